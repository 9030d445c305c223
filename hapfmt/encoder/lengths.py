"""Packet lengths of LPCR: long packets for size, shorter ones against damage.

A packet is cut in halves where separate predictors save more than they cost. Sums of products of
each piece tell how well any predictor does there, so that each sample is read once.

Small files get shorter packets, so that one damaged byte takes few samples. These parts keep the
predictors of the packet that was cut. Each part pays for them and for a row of its own. The packets
whose damage would take most samples are cut first, until the cost is too high.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..codecs.exact import RECALL, lacking_of, parse_parameters, split_packet
from ..codecs.grids import LpcParameters
from ..codecs.predicted import (
    ORDER_LIMIT,
    SHIFT,
    Predictor,
    decode_components,
    differences,
    encode_component,
    encode_indices,
    join_components,
    parse_header,
    parts_of,
    split_components,
)
from ..format.cluster import Packet
from ..format.track import Track
from ..limits import LEVELS
from ..numbers import build_varint
from ..recording import Span
from .knots import Coded
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


SMALL = 1 << 20
"""Most bytes of packets in a file that is worth it: in larger files a packet is a small part
anyway."""

SHARE, PRICE = 50, 100
"""A packet should hold at most a 50th of all samples, if that costs at most a 100th of the size."""

SHORTEST = 64
"""Ticks of a part."""

SHORTER_ORDERS = (32, 8)
"""Parts may do with fewer coefficients than the whole."""

LEVEL = LEVELS[2]

Doubles = NDArray[np.float64]


class Opened:
    """A packet taken apart: indices, predictors (None: constant), and of LPCX the doubles."""

    def __init__(self, packet: Packet, track: Track, doubles: Sequence[Doubles]) -> None:
        self.packet, self.exact = packet, track.codec == "LPCX"
        count, data, rest = len(track.components), packet.data, b""
        if self.exact:
            data, rest, _ = split_packet(packet.data, 0)
        grid = LpcParameters()
        if not self.exact:
            grid = LpcParameters.parse(track.parameters, LEVEL, 0)
        limit = grid.index_limit(LEVEL.count_bound)
        self.columns = decode_components(data, packet.span, count, limit, 0)
        self.predictors: list[Predictor | None] = []
        for start, stop in split_components(data, count, 0):
            predictor, constant, _ = parse_header(data[start:stop], 0, len(self.predictors))
            self.predictors.append(None if constant else predictor)
        if self.exact:
            self.affines = [component.calibration for component in track.components]
            self.rules = parse_parameters(track.parameters, count, 0)
            self.doubles = doubles
            ends = parts_of(rest, count, 0) if rest else [(0, 0)] * count
            assert ends is not None
            self.recalls = [a < b and bool(rest[a] & RECALL) for a, b in ends]

    def cut(self, parts: int) -> Iterator[Packet]:
        """In equal parts; ValueError where a predictor does not do for one."""
        span, start = self.packet.span, self.packet.start
        for first, last in pairwise(span * k // parts for k in range(parts + 1)):
            rows = [np.ascontiguousarray(column[first:last]) for column in self.columns]
            body = join_components(
                [
                    shorter_component(row, predictor, rows[:place])
                    for place, (row, predictor) in enumerate(
                        zip(rows, self.predictors, strict=True)
                    )
                ]
            )
            if self.exact:
                beside = list(self.beside(rows, first, last))
                body = build_varint(len(body)) + body
                body += join_components(beside) if any(beside) else b""
            yield Packet(self.packet.track, start + first, last - first, body)

    def beside(self, rows: Sequence[Indices], first: int, last: int) -> Iterator[bytes]:
        """The exact values of a part."""
        values = [np.ascontiguousarray(column[first:last]) for column in self.doubles]
        for place, row in enumerate(rows):
            rule, affine = self.rules[place], self.affines[place]
            lacking = lacking_of(values[place], rule, affine, row, values)
            data = lacking.build(recall=self.recalls[place])
            assert data is not None
            yield data


@dataclass
class Division:
    """The packets of a track, each cut into ``parts`` parts, and the cost of that."""

    coded: Coded
    parts: int = 1
    packets: list[Packet] = field(default_factory=list)
    opened: list[Opened] = field(default_factory=list)

    @property
    def size(self) -> int:
        return sum(len(packet.data) + ROW for packet in self.packets)

    def loss(self, samples: int, size: int) -> float:
        """The share of all samples that a damaged byte takes, times how probable it is here."""
        width = len(self.coded.track.components)
        return sum(
            len(packet.data) / size * packet.span * width / samples for packet in self.packets
        )

    def finer(self, samples: int) -> Division | None:
        """In twice as many parts; None where that would be no use."""
        width = len(self.coded.track.components)
        spans = [packet.span for packet in self.packets]
        enough = max(spans) * width * SHARE <= samples
        if enough or min(spans) < 2 * SHORTEST:
            return None
        if not self.opened:
            doubles = self.coded.doubles or [()] * len(self.packets)
            self.opened = [
                Opened(packet, self.coded.track, exact)
                for packet, exact in zip(self.packets, doubles, strict=True)
            ]
        try:
            packets = [cut for each in self.opened for cut in each.cut(2 * self.parts)]
        except ValueError:
            return None
        return replace(self, parts=2 * self.parts, packets=packets)


def shorten(tracks: Sequence[Coded], others: Sequence[Coded], saved: int) -> None:
    """Cuts the packets of some tracks of a small file, which has ``others`` too. ``saved``: bytes
    that tracks of several channels save, whose damage takes more."""
    every = [*tracks, *others]
    size = sum(len(packet.data) + ROW for coded in every for packet in coded.packets)
    samples = sum(
        packet.span * len(coded.track.components) for coded in every for packet in coded.packets
    )
    if not 0 < size < SMALL:
        return
    divisions = [
        Division(coded, packets=list(coded.packets))
        for coded in tracks
        if coded.track.codec in ("LPCR", "LPCX") and coded.packets
    ]
    room = size / PRICE + saved / SHARE
    finer: dict[int, Division | None] = {}
    while True:
        best, most = -1, 0.0
        for place, division in enumerate(divisions):
            if place not in finer:
                finer[place] = division.finer(samples)
            other = finer[place]
            if other is None or other.size - division.size > room:
                continue
            gain = division.loss(samples, size) - other.loss(samples, size)
            worth = gain / max(other.size - division.size, 1)
            if worth > most:
                best, most = place, worth
        if best < 0:
            break
        chosen = finer.pop(best)
        assert chosen is not None
        room -= chosen.size - divisions[best].size
        divisions[best] = chosen
    for division in divisions:
        division.coded.packets = division.packets


def shorter_component(row: Indices, whole: Predictor | None, earlier: Sequence[Indices]) -> bytes:
    """A component packet of a part, by the predictor of the whole."""
    if whole is None or (row == row[0]).all():
        return encode_indices(row, Predictor())
    base = int(row[0]) if whole.difference else whole.base
    found = []
    for order in SHORTER_ORDERS:
        if order == SHORTER_ORDERS[0] or order < len(whole.reflections):
            predictor = replace(whole, base=base, reflections=whole.reflections[:order])
            found.append(encode_component(row, predictor, earlier))
    return min(found, key=len)
