"""How often errors of each size occur, counted as they come."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .outline import LARGEST

BINS = 3**7
"""Odd, so that a bin is centred on zero, and a power of three, so that three neighbours become one
where the range must grow."""


class Histogram:
    """counts [BINS]; bin i is centred on (i - BINS // 2) * width. Zeros are counted from the start,
    the width follows from the first value that is not zero, or is that of a count."""

    def __init__(self, width: float = 0.0) -> None:
        self.width = width
        self.counts = np.zeros(BINS, np.int64)
        self.largest = 0.0
        self.beyond = 0
        """Values that are not finite."""

    @property
    def total(self) -> int:
        return int(self.counts.sum())

    def add(self, errors: NDArray[np.float64]) -> None:
        """errors, any shape."""
        finite = np.clip(errors[np.isfinite(errors)], -LARGEST, LARGEST)
        self.beyond += int(errors.size - finite.size)
        largest = float(np.max(np.abs(finite), initial=0.0))
        self.largest = max(self.largest, largest)
        if largest == 0:
            self.counts[BINS // 2] += finite.size
            return
        if not self.width:
            self.width = max(largest / (BINS // 4), np.finfo(np.float64).tiny)
        while largest > self.width * (BINS // 2 - 1):
            self.widen()
        places = np.rint(finite / self.width).astype(np.int64) + BINS // 2
        self.counts += np.bincount(places.ravel(), minlength=BINS)

    def widen(self) -> None:
        third = self.counts.reshape(-1, 3).sum(axis=1)
        self.counts = np.zeros(BINS, np.int64)
        start = (BINS - third.size) // 2
        self.counts[start : start + third.size] = third
        self.width *= 3

    def bars(self, most: int = 81) -> tuple[NDArray[np.float64], NDArray[np.int64], float]:
        """Centres [bars], counts [bars], width: at most ``most`` bars that hold all."""
        counts, width = self.counts, self.width
        while True:
            found = np.flatnonzero(counts)
            middle = counts.size // 2
            reach = int(np.abs(found - middle).max(initial=0))
            if 2 * reach + 1 <= most or counts.size < 3:
                break
            counts, width = counts.reshape(-1, 3).sum(axis=1), width * 3
        centres = np.arange(-reach, reach + 1, dtype=np.float64) * width
        return centres, counts[middle - reach : middle + reach + 1], width
