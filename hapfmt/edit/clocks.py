"""Chunks of clocks whose tracks move in time (SPEC 6.10)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from ..format.wire import NO_TRACK
from ..integers import build_svarint, parse_svarint, parse_varint
from .original import NS, Original
from .plan import Plan

TYPES = frozenset({"cLOk", "cMAp"})
TICK_BOUND = 1 << 52


class Everything:
    """As a set: of all there is."""

    def __contains__(self, _: object) -> bool:
        return True


def differing_maps(originals: Sequence[Original]) -> set[bytes]:
    """Payloads of the maps that files, parts of one line of time, do not have in common."""
    found = [
        {
            chunk.payload
            for behind in (False, True)
            for chunk in original.others(behind=behind)
            if chunk.header.type == "cMAp" and chunk.header.known
        }
        for original in originals
    ]
    return found[0].union(*found) - found[0].intersection(*found)


def moved_clock(payload: bytes, track: int, plan: Plan, offset: int) -> bytes | None:
    """The payload of a clock chunk, of observations or a map, on the new time line: all its ticks
    are counted from the first. None where no whole number of ticks, or no svarint, says that."""
    place = plan.places.get(track)
    ticks = Fraction(place.shift) if place else plan.shift * NS
    if (track != NO_TRACK and place is None) or ticks.denominator != 1:
        return None
    if not ticks:
        return payload
    _, start = parse_varint(payload, 1 + payload[0] if payload else 0, offset)
    tick, stop = parse_svarint(payload, start, offset)
    tick += ticks.numerator
    if not -TICK_BOUND < tick < TICK_BOUND:
        return None
    return payload[:start] + build_svarint(tick) + payload[stop:]
