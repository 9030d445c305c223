"""SPEC 2, 5, 6.1 and 6.2: numbers and texts, chunks, HEAD, TLVs."""

from __future__ import annotations

from collections.abc import Iterator

import broken
import forge as f
from broken import DATA, FIVES, HEAD, TRACK, described, packed, series
from case import NONCONFORMING, Case

NOTHING_VALID = ("FIL-001", "HED-001", "FIL-002", "FIL-003")
SIGNED = ("HED-001", "FIL-001", "FIL-002", "FIL-003")

KEPT = [FIVES]
THREE = b"\x0a\x0a\x0a"
"""A packet of three components."""


def knots(packet: bytes) -> bytes:
    return packed(b"KNOT", f.knot_parameters(), packet, 1)


def labelled(raw: bytes) -> bytes:
    """A label of these bytes."""
    return described(f.HOLD + f.tlv(2, bytes([len(raw)]) + raw))


def table(packet_count: bytes, size: bytes = b"\1", start: bytes = b"\0") -> bytes:
    """DATA, its numbers written out."""
    crc = f.packet_crc(1, 0, 0, 4, f.KNOT_DATA).to_bytes(4, "little")
    rows = packet_count + b"\0\0" + b"\0" + size + start + b"\4" + crc
    crc = f.cluster_crc(rows).to_bytes(4, "little")
    return series((f.trak(), 0), data=("DATA", rows + crc + f.KNOT_DATA))


VARINTS = [
    ("varint-of-nine-bytes", "CNV-002", "A knot value takes nine bytes.",
     knots(b"\x80" * 8 + b"\1"), None, NONCONFORMING),
    ("varint-of-2-to-53", "CNV-002", "A knot value is the varint 2^53.",
     knots(b"\x80" * 7 + b"\x10"), None, NONCONFORMING),
    ("varint-cut-short", ("CNV-002", "KNT-002"), "The last byte of a packet announces another.",
     knots(b"\x80"), None, NONCONFORMING),
    ("varint-not-minimal", "CNV-002", "The knot value -1 is stored as 81 00.",
     knots(b"\x81\0"), None, NONCONFORMING),
    ("varint-of-eight-bytes-not-minimal", "CNV-002", "A last, eighth byte of a varint is 0.",
     knots(b"\x8A" + b"\x80" * 6 + b"\0"), None, NONCONFORMING),
    ("packet-size-not-minimal", "CNV-002", "A packet size of 1 is stored as 81 00.",
     table(b"\1", b"\x81\0"), KEPT),
    ("step-not-minimal", "CNV-002", "The step 1 is stored as 81 00.",
     described(f.tlv(1, b"\0\0\0\x81\0\0")), KEPT),
]  # fmt: skip

TEXTS = [
    ("text-no-utf-8", "CNV-004", "A label holds the byte FF.", labelled(b"\xFF"), KEPT),
    ("text-overlong", "CNV-004", "A label holds C0 AF, an overlong slash.",
     labelled(b"\xC0\xAF"), KEPT),
    ("text-surrogate", "CNV-004", "A label holds ED A0 80, half of a surrogate pair.",
     labelled(b"\xED\xA0\x80"), KEPT),
    ("text-above-unicode", "CNV-004", "A label holds F4 90 80 80, above U+10FFFF.",
     labelled(b"\xF4\x90\x80\x80"), KEPT),
    ("text-ends-within-a-character", "CNV-004", "A label ends after the first byte of two.",
     labelled(b"N\xC3"), KEPT),
    ("text-nul", "CNV-004", "A label holds U+0000.", labelled(b"a\0b"), KEPT),
    ("text-provenance-nul", "CNV-004", "The provenance, a text without length, ends with U+0000.",
     described(f.HOLD + f.tlv(22, b"lab\0")), KEPT),
    ("text-before-the-first", "TLV-004", "A list of strings begins with the byte 255.",
     described(f.HOLD + f.tlv(2, b"\xFF")), KEPT),
]  # fmt: skip

