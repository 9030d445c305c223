"""Opening a file: by its index, or by walking through it (SPEC 6.5 and clause 12)."""

from __future__ import annotations

from collections.abc import Callable

from .catalogue import Catalogue, ChunkRef
from .container.chain import index_chain
from .container.index import FIRST_OFFSET, IndexEntry, parse_foot
from .container.source import Source
from .container.walk import Chunk, Finding, end_at, read_chunk, walk
from .container.wire import HEADER_SIZE, SIGNATURE
from .errors import FormatError, HapfmtError
from .limits import Limits

MS = 10**6
"""Nanoseconds."""
FOOT_SIZE = HEADER_SIZE + 32
LATER = frozenset({"DATA", "aTTc", "dGST", "cLOk", "cMAp"})
"""Chunks that are read when somebody asks for them."""


class Bounded(list[Finding]):
    """Findings, as many as there is room for."""

    def __init__(self, check: Callable[[], None]) -> None:
        super().__init__()
        self.check = check

    def append(self, finding: Finding) -> None:
        self.check()
        super().append(finding)


def open_catalogue(
    source: Source, *, scan: bool = False, limits: Limits | None = None
) -> Catalogue:
    """By the index where there is one and it holds, else by walking; ``scan`` always walks."""
    limits = limits or Limits()
    try:
        if not scan:
            found = from_index(source, limits)
            if found is not None:
                return found
        return from_walk(source, limits)
    except HapfmtError as error:
        raise error.at(path=source.path) from None


def from_index(source: Source, limits: Limits) -> Catalogue | None:
    """None where anything about the index is not as it should be (IDX-003)."""
    catalogue = Catalogue(source, limits, indexed=True)
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
        stop = FIRST_OFFSET
        for entry in index_entries(source, catalogue.foot.index_offset, file_id, limits):
            # Chunks do not overlap: so the index costs no more than the file is long.
            end = end_at(source, entry.offset, file_id)
            if end is None or entry.offset < stop:
                return None
            stop = end
            catalogue.chunks.append(
                ChunkRef(entry.type, entry.offset, entry.start_ms * MS, entry.stop_ms * MS)
            )
            if entry.type in LATER:
                continue
            chunk = read_chunk(source, entry.offset, file_id)
            if chunk is None or not chunk.intact or chunk.header.type != entry.type:
                return None
            catalogue.learn(chunk)
    except FormatError:
        return None
    return catalogue if catalogue.head else None


def index_entries(
    source: Source, offset: int, file_id: int, limits: Limits | None = None
) -> list[IndexEntry]:
    """All entries, oldest first, by the chain of indexes that ends at ``offset``."""
    limits = limits or Limits()
    kept: list[list[IndexEntry]] = []
    stop = 1 << 64
    for _, index in reversed(index_chain(source, offset, file_id, limits)):
        kept.append([entry for entry in index.entries if entry.offset < stop])
        stop = min(stop, index.covers_from)
    return [entry for entries in reversed(kept) for entry in entries]


def from_walk(source: Source, limits: Limits) -> Catalogue:
    """Every chunk that can be found, in the order of the file; damage becomes findings.

    A broken rule is raised where there is no damage anywhere, else it counts as damage (clause 14).
    """
    catalogue = Catalogue(source, limits)
    catalogue.findings = Bounded(catalogue.check_records)
    broken: list[tuple[Chunk, FormatError]] = []
    for chunk in walk(source, catalogue.findings):
        header = chunk.header
        ref = ChunkRef(
            header.type,
            chunk.offset,
            sequence=header.sequence,
            size=header.payload_size,
            known=header.known,
        )
        catalogue.check_records()
        catalogue.foot = None
        if chunk.intact:
            try:
                ref = catalogue.learn(chunk) or ref
            except FormatError as error:
                broken.append((chunk, error))
        catalogue.chunks.append(ref)
    if broken and not catalogue.damaged:
        raise catalogue.unsupported or broken[0][1]
    for chunk, fault in broken:
        lose_chunk(catalogue, chunk, fault)
    for stranger in catalogue.table.drop_strangers() if catalogue.damaged else ():
        at, rule = stranger.offset or 0, stranger.requirement or "TRK-007"
        catalogue.lose("bad-chunk", at, 0, stranger.message, rule)
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
