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
     "Another major version, with another level and TLVs that are none.",
     headed(major=255, level=9, tlvs=b"\4\1")),
    ("major-2-of-other-chunks", "VER-001", "Another major version, with empty chunks.",
     f.file(("HEAD", f.head(major=2)), ("TRAK", b""), ("iNDX", b""), ("fOOT", b""))),
    ("major-2-and-a-short-head", "VER-001", "Another major version, with a HEAD of one byte.",
     f.file(("HEAD", f.head(major=2)[:1]), TRACK, DATA, ("fOOT", b""))),
    ("major-2-and-a-broken-rule", "VER-001", "With another major version packets overlap.",
     headed(major=2, data=("DATA", TWICE))),
    ("major-2-and-damage", "VER-001", "With another major version the CRC of a payload differs.",
     headed(BAD, major=2)),
    ("level-3-and-a-broken-head", "HED-004", "Level 3, and a TLV that HEAD ends within.",
     f.file(("HEAD", f.head(b"\2", level=3)), TRACK, DATA, ("fOOT", b""))),
    ("head-tlv-and-a-broken-rule", "TLV-003", "With a critical TLV in HEAD packets overlap.",
     headed(tlvs=tlvs(1), data=("DATA", TWICE))),
    ("head-tlv-and-damage", "TLV-003", "With a critical TLV in HEAD a payload CRC differs.",
     headed(BAD, tlvs=tlvs(1))),
    ("level-0", "HED-004", "The level is 0.", headed(level=0)),
    ("level-3", "HED-004", "The level is 3.", headed(level=3)),
    ("head-tlv-1", "TLV-003", "HEAD carries an unknown critical TLV of type 1.",
     headed(tlvs=tlvs(1))),
    ("head-tlv-32769", "TLV-003", "HEAD carries a private critical TLV.",
     headed(tlvs=tlvs(0x8001))),
    ("head-tlv-3-behind-another", "TLV-003", "A critical TLV of HEAD follows an ancillary one.",
     headed(tlvs=tlvs(0, 3))),
    ("head-tlv-65535", "TLV-003", "HEAD carries a critical TLV of the largest type.",
     headed(tlvs=f.epoch(0, 0) + tlvs(0xFFFF))),
]  # fmt: skip

CHUNKS = [
    *[(f"critical-chunk-{name}", "CHK-009", f"There is a chunk {type_}.",
       f.minimal((type_, b"abc")))
      for name, type_ in [("public", "NEWC"), ("private", "NeWC"), ("safe-to-copy", "NEWc"),
                          ("reserved", "NEwC")]],
    ("critical-chunk-before-tracks", "CHK-009", "An unknown critical chunk follows HEAD.",
     f.closed(HEAD, UNKNOWN, TRACK, DATA)),
    ("critical-chunk-like-data", "CHK-009", "A chunk is called DAtA.",
     f.minimal(("DAtA", LATER[1]))),
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
     f.closed(HEAD, ("TRAK", f.trak() + other(codec=b"NEWC")[2:]),
              ("DATA", f.cluster((0, 0, 4, CONSTANT), (1, 0, 4, b"abc"))))),
    ("codec-of-hf", "TRK-011", "An HF track has the codec NEWC.",
     beside(other(codec=b"NEWC", kind=2, base=0, first_channel=0), kind=1)),
    ("codec-that-continues", "TRK-011", "A track of the codec NEWC continues one of KNOT.",
     beside(other(continues=0, codec=b"NEWC", first_channel=0), start=4)),
]  # fmt: skip

TRACKS = [
    *[(f"kind-{kind}", "TRK-011", f"A track is of kind {kind}.", beside(other(kind=kind)))
      for kind in (4, 15)],
    *[(f"number-format-{number}", "TRK-011", f"A track has the number format {number}.",
       beside(other(number_format=number, count_min=0, count_max=0)))
      for number in (6, 15)],
    *[(f"track-tlv-{type_}", "TLV-003", f"A track carries a critical TLV of type {type_}.",
       beside(f.trak(f.HOLD + tlvs(type_), first_channel=1), CONSTANT))
      for type_ in (7, 13, 0x8001, 0xFFFF)],
]  # fmt: skip

SEVERAL = [
    ("critical-chunk-and-a-broken-rule", "CHK-009",
     "With an unknown critical chunk the metadata are no JSON.",
     f.minimal(UNKNOWN, ("mETa", b"{")), UNSUPPORTED),
    ("codec-and-a-broken-rule", "TRK-011",
     "With a track of the codec NEWC the metadata are no JSON.",
     f.minimal(("TRAK", other(codec=b"NEWC", first=1)), ("mETa", b"{")), UNSUPPORTED),
    ("critical-chunk-and-damage", "CHK-009",
     "With an unknown critical chunk the CRC of a payload differs, which counts first.",
     f.minimal(UNKNOWN, BAD), DAMAGED),
    ("codec-and-damage", "TRK-011",
     "With a track of the codec NEWC the CRC of a payload differs, which counts first.",
     f.minimal(("TRAK", other(codec=b"NEWC", first=1)), BAD), DAMAGED),
]  # fmt: skip


def skipped(type_: str, payload: bytes = b"abc") -> tuple[bytes, dict[str, Any]]:
    """An unknown ancillary chunk, and how it is listed."""
    data = f.minimal((type_, payload))
    return data, {"unknown": [[type_, data.index(type_.encode()) - 4]]}


READ_ON = [
    ("later-minor-version", "VER-001", "Minor version 255, ancillary TLVs in HEAD.",
     headed(minor=255, tlvs=tlvs(0, 8, 0x8000)), {}),
    *[(f"ancillary-chunk-{name}", "CHK-010", f"There is a chunk {type_}.", *skipped(type_))
      for name, type_ in [("public", "nEWc"), ("private", "neWc"), ("unsafe-to-copy", "nEWC"),
                          ("reserved", "nEwc")]],
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
