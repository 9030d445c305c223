"""What haptic effects in JSON share: curves through keyframes, sampled on ticks, and checked texts.

A curve is kept as what it is, an envelope. Nothing here makes the vibration that a device would
play from it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from math import ceil, floor, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, ParameterError
from ..limits import TICK_LIMIT
from ..numbers import exact
from ..recording import Channel, Event, spans_at
from .common import exact_doubles, read_bytes, refusing, selected
from .formats import ReadOptions, Source
from .tables import Import, ImportBlock, ImportColumn, ImportTable

_TEXT_LIMIT = 1 << 26
_AMPLIFIED = 64
"""Bytes in memory of one byte of JSON, at most about."""
_ROWS = 1 << 16
_LONGEST_S = 10**7
FRAMES_LIMIT = 1 << 18
"""Keyframes of a file."""
_FLOAT32 = 2.0**-24
"""Relative, what readers with 32 bits round."""


@dataclass
class Piece:
    """Keyframes in order: seconds and values. ``stop``: where the next piece takes over."""

    times: list[Fraction]
    values: list[float]
    stop: Fraction | None = None


@dataclass
class Curve:
    label: str
    unit: str = "1"
    group: str = ""
    kind: str = ""
    pieces: list[Piece] = field(default_factory=list)


def parsed(source: Source, options: ReadOptions, title: str) -> dict[str, Any]:
    """The JSON object in a file, which is small: effects are."""
    limit = min(_TEXT_LIMIT, options.max_memory // _AMPLIFIED)
    source.stream.seek(0)
    raw = bytes(read_bytes(source.stream, limit + 1))
    if len(raw) > limit:
        raise LimitError(f"the {title} file is longer than {limit} bytes")
    try:
        with refusing(f"this is not an {title} file"):
            found = json.loads(raw.decode("utf-8-sig"))
    except RecursionError:
        raise ParameterError(f"this is not an {title} file: it is nested too deeply") from None
    if not isinstance(found, dict):
        raise ParameterError(f"this is not an {title} file: it is not an object")
    return found


def number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or abs(value) > 1e15:
        raise ParameterError(f"{what} is {_shown(value)}, not a number")
    if not isfinite(value):
        raise ParameterError(f"{what} is not finite")
    return float(value)


def whole(value: Any, what: str, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ParameterError(f"{what} is {_shown(value)}, not a whole number from {low} to {high}")
    return value


def seconds(value: Any, what: str) -> Fraction:
    found = number(value, what)
    if not 0 <= found <= _LONGEST_S:
        raise ParameterError(f"{what} is {found:g} s, not from 0 to {_LONGEST_S} s")
    return exact(found)


def text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise ParameterError(f"{what} is {_shown(value)}, not a text")
    with refusing(what):
        value.encode()  # raises for half of a surrogate
    return value


def objects(value: Any, what: str) -> list[dict[str, Any]]:
    if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
        raise ParameterError(f"{what} is not a list of objects")
    return value


def _shown(value: Any) -> str:
    if isinstance(value, (dict, list)):
        return "a list" if isinstance(value, list) else "an object"
    return repr(value)[:40]


def import_of(
    curves: Sequence[Curve],
    rate: Fraction,
    options: ReadOptions,
    events: Sequence[Event],
    metadata: dict[str, Any],
    notes: Sequence[str],
) -> Import:
    """One table for each curve, at ``rate`` unless the caller gives one. Ticks between the pieces
    of a curve are gaps."""
    kept = [curves[at] for at in selected([c.label for c in curves], options.select, "curve")]
    rate = options.rate or rate
    tables, parts = [], []
    left = options.max_memory // 2
    for curve in kept:
        ranges = [_ticks(piece, rate) for piece in curve.pieces]
        rows = sum(stop - start for start, stop in ranges)
        left -= 16 * rows
        if left < 0:
            raise LimitError("the curves take more samples than allowed (max_memory=, rate=)")
        ticks = np.concatenate([np.arange(*each) for each in ranges] or [np.empty(0, np.int64)])
        plain = len(spans_at(ticks)) <= 1
        start = int(ticks[0]) if plain and ticks.size else 0
        column = ImportColumn(curve.label, curve.unit, group=curve.group)
        tables.append(
            ImportTable(
                curve.label, (column,), rate, rows, None if plain else ticks, start, curve.kind
            )
        )
        parts.append([*zip(curve.pieces, ranges, strict=True)])
    return Import(
        tuple(tables),
        partial(_blocks, parts, rate),
        metadata=metadata,
        events=tuple(sorted(events, key=lambda event: event.time)),
        notes=tuple(dict.fromkeys(notes)),
    )


def _ticks(piece: Piece, rate: Fraction) -> tuple[int, int]:
    """First tick, and the one after the last."""
    start, stop = ceil(piece.times[0] * rate), floor(piece.times[-1] * rate) + 1
    if piece.stop is not None:
        stop = min(stop, ceil(piece.stop * rate))
    if stop >= TICK_LIMIT:
        raise LimitError("a curve has keyframes beyond 2^48 ticks")
    return start, max(start, stop)


def _blocks(
    parts: Sequence[Sequence[tuple[Piece, tuple[int, int]]]], rate: Fraction
) -> Iterator[ImportBlock]:
    for table, pieces in enumerate(parts):
        row = 0
        for piece, (start, stop) in pieces:
            places = np.array([float(time * rate) for time in piece.times])
            values = np.array(piece.values)
            for first in range(start, stop, _ROWS):
                x = np.interp(np.arange(first, min(first + _ROWS, stop)), places, values)
                yield ImportBlock(table, row, [x])
                row += x.size


def ordered(pieces: list[Piece]) -> list[Piece]:
    """By their starts; each ends where the next one begins."""
    pieces = sorted(pieces, key=lambda piece: piece.times[0])
    for piece, after in zip(pieces, pieces[1:], strict=False):
        piece.stop = after.times[0]
    return pieces


def keyframes(x: NDArray[np.float64], tolerance: float) -> list[int]:
    """Places of samples, first and last included, such that straight lines between them lie within
    ``tolerance`` of all others."""
    values = x.tolist()
    if len(values) < 3:
        return [*range(len(values))]
    kept, origin, low, high = [0], 0, -float("inf"), float("inf")
    for place in range(1, len(values)):
        far = place - origin
        slope = (values[place] - values[origin]) / far
        if not low <= slope <= high:
            origin, far = place - 1, 1
            kept.append(origin)
            low, high = -float("inf"), float("inf")
            slope = values[place] - values[origin]
        low = max(low, slope - tolerance / far)
        high = min(high, slope + tolerance / far)
    return [*kept, len(values) - 1]


def rounding(channel: Channel, notes: list[str]) -> tuple[NDArray[np.float64], float]:
    """Its physical values, and how far straight lines may lie from them, which is noted."""
    if channel.exact is not None:
        values = channel.exact
    elif channel.calibration is not None:
        values = channel.calibration.physical(channel.stored)
    else:
        values = exact_doubles(channel.stored, f"channel {channel.label!r}")
    if not np.isfinite(values).all():
        raise ParameterError(f"channel {channel.label!r} holds infinities or NaN; use .npz")
    step = abs(float(channel.calibration.step)) if channel.calibration is not None else 0.0
    tolerance = max(step, float(np.abs(values).max(initial=0.0)) * _FLOAT32)
    if tolerance:
        unit = "" if channel.unit == "1" else f" {channel.unit}"
        notes.append(
            f"the values of channel {channel.label!r} are rounded to straight lines, at most "
            f"{tolerance * 1.01:.3g}{unit} off"
        )
    return values, tolerance


def check_frames(count: int, channel: Channel, suffix: str) -> None:
    """LimitError where a file would hold more keyframes than effects have."""
    if count > FRAMES_LIMIT:
        raise LimitError(
            f"{suffix} is for slow curves, and the channels up to {channel.label!r} need more "
            f"than {FRAMES_LIMIT} keyframes; write the slow band (--band lf), or use .npz"
        )
