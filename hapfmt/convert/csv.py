""".csv <-> Recording: a header row ``name [unit]``, a time column ``t [s]``, one row per tick."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterable, Iterator
from fractions import Fraction
from io import TextIOWrapper
from math import inf, isinf, nan
from typing import BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from ..recording import Channel, Recording
from ..units import to_ucum
from .common import (
    CHANNEL_LIMIT,
    dense_doubles,
    extent,
    not_carried,
    one_rate,
    unit_of,
    with_notes,
)
from .times import Grid, Stamps, spans_at

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf|infinity)", re.A | re.I)
_TIME_UNITS = {"s": 0, "sec": 0, "ms": -3, "us": -6, "\u00b5s": -6, "\u03bcs": -6, "ns": -9}
"""Powers of ten, s."""
_TIME_UNIT = "|".join(_TIME_UNITS)
_TIME = re.compile(
    r"(?:t|(?i:times?|time ?stamps?))"
    rf"(?: ?\[({_TIME_UNIT})\]| ?\(({_TIME_UNIT})\)|[ _]({_TIME_UNIT}))?"
)
_DELIMITERS = "\t;,"
"""Where two are equally frequent in the header, the first of them is not likely to be in a name."""
_LINE_LIMIT = 1 << 24
"""Characters of a line: 65 534 channels of 25 digits take a tenth of it."""
_DECIMALS_LIMIT = 18
"""Decimals of a time that is written exactly; 1 / 2**18 Hz needs as many."""
_ROWS_AT_ONCE = 1 << 12


class _Lines:
    """The lines of a stream without comments, counted, each as :mod:`csv` wants it."""

    def __init__(self, stream: BinaryIO) -> None:
        self._text = TextIOWrapper(stream, encoding="utf-8-sig", newline="")
        self.number = 0
        self.comments = 0
        self.is_plain = True

    def __iter__(self) -> Iterator[str]:
        while line := self._next():
            if line.startswith("#"):
                self.comments += 1
                continue
            # float() would take 1_000 and digits of other scripts.
            self.is_plain = line.isascii() and "_" not in line
            yield line

    def _next(self) -> str:
        self.number += 1
        try:
            line = self._text.readline(_LINE_LIMIT)
        except UnicodeDecodeError as error:
            raise ParameterError(
                f"after line {self.number - 1}: no UTF-8 text ({error.reason})"
            ) from error
        if len(line) == _LINE_LIMIT and not line.endswith(("\r", "\n")):
            raise ParameterError(f"line {self.number} is longer than {_LINE_LIMIT} characters")
        return line

    def release(self) -> None:
        """Leave the stream open; it is the caller's."""
        self._text.detach()


def read(stream: BinaryIO, *, rate: Fraction | None, max_memory: int) -> Recording:
    """Empty cells, "nan" and rows that a regular time column leaves out are gaps.

    The delimiter is the most frequent of tab, semicolon and comma in the header; lines that begin
    with # are comments; a first column t, time, "time [ms]" ... holds times.
    """
    lines = _Lines(stream)
    try:
        return _Table(lines, max_memory).recording(rate)
    except csv.Error as error:
        raise ParameterError(f"line {lines.number}: {error}") from error
    finally:
        lines.release()


