"""Reads .xdf and .xdfz, recordings of the Lab Streaming Layer.

A file is a series of chunks: headers in XML, samples, and offsets between the clocks of a stream
and of the recording computer. The stamps of the file place the samples. Streams of text, and
streams without a rate, become events.
"""

from __future__ import annotations

import gzip
import json
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from datetime import datetime
from fractions import Fraction
from typing import IO, Any, cast
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockObservation
from ..errors import LimitError, ParameterError
from ..numbers import counted, exact
from ..recording import Calibration, Event
from .common import filled_rates, read_bytes, refusing, selected, several_rates, unit_of
from .formats import ReadOptions, Source
from .tables import Import, ImportBlock, ImportColumn, ImportTable
from .timestamps import Placed, align, observations, place, stamp_channel, stamp_label

_FILE_HEADER, _STREAM_HEADER, _SAMPLES, _CLOCK_OFFSET = 1, 2, 3, 4
_DTYPES = {
    "int8": "i1", "int16": "<i2", "int32": "<i4", "int64": "<i8", "float32": "<f4",
    "double64": "<f8", "string": "",
}  # fmt: skip
_XML_LIMIT = 1 << 24
_EVENT_SIZE = 512
"""Bytes that an event takes in memory, about."""
_NS = 10**9
_STAMP_LIMIT = 4e9
"""Seconds, so that sums of two fit 64 bits in ns."""
_RATIO, _SMALL = 200, 1 << 24
"""How much larger a packed file may become, by its size; and bytes that any may have."""
_EARLY_S = 3600
"""An event may come so much before the first sample."""
_SET_BACK_S = 1.0
"""A clock was set back where its stamps go back by more."""
_NEAR_NOMINAL, _CLEAR = 0.01, 0.15
"""The rate by the stamps counts, if it is that near to the nominal one, or if the steps of the
stamps are so near to whole ticks of it."""
_RECORDER = "lsl"
"""Name of the clock of the recording computer."""


@dataclass
class XdfStream:
    """A stream as its header says, and where its samples are."""

    number: int
    name: str
    kind: str
    host: str
    channels: int
    rate: Fraction | None
    dtype: str
    labels: list[str]
    units: list[str]
    facts: dict[str, str]
    stamps: list[NDArray[np.float64]] = field(default_factory=list)
    chunks: list[tuple[int, int, int]] = field(default_factory=list)
    """Place of the content in the file, its bytes, and the first row."""
    rows: int = 0
    last: float = 0.0
    texts: list[str] = field(default_factory=list)
    offsets: list[tuple[int, float, float]] = field(default_factory=list)
    """Rows before it, the time of the stream's clock, and what the recorder's clock is ahead."""

    @property
    def row_size(self) -> int:
        return self.channels * np.dtype(self.dtype).itemsize if self.dtype else 0


