"""Cuts a packet at a sample, where what remains can be coded so that it decodes to the same values.

The new packet takes the predictor of the old one: nothing is searched, and no value is rounded
again. Packets of held steps, of predicted counts, of exact values and of words can be cut. Lines
between knots, and textures, cannot: their samples follow from the whole packet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from ..codecs.events import build_events, parse_events
from ..codecs.exact import LINEAR, Lacking, decode_moves, lacking_of, split_packet
from ..codecs.grids import LpcParameters
from ..codecs.knots import (
    KnotParameters,
    build_knots,
    decode_indices,
    encode_knots,
    parse_knots,
)
from ..codecs.predicted import (
    Indices,
    Predictor,
    decode_components,
    encode_component,
    join_components,
    parse_header,
    parts_of,
)
from ..codecs.raw import RawParameters, encode_raw
from ..format.cluster import Packet
from ..format.track import Track
from ..limits import Level
from ..numbers import build_varint
from ..reading.decoder import TrackDecoder


class Cutter:
    """Cuts the packets of these tracks; ``unable`` collects those that it must leave whole."""

    def __init__(self, tracks: Mapping[int, Track], level: Level) -> None:
        self.tracks, self.level = tracks, level
        self.decoders: dict[int, TrackDecoder] = {}
        self.unable: set[int] = set()

    def cut(self, packet: Packet, first: int, last: int) -> Packet | None:
        """The samples of a packet from tick ``first`` to before ``last``, which overlap it; None
        where its codec has no such packet."""
        track = self.tracks[packet.track]
        start, stop = max(first, packet.start), min(last, packet.stop)
        if (start, stop) == (packet.start, packet.stop):
            return packet
        code = CODERS.get(track.codec)
        if code and track.kind == "full" and not track.unsupported:
            decoder = self.decoders.setdefault(track.id, TrackDecoder(track, self.level))
            rows = slice(start - packet.start, stop - packet.start)
            data = code(packet, decoder, rows)
            if data is not None:
                made = replace(packet, start=start, span=stop - start, data=data)
                if same_values(decoder, packet, made, rows):
                    return made
        self.unable.add(track.id)
        return None

    def events(self, packet: Packet, first: int, last: int) -> Packet | None:
        """The events that begin from tick ``first`` to before ``last``."""
        events = parse_events(packet.data, packet.start, packet.span, packet.offset)
        events = [event for event in events if first <= event.tick < last]
        if not events:
            return None
        start = events[0].tick
        span, data = events[-1].tick + 1 - start, build_events(events, start)
        return replace(packet, start=start, span=span, data=data)


def same_values(decoder: TrackDecoder, whole: Packet, part: Packet, rows: slice) -> bool:
    """Whether a part decodes to the values that the packet has there."""
    counts, of_part = decoder.decode(whole), decoder.decode(part)
    exact, exact_of_part = decoder.decode_exact(whole, counts), decoder.decode_exact(part, of_part)
    if exact is not None and exact_of_part is not None:
        counts, of_part = exact, exact_of_part
    return counts[rows].tobytes() == of_part.tobytes()


def code_rows(data: bytes, decoded: list[Indices], rows: slice, offset: int) -> bytes:
    """Rows of the components of a packet, each with its predictor."""
    parts, cut = parts_of(data, len(decoded), offset) or [], list[Indices]()
    packets = []
    for (start, stop), indices in zip(parts, decoded, strict=True):
        predictor, _, _ = parse_header(data[start:stop], offset + start, len(cut))
        cut.append(np.ascontiguousarray(indices[rows]))
        if predictor.difference:
            predictor = replace(predictor, base=int(cut[-1][0]))
        try:
            packets.append(encode_component(cut[-1], predictor, cut[:-1]))
        except ValueError:
            # An error of 34 bits at the new start; an index itself is shorter.
            packets.append(encode_component(cut[-1], Predictor(), cut[:-1]))
    return join_components(packets)


def cut_predicted(packet: Packet, decoder: TrackDecoder, rows: slice) -> bytes:
    grid = decoder.parameters
    assert isinstance(grid, LpcParameters)
    limit, size = grid.index_limit(decoder.level.count_bound), len(decoder.track.components)
    decoded = decode_components(packet.data, packet.span, size, limit, packet.offset)
    return code_rows(packet.data, decoded, rows, packet.offset)


def cut_exact(packet: Packet, decoder: TrackDecoder, rows: slice) -> bytes | None:
    """The counts as they are; corrections of a linear rule are found again, for the samples at the
    new start follow from none before them."""
    parameters, counts = decoder.parameters, decoder.decode(packet).astype(np.int64)
    assert isinstance(parameters, tuple)
    doubles = decoder.decode_exact(packet, counts.astype(np.int32))
    assert doubles is not None
    coded, rest, at = split_packet(packet.data, packet.offset)
    indices = [np.ascontiguousarray(column) for column in counts.T]
    coded = code_rows(coded, indices, rows, at - len(coded))
    ends = (parts_of(rest, len(parameters), at) if rest else None) or [(0, 0)] * len(parameters)
    columns = [np.ascontiguousarray(column[rows]) for column in doubles.T]
    parts = []
    for place, (start, stop) in enumerate(ends):
        of_part = indices[place][rows]
        if parameters[place].rule == LINEAR:
            affine = decoder.track.components[place].calibration
            try:
                lacking = lacking_of(columns[place], parameters[place], affine, of_part, columns)
            except ValueError:
                return None
        else:
            moves = decode_moves(rest[start:stop], indices[place], at + start)[rows]
            together = int(np.bitwise_or.reduce(moves))
            shift = max((together & -together).bit_length() - 1, 0)
            lacking = Lacking(of_part, moves >> shift, shift)
        parts.append(min((lacking.build(recall=recall) for recall in (False, True)), key=len))
    return build_varint(len(coded)) + coded + (join_components(parts) if any(parts) else b"")


def cut_words(packet: Packet, decoder: TrackDecoder, rows: slice) -> bytes:
    assert isinstance(decoder.parameters, RawParameters)
    return encode_raw(decoder.decode(packet)[rows], decoder.parameters.word_size)


def cut_steps(packet: Packet, decoder: TrackDecoder, rows: slice) -> bytes | None:
    """Knots that are held, or one knot alone."""
    parameters, size = decoder.parameters, len(decoder.track.components)
    assert isinstance(parameters, KnotParameters)
    if parameters.coded:
        limit = parameters.grid.index_limit(decoder.level.count_bound)
        way = parameters.interpolation
        ticks, indices = decode_indices(packet.data, way, packet.span, size, limit, packet.offset)
    else:
        ticks, indices = parse_knots(packet.data, size, packet.offset)
    if parameters.interpolation != "hold" and ticks.size > 1:
        return None
    kept = slice(*np.searchsorted(ticks, (rows.start + 1, rows.stop)) - (1, 0))
    ticks = np.maximum(ticks[kept] - rows.start, 0)
    if parameters.coded:
        return encode_knots(ticks, indices[kept], parameters.interpolation)
    return build_knots(ticks, indices[kept])


CODERS: dict[str, Callable[[Packet, TrackDecoder, slice], bytes | None]] = {
    "LPCR": cut_predicted,
    "LPCX": cut_exact,
    "RAWB": cut_words,
    "KNOT": cut_steps,
}
