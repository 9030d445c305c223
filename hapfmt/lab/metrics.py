"""Measures of the error between an original f and its reconstruction y.

The measures disagree, so report them together. Noise that is shaped like the texture has a poor
signal-to-noise ratio but matching band energies; a shifted click is the opposite case. All
functions take finite float64 arrays, [ticks] or [ticks, components], of equal shape and unit. They
return one number over all components.
"""

from __future__ import annotations

from fractions import Fraction
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..deadband import Deadband
from ..errors import MissingExtraError, ParameterError

SPLIT_HZ = 20.0
"""The HF part, whose variance is the signal of :func:`snr_hf_db`, begins here."""

BAND_BLOCK_S = 0.128
BAND_COUNT = 10
"""Blocks and bands of :func:`band_energy_error_db`. 0.128 s resolve 7.8 Hz, so that ten bands from
20 Hz to 500 Hz hold a line each; at this length the band energies of a recorded texture itself vary
by 1.7 dB over 0.5 s."""

BAND_FLOOR = 1e-6
"""Added to each band energy, relative to the largest in f: -60 dB, so that silence compares."""

ST_SIM_HIGH_PASS_HZ = 15.0
ST_SIM_RATE_HZ = 8000
ST_SIM_EDGE = 4096
ST_SIM_BLOCK = 512
ST_SIM_EXPONENT = 2 / 3
"""Protocol of :func:`st_sim`: the perceptual curve of the measure is defined for 8 kHz; the edges
hold the transients of both filters."""

ST_SIM_MOST = 1 << 15
"""Largest up- or downsampling factor of :func:`st_sim`. The filter of the polyphase resampling has
20 taps per unit of the larger factor: 655 381 taps, 5 MB. The rate is off by 3e-5 at most."""

_SILENT = 1e-9
"""A high-passed part below this share of the signal is rounding, not texture."""


def max_error(f: NDArray[Any], y: NDArray[Any]) -> float:
    """Largest ``|f - y|``; 0 without samples, infinity where it is beyond float64."""
    a, b = _pair(f, y)
    with np.errstate(over="ignore"):
        return float(np.max(np.abs(a - b), initial=0.0))


def rmse(f: NDArray[Any], y: NDArray[Any]) -> float:
    """Root of the mean squared error; 0 without samples, infinity where an error is infinite."""
    a, b = _pair(f, y)
    with np.errstate(over="ignore"):
        return _rms(a - b)


def snr_hf_db(
    f: NDArray[Any], y: NDArray[Any], rate_hz: float, split_hz: float = SPLIT_HZ
) -> float:
    """10 log10 of the variance of f above ``split_hz`` over the mean squared error of y.

    The error is that of the full band: what the LF part loses counts as noise. Infinity where y
    equals f, also without samples; minus infinity where f has no HF part and y differs.
    """
    from ..encoder.split import low_pass

    a, b = _scaled(f, y)
    noise = _rms(a - b)
    if noise == 0:
        return float("inf")
    texture = _drop_rounding(a - low_pass(a, rate_hz, split_hz), a)
    level = _rms(texture - texture.mean(axis=0))
    return float(20 * (np.log10(level) - np.log10(noise))) if level else float("-inf")


def share_outside(deadband: Deadband, x: NDArray[Any], y: NDArray[Any]) -> float:
    """Share of the samples (vector mode: of the ticks) outside the deadband, in [0, 1]; 0 of none.

    x, y: integers in counts, [ticks] or [ticks, components].
    """
    outside = deadband.outside(x, y)
    return float(np.mean(outside)) if outside.size else 0.0


