"""Messages of JSON -> their numbers and texts, by path: {"force": {"x": 1}} has force.x."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError

MAX_DEPTH = 32
_LARGEST = 1 << 63
_ITEM_LIMIT = 4096
"""Members of an array that become paths."""


class JsonNumber(NamedTuple):
    dtype: np.dtype[Any]
    length: int | None = None
    owners: Sequence[tuple[str, str]] = ()
    is_time: bool = False


@dataclass
class JsonMessages:
    rows: NDArray[np.intp]
    numbers: Mapping[str, JsonNumber]
    texts: Mapping[str, list[str | None]]
    found: Mapping[str, list[Any]]

    def values(self, path: str) -> NDArray[Any]:
        column = self.found[path]
        dtype = self.numbers[path].dtype
        if dtype.kind == "f":
            return np.array([np.nan if x is None else x for x in column], np.float64)
        return np.array(column, dtype)

    def text(self, path: str, row: int) -> str:
        return self.texts[path][row] or ""

    def is_constant(self, path: str) -> bool:
        column = self.texts[path]
        return column.count(column[0]) == len(column)


class JsonDecoder:
    def parts(self, messages: Sequence[bytes]) -> Iterator[JsonMessages]:
        found: dict[str, list[Any]] = {}
        texts: dict[str, list[str | None]] = {}
        for row, data in enumerate(messages):
            try:
                message = json.loads(data)
            except (ValueError, RecursionError) as error:
                raise ParameterError(f"a message is not JSON: {error}") from error
            if not isinstance(message, dict):
                raise ParameterError("a message of JSON is not an object")
            for path, value in _leaves(message, "", 0):
                columns: dict[str, list[Any]] = texts if isinstance(value, str) else found
                column = columns.setdefault(path, [])
                if len(column) <= row:
                    column.extend([None] * (row - len(column)))
                    column.append(value)
        for column in (*found.values(), *texts.values()):
            column.extend([None] * (len(messages) - len(column)))
        numbers = {path: _number(column) for path, column in found.items()}
        yield JsonMessages(np.arange(len(messages)), numbers, texts, found)


def _leaves(value: Any, path: str, depth: int) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        if depth > MAX_DEPTH:
            raise ParameterError("a message of JSON is nested too deeply")
        time = _time_ns(value)
        if time is not None:
            yield path, time
            return
        for name, each in value.items():
            yield from _leaves(each, f"{path}.{name}" if path else name, depth + 1)
    elif isinstance(value, list):
        if depth > MAX_DEPTH or len(value) > _ITEM_LIMIT:
            raise ParameterError(f"an array of JSON has more than {_ITEM_LIMIT} members")
        for place, each in enumerate(value):
            yield from _leaves(each, f"{path}[{place}]", depth + 1)
    elif isinstance(value, (bool, int, float, str)):
        yield path, value


class TimeNs(int):
    """Nanoseconds of {"sec": s, "nsec": ns}."""


def _time_ns(value: Mapping[str, Any]) -> TimeNs | None:
    if len(value) != 2 or "sec" not in value:
        return None
    seconds, rest = value["sec"], value.get("nsec", value.get("nanosec"))
    if type(seconds) is not int or type(rest) is not int:
        return None
    return TimeNs(seconds * 10**9 + rest)


def _number(column: Sequence[Any]) -> JsonNumber:
    """Integers stay integers where all messages have one."""
    kinds = {type(value) for value in column}
    if kinds == {bool}:
        return JsonNumber(np.dtype(np.uint8))
    whole = [value for value in column if isinstance(value, int)]
    low, high = min(whole, default=0), max(whole, default=0)
    if kinds <= {int, TimeNs}:
        if low >= -_LARGEST and high < _LARGEST:
            return JsonNumber(np.dtype(np.int64), is_time=kinds == {TimeNs})
        if low >= 0 and high < 2 * _LARGEST:
            return JsonNumber(np.dtype(np.uint64))
    if max(-low, high) > sys.float_info.max:
        raise ParameterError("a number of JSON is larger than any double")
    return JsonNumber(np.dtype(np.float64))
