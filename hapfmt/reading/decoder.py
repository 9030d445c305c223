"""Packets of one track -> decoded pieces, and the track's checksum (SPEC clauses 9 and 10, 6.9).

A piece has the numbers or events of one packet, cut to the requested ticks.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..codecs import knots, predicted, quantised
from ..codecs.events import CodedEvent, parse_events
from ..codecs.exact import ExactParameters, decode_counts, decode_exact, parse_parameters
from ..codecs.grids import LpcParameters
from ..codecs.knots import KnotParameters
from ..codecs.quantised import QuanParameters
from ..codecs.raw import RawParameters, decode_raw
from ..errors import FormatError, HapfmtError, ParameterError
from ..format.cluster import Packet
from ..format.layout import COVERED_SPAN
from ..format.track import Track, unsupported_track
from ..limits import Level
from ..recording import Span, append_span

Exact = tuple[ExactParameters, ...]
Parameters = KnotParameters | QuanParameters | RawParameters | LpcParameters | Exact


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
            if track.codec == "LPCX":
                return self.parse_exact()
            return RawParameters.parse(track.parameters, track.number_format, track.offset)
        except HapfmtError as error:
            raise error.at(path=self.path) from None

    def parse_codebook(self) -> QuanParameters:
        try:
            return codebook_of(self.track.parameters, self.level)
        except HapfmtError:
            # Once more, to tell the place.
            return QuanParameters.parse(self.track.parameters, self.level, self.track.offset)

    def parse_exact(self) -> Exact:
        track = self.track
        lossy = track.contract or any(c.deviation for c in track.components)
        if track.kind != "full" or lossy:
            raise FormatError(
                "exact values in a track that is not lossless",
                requirement="EXA-001",
                offset=track.offset,
            )
        return parse_parameters(track.parameters, len(track.components), track.offset)

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
                counts.astype(np.int64),
                packet.offset,
            )
        except HapfmtError as error:
            raise error.at(path=self.path) from None

    def decode_events(self, packet: Packet) -> list[CodedEvent]:
        """Of a track of kind events, in the order of the bytes."""
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
                    self.check_range(numbers, packet.offset, "RAW-005")
                return numbers
            if isinstance(parameters, tuple):
                counts = decode_counts(packet.data, packet.span, size, self.level, packet.offset)
                self.check_range(counts, packet.offset, "EXA-003")
                return counts.astype(np.int32)
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
            if parameters is None:
                raise ParameterError("a layer of events has no numbers")
            return quantised.decode_within(
                packet.data, parameters, packet.span, size, self.level, packet.offset,
                track.count_min, track.count_max,
            )  # fmt: skip
        except HapfmtError as error:
            raise error.at(path=self.path) from None

    def check_range(self, numbers: NDArray[Any], offset: int, requirement: str) -> None:
        """What is lossless is never clamped."""
        low, high = self.track.count_min, self.track.count_max
        if numbers.min() < low or numbers.max() > high:
            raise FormatError(
                "a lossless count outside the declared range",
                requirement=requirement,
                offset=offset,
            )


class TrackDigest:
    """SHA-256 of a track's canonical decode (SPEC 6.9), packet by packet in order of time."""

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
    They are NaN if they break a rule; ``fault`` tells which one (EXA-006).
    """

    track: Track
    start: int
    numbers: NDArray[Any]
    exact: NDArray[np.float64] | None = None
    events: Sequence[CodedEvent] = ()
    offset: int = 0
    """Of the packet in the file."""
    fault: FormatError | None = None

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

    def decode(self, packet: Packet) -> DecodedPiece:
        decoder = self.decoders[packet.track]
        first, last = self.ranges[packet.track]
        if decoder.track.kind == "events":
            events = [e for e in decoder.decode_events(packet) if first <= e.tick < last]
            return DecodedPiece(decoder.track, packet.start, NOTHING, None, events, packet.offset)
        numbers = decoder.decode(packet)
        doubles: NDArray[np.float64] | None = None
        fault = None
        try:
            doubles = decoder.decode_exact(packet, numbers) if self.exact else None
        except FormatError as error:
            # The counts hold all the same.
            doubles, fault = np.full(numbers.shape, np.nan), error
        a, b = max(first - packet.start, 0), min(last - packet.start, packet.span)
        doubles = None if doubles is None else doubles[a:b]
        return DecodedPiece(
            decoder.track, packet.start + a, numbers[a:b], doubles, (), packet.offset, fault
        )
