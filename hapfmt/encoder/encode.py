"""Recording -> tracks and packets: lattice, units, choice of codec, and what was chosen and why."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import LpcParameters
from ..codecs.knots_coded import CodedKnotParameters
from ..container.cluster import Packet
from ..container.track import Track
from ..errors import FormatError, ParameterError
from ..limits import LAST_TRACK_ID, LEVELS, Level
from ..reading.decoder import TrackDecoder
from ..recording import Channel, Recording
from ..threads import in_order, thread_count
from .auto import NOTHING, Plan, encode_auto, plan_channel, plan_unit
from .exact import encode_doubles
from .groups import group_units
from .lattice import Lattice, sparse, to_counts
from .packed import Coded
from .references import SAVED, Links, encode_run, find_runs, step_of
from .settings import Settings
from .source import Source, cut, side_by_side
from .unit import ENCODE_LEVEL, Unit, encode_counts
from .words import WORDS_REASON, encode_words, words_size

WORDS = {
    np.dtype(np.int64): "int64",
    np.dtype(np.uint64): "uint64",
    np.dtype(np.float16): "binary16",
    np.dtype(np.float32): "binary32",
    np.dtype(np.float64): "binary64",
}


JOINED_TICKS = 1 << 19
"""Of a constant packet with one component, at most: eight of them fill a cluster of level 1."""


@dataclass(frozen=True)
class Decision:
    """What became of one channel.

    ``exact``: stored without loss (on its lattice, see ``lattice``); ``within``: every sample was
    found within its deadband. ``axis_count`` channels share a vector. ``size`` in bytes, of packets
    and codebooks. ``left_out``: told by preset auto.
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
    left_out: str = ""
    unit: str = ""
    kept_as: str = ""
    largest_error: float = 0.0
    original_bits: int = 64

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


@dataclass
class Encoded:
    """Tracks in order of their ids, packets track by track, and the decisions."""

    tracks: list[Track]
    packets: list[Packet]
    decisions: list[Decision]
    level: Level


def encode(
    recording: Recording,
    settings: Settings | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
    threads: int | None = None,
) -> Encoded:
    """All channels of a recording; ``progress`` is called with (channels done, channels in all).

    ``threads``: as in :func:`hapfmt.write`; the result does not depend on it.
    """
    settings = settings or Settings()
    threads = min(thread_count(threads, recording.sample_count), len(recording))
    if len(recording) > LAST_TRACK_ID // 2:
        raise ParameterError(f"a recording has at most {LAST_TRACK_ID // 2} channels")
    originals = [as_recorded(channel) for channel in recording.channels]
    planned = list(in_order(lambda channel: prepare(channel, settings), originals, threads))
    plans = [plan for plan, _, _ in planned]
    prepared = [(channel, lattice) for _, channel, lattice in planned]
    cluster = settings.cluster_of(recording)
    units: list[Unit] = []
    decisions: list[Decision] = []
    groups = list(
        group_units(
            [channel for channel, _ in prepared],
            originals,
            required=settings.vectors == "required",
            apart=settings.preset in ("archive", "near-lossless")
            or (settings.preset == "auto" and settings.vectors != "required"),
        )
    )
    job = Job(settings, originals, plans, cluster)

    def code(run: Run) -> list[tuple[Unit, list[Channel]]]:
        return list(encode_members(*run, job))

    runs = find_runs(groups, [step_of(members, settings) for members in groups])
    for coded in in_order(code, numbered(runs), threads):
        for unit, members in coded:
            units.append(unit)
            decisions += decide(unit, members, [why for _, why in prepared[len(decisions) :]])
            if progress:
                progress(len(decisions), len(prepared))
    tracks, packets = number_tracks(units)
    return Encoded(tracks, packets, decisions, choose_level(tracks))


@dataclass(frozen=True)
class Job:
    """What was asked, the channels as they were recorded, and the plan of each."""

    settings: Settings
    originals: list[Channel]
    plans: list[Plan]
    cluster: Fraction

    def unit(self, members: list[Channel], first: int) -> Unit:
        plan = plan_unit(self.plans[first : first + len(members)], self.settings)
        return encode_unit(members, self.originals[first], first, plan, self.cluster)


Run = tuple[list[Channel], Links, int]
"""Channels, their links, and the number of the first."""


def numbered(runs: Iterable[tuple[list[Channel], Links]]) -> Iterator[Run]:
    first = 0
    for members, links in runs:
        yield members, links, first
        first += len(members)


def prepare(channel: Channel, settings: Settings) -> tuple[Plan, Channel, str]:
    """What one channel is coded with, the channel in counts, and a line on its lattice."""
    plan = plan_channel(channel, settings)
    return plan, *to_counts(channel, plan.settings.tolerance_for(channel))


def as_recorded(channel: Channel) -> Channel:
    """With exact values a channel is these doubles: its counts were found in them."""
    if channel.exact is None:
        return channel
    return replace(channel, stored=channel.exact, exact=None, calibration=None)


def encode_members(
    members: list[Channel], links: Links, first: int, job: Job
) -> Iterator[tuple[Unit, list[Channel]]]:
    """Units and their channels: together, or apart where links do not make them smaller."""
    if not links:
        yield job.unit(members, first), members
        return
    apart = [job.unit([channel], first + place) for place, channel in enumerate(members)]
    joint = encode_run(members, first, job.settings, job.cluster, links, apart)
    if joint and joint.size < (1 - SAVED) * sum(unit.size for unit in apart):
        yield joint, members
    else:
        yield from ((unit, [channel]) for unit, channel in zip(apart, members, strict=True))


