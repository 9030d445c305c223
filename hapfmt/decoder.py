"""One track: packets -> numbers, and their digest (SPEC clauses 9 and 10, 6.9)."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .codecs.components import decode_predicted
from .codecs.knots import KnotParameters, decode_knots
from .codecs.predicted import LpcParameters
from .codecs.quantised import QuanParameters, decode_quantised
from .codecs.raw import RawParameters, decode_raw
from .container.cluster import Packet
from .container.track import Track
from .errors import FormatError, HapfmtError, UnsupportedError
from .limits import Level
from .recording import Span, append_span

Parameters = KnotParameters | QuanParameters | RawParameters | LpcParameters


class TrackDecoder:
    """Decodes packets of one track, each alone (DAT-007)."""

    def __init__(self, track: Track, level: Level, path: str | None = None) -> None:
        if track.unsupported:
            raise UnsupportedError(
                f"track {track.id} needs {track.unsupported}", offset=track.offset, path=path
            )
        self.track = track
        self.level = level
        self.path = path
        self.parameters = self.parse_parameters()

    def parse_parameters(self) -> Parameters:
        track = self.track
        try:
            if track.codec == "KNOT":
                return KnotParameters.parse(track.parameters, self.level, track.offset)
            if track.codec == "QUAN":
                return QuanParameters.parse(track.parameters, self.level, track.offset)
            if track.codec == "LPCR":
                return LpcParameters.parse(track.parameters, self.level, track.offset)
            return RawParameters.parse(track.parameters, track.number_format, track.offset)
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
                if track.number_format != "counts":
                    return numbers
                self.check_range(numbers, packet.offset)
            elif isinstance(parameters, KnotParameters):
                numbers = decode_knots(
                    packet.data, parameters, packet.span, size, self.level, packet.offset
                )
            elif isinstance(parameters, LpcParameters):
                numbers = decode_predicted(
                    packet.data, parameters, packet.span, size, self.level, packet.offset
                )
            else:
                numbers = decode_quantised(
                    packet.data, parameters, packet.span, size, self.level, packet.offset
                )
        except HapfmtError as error:
            raise error.at(path=self.path) from None
        clamped: NDArray[np.int32] = np.clip(numbers, track.count_min, track.count_max).astype(
            np.int32
        )
        return clamped

    def check_range(self, numbers: NDArray[Any], offset: int) -> None:
        """RAW-005."""
        low, high = self.track.count_min, self.track.count_max
        if numbers.min() < low or numbers.max() > high:
            raise FormatError(
                "a raw count outside the declared range", requirement="RAW-005", offset=offset
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
            span.start.to_bytes(8, "little") + span.ticks.to_bytes(8, "little")
            for span in self.spans
        )
        return hashlib.sha256(self.numbers.digest() + coverage).digest()
