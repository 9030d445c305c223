"""Output files of a recording: a file that grows, or a stream that is only written.

The file grows under its own name, chunk by chunk, and is whole after each of them, so it survives a
crash.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO, Protocol

from ..errors import ParameterError
from ..files import Closing, lock, refusal, refuse, sync_directory, unlock
from ..format.source import FILE_GAP, LocalSource
from ..format.wire import SIGNATURE
from .filewriter import FileWriter

OPENED = os.O_RDWR | getattr(os, "O_BINARY", 0)
TRIES = 8
"""How often a file is opened again that another program replaces meanwhile."""


class SyncPolicy:
    """When written data must have reached the disk: after each ``"cluster"``, after a number of
    seconds, at ``"close"``, or ``"never"`` (the system decides)."""

    WORDS = ("cluster", "close", "never")

    def __init__(
        self, when: str | float | Fraction = "close", clock: Callable[[], float] = time.monotonic
    ) -> None:
        if isinstance(when, str) and when not in self.WORDS:
            raise ParameterError(f"fsync is one of {', '.join(self.WORDS)}, or seconds")
        if not isinstance(when, str) and not 0 < when < float("inf"):
            raise ParameterError("the time between two fsyncs must be positive")
        self.when = when
        self.clock = clock
        self.last = clock()

    @property
    def at_close(self) -> bool:
        return self.when != "never"

    def due(self) -> bool:
        """Whether to sync after a cluster."""
        if isinstance(self.when, str):
            return self.when == "cluster"
        return self.clock() - self.last >= self.when

    def done(self) -> None:
        self.last = self.clock()


class LiveFile(Closing, LocalSource):
    """Writes at the end of a locked file, and reads anywhere in it.

    A write is in the file as a whole or not at all: after a failed write the file is cut back to
    the end of the last good one. Every OSError carries the file's name. ``size`` is where the next
    write goes.
    """

    whole_writes = True
    gap = FILE_GAP

    def __init__(
        self, descriptor: int, path: str, sync: SyncPolicy, *, temporary: Path | None = None
    ) -> None:
        self.descriptor = descriptor
        self.name = path
        self.path: str | None = path
        self.policy = sync
        self.temporary = temporary
        self.created = False
        self.size = os.fstat(descriptor).st_size
        self.lost_size = 0
        """Bytes of failed writes."""
        self.replaced: int | None = None
        self.closed = False
        self.seeking = threading.Lock()

    def fileno(self) -> int:
        return self.descriptor

    def write(self, data: bytes) -> int:
        """All of ``data`` at the end of the file, or OSError and nothing."""
        rest, position = memoryview(data), self.size
        try:
            while rest:
                count = self.write_at(position, rest)
                if not count:
                    raise OSError(errno.EIO, "the system wrote nothing")
                rest, position = rest[count:], position + count
        except BaseException as error:
            self.lost_size += len(data)
            # A lost disk cannot be cut either: the rest is cut off when the file opens again.
            with suppress(OSError):
                os.ftruncate(self.descriptor, self.size)
            if isinstance(error, OSError):
                error.filename = self.path
            raise
        self.size = position
        if self.temporary and self.size > len(SIGNATURE):
            self.appear()
        return len(data)

    def write_at(self, position: int, data: memoryview) -> int:
        if hasattr(os, "pwrite"):
            return os.pwrite(self.descriptor, data, position)
        with self.seeking:
            os.lseek(self.descriptor, position, os.SEEK_SET)
            return os.write(self.descriptor, data)

    def read_at(self, offset: int, size: int) -> bytes:
        """Up to ``size`` bytes from ``offset``; fewer only at the end."""
        parts = []
        size = min(size, self.size - offset)
        while size > 0:
            with named(self.path):
                part = self.read_some(offset, size)
            if not part:
                break
            parts.append(part)
            offset, size = offset + len(part), size - len(part)
        return b"".join(parts)

    def read_some(self, offset: int, size: int) -> bytes:
        if hasattr(os, "pread"):
            return os.pread(self.descriptor, size, offset)
        with self.seeking:
            os.lseek(self.descriptor, offset, os.SEEK_SET)
            return os.read(self.descriptor, size)

    def trim(self) -> None:
        """Cut off the bytes beyond ``size``."""
        with named(self.path):
            if os.fstat(self.descriptor).st_size > self.size:
                os.ftruncate(self.descriptor, self.size)

    def appear(self) -> None:
        """Take the place of the file that was there."""
        assert self.temporary is not None
        target = Path(os.path.realpath(self.name))
        with named(self.path):
            self.temporary.replace(target)
        self.temporary = None
        if self.replaced is not None:
            os.close(self.replaced)
            self.replaced = None
        if self.policy.at_close:
            sync_directory(target.parent)

    def flush(self) -> None:
        """Nothing waits here: each write has reached the system."""

    def settle(self) -> None:
        """After a cluster: sync where it is due."""
        if self.policy.due():
            self.sync()

    def sync(self) -> None:
        """All bytes to the disk. After an error it is unknown which have reached it."""
        with named(self.path):
            os.fsync(self.descriptor)
        self.policy.done()

    def close(self) -> None:
        """Sync, unlock, close; a new file that nothing was written to is removed."""
        if self.closed:
            return
        self.closed = True
        empty = self.size <= len(SIGNATURE)
        with named(self.path):
            try:
                if self.policy.at_close and not empty:
                    self.sync()
            finally:
                with suppress(OSError):
                    unlock(self.descriptor)
                os.close(self.descriptor)
                if self.replaced is not None:
                    os.close(self.replaced)
                if self.temporary:
                    self.temporary.unlink(missing_ok=True)
                elif self.created and empty:
                    Path(os.path.realpath(self.name)).unlink(missing_ok=True)


@contextmanager
def named(path: str | None) -> Iterator[None]:
    """OSErrors that leave the block carry the name of the file."""
    try:
        yield
    except OSError as error:
        error.filename, error.filename2 = path, None
        raise


def create_live(
    path: str | os.PathLike[str], *, force: bool = False, sync: SyncPolicy | None = None
) -> LiveFile:
    """A new, locked file under its own name from the first byte.

    With ``force`` it replaces an existing file as soon as its HEAD is written.

    Raises ParameterError as atomic_write does, and where another program writes the file.
    """
    name = os.fspath(path)
    refuse(name, force)
    target = Path(os.path.realpath(name))
    sync = sync or SyncPolicy()
    replaced = None
    with named(name):
        if target.exists():
            replaced = os.open(target, os.O_RDONLY | getattr(os, "O_BINARY", 0))
            take(replaced, name)
            if os.name == "nt":
                # What is open cannot be renamed there.
                os.close(replaced)
                target.unlink()
                replaced = None
        place = target if replaced is None else target.with_name(f".{secrets.token_hex(8)}.tmp")
        try:
            descriptor = os.open(place, OPENED | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            refuse(name, force=False)
            raise
        except OSError:
            if replaced is not None:
                os.close(replaced)
            raise
        take(descriptor, name)
        file = LiveFile(descriptor, name, sync, temporary=None if place == target else place)
        file.created, file.replaced = True, replaced
        if place == target and sync.at_close:
            sync_directory(target.parent)
    return file


def open_live(path: str | os.PathLike[str], *, sync: SyncPolicy | None = None) -> LiveFile:
    """An existing file, locked before anything of it is read.

    Raises ParameterError for anything but a regular file, or where another program writes it.
    """
    name = os.fspath(path)
    with named(name):
        for _ in range(TRIES):
            mode = Path(name).stat().st_mode
            if not stat.S_ISREG(mode):
                raise refusal(f"{name} is not a regular file, so nothing can be appended")
            descriptor = os.open(name, OPENED)
            take(descriptor, name)
            if os.path.samestat(os.fstat(descriptor), Path(name).stat()):
                return LiveFile(descriptor, name, sync or SyncPolicy())
            os.close(descriptor)
    raise refusal(f"Another program replaces {name} again and again")


def take(descriptor: int, name: str) -> None:
    """The lock, or the descriptor closed and a refusal."""
    taken = False
    try:
        taken = lock(descriptor) is not False
    finally:
        if not taken:
            os.close(descriptor)
    if not taken:
        raise refusal(f"Another program is writing {name}")


class Target(Protocol):
    """What both have."""

    def write(self, data: bytes, /) -> object: ...
    def sync(self) -> None: ...
    def close(self) -> None: ...


class Pipe:
    """A stream of the caller, who closes it."""

    def __init__(self, stream: BinaryIO) -> None:
        self.stream = stream

    def write(self, data: bytes) -> int:
        """All of it: a raw stream may take less at once."""
        rest = memoryview(data)
        while rest:
            count = self.stream.write(rest)
            rest = rest[len(rest) if count is None else count :]
        return len(data)

    def sync(self) -> None:
        with suppress(AttributeError):
            self.stream.flush()

    def close(self) -> None:
        self.sync()


class RecordingOutput:
    """The writer and what it writes to."""

    def __init__(self, target: LiveFile | Pipe, policy: SyncPolicy) -> None:
        self.target: Target = target
        self.policy = policy
        self.writer: FileWriter

    def settle(self) -> bool:
        """After a cluster: whether all of it is on the disk."""
        if self.policy.due():
            self.sync()
            return True
        return False

    def sync(self) -> None:
        self.target.sync()
        self.policy.done()

    def close(self) -> None:
        try:
            self.writer.close()
        finally:
            self.target.close()

    def give_up(self, *, close: bool) -> None:
        """After an error: the data in the file stays; with index and footer where asked."""
        with suppress(Exception):
            if close:
                self.writer.close()
        with suppress(Exception):
            self.target.close()
