"""Splits a recorded signal into its slow and its fast part: a zero-phase low-pass.

The split is the encoder's choice, never part of the format. The residual is formed against the LF
part as decoded, so the split itself loses nothing.

Filters. The default is Bessel of order 4. Its step response undershoots by 0.33 % before a stiff
contact (0 to 3.3 N within a sample, 1 kHz, 20 Hz), which the clamp removes. The slow part begins
(10 mN) 16 ms early. Butterworth of order 2, 4, 8 would undershoot by 3.4, 6.8, 8.3 %: a replay
would push before the touch. Butterworth of order 1 never undershoots, begins 26 ms early, and
separates less.
"""

from __future__ import annotations

from functools import lru_cache
from math import atan, ceil, isfinite, pi, sqrt, tan
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .errors import ParameterError
from .kernels import compiled

Filter = Literal["bessel4", "butter1"]

LF_CUTOFF_HZ = 20.0
"""Where the quasi-static force ends and texture begins: the split of F. Brandi, R. Chaudhari,
E. Steinbach, "Texture compensation for haptic feedback signal compression", VECIMS 2011,
https://doi.org/10.1109/VECIMS.2011.6053837.

The rate of an encoded texture is flat within 5 % for cutoffs of 10-30 Hz (measured), so the value
is not critical."""


def split_text(cutoff_hz: float = LF_CUTOFF_HZ) -> str:
    """How the ratio of a texture is measured, for people; other filters give other figures."""
    return f"dB above {cutoff_hz:g} Hz (zero-phase Bessel filter of order 4), over all errors"


_BESSEL4_HALF = 2.113917674904216
"""w with |H(jw)|^2 = 1/2 for the Bessel polynomial s^4 + 10s^3 + 45s^2 + 105s + 105."""

_BESSEL4_ROOT = 1.527528683698402
"""w with |H(jw)|^2 = 1/sqrt(2) for the same polynomial."""

_PROTOTYPE: dict[Filter, tuple[tuple[complex, ...], float]] = {
    "bessel4": (
        (
            -0.995208764350272 + 1.257105739454664j,
            -1.3700678305514422 + 0.41024971749375155j,
            -1.3700678305514422 - 0.41024971749375155j,
            -0.995208764350272 - 1.257105739454664j,
        ),
        5.258199010244144,
    ),
    "butter1": ((-1 + 0j,), 1.0),
}
"""Poles, and their product, of the analog filter that is 3 dB down at 1 rad/s. Those of Bessel are
the roots of its polynomial, divided by _BESSEL4_HALF."""

CASCADE_RATIO: dict[Filter, float] = {
    "bessel4": _BESSEL4_HALF / _BESSEL4_ROOT,
    "butter1": 1 / sqrt(sqrt(2) - 1),
}
"""-3 dB frequency of one pass over that of two: forward and backward, each pass may only take
1.5 dB off at the cutoff."""

PADDING_PERIODS = 3
"""Reflected padding in periods of the cutoff: the slowest pole of either filter has then decayed to
exp(-3 * 2 * pi * 1.38 * 0.995) < 1e-11."""

PADDING_LEAST = 64
"""... and at least this many samples, since near the Nyquist rate a pole turns slower than that."""

FAST = sorted(factor << shift for factor in (2, 3, 5) for shift in range(48))
"""Half lengths of Fourier transforms that take little time."""

SECTIONS_RATIO = 1e-4
"""Below this cutoff / rate the cosine transform takes the place of second-order sections, which
lose digits: 5e-11 of the largest value here, 2e-9 at 2e-5, 2e-7 at 2e-6 (Bessel, measured)."""


