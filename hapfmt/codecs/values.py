"""Which double a count stands for before it is corrected: the rules of LPCX (SPEC 9.7).

Each is what some logger did with its counts, in correctly rounded steps, the same on every machine.
The bit patterns of doubles in the order of their values are integers here as well.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..format.track import Affine

QUOTIENT, PRODUCT, SIGNIFICANT, CUBIC, LINEAR = range(5)
PLACES_LIMIT, DIGITS_LIMIT = 22, 15
"""10^22 is the last power of ten that is a double, 10^15 the last below 2^53."""

COEFFICIENTS, COEFFICIENT_LIMIT = 4, 2.0**900
"""Polynomials of 32-bit counts stay finite below this limit."""

TERMS_LIMIT = 16
"""Of a linear rule."""

DOUBLE, BITS = struct.Struct("<d"), struct.Struct("<q")
LAST_PLACE, HALF = (1 << 63) - 1, 1 << 63

WIDE = 1 << 62
"""Products below are taken in 64 bits."""

Counts = NDArray[np.int64]
Doubles = NDArray[np.float64]


class Term(NamedTuple):
    """Of a linear rule: a weight for the exact value of a component some ticks before."""

    component: int
    lag: int
    weight: float


def rule_fits(rule: int, digits: int, terms: int) -> bool:
    """EXA-002."""
    least, most = (1, DIGITS_LIMIT) if rule == SIGNIFICANT else (0, 0)
    fewest, many = (1, TERMS_LIMIT) if rule == LINEAR else (0, 0)
    return rule <= LINEAR and least <= digits <= most and fewest <= terms <= many


def values_of(
    counts: Counts, affine: Affine, rule: int, digits: int, coefficients: Sequence[float] = ()
) -> Doubles:
    """The double of each count [samples] by the rule; counts as VAL-001 allows them."""
    a, b, d = affine
    if rule == CUBIC:
        # NumPy has no fused multiply-add. The last sum turns -0.0 into 0.0.
        x, v = counts.astype(np.float64), np.full(counts.size, coefficients[-1])
        for each in coefficients[-2::-1]:
            v = v * x + each
        return np.asarray(v + 0.0)
    if rule == PRODUCT:
        product = counts.astype(np.float64) * (float(a) / float(d))
        return np.asarray(product + float(b) / float(d))
    quotients = (counts * a + b).astype(np.float64) / float(d)
    if rule == QUOTIENT:
        return np.asarray(quotients)
    distinct, places = np.unique(counts, return_inverse=True)
    return many_in_digits(distinct * a + b, d, digits)[places]


def predictions(
    quotients: Doubles, c0: float, terms: Sequence[Term], columns: Sequence[Doubles]
) -> Doubles:
    """What a linear rule gives where all exact values are known; ``quotients``: what the counts of
    its component stand for."""
    size = quotients.size
    reach = min(max(term.lag for term in terms), size)
    total = np.full(size - reach, c0)
    with np.errstate(all="ignore"):
        for component, lag, weight in terms:
            total += weight * columns[component][reach - lag : size - lag]
    return np.concatenate(
        (quotients[:reach], np.where(np.isfinite(total), total + 0.0, quotients[reach:]))
    )


def linear_values(
    quotients: Doubles,
    c0: float,
    terms: Sequence[Term],
    columns: Sequence[Doubles],
    moves: Counts,
    own: int,
) -> Doubles:
    """The exact values of component ``own`` by its linear rule. ``quotients``: what its counts
    stand for; ``columns``: the exact values of those that are decoded before it; ``moves``: the
    places by which each value is corrected."""
    if all(term.component != own for term in terms):
        return by_places(predictions(quotients, c0, terms, columns), moves)
    # Views give Python's numbers one by one; lists would hold an object for each sample.
    found = np.empty(quotients.size)
    out: Any = found.data
    bits: Any = found.view(np.int64).data
    known: list[Any] = [out if place == own else x.data for place, x in enumerate(columns)]
    rows = [(known[term.component], term.lag, term.weight) for term in terms]
    reach = max(term.lag for term in terms)
    given: Any = zip(quotients.data, moves.data, strict=True)
    for t, (quotient, move) in enumerate(given):
        v = quotient
        if t >= reach:
            v = c0
            for x, lag, weight in rows:
                v += weight * x[t - lag]
        v = v + 0.0 if isfinite(v) else quotient
        out[t] = v
        if move:
            # NaN with its bits.
            bits[t] = bits_at(place_of(v) + move)
    return found


def place_of(double: float) -> int:
    """Its place in the order of doubles."""
    (bits,) = BITS.unpack(DOUBLE.pack(double))
    return int(bits if bits >= 0 else ~(bits & LAST_PLACE))


def bits_at(place: int) -> int:
    """The bits of the double at a place modulo 2^64."""
    place = (place + HALF) % (2 * HALF) - HALF
    return place if place >= 0 else ~place - HALF


def many_in_places(numerators: Counts, d: int, places: int) -> Doubles:
    """``in_places`` of each numerator, none of them 0, at once where 64 bits hold it."""
    power, largest = 10**places, int(np.abs(numerators).max())
    if largest * power >= WIDE or 2 * d >= WIDE:
        slowly = (in_places(n, d, places) for n in numerators.data)
        return np.fromiter(slowly, np.float64, numerators.size)
    whole, rest = np.divmod(np.abs(numerators) * power, d)
    whole += (2 * rest > d) | ((2 * rest == d) & (whole % 2 == 1))
    # A quotient of two doubles is correctly rounded, these being integers below 2^53 and powers
    # of ten up to 10^22.
    return np.asarray(np.sign(numerators) * whole / float(power))


def many_in_digits(numerators: Counts, d: int, digits: int) -> Doubles:
    """``in_digits`` of each numerator, those with the same number of places at once."""
    n = np.abs(numerators)
    table = np.zeros(n.size)
    # n / d >= 10^power where n >= d * 10^power: powers at which another digit begins.
    powers = range(-len(str(d)), 18)
    starts = [-(-d // 10**-power) if power < 0 else d * 10**power for power in powers]
    starts = [min(start, WIDE) for start in starts]
    classes = np.searchsorted(np.array(starts, np.int64), n, side="right") - 1
    for at in np.unique(classes[n > 0]).tolist():
        places = min(digits - 1 - powers[at], PLACES_LIMIT)
        here = (classes == at) & (n > 0)
        if places >= 0:
            table[here] = many_in_places(numerators[here], d, places)
        else:
            unit = 10**-places
            table[here] = many_in_places(numerators[here], d * unit, 0) * float(unit)
    return table


def in_places(numerator: int, d: int, places: int) -> float:
    """numerator / d with so many decimals, ties to even, of at most 15 digits; as a double."""
    whole, rest = divmod(abs(numerator) * 10**places, d)
    whole += 2 * rest > d or (2 * rest == d and whole % 2)
    # A quotient of integers is correctly rounded in Python, whatever their size.
    return float((whole if numerator > 0 else -whole) / 10**places)


def in_digits(numerator: int, d: int, digits: int) -> float:
    """numerator / d with so many significant digits, ties to even; as a double."""
    if not numerator:
        return 0.0
    n = abs(numerator)
    # 10^power <= n / d < 10^(power + 1)
    power = len(str(n)) - len(str(d))
    if n * 10 ** max(-power, 0) < d * 10 ** max(power, 0):
        power -= 1
    places = min(digits - 1 - power, PLACES_LIMIT)
    if places >= 0:
        return in_places(numerator, d, places)
    unit = 10**-places
    return float(in_places(numerator, d * unit, 0) * unit)


LARGEST = np.int64((1 << 63) - 1)


def ordered(doubles: Doubles) -> Counts:
    """Bit patterns as signed integers that grow with the value; -0.0 is -1, 0.0 is 0."""
    bits = np.ascontiguousarray(doubles, "<f8").view(np.int64)
    return np.where(bits < 0, ~(bits & LARGEST), bits)


def unordered(places: Counts) -> Doubles:
    """The doubles at these positions (SPEC 9.7, order)."""
    bits: NDArray[Any] = np.where(places < 0, ~places | ~LARGEST, places)
    return np.ascontiguousarray(bits, np.int64).view(np.float64)


def by_places(doubles: Doubles, moves: Counts) -> Doubles:
    """The doubles at the positions of ``doubles`` plus ``moves``, modulo 2^64."""
    if not moves.any():
        return doubles
    with np.errstate(over="ignore"):
        return unordered(ordered(doubles) + moves)
