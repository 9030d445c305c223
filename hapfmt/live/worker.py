"""The thread of a recorder: samples off the queue, through clusters and encoder, into the file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from ..container.filewriter import FileWriter
from ..encoder.live import Block, LiveEncoder
from ..errors import ParameterError
from .clusters import Clusters, Piece, Rows
from .extras import Extras
from .inputs import Input
from .output import Output
from .queue import Queue

POLL_S = 0.25
"""Samples that complete nothing wait in the queue for so long at most."""

Task = Callable[[], None]
Item = Rows | Task


@dataclass
class Member:
    """An input and its place in the file: its channel number."""

    input: Input
    number: int


@dataclass
class Progress:
    """What the thread has done so far; others only read it."""

    missing: int = 0
    written: int = 0
    cluster_count: int = 0
    flushed_s: float = 0.0
    busy_s: float = 0.0
    pending_size: int = 0
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
        extras: Extras,
        *,
        fsync_s: float | None,
        hold_s: float | None,
    ) -> None:
        self.queue, self.output, self.encoder = queue, output, encoder
        self.clusters, self.extras = clusters, extras
        self.fsync_s, self.hold_s = fsync_s, hold_s
        self.synced_at = time.monotonic()
        self.members: list[Member] = []
        self.tracks: dict[int, int] = {}
        """Of channel numbers, the first track."""
        self.progress = Progress()
        self.finished = False
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
        except BaseException as error:
            self.queue.fail(error)
            self.output.give_up(error)
        else:
            self.queue.fail(ParameterError("the recording was closed"))

    def handle(self, item: Item | None) -> None:
        if isinstance(item, Rows):
            if self.clusters.take(item):
                self.write(self.clusters.complete())
            if self.clusters.size > self.queue.limit:
                self.write(self.clusters.rest())
        elif item is not None:
            item()
        oldest = self.clusters.oldest
        if self.hold_s is not None and oldest is not None:
            if time.monotonic() - oldest > self.hold_s:
                self.write(self.clusters.rest())
        self.progress.pending_size = self.clusters.size

    def add(self, member: Member, start: int) -> None:
        """An input that samples may come for, from tick ``start`` on."""
        self.clusters.add(len(self.members), member.input.rate, start)
        self.members.append(member)

    def write(self, clusters: Iterable[list[Piece]]) -> None:
        for pieces in clusters:
            blocks = []
            for piece in pieces:
                member = self.members[piece.channel]
                blocks.append(Block(member.number, member.input, piece.start, piece.values))
            tracks, packets = self.encoder.encode(blocks)
            self.describe(tracks)
            self.writer.cluster(packets)
            self.progress.written += sum(block.values.size for block in blocks)
            self.progress.cluster_count += 1
            self.write_extras(Fraction(self.clusters.done) * self.clusters.cluster)
            if self.fsync_s is not None and time.monotonic() - self.synced_at >= self.fsync_s:
                self.sync()

    def describe(self, tracks: list[Any]) -> None:
        self.writer.describe(tracks)
        for track in tracks:
            for number in track.channels:
                self.tracks.setdefault(number, track.id)

    def write_extras(self, until: Fraction | None) -> None:
        self.encoder.next_track = self.extras.write(
            self.writer, self.tracks, until, self.encoder.next_track
        )

    def sync(self) -> None:
        self.output.sync()
        self.synced_at = time.monotonic()
        self.progress.flushed_s = float(self.writer.stop)

    def flush(self) -> None:
        """All that came so far, on the disk."""
        self.write(self.clusters.rest())
        self.write_extras(None)
        self.sync()

    def finish(self, closing: Callable[[], dict[str, Any]]) -> None:
        """The end: ``closing`` gives the metadata that changed."""
        self.write(self.clusters.rest())
        self.describe(self.encoder.empty([(m.number, m.input) for m in self.members]))
        self.write_extras(None)
        metadata = closing()
        if metadata:
            self.writer.metadata(metadata)
        self.output.close()
        self.progress.flushed_s = float(self.writer.stop)
        self.finished = True
