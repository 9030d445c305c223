"""Recordings for measurements where none are at hand: a glove of any length, styluses, doubles."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

import hapfmt
from hapfmt.lab.scenes.stylus import simulate

SENSORS = 22
"""Sensors of a CyberGlove."""

BLOCK = 1 << 16
"""Ticks computed at a time: memory beyond the counts is that of one block."""

WAVES_HZ = (0.05, 0.11, 0.23, 0.47, 0.9, 1.7)
"""A hand that opens and closes, each joint at its own pace."""

DEGREES = 30.0
NOISE_COUNTS = 0.6
STEP = hapfmt.Calibration(1, 0, 20)
"""0.05 degrees a count."""


def glove(seconds: float, rate_hz: int = 1000, sensors: int = SENSORS) -> hapfmt.Recording:
    """Joint angles in counts; the same arguments give the same counts."""
    ticks = round(seconds * rate_hz)
    channels = []
    for sensor in range(sensors):
        rng = np.random.Generator(np.random.PCG64([7, sensor]))
        pace, phase = (
            rng.uniform(0.8, 1.25, len(WAVES_HZ)),
            rng.uniform(0, 2 * np.pi, len(WAVES_HZ)),
        )
        counts = np.empty(ticks, np.int16)
        for at in range(0, ticks, BLOCK):
            t = np.arange(at, min(at + BLOCK, ticks)) / rate_hz
            angle = np.zeros(t.size)
            for hz, p, start in zip(WAVES_HZ, pace, phase, strict=True):
                angle += np.sin(2 * np.pi * hz * p * t + start) * DEGREES / (1 + 4 * hz)
            noisy = angle * STEP.d + rng.normal(0, NOISE_COUNTS, t.size)
            counts[at : at + t.size] = np.floor(noisy + 0.5)
        channels.append(
            hapfmt.Channel(
                counts,
                Fraction(rate_hz),
                calibration=STEP,
                label=f"joint {sensor}",
                unit="deg",
                quantity="angle",
            )
        )
    return hapfmt.Recording(tuple(channels))


def drift(seconds: float, rate_hz: int = 1000) -> hapfmt.Recording:
    """Floating point values: three filtered forces without a common step."""
    rng = np.random.Generator(np.random.PCG64(11))
    steps: NDArray[np.float64] = rng.normal(0, 0.003, (3, round(seconds * rate_hz)))
    forces = np.cumsum(steps, axis=1)
    forces += 0.002 * rng.normal(size=forces.shape)
    return hapfmt.Recording(
        tuple(
            hapfmt.Channel.from_physical(force, rate_hz, label=f"force {axis}", unit="N")
            for force, axis in zip(forces, "xyz", strict=True)
        )
    )


def recordings(seconds: float = 10.0) -> dict[str, hapfmt.Recording]:
    """By name: textures under a stylus, a glove, and doubles."""
    found = {
        f"simulated {texture}": simulate(texture, seconds, axes=3)
        for texture in ("stone", "sand", "cork")
    }
    found["simulated glove"] = glove(seconds)
    found["simulated doubles"] = drift(seconds)
    return found
