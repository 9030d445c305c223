"""Checks every rule of one file, and its error bound against the original.

The comparison with the original uses exact arithmetic (SPEC clause 11).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..deadband import Deadband
from ..errors import (
    HARMLESS,
    INTACT,
    VERDICTS,
    FormatError,
    HapfmtError,
    LimitError,
    ParameterError,
    UnsupportedError,
    verdict_of,
)
from ..format.extras import (
    INDEX_EVERY,
    IndexEntry,
    ceil_ms,
    check_listing,
    floor_ms,
    parse_foot,
    parse_index,
)
from ..format.layout import FOOT
from ..format.track import Contract, lone_lf, missing_channels, unsupported_track
from ..format.walk import read_chunk
from ..format.wire import HEADER_SIZE
from ..limits import TICK_LIMIT, Limits
from ..numbers import counted
from ..recording import Calibration, Channel, Recording
from .catalogue import Catalogue, ChannelRef, ChunkRef, TrackPair
from .damage import DamageReport, LostPart
from .decoder import intersect
from .reader import DigestCheck, Reader


@dataclass
class ContractCheck:
    """One track of a channel against its original.

    ``samples`` were compared, ``missing`` are in the original only, ``invented`` in the file only;
    ``outside`` lie outside the deadband, or differ at all where there is no contract;
    ``worst_ratio`` is the largest error in deadbands, ``largest_error`` in the channel's unit;
    ``moved`` the largest distance of the source from its grid, ``stated`` what the file says;
    ``kept_as``: what the file states of the samples.
    """

    channel: int
    track: int
    label: str
    contract: Contract | None
    samples: int
    missing: int
    invented: int
    outside: int
    worst_ratio: Fraction
    largest_error: float
    moved: float
    stated: float
    unit: str
    kept_as: str
    extent: float = 0.0
    """Largest less smallest value of the original."""
    synthetic: bool = False
    """Whether the texture comes from a model, which promises nothing of a sample."""

    @property
    def promised(self) -> bool:
        """Whether the error bound is guaranteed. Without a bound, nothing may differ (DBC-004)."""
        if self.synthetic:
            return False
        return self.contract is None or self.contract.guaranteed

    @property
    def broken(self) -> bool:
        """Whether a promise does not hold, samples do not correspond, or the source was further
        from its quantisation grid than the file states (TLV-006)."""
        moved = self.moved > self.stated
        return bool(self.missing or self.invented or moved or (self.promised and self.outside))

    def as_json(self) -> dict[str, Any]:
        contract = self.contract
        return {
            "channel": self.channel,
            "track": self.track,
            "label": self.label,
            "contract": contract
            and {
                "kn": contract.kn,
                "kd": contract.kd,
                "vector": contract.vector,
                "guaranteed": contract.guaranteed,
            },
            "synthetic": self.synthetic,
            "broken": self.broken,
            "sample_count": self.samples,
            "missing_count": self.missing,
            "invented_count": self.invented,
            "outside_count": self.outside,
            "worst_ratio": float(self.worst_ratio),
            "largest_error": self.largest_error,
            "range": self.extent,
            "unit": self.unit,
            "kept_as": self.kept_as,
            "moved": self.moved,
            "stated": self.stated,
        }


@dataclass
class SamplePair:
    """Samples that original and file both have: counts (or words) x and y [samples]."""

    x: NDArray[Any]
    y: NDArray[Any]
    missing: int
    invented: int
    largest_error: float
    moved: float
    far: int
    """Samples of x that are near no count: outside, whatever the deadband."""
    extent: float


def check_contracts(reader: Reader, against: Recording) -> list[ContractCheck]:
    """Each channel of the file against the channel of the same place in ``against`` (DBC-002),
    track by track where one continues another."""
    refs = reader.channels
    if len(refs) != len(against):
        stamped = [r for r in refs if "stamp" in r.label and r.label not in against.labels]
        hint = "; channels of time stamps were kept: read the original with keep_stamps=True"
        raise ParameterError(
            f"the file has {counted(len(refs), 'channel')}, the original {len(against)}"
            + hint * bool(stamped)
        )
    assembly = reader.assembly(refs)
    groups: dict[int, list[ExpectedPart]] = {}
    for ref, x in zip(refs, against.channels, strict=True):
        rate = ref.track.rate
        if x.rate_exact != rate:
            raise ParameterError(
                f"channel {ref.number} has a rate of {rate} Hz, the original of {x.rate_exact} Hz"
            )
        decoded = assembly.parts(ref)
        originals = cut(x, decoded)
        for part, own, y in zip(ref.parts, originals, decoded, strict=True):
            groups.setdefault(part.track.id, []).append(ExpectedPart(ref, part, own, y))
    checks = [check for members in groups.values() for check in check_track(members)]
    return sorted(checks, key=lambda check: (check.channel, check.track))


class ExpectedPart(NamedTuple):
    """What one part of a channel should be, and what it is."""

    ref: ChannelRef
    part: TrackPair
    original: Channel
    decoded: Channel


def cut(original: Channel, parts: Sequence[Channel]) -> list[Channel]:
    """What of the original belongs to which part: each sample to one, whatever a part lacks."""
    if len(parts) == 1:
        return [original]
    ends = [part.stop_tick for part in parts]
    stops = [max(ends[: i + 1]) for i in range(len(ends) - 1)] + [TICK_LIMIT]
    starts = [0, *stops]
    return [original.slice_ticks(a, b) for a, b in zip(starts, stops, strict=False)]


def check_track(members: Sequence[ExpectedPart]) -> list[ContractCheck]:
    """The channels of one track together, since a vector contract concerns all of them."""
    pairs = [pair_up(member.original, member.decoded) for member in members]
    part = members[0].part
    contract = part.contract
    if contract is None:
        judged = [(int((pair.x != pair.y).sum()), Fraction(0)) for pair in pairs]
    elif contract.vector:
        sizes = {pair.x.size for pair in pairs}
        if len(sizes) != 1:
            raise ParameterError("the originals of one vector have different gaps")
        band = Deadband(contract.kn, contract.kd, contract.floor, contract.zero, vector=True)
        xs = np.column_stack([pair.x for pair in pairs])
        ys = np.column_stack([pair.y for pair in pairs])
        judged = [(int(band.outside(xs, ys).sum()), band.worst_ratio(xs, ys))] * len(pairs)
    else:
        judged = [
            judge(pair, contract, floor, zero)
            for pair, floor, zero in zip(pairs, contract.floor, contract.zero, strict=True)
        ]
    return [
        ContractCheck(
            ref.number, part.track.id, ref.label, contract, int(pair.x.size), pair.missing,
            pair.invented, outside + pair.far, ratio, pair.largest_error, pair.moved,
            y.deviation.largest if y.deviation else 0.0, ref.track.components[ref.index].unit,
            part.kept_as(ref.index), pair.extent, part.synthetic,
        )
        for (ref, _, _, y), pair, (outside, ratio) in zip(members, pairs, judged, strict=True)
    ]  # fmt: skip


def judge(pair: SamplePair, contract: Contract, floor: int, zero: int) -> tuple[int, Fraction]:
    """Samples outside, and the worst ratio, of one component on its own."""
    band = Deadband(contract.kn, contract.kd, (floor,), (zero,))
    x, y = pair.x[:, None], pair.y[:, None]
    return int(band.outside(x, y).sum()), band.worst_ratio(x, y)


def pair_up(original: Channel, decoded: Channel) -> SamplePair:
    """What both cover, in the counts of the file."""
    common = intersect(original.coverage, decoded.coverage)
    rows_x = [np.arange(i, i + span.ticks) for (i, _), span in common]
    rows_y = [np.arange(j, j + span.ticks) for (_, j), span in common]
    none = np.zeros(0, np.int64)
    at_x, at_y = np.concatenate([none, *rows_x]), np.concatenate([none, *rows_y])
    physical_x, physical_y = original.samples()[at_x], decoded.samples()[at_y]
    # Equal infinities do not differ; NaN words differ only where their bits do.
    same = physical_x.view(np.int64) == physical_y.view(np.int64)
    with np.errstate(all="ignore"):
        errors = np.where(same, 0.0, np.abs(physical_x - physical_y))
    y = decoded.stored[at_y]
    moved, far = 0.0, 0
    finite = physical_x[np.isfinite(physical_x)]
    if decoded.exact is not None:
        x, y = physical_x.view(np.int64), physical_y.view(np.int64)
    elif decoded.calibration is None:
        x, y = comparable(original.stored[at_x], y)
    elif original.calibration == decoded.calibration:
        x = original.stored[at_x]
    else:
        near = reachable(physical_x, decoded.calibration)
        far = int(physical_x.size - near.sum())
        x = np.where(near, 0, y).astype(np.int64)
        x[near] = nearest_counts(physical_x[near], decoded.calibration)
        away = np.abs(physical_x[near] - physical_of(x[near], decoded.calibration))
        moved = float(away.max(initial=0.0))
    return SamplePair(
        x,
        y,
        original.stored.size - at_x.size,
        decoded.stored.size - at_y.size,
        float(errors.max(initial=0.0)),
        moved,
        far,
        # In Python: of doubles it may be infinite.
        float(finite.max()) - float(finite.min()) if finite.size else 0.0,
    )


def comparable(x: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Words as numbers that differ exactly where the words do."""
    if x.dtype == y.dtype:
        kind = f"u{x.dtype.itemsize}"
        return x.view(kind), y.view(kind)
    if x.dtype.kind in "iu" and y.dtype.kind in "iu":
        return x.astype(object), y.astype(object)
    return x.astype(np.float64).view(np.int64), y.astype(np.float64).view(np.int64)


