"""Every rule of one file, checked; and the deadband contract against the original."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, BinaryIO

from ..format.index import INDEX_EVERY, IndexEntry, ceil_ms, check_listing, floor_ms, parse_index
from ..format.track import lone_lf, unsupported_track
from ..format.walk import read_chunk
from ..format.wire import HEADER_SIZE
from .contract import ContractCheck, check_contracts
from .damage import damage_report, told
from ..errors import FormatError, HapfmtError, LimitError, UnsupportedError
from ..limits import Limits
from .catalogue import Catalogue
from .digests import DigestCheck
from .reader import Reader
from ..recording import Recording
from ..verdict import INTACT, VERDICTS, verdict_of


@dataclass
class Report:
    """What ``verify`` found; ``verdict`` is a word of SPEC clause 13, ``exit_code`` its number."""

    exit_code: int = INTACT
    findings: list[dict[str, Any]] = field(default_factory=list)
    lost: list[dict[str, Any]] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    """Damage and losses, for people."""
    file_code: int = INTACT
    """The exit code for the file alone, whatever the original holds."""
    damage: dict[str, Any] | None = None
    """The damage report; None where the file could not be opened."""
    error: HapfmtError | None = None
    digests: int = 0
    packets: int = 0
    samples: int = 0
    events: int = 0
    unknown: list[str] = field(default_factory=list)
    contracts: list[ContractCheck] = field(default_factory=list)

    @property
    def verdict(self) -> str:
        return VERDICTS[self.exit_code]

    def as_json(self) -> dict[str, Any]:
        return {
            "verdict": self.verdict,
            "exit_code": self.exit_code,
            "error": str(self.error) if self.error else None,
            "damage": self.damage,
            "packet_count": self.packets,
            "sample_count": self.samples,
            "event_count": self.events,
            "digest_count": self.digests,
            "unknown_chunks": self.unknown,
            "contracts": [check.as_json() for check in self.contracts],
        }


def verify(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    *,
    against: Recording | None = None,
    limits: Limits | None = None,
    progress: Callable[[int, int], None] | None = None,
    threads: int | None = None,
    file_id: int | None = None,
) -> Report:
    """Check everything the SPEC says of a file; with ``against`` its contracts as well.

    Raises only OSError, and ParameterError where ``against`` does not belong to the file.
    ``threads``, ``file_id``: as for a Reader.
    """
    report = Report()
    try:
        reader = Reader(file, limits=limits, threads=threads, file_id=file_id)
    except (FormatError, UnsupportedError, LimitError) as error:
        report.error = error
        report.exit_code = report.file_code = verdict_of(error=error)
        return report
    with reader:
        try:
            reader.scan()
            check_structure(reader.catalogue)
            check_packets(reader, report, progress)
            if against is not None:
                report.contracts = check_contracts(reader, against)
        except (FormatError, UnsupportedError, LimitError) as error:
            report.error = error.at(path=reader.source.path)
        catalogue = reader.catalogue
        report.findings = [finding.as_json() for finding in catalogue.findings]
        report.lost = [span._asdict() for span in reader.lost]
        report.told = told(catalogue, reader.lost)
        report.damage = damage_report(catalogue, reader.lost)
        report.unknown = [header.type for header in catalogue.unknown]
        codes = [finding.code for finding in catalogue.findings]
        broken = any(check.broken for check in report.contracts)
        report.file_code, report.exit_code = (
            verdict_of(codes, error=report.error, unknown=catalogue.not_understood, lost=lost)
            for lost in (bool(report.lost), bool(report.lost) or broken)
        )
        return report


def check_structure(catalogue: Catalogue) -> None:
    """Index, footer, channel numbers: only in a file without damage. Attachments and clocks."""
    if catalogue.damaged or not catalogue.unsupported:
        check_extras(catalogue)
    if catalogue.damaged or catalogue.unsupported:
        return
    listing = [
        IndexEntry(
            ref.type,
            ref.offset,
            floor_ms(Fraction(ref.start_ns or 0, 10**9)),
            ceil_ms(Fraction(ref.stop_ns or 0, 10**9)),
        )
        for ref in catalogue.chunks
    ]
    last_index = unlisted = 0
    indexes: set[int] = set()
    for ref in catalogue.chunks:
        if ref.type == "iNDX":
            chunk = read_chunk(catalogue.source, ref.offset)
            if chunk is None or not chunk.header.known:
                continue
            index = parse_index(chunk.payload, ref.offset, chunk.payload_offset)
            if index.previous and index.previous not in indexes:
                raise FormatError(
                    "the previous index is missing",
                    requirement="IDX-002",
                    offset=chunk.payload_offset,
                )
            indexes.add(ref.offset)
            check_listing(index, ref.offset, listing, chunk.payload_offset)
            last_index, unlisted = ref.offset, 0
        elif ref.type != "fOOT":
            size = HEADER_SIZE + (ref.size or 0)
            if unlisted and unlisted + size > INDEX_EVERY:
                raise FormatError(
                    "more than 4 MiB without an index", requirement="IDX-005", offset=ref.offset
                )
            unlisted += size
    foot = catalogue.foot
    if foot is None:
        return
    at = catalogue.source.size - 32
    bases = catalogue.table.bases
    if not last_index or foot.index_offset != last_index:
        raise FormatError(
            "the footer does not name the last index", requirement="FOT-002", offset=at
        )
    counts = (len(catalogue.data), len(catalogue.tracks))
    stop_ns = int(catalogue.duration * 10**9)
    if (foot.data_count, foot.track_count, foot.duration_ns) != (*counts, stop_ns):
        raise FormatError(
            "the counts or the duration in the footer are wrong",
            requirement="FOT-002",
            offset=at + 16,
        )
    bare = [t for t in catalogue.tracks.values() if t.kind == "lf" and t.id not in bases]
    if bare:
        raise lone_lf(bare[0])
    numbers = [channel.number for channel in catalogue.channels]
    if numbers != list(range(len(numbers))):
        raise FormatError("a channel number is missing", requirement="TRK-010", offset=at)


def check_extras(catalogue: Catalogue) -> None:
    for _ in catalogue.each_attachment():
        pass
    _ = catalogue.clocks, catalogue.clock_maps


def check_packets(
    reader: Reader, report: Report, progress: Callable[[int, int], None] | None
) -> None:
    """Decode all that is supported, and compare digests with the packets before them."""
    catalogue = reader.catalogue
    known = [track for track in catalogue.tracks.values() if not track.unsupported]
    digests = DigestCheck(catalogue)
    numbers = {channel.number for channel in catalogue.channels}
    for piece in reader.pieces(known, exact=True, progress=progress):
        report.packets += 1
        report.samples += piece.numbers.size
        report.events += len(piece.events)
        for event in piece.events if catalogue.closed and not catalogue.damaged else ():
            if event.channel is not None and event.channel not in numbers:
                raise FormatError(
                    f"an event refers to channel {event.channel}, and there is none",
                    requirement="EVT-003",
                    offset=piece.offset,
                )
        digests.add(piece)
    parts = reader.lost_parts(catalogue.channels, "full")
    # Of a track that is not described the packets themselves were named.
    reader.lost.extend(span for span in parts if span.track in catalogue.tracks)
    report.digests = len(digests.stored)
    digests.compare({span.track for span in reader.lost})
    for track in catalogue.tracks.values():
        if track.unsupported:
            raise unsupported_track(track)
