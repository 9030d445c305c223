"""A signal as a picture shows it: the least and the greatest value of each column."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ...recording import Channel

LARGEST = 1e300
"""Larger values are drawn as this, so that margins do not overflow."""
COLUMNS = 2000
"""A page has about two columns for each pixel. Up to twice as many ticks are kept one by one."""


@dataclass
class Outline:
    """Ticks [first, stop) in columns of ``size`` ticks: least and most [columns] (NaN where there
    is nothing finite), and how many samples each holds."""

    first: int
    stop: int
    rate: Fraction
    size: int
    least: NDArray[np.float64]
    most: NDArray[np.float64]
    counts: NDArray[np.int64]

    @classmethod
    def over(cls, first: int, stop: int, rate: Fraction, limit: int = COLUMNS) -> Outline:
        ticks = max(stop - first, 0)
        size = 1 if ticks <= 2 * limit else -(-ticks // limit)
        columns = -(-ticks // size)
        empty = np.full(columns, np.nan)
        return cls(first, stop, rate, size, empty, empty.copy(), np.zeros(columns, np.int64))

    def add(self, start: int, values: NDArray[np.float64]) -> None:
        """Adds values [ticks] from tick ``start`` on; values outside the outline are ignored."""
        a, b = max(start, self.first), min(start + values.size, self.stop)
        if a >= b:
            return
        x = values[a - start : b - start]
        x = np.where(np.isfinite(x), np.clip(x, -LARGEST, LARGEST), np.nan)
        column, within = divmod(a - self.first, self.size)
        starts = np.append(0, np.arange(self.size - within, x.size, self.size))
        place = slice(column, column + starts.size)
        self.least[place] = np.fmin(self.least[place], np.fmin.reduceat(x, starts))
        self.most[place] = np.fmax(self.most[place], np.fmax.reduceat(x, starts))
        self.counts[place] += np.diff(starts, append=x.size)

    def add_channel(self, channel: Channel, values: NDArray[np.float64] | None = None) -> None:
        """All that a channel covers; values [samples]: these instead of its own."""
        x = channel.samples() if values is None else values
        place = 0
        for span in channel.coverage:
            self.add(span.start, x[place : place + span.ticks])
            place += span.ticks

    @property
    def is_whole(self) -> bool:
        """Whether every column is one tick."""
        return self.size == 1

    @property
    def sample_count(self) -> int:
        return int(self.counts.sum())

    def seconds(self) -> NDArray[np.float64]:
        """[columns] the middle of each column."""
        ticks = self.first + self.size * np.arange(self.counts.size, dtype=np.float64)
        return (ticks + (self.size - 1) / 2) / float(self.rate)

    def line(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A line that looks as all samples would; NaN breaks it where there are none."""
        if self.is_whole:
            return self.seconds(), self.most
        return np.repeat(self.seconds(), 2), np.stack([self.least, self.most], axis=1).ravel()

    def missing(self) -> NDArray[np.bool_]:
        """[columns] that lack a sample, between the first and the last that hold one."""
        full = np.full(self.counts.size, self.size, np.int64)
        if full.size:
            full[-1] = self.stop - self.first - self.size * (full.size - 1)
        known = np.flatnonzero(self.counts)
        found = self.counts < full
        if known.size:
            found[: known[0]] = found[known[-1] + 1 :] = False
            if not self.is_whole:
                # A column may hold the first or the last sample, and be full as far as it goes.
                found[known[0]] = found[known[-1]] = False
        else:
            found[:] = False
        return found

    def runs(self, columns: NDArray[np.bool_]) -> list[tuple[float, float]]:
        """Seconds of the runs of True in [columns]; ticks reach half a tick to either side."""
        edges = np.flatnonzero(np.diff(columns.astype(np.int8), prepend=0, append=0))
        seconds = (self.first + self.size * edges - 0.5) / float(self.rate)
        return list(zip(seconds[::2].tolist(), seconds[1::2].tolist(), strict=True))

    def columns_within(self, start: float, stop: float) -> slice:
        """Columns that the seconds [start, stop) touch."""
        places = [(s * float(self.rate) - self.first) / self.size for s in (start, stop)]
        low, high = (float(np.clip(p, 0, self.counts.size)) for p in places)
        return slice(int(low), int(np.ceil(high)))
