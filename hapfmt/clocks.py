"""ClockObservation and ClockMap: what a recording knows of other clocks (SPEC 11.6).

Both refer to a channel of the recording, as an event does. A file refers to a track instead.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import index
from typing import Any, TypeVar

from .errors import ParameterError
from .numbers import rdiv

TICK_BOUND = 1 << 52
TIME_BOUND = 1 << 63
VARINT_BOUND = 1 << 53
NAME_SIZE = 255
"""Bytes of a clock's name."""


@dataclass(frozen=True, slots=True)
class ClockObservation:
    """A reading of a clock: it showed ``time_ns`` at ``tick`` of a channel.

    ``channel`` is a number or a label. With None, ticks are nanoseconds of the recording.
    uncertainty_ns 0: unknown.
    """

    clock: str
    channel: int | str | None
    tick: int
    time_ns: int
    uncertainty_ns: int = 0

    def __post_init__(self) -> None:
        check_reference(self.clock, self.channel)
        for name in ("tick", "time_ns", "uncertainty_ns"):
            object.__setattr__(self, name, whole(getattr(self, name), f"the {name} of a clock"))
        check_place(self.tick, self.time_ns)
        if not 0 <= self.uncertainty_ns < VARINT_BOUND:
            raise ParameterError("the uncertainty of a clock lies between 0 and 2^53 - 1 ns")


@dataclass(frozen=True)
class ClockMap:
    """Maps ticks of a channel to the time of a clock and back, in integers.

    It interpolates linearly between ``points`` (tick, time_ns), at least two, both increasing.
    ``channel`` is a number or a label. With None, ticks are nanoseconds of the recording.
    """

    clock: str
    channel: int | str | None
    points: tuple[tuple[int, int], ...]

    def __post_init__(self) -> None:
        check_reference(self.clock, self.channel)
        try:
            points = tuple((index(tick), index(time_ns)) for tick, time_ns in self.points)
        except (TypeError, ValueError):
            raise ParameterError(
                "the points of a clock map are pairs of integers: (tick, nanoseconds)"
            ) from None
        for point in points:
            check_place(*point)
        steps = pairwise(points)
        if len(points) < 2 or any(k1 <= k0 or t1 <= t0 for (k0, t0), (k1, t1) in steps):
            raise ParameterError("a clock map has two points or more, whose ticks and times grow")
        object.__setattr__(self, "points", points)

    @cached_property
    def _ticks(self) -> list[int]:
        return [tick for tick, _ in self.points]

    @cached_property
    def _times(self) -> list[int]:
        return [time for _, time in self.points]

    def time_ns(self, tick: int) -> int:
        """The time of the clock at a tick, in nanoseconds."""
        (k0, t0), (k1, t1) = self._line(bisect_right(self._ticks, tick))
        return t0 + rdiv((t1 - t0) * (tick - k0), k1 - k0)

    def tick(self, time_ns: int) -> int:
        """The tick at a time of the clock in nanoseconds."""
        (k0, t0), (k1, t1) = self._line(bisect_right(self._times, time_ns))
        return k0 + rdiv((k1 - k0) * (time_ns - t0), t1 - t0)

    def _line(self, after: int) -> Sequence[tuple[int, int]]:
        """The line from the last point at or before something, else the first line."""
        first = min(max(after - 1, 0), len(self.points) - 2)
        return self.points[first : first + 2]


Clocked = TypeVar("Clocked", ClockObservation, ClockMap)


def check_reference(clock: object, channel: object) -> None:
    """The name of a clock, and the kind of its channel."""
    try:
        raw = clock.encode("utf-8") if isinstance(clock, str) else b""
    except UnicodeEncodeError:
        raw = b""
    if not 1 <= len(raw) <= NAME_SIZE or 0 in raw:
        raise ParameterError(
            f"the name of a clock is a text of 1 to {NAME_SIZE} bytes of UTF-8 without U+0000, "
            f"unlike {clock!r:.60}"
        )
    if channel is not None and not isinstance(channel, (int, str)):
        raise ParameterError("the channel of a clock must be a number, a label or None")


def check_place(tick: int, time_ns: int) -> None:
    if abs(tick) >= TICK_BOUND or not -TIME_BOUND <= time_ns < TIME_BOUND:
        raise ParameterError(
            f"tick {tick}, time {time_ns} ns: a clock has ticks between -2^52 and 2^52, and times "
            "within 2^63 ns of its zero"
        )


def check_steps(clock_map: ClockMap) -> None:
    """ParameterError where no file holds the map."""
    for (k0, t0), (k1, t1) in pairwise(clock_map.points):
        if max(k1 - k0, t1 - t0) >= VARINT_BOUND:
            raise ParameterError(
                f"two points of the map of clock {clock_map.clock!r} are 2^53 ns or more apart; a "
                "file holds the observations, but not this map"
            )


def whole(value: Any, what: str) -> int:
    try:
        return index(value)
    except TypeError:
        kind = type(value).__name__
        raise ParameterError(f"{what} is an integer, not {kind}; round it with int()") from None


def by_clock(found: Iterable[Clocked]) -> dict[tuple[str, int | str | None], list[Clocked]]:
    """By clock and channel, in the order in which these come first."""
    groups: dict[tuple[str, int | str | None], list[Clocked]] = {}
    for each in found:
        groups.setdefault((each.clock, each.channel), []).append(each)
    return groups


def on_channels(
    found: Iterable[Clocked], places: Mapping[int | str | None, int]
) -> Iterator[Clocked]:
    """Those of the channels in ``places``, under their new numbers, and those of no channel."""
    for each in found:
        place = places.get(each.channel)
        if each.channel is None or place == each.channel:
            yield each
        elif place is not None:
            yield replace(each, channel=place)
