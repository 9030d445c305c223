"""Further extremes, of time: rows 29 to 31."""

from __future__ import annotations

import io
from collections.abc import Iterator
from fractions import Fraction
from math import floor

import numpy as np

import hapfmt
from hapfmt import Calibration, Channel, ClockObservation, Span
from hapfmt.errors import ParameterError
from hapfmt.reading.clocks import fit_clock
from hapfmt.reading.packets import tick_range

from .row import Row, at_least, at_most, compared, exactly
from .signals import RATE, Samples, file_of, generator, texture

HOUR = Fraction(1, 3600)
BASE_NS = 1_700_000_000 * 10**9


def odd_rates() -> Row:
    """Hourly samples for 40 days, and 15 ms of 200 kHz; float64 seconds since 1970 as times."""
    hours, epoch = 1000, BASE_NS / 1e9
    fast = np.floor(texture(3000, 2000, band=(1e3, 80e3), rate=200_000)).astype(np.int16)
    slow = np.arange(hours, dtype=np.int32)
    channels = (
        Channel(slow, HOUR, calibration=Calibration(), label="slow"),
        Channel(fast, Fraction(200_000), calibration=Calibration(), label="fast"),
    )
    data = file_of(*channels, settings=hapfmt.Settings.of("lossless"))
    back = hapfmt.read(data).channels
    naive = sum(floor((epoch + k / 200_000 - epoch) * 200_000) != k for k in range(fast.size))
    naive += sum(floor((epoch + k * 3600 - epoch) / 3600) != k for k in range(hours))
    ours = sum(tick_range(HOUR, k * 3600, None)[0] != k for k in range(hours))
    for k in range(fast.size):
        ours += tick_range(Fraction(200_000), Fraction(k, 200_000), None)[0] != k
    some = [hapfmt.read(data, ["slow"], k * 3600, k * 3600 + 1).channels[0] for k in (3, 777)]
    return compared(
        29, "1/3600 Hz beside 200 kHz, times in float64", (naive, at_least(100)),
        (ours, exactly(0)), f"of {hours + fast.size} ticks wrong",
        f"seconds since 1970; ours: both rates as fractions, {len(data)} bytes for both",
        held=all(np.array_equal(a.stored, b.stored) for a, b in zip(channels, back, strict=True))
        and [channel.stored.tolist() for channel in some] == [[3], [777]],
    )  # fmt: skip


def slow_logger() -> Row:
    """A temperature, once an hour for 40 days, in clusters of ten seconds as of any recording."""
    walk = np.cumsum(generator(1).integers(-3, 4, 1000)).astype(np.int32)
    channel = Channel(walk, HOUR, calibration=Calibration(1, 0, 10), unit="Cel")
    sizes = [
        len(file_of(channel, settings=hapfmt.Settings.of("lossless", cluster=cluster)))
        for cluster in (Fraction(10), None)
    ]
    return compared(
        29, "1/3600 Hz alone, clusters of ten seconds", (sizes[0] / walk.size, at_least(30)),
        (sizes[1] / walk.size, at_most(2)), "bytes a sample",
        "a cluster has 256 ticks of the fastest channel, unless told otherwise",
    )  # fmt: skip


def late_start() -> Row:
    """A second at 1 kHz that begins after ten hours; an array that begins at 0 is filled with
    NaN."""
    first = 36_000_000
    x = np.floor(texture(RATE, 200) + 0.5).astype(np.int16)
    channel = Channel(x, Fraction(RATE), (Span(first, first + x.size),), Calibration())
    head = io.BytesIO()
    np.save(head, np.zeros(0))
    data = file_of(channel, settings=hapfmt.Settings.of("lossless"))
    back = hapfmt.read(data).channels[0]
    return compared(
        30, "a second that begins after ten hours, as npy of doubles",
        (head.tell() + 8 * (first + x.size), at_least(10**8)), (len(data), at_most(3000)), "bytes",
        held=back.coverage == channel.coverage and np.array_equal(back.stored, x),
    )  # fmt: skip


def stamps(
    seed: int, steps: tuple[tuple[float, float], ...] = ()
) -> tuple[list[ClockObservation], Samples]:
    """(stamps a second apart for 20 minutes, the true readings, ns): 40 ppm fast, 2 ms
    of jitter, one in a hundred 0.1 s late and more."""
    rng = generator(seed)
    t = np.arange(1200.0)
    truth = 40e3 * t + t * 1e9
    for at, height in steps:
        truth = truth + (t >= at) * height
    told = truth + rng.normal(0, 2e6, t.size) + (rng.random(t.size) < 0.01) * 1e8
    return [
        ClockObservation("pc", 0, int(k) * RATE, BASE_NS + round(x))
        for k, x in zip(t, told, strict=True)
    ], truth


def clocks() -> Iterator[Row]:
    """One straight line by least squares, against the map of ``fit_clock``."""
    for case, steps in (
        ("that jitters", ()),
        ("that jumps by 3 s, and back by 50 ms", ((400.0, 3e9), (800.0, -5e7))),
    ):
        seen, truth = stamps(1, steps)
        ticks = np.array([each.tick for each in seen], dtype=float)
        told = np.array([each.time_ns - BASE_NS for each in seen], dtype=float)
        line = np.polynomial.Polynomial.fit(ticks, told, 1)(ticks)
        found = fit_clock(seen, RATE)
        ours = np.array([found.time_ns(each.tick) - BASE_NS for each in seen], dtype=float)
        naive, good = (float(np.sqrt(np.mean((y - truth) ** 2))) / 1e6 for y in (line, ours))
        yield compared(
            31, f"a clock {case}", (naive, at_least(0.7)), (good, at_most(0.5)), "ms rms",
            f"jitter of 2 ms, one stamp in a hundred is 100 ms late; {len(found.points)} points",
        )  # fmt: skip


def backwards() -> Row:
    """Set back by an hour in the middle: repeated times have no single tick."""
    seen, _ = stamps(2, ((600.0, -3.6e12),))
    told = np.array([each.time_ns - BASE_NS for each in seen], dtype=float)
    found = np.interp(told, told, np.arange(told.size))  # which asks for growing times
    refused = False
    try:
        fit_clock(seen, RATE)
    except ParameterError:
        refused = True
    kept = seen[0].time_ns - seen[-1].time_ns > 0
    return compared(
        31, "a clock that runs back by an hour, np.interp",
        (100 * np.mean(np.abs(found - np.arange(told.size)) > 0.5), at_least(10)),
        (0 if refused else 100, exactly(0)), "% of stamps at another tick",
        "no map is made; stamps are kept as they were told", held=kept,
    )  # fmt: skip


ROWS = (odd_rates, slow_logger, late_start, clocks, backwards)
