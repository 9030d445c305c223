"""Checksums made right, so that what is behind them is reached; imports nothing from hapfmt."""

from __future__ import annotations

import struct
import zlib
from typing import NamedTuple

SIGNATURE = bytes.fromhex("8F4841500D0A1A0A")
SYNC = bytes.fromhex("F9488B1C")
HEADER = struct.Struct("<4s4sQIIII")
SIZE = HEADER.size
CRC_AT = SIZE - 4


class Part(NamedTuple):
    """A chunk as it stands, right or wrong."""

    type: bytes
    file_id: int
    sequence: int
    payload: bytes


def varint_at(data: bytes, at: int) -> tuple[int, int] | None:
    value = 0
    for place in range(8):
        if at + place >= len(data):
            return None
        byte = data[at + place]
        value |= (byte & 0x7F) << (7 * place)
        if byte < 0x80:
            return value, at + place + 1
    return None


def file_crc(data: bytes, file_id: int) -> int:
    return zlib.crc32(file_id.to_bytes(8, "little") + data)


class Table(NamedTuple):
    """``rows``: track, size, start, span; ``head``: where they begin, ``row``: bytes of each."""

    rows: list[tuple[int, ...]]
    head: int
    row: int

    @property
    def stop(self) -> int:
        """Where the CRC of the table begins."""
        return self.head + self.row * len(self.rows)


def table_at(payload: bytes) -> Table | None:
    """None where the table does not lie within the payload."""
    found = varint_at(payload, 0)
    if found is None or found[0] > len(payload):
        return None
    count, at = found
    packed = int.from_bytes(payload[at : at + 2], "little")
    widths = [packed >> 4 * place & 15 for place in range(4)]
    at += 2
    least = []
    for _ in range(4):
        found = varint_at(payload, at)
        if found is None:
            return None
        least.append(found[0])
        at = found[1]
    head, size, rows = at, sum(widths) + 4, []
    if head + count * size + 4 > len(payload):
        return None
    for _ in range(count):
        row = []
        for low, width in zip(least, widths, strict=True):
            row.append(low + int.from_bytes(payload[at : at + width], "little"))
            at += width
        rows.append(tuple(row))
        at += 4
    return Table(rows, head, size)


def mend_cluster(payload: bytes, file_id: int = 7, sequence: int = 2) -> bytes:
    """The CRCs of the table and of every packet."""
    table = table_at(payload)
    if table is None:
        return payload
    out = bytearray(payload)
    chunk = struct.pack("<Q", sequence)
    at, crc_at = table.stop + 4, table.head - 4
    for track, size, start, span in table.rows:
        crc_at += table.row
        fields = [value % (1 << 64) for value in (len(table.rows), track, size, start, span)]
        crc = file_crc(chunk + struct.pack("<5Q", *fields) + payload[at : at + size], file_id)
        out[crc_at : crc_at + 4] = crc.to_bytes(4, "little")
        at += size
    crc = file_crc(chunk + bytes(out[: table.stop]), file_id)
    out[table.stop : table.stop + 4] = crc.to_bytes(4, "little")
    return bytes(out)


def mend_header(data: bytes) -> bytes:
    """The sync word and the CRC of the first 32 bytes."""
    if len(data) < SIZE:
        return data
    head = SYNC + data[4:CRC_AT]
    return head + zlib.crc32(head).to_bytes(4, "little") + data[SIZE:]


def parts_of(data: bytes) -> list[Part]:
    """The chunks of a file by the sizes in their headers, checksums not looked at; a size that
    leaves the file, or a lost sync word, ends at the next sync word."""
    parts = []
    at = 8
    while at < len(data):
        raw = data[at : at + SIZE].ljust(SIZE, b"\0")
        _, type_, file_id, sequence, size, _, _ = HEADER.unpack(raw)
        stop = at + SIZE + size
        if stop > len(data) or (stop < len(data) and data[stop : stop + 4] != SYNC):
            found = data.find(SYNC, at + SIZE)
            stop = len(data) if found < 0 else found
        parts.append(Part(type_, file_id, sequence, data[at + SIZE : stop]))
        at = stop
    return parts


def build(parts: list[Part]) -> bytes:
    """A file of these chunks: one file id, sequence numbers in order, sizes and CRCs right; the
    index and the footer name the places where the chunks came to stand."""
    out = bytearray(SIGNATURE)
    file_id = parts[0].file_id if parts else 0
    index_at = 0
    for sequence, part in enumerate(parts):
        payload = part.payload
        if part.type == b"DATA":
            payload = mend_cluster(payload, file_id, sequence)
        elif part.type == b"iNDX":
            index_at = len(out)
        elif part.type == b"fOOT" and len(payload) == 12:
            distance = len(out) - index_at if index_at else 0
            payload = struct.pack("<I", distance) + payload[4:]
        crc = file_crc(payload, file_id)
        header = HEADER.pack(SYNC, part.type, file_id, sequence, len(payload), crc, 0)[:CRC_AT]
        out += header + zlib.crc32(header).to_bytes(4, "little") + payload
    return bytes(out)


def mend_file(data: bytes) -> bytes:
    return build(parts_of(data))
