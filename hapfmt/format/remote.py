"""Bytes behind a URL, through fsspec.

fsspec asks for whole blocks, one by one, and keeps the blocks used last, CACHE bytes of them. The
size of a block is measured: a few channels or seconds take two or three requests.
"""

from __future__ import annotations

import errno
import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any, BinaryIO, cast
from urllib.parse import urlsplit

from ..errors import HapfmtError, MissingExtraError, ParameterError

BLOCK = 1 << 18
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
            # Never a damage of the file: it is not what the server said it was.
            message = f"{len(data)} bytes came where {size} were asked for"
            raise OSError(errno.EIO, message, self.path)
        return data

    def close(self) -> None:
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


@contextmanager
def streamed(url: str) -> Iterator[BinaryIO]:
    """All that stands behind a URL, from the first byte to the last."""
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
