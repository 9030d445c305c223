"""Which predictor a packet of LPCR gets: fixed polynomials and LPC, by description length.

Reflection coefficients are quantised in the arcsine domain, where steps are finest near 1 (J. D.
Markel, A. H. Gray, "Linear Prediction of Speech", Springer 1976).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import asin, pi

import numpy as np
from numpy.typing import NDArray

from ..codecs.adaptive import ERROR_BITS
from ..codecs.predicted import (
    DIFFERENCE_LIMIT,
    ORDER_LIMIT,
    SHIFT,
    Predictor,
    differences,
    encode_indices,
    step_ups,
)

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 32)
"""LPC orders that are tried; between them the size hardly changes."""

FINALISTS = 3
"""Predictors whose packets are really written, the smallest is kept: the estimate is within 2 %."""

ERROR_LIMIT = 1 << ERROR_BITS
"""Prediction errors beyond it cannot be coded (SPEC RNG-003): differences of 32-bit extremes."""

BLOCK = 32
"""Samples whose scale is taken to be the same."""

REPEAT_SHARE = 0.02
"""From this share of unchanged samples on, coding them as such is tried."""

NOISE = 1e-9
"""Added to the autocorrelation at lag 0, relatively, beside the rounding noise of 1/12 a sample:
near-singular signals (a sine, 20 Hz at 10 kHz) have reflections of magnitude 1 otherwise."""


def encode_best(indices: NDArray[np.int64]) -> bytes:
    """The smallest packet found."""
    if (indices == indices[0]).all():
        return encode_indices(indices, Predictor())
    ranked = sorted(candidates(indices), key=lambda pair: pair[0])[:FINALISTS]
    tried = [predictor for _, predictor in ranked]
    packets = [(encode_indices(indices, predictor), predictor) for predictor in tried]
    best, predictor = min(packets, key=lambda pair: len(pair[0]))
    unchanged = np.count_nonzero(np.diff(indices) == 0) / indices.size
    if unchanged > REPEAT_SHARE:
        marked = Predictor(predictor.difference, predictor.reflections, predictor.base, True)
        other = encode_indices(indices, marked)
        best = min(best, other, key=len)
    return best


def quick_estimate(indices: NDArray[np.int64]) -> float:
    """Bits of a packet by the best of the first three fixed polynomials."""
    first, mean = int(indices[0]), int(np.floor(indices.mean() + 0.5))
    bases = mean, first, first
    return min(estimate(differences(indices - base, order)) for order, base in enumerate(bases))


def candidates(indices: NDArray[np.int64]) -> Iterator[tuple[float, Predictor]]:
    """(estimated bits, predictor)"""
    first, mean = int(indices[0]), int(np.floor(indices.mean() + 0.5))
    for order in range(DIFFERENCE_LIMIT + 1):
        predictor = Predictor(order, (), first if order else mean)
        e = differences(indices - predictor.base, order)
        if np.abs(e).max() < ERROR_LIMIT:
            yield estimate(e), predictor
    for order, base in ((0, mean), (1, first)):
        y = differences(indices - base, order)
        reflections = levinson(y)
        for used, c in enumerate(step_ups(reflections), 1):
            if used not in ORDERS or c is None:
                continue
            left = prediction_errors(y, c)
            if left is not None and np.abs(left).max() < ERROR_LIMIT:
                yield estimate(left) + 8 * used, Predictor(order, tuple(reflections[:used]), base)


def prediction_errors(y: NDArray[np.int64], c: list[int]) -> NDArray[np.int64] | None:
    """What is left of y; float64 sums are exact below 2**53, in any order."""
    if np.abs(y).max() * np.abs(c).sum() >= 1 << 52:
        return None
    sums = np.convolve(y[:-1].astype(np.float64), np.array(c, np.float64))[: y.size - 1]
    predicted = np.zeros(y.size, np.int64)
    predicted[1:] = (sums.astype(np.int64) + (1 << (SHIFT - 1))) >> SHIFT
    return y - predicted


def estimate(e: NDArray[np.int64]) -> float:
    """Bits of Laplacian prediction errors whose scale is that of their block."""
    whole = e.size // BLOCK * BLOCK
    magnitude = np.abs(e).astype(np.float64)
    means = magnitude[:whole].reshape(-1, BLOCK).mean(axis=1)
    bits = BLOCK * np.log2(1 + 2 * np.e * means).sum()
    rest = magnitude[whole:]
    return float(bits + (rest.size * np.log2(1 + 2 * np.e * rest.mean()) if rest.size else 0))


def levinson(y: NDArray[np.int64]) -> list[int]:
    """Indices of the quantised reflection coefficients, up to order 32; fewer where the
    recursion has nothing left to predict."""
    # An exact power of two keeps squares of 32-bit counts within float64.
    bits = int(np.abs(y).max()).bit_length()
    x = np.ldexp(y.astype(np.float64), -bits)
    n = x.size
    orders = min(ORDER_LIMIT, n - 1)
    # Not np.dot: threads of a BLAS wait longer for each other than these sums take.
    r = np.array([np.einsum("i,i->", x[: n - lag], x[lag:]) for lag in range(orders + 1)])
    error = r[0] * (1 + NOISE) + n * 4.0**-bits / 12
    p = np.zeros(0)
    found: list[int] = []
    for order in range(1, orders + 1):
        k = (r[order] - float((p * r[order - 1 : 0 : -1]).sum())) / error if error > 0 else 0.0
        if not abs(k) < 1:
            break
        found.append(min(max(round(asin(k) * 256 / pi), -127), 127))
        p = np.append(p - k * p[::-1], k)
        error *= 1 - k * k
    return found
