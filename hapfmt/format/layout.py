"""The fixed layouts of the format, each declared once: its fields in order, type and meaning.

SPEC's tables are printed from these declarations. construct writes the parts that a file has only a
few times. struct reads everything, and writes the parts that each chunk or track has. Both use the
same fields. Importing construct takes longer than reading all descriptions of a file.
"""

from __future__ import annotations

import struct
from collections import namedtuple
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple

from ..errors import TruncatedError

SIGNATURE = b"\x8fHAP\r\n\x1a\n"
SYNC = b"\xf9H\x8b\x1c"
CODES = {
    "u8": "B",
    "u16": "H",
    "u32": "L",
    "u64": "Q",
    "i32": "l",
    "i64": "q",
    "f32": "f",
    "f64": "d",
}
"""Letters of struct and of construct's FormatField for SPEC's types, except byte[n]."""


class Field(NamedTuple):
    name: str
    type: str
    meaning: str

    @property
    def length(self) -> int | None:
        """n of byte[n]."""
        return int(self.type[5:-1]) if self.type.startswith("byte[") else None

    @property
    def code(self) -> str:
        return CODES[self.type] if self.length is None else f"{self.length}s"

    @property
    def size(self) -> int:
        return struct.calcsize("<" + self.code)


class Layout:
    """Little-endian integers, numbers and bytes, one after the other."""

    def __init__(self, *fields: Field) -> None:
        self.fields = fields
        self.fixed = struct.Struct("<" + "".join(field.code for field in fields))
        self.size = self.fixed.size
        places = accumulate((field.size for field in fields), initial=0)
        self.offsets = {field.name: at for field, at in zip(fields, places, strict=False)}

    @cached_property
    def record(self) -> Any:
        """The named tuple that read gives."""
        return namedtuple("Fields", self.offsets)

    @cached_property
    def construct(self) -> Any:
        """The Struct of construct."""
        from construct import Bytes, FormatField, Struct

        return Struct(
            *(
                field.name
                / (FormatField("<", field.code) if field.length is None else Bytes(field.length))
                * field.meaning
                for field in self.fields
            )
        )

    def build(self, **values: Any) -> bytes:
        """By construct: every field is checked."""
        return bytes(self.construct.build(values))

    def pack(self, **values: Any) -> bytes:
        """By struct; byte strings have their size already."""
        return self.fixed.pack(*self.record(**values))

    def read(self, data: bytes, position: int = 0) -> Any:
        """The fields at ``position`` of data that holds them all."""
        return self.record._make(self.fixed.unpack_from(data, position))

    def parse(self, data: bytes, position: int, requirement: str, base: int) -> Any:
        """The fields at ``position``; ``base`` is the file offset of ``data``."""
        if len(data) - position < self.size:
            raise TruncatedError(
                f"{len(data) - position} bytes where the layout has {self.size}",
                requirement=requirement,
                offset=base + position,
            )
        return self.read(data, position)


CHUNK_HEADER = Layout(
    Field("sync", "byte[4]", "sync word F9 48 8B 1C"),
    Field("type", "byte[4]", "chunk type, four ASCII letters; their cases are the property bits"),
    Field("file_id", "u64", "file id, the same in every chunk of the file"),
    Field("sequence", "u32", "sequence number: 0 for the first chunk, one more for each next"),
    Field("payload_size", "u32", "size of the payload in bytes"),
    Field("payload_crc", "u32", "file CRC of the payload"),
    Field("header_crc", "u32", "CRC-32 of the 28 bytes before it"),
)

HEAD = Layout(
    Field("major", "u8", "major version, 1"),
    Field("minor", "u8", "minor version, 0"),
    Field("level", "u8", "level, 1 or 2"),
)

HEAD_EPOCH = Layout(
    Field("time_ns", "i64", "UTC of tick 0"),
    Field("uncertainty_ns", "u64", "its uncertainty"),
)
"""TLV 4 of HEAD."""

DEVIATION = Layout(
    Field("declared", "f32", "tolerance that the caller declared, in the unit of the channel"),
    Field("largest", "f32", "largest deviation found, in the unit of the channel"),
)

