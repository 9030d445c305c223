"""Floating point channels without a common step, stored bit for bit (SPEC 9.7).

LPCX stores counts on a grid, with corrections that give the exact values. Two kinds of grid are
tried: a natural grid with small deviations, with the rule that leaves the shortest corrections; and
a binary grid as fine as level 1 allows. The encoder keeps the smaller.

Channels that fit no grid become one RAWB track of words.

Other channels are linear in channels before them, sample by sample (LPCX, rule 4): equal, scaled,
or filtered by a logger. Loggers often store a signal and its filtered form. The second takes 53 new
bits a sample, which no predictor of integers finds. It takes almost none where its filter is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import frexp, inf, log
from typing import Any, NamedTuple

import numpy as np

from ..codecs.exact import (
    COEFFICIENT_LIMIT,
    CUBIC,
    DECIMALS,
    DIGITS_LIMIT,
    LINEAR,
    PRODUCT,
    QUOTIENT,
    SIGNIFICANT,
    Counts,
    Doubles,
    ExactParameters,
    Lacking,
    LinearTerm,
    corrections_of,
    lacking_of,
    ordered,
    predictions,
)
from ..codecs.predicted import join_components
from ..codecs.raw import APART, RawParameters, encode_raw, repeats
from ..format.cluster import Packet
from ..format.track import Affine
from ..limits import AFFINE_LIMIT, EXACT_LIMIT, LEVELS
from ..numbers import build_varint, parse_varint
from ..recording import Calibration, Channel, Span
from .effort import EFFORTS, Effort
from .knots import Coded
from .lattice import Lattice, LatticeSearch, nearest_within
from .lengths import bits_of, pieces_of
from .predict import encode_best, fitting_packets
from .source import declared_range, make_track
from .unit import Unit, decode_all

GRID_BITS = LEVELS[1].count_bits - 1
"""Bits of the range of a binary grid. A finer grid predicts better but needs longer counts (0.1 b/s
at most on the recordings, either way)."""

TEXTS = 512
"""About as many distinct values have their digits examined (fewer than twice as many)."""

CHEAP = 4
"""Bits a sample: a grid SPARSE times finer than the natural one costs at least as much."""

FINE = 16
"""A binary grid takes more bits a sample than this, with few exceptions."""

SMALLER, SMALLER_SHORT, LONGER, SHORT_OF = 0.98, 0.94, 1.03, 1.045
"""Words that are estimated to take less than this share of a binary grid are smaller. Short packets
take LONGER words (1.00 to 1.07 measured where they do not repeat). The estimate of a binary grid is
multiplied by SHORT_OF (1.01 to 1.08 measured)."""

RECALLED, SELDOM, RARE = 1024, 20, 2000
"""Samples that tell whether counts repeat, half of them neighbours: in one of 20 at least. Fewer
corrections than one in 2000 samples take less than a hundredth of a bit."""

SURE, ROUNDED = 0.02, 0.4
"""Bits of a correction of one distinct value: a rule that leaves fewer is that of the logger. One
that leaves more may be followed by a polynomial, or by decimals."""

GAINS, ULPS, FIRST_OFFSETS, GAINED = 64, 16, 8, 2048
"""Gains that are tried on either side of the step at most; it is known by 16 ulp of the values. One
of 8 values rules most of them out. Samples that an offset must suit."""

SHIFTED, OFFSETS, OFFSET_UNIT, OFFSET_NEAR = 4096, 3, 1e-7, 1e-5
"""Most steps of an offset; how many offsets are tried, those with seven decimals: an offset is
known by more digits."""

TRIALS, FITTED_LINE = 512, 8192
"""Distinct values that a polynomial is fitted to, and samples that a line is."""

FITTED, SLOPES = 12, 3
"""Fewest distinct values that a polynomial is fitted to; and how many slopes are tried on either
side of the fitted one. The fitted slope has the error of the samples, which are rounded."""


@dataclass(frozen=True)
class Candidate:
    """Counts [samples] and the rule that makes doubles of them."""

    calibration: Calibration
    counts: Counts
    parameters: ExactParameters
    how: str

    @property
    def described(self) -> int:
        """Bits of coefficients that are not 0."""
        return 64 * int(np.count_nonzero(self.parameters.coefficients))

    @property
    def affine(self) -> Affine:
        return Affine(self.calibration.a, self.calibration.b, self.calibration.d)


class Beside(NamedTuple):
    """A unit with exact values, and how many bytes these take."""

    unit: Unit
    size: int


def encode_doubles(
    channel: Channel,
    spans: Sequence[Span],
    first_channel: int,
    otherwise: Callable[[], Unit],
    search: LatticeSearch,
    *,
    exact: Lattice | None = None,
    grid: bool = True,
    effort: Effort | None = None,
) -> Unit:
    """The smallest way to keep a floating point channel bit for bit: counts and exact values, or
    ``otherwise``.

    ``otherwise`` is not called where a natural grid leaves almost no corrections. Nor is it called
    where estimates tell that a binary grid is smaller. ``exact``: the grid that holds the values
    exactly, if one exists. ``grid``: whether to try a binary grid; ``otherwise`` are words then.
    """
    x, effort = search.values, effort or EFFORTS["default"]
    if not x.size or not search.facts.finite:
        return otherwise()
    candidate = natural_candidate(search, exact, effort)
    natural = coded_as(channel, x, spans, first_channel, candidate, effort)
    search.forget()
    if natural and 8 * natural.size < CHEAP * x.size:
        return natural.unit
    units = [natural.unit] if natural else []
    if not grid:
        return min([*units, otherwise()], key=lambda unit: unit.size)
    # Estimates know nothing of values that repeat.
    part = x[middle_of(spans)]
    unknown = effort.every_form or repeats(part)
    words, surely = 0.0 if unknown else bytes_of_words(x), SMALLER
    if part.size < APART:
        words, surely = words * LONGER, SMALLER_SHORT
    if not (units and 8 * units[0].size < FINE * x.size):
        candidate = binary_grid(x)
        if candidate and (not words or words > surely * bytes_of(candidate, x)):
            found = coded_as(channel, x, spans, first_channel, candidate, effort)
            units += [found.unit] if found else []
    if not units or words < min(unit.size for unit in units):
        units.append(otherwise())
    return min(units, key=lambda unit: unit.size)


def middle_of(spans: Sequence[Span]) -> slice:
    """The samples of the span in the middle."""
    place = len(spans) // 2
    start = sum(span.ticks for span in spans[:place])
    return slice(start, start + spans[place].ticks)


def bytes_of_words(x: Doubles) -> float:
    """About how many bytes words take that do not repeat: the entropy of each byte."""
    looked = np.ascontiguousarray(pieces_of(x), "<f8").view(np.uint8).reshape(-1, x.itemsize)
    bits = 0.0
    for plane in looked.T:
        seen = np.bincount(plane)
        seen = seen[seen > 0]
        # Few samples have too little of it (G. A. Miller, 1955).
        missing = (seen.size - 1) / (2 * log(2) * plane.size)
        bits += min(float((seen * np.log2(plane.size / seen)).sum()) / plane.size + missing, 8.0)
    return bits * x.size / 8


def bytes_of(candidate: Candidate, x: Doubles) -> float:
    """About how many bytes counts with exact values take where no values repeat; 0 where that is
    not known."""
    looked: Doubles = pieces_of(x).ravel().astype(np.float64)
    counts: Counts = pieces_of(candidate.counts).astype(np.int64)
    try:
        lacking = lacking_of(looked, candidate.parameters, candidate.affine, counts.ravel())
    except ValueError:
        return 0.0
    moved = np.abs(lacking.corrections.astype(np.float64))
    bits = bits_of(counts.astype(np.float64)) + float(np.log2(1.0 + 2.0 * moved).mean())
    return SHORT_OF * bits * x.size / 8


def coded_as(
    channel: Channel,
    x: Doubles,
    spans: Sequence[Span],
    first_channel: int,
    candidate: Candidate | None,
    effort: Effort,
) -> Beside | None:
    if candidate is None:
        return None
    low, high = declared_range(candidate.counts)
    if not candidate.calibration.covers(low, high):
        low, high = int(candidate.counts.min()), int(candidate.counts.max())
    described = replace(
        channel, stored=candidate.counts, calibration=candidate.calibration, deviation=None
    )
    track = make_track(
        [described],
        first_channel,
        codec="LPCX",
        parameters=candidate.parameters.build(),
        count_min=low,
        count_max=high,
    )
    coded = Coded(track)
    at = beside = 0
    for span in spans:
        values, counts = x[at : at + span.ticks], candidate.counts[at : at + span.ticks]
        at += span.ticks

        def code(part: slice, values: Doubles = values, counts: Counts = counts) -> bytes:
            x, given = values[part], counts[part]
            lacking = lacking_of(x, candidate.parameters, candidate.affine, given)
            return beside_counts(encode_best(given, effort), lacking)

        try:
            for part, data in fitting_packets(span, counts, code):
                coded.packets.append(Packet(0, part.start, part.ticks, data))
                size, begin = parse_varint(data, 0)
                beside += len(data) - begin - size
        except ValueError:
            # Too far from its count, or counts too far from each other.
            return None
    reason = f"bit for bit: counts of {candidate.how}, and {beside} bytes of exact values"
    return Beside(Unit(coded, None, "predicted + exact", reason, exact=True), beside)


def natural_candidate(
    search: LatticeSearch, exact: Lattice | None, effort: Effort
) -> Candidate | None:
    """The natural grid and the rule with the shortest corrections, by distinct values."""
    if search.has_negative_zero:
        exact = None if isinstance(search.exact, str) else search.exact
        if exact is not None:
            # Only -0.0 is off the grid.
            return Candidate(
                exact.calibration, exact.counts.astype(np.int64), ExactParameters(), exact.reason
            )
    u = search.few
    rules: list[ExactParameters] = []
    found: RuleTrial | None = None
    known: set[Calibration] = set()
    for lattice in search.natural_lattices(exact):
        if lattice.calibration in known:
            continue
        known.add(lattice.calibration)
        rules = rules or [ExactParameters(QUOTIENT), ExactParameters(PRODUCT), *printed_rule(u)]
        # Counts are sorted as u is.
        first = np.flatnonzero(np.diff(lattice.counts, prepend=lattice.counts[0] - 1))
        near = DistinctCounts(lattice.calibration, lattice.counts[first], u[first])
        for rule in rules:
            found = better(found, Candidate(near.calibration, near.counts, rule, ""), near)
        if len(known) == 1 and not (found and found.bits < SURE * near.counts.size):
            for way in gained_ways(near, search.values):
                found = better(found, way, near)
        if found and found.bits < SURE * near.counts.size + found.way.described:
            break
    if not found:
        return None
    near = found.near
    if effort.decimals and found.bits >= ROUNDED * near.counts.size:
        for way in decimal_way(near, u, search.values):
            found = better(found, way, near) or found
    if effort.polynomials and found.bits >= ROUNDED * near.counts.size:
        for way in cubic_ways(near):
            found = better(found, way, near) or found
    best = found.way
    counts, largest, _ = nearest_within(search.values, best.calibration, inf)
    how = f"step {float(best.calibration.step):.10g}{best.how}, missed by {largest:.3g} at most"
    return replace(best, counts=counts.astype(np.int64), how=how)


class DistinctCounts(NamedTuple):
    """Distinct counts, and one of the values of each."""

    calibration: Calibration
    counts: Counts
    doubles: Doubles


class RuleTrial(NamedTuple):
    """A rule, and about how many bits the corrections of some values have in all."""

    bits: float
    way: Candidate
    near: DistinctCounts


def better(found: RuleTrial | None, way: Candidate, near: DistinctCounts) -> RuleTrial | None:
    """The one with the shorter corrections."""
    rule = way.parameters
    try:
        corrections = corrections_of(near.doubles, rule.values(way.counts, way.affine))
    except ValueError:
        return found
    bits = float(np.log2(1.0 + np.abs(corrections.astype(np.float64))).sum())
    bits += way.described
    return RuleTrial(bits, way, near) if found is None or bits < found.bits else found


def gained_ways(near: DistinctCounts, x: Doubles) -> Iterator[Candidate]:
    """Counts times a gain, and an offset: as most programs do it, both numbers being doubles.

    The offset may be many steps, so that counts begin elsewhere. It is known by some ulp of the
    values, and is supposed to have few decimals."""
    calibration = near.calibration
    step, base = float(calibration.step), calibration.b / calibration.d
    shifts = np.arange(-SHIFTED, SHIFTED + 1)
    units = (base - shifts * step) / OFFSET_UNIT
    likely = shifts[np.abs(units - np.rint(units)) < OFFSET_NEAR].tolist()
    largest, extent = float(np.abs(near.doubles).max()), int(np.ptp(near.counts)) or 1
    unit = float(np.spacing(abs(step)))
    reach = np.ceil(ULPS * float(np.spacing(largest)) / extent / unit)
    reach = float(min(max(reach, ULPS), GAINS))
    gains: Doubles = step + np.arange(-reach, reach + 1) * unit
    more = np.ascontiguousarray(x[:: -(-x.size // GAINED)])
    for shift in sorted(likely, key=abs)[:OFFSETS]:
        few = gains
        for stride in (FIRST_OFFSETS, 1):
            part = slice(None, None, stride)
            few, low, high = offsets_of(near.counts[part] + shift, near.doubles[part], few)
        if few.size:
            counts = nearest_within(more, calibration, inf)[0] + np.int64(shift)
            few, low, high = offsets_of(counts, more, few)
        for gain, one, other in list(zip(few, low, high, strict=True))[few.size // 2 :][:1]:
            offset = shortest_between(float(one), float(other))
            moved = near.counts + shift
            rule = ExactParameters(CUBIC, 0, (offset, float(gain), 0.0, 0.0))
            b = calibration.b - shift * calibration.a
            if abs(b) < AFFINE_LIMIT:
                yield Candidate(Calibration(calibration.a, b, calibration.d), moved, rule, "")


def offsets_of(counts: Counts, x: Doubles, gains: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """The gains with which an offset gives all of x, and between which numbers it lies."""
    products = gains[:, None] * counts.astype(np.float64)
    rest = x - products
    back = rest - x
    missing = (x - (rest - back)) - (products + back)
    half: Doubles = np.spacing(np.abs(x)) / 2
    low = (rest + (missing - half)).max(axis=1)
    high = (rest + (missing + half)).min(axis=1)
    fits = low <= high
    return gains[fits], low[fits], high[fits]


def shortest_between(low: float, high: float) -> float:
    """The number with the fewest digits."""
    middle = low / 2 + high / 2
    if low <= 0 <= high:
        return 0.0
    texts = (f"{middle:.{digits}e}" for digits in range(17))
    return next((x for x in map(float, texts) if low <= x <= high), middle)


def cubic_ways(near: DistinctCounts) -> Iterator[Candidate]:
    """Polynomials of degree 3 through the values of their counts: what converters with a linearised
    scale give. They differ in the lowest bits of the slope."""
    if near.counts.size < FITTED:
        return
    stride = -(-near.counts.size // TRIALS)
    u, counts = near.doubles[::stride], near.counts[::stride]
    a, b, d = near.calibration.a, near.calibration.b, near.calibration.d
    # What a line leaves is small, and so are the rounding errors of a fit to that.
    # Python rounds a quotient of integers correctly.
    whole = counts.tolist()
    ratios = [x.as_integer_ratio() for x in u.tolist()]
    left = np.array(
        [(n * d - (c * a + b) * m) / (m * d) for (n, m), c in zip(ratios, whole, strict=True)]
    )
    reach = float(np.abs(counts).max())
    t = counts / reach
    slope = Fraction(float(Fraction(a, d) + Fraction(fit(t, left, (0, 1, 2, 3))[1] / reach)))
    for steps in range(-SLOPES, SLOPES + 1):
        c1 = slope + steps * Fraction(np.spacing(float(slope)).item())
        n, m = (c1 - Fraction(a, d)).as_integer_ratio()
        bent = left - np.array([n * c / m for c in whole])
        c0, c2, c3 = fit(t, bent, (0, 2, 3))
        offset = float(Fraction(b, d) + Fraction(c0))
        found = offset, float(c1), c2 / reach**2, c3 / reach**3
        if max(map(abs, found)) < COEFFICIENT_LIMIT:
            rule = ExactParameters(CUBIC, 0, found)
            yield Candidate(near.calibration, near.counts, rule, "")


def fit(t: Doubles, y: Doubles, powers: Sequence[int]) -> list[float]:
    """The coefficients of these powers of t that come nearest to y, by least squares."""
    found: list[float] = Weigher(np.stack([t**power for power in powers]))(y).tolist()
    return found


def printed_rule(u: Doubles) -> Iterator[ExactParameters]:
    """The digits that the distinct values u may have been printed with."""
    digits = 0
    for value in u[:: max(1, u.size // TEXTS)].tolist():
        text = f"{value:.{DIGITS_LIMIT - 1}e}"
        if float(text) != value:
            return
        mantissa = text.partition("e")[0]
        digits = max(digits, len(mantissa.strip("-").replace(".", "").rstrip("0")))
    if digits:
        yield ExactParameters(SIGNIFICANT, digits)


def decimals_of(u: Doubles) -> int | None:
    """How many decimals the distinct values u may have been printed with, the fewest; None where
    one has more."""
    looked = u[:: max(1, u.size // TEXTS)]
    largest = float(np.abs(looked).max())
    for decimals in range(DIGITS_LIMIT + 1):
        power = 10.0**decimals
        if largest * power >= EXACT_LIMIT:
            break
        if (np.rint(looked * power) / power == looked).all():
            return decimals
    return None


def decimal_way(near: DistinctCounts, u: Doubles, x: Doubles) -> Iterator[Candidate]:
    """The line through the values of the counts, which then are rounded to that many decimals;
    some of all samples x tell more of it than the few values u."""
    decimals = decimals_of(u)
    if decimals is None or u.size < FITTED:
        return
    a, b, d = near.calibration.a, near.calibration.b, near.calibration.d
    looked = np.ascontiguousarray(x[:: -(-x.size // FITTED_LINE)])
    counts = nearest_within(looked, near.calibration, inf)[0].astype(np.int64)
    reach = float(np.abs(counts).max()) or 1.0
    c0, c1 = fit(counts / reach, looked - near.calibration.physical(counts), (0, 1))
    slope, offset = Fraction(a, d) + Fraction(c1 / reach), Fraction(b, d) + Fraction(c0)
    most = max(-int(near.counts.min()), int(near.counts.max()), 1)
    step = slope.limit_denominator(min(int(EXACT_LIMIT / (4 * most * abs(slope))), EXACT_LIMIT - 1))
    times = max(
        min(EXACT_LIMIT // (4 * most * abs(step.numerator)), EXACT_LIMIT // step.denominator), 1
    )
    # Multiples of D bring the offset nearer.
    d = step.denominator * times
    b = round(offset * d)
    calibration = Calibration(step.numerator * times, b, d)
    if calibration.covers(int(near.counts.min()), int(near.counts.max())):
        rule = ExactParameters(SIGNIFICANT, DECIMALS + decimals)
        yield Candidate(calibration, near.counts, rule, f" with {decimals} decimals")


def binary_grid(x: Doubles, bits: int = GRID_BITS) -> Candidate | None:
    """Multiples of a power of two such that the range of x takes ``bits`` bits.

    None where they are too large for a calibration."""
    low, high = float(x.min()), float(x.max())
    power = bits - 1 - frexp(high / 2 - low / 2)[1]
    # Counts and B stay below 2^52, D below 2^53.
    reach = max(-low, high)
    power = min(power, 52, 52 - frexp(reach)[1])
    if power < 0 and reach > EXACT_LIMIT:
        return None
    scaled = np.rint(np.ldexp(x, power)).astype(np.int64)
    middle = int(np.rint(np.ldexp(low / 2 + high / 2, power)))
    if int(np.abs(scaled).max()) < 1 << bits:
        middle = 0
    counts = scaled - middle
    a, d = (1, 1 << power) if power >= 0 else (1 << -power, 1)
    if abs(middle * a) >= AFFINE_LIMIT:
        return None
    calibration = Calibration(a, middle * a, d)
    if not calibration.covers(int(counts.min()), int(counts.max())):
        return None
    return Candidate(calibration, counts, ExactParameters(), f"a binary grid of step {a / d:.6g}")


def beside_counts(coded: bytes, lacking: Lacking) -> bytes:
    """A packet of LPCX: coded counts, and the exact values that these lack."""
    return build_varint(len(coded)) + coded + smallest_exact(lacking)


def smallest_exact(lacking: Lacking) -> bytes:
    """With recall or without; with it only where counts repeat in some of the samples, and where
    corrections are not rare."""
    half, counts = RECALLED // 2, lacking.counts
    if RARE * np.count_nonzero(lacking.corrections) < counts.size:
        return lacking.build(recall=False)
    counts = np.concatenate((counts[:half], counts[half :: 1 + counts.size // half]))
    seldom = SELDOM * (counts.size - np.unique(counts).size) < counts.size
    ways = (False,) if seldom else (False, True)
    return min((lacking.build(recall=recall) for recall in ways), key=len)


WORDS_REASON = "bit for bit: no common step"


def encode_words(
    channel: Channel, spans: Sequence[Span], first_channel: int, number_format: str, reason: str
) -> Unit:
    """RAWB words, bit for bit."""
    track = make_track(
        [channel],
        first_channel,
        codec="RAWB",
        parameters=RawParameters(channel.stored.dtype.itemsize).build(),
        number_format=number_format,
    )
    coded = Coded(track)
    at = 0
    for span in spans:
        rows = channel.stored[at : at + span.ticks, None]
        coded.packets.append(
            Packet(0, span.start, span.ticks, encode_raw(rows, channel.stored.dtype.itemsize))
        )
        at += span.ticks
    return Unit(coded, None, "raw", reason, exact=True)


RUN_LIMIT = 32
"""Components of a track: one lost packet takes all of them along."""

COSTLY = 20
"""Bits a sample from which on a channel is tried as a linear one."""

HOPED = 8
"""Bits a sample that a relation has to save."""

LOOKED_AT, SETTLING = 400, 4
"""Samples in which relations are searched, and those at their start that serve as lags."""

PROBED_SAMPLES = 40
"""Samples that rule most channels out as sources."""

NEAR = 2.0**-36
"""A relation may leave this share of the largest value."""

FORMS = ((0, 0), (1, 0), (1, 1), (2, 2))
"""Lags of the channel itself and of the other one, the fewest first."""

ROUGH_GRID_BITS = 12
"""Bits of the range of the counts of a linear channel, as many as many converters have. They serve
readers that do not need exact values. The exact values do not depend on them."""

REFINED, ROUNDS = 2048, 3

DEPENDENT = 1e-14
"""A row is a sum of the rows before it if they leave this share of it or less."""


class Relation(NamedTuple):
    """How channel ``target`` follows from channel ``source``; both are places among the examined
    channels. ``bits``: size of the corrections of one sample."""

    target: int
    source: int
    c0: float
    terms: tuple[LinearTerm, ...]
    bits: float

    def moved(self, by: int) -> Relation:
        """The same among channels whose places differ by that."""
        return self.renamed(lambda place: place + by)

    def among(self, places: Sequence[int]) -> Relation:
        """The same among the channels at these places alone."""
        return self.renamed(places.index)

    def renamed(self, name: Callable[[int], int]) -> Relation:
        terms = tuple(term._replace(component=name(term.component)) for term in self.terms)
        return self._replace(target=name(self.target), source=name(self.source), terms=terms)


def find_relations(columns: Sequence[Doubles], costly: Sequence[bool]) -> list[Relation]:
    """The best of each costly channel, where one saves enough. ``columns``: of equal length, no
    number of them infinite or NaN."""
    size = columns[0].size
    found: list[Relation] = []
    if size < 2 * LOOKED_AT:
        return found
    part = slice(size // 2, size // 2 + LOOKED_AT)
    looked = [x[part] for x in columns]
    left = [place for place, each in enumerate(costly) if each]
    near = {target: sources_of(target, looked) for target in left}
    known = {place for place, each in enumerate(costly) if not each}

    def usable(target: int, linear: set[int]) -> list[int]:
        return [a for a in near[target] if a in known and (a not in linear or a < target)]

    while left:
        # Linear ones are decoded in their order.
        linear = {each.target for each in found}
        new = [
            best
            for target in left
            if (best := best_relation(target, usable(target, linear), columns)) is not None
        ]
        found += new
        # Where nothing follows from what is known, one that most others may follow from.
        root = max(left, key=lambda place: sum(place in near[each] for each in left))
        done = {each.target for each in new} or {root}
        known |= done
        left = [target for target in left if target not in done]
    return found


def sources_of(target: int, looked: Sequence[Doubles]) -> list[int]:
    """The channels that a channel is nearly linear in."""
    y = looked[target]
    if not np.ptp(y):
        return []
    limit = NEAR * float(np.abs(y).max())
    others = [source for source, x in enumerate(looked) if source != target and np.ptp(x)]
    likely = within_reach(y, [looked[source] for source in others], limit)
    return [
        source for source, possible in zip(others, likely, strict=True)
        if possible and left_by(FORMS[-1], y, looked[source]) < limit
    ]  # fmt: skip


def within_reach(y: Doubles, sources: Sequence[Doubles], limit: float) -> list[bool]:
    """For each source: False if a few samples already show an error above the limit."""
    if not sources:
        return []
    few = slice(0, PROBED_SAMPLES + SETTLING)
    # As rows_of gives them, of all sources at once.
    own, other = FORMS[-1]
    x, size = np.stack([source[few] for source in sources]), PROBED_SAMPLES + SETTLING
    rows = np.ones((len(sources), own + other + 2, PROBED_SAMPLES))
    for lag in range(1, own + 1):
        rows[:, lag - 1] = y[few][SETTLING - lag : size - lag]
    for lag in range(other + 1):
        rows[:, own + lag] = x[:, SETTLING - lag : size - lag]
    scales = np.abs(rows).max(axis=2, keepdims=True)
    scales[scales == 0] = 1
    rows /= scales
    scale = float(np.abs(y).max())
    left = np.repeat(y[few][None, SETTLING:] / scale, len(sources), axis=0)
    whole = dot(rows, rows)
    for place in range(rows.shape[1]):
        row = rows[:, place]
        energy = dot(row, row)
        row[energy <= DEPENDENT**2 * whole[:, place]] = 0
        energy[energy == 0] = 1
        shares = dot(rows[:, place + 1 :], row[:, None]) / energy[:, None]
        rows[:, place + 1 :] -= shares[:, :, None] * row[:, None]
        left -= (dot(left, row) / energy)[:, None] * row
    within: list[bool] = (np.abs(left).max(axis=1) < limit / scale * PROBED_SAMPLES**0.5).tolist()
    return within


def best_relation(
    target: int, sources: Sequence[int], columns: Sequence[Doubles]
) -> Relation | None:
    size = columns[target].size
    part = slice(size // 2, size // 2 + LOOKED_AT)
    y = columns[target][part]
    limit = NEAR * float(np.abs(y).max())
    tried: list[Relation] = []
    for source in sources:
        for form in FORMS:
            if left_by(form, y, columns[source][part]) < limit:
                tried += relations(form, target, source, columns)
            if tried and min(each.bits for each in tried) < SURE:
                return min(tried, key=lambda each: each.bits)
    best = min(tried, key=lambda each: each.bits, default=None)
    return best if best and best.bits < COSTLY - HOPED else None


def rows_of(form: tuple[int, int], y: Doubles, x: Doubles, start: int) -> Doubles:
    """[terms, samples from ``start`` on]: those that are weighed, and ones."""
    size = y.size
    rows = [y[start - lag : size - lag] for lag in range(1, form[0] + 1)]
    rows += [x[start - lag : size - lag] for lag in range(form[1] + 1)]
    return np.stack([*rows, np.ones(size - start)])


def left_by(form: tuple[int, int], y: Doubles, x: Doubles) -> float:
    """The largest error of the best weights; infinite where no file has room for these."""
    rows = rows_of(form, y, x, SETTLING)
    weights = Weigher(rows)(y[SETTLING:])
    if not (np.abs(weights) < COEFFICIENT_LIMIT).all():
        return inf
    return float(np.abs(y[SETTLING:] - weights @ rows).max())


def dot(a: Doubles, b: Doubles) -> Doubles:
    """Sums of products along the last axis. NumPy adds in the same order on all machines; einsum
    and LAPACK do not."""
    return np.asarray(np.add.reduce(a * b, axis=-1))


def exact_sum(a: Doubles, b: Doubles) -> tuple[Doubles, Doubles]:
    """The sum, and what its rounding lost (D. E. Knuth)."""
    total = a + b
    back = total - a
    return total, (a - (total - back)) + (b - back)


def exact_product(a: float, b: Doubles) -> tuple[Doubles, Doubles]:
    """The product, and what its rounding lost (T. J. Dekker, 1971)."""
    product = a * b
    (high, low), (top, rest) = halves(np.float64(a)), halves(b)
    return product, low * rest - (((product - high * top) - low * top) - high * rest)


def halves(x: Any) -> tuple[Any, Any]:
    """Two numbers of 26 bits whose sum is x."""
    moved = x * ((1 << 27) + 1)
    high = moved - (moved - x)
    return high, x - high


class Weigher:
    """Least squares by some rows, which are made orthogonal once (modified Gram-Schmidt): threads
    of a BLAS wait longer for each other than this takes."""

    def __init__(self, rows: Doubles) -> None:
        self.scales = np.abs(rows).max(axis=1)
        self.scales[self.scales == 0] = 1
        self.basis = rows / self.scales[:, None]
        self.shares = np.eye(len(rows))
        whole = dot(self.basis, self.basis)
        self.energies = np.zeros(len(rows))
        for place, row in enumerate(self.basis):
            energy = float(dot(row, row))
            if energy <= DEPENDENT**2 * whole[place]:
                row[:] = 0
                continue
            self.energies[place] = energy
            later = self.basis[place + 1 :]
            shares = dot(later, row) / energy
            later -= shares[:, None] * row
            self.shares[place, place + 1 :] = shares

    def __call__(self, y: Doubles) -> Doubles:
        """Rows that depend on those before get no weight."""
        scale = float(np.abs(y).max()) or 1.0
        left, weights = y / scale, np.zeros(len(self.basis))
        for place, (row, energy) in enumerate(zip(self.basis, self.energies, strict=True)):
            if energy:
                weights[place] = dot(row, left) / energy
                left -= weights[place] * row
        for place in range(len(weights) - 1, -1, -1):
            if self.energies[place]:
                weights[place] -= dot(self.shares[place, place + 1 :], weights[place + 1 :])
        with np.errstate(over="ignore"):
            return np.asarray(weights / self.scales * scale)


def left_after(y: Doubles, rows: Doubles, weights: Doubles, finer: Doubles) -> Doubles:
    """What the weighed rows leave of y, in twice the digits of a double; the weights are sums of
    two."""
    left, lost = y, np.zeros(y.size)
    for row, *parts in zip(rows, weights.tolist(), finer.tolist(), strict=True):
        for weight in parts:
            product, rest = exact_product(-weight, row)
            left, more = exact_sum(left, product)
            lost += rest + more
    return left + lost


def relations(
    form: tuple[int, int], target: int, source: int, columns: Sequence[Doubles]
) -> Iterator[Relation]:
    """With a constant and without."""
    y, x = columns[target], columns[source]
    some = slice(0, REFINED)
    rows, exact = rows_of(form, y[some], x[some], SETTLING), y[some][SETTLING:]
    keys = [(target, lag) for lag in range(1, form[0] + 1)]
    keys += [(source, lag) for lag in range(form[1] + 1)]
    # Products of large numbers stay finite.
    power = -frexp(max(float(np.abs(rows).max()), float(np.abs(exact).max())))[1]
    rows, exact = np.ldexp(rows, power), np.ldexp(exact, power)
    for used in (rows[:-1], rows):
        weights, finer = np.zeros(len(used)), np.zeros(len(used))
        weigh = Weigher(used)
        for _ in range(ROUNDS):
            change = weigh(left_after(exact, used, weights, finer))
            if not (np.abs(change) < COEFFICIENT_LIMIT).all():
                weights = change
                break
            weights, lost = exact_sum(weights, change)
            finer += lost
        numbers = (weights + finer).tolist()
        if not all(abs(w) < COEFFICIENT_LIMIT for w in numbers):
            continue
        c0 = numbers[-1] if len(numbers) > len(keys) else 0.0
        terms = tuple(LinearTerm(a, lag, w) for (a, lag), w in zip(keys, numbers, strict=False))
        v = predictions(y, c0, terms, columns)
        away = np.abs((ordered(y) - ordered(v)).astype(np.float64))
        yield Relation(target, source, c0, terms, float(np.log2(1 + 2 * away).mean()))


def stretches(relations: Sequence[Relation]) -> list[tuple[int, int]]:
    """The shortest runs of neighbours that no relation leaves."""
    found: list[tuple[int, int]] = []
    for relation in sorted(relations, key=lambda each: min(each.target, each.source)):
        start, stop = sorted((relation.target, relation.source))
        if found and start < found[-1][1]:
            start, stop = found[-1][0], max(found.pop()[1], stop + 1) - 1
        found.append((start, stop + 1))
    return found


def groups_of(relations: Sequence[Relation], count: int) -> list[list[int]]:
    """The places of ``count`` channels in groups that no relation leaves, by their first places."""
    group = list(range(count))
    for relation in relations:
        one, other = sorted((group[relation.target], group[relation.source]))
        group = [one if each == other else each for each in group]
    return [
        [place for place, each in enumerate(group) if each == first]
        for first in range(count)
        if group[first] == first
    ]


def encode_linear(
    channels: Sequence[Channel],
    columns: Sequence[Doubles],
    units: Sequence[Unit],
    relations: Sequence[Relation],
    numbers: Sequence[int],
    spans: Sequence[Span],
    effort: Effort,
) -> Unit | None:
    """One track of channels, in the order of their numbers; None where they have no common range
    of counts."""
    related = {relation.target: relation for relation in relations}
    candidates: list[Candidate] = []
    for place, x in enumerate(columns):
        relation = related.get(place)
        if relation is not None:
            grid = binary_grid(x, ROUGH_GRID_BITS)
            rule = ExactParameters(LINEAR, 0, (relation.c0,), relation.terms)
            candidate = grid and replace(grid, parameters=rule)
        else:
            candidate = candidate_of(units[place], x)
        if candidate is None:
            return None
        candidates.append(candidate)
    counts = np.stack([each.counts for each in candidates], axis=1)
    low, high = declared_range(counts)
    if not all(each.calibration.covers(low, high) for each in candidates):
        low, high = int(counts.min()), int(counts.max())
        if not all(each.calibration.covers(low, high) for each in candidates):
            return None
    described = [
        replace(channel, stored=each.counts, calibration=each.calibration, deviation=None)
        for channel, each in zip(channels, candidates, strict=True)
    ]
    track = make_track(
        described,
        numbers[0],
        further=() if follow_on(numbers) else tuple(numbers[1:]),
        codec="LPCX",
        parameters=b"".join(each.parameters.build() for each in candidates),
        count_min=low,
        count_max=high,
    )
    coded = Coded(track)
    sizes = np.zeros(len(channels), np.int64)
    at = 0
    for span in spans:
        part = slice(at, at + span.ticks)
        at += span.ticks
        try:
            exact = [x[part] for x in columns]
            data, each_size = linear_packet(candidates, exact, counts[part], effort)
        except ValueError:
            return None
        coded.packets.append(Packet(0, span.start, span.ticks, data))
        sizes += each_size
    parts, every = [], ", ".join(map(str, numbers))
    for place, size in enumerate(sizes.tolist()):
        relation = related.get(place)
        how = f"track of {every}"
        if relation is not None:
            how += f", linear in {numbers[relation.source]}"
        parts.append((f"bit for bit, {how}", size))
    return Unit(coded, None, "predicted + exact", "bit for bit", exact=True, parts=tuple(parts))


def follow_on(numbers: Sequence[int]) -> bool:
    return list(numbers) == list(range(numbers[0], numbers[0] + len(numbers)))


def candidate_of(unit: Unit, x: Doubles) -> Candidate | None:
    """The counts and the rule of a channel alone, as its unit has them. Words have no counts: a
    binary grid gives some, where they are small enough."""
    track = unit.base.track
    if track.number_format != "counts":
        return binary_grid(x)
    affine, counts = track.components[0].calibration, decode_all(unit.base, 1)[:, 0]
    rule = ExactParameters()
    if track.codec == "LPCX":
        rule = ExactParameters.parse(track.parameters, 0)
    return Candidate(Calibration(*affine), counts, rule, "as it is alone")


def linear_packet(
    candidates: Sequence[Candidate], columns: Sequence[Doubles], counts: Counts, effort: Effort
) -> tuple[bytes, list[int]]:
    """One packet, and how many of its bytes each component takes."""
    indices = [np.ascontiguousarray(counts[:, place]) for place in range(len(candidates))]
    packets = [encode_best(row, effort) for row in indices]
    parts = [
        smallest_exact(lacking_of(x, each.parameters, each.affine, row, columns))
        for x, each, row in zip(columns, candidates, indices, strict=True)
    ]
    coded = join_components(packets)
    sizes = [len(a) + len(b) for a, b in zip(packets, parts, strict=True)]
    rest = join_components(parts) if any(parts) else b""
    return build_varint(len(coded)) + coded + rest, sizes
