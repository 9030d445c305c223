"""One large sample among small ones: rows 7, 8."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hapfmt.encoder.plan import without_glitches
from hapfmt.split import low_pass

from .filters import butterworth
from .row import Row, at_least, at_most, compared
from .signals import RATE, Samples, back, force, snr_db, texture

BITS = 5
MARGIN = 300
"""Samples on each side that are not asked for: what is slow reaches so far."""


def range_derived(x: Samples) -> Samples:
    """The paper's quantiser around a slow part of no error: 2^b - 1 levels from the residual's
    range."""
    d = butterworth(x)
    e = x - d
    step = np.abs(e).max() / (2 ** (BITS - 1) - 1)
    return np.asarray(d + np.floor(e / step + 0.5) * step)


def away_from(at: int, n: int) -> NDArray[np.bool_]:
    return np.asarray(np.abs(np.arange(n) - at) > MARGIN)


def tap() -> Iterator[Row]:
    n, at = 8000, 4000
    calm = 1 + texture(n, 0.03)
    hit = calm.copy()
    hit[at : at + 4] += np.array([1.2, 3.3, 2.1, 0.6])
    quiet = away_from(at, n)
    fine = calm - low_pass(calm, RATE)

    def snr(y: Samples, x: Samples) -> float:
        return snr_db(fine[quiet], (y - x)[quiet])

    step = f"{2 * np.abs(calm - butterworth(calm)).max() / 30:.3f}"
    naive = snr(range_derived(calm), calm), snr(range_derived(hit), hit)
    paper = [snr(back(force(x), "paper").samples(), x) for x in (calm, hit)]
    ours = [snr(back(force(x), "paper", step=step).samples(), x) for x in (calm, hit)]
    usual = [snr(back(force(x)).samples(), x) for x in (calm, hit)]
    yield compared(
        7, f"one tap in 8 s of texture, b = {BITS}", (naive[0] - naive[1], at_least(10)),
        (ours[0] - ours[1], at_most(1)), "dB lost everywhere",
        f"from {naive[0]:.1f} to {naive[1]:.1f} dB; ours, an explicit step of {step} N, "
        f"{ours[0]:.1f} and {ours[1]:.1f}; the range with preset paper, {paper[0]:.1f} "
        f"and {paper[1]:.1f}; preset perceptual {usual[0]:.1f} and {usual[1]:.1f}",
        held=usual[1] > 15,
    )  # fmt: skip


def glitch() -> Iterator[Row]:
    n, at = 8000, 4000
    calm = 1 + texture(n, 0.03)
    hit = calm.copy()
    hit[at] = 1000
    quiet = away_from(at, n)
    fine = calm - low_pass(calm, RATE)
    step = "0.01"
    naive = snr_db(fine[quiet], (range_derived(hit) - hit)[quiet])
    paper = snr_db(fine[quiet], (back(force(hit), "paper").samples() - hit)[quiet])
    explicit = back(force(hit), "paper", step=step).samples()
    yield compared(
        8, "one sample of 1 kN in 8 s of texture", (naive, at_most(1)),
        (snr_db(fine[quiet], (explicit - hit)[quiet]), at_least(18)), "dB away from it",
        f"explicit step of {step} N, the glitch itself by an escape; preset paper {paper:.1f} dB",
        held=abs(explicit[at] - 1000) <= 0.01,
    )  # fmt: skip
    usual, before = (back(force(x)).samples() for x in (hit, calm))
    default, calmer = (snr_db(fine[quiet], (y - calm)[quiet]) for y in (usual, before))
    yield compared(
        8, "one sample of 1 kN, nothing chosen", (naive, at_most(1)), (default, at_least(18)),
        "dB away from it", "preset perceptual: its floor is a share of the range without glitches; "
        f"{calmer:.1f} dB in a texture that has none", held=abs(usual[at] - 1000) < 1,
    )  # fmt: skip
    slow = low_pass(without_glitches(hit), RATE)
    plain = np.abs(butterworth(hit) - butterworth(calm)).max()
    yield compared(
        8, "one sample of 1 kN, the slow part that presets see", (plain, at_least(30)),
        (np.abs(slow - butterworth(calm)).max(), at_most(0.2)), "N too much",
        "a median of three before the filter, where a sample is beyond all others",
    )  # fmt: skip


ROWS = (tap, glitch)
