"""Files with blocks of other files, forks, and repeated parts: every way to read one of them agrees.

A file, a second recording of the same set-up, a recording with other channels, and a fork: a copy of
the first file that was appended to on its own, so that it has the same file id.
"""

from __future__ import annotations

import io
import json
import random
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from terminal import called

import hapfmt
from hapfmt.errors import HapfmtError
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import walk
from hapfmt.format.wire import id_text
from hapfmt.reading.follow import Follower
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

RATE, TICKS, MORE = 1000, 120, 60
CLUSTER = Fraction(1, 50)
OURS, THEIRS, STRANGE = 7, 1 << 40, (1 << 63) + 5
BLOCK = 512
Truth = dict[str, list[dict[int, int]]]
"""By label: what each version of a recording has at each tick."""


class Known(NamedTuple):
    """A file, its file id, and what its samples are."""

    data: bytes
    file_id: int
    truth: Truth


def channels(number: int, count: int, ticks: int) -> list[hapfmt.Channel]:
    """Values that no other recording has at the same tick."""
    rows = 1 + number + 10 * np.cumsum(np.arange(ticks * count) % 7).reshape(count, ticks)
    return [
        hapfmt.Channel(
            row.astype(np.int32),
            RATE,
            calibration=hapfmt.Calibration(),
            label=f"{'y' if number == 4 else 'x'}{i}",
        )
        for i, row in enumerate(rows)
    ]


def truth_of(rows: list[hapfmt.Channel], start: int = 0) -> dict[str, dict[int, int]]:
    return {c.label: {start + t: int(v) for t, v in enumerate(c.stored)} for c in rows}


def record(path: Path, rows: list[hapfmt.Channel], **given: Any) -> None:
    inputs = [hapfmt.Input(row.label, RATE, calibration=hapfmt.Calibration()) for row in rows]
    with hapfmt.Recorder(path, inputs, cluster=CLUSTER, **given) as recorder:
        for row in rows:
            recorder.write(row.label, row.stored)


def written(number: int, file_id: int, count: int, path: Path) -> Known:
    rows = channels(number, count, TICKS)
    record(path, rows, canonical=file_id, metadata={"title": f"recording {number}"})
    truth = {label: [values] for label, values in truth_of(rows).items()}
    return Known(path.read_bytes(), file_id, truth)


def appended(base: Known, number: int, path: Path) -> Known:
    """A copy of the file with more samples in the same channels."""
    path.write_bytes(base.data)
    count = len(base.truth)
    rows = channels(number, count, MORE)
    record(path, rows, append=True)
    more = truth_of(rows, TICKS)
    truth = {label: [{**base.truth[label][0], **more[label]}] for label in base.truth}
    return Known(path.read_bytes(), base.file_id, truth)


