"""DEFLATE (RFC 1951): streams that are the same on every machine, and inflating to a known size."""

from __future__ import annotations

import zlib
from bisect import bisect_right

from ..errors import FormatError
from ..kernels import compiled

SHORTEST, LONGEST, WINDOW = 3, 258, 1 << 15
TRIES = 32
"""Places with the same three bytes that are looked at, the nearest first."""
MARKED = 16
"""First places of a repetition that are remembered, so that later repetitions may start there."""
END, FIRST_LENGTH = 256, 257


def inflate(data: bytes, size: int, requirement: str, offset: int) -> bytes:
    """The ``size`` bytes that a whole stream stands for, at most one more in memory;
    ``requirement``: the rule that another length and a bad stream break."""
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        out = unpacker.decompress(data, size + 1)
    except zlib.error as error:
        raise FormatError(f"DEFLATE: {error}", requirement=requirement, offset=offset) from None
    if len(out) != size:
        raise FormatError(
            "DEFLATE stream of another length", requirement=requirement, offset=offset
        )
    if not unpacker.eof or unpacker.unused_data:
        raise FormatError(
            "DEFLATE stream ends too late or too early", requirement=requirement, offset=offset
        )
    return out


def classes(least: int, step: int, short: int, count: int) -> list[tuple[int, int]]:
    """Least value and further bits of each code: one bit more every ``step`` codes."""
    out = []
    for code in range(count):
        out.append((least, max(0, code - short) // step))
        least += 1 << out[-1][1]
    return out


LENGTHS = [*classes(3, 4, 4, 28), (LONGEST, 0)]
DISTANCES = classes(1, 2, 2, 30)


def reverse(value: int, size: int) -> int:
    return int(f"{value:0{size}b}"[::-1], 2)


def word(symbol: int) -> tuple[int, int]:
    """The fixed code word of a byte, a length or the end, its first bit lowest, and its size."""
    first, least, size = next(row for row in FIXED if symbol >= row[0])
    return reverse(least + symbol - first, size), size


FIXED = ((280, 0xC0, 8), (256, 0, 7), (144, 0x190, 9), (0, 0x30, 8))
"""For each size of code words: the first symbol, its code word, and the bits."""
WORDS = [word(symbol) for symbol in range(286)]


def deflate(data: bytes) -> bytes:
    """One block with fixed codes, without zlib, of which each version writes other bytes."""
    if compiled is not None:
        return compiled.deflate(data)
    hold, held = 0b011, 3  # the last block, with fixed codes
    out = bytearray()
    seen: dict[bytes, list[int]] = {}
    at = 0
    while at < len(data):
        length, distance = longest(data, at, seen.get(data[at : at + SHORTEST], []))
        parts = [WORDS[data[at]]]
        if length:
            code, above = coded(LENGTHS, length)
            far, further = coded(DISTANCES, distance)
            parts = [WORDS[FIRST_LENGTH + code], above, (reverse(far, 5), 5), further]
        for value, size in parts:
            hold |= value << held
            held += size
        while held >= 8:
            out.append(hold & 0xFF)
            hold >>= 8
            held -= 8
        for place in range(at, at + min(max(length, 1), MARKED)):
            seen.setdefault(data[place : place + SHORTEST], []).append(place)
        at += max(length, 1)
    return bytes(out) + hold.to_bytes((held + WORDS[END][1] + 7) // 8, "little")


def coded(table: list[tuple[int, int]], value: int) -> tuple[int, tuple[int, int]]:
    """Its code; how far it is above the least of that, and in how many bits."""
    code = bisect_right(table, (value, LONGEST)) - 1
    least, bits = table[code]
    return code, (value - least, bits)


def longest(data: bytes, at: int, places: list[int]) -> tuple[int, int]:
    """Length and distance of what is repeated from ``at`` on, as long as can be; 0: nothing."""
    best = distance = 0
    most = min(LONGEST, len(data) - at)
    for place in reversed(places[-TRIES:]):
        if best == most or at - place > WINDOW:
            break
        if data[place + best] != data[at + best]:
            continue
        length = SHORTEST
        while length < most and data[place + length] == data[at + length]:
            length += 1
        if length > best:
            best, distance = length, at - place
    return best, distance
