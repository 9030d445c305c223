"""Distinct values to whole numerators over one denominator: exactly, or near by.

u is always float64 [values], sorted, distinct, finite, without -0.0, each 0 or between 2**-53 and
2**53 in magnitude. Numerators stay within 2**53. "Exactly" means that float64(numerator) /
float64(denominator) is u bit for bit.

The file also finds the greatest common step of sorted positions that are known only within
intervals. It uses Euclid's algorithm on intervals: a step in [a, b] has to divide a difference in
[l, h]. Either the step goes into it a whole number of times, or it is too coarse. Then the simplest
fraction p/q in [l/b, h/a] divides the step by q. Each step found narrows the interval, so that
longer differences can be counted. No difference needs to be the step itself: a sensor that visits
few of its codes is found as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from decimal import Decimal
from fractions import Fraction
from math import ceil, floor, frexp, gcd, lcm, ldexp, log2
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels import compiled
from ..limits import AFFINE_LIMIT, EXACT_LIMIT, LEVELS
from ..numbers import rdiv
from ..recording import Calibration

SMALLEST_COUNT, FIRST_COUNT = 256, 8
"""Smallest differences that are examined one by one. On the recordings a few settle the step.
Values without a common step are given up after about three."""

TERMS = 40
"""Bound on the terms of a fraction: two of them at least double its denominator, twice."""

STEP_ROUNDS = 128
"""Bound on passes over all positions. Each one doubles the reach or at least halves the step, and
both stay within the 53 bits of a float64."""

DENSE = 16
"""Positions that make a place dense: enough to tell a cluster from two neighbours by chance."""

CLEARANCE = 16
"""A step is at least this many noise half-widths. Below it the intervals cover 1/8 of the line and
more, so that anything fits."""

SHARED_CLEARANCE = 1000
"""The same, where several values share a count. Levels that a signal dwells on, with jitter, look
like a coarse grid (ratios up to about 100). Rounding does not (10**5 and more measured)."""

CHANCE_BITS = 24.0
"""A grid under noise must be this many bits away from chance: one wrong find in 16 million."""

ROUNDING_ULP = 4
"""Half-width in ulp of the largest value, where the values are on an exact grid. Half an ulp is for
the value, up to three for the differences and products taken of it here in float64."""


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
    found = simplest(*low.as_integer_ratio(), *high.as_integer_ratio(), low_in, high_in)
    return Fraction(*found)


def simplest(
    a: int, b: int, c: int, d: int, low_in: bool = True, high_in: bool = True
) -> tuple[int, int]:
    """The same from a/b to c/d, an interval that is not empty. Fractions take five times longer."""
    # d is 0 where there is no upper end.
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
    return n, m


def simplest_near(low: float, high: float) -> tuple[float, float]:
    """The same from low > 0 to high, about, for ends that are known by eight ulp and more; 0 where
    the interval is empty, or too far from 0 for that."""
    if not low <= high < EXACT_LIMIT:
        return 0.0, 1.0
    terms: list[float] = []
    first = float(ceil(low))
    while EXACT_LIMIT > first > high and len(terms) < TERMS:
        terms.append(first - 1)
        low, high = 1 / (high - terms[-1]), 1 / (low - terms[-1])
        first = float(ceil(low))
    n, m = first, 1.0
    for term in reversed(terms):
        n, m = term * n + m, n
    return n, m


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
    for _ in range(STEP_ROUNDS):
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
    """The step of values that are off their grid by some noise, for the smallest noise that works.

    u: float64 [values], sorted, distinct, finite, at most 2**53 in magnitude. floor: the smallest
    step that is of interest. None where no grid exists, or only one that chance would give.
    """
    if u.size < 3:
        return None
    gaps = np.diff(u)
    ordered = np.sort(gaps)
    # From the rounding of float64, doubled to where no step is left.
    noise = ROUNDING_ULP * float(np.spacing(max(-u[0], u[-1])))
    found: Steps | None = None
    while found is None and (CLEARANCE - 2) * noise <= ordered[-1]:
        found = steps_with(noise, u, gaps, ordered, floor)
        noise *= 2
    return found


def steps_with(
    noise: float,
    u: NDArray[np.float64],
    gaps: NDArray[np.float64],
    ordered: NDArray[np.float64],
    floor: float,
) -> Steps | None:
    """The same for one noise. gaps: those of u; ordered: from the smallest on."""
    inside = int(np.searchsorted(ordered, 2 * noise, side="right"))
    outside = int(np.searchsorted(ordered, (CLEARANCE - 2) * noise))
    if inside != outside or inside == ordered.size:
        return None  # some gap is neither noise nor a step
    least = max(floor, (SHARED_CLEARANCE if inside else CLEARANCE) * noise)
    # The cheap test first: it ends almost every attempt.
    for size in (FIRST_COUNT, SMALLEST_COUNT):
        few = ordered[inside : inside + size]
        if _divisor(few - 2 * noise, few + 2 * noise, least) is None:
            return None
    starts = np.concatenate(([0], np.flatnonzero(gaps > 2 * noise) + 1))
    ends = np.concatenate((starts[1:], [u.size])) - 1
    if (u[ends] - u[starts] > 2 * noise).any():
        return None
    found = common_step(u[ends] - noise, u[starts] + noise, least)
    if found is None:
        return None
    low, high, index = found
    clear = (starts.size - 2) * log2(low / (2 * noise)) - 2 * log2(float(ordered[inside]) / low)
    if clear < CHANCE_BITS:
        return None
    return Steps(low, high, np.repeat(index, ends - starts + 1), noise)


def _shortest(
    least: NDArray[np.float64], most: NDArray[np.float64], floor: float
) -> tuple[float, float] | None:
    """The common step of the shortest of the differences in [least, most]."""
    order = np.arange(least.size)
    if order.size > SMALLEST_COUNT:
        order = np.argpartition(least, SMALLEST_COUNT)[:SMALLEST_COUNT]
    order = order[np.argsort(least[order], kind="stable")]
    return _divisor(least[order], most[order], floor)


def _divisor(
    least: NDArray[np.float64], most: NDArray[np.float64], floor: float
) -> tuple[float, float] | None:
    """The common step of differences in [least, most], in this order."""
    if compiled is not None:
        least, most = np.ascontiguousarray(least), np.ascontiguousarray(most)
        return compiled.common_divisor(least, most, floor)
    lows, highs = least.tolist(), most.tolist()
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
    p, q = simplest_near(low / b, high / a)
    if not p:
        return None
    a, b = sorted((max(a / q, low / p), min(b / q, high / p)))
    return (a, b) if b >= floor else None


PLACES = 15
"""10**15 is the last power of ten below 2**53."""

LONE_STEP = 1 << 31
"""A of a constant whose numerator is too large for B: half of its bits are the count then."""

PROBES = 64
"""Values that have to pass before all are looked at."""

SMALL = 1 << 16
"""Denominators that are tried one by one, in a millisecond: those of sensors with up to 16 bits."""

WITNESSES = 128
"""Exact bounds added per round of the search for A/D: one round costs about a millisecond."""

ROUNDS = 32
"""Each round leaves about 1 in WITNESSES of the values wrong, so that 5 do for 2**32 of them; the
rest is for what is not evenly spread."""

HALVINGS = 16
"""How often the step's interval is halved. It is a few times wider than the noise requires."""


