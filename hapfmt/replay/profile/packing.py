"""Counts -> the reports of a frame. The layout is planned once, so that a frame takes few steps.

Also the functions that turn counts into bytes for fields that are not plain integers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import chain, count
from math import log2
from operator import itemgetter, sub
from struct import Struct
from typing import NamedTuple
from zlib import crc32

from ...errors import ParameterError
from .model import (
    Const,
    Counter,
    Crc32,
    Frame,
    HidReport,
    Mapped,
    One,
    Profile,
    ReportLayout,
    Samples,
)

Values = tuple[float, ...]
"""What an actuator's counts stand for, from its lowest count to its highest."""
Packed = Callable[[tuple[int, ...]], bytes]
"""Places in those tables, one for each actuator -> bytes."""


class Map(NamedTuple):
    actuators: tuple[str, ...]
    """What the actuators stand for, in order."""
    size: int
    low: float
    high: float
    """Values that it takes."""
    make: Callable[[tuple[Values, ...], Mapping[str, float]], Packed]


AMPLITUDE_CEILING = 100
"""Index of the largest amplitude that does the actuators no harm: HA 0xC8, LA 0x72."""
LOW_AMPLITUDES = (0.0, 0.007843, *(0.011823 * 2 ** (n / 4) for n in range(14)), 0.117471)
"""What the indices 0 to 16 stand for (rumble_data_table.md, as all numbers here)."""


def rumble_amplitude(value: float) -> int:
    """The index of an amplitude, 1.0 being the largest: never above the ceiling."""
    if value > 0.23:
        return min(round(32 * log2(8.7 * value)), AMPLITUDE_CEILING)
    if value > 0.12:
        return round(16 * log2(17 * value))
    return min(range(len(LOW_AMPLITUDES)), key=lambda index: abs(LOW_AMPLITUDES[index] - value))


def rumble_frequency(hertz: float) -> int:
    return round(32 * log2(hertz / 10))


def hd_rumble(values: tuple[Values, ...], options: Mapping[str, float]) -> Packed:
    """Amplitudes of the high and the low band at fixed frequencies -> four bytes."""
    high = (rumble_frequency(options["high_hz"]) - 0x60) * 4
    low = rumble_frequency(options["low_hz"]) - 0x40
    heads = [
        bytes([high & 0xFF, (high >> 8) + 2 * index]) for index in map(rumble_amplitude, values[0])
    ]
    tails = [
        bytes([low + 0x80 * (index & 1), (index >> 1) + 0x40])
        for index in map(rumble_amplitude, values[1])
    ]

    def pack(places: tuple[int, ...]) -> bytes:
        return heads[places[0]] + tails[places[1]]

    return pack


MAPS = {
    "hd-rumble": Map(
        actuators=("amplitude of the high band", "amplitude of the low band"),
        size=4,
        low=0.0,
        high=1.0,
        make=hd_rumble,
    )
}
MOST_COUNTS = 1 << 16
"""Most counts of an actuator with a map: its table has an entry for each."""


Counts = tuple[tuple[int, ...], ...]
Step = Callable[[bytearray, Counts], None]
"""Puts one part of a report into its place."""


class Packer:
    """Packs frame after frame; counters go on from one to the next."""

    def __init__(self, profile: Profile) -> None:
        self.profile = profile
        shared: dict[str, Iterator[int]] = {}
        self._reports = [_Plan(profile, layout, shared) for layout in profile.reports]
        self._width = len(profile.actuators)
        self._low = tuple(limits.low for limits in profile.count_limits)
        self._high = tuple(limits.high for limits in profile.count_limits)
        rest = tuple(limits.rest for limits in profile.count_limits)
        self._rest = (rest,) * profile.timing.frame_samples

    def pack(self, frame: Frame) -> tuple[HidReport, ...]:
        """The last gate before the device: a count beyond its limits is refused."""
        if len(frame.counts) != len(self._rest):
            raise ParameterError(f"a frame has {len(self._rest)} samples, not {len(frame.counts)}")
        for counts in frame.counts:
            if len(counts) != self._width:
                raise ParameterError(f"a sample has {self._width} counts, not {len(counts)}")
            for low, given, high in zip(self._low, counts, self._high, strict=True):
                if not low <= given <= high:
                    raise ParameterError(
                        f"count {given} in frame {frame.number} is beyond {low} to {high}",
                        requirement="PLY-002",
                    )
        return self._pack(frame.counts)

    def neutral(self) -> tuple[HidReport, ...]:
        """What puts every actuator to rest."""
        return self.profile.neutral or self.at_rest()

    def at_rest(self) -> tuple[HidReport, ...]:
        return self._pack(self._rest)

    def _pack(self, counts: Counts) -> tuple[HidReport, ...]:
        return tuple([report.pack(counts) for report in self._reports])


