"""Messages of ROS as bytes -> their numbers, many messages at a time, by NumPy.

A message is a structure of numbers, texts and arrays. Texts and arrays begin with their length, so
messages whose lengths are equal have one layout: each number is at the same offset in all of them.
CDR (ROS 2) aligns each number to its size; the encoding of ROS 1 does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, ParameterError

Bytes2D = NDArray[np.uint8]
Types = Mapping[str, tuple[Any, Sequence[tuple[str, tuple[Any, Any]]]]]
"""What ``rosbags.typesys`` parses: type -> constants and (field, description)."""

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of a description, ``rosbags.interfaces.Nodetype``."""
NUMBERS = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "int8": "i1", "uint8": "u1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
TIME, DURATION = "builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"
_EMPTY = "structure_needs_at_least_one_member"
_MAX_FIELDS = 4096
"""Fields of one message, those of the members of arrays counted singly."""
_MAX_DEPTH = 32
_PADDING = 3
"""Bytes that CDR may add at the end of a message."""


class RosNumber(NamedTuple):
    """A number in every message, or an array of ``length`` numbers.

    ``owners`` are the types and fields that lead to it, from the outside. ``is_time``: seconds and
    nanoseconds, which become nanoseconds.
    """

    offset: int
    dtype: np.dtype[Any]
    length: int | None
    owners: tuple[tuple[str, str], ...]
    is_time: bool = False


class RosText(NamedTuple):
    offset: int
    size: int


