""".csv <-> Recording: a header row ``name [unit]``, a time column ``t [s]``, one row per tick."""

from __future__ import annotations

import csv
import re
import warnings
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from io import TextIOWrapper
from math import nan
from typing import BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, MovedTimesWarning, ParameterError, channels_called
from ..numbers import DOUBLE, double, plain_doubles
from ..recording import Channel, Recording, Span, spans_at, unique
from ..spool import GrowingArray, Memory
from ..times import TIME_UNITS, TickGrid, TimeStamps, seconds_of_date, time_name
from ..units import split_name, to_ucum
from .common import (
    CHANNEL_LIMIT,
    SLICE,
    Dense,
    extent,
    not_carried,
    one_rate,
    unit_of,
    with_notes,
)
from .formats import Destination, ReadOptions, Source, WriteOptions
from .npy import rows_in, stored_samples
from .timestamps import kept_stamps

_COMMA = re.compile(r"[+-]?\d*,\d+(e[+-]?\d+)?", re.A | re.I)
"""A number with a decimal comma."""
NAMED = 4
"""Columns of the header that a message proposes."""
_DELIMITERS = "\t;,"
"""Where two are equally frequent in the header, the first of them is not likely to be in a name."""
_LINE_LIMIT = 1 << 24
"""Characters of a line: 65 534 channels of 25 digits take a tenth of it."""
_DECIMALS_LIMIT = 18
"""Decimals of a time that is written exactly; 1 / 2**18 Hz needs as many."""
_GAP_ROWS = 1_000_000
"""Most rows without any sample that are written. Where there are more, the time column shows
them."""
_EVENLY = 8
"""Fewer rows may rise by chance."""
_MILLISECONDS = 1e11
"""Times from here on, in a column that names no unit, are milliseconds or less since 1970."""


_SPACES = (
    "the cells are separated by spaces; hapfmt reads commas, semicolons and tabs; "
    "numpy.loadtxt reads such a file, and hapfmt.write(array.T, ...) takes its array"
)


def _in_spaces(line: str) -> bool:
    """Whether a line without another delimiter holds several numbers."""
    cells = line[:1000].split()[:3]
    return len(cells) > 1 and all(map(DOUBLE.fullmatch, cells))


class _Lines:
    """The lines of a stream without comments, counted, each as :mod:`csv` wants it."""

    def __init__(self, stream: BinaryIO) -> None:
        self._text = TextIOWrapper(stream, encoding="utf-8-sig", newline="")
        self.number = 0
        self.comments = 0
        self.is_plain = True
        self.has_points = False

    def __iter__(self) -> Iterator[str]:
        while line := self._next():
            if line.startswith("#"):
                self.comments += 1
                continue
            # float() takes 1_000 and digits of other scripts too.
            self.is_plain = line.isascii() and "_" not in line
            self.has_points = self.has_points or (self.number > 1 and "." in line)
            yield line

    def _next(self) -> str:
        self.number += 1
        try:
            line = self._text.readline(_LINE_LIMIT)
        except UnicodeDecodeError as error:
            after = f"after line {self.number - 1}: " if self.number > 1 else ""
            raise ParameterError(
                f"{after}not UTF-8 text; save the table as UTF-8 "
                "(iconv -f latin1 -t utf-8 IN > OUT)"
            ) from error
        if len(line) == _LINE_LIMIT and not line.endswith(("\r", "\n")):
            raise ParameterError(f"line {self.number} is longer than {_LINE_LIMIT} characters")
        return line

    def release(self) -> None:
        """Leave the stream open; it is the caller's."""
        self._text.detach()


