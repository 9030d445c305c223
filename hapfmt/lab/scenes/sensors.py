"""Sensor model: adds noise, quantises to counts, and clips at the end of the range."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...recording import Calibration
from .description import Sensor, Work
from .motion import Floats

RESOLUTION_BITS = 31
READ_SAMPLES = 1 << 18
"""Samples read at a time."""


@dataclass(frozen=True)
class Reading:
    """Unit and quantity of a channel; its step, range in counts, and noise (rms) in the unit."""

    unit: str
    quantity: str
    calibration: Calibration
    most: int
    noise: float

    def counts(self, values: Floats, rng: np.random.Generator, work: Work) -> NDArray[Any]:
        """[ticks] in the unit to counts, int16 where they fit: nearest ones, saturated."""
        out = np.empty(values.size, np.int16 if self.most < 1 << 15 else np.int32)
        for start in range(0, values.size, READ_SAMPLES):
            block = values[start : start + READ_SAMPLES]
            noisy = block + rng.normal(0, self.noise, block.size)
            counts = np.floor(noisy * self.calibration.d / self.calibration.a + 0.5)
            work.saturated_count += int(
                np.count_nonzero((counts > self.most) | (counts < -self.most - 1))
            )
            out[start : start + READ_SAMPLES] = np.clip(counts, -self.most - 1, self.most)
        work.channel_count += 1
        work.sample_count += values.size
        return out


WIDEST = (1 << RESOLUTION_BITS) - 1
POSITION = Reading("m", "position", Calibration(1, 0, 1_000_000), WIDEST, 1e-6)
VELOCITY = Reading("m/s", "velocity", Calibration(1, 0, 100_000), WIDEST, 2e-5)
"""An optical tracker of 1 um, and velocities of 10 um/s; noise of one and of two steps."""

JOINT = Reading("rad", "angle", Calibration(1, 0, 1000), (1 << 15) - 1, 0.5e-3)
"""A glove of 1 mrad a count, noise of half a count."""


def force_reading(sensor: Sensor | None = None) -> Reading:
    """Without a description a 16-bit sensor of +-16.384 N: one count is 0.5 mN, noise one count."""
    sensor = sensor or Sensor()
    step = Fraction(repr(sensor.step_n))
    most = round(sensor.range_n / sensor.step_n) - 1
    calibration = Calibration(step.numerator, 0, step.denominator)
    return Reading("N", "force", calibration, most, sensor.noise_n)


def reading_of(label: str, sensor: Sensor | None) -> Reading:
    """How a sensor reads a tool's channel, by the channel's name."""
    if "force" in label:
        return force_reading(sensor)
    return POSITION if label.startswith("position") else VELOCITY
