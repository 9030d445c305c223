"""Clauses 9.1 and 9.6: knots in varints and entropy coded, and the lines between them."""

from __future__ import annotations

from collections.abc import Iterator

import page
import page_knots
from luck import Luck
from page import BrokenRule, signed, varint

from .component import Case, Component, also, tried

BOUND = 2**24

Knots = list[tuple[int, list[int]]]


def parse(data: bytes, linear: bool, step: int, span: int, width: int) -> Knots:
    """(tick, indices) of each knot of a packet in varints at level 1."""
    out: Knots = []
    at, tick, row = 0, 0, [0] * width
    try:
        while at < len(data):
            if out:
                gap, at = varint(data, at)
                if gap < 1:
                    raise BrokenRule("KNT-003")
                tick += gap
            for i in range(width):
                if at == len(data):
                    raise BrokenRule("KNT-002")
                number, at = varint(data, at)
                row[i] += signed(number)
            if any(abs(index) * step > BOUND for index in row):
                raise BrokenRule("LPC-003")
            out.append((tick, list(row)))
    except BrokenRule as broken:
        if broken.args[0] == "CNV-002" and len(data) > 0 and data[-1] >= 128:
            raise BrokenRule("KNT-002", "CNV-002") from None
        raise
    if not out:
        raise BrokenRule("KNT-002")
    ticks = [tick for tick, _ in out]
    if ticks[-1] >= span:
        raise BrokenRule("KNT-003")
    if linear and len(out) > 1 and ticks[-1] != span - 1:
        raise BrokenRule("KNT-003")
    return out


def drawn(knots: Knots, linear: bool, span: int) -> list[list[int]]:
    """The counts of each component, tick by tick."""
    return [
        page_knots.between([(tick, row[i]) for tick, row in knots], span, int(linear))
        for i in range(len(knots[0][1]))
    ]


def stored(*knots: tuple[int, list[int]]) -> bytes:
    """The packet of (tick, values)."""
    return page_knots.encode(list(knots))


def plain_knots() -> Component:
    rng = Luck(8)
    ticks = sorted({rng.between(1, 78) for _ in range(12)})
    many = [(0, [7, -3])] + [(t, [rng.between(-99, 99), rng.between(-9, 9)]) for t in ticks]
    rows: list[tuple] = [
        ("one knot", "hold", 1, 5, stored((0, [7]))),
        ("one knot, linear", "linear", 1, 5, stored((0, [-7]))),
        ("the first example", "hold", 25, 8, bytes.fromhex("080302")),
        ("held", "hold", 1, 9, stored((0, [1]), (4, [5]), (8, [-2]))),
        ("held, two components", "hold", 3, 80, stored(*many), 2),
        ("a line upwards", "linear", 1, 9, stored((0, [0]), (8, [3]))),
        (
            "a line downwards: ties towards plus infinity",
            "linear",
            1,
            9,
            stored((0, [0]), (8, [-4])),
        ),
        ("a line upwards with ties", "linear", 1, 9, stored((0, [0]), (8, [4]))),
        ("below 0, thirds", "linear", 1, 7, stored((0, [-1]), (3, [-2]), (6, [-9]))),
        ("lines, two components", "linear", 1, 80, stored(*many, (79, [0, 0])), 2),
        ("the largest counts", "linear", 1, 9, stored((0, [2**24]), (8, [-(2**24)]))),
        ("the largest step", "hold", 2**24, 2, stored((0, [1]), (1, [-1]))),
        ("every tick a knot", "linear", 1, 4, stored((0, [3]), (1, [-3]), (2, [9]), (3, [0]))),
        ("no knot", "hold", 1, 4, b""),
        ("two of three components", "hold", 1, 4, stored((0, [1, 2])), 3),
        ("a tick without a value", "hold", 1, 4, stored((0, [1])) + b"\1"),
        ("ends within a varint", "hold", 1, 4, stored((0, [1])) + b"\1\x80"),
        ("the same tick again", "hold", 1, 4, stored((0, [1])) + b"\0\2"),
        ("too large a count", "hold", 1, 4, stored((0, [2**24 + 1]))),
        ("too large with its step", "hold", 25, 4, stored((0, [2**20]))),
        ("held, at the end of the span", "hold", 1, 4, stored((0, [1]), (4, [2]))),
        ("a line that ends early", "linear", 1, 9, stored((0, [1]), (7, [2]))),
        ("a knot behind the end", "linear", 1, 5, stored((0, [1]), (4, [2]), (9, [3]))),
        ("two knots in a span of one tick", "linear", 1, 1, stored((0, [3]), (5, [9]))),
    ]
    cases = []
    for name, interpolation, step, span, data, *width in rows:
        count, linear = (width or [1])[0], interpolation == "linear"

        def run(data=data, linear=linear, step=step, span=span, count=count) -> Case:
            knots = parse(data, linear, step, span, count)
            scaled = [(tick, [index * step for index in row]) for tick, row in knots]
            counts = drawn(scaled, linear, span)
            assert counts == page_knots.decode(data, count, span, int(linear), step)
            return {"knots": scaled, "counts": counts}

        cases.append(
            tried(
                {
                    "name": name,
                    "interpolation": interpolation,
                    "step": step,
                    "span": span,
                    "components": count,
                    "packet": data,
                },
                run,
            )
        )
    return Component(
        "knot",
        "9.1",
        ("KNT-002", "KNT-003", "LPC-003", "CNV-001", "COD-001"),
        "Packets of KNOT in varints at level 1, on the uniform grid of `step` and zero 0: knots as "
        "[tick, [count of each component]], and the counts of each component before they are "
        "clamped.",
        also(
            cases,
            {
                "no knot": ["COD-001"],
                "two of three components": ["COD-001"],
                "a tick without a value": ["COD-001"],
                "ends within a varint": ["COD-001"],
            },
        ),
    )


