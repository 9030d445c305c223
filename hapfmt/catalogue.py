"""What a file holds and where: from its index, or by walking through it (SPEC clauses 5, 6, 12).

Nothing is decoded here, and NumPy is not needed: this is all that ``hapfmt info`` loads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from .container.cluster import parse_count, parse_entry
from .container.extras import Attachment, parse_attachment, parse_metadata
from .container.index import (
    FIRST_OFFSET,
    Foot,
    Index,
    IndexEntry,
    ceil_ns,
    floor_ns,
    parse_foot,
    parse_index,
)
from .container.series import parse_series
from .container.source import Source
from .container.track import Track, add_series
from .container.walk import Chunk, Finding, read_chunk, walk
from .container.wire import HEADER_SIZE, SIGNATURE, ChunkHeader, Head, parse_head
from .errors import FormatError, HapfmtError, UnsupportedError
from .limits import LEVELS, Level

FOOT_SIZE = 64
HARMLESS = frozenset({"not-closed"})
"""Findings that lose nothing that stands in the file."""


@dataclass(frozen=True)
class ChunkRef:
    """Where a chunk stands, and the nanoseconds that the packets of a DATA chunk lie within.

    The times are None where damage hides them, sequence and size where the index was read only.
    """

    type: str
    offset: int
    start_ns: int | None = None
    stop_ns: int | None = None
    sequence: int | None = None
    size: int | None = None


@dataclass(frozen=True)
class ChannelRef:
    """A channel's place: component ``index`` of its base track, and its HF track, if any."""

    number: int
    track: Track
    index: int
    residual: Track | None

    @property
    def label(self) -> str:
        return self.track.components[self.index].label


@dataclass
class Catalogue:
    """Descriptions and chunk places of one file; ``findings`` is empty where nothing is wrong."""

    source: Source
    head: Head | None = None
    tracks: dict[int, Track] = field(default_factory=dict)
    chunks: list[ChunkRef] = field(default_factory=list)
    metadata: dict[str, Any] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    unknown: list[ChunkHeader] = field(default_factory=list)
    unsupported: UnsupportedError | None = None
    foot: Foot | None = None
    indexed: bool = False
    known_findings: set[Finding] = field(default_factory=set)

    @property
    def level(self) -> Level:
        return LEVELS[self.head.level] if self.head else LEVELS[2]

    @property
    def damaged(self) -> bool:
        return any(finding.code not in HARMLESS for finding in self.findings)

    @property
    def closed(self) -> bool:
        return self.foot is not None

    @property
    def data(self) -> list[ChunkRef]:
        """DATA chunks in order of their sequence numbers, which is order of time."""
        found = [chunk for chunk in self.chunks if chunk.type == "DATA"]
        if not self.indexed:
            found.sort(key=lambda chunk: -1 if chunk.sequence is None else chunk.sequence)
        return found

    @property
    def channels(self) -> list[ChannelRef]:
        """All channels in order of their numbers."""
        residuals = {track.base: track for track in self.tracks.values() if track.kind == "hf"}
        found = [
            ChannelRef(number, track, index, residuals.get(track.id))
            for track in self.tracks.values()
            if track.kind != "hf"
            for index, number in enumerate(track.channels)
        ]
        return sorted(found, key=lambda channel: channel.number)

    @property
    def duration(self) -> Fraction:
        """Seconds to the end of the last packet, to the nanosecond above."""
        stop = max((chunk.stop_ns or 0 for chunk in self.data), default=0)
        return Fraction(stop, 10**9)

    def attachments(self) -> list[Attachment]:
        found = []
        for ref in self.chunks:
            if ref.type == "aTTc":
                chunk = read_chunk(self.source, ref.offset)
                if chunk is not None and chunk.intact and chunk.header.known:
                    found.append(parse_attachment(chunk.payload, chunk.payload_offset))
        return found

    def lose(self, code: str, offset: int, size: int, message: str, requirement: str) -> None:
        finding = Finding(code, offset, size, message, requirement)
        if finding not in self.known_findings:
            self.known_findings.add(finding)
            self.findings.append(finding)


