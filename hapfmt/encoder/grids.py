"""Which grid (SPEC 9.5) keeps a bound, and the index that stands for a count."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import FINEST, LpcParameters, deadband_levels
from .unit import STEP_LIMIT, Bound, at_most

Indices = NDArray[np.int64]

Levels = range | NDArray[np.int64]
"""Counts in ascending order."""


@lru_cache(maxsize=256)
def grid_within(bound: Bound, part: Fraction = Fraction(1)) -> LpcParameters:
    """The grid that has a value within that part of the deadband of every count."""
    step = min(int(bound.slack * part), STEP_LIMIT // 2 - 1)
    ratio = at_most(Fraction(bound.band.kn, bound.band.kd) * part)
    if ratio * FINEST < 1:
        return LpcParameters(2 * step + 1)
    return LpcParameters(step, bound.band.zero[0], ratio.numerator, ratio.denominator)


def nearest(x: Indices, grid: LpcParameters) -> Indices:
    return nearest_level(x, grid) if grid.kn else nearest_uniform(x, grid)


def nearest_uniform(x: Indices, grid: LpcParameters) -> Indices:
    if grid.step == 1:
        return x - grid.zero if grid.zero else x
    return (2 * (x - grid.zero) + grid.step) // (2 * grid.step)


def nearest_level(x: Indices, grid: LpcParameters) -> Indices:
    """The index whose cell holds each count: cells end at top(y) of SPEC 9.5."""
    c = x - grid.zero
    _, tops = deadband_levels(grid, int(np.abs(c).max()))
    cells: Indices = np.searchsorted(tops, np.abs(c)).astype(np.int64)
    return np.asarray(np.sign(c) * cells)


def levels_of(x: Indices, grid: LpcParameters) -> tuple[int, Levels]:
    """The counts that the nearest indices of x lie between, and the index of the first."""
    first, last = nearest(np.array([x.min(), x.max()]), grid).tolist()
    if not grid.kn:
        step, zero = grid.step, grid.zero
        return first, range(first * step + zero, last * step + zero + 1, step)
    return first, grid.counts(np.arange(first, last + 1), int(np.abs(x - grid.zero).max()))


def places(lower: Indices, upper: Indices, levels: Levels) -> tuple[Indices, Indices]:
    """The first and the last of ascending ``levels`` within [lower, upper]."""
    if isinstance(levels, range):
        low = -((levels.start - lower) // levels.step)
        high = (upper - levels.start) // levels.step
        return np.maximum(low, 0), np.minimum(high, len(levels) - 1)
    return np.searchsorted(levels, lower), np.searchsorted(levels, upper, side="right") - 1
