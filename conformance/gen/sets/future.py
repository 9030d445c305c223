"""SPEC 5.1 to 6.3: what later versions may bring, and what a reader of this one makes of it.

A file that needs what is unknown is unsupported; what it can do without is read on.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import forge as f
from broken import DATA, FIVES, HEAD, TRACK, needs, series
from case import DAMAGED, INTACT, UNSUPPORTED, Case, numbers

WORDS = {INTACT: "intact", DAMAGED: "damaged", UNSUPPORTED: "unsupported"}
BAD = ("aaaa", b"", {"crc": 1})
"""A chunk whose payload is damaged."""

UNKNOWN = ("NEWC", b"abc")
CONSTANT = f.KNOT_DATA
TWICE = f.cluster((0, 0, 4, CONSTANT), (0, 0, 4, CONSTANT))
LATER = ("DATA", f.cluster((0, 4, 4, CONSTANT)))


def headed(*more: Any, tlvs: bytes = b"", data: Any = DATA, **fields: int) -> bytes:
    return f.closed(("HEAD", f.head(tlvs, **fields)), TRACK, data, *more)


def tlvs(*types: int) -> bytes:
    return b"".join(f.tlv(type_, b"abc") for type_ in types)


VERSIONS = [
    ("major-2", "VER-001", "The major version is 2.", headed(major=2)),
    ("major-0", "VER-001", "The major version is 0.", headed(major=0)),
    ("major-255-and-another-head", "VER-001",
     "Another major version, with another level, file id and reserved byte.",
     headed(major=255, level=9, reserved=1)),
    ("major-2-of-other-chunks", "VER-001", "Another major version, with empty chunks.",
     f.file(("HEAD", f.head(major=2)), ("TRAK", b""), ("iNDX", b""), ("fOOT", b""))),
    ("major-2-and-a-short-head", "VER-001", "Another major version, with a HEAD of 8 bytes.",
     f.file(("HEAD", f.head(major=2)[:8]), TRACK, DATA, ("fOOT", b""))),
    ("incompat-and-a-short-head", "VER-001", "An unknown feature, with a HEAD of 8 bytes.",
     f.file(("HEAD", f.head(incompat=1)[:8]), TRACK, DATA, ("fOOT", b""))),
    ("level-3-and-a-short-head", "HED-004", "Level 3, with a HEAD of 3 bytes.",
     f.file(("HEAD", f.head(level=3)[:3]), TRACK, DATA, ("fOOT", b""))),
    ("head-tlv-and-a-reserved-byte", "TLV-003", "A critical TLV in HEAD, and a reserved byte of 1.",
     f.file(("HEAD", f.head(f.tlv(1, b""), reserved=1)), TRACK, DATA)),
    ("incompat-bit-0", "VER-001", "Bit 0 of incompat is set.", headed(incompat=1)),
    ("incompat-bit-31", "VER-001", "Bit 31 of incompat is set.", headed(incompat=2**31)),
    ("incompat-and-a-broken-rule", "VER-001", "With an unknown feature packets overlap.",
     headed(incompat=4, data=("DATA", TWICE))),
    ("incompat-and-damage", "VER-001", "With an unknown feature the CRC of a payload differs.",
     headed(BAD, incompat=1)),
    ("level-0", "HED-004", "The level is 0.", headed(level=0)),
    ("level-3", "HED-004", "The level is 3.", headed(level=3)),
    ("head-tlv-1", "TLV-003", "HEAD carries an unknown critical TLV of type 1.",
     headed(tlvs=tlvs(1))),
    ("head-tlv-32769", "TLV-003", "HEAD carries a private critical TLV.",
     headed(tlvs=tlvs(0x8001))),
    ("head-tlv-3-behind-another", "TLV-003", "A critical TLV of HEAD follows an ancillary one.",
     headed(tlvs=tlvs(2, 3))),
]  # fmt: skip

CHUNKS = [
    *[(f"critical-chunk-{name}", "CHK-009", f"There is a chunk {type_}.",
       f.minimal((type_, b"abc")))
      for name, type_ in [("public", "NEWC"), ("private", "NeWC"), ("safe-to-copy", "NEWc"),
                          ("reserved", "NEwC")]],
    ("critical-chunk-before-tracks", "CHK-009", "An unknown critical chunk follows HEAD.",
     f.closed(HEAD, UNKNOWN, TRACK, DATA)),
    ("critical-chunk-of-a-track", "CHK-009", "An unknown critical chunk speaks of track 0.",
     f.minimal((*UNKNOWN, {"track": 0}))),
    ("critical-chunk-like-data", "CHK-007", "A chunk is called DAtA.",
     f.minimal(("DAtA", LATER[1]))),
    ("data-flag-0", "CHK-007", "A DATA chunk has the critical flag bit 0.",
     f.minimal((*LATER, {"flags": 1}), data_count=1)),
    ("data-flag-7", "CHK-007", "A DATA chunk has the critical flag bit 7.",
     f.minimal((*LATER, {"flags": 128}), data_count=1)),
    ("track-flag-1", "CHK-007", "A TRAK chunk has the critical flag bit 1.",
     f.minimal(("TRAK", f.trak(first_channel=1), {"track": 1, "flags": 2}), track_count=1)),
    ("critical-chunk-with-flags", "CHK-009", "An unknown critical chunk has all flag bits.",
     f.minimal((*UNKNOWN, {"flags": 0xFFFF}))),
]  # fmt: skip


def beside(payload: bytes, packet: bytes = b"abc", *, start: int = 0, kind: int = 0) -> bytes:
    """Track 0 as usual, and another one with a packet."""
    cluster = f.cluster((0, 0, 4, CONSTANT), (1, start, 4, packet))
    duration_ns = (start + 4) * 1_000_000
    return series(
        (f.trak(kind=kind), 0), (payload, 1), data=("DATA", cluster), duration_ns=duration_ns
    )


def other(more: bytes = b"", **fields: Any) -> bytes:
    return f.trak(f.tlv(1, b"abc") + more, **({"first_channel": 1} | fields))


CODECS = [
    *[(f"codec-{codec.lower()}", "TRK-011", f"A track has the codec {codec}.",
       beside(other(codec=codec.encode())))
      for codec in ("NEWC", "xabc")],
    ("codec-alone", "TRK-011", "The only track has the codec NEWC.",
     series((f.trak(codec=b"NEWC"), 0))),
    ("codec-without-packets", "TRK-011", "A track of the codec NEWC has no packets.",
     series((f.trak(), 0), (other(codec=b"NEWC"), 1))),
    ("codec-in-a-chunk", "TRK-011", "The second track of a chunk has the codec NEWC.",
     f.closed(HEAD, ("TRAK", f.trak() + other(codec=b"NEWC")[1:], {"track": 0}),
              ("DATA", f.cluster((0, 0, 4, CONSTANT), (1, 0, 4, b"abc"))))),
    ("codec-of-hf", "TRK-011", "An HF track has the codec NEWC.",
     beside(other(codec=b"NEWC", kind=2, base=0, first_channel=0), kind=1)),
    ("codec-that-continues", "TRK-011", "A track of the codec NEWC continues one of KNOT.",
     beside(other(continues=0, codec=b"NEWC", first_channel=0), start=4)),
]  # fmt: skip

TRACKS = [
    *[(f"kind-{kind}", "TRK-011", f"A track is of kind {kind}.", beside(other(kind=kind)))
      for kind in (4, 255)],
    *[(f"number-format-{number}", "TRK-011", f"A track has the number format {number}.",
       beside(other(number_format=number, count_min=0, count_max=0)))
      for number in (6, 255)],
    *[(f"track-tlv-{type_}", "TLV-003", f"A track carries a critical TLV of type {type_}.",
       beside(f.trak(f.HOLD + tlvs(type_), first_channel=1), CONSTANT))
      for type_ in (5, 13, 0x8001, 0xFFFF)],
]  # fmt: skip

SEVERAL = [
    ("critical-chunk-and-a-broken-rule", "CHK-009",
     "With an unknown critical chunk the metadata are no JSON.",
     f.minimal(UNKNOWN, ("mETa", b"{")), UNSUPPORTED),
    ("codec-and-a-broken-rule", "TRK-011",
     "With a track of the codec NEWC the metadata are no JSON.",
     f.minimal(("TRAK", other(codec=b"NEWC"), {"track": 1}), ("mETa", b"{")), UNSUPPORTED),
    ("critical-chunk-and-damage", "CHK-009",
     "With an unknown critical chunk the CRC of a payload differs, which counts first.",
     f.minimal(UNKNOWN, BAD), DAMAGED),
    ("codec-and-damage", "TRK-011",
     "With a track of the codec NEWC the CRC of a payload differs, which counts first.",
     f.minimal(("TRAK", other(codec=b"NEWC"), {"track": 1}), BAD), DAMAGED),
]  # fmt: skip


def skipped(type_: str, payload: bytes = b"abc", **given: int) -> tuple[bytes, dict[str, Any]]:
    """An unknown ancillary chunk, and how it is listed."""
    data = f.minimal((type_, payload, given))
    return data, {"unknown": [[type_, data.index(type_.encode()) - 4]]}


ANCILLARY = {"flags": 0xFF00}
READ_ON = [
    ("later-minor-version", "VER-001",
     "Minor version 255, all compatible features, ancillary TLVs in HEAD.",
     headed(minor=255, compat=2**32 - 1, tlvs=tlvs(2, 0x8000)), {}),
    *[(f"ancillary-chunk-{name}", "CHK-010", f"There is a chunk {type_}.", *skipped(type_))
      for name, type_ in [("public", "nEWc"), ("private", "neWc"), ("unsafe-to-copy", "nEWC"),
                          ("reserved", "nEwc")]],
    ("metadata-flag-0", "CHK-007", "Metadata with a critical flag bit are an unknown chunk.",
     *skipped("mETa", b"no JSON", flags=1)),
    ("attachment-flag-7", "CHK-007", "An attachment with a critical flag bit is unknown.",
     *skipped("aTTc", b"", flags=128)),
    ("ancillary-flags", "CHK-007", "HEAD, TRAK and DATA have all ancillary flag bits.",
     f.closed((*HEAD, ANCILLARY), (*TRACK[:2], {"track": 0} | ANCILLARY), (*DATA, ANCILLARY)),
     {"unknown": []}),
    ("metadata-ancillary-flag", "CHK-007", "Metadata have the flag bit 15.",
     f.minimal(("mETa", b'{"a":1}', {"flags": 1 << 15})), {"metadata": {"a": 1}}),
    ("track-ancillary-tlvs", "TLV-003", "A track carries ancillary TLVs, known by no reader yet.",
     series((f.trak(f.HOLD + tlvs(20, 24, 0x8000)), 0)), {}),
]  # fmt: skip


def sampled(rule: str, code: int) -> int | list[int]:
    """Exit codes of ``decode``, which may have given samples of the tracks that are known."""
    return [DAMAGED, UNSUPPORTED] if code == DAMAGED and rule == "TRK-011" else UNSUPPORTED


def unsupported(fault: str, rows: list[tuple], recover: int) -> Iterator[Case]:
    for name, rule, about, data, *codes in rows:
        code = codes[0] if codes else UNSUPPORTED
        expect: dict[str, Any] = {
            "needs": needs(data),
            "exit": {"decode": sampled(rule, code), "verify": code, "recover": recover},
            "verdict": WORDS[code],
            "verify": {"requirement": ["CHK-003"] if code == DAMAGED else [rule, "CHK-009"]},
        }
        if fault in ("codec", "track"):
            known = [FIVES] if b"KNOT" in data else []
            spans = [] if name == "codec-of-hf" else FIVES["spans"]
            channel = {"channel": 0, "spans": spans, "numbers": numbers([5] * 4 if spans else [])}
            expect["decode"] = {"tracks": known, "channels": [channel] if known else []}
        if fault != "head":
            expect["recover"] = {"verdict": "unsupported", "decode": {}}
        touched = [rule, "VRD-001"] if fault == "several" else [rule]
        yield Case("future", name, about, touched, data, expect, f"version/{fault}")


def cases() -> Iterator[Case]:
    yield from unsupported("head", VERSIONS, UNSUPPORTED)
    yield from unsupported("chunk", CHUNKS, UNSUPPORTED)
    yield from unsupported("codec", CODECS, UNSUPPORTED)
    yield from unsupported("track", TRACKS, UNSUPPORTED)
    yield from unsupported("several", SEVERAL, DAMAGED)
    for name, rule, about, data, more in READ_ON:
        expect = {
            "needs": needs(data),
            "exit": {"decode": INTACT, "verify": INTACT},
            "verdict": "intact",
            "decode": {"tracks": [FIVES]} | more,
            "verify": {"damages": [], "lost": []},
        }
        yield Case("future", name, about, [rule], data, expect)