def low_pass(
    x: NDArray[Any],
    rate_hz: float,
    cutoff_hz: float = LF_CUTOFF_HZ,
    *,
    filter: Filter = "bessel4",
    median3: bool = False,
) -> NDArray[np.float64]:
    """The slow part of x, same shape, without delay, within [min x, max x] of each column.

    x
        [ticks] or [ticks, components], finite real numbers of any unit and of any size up to the
        largest float64: each column is scaled by a power of two first, which is exact. Gaps are
        the caller's: pass one span, or bridge them.
    cutoff_hz
        where forward and backward pass together take 3.01 dB off (each pass is designed
        CASCADE_RATIO higher for that). At the Nyquist rate and above the result is a copy of x.
    median3
        the median of each three neighbours goes into the filter, so that a glitch of one sample
        (1 kN in a signal of 1 N) does not draw the slow part with it.

    The edges are continued by reflection (even: x2 x1 | x0 x1 x2), endlessly where x is short.
    Signals shorter than the padding, and cutoffs below SECTIONS_RATIO, are filtered in the domain
    of the type-1 cosine transform. The response is the same: that is forward-backward filtering of
    an endless reflection. It is exact at any ratio, without a state that could go unstable.
    """
    if not (isfinite(rate_hz) and rate_hz > 0 and cutoff_hz > 0):
        raise ParameterError("a low-pass needs a positive rate and a positive cutoff")
    if filter not in CASCADE_RATIO:
        raise ParameterError(
            f"no low-pass is called {filter!r}; there are: {', '.join(CASCADE_RATIO)}"
        )
    y = np.array(x, dtype=np.float64)
    if not np.all(np.isfinite(y)):
        raise ParameterError("a low-pass needs finite samples; bridge the gaps first")
    n = y.shape[0]
    if n < 3 or 2 * cutoff_hz >= rate_hz:
        return y
    if median3:
        y[1:-1] = np.maximum(
            np.minimum(y[:-2], y[1:-1]), np.minimum(np.maximum(y[:-2], y[1:-1]), y[2:])
        )
    low, high = y.min(axis=0), y.max(axis=0)
    _, exponent = np.frexp(np.maximum(-low, high))
    y = np.ldexp(y, -exponent)
    ratio = float(cutoff_hz) / float(rate_hz)
    padding = max(ceil(PADDING_PERIODS / ratio), PADDING_LEAST) if ratio >= SECTIONS_RATIO else n
    y = _by_sections(y, ratio, filter, padding) if padding < n else _by_cosines(y, ratio, filter)
    with np.errstate(over="ignore"):  # overshoot beyond the largest float64, which the clamp ends
        return np.clip(np.ldexp(y, exponent), low, high)


def _pass_cutoff(ratio: float, filter: Filter) -> float:
    """-3 dB of one pass, in cycles per sample: bilinear, so the correction is one of tangents."""
    return atan(CASCADE_RATIO[filter] * tan(pi * ratio)) / pi


def _by_sections(
    y: NDArray[np.float64], ratio: float, filter: Filter, padding: int
) -> NDArray[np.float64]:
    """Forward, then backward; each pass begins as if its first value had lasted forever."""
    sections, steady = _pass(_pass_cutoff(ratio, filter), filter)
    rows = y.reshape(y.shape[0], -1).T
    ends = rows[:, padding:0:-1], rows[:, -2 : -padding - 2 : -1]
    rows = np.concatenate((ends[0], rows, ends[1]), axis=1)
    for _ in range(2):
        rows = filtered(sections, steady * rows[:, :1, None], rows)[:, ::-1]
    return np.ascontiguousarray(rows[:, padding:-padding].T).reshape(y.shape)


