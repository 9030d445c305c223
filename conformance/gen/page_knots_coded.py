"""SPEC 9.6 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

from page_coding import Bit, Range
from page_numbers import BrokenRule, bits_of, signed, svarint_bytes, varint, varint_bytes


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
    """(tick, indices) of each knot of a packet."""
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
