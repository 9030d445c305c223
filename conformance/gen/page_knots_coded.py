"""SPEC 9.6 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

from page_coding import Coder, code_by_bits
from page_numbers import BrokenRule, signed, svarint_bytes, varint, varint_bytes


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
        raise BrokenRule("KTE-004")
    coder = Coder(data[at:])
    ticks = code_by_bits(coder, f - linear, False)
    steps = code_by_bits(coder, f * width, True)
    coder.finish()
    out = [(0, first)]
    for number in range(f):
        tick, row = out[-1]
        following = f - 1 - number
        tick = span - 1 if linear and following == 0 else tick + 1 + ticks[number]
        if tick >= span - following:
            raise BrokenRule("KTE-004")
        new = [index + steps[i * f + number] for i, index in enumerate(row)]
        if any(abs(index) > last for index in new):
            raise BrokenRule("LPC-003")
        out.append((tick, new))
    return out


def encode_knots(knots, linear: bool) -> bytes:
    """The packet of (tick, indices)."""
    first = knots[0][1]
    head = b"".join(map(svarint_bytes, first))
    if len(knots) == 1:
        return head
    coder = Coder()
    pairs = list(zip(knots, knots[1:], strict=False))
    ticks = [b[0] - a[0] - 1 for a, b in pairs]
    steps = [b[1][i] - a[1][i] for i in range(len(first)) for a, b in pairs]
    code_by_bits(coder, len(pairs) - linear, False, ticks)
    code_by_bits(coder, len(steps), True, steps)
    return head + varint_bytes(len(pairs)) + coder.finish()