def read(source: Source, options: ReadOptions) -> Import:
    """Each stream with a rate is a table."""
    notes: list[str] = []
    with refusing("this is no XDF file", zlib.error, gzip.BadGzipFile):
        streams, header = _scan(source, options, notes)
    names = [stream.name for stream in streams]
    streams = [streams[place] for place in selected(names, options.select, "stream")]
    stamps, ranges = [], []
    for stream in streams:
        found, first, last = _episode(stream, options, notes)
        stamps.append(found)
        ranges.append((first, last))
    if streams and options.episode is not None and all(first == last for first, last in ranges):
        raise ParameterError(f"no stream has an episode {options.episode}; the first one is 0")
    numeric = [stream for stream in streams if stream.dtype]
    rates, is_forced = filled_rates(
        options.rate, [(s.name, s.rate, str(s.number)) for s in numeric], notes
    )
    placed = [
        _placed(stream, ns, rates[0] if is_forced else None) if stream.dtype else None
        for stream, ns in zip(streams, stamps, strict=True)
    ]
    if options.rate is not None and numeric and not is_forced:
        lacking = [s.dtype and each is None for s, each in zip(streams, placed, strict=True)]
        if not any(lacking):
            raise several_rates()
        placed = [
            place(ns, name=f"stream {stream.name!r}", rate=options.rate) if lacks else each
            for stream, ns, each, lacks in zip(streams, stamps, placed, lacking, strict=True)
        ]
    shifts = [_shift(stream, own) for stream, own in zip(streams, ranges, strict=True)]
    shifted = [
        each._replace(start_ns=each.start_ns + shift)
        for each, shift in zip(placed, shifts, strict=True)
        if each is not None
    ]
    zero, starts = _zero(
        shifted,
        [
            int(ns.min()) + shift
            for ns, shift, each in zip(stamps, shifts, placed, strict=True)
            if ns.size and each is None
        ],
    )
    labels = _labels([s for s, each in zip(streams, placed, strict=True) if each])
    tables: list[ImportTable] = []
    readers: list[tuple[XdfStream, tuple[int, int], NDArray[Any] | None]] = []
    clocks: list[ClockObservation] = []
    events: list[Event] = []
    dropped: Counter[str] = Counter()
    channel = 0
    rateless = [
        (stream, own)
        for stream, own, each in zip(streams, ranges, placed, strict=True)
        if each is None and stream.dtype
    ]
    texts = _texts_of(source, rateless, options) if rateless else {}
    for stream, ns, own, each, shift in zip(streams, stamps, ranges, placed, shifts, strict=True):
        if each is None:
            times = [time + shift - zero for time in ns.tolist()]
            said = texts[stream.number] if stream.dtype else stream.texts[own[0] : own[1]]
            events += _events(stream, said, times, dropped)
            continue
        start = starts[len(tables)]
        table, kept = _table(
            stream, each, start, next(labels), ns, zero - shift, len(starts), options, notes
        )
        tables.append(table)
        readers.append((stream, own, kept))
        clocks += _clocks(stream, own, each, ns, start, channel)
        channel += len(table.columns)
    notes += [
        f"{counted(count, 'event')} of stream {name!r}: more than {_EARLY_S} s before the first "
        "sample, not read"
        for name, count in dropped.items()
    ]
    epoch, uncertainty = _epoch(header, notes)
    described = {stream.name: stream.facts for stream in streams if stream.facts}

    def blocks() -> Iterator[ImportBlock]:
        yield from _blocks(source, readers)

    return Import(
        tuple(tables),
        blocks,
        epoch,
        uncertainty,
        metadata={"streams": described} if described else {},
        events=tuple(sorted(events, key=lambda event: event.time)),
        notes=tuple(notes),
        clocks=tuple(clocks),
    )


def _zero(placed: Sequence[Placed], events: Sequence[int]) -> tuple[int, list[int]]:
    """The time of the first sample, or of the first event that is not much earlier; start ticks."""
    if not placed:
        return min(events, default=0), []
    zero, starts = align(placed)
    earlier = [first for first in events if zero - _EARLY_S * _NS <= first < zero]
    if not earlier:
        return zero, starts
    event = Placed(Fraction(_NS), np.zeros(1, np.int64), min(earlier), (), 0, 0.0)
    zero, starts = align([*placed, event])
    return zero, starts[:-1]


def _opened(source: Source) -> IO[bytes]:
    stream = source.stream
    stream.seek(0)
    if source.head.startswith(b"\x1f\x8b"):
        return cast("IO[bytes]", _Unpacked(stream))
    return cast("IO[bytes]", _Kept(stream))


class _Unpacked(gzip.GzipFile):
    """Stops at a bomb."""

    def __init__(self, stream: IO[bytes]) -> None:
        self.limit = _SMALL + _RATIO * stream.seek(0, 2)
        stream.seek(0)
        super().__init__(fileobj=stream)

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if self.tell() > self.limit:
            raise LimitError(f"the file unpacks to more than {_RATIO} times its size")
        return data


class _Kept:
    """A stream that is left open by ``close``."""

    def __init__(self, stream: IO[bytes]) -> None:
        self.read, self.seek, self.tell = stream.read, stream.seek, stream.tell

    def close(self) -> None:
        pass


