"""Spectral-temporal similarity ST-SIM of textures, through the package vibromaf (extra "metrics").

R. Hassen, E. Steinbach, "Subjective evaluation of the spectral temporal similarity (ST-SIM) measure
for vibrotactile quality assessment", IEEE Transactions on Haptics 13, 2020.
"""

from __future__ import annotations

from fractions import Fraction
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingExtraError, ParameterError

Doubles = NDArray[np.float64]

HIGH_PASS_HZ = 15.0
RATE_HZ = 8000
EDGE = 4096
BLOCK = 512
EXPONENT = 2 / 3
"""The perceptual curve of the measure is defined for 8 kHz; the edges hold the transients of both
filters."""

MOST = 1 << 15
"""Largest up- or downsampling factor. The filter of the polyphase resampling has 20 taps per unit
of the larger factor: 655 381 taps, 5 MB. The rate is off by 3e-5 at most."""

SILENT = 1e-9
"""A high-passed part below this share of the signal is rounding, not texture."""


class Similarity:
    """ST-SIM of decoded signals to one signal [ticks], finite float64 at ``rate_hz``.

    The signals pass a zero-phase high-pass (15 Hz, Butterworth of order 2). They are resampled to
    8 kHz by a polyphase filter (within 0.003 %). The first and last 4096 samples are dropped.
    """

    def __init__(self, f: Doubles, rate_hz: float | Fraction) -> None:
        if not long_enough(f.size, rate_hz):
            raise ParameterError("ST-SIM needs at least 1.088 s, at more than 30 Hz")
        self.f, self.rate_hz = f, rate_hz
        self.measure = vibromaf()
        self.reference = texture_8khz(f, rate_hz)

    def __call__(self, y: Doubles) -> float:
        """0 or more; 1 where y equals f."""
        if np.array_equal(self.f, y):
            return 1.0
        distorted = texture_8khz(y, self.rate_hz)
        if not (np.any(self.reference) and np.any(distorted)):
            return float(np.any(self.reference) == np.any(distorted))
        # A silent block has the spectrum -inf dB, which the measure allows.
        with np.errstate(divide="ignore"):
            similarity = self.measure(distorted, self.reference, eta=EXPONENT)
        # A negative mean correlation gives a complex number.
        return 0.0 if isinstance(similarity, complex) else float(similarity)


def vibromaf() -> Any:
    """The function of the package."""
    try:
        return import_module("vibromaf.metrics.stsim").st_sim
    except ImportError as error:
        raise MissingExtraError("vibromaf", "metrics") from error


def resampling_8khz(rate_hz: float | Fraction) -> Fraction:
    """8 kHz / ``rate_hz``, neither its numerator nor its denominator above :data:`MOST`, and within
    a share of 1 / ``MOST`` of exact."""
    exact = RATE_HZ / Fraction(rate_hz)
    return exact.limit_denominator(max(int(MOST / max(exact, Fraction(1))), 1))


def long_enough(size: int, rate_hz: float | Fraction) -> bool:
    """Whether samples of this rate have an ST-SIM: one block and both edges."""
    return rate_hz > 2 * HIGH_PASS_HZ and size * resampling_8khz(rate_hz) >= BLOCK + 2 * EDGE


def texture_8khz(x: Doubles, rate_hz: float | Fraction) -> Doubles:
    from scipy import signal

    ratio = resampling_8khz(rate_hz)
    sections = signal.butter(2, HIGH_PASS_HZ, "highpass", fs=float(rate_hz), output="sos")
    texture = np.asarray(signal.sosfiltfilt(sections, x))
    if np.max(np.abs(texture)) <= SILENT * np.max(np.abs(x)):
        texture = np.zeros_like(texture)
    resampled = signal.resample_poly(texture, ratio.numerator, ratio.denominator)
    return np.asarray(resampled[EDGE:-EDGE])
