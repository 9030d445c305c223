"""SPEC 9.10 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

import re

from page_coding import Coder, code_integers
from page_numbers import BrokenRule, clamp, rdiv, varint_bytes
from page_predicted import TEXT, K, split_parts

CLAUSE = TEXT[TEXT.index("### 9.10") : TEXT.index("## 10 ")]
R = [int(n) for n in re.search(r"R = (\d+), (\d+), (\d+), (\d+)", CLAUSE).groups()]

ORDERS, GAINS = 32, 112
HEAD = 9
"""Bytes of a component packet before the coding of its coefficients."""


def gain_of(q: int) -> int:
    """G(q)"""
    return 0 if q == 0 else R[(q - 1) % 4] * 2 ** ((q - 1) // 4)


def word_of(seed: int, t: int) -> int:
    w = (seed + t * 2654435769) % 2**32
    w = (w ^ w // 2**16) * 2246822507 % 2**32
    w = (w ^ w // 2**13) * 3266489909 % 2**32
    return w ^ w // 2**16


def noise_of(seed: int, t: int, density: int) -> int:
    """n[t]"""
    b = word_of(seed, t).to_bytes(4, "little")
    if density > 0 and b[0] >= density:
        return 0
    return 2 * (b[1] + b[2] + b[3]) - 765


def envelope(gains: list[int], shift: int, span: int) -> list[int]:
    """gain[t]"""
    out = []
    for t in range(span):
        s, i = t // 2**shift, t % 2**shift
        a, b = gain_of(gains[max(s - 1, 0)]), gain_of(gains[s])
        out.append(a + (b - a) * i // 2**shift)
    return out


def sine(k: int) -> int:
    return K[k] if k >= 0 else -K[-k]


def filtered(f: int, ks: list[int], g: list[int]) -> int:
    """The sample of an excitation; g becomes that of the next tick."""
    h = list(g)
    for j in range(len(ks), 0, -1):
        f = f + rdiv(sine(ks[j - 1]) * g[j - 1], 32768)
        if j < len(ks):
            h[j] = g[j - 1] - rdiv(sine(ks[j - 1]) * f, 32768)
    f = clamp(f, -(2**31), 2**31 - 1)
    if ks:
        h[0] = f
    g[:] = [clamp(each, -(2**31), 2**31 - 1) for each in h]
    return f


def synthesis(gains, blocks, shift: int, intervals: int, density: int, seed: int, span: int):
    """Counts; ``blocks``: the coefficients of each."""
    out: list[int] = []
    gain = envelope(gains, shift, span)
    g = [0] * len(blocks[0])
    for t in range(span):
        s = t // 2**shift
        if gains[s] == 0 and gains[max(s - 1, 0)] == 0:
            g = [0] * len(g)
            out.append(0)
            continue
        e = rdiv(gain[t] * noise_of(seed, t, density), 2**20)
        out.append(rdiv(filtered(e, blocks[s // intervals], g), 64))
    return out


def code_gains(coder, first: int, n: int, way, gains=None):
    told = None if gains is None else [gains[s] - gains[s - 1] for s in range(1, n)]
    out = [first]
    for difference in code_integers(coder, n - 1, *way, True, told):
        out.append(out[-1] + difference)
        if coder.coded is not None and not 0 <= out[-1] <= GAINS:
            raise BrokenRule("NOI-006")
    return out


def code_blocks(coder, gains, intervals: int, m: int, way, blocks=None):
    """The coefficients of each block; of ``blocks`` those that are written."""
    count = -(-len(gains) // intervals)
    silent = [not any(gains[b * intervals : (b + 1) * intervals]) for b in range(count)]
    told, before = None, [0] * m
    if blocks is not None:
        told = []
        for b in range(count):
            if not silent[b]:
                told += [new - old for new, old in zip(blocks[b], before, strict=True)]
                before = blocks[b]
    found = iter(code_integers(coder, m * silent.count(False), *way, True, told))
    out, before = [], [0] * m
    for b in range(count):
        if not silent[b]:
            before = [old + next(found) for old in before]
            if coder.coded is not None and not all(-127 <= k <= 127 for k in before):
                raise BrokenRule("NOI-006")
        out.append(before)
    return out


def decode(part: bytes, shift: int, intervals: int, span: int) -> list[int]:
    """The counts of a component packet."""
    if not part:
        return [0] * span
    m = part[0]
    if m > ORDERS:
        raise BrokenRule("NOI-005")
    head = HEAD + 2 * (m > 0)
    if len(part) < head:
        raise BrokenRule("NOI-005")
    density, seed, first = part[1], int.from_bytes(part[2:6], "little"), part[6]
    if first > GAINS:
        raise BrokenRule("NOI-006")
    ways = [tuple(part[at : at + 2]) for at in range(7, head, 2)]
    states = 4 if ways[0][0] & 16 else 1
    ways[0] = (ways[0][0] - 16 * (states == 4), ways[0][1])
    if any(number > 15 or start > 163 for number, start in ways):
        raise BrokenRule("RNG-004")
    n = -(-span // 2**shift)
    coder = Coder(part[head:], states)
    gains = code_gains(coder, first, n, ways[0])
    blocks = [[]] * n
    if m > 0:
        blocks = code_blocks(coder, gains, intervals, m, ways[1])
    coder.finish()
    return synthesis(gains, blocks, shift, intervals, density, seed, span)


def decode_packet(data: bytes, shift: int, intervals: int, span: int, count: int):
    """The counts of ``count`` components."""
    return [decode(part, shift, intervals, span) for part in split_parts(data, count, "LPC-001")]


def encode(gains, blocks, intervals, *, density=0, seed=1, ways=((0, 12), (0, 12)), states=1):
    """A component packet of gain indices, and the coefficients of each block (none: m is 0)."""
    m = len(blocks[0]) if blocks else 0
    coder = Coder(None, states)
    code_gains(coder, gains[0], len(gains), ways[0], gains)
    if m > 0:
        code_blocks(coder, gains, intervals, m, ways[1], blocks)
    head = bytes([m, density]) + seed.to_bytes(4, "little")
    head += bytes([gains[0], ways[0][0] + 16 * (states == 4), ways[0][1]])
    return head + (bytes(ways[1]) if m > 0 else b"") + coder.finish()


def encode_packet(parts: list[bytes]) -> bytes:
    return b"".join([*(varint_bytes(len(part)) for part in parts[:-1]), *parts])
