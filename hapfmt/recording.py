"""Recording, Channel and Event: the data in memory, and their conversion from and to arrays.

A channel holds integer counts with a calibration, or floating-point values. It keeps the measured
samples and the spans of ticks that they cover. Ticks outside every span are a gap. A gap takes no
memory and becomes NaN only in :meth:`Channel.filled`. A Recording converts from and to arrays,
tables and data frames. An event is a marker or annotation, with times in seconds.
"""

from __future__ import annotations

import json
import os
import uuid as _uuid
import warnings
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from itertools import accumulate, chain
from operator import index
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, overload

import numpy as np
from numpy.typing import NDArray

from .clocks import ClockMap, ClockObservation, by_clock, check_steps, on_channels
from .errors import (
    DataWarning,
    LimitError,
    MissingExtraError,
    MovedTimesWarning,
    ParameterError,
    UnknownChannelError,
    matching,
    refuse_keywords,
    unknown,
)
from .limits import AFFINE_LIMIT, EXACT_LIMIT, LAST_TRACK_ID, TICK_LIMIT
from .numbers import counted, exact, hertz, tick_range
from .numbers import exact as to_fraction
from .units import given_units, split_name


@dataclass(frozen=True, repr=False)
class Event:
    """A text at ``time``, in seconds from the zero of the recording, valid for ``duration``.

    A float stands for its shortest decimal. A file keeps times exactly if their common
    denominator is below 2^32, else to the microsecond.

    channel
        label or number of a channel; None: the event concerns all channels. An event from a file
        has a number.
    layer
        name of the group of events that this event belongs to.
    """

    time: Fraction
    text: str = ""
    duration: Fraction = Fraction(0)
    channel: int | str | None = None
    layer: str = ""

    def __post_init__(self) -> None:
        for name in ("time", "duration"):
            seconds = exact(getattr(self, name))
            if seconds < 0:
                raise ParameterError(f"the {name} of an event must not be negative")
            object.__setattr__(self, name, seconds)
        if not (isinstance(self.text, str) and isinstance(self.layer, str)):
            raise ParameterError("the text and the layer of an event must be strings")
        if self.channel is not None and not isinstance(self.channel, (int, str)):
            raise ParameterError("the channel of an event must be a number, a label or None")

    def __repr__(self) -> str:
        """One line: seconds, text, and the other members that are set."""
        parts = [f"Event {float(self.time):.9g} s {_short(self.text, 80)!r}"]
        parts += [f"{float(self.duration):.9g} s long"] if self.duration else []
        parts += [f"channel {self.channel!r}"] if self.channel is not None else []
        parts += [f"layer {_short(self.layer)!r}"] if self.layer else []
        return ", ".join(parts)


def in_order(events: Iterable[Event]) -> list[Event]:
    """By time; those of one time as they come."""
    return sorted(events, key=lambda event: event.time)


def by_layer(events: Iterable[Event]) -> dict[str, list[Event]]:
    """In order of time, the layers as they come first."""
    found: dict[str, list[Event]] = {}
    for event in events:
        found.setdefault(event.layer, []).append(event)
    return {layer: in_order(own) for layer, own in found.items()}


def index_of_channel(event: Event, labels: Sequence[str]) -> int | None:
    """The number of the channel that an event refers to."""
    return None if event.channel is None else place_of_reference(event.channel, labels, "an event")


_DROPS = "rec.sel([...]) drops events and clocks with their channels"


def place_of_reference(channel: int | str, labels: Sequence[str], what: str) -> int:
    """The number of a channel that an event or a clock refers to."""
    if isinstance(channel, str):
        if channel not in labels:
            raise ParameterError(
                f"{what} names channel {channel!r}, which does not exist; {_DROPS}"
            )
        return labels.index(channel)
    if not 0 <= channel < len(labels):
        raise ParameterError(f"{what} names channel {channel} of {len(labels)}; {_DROPS}")
    return channel


Units = str | Sequence[str] | Mapping[str, str]

CHANNEL_LIMIT = LAST_TRACK_ID // 2
"""Channels of a recording that is encoded: up to two tracks each."""


def recording_of(
    data: Any,
    rate: Rates | None = None,
    *,
    labels: str | Sequence[str] | None = None,
    units: Units | None = None,
    transpose: bool | None = None,
) -> Recording:
    """A recording of whatever people have: a Recording, Channels, an array, a DataFrame, or
    {label: 1-D array}. The arguments are those of :func:`hapfmt.write`."""
    if isinstance(data, (str, os.PathLike)):
        name = os.fspath(data)
        raise ParameterError(f"{name!r} names a file; the recording comes first, then the file")
    if isinstance(data, Recording) or _are_channels(data):
        given = {"rate": rate, "labels": labels, "units": units, "transpose": transpose}
        if named := [name for name, value in given.items() if value is not None]:
            raise ParameterError(f"{named[0]} is for arrays; channels have their own")
        if isinstance(data, Recording):
            return data
        return Recording((data,) if isinstance(data, Channel) else tuple(data))
    if isinstance(rate, (list, tuple, np.ndarray)) or (
        isinstance(rate, Mapping) and (_frame_of(data) is not None or not isinstance(data, Mapping))
    ):
        raise ParameterError(
            "rate is one number here; for several rates give {label: array} with "
            "rate={label: samples per second}, or a list of hapfmt.Channel.from_physical(x, rate)"
        )
    if _is_pandas(data, "Dataset", "xarray") and len(data.dims) > 1:
        if not all(value is None for value in (rate, labels, units, transpose)):
            raise ParameterError("a dataset of several rates holds rates, labels and units itself")
        return _recording_of_dataset(data)
    frame = _frame_of(data)
    if frame is not None:
        if transpose is not None:
            raise ParameterError("transpose is for arrays; a table has a column for each channel")
        assert not isinstance(rate, Mapping)
        return _recording_of_frame(frame, rate, labels, units)
    if isinstance(data, Mapping):
        if transpose is not None:
            raise ParameterError("transpose is for arrays; a dict has an array for each channel")
        keys = [str(name) for name in data]
        rows = [_row(value, str(name)) for name, value in data.items()]
        labels, units = _described(keys, labels, units)
    else:
        keys = []
        rows = rows_of(data, labels, transpose)
    if rate is None:
        raise ParameterError("an array has no rate; give one, such as rate=1000")
    names = _for_each(labels, "labels", len(rows)) or [f"ch{i + 1}" for i in range(len(rows))]
    rates = _rates(rate, names, keys)
    sizes = [len(row) for row in rows]
    if not isinstance(rate, Mapping) and len(set(sizes)) > 1:
        pairs = [*zip(names, sizes, strict=True)][:_SHOWN_CHANNELS]
        listed = ", ".join(f"{name}: {size}" for name, size in pairs)
        warnings.warn(
            f"the arrays have different lengths ({listed}) and one rate, {rate} Hz; "
            "rate={label: samples per second} gives each its own",
            DataWarning,
            stacklevel=3,
        )
    codes = given_units(_units(units, names), stacklevel=3)
    return Recording(
        tuple(
            channel_of(row, own, label=name, unit=code)
            for row, own, name, code in zip(rows, rates, names, codes, strict=True)
        )
    )


def _rates(rate: Rates, labels: Sequence[str], keys: Sequence[str]) -> list[Rate]:
    """The rate of each array; a dict names it by label, or by the key of its array."""
    if not isinstance(rate, Mapping):
        return [rate] * len(labels)
    for name in rate:
        if name not in labels and name not in keys:
            raise UnknownChannelError(unknown("channel", name, labels))
    found = []
    for label, key in zip(labels, keys, strict=True):
        if label not in rate and key not in rate:
            raise ParameterError(f"rate has no entry for channel {label!r}")
        found.append(rate[label] if label in rate else rate[key])
    return found


