"""The container of a file without damage, as far as an index is checked against it (SPEC 5, 11.1,
11.2)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

SIGNATURE = bytes.fromhex("8F4841500D0A1A0A")
SYNC = bytes.fromhex("F9488B1C")
HEADER_SIZE = 32
FIRST_OFFSET = 8
BARE_SIZE, BARE_COUNT = 1 << 16, 16
"""A file of at most this many bytes and chunks needs no index (IDX-005)."""


class Chunk(NamedTuple):
    type: str
    offset: int
    file_id: int
    payload: bytes

    @property
    def stop(self) -> int:
        return self.offset + HEADER_SIZE + len(self.payload)


def chunks(data: bytes) -> list[Chunk]:
    """All of them; ValueError where one is not as it should be."""
    if data[:8] != SIGNATURE:
        raise ValueError("no signature")
    found: list[Chunk] = []
    position = FIRST_OFFSET
    while position < len(data):
        header = data[position : position + HEADER_SIZE]
        if len(header) < HEADER_SIZE or header[:4] != SYNC:
            raise ValueError(f"no chunk at {position}")
        type_, file_id, sequence, size, payload_crc, header_crc = struct.unpack(
            "<4sQIIII", header[4:]
        )
        payload = data[position + HEADER_SIZE : position + HEADER_SIZE + size]
        payload_found = zlib.crc32(file_id.to_bytes(8, "little") + payload)
        if zlib.crc32(header[:28]) != header_crc or payload_found != payload_crc:
            raise ValueError(f"a CRC-32 of the chunk at {position} differs")
        if len(payload) < size or sequence != len(found):
            raise ValueError(f"chunk {sequence} at {position}, {len(payload)} of {size} bytes")
        found.append(Chunk(type_.decode("latin-1"), position, file_id, payload))
        position += HEADER_SIZE + size
    return found


def varint(data: bytes, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        value |= (byte & 127) << shift
        position, shift = position + 1, shift + 7
        if byte < 128:
            return value, position


class Index(NamedTuple):
    previous: int
    first_sequence: int
    entries: list[tuple[str, int]]


def index_of(payload: bytes) -> Index:
    """Types and offsets that it lists."""
    previous, first_sequence, count = struct.unpack_from("<QII", payload)
    position, offset = 16, previous
    entries = []
    for _ in range(count):
        type_ = payload[position : position + 4].decode("latin-1")
        distance, position = varint(payload, position + 4)
        offset += distance
        entries.append((type_, offset))
        if type_ == "DATA":
            _, position = varint(payload, position)
            _, position = varint(payload, position)
    if position != len(payload):
        raise ValueError("an index does not end with its last entry")
    return Index(previous, first_sequence, entries)


def index_faults(data: bytes) -> Iterator[str]:
    """Where the indexes of a closed file do not lead to every chunk (IDX-002, IDX-005,
    FOT-002)."""
    try:
        found = chunks(data)
    except (ValueError, struct.error) as error:
        yield str(error)
        return
    indexes = {chunk.offset: chunk for chunk in found if chunk.type == "iNDX"}
    last = found[-1] if found else None
    if last is None or last.type != "fOOT" or len(last.payload) != 12:
        yield "no fOOT at the end"
        return
    (distance,) = struct.unpack_from("<I", last.payload)
    at = max(indexes, default=0)
    if distance != (last.offset - at if at else 0):
        yield f"fOOT: index_distance {distance}, the last index stands at {at or 'no place'}"
        return
    large = len(data) > BARE_SIZE or len(found) > BARE_COUNT
    if large and (not at or indexes[at].stop != last.offset):
        yield f"no index before fOOT, in a file of {len(data)} bytes and {len(found)} chunks"
    if not at:
        return
    listed: dict[int, str] = {}
    numbers = {chunk.offset: number for number, chunk in enumerate(found)}
    end = at
    while True:
        try:
            index = index_of(indexes[at].payload)
        except (KeyError, IndexError, ValueError, struct.error):
            yield f"no index that can be read at {at}"
            return
        listed |= {offset: type_ for type_, offset in index.entries}
        first = index.entries[0][1] if index.entries else at
        if numbers.get(first) != index.first_sequence:
            yield f"the index at {at} counts the chunk at {first} as {index.first_sequence}"
        if not index.previous:
            break
        if not index.previous < at:
            yield f"the index at {at} names {index.previous} as the one before"
            return
        at = index.previous
    there = {chunk.offset: chunk.type for chunk in found if chunk.offset < end}
    for offset in sorted(there.keys() | listed.keys()):
        if there.get(offset) != listed.get(offset):
            is_there, is_listed = there.get(offset, "no chunk"), listed.get(offset, "nothing")
            yield f"at {offset} stands {is_there}, the index lists {is_listed}"
