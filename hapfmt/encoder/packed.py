"""A track in the making, and its packets of knots: varints, or coded where that is smaller."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.knots import Interpolation, KnotParameters, build_knots
from ..codecs.knots_coded import encode_knots
from ..format.cluster import Packet
from ..format.track import Track
from ..recording import Span

Knots = tuple[Span, NDArray[np.int64], NDArray[np.int64]]
"""Ticks [knots] from the start of a span, and values [knots, components]."""


@dataclass
class Coded:
    """One track, its id still open, and its packets."""

    track: Track
    packets: list[Packet] = field(default_factory=list)
    doubles: list[Sequence[NDArray[np.float64]]] = field(default_factory=list)
    """Of LPCX: for each packet the exact values [samples] of its components."""

    @property
    def size(self) -> int:
        return len(self.track.parameters) + sum(len(packet.data) for packet in self.packets)


Packing = Callable[[Track, Interpolation, int, list[Knots]], Coded]
"""(track, interpolation, step, knots of its packets)."""


def plain_knots(
    track: Track, interpolation: Interpolation, step: int, pieces: Iterable[Knots]
) -> Coded:
    """In varints, values in multiples of the step."""
    parameters = KnotParameters(interpolation, LpcParameters(step))
    coded = Coded(replace(track, codec="KNOT", parameters=parameters.build()))
    for span, ticks, values in pieces:
        coded.packets.append(Packet(0, span.start, span.ticks, build_knots(ticks, values)))
    return coded


def coded_knots(track: Track, parameters: KnotParameters, pieces: Iterable[Knots]) -> Coded:
    """With entropy coding, values are indices of the grid."""
    coded = Coded(replace(track, codec="KNOT", parameters=parameters.build()))
    for span, ticks, indices in pieces:
        data = encode_knots(ticks, indices, parameters.interpolation)
        coded.packets.append(Packet(0, span.start, span.ticks, data))
    return coded


def smaller_knots(
    track: Track, interpolation: Interpolation, step: int, pieces: list[Knots]
) -> Coded:
    """In varints or with entropy coding; the counts are the same."""
    plain = plain_knots(track, interpolation, step, pieces)
    parameters = KnotParameters(interpolation, LpcParameters(step), coded=True)
    coded = coded_knots(track, parameters, pieces)
    return coded if coded.size < plain.size else plain


def fill_below(
    coded: Coded, packets: Iterable[tuple[Span, bytes]], smallest: int | None
) -> Coded | None:
    """The track with these packets; None, and no more of them are made, once it is not below
    ``smallest``."""
    size = coded.size
    for span, data in packets:
        coded.packets.append(Packet(0, span.start, span.ticks, data))
        size += len(data)
        if smallest is not None and size >= smallest:
            return None
    return coded