def _scan(
    source: Source, options: ReadOptions, notes: list[str]
) -> tuple[list[XdfStream], ElementTree.Element | None]:
    """The streams with their stamps, without values."""
    streams: dict[int, XdfStream] = {}
    header: ElementTree.Element | None = None
    held = 0
    with closing(_opened(source)) as file:
        if file.read(4) != b"XDF:":
            raise ParameterError("this is not an XDF file: it does not begin with XDF:")
        for tag, size, place in _chunk_heads(file):
            if tag not in (_FILE_HEADER, _STREAM_HEADER, _SAMPLES, _CLOCK_OFFSET):
                if _skipped(file, size):
                    continue
                notes.append(_cut(place))
                break
            limit = options.max_memory if tag == _SAMPLES else _XML_LIMIT
            if size > limit:
                raise LimitError(f"the chunk at byte {place} has {size} bytes, more than {limit}")
            raw = bytes(read_bytes(file, size))
            if len(raw) < size:
                notes.append(_cut(place))
                break
            if tag == _FILE_HEADER:
                header = _xml(raw)
                continue
            with refusing(f"the chunk at byte {place} is too short", struct.error):
                (number,) = struct.unpack_from("<I", raw)
                clock = struct.unpack_from("<dd", raw, 4) if tag == _CLOCK_OFFSET else None
            if tag == _STREAM_HEADER:
                if number in streams:
                    raise ParameterError(f"two streams have the number {number}")
                if len(streams) >= 1 << 15:
                    raise LimitError("more than 32768 streams")
                streams[number] = _stream(number, _xml(raw[4:]))
                continue
            if number not in streams:
                raise ParameterError(f"samples of stream {number} come before its header")
            stream = streams[number]
            if clock is not None:
                time, offset = clock
                if abs(time) < _STAMP_LIMIT and abs(offset) < _STAMP_LIMIT:
                    stream.offsets.append((stream.rows, time, offset))
                held += 64
            else:
                held += _add(stream, raw, place)
            if held > options.max_memory:
                raise LimitError(
                    "the time stamps and texts take more than the "
                    f"{options.max_memory} bytes allowed; allow more (max_memory=)"
                )
    return list(streams.values()), header


def _chunk_heads(file: IO[bytes]) -> Iterator[tuple[int, int, int]]:
    """Tag, size of the content, and its place; the caller reads it or skips it."""
    while code := file.read(1):
        raw = file.read(code[0]) if code[0] in (1, 4, 8) else b""
        if code[0] not in (1, 4, 8):
            raise ParameterError(f"the chunk at byte {file.tell() - 1} has no valid size")
        size = int.from_bytes(raw, "little")
        tag = file.read(2)
        if len(raw) == code[0] and len(tag) == 2 and size < 2:
            raise ParameterError(f"the chunk at byte {file.tell()} is shorter than its tag")
        yield int.from_bytes(tag, "little") if len(tag) == 2 else 0, max(size - 2, 1), file.tell()


def _skipped(file: IO[bytes], size: int) -> bool:
    """False where the file ends before."""
    while size:
        part = file.read(min(size, 1 << 20))
        if not part:
            return False
        size -= len(part)
    return True


def _cut(place: int) -> str:
    return f"the file ends within the chunk at byte {place}; what comes before is read"


def _xml(raw: bytes) -> ElementTree.Element:
    if b"<!" in raw:
        raise ParameterError("an XML header has declarations, which are not read")
    with refusing("an XML header is malformed", ElementTree.ParseError):
        return ElementTree.fromstring(raw.decode(errors="replace"))


def _said(element: ElementTree.Element, name: str) -> str:
    return (element.findtext(name) or "").strip()


def _stream(number: int, info: ElementTree.Element) -> XdfStream:
    name = _said(info, "name") or f"stream {number}"
    format = _said(info, "channel_format")
    if format not in _DTYPES:
        raise ParameterError(f"stream {name!r} has the format {format[:40]!r}, which is not known")
    count = _said(info, "channel_count")
    if not count.isascii() or not count.isdigit() or not 0 < int(count[:9]) <= 1 << 15:
        raise ParameterError(f"stream {name!r} has {count[:40]!r} channels")
    try:
        rate = exact(_said(info, "nominal_srate") or 0)
    except ParameterError as error:
        raise ParameterError(f"stream {name!r}: the nominal rate: {error}") from None
    described = info.findall("desc/channels/channel")[: int(count)]
    texts = {key: [_said(one, key) for one in described] for key in ("label", "unit")}
    missing = [""] * (int(count) - len(described))
    facts = {key: _said(info, key) for key in ("type", "source_id", "hostname")}
    return XdfStream(
        number,
        name,
        _said(info, "type"),
        _said(info, "hostname"),
        int(count),
        rate if rate > 0 else None,
        _DTYPES[format],
        texts["label"] + missing,
        texts["unit"] + missing,
        {key: text for key, text in facts.items() if text},
    )


