"""Recording -> tracks and packets.

The steps are: plan, a promise for each channel; grid, floating point values to counts; group,
channels that share a track; choose, the smallest way to keep the promise. Lossless is always one of
the ways. The encoder reports each decision.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from functools import partial
from importlib.util import find_spec
from itertools import accumulate, pairwise
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.knots import KnotParameters
from ..errors import DataWarning, FormatError, MissingExtraError, ParameterError
from ..format.cluster import Packet
from ..format.track import Track
from ..limits import EXACT_LIMIT, LAST_TRACK_ID, LEVELS, Level
from ..reading.catalogue import TrackPair
from ..reading.decoder import TrackDecoder
from ..recording import Channel, Recording, Span
from ..spool import MEMORY, Spool, is_mapped, release
from ..threads import in_order, thread_count
from .bitrate import fill
from .bounded import HOPE, encode_bounded, encode_lossless, error_of, lossless_bits
from .effort import Effort
from .exact import (
    COSTLY,
    RUN_LIMIT,
    WORDS_REASON,
    Relation,
    encode_doubles,
    encode_linear,
    encode_words,
    find_relations,
    groups_of,
    stretches,
)
from .gridded import INFINITE, KEPT, NO_STEP, Gridded, on_grid
from .knots import Coded
from .lattice import Lattice, LatticeSearch, sparse
from .lengths import Load, PacketLengths, load_of
from .plan import Promise, check_error, promises_of, range_of, vector_promise
from .references import Links, encode_run, find_runs, same_ticks, step_of
from .settings import Settings, Tolerance
from .source import InputBlock, cut, group_units, side_by_side
from .texture import encode_textured
from .unit import (
    DESCRIPTION,
    ENCODE_LEVEL,
    ROW,
    Unit,
    encode_constant,
    encode_paper,
    is_constant,
    largest_errors,
    whole_range,
)

WORDS = {
    np.dtype(np.int64): "int64",
    np.dtype(np.uint64): "uint64",
    np.dtype(np.float16): "binary16",
    np.dtype(np.float32): "binary32",
    np.dtype(np.float64): "binary64",
}


JOINED_TICKS = 1 << 19
"""Most ticks of a constant packet with one component: eight of them fill a cluster of level 1."""


RELATED = 0.03
"""Share of the bytes that a track of channels which follow from each other has to save."""

METADATA = 96
"""Bytes in a file. A lossy form that saves less is not worth the loss."""

SMALLER = "smaller than a lossy form"
SMALLER_LOSSLESS = "lossless is smaller"

ALWAYS, SMALL = 1 << 14, 1 << 16
"""Recordings of up to ALWAYS samples are also written without loss, and those of up to SMALL where
an estimate does not tell that they are larger then: the smaller file counts."""

LIKELY = 0.7
"""Share of a quick estimate of the lossless size, above which the lossless form is tried."""


@dataclass(frozen=True)
class Decision:
    """What became of one channel.

    ``kept_as``: what the file states of the samples; ``reason``: how they are coded. ``unit``: the
    channel's. ``largest_error``: of all samples, decoded against recorded, in that unit.
    ``relative_error``: its share of the range, glitches left out; 0 without an error or a range.
    ``original_bits`` of one sample as it came. ``exact``: the track is stored without loss (on
    its grid, see ``lattice``); ``within``: every sample was found within the bound of the track.
    ``axis_count`` channels share a vector. ``size`` in bytes, of packets and codebooks.
    ``snr_hf_db``, ``st_sim``: the quality of the texture as decoded, without silent stretches;
    ``snr_db``: of all frequencies, as in :mod:`hapfmt.metrics`; None where no texture is kept, or
    where it was not measured. ``level_db``, ``band_db``: how much louder a synthetic texture is
    than the recorded one, above 40 Hz and in the band that is furthest off. ``missed``: why the
    texture does not have the quality that was asked for.
    """

    channel: int
    label: str
    sample_count: int
    axis_count: int
    chosen: str
    reason: str
    lattice: str
    exact: bool
    within: bool
    size: int
    unit: str
    kept_as: str
    largest_error: float
    relative_error: float
    original_bits: int
    snr_hf_db: float | None = None
    snr_db: float | None = None
    st_sim: float | None = None
    level_db: float | None = None
    band_db: float | None = None
    band_low_hz: float | None = None
    band_high_hz: float | None = None
    missed: str = ""

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


@dataclass
class Encoded:
    """Tracks in order of their ids, packets track by track, and the decisions."""

    tracks: list[Track]
    packets: list[Packet]
    decisions: list[Decision]
    level: Level
    settings: Settings
    """As asked for; of preset lossless where nothing was lost after all."""
    cluster: Fraction
    """Seconds of a cluster."""
    cluster_samples: int | None = None
    """Most samples of a chunk; None: as many as the level allows."""


@dataclass(frozen=True)
class PlacedUnit:
    """A unit, its first channel, and of each of its channels how it was put on a grid."""

    unit: Unit
    first: int
    members: list[Gridded]
    tracks: tuple[PlacedUnit, ...] = ()
    """Where these are several tracks, whose channels lie among each other: what each became."""
    numbers: tuple[int, ...] = ()
    """The channel numbers, where they do not follow one another."""

    @property
    def stop(self) -> int:
        return self.first + len(self.members)

    @property
    def channels(self) -> Sequence[int]:
        return self.numbers or range(self.first, self.stop)


@dataclass(frozen=True)
class EncodeJob:
    """The settings, and the channels as they were recorded."""

    settings: Settings
    originals: list[Channel]
    promises: list[Promise]
    searches: list[LatticeSearch]
    """One for the values of each channel."""
    threads: int
    heads: list[int]
    """Channels that begin a track: the first, and those that clocks refer to."""
    loads: Sequence[Load]
    """One for each channel."""
    lengths: PacketLengths

    @property
    def lossless(self) -> Settings:
        """The settings of the same file without loss."""
        given = self.settings
        if given.preset == "lossless":
            return given
        return Settings(
            references=given.references, cluster=given.cluster, digest=given.digest,
            effort=given.effort,
        )  # fmt: skip

    def with_sizes(self, parts: list[PlacedUnit], found: list[Relation]) -> EncodeJob:
        """The same, with the sizes of these channels as they turned out."""
        loads = list(self.loads)
        for part in parts:
            loads[part.first] = replace(loads[part.first], size=part.unit.size)
        for each in found:
            number = parts[each.target].first
            loads[number] = replace(loads[number], size=each.bits * loads[number].samples / 8)
        before = self.loads[parts[0].first : parts[-1].stop]
        groups = groups_of(found, len(parts))
        after = [Load.of(loads[parts[place].first] for place in group) for group in groups]
        return replace(self, loads=loads, lengths=self.lengths.changed(before, after))

    def spans(
        self, channels: Sequence[Channel], numbers: Sequence[int], components: int
    ) -> tuple[Span, ...]:
        """The packets of a track that has the channels of these numbers."""
        seconds = self.lengths.seconds(channels, [self.loads[number] for number in numbers])
        return tuple(cut(channels[0].coverage, channels[0].rate_exact, seconds, components))


def encode(
    recording: Recording,
    settings: Settings | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    threads: int | None = None,
    size_of: Callable[[Encoded], int] | None = None,
) -> Encoded:
    """All channels of a recording; ``progress`` is called with (channels done, channels in all).

    ``threads``: as in :func:`hapfmt.write`; the result does not depend on it. ``size_of``: bytes of
    the file, which a bit rate counts; None: about.
    """
    settings = settings or Settings()
    if settings.st_sim is not None and not find_spec("vibromaf"):
        raise MissingExtraError("vibromaf", "metrics")
    size_of = size_of or about
    encoding = Encoding(recording, settings, progress or no_progress, threads, size_of)
    if settings.bitrate is None or not encoding.textures:
        return with_weights(encoding.finish(encoding.parts))
    return with_weights(
        fill(
            lambda db: encoding.finish(encoding.at_quality(db)),
            size_of,
            settings.bitrate * 1000 / 8 * float(recording.duration),
        )
    )


def no_progress(_done: int, _all: int) -> None:
    """Report nothing."""


def with_weights(encoded: Encoded) -> Encoded:
    """Return the same; warn where no texture has the steps that a weighting changes."""
    if encoded.settings.weighting and not any(track.codec == "MDCT" for track in encoded.tracks):
        text = "weighting does nothing here: LPCR is smaller; add texture_codec='MDCT'"
        warnings.warn(text, DataWarning, stacklevel=4)
    return encoded


def about(encoded: Encoded) -> int:
    """Bytes of a file."""
    size = METADATA + DESCRIPTION * len(encoded.tracks)
    return size + sum(len(packet.data) + ROW for packet in encoded.packets)


class Encoding:
    """A recording in the encoder. All is coded once, but for textures, at any quality."""

    def __init__(
        self,
        recording: Recording,
        settings: Settings,
        progress: Callable[[int, int], None],
        threads: int | None,
        size_of: Callable[[Encoded], int],
    ) -> None:
        self.size_of = size_of
        threads = min(thread_count(threads, recording.sample_count), len(recording))
        if len(recording) > LAST_TRACK_ID // 2:
            raise ParameterError(f"a recording has at most {LAST_TRACK_ID // 2} channels")
        self.recording, self.progress = recording, progress
        originals = [as_recorded(channel) for channel in recording.channels]
        promises = promises_of(replace(recording, channels=tuple(originals)), settings)
        # Counts go to the disk where the samples are there.
        mapped = any(is_mapped(channel.stored) for channel in originals)
        store = Spool() if mapped else MEMORY
        searches = [LatticeSearch(channel.stored, store=store) for channel in originals]
        heads, count = heads_of(recording, settings), len(recording)
        longest = settings.cluster_of(recording)
        self.job = EncodeJob(
            settings,
            originals,
            promises,
            searches,
            threads,
            heads,
            [],
            PacketLengths(longest, longest),
        )
        prepared, loads = put_on_grids(self.job, 0, count)
        lengths = PacketLengths.of(recording, settings, loads)
        self.job = replace(self.job, loads=loads, lengths=lengths)
        self.rivals: Rivals = {}
        self.exact: Encoding | None = None
        self.parts: list[PlacedUnit] = []
        for first, stop in pairwise([*heads, count]):
            rows = prepared[first:stop]
            own = list(encode_parts(self.job, first, rows, lambda done: progress(done, count)))
            related = settings.references and settings.searches.relations
            self.parts += with_relations(own, self.job) if related else own

    @property
    def textures(self) -> list[PlacedUnit]:
        """Parts that are one channel with a texture."""
        return [part for part in self.parts if part.members[0].promise.texture]

    def at_quality(self, db: float) -> list[PlacedUnit]:
        """All parts, textures with that signal-to-noise ratio."""

        def code(part: PlacedUnit) -> PlacedUnit:
            (member,) = part.members
            if member.promise.texture is None:
                return part
            texture = replace(member.promise.texture, snr=db)
            again = replace(member, promise=replace(member.promise, texture=texture))
            unit = encode_unit([again], part.first, self.job)
            if unit.reached:
                unit.missed = ""  # the search asks for this quality, not the user
            return PlacedUnit(unit, part.first, [again])

        again = in_order(code, self.textures, self.job.threads)
        count = len(self.recording)
        out = []
        for part in self.parts:
            out.append(next(again) if part.members[0].promise.texture else part)
            self.progress(part.stop, count)
        return out

    def finish(self, parts: list[PlacedUnit]) -> Encoded:
        """The smallest of the files that have some channels without loss."""
        settings = self.job.settings
        if settings.preset == "lossless" or not settings.smallest:
            return self.complete(parts)
        ours = self.complete(with_lossless(parts, self.job, self.rivals))
        theirs = self.without_loss(parts)
        return min(theirs, ours, key=self.size_of) if theirs else ours

    def without_loss(self, parts: list[PlacedUnit]) -> Encoded | None:
        """The file without loss, where the recording is small and that may be the smaller one.

        Estimates are too coarse for few samples, where descriptions and deviations count.
        """
        samples = sum(channel.stored.size for channel in self.job.originals)
        asked = [each.promise for part in parts for each in part.members]
        least = sum(part.unit.least for part in parts)
        hopeless = samples > ALWAYS and 8 * total_cost(parts) <= HOPE * least
        if samples > SMALL or hopeless or all(promise.lossless for promise in asked):
            return None
        if self.exact is None:
            self.exact = Encoding(
                self.recording, self.job.lossless, no_progress, self.job.threads, self.size_of
            )
        return self.exact.complete([in_place(part, asked) for part in self.exact.parts])

    def complete(self, parts: list[PlacedUnit]) -> Encoded:
        """Tracks and packets, and what is reported of them."""
        settings, job = self.job.settings, self.job
        parts = [each for part in parts for each in part.tracks or (part,)]
        decisions: list[Decision] = []
        for part in parts:
            decisions += decide(part, job.originals, self.recording)
            release()
        decisions.sort(key=lambda each: each.channel)
        tracks, packets = number_tracks([part.unit for part in parts])
        exact = not any(decision.largest_error for decision in decisions)
        if exact and settings.preset != "lossless":
            settings = job.lossless
        level, lengths = choose_level(tracks), job.lengths
        return Encoded(
            tracks, packets, decisions, level, settings, lengths.cluster, lengths.cluster_samples
        )


def heads_of(recording: Recording, settings: Settings) -> list[int]:
    """In order. A file counts the ticks of a track and not of its channels, so a channel with
    clocks comes first there; the axes of one vector stay together."""
    found = {0}
    references = {seen.channel for seen in recording.clocks}
    references |= {seen.channel for seen in recording.clock_maps}
    for place in references:
        if isinstance(place, int):
            group = recording.channels[place].group
            inner = place and group and group == recording.channels[place - 1].group
            if not (inner and settings.keeps_vectors):
                found.add(place)
    return sorted(found)


def put_on_grids(
    job: EncodeJob, first: int, stop: int
) -> tuple[tuple[Gridded, ...], tuple[Load, ...]]:
    """The channels first ... stop - 1 as they are coded, and estimates of their sizes."""
    settings = job.settings

    def gridded(number: int) -> tuple[Gridded, Load]:
        search = job.searches[number]
        channel, asked = job.originals[number], job.promises[number]
        found = on_grid(channel, asked, settings, search)
        load = load_of(found, search)
        search.forget()
        found = found.kept(search.store)
        if asked.floor is settings.max_error and not found.promise.lossless:
            check_bound(channel, found, settings)
        return found, load

    pairs = list(in_order(gridded, range(first, stop), job.threads))
    return tuple(found for found, _ in pairs), tuple(load for _, load in pairs)


def encode_parts(
    job: EncodeJob,
    first: int,
    prepared: Sequence[Gridded],
    done: Callable[[int], None] = lambda _done: None,
) -> Iterator[PlacedUnit]:
    """The prepared channels in their order, from number ``first`` on."""
    settings, stop = job.settings, first + len(prepared)
    tell_kept(job.promises[first:stop], prepared, settings)
    groups = list(
        group_units(
            [each.channel for each in prepared],
            job.originals[first:stop],
            required=settings.vectors == "required",
            apart=not settings.keeps_vectors,
        )
    )
    steps, at = [], 0
    for members in groups:
        steps.append(step_of(members, prepared[at].promise, settings))
        release()
        at += len(members)

    runs = list(find_runs(groups, steps))
    starts = accumulate((len(members) for members, _ in runs), initial=0)

    def code(run: tuple[tuple[list[Channel], Links], int]) -> list[PlacedUnit]:
        (members, links), at = run
        rows = [
            each if each.channel is channel else replace(each, channel=channel)
            for each, channel in zip(prepared[at : at + len(members)], members, strict=True)
        ]
        return list(encode_members(rows, links, first + at, job))

    for coded in in_order(code, zip(runs, starts, strict=False), job.threads):
        release()
        for part in coded:
            yield part
            done(part.stop)


def tell_kept(asked: Sequence[Promise], prepared: Sequence[Gridded], settings: Settings) -> None:
    """Warn of channels that stay lossless: infinite samples, or amounts in steps without a step."""
    for option in ("max_error", "floor"):
        amount: Tolerance | None = getattr(settings, option)
        names = [
            repr(each.channel.label)
            for promise, each in zip(asked, prepared, strict=True)
            if promise.floor is amount and each.promise.why == NO_STEP
        ]
        if amount is not None and names:
            more = f" and {len(names) - 1} more" if names[1:] else ""
            text = f"{option} does nothing for {names[0]}{more}: {NO_STEP}; give it in a unit or %"
            warnings.warn(text, DataWarning, stacklevel=5)
    for each in prepared:
        if each.promise.why == INFINITE and np.isinf(each.channel.stored).any():
            warnings.warn(KEPT.format(each.channel.label), DataWarning, stacklevel=5)


def check_bound(channel: Channel, found: Gridded, settings: Settings) -> None:
    """Refuse a largest error that flattens a channel."""
    floor = found.promise.floor
    if settings.allows_any_error or floor is None:
        return
    step = float(abs(channel.calibration.step)) if channel.calibration else None
    extent = range_of(channel)
    error = floor.absolute(extent, step, channel.unit) or 0.0
    if step is None or error >= step:  # below one count nothing is lost
        check_error(settings, extent, error, channel.label, channel.unit)


def as_recorded(channel: Channel) -> Channel:
    """With exact values a channel is these doubles: its counts were found in them."""
    if channel.exact is None:
        return channel
    return replace(channel, stored=channel.exact, exact=None, calibration=None)


def encode_members(
    members: list[Gridded], links: Links, first: int, job: EncodeJob
) -> Iterator[PlacedUnit]:
    """Units and their channels: together where they are linked."""
    if not links:
        yield PlacedUnit(encode_unit(members, first, job), first, members)
        return
    channels = [each.channel for each in members]
    error = error_of(channels[0], members[0].promise)
    # Half of the components: packets of LPCR take less than five bytes a sample.
    half = (len(channels) + 1) // 2
    spans = job.spans(channels, range(first, first + len(channels)), half)
    searches = job.settings.searches
    joint = encode_run(channels, first, error, spans, links, searches)
    apart = (
        PlacedUnit(encode_unit([each], first + place, job), first + place, [each])
        for place, each in enumerate(members)
    )
    if joint is None:
        yield from apart
        return
    joint.channels = tuple(channels)
    together = PlacedUnit(joint, first, members)
    # Alone a channel with an error may be knots.
    both = error or searches.every_form
    yield from smaller(list(apart), [together]) if both else [together]


def with_relations(parts: list[PlacedUnit], job: EncodeJob) -> Iterator[PlacedUnit]:
    """The parts, those in one track that hold doubles which are linear in each other."""
    for run in runs_of_doubles(parts, job):
        channels = [job.originals[part.first] for part in run]
        doubles = [has_doubles(part, job) for part in run]
        costly = [
            double and 8 * part.unit.size > COSTLY * channel.stored.size
            for part, channel, double in zip(run, channels, doubles, strict=True)
        ]
        if len(run) == 1 or not any(costly):
            yield from run
            continue
        # From what is constant no channel follows.
        columns = [
            channel.stored if double else np.zeros(channel.stored.size)
            for channel, double in zip(channels, doubles, strict=True)
        ]
        found = find_relations(columns, costly)
        at = 0
        for start, stop in stretches(found):
            yield from run[at:start]
            own = [each.moved(-start) for each in found if start <= each.target < stop]
            yield from joined(run[start:stop], columns[start:stop], own, job)
            at = stop
        yield from run[at:]


def joined(
    parts: list[PlacedUnit],
    columns: list[NDArray[np.float64]],
    found: list[Relation],
    job: EncodeJob,
) -> list[PlacedUnit]:
    """One part of several tracks, where that is smaller: channels that follow from each other share
    one."""
    job = job.with_sizes(parts, found)
    tracks = [
        part
        for places in groups_of(found, len(parts))
        for part in related([parts[place] for place in places], columns, found, places, job)
    ]
    if len(tracks) == len(parts):
        return parts
    # For what compares sizes, all of them are one.
    every = [packet for part in tracks for packet in part.unit.base.packets]
    whole = Unit(Coded(tracks[0].unit.base.track, every), exact=True)
    members = [part.members[0] for part in parts]
    return [PlacedUnit(whole, parts[0].first, members, tracks=tuple(tracks))]


def related(
    parts: list[PlacedUnit],
    columns: list[NDArray[np.float64]],
    found: list[Relation],
    places: Sequence[int],
    job: EncodeJob,
) -> list[PlacedUnit]:
    """One track of the parts at these places, where it is smaller than they are."""
    if len(parts) == 1:
        return parts
    members = [part.members[0] for part in parts]
    channels = [each.channel for each in members]
    numbers = tuple(part.first for part in parts)
    units = [part.unit for part in parts]
    spans = job.spans(channels, numbers, (len(channels) + 1) // 2)
    own = [each.among(places) for each in found if each.target in places]
    joint = encode_linear(
        channels, [columns[a] for a in places], units, own, numbers, spans, job.settings.searches
    )
    if joint is None or joint.size >= (1 - RELATED) * sum(unit.size for unit in units):
        return parts
    return [PlacedUnit(joint, numbers[0], members, numbers=numbers)]


def has_doubles(part: PlacedUnit, job: EncodeJob) -> bool:
    """Whether these are the doubles of one channel, such as a track of several may hold."""
    if job.originals[part.first].stored.dtype != np.float64:
        return False
    facts = job.searches[part.first].facts
    return (
        facts.finite
        # Words of which one is larger than those of a binary grid may not; others do not come
        # near the largest double, where sums overflow.
        and (
            part.unit.base.track.number_format == "counts"
            or max(-facts.low, facts.high) <= EXACT_LIMIT
        )
    )


def runs_of_doubles(parts: list[PlacedUnit], job: EncodeJob) -> Iterator[list[PlacedUnit]]:
    """All parts in their order; those with the same ticks side by side, as long as a track may hold
    their doubles. Channels of other numbers may lie among these."""
    run: list[PlacedUnit] = []
    count = 0
    for part in parts:
        fits = len(part.members) == 1 and part.members[0].promise.lossless
        double = fits and has_doubles(part, job)
        channel = job.originals[part.first]
        if run and not (
            fits
            and count + double <= RUN_LIMIT
            and same_ticks(job.originals[run[0].first], channel)
        ):
            yield run
            run, count = [], 0
        run.append(part)
        count += double
        if not fits:
            yield run
            run, count = [], 0
    if run:
        yield run


Rivals = dict[tuple[int, int], list[PlacedUnit]]
"""Lossless parts by their first and last channel."""


def with_lossless(parts: list[PlacedUnit], job: EncodeJob, known: Rivals) -> list[PlacedUnit]:
    """The parts, where they are larger than the same channels without loss these in their place.

    ``known`` keeps the lossless parts for the next call.
    """
    lossless = replace(job, settings=job.lossless, promises=[Promise()] * len(job.originals))
    rivals: list[PlacedUnit] = []
    every = job.settings.searches.every_form
    doubtful = [may_lose(part, every=every) for part in parts]
    at = 0
    while at < len(parts):
        stop = at
        while stop < len(parts) and doubtful[stop]:
            stop += 1
            if stop < len(parts) and parts[stop].first in job.heads:
                break
        if stop > at:
            ends = parts[at].first, parts[stop - 1].stop
            if ends not in known:
                known[ends] = list(
                    encode_parts(lossless, ends[0], put_on_grids(lossless, *ends)[0])
                )
            rivals += known[ends]
        at = max(stop, at + 1)
    asked = [each.promise for part in parts for each in part.members]
    rivals = [in_place(part, asked) for part in rivals]
    return list(smaller(parts, rivals))


def in_place(part: PlacedUnit, asked: list[Promise]) -> PlacedUnit:
    """A lossless part, with the reason why it replaces the requested form."""
    members = [
        replace(each, promise=promise if promise.lossless else instead_of(promise))
        for each, promise in zip(part.members, (asked[n] for n in part.channels), strict=True)
    ]
    tracks = tuple(in_place(each, asked) for each in part.tracks)
    return replace(part, unit=replace(part.unit, instead=True), members=members, tracks=tracks)


def instead_of(promise: Promise) -> Promise:
    return Promise(texture=promise.texture, why=SMALLER)


def may_lose(part: PlacedUnit, *, every: bool) -> bool:
    """Whether a lossless form may be smaller: what lost nothing is the smallest found.

    Measured: on a grid of wider steps a channel is never larger. Other forms were, where they took
    more than LIKELY of the quick estimate. ``every``: try all that are not certain.
    """
    if part.unit.exact and not any(each.channel.deviation for each in part.members):
        return False
    promise = part.members[0].promise
    if every:
        return 8 * part.unit.cost > HOPE * part.unit.least
    stepped = not (promise.k or promise.paper or promise.texture)
    return not stepped and 8 * part.unit.cost > LIKELY * part.unit.least


def total_cost(parts: list[PlacedUnit]) -> int:
    return sum(part.unit.cost for part in parts)


def smaller(parts: list[PlacedUnit], rivals: list[PlacedUnit]) -> Iterator[PlacedUnit]:
    """Stretch by stretch of channels that both cut alike, the smaller; of equal ones the rival."""
    at = place = 0
    while at < len(parts):
        if place == len(rivals) or parts[at].stop <= rivals[place].first:
            yield parts[at]
            at += 1
            continue
        ours, theirs = [parts[at]], [rivals[place]]
        at, place = at + 1, place + 1
        while ours[-1].stop != theirs[-1].stop:
            if ours[-1].stop < theirs[-1].stop:
                ours.append(parts[at])
                at += 1
            else:
                theirs.append(rivals[place])
                place += 1
        if total_cost(theirs) > total_cost(ours):
            yield from ours
            continue
        yield from theirs


def decide(part: PlacedUnit, originals: list[Channel], recording: Recording) -> Iterator[Decision]:
    """What is reported of each channel of a unit; the bytes of a vector in equal parts."""
    unit, count = part.unit, len(part.members)
    pair = TrackPair(unit.base.track, unit.residual.track if unit.residual else None)
    within = unit.exact or bool(pair.contract and pair.contract.guaranteed)
    shares = unit.parts or ((unit.reason, unit.size // count),) * count
    sources = recording.channels if unit.instead else originals
    errors = largest_errors(
        unit,
        unit.channels or [each.channel for each in part.members],
        [as_recorded(sources[number]) for number in part.channels],
    )
    for place, each in enumerate(part.members):
        number = part.channels[place]
        reason, size = shares[place]
        given = recording.channels[number]
        why = "" if each.promise.why == reason else each.promise.why
        missed = unit.missed
        if unit.instead and each.promise.texture is not None:
            missed = SMALLER_LOSSLESS
        yield Decision(
            channel=number,
            label=given.label,
            sample_count=int(given.stored.size),
            axis_count=1 if unit.parts else count,
            chosen=unit.chosen,
            reason=f"{reason} ({why})" if why else reason,
            lattice=unit.grid or each.text,
            exact=unit.exact,
            within=within,
            size=size,
            unit=given.unit,
            kept_as=pair.kept_as(place),
            largest_error=errors[place],
            relative_error=share_of_range(errors[place], given),
            original_bits=8 * (given.stored if given.exact is None else given.exact).itemsize,
            missed=missed,
            **unit.reached,
        )


def share_of_range(error: float, channel: Channel) -> float:
    extent = range_of(channel) if error else 0.0
    return error / extent if 0 < extent < inf else 0.0


def encode_unit(members: list[Gridded], first_channel: int, job: EncodeJob) -> Unit:
    """A channel, or the axes of a vector: the smallest way to keep the promise."""
    channels = [each.channel for each in members]
    channel = channels[0]
    original = job.originals[first_channel]
    if channel.rate_exact.numerator >> 32 or channel.rate_exact.denominator >> 32:
        raise ParameterError(
            f"rate {channel.rate_exact} of channel {channel.label!r} needs more than 32 bits"
        )
    numbers = range(first_channel, first_channel + len(channels))
    spans = job.spans(channels, numbers, len(channels))
    if channel.calibration is None:
        kind = WORDS.get(channel.stored.dtype)
        if kind is None:
            raise ParameterError(
                f"channel {channel.label!r} holds {channel.stored.dtype}: give it a calibration, "
                "or one of int64, uint64, float16, float32, float64"
            )
        words = partial(encode_words, channel, spans, first_channel, kind, WORDS_REASON)
        if kind != "binary64":
            return words()
        return encode_doubles(
            channel, spans, first_channel, words, job.searches[first_channel],
            effort=job.settings.searches,
        )  # fmt: skip
    counts = side_by_side(channels)
    if counts.size and not -(1 << 31) <= int(counts.min()) <= int(counts.max()) < 1 << 31:
        raise ParameterError(f"channel {channel.label!r} has counts of more than 32 bits")
    source = InputBlock(tuple(channels), counts, spans)
    unit = encode_source(source, members, original, first_channel, job)
    unit.channels = unit.channels or source.channels
    return unit


def encode_source(
    source: InputBlock,
    members: list[Gridded],
    original: Channel,
    first_channel: int,
    job: EncodeJob,
) -> Unit:
    """Channels of counts: the smallest way to keep the promise."""
    base = whole_range(source, first_channel)
    promise, settings, spans = members[0].promise, job.settings, source.spans
    channel, counts = source.channels[0], source.counts
    if is_constant(source):
        return encode_constant(source, base)
    if promise.lossless:

        def as_counts() -> Unit:
            return encode_lossless(source, base, settings.searches)

        rounded = original.stored.dtype == "f8" and channel.deviation is None and sparse(counts)
        if rounded:
            # Values that a text format rounded may lie on a much coarser grid.
            assert channel.calibration is not None
            exact = Lattice(channel.calibration, counts[:, 0], True, 0.0, "")
            return encode_doubles(
                original, spans, first_channel, as_counts, job.searches[first_channel],
                exact=exact, grid=False, effort=settings.searches,
            )  # fmt: skip
        return as_counts()
    if promise.paper:
        unit = encode_paper(source, first_channel, promise, settings)
    elif len(members) > 1:
        joint = encode_bounded(source, base, vector_promise(settings), effort=settings.searches)
        assert joint
        unit = joint
    elif promise.texture is not None:
        found = encode_textured(
            source, original, first_channel, promise, settings.cutoff_hz, settings.searches
        )
        unit = found or without_loss(original, first_channel, job)
    else:
        unit = encode_within(members[0], source, base, first_channel, promise, settings.searches)
    unit.least = unit.least or sum(map(lossless_bits, counts.T))
    return unit


def without_loss(original: Channel, first_channel: int, job: EncodeJob) -> Unit:
    """A texture whose quality no grid has."""
    exact = on_grid(original, Promise(), job.settings, job.searches[first_channel])
    unit = encode_unit([exact], first_channel, job)
    return replace(unit, grid=exact.text, missed="only lossless has it")


def encode_within(
    member: Gridded,
    source: InputBlock,
    base: Track,
    first_channel: int,
    promise: Promise,
    effort: Effort,
) -> Unit:
    """A bound on each sample. Where the grid is the quantiser, knots are tried on a finer one."""
    if member.fine:
        unit = encode_bounded(source, base, promise, effort=effort)
        assert unit
        return unit
    unit = encode_lossless(source, base, effort)
    unit.reason = "each sample from those before, in equal steps"
    fine = member.finer
    if fine is None:
        return unit
    finer = InputBlock((fine.channel,), fine.channel.stored[:, None], source.spans)
    unit.least = lossless_bits(fine.channel.stored)
    base = whole_range(finer, first_channel)
    knots = encode_bounded(finer, base, promise, unit.size, knots_alone=True, effort=effort)
    if knots is None:
        return unit
    return replace(knots, channels=finer.channels, grid=fine.text, least=unit.least)


def number_tracks(units: list[Unit]) -> tuple[list[Track], list[Packet]]:
    """Ids: the base tracks, then the HF tracks in the order of their bases."""
    numbered: list[tuple[Coded, int | None]] = [(unit.base, None) for unit in units]
    numbered += [(unit.residual, id_) for id_, unit in enumerate(units) if unit.residual]
    tracks: list[Track] = []
    packets: list[Packet] = []
    for id_, (coded, base) in enumerate(numbered):
        tracks.append(coded.track.numbered(id_, base))
        packets += [
            Packet(id_, packet.start, packet.span, packet.data) for packet in join_constant(coded)
        ]
    return tracks, packets


def join_constant(coded: Coded) -> Iterator[Packet]:
    """Neighbours that are the same constant as one packet, so that silence costs next to nothing:
    a packet alone takes ten bytes of a cluster's table."""
    if len(coded.packets) < 2:
        yield from coded.packets
        return
    runs: list[list[Packet]] = []
    limit = JOINED_TICKS // len(coded.track.components)
    for packet in coded.packets:
        last = runs[-1] if runs else []
        if (
            last
            and packet.data == last[-1].data
            and packet.start == last[-1].stop
            and packet.stop - last[0].start <= limit
        ):
            last.append(packet)
        else:
            runs.append([packet])
    for run in runs:
        joint = replace(run[0], span=run[-1].stop - run[0].start)
        if len(run) > 1 and is_same_constant(coded.track, joint, run[0]):
            yield joint
        else:
            yield from run


