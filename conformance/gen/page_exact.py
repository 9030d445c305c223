"""SPEC 9.7 a second time, from the page alone, in exact fractions; imports nothing of hapfmt."""

from __future__ import annotations

import struct
from fractions import Fraction

import page
from page import Bit, BrokenRule, Range, bits_of, varint


def nearest(q: Fraction) -> Fraction:
    """The integer nearest to q, ties to even."""
    return Fraction(round(q))


def rounded(q: Fraction, digits: int = 53, least: int = -1074) -> Fraction:
    """q to binary64 (24 digits from 2^-149 on: to binary32), as an exact number."""
    if q == 0:
        return q
    power = abs(q.numerator).bit_length() - q.denominator.bit_length() - 1
    while abs(q) >= Fraction(2) ** (power + 1):
        power += 1
    unit = Fraction(2) ** max(power - digits + 1, least)
    return nearest(q / unit) * unit


def value(count: int, a: int, b: int, d: int, rule: int, digits: int, c=()) -> Fraction:
    q = Fraction(count * a + b, d)
    if rule == 0:
        return rounded(q)
    if rule == 1:
        return rounded(rounded(count * rounded(Fraction(a, d))) + rounded(Fraction(b, d)))
    if rule == 3:
        v = Fraction(c[3])
        for each in (c[2], c[1], c[0]):
            v = rounded(rounded(v * count) + Fraction(each))
        return v
    p = 0
    while q and abs(q) >= Fraction(10) ** (p + 1):
        p += 1
    while q and abs(q) < Fraction(10) ** p:
        p -= 1
    k = min(digits - 1 - p, 22)
    return rounded(nearest(q * Fraction(10) ** k) / Fraction(10) ** k)


def bits(number: Fraction) -> int:
    """b, of a number that binary64 holds; -0.0 is none of the values."""
    return struct.unpack("<q", struct.pack("<d", number.numerator / number.denominator))[0]


def place(b: int) -> int:
    return b if b >= 0 else -1 - (b + 2**63)


def word_at(number: int) -> int:
    """The bits, unsigned, of the number at a place modulo 2^64."""
    number = (number + 2**63) % 2**64 - 2**63
    return number if number >= 0 else 2**63 + (-1 - number)


def number(coder: Range, models, bits: int, value: int | None) -> int:
    j = 1
    for i in range(bits - 1, -1, -1):
        j = 2 * j + coder.code(models[j], None if value is None else value // 2**i % 2)
    return j - 2**bits


def corrections(coder: Range, counts, recall: bool, shift: int, given=None):
    """One after the other; ``given`` where ``coder`` encodes."""
    x_models = [Bit() for _ in range(2**10)]
    r = [[Bit() for _ in range(32)] for _ in range(3)]
    t = [Bit() for _ in range(63)]
    lists: dict[int, list[int]] = {}
    out = []
    for at, count in enumerate(counts):
        c = None if given is None else given[at]
        found = None
        if recall:
            x = 0 if count not in lists else 1 if count == counts[at - 1] else 2
            known = lists.get(count, [0])
            rank = None
            for i, entry in enumerate(known):
                if coder.code(r[x][i], None if c is None else int(c == entry)):
                    found, rank = entry, i
                    break
        if found is None:
            target = None if c is None else bits_of(abs(c))
            length = found = 0
            while length < 63 and coder.code(t[length], target and int(length < target)):
                length += 1
            if length > 0:
                e = min(length - 1, max(length + shift - 53, 0), 10)
                field = 2 ** (length - e - 1)
                high = None if c is None else abs(c) // field % 2**e
                high = number(coder, x_models, e, high) + 2**e
                low = coder.number(length - e - 1, None if c is None else abs(c) % field)
                negative = coder.number(1, None if c is None else int(c < 0))
                found = (-1 if negative else 1) * (high * field + low)
        if recall:
            rest = [entry for i, entry in enumerate(lists.get(count, [])) if i != rank]
            lists[count] = [found, *rest][:32]
        out.append(found)
        coder.check()
    return out


def decode(data: bytes, span: int, affine, rule: int, digits: int, last: int = 2**24, c=()):
    """(counts, words) of a packet."""
    n, at = varint(data, 0)
    if n > len(data) - at:
        raise BrokenRule("EXA-003")
    counts = page.decode(data[at : at + n], span, last)
    return counts, decode_exact(data[at + n :], counts, affine, rule, digits, c)


def decode_exact(rest: bytes, counts, affine, rule: int, digits: int, c=()) -> list[int]:
    values = [value(count, *affine, rule, digits, c) for count in counts]
    if not rest:
        return [bits(v) % 2**64 for v in values]
    if len(rest) < 2 or rest[0] > 1 or rest[1] > 63:
        raise BrokenRule("EXA-004")
    recall, z = rest[0] == 1, rest[1]
    coder = Range(rest[2:])
    found = corrections(coder, counts, recall, z)
    coder.finish()
    places = [place(bits(v)) for v in values]
    return [word_at(p + c * 2**z) for p, c in zip(places, found, strict=True)]


def encode_exact(words, counts, affine, rule: int, digits: int, recall, c=()) -> bytes:
    """What follows the counts; words as signed integers b."""
    values = [value(count, *affine, rule, digits, c) for count in counts]
    away = [place(w) - place(bits(v)) for w, v in zip(words, values, strict=True)]
    if not any(away):
        return b""
    z = 0
    while all(c % 2 ** (z + 1) == 0 for c in away):
        z += 1
    coder = Range()
    small = [c // 2**z for c in away]
    corrections(coder, counts, recall, z, small)
    return bytes([recall, z]) + coder.finish()
