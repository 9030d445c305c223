"""Physical and exact values: where a shorter way gives another number (SPEC 8, 9.7)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from functools import partial

import forge as f
import page
import page_exact
import page_raw
from case import Case
from facts import Packet, Track, case_of, double_of
from luck import Luck
from page_exact import rounded

render = partial(case_of, "render")
Affine = tuple[int, int, int]

NARROW, WIDE = (-(2**23), 2**23 - 1), (-(2**31), 2**31 - 1)
WANTED = 40
"""Counts of a case for which the shorter way is wrong."""


def cases() -> Iterator[Case]:
    yield from quotients()
    yield from edges()
    yield from channels()
    yield from exact()


def raw(counts: Sequence[int], affine: Affine, *, size: int = 3, low: int = NARROW[0],
        high: int = NARROW[1], **more: object) -> Track:  # fmt: skip
    """A track of codec RAWB; its values twice: by Python, and in fractions."""
    a, b, d = affine
    for count in counts:
        value = rounded(Fraction(count * a + b, d))
        assert page_exact.bits(value) % 2**64 == double_of(count, affine)
    return Track(
        codec="RAWB", parameters=f.raw_parameters(size), tlvs=f.tlv(3, f.calibration(*affine)),
        packets=[Packet(0, list(counts), page_raw.encode([list(counts)], size))],
        calibration=affine, low=low, high=high, **more,
    )  # fmt: skip


def telling(affine: Affine, wrong: Callable[[int, Affine], Fraction], seed: int,
            reach: Sequence[int] = NARROW) -> list[int]:  # fmt: skip
    """Counts whose value comes out different the wrong way."""
    luck, found = Luck(seed), []
    a, b, d = affine
    for _ in range(200_000):
        count = luck.between(*reach)
        if wrong(count, affine) != rounded(Fraction(count * a + b, d)):
            found.append(count)
            if len(found) == WANTED:
                return found
    raise AssertionError("the shorter way is as good")


def times_scale(count: int, affine: Affine) -> Fraction:
    a, _, d = affine
    return rounded(count * rounded(Fraction(a, d)))


def by_reciprocal(count: int, affine: Affine) -> Fraction:
    a, b, d = affine
    return rounded((count * a + b) * rounded(Fraction(1, d)))


def offset_apart(count: int, affine: Affine) -> Fraction:
    a, b, d = affine
    return rounded(rounded(Fraction(count * a, d)) + rounded(Fraction(b, d)))


def rounded_twice(count: int, affine: Affine) -> Fraction:
    """As with the registers of 80 bits of a x87."""
    a, b, d = affine
    return rounded(rounded(Fraction(count * a + b, d), 64))


def single(count: int, affine: Affine) -> Fraction:
    a, b, d = affine
    return rounded(Fraction(count * a + b, d), 24, -149)


def quotients() -> Iterator[Case]:
    ways: tuple[tuple[str, str, Affine, Callable[[int, Affine], Fraction]], ...] = (
        ("scale", "Counts times A / D, rounded before, are other numbers.", (7, 0, 1000),
         times_scale),
        ("reciprocal", "The quotient is no product with 1 / D.", (3, 11, 997), by_reciprocal),
        ("offset", "B is added before the division, not behind it.", (3, 10_007, 4096 * 3 + 1),
         offset_apart),
        ("twice", "The quotient is rounded once, not to 64 bits and then to 53.",
         (2**20 + 7, 5, 999_983), rounded_twice),
        ("single", "Values are binary64, not binary32.", (1, 0, 10), single),
    )  # fmt: skip
    for number, (name, about, affine, wrong) in enumerate(ways):
        yield render(
            f"physical-{name}", about, ["VAL-003"], raw(telling(affine, wrong, number), affine)
        )


def edges() -> Iterator[Case]:
    yield render(
        "physical-zero", "Where count * A + B is 0 the value is 0.0, never -0.0.",
        ["VAL-003"], raw([0, 1, -1], (-1, 0, 3)), raw([2, -2, 0], (-5, 10, 7), id=1, channel=1),
    )  # fmt: skip
    top, low = 2**30, -(2**30)
    whole = {"size": 4, "low": low, "high": top}
    yield render(
        "physical-largest", "The sum count * A + B is 2^53 and -2^53, over several D.",
        ["VAL-001", "VAL-003"],
        *(
            raw([top, low, top - 1, low + 1], (2**23, 0, d), id=i, channel=i, **whole)
            for i, d in enumerate((1, 3, 7, 2**53 - 1))
        ), level=2,
    )  # fmt: skip
    yield render(
        "physical-even", "Integers above 2^52 that are halved and quartered: ties go to even.",
        ["VAL-003"],
        raw(list(range(-9, 10)), (2**28 + 1, 2**52 - 1, 2), low=-100, high=100),
        raw(list(range(-9, 10)), (2**29 + 1, -(2**52) + 1, 4), low=-100, high=100, id=1, channel=1),
    )  # fmt: skip
    luck = Luck(7)
    counts = [WIDE[0], WIDE[1], *(luck.between(*WIDE) for _ in range(30))]
    yield render(
        "physical-of-32-bits", "Counts of 32 bits, which binary32 does not hold.",
        ["VAL-003"], raw(counts, (3, 1, 10), size=4, low=WIDE[0], high=WIDE[1]), level=2,
    )  # fmt: skip


def channels() -> Iterator[Case]:
    """Which calibration goes with which numbers."""
    affine = (3, 100, 7)
    knots = [Packet(0, [50, 50, 60, 60], b"\x64\2\x14")]
    fast = [Packet(0, [1, -1, 70, 2], b"\0" + bytes([1, 255, 70, 2]))]
    slow = Track(
        kind="lf", tlvs=f.tlv(3, f.calibration(*affine)), calibration=affine, packets=knots,
        low=-100, high=100,
    )  # fmt: skip
    residual = Track(
        id=1, kind="hf", base=0, codec="RAWB", parameters=f.raw_parameters(1), packets=fast,
    )  # fmt: skip
    yield render(
        "physical-of-a-sum", "The value of a sum of both bands, clamped: B counts once.",
        ["DEC-001", "DEC-005", "VAL-003"], slow, residual,
    )  # fmt: skip
    rows = [(1, 2, 3), (-4, 5, 6)]
    each = [(1, 0, 10), (7, -3, 9), (-2, 5, 3)]
    body = b"\0" + bytes(number % 256 for column in zip(*rows, strict=True) for number in column)
    wide = Track(
        width=3, codec="RAWB", parameters=f.raw_parameters(1), packets=[Packet(0, rows, body)],
        tlvs=f.tlv(3, b"".join(f.calibration(*one) for one in each)), calibration=each,
    )  # fmt: skip
    yield render(
        "physical-of-components", "Each component has a calibration of its own.",
        ["TLV-004", "VAL-003"], wide,
    )  # fmt: skip
    plain = Track(packets=[Packet(0, [5, 5, 5, 5], f.KNOT_DATA)], calibration=(1, 0, 1))
    yield render(
        "physical-uncalibrated", "Without a calibration the value is the count.", ["VAL-003"], plain
    )


def lattice(counts: Sequence[int], affine: Affine, rule: int, digits: int = 0, *, id: int = 0,
            low: int = NARROW[0], high: int = NARROW[1],
            coefficients: Sequence[float] = ()) -> Track:  # fmt: skip
    """LPCX with nothing behind the counts: the values of the rule."""
    coded = page.encode(list(counts))
    body = page.varint_bytes(len(coded)) + coded
    found, words = page_exact.decode(body, len(counts), affine, rule, digits, c=coefficients)
    assert found == list(counts)
    return Track(
        id=id, channel=id, codec="LPCX",
        parameters=f.lpcx_parameters(rule, digits, bytes(2), coefficients),
        tlvs=f.tlv(3, f.calibration(*affine)), calibration=affine, low=low, high=high,
        packets=[Packet(0, list(counts), body, exact=words)],
    )  # fmt: skip


def fused(count: int, affine: Affine) -> Fraction:
    a, b, d = affine
    return rounded(count * rounded(Fraction(a, d)) + rounded(Fraction(b, d)))


def exact() -> Iterator[Case]:
    rules = ["EXA-002", "EXA-007"]

    def unlike(affine: Affine, rule: int, digits: int, seed: int,
               wrong: Callable[[int, Affine], Fraction]) -> list[int]:  # fmt: skip
        luck, found = Luck(seed), []
        for _ in range(200_000):
            count = luck.between(-(10**6), 10**6)
            if wrong(count, affine) != page_exact.value(count, *affine, rule, digits):
                found.append(count)
                if len(found) == WANTED:
                    return found
        raise AssertionError("the shorter way is as good")

    def tenth(count: int, affine: Affine) -> Fraction:
        return rounded(Fraction(count * affine[0], affine[2]))

    affine, tenths = (3, 7, 10), (1, 0, 10)
    yield render(
        "exact-product-fused", "Rule 1 rounds the product before the sum: no fused multiply-add.",
        rules, lattice(unlike(affine, 1, 0, 1, fused), affine, 1),
    )  # fmt: skip
    yield render(
        "exact-product-quotient", "Rule 1 is not the quotient.", rules,
        lattice(unlike(tenths, 1, 0, 2, tenth), tenths, 1),
    )  # fmt: skip
    bent = (1 / 3, 0.1, -1e-7, 1e-14)
    c = [Fraction(each) for each in bent]

    def fused_cubic(x: int) -> Fraction:
        return rounded(rounded(rounded(c[3] * x + c[2]) * x + c[1]) * x + c[0])

    def at_once(x: int) -> Fraction:
        return rounded(c[0] + c[1] * x + c[2] * x**2 + c[3] * x**3)

    def by_powers(x: int) -> Fraction:
        square = rounded(Fraction(x * x))
        parts = rounded(c[1] * x), rounded(c[2] * square), rounded(c[3] * rounded(square * x))
        return rounded(rounded(rounded(c[0] + parts[0]) + parts[1]) + parts[2])

    def bends(wrong: Callable[[int], Fraction], seed: int) -> list[int]:
        luck, found = Luck(seed), []
        while len(found) < WANTED:
            count = luck.between(-(10**6), 10**6)
            if wrong(count) != page_exact.value(count, 1, 0, 10, 3, 0, bent):
                found.append(count)
        return found

    for seed, (name, about, wrong) in enumerate((
        ("fused", "no fused multiply-add", fused_cubic),
        ("at-once", "not only at the end", at_once),
        ("powers", "in this order, not by powers of the count", by_powers),
    )):  # fmt: skip
        yield render(
            f"exact-cubic-{name}", f"Rule 3 rounds each product and each sum: {about}.",
            ["EXA-007", "EXA-002"], lattice(bends(wrong, seed), (1, 0, 10), 3, coefficients=bent),
        )  # fmt: skip
    tens = [10**p + i for p in range(7) for i in (-1, 0, 1)]
    yield render(
        "exact-digits-at-tens", "Rule 2 next to powers of ten: 9.9996 has four digits as 10.00.",
        rules,
        lattice(tens, (1, 0, 10), 2, 4), lattice([-n for n in tens], (1, 0, 1000), 2, 1, id=1),
        lattice(tens, (99_996, 0, 10**7), 2, 4, id=2),
    )  # fmt: skip
    yield render(
        "exact-decimals", "Rule 2 with decimals: ties, numbers that round to 0, and large ones.",
        rules,
        lattice([0, 1, -1, 5, -5, 15, 25, 12_345, -8_388_608], (1, 0, 1000), 2, 16 + 2),
        lattice([1, -1, 3, 77_777, -8_388_607], (7, 3, 30_000_001), 2, 16 + 6, id=1),
        lattice([8, 9, 9_007, 9_008, -9_008], (10**9, 1, 999), 2, 16 + 15, id=2),
        lattice([4, 5, -5, 6, 7], (1, 0, 2), 2, 16, id=3),
    )  # fmt: skip
    yield render(
        "exact-digits-above-the-point", "Rule 2 with k below 0: digits in front of the point.",
        rules, lattice([12_345, 12_355, -12_345, 99_950, 5, 0, 8_388_607], (1000, 0, 1), 2, 3),
    )  # fmt: skip
    yield render(
        "exact-digits-most", "Rule 2 of values below 10^-7: k is at most 22.",
        rules, lattice([1, -1, 3, 12_345, 0], (1, 0, 2**52 + 1), 2, 15),
    )  # fmt: skip
