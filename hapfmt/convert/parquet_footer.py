"""What a Parquet footer says of its columns. pyarrow ends the process where it shows a footer whose
statistics of sizes contradict each other, so hapfmt reads these numbers itself.

A footer is a structure in Thrift's compact protocol. Its fields have numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ..errors import ParameterError
from .common import refusing

_ROW_GROUPS, _COLUMNS, _META, _SIZE, _STATISTICS, _NULLS = 4, 1, 3, 6, 12, 3
"""Fields: of the file, of a row group, of a column in it (three), of its statistics."""
_TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT, _UUID = (
    1, 2, 3, 7, 8, 9, 10, 11, 12, 13,
)  # fmt: skip
_NUMBERS = (4, 5, 6)
_FIXED = {_BYTE: 1, _DOUBLE: 8, _UUID: 16}
_DEPTH = 32


class ColumnChunk(NamedTuple):
    """A column in a row group. ``size``: bytes of its pages, decompressed. ``nulls``: values that
    are missing; None where the file does not say."""

    size: int
    nulls: int | None


def column_chunks(footer: bytes) -> list[list[ColumnChunk]]:
    """The columns of each row group, in the order of the schema."""
    with refusing("the footer of the Parquet file"):
        reader = _Compact(footer)
        found: list[list[ColumnChunk]] = []
        for number, kind in reader.fields():
            if (number, kind) == (_ROW_GROUPS, _LIST):
                found += [list(_group(reader)) for _ in range(reader.list_of(_STRUCT))]
            else:
                reader.skip(kind)
        return found


def _group(reader: _Compact) -> Iterator[ColumnChunk]:
    for number, kind in reader.fields():
        if (number, kind) != (_COLUMNS, _LIST):
            reader.skip(kind)
            continue
        for _ in range(reader.list_of(_STRUCT)):
            yield _chunk(reader)


def _chunk(reader: _Compact) -> ColumnChunk:
    found = ColumnChunk(0, None)
    for number, kind in reader.fields():
        if (number, kind) != (_META, _STRUCT):
            reader.skip(kind)
            continue
        for inner, inner_kind in reader.fields():
            if inner == _SIZE and inner_kind in _NUMBERS:
                found = found._replace(size=reader.number())
            elif (inner, inner_kind) == (_STATISTICS, _STRUCT):
                for part, part_kind in reader.fields():
                    if part == _NULLS and part_kind in _NUMBERS:
                        found = found._replace(nulls=reader.number())
                    else:
                        reader.skip(part_kind)
            else:
                reader.skip(inner_kind)
    if found.size < 0 or (found.nulls or 0) < 0:
        raise ParameterError("the footer of the Parquet file has sizes below 0")
    return found


class _Compact:
    """Thrift's compact protocol, from the start of some bytes on."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def byte(self) -> int:
        found = self._data[self._at]
        self._at += 1
        return found

    def unsigned(self) -> int:
        found = shift = 0
        while True:
            byte = self.byte()
            found |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return found
            if shift > 63:
                raise ValueError("a number has more than 64 bits")

    def number(self) -> int:
        found = self.unsigned()
        return (found >> 1) ^ -(found & 1)

    def fields(self) -> Iterator[tuple[int, int]]:
        """Number and kind of each field of a structure; the caller reads or skips its value."""
        number = 0
        while head := self.byte():
            number = number + (head >> 4) if head >> 4 else self.number()
            yield number, head & 15

    def list_of(self, wanted: int) -> int:
        """The length of a list whose elements are of one kind."""
        kind, length = self._list()
        if length and kind != wanted:
            raise ValueError("a list holds something else")
        return length

    def _list(self) -> tuple[int, int]:
        head = self.byte()
        return head & 15, head >> 4 if head >> 4 < 15 else self.unsigned()

    def skip(self, kind: int, depth: int = 0, *, element: bool = False) -> None:
        """Leaves a value out. Truth values are in the head of a field; as elements, they have a
        byte."""
        if depth > _DEPTH:
            raise ValueError(f"more than {_DEPTH} structures lie within each other")
        if kind in _NUMBERS:
            self.unsigned()
        elif kind == _BINARY:
            self._forward(self.unsigned())
        elif kind in _FIXED:
            self._forward(_FIXED[kind])
        elif kind in (_TRUE, _FALSE):
            self._forward(1 if element else 0)
        elif kind == _STRUCT:
            for _, inner in self.fields():
                self.skip(inner, depth + 1)
        elif kind in (_LIST, _SET):
            inner, length = self._list()
            for _ in range(length):
                self.skip(inner, depth + 1, element=True)
        elif kind == _MAP:
            length = self.unsigned()
            kinds = self.byte() if length else 0
            for _ in range(length):
                self.skip(kinds >> 4, depth + 1, element=True)
                self.skip(kinds & 15, depth + 1, element=True)
        else:
            raise ValueError(f"a value has the unknown kind {kind}")

    def _forward(self, size: int) -> None:
        self._at += size
        if self._at > len(self._data):
            raise ValueError("it ends in the middle of a value")
