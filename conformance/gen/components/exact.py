"""Clause 9.7: values of counts, places, corrections, packets of LPCX; bits as hexadecimal."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from math import inf

import page
import page_exact
from luck import Luck
from page import varint_bytes

from .component import Case, Component, also, tried

RULES = ("quotient", "product", "significant digits", "cubic")


CUBICS = {
    "a device of 10 V": (-0.000312, 0.00030517633, 2.1e-15, -3.3e-20),
    "a bend that shows": (1 / 3, 0.1, -1e-7, 1e-14),
    "zeros": (-0.0, 0.0, -0.0, 0.0),
    "large ones": (-1e250, 1e260, -1e240, 1e230),
    "next to the least": (0.0, 5e-324, 0.0, -5e-324),
}


def word(number: float) -> str:
    """Its bits, the highest first."""
    return struct.pack(">d", number).hex()


def hexed(words: list[int]) -> list[str]:
    return [f"{w % 2**64:016x}" for w in words]


def values() -> Component:
    counts = (0, 1, -1, 2, 3, 7, -7, 10, 123, -4567, 99999, 2**23 - 1, -(2**23), 2**24)
    affine = (
        (1, 0, 10),
        (1, 0, 1),
        (1, 0, 3),
        (3, 0, 7),
        (-1, 0, 100),
        (5, -3, 1000),
        (1, 1, 2),
        (1, 2**40, 2**13),
        (2**29, 0, 1),
        (1, 0, 2**52),
        (9806650, 123, 2**26 - 5),
    )
    rules = [(0, 0), (1, 0)] + [(2, k) for k in (1, 2, 3, 6, 9, 15)]
    cases: list[Case] = []
    for a, b, d in affine:
        for rule, digits in rules:
            found = [page_exact.bits(page_exact.value(c, a, b, d, rule, digits)) for c in counts]
            cases.append(
                {
                    "name": f"({a} c + {b}) / {d}, {RULES[rule]}"
                    + (f", {digits}" if rule == 2 else ""),
                    "calibration": [a, b, d],
                    "rule": rule,
                    "digits": digits,
                    "counts": counts,
                    "values": hexed(found),
                }
            )
    for name, coefficients in CUBICS.items():
        found = [page_exact.bits(page_exact.value(c, 1, 0, 1, 3, 0, coefficients)) for c in counts]
        cases.append(
            {
                "name": f"cubic, {name}",
                "calibration": [1, 0, 1],
                "rule": 3,
                "digits": 0,
                "coefficients": [word(each) for each in coefficients],
                "counts": counts,
                "values": hexed(found),
            }
        )
    for name, a, b, d, rule, digits, c in (
        ("halfway to even, downwards", 2**52 - 1, 0, 2**52, 0, 0, 2),
        ("a tie of s: to even", 1, 0, 2, 2, 1, 5),
        ("another tie of s: to even", 1, 0, 2, 2, 1, 3),
        ("a tie of s below 0: to even", 1, 0, 2, 2, 1, -5),
        ("k below 0", 1000, 0, 1, 2, 2, 12345),
        ("k at most 22", 1, 0, 2**52, 2, 15, 1),
        ("p at a power of ten", 1, 0, 100, 2, 3, 1000),
        ("p just below it", 1, 0, 1000, 2, 3, 9999),
    ):
        found = page_exact.bits(page_exact.value(c, a, b, d, rule, digits))
        cases.append(
            {
                "name": name,
                "calibration": [a, b, d],
                "rule": rule,
                "digits": digits,
                "counts": [c],
                "values": hexed([found]),
            }
        )
    return Component(
        "exact-values",
        "9.7, 8",
        ("VAL-003", "EXA-002"),
        "The value v of counts by the rules of 9.7, as the bits of binary64 (16 hexadecimal "
        "digits, "
        "highest first). Rule 0 is also VAL-003. Rule 3 has coefficients c0 to c3, as bits too.",
        cases,
    )


def places() -> Component:
    numbers = (
        0.0,
        -0.0,
        1.0,
        -1.0,
        5e-324,
        -5e-324,
        2.2250738585072014e-308,
        0.1,
        -0.3,
        1e300,
        1.7976931348623157e308,
        float("inf"),
        float("-inf"),
    )
    cases = []
    for number in numbers:
        (b,) = struct.unpack(">q", struct.pack(">d", number))
        cases.append(
            {"name": repr(number), "bits": word(number), "place": str(page_exact.place(b))}
        )
    for name, w in (("a NaN", 0x7FF8000000000000), ("a negative NaN", 0xFFF8000000000001)):
        b = w - 2**64 if w >= 2**63 else w
        cases.append({"name": name, "bits": f"{w:016x}", "place": str(page_exact.place(b))})
    moves = (
        (0.0, 1),
        (0.0, -1),
        (0.1, 3),
        (1.0, -(2**52)),
        (-0.0, 1),
        (5e-324, -2),
        (1.5, 2**62),
        (-1.5, -(2**62)),
        (1.0, 2**63 - 1),
        (1e300, -(2**63) + 1),
    )
    for number, c in moves:
        (b,) = struct.unpack(">q", struct.pack(">d", number))
        found = page_exact.word_at(page_exact.place(b) + c)
        cases.append(
            {
                "name": f"{number!r} and {c} further",
                "bits": word(number),
                "correction": str(c),
                "exact": f"{found:016x}",
            }
        )
    return Component(
        "places",
        "9.7",
        ("EXA-006",),
        "The place of a binary64 number in their order; and the number that lies a correction "
        "further, "
        "modulo 2^64.",
        cases,
    )


def packet(counts, words, affine, rule=0, digits=0, *, recall) -> bytes:
    inner = page.encode(counts)
    p = page_exact.EVEN if recall else None
    rest = page_exact.encode_exact(words, counts, affine, rule, digits, p=p)
    return varint_bytes(len(inner)) + inner + rest


def signed_bits(numbers: list[float]) -> list[int]:
    return list(struct.unpack(f"<{len(numbers)}q", struct.pack(f"<{len(numbers)}d", *numbers)))


def packets() -> Component:
    tenth, examples = (1, 0, 10), "0C 00 00 00 0D 1E 00 01 A3 57 66 5B 00"
    sums = [1, 2, 3, 3, 7, 3]
    again = " 01 00 01 80 01 FF 01 FF 01 01 FF 00 10 1B 20 00"
    long = (
        " 00 01 00 3E FF 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"
        " 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 55 55 00"
        " 00 00 00 00 00 00 00 00 00 55 07 62 84 3B FF 4C CC CC CC CC CC D0 44 44 44 44 44 45"
        " 33 33 33 33 33 33"
    )
    rows: list[tuple] = [
        ("quotient alone", tenth, 0, 0, 6, bytes.fromhex(examples)),
        ("product alone", tenth, 1, 0, 6, bytes.fromhex(examples)),
        ("corrections", tenth, 0, 0, 6, bytes.fromhex(examples + again)),
        ("far away", tenth, 0, 0, 6, bytes.fromhex(examples + long)),
    ]
    rng = Luck(12)
    counts = [rng.bell(40) for _ in range(60)]
    near = [
        struct.unpack("<q", struct.pack("<d", c / 10))[0] + rng.choice([0, 0, 1, -1, 2]) if c else 0
        for c in counts
    ]
    real = signed_bits([c / 10 + rng.between(-(10**6), 10**6) / 2e7 for c in counts])
    coarse = signed_bits([struct.unpack("<f", struct.pack("<f", c / 10 + 0.01))[0] for c in counts])
    for recall in (False, True):
        how = "recall" if recall else "no flags"
        for name, words in (("near", near), ("any numbers", real), ("binary32, z > 0", coarse)):
            data = packet(counts, words, tenth, recall=recall)
            rows.append((f"{name}, {how}", tenth, 0, 0, 60, data))
    cycle = [c % 3 for c in range(120)]
    words = [
        struct.unpack("<q", struct.pack("<d", c / 10))[0] + i % 34 if c else i % 2
        for i, c in enumerate(cycle)
    ]
    data = packet(cycle, words, tenth, recall=True)
    rows.append(("a list of more than 32", tenth, 0, 0, 120, data))
    held = [5] * 40
    words = [struct.unpack("<q", struct.pack("<d", 0.5))[0] + i % 35 - 5 for i in range(40)]
    data = packet(held, words, tenth, recall=True)
    rows.append(("one count, more than 32 corrections", tenth, 0, 0, 40, data))
    special = [*signed_bits([inf, -inf, -0.0, 0.0, 5e-324]), 0x7FF8000000000001]
    data = packet(sums, special, tenth, recall=False)
    rows.append(("infinities, NaN, -0.0", tenth, 0, 0, 6, data))
    data = packet(counts, near, tenth, 2, 9, recall=True)
    rows.append(("significant digits", tenth, 2, 9, 60, data))
    good, n = bytes.fromhex(examples + again), 13
    rows += [
        ("the counts beyond the packet", tenth, 0, 0, 6, bytes.fromhex("09 00 00 06 01")),
        ("an unknown flag", tenth, 0, 0, 6, good[:n] + b"\4" + good[n + 1 :]),
        ("z = 64", tenth, 0, 0, 6, good[: n + 1] + b"\x40" + good[n + 2 :]),
        ("ends after the flags", tenth, 0, 0, 6, good[: n + 1]),
        ("a byte is missing", tenth, 0, 0, 6, good[:-1]),
        ("a byte left over", tenth, 0, 0, 6, good + b"\0"),
        ("another state", tenth, 0, 0, 6, good[:-1] + bytes([good[-1] ^ 1])),
        ("33 probabilities", tenth, 0, 0, 6, good[: n + 2] + b"\x21" + good[n + 3 :]),
        ("a probability is 0", tenth, 0, 0, 6, good[: n + 3] + b"\0" + good[n + 4 :]),
        ("no length", tenth, 0, 0, 6, good[: n + 9] + b"\0" + good[n + 10 :]),
        ("no weight", tenth, 0, 0, 6, good[: n + 10] + b"\0" + good[n + 11 :]),
    ]
    cases = [exact_case(*row) for row in rows]
    return Component(
        "lpcx",
        "9.7",
        ("EXA-003", "EXA-006", "RNG-001", "RNG-004"),
        "Packets of LPCX: the counts, and the exact values as the bits of binary64. With `error` "
        "and "
        "`counts` the counts are given all the same (EXA-006).",
        also(
            cases,
            {
                "ends after the flags": ["COD-001"],
                "a byte is missing": ["COD-001"],
                "the counts beyond the packet": ["COD-001"],
                "a byte left over": ["COD-001"],
            },
        ),
    )


def exact_case(name: str, affine, rule: int, digits: int, span: int, data: bytes) -> Case:
    case: Case = {
        "name": name,
        "calibration": affine,
        "rule": rule,
        "digits": digits,
        "span": span,
        "packet": data,
    }
    shown: Case = {}

    def run() -> Case:
        n, at = page.varint(data, 0)
        if n > len(data) - at:
            raise page.BrokenRule("EXA-003")
        shown["counts"] = page.decode(data[at : at + n], span, 2**24)
        words = page_exact.decode_exact(data[at + n :], shown["counts"], affine, rule, digits)
        return {"counts": shown["counts"], "exact": hexed(words)}

    out = tried(case, run)
    return {**case, **shown, **out}


def components() -> Iterator[Component]:
    yield values()
    yield places()
    yield packets()