class _Table:
    """A table being read: its columns, then its rows."""

    def __init__(self, lines: _Lines, max_memory: int) -> None:
        self._lines = lines
        self._rows_left = iter(lines)
        self._max_memory = max_memory
        header = next((line for line in self._rows_left if line.strip()), None)
        if header is None:
            raise ParameterError("no header row 'name [unit]'; the table is empty")
        outside_quotes = re.sub(r'"[^"]*"', "", header)
        self._delimiter = max(_DELIMITERS, key=outside_quotes.count)
        self._names = [cell.strip() for cell in next(self._reader([header]))]
        if all(_NUMBER.fullmatch(name) or not name for name in self._names):
            self._refuse("the first row holds numbers; a header row 'name [unit]' is expected")
        if len(self._names) > CHANNEL_LIMIT:
            self._refuse(f"{len(self._names)} columns, more than {CHANNEL_LIMIT}")
        self._stamps = self._time_column()
        self._values = array("d")

    def recording(self, rate: Fraction | None) -> Recording:
        first = 0 if self._stamps is None else 1
        columns = len(self._names) - first
        if not columns:
            raise ParameterError("a time column but no channel")
        self._read_rows(first)
        x = np.frombuffer(self._values) if self._values else np.empty(0)
        grid = self._grid(x.size // columns, rate)
        notes = list(grid.notes)
        if self._lines.comments:
            notes.append(f"comment lines not carried over: {self._lines.comments}")
        channels = tuple(
            _channel(name, column, grid, notes)
            for name, column in zip(self._names[first:], x.reshape(-1, columns).T, strict=True)
        )
        return Recording(channels, metadata=with_notes({}, notes))

    def _grid(self, rows: int, rate: Fraction | None) -> Grid:
        if self._stamps is not None:
            return self._stamps.grid(rate)
        if rate is None:
            raise ParameterError("no first column 't [s]' and no rate; give one (--rate)")
        return Grid(rate, np.arange(rows), ())

    def _reader(self, lines: Iterable[str]) -> Iterator[list[str]]:
        return csv.reader(lines, delimiter=self._delimiter, skipinitialspace=True, strict=True)

    def _time_column(self) -> Stamps | None:
        match = _TIME.fullmatch(self._names[0])
        if match is None:
            return None
        return Stamps(_TIME_UNITS[match[match.lastindex] if match.lastindex else "s"])

    def _read_rows(self, first: int) -> None:
        """Fill the stamps and the values, row after row."""
        width = len(self._names)
        for cells in self._reader(self._rows_left):
            row = cells or [""]
            # An empty line is no row, except in a single column, where it is an empty cell. Empty
            # cells are a row of gaps, except where their time would have to be known.
            if not any(row) and (len(row) < width or self._stamps is not None):
                continue
            if len(row) != width:
                self._refuse(f"a row of {len(row)} cells, where the header has {width}")
            if self._stamps is not None:
                self._add_time(self._stamps, row[0].strip())
            self._values.extend(self._row_values(row[first:], first))
            if 8 * len(self._values) > self._max_memory:
                self._refuse(f"the values so far take more than {self._max_memory} bytes")

    def _row_values(self, row: list[str], first: int) -> list[float]:
        if self._lines.is_plain:
            try:
                values = list(map(float, row))
            except ValueError:
                pass
            else:
                # 1e999 becomes infinite silently, "inf" is a value: look at the cells.
                if inf not in values and -inf not in values:
                    return values
        return [self._value(cell.strip(), first + index) for index, cell in enumerate(row)]

    def _value(self, cell: str, column: int) -> float:
        if not cell:
            return nan
        if _NUMBER.fullmatch(cell) is None:
            hint = " (a decimal point is expected)" * ("," in cell)
            self._refuse(f"{cell[:40]!r} is not a number{hint}", column)
        value = float(cell)
        if isinf(value) and "inf" not in cell.lower():
            self._refuse(f"{cell[:40]!r} is beyond the range of a double", column)
        return value

    def _add_time(self, stamps: Stamps, cell: str) -> None:
        if _NUMBER.fullmatch(cell) is None:
            self._refuse(f"{cell[:40]!r} is not a time; a number is expected", 0)
        try:
            stamps.add(cell)
        except ValueError as error:
            self._refuse(f"{cell[:40]!r} {error}", 0)

    def _refuse(self, message: str, column: int | None = None) -> NoReturn:
        place = f"line {self._lines.number}"
        if column is not None:
            place += f", column {column + 1} ({self._names[column][:40]!r})"
        raise ParameterError(f"{place}: {message}")


def _channel(name: str, column: NDArray[np.float64], grid: Grid, notes: list[str]) -> Channel:
    label, unit = _split_name(name)
    known = ~np.isnan(column)
    return Channel(
        column[known],
        grid.rate,
        spans_at(grid.ticks[known]),
        label=label,
        unit=unit_of(unit, label, notes),
    )


def _split_name(name: str) -> tuple[str, str]:
    """'force [N]' -> 'force', 'N'. A label may hold brackets itself; a code holds no space."""
    if not name.endswith("]"):
        return name, ""
    match = re.fullmatch(r"(.*) \[(.*?)\]", f" {name}", re.DOTALL)
    match = match or re.fullmatch(r"(.*)\[([^][]*)\]", name, re.DOTALL)
    return (match[1].strip(), match[2]) if match is not None else (name, "")


def write(recording: Recording, stream: BinaryIO, *, max_memory: int) -> list[str]:
    """Physical values in the shortest decimals that give the same bits; a gap is an empty cell."""
    rate = one_rate(recording, ".csv")
    start, stop = extent(recording.channels)
    header = [column_name(channel.label, channel.unit) for channel in recording.channels]
    x = dense_doubles(recording.channels, max_memory)
    text = TextIOWrapper(stream, encoding="utf-8", newline="")
    stamps = Stamps()
    try:
        text.write(",".join(["t [s]", *header]) + "\n")
        rows = csv.writer(text, lineterminator="\n")
        for first in range(start, stop, _ROWS_AT_ONCE):
            times = tick_times(first, min(first + _ROWS_AT_ONCE, stop), rate)
            for time in times:
                stamps.add(time)
            block = x[:, first - start : first - start + len(times)]
            rows.writerows(zip(times, *map(_cells_of, block), strict=True))
    except UnicodeEncodeError as error:
        raise ParameterError(f"a label cannot be written as UTF-8: {error.reason}") from error
    finally:
        text.detach()
    notes = []
    if not _told_by(stamps, rate, start):
        notes.append(f"the times do not tell the rate, {rate} Hz, and the start, tick {start}")
    if any(channel.label != channel.label.strip() for channel in recording.channels):
        notes.append("spaces around labels are not carried over to .csv")
    return notes + not_carried(recording, ".csv", "unit", "label")


def column_name(label: str, unit: str) -> str:
    """The cell of the header, quoted where a reader could stumble over it."""
    name = f"{label.strip()} [{to_ucum(unit)}]"
    if "\n" in name or "\r" in name:
        raise ParameterError(f"the label {label!r} has a line break, which .csv cannot hold")
    if name[0] not in " #" and not re.search(r'[",;\t]', name):
        return name
    return '"' + name.replace('"', '""') + '"'


def _cells_of(x: NDArray[np.float64]) -> list[float | None]:
    """:mod:`csv` writes a float by repr, and None as nothing."""
    return [None if value != value else value for value in x.tolist()]  # noqa: PLR0124


def tick_times(first: int, stop: int, rate: Fraction) -> list[str]:
    """Ticks in seconds, as exact decimals if there are such, otherwise as the nearest doubles."""
    period = 1 / rate
    decimals = 0
    while (10**decimals * period).denominator != 1:
        decimals += 1
        if decimals > _DECIMALS_LIMIT:
            up, down = period.numerator, period.denominator
            return [repr(tick * up / down) for tick in range(first, stop)]
    scaled = int(10**decimals * period)
    if not decimals:
        return [str(tick * scaled) for tick in range(first, stop)]
    digits = (str(tick * scaled).zfill(decimals + 1) for tick in range(first, stop))
    return [f"{text[:-decimals]}.{text[-decimals:]}" for text in digits]


def _told_by(stamps: Stamps, rate: Fraction, start: int) -> bool:
    try:
        grid = stamps.grid()
    except ParameterError:
        return False
    return grid.rate == rate and int(grid.ticks[0]) == start
