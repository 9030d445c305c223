"""The fixed layouts of the format: SPEC's tables are printed from these declarations.

Flat structs of plain little-endian integers and bytes, one line of meaning each. They check
nothing: every check and every conversion is in wire.py, track.py, cluster.py and index.py.
"""

from __future__ import annotations

from construct import (
    Bytes,
    Construct,
    Float32l,
    Int8ul,
    Int16ul,
    Int32sl,
    Int32ul,
    Int64sl,
    Int64ul,
    Struct,
)

SIGNATURE = b"\x8fHAP\r\n\x1a\n"
SYNC = b"\xf9H\x8b\x1c"

CHUNK_HEADER = Struct(
    "sync" / Bytes(4) * "sync word F9 48 8B 1C",
    "type" / Bytes(4) * "chunk type, four ASCII letters; their cases are the property bits",
    "file_id" / Int64ul * "file id, the same in every chunk of the file",
    "sequence" / Int32ul * "sequence number: 0 for the first chunk, one more for each next",
    "payload_size" / Int32ul * "size of the payload in bytes",
    "track" / Int16ul * "track id that the chunk refers to; 0xFFFF: none",
    "flags" / Int16ul * "bits 0-7 critical, bits 8-15 ancillary; all 0 in version 1.0",
    "payload_crc" / Int32ul * "file CRC of the payload",
    "header_crc" / Int32ul * "CRC-32 of the 32 bytes before it",
)

HEAD = Struct(
    "major" / Int8ul * "major version, 1",
    "minor" / Int8ul * "minor version, 0",
    "level" / Int8ul * "level, 1 or 2",
    "reserved" / Int8ul * "0",
    "incompat" / Int32ul * "incompatible feature bits, none defined in 1.0",
    "compat" / Int32ul * "compatible feature bits, none defined in 1.0",
    "uuid" / Bytes(16) * "UUID of the recording in network order; all 0: none",
    "epoch_ns" / Int64sl * "UTC of tick 0, nanoseconds since 1970-01-01T00:00:00Z",
    "epoch_uncertainty_ns" / Int64ul * "its uncertainty; all 1: the epoch is not known",
)

TRACK = Struct(
    "tlv_count" / Int8ul * "TLVs that follow",
    "component_count" / Int8ul * "components",
    "kind" / Int8ul * "0 full band, 1 LF, 2 HF residual, 3 events",
    "number_format" / Int8ul * "0 counts, 1 int64, 2 uint64, 3 binary16, 4 binary32, 5 binary64",
    "codec" / Bytes(4) * "codec, four ASCII characters",
    "rate_num" / Int32ul * "numerator of the rate in ticks per second",
    "rate_den" / Int32ul * "denominator of the rate",
    "count_min" / Int32sl * "declared range of a decoded count, lowest",
    "count_max" / Int32sl * "declared range of a decoded count, highest",
    "first_channel" / Int16ul * "channel number of the first component; the others follow",
    "linked" / Int16ul * "HF: id of its base track; else of the track that it continues, or 0xFFFF",
)

TLV = Struct(
    "type" / Int16ul * "what the value is; odd: critical, even: ancillary",
    "size" / Int16ul * "size of the value in bytes",
)

DEVIATION = Struct(
    "declared" / Float32l * "tolerance that the caller declared, in the unit of the channel",
    "largest" / Float32l * "largest deviation found, in the unit of the channel",
)

INDEX = Struct(
    "previous" / Int64ul * "offset of the iNDX chunk that the list begins with; 0: none",
    "first_sequence" / Int32ul * "sequence number of the first chunk that is listed",
    "entry_count" / Int32ul * "number of entries",
)

FOOT = Struct(
    "index_offset" / Int64ul * "offset of the last iNDX chunk",
    "stop_offset" / Int64ul * "offset of the first byte after this chunk",
    "data_count" / Int32ul * "number of DATA chunks in the file",
    "track_count" / Int32ul * "number of tracks described in the file",
    "duration_ns" / Int64sl * "end of the latest packet, rounded up",
)

QUAN_PARAMETERS = Struct(
    "step" / Int32ul * "counts per level",
    "direct_levels" / Int16ul * "M: levels -M to M have symbols of their own",
    "run_classes" / Int8ul * "R: number of zero-run symbols",
    "escape_classes" / Int8ul * "C: number of escape symbols",
)

RAWB_PARAMETERS = Struct(
    "word_size" / Int8ul * "bytes per number: 1, 2, 3, 4 or 8",
    "reserved" / Bytes(3) * "0",
)

LPCX_PARAMETERS = Struct(
    "rule" / Int8ul * "0 quotient, 1 product, 2 significant digits, 3 cubic, 4 linear",
    "digits" / Int8ul * "rule 2: significant digits; else 0",
    "terms" / Int8ul * "rule 4: number of terms; else 0",
    "reserved" / Int8ul * "0",
)

TABLES: dict[str, Construct] = {
    "chunk header": CHUNK_HEADER,
    "HEAD": HEAD,
    "TLV": TLV,
    "deviation": DEVIATION,
    "track": TRACK,
    "iNDX": INDEX,
    "fOOT": FOOT,
    "QUAN parameters": QUAN_PARAMETERS,
    "RAWB parameters": RAWB_PARAMETERS,
    "LPCX parameters": LPCX_PARAMETERS,
}
"""Name of each table in SPEC.md and its declaration, in the order of the SPEC."""
