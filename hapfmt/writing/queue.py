"""What the caller hands over and the thread takes, in order, within a bound of bytes."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Generic, TypeVar

Queued = TypeVar("Queued")

OVERHEAD = 256
"""Bytes that an item takes beside its samples: two objects of Python and their places."""


class Queue(Generic[Queued]):
    """Items with their sizes. What the taker holds counts until it takes the next.

    The taker is woken when asked, or when half of the room is used: samples that complete nothing
    can wait.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.size = 0
        self.blocked_s = 0.0
        self.error: BaseException | None = None
        self.items: deque[tuple[Queued, int]] = deque()
        self.put_count = self.done_count = 0
        self.held: int | None = None
        self.woken = False
        self.condition = threading.Condition()

    def put(self, item: Queued, size: int = 0, *, wake: bool = False, wait: bool = True) -> bool:
        """Whether there was room; ``wait`` for it. An item alone always has room.

        Raises what the taker failed with.
        """
        size += OVERHEAD
        with self.condition:
            if not self.has_room(size):
                self.wake()
                if not wait:
                    return False
                began = time.monotonic()
                try:
                    self.condition.wait_for(lambda: self.has_room(size))
                finally:
                    self.blocked_s += time.monotonic() - began
            self.refuse()
            self.items.append((item, size))
            self.put_count += 1
            self.size += size
            if wake or 2 * self.size > self.limit:
                self.wake()
        return True

    def has_room(self, size: int) -> bool:
        return self.error is not None or not self.size or self.size + size <= self.limit

    def refuse(self) -> None:
        if self.error is not None:
            raise self.error

    def wake(self) -> None:
        if not self.woken:
            self.woken = True
            self.condition.notify_all()

    def join(self) -> None:
        """Wait until all that was put so far is done; raises what the taker failed with."""
        with self.condition:
            count = self.put_count
            self.wake()
            self.condition.wait_for(lambda: self.error or self.done_count >= count)
            self.refuse()

    def take(self, timeout: float) -> Queued | None:
        """The next item; None where nothing came in so many seconds. The one before is done."""
        with self.condition:
            if self.held is not None:
                self.size -= self.held
                self.done_count += 1
                self.held = None
                self.condition.notify_all()
            self.woken = self.woken and bool(self.items)
            if not self.woken:
                self.condition.wait_for(lambda: self.woken, timeout)
            if not self.items:
                return None
            self.woken = True
            item, self.held = self.items.popleft()
            return item

    def fail(self, error: BaseException) -> None:
        """Raise this from every put and join to come; what was not taken yet is given up."""
        with self.condition:
            self.error = error
            self.items.clear()
            self.size = 0
            self.held = None
            self.condition.notify_all()