def _number(raw: bytes, at: int) -> tuple[int, int]:
    """A number behind the count of its bytes, and the place after it."""
    size = raw[at]
    if size not in (1, 4, 8) or at + 1 + size > len(raw):
        raise ParameterError("a chunk of samples holds a number without a valid size")
    return int.from_bytes(raw[at + 1 : at + 1 + size], "little"), at + 1 + size


def _add(stream: XdfStream, raw: bytes, place: int) -> int:
    """Take the stamps of a chunk, and its texts. Returns the bytes that they take."""
    count, at = _number(raw, 4)
    if count * (1 + max(stream.row_size, 1)) > len(raw) - at:
        raise ParameterError(f"stream {stream.name!r} has a chunk shorter than its {count} rows")
    if stream.dtype:
        stamps, _ = _rows(raw, at, count, stream.row_size)
        taken = 16 * count + 128
    else:
        stamps, texts = _texts(raw, at, count, stream.channels)
        stream.texts += texts
        taken = sum(_EVENT_SIZE + len(text) for text in texts)
    step = float(1 / stream.rate) if stream.rate else 0.0
    place_of = np.arange(count)
    known = np.maximum.accumulate(np.where(np.isnan(stamps), -1, place_of))
    base = np.where(known < 0, stream.last, stamps[np.maximum(known, 0)])
    stamps = base + (place_of - known) * step
    if count and not (np.abs(stamps) < _STAMP_LIMIT).all():
        raise ParameterError(
            f"stream {stream.name!r} has a time stamp that is infinite or too large"
        )
    stream.stamps.append(stamps)
    stream.chunks.append((place, len(raw), stream.rows))
    stream.rows += count
    if count:
        stream.last = float(stamps[-1])
    return taken


