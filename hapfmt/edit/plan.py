"""What becomes of each track: its new id, channel numbers and description, and how far it moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

from ..format.track import Track
from ..errors import ParameterError, UnsupportedError
from ..limits import LAST_TRACK_ID, LEVELS, Level
from .original import has_channels, ticks_of

LAST_CHANNEL = 65_534


class Place(NamedTuple):
    """A track as the new file describes it, and the ticks that its packets move by."""

    track: Track
    shift: int = 0


class Plan(NamedTuple):
    """``places`` by the old track id, ``numbers`` by the old channel number; all tracks move by
    ``shift`` seconds."""

    places: dict[int, Place]
    numbers: dict[int, int]
    shift: Fraction = Fraction(0)


def lay_out(
    kept: Mapping[int, Track],
    *,
    first_track: int = 0,
    first_channel: int = 0,
    shift: Fraction = Fraction(0),
) -> Plan:
    """Tracks, by their old id and in the order of the file, get new ids and channel numbers in
    the same order without holes; ``shift`` is in seconds."""
    ids = {old: first_track + place for place, old in enumerate(kept)}
    wanted = {n for track in kept.values() if has_channels(track) for n in track.channels}
    numbers = {old: first_channel + place for place, old in enumerate(sorted(wanted))}
    if (
        max(ids.values(), default=0) > LAST_TRACK_ID
        or max(numbers.values(), default=0) > LAST_CHANNEL
    ):
        raise ParameterError("more tracks or channels than a file can have, about 65 000")
    before: dict[int, int] = {}
    places = {}
    for old in sorted(kept):
        track = kept[old]
        changes: dict[str, object] = {"id": ids[old]}
        if track.kind != "events":
            if track.first_channel not in numbers:
                # Only a track that is not understood has a channel that its base has not.
                raise UnsupportedError(
                    f"Track {old} refers to channel {track.first_channel}, which is not copied",
                    offset=track.offset,
                )
            changes["first_channel"] = numbers[track.first_channel]
        if track.base is not None:
            if track.base not in ids:
                # Only a track that is not understood refers to one that does not belong to it.
                raise UnsupportedError(
                    f"Track {old} refers to track {track.base}, which is not copied",
                    offset=track.offset,
                )
            changes["base"] = ids[track.base]
        if has_channels(track):
            # Tracks that share their channel numbers continue one another, in order of their ids.
            if track.first_channel in before:
                changes["continues"] = before[track.first_channel]
            before[track.first_channel] = ids[old]
        places[old] = Place(replace(track, **changes), ticks_of(shift, track.rate))  # type: ignore[arg-type]
    return Plan({old: places[old] for old in kept}, numbers, shift)


def level_for(tracks: Sequence[Track], *levels: Level, largest: int = 0) -> Level:
    """The highest of ``levels``, or level 2 where a declared range, or the largest payload that is
    no cluster, needs it."""
    level = max(levels, key=lambda level: level.number, default=LEVELS[1])
    low = largest <= level.payload_size and all(track.in_range_of(level) for track in tracks)
    return level if low else LEVELS[2]
