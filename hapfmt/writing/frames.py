"""A stream of binary frames -> samples and objects (docs/streams.md)."""

from __future__ import annotations

import struct

import numpy as np

from ..descriptions import parse_json
from ..errors import ParameterError
from .session import Session

MAGIC = b"hFr1"
HEADER = struct.Struct("<4sBBHqII")
"""Magic, type, number format, channel, tick, count, size of the payload."""

OBJECT, SAMPLES, ROWS = range(3)
FORMATS = {1: "<i2", 2: "<i4", 3: "<f4", 4: "<f8"}
GO_ON = -1
"""In place of a tick: where the last sample ended."""

PAYLOAD_SIZE = 1 << 26
"""A longer frame is refused, not collected."""


def build_frame(
    type_: int,
    payload: bytes,
    *,
    number_format: int = 0,
    channel: int = 0,
    tick: int = GO_ON,
    count: int = 0,
) -> bytes:
    head = HEADER.pack(MAGIC, type_, number_format, channel, tick, count, len(payload))
    return head + payload


class Frames:
    """Takes bytes in pieces of any size; whole frames are worked off."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.rest = bytearray()
        self.offset = 0

    @property
    def place(self) -> str:
        return f"byte {self.offset}"

    def feed(self, data: bytes) -> None:
        self.rest += data
        at = 0
        try:
            while len(self.rest) - at >= HEADER.size:
                magic, type_, format_, channel, tick, count, size = HEADER.unpack_from(
                    self.rest, at
                )
                if magic != MAGIC:
                    raise ParameterError("no frame begins here")
                if size > PAYLOAD_SIZE:
                    raise ParameterError(f"a frame of {size} bytes, above {PAYLOAD_SIZE}")
                stop = at + HEADER.size + size
                if len(self.rest) < stop:
                    break
                payload = bytes(memoryview(self.rest)[at + HEADER.size : stop])
                self.frame(type_, format_, channel, tick, count, payload)
                self.offset += stop - at
                at = stop
        finally:
            del self.rest[:at]

    def finish(self) -> None:
        if self.rest:
            raise ParameterError(f"the stream ends within a frame, {len(self.rest)} bytes into it")

    def frame(
        self, type_: int, format_: int, channel: int, tick: int, count: int, payload: bytes
    ) -> None:
        if type_ == OBJECT:
            self.session.object(parse_json(payload))
            return
        if type_ not in (SAMPLES, ROWS) or format_ not in FORMATS or tick < GO_ON:
            raise ParameterError(f"a frame of type {type_}, number format {format_}, tick {tick}")
        inputs = self.session.running.inputs
        columns = 1 if type_ == SAMPLES else len(inputs)
        dtype = np.dtype(FORMATS[format_])
        if len(payload) != count * columns * dtype.itemsize:
            raise ParameterError(f"{len(payload)} bytes are not {count} times {columns} samples")
        values = np.frombuffer(payload, dtype)
        start = None if tick == GO_ON else tick
        if type_ == SAMPLES:
            self.session.samples(channel, values, start)
        else:
            self.session.rows(values.reshape(count, columns), start)
