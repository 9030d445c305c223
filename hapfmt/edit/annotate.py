"""Events added to an existing file (SPEC 9.9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..codecs.layers import coded, event_packets, layer_track, rate_of
from ..format.cluster import Packet
from ..format.track import Track
from ..errors import ParameterError
from ..events import Event, by_layer
from ..limits import LAST_TRACK_ID
from ..numbers import counted
from ..reading.catalogue import Catalogue
from .appended import appended
from .making import Output
from .original import Input


def annotate(
    file: Input, events: Sequence[Event], out: Output | None = None, *, force: bool = False
) -> list[str]:
    """Append events to a file, or to a copy of it at ``out``; returns notes.

    They join the layer of their name where there is one, at its rate, else a new layer is made.
    ``Event.channel`` is a label or a number of the file. The file's other contents do not
    change.
    """
    if not events:
        raise ParameterError("nothing to annotate")
    with appended(file, out, force=force) as (writer, catalogue, note):
        notes = [note] if note else []
        end = catalogue.duration
        late = [event for event in events if event.time > end]
        if late:
            notes.append(
                f"{len(late)} of {len(events)} events begin after the end of the recording "
                f"({float(end):g} s)"
            )
        labels = [ref.label for ref in catalogue.channels]
        known = known_layers(catalogue)
        made: list[Track] = []
        packets: list[Packet] = []
        for layer, own in by_layer(named(event, labels) for event in events).items():
            track = known.get(layer)
            if track is None:
                id_ = max([*catalogue.tracks, -1]) + 1 + len(made)
                if id_ > LAST_TRACK_ID:
                    raise ParameterError("no room for another layer: 65 534 tracks")
                track = layer_track(id_, layer, rate_of(own))
                made.append(track)
            packets += event_packets(track.id, [coded(event, track.rate, labels) for event in own])
            between = [
                event
                for event in own
                if {(x * track.rate).denominator for x in (event.time, event.duration)} != {1}
            ]
            if between:
                notes.append(
                    f"{counted(len(between), 'event')} of layer {layer!r} moved to the nearest of "
                    f"its {track.rate} ticks a second"
                )
        writer.describe(made)
        writer.cluster(packets)
    return notes


def named(event: Event, labels: Sequence[str]) -> Event:
    """A text that is no label but a number is taken as one."""
    channel = event.channel
    if isinstance(channel, str) and channel not in labels and channel.isascii():
        return replace(event, channel=int(channel)) if channel.isdecimal() else event
    return event


def known_layers(catalogue: Catalogue) -> dict[str, Track]:
    """By name, the first of each."""
    return {
        track.components[0].label: track
        for track in reversed(catalogue.layers)
        if track.unsupported is None
    }
