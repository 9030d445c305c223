"""Reads .tdms, recordings of LabVIEW and DAQmx.

npTDMS reads the structure, and the values chunk by chunk. Each channel is a table of its own, since
a file may hold them in any lengths and at any rates. Integers with one linear scale stay integers.
Other scales give what npTDMS computes.
"""

from __future__ import annotations

import logging
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from math import isfinite, lcm
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockObservation
from ..errors import LimitError, MissingExtraError, ParameterError
from ..limits import TICK_LIMIT
from ..numbers import exact, hertz, rdiv
from ..recording import Calibration
from .common import filled_rates, refusing, selected, several_rates, unit_of
from .formats import ReadOptions, Source
from .tables import Import, ImportBlock, ImportColumn, ImportTable
from .timestamps import Placed, observations, place, place_at_need, stamp_channel, stamp_label

_NS = 10**9
_EPOCH_S = 2_082_844_800
"""From 1904, where the stamps begin, to 1970."""
_INTERLEAVED = 1 << 5
_RAW = 0xFFFFFFFF
"""A scale with this source takes the values of the file."""
_WORK = 10_000_000
"""npTDMS visits each object in each segment: so often at most."""
_SCALES = 100
"""Scales of a channel, and steps that they may take together."""
_ROWS = 1 << 16
_METADATA = 1 << 18
"""Characters of properties that are kept."""
_OWN = re.compile(r"NI_(Scal|Number_Of_Scales)|wf_|unit_string$|NI_UnitDescription$")
"""Properties that are read, so that they need not be kept as text."""


@dataclass
class TdmsChannel:
    path: str
    group: str
    name: str
    rows: int
    kind: Any
    """The class of npTDMS for its values."""
    properties: Mapping[str, Any]
    scaling: Any
    scaler: int | None = None
    """Number of the values in a DAQmx chunk; None where they are plain."""
    raw: np.dtype[Any] | None = None
    calibration: Calibration | None = None
    dtype: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float64))
    rate: Fraction | None = None
    start_ns: int | None = None
    ticks: NDArray[np.int64] | None = None
    stamps: tuple[Placed, NDArray[np.int64]] | None = None
    """The time stamps of the group, in the first channel that takes them."""


def read(source: Source, options: ReadOptions) -> Import:
    """Each channel is a table."""
    try:
        from nptdms.reader import TdmsReader
    except ImportError:
        raise MissingExtraError("npTDMS", "tdms") from None
    notes: list[str] = []
    stream = _Bounded(source.stream)

    class Counted(TdmsReader):  # type: ignore[misc]
        """Stops where reading the structure takes too long."""

        work = 0

        def _update_object_metadata(self, segment: Any) -> None:
            self.work += 1 + len(segment.ordered_objects)
            if self.work > _WORK:
                raise LimitError("too many segments with too many channels; defragment the file")
            super()._update_object_metadata(segment)

    with _foreign():
        reader = Counted(stream)
        reader.read_metadata()
        channels, properties = _channels(reader)
    _check_chunks(reader, options.max_memory)
    if any(segment.segment_incomplete for segment in reader._segments):
        notes.append(
            "the file is cut off in its last segment; the values up to there are read, the rest is "
            "lost"
        )
    names = [f"{channel.group}/{channel.name}" for channel in channels]
    wanted = [channels[at] for at in selected(names, options.select, "channel")]
    found = [channel for channel in wanted if _is_numeric(channel, notes, wanted)]
    seen = _timed(reader, channels, found, options, notes)
    zero = min((c.start_ns for c in found if c.start_ns is not None), default=None)
    tables = [
        _table(channel, label, zero, notes)
        for channel, label in zip(found, _labels(found), strict=True)
    ]
    clocks = [replace(c, tick=c.tick + tables[number].start_tick) for number, c in seen]
    clocks += _starts(found, tables)
    kept = []
    stamped = sum(channel.stamps is not None for channel in found)
    for channel, table in zip(found, tuple(tables), strict=True):
        if channel.stamps is not None and options.keep_stamps:
            kept.append(stamp_channel(*channel.stamps, zero or 0, table.start_tick))
            name = stamp_label(channel.group, stamped)
            column = ImportColumn(name, "ns", group=channel.group, dtype=kept[-1].dtype)
            tables.append(replace(table, name=name, columns=(column,), kind="TimeStamp"))
    return Import(
        tuple(tables),
        partial(_blocks, reader, found, kept),
        zero,
        metadata=_kept(properties, notes),
        notes=tuple(notes),
        clocks=tuple(clocks),
    )


