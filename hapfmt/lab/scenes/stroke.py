"""A hand that draws a tool over a plane: a slow turn, once in about 5 s, with wandering speed,
heading and pressure; down at the beginning, up at the end, and up and down again in between where a
scene asks for it."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from .description import Stroke
from .waves import Floats, Grid, Repeats, Waves, minimum_jerk

APPROACH_M = 2e-3
TOUCH_S, LIFT_S, TRAVEL_S = 0.15, 0.10, 0.10
"""The hand waits 2 mm above the surface, starts down after 0.15 s, travels 0.1 s, and leaves so
that it is up again 0.1 s before the end; in recordings below 1 s all three shrink with it."""


class StrokeMotion:
    """What is not asked for is not computed: a flat plane does not care where on it the tip is."""

    def __init__(self, stroke: Stroke, grid: Grid, rng: np.random.Generator) -> None:
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
        """m/s."""
        slowest, fastest = self.stroke.speed_m_per_s
        half = (fastest - slowest) / 2
        return np.asarray(slowest + half + half * np.clip(self.pace.at(t) / 2, -1, 1))

    def heading(self, t: Floats) -> Floats:
        """Radians."""
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
        """What the hand would push with at rest, newtons."""
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
