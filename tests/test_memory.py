"""Peak memory of writing and reading stays that of a cluster, beside the recording itself."""

from __future__ import annotations

import io
import tracemalloc
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.spool import GrowingArray

MIB = 1 << 20


def staircase(minutes: int) -> Recording:
    """Each packet of 10 s is constant, so that coding it takes no time."""
    counts = np.repeat(np.arange(6 * minutes, dtype=np.int32), 10_000)
    return Recording((Channel(counts, Fraction(1000), calibration=Calibration()),))


def peak_of(work: Callable[[], object]) -> int:
    work()  # imports and tables
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


SETTINGS = {
    "lossless": Settings.of("lossless", cluster=10),
    "near-lossless": Settings.of("near-lossless", max_error="1lsb", cluster=10),
    "perceptual": Settings.of(
        "perceptual", texture=False, felt="all", k=0, floor="2lsb", cluster=10
    ),
}


@pytest.mark.compiled
@pytest.mark.parametrize("preset", SETTINGS)
def test_writing_holds_no_second_recording(preset):
    for minutes in (6, 18):
        recording = staircase(minutes)
        own = recording.channels[0].stored.nbytes
        used = peak_of(
            lambda r=recording: hapfmt.write(r, io.BytesIO(), SETTINGS[preset], canonical=1)
        )
        assert used < own / 4 + 3 * MIB


def test_reading_holds_the_samples_once():
    recording = staircase(60)
    stream = io.BytesIO()
    hapfmt.write(recording, stream, SETTINGS["lossless"], canonical=1)
    own = recording.channels[0].stored.nbytes
    assert own < peak_of(lambda: hapfmt.read(stream.getvalue())) < 1.25 * own + 2 * MIB


def test_reading_holds_exact_values_once():
    """Beside their counts: three times the bytes of these."""
    x = staircase(20).channels[0].stored * 0.1
    stream = io.BytesIO()
    hapfmt.write(
        Recording((Channel(x, Fraction(1000)),)), stream, SETTINGS["lossless"], canonical=1
    )
    assert hapfmt.read(stream.getvalue()).channels[0].exact is not None
    own = x.nbytes * 3 // 2
    assert own < peak_of(lambda: hapfmt.read(stream.getvalue())) < 1.25 * own + 2 * MIB


def test_pieces_hold_one_packet():
    stream = io.BytesIO()
    hapfmt.write(staircase(60), stream, SETTINGS["lossless"], canonical=1)

    def walk() -> None:
        with hapfmt.Reader(stream.getvalue()) as reader:
            for piece in reader.pieces([ref.track for ref in reader.channels]):
                assert len(piece.numbers) == 10_000

    assert peak_of(walk) < 2 * MIB


@given(st.lists(st.integers(1, 40), min_size=1, max_size=30), st.integers(1, 3))
def test_growing_is_concatenation(sizes, width):
    rng = np.random.default_rng(sum(sizes))
    parts = [rng.integers(-9, 9, (size, width)).astype(np.int32) for size in sizes]
    growing = GrowingArray()
    for part in parts:
        growing.append(part)
    joined = growing.joined()
    assert joined is not None
    assert joined.dtype == np.int32
    assert np.array_equal(joined, np.concatenate(parts))


def test_nothing_grew():
    assert GrowingArray().joined() is None