def decide(unit: Unit, members: list[Channel], lattices: list[str]) -> Iterator[Decision]:
    """What is told of each channel of a unit; the bytes of a vector in equal parts."""
    last = (unit.residual or unit.base).track
    contract = last.contract
    within = unit.exact or bool(contract and contract.guaranteed)
    shares = unit.parts or [(unit.reason, unit.size // len(members))] * len(members)
    for place, (channel, lattice) in enumerate(zip(members, lattices, strict=False)):
        reason, size = shares[place]
        yield Decision(
            channel=unit.base.track.first_channel + place,
            label=channel.label,
            sample_count=int(channel.stored.size),
            axis_count=1 if unit.parts else len(members),
            chosen=unit.chosen,
            reason=reason,
            lattice=lattice,
            exact=unit.exact,
            within=within,
            size=size,
            left_out=unit.left_out,
        )


def encode_unit(
    channels: list[Channel], original: Channel, first_channel: int, plan: Plan, cluster: Fraction
) -> Unit:
    """``original``: the first channel before it was put on a lattice."""
    channel, settings = channels[0], plan.settings
    if channel.rate_exact.numerator >> 32 or channel.rate_exact.denominator >> 32:
        raise ParameterError(
            f"rate {channel.rate_exact} of channel {channel.label!r} needs more than 32 bits"
        )
    spans = tuple(cut(channel.coverage, channel.rate_exact, cluster, len(channels)))
    if channel.calibration is None:
        kind = WORDS.get(channel.stored.dtype)
        if kind is None:
            raise ParameterError(
                f"channel {channel.label!r} holds {channel.stored.dtype}: give it a calibration, "
                "or one of int64, uint64, float16, float32, float64"
            )

        def words() -> Unit:
            return encode_words(channel, spans, first_channel, kind, WORDS_REASON)

        if kind == "binary64":
            unit = encode_doubles(
                channel, spans, first_channel, words, least=lambda: words_size(channel, spans)
            )
        else:
            unit = words()
        return replace(unit, left_out=NOTHING) if plan.why else unit
    counts = side_by_side(channels)
    if counts.size and not -(1 << 31) <= int(counts.min()) <= int(counts.max()) < 1 << 31:
        raise ParameterError(f"channel {channel.label!r} has counts of more than 32 bits")

    def as_counts() -> Unit:
        source = Source(tuple(channels), counts, spans)
        if plan.why:
            return encode_auto(source, first_channel, plan)
        return encode_counts(source, first_channel, settings)

    rounded = original.stored.dtype == "f8" and channel.deviation is None and sparse(counts)
    if settings.preset == "archive" and rounded:
        # What a text rounded may lie on a much coarser lattice.
        exact = Lattice(channel.calibration, counts[:, 0], True, 0.0, "")
        return encode_doubles(original, spans, first_channel, as_counts, exact=exact, grid=False)
    return as_counts()


def number_tracks(units: list[Unit]) -> tuple[list[Track], list[Packet]]:
    """Ids: the base tracks, those together that can share a series, then the HF tracks in the
    order of their bases."""
    places: dict[tuple[object, ...], list[Unit]] = {}
    for unit in units:
        places.setdefault(unit.base.track.shared, []).append(unit)
    ordered = [unit for alike in places.values() for unit in alike]
    numbered: list[tuple[Coded, int | None]] = [(unit.base, None) for unit in ordered]
    numbered += [(unit.residual, id_) for id_, unit in enumerate(ordered) if unit.residual]
    tracks: list[Track] = []
    packets: list[Packet] = []
    for id_, (coded, base) in enumerate(numbered):
        tracks.append(replace(coded.track, id=id_, base=base))
        packets += [replace(packet, track=id_) for packet in join_constant(coded)]
    return tracks, packets


def join_constant(coded: Coded) -> Iterator[Packet]:
    """Neighbours that are the same constant as one packet, so that silence costs next to nothing:
    a packet alone takes ten bytes of a cluster's table."""
    decoder = TrackDecoder(coded.track, ENCODE_LEVEL)
    for run in alike(coded.packets, JOINED_TICKS // len(coded.track.components)):
        joint = replace(run[0], span=run[-1].stop - run[0].start)
        if len(run) > 1 and is_constant(decoder, joint, run[0]):
            yield joint
        else:
            yield from run


def alike(packets: Sequence[Packet], limit: int) -> Iterator[list[Packet]]:
    """Runs of adjacent packets of the same bytes, of ``limit`` ticks together at most."""
    run: list[Packet] = []
    for packet in packets:
        if run and (
            packet.data != run[-1].data
            or packet.start != run[-1].stop
            or packet.stop - run[0].start > limit
        ):
            yield run
            run = []
        run.append(packet)
    if run:
        yield run


def is_constant(decoder: TrackDecoder, joint: Packet, part: Packet) -> bool:
    """Whether the joint packet, of the bytes of a part, is the constant that the part is."""
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
        bits = one.residual_bits if track.kind == "hf" else one.count_bits
        bound = 1 << (bits - 1)
        if track.count_min < -bound or track.count_max >= bound:
            return LEVELS[2]
        if track.codec in ("LPCR", "KNTE"):
            # The levels of a deadband grid are counted from the physical 0, which may lie far off.
            zero = grid_of(track).zero
            if max(zero - track.count_min, track.count_max - zero) > one.count_bound:
                return LEVELS[2]
    return one


def grid_of(track: Track) -> LpcParameters:
    if track.codec == "KNTE":
        return CodedKnotParameters.parse(track.parameters, LEVELS[2], 0).grid
    return LpcParameters.parse(track.parameters, LEVELS[2], 0)
