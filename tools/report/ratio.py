"""The paper's Fig. 4: compression ratio against the Weber fraction k, for residuals of b bits.

F. Brandi, R. Chaudhari, E. Steinbach, "Texture compensation for haptic feedback signal
compression", VECIMS 2011, https://doi.org/10.1109/VECIMS.2011.6053837.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np

import hapfmt
from hapfmt.encoder.settings import Tolerance
from hapfmt.lab.scenes import load_scene, simulate
from hapfmt.metrics import snr_hf_db

WEBER = (1, 2, 5, 10, 15, 20, 30, 40, 50)
BITS = (0, 2, 5, 8)
SECONDS = 11.0
"""Length of the paper's sessions."""

TEXTURES = ("stone", "sand", "cork")

SAMPLE_SIZE = 8
"""Bytes of a sample before coding, as the paper counts: a double."""


class Source(NamedTuple):
    """A recording that is measured, and the absolute floor of its deadband."""

    name: str
    recording: hapfmt.Recording
    floor: str


class Point(NamedTuple):
    """One setting. Sizes in bytes: payload is that of all packets, file is everything."""

    percent: float
    bits: int
    payload_size: int
    file_size: int
    sample_count: int
    snr_db: float
    file: bytes

    @property
    def payload_percent(self) -> float:
        """Size of the payload in percent of the samples as doubles."""
        return 100 * self.payload_size / (SAMPLE_SIZE * self.sample_count)

    @property
    def file_percent(self) -> float:
        return 100 * self.file_size / (SAMPLE_SIZE * self.sample_count)


class Recorded(NamedTuple):
    path: str
    channels: tuple[str, ...]
    floor: str
    name: str


RECORDED = (
    Recorded("teleop1dof/question1a_foam.npz", ("tau_env",), "0.2%", "foam, torque"),
    Recorded("teleop1dof/question1a_rigid.npz", ("tau_env",), "0.2%", "rigid, torque"),
    Recorded("panda_comanip/symbol17_3.npz", ("fx", "fy", "fz"), "0.01", "hand-guided, force"),
)
"""Contact forces, and torques at a lever that touches, with an HF part of 1 % of the range and
more. A floor of 10 mN for forces; torques have 0.2 % of their range."""


def simulated(seconds: float = SECONDS) -> list[Source]:
    return [
        Source(name, simulate(load_scene(name).changed(seconds=seconds))[0], "0.01")
        for name in TEXTURES
    ]


def recorded(folder: Path | None, count: int = len(RECORDED)) -> list[Source]:
    """Those that the folder has."""
    found = []
    for each in RECORDED[:count]:
        path = (folder or Path()) / each.path
        if folder and path.exists():
            recording = hapfmt.read(path)
            channels = tuple(recording.channel(label) for label in each.channels)
            found.append(Source(each.name, replace(recording, channels=channels), each.floor))
    return found


def settings(percent: float, bits: int, floor: str) -> hapfmt.Settings:
    k = Fraction(percent) / 100
    return hapfmt.Settings.of("paper", k=k, bits=bits, floor=Tolerance.parse(floor))


def measure(source: Source, chosen: hapfmt.Settings) -> Point:
    stream = io.BytesIO()
    summary = hapfmt.write(source.recording, stream, chosen, canonical=1)
    file = stream.getvalue()
    back = hapfmt.read(file)
    snr = np.median(
        [
            snr_hf_db(a.samples(), b.samples(), a.rate)
            for a, b in zip(source.recording.channels, back.channels, strict=True)
        ]
    )
    return Point(
        float(100 * chosen.k),
        chosen.bits or 0,
        summary.payload_size,
        summary.file_size,
        source.recording.sample_count,
        float(snr),
        file,
    )


def grid(
    source: Source, weber: tuple[int, ...] = WEBER, bits: tuple[int, ...] = BITS
) -> Iterator[Point]:
    """All settings, the bits of one k side by side."""
    for percent in weber:
        for count in bits:
            yield measure(source, settings(percent, count, source.floor))
