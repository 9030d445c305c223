"""Adaptive binary range coding, and the integer model on top of it (SPEC 9.4).

The readable twin: bit by bit, in the order of the page. kernels/ holds the same in C.
"""

from __future__ import annotations

from collections import defaultdict

from ..errors import FormatError

PROBABILITY_BITS = 16
LEAST, MOST = 64, 65472
"""No bit costs less than 0.0014 bits or more than 10."""

COUNT_LIMIT = 250
"""From here on p moves by 1/252 of the way; q always by 1/16."""

FAST_FROM = 8
"""Bits that p alone has learned from before q is mixed in."""

RATES = tuple(131072 // (2 * n + 3) for n in range(COUNT_LIMIT + 1))
"""R of SPEC 9.4 for each n."""

BUCKETS = 80
ERROR_BITS = 34
"""Bits of a magnitude that the integer model takes (RNG-003)."""

WORD = (1 << 32) - 1

OUT_OF_RANGE = "a prediction error of 2^34 or more, or an index beyond 2^32"
"""What an encoder must not ask for."""


class BitModel:
    """Probability of a 1: slow and counted (p, n), and fast (q)."""

    __slots__ = ("n", "p", "q")

    def __init__(self) -> None:
        self.p = self.q = 32768
        self.n = 0

    def probability(self) -> int:
        mixed = self.p if self.n < FAST_FROM else (3 * self.p + self.q) // 4
        return LEAST if mixed < LEAST else MOST if mixed > MOST else mixed

    def update(self, bit: int) -> None:
        t = 65535 * bit
        self.p += ((t - self.p) * RATES[self.n]) >> PROBABILITY_BITS
        self.q += (t - self.q) >> 4
        if self.n < COUNT_LIMIT:
            self.n += 1


def end_of(x1: int, x2: int) -> bytes:
    """The last bytes of a packet whose coder stands at x1, x2 (RNG-001)."""
    for size in range(5):
        unit = 1 << (32 - 8 * size)
        value = -(-x1 // unit) * unit
        if value <= x2:
            return value.to_bytes(5, "big")[1 : 1 + size]
    raise AssertionError("x1 itself fits four bytes")


class RangeEncoder:
    """Bits to bytes."""

    def __init__(self) -> None:
        self.x1, self.x2 = 0, WORD
        self.out = bytearray()

    def bit(self, bit: int, model: BitModel) -> None:
        self.split(bit, model.probability())
        model.update(bit)

    def split(self, bit: int, probability: int) -> None:
        r = self.x2 - self.x1
        m = self.x1 + (r >> 16) * probability + ((r & 0xFFFF) * probability >> 16)
        if bit:
            self.x2 = m
        else:
            self.x1 = m + 1
        while self.x1 >> 24 == self.x2 >> 24:
            self.out.append(self.x2 >> 24)
            self.x1 = (self.x1 << 8) & WORD
            self.x2 = (self.x2 << 8) & WORD | 255

    def raw(self, value: int, bits: int) -> None:
        """``bits`` bits of ``value``, the highest first."""
        for at in range(bits - 1, -1, -1):
            self.split(value >> at & 1, 1 << 15)

    def finish(self) -> bytes:
        return bytes(self.out) + end_of(self.x1, self.x2)


class RangeDecoder:
    """Bytes to bits; ``data`` stands at ``offset`` of the file, ``shifts`` is the n of RNG-001."""

    def __init__(self, data: bytes, offset: int = 0) -> None:
        self.data = data
        self.offset = offset
        self.x1, self.x2 = 0, WORD
        self.x = int.from_bytes(data[:4].ljust(4, b"\0"), "big")
        self.shifts = 0

    def bit(self, model: BitModel) -> int:
        bit = self.split(model.probability())
        model.update(bit)
        return bit

    def split(self, probability: int) -> int:
        r = self.x2 - self.x1
        m = self.x1 + (r >> 16) * probability + ((r & 0xFFFF) * probability >> 16)
        bit = int(self.x <= m)
        if bit:
            self.x2 = m
        else:
            self.x1 = m + 1
        while self.x1 >> 24 == self.x2 >> 24:
            at = self.shifts + 4
            self.x1 = (self.x1 << 8) & WORD
            self.x2 = (self.x2 << 8) & WORD | 255
            self.x = (self.x << 8) & WORD | (self.data[at] if at < len(self.data) else 0)
            self.shifts += 1
        return bit

    def raw(self, bits: int) -> int:
        value = 0
        for _ in range(bits):
            value = value << 1 | self.split(1 << 15)
        return value

    @property
    def place(self) -> int:
        """Where an error is reported: what was shifted out lies before it."""
        return self.offset + min(self.shifts, len(self.data))

    def finish(self) -> None:
        """RNG-001."""
        if self.data[self.shifts :] != end_of(self.x1, self.x2) or self.shifts > len(self.data):
            raise FormatError(
                "the coded bits do not end with their packet",
                requirement="RNG-001",
                offset=self.place,
            )


def row_of_models() -> list[BitModel]:
    return [BitModel() for _ in range(BUCKETS)]


class IntegerModel:
    """Signed integers by the scale of those before them."""

    def __init__(self) -> None:
        self.f = self.s = self.t = self.g = 0
        # Z and M of SPEC 9.4, by context; the most of the 40 are never met within a packet.
        self.buckets: defaultdict[int, list[BitModel]] = defaultdict(row_of_models)
        self.halves: defaultdict[int, list[BitModel]] = defaultdict(row_of_models)
        self.signs = [BitModel() for _ in range(3)]

    def scale(self) -> tuple[int, int]:
        """(h, c) of SPEC 9.4."""
        mean = (self.f + self.s) >> 1
        lg = max(mean.bit_length() - 1, 0)
        fr = (mean >> (lg - 2) if lg >= 2 else mean << (2 - lg)) & 3
        h = max(0, lg - 10)
        return h, 36 + fr if h else min(max(4 * lg + fr - 8, 0), 35)

    def learn(self, e: int) -> None:
        u = abs(e) << 8
        self.g = (e > 0) - (e < 0)
        self.f += (u - self.f) >> 3
        self.s += (u - self.s) >> min(7, (self.t + 1).bit_length())
        self.t += 1

    def encode(self, coder: RangeEncoder, e: int) -> None:
        u = abs(e)
        if u >> ERROR_BITS:
            raise ValueError(OUT_OF_RANGE)
        h, c = self.scale()
        w = u >> h
        k, low, bits = bucket_of(w)
        models = self.buckets[c]
        for i in range(k):
            coder.bit(1, models[i])
        coder.bit(0, models[k])
        coder.raw(low, bits)
        if h:
            coder.bit(u >> (h - 1) & 1, self.halves[c][k])
            coder.raw(u & ((1 << (h - 1)) - 1), h - 1)
        if u:
            coder.bit(int(e < 0), self.signs[self.g + 1])
        self.learn(e)

    def decode(self, coder: RangeDecoder) -> int:
        h, c = self.scale()
        models = self.buckets[c]
        k = 0
        while coder.bit(models[k]):
            k += 1
            if k == BUCKETS:
                raise FormatError("a bucket of 80", requirement="RNG-002", offset=coder.place)
        if k < 12:
            w = k
        else:
            exponent = (k - 8) >> 1
            v = (2 + (k & 1)) << (exponent - 1)
            w = (v | coder.raw(exponent - 1)) + 8
        if w >> (ERROR_BITS - h):
            raise FormatError(
                "a magnitude of 2^34 or more", requirement="RNG-003", offset=coder.place
            )
        u = w << h
        if h:
            u |= coder.bit(self.halves[c][k]) << (h - 1)
            u |= coder.raw(h - 1)
        e = -u if u and coder.bit(self.signs[self.g + 1]) else u
        self.learn(e)
        return e


def bucket_of(w: int) -> tuple[int, int, int]:
    """(k, the low bits of v, how many they are)."""
    if w < 12:
        return w, 0, 0
    v = w - 8
    exponent = v.bit_length() - 1
    half = v >> (exponent - 1) & 1
    return 2 * exponent + 8 + half, v & ((1 << (exponent - 1)) - 1), exponent - 1
