"""Random access to bytes of memory, a file, a mapping, a pipe or a URL, from any thread.

URLs are read through fsspec. It requests whole blocks, one by one, and keeps the CACHE bytes of
blocks that were used last. The size of a block was chosen by measurement: reading a few channels or
seconds takes two or three requests.
"""

from __future__ import annotations

import errno
import io
import mmap
import os
import re
import shutil
import stat
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Protocol, cast
from urllib.parse import urlsplit

from ..errors import HapfmtError, MissingExtraError, ParameterError

BLOCK = 1 << 18
CACHE = 1 << 22
GAP = 1 << 16
"""A request takes about as long as the transfer of this many bytes (10 ms, 50 Mbit/s)."""

NO_PARTS = (
    "the server gives whole files only, not parts of them (no range requests); fetch the file "
    "first, or let it be copied: Reader(url, spool=True)"
)


class RemoteSource:
    gap = GAP

    def __init__(self, url: str) -> None:
        self.path: str | None = shown(url)
        self.lock = threading.Lock()
        with network(self.path):
            self.files, self.stream = open_url(
                url,
                cache_type="blockcache",
                cache_options={"maxblocks": CACHE // BLOCK},
                block_size=BLOCK,
            )
        try:
            with network(self.path):
                size = getattr(self.stream, "size", None)
                self.size = self.stream.seek(0, io.SEEK_END) if size is None else int(size)
            # The end is needed anyway, and tells whether parts can be had.
            self.read_at(self.size - 1, 1)
        except BaseException:
            self.stream.close()
            raise

    def read_at(self, offset: int, size: int) -> bytes:
        size = min(size, self.size - offset)
        if size <= 0:
            return b""
        with self.lock, network(self.path):
            self.stream.seek(offset)
            data = self.stream.read(size)
        if len(data) != size:
            # Not damage of the file: the server delivered something else than it announced.
            message = f"{len(data)} bytes came where {size} were asked for"
            raise OSError(errno.EIO, message, self.path)
        return data

    def close(self) -> None:
        self.stream.close()


@contextmanager
def network(path: str | None) -> Iterator[None]:
    """Failures while reading a URL become an OSError that names it, never damage of the file."""
    try:
        yield
    except HapfmtError:
        raise
    except ImportError as error:
        raise missing(error) from None
    except PermissionError as error:
        raise PermissionError(errno.EACCES, reason(error), path) from error
    except Exception as error:
        cause = error.__cause__
        status = getattr(cause, "status", None if cause else 404)
        if isinstance(error, FileNotFoundError) and status in (404, 410):
            raise FileNotFoundError(errno.ENOENT, "not found", path) from error
        words = str(error) if isinstance(error, ValueError) else ""
        no_parts = "range requests" in words or "streaming" in words
        raise OSError(errno.EIO, NO_PARTS if no_parts else reason(error), path) from error


def missing(error: ImportError) -> ParameterError:
    """Each kind of URL has a package of its own, which fsspec looks for."""
    cause = error.__cause__ if isinstance(error.__cause__, ImportError) else error
    name = (cause.name or str(error)).split(".")[0]
    if name in ("fsspec", "aiohttp"):
        return MissingExtraError(name, "remote")
    return ParameterError(f"this needs the package {name!r}; install it with: pip install {name}")


def reason(error: BaseException) -> str:
    """The text of the innermost error: fsspec reports any first failure as "not found"."""
    inner = error.__cause__ or error
    status = getattr(inner, "status", None)
    if status:
        return f"the server answers {status} {getattr(inner, 'message', '')}".strip()
    return f"{type(inner).__name__}: {inner}" if str(inner) else type(inner).__name__


def open_url(url: str, **options: Any) -> tuple[object, BinaryIO]:
    """A file system of fsspec, which closes its files when it goes, and an open file.

    What is compressed on the way has no places: that is declined.
    """
    core = import_module("fsspec.core")
    headers = {"headers": {"Accept-Encoding": "identity"}} if url[:4].lower() == "http" else {}
    try:
        files, path = core.url_to_fs(url, **headers)
    except ValueError as error:
        raise ParameterError(f"{shown(url)}: {error}") from None
    return files, cast("BinaryIO", files.open(path, "rb", **options))


@contextmanager
def streamed(url: str) -> Iterator[BinaryIO]:
    """All bytes of a URL, from the first to the last."""
    with network(shown(url)):
        _files, stream = open_url(url, block_size=0)
        with stream:
            yield stream


def shown(url: str) -> str:
    """The URL without a password in it."""
    parts = urlsplit(url)
    if "@" not in parts.netloc:
        return url
    return parts._replace(netloc=parts.netloc.rsplit("@", 1)[1]).geturl()


SPOOL_SIZE = 1 << 24
"""A pipe is kept in memory up to this size, then in a temporary file."""

MEMORY_GAP, FILE_GAP = 1 << 12, 1 << 14
"""Bytes that take as long as one more read call with its Python overhead (measured): copied from
memory, or read from a file, and their CRC computed."""

URL = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]+(://|::)")


class ByteSource(Protocol):
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

    Only for a file that no program cuts meanwhile: to touch a page beyond its end kills the process
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
) -> ByteSource:
    """A Source for a path, a URL, bytes, or an open binary stream.

    A pipe is spooled first; a URL too, where ``spool`` says so: copied whole into memory or a
    temporary file. ``mapped``: the file of this path as a mapping (see MappedSource).
    """
    if isinstance(file, str) and is_url(file):
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
    if not hasattr(file, "read"):
        raise ParameterError(
            f"a file is a path, a URL, bytes or a binary stream, not a {type(file).__name__}"
        )
    name = getattr(file, "name", None)
    return source_of(file, name if isinstance(name, str) else None, owned=False)


def is_url(text: str) -> bool:
    """Whether a text names something that is not in the file system; a Path never does."""
    return URL.match(text) is not None


def source_of(stream: BinaryIO, path: str | None, *, owned: bool) -> ByteSource:
    # Another kind of stream may have a descriptor, yet deliver other bytes than its file has.
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
    """All bytes of a URL, copied the same way."""

    with streamed(url) as stream:
        return spooled_copy(stream)
