"""DATA payload <-> packets (SPEC 6.4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..errors import ChecksumError, FormatError, TruncatedError
from ..integers import build_varint, parse_varint
from ..limits import TICK_LIMIT, Level
from .track import Track
from .wire import crc32


@dataclass(frozen=True, slots=True)
class Packet:
    """The coded samples of one track for ticks start <= t < start + span."""

    track: int
    start: int
    span: int
    data: bytes
    offset: int = 0
    """Offset of ``data`` in the file."""

    @property
    def stop(self) -> int:
        return self.start + self.span


@dataclass(frozen=True, slots=True)
class Entry:
    """One row of the packet table."""

    track: int
    size: int
    start: int
    span: int
    crc: int
    fields: bytes
    offset: int

    @property
    def stop(self) -> int:
        return self.start + self.span


def entry_fields(packet: Packet) -> bytes:
    return b"".join(
        build_varint(v) for v in (packet.track, len(packet.data), packet.start, packet.span)
    )


def packet_crc(seed: int, fields: bytes, data: bytes) -> int:
    """Of an entry and its packet (SPEC DAT-004); ``seed``: where the file CRC starts."""
    return crc32(data, crc32(fields, seed))


def build_cluster(packets: Sequence[Packet], seed: int) -> bytes:
    """The DATA payload; packets in order of (track, start)."""
    table, body = [build_varint(len(packets))], []
    for packet in packets:
        fields = entry_fields(packet)
        table += [fields, packet_crc(seed, fields, packet.data).to_bytes(4, "little")]
        body.append(packet.data)
    return b"".join(table + body)


def entry_size(packet: Packet) -> int:
    """Bytes that the packet's row takes in the table."""
    return len(entry_fields(packet)) + 4


def parse_entry(payload: bytes, position: int, base: int) -> tuple[Entry, int]:
    start_of_entry = position
    track, position = parse_varint(payload, position, base)
    size, position = parse_varint(payload, position, base)
    start, position = parse_varint(payload, position, base)
    span, position = parse_varint(payload, position, base)
    if len(payload) - position < 4:
        raise TruncatedError(
            "the packet table ends early", requirement="DAT-005", offset=base + position
        )
    fields = payload[start_of_entry:position]
    crc = int.from_bytes(payload[position : position + 4], "little")
    return Entry(track, size, start, span, crc, fields, base + start_of_entry), position + 4


def parse_count(payload: bytes, level: Level, base: int) -> tuple[int, int]:
    count, position = parse_varint(payload, 0, base)
    if count < 1:
        raise FormatError("a cluster without packets", requirement="DAT-001", offset=base)
    level.check("packets", count, "DAT-001", base)
    return count, position


def check_entry(entry: Entry, level: Level) -> None:
    if entry.span < 1:
        raise FormatError("a packet without ticks", requirement="DAT-003", offset=entry.offset)
    level.check("span_ticks", entry.span, "DAT-003", entry.offset)
    if entry.start + entry.span > TICK_LIMIT:
        raise FormatError("ticks beyond 2^48", requirement="DAT-003", offset=entry.offset)


def parse_cluster(
    payload: bytes, tracks: Mapping[int, Track], level: Level, base: int, seed: int
) -> list[Packet]:
    """All packets of an intact DATA payload that stands at ``base``, every rule checked."""
    count, position = parse_count(payload, level, base)
    entries: list[Entry] = []
    samples = 0
    for _ in range(count):
        entry, position = parse_entry(payload, position, base)
        check_entry(entry, level)
        if entries and (entry.track, entry.start) <= (entries[-1].track, entries[-1].start):
            raise FormatError("packets out of order", requirement="DAT-002", offset=entry.offset)
        if entry.track not in tracks:
            raise FormatError(
                f"packet of track {entry.track}, which is not described",
                requirement="DAT-008",
                offset=entry.offset,
            )
        samples += tracks[entry.track].weight(entry.span, entry.size)
        level.check("cluster_samples", samples, "DAT-009", entry.offset)
        entries.append(entry)
    packets = []
    for entry in entries:
        data = payload[position : position + entry.size]
        if len(data) < entry.size:
            raise TruncatedError(
                "a packet runs past its cluster", requirement="DAT-005", offset=entry.offset
            )
        if packet_crc(seed, entry.fields, data) != entry.crc:
            raise ChecksumError("packet CRC differs", requirement="DAT-004", offset=entry.offset)
        packets.append(Packet(entry.track, entry.start, entry.span, data, base + position))
        position += entry.size
    if position != len(payload):
        raise FormatError(
            "bytes left over after the last packet", requirement="DAT-005", offset=base + position
        )
    return packets
