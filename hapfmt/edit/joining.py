"""Joins several files into one, without decoding: their tracks, and their time lines.

``concat`` places recordings one after the other. ``merge`` combines channels that were recorded
apart. Each file's zero gets a place on the time line of the result, in seconds.

A track of one file goes on in the next as the same track where its description is the same. Else a
new track continues it (SPEC TRK-016).
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import Literal, NamedTuple

from ..errors import ParameterError, UnsupportedError
from ..format.cluster import Packet
from ..format.extras import build_metadata
from ..format.track import Affine, Component, Track
from ..format.wire import Head, check_file_id
from ..limits import LAST_CHANNEL, LAST_TRACK_ID, LEVELS
from ..numbers import exact
from ..reading.packets import Seconds
from .making import (
    NS,
    Advance,
    Edited,
    EditPlan,
    Everything,
    Input,
    Making,
    Original,
    Output,
    TrackPlace,
    another,
    common_period,
    described_by,
    differing_maps,
    has_channels,
    lay_out,
    level_for,
    name_of,
    note_missing,
    open_original,
    opened,
    refuse_output,
    ticks_of,
    with_note,
)
from .subset import title

NEVER_CLAMPED = ("RAWB", "LPCX")
"""Counts outside the declared range are errors (RAW-005, EXA-003): a wider one changes none."""


class Joining:
    """Tracks of the result, file by file."""

    def __init__(self) -> None:
        self.tracks: dict[int, Track] = {}
        self.chains: dict[int, list[int]] = {}
        """Ids of tracks that continue one another, by their first channel."""
        self.owners: dict[int, int] = {}
        """Which of them each channel number belongs to."""
        self.residuals: dict[int, int] = {}
        self.layers: dict[tuple[str, object], int] = {}
        self.labels: dict[int, str] = {}
        self.notes: list[str] = []
        self.added: list[tuple[dict[int, int], dict[int, int], range]] = []
        """For each file: new ids by old ones, channel numbers by old ones, which ids are new."""

    def plan(
        self, number: int, shift: Fraction = Fraction(0), *, only_new: bool = False
    ) -> EditPlan:
        """For the file that was added as this number; ``only_new``: what it describes first."""
        ids, numbers, new = self.added[number]
        places = {
            old: TrackPlace(self.tracks[id_], ticks_of(shift, self.tracks[id_].rate))
            for old, id_ in ids.items()
            if not only_new or id_ in new
        }
        return EditPlan(places, numbers, shift)

    def add(self, original: Original) -> None:
        """The next file."""
        numbers = self.match(original)
        bases = {track.base: track for track in original.tracks.values() if track.base is not None}
        before, ids = len(self.tracks), {}
        for track in original.tracks.values():
            if track.base is not None and track.base not in ids:
                # Only a track that is not understood refers to one that is not there.
                raise UnsupportedError(
                    f"Track {track.id} refers to track {track.base}, which is not copied",
                    offset=track.offset,
                    path=original.source.path,
                )
            moved = self.moved(track, numbers, original)
            if track.kind == "events":
                ids[track.id] = self.layer(moved)
            elif track.base is None:
                residual = bases.get(track.id)
                ids[track.id] = self.go_on(moved, residual, original)
            elif ids[track.base] in self.residuals:
                ids[track.id] = self.residuals[ids[track.base]]
                self.widen(ids[track.id], track)
            else:
                ids[track.id] = self.new(replace(moved, base=ids[track.base]))
                self.residuals[ids[track.base]] = ids[track.id]
        self.added.append((ids, numbers, range(before, len(self.tracks))))

    def match(self, original: Original) -> dict[int, int]:
        """New channel numbers by old ones: by label where all have one of their own, else by
        number. Channels that no file before had come last."""
        found = original.labels
        named = all(
            len(set(x)) == len(x) and all(x) for x in (found.values(), self.labels.values())
        )
        known = {label: number for number, label in self.labels.items()}
        numbers: dict[int, int] = {}
        for number in sorted(found):
            label = found[number]
            if named:
                place = known.get(label)
            else:
                place = number if number in self.labels else None
                if place is not None and "" != label != self.labels[place] != "":
                    raise ParameterError(
                        f"channel {number} is {label!r}, and {self.labels[place]!r} before; "
                        "reorder the channels with subset and merge",
                        path=original.name,
                    )
            if place is None:
                place = max(self.labels, default=-1) + 1
                if self.chains:
                    self.notes.append(f"channel {label or place} is new in {original.name}")
                if place > LAST_CHANNEL:
                    raise ParameterError("more channels than a file can have, 65 535")
            numbers[number] = place
            self.labels.setdefault(place, label)
        for place in sorted(set(self.labels) - set(numbers.values())):
            lacking = f"channel {self.labels[place] or place}"
            self.notes.append(f"{lacking} is not in {original.name}: it has a gap there")
        return numbers

    def moved(self, track: Track, numbers: dict[int, int], original: Original) -> Track:
        if track.kind == "events":
            return track
        places = [numbers[number] for number in track.channels]
        if track.kind != "full" and not in_order(places):
            raise apart(track, original)
        further = tuple(places[1:]) if track.further or not in_order(places) else ()
        return replace(track, first_channel=places[0], further=further, continues=None)

    def new(self, track: Track) -> int:
        id_ = len(self.tracks)
        if id_ > LAST_TRACK_ID:
            raise ParameterError("more tracks than a file can have, 65 534")
        self.tracks[id_] = replace(track, id=id_)
        return id_

    def layer(self, track: Track) -> int:
        """Events of one layer and rate are one track."""
        key = track.components[0].label, (track.rate, track.provenance)
        if key not in self.layers:
            self.layers[key] = self.new(track)
        return self.layers[key]

    def go_on(self, track: Track, residual: Track | None, original: Original) -> int:
        """The id under which a channel's track goes on."""
        chain = self.chains.setdefault(track.first_channel, [])
        if not chain:
            if any(n in self.owners for n in track.channels):
                raise apart(track, original)
            self.owners |= dict.fromkeys(track.channels, track.first_channel)
            chain.append(self.new(track))
            return chain[-1]
        last = self.tracks[chain[-1]]
        check_alike(track, last, original)
        theirs = self.residuals.get(last.id)
        mine = [(track, last)]
        if residual is not None and theirs is not None:
            mine.append((residual, self.tracks[theirs]))
        alike = (residual is None) == (theirs is None) and all(joinable(a, b) for a, b in mine)
        # An unknown TLV may refer to anything.
        if alike and not any(one.unknown for pair in mine for one in pair):
            self.widen(last.id, track)
            return last.id
        chain.append(self.new(replace(track, continues=last.id)))
        return chain[-1]

    def widen(self, id_: int, track: Track) -> None:
        """One description for both, as wide as both need it."""
        mine = self.tracks[id_]
        components = tuple(
            replace(a, deviation=wider(a, b))
            for a, b in zip(mine.components, track.components, strict=True)
        )
        self.tracks[id_] = replace(
            mine,
            components=components,
            count_min=min(mine.count_min, track.count_min),
            count_max=max(mine.count_max, track.count_max),
        )


