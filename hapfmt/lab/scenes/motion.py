"""Motions of a hand. Each can be computed in blocks, and the blocks do not change the result.

- Waves: slow random variation.
- A stroke over a plane: heading that turns once in about 5 s, varying speed and pressure. The tool
  comes down at the beginning and lifts at the end. A scene can ask for lifts in between.
- Presses: the hand comes down on a surface, stays, lifts, and repeats.
- A reach through the air, from point to point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import cos, sin
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from .description import Press, Reach, Stroke

Floats = NDArray[np.float64]

BLOCK_STEPS = 1 << 14
"""Steps computed at a time: about 6 MB."""

WAVE_COUNT = 8


def stream(seed: int, name: str) -> np.random.Generator:
    """A generator of its own for each part of a scene, so that leaving one out moves no other."""
    return np.random.Generator(np.random.PCG64([seed, crc32(name.encode())]))


@dataclass(frozen=True)
class StepGrid:
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
        """Times of the steps [start, stop), in seconds."""
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
    """An action repeated every ``every_s`` seconds, with a random delay and strength."""

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
        """The number of the action, and the seconds since it began (negative before)."""
        number = np.minimum((t / self.every_s).astype(np.int64), self.count - 1)
        return number, t - number * self.every_s - self.late_s[number]


APPROACH_M = 2e-3
TOUCH_S, LIFT_S, TRAVEL_S = 0.15, 0.10, 0.10
"""The hand waits 2 mm above the surface, starts down after 0.15 s, and travels 0.1 s. It lifts
early enough to be up 0.1 s before the end. In recordings below 1 s all three times shrink."""


class StrokeMotion:
    """A stroke over the plane. Without a texture the place of the tip is not computed."""

    def __init__(self, stroke: Stroke, grid: StepGrid, rng: np.random.Generator) -> None:
        self.grid, self.stroke = grid, stroke
        self.pace = Waves(rng, 0.2, 1.5)
        self.heading_start = rng.uniform()
        self.turns = Waves(rng, 0.1, 1.0)
        self.slow_press, self.fast_press = Waves(rng, 0.2, 2.0), Waves(rng, 8, 12)
        self.x = self.y = 0.0
        if touches := stroke.touches:
            lasts = 2 * touches.travel_s + touches.away_s
            self.again = Repeats(rng, grid.ticks / grid.rate_hz, touches.every_s, lasts)

    def speed(self, t: Floats) -> Floats:
        """Speed along the plane in m/s."""
        slowest, fastest = self.stroke.speed_m_per_s
        half = (fastest - slowest) / 2
        return np.asarray(slowest + half + half * np.clip(self.pace.at(t) / 2, -1, 1))

    def heading(self, t: Floats) -> Floats:
        """Direction on the plane in radians."""
        return np.asarray(2 * np.pi * (self.heading_start + t / 5) + 0.3 * self.turns.at(t))

    def path(self, t: Floats) -> tuple[Floats, Floats]:
        """x and y in metres at the times of one block; blocks are asked for in their order."""
        speed, heading, dt = self.speed(t), self.heading(t), self.grid.dt_s
        x = np.cumsum(np.concatenate([[self.x], speed * np.cos(heading)]))[1:]
        y = np.cumsum(np.concatenate([[self.y], speed * np.sin(heading)]))[1:]
        self.x, self.y = float(x[-1]), float(y[-1])
        return x * dt, y * dt

    def since_start(self, axis: str, path: Floats, velocity: Floats) -> Floats:
        """A path, which adds up whole steps up to and with its own, by the trapezoidal rule: nearly
        the same at any step."""
        along = cos if axis == "x" else sin
        heading = float(self.heading(np.zeros(1))[0])
        first = float(self.speed(np.zeros(1))[0]) * along(heading)
        return np.asarray(path - self.grid.dt_s / 2 * (first + velocity))

    def press(self, t: Floats) -> Floats:
        """Force of the hand at rest, newtons."""
        wander = 0.12 * self.slow_press.at(t)
        return np.asarray(self.stroke.press_n * (1 + wander) + 0.006 * self.fast_press.at(t))

    def lifted(self, t: Floats) -> Floats:
        """From 0, pressing, to 1, above the surface."""
        seconds = self.grid.steps * self.grid.dt_s
        shrink = min(1.0, seconds)
        down = (t / shrink - TOUCH_S) / TRAVEL_S
        up = ((seconds - t) / shrink - LIFT_S) / TRAVEL_S
        travelled = np.clip(np.minimum(down, up), 0, 1)
        return np.asarray((1 + np.cos(np.pi * travelled)) / 2)

    def height(self, t: Floats, compliance: float) -> Floats:
        """Where along the normal the hand would have the tip, in metres; ``compliance`` of hand and
        contact in a row, m/N."""
        depth = self.press(t) * compliance
        height = self.lifted(t) * (depth + APPROACH_M) - depth
        if touches := self.stroke.touches:
            number, since = self.again.at(t)
            up = minimum_jerk(since / touches.travel_s)
            down = minimum_jerk((since - touches.travel_s - touches.away_s) / touches.travel_s)
            lift = touches.lift_m * self.again.strength[number]
            height = np.maximum(height, (up - down) * (depth + lift) - depth)
        return np.asarray(height)


UNEVEN = 0.02
"""How much a force that is held wanders (rms)."""


class PressMotion:
    def __init__(self, press: Press, grid: StepGrid, rng: np.random.Generator) -> None:
        self.what = press
        seconds = grid.ticks / grid.rate_hz
        self.again = Repeats(rng, seconds, press.every_s, 2 * press.travel_s + press.hold_s)
        self.wander = Waves(rng, 0.3, 3)

    def height(self, t: Floats, compliance: float) -> Floats:
        """As :meth:`hapfmt.lab.scenes.motion.StrokeMotion.height`."""
        number, since = self.again.at(t)
        travel, hold = self.what.travel_s, self.what.hold_s
        down = minimum_jerk(since / travel) - minimum_jerk((since - travel - hold) / travel)
        press = self.what.press_n * self.again.strength[number] * (1 + UNEVEN * self.wander.at(t))
        return np.asarray(self.what.lift_m - (self.what.lift_m + press * compliance) * down)


class ReachMotion:
    def __init__(self, reach: Reach, grid: StepGrid, rng: np.random.Generator) -> None:
        self.what = reach
        seconds = grid.ticks / grid.rate_hz
        self.again = Repeats(rng, seconds, reach.every_s, reach.travel_s)
        half = reach.extent_m / 2
        self.points = rng.uniform(-half, half, (self.again.count + 1, 3))

    def along(self, axis: int, t: Floats) -> Floats:
        """Where the hand is, in metres, on axis 0, 1 or 2."""
        number, since = self.again.at(t)
        point = self.points[:, axis]
        moved = minimum_jerk(since / self.what.travel_s)
        return np.asarray(point[number] + (point[number + 1] - point[number]) * moved)
