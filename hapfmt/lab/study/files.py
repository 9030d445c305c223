"""Files that a study names: regular files of bounded size alone, so that reading them ends."""

from __future__ import annotations

import os
import stat
from io import BufferedReader
from pathlib import Path

from ...errors import ParameterError

LARGEST = 1 << 32
"""Bytes of a recording. All of it is read into memory."""


def open_regular(path: str | Path, largest: int = LARGEST) -> BufferedReader:
    """Open for reading. A device, a pipe or a folder is refused; nothing waits for a pipe."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
    descriptor = os.open(path, flags | getattr(os, "O_BINARY", 0))
    try:
        refuse_special(descriptor, path, largest)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def refuse_special(descriptor: int, path: str | Path, largest: int) -> None:
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        raise ParameterError("is not a regular file", path=str(path))
    if found.st_size > largest:
        raise ParameterError(
            f"has {found.st_size} bytes; at most {largest} are read", path=str(path)
        )