@dataclass
class RosMessages:
    """Messages of one layout. ``rows``: which of those that were given, [n], in order."""

    rows: NDArray[np.intp]
    data: Bytes2D
    numbers: dict[str, RosNumber] = field(default_factory=dict)
    texts: dict[str, RosText] = field(default_factory=dict)

    def values(self, path: str) -> NDArray[Any]:
        """[n], or [n, count] of an array."""
        number = self.numbers[path]
        if number.is_time:
            pair = self._columns(number.offset, number.dtype, 2).astype(np.int64)
            return pair[:, 0] * 10**9 + pair[:, 1]
        if number.length is None:
            return self._columns(number.offset, number.dtype, 1)[:, 0]
        return self._columns(number.offset, number.dtype, number.length)

    def _columns(self, offset: int, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        raw = self.data[:, offset : offset + count * dtype.itemsize]
        return np.ascontiguousarray(raw).view(dtype)

    def text(self, path: str, row: int) -> str:
        one = self.texts[path]
        raw = self.data[row, one.offset : one.offset + one.size].tobytes()
        return raw.rstrip(b"\0").decode("utf-8", errors="replace")

    def is_constant(self, path: str) -> bool:
        one = self.texts[path]
        raw = self.data[:, one.offset : one.offset + one.size]
        return bool((raw == raw[:1]).all())


class RosLayout:
    """Decodes messages of one type. ``is_cdr``: of ROS 2, else of ROS 1."""

    def __init__(self, types: Types, kind: str, *, is_cdr: bool) -> None:
        self.types = types
        self.kind = kind
        self.is_cdr = is_cdr

    def parts(self, messages: Sequence[bytes]) -> Iterator[RosMessages]:
        """The messages in groups of one layout. ParameterError where they do not fit the type."""
        sizes = np.fromiter(map(len, messages), np.int64, len(messages))
        for size in np.unique(sizes).tolist():
            rows = np.flatnonzero(sizes == size)
            joined = b"".join([messages[row] for row in rows.tolist()])
            waiting = [(rows, np.frombuffer(joined, np.uint8).reshape(len(rows), size))]
            while waiting:
                rows, data = waiting.pop()
                walk = _LayoutWalk(self, data)
                try:
                    walk.message()
                except _LengthsDifferError as found:
                    for value in np.unique(found.values):
                        same = found.values == value
                        waiting.append((rows[same], data[same]))
                    continue
                yield RosMessages(rows, data, walk.numbers, walk.texts)


class _LengthsDifferError(Exception):
    """The messages differ in a length, [n]."""

    def __init__(self, values: NDArray[Any]) -> None:
        super().__init__()
        self.values = values


class _LayoutWalk:
    """Goes through the fields of messages of one size."""

    def __init__(self, layout: RosLayout, data: Bytes2D) -> None:
        self.layout = layout
        self.data = data
        self.size = data.shape[1]
        self.base = 0
        self.order = "<"
        self.at = 0
        self.numbers: dict[str, RosNumber] = {}
        self.texts: dict[str, RosText] = {}
        self.field_count = 0

    def message(self) -> None:
        if self.layout.is_cdr:
            kind = self._same(self._taken(4)[:, :2].astype(np.int64) @ [256, 1])
            if kind not in (0, 1):
                raise ParameterError(f"the encapsulation {kind:#06x} of a message is not plain CDR")
            self.order = "<>"[1 - kind]
            self.base = 4
        self.structure(self.layout.kind, "", (), 0)
        left = self.size - self.at
        if left > (_PADDING if self.layout.is_cdr else 0):
            raise ParameterError(
                f"a message is {left} bytes longer than its type {self.layout.kind}"
            )

    def structure(
        self, kind: str, path: str, owners: tuple[tuple[str, str], ...], depth: int
    ) -> None:
        if depth > _MAX_DEPTH:
            raise ParameterError(f"the type {self.layout.kind} is nested too deeply")
        if kind not in self.layout.types:
            raise ParameterError(f"the type {kind} is not defined")
        for name, description in self.layout.types[kind][1]:
            inner = f"{path}.{name}" if path else name
            self.field(description, inner, (*owners, (kind, name)), depth)

    def field(
        self,
        description: tuple[Any, Any],
        path: str,
        owners: tuple[tuple[str, str], ...],
        depth: int,
    ) -> None:
        self.field_count += 1
        if self.field_count > _MAX_FIELDS:
            raise LimitError(f"messages of type {self.layout.kind} have too many fields")
        what, about = int(description[0].value), description[1]
        if what == BASE:
            self.base_field(about[0], path, owners)
        elif what == NAME and about in (TIME, DURATION):
            self.time(about, path, owners)
        elif what == NAME:
            self.structure(about, path, owners, depth + 1)
        else:
            count = int(about[1]) if what == ARRAY else self.length(4)
            self.array(about[0], count, path, owners, depth)

    def base_field(self, name: str, path: str, owners: tuple[tuple[str, str], ...]) -> None:
        if name == "string":
            size = self.length(4)
            self.texts[path] = RosText(self.at, size)
            self._taken(size)
        elif owners[-1][1] == _EMPTY and not self.layout.is_cdr:
            return
        elif name in NUMBERS:
            dtype = self.dtype(name)
            self.align(dtype.itemsize)
            if owners[-1][1] != _EMPTY:
                self.numbers[path] = RosNumber(self.at, dtype, None, owners)
            self._taken(dtype.itemsize)
        else:
            raise ParameterError(f"fields of type {name} are not known")

    def time(self, kind: str, path: str, owners: tuple[tuple[str, str], ...]) -> None:
        unsigned = kind == TIME and not self.layout.is_cdr
        self.align(4)
        # Seconds and nanoseconds; those of ROS 2 are a signed and an unsigned integer, and below
        # 10^9 the latter has the same bits.
        dtype = np.dtype(self.order + ("u4" if unsigned else "i4"))
        self.numbers[path] = RosNumber(self.at, dtype, None, owners, is_time=True)
        self._taken(8)

    def array(
        self,
        member: tuple[Any, Any],
        count: int,
        path: str,
        owners: tuple[tuple[str, str], ...],
        depth: int,
    ) -> None:
        if int(member[0].value) == BASE and member[1][0] in NUMBERS:
            dtype = self.dtype(member[1][0])
            if count:
                self.align(dtype.itemsize)
            self.numbers[path] = RosNumber(self.at, dtype, count, owners)
            self._taken(count * dtype.itemsize)
            return
        if count > _MAX_FIELDS:
            raise LimitError(f"messages of type {self.layout.kind} have too many fields")
        for place in range(count):
            self.field(member, f"{path}[{place}]", owners, depth + 1)

    def dtype(self, name: str) -> np.dtype[Any]:
        """A byte is signed in ROS 1."""
        signed = name == "byte" and not self.layout.is_cdr
        return np.dtype(self.order + ("i1" if signed else NUMBERS[name]))

    def length(self, size: int) -> int:
        self.align(size)
        raw = np.ascontiguousarray(self._taken(size))
        return self._same(raw.view(f"{self.order}u{size}")[:, 0])

    def align(self, size: int) -> None:
        if self.layout.is_cdr:
            self.at += -(self.at - self.base) % size

    def _taken(self, size: int) -> Bytes2D:
        if self.at + size > self.size:
            raise ParameterError(f"a message ends before its type {self.layout.kind} does")
        self.at += size
        return self.data[:, self.at - size : self.at]

    @staticmethod
    def _same(values: NDArray[Any]) -> int:
        if (values != values[0]).any():
            raise _LengthsDifferError(values)
        return int(values[0])
