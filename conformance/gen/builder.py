"""Bytes of a hapf file with a note beside each field. Imports nothing from hapfmt, on purpose:
what it writes tests the package, and must not share its mistakes."""

from __future__ import annotations

import struct
import zlib

Field = tuple[bytes, str]
SIGNATURE = bytes.fromhex("8F4841500D0A1A0A")
SYNC = bytes.fromhex("F9488B1C")
COLUMNS = 16


def u8(value: int, meaning: str) -> Field:
    return struct.pack("<B", value), meaning


def u16(value: int, meaning: str) -> Field:
    return struct.pack("<H", value), meaning


def u32(value: int, meaning: str) -> Field:
    return struct.pack("<I", value), meaning


def u64(value: int, meaning: str) -> Field:
    return struct.pack("<Q", value), meaning


def i64(value: int, meaning: str) -> Field:
    return struct.pack("<q", value), meaning


def raw(value: bytes, meaning: str) -> Field:
    return value, meaning


def varint(value: int, meaning: str) -> Field:
    out = bytearray()
    while True:
        group, value = value & 0x7F, value >> 7
        out.append(group | (0x80 if value else 0))
        if not value:
            return bytes(out), meaning


def svarint(value: int, meaning: str) -> Field:
    return varint(2 * value if value >= 0 else -2 * value - 1, meaning)


def bits(text: str, meaning: str) -> Field:
    """A row of 0 and 1, filled with 0 to whole bytes."""
    text = text.replace(" ", "")
    text += "0" * (-len(text) % 8)
    return bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8)), meaning


def joined(fields: list[Field]) -> bytes:
    return b"".join(data for data, _ in fields)


class File:
    """Chunks in order; ``fields`` is the whole file, field by field. ``brief``: a chunk header is
    one field, and so is HEAD."""

    def __init__(self, file_id: int, *, brief: bool = False) -> None:
        self.file_id = file_id
        self.brief = brief
        self.sequence = 0
        self.fields: list[Field] = [(SIGNATURE, "signature")]
        self.offsets: dict[str, int] = {}
        self.listed: list[tuple[str, int, int, int]] = []
        self.stop_ns = 0
        self.first = self.last_index = 0

    @property
    def offset(self) -> int:
        return len(self.data)

    @property
    def data(self) -> bytes:
        return joined(self.fields)

    def cluster(self, packets: list[Packet], times: tuple[int, int]) -> None:
        """A DATA chunk."""
        self.chunk("DATA", cluster(packets, self.file_id, self.sequence), times=times)

    def chunk(self, type_: str, payload: list[Field], times: tuple[int, int] = (0, 0)) -> None:
        """``times``: of DATA, the start of its first packet and the end of its last one in ns."""
        body = joined(payload)
        header = [
            raw(SYNC, "sync word"),
            raw(type_.encode(), f"type {type_}"),
            u64(self.file_id, "file id"),
            u32(self.sequence, f"sequence number {self.sequence}"),
            u32(len(body), f"payload size {len(body)}"),
            u32(file_crc(body, self.file_id), "file CRC of the payload"),
        ]
        header.append(u32(zlib.crc32(joined(header)), "CRC-32 of the header"))
        if self.brief:
            about = f"header: {type_}, sequence number {self.sequence}, payload {len(body)} bytes"
            header = [raw(joined(header), about)]
        self.offsets.setdefault(type_, self.offset)
        self.listed.append((type_, self.offset, *times))
        self.stop_ns = max(self.stop_ns, times[1])
        self.fields += header + payload
        self.sequence += 1

    def head(self, level: int = 1, tlvs: list[Field] | None = None) -> None:
        payload = [u8(1, "major version"), u8(0, "minor version"), u8(level, "level")]
        if self.brief:
            payload = [raw(joined(payload), f"version 1.0, level {level}")]
        self.chunk("HEAD", payload + (tlvs or []))

    def index(self) -> None:
        """An iNDX of the chunks from the index before it on."""
        at, before = self.offset, self.last_index
        previous = f"from the index before it on, at {before}" if before else None
        payload = [
            u64(before, previous or "no index before"),
            u32(self.first, f"the first one listed is chunk {self.first}"),
            u32(len(self.listed), f"{len(self.listed)} entries"),
        ]
        for type_, offset, start_ns, stop_ns in self.listed:
            payload += [
                raw(type_.encode(), f"a {type_} chunk"),
                varint(offset - before, f"{offset - before} bytes on, at offset {offset}"),
            ]
            if type_ == "DATA":
                start, stop = start_ns // 10**6, -(-stop_ns // 10**6)
                payload += [
                    varint(start, f"start {start} ms"),
                    varint(stop - start, f"{stop - start} ms long"),
                ]
            before = offset
        self.listed, self.first, self.last_index = [], self.sequence, at
        self.chunk("iNDX", payload)

    def close(self, *, indexed: bool = False) -> None:
        if indexed:
            self.index()
        distance = self.offset - self.last_index if self.last_index else 0
        self.chunk(
            "fOOT",
            [
                u32(distance, f"index {distance} bytes before" if distance else "no index"),
                u64(self.stop_ns, f"duration {self.stop_ns} ns"),
            ],
        )