def open_catalogue(source: Source, *, scan: bool = False) -> Catalogue:
    """By the index where there is one and it holds, else by walking; ``scan`` always walks."""
    try:
        if not scan:
            found = from_index(source)
            if found is not None:
                return found
        return from_walk(source)
    except HapfmtError as error:
        raise error.at(path=source.path) from None


def from_index(source: Source) -> Catalogue | None:
    """None where anything about the index is not as it should be (IDX-003)."""
    catalogue = Catalogue(source, indexed=True)
    try:
        if source.size < FIRST_OFFSET + FOOT_SIZE or source.read_at(0, 8) != SIGNATURE:
            return None
        first = read_chunk(source, FIRST_OFFSET)
        if first is None or not first.intact or first.header.type != "HEAD":
            return None
        file_id = first.header.file_id
        last = read_chunk(source, source.size - FOOT_SIZE, file_id)
        if last is None or not last.intact or last.header.type != "fOOT":
            return None
        catalogue.foot = parse_foot(last.payload, last.payload_offset)
        for entry in index_entries(source, catalogue.foot.index_offset, file_id):
            catalogue.chunks.append(
                ChunkRef(entry.type, entry.offset, entry.start_ns, entry.stop_ns)
            )
            if entry.type == "DATA":
                continue
            chunk = read_chunk(source, entry.offset, file_id)
            if chunk is None or not chunk.intact or chunk.header.type != entry.type:
                return None
            take_chunk(catalogue, chunk)
    except FormatError:
        return None
    return catalogue if catalogue.head else None


def index_entries(source: Source, offset: int, file_id: int) -> list[IndexEntry]:
    """All entries, oldest first, by the chain of indexes that ends at ``offset``."""
    parts: list[Index] = []
    position = offset
    while True:
        chunk = read_chunk(source, position, file_id)
        if chunk is None or not chunk.intact or chunk.header.type != "iNDX":
            raise FormatError(
                "no index where one should be", requirement="IDX-004", offset=position
            )
        index = parse_index(chunk.payload, position, chunk.payload_offset)
        parts.append(index)
        if index.covers_from == FIRST_OFFSET:
            break
        position = index.previous
    entries: list[IndexEntry] = []
    stops = [part.covers_from for part in parts[-2::-1]] + [1 << 64]
    for index, stop in zip(reversed(parts), stops, strict=True):
        entries += [entry for entry in index.entries if entry.offset < stop]
    return entries


def from_walk(source: Source) -> Catalogue:
    """Every chunk that can be found, in the order of the file; damage becomes findings."""
    catalogue = Catalogue(source)
    stop = 0
    for chunk in walk(source, catalogue.findings):
        stop = max(stop, min(chunk.stop, source.size))
        ref = ChunkRef(
            chunk.header.type,
            chunk.offset,
            sequence=chunk.header.sequence,
            size=chunk.header.payload_size,
        )
        catalogue.foot = None
        if chunk.intact:
            try:
                ref = take_chunk(catalogue, chunk) or ref
            except FormatError as error:
                if not catalogue.damaged:
                    raise
                lose_chunk(catalogue, chunk, error)
        catalogue.chunks.append(ref)
    check_found(catalogue)
    return catalogue


def lose_chunk(catalogue: Catalogue, chunk: Chunk, error: HapfmtError) -> None:
    """In a damaged file a chunk that fits nothing is part of the damage."""
    catalogue.lose(
        "bad-chunk",
        chunk.offset,
        chunk.stop - chunk.offset,
        f"{chunk.header.type} chunk: {error.message}",
        error.requirement or "REC-003",
    )


