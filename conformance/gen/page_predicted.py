"""SPEC 9.5 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

import re
from math import pi, sin
from pathlib import Path

from page_coding import (
    Coder,
    code_bits,
    code_by_bits,
    code_integers,
    code_signs,
    some_bytes,
)
from page_numbers import BrokenRule, rdiv, signed, svarint_bytes, varint, varint_bytes

TEXT = (Path(__file__).resolve().parent.parent.parent / "SPEC.md").read_text(encoding="utf-8")
ANNEX_C = TEXT[TEXT.index("## Annex C") :]
K = [round(32768 * sin(pi * k / 256)) for k in range(128)]
"""The sine table."""

DIGEST = re.search(r"`([0-9a-f]{64})`", ANNEX_C)[1]

BY_BITS = 64
"""The coding byte of sections by bits."""


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


def code_errors(coder, span, way, errors=None, repeated=None):
    """(prediction errors, repeat bits of all ticks), in up to three sections; ``way``: (class, or
    64: by bits; start, probabilities of repeats, those of signs), the last two empty where there
    are none."""
    number, start, repeats, signs = way
    r = [0] * span
    if repeats:
        r[1:] = code_bits(coder, span - 1, repeats, repeated and repeated[1:])
    if number == BY_BITS:
        return code_by_bits(coder, r.count(0), True, errors), r
    out = code_integers(coder, r.count(0), number, start, not signs, errors)
    if signs:
        out = code_signs(coder, [abs(e) for e in out], signs, errors)
    return out, r


def samples(errors, r, span, g, c, base, last, x):
    """The indices."""
    out, z, y = [], [], []
    following = iter(errors)
    for t in range(span):
        if r[t]:
            z.append(z[-1])
        else:
            now = prediction(c, y, t) + x[t] + next(following)
            # y[t] is the g-th difference of z: solve for z[t].
            z.append(0)
            z[t] = now - difference(z, g, t)
        y.append(difference(z, g, t))
        out.append(z[t] + base)
        if abs(out[-1]) > last:
            raise BrokenRule("LPC-003")
    return out


def errors_of(indices, r, g, c, base, x):
    z = [index - base for index in indices]
    y = [difference(z, g, t) for t in range(len(z))]
    return [y[t] - prediction(c, y[:t], t) - x[t] for t in range(len(z)) if not r[t]]


def split_parts(data: bytes, count: int, rule: str) -> list[bytes]:
    """The parts of ``count`` components; ``rule``: the one that too large a size breaks."""
    sizes, at = [], 0
    for _ in range(count - 1):
        size, at = varint(data, at)
        sizes.append(size)
    if sum(sizes) > len(data) - at:
        raise BrokenRule(rule)
    parts = []
    for size in [*sizes, len(data) - at - sum(sizes)]:
        parts.append(data[at : at + size])
        at += size
    return parts


def decode_packet(data: bytes, span: int, last: int, count: int) -> list[list[int]]:
    """The indices of ``count`` components."""
    out: list[list[int]] = []
    for part in split_parts(data, count, "LPC-001"):
        out.append(decode(part, span, last, out))
    return out


def decode(data: bytes, span: int, last: int, components=()) -> list[int]:
    """The indices of a component packet, ``last`` being the largest magnitude of one (LPC-003),
    and ``components`` those before it."""
    if len(data) < 2 or len(data) < 2 + data[1]:
        raise BrokenRule("LPC-006")
    flags, m = data[:2]
    g, repeats, constant, refers = flags % 8, flags // 8 % 2, flags // 16 % 2, flags // 64 % 2
    ks = [byte - 256 * (byte > 127) for byte in data[2 : 2 + m]]
    if g > 4 or (m > 0 and g > 1) or m > 32 or -128 in ks or flags // 32 % 2 or flags > 127:
        raise BrokenRule("LPC-004")
    if constant and (g or m or repeats or refers):
        raise BrokenRule("LPC-004")
    at, references = 2 + m, []
    if refers:
        r = data[at] if at < len(data) else 0
        if at + 1 + 4 * r > len(data):
            raise BrokenRule("LPC-006")
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
    if constant:
        if data[at:]:
            raise BrokenRule("COD-001")
        return [base] * span
    c = step_up(ks)
    x = cross_terms(references, components, span, g, c)
    coding, start, at = way_of(data, at)
    p, at = some_bytes(data, at, 4 * repeats)
    signs, at = some_bytes(data, at, 3 * (coding // 32 % 2))
    coder = Coder(data[at:], 4 if coding // 16 % 2 else 1)
    way = coding if coding == BY_BITS else coding % 16, start, p, signs
    errors, r = code_errors(coder, span, way)
    coder.finish()
    return samples(errors, r, span, g, c, base, last, x)


def way_of(data: bytes, at: int):
    """(coding byte, start byte or None) and where they end; RNG-004."""
    if data[at : at + 1] == bytes([BY_BITS]):
        return BY_BITS, None, at + 1
    if len(data) < at + 2 or data[at] > 63 or data[at + 1] > 163:
        raise BrokenRule("RNG-004")
    return data[at], data[at + 1], at + 2


def encode(
    indices, g=0, ks=(), base=0, repeats=(), references=(), components=(), *,
    number=0, start=12, signs=(), states=1, forge=None,
):  # fmt: skip
    """A component packet that is not constant; ``number``: the class, or BY_BITS; ``forge``: these
    errors, whatever the indices."""
    coder, c = Coder(states=states), step_up(ks)
    x = cross_terms(references, components, len(indices), g, c)
    r = [int(bool(repeats) and t > 0 and i == indices[t - 1]) for t, i in enumerate(indices)]
    errors = errors_of(indices, r, g, c, base, x) if forge is None else forge
    if any(abs(e) >= 2**34 for e in errors) and forge is None:
        raise BrokenRule("RNG-003")
    code_errors(coder, len(indices), (number, start, repeats, signs), errors, r)
    flags = g + 8 * bool(repeats) + 64 * bool(references)
    header = bytes([flags, len(ks)]) + bytes(k % 256 for k in ks)
    if references:
        header += bytes([len(references)])
        header += b"".join(bytes(byte % 256 for byte in each) for each in references)
    told = [] if number == BY_BITS else [start]
    coding = bytes([number + 16 * (states == 4) + 32 * bool(signs), *told, *repeats, *signs])
    return header + svarint_bytes(base) + coding + coder.finish()


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
