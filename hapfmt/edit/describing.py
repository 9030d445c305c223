"""TRAK chunks of an edited file: as they were, but for ids and channel numbers, where a series is
kept whole; else written anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..container.filewriter import FileWriter
from ..container.layout import TRAK
from ..container.lists import build_channels, build_continued
from ..container.series import (
    CHANNELS,
    CONTINUED,
    CONTRACT,
    CRITICAL,
    DEVIATIONS,
    GROUP,
    INHERITED,
    LABEL,
    PROVENANCE,
    follow_on,
)
from ..container.tlv import build_strings, build_tlvs, parse_tlvs
from ..container.track import Track
from ..container.wire import NO_TRACK, build_fields, read_fields
from .plan import Place

KNOWN = frozenset(CRITICAL) | INHERITED | {CONTRACT, DEVIATIONS, PROVENANCE}


def unknown_tlvs(payload: bytes) -> list[int]:
    """Types that only a copy of the whole series keeps."""
    return [type_ for type_ in parse_tlvs(payload, TRAK.sizeof(), 0) if type_ not in KNOWN]


def texts_of(series: Sequence[Track], name: str) -> list[str]:
    return [getattr(component, name) for track in series for component in track.components]


def same_but_place(old: Track, new: Track) -> bool:
    """Whether nothing but ids, channel numbers, labels and groups differs."""
    if len(old.components) != len(new.components):
        return False
    components = tuple(
        replace(mine, label=theirs.label, group=theirs.group)
        for mine, theirs in zip(new.components, old.components, strict=True)
    )
    return old == replace(
        new,
        id=old.id,
        first_channel=old.first_channel,
        base=old.base,
        continues=old.continues,
        components=components,
    )


def patched(payload: bytes, old: Sequence[Track], places: Mapping[int, Place]) -> bytes | None:
    """The TRAK payload with its new ids and channel numbers, every other byte kept; None where the
    series is not kept as a whole."""
    if any(track.id not in places for track in old):
        return None
    new = [places[track.id].track for track in old]
    if not all(map(same_but_place, old, new)):
        return None
    ids = [track.id for track in new]
    if ids != follow_on(ids[0], 1, len(ids)):
        return None
    bases = [track.base for track in new]
    if bases[0] is not None and bases != follow_on(bases[0], 1, len(bases)):
        return None
    fields = read_fields(TRAK, payload, 0)._asdict()
    fields["base"] = NO_TRACK if bases[0] is None else bases[0]
    values = {type_: value for type_, (_, value) in parse_tlvs(payload, TRAK.sizeof(), 0).items()}
    firsts = [track.first_channel for track in new]
    if firsts != [track.first_channel for track in old]:
        fields["first_channel"] = firsts[0]
        values.pop(CHANNELS, None)
        if firsts != follow_on(firsts[0], len(new[0].components), len(new)):
            values[CHANNELS] = build_channels(firsts)
    continued = [track.continues for track in new]
    if continued != [track.continues for track in old]:
        values.pop(CONTINUED, None)
        if any(id_ is not None for id_ in continued):
            values[CONTINUED] = build_continued(continued)
    for type_, name in ((LABEL, "label"), (GROUP, "group")):
        if texts_of(new, name) != texts_of(old, name):
            values[type_] = build_strings(texts_of(new, name))
    return build_fields(TRAK, fields) + build_tlvs(values)


def describe(
    out: FileWriter,
    series: Sequence[tuple[bytes, Sequence[Track]]],
    places: Mapping[int, Place],
) -> list[str]:
    """Writes the TRAK chunks; returns what could not be kept."""
    notes = []
    loose: list[Track] = []
    for payload, tracks in series:
        kept = [places[track.id].track for track in tracks if track.id in places]
        if not kept:
            continue
        copied = patched(payload, tracks, places)
        if copied is None:
            loose += kept
            lost = unknown_tlvs(payload)
            if lost:
                listed = ", ".join(map(str, lost))
                notes.append(f"TLVs {listed} of track {tracks[0].id} left out: not known here")
            continue
        out.describe(loose)
        loose = []
        out.series.append((kept[0].id, copied))
        out.chunk("TRAK", copied, kept[0].id)
        out.tracks.update((track.id, track) for track in kept)
    out.describe(loose)
    return notes
