"""DATA chunks -> packets in order of time, and the spans that damage took (SPEC 6.4, 7 and 14).

Requested seconds select ticks and clusters (SPEC clause 7). If only some packets of a large cluster
are wanted, only its table and these packets are read (SPEC 6.4). The CRC of the table shows that no
row is damaged. The CRC of each packet covers its row too. Threads receive packets in batches.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil, floor
from typing import NamedTuple

from ..errors import ChecksumError, FormatError
from ..format.cluster import (
    HEAD_ROOM,
    MissingPackets,
    Packet,
    Table,
    TableRow,
    packet_crc,
    parse_cluster,
    parse_table,
    parse_table_head,
    salvage_cluster,
)
from ..format.source import ByteSource
from ..format.track import Track
from ..format.walk import header_at, holds
from ..format.wire import HEADER_SIZE, ChunkHeader
from ..limits import Level, Limits
from ..numbers import exact, tick_range
from .catalogue import Catalogue, ChunkRef
from .damage import UNKNOWN, Losses, LostSpan, Timeline, Times

Ranges = Mapping[int, tuple[int, int]]
Place = tuple[TableRow, int]
"""A row, and the offset of its packet in the file."""
ROW_SIZE = 12
"""Bytes of a row, mostly: as many for each track are read at first."""
SHARE = 2
"""The whole payload is read where a 2nd of it is wanted."""


def wanted_packets(
    source: ByteSource,
    ref: ChunkRef,
    header: ChunkHeader,
    tracks: Mapping[int, Track],
    level: Level,
    ranges: Ranges,
    known: Table | None = None,
) -> list[Packet] | None:
    """The packets of the tracks in ``ranges`` that overlap them; None where a rule does not hold,
    or where they are much of the payload. ``known``: the table, where it was parsed before."""
    at, payload_size = ref.offset + HEADER_SIZE, header.payload_size
    room = known[0].table_size if known else HEAD_ROOM + ROW_SIZE * len(tracks)
    size = min(room, payload_size)
    part = source.read_at(at, size)
    try:
        table_size = room if known else parse_table_head(part, level, at).table_size
        if table_size > size:
            part += source.read_at(at + size, min(table_size, payload_size) - size)
        head, rows = parse_table(part, payload_size, tracks, level, at, header.cluster_seed, known)
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


def read_packets(
    source: ByteSource, places: list[Place], count: int, seed: int
) -> list[Packet] | None:
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


Seconds = Fraction | float | int


def tick_after(time_ns: int, rate: Fraction) -> int:
    """The first tick at ``time_ns`` or later."""
    return -(-time_ns * rate.numerator // (rate.denominator * 10**9))


def overlapping(
    refs: list[ChunkRef], start: Seconds | None, stop: Seconds | None
) -> list[ChunkRef]:
    """DATA chunks that may hold something of the seconds [start, stop)."""
    first = 0 if start is None else floor(exact(start) * 10**9)
    last = None if stop is None else ceil(exact(stop) * 10**9)
    return [
        ref
        for ref in refs
        if ref.start_ns is None
        or ref.stop_ns is None
        or ((start is None or first < ref.stop_ns) and (last is None or ref.start_ns < last))
    ]


__all__ = ["Seconds", "overlapping", "tick_after", "tick_range"]


TAIL_LOSSES = frozenset({"truncated", "garbage", "duplicate-chunk"})
"""Findings that may have been a DATA chunk."""
MS = 10**6
"""Nanoseconds."""
OF_PACKETS = ("DAT-004", "DAT-008", "DAT-009")
"""Rules that cost one packet and not its table."""
EXTRA_SIZE = 1 << 16
"""Bytes that a damaged payload may be longer than its header says."""


@dataclass(slots=True)
class TrackLine:
    """Tracks that continue one another, or one alone: which is at work, where its last packet
    ended, and the ``spans`` of all of them. ``free``: of events, whose packets come in any order,
    or unsupported."""

    tracks: tuple[int, ...]
    free: bool = False
    place: int = 0
    stop: int = 0
    spans: list[list[int]] = field(default_factory=list)

    def advance(self, place: int, start: int, stop: int) -> None:
        if self.spans and self.spans[-1][1] == start:
            self.spans[-1][1] = stop
        else:
            self.spans.append([start, stop])
        self.place, self.stop = place, stop

    def uncovered(self, start: int, stop: int) -> Iterator[tuple[int, int]]:
        """The ticks of a span that no packet has."""
        for first, last in self.spans[bisect_right(self.spans, start, key=lambda s: s[1]) :]:
            if first >= stop:
                break
            if start < first:
                yield start, first
            start = last
        if start < stop:
            yield start, stop


def lines_of(catalogue: Catalogue) -> dict[int, tuple[TrackLine, int]]:
    """By track, with its place in the line."""
    lines: dict[int, tuple[TrackLine, int]] = {}
    for parts in catalogue.parts:
        if len(parts) == 1 and parts[0].residual is None:
            continue
        known = [part for part in parts if not part.track.unsupported]
        residuals = [part.residual for part in known if part.residual]
        for row in (
            tuple([part.track.id for part in known]),
            tuple([track.id for track in residuals if not track.unsupported]),
        ):
            line = TrackLine(row)
            for place, id_ in enumerate(row):
                lines[id_] = line, place
    for id_, track in catalogue.tracks.items():
        if id_ not in lines:
            free = track.kind == "events" or bool(track.unsupported)
            lines[id_] = TrackLine((id_,), free), 0
    return lines


class PacketPass:
    """One pass over the packets of some tracks.

    ``lost`` grows on the way; ``on_damage`` is called at each damage found, and may raise.
    """

    def __init__(self, catalogue: Catalogue, on_damage: Callable[[], None]) -> None:
        self.catalogue = catalogue
        self.on_damage = on_damage
        self.losses = Losses(catalogue.tracks, catalogue.foot)
        self.lost = self.losses.spans
        again = [f.offset for f in catalogue.findings if f.code == "duplicate-chunk"]
        self.offsets = sorted([*again, *(ref.offset for ref in catalogue.chunks)])
        self.lines = lines_of(catalogue)
        self.ranges: Ranges = {}
        self.left_out: list[LostSpan] = []
        """Intact packets that are not delivered."""
        self.refused: set[int | None] = set()
        """Offsets of packets that an earlier pass left out."""
        self.unharmed: set[int] = set()
        """Offsets of damaged DATA chunks of which every packet holds."""
        self.timeline: Timeline | None = None
        """None where nothing is damaged, or each chunk has its times from an index."""

    def packets(
        self,
        ranges: dict[int, tuple[int, int]],
        start: Seconds | None = None,
        stop: Seconds | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Packet]:
        """Packets of the tracks in ``ranges`` that overlap their tick range, CRCs checked.

        FalseIndexError where a chunk is not what an index says of it (IDX-003).
        """
        self.ranges = ranges
        refs = overlapping(self.catalogue.data, start, stop)
        if self.catalogue.damaged and not self.catalogue.indexed:
            self.timeline = Timeline(self.catalogue)
        jumps = sorted(f.offset for f in self.catalogue.findings if f.code == "missing-chunk")
        before = -1
        for done, ref in enumerate(refs):
            if self.timeline is not None and ref.sequence is not None:
                place = bisect_right(jumps, ref.offset) - 1
                offset = jumps[place] if place >= 0 else ref.offset
                self.suspect(ranges, self.timeline.missing(before, ref.sequence), offset)
                before = max(before, ref.sequence)
            for packet in self.cluster(ref):
                if packet.track not in ranges or packet.offset in self.refused:
                    continue
                first, last = ranges[packet.track]
                if self.settle(packet) and packet.start < last and packet.stop > first:
                    yield packet
            if progress:
                progress(done + 1, len(refs))
        if self.timeline is not None and self.timeline.found:
            last = self.timeline.found[-1]
            self.suspect(ranges, self.timeline.missing(before, last), (jumps or [0])[-1])
        for offset in self.tail():
            self.suspect(ranges, UNKNOWN, offset)
        for track in sorted(ranges):
            self.losses.end(track, self.lines[track][0].stop)
        for track, low, high, at in self.left_out:
            # A tick is delivered or lost, never both.
            for span in self.lines[track][0].uncovered(low, high or low):
                self.losses.lose(track, *span, at or 0)

    def tail(self) -> list[int]:
        """Where a file that was not closed may have had more, at or behind its last chunk."""
        if not self.catalogue.damaged or self.catalogue.closed:
            return []
        last = max(self.catalogue.chunks, key=lambda ref: (ref.sequence or 0, ref.offset))
        codes = TAIL_LOSSES if last.type == "fOOT" else TAIL_LOSSES | {"bad-payload"}
        found = (f.offset for f in self.catalogue.findings if f.code in codes)
        return [offset for offset in found if offset >= last.offset][:1]

    def suspect(self, tracks: Iterable[int], times: Times, offset: int) -> None:
        """Damage at ``offset`` may have taken packets of these tracks within these times."""
        # Behind the first packet of a track that continues another, none of that one can be lost.
        places = {track: self.lines[track] for track in tracks}
        wanted = [track for track, (line, place) in places.items() if place >= line.place]
        self.losses.suspect(wanted, times, offset)

    def times(self, ref: ChunkRef) -> Times:
        """When the packets of a damaged chunk are."""
        if self.timeline is not None and ref.sequence is not None:
            return self.timeline.of(ref.sequence)
        if ref.start_ns is None or ref.stop_ns is None:
            return UNKNOWN
        return Times(ref.start_ns // MS, -(-ref.stop_ns // MS))

    def cluster(self, ref: ChunkRef) -> Iterator[Packet]:
        """The packets of one DATA chunk, or of it those that are wanted; damaged ones are reported
        instead."""
        catalogue = self.catalogue
        source = catalogue.source
        if ref.limit is not None:
            source.expect(ref.offset, ref.limit)
        header = header_at(source, ref.offset, catalogue.file_id)
        if ref.limit is not None:
            ref.checked(header)
        if header is None:
            # The header was there when the file was opened.
            raise ChecksumError(
                "the file changed while it was read", offset=ref.offset, path=source.path
            )
        level, known = catalogue.level, catalogue.tables.get(ref.offset)
        part: list[Packet] | None = None
        few = SHARE * len(self.ranges) < len(catalogue.tracks)
        if few and ref.stop_ns is not None and header.payload_size > source.gap:
            tracks = catalogue.tracks
            part = wanted_packets(source, ref, header, tracks, level, self.ranges, known)
        if part is not None:
            yield from part
            return
        at, size, seed = ref.offset + HEADER_SIZE, header.payload_size, header.cluster_seed
        payload = source.read_at(at, size)
        # A walk without findings has checked it. The table and packets have CRCs of their own.
        checked = ref.limit is None and not catalogue.damaged
        if checked or holds(header, payload):
            try:
                yield from parse_cluster(payload, catalogue.tracks, level, at, seed, known)
                return
            except FormatError as error:
                if not catalogue.damaged:
                    raise error.at(path=source.path) from None
                rule = error.requirement or "DAT-005"
                if rule not in OF_PACKETS:
                    message = f"DATA chunk: {error.message}"
                    catalogue.lose("bad-chunk", ref.offset, HEADER_SIZE + size, message, rule)
        elif ref.limit is not None:
            message = "checksum error in the payload of a DATA chunk"
            catalogue.lose(
                "bad-payload", ref.offset, len(payload) + HEADER_SIZE, message, "CHK-003"
            )
            self.on_damage()
        payload, sizes = self.region(ref, payload, size)
        self.unharmed.add(ref.offset)
        for item in salvage_cluster(payload, catalogue.tracks, level, at, seed, sizes):
            if isinstance(item, Packet):
                catalogue.last_found = max(
                    catalogue.last_found, item.stop / catalogue.tracks[item.track].rate
                )
                yield item
            else:
                self.unharmed.discard(ref.offset)
                self.lose_packets(item, ref, len(payload))

    def region(self, ref: ChunkRef, payload: bytes, size: int) -> tuple[bytes, list[int]]:
        """The bytes that a damaged payload may be, and the sizes it may have: by its header, and up
        to the next chunk, where bytes were lost or came in."""
        at, sizes = ref.offset + HEADER_SIZE, [size]
        place = bisect_right(self.offsets, ref.offset)
        if place < len(self.offsets):
            size = self.offsets[place] - at
            if size != sizes[0] and size <= sizes[0] + EXTRA_SIZE:
                sizes.append(size)
        if max(sizes) > len(payload):
            payload = self.catalogue.source.read_at(at, max(sizes))
        return payload, sizes

    def lose_packets(self, hole: MissingPackets, ref: ChunkRef, size: int) -> None:
        if hole.row is not None:
            row = hole.row
            message = f"a packet of track {row.track} cannot be delivered"
            self.catalogue.lose("bad-packet", hole.offset, hole.size, message, "DAT-008")
            if row.track in self.ranges:
                self.left_out.append(LostSpan(row.track, row.start, row.stop, hole.offset))
            elif row.track not in self.catalogue.tracks:
                self.losses.lose(row.track, row.start, row.stop, hole.offset)
        elif hole.after is None and hole.before is None:
            at, message = ref.offset + HEADER_SIZE, "no packet can be read"
            self.catalogue.lose("bad-table", at, size, message, "REC-003")
            self.suspect(self.ranges, self.times(ref), at)
        else:
            tracks = hole.tracks(sorted(self.catalogue.tracks))
            named = [row.track for row in hole.missing] or tracks
            ends = sorted({named[0], named[-1]}) if named else ["?"]
            message = f"packets of track {' to '.join(map(str, ends))} are damaged"
            self.catalogue.lose("bad-packet", hole.offset, hole.size, message, "DAT-004")
            self.suspect(self.ranges.keys() & set(tracks), self.times(ref), hole.offset)

    def settle(self, packet: Packet) -> bool:
        """Check the order of time (DAT-006, TRK-016) and note losses before this packet. False:
        leave the packet out."""
        line, place = self.lines[packet.track]
        last = line.stop
        if line.free:
            return True
        if packet.start < last or place < line.place:
            error = disorder(packet, alone=place == line.place)
            if not self.catalogue.damaged:
                raise error.at(path=self.catalogue.source.path)
            message = f"a packet of track {packet.track} covers ticks that were delivered before"
            rule, size = error.requirement or "DAT-006", len(packet.data)
            self.catalogue.lose("overlap", packet.offset, size, message, rule)
            self.left_out.append(LostSpan(packet.track, packet.start, packet.stop, packet.offset))
            return False
        for track in line.tracks[line.place : place + 1]:
            self.losses.settle(track, last, packet.start)
        line.advance(place, packet.start, packet.stop)
        return True


def disorder(packet: Packet, *, alone: bool) -> FormatError:
    if alone:
        return FormatError(
            f"packets of track {packet.track} overlap", requirement="DAT-006", offset=packet.offset
        )
    return FormatError(
        f"packets of track {packet.track} and of one that it continues or is continued by overlap",
        requirement="TRK-016",
        offset=packet.offset,
    )


BATCH = 1 << 15
"""Samples that are worth handing to another thread."""


class Batch(NamedTuple):
    """Packets that one thread decodes, and how many samples they have."""

    packets: list[Packet]
    weight: int


def batches(
    packets: Iterable[Packet], tracks: Mapping[int, Track], limits: Limits, size: int
) -> Iterator[Batch]:
    """Packets that the limits let pass, in their order, as few together as hold ``size`` samples;
    what an error leaves of a batch comes before it."""
    batch, weight, work = [], 0, 0
    try:
        for packet in packets:
            samples = tracks[packet.track].weight(packet.span, len(packet.data))
            work += samples
            limits.check("packet_samples", samples)
            limits.check("work_samples", work)
            batch.append(packet)
            weight += samples
            if weight >= size:
                yield Batch(batch, weight)
                batch, weight = [], 0
    except Exception:
        if batch:
            yield Batch(batch, weight)
        raise
    if batch:
        yield Batch(batch, weight)
