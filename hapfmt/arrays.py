"""Arrays, tables and data frames <-> Recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import LimitError, MissingExtraError, ParameterError
from .limits import LAST_TRACK_ID
from .recording import (
    GAPPY_TICKS,
    Calibration,
    Channel,
    Rate,
    Recording,
    extent,
    seconds_of,
    spans_of,
)
from .units import to_ucum

CHANNEL_LIMIT = LAST_TRACK_ID // 2
"""Channels of a recording that is encoded: up to two tracks each."""


def recording_of(
    data: Any,
    rate: Rate | None = None,
    *,
    labels: str | Sequence[str] | None = None,
    units: str | Sequence[str] | None = None,
    transpose: bool | None = None,
) -> Recording:
    """A recording of whatever people have: a Recording, Channels, an array, a DataFrame, or
    {label: 1-D array}. The arguments are those of :func:`hapfmt.write`."""
    if isinstance(data, Recording) or _are_channels(data):
        given = {"rate": rate, "labels": labels, "units": units, "transpose": transpose}
        if named := [name for name, value in given.items() if value is not None]:
            raise ParameterError(f"{named[0]} is for arrays; channels have their own")
        if isinstance(data, Recording):
            return data
        return Recording((data,) if isinstance(data, Channel) else tuple(data))
    epoch_ns = None
    if _is_frame(data):
        labels = labels or [str(name) for name in data.columns]
        units = units or data.attrs.get("units")
        epoch_ns = data.attrs.get("epoch_ns")
        if rate is None:
            rate, start, epoch_ns = _grid_of_index(data.index, epoch_ns)
        else:
            start = 0
        rows = [
            _row(data.iloc[:, place].to_numpy(), labels[place]) for place in range(data.shape[1])
        ]
    elif isinstance(data, Mapping):
        labels = labels or [str(name) for name in data]
        rows = [_row(value, name) for name, value in zip(labels, data.values(), strict=False)]
        start = 0
    else:
        rows, start = rows_of(data, labels, transpose), 0
    if rate is None:
        raise ParameterError("an array has no rate; give one, such as rate=1000")
    names = _for_each(labels, "labels", len(rows)) or [f"ch{i + 1}" for i in range(len(rows))]
    codes = _for_each(units, "units", len(rows), shared=True) or ["1"] * len(rows)
    return Recording(
        tuple(
            channel_of(row, rate, label=name, unit=to_ucum(code), start_tick=start)
            for row, name, code in zip(rows, names, codes, strict=True)
        ),
        epoch_ns=epoch_ns,
    )


def channel_of(x: Any, rate: Rate, *, start_tick: int = 0, **described: Any) -> Channel:
    """A channel of a 1-D array: integers of up to 32 bits become counts; NaN and masked values are
    gaps."""
    known = ~np.ma.getmaskarray(x)
    x = np.ma.getdata(x)
    if x.dtype.kind == "f":
        known &= ~np.isnan(x)
    spans = tuple(spans_of(known, start_tick))
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
    if array.dtype.kind not in "biuf":
        raise ParameterError(f"{what} holds {array.dtype} values, not real numbers")
    if array.dtype.kind == "f" and array.dtype.itemsize > 8:
        raise ParameterError(f"{what} holds {array.dtype}; convert it to float64")
    return array


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
    if len(texts) != count or not all(isinstance(text, str) for text in texts):
        raise ParameterError(f"{name} are {count} texts, one for each channel; got {len(texts)}")
    return list(texts)


def _are_channels(data: Any) -> bool:
    if isinstance(data, Channel):
        return True
    return (
        isinstance(data, (list, tuple))
        and bool(data)
        and all(isinstance(one, Channel) for one in data)
    )


def _is_frame(data: Any) -> bool:
    """Without importing pandas."""
    kind = type(data)
    return kind.__name__ == "DataFrame" and kind.__module__.startswith("pandas")


def _grid_of_index(index: Any, epoch_ns: int | None) -> tuple[Fraction, int, int | None]:
    """Rate, first tick and epoch of a DataFrame's index in seconds, or of dates."""
    from .convert.times import Stamps

    kind = getattr(index.dtype, "kind", "O")
    stamps = Stamps(-9 if kind == "M" else 0)
    if kind == "M":
        texts = map(str, index.to_numpy().astype("M8[ns]").astype(np.int64).tolist())
    elif kind == "f":
        texts = map(repr, index.to_numpy().tolist())
    else:
        raise ParameterError("the index of the DataFrame holds no times; give a rate")
    for text in texts:
        try:
            stamps.add(text)
        except ValueError as error:
            raise ParameterError(f"the index of the DataFrame: {text[:40]!r} {error}") from None
    grid = stamps.grid()
    if int(grid.ticks[-1]) - int(grid.ticks[0]) != len(grid.ticks) - 1:
        raise ParameterError("rows are missing from the DataFrame; reindex it, NaN is a gap")
    return grid.rate, int(grid.ticks[0]), grid.epoch_ns if kind == "M" else epoch_ns


def to_pandas(recording: Recording) -> Any:
    try:
        import pandas
    except ImportError:
        raise MissingExtraError("pandas", "pandas") from None
    x = recording.to_numpy()
    index = pandas.Index(recording.times(), name="time")
    frame = pandas.DataFrame(x.T, index=index, columns=recording.labels)
    frame.attrs["units"] = [channel.unit for channel in recording]
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
