"""EVNT: Event objects <-> packets of one layer (SPEC 9.9).

An event is a text at a moment or over a span of time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import groupby
from math import lcm
from typing import NamedTuple

from ..errors import FormatError, ParameterError, TruncatedError
from ..format.cluster import Packet
from ..format.track import Component, Track
from ..format.wire import parse_text
from ..limits import LEVELS, TICK_LIMIT
from ..numbers import build_varint, parse_varint, rdiv
from ..recording import Event, index_of_channel

EVENT_COUNT = 1 << 16
"""Events of a packet, at most."""
TEXT_SIZE = CHANNELS = (1 << 16) - 1
"""Bytes of a text; 1 + the highest channel number."""


class CodedEvent(NamedTuple):
    """An event as the file stores it; channel None: the whole recording."""

    tick: int
    duration: int
    channel: int | None
    text: str


def build_events(events: Sequence[CodedEvent], start: int) -> bytes:
    """The packet of events in order of their ticks, from tick ``start`` on."""
    if not 1 <= len(events) <= EVENT_COUNT:
        raise ParameterError(f"a packet holds 1 to {EVENT_COUNT} events, not {len(events)}")
    out = bytearray()
    before = start
    for event in events:
        out += build_event(event, before)
        before = event.tick
    return bytes(out)


def build_event(event: CodedEvent, before: int) -> bytes:
    """One event after another at tick ``before``."""
    tick, duration, channel, text = event
    try:
        raw = text.encode("utf-8")
    except UnicodeEncodeError:
        raw = b"\0"
    if 0 in raw or len(raw) > TEXT_SIZE:
        raise ParameterError(
            f"the text of an event is at most {TEXT_SIZE} bytes of UTF-8 without U+0000, "
            f"unlike {text[:40]!r}"
        )
    number = 0 if channel is None else channel + 1
    if not (0 <= before <= tick <= tick + duration <= TICK_LIMIT and duration >= 0):
        raise ParameterError(f"event {text[:40]!r} is out of order, or ends after tick 2^48")
    if channel is not None and not 0 <= channel < CHANNELS:
        raise ParameterError(f"event {text[:40]!r} speaks of channel {channel}")
    return b"".join(map(build_varint, (tick - before, duration, number, len(raw)))) + raw


def parse_events(data: bytes, start: int, span: int, offset: int) -> list[CodedEvent]:
    """The events of a packet at ``offset``, in the order of the bytes."""
    if not data:
        raise FormatError("a packet without events", requirement="EVT-001", offset=offset)
    events: list[CodedEvent] = []
    tick, position = start, 0
    while position < len(data):
        at = offset + position
        if len(events) == EVENT_COUNT:
            raise FormatError(
                f"more than {EVENT_COUNT} events in a packet", requirement="EVT-001", offset=at
            )
        step, position = parse_varint(data, position, offset)
        duration, position = parse_varint(data, position, offset)
        channel, position = parse_varint(data, position, offset)
        size, position = parse_varint(data, position, offset)
        tick += step
        if tick >= start + span:
            raise FormatError(
                "an event after the end of its packet", requirement="EVT-001", offset=at
            )
        if tick + duration > TICK_LIMIT:
            raise FormatError("an event that ends after 2^48", requirement="EVT-001", offset=at)
        if channel > CHANNELS:
            raise FormatError(
                f"an event of channel {channel - 1}", requirement="EVT-003", offset=at
            )
        if size > TEXT_SIZE:
            raise FormatError(f"a text of {size} bytes", requirement="EVT-003", offset=at)
        raw = data[position : position + size]
        if len(raw) < size:
            raise TruncatedError(
                "the bytes end within an event", requirement="EVT-001", offset=offset + position
            )
        text = parse_text(raw, offset + position)
        events.append(CodedEvent(tick, duration, channel - 1 if channel else None, text))
        position += size
    return events


EVENT_RATE = Fraction(1_000_000)
"""Ticks per second of a layer, unless its events need others: microseconds."""
PACKET_SIZE = 1 << 16
"""Packets of events are cut above this many bytes, which one damaged byte may destroy."""


def layer_track(
    id_: int, layer: str, rate: Fraction = EVENT_RATE, *, device: str = "", provenance: str = ""
) -> Track:
    """The description of a layer."""
    component = Component(label=layer, device=device)
    return Track(id_, "events", "EVNT", rate, 0, (component,), provenance=provenance)


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
    return CodedEvent(tick, duration, index_of_channel(event, labels), event.text)


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