NO_FILE = [
    ("no-bytes", NOTHING_VALID, "The file is empty.", b"", None, NONCONFORMING),
    ("signature-alone", SIGNED, "The signature is the whole file.", f.SIGNATURE, None,
     NONCONFORMING),
    ("another-format", NOTHING_VALID, "A RIFF WAVE file without samples.",
     b"RIFF\x24\0\0\0WAVEfmt \x10\0\0\0\1\0\1\0\xE8\3\0\0\xD0\7\0\0\2\0\x10\0data\0\0\0\0", None,
     NONCONFORMING),
    ("no-sync-word", ("CHK-002", *SIGNED), "The only chunk has another sync word.",
     f.SIGNATURE + f.chunk("HEAD", f.head(), 0, sync=b"\xF9\x48\x8B\x1D"), None, NONCONFORMING),
    ("no-header-crc", ("CHK-002", *SIGNED), "The only chunk has the header CRC 0.",
     f.SIGNATURE + f.chunk("HEAD", f.head(), 0, header_crc=0), None, NONCONFORMING),
    ("type-of-no-letters", ("CHK-002", *SIGNED), "The only chunk has a type with a digit.",
     f.file(("H3AD", f.head())), None, NONCONFORMING),
]  # fmt: skip

PIECE = ("HED-002", "TLV-001", "CNV-002")


def told(tlvs: bytes) -> bytes:
    """The usual file, with these bytes behind the layout of HEAD."""
    return f.closed(("HEAD", f.head(tlvs)), TRACK, DATA)


HEADS = [
    ("head-second", "HED-001", "An ancillary chunk is before HEAD.",
     f.closed(("aaaa", b""), HEAD, TRACK, DATA), KEPT),
    ("head-after-track", "HED-001", "HEAD is after TRAK.", f.closed(TRACK, HEAD, DATA), KEPT),
    ("head-2-bytes", "HED-002", "HEAD lacks a byte of its layout.",
     f.closed(("HEAD", f.head()[:-1]), TRACK, DATA), None, NONCONFORMING),
    ("head-of-no-bytes", "HED-002", "HEAD has no bytes.",
     f.closed(("HEAD", b""), TRACK, DATA), None, NONCONFORMING),
    ("head-4-bytes", PIECE, "A byte follows the layout of HEAD, a TLV without size.",
     told(b"\2"), KEPT),
    ("head-tlv-past-the-chunk", PIECE, "A TLV of HEAD is a byte longer than what is left.",
     told(f.tlv(2, bytes(16))[:-1]), KEPT),
    ("head-tlv-not-minimal", "CNV-002", "The type of a TLV of HEAD is 88 00.",
     told(b"\x88\0\1a"), KEPT),
    ("head-tlvs-unordered", "TLV-001", "The epoch is before the UUID.",
     told(f.epoch(0, 0) + f.tlv(2, bytes(16))), KEPT),
    ("head-tlv-twice", "TLV-001", "HEAD names the encoder twice.",
     told(f.tlv(6, b"one") + f.tlv(6, b"two")), KEPT),
    ("head-tlv-type-65536", "TLV-001", "A TLV of HEAD has the type 65536.",
     told(f.tlv(65536, b"")), KEPT),
    ("head-uuid-15-bytes", "HED-002", "The UUID lacks a byte.", told(f.tlv(2, bytes(15))), KEPT),
    ("head-uuid-17-bytes", "HED-002", "A byte follows the UUID.", told(f.tlv(2, bytes(17))), KEPT),
    ("head-uuid-of-no-bytes", "HED-002", "The UUID has no bytes.", told(f.tlv(2, b"")), KEPT),
    ("head-epoch-8-bytes", "HED-002", "The epoch has no uncertainty.",
     told(f.tlv(4, bytes(8))), KEPT),
    ("head-epoch-17-bytes", "HED-002", "A byte follows the epoch.",
     told(f.tlv(4, bytes(17))), KEPT),
    ("head-uncertainty-2-to-63", "HED-002", "The uncertainty of the epoch is 2^63.",
     told(f.epoch(0, 2**63)), KEPT),
    ("head-encoder-no-utf-8", "CNV-004", "The name of the program holds the byte FF.",
     told(f.tlv(6, b"\xFF")), KEPT),
    ("head-copy-differs", "HED-001", "A second HEAD has another minor version.",
     f.closed(HEAD, TRACK, DATA, ("HEAD", f.head(minor=1))), KEPT),
]  # fmt: skip

