"""Bytes behind a URL, through fsspec: as few requests as needed, and never more than stated here.

A request asks for whole blocks: at most one block before and one after what is wanted. While
reading goes on exactly where the last request ended, each request takes as much again as was read
so far in a row, up to AHEAD. What came is kept, the newest CACHE bytes of it.
"""

from __future__ import annotations

import errno
import io
import threading
from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, BinaryIO, cast
from urllib.parse import urlsplit

from ..errors import HapfmtError, MissingExtraError, ParameterError
from .source import spooled_copy

BLOCK = 1 << 14
"""Bytes that are asked for and kept together."""
AHEAD = 1 << 20
CACHE = 1 << 22
GAP = 1 << 16
"""A request takes about as long as so many bytes (10 ms, 50 Mbit/s)."""

NO_PARTS = (
    "the server gives whole files only, not parts of them (no range requests); fetch the file "
    "first, or let it be copied: Reader(url, spool=True)"
)


class RemoteSource:
    gap = GAP

    def __init__(self, url: str) -> None:
        self.path: str | None = shown(url)
        self.lock = threading.Lock()
        self.blocks: OrderedDict[int, bytes] = OrderedDict()
        self.next = self.streak = 0
        with network(self.path):
            self.files, self.stream = open_url(url, cache_type="none")
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
        stop = min(offset + size, self.size)
        if offset >= stop:
            return b""
        offset = max(offset, 0)
        first, last = offset // BLOCK, (stop - 1) // BLOCK
        with self.lock:
            parts = self.take(first, last)
        data = b"".join(parts)
        return data[offset - first * BLOCK : stop - first * BLOCK]

    def take(self, first: int, last: int) -> list[bytes]:
        """Blocks ``first`` to ``last``: those that are kept, the others by one request."""
        missing = [number for number in range(first, last + 1) if number not in self.blocks]
        fetched: dict[int, bytes] = {}
        if missing:
            low, high = missing[0], missing[-1] + 1
            self.streak = self.streak if low == self.next else 0
            high = min(high + min(self.streak, AHEAD // BLOCK), -(-self.size // BLOCK))
            data = self.fetch(low * BLOCK, min(high * BLOCK, self.size))
            self.next, self.streak = high, self.streak + missing[-1] + 1 - low
            fetched = {
                number: data[(number - low) * BLOCK : (number - low + 1) * BLOCK]
                for number in range(low, high)
            }
        parts = []
        for number in range(first, last + 1):
            if number in fetched:
                parts.append(fetched[number])
            else:
                self.blocks.move_to_end(number)
                parts.append(self.blocks[number])
        for number, block in list(fetched.items())[-(CACHE // BLOCK) :]:
            self.blocks[number] = block
            self.blocks.move_to_end(number)
        while len(self.blocks) > CACHE // BLOCK:
            self.blocks.popitem(last=False)
        return parts

    def fetch(self, start: int, stop: int) -> bytes:
        with network(self.path):
            self.stream.seek(start)
            data = self.stream.read(stop - start)
        if len(data) != stop - start:
            # Never a damage of the file: it is not what the server said it was.
            message = f"{len(data)} bytes came where {stop - start} were asked for"
            raise OSError(errno.EIO, message, self.path)
        return data

    def close(self) -> None:
        self.blocks.clear()
        self.stream.close()


@contextmanager
def network(path: str | None) -> Iterator[None]:
    """Whatever fails on the way to a URL is an OSError that names it, never damage of the file."""
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
    """What the innermost error says: fsspec calls whatever fails at first "not found"."""
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


def spool_url(url: str) -> tuple[BinaryIO, str]:
    """All that stands behind a URL, and how to name it."""
    with network(shown(url)):
        _files, stream = open_url(url, block_size=0)
        with stream:
            return spooled_copy(stream), shown(url)


def shown(url: str) -> str:
    """The URL without a password in it."""
    parts = urlsplit(url)
    if "@" not in parts.netloc:
        return url
    return parts._replace(netloc=parts.netloc.rsplit("@", 1)[1]).geturl()
