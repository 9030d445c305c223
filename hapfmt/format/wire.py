"""Bytes <-> checked records: chunk headers, HEAD and TLVs (SPEC clauses 5, 6.1 and 6.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar
from zlib import crc32

from ..errors import ChecksumError, FormatError, ParameterError, UnsupportedError
from ..limits import LEVELS
from ..numbers import build_varint, parse_varint
from .layout import CHUNK_HEADER, HEAD, HEAD_EPOCH, SIGNATURE, SYNC

T = TypeVar("T")
LAST_TLV = 0xFFFF
STRING_SIZE, SAME = 0xFE, 0xFF
"""Texts are at most 254 bytes; a length of 255 stands for the text before."""


Tlvs = dict[int, tuple[int, bytes]]
"""{type: (file offset of the value, value)}"""


def parse_tlvs(payload: bytes, position: int, base: int) -> Tlvs:
    """All from ``position`` to the end of the payload."""
    found: Tlvs = {}
    while position < len(payload):
        position = parse_tlv(payload, position, base, found)
    return found


def parse_tlv(payload: bytes, position: int, base: int, found: Tlvs) -> int:
    """Adds the next one; returns where it ends."""
    at = base + position
    if position >= len(payload):
        raise FormatError("the bytes end before a TLV", requirement="TLV-001", offset=at)
    type_, start = parse_varint(payload, position, base)
    size, start = parse_varint(payload, start, base)
    if type_ > LAST_TLV or (found and type_ <= next(reversed(found))):
        raise FormatError("TLV types not increasing", requirement="TLV-001", offset=at)
    if size > len(payload) - start:
        raise FormatError("a TLV runs past the end of its chunk", requirement="TLV-001", offset=at)
    found[type_] = (base + start, payload[start : start + size])
    return start + size


def build_tlvs(values: dict[int, bytes]) -> bytes:
    out = bytearray()
    for type_ in sorted(values):
        out += build_varint(type_) + build_varint(len(values[type_])) + values[type_]
    return bytes(out)


def parse_text(raw: bytes, offset: int) -> str:
    """SPEC CNV-004."""
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError:
        raise FormatError("text is not UTF-8", requirement="CNV-004", offset=offset) from None
    if "\0" in text:
        raise FormatError("text holds U+0000", requirement="CNV-004", offset=offset)
    return text


def parse_strings(value: bytes, count: int, offset: int) -> tuple[str, ...]:
    """A string list for ``count`` components."""
    items: list[str] = []
    position = 0
    while position < len(value):
        if value[position] == SAME:
            if not items:
                raise FormatError(
                    "no text before the first", requirement="TLV-004", offset=offset + position
                )
            items.append(items[-1])
            position += 1
            continue
        stop = position + 1 + value[position]
        if stop > len(value):
            raise FormatError(
                "a string runs past its list", requirement="TLV-004", offset=offset + position
            )
        items.append(parse_text(value[position + 1 : stop], offset + position + 1))
        position = stop
    return spread(items, count, offset)


def build_strings(items: Sequence[str]) -> bytes:
    out = bytearray()
    before = None
    for item in share(items):
        raw = encode_text(item)
        out += bytes([SAME]) if raw and raw == before else bytes([len(raw)]) + raw
        before = raw
    return bytes(out)


def encode_text(text: str, limit: int = STRING_SIZE) -> bytes:
    """UTF-8, ParameterError where the format cannot hold it (CNV-004)."""
    try:
        raw = text.encode("utf-8")
    except (UnicodeEncodeError, AttributeError):
        raw = b"\0"
    if len(raw) > limit or 0 in raw:
        raise ParameterError(
            f"texts are at most {limit} bytes of UTF-8 without U+0000, unlike {str(text)[:40]!r}"
        )
    return raw


def spread(items: Sequence[T], count: int, offset: int) -> tuple[T, ...]:
    """One entry for all, or one each (SPEC TLV-004)."""
    if len(items) == count:
        return tuple(items)
    if len(items) == 1:
        return tuple(items) * count
    raise FormatError(
        f"a list of {len(items)} entries for {count} components",
        requirement="TLV-004",
        offset=offset,
    )


def share(items: Sequence[T]) -> Sequence[T]:
    """The shortest list that means the same."""
    return items[:1] if len(items) == 1 or all(item == items[0] for item in items) else items


HEADER_SIZE = CHUNK_HEADER.size
CRC_OFFSET = CHUNK_HEADER.offsets["header_crc"]
FILE_ID_LIMIT = 1 << 64
MAJOR, MINOR = 1, 0
UUID, EPOCH, ENCODER = 2, 4, 6
"""TLVs of HEAD."""
HEAD_TLVS = frozenset({UUID, EPOCH, ENCODER})
UNCERTAINTY_LIMIT = 1 << 63
KNOWN_TYPES = frozenset(
    {"HEAD", "TRAK", "DATA", "iNDX", "fOOT", "mETa", "aTTc", "dGST", "cLOk", "cMAp"}
)

__all__ = [
    "HEADER_SIZE",
    "SIGNATURE",
    "SYNC",
    "ChunkHeader",
    "Head",
    "build_chunk",
    "check_file_id",
    "cluster_seed",
    "crc32",
    "id_text",
    "seed_of",
]


def check_file_id(file_id: int | None) -> None:
    if file_id is not None and not 0 <= file_id < FILE_ID_LIMIT:
        raise ParameterError("the file id must be between 0 and 2^64 - 1")


def id_text(file_id: int) -> str:
    """As messages and JSON show it: JSON numbers of 64 bits are not exact everywhere."""
    return f"0x{file_id:016x}"


def seed_of(file_id: int) -> int:
    """Where a file CRC starts: the CRC-32 of the file id (SPEC clause 2)."""
    return crc32(file_id.to_bytes(8, "little"))


def cluster_seed(file_id: int, sequence: int) -> int:
    """Where a cluster CRC starts: the file CRC of the sequence number (SPEC 6.4)."""
    return crc32(sequence.to_bytes(8, "little"), seed_of(file_id))


@dataclass(frozen=True)
class ChunkHeader:
    """SPEC 5.1, without the sync word and the header's own CRC."""

    type: str
    file_id: int
    sequence: int
    payload_size: int
    payload_crc: int

    @property
    def seed(self) -> int:
        """Where the CRC of the payload starts."""
        return seed_of(self.file_id)

    @property
    def cluster_seed(self) -> int:
        """Where the CRCs of a table and of its packets start."""
        return cluster_seed(self.file_id, self.sequence)

    @property
    def critical(self) -> bool:
        return self.type[0].isupper()

    @property
    def known(self) -> bool:
        return self.type in KNOWN_TYPES

    def build(self) -> bytes:
        head = CHUNK_HEADER.pack(
            sync=SYNC,
            type=self.type.encode("ascii"),
            file_id=self.file_id,
            sequence=self.sequence,
            payload_size=self.payload_size,
            payload_crc=self.payload_crc,
            header_crc=0,
        )[:CRC_OFFSET]
        return head + crc32(head).to_bytes(4, "little")


