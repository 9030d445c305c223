"""Messages between the processes of a replay: kind, length, payload, sent through pipes.

Neither end of a pipe blocks unless asked to. Pipes are non-blocking where the system supports it;
on Windows a thread serves each end instead.

Messages come from our own processes, but a dying or foreign process can write any bytes. So any
input gives messages or a MessageError, in bounded memory.

Blocks and the log of sent frames are payloads of messages; they are packed here too.
"""

from __future__ import annotations

import json
import os
import select
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import suppress
from enum import IntEnum
from struct import Struct
from typing import Any, NamedTuple

from ...errors import HapfmtError
from ..profile.model import Frame, FrameBlock, HidReport

HEADER = Struct("<BI")
SIZE_LIMIT = 1 << 22
"""Most bytes of a payload: a block of 50 ms takes about 10 kB."""


class MessageError(HapfmtError):
    """What came through a pipe between our processes is none of their messages."""


class Kind(IntEnum):
    SETUP = 1
    """To a process that begins: all it needs to know."""
    READY = 2
    """Back: it can begin, or why not."""
    # from the player to the writer
    BLOCK = 3
    START = 4
    STOP = 5
    PAUSE = 6
    RESUME = 7
    SEEK = 8
    ALIVE = 9
    """Nothing to say; from the watchdog to the writer too."""
    # from the writer to the player
    STATUS = 10
    SENT = 11
    END = 12
    # between writer and watchdog
    BEAT = 13
    GOODBYE = 14
    """From the writer: it ends well. From the watchdog: it was asked to end."""
    TRIPPED = 15


class Message(NamedTuple):
    kind: Kind
    payload: bytes

    def fields(self) -> dict[str, Any]:
        """The JSON object that the payload is."""
        try:
            found = json.loads(self.payload)
        except (ValueError, RecursionError) as error:
            raise MessageError(f"{self.kind.name}: {error}") from None
        if not isinstance(found, dict):
            raise MessageError(f"{self.kind.name}: no JSON object")
        return found

    def field(self, name: str, kind: type) -> Any:
        """One field; a whole number counts as a float too."""
        value = self.fields().get(name)
        if kind is float and type(value) is int:
            value = float(value)
        if type(value) is not kind:
            raise MessageError(f"{self.kind.name}: {name!r} is not of type {kind.__name__}")
        return value


def pack(kind: Kind, payload: bytes = b"") -> bytes:
    return HEADER.pack(kind, len(payload)) + payload


def pack_json(kind: Kind, **fields: Any) -> bytes:
    return pack(kind, json.dumps(fields).encode())


def reports_json(reports: tuple[HidReport, ...]) -> list[list[str]]:
    return [[report.path, report.data.hex()] for report in reports]


def reports_of(value: Any) -> tuple[HidReport, ...]:
    """The way back from ``reports_json``."""
    try:
        found = tuple(HidReport(path, bytes.fromhex(data)) for path, data in value)
    except (TypeError, ValueError):
        raise MessageError("no reports") from None
    if any(report.path not in ("output", "feature") for report in found):
        raise MessageError("a report of an unknown path")
    return found


class Inbox:
    """Bytes as they come -> whole messages."""

    def __init__(self) -> None:
        self.buffer = bytearray()

    def feed(self, data: bytes) -> None:
        self.buffer += data

    def take(self) -> Message | None:
        """The next message, if all of it is there."""
        buffer = self.buffer
        if not buffer:
            return None
        if buffer[0] not in KINDS:
            raise MessageError(f"unknown message {buffer[0]}")
        if len(buffer) < HEADER.size:
            return None
        number, size = HEADER.unpack_from(buffer)
        if size > SIZE_LIMIT:
            raise MessageError(f"a message of {size} bytes, more than {SIZE_LIMIT}")
        stop = HEADER.size + size
        if len(buffer) < stop:
            return None
        message = Message(Kind(number), bytes(buffer[HEADER.size : stop]))
        del buffer[:stop]
        return message

    def end(self) -> None:
        """Nothing more comes."""
        if self.buffer:
            raise MessageError(f"a message is cut off after {len(self.buffer)} bytes")


KINDS = frozenset(Kind)


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
        """The available bytes; None: nothing yet; empty: end of input."""
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
    """Bytes on their way; ``broken`` once the other end no longer reads them, or too many wait."""

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
        """Waits for the other side, at most this many seconds."""
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


BLOCK = Struct("<qI?IH")
"""first, generation, last, samples, actuators; then values (float64), then known (bytes)."""
VALUES = 1 << 14
"""Size of a block in one message: the writer must handle it between two frames."""
LOG = Struct("<IHH")
"""frames, samples of a frame, actuators; then, a frame: number, due, sent (ns), counts: int64."""


def pack_block(block: FrameBlock) -> bytes:
    samples, actuators = block.values.shape
    head = BLOCK.pack(block.first, block.generation, block.last, samples, actuators)
    return b"".join(
        (head, block.values.astype("<f8").tobytes(), block.known.astype("u1").tobytes())
    )


def parse_block(payload: bytes) -> FrameBlock:
    if len(payload) < BLOCK.size:
        raise MessageError("a block without its head")
    first, generation, last, samples, actuators = BLOCK.unpack_from(payload)
    shape, size = (samples, actuators), samples * actuators
    if len(payload) != BLOCK.size + 9 * size:
        raise MessageError(f"a block of {samples} x {actuators} values in {len(payload)} bytes")
    import numpy as np  # Here, since the watchdog starts without it.

    values = np.frombuffer(payload, "<f8", size, BLOCK.size).reshape(shape)
    known = np.frombuffer(payload, "u1", size, BLOCK.size + 8 * size).reshape(shape)
    return FrameBlock(first, values, known.astype(bool), generation, last)


def parts(block: FrameBlock, values: int = VALUES) -> Iterator[FrameBlock]:
    """The block in pieces that are short enough for a message."""
    count, actuators = block.values.shape
    samples = max(values // max(actuators, 1), 1)
    for start in range(0, max(count, 1), samples):
        stop = start + samples
        yield block._replace(
            first=block.first + start,
            values=block.values[start:stop],
            known=block.known[start:stop],
            last=block.last and stop >= count,
        )


class Sent(NamedTuple):
    """A frame, and when it was sent (ns since the start of the replay)."""

    frame: Frame
    sent_ns: int


def pack_log(frames: Sequence[Sent]) -> bytes:
    """All of one shape."""
    import numpy as np

    shape = np.shape(frames[0].frame.counts)
    rows = np.array(
        [
            [f.frame.number, f.frame.due_ns, f.sent_ns, *(c for row in f.frame.counts for c in row)]
            for f in frames
        ],
        "<i8",
    )
    return LOG.pack(len(frames), *shape) + rows.tobytes()


def parse_log(payload: bytes) -> list[Sent]:
    if len(payload) < LOG.size:
        raise MessageError("a log without its head")
    count, samples, actuators = LOG.unpack_from(payload)
    width = 3 + samples * actuators
    if len(payload) != LOG.size + 8 * count * width:
        raise MessageError(f"a log of {count} frames in {len(payload)} bytes")
    import numpy as np

    rows = np.frombuffer(payload, "<i8", count * width, LOG.size).reshape(count, width).tolist()
    return [
        Sent(
            Frame(
                number,
                due,
                tuple(tuple(counts[i * actuators : (i + 1) * actuators]) for i in range(samples)),
            ),
            sent,
        )
        for number, due, sent, *counts in rows
    ]
