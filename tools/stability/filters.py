"""The split into slow and fast: rows 4, 5, 12, 14, 17."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
from scipy import signal

import hapfmt
from hapfmt import Channel
from hapfmt.split import CASCADE_RATIO, low_pass

from .row import Row, at_least, at_most, compared, exactly
from .signals import RATE, Samples, back, contact, counts, force, same_bits, texture

CUTOFF_HZ = 20.0
FELT_N = 0.03
"""Forces are felt from tens of millinewtons on."""


def butterworth(x: Samples, order: int = 2, rate: float = RATE, **given: object) -> Samples:
    """What is at hand: forward and backward, with SciPy's own padding (odd)."""
    sections = signal.butter(order, CUTOFF_HZ, fs=rate, output="sos")
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray(signal.sosfiltfilt(sections, x, **given))  # type: ignore[arg-type]


def not_a_number() -> Row:
    x = 1 + texture(4000, 0.03)
    x[2000] = np.nan
    lost = float(np.mean(np.isnan(butterworth(x))))
    channel = force(np.nan_to_num(x))
    gap = Channel.from_physical(x, RATE, unit="N")
    decoded = back(gap, tolerance="1e-3").filled()
    wrong = ~(np.abs(decoded - x) <= 0.02)
    return compared(
        4, "one NaN in 4 s", (100 * lost, exactly(100)), (100 * wrong.mean(), at_most(0.025)),
        "% of samples lost", "ours: a gap of one tick, filtered on each side alone",
        held=bool(np.isnan(decoded[2000])) and channel.stored.size == x.size,
    )  # fmt: skip


def infinite() -> Iterator[Row]:
    x = 1 + texture(4000, 0.03)
    x[2000] = np.inf
    lost = float(np.mean(~np.isfinite(butterworth(x))))
    x[1000:1003] = np.array([0x7FF8_0000_0000_0001, 0xFFF0_1234_5678_9ABC, 1], np.uint64).view(
        np.float64
    )
    channel = Channel(x, RATE, unit="N")  # type: ignore[arg-type]
    wrong = ~same_bits(back(channel, "lossless").samples(), x)
    yield compared(
        4, "an infinity and two words of NaN, preset lossless",
        (100 * lost, exactly(100)), (100 * wrong.mean(), exactly(0)), "% of samples lost",
        "every bit comes back",
    )  # fmt: skip
    with warnings.catch_warnings():  # the note that this channel is stored without loss
        warnings.simplefilter("ignore", hapfmt.errors.DataWarning)
        wrong = ~same_bits(back(channel, "perceptual").samples(), x)
    yield compared(
        4, "an infinity and two words of NaN, preset perceptual",
        (100 * lost, exactly(100)), (100 * wrong.mean(), exactly(0)), "% of samples lost",
        "the channel is stored without loss",
    )  # fmt: skip


def stiff_contact() -> Iterator[Row]:
    at = 1000
    x = contact(2000, at)
    slow, whole = (back(force(x), "paper", bits=8, band=band).samples() for band in ("lf", "full"))
    for order, least in ((2, 3), (4, 6), (8, 8)):
        undershoot = -100 * butterworth(x, order).min() / x.max()
        yield compared(
            5, f"0 to 3.3 N in a sample, Butterworth of order {order}",
            (undershoot, at_least(least)), (100 * abs(min(slow.min(), 0)) / x.max(), exactly(0)),
            "% pull before the touch", "ours: the LF track as a device gets it",
            held=slow.max() <= 3.3,
        )  # fmt: skip
    naive, ours, alone, exact = (
        at - int(np.flatnonzero(np.abs(y) > FELT_N)[0])
        for y in (butterworth(x, 8), slow, low_pass(x, RATE), whole)
    )
    yield compared(
        5, "0 to 3.3 N in a sample, LF begins early", (naive, at_least(60)), (ours, at_most(20)),
        "ms before the touch", f"beyond {1000 * FELT_N:g} mN, Butterworth of order 8; our filter "
        f"before knots {alone} ms, LF with HF {exact} ms, knots joined by lines reach "
        f"{1000 * slow[: at - 30].max():.0f} mN long before",
        held=exact == 0 and np.abs(whole - x).max() < 0.05 and slow[: at - 30].max() < FELT_N,
    )  # fmt: skip


