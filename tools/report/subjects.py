"""The recordings and scenes that codecs are measured on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench import counted, counts_of
from numpy.typing import NDArray

import hapfmt
from hapfmt.convert import FORMATS
from hapfmt.kernels import compiled
from hapfmt.scenes import load_scene, simulate
from report.section import Options

SCENES = ("stone", "sand", "cork", "wall", "taps", "grasp", "free")
QUICK_SCENES = ("sand", "grasp")
SECONDS, QUICK_SECONDS = 10.0, 1.0
SAMPLES, QUICK_SAMPLES = 120_000, 10_000
"""Of a recording at most, from its begin: what follows is more of the same, and takes minutes."""


class Subject(NamedTuple):
    """Channels of one recording; ``integers`` where they are counts, None where doubles."""

    name: str
    simulated: bool
    recording: hapfmt.Recording
    integers: list[NDArray[np.int64]] | None

    @property
    def truth(self) -> list[NDArray[np.float64]]:
        return [channel.samples() for channel in self.recording.channels]


def subjects(options: Options) -> Iterator[Subject]:
    """Scenes, then the first recording of each folder."""
    short = options.quick or compiled is None  # the readable loops take 2 to 100 times as long
    seconds, most = (QUICK_SECONDS, QUICK_SAMPLES) if short else (SECONDS, SAMPLES)
    for name in QUICK_SCENES if options.quick else SCENES:
        recording, _ = simulate(load_scene(name).changed(seconds=seconds))
        yield from prepared(name, True, recording)
    if options.data is None:
        return
    for path in first_of_each(options.data)[: 2 if options.quick else None]:
        try:
            loaded = hapfmt.read(path)
        except hapfmt.HapfmtError as error:
            options.progress(f"left out: {error}")
            continue
        name = str(path.relative_to(options.data).with_suffix("")).removeprefix("unlicensed/")
        yield from prepared(name, False, shortened(loaded, most))


def first_of_each(folder: Path) -> list[Path]:
    """Files that can be read and hold their own rate, one a folder."""
    found: dict[Path, Path] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in FORMATS and path.suffix.lower() != ".csv":
            found.setdefault(path.parent, path)
    return list(found.values())


def shortened(recording: hapfmt.Recording, samples: int) -> hapfmt.Recording:
    """Its begin, all channels up to the same time."""
    if recording.sample_count <= samples:
        return recording
    ends = recording.duration * Fraction(samples, recording.sample_count)
    cut = tuple(
        channel.slice_ticks(0, int(ends * channel.rate_exact)) for channel in recording.channels
    )
    return replace(recording, channels=cut, events=())


def prepared(name: str, simulated: bool, recording: hapfmt.Recording) -> Iterator[Subject]:
    """Channels on a lattice in counts, as their sensors gave them, so that all coders get the same
    integers; and those of true doubles apart, as a subject of their own. Constants alone: none."""
    kept = [
        channel
        for channel in recording.channels
        if channel.stored.size and np.isfinite(channel.samples()).all()
    ]
    search = all(channel.lsb is None for channel in kept)
    found = [(channel, counts_of(channel, search=search)) for channel in kept]
    whole = [(channel, counts) for channel, counts in found if counts is not None]
    doubles = tuple(channel for channel, counts in found if counts is None)
    if any(np.ptp(counts) for _, counts in whole):
        channels = tuple(counted(channel, counts) for channel, counts in whole)
        integers = [counts for _, counts in whole]
        yield Subject(name, simulated, replace(recording, channels=channels), integers)
    if any(np.ptp(channel.stored) for channel in doubles):
        apart = f"{name}, doubles"
        yield Subject(apart, simulated, replace(recording, channels=doubles), None)
