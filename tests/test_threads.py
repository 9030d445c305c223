"""The same results whatever the number of threads."""

from __future__ import annotations

import concurrent.futures
import io
import threading
import time
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hapfmt
from hapfmt import Calibration, Channel, ParameterError, Recording, Settings
from hapfmt import threads as module
from hapfmt.encoder import encode as encoding
from hapfmt.threads import Stopped, check_stopped, in_order, thread_count

COUNTS = [1, 2, 3, 7]
PRESETS = ["lossless", "near-lossless", "perceptual", "paper"]


def recording(size: int = 3000) -> Recording:
    rng = np.random.default_rng(5)
    walks = rng.integers(-9, 10, (5, size)).cumsum(axis=1)
    channels = [
        Channel(w.astype(np.int32), Fraction(100), calibration=Calibration(1, 0, 100), unit="N")
        for w in walks
    ]
    noise = Channel(rng.normal(size=size), Fraction(100), label="noise")
    return Recording((*channels, noise))


def written(threads: int, preset: str, **more: object) -> bytes:
    stream = io.BytesIO()
    settings = Settings.of(preset, digest=True, cluster=5)
    hapfmt.write(recording(), stream, settings, canonical=1, threads=threads, **more)
    return stream.getvalue()


@pytest.mark.compiled
@pytest.mark.parametrize("preset", PRESETS)
def test_the_bytes_do_not_depend_on_threads(preset):
    one = written(1, preset)
    assert all(written(threads, preset) == one for threads in COUNTS[1:])


@pytest.mark.compiled
@pytest.mark.parametrize("threads", COUNTS)
def test_reading_does_not_depend_on_threads(threads):
    data = written(1, "lossless")
    one, many = hapfmt.read(data, threads=1), hapfmt.read(data, threads=threads)
    for a, b in zip(one.channels, many.channels, strict=True):
        assert np.array_equal(a.stored, b.stored)
        assert np.array_equal(a.samples(), b.samples())
    assert hapfmt.verify(data, threads=threads) == hapfmt.verify(data, threads=1)


@pytest.mark.parametrize("threads", COUNTS)
def test_pieces_come_in_order(threads, monkeypatch):
    monkeypatch.setattr("hapfmt.reading.reader.BATCH", 700)

    def pieces(threads: int) -> list[tuple[int, int, bytes]]:
        with hapfmt.Reader(data, threads=threads) as reader:
            tracks = [ref.track for ref in reader.channels]
            return [(p.track.id, p.start, p.numbers.tobytes()) for p in reader.pieces(tracks)]

    data = written(1, "lossless")
    assert len(pieces(1)) > 12
    assert pieces(threads) == pieces(1)


@pytest.mark.parametrize("threads", COUNTS)
def test_progress_is_told_in_order_and_in_the_callers_thread(threads):
    told: list[tuple[int, int]] = []
    callers = set()

    def progress(done: int, total: int) -> None:
        told.append((done, total))
        callers.add(threading.get_ident())

    written(threads, "lossless", progress=progress)
    assert told == [(i, 6) for i in range(1, 7)]
    with hapfmt.Reader(written(1, "lossless"), threads=threads) as reader:
        told.clear()
        reader.read(progress=progress)
    assert told == sorted(told)
    assert told[-1][0] == told[-1][1]
    assert callers == {threading.get_ident()}


@pytest.mark.parametrize("threads", COUNTS)
def test_broken_packets_raise_the_first_error(threads):
    data = written(1, "lossless")
    errors = set()
    for count in (1, threads):
        # Two packets that break a rule although their CRCs hold: the first one is told.
        with hapfmt.Reader(data, threads=count) as reader:
            broken = Broken(reader, {4, 7})
            with pytest.raises(hapfmt.FormatError) as caught:
                list(reader.pieces([ref.track for ref in reader.channels]))
            assert broken.seen > 4 or count == 1
            errors.add(str(caught.value))
    assert len(errors) == 1


class Broken:
    """A reader some of whose packets are cut short after their CRC was checked."""

    def __init__(self, reader: hapfmt.Reader, places: set[int]) -> None:
        self.packets, self.places, self.seen = reader.packets, places, 0
        reader.packets = self  # type: ignore[method-assign, assignment]

    def __call__(self, *given, **named):
        for place, packet in enumerate(self.packets(*given, **named)):
            self.seen = place
            yield replace(packet, data=b"") if place in self.places else packet


