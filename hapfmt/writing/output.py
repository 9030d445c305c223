"""Where a recording goes: a file that grows and survives, or a stream that is only written."""

from __future__ import annotations

from contextlib import suppress
from typing import BinaryIO, Protocol

from .filewriter import FileWriter
from .file import LiveFile, SyncPolicy


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


class Output:
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
        """After an error: what stands in the file stays; with index and footer where asked."""
        with suppress(Exception):
            if close:
                self.writer.close()
        with suppress(Exception):
            self.target.close()
