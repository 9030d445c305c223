"""Our own layout of MAT files of version 5: a structure for each rate.

=========================  ======================================================================
``rate_1000Hz.time``       [rows, 1] seconds from the zero of the recording
``rate_1000Hz.fs``         samples per second
``rate_1000Hz.fx``         [rows, 1] values of a channel; NaN is a gap. Integers are counts, and 0
                           in gaps
``rate_1000Hz.units``      UCUM code of each channel: ``units.fx``
``rate_1000Hz.scale``      of the channels that are counts with a scale: the value is
``rate_1000Hz.offset``     count * ``scale.fx`` + ``offset.fx``
``events``                 ``time`` and ``duration`` in seconds, ``text``, ``layer``
``attachments``            ``a1``, ``a2``: bytes
``hapfmt``                 JSON: all that a recording holds but its samples and attachments, exactly
=========================  ======================================================================

It is read back from ``hapfmt`` and the values alone; the other members are for people.
"""

from __future__ import annotations

import json
import re
import shutil
import struct
import tempfile
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockMap, ClockObservation
from ..errors import LimitError, MissingExtraError, ParameterError
from ..limits import TICK_LIMIT
from ..numbers import checked_rate
from ..recording import (
    CHANNEL_LIMIT,
    Calibration,
    Channel,
    Event,
    Recording,
    extent,
    index_of_channel,
)
from ..spool import release
from .common import not_carried, rate_from, refusing
from .formats import Destination, ReadOptions, WriteOptions
from .layouts import SourceArray, SourceTree
from .mat5_files import HEADER
from .stored import (
    CARRIED,
    DESCRIBED,
    Spans,
    Stored,
    check_gaps,
    checked_spans,
    column_of,
    exact_note,
    import_of_stored,
    integer_of,
    of_channels,
    reference_of,
    seconds_of,
    spans_of,
    times_of,
)
from .tables import Import

FORMAT = "hapfmt recording"
LARGEST = (1 << 31) - 1
"""Bytes of a variable in MATLAB's own files of version 5."""
_RESERVED = ("time", "fs", "units", "scale", "offset")
_LONGEST_NAME = 63
_TAG, _COMPRESSED, _PIECE = struct.Struct("<II"), 15, 1 << 20
_AROUND = 256
"""Bytes around each array in a structure, at most."""


class _Variables(dict[str, Any]):
    """Variables that are made when savemat asks for them, one after the other."""

    def __init__(self, made: Iterator[tuple[str, Any]]) -> None:
        super().__init__()
        self._made = made

    def items(self) -> Any:
        return self._made


