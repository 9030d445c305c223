"""Our own layout of HDF5: a group for each rate, in it a data set for each channel.

==========================  =====================================================================
``/``                       attributes ``format``, ``version``, ``epoch_ns``,
                            ``epoch_uncertainty_ns``
``/rate_1000Hz``            attributes ``rate`` (text "num/den", exact), ``rate_hz``,
                            ``start_tick``: row i is at (start_tick + i) / rate seconds
``/rate_1000Hz/time``       [rows] the same times in seconds, rounded: the dimension scale of the
                            channels, for other programs
``/rate_1000Hz/fx``         [rows] values; NaN is a gap. Integers are counts with the attribute
                            ``calibration`` [a, b, d]: value = (count * a + b) / d, also as
                            ``scale_factor`` and ``add_offset``. Attributes ``label``, ``units``
                            (UCUM), ``index`` (place in the recording), ``quantity``, ``axis``,
                            ``group``, ``body_site``, ``device``, ``lsb``, ``deviation``
``/spans/0``                [spans, 2] first row and end of each measured part, for the integer
                            channel whose attribute ``spans`` names it; other rows are 0
``/events``                 a column each: ``time_s``, ``duration_s``, ``time`` and ``duration``
                            (exact text), ``text``, ``channel`` (index, -1: all), ``layer``
``/clocks``                 a column each: ``clock``, ``channel``, ``tick``, ``time_ns``,
                            ``uncertainty_ns``
``/clock_maps/0``           [points, 2] tick and time_ns; attributes ``clock``, ``channel``
``/attachments/0``          bytes; attributes ``name``, ``media_type``
``/metadata``               JSON
==========================  =====================================================================
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockMap, ClockObservation
from ..errors import LimitError, ParameterError
from ..limits import TICK_LIMIT
from ..numbers import checked_rate
from ..recording import (
    CHANNEL_LIMIT,
    Channel,
    Event,
    Recording,
    extent,
    index_of_channel,
    unique,
)
from .common import not_carried, rate_from
from .formats import Destination, ReadOptions, WriteOptions
from .hdf5_files import Texts, Walk, h5py_of, reader, refusal_of, refusing_hdf5, texts_of
from .stored import (
    CARRIED,
    CHUNK_ROWS,
    DESCRIBED,
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
TIME = "time"
MOST_SCALED = 1000
"""Channels that name their dimension scale; it lists them in an attribute, of at most 64 KiB."""
MOST_SPANS = 1 << 22
MOST_ROWS = 1 << 20
"""Rows of the columns of events and clocks."""


def is_ours(file: Any, texts: Texts) -> bool:
    if "format" not in file.attrs:
        return False
    low = file.attrs.get_id("format")
    h5py = h5py_of()
    is_text = h5py.check_string_dtype(low.dtype) is not None and texts.fit(1)
    return is_text and low.shape == () and texts_of(file.attrs["format"]) == FORMAT


def write_ours(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """All of it; returns notes on what is not kept."""
    by_rate: dict[Fraction, list[int]] = {}
    for place, channel in enumerate(recording.channels):
        by_rate.setdefault(checked_rate(channel.rate_exact), []).append(place)
    check_gaps(recording, by_rate, ".h5", options.max_memory)
    stream = target.stream
    is_plain = stream.seekable() and stream.readable() and stream.tell() == 0
    with tempfile.TemporaryFile() as spare:
        out = stream if is_plain else cast(BinaryIO, spare)
        with (
            refusing_hdf5("this cannot be written as HDF5"),
            h5py_of().File(out, "w", libver=("earliest", "v110")) as file,
        ):
            _write(file, recording, by_rate, options)
        if not is_plain:
            spare.seek(0)
            while block := spare.read(1 << 20):
                stream.write(block)
    return [
        *not_carried(recording, ".h5", *CARRIED, *recording.metadata),
        *exact_note(recording),
    ]


def _write(
    file: Any,
    recording: Recording,
    by_rate: Mapping[Fraction, list[int]],
    options: WriteOptions,
) -> None:
    file.attrs["format"] = FORMAT
    file.attrs["version"] = 1
    if recording.epoch_ns is not None:
        file.attrs["epoch_ns"] = np.int64(recording.epoch_ns)
        file.attrs["epoch_uncertainty_ns"] = np.uint64(recording.epoch_uncertainty_ns)
    names = unique([f"rate_{float(rate):.6g}Hz" for rate in by_rate], [])
    total, done = recording.sample_count, 0
    for name, (rate, places) in zip(names, by_rate.items(), strict=True):
        channels = [recording.channels[place] for place in places]
        first, last = extent(channels)
        group = file.create_group(name)
        group.attrs["rate"] = str(rate)
        group.attrs["rate_hz"] = float(rate)
        group.attrs["start_tick"] = np.int64(first)
        time = _write_times(group, rate, first, last)
        own = [_member(c.label, place) for c, place in zip(channels, places, strict=True)]
        members = unique([TIME, *own], [])[1:]
        for member, place, channel in zip(members, places, channels, strict=True):
            for rows in _write_channel(file, group, member, place, channel, first, last):
                done += rows
                if options.progress:
                    options.progress(done, total)
            if len(channels) <= MOST_SCALED:
                group[member].dims[0].attach_scale(time)
    _write_rest(file, recording)


def _write_times(group: Any, rate: Fraction, first: int, last: int) -> Any:
    """The times of the rows, as a dimension scale. Compressed they take .1 bytes a row."""
    data = _rows(group, TIME, last - first, np.dtype(np.float64))
    for start in range(first, last, 16 * CHUNK_ROWS):
        stop = min(start + 16 * CHUNK_ROWS, last)
        data[start - first : stop - first] = times_of(rate, start, stop)
    data.attrs["units"] = "s"
    data.make_scale(TIME)
    return data


def _rows(group: Any, name: str, rows: int, dtype: np.dtype[Any]) -> Any:
    return group.create_dataset(
        name,
        shape=(rows,),
        dtype=dtype,
        chunks=(max(min(CHUNK_ROWS, rows), 1),),
        maxshape=(None,),
        compression="gzip",
        shuffle=True,
        fillvalue=np.nan if dtype.kind == "f" else 0,
        track_times=False,
    )


def _member(label: str, place: int) -> str:
    """The name of a data set; its attribute ``label`` is the label."""
    name = re.sub(r"[/\0]", "|", label)
    return name if name.strip(". ") else f"ch{place + 1}"


def _write_channel(
    file: Any, group: Any, member: str, place: int, channel: Channel, first: int, last: int
) -> Iterator[int]:
    x: NDArray[Any] = channel.stored if channel.exact is None else channel.exact
    data = _rows(group, member, last - first, x.dtype)
    at = 0
    for span in channel.coverage:
        for start in range(span.start, span.stop, 16 * CHUNK_ROWS):
            stop = min(start + 16 * CHUNK_ROWS, span.stop)
            data[start - first : stop - first] = x[at : at + stop - start]
            at += stop - start
            yield stop - start
    data.attrs["label"] = channel.label
    data.attrs["units"] = channel.unit
    data.attrs["index"] = place
    for name in DESCRIBED:
        if getattr(channel, name):
            data.attrs[name] = getattr(channel, name)
    if channel.lsb is not None:
        data.attrs["lsb"] = float(channel.lsb)
    if channel.deviation is not None:
        data.attrs["deviation"] = np.array(channel.deviation, np.float64)
    if channel.calibration is not None and channel.exact is None:
        found = channel.calibration
        data.attrs["calibration"] = np.array([found.a, found.b, found.d], np.int64)
        data.attrs["scale_factor"] = found.a / found.d
        data.attrs["add_offset"] = found.b / found.d
    spans = spans_of(channel, first, last)
    if spans is not None:
        rows = np.array(spans, np.int64).reshape(-1, 2)
        file.require_group("spans").create_dataset(str(place), data=rows, **_packed(rows))
        data.attrs["spans"] = f"/spans/{place}"


def _packed(rows: NDArray[Any]) -> dict[str, Any]:
    """Small arrays are not compressed."""
    kept = {"track_times": False}
    return kept if rows.nbytes < 4096 else {**kept, "compression": "gzip", "shuffle": True}


def _write_rest(file: Any, recording: Recording) -> None:
    labels = recording.labels
    if recording.events:
        _write_columns(
            file.create_group("events"),
            {
                "time_s": [float(event.time) for event in recording.events],
                "duration_s": [float(event.duration) for event in recording.events],
                "time": [str(event.time) for event in recording.events],
                "duration": [str(event.duration) for event in recording.events],
                "text": [event.text for event in recording.events],
                "channel": _numbers([index_of_channel(e, labels) for e in recording.events]),
                "layer": [event.layer for event in recording.events],
            },
        )
    if recording.clocks:
        _write_columns(
            file.create_group("clocks"),
            {
                "clock": [one.clock for one in recording.clocks],
                "channel": _numbers([cast("int | None", c.channel) for c in recording.clocks]),
                "tick": np.array([one.tick for one in recording.clocks], np.int64),
                "time_ns": np.array([one.time_ns for one in recording.clocks], np.int64),
                "uncertainty_ns": np.array(
                    [one.uncertainty_ns for one in recording.clocks], np.int64
                ),
            },
        )
    for number, one in enumerate(recording.clock_maps):
        points = np.array(one.points, np.int64)
        data = file.require_group("clock_maps").create_dataset(
            str(number), data=points, **_packed(points)
        )
        data.attrs["clock"] = one.clock
        data.attrs["channel"] = _numbers([cast("int | None", one.channel)])[0]
    for number, (name, (kind, content)) in enumerate(recording.attachments.items()):
        content_array = np.frombuffer(content, np.uint8)
        data = file.require_group("attachments").create_dataset(
            str(number), data=content_array, track_times=False
        )
        data.attrs["name"] = name
        data.attrs["media_type"] = kind
    if recording.metadata:
        file.create_dataset("metadata", data=json.dumps(recording.metadata), track_times=False)


def _numbers(channels: Sequence[int | None]) -> NDArray[np.int64]:
    return np.array([-1 if channel is None else channel for channel in channels], np.int64)


def _write_columns(group: Any, columns: Mapping[str, Any]) -> None:
    for name, values in columns.items():
        kept = {"track_times": False}
        if isinstance(values, list) and isinstance(values[0], str):
            text = h5py_of().string_dtype()
            group.create_dataset(name, data=np.array(values, object), dtype=text, **kept)
        else:
            group.create_dataset(name, data=np.asarray(values), **kept)


def read_ours(file: Any, texts: Texts, options: ReadOptions) -> Import:
    """A recording that :func:`write_ours` wrote."""
    for name in ("transpose", "clock", "episode", "keep_stamps"):
        if getattr(options, name) not in (None, False):
            raise ParameterError(f"{name} is not for a recording that hapfmt wrote")
    walk = Walk(texts)
    about = walk.attributes(file, ())
    if about.get("version") != 1:
        raise ParameterError(
            f"version {about.get('version')!r} of this layout is not known, only 1"
        )
    notes = walk.tree.notes
    found: list[Stored] = []
    budget = [options.max_memory]
    for name in file:
        if name.startswith("rate_"):
            found += _stored(file, walk, name, budget)
    whole, places = import_of_stored(found, options)
    whole = replace(
        whole,
        epoch_ns=about.get("epoch_ns"),
        epoch_uncertainty_ns=about.get("epoch_uncertainty_ns", 0),
        metadata=_metadata(file, walk),
        attachments=_attachments(file, walk, budget),
        notes=(*whole.notes, *notes),
    )
    return of_channels(
        whole,
        places,
        _events(file, walk, len(found), budget),
        _clocks(file, walk, len(found), budget),
        _clock_maps(file, walk, len(found), budget),
    )


def _stored(file: Any, walk: Walk, name: str, budget: list[int]) -> Iterator[Stored]:
    h5py = h5py_of()
    group = _held(file, name, h5py.Group)
    about = walk.attributes(group, (name,))
    rate = rate_from(str(about["rate"]))
    start = integer_of(about, "start_tick", 0, TICK_LIMIT)
    for member in group:
        if member == TIME:
            continue
        walk.count()
        data = _held(group, member, h5py.Dataset)
        shown = data.name
        if data.ndim != 1 or data.dtype.kind not in "biuf" or data.dtype.itemsize > 8:
            raise ParameterError(f"{shown} is not one row of numbers")
        if start + data.shape[0] > TICK_LIMIT:
            raise ParameterError(f"{shown} reaches beyond tick 2^48")
        described = walk.attributes(data, (name, member))
        spans = None
        if "spans" in described:
            spans = _spans(file, str(described["spans"]), data.shape[0], budget)
        sparse = spans is not None or data.dtype.kind == "f"
        reason = refusal_of(data, sparse=sparse)
        if reason is not None:
            raise ParameterError(f"{shown} cannot be read: {reason}")
        yield Stored(
            name,
            data.shape[0],
            reader(data),
            integer_of(described, "index", 0, CHANNEL_LIMIT),
            column_of(described, data.dtype.newbyteorder("=")),
            rate,
            start,
            spans,
        )


def _held(group: Any, name: str, kind: Any) -> Any:
    """A member that lies in the file itself."""
    h5py = h5py_of()
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ParameterError(f"{group.name}/{name} is a link, which this layout does not have")
    found = group[name]
    if not isinstance(found, kind):
        raise ParameterError(f"{group.name}/{name} is not a {kind.__name__.lower()}")
    return found


def _spans(file: Any, path: str, rows: int, budget: list[int]) -> tuple[tuple[int, int], ...]:
    match = re.fullmatch(r"/spans/([0-9]{1,5})", path)
    if match is None:
        raise ParameterError(f"{path[:100]!r} does not name spans")
    h5py = h5py_of()
    data = _held(_held(file, "spans", h5py.Group), match[1], h5py.Dataset)
    if data.shape[1:] != (2,) or data.ndim != 2 or data.shape[0] > MOST_SPANS:
        raise ParameterError(f"{path} is not a list of at most {MOST_SPANS} spans")
    found = _small(data, "iu", budget, 40)
    checked_spans(found, rows, path)
    _take(budget, 8 * int((found[:, 1] - found[:, 0]).sum()), path)
    return tuple((a, b) for a, b in found.tolist())


def _take(budget: list[int], size: int, what: str) -> None:
    """Count memory that is needed before the values are read."""
    budget[0] -= size
    if budget[0] < 0:
        raise LimitError(f"{what} takes {size} bytes, more than allowed; allow more (max_memory=)")


def _small(data: Any, kinds: str, budget: list[int], size: int = 0) -> NDArray[Any]:
    """A data set that is read whole; ``size``: bytes of a row where they are more."""
    if data.dtype.kind not in kinds or (reason := refusal_of(data)) is not None:
        raise ParameterError(
            f"{data.name} holds {data.dtype} values"
            if data.dtype.kind not in kinds
            else f"{data.name} cannot be read: {reason}"
        )
    rows = data.shape[0] if data.ndim else 1
    _take(budget, max(data.size * data.dtype.itemsize, rows * size), data.name)
    return np.asarray(data[()])


def _columns(
    file: Any, walk: Walk, name: str, kinds: Mapping[str, str], budget: list[int]
) -> Iterator[tuple[Any, ...]]:
    """The rows of a group of columns."""
    if name not in file:
        return
    h5py = h5py_of()
    group = _held(file, name, h5py.Group)
    columns = []
    rows = None
    for key, kind in kinds.items():
        data = _held(group, key, h5py.Dataset)
        if data.ndim != 1 or (rows is not None and data.shape[0] != rows):
            raise ParameterError(f"{data.name} does not have a value for each row")
        rows = data.shape[0]
        if rows > MOST_ROWS:
            raise LimitError(f"{data.name} has {rows} rows, more than {MOST_ROWS}")
        if kind == "text":
            columns.append(_texts(data, walk, budget))
        else:
            columns.append(_small(data, kind, budget, 64).tolist())
    yield from zip(*columns, strict=True)


def _texts(data: Any, walk: Walk, budget: list[int]) -> list[str]:
    """[rows] texts, in slices whose memory is known before."""
    if h5py_of().check_string_dtype(data.dtype) is None or refusal_of(data) is not None:
        raise ParameterError(f"{data.name} holds no texts")
    at_once = max((16 << 20) // max(walk.texts.longest, 1), 1)
    found: list[str] = []
    for first in range(0, data.shape[0], at_once):
        part = data[first : first + at_once].tolist()
        _take(budget, sum(64 + 2 * len(each) for each in part), data.name)
        found += [texts_of(each) for each in part]
    return found


def _events(file: Any, walk: Walk, count: int, budget: list[int]) -> list[Event]:
    kinds = {"time": "text", "duration": "text", "text": "text", "channel": "iu", "layer": "text"}
    found = []
    for time, duration, text, channel, layer in _columns(file, walk, "events", kinds, budget):
        found.append(
            Event(seconds_of(time), text, seconds_of(duration), reference_of(channel, count), layer)
        )
    return found


def _clocks(file: Any, walk: Walk, count: int, budget: list[int]) -> list[ClockObservation]:
    kinds = {
        "clock": "text",
        "channel": "iu",
        "tick": "iu",
        "time_ns": "iu",
        "uncertainty_ns": "iu",
    }
    return [
        ClockObservation(clock, reference_of(channel, count), *rest)
        for clock, channel, *rest in _columns(file, walk, "clocks", kinds, budget)
    ]


def _clock_maps(file: Any, walk: Walk, count: int, budget: list[int]) -> list[ClockMap]:
    maps: list[ClockMap] = []
    h5py = h5py_of()
    if "clock_maps" not in file:
        return maps
    group = _held(file, "clock_maps", h5py.Group)
    for name in sorted(group, key=lambda text: (len(text), text)):
        walk.count()
        data = _held(group, name, h5py.Dataset)
        about = walk.attributes(data, ("clock_maps", name))
        if data.ndim != 2 or data.shape[1] != 2 or data.shape[0] > MOST_ROWS:
            raise ParameterError(f"{data.name} does not hold points of a clock")
        points = _small(data, "iu", budget, 200).tolist()
        where = reference_of(integer_of(about, "channel", -1, count), count)
        maps.append(ClockMap(str(about["clock"]), where, tuple(map(tuple, points))))
    return maps


def _attachments(file: Any, walk: Walk, budget: list[int]) -> dict[str, tuple[str, bytes]]:
    found: dict[str, tuple[str, bytes]] = {}
    if "attachments" not in file:
        return found
    h5py = h5py_of()
    group = _held(file, "attachments", h5py.Group)
    for name in sorted(group, key=lambda text: (len(text), text)):
        walk.count()
        data = _held(group, name, h5py.Dataset)
        about = walk.attributes(data, ("attachments", name))
        content = _small(data, "u", budget) if data.size else np.empty(0, np.uint8)
        found[str(about["name"])] = (
            str(about["media_type"]), content.astype(np.uint8).tobytes()
        )  # fmt: skip
    return found


def _metadata(file: Any, walk: Walk) -> dict[str, Any]:
    if "metadata" not in file:
        return {}
    data = _held(file, "metadata", h5py_of().Dataset)
    if data.shape != () or h5py_of().check_string_dtype(data.dtype) is None:
        raise ParameterError("/metadata is not one text")
    if (reason := refusal_of(data)) is not None or walk.texts.longest < 0:
        raise ParameterError(f"/metadata cannot be read: {reason}")
    found = json.loads(texts_of(data[()]))
    if not isinstance(found, dict):
        raise ParameterError("/metadata is not a JSON object")
    return found
