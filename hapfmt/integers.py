"""The integer arithmetic of SPEC clause 2, one number at a time: rdiv, clamp, varint, svarint."""

from __future__ import annotations

from .errors import FormatError, TruncatedError

VARINT_SIZE = 8
"""Eight groups of seven bits hold every number below 2**53."""


def rdiv(n: int, d: int) -> int:
    """n / d to the nearest integer, ties towards plus infinity; d > 0."""
    return (2 * n + d) // (2 * d)


def clamp(x: int, low: int, high: int) -> int:
    return low if x < low else high if x > high else x


def build_varint(value: int) -> bytes:
    """SPEC CNV-002."""
    if not 0 <= value < 1 << 53:
        raise ValueError(f"varint out of range: {value}")
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def parse_varint(data: bytes, position: int, base: int = 0) -> tuple[int, int]:
    """The varint at ``position`` and the position after it; ``base`` is the offset of ``data``."""
    if position + 1 < len(data):
        # Nearly all are of one byte or two.
        value, byte = data[position], data[position + 1]
        if value < 0x80:
            return value, position + 1
        if 0 < byte < 0x80:
            return value & 0x7F | byte << 7, position + 2
    value = 0
    for index in range(VARINT_SIZE):
        if position + index >= len(data):
            raise TruncatedError(
                "the bytes end within a varint", requirement="CNV-002", offset=base + position
            )
        byte = data[position + index]
        value |= (byte & 0x7F) << (7 * index)
        if byte < 0x80:
            if byte == 0 and index:
                raise FormatError(
                    "varint longer than needed", requirement="CNV-002", offset=base + position
                )
            if value >= 1 << 53:
                break
            return value, position + index + 1
    raise FormatError("varint of 2^53 or more", requirement="CNV-002", offset=base + position)


def from_signed(v: int) -> int:
    """What stands for v in an unsigned code: 0, -1, 1, -2 ... are 0, 1, 2, 3 ..."""
    return 2 * v if v >= 0 else -2 * v - 1


def to_signed(u: int) -> int:
    return (u >> 1) ^ -(u & 1)


def build_svarint(value: int) -> bytes:
    return build_varint(from_signed(value))


def parse_svarint(data: bytes, position: int, base: int = 0) -> tuple[int, int]:
    """As parse_varint, signed."""
    number, after = parse_varint(data, position, base)
    return to_signed(number), after
