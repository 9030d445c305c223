"""SPEC 9.3 a second time, read from the page alone; imports nothing from hapfmt."""

from __future__ import annotations

import deflate

STORED, DEFLATE = 0, 1


def planes(components: list[list[int]], size: int) -> bytes:
    """For each component the lowest bytes of all ticks, then the next ones; two's complement."""
    out = b""
    for numbers in components:
        words = [(number % 256**size).to_bytes(size, "little") for number in numbers]
        out += b"".join(bytes(word[i] for word in words) for i in range(size))
    return out


def encode(components: list[list[int]], size: int, method: int = STORED,
           kind: int = deflate.DYNAMIC) -> bytes:  # fmt: skip
    raw = planes(components, size)
    return bytes([method]) + (raw if method == STORED else deflate.deflate(raw, kind))
