"""The predictor of each LPCR packet, by estimates of its size; and how long the packets are.

A predictor is a fixed polynomial or LPC. Reflection coefficients are quantised in the arcsine
domain, where steps are finest near 1 (J. D. Markel, A. H. Gray, "Linear Prediction of Speech",
Springer 1976). kernels/ has the same loops in C, with the same numbers.

Sums of products of the samples give predictors of any order, and the energy that each order leaves.
The best order of each kind of sums is compared with polynomials by a part of its prediction errors.
Estimates decide; the packet is written once.

Packets are long for size, and shorter against damage. A packet is cut in halves where separate
predictors save more than they cost. Sums of products of each piece tell how well any predictor does
there, so that each sample is read once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from math import frexp, inf, pi, sin, sqrt
from operator import mul

import numpy as np
from numpy.typing import NDArray

from ..codecs.entropy import ERROR_BITS, bit_cost, probability
from ..codecs.predicted import (
    BY_BITS,
    DIFFERENCE_LIMIT,
    ORDER_LIMIT,
    SHIFT,
    TABLE,
    Predictor,
    differences,
    encode_indices,
)
from ..kernels import compiled
from ..recording import Span
from .effort import EFFORTS, Effort

Indices = NDArray[np.int64]

COEFFICIENT_COST = 8
"""Bits."""

SUMS = 4
"""Sums are of first differences where quiet parts and loud ones count alike, of first differences,
and the same two of the samples: their bits say which are tried."""

PART, COSTED, SHARE = 48, 32, 0.3
"""Samples whose loudness is one number, and those whose mean error is. Loudness is the mean error
of the best polynomial, and a SHARE of a count for rounding."""

MORE = 1 / 16384
"""Added to predictions, which are multiples of 2**-13, so that halves are rounded up."""

REPEAT_SHARE = 50
"""Repeats are tried where more than one sample in 50 repeats the one before."""

SPARSE = 1.5
"""Bits a sample. Below, what codes by bits may expect repeats anyway, so that way is looked at."""

QUIET_BITS = 141
"""256ths of a bit a sample. Below, what codes by bits may learn more of errors that are larger, so
that the best polynomial is written as well as the best of all."""

LOW_ORDERS = (1, 1), (3, 3)
"""Sums and orders that quiet packets are tried with too."""

CALM_BITS, LEVEL_BITS = 384, 128
"""256ths of a bit a sample. Plain sums are for packets where a polynomial takes less. Sums of the
samples are for packets whose differences save no more."""

POLYNOMIALS = ((), (), (1,), (2, -1), (3, -3, 1))
"""As predictors of the samples, or of their first differences."""

SCALED_BITS, SUM_BLOCK = 18, 4096

NOISE = 1e-9
"""Added to the autocorrelation at lag 0, relative to it, with the rounding noise of 1/12 a sample.
Without it near-singular signals (a sine, 20 Hz at 10 kHz) have reflections of magnitude 1."""

LIMITS = np.array([sin(pi * (2 * k + 1) / 512) for k in range(127)])
"""Where one reflection coefficient ends and the next begins."""


@dataclass(frozen=True)
class Attempt:
    """A predictor, and what it predicts with: the samples or their first differences."""

    predictor: Predictor
    set: int = -1
    """The sums that it comes from."""
    bits: int = -1
    """256 times those of the packet; -1: not known, or an error that cannot be coded."""

    @property
    def taps(self) -> list[float]:
        if self.predictor.reflections:
            return [c / (1 << SHIFT) for c in self.predictor.coefficients or []]
        return [float(c) for c in POLYNOMIALS[self.predictor.difference]]


def encode_best(indices: Indices, effort: Effort | None = None) -> bytes:
    """A packet of the predictor that is best by estimates. ``effort``: None is the default one.

    ValueError where an index is beyond 2**32."""
    effort = effort or EFFORTS["default"]
    plain = np.ascontiguousarray(indices, np.int64)
    if compiled is not None:
        return compiled.encode_packet(
            plain, TABLE, LIMITS, effort.highest, effort.stride, effort.sums,
            effort.other_orders, max(effort.written, 1),
        )  # fmt: skip
    first = int(plain[0])
    if (plain == first).all():
        return encode_indices(plain, Predictor())
    choice = Choice(plain, effort)
    ranked = choice.ranked()
    tried = [way.predictor for way in ranked[: choice.written]]
    packets = []
    if tried and tried[0].repeats and ranked[0].bits < SPARSE * 256 * plain.size:
        other = replace(tried[0], repeats=False)
        packets = written(plain, [other])
        if len(tried) == 1 and packets and packets[0][len(other.build())] == BY_BITS:
            return packets[0]
    packets += written(plain, tried)
    # An error may be too large in what no estimate looked at.
    packets = packets or [encode_indices(plain, Predictor(0, (), mean_of(plain)))]
    return min(packets, key=len)


def written(indices: Indices, predictors: Sequence[Predictor]) -> list[bytes]:
    found = []
    for predictor in predictors:
        with suppress(ValueError):
            found.append(encode_indices(indices, predictor))
    return found


def mean_of(indices: Indices) -> int:
    """Rounded to nearest."""
    return (2 * int(indices.sum()) + indices.size) // (2 * indices.size)


class Choice:
    """The ways to predict a packet. kernels/choice.h has the same, in the same order."""

    def __init__(self, indices: Indices, effort: Effort) -> None:
        self.indices, self.effort, self.size = indices, effort, indices.size
        self.bases = mean_of(indices), int(indices[0])
        self.rows = [(indices - base).astype(np.float64) for base in self.bases]
        self.rows[1] = np.diff(self.rows[1], prepend=0.0)
        self.parts = -(-self.size // PART)
        self.looked_at = np.arange(self.size) // PART % effort.stride == 0
        self.seen = int(np.count_nonzero(self.looked_at))
        self.written = max(effort.written, 1)

    def ranked(self) -> list[Attempt]:
        """The best first."""
        polynomials = [
            self.measured(Attempt(Predictor(g, (), self.bases[g > 0])))
            for g in range(DIFFERENCE_LIMIT + 1)
        ]
        loudness = self.loudness([self.errors(way) for way in polynomials])
        ways: list[Attempt] = []
        reflections: dict[int, list[int]] = {}
        for place in range(SUMS):
            if self.sums(polynomials) >> place & 1:
                reflections[place], order = self.linear(place, loudness)
                ways += self.way(place, reflections[place][:order])
        ways = [self.measured(way) for way in ways]
        able = [way for way in ways if way.bits >= 0]
        if self.effort.other_orders and able:
            best = min(able, key=lambda way: way.bits)
            every = reflections[best.set]
            for order in (*range(1, 4), *range(4, len(every) + 1, 4)):
                if order <= len(every) and order != len(best.predictor.reflections):
                    ways += map(self.measured, self.way(best.set, every[:order]))
        able = [way for way in ways + polynomials if way.bits >= 0]
        quiet = any(way.bits < QUIET_BITS * self.seen for way in able)
        if quiet:
            for place, order in LOW_ORDERS:
                if len(reflections.get(place, [])) >= order:
                    low = map(self.measured, self.way(place, reflections[place][:order]))
                    able += [way for way in low if way.bits >= 0]
        able = sorted(map(self.whole, able), key=lambda way: way.bits)
        plain = [at for at, way in enumerate(able) if not way.predictor.reflections]
        if quiet and plain and plain[0]:
            able.insert(0, able.pop(plain[0]))
            self.written = max(self.written, 2)
        marks = np.count_nonzero(self.indices[1:] == self.indices[:-1])
        if able and marks * REPEAT_SHARE > self.size:
            marked = self.measured(
                replace(able[0], predictor=replace(able[0].predictor, repeats=True))
            )
            if marked.bits >= 0:
                marked = self.whole(marked, 4)
                able.insert(marked.bits >= able[0].bits, marked)
                self.written += quiet and self.written == 2
        return able

    def sums(self, polynomials: Sequence[Attempt]) -> int:
        """Those that are likely to help, as bits."""
        bits = [way.bits for way in polynomials]
        calm = min(bits) < CALM_BITS * self.seen
        chosen = self.effort.sums & (15 if calm else 7)
        if not self.effort.other_orders:
            chosen &= 15 if calm else ~2
            chosen &= ~4 if bits[0] >= bits[1] + LEVEL_BITS * self.seen else 15
        return chosen

    def way(self, place: int, reflections: Sequence[int]) -> list[Attempt]:
        """None where there is nothing to predict with, or it is out of range."""
        difference = int(place < 2)
        predictor = Predictor(difference, tuple(reflections), self.bases[difference])
        return (
            [Attempt(predictor, place)]
            if reflections and predictor.coefficients is not None
            else []
        )

    def errors(self, way: Attempt) -> NDArray[np.float64]:
        """Prediction errors, four coefficients at a time."""
        x, taps = self.rows[way.predictor.difference > 0], way.taps
        taps += [0.0] * (-len(taps) % 4)
        past = np.concatenate((np.zeros(len(taps)), x))
        sums = np.zeros(x.size)
        for j in range(0, len(taps), 4):
            a, b, c, d = (
                taps[k] * past[len(taps) - 1 - k : past.size - 1 - k] for k in range(j, j + 4)
            )
            sums += (a + b) + (c + d)
        return np.asarray(x - np.rint(sums + MORE))

    def loudness(self, errors: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """One over the loudness of each part and its neighbours."""
        starts = np.arange(0, self.size, PART)
        least = np.min([np.add.reduceat(np.abs(e), starts) for e in errors], axis=0)
        loud = least / np.diff(np.append(starts, self.size)) + SHARE
        around = np.concatenate((loud[:1], loud, loud[-1:]))
        return np.asarray(4 / (around[:-2] + 2 * loud + around[2:]))

    def linear(self, place: int, loudness: NDArray[np.float64]) -> tuple[list[int], int]:
        """Reflection coefficients, and the order whose energy best repays them."""
        x = self.rows[place < 2]
        noise = np.diff(np.append(np.arange(0, self.size, PART), self.size)).astype(np.float64)
        if place % 2 == 0:
            ends = np.concatenate((loudness[:1], loudness, loudness[-1:]))
            at = np.arange(self.size) + PART // 2
            left = at // PART
            x = x * (ends[left] + (ends[left + 1] - ends[left]) * (at % PART / PART))
            noise = noise * (loudness * loudness)
        r = self.products(x)
        r[0] = r[0] * (1 + NOISE) + np.cumsum(noise)[-1] / 12
        r += [0.0] * (ORDER_LIMIT + 1 - len(r))
        reflections, energies = recursion(r, min(self.effort.highest, self.size - 1))
        return reflections, best_order(energies, self.size)

    def products(self, x: NDArray[np.float64]) -> list[float]:
        """Sums of x[i] * x[i - lag], part by part: rounded sums have one order."""
        highest = self.effort.highest
        past = np.concatenate((np.zeros(highest), x))
        now = past[highest:]
        lags = range(highest + 1)
        return [in_parts(now * past[highest - lag : past.size - lag]) for lag in lags]

    def measured(self, way: Attempt) -> Attempt:
        """With the bits of the parts that are looked at."""
        errors, total, counts = self.errors(way), 0, np.zeros((4, 2), np.int64)
        same = np.concatenate(([False], self.indices[1:] == self.indices[:-1]))
        for start in range(0, self.size, self.effort.stride * PART):
            e = errors[start : start + PART]
            if way.predictor.repeats:
                marks = same[start : start + PART].astype(np.int64)
                before = np.concatenate(([0, 0], marks))
                np.add.at(counts, (2 * before[1:-1] + before[:-2], marks), 1)
                e = e[marks == 0]
            bits = bits_of(e)
            if bits < 0:
                return replace(way, bits=-1)
            total += bits
        if way.predictor.repeats:
            for zeros, ones in counts.tolist():
                p = probability(zeros, ones)
                total += zeros * bit_cost(256 - p) + ones * bit_cost(p)
        return replace(way, bits=total)

    def whole(self, way: Attempt, more: int = 0) -> Attempt:
        """With the bits of all samples; ``more``: bytes of the header."""
        size = len(way.predictor.reflections) + more
        bits = way.bits * self.size // self.seen + 256 * COEFFICIENT_COST * size
        return replace(way, bits=bits)


def bits_of(errors: NDArray[np.float64]) -> int:
    """256 times their bits, by the logarithm of the mean of a few; -1: one cannot be coded."""
    magnitudes = np.abs(errors).astype(np.int64)
    if not magnitudes.size or int(magnitudes.max()) >> ERROR_BITS:
        return -1 if magnitudes.size else 0
    starts = np.arange(0, magnitudes.size, COSTED)
    sums, sizes = np.add.reduceat(magnitudes, starts), np.diff(np.append(starts, magnitudes.size))
    return int((sizes * (logs(32 * sizes + 87 * sums) - logs(32 * sizes))).sum())


def quick_estimate(indices: Indices) -> float:
    """Bits of a packet by the best of the first three fixed polynomials."""
    plain = np.ascontiguousarray(indices, np.int64)
    if compiled is not None:
        return compiled.polynomial_bits(plain) / 256
    rows = [plain - mean_of(plain), plain - plain[0]]
    rows[1] = np.diff(rows[1], prepend=0)
    rows.append(np.diff(rows[1], prepend=0))
    found = [(bits_of(row.astype(np.float64)), int(np.count_nonzero(row))) for row in rows]
    return min((bits / 256 + signs for bits, signs in found if bits >= 0), default=inf)


def linear_predictor(indices: Indices, difference: int, base: int) -> tuple[Predictor, list[int]]:
    """The best by the energies that the recursion leaves, and all its reflection coefficients."""
    sums = autocorrelations(indices, difference, base)
    orders = min(ORDER_LIMIT, indices.size - 1)
    reflections, energies = levinson(sums, indices.size, orders)
    order = best_order(energies, indices.size)
    return Predictor(difference, tuple(reflections[:order]), base), reflections


def best_order(energies: Sequence[float], size: int) -> int:
    """Whose energy best repays its coefficients."""
    a = 1.3862943611198906 * COEFFICIENT_COST / size
    factor, found = 1.0, [(inf, 0)]
    for order, energy in enumerate(energies, 1):
        factor *= 1 + a + a * a / 2
        if energy > 0:
            found.append((energy * factor, order))
    return min(found)[1]


def autocorrelations(indices: Indices, order: int, base: int) -> list[int]:
    """Sums of x[i] * x[i + lag], lag 0 to 32, x being the differences scaled to 18 bits."""
    if compiled is not None:
        sums = np.zeros(ORDER_LIMIT + 1, np.int64)
        compiled.autocorrelate(indices, order, base, sums)
        return sums.tolist()
    y = differences(indices - base, order)
    bits = int(np.bitwise_or.reduce(np.abs(y))).bit_length()
    x = np.concatenate((np.zeros(ORDER_LIMIT), y >> max(bits - SCALED_BITS, 0)))
    found = [0] * (ORDER_LIMIT + 1)
    for start in range(ORDER_LIMIT, x.size, SUM_BLOCK):
        now = x[start : start + SUM_BLOCK]
        for lag in range(ORDER_LIMIT + 1):
            # Not np.dot: threads of a BLAS wait longer for each other than these sums take.
            then = x[start - lag : start - lag + now.size]
            found[lag] += int(np.einsum("i,i->", now, then))
    return found


def levinson(sums: Sequence[float], rounding: float, orders: int) -> tuple[list[int], list[float]]:
    """Indices of the quantised reflection coefficients, fewer than ``orders`` where the recursion
    has nothing left to predict; and the energy that each leaves. ``rounding``: 12 times the energy
    of the rounding errors."""
    r = [float(s) for s in sums]
    r[0] = r[0] * (1 + NOISE) + rounding / 12
    return recursion(r, orders)


def recursion(r: list[float], orders: int) -> tuple[list[int], list[float]]:
    """``levinson`` of an autocorrelation [33] with its noise."""
    if compiled is not None:
        found, left = np.zeros(ORDER_LIMIT, np.int8), np.zeros(ORDER_LIMIT)
        order = compiled.levinson(np.array(r), orders, LIMITS, found, left)
        return found[:order].tolist(), left[:order].tolist()
    reflections: list[int] = []
    energies: list[float] = []
    error, p = r[0], [0.0] * 0
    for order in range(orders):
        total = 0.0
        for j in range(order):
            total += p[j] * r[order - j]
        k = (r[order + 1] - total) / error if error > 0 else 1.0
        if not abs(k) < 1:
            break
        index = int(np.searchsorted(LIMITS, abs(k), side="right"))
        reflections.append(-index if k < 0 else index)
        p = [p[j] - k * p[order - 1 - j] for j in range(order)] + [k]
        error *= 1 - k * k
        energies.append(error)
    return reflections, energies


def logs(v: Indices) -> Indices:
    """256 times the binary logarithm, the mantissa taken for its own logarithm."""
    lg = np.frexp(v.astype(np.float64))[1].astype(np.int64) - 1
    mantissa = np.where(lg >= 8, v >> np.maximum(lg - 8, 0), v << np.maximum(8 - lg, 0))
    return np.asarray(256 * lg + (mantissa & 255))


SHORTEST_CUT, PIECES = 4096, 16
"""Samples of the shortest packet that is cut off; most packets."""

CUT_BITS = 496
"""Bits that a cut must save: a row of 12 bytes, the first states, averages that start from one
byte."""

CUT_ORDERS = (0, 1, 2, 4, 8, 11)

SPREAD = 3.8
"""Errors of this many counts and more take a bit each time they double: 5.4 times the mean of a
Laplacian distribution, by its deviation."""


def fitting_packets(
    span: Span, indices: Indices, code: Callable[[slice], bytes], *, cuts: bool = True
) -> Iterator[tuple[Span, bytes]]:
    """The packet of a span, or several that are smaller together; ``code`` makes one of a part."""
    edges = [*(best_cuts(indices) if cuts else [0]), span.ticks]
    for a, b in pairwise(edges):
        yield Span(span.start + a, span.start + b), code(slice(a, b))


def best_cuts(indices: Indices) -> list[int]:
    """Where packets begin that take few bits: of the shortest ones those neighbours become one
    that save most by that, until none does."""
    count = min(indices.size // SHORTEST_CUT, PIECES)
    if count < 2:
        return [0]
    plain = np.ascontiguousarray(indices, np.int64)
    if compiled is not None:
        found = np.zeros(PIECES, np.int64)
        return list(found[: compiled.find_cuts(plain, TABLE, LIMITS, found)].tolist())
    pieces = CutPieces(plain, [plain.size * k // count for k in range(count + 1)])
    starts = list(range(count + 1))
    costs = [pieces.bits(k, k + 1)[0] for k in range(count)]
    joint = [pieces.bits(k, k + 2)[0] for k in range(count - 1)]
    while joint:
        least, place = min((joint[k] - costs[k] - costs[k + 1], k) for k in range(len(joint)))
        if least >= 0:
            break
        costs[place : place + 2] = [joint[place]]
        del starts[place + 1], joint[place]
        for k in (place - 1, place):
            if 0 <= k < len(joint):
                joint[k] = pieces.bits(starts[k], starts[k + 2])[0]
    return [pieces.edges[k] for k in starts[:-1]]


class CutPieces:
    """Sums of products of first differences, piece by piece, and how much a piece counts where a
    predictor serves several."""

    def __init__(self, indices: Indices, edges: list[int]) -> None:
        self.edges, self.sizes = edges, np.diff(edges).tolist()
        lags = CUT_ORDERS[-1] + 1
        self.sums: list[list[float]] = []
        for a, b in pairwise(edges):
            x = np.diff(indices[a:b], prepend=indices[a]).astype(np.float64)
            past = np.concatenate((np.zeros(lags), x))
            shifted = (past[lags - lag : past.size - lag] for lag in range(lags))
            self.sums.append([in_parts(x * then) for then in shifted])
        self.weights = [1.0] * len(self.sizes)
        energies = [self.bits(k, k + 1)[1] for k in range(len(self.sizes))]
        self.weights = [n / e for n, e in zip(self.sizes, energies, strict=True)]

    def bits(self, first: int, stop: int) -> tuple[float, float]:
        """Those of one packet of these pieces, and the energy of its errors."""
        mixed, noise = [0.0] * (ORDER_LIMIT + 1), 0.0
        for k in range(first, stop):
            for lag, value in enumerate(self.sums[k]):
                mixed[lag] += self.weights[k] * value
            noise += self.weights[k] * self.sizes[k]
        mixed[0] = mixed[0] * (1 + NOISE) + noise / 12
        reflections, _ = recursion(mixed, CUT_ORDERS[-1])
        found = []
        for order in CUT_ORDERS:
            c = Predictor(1, tuple(reflections[:order])).coefficients
            if order > len(reflections) or c is None:
                break
            a = [1.0, *(-each / (1 << SHIFT) for each in c)]
            products = [(1 + (lag > 0)) * sum_of(map(mul, a, a[lag:])) for lag in range(order + 1)]
            bits, total = float(COEFFICIENT_COST * order), 0.0
            for n, own in zip(self.sizes[first:stop], self.sums[first:stop], strict=True):
                energy = max(sum_of(map(mul, products, own)), 0.0) + n / 12
                bits += n * log_2(1 + SPREAD * sqrt(energy / n))
                total += energy
            found.append((bits, total))
        bits, energy = min(found, key=lambda each: each[0])
        return bits + CUT_BITS, energy


def sum_of(numbers: Iterable[float]) -> float:
    """One after the other; sum() may round otherwise."""
    total = 0.0
    for number in numbers:
        total += number
    return total


def in_parts(products: NDArray[np.float64]) -> float:
    """Their sum, part by part: rounded sums have one order."""
    padded = np.concatenate((products, np.zeros(-products.size % PART))).reshape(-1, PART)
    return float(np.cumsum(np.cumsum(padded, axis=1)[:, -1])[-1])


def log_2(v: float) -> float:
    """The logarithm that every machine has."""
    m, power = frexp(v)
    root = 0.7071067811865476
    t = (m - root) / (m + root)
    q = t * t
    rest = 1 + q * (1.0 / 3 + q * (1.0 / 5 + q * (1.0 / 7 + q / 9)))
    return power - 0.5 + 2.8853900817779268 * (t * rest)
