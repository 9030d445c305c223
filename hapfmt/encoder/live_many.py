"""Blocks of many channels to packets of LPCR in one call, each by the predictor that it is given.

kernels/live.c has the same in C: it takes as long as the coding itself, where calls from Python,
one for each step of each packet, take several times that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters, deadband_levels
from ..codecs.predicted import (
    CONSTANT,
    ORDER_LIMIT,
    RAW_SIGNS,
    REPEATS,
    RICE,
    TABLE,
    Predictor,
    encode_predicted,
)
from ..deadband import Deadband
from ..integers import build_svarint, rdiv
from ..kernels import compiled
from .grids import nearest_uniform
from .predict import LIMITS, REPEAT_SHARE, choose_predictors, with_repeats
from .quick import choose_quick, costs_of

Counts = NDArray[np.int64]
Levels = NDArray[np.int64]


class Missing(IntEnum):
    """Why a block has no packet."""

    OUTSIDE = -1
    """A count beyond the declared range."""
    NO_CODE = -2
    """The predictor leaves an error of more bits than there is a code for."""
    FULL = -3
    """There was no room for it."""
    BROKEN = -4
    """The contract would not hold."""


@dataclass(frozen=True)
class Task:
    """What one channel asks for: its range, its grid, the contract to be checked, and a predictor,
    whose base is that of each block; None: Rice codes, and a predictor for each block."""

    low: int
    high: int
    grid: LpcParameters
    band: Deadband | None
    predictor: Predictor | None

    @cached_property
    def levels(self) -> Levels | None:
        """[2, levels]: magnitudes of a deadband's grid, and the largest that stands for each."""
        if not self.grid.kn:
            return None
        reach = max(abs(self.low - self.grid.zero), abs(self.high - self.grid.zero))
        return np.stack(deadband_levels(self.grid, reach))

    def record(self, place: int) -> bytes:
        """As kernels/live.c reads it; ``place`` of the levels among those that go with it."""
        band, grid = self.band, self.grid
        way = Predictor(rice=True) if self.predictor is None else self.predictor
        flags = way.repeats * REPEATS | way.raw_signs * RAW_SIGNS | way.rice * RICE
        numbers = [
            self.low, self.high, grid.step, grid.zero, place, way.difference,
            len(way.reflections), flags, *((band.kn, band.kd, band.floor[0], band.zero[0])
                                           if band else (0, 0, 0, 0)),
        ]  # fmt: skip
        coefficients = np.zeros(ORDER_LIMIT, np.int32)
        reflections = np.zeros(ORDER_LIMIT, np.int8)
        order = len(way.reflections)
        coefficients[:order] = way.coefficients or []
        reflections[:order] = way.reflections
        return (
            np.array(numbers, np.int64).tobytes() + coefficients.tobytes() + reflections.tobytes()
        )


@dataclass
class Shelf:
    """The grids of levels that tasks share, each once."""

    levels: list[Levels]
    places: dict[tuple[LpcParameters, int, int], int]

    @classmethod
    def empty(cls) -> Shelf:
        return cls([], {})

    def record(self, task: Task) -> bytes:
        if task.levels is None:
            return task.record(-1)
        key = task.grid, task.low, task.high
        place = self.places.get(key)
        if place is None:
            place = self.places[key] = len(self.levels)
            self.levels.append(task.levels)
        return task.record(place)


def encode_blocks(
    blocks: list[NDArray[Any]], tasks: Sequence[Task], records: Sequence[bytes], shelf: Shelf
) -> list[bytes | Missing]:
    """Packets of blocks, all of the same number of samples, int16, int32 or int64."""
    if compiled is None:
        return [encode_block(block, task) for block, task in zip(blocks, tasks, strict=True)]
    size = blocks[0].size
    out = np.empty(len(blocks) * (2 * size + 64), np.uint8)
    ends = np.empty(len(blocks), np.int64)
    compiled.encode_blocks(
        blocks, shelf.levels, b"".join(records), TABLE, LIMITS, costs_of(size), out, ends
    )
    data, at = out.data, 0
    packets: list[bytes | Missing] = []
    for end in ends.tolist():
        if end < 0:
            packets.append(Missing(end))
        else:
            packets.append(bytes(data[at:end]))
            at = end
    return packets


def encode_block(block: NDArray[Any], task: Task) -> bytes | Missing:
    """One of them; kernels/ has the same in C."""
    counts = block.astype(np.int64)
    if counts.min() < task.low or counts.max() > task.high:
        return Missing.OUTSIDE
    indices = indices_of(counts, task)
    if indices is None:
        return Missing.BROKEN
    first = int(indices[0])
    if (indices == first).all():
        return bytes([CONSTANT, 0]) + build_svarint(first)
    predictor = based(task.predictor, indices) if task.predictor else choose_quick(indices)
    try:
        return encode_predicted(indices, predictor)
    except ValueError:
        if task.predictor is not None:
            return Missing.NO_CODE
        # An error too large in what was not looked at.
        return encode_predicted(indices, Predictor(0, (), first, rice=True))


def indices_of(counts: Counts, task: Task) -> Counts | None:
    """The nearest places on the grid; None where one of them does not keep the contract."""
    if task.levels is None:
        indices = nearest_uniform(counts, task.grid)
        given = indices * task.grid.step + task.grid.zero
    else:
        sizes, tops = task.levels
        beside = counts - task.grid.zero
        cells = np.searchsorted(tops, np.abs(beside)).astype(np.int64)
        indices = np.where(beside < 0, -cells, cells)
        given = task.grid.zero + np.where(beside < 0, -sizes[cells], sizes[cells])
    if task.band is None:
        return indices
    outside = task.band.outside(counts, np.clip(given, task.low, task.high))
    return None if outside.any() else indices


def based(predictor: Predictor, indices: Counts) -> Predictor:
    """The same with the base of other indices."""
    mean = rdiv(int(indices.sum()), indices.size)
    return replace(predictor, base=int(indices[0]) if predictor.difference else mean)


def search(indices: Counts, before: Predictor | None) -> tuple[bytes, Predictor]:
    """The smallest of some packets, and its predictor: by the best of this block by its estimate,
    or by that of the block before, which the estimate does not always do justice to."""
    first = int(indices[0])
    if (indices == first).all():
        return bytes([CONSTANT, 0]) + build_svarint(first), before or Predictor()
    plain = np.ascontiguousarray(indices)
    extent = max(-int(plain.min()), int(plain.max()))
    tried = [choose_predictors(plain, extent)[0][1]]
    if np.count_nonzero(plain[1:] == plain[:-1]) > REPEAT_SHARE * plain.size:
        tried.append(with_repeats(plain, tried[0], extent)[0])
    if before is not None:
        tried.append(based(before, plain))
    packets = []
    for predictor in tried:
        try:
            packets.append((encode_predicted(plain, predictor), predictor))
        except ValueError:
            # That of another block may leave errors that are too large here.
            continue
    return min(packets, key=lambda pair: len(pair[0]))