def in_order(places: list[int]) -> bool:
    return places == list(range(places[0], places[0] + len(places)))


def apart(track: Track, original: Original) -> ParameterError:
    return ParameterError(
        f"channels {', '.join(map(str, track.channels))} are coded together with others than in "
        "the files before; encode one of them anew with references=False",
        path=original.name,
    )


def wider(a: Component, b: Component) -> tuple[float, float] | None:
    if a.deviation is None or b.deviation is None:
        return None
    return max(a.deviation, b.deviation)


def joinable(track: Track, last: Track) -> bool:
    """Whether one description can stand for both and change no decoded number."""
    declared = [[c.deviation and c.deviation[0] for c in t.components] for t in (track, last)]
    if declared[0] != declared[1]:
        return False
    changes = {
        "id": last.id,
        "first_channel": last.first_channel,
        "further": last.further,
        "base": last.base,
        "continues": last.continues,
        "offset": last.offset,
        "components": tuple(
            replace(a, deviation=b.deviation)
            for a, b in zip(track.components, last.components, strict=True)
        ),
    }
    if track.codec in NEVER_CLAMPED and track.number_format == "counts":
        changes |= {"count_min": last.count_min, "count_max": last.count_max}
    return replace(track, **changes) == last  # type: ignore[arg-type]