def is_same_constant(track: Track, joint: Packet, part: Packet) -> bool:
    """Whether the joint packet, of the bytes of a part, is the constant that the part is."""
    decoder = TrackDecoder(track, ENCODE_LEVEL)
    first = words_of(decoder, part)
    if (first != first[0]).any():
        return False
    try:
        return bool((words_of(decoder, joint) == first[0]).all())
    except FormatError:
        return False


def words_of(decoder: TrackDecoder, packet: Packet) -> NDArray[Any]:
    """What a packet holds: counts or words, and of exact values the bits."""
    numbers = decoder.decode(packet)
    exact = decoder.decode_exact(packet, numbers)
    return numbers if exact is None else exact.view(np.int64)


def choose_level(tracks: list[Track]) -> Level:
    """Level 1 where everything fits."""
    one = LEVELS[1]
    for track in tracks:
        if not track.in_range_of(one):
            return LEVELS[2]
        if track.codec in ("LPCR", "KNOT"):
            # The levels of a deadband grid are counted from the physical 0, which may lie far off.
            zero = grid_of(track).zero
            if max(zero - track.count_min, track.count_max - zero) > one.count_bound:
                return LEVELS[2]
    return one


def grid_of(track: Track) -> LpcParameters:
    if track.codec == "KNOT":
        return KnotParameters.parse(track.parameters, LEVELS[2], 0).grid
    return LpcParameters.parse(track.parameters, LEVELS[2], 0)