@cache
def files() -> tuple[Known, Known, Known, Known, Known]:
    """The file, appended to; its fork; the file alone; the second recording; one of other
    channels."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.hapf"
        base, theirs = written(0, OURS, 3, path), written(2, THEIRS, 3, path.with_name("b.hapf"))
        strange = written(4, STRANGE, 5, path.with_name("c.hapf"))
        ours, fork = appended(base, 1, path), appended(base, 3, path)
    versions = base, ours, fork
    truth = {label: [known.truth[label][0] for known in versions] for label in base.truth}
    base, ours, fork = (known._replace(truth=truth) for known in versions)
    return ours, fork, base, theirs, strange


@cache
def edges(data: bytes) -> list[int]:
    """Where chunks begin, and the end."""
    return [chunk.offset for chunk in walk(BytesSource(data), [])] + [len(data)]


def block(data: bytes, rng: random.Random) -> tuple[int, int]:
    """Whole chunks, whole blocks, or any bytes."""
    way = rng.randrange(3)
    if way == 0:
        known = edges(data)
        first = rng.randrange(len(known) - 1)
        return known[first], known[min(first + rng.choice((1, 1, 2, 4, 8, 16)), len(known) - 1)]
    unit = BLOCK if way == 1 else 1
    start = unit * rng.randrange(len(data) // unit)
    return start, min(start + unit * rng.randrange(1, 2 + len(data) // unit), len(data))


def splice(data: bytes, own: bytes, rng: random.Random, told: Counter[str]) -> bytes:
    """One change; ``own``: the file as it was."""
    ours, fork, _, theirs, strange = files()
    kinds = {"a fork": fork, "the same set-up": theirs, "other channels": strange, "itself": ours}
    name, source = rng.choice([*kinds.items()])
    part = own if name == "itself" else source.data
    start, stop = block(part, rng)
    piece = part[start:stop]
    way = rng.randrange(8)
    at = start if way < 2 else rng.choice(edges(own)) if way < 5 else rng.randrange(len(data) + 1)
    if way < 4:
        told[f"blocks of {name} over others"] += 1
        return data[:at] + piece + data[at + len(piece) :]
    if way == 4:
        told[f"blocks of {name} between others"] += 1
        return data[:at] + piece + data[at:]
    if way == 5:
        told[f"the start of {name}"] += 1
        return part[:stop] + data[stop:]
    if way == 6:
        told[f"the end of {name}"] += 1
        return data[:at] + part[start:]
    told["cut or left out"] += 1
    return data[:at] + (data[at + rng.randrange(1, BLOCK) :] if rng.randrange(2) else b"")


def spliced(seed: int) -> tuple[bytes, bool, list[str]]:
    """The same file for the same number; whether a fork is in it, and what was done."""
    rng = random.Random(seed)
    own = rng.choice(files()[:1] * 2 + files()[2:4]).data
    told: Counter[str] = Counter()
    data = own if rng.randrange(3) else own[: rng.choice(edges(own))]
    for _ in range(rng.choice((1, 1, 2, 3))):
        data = splice(data, own, rng, told)
    forked = any("fork" in line for line in told)
    return data, forked, [*told]


class Facts(NamedTuple):
    """What a way to read says that the file is."""

    file_id: str | None
    title: str | None
    labels: tuple[str, ...]


def facts_of(catalogue: Any) -> Facts:
    file_id = None if catalogue.file_id is None else id_text(catalogue.file_id)
    labels = tuple(ref.label for ref in catalogue.channels)
    return Facts(file_id, catalogue.metadata.get("title"), labels)


def truth_by_id(file_id: int | None) -> Truth:
    for known in files():
        if known.file_id == file_id:
            return known.truth
    return {}


def wrong_samples(recording: hapfmt.Recording, truth: Truth) -> int:
    """Samples that no version of the recording has at their ticks."""
    wrong = 0
    for channel in recording.channels:
        for start, values in channel.segments():
            for tick, value in enumerate(values.tolist(), start):
                wrong += all(own.get(tick) != value for own in truth.get(channel.label, []))
    return wrong


def check_lost(reader: Reader, recording: hapfmt.Recording, truth: Truth) -> None:
    """Each sample of a channel that is described is delivered or named as lost, and never both."""
    for ref, channel in zip(reader.channels, recording.channels, strict=True):
        have = {t for span in channel.coverage for t in range(span.start, span.stop)}
        ids = {track.id for track in ref.tracks}
        lost: set[int] = set()
        for span in reader.lost:
            if span.track in ids:
                stop = TICKS + MORE if span.stop is None else span.stop
                lost |= set(range(span.start, stop))
        assert not have & lost, (ref.label, reader.lost)
        every = set.intersection(*map(set, truth.get(channel.label, [{}])))
        if not reader.catalogue.closed:
            # What came after the last part is unknown, and "not-closed" says so.
            every = {tick for tick in every if tick < max(have | lost, default=0)}
        assert every <= have | lost, (ref.label, reader.lost, reader.findings)


def check(seed: int, folder: Path, opened: Callable[[Path], Any] | None = None) -> list[str]:
    """One file by every way to read it: the same id, title and channels, or an error; no wrong
    sample, and nothing lost in silence. AssertionError where that does not hold. ``opened``: what
    the viewer says of a file."""
    data, forked, told = spliced(seed)
    path = folder / "spliced.hapf"
    path.write_bytes(data)
    try:
        with Reader(data, scan=True, threads=1) as reader:
            whole = reader.read()
            facts, truth = facts_of(reader.catalogue), truth_by_id(reader.catalogue.file_id)
            assert not wrong_samples(whole, truth)
            check_lost(reader, whole, truth)
            damaged = bool(reader.findings)
    except HapfmtError as error:
        # A rule that is broken where nothing is damaged, or no chunk at all.
        assert error.exit_code in (2, 4)
        return [*told, "refused"]
    check_ways(data, path, facts, truth, forked)
    if opened is not None:
        page = opened(path)
        labels = tuple(channel["label"] for channel in page["channels"])
        seen = Facts(facts.file_id, page["metadata"].get("title"), labels)
        assert seen == facts or forked, (seen, facts)
    report = verify(data, threads=1)
    assert report.error is None or not damaged
    assert report.damage is not None
    assert tuple(row["label"] for row in report.damage["channels"]) == facts.labels
    out = io.BytesIO()
    try:
        hapfmt.recover(data, out, canonical=9)
    except HapfmtError:
        return [*told, "read, not recovered"]
    with Reader(out.getvalue(), threads=1) as again:
        back = {c.label: c for c in again.read().channels}
        for channel in whole.channels:
            other = back[channel.label]
            assert other.coverage == channel.coverage
            assert np.array_equal(other.stored, channel.stored)
    return [*told, "damaged" if damaged else "intact"]


def check_ways(data: bytes, path: Path, facts: Facts, truth: Truth, forked: bool) -> None:
    """By the index, a part in time, a channel, by the command line, and while it grows."""
    found: dict[str, Facts] = {}
    with Reader(data, threads=1) as reader:
        found["index"] = facts_of(reader.catalogue)
        for name, given in (
            ("part", {"start": 0.01, "stop": 0.05}),
            ("channel", {"channels": [0]}),
        ):
            try:
                part = reader.read(**given)
            except HapfmtError:
                continue
            found[name] = facts_of(reader.catalogue)
            assert not wrong_samples(part, truth), name
    told = called("info", path, "--json")
    if told.code in (0, 3):
        said = json.loads(told.out)
        title = said["metadata"].get("title")
        found["info"] = Facts(said["file_id"], title, tuple(c["label"] for c in said["channels"]))
    out = path.with_name("part.hapf")
    if called("subset", path, out, "--start", "0.01", "--stop", "0.05", "--force").code == 0:
        with Reader(out, threads=1) as reader:
            found["subset"] = facts_of(reader.catalogue)._replace(file_id=facts.file_id)
            assert not wrong_samples(reader.read(), truth), "subset"
    with suppress(HapfmtError), Follower(path, timeout=0) as follower:
        for _ in follower.chunks():
            pass
        if follower.file_id is not None:
            found["follow"] = facts_of(follower.catalogue)
    for way, other in found.items():
        # Chunks of a fork have the same id: only its samples tell them apart.
        same = other.file_id == facts.file_id if forked else other == facts
        assert same, (way, other, facts)