def check_alike(track: Track, last: Track, original: Original) -> None:
    """Refuses tracks of one channel that differ in rate, number format, calibration or unit."""
    pairs = [
        ("rate", f"{track.rate} Hz", f"{last.rate} Hz"),
        ("number format", track.number_format, last.number_format),
        *(
            pair
            for a, b in zip(track.components, last.components, strict=False)
            for pair in (
                ("calibration", formula(a.calibration), formula(b.calibration)),
                ("unit", a.unit, b.unit),
            )
        ),
    ]
    label = track.components[0].label or f"channel {track.first_channel}"
    for name, mine, theirs in pairs:
        if mine != theirs:
            raise ParameterError(
                f"{label}: {name} {mine}, and {theirs} in the files before; leave the channel out "
                "with subset, or encode one of them again with the same",
                path=original.name,
            )
    if [*track.channels] != [*last.channels]:
        raise apart(track, original)


def formula(affine: Affine) -> str:
    return f"({affine.a} * count + {affine.b}) / {affine.d}"


Times = Literal["same", "epoch"]
"""same: the ticks of all files count from one zero; epoch: the UTC times of their zeros decide."""


class CommonTimeline(NamedTuple):
    """The common time line: its HEAD, and where the zero of each file lies on it."""

    head: Head
    offsets: list[Fraction]
    notes: list[str]


def one_recording(originals: Sequence[Original]) -> bool:
    """Whether all files are parts of one recording, on its time line."""
    first = originals[0].head
    names = {(original.head.uuid, original.head.epoch_ns) for original in originals}
    return names == {(first.uuid, first.epoch_ns)}


def period_of(originals: Sequence[Original]) -> Fraction:
    return common_period([t.rate for original in originals for t in original.tracks.values()])


def nearest(seconds: Fraction, period: Fraction) -> Fraction:
    return round(seconds / period) * period


def common_line(
    originals: Sequence[Original],
    times: Times | None,
    given: Mapping[int, Seconds],
) -> CommonTimeline:
    """Offsets of files recorded side by side; ``given``: by the place of the file."""
    if given:
        if times is not None:
            raise ParameterError('give offsets=, times="epoch" or times="same", not two of them')
        offsets = [exact(given.get(i, 0)) for i in range(len(originals))]
        for original, offset in zip(originals, offsets, strict=True):
            check_offset(original, offset)
        return CommonTimeline(another(originals[0].head, -offsets[0]), offsets, [])
    epochs = [original.head.epoch_ns for original in originals]
    equal = None not in epochs and len(set(epochs)) == 1
    zeros = [Fraction(0)] * len(originals)
    if times is None and one_recording(originals):
        return CommonTimeline(originals[0].head, zeros, [])
    if times == "same" or (times is None and equal):
        head = originals[0].head
        return CommonTimeline(
            head if one_recording(originals) else another(head, zeros[0]), zeros, []
        )
    if times is None:
        raise ParameterError(
            'the files do not say how their times belong together; give times="epoch", '
            'times="same" (tick 0 is the same moment in all), or offsets='
        )
    first = originals[min(range(len(epochs)), key=lambda i: epoch_of(originals[i]))]
    offsets, notes = by_epoch(first, originals, [period_of([original]) for original in originals])
    return CommonTimeline(another(first.head, zeros[0]), offsets, notes)


def epoch_of(original: Original) -> int:
    if original.head.epoch_ns is None:
        raise ParameterError("the epoch is not known: give the offset", path=original.name)
    return original.head.epoch_ns


def by_epoch(
    first: Original, originals: Sequence[Original], periods: Sequence[Fraction]
) -> tuple[list[Fraction], list[str]]:
    """Offsets to the nearest whole ticks, and what that moved."""
    offsets, notes = [], []
    for original, period in zip(originals, periods, strict=True):
        distance = Fraction(epoch_of(original) - epoch_of(first), NS)
        offset = nearest(distance, period)
        offsets.append(offset)
        if offset != distance:
            moved = float(offset - distance)
            notes.append(f"{original.name}: {moved:+.3g} s from its epoch, to whole ticks")
    return offsets, notes


def check_offset(original: Original, offset: Fraction) -> None:
    period = period_of([original])
    if offset < 0:
        raise ParameterError(
            "an offset must not be negative; offset the other files instead", path=original.name
        )
    if offset % period:
        raise ParameterError(
            f"an offset of {offset} s is not a whole number of ticks of every track; the nearest "
            f"one: {nearest(offset, period)} s",
            path=original.name,
        )


