"""Which tracks a recovered file describes: those that hold, and places for what is lost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

from ..format.description import Record, build_track, split
from ..format.track import COMPONENTS, Component, Track, TrackTable
from ..format.walk import read_chunk
from ..format.wire import HEADER_SIZE
from ..errors import FormatError
from ..limits import LAST_TRACK_ID
from ..reading.catalogue import Catalogue
from ..reading.decoder import TrackDecoder
from ..reading.packets import PacketPass

EMPTY = b"\0\0\0\1\0"
"""Parameters of KNOT: hold, varints, step 1. A track without packets needs no others."""
LOST_LABEL = "(lost)"
LOST_RESIDUAL = "the description of this HF track was lost"
LOST_CHANNEL = "the description of this channel was lost"
LAST_CHANNEL = 65_534
EVERYTHING = (0, 1 << 62)
"""All ticks."""


def describe(catalogue: Catalogue) -> tuple[list[Record], list[Track]]:
    """All tracks that can be kept, HF last; and the tracks that stand for lost ones, without
    packets: also of channels that an event speaks of."""
    kept = dict(copied(catalogue, rejoined(usable(catalogue))))
    places = placeholders({track.id: track for track in kept}, catalogue)
    kept |= {track: build_track(track) for track in places}
    return sorted(kept.items(), key=lambda part: (part[0].kind == "hf", part[0].id)), places


def usable(catalogue: Catalogue) -> dict[int, Track]:
    """HF tracks only with their base."""
    found: dict[int, Track] = {}
    for track in sorted(catalogue.tracks.values(), key=lambda t: (t.kind == "hf", t.id)):
        if track.kind == "hf" and track.base not in found:
            message = f"HF track {track.id} has lost its base track {track.base}"
            catalogue.lose("lost-base", track.offset - HEADER_SIZE, 0, message, "DEC-003")
            continue
        found[track.id] = track
    return found


def rejoined(kept: dict[int, Track]) -> dict[int, Track]:
    """Tracks that continue one that is lost continue the one before it, or none."""
    table = TrackTable()
    table.tracks = kept
    out = dict(kept)
    for chain in table.chains():
        for before, track in zip([None, *chain], chain, strict=False):
            if track.continues is not None and track.continues not in kept:
                out[track.id] = replace(track, continues=before.id if before else None)
    return out


def copied(catalogue: Catalogue, kept: dict[int, Track]) -> Iterator[Record]:
    """The tracks as they stand, byte for byte, but for those that continue another one now."""
    by_chunk: dict[int, list[Track]] = {}
    for track in kept.values():
        by_chunk.setdefault(track.offset, []).append(track)
    for offset, tracks in by_chunk.items():
        chunk = read_chunk(catalogue.source, offset - HEADER_SIZE)
        assert chunk is not None
        records = split(chunk.payload, catalogue.level, offset)
        for track in tracks:
            if track is catalogue.tracks[track.id]:
                yield track, records[track.id - chunk.header.track]
            elif track.unsupported is None:
                yield track, build_track(track)


def placeholders(described: dict[int, Track], catalogue: Catalogue) -> list[Track]:
    """An empty HF track for each LF track without one (TRK-012), and empty tracks for channel
    numbers that nothing speaks of (TRK-010)."""
    ids = free_ids(described.keys() | catalogue.tracks.keys())
    bases = {track.base for track in described.values() if track.kind == "hf"}
    places = [
        Track(
            next(ids), "hf", "KNOT", lf.rate, lf.first_channel,
            (Component(),) * len(lf.components), EMPTY, base=lf.id, provenance=LOST_RESIDUAL,
        )
        for lf in sorted(described.values(), key=lambda t: t.id)
        if lf.kind == "lf" and lf.id not in bases
    ]  # fmt: skip
    for first, count in missing_channels(described, highest_named(catalogue, described)):
        components = (Component(label=LOST_LABEL),) * count
        places.append(
            Track(
                next(ids), "full", "KNOT", Fraction(1), first, components, EMPTY,
                provenance=LOST_CHANNEL,
            )
        )  # fmt: skip
    return places


def highest_named(catalogue: Catalogue, described: dict[int, Track]) -> int:
    """The highest channel number that an event speaks of, -1 where none does."""
    layers = [t for t in described.values() if t.kind == "events" and t.unsupported is None]
    everything = dict.fromkeys((layer.id for layer in layers), EVERYTHING)
    decoders = {layer.id: TrackDecoder(layer, catalogue.level) for layer in layers}
    highest = -1
    for packet in PacketPass(catalogue, lambda: None).packets(everything) if layers else ():
        try:
            events = decoders[packet.track].decode_events(packet)
        except FormatError:
            continue
        named = [event.channel for event in events if event.channel is not None]
        highest = max(highest, *named, -1)
    return highest


def missing_channels(described: dict[int, Track], highest: int) -> Iterator[tuple[int, int]]:
    """(first channel number, how many) that no track has, up to ``highest`` or the highest that one
    has; at most 255 each."""
    numbers = {
        number
        for track in described.values()
        if track.kind != "hf"
        for number in track.channels
        if number <= LAST_CHANNEL
    }
    run: list[int] = []
    for number in range(max(*numbers, highest, -1) + 1):
        if number in numbers or len(run) == COMPONENTS:
            if run:
                yield run[0], len(run)
            run = []
        if number not in numbers:
            run.append(number)
    if run:
        yield run[0], len(run)


def free_ids(taken: set[int]) -> Iterator[int]:
    """Ids that no track has, new ones first."""
    highest = max(taken, default=-1)
    yield from range(highest + 1, LAST_TRACK_ID + 1)
    yield from (id_ for id_ in range(highest) if id_ not in taken)
