"""Recorded units -> those of an actuator: what a profile accepts, with any prefix."""

from __future__ import annotations

import re
from collections.abc import Mapping
from fractions import Fraction
from typing import NamedTuple

from ...numbers import exact
from ...units import to_ucum

_POWERS = {
    "Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1, "d": -1,
    "c": -2, "m": -3, "u": -6, "n": -9, "p": -12, "f": -15, "a": -18, "z": -21, "y": -24,
}  # fmt: skip
"""UCUM's metric prefixes."""
_ATOMS = (
    "m", "s", "g", "rad", "K", "C", "cd", "mol", "sr", "N", "Pa", "J", "W", "A", "V", "F", "Ohm",
    "S", "Wb", "Cel", "T", "H", "Hz", "bar", "[g]", "m[H2O]", "m[Hg]", "L", "l", "eV", "lm", "lx",
)  # fmt: skip
"""Units that take a prefix."""
_FACTOR = re.compile(r"(.*?)([+-]?[0-9]{1,2})?", re.DOTALL)


class Term(NamedTuple):
    """``scale`` times a product of atoms, each with its exponent."""

    scale: Fraction
    atoms: tuple[tuple[str, int], ...]


def parse_term(unit: str) -> Term:
    """A UCUM term without parentheses and annotations; anything else is an atom as it stands."""
    if re.search(r"[(){}]", unit):
        return Term(Fraction(1), ((unit, 1),))
    scale, atoms = Fraction(1), dict[str, int]()
    for sign, text in re.findall(r"(^|[./])([^./]+)", unit):
        matched = _FACTOR.fullmatch(text)
        assert matched is not None
        body, power = matched[1] or text, int(matched[2] or 1) if matched[1] else 1
        power = -power if sign == "/" else power
        prefix, atom = split_prefix(body)
        scale *= Fraction(10) ** (prefix * power)
        if atom == "%":
            scale, atom = scale / Fraction(100) ** power, "1"
        if atom != "1":
            atoms[atom] = atoms.get(atom, 0) + power
    return Term(scale, tuple(sorted((atom, n) for atom, n in atoms.items() if n)))


def split_prefix(body: str) -> tuple[int, str]:
    """mN -> (-3, N); m -> (0, m)."""
    if body in _ATOMS:
        return 0, body
    for size in (2, 1):
        if body[:size] in _POWERS and body[size:] in _ATOMS:
            return _POWERS[body[:size]], body[size:]
    return 0, body


def factor_for(unit: str, accepts: Mapping[str, float]) -> Fraction | None:
    """What one recorded unit is in the actuator's; None where it does not accept that unit.

    >>> factor_for("cN", {"N": 1000.0})
    Fraction(10, 1)
    """
    known = {to_ucum(name): exact(factor) for name, factor in accepts.items()}
    unit = to_ucum(unit)
    if unit in known:
        return known[unit]
    term = parse_term(unit)
    for name, factor in known.items():
        other = parse_term(name)
        if other.atoms == term.atoms:
            return factor * term.scale / other.scale
    return None
