"""Bytes at an offset, from memory, a file, or a pipe; nothing is read that is not asked for."""

from __future__ import annotations

import io
import os
import shutil
import tempfile
from pathlib import Path
from typing import BinaryIO, Protocol

SPOOL_SIZE = 1 << 24
"""A pipe is kept in memory up to this size, then in a temporary file."""


class Source(Protocol):
    """Random access to a file's bytes."""

    path: str | None
    size: int

    def read_at(self, offset: int, size: int) -> bytes:
        """Up to ``size`` bytes from ``offset``; fewer only at the end."""

    def close(self) -> None: ...


class BytesSource:
    def __init__(self, data: bytes, path: str | None = None) -> None:
        self.data = data
        self.size = len(data)
        self.path = path

    def read_at(self, offset: int, size: int) -> bytes:
        return self.data[offset : offset + size]

    def close(self) -> None:
        pass


class FileSource:
    def __init__(self, stream: BinaryIO, path: str | None = None, *, owned: bool = False) -> None:
        self.stream = stream
        self.path = path
        self.owned = owned
        self.size = stream.seek(0, io.SEEK_END)

    def read_at(self, offset: int, size: int) -> bytes:
        if offset >= self.size:
            # A hostile file names places that no system can seek to.
            return b""
        self.stream.seek(offset)
        parts = []
        while size > 0:
            part = self.stream.read(size)
            if not part:
                break
            parts.append(part)
            size -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def close(self) -> None:
        if self.owned:
            self.stream.close()


def open_source(file: str | os.PathLike[str] | bytes | BinaryIO) -> Source:
    """A Source for a path, for bytes, or for an open binary stream (a pipe is spooled first)."""
    if isinstance(file, (bytes, bytearray, memoryview)):
        return BytesSource(bytes(file))
    if isinstance(file, (str, os.PathLike)):
        return FileSource(Path(file).open("rb"), os.fspath(file), owned=True)
    name = getattr(file, "name", None)
    path = name if isinstance(name, str) else None
    if file.seekable():
        return FileSource(file, path)
    spool = tempfile.SpooledTemporaryFile(max_size=SPOOL_SIZE)  # noqa: SIM115
    shutil.copyfileobj(file, spool)
    return FileSource(spool, path, owned=True)  # type: ignore[arg-type]
