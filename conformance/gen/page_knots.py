"""SPEC 9.1 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

from page_numbers import BrokenRule, rdiv, signed, svarint_bytes, varint, varint_bytes

HOLD, LINEAR = 0, 1


def between(knots: list[tuple[int, int]], span: int, interpolation: int) -> list[int]:
    """The counts of a span from (tick, count) of its knots, however they are coded."""
    out = []
    for t in range(span):
        at = max(i for i, (tick, _) in enumerate(knots) if tick <= t)
        t0, v0 = knots[at]
        if interpolation == HOLD or at == len(knots) - 1:
            out.append(v0)
        else:
            t1, v1 = knots[at + 1]
            out.append(v0 + rdiv((v1 - v0) * (t - t0), t1 - t0))
    return out


def encode(knots: list[tuple[int, list[int]]]) -> bytes:
    """The packet of (tick, indices), in varints."""
    out, before = b"", None
    for tick, values in knots:
        if before is not None:
            out += varint_bytes(tick - before[0])
        for i, value in enumerate(values):
            out += svarint_bytes(value if before is None else value - before[1][i])
        before = tick, values
    return out


def parse(data: bytes, width: int, span: int, interpolation: int,
          last: int = 2**24) -> list[tuple[int, list[int]]]:  # fmt: skip
    """(tick, indices) of each knot of a packet in varints, ``last`` being the largest magnitude of
    an index."""
    knots: list[tuple[int, list[int]]] = []
    at, tick, values = 0, 0, [0] * width

    def number() -> int:
        nonlocal at
        if all(byte >= 128 for byte in data[at : at + 8]) and len(data) - at < 8:
            raise BrokenRule("KNT-002")
        found, at = varint(data, at)
        return found

    while at < len(data) or not knots:
        if knots:
            step = number()
            if step < 1:
                raise BrokenRule("KNT-003")
            tick += step
        values = [value + signed(number()) for value in values]
        if any(abs(value) > last for value in values):
            raise BrokenRule("LPC-003")
        knots.append((tick, values))
    ticks = [tick for tick, _ in knots]
    if ticks[-1] >= span:
        raise BrokenRule("KNT-003")
    if interpolation == LINEAR and len(knots) > 1 and ticks[-1] != span - 1:
        raise BrokenRule("KNT-003")
    return knots


def decode(data: bytes, width: int, span: int, interpolation: int, step: int = 1,
           bound: int = 2**24) -> list[list[int]]:  # fmt: skip
    """The counts of each component, on the uniform grid of this step and zero 0."""
    knots = parse(data, width, span, interpolation, bound // step)
    return [
        between([(tick, values[i] * step) for tick, values in knots], span, interpolation)
        for i in range(width)
    ]
