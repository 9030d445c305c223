"""Bytes at an offset: of memory, a file, a mapping, a pipe, a URL; from any thread."""

from __future__ import annotations

import io
import mmap
import os
import re
import shutil
import stat
import tempfile
import threading
from pathlib import Path
from typing import BinaryIO, Protocol

from ..errors import ParameterError

SPOOL_SIZE = 1 << 24
"""A pipe is kept in memory up to this size, then in a temporary file."""

MEMORY_GAP, FILE_GAP = 1 << 12, 1 << 14
"""Measured: so many bytes are copied, or read, and their CRC taken, in the time that one more
reading takes with what Python does around it."""

URL = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]+(://|::)")


class Source(Protocol):
    """Random access to a file's bytes. ``gap``: as many bytes cost what a further reading costs."""

    path: str | None
    size: int
    gap: int

    def read_at(self, offset: int, size: int) -> bytes:
        """Up to ``size`` bytes from ``offset``; fewer only at the end."""

    def close(self) -> None: ...


class BytesSource:
    gap = MEMORY_GAP

    def __init__(self, data: bytes, path: str | None = None) -> None:
        self.data = data
        self.size = len(data)
        self.path = path

    def read_at(self, offset: int, size: int) -> bytes:
        return self.data[offset : offset + size]

    def close(self) -> None:
        pass


class FileSource:
    """A regular file, read where it is asked for: no position moves, threads need no lock."""

    gap = FILE_GAP

    def __init__(self, stream: io.IOBase | BinaryIO, path: str | None, *, owned: bool) -> None:
        self.stream = stream
        self.descriptor = stream.fileno()
        self.path = path
        self.owned = owned
        self.size = os.fstat(self.descriptor).st_size

    def read_at(self, offset: int, size: int) -> bytes:
        if offset >= self.size:
            # A hostile file names places that no system can read at.
            return b""
        size = min(size, self.size - offset)
        data = os.pread(self.descriptor, size, offset)
        while data and len(data) < size:
            part = os.pread(self.descriptor, size - len(data), offset + len(data))
            if not part:
                break
            data += part
        return data

    def close(self) -> None:
        if self.owned:
            self.stream.close()


class MappedSource:
    """A file in the address space: pages are read by the system when they are touched.

    Only for a file that nobody cuts meanwhile: to touch a page beyond its end kills the process
    (SIGBUS), and no program can catch that as an error.
    """

    gap = MEMORY_GAP

    def __init__(self, path: str) -> None:
        self.path: str | None = path
        with Path(path).open("rb") as stream:
            self.size = os.fstat(stream.fileno()).st_size
            # An empty file cannot be mapped.
            self.pages: mmap.mmap | bytes = b""
            if self.size:
                self.pages = mmap.mmap(stream.fileno(), self.size, access=mmap.ACCESS_READ)

    def read_at(self, offset: int, size: int) -> bytes:
        return self.pages[offset : offset + size] if offset < self.size else b""

    def close(self) -> None:
        if isinstance(self.pages, mmap.mmap):
            self.pages.close()


class StreamSource:
    """An open stream that can seek; a lock holds its position for one reading."""

    gap = FILE_GAP

    def __init__(self, stream: BinaryIO, path: str | None = None, *, owned: bool = False) -> None:
        self.stream = stream
        self.path = path
        self.owned = owned
        self.lock = threading.Lock()
        self.size = stream.seek(0, io.SEEK_END)

    def read_at(self, offset: int, size: int) -> bytes:
        if offset >= self.size:
            return b""
        parts = []
        with self.lock:
            self.stream.seek(offset)
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


def open_source(
    file: str | os.PathLike[str] | bytes | BinaryIO, *, mapped: bool = False, spool: bool = False
) -> Source:
    """A Source for a path, a URL, bytes, or an open binary stream.

    A pipe is spooled first; a URL too, where ``spool`` says so: copied whole into memory or a
    temporary file. ``mapped``: the file of this path as a mapping (see MappedSource).
    """
    if isinstance(file, str) and is_url(file):
        from .remote import RemoteSource, shown

        if mapped:
            raise ParameterError("only a local file can be mapped")
        if spool:
            return StreamSource(spooled_url(file), shown(file), owned=True)
        return RemoteSource(file)
    if mapped:
        if not isinstance(file, (str, os.PathLike)):
            raise ParameterError("only a file with a path can be mapped")
        return MappedSource(os.fspath(file))
    if isinstance(file, (bytes, bytearray, memoryview)):
        return BytesSource(bytes(file))
    if isinstance(file, (str, os.PathLike)):
        return source_of(Path(file).open("rb"), os.fspath(file), owned=True)
    name = getattr(file, "name", None)
    return source_of(file, name if isinstance(name, str) else None, owned=False)


def is_url(text: str) -> bool:
    """Whether a text names something that is not in the file system; a Path never does."""
    return URL.match(text) is not None


def source_of(stream: BinaryIO, path: str | None, *, owned: bool) -> Source:
    # Another kind of stream may have a descriptor, and yet other bytes than stand behind it.
    if isinstance(stream, (io.BufferedReader, io.FileIO)) and hasattr(os, "pread"):
        with_descriptor = stream
        if stat.S_ISREG(os.fstat(with_descriptor.fileno()).st_mode):
            return FileSource(with_descriptor, path, owned=owned)
    if stream.seekable():
        return StreamSource(stream, path, owned=owned)
    spooled = spooled_copy(stream)
    if owned:
        stream.close()
    return StreamSource(spooled, path, owned=True)


def spooled_copy(stream: BinaryIO) -> BinaryIO:
    """All of a stream, in memory or in a temporary file."""
    spool = tempfile.SpooledTemporaryFile(max_size=SPOOL_SIZE)  # noqa: SIM115
    shutil.copyfileobj(stream, spool)
    return spool  # type: ignore[return-value]


def spooled_url(url: str) -> BinaryIO:
    """All that stands behind a URL, copied the same way."""
    from .remote import streamed

    with streamed(url) as stream:
        return spooled_copy(stream)