def _recording_of_dataset(data: Any) -> Recording:
    """An xarray.Dataset with a time coordinate for each rate, as ``to_xarray`` makes it."""
    if any(one.ndim != 1 for one in data.values()):
        raise ParameterError("each variable of the xarray object needs one dimension, its time")
    names = list(data)
    by_time: dict[str, list[str]] = {}
    for name in names:
        by_time.setdefault(data[name].dims[0], []).append(name)
    parts = [
        _recording_of_frame(_frame_of(data[own]), None, None, None) for own in by_time.values()
    ]
    if len({part.epoch_ns for part in parts}) > 1:
        raise ParameterError("the times of the xarray object begin before second 0")
    order = [name for own in by_time.values() for name in own]
    channels = [channel for part in parts for channel in part]
    placed = dict(zip(order, channels, strict=True))
    return replace(parts[0], channels=tuple(placed[name] for name in names))


def _metadata_of(text: Any) -> dict[str, Any]:
    """The metadata that ``to_xarray`` wrote as JSON."""
    try:
        found = json.loads(text) if isinstance(text, str) else {}
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _recording_of_frame(
    frame: Any,
    rate: Rate | None,
    labels: str | Sequence[str] | None,
    units: Units | None,
) -> Recording:
    """A pandas.DataFrame: a channel for each column, the rows placed by the times of the index."""
    from .times import time_name

    columns = [str(name) for name in frame.columns]
    known = frame.attrs.get("units") if units is None else None
    if isinstance(known, Mapping):
        known = {str(column): unit for column, unit in known.items()}
        known = [known.get(column, "1") for column in columns]
    names, codes = _described(columns, labels, units if known is None else known)
    named = [column for column in columns if time_name(column) is not None]
    rate, ticks, epoch_ns, notes = _grid_of_index(
        frame.index, rate, frame.attrs.get("epoch_ns"), named[:1]
    )
    for note in notes:
        warnings.warn(note, MovedTimesWarning, stacklevel=4)
    codes = given_units(codes, stacklevel=4)
    dated = getattr(frame.index.dtype, "kind", "") == "M"
    zone = str(frame.index.tz or NO_ZONE) if dated else None
    return Recording(
        tuple(
            channel_of(
                _row(_column(frame, place), name), rate,
                ticks=ticks, label=name, unit=code,
            )
            for place, (name, code) in enumerate(zip(names, codes, strict=True))
        ),
        epoch_ns=epoch_ns,
        metadata=_metadata_of(frame.attrs.get("metadata"))
        | ({"notes": [*notes]} if notes else {})
        | ({} if zone is None else {TIME_ZONE: zone}),
    )  # fmt: skip


def _column(frame: Any, place: int) -> NDArray[Any]:
    """The numbers of a column of a DataFrame."""
    column, name = frame.iloc[:, place], frame.columns[place]
    is_text = any(isinstance(cell, str) for cell in column.dropna().head())
    if is_text or getattr(column.dtype, "kind", "O") in "mM":
        what = "texts" if is_text else "times"
        raise ParameterError(
            f"column {name!r} of the DataFrame holds {what}, and channels hold numbers; leave it "
            f"out with .drop(columns={name!r}), or write the table with .to_parquet() and encode "
            "that file"
        )
    array: NDArray[Any] = column.to_numpy()
    return array


def channel_of(
    x: Any, rate: Rate, *, ticks: NDArray[np.int64] | None = None, **described: Any
) -> Channel:
    """A channel of a 1-D array: integers of up to 32 bits become counts; NaN and masked values are
    gaps. ``ticks`` are the ticks of the values, by default 0, 1, 2 ..."""
    if ticks is None and type(x) is np.ndarray and x.dtype.kind in "biu":
        kept, spans = np.ascontiguousarray(x), (Span(0, x.size),) * bool(x.size)
    else:
        x, known = known_samples(np.ma.getdata(x), np.ma.getmaskarray(x))
        spans = tuple(spans_of(known)) if ticks is None else spans_at(ticks[known])
        kept = np.ascontiguousarray(x[known])
    if (kept.dtype.kind in "bi" and kept.dtype.itemsize <= 4) or kept.dtype in ("u1", "u2"):
        counts = kept.astype(np.int32)
        return Channel(counts, rate, spans, Calibration(), **described)
    wide = {"u": np.uint64, "i": np.int64}.get(kept.dtype.kind)
    return Channel(kept if wide is None else kept.astype(wide), rate, spans, **described)


def rows_of(
    x: Any, labels: str | Sequence[str] | None, transpose: bool | None
) -> list[NDArray[Any]]:
    """The channels of an array [samples] or [channels, samples]."""
    array = _numbers(x, "the array")
    if array.ndim == 1:
        refuse_transpose(transpose)
        return [array]
    if array.ndim != 2:
        raise ParameterError(
            f"an array of {array.ndim} dimensions; give [samples] or [channels, samples]"
        )
    count = None if labels is None or isinstance(labels, str) else len(labels)
    array = upright(array, count, transpose, "the array", "pass array.T, or transpose=True")
    return list(array)


def refuse_transpose(transpose: bool | None) -> None:
    if transpose:
        raise ParameterError("an array of one dimension has nothing to transpose")


def upright(x: Any, labelled: int | None, transpose: bool | None, what: str, advice: str) -> Any:
    """[channels, samples], transposed where that was asked for.

    More channels than samples are a likely mistake. They need labels that agree, or
    ``transpose=False``.
    """
    if transpose is not None:
        return x.T if transpose else x
    rows, columns = x.shape
    if rows > columns > 0 and labelled != rows:
        raise ParameterError(
            f"{what} is {rows} x {columns}, read as {rows} channels of {columns} samples; if it is "
            f"{columns} channels, {advice}; if not, transpose=False"
        )
    return x


def _numbers(x: Any, what: str) -> NDArray[Any]:
    try:
        array: NDArray[Any] = np.asanyarray(x)
    except ValueError:
        raise ParameterError(
            f"{what} has rows of different lengths; give {{label: array}}, and for several rates "
            "rate={label: samples per second}"
        ) from None
    if array.dtype == object:
        raise ParameterError(
            f"{what} holds Python objects, not numbers; leave texts out, and convert numbers with "
            ".astype(float)"
        )
    if array.dtype.kind not in "biuf":
        raise ParameterError(f"{what} holds {array.dtype} values, not real numbers")
    if array.dtype.kind == "f" and array.dtype.itemsize > 8:
        raise ParameterError(f"{what} holds {array.dtype}; convert it to float64")
    return array.astype(array.dtype.newbyteorder("="), copy=False)


def _row(x: Any, label: str) -> NDArray[Any]:
    row = _numbers(x, f"channel {label!r}")
    if row.ndim != 1:
        raise ParameterError(f"channel {label!r} is not an array of one dimension")
    return row


def _for_each(
    texts: str | Sequence[str] | None, name: str, count: int, *, shared: bool = False
) -> list[str]:
    if texts is None:
        return []
    if isinstance(texts, str):
        texts = [texts] * count if shared else [texts]
    if isinstance(texts, np.ndarray):
        texts = texts.tolist()
    if not isinstance(texts, Sequence):
        raise ParameterError(
            f"{name} are a list of {count} texts in the order of the channels, "
            f"not a {type(texts).__name__}"
        )
    if len(texts) != count or not all(isinstance(text, str) for text in texts):
        raise ParameterError(f"{name} are {count} texts, one for each channel; got {len(texts)}")
    return list(texts)


def _described(
    names: Sequence[str], labels: str | Sequence[str] | None, units: Units | None
) -> tuple[list[str], list[str]]:
    """Labels and units of named columns; names such as "fx [N]" hold both."""
    given = list(names) if labels is None else _for_each(labels, "labels", len(names))
    if units:
        return given, _units(units, given)
    split = [split_name(name.strip()) for name in names]
    return (
        unique([label for label, _ in split], []) if labels is None else given,
        [code for _, code in split],
    )


