"""How much of a channel's prediction errors those of other channels tell: least squares.

Every sample is measured by the prediction errors around it, since bits are saved by the ratio of
errors. Sums are of integers, exact in any order.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log2

import numpy as np
from numpy.typing import NDArray

from ..codecs.components import prediction_errors, taps_of
from ..codecs.predicted import Predictor
from ..codecs.references import REFERENCE_LIMIT, REFERENCE_SIZE, TAPS, Reference
from ..integers import rdiv
from .predict import linear_predictor

Indices = NDArray[np.int64]
Moments = NDArray[np.float64]

SETTLING = 33
"""Samples at the start of a packet or piece whose prediction errors tell nothing."""

LIKELY = 0.005
"""Squared correlation of two channels' prediction errors from which on a reference is tried."""

CHANCE = 16
"""The same times the samples: chance alone gives 1."""

NORMAL_BITS, CLIPPED_BITS, BLOCK = 8, 16, 32
"""Prediction errors are brought to a mean of 8 bits in each block, and clipped to 16: products of
32 bits, and no packet has 2**20 of them."""

ENOUGH, PIECE = 4096, 256
"""Of longer packets every so manieth piece is looked at."""

LOUD = 1 << 12
"""Prediction errors of more than 16 times the mean count as that, so that a tap does not outweigh
all the rest."""

MOST_TOLD = 0.999
"""Of a channel's energy by others."""

WORTH = 0.004
"""Bits a sample that a further reference has to save."""


def quick_predictor(indices: Indices) -> Predictor:
    first = int(indices[0])
    if (indices == first).all():
        return Predictor(1, (), first)
    predictor, _ = linear_predictor(indices, 1, first)
    return predictor if predictor.coefficients is not None else Predictor(1, (), first)


def likely_sources(errors: NDArray[np.float64]) -> tuple[list[list[int]], float]:
    """For each channel the earlier ones whose errors go with its own, at one of the taps; and the
    bits that this would save if no two of them told the same."""
    size = errors.shape[1]
    energies = np.einsum("it,it->i", errors, errors) + 1
    scores = np.zeros((len(errors),) * 2)
    for tap in TAPS:
        now = errors[:, max(0, -tap) : size - max(0, tap)]
        then = errors[:, max(0, tap) : size + min(0, tap)]
        products = np.einsum("it,jt->ij", now, then)
        scores += products * products / np.multiply.outer(energies, energies)
    enough = max(LIKELY, CHANCE / size)
    found, saved = [], 0.0
    for place in range(len(errors)):
        likely = [(-score, a) for a, score in enumerate(scores[place, :place]) if score > enough]
        best = sorted(likely)[:REFERENCE_LIMIT]
        found.append(sorted(a for _, a in best))
        told = min(-sum(score for score, _ in best), MOST_TOLD)
        saved -= size / 2 * log2(1 - told)
    return found, saved


def choose_sources(
    left: Moments, likely: Sequence[int], size: int
) -> tuple[tuple[int, ...], float]:
    """One after the other while it is worth its bits; and the bits that all of them save."""
    before = first = energy_of(left)
    chosen: list[int] = []
    while len(chosen) < len(likely):
        tried = [
            (energy_of(swept), place, swept)
            for place in range(len(likely))
            if place not in chosen
            for swept in [sweep(left, place)]
        ]
        least, place, swept = min(tried, key=lambda each: each[:2])
        if size / 2 * log2(before / least) < max(8 * REFERENCE_SIZE, WORTH * size):
            break
        before, left = least, swept
        chosen.append(place)
    return tuple(likely[place] for place in sorted(chosen)), size / 2 * log2(first / before)


def moments(
    indices: Indices,
    predictor: Predictor,
    earlier: Sequence[Indices],
    sources: Sequence[int],
    settled: NDArray[np.bool_],
) -> Moments:
    """Sums of products of all taps of the sources and, last, the prediction errors."""
    c, difference = predictor.coefficients or [], predictor.difference
    errors = prediction_errors(indices, difference, c, predictor.base)[settled]
    scales = scales_of(errors) - 4
    rows = [tap[settled] for a in sources for tap in taps_of(earlier[a], difference, c)]
    x = scaled(centred(np.stack([*rows, errors])), scales)
    x[-1].clip(-LOUD, LOUD, out=x[-1])
    found: Moments = np.einsum("it,jt->ij", x, x)
    # Roundings of the scaled numbers: without them, taps that are the same have no inverse.
    found[np.diag_indices(len(rows))] += x.shape[1]
    return found


def centred(x: Indices) -> Indices:
    """16 times what is left without the mean: a base takes what is the same everywhere."""
    size = x.shape[1]
    means = [rdiv(16 * total, size) for total in x.sum(axis=1).tolist()]
    return np.asarray(16 * x - np.array(means, np.int64)[:, None])


def scales_of(errors: Indices) -> Indices:
    """By how many bits the numbers of each block are shifted to the left, for each sample."""
    starts = np.arange(0, errors.size, BLOCK)
    sums = np.add.reduceat(np.abs(errors), starts)
    means = sums // np.diff(np.append(starts, errors.size))
    bits = np.frexp(means.astype(np.float64))[1].astype(np.int64)
    return np.repeat(NORMAL_BITS - np.maximum(bits, 1), BLOCK)[: errors.size]


def scaled(x: Indices, scales: Indices) -> NDArray[np.float64]:
    """Clipped as well: integers, as doubles."""
    most = 1 << CLIPPED_BITS
    rough = x.clip(-most << NORMAL_BITS, most << NORMAL_BITS) << np.maximum(scales, 0)
    wide = np.where(scales < 0, x >> np.maximum(-scales, 0), rough)
    return wide.clip(-most, most).astype(np.float64)


def sweep(m: Moments, source: int) -> Moments:
    """The moments with all taps of a source taken out of everything else (Gauss and Jordan)."""
    for k in range(len(TAPS) * source, len(TAPS) * (source + 1)):
        row = m[k] / m[k, k]
        m = m - np.multiply.outer(m[:, k], row)
        m[k] = row
    return m


def energy_of(m: Moments) -> float:
    return max(float(m[-1, -1]), 1.0)


def fit(
    indices: Indices, predictor: Predictor, earlier: Sequence[Indices], links: tuple[int, ...]
) -> tuple[Reference, ...]:
    """The references of a packet, weights and all; those that would weigh nothing are left out."""
    at = np.arange(indices.size)
    settled = at >= min(SETTLING, indices.size // 2)
    if indices.size > ENOUGH:
        settled &= at // PIECE % (indices.size // ENOUGH + 1) == 0
    left = moments(indices, predictor, earlier, links, settled)
    for place in range(len(links)):
        left = sweep(left, place)
    weights = np.floor(64 * left[:-1, -1] + 0.5).clip(-128, 127).astype(int)
    rows = weights.reshape(-1, len(TAPS)).tolist()
    return tuple(
        Reference(a, (row[0], row[1], row[2]))
        for a, row in zip(links, rows, strict=True)
        if any(row)
    )
