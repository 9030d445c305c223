"""Textured surfaces: the height along a path, in metres, for stone, sand and cork.

Each surface is an unbounded function of the plane, drawn once from its generator. The height at a
point does not depend on the other points requested. The height under a tip is smoothed by the size
of the tip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import ceil

import numpy as np
from numpy.typing import NDArray

from .description import Texture, Work
from .motion import Floats, StepGrid, StrokeMotion

Heights = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""x and y in metres, [points] each, to heights in metres, [points]."""

STONE_WAVES = 96
STONE_SHORTEST_M = 0.25e-3
STONE_LONGEST_M = 8e-3
STONE_RMS_M = 110e-6
STONE_HURST = 0.8
"""Fractal stone: waves in all directions, their amplitudes proportional to wavelength**Hurst, at
equal steps of log wavelength: a self-affine surface with Hurst exponent 0.8, as fractured rock
has."""

SAND_GRAIN_M = 0.5e-3
SAND_JITTER = 0.35
SAND_RADII = (0.7, 1.25)
SAND_RELIEF = 0.6
"""Grains of medium sand (0.25-0.5 mm, and some above, in the sense of ISO 14688): spheres on a
jittered grid, glued down so that a fraction of each radius protrudes."""

CORK_CELL_M = 2.2e-3
CORK_WALL_M = 0.2e-3
CORK_DEPTH_M = 300e-6
CORK_TILT_M = 40e-6
"""Agglomerated cork: granules of about 2 mm with grooves between them, each at a height of its own.
A Worley (cellular) texture: the groove is where the nearest two granules are equally far."""

_TABLE = 64
"""Cells repeat after 64 x 64: 35 mm of sand, 140 mm of cork."""


def stone(rng: np.random.Generator) -> Heights:
    wavelength = np.geomspace(STONE_SHORTEST_M, STONE_LONGEST_M, STONE_WAVES)
    direction = rng.uniform(0, 2 * np.pi, STONE_WAVES)
    phase = rng.uniform(0, 2 * np.pi, STONE_WAVES)
    amplitude = wavelength**STONE_HURST
    amplitude *= STONE_RMS_M / np.sqrt(np.sum(amplitude**2) / 2)
    kx, ky = 2 * np.pi / wavelength * np.array([np.cos(direction), np.sin(direction)])

    def heights(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.zeros_like(x)
        for wave in range(STONE_WAVES):
            out += amplitude[wave] * np.cos(kx[wave] * x + ky[wave] * y + phase[wave])
        return out

    return heights


def sand(rng: np.random.Generator) -> Heights:
    cells = _Cells(rng, SAND_JITTER)
    size = rng.uniform(*SAND_RADII, (_TABLE, _TABLE)) * SAND_GRAIN_M / 2

    def heights(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        top = np.zeros_like(x)
        for distance_sq, cell in cells.around(x / SAND_GRAIN_M, y / SAND_GRAIN_M):
            radius = size[cell]
            above_sq = radius**2 - distance_sq * SAND_GRAIN_M**2
            cap = np.sqrt(np.maximum(above_sq, 0)) - radius * (1 - SAND_RELIEF)
            np.maximum(top, cap, out=top)
        return top

    return heights


def cork(rng: np.random.Generator) -> Heights:
    cells = _Cells(rng, 0.5)
    level = rng.normal(0, CORK_TILT_M, (_TABLE, _TABLE))

    def heights(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        nearest = np.full_like(x, np.inf)
        second = np.full_like(x, np.inf)
        height = np.zeros_like(x)
        for distance_sq, cell in cells.around(x / CORK_CELL_M, y / CORK_CELL_M):
            closer = distance_sq < nearest
            second = np.where(closer, nearest, np.minimum(second, distance_sq))
            nearest = np.where(closer, distance_sq, nearest)
            height = np.where(closer, level[cell], height)
        wall = (np.sqrt(second) - np.sqrt(nearest)) * CORK_CELL_M / CORK_WALL_M
        # The level of a granule fades out at its border, so that the surface has no cliffs.
        plateau = height * (1 - np.exp(-(wall**2) / 4))
        return np.asarray(plateau - CORK_DEPTH_M * np.exp(-(wall**2)))

    return heights


class _Cells:
    """A square grid of cells of size 1, each with one point somewhere around its middle."""

    def __init__(self, rng: np.random.Generator, jitter: float) -> None:
        self.points = 0.5 + rng.uniform(-jitter, jitter, (2, _TABLE, _TABLE))

    def around(
        self, x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> Iterator[tuple[NDArray[np.float64], tuple[NDArray[np.int64], NDArray[np.int64]]]]:
        """Each of the 3 x 3 cells around: squared distance to its point, and its table index."""
        column, row = np.floor(x), np.floor(y)
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                cell = (
                    (column + dx).astype(np.int64) % _TABLE,
                    (row + dy).astype(np.int64) % _TABLE,
                )
                px, py = self.points[0][cell], self.points[1][cell]
                yield (x - column - dx - px) ** 2 + (y - row - dy - py) ** 2, cell


SURFACES: dict[str, Callable[[np.random.Generator], Heights]] = {
    "stone": stone,
    "sand": sand,
    "cork": cork,
}


TIP_M = 25e-6
TIP_SLOPE_M = 400e-6
"""Gaussian widths (standard deviation along the path): of the contact patch, that smooths the
height; and of the ball of the tip, that bridges slopes shorter than itself."""


class HeightProfile:
    """Heights along the whole path: 8 bytes a step are kept, since their mean lies at 0."""

    def __init__(
        self,
        texture: Texture,
        motion: StrokeMotion,
        grid: StepGrid,
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
