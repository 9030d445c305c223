"""Damage within a cluster: what SPEC 12.1, procedure salvage, still finds there."""

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

RULES = ["CHK-003", "DAT-004", "REC-001", "REC-002", "REC-003", "REC-004", "REC-012"]
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
    """An entry is lost with its packet, whatever becomes of the bytes behind it."""
    fields = ("track", "size", "start", "span", "crc")
    for place, field in enumerate(fields):
        yield wrecked(
            f"entry-flip-{field}", f"A bit of the {field} in a table: one packet is lost.",
            [*RULES, "DAT-004"], "transmission/bit-flip", w.flip(DATA, ONE.entry + place),
            kept=without_second(1), damages=[BAD, hole(ONE.at, ONE.stop)], lost=second(1),
        )  # fmt: skip
    yield wrecked(
        "entry-grows", "A varint of the first entry goes on: all entries behind it move.",
        RULES, "transmission/bit-flip", w.flip(DATA, ZERO.entry + 2, 0x80),
        kept=without_second(0), damages=[BAD, hole(SECOND.payload, ZERO.stop)], lost=second(0),
    )  # fmt: skip
    yield wrecked(
        "entry-grows-between", "A varint of the second entry goes on: the last one is looked for.",
        RULES, "transmission/bit-flip", w.flip(DATA, ONE.entry, 0x80),
        kept=without_second(1), damages=[BAD, hole(ONE.at, ONE.stop)], lost=second(1),
    )  # fmt: skip
    yield wrecked(
        "entry-grows-last", "A varint of the last entry goes on: the first packet is looked for.",
        RULES, "transmission/bit-flip", w.flip(DATA, TWO.entry + 1, 0x80),
        kept=without_second(2), damages=[BAD, hole(TWO.at, TWO.stop)], lost=second(2),
    )  # fmt: skip
    burst = w.over(DATA, TWO.entry, b"\xff" * 8 + bytes(7))
    yield wrecked(
        "table-and-packet", "The last entry and the first packet are overwritten.",
        RULES, "transmission/burst", burst, kept=without_second(0, 2),
        damages=[BAD, hole(SECOND.payload, ZERO.stop), hole(TWO.at, TWO.stop)],
        lost=second(0, 2),
    )  # fmt: skip


def counts() -> Iterator[Case]:
    """The number of packets is under no CRC of a packet: they all are found."""
    for count in (0, 2, 4, 0x83):
        yield wrecked(
            f"count-{count}", f"The number of packets is {count & 127}"
            f"{' and goes on' if count > 127 else ''} in place of 3: all of them are found.",
            ["DAT-001", "REC-002"], "transmission/bit-flip",
            w.over(DATA, SECOND.payload, bytes([count])), damages=[BAD], recover=[0, 3],
        )  # fmt: skip


