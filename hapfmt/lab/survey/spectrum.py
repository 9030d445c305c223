"""Power spectral density by Welch's method, part by part.

P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE
Transactions on Audio and Electroacoustics 15, 1967, 10.1109/TAU.1967.1161901.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SEGMENT_S = 2.0
"""Half a hertz between lines: the LF part below 20 Hz is resolved."""
SHORTEST, LONGEST = 16, 1 << 14
"""Samples of a segment."""
SAMPLES = 1 << 20
"""Of one channel that are looked at, spread over the whole; the estimate is no better for more."""


class Spectrum:
    """Of runs of [samples] values, Hann window, half overlapping segments without their means."""

    def __init__(self, rate_hz: float, sample_count: int) -> None:
        """sample_count: how many will come, about."""
        self.rate_hz = rate_hz
        size = 1 << max(round(np.log2(max(SEGMENT_S * rate_hz, 1))), 0)
        size = min(size, 1 << max(sample_count // 4, 1).bit_length() - 1)
        self.size = int(min(max(size, SHORTEST), LONGEST))
        self.share = min(1.0, SAMPLES / max(sample_count, 1))
        self.power: NDArray[np.float64] = np.zeros(self.size // 2 + 1)
        self.segments = 0

    def add(self, run: NDArray[np.float64]) -> None:
        """A run without a gap; one that is shorter than a segment says nothing."""
        take = max(self.size, int(run.size * self.share))
        x = run[:take]
        if x.size < self.size or not np.isfinite(x).all():
            return
        from scipy import signal

        count = (x.size - self.size) // (self.size // 2) + 1
        with np.errstate(all="ignore"):
            _, power = signal.welch(x, self.rate_hz, nperseg=self.size)
        self.power += count * power
        self.segments += count

    def density(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Hertz [lines] above 0, and unit^2 / Hz [lines]; None where nothing was long enough."""
        if not self.segments:
            return None
        hertz = np.arange(1, self.power.size, dtype=np.float64) * (self.rate_hz / self.size)
        return hertz, self.power[1:] / self.segments
