"""Files that are written completely or not at all, locks on them, and objects that must be closed.

A lock on the open file admits one writer at a time. The operating system releases the lock when the
process ends. A ``Closing`` object is closed when its ``with`` block ends.
"""

from __future__ import annotations

import errno
import importlib
import os
import secrets
import shutil
import stat
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path
from types import ModuleType, TracebackType
from typing import BinaryIO, Self, cast

from .errors import ParameterError

FAR = 1 << 43
"""Where Windows locks a byte: 8 TiB, beyond every file, so that readers are not kept out."""

TAKEN = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
MISSING = {
    errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF
}  # fmt: skip
"""EBADF: over a network, where the file is open for reading only."""


@cache
def optional(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def lock(descriptor: int) -> bool | None:
    """Whether the lock was taken; None where the file system has none. It ends with unlock, when
    the descriptor is closed, or with the process."""
    fcntl, msvcrt = optional("fcntl"), optional("msvcrt")
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        elif msvcrt is not None:
            lock_far(msvcrt, msvcrt.LK_NBLCK, descriptor)
        else:
            return None
    except OSError as error:
        if error.errno in TAKEN:
            return False
        if error.errno in MISSING:
            return None
        raise
    return True


def unlock(descriptor: int) -> None:
    fcntl, msvcrt = optional("fcntl"), optional("msvcrt")
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)
    elif msvcrt is not None:
        lock_far(msvcrt, msvcrt.LK_UNLCK, descriptor)


def in_use(path: str | os.PathLike[str]) -> bool:
    """True if a writer has locked the file; False also where the system has no locks."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        return lock(descriptor) is False
    except OSError:
        return False
    finally:
        os.close(descriptor)


def lock_far(msvcrt: ModuleType, mode: int, descriptor: int) -> None:
    position = os.lseek(descriptor, 0, os.SEEK_CUR)
    try:
        os.lseek(descriptor, FAR, os.SEEK_SET)
        msvcrt.locking(descriptor, mode, 1)
    finally:
        os.lseek(descriptor, position, os.SEEK_SET)


@contextmanager
def atomic_write(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[BinaryIO]:
    """A binary stream (read, write, seek) that becomes ``path`` when the block ends well.

    The bytes go to a temporary name in the same directory, reach the disk (fsync), and take the
    name in one step; on any exception the temporary file is removed and ``path`` is as before.
    Permissions are those of any new file (umask); a symbolic link stays, its target is replaced.

    Raises ParameterError if ``path`` exists or is a dangling symbolic link, unless ``force``.
    Raises it as well if ``path`` is being recorded, is a directory or a device, or its directory
    does not exist. Raises OSError, with ``path`` as its file name, if the system refuses.
    """
    name = os.fspath(path)
    refuse(name, force)
    target = Path(os.path.realpath(name))
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        descriptor = os.open(temporary, flags, 0o666)
    except OSError as error:
        raise OSError(error.errno, error.strerror, name) from error
    stream = os.fdopen(descriptor, "w+b")
    try:
        yield cast(BinaryIO, stream)
        stream.flush()
        os.fsync(stream.fileno())
        stream.close()
        refuse(name, force)
        temporary.replace(target)
    except BaseException:
        # A full disk fails again in close(); the first error is the one to report.
        with suppress(OSError):
            stream.close()
        with suppress(FileNotFoundError):
            temporary.unlink()
        raise
    sync_directory(target.parent)


@contextmanager
def atomic_folder(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[Path]:
    """A new folder that becomes ``path`` when the block ends well, as :func:`atomic_write` does.

    With ``force`` it replaces a folder. Raises ParameterError where a file has the name.
    """
    target = Path(os.path.realpath(path))
    name = os.fspath(path)
    if target.exists() and not target.is_dir():
        raise refusal(f"{name} is a file; this format is a folder")
    if target.exists() and not force:
        raise refusal(f"{name} already exists; use force=True to overwrite it")
    if not target.parent.is_dir():
        raise refusal(f"{name}: the directory {target.parent} does not exist")
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
    temporary.mkdir()
    try:
        yield temporary
        if target.exists():
            old = target.with_name(f".{secrets.token_hex(8)}.tmp")
            target.replace(old)
            temporary.replace(target)
            shutil.rmtree(old)
        else:
            temporary.replace(target)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    sync_directory(target.parent)


def target(
    file: str | os.PathLike[str] | BinaryIO, force: bool
) -> AbstractContextManager[BinaryIO]:
    """A stream for a path, written atomically, or the given stream itself."""
    if isinstance(file, (str, os.PathLike)):
        return atomic_write(file, force=force)
    return nullcontext(file)


def refuse(name: str, force: bool) -> None:
    """Raise ParameterError where nothing may be written at ``name``."""
    path = Path(name)
    # A Path leaves out a separator at the end.
    as_directory = name.endswith((os.sep, os.altsep or os.sep))
    if not name or path.name in ("", ".."):
        raise ParameterError("not a file name", path=name or "''")
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        if path.is_symlink() and not force:
            # Another user may have chosen its target.
            raise refusal(
                f"{name} is a symbolic link to a file that does not exist; "
                "use force=True to write it"
            ) from None
        if as_directory:
            raise refusal(f"the directory {name} does not exist") from None
        parent = Path(os.path.realpath(name)).parent
        if not parent.is_dir():
            raise refusal(f"{name}: the directory {parent} does not exist") from None
        return
    if stat.S_ISDIR(mode):
        raise refusal(f"{name} is a directory")
    if as_directory:
        raise refusal(f"{name}: {path} is a file, not a directory")
    if not stat.S_ISREG(mode):
        raise refusal(f"{name} is not a regular file and cannot be replaced")
    if not force:
        raise refusal(f"{name} already exists; use force=True to overwrite it")
    if in_use(path):
        raise refusal(f"Another program is writing {name}")


def refusal(message: str) -> ParameterError:
    """An error whose message names the file itself."""
    return ParameterError(message, path="")


def sync_directory(directory: Path) -> None:
    """Write the directory entry to the disk, where the system can (POSIX)."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class Closing(ABC):
    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None: ...