def parse_header(data: bytes, offset: int) -> ChunkHeader:
    """The chunk header in ``data`` (32 bytes or more), at ``offset`` in the file."""
    raw = CHUNK_HEADER.parse(data, 0, "FIL-002", offset)
    if raw.sync != SYNC:
        raise FormatError(
            "no sync word where a chunk should start", requirement="CHK-002", offset=offset
        )
    if raw.header_crc != crc32(data[:CRC_OFFSET]):
        raise ChecksumError("chunk header CRC differs", requirement="CHK-002", offset=offset)
    if not (raw.type.isascii() and raw.type.isalpha()):
        raise FormatError("chunk type is not four letters", requirement="CHK-002", offset=offset)
    if raw.payload_size > LEVELS[2].payload_size:
        LEVELS[2].check("payload_size", raw.payload_size, "LIM-001", offset)
    return ChunkHeader(
        raw.type.decode("ascii"),
        raw.file_id,
        raw.sequence,
        raw.payload_size,
        raw.payload_crc,
    )


def build_chunk(type_: str, payload: bytes, *, file_id: int, sequence: int) -> bytes:
    """A whole chunk, header and payload."""
    crc = crc32(payload, seed_of(file_id))
    return ChunkHeader(type_, file_id, sequence, len(payload), crc).build() + payload


