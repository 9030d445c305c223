"""How long the packets of LPCR are: cut in halves where predictors of their own save more than they
cost.

Sums of products of each piece of a packet tell how well any predictor does there, so that each
sample is looked at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..codecs.predicted import ORDER_LIMIT, SHIFT, Predictor, differences
from ..recording import Span
from .predict import COEFFICIENT_COST, SCALED_BITS, autocorrelations, levinson

Indices = NDArray[np.int64]
Sums = NDArray[np.float64]

PIECE = 4096
"""Samples of the shortest packet that is cut off."""

PACKET_BITS = 400
"""Fixed cost of a packet: its row in the table of its cluster, its first states, and averages that
start from one byte (30 to 40 bytes, measured)."""

ROW = 12
"""Bytes of a row in the table of its cluster."""

ORDERS = (0, 1, 2, 8, 20, ORDER_LIMIT)

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
    count = indices.size // PIECE
    if count < 2 or (indices == indices[0]).all():
        return [0]
    edges = [indices.size * k // count for k in range(count + 1)]
    views = [View(indices, edges, order) for order in (0, 1)]

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


class View:
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
        for order in ORDERS:
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
            for each, order, total in zip(bits, ORDERS, totals, strict=False)
        )
