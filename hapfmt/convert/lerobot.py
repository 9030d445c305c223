"""LeRobot datasets, versions 2.0 to 3.0 <-> Recording: one episode is one recording.

A dataset is a folder. ``meta/info.json`` gives the frames per second, the features (columns with a
shape and names) and where the rows of an episode are. Version 2 has a Parquet file for each
episode; in version 3 episodes share files, and ``meta/episodes`` says which rows they have.

Each frame that hapfmt writes has a window of samples: a feature of shape [samples, channels]. The
Parquet file says the rest in its metadata:

====================  =========================================================================
schema, key           JSON: ``version`` 1, ``fps`` as text "num/den", ``frames``, and the members
``hapfmt``            of the recording, as in arrowtables.py
field, key            JSON: ``window``, ``first_frame``, ``channels``: for each ``number`` in the
``hapfmt``            recording, ``dtype``, ``counts``, ``label``, ``unit`` ...
====================  =========================================================================
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from math import ceil, gcd, lcm
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, ParameterError, unknown
from ..limits import TICK_LIMIT
from ..numbers import checked_rate
from ..recording import Calibration, Channel, Event, Recording, unique
from ..units import split_name
from .arrowtables import (
    BATCH_SIZE,
    EVENTS,
    ROWS,
    TEXT_KEYS,
    WIDTH,
    Columns,
    Leaf,
    Sparse,
    arrow,
    arrow_errors,
    channel_numbers,
    channel_texts,
    chosen,
    column_values,
    import_of_columns,
    is_number,
    is_text,
    memory_check,
    parts_of,
    read_batches,
    text_events,
    texts_of,
)
from .common import choose_rate, not_carried, rate_from, refusing, unit_of
from .formats import Destination, ReadOptions, Source, WriteOptions
from .own import CARRIED, own_json, own_members, restored_counts, with_own
from .parquet import ParquetTable
from .tables import Import, ImportBlock, ImportColumn, ImportTable
from .timestamps import Placed, place, stamp_channel

INFO = "meta/info.json"
_TEXT_SIZE = 1 << 26
"""Bytes of a file of JSON."""
_EPISODE_FILES = 10_000
_EPISODES = 1 << 22
_TASKS = 1 << 16
_NAMES_DEPTH = 4
_LISTED = 20
_DATA = {
    2: "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    3: "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
}
_FIELD = re.compile(r"\{(\w+)(?::0?(\d{1,2})d)?\}")
_FRAME = {
    "timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64",
    "task_index": "int64",
}  # fmt: skip
"""Features that every dataset has: they describe the frames, and are no channels."""
_ON_TIME_S = 1e-4
"""LeRobot's own tolerance for time stamps."""


class Feature(NamedTuple):
    name: str
    dtype: str
    names: tuple[str, ...]
    """One for each place; empty where it has none."""


class Episode(NamedTuple):
    number: int
    length: int
    path: Path
    first_row: int | None
    """In the file; None: it is the whole file."""


