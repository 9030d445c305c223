"""Encodes the conditions of a study as .hapf files in one folder, once, with reproducible bytes.

Every condition is played with the same gain. A level change by a preset is part of the condition
and is not compensated.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import HapfmtError, ParameterError
from ...files import atomic_write
from ...recording import Channel, Recording, Span
from ...version import __version__
from .description import Condition, Study, StudySession, open_regular

MANIFEST = "prepared.json"
LARGEST_MANIFEST = 64 << 20
"""Bytes."""
SHORTER_S = 0.05
"""A file of one's own may differ so much in length from the reference."""
LOSSLESS = {"preset": "lossless"}


class Stimulus(NamedTuple):
    """One condition of one session, as it is played."""

    session: str
    condition: str
    path: Path
    sha256: str
    file_size: int
    sample_count: int

    @property
    def bits_per_sample(self) -> float:
        return 8 * self.file_size / max(self.sample_count, 1)


class Prepared(NamedTuple):
    stimuli: tuple[Stimulus, ...]
    folder: Path

    def file(self, session: str, condition: str) -> Path:
        return next(
            s.path for s in self.stimuli if (s.session, s.condition) == (session, condition)
        )

    @property
    def digest(self) -> str:
        """SHA-256 of all that can be felt."""
        rows = sorted([s.session, s.condition, s.sha256] for s in self.stimuli)
        return hashlib.sha256(json.dumps(rows).encode()).hexdigest()

    def bits_per_sample(self, condition: str) -> dict[str, float]:
        """By session."""
        found = (s for s in self.stimuli if s.condition == condition)
        return {each.session: each.bits_per_sample for each in found}


def prepare(
    study: Study, folder: Path, progress: Callable[[int, int], None] = lambda _done, _all: None
) -> Prepared:
    """What lies in the folder, if it is all there and of this study and these recordings; else it
    is made."""
    sources = [digest_of(path) for path in sources_of(study)]
    found = {"version": 1, "study_sha256": study.digest, "sources": sources, "hapfmt": __version__}
    stimuli = load(folder, found)
    if stimuli is None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / MANIFEST).unlink(missing_ok=True)
        stimuli = make(study, folder, progress)
        rows = [{**s._asdict(), "path": s.path.name} for s in stimuli]
        with atomic_write(folder / MANIFEST) as stream:
            stream.write(json.dumps({**found, "stimuli": rows}, indent=1).encode() + b"\n")
    return Prepared(tuple(stimuli), folder)


def sources_of(study: Study) -> list[Path]:
    own = [file for each in study.conditions for file in each.files.values()]
    return [study.beside(file) for file in (*(s.recording for s in study.sessions), *own)]


