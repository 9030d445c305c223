"""Some packets of a large cluster: its table and they alone are read (SPEC 6.4).

The CRC of a packet covers its row, so what is delivered is true. But the CRC of the payload is not
known then, and a damaged row of another track may have been one of a track that is wanted: so
where a wanted track does not go on without a gap, the payloads on both sides are read whole.
Events have gaps everywhere: beside samples, what the table shows of them is taken as it is, and
alone they are always read with the whole payload.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..container.cluster import Entry, Packet, packet_crc, parse_count, parse_entry
from ..container.source import Source
from ..container.track import Track
from ..container.wire import HEADER_SIZE, ChunkHeader
from ..errors import FormatError
from ..integers import parse_varint
from ..limits import TICK_LIMIT, Level
from .catalogue import ChunkRef

Ranges = Mapping[int, tuple[int, int]]
Row = tuple[Entry, int]
"""Of the table, and where its packet stands in the file."""
ROW_SIZE = 14
"""Bytes of a row, mostly: as many for each track are read at first, then twice as many."""
SHARE = 2
"""The whole payload is read where a 2nd of it is wanted."""


def read_table(
    source: Source,
    ref: ChunkRef,
    header: ChunkHeader,
    tracks: Mapping[int, Track],
    level: Level,
    ranges: Ranges,
) -> list[Row] | None:
    """The rows of a cluster that are of the tracks in ``ranges``; None where a rule does not
    hold."""
    at = ref.offset + HEADER_SIZE
    size = ROW_SIZE * (len(tracks) + 1)
    while True:
        size = min(size, header.payload_size)
        part = source.read_at(at, size)
        try:
            return parse_table(part, at, header.payload_size, tracks, level, ranges)
        except FormatError:
            if size == header.payload_size:
                return None
        size *= 2


def parse_table(
    part: bytes,
    base: int,
    payload_size: int,
    tracks: Mapping[int, Track],
    level: Level,
    ranges: Ranges,
) -> list[Row] | None:
    """From the first bytes of a payload; FormatError where they end within the table.

    Every rule of a table is checked. The loop makes nothing of the rows that are not wanted: they
    are many.
    """
    count, position = parse_count(part, level, base)
    rows: list[tuple[int, int]] = []
    packets_size = samples = start_before = 0
    track_before = -1
    for _ in range(count):
        row = position
        track, position = parse_varint(part, position, base)
        size, position = parse_varint(part, position, base)
        start, position = parse_varint(part, position, base)
        span, position = parse_varint(part, position, base)
        position += 4
        described = tracks.get(track)
        in_order = track > track_before or (track == track_before and start > start_before)
        if described is None or not in_order:
            return None
        if not 1 <= span <= level.span_ticks or start + span > TICK_LIMIT:
            return None
        track_before, start_before = track, start
        samples += described.weight(span, size)
        if track in ranges:
            rows.append((row, packets_size))
        packets_size += size
    if position + packets_size != payload_size or samples > level.cluster_samples:
        return None
    return [(parse_entry(part, row, base)[0], base + position + at) for row, at in rows]


def read_packets(source: Source, rows: Sequence[Row], seed: int) -> list[Packet] | None:
    """The packets of rows in order of their places; neighbours in one reading. None where a CRC
    differs."""
    packets: list[Packet] = []
    runs: list[list[Row]] = []
    for row in rows:
        last = runs[-1][-1] if runs else None
        if last is not None and row[1] - last[1] - last[0].size <= source.gap:
            runs[-1].append(row)
        else:
            runs.append([row])
    for run in runs:
        start, stop = run[0][1], run[-1][1] + run[-1][0].size
        part = source.read_at(start, stop - start)
        for entry, at in run:
            data = part[at - start : at - start + entry.size]
            if len(data) != entry.size or packet_crc(seed, entry.fields, data) != entry.crc:
                return None
            packets.append(Packet(entry.track, entry.start, entry.span, data, at))
    return packets


def wanted_rows(rows: Sequence[Row], ranges: Ranges) -> list[Row]:
    return [
        (entry, at)
        for entry, at in rows
        if entry.start < ranges[entry.track][1] and entry.stop > ranges[entry.track][0]
    ]
