"""``scan_hapf``: a file as a LazyFrame of Polars, which reads the columns and seconds of a query.

Polars hands over the columns and the condition of a query. Bounds of the column "time" become the
seconds that are read. The whole condition is then applied to the rows that came.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from ..errors import MissingExtraError, ParameterError
from ..numbers import counted
from ..recording import column_names, gap_mask, seconds_of
from .files import (
    check_channels,
    extents_of,
    open_reader,
    read_ticks,
    unchanged,
    version_of,
)

BATCH = 1 << 18
"""Ticks that are read at once, 2 MiB for each column."""
FARTHEST = 1 << 53


class Interval(NamedTuple):
    """Seconds from low to high; both ends may belong to it."""

    low: float = -math.inf
    high: float = math.inf


def scan_hapf(
    file: str | os.PathLike[str], channels: Sequence[str | int] | str | int | None = None
) -> Any:
    """A polars.LazyFrame of channels of one rate: "time" in seconds, and a column for each channel.

    A row is a tick; gaps are null. A query decodes only the columns and the seconds that it needs.
    ``channels`` are labels, numbers or patterns, as in :func:`hapfmt.read`. The file may be a URL.
    Needs the extra "polars". Raises ParameterError where the channels differ in rate.
    """
    try:
        import polars
        from polars.io.plugins import register_io_source
    except ImportError:
        raise MissingExtraError("polars", "polars") from None
    path = os.fspath(file)
    with open_reader(path) as reader:
        refs = reader.select(channels)
        rates = dict.fromkeys(ref.track.rate for ref in refs)
        if len(rates) > 1:
            listed = ", ".join(f"{float(rate):.6g} Hz" for rate in rates)
            raise ParameterError(
                f"the channels have {counted(len(rates), 'rate')} ({listed}); name those of one "
                "rate: scan_hapf(file, ['fx', 'fy'])"
            )
        check_channels(reader, refs)
        version = version_of(reader)
        first, last = next(iter(extents_of(reader.catalogue, refs).values()), (0, 0))
    rate = next(iter(rates), Fraction(1))
    names = ["time", *column_names([ref.label for ref in refs])]
    numbers = dict(zip(names[1:], (ref.number for ref in refs), strict=True))

    def batches(
        wanted: list[str] | None, predicate: Any, row_count: int | None, size: int | None
    ) -> Iterator[Any]:
        columns = names if wanted is None else wanted
        used = {*columns, *(predicate.meta.root_names() if predicate is not None else ())}
        decoded = [name for name in names[1:] if name in used]
        seconds = Interval() if predicate is None else bounds(predicate)
        start, stop = ticks_of(seconds, rate, first, last)
        left = math.inf if row_count is None else row_count
        at_once = BATCH if row_count is None or predicate is not None else max(row_count, 1)
        at_once = min(at_once, size or BATCH, BATCH)
        with open_reader(path) as reader:
            chosen = [reader.by_number()[numbers[name]] for name in decoded]
            for low in range(start, stop, at_once):
                high = min(low + at_once, stop)
                if left <= 0:
                    return
                table: dict[str, Any] = {}
                if "time" in used or not decoded:
                    table["time"] = seconds_of(low, high, rate)
                with unchanged(reader, version):
                    parts = read_ticks(reader, chosen, low, high) if chosen else []
                for name, part in zip(decoded, parts, strict=True):
                    column = polars.Series(name, part.filled(low, high))
                    if part.stored.size < high - low:
                        column = column.set(polars.Series(gap_mask(part, low, high)), None)
                    table[name] = column
                frame = polars.DataFrame(table)
                if predicate is not None:
                    frame = frame.filter(predicate)
                frame = frame.select(columns)
                if left < frame.height:
                    frame = frame.head(int(left))
                left -= frame.height
                yield frame

    return register_io_source(batches, schema=dict.fromkeys(names, polars.Float64))


def ticks_of(seconds: Interval, rate: Fraction, first: int, last: int) -> tuple[int, int]:
    """The ticks within [first, last) whose times may be in the interval, and few more."""
    low, high = seconds
    if math.isfinite(low):
        first = max(first, math.floor(Fraction(low) * rate) - _slack(low, rate))
    elif low > 0:
        first = last
    if math.isfinite(high):
        last = min(last, math.ceil(Fraction(high) * rate) + 1 + _slack(high, rate))
    elif high < 0:
        last = first
    return first, max(last, first)


def _slack(seconds: float, rate: Fraction) -> int:
    """Ticks by which rounding may move a time."""
    return 1 + math.ceil(abs(Fraction(np.spacing(seconds).item()) * rate))


def bounds(predicate: Any) -> Interval:
    """Seconds outside of which the condition holds for no row."""
    try:
        found = json.loads(predicate.meta.serialize(format="json"))
    except Exception:  # A condition that Polars cannot write as JSON.
        return Interval()
    return _bounds(found)


def _bounds(node: Any) -> Interval:
    match node:
        case {"BinaryExpr": {"left": left, "op": "And", "right": right}}:
            a, b = _bounds(left), _bounds(right)
            return Interval(max(a.low, b.low), min(a.high, b.high))
        case {"BinaryExpr": {"left": left, "op": "Or", "right": right}}:
            a, b = _bounds(left), _bounds(right)
            return Interval(min(a.low, b.low), max(a.high, b.high))
        case {"BinaryExpr": {"left": {"Column": "time"}, "op": op, "right": {"Literal": value}}}:
            return _compared(op, _number(value))
        case {"BinaryExpr": {"left": {"Literal": value}, "op": op, "right": {"Column": "time"}}}:
            turned = {"Lt": "Gt", "LtEq": "GtEq", "Gt": "Lt", "GtEq": "LtEq"}
            return _compared(turned.get(op, op), _number(value))
        case {
            "Function": {
                "input": [{"Column": "time"}, {"Literal": low}, {"Literal": high}],
                "function": {"Boolean": {"IsBetween": _}},
            }
        }:
            least, most = _number(low), _number(high)
            return Interval(
                -math.inf if least is None else least, math.inf if most is None else most
            )
    return Interval()


def _compared(op: str, value: float | None) -> Interval:
    if value is None:
        return Interval()
    match op:
        case "Lt" | "LtEq":
            return Interval(high=value)
        case "Gt" | "GtEq":
            return Interval(low=value)
        case "Eq":
            return Interval(value, value)
    return Interval()


def _number(literal: Any) -> float | None:
    """A literal that is a number; None for any other."""
    match literal:
        case {"Dyn": dict() as inner} | {"Scalar": dict() as inner}:
            ((kind, value),) = inner.items()
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            plain = kind.startswith(("Float", "Int", "UInt"))
            if is_number and plain and abs(value) < FARTHEST:  # NaN is not below either
                return float(value)
    return None