def reachable(physical: NDArray[np.float64], calibration: Calibration) -> NDArray[np.bool_]:
    """Where a value is near any count at all: finite, and within 32 bits."""
    with np.errstate(all="ignore"):
        guess = (physical * calibration.d - calibration.b) / calibration.a
        return np.isfinite(guess) & (np.abs(guess) < (1 << 32) - 1)


def nearest_counts(physical: NDArray[np.float64], calibration: Calibration) -> NDArray[np.int64]:
    """The count nearest to each physical value, which is ``reachable``; exact on the grid."""
    a, b, d = calibration.a, calibration.b, calibration.d
    guess = np.rint((physical * d - b) / a)
    # With a large B the product above is rounded: the neighbours may be nearer.
    tried = [guess.astype(np.int64) + shift for shift in (0, -1, 1)]
    away = [np.abs(physical - physical_of(counts, calibration)) for counts in tried]
    return np.choose(np.argmin(away, axis=0), tried) if guess.size else tried[0]


def physical_of(counts: NDArray[np.int64], calibration: Calibration) -> NDArray[np.float64]:
    """As Calibration.physical, for counts that may lie outside its exact range too."""
    a, b, d = calibration.a, calibration.b, calibration.d
    if int(np.abs(counts).max(initial=0)) * abs(a) + abs(b) < 1 << 62:
        return (counts * a + b).astype(np.float64) / d
    return (counts.astype(np.float64) * a + b) / d