def read(source: Source, options: ReadOptions) -> Recording:
    """Empty cells, "nan" and rows that a regular time column leaves out are gaps.

    The delimiter is the most frequent of tab, semicolon and comma in the header. Lines that begin
    with # are comments. A first column t, time, "time [ms]" ... holds times in seconds or that
    unit, or ISO 8601 dates. Times that count from 1970 give the epoch. Decimal commas are read
    unless the delimiter is a comma.
    """
    lines = _Lines(source.stream)
    try:
        return _Table(lines, options).recording(options.rate)
    except csv.Error as error:
        raise ParameterError(f"line {lines.number}: {error}") from error
    finally:
        lines.release()


class _Table:
    """A table being read: its columns, then its rows."""

    def __init__(self, lines: _Lines, options: ReadOptions) -> None:
        self._lines = lines
        self._rows_left = iter(lines)
        self._max_memory = options.max_memory
        self._keep_stamps = options.keep_stamps
        self._select = list(options.select)
        self._faults: dict[int, ParameterError] = {}
        """By column, what is wrong with its first bad cell; it counts if the column is selected."""
        header = next((line for line in self._rows_left if line.strip()), None)
        if header is None:
            raise ParameterError("no header row 'name [unit]'; the table is empty")
        outside_quotes = re.sub(r'"[^"]*"', "", header)
        self._delimiter = max(_DELIMITERS, key=outside_quotes.count)
        if outside_quotes.count(self._delimiter) > CHANNEL_LIMIT:
            raise ParameterError(f"line {lines.number}: more than {CHANNEL_LIMIT} columns")
        self._names = [cell.strip() for cell in next(self._reader([header]))]
        if len(self._names) == 1 and _in_spaces(self._names[0]):
            self._refuse(_SPACES)
        if all(DOUBLE.fullmatch(name) or not name for name in self._names):
            names = [f"ch{number + 1}" for number in range(len(self._names))]
            some = ", ..." if len(names) > NAMED else ""
            plain, timed = (
                repr(self._delimiter.join(each[:NAMED])) + some
                for each in (names, ["t [s]", *names[:-1]])
            )
            self._refuse(
                f"the first row holds numbers; write a header as line 1, such as {timed} if the "
                f"first column is time, or {plain} with a rate (rate=)"
            )
        # Some programs write a delimiter at the end of each row: it does not start a column.
        self._trailing = len(self._names) > 1 and not self._names[-1]
        if self._trailing:
            self._names.pop()
        if "" in self._names:
            column = self._names.index("")
            index = "; for tables of pandas: to_csv(index=False), or index_label='t [s]' for times"
            hint = "" if column else index
            self._refuse(f"the header gives this column no name{hint}", column)
        if len(self._names) > CHANNEL_LIMIT:
            self._refuse(f"{len(self._names)} columns, more than {CHANNEL_LIMIT}")
        self._stamps = self._time_column()
        self._rising = None if self._stamps is not None else self._column_in_seconds()
        self._dates = False
        self._commas = False
        self._values = array("d")
        self._store = options.store
        self._filled = GrowingArray(self._store)
        self._row_count = 0

    def recording(self, rate: Fraction | None) -> Recording:
        first = 0 if self._stamps is None else 1
        columns = len(self._names) - first
        if not columns:
            raise ParameterError("a time column but no channel")
        self._read_rows(first)
        whole = self._filled.joined()
        x = (np.empty(0) if whole is None else whole).reshape(-1, columns)
        notes: list[str] = []
        stamps, grid = self._rising, self._rising_grid(rate, notes)
        if grid is not None:
            first, x = 1, x[:, 1:]
        else:
            stamps, grid = self._stamps, self._grid(len(x), rate)
            name = self._names[0][:40]
            if stamps is None and columns > 1 and _rises_evenly(x[:, 0]):
                notes.append(
                    f"column {name!r} looks like time, but was read as a channel; if it is time, "
                    f"write its unit in the header, as '{split_name(name)[0]} [s]'"
                )
        notes += grid.notes
        for note in grid.notes:
            warnings.warn(note, MovedTimesWarning, stacklevel=5)
        if self._lines.comments:
            notes.append(f"comment lines not carried over: {self._lines.comments}")
        named = [split_name(name) for name in self._names[first:]]
        kept = () if stamps is None or stamps.ns is None else (kept_stamps(stamps.ns, grid),)
        names = [*(label for label, _ in named), *(channel.label for channel in kept)]
        labels = unique(names, notes)
        if self._faults:
            for number in channels_called(self._select, dict(enumerate(labels))):
                if first + number in self._faults:
                    raise self._faults[first + number]
        channels = tuple(
            _channel(label, unit, column, grid, notes, self._store)
            for label, (_, unit), column in zip(
                labels, named, rows_in(x.T, "the table", self._store), strict=False
            )
        ) + tuple(replace(channel, label=labels[-1]) for channel in kept)
        return Recording(channels, metadata=with_notes({}, notes), epoch_ns=grid.epoch_ns)

    def _grid(self, rows: int, rate: Fraction | None) -> TickGrid:
        if self._stamps is not None:
            if self._unit_missing and len(self._stamps) and self._stamps.first >= _MILLISECONDS:
                raise ParameterError(
                    f"the times begin at {float(self._stamps.first):.15g}, which are no seconds "
                    f"since 1970; name the unit in the header, as {self._names[0]!r} + ' [ms]'"
                )
            return self._stamps.grid(rate)
        if self._keep_stamps:
            raise ParameterError("no first column 't [s]', so there are no time stamps to keep")
        if rate is None:
            name = self._names[0][:40]
            raise ParameterError(
                f"no first column 't [s]' and no rate. If {name!r} holds times, call it 't', "
                f"'time' or 'timestamp', or name its unit, as '{split_name(name)[0]} [ms]'; "
                "otherwise give a rate (rate=)"
            )
        return TickGrid(rate, np.arange(rows), ())

    def _reader(self, lines: Iterable[str]) -> Iterator[list[str]]:
        return csv.reader(lines, delimiter=self._delimiter, skipinitialspace=True, strict=True)

    def _time_column(self) -> TimeStamps | None:
        named = time_name(self._names[0])
        self._unit_missing = named is not None and named.unit is None
        return None if named is None else TimeStamps(named.exponent, keep=self._keep_stamps)

    def _column_in_seconds(self) -> TimeStamps | None:
        """A first column of another name with a unit of time: times, if they rise in every row."""
        unit = split_name(self._names[0])[1]
        if unit not in TIME_UNITS or len(self._names) < 2:
            return None
        return TimeStamps(TIME_UNITS[unit], keep=self._keep_stamps)

    def _add_rising(self, cell: str) -> None:
        assert self._rising is not None
        if self._commas:
            cell = cell.replace(",", ".")
        try:
            if DOUBLE.fullmatch(cell) is None:
                raise ValueError
            self._rising.add(cell)
        except ValueError:
            self._rising = None

    def _rising_grid(self, rate: Fraction | None, notes: list[str]) -> TickGrid | None:
        if self._rising is None or len(self._rising) < 2:
            return None
        try:
            grid = self._rising.grid(rate)
        except ParameterError:
            if rate is None:
                raise
            return None  # a channel that rises, at the rate that was given
        notes.append(f"{self._names[0]!r} is taken for the time: its values rise in every row")
        return grid

    def _read_rows(self, first: int) -> None:
        """Fill the stamps and the values, row after row."""
        width = len(self._names)
        for cells in self._reader(self._rows_left):
            row = cells or [""]
            if self._trailing and len(row) == width + 1:
                if row[-1].strip():
                    self._refuse("a value in a column that the header gives no name")
                row.pop()
            # An empty line is skipped, except in a single column, where it is an empty cell. Empty
            # cells are a row of gaps, except where their time would have to be known.
            if not any(row) and (len(row) < width or self._stamps is not None):
                continue
            if len(row) != width:
                hint = ""
                if self._delimiter == "," and len(row) > width:
                    hint = "; if commas are decimal signs, put semicolons between the cells"
                self._refuse(f"a row of {len(row)} cells, where the header has {width}{hint}")
            if not self._row_count:
                self._refuse_units([cell.strip() for cell in row])
            if self._stamps is not None:
                self._add_time(self._stamps, row[0].strip())
            self._values.extend(self._row_values(row[first:], first))
            if self._rising is not None:
                self._add_rising(row[0].strip())
            self._row_count += 1
            if len(self._values) >= SLICE:
                self._fill()
            if 8 * (width - first) * self._row_count > self._max_memory:
                raise LimitError(
                    f"line {self._lines.number}: the values so far take more than "
                    f"{self._max_memory} bytes; allow more (max_memory=)"
                )

        self._fill()

    def _fill(self) -> None:
        if self._values:
            self._filled.append(np.frombuffer(self._values))
            self._values = array("d")

    def _refuse_units(self, row: list[str]) -> None:
        """A first row of texts, some of which are units."""
        texts = [cell for cell in row if cell]
        if any(DOUBLE.fullmatch(cell) or seconds_of_date(cell) for cell in texts):
            return
        codes = [to_ucum(cell) for cell in row]
        units = [place for place, code in enumerate(codes) if code != "1" and "{" not in code]
        if units:
            name, unit = self._names[units[0]], row[units[0]].strip("[]()")
            self._refuse(
                f"this looks like a row of units; write them in the header: '{name} [{unit}]'"
            )

    def _row_values(self, row: list[str], first: int) -> list[float]:
        if self._lines.is_plain and not self._commas:
            values = plain_doubles(row)
            if values is not None:
                return values
        return [self._value(cell.strip(), first + index) for index, cell in enumerate(row)]

    def _value(self, cell: str, column: int) -> float:
        if not cell or column in self._faults:
            return nan
        try:
            return self._number(cell, column)
        except ParameterError as error:
            if not self._select:
                raise
            self._faults[column] = error
            return nan

    def _number(self, cell: str, column: int) -> float:
        cell = self._with_point(cell, column)
        try:
            return double(cell)
        except ParameterError as error:
            hint = ""
            if DOUBLE.fullmatch(cell) is None:
                if len(self._names) == 1 and _in_spaces(cell):
                    self._refuse(_SPACES)
                others = len(self._names) - 1 - (self._stamps is not None)
                if others and not self._select:
                    hint = "; leave the column out: name the others (select=)"
            self._refuse(error.message + hint, column)

    def _with_point(self, cell: str, column: int) -> str:
        """A number with a decimal comma, where all of the table has one."""
        if "," in cell:
            if _COMMA.fullmatch(cell) is None or (self._lines.has_points and not self._dates):
                self._refuse(
                    f"{cell[:40]!r} is not a number; write 1.5, or 1,5 in the whole table", column
                )
            self._commas = True
            return cell.replace(",", ".")
        if self._commas and "." in cell:
            self._refuse(f"{cell[:40]!r} has a point where the table has decimal commas", column)
        return cell

    def _add_time(self, stamps: TimeStamps, cell: str) -> None:
        if not len(stamps):
            self._dates = seconds_of_date(cell) is not None
            if self._dates and not self._unit_missing:
                self._refuse(f"{cell[:40]!r} is a date, and the column has a unit", 0)
        if self._dates:
            cell = seconds_of_date(cell) or self._refuse(f"{cell[:40]!r} is not a date", 0)
        else:
            cell = self._with_point(cell, 0)
        if DOUBLE.fullmatch(cell) is None:
            self._refuse(
                f"{cell[:40]!r} is not a time; write seconds, or 2026-11-22T17:05:00.25Z", 0
            )
        try:
            stamps.add(cell)
        except ValueError as error:
            self._refuse(f"{cell[:40]!r} {error}", 0)

    def _refuse(self, message: str, column: int | None = None) -> NoReturn:
        place = f"line {self._lines.number}"
        if column is not None:
            place += f", column {column + 1} ({self._names[column][:40]!r})"
        raise ParameterError(f"{place}: {message}")


