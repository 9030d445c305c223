"""Reads MAT files of version 5, as MATLAB writes them without -v7.3: the arrays, texts and
structures of their variables.

A file is a sequence of elements: type, size, content. A variable is an element of the type matrix,
or a compressed one with a matrix in it. Matrices of cells and structures hold matrices. Only the
heads are read here; a compressed variable is unpacked when its values are needed, into a temporary
file if it is large.

This is our own reader, since scipy.io.loadmat reads each variable whole, and has no bound on what a
damaged file makes it do.
"""

from __future__ import annotations

import tempfile
import zlib
from collections.abc import Callable, Iterator
from math import prod
from typing import Any, BinaryIO, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, ParameterError
from ..numbers import counted
from .formats import Source
from .layouts import LONGEST_NAME, Path, SourceArray, SourceTree

HEADER_SIZE = 128
HEADER = b"MATLAB 5.0 MAT-file, written by hapfmt".ljust(116) + bytes(8) + b"\x00\x01IM"
OUR_TEXT = ("hapfmt",)
"""The variable that may hold a long text."""
MOST_MATRICES = 20_000
DEEPEST = 32
MOST_SIDES = 32
MOST_TEXTS = 4096
LONGEST_TEXT = 1 << 20
"""Characters of a text that is kept."""
IN_MEMORY = 1 << 20
"""Bytes of an unpacked variable that are not worth a temporary file."""
_PIECE = 1 << 20
_HEAD = 4096
"""Bytes of a compressed variable that are unpacked to know what it is."""
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
"""Types of elements."""
_CLASSES = {
    6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8",
}  # fmt: skip
"""Classes of matrices of numbers."""
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_COMPLEX, _LOGICAL = 0x0800, 0x0200
ADVICE = {
    "timetable": "in MATLAB, s = struct('time', seconds(tt.Properties.RowTimes), 'data', tt{:,:}) "
    "makes a structure of it",
    "table": "in MATLAB, s = table2struct(t, 'ToScalar', true) makes a structure of it",
    "timeseries": "in MATLAB, s = struct('time', ts.Time, 'data', ts.Data) makes a structure of it",
    "string": "in MATLAB, cellstr makes a cell array of it",
    "datetime": "in MATLAB, posixtime makes numbers of it",
    "duration": "in MATLAB, seconds makes numbers of it",
}


def object_note(shown: str, kind: str) -> str:
    """Why an object is not read, and what helps."""
    advice = ADVICE.get(kind, "store it as an array or a structure")
    return f"{shown} is an object of the class {kind or '?'}, which only MATLAB reads; {advice}"


def name_of(path: Path) -> str:
    return "/" + "/".join(path)


class Budget:
    """Bytes that unpacked variables may take."""

    def __init__(self, size: int) -> None:
        self.size, self.left = size, size

    def take(self, size: int, what: str) -> None:
        self.left -= size
        if self.left < 0:
            raise LimitError(
                f"{what} makes the unpacked variables take more than the {self.size} bytes "
                "allowed; allow more (max_memory=)"
            )


class Bytes(Protocol):
    """Bytes that are read in parts."""

    size: int

    def at(self, place: int, count: int) -> bytes: ...