@dataclass(repr=False)
class Report:
    """What ``verify`` found; ``verdict`` is a word of SPEC clause 13, ``exit_code`` its number.

    ``summary`` are plain sentences on damage and losses; ``lost`` are the lost parts with
    ``labels``, ``start`` and ``stop`` in seconds.
    """

    exit_code: int = INTACT
    findings: list[dict[str, Any]] = field(default_factory=list)
    lost: list[LostPart] = field(default_factory=list)
    summary: list[str] = field(default_factory=list)
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

    def headline(self) -> str:
        """The verdict and the numbers of packets and samples, in one line."""
        facts = [counted(self.packets, "packet"), counted(self.samples, "sample")]
        facts += [counted(self.digests, "SHA-256 checksum")] if self.digests else []
        facts += [counted(self.events, "event")] if self.events else []
        return f"{self.judgement()}; {', '.join(facts)}"

    def judgement(self) -> str:
        """The verdict on the file, and how its number of samples differs from the original's."""
        missing = sum(check.missing for check in self.contracts)
        added = sum(check.invented for check in self.contracts)
        differences = []
        if missing:
            verb = "is" if missing == 1 else "are"
            differences.append(f"{counted(missing, 'sample')} of the original {verb} missing")
        if added:
            verb = "is" if added == 1 else "are"
            differences.append(f"{counted(added, 'sample')} {verb} not in the original")
        word = VERDICTS[self.file_code]
        if self.findings and all(each["code"] in HARMLESS for each in self.findings):
            word += ", not closed"
        if not differences:
            return word
        link = "but" if self.file_code == INTACT else "and"
        return f"{word}, {link} {' and '.join(differences)}"

    def bounds(self) -> str:
        """The result of the comparison with the original, in one line."""
        checks = self.contracts
        broken = [check for check in checks if check.promised and check.outside]
        aims = [check for check in checks if not check.promised and check.outside]
        if broken:
            what = "the error bound does not hold"
            return f"{len(broken)} of {counted(len(checks), 'channel')}: {what}"
        if any(check.synthetic for check in aims):
            named = counted(sum(check.synthetic for check in aims), "channel")
            return f"{named} of {len(checks)}: the texture is synthetic, so it has no error bound"
        if aims:
            what = "a sample is outside the bound, which is only an aim"
            return f"{len(aims)} of {counted(len(checks), 'channel')}: {what}"
        every, rest = "every sample", "; none is missing, none was added"
        if any(check.missing or check.invented for check in checks):
            every, rest = "every sample that both have", ""
        if all(not check.largest_error for check in checks):
            return f"{every} equals the original{rest}"
        return f"{every} keeps its error bound{rest}"

    def __repr__(self) -> str:
        """What the command line prints."""
        error = [self.error.line()] if self.error else []
        bounds = [self.bounds()] if self.contracts else []
        return "\n  ".join([f"Report: {self.headline()}", *error, *self.summary, *bounds])

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
    """Check a file against every rule of the SPEC, and with ``against`` its error bounds too.

    ``against`` is the original recording. ``threads``, ``file_id``: as for a Reader. Damage is in
    the report. Raises only OSError, and ParameterError if ``against`` does not belong to the file.
    """
    if not isinstance(against, Recording | None):
        raise ParameterError(f"against is a recording, as hapfmt.read gives it, not {against!r}")
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
        damage = reader.damage()
        report.lost, report.summary = damage.parts(), damage.lines()
        report.damage = damage.as_json()
        report.unknown = [header.type for header in catalogue.unknown]
        codes = [finding.code for finding in catalogue.findings]
        broken = any(check.broken for check in report.contracts)
        report.file_code, report.exit_code = (
            verdict_of(codes, error=report.error, unknown=catalogue.not_understood, lost=lost)
            for lost in (bool(reader.lost), bool(reader.lost) or broken)
        )
        return report