def _rises_evenly(x: NDArray[np.float64]) -> bool:
    with np.errstate(all="ignore"):
        steps = np.diff(x)
        return bool(
            x.size > _EVENLY and steps[0] > 0 and (np.abs(steps / np.median(steps) - 1) < 0.5).all()
        )


def _channel(
    label: str,
    unit: str,
    column: NDArray[np.float64],
    grid: TickGrid,
    notes: list[str],
    store: Memory,
) -> Channel:
    values, known = stored_samples(column, store)
    return Channel(
        values,
        grid.rate,
        spans_at(grid.ticks[known]),
        label=label,
        unit=unit_of(unit, label, notes),
    )


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Physical values in the shortest decimals that give the same bits; a gap is an empty cell.

    Where more than ``_GAP_ROWS`` rows, and more than half, would hold no sample, those rows are
    left out: the time column tells of them.
    """
    rate = one_rate(recording, ".csv")
    header = [column_name(channel.label, channel.unit) for channel in recording.channels]
    parts, left_out = _parts(recording, options.max_memory)
    text = TextIOWrapper(target.stream, encoding="utf-8", newline="")
    stamps = TimeStamps()
    try:
        text.write(",".join(["t [s]", *header]) + "\n")
        rows = csv.writer(text, lineterminator="\n")
        for first, block in parts:
            times = tick_times(first, first + block.shape[1], rate)
            for time in times:
                stamps.add(time)
            rows.writerows(zip(times, *map(_cells_of, block), strict=True))
    except UnicodeEncodeError as error:
        raise ParameterError(f"a label cannot be written as UTF-8: {error.reason}") from error
    finally:
        text.detach()
    notes = []
    if left_out:
        notes.append(f"{left_out} rows without any sample were left out; the times tell of them")
    start, _ = extent(recording.channels)
    if not recording.sample_count:
        notes.append("no samples: a .csv without rows holds neither rate nor start")
    elif not _told_by(stamps, rate, start):
        notes.append(
            "the times are too few or too coarse to give "
            f"the rate, {rate} Hz, and the start, tick {start}"
        )
    if any(channel.label != channel.label.strip() for channel in recording.channels):
        notes.append("spaces around labels are not carried over to .csv")
    return notes + not_carried(recording, ".csv", "unit", "label")


def _parts(
    recording: Recording, max_memory: int
) -> tuple[Iterator[tuple[int, NDArray[np.float64]]], int]:
    """The first tick and [channels, ticks] values of slices, and the rows that are left out."""
    channels = recording.channels
    ends = sorted(span for channel in channels for span in channel.coverage)
    spans: list[Span] = []  # where any channel has samples
    for span in ends:
        if spans and span.start <= spans[-1].stop:
            spans[-1] = Span(spans[-1].start, max(spans[-1].stop, span.stop))
        else:
            spans.append(span)
    start, stop = extent(channels)
    rows = sum(span.ticks for span in spans)
    left_out = stop - start - rows
    if left_out <= max(_GAP_ROWS, rows):
        spans, left_out = [Span(start, stop)], 0
    cells = len(channels) * (stop - start - left_out) - recording.sample_count
    if 8 * cells > max_memory:
        raise LimitError(
            f"the gaps take {cells} empty cells in .csv, more than the {max_memory // 8} allowed; "
            "allow more (max_memory=) or write a part"
        )
    dense = Dense(channels, ".csv", 1 << 62)
    at_once = max(SLICE // len(channels), 1)
    return (
        (first, dense.block(first, min(first + at_once, span.stop)))
        for span in spans
        for first in range(span.start, span.stop, at_once)
    ), left_out


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


def _told_by(stamps: TimeStamps, rate: Fraction, start: int) -> bool:
    try:
        grid = stamps.grid()
    except ParameterError:
        return False
    return grid.rate == rate and int(grid.ticks[0]) == start
