"""Entropy coding (SPEC 9.4). kernels/ implements the same in C.

Symbols are read from the front of the coded bytes, raw bits from their back. The encoder collects
symbols in sections, in the order of the decoder. Then it codes them from the last to the first.
"""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import isqrt, log2

from ..errors import FormatError

SCALE = 4096
"""The frequencies of all symbols together."""

LEAST = 1 << 16
"""The smallest state of the coder; every state ends with this value."""

FOUR = 4096
"""Symbols from which on the encoder takes four states; one state takes 6 bytes less."""

SYMBOLS, ESCAPE, CONTEXTS, CLASSES = 16, 15, 36, 16
LENGTHS = 64
"""Integers have fewer bits."""

BLOCK = 8
"""Integers that share a context."""

START_MOST = 163
"""Largest byte that gives the first average, which is below 2^43 then."""

FEW = 16
"""Integers at the beginning whose mean an encoder lets the averages begin with."""

ERROR_BITS = 34
"""Every magnitude is below 2^34."""

EDGES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44)
EXTRA = (0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4, 0)

ROWS = (
    (8, 38, 0, 0), (32, 24, 0, 0), (-4, 38, 0, 0), (-7, 24, -1, 0),
    (64, 14, 0, 0), (8, 38, 0, 1), (16, 76, 32, 0), (0, 38, 0, 1),
    (32, 17, 0, 0), (8, 28, 0, 1), (8, 14, 0, 1), (-4, 76, 0, 1),
    (-6, 38, 0, 0), (16, 24, -1, 0), (64, 24, 0, 0), (0, 14, 0, 1),
)  # fmt: skip
"""Shape, scale, zeros and half of each class, chosen to suit prediction errors of sensors."""

QUIET = 2
"""Bits an integer: sections that take more are not tried by bits, which take longer to decode."""

SURE = 1024
"""A section of this many integers with a mean below a half is coded by bits in any case."""

FAST, SLOW = 5, 7
"""How slowly models learn at most: by a 32nd or a 128th of what they lack."""

NEAR, LOUD, KINDS, PLAIN = 9, 12, 36, 3
"""Contexts by the two magnitudes before, and by an average; kinds of magnitudes, by size; those
that are one magnitude."""

OUT_OF_RANGE = "an index beyond 2^32, or a prediction error of 2^34 or more"

Ends = tuple[int, ...]
"""Where the share of each symbol ends: frequencies, added up, of which the last is 4096."""


