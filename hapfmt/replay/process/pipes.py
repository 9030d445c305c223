"""Both ends of a pipe, without ever waiting for the other side unasked.

Where the system can, pipes are set not to block; elsewhere (Windows) a thread stands at each.
"""

from __future__ import annotations

import os
import select
import sys
import threading
from contextlib import suppress

from .messages import Inbox, Message

CHUNK = 1 << 16
PENDING_LIMIT = 1 << 23
"""Bytes that the other side may leave unread."""


class Inlet:
    """Messages that have come; ``ended`` once nothing more will."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor, self.inbox, self.ended = descriptor, Inbox(), False
        os.set_blocking(descriptor, False)

    def take(self) -> Message | None:
        """The next whole message, if it is there. Raises MessageError."""
        message = self.inbox.take()
        if message is None and not self.ended:
            data = self.read()
            if data is not None:
                self.inbox.feed(data)
                self.ended = not data
                message = self.inbox.take()
        return message

    def read(self) -> bytes | None:
        """What is there; None: nothing now; empty: the end."""
        try:
            return os.read(self.descriptor, CHUNK)
        except BlockingIOError:
            return None
        except OSError:
            return b""

    def wait(self, seconds: float) -> None:
        """Until something comes, the end does, or the time is over."""
        if seconds > 0 and not self.ended:
            select.select([self.descriptor], [], [], seconds)


class ThreadedInlet(Inlet):
    def __init__(self, descriptor: int) -> None:
        self.descriptor, self.inbox, self.ended = descriptor, Inbox(), False
        self.chunks: list[bytes] = []
        self.came = threading.Event()
        threading.Thread(target=self.run, daemon=True).start()

    def run(self) -> None:
        while True:
            try:
                data = os.read(self.descriptor, CHUNK)
            except OSError:
                data = b""
            self.chunks.append(data)
            self.came.set()
            if not data:
                return

    def read(self) -> bytes | None:
        self.came.clear()
        return self.chunks.pop(0) if self.chunks else None

    def wait(self, seconds: float) -> None:
        if seconds > 0 and not self.ended and not self.chunks:
            self.came.wait(seconds)


class Outlet:
    """Bytes on their way; ``broken`` once nobody reads them, or too many wait."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor, self.waiting, self.broken = descriptor, bytearray(), False
        os.set_blocking(descriptor, False)

    def send(self, data: bytes) -> None:
        if not self.broken:
            self.waiting += data
            self.flush()

    def flush(self) -> None:
        """As much as the pipe takes now."""
        try:
            while self.waiting:
                del self.waiting[: os.write(self.descriptor, self.waiting[:CHUNK])]
        except BlockingIOError:
            self.broken = len(self.waiting) > PENDING_LIMIT
        except OSError:
            self.broken = True

    def close(self) -> None:
        """Nothing more goes; the descriptor may be closed then."""
        self.broken = True

    def drain(self, seconds: float) -> None:
        """Waits for the other side, so long at most."""
        while self.waiting and not self.broken and seconds > 0:
            with suppress(OSError):
                select.select([], [self.descriptor], [], 0.05)
            seconds -= 0.05
            self.flush()


class ThreadedOutlet(Outlet):
    def __init__(self, descriptor: int) -> None:
        self.descriptor, self.waiting, self.broken = descriptor, bytearray(), False
        self.changed = threading.Condition()
        threading.Thread(target=self.run, daemon=True).start()

    def flush(self) -> None:
        with self.changed:
            self.broken = self.broken or len(self.waiting) > PENDING_LIMIT
            self.changed.notify_all()

    def send(self, data: bytes) -> None:
        with self.changed:
            self.waiting += data
        self.flush()

    def close(self) -> None:
        with self.changed:
            self.broken = True
            self.changed.notify_all()

    def run(self) -> None:
        while True:
            with self.changed:
                self.changed.wait_for(lambda: bool(self.waiting) or self.broken)
                if self.broken:
                    return
                data = bytes(self.waiting[:CHUNK])
            try:
                written = os.write(self.descriptor, data)
            except OSError:
                self.broken = True
                return
            with self.changed:
                del self.waiting[:written]
                self.changed.notify_all()

    def drain(self, seconds: float) -> None:
        with self.changed:
            self.changed.wait_for(lambda: self.broken or not self.waiting, seconds)


def inlet(descriptor: int) -> Inlet:
    return ThreadedInlet(descriptor) if sys.platform == "win32" else Inlet(descriptor)


def outlet(descriptor: int) -> Outlet:
    return ThreadedOutlet(descriptor) if sys.platform == "win32" else Outlet(descriptor)
