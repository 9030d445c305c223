"""Numbers as people write them, exactly, and never larger than the text deserves."""

from __future__ import annotations

import re
from fractions import Fraction
from numbers import Rational, Real
from typing import Any

from .errors import ParameterError

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


def counted(count: int, what: str) -> str:
    """1 channel, 2 channels"""
    return f"{count} {what}" + ("" if count == 1 else "s")


def hertz(value: Any) -> Fraction:
    """A rate, as :func:`exact`; but a float such as 1 / 0.003 stands for the simplest fraction
    within 1e-9 of it, where its decimals are too many to be meant."""
    try:
        found = exact(value)
    except ParameterError:
        raise ParameterError(
            f"rate is a number of samples per second, such as 1000 or '44100/7', not {value!r}"
        ) from None
    is_float = isinstance(value, Real) and not isinstance(value, Rational)
    if not is_float or found <= 0 or max(found.as_integer_ratio()) < 1 << 32:
        return found
    for limit in (1, 10, 100, 1000, 10_000):
        period = (1 / found).limit_denominator(limit)
        for near in (found.limit_denominator(limit), 1 / period if period else found):
            if near != found and abs(near - found) <= found / 10**9:
                return near
    return found


def checked_rate(rate: Fraction) -> Fraction:
    if not (0 < rate.numerator < RATE_LIMIT and rate.denominator < RATE_LIMIT):
        raise ParameterError("a rate is a fraction of two integers in [1, 2^64)")
    return rate


def tick_range(
    rate: Fraction, start: Fraction | float | None, stop: Fraction | float | None
) -> tuple[int, int]:
    """Ticks from ceil(start * rate) to ceil(stop * rate), exactly (SPEC clause 7)."""

    def tick(seconds: Fraction | float) -> int:
        product = exact(seconds) * rate
        return -(-product.numerator // product.denominator)

    return (
        0 if start is None else max(tick(start), 0),
        1 << 62 if stop is None else tick(stop),
    )
