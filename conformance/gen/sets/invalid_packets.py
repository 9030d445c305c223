"""SPEC 9.1 to 9.3: packets of KNOT, QUAN and RAWB, and their parameters."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from functools import partial

import broken
import forge as f
from broken import described, packed
from case import Case


def held(packet: bytes, span: int = 4, **grid: int) -> bytes:
    return packed(b"KNOT", f.knot_parameters(0, **grid), packet, span)


def lines(packet: bytes, span: int = 4, **given: int) -> bytes:
    return packed(b"KNOT", f.knot_parameters(1), packet, span, **given)


BOUND = 2**24
KNOTS = [
    ("parameters-missing", "COD-002", "A track of KNOT has no TLV 1.", described(b"")),
    ("knots-parameters-cut-short", ("COD-002", "CNV-002"), "KNOT has no grid.",
     described(f.tlv(1, b"\0\0"))),
    ("knots-parameters-and-a-byte", "COD-002", "A byte follows the parameters of KNOT.",
     described(f.tlv(1, f.knot_parameters() + b"\0"))),
    ("knots-interpolation-2", "KNT-001", "The interpolation is 2.",
     described(f.tlv(1, f.knot_parameters(2)))),
    ("knots-coding-2", "KNT-001", "The coding is 2.", held(f.KNOT_DATA, coding=2)),
    ("knots-grid-2", "LPC-002", "The grid is 2.", held(f.KNOT_DATA, grid=2, kn=1, kd=10)),
    ("knots-step-0", "LPC-002", "The step of a uniform grid is 0.", held(f.KNOT_DATA, step=0)),
    ("knots-step-above-level-1", ("LPC-002", "LIM-001"), "The step is 2^24 + 1.",
     held(b"\0", step=BOUND + 1)),
    ("knots-none", "KNT-002", "A packet of KNOT is empty.", held(b"")),
    ("knots-value-missing", ("KNT-002", "CNV-002"), "The second knot has a tick and no value.",
     held(b"\0\1")),
    ("knots-value-of-a-component-missing", ("KNT-002", "CNV-002"),
     "The second of two components has no value.", described(packet=b"\0", component_count=2)),
    ("knots-at-one-tick", "KNT-003", "The difference of two ticks is 0.", held(b"\0\0\0")),
    ("knots-index-too-high", "LPC-003", "A knot's index is 2^24 + 1.",
     held(f.svarint(BOUND + 1))),
    ("knots-index-too-high-by-a-difference", "LPC-003", "The second knot's index is 2^24 + 1.",
     held(f.svarint(BOUND) + b"\1" + f.svarint(1))),
    ("knots-index-too-high-by-step", "LPC-003", "2 times the step 2^23 + 1 is too much.",
     held(f.svarint(2), step=2**23 + 1)),
    ("knots-product-of-2-to-64", "LPC-003", "An index times the step is 2^64, 0 in 64 bits.",
     held(f.svarint(2**44), step=2**20)),
    ("knots-differences-add-up", "LPC-003", "Differences add up to more than 2^53.",
     held(f.svarint(2**52 - 1) + (b"\1" + f.svarint(2**52 - 1)) * 2)),
    ("knots-held-at-the-end", "KNT-003", "A held knot is at the tick of the packet's end.",
     held(b"\0\4\0")),
    ("knots-line-ends-early", "KNT-003", "The last knot of a line is at tick 2 of 4.",
     lines(b"\0\2\0")),
    ("knots-line-goes-on", "KNT-003", "A knot of a line follows one at the last tick.",
     lines(b"\0\3\0\1\0")),
    ("knots-line-too-long", "KNT-003", "The last knot of a line is at tick 2^24 + 1.",
     lines(b"\0" + f.varint(BOUND + 1) + b"\0")),
]  # fmt: skip


FOUR = f.quan_parameters(b"\x22\x22", m=1, r=1)
"""Symbols 0 1 2 3, two bits each: levels 0, 1, -1, a run of 2 or 3."""

levels = partial(packed, b"QUAN")


def book(codebook: bytes, packet: bytes = b"", **given: int) -> bytes:
    return levels(f.quan_parameters(codebook, **given), packet)


LEVELS = [
    ("levels-parameters-cut-short", "COD-002", "The parameters of QUAN have seven bytes.",
     levels(FOUR[:7], b"")),
    ("levels-step-0", "QNT-001", "The step is 0.", book(b"\x10", step=0)),
    ("levels-step-above-level-1", ("QNT-001", "LIM-001"), "The step is 2^24 + 1.",
     book(b"\x10", step=BOUND + 1)),
    ("levels-4097-symbols", "QNT-001", "M = 2048: there are 4097 symbols.",
     book(b"\x10", m=2048)),
    ("levels-runs-of-25-bits", "QNT-001", "R is 25.", book(b"\x10", r=25)),
    ("levels-escapes-of-33-bits", "QNT-001", "C is 33.", book(b"\x10", c=33)),
    ("levels-lengths-more", "QNT-003", "One symbol has two code words.", book(b"\x11")),
    ("levels-skipped-more", "QNT-003", "Three symbols are skipped where two are left.",
     book(b"\x10\x20", m=1)),
    ("levels-no-code-word", "QNT-003", "No symbol has a code word.", book(b"")),
    ("levels-one-word-of-two-bits", "QNT-003", "The only code word has two bits.", book(b"\x20")),
    ("levels-words-too-many", "QNT-003", "Three code words have one bit.", book(b"\x11\x10", m=1)),
    ("levels-words-too-few", "QNT-003", "Three code words have two bits.",
     book(b"\x22\x20", m=1)),
    ("levels-run-past-the-end", "QNT-004", "A run of 2 zeros is where one tick is left.",
     levels(FOUR, b"\x03\0", 4)),
    ("levels-run-of-2-to-24", "QNT-004", "A run of 2^24 zeros codes four ticks.",
     book(b"\x10\xF0\x61", b"\x80\0\0\0", r=24)),
    ("levels-and-a-byte", ("QNT-004", "COD-001"), "A byte follows the last level.",
     levels(FOUR, b"\0\0")),
    ("levels-filled-with-ones", "QNT-004", "The bits that fill the last byte are 1.",
     levels(FOUR, b"\3", 3)),
    ("levels-product-too-large", "QNT-006", "A level times the step is 3 * 2^24.",
     levels(f.quan_parameters(b"\x22\x22", c=3, step=BOUND), b"\xA0", 1)),
    ("levels-product-of-2-to-55", "QNT-006", "A level times the step is 2^55, 0 in 32 bits.",
     levels(f.quan_parameters(b"\x10\xF0\xE1", c=32, step=BOUND), b"\x80" + bytes(4), 1)),
    ("levels-missing", "COD-001", "A packet ends before its last level.", levels(FOUR, b"\0", 5)),
    ("levels-of-no-bytes", "COD-001", "A packet of four levels is empty.", levels(FOUR, b"")),
    ("levels-extra-bits-missing", "COD-001", "A packet ends before the extra bit of a run.",
     levels(FOUR, b"\x03", 6)),
    ("levels-bytes-of-one-word", ("COD-001", "QNT-004"),
     "The only symbol takes no bits, and there is a byte.", book(b"\x10", b"\0")),
]  # fmt: skip


def raw(packet: bytes, word_size: int = 1, span: int = 2, **fields: int) -> bytes:
    return packed(b"RAWB", f.raw_parameters(word_size), packet, span, **fields)


def deflated(data: bytes) -> bytes:
    """Stored, in one DEFLATE block: the same bytes whatever the library."""
    return b"\1\1" + struct.pack("<HH", len(data), 0xFFFF - len(data)) + data


WORDS = {"count_min": 0, "count_max": 0}
RAW = [
    ("raw-parameters-cut-short", "COD-002", "The parameters of RAWB have three bytes.",
     described(f.tlv(1, b"\1\0\0"), codec=b"RAWB", packet=bytes(5))),
    ("raw-parameters-and-a-byte", "COD-002", "The parameters of RAWB have five bytes.",
     described(f.tlv(1, b"\1\0\0\0\0"), codec=b"RAWB", packet=bytes(5))),
    ("raw-parameters-reserved", "HED-005", "A reserved byte of RAWB is 1.",
     described(f.tlv(1, b"\1\0\0\1"), codec=b"RAWB", packet=b"\0\5\5\5\5"),
     [broken.FIVES]),
    ("raw-counts-of-5-bytes", "RAW-001", "The words of counts have five bytes.",
     raw(bytes(11), 5)),
    ("raw-counts-of-8-bytes", "RAW-001", "The words of counts have eight bytes.",
     raw(bytes(17), 8)),
    ("raw-binary32-of-8-bytes", "RAW-001", "The words of binary32 have eight bytes.",
     raw(bytes(17), 8, number_format=4, **WORDS)),
    ("raw-no-method", ("COD-001", "RAW-003"), "A packet of RAWB is empty.", raw(b"")),
    ("raw-method-2", "RAW-003", "The method is 2.", raw(b"\2\0\0")),
    ("raw-stored-too-short", "RAW-003", "A byte of two is missing.", raw(b"\0\5")),
    ("raw-stored-too-long", "RAW-003", "A byte follows two.", raw(b"\0\5\5\5")),
    ("raw-inflates-too-short", "RAW-003", "One byte is inflated where two belong.",
     raw(deflated(b"\5"))),
    ("raw-inflates-too-long", "RAW-003", "Three bytes are inflated where two belong.",
     raw(deflated(b"\5\5\5"))),
    ("raw-no-deflate", "RAW-003", "The bytes are no DEFLATE stream.", raw(b"\1\xFF")),
    ("raw-deflate-of-no-bytes", "RAW-003", "No byte follows the method 1.",
     raw(b"\1")),
    ("raw-deflate-with-zlib-header", "RAW-003", "The stream has a header of zlib.",
     raw(b"\1\x78\x01" + deflated(b"\5\5")[1:] + zlib.adler32(b"\5\5").to_bytes(4, "big"))),
    ("raw-deflate-not-ended", "RAW-003", "No block of the stream says that it is the last.",
     raw(b"\1\0" + deflated(b"\5\5")[2:])),
    ("raw-deflate-cut-short", "RAW-003", "The stream ends within its block.",
     raw(deflated(b"\5\5")[:-1])),
    ("raw-deflate-and-a-byte", "RAW-003", "A byte follows the stream.",
     raw(deflated(b"\5\5") + b"\0")),
    ("raw-deflate-reserved-block", "RAW-003", "A block has the type 3.", raw(b"\1\7\0\0")),
    ("raw-deflate-distance", "RAW-003", "A match points before the first byte.",
     raw(b"\1\3\2\0")),
    ("raw-count-too-high", "RAW-005", "A count is 101, above its declared range.",
     raw(b"\0\x65\5")),
    ("raw-count-too-low", "RAW-005", "A count is -101, below its declared range.",
     raw(b"\0\5\x9B")),
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("entropy/knots", KNOTS)
    yield from broken.cases("entropy/codebook", [r for r in LEVELS if r[1] == "QNT-003"])
    yield from broken.cases("entropy/levels", [r for r in LEVELS if r[1] != "QNT-003"])
    yield from broken.cases("entropy/raw", RAW)
