"""Finds all chunks in the order of the file despite damage: SPEC clause 14, procedure ``walk``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from ..errors import ChecksumError, FormatError, LimitError, TruncatedError
from .cluster import held_size
from .layout import FOOT
from .source import ByteSource
from .wire import (
    HEADER_SIZE,
    SIGNATURE,
    SYNC,
    ChunkHeader,
    crc32,
    id_text,
    parse_header,
)

FIRST_BLOCK, BLOCK_SIZE = 1 << 8, 1 << 16
"""Bytes per block when scanning for a header: the size doubles from the first to the second.
So headers close to one another cost little."""

FOOT_SIZE = HEADER_SIZE + FOOT.size
"""Bytes of a whole fOOT chunk."""
MARK_BLOCK, MARK_BLOCK_LIMIT = 1 << 16, 1 << 22
"""Bytes looked at first for the last index; the size doubles from the first to the second."""

TABLE_WORK = 8
"""Reading the table of a damaged cluster costs at most 8 times the CRC of its payload."""

WORK_FACTOR, WORK_BASE = 16, 1 << 26
"""A file made of headers that each promise the rest of it would take time in the square of its
size: checksums are computed over at most this many times its bytes (SPEC REC-005)."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong: what, where, how many bytes, by which rule."""

    code: str
    offset: int
    size: int
    message: str
    requirement: str

    @property
    def error(self) -> type[FormatError]:
        """What is raised where damage is refused."""
        return TruncatedError if self.code in ("not-closed", "truncated") else ChecksumError

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        return f"0x{self.offset:x}+{self.size}: {self.code}: {self.message} [{self.requirement}]"


@dataclass(frozen=True)
class Chunk:
    """A chunk whose header holds; ``payload`` is as much as the file has of it."""

    header: ChunkHeader
    offset: int
    payload: bytes
    intact: bool

    @property
    def payload_offset(self) -> int:
        return self.offset + HEADER_SIZE

    @property
    def stop(self) -> int:
        return self.payload_offset + self.header.payload_size


def header_at(source: ByteSource, offset: int, file_id: int | None) -> ChunkHeader | None:
    """The valid header at ``offset``, or None."""
    data = source.read_at(offset, HEADER_SIZE)
    if data[:4] != SYNC or len(data) < HEADER_SIZE:
        return None
    try:
        header = parse_header(data, offset)
    except FormatError:
        return None
    return header if file_id is None or header.file_id == file_id else None


def read_chunk(source: ByteSource, offset: int, file_id: int | None = None) -> Chunk | None:
    """The chunk at ``offset``, or None if no valid header is there."""
    header = header_at(source, offset, file_id)
    if header is None:
        return None
    payload = source.read_at(offset + HEADER_SIZE, header.payload_size)
    return Chunk(header, offset, payload, holds(header, payload))


def holds(header: ChunkHeader, payload: bytes) -> bool:
    """Whether the payload is whole and its CRC right (SPEC CHK-003)."""
    whole = len(payload) == header.payload_size
    return whole and crc32(payload, header.seed) == header.payload_crc


def find_header(source: ByteSource, start: int, file_id: int | None) -> int | None:
    """Offset of the first valid header at or after ``start``, whatever the block edges."""
    position, size = start, FIRST_BLOCK
    while position < source.size:
        # Each block reaches three bytes into the next, so a sync word on the edge is seen once.
        block = source.read_at(position, size + len(SYNC) - 1)
        at = block.find(SYNC)
        while at >= 0:
            if header_at(source, position + at, file_id) is not None:
                return position + at
            at = block.find(SYNC, at + 1)
        position += size
        size = min(2 * size, BLOCK_SIZE)
    return None


def walk(
    source: ByteSource,
    findings: list[Finding],
    file_id: int | None = None,
    *,
    after: Chunk | None = None,
) -> Iterator[Chunk]:
    """Every chunk with this file id that can be found, or those after one; what is wrong is
    appended to ``findings`` on the way. ``file_id`` None: the one that ``identify`` gives."""
    if file_id is None:
        file_id = after.header.file_id if after else identify(source)
    position = after.stop if after else len(SIGNATURE)
    if after is None and source.read_at(0, len(SIGNATURE)) != SIGNATURE:
        findings.append(
            Finding("bad-signature", 0, len(SIGNATURE), "the signature differs", "FIL-001")
        )
        position = 0
    seen: set[int] = set()
    others = Strangers(source, file_id)
    last = after.header.sequence if after else -1
    suspect_from: int | None = None
    work = WORK_BASE + WORK_FACTOR * source.size
    while position < source.size or suspect_from is not None:
        header = header_at(source, position, file_id)
        if header is None:
            start = position if suspect_from is None else suspect_from
            found = find_header(source, start, file_id)
            stop = source.size if found is None else found
            if stop > position:
                findings.append(
                    Finding(
                        "garbage", position, stop - position, "bytes that are no chunk", "FIL-002"
                    )
                )
                findings += others.within(position, stop)
            if found is None:
                return
            position, suspect_from = found, None
            continue
        offset, payload_offset = position, position + HEADER_SIZE
        position = min(payload_offset + header.payload_size, source.size)
        if header.sequence in seen:
            message = f"sequence number {header.sequence} again"
            findings.append(
                Finding("duplicate-chunk", offset, position - offset, message, "CHK-005")
            )
            suspect_from = payload_offset
            continue
        if header.sequence != last + 1:
            findings.append(order_finding(header.sequence, last, offset))
        last = header.sequence
        payload = source.read_at(payload_offset, header.payload_size)
        intact = holds(header, payload)
        chunk = Chunk(header, offset, payload, intact)
        work = spend(work, chunk)
        if intact:
            seen.add(header.sequence)
        else:
            whole = len(payload) == header.payload_size
            findings.append(payload_finding(header, offset, position - offset, whole))
            if header.type != "aTTc":
                findings += others.within(payload_offset, position)
        yield chunk
        suspect_from = None if intact else payload_offset


