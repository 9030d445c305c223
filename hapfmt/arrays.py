"""Arrays, tables and data frames <-> Recording."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import (
    LimitError,
    MissingExtraError,
    MovedTimesWarning,
    ParameterError,
    UnknownChannelError,
)
from .limits import LAST_TRACK_ID
from .names import unknown
from .numbers import hertz
from .recording import (
    GAPPY_TICKS,
    Calibration,
    Channel,
    Rate,
    Recording,
    extent,
    seconds_of,
    spans_at,
    spans_of,
)
from .units import split_name, to_ucum

Units = str | Sequence[str] | Mapping[str, str]

CHANNEL_LIMIT = LAST_TRACK_ID // 2
"""Channels of a recording that is encoded: up to two tracks each."""


def recording_of(
    data: Any,
    rate: Rate | None = None,
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
    frame = _frame_of(data)
    if frame is not None:
        if transpose is not None:
            raise ParameterError("transpose is for arrays; a table has a column for each channel")
        return _recording_of_frame(frame, rate, labels, units)
    if isinstance(data, Mapping):
        rows = [_row(value, str(name)) for name, value in data.items()]
        labels, units = _described([str(name) for name in data], labels, units)
    else:
        rows = rows_of(data, labels, transpose)
    if rate is None:
        raise ParameterError("an array has no rate; give one, such as rate=1000")
    names = _for_each(labels, "labels", len(rows)) or [f"ch{i + 1}" for i in range(len(rows))]
    return Recording(
        tuple(
            channel_of(row, rate, label=name, unit=to_ucum(code))
            for row, name, code in zip(rows, names, _units(units, names), strict=True)
        )
    )


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
    return Recording(
        tuple(
            channel_of(
                _row(frame.iloc[:, place].to_numpy(), name), rate,
                ticks=ticks, label=name, unit=to_ucum(code),
            )
            for place, (name, code) in enumerate(zip(names, codes, strict=True))
        ),
        epoch_ns=epoch_ns,
        metadata={"notes": list(notes)} if notes else {},
    )  # fmt: skip


def channel_of(
    x: Any, rate: Rate, *, ticks: NDArray[np.int64] | None = None, **described: Any
) -> Channel:
    """A channel of a 1-D array: integers of up to 32 bits become counts; NaN and masked values are
    gaps. ``ticks`` are the ticks of the values, by default 0, 1, 2 ..."""
    known = ~np.ma.getmaskarray(x)
    x = np.ma.getdata(x)
    if x.dtype.kind == "f":
        known &= ~np.isnan(x)
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
        if transpose:
            raise ParameterError("an array of one dimension has nothing to transpose")
        return [array]
    if array.ndim != 2:
        raise ParameterError(
            f"an array of {array.ndim} dimensions; give [samples] or [channels, samples]"
        )
    count = None if labels is None or isinstance(labels, str) else len(labels)
    array = upright(array, count, transpose, "the array", "pass array.T, or transpose=True")
    return list(array)


def upright(x: Any, labelled: int | None, transpose: bool | None, what: str, advice: str) -> Any:
    """[channels, samples], transposed where that was asked for.

    Nobody records more channels than samples by intent, so that needs labels that agree, or
    ``transpose=False``.
    """
    if transpose is not None:
        return x.T if transpose else x
    rows, columns = x.shape
    if rows > columns > 0 and labelled != rows:
        raise ParameterError(
            f"{what} is {rows} x {columns}, read as {rows} channels of {columns} samples; if it is "
            f"{columns} channels, {advice}; if not, transpose=False (--no-transpose)"
        )
    return x


def _numbers(x: Any, what: str) -> NDArray[Any]:
    try:
        array: NDArray[Any] = np.asanyarray(x)
    except ValueError:
        raise ParameterError(f"{what} has rows of different lengths") from None
    if array.dtype == object:
        raise ParameterError(
            f"{what} holds Python objects, not numbers; convert it with .astype(float)"
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
        "units": {name: one.attrs["units"] for name, one in data.items() if "units" in one.attrs},
        "epoch_ns": data.attrs.get("epoch_ns"),
    }
    return frame


def _grid_of_index(
    index: Any, rate: Rate | None, epoch_ns: int | None, time_columns: Sequence[str]
) -> tuple[Fraction, NDArray[np.int64], int | None, tuple[str, ...]]:
    """Rate, ticks of the rows, epoch, and notes, from an index in seconds, of durations or dates.

    Times are placed as those of a .csv file. An index named "t [ms]" holds milliseconds.
    """
    from .times import Stamps, time_name

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
    stamps = Stamps(exponent)
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


def to_pandas(recording: Recording) -> Any:
    try:
        import pandas
    except ImportError:
        raise MissingExtraError("pandas", "pandas") from None
    x = recording.to_numpy()
    index = pandas.Index(recording.times(), name="time")
    frame = pandas.DataFrame(x.T, index=index, columns=recording.labels)
    frame.attrs["units"] = {channel.label: channel.unit for channel in recording}
    if recording.epoch_ns is not None:
        frame.attrs["epoch_ns"] = recording.epoch_ns
    return frame


def to_xarray(recording: Recording) -> Any:
    try:
        import xarray
    except ImportError:
        raise MissingExtraError("xarray", "xarray") from None
    by_rate: dict[Fraction, list[Channel]] = {}
    for channel in recording:
        by_rate.setdefault(channel.rate_exact, []).append(channel)
    names = iter(unique(recording.labels, []))
    name_of = {id(channel): name for channel, name in zip(recording, names, strict=True)}
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    left = GAPPY_TICKS
    for number, (rate, channels) in enumerate(by_rate.items()):
        time = "time" if len(by_rate) == 1 else f"time_{number}"
        first, last = extent(channels)
        left -= (last - first) * len(channels)
        if left < 0:
            raise LimitError(
                f"the channels with their gaps have more than {GAPPY_TICKS} values; take a part: "
                "rec.sel(start=..., stop=...)"
            )
        coordinates[time] = (time, seconds_of(first, last, rate), {"units": "s"})
        for channel in channels:
            described = {"units": channel.unit, "long_name": channel.label, "rate": channel.rate}
            variables[name_of[id(channel)]] = (time, channel.filled(first, last), described)
    about = {} if recording.epoch_ns is None else {"epoch_ns": recording.epoch_ns}
    return xarray.Dataset(variables, coordinates, about)


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
