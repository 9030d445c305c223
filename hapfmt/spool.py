"""Where the samples of a recording are kept: in memory, or in a temporary file that is mapped.

What a :class:`Spool` keeps are arrays as any other. Their pages are read when they are touched, and
:func:`release` gives those of all spools back, so that a long recording takes little memory.
"""

from __future__ import annotations

import errno
import mmap
import os
import shutil
import tempfile
import threading
import weakref
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

IN_MEMORY = 32 << 20
"""Bytes that stay in memory; what comes after them goes to the disk."""

PART = 64 << 20
"""Bytes of a file at least. A file takes a descriptor, so the later ones are larger."""

TOGETHER = 1 << 20
"""Bytes of a growing array that go to the disk together."""

ALIGNED = 64

_mapped: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()
_mapping = threading.Lock()


class Memory:
    """Arrays in memory."""

    on_disk = False

    def empty(self, count: int, dtype: DTypeLike) -> NDArray[Any]:
        """[count] values of any content."""
        return np.empty(count, dtype)

    def kept(self, array: NDArray[Any]) -> NDArray[Any]:
        """The same values; the array itself is not needed any more."""
        return array


class Spool(Memory):
    """Arrays on the disk, but for the first of them. A file has no name, and goes when the last of
    its arrays does.

    Raises OSError where the disk is full.
    """

    on_disk = True

    def __init__(self, in_memory: int = IN_MEMORY) -> None:
        self._left = in_memory
        self._size = 0
        self._file: mmap.mmap | None = None
        self._at = 0
        self._lock = threading.Lock()

    def empty(self, count: int, dtype: DTypeLike) -> NDArray[Any]:
        dtype = np.dtype(dtype)
        size = count * dtype.itemsize
        with self._lock:
            if size <= self._left:
                self._left -= size
                return np.empty(count, dtype)
            if self._file is None or self._at + size > len(self._file):
                part = max(PART, self._size // 4, size)
                self._file, self._at = mapped(part), 0
                self._size += part
            at, self._at = self._at, self._at + -(-size // ALIGNED) * ALIGNED
            return np.frombuffer(self._file, dtype, count, at)

    def kept(self, array: NDArray[Any]) -> NDArray[Any]:
        if is_mapped(array):
            return array
        with self._lock:
            if array.nbytes <= self._left:
                self._left -= array.nbytes
                return array
        out = self.empty(array.size, array.dtype).reshape(array.shape)
        out[...] = array
        release()
        return out


MEMORY = Memory()


class GrowingArray:
    """Rows that come piece by piece and end as one array, without both in memory at once: a
    bytearray grows by an eighth, and large ones are moved by the operating system, not copied. A
    ``store`` on the disk gets parts of it meanwhile, in one piece where ``expected`` rows, or a
    little less, are all that come."""

    def __init__(self, store: Memory = MEMORY, expected: int = 0) -> None:
        self.store, self.expected = store, expected
        self.parts: list[NDArray[np.uint8]] = []
        self.room: bytearray | None = None
        self.first: NDArray[Any] | None = None
        """All rows, where they come in one piece."""
        self.reserved = self.filled = 0
        """Bytes of the last part, which is filled piece by piece."""

    def append(self, rows: NDArray[Any]) -> None:
        """rows [ticks, ...], of one dtype and width throughout."""
        if self.first is None:
            self.first = rows
            return
        if self.room is None:
            self.room = bytearray(np.ascontiguousarray(self.first).data.cast("B"))
            self.reserved = self.expected * (len(self.room) // max(len(self.first), 1))
            self.first = self.first[:0].copy()
        self.room += np.ascontiguousarray(rows).data.cast("B")
        if self.store.on_disk and len(self.room) >= TOGETHER:
            self.store_room(self.room)

    def store_room(self, room: bytearray) -> None:
        size = len(room)
        if self.filled + size > self.reserved:
            self.cut()
            self.reserved = size
        if not self.filled:
            self.parts.append(self.store.empty(self.reserved, np.uint8))
        self.parts[-1][self.filled : self.filled + size] = np.frombuffer(room, np.uint8)
        self.filled += size
        self.room = bytearray()
        release()

    def cut(self) -> None:
        """End the last part where it is filled."""
        if self.parts and self.filled:
            self.parts[-1] = self.parts[-1][: self.filled]
        self.filled = 0

    def joined(self) -> NDArray[Any] | None:
        """All rows; None where there were none. Nothing is appended after that."""
        if self.room is None or self.first is None:
            first = self.first
            return first if first is None or first.flags.writeable else first.copy()
        if self.parts and self.room:
            self.store_room(self.room)
        self.cut()
        if len(self.parts) > 1:
            whole, at = self.store.empty(sum(map(len, self.parts)), np.uint8), 0
            for part in self.parts:
                whole[at : at + len(part)] = part
                at += len(part)
                release()
            self.parts = [whole]
        held = self.parts[0] if self.parts else self.room
        return np.frombuffer(held, self.first.dtype).reshape(-1, *self.first.shape[1:])


def mapped(size: int) -> mmap.mmap:
    """Map a temporary file of this size, whose disk space is there."""
    folder = tempfile.gettempdir()
    with tempfile.TemporaryFile(prefix="hapfmt-") as file:
        try:
            if shutil.disk_usage(folder).free < size:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            file.truncate(size)
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            found = mmap.mmap(file.fileno(), size)
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            text = f"{size} bytes of samples do not fit this folder; TMPDIR names another"
            raise OSError(errno.ENOSPC, text, folder) from None
    with _mapping:
        _mapped.add(found)
    return found


def is_mapped(array: NDArray[Any]) -> bool:
    """Whether an array lies in a mapped file."""
    base: object = array
    while isinstance(base, np.ndarray):
        base = base.base
    return isinstance(base.obj if isinstance(base, memoryview) else base, mmap.mmap)


def release() -> None:
    """Give back the memory of all that is on the disk; it is read again when it is touched."""
    if hasattr(mmap, "MADV_DONTNEED"):
        with _mapping:  # another thread may map a file meanwhile
            files = list(_mapped)
        for file in files:
            with suppress(ValueError, OSError):
                file.madvise(mmap.MADV_DONTNEED)
