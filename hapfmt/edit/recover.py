"""``recover``: damaged file -> intact file (docs/spec/recovery.md)."""

from __future__ import annotations

import os
import shutil
import tempfile
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO, cast
from uuid import UUID

from ..atomic import refuse, target
from ..format.cluster import Packet, alone_size
from ..writing.filewriter import FileWriter
from ..format.source import SPOOL_SIZE, Source, StreamSource, open_source
from ..format.walk import Finding, read_chunk
from ..format.wire import SIGNATURE, check_file_id
from ..reading.damage import damage_report, told
from ..errors import FormatError, HapfmtError, ParameterError
from ..limits import Limits
from ..numbers import counted
from ..reading.catalogue import Catalogue, ChunkRef
from ..reading.decoder import TrackDecoder, TrackDigest
from ..reading.digests import stored_digests
from ..reading.losses import LostSpan
from ..reading.opening import from_walk
from ..reading.packets import PacketPass
from ..reading.pieces import PieceDecoder
from ..verdict import DAMAGED, HARMLESS, UNSUPPORTED
from ..reading.verifier import check_structure
from .descriptions import EVERYTHING, describe
from .recovered_extras import Extras, write_note

REMADE = frozenset({"iNDX", "fOOT"})
NOTED = 6
"""Lines on damage and losses in the note in the file."""
OF_CHUNKS = frozenset({"bad-chunk", "bad-payload", "truncated", "duplicate-chunk"})
"""Findings with the offset of a chunk."""


@dataclass
class Recovery:
    """What ``recover`` kept and what was lost."""

    exit_code: int = 0
    findings: list[Finding] = field(default_factory=list)
    lost: list[LostSpan] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    """Damage and losses, for people."""
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
    """Write all that can be read of ``file`` into a new file that is intact.

    Packets are copied bit for bit, those that do not decode are left out; what is missing stays a
    gap. ``canonical`` is the file id, otherwise it is random. ``file_id``: of a file with parts of
    others, which one is read; None: the one that most of it belongs to. An existing path is refused
    unless ``force``. ``progress`` is called with (clusters done, clusters in all).

    Raises FormatError where ``file`` is not a hapf file at all, UnsupportedError where its version
    or a feature bit is unknown: then nothing is written.
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


def check_layout(source: Source, limits: Limits) -> None:
    """Raise FormatError where a closed file breaks a rule, but for what its packets hold."""
    found = from_walk(source, limits)
    check_structure(found)
    everything = dict.fromkeys(found.tracks, EVERYTHING)
    for packet in PacketPass(found, lambda: None).packets(everything):
        limits.check_packet(found.tracks[packet.track].weight(packet.span, len(packet.data)))
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
        self.types = {ref.offset: ref.type for ref in catalogue.chunks if ref.known}
        described, self.places = describe(catalogue)
        head = catalogue.head
        self.writer = FileWriter(
            stream,
            level=catalogue.level,
            file_id=file_id,
            recording_uuid=UUID(bytes=head.uuid) if head and head.uuid else None,
            epoch_ns=head.epoch_ns if head else None,
            epoch_uncertainty_ns=head.epoch_uncertainty_ns if head else 0,
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
        self.outrun: set[int] = set()
        """Tracks with packets behind their last digest, which is not of them (DGS-003)."""

    def run(self) -> Recovery:
        catalogue, done = self.catalogue, self.done
        apart = [ref for ref in catalogue.chunks if not (ref.known and ref.type == "DATA")]
        others = deque(sorted(apart, key=lambda ref: ref.sequence or 0))
        bare = [track.base for track in self.places if track.base is not None]
        done.lost = [LostSpan(base, 0, None) for base in bare]
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
        if lossy or done.lost or self.places or self.extras.dropped:
            done.exit_code = DAMAGED
        elif catalogue.not_understood:
            done.exit_code = UNSUPPORTED
        if done.findings or done.exit_code == DAMAGED:
            write_note(catalogue, self.writer, self.note())
        self.writer.close()
        done.told = told(catalogue, done.lost)
        done.damage = damage_report(catalogue, done.lost)
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
        self.done.lost += current.lost
        self.unharmed = current.unharmed

    def check(self, packet: Packet) -> bool:
        """Whether it decodes, and fits; it goes into its track's digest."""
        decoder = self.decoders.get(packet.track)
        samples = self.tracks[packet.track].weight(packet.span, len(packet.data))
        self.limits.check_packet(samples)
        self.limits.check_work(self.done.samples + samples)
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
            self.done.lost.append(LostSpan(packet.track, packet.start, packet.stop))
            self.done.undecodable += 1
            return False
        self.done.packets += 1
        if self.tracks[packet.track].kind != "events":
            self.done.samples += samples
        return True

    def copy_digests(self) -> None:
        """Those that what was recovered still has: of tracks that lost nothing."""
        catalogue = self.catalogue
        touched = {span.track for span in self.done.lost}
        kept: dict[int, bytes] = {}
        for track, (offset, digest) in self.stored.items():
            if track not in self.tracks:
                continue
            if track not in self.decoders:
                same = not catalogue.findings
            else:
                same = self.digests[track].digest() == digest
            if same and track not in self.outrun:
                kept[track] = digest
            elif not same and track not in touched:
                message = f"the decoded numbers of track {track} do not match their checksum"
                catalogue.lose("bad-digest", offset, len(digest), message, "DGS-002")
        self.writer.digest(kept)
        self.done.digests = len(kept)

    def costs(self, finding: Finding) -> bool:
        """Whether it may have taken something that is not written anew."""
        if finding.code in HARMLESS or finding.code in ("bad-signature", "other-file"):
            return False
        if finding.code in ("missing-chunk", "missing-head"):
            return True
        if finding.code == "bad-payload" and finding.offset in self.unharmed:
            return False
        if finding.offset + finding.size <= len(SIGNATURE):
            # What is left of the signature, which is written anew.
            return False
        # Packets without bytes have the offset of whatever follows them.
        type_ = self.types.get(finding.offset) if finding.code in OF_CHUNKS else None
        if type_ == "TRAK" and finding.code != "bad-chunk":
            chunk = read_chunk(self.catalogue.source, finding.offset)
            return chunk is None or chunk.header.track not in self.tracks
        return type_ not in REMADE and (type_ != "HEAD" or self.catalogue.head is None)

    def note(self) -> str:
        """What happened, for a person."""
        done = self.done
        if done.exit_code != DAMAGED:
            return "recovered; nothing was lost that stood in the file, its end may be missing"
        lines = told(self.catalogue, done.lost)
        if len(lines) > NOTED:
            lines[NOTED:] = [f"and {len(lines) - NOTED} more"]
        kept = f"recovered from a damaged file: {counted(done.packets, 'packet')} kept"
        return "; ".join([kept, *lines])
