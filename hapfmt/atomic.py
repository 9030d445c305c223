"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import BinaryIO, cast

from .errors import ParameterError
from .lock import in_use


@contextmanager
def atomic_write(path: str | os.PathLike[str], *, force: bool = False) -> Iterator[BinaryIO]:
    """A binary stream (read, write, seek) that becomes ``path`` when the block ends well.

    The bytes go to a temporary name in the same directory, reach the disk (fsync), and take the
    name in one step; on any exception the temporary file is removed and ``path`` is as before.
    Permissions are those of any new file (umask); a symbolic link stays, its target is replaced.

    Raises ParameterError where ``path`` exists (unless ``force``), is being recorded, is a
    directory or a device, or lies in no directory; OSError, with ``path`` as its file name, where
    the system refuses.
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


def target(
    file: str | os.PathLike[str] | BinaryIO, force: bool
) -> AbstractContextManager[BinaryIO]:
    """A stream for a path, written atomically, or the stream that is given."""
    if isinstance(file, (str, os.PathLike)):
        return atomic_write(file, force=force)
    return nullcontext(file)


def refuse(name: str, force: bool) -> None:
    """Raise ParameterError where nothing may be written at ``name``."""
    path = Path(name)
    if not name or path.name in ("", ".."):
        raise ParameterError("this is not the name of a file", path=name or "''")
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        parent = Path(os.path.realpath(name)).parent
        if not parent.is_dir():
            raise ParameterError(
                "the directory it should lie in does not exist", path=name
            ) from None
        return
    if stat.S_ISDIR(mode):
        raise ParameterError("the output is a directory", path=name)
    if not stat.S_ISREG(mode):
        raise ParameterError("not a regular file, so it cannot be replaced", path=name)
    if not force:
        raise ParameterError("exists already; it is replaced only with force", path=name)
    if in_use(path):
        raise ParameterError("is being written by another program", path=name)


def sync_directory(directory: Path) -> None:
    """Make the new name itself durable, where the system can (POSIX)."""
    with suppress(OSError):
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