def identify(source: ByteSource) -> int | None:
    """The file id that most of the file belongs to; None if the file has no header.

    A block of another file does no harm, not even at the start (SPEC REC-013): the id of a HEAD at
    the start counts where the last index or footer has it too, so a read by the index agrees.
    """
    work = WORK_BASE + WORK_FACTOR * source.size
    last = last_mark(source, work)
    first = read_chunk(source, len(SIGNATURE)) if signed(source) else None
    begun = first is not None and first.intact and first.header.type == "HEAD"
    if first and last and begun and first.header.file_id == last.header.file_id:
        return first.header.file_id
    # Bytes that hold under each id, in the order of their first headers.
    votes: dict[int, int] = {}
    described = {last.header.file_id} if last else set()
    position = find_header(source, 0, None)
    while position is not None:
        chunk = read_chunk(source, position)
        assert chunk is not None
        header, stop = chunk.header, chunk.stop
        work = spend(work, chunk)
        held = HEADER_SIZE + header.payload_size if chunk.intact else 0
        if header.type == "DATA" and not chunk.intact:
            work = spend(work, chunk, TABLE_WORK)
            held = held_size(chunk.payload, header.cluster_seed)
        if header.type == "TRAK" and chunk.intact:
            described.add(header.file_id)
        votes[header.file_id] = votes.get(header.file_id, 0) + held
        sure = chunk.intact or header.type == "aTTc" or follows(source, header, stop)
        position = find_header(source, stop if sure else position + 1, None)
    # Without a description no packet can be read.
    chosen = [file_id for file_id in reversed(votes) if file_id in described] or reversed(votes)
    return max(chosen, key=votes.__getitem__, default=None)


def signed(source: ByteSource) -> bool:
    """Whether the file begins with the signature."""
    return source.read_at(0, len(SIGNATURE)) == SIGNATURE


def last_mark(source: ByteSource, work: int) -> Chunk | None:
    """The footer that ends the file, or the last intact index or footer, under any id."""
    foot = read_chunk(source, source.size - FOOT_SIZE) if source.size > FOOT_SIZE else None
    if foot is not None and foot.intact and foot.header.type == "fOOT":
        return foot
    for chunk in marks_backwards(source):
        work = spend(work, chunk)
        if chunk.intact:
            return chunk
    return None


def marks_backwards(source: ByteSource, lowest: int = 0) -> Iterator[Chunk]:
    """Every index and footer with a valid header, the last one first, under any id."""
    stop, size = source.size, MARK_BLOCK
    while stop > lowest:
        start = max(stop - size, lowest)
        block = source.read_at(start, stop - start + len(SYNC) - 1)
        at = block.rfind(SYNC)
        while at >= 0:
            header = header_at(source, start + at, None)
            if header is not None and header.type in ("iNDX", "fOOT"):
                chunk = read_chunk(source, start + at)
                assert chunk is not None
                yield chunk
            at = block.rfind(SYNC, 0, at + len(SYNC) - 1)
        stop, size = start, min(2 * size, MARK_BLOCK_LIMIT)


def follows(source: ByteSource, header: ChunkHeader, stop: int) -> bool:
    """Whether the chunk ends at ``stop`` although its payload is damaged: the next chunk starts
    there, or the file ends."""
    after = header_at(source, stop, header.file_id)
    return stop == source.size or (after is not None and after.sequence == header.sequence + 1)


class Strangers:
    """The ids of other files, each reported once (SPEC, ``strangers``)."""

    def __init__(self, source: ByteSource, file_id: int | None) -> None:
        self.source = source
        self.file_id = file_id
        self.known = {file_id}
        self.searched = 0
        """No byte is searched twice: chunks may lie in chunks."""

    def within(self, start: int, stop: int) -> Iterator[Finding]:
        """The findings of the headers that begin within these bytes."""
        position = find_header(self.source, max(start, self.searched), None)
        self.searched = max(self.searched, stop)
        while position is not None and position < stop:
            header = header_at(self.source, position, None)
            assert header is not None
            if header.file_id not in self.known:
                self.known.add(header.file_id)
                message = (
                    f"a chunk of another file with the id {id_text(header.file_id)}; "
                    f"this file has the id {id_text(self.file_id or 0)}"
                )
                yield Finding("other-file", position, 0, message, "REC-013")
            position = find_header(self.source, position + 1, None)


def spend(work: int, chunk: Chunk, times: int = 1) -> int:
    """What is left of the bytes that checksums may be taken of (REC-005)."""
    work -= HEADER_SIZE + times * len(chunk.payload)
    if work < 0:
        raise LimitError(
            "too many chunks inside damaged chunks", requirement="REC-005", offset=chunk.offset
        )
    return work


def payload_finding(header: ChunkHeader, offset: int, size: int, whole: bool) -> Finding:
    if not whole:
        message = f"the file ends within a {header.type} chunk"
        return Finding("truncated", offset, size, message, "WRT-001")
    message = f"checksum error in the payload of a {header.type} chunk"
    return Finding("bad-payload", offset, size, message, "CHK-003")


def order_finding(sequence: int, last: int, offset: int) -> Finding:
    if sequence > last:
        return Finding(
            "missing-chunk",
            offset,
            0,
            f"chunks {last + 1} to {sequence - 1} are missing",
            "CHK-005",
        )
    return Finding("out-of-order", offset, 0, f"chunk {sequence} after chunk {last}", "CHK-005")