def concat(
    files: Sequence[Input | Original],
    out: Output,
    *,
    times: Times | None = None,
    gap: Seconds | None = None,
    canonical: int | None = None,
    force: bool = False,
    progress: Advance | None = None,
) -> Edited:
    """Put files one after the other into ``out``.

    Channels are matched by label where every channel has one of its own, else by number. They need
    the same rate, number format, calibration and unit. Channels that are coded in one track must be
    so in all files. A channel that a file lacks has a gap there.

    Parts of one recording (the same UUID) keep their times. Else the zero of each file lies at the
    end of the one before, or ``gap`` seconds after it. It is rounded up to a whole number of ticks
    of every track. ``times``: "same" keeps the ticks of all files, "epoch" places them as their
    epochs say, to the nearest whole tick. The epoch is that of the first file.

    Raises as :func:`subset` does, ParameterError also where channels do not go together, or packets
    of one channel overlap.
    """
    check_file_id(canonical)
    refuse_output(out, force)
    if not files:
        raise ParameterError("nothing to concatenate")
    wait = None if gap is None else exact(gap)
    if wait is not None and (wait < 0 or times is not None):
        raise ParameterError(
            "a gap must not be negative, and is not allowed if the times are known"
        )
    with ExitStack() as stack:
        originals = [stack.enter_context(open_original(file)) for file in files]
        joining = Joining()
        for original in originals:
            original.check_known(list(original.tracks.values()))
            joining.add(original)
        if times is None and wait is None and one_recording(originals):
            times = "same"
        known, notes = known_offsets(originals, times)
        head = originals[0].head
        if times != "same" or not one_recording(originals):
            head = another(head, Fraction(0))
        named = list(dict.fromkeys(map(dated, originals)))
        several = f"{len(originals)} files of " * (len(named) < len(originals))
        text = f"concatenated from {several}{', '.join(named)}"
        encoder, members = described_by(originals)
        metadata = with_note(members, text)
        tracks = list(joining.tracks.values())
        level = level_for(
            tracks,
            *(LEVELS[original.head.level] for original in originals),
            largest=len(build_metadata(metadata)),
        )
        with opened(out, force) as stream:
            head = replace(head, encoder=encoder)
            making = Making(stream, head, level=level, canonical=canonical, name=name_of(out))
            if len(originals) > 1:
                same = times == "same"
                making.maps_to_drop = differing_maps(originals) if same else Everything()
            for note in [*joining.notes, *notes]:
                making.note(note)
            for number, original in enumerate(originals):
                making.describe(original, joining.plan(number, only_new=True))
            making.metadata(metadata)
            copy_all(making, originals, joining, known, wait or Fraction(0), progress)
            edited = making.close()
            note_missing(edited)
            return edited


def known_offsets(
    originals: Sequence[Original], times: Times | None
) -> tuple[list[Fraction] | None, list[str]]:
    """Offsets of the zeros; None: each is at the end of the previous file."""
    if times == "same":
        return [Fraction(0)] * len(originals), []
    if times == "epoch":
        return by_epoch(originals[0], originals, [period_of(originals)] * len(originals))
    return None, []