def _units(units: Units | None, labels: Sequence[str]) -> list[str]:
    """The unit of each label: one for all, a list, or {label: unit}, where others have unit 1."""
    if isinstance(units, Mapping):
        for label, unit in units.items():
            if label not in labels:
                raise UnknownChannelError(unknown("channel", label, labels))
            if not isinstance(unit, str):
                raise ParameterError(f"the unit of channel {label!r} is not a text")
        return [units.get(label, "1") for label in labels]
    return _for_each(units, "units", len(labels), shared=True) or ["1"] * len(labels)


def _are_channels(data: Any) -> bool:
    if isinstance(data, Channel):
        return True
    return (
        isinstance(data, (list, tuple))
        and bool(data)
        and all(isinstance(one, Channel) for one in data)
    )


def _is_pandas(data: Any, name: str, package: str = "pandas") -> bool:
    """Without importing the package."""
    return any(
        kind.__name__ == name and kind.__module__.partition(".")[0] == package
        for kind in type(data).__mro__
    )


def _frame_of(data: Any) -> Any:
    """The pandas.DataFrame of a table of pandas or xarray; None for anything else."""
    if _is_pandas(data, "DataFrame"):
        return data
    if _is_pandas(data, "Series"):
        frame = data.to_frame("ch1" if data.name is None else data.name)
        frame.attrs = dict(data.attrs)
        return frame
    is_array = _is_pandas(data, "DataArray", "xarray")
    if not is_array and not _is_pandas(data, "Dataset", "xarray"):
        return None
    if len(data.dims) != 1:
        raise ParameterError(
            f"the xarray object has {len(data.dims)} dimensions; give one with the dimension time "
            "only, or array.to_pandas()"
        )
    if is_array:
        data = data.to_dataset(name="ch1" if data.name is None else data.name)
    data = data.reset_coords(drop=True)
    frame = data.to_dataframe()
    frame.attrs = {
        "units": {
            name: one.attrs.get("ucum", one.attrs.get("units"))
            for name, one in data.items()
            if {"ucum", "units"} & one.attrs.keys()
        },
        "epoch_ns": data.attrs.get("epoch_ns"),
        "metadata": data.attrs.get("metadata"),
    }
    return frame


