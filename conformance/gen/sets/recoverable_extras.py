"""Damage of what is not samples: digests, metadata, attachments, clocks (SPEC 11.3 to 11.6)."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator
from typing import Any

import forge as f
import wreck as w
from case import Case
from wreck import ALL, HEAD, THREE, Laid, wrecked

WHOLE = w.decoded(dict.fromkeys(range(3), ALL))


def digest(track: int, spans: Iterable[tuple[int, int]]) -> bytes:
    """SPEC 11.5."""
    ticks = [tick for start, stop in spans for tick in range(start, stop)]
    counts = struct.pack(f"<{len(ticks)}i", *(w.value(track, tick) for tick in ticks))
    rows = b"".join(struct.pack("<QQ", start, stop - start) for start, stop in spans)
    return hashlib.sha256(hashlib.sha256(counts).digest() + rows).digest()


DIGESTS = b"".join(digest(track, ALL) for track in range(3))
WRONG = DIGESTS[:32] + digest(1, [(0, 11)]) + DIGESTS[64:]
"""Of track 1 that of other samples."""


def digested(payload: bytes, *more: w.Chunk) -> Laid:
    return w.lay(HEAD, THREE, *more, *w.clusters(0, 4, 8), ("dGST", f.digests(payload)))


def bad(laid: Laid, type_: str, number: int = 0) -> w.Damage:
    place = laid.of(type_, number)
    return ("bad-payload", place.at, place.size)


def bad_chunk(laid: Laid, type_: str, number: int = 0) -> w.Damage:
    return ("bad-chunk", *bad(laid, type_, number)[1:])


def cases() -> Iterator[Case]:
    yield from digests()
    yield from metadata()
    yield from attachments()
    yield from attached_file()
    yield from nested()
    yield from clocks()
    yield from clocks_of_tracks()
    yield from unknown()
    yield from notes()


def digests() -> Iterator[Case]:
    laid = digested(WRONG)
    place = laid.of("dGST").payload + 33
    yield wrecked(
        "digest-differs", "A track decodes to other numbers than its digest says.",
        ["DGS-002", "REC-010"], "structure/digest", laid.data,
        damages=[("bad-digest", place, 32)], exits={"decode": [0, 3]},
    )  # fmt: skip
    laid = digested(WRONG, ("mETa", b'{"a":1}'))
    data = w.flip(laid.data, laid.of("mETa").payload + 2)
    yield wrecked(
        "digest-differs-and-damage", "A digest is compared in a file with damage elsewhere, too.",
        ["DGS-002", "REC-010"], "structure/digest", data,
        damages=[bad(laid, "mETa"), ("bad-digest", laid.of("dGST").payload + 33, 32)],
    )  # fmt: skip
    laid = digested(DIGESTS)
    row, place = laid.row(1, 4), laid.of("DATA", 1)
    kept: dict[int, w.Spans] = {0: ALL, 1: ((0, 4), (8, 12)), 2: ALL}
    yield wrecked(
        "digest-of-what-is-lost",
        "No digest is compared where a packet of its track is lost, and it is not copied.",
        ["DGS-002", "REC-010"], "transmission/bit-flip", w.flip(laid.data, row.at), kept=kept,
        damages=[("bad-payload", place.at, place.size), ("bad-packet", row.at, row.size)],
        lost=[(1, 4, 8)],
    )  # fmt: skip
    yield wrecked(
        "digest-chunk-damaged", "The chunk of digests is damaged: none is compared.",
        ["DGS-002", "REC-010"], "transmission/bit-flip",
        w.flip(laid.data, laid.of("dGST").payload + 40), damages=[bad(laid, "dGST")],
    )  # fmt: skip
    early = w.lay(
        HEAD, THREE, *w.clusters(0, 4),
        ("dGST", f.digests(*(digest(track, [(0, 8)]) for track in range(3)))),
        *w.clusters(8), close=False,
    )  # fmt: skip
    yield wrecked(
        "digest-before-packets", "A digest holds for the packets before it; recover leaves it out.",
        ["DGS-003", "REC-010"], "crash/not-closed", early.data,
        damages=[("not-closed", len(early.data), 0)], recover=0,
    )  # fmt: skip


def metadata() -> Iterator[Case]:
    laid = w.lay(
        HEAD, THREE, ("mETa", b'{"a":1,"b":2}'), *w.clusters(0, 4, 8), ("mETa", b'{"c":3}')
    )
    left = WHOLE | {"metadata": {"c": 3}}
    yield wrecked(
        "metadata-lost", "A chunk of metadata is damaged: its members are lost, not the others.",
        ["MET-001", "REC-010"], "transmission/bit-flip",
        w.flip(laid.data, laid.of("mETa").payload + 5), decode=left, damages=[bad(laid, "mETa")],
        recovered={"decode": WHOLE},
    )  # fmt: skip
    laid = w.lay(HEAD, THREE, ("mETa", b"{a:1}"), *w.clusters(0, 4, 8), ("mETa", b'{"c":3}'))
    yield wrecked(
        "metadata-broken-and-damage", "With damage, metadata that break a rule are left out.",
        ["MET-001", "REC-010"], "structure/metadata", laid.data + b"\0", decode=left,
        damages=[("garbage", len(laid.data), 1), bad_chunk(laid, "mETa")],
        recovered={"decode": WHOLE},
    )  # fmt: skip
    yield wrecked(
        "metadata-broken", "Metadata break a rule, nothing else is wrong: recover leaves them out.",
        ["MET-001", "REC-010"], "structure/metadata", laid.data, decode=WHOLE,
        damages=[], verdict="nonconforming", exits={"decode": [0, 2], "verify": 2},
    )  # fmt: skip


def file_of(name: str, content: bytes) -> w.Chunk:
    return ("aTTc", f.strings(name, "text/plain") + content)


def told(name: str, content: bytes) -> dict[str, Any]:
    return {
        "name": name, "media_type": "text/plain", "size": len(content),
        "sha256": hashlib.sha256(content).hexdigest(),
    }  # fmt: skip


def attached_file() -> Iterator[Case]:
    data = f.cluster((0, 0, 4, f.KNOT_DATA), file_id=9)
    other = f.file(HEAD, ("TRAK", f.trak()), ("DATA", data), file_id=9)
    laid = w.lay(HEAD, THREE, file_of("other.hapf", other), *w.clusters(0, 4, 8))
    yield wrecked(
        "head-lost-before-an-attached-file",
        "The header of HEAD is damaged: HEAD of an attached file does not take its place.",
        ["CHK-004", "REC-001", "HED-001"], "transmission/bit-flip", w.flip(laid.data, 8 + 28),
        decode=WHOLE | {"attachments": [told("other.hapf", other)]},
        damages=[
            ("garbage", 8, laid.of("HEAD").size), ("missing-chunk", laid.of("TRAK").at, 0),
            ("missing-head", 8, 0),
        ],
    )  # fmt: skip


def attachments() -> Iterator[Case]:
    laid = w.lay(HEAD, THREE, file_of("a", b"one"), *w.clusters(0, 4, 8), file_of("b", b"two"))
    yield wrecked(
        "attachment-lost", "An attachment is damaged, another one is kept.",
        ["CHK-003", "REC-010"], "transmission/bit-flip",
        w.flip(laid.data, laid.of("aTTc").stop - 1),
        decode=WHOLE | {"attachments": [told("b", b"two")]}, damages=[bad(laid, "aTTc")],
    )  # fmt: skip
    laid = w.lay(
        HEAD, THREE, ("aTTc", f.strings("", "text/plain") + b"x"), *w.clusters(0, 4, 8),
        file_of("b", b"two"),
    )  # fmt: skip
    yield wrecked(
        "attachment-broken-and-damage",
        "In a file with damage an attachment without a name is left out.",
        ["ATT-001", "REC-010"], "structure/attachment", laid.data + b"\0",
        decode=WHOLE | {"attachments": [told("b", b"two")]},
        damages=[("garbage", len(laid.data), 1), bad_chunk(laid, "aTTc")],
    )  # fmt: skip


def nested() -> Iterator[Case]:
    """A file within an attachment is content, until the attachment is damaged."""
    inner = w.lay(HEAD, ("TRAK", f.trak()), [w.packet(0, 100)], close=False)
    outer = [HEAD, THREE, *w.clusters(0)]
    laid = w.lay(*outer, ("aTTc", f.strings("a", "") + inner.data), *w.clusters(4, 8))
    place = laid.of("aTTc")
    decode = WHOLE | {"attachments": []}
    yield wrecked(
        "file-within-flip",
        "In an attachment whose CRC differs is a file with the same file id: not looked at.",
        ["CHK-004", "REC-002"], "transmission/bit-flip", w.flip(laid.data, place.stop - 1),
        decode=decode, damages=[bad(laid, "aTTc")],
    )  # fmt: skip
    begin = place.payload + 3 - 1
    yield wrecked(
        "file-within-lost-byte",
        "The attachment has lost a byte: the chunks of the attached file have numbers that there "
        "were, and are not used.",
        ["CHK-005", "REC-002"], "transmission/lost-bytes", w.without(laid.data, place.payload),
        decode=decode,
        damages=[
            bad(laid, "aTTc"),
            *[("duplicate-chunk", begin + each.at, each.size) for each in inner.places],
        ],
    )  # fmt: skip
    data = f.cluster(w.packet(0, 100), file_id=9)
    track, meta = ("TRAK", f.trak()), ("mETa", b'{"a":1}')
    content = f.strings("a", "") + f.file(HEAD, track, ("DATA", data), meta, file_id=9)
    laid = w.lay(*outer, ("aTTc", content), *w.clusters(4, 8))
    place = laid.of("aTTc")
    yield wrecked(
        "other-file-within-lost-byte",
        "The attachment has lost a byte: chunks of an attached file with another id are none.",
        ["CHK-004", "REC-002"], "transmission/lost-bytes", w.without(laid.data, place.payload),
        decode=decode | {"metadata": None}, damages=[bad(laid, "aTTc")],
        recovered={"decode": decode},
    )  # fmt: skip

    yield wrecked(
        "attached-head-is-no-head",
        "The header of HEAD is damaged: the file id is not that of a file in an intact attachment.",
        ["CHK-004", "REC-002"], "transmission/bit-flip", w.flip(laid.data, 8 + 20),
        decode=WHOLE,
        damages=[
            ("garbage", 8, laid.of("HEAD").size), ("missing-chunk", laid.of("TRAK").at, 0),
            ("missing-head", 8, 0),
        ],
    )  # fmt: skip


def clocks() -> Iterator[Case]:
    seen = [(0, 1000, 5), (10, 11_000, 5)]
    points = [(0, 0), (1000, 999_999)]
    laid = w.lay(
        HEAD, THREE, ("cLOk", f.clock(seen, track=0)), *w.clusters(0, 4, 8),
        ("cLOk", f.clock(seen[:1], "UTC")), ("cMAp", f.clock_map(points)),
    )  # fmt: skip
    pc = {"track": 0, "name": "pc", "observations": [[0, "1000", "5"], [10, "11000", "5"]]}
    utc = {"track": None, "name": "UTC", "observations": [[0, "1000", "5"]]}
    line = {"track": None, "name": "pc", "points": [[0, "0"], [1000, "999999"]]}
    yield wrecked(
        "clock-lost", "A chunk of observations is damaged; others and the map are kept.",
        ["CLK-001", "REC-010"], "transmission/bit-flip",
        w.flip(laid.data, laid.of("cLOk").stop - 1),
        decode=WHOLE | {"clocks": [utc], "maps": [line]}, damages=[bad(laid, "cLOk")],
    )  # fmt: skip
    yield wrecked(
        "map-lost", "A map is damaged; the observations are kept.",
        ["CLK-001", "REC-010"], "transmission/bit-flip",
        w.flip(laid.data, laid.of("cMAp").stop - 1),
        decode=WHOLE | {"clocks": [pc, utc], "maps": []}, damages=[bad(laid, "cMAp")],
    )  # fmt: skip


def clocks_of_tracks() -> Iterator[Case]:
    first, second = ("TRAK", f.trak()), ("TRAK", f.trak(first_channel=1, first=1))
    seen = [(0, 1000, 5)]
    laid = w.lay(
        HEAD, first, second, *w.clusters(0, 4, 8, tracks=2), ("cLOk", f.clock(seen, track=1)),
        ("cLOk", f.clock(seen, track=0)),
    )  # fmt: skip
    rows = [laid.row(1, start) for start in (0, 4, 8)]
    yield wrecked(
        "clock-of-a-lost-track", "Observations in ticks of a track that has lost its description.",
        ["CLK-005", "REC-010"], "transmission/bit-flip",
        w.flip(laid.data, laid.of("TRAK", 1).payload + 5), lost=[(1, 0, 12)],
        decode=w.decoded({0: ALL}) | {
            "clocks": [{"track": 0, "name": "pc", "observations": [[0, "1000", "5"]]}],
        },
        damages=[
            bad(laid, "TRAK", 1), bad_chunk(laid, "cLOk"),
            *[("bad-packet", row.at, row.size) for row in rows],
        ],
    )  # fmt: skip


def unknown() -> Iterator[Case]:
    """Ancillary chunks: of a small fourth letter those that are safe to copy."""
    more: list[w.Chunk] = [("abcd", b"safe"), ("abcD", b"unsafe"), ("aBcd", b"private, safe")]
    laid = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), *more)
    told = [[place.type, place.at] for place in laid.places if place.type.lower() == "abcd"]
    whole = WHOLE | {"unknown": told}
    yield wrecked(
        "unknown-chunks-and-damage",
        "From a file with damage unknown ancillary chunks come along if they are safe to copy.",
        ["CHK-010", "REC-010"], "transmission/added-bytes", laid.data + b"\0", decode=whole,
        damages=[("garbage", len(laid.data), 1)],
        recovered={"decode": WHOLE, "unknown": ["aBcd", "abcd"]},
    )  # fmt: skip
    bare = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), *more, close=False)
    told = [[place.type, place.at] for place in bare.places if place.type.lower() == "abcd"]
    yield wrecked(
        "unknown-chunks-not-closed",
        "A file that was not closed is none with damage: all unknown ancillary chunks come along.",
        ["CHK-010", "REC-010"], "crash/not-closed", bare.data, decode=WHOLE | {"unknown": told},
        damages=[("not-closed", len(bare.data), 0)], recover=0,
        recovered={"decode": WHOLE, "unknown": ["aBcd", "abcD", "abcd"]},
    )  # fmt: skip


def notes() -> Iterator[Case]:
    laid = w.lay(HEAD, THREE, ("mETa", b'{"a":1,"notes":["old"]}'), *w.clusters(0, 4, 8))
    row, place = laid.row(1, 4), laid.of("DATA", 1)
    kept: dict[int, w.Spans] = {0: ALL, 1: ((0, 4), (8, 12)), 2: ALL}
    yield wrecked(
        "notes", "What was lost is noted in the metadata, after the notes that were there.",
        ["REC-010"], "transmission/bit-flip", w.flip(laid.data, row.at), kept=kept,
        damages=[("bad-payload", place.at, place.size), ("bad-packet", row.at, row.size)],
        lost=[(1, 4, 8)],
        recovered={"decode": w.decoded(kept) | {"metadata": {"a": 1}}, "notes": 2},
    )  # fmt: skip
