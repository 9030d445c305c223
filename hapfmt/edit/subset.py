"""Takes some channels, a time range or one band of a file; packets are copied bit for bit.

It also splits one file into consecutive parts; each packet lies in the part in which it begins.
Where a cut at the sample is asked for, the packets at its ends are coded again.
"""

from __future__ import annotations

import string
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import chain
from typing import NamedTuple

from ..errors import ParameterError, channels_called
from ..format.cluster import Packet
from ..format.extras import build_metadata
from ..format.track import Track
from ..format.wire import FILE_ID_LIMIT, check_file_id
from ..limits import LEVELS
from ..numbers import exact as fraction
from ..reading.packets import Seconds, tick_range
from ..reading.reader import BANDS, Band
from .cutting import Cutter
from .making import (
    Advance,
    Edited,
    EditPlan,
    Input,
    Making,
    Original,
    Output,
    another,
    common_period,
    has_channels,
    labels_of,
    lay_out,
    level_for,
    name_of,
    note_missing,
    open_original,
    opened,
    refuse_output,
    residual_alone,
    slow_alone,
    with_note,
)


class Window(NamedTuple):
    """Seconds to look at, and what is taken of each packet there; None: all."""

    start: Seconds | None = None
    stop: Seconds | None = None
    pick: Callable[[Packet], Packet | None] | None = None
    cutter: Cutter | None = None


def subset(
    file: Input | Original,
    out: Output,
    channels: Sequence[str | int] | str | int | None = None,
    start: Seconds | None = None,
    stop: Seconds | None = None,
    *,
    band: Band = "full",
    exact: bool = False,
    to_zero: bool = False,
    level: int | None = None,
    canonical: int | None = None,
    force: bool = False,
    progress: Advance | None = None,
) -> Edited:
    """Write the channels, seconds [start, stop) and band that are asked for into ``out``.

    Nothing is decoded. Packets that overlap the seconds are kept whole, so the result may hold a
    little more. It has the requested times, its own, and the missing stretches. ``exact`` cuts at
    the sample: the packets at the ends are coded again, without loss. Where that is impossible
    (textures, and lines between knots), they are kept whole, with a note. All channels that
    share a track with a requested one come along too. Channels are numbered from 0 on. Ticks,
    epoch and UUID stay as they are, since the samples keep their time. ``to_zero`` moves the
    first packet to tick 0, and the epoch with it. The move is a whole number of ticks of every
    track, so the packet may begin near tick 0 instead. ``band``: "lf" makes a channel of each
    slow part (where some channels were split, the others are kept whole, with a note), "hf" of
    each residual. ``level`` 2 raises the limits of the file.

    Raises ChecksumError or TruncatedError, with exit code 3, where the file is damaged or was not
    closed. Raises ParameterError where no channel would be left or ``start`` is behind the end.
    """
    check_file_id(canonical)
    refuse_output(out, force)
    if exact and start is None and stop is None:
        raise ParameterError("exact=True requires start or stop")
    if band not in BANDS:
        raise ParameterError(f"band is one of {', '.join(BANDS)}")
    if level not in (None, *LEVELS):
        raise ParameterError("level must be 1 or 2")
    with open_original(file, scan=start is None and stop is None) as original:
        end = original.catalogue.duration
        if start is not None and fraction(start) >= end > 0:
            raise ParameterError(
                f"No samples in this time range; the recording ends at {float(end):g} s",
                path=original.source.path,
            )
        notes: list[str] = []
        kept = choose(original, channels, band, notes)
        window = overlapping(original, start, stop, cutter_of(original, kept, exact=exact))
        text = said(original, kept, start, stop, band)
        return write_part(
            original, out, kept, window, text, notes,
            to_zero=to_zero, level=level, canonical=canonical, force=force, progress=progress,
        )  # fmt: skip


def choose(
    original: Original,
    channels: Sequence[str | int] | str | int | None,
    band: Band,
    notes: list[str],
) -> dict[int, Track]:
    """The tracks to keep, as they will be described, by id in the order of the file."""
    tracks = original.tracks
    all_numbers = {n for t in tracks.values() if has_channels(t) for n in t.channels}
    asked = all_numbers
    if channels is not None:
        asked = set(channels_called(channels, dict(sorted(original.labels.items()))))
    residuals = {t.base: t for t in tracks.values() if t.kind == "hf"}
    kept: dict[int, Track] = {}
    along: set[int] = set()
    for track in tracks.values():
        if track.kind == "events":
            kept[track.id] = track
        if not has_channels(track) or asked.isdisjoint(track.channels):
            continue
        along.update(set(track.channels) - asked)
        residual = residuals.get(track.id)
        if band == "full":
            kept[track.id] = track
            if residual:
                kept[residual.id] = residual
        elif band == "lf":
            kept[track.id] = slow_alone(track, residual) if residual else track
        elif residual:
            kept[residual.id] = residual_alone(track, residual)
    if not any(map(has_channels, kept.values())) and (channels is not None or band == "hf"):
        raise ParameterError("none of these channels has this band", path=original.source.path)
    whole = {
        n for t in kept.values() if has_channels(t) and t.id not in residuals for n in t.channels
    }
    if band == "lf" and asked <= whole:
        raise ParameterError("none of these channels has this band", path=original.source.path)
    if band == "lf" and whole:
        listed = ", ".join(map(str, sorted(whole)))
        notes.append(f"channels {listed} have no LF track and are copied whole")
    if along:
        listed = ", ".join(original.labels[n] or str(n) for n in sorted(along))
        notes.append(f"also copied, as tracks are kept whole: {listed}")
    if band != "full":
        left = asked - {n for t in kept.values() if has_channels(t) for n in t.channels}
        if left:
            notes.append(f"channels {', '.join(map(str, sorted(left)))} have no such band")
    original.check_known(list(kept.values()))
    return {id_: kept[id_] for id_ in tracks if id_ in kept}


