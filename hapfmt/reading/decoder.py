"""Packets -> decoded pieces of tracks -> channels, part by part; and the checksum of a track.

SPEC 6.3, 11.5, clauses 9 and 10. A piece has the numbers or events of one packet, cut to the
requested ticks.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..codecs import knots, noise, predicted, quantised, transform
from ..codecs.events import CodedEvent, decoded, parse_events
from ..codecs.exact import ExactParameters, decode_counts, decode_exact, parse_parameters
from ..codecs.grids import LpcParameters
from ..codecs.knots import KnotParameters
from ..codecs.noise import NoiseParameters
from ..codecs.quantised import QuanParameters
from ..codecs.raw import DTYPES, RawParameters, decode_raw
from ..codecs.transform import TransformParameters
from ..errors import FormatError, HapfmtError, ParameterError
from ..format.cluster import Packet
from ..format.layout import COVERED_SPAN
from ..format.track import SYNTHETIC, Component, Track, unsupported_track
from ..limits import Level
from ..recording import Calibration, Channel, Deviation, Event, Span, append_span, in_order
from ..spool import MEMORY, GrowingArray, Memory
from .catalogue import ChannelRef, TrackPair

Exact = tuple[ExactParameters, ...]
Parameters = (
    KnotParameters
    | QuanParameters
    | RawParameters
    | LpcParameters
    | TransformParameters
    | NoiseParameters
    | Exact
)


CODEBOOKS = 128
"""Kept parsed at a time: one takes up to 250 kB, and a file may describe 65 534 in 17 MB."""


@lru_cache(maxsize=CODEBOOKS)
def codebook_of(parameters: bytes, level: Level) -> QuanParameters:
    return QuanParameters.parse(parameters, level, 0)


class TrackDecoder:
    """Decodes packets of one track, each alone (DAT-007)."""

    def __init__(self, track: Track, level: Level, path: str | None = None) -> None:
        if track.unsupported:
            raise unsupported_track(track, path)
        self.track = track
        self.level = level
        self.path = path
        parsed = self.parse_parameters()
        self.parsed = None if isinstance(parsed, QuanParameters) else parsed

    @property
    def parameters(self) -> Parameters:
        return self.parsed or codebook_of(self.track.parameters, self.level)

    def parse_parameters(self) -> Parameters | None:
        track = self.track
        try:
            if track.codec == "EVNT":
                return None
            if track.codec == "KNOT":
                return KnotParameters.parse(track.parameters, self.level, track.offset)
            if track.codec == "QUAN":
                return self.parse_codebook()
            if track.codec == "LPCR":
                return LpcParameters.parse(track.parameters, self.level, track.offset)
            if track.codec == "MDCT":
                return TransformParameters.parse(track.parameters, track.offset)
            if track.codec == "LPCX":
                lossy = track.contract or any(c.deviation for c in track.components)
                if track.kind != "full" or lossy:
                    raise FormatError(
                        "exact values in a track that is not lossless",
                        requirement="EXA-001",
                        offset=track.offset,
                    )
                return parse_parameters(track.parameters, len(track.components), track.offset)
            if track.codec == "NOIS":
                if track.kind == "lf" or track.contract:
                    raise FormatError(
                        "a synthetic texture in an LF track, or with a contract",
                        requirement="NOI-001",
                        offset=track.offset,
                    )
                return NoiseParameters.parse(track.parameters, track.offset)
            return RawParameters.parse(track.parameters, track.number_format, track.offset)
        except HapfmtError as error:
            raise error.at(path=self.path) from None

    def parse_codebook(self) -> QuanParameters:
        try:
            return codebook_of(self.track.parameters, self.level)
        except HapfmtError:
            # Decode again, to report the place.
            return QuanParameters.parse(self.track.parameters, self.level, self.track.offset)

    def decode_exact(self, packet: Packet, counts: NDArray[np.int32]) -> NDArray[np.float64] | None:
        """The source's doubles [span, components], for the counts that ``decode`` gave of the same
        packet; None where the counts are all there is."""
        if not isinstance(self.parameters, tuple):
            return None
        try:
            return decode_exact(
                packet.data,
                self.parameters,
                [component.calibration for component in self.track.components],
                counts,
                packet.offset,
                self.track.parameters,
            )
        except HapfmtError as error:
            raise error.at(path=self.path) from None

    def decode_events(self, packet: Packet) -> list[CodedEvent]:
        """The events of a track of kind events, in the order of the bytes."""
        try:
            return parse_events(packet.data, packet.start, packet.span, packet.offset)
        except HapfmtError as error:
            raise error.at(path=self.path) from None

    def decode(self, packet: Packet) -> NDArray[Any]:
        """[span, components]: int32 counts, clamped to the declared range (DEC-001), or words."""
        track, parameters = self.track, self.parameters
        size = len(track.components)
        try:
            if isinstance(parameters, RawParameters):
                numbers = decode_raw(
                    packet.data, parameters, track.number_format, packet.span, size, packet.offset
                )
                if track.number_format == "counts":
                    self.check_range(numbers, packet.offset)
                return numbers
            if isinstance(parameters, tuple):
                return decode_counts(
                    packet.data, packet.span, size, self.level, packet.offset,
                    track.count_min, track.count_max,
                )  # fmt: skip
            if isinstance(parameters, KnotParameters):
                coded = parameters.coded
                within = knots.decode_coded_within if coded else knots.decode_within
                return within(
                    packet.data, parameters, packet.span, size, self.level, packet.offset,
                    track.count_min, track.count_max,
                )  # fmt: skip
            if isinstance(parameters, LpcParameters):
                return predicted.decode_within(
                    packet.data, parameters, packet.span, size, self.level, packet.offset,
                    track.count_min, track.count_max,
                )  # fmt: skip
            if isinstance(parameters, TransformParameters):
                return transform.decode_within(
                    packet.data, parameters, packet.span, size, self.level, packet.offset,
                    track.count_min, track.count_max,
                )  # fmt: skip
            if isinstance(parameters, NoiseParameters):
                return noise.decode_within(
                    packet.data, parameters, packet.span, size, packet.offset,
                    track.count_min, track.count_max,
                )  # fmt: skip
            if parameters is None:
                raise ParameterError("a layer of events has no numbers")
            return quantised.decode_within(
                packet.data, parameters, packet.span, size, self.level, packet.offset,
                track.count_min, track.count_max,
            )  # fmt: skip
        except HapfmtError as error:
            raise error.at(path=self.path) from None

    def check_range(self, numbers: NDArray[Any], offset: int) -> None:
        """What is lossless is never clamped."""
        low, high = self.track.count_min, self.track.count_max
        if numbers.min() < low or numbers.max() > high:
            raise FormatError(
                "a lossless count outside the declared range",
                requirement="RAW-005",
                offset=offset,
            )


class TrackDigest:
    """SHA-256 of a track's canonical decode (SPEC 11.5), packet by packet in order of time."""

    def __init__(self) -> None:
        self.numbers = hashlib.sha256()
        self.spans: list[Span] = []

    def update(self, start: int, numbers: NDArray[Any]) -> None:
        self.numbers.update(np.ascontiguousarray(numbers).tobytes())
        append_span(self.spans, Span(start, start + len(numbers)))

    def digest(self) -> bytes:
        coverage = b"".join(
            COVERED_SPAN.pack(start=span.start, ticks=span.ticks) for span in self.spans
        )
        return hashlib.sha256(self.numbers.digest() + coverage).digest()