def lengths() -> Iterator[Case]:
    """Bytes that went missing or came in move the end of the payload to another place."""
    yield wrecked(
        "packet-byte-gone", "A byte of a packet is missing: those behind are found from the end.",
        RULES, "transmission/lost-bytes", w.without(DATA, ONE.at + 2),
        kept=without_second(1), damages=[BAD, hole(ONE.at, ONE.stop - 1)], lost=second(1),
    )  # fmt: skip
    yield wrecked(
        "packet-byte-more", "A byte too many stands in a packet.",
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
        "table-byte-gone", "A byte of the first entry is missing.",
        RULES, "transmission/lost-bytes", w.without(DATA, ZERO.entry + 3),
        kept=without_second(0), damages=[BAD, hole(SECOND.payload, ZERO.stop - 1)],
        lost=second(0),
    )  # fmt: skip
    yield wrecked(
        "table-byte-more",
        "A byte too many stands in the last entry: the others are found from the end, one byte "
        "behind the end of the table.",
        RULES, "transmission/added-bytes", w.with_bytes(DATA, TWO.entry + 4, b"\0"),
        kept=without_second(2), lost=second(2),
        damages=[
            BAD, hole(SECOND.payload, ZERO.at + 1), hole(TWO.at + 1, TWO.stop),
            ("garbage", SECOND.stop, 1),
        ],
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
    """The header of one cluster, bytes of another: its packets hold, and are themselves."""
    moved = w.without(DATA, SECOND.payload, THIRD.payload)
    yield wrecked(
        "payload-of-the-next", "The header of a cluster stands before the payload of the next.",
        RULES, "transmission/lost-bytes", moved, kept=dict.fromkeys(range(3), GAP),
        damages=[BAD, ("missing-chunk", SECOND.stop, 0)], lost=second(0, 1, 2),
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
        "table-of-two-clusters", "The table begins as that of one cluster and goes on as the next.",
        RULES, "transmission/lost-bytes", torn,
        kept={0: ((0, 4),), 1: GAP, 2: GAP},
        damages=[BAD, hole(SECOND.payload, ONE.at), ("missing-chunk", SECOND.stop, 0)],
        lost=[(0, 4, 12), (1, 4, 8), (2, 4, 8)],
    )  # fmt: skip
    copied = w.over(DATA, SECOND.payload, DATA[THIRD.payload : THIRD.stop])
    yield wrecked(
        "payload-copied-from-the-next", "The payload of the next cluster stands in two places.",
        RULES, "transmission/misplaced-write", copied, kept=dict.fromkeys(range(3), GAP),
        damages=[BAD, *[("overlap", row.at, row.size) for row in SECOND.rows]],
        lost=second(0, 1, 2),
    )  # fmt: skip
    copied = w.over(DATA, SECOND.payload, DATA[FIRST.payload : FIRST.stop])
    yield wrecked(
        "payload-copied-from-before", "The payload of the cluster before stands in two places.",
        RULES, "transmission/misplaced-write", copied, kept=dict.fromkeys(range(3), GAP),
        damages=[BAD, *[("overlap", row.at, row.size) for row in SECOND.rows]],
        lost=second(0, 1, 2),
    )  # fmt: skip


def stale() -> Iterator[Case]:
    sparse = w.lay(HEAD, THREE, *w.clusters(0, 40, 80))
    place = sparse.of("DATA", 1)
    other = f.cluster(*w.clusters(60)[0])
    yield wrecked(
        "stale-payload",
        "A payload keeps every rule and is not what its header speaks of: what stood there is "
        "missing, though no packet of it is.",
        ["CHK-003", "REC-003", "REC-012"], "transmission/misplaced-write",
        w.over(sparse.data, place.payload, other),
        kept=dict.fromkeys(range(3), ((0, 4), (60, 64), (80, 84))),
        damages=[("bad-payload", place.at, place.size)],
        lost=[(track, 40, 44) for track in range(3)],
    )  # fmt: skip


def small() -> Iterator[Case]:
    """Packets of a byte or none: too few bits to tell where the table ends."""
    one = ("TRAK", f.trak(), {"track": 0})
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
    two = ("TRAK", f.trak(track_count=2), {"track": 0})
    pairs = w.lay(HEAD, two, *[[w.packet(t, at, 1) for t in range(2)] for at in range(3)])
    place = pairs.of("DATA", 1)
    yield wrecked(
        "two-packets-of-a-byte",
        "The number of packets is wrong, and those found are too short to tell that they are all.",
        ["DAT-001", "REC-002", "REC-003"], "transmission/bit-flip",
        w.over(pairs.data, place.payload, b"\3"), kept=dict.fromkeys(range(2), ((0, 3),)),
        damages=[
            ("bad-payload", place.at, place.size),
            ("bad-table", place.payload, place.size - w.HEADER),
        ], recover=[0, 3],
    )  # fmt: skip
    zeros = f.tlv(1, f.quan_parameters(b"\x10", m=0))
    silent = f.trak(zeros, track_count=1, codec=b"QUAN", first_channel=2)
    quiet = [[*(w.packet(t, at) for t in range(2)), (2, at, 4, b"")] for at in (0, 4, 8)]
    empty = w.lay(HEAD, two, ("TRAK", silent, {"track": 2}), *quiet)
    place = empty.of("DATA", 1)
    numbers = {"spans": [[0, 12]], "numbers": w.numbers([0] * 12)}
    decode = w.decoded(dict.fromkeys(range(2), ALL))
    decode["tracks"].append({"track": 2, **numbers})
    decode["channels"].append({"channel": 2, **numbers})
    yield wrecked(
        "empty-packet", "A packet without bytes is found by its entry behind the last one.",
        RULES, "transmission/bit-flip", w.over(empty.data, place.payload, b"\1"),
        decode=decode, damages=[("bad-payload", place.at, place.size)], recover=[0, 3],
        codecs=("KNOT", "QUAN"),
    )  # fmt: skip
    wide = f.trak(f.tlv(1, f.knot_parameters(1)), component_count=1)
    broken = [[(0, 0, 4, f.svarint(5))], [(0, 4, 4, b"\x80")], [(0, 8, 4, f.svarint(5))]]
    spoilt = w.lay(HEAD, ("TRAK", wide, {"track": 0}), *broken)
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
    yield wrecked(
        "packet-that-breaks-a-rule-alone",
        "A file without damage with a packet that does not decode: recover leaves it out.",
        ["COD-001", "CNV-002", "REC-006"], "semantics/packet", spoilt.data,
        decode={}, damages=[], verdict="nonconforming", exits={"decode": 2, "verify": 2},
        recovered={"decode": decode},
    )  # fmt: skip