class Ratio(NamedTuple):
    """Values = numerators / denominator; numerators int64 [values], sorted; how: for the user.

    lone_step: A, where all numerators are the same.
    """

    numerators: NDArray[np.int64]
    denominator: int
    how: str
    lone_step: int = 1


class CalibratedCounts(NamedTuple):
    """Values = calibration of counts; counts int64 [values], sorted; how: as in the Ratio."""

    calibration: Calibration
    counts: NDArray[np.int64]
    how: str


def constant(u: NDArray[np.float64]) -> Ratio:
    """One value: its shortest decimal, or the simplest fraction that rounds to it."""
    value = float(u[0])
    shortest = Decimal(repr(value)).normalize()
    places = max(0, -int(shortest.as_tuple().exponent))
    numerator = int(shortest.scaleb(places))
    denominator = 10**places
    if places > PLACES or abs(numerator) > EXACT_LIMIT:
        ratio = shortest_fraction(abs(value))
        numerator, denominator = ratio.as_integer_ratio()
        numerator *= -1 if value < 0 else 1
    step = 1 if abs(numerator) < AFFINE_LIMIT else LONE_STEP
    return Ratio(np.array([numerator]), denominator, "constant", step)


def dyadic(u: NDArray[np.float64]) -> Ratio | None:
    """Exactly, over the smallest power of two; integers have 1."""
    mantissa, exponent = np.frexp(u[u != 0])
    bits = np.ldexp(mantissa, 53).astype(np.int64)
    lowest = np.frexp((bits & -bits).astype(np.float64))[1] - 1
    shift = max(0, -int((exponent - 53 + lowest).min(initial=0)))
    if shift > 53:
        return None
    n = np.ldexp(u, shift)
    if max(-n[0], n[-1]) > EXACT_LIMIT:
        return None
    return Ratio(n.astype(np.int64), 1 << shift, "binary fractions" if shift else "integers")


