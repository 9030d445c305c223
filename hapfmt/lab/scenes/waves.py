"""What hands do by themselves: they wander, move smoothly, and do it again; all of it can be asked
for block by block, and comes out the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BLOCK_STEPS = 1 << 14
"""Steps computed at a time: about 6 MB."""

WAVE_COUNT = 8


def stream(seed: int, name: str) -> np.random.Generator:
    """A generator of its own for each part of a scene, so that leaving one out moves no other."""
    return np.random.Generator(np.random.PCG64([seed, crc32(name.encode())]))


@dataclass(frozen=True)
class Grid:
    """Steps of a part of a scene: ``per_tick`` in each of ``ticks`` samples of the sensors."""

    ticks: int
    per_tick: int
    rate_hz: int

    @property
    def steps(self) -> int:
        return self.ticks * self.per_tick

    @property
    def dt_s(self) -> float:
        return 1 / (self.rate_hz * self.per_tick)

    def times(self, start: int, stop: int) -> Floats:
        """Of steps [start, stop), in seconds."""
        return np.arange(start, stop, dtype=np.float64) * self.dt_s

    def blocks(self) -> Iterator[tuple[int, int]]:
        """Ranges of steps, each of whole ticks."""
        size = max(BLOCK_STEPS // self.per_tick, 1) * self.per_tick
        for start in range(0, self.steps, size):
            yield start, min(start + size, self.steps)

    def ticks_of(self, start: int, stop: int) -> slice:
        return slice(start // self.per_tick, stop // self.per_tick)

    def averages(self, values: Floats) -> Floats:
        """[steps] of whole ticks to [ticks]: what a sensor that averages sees."""
        if self.per_tick == 1:
            return values
        return np.asarray(values.reshape(-1, self.per_tick).mean(axis=1))

    def with_slope(
        self, values: Callable[[Floats], Floats], start: int, stop: int
    ) -> tuple[Floats, Floats]:
        """A function of time at steps [start, stop), and d/dt of it as np.gradient takes it of all
        steps."""
        first, last = max(start - 1, 0), min(stop + 1, self.steps)
        x = values(self.times(first, last))
        slope = np.gradient(x, self.dt_s) if x.size > 1 else np.zeros(1)
        rows = slice(start - first, stop - first)
        return x[rows], np.asarray(slope[rows])


class Waves:
    """Eight sines of random frequency and phase between two frequencies; rms 1 in the long run."""

    def __init__(self, rng: np.random.Generator, low_hz: float, high_hz: float) -> None:
        frequency = rng.uniform(low_hz, high_hz, WAVE_COUNT)
        self.waves = list(zip(frequency, rng.uniform(0, 2 * np.pi, WAVE_COUNT), strict=True))

    def at(self, t: Floats) -> Floats:
        out = np.zeros_like(t)
        for frequency, phase in self.waves:
            out += np.sin(2 * np.pi * frequency * t + phase)
        return out / 2


def minimum_jerk(u: Floats) -> Floats:
    """From 0 at u <= 0 to 1 at u >= 1, as smoothly as can be: T. Flash, N. Hogan, "The coordination
    of arm movements", J. Neurosci. 5, 1985, https://doi.org/10.1523/JNEUROSCI.05-07-01688.1985."""
    u = np.clip(u, 0, 1)
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


class Repeats:
    """Something that is done again every so many seconds, each time a little different."""

    def __init__(
        self, rng: np.random.Generator, seconds: float, every_s: float, lasts_s: float
    ) -> None:
        """``lasts_s`` of ``every_s``: it begins somewhere in the first half of what is left."""
        self.every_s = every_s
        self.count = int(seconds / every_s) + 1
        spare = every_s - lasts_s
        self.late_s = spare * rng.uniform(0.25, 0.5, self.count)
        self.strength = rng.uniform(0.85, 1.15, self.count)

    def at(self, t: Floats) -> tuple[NDArray[np.int64], Floats]:
        """Which one it is, and the seconds since it began (negative before)."""
        number = np.minimum((t / self.every_s).astype(np.int64), self.count - 1)
        return number, t - number * self.every_s - self.late_s[number]
