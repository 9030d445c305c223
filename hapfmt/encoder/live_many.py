"""Blocks of many channels to packets of LPCR or KNOT in one call.

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
from ..codecs.knots import INTERPOLATIONS, Interpolation
from ..codecs.predicted import (
    CONSTANT,
    INDEX_LIMIT,
    ORDER_LIMIT,
    REPEATS,
    TABLE,
    Predictor,
    encode_predicted,
)
from ..deadband import Deadband
from ..integers import build_svarint, rdiv
from ..kernels import compiled
from .grids import nearest_uniform
from .predict import LIMITS, REPEAT_SHARE, choose_predictors
from .quick import costs_of, encode_quick

Counts = NDArray[np.int64]
Levels = NDArray[np.int64]


class Missing(IntEnum):
    """Why a block has no packet."""

    OUTSIDE = -1
    """A count beyond the declared range."""
    NO_CODE = -2
    """The predictor leaves an error of more bits than there is a code for."""
    FULL = -3
    """The buffer had no room; a call for that block alone makes it."""
    BROKEN = -4
    """The contract would not hold."""


class How(IntEnum):
    """Where the predictor of a packet comes from."""

    GIVEN = 0
    LOOK = 1
    LOOK_BESIDE = 2
    """Looked for, but the given one is kept where it does better."""


@dataclass(frozen=True)
class Task:
    """What one channel asks for: its range, its grid, and the contract to be checked; packets of
    indices, or of knots within the slack where the floor allows less than a count."""

    low: int
    high: int
    grid: LpcParameters
    band: Deadband | None
    knots: Interpolation | None = None
    slack: int = 0

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
        felt = (band.kn, band.kd, band.floor[0], band.zero[0]) if band else (0, 0, 0, 0)
        way = 0 if self.knots is None else 1 + INTERPOLATIONS.index(self.knots)
        numbers = self.low, self.high, grid.step, grid.zero, place, *felt, way, self.slack
        return np.array(numbers, np.int64).tobytes()


class Shelf:
    """The grids of levels that tasks share, each once."""

    def __init__(self) -> None:
        self.levels: list[Levels] = []
        self.places: dict[tuple[LpcParameters, int, int], int] = {}

    def record(self, task: Task) -> bytes:
        if task.levels is None:
            return task.record(-1)
        key = task.grid, task.low, task.high
        place = self.places.setdefault(key, len(self.levels))
        if place == len(self.levels):
            self.levels.append(task.levels)
        return task.record(place)


QUICK_FLAG = 128
"""Of a habit: predictors are looked for in each packet, with little work."""


def habit_of(predictor: Predictor, *, quick: bool = False) -> bytes:
    """A predictor but for its base, as kernels/live.c has it."""
    order = len(predictor.reflections)
    flags = predictor.repeats * REPEATS | quick * QUICK_FLAG
    coefficients = np.zeros(ORDER_LIMIT, np.int32)
    reflections = np.zeros(ORDER_LIMIT, np.int8)
    coefficients[:order] = predictor.coefficients or []
    reflections[:order] = predictor.reflections
    head = np.array((predictor.difference, order, flags, 0), np.int32)
    return head.tobytes() + coefficients.tobytes() + reflections.tobytes()


def predictor_of(habit: bytes) -> Predictor:
    difference, order, flags, _ = np.frombuffer(habit, np.int32, 4).tolist()
    reflections = np.frombuffer(habit, np.int8, order, len(habit) - ORDER_LIMIT).tolist()
    return Predictor(difference, tuple(reflections), 0, bool(flags & REPEATS))


FRESH, QUICK = habit_of(Predictor()), habit_of(Predictor(), quick=True)
"""Of a channel without a packet, and of one whose predictors are looked for in each, with little
work."""


@dataclass(frozen=True)
class Job:
    """One block to be coded."""

    block: NDArray[Any]
    """int16, int32 or int64 [samples]."""
    task: Task
    record: bytes
    habit: bytes
    how: How


Made = tuple[bytes | Missing, bytes]
"""A packet, and the habit of its channel from then on."""


def encode_blocks(jobs: Sequence[Job], shelf: Shelf) -> list[Made]:
    """Packets of blocks, all of the same number of samples."""
    if compiled is None:
        return [encode_block(job) for job in jobs]
    size = jobs[0].block.size
    out = np.empty(len(jobs) * (2 * size + 64), np.uint8)
    ends = np.empty(len(jobs), np.int64)
    habits = bytearray().join([job.habit for job in jobs])
    compiled.encode_blocks(
        [job.block for job in jobs],
        shelf.levels,
        b"".join([job.record for job in jobs]),
        habits,
        bytes([job.how for job in jobs]),
        TABLE,
        LIMITS,
        costs_of(size),
        out,
        ends,
    )
    data, at, made = out.data, 0, list[Made]()
    for place, (job, end) in enumerate(zip(jobs, ends.tolist(), strict=True)):
        if end == Missing.FULL:
            made.append(encode_block(job))
        elif end < 0:
            made.append((Missing(end), job.habit))
        else:
            habit = job.habit
            if job.how:
                habit = bytes(habits[place * len(habit) : (place + 1) * len(habit)])
            made.append((bytes(data[at:end]), habit))
            at = end
    return made


def encode_block(job: Job) -> Made:
    """One of them; kernels/ has the same in C."""
    counts, task = job.block.astype(np.int64), job.task
    if counts.min() < task.low or counts.max() > task.high:
        return Missing.OUTSIDE, job.habit
    if task.knots is not None and task.band is not None:
        from .live_knots import pack_knots

        packet = pack_knots(
            counts,
            task.knots,
            task.grid,
            task.levels,
            task.band,
            task.slack,
            (task.low, task.high),
        )
        return Missing.BROKEN if packet is None else packet, job.habit
    indices = indices_of(counts, task)
    if indices is None:
        return Missing.BROKEN, job.habit
    first = int(indices[0])
    if (indices == first).all():
        return bytes([CONSTANT, 0]) + build_svarint(first), job.habit
    if np.abs(indices).max() > INDEX_LIMIT:
        return Missing.NO_CODE, job.habit
    given = predictor_of(job.habit)
    if job.habit == QUICK:
        return encode_quick(indices), job.habit
    if job.how:
        before = given if job.how is How.LOOK_BESIDE else None
        packet, found = search(indices, before)
        return packet, habit_of(found)
    try:
        return encode_predicted(indices, based(given, indices)), job.habit
    except ValueError:
        return Missing.NO_CODE, job.habit


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
    plain = np.ascontiguousarray(indices)
    extent = max(-int(plain.min()), int(plain.max()))
    tried = [choose_predictors(plain, extent)[0][1]]
    if np.count_nonzero(plain[1:] == plain[:-1]) > REPEAT_SHARE * plain.size:
        tried.append(replace(tried[0], repeats=True))
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