def cutter_of(original: Original, kept: Mapping[int, Track], *, exact: bool) -> Cutter | None:
    return Cutter(kept, original.catalogue.level) if exact else None


def overlapping(
    original: Original, start: Seconds | None, stop: Seconds | None, cutter: Cutter | None
) -> Window:
    """Packets that overlap these seconds; a cutter shortens them."""
    if start is None and stop is None:
        return Window()
    ranges = {t.id: tick_range(t.rate, start, stop) for t in original.tracks.values()}

    def pick(packet: Packet) -> Packet | None:
        first, last = ranges[packet.track]
        if packet.start >= last or packet.stop <= first:
            return None
        if cutter is None:
            return packet
        if first >= last:  # a slow track has no tick in this range
            return None
        if original.tracks[packet.track].kind == "events":
            return cutter.events(packet, first, last)
        return cutter.cut(packet, first, last) or packet

    return Window(start, stop, pick, cutter)


def first_time(original: Original, kept: Mapping[int, Track], window: Window) -> Fraction:
    """Where the first packet begins, in seconds; 0 where there is none."""
    packets = chain.from_iterable(original.clusters(window.start, window.stop))
    chosen = (packet for packet in packets if packet.track in kept)
    taken = filter(None, map(window.pick, chosen) if window.pick else chosen)
    starts = (packet.start / kept[packet.track].rate for packet in taken)
    return min(starts, default=Fraction(0))


def write_part(
    original: Original,
    out: Output,
    kept: Mapping[int, Track],
    window: Window,
    text: str,
    notes: Sequence[str] = (),
    *,
    to_zero: bool = False,
    level: int | None = None,
    canonical: int | None = None,
    force: bool = False,
    progress: Advance | None = None,
) -> Edited:
    """One file of the tracks in ``kept`` and of the packets in ``window``."""
    head, shift = original.head, Fraction(0)
    if to_zero:
        period = common_period([track.rate for track in kept.values()])
        shift = first_time(original, kept, window) // period * period
        head = another(head, shift)
    plan = lay_out(kept, shift=-shift)
    metadata = with_note(original.catalogue.metadata, text)
    described = [place.track for place in plan.places.values()]
    asked = [LEVELS[level]] if level else []
    limits = level_for(described, LEVELS[head.level], *asked, largest=len(build_metadata(metadata)))
    ends = [None if end is None else fraction(end) - shift for end in window[:2]]
    with opened(out, force) as stream:
        making = Making(stream, head, level=limits, canonical=canonical, name=name_of(out))
        making.asked = ends[0], ends[1]
        for note in notes:
            making.note(note)
        making.describe(original, plan)
        making.metadata(metadata)
        making.others(original, plan, behind=False)
        for packets in making.clusters(
            original, plan, window.start, window.stop, pick=window.pick, progress=progress
        ):
            making.put(packets)
        making.others(original, plan, behind=True)
        making.digests(original, plan)
        edited = making.close()
        if window.start is not None or window.stop is not None:
            account(edited, making, window, plan)
        return edited


REMEDY = "packets are kept whole; exact=True cuts at the sample"


def account(edited: Edited, making: Making, window: Window, plan: EditPlan) -> None:
    """Report the requested times and those of the packets, on the time line of the original."""
    note_missing(edited)
    edited.asked = (
        None if window.start is None else fraction(window.start),
        None if window.stop is None else fraction(window.stop),
    )
    if edited.start is not None and edited.stop is not None:
        edited.made = (edited.start - plan.shift, edited.stop - plan.shift)
    if edited.rounded and window.cutter is None:
        making.note(REMEDY)
    if window.cutter and window.cutter.unable:
        tracks = (place.track for id_, place in plan.places.items() if id_ in window.cutter.unable)
        named = ", ".join(map(repr, labels_of({track.id: track for track in tracks}).values()))
        making.note(f"{named}: packets are kept whole, since they cannot be cut without a loss")


def said(
    original: Original,
    kept: Mapping[int, Track],
    start: Seconds | None,
    stop: Seconds | None,
    band: Band,
) -> str:
    """What happened, for the member ``notes`` of the metadata."""
    numbers = sorted({n for track in kept.values() if has_channels(track) for n in track.channels})
    parts = [f"channels {', '.join(map(str, numbers))}"]
    if start is not None or stop is not None:
        ends = ("" if time is None else f"{float(time):.9g}" for time in (start, stop))
        parts.append(f"{':'.join(ends)} s")
    if band != "full":
        parts.append(f"band {band}")
    return f"subset of {title(original)}: {'; '.join(parts)}"