class _Bounded:
    """A stream that never allocates more than it has left."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = stream.seek(0, os.SEEK_END)
        self.seek, self.tell = stream.seek, stream.tell
        stream.seek(0)

    def read(self, size: int = -1) -> bytes:
        left = max(self.size - self.tell(), 0)
        return self._stream.read(left if size < 0 else min(size, left))

    def readinto(self, target: Any) -> int:
        data = self.read(memoryview(target).nbytes)
        memoryview(target).cast("B")[: len(data)] = data
        return len(data)


@contextmanager
def _foreign() -> Iterator[None]:
    """npTDMS raises plain Exceptions, and prints warnings that are notes here."""
    from nptdms.log import log_manager

    level = log_manager.log_level
    log_manager.set_level(logging.CRITICAL)
    try:
        with refusing("this TDMS file cannot be read", Exception), np.errstate(all="ignore"):
            yield
    finally:
        log_manager.set_level(level)


def _channels(reader: Any) -> tuple[list[TdmsChannel], dict[str, Mapping[str, Any]]]:
    """The channels, and the properties of all objects by path."""
    from nptdms.common import ObjectPath
    from nptdms.scaling import get_scaling

    found: list[TdmsChannel] = []
    properties = {path: each.properties for path, each in reader.object_metadata.items()}
    for path, each in reader.object_metadata.items():
        names = ObjectPath.from_string(path)
        if not names.is_channel:
            continue
        of_all = (each.properties, properties.get(names.group_path(), {}), properties.get("/", {}))
        for own in of_all:
            _check_scales(path, own)
        channel = TdmsChannel(
            path, names.group, names.channel, each.num_values, each.data_type, each.properties,
            get_scaling(*of_all),
        )  # fmt: skip
        if each.num_values:
            _scale(channel, each.scaler_data_types)
        found.append(channel)
    return found, properties


def _check_scales(path: str, properties: Mapping[str, Any]) -> None:
    count = int(properties.get("NI_Number_Of_Scales", 0))
    for key in properties:
        if number := re.match(r"NI_Scale\[(\d{1,20})\]", key):
            count = max(count, int(number[1]) + 1)
    if count > _SCALES:
        raise LimitError(f"{path} has {count} scales, more than {_SCALES}")


def _scale(channel: TdmsChannel, scalers: Mapping[int, Any] | None) -> None:
    """Find the values that are read, and their scale."""
    line: tuple[Fraction, Fraction] | None = (Fraction(1), Fraction(0))
    if channel.scaling is not None:
        scales = channel.scaling.scalings
        if _steps(scales, len(scales) - 1, _SCALES) < 0:
            raise LimitError(f"the scales of {channel.path} take more than {_SCALES} steps")
        line, channel.scaler = _line(scales, len(scales) - 1)
    elif scalers:
        if len(scalers) > 1:
            raise ParameterError(f"{channel.path} has several raw values and no scale")
        (channel.scaler,) = scalers
    kind = channel.kind if channel.scaler is None else (scalers or {})[channel.scaler]
    raw = kind.nptype if kind is not None and kind.nptype is not None else None
    channel.raw = None if raw is None else raw.newbyteorder("=")
    if raw is None or line is None:
        return
    if raw.kind == "b" or (raw.kind in "iu" and (raw.itemsize < 4 or raw == np.int32)):
        channel.calibration = _calibration(*line, raw)
        if channel.calibration is not None:
            channel.dtype = np.dtype(np.int32)
    elif line[0] == 1 and line[1] == 0:
        channel.dtype = np.dtype(np.uint64) if raw == np.uint32 else raw.newbyteorder("=")


def _steps(scales: Sequence[Any], at: int, left: int) -> int:
    """The steps left after computing a scale; below 0: it takes too many, or never ends."""
    if left < 0 or at == _RAW:
        return left
    for name in ("input_source", "left_input_source", "right_input_source"):
        if (source := getattr(scales[at], name, None)) is not None:
            left = _steps(scales, source, left - 1)
    return left


def _line(scales: Sequence[Any], at: int) -> tuple[tuple[Fraction, Fraction] | None, int | None]:
    """Gain and offset, if the scale is linear, and the DAQmx values that it takes."""
    from nptdms import scaling

    if at == _RAW:
        return (Fraction(1), Fraction(0)), None
    scale = scales[at]
    if isinstance(scale, scaling.DaqMxScalerScaling):
        return (Fraction(1), Fraction(0)), scale.scale_id
    if not hasattr(scale, "input_source"):
        return None, None
    line, scaler = _line(scales, scale.input_source)
    if isinstance(scale, scaling.NoOpScaling):
        return line, scaler
    terms: list[float] = []
    if isinstance(scale, scaling.LinearScaling):
        terms = [scale.intercept, scale.slope]
    elif isinstance(scale, scaling.PolynomialScaling) and not any(scale.coefficients[2:]):
        terms = [*scale.coefficients[:2], 0.0, 0.0][:2]
    if line is None or not terms or not all(isfinite(term) for term in terms) or not terms[1]:
        return None, scaler
    offset, gain = (exact(term) for term in terms)
    return (gain * line[0], gain * line[1] + offset), scaler


def _calibration(gain: Fraction, offset: Fraction, raw: np.dtype[Any]) -> Calibration | None:
    """None where the scale has too many digits."""
    d = lcm(gain.denominator, offset.denominator)
    ends = (0, 1) if raw.kind == "b" else (int(np.iinfo(raw).min), int(np.iinfo(raw).max))
    try:
        found = Calibration(int(gain * d), int(offset * d), d)
    except ParameterError:
        return None
    return found if found.covers(*ends) else None


def _check_chunks(reader: Any, max_memory: int) -> None:
    """LimitError where npTDMS would hold too much at once."""
    for segment in reader._segments:
        whole = segment.next_segment_pos - segment.data_position
        size = segment.chunk_size_cached or 0
        if segment.toc_mask & _INTERLEAVED:
            size = whole
        elif not segment.has_daqmx_objects_cached:
            size = min(size, whole)
        if size > max_memory:
            raise LimitError(
                f"a chunk at byte {segment.data_position} takes {size} bytes, more than the "
                f"{max_memory} allowed; allow more (max_memory=)"
            )


def _is_numeric(channel: TdmsChannel, notes: list[str], channels: Sequence[TdmsChannel]) -> bool:
    name = f"{channel.group}/{channel.name}"
    if not channel.rows:
        notes.append(f"channel {name!r} holds no values")
        return False
    if channel.raw is None or channel.raw.kind not in "iufb" or channel.raw.itemsize > 8:
        what = getattr(channel.kind, "__name__", "unknown")
        if what != "TimeStamp" or not any(_is_time_of(channel, other) for other in channels):
            notes.append(f"channel {name!r} holds {what} values, which are not read")
        return False
    if channel.calibration is None and channel.raw.kind in "iub" and channel.dtype.kind == "f":
        notes.append(
            f"the scale of channel {name!r} is not an exact linear one; its values are doubles"
        )
    return True


def _is_time_of(time: TdmsChannel, other: TdmsChannel) -> bool:
    return (
        getattr(time.kind, "__name__", "") == "TimeStamp"
        and (time.group, time.rows) == (other.group, other.rows)
        and other.raw is not None
        and other.raw.kind in "iufb"
        and _rate(other) is None
    )


def _rate(channel: TdmsChannel) -> Fraction | None:
    step = channel.properties.get("wf_increment")
    if not isinstance(step, (int, float)) or not isfinite(step) or step <= 0:
        return None
    if not isfinite(1 / step):
        raise ParameterError(f"the wf_increment of {channel.path} is too small: {step}")
    return hertz(1 / step)


def _timed(
    reader: Any,
    channels: Sequence[TdmsChannel],
    found: Sequence[TdmsChannel],
    options: ReadOptions,
    notes: list[str],
) -> list[tuple[int, ClockObservation]]:
    """Give each channel its rate, and its start if there is one. What clocks showed at the ticks of
    a channel."""
    times: dict[str, list[int]] = {}
    for number, channel in enumerate(found):
        channel.rate = _rate(channel)
        own = [time for time in channels if _is_time_of(time, channel)]
        if channel.rate is None and len(own) == 1:
            times.setdefault(own[0].path, []).append(number)
            continue
        if channel.rate is None and options.rate is None:
            raise ParameterError(
                f"channel {channel.group}/{channel.name} has no wf_increment, and its group no "
                "time stamps of the same length; give a rate (rate=) or select other channels "
                "(select=)"
            )
        channel.start_ns = _start(channel)
    path_of = {number: path for path, numbers in times.items() for number in numbers}
    stated = [
        (f"{channel.group}/{channel.name}", channel.rate, path_of.get(number))
        for number, channel in enumerate(found)
    ]
    rates, is_forced = filled_rates(options.rate, stated, notes)
    is_used = is_forced or rates != [channel.rate for channel in found]
    for channel, rate in zip(found, rates, strict=True):
        channel.rate = rate
    return _placed(
        reader, {c.path: c for c in channels}, found, times, options, notes,
        is_forced=is_forced, is_used=is_used,
    )  # fmt: skip


def _start(channel: TdmsChannel) -> int | None:
    start = channel.properties.get("wf_start_time")
    if start is None or not getattr(start, "seconds", 0):
        return None
    ns = _since_1970(int(start.seconds), int(start.second_fractions))
    offset = channel.properties.get("wf_start_offset", 0.0)
    if isinstance(offset, (int, float)) and isfinite(offset):
        ns += round(exact(offset) * _NS)
    if not -(1 << 62) < ns < 1 << 62:
        raise ParameterError(f"the wf_start_time of {channel.path} is too far away")
    return ns


def _since_1970(seconds: int, fractions: int) -> int:
    return (seconds - _EPOCH_S) * _NS + ((fractions * _NS + (1 << 63)) >> 64)


def _placed(
    reader: Any,
    channels: Mapping[str, TdmsChannel],
    found: Sequence[TdmsChannel],
    times: Mapping[str, Sequence[int]],
    options: ReadOptions,
    notes: list[str],
    *,
    is_forced: bool,
    is_used: bool,
) -> list[tuple[int, ClockObservation]]:
    """Place the rows by the time stamps of their group. ``is_forced``: at the caller's rate.
    ``is_used``: another channel takes that."""
    if sum(32 * channels[path].rows for path in times) > options.max_memory:
        raise LimitError(
            f"the time stamps take more than the {options.max_memory} bytes allowed; allow more "
            "(max_memory=) or select other channels (select=)"
        )
    parts: dict[str, list[NDArray[np.int64]]] = {path: [] for path in times}
    if times:
        for path, raw in _raw_chunks(reader):
            if path in parts and raw.data is not None:
                parts[path].append(_stamps(raw.data))
    clocks: list[tuple[int, ClockObservation]] = []
    for path, numbers in times.items():
        stamps = np.concatenate(parts[path])
        name = f"{channels[path].group}/{channels[path].name}"
        if len(stamps) != channels[path].rows:
            raise ParameterError(f"the time stamps of {name} end before their number")
        if is_forced:
            placed = place(stamps, name=name, rate=options.rate)
        else:
            placed, took = place_at_need(stamps, options.rate, name=name)
            is_used |= took
        if placed is None:
            raise ParameterError(f"the time stamps of {name} have no rate; give one (rate=)")
        notes.extend(placed.notes)
        plain = bool((np.diff(placed.ticks) == 1).all())
        for number in numbers:
            found[number].rate, found[number].start_ns = placed.rate, placed.start_ns
            found[number].ticks = None if plain else placed.ticks
        first = numbers[0]
        found[first].stamps = placed, stamps
        clocks += [
            (first, ClockObservation(*seen))
            for seen in observations(placed, stamps, name, 0, first)
        ]
    if options.rate is not None and found and not is_used:
        raise several_rates()
    return clocks


def _stamps(data: Any) -> NDArray[np.int64]:
    seconds = np.asarray(data.seconds, np.int64)
    if seconds.size and not (np.abs(seconds - _EPOCH_S) < 4 * _NS).all():
        raise ParameterError("a time stamp is too far away")
    parts = np.asarray(data.second_fractions, np.uint64) >> np.uint64(32)
    ns = (parts.astype(np.int64) * _NS + (1 << 31)) >> 32
    return np.asarray((seconds - _EPOCH_S) * _NS + ns)


def _labels(channels: Sequence[TdmsChannel]) -> list[str]:
    """With the group in front where two groups use the same."""
    seen = Counter(channel.name for channel in channels)
    return [
        channel.name if seen[channel.name] == 1 else f"{channel.group}.{channel.name}"
        for channel in channels
    ]


def _table(channel: TdmsChannel, label: str, zero: int | None, notes: list[str]) -> ImportTable:
    assert channel.rate is not None
    start = 0
    if zero is not None and channel.start_ns is not None:
        rate = channel.rate
        start = rdiv((channel.start_ns - zero) * rate.numerator, rate.denominator * _NS)
    last = channel.rows - 1 if channel.ticks is None else int(channel.ticks[-1])
    if start + last >= TICK_LIMIT:
        raise ParameterError(f"channel {label!r} begins too long after the first one")
    text = next(
        (
            text
            for key in ("unit_string", "NI_UnitDescription")
            if isinstance(text := channel.properties.get(key), str) and text
        ),
        "",
    )
    column = ImportColumn(
        label,
        unit_of(text, label, notes, about=channel.group),
        group=channel.group,
        calibration=channel.calibration,
        dtype=channel.dtype,
        source_unit=text,
    )
    name = f"{channel.group}/{channel.name}"
    kind = getattr(channel.kind, "__name__", "")
    return ImportTable(name, (column,), channel.rate, channel.rows, channel.ticks, start, kind)


def _starts(
    channels: Sequence[TdmsChannel], tables: Sequence[ImportTable]
) -> list[ClockObservation]:
    """The exact start of each channel that does not begin on a tick of the first."""
    known = [(n, c) for n, c in enumerate(channels) if c.start_ns is not None and c.ticks is None]
    zero = min((c.start_ns for c in channels if c.start_ns is not None), default=0)
    return [
        ClockObservation("wf_start_time", number, tables[number].start_tick, channel.start_ns)
        for number, channel in known
        if channel.start_ns is not None
        and (channel.start_ns - zero) * tables[number].rate != tables[number].start_tick * _NS
    ]


def _raw_chunks(reader: Any) -> Iterator[tuple[str, Any]]:
    chunks = reader.read_raw_data()
    while True:
        with _foreign():
            chunk = next(chunks, None)
        if chunk is None:
            return
        yield from chunk.channel_data.items()


def _blocks(
    reader: Any, channels: Sequence[TdmsChannel], kept: Sequence[NDArray[np.int64]]
) -> Iterator[ImportBlock]:
    numbers = {channel.path: number for number, channel in enumerate(channels)}
    done = [0] * len(channels)
    for path, raw in _raw_chunks(reader):
        if path not in numbers:
            continue
        number = numbers[path]
        channel = channels[number]
        for first in range(0, len(raw), _ROWS):
            with _foreign():
                x = _values(channel, raw, first, min(first + _ROWS, len(raw)))
            if done[number] + len(x) > channel.rows:
                raise ParameterError("the rows of the file changed while it was read")
            yield ImportBlock(number, done[number], [x])
            done[number] += len(x)
    for number, stamps in enumerate(kept, start=len(channels)):
        for first in range(0, len(stamps), _ROWS):
            yield ImportBlock(number, first, [stamps[first : first + _ROWS]])


@dataclass
class _Part:
    data: Any
    scaler_data: Any


def _values(channel: TdmsChannel, raw: Any, first: int, last: int) -> NDArray[Any]:
    part = _Part(
        None if raw.data is None else raw.data[first:last],
        None
        if raw.scaler_data is None
        else {number: x[first:last] for number, x in raw.scaler_data.items()},
    )
    if channel.calibration is None and channel.dtype.kind == "f" and channel.scaling is not None:
        found = channel.scaling.scale(part)
    elif channel.scaler is None:
        found = part.data
    else:
        found = part.scaler_data[channel.scaler]
    return np.asarray(found).astype(channel.dtype, copy=False)


def _kept(properties: Mapping[str, Mapping[str, Any]], notes: list[str]) -> dict[str, Any]:
    """Properties that say something else than the channels do, by the path of their object."""
    kept: dict[str, dict[str, Any]] = {}
    left = _METADATA
    for path, own in properties.items():
        for key, value in own.items():
            if _OWN.match(key) or (key == "name" and path != "/"):
                continue
            said = _plain(value)
            left -= len(key) + len(str(said)) + len(path)
            if left < 0:
                notes.append("the properties are long, and not all of them are kept")
                return {"properties": kept} if kept else {}
            kept.setdefault(path, {})[key] = said
    return {"properties": kept} if kept else {}


def _plain(value: Any) -> Any:
    if isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value) if abs(int(value)) < 1 << 53 else str(int(value))
    if isinstance(value, (float, np.floating)):
        return float(value) if isfinite(value) else str(value)
    return str(value)
