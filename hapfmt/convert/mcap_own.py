"""MCAP that hapfmt wrote -> the recording as it was: mcap_writer.py keeps in the metadata what
messages do not hold.

A file that another program cut or changed is read like any other.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..clocks import on_channels
from ..errors import LimitError, ParameterError
from ..limits import TICK_LIMIT
from ..recording import Calibration, Span
from .common import fits, rate_from, refusing, selected
from .formats import ReadOptions
from .messages import DecodedMessages, MessageFile, Topic, batches
from .own import restored_counts, with_own
from .tables import Import, ImportBlock, ImportColumn, ImportTable
from .timestamps import stamps_of

_TEXTS = ("label", "unit", "quantity", "axis", "group", "body_site", "device")
_DTYPES = {
    "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float16", "float32",
    "float64",
}  # fmt: skip
_CHANGED = "another program changed the messages; units, labels and rates come from the messages"


class _OwnColumn(NamedTuple):
    number: int
    path: str
    is_counts: bool
    """Counts rather than physical values."""
    column: ImportColumn


class _OwnTopic(NamedTuple):
    name: str
    rate: Fraction
    spans: tuple[Span, ...]
    ticks: NDArray[np.int64]
    columns: tuple[_OwnColumn, ...]


class _OwnFile(NamedTuple):
    zero_ns: int
    topics: tuple[_OwnTopic, ...]
    members: dict[str, Any]


def own_import(
    file: MessageFile,
    text: str,
    options: ReadOptions,
    attachments: Mapping[str, tuple[str, bytes]],
    notes: list[str],
) -> Import | None:
    """None: the messages are not those that were written, so they are read like those of others."""
    with refusing("the metadata of the file", RecursionError, AttributeError):
        own = _parsed(json.loads(text), options.max_memory)
    places = _places(file.topics, own)
    if places is None or not _is_unchanged(file, own, places, options.max_memory):
        notes.append(_CHANGED)
        return None
    return _imported(file, own, places, options, attachments)


def _parsed(found: dict[str, Any], max_memory: int) -> _OwnFile:
    topics = []
    left = max_memory // 8
    for each in found["topics"]:
        spans = tuple(Span(int(start), int(stop)) for start, stop in each["spans"])
        last = -1
        for span in spans:
            if not last < span.start < span.stop <= TICK_LIMIT:
                raise ValueError("wrong spans")
            last = span.stop
        rows = sum(span.ticks for span in spans)
        left -= rows
        if left < 0:
            raise LimitError(
                f"the times of the messages take more than the {max_memory} bytes allowed; allow "
                "more (max_memory=)"
            )
        ticks = np.concatenate(
            [np.empty(0, np.int64), *(np.arange(span.start, span.stop) for span in spans)]
        )
        columns = tuple(_column(column) for column in each["channels"])
        rate = rate_from(str(each["rate"]))
        topics.append(_OwnTopic(str(each["name"]), rate, spans, ticks, columns))
    numbers = [column.number for topic in topics for column in topic.columns]
    if sorted(numbers) != list(range(len(numbers))):
        raise ValueError("wrong channels")
    return _OwnFile(int(found["zero_ns"]), tuple(topics), found)


def _column(found: dict[str, Any]) -> _OwnColumn:
    if found["dtype"] not in _DTYPES:
        raise ValueError("wrong dtype")
    dtype = np.dtype(found["dtype"])
    calibration = Calibration(*found["calibration"]) if "calibration" in found else None
    if calibration is not None and dtype.kind == "f":
        raise ValueError("wrong calibration")
    lsb = float(found["lsb"]) if "lsb" in found else None
    texts: dict[str, Any] = {key: str(found[key]) for key in _TEXTS if key in found}
    column = ImportColumn("", calibration=calibration, lsb=lsb, dtype=dtype)
    return _OwnColumn(
        int(found["number"]), str(found["path"]), "counts" in found, replace(column, **texts)
    )


def _places(topics: Sequence[Topic], own: _OwnFile) -> list[int | None] | None:
    """The topic of the file for each of ours; None where one is missing, or there twice."""
    known = [topic.name for topic in topics]
    found: list[int | None] = []
    for topic in own.topics:
        count = known.count(topic.name)
        if count > 1 or (not count and topic.spans):
            return None
        place = known.index(topic.name) if count else None
        if place is not None and topics[place].decoder is None:
            return None
        found.append(place)
    return found


def _is_unchanged(
    file: MessageFile, own: _OwnFile, places: Sequence[int | None], max_memory: int
) -> bool:
    """Whether the messages have the times of the ticks."""
    wanted = {place for place in places if place is not None}
    logs = {place: array("q") for place in wanted}
    left = max_memory // 8
    for message in file.messages(wanted):
        logs[message.topic].append(message.log_ns)
        left -= 1
        if left < 0:
            return False
    for topic, place in zip(own.topics, places, strict=True):
        if place is None:
            continue
        if len(logs[place]) != len(topic.ticks):
            return False
        stop = topic.spans[-1].stop if topic.spans else 0
        end_ns = own.zero_ns + int(stop / topic.rate * 10**9)
        if not 0 <= own.zero_ns <= end_ns < 1 << 63:
            return False
        zeros = np.zeros(len(topic.ticks), np.int64)
        if not np.array_equal(
            np.array(logs[place], np.int64),
            stamps_of(zeros, topic.ticks, topic.rate, own.zero_ns),
        ):
            return False
    return True


def _imported(
    file: MessageFile,
    own: _OwnFile,
    places: Sequence[int | None],
    options: ReadOptions,
    attachments: Mapping[str, tuple[str, bytes]],
) -> Import:
    every = sorted(
        ((column, number) for number, topic in enumerate(own.topics) for column in topic.columns),
        key=lambda one: one[0].number,
    )
    kept = _selected(own, every, options.select)
    runs = [list(run) for _, run in groupby(kept, key=lambda one: one[1])]
    tables = []
    for run in runs:
        topic = own.topics[run[0][1]]
        tables.append(
            ImportTable(
                name=topic.name,
                columns=tuple(column.column for column, _ in run),
                rate=topic.rate,
                row_count=len(topic.ticks),
                ticks=topic.ticks if len(topic.spans) > 1 else None,
                start_tick=topic.spans[0].start if len(topic.spans) == 1 else 0,
                kind=file.topics[place].kind if (place := places[run[0][1]]) is not None else "",
            )
        )
    tables_of: dict[int, list[int]] = {}
    for table, run in enumerate(runs):
        place = places[run[0][1]]
        if place is not None:
            tables_of.setdefault(place, []).append(table)

    def blocks() -> Iterator[ImportBlock]:
        done = dict.fromkeys(tables_of, 0)
        for place, messages in batches(file.messages({*tables_of})):
            decoder = file.topics[place].decoder
            assert decoder is not None
            parts = [*decoder.parts([message.data for message in messages])]
            for table in tables_of[place]:
                values = [_values(column, parts, len(messages)) for column, _ in runs[table]]
                yield ImportBlock(table, done[place], values)
            done[place] += len(messages)

    made = with_own(Import(tuple(tables), blocks, attachments=attachments), own.members)
    if len(kept) == len(every):
        return made
    numbers: dict[int | str | None, int] = {
        column.number: place for place, (column, _) in enumerate(kept)
    }
    events = tuple(
        replace(event, channel=numbers.get(event.channel))
        for event in made.events
        if event.channel is None or event.channel in numbers
    )
    return replace(
        made,
        events=events,
        clocks=tuple(on_channels(made.clocks, numbers)),
        clock_maps=tuple(on_channels(made.clock_maps, numbers)),
    )


def _selected(
    own: _OwnFile, every: Sequence[tuple[_OwnColumn, int]], patterns: Sequence[str]
) -> list[tuple[_OwnColumn, int]]:
    names = [own.topics[number].name for _, number in every]
    labels = [column.column.label for column, _ in every]
    if patterns:
        selected([*dict.fromkeys(names), *labels], patterns, "topic or channel")
    return [
        one
        for one, name, label in zip(every, names, labels, strict=True)
        if not patterns or any(fits(name, p) or fits(label, p) for p in patterns)
    ]


def _values(column: _OwnColumn, parts: Sequence[DecodedMessages], count: int) -> NDArray[Any]:
    """The samples as they were stored."""
    path, _, place = column.path.partition("[")
    found: NDArray[Any] | None = None
    for part in parts:
        inner = column.path if column.path in part.numbers else path
        if inner not in part.numbers:  # null in JSON
            x: NDArray[Any] = np.full(len(part.rows), np.nan)
        else:
            x = part.values(inner)
        if x.ndim == 2:
            if not place or int(place.rstrip("]")) >= x.shape[1]:
                raise ParameterError(f"the values of {column.path!r} are missing")
            x = x[:, int(place.rstrip("]"))]
        if found is None:
            found = np.empty(count, x.dtype)
        found[part.rows] = x
    assert found is not None
    return _restored(column, found)


def _restored(column: _OwnColumn, x: NDArray[Any]) -> NDArray[Any]:
    dtype, calibration = column.column.dtype, column.column.calibration
    if calibration is not None and not column.is_counts:
        counts = restored_counts(x, calibration, dtype)
        if counts is not None:
            return counts
    elif dtype.kind == "f" or (x.dtype.kind in "iu" and _fit(x, dtype)):
        with np.errstate(over="ignore"):
            return x.astype(dtype)
    raise ParameterError(
        f"the values of channel {column.column.label!r} are not those that hapfmt wrote; remove "
        "the record 'hapfmt' from the metadata to read them as they are"
    )


def _fit(x: NDArray[Any], dtype: np.dtype[Any]) -> bool:
    limits = np.iinfo(dtype)
    return not x.size or (int(x.min()) >= limits.min and int(x.max()) <= limits.max)