def _rows(
    raw: bytes, at: int, count: int, row: int
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """[count] stamps, NaN where there is none, and [count, row] bytes of values."""
    data = np.frombuffer(raw, np.uint8)[at:]
    for flag in (8, 0) if count else ():
        if data.size == count * (1 + flag + row):
            table = data.reshape(count, -1)
            if (table[:, 0] == flag).all():
                stamps = np.full(count, np.nan)
                if flag:
                    stamps = np.ascontiguousarray(table[:, 1:9]).view("<f8")[:, 0].copy()
                return stamps, table[:, 1 + flag :]
    stamps, places, here = np.full(count, np.nan), np.empty(count, np.int64), 0
    unpack = struct.Struct("<d").unpack_from
    for number in range(count):
        flag = data[here] if here < data.size else 255
        if flag == 8 and here + 9 <= data.size:
            (stamps[number],) = unpack(raw, at + here + 1)
        elif flag:
            raise ParameterError("a sample has neither a time stamp nor none")
        here += 1 + int(flag)
        places[number] = here
        here += row
    if here > data.size:
        raise ParameterError("a chunk ends within a sample")
    return stamps, data[places[:, np.newaxis] + np.arange(row)]


def _texts(raw: bytes, at: int, count: int, channels: int) -> tuple[NDArray[np.float64], list[str]]:
    stamps, texts = np.full(count, np.nan), []
    for number in range(count):
        flag = raw[at]
        if flag == 8:
            (stamps[number],) = struct.unpack_from("<d", raw, at + 1)
        elif flag:
            raise ParameterError("a sample has neither a time stamp nor none")
        at += 1 + flag
        parts = []
        for _ in range(channels):
            size, at = _number(raw, at)
            if at + size > len(raw):
                raise ParameterError("a chunk ends within a text")
            parts.append(raw[at : at + size].decode(errors="replace"))
            at += size
        texts.append(", ".join(parts))
    return stamps, texts


def _episode(
    stream: XdfStream, options: ReadOptions, notes: list[str]
) -> tuple[NDArray[np.int64], int, int]:
    """The stamps in ns between two places where the clock was set back, and their rows."""
    seconds = np.concatenate(stream.stamps) if stream.stamps else np.empty(0)
    whole = np.floor(seconds)
    stamps = whole.astype(np.int64) * _NS + np.rint((seconds - whole) * _NS).astype(np.int64)
    back = np.flatnonzero(np.diff(seconds) < -_SET_BACK_S) + 1
    ends = [0, *back.tolist(), len(seconds)]
    asked = options.episode or "0"
    if not asked.isdigit():
        raise ParameterError(f"episode is a number from 0 on, not {asked!r}")
    number = int(asked[:9])
    if len(ends) > 2 and options.episode is None:
        notes.append(
            f"the clock of stream {stream.name!r} was set back {counted(len(ends) - 2, 'time')}; "
            "the rows from there on are other recordings; episode 1 is the next"
        )
    if number >= len(ends) - 1:
        return np.empty(0, np.int64), 0, 0
    return stamps[ends[number] : ends[number + 1]], ends[number], ends[number + 1]


def _placed(stream: XdfStream, stamps: NDArray[np.int64], rate: Fraction | None) -> Placed | None:
    """At ``rate``, if the caller gives it. None: its rows become events."""
    name = f"stream {stream.name!r}"
    if rate is not None:
        return place(stamps, name=name, rate=rate)
    try:
        found = place(stamps, name=name)
    except ParameterError:
        found = None
    if stream.rate is None:
        return found
    if found is not None and abs(found.rate / stream.rate - 1) <= _NEAR_NOMINAL:
        return found
    if found is not None and _jitter(stamps, found) < _CLEAR:
        note = f"{name}: the nominal rate is {stream.rate} Hz, the stamps come at {found.rate} Hz"
        return found._replace(notes=(note, *found.notes))
    return place(stamps, name=name, rate=stream.rate)


def _jitter(stamps: NDArray[np.int64], placed: Placed) -> float:
    """How far neighbours are moved from their distance in ticks, median."""
    ticks = np.diff(stamps - stamps[0]) * (float(placed.rate) / _NS)
    return float(np.median(np.abs(ticks - np.diff(placed.ticks)))) if ticks.size else 0.0


def _shift(stream: XdfStream, rows: tuple[int, int]) -> int:
    """ns from the clock of a stream to that of the recorder, when it was measured first there."""
    near = _offsets(stream, rows) or stream.offsets
    return round(near[0][2] * _NS) if near else 0


def _offsets(stream: XdfStream, rows: tuple[int, int]) -> list[tuple[int, float, float]]:
    """Those that were measured between the first and the last of the rows."""
    return [each for each in stream.offsets if rows[0] <= each[0] <= rows[1]]


def _labels(streams: Sequence[XdfStream]) -> Iterator[list[str]]:
    """A label of the file, or one that is made of the stream's name; with the name where two
    streams use the same."""
    own = []
    for stream in streams:
        plain = [label or str(place) for place, label in enumerate(stream.labels)]
        named = [
            label if given else (stream.name if stream.channels == 1 else f"{stream.name}.{label}")
            for given, label in zip(stream.labels, plain, strict=True)
        ]
        own.append(named)
    seen = Counter(label for labels in own for label in set(labels))
    for stream, labels in zip(streams, own, strict=True):
        yield [
            f"{stream.name}.{label}" if seen[label] > 1 and label != stream.name else label
            for label in labels
        ]


def _table(
    stream: XdfStream,
    placed: Placed,
    start: int,
    labels: Sequence[str],
    stamps: NDArray[np.int64],
    zero: int,
    count: int,
    options: ReadOptions,
    notes: list[str],
) -> tuple[ImportTable, NDArray[Any] | None]:
    """The table, and the values of its channel of stamps, if one is asked for. ``count``: of tables
    with stamps."""
    dtype = np.dtype(stream.dtype).newbyteorder("=")
    counts = dtype.kind == "i" and dtype.itemsize < 8
    columns = [
        ImportColumn(
            label,
            unit_of(unit, label, notes, about=f"{stream.name} {stream.kind}"),
            group=stream.name,
            calibration=Calibration() if counts else None,
            dtype=dtype,
            source_unit=unit,
        )
        for label, unit in zip(labels, stream.units, strict=True)
    ]
    kept = None
    if options.keep_stamps:
        kept = stamp_channel(placed, stamps, zero, start)
        columns.append(
            ImportColumn(stamp_label(stream.name, count), "ns", group=stream.name, dtype=kept.dtype)
        )
    ticks = placed.ticks
    plain = bool((np.diff(ticks) == 1).all()) and not ticks[0]
    return ImportTable(
        stream.name,
        tuple(columns),
        placed.rate,
        ticks.size,
        None if plain else ticks,
        start,
        stream.kind,
        placed.notes,
    ), kept


def _clocks(
    stream: XdfStream,
    rows: tuple[int, int],
    placed: Placed,
    stamps: NDArray[np.int64],
    start: int,
    channel: int,
) -> Iterator[ClockObservation]:
    """The clock of the stream, and what the recorder's clock showed at the same ticks."""
    name = f"{_RECORDER}:{stream.host or stream.name}"[:200]
    for seen in observations(placed, stamps, name, start, channel):
        yield ClockObservation(seen.clock, seen.channel, seen.tick, seen.time_ns)
    previous = -1
    for _, time, offset in _offsets(stream, rows):
        tick = round((round(time * _NS) - placed.start_ns) * placed.rate / _NS)
        at = placed.start_ns + round(tick * _NS / placed.rate)
        if tick + start > previous and 0 <= tick <= int(placed.ticks[-1]):
            yield ClockObservation(_RECORDER, channel, tick + start, at + round(offset * _NS))
            previous = tick + start


def _events(
    stream: XdfStream, texts: Sequence[str], times: Sequence[int], dropped: Counter[str]
) -> Iterator[Event]:
    for time, text in zip(times, texts, strict=True):
        if time < 0:
            dropped[stream.name] += 1
        else:
            yield Event(Fraction(time, _NS), text, layer=stream.name)


def _texts_of(
    source: Source, readers: Sequence[tuple[XdfStream, tuple[int, int]]], options: ReadOptions
) -> dict[int, list[str]]:
    """Rows of numbers, as JSON, for each stream by its number."""
    left = options.max_memory
    for stream, (first, last) in readers:
        left -= (last - first) * (_EVENT_SIZE + 32 * stream.channels)
        if left < 0:
            raise LimitError(
                f"stream {stream.name!r} has no rate, and its {last - first} rows take too much "
                "as events; give a rate (rate=) or select other streams (select=)"
            )
    found: dict[int, list[str]] = {stream.number: [] for stream, _ in readers}
    for block in _blocks(source, [(*reader, None) for reader in readers]):
        stream, _ = readers[block.table]
        labels = [label or str(place) for place, label in enumerate(stream.labels)]
        for row in zip(*(column.tolist() for column in block.values), strict=True):
            said = row[0] if len(row) == 1 else dict(zip(labels, row, strict=True))
            found[stream.number].append(json.dumps(said))
    return found


def _blocks(
    source: Source,
    readers: Sequence[tuple[XdfStream, tuple[int, int], NDArray[Any] | None]],
) -> Iterator[ImportBlock]:
    """Chunk by chunk, in the order of the file."""
    wanted = sorted(
        (place, size, row, number)
        for number, (stream, _, _) in enumerate(readers)
        for place, size, row in stream.chunks
    )
    with closing(_opened(source)) as file:
        for place, size, row, number in wanted:
            stream, (first, last), kept = readers[number]
            file.seek(place)
            raw = bytes(read_bytes(file, size))
            if len(raw) < size:
                raise ParameterError("the file changed while it was read")
            count, at = _number(raw, 4)
            a, b = max(first - row, 0), min(last - row, count)
            if a >= b:
                continue
            _, cells = _rows(raw, at, count, stream.row_size)
            x = np.ascontiguousarray(cells[a:b]).view(stream.dtype)
            values: list[NDArray[Any]] = list(x.T)
            if kept is not None:
                values.append(kept[row + a - first : row + b - first])
            yield ImportBlock(number, row + a - first, values)


def _epoch(header: ElementTree.Element | None, notes: list[str]) -> tuple[int | None, int]:
    """The time in the file header, which is that of the first sample to about a second."""
    text = _said(header, "datetime") if header is not None else ""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None, 0
    if moment.tzinfo is None:
        notes.append(f"the start {text!r} names no time zone and is not read")
        return None, 0
    return round(moment.timestamp()) * _NS, _NS
