"""A map: a TOML file that says where the channels of an HDF5 or MAT file are.

For layouts that layouts.py does not recognise. Each ``[[table]]`` names data sets whose rows have
common times.
"""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from ..descriptions import Description, DescriptionError, parse_toml, read, refuse_twice, what
from ..errors import HapfmtError, ParameterError
from ..structs import Meta
from ..times import TIME_UNITS
from .common import rate_from
from .formats import ReadOptions
from .layouts import PlannedPart, PlannedTable, SourceArray, SourceTree, built, split_column
from .tables import Import

TimeUnit = Literal["s", "ms", "us", "ns"]
Name = Annotated[str, Meta(min_length=1, max_length=1000)]
Rated = Annotated[float | str, what("samples per second: 1000, 35.618 or '44100/7'")]


class MapTable(Description):
    """Data sets with common times."""

    data: Annotated[Name | tuple[Name, ...], what("path of a data set, or of several")]
    name: Annotated[Name | None, what("name of the table [path of the first data set]")] = None
    time: Annotated[Name | None, what("path of the times")] = None
    time_unit: Annotated[TimeUnit | None, what("unit of the times [as the file says]")] = None
    time_column: (
        Annotated[
            int, Meta(ge=0, description="which column of the data set holds the times, from 0")
        ]
        | None
    ) = None
    rate: Rated | None = None
    axis: (
        Annotated[int, Meta(ge=0, le=7, description="which side of the arrays is time, from 0")]
        | None
    ) = None
    labels: Annotated[tuple[Name, ...], what("a label for each channel")] = ()
    unit: Annotated[str | tuple[str, ...], what("unit of all channels, or one for each")] = ""
    quantity: Annotated[str, what("what is measured: 'force'")] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.paths:
            raise DescriptionError("data", "is empty; name a data set")
        refuse_twice("data", self.paths)
        refuse_twice("labels", self.labels)
        if self.time_column is not None and (self.time is not None or len(self.paths) > 1):
            raise DescriptionError("time_column", "is for one data set without time")
        if self.time is None and self.time_column is None and self.time_unit is not None:
            raise DescriptionError("time_unit", "needs time, the path of the times")
        if self.rate is not None:
            self.stated_rate()

    @property
    def paths(self) -> tuple[str, ...]:
        return (self.data,) if isinstance(self.data, str) else self.data

    def stated_rate(self) -> Fraction:
        try:
            return rate_from(self.rate)  # type: ignore[arg-type]
        except ParameterError as error:
            raise DescriptionError("rate", str(error)) from None


class MapKeys(Description):
    """Where the channels of a file are."""

    table: Annotated[
        tuple[MapTable, ...], Meta(min_length=1, max_length=10_000, description="the tables")
    ]


