"""What a recorder is told of a channel before its first sample."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import isfinite

from ..format.tlv import encode_text
from ..errors import ParameterError
from ..numbers import exact
from ..recording import Calibration

COUNT_BITS = range(2, 33)


@dataclass(frozen=True)
class Input:
    """One channel to be recorded.

    ``rate``: ticks per second, a positive Fraction. With a ``calibration`` integer counts of
    ``bits`` signed bits come in. With an ``lsb``, the step in ``unit``, floats come in and are put
    on its multiples: half of it is declared as deviation. With neither floats are kept bit for bit.
    """

    label: str
    rate: Fraction
    unit: str = "1"
    quantity: str = ""
    axis: str = ""
    group: str = ""
    body_site: str = ""
    device: str = ""
    calibration: Calibration | None = None
    bits: int = 24
    lsb: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", exact(self.rate))
        for text in (self.label, self.unit, self.quantity, self.axis, self.group, self.body_site):
            encode_text(text)
        encode_text(self.device)
        if self.rate <= 0:
            raise ParameterError(f"the rate of {self.label!r} is positive")
        if self.bits not in COUNT_BITS:
            raise ParameterError(f"the counts of {self.label!r} have 2 to 32 bits")
        if self.calibration is not None and self.lsb is not None:
            raise ParameterError(f"{self.label!r} has a calibration or an lsb, not both")
        if self.lsb is not None and not (isfinite(self.lsb) and self.lsb > 0):
            raise ParameterError(f"the lsb of {self.label!r} is a positive number")

    @property
    def takes_counts(self) -> bool:
        """Whether integer counts come in, else floats."""
        return self.calibration is not None