class FileBytes:
    """Those of the file itself."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = stream.seek(0, 2)
        stream.seek(0)

    def at(self, place: int, count: int) -> bytes:
        if place + count > self.size:
            raise ParameterError(f"the MAT file ends at byte {self.size}, in the middle of a value")
        self._stream.seek(place)
        return self._stream.read(count)


class PackedBytes:
    """Those that a compressed variable unpacks to."""

    def __init__(
        self, file: FileBytes, start: int, stored: int, little: bool, budget: Budget, source: Source
    ) -> None:
        self._file, self._start, self._stored = file, start, stored
        self._budget, self._source = budget, source
        self._whole: Any = None
        self._head = b""
        for piece in self._pieces(_HEAD):
            self._head += piece
            if len(self._head) >= 8:
                break
        if len(self._head) < 8:
            raise ParameterError("a compressed variable holds nothing")
        self.size = 8 + int.from_bytes(self._head[4:8], "little" if little else "big")

    def at(self, place: int, count: int) -> bytes:
        if place + count > self.size:
            raise ParameterError("a compressed variable is shorter than it states")
        if place + count <= len(self._head) and self.size > _HEAD:
            return self._head[place : place + count]
        if self._whole is None:
            self._whole = self._unpacked()
        self._whole.seek(place)
        data: bytes = self._whole.read(count)
        return data

    def _pieces(self, size: int) -> Iterator[bytes]:
        """The bytes, at most ``size`` at a time."""
        unpack = zlib.decompressobj()
        at, end, data = self._start, self._start + self._stored, b""
        try:
            while not unpack.eof:
                if not data:
                    if at >= end:
                        raise ParameterError("a compressed variable is cut off")
                    data = self._file.at(at, min(_PIECE, end - at))
                    at += len(data)
                yield unpack.decompress(data, size)
                data = unpack.unconsumed_tail
        except zlib.error as error:
            raise ParameterError(f"a compressed variable is damaged: {error}") from error

    def _unpacked(self) -> Any:
        self._budget.take(self.size, f"a variable of {self.size} bytes")
        whole = tempfile.SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115
        self._source.on_close(whole.close)
        done = 0
        for piece in self._pieces(_PIECE):  # to its end, where the checksum is
            done += len(piece)
            if done > self.size + 8:
                raise ParameterError("a compressed variable is longer than it states")
            whole.write(piece)
        if done < self.size:
            raise ParameterError("a compressed variable ends before its last value")
        return whole


class Element(NamedTuple):
    kind: int
    start: int
    size: int
    after: int
    """Where the next one begins."""


def tree_of_mat5(source: Source, max_memory: int) -> SourceTree:
    """All arrays, texts and numbers of a file."""
    return _Scan(source, max_memory).tree


class _Scan:
    def __init__(self, source: Source, max_memory: int) -> None:
        self.tree = SourceTree(groups={(): {}})
        file = FileBytes(source.stream)
        header = file.at(0, HEADER_SIZE)
        self._little = header[126:128] == b"IM"
        self._order: Literal["<", ">"] = "<" if self._little else ">"
        self._our_text = max_memory // 16
        budget = Budget(max_memory)
        own = int.from_bytes(header[116:124], "little" if self._little else "big")
        at, self._count = HEADER_SIZE, 0
        while at < file.size:
            one = self._element(file, at, file.size)
            if one.kind == _COMPRESSED:
                packed = PackedBytes(file, one.start, one.size, self._little, budget, source)
                inner = self._element(packed, 0, packed.size)
                if inner.kind != _MATRIX:
                    raise ParameterError("a compressed variable holds no matrix")
                self._matrix(packed, inner, (), 0, is_named=at != own)
            elif one.kind == _MATRIX:
                self._matrix(file, one, (), 0, is_named=at != own)
            else:
                raise ParameterError(f"byte {at} begins no variable")
            at = one.after

    def _int(self, data: bytes) -> int:
        return int.from_bytes(data, "little" if self._little else "big")

    def _element(self, data: Bytes, at: int, end: int) -> Element:
        if at + 8 > end:
            raise ParameterError(f"the MAT file is truncated: an element begins at byte {at}")
        head = data.at(at, 8)
        kind, size = self._int(head[:4]), self._int(head[4:])
        if kind >> 16:  # size and content in the first 8 bytes
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise ParameterError(f"a small element at byte {at} has {size} bytes")
            return Element(kind, at + 4, size, at + 8)
        if at + 8 + size > end:
            raise ParameterError(f"the MAT file is truncated: the element at byte {at} is cut off")
        padded = size if kind == _COMPRESSED else -(-size // 8) * 8
        return Element(kind, at + 8, size, min(at + 8 + padded, end))

    def _integers(self, data: Bytes, one: Element, most: int) -> list[int]:
        if one.kind not in (5, 6) or one.size > 4 * most or one.size % 4:
            raise ParameterError(f"byte {one.start} holds no sizes")
        kind = np.dtype(_NUMBERS[one.kind]).newbyteorder(self._order)
        return [int(x) for x in np.frombuffer(data.at(one.start, one.size), kind)]

    def _short_text(self, data: Bytes, one: Element) -> str:
        if one.kind not in (1, 2, 16) or one.size > LONGEST_NAME:
            raise ParameterError(f"byte {one.start} holds no name")
        return data.at(one.start, one.size).partition(b"\0")[0].decode("utf-8", "replace")

    def _matrix(
        self, data: Bytes, one: Element, path: Path, depth: int, *, is_named: bool = False
    ) -> None:
        """Put a matrix into the tree; ``path`` is its own unless it is a named variable."""
        self._count += 1
        if self._count > MOST_MATRICES:
            raise LimitError(f"the file has more than {MOST_MATRICES} arrays, cells and structures")
        if depth > DEEPEST:
            raise LimitError(f"structures lie more than {DEEPEST} deep in one another")
        if one.size == 0:
            return  # [], as MATLAB stores it in structures and cells
        end = one.start + one.size
        flags = self._element(data, one.start, end)
        if flags.kind != 6 or flags.size != 8:
            raise ParameterError(f"byte {one.start} begins no matrix")
        bits = self._int(data.at(flags.start, 4))
        kind = bits & 0xFF
        if kind == _OPAQUE:
            self._opaque(data, flags.after, end, path)
            return
        sides = self._element(data, flags.after, end)
        shape = tuple(self._integers(data, sides, MOST_SIDES))
        if len(shape) < 2 or min(shape) < 0:
            raise ParameterError(f"byte {sides.start} holds no sizes of a matrix")
        called = self._element(data, sides.after, end)
        name = self._short_text(data, called)
        if depth == 0:
            if not is_named or not name:
                return  # what MATLAB keeps of objects
            path = (name,)
        rest = (data, called.after, end, path, shape)
        if kind in _CLASSES:
            self._numbers(*rest, kind, bits)
        elif kind == _CHAR:
            self._text(*rest)
        elif kind == _STRUCT:
            self._struct(*rest, depth)
        elif kind == _CELL:
            self._cell(*rest, depth)
        elif kind == _OBJECT:
            of = self._short_text(data, self._element(data, called.after, end))
            self.tree.note(object_note(name_of(path), of))
        elif kind == _SPARSE:
            self.tree.note(
                f"{name_of(path)} is a sparse matrix, which is not read; in MATLAB, full makes an "
                "array of it"
            )
        elif kind == _FUNCTION:
            self.tree.note(f"{name_of(path)} is a function, which is not read")
        else:
            raise ParameterError(f"{name_of(path)} is of the unknown class {kind}")

    def _opaque(self, data: Bytes, at: int, end: int, path: Path) -> None:
        texts = []
        for _ in range(3):
            one = self._element(data, at, end)
            texts.append(self._short_text(data, one))
            at = one.after
        self.tree.note(object_note(name_of(path or (texts[0],)), texts[2]))

    def _numbers(
        self,
        data: Bytes,
        at: int,
        end: int,
        path: Path,
        shape: tuple[int, ...],
        kind: int,
        bits: int,
    ) -> None:
        if prod(shape) == 0:
            return
        if bits & _COMPLEX:
            self.tree.note(f"{name_of(path)} is not read: it holds complex numbers")
            return
        one = self._element(data, at, end)
        if one.kind not in _NUMBERS:
            raise ParameterError(f"{name_of(path)} holds no numbers")
        stored = np.dtype(_NUMBERS[one.kind]).newbyteorder(self._order)
        if prod(shape) * stored.itemsize != one.size:
            raise ParameterError(
                f"{name_of(path)} is {' x '.join(map(str, shape))}, and holds "
                f"{counted(one.size, 'byte')}"
            )
        dtype = np.dtype(bool if bits & _LOGICAL else _CLASSES[kind])
        read = _reader(data, one.start, shape, stored, dtype)
        if prod(shape) == 1:
            value = read(0, 0, 1).reshape(-1)[0].item()
            self.tree.groups.setdefault(path[:-1], {})[path[-1]] = value
        else:
            self.tree.arrays.append(SourceArray(path, shape, dtype, read))

    def _text(self, data: Bytes, at: int, end: int, path: Path, shape: tuple[int, ...]) -> None:
        """Keep a text, or one for each row of a matrix of characters."""
        rows, count = shape[0], prod(shape)
        value: str | list[str] = ""
        if count:
            one = self._element(data, at, end)
            most = self._our_text if path == OUR_TEXT else LONGEST_TEXT
            if count > most or rows > MOST_TEXTS or one.size > 4 * most:
                self.tree.note(f"the text {name_of(path)} is too long, and is not read")
                return
            text = self._characters(data, one)
            value = text if rows == 1 else [text[row::rows].rstrip() for row in range(rows)]
        self.tree.groups.setdefault(path[:-1], {})[path[-1]] = value

    def _characters(self, data: Bytes, one: Element) -> str:
        content = data.at(one.start, one.size)
        end = "le" if self._little else "be"
        codec = {4: "utf-16", 17: "utf-16", 18: "utf-32"}.get(one.kind)
        if codec is not None:
            return content.decode(f"{codec}-{end}", "replace")
        try:
            return content.decode("utf-8")
        except UnicodeDecodeError:
            return content.decode("latin-1")

    def _struct(
        self, data: Bytes, at: int, end: int, path: Path, shape: tuple[int, ...], depth: int
    ) -> None:
        longest = self._element(data, at, end)
        (width,) = self._integers(data, longest, 1) or (0,)
        names_at = self._element(data, longest.after, end)
        if names_at.size and (width < 1 or names_at.size % width):
            raise ParameterError(f"the names of the fields of {name_of(path)} are damaged")
        count = prod(shape)
        fields = names_at.size // width if names_at.size else 0
        if count * max(fields, 1) > MOST_MATRICES:
            raise LimitError(f"{name_of(path)} has {count} entries, more than {MOST_MATRICES}")
        names = [
            self._short_text(data, Element(1, names_at.start + width * place, width, 0))
            for place in range(fields)
        ]
        at = names_at.after
        for number in range(count):
            inner = path if count == 1 else (*path, str(number + 1))
            self.tree.groups.setdefault(inner, {})
            for name in names:
                one = self._member(data, at, end)
                self._matrix(data, one, (*inner, name), depth + 1)
                at = one.after

    def _member(self, data: Bytes, at: int, end: int) -> Element:
        one = self._element(data, at, end)
        if one.kind != _MATRIX:
            raise ParameterError(f"byte {at} begins no matrix")
        return one

    def _cell(
        self, data: Bytes, at: int, end: int, path: Path, shape: tuple[int, ...], depth: int
    ) -> None:
        """A list of texts describes its group; other cells are read as a structure of them."""
        count = prod(shape)
        if count > MOST_MATRICES:
            raise LimitError(f"{name_of(path)} has {count} cells, more than {MOST_MATRICES}")
        self.tree.groups[path] = {}
        for number in range(count):
            one = self._member(data, at, end)
            self._matrix(data, one, (*path, str(number + 1)), depth + 1)
            at = one.after
        fold_texts(self.tree, path, count)


def fold_texts(tree: SourceTree, path: Path, count: int) -> None:
    """Make the cells of a group one list, where all of them are texts."""
    cells = tree.groups[path]
    if 0 < len(cells) == count <= MOST_TEXTS and all(isinstance(x, str) for x in cells.values()):
        del tree.groups[path]
        tree.groups.setdefault(path[:-1], {})[path[-1]] = list(cells.values())


def _reader(
    data: Bytes,
    start: int,
    shape: tuple[int, ...],
    stored: np.dtype[Any],
    dtype: np.dtype[Any],
) -> Callable[[int, int, int], NDArray[Any]]:
    """A function that reads a part along one axis; the first axis varies fastest in the file."""

    def part(axis: int, first: int, last: int) -> NDArray[Any]:
        inner, outer = prod(shape[:axis]), prod(shape[axis + 1 :])
        rows, size = last - first, stored.itemsize
        found = np.empty((outer, rows * inner), dtype)
        for place in range(outer):
            at = start + (place * shape[axis] + first) * inner * size
            content = data.at(at, rows * inner * size)
            values = np.frombuffer(content, stored)
            with np.errstate(invalid="ignore", over="ignore"):  # of a damaged file
                found[place] = values != 0 if dtype == np.bool_ else values
        return found.reshape(-1).reshape((*shape[:axis], rows, *shape[axis + 1 :]), order="F")

    return part
