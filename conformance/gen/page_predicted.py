"""SPEC 9.5 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

import re
from pathlib import Path

from page_coding import Bit, Integers, Range
from page_numbers import BrokenRule, rdiv, signed, svarint_bytes, varint, varint_bytes
from page_rice import Rice

TEXT = (Path(__file__).resolve().parent.parent.parent / "SPEC.md").read_text(encoding="utf-8")
ANNEX_C = TEXT[TEXT.index("## Annex C") :]
K = [int(number) for number in re.findall(r"\d+", ANNEX_C.split("```")[1])]
"""The sine table."""

DIGEST = re.search(r"`([0-9a-f]{64})`", ANNEX_C)[1]


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


def code_samples(coder, span, g, c, base, repeats, last, indices=None, x=None):
    """The loop over the ticks of a packet that is not constant; the indices."""
    model = coder if isinstance(coder, Rice) else Integers()
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
    g, repeats, constant, refers = flags % 8, flags // 8 % 2, flags // 16 % 2, flags // 64 % 2
    ks = [byte - 256 * (byte > 127) for byte in data[2 : 2 + m]]
    rice = flags // 128
    if g > 4 or (m > 0 and g > 1) or m > 32 or -128 in ks or flags // 32 % 2:
        raise BrokenRule("LPC-004")
    if constant and (g or m or repeats or refers or rice):
        raise BrokenRule("LPC-004")
    if rice and (repeats or refers):
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
    out = code_samples(coder, span, g, c, base, repeats, last, None, x)
    coder.finish()
    return out


def encode(
    indices, g=0, ks=(), base=0, repeats=False, references=(), components=(), *,
    rice=False, last=2**32, forge=False, widths=(5,),
):  # fmt: skip
    """A component packet that is not constant; ``forge``: it may end with what breaks a rule."""
    coder, c = Rice(widths=widths) if rice else Range(), step_up(ks)
    x = cross_terms(references, components, len(indices), g, c)
    try:
        code_samples(coder, len(indices), g, c, base, repeats, last, indices, x)
    except BrokenRule:
        if not forge:
            raise
    flags = g + 8 * repeats + 64 * bool(references) + 128 * rice
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