NOTHING = np.zeros((0, 1), np.int32)
"""The numbers of a layer."""


class DecodedPiece(NamedTuple):
    """One decoded packet: numbers [ticks, components] from tick ``start`` on, or events of a layer.

    exact: the source's doubles, of the same shape, if the packet has them and they were requested.
    """

    track: Track
    start: int
    numbers: NDArray[Any]
    exact: NDArray[np.float64] | None = None
    events: Sequence[CodedEvent] = ()
    offset: int = 0
    """Offset of the packet in the file."""

    @property
    def digested(self) -> NDArray[Any]:
        """The numbers that a digest is taken of (SPEC 11.5)."""
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

    def decode(self, packet: Packet) -> DecodedPiece:
        decoder = self.decoders[packet.track]
        first, last = self.ranges[packet.track]
        if decoder.track.kind == "events":
            events = [e for e in decoder.decode_events(packet) if first <= e.tick < last]
            return DecodedPiece(decoder.track, packet.start, NOTHING, None, events, packet.offset)
        numbers = decoder.decode(packet)
        doubles = decoder.decode_exact(packet, numbers) if self.exact else None
        a, b = max(first - packet.start, 0), min(last - packet.start, packet.span)
        doubles = None if doubles is None else doubles[a:b]
        return DecodedPiece(
            decoder.track, packet.start + a, numbers[a:b], doubles, (), packet.offset
        )


