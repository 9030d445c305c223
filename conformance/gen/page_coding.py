"""SPEC 9.4 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

import re
from functools import cache
from math import isqrt
from pathlib import Path

from page_numbers import BrokenRule, bits_of

CLAUSE = (Path(__file__).resolve().parent.parent.parent / "SPEC.md").read_text(encoding="utf-8")
CLAUSE = CLAUSE[CLAUSE.index("### 9.4") : CLAUSE.index("### 9.5")]
ROWS = [
    [int(n) for n in re.findall(r"-?\d+", row)]
    for row in re.findall(r"^\| (?:shape|scale|zeros|half) \|(.*)\|$", CLAUSE, re.M)
]
CLASSES = list(zip(*ROWS, strict=True))
DIGEST = re.search(r"`([0-9a-f]{64})`", CLAUSE)[1]

EDGES = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44]
EXTRA = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4]


@cache
def class_ends(number: int, c: int) -> list[int]:
    shape, scale, zeros, half = CLASSES[number]
    lg, fr = (c + 8) // 4, (c + 8) % 4
    m = (((9 + 2 * fr) * 2**lg) // 8 + 1) * scale // 64 + 1
    t = 65536 * m // (m + 256)
    g = [65536, isqrt(65536 * t) if half == 1 else t]
    for w in range(2, 45):
        g.append(g[w - 1] * t // 65536)
    tail = [(8 + shape) * each * 65536 // (8 * 65536 + shape * each) for each in g]
    less = [x * 64512 // max(tail[1], 1) if zeros == -1 else x * (64 - zeros) // 64 for x in tail]
    ends = [k + 1 + (65536 - min(less[EDGES[k + 1]], 65535)) * 4080 // 65536 for k in range(15)]
    return [*ends, 4096]


def bit_ends(p: int) -> list[int]:
    return [4096 - 16 * p, 4096]


def length_ends(weights) -> list[int]:
    n, total = len(weights), sum(weights)
    return [i + 1 + (4096 - n) * sum(weights[: i + 1]) // total for i in range(n)]


class Coder:
    """Decodes ``coded``; without it encodes the symbols that its caller gives."""

    def __init__(self, coded: bytes | None = None, states: int = 1):
        self.coded, self.front, self.states = coded, 0, states
        self.raw: list[int] = []
        self.sections: list[list] = []
        self.i = 0
        self.x = [self.word() * 65536 + self.word() for _ in range(states)]
        self.check()

    def word(self) -> int:
        if self.coded is None:
            return 0
        pair = (self.coded + bytes(self.front + 2))[self.front : self.front + 2]
        self.front += 2
        return pair[0] * 256 + pair[1]

    def section(self) -> None:
        self.i = 0
        self.sections.append([])

    def symbol(self, ends, k: int | None = None) -> int:
        at = self.i % self.states
        self.i += 1
        if self.coded is None:
            self.sections[-1].append((ends, k))
            return k
        x = self.x[at]
        slot = x % 4096
        k = next(k for k, end in enumerate(ends) if slot < end)
        first = ends[k - 1] if k > 0 else 0
        x = (ends[k] - first) * (x // 4096) + slot - first
        if x < 65536:
            x = x * 65536 + self.word()
        self.x[at] = x
        return k

    def number(self, bits: int, value: int | None = None) -> int:
        """Raw bits, lowest first."""
        out = 0
        for i in range(bits):
            at = len(self.raw)
            if self.coded is None:
                bit = value // 2**i % 2
            else:
                byte = self.coded[-1 - at // 8] if at // 8 < len(self.coded) else 0
                bit = byte // 2 ** (at % 8) % 2
            self.raw.append(bit)
            out += bit * 2**i
        return out

    def check(self) -> None:
        """RNG-001, before the end."""
        if self.coded is not None and self.front - -len(self.raw) // 8 > len(self.coded):
            raise BrokenRule("RNG-001")

    def end(self) -> bytes:
        """All coded bytes: each step of the decoder backwards, from the last to the first."""
        x, words = [65536] * self.states, []
        for section in reversed(self.sections):
            for i, (ends, k) in reversed(list(enumerate(section))):
                at, first = i % self.states, ends[k - 1] if k > 0 else 0
                width = ends[k] - first
                # The state before is this one, or its part above a word that was read.
                if x[at] // width * 4096 >= 2**32:
                    words.insert(0, x[at] % 65536)
                    x[at] //= 65536
                x[at] = x[at] // width * 4096 + x[at] % width + first
        front = b"".join(each.to_bytes(4, "big") for each in x)
        front += b"".join(word.to_bytes(2, "big") for word in words)
        back = sum(bit * 2**i for i, bit in enumerate(self.raw))
        return front + back.to_bytes(-(-len(self.raw) // 8), "big")

    def finish(self) -> bytes:
        """All coded bytes; RNG-001."""
        if self.coded is None:
            return self.end()
        spare = self.number(-len(self.raw) % 8)
        used = self.front + len(self.raw) // 8
        if self.x != [65536] * self.states or used != len(self.coded) or spare:
            raise BrokenRule("RNG-001")
        return self.coded


def code_bits(coder, count, p, bits=None):
    """A section of bits, each with the probability that the two before it choose."""
    coder.section()
    out = []
    for t in range(count):
        r1 = out[t - 1] if t >= 1 else 0
        r2 = out[t - 2] if t >= 2 else 0
        out.append(coder.symbol(bit_ends(p[2 * r1 + r2]), None if bits is None else bits[t]))
        coder.check()
    return out


def context_of(mean):
    """(context, h) of a block whose averages have this mean"""
    lg = max(bits_of(mean), 1) - 1
    fr = mean * 4 // 2**lg % 4
    return max(0, 4 * min(lg, 10) + fr - 8), max(0, lg - 10)


def symbol_of(e, h):
    return sum(abs(e) // 2**h >= edge for edge in EDGES) - 1


def code_rest(coder, k, h, signs, e=None):
    """The integer whose symbol is k: what is raw of it."""
    u = None if e is None else abs(e)
    if k < 15:
        low = EDGES[k] * 2**h
        got = low + coder.number(EXTRA[k] + h, None if u is None else u - low)
    else:
        y = None if u is None else u // 2**h - 43
        length = coder.number(6, None if u is None else bits_of(y) - 1)
        rest = coder.number(length, None if u is None else y - 2**length)
        high = 2**length + rest + 43
        got = high * 2**h
        if coder.coded is None or got < 2**34:
            got += coder.number(h, None if u is None else u % 2**h)
    if coder.coded is not None and got >= 2**34:
        raise BrokenRule("RNG-003")
    minus = 0
    if signs and got > 0:
        minus = coder.number(1, None if e is None else int(e < 0))
    return -got if minus else got


def code_integers(coder, count, number, a, signs, integers=None):
    """A section of integers of a class; ``signs``: with raw signs."""
    coder.section()
    f = s = (4 + a % 4) * 2 ** (a // 4)
    out = []
    for start in range(0, count, 8):
        size = min(8, count - start)
        told = None if integers is None else integers[start : start + size]
        c, h = context_of((f + s) // 2)
        ends = class_ends(number, c)
        ks = [
            coder.symbol(ends, None if told is None else symbol_of(told[i], h)) for i in range(size)
        ]
        total = 0
        for i, k in enumerate(ks):
            e = code_rest(coder, k, h, signs, None if told is None else told[i])
            out.append(e)
            total += abs(e)
        coder.check()
        f += (32 * total - f) // 2
        s += 3 * (32 * total - s) // 16
    return out


class Model:
    """P.p and P.n of a letter and contexts; ``limit`` is that of all its flags."""

    def __init__(self, letter: str, *place: int):
        self.p, self.n, self.limit = 32768, 0, 5 if letter == "A" else 7
        if letter in "AB" and place[1] < place[0] - {"A": 2, "B": 5}[letter]:
            self.p, self.n = 8192, 2

    def learn(self, bit: int) -> None:
        t = min(bits_of(self.n + 2) - 1, self.limit)
        self.p += (65535 - self.p) // 2**t if bit else -(self.p // 2**t)
        self.n += 1


def code_flag(coder, models, bit=None):
    """A flag of one model or two."""
    mean = sum(model.p for model in models) // (16 * len(models))
    bit = coder.symbol([4096 - mean, 4096], bit)
    for model in models:
        model.learn(bit)
    return bit


def code_by_bits(coder, count, signs, integers=None, kept=None):
    """A section of integers by bits; ``kept`` takes the models, by letter and contexts."""
    coder.section()
    models = {} if kept is None else kept

    def model(*place):
        return models.setdefault(place, Model(*place))

    out, a, b, s, d = [], 0, 0, 0, 0
    for number in range(count):
        e = None if integers is None else integers[number]
        told = None if e is None else abs(e)
        last = None if e is None else told if told < 3 else bits_of(told - 1) + 1
        g = 2 * a + b
        i, j, k = g if g < 3 else min(1 + bits_of(g), 8), min(bits_of(s), 11), 0
        while not code_flag(
            coder, [model("A", i, k), model("B", j, k)], None if e is None else int(k == last)
        ):
            k += 1
            if k > 35 and coder.coded is not None:
                coder.check()
                raise BrokenRule("RNG-003")
        u = k
        if k > 2:
            rest = None if e is None else told - 1 - 2 * 2 ** (k - 3)
            half = code_flag(coder, [model("C", k)], None if e is None else rest // 2 ** (k - 3))
            u = (2 + half) * 2 ** (k - 3) + 1
            u += coder.number(k - 3, None if e is None else rest % 2 ** (k - 3))
        if u >= 2**34 and coder.coded is not None:
            raise BrokenRule("RNG-003")
        if signs and u > 0:
            d = 1 + code_flag(coder, [model("D", d)], None if e is None else int(e < 0))
        coder.check()
        out.append(-u if signs and u > 0 and d == 2 else u)
        b, a, s = a, u, s + (64 * u - s) // 8
    return out


def code_lengths(coder, count, table, integers=None):
    """A section of integers by length; ``table``: (first, weights)."""
    coder.section()
    return [
        code_length(coder, table, None if integers is None else integers[i]) for i in range(count)
    ]


def code_length(coder, table, e=None):
    first, weights = table
    u = None if e is None else abs(e)
    length = first + coder.symbol(length_ends(weights), None if u is None else bits_of(u) - first)
    got = 0
    if length > 0:
        got = 2 ** (length - 1)
        got += coder.number(length - 1, None if u is None else u - got)
        if coder.number(1, None if e is None else int(e < 0)):
            got = -got
    coder.check()
    return got


def code_signs(coder, magnitudes, p, integers=None):
    """The integers, given their magnitudes."""
    coder.section()
    out = []
    for i, u in enumerate(magnitudes):
        minus = 0
        if u > 0:
            before = out[-1] if out else 0
            x = p[0 if before < 0 else 2 if before > 0 else 1]
            minus = coder.symbol(bit_ends(x), None if integers is None else int(integers[i] < 0))
            coder.check()
        out.append(-u if minus else u)
    return out


def table_of(data: bytes, at: int):
    """(first, weights) and where they end; RNG-004."""
    if len(data) < at + 2 or len(data) < at + 2 + data[at + 1]:
        raise BrokenRule("RNG-004")
    first, n = data[at : at + 2]
    weights = list(data[at + 2 : at + 2 + n])
    if n < 1 or first + n > 64 or not any(weights):
        raise BrokenRule("RNG-004")
    return (first, weights), at + 2 + n


def some_bytes(data: bytes, at: int, count: int):
    """Probabilities, and where they end; RNG-004."""
    found = list(data[at : at + count])
    if len(found) < count or 0 in found:
        raise BrokenRule("RNG-004")
    return found, at + count