def file_crc(data: bytes, file_id: int) -> int:
    return zlib.crc32(file_id.to_bytes(8, "little") + data)


Packet = tuple[int, int, list[Field], int]
"""Track, start tick, the packet's fields, span."""

FIELDS = (("track", "track {}"), ("size", "{} bytes"), ("start", "start tick {}"),
          ("span", "{} ticks"))  # fmt: skip


def cluster(packets: list[Packet], file_id: int, sequence: int) -> list[Field]:
    """The table, and the packets."""

    def cluster_crc(data: bytes) -> int:
        return file_crc(struct.pack("<Q", sequence) + data, file_id)

    bodies = [joined(body) for _, _, body, _ in packets]
    rows = [
        (track, len(body), start, span)
        for (track, start, _, span), body in zip(packets, bodies, strict=True)
    ]
    least = [min(column) for column in zip(*rows, strict=True)]
    widths = [
        (max(column) - low).bit_length() + 7 >> 3
        for column, low in zip(zip(*rows, strict=True), least, strict=True)
    ]
    told = ", ".join(f"{name} {width}" for (name, _), width in zip(FIELDS, widths, strict=True))
    fields = [
        varint(len(packets), "1 packet" if len(packets) == 1 else f"{len(packets)} packets"),
        u16(sum(width << 4 * i for i, width in enumerate(widths)), f"bytes in a row: {told}"),
    ]
    fields += [varint(low, f"least {name}") for (name, _), low in zip(FIELDS, least, strict=True)]
    for row, body in zip(rows, bodies, strict=True):
        for value, low, width, (_, text) in zip(row, least, widths, FIELDS, strict=True):
            if width:
                fields.append(raw((value - low).to_bytes(width, "little"), text.format(value)))
        crc = cluster_crc(struct.pack("<5Q", len(packets), *row) + body)
        fields.append(u32(crc, f"packet CRC of track {row[0]}, start tick {row[2]}"))
    fields.append(u32(cluster_crc(joined(fields)), "table CRC"))
    for _, _, body, _ in packets:
        fields += body
    return fields


def listing(fields: list[Field], first: int = 0, stop: int | None = None) -> str:
    """Lines of offset, bytes, meaning, from the offset ``first`` up to ``stop``; long fields
    continue below."""
    lines = []
    offset = 0
    for data, meaning in fields:
        shown = first <= offset and (stop is None or offset < stop)
        for at in range(0, max(len(data), 1) if shown else 0, COLUMNS):
            part = " ".join(f"{byte:02X}" for byte in data[at : at + COLUMNS])
            lines.append(f"{offset + at:06X}  {part:<47}  {meaning if at == 0 else ''}".rstrip())
        offset += len(data)
    return "\n".join(lines)
