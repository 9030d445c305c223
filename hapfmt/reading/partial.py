"""Some packets of a large cluster: its table and they alone are read (SPEC 6.4).

The CRC of the table shows that no row is damaged. That of each packet covers its row too.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..format.cluster import HEAD_ROOM, Packet, Row, packet_crc, parse_table, parse_table_head
from ..format.source import Source
from ..format.track import Track
from ..format.wire import HEADER_SIZE, ChunkHeader
from ..errors import FormatError
from ..limits import Level
from .catalogue import ChunkRef

Ranges = Mapping[int, tuple[int, int]]
Place = tuple[Row, int]
"""A row, and where its packet stands in the file."""
ROW_SIZE = 12
"""Bytes of a row, mostly: as many for each track are read at first."""
SHARE = 2
"""The whole payload is read where a 2nd of it is wanted."""


def wanted_packets(
    source: Source,
    ref: ChunkRef,
    header: ChunkHeader,
    tracks: Mapping[int, Track],
    level: Level,
    ranges: Ranges,
) -> list[Packet] | None:
    """The packets of the tracks in ``ranges`` that overlap them; None where a rule does not hold,
    or where they are much of the payload."""
    at, payload_size = ref.offset + HEADER_SIZE, header.payload_size
    size = min(HEAD_ROOM + ROW_SIZE * len(tracks), payload_size)
    part = source.read_at(at, size)
    try:
        table_size = parse_table_head(part, level, at).table_size
        if table_size > size:
            part += source.read_at(at + size, min(table_size, payload_size) - size)
        head, rows = parse_table(part, payload_size, tracks, level, at, header.cluster_seed)
    except FormatError:
        return None
    places, position = [], at + head.table_size
    for row in rows:
        first, last = ranges.get(row.track, (0, 0))
        if row.start < last and row.stop > first:
            places.append((row, position))
        position += row.size
    if SHARE * sum(row.size for row, _ in places) >= payload_size:
        return None
    return read_packets(source, places, head.packet_count, header.cluster_seed)


def read_packets(source: Source, places: list[Place], count: int, seed: int) -> list[Packet] | None:
    """Neighbours in one reading. None where a CRC differs."""
    packets: list[Packet] = []
    runs: list[list[Place]] = []
    for place in places:
        last = runs[-1][-1] if runs else None
        if last is not None and place[1] - last[1] - last[0].size <= source.gap:
            runs[-1].append(place)
        else:
            runs.append([place])
    for run in runs:
        start, stop = run[0][1], run[-1][1] + run[-1][0].size
        part = source.read_at(start, stop - start)
        for row, at in run:
            data = part[at - start : at - start + row.size]
            if len(data) != row.size or packet_crc(seed, count, row, data) != row.crc:
                return None
            packets.append(Packet(row.track, row.start, row.span, data, at))
    return packets
