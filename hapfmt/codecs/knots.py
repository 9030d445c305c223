"""KNOT: support points on a grid, joined by steps or lines, in varints (SPEC 9.1).

knots_coded.py has their entropy coding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError
from ..kernels import compiled
from ..limits import Level
from .grids import UNIT_GRID, LpcParameters, levels_of
from .varints import build_varints, from_signed, parse_varints, to_signed

Interpolation = Literal["hold", "linear"]
FAR = 1 << 36
INTERPOLATIONS: tuple[Interpolation, ...] = ("hold", "linear")


@dataclass(frozen=True)
class KnotParameters:
    """How knots are joined, which count each index stands for, and whether they are
    entropy coded or stored in varints."""

    interpolation: Interpolation
    grid: LpcParameters = UNIT_GRID
    coded: bool = False

    def build(self) -> bytes:
        way = INTERPOLATIONS.index(self.interpolation)
        return bytes([way, self.coded]) + self.grid.build()

    @classmethod
    def parse(cls, data: bytes, level: Level, offset: int) -> KnotParameters:
        if len(data) < 2:
            raise TruncatedError("KNOT parameters cut short", requirement="COD-002", offset=offset)
        if data[0] >= len(INTERPOLATIONS) or data[1] > 1:
            raise FormatError(
                "unknown interpolation or coding", requirement="KNT-001", offset=offset
            )
        grid = LpcParameters.parse(data[2:], level, offset + 2)
        return cls(INTERPOLATIONS[data[0]], grid, bool(data[1]))


def parse_knots(
    data: bytes, components: int, offset: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Ticks [knots] counted from the packet's start, and indices [knots, components]."""
    numbers = parse_varints(data, offset)
    width = components + 1
    # The tick of the first knot is 0 and not stored: put it in, and all rows are alike.
    if (numbers.size + 1) % width or numbers.size < components:
        raise FormatError("a knot is not whole", requirement="KNT-002", offset=offset)
    table = np.concatenate((np.zeros(1, np.int64), numbers)).reshape(-1, width)
    if (table[1:, 0] < 1).any():
        raise FormatError("knot ticks not increasing", requirement="KNT-003", offset=offset)
    # Sums of 64-bit numbers could wrap: no index that keeps LPC-003 is that far from the next, and
    # a gap cut to this size still lies beyond any packet.
    if table[:, 1:].max() >= FAR:
        raise FormatError("index far beyond the grid", requirement="LPC-003", offset=offset)
    return np.cumsum(np.minimum(table[:, 0], FAR)), np.cumsum(to_signed(table[:, 1:]), axis=0)


def build_knots(ticks: NDArray[np.int64], indices: NDArray[np.int64]) -> bytes:
    """The packet of knots: ticks [knots] with ticks[0] = 0, indices [knots, components]."""
    differences = np.diff(indices, axis=0, prepend=0)
    table = np.column_stack((np.diff(ticks, prepend=0), from_signed(differences)))
    return build_varints(table.reshape(-1)[1:])


def interpolate(
    ticks: NDArray[np.int64], counts: NDArray[np.int64], span: int, interpolation: Interpolation
) -> NDArray[np.int64]:
    """Counts [span, components] from knots that keep KNT-003."""
    if interpolation == "hold" or ticks.size == 1:
        return np.repeat(counts, np.diff(np.append(ticks, span)), axis=0)
    lengths = np.diff(ticks)
    lengths[-1] += 1
    rise, run = np.diff(counts, axis=0), np.diff(ticks)
    row = np.repeat(np.arange(lengths.size), lengths)
    along = np.arange(span) - ticks[row]
    divisor = run[row][:, None]
    numerator = 2 * rise[row] * along[:, None] + divisor
    line: NDArray[np.int64] = counts[row] + numerator // (2 * divisor)
    return line


def decode_knots(
    data: bytes, parameters: KnotParameters, span: int, components: int, level: Level, offset: int
) -> NDArray[np.int64]:
    """The packet ``data``, which stands at ``offset``, as counts [span, components]."""
    ticks, indices = parse_knots(data, components, offset)
    grid, bound = parameters.grid, level.count_bound
    if np.abs(indices).max() > grid.index_limit(bound):
        raise FormatError("index beyond the grid", requirement="LPC-003", offset=offset)
    check_ticks(ticks, span, parameters.interpolation, offset)
    return interpolate(ticks, grid.counts(indices, bound), span, parameters.interpolation)


def decode_within(
    data: bytes,
    parameters: KnotParameters,
    span: int,
    components: int,
    level: Level,
    offset: int,
    low: int,
    high: int,
) -> NDArray[np.int32]:
    """``decode_knots``, each count clamped to low ... high (DEC-001)."""
    if compiled is not None:
        grid, out = parameters.grid, np.empty((span, components), np.int32)
        if compiled.knots_decode(
            data, components, parameters.interpolation == "linear",
            grid.index_limit(level.count_bound), grid.step, grid.zero,
            levels_of(grid, level.count_bound), low, high,
            np.zeros(2 * components, np.int64), out,
        ):  # fmt: skip
            return out
    # In Python, and so is a broken rule told.
    counts = decode_knots(data, parameters, span, components, level, offset)
    return np.clip(counts, low, high).astype(np.int32)


def check_ticks(
    ticks: NDArray[np.int64], span: int, interpolation: Interpolation, offset: int
) -> None:
    last = int(ticks[-1])
    if last >= span:
        raise FormatError("knot beyond its packet", requirement="KNT-003", offset=offset)
    if interpolation == "linear" and 0 < last < span - 1:
        raise FormatError(
            "the last line does not end at the packet's end", requirement="KNT-003", offset=offset
        )
