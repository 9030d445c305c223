"""Lattices that values miss by little: how far, and which is the first near enough."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, nextafter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..recording import Calibration
from .rational import Ratio, place


class Near(NamedTuple):
    """A calibration, the counts of some values, and the most that one of them misses its count."""

    calibration: Calibration
    counts: NDArray[np.int64]
    largest_deviation: float
    how: str


def first_near(
    u: NDArray[np.float64], ratios: Iterator[Ratio | None], allowed: float, bits: int
) -> Near | None:
    """The first that keeps all of u within ``allowed``."""
    for ratio in ratios:
        placed = None if ratio is None else place(ratio, bits)
        if placed is None:
            continue
        largest = largest_deviation(u, placed.calibration.physical(placed.counts))
        if largest <= allowed:
            return Near(placed.calibration, placed.counts, largest, placed.how)
    return None


def largest_deviation(u: NDArray[np.float64], given: NDArray[np.float64]) -> float:
    """max |u - given|, rounded up to float64; both finite.

    The difference as an unevaluated sum of two float64: D. E. Knuth, The Art of Computer
    Programming 2, section 4.2.2, theorem B.
    """
    difference = u - given
    back = difference - u
    rest = (u - (difference - back)) - (given + back)
    size = np.abs(difference)
    worst = float(size.max())
    above = rest * np.sign(difference) > 0
    return nextafter(worst, inf) if above[size == worst].any() else worst
