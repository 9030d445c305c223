"""Events of people <-> the packets of a layer (SPEC 9.9)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import groupby
from math import lcm

from ..format.cluster import Packet
from ..format.track import Component, Track
from ..format.wire import NO_TRACK
from ..errors import ParameterError
from ..events import Event, channel_of
from ..integers import rdiv
from ..limits import LEVELS, TICK_LIMIT
from .events import EVENT_COUNT, CodedEvent, build_events

EVENT_RATE = Fraction(1_000_000)
"""Ticks per second of a layer, unless its events need others: microseconds."""
PACKET_SIZE = 1 << 16
"""Packets of events are cut above so many bytes: what one damaged byte takes along."""


def layer_track(
    id_: int, layer: str, rate: Fraction = EVENT_RATE, *, device: str = "", provenance: str = ""
) -> Track:
    """The description of a layer."""
    component = Component(label=layer, device=device)
    return Track(id_, "events", "EVNT", rate, NO_TRACK, (component,), provenance=provenance)


def rate_of(events: Iterable[Event]) -> Fraction:
    """Ticks per second that put every event on a tick, a multiple of the usual rate; that itself
    where there is none below 2^32: times are then rounded to the microsecond."""
    rate = EVENT_RATE.numerator
    for event in events:
        rate = lcm(rate, event.time.denominator, event.duration.denominator)
        if rate >= 1 << 32:
            return EVENT_RATE
    return Fraction(rate)


def coded(event: Event, rate: Fraction, labels: Sequence[str]) -> CodedEvent:
    """In ticks, to the nearest; ``labels`` of the channels in order of their numbers."""
    tick, duration = (rdiv(*(x * rate).as_integer_ratio()) for x in (event.time, event.duration))
    if tick + duration >= TICK_LIMIT:
        raise ParameterError(f"event {event.text[:40]!r} ends after the last possible tick, 2^48")
    return CodedEvent(tick, duration, channel_of(event, labels), event.text)


def event_packets(
    track: int, events: Sequence[CodedEvent], ticks: Fraction | int | None = None
) -> Iterator[Packet]:
    """Packets of a layer: of events in order of their ticks, none over more than ``ticks``."""
    n, d = Fraction(ticks or LEVELS[1].span_ticks).as_integer_ratio()
    limit = LEVELS[1].span_ticks
    for _, group in groupby(events, key=lambda event: (event.tick * d // n, event.tick // limit)):
        batch: list[CodedEvent] = []
        size = 0
        for event in group:
            weight = len(event.text) + 20
            if batch and (size + weight > PACKET_SIZE or len(batch) == EVENT_COUNT):
                yield event_packet(track, batch)
                batch, size = [], 0
            batch.append(event)
            size += weight
        yield event_packet(track, batch)


def event_packet(track: int, events: Sequence[CodedEvent]) -> Packet:
    start = events[0].tick
    return Packet(track, start, events[-1].tick + 1 - start, build_events(events, start))


def decoded(event: CodedEvent, track: Track) -> Event:
    """In seconds; the channel is its number."""
    time, duration = event.tick / track.rate, event.duration / track.rate
    return Event(time, event.text, duration, event.channel, track.components[0].label)