def coded_knots() -> Component:
    rng = Luck(11)
    ticks = sorted({rng.between(1, 198) for _ in range(25)})
    many = [(0, [7])] + [(t, [rng.between(-99, 99)]) for t in ticks]
    three = [(t, [row[0], -row[0] // 7, rng.choice([0, 0, 5])]) for t, row in many]
    twenty = [(t, [row[0] % (i + 2) // (i + 1) for i in range(20)]) for t, row in many]
    e = page.encode_knots
    rows: list[tuple] = [
        ("one knot", "linear", 7, bytes.fromhex("09")),
        ("two, linear", "linear", 9, bytes.fromhex("02010040c000")),
        ("four, held", "hold", 40, bytes.fromhex("0e03029260bc210001")),
        ("four, linear", "linear", 31, bytes.fromhex("0003393503082100cc")),
        ("two components", "hold", 20, bytes.fromhex("0204010010c25f69052d"), 2),
        ("many, held", "hold", 200, e(many, False)),
        ("many, linear", "linear", 200, e([*many, (199, [4])], True)),
        ("three components", "hold", 200, e(three, False), 3),
        ("twenty components", "hold", 200, e(twenty, False), 20),
        ("gaps of 1", "hold", 40, e([(t, [t * t]) for t in range(40)], False)),
        ("equal values", "linear", 9, e([(0, [5]), (4, [5]), (8, [5])], True)),
        (
            "large differences",
            "hold",
            9,
            e([(0, [-(2**24)]), (1, [2**24]), (5, [-(2**24)]), (8, [0])], False),
        ),
        ("a long gap", "hold", 2**20, e([(0, [1]), (2**20 - 1, [2])], False)),
    ]
    good = e(many, False)
    rows += [
        ("no bytes", "hold", 9, b""),
        ("f = 0", "hold", 9, bytes.fromhex("0900")),
        ("f = span", "hold", 4, bytes.fromhex("090400")),
        ("the first index is not on the grid", "hold", 9, page.svarint_bytes(2**24 + 1)),
        ("an index is not on the grid", "hold", 9, e([(0, [2**24]), (3, [2**24 + 1])], False)),
        ("a tick beyond the span", "hold", 9, e([(0, [1]), (9, [2])], False)),
        (
            "no room for the knots that follow",
            "hold",
            9,
            e([(0, [1]), (8, [2]), (9, [3])], False),
        ),
        ("a magnitude of 35 bits", "hold", 9, e([(0, [0]), (3, [2**34])], False)),
        ("k is 36", "hold", 9, e([(0, [0]), (3, [2**34 + 1])], False)),
        ("a gap of 35 bits", "hold", 9, e([(0, [0]), (2**34 + 1, [3])], False)),
        ("a byte left over", "hold", 200, good + b"\0"),
        ("a byte is missing", "hold", 200, good[:-1]),
        ("only the count is there", "hold", 200, bytes.fromhex("0905")),
    ]
    cases = []
    for name, interpolation, span, data, *width in rows:
        count, linear = (width or [1])[0], interpolation == "linear"

        def run(data=data, linear=linear, span=span, count=count) -> Case:
            knots = page.decode_knots(data, linear, span, count, BOUND)
            shown = {"knots": knots}
            return shown | ({"counts": drawn(knots, linear, span)} if span <= 200 else {})

        cases.append(
            tried(
                {
                    "name": name,
                    "interpolation": interpolation,
                    "span": span,
                    "components": count,
                    "last": BOUND,
                    "packet": data,
                },
                run,
            )
        )
    return Component(
        "coded-knots",
        "9.6",
        ("KTE-004", "LPC-003", "RNG-001", "RNG-003", "CNV-001", "COD-001"),
        "Packets of KNOT with entropy coding, on the uniform grid of step 1 and zero 0 at level "
        "1: knots as [tick, [index of each component]], and where the span is short the counts of "
        "each component.",
        also(
            cases,
            {
                "no bytes": ["COD-001"],
                "a byte is missing": ["RNG-001"],
            },
        ),
    )


def components() -> Iterator[Component]:
    yield plain_knots()
    yield coded_knots()
