"""SPEC 9.4 to 9.7: entropy coding, packets of LPCR, coded knots, LPCX."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from math import inf, nan
from typing import Any

import broken
import forge as f
import page
import page_exact
from broken import FIVES, packed
from case import Case

BOUND = 2**24


def predicted(packet: bytes, span: int = 1, **grid: int) -> bytes:
    return packed(b"LPCR", f.lpcr_parameters(**grid), packet, span)


def vector(packet: bytes, span: int = 1, width: int = 2) -> bytes:
    return packed(b"LPCR", f.lpcr_parameters(), packet, span, component_count=width)


def described(raw: bytes, codec: bytes = b"LPCR") -> bytes:
    return packed(codec, raw, f.KNOT_DATA)


def filled(packet: bytes) -> bytes:
    """The packet with a 1 behind its last raw bit: six signs are all raw bits that it has."""
    return packet[:-1] + bytes([packet[-1] | 128])


def another_end(packet: bytes, at: int) -> bytes:
    """The packet whose state begins 4096 higher: the same symbols, and another state at the end."""
    state = int.from_bytes(packet[at : at + 4], "big") + 4096
    return packet[:at] + state.to_bytes(4, "big") + packet[at + 4 :]


def largest(number: int = 0, error: int = 2**34) -> bytes:
    """A prediction error of 2^34 or more, which no index needs."""
    return page.encode([0], number=number, forge=[error])


SOME = [3, -1, 4, 1, -5, 9]
HEAD = b"\0\0\0"
"""Flags, order and base."""

ONE = page.encode([1])
QUIET = page.encode([1], number=page.BY_BITS)
CODING = [
    ("coded-and-a-byte", "RNG-001", "A byte follows the coded bytes.", predicted(ONE + b"\0")),
    ("coded-byte-between", "RNG-001", "A byte of zeros is between front and back.",
     predicted(ONE[:-1] + b"\0" + ONE[-1:])),
    ("coded-byte-missing", "RNG-001", "The last coded byte is missing.",
     predicted(page.encode(SOME)[:-1], 6)),
    ("coded-none", "RNG-001", "No byte is coded for 64 ticks.", predicted(HEAD + b"\0\x0c", 64)),
    ("coded-state-cut-short", "RNG-001", "Of four states the last has three bytes.",
     predicted(HEAD + b"\x10\x0c" + b"\0\1\0\0" * 3 + b"\0\1\0")),
    ("coded-ends-with-another-state", "RNG-001", "The last state is not 65536.",
     predicted(another_end(ONE, 5))),
    ("coded-bits-for-too-much", ("RNG-001", "LPC-003", "RNG-003"),
     "Ten coded bytes give 2^22 ticks.",
     predicted(HEAD + b"\0\x0c" + b"\xFF" * 10, 2**22)),
    ("coded-filled-with-a-one", "RNG-001", "A 1 follows the last raw bit.",
     predicted(filled(page.encode(SOME)), 6)),
    ("coded-integer-of-2-to-34", "RNG-003", "A coded integer is 2^34.", predicted(largest())),
    ("coding-missing", "RNG-004", "A component packet ends behind its base.", predicted(HEAD)),
    ("coding-without-start", "RNG-004", "The start byte is missing.", predicted(HEAD + b"\0")),
    ("coding-start-164", "RNG-004", "The start byte is 164.",
     predicted(HEAD + b"\0\xa4" + ONE[5:])),
    *[(f"coding-bits-{name}", "RNG-004", f"Bits {name.replace('-', ' ')} of the coding are 1.",
       predicted(HEAD + bytes([coding]) + QUIET[4:]))
      for name, coding in (("0-and-6", 0x41), ("4-and-6", 0x50), ("5-and-6", 0x60),
                           ("6-and-7", 0xC0))],
    ("coding-bit-7", "RNG-004", "Bit 7 of the coding is 1.", predicted(HEAD + b"\x80" + ONE[4:])),
    ("repeats-of-probability-0", "RNG-004", "The last probability of repeats is 0.",
     predicted(b"\x08\0\0\0\x0c\1\1\1\0" + b"\0\1\0\0")),
    ("repeats-without-probability", "RNG-004", "Of four probabilities three are there.",
     predicted(b"\x08\0\0\0\x0c\1\1\1")),
    ("signs-of-probability-0", "RNG-004", "The first probability of signs is 0.",
     predicted(HEAD + b"\x20\x0c\0\1\1" + b"\0\1\0\0")),
    ("signs-without-probability", "RNG-004", "Of three probabilities two are there.",
     predicted(HEAD + b"\x20\x0c\1\1")),
]  # fmt: skip

LATE = page.encode(SOME, number=page.BY_BITS)
BY_BITS = [
    ("by-bits-and-a-byte", "RNG-001", "A byte follows the coded bytes.", predicted(QUIET + b"\0")),
    ("by-bits-byte-between", "RNG-001", "A byte of zeros is between front and back.",
     predicted(LATE[:-1] + b"\0" + LATE[-1:], 6)),
    ("by-bits-byte-missing", "RNG-001", "The last coded byte is missing.", predicted(LATE[:-1], 6)),
    ("by-bits-none", "RNG-001", "No byte is coded.", predicted(HEAD + b"\x40", 64)),
    ("by-bits-state-cut-short", "RNG-001", "The state has three bytes.",
     predicted(HEAD + b"\x40\0\1\0")),
    ("by-bits-ends-with-another-state", "RNG-001", "The last state is not 65536.",
     predicted(another_end(QUIET, 4))),
    ("by-bits-filled-with-a-one", "RNG-001", "A 1 follows the last raw bit.",
     predicted(filled(LATE), 6)),
    ("by-bits-with-start", ("RNG-001", "LPC-003", "RNG-003"), "A start byte follows the coding.",
     predicted(QUIET[:4] + b"\x0c" + QUIET[4:])),
    ("by-bits-integer-of-2-to-34", "RNG-003", "An integer by bits is 2^34.",
     predicted(largest(page.BY_BITS))),
    ("by-bits-integer-of-k-36", "RNG-003", "An integer by bits has k = 36.",
     predicted(largest(page.BY_BITS, 2**34 + 1))),
    ("by-bits-for-too-much", ("RNG-001", "LPC-003", "RNG-003"), "Ten coded bytes give 2^22 ticks.",
     predicted(HEAD + b"\x40" + b"\xFF" * 10, 2**22)),
    ("by-bits-without-a-one", ("RNG-001", "RNG-003"), "Zeros alone are coded: k passes all bounds.",
     predicted(HEAD + b"\x40" + bytes(200))),
    ("by-bits-repeats-of-probability-0", "RNG-004", "The first probability of repeats is 0.",
     predicted(b"\x08\0\0\x40\0\1\1\1" + b"\0\1\0\0")),
    ("by-bits-repeats-without-probability", "RNG-004", "Of four probabilities three are there.",
     predicted(b"\x08\0\0\x40\1\1\1")),
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
     predicted(page.encode([BOUND + 1]))),
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
    ("constant-with-bit-7", "LPC-004", "A constant has bit 7 of the flags.",
     predicted(b"\x90\0\0")),
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
    ("references-in-falling-order", "LPC-007", "References are in falling order.",
     vector(b"\3\3" + b"\x10\0\0" * 2 + b"\x40\0\2\1\0\0\0\0\0\0\0\0", width=3)),
    ("references-without-number", "LPC-006", "A component packet ends before r.",
     vector(FIRST + b"\x40\0")),
    ("references-cut-short", "LPC-006", "A component packet ends within a reference.",
     vector(FIRST + b"\x40\0\1\0\0\0")),
    ("lpcr-flag-5", "LPC-004", "Bit 5 of the flags is 1.", predicted(b"\x20\0\0\x16")),
    ("lpcr-flag-7", "LPC-004", "Bit 7 of the flags is 1.", predicted(b"\x80\0\0\x16")),
]  # fmt: skip

points = partial(packed, b"KNOT")


def held(packet: bytes, span: int = 2, **grid: int) -> bytes:
    return points(f.coded_knot_parameters(**grid), packet, span)


def knots(*rows: tuple[int, int], linear: bool = False) -> bytes:
    """As the encoder of the page codes them, whatever rule they break."""
    return page.encode_knots([(tick, [index]) for tick, index in rows], linear)


KNOTS = [
    ("coded-knots-none", "CNV-002", "A packet of coded knots is empty.", held(b""), None, 2),
    ("coded-knots-component-missing", "CNV-002", "The second component has no first index.",
     packed(b"KNOT", f.coded_knot_parameters(), b"\0", 2, component_count=2), None, 2),
    ("coded-knots-first-index-too-high", "LPC-003", "The first index is 2^24 + 1.",
     held(f.svarint(BOUND + 1))),
    ("coded-knots-no-more", "KTE-002", "The number of further knots, f, is 0.", held(b"\0\0")),
    ("coded-knots-as-many-as-ticks", "KTE-002", "Two knots follow the first of two ticks.",
     held(b"\0\2")),
    ("coded-knots-past-the-end", "KTE-004", "A knot is at tick 2 of 2.",
     held(knots((0, 0), (2, 1)))),
    ("coded-knots-without-room", "KTE-004", "The second knot of three is at the last tick.",
     held(b"\0\2" + knots((0, 0), (2, 1), (3, 1))[2:], 3)),
    ("coded-knots-line-without-room", "KTE-004",
     "A knot is at the tick of the last one of a line.",
     points(f.coded_knot_parameters(1), knots((0, 0), (3, 1), (4, 2), linear=True), 4)),
    ("coded-knots-index-too-high", "LPC-003", "The second index is 2^24 + 1.",
     held(knots((0, 0), (1, BOUND + 1)))),
    ("coded-knots-and-a-byte", "RNG-001", "A byte follows the coded bytes.",
     held(knots((0, 0), (1, 1)) + b"\0")),
    ("coded-knots-byte-missing", "RNG-001", "The last byte is missing.",
     held(knots((0, 0), (1, 1))[:-1])),
    ("coded-knots-coded-none", "RNG-001", "Nothing follows f.", held(b"\0\1")),
    ("coded-knots-difference-of-2-to-34", "RNG-003", "A difference is 2^34.",
     held(knots((0, 0), (1, 2**34)))),
    ("coded-knots-gap-of-2-to-34", "RNG-003", "A gap is 2^34.",
     held(knots((0, 0), (2**34 + 1, 1)))),
    ("coded-knots-ends-with-another-state", "RNG-001", "The last state is not 65536.",
     held(another_end(knots((0, 0), (1, 1)), 2))),
]  # fmt: skip

COUNTS = b"\3\x10\0\x0a"
"""Counts of a packet of LPCX: all 5."""


def exact(packet: bytes, *parameters: Any, **given: object) -> bytes:
    return packed(b"LPCX", f.lpcx_parameters(*parameters), packet, **given)


def beside(rest: bytes, span: int = 1) -> bytes:
    """What follows the counts."""
    return exact(COUNTS + rest, span=span)


def corrected(length: int) -> bytes:
    """One correction of ``length`` bits."""
    return page_exact.build_exact([2 ** (length - 1)], [5], 0, None, (length, [1]))


ZERO = b"\0\0\0\1\1" + b"\0\1\0\0"
"""One correction of 0, in full."""


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
    *[(f"exact-{name}", "EXA-002", f"A weight is {what}.",
       exact(COUNTS, 4, 0, bytes(2), [0.0], [(0, 1, each)]), [FIVES])
      for name, what, each in (("weight-nan", "no number", nan),
                               ("weight-of-2-to-900", "2^900", 2.0**900))],
    ("exact-constant-infinite", "EXA-002", "The constant of rule 4 is infinite.",
     exact(COUNTS, 4, 0, bytes(2), [inf], [(0, 1, 1.0)]), [FIVES]),
    ("exact-of-its-own-tick", "EXA-002", "A component is linear in itself, with lag 0.",
     exact(COUNTS, 4, 0, bytes(2), [0.0], [(0, 0, 1.0)]), [FIVES]),
    ("exact-of-no-component", "EXA-002", "A component is linear in number 1, of one.",
     exact(COUNTS, 4, 0, bytes(2), [0.0], [(1, 1, 1.0)]), [FIVES]),
    ("exact-of-a-later-one", "EXA-002", "Component 0 is linear in 1, which is linear too.",
     pair([(1, 1, 1.0)], [(0, 1, 1.0)], b""), None, [0, 2]),
    ("exact-parts-past-the-packet", "EXA-003", "The first of two parts has 2 bytes, of 1.",
     pair([(1, 0, 1.0)], None, b"\2\0"), None, [0, 2]),
    ("exact-cubic-with-digits", "EXA-002", "The rule is 3 and digits 1.",
     exact(COUNTS, 3, 1, bytes(2), (0, 1, 0, 0)), [FIVES]),
    ("exact-coefficient-missing", "COD-002", "The rule is 3, with three coefficients.",
     described(f.lpcx_parameters(3, 0, bytes(2), (0, 1, 0)), b"LPCX")),
    ("exact-coefficient-too-many", "COD-002", "The rule is 3, with five coefficients.",
     described(f.lpcx_parameters(3, 0, bytes(2), (0, 1, 0, 0, 0)), b"LPCX")),
    *[(f"exact-coefficient-{name}", "EXA-002", f"A coefficient is {what}.",
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
         beside(b"\4" + corrected(1)[1:])),
        ("exact-shift-64", "EXA-004", "Corrections are counted in steps of 2^64.",
         beside(b"\0\x40" + corrected(1)[2:])),
        ("exact-coded-and-a-byte", "RNG-001", "A byte follows the coded bytes.",
         beside(corrected(1) + b"\0")),
        ("exact-coded-cut-short", "RNG-001", "A correction of 60 bits has 52.",
         beside(corrected(60)[:-1])),
        ("exact-coded-empty", "RNG-001", "No byte is coded.", beside(ZERO[:5])),
        ("exact-no-table", "RNG-004", "No table of lengths is there.", beside(b"\0\0")),
        ("exact-lengths-to-64", "RNG-004", "A table goes to 64 bits.",
         beside(b"\0\0\x3f\2\1\1" + ZERO[5:])),
        ("exact-weights-0", "RNG-004", "All weights are 0.", beside(b"\0\0\0\1\0" + ZERO[5:])),
        ("exact-33-probabilities", "RNG-004", "A context of ranks has 33 probabilities.",
         beside(b"\1\0" + b"\x21" + b"\x80" * 33 + b"\0\0" + ZERO[2:])),
        ("exact-probability-0", "RNG-004", "A rank has the probability 0.",
         beside(b"\1\0\1\0\0\0" + ZERO[2:])),
        ("exact-probabilities-cut-short", "RNG-004", "Probabilities are missing.",
         beside(b"\1\0\2\x80")),
    ]],
]  # fmt: skip


def cases() -> Iterator[Case]:
    yield from broken.cases("entropy/coded", CODING + BY_BITS)
    yield from broken.cases("structure/parameters", PARAMETERS)
    yield from broken.cases("entropy/predicted", COMPONENTS)
    yield from broken.cases("entropy/coded-knots", KNOTS)
    yield from broken.cases("entropy/exact", EXACT)
