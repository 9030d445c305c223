""".edf and .bdf <-> Recording: counts of 16 or 24 bits in records of one duration.

Texts of 8 characters in the header give the physical values of two counts, so that the scale is an
exact fraction. EDF+ adds annotations, and gaps between records. A gap of one channel is written as
its last value under the annotation ``no data@@label``, and read back as a gap.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from itertools import groupby
from math import ceil, floor, gcd, lcm
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, ParameterError
from ..limits import TICK_LIMIT
from ..numbers import exact
from ..recording import (
    Calibration,
    Channel,
    Event,
    Recording,
    Span,
    spans_at,
)
from .common import choose_rate, exact_doubles, not_carried, read_bytes, selected, unit_of
from .formats import Destination, ReadOptions, Source, WriteOptions
from .tables import Import, ImportBlock, ImportColumn, ImportTable

_FIELDS = (8, 80, 80, 8, 8, 8, 44, 8, 8, 4)
_SIGNAL_FIELDS = (16, 80, 8, 8, 8, 8, 8, 80, 8, 32)
_HEADER = 256
"""Bytes of the header, and of the description of each signal."""
_BLOCK = 1 << 20
"""Bytes of samples that are read or written at a time."""
_EVENT_SIZE = 512
"""Bytes that an event takes in memory, about."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_MONTHS = ["JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC"]
_TWO_DIGITS_FROM = 1985
"""A year of two digits is the first such year from here on."""
_ONSET = re.compile(r"[+-]\d{1,18}(?:\.\d{0,18})?", re.A)
_DURATION = re.compile(r"\d{1,18}(?:\.\d{0,18})?", re.A)
_NO_DATA = "no data"
_OURS = "hapfmt"
"""The equipment, in files that we wrote."""
_NUMBER_SIZE = 8
"""Characters of a number in the header."""
_RECORD_SIZE = 61440
"""Bytes of the longest record that every program reads."""
_RECORDS_LIMIT = 10**8 - 1


@dataclass(frozen=True)
class EdfSignal:
    """One signal in the header; ``place`` is the first sample of it in a record."""

    label: str
    transducer: str
    unit: str
    physical: tuple[Fraction, Fraction]
    digital: tuple[int, int]
    prefilter: str
    samples: int
    place: int


@dataclass(frozen=True)
class EdfHeader:
    """``size``: bytes of a sample. ``records`` counts the whole records that are in the file."""

    size: int
    patient: str
    recorded: str
    epoch_ns: int | None
    time: str
    """hh:mm:ss of the start where the date is hidden, otherwise empty."""
    kind: str
    records: int
    duration: Fraction
    signals: tuple[EdfSignal, ...]
    start: int
    notes: tuple[str, ...]

    @property
    def record_size(self) -> int:
        return self.size * sum(signal.samples for signal in self.signals)

    @property
    def title(self) -> str:
        return "EDF" if self.size == 2 else "BDF"


