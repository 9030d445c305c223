"""SPEC 9.4 to 9.6 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

import re
from pathlib import Path

TEXT = (Path(__file__).resolve().parent.parent.parent / "SPEC.md").read_text(encoding="utf-8")
ANNEX_D = TEXT[TEXT.index("## Annex D") :]
K = [int(number) for number in re.findall(r"\d+", ANNEX_D.split("```")[1])]
"""The sine table."""

DIGEST = re.search(r"`([0-9a-f]{64})`", ANNEX_D)[1]


class BrokenRule(Exception):  # noqa: N818
    """The argument is its id."""


def rdiv(n: int, d: int) -> int:
    return (2 * n + d) // (2 * d)


def clamp(x: int, low: int, high: int) -> int:
    return max(low, min(high, x))


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


def bits_of(v: int) -> int:
    return len(f"{v:b}") if v else 0


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

    def __init__(self, raw_signs: bool = False):
        self.f = self.s = 32
        self.t = self.g = 0
        self.z = [Symbols(first(c), 10) for c in range(36)]
        self.y = Symbols([4096 * (15 - i) for i in range(15)], 2)
        self.signs = [Bit() for _ in range(3)]
        self.raw_signs = raw_signs

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
            if self.raw_signs:
                sign = -1 if coder.number(1, minus) else 1
            else:
                sign = -1 if coder.code(self.signs[self.g + 1], minus) else 1
        self.g = sign
        a = min(7, bits_of(self.t + 1))
        self.f += (256 * got - self.f) // 8
        self.s += (256 * got - self.s) // 2**a
        self.t += 1
        return sign * got


class Rice:
    """Rice codes, in place of both the range coder and the integer model."""

    def __init__(self, packet: bytes | None = None, widths=(5,)):
        self.bits = "" if packet is None else "".join(f"{byte:08b}" for byte in packet)
        self.reading, self.widths = packet is not None, widths
        self.at = self.w = 0
        self.errors: list[int] = []

    def read(self, n: int) -> str:
        self.at += n
        return self.bits[self.at - n : self.at].ljust(n, "0")

    def get(self, k: int) -> int:
        n = 0
        while n < 24 and self.read(1) == "0":
            n += 1
        u = n * 2**k + int("0" + self.read(k), 2) if n < 24 else int(self.read(35), 2)
        return u // 2 if u % 2 == 0 else -(u + 1) // 2

    def code(self, _coder, e: int | None = None) -> int:
        if self.reading:
            if len(self.errors) % 32 == 0:
                if self.at > len(self.bits):
                    raise BrokenRule("LPC-012")
                self.w += self.get(0)
                if not 0 <= self.w <= 31:
                    raise BrokenRule("LPC-011")
            e = self.get(self.w - 1) if self.w > 0 else 0
        self.errors.append(e)
        return e

    def put(self, value: int, k: int) -> None:
        u = 2 * value if value >= 0 else -2 * value - 1
        if u >= 2**35:
            raise BrokenRule("a code of 36 bits")
        low = f"{u % 2**k:0{k}b}" if k > 0 else ""
        self.bits += "0" * 24 + f"{u:035b}" if u // 2**k >= 24 else "0" * (u // 2**k) + "1" + low

    def end(self) -> bytes:
        """Blocks get the widths in turn, those that cannot have them 1."""
        for at in range(0, len(self.errors), 32):
            block, w = self.errors[at : at + 32], self.widths[at // 32 % len(self.widths)]
            w = 1 if w == 0 and any(block) else w
            self.put(w - self.w, 0)
            self.w = w
            for e in block if w > 0 else []:
                self.put(e, w - 1)
        bits = self.bits + "0" * (-len(self.bits) % 8)
        return bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))

    def finish(self) -> bytes | None:
        if not self.reading:
            return self.end()
        if not 0 <= len(self.bits) - self.at < 8 or "1" in self.bits[self.at :]:
            raise BrokenRule("LPC-012")
        return None


def step_up(ks: list[int]) -> list[int]:
    """c[1..m]"""
    p: list[int] = []
    for k in ks:
        sine = K[k] if k >= 0 else -K[-k]
        n = len(p) + 1
        p = [p[j - 1] - rdiv(sine * p[n - j - 1], 32768) for j in range(1, n)] + [sine * 32]
        if max(map(abs, p)) > 2**36:
            raise BrokenRule("LPC-005")
    c = [rdiv(x, 128) for x in p]
    if c and max(map(abs, c)) > 2**21:
        raise BrokenRule("LPC-005")
    return c


def difference(row, order, t):
    """(D^order row)[t]"""
    if t < 0:
        return 0
    if order == 0:
        return row[t]
    return difference(row, order - 1, t) - difference(row, order - 1, t - 1)


def prediction(c, y, t):
    return (sum(c[j - 1] * y[t - j] for j in range(1, min(len(c), t) + 1)) + 4096) // 8192


def cross_terms(references, components, span, g, c):
    """x[0] to x[span - 1]; references: (a, w[-1], w[0], w[1])"""
    sums = [0] * span
    for a, *w in references:
        index = components[a]
        z = [i - index[0] for i in index]
        y = [difference(z, g, t) for t in range(span)]
        d = [0, *(y[t] - prediction(c, y, t) for t in range(span)), 0]
        for t in range(span):
            sums[t] += w[0] * d[t] + w[1] * d[t + 1] + w[2] * d[t + 2]
    return [rdiv(n, 64) for n in sums]


def code_samples(coder, span, g, c, base, repeats, raw_signs, last, indices=None, x=None):
    """The loop over the ticks of a packet that is not constant; the indices."""
    model = coder if isinstance(coder, Rice) else Integers(raw_signs)
    q = [Bit() for _ in range(4)]
    out, z, y, r = [], [], [], []
    x = x or [0] * span
    for t in range(span):
        bit = 0
        if repeats and t >= 1:
            r1, r2 = (r[t - 1], r[t - 2] if t >= 2 else 0)
            bit = coder.code(
                q[2 * r1 + r2], None if indices is None else indices[t] == indices[t - 1]
            )
        r.append(bit)
        if bit:
            z.append(z[-1])
        else:
            pred = prediction(c, y, t)
            e = None
            if indices is not None:
                z.append(indices[t] - base)
                e = difference(z, g, t) - pred - x[t]
                z.pop()
            now = pred + x[t] + model.code(coder, e)
            # y[t] is the g-th difference of z: solve for z[t].
            z.append(0)
            z[t] = now - difference(z, g, t)
        y.append(difference(z, g, t))
        out.append(z[t] + base)
        if abs(out[-1]) > last:
            raise BrokenRule("LPC-003")
        if isinstance(coder, Range):
            coder.check()
    return out


def varint(data: bytes, at: int) -> tuple[int, int]:
    """The number, and where it ends."""
    number = 0
    for group in range(9):
        if group == 8 or at + group >= len(data):
            raise BrokenRule("CNV-002")
        byte = data[at + group]
        number += byte % 128 * 128**group
        if byte < 128:
            break
    if group and byte == 0:
        raise BrokenRule("CNV-003")
    if number >= 2**53:
        raise BrokenRule("CNV-002")
    return number, at + group + 1


def signed(number: int) -> int:
    return number // 2 if number % 2 == 0 else -(number + 1) // 2


def varint_bytes(number: int) -> bytes:
    out = bytearray()
    while number > 127:
        out.append(number % 128 + 128)
        number //= 128
    return bytes([*out, number])


def svarint_bytes(v: int) -> bytes:
    return varint_bytes(2 * v if v >= 0 else -2 * v - 1)


def decode_packet(data: bytes, span: int, last: int, count: int) -> list[list[int]]:
    """The indices of ``count`` components."""
    sizes, at = [], 0
    for _ in range(count - 1):
        size, at = varint(data, at)
        sizes.append(size)
    if sum(sizes) > len(data) - at:
        raise BrokenRule("LPC-001")
    out: list[list[int]] = []
    for size in [*sizes, len(data) - at - sum(sizes)]:
        out.append(decode(data[at : at + size], span, last, out))
        at += size
    return out


def decode(data: bytes, span: int, last: int, components=()) -> list[int]:
    """The indices of a component packet, ``last`` being the largest magnitude of one (LPC-003),
    and ``components`` those before it."""
    if len(data) < 2 or len(data) < 2 + data[1]:
        raise BrokenRule("LPC-006")
    flags, m = data[:2]
    g, repeats, constant, raw_signs = flags % 8, flags // 8 % 2, flags // 16 % 2, flags // 32 % 2
    refers = flags // 64 % 2
    ks = [byte - 256 * (byte > 127) for byte in data[2 : 2 + m]]
    rice = flags // 128
    if g > 4 or (m > 0 and g > 1) or m > 32 or -128 in ks:
        raise BrokenRule("LPC-004")
    if constant and (g or m or repeats or raw_signs or refers or rice):
        raise BrokenRule("LPC-004")
    if rice and (repeats or raw_signs or refers):
        raise BrokenRule("LPC-010")
    at, references = 2 + m, []
    if refers:
        r = data[at] if at < len(data) else 0
        if at + 1 + 4 * r > len(data):
            raise BrokenRule("LPC-008")
        for k in range(r):
            a, *w = data[at + 1 + 4 * k : at + 5 + 4 * k]
            references.append((a, *(byte - 256 * (byte > 127) for byte in w)))
        numbers = [a for a, *_ in references]
        if not 1 <= r <= 8 or numbers != sorted({*numbers}) or numbers[-1] >= len(components):
            raise BrokenRule("LPC-007")
        at += 1 + 4 * r
    number, at = varint(data, at)
    base = signed(number)
    if abs(base) > last:
        raise BrokenRule("LPC-003")
    coded = data[at:]
    if constant:
        if coded:
            raise BrokenRule("COD-001")
        return [base] * span
    coder = Rice(coded) if rice else Range(coded)
    c = step_up(ks)
    x = cross_terms(references, components, span, g, c)
    out = code_samples(coder, span, g, c, base, repeats, raw_signs, last, None, x)
    coder.finish()
    return out


def encode(
    indices, g=0, ks=(), base=0, repeats=False, raw_signs=False, references=(), components=(), *,
    rice=False, last=2**32, forge=False, widths=(5,),
):  # fmt: skip
    """A component packet that is not constant; ``forge``: it may end with what breaks a rule."""
    coder, c = Rice(widths=widths) if rice else Range(), step_up(ks)
    x = cross_terms(references, components, len(indices), g, c)
    try:
        code_samples(coder, len(indices), g, c, base, repeats, raw_signs, last, indices, x)
    except BrokenRule:
        if not forge:
            raise
    flags = g + 8 * repeats + 32 * raw_signs + 64 * bool(references) + 128 * rice
    header = bytes([flags, len(ks)]) + bytes(k % 256 for k in ks)
    if references:
        header += bytes([len(references)])
        header += b"".join(bytes(byte % 256 for byte in each) for each in references)
    return header + svarint_bytes(base) + coder.finish()


def encode_packet(parts: list[bytes]) -> bytes:
    return b"".join([varint_bytes(len(part)) for part in parts[:-1]] + parts)


def tolerance(c: int, kn: int, kd: int, step: int) -> int:
    return max(kn * c // kd, step)


def grid_levels(kn: int, kd: int, step: int, bound: int) -> list[int]:
    """y(0) to y(N)"""
    y = [0]
    while kn < kd and max(y[-1] + step, y[-1] * kd // (kd - kn)) < bound:
        c = max(y[-1] + step, y[-1] * kd // (kd - kn)) + 1
        y.append(c + tolerance(c, kn, kd, step))
    return y


def tops_by_search(kn: int, kd: int, step: int, bound: int) -> list[int]:
    """The largest c <= bound with c - tol(c) <= y, for each level: count by count."""
    return [
        max(c for c in range(bound + 1) if c - tolerance(c, kn, kd, step) <= y)
        for y in grid_levels(kn, kd, step, bound)
    ]


class Magnitudes:
    """The magnitude model of length n."""

    def __init__(self, n: int):
        self.n = n
        self.ls = [Bit() for _ in range(n + 1)]
        self.hs = [Bit() for _ in range(n + 1)]

    def code(self, coder: Range, u: int | None = None) -> int:
        b = 0
        while coder.code(self.ls[b], None if u is None else int(b < bits_of(u))):
            b += 1
            if b > self.n:
                raise BrokenRule("KTE-003")
        if b < 2:
            return b
        high = coder.code(self.hs[b], None if u is None else u // 2 ** (b - 2) % 2)
        return (2 + high) * 2 ** (b - 2) + coder.number(
            b - 2, None if u is None else u % 2 ** (b - 2)
        )


def code_knots(coder, f, linear, span, first, last, knots=None):
    """Ticks and rows of indices, the first knot's too."""
    gaps, differences = Magnitudes(24), Magnitudes(34)
    s, signs = [Bit() for _ in range(3)], [0] * len(first)
    out = [(0, first)]
    for number in range(1, f + 1):
        tick, row = out[-1]
        following = f - number
        told = None if knots is None else knots[number]
        if linear and following == 0:
            tick = span - 1
        else:
            tick += 1 + gaps.code(coder, told and told[0] - tick - 1)
        if tick >= span - following:
            raise BrokenRule("KTE-004")
        new = []
        for i, before in enumerate(row):
            d = told and told[1][i] - before
            u = differences.code(coder, told and abs(d))
            sign = 0
            if u:
                sign = -1 if coder.code(s[signs[i] + 1], told and int(d < 0)) else 1
            signs[i] = sign
            new.append(before + sign * u)
        if any(abs(index) > last for index in new):
            raise BrokenRule("LPC-003")
        out.append((tick, new))
        coder.check()
    return out


def decode_knots(data: bytes, linear: bool, span: int, width: int, last: int):
    """(tick, indices) of each knot of a packet of KNTE."""
    first, at = [], 0
    for _ in range(width):
        number, at = varint(data, at)
        first.append(signed(number))
        if abs(first[-1]) > last:
            raise BrokenRule("LPC-003")
    if at == len(data):
        return [(0, first)]
    f, at = varint(data, at)
    if not 1 <= f < span:
        raise BrokenRule("KTE-002")
    coder = Range(data[at:])
    out = code_knots(coder, f, linear, span, first, last)
    coder.finish()
    return out


def encode_knots(knots, linear: bool, span: int, *, last=2**32, forge=False) -> bytes:
    """The packet of (tick, indices); ``forge``: it may end with what breaks a rule."""
    first = knots[0][1]
    head = b"".join(map(svarint_bytes, first))
    if len(knots) == 1:
        return head
    coder = Range()
    try:
        code_knots(coder, len(knots) - 1, linear, span, first, last, knots)
    except BrokenRule:
        if not forge:
            raise
    return head + varint_bytes(len(knots) - 1) + coder.finish()