def write_ours(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """All of it; returns notes on what is not kept."""
    by_rate: dict[Fraction, list[int]] = {}
    for place, channel in enumerate(recording.channels):
        by_rate.setdefault(checked_rate(channel.rate_exact), []).append(place)
    check_gaps(recording, by_rate, ".mat", options.max_memory)
    names = identifiers([f"rate_{float(rate):.6g}Hz" for rate in by_rate], ())
    fields = {
        rate: identifiers([recording.channels[place].label for place in places], _RESERVED)
        for rate, places in by_rate.items()
    }
    tables = list(zip(names, by_rate.items(), fields.values(), strict=True))
    for _, (rate, places), _ in tables:
        _check_size(recording, rate, places)
    with tempfile.TemporaryFile() as plain:
        with refusing("this cannot be written as MAT"), warnings.catch_warnings():
            warnings.simplefilter("error")
            _savemat(_Plain(plain), _Variables(_variables(recording, tables, options)))
        plain.seek(len(HEADER))
        target.stream.write(HEADER)  # scipy writes the date into its own
        while tag := plain.read(_TAG.size):
            _write_compressed(plain, tag, target.stream)
    return [
        *not_carried(recording, ".mat", *CARRIED, *recording.metadata),
        *exact_note(recording),
    ]


class _Plain:
    """The file that savemat fills. What was written of samples need not stay in memory."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.seek, self.tell = file.seek, file.tell

    def write(self, data: bytes) -> int:
        release()
        return self._file.write(data)


def _write_compressed(plain: IO[bytes], tag: bytes, stream: IO[bytes]) -> None:
    """A variable, compressed piece by piece. scipy would compress all of it in memory."""
    left, packing = _TAG.unpack(tag)[1], zlib.compressobj()
    with tempfile.TemporaryFile() as packed:
        packed.write(packing.compress(tag))
        while block := plain.read(min(left, _PIECE)):
            left -= len(block)
            packed.write(packing.compress(block))
        packed.write(packing.flush())
        stream.write(_TAG.pack(_COMPRESSED, packed.tell()))
        packed.seek(0)
        shutil.copyfileobj(packed, stream, _PIECE)


def _savemat(file: Any, variables: Mapping[str, Any]) -> None:
    try:
        from scipy.io import savemat
    except ImportError:
        raise MissingExtraError("scipy", "mat") from None
    savemat(
        file, variables, appendmat=False, format="5", long_field_names=True, oned_as="column",
    )  # fmt: skip


def _check_size(recording: Recording, rate: Fraction, places: list[int]) -> None:
    channels = [recording.channels[place] for place in places]
    first, last = extent(channels)
    row = 8 + sum(_dtype(channel).itemsize for channel in channels)
    size = (last - first) * row + (4 * len(channels) + 8) * _AROUND
    if size > LARGEST:
        raise LimitError(
            f"the channels of {rate} Hz take {size} bytes, and a variable of a MAT file at most "
            f"{LARGEST}; write .h5, or a part"
        )


def identifiers(texts: list[str], taken: tuple[str, ...]) -> list[str]:
    """A name for each text that MATLAB allows, all different."""
    used, count, found = set(taken), dict.fromkeys(taken, 1), []
    for number, text in enumerate(texts, 1):
        name = re.sub(r"[^A-Za-z0-9_]", "_", text)[:_LONGEST_NAME]
        if re.match("[A-Za-z]", name) is None:
            name = f"ch{number}_{name.strip('_')}".rstrip("_")[:_LONGEST_NAME]
        stem = name
        while name in used:
            count[stem] = count.get(stem, 1) + 1
            end = f"_{count[stem]}"
            name = stem[: _LONGEST_NAME - len(end)] + end
        used.add(name)
        found.append(name)
    return found


_Tables = list[tuple[str, tuple[Fraction, list[int]], list[str]]]


def _variables(
    recording: Recording, tables: _Tables, options: WriteOptions
) -> Iterator[tuple[str, Any]]:
    """The name and the value of each variable."""
    done, total = 0, recording.sample_count
    described: list[dict[str, Any]] = [{} for _ in recording.channels]
    rates = []
    for name, (rate, places), fields in tables:
        channels = [recording.channels[place] for place in places]
        first, last = extent(channels)
        rates.append({"name": name, "rate": str(rate), "start_tick": first, "rows": last - first})
        about: dict[str, dict[str, Any]] = {"units": {}, "scale": {}, "offset": {}}
        values: dict[str, Any] = {
            "time": times_of(rate, first, last),
            "fs": float(rate),
        }
        for place, field, channel in zip(places, fields, channels, strict=True):
            described[place] = {"table": len(rates) - 1, "field": field} | _described(
                channel, first, last
            )
            values[field] = _dense(channel, first, last)
            about["units"][field] = _shown(channel.unit)
            known = channel.calibration
            if known is not None and channel.exact is None and known != Calibration():
                about["scale"][field] = known.a / known.d
                about["offset"][field] = known.b / known.d
            done += channel.stored.size
            if options.progress:
                options.progress(done, total)
        yield name, values | {key: each for key, each in about.items() if each}
    if recording.events:
        yield "events", _events(recording)
    files = {
        f"a{number}": np.frombuffer(content, np.uint8)
        for number, (_, content) in enumerate(recording.attachments.values(), 1)
    }
    if files:
        yield "attachments", files
    yield "hapfmt", json.dumps(_header(recording) | {"tables": rates, "channels": described})


def _dtype(channel: Channel) -> np.dtype[Any]:
    """MATLAB has no float16."""
    x = channel.stored if channel.exact is None else channel.exact
    return np.dtype(np.float32) if x.dtype == np.float16 else x.dtype


def _dense(channel: Channel, first: int, last: int) -> NDArray[Any]:
    """[last - first] values, NaN or 0 in gaps."""
    x: NDArray[Any] = channel.stored if channel.exact is None else channel.exact
    dtype = _dtype(channel)
    if x.size == last - first:
        return x.astype(dtype, copy=False)
    found = np.full(last - first, np.nan if dtype.kind == "f" else 0, dtype)
    at = 0
    for span in channel.coverage:
        found[span.start - first : span.stop - first] = x[at : at + span.ticks]
        at += span.ticks
    return found


def _described(channel: Channel, first: int, last: int) -> dict[str, Any]:
    found: dict[str, Any] = {"label": channel.label, "units": channel.unit}
    found |= {name: getattr(channel, name) for name in DESCRIBED if getattr(channel, name)}
    if channel.lsb is not None:
        found["lsb"] = float(channel.lsb)
    if channel.deviation is not None:
        found["deviation"] = [float(each) for each in channel.deviation]
    if channel.calibration is not None and channel.exact is None:
        known = channel.calibration
        found["calibration"] = [known.a, known.b, known.d]
    x = channel.stored if channel.exact is None else channel.exact
    found["dtype"] = str(x.dtype)
    spans = spans_of(channel, first, last)
    return found if spans is None else found | {"spans": spans}


def _shown(text: str) -> str:
    """A text that UTF-8 can hold."""
    return text.encode("utf-8", "replace").decode("utf-8")


def _events(recording: Recording) -> dict[str, Any]:
    def cells(texts: list[str]) -> NDArray[Any]:
        found = np.empty((len(texts), 1), object)
        found[:, 0] = [_shown(text) for text in texts]
        return found

    return {
        "time": np.array([float(event.time) for event in recording.events]),
        "duration": np.array([float(event.duration) for event in recording.events]),
        "text": cells([event.text for event in recording.events]),
        "layer": cells([event.layer for event in recording.events]),
    }


def _header(recording: Recording) -> dict[str, Any]:
    labels = recording.labels

    def place(item: Any) -> int:
        found = index_of_channel(item, labels)
        return -1 if found is None else found

    return {
        "format": FORMAT,
        "version": 1,
        "epoch_ns": recording.epoch_ns,
        "epoch_uncertainty_ns": recording.epoch_uncertainty_ns,
        "events": [
            [str(event.time), str(event.duration), event.text, place(event), event.layer]
            for event in recording.events
        ],
        "clocks": [
            [one.clock, _place(one), one.tick, one.time_ns, one.uncertainty_ns]
            for one in recording.clocks
        ],
        "clock_maps": [[one.clock, _place(one), one.points] for one in recording.clock_maps],
        "attachments": [[name, kind] for name, (kind, _) in recording.attachments.items()],
        "metadata": recording.metadata,
    }


def _place(one: ClockObservation | ClockMap) -> int:
    return -1 if one.channel is None else cast(int, one.channel)


def is_ours(tree: SourceTree) -> bool:
    text = tree.groups.get((), {}).get("hapfmt")
    return isinstance(text, str) and text.startswith(f'{{"format": "{FORMAT}"')


def read_ours(tree: SourceTree, options: ReadOptions) -> Import:
    """A recording that :func:`write_ours` wrote."""
    for name in ("transpose", "clock", "episode", "keep_stamps"):
        if getattr(options, name) != getattr(ReadOptions(), name):
            raise ParameterError(f"{name} is not for a recording that hapfmt wrote")
    with refusing("this MAT file cannot be read", RecursionError, AttributeError):
        return _read(tree, options)


def _read(tree: SourceTree, options: ReadOptions) -> Import:
    about = json.loads(tree.groups[()]["hapfmt"])
    if about["version"] != 1:
        raise ParameterError(f"version {about['version']!r} of this layout is not known, only 1")
    arrays = {array.path: array for array in tree.arrays}
    room = options.max_memory
    found = []
    for place, described in enumerate(about["channels"]):
        table = about["tables"][integer_of(described, "table", 0, CHANNEL_LIMIT)]
        rows = integer_of(table, "rows", 0, TICK_LIMIT)
        start = integer_of(table, "start_tick", 0, TICK_LIMIT - rows)
        path = (str(table["name"]), str(described["field"]))
        dtype = np.dtype(str(described["dtype"]))
        if dtype.kind not in "iuf" or dtype.itemsize > 8:
            raise ParameterError(f"channel {place} holds {dtype} values")
        spans = _spans(described, rows, place)
        room -= 8 * (rows if spans is not None else 0)
        if room < 0:
            raise LimitError("the gaps take more than allowed; allow more (max_memory=)")
        if "calibration" in described and not all(
            type(each) is int for each in described["calibration"]
        ):
            raise ParameterError(f"the calibration of channel {place} is not of integers")
        found.append(
            Stored(
                path[0],
                rows,
                _values(tree, arrays, path, rows, dtype),
                place,
                column_of(described, dtype),
                rate_from(str(table["rate"])),
                start,
                spans,
            )
        )
    whole, places = import_of_stored(found, options)
    count = len(found)
    whole = replace(
        whole,
        epoch_ns=about["epoch_ns"],
        epoch_uncertainty_ns=about["epoch_uncertainty_ns"],
        metadata=dict(about["metadata"]),
        attachments=_attachments(tree, arrays, about["attachments"], options.max_memory),
        notes=(*whole.notes, *tree.notes),
    )
    return of_channels(
        whole,
        places,
        [
            Event(seconds_of(time), text, seconds_of(duration), reference_of(at, count), layer)
            for time, duration, text, at, layer in about["events"]
        ],
        [
            ClockObservation(clock, reference_of(at, count), *rest)
            for clock, at, *rest in about["clocks"]
        ],
        [
            ClockMap(clock, reference_of(at, count), tuple(map(tuple, points)))
            for clock, at, points in about["clock_maps"]
        ],
    )


def _spans(described: Mapping[str, Any], rows: int, place: int) -> Spans | None:
    if "spans" not in described:
        return None
    spans = np.array(described["spans"], np.int64).reshape(-1, 2)
    checked_spans(spans, rows, f"channel {place}")
    return tuple((a, b) for a, b in spans.tolist())


def _values(
    tree: SourceTree,
    arrays: Mapping[tuple[str, ...], SourceArray],
    path: tuple[str, ...],
    rows: int,
    dtype: np.dtype[Any],
) -> Callable[[int, int, int], NDArray[Any]]:
    """The function that reads the rows of a channel, [rows, 1]."""
    stored = np.dtype(np.float32) if dtype == np.float16 else dtype
    shown = "/" + "/".join(path)
    if rows < 2:
        # An array of one number is in the tree as a number, one of none is not there.
        known = tree.groups.get(path[:-1], {})
        if rows and not isinstance(known.get(path[-1]), (int, float)):
            raise ParameterError(f"{shown} is missing")
        few = np.array([known[path[-1]]] if rows else [], stored)
        return lambda _, first, last: few[first:last].astype(dtype)
    array = arrays.get(path)
    if array is None or array.shape != (rows, 1) or array.dtype != stored:
        raise ParameterError(f"{shown} is missing, or does not hold {rows} {stored} values")
    return array.read


def _attachments(
    tree: SourceTree,
    arrays: Mapping[tuple[str, ...], SourceArray],
    named: list[Any],
    max_memory: int,
) -> dict[str, tuple[str, bytes]]:
    found = {}
    for number, (name, kind) in enumerate(named, 1):
        path = ("attachments", f"a{number}")
        array, one = arrays.get(path), tree.groups.get(path[:1], {}).get(path[1])
        if array is None:
            content = b"" if one is None else bytes([one])
        else:
            max_memory -= array.size
            if max_memory < 0 or array.dtype != np.uint8:
                raise LimitError("the attachments take more than allowed (max_memory=)")
            content = array.line().tobytes()
        found[str(name)] = (str(kind), content)
    return found
