"""Opens a file by its index, or by walking through it (SPEC 11.1 and clause 14).

The module also reads the chain of indexes, and the facts that appending to a file needs.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import islice

from ..errors import FormatError, HapfmtError, UnsupportedError
from ..format.extras import (
    FIRST_OFFSET,
    INDEX_EVERY,
    Foot,
    Index,
    IndexEntry,
    check_listing,
    entry_count,
    parse_foot,
    parse_index,
)
from ..format.source import ByteSource
from ..format.track import check_range, unsupported_track
from ..format.walk import (
    FOOT_SIZE,
    Chunk,
    Finding,
    header_at,
    identify,
    marks_backwards,
    read_chunk,
    signed,
    walk,
)
from ..format.wire import HEADER_SIZE, SIGNATURE
from ..limits import LEVELS, Limits
from .catalogue import Catalogue, ChunkRef


def index_chain(
    source: ByteSource, offset: int, file_id: int | None, limits: Limits | None = None
) -> list[tuple[int, Index]]:
    """Offsets and indexes, oldest first, of the chain that ends at ``offset``."""
    limits, listed = limits or Limits(), 0
    parts: list[tuple[int, Index]] = []
    position = position_after = offset
    while True:
        chunk = read_chunk(source, position, file_id)
        if chunk is None or not chunk.intact or chunk.header.type != "iNDX":
            raise FormatError(
                "no index where one should be", requirement="IDX-002", offset=position
            )
        if parts and chunk.stop > position_after:
            raise FormatError("indexes overlap", requirement="IDX-002", offset=position)
        if parts and chunk.header.sequence != parts[-1][1].first_sequence:
            raise FormatError(
                "the index does not begin with the one before",
                requirement="IDX-002",
                offset=position_after,
            )
        listed += entry_count(chunk.payload)
        limits.check("records", listed)
        index = parse_index(chunk.payload, position, chunk.payload_offset)
        if index.first_sequence + len(index.entries) != chunk.header.sequence:
            raise FormatError(
                "the index does not list every chunk before it",
                requirement="IDX-002",
                offset=position,
            )
        parts.append((position, index))
        if not index.previous:
            return parts[::-1]
        position, position_after = index.previous, position


def chain_of(catalogue: Catalogue, entries: Sequence[IndexEntry]) -> list[tuple[int, Index]]:
    """The chain that a file ends with; empty where there is none, or it does not list
    ``entries``."""
    source, file_id = catalogue.source, catalogue.file_id
    if catalogue.indexed and catalogue.foot:
        return index_chain(source, index_before(source, catalogue.foot), file_id)
    parts: list[tuple[int, Index]] = []
    offsets = [ref.offset for ref in catalogue.chunks if ref.type == "iNDX"]
    with suppress(FormatError):
        for offset, index in index_chain(source, offsets[-1], file_id) if offsets else ():
            check_listing(index, offset, entries, offset)
            parts.append((offset, index))
        return parts
    return []


def index_before(source: ByteSource, foot: Foot) -> int:
    """Offset of the last index before the footer that ends the file."""
    return source.size - FOOT_SIZE - foot.index_distance


def copied_payloads(source: ByteSource, entries: Sequence[IndexEntry]) -> set[int]:
    """The file CRCs of the payloads that HEAD and TRAK chunks carry twice."""
    places = [entry.offset for entry in entries if entry.type in ("HEAD", "TRAK")]
    headers = [header_at(source, offset, None) for offset in places]
    counts = Counter(header.payload_crc for header in headers if header is not None)
    return {crc for crc, count in counts.items() if count > 1}


MS = 10**6
"""Nanoseconds."""
LAST_MS, FAR_NS = (1 << 53) - 1, 1 << 128
"""A time of an index that may be any later one (IDX-002), and a time after every packet."""
LATER = frozenset({"DATA", "aTTc", "dGST", "cLOk", "cMAp", "iNDX", "fOOT"})
"""Chunks that are read on request only, or that the last index makes superfluous."""
BACK = INDEX_EVERY + 2 * LEVELS[2].payload_size
"""Bytes before the end of an unclosed file in which an index is searched. At most this many bytes
follow the last index, including an incomplete chunk."""
TRIES = 16
"""Indexes and footers that are looked at, intact or not."""


class Bounded(list[Finding]):
    """Findings, as many as there is room for."""

    def __init__(self, check: Callable[[], None]) -> None:
        super().__init__()
        self.check = check

    def append(self, finding: Finding) -> None:
        self.check()
        super().append(finding)


def open_catalogue(
    source: ByteSource,
    *,
    scan: bool = False,
    limits: Limits | None = None,
    file_id: int | None = None,
) -> Catalogue:
    """By the index where there is one and it holds, else by walking; ``scan`` always walks.

    ``file_id``: of a file with parts of others, which one is read.
    """
    limits = limits or Limits()
    try:
        if not scan:
            found = from_index(source, limits, file_id)
            if found is not None:
                return found
        return from_walk(source, limits, file_id=file_id)
    except HapfmtError as error:
        raise error.at(path=source.path) from None


def from_index(source: ByteSource, limits: Limits, file_id: int | None = None) -> Catalogue | None:
    """By the index of a closed file, or the last one of a file that was not closed; None where
    anything about it is not as it should be (IDX-003)."""
    if source.size < FIRST_OFFSET + FOOT_SIZE or not signed(source):
        return None
    try:
        first = read_chunk(source, FIRST_OFFSET, file_id)
        if first is None or not first.intact or first.header.type != "HEAD":
            return None
        last = read_chunk(source, source.size - FOOT_SIZE)
        if last is None or not last.intact or last.header.type != "fOOT":
            return from_checkpoint(source, first.header.file_id, limits)
        same = last.header.file_id == first.header.file_id
        return from_foot(source, last, limits) if same else None
    except FormatError:
        return None


def from_foot(source: ByteSource, chunk: Chunk, limits: Limits) -> Catalogue | None:
    file_id = chunk.header.file_id
    catalogue = Catalogue(source, limits, file_id, indexed=True)
    catalogue.foot = parse_foot(chunk.payload, chunk.payload_offset)
    offset = index_before(source, catalogue.foot)
    index = header_at(source, offset, file_id) if offset >= FIRST_OFFSET else None
    if index is None or offset + HEADER_SIZE + index.payload_size != chunk.offset:
        # A file without an index right before its footer is read in order (SPEC 11.1).
        return None
    if not learn_listed(catalogue, offset, file_id):
        return None
    catalogue.chunks.append(ChunkRef("fOOT", chunk.offset))
    return catalogue


def from_checkpoint(source: ByteSource, file_id: int, limits: Limits) -> Catalogue | None:
    """The chunks that the last index lists, and those after it, read in order.

    None if more is missing than the end of the last chunk.
    """
    catalogue = Catalogue(source, limits, file_id, indexed=True)
    index = learn_checkpoint(catalogue, file_id)
    if index is None:
        return None
    for chunk in walk(source, catalogue.findings, file_id, after=index):
        catalogue.foot = None
        found = catalogue.learn(chunk) if chunk.intact else None
        catalogue.chunks.append(found or ref_of(chunk))
    ends = all(
        finding.code in ("truncated", "garbage") and finding.offset + finding.size == source.size
        for finding in catalogue.findings
    )
    if not ends or catalogue.foot is not None:
        return None
    settle_end(catalogue)
    check_found(catalogue)
    return catalogue


def learn_checkpoint(catalogue: Catalogue, file_id: int) -> Chunk | None:
    """The last index, and what it lists is learnt; None where there is none that can be relied on.

    It follows directly on the last chunk that it lists: one within an attached file does not.
    """
    source = catalogue.source
    index = last_index(source, file_id)
    if index is None or not learn_listed(catalogue, index.offset, file_id):
        return None
    last = catalogue.chunks[-2]
    before = header_at(source, last.offset, file_id)
    if before is None or before.sequence + 1 != index.header.sequence:
        return None
    stop = last.offset + HEADER_SIZE + before.payload_size
    return index if stop == index.offset else None


def learn_listed(catalogue: Catalogue, offset: int, file_id: int) -> bool:
    """Read the descriptions listed by the chain of indexes that ends at ``offset``.

    Note the places of all other chunks without reading their headers. False if the file has
    something else at a listed place. Reads do not overlap, so the cost is bounded by the file size.
    """
    source = catalogue.source
    entries = index_entries(source, offset, file_id, catalogue.limits)
    if not entries:
        return False
    ends = [entry.offset for entry in entries[1:]] + [offset]
    stop = FIRST_OFFSET
    for entry, limit in zip(entries, ends, strict=True):
        if entry.offset < stop:
            return False
        stop = entry.offset + HEADER_SIZE
        stop_ns = entry.stop_ms * MS if entry.stop_ms < LAST_MS else FAR_NS
        catalogue.chunks.append(
            ChunkRef(entry.type, entry.offset, entry.start_ms * MS, stop_ns, limit=limit)
        )
        if entry.type in LATER:
            continue
        chunk = read_chunk(source, entry.offset, file_id)
        if chunk is None or not chunk.intact or chunk.header.type != entry.type:
            return False
        stop = chunk.stop
        catalogue.learn(chunk)
    catalogue.chunks.append(ChunkRef("iNDX", offset))
    return catalogue.head is not None


def last_index(source: ByteSource, file_id: int) -> Chunk | None:
    """The last intact index, if it is where a writer puts one (IDX-005); None where an index or a
    footer of another file comes after it (REC-013)."""
    lowest = max(source.size - BACK, FIRST_OFFSET)
    for chunk in islice(marks_backwards(source, lowest), TRIES):
        if not chunk.intact:
            continue
        if chunk.header.file_id != file_id:
            return None
        if chunk.header.type == "iNDX":
            return chunk
    return None


def settle_end(catalogue: Catalogue) -> None:
    """The end of the latest packet to the tick: an index knows its milliseconds."""
    latest = max((ref.stop_ns or 0 for ref in catalogue.data), default=0)
    for place, ref in enumerate(catalogue.chunks):
        if ref.type == "DATA" and ref.stop_ns == latest and ref.limit is not None:
            chunk = read_chunk(catalogue.source, ref.offset, catalogue.file_id)
            ref.checked(chunk.header if chunk else None)
            if chunk is not None and chunk.intact:
                start_ns, stop_ns = catalogue.time_range(chunk)
                catalogue.chunks[place] = ref._replace(start_ns=start_ns, stop_ns=stop_ns)


def index_entries(
    source: ByteSource, offset: int, file_id: int, limits: Limits | None = None
) -> list[IndexEntry]:
    """All entries, oldest first, by the chain of indexes that ends at ``offset``."""
    chain = index_chain(source, offset, file_id, limits)
    return [entry for _, index in chain for entry in index.entries]


def from_walk(
    source: ByteSource,
    limits: Limits | None = None,
    *,
    tolerant: bool = False,
    file_id: int | None = None,
) -> Catalogue:
    """Every chunk that can be found, in the order of the file; damage becomes findings.

    A broken rule is raised where there is no damage anywhere, else, and where the caller is
    ``tolerant``, it counts as damage (clause 13). ``file_id`` None: that of most of the file
    (REC-013), which is that of the first chunk where nothing is wrong.
    """
    if file_id is not None:
        return walked(source, limits, file_id, tolerant=tolerant)
    first = header_at(source, FIRST_OFFSET, None)
    if first is None or not signed(source):
        return walked(source, limits, identify(source), tolerant=tolerant)
    try:
        found = walked(source, limits, first.file_id, tolerant=tolerant)
        if not found.harmed:
            return found
        chosen = identify(source)
    except HapfmtError:
        chosen = identify(source)
        if chosen == first.file_id:
            raise
    return found if chosen == first.file_id else walked(source, limits, chosen, tolerant=tolerant)


def walked(
    source: ByteSource, limits: Limits | None, file_id: int | None, *, tolerant: bool
) -> Catalogue:
    """The chunks with one file id."""
    catalogue = Catalogue(source, limits or Limits(), file_id, tolerant=tolerant)
    catalogue.findings = Bounded(catalogue.check_records)
    last: Chunk | None = None
    broken: list[tuple[Chunk, FormatError]] = []
    for chunk in walk(source, catalogue.findings, file_id):
        ref = ref_of(chunk)
        catalogue.check_records()
        catalogue.foot = None
        last = chunk
        if chunk.intact:
            try:
                ref = catalogue.learn(chunk) or ref
            except FormatError as error:
                broken.append((chunk, error))
        catalogue.chunks.append(ref)
    catalogue.ended = last is not None and is_end(last)
    if broken and not catalogue.damaged:
        raise unknown_part(catalogue) or broken[0][1]
    if broken and not tolerant:
        # Treat chunks before the first damage as tolerantly as those after it.
        return walked(source, limits, file_id, tolerant=True)
    for chunk, fault in broken:
        lose_chunk(catalogue, chunk, fault)
    if catalogue.damaged:
        lose_strangers(catalogue)
    check_found(catalogue)
    return catalogue


def is_end(chunk: Chunk) -> bool:
    """Whether this chunk closes a file, if it is the last one (SPEC clause 5)."""
    return chunk.intact and chunk.header.type == "fOOT"


def unknown_part(catalogue: Catalogue) -> UnsupportedError | None:
    """The first critical part that is not understood; it comes before a broken rule (clause 13)."""
    tracks = [track for track in catalogue.tracks.values() if track.unsupported]
    if catalogue.unsupported is None and tracks:
        return unsupported_track(tracks[0], catalogue.source.path)
    return catalogue.unsupported


def ref_of(chunk: Chunk) -> ChunkRef:
    header = chunk.header
    return ChunkRef(
        header.type,
        chunk.offset,
        sequence=header.sequence,
        size=header.payload_size,
    )


def lose_chunk(catalogue: Catalogue, chunk: Chunk, error: HapfmtError) -> None:
    """In a damaged file a chunk that fits nothing is part of the damage."""
    catalogue.lose(
        "bad-chunk",
        chunk.offset,
        chunk.stop - chunk.offset,
        f"{chunk.header.type} chunk: {error.message}",
        error.requirement or "REC-003",
    )


def drop_broken(catalogue: Catalogue) -> list[FormatError]:
    """Drops tracks whose codec parameters break a rule. Tracks before HEAD, whose level was not
    checked yet, are checked here."""
    from .decoder import TrackDecoder

    dropped = []
    for track in list(catalogue.tracks.values()):
        try:
            if track.unsupported is None:
                check_range(track, catalogue.level, track.offset)
                TrackDecoder(track, catalogue.level)
        except FormatError as error:
            del catalogue.tracks[track.id]
            error.offset, error.requirement = track.offset, error.requirement or "COD-002"
            dropped.append(error)
    return dropped


def lose_strangers(catalogue: Catalogue) -> None:
    """Tracks that break a rule or do not fit others, and HF tracks whose base is lost."""
    faults = [*drop_broken(catalogue), *catalogue.table.drop_strangers()]
    refs = sorted(catalogue.chunks, key=lambda ref: ref.offset)
    starts = [ref.offset for ref in refs]
    for fault in faults:
        ref = refs[bisect_right(starts, fault.offset or 0) - 1]
        size, rule = HEADER_SIZE + (ref.size or 0), fault.requirement or "TRK-007"
        catalogue.lose("bad-chunk", ref.offset, size, fault.message, rule)
    for track in catalogue.tracks.values():
        if track.is_orphan(catalogue.tracks):
            message = f"HF track {track.id} has lost its base track {track.base}"
            catalogue.lose("lost-base", track.offset - HEADER_SIZE, 0, message, "DEC-003")


def no_chunk(source: ByteSource) -> FormatError:
    if source.read_at(0, len(SIGNATURE)) != SIGNATURE:
        return no_signature(source)
    return FormatError("a signature without any chunk", requirement="HED-001", offset=0)


def no_signature(source: ByteSource) -> FormatError:
    what = "no signature" if source.size else "the file is empty"
    return FormatError(
        f"not a hapf file: {what}", requirement="FIL-001", offset=0, path=source.path
    )


def check_found(catalogue: Catalogue) -> None:
    """What only the end of the walk tells."""
    source = catalogue.source
    if not catalogue.chunks:
        raise no_chunk(source)
    if catalogue.head is None and not catalogue.damaged:
        error = FormatError(
            "the file has no HEAD chunk", requirement="HED-001", offset=FIRST_OFFSET
        )
        raise unknown_part(catalogue) or error
    if catalogue.head is None:
        catalogue.lose("missing-head", FIRST_OFFSET, 0, "no intact HEAD chunk", "HED-001")
    if not catalogue.closed:
        catalogue.lose(
            "not-closed",
            source.size,
            0,
            "the file was not closed: its end may be missing",
            "FIL-003",
        )
