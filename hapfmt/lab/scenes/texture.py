"""The height under a tip that moves over a surface, as the tip feels it: smoothed by its size."""

from __future__ import annotations

from math import ceil

import numpy as np

from .description import Texture
from .heightfields import SURFACES
from .stroke import StrokeMotion
from .waves import Floats, Grid
from .work import Work

TIP_M = 25e-6
TIP_SLOPE_M = 400e-6
"""Gaussian widths (standard deviation along the path): of the contact patch, that smooths the
height; and of the ball of the tip, that bridges slopes shorter than itself."""


class Profile:
    """Heights along the whole path: 8 bytes a step are kept, since their mean lies at 0."""

    def __init__(
        self,
        texture: Texture,
        motion: StrokeMotion,
        grid: Grid,
        rng: np.random.Generator,
        work: Work,
    ) -> None:
        surface = SURFACES[texture.surface](rng)
        self.grid = grid
        self.heights = np.empty(grid.steps)
        for start, stop in grid.blocks():
            x, y = motion.path(grid.times(start, stop))
            self.heights[start:stop] = surface(x, y)
        work.height_count += grid.steps
        self.heights -= self.heights.mean()
        if texture.relief != 1:
            self.heights *= texture.relief
        mean_speed = float(np.mean(motion.stroke.speed_m_per_s))
        self.tip, self.ball = (gaussian(width / (mean_speed * grid.dt_s)) for width in
                               (TIP_M, TIP_SLOPE_M))  # fmt: skip

    def surface(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Height under the tip in metres, and how fast it rises, m/s, at steps [start, stop)."""
        return self._felt(self.tip, start, stop)

    def rise(self, start: int, stop: int) -> Floats:
        """m/s that the ball of the tip rises with."""
        return self._felt(self.ball, start, stop)[1]

    def _felt(self, kernel: Floats, start: int, stop: int) -> tuple[Floats, Floats]:
        first, last = max(start - 1, 0), min(stop + 1, self.grid.steps)
        height = self._smooth(kernel, first, last)
        rise = np.gradient(height, self.grid.dt_s) if height.size > 1 else np.zeros(1)
        rows = slice(start - first, stop - first)
        return height[rows], np.asarray(rise[rows])

    def _smooth(self, kernel: Floats, start: int, stop: int) -> Floats:
        """Edges held."""
        reach = len(kernel) // 2
        first, last = max(start - reach, 0), min(stop + reach, self.grid.steps)
        missing = first - (start - reach), stop + reach - last
        around = np.pad(self.heights[first:last], missing, mode="edge")
        return np.convolve(around, kernel, mode="valid")


def gaussian(sigma: float) -> Floats:
    """A kernel of sum 1, out to four standard deviations."""
    reach = ceil(4 * sigma)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(kernel / kernel.sum())