def decimal(u: NDArray[np.float64]) -> Ratio | None:
    """Exactly, with the fewest decimal places."""
    probes = u[:: max(1, u.size // PROBES)]
    # The shortest text of a double tells how many places it needs at least.
    texts = (Decimal(repr(value)) for value in probes[:: PROBES // 8].tolist())
    least = max(-int(text.normalize().as_tuple().exponent) for text in texts)
    for places in range(max(least, 1), PLACES + 1):
        if max(-u[0], u[-1]) * 10.0**places > EXACT_LIMIT:
            return None
        if _over(probes, 10**places) is not None:
            n = _over(u, 10**places)
            if n is not None:
                return Ratio(n, 10**places, f"decimals with {places} places")
    return None


def small_denominator(u: NDArray[np.float64]) -> Ratio | None:
    """Exactly, over the smallest denominator, with any offset.

    Every value has a simplest fraction. Another fraction with a small denominator can be the same
    value only if it is an equal one, unless the value is large. So all of them share a multiple of
    their denominators.
    """
    d, most = 1, min(SMALL, EXACT_LIMIT / max(-u[0], u[-1]))
    probes = u[u.size // 2 :: max(1, u.size // PROBES)]
    while d <= most:
        missed = probes[np.rint(probes * d) / d != probes]
        if not missed.size:
            n = _over(u, d)
            if n is not None:
                return Ratio(n, d, "a common denominator")
            missed = u[np.rint(u * d) / d != u]
            if not missed.size:
                return None
        before, d = d, lcm(d, shortest_fraction(abs(float(missed[0]))).denominator)
        if d == before:
            return None
    return None


def stepped(u: NDArray[np.float64], least: float) -> Ratio | None:
    """Exactly, as multiples of a common step of at least ``least``, with any offset.

    It finds steps above 64 ulp of the largest value. Where the offset is a whole number of steps,
    or a simple fraction of one, it takes the simplest A/D. If it finds none, none is within 2**53.
    That happens to about a third of channels made as count * step (measured). There, products
    halfway between two float64 values allow only the original step, with all its 53 bits. Other
    offsets are found if all values have about the same magnitude.
    """
    rounding = ROUNDING_ULP * float(np.spacing(max(-u[0], u[-1])))
    found = common_step(u - rounding, u + rounding, max(least, CLEARANCE * rounding))
    if found is None:
        return None
    steps = Steps(*found, rounding)
    indices = _indices(u, u, steps)
    if indices is not None and (np.sign(indices) == np.sign(u)).all():
        ratio = _witnessed(u, indices)
        if ratio is not None:
            return ratio
    # Any number less than half an ulp away rounds to the value; 0.49 leaves room for the search.
    ratio = next(fitted_all(u, steps, [0.49 * float(np.spacing(np.abs(u).min()))]))
    return ratio if ratio is not None and _gives(ratio, u) else None


def near_all(
    u: NDArray[np.float64], steps: Steps, noises: Sequence[float]
) -> Iterator[Ratio | None]:
    """The simplest step that brings all values within each noise, with the offset a fraction of it.

    steps: of these values, as found by ``near_steps``. None where no such offset does.
    """
    indices = _indices(u - steps.noise, u + steps.noise, steps)
    if indices is None:
        return
    away = indices != 0
    times = np.abs(indices[away]).astype(np.float64)
    size = np.where(indices > 0, u, -u)[away]
    for noise in noises:
        low, high = float(((size - noise) / times).max()), float(((size + noise) / times).min())
        step = simplest_fraction(Fraction(low), Fraction(high)) if low > 0 else None
        yield None if step is None else _scaled(indices, step, "a common step")


def fitted_all(
    u: NDArray[np.float64], steps: Steps, noises: Sequence[float]
) -> Iterator[Ratio | None]:
    """The same with any offset: within each noise, or as near to that as a straight line gets."""
    centre = u.size // 2
    index = steps.indices - steps.indices[centre]
    times = index.astype(np.float64)
    # From the centre the differences are exact, or small against the noise.
    v = u - u[centre]

    def spread(step: float) -> float:
        rest = v - times * step
        return float(rest.max() - rest.min())

    # Where it is smallest, by thirds: it is convex.
    low, high = steps.low, steps.high
    for _ in range(HALVINGS):
        a, b = low + (high - low) / 3, high - (high - low) / 3
        if spread(a) <= spread(b):
            high = b
        else:
            low = a
    best = low / 2 + high / 2
    middle, least = Fraction(float(u[centre])), spread(best)
    for noise in noises:
        allowed = max(2 * noise, least)
        ends = []
        for end in (steps.low, steps.high):
            # The last step from the best towards the end that still allows it.
            outside, inside = end, end if spread(end) <= allowed else best
            for _ in range(HALVINGS if inside != outside else 0):
                middle_step = inside / 2 + outside / 2
                if spread(middle_step) <= allowed:
                    inside = middle_step
                else:
                    outside = middle_step
            ends.append(Fraction(inside))
        a, d = _simplest_between(*ends).as_integer_ratio()
        rest = v - times * (a / d)
        low, high = float(rest.max()) - allowed / 2, float(rest.min()) + allowed / 2
        offset = _simplest_between(d * (middle + Fraction(low)), d * (middle + Fraction(high)))
        b, finer = offset.as_integer_ratio()
        reach = max(-int(index[0]), int(index[-1])) * a * finer + abs(b)
        # Twice, for the two ends of a numerator that may have opposite signs; place() knows better.
        if reach > 2 * EXACT_LIMIT or d * finer > EXACT_LIMIT:
            yield None
        else:
            yield Ratio(index * (a * finer) + b, d * finer, "a common step with an offset")


def on_grid(u: NDArray[np.float64], step: Fraction, how: str) -> Ratio | None:
    """The nearest multiples of the step; u may be nearer to 0 than 2**-53."""
    a, d = step.as_integer_ratio()
    if max(a, d) > EXACT_LIMIT or max(-u[0], u[-1]) * d > EXACT_LIMIT:
        return None
    count = np.rint(u * float(d) / float(a)).astype(np.int64)
    return Ratio(count * a, d, how, a)


def place(ratio: Ratio, bits: int) -> CalibratedCounts | None:
    """Numerators to counts of at most ``bits`` bits, signed and symmetrical; None where too many.

    A is the largest step of all numerators. B brings the counts to the bits of level 1: the
    smallest B, or else the roundest. If there is none, B brings them to ``bits``.
    """
    n, d, how, lone_step = ratio
    first, last = int(n[0]), int(n[-1])
    step = int(np.gcd.reduce(np.diff(n))) if last > first else lone_step
    phase = first % step
    common = gcd(step, phase, d)
    if max(-first, last) > EXACT_LIMIT or d // common >= EXACT_LIMIT:
        return None
    if step // common >= AFFINE_LIMIT:
        return None
    if 2 * phase > step:
        phase -= step
    low, high = (first - phase) // step, (last - phase) // step
    # What is taken from the counts: nothing, or their middle, the roundest first.
    powers = range(len(str(max(-low, high))) - 1, -1, -1)
    shifts = [0, *(rdiv((low + high) // 2, 10**power) * 10**power for power in powers)]
    for width in sorted({min(bits, LEVELS[1].count_bits), bits}):
        limit = (1 << (width - 1)) - 1
        for shift in shifts:
            b = phase + shift * step
            reach = max(shift - low, high - shift)
            offset = b // common
            fits = max(reach * (step // common), abs(b)) <= EXACT_LIMIT
            if reach <= limit and fits and abs(offset) < AFFINE_LIMIT:
                calibration = Calibration(step // common, offset, d // common)
                return CalibratedCounts(calibration, (n - b) // step, how)
    return None


def shortest_fraction(value: float) -> Fraction:
    """The simplest fraction that rounds to ``value`` > 0 in float64."""
    low, high, q, closed = _rounding_interval(value)
    return Fraction(*simplest(low, q, high, q, closed, closed))


def _simplest_between(one: Fraction, other: Fraction) -> Fraction:
    """The simplest fraction from one to the other, of any sign and in any order."""
    low, high = sorted((one, other))
    if low <= 0 <= high:
        return Fraction(0)
    found = simplest_fraction(low, high) if low > 0 else simplest_fraction(-high, -low)
    assert found is not None  # low <= high
    return found if low > 0 else -found


def _indices(
    low: NDArray[np.float64], high: NDArray[np.float64], steps: Steps
) -> NDArray[np.int64] | None:
    """Multiples of one step counted from the physical 0: int64 [values], or None past 2**53.

    The value nearest to 0 tells the offset as p/q of a step; q > 1 divides the step by q.
    """
    at = int(np.argmin(np.abs(low + high)))
    least, most = Fraction(float(low[at])), Fraction(float(high[at]))
    a, b = Fraction(steps.low), Fraction(steps.high)
    offsets = [value / step for value in (least, most) for step in (a, b)]
    first, last = min(offsets), max(offsets)
    if first == last:
        # The value is known exactly, and the step as well: leave room for their own rounding.
        first, last = first - abs(first) / EXACT_LIMIT, last + abs(last) / EXACT_LIMIT
    whole = floor(first)
    offset = simplest_fraction(first - whole, last - whole)
    assert offset is not None  # first <= last
    p, q = (offset + whole).as_integer_ratio()
    reach = q * int(steps.indices[-1]) + abs(p)
    if reach > EXACT_LIMIT:
        return None
    indices: NDArray[np.int64] = q * (steps.indices - steps.indices[at]) + p
    return indices


def _witnessed(u: NDArray[np.float64], indices: NDArray[np.int64]) -> Ratio | None:
    """The simplest A/D with u = indices * A/D for all values, from bounds of a few of them.

    A value that the simplest step so far does not give adds its own exact bounds.
    """
    # Each bound is p / q. Comparing products takes a tenth of what fractions take.
    low, high = (0, 1), (EXACT_LIMIT, 1)
    low_in = high_in = True
    witnesses = np.unique(np.linspace(0, u.size - 1, min(u.size, WITNESSES)).astype(np.int64))
    for _ in range(ROUNDS):
        for at in witnesses.tolist():
            if indices[at] == 0:
                continue
            least, most, q, closed = _rounding_interval(abs(float(u[at])))
            q *= abs(int(indices[at]))
            away = least * low[1] - low[0] * q
            if away >= 0:
                low_in = closed and (away > 0 or low_in)
                low = least, q
            away = high[0] * q - most * high[1]
            if away >= 0:
                high_in = closed and (away > 0 or high_in)
                high = most, q
        step = simplest_fraction(Fraction(*low), Fraction(*high), low_in, high_in)
        ratio = None if step is None else _scaled(indices, step, "a common step")
        if ratio is None:
            return None  # steps only get less simple from here
        missed = np.flatnonzero(_values(ratio) != u)
        if not missed.size:
            return ratio
        witnesses = missed[:: max(1, missed.size // WITNESSES)]
    return None


def _scaled(indices: NDArray[np.int64], step: Fraction, how: str) -> Ratio | None:
    reach = max(-int(indices[0]), int(indices[-1]))
    if reach * step.numerator > EXACT_LIMIT or step.denominator > EXACT_LIMIT:
        return None
    return Ratio(indices * step.numerator, step.denominator, how)


def _gives(ratio: Ratio, u: NDArray[np.float64]) -> bool:
    return np.array_equal(_values(ratio), u)


def _values(ratio: Ratio) -> NDArray[np.float64]:
    return ratio.numerators.astype(np.float64) / float(ratio.denominator)


def _over(u: NDArray[np.float64], denominator: int) -> NDArray[np.int64] | None:
    """Numerators over ``denominator`` that give u exactly."""
    n = np.rint(u * float(denominator))
    # The product is rounded too: near 2**53 the numerator can be one off.
    n += np.sign(u - n / float(denominator))
    numerators: NDArray[np.int64] = n.astype(np.int64)
    return numerators if np.array_equal(n / float(denominator), u) else None


def _rounding_interval(value: float) -> tuple[int, int, int, bool]:
    """p, q, d: the reals from p / d to q / d round to ``value`` > 0 in float64; and whether the
    ends do."""
    fraction, exponent = frexp(value)
    # Below a power of two doubles are twice as dense.
    whole, shift = int(ldexp(fraction, 53)), 55 - exponent
    p, q = 4 * whole - (1 if whole == 1 << 52 else 2), 4 * whole + 2
    if shift < 0:
        p, q, shift = p << -shift, q << -shift, 0
    return p, q, 1 << shift, whole % 2 == 0
