"""SPEC 9.7 a second time, from the page alone, in exact fractions; imports nothing of hapfmt."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import page
from page import BrokenRule, Coder, bits_of, varint
from page_coding import bit_ends, code_length, some_bytes, table_of
from page_predicted import split_parts


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
    k = digits - 16 if digits >= 16 else min(digits - 1 - p, 22)
    s = nearest(q * Fraction(10) ** k)
    return rounded(q if abs(s) >= 2**53 else s / Fraction(10) ** k)


def bits(number: Fraction) -> int:
    """b, of a number that binary64 holds; -0.0 is none of the values."""
    return struct.unpack("<q", struct.pack("<d", number.numerator / number.denominator))[0]


def place(b: int) -> int:
    return b if b >= 0 else -1 - (b + 2**63)


def word_at(number: int) -> int:
    """The bits, unsigned, of the number at a place modulo 2^64."""
    number = (number + 2**63) % 2**64 - 2**63
    return number if number >= 0 else 2**63 + (-1 - number)


def code_ranks(coder, counts, p, given=None):
    """For each correction the place on the list of its count, None where it is on none."""
    coder.section()
    sizes: dict[int, int] = {}
    lists: dict[int, list[int]] = {}
    out = []
    for at, count in enumerate(counts):
        x = 0 if count not in sizes else 1 if count == counts[at - 1] else 2
        size, rank = sizes.get(count, 1), None
        known = lists.get(count, [0])
        for i in range(size):
            hit = None if given is None else int(given[at] == known[i])
            row = p[x]
            chance = row[min(i, len(row) - 1)] if row else 128
            bit = coder.symbol(bit_ends(chance), hit)
            coder.check()
            if bit:
                rank = i
                break
        out.append(rank)
        sizes[count] = size if rank is not None or count not in sizes else min(size + 1, 32)
        if given is not None:
            lists[count] = recalled(lists.get(count, []), given[at], rank)
    return out


def recalled(known, correction, rank):
    """The list of a count after this correction."""
    rest = [entry for i, entry in enumerate(known) if i != rank]
    return [correction, *rest][:32]


def corrections(coder, counts, p, table, given=None):
    """All; ``p``: None without recall; ``given`` where ``coder`` encodes."""
    ranks = [None] * len(counts)
    if p is not None:
        ranks = code_ranks(coder, counts, p, given)
    coder.section()
    lists: dict[int, list[int]] = {}
    out = []
    for at, (count, rank) in enumerate(zip(counts, ranks, strict=True)):
        if rank is None:
            c = code_length(coder, table, None if given is None else given[at])
        else:
            c = lists.get(count, [0])[rank]
        if p is not None:
            lists[count] = recalled(lists.get(count, []), c, rank)
        out.append(c)
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
    away = moves(rest, counts) if rest else [0] * len(values)
    return [word_at(place(bits(v)) + each) for v, each in zip(values, away, strict=True)]


def moves(rest: bytes, counts) -> list[int]:
    """The corrections of a part, times 2^z."""
    if len(rest) < 2 or rest[0] > 3 or rest[1] > 63:
        raise BrokenRule("EXA-003")
    (flags, z), at, p = rest[:2], 2, None
    if flags % 2:
        p = []
        for _ in range(3):
            if at >= len(rest) or rest[at] > 32:
                raise BrokenRule("RNG-004")
            row, at = some_bytes(rest, at + 1, rest[at])
            p.append(row)
    table, at = table_of(rest, at)
    coder = Coder(rest[at:], 4 if flags // 2 else 1)
    found = corrections(coder, counts, p, table)
    coder.finish()
    return [c * 2**z for c in found]


class Component(NamedTuple):
    """What the description says of one: A, B, D, the rule, and (a, lag, w) of its terms."""

    affine: tuple[int, int, int]
    rule: int = 0
    digits: int = 0
    c: tuple[float, ...] = ()
    terms: tuple[tuple[int, int, float], ...] = ()


def order(components: Sequence[Component]) -> list[int]:
    places = range(len(components))
    return [a for a in places if components[a].rule != 4] + [
        a for a in places if components[a].rule == 4
    ]


def number_of(word: int) -> Fraction | None:
    """None where it is not finite."""
    x = struct.unpack("<d", struct.pack("<Q", word % 2**64))[0]
    return Fraction(x) if math.isfinite(x) else None


def finite(q: Fraction | None) -> Fraction | None:
    """Rounded; None from 2^1024 on, after rounding."""
    if q is None:
        return None
    q = rounded(q)
    return q if abs(q) < 2**1024 else None


def linear(t: int, count: int, mine: Component, columns) -> Fraction:
    """v of rule 4; columns: the words of components, as far as they are known."""
    v: Fraction | None = Fraction(mine.c[0])
    for a, lag, w in mine.terms:
        x = number_of(columns[a][t - lag]) if t >= lag else None
        product = None if x is None else finite(Fraction(w) * x)
        v = None if v is None or product is None else finite(v + product)
    return value(count, *mine.affine, 0, 0) if v is None else v


def decode_components(data: bytes, span: int, components: Sequence[Component], last=2**32):
    """(counts, words) of each component of a packet."""
    n, at = varint(data, 0)
    if n > len(data) - at:
        raise BrokenRule("EXA-003")
    counts = page.decode_packet(data[at : at + n], span, last, len(components))
    rest = data[at + n :]
    parts = split_parts(rest, len(components), "EXA-003") if rest else [b""] * len(components)
    words: dict[int, list[int]] = {}
    for place_ in order(components):
        mine, row = components[place_], counts[place_]
        away = [0] * span
        if parts[place_]:
            away = moves(parts[place_], row)
        words[place_] = []
        for t, count in enumerate(row):
            if mine.rule == 4:
                v = linear(t, count, mine, words)
            else:
                v = value(count, *mine.affine, mine.rule, mine.digits, mine.c)
            words[place_].append(word_at(place(bits(v)) + away[t]))
    return counts, [words[a] for a in range(len(components))]


def encode_components(words, counts, components: Sequence[Component], recall=False) -> bytes:
    """A packet; words as signed integers b."""
    parts = []
    for mine, own, row in zip(components, words, counts, strict=True):
        if mine.rule == 4:
            values = [linear(t, count, mine, words) for t, count in enumerate(row)]
        else:
            values = [value(c, *mine.affine, mine.rule, mine.digits, mine.c) for c in row]
        parts.append(corrected(own, values, row, EVEN if recall else None))
    coded = page.encode_packet([page.encode(list(row)) for row in counts])
    rest = b"".join(page.varint_bytes(len(part)) for part in parts[:-1]) + b"".join(parts)
    return page.varint_bytes(len(coded)) + coded + (rest if any(parts) else b"")


EVEN = ((128,),) * 3
"""Probabilities of ranks of which nothing is known."""


def flat_table(numbers):
    """All lengths that there are, equally likely."""
    sizes = [bits_of(abs(n)) for n in numbers]
    return min(sizes), [1] * (max(sizes) - min(sizes) + 1)


def encode_exact(
    words, counts, affine, rule: int, digits: int, *, p=None, table=None, states=1, c=()
):
    """What follows the counts; words as signed integers b; ``p``: None without recall."""
    values = [value(count, *affine, rule, digits, c) for count in counts]
    return corrected(words, values, counts, p, table, states)


def corrected(words, values, counts, p, table=None, states=1) -> bytes:
    """A part: what leads from the values to the words."""
    away = [place(w) - place(bits(v)) for w, v in zip(words, values, strict=True)]
    if not any(away):
        return b""
    z = 0
    while all(c % 2 ** (z + 1) == 0 for c in away):
        z += 1
    small = [c // 2**z for c in away]
    return build_exact(small, counts, z, p, table or flat_table(small), states)


def build_exact(small, counts, z, p, table, states=1) -> bytes:
    """What follows the counts, of these corrections."""
    coder = Coder(states=states)
    corrections(coder, counts, p, table, small)
    head = [(p is not None) + 2 * (states == 4), z]
    for row in p or ():
        head += [len(row), *row]
    first, weights = table
    return bytes([*head, first, len(weights), *weights]) + coder.finish()


def heading_of(rest: bytes):
    """(p, table, states) of what follows the counts."""
    at, p = 2, None
    if rest[0] % 2:
        p = []
        for _ in range(3):
            p.append(list(rest[at + 1 : at + 1 + rest[at]]))
            at += 1 + rest[at]
    return p, table_of(rest, at)[0], 4 if rest[0] // 2 else 1
