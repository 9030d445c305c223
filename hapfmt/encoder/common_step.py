"""The greatest common step of sorted positions that are known only within intervals.

Euclid's algorithm on intervals: a step in [a, b] that has to divide a difference in [l, h] either
goes into it a whole number of times, or the simplest fraction p/q in [l/b, h/a] divides the step by
q. Every step found narrows the interval, so that longer differences can be counted. No difference
needs to be the step itself: a sensor that visits few of its codes is found as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from math import log2
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SMALLEST_COUNT = 256
"""Smallest differences that are looked at one by one. On the recordings the step is settled after
a few; true doubles are given up after about three."""

ROUNDS = 128
"""Bound on passes over all positions. Each one doubles the reach or at least halves the step, and
both stay within the 53 bits of a float64."""

DENSE = 16
"""Positions that make a place dense: enough to tell a cluster from two neighbours by chance."""

CLEARANCE = 16
"""A step is at least this many noise half-widths. Below it the intervals cover 1/8 of the line and
more, so that anything fits."""

SHARED_CLEARANCE = 1000
"""The same, where several values share a count: levels that a signal dwells on and jitters about
look like a coarse lattice (ratios up to about 100), rounding does not (10**5 and more measured)."""

CHANCE_BITS = 24.0
"""A lattice under noise must be this many bits away from chance: one wrong find in 16 million."""

ROUNDING_ULP = 4
"""Half-width in ulp of the largest value, where the values are on an exact lattice: half for the
value, and up to three for the differences and products taken of it here in float64."""


class Steps(NamedTuple):
    """Positions p[j] = p[0] + indices[j] * step, with low <= step <= high.

    indices: int64 [positions], sorted, first 0, together without a common factor. noise: half-width
    of the intervals that the positions were given with.
    """

    low: float
    high: float
    indices: NDArray[np.int64]
    noise: float


def simplest_fraction(
    low: Fraction, high: Fraction, low_in: bool = True, high_in: bool = True
) -> Fraction | None:
    """The fraction with the smallest denominator (and numerator) from ``low`` to ``high`` >= 0.

    ``low_in`` and ``high_in`` tell whether the ends belong to the interval. None where it is empty.
    It is the first node of the Stern-Brocot tree inside the interval, walked down by whole runs
    (continued fractions).
    """
    if low > high or (low == high and not (low_in and high_in)):
        return None
    # From a/b to c/d; d is 0 where there is no upper end. Fractions take five times as long.
    (a, b), (c, d) = low.as_integer_ratio(), high.as_integer_ratio()
    terms: list[int] = []
    while True:
        first = -(-a // b) + (1 if not low_in and a % b == 0 else 0)
        if not d or first * d < c or (first * d == c and high_in):
            break
        whole = first - 1
        terms.append(whole)
        a, b, c, d = d, c - whole * d, b, a - whole * b
        low_in, high_in = high_in, low_in
    n, m = first, 1
    for term in reversed(terms):
        n, m = term * n + m, n
    return Fraction(n, m)


def common_step(
    low: NDArray[np.float64], high: NDArray[np.float64], floor: float
) -> tuple[float, float, NDArray[np.int64]] | None:
    """The largest step with all positions on p[0] + step * integers, or None.

    low, high: float64 [positions >= 2], low[j] <= p[j] <= high[j], sorted and disjoint. floor: the
    smallest step that is of interest. Returns the ends of the step's interval, and the integers.
    """
    step = _shortest(low[1:] - high[:-1], high[1:] - low[:-1], floor)
    # Distances from the densest place, as sensors have it near rest: from an outlier, the first
    # one may be longer than the step can count yet.
    window = min(DENSE, low.size - 1)
    start = int(np.argmin(low[window:] - low[:-window])) + window // 2
    least = np.concatenate((low[start] - high[:start], low[start + 1 :] - high[start]))
    most = np.concatenate((high[start] - low[:start], high[start + 1 :] - low[start]))
    order = np.argsort(least, kind="stable")
    least, most = least[order], most[order]
    middle = least / 2 + most / 2
    counted = 0
    for _ in range(ROUNDS):
        if step is None:
            return None
        a, b = step
        mean = a / 2 + b / 2
        # A count is certain while the width of the step adds up to less than half a step; where no
        # further position is as near as that, the next one takes its nearest integer.
        reach = mean * (a / (4 * (b - a)) if b > a else float(1 << 53))
        stop = max(int(np.searchsorted(middle, reach, side="right")), counted + 1)
        count = np.maximum(np.rint(middle[:stop] / mean), 1.0)
        wrong = (least[:stop] > count * b) | (most[:stop] < count * a)
        if wrong.any():
            at = int(np.argmax(wrong))
            step, counted = _divide(a, b, float(least[at]), float(most[at]), floor), 0
            continue
        a = max(a, float((least[:stop] / count).max()))
        b = min(b, float((most[:stop] / count).min()))
        if a > b:
            return None
        step, counted = (a, b), count.size
        if counted == middle.size:
            index = np.empty(middle.size, np.int64)
            index[order] = count.astype(np.int64)
            index[:start] *= -1
            index = np.insert(index, start, 0)
            return a, b, index - index[0]
    return None


def near_steps(u: NDArray[np.float64], floor: float) -> Steps | None:
    """The step of values that miss their lattice by some noise, for the smallest noise that works.

    u: float64 [values], sorted, distinct, finite, at most 2**53 in magnitude. floor: the smallest
    step that is of interest. None where there is no lattice, or none that chance would not give.
    """
    if u.size < 3:
        return None
    gaps = np.diff(u)
    ordered = np.sort(gaps)
    for noise in _noises(u, ordered):
        inside = int(np.searchsorted(ordered, 2 * noise, side="right"))
        outside = int(np.searchsorted(ordered, (CLEARANCE - 2) * noise))
        if inside != outside or inside == ordered.size:
            continue  # some gap is neither noise nor a step
        least = max(floor, (SHARED_CLEARANCE if inside else CLEARANCE) * noise)
        # The cheap test first: it ends almost every attempt.
        few = ordered[inside : inside + SMALLEST_COUNT]
        if _shortest(few - 2 * noise, few + 2 * noise, least) is None:
            continue
        starts = np.concatenate(([0], np.flatnonzero(gaps > 2 * noise) + 1))
        ends = np.concatenate((starts[1:], [u.size])) - 1
        if (u[ends] - u[starts] > 2 * noise).any():
            continue
        found = common_step(u[ends] - noise, u[starts] + noise, least)
        if found is None:
            continue
        low, high, index = found
        clear = (starts.size - 2) * log2(low / (2 * noise)) - 2 * log2(float(ordered[inside]) / low)
        if clear >= CHANCE_BITS:
            return Steps(low, high, np.repeat(index, ends - starts + 1), noise)
    return None


def exact_steps(u: NDArray[np.float64], floor: float) -> Steps | None:
    """The step of values that may lie on a lattice but for the rounding to float64.

    u: as in :func:`near_steps`, at least two.
    """
    noise = ROUNDING_ULP * float(np.spacing(max(-u[0], u[-1])))
    found = common_step(u - noise, u + noise, max(floor, CLEARANCE * noise))
    return None if found is None else Steps(*found, noise)


def _noises(u: NDArray[np.float64], ordered: NDArray[np.float64]) -> Iterator[float]:
    """Half-widths to try: doubling from the rounding of float64 to where no step is left."""
    noise = ROUNDING_ULP * float(np.spacing(max(-u[0], u[-1])))
    while (CLEARANCE - 2) * noise <= ordered[-1]:
        yield noise
        noise *= 2


def _shortest(
    least: NDArray[np.float64], most: NDArray[np.float64], floor: float
) -> tuple[float, float] | None:
    """The common step of the shortest of the differences in [least, most]."""
    order = np.arange(least.size)
    if order.size > SMALLEST_COUNT:
        order = np.argpartition(least, SMALLEST_COUNT)[:SMALLEST_COUNT]
    order = order[np.argsort(least[order], kind="stable")]
    lows, highs = least[order].tolist(), most[order].tolist()
    a, b = lows[0], highs[0]
    for low, high in zip(lows, highs, strict=True):
        if a <= 0 or b < floor:
            return None
        # Nearly always the first case of _divide; the call takes longer than the rest.
        times = round((low + high) / (a + b))
        if times >= 1 and low <= times * b and high >= times * a:
            shortest, longest = low / times, high / times
            a = shortest if shortest > a else a
            b = longest if longest < b else b
            continue
        step = _divide(a, b, low, high, floor)
        if step is None:
            return None
        a, b = step
    return a, b


def _divide(
    a: float, b: float, low: float, high: float, floor: float
) -> tuple[float, float] | None:
    """The step in [a, b] made to divide a difference in [low, high]; None below ``floor``."""
    times = round((low + high) / (a + b))
    if times >= 1 and low <= times * b and high >= times * a:
        return max(a, low / times), min(b, high / times)
    ratio = simplest_fraction(Fraction(low) / Fraction(b), Fraction(high) / Fraction(a))
    if not ratio:
        return None
    p, q = ratio.numerator, ratio.denominator
    a, b = sorted((max(a / q, low / p), min(b / q, high / p)))
    return (a, b) if b >= floor else None
