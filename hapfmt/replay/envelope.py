"""Soft start and soft stop: a phase that moves by one a sample, a raised cosine (PLY-003).

An envelope that falls goes on to the ground before it rises again, so a short gap, a pause that is
taken back at once or a seek give the same slow way down and up as a long one.
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil, cos, pi

from ..numbers import exact


def ramp_samples(seconds: float, rate: Fraction) -> int:
    """Two at least: one value between rest and signal. 0.05 s are 50 ms, as the profile says, not
    what the float of it is."""
    return max(2, ceil(exact(seconds) * rate))


class Envelope:
    """Of one actuator. ``phase``: 0 at rest, ``length`` at the full signal."""

    __slots__ = ("_top", "falling", "length", "phase")

    def __init__(self, length: int) -> None:
        self.length = length
        self.phase = 0
        self.falling = False
        self._top = 1.0

    def shape(self) -> float:
        return (1 - cos(pi * self.phase / self.length)) / 2

    def rise(self) -> float:
        """What part of the signal this sample is."""
        if self.phase == self.length:
            return 1.0
        self.phase += 1
        return self.shape()

    def fall(self) -> float:
        """What is left in this sample of the value that the fall began with."""
        if not self.falling:
            self.falling = True
            self._top = self.shape()
        if self.phase:
            self.phase -= 1
        return self.shape() / self._top if self._top else 0.0
