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

    transform: bool = True
    """A texture is tried by MDCT too."""

    lines: bool = False
    """A texture without silent stretches is tried after lines for its slow part too."""


EFFORTS: dict[EffortName, Effort] = {
    "fast": Effort(references=False, relations=False),
    "default": Effort(),
    "best": Effort(lines=True),
}

SEARCHES = tuple(field.name for field in fields(Effort))


@contextmanager
def without(search: str) -> Iterator[None]:
    """Leave one search out of every effort, to measure it."""
    known = dict(EFFORTS)
    try:
        for name, effort in known.items():
            EFFORTS[name] = replace(effort, **{search: type(getattr(effort, search))()})
        yield
    finally:
        EFFORTS.update(known)
