"""How much the encoder searches: fast, default or best.

A search that gains less than 1 % of size on a kind of recording may take 10 % of the encoding time
there. ``tools/bench.py --searches`` prints what each gains and costs.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Literal

EffortName = Literal["fast", "default", "best"]


@dataclass(frozen=True)
class Effort:
    """The searches that the encoder makes. Each can be left out alone."""

    references: bool = True
    """Channels that resemble each other share a track."""

    relations: bool = True
    """Channels of doubles that follow from others share a track with them."""

    cuts: bool = True
    """Packets are cut where the pieces are smaller together."""

    high_orders: bool = True
    """Predictors have up to 32 coefficients, not 12."""

    plain_sums: bool = True
    """Predictors of quiet packets come also from sums in which loud parts outweigh quiet ones."""

    undifferenced: bool = True
    """Predictors are also of the samples where their differences are little smaller."""

    polynomials: bool = True
    """Doubles near to a grid are tried as a polynomial of their counts."""

    decimals: bool = True
    """Doubles near to a grid are tried as decimals."""

    every_form: bool = False
    """Doubles, channels with an error, and channels that are linked, are written in each form, not
    only in the one that estimates tell."""

    every_sample: bool = False
    """Estimates look at each sample, not at one in three."""

    other_orders: bool = False
    """All packets have all sums, and the best sums are tried with other orders as well."""

    written: int = 1
    """Packets that are written, for the smallest to stay."""

    transform: bool = True
    """A texture is tried by MDCT too."""

    lines: bool = False
    """A texture without silent stretches is tried after lines for its slow part too."""

    @property
    def highest(self) -> int:
        """The highest order of a predictor."""
        return 32 if self.high_orders else 12

    @property
    def stride(self) -> int:
        """Estimates look at one part of as many as this."""
        return 1 if self.every_sample else 3

    @property
    def sums(self) -> int:
        """Which sums predictors come from, as bits."""
        return 1 | 2 * self.plain_sums | 4 * self.undifferenced * (1 + 2 * self.plain_sums)


EFFORTS: dict[EffortName, Effort] = {
    "fast": Effort(
        references=False,
        relations=False,
        cuts=False,
        plain_sums=False,
        undifferenced=False,
    ),
    "default": Effort(),
    "best": Effort(every_form=True, every_sample=True, other_orders=True, written=6, lines=True),
}

SEARCHES = tuple(field.name for field in fields(Effort) if field.type == "bool")


@contextmanager
def without(search: str) -> Iterator[None]:
    """Leave one search out of every effort, to measure it."""
    known = dict(EFFORTS)
    try:
        for name, effort in known.items():
            EFFORTS[name] = replace(effort, **{search: False})
        yield
    finally:
        EFFORTS.update(known)
