"""Feather, which is Arrow IPC, <-> Recording.

A file holds messages and a footer that lists them; a stream holds the messages alone. Each message
is checked before pyarrow decompresses its buffers.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ..errors import LimitError, ParameterError
from .arrowtables import arrow, arrow_errors, checked_schema, read_table, tables_of
from .formats import Destination, ReadOptions, Source, WriteOptions
from .tables import Import

MAGIC = b"ARROW1"
_CONTINUES = b"\xff\xff\xff\xff"
"""The start of a message; before version 0.15 of Arrow, messages began with their length."""
_SCHEMA_SIZE = 1 << 26
_MESSAGES = 1 << 20
_RECORD_BATCH, _DICTIONARY_BATCH = 3, 2
"""Kinds of messages."""


def read(source: Source, options: ReadOptions) -> Import:
    arrow()
    return read_table(FeatherTable(source.path, options.max_memory), options, "Arrow IPC")


def write(recording: Any, target: Destination, options: WriteOptions) -> list[str]:
    """A column for each channel, behind their times in s; empty cells in gaps."""
    arrow()
    from pyarrow import ipc

    schema, batches, notes = tables_of(recording, ".feather", options)
    with (
        arrow_errors("the table cannot be written"),
        ipc.new_file(
            target.stream, schema, options=ipc.IpcWriteOptions(compression="zstd")
        ) as writer,
    ):
        for batch in batches:
            writer.write_batch(batch)
    return notes


class FeatherTable:
    """The record batches of a file or a stream."""

    def __init__(self, path: Path, max_memory: int) -> None:
        self._path = path
        self._max_memory = max_memory
        self._is_file = _is_file(path)
        self.row_count = 0
        with arrow_errors("this is not an Arrow file"), self._open() as file:
            for kind, metadata, body in _blocks(file) if self._is_file else _messages(file):
                if kind in (_RECORD_BATCH, _DICTIONARY_BATCH):
                    rows, size = _size_of(metadata, body, kind)
                    if size > max_memory:
                        raise LimitError(
                            f"a batch takes {size} bytes, more than the {max_memory} allowed; "
                            "allow more (max_memory=)"
                        )
                    self.row_count += rows if kind == _RECORD_BATCH else 0
        from pyarrow import ipc

        with arrow_errors("this is not an Arrow file"), self._open() as file:
            opened = ipc.open_file(file) if self._is_file else ipc.open_stream(file)
            self.schema: Any = checked_schema(opened.schema)

    def _open(self) -> Any:
        import pyarrow as pa

        return pa.memory_map(str(self._path))

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[Any]:
        from pyarrow import ipc

        with arrow_errors("the table cannot be read"), self._open() as file:
            places = sorted({self.schema.get_field_index(name) for name in columns})
            options = ipc.IpcReadOptions(included_fields=places, use_threads=False)
            for batch in _batches(file, self._is_file, options):
                batch.validate(full=True)
                for first in range(0, batch.num_rows, rows):
                    yield batch.slice(first, rows)

    def may_lack(self, column: str) -> bool:
        return bool(self.schema.field(column).nullable or self.schema.field(column).type.num_fields)


def _batches(file: Any, is_file: bool, options: Any) -> Iterator[Any]:
    from pyarrow import ipc

    if is_file:
        opened = ipc.open_file(file, options=options)
        for number in range(opened.num_record_batches):
            yield opened.get_batch(number)
    else:
        yield from ipc.open_stream(file, options=options)


def _is_file(path: Path) -> bool:
    """Whether this is a file with a footer, not a stream; ParameterError where it is neither."""
    size = path.stat().st_size
    with path.open("rb") as stream:
        head = stream.read(8)
        if head[:4] == b"FEA1":
            raise ParameterError("Feather of version 1 is not read; pandas rewrites it")
        if head[:6] != MAGIC:
            if size < 16 or head[:4] != _CONTINUES:
                raise ParameterError("this is not an Arrow file")
            return False
        stream.seek(max(size - 10, 0))
        tail = stream.read(10)
    if size < 24 or tail[4:] != MAGIC:
        raise ParameterError("the Arrow file is truncated: it has no footer")
    return True


def _blocks(file: Any) -> Iterator[tuple[int, bytes, Any]]:
    """Kind, metadata and body of each message that the footer lists. Nothing is decompressed."""
    size = file.size()
    file.seek(size - 10)
    length = int.from_bytes(file.read(4), "little")
    if not 0 < length <= min(size - 18, _SCHEMA_SIZE):
        raise ParameterError(f"a footer of {length} bytes is longer than the file")
    file.seek(size - 10 - length)
    footer = _FlatTable.root(file.read(length))
    listed = [*footer.structs(2, "<qi4xq"), *footer.structs(3, "<qi4xq")]
    if len(listed) > _MESSAGES:
        raise LimitError(f"the file has more than {_MESSAGES} messages")
    before = 8
    for at, head, body in sorted(listed):
        if not (before <= at <= size and 8 <= head <= _SCHEMA_SIZE and 0 <= body <= size):
            raise ParameterError("the footer lists messages that overlap, or lie outside the file")
        before = at + head + body
        if before > size - 10 - length:
            raise ParameterError("the footer lists messages that lie outside the file")
        file.seek(at)
        metadata = file.read(head)
        metadata = metadata[8:] if metadata[:4] == _CONTINUES else metadata[4:]
        yield _FlatTable.root(metadata).number(1, "B"), metadata, file.read_buffer(body)


def _messages(file: Any) -> Iterator[tuple[int, bytes, Any]]:
    """The same of the messages of a stream."""
    size = file.size()
    for _ in range(_MESSAGES):
        head = file.read(8)
        if len(head) < 4 or head[:4] != _CONTINUES:
            raise ParameterError("the Arrow stream is truncated, or older than version 0.15")
        length = int.from_bytes(head[4:8], "little") if len(head) == 8 else 0
        if not length:
            return
        if length > min(size - file.tell(), _SCHEMA_SIZE):
            raise ParameterError(f"a message of {length} bytes is longer than the file")
        metadata = file.read(length)
        table = _FlatTable.root(metadata)
        body_size = table.number(3, "q")
        if not 0 <= body_size <= size - file.tell():
            raise ParameterError(f"a message of {body_size} bytes is longer than the file")
        body = file.read_buffer(body_size)
        yield table.number(1, "B"), metadata, body
    raise LimitError(f"the file has more than {_MESSAGES} messages")


def _size_of(metadata: bytes, body: Any, kind: int) -> tuple[int, int]:
    """Rows of a batch, and the bytes of its buffers once they are decompressed."""
    batch = _FlatTable.root(metadata).table(2)
    if batch is not None and kind == _DICTIONARY_BATCH:
        batch = batch.table(1)
    if batch is None:
        raise ParameterError("a message of the file has no contents")
    rows = batch.number(0, "q")
    compressed = batch.table(3) is not None
    total = 0
    for offset, length in batch.structs(2, "<qq"):
        if offset < 0 or length < 0 or offset + length > body.size:
            raise ParameterError("a buffer lies outside its message")
        if compressed and length >= 8:
            size = struct.unpack("<q", body.slice(offset, 8).to_pybytes())[0]
            total += length if size < 0 else size
        else:
            total += length
    # A column takes at least a bit for each row, except where it holds nothing at all.
    if rows < 0 or rows > 8 * total:
        raise ParameterError(f"a batch declares {rows} rows, and holds {total} bytes")
    return rows, total


class _FlatTable:
    """A table of a flatbuffer: numbers, tables and vectors by the number of their field."""

    def __init__(self, data: bytes, at: int) -> None:
        self._data = data
        self._at = at
        self._fields = at - self._unpack("i", at)

    @classmethod
    def root(cls, data: bytes) -> _FlatTable:
        if len(data) < 4:
            raise ParameterError("a message of the file is too short")
        return cls(data, int.from_bytes(data[:4], "little"))

    def _unpack(self, code: str, at: int) -> int:
        size = struct.calcsize(f"<{code}")
        if not 0 <= at <= len(self._data) - size:
            raise ParameterError("a message of the file points outside itself")
        return int(struct.unpack_from(f"<{code}", self._data, at)[0])

    def _place(self, number: int) -> int | None:
        at = 4 + 2 * number
        if at + 2 > self._unpack("H", self._fields):
            return None
        offset = self._unpack("H", self._fields + at)
        return self._at + offset if offset else None

    def number(self, number: int, code: str) -> int:
        at = self._place(number)
        return 0 if at is None else self._unpack(code, at)

    def table(self, number: int) -> _FlatTable | None:
        at = self._place(number)
        return None if at is None else _FlatTable(self._data, at + self._unpack("I", at))

    def structs(self, number: int, layout: str) -> Iterator[tuple[int, ...]]:
        """A vector of structures."""
        at = self._place(number)
        if at is None:
            return
        at += self._unpack("I", at)
        count, size = self._unpack("I", at), struct.calcsize(layout)
        if count * size > len(self._data) - at - 4:
            raise ParameterError("a message of the file points outside itself")
        for place in range(count):
            yield struct.unpack_from(layout, self._data, at + 4 + size * place)
