"""Adaptive range coding, and the integer model on top of it (SPEC 9.4).

The readable twin: step by step, in the order of the page. kernels/ holds the same in C.
"""

from __future__ import annotations

from ..errors import FormatError

PROBABILITY_BITS = 16
LEAST, MOST = 64, 65472
"""No bit costs less than 0.0014 bits or more than 10."""

COUNT_LIMIT = 250
"""From here on p and z move by 1/252 of the way; q always by 1/16."""

FAST_FROM = 8
"""Bits that p alone has learned from before q is mixed in."""

RATES = tuple(131072 // (2 * n + 3) for n in range(COUNT_LIMIT + 1))
"""R of SPEC 9.4 for each n."""

SYMBOLS = 16
EDGES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44)
"""The least w of each bucket."""

EXTRA = (0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4, 0)
"""Raw bits of w after its bucket."""

ESCAPE = SYMBOLS - 1
CONTEXTS, SCALED = 36, 10
"""Contexts, and the lg from which on magnitudes are divided by a power of two."""

CONFIDENCE, ESCAPE_CONFIDENCE = 10, 2
"""n at the start: how many symbols the first table is worth."""

FIRST_SCALE = 32
"""An eighth, times 256: packets begin with what the base leaves, often nothing."""

ERROR_BITS = 34
"""Bits of a magnitude that the integer model takes (RNG-003)."""

HALF = 1 << 15
OUT_OF_RANGE = "a prediction error of 2^34 or more, or an index beyond 2^32"
"""What an encoder must not ask for."""


KEPT = 480
"""Bits that wait before whole bytes of them are put out."""


class BitModel:
    """Probability of a 1: slow and counted (p, n), and fast (q)."""

    __slots__ = ("n", "p", "q")

    def __init__(self) -> None:
        self.p = self.q = 32768
        self.n = 0

    def probability(self) -> int:
        mixed = self.p if self.n < FAST_FROM else (3 * self.p + self.q) >> 2
        return LEAST if mixed < LEAST else MOST if mixed > MOST else mixed

    def update(self, bit: int) -> None:
        t, p, q, n = 65535 * bit, self.p, self.q, self.n
        self.p = p + ((t - p) * RATES[n] >> PROBABILITY_BITS)
        self.q = q + ((t - q) >> 4)
        if n < COUNT_LIMIT:
            self.n = n + 1


class SymbolModel:
    """Probabilities of 16 symbols: z[i] / 65536 is that of a symbol above i."""

    __slots__ = ("n", "z")

    def __init__(self, z: tuple[int, ...], n: int) -> None:
        self.z = list(z)
        self.n = n

    def bound(self, width: int, i: int) -> int:
        """Where the symbols above i end in a range of ``width``."""
        return ((width - 16) * self.z[i] >> 16) + 15 - i

    def update(self, symbol: int) -> None:
        rate = RATES[self.n]
        z = self.z
        self.z = [x + ((65535 - x) * rate >> 16) for x in z[:symbol]]
        self.z += [x - (x * rate >> 16) for x in z[symbol:]]
        if self.n < COUNT_LIMIT:
            self.n += 1


def end_of(low: int, width: int) -> tuple[int, int]:
    """(v, r) of RNG-001: the coded number without its lowest r bits, which are zeros."""
    for r in (15, 14):
        v = -(-low >> r) << r
        if v + (1 << r) <= low + width:
            return v, r
    raise AssertionError("a range of 2^15 holds a whole quarter of 2^16")


