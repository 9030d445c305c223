"""One writer at a time: a lock on an open file, which the system drops with the process."""

from __future__ import annotations

import errno
import importlib
import os
from types import ModuleType

FAR = 1 << 43
"""Where Windows locks a byte: 8 TiB, beyond every file, so that readers are not kept out."""

TAKEN = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
MISSING = {
    errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF
}  # fmt: skip
"""EBADF: over a network, where the file is open for reading only."""


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
    """Whether a writer has the file; False where nobody can tell."""
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
