"""Clause 9.5: packets of LPCR."""

from __future__ import annotations

from collections.abc import Iterator

import page
from lpcr import EVEN
from luck import walk
from page import BY_BITS

from .component import Case, Component, also, tried

BOUND = 2**24
"""The count bound of level 1."""


def whole_packet(name: str, data: bytes, span: int, width: int = 1, last: int = BOUND) -> Case:
    case: Case = {"name": name, "packet": data, "span": span, "components": width, "last": last}
    return tried(case, lambda: {"indices": page.decode_packet(data, span, last, width)})


def packets() -> Component:
    slow = walk(60, 100, 6)
    other = [(3 * x) // 4 + t % 3 for t, x in enumerate(slow)]
    ks = [113, -110]
    held = [x for x in slow[:12] for _ in range(5)]
    e, p = page.encode, page.encode_packet
    rows: list[tuple] = [
        ("constant", bytes.fromhex("10000a"), 4),
        ("constant, one tick", bytes.fromhex("10000a"), 1),
        ("two ticks", bytes.fromhex("00000003180001c75f02"), 2),
        ("second differences", bytes.fromhex("020000041a9eabe06400"), 8),
        ("repeats", bytes.fromhex("08000e0020ffffff55224d297b04"), 9),
        (
            "two coefficients",
            bytes.fromhex("00 02 78 92 00 01 25 C8 30 30 B7 CB 09 51 35 00 9F 5D CC"),
            13,
        ),
        (
            "two components with a reference",
            bytes.fromhex(
                "12 00 00 00 0E 2E 00 02 60 9C C5 02 4C 78 03 3B 04 63 B0 40 00 01 00 00 20 00 00"
                " 00 08 00 23 FF F5 FF F5 5F F4 FF F5 FF F5 5F F5 9F 75 00 00"
            ),
            9,
            2,
        ),
    ]
    rows += [(f"difference order {g}", e(slow, g=g), 60) for g in range(5)]
    rows += [
        ("coefficients on first differences", e(slow, g=1, ks=ks), 60),
        ("32 coefficients", e(slow, ks=[*ks, *([7, -6] * 15)]), 60),
        ("a base", e([x + 5000 for x in slow], base=5000), 60),
        ("a negative base", e([x - 5000 for x in slow], base=-5000), 60),
        ("repeats, held", e(held, repeats=EVEN), 60),
        ("repeats with coefficients", e(held, ks=ks, repeats=EVEN), 60),
        ("repeats with differences", e(held, g=3, repeats=EVEN), 60),
        ("equal, and not constant", e([4] * 9, base=4), 9),
        ("four states", e(slow, g=1, ks=ks, states=4), 60),
        ("signs of their own", e(slow, g=2, signs=(200, 128, 40), number=7, start=30), 60),
        ("three sections", e(held, repeats=(9, 99, 199, 250), signs=(1, 2, 3), states=4), 60),
        ("by bits", e(slow, number=BY_BITS), 60),
        ("by bits, second differences", e(slow, g=2, number=BY_BITS), 60),
        ("by bits, with repeats", e(held, number=BY_BITS, repeats=EVEN), 60),
        ("by bits, one tick", e([-3], number=BY_BITS), 1),
        ("by bits, zeros", e([0] * 999 + [1, -1, 0], number=BY_BITS), 1002),
        ("largest index", e([2**24, -(2**24)]), 2),
        ("two components, no references", p([e(slow, g=1), e(other, g=2)]), 60, 2),
        (
            "constant next to four states",
            p([bytes.fromhex("10000a"), e(slow, g=2, states=4)]),
            60,
            2,
        ),
    ]
    for name, w, g, coefficients in (
        ("tick before", (64, 0, 0), 1, []),
        ("same tick", (0, 48, 0), 1, []),
        ("next tick", (0, 0, 127), 0, ks),
        ("negative weights", (-128, 77, -3), 1, ks),
        ("fourth differences", (5, 40, -9), 4, []),
    ):
        second = e(other, g=g, ks=coefficients, references=[(0, *w)], components=[slow])
        rows.append((f"a reference, {name}", p([e(slow, g=2), second]), 60, 2))
    third = [a - b for a, b in zip(slow, other, strict=True)]
    parts = [
        e(slow, g=1),
        e(other, g=1, references=[(0, 0, 48, 0)], components=[slow]),
        e(third, references=[(0, 1, 60, -2), (1, -3, -61, 4)], components=[slow, other]),
    ]
    rows.append(("two references, one of them refers itself", p(parts), 60, 3))
    rows.append(
        (
            "a reference to a constant",
            p(
                [
                    bytes.fromhex("10000a"),
                    e(slow, g=1, references=[(0, 9, 64, 9)], components=[[5] * 60]),
                ]
            ),
            60,
            2,
        )
    )
    rows.append(
        (
            "a reference to four states",
            p(
                [
                    e(slow, g=2, states=4),
                    e(other, ks=ks, repeats=EVEN, references=[(0, 1, 47, 0)], components=[slow]),
                ]
            ),
            60,
            2,
        )
    )
    rows += [(name, data, span, *rest) for name, data, span, *rest in broken(slow)]
    return Component(
        "lpcr",
        "9.5",
        (
            "LPC-001",
            "LPC-003",
            "LPC-004",
            "LPC-005",
            "LPC-006",
            "LPC-007",
            "RNG-001",
            "RNG-003",
            "RNG-004",
            "COD-001",
        ),
        "Packets of LPCR: the indices of each component, `last` being the largest magnitude.",
        also(
            [whole_packet(*row) for row in rows],
            {
                "empty": ["COD-001"],
                "one byte": ["COD-001"],
                "coefficients are missing": ["COD-001"],
                "references are missing": ["COD-001"],
                "constant, bytes left over": ["LPC-004"],
            },
        ),
    )


def broken(slow: list[int]) -> Iterator[tuple]:
    e, p = page.encode, page.encode_packet
    good = e(slow, g=1)
    yield "sizes beyond the packet", bytes.fromhex("0510000a"), 4, 2
    yield "empty", b"", 4
    yield "one byte", b"\0", 4
    yield "coefficients are missing", bytes.fromhex("000300"), 4
    yield "difference order 5", bytes.fromhex("050000"), 4
    yield "difference order 2 with a coefficient", bytes.fromhex("02010100"), 4
    yield "33 coefficients", bytes([0, 33, *bytes(33), 0]), 4
    yield "k = -128", bytes.fromhex("00018000"), 4
    for name, flags in (
        ("differences", 0x11),
        ("repeats", 0x18),
        ("bit 5", 0x30),
        ("references", 0x50),
        ("bit 7", 0x90),
    ):
        yield f"constant with {name}", bytes([flags, 0, 10]), 4
    yield "constant with a coefficient", bytes.fromhex("1001010a"), 4
    yield "constant, bytes left over", bytes.fromhex("10000a00"), 4
    yield "bit 5 of the flags", bytes.fromhex("20000016"), 2
    yield "bit 7 of the flags", bytes.fromhex("80000016"), 2
    yield "no coding", bytes.fromhex("000000"), 2
    quiet = e(slow, number=BY_BITS)
    for bit in (0, 4, 5, 7):
        yield f"by bits with bit {bit}", quiet[:3] + bytes([64 + 2**bit]) + quiet[4:], 60
    yield "by bits, a byte left over", quiet + b"\0", 60
    yield "by bits, a byte is missing", quiet[:-1], 60
    yield "by bits, one tick fewer", quiet, 59
    yield "by bits, no bytes", quiet[:4], 60
    yield "by bits, 2^34", e([0], number=BY_BITS, forge=[2**34]), 1
    yield "by bits, k is 36", e([0], number=BY_BITS, forge=[2**34 + 1]), 1
    yield "a start byte of 164", good[:4] + b"\xa4" + good[5:], 60
    yield "a probability is 0", bytes.fromhex("080000000c01000101") + bytes(4), 2
    yield "the predictor is too large", bytes([0, 32, *([127] * 32), 0]), 4
    yield "the base is not on the grid", bytes.fromhex("10008208"), 4, 1, 512
    yield "an index is not on the grid", e([0, 600]), 2, 1, 512
    yield "a byte left over", good + b"\0", 60
    yield "a byte is missing", good[:-1], 60
    yield "one tick fewer", good, 59
    yield "no references", bytes.fromhex("4000000a"), 4, 1
    yield "refers to itself", p([bytes.fromhex("10000a"), bytes.fromhex("400001010020000a")]), 4, 2
    twice = bytes([0x40, 0, 2, 0, 0, 32, 0, 0, 0, 32, 0, 10])
    yield "refers twice", p([bytes.fromhex("10000a"), twice]), 4, 2
    yield "nine references", p([bytes.fromhex("10000a"), bytes([0x40, 0, 9, *bytes(36), 0])]), 4, 2
    yield "references are missing", p([bytes.fromhex("10000a"), bytes.fromhex("40000100")]), 4, 2


def components() -> Iterator[Component]:
    yield packets()
