"""DATA chunks -> packets in order of time, and what damage took (SPEC clauses 6.4, 7 and 12)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import NamedTuple

from .catalogue import Catalogue, ChunkRef
from .container.cluster import Packet, parse_cluster, salvage_cluster
from .container.walk import header_at, read_chunk
from .errors import ChecksumError, FormatError
from .numbers import exact

Seconds = Fraction | float | int
TAIL_LOSSES = frozenset({"missing-chunk", "truncated", "garbage", "duplicate-chunk"})
"""Findings after the last DATA chunk that may have been packets."""


class LostSpan(NamedTuple):
    """Ticks of a track that damage took: start <= t < stop; stop None: nobody knows how many."""

    track: int
    start: int
    stop: int | None


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
    broken: set[int] = field(default_factory=set)

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
        self.lost: list[LostSpan] = []

    def packets(
        self,
        ranges: dict[int, tuple[int, int]],
        start: Seconds | None = None,
        stop: Seconds | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Packet]:
        """Packets of the tracks in ``ranges`` that overlap their tick range, CRCs checked."""
        state = Progress.of(self.catalogue)
        refs = [ref for ref in self.catalogue.data if overlaps(ref, start, stop)]
        found = {ref.sequence for ref in self.catalogue.chunks if ref.sequence is not None}
        previous: ChunkRef | None = None
        for done, ref in enumerate(refs):
            if self.missing(found, previous, ref):
                state.broken.update(ranges)
            previous = ref
            for packet in self.cluster(ref, state, set(ranges)):
                if packet.track not in ranges:
                    continue
                if not self.settle(packet, state):
                    continue
                first, last = ranges[packet.track]
                if packet.start < last and packet.stop > first:
                    yield packet
            if progress:
                progress(done + 1, len(refs))
        if self.missing(found, previous, None):
            state.broken.update(ranges)
        for track in sorted(state.broken & set(ranges)):
            line, place = state.lines[track]
            if place >= line.place:
                self.lost.append(LostSpan(track, line.stop, None))

    def holds(self, start: Seconds | None, stop: Seconds | None) -> bool:
        """Whether a DATA chunk stands wherever an index says that one does (IDX-003)."""
        for ref in self.catalogue.data:
            if self.catalogue.indexed and overlaps(ref, start, stop):
                header = header_at(self.catalogue.source, ref.offset, self.file_id)
                if header is None or header.type != "DATA" or not header.known:
                    return False
        return True

    @property
    def file_id(self) -> int | None:
        return self.catalogue.head.file_id if self.catalogue.head else None

    def missing(self, found: set[int], before: ChunkRef | None, after: ChunkRef | None) -> bool:
        """Whether chunks were lost between two DATA chunks; ``found`` are the sequence numbers of
        the chunks whose header holds."""
        if self.catalogue.indexed or not self.catalogue.damaged:
            return False
        if after is None or after.sequence is None:
            end = before.offset if before else -1
            return any(f.code in TAIL_LOSSES and f.offset > end for f in self.catalogue.findings)
        low = -1 if before is None or before.sequence is None else before.sequence
        return any(number not in found for number in range(low + 1, after.sequence))

    def cluster(self, ref: ChunkRef, state: Progress, wanted: set[int]) -> Iterator[Packet]:
        """The packets of one DATA chunk; damaged ones are reported instead."""
        catalogue = self.catalogue
        chunk = read_chunk(catalogue.source, ref.offset)
        if chunk is None:
            # Its header stood there when the file was opened.
            raise ChecksumError(
                "the file changed while it was read", offset=ref.offset, path=catalogue.source.path
            )
        at, size = chunk.payload_offset, len(chunk.payload)
        if chunk.intact:
            try:
                yield from parse_cluster(chunk.payload, catalogue.tracks, catalogue.level, at)
                return
            except FormatError as error:
                if not catalogue.damaged:
                    raise error.at(path=self.catalogue.source.path) from None
        elif catalogue.indexed:
            catalogue.lose(
                "bad-payload",
                ref.offset,
                size + 32,
                "payload CRC of a DATA chunk differs",
                "CHK-003",
            )
            self.on_damage()
        for item in salvage_cluster(chunk.payload, catalogue.tracks, catalogue.level, at):
            if isinstance(item, Packet):
                yield item
            elif item is None:
                catalogue.lose("bad-table", at, size, "the packet table cannot be read", "REC-003")
                state.broken.update(wanted)
            else:
                catalogue.lose(
                    "bad-packet", item.offset, item.size,
                    f"a packet, perhaps of track {item.track}, is damaged", "DAT-004",
                )  # fmt: skip
                # The entry itself may be what is damaged: any track may have lost something.
                state.broken.update(wanted)

    def settle(self, packet: Packet, state: Progress) -> bool:
        """Order of time (DAT-006, TRK-017), and what was lost before this packet; False: leave it
        out."""
        line, place = state.lines[packet.track]
        last = line.stop
        if line.free:
            return True
        if packet.start < last or place < line.place:
            error = disorder(packet, alone=place == line.place)
            if not self.catalogue.damaged:
                raise error.at(path=self.catalogue.source.path)
            self.catalogue.lose(
                "overlap",
                packet.offset,
                len(packet.data),
                f"a packet of track {packet.track} covers ticks that were delivered before",
                error.requirement or "DAT-006",
            )
            return False
        if state.broken:
            for track in line.tracks[line.place : place + 1]:
                if track in state.broken:
                    if packet.start > last:
                        self.lost.append(LostSpan(track, last, packet.start))
                    state.broken.discard(track)
        line.place, line.stop = place, packet.stop
        return True


def disorder(packet: Packet, *, alone: bool) -> FormatError:
    if alone:
        return FormatError(
            f"packets of track {packet.track} overlap", requirement="DAT-006", offset=packet.offset
        )
    return FormatError(
        f"packets of track {packet.track} and of one that it continues or is continued by overlap",
        requirement="TRK-017",
        offset=packet.offset,
    )


def tick_range(rate: Fraction, start: Seconds | None, stop: Seconds | None) -> tuple[int, int]:
    """Ticks from ceil(start * rate) to ceil(stop * rate), exactly (SPEC clause 7)."""

    def tick(seconds: Seconds) -> int:
        product = exact(seconds) * rate
        return -(-product.numerator // product.denominator)

    return (
        0 if start is None else max(tick(start), 0),
        1 << 62 if stop is None else tick(stop),
    )


def overlaps(ref: ChunkRef, start: Seconds | None, stop: Seconds | None) -> bool:
    if ref.start_ns is None or ref.stop_ns is None:
        return True
    after = stop is not None and exact(stop) * 10**9 <= ref.start_ns
    before = start is not None and exact(start) * 10**9 >= ref.stop_ns
    return not (after or before)
