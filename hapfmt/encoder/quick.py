"""Which predictor a packet gets, with as little work as tells it.

A fixed polynomial, or LPC of the differences: the order by the energies that the recursion leaves,
and of the two the one whose prediction errors are the smaller. kernels/ has the same in C.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..codecs.predicted import (
    ORDER_LIMIT,
    TABLE,
    Predictor,
    differences,
    encode_indices,
    encode_predicted,
    errors_of,
)
from ..kernels import compiled
from .predict import LIMITS, SCALED_BITS, logs, recursion

Indices = NDArray[np.int64]

ORDERS, POLYNOMIALS = 12, 3
"""LPC of order 12 and fixed polynomials of order 3 at most (32 and 4: 0.4 % smaller, measured, at
twice the work)."""

COST = 24
"""Bits that a coefficient is to save: it takes 8, and time (the mean size is the same)."""

PIECE, HISTORY, NOISE = 1024, 36, 1e-6
"""Samples whose autocorrelation is taken at a time, and those before them that it reaches into;
relative noise, without which a sine has reflections of magnitude 1."""

BLOCK, U_BITS = 32, 35
"""Errors whose mean is taken at a time; bits of the largest error and its sign."""

REPEAT_SHARE = 0.25
"""Where more samples than that repeat the one before, they are marked (gloves: half the size)."""

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
        return encode_predicted(plain, predictor)
    except ValueError:
        # An error too large in what was not looked at.
        return encode_predicted(plain, Predictor(0, (), first))


def quick_predictor(indices: Indices) -> Predictor:
    """With repeats where they are frequent."""
    repeats = np.count_nonzero(indices[1:] == indices[:-1]) > REPEAT_SHARE * indices.size
    return replace(choose_quick(indices), repeats=bool(repeats))


def choose_quick(indices: Indices) -> Predictor:
    first, costs = int(indices[0]), costs_of(indices.size)
    if compiled is not None:
        found, coefficients = np.zeros(ORDERS, np.int8), np.zeros(ORDERS, np.int32)
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
    linear = linear_predictor(indices, costs.tolist())
    c = linear.coefficients
    if c:
        size = weight(indices, 1, c)
        if size >= 0 and (smallest < 0 or size < smallest):
            return linear
    return best


@lru_cache(maxsize=32)
def costs_of(size: int) -> NDArray[np.float64]:
    """By what factor each order is to lower the energy of so many samples."""
    return np.asarray(2.0 ** (np.arange(1, ORDERS + 1) * (2 * COST / size)))


def linear_predictor(indices: Indices, costs: list[float]) -> Predictor:
    """The order whose energy best repays its coefficients."""
    orders = min(ORDERS, indices.size - 1)
    reflections, energies = recursion(quick_autocorrelation(indices), orders)
    weighed = [
        (energy * cost, m)
        for m, (energy, cost) in enumerate(zip(energies, costs, strict=False), 1)
        if energy > 0
    ]
    order = min(weighed)[1] if weighed else 0
    return Predictor(1, tuple(reflections[:order]), int(indices[0]))


def quick_autocorrelation(indices: Indices) -> list[float]:
    """Of the first differences, lags 0 to 12 (and 0 for further ones), of one piece in two.

    Each piece is divided by its own energy, since bits go by its logarithm; sums of 18 bits are
    exact.
    """
    y = np.concatenate((np.zeros(HISTORY, np.int64), np.diff(indices, prepend=indices[0])))
    stride = 2 * PIECE if indices.size > 4 * PIECE else PIECE
    r = [0.0] * (ORDER_LIMIT + 1)
    for start in range(0, indices.size, stride):
        x = y[start : start + HISTORY + PIECE]
        bits = int(np.bitwise_or.reduce(np.where(x < 0, ~x, x))).bit_length()
        x = x >> max(bits - SCALED_BITS, 0)
        now = x[HISTORY:]
        sums = [int((now * x[HISTORY - lag : x.size - lag]).sum()) for lag in range(ORDERS + 1)]
        energy = float(sums[0] + now.size)
        for lag, value in enumerate(sums):
            r[lag] += value / energy
    r[0] *= 1 + NOISE
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
