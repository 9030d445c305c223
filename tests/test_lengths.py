"""How long packets are: as long as one predictor serves."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt.codecs.predicted import INDEX_LIMIT
from hapfmt.encoder.encode import encode
from hapfmt.encoder.lengths import Load, PacketLengths
from hapfmt.encoder.predict import SHORTEST_CUT, best_cuts, fitting_packets
from hapfmt.encoder.source import cut
from hapfmt.recording import Channel, Recording, Span


def coloured(frequency, size, seed):
    """Noise with a resonance, in counts."""
    noise, x = np.random.default_rng(seed).normal(0, 30, size), np.zeros(size)
    for t in range(2, size):
        x[t] = 1.96 * np.cos(frequency) * x[t - 1] - 0.9604 * x[t - 2] + noise[t]
    return np.rint(x).astype(np.int64)


def test_packets_end_where_another_predictor_does_better():
    x = np.concatenate([coloured(0.5, 5 * SHORTEST_CUT, 1), coloured(2.5, 11 * SHORTEST_CUT, 2)])
    assert best_cuts(x) == [0, 5 * SHORTEST_CUT]
    recording = Recording((Channel(x.astype(np.int32), 8000),))
    # A small file is cut further, unless its clusters are given.
    packets = encode(recording, hapfmt.Settings(cluster=10)).packets
    assert [packet.span for packet in packets] == [5 * SHORTEST_CUT, 11 * SHORTEST_CUT]


@pytest.mark.parametrize("size", [100, SHORTEST_CUT, 2 * SHORTEST_CUT + 1, 16 * SHORTEST_CUT])
def test_a_steady_signal_stays_whole(size):
    assert best_cuts(coloured(0.5, size, 3)) == [0]
    assert best_cuts(np.full(size, 7)) == [0]


def test_doubles_are_cut_as_well():
    x = (
        np.concatenate([coloured(0.5, 5 * SHORTEST_CUT, 1), coloured(2.5, 5 * SHORTEST_CUT, 2)])
        * 0.1
    )
    recording = Recording((Channel(x + 1e-14 * np.sin(x), 8000, calibration=None),))
    encoded = encode(recording, hapfmt.Settings(cluster=10))
    assert encoded.tracks[0].codec == "LPCX"
    assert [packet.span for packet in encoded.packets] == [5 * SHORTEST_CUT, 5 * SHORTEST_CUT]


def test_no_cuts_are_looked_for_where_none_are_wanted():
    x = np.concatenate([coloured(0.5, 2 * SHORTEST_CUT, 1), coloured(2.5, 2 * SHORTEST_CUT, 2)])
    span, middle = Span(100, 100 + x.size), 100 + 2 * SHORTEST_CUT

    def parts(**given_):
        return [s for s, _ in fitting_packets(span, x, lambda _part: b"", **given_)]

    assert parts() == [Span(span.start, middle), Span(middle, span.stop)]
    assert parts(cuts=False) == [span]


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.sampled_from([0, 1, -3, INDEX_LIMIT, -INDEX_LIMIT]), min_size=2, max_size=5),
    st.integers(2 * SHORTEST_CUT, 6 * SHORTEST_CUT),
)
def test_any_counts_can_be_cut(values, size):
    starts = best_cuts(np.resize(np.repeat(values, 700), size))
    assert starts[0] == 0
    assert all(b - a >= SHORTEST_CUT for a, b in zip(starts, [*starts[1:], size], strict=True))


@pytest.mark.parametrize(
    ("span", "packets"),
    [
        (Span(0, 1039), [Span(0, 519), Span(519, 1039)]),
        (Span(518, 1038), [Span(518, 1038)]),
        (Span(518, 1039), [Span(518, 1039)]),
        (Span(0, 1059), [Span(0, 519), Span(519, 1038), Span(1038, 1059)]),
    ],
)
def test_few_ticks_join_their_neighbours(span, packets):
    assert cut([span], Fraction(1000), Fraction(519, 1000), 1) == packets


def test_a_late_recording_is_cut_as_it_is_at_tick_0():
    x = np.cumsum(np.random.default_rng(1).integers(-9, 10, 2056)).astype(np.int32)
    late = Channel(x, 60, coverage=(Span(2054, 2054 + x.size),))
    assert [packet.span for packet in encode(Recording((late,))).packets] == [x.size]


def test_lengths_follow_tracks_that_become_one():
    loads = [Load(100.0 * n, 1000, 40.0 + n) for n in range(1, 9)]
    joint = Load.of(loads[2:5])
    given_ = PacketLengths(
        Fraction(1), Fraction(9), Load.of(loads), sum(load.root for load in loads), 40.0
    )
    changed = given_.changed(loads[2:5], [joint])
    tracks = [*loads[:2], joint, *loads[5:]]
    assert changed.root == pytest.approx(sum(load.root for load in tracks))
    assert changed.whole.size == pytest.approx(given_.whole.size)
    assert changed.root > given_.root


def test_a_file_with_packets_of_many_lengths_is_read_back():
    a = np.concatenate([coloured(0.5, 5 * SHORTEST_CUT, 1), coloured(2.5, 11 * SHORTEST_CUT, 2)])
    given_ = Recording((Channel(a.astype(np.int32), 1000), Channel(a[::-4].astype(np.int16), 250)))
    import io

    out = io.BytesIO()
    hapfmt.write(given_, out)
    back = hapfmt.read(out.getvalue())
    for x, y in zip(given_.channels, back.channels, strict=True):
        assert np.array_equal(x.stored, y.stored)
    part = hapfmt.Reader(out.getvalue()).read(start=20, stop=21)
    assert np.array_equal(part.channels[0].stored, a[20000:21000])
