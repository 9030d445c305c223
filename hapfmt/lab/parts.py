"""Recordings of any format, read in parts of bounded size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..codecs.grids import UNIFORM, LpcParameters
from ..codecs.quantised import QuanParameters
from ..errors import HapfmtError
from ..format.track import Contract, Track
from ..reading.catalogue import ChannelRef, TrackPair
from ..reading.damage import DamageReport, LostSpan, lost_within
from ..reading.decoder import Assembly, build_channel, join
from ..reading.packets import tick_range
from ..reading.reader import Reader
from ..recording import Channel, Event, Recording

PART = 1 << 20
"""Approximate number of samples, of all channels, decoded at a time; they take 20 MB."""


@dataclass(frozen=True)
class Described:
    """A channel, without its samples. ``contract`` is that of its last track, ``step`` of the
    quantiser of its residual, or of all its samples, in counts; None: there is none."""

    number: int
    label: str
    unit: str
    quantity: str
    rate: Fraction
    lsb: float | None = None
    zero: float = 0.0
    contract: Contract | None = None
    component: int = 0
    step: int | None = None
    has_lf: bool = False
    synthetic: bool = False
    deviation: float = 0.0
    """Largest distance of the source from the grid of counts, in the channel's unit."""
    kept_as: str = ""
    """What the file states of the samples; empty where there is no file."""

    @property
    def name(self) -> str:
        return self.label or f"channel {self.number}"

    @property
    def floor(self) -> float:
        """Absolute threshold of the deadband, in the channel's unit."""
        if self.contract is None or self.lsb is None:
            return 0.0
        floors = self.contract.floor
        return floors[min(self.component, len(floors) - 1)] * self.lsb

    @property
    def weber(self) -> float:
        return self.contract.kn / self.contract.kd if self.contract else 0.0

    @property
    def is_lossy(self) -> bool:
        lossy = self.contract is not None or self.step is not None or self.deviation > 0
        return lossy or self.synthetic

    @property
    def error_bound(self) -> float | None:
        """Largest error that the file allows any sample, in the channel's unit; None: unknown, or
        it depends on the signal."""
        if not self.is_lossy:
            return 0.0
        if self.synthetic:
            return None
        if self.step is not None and self.lsb:
            return self.step * self.lsb / 2 + self.deviation
        contract = self.contract
        if contract is not None and contract.guaranteed and not contract.kn:
            return self.floor + self.deviation
        return self.deviation if contract is None else None

    @property
    def has_deadband(self) -> bool:
        """Whether the allowed error grows with the signal."""
        return self.contract is not None and self.contract.kn > 0

    @property
    def is_vector(self) -> bool:
        return self.contract is not None and self.contract.vector

    def half_width(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Half the width of a scalar deadband around the physical values x, same shape."""
        return np.asarray(np.maximum(self.weber * np.abs(x - self.zero), self.floor))


class ChannelPart(NamedTuple):
    """A part of one channel: the whole band, the LF track, and half the width of the deadband
    around each sample of the whole band [samples], where there are such."""

    full: Channel
    lf: Channel | None = None
    half: NDArray[np.float64] | None = None


class Parts(Protocol):
    """Channels of one recording, examined in parts. ``lost``: spans lost to damage in the parts
    examined so far."""

    channels: list[Described]
    lost: list[LostSpan]

    def extent(self) -> tuple[Fraction, Fraction]:
        """Seconds from the first sample to the end of the last, of all channels together."""

    def edges(self, start: Fraction, stop: Fraction) -> list[Fraction]:
        """Seconds that cut [start, stop) into parts of a good size, the two included."""

    def part(self, start: Fraction, stop: Fraction) -> list[ChannelPart]:
        """The seconds [start, stop) of each channel."""

    def events(self, start: Fraction, stop: Fraction) -> list[Event]: ...

    def damage(self, start: Fraction | None, stop: Fraction | None, /) -> DamageReport | None:
        """What is wrong, as far as the seconds [start, stop) of these channels were examined."""

    def close(self) -> None: ...


class RecordingParts:
    """Parts of a recording in memory; ``places``: the channels, None: all."""

    def __init__(self, recording: Recording, places: Sequence[int] | None = None) -> None:
        chosen = range(len(recording)) if places is None else places
        self.recording = recording
        self.own = [recording.channels[place] for place in chosen]
        self.lost: list[LostSpan] = []
        self.channels = [
            Described(
                place, channel.label, channel.unit, channel.quantity, channel.rate_exact,
                step_of(channel),
            )
            for place, channel in zip(chosen, self.own, strict=True)
        ]  # fmt: skip

    def extent(self) -> tuple[Fraction, Fraction]:
        known = [c for c in self.own if c.stored.size]
        start = min((c.start_tick / c.rate_exact for c in known), default=Fraction(0))
        return start, max((c.duration for c in known), default=start)

    def edges(self, start: Fraction, stop: Fraction) -> list[Fraction]:
        samples = (stop - start) * sum(channel.rate_exact for channel in self.own)
        count = min(max(int(samples) // PART, 1), 10_000)
        return [start + (stop - start) * i / count for i in range(count + 1)]

    def part(self, start: Fraction, stop: Fraction) -> list[ChannelPart]:
        return [
            ChannelPart(channel.slice_ticks(*tick_range(channel.rate_exact, start, stop)))
            for channel in self.own
        ]

    def events(self, start: Fraction, stop: Fraction) -> list[Event]:
        return [event for event in self.recording.events if start <= event.time < stop]

    def damage(self, *_seconds: Fraction | None) -> None:
        return None

    def close(self) -> None:
        pass


class FileParts:
    """Parts of a hapf file; ``names``: labels or numbers of the channels, None: all.

    A file that is read as a whole is checked for damage first.
    """

    def __init__(
        self, reader: Reader, names: Sequence[str | int] | None = None, *, whole: bool = True
    ) -> None:
        if whole:
            reader.scan()
        self.reader = reader
        self.refs = reader.select(names)
        self.lost: list[LostSpan] = []
        self.passed = False
        self.known: list[tuple[Fraction, Fraction]] = []
        """Seconds of intact packets, and of losses between them, in a damaged file."""
        self.channels = [describe(ref, reader) for ref in self.refs]

    def extent(self) -> tuple[Fraction, Fraction]:
        # The times of a damaged cluster are unknown, but its intact packets have their own.
        self.find_lost()
        starts = [ref.start_ns for ref in self.reader.catalogue.data if ref.start_ns is not None]
        firsts = [Fraction(ns, 10**9) for ns in starts] + [span[0] for span in self.known]
        stop = max([self.reader.duration, *(span[1] for span in self.known)])
        return min(min(firsts, default=Fraction(0)), stop), stop

    def edges(self, start: Fraction, stop: Fraction) -> list[Fraction]:
        """Where clusters begin, so that few packets are decoded twice."""
        rate = sum((ref.track.rate for ref in self.refs), Fraction(0))
        starts = sorted({ref.start_ns or 0 for ref in self.reader.catalogue.data})
        found = [start]
        for ns in starts:
            seconds = Fraction(ns, 10**9)
            if seconds < stop and (seconds - found[-1]) * rate >= PART:
                found.append(seconds)
        return [*found, stop]

    def part(self, start: Fraction, stop: Fraction) -> list[ChannelPart]:
        catalogue = self.reader.catalogue
        assembly = self.reader.assembly(self.refs, start, stop)
        if self.reader.catalogue is not catalogue:
            # The index was wrong, so the file was walked: read again, with the chunks found.
            self.refs = self.reader.select([ref.number for ref in self.refs])
            assembly = self.reader.assembly(self.refs, start, stop)
        # If a pass has found the missing spans, parts add only packets that fail to decode.
        new = [s for s in self.reader.lost if not self.passed or s.offset is None]
        self.lost += [span for span in new if span not in self.lost]
        return [block_of(assembly, ref) for ref in self.refs]

    def find_lost(self) -> None:
        """Finds what a damaged file lacks, and its times, in one pass over all its packets."""
        if self.passed or not self.reader.catalogue.damaged:
            return
        tracks = {track.id: track for ref in self.refs for track in ref.tracks}
        ticks: dict[int, tuple[int, int]] = {}
        for packet in self.reader.packets(dict.fromkeys(tracks, (0, 1 << 62))):
            start, stop = packet.start, packet.start + packet.span
            first, last = ticks.get(packet.track, (start, stop))
            ticks[packet.track] = min(first, start), max(last, stop)
        self.lost, self.passed = list(self.reader.lost), True
        spans = [(track, *span) for track, span in ticks.items()]
        if spans:
            spans += [(s.track, s.start, s.stop or s.start) for s in self.lost if s.track in tracks]
        self.known = [
            (first / tracks[track].rate, last / tracks[track].rate) for track, first, last in spans
        ]

    def lost_within(self, start: Fraction | None, stop: Fraction | None) -> list[LostSpan]:
        """The spans of ``lost`` within the seconds [start, stop)."""
        tracks = self.reader.catalogue.tracks
        ranges = {id_: tick_range(track.rate, start, stop) for id_, track in tracks.items()}
        return lost_within(self.lost, ranges, tracks)

    def damage(self, start: Fraction | None, stop: Fraction | None) -> DamageReport:
        numbers = {ref.number for ref in self.refs}
        part = not (start is stop is None and len(self.refs) == len(self.reader.channels))
        return DamageReport(self.reader.catalogue, self.lost_within(start, stop), numbers, part)

    def events(self, start: Fraction, stop: Fraction) -> list[Event]:
        before = self.reader.lost
        found = self.reader.events(start, stop)
        self.reader.lost = before
        return found

    def close(self) -> None:
        self.reader.close()


def step_of(channel: Channel) -> float | None:
    return channel.lsb if channel.calibration is None else float(abs(channel.calibration.step))


def describe(ref: ChannelRef, reader: Reader) -> Described:
    track, part = ref.track, ref.parts[-1]
    component = track.components[ref.index]
    a, b, d = component.calibration
    contract = part.contract
    zero = (contract.zero[ref.index] * a + b) / d if contract and contract.zero else 0.0
    return Described(
        ref.number, ref.label, component.unit, component.quantity, track.rate,
        abs(a) / d if track.number_format == "counts" else None,
        zero, contract, ref.index, quantiser_step(part.residual or part.track, reader),
        any(each.track.kind == "lf" and each.residual for each in ref.parts),
        ref.synthetic,
        max((track.components[ref.index].deviation or (0, 0))[1] for track in ref.tracks),
        ref.kept_as,
    )  # fmt: skip


def quantiser_step(track: Track, reader: Reader) -> int | None:
    """In counts; None where samples are not rounded to a uniform grid, or lossless."""
    level = reader.catalogue.level
    try:
        if track.codec == "QUAN":
            return QuanParameters.parse(track.parameters, level, track.offset).step
        if track.codec == "LPCR":
            grid = LpcParameters.parse(track.parameters, level, track.offset)
            return grid.step if grid.grid == UNIFORM and grid.step > 1 else None
    except HapfmtError:
        pass  # reading says so, with its place
    return None


def block_of(assembly: Assembly, ref: ChannelRef) -> ChannelPart:
    described = ref.track.components[ref.index]
    fulls = assembly.parts(ref)
    lfs = [
        build_channel(assembly.tracks[part.track.id], ref.index, described)
        for part in ref.parts
        if part.track.kind == "lf"
    ]
    halves = None
    if any(part.contract and part.contract.kn for part in ref.parts):
        pairs = zip(ref.parts, fulls, strict=True)
        halves = np.concatenate([half_width(assembly, ref, *pair) for pair in pairs])
    return ChannelPart(join(fulls), join(lfs) if lfs else None, halves)


def half_width(
    assembly: Assembly, ref: ChannelRef, part: TrackPair, full: Channel
) -> NDArray[np.float64]:
    """[samples of full], in the channel's unit: what the contract allows around the decoded values;
    NaN where there is none. For a vector, this is about the norm."""
    contract = part.contract
    if contract is None or full.calibration is None:
        return np.full(full.stored.size, np.nan)
    counts = full.stored[:, None]
    zero, floor = contract.zero[ref.index : ref.index + 1], contract.floor
    if contract.vector:
        counts, zero = assembly.of_part(part).numbers(), contract.zero
    away = counts.astype(np.float64) - np.array(zero)
    norm = np.sqrt(np.einsum("ij,ij->i", away, away))
    allowed = np.maximum(norm * contract.kn / contract.kd, floor[min(ref.index, len(floor) - 1)])
    return np.asarray(allowed * float(abs(full.calibration.step)))
