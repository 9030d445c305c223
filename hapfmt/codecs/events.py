"""EVNT: events of one layer, texts at moments or over times (SPEC 9.9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ..format.tlv import parse_text
from ..errors import FormatError, ParameterError, TruncatedError
from ..integers import build_varint, parse_varint
from ..limits import TICK_LIMIT

EVENT_COUNT = 1 << 16
"""Events of a packet, at most."""
TEXT_SIZE = CHANNELS = (1 << 16) - 1
"""Bytes of a text; 1 + the highest channel number."""


class CodedEvent(NamedTuple):
    """As it stands in a file; channel None: the whole recording."""

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
    """The events of a packet that stands at ``offset``, in the order of the bytes."""
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
