"""SPEC 9.4 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

from page_numbers import BrokenRule, bits_of, clamp


class Bit:
    """A bit model."""

    def __init__(self):
        self.p = self.q = 32768
        self.n = 0

    def chance(self) -> int:
        return clamp(self.p if self.n < 8 else (3 * self.p + self.q) // 4, 64, 65472)

    def learn(self, b: int) -> None:
        t, r = 65535 * b, 131072 // (2 * self.n + 3)
        self.p = self.p + ((t - self.p) * r) // 65536
        self.q = self.q + (t - self.q) // 16
        self.n = min(self.n + 1, 250)


class Symbols:
    """A symbol model."""

    def __init__(self, z: list[int], n: int):
        self.z, self.n = list(z), n

    def learn(self, s: int) -> None:
        r = 131072 // (2 * self.n + 3)
        for i in range(15):
            if i < s:
                self.z[i] = self.z[i] + ((65535 - self.z[i]) * r) // 65536
            else:
                self.z[i] = self.z[i] - (self.z[i] * r) // 65536
        self.n = min(self.n + 1, 250)


class Range:
    """The decoder where there are coded bytes; else the encoder, which is told each bit.

    The number is one integer, and raw bits are a list: slow, and nothing to get wrong.
    """

    def __init__(self, coded: bytes | None = None):
        self.coded, self.n, self.width, self.low = coded, 15, 32768, 0
        self.raw: list[int] = []
        self.x = self.read(15) if coded is not None else 0

    def read(self, n: int) -> int:
        """The first n bits of the number."""
        number = int.from_bytes(self.coded, "big")
        over = n - 8 * len(self.coded)
        return number << over if over >= 0 else number >> -over

    def take(self, lower: int, width: int) -> None:
        self.low, self.x, self.width = self.low + lower, self.x - lower, width
        while self.width < 32768:
            self.width, self.low, self.n = 2 * self.width, 2 * self.low, self.n + 1
            if self.coded is not None:
                self.x = 2 * self.x + self.read(self.n) % 2

    def code(self, model: Bit, b: int | None = None) -> int:
        m = (self.width * model.chance()) // 65536
        if self.coded is not None:
            b = 1 if self.x < m else 0
        self.take(*((0, m) if b else (m, self.width - m)))
        model.learn(b)
        return b

    def symbol(self, model: Symbols, s: int | None = None) -> int:
        v = [((self.width - 16) * model.z[i]) // 65536 + 15 - i for i in range(15)] + [0]
        if self.coded is not None:
            s = next(i for i in range(16) if self.x >= v[i])
        self.take(v[s], (v[s - 1] if s > 0 else self.width) - v[s])
        model.learn(s)
        return s

    def number(self, bits: int, value: int | None = None) -> int:
        """Raw bits, lowest first."""
        out = 0
        for i in range(bits):
            if self.coded is None:
                bit = value // 2**i % 2
            else:
                at = len(self.raw)
                byte = self.coded[-1 - at // 8] if at // 8 < len(self.coded) else 0
                bit = byte // 2 ** (at % 8) % 2
            self.raw.append(bit)
            out += bit * 2**i
        return out

    def check(self) -> None:
        """RNG-001, after each number."""
        if self.coded is not None and self.n - 15 + len(self.raw) > 8 * len(self.coded):
            raise BrokenRule("RNG-001")

    def end(self) -> bytes:
        """All coded bytes."""
        for r in (15, 14):
            v = -(-self.low // 2**r) * 2**r
            if v + 2**r <= self.low + self.width:
                break
        size = -(-(self.n - r + len(self.raw)) // 8)
        whole = v // 2**r * 2 ** (8 * size - self.n + r)
        return (whole + sum(bit * 2**i for i, bit in enumerate(self.raw))).to_bytes(size, "big")

    def finish(self) -> bytes:
        """All coded bytes; RNG-001."""
        if self.coded is not None and self.coded != self.end():
            raise BrokenRule("RNG-001")
        return self.end()


EDGES = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 16, 20, 28, 44]
EXTRA = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 2, 3, 4]


def first(c: int) -> list[int]:
    lg, fr = (c + 8) // 4, (c + 8) % 4
    m = ((9 + 2 * fr) * 2**lg) // 8 + 5
    t = (65536 * m) // (m + 256)
    tail = [65536]
    for w in range(1, 45):
        tail.append(tail[w - 1] * t // 65536)
    return [tail[EDGES[i + 1]] for i in range(15)]


class Integers:
    """The integer model."""

    def __init__(self):
        self.f = self.s = 32
        self.t = self.g = 0
        self.z = [Symbols(first(c), 10) for c in range(36)]
        self.y = Symbols([4096 * (15 - i) for i in range(15)], 2)
        self.signs = [Bit() for _ in range(3)]

    def code(self, coder: Range, e: int | None = None) -> int:
        """The next integer; the one that is given, where ``coder`` encodes."""
        u = None if e is None else abs(e)
        mean = (self.f + self.s) // 2
        lg = max(bits_of(mean), 1) - 1
        fr = ((mean * 4) // 2**lg) % 4
        h = max(0, lg - 10)
        c = max(0, 4 * min(lg, 10) + fr - 8)
        # 1
        w = None if u is None else u // 2**h
        k = coder.symbol(
            self.z[c], None if u is None else max(i for i in range(16) if EDGES[i] <= w)
        )
        # 2
        if k == 15:
            length = None if u is None else bits_of(w - 43) - 1
            some = coder.symbol(self.y, None if u is None else min(length, 15))
            if some == 15:
                some += coder.number(5, None if u is None else length - 15)
            rest = coder.number(some, None if u is None else w - 43 - 2**some)
            got = (2**some + rest + 43) * 2**h + coder.number(h, None if u is None else u % 2**h)
        # 3
        else:
            low = EDGES[k] * 2**h
            got = low + coder.number(EXTRA[k] + h, None if u is None else u - low)
        if got >= 2**34:
            raise BrokenRule("RNG-003")
        # 4
        sign = 0
        if got > 0:
            minus = None if e is None else int(e < 0)
            sign = -1 if coder.code(self.signs[self.g + 1], minus) else 1
        self.g = sign
        a = min(7, bits_of(self.t + 1))
        self.f += (256 * got - self.f) // 8
        self.s += (256 * got - self.s) // 2**a
        self.t += 1
        return sign * got
