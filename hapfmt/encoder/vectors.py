"""Knots of a vector within its deadband: one clock for all axes, Euclidean norms.

Held: a piece goes on while one point lies within the balls of all its samples. The search moves the
point to the ball that is furthest away, again and again. Where a common point exists, this comes
ever closer to it (S. Agmon, "The relaxation method for linear inequalities", Canadian Journal of
Mathematics 6, 1954, and its followers).

Lines: each axis has a tube of its own. Its half width is that of the ball over the root of the
number of axes, so that the axes are independent. A link ends where the first axis must end. Where
the extension is built, kernels/vectors.c takes the same steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isqrt, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..deadband import norm_sq
from ..errors import ParameterError
from ..kernels import compiled
from .gridded import Indices, Levels, levels_of, places
from .tube import COUNT_BOUND, NO_VALUE, SHORT, SLACK, TRIES, Knot, Tube, Way, bounds
from .unit import STEP_LIMIT, Bound

MOVES = 40
"""Balls that are moved to before a piece is given up (100 find 1 % fewer pieces at most)."""

AHEAD = 64
"""Ticks looked at in one go; doubled while a point holds."""

TINY = 1e-9
"""Room, relatively, for what float64 arithmetic may be off."""


def held_grid(bound: Bound) -> LpcParameters:
    """Even steps, as large as lets rounding move a point by half of the floor's radius at most:
    smaller ones cost 5 to 25 % more."""
    return LpcParameters(max(bound.step // 2, 1))


def held_vectors(rows: Indices, grid: LpcParameters, bound: Bound) -> tuple[Indices, Indices]:
    """Ticks [knots] and indices [knots, axes]; every sample within the deadband of its knot."""
    search = Pieces(rows, grid, bound)
    ticks, indices = [], []
    at = 0
    while at < len(rows):
        stop, index = search.longest(at)
        ticks.append(at)
        indices.append(index)
        at = stop
    return np.array(ticks, np.int64), np.array(indices, np.int64)


class Pieces:
    """Balls around the samples, narrower by what rounding to the grid may move a point."""

    def __init__(self, rows: Indices, grid: LpcParameters, bound: Bound) -> None:
        self.rows, self.step, self.band = rows, grid.step, bound.band
        self.points = rows.astype(np.float64)
        allowed = bound.band.allowed_sq(norm_sq(rows - np.array(bound.band.zero)))
        moved = grid.step * sqrt(rows.shape[1]) / 2
        self.radii = np.sqrt(allowed) * (1 - TINY) - moved

    def longest(self, start: int) -> tuple[int, Indices]:
        """Where the piece from ``start`` ends, and the index of its value."""
        point = self.points[start]
        stop, known = start + 1, self.nearest(point)
        ahead = AHEAD
        while stop < len(self.rows):
            end = min(stop + ahead, len(self.rows))
            beyond = self.distances(point, stop, end) > 0
            at = int(beyond.argmax())
            if not beyond[at]:
                stop, ahead = end, 2 * ahead
                continue
            moved = self.common(point, start, stop + at + 1)
            stop += at
            if moved is None:
                break
            point, stop = moved, stop + 1
        index = self.nearest(point)
        return (stop, index) if self.holds(index, start, stop) else (start + 1, known)

    def distances(self, point: NDArray[np.float64], start: int, stop: int) -> NDArray[np.float64]:
        """How far outside each ball the point is."""
        # Axis by axis: the same sum on any machine.
        square = np.zeros(stop - start)
        for axis, at in zip(self.points[start:stop].T, point.tolist(), strict=True):
            square += (axis - at) * (axis - at)
        return np.asarray(np.sqrt(square) - self.radii[start:stop])

    def common(
        self, point: NDArray[np.float64], start: int, stop: int
    ) -> NDArray[np.float64] | None:
        """A point within all balls, from ``point`` on; None where none was found."""
        for _ in range(MOVES):
            outside = self.distances(point, start, stop)
            at = int(outside.argmax())
            if outside[at] <= 0:
                return point
            centre = self.points[start + at]
            length = float(outside[at] + self.radii[start + at])
            if length <= 0:
                # Rounding to the grid may take all of the ball.
                return None
            # A little further than its border, or the border is approached for ever.
            part = min(1.0, 1.05 * float(outside[at]) / length)
            point = point + (centre - point) * part
        return None

    def nearest(self, point: NDArray[np.float64]) -> Indices:
        return np.floor(point / self.step + 0.5).astype(np.int64)

    def holds(self, index: Indices, start: int, stop: int) -> bool:
        """Exactly."""
        rows = self.rows[start:stop]
        return not self.band.outside(rows, np.broadcast_to(index * self.step, rows.shape)).any()


def box_of(rows: Indices, bound: Bound) -> Indices:
    """Half width [ticks] of the largest cube within each ball, in whole counts."""
    axes = rows.shape[1]
    band = bound.band
    reference = norm_sq(rows - np.array(band.zero))
    weber = np.sqrt(reference / axes) * (band.kn / band.kd) * (1 - TINY) - TINY
    whole = np.minimum(np.floor(weber), COUNT_BOUND).astype(np.int64)
    return np.asarray(np.maximum(whole, isqrt(bound.slack**2 // axes)))


def joined_grid(bound: Bound) -> LpcParameters:
    """Even steps, as wide as the cube of the floor: half of that costs 0 to 20 % more."""
    inner = isqrt(bound.slack**2 // len(bound.band.zero))
    return LpcParameters(2 * min(inner, STEP_LIMIT // 2 - 1) + 1)


class Front(NamedTuple):
    """The knot of each axis at one tick, and the lines that begin there."""

    ways: tuple[Way, ...]

    @property
    def tick(self) -> int:
        return self.ways[0][0].tick

    @property
    def stop(self) -> int:
        """The first tick that the lines of one axis cannot pass."""
        return min(sweep.stop for _, sweep in self.ways)


def joined_vectors(rows: Indices, grid: LpcParameters, bound: Bound) -> tuple[Indices, Indices]:
    """Ticks [knots] and indices [knots, axes], joined by lines; the last tick is that of rows."""
    width = box_of(rows, bound)
    shapes = [levels_of(x, grid) for x in rows.T]
    ticks, at = joined_places(
        [bounds(x - width, x + width) for x in rows.T], [levels for _, levels in shapes]
    )
    return ticks, at + np.array([first for first, _ in shapes])


def joined_places(
    axes: Sequence[tuple[Indices, Indices]], grids: Sequence[Levels]
) -> tuple[Indices, Indices]:
    """Ticks [knots] and places [knots, axes] on even grids, within the tubes (lower, upper)."""
    shared = [
        places(lower.max(keepdims=True), upper.min(keepdims=True), grid)
        for (lower, upper), grid in zip(axes, grids, strict=True)
    ]
    if all(low[0] <= high[0] for low, high in shared):
        row = [int(low[0] + high[0]) // 2 for low, high in shared]
        return np.zeros(1, np.int64), np.array([row], np.int64)
    if compiled is not None and all(isinstance(grid, range) for grid in grids):
        lower, upper = (np.array(side) for side in zip(*axes, strict=True))
        shape = [(grid.start, grid.step, len(grid)) for grid in grids if isinstance(grid, range)]
        ticks, at = np.empty(lower.shape[1], np.int64), np.empty(lower.shape[::-1], np.int64)
        count = compiled.fewest_joined(lower, upper, np.array(shape, np.int64), ticks, at)
        if not count:
            raise ParameterError(NO_VALUE)
        return ticks[-count:].copy(), at[-count:].copy()
    tubes = [Tube(*sides, grid) for sides, grid in zip(axes, grids, strict=True)]
    knots = last_front(tubes)
    clock = [knots[0].tick]
    found = [[(knot.low + knot.high) // 2 for knot in knots]]
    while knots[0].parts:
        row = []
        for tube, knot, place in zip(tubes, knots, found[-1], strict=True):
            low, high = tube.origins(knot.parts[0][2], knot.tick, place)
            row.append(min(max(place, low), high))
        knots = [knot.parts[0][2] for knot in knots]
        clock.append(knots[0].tick)
        found.append(row)
    return np.array(clock[::-1], np.int64), np.array(found[::-1], np.int64)


def last_front(tubes: list[Tube]) -> list[Knot]:
    """The knots at the tubes' end, and through their parts all knots before them."""
    size = tubes[0].size
    front = Front(tuple(tube.way(Knot(0, tube.lows[0], tube.highs[0])) for tube in tubes))
    while True:
        if front.stop >= size and (knots := meet(tubes, front, size - 1)):
            return knots
        found: list[Front] = []
        for tick in candidates(tubes, front):
            if knots := meet(tubes, front, tick):
                ways = [tube.way(knot) for tube, knot in zip(tubes, knots, strict=True)]
                found.append(Front(tuple(ways)))
                if len(found) > TRIES + (tick - front.tick < SHORT):
                    break
        front = max(found, key=lambda each: (each.stop, each.tick))


def candidates(tubes: list[Tube], front: Front) -> list[int]:
    """Ticks for the next knots, best first; the last of them can be reached whatever happens."""
    last = front.stop - 1
    slow = min(range(len(tubes)), key=lambda i: front.ways[i][1].stop)
    knot, sweep = front.ways[slow]
    ticks = tubes[slow].candidates(knot, sweep)[0] if sweep.side else []
    near = [min(tick, last) for tick in ticks]
    back = range(last, front.tick, -max((last - front.tick) // SLACK, 1))
    return list(dict.fromkeys((*near, *back, front.tick + 1)))


def meet(tubes: list[Tube], front: Front, tick: int) -> list[Knot] | None:
    """The knots of all axes at ``tick``; None where one of them has none."""
    knots = []
    for tube, (knot, sweep) in zip(tubes, front.ways, strict=True):
        if not knot.tick < tick < sweep.stop or (part := tube.arrive(knot, sweep, tick)) is None:
            return None
        knots.append(Knot(tick, part[0], part[1], (part,)))
    return knots
