"""SPEC 2 a second time, from the page alone: integers; imports nothing from hapfmt."""

from __future__ import annotations


class BrokenRule(Exception):  # noqa: N818
    """The argument is its id."""


def rdiv(n: int, d: int) -> int:
    return (2 * n + d) // (2 * d)


def clamp(x: int, low: int, high: int) -> int:
    return max(low, min(high, x))


def bits_of(v: int) -> int:
    return len(f"{v:b}") if v else 0


def varint(data: bytes, at: int) -> tuple[int, int]:
    """The number, and where it ends."""
    number = 0
    for group in range(9):
        if group == 8 or at + group >= len(data):
            raise BrokenRule("CNV-002")
        byte = data[at + group]
        number += byte % 128 * 128**group
        if byte < 128:
            break
    if group and byte == 0:
        raise BrokenRule("CNV-002")
    if number >= 2**53:
        raise BrokenRule("CNV-002")
    return number, at + group + 1


def signed(number: int) -> int:
    return number // 2 if number % 2 == 0 else -(number + 1) // 2


def varint_bytes(number: int) -> bytes:
    out = bytearray()
    while number > 127:
        out.append(number % 128 + 128)
        number //= 128
    return bytes([*out, number])


def svarint_bytes(v: int) -> bytes:
    return varint_bytes(2 * v if v >= 0 else -2 * v - 1)