def band_energy_error_db(f: NDArray[Any], y: NDArray[Any], rate_hz: float) -> float:
    """Mean ``|10 log10(energy of y / energy of f)|`` over blocks and bands, in dB.

    Blocks of 128 ms with a Hann window, end to end, each without its mean; what does not fill a
    block at the end is left out, unless it is all there is. Ten bands of equal ratio from 20 Hz (at
    rates below 400 Hz from a twentieth of the rate) to the Nyquist rate; a band that no
    line of the spectrum falls into is left out. 0 without samples and where y equals f.
    """
    if not rate_hz > 0:
        raise ParameterError("a metric needs a positive rate")
    a, b = _scaled(f, y)
    n = a.shape[0]
    size = min(max(round(BAND_BLOCK_S * rate_hz), 4), n)
    if size < 4 or np.array_equal(a, b):
        return 0.0
    lines = np.fft.rfftfreq(size, 1 / rate_hz)
    edges = np.geomspace(min(SPLIT_HZ, rate_hz / 20), rate_hz / 2, BAND_COUNT + 1)
    band = np.searchsorted(edges, lines, side="right") - 1
    band[-1] = min(band[-1], BAND_COUNT - 1)
    members = np.stack([band == k for k in np.unique(band[band >= 0])]).astype(np.float64)

    def energies(x: NDArray[np.float64]) -> NDArray[np.float64]:
        blocks = x[: n // size * size].reshape(n // size, size, -1)
        window = np.hanning(size + 1)[:size, np.newaxis]
        spectrum = np.fft.rfft((blocks - blocks.mean(axis=1, keepdims=True)) * window, axis=1)
        return np.asarray(np.einsum("kf,bfc->bkc", members, np.abs(spectrum) ** 2))

    of_f, of_y = energies(a), energies(b)
    floor = BAND_FLOOR * of_f.max() or BAND_FLOOR * of_y.max() or 1.0
    return float(np.mean(np.abs(10 * np.log10((of_y + floor) / (of_f + floor)))))


def st_sim(f: NDArray[Any], y: NDArray[Any], rate_hz: float | Fraction) -> float:
    """Spectral-temporal similarity ST-SIM of two [ticks] signals, 0 or more; 1 where y equals f.

    The package vibromaf (extra "metrics") computes it. Before that, the signals pass a zero-phase
    high-pass (15 Hz, Butterworth of order 2). They are resampled to 8 kHz by a polyphase filter
    (within 0.003 %, see :func:`resampling_8khz`). The first and last 4096 samples are dropped.

    If the mean correlation is negative, the package gives a complex number; it counts as 0. Two
    signals without texture give 1; a signal without texture and one with texture give 0. The unit
    matters: the measure weighs each spectrum with its own perceptual threshold. Both terms are
    projections on f, divided by the energy of f alone. So a y with slightly more energy gives more
    than 1 (1.014 was observed).
    ParameterError if fewer than 512 samples (the block of the measure) are left: below 1.088 s.

    R. Hassen, E. Steinbach, "Subjective evaluation of the spectral temporal similarity (ST-SIM)
    measure for vibrotactile quality assessment", IEEE Transactions on Haptics 13, 2020.
    """
    a, b = _pair(f, y)
    if a.ndim != 1:
        raise ParameterError("ST-SIM compares single channels, [ticks]")
    if np.array_equal(a, b):
        return 1.0
    try:
        measure = import_module("vibromaf.metrics.stsim").st_sim
    except ImportError as error:
        raise MissingExtraError("vibromaf", "metrics") from error
    reference, distorted = (_texture_8khz(x, rate_hz) for x in (a, b))
    if not (np.any(reference) and np.any(distorted)):
        return float(np.any(reference) == np.any(distorted))
    # A silent block has the spectrum -inf dB, which the measure allows.
    with np.errstate(divide="ignore"):
        similarity = measure(distorted, reference, eta=ST_SIM_EXPONENT)
    return 0.0 if isinstance(similarity, complex) else float(similarity)


def resampling_8khz(rate_hz: float | Fraction) -> Fraction:
    """The ratio that :func:`st_sim` resamples by: 8 kHz / ``rate_hz``, neither its numerator nor
    its denominator above :data:`ST_SIM_MOST`, and within a share of 1 / ``ST_SIM_MOST`` of exact.
    """
    exact = ST_SIM_RATE_HZ / Fraction(rate_hz)
    return exact.limit_denominator(max(int(ST_SIM_MOST / max(exact, Fraction(1))), 1))


def _texture_8khz(x: NDArray[np.float64], rate_hz: float | Fraction) -> NDArray[np.float64]:
    from scipy import signal

    ratio = resampling_8khz(rate_hz)
    left = x.size * ratio - 2 * ST_SIM_EDGE
    if rate_hz <= 2 * ST_SIM_HIGH_PASS_HZ or left < ST_SIM_BLOCK:
        raise ParameterError("ST-SIM needs at least 1.088 s, at more than 30 Hz")
    sections = signal.butter(2, ST_SIM_HIGH_PASS_HZ, "highpass", fs=float(rate_hz), output="sos")
    texture = _drop_rounding(np.asarray(signal.sosfiltfilt(sections, x)), x)
    resampled = signal.resample_poly(texture, ratio.numerator, ratio.denominator)
    return np.asarray(resampled[ST_SIM_EDGE:-ST_SIM_EDGE])


def _pair(f: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    a, b = np.asarray(f, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if a.shape != b.shape:
        raise ParameterError(f"a metric compares equal shapes, not {a.shape} and {b.shape}")
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(b))):
        raise ParameterError("a metric needs finite samples; compare span by span")
    return a, b


def _scaled(f: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Both times one power of two, at most 1/2 in magnitude, for measures of ratios."""
    a, b = _pair(f, y)
    largest = max(float(np.max(np.abs(x), initial=0.0)) for x in (a, b))
    exponent = -int(np.frexp(largest)[1]) - 1
    return np.ldexp(a, exponent), np.ldexp(b, exponent)


def _rms(x: NDArray[np.float64]) -> float:
    """Root mean square of all elements of any size; 0 without elements."""
    largest = float(np.max(np.abs(x), initial=0.0))
    return (
        largest * float(np.sqrt(np.mean((x / largest) ** 2))) if 0 < largest < np.inf else largest
    )


def _drop_rounding(texture: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    silent = np.max(np.abs(texture), axis=0) <= _SILENT * np.max(np.abs(whole), axis=0)
    return np.where(silent, 0.0, texture)