def uuid_of(file_id: int) -> bytes:
    """The UUID of a recording that was given none, of version 8 (SPEC 6.1)."""
    digits = f"{file_id:016x}"
    return bytes.fromhex(f"{digits[:12]}8{digits[12:15]}8{digits[15]}00{'0' * 12}")


@dataclass(frozen=True)
class Head:
    """SPEC 6.1; ``epoch_ns`` is None where the epoch is not known, ``uuid`` where it follows from
    the file id."""

    level: int
    uuid: bytes | None = None
    epoch_ns: int | None = None
    epoch_uncertainty_ns: int = 0
    encoder: str = ""
    major: int = MAJOR
    minor: int = MINOR

    def build(self) -> bytes:
        values = {}
        if self.uuid is not None:
            values[UUID] = self.uuid
        if self.epoch_ns is not None:
            values[EPOCH] = HEAD_EPOCH.pack(
                time_ns=self.epoch_ns, uncertainty_ns=self.epoch_uncertainty_ns
            )
        if self.encoder:
            values[ENCODER] = encode_text(self.encoder, LEVELS[self.level].payload_size)
        fixed = HEAD.build(major=self.major, minor=self.minor, level=self.level)
        return fixed + build_tlvs(values)


def parse_head(payload: bytes, offset: int) -> Head:
    """The HEAD payload at ``offset`` in the file."""
    places = HEAD.offsets
    # A shorter HEAD of another version is unsupported, not wrong: VER-001 comes before HED-002.
    raw = HEAD.read(payload[: HEAD.size].ljust(HEAD.size, b"\0"))
    if payload and raw.major != MAJOR:
        raise UnsupportedError(f"major version {raw.major}", requirement="VER-001", offset=offset)
    if len(payload) > places["level"] and raw.level not in LEVELS:
        raise UnsupportedError(
            f"level {raw.level}", requirement="HED-004", offset=offset + places["level"]
        )
    HEAD.parse(payload, 0, "HED-002", offset)
    tlvs, position = Tlvs(), HEAD.size
    try:
        while position < len(payload):
            position = parse_tlv(payload, position, offset, tlvs)
    finally:
        unknown = [type_ for type_ in tlvs if type_ % 2]
        if unknown:
            # It comes before a broken rule, even in the TLVs behind it (clause 13).
            raise UnsupportedError(
                f"critical TLV {unknown[0]} in HEAD", requirement="TLV-003", offset=offset
            )
    for type_ in (UUID, EPOCH):
        at, value = tlvs.get(type_, (offset, bytes(HEAD_EPOCH.size)))
        if len(value) != HEAD_EPOCH.size:
            raise FormatError(
                f"TLV {type_} of HEAD without 16 bytes", requirement="HED-002", offset=at
            )
    epoch_ns, uncertainty_ns = None, 0
    if EPOCH in tlvs:
        epoch_ns, uncertainty_ns = HEAD_EPOCH.read(tlvs[EPOCH][1])
        if uncertainty_ns >= UNCERTAINTY_LIMIT:
            raise FormatError(
                "an uncertainty of 2^63 ns or more", requirement="HED-002", offset=tlvs[EPOCH][0]
            )
    encoder_at, encoder = tlvs.get(ENCODER, (offset, b""))
    return Head(
        raw.level,
        tlvs[UUID][1] if UUID in tlvs else None,
        epoch_ns,
        uncertainty_ns,
        parse_text(encoder, encoder_at),
        raw.major,
        raw.minor,
    )
