"""How a recording begins: a new file, or the end of one that is there."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import ceil
from typing import Any, BinaryIO, Literal

from .appending import Appending, open_append
from ..format.clocks import ClockObservation
from ..format.extras import build_metadata
from .filewriter import FileWriter
from ..format.track import Track, missing_channels
from ..format.wire import check_file_id
from ..encoder.live import LiveEncoder
from ..encoder.settings import Settings
from ..errors import ParameterError
from ..limits import LAST_TRACK_ID
from ..numbers import exact
from ..recording import Recording
from ..version import __version__
from .clusters import Clusters
from .extras import Layers
from .file import SyncPolicy, create_live
from ..encoder.inputs import Input
from .observed import Observed
from .output import Output, Pipe
from .queue import Queue
from .worker import Item, Member, Worker

CLUSTER_S = Fraction(1)
"""SPEC clause 15: for a live recording, where the last one may be lost."""

NOTED = 100
"""Channels whose dropped samples get a note each: metadata have to fit a chunk."""


@dataclass
class Options:
    """What the caller asked for, as :class:`Recorder` says."""

    settings: Settings | None = None
    cluster: Any = None
    patience: Any = 1
    hold: Any = None
    fsync: str | float = "cluster"
    append: bool = False
    at: Any = None
    force: bool = False
    metadata: dict[str, Any] = field(default_factory=dict)
    epoch_ns: int | Literal["now"] | None = "now"
    epoch_uncertainty_ns: int = 0
    clock_maps: bool = False
    canonical: int | None = None

    def __post_init__(self) -> None:
        settings = self.settings or Settings()
        asked = settings.cluster if self.cluster is None else self.cluster
        self.cluster = CLUSTER_S if asked is None else exact(asked)
        self.patience = exact(self.patience)
        self.settings = replace(settings, cluster=self.cluster)
        if self.cluster <= 0 or self.patience < 0:
            raise ParameterError("the cluster length must be positive, and patience not negative")
        if self.hold is None and self.canonical is None:
            self.hold = self.cluster + 2 * self.patience
        self.hold = None if self.hold is None else exact(self.hold)
        if self.canonical is not None:
            check_file_id(self.canonical)
            if self.hold is not None or self.append:
                raise ParameterError(
                    "canonical mode cannot use the time of day or append to a file"
                )
            if self.epoch_ns == "now":
                self.epoch_ns = None
        if settings.digest:
            raise ParameterError(
                "checksums cover whole tracks and cannot be written while recording"
            )
        if self.append and self.force:
            raise ParameterError("use either force or append, not both")
        if self.at is not None and not self.append:
            raise ParameterError("at requires append")


class Start:
    """A recorder's parts, made and joined; ``members`` are the inputs in their order."""

    def __init__(
        self,
        file: str | os.PathLike[str] | BinaryIO,
        inputs: Sequence[Input],
        options: Options,
        queue: Queue[Item],
    ) -> None:
        assert options.settings is not None
        self.options, self.settings = options, options.settings
        self.policy = SyncPolicy(options.fsync)
        self.ends: list[int] = []
        self.notes: list[str] = []
        self.metadata = dict(options.metadata)
        self.written: dict[str, Any] = {}
        """Metadata that stands in the file."""
        self.start_s = Fraction(0)
        self.holes: list[int] = []
        """Channel numbers below the highest without a channel."""
        self.observed: list[ClockObservation] = []
        """Those of the file that is gone on with, where maps are asked for."""
        if options.append:
            if not isinstance(file, (str, os.PathLike)):
                raise ParameterError("a stream that is only written cannot be appended to")
            self.append(open_append(file, sync=self.policy, clock=time.monotonic), inputs)
        else:
            self.create(file, inputs)
        layers = Layers(self.output.writer.tracks.values())
        observed = Observed(maps=options.clock_maps, before=self.observed)
        clusters = Clusters(options.cluster, options.patience)
        hold_s = None if options.hold is None else float(options.hold)
        self.worker = Worker(
            queue, self.output, self.encoder, clusters, layers, observed, hold_s=hold_s
        )
        self.worker.add(self.members, self.ends)

    def create(self, file: str | os.PathLike[str] | BinaryIO, inputs: Sequence[Input]) -> None:
        options = self.options
        self.encoder = LiveEncoder(self.settings)
        level = self.encoder.level(inputs)
        epoch_ns = time.time_ns() if options.epoch_ns == "now" else options.epoch_ns
        known = Recording(epoch_ns=epoch_ns, epoch_uncertainty_ns=options.epoch_uncertainty_ns)
        made_by = f"hapfmt {__version__}: {self.settings.describe()}"
        self.metadata["encoder"] = made_by
        build_metadata(self.metadata)
        clock: Callable[[], float] = time.monotonic
        if options.canonical is not None:
            clock = self.recorded
        self.members = [Member(given, number) for number, given in enumerate(inputs)]
        self.ends = [0] * len(inputs)
        self.next_number = len(inputs)
        if isinstance(file, (str, os.PathLike)):
            self.output = Output(
                create_live(file, force=options.force, sync=self.policy), self.policy
            )
        else:
            self.output = Output(Pipe(file), self.policy)
        try:
            self.output.writer = FileWriter(
                self.output.target,
                level=level,
                file_id=options.canonical,
                recording_uuid=uuid.uuid4() if options.canonical is None else None,
                epoch_ns=known.epoch_ns,
                epoch_uncertainty_ns=known.epoch_uncertainty_ns,
                clock=clock,
            )
            self.output.writer.metadata(self.metadata)
            self.written = dict(self.metadata)
        except BaseException:
            self.output.target.close()
            raise

    def recorded(self) -> float:
        """Seconds of the recording, as a clock for what depends on nothing else."""
        writer: FileWriter | None = getattr(self.output, "writer", None)
        return float(writer.stop) if writer else 0.0

    def append(self, found: Appending, inputs: Sequence[Input]) -> None:
        try:
            catalogue, options = found.catalogue, self.options
            self.output = Output(found.file, self.policy)
            self.output.writer = found.writer
            self.encoder = LiveEncoder(
                self.settings, first_track=max(catalogue.tracks, default=-1) + 1
            )
            self.next_number = max((c.number for c in catalogue.channels), default=-1) + 1
            self.holes = missing_channels(catalogue.tracks.values())
            end_s = end_of(found)
            epoch_ns = catalogue.head.epoch_ns if catalogue.head else None
            self.start_s = start_of(options.at, end_s, epoch_ns)
            self.members = self.match(catalogue.channels, inputs)
            needed = self.encoder.level(m.input for m in self.members).number
            if needed > catalogue.level.number:
                raise ParameterError(
                    "the file is of level 1, and these inputs need level 2 (more than 24 bits)"
                )
            self.ends = [ceil(self.start_s * m.input.rate) for m in self.members]
            self.written = dict(catalogue.metadata)
            if options.clock_maps:
                self.observed = catalogue.clocks
            notes = catalogue.metadata.get("notes", [])
            self.notes = [note for note in notes if isinstance(note, str)]
            if found.note and found.note not in self.notes:
                self.notes.append(found.note)
            self.notes.append(
                f"appended from {float(self.start_s):.9g} s on by hapfmt {__version__}"
            )
        except BaseException:
            found.__exit__(None, None, None)
            raise

    def closing(self, metadata: dict[str, Any]) -> dict[str, Any]:
        """Metadata at the end: what changed, and notes of what was lost."""
        progress = self.worker.progress
        own = metadata.get("notes", [])
        notes = [*self.notes, *(own if isinstance(own, list) else [])]
        members = self.worker.members
        dropped = [(members[p].input.label, n) for p, n in sorted(progress.dropped.items())]
        lost = [
            f"dropped: {count} samples of {label!r}, for which the encoder was too slow"
            for label, count in dropped[:NOTED]
        ]
        if len(dropped) > NOTED:
            more = sum(count for _, count in dropped[NOTED:])
            lost.append(f"dropped: {more} samples of {len(dropped) - NOTED} more channels")
        lost += self.worker.notes
        if self.notes or lost:
            metadata = {**metadata, "notes": [*notes, *lost]}
        return {k: v for k, v in metadata.items() if k not in self.written or self.written[k] != v}

    def number(self) -> int:
        """Of a new channel: one that a crash left without a channel, else the next."""
        if self.holes:
            return self.holes.pop(0)
        self.next_number += 1
        return self.next_number - 1

    def match(self, channels: Sequence[Any], inputs: Sequence[Input]) -> list[Member]:
        """Inputs and their channels in the file: those of the same label, rate and unit, each
        once; else new ones."""
        free = list(channels)
        members = []
        for given in inputs:
            same = (given.label, given.rate, given.unit)
            for ref in free:
                component = ref.track.components[ref.index]
                if same == (component.label, ref.track.rate, component.unit):
                    free.remove(ref)
                    members.append(Member(given, ref.number, is_new=False))
                    self.encoder.known(ref.number, last_track(ref))
                    break
            else:
                members.append(Member(given, self.number()))
        if self.next_number > LAST_TRACK_ID:
            raise ParameterError(f"a recording has at most {LAST_TRACK_ID} channels")
        return members


def last_track(ref: Any) -> Track:
    """The track that goes on with the channel."""
    track: Track = ref.parts[-1].track
    return track


def end_of(found: Appending) -> Fraction:
    """Seconds to the end of the last sample; events are no samples."""
    tracks = found.catalogue.tracks
    ends = ((tracks[id_], tick) for id_, tick in found.ends().items())
    samples = (tick / track.rate for track, tick in ends if track.kind != "events")
    return max(samples, default=Fraction(0))


def start_of(at: Any, end_s: Fraction, epoch_ns: int | None) -> Fraction:
    """Seconds where an appended part begins."""
    if at is None:
        return end_s
    if at == "now":
        if epoch_ns is None:
            raise ParameterError("the file has no epoch, so the time now has no place in it")
        start_s = Fraction(time.time_ns() - epoch_ns, 10**9)
    else:
        start_s = exact(at)
    if start_s < end_s:
        raise ParameterError(
            f"the recording ends at {float(end_s):.9g} s: nothing is appended at "
            f"{float(start_s):.9g} s"
        )
    return start_s


__all__ = ["Options", "Start"]
