"""SPEC 9.7 a second time, from the page alone, in exact fractions; imports nothing of hapfmt."""

from __future__ import annotations

import struct
from fractions import Fraction

import page
from page import Bit, BrokenRule, Range, bits_of, clamp, varint


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


def value(count: int, a: int, b: int, d: int, rule: int, digits: int) -> Fraction:
    q = Fraction(count * a + b, d)
    if rule == 0:
        return rounded(q)
    if rule == 1:
        return rounded(rounded(count * rounded(Fraction(a, d))) + rounded(Fraction(b, d)))
    if rule == 2:
        return rounded(rounded(q), 24, -149)
    k = digits
    if rule == 4:
        p = 0
        while q and abs(q) >= Fraction(10) ** (p + 1):
            p += 1
        while q and abs(q) < Fraction(10) ** p:
            p -= 1
        k = min(digits - 1 - p, 22)
    s = nearest(q * Fraction(10) ** k)
    if abs(s) >= 2**53:
        return rounded(q)
    return rounded(s / Fraction(10) ** k)


def bits(number: Fraction) -> int:
    """b, of a number that binary64 holds; -0.0 is none of the values."""
    return struct.unpack("<q", struct.pack("<d", number.numerator / number.denominator))[0]


def place(b: int) -> int:
    return b if b >= 0 else -1 - (b + 2**63)


def word_at(number: int) -> int:
    """The bits, unsigned, of the number at a place modulo 2^64."""
    number = (number + 2**63) % 2**64 - 2**63
    return number if number >= 0 else 2**63 + (-1 - number)


class Fields:
    def __init__(self, data: bytes | None = None):
        self.text = None if data is None else "".join(f"{byte:08b}" for byte in data)
        self.out = ""
        self.used = 0

    def take(self, size: int, negative: bool | None, low: int) -> tuple[bool, int]:
        """Sign and lowest bits."""
        if negative is not None:
            self.out += str(int(negative)) + (f"{low:0{size}b}")[1:]
            return negative, low
        field = self.text[self.used : self.used + size]
        if len(field) < size:
            raise BrokenRule("EXA-005")
        self.used += size
        return field[0] == "1", int("0" + field[1:], 2)

    def bytes(self) -> bytes:
        whole = self.out + "0" * (-len(self.out) % 8)
        return bytes(int(whole[i : i + 8], 2) for i in range(0, len(whole), 8))


def number(coder: Range, models, bits: int, value: int | None) -> int:
    j = 1
    for i in range(bits - 1, -1, -1):
        j = 2 * j + coder.code(models[j], None if value is None else value // 2**i % 2)
    return j - 2**bits


def corrections(coder: Range, fields: Fields, counts, widths, recall: bool, shift: int, given=None):
    """One after the other; ``given`` where ``coder`` encodes."""
    x_models = [Bit() for _ in range(2**10)]
    r = [[Bit() for _ in range(32)] for _ in range(3)]
    t = [Bit() for _ in range(63)]
    lists: dict[int, list[int]] = {}
    out = []
    for at, (count, w) in enumerate(zip(counts, widths, strict=True)):
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
            length = 0 if c is None else bits_of(abs(c))
            target = None if c is None else length if w is None else (w - length) % 64
            u = 0
            while u < 63 and coder.code(t[u], None if target is None else int(u < target)):
                u += 1
            length = u if w is None else (w - u) % 64
            found = 0
            if length > 0:
                e = min(length - 1, max(length + shift - 53, 0), 10)
                field = 2 ** (length - e - 1)
                high = None if c is None else abs(c) // field % 2**e
                high = number(coder, x_models, e, high) + 2**e
                negative, low = (None, 0) if c is None else (c < 0, abs(c) % field)
                negative, low = fields.take(length - e, negative, low)
                found = (-1 if negative else 1) * (high * field + low)
        if recall:
            rest = [entry for i, entry in enumerate(lists.get(count, [])) if i != rank]
            lists[count] = [found, *rest][:32]
        out.append(found)
        coder.check()
    return out


def spreads(values, a: int, d: int, relative: bool, z: int) -> list[int | None]:
    if not relative:
        return [None] * len(values)
    exponents = [bits(v) // 2**52 % 2**11 for v in values]
    step = bits_of(abs(a)) - bits_of(d)
    return [max(clamp(step + 1075 - e, 0, 63) - z, 0) for e in exponents]


def decode(data: bytes, span: int, affine, rule: int, digits: int, last: int = 2**24):
    """(counts, words) of a packet."""
    n, at = varint(data, 0)
    if n > len(data) - at:
        raise BrokenRule("EXA-003")
    counts = page.decode(data[at : at + n], span, last)
    return counts, decode_exact(data[at + n :], counts, affine, rule, digits)


def decode_exact(rest: bytes, counts, affine, rule: int, digits: int) -> list[int]:
    a, b, d = affine
    values = [value(count, a, b, d, rule, digits) for count in counts]
    if not rest:
        return [bits(v) % 2**64 for v in values]
    if len(rest) < 2 or rest[0] > 3 or rest[1] > 63:
        raise BrokenRule("EXA-004")
    recall, relative, z = rest[0] % 2 == 1, rest[0] >= 2, rest[1]
    m, start = varint(rest, 2)
    if m > len(rest) - start:
        raise BrokenRule("EXA-004")
    coder, fields = Range(rest[start : start + m]), Fields(rest[start + m :])
    found = corrections(coder, fields, counts, spreads(values, a, d, relative, z), recall, z)
    coder.finish()
    if len(fields.text) != -(-fields.used // 8) * 8 or "1" in fields.text[fields.used :]:
        raise BrokenRule("EXA-005")
    places = [place(bits(v)) for v in values]
    return [word_at(p + c * 2**z) for p, c in zip(places, found, strict=True)]


def encode_exact(words, counts, affine, rule: int, digits: int, recall, relative) -> bytes:
    """What follows the counts; words as signed integers b."""
    a, b, d = affine
    values = [value(count, a, b, d, rule, digits) for count in counts]
    away = [place(w) - place(bits(v)) for w, v in zip(words, values, strict=True)]
    if not any(away):
        return b""
    z = 0
    while all(c % 2 ** (z + 1) == 0 for c in away):
        z += 1
    coder, fields = Range(), Fields()
    small = [c // 2**z for c in away]
    corrections(coder, fields, counts, spreads(values, a, d, relative, z), recall, z, small)
    coded = coder.finish()
    size = bytearray()
    number = len(coded)
    while number > 127:
        size.append(number % 128 + 128)
        number //= 128
    return bytes([recall + 2 * relative, z, *size, number]) + coded + fields.bytes()
