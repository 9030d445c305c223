"""Decoded tracks of a file -> its channels, part by part (SPEC 6.3 and clause 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..codecs.events import CodedEvent, decoded
from ..codecs.raw import DTYPES
from ..events import Event, in_order
from ..format.track import Component, Track
from ..recording import Calibration, Channel, Deviation, Span, append_span
from .catalogue import ChannelRef, TrackPair


class GrowingArray:
    """Rows that come piece by piece and end as one array, without both in memory at once: a
    bytearray grows by an eighth, and large ones are moved by the operating system, not copied."""

    def __init__(self) -> None:
        self.room = bytearray()
        self.like: NDArray[Any] | None = None

    def append(self, rows: NDArray[Any]) -> None:
        """rows [ticks, ...], of one dtype and width throughout."""
        if self.like is None:
            self.like = rows[:0].copy()
        self.room += np.ascontiguousarray(rows).data.cast("B")

    def joined(self) -> NDArray[Any] | None:
        """All rows; None where there were none. Nothing is appended after that."""
        if self.like is None:
            return None
        return np.frombuffer(self.room, self.like.dtype).reshape(-1, *self.like.shape[1:])


@dataclass
class Decoded:
    """Decoded packets of one track in order of time."""

    track: Track
    pieces: GrowingArray = field(default_factory=GrowingArray)
    spans: list[Span] = field(default_factory=list)
    doubles: GrowingArray = field(default_factory=GrowingArray)
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

    def exact(self) -> NDArray[np.float64] | None:
        """[samples, components], or None where the counts are all there is."""
        return self.doubles.joined()


def sum_of(lf: Track, d: NDArray[Any], e: NDArray[Any]) -> NDArray[np.int32]:
    """d + e^, clamped to the range of the LF track (DEC-001)."""
    both: NDArray[np.int64] = d.astype(np.int64) + e
    return np.clip(both, lf.count_min, lf.count_max).astype(np.int32)


def add_residual(lf: Decoded, hf: Decoded) -> Decoded:
    """Their sum where both are covered (DEC-003)."""
    d, e = lf.numbers(), hf.numbers()
    out = Decoded(lf.track)
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
    decoded: Decoded, index: int, component: Component, *, hf_only: bool = False
) -> Channel:
    """The channel of component ``index``; ``component`` is its description in the base track."""
    counts, exact = decoded.track.number_format == "counts", decoded.exact()
    a, b, d = component.calibration
    deviation = Deviation(*component.deviation) if component.deviation else None
    return Channel(
        stored=np.ascontiguousarray(decoded.numbers()[:, index]),
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
        exact=None if exact is None else np.ascontiguousarray(exact[:, index]),
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
            own = replace(described, deviation=part.track.components[ref.index].deviation)
            track = self.of_part(part)
            found.append(build_channel(track, ref.index, own, hf_only=self.band == "hf"))
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
    """Those of the chosen channels, by their places there, and those that speak of none, or of one
    that is lost."""
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
    )