def copy_all(
    making: Making,
    originals: Sequence[Original],
    joining: Joining,
    known: list[Fraction] | None,
    gap: Fraction,
    progress: Advance | None,
) -> None:
    period = period_of(originals)
    plans = []
    for number, original in enumerate(originals):
        if known is not None:
            offset = known[number]
        else:
            end = making.span[1] + gap if making.span else Fraction(0)
            offset = -(-end // period) * period
        making.edited.offsets.append(offset)
        plans.append(joining.plan(number, offset))
        making.others(original, plans[-1], behind=False)
        advance = part_of(progress, number, len(originals))
        for packets in making.clusters(original, plans[-1], progress=advance):
            making.put(packets)
        making.others(original, plans[-1], behind=True)
    shared = Counter(place.track.id for plan in plans for place in plan.places.values())
    for original, plan in zip(originals, plans, strict=True):
        together = {old for old, place in plan.places.items() if shared[place.track.id] > 1}
        making.partial.setdefault(original, set()).update(together)
        making.digests(original, plan)


def dated(original: Original) -> str:
    """Title and time of a recording, since only the first epoch is kept."""
    epoch = original.head.epoch_ns
    if epoch is None:
        return title(original)
    try:
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=epoch // 1000)
    except OverflowError:
        return title(original)
    return f"{title(original)} ({moment.isoformat()})"


def part_of(progress: Advance | None, number: int, count: int) -> Advance | None:
    """The progress of all files, each of which counts the same."""
    if progress is None:
        return None
    return lambda done, total: progress(number * 1000 + done * 1000 // total, count * 1000)


def merge(
    files: Sequence[Input | Original],
    out: Output,
    *,
    times: Times | None = None,
    offsets: Mapping[int, Seconds] | None = None,
    prefixes: Sequence[str] | None = None,
    canonical: int | None = None,
    force: bool = False,
    progress: Advance | None = None,
) -> Edited:
    """Put the channels of several files side by side into ``out``.

    Files of one recording (the same UUID), or with the same epoch, share their zero of time. Others
    need ``times``: "same" (their zeros are one moment) or "epoch" (as their epochs say, to the
    nearest whole tick), or ``offsets``: seconds by the place of the file, whole ticks of each track
    in it. Channels are numbered on, file by file; ``prefixes``, one for each file, precede
    their labels and groups. Metadata and attachments of all are kept.

    Raises as :func:`subset` does.
    """
    check_file_id(canonical)
    refuse_output(out, force)
    if not files:
        raise ParameterError("nothing to merge")
    if prefixes is not None and len(prefixes) != len(files):
        raise ParameterError("one prefix for each file; it may be empty")
    with ExitStack() as stack:
        originals = [stack.enter_context(open_original(file)) for file in files]
        for original in originals:
            original.check_known(list(original.tracks.values()))
        line = common_line(originals, times, offsets or {})
        plans = plans_of(originals, line.offsets, prefixes or [""] * len(files))
        text = f"merged from {', '.join(map(title, originals))}"
        encoder, members = described_by(originals)
        metadata = with_note(members, text)
        tracks = [place.track for plan in plans for place in plan.places.values()]
        level = level_for(
            tracks,
            *(LEVELS[original.head.level] for original in originals),
            largest=len(build_metadata(metadata)),
        )
        with opened(out, force) as stream:
            head = replace(line.head, encoder=encoder)
            making = Making(stream, head, level=level, canonical=canonical, name=name_of(out))
            making.edited.offsets = line.offsets
            for note in [*line.notes, *collisions(plans)]:
                making.note(note)
            for original, plan in zip(originals, plans, strict=True):
                making.describe(original, plan)
            making.metadata(metadata)
            for original, plan in zip(originals, plans, strict=True):
                making.others(original, plan, behind=False)
            for packets in interleaved(making, originals, plans, progress):
                making.put(packets)
            for original, plan in zip(originals, plans, strict=True):
                making.others(original, plan, behind=True)
                making.digests(original, plan)
            return making.close()


def plans_of(
    originals: Sequence[Original], offsets: Sequence[Fraction], prefixes: Sequence[str]
) -> list[EditPlan]:
    plans: list[EditPlan] = []
    first_track = first_channel = 0
    for original, offset, prefix in zip(originals, offsets, prefixes, strict=True):
        kept = {id_: prefixed(track, prefix) for id_, track in original.tracks.items()}
        plan = lay_out(kept, first_track=first_track, first_channel=first_channel, shift=offset)
        first_track += len(plan.places)
        first_channel += len(plan.numbers)
        plans.append(plan)
    return plans


def prefixed(track: Track, prefix: str) -> Track:
    if not prefix or not has_channels(track):
        return track

    def named(c: Component) -> Component:
        group = prefix + c.group if c.group else ""
        return replace(c, label=prefix + c.label, group=group)

    return replace(track, components=tuple(map(named, track.components)))


def collisions(plans: Sequence[EditPlan]) -> Iterator[str]:
    """Labels that more than one file has."""
    labels = Counter(
        label
        for plan in plans
        for label in {
            component.label
            for place in plan.places.values()
            if has_channels(place.track)
            for component in place.track.components
        }
    )
    twice = sorted(label for label, count in labels.items() if label and count > 1)
    if twice:
        yield f"labels that more than one file has: {', '.join(twice)}; prefixes tell them apart"


def interleaved(
    making: Making,
    originals: Sequence[Original],
    plans: Sequence[EditPlan],
    progress: Advance | None,
) -> Iterator[list[Packet]]:
    """Clusters of all files in order of time, those of each file in its own order."""

    def timed(number: int) -> Iterator[tuple[Fraction, int, list[Packet]]]:
        for packets in making.clusters(originals[number], plans[number]):
            start = min(p.start / making.out.tracks[p.track].rate for p in packets)
            yield start, number, packets

    total = sum(len(original.refs(None, None)) for original in originals)
    rows = heapq.merge(*map(timed, range(len(originals))), key=lambda row: row[0])
    for done, (_, _, packets) in enumerate(rows):
        yield packets
        if progress:
            progress(done + 1, total)
