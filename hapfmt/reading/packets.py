"""DATA chunks -> packets in order of time, and what damage took (SPEC clauses 6.4, 7 and 12)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from ..container.cluster import Packet, parse_cluster, parse_count, parse_entry
from ..container.salvage import Hole, is_cluster, salvage_cluster
from ..container.walk import header_at, holds, read_chunk
from ..container.wire import HEADER_SIZE, ChunkHeader
from ..errors import ChecksumError, FormatError
from .catalogue import Catalogue, ChunkRef
from .losses import Losses
from .partial import SHARE, Ranges, Row, read_packets, read_table, wanted_rows
from .seconds import Seconds, overlapping, tick_after
from .timeline import UNKNOWN, Timeline, Times

TAIL_LOSSES = frozenset({"missing-chunk", "truncated", "garbage", "duplicate-chunk"})
"""Findings after the last DATA chunk that may have been packets."""

MS = 10**6
"""Nanoseconds."""
EXTRA_SIZE = 1 << 16
"""Bytes that a damaged payload may be longer than its header says."""


@dataclass
class Line:
    """Tracks that continue one another, or one alone: which is at work, and where its last packet
    ended. ``free``: of events, whose packets come in any order."""

    tracks: tuple[int, ...]
    free: bool = False
    place: int = 0
    stop: int = 0


@dataclass
class Progress:
    """Where a pass over the packets stands; ``lines`` by track, with its place in the line."""

    lines: dict[int, tuple[Line, int]]
    timeline: Timeline | None = None
    """None where nothing is damaged, or each chunk has its times from an index."""
    done: int = 0
    """DATA chunks before the one that is read."""
    ahead: dict[int, int] = field(default_factory=dict)
    """Where the packets of the next chunk start, by track, while a damaged one is read."""
    torn: bool = False
    """Whether chunks are missing behind the one that is read."""
    last: ChunkRef | None = None
    """A damaged one behind which no chunk stands."""

    @classmethod
    def of(cls, catalogue: Catalogue) -> Progress:
        rows: list[tuple[int, ...]] = [(track,) for track in catalogue.tracks]
        for parts in catalogue.parts:
            rows.append(tuple(part.track.id for part in parts))
            rows.append(tuple(part.residual.id for part in parts if part.residual))
        lines: dict[int, tuple[Line, int]] = {}
        for row in rows:
            line = Line(row, any(catalogue.tracks[track].kind == "events" for track in row))
            lines |= {track: (line, place) for place, track in enumerate(row)}
        return cls(lines)


class PacketPass:
    """One pass over the packets of some tracks.

    ``lost`` grows on the way; ``on_damage`` is called at each damage found, and may raise.
    """

    def __init__(self, catalogue: Catalogue, on_damage: Callable[[], None]) -> None:
        self.catalogue = catalogue
        self.on_damage = on_damage
        self.losses = Losses(catalogue.tracks)
        self.lost = self.losses.spans
        again = [f.offset for f in catalogue.findings if f.code == "duplicate-chunk"]
        self.offsets = sorted([*again, *(ref.offset for ref in catalogue.chunks)])
        self.state = Progress.of(catalogue)
        self.stops: dict[tuple[int, ...], int] = {}
        """Where the last packet of each line ended."""
        self.unproven: ChunkRef | None = None
        """The last cluster that was read in part: a damaged row may hide what follows there."""

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
        state = self.state
        refs = overlapping(self.catalogue.data, start, stop)
        walked = self.catalogue.damaged and not self.catalogue.indexed
        state.timeline = Timeline(self.catalogue, refs) if walked else None
        found: set[int] = set()
        if self.catalogue.damaged:
            found = {ref.sequence for ref in self.catalogue.chunks if ref.sequence is not None}
        jumps = sorted(f.offset for f in self.catalogue.findings if f.code == "missing-chunk")
        previous: ChunkRef | None = None
        for done, ref in enumerate(refs):
            state.done = done
            if self.missing(found, previous, ref):
                place = bisect_right(jumps, ref.offset) - 1
                self.suspect(state, ranges, jumps[place] if place >= 0 else ref.offset)
            previous = ref
            following = refs[done + 1 :][:1]
            state.ahead = self.ahead(following) if ref.start_ns is None else {}
            state.torn = any(self.missing(found, ref, after) for after in following)
            state.torn = state.torn or (not following and any(self.tail(ref)))
            for packet in self.cluster(ref, state, ranges):
                if packet.track not in ranges:
                    continue
                first, last = ranges[packet.track]
                line = state.lines[packet.track][0]
                if not line.free and packet.start > self.stops.get(line.tracks, first):
                    self.prove(state, ranges)
                if self.beyond(packet, state) or not self.settle(packet, state):
                    continue
                self.stops[line.tracks] = packet.stop
                if packet.start < last and packet.stop > first:
                    yield packet
            if progress:
                progress(done + 1, len(refs))
        rows = [(state.lines[track][0], *ends) for track, ends in ranges.items()]
        if any(self.stops.get(x.tracks, first) < last for x, first, last in rows if not x.free):
            self.prove(state, ranges)
        state.done = len(refs)
        for offset in [*self.tail(previous), *([state.last.offset] if state.last else [])]:
            self.suspect(state, ranges, offset)
        for track in sorted(ranges):
            self.losses.end(track, state.lines[track][0].stop)

    def missing(self, found: set[int], before: ChunkRef | None, after: ChunkRef) -> bool:
        """Whether chunks were lost between two DATA chunks; ``found`` are the sequence numbers of
        the chunks whose header holds."""
        if not self.catalogue.damaged or self.catalogue.indexed or after.sequence is None:
            return False
        low = -1 if before is None or before.sequence is None else before.sequence
        return any(number not in found for number in range(low + 1, after.sequence))

    def tail(self, last: ChunkRef | None) -> Iterator[int]:
        """Offsets of damage behind the last DATA chunk that may have been packets."""
        end = last.offset if last else -1
        for finding in self.catalogue.findings if self.catalogue.damaged else ():
            if finding.code in TAIL_LOSSES and finding.offset > end:
                yield finding.offset

    def suspect(
        self, state: Progress, tracks: Iterable[int], offset: int, ref: ChunkRef | None = None
    ) -> None:
        """Damage at ``offset``, in the chunk ``ref`` or where a chunk is missing, may have taken
        packets of these tracks."""
        times = UNKNOWN
        if state.timeline is not None:
            times = state.timeline.between(state.done, offset)
        elif ref is not None and ref.start_ns is not None and ref.stop_ns is not None:
            times = Times(ref.start_ns // MS, -(-ref.stop_ns // MS))
        self.losses.suspect(tracks, times, offset)

    def cluster(self, ref: ChunkRef, state: Progress, ranges: Ranges) -> Iterator[Packet]:
        """The packets of one DATA chunk, or of it those that are wanted; damaged ones are reported
        instead."""
        source = self.catalogue.source
        listed = ref.limit is not None
        header = header_at(source, ref.offset, self.catalogue.file_id)
        if listed:
            ref.checked(header)
        if header is None:
            # It stood there when the file was opened.
            raise ChecksumError(
                "the file changed while it was read", offset=ref.offset, path=source.path
            )
        part = self.part(ref, header, ranges)
        if part is not None:
            yield from part
        else:
            yield from self.whole(ref, header, state, ranges)

    def part(self, ref: ChunkRef, header: ChunkHeader, ranges: Ranges) -> list[Packet] | None:
        """The wanted packets alone; None where that saves nothing, or where the CRC of the whole
        payload is needed."""
        source, tracks = self.catalogue.source, self.catalogue.tracks
        if ref.stop_ns is None or header.payload_size <= source.gap:
            return None
        if any(self.state.lines[track][0].free for track in ranges):
            return None
        if SHARE * len(ranges) >= len(tracks):
            return None
        rows = read_table(source, ref, header, tracks, self.catalogue.level, ranges)
        if rows is None:
            return None
        wanted = wanted_rows(rows, ranges)
        if SHARE * sum(entry.size for entry, _ in wanted) >= header.payload_size:
            return None
        listed = ref.limit is not None
        if listed and not self.goes_on(rows, ranges, ref.stop_ns):
            return None
        packets = read_packets(source, wanted, header.seed)
        if packets is not None and listed:
            self.unproven = ref
        return packets

    def goes_on(self, rows: Sequence[Row], ranges: Ranges, stop_ns: int) -> bool:
        """Whether each wanted line has its samples without a gap, from where it stood, or the start
        of its range, to where it ends here; one that stands at its end already needs none."""
        here: dict[tuple[int, ...], int] = {}
        ends: dict[tuple[int, ...], int] = {}
        for track, (first, last) in ranges.items():
            if self.state.lines[track][0].free:
                continue
            line = self.state.lines[track][0].tracks
            here[line] = self.stops.get(line, first)
            rate = self.catalogue.tracks[track].rate
            ends[line] = min(last, tick_after(stop_ns, rate))
        reached: set[tuple[int, ...]] = set()
        for entry, _ in rows:
            line = self.state.lines[entry.track][0].tracks
            if line not in here or entry.start >= ranges[entry.track][1]:
                continue
            if entry.start > here[line]:
                return False
            here[line] = max(here[line], entry.stop)
            reached.add(line)
        proven = all(line in reached or here[line] >= end for line, end in ends.items())
        return proven and bool(ends)

    def prove(self, state: Progress, ranges: Ranges) -> None:
        """A gap: take the CRC of the payload that the missing packets may have stood in."""
        ref, self.unproven = self.unproven, None
        if ref is None:
            return
        header = header_at(self.catalogue.source, ref.offset, self.catalogue.file_id)
        for _ in self.whole(ref, ref.checked(header), state, ranges):
            # Those that are wanted were delivered.
            pass

    def whole(
        self, ref: ChunkRef, header: ChunkHeader, state: Progress, ranges: Ranges
    ) -> Iterator[Packet]:
        catalogue, seed = self.catalogue, header.seed
        at, size = ref.offset + HEADER_SIZE, header.payload_size
        payload = catalogue.source.read_at(at, size)
        intact = holds(header, payload)
        if intact:
            try:
                yield from parse_cluster(payload, catalogue.tracks, catalogue.level, at, seed)
                return
            except FormatError as error:
                if not catalogue.damaged:
                    raise error.at(path=catalogue.source.path) from None
        elif ref.limit is not None:
            message = "checksum error in the payload of a DATA chunk"
            catalogue.lose(
                "bad-payload", ref.offset, len(payload) + HEADER_SIZE, message, "CHK-003"
            )
            self.on_damage()
        payload, sizes = self.region(ref, payload, size)
        if not intact and ref.limit is None and ref.offset == self.offsets[-1]:
            state.last = ref
        items = list(salvage_cluster(payload, catalogue.tracks, catalogue.level, at, seed, sizes))
        if not intact and self.foreign(payload[:size], items, state, seed):
            self.suspect(state, ranges, ref.offset, ref)
        for item in items:
            if isinstance(item, Packet):
                yield item
            else:
                self.lose_packets(item, ref, len(payload), state, ranges)

    def foreign(
        self, payload: bytes, items: Sequence[Packet | Hole], state: Progress, seed: int
    ) -> bool:
        """Whether a damaged payload may hold bytes of another cluster, so that nothing in it tells
        what is missing: chunks are missing behind it, or none stands there, its packets are in the
        way of others, or it is whole, and yet not what its header speaks of."""
        if state.torn or state.last:
            return True
        lines = state.lines
        for item in items:
            if isinstance(item, Packet) and not lines[item.track][0].free:
                late = item.stop > state.ahead.get(item.track, item.stop)
                if late or item.start < lines[item.track][0].stop:
                    return True
        return is_cluster(payload, self.catalogue.tracks, self.catalogue.level, seed)

    def ahead(self, following: Sequence[ChunkRef]) -> dict[int, int]:
        """Where the packets of the next chunk start, by track: damage may have brought bytes of
        another cluster, and its packets hold too."""
        if not following or following[0].start_ns is None:
            return {}
        chunk = read_chunk(self.catalogue.source, following[0].offset, self.catalogue.file_id)
        firsts: dict[int, int] = {}
        if chunk is not None and chunk.intact:
            count, position = parse_count(chunk.payload, self.catalogue.level, 0)
            for _ in range(count):
                entry, position = parse_entry(chunk.payload, position, 0)
                firsts.setdefault(entry.track, entry.start)
        return firsts

    def beyond(self, packet: Packet, state: Progress) -> bool:
        """Whether it ends after the next packet of its track starts."""
        free = state.lines[packet.track][0].free
        late = packet.stop > state.ahead.get(packet.track, packet.stop) and not free
        if late:
            self.lose_overlap(packet, "ticks of the next packet")
        return late

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

    def lose_packets(
        self, hole: Hole, ref: ChunkRef, size: int, state: Progress, ranges: Ranges
    ) -> None:
        if hole.entry is not None:
            message = f"a packet of track {hole.entry.track} cannot be delivered"
            self.catalogue.lose("bad-packet", hole.offset, hole.size, message, "DAT-008")
            entry = hole.entry
            if entry.track in ranges or entry.track not in self.catalogue.tracks:
                self.losses.lose(entry.track, entry.start, entry.stop, hole.offset)
        elif hole.after is None and hole.before is None:
            at, message = ref.offset + HEADER_SIZE, "no packet can be read"
            self.catalogue.lose("bad-table", at, size, message, "REC-003")
            self.suspect(state, ranges, at, ref)
        else:
            tracks = hole.tracks(sorted(self.catalogue.tracks))
            ends = sorted({tracks[0], tracks[-1]}) if tracks else ["?"]
            message = f"packets of track {' to '.join(map(str, ends))} are damaged"
            self.catalogue.lose("bad-packet", hole.offset, hole.size, message, "DAT-004")
            self.suspect(state, ranges.keys() & set(tracks), hole.offset, ref)

    def lose_overlap(self, packet: Packet, what: str, rule: str | None = None) -> None:
        message, size = f"a packet of track {packet.track} covers {what}", len(packet.data)
        self.catalogue.lose("overlap", packet.offset, size, message, rule or "DAT-006")

    def settle(self, packet: Packet, state: Progress) -> bool:
        """Order of time (DAT-006, TRK-016), and what was lost before this packet; False: leave it
        out."""
        line, place = state.lines[packet.track]
        last = line.stop
        if line.free:
            return True
        if packet.start < last or place < line.place:
            error = disorder(packet, alone=place == line.place)
            if not self.catalogue.damaged:
                raise error.at(path=self.catalogue.source.path)
            self.lose_overlap(packet, "ticks that were delivered before", error.requirement)
            return False
        for track in line.tracks[line.place : place + 1]:
            self.losses.settle(track, last, packet.start)
        line.place, line.stop = place, packet.stop
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