def check_found(catalogue: Catalogue) -> None:
    """What only the end of the walk tells."""
    source = catalogue.source
    if not catalogue.chunks:
        rule, message = ("FIL-001", "not a hapf file: no signature")
        if source.read_at(0, len(SIGNATURE)) == SIGNATURE:
            rule, message = ("HED-001", "a signature without any chunk")
        raise FormatError(message, requirement=rule, offset=0)
    if catalogue.head is None:
        catalogue.lose("missing-head", FIRST_OFFSET, 0, "no HEAD chunk that holds", "HED-001")
    if catalogue.foot is None:
        catalogue.lose(
            "not-closed",
            source.size,
            0,
            "the file was not closed: its end may be missing",
            "FIL-003",
        )


def take_chunk(catalogue: Catalogue, chunk: Chunk) -> ChunkRef | None:
    """Learn what an intact chunk says; a DATA chunk only tells its place in time."""
    header, offset = chunk.header, chunk.payload_offset
    if not header.known:
        catalogue.unknown.append(header)
        if header.critical and catalogue.unsupported is None:
            catalogue.unsupported = UnsupportedError(
                f"unknown critical chunk {header.type!r}",
                requirement="CHK-009",
                offset=chunk.offset,
                path=catalogue.source.path,
            )
        return None
    if header.type == "HEAD":
        take_head(catalogue, chunk)
        return None
    if catalogue.head is None and not catalogue.damaged:
        raise FormatError("the first chunk is not HEAD", requirement="HED-001", offset=chunk.offset)
    catalogue.level.check("payload_size", header.payload_size, "LIM-001", chunk.offset)
    if header.type == "TRAK":
        add_series(
            catalogue.tracks,
            parse_series(chunk.payload, header.track, catalogue.level, offset),
            damaged=catalogue.damaged,
        )
    elif header.type == "mETa":
        catalogue.metadata.update(parse_metadata(chunk.payload, offset))
    elif header.type == "fOOT":
        catalogue.foot = parse_foot(chunk.payload, offset, moved=catalogue.damaged)
    elif header.type == "DATA" and not catalogue.indexed:
        start_ns, stop_ns = time_range(catalogue, chunk)
        return ChunkRef(
            "DATA", chunk.offset, start_ns, stop_ns, header.sequence, header.payload_size
        )
    return None


def take_head(catalogue: Catalogue, chunk: Chunk) -> None:
    if catalogue.head is None:
        if chunk.offset != FIRST_OFFSET and not catalogue.damaged:
            raise FormatError(
                "HEAD is not the first chunk", requirement="HED-001", offset=chunk.offset
            )
        catalogue.head = parse_head(chunk.payload, chunk.header, chunk.payload_offset)
    elif parse_head(chunk.payload, chunk.header, chunk.payload_offset) != catalogue.head:
        raise FormatError("a second, different HEAD", requirement="HED-006", offset=chunk.offset)


def time_range(catalogue: Catalogue, chunk: Chunk) -> tuple[int, int] | tuple[None, None]:
    """Nanoseconds from the earliest sample to the end of the latest of an intact DATA chunk.

    None where a description is lost: a copy of it may still follow.
    """
    count, position = parse_count(chunk.payload, catalogue.level, chunk.payload_offset)
    earliest: Fraction | float = math.inf
    latest: Fraction | float = -math.inf
    for _ in range(count):
        entry, position = parse_entry(chunk.payload, position, chunk.payload_offset)
        track = catalogue.tracks.get(entry.track)
        if track is None:
            if catalogue.damaged:
                return None, None
            raise FormatError(
                f"packet of track {entry.track}, which is not described",
                requirement="DAT-008",
                offset=entry.offset,
            )
        earliest = min(earliest, entry.start / track.rate)
        latest = max(latest, (entry.start + entry.span) / track.rate)
    return floor_ns(Fraction(earliest)), ceil_ns(Fraction(latest))


__all__ = ["HEADER_SIZE", "Catalogue", "ChannelRef", "ChunkRef", "open_catalogue"]