def digest_of(path: Path) -> str:
    with open_regular(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def load(folder: Path, wanted: dict[str, Any]) -> list[Stimulus] | None:
    """The stimuli prepared earlier, if every byte is intact; else None."""
    try:
        with open_regular(folder / MANIFEST, LARGEST_MANIFEST) as stream:
            found = json.loads(stream.read())
        rows = found.pop("stimuli")
        if found != wanted:
            return None
        stimuli = [Stimulus(**{**row, "path": folder / row["path"]}) for row in rows]
        whole = all(digest_of(each.path) == each.sha256 for each in stimuli)
    except (HapfmtError, OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None
    return stimuli if whole else None


def make(study: Study, folder: Path, progress: Callable[[int, int], None]) -> list[Stimulus]:
    found = []
    total = len(study.sessions) * len(study.conditions)
    for number, session in enumerate(study.sessions, 1):
        reference = load_session(study, session)
        for place, condition in enumerate(study.conditions, 1):
            # Numbers, so that the name of a file tells a subject nothing.
            path = folder / f"session-{number:02d}-{place:02d}.hapf"
            try:
                own = condition.files.get(session.name)
                if own is None:
                    encode(reference, condition, path)
                else:
                    copy(study.beside(own), reference, path)
            except HapfmtError as error:
                where = f"condition {condition.name!r} of session {session.name!r}"
                raise ParameterError(f"{where}: {error}", path=str(study.path)) from error
            size, samples = path.stat().st_size, reference.sample_count
            made = Stimulus(session.name, condition.name, path, digest_of(path), size, samples)
            found.append(made)
            progress(len(found), total)
    return found


def load_session(study: Study, session: StudySession) -> Recording:
    """The channels of the session, cut to its time range, which then starts at 0."""
    from ...convert import read as read_any
    from ...reading.reader import Reader

    path = study.beside(session.recording)
    if path.suffix.lower() == ".hapf":
        with Reader(str(path)) as reader:
            whole = reader.read()
            if reader.findings or reader.lost:
                raise ParameterError("is damaged; hapfmt recover it first", path=str(path))
    else:
        whole = read_any(str(path))
    channels = [stretch(each, session.from_s, session.to_s) for each in whole.channels]
    if not any(channel.stored.size for channel in channels):
        raise ParameterError(f"session {session.name!r} holds no sample", path=str(path))
    return Recording(tuple(channels))


def stretch(channel: Channel, from_s: float | None, to_s: float | None) -> Channel:
    start = 0 if from_s is None else ceil(Fraction(repr(from_s)) * channel.rate_exact)
    stop = channel.stop_tick if to_s is None else ceil(Fraction(repr(to_s)) * channel.rate_exact)
    part = channel.slice_ticks(start, stop)
    coverage = tuple(Span(span.start - start, span.stop - start) for span in part.coverage)
    return replace(part, coverage=coverage)


def encode(reference: Recording, condition: Condition, path: Path) -> None:
    from ...encoder.settings import Settings, renamed
    from ...writing.writer import write

    given = dict(condition.coding or LOSSLESS)
    recording = reference
    if condition.low_pass_hz is not None:
        cutoff = condition.low_pass_hz
        recording = Recording(tuple(low_passed(each, cutoff) for each in reference.channels))
    of_paper = {"bits", "step", "interpolation"} & given.keys()
    preset, given = renamed(given.pop("preset", "paper" if of_paper else "perceptual"), given)
    settings = Settings.of(preset, **given, smallest=False)
    write(recording, path, settings, canonical="content", force=True)


def low_passed(channel: Channel, cutoff_hz: float) -> Channel:
    """Without delay, each stretch between two gaps by itself; counts stay counts."""
    from ...split import low_pass

    if not channel.stored.size or 2 * cutoff_hz >= channel.rate_exact:
        return channel
    physical = replace(channel, stored=channel.samples(), calibration=None, exact=None)
    slow = np.concatenate(
        [low_pass(x, float(channel.rate_exact), cutoff_hz) for _, x in physical.segments()]
    )
    if channel.calibration is None:
        return replace(physical, stored=slow)
    a, b, d = channel.calibration.a, channel.calibration.b, channel.calibration.d
    counts = np.floor((slow * d - b) / a + 0.5).astype(channel.stored.dtype)
    return replace(channel, stored=counts, exact=None, deviation=None)


def copy(source: Path, reference: Recording, path: Path) -> None:
    """A file that is there already, if it may stand for the reference."""
    from ...reading.reader import Reader

    with Reader(str(source)) as reader:
        labels = [each.label for each in reader.channels]
        back = reader.read()
        if reader.findings or reader.lost:
            raise ParameterError("is damaged; hapfmt recover it first", path=str(source))
    wanted = [each.label for each in reference.channels]
    if labels != wanted:
        raise ParameterError(
            f"has the channels {', '.join(labels)}, and the reference {', '.join(wanted)}",
            path=str(source),
        )
    if abs(back.duration - reference.duration) > SHORTER_S:
        raise ParameterError(
            f"lasts {float(back.duration):g} s, and the reference {float(reference.duration):g} s",
            path=str(source),
        )
    with atomic_write(path, force=True) as stream:
        stream.write(source.read_bytes())