@dataclass
class Decoded:
    """Decoded packets of one track in order of time."""

    track: Track
    store: Memory = MEMORY
    expected: int = 0
    spans: list[Span] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.pieces = GrowingArray(self.store, self.expected)
        self.doubles = GrowingArray(self.store, self.expected)
        """Exact values, for each of the pieces or for none."""

    def add(
        self, start: int, numbers: NDArray[Any], exact: NDArray[np.float64] | None = None
    ) -> None:
        """numbers [ticks, components] from tick ``start`` on; exact: the same"""
        if not len(numbers):
            return
        append_span(self.spans, Span(start, start + len(numbers)))
        self.pieces.append(numbers)
        if exact is not None:
            self.doubles.append(exact)

    def numbers(self) -> NDArray[Any]:
        """[samples, components]"""
        joined = self.pieces.joined()
        if joined is None:
            dtype = DTYPES.get(self.track.number_format, np.dtype(np.int32))
            return np.zeros((0, len(self.track.components)), dtype)
        return joined


def sum_of(lf: Track, d: NDArray[Any], e: NDArray[Any]) -> NDArray[np.int32]:
    """d + e^, clamped to the range of the LF track (DEC-001)."""
    both: NDArray[np.int64] = d.astype(np.int64) + e
    return np.clip(both, lf.count_min, lf.count_max).astype(np.int32)


def add_residual(lf: Decoded, hf: Decoded) -> Decoded:
    """Their sum where both are covered (DEC-003)."""
    d, e = lf.numbers(), hf.numbers()
    out = Decoded(lf.track, lf.store)
    for (i, j), span in intersect(lf.spans, hf.spans):
        out.add(span.start, sum_of(lf.track, d[i : i + span.ticks], e[j : j + span.ticks]))
    return out


def intersect(a: Sequence[Span], b: Sequence[Span]) -> list[tuple[tuple[int, int], Span]]:
    """Common spans, and at which sample of a and of b each starts."""
    out = []
    i = j = at = bt = 0
    while i < len(a) and j < len(b):
        start, stop = max(a[i].start, b[j].start), min(a[i].stop, b[j].stop)
        if start < stop:
            out.append(((at + start - a[i].start, bt + start - b[j].start), Span(start, stop)))
        if a[i].stop <= b[j].stop:
            at += a[i].ticks
            i += 1
        else:
            bt += b[j].ticks
            j += 1
    return out


def build_channel(
    decoded: Decoded,
    index: int,
    component: Component,
    *,
    hf_only: bool = False,
    synthetic: bool = False,
) -> Channel:
    """The channel of component ``index``; ``component`` is its description in the base track."""
    counts, exact = decoded.track.number_format == "counts", decoded.doubles.joined()
    kept = decoded.store.kept
    a, b, d = component.calibration
    deviation = Deviation(*component.deviation) if component.deviation else None
    return Channel(
        stored=kept(np.ascontiguousarray(decoded.numbers()[:, index])),
        rate=decoded.track.rate,
        coverage=tuple(decoded.spans),
        calibration=Calibration(a, 0 if hf_only else b, d) if counts else None,
        label=component.label,
        unit=component.unit,
        quantity=component.quantity,
        axis=component.axis,
        group=component.group,
        body_site=component.body_site,
        device=component.device,
        deviation=deviation,
        exact=None if exact is None else kept(np.ascontiguousarray(exact[:, index])),
        synthetic=synthetic,
    )