def test_a_damaged_file_is_read_the_same_way():
    data = bytearray(written(1, "lossless"))
    with hapfmt.Reader(bytes(data)) as reader:
        offset = reader.catalogue.data[1].offset
    data[offset + 60] ^= 1
    found = []
    for threads in COUNTS:
        with hapfmt.Reader(bytes(data), threads=threads) as reader:
            values = [channel.stored.tobytes() for channel in reader.read().channels]
            found.append((values, [f.as_json() for f in reader.findings], reader.lost))
    assert found[0][1]
    assert all(each == found[0] for each in found)


@pytest.mark.parametrize("threads", COUNTS)
def test_encoding_raises_the_first_error(threads, monkeypatch):
    usual = encoding.encode_unit

    def broken(members, first_channel, job):
        if first_channel == 1:
            time.sleep(0.02)
        if first_channel in (1, 2):
            raise ParameterError(f"channel {first_channel}")
        return usual(members, first_channel, job)

    monkeypatch.setattr(encoding, "encode_unit", broken)
    with pytest.raises(ParameterError, match="channel 1"):
        written(threads, "lossless")


@given(
    st.lists(st.integers(0, 9), max_size=30),
    st.integers(1, 4),
    st.integers(0, 40),
    st.integers(0, 40),
)
def test_in_order_is_map(weights, threads, bad_item, bad_work):
    """What comes before the first error, and that error."""

    def items():
        for place, weight in enumerate(weights):
            if place == bad_item:
                raise KeyError(place)
            yield place, weight

    def work(item: tuple[int, int]) -> int:
        if item[0] == bad_work:
            raise ValueError(item[0])
        return 2 * item[0]

    def outcome(threads: int) -> list[object]:
        found: list[object] = []
        try:
            found.extend(in_order(work, items(), threads, lambda item: item[1] / 5))
        except (KeyError, ValueError) as error:
            found.append(repr(error))
        return found

    assert outcome(threads) == outcome(1)


def test_no_more_than_its_weight_is_ahead():
    running, most, lock = 0, 0, threading.Lock()

    def work(_: int) -> None:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.001)
        with lock:
            running -= 1

    list(in_order(work, range(20), 4, lambda _: 0.7))
    assert most == 1
    both = threading.Barrier(2, timeout=60)
    list(in_order(lambda item: item < 2 and both.wait(), range(20), 4, lambda _: 0.1))


def test_what_nobody_waits_for_stops():
    ended = threading.Event()

    def work(item: int) -> int:
        if not item:
            return item
        try:
            while True:
                check_stopped()
                time.sleep(0.001)
        except Stopped:
            ended.set()
            raise

    results = in_order(work, range(9), 2)
    assert next(results) == 0
    results.close()  # type: ignore[attr-defined]
    assert ended.is_set()
    assert not [t for t in threading.enumerate() if t.name.startswith("hapfmt")]
    check_stopped()


class TestHowMany:
    def test_asked_for(self, monkeypatch):
        monkeypatch.setenv("HAPFMT_THREADS", "5")
        assert thread_count(3, 10) == 3
        assert thread_count(None, 10) == 5

    def test_the_cpus_there_are(self, monkeypatch):
        monkeypatch.delenv("HAPFMT_THREADS", raising=False)
        monkeypatch.setattr(module, "compiled", object())
        monkeypatch.setattr(module, "cpu_count", lambda: 6)
        assert thread_count(None, module.SMALL) == 6
        assert thread_count(None, module.SMALL - 1) == 1
        monkeypatch.setattr(module, "compiled", None)
        assert thread_count(None, module.SMALL) == 1

    def test_at_least_one_cpu(self):
        assert module.cpu_count() >= 1

    @pytest.mark.parametrize("text", ["many", "-1", "1.5"])
    def test_no_number(self, monkeypatch, text):
        monkeypatch.setenv("HAPFMT_THREADS", text)
        with pytest.raises(ParameterError, match="HAPFMT_THREADS"):
            thread_count(None, 1)

    def test_none_at_all(self):
        with pytest.raises(ParameterError):
            thread_count(0, 1)


def test_no_pool_where_one_thread_is_enough(monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a pool for small work")

    monkeypatch.setattr(concurrent.futures, "ThreadPoolExecutor", refuse)
    stream = io.BytesIO()
    hapfmt.write(Recording((Channel(np.arange(100) % 7 / 10, Fraction(1000)),)), stream)
    assert hapfmt.read(stream.getvalue()).sample_count == 100
    # Imported where a pool is made, and nowhere before.
    assert not {"concurrent", "ThreadPoolExecutor"} & {*vars(module)}
