"""The predictor of each LPCR packet, by description length; and how long the packets are.

A predictor is a fixed polynomial or LPC. Reflection coefficients are quantised in the arcsine
domain, where steps are finest near 1 (J. D. Markel, A. H. Gray, "Linear Prediction of Speech",
Springer 1976). kernels/ has the same loops in C, with the same numbers.

The quick way chooses with little work. It tries a fixed polynomial and LPC of the differences. The
energies that the recursion leaves give the order of LPC. The one with the smaller prediction errors
wins.

Packets are long for size, and shorter against damage. A packet is cut in halves where separate
predictors save more than they cost. Sums of products of each piece tell how well any predictor does
there, so that each sample is read once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import inf, log2, pi, sin

import numpy as np
from numpy.typing import NDArray

from ..codecs.entropy import ERROR_BITS
from ..codecs.predicted import (
    BY_BITS,
    DIFFERENCE_LIMIT,
    ORDER_LIMIT,
    SHIFT,
    TABLE,
    Predictor,
    differences,
    encode_indices,
    encode_predicted,
    errors_of,
    prediction_errors,
)
from ..kernels import compiled
from ..recording import Span

Indices = NDArray[np.int64]

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 28, 32)
"""LPC orders that are tried; orders between them give nearly the same sizes."""

TRIED = (3, 8, 20)
"""The loud parts of a packet need more coefficients than its quiet rest repays. So these orders are
tried as well."""

COEFFICIENT_COST = 8
"""Bits."""

REPEAT_SHARE = 0.02
"""Repeats are tried from this share of unchanged samples on."""

FINALISTS, SPARSE, SHORT = 3, 1.5, 1500
"""The encoder writes the packets of the best 3 predictors, with repeats and without, and keeps the
smallest. It does so where samples take less than 1.5 bits, or are fewer than 1500: the estimate of
the size is not exact enough there."""

LONG, ESTIMATED_PIECE, STRIDE = 6000, 256, 3
"""Packets of 6000 samples and more: a predictor is estimated from every third piece of 256 samples.
With every fifth piece some packets were 2 % larger."""

SCALED_BITS, SUM_BLOCK, COST_BLOCK = 18, 4096, 32

BALANCED, LOUDNESS_BLOCK, LOUDNESS_BITS = 2048, 128, 14
"""Packets of 2048 samples and more: loud and quiet parts have equal weight in the predictor. This
saves 3 % of shock51k and 2 to 5 % of dropbear. Samples are divided by the mean error around them,
measured in blocks of 128; the quotients have 14 fractional bits."""

NOISE = 1e-9
"""Added to the autocorrelation at lag 0, relative to it, with the rounding noise of 1/12 a sample.
Without it near-singular signals (a sine, 20 Hz at 10 kHz) have reflections of magnitude 1."""

LIMITS = np.array([sin(pi * (2 * k + 1) / 512) for k in range(127)])
"""Where one reflection coefficient ends and the next begins."""


def encode_best(indices: Indices, *, thorough: bool = True, live: bool = False) -> bytes:
    """The smallest packet found; ``thorough``: several are written, not only where the estimate
    is not to be trusted. ``live``: the estimate alone decides (0.04 % larger, 30 % less time)."""
    if (indices == indices[0]).all():
        return encode_indices(indices, Predictor())
    plain = np.ascontiguousarray(indices, np.int64)
    extent = max(-int(plain.min()), int(plain.max()))
    ranked = choose_predictors(plain, extent, balanced=plain.size >= BALANCED)
    marks = np.count_nonzero(plain[1:] == plain[:-1]) > REPEAT_SHARE * plain.size
    unsure = plain.size < SHORT or ranked[0][0] < SPARSE * plain.size
    if not live and (thorough or unsure):
        ways = [way for _, way in ranked[:FINALISTS]]
        if ranked[0][0] < SPARSE * plain.size:
            ways += [way for way in steady_predictors(plain) if way not in ways]
        packets = [(encode_indices(plain, way), way) for way in ways]
        best, predictor = min(packets, key=lambda pair: len(pair[0]))
        if marks and not has_models(best, predictor):
            other = replace(predictor, repeats=True)
            best = min(best, encode_indices(plain, other), key=len)
        return best
    bits, predictor = ranked[0]
    if marks:
        other = replace(predictor, repeats=True)
        if estimate(plain, other, extent, counted=True) < bits:
            predictor = other
    return encode_indices(plain, predictor)


def steady_predictors(indices: Indices) -> list[Predictor]:
    """For quiet channels: what learns can tell more of differences than a predictor leaves."""
    return [Predictor(order, (), int(indices[0])) for order in (1, 2)]


def has_models(packet: bytes, predictor: Predictor) -> bool:
    """Whether its prediction errors are coded by bits, which expect repeats anyway."""
    return packet[len(predictor.build())] == BY_BITS


def quick_estimate(indices: Indices) -> float:
    """Bits of a packet by the best of the first three fixed polynomials."""
    plain = np.ascontiguousarray(indices, np.int64)
    extent = max(-int(plain.min()), int(plain.max()))
    first, mean = int(plain[0]), int(np.floor(plain.mean() + 0.5))
    return min(
        estimate(plain, Predictor(order, (), base), extent)
        for order, base in enumerate((mean, first, first))
    )


def choose_predictors(
    indices: Indices, extent: int, *, balanced: bool = False
) -> list[tuple[float, Predictor]]:
    """(bits, predictor), the best first: fixed polynomials while each is better than the one
    before, and LPC; ``balanced``: LPC too that quiet parts and loud ones decide alike."""
    first, mean = int(indices[0]), int(np.floor(indices.mean() + 0.5))
    found: dict[Predictor, float] = {}

    def weigh(predictor: Predictor) -> float:
        found[predictor] = estimate(indices, predictor, extent)
        return found[predictor]

    before = inf
    for difference in range(DIFFERENCE_LIMIT + 1):
        bits = weigh(Predictor(difference, (), first if difference else mean))
        if bits >= before:
            break
        before = bits
    tried = [
        (weigh(predictor), difference, reflections)
        for difference, base in ((0, mean), (1, first))
        for predictor, reflections in (linear_predictor(indices, difference, base),)
        if reflections
    ]
    if tried:
        _, difference, reflections = min(tried, key=lambda row: row[0])
        for order in TRIED:
            predictor = Predictor(difference, tuple(reflections[:order]), (mean, first)[difference])
            if predictor not in found:
                weigh(predictor)
    best = min(found, key=found.__getitem__)
    if balanced and found[best] < inf:
        loudness = loudness_of(indices, best)
        for difference, base in ((0, mean), (1, first)):
            reflections = balanced_reflections(indices, difference, base, loudness)
            for order in (*TRIED, len(reflections)):
                predictor = Predictor(difference, tuple(reflections[:order]), base)
                if order <= len(reflections) and predictor not in found:
                    weigh(predictor)
    ranked = sorted(found, key=found.__getitem__)
    bits = estimate(indices, ranked[0], extent, counted=True)
    if bits == inf:
        # An error too large in what the estimate did not look at; these are below 2**33.
        return [(inf, Predictor(0, (), mean))]
    return [(bits, way) for way in ranked if found[way] < inf]


def linear_predictor(indices: Indices, difference: int, base: int) -> tuple[Predictor, list[int]]:
    """The best by the energies that the recursion leaves, and all its reflection coefficients."""
    sums = autocorrelations(indices, difference, base)
    orders = min(ORDER_LIMIT, indices.size - 1)
    reflections, energies = levinson(sums, indices.size, orders)
    weighed = [
        (indices.size / 2 * log2(energies[m - 1]) + COEFFICIENT_COST * m, m)
        for m in ORDERS
        if m <= len(energies) and energies[m - 1] > 0
    ]
    order = min(weighed)[1] if weighed else 0
    return Predictor(difference, tuple(reflections[:order]), base), reflections


def balanced_reflections(
    indices: Indices, difference: int, base: int, loudness: Indices
) -> list[int]:
    """Reflection coefficients of the samples divided by ``loudness``: bits are saved by the ratio
    of errors, in quiet parts as in loud ones."""
    y = (differences(indices - base, difference) << LOUDNESS_BITS) // loudness
    shift = max(int(np.abs(y).max()).bit_length() - SCALED_BITS, 0)
    sums = autocorrelations(y >> shift, 0, 0)
    # Samples are rounded before they are divided.
    rounding = int((((1 << LOUDNESS_BITS) // loudness) ** 2).sum()) >> 2 * shift
    return levinson(sums, rounding, min(ORDER_LIMIT, indices.size - 1))[0]


def loudness_of(indices: Indices, predictor: Predictor) -> Indices:
    """For each sample 16 times the mean prediction error around it, and some for rounding."""
    c = predictor.coefficients or []
    errors = np.abs(prediction_errors(indices, predictor.difference, c, predictor.base))
    starts = np.arange(0, errors.size, LOUDNESS_BLOCK)
    sizes = np.diff(np.append(starts, errors.size))
    means = 16 * np.add.reduceat(errors, starts) // sizes + 5
    at = np.arange(errors.size) + LOUDNESS_BLOCK // 2
    left, place = at // LOUDNESS_BLOCK, at % LOUDNESS_BLOCK
    means = np.concatenate((means[:1], means, means[-1:]))
    return np.asarray(means[left] + (means[left + 1] - means[left]) * place // LOUDNESS_BLOCK)


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


def estimate(
    indices: Indices, predictor: Predictor, extent: int, *, counted: bool = False
) -> float:
    """Bits of a packet, all samples being within ``extent`` of 0.

    They are those of Laplacian prediction errors whose scale is that of their block, infinite
    where one of them cannot be coded (SPEC RNG-003, LPC-005). ``counted``: signs and repeats
    take the bits of their models, which takes longer to find; else a sign is a bit.
    """
    c = predictor.coefficients
    if c is None:
        return inf
    counts = np.zeros(15, np.int64)
    stride = 1 if counted or indices.size < LONG else STRIDE
    if compiled is not None:
        cost = compiled.estimate(
            np.array(c, np.int32), predictor.difference, predictor.repeats, counted, stride,
            predictor.base, max(extent, abs(predictor.base)), indices, counts,
        )  # fmt: skip
    else:
        cost = cost_of(indices, predictor, c, counts, stride, counted=counted)
    if cost < 0:
        return inf
    header = COEFFICIENT_COST * len(c)
    if not counted:
        whole, rest = divmod(indices.size, stride * ESTIMATED_PIECE)
        seen = whole * ESTIMATED_PIECE + min(rest, ESTIMATED_PIECE)
        return (cost / 256 + int(counts[-1])) * indices.size / seen + header
    pairs = counts[:-1].reshape(7, 2).tolist()
    saved = sum(saving(*pair) for pair in pairs[:3])
    # What is modelled takes what raw bits would, less what that saves.
    marks = sum(sum(pair) - saving(*pair) for pair in pairs[3:])
    return cost / 256 + int(counts[-1]) - saved + marks + header


def cost_of(
    indices: Indices,
    predictor: Predictor,
    c: list[int],
    counts: Indices,
    stride: int,
    *,
    counted: bool,
) -> int:
    """256 times the bits without signs and repeats, log2(1 + e * mean) for each of a block; -1
    where an error cannot be coded.

    ``counts`` [15]: positive and negative ones after a negative one, none, a positive one; then
    the zeros and ones that say that a sample repeats, for each of their models; and all that are
    not 0. Where they are not ``counted``, the last alone.
    """
    y = differences(indices - predictor.base, predictor.difference)
    e = errors_of(y, c)
    blocks = np.arange(e.size) // COST_BLOCK
    if stride > 1:
        seen = np.arange(e.size) // ESTIMATED_PIECE % stride == 0
        e, blocks = e[seen], blocks[seen]
    if predictor.repeats:
        same = np.concatenate(([0], (indices[1:] == indices[:-1]).astype(np.int64)))
        models = 2 * same[:-1] + np.concatenate(([0], same[:-2]))
        counts[6:-1] = np.bincount(2 * models + same[1:], minlength=8)
        e, blocks = e[same == 0], blocks[same == 0]
    magnitudes, signs = np.abs(e), np.sign(e)
    if int(magnitudes.max()) >> ERROR_BITS:
        return -1
    some = signs != 0
    counts[-1] = np.count_nonzero(some)
    if counted:
        after = np.concatenate(([0], signs[:-1]))[some]
        counts[:6] = np.bincount(2 * after + 2 + (signs[some] < 0), minlength=6)
    first = np.flatnonzero(np.diff(blocks, prepend=-1))
    sums = np.add.reduceat(magnitudes, first)
    sizes = np.diff(np.append(first, e.size))
    return int((sizes * (logs(32 * sizes + 87 * sums) - logs(32 * sizes))).sum())


def logs(v: Indices) -> Indices:
    """256 times the binary logarithm, the mantissa taken for its own logarithm."""
    lg = np.frexp(v.astype(np.float64))[1].astype(np.int64) - 1
    mantissa = np.where(lg >= 8, v >> np.maximum(lg - 8, 0), v << np.maximum(8 - lg, 0))
    return np.asarray(256 * lg + (mantissa & 255))


def saving(a: int, b: int) -> float:
    """Bits that modelling a + b bits saves, a of them zeros."""
    n = a + b
    return n + sum(x * log2(x / n) for x in (a, b) if x) if n else 0.0


FAST_ORDERS, POLYNOMIALS = 12, 3
"""Highest orders: LPC 12 and fixed polynomials 3 (32 and 4: 0.4 % smaller, measured, at twice the
work)."""

COST = 24
"""Bits that a coefficient must save: it takes 8, and time (the mean size is the same)."""

FAST_PIECE, HISTORY, FAST_NOISE = 1024, 36, 1e-6
"""Samples whose autocorrelation is taken at a time, and those before them that it reaches into;
relative noise, without which a sine has reflections of magnitude 1."""

BLOCK, U_BITS = 32, 35
"""Errors whose mean is taken at a time; bits of the largest error and its sign."""

FAST_REPEAT_SHARE = 0.25
"""If more samples than this repeat the one before, repeats are marked (gloves: half the size)."""

SEEN, SEEN_OF = 256, 4
"""One piece in four tells how large prediction errors are."""


def encode_quick(indices: Indices) -> bytes:
    """A packet whose predictor little work has found."""
    plain = np.ascontiguousarray(indices, np.int64)
    first = int(plain[0])
    if first == plain[-1] and (plain == first).all():
        return encode_indices(plain, Predictor())
    predictor = quick_predictor(plain)
    try:
        if predictor.repeats:
            other = replace(predictor, repeats=False)
            packet = encode_predicted(plain, other)
            if has_models(packet, other):
                return packet
        return encode_predicted(plain, predictor)
    except ValueError:
        # An error is too large in a part that the estimate skipped.
        return encode_predicted(plain, Predictor(0, (), first))


def quick_predictor(indices: Indices) -> Predictor:
    """With repeats where they are frequent."""
    repeats = np.count_nonzero(indices[1:] == indices[:-1]) > FAST_REPEAT_SHARE * indices.size
    return replace(choose_quick(indices), repeats=bool(repeats))


def choose_quick(indices: Indices) -> Predictor:
    first, costs = int(indices[0]), costs_of(indices.size)
    if compiled is not None:
        found, coefficients = np.zeros(FAST_ORDERS, np.int8), np.zeros(FAST_ORDERS, np.int32)
        g, order = compiled.quick_predictor(indices, TABLE, LIMITS, costs, found, coefficients)
        return Predictor(g, tuple(found[:order].tolist()), first)
    best, smallest = Predictor(0, (), first), weight(indices, 0, [])
    for difference in range(1, POLYNOMIALS + 1):
        size = weight(indices, difference, [])
        if size < 0 or (smallest >= 0 and size >= smallest):
            if difference > 1:
                break
            continue
        best, smallest = Predictor(difference, (), first), size
    linear = quick_linear_predictor(indices, costs.tolist())
    c = linear.coefficients
    if c:
        size = weight(indices, 1, c)
        if size >= 0 and (smallest < 0 or size < smallest):
            return linear
    return best


@lru_cache(maxsize=32)
def costs_of(size: int) -> NDArray[np.float64]:
    """The factor by which each order must lower the energy of ``size`` samples."""
    return np.asarray(2.0 ** (np.arange(1, FAST_ORDERS + 1) * (2 * COST / size)))


def quick_linear_predictor(indices: Indices, costs: list[float]) -> Predictor:
    """The order whose energy best repays its coefficients."""
    orders = min(FAST_ORDERS, indices.size - 1)
    reflections, energies = recursion(quick_autocorrelation(indices), orders)
    weighed = [
        (energy * cost, m)
        for m, (energy, cost) in enumerate(zip(energies, costs, strict=False), 1)
        if energy > 0
    ]
    order = min(weighed)[1] if weighed else 0
    return Predictor(1, tuple(reflections[:order]), int(indices[0]))


def quick_autocorrelation(indices: Indices) -> list[float]:
    """Autocorrelation of the first differences at lags 0 to 12, from one piece in two; 0 beyond.

    Each piece is divided by its own energy, since bits go by its logarithm; sums of 18 bits are
    exact.
    """
    y = np.concatenate((np.zeros(HISTORY, np.int64), np.diff(indices, prepend=indices[0])))
    stride = 2 * FAST_PIECE if indices.size > 4 * FAST_PIECE else FAST_PIECE
    r = [0.0] * (ORDER_LIMIT + 1)
    for start in range(0, indices.size, stride):
        x = y[start : start + HISTORY + FAST_PIECE]
        bits = int(np.bitwise_or.reduce(np.where(x < 0, ~x, x))).bit_length()
        x = x >> max(bits - SCALED_BITS, 0)
        now = x[HISTORY:]
        sums = [
            int((now * x[HISTORY - lag : x.size - lag]).sum()) for lag in range(FAST_ORDERS + 1)
        ]
        energy = float(sums[0] + now.size)
        for lag, value in enumerate(sums):
            r[lag] += value / energy
    r[0] *= 1 + FAST_NOISE
    return r


def weight(indices: Indices, difference: int, c: list[int]) -> int:
    """256 times about the bits of the prediction errors that are looked at, by the logarithm of
    each block's mean; -1 where one of them is too large to be coded."""
    e = errors_of(differences(indices - indices[0], difference), c)
    if e.size > SEEN * SEEN_OF:
        e = e[np.arange(e.size) // SEEN % SEEN_OF == 0]
    codes = np.where(e < 0, -2 * e - 1, 2 * e)
    if (codes >> U_BITS).any():
        return -1
    return int(logs(BLOCK + 2 * np.add.reduceat(codes, np.arange(0, e.size, BLOCK))).sum())


Sums = NDArray[np.float64]

SHORTEST_CUT = 4096
"""Samples of the shortest packet that is cut off."""

PACKET_BITS = 400
"""Fixed cost of a packet: its row in the table of its cluster, its first states, and averages that
start from one byte (30 to 40 bytes, measured)."""

ROW = 12
"""Bytes of a row in the table of its cluster."""

CUT_ORDERS = (0, 1, 2, 8, 20, ORDER_LIMIT)

SPREAD = 3.8
"""Errors of this many counts and more take a bit each time they double: 5.4 times the mean of a
Laplacian distribution, by its deviation."""


def fitting_packets(
    span: Span, indices: Indices, code: Callable[[slice], bytes]
) -> Iterator[tuple[Span, bytes]]:
    """The packet of a span, or several that are smaller together; ``code`` makes one of a part."""
    whole = code(slice(0, span.ticks))
    edges = [*best_cuts(indices), span.ticks]
    packets = [code(slice(a, b)) for a, b in pairwise(edges)] if len(edges) > 2 else [whole]
    if sum(map(len, packets)) + ROW * (len(packets) - 1) >= len(whole):
        yield span, whole
        return
    for (a, b), packet in zip(pairwise(edges), packets, strict=True):
        yield Span(span.start + a, span.start + b), packet


def best_cuts(indices: Indices) -> list[int]:
    """Where packets begin that take few bits: of the shortest ones those neighbours become one
    that save most by that, until none does."""
    count = indices.size // SHORTEST_CUT
    if count < 2 or (indices == indices[0]).all():
        return [0]
    edges = [indices.size * k // count for k in range(count + 1)]
    views = [PieceSums(indices, edges, order) for order in (0, 1)]

    def cost(first: int, stop: int) -> float:
        return min(view.bits(first, stop) for view in views) + PACKET_BITS

    starts = list(range(count + 1))
    costs = [cost(k, k + 1) for k in range(count)]
    joint = [cost(k, k + 2) for k in range(count - 1)]
    while joint:
        least, place = min((joint[k] - costs[k] - costs[k + 1], k) for k in range(len(joint)))
        if least >= 0:
            break
        costs[place : place + 2] = [joint[place]]
        del starts[place + 1], joint[place]
        for k in (place - 1, place):
            if 0 <= k < len(joint):
                joint[k] = cost(starts[k], starts[k + 2])
    return [edges[k] for k in starts[:-1]]


class PieceSums:
    """The differences of one order, piece by piece: sums of products, lag 0 to 32, and how much a
    piece counts where a predictor serves several."""

    def __init__(self, indices: Indices, edges: Sequence[int], order: int) -> None:
        base = int(indices[0]) if order else int(np.floor(indices.mean() + 0.5))
        y = differences(indices - base, order)
        shift = max(int(np.abs(y).max()).bit_length() - SCALED_BITS, 0)
        y >>= shift
        pieces = pairwise(edges)
        rows = [autocorrelations(np.ascontiguousarray(y[a:b]), 0, 0) for a, b in pieces]
        self.order, self.scale = order, 4.0**shift
        self.sizes = np.diff(edges).astype(np.float64)
        self.sums: Sums = np.array(rows, np.float64)
        self.found: dict[tuple[int, int], tuple[float, float]] = {}
        self.weights = np.ones(len(rows))
        self.weights = np.array([1 / self.best(k, k + 1)[1] for k in range(len(rows))])

    def bits(self, first: int, stop: int) -> float:
        return self.best(first, stop)[0]

    def best(self, first: int, stop: int) -> tuple[float, float]:
        """Bits of one packet of these pieces, and the energy of its errors."""
        # One piece counts as much whatever its weight is.
        if (first, stop) not in self.found:
            self.found[first, stop] = self.weighed(first, stop)
        return self.found[first, stop]

    def weighed(self, first: int, stop: int) -> tuple[float, float]:
        sums, sizes = self.sums[first:stop], self.sizes[first:stop]
        weights = self.weights[first:stop] / self.weights[first:stop].max()
        mixed = (weights[:, None] * sums).sum(axis=0).tolist()
        rounding = (weights * sizes).sum() / self.scale
        reflections, _ = levinson(mixed, float(rounding), ORDER_LIMIT)
        filters = []
        for order in CUT_ORDERS:
            c = Predictor(self.order, tuple(reflections[:order])).coefficients
            if order > len(reflections) or c is None:
                break
            # The energy of errors is that of the samples, weighed by the products of the filter.
            taps = np.array([-(1 << SHIFT), *c])
            products = np.zeros(ORDER_LIMIT + 1)
            products[: order + 1] = np.correlate(taps, taps, "full")[order:] / (1 << 2 * SHIFT)
            filters.append(products)
        table = np.array(filters)
        table[:, 1:] *= 2
        # Lag after lag, in this order: any machine finds the same.
        energy = (table.T[:, :, None] * sums.T[:, None, :]).sum(axis=0)
        energy = np.maximum(energy * self.scale, 0) + sizes / 12
        bits = (sizes * np.log2(1 + SPREAD * np.sqrt(energy / sizes))).sum(axis=1).tolist()
        totals = energy.sum(axis=1).tolist()
        return min(
            (each + COEFFICIENT_COST * order, total)
            for each, order, total in zip(bits, CUT_ORDERS, totals, strict=False)
        )