Band = Literal["full", "lf", "hf"]
BANDS: tuple[Band, ...] = ("full", "lf", "hf")


def wanted_tracks(chosen: Sequence[ChannelRef], band: Band) -> list[Track]:
    """The tracks that a band of some channels needs, each once."""
    tracks: dict[int, Track] = {}
    for part in (part for ref in chosen for part in ref.parts):
        if band != "hf":
            tracks[part.track.id] = part.track
        if band != "lf" and part.residual is not None:
            tracks[part.residual.id] = part.residual
    return list(tracks.values())


class Assembly:
    """Puts together the channels of one band and the events of the layers.

    ``tracks``: the decoded tracks that ``wanted_tracks`` names.
    """

    def __init__(self, tracks: dict[int, Decoded], band: Band) -> None:
        self.tracks = tracks
        self.band = band
        self.sums: dict[int, Decoded] = {}
        self.layers: dict[int, tuple[Track, list[CodedEvent]]] = {}
        self.event_count = 0

    def add_events(self, layer: Track, events: Sequence[CodedEvent]) -> None:
        self.layers.setdefault(layer.id, (layer, []))[1].extend(events)
        self.event_count += len(events)

    def events(self) -> list[Event]:
        """In order of time; channels are their numbers (EVT-004)."""
        rows = [self.layers[id_] for id_ in sorted(self.layers)]
        return in_order(decoded(event, layer) for layer, events in rows for event in events)

    def channel(self, ref: ChannelRef) -> Channel:
        return join(self.parts(ref))

    def parts(self, ref: ChannelRef) -> list[Channel]:
        """What each track gives of the channel, as the first one describes it (TRK-018)."""
        described = ref.track.components[ref.index]
        found = []
        for part in ref.parts:
            own = part.track.components[ref.index]
            if own is not described:
                own = replace(described, deviation=own.deviation)
            track = self.of_part(part)
            fast = None if self.band == "lf" else part.residual
            synthetic = SYNTHETIC in (part.track.codec, fast and fast.codec)
            found.append(
                build_channel(track, ref.index, own, hf_only=self.band == "hf", synthetic=synthetic)
            )
        return found

    def of_part(self, part: TrackPair) -> Decoded:
        if self.band == "hf":
            return self.tracks[part.residual.id] if part.residual else Decoded(part.track)
        if self.band == "lf" or part.track.kind != "lf":
            return self.tracks[part.track.id]
        if part.residual is None:
            # Its HF track is lost: what is left is not the channel (DEC-003).
            return Decoded(part.track)
        if part.track.id not in self.sums:
            lf, hf = self.tracks[part.track.id], self.tracks[part.residual.id]
            self.sums[part.track.id] = add_residual(lf, hf)
        return self.sums[part.track.id]


def events_of(
    events: Sequence[Event], known: Sequence[ChannelRef], chosen: Sequence[ChannelRef]
) -> tuple[Event, ...]:
    """Events of the chosen channels, numbered by their places there, and events without a channel
    or of a lost one."""
    places: dict[int | str | None, int | None] = {None: None}
    for place, ref in enumerate(chosen):
        places.setdefault(ref.number, place)
    others = {ref.number for ref in known} - places.keys()
    return tuple(
        replace(event, channel=places.get(event.channel))
        for event in events
        if event.channel not in others
    )


def join(parts: Sequence[Channel]) -> Channel:
    """Parts in order of time as one channel."""
    first = parts[0]
    if len(parts) == 1:
        return first
    spans: list[Span] = []
    for part in parts:
        for span in part.coverage:
            append_span(spans, span)
    exact = None
    if any(part.exact is not None for part in parts):
        exact = np.concatenate([part.samples() for part in parts])
    deviations = [part.deviation for part in parts if part.deviation]
    return replace(
        first,
        stored=np.concatenate([part.stored for part in parts]),
        coverage=tuple(spans),
        deviation=Deviation(
            max(each.declared for each in deviations), max(each.largest for each in deviations)
        )
        if deviations
        else None,
        exact=exact,
        synthetic=any(part.synthetic for part in parts),
    )
