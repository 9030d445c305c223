"""SPEC 9.8 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

import re
from functools import cache
from math import cos, pi
from pathlib import Path

from page_coding import Coder, class_ends, code_rest, context_of, symbol_of
from page_numbers import BrokenRule, rdiv, signed, svarint_bytes, varint, varint_bytes
from page_predicted import encode_packet, split_parts

CLAUSE = (Path(__file__).resolve().parent.parent.parent / "SPEC.md").read_text(encoding="utf-8")
CLAUSE = CLAUSE[CLAUSE.index("### 9.8 MDCT") :]
DIGEST = re.search(r"`([0-9a-f]{64})`", CLAUSE)[1]
NEXT = [
    [int(n) for n in re.findall(r"\d+", row)]
    for row in re.findall(r"^\| next\(state, [01]\) \|(.*)\|$", CLAUSE, re.M)
]
"""By the lowest bit of a magnitude, by state."""

TABLE = [round(2**15 * cos(pi * i / 2048)) for i in range(1025)]
LARGEST = 2**36

__all__ = ["analyse", "decode_packet", "encode", "encode_packet", "quantise", "steps"]


def wave(i: int) -> int:
    """C(i)"""
    i = abs(i)
    while i > 4096:
        i -= 4096
    i = min(i, 4096 - i)
    return TABLE[i] if i <= 1024 else -TABLE[2048 - i]


@cache
def waves(m: int) -> list[list[int]]:
    """For each k the C of all j."""
    size, d = 2**m, 512 // 2**m
    return [
        [wave((2 * j + 1) * (2 * k + 1) * d) for j in range(size)] for k in range(size)
    ]  # fmt: skip


def turn(m: int, i: int) -> tuple[int, int]:
    """w and z"""
    size, d = 2**m, 512 // 2**m
    return wave((size - 2 * i - 1) * d), wave((size + 2 * i + 1) * d)


def steps(m: int, step: int, weights=()) -> list[int]:
    """s[0] to s[M - 1]; MDC-001"""
    n = len(weights)
    if not 5 <= m <= 9 or not 1 <= step <= 2**32 or n not in (0, 1, 2, 4, 8, 16, 32, 64, 128):
        raise BrokenRule("MDC-001")
    if n > 2**m:
        raise BrokenRule("MDC-001")
    if n == 0:
        return [step] * 2**m
    return [max(1, rdiv(step * weights[k * n // 2**m], 32)) for k in range(2**m)]


def coefficient(u: int, state: int, step: int) -> int:
    """|X| of a magnitude"""
    return max(2 * u - state % 2, 0) * step


def follow(state: int, u: int) -> int:
    return NEXT[u % 2][state]


def code_blocks(coder, count, kept, classes, a, s, told=None, seen=None, *, loud=False):
    """X[0] to X[K - 1] of each block, and the integers; ``told``: the integers; ``seen``: takes
    (context, shift, state) of each; ``loud``: MDC-003 may be broken."""
    coder.section()
    p = [(4 + a % 4) * 2 ** (a // 4)] * kept
    e = [*p]
    state = 0
    out, integers = [], []
    for block in range(count):
        a1 = a2 = e[0]
        row, now = [], []
        for k in range(kept):
            near = p[max(k - 1, 0)] + p[min(k + 1, kept - 1)]
            c, h = context_of((8 * a1 + 4 * a2 + 4 * p[k] + 3 * near + 10 * e[k]) // 32)
            q = state % 2
            given = None if told is None else told[block][k]
            symbol = None if told is None else symbol_of(given, h)
            symbol = coder.symbol(class_ends(classes[q], c), symbol)
            integer = code_rest(coder, symbol, h, True, given)
            coder.check()
            if seen is not None:
                seen.append([c, h, state])
            u = abs(integer)
            x = coefficient(u, state, s[k])
            row.append(-x if integer < 0 else x)
            if sum(map(abs, row)) > LARGEST and not loud:
                raise BrokenRule("MDC-003")
            now.append(integer)
            state = follow(state, u)
            a2, a1 = a1, 256 * u
        for k in range(kept):
            p[k] = 256 * abs(now[k])
            e[k] += (p[k] - e[k]) // 4
        out.append(row)
        integers.append(now)
    return out, integers


def unfold(block, m: int) -> list[int]:
    """v of a block"""
    rows = waves(m)
    return [rdiv(sum(x * rows[k][j] for k, x in enumerate(block) if x), 2**15) for j in range(2**m)]


def transform(blocks, m: int) -> list[int]:
    """x of all blocks"""
    size = 2**m
    v = [each for block in blocks for each in unfold(block, m)]
    x = [rdiv(each, 2**8) for each in v]
    for p in range(size, len(v), size):
        for i in range(size // 2):
            w, z = turn(m, i)
            x[p + i] = rdiv(w * v[p + i] - z * v[p - 1 - i], 2**23)
            x[p - 1 - i] = rdiv(w * v[p - 1 - i] + z * v[p + i], 2**23)
    return x


def decode_packet(data: bytes, span: int, m: int, s, count: int, bound: int = 2**24):
    """The counts of ``count`` components, not clamped yet."""
    return [decode(part, span, m, s, bound) for part in split_parts(data, count, "LPC-001")]


def header(data: bytes, m: int, bound: int):
    """(b, K, classes, start byte) and where they end."""
    number, at = varint(data, 0)
    kept, at = varint(data, at)
    if abs(signed(number)) > bound or kept > 2**m:
        raise BrokenRule("MDC-002")
    if kept == 0:
        if data[at:]:
            raise BrokenRule("COD-001")
        return (signed(number), 0, (0, 0), 0), at
    if len(data) < at + 2 or data[at + 1] > 163:
        raise BrokenRule("RNG-004")
    return (signed(number), kept, (data[at] % 16, data[at] // 16), data[at + 1]), at + 2


def decode(data: bytes, span: int, m: int, s, bound: int = 2**24, seen=None) -> list[int]:
    """The counts of a component packet; ``bound``: the count bound."""
    (b, kept, classes, a), at = header(data, m, bound)
    if kept == 0:
        return [b] * span
    coder = Coder(data[at:])
    blocks, integers = code_blocks(coder, -(-span // 2**m), kept, classes, a, s, seen=seen)
    coder.finish()
    if seen is not None:
        seen[:] = [integers, blocks, seen[:]]
    return [b + x for x in transform(blocks, m)[:span]]


def encode(integers, s, base=0, *, classes=(0, 0), start=12, loud=False) -> bytes:
    """A component packet of the integers of each block, all of the same number."""
    kept = len(integers[0]) if integers else 0
    head = svarint_bytes(base) + varint_bytes(kept)
    if kept == 0:
        return head
    coder = Coder()
    code_blocks(coder, len(integers), kept, classes, start, s, integers, loud=loud)
    return head + bytes([classes[0] + 16 * classes[1], start]) + coder.finish()


def analyse(numbers, m: int) -> list[list[int]]:
    """X of each block, of which the transform gives these numbers again, nearly."""
    size = 2**m
    count = -(-len(numbers) // size)
    x = [*numbers, *[numbers[-1]] * (count * size - len(numbers))]
    v = [2**15 * each for each in x]
    for p in range(size, len(x), size):
        for i in range(size // 2):
            w, z = turn(m, i)
            v[p + i] = w * x[p + i] + z * x[p - 1 - i]
            v[p - 1 - i] = w * x[p - 1 - i] - z * x[p + i]
    rows = waves(m)
    return [
        [
            rdiv(2**9 * sum(a * b for a, b in zip(v[at : at + size], row, strict=True)),
                 size * 2**30)
            for row in rows
        ]
        for at in range(0, len(x), size)
    ]  # fmt: skip


def quantise(blocks, s) -> list[list[int]]:
    """The integer next to each X, in turn."""
    state, out = 0, []
    for block in blocks:
        row = []
        for x, step in zip(block, s, strict=False):
            u = rdiv(abs(x) + state % 2 * step, 2 * step) if x else 0
            row.append(-u if x < 0 else u)
            state = follow(state, u)
        out.append(row)
    return out