PACKET_FIELDS = Layout(
    Field("packet_count", "u64", "packets of the cluster"),
    Field("track", "u64", "track id"),
    Field("size", "u64", "bytes of the packet"),
    Field("start", "u64", "first tick"),
    Field("span", "u64", "number of ticks"),
)
"""What a packet CRC covers before the packet (DAT-004)."""

COVERED_SPAN = Layout(
    Field("start", "u64", "first tick"),
    Field("ticks", "u64", "number of ticks"),
)
"""One span of the coverage in a digest (SPEC 11.5)."""

INDEX = Layout(
    Field("previous", "u64", "offset of the iNDX chunk that the list begins with; 0: none"),
    Field("first_sequence", "u32", "sequence number of the first chunk that is listed"),
    Field("entry_count", "u32", "number of entries"),
)

FOOT = Layout(
    Field(
        "index_distance",
        "u32",
        "offset of this chunk minus that of the last iNDX chunk before it; 0: none",
    ),
    Field("duration_ns", "u64", "end of the latest packet, rounded up"),
)

QUAN_PARAMETERS = Layout(
    Field("step", "u32", "counts per level"),
    Field("direct_levels", "u16", "M: levels -M to M have symbols of their own"),
    Field("run_classes", "u8", "R: number of zero-run symbols"),
    Field("escape_classes", "u8", "C: number of escape symbols"),
)

RAWB_PARAMETERS = Layout(
    Field("word_size", "u8", "bytes per number: 1, 2, 3, 4 or 8"),
    Field("reserved", "byte[3]", "0"),
)

LPCX_PARAMETERS = Layout(
    Field("rule", "u8", "0 quotient, 1 product, 2 digits, 3 cubic, 4 linear"),
    Field("digits", "u8", "rule 2: 1 to 15 significant digits, or 16 plus decimals; else 0"),
    Field("terms", "u8", "rule 4: number of terms; else 0"),
    Field("reserved", "u8", "0"),
)

LPCX_TERM = Layout(
    Field("a", "u8", "a component of the track"),
    Field("lag", "u8", "in ticks"),
    Field("w", "f64", "weight"),
)

NOIS_PARAMETERS = Layout(
    Field("shift", "u8", "an interval has 2^shift ticks"),
    Field("intervals", "u8", "intervals of a frame"),
)

OVERVIEW_END = Layout(
    Field("file_id", "u64", "file id of the file that it describes"),
    Field(
        "covered",
        "u64",
        "offset in the file: it describes the packets of the `DATA` chunks before it",
    ),
    Field("base", "u32", "ticks of a bin of level 0: a power of two, at most 2^24"),
    Field("channel_count", "u32", "rows of channels in the table"),
    Field("part_count", "u32", "rows of parts in the table"),
    Field("table_crc", "u32", "CRC-32 of the table"),
    Field("magic", "byte[4]", "`hOVW`; another version has another magic"),
    Field("end_crc", "u32", "CRC-32 of the 36 bytes before it"),
)

OVERVIEW_CHANNEL = Layout(
    Field("channel", "u32", "channel number"),
    Field("first_tick", "u64", "first tick that the channel covers"),
    Field(
        "tick_count",
        "u64",
        "ticks from it up to the last that the channel covers, gaps included; 0: none",
    ),
    Field("low", "f64", "lowest finite value; 0 where there is none"),
    Field("high", "f64", "highest finite value; 0 where there is none"),
)

OVERVIEW_PART = Layout(
    Field("size", "u32", "bytes of the part"),
    Field("crc", "u32", "CRC-32 of these bytes"),
)

TABLES: dict[str, Layout] = {
    "chunk header": CHUNK_HEADER,
    "HEAD": HEAD,
    "deviation": DEVIATION,
    "iNDX": INDEX,
    "fOOT": FOOT,
    "QUAN parameters": QUAN_PARAMETERS,
    "RAWB parameters": RAWB_PARAMETERS,
    "LPCX parameters": LPCX_PARAMETERS,
    "LPCX term": LPCX_TERM,
    "NOIS parameters": NOIS_PARAMETERS,
}
"""Name of each table in SPEC.md and its declaration, in the order of the SPEC."""

OVERVIEW_TABLES: dict[str, Layout] = {
    "overview end": OVERVIEW_END,
    "overview channel": OVERVIEW_CHANNEL,
    "overview part": OVERVIEW_PART,
}
"""The same for docs/spec/overview.md."""
