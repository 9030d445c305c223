"""Descriptions that are lost, and what is left without them (SPEC 14.1 and 14.2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import forge as f
import wreck as w
from case import Case
from facts import Layer, Packet, Track, decode_of
from wreck import HEAD, Damage, Laid, wrecked


def parts(track: int, *starts: int) -> list[Packet]:
    return [
        Packet(start, [w.value(track, start + i) for i in range(4)], w.knots(track, start, 4))
        for start in starts
    ]


def unheld(laid: Laid, track: int, *starts: int) -> list[Damage]:
    """Packets that hold, of a track that nothing describes."""
    rows = [laid.row(track, start) for start in starts]
    return [("bad-packet", row.at, row.size) for row in rows]


def bad(laid: Laid, type_: str, number: int = 0) -> Damage:
    place = laid.of(type_, number)
    return ("bad-payload", place.at, place.size)


def spoilt(laid: Laid, number: int) -> bytes:
    """With a wrong bit in a TRAK chunk."""
    return w.flip(laid.data, laid.of("TRAK", number).payload + 5)


def described(*tracks: Track) -> list[w.Chunk]:
    return [HEAD, *(track.chunk for track in tracks)]


def two(*starts: int) -> list[list[w.Packet]]:
    return w.clusters(*starts, tracks=2)


def cases() -> Iterator[Case]:
    yield from full_band()
    yield from parameters()
    yield from bands()
    yield from continued()
    yield from layers()
    yield from unknown()


def full_band() -> Iterator[Case]:
    first = Track(id=0, packets=parts(0, 0, 4, 8))
    second = Track(id=1, channel=1, packets=parts(1, 0, 4, 8))
    laid = w.lay(*described(first, second), *two(0, 4, 8))
    empty = {"channel": 0, "label": "(lost)", "spans": [], "numbers": w.numbers([])}
    decode = decode_of(second)
    yield wrecked(
        "description-lost",
        "The description of a track is lost: its packets hold and cannot be delivered. The "
        "recovered file has a channel without samples in its place.",
        ["DAT-008", "REC-003", "REC-007", "REC-012"], "transmission/bit-flip",
        spoilt(laid, 0), decode=decode, lost=[(0, 0, 12)],
        damages=[bad(laid, "TRAK"), *unheld(laid, 0, 0, 4, 8)],
        recovered={"decode": {"channels": [empty, *decode["channels"]]}},
    )  # fmt: skip
    yield wrecked(
        "last-description-lost", "The last channel is lost: no number tells that it was there.",
        ["DAT-008", "REC-003", "REC-007", "REC-012"], "transmission/bit-flip",
        spoilt(laid, 1), decode=decode_of(first), lost=[(1, 0, 12)],
        damages=[bad(laid, "TRAK", 1), *unheld(laid, 1, 0, 4, 8)],
    )  # fmt: skip
    twice = w.lay(*described(first, second), *two(0, 4, 8), *described(first, second))
    for number in (0, 1):
        yield wrecked(
            f"description-by-its-copy-{number}",
            "The description of a track is damaged, its copy at the end is not.",
            ["REC-007", "TRK-001", "TRK-003"], "transmission/bit-flip", spoilt(twice, number),
            decode=decode_of(first, second), damages=[bad(twice, "TRAK", number)], recover=0,
        )  # fmt: skip
    other = Track(id=1, channel=1, high=99)
    differing = w.lay(*described(first, second), *two(0, 4, 8), other.chunk)
    place = differing.of("TRAK", 2)
    yield wrecked(
        "description-twice", "In a file with damage a second, different description is part of it.",
        ["TRK-003"], "structure/description", differing.data + b"\0",
        decode=decode_of(first, second),
        damages=[
            ("garbage", len(differing.data), 1), ("bad-chunk", place.at, place.size),
        ],
    )  # fmt: skip


def parameters() -> Iterator[Case]:
    broken = Track(id=0, parameters=f.knot_parameters(2))
    good = Track(id=1, channel=1, packets=parts(1, 0, 4))
    laid = w.lay(*described(broken, good), *two(0, 4))
    place, left = laid.of("TRAK"), decode_of(good)
    empty = {"channel": 0, "label": "(lost)", "spans": [], "numbers": w.numbers([])}
    recovered = {"decode": {"channels": [empty, *left["channels"]]}}
    yield wrecked(
        "parameters-broken", "The codec parameters of a track break a rule: recover leaves it out.",
        ["KNT-001", "REC-007"], "structure/description", laid.data, decode={},
        damages=[], verdict="nonconforming", exits={"decode": 2, "verify": 2}, recovered=recovered,
    )  # fmt: skip
    yield wrecked(
        "parameters-broken-and-damage",
        "In a file with damage a track whose codec parameters break a rule is part of it.",
        ["KNT-001", "REC-007", "REC-012"], "structure/description", laid.data + b"\0",
        decode=left, recovered=recovered, lost=[(0, 0, 8)],
        damages=[
            ("garbage", len(laid.data), 1), ("bad-chunk", place.at, place.size),
            *unheld(laid, 0, 0, 4),
        ],
    )  # fmt: skip


def bands() -> Iterator[Case]:
    slow = Track(id=0, kind="lf", packets=parts(0, 0, 4, 8))
    fast = Track(id=1, kind="hf", base=0, packets=parts(1, 0, 4, 8))
    laid = w.lay(*described(slow, fast), *two(0, 4, 8))
    left = decode_of(slow)
    yield wrecked(
        "hf-description-lost",
        "The description of an HF track is lost: nothing in full band, the LF part alone is left.",
        ["DEC-003", "REC-007", "REC-012", "TRK-012"], "transmission/bit-flip",
        spoilt(laid, 1), decode=left, lost=[(0, 0, None), (1, 0, 12)],
        damages=[bad(laid, "TRAK", 1), *unheld(laid, 1, 0, 4, 8)],
        recovered={"decode": {name: left[name] for name in ("channels", "lf", "hf")}},
    )  # fmt: skip
    alone = w.lay(*described(slow), *w.clusters(0, 4, 8, tracks=1), close=False)
    yield wrecked(
        "lf-alone-not-closed",
        "A file was not closed, and its LF track has no HF track: nothing in full band.",
        ["DEC-003", "REC-003", "TRK-012"], "crash/not-closed",
        alone.data, decode=left, lost=[(0, 0, None)],
        damages=[("not-closed", len(alone.data), 0)],
        recovered={"decode": {name: left[name] for name in ("channels", "lf", "hf")}},
    )  # fmt: skip
    place = laid.of("TRAK", 1)
    yield wrecked(
        "lf-description-lost", "The description of an LF track is lost, and so is its channel.",
        ["DEC-003", "REC-007", "REC-012", "TRK-007"], "transmission/bit-flip",
        spoilt(laid, 0), lost=[(0, 0, 12)],
        decode={"tracks": decode_of(slow, fast)["tracks"][1:], "channels": [], "lf": [], "hf": []},
        damages=[bad(laid, "TRAK"), *unheld(laid, 0, 0, 4, 8), ("lost-base", place.at, 0)],
        recovered={"decode": {"tracks": [], "channels": [], "lf": [], "hf": []}},
    )  # fmt: skip
    row = laid.row(1, 4)
    short = Track(id=1, kind="hf", base=0, packets=parts(1, 0, 8))
    cluster = laid.of("DATA", 1)
    yield wrecked(
        "hf-packet-lost", "A packet of an HF track is lost: a gap in full band alone.",
        ["DEC-003", "REC-012"], "transmission/bit-flip", w.flip(laid.data, row.at),
        decode=decode_of(slow, short), lost=[(1, 4, 8)],
        damages=[("bad-payload", cluster.at, cluster.size), ("bad-packet", row.at, row.size)],
    )  # fmt: skip
    row = laid.row(0, 4)
    short = Track(id=0, kind="lf", packets=parts(0, 0, 8))
    yield wrecked(
        "lf-packet-lost", "A packet of an LF track is lost: a gap in full band.",
        ["DEC-003", "REC-012"], "transmission/bit-flip", w.flip(laid.data, row.at),
        decode=decode_of(short, fast), lost=[(0, 4, 8)],
        damages=[
            ("bad-payload", cluster.at, cluster.size),
            ("bad-packet", cluster.payload, row.stop - cluster.payload),
        ],
    )  # fmt: skip


def continued() -> Iterator[Case]:
    first = Track(id=0, packets=parts(0, 0, 4))
    second = Track(id=1, continues=0, packets=parts(1, 8, 12))
    rows = [[w.packet(0, 0)], [w.packet(0, 4)], [w.packet(1, 8)], [w.packet(1, 12)]]
    laid = w.lay(*described(first, second), *rows)
    for number, left, starts in ((0, second, (0, 4)), (1, first, (8, 12))):
        yield wrecked(
            f"continued-lost-{number}",
            "Of two tracks that continue one another one has lost its description: the other "
            "stays the channel.",
            ["REC-007", "REC-012", "TRK-016", "TRK-018"], "transmission/bit-flip",
            spoilt(laid, number), decode=decode_of(left),
            lost=[(number, starts[0], starts[-1] + 4)],
            damages=[bad(laid, "TRAK", number), *unheld(laid, number, *starts)],
        )  # fmt: skip


def layers() -> Iterator[Case]:
    def marks(*starts: int) -> Layer:
        rows = [(start, 4, [(start + 1, 2, None, f"mark at {start + 1}")]) for start in starts]
        return Layer(id=1, label="marks", rate=(1000, 1), packets=rows)

    def clusters(layer: Layer, samples: Sequence[Packet]) -> list[list[w.Packet]]:
        bodies = {start: body for _, _, start, _, body in layer.rows()}
        return [
            [(0, each.start, 4, each.body), (1, each.start, 4, bodies[each.start])]
            for each in samples
        ]

    track = Track(id=0, packets=parts(0, 0, 4, 8))
    whole = marks(0, 4, 8)
    laid = w.lay(HEAD, track.chunk, whole.chunk, *clusters(whole, track.packets))
    row, place = laid.row(1, 4), laid.of("DATA", 1)
    yield wrecked(
        "events-lost", "A packet of events is lost: all ticks of its cluster are named.",
        ["REC-003", "REC-012"], "transmission/bit-flip", w.flip(laid.data, row.stop - 1),
        decode=decode_of(track, layers=[marks(0, 8)]), lost=[(1, 4, 8)],
        damages=[("bad-payload", place.at, place.size), ("bad-packet", row.at, row.size)],
        codecs=("KNOT", "EVNT"),
    )  # fmt: skip
    spoken = Layer(id=2, label="", rate=(1000, 1), packets=[(0, 4, [(1, 0, 1, "here")])])
    second = Track(id=1, channel=1, packets=parts(1, 0))
    ((_, _, _, _, body),) = spoken.rows()
    first = Track(id=0, packets=parts(0, 0))
    laid = w.lay(
        HEAD, first.chunk, second.chunk, spoken.chunk,
        [w.packet(0, 0), w.packet(1, 0), (2, 0, 4, body)],
    )  # fmt: skip
    decode = decode_of(first, layers=[spoken])
    empty = {"channel": 1, "label": "(lost)", "spans": [], "numbers": w.numbers([])}
    yield wrecked(
        "event-of-a-lost-channel",
        "An event speaks of a channel that has lost its description: it stays one, without "
        "samples.",
        ["EVT-003", "REC-007", "REC-012"], "transmission/bit-flip", spoilt(laid, 1),
        decode=decode, lost=[(1, 0, 4)], codecs=("KNOT", "EVNT"),
        damages=[bad(laid, "TRAK", 1), *unheld(laid, 1, 0)],
        recovered={"decode": {
            "channels": [*decode["channels"], empty], "layers": decode["layers"],
        }},
    )  # fmt: skip


def unknown() -> Iterator[Case]:
    track = Track(id=0, packets=parts(0, 0))
    strange = Track(id=1, channel=1, codec="xNEW")
    laid = w.lay(HEAD, track.chunk, strange.chunk, [w.packet(0, 0), (1, 0, 4, b"what is this")])
    yield wrecked(
        "unknown-codec-and-damage",
        "A track of an unknown codec in a file with damage: recover copies its packets.",
        ["TRK-011", "VRD-001", "REC-006", "REC-007"], "transmission/added-bytes",
        laid.data + bytes(3), decode=decode_of(track),
        damages=[("garbage", len(laid.data), 3)], exits={"decode": [3, 4]},
        recovered={"verdict": "unsupported"},
    )  # fmt: skip
    strange = Track(id=0, codec="xNEW")
    known = Track(id=1, channel=1, packets=parts(1, 4))
    most = [(0, 0, 2**22 - 3, b"what is this"), w.packet(1, 0)]
    laid = w.lay(*described(strange, known), most, [w.packet(1, 4)])
    row = laid.row(1, 0)
    yield wrecked(
        "unknown-codec-of-most-samples",
        "Packets of an unknown codec count for the limit of samples: the next one is left out.",
        ["DAT-009", "TRK-011", "REC-003"], "transmission/bit-flip",
        w.flip(laid.data, laid.row(0, 0).at - 1), decode=decode_of(known),
        damages=[bad(laid, "DATA"), ("bad-packet", row.at, row.size)], lost=[(1, 0, 4)],
        exits={"decode": [3, 4]}, recovered={"verdict": "unsupported"},
    )  # fmt: skip
    third = Track(id=2, channel=2)
    most.append((2, 0, 3, w.knots(2, 0, 3)))
    laid = w.lay(*described(strange, known, third), most, [w.packet(1, 4)])
    rows = [laid.row(1, 0), laid.row(2, 0)]
    yield wrecked(
        "samples-left-out-count",
        "A packet that passes the limit of samples counts, although it is left out.",
        ["DAT-009", "REC-003"], "transmission/bit-flip",
        w.flip(laid.data, laid.row(0, 0).at - 1), decode=decode_of(known, third),
        damages=[bad(laid, "DATA"), *(("bad-packet", row.at, row.size) for row in rows)],
        lost=[(1, 0, 4), (2, 0, 3)],
        exits={"decode": [3, 4]}, recovered={"verdict": "unsupported"},
    )  # fmt: skip
    laid = w.lay(HEAD, track.chunk, [w.packet(0, 0)], ("ABCD", b"what"))
    yield wrecked(
        "unknown-critical-and-damage",
        "An unknown critical chunk in a file with damage: decode gives nothing, recover keeps it.",
        ["CHK-009", "REC-010", "VRD-001"], "transmission/added-bytes", laid.data + bytes(3),
        decode={}, damages=[("garbage", len(laid.data), 3)], exits={"decode": 4},
        recovered={"verdict": "unsupported"},
    )  # fmt: skip
