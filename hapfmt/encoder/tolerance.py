"""Amounts as the caller gives them: 0.01, 10mN, 2lsb, 0.1%."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from math import isfinite
from typing import Literal

from ..errors import ParameterError
from ..units import conversion, to_ucum

# ASCII digits only: \d would take every digit of Unicode. Four digits of exponent are more than
# float64 can use, and keep the text of the exponent short.
_NUMBER = r"([0-9]+\.?[0-9]*|\.[0-9]+)(?:e([+-]?[0-9]{1,4}))?"
_AMOUNT = re.compile(rf"\+?{_NUMBER}\s*(\S.{{0,99}})?", re.IGNORECASE | re.DOTALL)


@dataclass(frozen=True)
class Tolerance:
    """An amount, positive and finite: a largest error, a threshold, a step.

    ``value`` is absolute, in ``unit`` (a UCUM code; "" for the channel's own), in steps of
    the sensor ("lsb"), or a fraction (0.0001 for 0.01 %) of the channel's largest minus its
    smallest value ("range"), single samples far beyond all others left out.
    """

    value: float
    kind: Literal["absolute", "lsb", "range"] = "absolute"
    unit: str = ""

    def __post_init__(self) -> None:
        if self.kind not in ("absolute", "lsb", "range"):
            raise ParameterError(f"{self.kind!r} is not a kind of tolerance: absolute, lsb, range")
        if not (isfinite(self.value) and self.value > 0):
            raise ParameterError(
                f"an amount is above 0 and finite, {self.value} is not; "
                "to keep every bit, use preset lossless"
            )

    @classmethod
    def parse(cls, text: str) -> Tolerance:
        """ "1e-6" in the channel's unit, "10mN", "0.5lsb" in steps, "0.01%" of the channel's own
        range."""
        match = _AMOUNT.fullmatch(text.strip())
        digits, exponent, suffix = match.groups() if match else ("", "", "")
        suffix = (suffix or "").strip()
        if match is None or not is_unit(suffix):
            raise ParameterError(
                f"{text!r} is not an amount: write a positive number in the channel's unit (1e-6), "
                "with a unit (10mN), in steps of the sensor (0.5lsb), or in percent of the "
                "channel's range (0.01%)"
            )
        if suffix == "%":
            # Moved into the exponent, 0.07% is the double nearest to 0.0007; 0.07 / 100 is not.
            return cls(float(f"{digits}e{int(exponent or 0) - 2}"), "range")
        value = float(f"{digits}e{exponent or 0}")
        if suffix.lower() == "lsb":
            return cls(value, "lsb")
        return cls(value, unit=to_ucum(suffix) if suffix else "")

    def in_unit(self, unit: str) -> float:
        """The value of an absolute amount in the unit of a channel."""
        if not self.unit or self.unit == unit:
            return self.value
        factor = conversion(self.unit, unit)
        if factor is None:
            raise ParameterError(
                f"an amount in {self.unit} does not fit a channel in {unit}; give a share of the "
                "range (0.1%), or the amount in the channel's unit"
            )
        return float(Fraction(repr(self.value)) * factor)

    def absolute(self, extent: float, step: float | None, unit: str = "") -> float | None:
        """The tolerance in the channel's unit; None in lsb where no step is known.

        extent: the channel's largest minus its smallest value. unit: the channel's.
        """
        if self.kind == "range":
            return self.value * extent
        if self.kind == "lsb":
            return None if step is None else self.value * step
        return self.in_unit(unit)


def is_unit(text: str) -> bool:
    """Whether a text behind a number is a unit or one of the two other suffixes, or empty."""
    if text in ("", "%") or text.lower() == "lsb":
        return True
    return not to_ucum(text).startswith("{")
