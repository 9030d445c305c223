"""Rules that are broken in a file with damage (SPEC 14.2), or where more than one verdict fits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import forge as f
import wreck as w
from case import Case
from facts import Track, decode_of
from wreck import ALL, HEAD, THREE, Laid, wrecked

from .recoverable_extras import WRONG, digested
from .recoverable_tracks import parts, unheld

WHOLE = w.decoded(dict.fromkeys(range(3), ALL))


def cases() -> Iterator[Case]:
    yield from exact_values()
    yield from channels()
    yield from unsupported()
    yield from chunks()
    yield from verdicts()


def spoilt(
    name: str,
    about: str,
    rules: list[str],
    laid: Laid,
    decode: Any,
    *damages: w.Damage,
    **more: Any,
) -> Case:
    """With a byte behind the last chunk, so that a broken rule is part of the damage."""
    found = [("garbage", len(laid.data), 1), *damages]
    return wrecked(name, about, rules, "structure/description", laid.data + b"\0", damages=found,
                   decode=decode, **more)  # fmt: skip


def whole(laid: Laid, type_: str, number: int = 0) -> w.Damage:
    place = laid.of(type_, number)
    return ("bad-chunk", place.at, place.size)


def exact_values() -> Iterator[Case]:
    fives = b"\3\x10\0\x0a"
    exact = ("TRAK", f.trak(f.tlv(1, f.lpcx_parameters()), codec=b"LPCX"))
    laid = w.lay(HEAD, exact, [(0, 0, 4, fives)], [(0, 4, 4, fives + b"\4\0\0")])
    row = laid.row(0, 4)
    found = {"spans": [[0, 4]], "numbers": w.numbers([5] * 4)}
    yield spoilt(
        "exact-values-broken-and-damage",
        "The exact values of a packet break a rule: it is reported, and none of it is delivered.",
        ["EXA-006", "EXA-003", "REC-003"], laid,
        {"tracks": [{"track": 0, **found}], "channels": [{"channel": 0, **found}]},
        ("bad-packet", row.at, row.size), lost=[(0, 4, 8)], codecs=("LPCX",),
    )  # fmt: skip


def channels() -> Iterator[Case]:
    three = f.tracks(*(f.track(first_channel=channel) for channel in (0, 0, 1)))
    clock = ("cLOk", f.clock([(0, 1000, 5)], track=1))
    laid = w.lay(HEAD, ("TRAK", three), clock, *w.clusters(0, 4))
    kept = decode_of(
        Track(id=0, packets=parts(0, 0, 4)), Track(id=2, channel=1, packets=parts(2, 0, 4))
    )
    yield spoilt(
        "channel-taken-and-damage",
        "Of three tracks in a chunk the second has the channel number of the first: it alone is "
        "left out, and a clock on its ticks.",
        ["TRK-010", "CLK-005", "REC-003"], laid, kept | {"clocks": []},
        whole(laid, "TRAK"), whole(laid, "cLOk"), *unheld(laid, 1, 0, 4), lost=[(1, 0, 8)],
        recovered={"decode": {"channels": kept["channels"]}},
    )  # fmt: skip
    alone = f.tracks(f.track(), f.track(kind=2, linked=0))
    laid = w.lay(HEAD, ("TRAK", alone), *w.clusters(0, 4, tracks=2))
    first = Track(id=0, packets=parts(0, 0, 4))
    second = decode_of(
        Track(id=0, kind="lf"), Track(id=1, kind="hf", base=0, packets=parts(1, 0, 4))
    )["tracks"][1:]
    yield spoilt(
        "hf-of-no-base-and-damage", "An HF track names no base: its base counts as lost.",
        ["TRK-007", "DEC-003"], laid,
        decode_of(first) | {"tracks": [*decode_of(first)["tracks"], *second]},
        ("lost-base", laid.of("TRAK").at, 0), recovered={"decode": decode_of(first)},
    )  # fmt: skip


def unsupported() -> Iterator[Case]:
    slow = Track(id=0, kind="lf", codec="xNEW")
    fast = Track(id=1, kind="hf", base=0, packets=parts(1, 0, 4))
    rows = [[(0, start, 4, b"what is this"), w.packet(1, start)] for start in (0, 4)]
    laid = w.lay(HEAD, slow.chunk, fast.chunk, *rows)
    kept = {"tracks": decode_of(slow, fast)["tracks"][1:], "channels": [], "lf": [], "hf": []}
    yield spoilt(
        "codec-of-lf-and-damage",
        "The base of an HF track has an unknown codec: the HF track has no channel.",
        ["TRK-011", "DEC-003"], laid, kept, exits={"decode": [3, 4]},
        recovered={"verdict": "unsupported", "decode": {}},
    )  # fmt: skip
    first = Track(id=0, packets=parts(0, 0))
    strange = Track(id=1, codec="xNEW", continues=0)
    second = Track(id=2, continues=1, packets=parts(2, 8))
    rows = [[(1, 0, 12, b"what is this")], [w.packet(0, 0)], [w.packet(2, 8)]]
    laid = w.lay(HEAD, first.chunk, strange.chunk, second.chunk, *rows)
    yield spoilt(
        "continued-by-unknown-and-damage",
        "Between two tracks that continue one another is one of an unknown codec. Its packets "
        "overlap none.",
        ["TRK-011", "TRK-016", "TRK-018"], laid,
        decode_of(first, Track(id=2, continues=0, packets=parts(2, 8))), exits={"decode": [3, 4]},
        recovered={"verdict": "unsupported", "decode": {}},
    )  # fmt: skip


def chunks() -> Iterator[Case]:
    laid = w.lay(("HEAD", f.head(f.tlv(2, bytes(15)))), THREE, *w.clusters(0, 4, 8))
    yield spoilt(
        "head-broken-and-damage", "HEAD breaks a rule: nothing of it is used.",
        ["HED-002", "REC-003"], laid, WHOLE | {"head": None},
        whole(laid, "HEAD"), ("missing-head", 8, 0), recovered={"decode": WHOLE},
    )  # fmt: skip
    end = [("iNDX", b""), ("fOOT", bytes(13))]
    laid = w.lay(HEAD, THREE, *w.clusters(0, 4, 8), *end, close=False)
    yield spoilt(
        "foot-broken-and-damage", "The footer is too long: it closes the file all the same.",
        ["FOT-001", "FIL-003"], laid, WHOLE, whole(laid, "fOOT"),
    )  # fmt: skip
    laid = w.lay(HEAD, THREE, ("iNDX", f.index([]) + b"\0"), *w.clusters(0, 4, 8))
    yield spoilt(
        "index-broken-and-damage", "An index has a byte behind its last entry.",
        ["IDX-002", "REC-003"], laid, WHOLE, whole(laid, "iNDX"),
    )  # fmt: skip
    turned = [list(reversed(cluster)) for cluster in w.clusters(4)]
    laid = w.lay(HEAD, THREE, *w.clusters(0), *turned, *w.clusters(8))
    yield spoilt(
        "rows-out-of-order-and-damage", "The rows of a cluster are in the wrong order.",
        ["DAT-002", "REC-003"], laid, WHOLE, whole(laid, "DATA", 1),
    )  # fmt: skip


def verdicts() -> Iterator[Case]:
    laid = digested(WRONG, ("mETa", b"{a:1}"))
    yield wrecked(
        "digest-differs-and-a-broken-rule",
        "A rule is broken, and nothing is damaged: no digest is compared.",
        ["DGS-002", "MET-001", "VRD-001"], "structure/metadata", laid.data, decode=WHOLE,
        damages=[], verdict="nonconforming", exits={"decode": [0, 2], "verify": 2},
    )  # fmt: skip
    laid = digested(WRONG, ("ABCD", b"what"))
    yield wrecked(
        "digest-differs-and-a-critical-chunk",
        "A critical chunk is unknown: no packet is decoded, and no digest compared.",
        ["DGS-002", "CHK-009", "VRD-001"], "version/chunk", laid.data, decode={}, damages=[],
        verdict="unsupported", exits={"decode": 4, "verify": 4},
        recovered={"verdict": "unsupported"},
    )  # fmt: skip
    laid = w.lay(HEAD, THREE, *w.clusters(0, 4), ("iNDX", b""), ("fOOT", bytes(13)),
                 *w.clusters(8), close=False)  # fmt: skip
    case = wrecked(
        "foot-broken-and-not-closed", "A footer in the midst of an open file is too long.",
        ["FOT-001", "VRD-001"], "crash/not-closed", laid.data, decode=WHOLE,
        damages=[("not-closed", len(laid.data), 0)], recover=0, verdict="nonconforming",
        exits={"decode": [0, 2], "verify": 2},
    )  # fmt: skip
    # A file that cannot be opened has no damage report.
    del case.expect["verify"]
    yield case
