"""A hand that moves a tool through the air, from point to point."""

from __future__ import annotations

import numpy as np

from .description import Reach
from .waves import Floats, Grid, Repeats, minimum_jerk


class ReachMotion:
    def __init__(self, reach: Reach, grid: Grid, rng: np.random.Generator) -> None:
        self.what = reach
        seconds = grid.ticks / grid.rate_hz
        self.again = Repeats(rng, seconds, reach.every_s, reach.travel_s)
        half = reach.extent_m / 2
        self.points = rng.uniform(-half, half, (self.again.count + 1, 3))

    def along(self, axis: int, t: Floats) -> Floats:
        """Where the hand is, in metres, on axis 0, 1 or 2."""
        number, since = self.again.at(t)
        point = self.points[:, axis]
        moved = minimum_jerk(since / self.what.travel_s)
        return np.asarray(point[number] + (point[number + 1] - point[number]) * moved)
