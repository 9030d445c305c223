"""Packets -> pieces: the numbers or events of one packet, cut to the ticks asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..codecs.events import CodedEvent
from ..format.cluster import Packet
from ..format.track import Track
from .decoder import TrackDecoder

NOTHING = np.zeros((0, 1), np.int32)
"""The numbers of a layer."""


class Piece(NamedTuple):
    """One decoded packet: numbers [ticks, components] from tick ``start`` on; exact: the source's
    doubles, likewise, where they stand beside the counts and were asked for; events of a layer,
    which has no numbers."""

    track: Track
    start: int
    numbers: NDArray[Any]
    exact: NDArray[np.float64] | None = None
    events: Sequence[CodedEvent] = ()
    offset: int = 0
    """Of the packet in the file."""

    @property
    def digested(self) -> NDArray[Any]:
        """The numbers that a digest is taken of (SPEC 6.9)."""
        return self.numbers if self.exact is None else self.exact


class PieceDecoder:
    """Decodes packets of some tracks within ``ranges``, {id: (first tick, tick after the last)}."""

    def __init__(
        self,
        decoders: Mapping[int, TrackDecoder],
        ranges: Mapping[int, tuple[int, int]],
        *,
        exact: bool,
    ) -> None:
        self.decoders = decoders
        self.ranges = ranges
        self.exact = exact

    def decode(self, packet: Packet) -> Piece:
        decoder = self.decoders[packet.track]
        first, last = self.ranges[packet.track]
        if decoder.track.kind == "events":
            events = [e for e in decoder.decode_events(packet) if first <= e.tick < last]
            return Piece(decoder.track, packet.start, NOTHING, None, events, packet.offset)
        numbers = decoder.decode(packet)
        doubles = decoder.decode_exact(packet, numbers) if self.exact else None
        a, b = max(first - packet.start, 0), min(last - packet.start, packet.span)
        doubles = None if doubles is None else doubles[a:b]
        return Piece(decoder.track, packet.start + a, numbers[a:b], doubles, (), packet.offset)
