"""``--tolerance``: how far a value may be from the recorded one, as the caller declares it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite
from typing import Literal

from ..errors import ParameterError

# ASCII digits only: \d would take every digit of Unicode. Four digits of exponent are more than
# float64 can use, and keep the text of the exponent short.
_NUMBER = r"([0-9]+\.?[0-9]*|\.[0-9]+)(?:e([+-]?[0-9]{1,4}))?"
_TOLERANCE = re.compile(rf"\+?{_NUMBER}\s*(lsb|%)?", re.IGNORECASE)


@dataclass(frozen=True)
class Tolerance:
    """Largest deviation, positive and finite.

    ``value`` is in the channel's unit ("absolute"), in steps of the sensor ("lsb"), or a fraction
    (0.0001 for 0.01 %) of the channel's largest minus its smallest value ("range"), single samples
    far beyond all others left out.
    """

    value: float
    kind: Literal["absolute", "lsb", "range"] = "absolute"

    def __post_init__(self) -> None:
        if self.kind not in ("absolute", "lsb", "range"):
            raise ParameterError(f"{self.kind!r} is not a kind of tolerance: absolute, lsb, range")
        if not (isfinite(self.value) and self.value > 0):
            raise ParameterError(
                f"a tolerance is positive and finite, {self.value} is not; "
                "to keep every bit, declare none"
            )

    @classmethod
    def parse(cls, text: str) -> Tolerance:
        """ "1e-6" in the channel's unit, "0.5lsb" in steps, "0.01%" of the channel's own range."""
        match = _TOLERANCE.fullmatch(text.strip())
        if match is None:
            raise ParameterError(
                f"{text!r} is not a tolerance: write a positive number in the channel's unit "
                "(1e-6), in steps of the sensor (0.5lsb), or in percent of the channel's range "
                "(0.01%)"
            )
        digits, exponent, suffix = match.groups()
        if suffix == "%":
            # Moved into the exponent, 0.07% is the double nearest to 0.0007; 0.07 / 100 is not.
            return cls(float(f"{digits}e{int(exponent or 0) - 2}"), "range")
        return cls(float(f"{digits}e{exponent or 0}"), "lsb" if suffix else "absolute")

    def absolute(self, extent: float, step: float | None) -> float | None:
        """The tolerance in the channel's unit; None in lsb where no step is known.

        extent: the channel's largest minus its smallest value.
        """
        if self.kind == "range":
            return self.value * extent
        if self.kind == "lsb":
            return None if step is None else self.value * step
        return self.value
