"""Shorter packets in small files, so that one damaged byte takes few samples.

A packet that is cut in two keeps its predictors; each part pays for them and for a row of its own.
The packets whose damage would take most are cut first, until they would cost too much.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..codecs.components import (
    decode_components,
    encode_component,
    join_components,
    parts_of,
    split_components,
)
from ..codecs.exact import RECALL, lacking_of, parse_parameters, split_packet
from ..codecs.grids import LpcParameters
from ..codecs.predicted import Predictor, encode_indices, parse_header
from ..format.cluster import Packet
from ..format.track import Track
from ..integers import build_varint
from ..limits import LEVELS
from .lengths import ROW
from .packed import Coded

SMALL = 1 << 20
"""Bytes of packets in a file that is worth it: of larger ones a packet is a small part anyway."""

SHARE, PRICE = 50, 100
"""A packet should hold at most a 50th of all samples, if that costs at most a 100th of the size."""

SHORTEST = 64
"""Ticks of a part."""

ORDERS = (32, 8)
"""Parts may do with fewer coefficients than the whole."""

LEVEL = LEVELS[2]

Indices = NDArray[np.int64]
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
    for order in ORDERS:
        if order == ORDERS[0] or order < len(whole.reflections):
            predictor = replace(whole, base=base, reflections=whole.reflections[:order])
            found.append(encode_component(row, predictor, earlier))
    return min(found, key=len)
