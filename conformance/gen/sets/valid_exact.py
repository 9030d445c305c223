"""LPCX (SPEC 9.7): counts, and the numbers of the source next to them."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import forge as f
import page
import page_exact
from case import Case
from facts import Packet, Track, case_of
from luck import Luck

valid = partial(case_of, "valid")
uncommon = partial(case_of, "uncommon")

WIDE = (-(2**23), 2**23 - 1)
WIDEST = (-(2**31), 2**31 - 1)
QUOTIENT, PRODUCT, SIGNIFICANT, CUBIC = range(4)
NAN = float("nan")


def word(number: float | int) -> int:
    """Bits of a binary64 number, as a signed integer; an integer is its own bits."""
    if isinstance(number, int):
        return number - 2**64 * (number >= 2**63)
    return struct.unpack("<q", struct.pack("<d", number))[0]


class Source:
    """A calibration and a rule."""

    def __init__(self, affine: tuple[int, int, int] = (1, 0, 10), rule: int = QUOTIENT,
                 digits: int = 0, coefficients: Sequence[float] = ()) -> None:  # fmt: skip
        self.affine, self.rule, self.digits, self.coefficients = affine, rule, digits, coefficients

    def value(self, count: int) -> int:
        """Bits of the value of a count, signed."""
        found = page_exact.value(count, *self.affine, self.rule, self.digits, self.coefficients)
        return page_exact.bits(found)

    def packet(self, counts: Sequence[int], numbers: Sequence[float | int] | None = None, *,
               start: int = 0, recall: bool = False, g: int = 0) -> Packet:  # fmt: skip
        """Without numbers those that the rule gives."""
        words = [self.value(c) for c in counts] if numbers is None else [word(n) for n in numbers]
        coded = page.encode(list(counts), g)
        rest = page_exact.encode_exact(
            words, counts, self.affine, self.rule, self.digits,
            p=page_exact.EVEN if recall else None, c=self.coefficients,
        )  # fmt: skip
        return self.coded(page.varint_bytes(len(coded)) + coded + rest, counts, words, start)

    def coded(self, body: bytes, counts: Sequence[int], words: Sequence[int],
              start: int = 0) -> Packet:  # fmt: skip
        exact = [each % 2**64 for each in words]
        told = (len(counts), self.affine, self.rule, self.digits, 2**32, self.coefficients)
        found = page_exact.decode(body, *told)
        assert found == (list(counts), exact)
        return Packet(start, list(counts), body, exact=exact)

    def track(self, *packets: Packet, **fields: Any) -> Track:
        a, b, d = self.affine
        low, high = fields.pop("clamped", WIDE)
        return Track(
            codec="LPCX",
            parameters=f.lpcx_parameters(self.rule, self.digits, bytes(2), self.coefficients),
            tlvs=f.tlv(3, f.calibration(a, b, d)), calibration=self.affine, packets=packets,
            low=low, high=high, **fields,
        )  # fmt: skip


def joint(*components: page_exact.Component, rows: Sequence[Sequence[int]],
          numbers: Sequence[Sequence[float | int]], **fields: Any) -> Track:  # fmt: skip
    """``rows``: the counts of each component, ``numbers``: the doubles."""
    words = [[word(n) for n in column] for column in numbers]
    body = page_exact.encode_components(words, rows, components, fields.pop("recall", False))
    found = page_exact.decode_components(body, len(rows[0]), components)
    exact = [[w % 2**64 for w in column] for column in words]
    assert found == ([list(row) for row in rows], exact)
    packet = Packet(0, list(zip(*rows, strict=True)), body, exact=list(zip(*exact, strict=True)))
    affines = [each.affine for each in components]
    parameters = [
        f.lpcx_parameters(each.rule, each.digits, bytes(2), each.c, each.terms)
        for each in components
    ]
    return Track(
        codec="LPCX", parameters=b"".join(parameters), width=len(components), calibration=affines,
        tlvs=f.tlv(3, b"".join(f.calibration(*affine) for affine in affines)),
        packets=[packet], low=WIDE[0], high=WIDE[1], **fields,
    )  # fmt: skip


def linear_cases() -> Iterator[Case]:
    luck = Luck(77)
    sensor = [luck.between(-900, 900) for _ in range(60)]
    raw, filtered = [c / 10 for c in sensor], [0.0]
    for t in range(1, len(raw)):
        filtered.append(0.685 * filtered[t - 1] + 0.315 * raw[t])
    quotient = page_exact.Component((1, 0, 10))
    coarse = page_exact.Component((1, 0, 4))

    def linear(c0: float, *terms: tuple[int, int, float]) -> page_exact.Component:
        return coarse._replace(rule=4, c=(c0,), terms=terms)

    def near(column: Sequence[float]) -> list[int]:
        return [round(4 * x) for x in column]

    scaled = [1.5 - 2.25 * x for x in raw]
    delayed = [0.0, *(x / 3 for x in raw[:-1])]
    yield valid(
        "lpcx-components", "Two components, each with a rule of its own; one has no corrections.",
        ["EXA-003", "EXA-007"],
        joint(quotient, page_exact.Component((1, 0, 7), 1), rows=[sensor, sensor],
              numbers=[raw, [x * (1 / 7) + 1e-9 for x in sensor]]),
        joint(quotient, quotient, rows=[sensor, sensor[::-1]], numbers=[raw, raw[::-1]], id=1,
              channel=2),
    )  # fmt: skip
    yield valid(
        "lpcx-linear", "A channel, itself filtered, scaled, and one tick late.",
        ["EXA-002", "EXA-007"],
        joint(quotient, linear(0.0, (1, 1, 0.685), (0, 0, 0.315)), linear(1.5, (0, 0, -2.25)),
              linear(0.0, (0, 1, 1 / 3)),
              rows=[sensor, near(filtered), near(scaled), near(delayed)],
              numbers=[raw, filtered, scaled, delayed]),
    )  # fmt: skip
    yield valid(
        "lpcx-linear-first", "A linear component comes before the one that it is linear in.",
        ["EXA-002", "EXA-007"],
        joint(linear(0.0, (0, 1, 0.685), (2, 0, 0.315)), linear(1.5, (2, 0, -2.25)), quotient,
              rows=[near(filtered), near(scaled), sensor], numbers=[filtered, scaled, raw],
              recall=True),
    )  # fmt: skip
    lost = [0.0, -0.0, float("inf"), 1e308, -1e308, NAN, 5e-324, 3.0]
    wide = [0] * len(lost)
    yield valid(
        "lpcx-linear-not-finite", "Sums that are not finite, -0.0, and lags beyond the packet.",
        ["EXA-002", "EXA-007"],
        joint(quotient, linear(-0.0, (0, 0, 2.0), (0, 0, 0.5)), linear(0.0, (2, 200, 1.0)),
              linear(-0.0, (3, 1, -3.0)),
              rows=[wide, wide, near([1.5] * 8), [1, *wide[1:]]],
              numbers=[lost, [0.25, -0.0, 7.0, 1e308, 0.0, NAN, 5e-324, 7.5], [1.5] * 8,
                       [0.25, -0.75, 2.25, 0.0, -0.0, float("inf"), 2.0, -6.0]]),
    )  # fmt: skip


def cases() -> Iterator[Case]:
    yield from examples()
    yield from rules()
    yield from corrections()


def examples() -> Iterator[Case]:
    counts = [1, 2, 3, 3, 7, 3]
    short = "0C 00 00 00 0D 1E 00 01 A3 57 66 5B 00"
    told = [0.1, 0.2, 0.3, 0.3, 0.7, 0.3]
    odd = [0.1, 0.2, 0.30000000000000004, 0.30000000000000004, 0.7000000000000001]
    odd.append(0.30000000000000004)
    far = [0.1, 0.25, 1 / 3, 0.3, 0.7, -0.0]
    rest = (
        " 00 01 00 3E FF 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"
        " 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 55 55 00"
        " 00 00 00 00 00 00 00 00 00 55 07 62 84 3B FF 4C CC CC CC CC CC D0 44 44 44 44 44 45"
        " 33 33 33 33 33 33"
    )
    tenths, product = Source(), Source(rule=PRODUCT)
    rows = [
        (tenths, short, told),
        (product, short, odd),
        (tenths, short + " 01 00 01 80 01 FF 01 FF 01 01 FF 00 10 1B 20 00", odd),
        (tenths, short + rest, far),
    ]
    tracks = [
        source.track(
            source.coded(bytes.fromhex(body), counts, [word(n) for n in numbers]), id=i, channel=i
        )
        for i, (source, body, numbers) in enumerate(rows)
    ]
    yield valid(
        "lpcx-examples", "The packets that the page of LPCX shows.", ["EXA-003", "EXA-007"],
        *tracks,
    )  # fmt: skip


def rules() -> Iterator[Case]:
    counts = [0, 1, -1, 3, 7, -7, 99, 1234, -65_537, 8_000_000]
    for name, about, sources in (
        ("quotient", "The value is the quotient, rounded once.",
         [Source((1, 0, 10)), Source((-3, 7, 9)), Source((2**28 + 1, -5, 2**52 - 1))]),
        ("product", "Rule 1: the product rounded, then the sum rounded, never as one.",
         [Source((1, 0, 10), PRODUCT), Source((3, 1, 7), PRODUCT), Source((-1, 5, 49), PRODUCT)]),
        ("significant", "Rule 2: rounded to significant digits, of small and large values.",
         [Source((1, 0, 3), SIGNIFICANT, 6), Source((1, 0, 3), SIGNIFICANT, 1),
          Source((2**28, 1, 3), SIGNIFICANT, 4), Source((1, 0, 2**40), SIGNIFICANT, 15)]),
        ("cubic", "Rule 3: a polynomial of degree 3, each product and each sum rounded.",
         [Source((1, 0, 3277), CUBIC, 0, DEVICE), Source((1, 0, 10), CUBIC, 0, BENT),
          Source((1, 0, 1), CUBIC, 0, (-0.0, 0.0, -0.0, 0.0))]),
    ):  # fmt: skip
        yield valid(
            f"lpcx-rule-{name}", about, ["EXA-002", "EXA-007", "VAL-003"],
            *(s.track(s.packet(counts), id=i, channel=i) for i, s in enumerate(sources)),
        )  # fmt: skip
    tiny, large = (
        Source((1, 0, 2**52 - 1), SIGNIFICANT, 15),
        Source((2**28, 2**50, 3), SIGNIFICANT, 4),
    )
    yield uncommon(
        "lpcx-rule-ends", "Small values, where k is at most 22, large ones, where it is below 0.",
        ["EXA-002"],
        tiny.track(tiny.packet(counts)), large.track(large.packet(counts), id=1, channel=1),
    )  # fmt: skip


DEVICE = (-0.000312, 0.00030517633, 2.1e-15, -3.3e-20)
"""Of a converter of 16 bits and 10 V: a line misses it by less than a hundredth of its step."""

BENT = (1 / 3, 0.1, -1e-7, 1e-14)


def corrections() -> Iterator[Case]:
    tenths = Source()
    device, luck = Source((1, 0, 3277), CUBIC, 0, DEVICE), Luck(54)
    read = [luck.between(-(2**15), 2**15 - 1) for _ in range(40)]
    beside = [page_exact.word_at(page_exact.place(device.value(c)) + luck.choice((0, 0, 1, -1, 2)))
              for c in read]  # fmt: skip
    yield valid(
        "lpcx-cubic-near", "Doubles that miss a polynomial by up to 2 numbers.",
        ["EXA-002", "EXA-007"],
        device.track(
            device.packet(read, beside), device.packet(read, beside, recall=True, start=40)
        ),
    )  # fmt: skip
    yield valid(
        "lpcx-no-corrections", "Nothing follows the counts: every correction is 0.",
        ["EXA-003"],
        tenths.track(tenths.packet(list(range(-8, 9)), g=1)),
    )  # fmt: skip
    body = bytes([3]) + bytes.fromhex("10 00 0A")
    four = page.encode([3, -4, 5, 8], states=4)
    values = [tenths.value(c) for c in (5, 3, -4, 5, 8)]
    yield valid(
        "lpcx-constant-and-four-states", "Counts as a constant packet, and with four states.",
        ["EXA-003"],
        tenths.track(
            tenths.coded(body, [5] * 4, values[:1] * 4, 0),
            tenths.coded(page.varint_bytes(len(four)) + four, [3, -4, 5, 8], values[1:], 4),
        ),
    )  # fmt: skip
    far = Source((2**21 + 1, 7, 10**6))
    counts = [-(2**31), 2**31 - 1, 0, 12345]
    yield uncommon(
        "lpcx-level-2", "Counts of 32 bits at level 2, whose values are quotients near 2^53.",
        ["EXA-003", "VAL-003", "LIM-001"],
        far.track(far.packet(counts), clamped=WIDEST), level=2,
    )  # fmt: skip
    luck = Luck(53)
    counts = [luck.between(-40, 39) for _ in range(120)]
    near = [page_exact.word_at(page_exact.place(tenths.value(c)) + luck.between(-9, 9))
            for c in counts]  # fmt: skip
    yield valid(
        "lpcx-near", "Doubles that miss the lattice by up to 9 numbers, coded in full.",
        ["RNG-001", "EXA-007"],
        tenths.track(tenths.packet(counts, near)),
    )  # fmt: skip
    away = {c: luck.choice((0, 0, 1, -1, 2)) for c in range(-40, 40)}
    again = [page_exact.word_at(page_exact.place(tenths.value(c)) + away[c]) for c in counts]
    yield valid(
        "lpcx-recall", "Every count comes with the same correction again, coded by its rank.",
        ["EXA-003", "EXA-007"],
        tenths.track(tenths.packet(counts, again, recall=True)),
    )  # fmt: skip
    few = [luck.choice((3, 3, 4)) for _ in range(150)]
    lists = [page_exact.word_at(page_exact.place(tenths.value(c)) + luck.choice((0, 5, -7, 9)))
             for c in few]  # fmt: skip
    yield valid(
        "lpcx-recall-ranks", "A few counts with a few corrections each, the last one first.",
        ["EXA-007"],
        tenths.track(tenths.packet(few, lists, recall=True)),
    )  # fmt: skip
    order = [*range(40), *range(39, 30, -1), 0, 1, 8, 7, 39, 2]
    full = [page_exact.word_at(page_exact.place(tenths.value(6)) + 1 + c) for c in order]
    yield uncommon(
        "lpcx-recall-33", "More than 32 corrections of one count: the oldest ones are forgotten.",
        ["EXA-007"],
        tenths.track(tenths.packet([6] * len(full), full, recall=True)),
    )  # fmt: skip
    fine = Source((1, 0, 2**20))
    doubles = [luck.bell(2**52) / 2**52 for _ in range(60)]
    nearest = [round(x * 2**20) for x in doubles]
    yield valid(
        "lpcx-binary-grid", "Doubles of any kind on a binary grid.", ["EXA-003", "EXA-007"],
        fine.track(fine.packet(nearest, doubles)),
    )  # fmt: skip
    yield valid(
        "lpcx-binary-grid-recall", "The same twice: the second time they are recalled.",
        ["EXA-003", "EXA-007"],
        fine.track(fine.packet(nearest * 2, doubles * 2, recall=True)),
    )  # fmt: skip
    singles = [struct.unpack("<f", struct.pack("<f", x))[0] for x in doubles]
    yield valid(
        "lpcx-shifted", "Doubles that were binary32: corrections in steps of 2^29.",
        ["EXA-003", "EXA-007"],
        fine.track(
            fine.packet([round(x * 2**20) for x in singles], singles),
        ),
    )  # fmt: skip
    odd: list[float | int] = [0.1, NAN, float("inf"), float("-inf"), -0.0, 0.0, 5e-324, -1e308]
    odd += [0xFFF8000000000001, 0x7FF0000000000001, -2, 1]
    yield valid(
        "lpcx-not-finite", "NaN, infinities, both zeros and subnormals, every bit of them.",
        ["EXA-007"],
        tenths.track(tenths.packet([1, *[0] * (len(odd) - 1)], odd)),
        tenths.track(tenths.packet([1, *[0] * (len(odd) - 1)], odd, recall=True),
                     id=1, channel=1),
    )  # fmt: skip
    dying = [math.ldexp(1.37, -20 * i) for i in range(1, 51)]
    yield uncommon(
        "lpcx-dying", "A signal that dies away: corrections above bit 52.",
        ["EXA-007"],
        fine.track(fine.packet([round(x * 2**20) for x in dying], dying)),
        fine.track(
            fine.packet([round(x * 2**20) for x in dying * 3], dying * 3, recall=True),
            id=1, channel=1,
        ),
    )  # fmt: skip
    flipped = [page_exact.word_at(page_exact.place(tenths.value(c)) + 2**63) for c in (0, 1, 2)]
    yield uncommon(
        "lpcx-farthest", "A correction of 2^63, which can be coded in steps of 2^63 only.",
        ["EXA-007"],
        tenths.track(farthest(tenths, [0, 1, 2], flipped)),
    )  # fmt: skip
    yield from linear_cases()
    yield valid(
        "lpcx-two-packets", "What one packet recalls, the next one does not; and a gap.",
        ["DAT-007", "EXA-007"],
        tenths.track(
            tenths.packet([6, 6, 7], again_of(tenths, [6, 6, 7], 3), recall=True),
            tenths.packet([6, 6, 7], again_of(tenths, [6, 6, 7], 3), recall=True, start=5),
        ),
    )  # fmt: skip


def again_of(source: Source, counts: list[int], away: int) -> list[int]:
    return [page_exact.word_at(page_exact.place(source.value(c)) + away) for c in counts]


def farthest(source: Source, counts: list[int], words: list[int]) -> Packet:
    """z = 63, corrections of 1: L = 1, a raw bit each, which says + and - by turns."""
    ones = [1 if i % 2 == 0 else -1 for i in range(len(counts))]
    rest = page_exact.build_exact(ones, counts, 63, None, (1, [1]))
    coded = page.encode(counts)
    body = page.varint_bytes(len(coded)) + coded
    return source.coded(body + rest, counts, [word(w) for w in words])
