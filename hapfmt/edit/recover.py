"""``recover``: damaged file -> intact file (docs/spec/recovery.md).

A recovered file describes the tracks whose descriptions are intact, with placeholders for lost
ones. It keeps the other chunks that are intact and still have a meaning.

A damaged file can be repaired in place: only its end, or all of it. In the second case the damaged
file is kept too.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import tempfile
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Container, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO, cast

from ..errors import DAMAGED, HARMLESS, UNSUPPORTED, FormatError, HapfmtError, ParameterError
from ..files import atomic_write, refusal, refuse, sync_directory, target
from ..format.cluster import Packet, alone_size
from ..format.extras import (
    ClockChunk,
    ClockMapChunk,
    build_metadata,
    parse_attachment,
    parse_clock,
    parse_map,
    parse_metadata,
)
from ..format.source import SPOOL_SIZE, ByteSource, StreamSource, open_source
from ..format.track import (
    COMPONENTS,
    Component,
    Record,
    Track,
    TrackTable,
    build_track,
    first_of,
    split,
)
from ..format.walk import Chunk, Finding, header_at, read_chunk
from ..format.wire import HEADER_SIZE, SIGNATURE, check_file_id, crc32
from ..limits import LAST_CHANNEL, LAST_TRACK_ID, Limits
from ..numbers import counted
from ..reading.catalogue import Catalogue, ChunkRef
from ..reading.damage import DamageReport, LostPart, LostSpan
from ..reading.decoder import PieceDecoder, TrackDecoder, TrackDigest
from ..reading.opening import from_walk, lose_chunk
from ..reading.packets import PacketPass
from ..reading.reader import stored_digests
from ..reading.verifier import check_structure
from ..writing.file import open_live
from ..writing.filewriter import FileWriter
from ..writing.start import check_tail, open_append

EMPTY = b"\0\0\0\1\0"
"""Parameters of KNOT: hold, varints, step 1. A track without packets needs no others."""
LOST_LABEL = "(lost)"
LOST_RESIDUAL = "the description of this HF track was lost"
LOST_CHANNEL = "the description of this channel was lost"
EVERYTHING = (0, 1 << 62)
"""All ticks."""


def describe(catalogue: Catalogue) -> tuple[list[Record], list[Track]]:
    """All tracks that can be kept, HF last; and the tracks that stand for lost ones, without
    packets: also of channels that an event refers to."""
    kept = dict(copied(catalogue, rejoined(usable(catalogue))))
    places = placeholders({track.id: track for track in kept}, catalogue)
    kept |= {track: build_track(track) for track in places}
    return sorted(kept.items(), key=lambda part: (part[0].kind == "hf", part[0].id)), places


def usable(catalogue: Catalogue) -> dict[int, Track]:
    """Tracks that can be kept: HF tracks only with their base."""
    found: dict[int, Track] = {}
    for track in sorted(catalogue.tracks.values(), key=lambda t: (t.kind == "hf", t.id)):
        if track.is_orphan(found):
            message = f"HF track {track.id} has lost its base track {track.base}"
            catalogue.lose("lost-base", track.offset - HEADER_SIZE, 0, message, "DEC-003")
            continue
        found[track.id] = track
    return found


def rejoined(kept: dict[int, Track]) -> dict[int, Track]:
    """Tracks that continue one that is lost continue the one before it, or none."""
    table = TrackTable()
    table.tracks = kept
    out = dict(kept)
    for chain in table.chains():
        known = [track for track in chain if track.unsupported is None]
        for before, track in zip([None, *known], known, strict=False):
            if track.continues is not None and track.continues not in kept:
                out[track.id] = replace(track, continues=before.id if before else None)
    return out


def copied(catalogue: Catalogue, kept: dict[int, Track]) -> Iterator[Record]:
    """The tracks unchanged, byte for byte, except those that now continue another one."""
    by_chunk: dict[int, list[Track]] = {}
    for track in kept.values():
        by_chunk.setdefault(track.offset, []).append(track)
    for offset, tracks in by_chunk.items():
        chunk = read_chunk(catalogue.source, offset - HEADER_SIZE)
        assert chunk is not None
        records = split(chunk.payload, catalogue.level, offset)
        for track in tracks:
            if track is catalogue.tracks[track.id]:
                yield track, records[track.id - first_of(chunk.payload)]
            elif track.unsupported is None:
                yield track, build_track(track)


def placeholders(described: dict[int, Track], catalogue: Catalogue) -> list[Track]:
    """An empty HF track for each LF track without one (TRK-012), and empty tracks for channel
    numbers without any reference (TRK-010)."""
    ids = free_ids(described.keys() | catalogue.tracks.keys())
    bases = {track.base for track in described.values() if track.kind == "hf"}
    places = [
        Track(
            next(ids), "hf", "KNOT", lf.rate, lf.first_channel,
            (Component(),) * len(lf.components), EMPTY, base=lf.id, provenance=LOST_RESIDUAL,
        )
        for lf in sorted(described.values(), key=lambda t: t.id)
        if lf.kind == "lf" and lf.id not in bases
    ]  # fmt: skip
    for first, count in missing_channels(described, highest_named(catalogue, described)):
        components = (Component(label=LOST_LABEL),) * count
        places.append(
            Track(
                next(ids), "full", "KNOT", Fraction(1), first, components, EMPTY,
                provenance=LOST_CHANNEL,
            )
        )  # fmt: skip
    return places


def highest_named(catalogue: Catalogue, described: dict[int, Track]) -> int:
    """The highest channel number in an event, -1 where no event has one."""
    layers = [t for t in described.values() if t.kind == "events" and t.unsupported is None]
    everything = dict.fromkeys((layer.id for layer in layers), EVERYTHING)
    decoders = {layer.id: TrackDecoder(layer, catalogue.level) for layer in layers}
    highest = -1
    for packet in PacketPass(catalogue, lambda: None).packets(everything) if layers else ():
        try:
            events = decoders[packet.track].decode_events(packet)
        except FormatError:
            continue
        named = [event.channel for event in events if event.channel is not None]
        highest = max(highest, *named, -1)
    return highest


def missing_channels(described: dict[int, Track], highest: int) -> Iterator[tuple[int, int]]:
    """(first channel number, how many) that no track has, up to ``highest`` or the highest that one
    has; at most 255 each."""
    numbers = {
        number
        for track in described.values()
        if track.kind != "hf"
        for number in track.channels
        if number <= LAST_CHANNEL
    }
    run: list[int] = []
    for number in range(max(*numbers, highest, -1) + 1):
        if number in numbers or len(run) == COMPONENTS:
            if run:
                yield run[0], len(run)
            run = []
        if number not in numbers:
            run.append(number)
    if run:
        yield run[0], len(run)


def free_ids(taken: set[int]) -> Iterator[int]:
    """Ids that no track has, new ones first."""
    highest = max(taken, default=-1)
    yield from range(highest + 1, LAST_TRACK_ID + 1)
    yield from (id_ for id_ in range(highest) if id_ not in taken)


WRITTEN_ANEW = frozenset({"HEAD", "TRAK", "DATA", "iNDX", "fOOT", "dGST"})
CLOCKS: dict[str, Callable[[bytes, int], ClockChunk | ClockMapChunk]] = {
    "cLOk": parse_clock,
    "cMAp": parse_map,
}


@dataclass
class Extras:
    """Copies chunks that the writer does not write itself; names the unknown ones."""

    catalogue: Catalogue
    writer: FileWriter
    tracks: Container[int]
    """Ids of the tracks that are kept."""
    kept: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)

    def copy(self, ref: ChunkRef) -> None:
        """One chunk unchanged, where it is intact and still has a meaning."""
        if ref.type in WRITTEN_ANEW:
            return
        chunk = read_chunk(self.catalogue.source, ref.offset)
        if chunk is None or not chunk.intact:
            return
        header = chunk.header
        keep = self.wanted(chunk) if header.known else self.may_be_copied(chunk)
        if not header.known:
            (self.kept if keep else self.dropped).append(header.type)
        if keep:
            self.writer.chunk(header.type, chunk.payload)

    def wanted(self, chunk: Chunk) -> bool:
        header, offset = chunk.header, chunk.payload_offset
        try:
            self.catalogue.level.check("payload_size", header.payload_size, "LIM-001", offset)
            if header.type == "mETa":
                parse_metadata(chunk.payload, offset)
            elif header.type == "aTTc":
                if parse_attachment(chunk.payload, offset).is_overview:
                    return False
            elif header.type in CLOCKS:
                track = CLOCKS[header.type](chunk.payload, offset).track
                self.catalogue.check_observed(track, chunk)
                return track is None or track in self.tracks
        except FormatError as error:
            lose_chunk(self.catalogue, chunk, error)
            return False
        return True

    def may_be_copied(self, chunk: Chunk) -> bool:
        """Whether to copy a chunk of an unknown type: always if nothing else changes. A critical
        chunk is always copied: without it the file would seem to be understood."""
        if chunk.header.payload_size > self.catalogue.level.payload_size:
            return False
        safe = chunk.header.type[3].islower()
        whole = not self.catalogue.harmed
        return chunk.header.critical or safe or whole


def write_note(catalogue: Catalogue, writer: FileWriter, note: str) -> None:
    """The member ``notes`` of the metadata, with one more text (SPEC 11.3)."""
    found = catalogue.metadata.get("notes", [])
    before = found if isinstance(found, list) else [found]
    notes = [text if isinstance(text, str) else json.dumps(text) for text in before]
    try:
        payload = build_metadata({"notes": [*notes, note]})
    except ParameterError:
        return
    if len(payload) <= writer.level.payload_size:
        writer.chunk("mETa", payload)


REMADE = frozenset({"iNDX", "fOOT"})
NOTED = 6
"""Lines on damage and losses in the note in the file."""
OF_CHUNKS = frozenset({"bad-chunk", "bad-payload", "truncated", "duplicate-chunk"})
"""Findings with the offset of a chunk."""


@dataclass(repr=False)
class Recovery:
    """The data that ``recover`` kept, and the data that it lost.

    ``summary`` are plain sentences on damage and losses; ``lost`` are the lost parts with
    ``labels``, ``start`` and ``stop`` in seconds.
    """

    exit_code: int = 0
    findings: list[Finding] = field(default_factory=list)
    lost: list[LostPart] = field(default_factory=list)
    summary: list[str] = field(default_factory=list)
    damage: dict[str, Any] = field(default_factory=dict)
    """The damage report of docs/spec/recovery.md."""
    packets: int = 0
    samples: int = 0
    digests: int = 0
    file_size: int = 0
    empty_tracks: int = 0
    undecodable: int = 0
    """Packets whose checksum holds and that break a rule."""
    mended: str = ""
    """In place: "end", "file", or nothing where nothing was to be done."""
    kept_as: str | None = None
    """In place: where the damaged file is now."""
    kept_unknown: list[str] = field(default_factory=list)
    dropped_unknown: list[str] = field(default_factory=list)

    def headline(self) -> str:
        """The numbers of packets and samples in the new file, and whether anything was lost."""
        line = f"{counted(self.packets, 'packet')}, {counted(self.samples, 'sample')}"
        if self.exit_code == DAMAGED:
            return f"{line}; with loss"
        open_end = any(each.code == "not-closed" for each in self.findings)
        return f"{line}; nothing lost{' of what is in the file' if open_end else ''}"

    def __repr__(self) -> str:
        """What the command line prints."""
        kept = [f"the damaged file is now {self.kept_as}"] if self.kept_as else []
        return "\n  ".join([f"Recovery: {self.headline()}", *self.summary, *kept])

    def as_json(self) -> dict[str, Any]:
        return {
            "exit_code": self.exit_code,
            "damage": self.damage,
            "packet_count": self.packets,
            "sample_count": self.samples,
            "digest_count": self.digests,
            "file_size": self.file_size,
            "empty_track_count": self.empty_tracks,
            "unknown_chunks": self.kept_unknown,
            "dropped_chunks": self.dropped_unknown,
            "mended": self.mended or None,
            "kept_as": self.kept_as,
        }


def recover(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    into: str | os.PathLike[str] | BinaryIO,
    *,
    canonical: int | None = None,
    file_id: int | None = None,
    force: bool = False,
    limits: Limits | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recovery:
    """Write all readable parts of ``file`` into a new, intact file.

    Packets are copied bit for bit. Packets that do not decode are left out; missing samples become
    gaps. ``canonical`` is the file id, which is random otherwise. ``file_id``: for a file that
    contains parts of others, the id of the file to read; None: that of its start and end, or else
    of most bytes. ``force`` replaces an existing file. ``progress`` is called with (clusters done,
    clusters in all).

    Raises FormatError if ``file`` is not a hapf file at all, and UnsupportedError if its version
    is unknown. Then nothing is written.
    """
    check_file_id(canonical)
    if isinstance(into, (str, os.PathLike)):
        refuse(os.fspath(into), force)
        if isinstance(file, (str, os.PathLike)) and Path(into).exists():
            refuse_same(file, into)
    source = open_source(file)
    try:
        catalogue = from_walk(source, limits, tolerant=True, file_id=file_id)
        with target(into, force) as stream:
            if isinstance(into, (str, os.PathLike)):
                return write_checked(catalogue, stream, canonical, limits or Limits(), progress)
            with cast(BinaryIO, tempfile.SpooledTemporaryFile(max_size=SPOOL_SIZE)) as spool:
                done = write_checked(catalogue, spool, canonical, limits or Limits(), progress)
                spool.seek(0)
                shutil.copyfileobj(spool, stream)
            return done
    except HapfmtError as error:
        raise error.at(path=source.path) from None
    finally:
        source.close()


def refuse_same(file: str | os.PathLike[str], into: str | os.PathLike[str]) -> None:
    if Path(file).exists() and Path(file).samefile(into):
        raise ParameterError("the recovered file would replace the damaged one", path=str(into))


def write_checked(
    catalogue: Catalogue,
    stream: BinaryIO,
    file_id: int | None,
    limits: Limits,
    progress: Callable[[int, int], None] | None,
) -> Recovery:
    """The recovered file, written to ``stream`` and read back, so that no output breaks a rule.

    Packets were decoded when they were copied: here only the structure around them is checked, in
    a time that grows with the size of the file. Raises FormatError or LimitError instead of leaving
    a file that ``verify`` would refuse.
    """
    done = Copy(catalogue, stream, file_id, limits, progress).run()
    stream.flush()
    try:
        check_layout(StreamSource(stream), limits)
    except FormatError as error:
        raise FormatError(
            f"The recovered file would break a rule: {error.message}", requirement=error.requirement
        ) from None
    return done


def check_layout(source: ByteSource, limits: Limits) -> None:
    """Raise FormatError where a closed file breaks a rule, but for what its packets hold."""
    found = from_walk(source, limits)
    check_structure(found)
    everything = dict.fromkeys(found.tracks, EVERYTHING)
    for packet in PacketPass(found, lambda: None).packets(everything):
        limits.check(
            "packet_samples", found.tracks[packet.track].weight(packet.span, len(packet.data))
        )
    stored_digests(found)
    if found.findings:
        first = found.findings[0]
        raise FormatError(first.message, requirement=first.requirement, offset=first.offset)


class Copy:
    """One recovery; memory is that of one cluster."""

    def __init__(
        self,
        catalogue: Catalogue,
        stream: BinaryIO,
        file_id: int | None,
        limits: Limits,
        progress: Callable[[int, int], None] | None,
    ) -> None:
        self.catalogue = catalogue
        self.limits = limits
        self.progress = progress
        self.done = Recovery()
        self.lost: list[LostSpan] = []
        self.types = {ref.offset: ref.type for ref in catalogue.chunks}
        described, self.places = describe(catalogue)
        head = catalogue.head
        self.writer = FileWriter(
            stream,
            level=catalogue.level,
            file_id=file_id,
            recording_uuid=catalogue.uuid,
            epoch_ns=head.epoch_ns if head else None,
            epoch_uncertainty_ns=head.epoch_uncertainty_ns if head else 0,
            encoder=head.encoder if head else "",
        )
        self.writer.describe_as(described)
        empty = {track.id for track in self.places}
        self.tracks = {id_: t for id_, t in self.writer.tracks.items() if id_ not in empty}
        self.decoders = {
            id_: TrackDecoder(track, catalogue.level)
            for id_, track in self.tracks.items()
            if track.unsupported is None
        }
        everything = dict.fromkeys(self.decoders, EVERYTHING)
        self.pieces = PieceDecoder(self.decoders, everything, exact=True)
        self.extras = Extras(catalogue, self.writer, self.tracks)
        self.stored = stored_digests(catalogue)
        self.digests = {id_: TrackDigest() for id_ in self.stored}
        self.unharmed: set[int] = set()
        """Offsets of damaged DATA chunks of which every packet holds."""
        self.differs = False
        """Whether the checksum of a track is wrong: mending the end alone would leave it."""
        self.outrun: set[int] = set()
        """Tracks with packets behind their last digest, which is not of them (DGS-003)."""

    def run(self) -> Recovery:
        catalogue, done = self.catalogue, self.done
        apart = [ref for ref in catalogue.chunks if ref.type != "DATA"]
        others = deque(sorted(apart, key=lambda ref: ref.sequence or 0))
        bare = [track.base for track in self.places if track.base is not None]
        self.lost = [LostSpan(base, 0, None) for base in bare]
        for ref, packets in self.clusters():
            while others and (others[0].sequence or 0) < (ref.sequence or 0):
                self.extras.copy(others.popleft())
            kept = [packet for packet in packets if self.check(packet)]
            if kept:
                self.writer.cluster(kept)
        for ref in others:
            self.extras.copy(ref)
        self.copy_digests()
        done.kept_unknown, done.dropped_unknown = self.extras.kept, self.extras.dropped
        done.findings = catalogue.findings
        done.empty_tracks = len(self.places)
        lossy = any(self.costs(finding) for finding in done.findings)
        if lossy or self.lost or self.places or self.extras.dropped:
            done.exit_code = DAMAGED
        elif catalogue.not_understood:
            done.exit_code = UNSUPPORTED
        if done.findings or done.exit_code == DAMAGED:
            write_note(catalogue, self.writer, self.note())
        self.writer.close()
        damage = DamageReport(catalogue, self.lost)
        done.lost, done.summary, done.damage = damage.parts(), damage.lines(), damage.as_json()
        done.file_size = self.writer.offset
        return done

    def clusters(self) -> Iterator[tuple[ChunkRef, list[Packet]]]:
        """Packets that hold, chunk by chunk."""
        current = PacketPass(self.catalogue, lambda: None)
        refs = sorted(self.catalogue.data, key=lambda ref: ref.offset)
        offsets = [ref.offset for ref in refs]
        packets = current.packets(dict.fromkeys(self.tracks, EVERYTHING), progress=self.progress)
        for place, group in groupby(packets, lambda p: bisect_right(offsets, p.offset) - 1):
            yield refs[place], list(group)
        self.lost += current.lost
        self.unharmed = current.unharmed

    def check(self, packet: Packet) -> bool:
        """Whether it decodes, and fits; it goes into its track's digest."""
        decoder = self.decoders.get(packet.track)
        samples = self.tracks[packet.track].weight(packet.span, len(packet.data))
        self.limits.check("packet_samples", samples)
        self.limits.check("work_samples", self.done.samples + samples)
        try:
            self.writer.level.check("payload_size", alone_size(packet), "LIM-001", packet.offset)
            if decoder is not None:
                piece = self.pieces.decode(packet)
                if packet.offset < self.stored.get(packet.track, (0, b""))[0]:
                    self.digests[packet.track].update(packet.start, piece.digested)
                else:
                    self.outrun.add(packet.track)
        except FormatError as error:
            rule = error.requirement or "COD-001"
            self.catalogue.lose("bad-packet", packet.offset, len(packet.data), error.message, rule)
            self.lost.append(LostSpan(packet.track, packet.start, packet.stop))
            self.done.undecodable += 1
            return False
        self.done.packets += 1
        if self.tracks[packet.track].kind != "events":
            self.done.samples += samples
        return True

    def copy_digests(self) -> None:
        """Copies the checksums that still hold: those of tracks that lost nothing."""
        catalogue = self.catalogue
        touched = {span.track for span in self.lost}
        kept: dict[int, bytes] = {}
        for track, (offset, digest) in self.stored.items():
            if track not in self.tracks:
                continue
            if track not in self.decoders:
                same = not catalogue.findings
            else:
                same = self.digests[track].digest() == digest
            self.differs |= not same and track in self.decoders
            if same and track not in self.outrun:
                kept[track] = digest
            elif not same and track not in touched:
                message = f"the decoded numbers of track {track} do not match their checksum"
                catalogue.lose("bad-digest", offset, len(digest), message, "DGS-002")
        self.writer.digest(kept)
        self.done.digests = len(kept)

    def costs(self, finding: Finding) -> bool:
        """Whether the finding may have lost something that the writer does not write again."""
        if finding.code in HARMLESS or finding.code in ("bad-signature", "other-file"):
            return False
        if finding.code in ("missing-chunk", "missing-head"):
            return True
        if finding.code in ("bad-payload", "bad-chunk") and finding.offset in self.unharmed:
            return False
        if finding.offset + finding.size <= len(SIGNATURE):
            # The rest of the signature, which the writer writes again.
            return False
        # Packets without bytes have the offset of whatever follows them.
        type_ = self.types.get(finding.offset) if finding.code in OF_CHUNKS else None
        if type_ == "TRAK" and finding.code != "bad-chunk":
            return not self.has_copy(finding.offset)
        return type_ not in REMADE and (type_ != "HEAD" or self.catalogue.head is None)

    def has_copy(self, offset: int) -> bool:
        """Whether the TRAK chunk at ``offset`` had a payload that is in another one."""
        catalogue = self.catalogue
        header = header_at(catalogue.source, offset, catalogue.file_id)
        copies = catalogue.table.payloads.values()
        return header is not None and any(
            len(copy) == header.payload_size and crc32(copy, header.seed) == header.payload_crc
            for copy in copies
        )

    def note(self) -> str:
        """What happened, for a person."""
        done = self.done
        if done.exit_code != DAMAGED:
            return "recovered; nothing was lost that stood in the file, its end may be missing"
        lines = DamageReport(self.catalogue, self.lost).lines()
        if len(lines) > NOTED:
            lines[NOTED:] = [f"and {len(lines) - NOTED} more"]
        kept = f"recovered from a damaged file: {counted(done.packets, 'packet')} kept"
        return "; ".join([kept, *lines])


