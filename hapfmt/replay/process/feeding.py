"""Blocks ahead of their time: rendered in a thread, a second of them at most."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from ...reading.seconds import Seconds
from ..frames import Block
from . import virtual
from .blocks import parts

WAITING = 32
"""Blocks of some 50 ms each."""


class Place(Protocol):
    """Which time through the recording, and where in it."""

    @property
    def loop(self) -> int: ...

    @property
    def seconds(self) -> Seconds | None: ...


class Source(virtual.Source, Protocol):
    """A Renderer that seeks."""

    def blocks(
        self, first: int = 0, generation: int = 0, at: Seconds | None = None, loop: int = 0
    ) -> Iterator[Block]: ...

    def position(self, sample: int) -> Place: ...


class Feed:
    """One generation: what is played from one position on. ``error``: what ended it early."""

    def __init__(
        self,
        source: Source,
        actuators: int,
        generation: int = 0,
        at: Seconds | None = None,
        loop: int = 0,
        before: Feed | None = None,
    ) -> None:
        self.source, self.generation, self.at, self.loop = source, generation, at, loop
        self.actuators = actuators
        self.ready: queue.Queue[Block] = queue.Queue(WAITING)
        self.head: Block | None = None
        self.begun = False
        """What the source says of positions is about this generation."""
        self.halted = threading.Event()
        self.error: BaseException | None = None
        self.thread = threading.Thread(target=self.run, args=(before,), daemon=True)
        self.thread.start()

    def run(self, before: Feed | None) -> None:
        if before is not None:
            before.halt()
            before.thread.join()
        stop = 0
        try:
            for block in self.source.blocks(0, self.generation, self.at, self.loop):
                self.begun = True
                for part in parts(block):
                    if not self.put(part):
                        return
                stop = block.first + len(block.values)
                if block.last:
                    return
        except BaseException as error:
            self.error = error
        shape = (0, self.actuators)
        nothing = Block(stop, np.zeros(shape), np.zeros(shape, bool), self.generation, last=True)
        self.put(nothing)

    def put(self, block: Block) -> bool:
        """Waits for room; False once nobody wants it."""
        while not self.halted.is_set():
            try:
                self.ready.put(block, timeout=0.05)
                return True
            except queue.Full:
                continue
        return False

    def take(self, before: int) -> Block | None:
        """The next block, if it is there and begins earlier than sample ``before``."""
        if self.head is None:
            try:
                self.head = self.ready.get_nowait()
            except queue.Empty:
                return None
        if self.head.first >= before:
            return None
        block, self.head = self.head, None
        return block

    def halt(self) -> None:
        self.halted.set()
