"""iNDX and fOOT (SPEC 6.5 and 6.6): where the chunks are. A hint, never trusted."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from ..errors import FormatError
from ..numbers import build_varint, parse_varint
from .layout import FOOT, INDEX
from .wire import HEADER_SIZE

FIRST_OFFSET = 8
INDEX_EVERY = 1 << 22
"""Bytes of chunks after which an index is due (SPEC IDX-005)."""
NS_LIMIT = (1 << 63) - 1
MS_LIMIT = (1 << 53) - 1
ENTRY_SIZES = (5, 28)
"""The smallest and the largest number of bytes that an entry takes."""
INDEX_SIZE = INDEX.size


class IndexEntry(NamedTuple):
    """A chunk's type and offset; for DATA the milliseconds that its packets lie within."""

    type: str
    offset: int
    start_ms: int = 0
    stop_ms: int = 0


class Index(NamedTuple):
    previous: int
    first_sequence: int
    entries: tuple[IndexEntry, ...]


class Foot(NamedTuple):
    index_offset: int
    stop_offset: int
    data_count: int
    track_count: int
    duration_ns: int


def ceil_ns(seconds: Fraction) -> int:
    return min(-(-seconds.numerator * 10**9 // seconds.denominator), NS_LIMIT)


def floor_ms(seconds: Fraction) -> int:
    return min(seconds.numerator * 1000 // seconds.denominator, MS_LIMIT)


def ceil_ms(seconds: Fraction) -> int:
    return min(-(-seconds.numerator * 1000 // seconds.denominator), MS_LIMIT)


def build_index(index: Index) -> bytes:
    out = bytearray(
        INDEX.build(
            previous=index.previous,
            first_sequence=index.first_sequence,
            entry_count=len(index.entries),
        )
    )
    before = index.previous
    for entry in index.entries:
        out += entry.type.encode("ascii") + build_varint(entry.offset - before)
        if entry.type == "DATA":
            out += build_varint(entry.start_ms) + build_varint(entry.stop_ms - entry.start_ms)
        before = entry.offset
    return bytes(out)


def entry_count(payload: bytes) -> int:
    """What the payload promises, and no more than it can hold; for a bound before it is parsed."""
    if len(payload) < INDEX_SIZE:
        return 0
    return min(int(INDEX.read(payload).entry_count), len(payload) // ENTRY_SIZES[0])


def parse_index(payload: bytes, own_offset: int, offset: int) -> Index:
    """The iNDX payload at ``offset``, whose chunk starts at ``own_offset``."""
    raw = INDEX.parse(payload, 0, "IDX-002", offset)
    if len(payload) < INDEX_SIZE + raw.entry_count * ENTRY_SIZES[0]:
        raise FormatError(
            "index length and entry count differ", requirement="IDX-002", offset=offset
        )
    if raw.entry_count * HEADER_SIZE > max(own_offset - raw.previous, 0):
        raise FormatError(
            "more entries than there are chunks before the index",
            requirement="IDX-002",
            offset=offset + INDEX.offsets["entry_count"],
        )
    if raw.previous and not FIRST_OFFSET <= raw.previous < own_offset:
        raise FormatError("previous index out of place", requirement="IDX-002", offset=offset)
    entries: list[IndexEntry] = []
    position, chunk_offset = INDEX_SIZE, raw.previous
    for _ in range(raw.entry_count):
        at = position
        letters = payload[at : at + 4]
        if len(letters) < 4:
            raise FormatError(
                "the index ends within an entry", requirement="IDX-002", offset=offset + at
            )
        if not (letters.isascii() and letters.isalpha()):
            raise FormatError(
                "an index entry without a chunk type", requirement="IDX-002", offset=offset + at
            )
        further, position = parse_varint(payload, at + 4, offset)
        chunk_offset += further
        if chunk_offset >= own_offset or (entries and further < HEADER_SIZE):
            raise FormatError(
                "index offsets out of order", requirement="IDX-002", offset=offset + at
            )
        if letters == b"DATA":
            start_ms, position = parse_varint(payload, position, offset)
            span_ms, position = parse_varint(payload, position, offset)
            entries.append(IndexEntry("DATA", chunk_offset, start_ms, start_ms + span_ms))
        else:
            entries.append(IndexEntry(letters.decode("latin-1"), chunk_offset))
    if position != len(payload):
        raise FormatError(
            "bytes left over after an index", requirement="IDX-002", offset=offset + position
        )
    return Index(raw.previous, raw.first_sequence, tuple(entries))


def build_foot(foot: Foot) -> bytes:
    return FOOT.build(**foot._asdict())


def parse_foot(payload: bytes, offset: int, *, moved: bool = False) -> Foot:
    """The fOOT payload at ``offset``; ``moved``: bytes before it were lost or came in."""
    if len(payload) != FOOT.size:
        raise FormatError("footer of another length", requirement="FOT-001", offset=offset)
    raw = FOOT.parse(payload, 0, "FOT-001", offset)
    foot = Foot(**raw._asdict())
    if not moved and foot.stop_offset != offset + len(payload):
        raise FormatError(
            "footer names another end",
            requirement="FOT-001",
            offset=offset + FOOT.offsets["stop_offset"],
        )
    return foot


def check_listing(index: Index, own_offset: int, chunks: Sequence[IndexEntry], offset: int) -> None:
    """IDX-002 and IDX-006 against all chunks of the file, in order of their offsets."""
    start = bisect_left(chunks, index.previous, key=lambda chunk: chunk.offset)
    stop = bisect_left(chunks, own_offset, key=lambda chunk: chunk.offset)
    expected = chunks[start:stop]
    for listed, found in zip(index.entries, expected, strict=False):
        if (listed.type, listed.offset) != (found.type, found.offset):
            break
        if listed.start_ms > found.start_ms or listed.stop_ms < found.stop_ms:
            raise FormatError("index times miss samples", requirement="IDX-006", offset=offset)
    else:
        if len(expected) == len(index.entries):
            if index.first_sequence != start:
                raise FormatError(
                    f"the index counts its chunks from {index.first_sequence}, not {start}",
                    requirement="IDX-002",
                    offset=offset + INDEX.offsets["first_sequence"],
                )
            return
    raise FormatError("the index does not match the chunks", requirement="IDX-002", offset=offset)
