"""Messages between the processes of a replay: kind, length, payload, through pipes.

They come from our own processes; yet a process that dies, or another that writes into the pipe,
can leave anything there: whatever comes gives messages or a MessageError, in bounded memory.
"""

from __future__ import annotations

import json
from enum import IntEnum
from struct import Struct
from typing import Any, NamedTuple

from ...errors import HapfmtError
from ..profile.model import Report

HEADER = Struct("<BI")
SIZE_LIMIT = 1 << 22
"""Of a payload: a block of 50 ms is some 10 kB."""


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


def reports_json(reports: tuple[Report, ...]) -> list[list[str]]:
    return [[report.path, report.data.hex()] for report in reports]


def reports_of(value: Any) -> tuple[Report, ...]:
    """The way back from ``reports_json``."""
    try:
        found = tuple(Report(path, bytes.fromhex(data)) for path, data in value)
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
