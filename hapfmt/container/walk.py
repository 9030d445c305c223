"""Chunks in order of the file, through any damage: SPEC clause 12, procedure ``walk``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from ..errors import FormatError, LimitError
from .source import Source
from .wire import HEADER_SIZE, SIGNATURE, SYNC, ChunkHeader, crc32, parse_header

FIRST_BLOCK, BLOCK_SIZE = 1 << 8, 1 << 16
"""Bytes looked at in one go when scanning for a header, doubling from the first to the second:
where headers stand close, each costs little."""

HEAD_SIZE_LIMIT = 1 << 12
"""A HEAD larger than this is not looked into when choosing the file id."""

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


def header_at(source: Source, offset: int, file_id: int | None) -> ChunkHeader | None:
    """The valid header at ``offset``, or None."""
    data = source.read_at(offset, HEADER_SIZE)
    if data[:4] != SYNC or data[28:] != crc32(data[:28]).to_bytes(4, "little"):
        return None
    try:
        header = parse_header(data, offset)
    except FormatError:
        return None
    return header if file_id is None or header.file_id == file_id else None


def read_chunk(source: Source, offset: int, file_id: int | None = None) -> Chunk | None:
    """The chunk at ``offset``, or None where no valid header stands there."""
    header = header_at(source, offset, file_id)
    if header is None:
        return None
    payload = source.read_at(offset + HEADER_SIZE, header.payload_size)
    intact = len(payload) == header.payload_size and crc32(payload) == header.payload_crc
    return Chunk(header, offset, payload, intact)


def find_header(source: Source, start: int, file_id: int | None) -> int | None:
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


def walk(source: Source, findings: list[Finding], *, after: Chunk | None = None) -> Iterator[Chunk]:
    """Every chunk that can be found, or those after one; what is wrong is appended to ``findings``
    on the way."""
    position = after.stop if after else len(SIGNATURE)
    if after is None and source.read_at(0, len(SIGNATURE)) != SIGNATURE:
        findings.append(
            Finding("bad-signature", 0, len(SIGNATURE), "the signature differs", "FIL-001")
        )
        position = 0
    file_id = choose_file_id(source)
    seen: set[int] = set()
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
        whole = len(payload) == header.payload_size
        intact = whole and crc32(payload) == header.payload_crc
        chunk = Chunk(header, offset, payload, intact)
        work = spend(work, chunk)
        if not intact:
            findings.append(payload_finding(header, offset, position - offset, whole))
        else:
            seen.add(header.sequence)
        yield chunk
        suspect_from = None if intact else payload_offset


def choose_file_id(source: Source) -> int | None:
    """The id of the header at offset 8; if that does not hold, of the first intact HEAD, so that
    a piece of another file in front does no harm; else of the first header there is. Headers
    within the payload of an intact chunk are those of an attached file."""
    header = header_at(source, len(SIGNATURE), None)
    if header is not None:
        return header.file_id
    first: int | None = None
    position = find_header(source, 0, None)
    work = WORK_BASE + WORK_FACTOR * source.size
    while position is not None:
        chunk = read_chunk(source, position)
        assert chunk is not None
        header = chunk.header
        first = header.file_id if first is None else first
        if header.type == "HEAD" and header.payload_size < HEAD_SIZE_LIMIT and chunk.intact:
            return header.file_id
        work = spend(work, chunk)
        position = find_header(source, chunk.stop if chunk.intact else position + 1, None)
    return first


def spend(work: int, chunk: Chunk) -> int:
    """What is left of the bytes that checksums may be taken of (REC-005)."""
    work -= HEADER_SIZE + len(chunk.payload)
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
