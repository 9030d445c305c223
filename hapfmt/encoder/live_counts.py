"""Channels of counts, block by block, on one grid: of step 1, of a largest error, of a deadband."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..container.track import Track
from ..contract import nearest_counts
from ..errors import ParameterError
from .live_many import FRESH, QUICK, How, Job, Made, Missing, Shelf, Task, encode_blocks
from .live_plan import Plan

Counts = NDArray[np.int64]

AGAIN = 1
"""Packets that a predictor serves after the one that it was looked for."""

LIKE, FEW = 0.03, 4
"""It is looked for anew where a packet is not as large as the one it was looked for, by more than
that part and some bytes: with that sizes were 0.3 % above those of a search for each (measured on
counts of sensors and simulated ones), in two thirds of the time."""


def counts_of_block(plan: Plan, values: NDArray[Any], channel: int, start: int) -> Counts:
    """What came in as counts within the declared range; nothing is clamped."""
    given = plan.input
    if given.takes_counts:
        if values.dtype.kind not in "iu":
            raise ParameterError(
                f"channel {channel} ({given.label!r}) takes integer counts, not {values.dtype}"
            )
        outside = (values < plan.low) | (values > plan.high)
        if outside.any():
            raise outside_range(plan, values, outside, channel, start)
        return np.ascontiguousarray(values, np.int64)
    if values.dtype.kind not in "iuf" or values.dtype.itemsize > 8:
        raise ParameterError(
            f"channel {channel} ({given.label!r}) takes numbers of up to 64 bits, "
            f"not {values.dtype}"
        )
    x = np.ascontiguousarray(values, np.float64)
    low, high = (float(plan.calibration.step) * end for end in (plan.low, plan.high))
    outside = ~((x >= low) & (x <= high))
    if outside.any():
        raise outside_range(plan, values, outside, channel, start)
    return np.clip(nearest_counts(x, plan.calibration), plan.low, plan.high)


def outside_range(
    plan: Plan, values: NDArray[Any], outside: NDArray[np.bool_], channel: int, start: int
) -> ParameterError:
    given = plan.input
    at = int(np.argmax(outside))
    bits = f"the {given.bits} bits ({plan.low} to {plan.high})"
    if given.takes_counts:
        limits = f"the count {values[at]} is outside {bits} of the input: declare more of them"
    else:
        limits = f"{values[at]} is outside {bits} of steps of {given.lsb:g}: give a larger lsb"
    return ParameterError(f"channel {channel} ({given.label!r}), tick {start + at}: {limits}")


def fits(track: Track, counts: Counts) -> bool:
    """Whether the declared range holds all of them."""
    return track.count_min <= int(counts.min()) and int(counts.max()) <= track.count_max


class Way:
    """How the packets of a channel are made, by what was found of the ones before."""

    def __init__(self, task: Task, shelf: Shelf, *, fast: bool = False) -> None:
        self.task, self.shelf = task, shelf
        self.record = shelf.record(task)
        self.habit = QUICK if fast else FRESH
        self.looks = not fast and task.knots is None
        """Whether predictors are looked for: that of one packet serves the next, but not for long,
        and not where that one turns out another size."""
        self.left, self.expected = 0, 0.0

    def job(self, block: NDArray[Any], *, again: bool = False) -> Job:
        how = How.GIVEN
        if self.looks and (again or not self.left):
            how = How.LOOK if self.habit is FRESH else How.LOOK_BESIDE
        return Job(block, self.task, self.record, self.habit, how)

    def take(self, job: Job, made: Made) -> bytes | None:
        """The packet that was made; None: again."""
        packet, self.habit = made
        if packet is Missing.BROKEN:
            raise AssertionError("an encoder that guarantees a deadband left it")
        if isinstance(packet, Missing):
            return None
        if not self.looks:
            return packet
        if job.how:
            self.left, self.expected = AGAIN, len(packet) / job.block.size
            return packet
        self.left -= 1
        expected = self.expected * job.block.size
        return packet if abs(len(packet) - expected) <= LIKE * expected + FEW else None

    def pack(self, x: Counts) -> bytes:
        """A packet on its own."""
        packet = None
        for again in (False, True):
            if packet is None:
                job = self.job(x, again=again)
                packet = self.take(job, encode_blocks([job], self.shelf)[0])
        assert packet is not None
        return packet


def grid_way(plan: Plan, number: int, grid: LpcParameters, shelf: Shelf) -> tuple[Track, Way]:
    """A channel on this grid, in packets of LPCR."""
    track = plan.track(number, codec="LPCR", parameters=grid.build(), contract=plan.contract)
    task = Task(plan.low, plan.high, grid, plan.bound.band if plan.bound else None)
    return track, Way(task, shelf, fast=plan.settings.fast)


class GridLane:
    """A channel on one grid."""

    def __init__(self, plan: Plan, number: int, shelf: Shelf) -> None:
        self.plan, self.number = plan, number
        self.track, self.way = grid_way(plan, number, plan.grid, shelf)
        self.wider: Track | None = None

    @property
    def ways(self) -> Sequence[Way]:
        return () if self.wider else (self.way,)

    def adopt(self, track: Track) -> None:
        """Goes on with a track of the file where it differs in its range alone."""
        following = replace(self.track, continues=track.id)
        if alike(track, self.track):
            self.track, self.wider = track, following
        else:
            self.track = following

    def take(self, packets: Sequence[bytes]) -> bytes:
        return packets[0]

    def code(self, values: NDArray[Any], start: int) -> bytes:
        x = counts_of_block(self.plan, values, self.number, start)
        if self.wider and not fits(self.track, x):
            self.track, self.wider = self.wider, None
        return self.way.pack(x)


def alike(track: Track, wanted: Track) -> bool:
    """Whether packets for the one are packets for the other, but for the declared range."""
    same = ("codec", "parameters", "contract", "number_format")
    return all(getattr(track, name) == getattr(wanted, name) for name in same) and (
        track.components[0].deviation == wanted.components[0].deviation
    )
