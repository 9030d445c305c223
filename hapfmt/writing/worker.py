"""The thread of a recorder: samples off the queue, through clusters and encoder, into the file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from ..format.cluster import Packet
from .filewriter import FileWriter
from ..format.track import Track
from ..encoder.live import Block, LiveEncoder
from ..errors import ParameterError
from .clusters import Clusters, Piece, Rows
from .extras import Layers
from ..encoder.inputs import Input
from .observed import Observed
from .output import Output
from .queue import Queue

POLL_S = 0.25
"""Samples that complete nothing wait in the queue for so long at most."""

Task = Callable[[], None]
Item = Rows | Task


@dataclass(frozen=True)
class Member:
    """An input and its channel number in the file; ``is_new``: no track of it stands there yet."""

    input: Input
    number: int
    is_new: bool = True

    def block(self, start: int, values: Any) -> Block:
        return Block(self.number, self.input, start, values)


@dataclass
class Progress:
    """What the thread has done so far; others only read it."""

    written: int = 0
    cluster_count: int = 0
    flushed_s: float = 0.0
    busy_s: float = 0.0
    dropped: dict[int, int] = field(default_factory=dict)
    """By input; the only part that the caller's side writes."""


class Worker:
    """Owns the file from its first byte to its last."""

    def __init__(
        self,
        queue: Queue[Item],
        output: Output,
        encoder: LiveEncoder,
        clusters: Clusters,
        layers: Layers,
        observed: Observed,
        *,
        hold_s: float | None,
    ) -> None:
        self.queue, self.output, self.encoder = queue, output, encoder
        self.clusters, self.layers, self.observed = clusters, layers, observed
        self.hold_s = hold_s
        self.members: list[Member] = []
        self.first_tracks: dict[int, int] = {}
        """By channel number."""
        self.enter(self.writer.tracks.values())
        self.progress = Progress()
        self.finished = False
        self.written_at = time.monotonic()
        self.notes: list[str] = []
        """Of what the end could not do."""
        self.error: BaseException | None = None
        self.thread = threading.Thread(target=self.run, name="hapfmt recorder", daemon=True)

    @property
    def writer(self) -> FileWriter:
        return self.output.writer

    def run(self) -> None:
        began = time.thread_time()
        poll_s = POLL_S if self.hold_s is None else min(POLL_S, self.hold_s / 2)
        try:
            while not self.finished:
                item = self.queue.take(poll_s)
                self.handle(item)
                # The next one may be long in coming.
                del item
                self.progress.busy_s = time.thread_time() - began
            self.queue.fail(ParameterError("the recording was closed"))
        except BaseException as error:
            self.error = error
            self.give_up()
            self.queue.fail(error)

    def handle(self, item: Item | None) -> None:
        if isinstance(item, Rows):
            if self.clusters.take(item, time.monotonic()):
                self.write(self.clusters.complete())
            if self.clusters.size > self.queue.limit:
                self.write(self.clusters.rest())
        elif item is not None:
            item()
        if self.hold_s is None:
            return
        since = self.clusters.oldest
        if since is None and (self.layers.waiting or self.observed.waiting):
            since = self.written_at
        if since is not None and time.monotonic() - since > self.hold_s:
            self.write_rest()
            self.written_at = time.monotonic()

    def check(self, given: Input) -> None:
        """Whether the file can hold an input that comes late; in any thread."""
        if self.encoder.level([given]).number > self.writer.level.number:
            raise ParameterError(
                f"{given.label!r} needs level 2 (more than 24 bits), and the file is of level 1"
            )

    def add(self, members: Sequence[Member], starts: Sequence[int]) -> None:
        """Inputs that samples may come for, from these ticks on."""
        for member, start in zip(members, starts, strict=True):
            self.clusters.add(len(self.members), member.input.rate, start)
            self.members.append(member)
        # What does not depend on samples is described at once: the file is whole from then on.
        self.describe(self.encoder.begin({m.number: m.input for m in members if m.is_new}))

    def write(self, clusters: Iterable[list[Piece]]) -> None:
        for pieces in clusters:
            blocks = [self.members[p.channel].block(p.start, p.values) for p in pieces]
            tracks, packets = self.encoder.encode(blocks)
            self.describe(tracks)
            self.writer.cluster([*packets, *self.events(self.clusters.done_s)])
            self.observed.write(self.writer, self.first_tracks)
            self.progress.written += sum(block.values.size for block in blocks)
            self.progress.cluster_count += 1
            self.written_at = time.monotonic()
            if self.output.settle():
                self.progress.flushed_s = float(self.writer.stop)

    def events(self, until: Fraction | None) -> list[Packet]:
        """Packets of the events before ``until`` seconds; None: of all."""
        tracks, packets = self.layers.take(until, self.encoder.next_track)
        self.encoder.next_track += len(tracks)
        self.describe(tracks)
        return packets

    def describe(self, tracks: Sequence[Track]) -> None:
        if tracks:
            self.writer.describe(tracks)
            self.enter(tracks)

    def enter(self, tracks: Iterable[Track]) -> None:
        for track in tracks:
            for number in track.channels:
                self.first_tracks.setdefault(number, track.id)

    def flush(self) -> None:
        """All that came so far, on the disk."""
        self.write_rest()
        self.output.sync()
        self.progress.flushed_s = float(self.writer.stop)

    def write_rest(self) -> None:
        self.write(self.clusters.rest())
        events = self.events(None)
        if events:
            self.writer.cluster(events)
        self.observed.write(self.writer, self.first_tracks)

    def finish(self, closing: Callable[[], dict[str, Any]]) -> None:
        """The end: ``closing`` gives the metadata that changed."""
        self.write_rest()
        self.describe_silent()
        self.observed.write(self.writer, self.first_tracks)
        maps, self.notes = self.observed.fitted(self.writer.tracks)
        for each in maps:
            self.writer.clock_map(each)
        metadata = closing()
        if metadata:
            self.writer.metadata(metadata)
        self.output.close()
        self.progress.flushed_s = float(self.writer.stop)
        self.finished = True

    def describe_silent(self) -> None:
        """Channels that nothing came for have a number all the same (TRK-010)."""
        known = self.first_tracks
        silent = {m.number: m.input for m in self.members if m.number not in known}
        self.describe(self.encoder.silent(silent))

    def give_up(self) -> None:
        """After an error: what stands in the file stays, closed where that can be."""
        try:
            if self.writer.failed is None:
                self.describe_silent()
        except Exception:
            pass
        self.output.give_up(close=self.writer.failed is None)
