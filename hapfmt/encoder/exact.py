"""Floating point channels without a common step, stored bit for bit (SPEC 9.7).

LPCX stores counts on a grid, with corrections that give the exact values. Two kinds of grid are
tried: a natural grid with small deviations, with the rule that leaves the shortest corrections; and
a binary grid as fine as level 1 allows. The encoder keeps the smaller.

Channels that fit no grid become one RAWB track of words.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import accumulate
from math import frexp
from typing import NamedTuple

import numpy as np

from ..codecs.exact import (
    COEFFICIENT_LIMIT,
    CUBIC,
    DIGITS_LIMIT,
    PRODUCT,
    QUOTIENT,
    SIGNIFICANT,
    Counts,
    Doubles,
    ExactParameters,
    Lacking,
    corrections_of,
    lacking_of,
)
from ..codecs.raw import RawParameters, encode_raw
from ..format.cluster import Packet
from ..format.track import Affine
from ..limits import AFFINE_LIMIT, EXACT_LIMIT, LEVELS
from ..numbers import build_varint, parse_varint
from ..recording import Calibration, Channel, Span
from .knots import Coded
from .lattice import Lattice, Near, find_lattice, natural_lattices
from .lengths import fitting_packets
from .predict import encode_best
from .source import declared_range, make_track
from .unit import Unit

GRID_BITS = LEVELS[1].count_bits - 1
"""Bits of the range of a binary grid. A finer grid predicts better but needs longer counts (0.1 b/s
at most on the recordings, either way)."""

TEXTS = 4096
"""Most distinct values whose decimals are examined."""

CHEAP = 4
"""Bits a sample: a grid SPARSE times finer than the natural one costs at least as much."""

TRIALS = 512
"""Distinct counts that the rules are tried on."""

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
    *,
    exact: Lattice | None = None,
    grid: bool = True,
    least: Callable[[], float] = lambda: 0,
) -> Unit:
    """The smallest way to keep a floating point channel bit for bit: counts and exact values, or
    ``otherwise``.

    ``otherwise`` is not called where a natural grid leaves almost no corrections. Nor is it called
    where its size, at ``least`` that many bytes, is larger. ``exact``: the grid that holds the
    values exactly, if one exists. ``grid``: whether to try a binary grid.
    """
    x = np.ascontiguousarray(channel.stored, np.float64)
    if not x.size or not np.isfinite(x).all():
        return otherwise()

    def code(candidate: Candidate | None) -> Beside | None:
        return coded_as(channel, x, spans, first_channel, candidate) if candidate else None

    natural = code(natural_candidate(x, exact))
    if natural and 8 * natural.size < CHEAP * x.size:
        return natural.unit
    found = [natural, code(binary_grid(x) if grid else None)]
    units = [way.unit for way in found if way]
    if not units or least() < min(unit.size for unit in units):
        units.append(otherwise())
    return min(units, key=lambda unit: unit.size)


def coded_as(
    channel: Channel,
    x: Doubles,
    spans: Sequence[Span],
    first_channel: int,
    candidate: Candidate,
) -> Beside | None:
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
            return packet_of(values[part], candidate, counts[part])

        try:
            for part, data in fitting_packets(span, counts, code):
                coded.packets.append(Packet(0, part.start, part.ticks, data))
                first = part.start - span.start
                coded.doubles.append([values[first : first + part.ticks]])
                beside += exact_size(data)
        except ValueError:
            # Too far from its count, or counts too far from each other.
            return None
    reason = f"bit for bit: counts of {candidate.how}, and {beside} bytes of exact values"
    return Beside(Unit(coded, None, "predicted + exact", reason, exact=True), beside)


def natural_candidate(x: Doubles, exact: Lattice | None) -> Candidate | None:
    """The natural grid and the rule with the shortest corrections, by distinct values."""
    z = x
    if (np.signbit(x) & (x == 0)).any():
        z = x + 0.0
        exact = find_lattice(z)
        if exact is not None:
            # Only -0.0 is off the grid.
            return Candidate(exact.calibration, exact.counts, ExactParameters(), exact.reason)
    u = np.unique(z)
    rules = [ExactParameters(QUOTIENT), ExactParameters(PRODUCT), *printed_rule(u)]
    found: list[tuple[float, Candidate]] = []
    lattices = {near.calibration: near for near in natural_lattices(u, exact)}
    for near in lattices.values():
        step = float(near.calibration.step)
        how = f"step {step:.10g}, missed by {near.largest_deviation:.3g} at most"
        # Counts are sorted as u is.
        first = np.flatnonzero(np.diff(near.counts, prepend=near.counts[0] - 1))
        first = first[:: max(1, first.size // TRIALS)]
        for rule in (*rules, *cubic_rules(near, u[first], near.counts[first])):
            way = Candidate(near.calibration, near.counts, rule, how)
            bits = correction_bits(u[first], rule.values(near.counts[first], way.affine))
            if bits is not None:
                found.append((bits + 64 * len(rule.coefficients), way))
    if not found:
        return None
    best = min(found, key=lambda pair: pair[0])[1]
    return replace(best, counts=best.counts[np.searchsorted(u, z)])


def correction_bits(x: Doubles, doubles: Doubles) -> float | None:
    """About how many bits the corrections have in all."""
    try:
        corrections = corrections_of(x, doubles)
    except ValueError:
        return None
    return float(np.log2(1.0 + np.abs(corrections.astype(np.float64))).sum())


def cubic_rules(near: Near, u: Doubles, counts: Counts) -> Iterator[ExactParameters]:
    """Polynomials of degree 3 through the distinct values u of their counts: what converters with
    a linearised scale give. They differ in the lowest bits of the slope."""
    if u.size < FITTED:
        return
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
            yield ExactParameters(CUBIC, 0, found)


def fit(t: Doubles, y: Doubles, powers: Sequence[int]) -> list[float]:
    """The coefficients of these powers of t that come nearest to y, by least squares."""
    table = np.stack([t**power for power in powers], axis=1)
    coefficients: list[float] = np.linalg.lstsq(table, y, rcond=None)[0].tolist()
    return coefficients


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


def exact_size(packet: bytes) -> int:
    """How many of its bytes are exact values."""
    size, at = parse_varint(packet, 0)
    return len(packet) - at - size


def packet_of(x: Doubles, candidate: Candidate, counts: Counts) -> bytes:
    """One packet of these samples."""
    lacking = lacking_of(x, candidate.parameters, candidate.affine, counts)
    return beside_counts(encode_best(counts), lacking)


def beside_counts(coded: bytes, lacking: Lacking) -> bytes:
    """A packet of LPCX: coded counts, and the exact values that these lack."""
    return build_varint(len(coded)) + coded + smallest_exact(lacking)


def smallest_exact(lacking: Lacking) -> bytes:
    """With recall or without."""
    return min((lacking.build(recall=recall) for recall in (False, True)), key=len)


WORDS_REASON = "bit for bit: no common step"

PROBES, PROBED = 4, 2048
"""Packets, and samples in the middle of each, that estimate the size of words. DEFLATE takes 70 %
of the time of a channel whose values repeat."""

LARGER = 1.25
"""Largest ratio of a probe's size to that of the whole (1.12 measured)."""


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


def words_size(channel: Channel, spans: Sequence[Span]) -> float:
    """Bytes that RAWB words hardly stay below."""
    size, samples, stride = 0, 0, -(-len(spans) // PROBES)
    firsts = list(accumulate((span.ticks for span in spans), initial=0))
    for place in range(stride // 2, len(spans), stride):
        first, span = firsts[place], spans[place]
        ticks = min(span.ticks, PROBED)
        start = first + (span.ticks - ticks) // 2
        rows = channel.stored[start : start + ticks, None]
        size += len(encode_raw(rows, channel.stored.dtype.itemsize))
        samples += ticks
    return size / LARGER * channel.stored.size / samples
