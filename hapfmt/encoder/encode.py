"""Recording -> tracks and packets: lattice, units, choice of codec, and what was chosen and why."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..container.cluster import Packet
from ..container.track import Track
from ..errors import ParameterError
from ..limits import LAST_TRACK_ID, LEVELS, Level
from ..recording import Channel, Recording
from .lattice import to_counts
from .settings import Settings
from .source import Source, cut
from .unit import Unit, encode_counts, encode_words

WORDS = {
    np.dtype(np.int64): "int64",
    np.dtype(np.uint64): "uint64",
    np.dtype(np.float16): "binary16",
    np.dtype(np.float32): "binary32",
    np.dtype(np.float64): "binary64",
}


@dataclass(frozen=True)
class Decision:
    """What became of one channel; sizes in bytes, of packets and codebooks."""

    channel: int
    label: str
    sample_count: int
    chosen: str
    reason: str
    lattice: str
    guaranteed: bool
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
    units: list[Unit] = []
    decisions: list[Decision] = []
    done = 0
    for size in unit_sizes([channel for channel, _ in prepared]):
        members = prepared[done : done + size]
        unit = encode_unit([channel for channel, _ in members], done, settings)
        units.append(unit)
        for i, (channel, lattice) in enumerate(members):
            last = (unit.residual or unit.base).track
            exact = unit.base.track.number_format != "counts" or unit.reason == "constant"
            decisions.append(
                Decision(
                    done + i,
                    channel.label,
                    int(channel.values.size),
                    unit.chosen,
                    unit.reason,
                    lattice,
                    bool(exact or (last.contract and last.contract.guaranteed)),
                    unit.size // size,
                )
            )
        done += size
        if progress:
            progress(done, len(prepared))
    tracks, packets = number_tracks(units)
    return Encoded(tracks, packets, decisions, choose_level(tracks))


def unit_sizes(channels: list[Channel]) -> Iterator[int]:
    """How many neighbouring channels each unit takes: the axes of one vector, or one channel."""
    at = 0
    while at < len(channels):
        first = channels[at]
        size = 1
        if first.group and first.calibration:
            while at + size < len(channels) and same_vector(first, channels[at + size]):
                size += 1
        yield size
        at += size


def same_vector(a: Channel, b: Channel) -> bool:
    """Whether two channels are axes of one vector that one knot clock can serve."""
    return (
        a.group == b.group
        and a.axis != b.axis
        and a.unit == b.unit
        and a.rate == b.rate
        and a.coverage == b.coverage
        and a.calibration is not None
        and b.calibration is not None
        and abs(a.calibration.step) == abs(b.calibration.step)
    )


def encode_unit(channels: list[Channel], first_channel: int, settings: Settings) -> Unit:
    channel = channels[0]
    if channel.rate.numerator >> 32 or channel.rate.denominator >> 32:
        raise ParameterError(
            f"rate {channel.rate} of channel {channel.label!r} needs more than 32 bits"
        )
    spans = tuple(cut(channel.coverage, channel.rate, settings.cluster, len(channels)))
    if channel.calibration is None:
        kind = WORDS.get(channel.values.dtype)
        if kind is None:
            raise ParameterError(
                f"channel {channel.label!r} holds {channel.values.dtype}: give it a calibration, "
                "or one of int64, uint64, float16, float32, float64"
            )
        return encode_words(channel, spans, first_channel, kind, "true doubles, bit for bit")
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
    return one
