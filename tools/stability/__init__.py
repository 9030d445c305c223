"""Stiff and extreme cases: what a naive way gives, and what hapfmt gives, both computed.

    row.py          a row: two results, the limits of both, and whether they hold
    signals.py      what the cases are made of
    perception.py   deadbands and measures
    filters.py      the split into slow and fast
    ranges.py       one large sample among small ones
    arithmetic.py   numbers: huge, short, long, rounded
    predictors.py   linear prediction
    playing.py      what a device gets
    scenes.py       simulated contact
    extremes.py     full scale, impulses, denormals, -0.0, as many tracks as there can be
    seconds.py      odd rates, late starts, clocks

Every case is a function without arguments that gives a row or several.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from importlib import import_module

from .row import Row

__all__ = ["DEEP", "QUICK", "Row", "rows", "rows_of"]

Case = Callable[[], Row | Iterable[Row]]
MODULES = (
    "perception", "filters", "ranges", "arithmetic", "predictors", "playing", "scenes", "extremes",
    "seconds",
)  # fmt: skip


def cases(name: str) -> Iterator[Case]:
    for module in MODULES:
        yield from getattr(import_module(f".{module}", __package__), name, ())


QUICK: tuple[Case, ...] = tuple(cases("ROWS"))
DEEP: tuple[Case, ...] = tuple(cases("DEEP"))
"""Those that take seconds."""


def rows_of(case: Case) -> list[Row]:
    found = case()
    return [found] if isinstance(found, Row) else list(found)


def rows(*, deep: bool = False, progress: Callable[[str], None] = lambda _line: None) -> list[Row]:
    """All of them, by number; ``deep``: with those that take seconds."""
    found: list[Row] = []
    for case in QUICK + (DEEP if deep else ()):
        progress(case.__name__.replace("_", " "))
        found += rows_of(case)
    return sorted(found, key=lambda row: row.number)
