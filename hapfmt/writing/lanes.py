"""The channels of a recording, and the next tick of each.

The caller's samples become private arrays, checked against the inputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..encoder.live import Input
from ..errors import ParameterError, unknown
from .clusters import ClusterGrid
from .worker import FileChannel


def owned(values: ArrayLike, inputs: Sequence[Input]) -> NDArray[Any]:
    """[ticks, channels] int32 counts or float64, a copy; [ticks] goes for one channel.

    Raises ParameterError for another shape or kind, and for counts beyond the bits of an input.
    """
    given = np.asarray(values)
    if given.ndim < 2 and len(inputs) == 1:
        given = given.reshape(-1, 1)
    if given.ndim != 2 or given.shape[1] != len(inputs):
        raise ParameterError(
            f"samples of {named(inputs)} are [ticks, {len(inputs)}], not {list(given.shape)}"
            if len(inputs) > 1
            else f"samples of {named(inputs)} are one-dimensional, not {list(given.shape)}"
        )
    if not inputs[0].takes_counts:
        if given.dtype.kind not in "fiub" or given.dtype.itemsize > 8:
            raise ParameterError(
                f"samples of {named(inputs)} are floats, not {given.dtype}: "
                "integer counts need an Input with a calibration"
            )
        return np.array(given, np.float64, order="C")
    if given.dtype.kind not in "iu" and given.size:
        raise ParameterError(
            f"samples of {named(inputs)} are integer counts, not {given.dtype}, "
            "as its calibration says"
        )
    check_range(given, inputs)
    return np.array(given, np.int32, order="C")


def check_range(counts: NDArray[Any], inputs: Sequence[Input]) -> None:
    bits = inputs[0].bits if len(inputs) == 1 else min(given.bits for given in inputs)
    if not counts.size or (counts.dtype.kind == "i" and 8 * counts.dtype.itemsize <= bits):
        return
    if counts.size == 1:
        low = high = int(counts.item())
    else:
        low, high = int(counts.min()), int(counts.max())
    if within(low, high, bits):
        return
    for place, given in enumerate(inputs):
        low, high = int(counts[:, place].min()), int(counts[:, place].max())
        if not within(low, high, given.bits):
            raise ParameterError(
                f"counts of {given.label!r} from {low} to {high} need more than its "
                f"{given.bits} bits"
            )


def within(low: int, high: int, bits: int) -> bool:
    return -(1 << (bits - 1)) <= low and high < 1 << (bits - 1)


def named(inputs: Sequence[Input]) -> str:
    if len(inputs) == 1:
        return repr(inputs[0].label)
    return f"the {len(inputs)} channels from {inputs[0].label!r} to {inputs[-1].label!r}"


@dataclass
class InputGroup:
    """Channels whose samples come together."""

    channels: tuple[int, ...]
    index: NDArray[np.intp]
    inputs: list[Input]
    grid: ClusterGrid
    wake: int = 0
    """The first tick of the cluster after the one that the last sample was for."""


class Lanes:
    """Channels by label or place, alone or together."""

    def __init__(self, cluster: Fraction, start_s: Fraction) -> None:
        self.cluster, self.start_s = cluster, start_s
        self.members: list[FileChannel] = []
        self.ticks: NDArray[np.int64] = np.empty(0, np.int64)
        """Where the next sample of each channel goes."""
        self.silent: set[int] = set()
        """Places that nothing came for yet: these may begin anywhere."""
        self.by_label: dict[str, int] = {}
        self.known: dict[tuple[int, ...], InputGroup] = {}
        self.single: dict[str | int, InputGroup] = {}

    def enter(self, member: FileChannel, start_s: Fraction) -> int:
        """The place of an input that is new."""
        place = len(self.members)
        self.members.append(member)
        if member.is_new:
            self.silent.add(place)
        self.by_label.setdefault(member.input.label, place)
        self.ticks = np.append(self.ticks, ceil(start_s * member.input.rate))
        return place

    @property
    def seconds(self) -> Fraction:
        """The end of the latest sample so far."""
        latest: dict[Fraction, int] = {}
        for tick, member in zip(self.ticks.tolist(), self.members, strict=True):
            rate = member.input.rate
            latest[rate] = max(latest.get(rate, 0), tick)
        return max((tick / rate for rate, tick in latest.items()), default=self.start_s)

    def place_of(self, channel: str | int) -> int:
        place = self.by_label.get(channel, -1) if isinstance(channel, str) else channel
        if isinstance(place, (int, np.integer)) and 0 <= place < len(self.members):
            return int(place)
        labels = [member.input.label for member in self.members]
        raise ParameterError(unknown("channel", channel, labels))

    def one(self, channel: str | int) -> InputGroup:
        """The lane of a single channel."""
        lane = self.single.get(channel)
        if lane is None:
            lane = self.single[channel] = self.of((channel,))
        return lane

    def of(self, channels: Sequence[str | int]) -> InputGroup:
        places = tuple(self.place_of(channel) for channel in channels)
        lane = self.known.get(places)
        if lane is None:
            inputs = [self.members[place].input for place in places]
            if not inputs or len(set(places)) < len(places):
                raise ParameterError("rows have one channel or more, each once")
            if len({(given.rate, given.takes_counts) for given in inputs}) > 1:
                raise ParameterError(
                    f"{named(inputs)} have different rates, or integers and floats: "
                    "write them separately"
                )
            grid = ClusterGrid.of(self.cluster, inputs[0].rate)
            lane = InputGroup(places, np.array(places, np.intp), inputs, grid)
            self.known[places] = lane
        return lane

    def start_of(self, lane: InputGroup, tick: int | None) -> int:
        """Where samples go; ticks never go back."""
        if len(lane.channels) == 1 and (tick is None or tick >= self.ticks.item(lane.channels[0])):
            return self.ticks.item(lane.channels[0]) if tick is None else tick
        ticks = self.ticks[lane.index]
        ahead = int(ticks.max())
        if tick is None:
            if int(ticks.min()) != ahead:
                raise ParameterError(
                    f"{named(lane.inputs)} are not at one tick, but from {ticks.min()} "
                    f"to {ahead}: give the tick"
                )
            return ahead
        if 0 <= tick < ahead and self.silent:
            behind = ticks > tick
            if self.silent.issuperset(lane.index[behind].tolist()):
                return tick
        if tick < ahead:
            place = int(ticks.argmax())
            raise ParameterError(
                f"samples of {lane.inputs[place].label!r} for tick {tick} come after those up to "
                f"tick {ahead}: ticks never go back"
            )
        return tick

    def move(self, lane: InputGroup, tick: int) -> None:
        """The next samples of a lane go to this tick."""
        if len(lane.channels) == 1:
            self.ticks[lane.channels[0]] = tick
        else:
            self.ticks[lane.index] = tick
        if self.silent:
            self.silent.difference_update(lane.channels)
