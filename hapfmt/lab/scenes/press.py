"""A hand that comes down on something, stays, goes up, and does it again."""

from __future__ import annotations

import numpy as np

from .description import Press
from .waves import Floats, Grid, Repeats, Waves, minimum_jerk

UNEVEN = 0.02
"""How much a force that is held wanders (rms)."""


class PressMotion:
    def __init__(self, press: Press, grid: Grid, rng: np.random.Generator) -> None:
        self.what = press
        seconds = grid.ticks / grid.rate_hz
        self.again = Repeats(rng, seconds, press.every_s, 2 * press.travel_s + press.hold_s)
        self.wander = Waves(rng, 0.3, 3)

    def height(self, t: Floats, compliance: float) -> Floats:
        """As :meth:`hapfmt.lab.scenes.stroke.StrokeMotion.height`."""
        number, since = self.again.at(t)
        travel, hold = self.what.travel_s, self.what.hold_s
        down = minimum_jerk(since / travel) - minimum_jerk((since - travel - hold) / travel)
        press = self.what.press_n * self.again.strength[number] * (1 + UNEVEN * self.wander.at(t))
        return np.asarray(self.what.lift_m - (self.what.lift_m + press * compliance) * down)
