"""Where the knots of an LF track are, as long as they are few."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ...codecs.knots import KnotParameters, parse_knots
from ...codecs.knots_coded import decode_indices, parse_start
from ...format.cluster import Packet
from ...format.track import Track
from ...errors import FormatError
from ...reading.catalogue import ChannelRef
from ...reading.reader import Reader
from ...reading.seconds import tick_range

SHOWN = 600
"""Dots of more knots would hide the line."""
PACKETS = 4096
"""More packets than this hold too many knots to show."""
CODED = 5000
"""A packet of more coded knots is not decoded to show a few of them."""


def knots_within(
    reader: Reader, ref: ChannelRef, start: Fraction, stop: Fraction
) -> NDArray[np.int64] | None:
    """Ticks of the knots in [start, stop), ascending; None where they are too many to show, or the
    channel is not coded in knots."""
    tracks = {part.track.id: part.track for part in ref.parts if part.track.codec == "KNOT"}
    if not tracks:
        return None
    ranges = {id_: tick_range(track.rate, start, stop) for id_, track in tracks.items()}
    before = reader.lost
    found: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    total = 0
    try:
        for number, packet in enumerate(reader.packets(ranges, start, stop)):
            first, last = ranges[packet.track]
            ticks = ticks_of(packet, tracks[packet.track], reader)
            if ticks is None or number >= PACKETS:
                return None
            ticks = ticks[(ticks >= first) & (ticks < last)]
            total += ticks.size
            if total > SHOWN:
                return None
            found.append(ticks)
    finally:
        reader.lost = before
    return np.unique(np.concatenate(found))


def ticks_of(packet: Packet, track: Track, reader: Reader) -> NDArray[np.int64] | None:
    level, components = reader.catalogue.level, len(track.components)
    try:
        parameters = KnotParameters.parse(track.parameters, level, track.offset)
        if not parameters.coded:
            return parse_knots(packet.data, components, packet.offset)[0] + packet.start
        limit = parameters.grid.index_limit(level.count_bound)
        row = packet.data, packet.span, components, limit, packet.offset
        if parse_start(*row)[1] > CODED:
            return None
        ticks, _ = decode_indices(row[0], parameters.interpolation, *row[1:])
    except FormatError:
        return np.zeros(0, np.int64)  # reading says what is wrong, or has said so
    return ticks + packet.start
