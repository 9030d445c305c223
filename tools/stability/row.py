"""A case that goes wrong naively: what both ways give, and what must hold."""

from __future__ import annotations

from typing import NamedTuple


class Limit(NamedTuple):
    """Which numbers are allowed; never nan."""

    sign: str
    value: float

    def holds(self, x: float) -> bool:
        if self.sign == "\N{LESS-THAN OR EQUAL TO}":
            return x <= self.value
        if self.sign == "\N{GREATER-THAN OR EQUAL TO}":
            return x >= self.value
        return x == self.value

    def __str__(self) -> str:
        return f"{self.sign} {self.value:g}"


def at_most(value: float) -> Limit:
    return Limit("\N{LESS-THAN OR EQUAL TO}", value)


def at_least(value: float) -> Limit:
    return Limit("\N{GREATER-THAN OR EQUAL TO}", value)


def exactly(value: float) -> Limit:
    return Limit("=", value)


class Row(NamedTuple):
    """Naive and ours in ``unit``. ok: the naive result is as bad, and ours as good, as ``limits``
    say, and what else the case asks of ours holds."""

    number: int
    case: str
    naive: float
    ours: float
    unit: str
    note: str
    ok: bool
    limits: str


def compared(
    number: int,
    case: str,
    naive: tuple[float, Limit],
    ours: tuple[float, Limit],
    unit: str,
    note: str = "",
    *,
    held: bool = True,
) -> Row:
    """held: what else must be true of ours; the note says what."""
    (bad, is_bad), (good, is_good) = naive, ours
    return Row(
        number,
        case,
        float(bad),
        float(good),
        unit,
        note,
        bool(held and is_bad.holds(bad) and is_good.holds(good)),
        f"naive {is_bad}, ours {is_good}",
    )
