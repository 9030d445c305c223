"""The channels of a recording, and the tick that each has come to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from ..names import unknown
from .clusters import Grid
from ..encoder.inputs import Input
from .samples import named
from .worker import Member


@dataclass
class Lane:
    """Channels whose samples come together."""

    channels: tuple[int, ...]
    index: NDArray[np.intp]
    inputs: list[Input]
    grid: Grid
    wake: int = 0
    """The first tick of the cluster after the one that the last sample was for."""


class Lanes:
    """Channels by label or place, alone or together."""

    def __init__(self, cluster: Fraction, start_s: Fraction) -> None:
        self.cluster, self.start_s = cluster, start_s
        self.members: list[Member] = []
        self.ticks: NDArray[np.int64] = np.empty(0, np.int64)
        """Where the next sample of each channel goes."""
        self.silent: set[int] = set()
        """Places that nothing came for yet: these may begin anywhere."""
        self.by_label: dict[str, int] = {}
        self.known: dict[tuple[int, ...], Lane] = {}
        self.single: dict[str | int, Lane] = {}

    def enter(self, member: Member, start_s: Fraction) -> int:
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

    def one(self, channel: str | int) -> Lane:
        """The lane of a single channel."""
        lane = self.single.get(channel)
        if lane is None:
            lane = self.single[channel] = self.of((channel,))
        return lane

    def of(self, channels: Sequence[str | int]) -> Lane:
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
            grid = Grid.of(self.cluster, inputs[0].rate)
            lane = Lane(places, np.array(places, np.intp), inputs, grid)
            self.known[places] = lane
        return lane

    def start_of(self, lane: Lane, tick: int | None) -> int:
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

    def move(self, lane: Lane, tick: int) -> None:
        """The next samples of a lane go to this tick."""
        if len(lane.channels) == 1:
            self.ticks[lane.channels[0]] = tick
        else:
            self.ticks[lane.index] = tick
        if self.silent:
            self.silent.difference_update(lane.channels)
