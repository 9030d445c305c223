"""Random access to bytes of memory, a file, a mapping, a pipe or a URL, from any thread.

URLs are read through fsspec, in blocks. The CACHE bytes of blocks that were used last are kept. The
first request takes the end of the file, where its index is. Blocks that lie side by side come in
one request, and a reader that goes on gets more at once. Opening a file and reading a second of it
takes three requests. A file that changes meanwhile is an error.
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
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Protocol, cast, runtime_checkable
from urllib.parse import urlsplit

from ..errors import HapfmtError, MissingExtraError, ParameterError

BLOCK = 1 << 15
CACHE = 1 << 22
TAIL = 1 << 16
"""Bytes of the first request, the last of the file."""
AHEAD = 1 << 20
"""Bytes of the largest request that a reader in the order of the file gets."""
NEAR = 1 << 18
"""A reader that skips up to this many bytes reads in the order of the file."""
GAP = 1 << 16
"""A request takes about as long as the transfer of this many bytes (10 ms, 50 Mbit/s)."""

CHANGED = "the file changed while it was read"
NO_PARTS = (
    "the server gives whole files only, not parts of them (no range requests); write simplecache:: "
    "before the URL to fetch the whole file first"
)


class RemoteSource:
    gap = GAP

    def __init__(self, url: str) -> None:
        self.path: str | None = shown(url)
        self.lock = threading.Lock()
        self.blocks: OrderedDict[int, bytes] = OrderedDict()
        """By number; the last used is last."""
        self.next = 0
        """The byte after the last request, which was for ``ahead`` blocks."""
        self.ahead = 1
        with network(self.path):
            self.ranges: HttpRanges | StreamRanges = open_ranges(url, self.path)
            try:
                self.size, self.tail = self.ranges.open(TAIL)
            except BaseException:
                self.ranges.close()
                raise
        self.version = self.ranges.version
        """What tells this content of the file from another: its ETag, or its time."""

    def read_at(self, offset: int, size: int) -> bytes:
        size = min(size, self.size - offset)
        if size <= 0:
            return b""
        before_tail = self.size - len(self.tail)
        parts = []
        with self.lock:
            stop = min(offset + size, before_tail)
            if offset < stop:
                wanted = range(offset // BLOCK, -(-stop // BLOCK))
                found = self.blocks_of(wanted)
                joined = b"".join(found) if len(found) > 1 else found[0]
                start = wanted.start * BLOCK
                parts.append(joined[offset - start : stop - start])
        if offset + size > before_tail:
            start = max(offset - before_tail, 0)
            parts.append(self.tail[start : offset + size - before_tail])
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def expect(self, start: int, stop: int) -> None:
        stop = min(stop, self.size - len(self.tail))
        if 0 < stop - start <= self.gap:
            with self.lock:
                self.blocks_of(range(start // BLOCK, -(-stop // BLOCK)))

    def blocks_of(self, wanted: range) -> list[bytes]:
        """These blocks, of which those that are not kept come in one request for each run."""
        found: dict[int, bytes] = {}
        for number in wanted:
            if number in self.blocks:
                self.blocks.move_to_end(number)
                found[number] = self.blocks[number]
            elif number not in found:
                stop = number + 1
                while stop < wanted.stop and stop not in self.blocks:
                    stop += 1
                found |= self.request(number, stop)
        return [found[number] for number in wanted]

    def request(self, first: int, stop: int) -> dict[int, bytes]:
        """The blocks [first, stop), and those behind them if the file is read in its order."""
        before_tail = self.size - len(self.tail)
        in_order = 0 < self.next <= first * BLOCK <= self.next + NEAR
        self.ahead = min(2 * self.ahead, AHEAD // BLOCK) if in_order else 1
        last = max(stop, min(first + self.ahead, -(-before_tail // BLOCK)))
        for number in range(stop, last):
            if number in self.blocks:
                last = number
                break
        start, end = first * BLOCK, min(last * BLOCK, before_tail)
        with network(self.path):
            data = self.ranges.fetch(start, end)
        if len(data) != end - start:
            # Not damage of the file: the server delivered something else than it announced.
            message = f"{len(data)} bytes came where {end - start} were asked for"
            raise OSError(errno.EIO, message, self.path)
        self.next = end
        came = {n: data[n * BLOCK - start : (n + 1) * BLOCK - start] for n in range(first, last)}
        self.blocks |= came
        while len(self.blocks) > CACHE // BLOCK:
            self.blocks.popitem(last=False)
        return came

    def close(self) -> None:
        self.ranges.close()


def changed(path: str | None) -> OSError:
    return OSError(errno.ESTALE, CHANGED, path)


class HttpRanges:
    """Parts of a file of a web server. Each answer tells its version."""

    def __init__(self, files: Any, url: str, path: str | None) -> None:
        self.files = files
        self.url = url
        self.path = path
        self.size = -1
        self.version: tuple[str, ...] = ()

    def open(self, tail: int) -> tuple[int, bytes]:
        """The size of the file, and up to ``tail`` of its last bytes."""
        check = partial(self.check, tail=tail)
        try:
            data: bytes = self.files.cat_file(self.url, start=-tail, raise_for_status=check)
        except Exception:
            if self.size:
                raise
            data = b""  # fsspec refuses what a server answers of an empty file.
        if self.size >= 0:
            return self.size, data
        # A server that gives parts, but not the end of a file of unknown size.
        self.size = int(self.files.info(self.url)["size"])
        return self.size, self.fetch(max(self.size - tail, 0), self.size)

    def fetch(self, start: int, stop: int) -> bytes:
        if start == stop:
            return b""
        found: bytes = self.files.cat_file(
            self.url, start=start, end=stop, raise_for_status=partial(self.check, start=start)
        )
        return found

    async def check(self, response: Any, *, start: int = 0, tail: int = 0) -> None:
        """Called with the headers of each answer, before its content is read."""
        try:
            self.check_answer(response, start, tail)
        except BaseException:
            response.close()
            raise

    def check_answer(self, response: Any, start: int, tail: int) -> None:
        status, headers = response.status, response.headers
        if status in (404, 410):
            raise FileNotFoundError(errno.ENOENT, "not found", self.path)
        part = re.fullmatch(r"bytes (?:(\d+)-\d+|\*)/(\d+|\*)", headers.get("Content-Range", ""))
        total = int(part[2]) if part and part[2] != "*" else -1
        if status == 416 and tail and total == 0:
            self.size = 0
            return
        if status == 416 and not tail:
            raise changed(self.path)
        if status == 200:
            total = int(headers.get("Content-Length", -1))
            if not tail or not 0 <= total <= tail:
                if not tail or headers.get("Accept-Ranges") != "bytes":
                    raise OSError(errno.EIO, NO_PARTS, self.path)
                return
        elif status != 206 or part is None:
            raise OSError(errno.EIO, f"the server answers {status} {response.reason}", self.path)
        elif not tail and int(part[1] or -1) != start:
            raise OSError(errno.EIO, "the server sends another part than was asked for", self.path)
        version = tuple(headers[name] for name in ("ETag", "Last-Modified") if name in headers)[:1]
        if self.version and version != self.version:
            raise changed(self.path)
        if self.size >= 0 and total not in (-1, self.size):
            raise changed(self.path)
        self.version = version
        self.size = max(self.size, total)

    def close(self) -> None:
        """The file system closes its connections."""


VERSION_KEYS = ("ETag", "etag", "generation", "LastModified", "last_modified", "mtime", "created")
"""What file systems call the version of a file, the most certain first."""


SNAPSHOTS = {"s3", "s3a", "simplecache", "filecache"}
"""s3fs names the version in each request; the two caches read a copy of the whole file."""


class StreamRanges:
    """Parts of a file of any other file system, which tells its version before and after."""

    def __init__(self, files: Any, name: str, path: str | None) -> None:
        self.files = files
        self.name = name
        self.path = path
        self.stream: BinaryIO | None = None
        self.version: tuple[str, ...] = ()
        self.size = -1
        self.is_one = bool({*protocols_of(files)} & SNAPSHOTS)
        """Whether the file system itself gives all parts of one version, or an error."""

    def look(self) -> tuple[int, tuple[str, ...]]:
        self.files.invalidate_cache()
        about = self.files.info(self.name)
        version = [str(about[key]) for key in VERSION_KEYS if about.get(key) is not None][:1]
        size = about.get("size")
        return -1 if size is None else int(size), tuple(version)

    def open(self, tail: int) -> tuple[int, bytes]:
        self.size, self.version = self.look()
        self.stream = cast(
            "BinaryIO", self.files.open(self.name, "rb", cache_type="none", block_size=BLOCK)
        )
        size = self.stream.seek(0, io.SEEK_END) if self.size < 0 else self.size
        return size, self.fetch(max(size - tail, 0), size)

    def fetch(self, start: int, stop: int) -> bytes:
        assert self.stream is not None
        self.stream.seek(start)
        data = self.stream.read(stop - start)
        if not self.is_one and self.look() != (self.size, self.version):
            raise changed(self.path)
        return data

    def close(self) -> None:
        if self.stream is not None:
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
    except OSError as error:
        if type(error).__name__ == "FileExpired":  # of s3fs
            raise changed(path) from error
        if error.errno == errno.ESTALE or error.filename == path is not None:
            raise
        raise failure(error, path) from error
    except Exception as error:
        raise failure(error, path) from error


def failure(error: Exception, path: str | None) -> OSError:
    if isinstance(error, PermissionError):
        return PermissionError(errno.EACCES, reason(error), path)
    cause = error.__cause__
    status = getattr(cause, "status", None if cause else 404)
    if isinstance(error, FileNotFoundError) and status in (404, 410):
        return FileNotFoundError(errno.ENOENT, "not found", path)
    words = str(error) if isinstance(error, ValueError) else ""
    no_parts = "range requests" in words or "streaming" in words
    return OSError(errno.EIO, NO_PARTS if no_parts else reason(error), path)


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


def files_of(url: str) -> tuple[Any, str]:
    """A file system of fsspec, and the name of the file in it.

    What is compressed on the way has no places: that is declined.
    """
    core = import_module("fsspec.core")
    headers = {"headers": {"Accept-Encoding": "identity"}} if url[:4].lower() == "http" else {}
    try:
        files, path = core.url_to_fs(url, **headers)
    except ValueError as error:
        raise ParameterError(f"{shown(url)}: {error}") from None
    return files, path


def protocols_of(files: Any) -> tuple[str, ...]:
    return (files.protocol,) if isinstance(files.protocol, str) else tuple(files.protocol)


def open_ranges(url: str, path: str | None) -> HttpRanges | StreamRanges:
    files, name = files_of(url)
    kind = HttpRanges if "http" in protocols_of(files) else StreamRanges
    return kind(files, name, path)


@contextmanager
def streamed(url: str) -> Iterator[BinaryIO]:
    """All bytes of a URL, from the first to the last."""
    with network(shown(url)):
        files, name = files_of(url)
        with files.open(name, "rb", block_size=0) as stream:
            yield cast("BinaryIO", stream)


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


@runtime_checkable
class ByteSource(Protocol):
    """Random access to a file's bytes. ``gap``: as many bytes cost what a further reading costs."""

    path: str | None
    size: int
    gap: int

    def read_at(self, offset: int, size: int) -> bytes:
        """Up to ``size`` bytes from ``offset``; fewer only at the end."""

    def expect(self, start: int, stop: int) -> None:
        """A hint that these bytes are read next; one request may then bring all of them."""

    def close(self) -> None: ...


class LocalSource:
    """One without requests."""

    def expect(self, start: int, stop: int) -> None:
        pass


class BytesSource(LocalSource):
    gap = MEMORY_GAP

    def __init__(self, data: bytes, path: str | None = None) -> None:
        self.data = data
        self.size = len(data)
        self.path = path

    def read_at(self, offset: int, size: int) -> bytes:
        return self.data[offset : offset + size]

    def close(self) -> None:
        pass


class FileSource(LocalSource):
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


class MappedSource(LocalSource):
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


class StreamSource(LocalSource):
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
    file: str | os.PathLike[str] | bytes | BinaryIO | ByteSource,
    *,
    mapped: bool = False,
    spool: bool = False,
) -> ByteSource:
    """A Source for a path, a URL, bytes, an open binary stream, or a Source, which stays itself.

    A pipe is spooled first; a URL too, where ``spool`` says so: copied whole into memory or a
    temporary file. ``mapped``: the file of this path as a mapping (see MappedSource).
    """
    if isinstance(file, LocalSource):
        return cast(ByteSource, file)
    if not isinstance(file, (str, bytes)) and isinstance(file, ByteSource):
        # Slow: it looks for each name of the protocol.
        return file
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
