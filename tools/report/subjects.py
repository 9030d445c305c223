"""The recordings and scenes that codecs are measured on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bench import counted, counts_of
from measured import files_in
from numpy.typing import NDArray

import hapfmt
from hapfmt.convert.formats import read_suffixes
from hapfmt.kernels import compiled
from hapfmt.lab.scenes import load_scene, simulate
from report.section import Options

SCENES = ("stone", "sand", "cork", "wall", "taps", "grasp", "free")
QUICK_SCENES = ("sand", "grasp")
SECONDS, QUICK_SECONDS = 10.0, 1.0
SAMPLES, QUICK_SAMPLES = 60_000, 10_000
"""Most samples of a recording, all channels together, from its middle: all of ../shared/data would
take hours."""

QUICK_RECORDINGS = 2


class Subject(NamedTuple):
    """Channels of one recording; ``integers`` where they are counts, None where doubles."""

    name: str
    simulated: bool
    recording: hapfmt.Recording
    integers: list[NDArray[np.int64]] | None

    @property
    def truth(self) -> list[NDArray[np.float64]]:
        return [channel.samples() for channel in self.recording.channels]


class Listed(NamedTuple):
    """A scene or file, and what of it was measured; ``skipped`` says why something was not."""

    name: str
    channels: int = 0
    samples: int = 0
    measured: int = 0
    start_s: float | None = None
    stop_s: float | None = None
    skipped: str = ""


LISTED = ("recording", "channels", "samples", "measured", "from, s", "to, s", "skipped")


def subjects(options: Options, listed: list[Listed]) -> Iterator[Subject]:
    """Scenes, then every recording of the folder, linked folders too; each adds to ``listed``."""
    short = options.quick or compiled is None  # the readable loops take 2 to 100 times as long
    seconds, most = (QUICK_SECONDS, QUICK_SAMPLES) if short else (SECONDS, SAMPLES)
    for name in QUICK_SCENES if options.quick else SCENES:
        recording, _ = simulate(load_scene(name).changed(seconds=seconds))
        yield from measured_of(name, True, recording, recording, listed)
    if options.data is None:
        return
    paths = recordings_in(options.data)
    for place, path in enumerate(paths):
        name = str(path.relative_to(options.data)).removeprefix("unlicensed/")
        if options.quick and place >= QUICK_RECORDINGS:
            listed.append(Listed(name, skipped="--quick measures two recordings"))
            continue
        try:
            loaded = hapfmt.read(path)
        except hapfmt.HapfmtError as error:
            listed.append(Listed(name, skipped=str(error).removeprefix(f"{path}: ")))
            continue
        name = name.removesuffix(path.suffix)
        yield from measured_of(name, False, loaded, shortened(loaded, most), listed)


def recordings_in(folder: Path) -> list[Path]:
    """Files of a format that hapfmt reads."""
    known = {*read_suffixes(), ".hapf"}
    return [path for path in files_in(folder) if path.suffix.lower() in known]


def shortened(recording: hapfmt.Recording, samples: int) -> hapfmt.Recording:
    """The middle of a recording, all channels between the same times."""
    if recording.sample_count <= samples:
        return recording
    first, last = extent_of(recording)
    half = (last - first) * Fraction(samples, recording.sample_count) / 2
    start, stop = (first + last) / 2 - half, (first + last) / 2 + half
    cut = tuple(
        channel.slice_ticks(int(start * channel.rate_exact), int(stop * channel.rate_exact))
        for channel in recording.channels
    )
    return replace(recording, channels=cut, events=())


def extent_of(recording: hapfmt.Recording) -> tuple[Fraction, Fraction]:
    """Seconds of the first sample and after the last."""
    spans = [
        (span.start / channel.rate_exact, span.stop / channel.rate_exact)
        for channel in recording.channels
        for span in channel.coverage
    ]
    return min(start for start, _ in spans), max(stop for _, stop in spans)


def why_not(channel: hapfmt.Channel) -> str:
    x = channel.samples()
    if not x.size:
        return "no samples"
    return "constant" if np.isfinite(x).all() else "values that are not finite"


def measured_of(
    name: str, simulated: bool, whole: hapfmt.Recording, part: hapfmt.Recording,
    listed: list[Listed],
) -> Iterator[Subject]:  # fmt: skip
    """The subjects of one recording, and its line in the list."""
    if not whole.sample_count:
        listed.append(Listed(name, len(whole), skipped="no samples"))
        return
    found = list(prepared(name, simulated, part))
    kept = {channel.label for subject in found for channel in subject.recording.channels}
    start, stop = extent_of(part)
    reasons = [
        f"channel {channel.label!r}: {why_not(channel)}"
        for channel in part.channels
        if channel.label not in kept
    ]
    if part.sample_count < whole.sample_count:
        reasons.append(f"samples outside the middle {float(stop - start):.3g} s")
    size = sum(subject.recording.sample_count for subject in found)
    listed.append(
        Listed(name, len(whole), whole.sample_count, size, float(start), float(stop),
               "; ".join(reasons))
    )  # fmt: skip
    yield from found


def prepared(name: str, simulated: bool, recording: hapfmt.Recording) -> Iterator[Subject]:
    """Channels on a grid as the counts of their sensors, so that all coders get the same integers;
    floating point channels as a subject of their own. No subject for constants alone."""
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
