"""Grids of counts: uniform grids, and the grids of a deadband (SPEC 9.1)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..kernels import compiled
from ..limits import FRACTION_LIMIT, ZERO_LIMIT, Level
from ..numbers import build_svarint, build_varint, parse_svarint, parse_varint

UNIFORM, DEADBAND = 0, 1

FINEST = 1024
"""The finest deadband grid has the Weber fraction 1 / 1024 (LPC-002)."""

LEVELS_LIMIT = 1 << 14
"""More than any deadband's grid has: 8813."""


@dataclass(frozen=True)
class LpcParameters:
    """The grid: which count each index stands for."""

    step: int = 1
    zero: int = 0
    kn: int = 0
    kd: int = 1

    @property
    def grid(self) -> int:
        return DEADBAND if self.kn else UNIFORM

    def build(self) -> bytes:
        out = bytes([self.grid]) + build_varint(self.step) + build_svarint(self.zero)
        return out + build_varint(self.kn) + build_varint(self.kd) if self.grid else out

    @classmethod
    def parse(cls, data: bytes, level: Level, offset: int) -> LpcParameters:
        if not data:
            raise TruncatedError("no grid in the parameters", requirement="COD-002", offset=offset)
        grid, kn, kd = data[0], 0, 1
        step, position = parse_varint(data, 1, offset)
        zero, position = parse_svarint(data, position, offset)
        fits = grid in (UNIFORM, DEADBAND) and -ZERO_LIMIT <= zero < ZERO_LIMIT
        if grid == UNIFORM:
            fits = fits and step > 0
        elif fits:
            kn, position = parse_varint(data, position, offset)
            kd, position = parse_varint(data, position, offset)
            fits = 0 < kn < FRACTION_LIMIT and 0 < kd < FRACTION_LIMIT and kd <= FINEST * kn
        if not fits:
            raise FormatError("a grid that is not defined", requirement="LPC-002", offset=offset)
        if position != len(data):
            raise FormatError(
                "bytes after the grid's parameters", requirement="COD-002", offset=offset
            )
        level.check("step", step, "LPC-002", offset + 1)
        return cls(step, zero, kn, kd)

    def counts(self, indices: NDArray[np.int64], bound: int) -> NDArray[np.int64]:
        """Counts of indices that lie on the grid."""
        if self.grid == UNIFORM:
            scaled = indices if self.step == 1 else indices * self.step
            return scaled + self.zero if self.zero else scaled
        levels = deadband_levels(self, bound)[0]
        return self.zero + np.sign(indices) * levels[np.abs(indices)]

    def index_limit(self, bound: int) -> int:
        """Largest magnitude of an index (LPC-003)."""
        if self.grid == UNIFORM:
            return bound // self.step
        return deadband_levels(self, bound)[0].size - 1


UNIT_GRID = LpcParameters()
"""Every count is its own index."""


def levels_of(grid: LpcParameters, bound: int) -> NDArray[np.int64] | bytes:
    """y(i) as the compiled loops take them: none on the uniform grid."""
    return b"" if grid.grid == UNIFORM else deadband_levels(grid, bound)[0]


@lru_cache(maxsize=32)
def deadband_levels(grid: LpcParameters, bound: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """y(i) and top(y(i)) of SPEC 9.1 for i = 0 ... N; a top without bound is ``bound``.

    At most 8813 of them: steps of 1 up to kd / kn, and from there on by a factor of 1 + 2 kn / kd.
    """
    if compiled is not None:
        rows = np.empty((2, LEVELS_LIMIT), np.int64)
        count = compiled.deadband_levels(grid.step, grid.kn, grid.kd, bound, rows[0], rows[1])
        assert count > 0
        return rows[0, :count].copy(), rows[1, :count].copy()
    levels, tops = [0], []
    while True:
        y = levels[-1]
        room = grid.kd - grid.kn
        top = max(y + grid.step, y * grid.kd // room) if room > 0 else bound
        tops.append(top)
        if top >= bound:
            return np.array(levels, np.int64), np.array(tops, np.int64)
        c = top + 1
        levels.append(c + max(grid.kn * c // grid.kd, grid.step))
