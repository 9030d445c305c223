"""Samples far beyond all others: a cable makes them, a hand does not.

One sample of 1 kN in a texture of 30 mN would make a floor that is a share of the range a thousand
times too wide, and draw the slow part by 50 N. They are coded like any other sample; only what the
encoder takes from the signal as a whole, its range and its slow part, leaves them out.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LEAST = 64
"""Samples of a channel; of fewer none can be called rare."""

RARE = 1000
"""One in so many, and no more: what comes more often is the signal."""

BLOCK = 1 << 18


def median3(x: NDArray[Any]) -> NDArray[Any]:
    """[n] -> [n - 2]: the median of each sample and its neighbours."""
    a, b, c = x[:-2], x[1:-1], x[2:]
    return np.asarray(np.maximum(np.minimum(a, b), np.minimum(np.maximum(a, b), c)))


def find_glitches(x: NDArray[Any]) -> NDArray[np.intp]:
    """Places in [ticks] finite numbers: beyond the range of the medians of three by more than that
    range, where such samples are rare; otherwise none."""
    none = np.zeros(0, np.intp)
    if x.size < LEAST:
        return none
    ends = [
        (part.min().item(), part.max().item())
        for start in range(0, x.size - 2, BLOCK)
        for part in (median3(x[start : start + BLOCK + 2]),)
    ]
    low, high = min(a for a, _ in ends), max(b for _, b in ends)
    # In Python: the range of 32-bit counts takes 33, and of doubles it may be infinite.
    below, above = low - (high - low), high + (high - low)
    if below <= x.min().item() and x.max().item() <= above:
        return none
    found = np.flatnonzero((x < below) | (x > above))
    return found if found.size <= max(x.size // RARE, 1) else none


def without_glitches(x: NDArray[Any]) -> NDArray[Any]:
    """[ticks] with the median of three in the place of each; x itself where there is none."""
    found = find_glitches(x)
    if not found.size:
        return x
    calm = x.copy()
    calm[found] = median3(np.pad(x, 1, mode="reflect"))[found]
    return calm
