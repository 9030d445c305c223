"""Further extremes, of values and sizes: rows 22 to 28, and 32."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

import hapfmt
from hapfmt import Calibration, Channel, Recording, Span
from hapfmt.encoder.encode import encode
from hapfmt.encoder.source import InputBlock
from hapfmt.limits import LAST_TRACK_ID
from hapfmt.reading.reader import Reader
from hapfmt.writing.filewriter import FileWriter

from .filters import butterworth
from .row import Row, at_least, at_most, compared, exactly
from .signals import RATE, back, file_of, force, generator, same_bits


def raw(x: NDArray[np.generic], rate: Fraction | int = RATE) -> Channel:
    """Counts as they are."""
    return Channel(x, Fraction(rate), calibration=Calibration())


def full_scale() -> Iterator[Row]:
    """Noise over the whole range, from its lowest count to its highest."""
    for bits, kind in ((24, np.int16), (32, np.float32)):
        low, high = -(1 << (bits - 1)), (1 << (bits - 1)) - 1
        x = generator(bits).integers(low, high, 3000, endpoint=True)
        x[[7, 8]] = low, high
        with np.errstate(over="ignore", invalid="ignore"):
            narrow = x.astype(kind).astype(np.float64)
        wrong = np.mean(back(raw(x.astype(np.int32)), "lossless").stored != x)
        near = back(raw(x.astype(np.int32)), "near-lossless", max_error="100lsb").stored
        yield compared(
            22, f"counts of {bits} bits, full scale, as {np.dtype(kind).name}",
            (100 * np.mean(narrow != x), at_least(90)), (100 * wrong, exactly(0)),
            "% of samples wrong", "and within 100 counts where that is asked for",
            held=np.abs(near.astype(np.int64) - x).max() <= 100,
        )  # fmt: skip


def alternating() -> Iterator[Row]:
    x = np.tile(np.array([-(2**31), 2**31 - 1], np.int32), 500)
    with np.errstate(over="ignore"):
        naive = float(x.max() - x.min())
    ours = InputBlock((raw(x),), x[:, None], (Span(0, x.size),)).extents[0]
    yield compared(
        23, "+-max of 32 bits in turn, range of its counts in 32 bits", (naive, at_most(-1)),
        (ours, exactly(2**32 - 1)), "counts",
        held=np.array_equal(back(raw(x), "lossless").stored, x),
    )  # fmt: skip
    with np.errstate(over="ignore"):
        residual = np.diff(x, prepend=np.int32(0))
        step = np.int32(1000)
        levels = (2 * residual + step) // (2 * step)
        decoded = np.add.accumulate(levels.astype(np.int64) * 1000)
    near = back(raw(x), "near-lossless", max_error="1000lsb").stored.astype(np.int64)
    yield compared(
        23, "+-max of 32 bits in turn, quantised prediction in 32 bits",
        (float(np.abs(decoded - x).max()), at_least(2**31)),
        (float(np.abs(near - x).max()), at_most(1000)), "counts off",
        "33 bits for a difference, 34 for the rounding: level 2 has 64",
    )  # fmt: skip


def impulses() -> Row:
    """3 N for a millisecond, ten times a second, and nothing else."""
    x = np.zeros(4000)
    x[50::100] = 3
    d = butterworth(x, 8)
    knots = np.flatnonzero(np.diff(np.sign(np.diff(d)), prepend=0, append=0) != 0)
    naive = d + 0  # the residual in three bits, from its range
    step = np.abs(x - d).max() / 3
    naive += np.floor((x - d) / step + 0.5) * step
    rest = x == 0
    y = back(force(x)).samples()
    return compared(
        24, "impulse train, 3 bits against preset perceptual",
        (1000 * np.abs(naive[rest]).max(), at_least(100)),
        (1000 * np.abs(y[rest]).max(), at_most(6)), "mN where nothing is",
        f"Butterworth of order 8 rings on {knots.size} turns; ours keeps the deadband of 10 %",
        held=np.abs(y - x).max() <= 0.1 * 3,
    )  # fmt: skip


def denormals() -> Row:
    x = generator(5).integers(1, 2**40, 800).astype(np.uint64).view(np.float64)
    single = x.astype(np.float32).astype(np.float64)
    channel = Channel(x, Fraction(RATE))
    ours = [back(channel, "lossless", fast=fast).samples() for fast in (False, True)]
    return compared(
        25, "denormal doubles, stored as float32", (100 * np.mean(single != x), exactly(100)),
        (100 * max(np.mean(~same_bits(y, x)) for y in ours), exactly(0)), "% of samples lost",
    )  # fmt: skip


def negative_zero() -> Row:
    x = np.where(np.arange(3000) % 3 == 0, -0.0, np.arange(3000) % 7 * 0.25)
    naive = np.rint(x / 0.25).astype(np.int32) * 0.25
    ours = back(Channel(x, Fraction(RATE)), "lossless").samples()
    return compared(
        25, "-0.0 among steps of 0.25, stored as counts",
        (100 * np.mean(~same_bits(naive, x)), at_least(33)),
        (100 * np.mean(~same_bits(ours, x)), exactly(0)), "% of words changed",
        "no count stands for -0.0: words are kept",
    )  # fmt: skip


def one_sample_each() -> Row:
    """Each in a unit and with a name of its own."""
    count = 400
    channels = [
        Channel(np.array([i], np.int32), Fraction(RATE), calibration=Calibration(), label=f"c{i}")
        for i in range(count)
    ]
    out = io.BytesIO()
    np.savez(out, **{channel.label: channel.stored for channel in channels})
    data = file_of(*channels)
    found = hapfmt.read(data).channels
    return compared(
        26, f"{count} tracks of one sample, as npz", (out.tell() / count, at_least(100)),
        (len(data) / count, at_most(40)), "bytes a track",
        held=[int(channel.stored[0]) for channel in found] == list(range(count)),
    )  # fmt: skip


def all_tracks() -> Row:
    """As many as there can be; numbers of 16 bits with a sign end at half of them."""
    count = LAST_TRACK_ID + 1
    made = encode(Recording((raw(np.array([7], np.int32)),)))
    out = io.BytesIO()
    writer = FileWriter(out, level=made.level)
    writer.describe([replace(made.tracks[0], id=i, first_channel=i) for i in range(count)])
    for first in range(0, count, 1 << 13):
        stop = min(first + (1 << 13), count)
        writer.cluster([replace(made.packets[0], track=i) for i in range(first, stop)])
    writer.close()
    with Reader(out.getvalue()) as reader:
        found = reader.read()
    lost = int((np.arange(count).astype(np.int16) < 0).sum())
    return compared(
        27, f"{count} tracks, numbered in 16 bits with a sign", (lost, at_least(32_000)),
        (count - len(found), exactly(0)), "tracks lost",
        f"{out.tell() / count:.1f} bytes a track of one sample",
        held=all(channel.stored.tolist() == [7] for channel in found.channels),
    )  # fmt: skip


def long_span() -> Row:
    """Steps around tick 2^24, where float32 has no odd numbers any more."""
    n, steps = (1 << 24) + 9, (1 << 24) + np.array([-3, -1, 1, 3, 5])
    x = np.zeros(n, np.int8)
    for i, tick in enumerate(steps.tolist()):
        x[tick:] = i + 1
    naive = steps.astype(np.float32).astype(np.int64)
    data = file_of(raw(x), settings=hapfmt.Settings.of("lossless"))
    found = hapfmt.read(data, start=Fraction(n - 20, RATE)).channels[0]
    places = found.start_tick + 1 + np.flatnonzero(np.diff(found.stored))
    wrong = 5 if places.size != 5 else int((places != steps).sum())
    return compared(
        28, "steps at ticks around 2^24, ticks in float32",
        (int((naive != steps).sum()), at_least(3)), (wrong, exactly(0)), "of 5 steps elsewhere",
        f"{len(data)} bytes for {n} samples",
        held=len(data) < 10_000,
    )  # fmt: skip


def hold() -> Row:
    """One position, held for ten hours."""
    n = 36_000_000
    x = np.broadcast_to(np.int16(1234), n)
    data = file_of(raw(x), settings=hapfmt.Settings.of("lossless"))
    huffman = (n + 7) // 8
    with Reader(data) as reader:
        end = reader.read(start=Fraction(35_999)).channels[0]
    return compared(
        32, "ten hours of one value, a bit a sample", (huffman, at_least(4_000_000)),
        (len(data), at_most(20_000)), "bytes", "Huffman codes have at least a bit each",
        held=end.stored.size == 1000 and bool((end.stored == 1234).all()),
    )  # fmt: skip


ROWS = (
    full_scale, alternating, impulses, denormals, negative_zero, one_sample_each, long_span, hold,
)  # fmt: skip
DEEP = (all_tracks,)
