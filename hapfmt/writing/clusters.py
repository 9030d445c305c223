"""Samples in the order of their arrival -> clusters, each of one time range.

Events and clock observations go into the cluster of their time. Observations of other clocks are
stored unchanged, with the next cluster.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockObservation, by_clock, check_steps
from ..codecs.events import EVENT_RATE, CodedEvent, build_event, coded, event_packets, layer_track
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Track
from ..reading.clocks import fit_clock
from ..recording import NANOSECONDS, Event, spans_of
from .filewriter import FileWriter

PACKET_SAMPLES = 1 << 16
"""Longer stretches are cut: eight bytes each then still fit a payload of level 1."""


class SampleRows(NamedTuple):
    """Samples of channels of one rate: values [ticks, channels], int32 counts or float64, NaN where
    one is missing. Without ticks: the channels have nothing before ``start``."""

    channels: tuple[int, ...]
    start: int
    values: NDArray[Any]

    @property
    def stop(self) -> int:
        return self.start + len(self.values)


class SamplePiece(NamedTuple):
    """Samples of one channel without a gap."""

    channel: int
    start: int
    values: NDArray[Any]


class ClusterGrid(NamedTuple):
    """Where clusters begin, in ticks of one rate."""

    ticks: int
    clusters: int

    @classmethod
    def of(cls, cluster: Fraction, rate: Fraction) -> ClusterGrid:
        return cls(*(cluster * rate).as_integer_ratio())

    def number(self, tick: int) -> int:
        """The cluster that a tick lies in."""
        return tick * self.clusters // self.ticks

    def start(self, number: int) -> int:
        """The first tick of a cluster."""
        return -(-number * self.ticks // self.clusters)


@dataclass
class Bucket:
    """Rows of one cluster that were not written yet."""

    since: float
    """When the first of them came, in seconds of the caller's clock."""
    rows: list[SampleRows] = field(default_factory=list)
    size: int = 0


class Clusters:
    """Collects rows and says which clusters are complete.

    A cluster is complete when every channel has passed its end, or one is ``patience`` seconds past
    it. With patience None all are waited for. Channels that were not waited for are not until they
    have caught up; what they bring for clusters that are done comes in clusters of its own.
    """

    def __init__(self, cluster: Fraction, patience: Fraction | None) -> None:
        self.cluster, self.patience = cluster, patience
        self.buckets: dict[int, Bucket] = {}
        self.done = 0
        """Clusters before this one were written."""
        self.late = 0 if patience is None else 1 + ceil(patience / cluster)
        self.size = self.missing = 0
        """Bytes that are here, and samples that were NaN."""
        self.rates: list[Fraction] = []
        self.grids: list[ClusterGrid] = []
        self.rate_of = np.empty(0, np.intp)
        self.reach = np.empty(0, np.int64)
        """Tick after the last one that a channel brought."""
        self.behind = np.empty(0, np.bool_)
        self.index: dict[tuple[int, ...], NDArray[np.intp]] = {}

    def add(self, channel: int, rate: Fraction, start: int) -> None:
        """A channel; numbers may be added in any order, some of them never."""
        if rate not in self.rates:
            self.rates.append(rate)
            self.grids.append(ClusterGrid.of(self.cluster, rate))
        if channel >= self.reach.size:
            more = channel + 1 - self.reach.size
            self.rate_of = np.pad(self.rate_of, (0, more))
            self.reach = np.pad(self.reach, (0, more))
            self.behind = np.pad(self.behind, (0, more), constant_values=True)
        self.rate_of[channel] = self.rates.index(rate)
        self.reach[channel] = start
        self.behind[channel] = False

    @property
    def done_s(self) -> Fraction:
        """Seconds up to which clusters are done."""
        return self.done * self.cluster

    @property
    def oldest(self) -> float | None:
        """When the first of the rows that are still here came."""
        return min((bucket.since for bucket in self.buckets.values()), default=None)

    def take(self, rows: SampleRows, now: float = 0.0) -> bool:
        """Whether a cluster may be complete now."""
        place = int(self.rate_of[rows.channels[0]])
        grid = self.grids[place]
        index = self.index.get(rows.channels)
        if index is None:
            index = self.index[rows.channels] = np.array(rows.channels, np.intp)
        self.reach[index] = rows.stop
        at = rows.start
        number = grid.number(at)
        while at < rows.stop:
            stop = min(grid.start(number + 1), rows.stop)
            part = rows.values[at - rows.start : stop - rows.start]
            bucket = self.buckets.setdefault(number, Bucket(now))
            bucket.rows.append(SampleRows(rows.channels, at, part))
            bucket.size += part.nbytes
            self.size += part.nbytes
            at = stop
            number = grid.number(at)
        # The first cluster that is open, or the one after it: this tick lies past it.
        return bool(self.buckets) and number > min(self.buckets)

    def complete(self) -> Iterator[list[SamplePiece]]:
        """Clusters whose time has come; they are here no more."""
        while True:
            late = sorted(number for number in self.buckets if number < self.done)
            for number in late[: max(len(late) - self.late, 0)]:
                yield self.pop(number)
            open_ = min((number for number in self.buckets if number >= self.done), default=None)
            if open_ is None or not self.is_complete(open_):
                return
            for number in late[max(len(late) - self.late, 0) :]:
                yield self.pop(number)
            self.done = open_ + 1
            self.behind |= self.reach < self.ticks(Fraction(self.done))
            yield self.pop(open_)

    def is_complete(self, number: int) -> bool:
        self.behind &= self.reach < self.ticks(Fraction(number))
        end = Fraction(number + 1)
        if bool((self.behind | (self.reach >= self.ticks(end))).all()):
            return True
        if self.patience is None:
            return False
        return bool((self.reach >= self.ticks(end + self.patience / self.cluster)).any())

    def ticks(self, clusters: Fraction) -> NDArray[np.int64]:
        """The first tick of each channel at or after ``clusters`` clusters."""
        firsts = [ceil(clusters * grid.ticks / grid.clusters) for grid in self.grids]
        return np.array(firsts, np.int64)[self.rate_of]

    def rest(self) -> Iterator[list[SamplePiece]]:
        """All that is here, complete or not."""
        for number in sorted(self.buckets):
            yield self.pop(number)

    def pop(self, number: int) -> list[SamplePiece]:
        bucket = self.buckets.pop(number)
        self.size -= bucket.size
        pieces = list(pieces_of(bucket.rows))
        self.missing += sum(rows.values.size for rows in bucket.rows)
        self.missing -= sum(piece.values.size for piece in pieces)
        return pieces


