"""SPEC 9.4 to 9.7: adaptive and Rice coding, packets of LPCR, coded knots, LPCX."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from math import inf, nan
from typing import Any

import broken
import forge as f
import page
from broken import FIVES, packed
from case import Case

BOUND = 2**24


def predicted(packet: bytes, span: int = 1, **grid: int) -> bytes:
    return packed(b"LPCR", f.lpcr_parameters(**grid), packet, span)


def vector(packet: bytes, span: int = 1, width: int = 2) -> bytes:
    return packed(b"LPCR", f.lpcr_parameters(), packet, span, component_count=width)


def described(raw: bytes, codec: bytes = b"LPCR") -> bytes:
    return packed(codec, raw, f.KNOT_DATA)


def filled(indices: list[int]) -> bytes:
    """A component packet with a 1 just behind its front, where zeros belong."""
    coder = page.Range()
    page.code_samples(coder, len(indices), 0, [], 0, False, BOUND, indices)
    whole = bytearray(coder.finish())
    room = 8 * len(whole) - len(coder.raw)
    fronts = [coder.n - r for r in (15, 14) if holds(coder, r)]
    assert fronts[0] < room, "no bit between front and back"
    whole[fronts[0] // 8] ^= 128 >> fronts[0] % 8
    return b"\0\0\0" + bytes(whole)


def holds(coder: page.Range, r: int) -> bool:
    """Whether a multiple of 2^r with all that follows it lies within the width."""
    return -(-coder.low // 2**r) * 2**r + 2**r <= coder.low + coder.width


SOME = [3, -1, 4, 1, -5, 9]
CODING = [
    ("coded-and-a-byte", "RNG-001", "A byte follows the coded bytes.",
     predicted(page.encode([1]) + b"\0")),
    ("coded-byte-between", "RNG-001", "A byte of zeros stands between front and back.",
     predicted(page.encode([100])[:-1] + b"\0" + page.encode([100])[-1:])),
    ("coded-byte-missing", "RNG-001", "The last coded byte is missing.",
     predicted(page.encode(SOME)[:-1], 6)),
    ("coded-none", "RNG-001", "No byte is coded for 64 ticks.", predicted(b"\0\0\0", 64)),
    ("coded-bits-for-too-much", ("RNG-001", "LPC-003", "RNG-003"),
     "Eight coded bytes stand for 2^22 ticks.", predicted(b"\0\0\0" + b"\xFF" * 8, 2**22)),
    ("coded-filled-with-a-one", "RNG-001", "A 1 stands between front and back.",
     predicted(filled(SOME), 6)),
    ("coded-integer-of-2-to-34", "RNG-003", "A coded integer is 2^34.",
     predicted(page.encode([2**34], forge=True))),
]  # fmt: skip

FIRST = b"\3\x10\0\0"
"""The size of a first component packet, which is constant, and itself."""

NINE = b"".join(bytes([a, 0, 0, 0]) for a in range(9))
PARAMETERS = [
    ("predicted-parameters-cut-short", ("CNV-002", "COD-002"), "LPCR has no zero.",
     described(b"\0\1")),
    ("predicted-parameters-without-fraction", ("CNV-002", "COD-002"),
     "The deadband grid has no Weber fraction.", described(b"\1\1\0")),
    ("predicted-parameters-and-a-byte", "COD-002", "A byte follows the parameters of LPCR.",
     described(f.lpcr_parameters() + b"\0")),
    ("predicted-uniform-with-fraction", "COD-002", "The uniform grid has a Weber fraction.",
     described(f.lpcr_parameters() + b"\1\x0a")),
    ("grid-2", "LPC-002", "The grid is 2.",
     described(f.lpcr_parameters(2, kn=1, kd=10))),
    ("grid-step-0", "LPC-002", "The step of a uniform grid is 0.",
     described(f.lpcr_parameters(step=0))),
    ("grid-step-above-level-1", ("LPC-002", "LIM-001"), "The step is 2^24 + 1.",
     described(f.lpcr_parameters(step=BOUND + 1))),
    ("grid-zero-too-high", "LPC-002", "The count of index 0 is 2^31.",
     described(f.lpcr_parameters(zero=2**31))),
    ("grid-kn-0", "LPC-002", "The Weber fraction has kn = 0.",
     described(f.lpcr_parameters(1, kn=0, kd=10))),
    ("grid-kd-0", "LPC-002", "The Weber fraction has kd = 0.",
     described(f.lpcr_parameters(1, kn=1, kd=0))),
    ("grid-kn-2-to-16", "LPC-002", "The Weber fraction has kn = 2^16.",
     described(f.lpcr_parameters(1, kn=2**16, kd=9))),
    ("grid-kd-2-to-16", "LPC-002", "The Weber fraction has kd = 2^16.",
     described(f.lpcr_parameters(1, kn=64, kd=2**16))),
    ("grid-fraction-too-small", "LPC-002", "The Weber fraction has kd = 1024 * kn + 1.",
     described(f.lpcr_parameters(1, kn=1, kd=1025))),
]  # fmt: skip

COMPONENTS = [
    ("predicted-base-too-high", "LPC-003", "The base is 2^24 + 1.",
     predicted(b"\x10\0" + f.svarint(BOUND + 1))),
    ("predicted-base-times-step", "LPC-003", "The base 2 times the step 2^23 + 1 is too much.",
     predicted(b"\x10\0\4", step=2**23 + 1)),
    ("predicted-base-past-the-deadband", "LPC-003", "On the grid of kn = kd there is no index 1.",
     predicted(b"\x10\0\2", grid=1, kn=1, kd=1)),
    ("predicted-index-too-high", "LPC-003", "An index is 2^24 + 1.",
     predicted(page.encode([BOUND + 1], forge=True))),
    ("predicted-index-past-the-deadband", "LPC-003", "An index is N + 1 on a deadband grid.",
     predicted(page.encode([len(page.grid_levels(1, 2, 100, BOUND))]), grid=1, step=100, kn=1,
               kd=2)),
    ("predicted-difference-5", "LPC-004", "The difference order is 5.", predicted(b"\5\0\0")),
    ("predicted-difference-2-and-order-1", "LPC-004", "The orders are 2 and 1.",
     predicted(b"\2\1\0\0")),
    ("predicted-order-33", "LPC-004", "The prediction order is 33.",
     predicted(b"\0\x21" + bytes(34))),
    ("predicted-coefficient-too-low", "LPC-004", "A reflection coefficient is -128.",
     predicted(b"\0\1\x80\0")),
    ("constant-with-difference", "LPC-004", "A constant has the difference order 1.",
     predicted(b"\x11\0\0")),
    ("constant-with-coefficient", "LPC-004", "A constant has a coefficient.",
     predicted(b"\x10\1\0\0")),
    ("constant-with-repeats", "LPC-004", "A constant has the flag repeats.",
     predicted(b"\x18\0\0")),
    ("constant-with-references", "LPC-004", "A constant has a reference.",
     vector(FIRST + b"\x50\0\1\0\0\x40\0\0")),
    ("constant-with-rice", "LPC-004", "A constant has the flag Rice.", predicted(b"\x90\0\0")),
    ("constant-and-a-byte", "COD-001", "A byte follows a constant.", predicted(b"\x10\0\0\0")),
    ("predicted-p-too-large", "LPC-005", "A p[j] is above 2^36.",
     predicted(b"\0\x20" + b"\x7F\x81" * 16 + b"\0")),
    ("predicted-c-too-large", "LPC-005", "A c[j] is above 2^21.",
     predicted(b"\0\x0B" + b"\x81" * 11 + b"\0")),
    ("predicted-of-no-bytes", "LPC-006", "A packet of LPCR is empty.", predicted(b"")),
    ("predicted-coefficients-cut-short", "LPC-006", "One coefficient of two is there.",
     predicted(b"\0\2\0")),
    ("predicted-without-base", "CNV-002", "A component packet ends before its base.",
     predicted(b"\0\0"), None, 2),
    ("components-past-the-packet", "LPC-001", "The first component is larger than the packet.",
     vector(b"\4\x10\0\0")),
    ("components-size-past-the-packet", ("CNV-002", "LPC-001"), "Sizes of components are missing.",
     vector(b""), None, 2),
    ("components-sizes-of-2-to-53", "LPC-001", "Sizes add up to more than 2^53.",
     vector(f.varint(2**53 - 1) * 2 + b"\x10\0\0", width=3)),
    ("component-missing", "LPC-006", "No byte is left for the second component.", vector(FIRST)),
    ("component-in-the-middle", "LPC-004", "The second of three components has the order 5.",
     vector(b"\3\3\x10\0\0\5\0\0\x10\0\0", width=3)),
    ("reference-of-the-first", "LPC-007", "The first component has a reference, to itself.",
     predicted(b"\x40\0\1\0\0\x40\0\0")),
    ("reference-to-itself", "LPC-007", "The second component refers to itself.",
     vector(FIRST + b"\x40\0\1\1\0\x40\0\0")),
    ("references-none", "LPC-007", "The flag references is set, and r is 0.",
     vector(FIRST + b"\x40\0\0\0")),
    ("references-nine", "LPC-007", "A component has nine references.",
     vector(b"\3" * 9 + b"\x10\0\0" * 9 + b"\x40\0\x09" + NINE + b"\0", width=10)),
    ("references-twice", "LPC-007", "A component refers to another twice.",
     vector(FIRST + b"\x40\0\2" + bytes(9))),
    ("references-in-falling-order", "LPC-007", "References stand in falling order.",
     vector(b"\3\3" + b"\x10\0\0" * 2 + b"\x40\0\2\1\0\0\0\0\0\0\0\0", width=3)),
    ("references-without-number", "LPC-008", "A component packet ends before r.",
     vector(FIRST + b"\x40\0")),
    ("references-cut-short", "LPC-008", "A component packet ends within a reference.",
     vector(FIRST + b"\x40\0\1\0\0\0")),
    ("rice-with-repeats", "LPC-010", "Rice codes stand with the flag repeats.",
     predicted(b"\x88\0\0\x80")),
    ("lpcr-flag-5", "LPC-004", "Bit 5 of the flags is 1.", predicted(b"\x20\0\0\x16")),
    ("rice-width-below-0", "LPC-011", "The first width is -1.", predicted(b"\x80\0\0\x40")),
    ("rice-width-32", "LPC-011", "The first width is 32.",
     predicted(b"\x80\0\0" + bytes(6) + b"\x08\0")),
    ("rice-none", "LPC-012", "No Rice code is there.", predicted(b"\x80\0\0")),
    ("rice-cut-short", "LPC-012", "The last Rice code ends behind the packet.",
     predicted(page.encode([200], rice=True)[:-1])),
    ("rice-and-a-byte", "LPC-012", "A byte follows the Rice codes.", predicted(b"\x80\0\0\x80\0")),
    ("rice-filled-with-ones", "LPC-012", "The bit behind the last code is 1.",
     predicted(b"\x80\0\0\x81")),
    ("rice-index-too-high", "LPC-003", "A Rice code gives the index 2^24 + 1.",
     predicted(page.encode([BOUND + 1], rice=True, forge=True, widths=(20,)))),
]  # fmt: skip

points = partial(packed, b"KNOT")


def held(packet: bytes, span: int = 2, **grid: int) -> bytes:
    return points(f.coded_knot_parameters(**grid), packet, span)


def knots(*rows: tuple[int, int], span: int = 2, linear: bool = False) -> bytes:
    """As the encoder of the page codes them, whatever rule they break."""
    return page.encode_knots([(tick, [index]) for tick, index in rows], linear, span, forge=True)


KNOTS = [
    ("coded-knots-none", "CNV-002", "A packet of coded knots is empty.", held(b""), None, 2),
    ("coded-knots-component-missing", "CNV-002", "The second component has no first index.",
     packed(b"KNOT", f.coded_knot_parameters(), b"\0", 2, component_count=2), None, 2),
    ("coded-knots-first-index-too-high", "LPC-003", "The first index is 2^24 + 1.",
     held(f.svarint(BOUND + 1))),
    ("coded-knots-no-more", "KTE-002", "The number of further knots, f, is 0.", held(b"\0\0")),
    ("coded-knots-as-many-as-ticks", "KTE-002", "Two knots follow the first of two ticks.",
     held(b"\0\2")),
    ("coded-knots-gap-of-25-bits", "KTE-003", "A gap has 25 bits.", held(b"\0\1" + bytes(4))),
    ("coded-knots-past-the-end", "KTE-004", "A knot stands at tick 2 of 2.",
     held(knots((0, 0), (2, 1)))),
    ("coded-knots-without-room", "KTE-004", "The second knot of three stands at the last tick.",
     held(b"\0\2" + knots((0, 0), (2, 1), span=3)[2:], 3)),
    ("coded-knots-line-without-room", "KTE-004",
     "A knot stands where the last one of a line has its place.",
     points(f.coded_knot_parameters(1), knots((0, 0), (3, 1), (4, 2), span=4, linear=True), 4)),
    ("coded-knots-index-too-high", "LPC-003", "The second index is 2^24 + 1.",
     held(knots((0, 0), (1, BOUND + 1)))),
    ("coded-knots-and-a-byte", "RNG-001", "A byte follows the coded bytes.",
     held(knots((0, 0), (1, 1)) + b"\0")),
    ("coded-knots-byte-missing", ("RNG-001", "KTE-003"), "No byte is coded.",
     held(knots((0, 0), (1, 1))[:2])),
]  # fmt: skip

COUNTS = b"\3\x10\0\x0a"
"""Counts of a packet of LPCX: all 5."""


def exact(packet: bytes, *parameters: Any, **given: object) -> bytes:
    return packed(b"LPCX", f.lpcx_parameters(*parameters), packet, **given)


def beside(rest: bytes, span: int = 1) -> bytes:
    """What follows the counts."""
    return exact(COUNTS + rest, span=span)


def corrected(length: int) -> bytes:
    """One correction of so many bits."""
    coder = page.Range()
    models = [page.Bit() for _ in range(length + 1)]
    for i in range(min(length + 1, 63)):
        coder.code(models[i], int(i < length))
    coder.number(length, 0)
    return b"\0\0" + coder.finish()


def pair(one: Any, other: Any, rest: bytes) -> bytes:
    """Two components of fives, linear by their terms; those without are quotients."""
    rules = [f.lpcx_parameters(4, 0, bytes(2), [0.0], terms) if terms else f.lpcx_parameters()
             for terms in (one, other)]  # fmt: skip
    return packed(b"LPCX", b"".join(rules), b"\7\3\x10\0\x0a\x10\0\x0a" + rest, component_count=2)


EXACT = [
    ("exact-parameters-cut-short", "COD-002", "The parameters of LPCX have three bytes.",
     described(f.lpcx_parameters()[:-1], b"LPCX")),
    ("exact-parameters-and-a-byte", "COD-002", "A byte follows the parameters of LPCX.",
     described(f.lpcx_parameters() + b"\0", b"LPCX")),
    ("exact-of-two-with-one-rule", "COD-002", "A track of LPCX has two components, and one rule.",
     exact(COUNTS, component_count=2), None, [0, 2]),
    ("exact-lf", "EXA-001", "A track of LPCX is of kind LF.",
     broken.series((f.trak(f.tlv(1, f.lpcx_parameters()), codec=b"LPCX", kind=1), 0),
                   (f.trak(kind=2, base=0), 1), data=("DATA", f.cluster((0, 0, 4, COUNTS)))),
     None, [0, 2]),
    ("exact-with-deadband", "EXA-001", "A track of LPCX has a deadband contract.",
     exact(COUNTS, tlvs=f.tlv(16, f.deadband())), [FIVES]),
    ("exact-with-deviation", "EXA-001", "A track of LPCX has a deviation.",
     exact(COUNTS, tlvs=f.tlv(18, f.deviation(1, 1))), [FIVES]),
    ("exact-rule-5", "EXA-002", "The rule is 5.", exact(COUNTS, 5), [FIVES]),
    ("exact-cubic-with-terms", "EXA-002", "The rule is 3 and terms 1.",
     exact(COUNTS, 3, 0, b"\1\0", (0, 1, 0, 0), [(0, 1, 1.0)]), [FIVES]),
    ("exact-linear-without-terms", "EXA-002", "The rule is 4 and terms 0.",
     exact(COUNTS, 4, 0, bytes(2), [0.0]), [FIVES]),
    ("exact-linear-with-digits", "EXA-002", "The rule is 4 and digits 1.",
     exact(COUNTS, 4, 1, bytes(2), [0.0], [(0, 1, 1.0)]), [FIVES]),
    ("exact-17-terms", "EXA-002", "The rule is 4 and terms 17.",
     exact(COUNTS, 4, 0, bytes(2), [0.0], [(0, 1, 1.0)] * 17), [FIVES]),
    ("exact-term-missing", "COD-002", "The rule is 4 and terms 1, with none.",
     described(f.lpcx_parameters(4, 0, b"\1\0", [0.0]), b"LPCX")),
    ("exact-term-too-many", "COD-002", "The rule is 4 and terms 1, with two.",
     described(f.lpcx_parameters(4, 0, bytes(2), [0.0], [(0, 1, 1.0)]) + bytes(10), b"LPCX")),
    *[(f"exact-{name}", "EXA-008", f"A weight is {what}.",
       exact(COUNTS, 4, 0, bytes(2), [0.0], [(0, 1, each)]), [FIVES])
      for name, what, each in (("weight-nan", "no number", nan),
                               ("weight-of-2-to-900", "2^900", 2.0**900))],
    ("exact-constant-infinite", "EXA-008", "The constant of rule 4 is infinite.",
     exact(COUNTS, 4, 0, bytes(2), [inf], [(0, 1, 1.0)]), [FIVES]),
    ("exact-of-its-own-tick", "EXA-009", "A component is linear in itself, with lag 0.",
     exact(COUNTS, 4, 0, bytes(2), [0.0], [(0, 0, 1.0)]), [FIVES]),
    ("exact-of-no-component", "EXA-009", "A component is linear in number 1, of one.",
     exact(COUNTS, 4, 0, bytes(2), [0.0], [(1, 1, 1.0)]), [FIVES]),
    ("exact-of-a-later-one", "EXA-009", "Component 0 is linear in 1, which is linear too.",
     pair([(1, 1, 1.0)], [(0, 1, 1.0)], b""), None, [0, 2]),
    ("exact-parts-past-the-packet", "EXA-010", "The first of two parts has 2 bytes, of 1.",
     pair([(1, 0, 1.0)], None, b"\2\0"), None, [0, 2]),
    ("exact-cubic-with-digits", "EXA-002", "The rule is 3 and digits 1.",
     exact(COUNTS, 3, 1, bytes(2), (0, 1, 0, 0)), [FIVES]),
    ("exact-coefficient-missing", "COD-002", "The rule is 3, with three coefficients.",
     described(f.lpcx_parameters(3, 0, bytes(2), (0, 1, 0)), b"LPCX")),
    ("exact-coefficient-too-many", "COD-002", "The rule is 3, with five coefficients.",
     described(f.lpcx_parameters(3, 0, bytes(2), (0, 1, 0, 0, 0)), b"LPCX")),
    *[(f"exact-coefficient-{name}", "EXA-008", f"A coefficient is {what}.",
       exact(COUNTS, 3, 0, bytes(2), (0, 1, 0, each)), [FIVES])
      for name, what, each in (("infinite", "infinite", inf), ("nan", "no number", nan),
                               ("of-2-to-900", "2^900", 2.0**900),
                               ("below-minus-2-to-900", "-2^900", -(2.0**900)))],
    ("exact-quotient-with-digits", "EXA-002", "The rule is 0 and digits 1.",
     exact(COUNTS, 0, 1), [FIVES]),
    ("exact-no-significant-digit", "EXA-002", "The rule is 2 and digits 0.",
     exact(COUNTS, 2, 0), [FIVES]),
    ("exact-16-significant-digits", "EXA-002", "The rule is 2 and digits 16.",
     exact(COUNTS, 2, 16), [FIVES]),
    ("exact-reserved", "HED-005", "A reserved byte of LPCX is 1.",
     exact(COUNTS, 0, 0, b"\0\1"), [FIVES]),
    ("exact-of-no-bytes", "CNV-002", "A packet of LPCX is empty.", exact(b""), None, 2),
    ("exact-counts-past-the-packet", "EXA-003", "The counts are longer than the packet.",
     exact(COUNTS[:-1])),
    ("exact-counts-and-a-byte", ("COD-001", "LPC-006"), "A byte follows the counts, a constant.",
     exact(b"\4" + COUNTS[1:] + b"\0")),
    ("exact-count-too-high", "EXA-003", "A count is 101, above its declared range.",
     exact(b"\4\x10\0" + f.svarint(101))),
    *[(*row, [broken.track([5])], None, "EXA-006") for row in [
        ("exact-flags-alone", ("EXA-004", "CNV-002"), "A packet ends behind the flags.",
         beside(b"\0")),
        ("exact-flag", "EXA-004", "An undefined flag is set.",
         beside(b"\2" + corrected(1)[1:])),
        ("exact-shift-64", "EXA-004", "Corrections are counted in steps of 2^64.",
         beside(b"\0\x40" + corrected(1)[2:])),
        ("exact-coded-and-a-byte", "RNG-001", "A byte follows the coded bytes.",
         beside(corrected(1) + b"\0")),
        ("exact-coded-cut-short", "RNG-001", "A correction of 60 bits has 52.",
         beside(corrected(60)[:-1])),
        ("exact-coded-empty", "RNG-001", "No byte is coded.", beside(b"\0\0")),
    ]],
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("entropy/coded", CODING)
    yield from broken.cases("structure/parameters", PARAMETERS)
    yield from broken.cases("entropy/predicted", COMPONENTS)
    yield from broken.cases("entropy/coded-knots", KNOTS)
    yield from broken.cases("entropy/exact", EXACT)