def _read_map(path: str) -> tuple[MapKeys, str]:
    """The map in a TOML file, and its text."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ParameterError("this is not a text in UTF-8", path=path) from None
    try:
        return read(MapKeys, parse_toml(text)), text
    except HapfmtError as error:
        error.message += _line(text, error.message)
        raise error.at(path=path) from error.__cause__


def _line(text: str, message: str) -> str:
    """Where the table and the key are that a message begins with; "" where it is not clear."""
    found = re.match(r"table\[(\d{1,5})\](?:\.|: )?(\w+)?", message)
    lines = text.splitlines()
    heads = [place for place, line in enumerate(lines) if re.match(r"\s*\[\[\s*table\b", line)]
    if found is None or int(found[1]) >= len(heads):
        return ""
    first = heads[int(found[1])]
    last = [*heads, len(lines)][int(found[1]) + 1]
    for place in range(first + 1, last):
        if found[2] and re.match(rf"\s*{found[2]}\s*=", lines[place]):
            first = place
    return f" (at line {first + 1})"


def mapped(tree: SourceTree, options: ReadOptions) -> Import:
    """The contents of a file by its map."""
    assert options.map is not None
    for name in ("select", "episode", "clock", "transpose"):
        if getattr(options, name) != getattr(ReadOptions(), name):
            raise ParameterError(f"{name} is not for a map, which says it itself")
    keys, text = _read_map(options.map)
    planned = []
    for number, one in enumerate(keys.table):
        try:
            planned.append(_table(tree, one, options))
        except ParameterError as error:
            message = f"table[{number}]: {error}"
            raise ParameterError(message + _line(text, message), path=options.map) from None
    unread = {array.name for array in tree.arrays}
    for table in planned:
        unread -= {part.array.name for part in table.parts}
        unread -= {table.times.name} if table.times is not None else set()
    if unread:
        shown = sorted(unread)[:8]
        more = f" and {len(unread) - 8} more" if len(unread) > 8 else ""
        tree.notes.append(f"the map does not name {', '.join(shown)}{more}; they are not read")
    return built(tree, planned, options)


def _table(tree: SourceTree, one: MapTable, options: ReadOptions) -> PlannedTable:
    arrays = [tree.array(path) for path in one.paths]
    times = None if one.time is None else tree.array(one.time)
    if one.time_column is not None:
        times, arrays[0] = _split(arrays[0], one)
    rate = None if one.rate is None else one.stated_rate()
    if times is None and rate is None and options.rate is None:
        raise ParameterError("it needs time, time_column or rate")
    if times is not None and (not times.is_line or times.dtype.kind not in "iuf"):
        raise ParameterError(f"time: {times.name} is not one row of numbers")
    axes = [_axis(array, one, times) for array in arrays]
    rows = {array.shape[axis] for array, axis in zip(arrays, axes, strict=True)}
    if len(rows) > 1:
        raise ParameterError(f"data: the arrays have {sorted(rows)} rows; give each its own table")
    widths = [array.width(axis) for array, axis in zip(arrays, axes, strict=True)]
    labels = _shared("labels", one.labels, widths)
    units = _shared("unit", (one.unit,) if isinstance(one.unit, str) else one.unit, widths)
    return PlannedTable(
        one.name or arrays[0].name,
        [
            PlannedPart(array, axis, own or None, codes or None, one.quantity)
            for array, axis, own, codes in zip(arrays, axes, labels, units, strict=True)
        ],
        times,
        rate,
        None if one.time_unit is None else TIME_UNITS[one.time_unit],
    )


def _split(array: SourceArray, one: MapTable) -> tuple[SourceArray, SourceArray]:
    """The column of the times, and the others."""
    assert one.time_column is not None
    axis = _axis(array, one, None)
    sides = [side for side in array.long_axes if side != axis]
    if len(sides) != 1 or one.time_column >= array.shape[sides[0]]:
        shape = " x ".join(map(str, array.shape))
        raise ParameterError(f"time_column: {array.name} ({shape}) has no such column")
    return split_column(array, sides[0], one.time_column)


def _axis(array: SourceArray, one: MapTable, times: SourceArray | None) -> int:
    if array.dtype.kind not in "biuf" or array.dtype.itemsize > 8 or not array.size:
        raise ParameterError(f"data: {array.name} holds {array.dtype} values")
    if one.axis is not None:
        if one.axis >= len(array.shape):
            raise ParameterError(f"axis: {array.name} has {len(array.shape)} sides, from 0")
        return one.axis
    axes = array.long_axes
    if times is not None:
        axes = [axis for axis in axes if array.shape[axis] == times.size]
        if not axes:
            shape = " x ".join(map(str, array.shape))
            raise ParameterError(
                f"data: {array.name} is {shape}, and {times.name} has {times.size} times"
            )
    if len(axes) > 1:
        axes = [axis for axis in axes if array.shape[axis] == max(array.shape)]
    if len(axes) > 1:
        raise ParameterError(f"axis: say which side of {array.name} is time")
    return axes[0]


def _shared(key: str, texts: tuple[str, ...], widths: list[int]) -> list[list[str]]:
    """The texts of each array: one for all, or one for each channel."""
    given = [text for text in texts if text or len(texts) > 1]
    if not given:
        return [[] for _ in widths]
    if key == "unit" and len(given) == 1:
        given = given * sum(widths)
    if len(given) != sum(widths):
        raise ParameterError(f"{key}: {len(given)} for {sum(widths)} channels; give one for each")
    places = np.cumsum([0, *widths])
    return [given[a:b] for a, b in zip(places, places[1:], strict=False)]
