"""Devices and files that replay is measured with."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from simulated import SENSORS, glove

import hapfmt

BLOCK_S = 60
"""Seconds of samples that are made; a longer file plays them forwards and backwards."""

FORCE = hapfmt.Calibration(1, 0, 400)
"""Joint angles as forces: up to some 3 N, which is within the limits of the gloves."""


@dataclass(frozen=True)
class Case:
    """A built-in profile, and what a file for it has."""

    title: str
    profile: str
    actuators: int
    rate: int = 1000
    frame_samples: int = 1
    unit: str = "N"

    @property
    def period_s(self) -> float:
        return self.frame_samples / self.rate

    @property
    def report_size(self) -> int:
        """With the report id."""
        return 142 if self.frame_samples > 1 else 2 + 2 * self.actuators


CASES = (
    Case("5 at 1 kHz", "glove5", 5),
    Case("22 at 1 kHz", "glove22", 22),
    Case("2 PCM at 3 kHz", "dualsense-bluetooth-haptics", 2, 3000, 32, "m/s2"),
)


def make_file(case: Case, seconds: float, path: Path) -> None:
    """Smooth motion at the rate of the device."""
    joints = glove(seconds, case.rate, case.actuators).channels
    channels = tuple(
        hapfmt.Channel(c.stored, c.rate_exact, calibration=FORCE, label=c.label, unit=case.unit)
        for c in joints
    )
    hapfmt.write(hapfmt.Recording(channels), str(path), force=True)


def make_hours(path: Path, hours: float) -> None:
    """22 forces at 1 kHz, coded as they would be while they are recorded."""
    block: NDArray[np.int16] = np.column_stack([c.stored for c in glove(BLOCK_S).channels])
    block = np.concatenate([block, block[::-1]])
    inputs = [
        hapfmt.Input(f"joint {n}", Fraction(1000), "N", calibration=FORCE) for n in range(SENSORS)
    ]
    settings = hapfmt.Settings.of("lossless", fast=True)
    with hapfmt.Recorder(str(path), inputs, settings, force=True) as recorder:
        for second in range(round(hours * 3600)):
            at = second * 1000 % len(block)
            recorder.write_rows(block[at : at + 1000])
