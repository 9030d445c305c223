"""Device samples -> places on a channel's grid of ticks, in exact rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from math import ceil, lcm, nextafter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

WIDE = 1 << 62
"""Sums below are taken in 64 bits."""
NOWHERE = 1 << 60
"""A tick that nothing covers: ticks end at 2^48."""
BELOW_ONE = nextafter(1.0, 0.0)


class Places(NamedTuple):
    """Sample i lies ``phases[i]`` (0 <= phase < 1) of a tick behind tick ``ticks[i]``."""

    ticks: NDArray[np.int64]
    phases: NDArray[np.float64]


class Grid:
    """Device sample n lies at ``start + n * step`` seconds, which is that times ``rate`` in ticks.

    Each sample is computed from its number, by integers, so that nothing adds up: ten hours in,
    the tick is the right one and the phase is rounded once.
    """

    def __init__(self, start: Fraction, step: Fraction, rate: Fraction) -> None:
        first, stride = start * rate, step * rate
        self.unit = lcm(first.denominator, stride.denominator)
        self.first = int(first * self.unit)
        self.stride = int(stride * self.unit)

    def tick(self, number: int) -> int:
        """The last tick that is not behind this sample."""
        return (self.first + number * self.stride) // self.unit

    def places(self, number: int, count: int) -> Places:
        """Of ``count`` samples from this one on."""
        tick, rest = divmod(self.first + number * self.stride, self.unit)
        if max(rest + count * self.stride, self.unit) < WIDE and tick < NOWHERE // 2:
            parts = rest + np.arange(count, dtype=np.int64) * self.stride
            ticks, rests = np.divmod(parts, self.unit)
            if self.unit <= 1 << 53:
                return Places(tick + ticks, rests / float(self.unit))
            return Places(tick + ticks, self.divided(rests.tolist()))
        pairs = [divmod(rest + i * self.stride, self.unit) for i in range(count)]
        far = [min(tick + ticks, NOWHERE) for ticks, _ in pairs]
        return Places(np.array(far, np.int64), self.divided([rest for _, rest in pairs]))

    def divided(self, rests: list[int]) -> NDArray[np.float64]:
        return np.array([min(rest / self.unit, BELOW_ONE) for rest in rests], np.float64)


def samples_in(seconds: Fraction, step: Fraction) -> int:
    """Device samples n with ``0 <= n * step < seconds``."""
    return max(ceil(seconds / step), 0)