def pieces_of(rows: Sequence[SampleRows]) -> Iterator[SamplePiece]:
    """Stretches without a gap, by channel, in order of time."""
    lanes: dict[tuple[int, ...], list[SampleRows]] = {}
    for part in rows:
        lanes.setdefault(part.channels, []).append(part)
    found: dict[int, list[SamplePiece]] = {}
    for channels, parts in lanes.items():
        for start, columns in joined([(part.start, part.values.T) for part in parts]):
            holes = columns.dtype.kind == "f" and bool(np.isnan(columns).any())
            for channel, column in zip(channels, columns, strict=True):
                parts_of = found.setdefault(channel, [])
                if holes:
                    parts_of += known(channel, start, column)
                else:
                    parts_of.append(SamplePiece(channel, start, column))
    for channel in sorted(found):
        own = sorted(found[channel], key=lambda piece: piece.start)
        for start, values in joined([(piece.start, piece.values) for piece in own]):
            for at in range(0, len(values), PACKET_SAMPLES):
                yield SamplePiece(channel, start + at, values[at : at + PACKET_SAMPLES])


def joined(parts: Sequence[tuple[int, NDArray[Any]]]) -> Iterator[tuple[int, NDArray[Any]]]:
    """Adjacent parts [..., samples] as one, from the first one's tick."""
    at = 0
    while at < len(parts):
        start = stop = parts[at][0]
        run = []
        while at < len(parts) and parts[at][0] == stop:
            run.append(parts[at][1])
            stop += parts[at][1].shape[-1]
            at += 1
        if len(run) == 1:
            yield start, np.ascontiguousarray(run[0])
            continue
        # Part by part, because that transposes rows of many channels in the cache.
        whole = np.empty((*run[0].shape[:-1], stop - start), np.result_type(*run))
        filled = 0
        for part in run:
            whole[..., filled : filled + part.shape[-1]] = part
            filled += part.shape[-1]
        yield start, whole


def known(channel: int, start: int, values: NDArray[Any]) -> Iterator[SamplePiece]:
    """What is not NaN."""
    for span in spans_of(~np.isnan(values), start):
        yield SamplePiece(channel, span.start, values[span.start - start : span.stop - start])


