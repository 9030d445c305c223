"""Resampling kernels: which value a channel has between its ticks (docs/spec/players.md).

``ratio`` is rate of the channel times speed by rate of the device; p = max(1, ratio) is the width
of a kernel in ticks, so that what the device cannot render is taken away before it folds back. x is
the distance of a tick from the place asked for, in ticks.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Shape = Literal["linear", "band-limited", "bounded"]

LOBES = 16
"""Zeros of the sinc on each side."""
BETA = 8.0
"""Of the Kaiser window."""
AT_ONCE = 1 << 15
"""Products that are held at a time: as a cache of the processor does."""
LARGE = 2.0**8
"""Sums of the largest doubles may not be finite on the way to a result that is; of these they
are."""
TABLES = 32
"""Tables of weights that a kernel keeps: places come again and again."""

Values = NDArray[np.float64]


@dataclass(eq=False)
class Kernel:
    """Weights of ``2 * half`` ticks: of tick k, the last that is not behind the place, with the
    ``half - 1`` before it and the ``half`` after it."""

    shape: Shape
    ratio: Fraction
    half: int
    tables: OrderedDict[bytes, Values] = field(default_factory=OrderedDict, repr=False)

    @property
    def width(self) -> Fraction:
        return max(self.ratio, Fraction(1))

    @property
    def name(self) -> str:
        """As reports call it: with its width in ticks, where that is not 1."""
        return self.shape if self.ratio <= 1 else f"{self.shape} ({float(self.ratio):.6g} ticks)"

    def weights(self, phases: Values) -> Values:
        """[places, 2 * half]; each row adds up to 1."""
        x = np.arange(1 - self.half, self.half + 1) - phases[:, None]
        if self.shape == "linear":
            return np.asarray(np.maximum(self.half - np.abs(x), 0.0) / self.half**2)
        u = x / float(self.width)
        inside = np.maximum(1.0 - (u / LOBES) ** 2, 0.0)
        w = np.sinc(u) * np.where(inside > 0, np.i0(BETA * np.sqrt(inside)), 0.0)
        return np.asarray(w / w.sum(axis=1, keepdims=True))

    def table(self, phases: Values) -> tuple[Values, NDArray[np.intp]]:
        """Weights of the different phases, and which of them each place has."""
        distinct, which = np.unique(phases, return_inverse=True)
        key = distinct.tobytes()
        found = self.tables.get(key)
        if found is None:
            found = self.tables[key] = self.weights(distinct)
            if len(self.tables) > TABLES:
                self.tables.popitem(last=False)
        else:
            self.tables.move_to_end(key)
        return found, which

    def apply(self, around: Values, first: int, ticks: NDArray[np.int64], phases: Values) -> Values:
        """Values at places [m]; ``around``: of all ticks from ``first`` on that they need."""
        if self.width == 1 and not phases.any():
            # On a tick the value is that of the tick, bit for bit.
            return around[ticks - first]
        out = np.empty(len(ticks))
        starts = ticks - first - (self.half - 1)
        windows = np.lib.stride_tricks.sliding_window_view(around, 2 * self.half)
        for rows in parts(len(ticks), max(AT_ONCE // (2 * self.half), 1)):
            out[rows] = self.blend(windows[starts[rows]], phases[rows])
        if self.width == 1:
            on = phases == 0
            out[on] = around[(ticks - first)[on]]
        return out

    def blend(self, near: Values, phases: Values) -> Values:
        """near [places, 2 * half]"""
        table, which = self.table(phases)
        weights = table[which] if len(table) > 1 else table
        with np.errstate(over="ignore", invalid="ignore"):
            out = (weights * near).sum(axis=1)
            large = ~np.isfinite(out)
            if large.any():
                some = weights[large] if len(weights) > 1 else weights
                out[large] = (some * (near[large] / LARGE)).sum(axis=1) * LARGE
        if self.shape == "band-limited":
            largest = np.finfo(np.float64).max
            return np.asarray(np.clip(out, -largest, largest))
        low, high = self.bounds(near, phases)
        return np.asarray(np.clip(out, low, high))

    def bounds(self, near: Values, phases: Values) -> tuple[Values, Values]:
        """The lowest and the highest of the ticks less than a width away."""
        reach = min(ceil(self.width), self.half)
        columns = slice(self.half - reach, self.half + reach)
        x = np.arange(1 - reach, reach + 1) - phases[:, None]
        close = np.abs(x) < float(self.half if self.shape == "linear" else self.width)
        values = near[:, columns]
        low = np.where(close, values, np.inf).min(axis=1)
        high = np.where(close, values, -np.inf).max(axis=1)
        return low, high


def parts(count: int, size: int) -> Iterator[slice]:
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


def kernel(shape: Shape, ratio: Fraction) -> Kernel:
    width = max(ratio, Fraction(1))
    lobes = 1 if shape == "linear" else LOBES
    return Kernel(shape, ratio, ceil(lobes * width))