class _Plan:
    """One report: what never changes, and the steps for the rest."""

    def __init__(
        self, profile: Profile, layout: ReportLayout, shared: dict[str, Iterator[int]]
    ) -> None:
        self.path = layout.path
        self.template = bytearray(layout.length)
        self.template[0] = layout.id
        for field in layout.fields:
            if isinstance(field, Const):
                self.template[field.at : field.at + len(field.data)] = field.data
        self.steps = [
            *_counters(layout, shared),
            *_ones(profile, layout),
            *_samples(profile, layout),
            *_mapped(profile, layout),
            *_sums(layout),
        ]

    def pack(self, counts: Counts) -> HidReport:
        data = self.template[:]
        for step in self.steps:
            step(data, counts)
        return HidReport(self.path, bytes(data))


def _counters(layout: ReportLayout, shared: dict[str, Iterator[int]]) -> Iterator[Step]:
    for field in layout.fields:
        if isinstance(field, Counter):
            yield _counter(field, shared)


def _counter(field: Counter, shared: dict[str, Iterator[int]]) -> Step:
    numbers = shared.setdefault(field.shared, count()) if field.shared else count()
    pack_into = Struct(field.type.order + field.type.code).pack_into

    def step(data: bytearray, _: Counts) -> None:
        number = (field.start + next(numbers)) & field.mask
        pack_into(data, field.at, number << field.shift)

    return step


def _ones(profile: Profile, layout: ReportLayout) -> Iterator[Step]:
    """Fields that follow one another are packed at once."""
    fields = sorted((f for f in layout.fields if isinstance(f, One)), key=lambda f: f.at)
    run: list[One] = []
    for field in fields:
        joined = run and run[-1].at + run[-1].type.size == field.at
        if run and not (joined and run[-1].type.order == field.type.order):
            yield _run(profile, run)
            run = []
        run.append(field)
    if run:
        yield _run(profile, run)


def _run(profile: Profile, run: list[One]) -> Step:
    pack_into = Struct(run[0].type.order + "".join(f.type.code for f in run)).pack_into
    at = run[0].at
    pick = _picker(profile, tuple(field.actuator for field in run))

    def step(data: bytearray, counts: Counts) -> None:
        pack_into(data, at, *pick(counts[0]))

    return step


def _picker(
    profile: Profile, names: tuple[str, ...]
) -> Callable[[tuple[int, ...]], tuple[int, ...]]:
    """A sample -> the counts of these actuators."""
    places = profile.places(names)
    if places == tuple(range(len(profile.actuators))):
        return lambda counts: counts
    if len(places) == 1:
        place = places[0]
        return lambda counts: (counts[place],)
    return itemgetter(*places)


def _samples(profile: Profile, layout: ReportLayout) -> Iterator[Step]:
    for field in layout.fields:
        if isinstance(field, Samples):
            yield _interleaved(profile, field)


def _interleaved(profile: Profile, field: Samples) -> Step:
    total = len(field.actuators) * profile.timing.frame_samples
    pack_into = Struct(f"{field.type.order}{total}{field.type.code}").pack_into
    pick = _picker(profile, field.actuators)

    def step(data: bytearray, counts: Counts) -> None:
        pack_into(data, field.at, *chain.from_iterable(map(pick, counts)))

    return step


def _mapped(profile: Profile, layout: ReportLayout) -> Iterator[Step]:
    for field in layout.fields:
        if isinstance(field, Mapped):
            yield _function(profile, field)


def _function(profile: Profile, field: Mapped) -> Step:
    function = MAPS[field.function]
    places = profile.places(field.actuators)
    limits = [profile.count_limits[place] for place in places]
    steps = [profile.actuators[place].step for place in places]
    values = tuple(
        tuple(count * step for count in range(limit.low, limit.high + 1))
        for limit, step in zip(limits, steps, strict=True)
    )
    packed = function.make(values, field.options)
    lows = tuple(limit.low for limit in limits)
    pick = _picker(profile, field.actuators)
    at, stop = field.at, field.at + function.size

    def step(data: bytearray, counts: Counts) -> None:
        places = tuple(map(sub, pick(counts[0]), lows))
        data[at:stop] = packed(places)

    return step


def _sums(layout: ReportLayout) -> Iterator[Step]:
    for field in layout.fields:
        if isinstance(field, Crc32):
            yield _sum(field)


def _sum(field: Crc32) -> Step:
    begin = 0 if field.seed is None else crc32(bytes([field.seed]))

    def step(data: bytearray, _: Counts) -> None:
        value = crc32(data[field.start : field.stop], begin)
        data[field.at : field.at + 4] = value.to_bytes(4, "little")

    return step