class Waiting(NamedTuple):
    """An event that was not written yet."""

    time: Fraction
    layer: str
    coded: CodedEvent


class Layers:
    """Events of each layer: a track at the first of them, or one that is in the file."""

    def __init__(self, tracks: Iterable[Track]) -> None:
        layers = (track for track in tracks if track.kind == "events")
        self.tracks = {track.components[0].label: track for track in layers}
        self.waiting: list[Waiting] = []

    def add(self, event: Event, channel: int | None) -> None:
        """``channel``: a channel number in the file."""
        rate = self.tracks[event.layer].rate if event.layer in self.tracks else EVENT_RATE
        self.waiting.append(Waiting(event.time, event.layer, code(event, channel, rate)))

    def take(self, until: Fraction | None, next_track: int) -> tuple[list[Track], list[Packet]]:
        """New tracks, the first of id ``next_track``, and packets of the events before ``until``
        seconds; None: of all."""
        if not self.waiting:
            return [], []
        due = [one for one in self.waiting if until is None or one.time < until]
        self.waiting = [one for one in self.waiting if not (until is None or one.time < until)]
        tracks: list[Track] = []
        packets: list[Packet] = []
        for layer in dict.fromkeys(one.layer for one in due):
            if layer not in self.tracks:
                self.tracks[layer] = layer_track(next_track + len(tracks), layer)
                tracks.append(self.tracks[layer])
            own = sorted((one.coded for one in due if one.layer == layer), key=lambda e: e.tick)
            packets += event_packets(self.tracks[layer].id, own)
        return tracks, packets


def code(event: Event, channel: int | None, rate: Fraction = EVENT_RATE) -> CodedEvent:
    """In ticks of a layer; ParameterError where it cannot be written."""
    found = coded(replace(event, channel=None), rate, [])._replace(channel=channel)
    build_event(found, 0)
    return found


class Observed:
    """Observations that wait until they are written: a channel may have no track yet.

    ``before``: those of the file that is appended to; ``tracks`` of its channels.
    """

    def __init__(
        self,
        *,
        maps: bool,
        before: Iterable[ClockObservation] = (),
        tracks: Mapping[int | str | None, int] | None = None,
    ) -> None:
        self.maps = maps
        """Whether maps are fitted at the end."""
        self.waiting: list[ClockObservation] = []
        self.kept: dict[tuple[str, int | None], array[int]] = {}
        """Tick, time and uncertainty of each, by clock and track: 24 bytes."""
        for seen in before:
            self.keep(seen, (tracks or {}).get(seen.channel))

    def add(self, seen: ClockObservation) -> None:
        self.waiting.append(seen)

    def keep(self, seen: ClockObservation, track: int | None) -> None:
        place = self.kept.setdefault((seen.clock, track), array("q"))
        place.extend((seen.tick, seen.time_ns, seen.uncertainty_ns))

    def write(self, writer: FileWriter, tracks: Mapping[int, int]) -> None:
        """``tracks``: the first track of each channel that has one."""
        if not self.waiting:
            return
        known: dict[int | str | None, int | None] = dict(tracks.items())
        known[None] = None
        ready = [seen for seen in self.waiting if seen.channel in known]
        self.waiting = [seen for seen in self.waiting if seen.channel not in known]
        ready.sort(key=lambda s: (s.clock, s.channel if isinstance(s.channel, int) else -1))
        for (clock, channel), own in by_clock(ready).items():
            rows = ((seen.tick, seen.time_ns, seen.uncertainty_ns) for seen in own)
            writer.clock(clock, known[channel], rows)
            for seen in own:
                self.keep(seen, known[channel])

    def write_maps(self, writer: FileWriter) -> list[str]:
        """Maps for each clock and track where they are asked for, and notes where there is none."""
        notes: list[str] = []
        if not self.maps:
            return notes
        if not self.kept:
            notes.append("clock_maps does nothing here: no clock was observed")
        for (clock, track), flat in self.kept.items():
            rows = zip(flat[::3], flat[1::3], flat[2::3], strict=True)
            rate = NANOSECONDS if track is None else writer.tracks[track].rate
            try:
                fitted = fit_clock([ClockObservation(clock, None, *row) for row in rows], rate)
                check_steps(fitted)
            except ParameterError as error:
                notes.append(f"no map of clock {clock!r}: {error.message}")
                continue
            writer.clock_map(clock, track, fitted.points)
        return notes