def filtered(
    sections: NDArray[np.float64], state: NDArray[np.float64], rows: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Each row [ticks] through all sections, from its state.

    rows, state
        [columns, ticks] and [columns, sections, 2].

    sections
        [sections, 6]: b0, b1, b2, 1, a1, a2, each a direct form II, transposed.
    """
    if compiled is None:
        return filtered_plain(sections, state, rows)
    out = np.array(rows, order="C")
    if out.size:
        compiled.filter_sections(sections, np.ascontiguousarray(state), out)
    return out


def filtered_plain(
    sections: NDArray[np.float64], state: NDArray[np.float64], rows: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What :func:`filtered` does, to be read."""
    out = np.empty(rows.shape)
    for column, row in enumerate(rows.tolist()):
        for section, held in zip(sections.tolist(), state[column].tolist(), strict=True):
            (b0, b1, b2, _, a1, a2), (first, second) = section, held
            for n, given in enumerate(row):
                made = b0 * given + first
                first = b1 * given - a1 * made + second
                second = b2 * given - a2 * made
                row[n] = made
        out[column] = row
    return out


@lru_cache(maxsize=8)
def _sections(cutoff: float, filter: Filter) -> NDArray[np.float64]:
    """[sections, 6] of one pass, -3 dB at ``cutoff`` cycles per sample: bilinear. The pair of poles
    that is nearest to the unit circle comes last."""
    poles, gain = _PROTOTYPE[filter]
    warped = 4 * float(np.tan(pi * cutoff))
    analog = warped * np.array(poles)
    gain = gain * warped ** len(poles) * float((1 / np.prod(4 - analog)).real)
    moved = (4 + analog) / (4 - analog)
    if len(poles) == 1:
        sections = np.array([[1, 1, 0, 1, -moved[0].real, 0]])
    else:
        pairs = sorted(moved[moved.imag > 0], key=lambda z: -abs(1 - abs(z)))
        sections = np.array(
            [[1, 2, 1, 1, -2 * z.real, z.real * z.real + z.imag * z.imag] for z in pairs]
        )
    sections[0, :3] *= gain
    return sections


@lru_cache(maxsize=8)
def _pass(cutoff: float, filter: Filter) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The sections, and the state of each after ones from the beginning of time."""
    sections = _sections(cutoff, filter)
    return sections, _steady(sections)


def _steady(sections: NDArray[np.float64]) -> NDArray[np.float64]:
    """The state [sections, 2] after ones from the beginning of time."""
    states, scale = [], 1.0
    for b0, b1, b2, _, a1, a2 in sections:
        state = np.linalg.solve([[1 + a1, -1], [a2, 1]], [b1 - a1 * b0, b2 - a2 * b0])
        states.append(scale * state)
        scale *= (b0 + b1 + b2) / (1 + a1 + a2)
    return np.array(states)


def _by_cosines(y: NDArray[np.float64], ratio: float, filter: Filter) -> NDArray[np.float64]:
    """By the cosine transform of type 1: a Fourier transform of the signal and its reflection."""
    n = y.shape[0]
    gain = _gain(n, ratio, filter).reshape((n,) + (1,) * (y.ndim - 1))
    lines = np.fft.rfft(_reflected(y), axis=0).real * gain
    return np.fft.rfft(_reflected(lines), axis=0, norm="forward").real


def _reflected(y: NDArray[np.float64]) -> NDArray[np.float64]:
    """One period of the endless reflection of y [n, ...]."""
    return np.concatenate([y, y[-2:0:-1]])


def slow_for_telling(
    x: NDArray[np.float64], rate_hz: float, cutoff_hz: float = LF_CUTOFF_HZ
) -> NDArray[np.float64]:
    """The slow part of counts, [ticks, components], against which texture is judged.

    It is that of :func:`low_pass`, by the cosines of any length. Up to a cutoff of a fifth of the
    rate both are within 1e-11 of the largest count; beyond, edges are less alike.
    """
    n, ratio = x.shape[0], float(cutoff_hz) / float(rate_hz)
    if n < 3 or 2 * cutoff_hz >= rate_hz:
        return x.copy()
    padding = max(ceil(PADDING_PERIODS / ratio), PADDING_LEAST)
    if padding < n:
        # Reflected further, to a length that is transformed fast.
        longer = next(size + 1 for size in FAST if size + 1 >= n + padding)
        x = np.pad(x, [(0, longer - n), *[(0, 0)] * (x.ndim - 1)], mode="reflect")
    length = x.shape[0]
    spectrum = np.fft.rfft(_reflected(x), axis=0)
    spectrum *= _gain_for_telling(length, ratio).reshape((length,) + (1,) * (x.ndim - 1))
    slow = np.fft.irfft(spectrum, 2 * (length - 1), axis=0)[:n]
    return np.clip(slow, x.min(axis=0), x.max(axis=0))


@lru_cache(maxsize=2)
def _gain_for_telling(n: int, ratio: float) -> NDArray[np.float64]:
    """The stretches of a recording are mostly of one length and rate."""
    return _gain(n, ratio, "bessel4")


def _gain(n: int, ratio: float, filter: Filter) -> NDArray[np.float64]:
    """The gain of both passes together, at the n frequencies of a cosine transform of type 1."""
    frequency = np.arange(n) / (2 * (n - 1))
    # 1e-280 and 1e30 keep the powers below finite; the gain there is 1 or far below one rounding.
    cutoff = tan(pi * _pass_cutoff(max(ratio, 1e-280), filter))
    w = np.minimum(np.tan(pi * frequency) / cutoff, 1e30)
    if filter == "bessel4":
        s = (w * _BESSEL4_HALF) ** 2
        gain = 105**2 / ((s * s - 45 * s + 105) ** 2 + s * (105 - 10 * s) ** 2)
    else:
        gain = 1 / (1 + w * w)
    return np.asarray(gain)