TLVS = [
    ("tlv-twice", "TLV-001", "A label occurs twice.",
     described(f.HOLD + f.tlv(2, f.strings("a")) * 2)),
    ("tlv-order", "TLV-001", "The unit is before the label.",
     described(f.HOLD + f.tlv(4, f.strings("N")) + f.tlv(2, f.strings("a")))),
    ("tlv-unknown-twice", "TLV-001", "An unknown ancillary TLV occurs twice.",
     described(f.HOLD + f.tlv(0x8000, b"") * 2), KEPT),
    ("tlv-half-a-header", ("TLV-001", "CNV-002"), "The last TLV ends behind its type.",
     described(f.HOLD + b"\2", tlv_count=2)),
    ("tlv-past-the-chunk", "TLV-001", "A TLV is a byte longer than what is left.",
     described(f.HOLD + b"\2\1")),
    ("tlv-type-65536", "TLV-001", "A TLV has the type 65536.",
     described(f.HOLD + f.tlv(65536, b"abc"))),
    ("tlv-type-65537", "TLV-001", "A TLV has the type 65537, which is no unknown critical one.",
     described(f.HOLD + f.tlv(65537, b"abc"))),
    ("tlv-type-not-minimal", "CNV-002", "The type of a TLV is 82 00.",
     described(f.HOLD + b"\x82\0\2\1a")),
    ("tlv-size-not-minimal", "CNV-002", "The size of a TLV is 82 00.",
     described(f.HOLD + b"\2\x82\0\1a")),
    ("labels-two-for-three", "TLV-004", "Two labels for three components.",
     described(f.HOLD + f.tlv(2, f.strings("a", "b")), component_count=3, packet=THREE)),
    ("label-missing", "TLV-004", "A list of strings is empty.",
     described(f.HOLD + f.tlv(2, b""))),
    ("calibrations-two-for-three", "TLV-004", "Two calibrations for three components.",
     described(f.HOLD + f.tlv(3, f.calibration(2) * 2), component_count=3, packet=THREE)),
    ("deadband-and-a-byte", "TLV-004", "A byte follows a deadband contract.",
     described(f.HOLD + f.tlv(16, f.deadband() + b"\0"))),
    ("deadband-of-kd-0", "DBC-001", "The Weber fraction has the denominator 0.",
     described(f.HOLD + f.tlv(16, f.deadband(kd=0)))),
    ("deadband-of-no-byte", ("TLV-004", "CNV-002"), "A contract is empty.",
     described(f.HOLD + f.tlv(16, b""))),
    ("string-past-its-list", ("TLV-001", "TLV-004"), "A string is longer than its TLV.",
     described(f.HOLD + f.tlv(2, b"\2N"))),
    ("calibration-cut-short", ("CNV-002", "TLV-004"), "A calibration has no D.",
     described(f.HOLD + f.tlv(3, f.calibration(2)[:-1]))),
    ("calibration-and-a-byte", ("TLV-004", "CNV-002"),
     "A byte follows a calibration: a list of one and a piece.",
     described(f.HOLD + f.tlv(3, f.calibration(2) + b"\2"))),
    ("deviation-cut-short", "TLV-004", "A deviation has seven bytes.",
     described(f.HOLD + f.tlv(18, f.deviation(1, 1)[:-1]))),
    ("deviation-larger-than-declared", "TLV-005", "The largest deviation is above the declared.",
     described(f.HOLD + f.tlv(18, f.deviation(1, 2)))),
    ("deviation-infinite", "TLV-005", "The declared tolerance is infinite.",
     described(f.HOLD + f.tlv(18, f.deviation(float("inf"), 1)))),
    ("deviation-no-number", "TLV-005", "The largest deviation is NaN.",
     described(f.HOLD + f.tlv(18, f.deviation(1, float("nan"))))),
]  # fmt: skip


OPEN = [
    ("open-and-no-tracks", "TRK-002", "A file that was not closed has a series without tracks.",
     f.file(HEAD, ("TRAK", f.trak(track_count=0))), None, NONCONFORMING, "VRD-001"),
    ("open-and-no-knot", ("KNT-002", "CNV-002", "COD-001"),
     "A file that was not closed has a packet without its first knot.",
     f.file(HEAD, TRACK, ("DATA", f.cluster((0, 0, 4, b"")))), None, None, "VRD-001"),
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("structure/varint", VARINTS)
    yield from broken.cases("structure/text", TEXTS)
    yield from broken.cases(broken.NOTHING, NO_FILE)
    yield from broken.cases("framing/head", HEADS)
    yield from broken.cases("structure/list", OPEN)
    yield from broken.cases("structure/list", TLVS)