def examine(reader: Reader) -> DamageReport:
    """What ``verify`` reports of the damage in a file that was walked through."""
    with suppress(FormatError, UnsupportedError, LimitError):
        check_structure(reader.catalogue)
        check_packets(reader, Report(), None)
    return reader.damage()


def check_structure(catalogue: Catalogue) -> None:
    """Index, footer, channel numbers: only in a file without damage. Attachments and clocks."""
    check_extras(catalogue)
    if catalogue.damaged:
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
            if chunk is None:
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
        elif ref.type == "fOOT":
            check_foot(catalogue, ref, last_index)
        else:
            size = HEADER_SIZE + (ref.size or 0)
            if unlisted and unlisted + size > INDEX_EVERY:
                raise FormatError(
                    "more than 4 MiB without an index", requirement="IDX-005", offset=ref.offset
                )
            unlisted += size
    foot = catalogue.foot
    if foot is None or catalogue.unsupported:
        return
    at = catalogue.source.size - FOOT.size
    bases = catalogue.table.bases
    if foot.duration_ns != int(catalogue.duration * 10**9):
        raise FormatError("the duration in the footer is wrong", requirement="FOT-002", offset=at)
    bare = [t for t in catalogue.tracks.values() if t.kind == "lf" and t.id not in bases]
    if bare:
        raise lone_lf(bare[0])
    if missing_channels(catalogue.tracks.values()):
        raise FormatError("a channel number is missing", requirement="TRK-010", offset=at)


def check_foot(catalogue: Catalogue, ref: ChunkRef, last_index: int) -> None:
    """FOT-002, of any footer; ``last_index`` 0: there is none before it."""
    chunk = read_chunk(catalogue.source, ref.offset)
    distance = ref.offset - last_index if last_index else 0
    if chunk is None or parse_foot(chunk.payload, 0).index_distance != distance:
        raise FormatError(
            "a footer does not name the last index before it",
            requirement="FOT-002",
            offset=ref.offset + HEADER_SIZE,
        )


def check_extras(catalogue: Catalogue) -> None:
    for _ in catalogue.each_attachment():
        pass
    _ = catalogue.clocks, catalogue.clock_maps


def check_packets(
    reader: Reader, report: Report, progress: Callable[[int, int], None] | None
) -> None:
    """Decode all that is supported, and compare digests with the packets before them."""
    catalogue = reader.catalogue
    digests = DigestCheck(catalogue)
    if catalogue.unsupported:
        # Only what the tables tell of the packets (CHK-009).
        for _ in reader.packets(dict.fromkeys(catalogue.tracks, (0, TICK_LIMIT))):
            pass
        reader.lost.extend(reader.lost_parts(catalogue.channels, "full"))
        raise catalogue.unsupported
    tracks = list(catalogue.tracks.values())
    known = [track for track in tracks if not track.unsupported]
    others = [track for track in tracks if track.unsupported]
    numbers = {channel.number for channel in catalogue.channels}
    for piece in reader.pieces(known, exact=True, progress=progress, beside=others):
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
    # The packets of a track without a description were named themselves.
    reader.lost.extend(span for span in parts if span.track in catalogue.tracks)
    report.digests = len(digests.stored)
    digests.compare({span.track for span in reader.lost})
    for track in catalogue.tracks.values():
        if track.unsupported:
            raise unsupported_track(track)
