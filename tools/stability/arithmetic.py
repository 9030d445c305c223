"""Numbers: rows 3, 6, 9, 13, 15, 16."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from math import floor

import numpy as np
from numpy.typing import NDArray
from scipy import signal

import hapfmt
from hapfmt import Calibration, Channel, Span
from hapfmt.codecs.quantised import quantise
from hapfmt.encoder.predict import ORDER_LIMIT, autocorrelations, levinson
from hapfmt.encoder.unit import choose_codebook
from hapfmt.numbers import rdiv
from hapfmt.split import low_pass

from .filters import butterworth
from .row import Row, at_least, at_most, compared, exactly
from .signals import RATE, Samples, back, counts, file_of, generator, same_bits, snr_db, texture


def huge() -> Iterator[Row]:
    x = np.sin(4 * np.pi * np.arange(4000) / RATE) * 1.7e308
    naive = np.mean(~np.isfinite(butterworth(x)))
    ours = low_pass(x, RATE)
    like = np.ldexp(low_pass(np.ldexp(x, -1000), RATE), 1000)
    yield compared(
        3, "values up to 1.7e308, low-pass", (100 * naive, at_least(0.1)),
        (100 * np.mean(~np.isfinite(ours)), exactly(0)), "% not finite",
        "scaled by a power of two, so the same as of small values, bit for bit",
        held=np.array_equal(ours, like),
    )  # fmt: skip
    x = (1 + texture(4000, 0.3)) * 1e300
    with np.errstate(over="ignore", invalid="ignore"):
        sums = np.array([np.sum(x[k:] * x[: x.size - k]) for k in range(9)])
    full = generator(1).integers(-(2**31), 2**31, x.size)
    found = autocorrelations(full, 0, 0)
    reflections, energies = levinson(found, full.size, ORDER_LIMIT)
    decoded = back(Channel(x, RATE), "lossless").samples()
    yield compared(
        3, "values of 1e300, autocorrelation", (100 * np.mean(~np.isfinite(sums)), exactly(100)),
        (100 * np.mean(~np.isfinite(energies)), exactly(0)), "% not finite",
        "ours: counts of 32 bits, sums of integers scaled to 18 bits; 1e300 comes back exactly",
        held=max(map(abs, found)) < 1 << 63 and bool(reflections) and same_bits(decoded, x).all(),
    )  # fmt: skip


def offset() -> Iterator[Row]:
    """A texture of 1 mN on a force: found again after storing and taking the slow part away."""
    fine = texture(4000, 0.001)
    micro = Fraction(1, 1_000_000)
    for force_n, most in ((1, 60), (100, 20), (10_000, 0)):
        x = np.round((force_n + fine) * 1e6) / 1e6
        truth = x - low_pass(x, RATE)
        stored = x.astype(np.float32)
        sections = signal.bessel(4, 0.04, output="sos").astype(np.float32)
        start = (signal.sosfilt_zi(sections) * stored[0]).astype(np.float32)
        slow = signal.sosfilt(sections, stored, zi=start)[0]
        exact = signal.sosfilt(sections.astype(float), x, zi=start.astype(float))[0]
        wrong = (stored - slow).astype(np.float64) - (x - exact)
        channel = back(Channel.from_physical(x, RATE), "lossless")
        assert channel.calibration is not None
        own = channel.stored - low_pass(channel.stored, RATE)
        error = own * float(abs(channel.calibration.step)) - truth
        ours = min(snr_db(truth, error), 200)
        yield compared(
            6, f"texture of 1 mN on {force_n} N, float32",
            (snr_db(x - exact, wrong), at_most(most)), (ours, at_least(100)), "dB",
            "ours: counts from an integer offset; 200 is the most told",
            held=abs(channel.calibration.step) == micro,
        )  # fmt: skip


def short() -> Row:
    """Nothing, one sample, two, and always the same."""
    cases = [np.zeros(0), np.ones(1), np.array([1.0, 2.0]), np.full(500, 0.7)]
    naive = sum(not naively(x) for x in cases)
    wrong = 0
    for x in cases:
        for preset in ("lossless", "near-lossless", "perceptual", "paper"):
            for channel in (
                Channel.from_physical(x, RATE),
                Channel(counts(x), RATE, calibration=Calibration(1, 0, 1000)),
            ):
                y = back(channel, preset).samples()
                wrong += not (y.shape == x.shape and (np.abs(y - x) <= 0.1 * x + 1e-12).all())
    e = np.zeros(100, np.int64)
    lengths = choose_codebook([e], 1).lengths
    return compared(
        9, "0, 1, 2 samples, a constant", (naive, at_least(3)), (wrong, exactly(0)),
        "cases that fail",
        "naive: filter raises, step 0, code words of no bits; ours: 4 presets, doubles and counts,"
        " deadband 10 %",
        held=len(lengths) > 0,
    )  # fmt: skip


def naively(x: Samples) -> bool:
    """Filter, range-derived step, Huffman lengths as usual: whether samples come back."""
    try:
        e = x - butterworth(x)
        step = np.abs(e).max() / 15
        with np.errstate(invalid="raise", divide="raise"):
            levels = np.floor(e / step + 0.5)
    except (ValueError, FloatingPointError):
        return False
    return bool(np.unique(levels).size > 1)


def hours() -> Iterator[Row]:
    start = np.float32(2047)
    ticks = np.full(1_000_000, np.float32(1e-4))
    ticks[0] = start
    shown = float(np.add.accumulate(ticks, dtype=np.float32)[-1]) - 2047
    tick = 36_000 * 10_000 + 7
    channel = Channel(
        np.array([1, 2, 3], np.int32), Fraction(10_000), (Span(tick, tick + 3),), Calibration()
    )
    data = file_of(channel)
    found = hapfmt.read(data, start=Fraction(tick + 1, 10_000), stop=Fraction(tick + 2, 10_000))
    (span,) = found.channels[0].coverage
    ours = abs(float(Fraction(span.start - tick - 1, 10_000)))
    yield compared(
        13, "10 kHz, float32 seconds added up, 100 s from 2047 s", (100 - shown, at_least(50)),
        (ours, exactly(0)), "s behind", "ticks are integers: a sample found after 10 h by its time",
        held=span.ticks == 1 and found.channels[0].stored.tolist() == [2],
    )  # fmt: skip
    total, hour = 0.0, 36_000_000
    step = np.full(1 << 20, 1e-4)
    for first in range(0, hour, step.size):
        part = step[: min(step.size, hour - first)].copy()
        part[0] += total
        total = float(np.add.accumulate(part)[-1])
    yield compared(
        13, "10 kHz, float64 seconds added up, an hour", (1e6 * abs(total - 3600), at_least(1)),
        (1e6 * ours, exactly(0)), "us off",
    )  # fmt: skip


def ties() -> Iterator[Row]:
    odd = np.arange(-1001, 1002, 2)
    stated = np.array([floor(Fraction(int(n), 2) + Fraction(1, 2)) for n in odd])
    ours = np.array([rdiv(int(n), 2) for n in odd])
    levels = quantise(odd * 500, 1000)
    wrong = max(int((found != stated).sum()) for found in (ours, levels))
    half = odd / 2
    ways: tuple[tuple[str, Callable[[Samples], NDArray[np.float64]]], ...] = (
        ("to even (0.5, 1.5, 2.5 are 0, 2, 2)", np.rint),
        ("away from 0 (1, 2, 3; -1, -2, -3)", lambda x: np.trunc(x + np.copysign(0.5, x))),
    )
    for case, way in ways:
        yield compared(
            15, f"ties rounded {case}", (int((way(half) != stated).sum()), at_least(400)),
            (wrong, exactly(0)), f"of {odd.size} ties", "floor(x + 1/2) on integers, stated",
        )  # fmt: skip


def float32_lossless() -> Row:
    walk = np.cumsum(generator(4).integers(-(2**20), 2**20, 5000))
    x = np.clip(walk + 2**30, -(2**30), 2**31 - 1).astype(np.int32)
    single = x.astype(np.float32)
    errors = np.diff(single, prepend=np.float32(0))
    decoded = np.add.accumulate(errors, dtype=np.float32).astype(np.int64)
    ours = back(Channel(x, RATE, calibration=Calibration()), "lossless").stored
    first = int(np.flatnonzero(decoded != x)[0])
    return compared(
        16, "lossless predictor in float32, 31-bit counts",
        (100 * np.mean(decoded != x), at_least(90)), (100 * np.mean(ours != x), exactly(0)),
        "% of samples wrong", f"first wrong sample: {first}", held=first < 10,
    )  # fmt: skip


ROWS = (huge, offset, short, hours, ties, float32_lossless)
