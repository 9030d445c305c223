"""DATA payload <-> packets (SPEC 6.4), and salvage of damaged payloads (SPEC clause 14)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ..errors import ChecksumError, FormatError, TruncatedError
from ..limits import LEVELS, TICK_LIMIT, Level
from ..numbers import build_varint, parse_varint
from .layout import PACKET_FIELDS
from .track import Track
from .wire import crc32

CRC_SIZE = 4
MOST_BYTES = 6
"""Most bytes of one field in a row (SPEC DAT-001)."""
ROW_ROOM = 20
"""Bytes of a row at most, if its fields keep the limits of level 2."""
HEAD_ROOM = 35
"""Bytes of packet_count, widths and the least values at most."""
FIELDS = PACKET_FIELDS.fixed
"""What a packet CRC covers before the packet."""


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


class TableRow(NamedTuple):
    """One row of the table; ``offset``: its place in the payload."""

    track: int
    size: int
    start: int
    span: int
    crc: int
    offset: int

    @property
    def stop(self) -> int:
        return self.start + self.span


class TableHead(NamedTuple):
    """The fields before the rows: number of rows, bytes of each field, its least value;
    ``size``: bytes of this head, ``row_size``: of a row; ``rows_stop``: where the rows end;
    ``table_size``: bytes from the start of the payload to the first packet."""

    packet_count: int
    widths: tuple[int, ...]
    least: tuple[int, ...]
    size: int
    row_size: int
    rows_stop: int
    table_size: int


def packet_crc(seed: int, count: int, row: TableRow, data: bytes) -> int:
    """SPEC DAT-004; ``seed``: where the cluster CRC starts, ``count``: packets in the cluster."""
    return crc32(data, crc32(FIELDS.pack(count, row.track, row.size, row.start, row.span), seed))


def build_cluster(packets: Sequence[Packet], seed: int) -> bytes:
    """The DATA payload; packets in order of (track, start), ``seed``: of the cluster CRC."""
    count = len(packets)
    rows = [TableRow(p.track, len(p.data), p.start, p.span, 0, 0) for p in packets]
    columns = list(zip(*(row[:4] for row in rows), strict=True))
    least = [min(column) for column in columns]
    widths = [
        (max(column) - low).bit_length() + 7 >> 3
        for column, low in zip(columns, least, strict=True)
    ]
    out = bytearray(build_varint(count))
    out += sum(width << 4 * place for place, width in enumerate(widths)).to_bytes(2, "little")
    for low in least:
        out += build_varint(low)
    for row, packet in zip(rows, packets, strict=True):
        for value, low, width in zip(row, least, widths, strict=False):
            out += (value - low).to_bytes(width, "little")
        out += packet_crc(seed, count, row, packet.data).to_bytes(CRC_SIZE, "little")
    out += crc32(bytes(out), seed).to_bytes(CRC_SIZE, "little")
    return bytes(out) + b"".join(packet.data for packet in packets)


def alone_size(packet: Packet) -> int:
    """Bytes of the payload that holds this packet and no other."""
    least = (packet.track, len(packet.data), packet.start, packet.span)
    head = 1 + 2 + sum(len(build_varint(value)) for value in least)
    return head + 2 * CRC_SIZE + len(packet.data)


def parse_table_head(payload: bytes, level: Level, base: int) -> TableHead:
    """The table head of a payload at ``base``, which may be truncated."""
    count, position = parse_varint(payload, 0, base)
    if count < 1:
        raise FormatError("a cluster without packets", requirement="DAT-001", offset=base)
    level.check("packets", count, "DAT-001", base)
    if len(payload) - position < 2:
        raise TruncatedError("the table ends early", requirement="DAT-005", offset=base + position)
    packed = int.from_bytes(payload[position : position + 2], "little")
    widths = tuple(packed >> 4 * place & 15 for place in range(4))
    if max(widths) > MOST_BYTES:
        raise FormatError(
            f"a field of {max(widths)} bytes", requirement="DAT-001", offset=base + position
        )
    position += 2
    least = []
    for _ in range(4):
        low, position = parse_varint(payload, position, base)
        least.append(low)
    row_size = sum(widths) + CRC_SIZE
    rows_stop = position + count * row_size
    return TableHead(
        count, widths, tuple(least), position, row_size, rows_stop, rows_stop + CRC_SIZE
    )


def parse_rows(payload: bytes, head: TableHead) -> Iterator[TableRow]:
    """The complete rows of the table."""
    stop = min(head.rows_stop, len(payload)) - head.row_size
    a, b, c, d = head.widths
    track, size, start, span = head.least
    number = int.from_bytes
    for at in range(head.size, stop + 1, head.row_size):
        i, j = at + a, at + a + b
        k, end = j + c, j + c + d
        yield TableRow(
            track + number(payload[at:i], "little"),
            size + number(payload[i:j], "little"),
            start + number(payload[j:k], "little"),
            span + number(payload[k:end], "little"),
            number(payload[end : end + CRC_SIZE], "little"),
            at,
        )


def check_times(row: TableRow, level: Level, base: int) -> None:
    if row.span < 1:
        raise FormatError("a packet without ticks", requirement="DAT-003", offset=base + row.offset)
    level.check("span_ticks", row.span, "DAT-003", base + row.offset)
    if row.start + row.span > TICK_LIMIT:
        raise FormatError("ticks beyond 2^48", requirement="DAT-003", offset=base + row.offset)


Table = tuple[TableHead, list[TableRow]]


def parse_table(
    part: bytes,
    size: int,
    tracks: Mapping[int, Track],
    level: Level,
    base: int,
    seed: int,
    known: Table | None = None,
) -> Table:
    """The table of a payload of ``size`` bytes, which ``part`` begins with; every rule checked.
    ``known``: the same table, where it was parsed before."""
    head = known[0] if known else parse_table_head(part, level, base)
    if len(part) < head.table_size:
        raise TruncatedError("the table ends early", requirement="DAT-005", offset=base + len(part))
    rows = known[1] if known else list(parse_rows(part, head))
    stored = int.from_bytes(part[head.rows_stop : head.table_size], "little")
    if crc32(part[: head.rows_stop], seed) != stored:
        raise ChecksumError(
            "table CRC differs", requirement="DAT-011", offset=base + head.rows_stop
        )
    samples, position = 0, head.table_size
    before = (-1, 0)
    for row in rows:
        check_times(row, level, base)
        if (row.track, row.start) <= before:
            raise FormatError(
                "packets out of order", requirement="DAT-002", offset=base + row.offset
            )
        before = row.track, row.start
        if row.track not in tracks:
            raise FormatError(
                f"packet of track {row.track}, which is not described",
                requirement="DAT-008",
                offset=base + row.offset,
            )
        samples += tracks[row.track].weight(row.span, row.size)
        level.check("cluster_samples", samples, "DAT-009", base + row.offset)
        position += row.size
        if position > size:
            raise TruncatedError(
                "a packet runs past its cluster", requirement="DAT-005", offset=base + row.offset
            )
    if position != size:
        raise FormatError(
            "bytes left over after the last packet", requirement="DAT-005", offset=base + position
        )
    return head, rows


def parse_cluster(
    payload: bytes,
    tracks: Mapping[int, Track],
    level: Level,
    base: int,
    seed: int,
    known: Table | None = None,
) -> list[Packet]:
    """All packets of an intact DATA payload at offset ``base``; checks every rule. ``known``: as
    in :func:`parse_table`."""
    head, rows = parse_table(payload, len(payload), tracks, level, base, seed, known)
    packets, position = [], head.table_size
    for row in rows:
        data = payload[position : position + row.size]
        if packet_crc(seed, head.packet_count, row, data) != row.crc:
            raise ChecksumError(
                "packet CRC differs", requirement="DAT-004", offset=base + row.offset
            )
        packets.append(Packet(row.track, row.start, row.span, data, base + position))
        position += row.size
    return packets


@dataclass(frozen=True)
class MissingPackets:
    """A place in a cluster where packets are missing.

    ``after`` and ``before`` are the nearest kept rows around it, or None. ``row`` is known only for
    an intact packet that is not delivered. ``missing``: the rows of the packets, where the table is
    intact.
    """

    after: TableRow | None
    before: TableRow | None
    offset: int
    size: int
    row: TableRow | None = None
    missing: Sequence[TableRow] = ()

    def tracks(self, known: Sequence[int]) -> list[int]:
        """Those of the ``known`` tracks that may have had packets here (DAT-002)."""
        low = self.after.track if self.after else 0
        high = self.before.track if self.before else 1 << 16
        return [track for track in known if low <= track <= high]


class Salvage:
    """The rows of one damaged payload, and the offsets of the packets that are kept."""

    def __init__(self, payload: bytes, level: Level, seed: int) -> None:
        self.payload, self.level, self.seed = payload, level, seed
        self.head: TableHead | None = None
        self.rows: list[TableRow] = []
        self.kept: dict[int, int] = {}
        """Offset of the packet, by the number of its row."""
        try:
            self.head = parse_table_head(payload, level, 0)
        except FormatError:
            return
        self.rows = list(parse_rows(payload, self.head))

    def table_holds(self) -> bool:
        """Whether the rows are those that were written (DAT-011)."""
        if self.head is None or len(self.payload) < self.head.table_size:
            return False
        stored = self.payload[self.head.rows_stop : self.head.table_size]
        return crc32(self.payload[: self.head.rows_stop], self.seed) == int.from_bytes(
            stored, "little"
        )

    def place_forwards(self) -> None:
        """Place the packets one after another, from the end of the table on."""
        position = self.head.table_size if self.head else 0
        for number, row in enumerate(self.rows):
            self.keep(number, position)
            position += row.size

    def place_backwards(self, stop: int) -> None:
        """Place the packets backwards from ``stop``. This needs the last row."""
        if self.head is None or len(self.rows) < self.head.packet_count:
            return
        for number, row in reversed(list(enumerate(self.rows))):
            stop -= row.size
            self.keep(number, stop)

    def keep(self, number: int, offset: int) -> None:
        if number not in self.kept and self.holds(self.rows[number], offset):
            self.kept[number] = offset

    def holds(self, row: TableRow, offset: int) -> bool:
        """Whether the CRC shows that this is the packet of the row. It matches no row if
        packet_count is wrong."""
        assert self.head is not None
        if offset < 0 or offset + row.size > len(self.payload):
            return False
        try:
            check_times(row, self.level, 0)
        except FormatError:
            return False
        data = self.payload[offset : offset + row.size]
        return packet_crc(self.seed, self.head.packet_count, row, data) == row.crc


def held_size(payload: bytes, seed: int) -> int:
    """Bytes of the packets with valid CRCs, placed forwards, and of their rows."""
    salvage = Salvage(payload, LEVELS[2], seed)
    salvage.place_forwards()
    row_size = salvage.head.row_size if salvage.head else 0
    return sum(row_size + salvage.rows[number].size for number in salvage.kept)


def salvage_cluster(
    payload: bytes,
    tracks: Mapping[int, Track],
    level: Level,
    base: int,
    seed: int,
    sizes: Sequence[int] = (),
) -> Iterator[Packet | MissingPackets]:
    """Packets whose CRC holds, in order of the table, and where others are missing.

    ``sizes``: possible sizes of the payload, by its header and by the place of the next header.
    """
    salvage = Salvage(payload, level, seed)
    salvage.place_forwards()
    sizes = sizes or (len(payload),)
    for size in sizes:
        salvage.place_backwards(size)
    if salvage.head is None or not salvage.kept:
        yield MissingPackets(None, None, base, len(payload))
        return
    rows = salvage.rows if salvage.table_holds() else []
    after: TableRow | None = None
    number, stop, samples = -1, 0, 0
    for each in sorted(salvage.kept):
        row, offset = salvage.rows[each], salvage.kept[each]
        if each > number + 1:
            size = max(offset - stop, 0)
            yield MissingPackets(after, row, base + stop, size, missing=rows[number + 1 : each])
        after, number, stop = row, each, offset + row.size
        track = tracks.get(row.track)
        samples += track.weight(row.span, row.size) if track else 0
        if track is None or samples > level.cluster_samples:
            yield MissingPackets(None, None, base + offset, row.size, row)
        else:
            yield Packet(row.track, row.start, row.span, payload[offset:stop], base + offset)
    if number + 1 < salvage.head.packet_count:
        end = min(sizes[0], len(payload))
        size = max(end - stop, 0)
        yield MissingPackets(after, None, base + stop, size, missing=rows[number + 1 :])
