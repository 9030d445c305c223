"""Events whose channels get other numbers, or are left out (SPEC 9.9, EDT-003)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..codecs.events import build_events, parse_events
from ..format.cluster import Packet


def renumbered(packet: Packet, numbers: Mapping[int, int]) -> tuple[Packet | None, int]:
    """The packet of events with new channel numbers, without those of channels that have none (None
    where no event is left), and how many these were."""
    events = parse_events(packet.data, packet.start, packet.span, packet.offset)
    kept = [
        event if event.channel is None else event._replace(channel=numbers[event.channel])
        for event in events
        if event.channel is None or event.channel in numbers
    ]
    lost = len(events) - len(kept)
    if not kept:
        return None, lost
    return replace(packet, data=build_events(kept, packet.start)), lost
