"""Decoded tracks of a file -> its channels, part by part (SPEC 6.3 and clause 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ..codecs.events import CodedEvent
from ..codecs.layers import decoded
from ..format.track import Track
from ..events import Event, in_order
from ..recording import Channel, Deviation, Span, append_span
from .catalogue import ChannelRef, Part
from .reconstruct import Decoded, add_residual, build_channel

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
    """Puts together the channels of one band; ``tracks`` are those that ``wanted_tracks``
    names, decoded; beside them the events of the layers."""

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

    def of_part(self, part: Part) -> Decoded:
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
