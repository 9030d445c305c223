"""Functions that turn counts into bytes, for devices whose fields are not plain integers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import log2
from typing import NamedTuple

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
"""Of an actuator that a map takes: its table has an entry for each."""
