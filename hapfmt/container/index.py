"""iNDX and fOOT (SPEC 6.5 and 6.6): where the chunks are. A hint, never trusted."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from ..errors import FormatError
from .layout import FOOT, INDEX, INDEX_ENTRY
from .wire import build_fields, parse_fixed, read_fields, size_of

FIRST_OFFSET = 8
INDEX_EVERY = 1 << 22
"""Bytes of chunks after which an index is due (SPEC IDX-005)."""
I64 = (-(1 << 63), (1 << 63) - 1)
ENTRY_SIZE: int = size_of(INDEX_ENTRY)
INDEX_SIZE: int = size_of(INDEX)


class IndexEntry(NamedTuple):
    """A chunk's type and offset; for DATA the nanoseconds that its packets lie within."""

    type: str
    offset: int
    start_ns: int = 0
    stop_ns: int = 0


class Index(NamedTuple):
    covers_from: int
    previous: int
    entries: tuple[IndexEntry, ...]


class Foot(NamedTuple):
    index_offset: int
    stop_offset: int
    data_count: int
    track_count: int
    duration_ns: int


def floor_ns(seconds: Fraction) -> int:
    return min(max(seconds.numerator * 10**9 // seconds.denominator, I64[0]), I64[1])


def ceil_ns(seconds: Fraction) -> int:
    return min(max(-(-seconds.numerator * 10**9 // seconds.denominator), I64[0]), I64[1])


def build_index(index: Index) -> bytes:
    head = INDEX.build(
        {
            "covers_from": index.covers_from,
            "previous": index.previous,
            "entry_count": len(index.entries),
        }
    )
    return bytes(head) + b"".join(
        build_fields(INDEX_ENTRY, {**entry._asdict(), "type": entry.type.encode("ascii")})
        for entry in index.entries
    )


def parse_index(payload: bytes, own_offset: int, offset: int) -> Index:
    """The iNDX payload at ``offset``, whose chunk starts at ``own_offset``."""
    raw = parse_fixed(INDEX, payload, 0, "IDX-001", offset)
    if len(payload) != INDEX_SIZE + raw.entry_count * ENTRY_SIZE:
        raise FormatError(
            "index length and entry count differ", requirement="IDX-001", offset=offset
        )
    if raw.covers_from < FIRST_OFFSET:
        raise FormatError("index covers the signature", requirement="IDX-004", offset=offset)
    if raw.covers_from != FIRST_OFFSET and not raw.covers_from <= raw.previous < own_offset:
        raise FormatError("previous index out of place", requirement="IDX-004", offset=offset + 8)
    entries = []
    last = raw.covers_from - 1
    for at in range(INDEX_SIZE, len(payload), ENTRY_SIZE):
        entry = read_fields(INDEX_ENTRY, payload, at)
        if not last < entry.offset < own_offset:
            raise FormatError(
                "index offsets out of order", requirement="IDX-002", offset=offset + at
            )
        last = entry.offset
        entries.append(
            IndexEntry(entry.type.decode("latin-1"), entry.offset, entry.start_ns, entry.stop_ns)
        )
    return Index(raw.covers_from, raw.previous, tuple(entries))


def build_foot(foot: Foot) -> bytes:
    return bytes(FOOT.build(foot._asdict()))


def parse_foot(payload: bytes, offset: int, *, moved: bool = False) -> Foot:
    """The fOOT payload at ``offset``; ``moved``: bytes before it were lost or came in."""
    if len(payload) != size_of(FOOT):
        raise FormatError("footer of another length", requirement="FOT-001", offset=offset)
    raw = parse_fixed(FOOT, payload, 0, "FOT-001", offset)
    foot = Foot(raw.index_offset, raw.stop_offset, raw.data_count, raw.track_count, raw.duration_ns)
    if not moved and foot.stop_offset != offset + len(payload):
        raise FormatError("footer names another end", requirement="FOT-001", offset=offset + 8)
    return foot


def check_listing(index: Index, own_offset: int, chunks: Sequence[IndexEntry], offset: int) -> None:
    """IDX-002 and IDX-006 against what was found in the file itself."""
    expected = [
        chunk
        for chunk in chunks
        if index.covers_from <= chunk.offset < own_offset and chunk.type not in ("iNDX", "fOOT")
    ]
    for listed, found in zip(index.entries, expected, strict=False):
        if (listed.type, listed.offset) != (found.type, found.offset):
            break
        if listed.start_ns > found.start_ns or listed.stop_ns < found.stop_ns:
            raise FormatError("index times miss samples", requirement="IDX-006", offset=offset)
    else:
        if len(expected) == len(index.entries):
            return
    raise FormatError("the index does not list the chunks", requirement="IDX-002", offset=offset)