def title(original: Original) -> str:
    """The recording by its UUID."""
    return str(original.catalogue.uuid)


PARTS_LIMIT = 100_000


def split(
    file: Input | Original,
    out: str = "part-{:03d}.hapf",
    *,
    every: Seconds | None = None,
    at: Sequence[Seconds] = (),
    exact: bool = False,
    to_zero: bool = False,
    canonical: int | None = None,
    force: bool = False,
    progress: Advance | None = None,
) -> list[Edited]:
    """Cut a file at each multiple of ``every`` seconds, or at the times ``at``.

    A packet is kept whole, in the part in which it begins; ``exact`` cuts at the sample, as for
    :func:`subset`. Every part has all channels, the
    metadata and the attachments. Ticks, epoch and UUID stay as they are, so that :func:`concat`
    puts the parts together again; ``to_zero`` as for :func:`subset`. Parts without a packet are
    left out. ``out`` is the name of a part with a place for its number, from 0 on. Each part
    appears whole or not at all. ``canonical`` is the file id of the first part, the others follow.

    Raises as :func:`subset` does.
    """
    check_file_id(canonical)
    if (every is None) == (not at):
        raise ParameterError("give either every or at")
    step = None if every is None else fraction(every)
    times = [fraction(time) for time in at]
    if (step is not None and step <= 0) or times != sorted({t for t in times if t > 0}):
        raise ParameterError("times to split at are above 0 and rising")
    with open_original(file) as original:
        cuts = cuts_of(original, step, times, exact=exact)
        names = names_of(out, len(cuts))
        for name in names:
            refuse_output(name, force)
        notes: list[str] = []
        kept = choose(original, None, "full", notes)
        parts = []
        before: Fraction | None = None
        for number, (name, (start, stop)) in enumerate(zip(names, cuts, strict=True)):
            between = f"no part of {float(before or 0):.6g} s to {float(start):.6g} s: no samples"
            window = beginning(original, start, stop, cutter_of(original, kept, exact=exact))
            # The ends of the recording were not asked for.
            window = window._replace(
                start=start if number else None, stop=stop if number < len(cuts) - 1 else None
            )
            parts.append(
                write_part(
                    original, name, kept, window,
                    f"part {number} of {title(original)}: {float(start)} s to "
                    f"{'the end' if stop is None else f'{float(stop)} s'}",
                    [*notes, between] if number and start != before else notes,
                    to_zero=to_zero, force=force,
                    canonical=None if canonical is None else (canonical + number) % FILE_ID_LIMIT,
                )
            )  # fmt: skip
            before = stop
            if progress:
                progress(number + 1, len(names))
        return parts


def cuts_of(
    original: Original, step: Fraction | None, times: Sequence[Fraction], *, exact: bool
) -> list[tuple[Fraction, Fraction | None]]:
    """Start and stop, in seconds, of the parts that hold packets, or samples where cuts are exact;
    one of everything where there are none."""

    def part_at(tick: int, rate: Fraction) -> int:
        at = tick / rate
        return int(at // step) if step else sum(time <= at for time in times)

    found = set[int]()
    for packets in original.clusters():
        for packet in packets:
            rate = original.tracks[packet.track].rate
            last = packet.stop - 1 if exact else packet.start
            found.update(range(part_at(packet.start, rate), part_at(last, rate) + 1))
            if len(found) > PARTS_LIMIT:
                raise ParameterError(f"more than {PARTS_LIMIT} parts: take longer ones")
    if not found:
        return [(Fraction(0), None)]
    if step:
        return [(number * step, (number + 1) * step) for number in sorted(found)]
    edges = [Fraction(0), *times]
    return [
        (edges[number], edges[number + 1] if number + 1 < len(edges) else None)
        for number in sorted(found)
    ]


def beginning(
    original: Original, start: Fraction, stop: Fraction | None, cutter: Cutter | None
) -> Window:
    """Packets that begin within these seconds; a cutter shortens all that overlap them."""
    ranges = {t.id: tick_range(t.rate, start, stop) for t in original.tracks.values()}

    def pick(packet: Packet) -> Packet | None:
        first, last = ranges[packet.track]
        if cutter and packet.start < last and packet.stop > first:
            if original.tracks[packet.track].kind == "events":
                return cutter.events(packet, first, last)
            made = cutter.cut(packet, first, last)
            if made:
                return made
        return packet if first <= packet.start < last else None

    return Window(start, stop, pick, cutter)


def names_of(template: str, count: int) -> list[str]:
    names = []
    try:
        fields = [name for _, name, _, _ in string.Formatter().parse(template) if name is not None]
        if fields in ([""], ["0"]):
            names = [template.format(number) for number in range(count)]
    except ValueError:
        pass
    if len(set(names)) != count:
        raise ParameterError(
            "the name of a part has one place for its number, such as part-{:03d}.hapf"
        )
    return names
