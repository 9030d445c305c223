"""Channels that were recorded apart -> one file on one time line; packets are copied."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from fractions import Fraction

from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.extras import build_metadata
from ..format.track import Component, Track
from ..format.wire import check_file_id
from ..reading.packets import Seconds
from .joining import Times, common_line
from .making import (
    Edited,
    EditPlan,
    Making,
    Output,
    combined,
    lay_out,
    level_for,
    name_of,
    opened,
    refuse_output,
    with_note,
)
from .original import Advance, Input, Original, has_channels, open_original
from .subset import title


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
        line = common_line(originals, times, offsets or {}, canonical)
        plans = plans_of(originals, line.offsets, prefixes or [""] * len(files))
        text = f"merged from {', '.join(map(title, originals))}"
        metadata = with_note(combined([o.catalogue.metadata for o in originals]), text)
        level = level_for(
            [place.track for plan in plans for place in plan.places.values()],
            *(original.head.limits for original in originals),
            largest=len(build_metadata(metadata)),
        )
        with opened(out, force) as stream:
            making = Making(stream, line.head, level=level, canonical=canonical, name=name_of(out))
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
