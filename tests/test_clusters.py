"""The queue of a recorder, and its clusters."""

from __future__ import annotations

import threading
import time
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.writing.clusters import PACKET_SAMPLES, Clusters, SampleRows, pieces_of
from hapfmt.writing.worker import OVERHEAD, SampleQueue


def rows(channels, start, ticks, value=1, dtype=np.int32):
    return SampleRows(channels, start, np.full((ticks, len(channels)), value, dtype))


def spans(clusters):
    """(channel, start, stop) of each piece, by cluster."""
    return [[(p.channel, p.start, p.start + len(p.values)) for p in pieces] for pieces in clusters]


def two(patience=1) -> Clusters:
    clusters = Clusters(Fraction(1), Fraction(patience))
    clusters.add(0, Fraction(10), 0)
    clusters.add(1, Fraction(100), 0)
    return clusters


def test_a_cluster_waits_for_every_channel():
    clusters = two()
    assert clusters.take(rows((0,), 0, 12))
    assert spans(clusters.complete()) == []
    assert not clusters.take(rows((1,), 0, 99))
    assert clusters.take(rows((1,), 99, 1))
    assert spans(clusters.complete()) == [[(0, 0, 10), (1, 0, 100)]]
    assert spans(clusters.rest()) == [[(0, 10, 12)]] and clusters.size == 0


def test_but_not_longer_than_patience_and_not_again_until_it_has_caught_up():
    clusters = two(patience=2)
    clusters.take(rows((1,), 0, 299))
    assert spans(clusters.complete()) == []
    clusters.take(rows((1,), 299, 101))
    assert spans(clusters.complete()) == [
        [(1, 0, 100)],
        [(1, 100, 200)],
        [(1, 200, 300)],
        [(1, 300, 400)],
    ]
    clusters.take(rows((0,), 0, 5))
    clusters.take(rows((1,), 400, 100))
    assert spans(clusters.complete()) == [[(0, 0, 5)], [(1, 400, 500)]]
    # Caught up: it is waited for again.
    clusters.take(rows((0,), 5, 47))
    clusters.take(rows((1,), 500, 150))
    assert spans(clusters.complete())[-1:] != [[(1, 500, 600)]]
    clusters.take(rows((0,), 52, 8))
    assert (1, 500, 600) in spans(clusters.complete())[-1]


def test_what_comes_late_by_much_is_written_as_it_comes():
    clusters = two(patience=1)
    clusters.take(rows((1,), 0, 10_000))
    assert len(spans(clusters.complete())) == 100
    clusters.take(rows((0,), 0, 500))
    assert len(spans(clusters.complete())) == 48
    assert len(clusters.buckets) == 2


def test_skips_move_a_channel_on():
    clusters = two()
    clusters.take(rows((0,), 0, 3))
    clusters.take(rows((0,), 10, 0))
    assert clusters.take(rows((1,), 0, 100))
    assert spans(clusters.complete()) == [[(0, 0, 3), (1, 0, 100)]]


@given(st.data())
def test_pieces_hold_every_sample_once(data):
    """Single channels and rows mixed, NaN anywhere, any order of the channels."""
    width, ticks = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 60))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    values = rng.integers(0, 50, (ticks, width)).astype(float)
    values[rng.random(values.shape) < data.draw(st.sampled_from([0, 0.1]))] = np.nan
    parts, at = [], 0
    while at < ticks:
        stop = min(ticks, at + int(rng.integers(1, 9)))
        if rng.integers(2):
            parts.append(SampleRows(tuple(range(width)), at, values[at:stop]))
        else:
            parts += [
                SampleRows((channel,), at, values[at:stop, channel : channel + 1])
                for channel in rng.permutation(width).tolist()
            ]
        at = stop
    back = np.full_like(values, np.nan)
    last: dict[int, int] = {}
    for piece in pieces_of(parts):
        assert piece.start > last.get(piece.channel, -1)
        last[piece.channel] = piece.start + len(piece.values)
        back[piece.start : last[piece.channel], piece.channel] = piece.values
    assert np.array_equal(back, values, equal_nan=True)


def test_long_stretches_are_cut():
    (a, b) = pieces_of([rows((3,), 5, PACKET_SAMPLES + 1)])
    assert (a.start, len(a.values), b.start, len(b.values)) == (
        5,
        PACKET_SAMPLES,
        5 + PACKET_SAMPLES,
        1,
    )


def test_a_queue_gives_items_in_order_and_counts_what_the_taker_holds():
    queue: SampleQueue[str] = SampleQueue(10 * OVERHEAD)
    assert queue.put("a", 100) and queue.put("b", wake=True)
    assert queue.take(0) == "a" and queue.size == 100 + 2 * OVERHEAD
    assert queue.take(0) == "b" and queue.size == OVERHEAD
    assert queue.take(0.01) is None and queue.size == 0
    queue.put("c")
    began = time.monotonic()
    assert queue.take(0.05) == "c" and time.monotonic() - began >= 0.04


@pytest.mark.realtime
def test_a_full_queue_refuses_or_waits():
    queue: SampleQueue[int] = SampleQueue(1)
    assert queue.put(1, 10**9)
    assert not queue.put(2, wait=False)
    done = threading.Thread(target=lambda: [queue.take(60), queue.take(60), queue.take(60)])
    threading.Timer(0.05, done.start).start()
    assert queue.put(2) and queue.blocked_s > 0.01
    queue.join()
    assert queue.done_count == 2 and queue.size == 0
    queue.put(3, wake=True)
    done.join()


def test_the_takers_error_reaches_all_who_wait():
    queue: SampleQueue[int] = SampleQueue(1)
    queue.put(1)
    threading.Timer(0.05, queue.fail, [ValueError("broken")]).start()
    with pytest.raises(ValueError, match="broken"):
        queue.put(2)
    with pytest.raises(ValueError, match="broken"):
        queue.join()
    with pytest.raises(ValueError, match="broken"):
        queue.refuse()
