"""SPEC 9.6 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

from page_coding import Coder, code_integers, code_lengths, code_signs, some_bytes, table_of
from page_numbers import BrokenRule, signed, svarint_bytes, varint, varint_bytes


def row_of(data: bytes, at: int, unused: int):
    """(coding, start byte or table) and where it ends."""
    if len(data) < at + 2 or data[at] & unused:
        raise BrokenRule("RNG-004")
    coding = data[at]
    if coding // 64:
        if coding % 16:
            raise BrokenRule("RNG-004")
        start, at = table_of(data, at + 1, 35)
    else:
        start, at = data[at + 1], at + 2
        if start > 163:
            raise BrokenRule("RNG-004")
    return (coding, start), at


def code_row(coder, count, way, signs, numbers=None):
    coding, start = way
    if coding // 64:
        return code_lengths(coder, count, start, signs, numbers)
    return code_integers(coder, count, coding % 16, start, signs, numbers)


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
    gaps, at = row_of(data, at, 128 + 32)
    differences, at = row_of(data, at, 128 + 16)
    signs, at = some_bytes(data, at, 3 * (differences[0] // 32 % 2))
    coder = Coder(data[at:], 4 if gaps[0] // 16 % 2 else 1)
    ticks = code_row(coder, f - linear, gaps, False)
    steps = code_row(coder, f * width, differences, not signs)
    if signs:
        steps = code_signs(coder, steps, signs)
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


def encode_knots(
    knots, linear: bool, *, gaps=(0, 12), differences=(0, 12), signs=(), states=1
) -> bytes:
    """The packet of (tick, indices); ways as row_of gives them."""
    first = knots[0][1]
    head = b"".join(map(svarint_bytes, first))
    if len(knots) == 1:
        return head
    coder = Coder(states=states)
    pairs = list(zip(knots, knots[1:], strict=False))
    ticks = [b[0] - a[0] - 1 for a, b in pairs]
    ticks = ticks[:-1] if linear else ticks
    steps = [b[1][i] - a[1][i] for i in range(len(first)) for a, b in pairs]
    code_row(coder, len(ticks), gaps, False, ticks)
    code_row(coder, len(steps), differences, not signs, steps)
    if signs:
        code_signs(coder, [abs(e) for e in steps], signs, steps)
    body = b""
    for (coding, start), flags in ((gaps, 16 * (states == 4)), (differences, 32 * bool(signs))):
        told = [start] if isinstance(start, int) else [start[0], len(start[1]), *start[1]]
        body += bytes([coding | flags, *told])
    return head + varint_bytes(len(pairs)) + body + bytes(signs) + coder.finish()