@lru_cache(CLASSES * CONTEXTS)
def ends_of(number: int, context: int) -> Ends:
    """The symbols of a class in a context."""
    shape, scale, zeros, half = ROWS[number]
    lg, fr = divmod(context + 8, 4)
    mean = (((9 + 2 * fr) << lg) // 8 + 1) * scale // 64 + 1
    ratio = 65536 * mean // (mean + 256)
    g, least, ends = 65536, 0, list[int]()
    for w in range(1, EDGES[ESCAPE] + 1):
        g = isqrt(65536 * ratio) if w == 1 and half else g * ratio // 65536
        if w not in EDGES:
            continue
        tail = (8 + shape) * g * 65536 // (8 * 65536 + shape * g)
        least = tail if w == 1 else least
        tail = tail * 64512 // max(least, 1) if zeros < 0 else tail * (64 - zeros) // 64
        tail = min(tail, 65535)
        ends.append(len(ends) + 1 + (65536 - tail) * (SCALE - SYMBOLS) // 65536)
    return (*ends, SCALE)


def bit_ends(p: int) -> Ends:
    """A bit that is 1 in ``p`` of 256 cases."""
    return SCALE - 16 * p, SCALE


@lru_cache(CLASSES)
def costs_of(number: int) -> tuple[int, ...]:
    """256 times the bits of each symbol in each context."""
    rows = (ends_of(number, context) for context in range(CONTEXTS))
    return tuple(
        int(256 * log2(SCALE / (end - first)) + 0.5)
        for row in rows
        for first, end in zip((0, *row), row, strict=False)
    )


def bit_cost(p: int) -> int:
    """256 times the bits of what has this probability in 256ths."""
    return int(256 * log2(256 / p) + 0.5)


def probability(zeros: int, ones: int) -> int:
    """In 256ths, of a 1."""
    n = zeros + ones
    return min(max((256 * ones + n // 2) // n, 1), 255) if n else 128


def context_of(mean: int) -> tuple[int, int]:
    """The context by an average of magnitudes times 256, and by how many bits magnitudes are
    shifted there."""
    lg = max(mean.bit_length() - 1, 0)
    fr = (mean * 4 >> lg) % 4
    return max(0, 4 * min(lg, 10) + fr - 8), max(0, lg - 10)


@dataclass
class Averages:
    """Running averages of the magnitudes before, times 256."""

    f: int
    s: int

    @classmethod
    def start(cls, start: int) -> Averages:
        """The averages of the first block, from a byte of the packet."""
        mean = (4 + start % 4) << (start // 4)
        return cls(mean, mean)

    def context(self) -> tuple[int, int]:
        """Those of the next block."""
        return context_of((self.f + self.s) // 2)

    def learn(self, block: Sequence[int]) -> None:
        mean = 32 * sum(map(abs, block))
        self.f += (mean - self.f) // 2
        self.s += 3 * (mean - self.s) // 16


@dataclass
class FlagModel:
    """How probable it is that a flag is 1, in 65536ths, learnt from the flags before."""

    p: int = 32768
    n: int = 0

    @classmethod
    def of(cls, *, rare: bool) -> FlagModel:
        """At first; ``rare``: as if it had learnt two zeros."""
        return cls(8192, 2) if rare else cls()

    def learn(self, bit: int, limit: int) -> None:
        t = min((self.n + 2).bit_length() - 1, limit)
        self.p += (65535 - self.p) >> t if bit else -(self.p >> t)
        self.n += 1


def flag_width(models: Sequence[FlagModel]) -> int:
    """How many of the 4096 mean that a flag is 1, by one model or two."""
    return sum(model.p for model in models) // (16 * len(models))


def learn_flag(models: Sequence[FlagModel], bit: int) -> None:
    """The first of two models learns fast, any other slowly."""
    for model, limit in zip(reversed(models), (SLOW, FAST), strict=False):
        model.learn(bit, limit)


class Models:
    """What a section of integers by bits has learnt."""

    def __init__(self) -> None:
        self.near = [[FlagModel.of(rare=k < i - 2) for k in range(KINDS)] for i in range(NEAR)]
        self.loud = [[FlagModel.of(rare=k < j - 5) for k in range(KINDS)] for j in range(LOUD)]
        self.halves = [FlagModel() for _ in range(KINDS)]
        self.signs = (FlagModel(), FlagModel(), FlagModel())
        self.a = self.b = self.s = self.d = 0

    def size(self) -> tuple[list[FlagModel], list[FlagModel]]:
        """The models of the next magnitude, for each kind."""
        g = 2 * self.a + self.b
        i = g if g < PLAIN else min(1 + g.bit_length(), NEAR - 1)
        return self.near[i], self.loud[min(self.s.bit_length(), LOUD - 1)]

    def half(self, kind: int) -> tuple[FlagModel]:
        return (self.halves[kind],)

    def sign(self) -> tuple[FlagModel]:
        return (self.signs[self.d],)

    def learn(self, number: int) -> None:
        u = abs(number)
        if number:
            self.d = 1 + (number < 0)
        self.b, self.a = self.a, u
        self.s += (64 * u - self.s) // 8


def kind_of(u: int) -> int:
    return u if u < PLAIN else 1 + (u - 1).bit_length()


@dataclass(frozen=True)
class Lengths:
    """How frequent each bit length is, from the first one on: integers of few kinds of length."""

    first: int
    weights: bytes

    @classmethod
    def of(cls, numbers: Sequence[int]) -> Lengths:
        lengths = [abs(e).bit_length() for e in numbers] or [0]
        first = min(lengths)
        counts = [0] * (max(lengths) - first + 1)
        for length in lengths:
            counts[length - first] += 1
        top = max(counts)
        return cls(first, bytes(max(1, (255 * c + top // 2) // top) if c else 0 for c in counts))

    def build(self) -> bytes:
        return bytes([self.first, len(self.weights)]) + self.weights

    @classmethod
    def parse(cls, data: bytes) -> Lengths | None:
        """What ``data`` begins with; None where it is not defined."""
        count = data[1] if len(data) > 1 else LENGTHS + 1
        weights = data[2 : 2 + count]
        fits = count == len(weights) and data[0] + count <= LENGTHS and any(weights)
        return cls(data[0], weights) if fits else None

    @cached_property
    def ends(self) -> Ends:
        total, n, sums = sum(self.weights), len(self.weights), 0
        ends = []
        for i, weight in enumerate(self.weights):
            sums += weight
            ends.append(i + 1 + (SCALE - n) * sums // total)
        return tuple(ends)


class Decoder:
    """Coded bytes, which begin at ``offset`` of the file; behind both ends are zeros.

    Few bytes may ask for many integers: each takes 8 bytes here, and no object of its own.
    """

    def __init__(self, data: bytes, offset: int, lanes: int) -> None:
        self.data, self.offset = data, offset
        self.front, self.raw_bits = 0, 0
        self.states = [self._word() << 16 | self._word() for _ in range(lanes)]
        self.lane = 0
        self.check()

    def _word(self) -> int:
        word = int.from_bytes(self.data[self.front : self.front + 2].ljust(2, b"\0"), "big")
        self.front += 2
        return word

    @property
    def place(self) -> int:
        """Where in the file the coder is."""
        return self.offset + min(self.front, len(self.data))

    def section(self) -> None:
        """What follows begins with the first state."""
        self.lane = 0

    def symbol(self, ends: Ends) -> int:
        x = self.states[self.lane]
        slot = x % SCALE
        k = bisect_right(ends, slot)
        first = ends[k - 1] if k else 0
        x = (ends[k] - first) * (x // SCALE) + slot - first
        if x < LEAST:
            x = x << 16 | self._word()
        self.states[self.lane] = x
        self.lane = (self.lane + 1) % len(self.states)
        return k

    def raw(self, bits: int) -> int:
        stop = max(len(self.data) - self.raw_bits // 8, 0)
        start = max(len(self.data) - (self.raw_bits + bits + 7) // 8, 0)
        word = int.from_bytes(self.data[start:stop], "big") >> self.raw_bits % 8
        self.raw_bits += bits
        return word & ((1 << bits) - 1)

    def check(self) -> None:
        """RNG-001 before the end: no more than there is."""
        if self.front + (self.raw_bits + 7) // 8 > len(self.data):
            raise self.ended_wrong()

    def finish(self) -> None:
        """RNG-001"""
        back = (self.raw_bits + 7) // 8
        padding = self.raw(-self.raw_bits % 8)
        if any(x != LEAST for x in self.states) or self.front + back != len(self.data) or padding:
            raise self.ended_wrong()

    def ended_wrong(self) -> FormatError:
        return FormatError(
            "the coded bytes do not end with their packet",
            requirement="RNG-001",
            offset=self.place,
        )

    def bits(self, count: int, probabilities: bytes) -> bytearray:
        """A section of bits, each with the probability that the two before it choose of four."""
        self.section()
        found = bytearray()
        recent = 0
        for _ in range(count):
            found.append(self.symbol(bit_ends(probabilities[recent])))
            recent = 2 * found[-1] + (recent >> 1)
            self.check()
        return found

    def integers(self, count: int, number: int, start: int, *, signs: bool) -> array[int]:
        """A section of integers of a class; ``signs``: each has its own, raw."""
        self.section()
        found = array("q")
        averages = Averages.start(start)
        while len(found) < count:
            context, h = averages.context()
            ends = ends_of(number, context)
            block = [self.symbol(ends) for _ in range(min(BLOCK, count - len(found)))]
            for i, k in enumerate(block):
                u = self.magnitude(k, h)
                block[i] = -u if signs and u and self.raw(1) else u
            self.check()
            averages.learn(block)
            found.extend(block)
        return found

    def magnitude(self, k: int, h: int) -> int:
        """By its symbol and its raw bits, below 2**34."""
        if k < ESCAPE:
            u = (EDGES[k] << h) + self.raw(EXTRA[k] + h)
        else:
            length = self.raw(6)
            w = (1 << length) + self.raw(length) + EDGES[ESCAPE] - 1
            u = w << h if w >> (ERROR_BITS - h) else w << h | self.raw(h)
        if u >> ERROR_BITS:
            raise self.too_large()
        return u

    def too_large(self) -> FormatError:
        return FormatError("a magnitude of 2^34 or more", requirement="RNG-003", offset=self.place)

    def by_length(self, lengths: Lengths) -> int:
        """An integer of a section of lengths."""
        length = lengths.first + self.symbol(lengths.ends)
        u = 1 << (length - 1) | self.raw(length - 1) if length else 0
        e = -u if u and self.raw(1) else u
        self.check()
        return e

    def flag(self, *models: FlagModel) -> int:
        width = flag_width(models)
        bit = self.symbol((SCALE - width, SCALE))
        learn_flag(models, bit)
        return bit

    def by_bits(self, count: int, *, signs: bool) -> array[int]:
        """A section of integers by bits."""
        self.section()
        found, models = array("q"), Models()
        for _ in range(count):
            near, loud = models.size()
            k = 0
            while not self.flag(near[k], loud[k]):
                k += 1
                if k == KINDS:
                    self.check()
                    raise self.too_large()
            u = k
            if k >= PLAIN:
                u = (2 + self.flag(*models.half(k)) << k - PLAIN) + 1 + self.raw(k - PLAIN)
            if u >> ERROR_BITS:
                raise self.too_large()
            negative = signs and u and self.flag(*models.sign())
            self.check()
            found.append(-u if negative else u)
            models.learn(found[-1])
        return found

    def signed(self, magnitudes: array[int], probabilities: bytes) -> array[int]:
        """With a section of signs, each with the probability of the sign before it."""
        self.section()
        last = 0
        for i, u in enumerate(magnitudes):
            if u:
                negative = self.symbol(bit_ends(probabilities[last + 1]))
                self.check()
                magnitudes[i] = -u if negative else u
                last = 1 - 2 * negative
            else:
                last = 0
        return magnitudes


@dataclass
class Encoder:
    """Notes sections of symbols, and writes raw bits; ``finish`` codes the symbols."""

    many_pay: bool = True
    """Whether there may be four states."""

    sections: list[list[tuple[int, int]]] = field(default_factory=list)
    """For each symbol, where its share begins and ends."""

    raw_bits: int = 0
    raw_value: list[tuple[int, int]] = field(default_factory=list)

    @property
    def many(self) -> bool:
        """Whether four states pay."""
        return self.many_pay and sum(len(section) + 1 for section in self.sections) >= FOUR

    def section(self, shares: Iterable[tuple[int, int]]) -> None:
        self.sections.append(list(shares))

    def raw(self, value: int, bits: int) -> None:
        self.raw_value.append((value & ((1 << bits) - 1), bits))
        self.raw_bits += bits

    def finish(self) -> bytes:
        states = [LEAST] * (4 if self.many else 1)
        words: list[int] = []
        for section in reversed(self.sections):
            for i in range(len(section) - 1, -1, -1):
                first, end = section[i]
                lane = i % len(states)
                x, width = states[lane], end - first
                if x >= width << 20:
                    words.append(x & 0xFFFF)
                    x >>= 16
                states[lane] = (x // width) * SCALE + x % width + first
        front = b"".join(x.to_bytes(4, "big") for x in states)
        front += b"".join(word.to_bytes(2, "big") for word in reversed(words))
        return front + self._back()

    def _back(self) -> bytes:
        out, tail, count = bytearray(), 0, 0
        for value, bits in self.raw_value:
            tail |= value << count
            count += bits
            while count >= 8:
                out.append(tail & 0xFF)
                tail >>= 8
                count -= 8
        if count:
            out.append(tail)
        return bytes(reversed(out))


def share_of(ends: Ends, k: int) -> tuple[int, int]:
    return (ends[k - 1] if k else 0), ends[k]


def start_of(numbers: Sequence[int]) -> int:
    """The byte for averages like those of the first few integers."""
    few = [abs(e) if abs(e) >> ERROR_BITS == 0 else 0 for e in numbers[:FEW]]
    mean = 256 * sum(few) // max(len(few), 1)
    lg = mean.bit_length() - 1
    return 4 * (lg - 2) + (mean >> (lg - 2)) % 4 if mean >= 4 else 0


def symbol_of(u: int, h: int) -> int:
    """The symbol of a magnitude."""
    return bisect_right(EDGES, u >> h) - 1


def put_rest(coder: Encoder, u: int, k: int, h: int) -> None:
    """The raw bits of a magnitude with symbol k."""
    if k < ESCAPE:
        coder.raw(u - (EDGES[k] << h), EXTRA[k] + h)
    else:
        y = (u >> h) - EDGES[ESCAPE] + 1
        length = y.bit_length() - 1
        coder.raw(length, 6)
        coder.raw(y, length)
        coder.raw(u, h)


def split_integers(numbers: Sequence[int], start: int) -> tuple[list[tuple[int, int]], list[int]]:
    """The context and the symbol of each integer; the shift of each."""
    averages, found, shifts = Averages.start(start), [], []
    for at in range(0, len(numbers), BLOCK):
        block = numbers[at : at + BLOCK]
        context, h = averages.context()
        for e in block:
            if abs(e) >> ERROR_BITS:
                raise ValueError(OUT_OF_RANGE)
            found.append((context, symbol_of(abs(e), h)))
            shifts.append(h)
        averages.learn(block)
    return found, shifts


def put_by_length(coder: Encoder, numbers: Sequence[int], lengths: Lengths) -> None:
    """A section of lengths."""
    coder.section(share_of(lengths.ends, abs(e).bit_length() - lengths.first) for e in numbers)
    for e in numbers:
        if e:
            coder.raw(abs(e), abs(e).bit_length() - 1)
            coder.raw(int(e < 0), 1)


def class_cost(numbers: Sequence[int]) -> int:
    """256 times the bits of integers in their best class, without signs."""
    found, shifts = split_integers(numbers, start_of(numbers))
    total = 2048 + min(
        sum(costs_of(n)[SYMBOLS * context + k] for context, k in found) for n in range(CLASSES)
    )
    for e, (_, k), h in zip(numbers, found, shifts, strict=True):
        escape = 5 + ((abs(e) >> h) - EDGES[ESCAPE] + 1).bit_length()
        total += 256 * (h + (EXTRA[k] if k < ESCAPE else escape))
    return total


def put_integers(coder: Encoder, numbers: Sequence[int], *, signs: bool) -> tuple[int, int]:
    """A section of integers, in the class that codes them in the fewest bits; that class, and what
    averages begin with."""
    start = start_of(numbers)
    found, shifts = split_integers(numbers, start)
    for e, (_, k), h in zip(numbers, found, shifts, strict=True):
        u = abs(e)
        put_rest(coder, u, k, h)
        if signs and u:
            coder.raw(int(e < 0), 1)
    counts: dict[int, int] = {}
    for context, k in found:
        counts[SYMBOLS * context + k] = counts.get(SYMBOLS * context + k, 0) + 1
    number = min(
        range(CLASSES), key=lambda n: sum(costs_of(n)[i] * count for i, count in counts.items())
    )
    coder.section(share_of(ends_of(number, context), k) for context, k in found)
    return number, start


@dataclass
class ByBits:
    """A section of integers by bits, not written yet."""

    shares: list[tuple[int, int]] = field(default_factory=list)
    raw: list[tuple[int, int]] = field(default_factory=list)
    """Raw bits: a value, and how many of its lowest bits."""

    cost: int = 0
    """256 times the bits."""

    @classmethod
    def of(cls, numbers: Iterable[int], *, signs: bool) -> ByBits:
        found, models = cls(), Models()
        for e in numbers:
            u, (near, loud) = abs(e), models.size()
            kind = kind_of(u)
            for k in range(kind + 1):
                found.flag(k == kind, near[k], loud[k])
            if kind >= PLAIN:
                rest = kind - PLAIN
                found.flag(bool((u - 1) >> rest & 1), *models.half(kind))
                found.raw.append((u - 1, rest))
                found.cost += 256 * rest
            if signs and u:
                found.flag(e < 0, *models.sign())
            models.learn(e)
        return found

    def flag(self, bit: bool, *models: FlagModel) -> None:
        middle = SCALE - flag_width(models)
        first, end = (middle, SCALE) if bit else (0, middle)
        self.shares.append((first, end))
        self.cost += int(256 * log2(SCALE / (end - first)) + 0.5)
        learn_flag(models, bit)

    def put(self, coder: Encoder) -> None:
        coder.section(self.shares)
        for value, bits in self.raw:
            coder.raw(value, bits)


def quiet_section(numbers: Sequence[int]) -> ByBits | None:
    """Integers by bits, with signs, where these take less than those of a class."""
    size = len(numbers)
    if size >= SURE and sum(map(abs, numbers)) < 2 * size // 3:
        return ByBits.of(numbers, signs=True)
    cost = class_cost(numbers) + Signs.of(numbers).cost
    found = ByBits.of(numbers, signs=True) if cost <= 256 * QUIET * size else None
    return found if found and found.cost < cost else None


def put_bits(coder: Encoder, bits: Sequence[int]) -> bytes:
    """A section of bits, and the probabilities that suit them."""
    counts, contexts, recent = [[0, 0] for _ in range(4)], [], 0
    for bit in bits:
        contexts.append(recent)
        counts[recent][bit] += 1
        recent = 2 * bit + (recent >> 1)
    p = bytes(probability(*pair) for pair in counts)
    coder.section(share_of(bit_ends(p[c]), bit) for c, bit in zip(contexts, bits, strict=True))
    return p


@dataclass
class Signs:
    """Signs of the integers that are not 0: the state after each sign, and its probabilities."""

    marks: list[tuple[int, int]]
    probabilities: bytes
    pay: bool
    """Whether they take less than raw bits would."""

    cost: int
    """256 times the bits of the way that takes less."""

    @classmethod
    def of(cls, numbers: Iterable[int]) -> Signs:
        counts, marks, last = [[0, 0] for _ in range(3)], [], 0
        for e in numbers:
            if e:
                marks.append((last + 1, int(e < 0)))
                counts[last + 1][e < 0] += 1
            last = (e > 0) - (e < 0)
        p = bytes(probability(*pair) for pair in counts)
        cost = 256 * 8 * len(p) + sum(
            zeros * bit_cost(256 - q) + ones * bit_cost(q)
            for (zeros, ones), q in zip(counts, p, strict=True)
        )
        raw = 256 * len(marks)
        return cls(marks, p, cost < raw, min(cost, raw))

    def put(self, coder: Encoder) -> None:
        coder.section(share_of(bit_ends(self.probabilities[c]), bit) for c, bit in self.marks)