Progress = Callable[[int, int], None]
DAMAGED_SUFFIX = ".damaged"


class NullWriter:
    """Takes everything and keeps nothing: what would be lost is found out before a file changes."""

    def write(self, data: bytes) -> int:
        return len(data)


def recover_in_place(
    path: str | os.PathLike[str],
    *,
    canonical: int | None = None,
    file_id: int | None = None,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> Recovery:
    """Make the file at ``path`` intact, with everything in it that is still readable.

    If only its end is damaged, or it was not closed, the file itself is repaired. Otherwise a new
    file replaces it, and the damaged one is kept as NAME.damaged. An intact file does not change.
    The file is locked meanwhile.

    Raises ParameterError if another program writes the file, or NAME.damaged exists.
    """
    name = os.fspath(path)
    with open_live(name):
        # A file that grows would seem to be damaged.
        catalogue, done, tail = survey(name, file_id, limits or Limits(), progress)
    if not done.findings and done.exit_code in (0, 4) and keeps_rules(name, limits or Limits()):
        return done
    # Appending copies the packets of a cut chunk without decoding them.
    if tail and not catalogue.unsupported and not done.undecodable:
        with open_append(name):
            pass
        if keeps_rules(name, limits or Limits()):
            done.file_size = Path(name).stat().st_size
            done.mended = "end"
            return done
    return rewrite(name, canonical, file_id, limits or Limits(), progress)


def keeps_rules(name: str, limits: Limits) -> bool:
    source = open_source(name)
    try:
        check_layout(source, limits)
    except FormatError:
        return False
    finally:
        source.close()
    return True


def survey(
    name: str, file_id: int | None, limits: Limits, progress: Progress | None
) -> tuple[Catalogue, Recovery, bool]:
    """What a recovery would find, and whether all of it lies at the end."""
    source = open_source(name)
    try:
        catalogue = from_walk(source, limits, tolerant=True, file_id=file_id)
        walked = [found for found in catalogue.findings if found.code not in HARMLESS]
        end = min((found.offset for found in walked), default=source.size)
        copy = Copy(catalogue, cast(BinaryIO, NullWriter()), 0, limits, progress)
        done = copy.run()
        tail = not (done.empty_tracks or copy.differs) and catalogue.head is not None
        tail = tail and all(found.offset >= end for found in done.findings)
        try:
            check_tail(catalogue, walked, end) if walked else None
        except ParameterError:
            tail = False
        return catalogue, done, tail
    except HapfmtError as error:
        raise error.at(path=name) from None
    finally:
        source.close()


def rewrite(
    name: str,
    canonical: int | None,
    file_id: int | None,
    limits: Limits,
    progress: Progress | None,
) -> Recovery:
    target = Path(os.path.realpath(name))
    kept = target.with_name(target.name + DAMAGED_SUFFIX)
    if kept.exists():
        raise refusal(f"{kept} already exists; it is the name for the damaged file")
    beside = target.with_name(f".{secrets.token_hex(8)}.tmp")
    linked = False
    locked = open_live(target)
    try:
        with atomic_write(beside) as stream:
            source = open_source(target)
            try:
                catalogue = from_walk(source, limits, tolerant=True, file_id=file_id)
                done = write_checked(catalogue, stream, canonical, limits, progress)
            finally:
                source.close()
        os.link(target, kept)
        linked = True
        if os.name == "nt":
            # Nothing replaces a file there that is open.
            locked.close()
        beside.replace(target)
        linked = False
        sync_directory(target.parent)
    except BaseException:
        for name_ in [beside, kept] if linked else [beside]:
            with suppress(OSError):
                name_.unlink()
        raise
    finally:
        locked.close()
    done.mended, done.kept_as = "file", str(kept)
    return done