class RangeEncoder:
    """Bits and symbols to bytes: the coded number from the front, raw bits from the back."""

    def __init__(self) -> None:
        self.low, self.width = 0, HALF
        self.bits = 15
        """Bits of ``low``; those before them are in ``out``."""
        self.out, self.back = bytearray(), bytearray()
        self.tail, self.tail_bits = 0, 0

    def bit(self, bit: int, model: BitModel) -> None:
        m = self.width * model.probability() >> 16
        # narrow() to what is below m for a 1, above it for a 0.
        if bit:
            width = m
        else:
            self.low += m
            width = self.width - m
        shift = 16 - width.bit_length()
        if shift:
            self.low <<= shift
            width <<= shift
            self.bits += shift
            if self.bits >= KEPT:
                self.put((self.bits - 16) // 8)
        self.width = width
        model.update(bit)

    def symbol(self, symbol: int, model: SymbolModel) -> None:
        lower = model.bound(self.width, symbol) if symbol < ESCAPE else 0
        upper = model.bound(self.width, symbol - 1) if symbol else self.width
        self.narrow(lower, upper - lower)
        model.update(symbol)

    def narrow(self, lower: int, width: int) -> None:
        shift = 16 - width.bit_length()
        self.low = (self.low + lower) << shift
        self.width = width << shift
        self.bits += shift
        if self.bits >= KEPT:
            self.put((self.bits - 16) // 8)

    def put(self, size: int) -> None:
        """The highest bytes of ``low``, and what they carry."""
        self.bits -= 8 * size
        top = self.low >> self.bits
        self.low &= (1 << self.bits) - 1
        if top >> (8 * size):
            at = len(self.out) - 1
            while self.out[at] == 255:
                self.out[at] = 0
                at -= 1
            self.out[at] += 1
        self.out += (top & ((1 << (8 * size)) - 1)).to_bytes(size, "big")

    def raw(self, value: int, bits: int) -> None:
        """The lowest ``bits`` bits of ``value``."""
        self.tail |= (value & ((1 << bits) - 1)) << self.tail_bits
        self.tail_bits += bits
        size = self.tail_bits // 8
        if size:
            self.back += (self.tail & ((1 << (8 * size)) - 1)).to_bytes(size, "little")
            self.tail >>= 8 * size
            self.tail_bits %= 8

    def finish(self) -> bytes:
        v, r = end_of(self.low, self.width)
        # All bits of v, in whole bytes, with room for what is left of the raw bits.
        size = -(-(self.bits - r + self.tail_bits) // 8)
        grow = 8 * size - self.bits
        self.low = v << grow if grow >= 0 else v >> -grow
        self.bits = 8 * size
        self.put(size)
        if self.tail_bits:
            self.out[-1] |= self.tail
        return bytes(self.out + self.back[::-1])


class RangeDecoder:
    """Bytes to bits and symbols; ``data`` stands at ``offset`` of the file."""

    def __init__(self, data: bytes, offset: int = 0) -> None:
        self.data = data
        self.offset = offset
        self.width = HALF
        self.x = 0
        self.at = self.left = self.chunk = 0
        """Bytes taken from the front; ``left`` bits of them wait in ``chunk``."""
        self.raw_bits = 0
        self.tail, self.tail_bits = 0, 0
        self.back = len(data)
        self.shift(15)

    def shift(self, bits: int) -> None:
        """The next bits of the coded number into x; zeros after the last byte."""
        if self.left < bits:
            fresh = self.data[self.at : self.at + 8].ljust(8, b"\0")
            self.chunk = self.chunk << 64 | int.from_bytes(fresh, "big")
            self.at += 8
            self.left += 64
        self.left -= bits
        self.x = self.x << bits | self.chunk >> self.left
        self.chunk &= (1 << self.left) - 1

    def narrow(self, lower: int, width: int) -> None:
        shift = 16 - width.bit_length()
        self.x -= lower
        self.width = width << shift
        if shift:
            self.shift(shift)

    def bit(self, model: BitModel) -> int:
        m = self.width * model.probability() >> 16
        bit = int(self.x < m)
        self.narrow(*((0, m) if bit else (m, self.width - m)))
        model.update(bit)
        return bit

    def symbol(self, model: SymbolModel) -> int:
        symbol, lower, upper = 0, 0, self.width
        while symbol < ESCAPE:
            bound = model.bound(self.width, symbol)
            if self.x >= bound:
                lower = bound
                break
            upper = bound
            symbol += 1
        self.narrow(lower, upper - lower)
        model.update(symbol)
        return symbol

    def raw(self, bits: int) -> int:
        """The next ``bits`` raw bits; zeros before the first byte."""
        while self.tail_bits < bits:
            fresh = self.data[max(self.back - 8, 0) : max(self.back, 0)].rjust(8, b"\0")
            self.tail |= int.from_bytes(fresh, "big") << self.tail_bits
            self.back -= 8
            self.tail_bits += 64
        value = self.tail & ((1 << bits) - 1)
        self.tail >>= bits
        self.tail_bits -= bits
        self.raw_bits += bits
        return value

    @property
    def taken(self) -> int:
        """N of SPEC 9.4: bits of the coded number that were read."""
        return 8 * self.at - self.left

    @property
    def place(self) -> int:
        """Where an error is reported: what was decoded lies before it, but for raw bits."""
        return self.offset + min((self.taken - 15) // 8, len(self.data))

    def check(self) -> None:
        """RNG-001, before the end: what was read since the last byte takes no packet any more."""
        if 8 * self.at - self.left - 15 + self.raw_bits > 8 * len(self.data):
            raise self.wrong_end()

    def wrong_end(self) -> FormatError:
        return FormatError(
            "the coded bits do not end with their packet",
            requirement="RNG-001",
            offset=self.place,
        )

    def finish(self) -> None:
        """RNG-001."""
        number = int.from_bytes(self.data, "big")
        over = 8 * len(self.data) - self.taken
        x = number >> over if over >= 0 else number << -over
        v, r = end_of(x - self.x, self.width)
        size = -(-(self.taken - r + self.raw_bits) // 8)
        whole = size == len(self.data) and v <= x < v + (1 << r)
        between = size * 8 - self.raw_bits - (self.taken - r)
        if not whole or number >> self.raw_bits & ((1 << between) - 1):
            raise self.wrong_end()


def first_table(context: int) -> tuple[int, ...]:
    """z of a fresh model: a geometric distribution of the context's own mean."""
    lg, fr = divmod(context + 8, 4)
    s = ((9 + 2 * fr) << lg >> 3) + 5
    t = 65536 * s // (s + 256)
    tails = [65536]
    for _ in range(EDGES[-1]):
        tails.append(tails[-1] * t >> 16)
    return tuple(tails[edge] for edge in EDGES[1:])


TABLES = tuple(first_table(context) for context in range(CONTEXTS))
EVEN = tuple(4096 * (15 - i) for i in range(15))


class IntegerModel:
    """Signed integers by the scale of those before them."""

    def __init__(self) -> None:
        self.f = self.s = FIRST_SCALE
        self.t = self.g = 0
        # Z of SPEC 9.4, by context; most of the 36 are never met within a packet.
        self.tables: dict[int, SymbolModel] = {}
        self.lengths = SymbolModel(EVEN, ESCAPE_CONFIDENCE)
        self.signs = [BitModel() for _ in range(3)]

    def scale(self) -> tuple[int, int]:
        """(h, c) of SPEC 9.4."""
        mean = (self.f + self.s) >> 1
        lg = max(mean.bit_length() - 1, 0)
        fr = (mean << 2 >> lg) & 3
        return max(lg - SCALED, 0), max(4 * min(lg, SCALED) + fr - 8, 0)

    def table(self, context: int) -> SymbolModel:
        found = self.tables.get(context)
        if found is None:
            found = self.tables[context] = SymbolModel(TABLES[context], CONFIDENCE)
        return found

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
        k = bucket_of(w)
        coder.symbol(k, self.table(c))
        if k == ESCAPE:
            y = w - EDGES[ESCAPE] + 1
            length = y.bit_length() - 1
            coder.symbol(min(length, 15), self.lengths)
            if length >= 15:
                coder.raw(length - 15, 5)
            coder.raw(y, length)
            coder.raw(u, h)
        else:
            coder.raw(u - (EDGES[k] << h), EXTRA[k] + h)
        if u:
            coder.bit(int(e < 0), self.signs[self.g + 1])
        self.learn(e)

    def decode(self, coder: RangeDecoder) -> int:
        h, c = self.scale()
        k = coder.symbol(self.table(c))
        if k == ESCAPE:
            length = coder.symbol(self.lengths)
            if length == 15:
                length += coder.raw(5)
            w = (1 << length | coder.raw(length)) + EDGES[ESCAPE] - 1
            u = w << h | coder.raw(h)
        else:
            u = (EDGES[k] << h) + coder.raw(EXTRA[k] + h)
        if u >> ERROR_BITS:
            raise FormatError(
                "a magnitude of 2^34 or more", requirement="RNG-003", offset=coder.place
            )
        e = u
        if u:
            e = -u if coder.bit(self.signs[self.g + 1]) else u
        self.learn(e)
        return e


def bucket_of(w: int) -> int:
    """The k whose edge is the last one not above w."""
    if w < 10:
        return w
    k = 10
    while k < ESCAPE and EDGES[k + 1] <= w:
        k += 1
    return k
