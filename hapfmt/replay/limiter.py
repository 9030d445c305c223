"""The last of all steps: counts within their limits, and close to the one before (PLY-002).

Integers only, so that no rounding, no value of a file and no fault above can get past it.
"""

from __future__ import annotations

from math import isfinite

from ..errors import ParameterError
from .profile.model import Actuator, CountLimits, Profile

COUNT_LIMIT = 2**53
"""Whole numbers up to here are exact as float64."""


def count_limits(profile: Profile, actuator: Actuator) -> CountLimits:
    """The limits of an actuator, refused where they do not bound it or let it never move."""
    try:
        limits = profile.limits(actuator)
    except (ArithmeticError, ValueError):  # not finite, or a step of zero
        limits = CountLimits(1, 0, 0, 0)
    low, high, rest, change = limits
    if not (
        -COUNT_LIMIT <= low <= rest <= high <= COUNT_LIMIT
        and change >= 1
        and actuator.step > 0
        and isfinite(actuator.maximum - actuator.minimum)
        and actuator.minimum <= actuator.rest <= actuator.maximum
    ):
        raise ParameterError(
            f"actuator {actuator.name!r} of profile {profile.name!r} has no usable limits: it needs"
            " minimum <= rest <= maximum, and a slew of one step a sample or more",
            requirement="PLY-001",
        )
    return limits


class Limiter:
    """Counts of one actuator, from rest on."""

    __slots__ = ("_high", "_low", "change", "count", "limited")

    def __init__(self, limits: CountLimits) -> None:
        self._low, self._high, self.count, self.change = limits
        self.limited = 0

    def __call__(self, wanted: int) -> int:
        """What is sent for it. ``count`` is in range, so a step towards the range stays in it."""
        if wanted > self._high:
            wanted = self._high
        elif wanted < self._low:
            wanted = self._low
        change = wanted - self.count
        if change > self.change:
            wanted = self.count + self.change
            self.limited += 1
        elif change < -self.change:
            wanted = self.count - self.change
            self.limited += 1
        self.count = wanted
        return wanted
