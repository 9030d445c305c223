"""Damage within a cluster: what SPEC 14.1, procedure salvage, still finds there."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
import wreck as w
from case import Case
from wreck import ALL, HEAD, STEADY, THREE, Damage, Lost, Spans, wrecked

DATA = STEADY.data
FIRST, SECOND, THIRD = (STEADY.of("DATA", number) for number in range(3))
ZERO, ONE, TWO = SECOND.rows
TABLE = ZERO.at
"""Where the table of the second cluster ends."""

RULES = ["CHK-003", "DAT-004", "REC-001", "REC-002", "REC-003", "DEC-003", "REC-012"]
BAD = ("bad-payload", SECOND.at, SECOND.size)
GAP = ((0, 4), (8, 12))


def without_second(*tracks: int) -> dict[int, Spans]:
    """The second packets of these tracks are lost."""
    return {track: GAP if track in tracks else ALL for track in range(3)}


def second(*tracks: int) -> list[Lost]:
    return [(track, 4, 8) for track in tracks]


def hole(start: int, stop: int) -> Damage:
    return ("bad-packet", start, stop - start)


def cases() -> Iterator[Case]:
    yield from packets()
    yield from tables()
    yield from counts()
    yield from lengths()
    yield from foreign()
    yield from stale()
    yield from small()


def packets() -> Iterator[Case]:
    for row, word in ((ZERO, "first"), (ONE, "middle"), (TWO, "last")):
        yield wrecked(
            f"packet-flip-{word}", f"A bit of the {word} packet is wrong: it is lost alone.",
            RULES, "transmission/bit-flip", w.flip(DATA, row.at + 3),
            kept=without_second(row.track), damages=[BAD, hole(
                SECOND.payload if row is ZERO else row.at, row.stop)], lost=second(row.track),
        )  # fmt: skip
    burst = w.over(DATA, ZERO.at + 2, bytes(10))
    yield wrecked(
        "packets-burst", "Ten zero bytes over two packets.",
        RULES, "transmission/burst", burst, kept=without_second(0, 1),
        damages=[BAD, hole(SECOND.payload, ONE.stop)], lost=second(0, 1),
    )  # fmt: skip
    both = w.flip(w.flip(DATA, ZERO.at), TWO.at)
    yield wrecked(
        "packets-around", "The first and the last packet are damaged, the one between is found.",
        RULES, "transmission/bit-flip", both, kept=without_second(0, 2),
        damages=[BAD, hole(SECOND.payload, ZERO.stop), hole(TWO.at, TWO.stop)],
        lost=second(0, 2),
    )  # fmt: skip
    swapped = w.over(DATA, ONE.at, DATA[TWO.at : TWO.stop] + DATA[ONE.at : ONE.stop])
    yield wrecked(
        "packets-swapped", "Two packets are swapped: neither belongs to its entry.",
        [*RULES, "DAT-004"], "transmission/swapped-bytes", swapped, kept=without_second(1, 2),
        damages=[BAD, hole(ONE.at, TWO.stop)], lost=second(1, 2),
    )  # fmt: skip
    more = w.flip(w.flip(DATA, STEADY.row(1, 0).at), STEADY.row(2, 8).at)
    first, last = STEADY.row(1, 0), STEADY.row(2, 8)
    yield wrecked(
        "two-clusters", "A packet of each of two clusters.", RULES, "transmission/bit-flip", more,
        kept={0: ALL, 1: ((4, 12),), 2: ((0, 8),)},
        damages=[
            ("bad-payload", FIRST.at, FIRST.size), hole(first.at, first.stop),
            ("bad-payload", THIRD.at, THIRD.size), hole(last.at, last.stop),
        ], lost=[(1, 0, 4), (2, 8, 12)],
    )  # fmt: skip
    everything = w.over(DATA, SECOND.payload, bytes(SECOND.size - w.HEADER))
    yield wrecked(
        "nothing-left", "The whole payload is zeros: no packet can be read.",
        RULES, "transmission/burst", everything, kept=without_second(0, 1, 2),
        damages=[BAD, ("bad-table", SECOND.payload, SECOND.size - w.HEADER)], lost=second(0, 1, 2),
    )  # fmt: skip


def tables() -> Iterator[Case]:
    """A row is lost with its packet, and no other."""
    wide = w.lay(HEAD, THREE, *map(w.Wide, w.clusters(0, 4, 8)))
    place = wide.of("DATA", 1)
    bad = ("bad-payload", place.at, place.size)
    zero, one, two = place.rows
    for offset, field in enumerate(("track", "size", "start", "span", "crc")):
        yield wrecked(
            f"row-flip-{field}", f"A bit of the {field} in a row: one packet is lost.",
            RULES, "transmission/bit-flip", w.flip(wide.data, one.entry + offset),
            kept=without_second(1), damages=[bad, hole(one.at, one.stop)], lost=second(1),
        )  # fmt: skip
    sizes = w.flip(w.flip(wide.data, zero.entry + 1), two.entry + 1)
    yield wrecked(
        "row-sizes-around", "The sizes in the first and in the last row are wrong: nothing tells "
        "where the packet between them is.",
        RULES, "transmission/bit-flip", sizes, kept=without_second(0, 1, 2),
        damages=[bad, table_of(place)], lost=second(0, 1, 2),
    )  # fmt: skip
    burst = w.over(DATA, TWO.entry, b"\xff" * 8 + bytes(7))
    yield wrecked(
        "table-and-packet", "The last row and the first packet are overwritten.",
        RULES, "transmission/burst", burst, kept=without_second(0, 2),
        damages=[BAD, hole(SECOND.payload, ZERO.stop), hole(TWO.at, TWO.stop)],
        lost=second(0, 2),
    )  # fmt: skip
    yield wrecked(
        "table-crc-flip",
        "A bit of table_crc is wrong, and every packet holds: nothing is lost, and recover ends "
        "with 0.",
        ["CHK-003", "DAT-011", "REC-002", "VRD-001"], "transmission/bit-flip",
        w.flip(DATA, TABLE - 1), damages=[BAD], recover=0,
    )  # fmt: skip


def table_of(place: w.Place) -> Damage:
    return ("bad-table", place.payload, place.size - w.HEADER)


def counts() -> Iterator[Case]:
    """No row holds where the head of the table is wrong."""
    rows = [
        (
            f"count-{count}",
            0,
            bytes([count]),
            f"The number of packets is {count & 127}"
            f"{' and continues' if count > 127 else ''} in place of 3",
        )
        for count in (0, 2, 4, 0x83)
    ]
    rows += [
        ("width-of-the-track", 1, b"\0", "The width of the track ids is 0 in place of 1"),
        ("width-of-the-span", 2, b"\x10", "The width of the spans is 1 in place of 0"),
        ("least-track", 3, b"\1", "The least track id is 1 in place of 0"),
        ("least-size", 4, b"\x08", "The least size is 8 in place of 7"),
        ("least-start", 5, b"\x05", "The least start tick is 5 in place of 4"),
    ]  # fmt: skip
    for name, at, new, about in rows:
        yield wrecked(
            name, f"{about}: the cluster is lost.", ["DAT-001", "DAT-004", "REC-001", "REC-012"],
            "transmission/bit-flip", w.over(DATA, SECOND.payload + at, new),
            kept=without_second(0, 1, 2), damages=[BAD, table_of(SECOND)], lost=second(0, 1, 2),
        )  # fmt: skip


def lengths() -> Iterator[Case]:
    """Bytes that went missing or came in move the end of the payload to another place."""
    yield wrecked(
        "packet-byte-gone", "A byte of a packet is missing: those behind are found from the end.",
        RULES, "transmission/lost-bytes", w.without(DATA, ONE.at + 2),
        kept=without_second(1), damages=[BAD, hole(ONE.at, ONE.stop - 1)], lost=second(1),
    )  # fmt: skip
    yield wrecked(
        "packet-byte-more", "A packet has a byte too many.",
        RULES, "transmission/added-bytes", w.with_bytes(DATA, ONE.at + 2, b"\0"),
        kept=without_second(1), lost=second(1),
        damages=[BAD, hole(ONE.at, ONE.stop + 1), ("garbage", SECOND.stop, 1)],
    )  # fmt: skip
    yield wrecked(
        "packet-gone", "The bytes of a packet are missing.",
        RULES, "transmission/lost-bytes", w.without(DATA, ONE.at, ONE.stop),
        kept=without_second(1), damages=[BAD, ("bad-packet", ONE.at, 0)], lost=second(1),
    )  # fmt: skip
    yield wrecked(
        "table-byte-gone", "A byte of the first row is missing: the cluster is lost.",
        RULES, "transmission/lost-bytes", w.without(DATA, ZERO.entry + 3),
        kept=without_second(0, 1, 2), damages=[BAD, table_of(SECOND)], lost=second(0, 1, 2),
    )  # fmt: skip
    yield wrecked(
        "table-byte-more",
        "The last row has a byte too many: the packets of the others are found from the end.",
        RULES, "transmission/added-bytes", w.with_bytes(DATA, TWO.entry + 4, b"\0"),
        kept=without_second(2), lost=second(2),
        damages=[BAD, hole(ONE.stop + 1, TWO.stop), ("garbage", SECOND.stop, 1)],
    )  # fmt: skip
    last = w.without(DATA, THIRD.rows[2].stop - 1)
    row = THIRD.rows[2]
    yield wrecked(
        "last-byte-of-a-cluster-gone", "The last byte of a cluster is missing.",
        RULES, "transmission/lost-bytes", last, kept={0: ALL, 1: ALL, 2: ((0, 8),)},
        damages=[("bad-payload", THIRD.at, THIRD.size), hole(row.at, row.stop)],
        lost=[(2, 8, 12)],
    )  # fmt: skip


def foreign() -> Iterator[Case]:
    """The header of one cluster, bytes of another: no packet of the other holds there."""
    after = [(track, 4, 12) for track in range(3)]
    moved = w.without(DATA, SECOND.payload, THIRD.payload)
    yield wrecked(
        "payload-of-the-next", "The header of a cluster is before the payload of the next.",
        RULES, "transmission/lost-bytes", moved, kept=dict.fromkeys(range(3), ((0, 4),)),
        damages=[BAD, table_of(SECOND), ("missing-chunk", SECOND.stop, 0)], lost=after,
    )  # fmt: skip
    row = STEADY.row(2, 8)
    torn = w.without(DATA, ONE.at, row.at)
    yield wrecked(
        "cut-across-two-clusters", "From within a cluster up to within the next all is missing.",
        RULES, "transmission/lost-bytes", torn,
        kept={0: ((0, 8),), 1: ((0, 4),), 2: ((0, 4),)},
        damages=[BAD, hole(ONE.at, TWO.stop), ("missing-chunk", SECOND.stop - row.size, 0)],
        lost=[(0, 8, 12), (1, 4, 12), (2, 4, 12)],
    )  # fmt: skip
    row = STEADY.row(1, 8)
    torn = w.without(DATA, ONE.entry, row.entry)
    yield wrecked(
        "table-of-two-clusters", "The table begins as that of one cluster and ends as another.",
        RULES, "transmission/lost-bytes", torn, kept=dict.fromkeys(range(3), ((0, 4),)),
        damages=[BAD, table_of(SECOND), ("missing-chunk", SECOND.stop, 0)], lost=after,
    )  # fmt: skip
    for name, other in (("the-next", THIRD), ("before", FIRST)):
        copied = w.over(DATA, SECOND.payload, DATA[other.payload : other.stop])
        yield wrecked(
            f"payload-copied-from-{name}",
            "The payload of another cluster is in two places: its packets count where they "
            "belong, and take no place from others.",
            [*RULES, "DAT-006"], "transmission/misplaced-write", copied,
            kept=dict.fromkeys(range(3), GAP), damages=[BAD, table_of(SECOND)],
            lost=second(0, 1, 2),
        )  # fmt: skip


def stale() -> Iterator[Case]:
    sparse = w.lay(HEAD, THREE, *w.clusters(0, 40, 80, 120))
    place = sparse.of("DATA", 1)
    other = f.cluster(*w.clusters(60)[0])
    rest = ((80, 84), (120, 124))
    yield wrecked(
        "stale-payload",
        "A payload keeps every rule, but as that of another chunk: what stood there is missing.",
        ["CHK-003", "DAT-004", "REC-003", "REC-012"], "transmission/misplaced-write",
        w.over(sparse.data, place.payload, other),
        kept=dict.fromkeys(range(3), ((0, 4), *rest)),
        damages=[("bad-payload", place.at, place.size), table_of(place)],
        lost=[(track, 40, 44) for track in range(3)],
    )  # fmt: skip
    third, row = sparse.of("DATA", 2), place.rows[1]
    yield wrecked(
        "hole-behind-a-damaged-cluster",
        "A packet of a cluster is damaged, and the cluster behind it is missing: the entry of each "
        "tells of its own packets alone.",
        ["REC-003", "REC-012"], "transmission/lost-bytes",
        w.flip(w.without(sparse.data, third.at, third.stop), row.at),
        kept=dict.fromkeys((0, 2), ((0, 4), (40, 44), (120, 124))) | {1: ((0, 4), (120, 124))},
        damages=[
            ("bad-payload", place.at, place.size), hole(row.at, row.stop),
            ("missing-chunk", third.at, 0),
        ],
        lost=[(0, 44, 84), (1, 40, 84), (2, 80, 84)],
    )  # fmt: skip


def small() -> Iterator[Case]:
    """Packets of a byte or none."""
    one = ("TRAK", f.trak())
    single = w.lay(HEAD, one, *[[w.packet(0, at, 1)] for at in range(3)])
    place = single.of("DATA", 1)
    yield wrecked(
        "one-packet-of-a-byte", "A cluster of one packet of one byte, which is damaged.",
        RULES, "transmission/bit-flip", w.flip(single.data, place.rows[0].at),
        kept={0: ((0, 1), (2, 3))},
        damages=[
            ("bad-payload", place.at, place.size),
            ("bad-table", place.payload, place.size - w.HEADER),
        ], lost=[(0, 1, 2)],
    )  # fmt: skip
    two = ("TRAK", f.trak(track_count=2))
    pairs = w.lay(HEAD, two, *[[w.packet(t, at, 1) for t in range(2)] for at in range(3)])
    place = pairs.of("DATA", 1)
    yield wrecked(
        "two-packets-of-a-byte",
        "The number of packets is wrong: no packet holds, however short.",
        ["DAT-004", "REC-002", "REC-003"], "transmission/bit-flip",
        w.over(pairs.data, place.payload, b"\1"),
        kept=dict.fromkeys(range(2), ((0, 1), (2, 3))),
        damages=[("bad-payload", place.at, place.size), table_of(place)],
        lost=[(0, 1, 2), (1, 1, 2)],
    )  # fmt: skip
    zeros = f.tlv(1, f.quan_parameters(b"\x10", m=0))
    silent = f.trak(zeros, track_count=1, codec=b"QUAN", first_channel=2, first=2)
    quiet = [[*(w.packet(t, at) for t in range(2)), (2, at, 4, b"")] for at in (0, 4, 8)]
    empty = w.lay(HEAD, two, ("TRAK", silent), *quiet)
    place = empty.of("DATA", 1)
    row = empty.row(1, 4)
    numbers = {"spans": [[0, 12]], "numbers": w.numbers([0] * 12)}
    decode = w.decoded({0: ALL, 1: GAP})
    decode["tracks"].append({"track": 2, **numbers})
    decode["channels"].append({"channel": 2, **numbers})
    yield wrecked(
        "empty-packet", "A packet without bytes holds by its row alone.",
        RULES, "transmission/bit-flip", w.flip(empty.data, row.at + 3), decode=decode,
        damages=[("bad-payload", place.at, place.size), hole(row.at, row.stop)], lost=[(1, 4, 8)],
        codecs=("KNOT", "QUAN"),
    )  # fmt: skip
    wide = f.trak(f.tlv(1, f.knot_parameters(1)), component_count=1)
    broken = [[(0, 0, 4, f.svarint(5))], [(0, 4, 4, b"\x80")], [(0, 8, 4, f.svarint(5))]]
    spoilt = w.lay(HEAD, ("TRAK", wide), *broken)
    row = spoilt.row(0, 4)
    spans = {"spans": [[0, 4], [8, 12]], "numbers": w.numbers([5] * 8)}
    decode = {"tracks": [{"track": 0, **spans}], "channels": [{"channel": 0, **spans}]}
    yield wrecked(
        "packet-that-breaks-a-rule",
        "In a file with damage a packet that does not decode is part of the damage.",
        ["COD-001", "CNV-002", "REC-006"], "semantics/packet", spoilt.data + b"\0",
        decode=decode, lost=[(0, 4, 8)],
        damages=[("garbage", len(spoilt.data), 1), ("bad-packet", row.at, 1)],
    )  # fmt: skip
    behind = [(0, 6, 2, f.svarint(5)), (0, 8, 4, f.svarint(5))]
    laid = w.lay(HEAD, ("TRAK", wide), *broken[:2], *([each] for each in behind))
    row, after = laid.row(0, 4), laid.row(0, 6)
    yield wrecked(
        "packet-that-breaks-a-rule-and-overlaps",
        "A packet that does not decode displaces one that starts before its end.",
        ["COD-001", "CNV-002", "DAT-006", "REC-003"], "semantics/packet", laid.data + b"\0",
        decode=decode, lost=[(0, 4, 8)],
        damages=[
            ("garbage", len(laid.data), 1), ("bad-packet", row.at, 1),
            ("overlap", after.at, after.size),
        ],
    )  # fmt: skip
    yield wrecked(
        "packet-that-breaks-a-rule-alone",
        "A file without damage with a packet that does not decode: recover leaves it out.",
        ["COD-001", "CNV-002", "REC-006"], "semantics/packet", spoilt.data,
        decode={}, damages=[], verdict="nonconforming", exits={"decode": 2, "verify": 2},
        recovered={"decode": decode},
    )  # fmt: skip
