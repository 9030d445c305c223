"""The error bound of a channel in words, in its unit."""

from __future__ import annotations

from ..format.track import Component, Contract
from .screen import JOINED

LOSSLESS = "lossless"


def unit_text(unit: str) -> str:
    """A UCUM unit for people: nothing for the unit 1, counts for {count}."""
    return "" if unit == "1" else unit.strip("{}") + "s" if unit == "{count}" else unit


def amount(value: float, unit: str, digits: int = 3) -> str:
    """A number with its unit, if it has one."""
    return f"{value:.{digits}g}{JOINED}{unit_text(unit)}".rstrip()


def bound_text(contract: Contract | None, component: Component, index: int) -> str:
    """How far a decoded sample may be from the recorded one."""
    a, _, d = component.calibration
    moved = component.deviation[1] if component.deviation else 0.0
    if contract is None:
        return f"within {amount(moved, component.unit)}" if moved else LOSSLESS
    floor = contract.floor[min(index, len(contract.floor) - 1)]
    least = amount(floor * abs(a / d) + moved, component.unit)
    aim = "" if contract.guaranteed else ", an aim"
    vector = " of the vector" if contract.vector else ""
    if not contract.kn:
        return f"within {least}{vector}{aim}"
    return f"{100 * contract.kn / contract.kd:.3g}{JOINED}%{vector}, at least {least}{aim}"