def in_float32(sections: Samples, x: Samples) -> Samples:
    """Forward and backward over the reflected x, settled on its first sample."""
    start = signal.sosfilt_zi(sections)
    short = sections.astype(np.float32)
    y = np.pad(x, x.size - 1, mode="reflect").astype(np.float32)
    for _ in range(2):
        y = signal.sosfilt(short, y, zi=(start * y[0]).astype(np.float32))[0][::-1]
    return y[x.size - 1 : 2 * x.size - 1].astype(np.float64)


def low_cutoff() -> Iterator[Row]:
    """A slow cosine about 5 N, of which the reflected edges make an endless one: what becomes of it
    is what the polynomial says."""
    n, ratio = 80_001, 2e-5
    wave = np.cos(np.pi * np.arange(n) / (n - 1))
    s = 2.113917674904216j / (CASCADE_RATIO["bessel4"] * ratio * 2 * (n - 1))
    gain = abs(105 / (s**4 + 10 * s**3 + 45 * s**2 + 105 * s + 105)) ** 2
    x = 5 + wave

    def wrong(y: Samples, gain: float = gain) -> float:
        """Error as a share of the largest value; at most a million percent, also for NaN."""
        error = float(np.abs(np.nan_to_num(y, nan=np.inf) - 5 - gain * wave).max() / 6)
        return min(100 * error, 1e6)

    ours = wrong(low_pass(x, 1.0, ratio))
    butterworth_gain = 1 / (1 + (1 / (2 * (n - 1) * ratio)) ** 8)
    one_pass = 2 * ratio * CASCADE_RATIO["bessel4"]
    with np.errstate(all="ignore"):
        b, a = signal.butter(4, 2 * ratio)
        transfer = signal.filtfilt(b, a, x, padtype="even", padlen=n - 1)
        single = in_float32(signal.bessel(4, one_pass, norm="mag", output="sos"), x)
    pole = np.abs(np.roots(a)).max()
    for case, naive, note in (
        ("as a transfer function", wrong(transfer, butterworth_gain), f"a pole at {pole:.6f}, "),
        ("sections in float32", wrong(single), ""),
    ):
        yield compared(
            12, f"cutoff / rate = 2e-5, {case}", (naive, at_least(5)), (ours, at_most(1e-6)),
            "% of the largest value", note + "a slow cosine about 5 N, level and shape",
        )  # fmt: skip


def saturation() -> Row:
    t = np.arange(4000) / RATE
    limit = 5.0
    x = np.clip(6.5 * np.sin(2 * np.pi * 3 * t) + texture(t.size, 0.05), -limit, limit)
    d = butterworth(x)
    e = x - d
    step = np.abs(e).max() / 3
    naive = d + np.floor(e / step + 0.5) * step
    channel = force(x)
    decoded = {band: back(channel, "paper", band, bits=3).samples() for band in ("full", "lf")}
    exact = back(channel, "lossless")
    runs = int((np.abs(exact.stored) == 5000).sum())
    return compared(
        14, "sensor at its end, 5 N, 3 bits of HF",
        (1000 * (np.abs(naive).max() - limit), at_least(50)),
        (1000 * max(np.abs(y).max() - limit for y in decoded.values()), at_most(0)),
        "mN beyond the sensor", f"lossless keeps all {runs} samples at the end",
        held=runs == (np.abs(counts(x)) == 5000).sum(),
    )  # fmt: skip


def edges() -> Row:
    whole = 1 + 0.3 * np.sin(2 * np.pi * 0.7 * np.arange(30_000) / RATE) + texture(30_000, 0.15)
    truth = butterworth(whole)
    starts = np.arange(1000, 27_000, 130)
    odd, ours = (
        np.array([filtered(whole[a : a + 2000])[0] - truth[a] for a in starts])
        for filtered in (butterworth, lambda x: low_pass(x, RATE))
    )
    naive, good = (1000 * np.sqrt(np.mean(error**2)) for error in (odd, ours))
    return compared(
        17, "a recording that begins in the middle of a texture",
        (naive, at_least(100)), (good, at_most(40)), "mN rms at the start",
        "odd padding hangs the slow part on the first sample; ours is reflected",
    )  # fmt: skip


ROWS = (not_a_number, infinite, stiff_contact, low_cutoff, saturation, edges)