@dataclass(frozen=True)
class Dataset:
    root: Path
    max_memory: int

    @cached_property
    def info(self) -> Mapping[str, Any]:
        if not (self.root / INFO).is_file():
            raise ParameterError(f"a LeRobot dataset is a folder with {INFO}")
        found = load_json(self.root / INFO)
        if not isinstance(found, dict):
            raise ParameterError(f"{INFO}: not a JSON object")
        return found

    @cached_property
    def version(self) -> int:
        """2 or 3."""
        text = str(self.info.get("codebase_version"))[:40]
        kind = re.fullmatch(r"v?([23])(\.\d+)*", text)
        if kind is None:
            raise ParameterError(f"the dataset has version {text!r}; hapfmt reads v2.0 to v3.0")
        return int(kind[1])

    @cached_property
    def fps(self) -> Fraction:
        given = self.info.get("fps")
        if isinstance(given, bool) or not isinstance(given, int | float | str):
            raise ParameterError(f"{INFO} has no fps")
        return rate_from(given)

    @cached_property
    def features(self) -> tuple[Feature, ...]:
        given = self.info.get("features")
        if not isinstance(given, dict) or not all(isinstance(one, dict) for one in given.values()):
            raise ParameterError(f"{INFO} has no features")
        return tuple(
            Feature(name, str(one.get("dtype")), tuple(flat_names(one.get("names"))))
            for name, one in given.items()
        )

    def path(self, **numbers: int) -> Path:
        """The file of some rows, by the pattern in the info."""
        pattern = self.info.get("data_path", _DATA[self.version])

        def number(found: re.Match[str]) -> str:
            return str(numbers.get(found[1], "{")).zfill(int(found[2] or 0))

        name = _FIELD.sub(number, pattern) if isinstance(pattern, str) else "{"
        outside = ".." in PurePosixPath(name).parts or PureWindowsPath(name).anchor
        if re.search(r"[{}\\\0]", name) or outside or len(name) > 1000:
            raise ParameterError(f"{INFO}: data_path does not name a file of the dataset")
        return self.root / name

    @cached_property
    def episodes(self) -> tuple[NDArray[np.int64], Callable[[int], Episode]]:
        """The numbers of all episodes, and what is known of the one at a place among them."""
        return self._listed() if self.version == 2 else self._tabulated()

    def _listed(self) -> tuple[NDArray[np.int64], Callable[[int], Episode]]:
        rows = load_lines(self.root / "meta/episodes.jsonl")
        with refusing("meta/episodes.jsonl", AttributeError):
            numbers = np.array([whole(row["episode_index"]) for row in rows], np.int64)
            lengths = [whole(row["length"]) for row in rows]
            size = max(whole(self.info.get("chunks_size", 1000)), 1)

        def episode(at: int) -> Episode:
            number = int(numbers[at])
            path = self.path(episode_chunk=number // size, episode_index=number)
            return Episode(number, lengths[at], path, None)

        return numbers, episode

    def _tabulated(self) -> tuple[NDArray[np.int64], Callable[[int], Episode]]:
        names = (
            "episode_index", "data/chunk_index", "data/file_index", "dataset_from_index",
            "dataset_to_index",
        )  # fmt: skip
        paths = sorted((self.root / "meta/episodes").glob("*/*.parquet"))
        if not paths or len(paths) > _EPISODE_FILES:
            raise ParameterError(f"meta/episodes has {len(paths)} files of a list of episodes")
        parts: list[list[NDArray[np.int64]]] = [[] for _ in names]
        rows = 0
        for path in paths:
            table = ParquetTable(path, self.max_memory)
            rows += table.row_count
            if rows > _EPISODES:
                raise LimitError(f"the dataset has more than {_EPISODES} episodes")
            for found, name in zip(parts, names, strict=True):
                found.append(whole_numbers(table, name, self.max_memory))
        numbers, chunks, files, firsts, lasts = map(np.concatenate, parts)

        def episode(at: int) -> Episode:
            same = (chunks == chunks[at]) & (files == files[at])
            first, last = int(firsts[at]), int(lasts[at])
            path = self.path(chunk_index=int(chunks[at]), file_index=int(files[at]))
            return Episode(int(numbers[at]), last - first, path, first - int(firsts[same].min()))

        return numbers, episode

    def episode(self, wanted: str | None) -> Episode:
        """The episode of a number; without one, the only one."""
        numbers, found = self.episodes
        if not numbers.size:
            raise ParameterError("the dataset has no episodes")
        listed = in_words(numbers)
        if wanted is None:
            if numbers.size > 1:
                raise ParameterError(
                    f"the dataset has {numbers.size} episodes ({listed}); choose one (episode=)"
                )
            return found(0)
        places = np.flatnonzero(
            numbers == (int(wanted) if re.fullmatch(r"\d{1,9}", wanted) else -1)
        )
        if not places.size:
            raise ParameterError(f"there is no episode {wanted!r}; the dataset has {listed}")
        return found(int(places[0]))

    def texts(self, name: str) -> dict[int, str]:
        """The texts that numbers stand for: of "task", or "subtask"."""
        with refusing(f"the {name}s of the dataset", AttributeError):
            lines = self.root / f"meta/{name}s.jsonl"
            if self.version == 2:
                rows = load_lines(lines) if lines.is_file() else []
                return {whole(row[f"{name}_index"]): str(row[name]) for row in rows}
            path = self.root / f"meta/{name}s.parquet"
            if not path.is_file():
                return {}
            table = ParquetTable(path, self.max_memory)
            if table.row_count > _TASKS:
                raise LimitError(f"the dataset has more than {_TASKS} {name}s")
            column = next(each.name for each in table.schema if is_text(each.type))
            numbers = whole_numbers(table, f"{name}_index", self.max_memory)
            texts: list[str] = []
            for batch in table.batches([column], ROWS):
                texts += batch.column(batch.schema.get_field_index(column)).to_pylist()
            return dict(zip(numbers.tolist(), map(str, texts), strict=True))


def load_json(path: Path) -> Any:
    if path.stat().st_size > _TEXT_SIZE:
        raise LimitError(f"{path.name} has more than {_TEXT_SIZE} bytes")
    with refusing(path.name, RecursionError):
        return json.loads(path.read_bytes())


def load_lines(path: Path) -> list[Any]:
    """A file of JSON, line by line."""
    if path.stat().st_size > _TEXT_SIZE:
        raise LimitError(f"{path.name} has more than {_TEXT_SIZE} bytes")
    with refusing(path.name, RecursionError):
        return [json.loads(line) for line in path.read_bytes().splitlines() if line.strip()]


def whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 1 << 62:
        raise ValueError(f"{str(value)[:40]!r} is not a row number")
    return value


def flat_names(given: Any, depth: int = 0) -> list[str]:
    """Names in a list, in lists of lists, or in a dictionary such as {"motors": [...]}."""
    if isinstance(given, str):
        return [given]
    if isinstance(given, dict):
        given = list(given.values())
    if not isinstance(given, list) or depth > _NAMES_DEPTH:
        return []
    return [name for each in given for name in flat_names(each, depth + 1)]


def in_words(numbers: NDArray[np.int64]) -> str:
    """0 to 49, or some of the numbers."""
    first, last = int(numbers.min()), int(numbers.max())
    if numbers.size == 1:
        return f"{first}"
    if last - first == numbers.size - 1:
        return f"{first} to {last}"
    more = " ..." if numbers.size > _LISTED else ""
    return ", ".join(map(str, numbers[:_LISTED].tolist())) + more


def numbers_in(table: ParquetTable, column: str, max_memory: int) -> NDArray[Any]:
    """The numbers of one column, all of them."""
    memory_check(8 * table.row_count, f"the values of {column!r}", max_memory)
    if not any(each.name == column and is_number(each.type) for each in table.schema):
        raise ParameterError(f"the table has no column {column!r} of numbers")
    arrays: list[NDArray[Any]] = []
    for batch in table.batches([column], ROWS):
        array = batch.column(batch.schema.get_field_index(column))
        if array.null_count:
            raise ParameterError(f"column {column!r} has empty cells")
        with arrow_errors(f"column {column!r} cannot be read"):
            arrays.append(array.to_numpy(zero_copy_only=False))
    return np.concatenate(arrays) if arrays else np.empty(0, np.int64)


def whole_numbers(table: ParquetTable, column: str, max_memory: int) -> NDArray[np.int64]:
    found = numbers_in(table, column, max_memory)
    if found.dtype.kind not in "iu" or (
        found.size and not 0 <= found.min() <= found.max() < 1 << 62
    ):
        raise ParameterError(f"column {column!r} holds other values than numbers of rows")
    return found.astype(np.int64)


# Reading


_PICTURES = ("image", "video")


def read(source: Source, options: ReadOptions) -> Import:
    arrow()
    dataset = Dataset(source.path, options.max_memory)
    if options.clock not in (None, *_CLOCKS):
        raise ParameterError(unknown("clock", str(options.clock), list(_CLOCKS)))
    episode = dataset.episode(options.episode)
    table = ParquetTable(episode.path, options.max_memory)
    notes: list[str] = []
    if episode.first_row is not None:
        table = table.rows(episode.first_row, episode.first_row + episode.length)
    elif table.row_count != episode.length:
        notes.append(
            f"meta/episodes.jsonl says {episode.length} frames, and there are {table.row_count}"
        )
    held = [each.name for each in table.schema]
    if "episode_index" in held:
        numbers = whole_numbers(table, "episode_index", options.max_memory)
        if (numbers != episode.number).any():
            raise ParameterError(f"the rows of episode {episode.number} are of another episode")
    texts = {key: dataset.texts(key) for key in ("task", "subtask") if f"{key}_index" in held}
    named = {*_FRAME, *(f"{key}_index" for key, found in texts.items() if found)}
    features = [each for each in dataset.features if each.name not in named]
    columns = Columns(table, only=[f.name for f in features if f.dtype not in _PICTURES])
    notes += [*_left_out(features, held), *columns.notes]
    leaves = chosen(columns, options.select)
    if not leaves:
        raise ParameterError("the dataset has no features of numbers")

    about = own_json(texts_of(table.schema.metadata).get("hapfmt"), "the metadata of the file")
    if about and about.get("version") != 1:
        raise ParameterError("the dataset was written by a later version of hapfmt")
    if "fps" not in about or about.get("frames") != table.row_count or dataset.episodes[0].size > 1:
        about = {}  # it belongs to the rows that were there once
    fps = rate_from(str(about["fps"])) if about else dataset.fps
    frames = _frames(table, choose_rate(options.rate, fps, notes), options, notes)
    if about:
        with refusing("the metadata of the file"):
            frames = frames._replace(first=frames.first + whole(about.get("first_frame", 0)))
    tables, blocks = _tables(table, leaves, columns, features, frames, options, notes,
                             f"episode {episode.number}")  # fmt: skip
    metadata: dict[str, Any] = {"episode": episode.number}
    if isinstance(dataset.info.get("robot_type"), str):
        metadata["robot_type"] = dataset.info["robot_type"]
    events: list[Event] = []
    for key, found in texts.items():
        if found and not about:
            codes = whole_numbers(table, f"{key}_index", options.max_memory)
            _add_texts(key, codes, found, frames, metadata, events, notes)
    if not options.select and not about:
        for column in columns.texts:
            events += text_events(table, column, frames.seconds, 1 / frames.rate, notes)
    made = Import(
        tables, blocks, metadata=metadata, events=tuple(events), notes=tuple(dict.fromkeys(notes))
    )
    return with_own(made, about)


def _left_out(features: Sequence[Feature], held: Sequence[str]) -> Iterator[str]:
    for each in features:
        if each.dtype == "video":
            yield f"the video {each.name!r} is not read"
        elif each.dtype == "image":
            yield f"the images {each.name!r} are not read"
        elif each.name not in held:
            yield f"the feature {each.name!r} has no column"
    described = {each.name for each in features}
    for name in held:
        if name not in described and name not in _FRAME and not name.endswith("task_index"):
            yield f"the column {name!r} is not a feature in {INFO}, and is not read"


class EpisodeFrames(NamedTuple):
    """Row i is frame ``first + ticks[i]``, or ``first + i`` where ``ticks`` is None.

    ``stamps``: how much later than its frame each time stamp is, in ns, where this was wanted.
    """

    rate: Fraction
    first: int
    ticks: NDArray[np.int64] | None
    rows: int
    stamps: NDArray[np.int64] | None

    def seconds(self, row: int) -> Fraction:
        return (self.first + (row if self.ticks is None else int(self.ticks[row]))) / self.rate

    def windows(self, size: int) -> NDArray[np.int64] | None:
        """Ticks of the samples in windows of a size, less that of the first frame."""
        if self.ticks is None:
            return None
        return (self.ticks[:, None] * size + np.arange(size)).ravel()


_CLOCKS = ("frame_index", "timestamp")


def _frames(
    table: ParquetTable, rate: Fraction, options: ReadOptions, notes: list[str]
) -> EpisodeFrames:
    """The frames by their numbers, which are compared with the time stamps, or by these."""
    rows, held = table.row_count, {each.name for each in table.schema}
    memory_check(32 * rows, "the numbers and times of the frames", options.max_memory)
    numbers = np.arange(rows)
    if "frame_index" in held:
        numbers = whole_numbers(table, "frame_index", options.max_memory)
        if (np.diff(numbers) < 1).any():
            raise ParameterError("the numbers of the frames do not rise")
    ns = np.empty(0, np.int64)
    if "timestamp" in held:
        seconds = numbers_in(table, "timestamp", options.max_memory).astype(np.float64)
        if options.clock == "timestamp" or options.keep_stamps:
            if not (np.abs(seconds) < 2.0**31).all():
                raise ParameterError("the time stamps are not finite, or too large")
            ns = np.rint(seconds * 1e9).astype(np.int64)
        if options.clock == "timestamp" and rows:
            placed = place(ns, name="column 'timestamp'", rate=rate)
            assert placed is not None  # a rate is given
            notes += placed.notes
            start = max(round(Fraction(placed.start_ns, 10**9) * rate), 0)
            numbers = placed.ticks + start
        else:
            _compare(seconds, numbers, rate, options, notes)
    elif options.clock == "timestamp" or options.keep_stamps:
        raise ParameterError("the dataset has no time stamps")
    if rows and numbers[-1] >= TICK_LIMIT >> 16:
        raise ParameterError(f"frame {numbers[-1]} is too far from the first")
    first = int(numbers[0]) if rows else 0
    ticks = None if not rows or numbers[-1] - first == rows - 1 else numbers - first
    if ticks is not None:
        notes.append(f"missing frames: {int(ticks[-1]) + 1 - rows}")
    stamps = None
    if options.keep_stamps:
        stamps = stamp_channel(Placed(rate, numbers, 0, (), 0, 0.0), ns, 0, 0)
    return EpisodeFrames(rate, first, ticks, rows, stamps)


def _compare(
    seconds: NDArray[np.float64],
    numbers: NDArray[np.int64],
    rate: Fraction,
    options: ReadOptions,
    notes: list[str],
) -> None:
    """A note where the time stamps differ from the frames; ParameterError from half a frame on."""
    if not seconds.size:
        return
    with np.errstate(all="ignore"):
        late = seconds - numbers.astype(np.float64) / float(rate)
        most = float(np.abs(late - np.median(late)).max())
    if not np.isfinite(most):
        raise ParameterError("the time stamps are not finite")
    rounding = float(np.spacing(np.float32(np.abs(seconds).max())))
    if most <= max(min(_ON_TIME_S, 0.1 / float(rate)), rounding):
        return
    differ = (
        f"the time stamps differ from {float(rate):.6g} frames per second by up to {most:.3g} s"
    )
    if most * float(rate) < 0.5 or options.clock == "frame_index" or options.rate is not None:
        notes.append(differ)
        return
    raise ParameterError(
        f"{differ}; place the frames by their number (clock='frame_index') or by their time "
        "(clock='timestamp')"
    )


def _add_texts(
    key: str,
    codes: NDArray[np.int64],
    texts: Mapping[int, str],
    frames: EpisodeFrames,
    metadata: dict[str, Any],
    events: list[Event],
    notes: list[str],
) -> None:
    """The task of the episode among the metadata; several tasks as events."""
    edges = np.flatnonzero(np.diff(codes, prepend=-1))
    if edges.size > EVENTS:
        notes.append(f"the {key}s are not read: they change more than {EVENTS} times")
        return
    strange = sorted({int(codes[edge]) for edge in edges} - set(texts))
    if strange:
        notes.append(f"the dataset names no {key} {in_words(np.array(strange))}")
    if edges.size == 1 and not strange:
        metadata[key] = texts[int(codes[0])]
        return
    stops = [*edges.tolist(), codes.size][1:]
    for first, stop in zip(edges.tolist(), stops, strict=True):
        text = texts.get(int(codes[first]))
        if text:
            start = frames.seconds(first)
            end = frames.seconds(stop - 1) + 1 / frames.rate
            events.append(Event(start, text, end - start, layer=key))


def _labels(leaves: Sequence[Leaf], features: Sequence[Feature]) -> dict[str, list[str]]:
    """The labels of the places of each leaf: its names, behind that of the feature where another
    feature has the same."""
    given = {each.name: each.names for each in features}
    found: dict[str, list[str]] = {}
    for leaf in leaves:
        names = list(given.get(leaf.name, ()))
        if len(names) != leaf.count:
            places = np.ndindex(*leaf.shape)
            names = [".".join([leaf.name, *map(str, at)]) for at in places]
            names = names if leaf.count > 1 else [leaf.name]
        found[leaf.name] = names
    times = Counter(label for names in found.values() for label in set(names))
    return {
        name: [f"{name}.{label}" for label in names] if any(times[x] > 1 for x in names) else names
        for name, names in found.items()
    }


def _tables(
    table: ParquetTable,
    leaves: Sequence[Leaf],
    columns: Columns,
    features: Sequence[Feature],
    frames: EpisodeFrames,
    options: ReadOptions,
    notes: list[str],
    name: str,
) -> tuple[tuple[ImportTable, ...], Callable[[], Iterator[ImportBlock]]]:
    """Features that hapfmt wrote are windows of samples; each place of others is a channel."""
    windows = windows_of(leaves)
    labels = _labels(columns.leaves, features)

    def describe(leaf: Leaf, at: int) -> ImportColumn:
        label, unit = split_name(labels[leaf.name][at])
        unit = next((leaf.metadata[key] for key in ("unit", "units") if key in leaf.metadata), unit)
        code = unit_of(unit, label, notes)
        source = unit if unit not in ("", code) else ""
        return ImportColumn(label, code, group=leaf.column, source_unit=source)

    plain = [leaf for leaf in leaves if window_size(leaf) is None]
    tables: tuple[ImportTable, ...] = ()
    read_windows = read_plain = None
    if windows:
        tables, read_windows = _import_of_windows(table, windows, leaves, frames, options)
    if plain or frames.stamps is not None:
        own = parts_of(plain, notes, describe)
        more, read_plain = import_of_columns(
            table, own, plain, frames.rate, frames.ticks, frames.first, options, name=name,
            stamps=frames.stamps,
        )  # fmt: skip
        tables += more

    def blocks() -> Iterator[ImportBlock]:
        if read_windows:
            yield from read_windows()
        if read_plain:
            for each in read_plain():
                yield each._replace(table=each.table + len(windows))

    return tables, blocks


class SampleWindow(NamedTuple):
    """A channel in the windows of a feature: value ``place`` of every ``channels``."""

    leaf: int
    place: int
    channels: int
    size: int
    """Samples of a channel in a frame."""
    number: int
    column: ImportColumn
    restored: Calibration | None
    """Physical values become counts by it."""

    def samples(
        self, wide: NDArray[Any], lacking: NDArray[np.bool_]
    ) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """The values of a batch, and where there are none."""
        shape = (len(wide), self.size, self.channels)
        x = wide.reshape(shape)[:, :, self.place].ravel()
        missing = lacking.reshape(shape)[:, :, self.place].ravel()
        if x.dtype.kind == "f":
            x[missing] = np.nan
            missing = np.isnan(x)
        return x, missing

    def converted(self, x: NDArray[Any], name: str) -> NDArray[Any]:
        dtype = self.column.dtype
        if self.restored is not None:
            counts = restored_counts(x, self.restored, dtype)
        elif dtype.kind == "f":
            return x
        else:
            with np.errstate(all="ignore"):
                counts = x.astype(dtype)
                counts = counts if (counts.astype(x.dtype) == x).all() else None
        if counts is None:
            raise ParameterError(
                f"feature {name!r} holds values that its channels do not have; remove the key "
                "'hapfmt' from the metadata of the field to read them as they are"
            )
        return counts


def window_size(leaf: Leaf) -> int | None:
    """Samples of a channel in a frame, where hapfmt wrote the feature."""
    what = f"the metadata of feature {leaf.name!r}"
    own = own_json(leaf.metadata.get("hapfmt"), what)
    if "window" not in own:
        return None
    with refusing(what, AttributeError):
        size, channels = whole(own["window"]), own["channels"]
        if not isinstance(channels, list) or size * len(channels) != leaf.count:
            raise ParameterError(f"{what} does not fit its shape")
    return size


def windows_of(leaves: Sequence[Leaf]) -> list[SampleWindow]:
    """In the order of the channels in the recording."""
    found = []
    for at, leaf in enumerate(leaves):
        size = window_size(leaf)
        if size is None:
            continue
        entries = own_json(leaf.metadata["hapfmt"], "")["channels"]
        for spot, entry in enumerate(entries):
            with refusing(f"the metadata of feature {leaf.name!r}", AttributeError):
                found.append(_window(entry, leaf, at, spot, len(entries), size))
    return sorted(found, key=lambda each: each.number)


def _window(
    entry: Mapping[str, Any], leaf: Leaf, at: int, place: int, count: int, size: int
) -> SampleWindow:
    dtype = np.dtype(str(entry["dtype"]))
    given = entry.get("calibration")
    calibration = None if given is None else Calibration(*given)
    fits = dtype.kind in "iu" if calibration or not leaf.is_float else dtype.kind in "iuf"
    if not fits or dtype.itemsize > 8 or (dtype.kind == "f" and dtype != leaf.dtype):
        raise ParameterError(f"the metadata of feature {leaf.name!r} names the dtype {dtype}")
    texts = {key: str(entry[key]) for key in TEXT_KEYS if key in entry}
    lsb = entry.get("lsb")
    column = ImportColumn(
        str(entry.get("label", "")), str(entry.get("unit", "1")), calibration=calibration,
        lsb=None if lsb is None else float(lsb), dtype=dtype,
    )  # fmt: skip
    return SampleWindow(
        at, place, count, size, whole(entry["number"]), replace(column, **texts),  # type: ignore[arg-type]
        None if entry.get("counts") else calibration,
    )  # fmt: skip


def _import_of_windows(
    table: ParquetTable,
    windows: Sequence[SampleWindow],
    leaves: Sequence[Leaf],
    frames: EpisodeFrames,
    options: ReadOptions,
) -> tuple[tuple[ImportTable, ...], Callable[[], Iterator[ImportBlock]]]:
    """A table for each channel, since each has gaps of its own."""
    used = sorted({each.leaf for each in windows})

    def passes(wanted: Sequence[int]) -> Iterator[dict[int, Any]]:
        for batch in read_batches(table, [leaves[each] for each in wanted]):
            with arrow_errors("the dataset cannot be read"):
                found = {each: leaves[each].wide(batch) for each in wanted}
            yield found

    whole_ones = [n for n, each in enumerate(windows) if each.column.dtype.kind != "f"]
    memory_check(
        sum(windows[n].size for n in whole_ones) * frames.rows, "the marks of missing values",
        options.max_memory,
    )  # fmt: skip
    masks: dict[int, NDArray[np.bool_]] = {}
    if whole_ones:
        parts: dict[int, list[NDArray[np.bool_]]] = {n: [] for n in whole_ones}
        for found in passes(sorted({windows[n].leaf for n in whole_ones})):
            for n in whole_ones:
                parts[n].append(~windows[n].samples(*found[windows[n].leaf])[1])
        masks = {
            n: mask
            for n, kept in parts.items()
            if kept and not (mask := np.concatenate(kept)).all()
        }
    tables = []
    for n, each in enumerate(windows):
        rows = frames.rows * each.size
        if frames.ticks is not None:
            memory_check(8 * rows, "the ticks of the samples", options.max_memory)
        ticks = frames.windows(each.size)
        if n in masks:
            memory_check(8 * rows, "the ticks of the samples", options.max_memory)
            places = np.flatnonzero(masks[n])
            ticks, rows = places if ticks is None else ticks[places], places.size
        name = leaves[each.leaf].name
        first, rate = frames.first * each.size, checked_rate(frames.rate * each.size)
        tables.append(ImportTable(name, (each.column,), rate, rows, ticks, first, "windows"))

    def blocks() -> Iterator[ImportBlock]:
        filled, seen = [0] * len(windows), [0] * len(windows)
        for found in passes(used):
            for n, each in enumerate(windows):
                x, _ = each.samples(*found[each.leaf])
                if n in masks:
                    x, size = x[masks[n][seen[n] : seen[n] + x.size]], x.size
                    seen[n] += size
                values = each.converted(x, leaves[each.leaf].name)
                yield ImportBlock(n, filled[n], [values])
                filled[n] += values.size

    return tuple(tables), blocks


# Writing


class Group(NamedTuple):
    """Channels that share a feature."""

    name: str
    size: int
    """Samples of a channel in a frame."""
    dtype: np.dtype[Any]
    members: list[int]

    @property
    def shape(self) -> list[int]:
        return [len(self.members)] if self.size == 1 else [self.size, len(self.members)]


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """A dataset of version 3.0 with one episode; each frame has a window of samples."""
    arrow()
    if not recording.channels:
        raise ParameterError("a recording without channels cannot be written as LeRobot")
    fps = _fps(recording, options.fps)
    sizes = [(channel.rate_exact / fps).numerator for channel in recording.channels]
    first, stop = _extent(recording, sizes)
    missing = sum(sizes) * (stop - first) - recording.sample_count
    if 8 * missing > options.max_memory:
        raise LimitError(
            f"the gaps take {8 * missing} bytes as NaN in LeRobot frames, more than the "
            f"{options.max_memory} allowed; allow more (max_memory=) or write a part"
        )
    notes = []
    if missing:
        notes.append(f"gaps and samples that frames lack at the ends are NaN: {missing}")
    if fps.denominator > 1:
        notes.append(f"LeRobot expects a whole number of frames per second, not {fps}")
    sources, scaled, counted = [], [], []
    for channel, size in zip(recording.channels, sizes, strict=True):
        values, counts = column_values(channel)
        counted.append(values.dtype.kind in "iu")
        lacks = channel.stored.size < size * (stop - first)
        sources.append(Sparse(channel, _with_nan(values, channel) if lacks else values))
        scaled += [channel.label] if counts else []
    notes += [f"channel {label!r} holds counts without their scale" for label in scaled]
    if any(channel.exact is not None for channel in recording.channels):
        notes.append("the grids of floating-point channels are not carried over to LeRobot")
    groups = _groups(recording, sizes, [source.dtype for source in sources])
    own = {"version": 1, "fps": str(fps), "first_frame": first, "frames": stop - first}
    _write(
        recording, target.path, fps, first, stop, groups, sources, counted,
        {**own, **own_members(recording)}, options,
    )  # fmt: skip
    return notes + not_carried(recording, "LeRobot", *CARRIED, *recording.metadata)


def _fps(recording: Recording, given: Fraction | None) -> Fraction:
    rates = sorted({checked_rate(channel.rate_exact) for channel in recording.channels})
    most = Fraction(
        gcd(*(rate.numerator for rate in rates)), lcm(*(rate.denominator for rate in rates))
    )
    listed = ", ".join(f"{rate} Hz" for rate in rates[:5])
    if given is None and len(rates) > 1:
        raise ParameterError(
            f"the channels have several rates ({listed}); give the frames per second, such as "
            f"{most} (fps=)"
        )
    fps = rates[0] if given is None else given
    if any((rate / fps).denominator > 1 for rate in rates):
        raise ParameterError(
            f"{fps} frames per second do not divide the rates ({listed}); {most} or a fraction of "
            "it does (fps=)"
        )
    return fps


def _extent(recording: Recording, sizes: Sequence[int]) -> tuple[int, int]:
    """The first frame, and the one behind the last."""
    ends = [
        (channel.coverage[0].start // size, -(-channel.coverage[-1].stop // size))
        for channel, size in zip(recording.channels, sizes, strict=True)
        if channel.coverage
    ]
    if not ends:
        raise ParameterError("a recording without samples cannot be written as LeRobot")
    return min(first for first, _ in ends), max(stop for _, stop in ends)


def _with_nan(values: NDArray[Any], channel: Channel) -> NDArray[Any]:
    """Values that can be NaN."""
    if values.dtype.kind == "f":
        return values
    found = values.astype(np.float64)
    if values.size and not -(2**53) <= int(values.min()) <= int(values.max()) <= 2**53:
        raise ParameterError(
            f"channel {channel.label!r} has gaps, or incomplete frames, and integers beyond 2^53: "
            "LeRobot frames cannot hold both"
        )
    return found


def _groups(
    recording: Recording, sizes: Sequence[int], dtypes: Sequence[np.dtype[Any]]
) -> list[Group]:
    """Channels of one group, rate and type share a feature."""
    found: dict[tuple[str, int, np.dtype[Any]], Group] = {}
    taken: set[str] = set(_FRAME)
    for number, channel in enumerate(recording.channels):
        base = feature_name(channel.group)
        key = (base, sizes[number], dtypes[number])
        if key not in found:
            name, count = base, 1
            while name in taken:
                count += 1
                name = f"{base}_{count}"
            taken.add(name)
            found[key] = Group(name, sizes[number], dtypes[number], [])
        found[key].members.append(number)
    for one in found.values():
        if one.size * len(one.members) > WIDTH:
            raise ParameterError(
                f"a frame of {one.name!r} would hold {one.size * len(one.members)} numbers, more "
                f"than {WIDTH}; choose more frames per second (fps=)"
            )
    return list(found.values())


def feature_name(group: str) -> str:
    """LeRobot's policies use features whose names begin with "observation" or "action"."""
    text = re.sub(r"[^\w.-]+", "_", group).strip("_.") or "touch"
    ours = text == "action" or text.startswith(("observation.", "action.", "next."))
    return text if ours else f"observation.{text}"


@dataclass
class Statistics:
    """Statistics of each place of a feature, without NaN. LeRobot scales its inputs by them."""

    shape: Sequence[int]
    frames: int = 0
    parts: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    def add(self, x: NDArray[Any]) -> None:
        """[rows, places]"""
        wide = x.astype(np.float64)
        known = ~np.isnan(wide)
        self.frames += len(wide)
        with np.errstate(all="ignore"):
            count = known.sum(0).astype(np.float64)
            mean = np.where(known, wide, 0).sum(0) / np.maximum(count, 1)
            now = {
                "min": np.where(known, wide, np.inf).min(0, initial=np.inf),
                "max": np.where(known, wide, -np.inf).max(0, initial=-np.inf),
                "mean": mean,
                "count": count,
                "squares": np.where(known, (wide - mean) ** 2, 0).sum(0),
            }
            if self.parts:
                before = self.parts
                total = before["count"] + count
                share = count / np.maximum(total, 1)
                apart = mean - before["mean"]
                now = {
                    "min": np.minimum(before["min"], now["min"]),
                    "max": np.maximum(before["max"], now["max"]),
                    "mean": before["mean"] + apart * share,
                    "count": total,
                    "squares": before["squares"] + now["squares"]
                    + apart**2 * before["count"] * share,
                }  # fmt: skip
        self.parts = now

    def as_json(self) -> dict[str, Any]:
        if not self.parts:
            return {}
        some = self.parts["count"] > 0
        with np.errstate(all="ignore"):
            found = {key: self.parts[key] for key in ("min", "max", "mean")}
            found["std"] = np.sqrt(self.parts["squares"] / np.maximum(self.parts["count"], 1))
        return {
            **{
                key: np.nan_to_num(np.where(some, x, 0)).reshape(self.shape).tolist()
                for key, x in found.items()
            },
            "count": [self.frames],
        }


def _write(
    recording: Recording,
    root: Path,
    fps: Fraction,
    first: int,
    stop: int,
    groups: Sequence[Group],
    sources: Sequence[Sparse],
    counted: Sequence[bool],
    own: Mapping[str, Any],
    options: WriteOptions,
) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    labels = unique([c.label or f"ch{i + 1}" for i, c in enumerate(recording.channels)], [])
    codes, tasks = _tasks(recording, fps, first, stop)
    features: dict[str, Any] = {}
    fields = []
    for group in groups:
        names = [labels[number] for number in group.members]
        features[group.name] = {
            "dtype": str(group.dtype),
            "shape": group.shape,
            "names": names if group.size == 1 else {"channels": names},
        }
        fields.append(
            pa.field(
                group.name, _type(group), metadata={"hapfmt": _about(recording, group, counted)}
            )
        )
    for name, dtype in _FRAME.items():
        features[name] = {"dtype": dtype, "shape": [1], "names": None}
        fields.append(pa.field(name, pa.from_numpy_dtype(np.dtype(dtype))))
    statistics = {name: Statistics(one["shape"]) for name, one in features.items()}
    with refusing("the metadata of the recording"):
        schema = pa.schema(fields, metadata={"hapfmt": json.dumps(own)})
    path = root / _DATA[3].format(chunk_index=0, file_index=0)
    path.parent.mkdir(parents=True)
    width = sum(group.size * len(group.members) for group in groups) + len(_FRAME)
    at_once = max(min(ROWS, BATCH_SIZE // (8 * width)), 1)
    with (
        arrow_errors("the dataset cannot be written"),
        parquet.ParquetWriter(
            str(path), schema, compression="zstd", write_page_checksum=True
        ) as writer,
    ):
        for low in range(first, stop, at_once):
            high = min(low + at_once, stop)
            arrays = []
            for group in groups:
                x = _block(group, sources, low, high)
                statistics[group.name].add(x)
                arrays.append(_array(group, x))
            for name, x in _frame_columns(low - first, high - first, fps, codes).items():
                statistics[name].add(x[:, None])
                arrays.append(pa.array(x))
            writer.write_batch(pa.RecordBatch.from_arrays(arrays, schema=schema))
            if options.progress:
                options.progress(high - first, stop - first)
    found = {name: one.as_json() for name, one in statistics.items()}
    _write_meta(recording, root, fps, stop - first, features, tasks, found)


def _about(recording: Recording, group: Group, counted: Sequence[bool]) -> str:
    channels = []
    for number in group.members:
        channel = recording.channels[number]
        about = {"number": number, **channel_texts(channel), **channel_numbers(channel)}
        channels.append({**about, "counts": True} if counted[number] else about)
    return json.dumps({"window": group.size, "channels": channels})


def _type(group: Group) -> Any:
    import pyarrow as pa

    kind = pa.from_numpy_dtype(group.dtype)
    if group.size > 1:
        return pa.list_(pa.list_(kind))
    return kind if len(group.members) == 1 else pa.list_(kind, len(group.members))


def _block(group: Group, sources: Sequence[Sparse], first: int, stop: int) -> NDArray[Any]:
    """[frames, places] of a feature."""
    x = np.empty(((stop - first) * group.size, len(group.members)), group.dtype)
    for spot, number in enumerate(group.members):
        values, missing = sources[number].between(first * group.size, stop * group.size)
        if missing.any():
            values[missing] = np.nan
        x[:, spot] = values
    return x.reshape(stop - first, -1)


def _array(group: Group, x: NDArray[Any]) -> Any:
    import pyarrow as pa

    flat, channels = pa.array(x.ravel()), len(group.members)
    if group.size > 1:
        inner = pa.array(np.arange(0, x.size + 1, channels, dtype=np.int32))
        outer = pa.array(np.arange(0, len(x) * group.size + 1, group.size, dtype=np.int32))
        return pa.ListArray.from_arrays(outer, pa.ListArray.from_arrays(inner, flat))
    return flat if channels == 1 else pa.FixedSizeListArray.from_arrays(flat, channels)


def _frame_columns(
    first: int, stop: int, fps: Fraction, codes: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    numbers = np.arange(first, stop)
    values = (
        (numbers / float(fps)).astype(np.float32), numbers, np.zeros_like(numbers), numbers,
        codes[first:stop],
    )  # fmt: skip
    return dict(zip(_FRAME, values, strict=True))


def _tasks(
    recording: Recording, fps: Fraction, first: int, stop: int
) -> tuple[NDArray[np.int64], list[str]]:
    """The task of each frame, by events of the layer "task" and by the metadata; and all tasks."""
    given = recording.metadata.get("task")
    tasks = {given if isinstance(given, str) else "": 0}
    codes = np.zeros(stop - first, np.int64)
    for event in recording.events:
        if event.layer == "task":
            low = int(event.time * fps) - first
            high = ceil((event.time + event.duration) * fps) - first
            codes[max(low, 0) : max(high, 0)] = tasks.setdefault(event.text, len(tasks))
    used, places = np.unique(codes, return_inverse=True)
    texts = list(tasks)
    return places.astype(np.int64), [texts[code] for code in used.tolist()] or texts[:1]


def _write_meta(
    recording: Recording,
    root: Path,
    fps: Fraction,
    frames: int,
    features: Mapping[str, Any],
    tasks: Sequence[str],
    statistics: Mapping[str, Any],
) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    robot = recording.metadata.get("robot_type")
    info = {
        "codebase_version": "v3.0",
        "robot_type": robot if isinstance(robot, str) else None,
        "total_episodes": 1,
        "total_frames": frames,
        "total_tasks": len(tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": int(fps) if fps.denominator == 1 else float(fps),
        "splits": {"train": "0:1"},
        "data_path": _DATA[3],
        "video_path": None,
        "features": features,
    }
    episode = {
        "episode_index": 0,
        "tasks": tasks,
        "length": frames,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": 0,
        "dataset_to_index": frames,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        **{f"stats/{name}/{key}": x for name, one in statistics.items() for key, x in one.items()},
    }
    folder = root / "meta/episodes/chunk-000"
    folder.mkdir(parents=True)
    with arrow_errors("the dataset cannot be written"):
        table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": tasks})
        table = table.replace_schema_metadata({"pandas": json.dumps(_INDEX)})
        parquet.write_table(table, str(root / "meta/tasks.parquet"))
        parquet.write_table(
            pa.table({key: [value] for key, value in episode.items()}),
            str(folder / "file-000.parquet"),
        )
    for name, content in (("info", info), ("stats", statistics)):
        text = json.dumps(content, indent=4 if name == "info" else None, allow_nan=False)
        (root / f"meta/{name}.json").write_text(text, "utf-8")


_INDEX = {
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": dtype,
         "metadata": None}
        for name, kind, dtype in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ],
    "pandas_version": "2.0.0",
}  # fmt: skip
"""What pandas keeps of a table: the texts of the tasks are its index, as LeRobot wants them."""
