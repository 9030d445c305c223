"""Recording -> tracks and packets: lattice, units, choice of codec, and what was chosen and why."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from ..codecs.predicted import LpcParameters
from ..container.cluster import Packet
from ..container.track import Track
from ..errors import ParameterError
from ..limits import LAST_TRACK_ID, LEVELS, Level
from ..recording import Channel, Recording
from .groups import group_units
from .lattice import to_counts
from .references import SAVED, Links, encode_run, find_runs, step_of
from .settings import Settings
from .source import Source, cut
from .unit import WORDS_REASON, Unit, encode_counts, encode_words

WORDS = {
    np.dtype(np.int64): "int64",
    np.dtype(np.uint64): "uint64",
    np.dtype(np.float16): "binary16",
    np.dtype(np.float32): "binary32",
    np.dtype(np.float64): "binary64",
}


@dataclass(frozen=True)
class Decision:
    """What became of one channel.

    ``exact``: stored without loss (on its lattice, see ``lattice``); ``within``: every sample was
    found within its deadband. ``axis_count`` channels share a vector. ``size`` in bytes, of packets
    and codebooks.
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
) -> Encoded:
    """All channels of a recording; ``progress`` is called with (channels done, channels in all)."""
    settings = settings or Settings()
    if len(recording) > LAST_TRACK_ID // 2:
        raise ParameterError(f"a recording has at most {LAST_TRACK_ID // 2} channels")
    prepared = [
        to_counts(channel, settings.tolerance_for(channel)) for channel in recording.channels
    ]
    cluster = settings.cluster_of(recording)
    units: list[Unit] = []
    decisions: list[Decision] = []
    groups = list(
        group_units(
            [channel for channel, _ in prepared],
            recording.channels,
            required=settings.vectors == "required",
            apart=settings.preset in ("archive", "near-lossless"),
        )
    )
    for run, links in find_runs(groups, [step_of(members, settings) for members in groups]):
        for unit, members in encode_members(run, links, len(decisions), settings, cluster):
            units.append(unit)
            decisions += decide(unit, members, [why for _, why in prepared[len(decisions) :]])
            if progress:
                progress(len(decisions), len(prepared))
    tracks, packets = number_tracks(units)
    return Encoded(tracks, packets, decisions, choose_level(tracks))


def encode_members(
    members: list[Channel], links: Links, first: int, settings: Settings, cluster: Fraction
) -> Iterator[tuple[Unit, list[Channel]]]:
    """Units and their channels: together, or apart where links do not make them smaller."""
    if not links:
        yield encode_unit(members, first, settings, cluster), members
        return
    apart = [
        encode_unit([channel], first + place, settings, cluster)
        for place, channel in enumerate(members)
    ]
    joint = encode_run(members, first, settings, cluster, links, apart)
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
            sample_count=int(channel.values.size),
            axis_count=1 if unit.parts else len(members),
            chosen=unit.chosen,
            reason=reason,
            lattice=lattice,
            exact=unit.exact,
            within=within,
            size=size,
        )


def encode_unit(
    channels: list[Channel], first_channel: int, settings: Settings, cluster: Fraction
) -> Unit:
    channel = channels[0]
    if channel.rate.numerator >> 32 or channel.rate.denominator >> 32:
        raise ParameterError(
            f"rate {channel.rate} of channel {channel.label!r} needs more than 32 bits"
        )
    spans = tuple(cut(channel.coverage, channel.rate, cluster, len(channels)))
    if channel.calibration is None:
        kind = WORDS.get(channel.values.dtype)
        if kind is None:
            raise ParameterError(
                f"channel {channel.label!r} holds {channel.values.dtype}: give it a calibration, "
                "or one of int64, uint64, float16, float32, float64"
            )
        return encode_words(channel, spans, first_channel, kind, WORDS_REASON)
    counts = np.column_stack([each.values.astype(np.int64) for each in channels])
    if counts.size and not -(1 << 31) <= int(counts.min()) <= int(counts.max()) < 1 << 31:
        raise ParameterError(f"channel {channel.label!r} has counts of more than 32 bits")
    return encode_counts(Source(tuple(channels), counts, spans), first_channel, settings)


def number_tracks(units: list[Unit]) -> tuple[list[Track], list[Packet]]:
    """Ids: the base tracks in order of their channels, then the HF tracks in the same order."""
    tracks: list[Track] = []
    packets: list[Packet] = []
    bases = [unit.base for unit in units]
    residuals = [(unit.residual, place) for place, unit in enumerate(units) if unit.residual]
    for id_, coded in enumerate(bases):
        tracks.append(replace(coded.track, id=id_))
        packets += [replace(packet, track=id_) for packet in coded.packets]
    for id_, (coded, place) in enumerate(residuals, len(bases)):
        tracks.append(replace(coded.track, id=id_, base=place))
        packets += [replace(packet, track=id_) for packet in coded.packets]
    return tracks, packets


def choose_level(tracks: list[Track]) -> Level:
    """Level 1 where everything fits."""
    one = LEVELS[1]
    for track in tracks:
        bits = one.residual_bits if track.kind == "hf" else one.count_bits
        bound = 1 << (bits - 1)
        if track.count_min < -bound or track.count_max >= bound:
            return LEVELS[2]
        if track.codec == "LPCR":
            # The levels of a deadband grid are counted from the physical 0, which may lie far off.
            zero = LpcParameters.parse(track.parameters, LEVELS[2], 0).zero
            if max(zero - track.count_min, track.count_max - zero) > one.count_bound:
                return LEVELS[2]
    return one
