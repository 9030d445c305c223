"""Damage between and around chunks: what SPEC 14.1, procedure walk, makes of it."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
import wreck as w
from case import Case
from wreck import ALL, HEAD, OPEN, STEADY, THREE, wrecked

DATA = STEADY.data
FIRST, SECOND, THIRD = (STEADY.of("DATA", number) for number in range(3))
INDEX = STEADY.of("iNDX")
HEAD_PLACE, TRAK_PLACE = STEADY.of("HEAD"), STEADY.of("TRAK")

NO_SECOND = dict.fromkeys(range(3), ((0, 4), (8, 12)))
LOST_SECOND = [(track, 4, 8) for track in range(3)]


def cases() -> Iterator[Case]:
    yield from fronts()
    yield from heads()
    yield from between()
    yield from headers()
    yield from repeats()
    yield from missing()
    yield from orders()


def fronts() -> Iterator[Case]:
    yield wrecked(
        "signature-flip", "A bit of the signature is wrong; nothing is lost.",
        ["FIL-001"], "transmission/bit-flip", w.flip(DATA, 1),
        damages=[("bad-signature", 0, 8), ("garbage", 0, 8)], recover=0,
    )  # fmt: skip
    yield wrecked(
        "signature-gone", "The file begins with the header of HEAD.",
        ["FIL-001", "FIL-002"], "transmission/lost-bytes", w.without(DATA, 0, 8),
        damages=[("bad-signature", 0, 8)], recover=0,
    )  # fmt: skip
    yield wrecked(
        "first-byte-gone", "The first byte is missing.",
        ["FIL-001", "FIL-002"], "transmission/lost-bytes", w.without(DATA, 0),
        damages=[("bad-signature", 0, 8), ("garbage", 0, 7)], recover=0,
    )  # fmt: skip
    yield wrecked(
        "text-in-front", "A line of text is before the signature.",
        ["FIL-001", "REC-002"], "transmission/added-bytes", b"HTTP/1.1 200 OK\r\n\r\n" + DATA,
        damages=[("bad-signature", 0, 8), ("garbage", 0, 19 + 8)],
    )  # fmt: skip
    alien = f.chunk("DATA", f.cluster((0, 0, 4, w.knots(1, 0, 4)), file_id=9), 2, file_id=9)
    yield wrecked(
        "chunk-of-another-file-in-front",
        "A chunk of another file is in front: the file id is that of most chunks.",
        ["CHK-004", "REC-002"], "framing/other-file", alien + DATA,
        damages=[
            ("bad-signature", 0, 8), ("garbage", 0, len(alien) + 8), ("other-file", 0, 0),
        ],
    )  # fmt: skip
    front = f.chunk("HEAD", f.head(), 0, file_id=9)
    yield wrecked(
        "head-of-another-file-in-front",
        "HEAD of another file is in front and does not choose the file id.",
        ["CHK-004", "REC-002", "REC-013"], "framing/other-file", b"\0" + front + DATA,
        damages=[
            ("bad-signature", 0, 8), ("garbage", 0, 1 + len(front) + 8), ("other-file", 1, 0),
        ],
    )  # fmt: skip


def heads() -> Iterator[Case]:
    yield wrecked(
        "no-head-header", "The header of HEAD is damaged and there is no copy of it.",
        ["CHK-002", "HED-001", "REC-002"], "transmission/bit-flip", w.flip(DATA, 8 + 28),
        damages=[
            ("garbage", 8, HEAD_PLACE.size), ("missing-chunk", TRAK_PLACE.at, 0),
            ("missing-head", 8, 0),
        ],
    )  # fmt: skip
    yield wrecked(
        "no-head-payload", "The payload of HEAD is damaged: limits of level 2, no epoch.",
        ["CHK-003", "HED-001"], "transmission/bit-flip", w.flip(DATA, HEAD_PLACE.payload + 1),
        damages=[("bad-payload", 8, HEAD_PLACE.size), ("missing-head", 8, 0)],
    )  # fmt: skip
    twice = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), HEAD, THREE)
    yield wrecked(
        "head-by-its-copy", "The payload of HEAD is damaged, its copy at the end is not.",
        ["CHK-003", "HED-001"], "transmission/bit-flip", w.flip(twice.data, HEAD_PLACE.payload),
        damages=[("bad-payload", 8, HEAD_PLACE.size)], recover=0,
    )  # fmt: skip
    yield wrecked(
        "file-id-by-the-copy", "The header of HEAD is damaged; its copy tells the file id.",
        ["CHK-002", "CHK-004"], "transmission/bit-flip", w.flip(twice.data, 8 + 8),
        damages=[("garbage", 8, HEAD_PLACE.size), ("missing-chunk", TRAK_PLACE.at, 0)],
    )  # fmt: skip

    stranger = f.chunk("mETa", b"{}", 9, file_id=9)
    data = w.with_bytes(w.flip(twice.data, 8 + 8), TRAK_PLACE.at, stranger)
    behind = TRAK_PLACE.at + len(stranger)
    yield wrecked(
        "file-id-not-of-a-stranger",
        "The header of HEAD is damaged, and a chunk of another file is before its copy.",
        ["CHK-002", "CHK-004"], "framing/other-file", data,
        damages=[
            ("garbage", 8, HEAD_PLACE.size + len(stranger)), ("other-file", TRAK_PLACE.at, 0),
            ("missing-chunk", behind, 0),
        ],
    )  # fmt: skip
    told = f.head(f.tlv(2, bytes(range(16))) + f.epoch(-5, 1000) + f.tlv(6, b"test 1"))
    known = w.lay(("HEAD", told), THREE, *w.clusters(0, 4, 8))
    head = {
        "level": 1, "uuid": bytes(range(16)).hex(), "epoch_ns": "-5",
        "epoch_uncertainty_ns": "1000",
    }  # fmt: skip
    yield wrecked(
        "head-kept", "UUID and epoch come along into the recovered file.",
        ["HED-002", "REC-006"], "transmission/added-bytes", known.data + b"\0",
        decode=w.decoded(dict.fromkeys(range(3), ALL)) | {"head": head},
        damages=[("garbage", len(known.data), 1)],
    )  # fmt: skip


def between() -> Iterator[Case]:
    at = SECOND.at
    yield wrecked(
        "zeros-between", "Ten zero bytes are between two clusters; nothing is lost.",
        ["FIL-002", "REC-003"], "transmission/added-bytes", w.with_bytes(DATA, at, bytes(10)),
        damages=[("garbage", at, 10)],
    )  # fmt: skip
    yield wrecked(
        "sync-words-between", "Sync words without a header are between two clusters.",
        ["CHK-002", "FIL-002"], "framing/false-sync",
        w.with_bytes(DATA, at, f.SYNC * 3 + f.SYNC[:3]), damages=[("garbage", at, 15)],
    )  # fmt: skip
    false = f.chunk("DATA", f.cluster(w.packet(0, 4)), 3, header_crc=0)
    yield wrecked(
        "header-of-a-wrong-crc-between", "A header whose CRC is wrong is skipped.",
        ["CHK-002", "REC-001"], "framing/false-sync", w.with_bytes(DATA, at, false),
        damages=[("garbage", at, len(false))],
    )  # fmt: skip
    alien = f.chunk("DATA", f.cluster(w.packet(0, 4), file_id=9), 3, file_id=9)
    yield wrecked(
        "chunk-of-another-file-between", "A chunk with another file id is not read.",
        ["CHK-004"], "framing/other-file", w.with_bytes(DATA, at, alien),
        damages=[("garbage", at, len(alien)), ("other-file", at, 0)],
    )  # fmt: skip
    skipped = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), skip=(3,))
    for name, about, rule, chunk in (
        ("type-with-a-digit", "A header whose type is not four letters is no header.", "CHK-002",
         f.chunk("DAT1", b"abc", 3)),
        ("size-above-level-2", "A header with a payload above the level-2 limit is no header.",
         "LIM-001", f.chunk("aTTc", b"abc", 3, size=(1 << 24) + 1)),
    ):  # fmt: skip
        yield wrecked(
            name, about, [rule, "REC-002"], "framing/false-header",
            w.with_bytes(skipped.data, at, chunk),
            damages=[("garbage", at, len(chunk)), ("missing-chunk", at + len(chunk), 0)],
        )  # fmt: skip


def headers() -> Iterator[Case]:
    for name, place, about in (
        ("sync", 2, "A bit of the sync word is wrong"),
        ("sequence", 16, "A bit of the sequence number is wrong"),
        ("size", 20, "A bit of the payload size is wrong"),
        ("crc", 31, "A bit of the header CRC is wrong"),
    ):
        yield wrecked(
            f"header-flip-{name}", f"{about}: the whole cluster is lost, and found to be.",
            ["CHK-002", "REC-001", "REC-003", "DEC-003"], "transmission/bit-flip",
            w.flip(DATA, SECOND.at + place), kept=NO_SECOND, lost=LOST_SECOND,
            damages=[("garbage", SECOND.at, SECOND.size), ("missing-chunk", THIRD.at, 0)],
        )  # fmt: skip


def repeats() -> Iterator[Case]:
    chunk = STEADY.chunk("DATA", 1)
    yield wrecked(
        "duplicate", "A cluster occurs twice and is delivered once.",
        ["CHK-005"], "framing/duplicate", w.with_bytes(DATA, SECOND.stop, chunk),
        damages=[("duplicate-chunk", SECOND.stop, SECOND.size)], recover=[0, 3],
    )  # fmt: skip
    other = f.chunk("mETa", b'{"a":1}', 3)
    decode = w.decoded(dict.fromkeys(range(3), ALL)) | {"metadata": None}
    yield wrecked(
        "duplicate-number", "Another chunk with a number that there was is not used.",
        ["CHK-005"], "framing/duplicate", w.with_bytes(DATA, SECOND.stop, other),
        damages=[("duplicate-chunk", SECOND.stop, len(other))], decode=decode,
        recovered={"decode": w.decoded(dict.fromkeys(range(3), ALL))},
    )  # fmt: skip
    header = f.chunk("aTTc", b"", 2, size=THIRD.size, crc=1)
    yield wrecked(
        "duplicate-over-the-next",
        "The payload of a chunk with a number that there was is looked through.",
        ["CHK-005", "REC-002"], "framing/duplicate", w.with_bytes(DATA, THIRD.at, header + b"abc"),
        damages=[("duplicate-chunk", THIRD.at, w.HEADER + THIRD.size)],
    )  # fmt: skip
    row = STEADY.row(1, 4)
    shorter = w.without(w.with_bytes(DATA, SECOND.stop, STEADY.chunk("DATA", 0)), row.at)
    yield wrecked(
        "lost-byte-before-a-duplicate",
        "A cluster has lost a byte, and a chunk that there was already ends it.",
        ["CHK-005", "REC-002"], "framing/duplicate", shorter,
        kept={0: ALL, 1: ((0, 4), (8, 12)), 2: ALL}, lost=[(1, 4, 8)],
        damages=[
            ("bad-payload", SECOND.at, SECOND.size), ("bad-packet", row.at, row.size - 1),
            ("duplicate-chunk", SECOND.stop - 1, FIRST.size),
        ],
    )  # fmt: skip
    yield wrecked(
        "damaged-then-whole",
        "A damaged cluster and then the same one whole: the whole one gives the packet that the "
        "damaged one has lost.",
        ["CHK-003", "CHK-005", "DAT-006"], "framing/duplicate",
        w.flip(w.with_bytes(DATA, SECOND.stop, chunk), row.at),
        damages=[
            ("bad-payload", SECOND.at, SECOND.size), ("bad-packet", row.at, row.size),
            *[("overlap", SECOND.size + STEADY.row(track, 4).at, 7) for track in (0, 2)],
            ("out-of-order", SECOND.stop, 0),
        ], recover=[0, 3],
    )  # fmt: skip
    again = f.chunk("DATA", f.cluster(*w.clusters(4)[0]), 5)
    late = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), skip=(5,))
    yield wrecked(
        "overlap", "In a file with damage packets of ticks that were delivered are left out.",
        ["DAT-006"], "structure/overlap",
        w.flip(w.with_bytes(late.data, THIRD.stop, again), len(late.data) + len(again) - 1),
        damages=[
            *[("overlap", THIRD.stop + row.at - SECOND.at, row.size) for row in SECOND.rows],
            ("bad-payload", len(late.data) + len(again) - f.FOOT, f.FOOT),
            ("not-closed", len(late.data) + len(again), 0),
        ],
    )  # fmt: skip
    rows = [[w.packet(0, start, span)] for start, span in ((0, 4), (2, 10), (6, 2))]
    crossed = w.lay(HEAD, THREE, *rows)
    row = crossed.row(0, 2)
    yield wrecked(
        "overlap-between-others",
        "Of a packet that is left out those ticks are lost that no delivered packet has.",
        ["DAT-006", "REC-003", "REC-012"], "structure/overlap", crossed.data + b"\0",
        kept={0: ((0, 4), (6, 8)), 1: (), 2: ()}, lost=[(0, 4, 6), (0, 8, 12)],
        damages=[("garbage", len(crossed.data), 1), ("overlap", row.at, row.size)],
    )  # fmt: skip


def missing() -> Iterator[Case]:
    kept = [((4, 12),), ((0, 4), (8, 12)), ((0, 8),)]
    for number, place in enumerate((FIRST, SECOND, THIRD)):
        start = 4 * number
        yield wrecked(
            f"missing-cluster-{number}", "A cluster is missing; the index tells when it was.",
            ["CHK-005", "REC-003", "DEC-003", "REC-012"], "framing/missing",
            w.without(DATA, place.at, place.stop),
            kept=dict.fromkeys(range(3), kept[number]),
            damages=[("missing-chunk", place.at, 0)],
            lost=[(track, start, start + 4) for track in range(3)],
        )  # fmt: skip
    yield wrecked(
        "missing-two-clusters", "Two clusters are missing.",
        ["CHK-005", "REC-003", "REC-012"], "framing/missing",
        w.without(DATA, FIRST.at, SECOND.stop), kept=dict.fromkeys(range(3), ((8, 12),)),
        damages=[("missing-chunk", FIRST.at, 0)], lost=[(track, 0, 8) for track in range(3)],
    )  # fmt: skip
    extra = w.lay(HEAD, THREE, *w.clusters(0, 4), ("aTTc", f.strings("a", "")), *w.clusters(8))
    place = extra.of("aTTc")
    decode = w.decoded(dict.fromkeys(range(3), ALL)) | {"attachments": []}
    yield wrecked(
        "missing-attachment", "A chunk is missing that was no cluster by the index.",
        ["CHK-005", "REC-003"], "framing/missing", w.without(extra.data, place.at, place.stop),
        damages=[("missing-chunk", place.at, 0)], decode=decode,
    )  # fmt: skip
    extra = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), ("aTTc", f.strings("a", "")))
    place = extra.of("aTTc")
    yield wrecked(
        "missing-before-index", "A chunk is missing in front of the index, and was no cluster.",
        ["CHK-005", "REC-003"], "framing/missing", w.without(extra.data, place.at, place.stop),
        damages=[("missing-chunk", place.at, 0)], decode=decode,
    )  # fmt: skip
    yield wrecked(
        "missing-head", "The chunk HEAD is missing: UUID and epoch are lost.",
        ["CHK-005", "HED-001"], "framing/missing", w.without(DATA, 8, TRAK_PLACE.at),
        damages=[("missing-chunk", 8, 0), ("missing-head", 8, 0)],
    )  # fmt: skip
    alike = w.lay(HEAD, THREE, [w.packet(0, 0, 12)], [w.packet(1, 0, 12)], [w.packet(2, 0, 12)])
    place = alike.of("DATA", 0)
    yield wrecked(
        "missing-of-equal-times",
        "Three clusters have the same times, and the first one is missing: the sequence numbers "
        "tell which one the index lists.",
        ["CHK-005", "REC-003", "REC-012"], "framing/missing",
        w.without(alike.data, place.at, place.stop), kept={0: (), 1: ALL, 2: ALL},
        damages=[("missing-chunk", place.at, 0)], lost=[(0, 0, 12)],
    )  # fmt: skip
    apart = w.lay(HEAD, THREE, *w.clusters(0, 40, 80), close=False)
    place = apart.of("DATA", 1)
    yield wrecked(
        "missing-without-index", "Without an index the packets around it tell what is missing.",
        ["CHK-005", "REC-003", "REC-012"], "framing/missing",
        w.without(apart.data, place.at, place.stop),
        kept=dict.fromkeys(range(3), ((0, 4), (80, 84))),
        damages=[("missing-chunk", place.at, 0), ("not-closed", len(apart.data) - place.size, 0)],
        lost=[(track, 4, 80) for track in range(3)],
    )  # fmt: skip


def orders() -> Iterator[Case]:
    first, second = STEADY.chunk("DATA", 1), STEADY.chunk("DATA", 2)
    yield wrecked(
        "clusters-swapped", "Two clusters are swapped, and delivered in order of their numbers.",
        ["CHK-005", "DAT-006"], "framing/order", w.over(DATA, SECOND.at, second + first),
        damages=[
            ("missing-chunk", SECOND.at, 0), ("out-of-order", SECOND.at + THIRD.size, 0),
            ("missing-chunk", INDEX.at, 0),
        ], recover=[0, 3],
    )  # fmt: skip
    head, track = STEADY.chunk("HEAD"), STEADY.chunk("TRAK")
    yield wrecked(
        "head-behind-its-track", "HEAD and TRAK are swapped.",
        ["CHK-005", "HED-001"], "framing/order", w.over(DATA, 8, track + head),
        damages=[
            ("missing-chunk", 8, 0), ("out-of-order", 8 + len(track), 0),
            ("missing-chunk", FIRST.at, 0),
        ], recover=[0, 3],
    )  # fmt: skip
    tracks_last = w.over(DATA, TRAK_PLACE.at, STEADY.chunk("DATA", 0) + track)
    yield wrecked(
        "description-behind-its-cluster",
        "Through damage descriptions count wherever they are, clusters in order of numbers.",
        ["CHK-005", "TRK-001"], "framing/order", tracks_last,
        damages=[
            ("missing-chunk", TRAK_PLACE.at, 0), ("out-of-order", TRAK_PLACE.at + FIRST.size, 0),
            ("missing-chunk", SECOND.at, 0),
        ], recover=[0, 3],
    )  # fmt: skip
    row = STEADY.row(1, 8)
    swapped = w.over(w.flip(DATA, row.at), SECOND.at, w.flip(DATA, row.at)[THIRD.at : THIRD.stop])
    swapped = w.over(swapped, SECOND.at + THIRD.size, first)
    moved = row.at - THIRD.at + SECOND.at
    yield wrecked(
        "clusters-swapped-and-damaged",
        "Of two swapped clusters the later one is damaged: the one behind it in the file is not "
        "the next one.",
        ["CHK-005", "REC-002", "REC-012"], "framing/order", swapped,
        kept={0: ALL, 1: ((0, 8),), 2: ALL}, lost=[(1, 8, 12)],
        damages=[
            ("missing-chunk", SECOND.at, 0), ("bad-payload", SECOND.at, THIRD.size),
            ("bad-packet", moved, row.size), ("out-of-order", SECOND.at + THIRD.size, 0),
            ("missing-chunk", INDEX.at, 0),
        ],
    )  # fmt: skip
    third = STEADY.chunk("DATA", 2)
    few = DATA[: TRAK_PLACE.at] + STEADY.chunk("DATA", 0) + track + third
    yield wrecked(
        "swapped-and-missing", "A description behind its cluster, and then a hole in the numbers.",
        ["CHK-005", "REC-003", "REC-012"], "framing/order", few,
        kept=dict.fromkeys(range(3), ((0, 4), (8, 12))), lost=LOST_SECOND,
        damages=[
            ("missing-chunk", TRAK_PLACE.at, 0), ("out-of-order", TRAK_PLACE.at + FIRST.size, 0),
            ("missing-chunk", FIRST.stop, 0), ("not-closed", len(few), 0),
        ],
    )  # fmt: skip
    end = len(OPEN.data)
    yield wrecked(
        "number-jumps", "The sequence numbers jump, and no chunk says what was there.",
        ["CHK-005"], "framing/missing",
        w.lay(HEAD, THREE, *w.clusters(0, 4, 8), skip=(3,), close=False).data,
        damages=[("missing-chunk", SECOND.at, 0), ("not-closed", end, 0)],
    )  # fmt: skip