def read(source: Source, options: ReadOptions) -> Import:
    """Counts with their exact scale, annotations as events. Each group of signals with one rate and
    the same gaps is a table."""
    stream = source.stream
    header = _header(stream)
    if header.records and header.record_size > options.max_memory:
        raise LimitError(
            f"a record takes {header.record_size} bytes, more than the {options.max_memory} "
            "allowed; allow more (max_memory=)"
        )
    notes = list(header.notes)
    marks = [s for s in header.signals if s.label == f"{header.title} Annotations"]
    signals = [s for s in header.signals if s not in marks]
    if signals and not header.duration:
        raise ParameterError("the records have the duration 0, so the signals have no rate")
    kept = selected([s.label for s in signals], options.select, "signal")
    signals = [signals[place] for place in kept]
    rates = {s.samples / header.duration for s in signals}
    if options.rate is not None and len(rates) > 1:
        raise ParameterError("the signals have several rates; select those of one (select=)")
    onsets, written = _annotations(stream, header, marks, options.max_memory, notes)
    ours = _OURS in header.recorded.split() and len(onsets) == 1
    events, gaps = _sorted_out(written, onsets[0], signals, ours, notes)
    tables, places = [], []
    for samples, own_gaps, group in _alike(signals, gaps):
        rate = choose_rate(options.rate, samples / header.duration, notes)
        columns = tuple(_column(signal, header, notes) for signal in group)
        ticks = _ticks(header, samples, rate, onsets, own_gaps, options.max_memory, notes)
        rows = samples * header.records if ticks is None else ticks.size
        name = group[0].label if len(group) == 1 else f"{len(group)} signals"
        tables.append(ImportTable(name, columns, rate, rows, ticks, kind=header.kind))
        starts = None if ticks is None or not own_gaps else ticks
        places.append((group, samples, starts))

    def blocks() -> Iterator[ImportBlock]:
        done = [0] * len(tables)
        for first, x in _records(stream, header):
            for number, (group, samples, known) in enumerate(places):
                values = [_values(x[:, s.place : s.place + samples], s, header) for s in group]
                if known is not None:
                    a, b = first * samples, (first + len(x)) * samples
                    low, high = np.searchsorted(known, (a, b))
                    values = [each[known[low:high] - a] for each in values]
                if len(values[0]):
                    yield ImportBlock(number, done[number], values)
                done[number] += len(values[0])

    epoch = header.epoch_ns
    if epoch is not None:
        epoch += round(onsets[0] * 10**9)
        notes.append("the start time names no time zone and is read as UTC")
    return Import(
        tuple(tables), blocks, epoch, metadata=_metadata(header, signals), events=tuple(events),
        notes=tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _header(stream: BinaryIO) -> EdfHeader:
    end = stream.seek(0, 2)
    stream.seek(0)
    raw = bytes(read_bytes(stream, _HEADER))
    if not raw.startswith((b"0       ", b"\xffBIOSEMI")):
        raise ParameterError("this is not an EDF or BDF file: it begins with other bytes")
    if len(raw) < _HEADER:
        raise ParameterError(f"truncated: {len(raw)} of {_HEADER} bytes of the header are there")
    size = 3 if raw[0] == 0xFF else 2
    fields = _split(raw[1:], (7, *_FIELDS[1:]))
    patient, recorded, date, time, length, kind, records, duration, count = fields[1:]
    number = _whole(count, "the number of signals", 1, 9999)
    start = _whole(length, "the size of the header", 0, 10**8)
    if start != _HEADER * (number + 1):
        raise ParameterError(f"the header has {start} bytes for {number} signals")
    described = bytes(read_bytes(stream, _HEADER * number))
    if len(described) < _HEADER * number:
        raise ParameterError("truncated: the file ends within its header")
    signals, place = [], 0
    for raw_signal in _columns(described, number):
        signals.append(_signal(raw_signal, place))
        place += signals[-1].samples
    seconds = _number(duration, "the duration of a record")
    if seconds < 0:
        raise ParameterError("the duration of a record is negative")
    found, rest = divmod(max(end - start, 0), size * place)
    stated = _whole(records, "the number of records", -1, _RECORDS_LIMIT)
    notes = []
    if stated > found:
        if not found:
            raise ParameterError(f"truncated: the header counts {stated} records, none is there")
        notes.append(
            f"the file is cut off: of {stated} records, the first {found} are read; the rest is "
            "lost"
        )
    elif stated < 0:
        notes.append(f"the header counts no records; the {found} whole ones are read")
    elif found > stated or rest:
        extra = (found - stated) * size * place + rest
        notes.append(f"the {extra} bytes after the last record are not read")
    plus = kind.startswith(("EDF+", "BDF+"))
    epoch_ns = _start(date, time, recorded if plus else "", notes)
    clock = time.replace(".", ":")
    hidden = clock if epoch_ns is None and clock != "00:00:00" and _is_clock(clock) else ""
    if hidden:
        notes.append(
            f"the file hides its date; metadata 'start_time' keeps the time of day, {hidden}"
        )
    shown = kind[:5] if plus else "EDF" if size == 2 else "BDF"
    return EdfHeader(
        size, patient, recorded, epoch_ns, hidden, shown,
        found if stated < 0 else min(stated, found), seconds, tuple(signals), start, tuple(notes),
    )  # fmt: skip


def _is_clock(text: str) -> bool:
    """hh:mm:ss."""
    return re.fullmatch(r"([01]\d|2[0-3]):[0-5]\d:[0-5]\d", text, re.A) is not None


def _split(raw: bytes, sizes: Sequence[int]) -> list[str]:
    found, at = [], 0
    for size in sizes:
        found.append(_text(raw[at : at + size]))
        at += size
    return found


def _columns(raw: bytes, number: int) -> Iterator[list[str]]:
    """The fields of each signal; the header has one field of all signals after the other."""
    for place in range(number):
        found, at = [], 0
        for size in _SIGNAL_FIELDS:
            found.append(_text(raw[at + place * size :][:size]))
            at += size * number
        yield found


def _text(raw: bytes) -> str:
    """ASCII, by the rules; many programs write Latin-1 or UTF-8."""
    try:
        text = raw.decode()
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    return "".join(c if c.isprintable() else " " for c in text).strip()


def _whole(text: str, what: str, low: int, high: int) -> int:
    if re.fullmatch(r"[+-]?[0-9]{1,8}", text) is None or not low <= int(text) <= high:
        raise ParameterError(f"{what} is {text!r}, not a whole number from {low} to {high}")
    return int(text)


def _number(text: str, what: str) -> Fraction:
    if "/" not in text:
        try:
            return exact(text)
        except ParameterError:
            pass
    raise ParameterError(f"{what} is {text!r}, not a number")


def _signal(fields: Sequence[str], place: int) -> EdfSignal:
    label, transducer, unit, low, high, least, most, prefilter, samples, _ = fields
    name = f"signal {label!r}: the"
    return EdfSignal(
        label,
        transducer,
        unit,
        (_number(low, f"{name} physical minimum"), _number(high, f"{name} physical maximum")),
        (
            _whole(least, f"{name} digital minimum", -(1 << 23), 1 << 24),
            _whole(most, f"{name} digital maximum", -(1 << 23), 1 << 24),
        ),
        prefilter,
        _whole(samples, f"{name} number of samples in a record", 1, 10**8),
        place,
    )


def _start(date: str, time: str, recorded: str, notes: list[str]) -> int | None:
    """ns since 1970; None where the file hides it."""
    words = recorded.split()
    full = words[1].upper() if words[:1] == ["Startdate"] and len(words) > 1 else ""
    named = re.fullmatch(r"(\d\d)-([A-Z]{3})-(\d{4})", full, re.A)
    short = re.fullmatch(r"(\d\d)\.(\d\d)\.(\d\d)", date, re.A)
    clock = re.fullmatch(r"(\d\d)\.(\d\d)\.(\d\d)", time, re.A)
    if full == "X" or (not named and date == "01.01.85"):
        return None
    try:
        if clock is None or (named is None and short is None):
            raise ValueError
        if named is not None:
            day, month, year = int(named[1]), _MONTHS.index(named[2]) + 1, int(named[3])
        else:
            assert short is not None
            day, month, year = map(int, short.groups())
            year += 1900 if year >= _TWO_DIGITS_FROM % 100 else 2000
        hour, minute, second = map(int, clock.groups())
        begin = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        notes.append(f"the start {date!r}, {time!r} is not a time and is not read")
        return None
    found = (begin - _EPOCH) // timedelta(seconds=1) * 10**9
    return found if abs(found) < 1 << 62 else None


def _column(signal: EdfSignal, header: EdfHeader, notes: list[str]) -> ImportColumn:
    calibration = _calibration(signal, header.size)
    if signal.digital[0] >= signal.digital[1] or signal.physical[0] == signal.physical[1]:
        notes.append(f"signal {signal.label!r} has no scale and is read as counts")
    elif calibration is None:
        notes.append(
            f"the scale of signal {signal.label!r} has too many digits for exact integers; its "
            "values are rounded to float64"
        )
    return ImportColumn(
        signal.label,
        unit_of(signal.unit, signal.label, notes, about=signal.transducer),
        device=signal.transducer,
        calibration=calibration,
        dtype=np.dtype(np.int16 if header.size == 2 else np.int32)
        if calibration
        else np.dtype(np.float64),
        source_unit=signal.unit,
    )


def _calibration(signal: EdfSignal, size: int) -> Calibration | None:
    """The exact scale; None where it has too many digits."""
    (least, most), (low, high) = signal.digital, signal.physical
    if least >= most or low == high:
        return Calibration()
    gain = (high - low) / (most - least)
    return _exact_scale(gain, low - least * gain, size)


def _exact_scale(gain: Fraction, offset: Fraction, size: int) -> Calibration | None:
    d = lcm(gain.denominator, offset.denominator)
    try:
        found = Calibration(int(gain * d), int(offset * d), d)
    except ParameterError:
        return None
    half = 1 << (8 * size - 1)
    return found if found.covers(-half, half - 1) else None


def _values(x: NDArray[Any], signal: EdfSignal, header: EdfHeader) -> NDArray[Any]:
    counts = np.ascontiguousarray(x).reshape(-1)
    if _calibration(signal, header.size) is not None:
        return counts
    (least, most), (low, high) = signal.digital, signal.physical
    return (counts - float(least)) * float((high - low) / (most - least)) + float(low)


def _records(stream: BinaryIO, header: EdfHeader) -> Iterator[tuple[int, NDArray[Any]]]:
    """The number of the first record, and [records, samples] counts, some records at a time."""
    at_once = max(1, _BLOCK // header.record_size)
    stream.seek(header.start)
    for first in range(0, header.records, at_once):
        count = min(at_once, header.records - first)
        raw = read_bytes(stream, count * header.record_size)
        if len(raw) < count * header.record_size:
            raise ParameterError("the file changed while it was read")
        if header.size == 2:
            x: NDArray[Any] = np.frombuffer(raw, "<i2")
        else:
            wide = np.zeros((len(raw) // 3, 4), np.uint8)
            wide[:, 1:] = np.frombuffer(raw, np.uint8).reshape(-1, 3)
            x = wide.view("<i4")[:, 0] >> 8
        yield first, x.reshape(count, -1)


def _alike(
    signals: Sequence[EdfSignal], gaps: dict[int, list[tuple[Fraction, Fraction]]]
) -> Iterator[tuple[int, list[tuple[Fraction, Fraction]], list[EdfSignal]]]:
    """Neighbours with the same number of samples in a record, and the same gaps."""
    numbered = enumerate(signals)
    for (samples, own), group in groupby(
        numbered, lambda each: (each[1].samples, gaps.get(each[0], []))
    ):
        yield samples, own, [signal for _, signal in group]


def _annotations(
    stream: BinaryIO,
    header: EdfHeader,
    marks: Sequence[EdfSignal],
    max_memory: int,
    notes: list[str],
) -> tuple[list[Fraction], list[tuple[Fraction, Fraction, str]]]:
    """The onsets of the records (of the first alone where they follow each other), and the
    annotations: onset, duration, text."""
    gapped = header.kind.endswith("+D")
    if not marks or not header.records:
        if gapped and header.records:
            raise ParameterError(f"the header says {header.kind}, and no signal has the onsets")
        return [Fraction(0)], []
    if gapped and header.records * 64 > max_memory:
        raise LimitError(f"the onsets of {header.records} records take too much (max_memory=)")
    onsets: list[Fraction] = []
    found: list[tuple[Fraction, Fraction, str]] = []
    bad = 0
    for record in range(header.records):
        for number, mark in enumerate(marks):
            stream.seek(header.start + record * header.record_size + mark.place * header.size)
            raw = bytes(read_bytes(stream, mark.samples * header.size))
            for place, part in enumerate(filter(None, raw.split(b"\0"))):
                onset, duration, texts = _parsed(part)
                if onset is None:
                    bad += 1
                    continue
                if number == place == 0 and (gapped or not onsets):
                    onsets.append(onset)
                found += [(onset, duration, text) for text in texts if text]
                if len(found) * _EVENT_SIZE > max_memory:
                    raise LimitError("the annotations take more than max_memory allows")
        if (gapped or not onsets) and len(onsets) <= (record if gapped else 0):
            if gapped:
                raise ParameterError(f"record {record + 1} has no onset")
            onsets.append(Fraction(0))
    if bad:
        notes.append(f"{bad} annotations are malformed and are not read")
    return onsets, found


def _parsed(part: bytes) -> tuple[Fraction | None, Fraction, list[str]]:
    """One time-stamped list of annotations."""
    head, *texts = part.decode(errors="replace").split("\x14")
    onset, _, duration = head.partition("\x15")
    if (
        not texts
        or _ONSET.fullmatch(onset) is None
        or (duration and _DURATION.fullmatch(duration) is None)
    ):
        return None, Fraction(0), []
    return Fraction(onset), Fraction(duration or 0), texts


def _sorted_out(
    written: Sequence[tuple[Fraction, Fraction, str]],
    zero: Fraction,
    signals: Sequence[EdfSignal],
    ours: bool,
    notes: list[str],
) -> tuple[list[Event], dict[int, list[tuple[Fraction, Fraction]]]]:
    """Events, and the gaps of each signal in seconds from the first record."""
    labels = [signal.label for signal in signals]
    events: list[Event] = []
    gaps: dict[int, list[tuple[Fraction, Fraction]]] = {}
    early = elsewhere = 0
    for onset, duration, text in written:
        words, at, label = text.rpartition("@@")
        number = labels.index(label) if at and labels.count(label) == 1 else None
        if ours and words == _NO_DATA:
            if number is not None:
                gaps.setdefault(number, []).append((onset - zero, duration))
        elif onset < zero:
            early += 1
        elif ours and at and number is None:
            elsewhere += 1
        else:
            said = text if number is None else words
            events.append(Event(onset - zero, said, duration, number))
    if early:
        notes.append(f"{early} annotations lie before the first record and are not read")
    if elsewhere:
        notes.append(f"{elsewhere} annotations of signals that were not selected are not read")
    return events, {number: sorted(own) for number, own in gaps.items()}


def _ticks(
    header: EdfHeader,
    samples: int,
    rate: Fraction,
    onsets: Sequence[Fraction],
    gaps: Sequence[tuple[Fraction, Fraction]],
    max_memory: int,
    notes: list[str],
) -> NDArray[np.int64] | None:
    """The tick of each row, where there are gaps; the rows of ``gaps`` are left out."""
    rows = samples * header.records
    if (len(onsets) > 1 or gaps) and 24 * rows > max_memory:
        raise LimitError(
            f"the ticks of {rows} rows take more than {max_memory} bytes (max_memory=)"
        )
    if len(onsets) > 1:
        starts = [(onset - onsets[0]) * rate for onset in onsets]
        rounded = [floor(start + Fraction(1, 2)) for start in starts]
        for place, (before, after) in enumerate(zip(rounded, rounded[1:], strict=False)):
            if after < before + samples:
                raise ParameterError(f"record {place + 2} begins before record {place + 1} ends")
        if rounded[-1] + samples > TICK_LIMIT:
            raise ParameterError("the records lie too far apart")
        if rounded != starts:
            notes.append("records that begin between two samples are moved by up to half a sample")
        if rounded[-1] != samples * (header.records - 1):
            first = np.array(rounded, np.int64)
            return (first[:, np.newaxis] + np.arange(samples)).reshape(-1)
        return None
    if not gaps:
        return None
    known = np.ones(rows, bool)
    for onset, duration in gaps:
        known[max(round(onset * rate), 0) : max(round((onset + duration) * rate), 0)] = False
    return np.flatnonzero(known)


def _metadata(header: EdfHeader, signals: Sequence[EdfSignal]) -> dict[str, Any]:
    """Texts of the header that say something."""
    found: dict[str, Any] = {}
    if header.patient.replace("X", "").strip():
        found["patient"] = header.patient
    if header.time:
        found["start_time"] = header.time
    words = header.recorded.split()
    if words[:1] == ["Startdate"]:
        words = words[2:]
    words = [word for word in words if word != _OURS]
    if set(words) - {"X"}:
        found["recording"] = " ".join(words)
    if filters := {s.label: s.prefilter for s in signals if s.prefilter}:
        found["prefiltering"] = filters
    return found


@dataclass(frozen=True)
class WrittenSignal:
    """A channel as counts. ``scale``: from physical values to counts, where they are rounded."""

    channel: Channel
    label: str
    unit: str
    physical: tuple[str, str]
    digital: tuple[int, int]
    samples: int
    scale: tuple[float, float] | None

    def counts(self, first: int, last: int) -> NDArray[np.int64]:
        """The counts of the stored samples first <= place < last."""
        if self.scale is None:
            stored: NDArray[np.int64] = self.channel.stored[first:last].astype(np.int64)
            return stored
        low, gain = self.scale
        x = np.rint((_physical(self.channel, first, last) - low) / gain) + self.digital[0]
        counts: NDArray[np.int64] = np.clip(x, *self.digital).astype(np.int64)
        return counts

    def held(self, first: int, count: int) -> NDArray[np.int64]:
        """[count] from the tick ``first`` on; a tick in a gap has the value before it."""
        if not self.channel.coverage:
            return np.full(count, self.digital[0])
        starts, stops = np.array(self.channel.coverage, np.int64).T
        before = np.cumsum(stops - starts) - (stops - starts)
        ticks = np.arange(first, first + count)
        span = np.maximum(np.searchsorted(starts, ticks, "right") - 1, 0)
        places = before[span] + np.clip(ticks, starts[span], stops[span] - 1) - starts[span]
        first_place = int(places[0])
        used = self.counts(first_place, int(places[-1]) + 1)
        held: NDArray[np.int64] = used[places - first_place]
        return held


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """EDF+ with counts of 16 bits."""
    return write_records(recording, target, options, 2)


def write_records(
    recording: Recording, target: Destination, options: WriteOptions, size: int
) -> list[str]:
    """Counts that fit ``size`` bytes and the texts of the header are exact. All other values are
    rounded, and a note says how far."""
    suffix = ".edf" if size == 2 else ".bdf"
    channels = [_without_nan(channel) for channel in recording.channels]
    if not any(channel.stored.size for channel in channels):
        raise ParameterError(f"a recording without samples cannot be written as {suffix}")
    notes: list[str] = []
    first = min(Fraction(c.start_tick) / c.rate_exact for c in channels if c.coverage)
    last = max(c.duration for c in channels)
    duration, text = _record_duration([c.rate_exact for c in channels], first, last, size, suffix)
    origin = floor(first / duration)
    records = ceil(last / duration) - origin
    filled = sum(int(c.rate_exact * duration) * records - c.stored.size for c in channels)
    if filled * size > options.max_memory:
        raise LimitError(
            f"the gaps take {filled * size} bytes in {suffix}, more than the "
            f"{options.max_memory} allowed; allow more (max_memory=) or write a part"
        )
    if records > _RECORDS_LIMIT:
        raise ParameterError(f"{suffix} holds at most {_RECORDS_LIMIT} records; write a part")
    labels = _short_labels([c.label for c in channels], notes)
    signals = [
        _written_signal(c, label, size, int(c.rate_exact * duration), notes)
        for c, label in zip(channels, labels, strict=True)
    ]
    zero = origin * duration
    shift, epoch = Fraction(0), None
    if recording.epoch_ns is not None:
        begin = recording.epoch_ns + zero * 10**9
        seconds = floor(begin / 10**9)
        shift = Fraction(round(begin) - seconds * 10**9, 10**9)
        epoch = _EPOCH + timedelta(seconds=seconds)
    elif origin:
        notes.append(f"the start, {float(zero):g} s, is not carried over to {suffix}")
    marks = _marks(recording, signals, zero, records, notes)
    onsets = [number * duration + shift for number in range(records)]
    pages, width = _pages(marks, onsets, shift, size)
    recorded = _recorded(recording, epoch)
    hidden = recording.metadata.get("start_time")
    clock = "00:00:00"
    if epoch is not None:
        clock = f"{epoch:%H:%M:%S}"
    elif isinstance(hidden, str) and _is_clock(hidden) and not origin:
        clock = hidden
    if filled:
        notes.append(
            f"{filled} samples that are missing are filled with the last value and marked "
            f"{_NO_DATA!r} by annotations"
        )
    stream = target.stream
    stream.write(
        _written_header(recording, signals, records, text, width, size, epoch, clock, recorded)
    )
    _write_samples(stream, signals, onsets, pages, origin, width, size)
    carried = {"epoch_ns", "unit", "label", "device", "events", "calibration"}
    carried |= {"patient"} if _patient(recording) != "X X X X" else set()
    carried |= {"recording"} if _words(recording) else set()
    carried |= {"start_time"} if clock == hidden else set()
    if any(s.scale is not None and s.channel.calibration is not None for s in signals):
        carried -= {"calibration"}
    return notes + not_carried(recording, suffix, *carried)


def _without_nan(channel: Channel) -> Channel:
    if channel.stored.dtype.kind != "f" or not (missing := np.isnan(channel.stored)).any():
        return channel
    ticks = np.concatenate([np.arange(*span) for span in channel.coverage])[~missing]
    return replace(channel, stored=channel.stored[~missing], coverage=spans_at(ticks))


def _physical(channel: Channel, first: int, last: int) -> NDArray[np.float64]:
    if channel.exact is not None:
        return channel.exact[first:last]
    if channel.calibration is not None:
        return channel.calibration.physical(channel.stored[first:last])
    return exact_doubles(channel.stored[first:last], f"channel {channel.label!r}")


def _record_duration(
    rates: Sequence[Fraction], first: Fraction, last: Fraction, size: int, suffix: str
) -> tuple[Fraction, str]:
    """Seconds of a record: a short decimal that holds whole samples of every channel, up to 1 s if
    there is one, and a divisor of the whole time if there is one."""
    step = Fraction(lcm(*(r.denominator for r in rates)), gcd(*(r.numerator for r in rates)))
    units = []
    for digits in range(7):
        scaled = step.numerator * 10**digits
        units.append(Fraction(scaled // gcd(scaled, step.denominator), 10**digits))
    unit = min(units)
    sampled = sum(int(rate * unit) for rate in rates) * size
    most = max(1, min(floor(1 / unit), _RECORD_SIZE // sampled))
    ticks = (last - first) / unit
    times = most
    if first % unit == 0 and ticks.denominator == 1:
        whole = int(ticks)
        times = min(times, whole)
        fits = [n for n in range(times, max(times // 10, 1) - 1, -1) if whole % n == 0
                and not (first / unit) % n]  # fmt: skip
        times = next((n for n in fits if _decimal(n * unit)), times)
    while times > 1 and not _decimal(times * unit):
        times -= 1
    text = _decimal(times * unit)
    if not text:
        raise ParameterError(
            f"no record of {suffix} holds whole samples of the rates "
            f"{', '.join(str(rate) for rate in sorted(set(rates))[:5])} Hz; use .npz"
        )
    return times * unit, text


def _decimal(value: Fraction) -> str:
    """Exactly, in at most 8 characters; "" where that does not go."""
    for digits in range(7):
        scaled = value * 10**digits
        if scaled.denominator == 1:
            text = _placed(int(scaled), digits)
            return text if len(text) <= _NUMBER_SIZE else ""
    return ""


def _placed(scaled: int, digits: int) -> str:
    """The text of scaled / 10**digits."""
    whole, part = divmod(abs(scaled), 10**digits)
    sign = "-" if scaled < 0 else ""
    return f"{sign}{whole}" + (f".{part:0{digits}}" if digits else "")


def _rounded(value: Fraction, up: bool, label: str) -> Fraction:
    """The nearest number of 8 characters below, or above."""
    for digits in range(6, -1, -1):
        scaled = (ceil if up else floor)(value * 10**digits)
        if len(_placed(scaled, digits)) <= _NUMBER_SIZE:
            return Fraction(scaled, 10**digits)
    raise ParameterError(
        f"channel {label!r} holds {float(value):g}, and the header has 8 characters for it; "
        "use a larger unit, or .npz"
    )


def _short_labels(labels: Sequence[str], notes: list[str]) -> list[str]:
    """ASCII labels of 16 characters, each once."""
    found: list[str] = []
    for number, label in enumerate(labels, start=1):
        plain = "".join(c if " " <= c <= "~" else "?" for c in label).replace("@@", "@").strip()
        short = plain[:16].strip() or f"ch{number}"
        extra = 2
        while short in found or short.endswith(" Annotations"):
            tail = f"_{extra}"
            short, extra = (plain or "ch")[: 16 - len(tail)] + tail, extra + 1
        if short != label:
            notes.append(f"the label {label!r} is written as {short!r}")
        found.append(short)
    return found


def _written_signal(
    channel: Channel, label: str, size: int, samples: int, notes: list[str]
) -> WrittenSignal:
    unit = "" if channel.unit == "1" else channel.unit
    if len(unit) > _NUMBER_SIZE:
        notes.append(f"the unit {unit!r} of channel {channel.label!r} is not carried over")
        unit = ""
    half = 1 << (8 * size - 1)
    stored = channel.stored
    if channel.calibration is not None and channel.exact is None:
        low, high = (int(stored.min()), int(stored.max())) if stored.size else (0, 0)
        ends = _exact_ends(channel.calibration, low, high, half)
        if ends is not None:
            return WrittenSignal(channel, label, unit, ends[1], ends[0], samples, None)
    values = _physical(channel, 0, stored.size)
    if not np.isfinite(values).all():
        raise ParameterError(f"channel {channel.label!r} holds infinities; use .npz")
    least, most = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    bottom = _rounded(Fraction(least), False, channel.label)
    top = _rounded(Fraction(most), True, channel.label)
    if bottom == top:
        bottom, top = _apart(bottom)
    digital = (-half, half - 1)
    gain = (top - bottom) / (2 * half - 1)
    shown = f" {unit}" if unit else ""
    finer = "; .bdf has finer steps" if size == 2 else ""
    notes.append(
        f"the values of channel {channel.label!r} are rounded to steps of {float(gain):.3g}"
        f"{shown}, at most {float(gain) * 0.501:.3g}{shown} off{finer}"
    )
    physical = (_decimal(bottom), _decimal(top))
    return WrittenSignal(
        channel, label, unit, physical, digital, samples, (float(bottom), float(gain))
    )


def _apart(value: Fraction) -> tuple[Fraction, Fraction]:
    """Two numbers of 8 characters, with the value at one end."""
    for step in (Fraction(1, 10**digits) for digits in range(6, -1, -1)):
        if _decimal(value + step):
            return value, value + step
    return value - 1, value


def _exact_ends(
    calibration: Calibration, low: int, high: int, half: int
) -> tuple[tuple[int, int], tuple[str, str]] | None:
    """Two counts around all of them, whose physical values have at most 8 characters."""
    if low < -half or high >= half:
        return None
    below = _exact_end(calibration, -half, low)
    above = _exact_end(calibration, half - 1, max(high, (below or 0) + 1))
    if below is None or above is None:
        return None
    return (below, above), (
        _decimal(calibration.exact(below)),
        _decimal(calibration.exact(above)),
    )


def _exact_end(calibration: Calibration, far: int, near: int) -> int | None:
    """A count from ``far`` to ``near`` with a short decimal; the farthest one that there is."""
    a, b, d = calibration.a, calibration.b, calibration.d
    step = 1 if near >= far else -1
    if step * far > step * near:
        return None
    for digits in range(7):
        # (a x + b) 10^digits is a multiple of d
        scaled = a * 10**digits
        factor = gcd(scaled, d)
        if b * 10**digits % factor:
            continue
        modulus = d // factor
        inverse = pow(scaled // factor, -1, modulus)
        root = int(-(b * 10**digits // factor) * inverse % modulus)
        distance: int = step * (root - far) % modulus
        places = [far + step * distance]
        if distance <= abs(near - far):
            places.append(near - step * ((step * (near - root)) % modulus))
            for x in places:
                if _decimal(calibration.exact(x)):
                    return x
    return None


def _marks(
    recording: Recording,
    signals: Sequence[WrittenSignal],
    zero: Fraction,
    records: int,
    notes: list[str],
) -> list[tuple[Fraction, Fraction, str]]:
    """Annotations in order: events, and the gaps of each signal, in seconds from the start."""
    found = []
    labels = recording.labels
    early, layers = 0, False
    for event in recording.events:
        text = "".join(c if c >= " " else " " for c in event.text) or "event"
        if text != event.text:
            notes.append(f"the text {event.text!r} of an event is written as {text!r}")
        if event.channel is not None:
            number = event.channel
            number = labels.index(number) if isinstance(number, str) else number
            text += f"@@{signals[number].label}"
        layers |= bool(event.layer)
        if event.time < zero:
            early += 1
            continue
        found.append((event.time - zero, event.duration, text))
    if early:
        notes.append(f"{early} events before the first sample are not carried over")
    if layers:
        notes.append("the layers of events are not carried over")
    for signal in signals:
        rate = signal.channel.rate_exact
        start = int(zero * rate)
        at = 0
        stop = signal.samples * records
        for span in [*signal.channel.coverage, Span(start + stop, start + stop)]:
            if span.start - start > at:
                text = f"{_NO_DATA}@@{signal.label}"
                found.append((at / rate, (span.start - start - at) / rate, text))
            at = span.stop - start
    return sorted(found)


def _seconds(value: Fraction) -> str:
    """In at most 12 decimals."""
    text = _placed(round(value * 10**12), 12)
    return text.rstrip("0").rstrip(".")


def _pages(
    marks: Sequence[tuple[Fraction, Fraction, str]],
    onsets: Sequence[Fraction],
    shift: Fraction,
    size: int,
) -> tuple[list[bytes], int]:
    """The annotations of each record after its onset, and the samples that they take there."""
    written = []
    for onset, length, text in marks:
        lasts = f"\x15{_seconds(length)}" if length else ""
        written.append(f"+{_seconds(onset + shift)}{lasts}\x14{text}\x14\0".encode())
    longest = max(map(len, written), default=0)
    room = -(-sum(map(len, written)) // len(onsets)) + longest
    pages, page = [], b""
    for each in written:
        if len(page) + len(each) > room:
            pages.append(page)
            page = b""
        page += each
    pages.append(page)
    room = max(map(len, pages))
    return pages, -(-(room + max(len(_onset(onset)) for onset in onsets)) // size)


def _onset(value: Fraction) -> bytes:
    return f"+{_seconds(value)}\x14\x14\0".encode()


def _patient(recording: Recording) -> str:
    text = recording.metadata.get("patient")
    usable = isinstance(text, str) and 0 < len(text) <= 80 and text.isascii() and text.isprintable()
    return text if usable and isinstance(text, str) else "X X X X"


def _words(recording: Recording) -> list[str]:
    text = recording.metadata.get("recording")
    if not isinstance(text, str) or not (text.isascii() and text.isprintable()) or len(text) > 46:
        return []
    return text.split()


def _recorded(recording: Recording, epoch: datetime | None) -> str:
    date = "X"
    if epoch is not None:
        date = f"{epoch.day:02}-{_MONTHS[epoch.month - 1]}-{epoch.year:04}"
    words = _words(recording)
    words += ["X"] * (2 - len(words))
    return " ".join(["Startdate", date, *words, _OURS])


def _written_header(
    recording: Recording,
    signals: Sequence[WrittenSignal],
    records: int,
    duration: str,
    width: int,
    size: int,
    epoch: datetime | None,
    clock: str,
    recorded: str,
) -> bytes:
    name = "EDF" if size == 2 else "BDF"
    half = 1 << (8 * size - 1)
    moment = epoch or datetime(_TWO_DIGITS_FROM, 1, 1, tzinfo=UTC)
    known = _TWO_DIGITS_FROM <= moment.year < _TWO_DIGITS_FROM + 100
    head = [
        "0" if size == 2 else "\xffBIOSEMI",
        _patient(recording),
        recorded,
        f"{moment:%d.%m}.{moment.year % 100:02}" if known else f"{moment:%d.%m}.yy",
        clock.replace(":", "."),
        str(_HEADER * (len(signals) + 2)),
        f"{name}+C",
        str(records),
        duration,
        str(len(signals) + 1),
    ]
    rows = [
        [
            s.label, _ascii(s.channel.device, 80), s.unit, *s.physical, *map(str, s.digital), "",
            str(s.samples), "",
        ]
        for s in signals
    ]  # fmt: skip
    rows.append([
        f"{name} Annotations", "", "", "-1", "1", str(-half), str(half - 1), "", str(width), "",
    ])  # fmt: skip
    columns = zip(*rows, strict=True)
    text = "".join(map(str.ljust, head, _FIELDS))
    for column, length in zip(columns, _SIGNAL_FIELDS, strict=True):
        text += "".join(value.ljust(length) for value in column)
    return text.encode("latin-1")


def _ascii(text: str, size: int) -> str:
    return "".join(c if " " <= c <= "~" else "?" for c in text)[:size]


def _write_samples(
    stream: BinaryIO,
    signals: Sequence[WrittenSignal],
    onsets: Sequence[Fraction],
    pages: Sequence[bytes],
    origin: int,
    width: int,
    size: int,
) -> None:
    """Some records at a time; a gap repeats the value before it."""
    record_size = size * (sum(signal.samples for signal in signals) + width)
    at_once = max(1, _BLOCK // record_size)
    for first in range(0, len(onsets), at_once):
        count = min(at_once, len(onsets) - first)
        rows = [
            _raw(signal.held((origin + first) * signal.samples, count * signal.samples), size)
            for signal in signals
        ]
        marks = b"".join(
            (_onset(onsets[record]) + (pages[record] if record < len(pages) else b"")).ljust(
                width * size, b"\0"
            )
            for record in range(first, first + count)
        )
        parts = [row.reshape(count, -1) for row in rows]
        parts.append(np.frombuffer(marks, np.uint8).reshape(count, -1))
        stream.write(np.concatenate(parts, axis=1).tobytes())


def _raw(counts: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    """The low bytes of each count."""
    return np.ascontiguousarray(counts.astype("<i4").view(np.uint8).reshape(-1, 4)[:, :size])
