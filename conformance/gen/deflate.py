"""DEFLATE streams (RFC 1951) that no version of a library changes; imports nothing from hapfmt."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Sequence

Token = int | tuple[int, int]
"""A byte, or (length, distance)."""

STORED, FIXED, DYNAMIC = range(3)
END = 256
ORDER = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15]
FIXED_LENGTHS = [8] * 144 + [9] * 112 + [7] * 24 + [8] * 8


def classes(first: int, step: int, extra_from: int, count: int) -> list[tuple[int, int]]:
    """(least value, extra bits) of each code of lengths or distances."""
    out, least = [], first
    for code in range(count):
        extra = max(0, code - extra_from) // step
        out.append((least, extra))
        least += 1 << extra
    return out


LENGTHS = [*classes(3, 4, 4, 28), (258, 0)]
DISTANCES = classes(1, 2, 2, 30)


def low_first(value: int, size: int) -> str:
    return f"{value:0{size}b}"[::-1] if size else ""


def tokens_of(data: bytes) -> list[Token]:
    """Greedy: the last place of the next three bytes, as far back as a stream may look."""
    out: list[Token] = []
    seen: dict[bytes, int] = {}
    at = 0
    while at < len(data):
        before = seen.get(data[at : at + 3])
        length = 0
        if before is not None and at - before <= 32768 and at + 3 <= len(data):
            while length < 258 and data[at + length : at + length + 1] == data[
                before + length : before + length + 1
            ] and at + length < len(data):  # fmt: skip
                length += 1
        for i in range(at, at + max(length, 1)):
            seen[data[i : i + 3]] = i
        out.append((length, at - before) if length else data[at])
        at += max(length, 1)
    return out


def code_lengths(counts: Counter[int], symbols: int, limit: int = 15) -> list[int]:
    """By Huffman, the same everywhere: equal weights go by the least symbol. Too long: flatter."""
    heap = [(n, symbol, [symbol]) for symbol, n in sorted(counts.items())]
    heapq.heapify(heap)
    out = [0] * symbols
    if len(heap) == 1:
        out[heap[0][1]] = 1
    while len(heap) > 1:
        a, b = heapq.heappop(heap), heapq.heappop(heap)
        for symbol in a[2] + b[2]:
            out[symbol] += 1
        heapq.heappush(heap, (a[0] + b[0], min(a[1], b[1]), a[2] + b[2]))
    if max(out) > limit:
        flatter = Counter({symbol: (n + 1) // 2 for symbol, n in counts.items()})
        return code_lengths(flatter, symbols, limit)
    return out


def codes(lengths: Sequence[int]) -> dict[int, str]:
    out, code, before = {}, 0, 0
    for length, symbol in sorted((n, symbol) for symbol, n in enumerate(lengths) if n):
        code <<= length - before
        out[symbol], before = f"{code:0{length}b}", length
        code += 1
    return out


def split(token: Token) -> list[tuple[int, int, int]]:
    """(symbol, extra value, extra bits): of a byte, or of a length and then of a distance."""
    if isinstance(token, int):
        return [(token, 0, 0)]
    out = []
    for value, table, first in zip(token, (LENGTHS, DISTANCES), (257, 0), strict=True):
        code = max(i for i, (least, _) in enumerate(table) if least <= value)
        out.append((first + code, value - table[code][0], table[code][1]))
    return out


def squeezed(lengths: Sequence[int]) -> list[tuple[int, int, int]]:
    """The lengths of the code words as (symbol, extra value, extra bits)."""
    out, at = [], 0
    while at < len(lengths):
        size = 1
        while at + size < len(lengths) and lengths[at + size] == lengths[at] and size < 138:
            size += 1
        if lengths[at] == 0 and size >= 11:
            out.append((18, size - 11, 7))
        elif lengths[at] == 0 and size >= 3:
            out.append((17, size - 3, 3))
        elif size >= 4:
            size = min(size, 7)
            out += [(lengths[at], 0, 0), (16, size - 4, 2)]
        else:
            size = 1
            out.append((lengths[at], 0, 0))
        at += size
    return out


def block(tokens: Sequence[Token], *, last: bool, kind: int) -> str:
    """Bits in order of the stream; ``kind`` FIXED or DYNAMIC."""
    parts = [split(token) for token in tokens] + [[(END, 0, 0)]]
    out = str(int(last)) + low_first(kind, 2)
    if kind == FIXED:
        words, far = codes(FIXED_LENGTHS), {i: f"{i:05b}" for i in range(30)}
    else:
        literal = code_lengths(Counter(part[0][0] for part in parts), 286)
        distance = code_lengths(Counter(part[1][0] for part in parts if part[1:]), 30)
        words, far = codes(literal), codes(distance)
        while len(literal) > 257 and literal[-1] == 0:
            literal.pop()
        while len(distance) > 1 and distance[-1] == 0:
            distance.pop()
        rows = squeezed(literal + distance)
        table = code_lengths(Counter(symbol for symbol, _, _ in rows), 19, 7)
        used = max(i for i, symbol in enumerate(ORDER) if table[symbol])
        out += low_first(len(literal) - 257, 5) + low_first(len(distance) - 1, 5)
        out += low_first(max(used + 1, 4) - 4, 4)
        out += "".join(low_first(table[symbol], 3) for symbol in ORDER[: max(used + 1, 4)])
        named = codes(table)
        out += "".join(named[symbol] + low_first(more, size) for symbol, more, size in rows)
    for part in parts:
        for place, (symbol, more, size) in enumerate(part):
            out += (far if place else words)[symbol] + low_first(more, size)
    return out


def packed(bits: str) -> bytes:
    bits += "0" * (-len(bits) % 8)
    return bytes(int(bits[i : i + 8][::-1], 2) for i in range(0, len(bits), 8))


def stored(data: bytes) -> bytes:
    """A last block of bytes as they stand, at most 65535."""
    size = len(data).to_bytes(2, "little")
    return b"\1" + size + bytes(255 - byte for byte in size) + data


def deflate(data: bytes, kind: int = DYNAMIC) -> bytes:
    if kind == STORED:
        return stored(data)
    return packed(block(tokens_of(data), last=True, kind=kind))
