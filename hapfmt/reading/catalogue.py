"""The catalogue of a file: its descriptions and the places of its chunks (SPEC clauses 5 and 6).

It learns one chunk after another as they are found. It decodes nothing and does not need NumPy:
``hapfmt info`` loads only this.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple, TypeVar
from uuid import UUID

from ..clocks import ClockMap, ClockObservation
from ..errors import HARMLESS, FormatError, TruncatedError, UnsupportedError, verdict_of
from ..format.cluster import Table, TableRow, parse_rows, parse_table_head
from ..format.extras import (
    FIRST_OFFSET,
    NS_LIMIT,
    Attachment,
    ClockChunk,
    ClockMapChunk,
    Foot,
    parse_attachment,
    parse_clock,
    parse_foot,
    parse_map,
    parse_metadata,
)
from ..format.source import ByteSource
from ..format.track import Contract, Track, TrackTable, described_size, parse_description
from ..format.walk import Chunk, Finding, read_chunk
from ..format.wire import HEADER_SIZE, ChunkHeader, Head, parse_head, uuid_of
from ..limits import LEVELS, Level, Limits
from ..units import unit_text

T = TypeVar("T", ClockChunk, ClockMapChunk)
COMPONENT_SIZE = 1 << 10
"""Bytes of a description that count as a component."""


KEPT_ROWS = 1 << 14
"""Rows of tables that are kept: about 6 MB. Further tables are parsed again when they are read."""


class FalseIndexError(FormatError):
    """An entry of an index does not match the file: the reader must walk the file (IDX-003)."""


def refuse_omission(count: int, offset: int, path: str | None) -> None:
    """Raise FormatError if the index omits ``count`` packets before ``offset``."""
    if count:
        raise FormatError(
            "the index does not match the chunks", requirement="IDX-002", offset=offset, path=path
        )


class ChunkRef(NamedTuple):
    """The place of a chunk, and the nanoseconds that the packets of a DATA chunk lie within.

    The times are None where damage hides them. Sequence and size are None if only the index was
    read.
    """

    type: str
    offset: int
    start_ns: int | None = None
    stop_ns: int | None = None
    sequence: int | None = None
    size: int | None = None
    limit: int | None = None
    """Offset of the next listed chunk, if this one is known from an index only."""

    def checked(self, header: ChunkHeader | None) -> ChunkHeader:
        """The header at this offset, if it is the listed one; else FalseIndexError (IDX-003)."""
        if (
            header is None
            or header.type != self.type
            or self.offset + HEADER_SIZE + header.payload_size > (self.limit or self.offset)
        ):
            raise FalseIndexError(
                f"the index lists a {self.type} chunk that is not there",
                requirement="IDX-003",
                offset=self.offset,
            )
        return header


class TrackPair(NamedTuple):
    """A track that is not HF, and its HF track, if any."""

    track: Track
    residual: Track | None

    @property
    def contract(self) -> Contract | None:
        return (self.residual or self.track).contract

    @property
    def tracks(self) -> list[Track]:
        return [self.track] + ([self.residual] if self.residual else [])

    @property
    def synthetic(self) -> bool:
        """Whether the texture comes from a model (NOI-002)."""
        return any(track.synthetic for track in self.tracks)

    def kept_as(self, index: int) -> str:
        """Say what the file states of the samples of the component ``index``."""
        if not self.synthetic:
            return bound_text(self.track, self.contract, index)
        if self.track.contract is None:
            return "synthetic texture"
        return f"slow part {bound_text(self.track, self.track.contract, index)}, synthetic texture"


def bound_text(track: Track, contract: Contract | None, index: int) -> str:
    """Say how far a decoded sample may be from the recorded one. Without a contract it is on the
    grid, and as far as the source was from that (DBC-004)."""
    component = track.components[index]
    a, _, d = component.calibration
    moved = component.deviation[1] if component.deviation else 0.0
    if contract is None and not moved:
        return "lossless"
    # A track that this version does not support may have fewer entries.
    floor = 0 if contract is None else contract.floor[min(index, len(contract.floor) - 1)]
    least = f"{floor * abs(a / d) + moved:.3g} {unit_text(component.unit)}".rstrip()
    if contract is None:
        return f"within {least}"
    vector = " of the vector" if contract.vector else ""
    aim = "" if contract.guaranteed else ", an aim"
    if not contract.kn:
        return f"within {least}{vector}{aim}"
    return f"deadband {100 * contract.kn / contract.kd:.3g} %{vector}, at least {least}{aim}"


@dataclass(frozen=True)
class ChannelRef:
    """A channel's place: component ``index`` of each of its parts, which continue one another."""

    number: int
    index: int
    parts: tuple[TrackPair, ...]

    @property
    def track(self) -> Track:
        """The first, whose description is that of the channel."""
        return self.parts[0].track

    @property
    def residual(self) -> Track | None:
        return self.parts[0].residual

    @property
    def tracks(self) -> list[Track]:
        """The tracks of all parts."""
        return [track for part in self.parts for track in part.tracks]

    @property
    def synthetic(self) -> bool:
        return any(part.synthetic for part in self.parts)

    @property
    def label(self) -> str:
        return self.track.components[self.index].label

    @property
    def kept_as(self) -> str:
        """What the file states of the samples, part by part, without repeats."""
        parts = [part for part in self.parts if self.index < len(part.track.components)]
        return ", then ".join(text for text, _ in groupby(p.kept_as(self.index) for p in parts))