def _grid_of_index(
    index: Any, rate: Rate | None, epoch_ns: int | None, time_columns: Sequence[str]
) -> tuple[Fraction, NDArray[np.int64], int | None, tuple[str, ...]]:
    """Rate, ticks of the rows, epoch, and notes, from an index in seconds, of durations or dates.

    Times are placed as those of a .csv file. An index named "t [ms]" holds milliseconds.
    """
    from .times import TimeStamps, time_name

    kind = getattr(index.dtype, "kind", "O")
    given = None if rate is None else hertz(rate)
    if kind not in "fmM":
        if given is None:
            advice = "".join(f", or use .set_index({column!r})" for column in time_columns)
            raise ParameterError(f"the index of the DataFrame holds no times; give a rate{advice}")
        rows = np.arange(len(index))
        if kind in "iu" and not np.array_equal(index.to_numpy(), rows):
            raise ParameterError(
                "the index of the DataFrame holds integers that do not count its rows; set an "
                "index of seconds as float, or use reset_index(drop=True)"
            )
        return given, rows, epoch_ns, ()
    if index.hasnans:
        raise ParameterError("the index of the DataFrame holds missing times")
    exponent = 0
    if kind == "f":
        named = time_name(str(index.name))
        exponent = 0 if named is None else named.exponent
        texts = map(repr, index.to_numpy().tolist())
    else:
        plain = index.tz_convert(None) if kind == "M" and index.tz is not None else index
        ns = plain.to_numpy().astype(f"{kind}8[ns]").astype(np.int64)
        if kind == "M":
            epoch_ns = int(ns[0]) if ns.size else None
            ns = ns - ns[:1]
        # The resolution of the clock, as the decimals of a text would tell it.
        zeros = next(digits for digits in (6, 3, 0) if not (ns % 10**digits).any())
        exponent = zeros - 9
        texts = map(str, (ns // 10**zeros).tolist())
    stamps = TimeStamps(exponent)
    for row, text in enumerate(texts):
        try:
            stamps.add(text)
        except ValueError as error:
            raise ParameterError(
                f"the index of the DataFrame: row {row} ({str(index[row])[:40]}) {error}"
            ) from None
    grid = stamps.grid(given)
    if grid.epoch_ns is not None:
        epoch_ns = grid.epoch_ns
    elif epoch_ns is not None and len(stamps) and stamps.first < 0:
        epoch_ns += round(stamps.first * 10**9)
    return grid.rate, grid.ticks, epoch_ns, grid.notes


TIME_ZONE = "time_zone"
"""Key of the metadata: the zone of the dates that were the index of a DataFrame."""
NO_ZONE = "none"
"""Stands for dates without a zone, which count as UTC."""


def _dates(seconds: NDArray[np.float64], epoch_ns: int, zone: object) -> Any:
    """The pandas.DatetimeIndex of the samples; UTC where the zone is not known here."""
    from datetime import UTC, datetime, tzinfo
    from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

    import pandas

    ns = np.rint(seconds * 1e9).astype(np.int64) + epoch_ns
    dates = pandas.DatetimeIndex(ns.astype("M8[ns]"), name="time")
    if zone == NO_ZONE:
        return dates
    known: tzinfo
    try:
        known = UTC if zone == "UTC" else ZoneInfo(str(zone))
    except (ValueError, OSError, ZoneInfoNotFoundError):
        try:
            known = datetime.strptime(str(zone), "UTC%z").tzinfo or UTC
        except ValueError:
            known = UTC
    return dates.tz_localize(UTC).tz_convert(known)


def to_pandas(recording: Recording) -> Any:
    try:
        import pandas
    except ImportError:
        raise MissingExtraError("pandas", "pandas") from None
    x = recording.to_numpy()
    zone = recording.metadata.get(TIME_ZONE)
    if zone is None or recording.epoch_ns is None:
        index = pandas.Index(recording.times(), name="time")
    else:
        index = _dates(recording.times(), recording.epoch_ns, zone)
    names = column_names(recording.labels)
    frame = pandas.DataFrame(x.T, index=index, columns=names)
    frame.attrs["units"] = {
        name: channel.unit for name, channel in zip(names, recording, strict=True)
    }
    if recording.epoch_ns is not None:
        frame.attrs["epoch_ns"] = recording.epoch_ns
    return frame


def to_xarray(recording: Recording) -> Any:
    try:
        import xarray  # noqa: F401
    except ImportError:
        raise MissingExtraError("xarray", "xarray") from None
    from .datasets import About, DatasetVariable, clock_maps, dataset_of, time_names

    by_rate: dict[Fraction, list[Channel]] = {}
    for channel in recording:
        by_rate.setdefault(channel.rate_exact, []).append(channel)
    extents = {rate: extent(channels) for rate, channels in by_rate.items()}
    left = GAPPY_TICKS
    for rate, (first, last) in extents.items():
        left -= (last - first) * len(by_rate[rate])
    if left < 0:
        raise LimitError(
            f"the channels with their gaps have more than {GAPPY_TICKS} values; take a part: "
            "rec.sel(start=..., stop=...), or xarray.open_dataset(file), which reads on demand"
        )
    names = variable_names(recording.labels, time_names(extents))
    signals = [
        DatasetVariable(name, number, channel, channel.filled(*extents[channel.rate_exact]))
        for number, (name, channel) in enumerate(zip(names, recording, strict=True))
    ]
    maps = clock_maps(recording.clocks, recording.clock_maps)
    about = About(
        recording.uuid, recording.epoch_ns, recording.epoch_uncertainty_ns, recording.metadata
    )
    return dataset_of(signals, extents, about, maps)


def to_arrow(recording: Recording) -> Any:
    try:
        import pyarrow as pa
    except ImportError:
        raise MissingExtraError("pyarrow", "arrow") from None
    first, last = recording._common_ticks(None, None)
    _check_ticks((last - first) * len(recording), GAPPY_TICKS)
    rate = recording.channels[0].rate_exact if recording.channels else Fraction(1)
    fields = [pa.field("time", pa.float64(), nullable=False, metadata={"unit": "s"})]
    arrays = [pa.array(seconds_of(first, last, rate))]
    for name, channel in zip(column_names(recording.labels), recording, strict=True):
        about = {"label": channel.label, "unit": channel.unit}
        for key in ("quantity", "axis", "group", "body_site", "device"):
            if text := getattr(channel, key):
                about[key] = text
        fields.append(pa.field(name, pa.float64(), metadata=about))
        missing = gap_mask(channel, first, last)
        arrays.append(pa.array(channel.filled(first, last), mask=missing))
    own: dict[str, Any] = {"version": 1, "rate": str(rate)}
    if recording.epoch_ns is not None:
        own["epoch_ns"] = recording.epoch_ns
    if recording.metadata:
        own["metadata"] = recording.metadata
    told = {"hapfmt": json.dumps(own, ensure_ascii=False), "rate_hz": str(float(rate))}
    return pa.table(arrays, schema=pa.schema(fields, metadata=told))


def column_names(labels: Sequence[str]) -> list[str]:
    """Names of the columns of channels, which differ from each other and from "time"."""
    return variable_names(labels, ["time"])


def gap_mask(channel: Channel, first: int, last: int) -> NDArray[np.bool_]:
    """bool [last - first]: where the channel has no sample."""
    missing = np.ones(last - first, np.bool_)
    for span in channel.coverage:
        missing[max(span.start - first, 0) : max(span.stop - first, 0)] = False
    return missing


def variable_names(labels: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Labels, each once and none of those ``taken``; a channel without one is called by its number:
    ch1, ch2 ..."""
    own = [label if label.strip() else f"ch{number}" for number, label in enumerate(labels, 1)]
    return unique([*taken, *own], [])[len(taken) :]


def unique(labels: Sequence[str], notes: list[str]) -> list[str]:
    """Labels of which none but "" is there twice: the second "x" becomes "x (2)", with a note."""
    taken = set(labels)
    count: dict[str, int] = {}
    found = []
    for label in labels:
        number = count.get(label, 0) + 1
        name = label if number == 1 or not label.strip() else f"{label} ({number})"
        while number > 1 and label.strip() and name in taken:
            number += 1
            name = f"{label} ({number})"
        count[label] = number
        taken.add(name)
        found.append(name)
    twice = [label for label, number in count.items() if number > 1 and label.strip()]
    if twice:
        new = f"{twice[0]} (2)"
        notes.append(f"several channels are called {twice[0]!r}; the second became {new!r}")
    return found


__all__ = ["CHANNEL_LIMIT", "channel_of", "recording_of", "to_pandas", "to_xarray", "unique"]


Rate = Fraction | float | str
Rates = Rate | Mapping[str, Rate]
"""One rate, or {label: rate}."""
Seconds = Fraction | float

NANOSECONDS = Fraction(10**9)
"""Ticks per second where an observation names no channel."""

EPOCH_LIMIT = 1 << 63
"""Nanoseconds: 292 years; HEAD has 64 bits."""

GAPPY_TICKS = 1 << 28
"""Values of one channel with its gaps, 2 GiB, unless the caller says otherwise."""

_OLD_NAMES = {
    "values": ("stored", "channel.counts or channel.stored"),
    "physical": ("samples", "channel.samples() or channel.to_numpy()"),
    "dense": ("filled", "channel.filled() or channel.to_numpy()"),
}
"""Old attributes of a channel: the one that does the same, and the advice."""

_SHOWN_CHANNELS = 6
_SHOWN_ROWS = 100
SHOWN_LINES = 20
"""Channels that a printed object names."""


class Span(NamedTuple):
    """Ticks start <= t < stop."""

    start: int
    stop: int

    @property
    def ticks(self) -> int:
        return self.stop - self.start


def spans_at(ticks: NDArray[np.int64]) -> tuple[Span, ...]:
    """Maximal runs in [n] increasing ticks, in memory proportional to n, not to the gaps."""
    if not ticks.size:
        return ()
    edges = np.flatnonzero(np.diff(ticks) != 1)
    starts = ticks[np.concatenate(([0], edges + 1))].tolist()
    stops = (ticks[np.concatenate((edges, [-1]))] + 1).tolist()
    return tuple(map(Span, starts, stops))


class Deviation(NamedTuple):
    """Declared and measured error of floating-point values on a grid, in the channel's unit."""

    declared: float
    largest: float


@dataclass(frozen=True)
class Calibration:
    """Converts counts to physical values: (count * a + b) / d, with d >= 1 and a != 0.

    ``exact()`` gives a Fraction. ``physical()`` gives float64, by one correctly rounded division.
    The result is the same on every machine, since ``|count * a + b|`` and d are at most 2**53.
    """

    a: int = 1
    b: int = 0
    d: int = 1

    def __post_init__(self) -> None:
        try:
            if not type(self.a) is type(self.b) is type(self.d) is int:
                for name in ("a", "b", "d"):
                    object.__setattr__(self, name, index(getattr(self, name)))
        except TypeError:
            raise ParameterError("a calibration holds three integers") from None
        if not (0 < abs(self.a) < AFFINE_LIMIT and abs(self.b) < AFFINE_LIMIT):
            raise ParameterError("calibration needs 0 < |A| < 2^52 and |B| < 2^52")
        if not 1 <= self.d < EXACT_LIMIT:
            raise ParameterError("calibration needs 1 <= D < 2^53")

    @property
    def step(self) -> Fraction:
        """Physical value of one count (the LSB); negative if larger counts are smaller values."""
        return Fraction(self.a, self.d)

    @property
    def zero(self) -> int:
        """The count nearest to the physical value 0; a half is rounded up."""
        a, b = (self.a, -self.b) if self.a > 0 else (-self.a, self.b)
        return (2 * b + a) // (2 * a)

    def exact(self, count: int) -> Fraction:
        """The physical value of a count, as a Fraction."""
        return Fraction(int(count) * self.a + self.b, self.d)

    def covers(self, low: int, high: int) -> bool:
        """True if ``|count * a|`` and ``|count * a + b|`` are at most 2**53 for every count in
        [low, high] (SPEC VAL-001)."""
        ends = (low * self.a, high * self.a)
        return max(max(abs(end), abs(end + self.b)) for end in ends) <= EXACT_LIMIT

    def physical(self, counts: NDArray[Any]) -> NDArray[np.float64]:
        """Convert counts (integers, any shape) to physical values (float64, same shape)."""
        if counts.size and not self.covers(int(counts.min()), int(counts.max())):
            raise ParameterError("a count leaves the exact range of its calibration")
        x = counts.astype(np.float64)
        if self.a != 1 or self.b:
            x *= self.a
            x += self.b  # and -0.0 becomes 0.0
        if self.d != 1:
            x /= self.d
        return x


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Channel:
    """One physical signal on a regular grid of ticks; tick 0 is the zero of the recording.

    ``Channel(x, 1000, label="fx", unit="N")`` is enough for most channels. Here a NaN is a
    sample that is kept bit for bit; :meth:`from_physical` turns NaN into gaps.

    stored
        [sample_count], the measured samples in order of time, without gaps. Signed integers if
        ``calibration`` is given (see ``counts``). Otherwise numbers in ``unit``: float64, float32,
        float16, int64 or uint64.
    rate
        samples per second, above 0: an int, a float, a Fraction or a text such as "44100/7".
        ``channel.rate`` is a float, ``channel.rate_exact`` the Fraction.
    coverage
        the spans of ticks that ``stored`` fills: sorted, disjoint, not empty, not adjacent.
        Together they have sample_count ticks. By default one span from tick 0.
    calibration
        converts counts to ``unit``; None for floating point.
    unit
        UCUM code ("N", "m/s2", "rad", "{count}", "1").
    exact
        float64 [sample_count] or None: the recorded doubles, bit for bit, where the counts alone
        do not give them.
    synthetic
        whether the texture comes from a model: it resembles the recorded one, and its samples are
        others. A codec of a file says so (``hapfmt encode --synthetic-texture``).
    """

    stored: NDArray[Any]
    rate_exact: Fraction
    coverage: tuple[Span, ...] = ()
    calibration: Calibration | None = None
    label: str = ""
    unit: str = "1"
    quantity: str = ""
    axis: str = ""
    group: str = ""
    body_site: str = ""
    device: str = ""
    deviation: Deviation | None = None
    lsb: float | None = None
    exact: NDArray[np.float64] | None = None
    synthetic: bool = False

    def __init__(
        self,
        stored: NDArray[Any] | None = None,
        rate: Rate | None = None,
        coverage: tuple[Span, ...] = (),
        calibration: Calibration | None = None,
        label: str = "",
        unit: str = "1",
        quantity: str = "",
        axis: str = "",
        group: str = "",
        body_site: str = "",
        device: str = "",
        deviation: Deviation | None = None,
        lsb: float | None = None,
        exact: NDArray[np.float64] | None = None,
        synthetic: bool = False,
        *,
        rate_exact: Rate | None = None,
        values: NDArray[Any] | None = None,
        **others: Any,
    ) -> None:
        refuse_keywords(others, Channel)
        if values is not None:  # dataclasses.replace gives ``stored`` too
            _deprecated("Channel(values=...)", "Channel(stored=...)")
            stored = values
        rate = rate_exact if rate is None else rate
        if stored is None or rate is None:
            raise ParameterError("a channel needs samples and a rate: Channel(x, 1000)")
        self.__dict__.update(
            stored=np.asarray(stored),
            rate_exact=rate if type(rate) is Fraction and rate.numerator > 0 else hertz(rate),
            coverage=coverage,
            calibration=calibration,
            label=label,
            unit=unit,
            quantity=quantity,
            axis=axis,
            group=group,
            body_site=body_site,
            device=device,
            deviation=deviation,
            lsb=lsb,
            exact=exact,
            synthetic=synthetic,
        )
        if self.stored.ndim != 1:
            raise ParameterError("a channel's values are one-dimensional")
        if self.calibration is not None and self.stored.dtype.kind not in "iu":
            raise ParameterError("a channel with a calibration holds integer counts")
        if self.exact is not None and (
            self.calibration is None
            or self.exact.dtype != np.float64
            or self.exact.shape != self.stored.shape
        ):
            raise ParameterError("exact values need one float64 for each count")
        if not self.coverage and self.stored.size:
            object.__setattr__(self, "coverage", (Span(0, self.stored.size),))
        previous = -1
        for span in self.coverage:
            if span.start <= previous or span.stop <= span.start:
                raise ParameterError("coverage spans are sorted, disjoint, not empty, not adjacent")
            previous = span.stop
        if previous > TICK_LIMIT or (self.coverage and self.coverage[0].start < 0):
            raise ParameterError("ticks lie in [0, 2^48)")
        if sum([stop - start for start, stop in self.coverage]) != self.stored.size:
            raise ParameterError("coverage and values differ in length")

    @classmethod
    def from_physical(
        cls, x: NDArray[Any], rate: Rate, *, start_tick: int = 0, **described: Any
    ) -> Channel:
        """A floating-point channel from values [ticks]; NaN becomes a gap, but where all are NaN.

        ``unit`` is any spelling, as in :func:`hapfmt.write`; the channel has its UCUM code.
        """
        if isinstance(described.get("unit"), str):
            described["unit"] = given_units([described["unit"]])[0]
        x = np.ascontiguousarray(x, dtype=np.float64)
        x, known = known_samples(x)
        return cls(
            stored=x[known],
            rate=rate,
            coverage=tuple(spans_of(known, start_tick)),
            **described,
        )

    @property
    def rate(self) -> float:
        """Samples per second, as a float; ``rate_exact`` is the Fraction."""
        return float(self.rate_exact)

    @property
    def counts(self) -> NDArray[Any]:
        """[sample_count] the stored integers, gaps left out.

        Raises ParameterError where the channel holds floating point.
        """
        if self.calibration is None:
            raise ParameterError(
                f"channel {self.label!r} holds {self.stored.dtype}, not counts; use samples()"
            )
        return self.stored

    @property
    def is_counts(self) -> bool:
        return self.calibration is not None

    @property
    def start_tick(self) -> int:
        return self.coverage[0].start if self.coverage else 0

    @property
    def stop_tick(self) -> int:
        return self.coverage[-1].stop if self.coverage else 0

    @property
    def gaps(self) -> tuple[Span, ...]:
        """Spans between the first and the last sample that nothing covers."""
        pairs = zip(self.coverage, self.coverage[1:], strict=False)
        return tuple(Span(a.stop, b.start) for a, b in pairs)

    @property
    def duration(self) -> Fraction:
        """Seconds from the zero of the recording to the end of the last sample."""
        return self.stop_tick / self.rate_exact

    def samples(self) -> NDArray[np.float64]:
        """float64 [sample_count]: the measured samples in ``unit``, without gaps."""
        if self.exact is not None:
            return self.exact.copy()
        if self.calibration is not None:
            return self.calibration.physical(self.stored)
        with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
            return self.stored.astype(np.float64)

    if not TYPE_CHECKING:  # else every misspelt attribute would pass

        def __getattr__(self, name: str) -> Any:
            """Old names, which neither dir() nor completion lists."""
            if name not in _OLD_NAMES:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            same, advice = _OLD_NAMES[name]
            _deprecated(f"channel.{name}", advice)
            return getattr(self, same)

    def ticks_between(self, start: Seconds | None, stop: Seconds | None) -> tuple[int, int]:
        """Ticks of the seconds [start, stop), within those from the first sample to the last."""
        first, last = tick_range(self.rate_exact, start, stop)
        first = max(first, self.start_tick)
        return first, max(min(last, self.stop_tick), first)

    def to_numpy(
        self,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        limit: int = GAPPY_TICKS,
    ) -> NDArray[np.float64]:
        """float64 [ticks]: values in ``unit`` from the first sample to the last, NaN in gaps.

        ``start`` and ``stop`` are seconds: the result covers start <= time < stop, with NaN where
        the channel has no samples. It has the length of :meth:`times` with the same arguments.
        Raises LimitError above ``limit`` values; :meth:`samples` leaves the gaps out.
        """
        first, last = self._window(start, stop)
        return self.filled(first, last, limit=limit)

    def times(
        self,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        limit: int = GAPPY_TICKS,
    ) -> NDArray[np.float64]:
        """float64 [ticks]: seconds from the zero of the recording, one for each value of
        :meth:`to_numpy` with the same arguments."""
        first, last = self._window(start, stop)
        _check_ticks(last - first, limit)
        return seconds_of(first, last, self.rate_exact)

    def _window(self, start: Seconds | None, stop: Seconds | None) -> tuple[int, int]:
        """The ticks of the seconds [start, stop); where one is None, the first or last sample."""
        first, last = tick_range(self.rate_exact, start, stop)
        first = self.start_tick if start is None else first
        return first, max(self.stop_tick if stop is None else last, first)

    def sel(self, start: Seconds | None = None, stop: Seconds | None = None) -> Channel:
        """The samples of the seconds start <= time < stop; they keep their times.

        Raises ParameterError where stop is not after start, or start is not before the end.
        """
        check_seconds(start, stop)
        if start is not None:
            refuse_past_end(start, self.duration)
        return self.slice_ticks(*tick_range(self.rate_exact, start, stop))

    def __getitem__(self, place: object) -> NoReturn:
        raise ParameterError(
            "a channel has no subscripts; channel.sel(start=1, stop=2) selects seconds, "
            "channel.to_numpy(1, 2) gives their values, and channel.to_numpy()[...] counts ticks"
        )

    def __len__(self) -> int:
        """Values of :meth:`to_numpy`: samples and gaps, from the first sample to the last."""
        return self.stop_tick - self.start_tick

    def __bool__(self) -> bool:
        return True

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """``np.asarray(channel)`` is ``channel.to_numpy()``."""
        if copy is False:
            raise ValueError("an array of a channel is always a copy")
        x = self.to_numpy()
        return x if dtype is None else x.astype(dtype, copy=False)

    def __repr__(self) -> str:
        kind = str(self.stored.dtype)
        if self.calibration is not None:
            kind = f"counts of {float(abs(self.calibration.step)):.6g}"
            kind += " and float64 corrections" if self.exact is not None else ""
        kind += "; synthetic texture" if self.synthetic else ""
        gaps = f", {len(self.gaps)} gap{'s' * (len(self.gaps) > 1)}" if self.gaps else ""
        return (
            f"Channel {_short(self.label)!r}: {self.stored.size} samples at {self.rate:.6g} Hz, "
            f"{_span_text(self)}{gaps}; unit {_short(self.unit)}; {kind}"
        )

    def segments(self) -> Iterator[tuple[int, NDArray[Any]]]:
        """Each covered span, in order: its first tick and its stored samples."""
        position = 0
        for span in self.coverage:
            yield span.start, self.stored[position : position + span.ticks]
            position += span.ticks

    def filled(
        self, start: int | None = None, stop: int | None = None, *, limit: int = 1 << 31
    ) -> NDArray[np.float64]:
        """float64 [stop - start]: values of the ticks in ``unit``, NaN in gaps.

        By default from tick 0 to the last sample. Raises LimitError above ``limit`` values.
        """
        first = 0 if start is None else start
        last = self.stop_tick if stop is None else stop
        _check_ticks(last - first, limit)
        out = np.full(max(last - first, 0), np.nan)
        position = 0
        x = self.samples()
        for span in self.coverage:
            a, b = max(span.start, first), min(span.stop, last)
            if a < b:
                at = position + a - span.start
                out[a - first : b - first] = x[at : at + b - a]
            position += span.ticks
        return out

    def slice_ticks(self, start: int, stop: int) -> Channel:
        """Only the samples with start <= tick < stop; ticks keep their numbers."""
        whole = self.coverage if start < stop else ()
        a = bisect_right(whole, start, key=lambda span: span.stop)
        b = bisect_left(whole, stop, key=lambda span: span.start)
        spans = tuple(Span(max(s.start, start), min(s.stop, stop)) for s in whole[a:b])
        kept = slice(0)
        if spans:
            low = self._places[a] + spans[0].start - whole[a].start
            high = self._places[b] - (whole[b - 1].stop - spans[-1].stop)
            kept = slice(low, high)
        exact = None if self.exact is None else self.exact[kept].copy()
        return replace(self, stored=self.stored[kept].copy(), coverage=spans, exact=exact)

    @cached_property
    def _places(self) -> list[int]:
        """Stored samples before each span, and all of them."""
        return [*accumulate((span.ticks for span in self.coverage), initial=0)]


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Channels that share one zero of time.

    ``rec["fx"]`` and ``rec[0]`` are channels, ``list(rec)`` has all of them, ``len(rec)`` is
    their number. ``"fx" in rec`` is True if a channel has that label.

    epoch_ns
        UTC time of tick 0 in nanoseconds since 1970-01-01; None: unknown.
    epoch_uncertainty_ns
        uncertainty of ``epoch_ns`` in nanoseconds; 0: unknown.
    metadata
        any JSON object.
    attachments
        {name: (media type, bytes)}.
    events
        markers and annotations.
    clocks
        hapfmt.ClockObservation of other clocks, those of one clock and channel together; a channel
        is kept by its number.
    clock_maps
        hapfmt.ClockMap, at most one for a clock and channel.
    """

    channels: tuple[Channel, ...] = ()
    uuid: _uuid.UUID | None = None
    epoch_ns: int | None = None
    epoch_uncertainty_ns: int = 0
    metadata: dict[str, Any] = field(default_factory=dict)
    attachments: dict[str, tuple[str, bytes]] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    clocks: tuple[ClockObservation, ...] = ()
    clock_maps: tuple[ClockMap, ...] = ()

    def __post_init__(self) -> None:
        kinds = {
            "channels": Channel,
            "events": Event,
            "clocks": ClockObservation,
            "clock_maps": ClockMap,
        }
        for name, kind in kinds.items():
            given = getattr(self, name)
            if isinstance(given, (Mapping, kind)) or not isinstance(given, Iterable):
                given = [None]
            found = tuple(given)
            if not all(isinstance(one, kind) for one in found):
                advice = "; Recording.from_array takes arrays and tables"
                raise ParameterError(
                    f"the {name.replace('_', ' ')} of a recording are a list of "
                    f"hapfmt.{kind.__name__}{advice if name == 'channels' else ''}"
                )
            object.__setattr__(self, name, found)
        if self.clocks or self.clock_maps:
            self._place_clocks()
        if self.epoch_ns is not None:
            object.__setattr__(self, "epoch_ns", _whole_ns(self.epoch_ns, "epoch_ns"))
            if not -EPOCH_LIMIT <= self.epoch_ns < EPOCH_LIMIT:
                raise ParameterError("the epoch lies within 2^63 nanoseconds of 1970")
        uncertainty = _whole_ns(self.epoch_uncertainty_ns, "epoch_uncertainty_ns")
        object.__setattr__(self, "epoch_uncertainty_ns", uncertainty)
        if not 0 <= uncertainty < EPOCH_LIMIT:
            raise ParameterError("the uncertainty of the epoch is below 2^63 ns and not negative")

    def _place_clocks(self) -> None:
        """Channels of clocks become numbers, and what belongs together is put together."""
        labels = self.labels
        clocked: list[ClockObservation | ClockMap] = [*self.clocks, *self.clock_maps]
        numbers: dict[int | str | None, int] = {
            channel: place_of_reference(channel, labels, "a clock")
            for channel in {one.channel for one in clocked}
            if channel is not None
        }
        seen = by_clock(on_channels(self.clocks, numbers))
        maps = by_clock(on_channels(self.clock_maps, numbers))
        for (clock, channel), own in maps.items():
            check_steps(own[0])
            if len(own) > 1:
                where = "nanoseconds" if channel is None else f"channel {channel}"
                raise ParameterError(f"{len(own)} maps of clock {clock!r} for {where}; keep one")
        object.__setattr__(self, "clocks", tuple(chain.from_iterable(seen.values())))
        object.__setattr__(self, "clock_maps", tuple(chain.from_iterable(maps.values())))

    @classmethod
    def from_array(
        cls,
        x: Any,
        rate: Rates | None = None,
        *,
        labels: str | Sequence[str] | None = None,
        units: str | Sequence[str] | Mapping[str, str] | None = None,
        transpose: bool | None = None,
        events: Iterable[Event] | None = None,
        **others: Any,
    ) -> Recording:
        """A recording of an array or a table; the arguments are those of :func:`hapfmt.write`."""
        refuse_keywords(others, cls.from_array)
        made = recording_of(x, rate, labels=labels, units=units, transpose=transpose)
        return made if events is None else replace(made, events=(*made.events, *events))

    def __len__(self) -> int:
        return len(self.channels)

    def __iter__(self) -> Iterator[Channel]:
        return iter(self.channels)

    def __contains__(self, label: object) -> bool:
        return any(channel.label == label or channel is label for channel in self.channels)

    @overload
    def __getitem__(self, label: str | int) -> Channel: ...

    @overload
    def __getitem__(self, label: list[str | int] | list[str] | list[int]) -> Recording: ...

    def __getitem__(self, label: Any) -> Channel | Recording:
        """The channel of a label or a number; negative numbers count from the end. A list gives a
        recording of several.

        Raises UnknownChannelError (a ParameterError and a KeyError) where there is none, and where
        several channels have the label.
        """
        if isinstance(label, list):
            return self.sel(label)
        if isinstance(label, slice):
            raise ParameterError(
                "a recording has no slices; rec.sel(start=1, stop=2) selects seconds, and "
                "list(rec)[1:3] channels"
            )
        return self.channels[self.place_of(label)]

    def place_of(self, label: str | int) -> int:
        """The number of a channel, by its label or number."""
        if isinstance(label, str):
            places = [i for i, channel in enumerate(self.channels) if channel.label == label]
            if len(places) == 1:
                return places[0]
            if places:
                numbers = ", ".join(map(str, places[:_SHOWN_CHANNELS]))
                raise UnknownChannelError(
                    f"{len(places)} channels are called {label!r}; use their numbers: {numbers}"
                )
            if label.removeprefix("-").isdecimal() and label.isascii():
                return self.place_of(int(label))
            if matching(label, self.labels):
                raise UnknownChannelError(
                    f"{label!r} fits several channels; rec.sel({label!r}) selects them"
                )
            raise UnknownChannelError(unknown("channel", label, self.labels))
        try:
            number = index(label)
        except TypeError:
            raise ParameterError(
                f"a channel is named by its label or number, not by {type(label).__name__}; "
                "rec.sel([...]) takes several"
            ) from None
        if not -len(self) <= number < len(self):
            raise UnknownChannelError(f"no channel {number}; there are {len(self)}, from 0")
        return number % len(self)

    @property
    def labels(self) -> list[str]:
        """The labels of all channels, in order."""
        return [channel.label for channel in self.channels]

    @property
    def duration(self) -> Fraction:
        """Seconds from the zero of the recording to the end of its last sample."""
        return max((channel.duration for channel in self.channels), default=Fraction(0))

    @property
    def rate(self) -> float:
        """Samples per second of all channels. Raises ParameterError where they differ."""
        rates = {channel.rate_exact for channel in self.channels}
        if len(rates) != 1:
            listed = ", ".join(f"{float(rate):.6g} Hz" for rate in sorted(rates)[:_SHOWN_CHANNELS])
            raise ParameterError(
                f"the channels have {len(rates)} rates ({listed or 'none'}); rec['label'].rate is "
                "that of a channel"
            )
        return float(rates.pop())

    @property
    def sample_count(self) -> int:
        return sum(int(channel.stored.size) for channel in self.channels)

    def channel(self, label: str) -> Channel:
        """The channel of a label; the same as ``rec[label]``."""
        return self[label]

    def sel(
        self,
        channels: str | int | Sequence[str | int] | None = None,
        start: Seconds | None = None,
        stop: Seconds | None = None,
    ) -> Recording:
        """A part of the recording: some channels, and the seconds start <= time < stop.

        ``channels``: labels or numbers in the wanted order, or patterns such as "pos_*"; None: all.
        Samples keep their times. Events and clocks of other channels, and events and observations
        outside these seconds, are left out; maps stay. Raises UnknownChannelError, and
        ParameterError if stop is not after start, or start is not before the end.
        """
        check_seconds(start, stop)
        if start is not None:
            refuse_past_end(start, self.duration)
        places = self._places_of(channels)
        parts = [self.channels[place] for place in places]
        if start is not None or stop is not None:
            parts = [
                channel.slice_ticks(*tick_range(channel.rate_exact, start, stop))
                for channel in parts
            ]
        now: dict[int | str | None, int] = {old: new for new, old in reversed([*enumerate(places)])}
        rates = [channel.rate_exact for channel in parts]
        return replace(
            self,
            channels=tuple(parts),
            events=tuple(self._events_of(places, start, stop)),
            clocks=tuple(observed_between(on_channels(self.clocks, now), rates, start, stop)),
            clock_maps=tuple(on_channels(self.clock_maps, now)),
        )

    def _places_of(self, labels: Any) -> list[int]:
        if labels is None:
            return [*range(len(self))]
        if isinstance(labels, (str, int, np.integer)):
            labels = [labels]
        if not isinstance(labels, (list, tuple, np.ndarray, range)):
            raise ParameterError(
                f"channels are a label, a number or a list of them, not a {type(labels).__name__}"
            )
        places: list[int] = []
        for label in labels:
            found = [] if not isinstance(label, str) else matching(label, self.labels)
            places += found or [self.place_of(label)]
        return places

    def _events_of(
        self, places: Sequence[int], start: Seconds | None, stop: Seconds | None
    ) -> Iterator[Event]:
        low = None if start is None else to_fraction(start)
        high = None if stop is None else to_fraction(stop)
        now = {old: new for new, old in reversed([*enumerate(places)])}
        by_label = {c.label: place for place, c in reversed([*enumerate(self.channels)])}
        for event in self.events:
            ended = low is not None and event.time < low and event.time + event.duration <= low
            if ended or (high is not None and event.time >= high):
                continue
            channel = event.channel
            if channel is None:
                yield event
                continue
            place = by_label.get(channel) if isinstance(channel, str) else channel
            if place in now:
                yield replace(event, channel=now[place])

    def to_numpy(
        self,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        limit: int = GAPPY_TICKS,
    ) -> NDArray[np.float64]:
        """float64 [channels, ticks]: values in each channel's unit, NaN in gaps.

        All channels cover the same ticks: from the first sample of any channel to the last, or the
        seconds start <= time < stop. :meth:`times` gives their seconds. Raises ParameterError if
        the channels differ in rate, LimitError above ``limit`` values.
        """
        first, last = self._common_ticks(start, stop)
        _check_ticks((last - first) * len(self), limit)
        rows = [channel.filled(first, last, limit=limit) for channel in self.channels]
        return np.stack(rows) if rows else np.empty((0, 0))

    def times(
        self,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        limit: int = GAPPY_TICKS,
    ) -> NDArray[np.float64]:
        """float64 [ticks]: seconds of the columns of :meth:`to_numpy`."""
        first, last = self._common_ticks(start, stop)
        _check_ticks(last - first, limit)
        rate = self.channels[0].rate_exact if self.channels else Fraction(1)
        return seconds_of(first, last, rate)

    def _common_ticks(self, start: Seconds | None, stop: Seconds | None) -> tuple[int, int]:
        by_rate: dict[Fraction, list[str]] = {}
        for channel in self.channels:
            by_rate.setdefault(channel.rate_exact, []).append(channel.label)
        if len(by_rate) > 1:
            rates = ", ".join(f"{float(rate):.6g} Hz" for rate in [*by_rate][:_SHOWN_CHANNELS])
            some = next(iter(by_rate.values()))[:2]
            raise ParameterError(
                f"the channels have {len(by_rate)} rates ({rates}); select those of one rate, "
                f"such as rec.sel({some!r}), or use rec.to_xarray()"
            )
        if not self.channels:
            return 0, 0
        first, last = extent(self.channels)
        low, high = tick_range(self.channels[0].rate_exact, start, stop)
        first = first if start is None else low
        return first, max(last if stop is None else high, first)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """``np.asarray(rec)`` is ``rec.to_numpy()``."""
        if copy is False:
            raise ValueError("an array of a recording is always a copy")
        x = self.to_numpy()
        return x if dtype is None else x.astype(dtype, copy=False)

    def to_pandas(self) -> Any:
        """A pandas.DataFrame: one column for each channel, NaN in gaps, seconds as index.

        Dates are the index of a recording that a DataFrame with a DatetimeIndex gave, in its zone.
        Each column has another name: a second "x" becomes "x (2)", and "time" becomes "time (2)".
        ``frame.attrs["units"]`` is {column: unit}, ``frame.attrs["epoch_ns"]`` is the UTC time of
        second 0. All channels need one rate; ``to_xarray()`` takes several. Needs the extra
        "pandas". Raises ParameterError, LimitError, MissingExtraError.
        """

        return to_pandas(self)

    def to_arrow(self) -> Any:
        """A pyarrow.Table: "time" in seconds, and a float64 column for each channel, null in gaps.

        The metadata of the fields have labels and units. All channels need one rate. Needs the
        extra "arrow". Raises ParameterError, LimitError, MissingExtraError.
        """

        return to_arrow(self)

    def to_xarray(self) -> Any:
        """An xarray.Dataset: one variable for each channel, NaN in gaps.

        The coordinate is "time" in seconds; channels of several rates have "time_1000Hz" ...
        A channel with the label "time" becomes "time (2)"; ``attrs["long_name"]`` is its label.
        Attributes follow the CF conventions. Clocks are coordinates in nanoseconds.
        ``xarray.open_dataset(file)`` gives the same dataset and reads values on demand. Needs the
        extra "xarray". Raises LimitError, MissingExtraError.
        """

        return to_xarray(self)

    def __repr__(self) -> str:
        channels, samples = counted(len(self), "channel"), counted(self.sample_count, "sample")
        lines = [f"Recording: {channels}, {samples}, {_seconds(self)}"]
        lines[0] += f", {counted(len(self.events), 'event')}" if self.events else ""
        names = {one.clock for one in self.clocks} | {one.clock for one in self.clock_maps}
        lines[0] += f", {counted(len(names), 'clock')}" if names else ""
        rows = [
            (
                str(number),
                repr(_short(c.label)),
                f"{counted(c.stored.size, 'sample')} at {c.rate:.6g} Hz",
                _short(c.unit),
                counted(len(c.gaps), "gap") if c.gaps else "",
            )
            for number, c in enumerate(self.channels[:SHOWN_LINES])
        ]
        lines += aligned(rows)
        if len(rows) < len(self):
            more = counted(len(self) - len(rows), "more channel")
            lines.append(f"  ... and {more} (rec.labels lists all)")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """A table for notebooks; every text of the file is escaped."""
        rows = [
            (str(number), c.label, c.unit, f"{c.rate:.6g} Hz", str(c.stored.size), _span_text(c),
             str(len(c.gaps)))
            for number, c in enumerate(self.channels[:_SHOWN_ROWS])
        ]  # fmt: skip
        head = ("", "label", "unit", "rate", "samples", "seconds", "gaps")
        return html_table(repr(self).split("\n", 1)[0], head, rows, len(self) - len(rows))


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of text with their columns below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [("  " + "  ".join(map(str.ljust, row, widths))).rstrip() for row in rows]


def html_table(first: str, head: Sequence[str], rows: Sequence[Sequence[str]], more: int) -> str:
    """A line and a table of channels for notebooks; all texts are escaped."""
    from html import escape

    lines = ["".join(f"<th>{text}</th>" for text in head)]
    lines += ["".join(f"<td>{escape(_short(text, 80))}</td>" for text in row) for row in rows]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    rest = f"<p>and {counted(more, 'more channel')}</p>" if more else ""
    return f"<p>{escape(first)}</p><table>{body}</table>{rest}"


def extent(
    channels: Sequence[Channel], start: Seconds | None = None, stop: Seconds | None = None
) -> tuple[int, int]:
    """The ticks [first, last) from the first sample of any channel to the last; channels without
    samples do not count."""
    ends = [c.ticks_between(start, stop) for c in channels if c.coverage]
    ends = [(first, last) for first, last in ends if first < last]
    first = min((first for first, _ in ends), default=0)
    return first, max((last for _, last in ends), default=first)


def seconds_of(first: int, last: int, rate: Fraction) -> NDArray[np.float64]:
    """float64 [last - first]: seconds of ticks, each the nearest double while the products are
    below 2**53."""
    ticks = np.arange(first, last).astype(np.float64)
    seconds: NDArray[np.float64] = ticks * float(rate.denominator) / float(rate.numerator)
    return seconds


def refuse_past_end(start: Seconds, end: Fraction) -> None:
    """ParameterError where a part begins at or after the end of the samples."""
    if to_fraction(start) >= end > 0:
        raise ParameterError(
            f"No samples at {float(to_fraction(start)):g} s or later: the recording ends at "
            f"{float(end):g} s"
        )


def observed_between(
    observations: Iterable[ClockObservation],
    rates: Sequence[Fraction],
    start: Seconds | None,
    stop: Seconds | None,
) -> Iterator[ClockObservation]:
    """Those at the seconds start <= time < stop; ``rates`` are those of the channels."""
    if start is None and stop is None:
        yield from observations
        return
    ranges: dict[int | str | None, tuple[int, int]] = {
        place: tick_range(rate, start, stop) for place, rate in enumerate(rates)
    }
    ranges[None] = tick_range(NANOSECONDS, start, stop)
    for seen in observations:
        first, end = ranges[seen.channel]
        if (start is None or first <= seen.tick) and seen.tick < end:
            yield seen


def check_seconds(start: Seconds | None, stop: Seconds | None) -> None:
    """ParameterError where the time range is empty."""
    low = to_fraction(0 if start is None else start)
    if stop is not None and to_fraction(stop) <= low:
        swapped = "; start is after stop" if to_fraction(stop) < low else ""
        raise ParameterError(
            f"No samples in this time range: {float(low):g} to {float(to_fraction(stop)):g} s"
            f"{swapped}"
        )


def _check_ticks(values: int, limit: int) -> None:
    if values > limit:
        raise LimitError(
            f"{values} values with their gaps are above the limit of {limit}; take a part of the "
            "time, or samples(), which leaves the gaps out"
        )


def _span_text(channel: Channel) -> str:
    if not channel.coverage:
        return "empty"
    first, last = channel.start_tick / channel.rate_exact, channel.duration
    return f"{float(first):.6g} to {float(last):.6g} s"


def _seconds(recording: Recording) -> str:
    begun = [c.start_tick / c.rate_exact for c in recording if c.coverage]
    start = float(min(begun, default=0))
    return (f"{start:.6g} to " if start else "") + f"{float(recording.duration):.6g} s"


def _short(text: str, size: int = 40) -> str:
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return text if len(text) <= size else text[: size - 3] + "..."


def _whole_ns(value: Any, name: str) -> int:
    try:
        return index(value)
    except TypeError:
        kind = type(value).__name__
        raise ParameterError(
            f"{name} is an integer, in nanoseconds, not {kind}; convert seconds with "
            "int(seconds * 1e9) and a datetime with int(t.timestamp() * 1e9)"
        ) from None


def _deprecated(old: str, new: str) -> None:
    warnings.warn(f"{old} is deprecated; use {new}", DeprecationWarning, stacklevel=3)


def known_samples(
    x: NDArray[Any], masked: NDArray[np.bool_] | bool = False
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Return [ticks] values, and which of them are samples: NaN and masked values are gaps.

    Without any other value all are samples that are NaN, because a channel of gaps has no length.
    """
    known = ~np.asarray(masked) & ~(np.isnan(x) if x.dtype.kind == "f" else np.zeros(x.shape, bool))
    if known.any() or not x.size:
        return x, known
    return np.full(x.shape, np.nan), ~known


def spans_of(known: NDArray[np.bool_], start_tick: int = 0) -> Iterator[Span]:
    """Maximal runs of True in [ticks] as spans, counted from ``start_tick``."""
    edges = np.flatnonzero(np.diff(known.astype(np.int8), prepend=0, append=0))
    for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        yield Span(start_tick + a, start_tick + b)


def append_span(spans: list[Span], span: Span) -> None:
    """Append a span that begins at or after the last one's end; adjacent ones become one."""
    if spans and spans[-1].stop == span.start:
        spans[-1] = Span(spans[-1].start, span.stop)
    else:
        spans.append(span)
