"""Metadata, attachments, digests, and chunks of unknown types (SPEC 5.2, 11.3 to 11.5)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import partial
from typing import Any

import forge as f
from case import Case
from facts import Packet, Track, case_of, digest, recording
from page_exact import bits as bits_of_value
from page_exact import value

from sets.valid_bands import FAST, SLOW, hf, lf, stored

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

FIVES = Track(packets=[Packet(0, [5] * 4, f.KNOT_DATA)])


def cases() -> Iterator[Case]:
    yield from metadata()
    yield from attachments()
    yield from digests()
    yield from unknown()


def json(text: str) -> tuple[str, bytes]:
    return "mETa", text.encode()


def metadata() -> Iterator[Case]:
    text = '\n{"subject": "S1", "µ" : [1, -2.5, true, null, {}], "e": {"x": ""}}\t'
    yield valid(
        "metadata", "One JSON object: texts, numbers, lists, objects, and white space.",
        ["MET-001"],
        FIVES,
        file={"more": [json(text)]},
        metadata={"subject": "S1", "µ": [1, -2.5, True, None, {}], "e": {"x": ""}},
    )  # fmt: skip
    yield valid(
        "metadata-replaced", "Members of later chunks replace those of the same name, whole.",
        ["MET-001"],
        FIVES,
        file={
            "before": [json('{"a": 1, "b": {"c": 2}, "d": 3}')],
            "more": [json('{"b": {"e": 4}, "d": null}'), json("{}")],
        },
        metadata={"a": 1, "b": {"e": 4}, "d": None},
    )  # fmt: skip
    yield valid(
        "metadata-escapes", "Escaped characters, a pair of surrogates among them.", ["MET-001"],
        FIVES, file={"more": [json(r'{"\u0061\n": "\ud83d\ude42\/\\\"\u00b5"}')]},
        metadata={"a\n": '🙂/\\"µ'},
    )  # fmt: skip
    yield uncommon(
        "metadata-numbers", "Integers of 30 digits, exponents, minus zero, and a number near 0.",
        ["MET-001"],
        FIVES,
        file={"more": [json('{"a": [123456789012345678901234567890, 1E+2, -0, -0.0, 1e-400]}')]},
        metadata={"a": [123456789012345678901234567890, 100.0, 0, 0.0, 0.0]},
    )  # fmt: skip
    yield uncommon(
        "metadata-empty", "An empty object is metadata too.", ["MET-001"],
        FIVES, file={"more": [json("{}")]}, metadata={},
    )  # fmt: skip
    deep = "[" * 63 + "]" * 63
    nested: Any = []
    for _ in range(62):
        nested = [nested]
    yield uncommon(
        "metadata-deep", "Nested 64 deep.", ["MET-001"],
        FIVES, file={"more": [json(f'{{"x": {deep}}}')]}, metadata={"x": nested},
    )  # fmt: skip


def attachment(name: str, media_type: str, content: bytes) -> tuple[str, bytes]:
    return "aTTc", f.strings(name, media_type) + content


def told(name: str, media_type: str, content: bytes) -> dict[str, Any]:
    return {
        "name": name, "media_type": media_type, "size": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }  # fmt: skip


def attachments() -> Iterator[Case]:
    files = [("notes.txt", "text/plain", b"by hand\n"), ("µ", "", b""),
             ("b.bin", "application/octet-stream", bytes(range(256)))]  # fmt: skip
    yield valid(
        "attachments", "Three files, one of them without content and without a media type.",
        ["ATT-001"],
        FIVES, file={"more": [attachment(*each) for each in files]},
        attachments=[told(*each) for each in files],
    )  # fmt: skip
    twice = [
        ("a.txt", "", b"1"),
        ("a.txt", "text/plain", b"2"),
        ("../" + 62 * "🙂" + "/..", "", b"3"),
    ]
    yield uncommon(
        "attachments-names", "Two files of one name, and a name of 254 bytes that is no path.",
        ["ATT-001"],
        FIVES, file={"more": [attachment(*each) for each in twice]},
        attachments=[told(*each) for each in twice],
    )  # fmt: skip
    inner = Track(packets=[Packet(0, [9] * 8, f.svarint(9))])
    for name, file_id in (("same-id", f.FILE_ID), ("other-id", 99)):
        nested = recording(inner)
        if file_id != f.FILE_ID:
            nested = renamed(inner, file_id)
        yield valid(
            f"attachment-hapf-{name}",
            "A file within the file, with the same file id as this one: its chunks are content."
            if file_id == f.FILE_ID
            else "A file within the file, with a file id of its own: its chunks are content.",
            ["CHK-004", "REC-005", "ATT-001"],
            FIVES, file={"before": [attachment("a.hapf", "haptics/vnd.hapf", nested)]},
            attachments=[told("a.hapf", "haptics/vnd.hapf", nested)],
        )  # fmt: skip
    sync = (f.SYNC + b"DATA") * 40 + f.SYNC[:3]
    yield uncommon(
        "attachment-of-sync-words", "Sync words and types in a row, no header among them.",
        ["CHK-002"],
        FIVES, file={"before": [attachment("s", "", sync)]}, attachments=[told("s", "", sync)],
    )  # fmt: skip


def renamed(track: Track, file_id: int) -> bytes:
    packets = ((0, p.start, p.span, p.body) for p in track.packets)
    data = f.cluster(*packets, file_id=file_id)
    return f.file(("HEAD", f.head()), track.chunk, ("DATA", data), file_id=file_id)


def dgst(*digests: bytes, track: int = 0) -> f.Chunk:
    return "dGST", f.digests(*digests, first=track)


def digests() -> Iterator[Case]:
    gaps = Track(
        packets=[Packet(2, [5] * 4, f.svarint(5)), Packet(6, [-1] * 2, f.svarint(-1)),
                 Packet(9, [7], f.svarint(7))],
    )  # fmt: skip
    yield valid(
        "digest", "The digest of a track: its counts as i32, and two maximal spans.", ["DGS-002"],
        gaps, file={"more": [dgst(digest(gaps))]},
    )  # fmt: skip
    pair = Track(width=2, packets=[Packet(0, [(1, -2)] * 3, f.svarint(1) + f.svarint(-2))])
    yield valid(
        "digest-components", "Tick by tick, within a tick component by component.", ["DGS-002"],
        pair, file={"more": [dgst(digest(pair))]},
    )  # fmt: skip
    slow, fast = lf(stored(0, SLOW)), hf(stored(0, FAST))
    last = Track(id=2, channel=1, packets=[Packet(0, [3] * 3, f.svarint(3))])
    yield valid(
        "digest-bands", "One chunk with the digests of LF, HF and another track.",
        ["DGS-001", "DGS-002"],
        slow, fast, last, file={"more": [dgst(digest(slow), digest(fast), digest(last))]},
    )  # fmt: skip
    for size, name, rows in (
        (2, "binary16", [1, 2**16 - 1]), (4, "binary32", [1, 2**32 - 1]),
        (8, "binary64", [1, 2**64 - 1]), (8, "int64", [1, 2**63]),
    ):  # fmt: skip
        words = Track(
            codec="RAWB", parameters=f.raw_parameters(size), number_format=name,
            packets=[stored(0, rows, size)],
        )  # fmt: skip
        yield valid(
            f"digest-{name}", "The digest of words, each of its own size.", ["DGS-002"],
            words, file={"more": [dgst(digest(words))]},
        )  # fmt: skip
    exact = bytes.fromhex("0C 00 00 00 0D 1E 00 01 A3 57 66 5B 00")
    counts = [1, 2, 3, 3, 7, 3]
    tenths = Track(
        codec="LPCX", parameters=f.lpcx_parameters(), tlvs=f.tlv(3, f.calibration(1, 0, 10)),
        calibration=(1, 0, 10),
        packets=[
            Packet(0, counts, exact,
                   exact=[bits_of_value(value(c, 1, 0, 10, 0, 0)) % 2**64 for c in counts]),
        ],
    )  # fmt: skip
    yield valid(
        "digest-exact", "With LPCX the exact values are in the digest, not the counts.",
        ["DGS-002"],
        tenths, file={"more": [dgst(digest(tenths))]},
    )  # fmt: skip
    silent = Track()
    yield uncommon(
        "digest-of-nothing", "The digest of a track without packets.", ["DGS-002"],
        silent, file={"more": [dgst(digest(silent))]},
    )  # fmt: skip


def unknown() -> Iterator[Case]:
    first = recording(FIVES)
    at = first.index(f.SYNC + b"DATA")
    yield valid(
        "unknown-ancillary", "Unknown ancillary chunks, public and private ones, are skipped.",
        ["CHK-010"],
        FIVES,
        file={"before": [("abCd", b"?"), ("abCD", b""), ("aBCd", f.SYNC * 3)]},
        unknown=[["abCd", at], ["abCD", at + f.HEADER + 1], ["aBCd", at + 2 * f.HEADER + 1]],
    )  # fmt: skip
    yield uncommon(
        "unknown-small-third-letter", "A small third letter of an unknown ancillary chunk.",
        ["CHK-010"],
        FIVES, file={"before": [("abcd", b"?")]}, unknown=[["abcd", at]],
    )  # fmt: skip