@dataclass
class Catalogue:
    """Descriptions and chunk places of one file; ``findings`` is empty where nothing is wrong."""

    source: ByteSource
    limits: Limits = field(default_factory=Limits)
    file_id: int | None = None
    """None where there is no chunk."""
    head: Head | None = None
    table: TrackTable = field(default_factory=TrackTable)
    chunks: list[ChunkRef] = field(default_factory=list)
    metadata: dict[str, Any] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    unknown: list[ChunkHeader] = field(default_factory=list)
    unsupported: UnsupportedError | None = None
    foot: Foot | None = None
    ended: bool = False
    """Whether the last chunk is an intact fOOT, even one that breaks a rule."""
    indexed: bool = False
    tolerant: bool = False
    """Whether a broken rule counts as damage in a file without any other."""
    known_findings: set[Finding] = field(default_factory=set)
    head_payload: bytes = b""
    component_count: int = 0
    metadata_size: int = 0
    tables: dict[int, Table] = field(default_factory=dict)
    """Tables of DATA chunks by their offsets, so that a reader parses each once."""
    kept_rows: int = 0
    last_found: Fraction = Fraction(0)
    """Seconds to the end of the packets found in damaged chunks, whose times may be unknown."""
    _placed: tuple[tuple[int, int], tuple[list[tuple[TrackPair, ...]], list[ChannelRef]]] | None = (
        None
    )

    @property
    def tracks(self) -> dict[int, Track]:
        """By id."""
        return self.table.tracks

    @property
    def exit_code(self) -> int:
        """What reading this file deserves (SPEC clause 13), as far as the chunks tell."""
        return verdict_of((f.code for f in self.findings), unknown=self.not_understood)

    @property
    def not_understood(self) -> bool:
        """Whether there is an unknown critical chunk or track."""
        tracks = self.tracks.values()
        return self.unsupported is not None or any(track.unsupported for track in tracks)

    @property
    def uuid(self) -> UUID | None:
        """The recording's name (SPEC 6.1); None where HEAD is lost."""
        if self.head is None or self.file_id is None:
            return None
        return UUID(bytes=self.head.uuid or uuid_of(self.file_id))

    @property
    def described(self) -> dict[str, Any]:
        """The metadata, with the encoder of HEAD as a member."""
        encoder = {"encoder": self.head.encoder} if self.head and self.head.encoder else {}
        return encoder | self.metadata

    @property
    def level(self) -> Level:
        return LEVELS[self.head.level] if self.head else LEVELS[2]

    @property
    def harmed(self) -> bool:
        """Whether bytes are lost or break a rule."""
        return any(finding.code not in HARMLESS for finding in self.findings)

    @property
    def damaged(self) -> bool:
        return self.tolerant or self.harmed

    @property
    def closed(self) -> bool:
        return self.foot is not None or self.ended

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
        return [*self.placed[1]]

    @property
    def parts(self) -> list[tuple[TrackPair, ...]]:
        """Tracks that continue one another together, each with its HF track. An unsupported track
        counts as lost to its HF track (SPEC 6.3)."""
        return [*self.placed[0]]

    @property
    def placed(self) -> tuple[list[tuple[TrackPair, ...]], list[ChannelRef]]:
        """The parts and the channels, put together again after the tracks have changed."""
        state = self.table.changes, len(self.tracks)
        if self._placed is None or self._placed[0] != state:
            parts = self.paired()
            found = [
                ChannelRef(number, index, chain)
                for chain in parts
                for index, number in enumerate(chain[0].track.channels)
            ]
            found.sort(key=lambda channel: channel.number)
            self._placed = state, (parts, found)
        return self._placed[1]

    def paired(self) -> list[tuple[TrackPair, ...]]:
        residuals = {track.base: track for track in self.tracks.values() if track.kind == "hf"}
        return [
            tuple(
                TrackPair(track, None if track.unsupported else residuals.get(track.id))
                for track in chain
            )
            for chain in self.table.chains()
        ]

    @property
    def layers(self) -> list[Track]:
        """Tracks of kind events in order of their ids."""
        return [
            self.tracks[id_] for id_ in sorted(self.tracks) if self.tracks[id_].kind == "events"
        ]

    @property
    def duration(self) -> Fraction:
        """Seconds to the end of the last packet, to the nanosecond above; as the footer says where
        there may be packets that are not known."""
        if self.foot and (self.indexed or self.harmed):
            return Fraction(self.foot.duration_ns, 10**9)
        stop = max((chunk.stop_ns or 0 for chunk in self.data), default=0)
        return min(max(Fraction(stop, 10**9), self.last_found), Fraction(NS_LIMIT, 10**9))

    @cached_property
    def attachments(self) -> dict[str, Attachment]:
        """By name; a name that comes again gets a number. FalseIndexError where an index lies."""
        found: dict[str, Attachment] = {}
        size = 0
        for name, attachment, offset in self.named_attachments():
            size += len(attachment.content)
            self.limits.check("attachments", size, offset)
            found[name] = attachment
        return found

    def named_attachments(self) -> Iterator[tuple[str, Attachment, int]]:
        """As :meth:`each_attachment`, after the name that no earlier one has."""
        taken: set[str] = set()
        counts: dict[str, int] = {}
        for attachment, offset in self.each_attachment():
            name = attachment.name
            while name in taken:
                counts[attachment.name] = counts.get(attachment.name, 1) + 1
                name = f"{attachment.name} ({counts[attachment.name]})"
            taken.add(name)
            yield name, attachment, offset

    def each_attachment(self) -> Iterator[tuple[Attachment, int]]:
        """One after the other, and the offset of its payload."""
        for chunk in self.intact_chunks("aTTc"):
            at = chunk.payload_offset
            try:
                attachment = parse_attachment(chunk.payload, at)
            except FormatError as error:
                if not self.damaged:
                    raise
                size, rule = chunk.stop - chunk.offset, error.requirement or "ATT-001"
                self.lose("bad-chunk", chunk.offset, size, f"aTTc chunk: {error.message}", rule)
                continue
            yield attachment, at

    def intact_chunks(self, type_: str) -> Iterator[Chunk]:
        """One after the other; FalseIndexError where an index lies."""
        for ref in [ref for ref in self.chunks if ref.type == type_]:
            chunk = read_chunk(self.source, ref.offset, self.file_id)
            if ref.limit is not None:
                ref.checked(chunk.header if chunk else None)
            if chunk is not None and ref.limit is not None and not chunk.intact:
                message = f"checksum error in the payload of the {type_} chunk"
                self.lose(
                    "bad-payload", ref.offset, len(chunk.payload) + HEADER_SIZE, message, "CHK-003"
                )
            if chunk is not None and chunk.intact:
                yield chunk

    @cached_property
    def clocks(self) -> list[ClockObservation]:
        """Observations of other clocks, in the order of the file."""
        return [
            ClockObservation(found.clock, channel, *row)
            for channel, found in self.clocks_of_channels("cLOk", parse_clock)
            for row in found.rows
        ]

    @cached_property
    def clock_maps(self) -> list[ClockMap]:
        """The last one for each clock and channel."""
        maps = {
            (found.clock, channel): ClockMap(found.clock, channel, found.points)
            for channel, found in self.clocks_of_channels("cMAp", parse_map)
        }
        return list(maps.values())

    def clocks_of_channels(
        self, type_: str, parse: Callable[[bytes, int], T]
    ) -> Iterator[tuple[int | None, T]]:
        """Clock chunks and the first channel of their tracks; an HF track alone has none."""
        known: set[int] = set()
        for found in self.parsed_clocks(type_, parse):
            known = known or {ref.number for ref in self.channels}
            channel = None if found.track is None else self.tracks[found.track].first_channel
            if channel is None or channel in known:
                yield channel, found

    def parsed_clocks(self, type_: str, parse: Callable[[bytes, int], T]) -> Iterator[T]:
        """Parsed payloads of intact chunks; in a damaged file, a broken rule counts as damage."""
        for chunk in self.intact_chunks(type_):
            self.metadata_size += len(chunk.payload)
            self.limits.check("metadata", self.metadata_size, chunk.payload_offset)
            try:
                found = parse(chunk.payload, chunk.payload_offset)
                self.check_observed(found.track, chunk)
                yield found
            except FormatError as error:
                if not self.damaged:
                    raise
                size, rule = chunk.stop - chunk.offset, error.requirement or "CLK-001"
                self.lose("bad-chunk", chunk.offset, size, f"{type_} chunk: {error.message}", rule)

    def check_observed(self, id_: int | None, chunk: Chunk) -> None:
        """CLK-005, of the track whose ticks a clock chunk refers to."""
        track = None if id_ is None else self.tracks.get(id_)
        known = track and track.kind != "events" and (self.damaged or track.offset < chunk.offset)
        if id_ is not None and not known:
            raise FormatError(
                f"a clock on the ticks of track {id_}", requirement="CLK-005", offset=chunk.offset
            )

    def lose(self, code: str, offset: int, size: int, message: str, requirement: str) -> None:
        """Note a damage, once."""
        finding = Finding(code, offset, size, message, requirement)
        if finding not in self.known_findings:
            self.check_records()
            self.known_findings.add(finding)
            self.findings.append(finding)

    def check_records(self) -> None:
        """Check that the limits allow another chunk or finding."""
        self.limits.check("records", len(self.chunks) + len(self.findings) + 1)

    def learn(self, chunk: Chunk) -> ChunkRef | None:
        """Learn the contents of an intact chunk; of a DATA chunk, only its place in time."""
        header, offset = chunk.header, chunk.payload_offset
        if not header.known:
            self.unknown.append(header)
            if header.critical and self.unsupported is None:
                self.unsupported = UnsupportedError(
                    f"unknown critical chunk {header.type!r}",
                    requirement="CHK-009",
                    offset=chunk.offset,
                    path=self.source.path,
                )
            self.level.check("payload_size", header.payload_size, "LIM-001", chunk.offset)
            return None
        if header.type == "HEAD":
            if self.head is None:
                if chunk.offset != FIRST_OFFSET and not self.damaged:
                    raise FormatError(
                        "HEAD is not the first chunk", requirement="HED-001", offset=chunk.offset
                    )
                self.head = parse_head(chunk.payload, offset)
                self.head_payload = chunk.payload
            elif chunk.payload != self.head_payload:
                raise FormatError(
                    "a second, different HEAD", requirement="HED-001", offset=chunk.offset
                )
            return None
        self.level.check("payload_size", header.payload_size, "LIM-001", chunk.offset)
        if header.type == "TRAK":
            if self.table.is_new(chunk.payload, offset):
                tracks = parse_description(chunk.payload, self.level, offset)
                weight = sum(len(track.components) for track in tracks)
                # Few bytes of DEFLATE can describe a component with many.
                weight = max(weight, described_size(chunk.payload) // COMPONENT_SIZE)
                self.component_count += weight
                self.limits.check("components", self.component_count)
                self.table.add(tracks, damaged=self.damaged)
        elif header.type == "mETa":
            self.metadata_size += len(chunk.payload)
            self.limits.check("metadata", self.metadata_size, offset)
            self.metadata.update(parse_metadata(chunk.payload, offset))
        elif header.type == "fOOT":
            self.foot = parse_foot(chunk.payload, offset)
        elif header.type == "DATA":
            start_ns, stop_ns = self.time_range(chunk)
            return ChunkRef(
                "DATA", chunk.offset, start_ns, stop_ns, header.sequence, header.payload_size
            )
        return None

    def time_range(self, chunk: Chunk) -> tuple[int, int] | tuple[None, None]:
        """Nanoseconds from the earliest sample to the end of the latest of an intact DATA chunk.

        None where a description is lost: a copy of it may still follow.
        """
        table = parse_table_head(chunk.payload, self.level, chunk.payload_offset)
        first = last = None
        rows: Iterable[TableRow] = parse_rows(chunk.payload, table)
        if self.kept_rows + table.packet_count <= KEPT_ROWS:
            self.tables[chunk.offset] = table, list(rows)
            rows = self.tables[chunk.offset][1]
            self.kept_rows += len(self.tables[chunk.offset][1])
        for row in rows:
            track = self.tracks.get(row.track)
            if track is None:
                if self.damaged:
                    return None, None
                raise FormatError(
                    f"packet of track {row.track}, which is not described",
                    requirement="DAT-008",
                    offset=chunk.payload_offset + row.offset,
                )
            # With integers: fractions take longer than the samples of a short packet.
            rate, tick_ns = track.rate.numerator, track.rate.denominator * 10**9
            start, stop = row.start * tick_ns // rate, -(-row.stop * tick_ns // rate)
            first = start if first is None else min(first, start)
            last = stop if last is None else max(last, stop)
        if first is None or last is None:
            raise TruncatedError(
                "the table ends early", requirement="DAT-005", offset=chunk.payload_offset
            )
        return first, last
