"""Exact numbers from the texts that people write, and the integer arithmetic of SPEC clause 2.

The size of a parsed number is bounded by the length of its text. rdiv, clamp, varint and svarint
work on one number at a time.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from math import inf, isinf
from numbers import Rational, Real
from typing import Any

from .errors import FormatError, ParameterError, TruncatedError

_DECIMAL = r"[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40}"
_NUMBER = re.compile(rf"[+-]?(?:{_DECIMAL})(?:e[+-]?[0-9]{{1,3}})?(?:/[0-9]{{1,40}})?", re.I)
"""1000, .5, 44100/7, 1e-3: forty digits and three of exponent are more than any format here holds,
and keep the arithmetic short."""

RATE_LIMIT = 1 << 64
"""Numerator and denominator of a rate lie below, so that every double of it is finite."""


def exact(value: Any) -> Fraction:
    """A text, an integer, a fraction, or a float, which stands for its shortest decimal: 0.1 is one
    tenth. ParameterError for anything else."""
    if isinstance(value, Rational):
        return Fraction(value)
    text = value
    if isinstance(value, Real):
        text = repr(float(value)) if isinstance(value, float) else str(value)
    if isinstance(text, str) and _NUMBER.fullmatch(text.strip()):
        try:
            return Fraction(text.strip())
        except (ValueError, ZeroDivisionError):
            pass
    raise ParameterError(f"{value!r} is not a number")


DOUBLE = re.compile(
    r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)(e[+-]?[0-9]+)?|[+-]?(nan|inf|infinity)", re.A | re.I
)
"""A number in a table, without blanks: float() takes 1_000 and digits of other scripts too."""

_NOT_ZERO = re.compile(r"[+-]?[0.]*[1-9]")


def double(text: str) -> float:
    """Return the double nearest to a number of a table; nan and inf are values.

    Raises ParameterError for other texts, and where the double would be infinite or 0 instead.
    """
    if DOUBLE.fullmatch(text) is None:
        raise ParameterError(f"{text[:40]!r} is not a number")
    value = float(text)
    if isinf(value) and "inf" not in text.lower():
        raise ParameterError(f"{text[:40]!r} is beyond the range of a double")
    if not value and _NOT_ZERO.match(text):
        raise ParameterError(f"{text[:40]!r} is below the smallest double; write 0")
    return value


def plain_doubles(cells: Sequence[str]) -> list[float] | None:
    """Return the doubles of many cells at once; None where one needs a look by :func:`double`.

    The cells are ASCII without an underscore, which float() skips.
    """
    try:
        values = list(map(float, cells))
    except ValueError:
        return None
    if inf in values or -inf in values:
        return None
    if 0.0 in values and any(
        not value and cell.strip(" +-0.") for value, cell in zip(values, cells, strict=True)
    ):
        return None
    return values


def counted(count: int, what: str) -> str:
    """1 channel, 2 channels"""
    return f"{count} {what}" + ("" if count == 1 else "s")


def hertz(value: Any) -> Fraction:
    """A rate, as :func:`exact`. A float such as 1 / 0.003, which has too many decimals to be meant
    literally, becomes the simplest fraction within 1e-9 of it."""
    plain = type(value) in (int, float, str, Fraction)
    return _known_hertz(value) if plain else _hertz(value)


def _hertz(value: Any) -> Fraction:
    try:
        found = exact(value)
    except ParameterError:
        raise ParameterError(
            f"rate is a number of samples per second, such as 1000 or '44100/7', not {value!r}"
        ) from None
    if found <= 0:
        raise ParameterError(f"rate is above 0 samples per second, not {value}")
    is_float = isinstance(value, Real) and not isinstance(value, Rational)
    if not is_float or found <= 0 or max(found.as_integer_ratio()) < 1 << 32:
        return found
    for limit in (1, 10, 100, 1000, 10_000):
        period = (1 / found).limit_denominator(limit)
        for near in (found.limit_denominator(limit), 1 / period if period else found):
            if near != found and abs(near - found) <= found / 10**9:
                return near
    return found


_known_hertz = lru_cache(maxsize=64, typed=True)(_hertz)
"""Channels of a recording have few rates."""


def checked_rate(rate: Fraction) -> Fraction:
    if not (0 < rate.numerator < RATE_LIMIT and rate.denominator < RATE_LIMIT):
        raise ParameterError(f"a rate is a fraction of two integers from 1 to 2^64 - 1, not {rate}")
    return rate


def tick_range(
    rate: Fraction, start: Fraction | float | None, stop: Fraction | float | None
) -> tuple[int, int]:
    """Ticks from ceil(start * rate) to ceil(stop * rate), exactly (SPEC clause 7)."""
    if start is None and stop is None:
        return 0, 1 << 62

    def tick(seconds: Fraction | float) -> int:
        product = exact(seconds) * rate
        return -(-product.numerator // product.denominator)

    return (
        0 if start is None else max(tick(start), 0),
        1 << 62 if stop is None else tick(stop),
    )


VARINT_SIZE = 8
"""Eight groups of seven bits hold every number below 2**53."""


def rdiv(n: int, d: int) -> int:
    """n / d to the nearest integer, ties towards plus infinity; d > 0."""
    return (2 * n + d) // (2 * d)


def clamp(x: int, low: int, high: int) -> int:
    return low if x < low else high if x > high else x


_BYTES = [bytes([value]) for value in range(0x80)]


def build_varint(value: int) -> bytes:
    """SPEC CNV-002."""
    if 0 <= value < 0x80:
        return _BYTES[value]
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
