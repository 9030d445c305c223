"""What stands beside the samples: events and clock observations, in the cluster of their time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

from ..codecs.events import CodedEvent, build_event
from ..codecs.layers import EVENT_RATE, coded, event_packets, layer_track
from ..format.cluster import Packet
from ..format.track import Track
from ..events import Event


class Waiting(NamedTuple):
    """An event that was not written yet."""

    time: Fraction
    layer: str
    coded: CodedEvent


class Layers:
    """Events of each layer: a track at the first of them, or one that is in the file."""

    def __init__(self, tracks: Iterable[Track]) -> None:
        layers = (track for track in tracks if track.kind == "events")
        self.tracks = {track.components[0].label: track for track in layers}
        self.waiting: list[Waiting] = []

    def add(self, event: Event, channel: int | None) -> None:
        """``channel``: a channel number in the file."""
        rate = self.tracks[event.layer].rate if event.layer in self.tracks else EVENT_RATE
        self.waiting.append(Waiting(event.time, event.layer, code(event, channel, rate)))

    def take(self, until: Fraction | None, next_track: int) -> tuple[list[Track], list[Packet]]:
        """New tracks, the first of id ``next_track``, and packets of the events before ``until``
        seconds; None: of all."""
        if not self.waiting:
            return [], []
        due = [one for one in self.waiting if until is None or one.time < until]
        self.waiting = [one for one in self.waiting if not (until is None or one.time < until)]
        tracks: list[Track] = []
        packets: list[Packet] = []
        for layer in dict.fromkeys(one.layer for one in due):
            if layer not in self.tracks:
                self.tracks[layer] = layer_track(next_track + len(tracks), layer)
                tracks.append(self.tracks[layer])
            own = sorted((one.coded for one in due if one.layer == layer), key=lambda e: e.tick)
            packets += event_packets(self.tracks[layer].id, own)
        return tracks, packets


def code(event: Event, channel: int | None, rate: Fraction = EVENT_RATE) -> CodedEvent:
    """In ticks of a layer; ParameterError where it cannot be written."""
    found = coded(replace(event, channel=None), rate, [])._replace(channel=channel)
    build_event(found, 0)
    return found
