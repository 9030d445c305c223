"""Packs blocks and the log of sent frames as payloads of messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..frames import Frame, FrameBlock
from .pipes import MessageError

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
        (head, block.values.astype("<f8").tobytes(), block.known.astype(np.uint8).tobytes())
    )


def parse_block(payload: bytes) -> FrameBlock:
    if len(payload) < BLOCK.size:
        raise MessageError("a block without its head")
    first, generation, last, samples, actuators = BLOCK.unpack_from(payload)
    shape, size = (samples, actuators), samples * actuators
    if len(payload) != BLOCK.size + 9 * size:
        raise MessageError(f"a block of {samples} x {actuators} values in {len(payload)} bytes")
    values = np.frombuffer(payload, "<f8", size, BLOCK.size).reshape(shape)
    known = np.frombuffer(payload, np.uint8, size, BLOCK.size + 8 * size).reshape(shape)
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
    shape = np.shape(frames[0].frame.counts)
    rows: NDArray[np.int64] = np.array(
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
