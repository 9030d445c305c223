"""The thread of a recorder, and its queue.

The caller puts samples into the queue, in order and within a bound of bytes. The thread takes them
through clusters and encoder into the file.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Generic, TypeVar

from ..encoder.live import Block, Input, LiveEncoder, Plan, plan_input
from ..encoder.plan import Range, too_wide
from ..errors import ParameterError
from ..format.cluster import Packet
from ..format.track import Track
from .clusters import Clusters, Layers, Observed, SamplePiece, SampleRows
from .file import RecordingOutput
from .filewriter import FileWriter

Queued = TypeVar("Queued")

OVERHEAD = 256
"""Bytes that an item takes besides its samples: two objects of Python and their places."""


class SampleQueue(Generic[Queued]):
    """Items with their sizes. What the taker holds counts until it takes the next.

    The taker is woken when asked, or when half of the room is used: samples that complete nothing
    can wait.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self.size = 0
        self.blocked_s = 0.0
        self.error: BaseException | None = None
        self.items: deque[tuple[Queued, int]] = deque()
        self.put_count = self.done_count = 0
        self.held: int | None = None
        self.woken = False
        self.condition = threading.Condition()

    def put(self, item: Queued, size: int = 0, *, wake: bool = False, wait: bool = True) -> bool:
        """Whether there was room; ``wait`` for it. An item alone always has room.

        Raises what the taker failed with.
        """
        size += OVERHEAD
        with self.condition:
            if not self.has_room(size):
                self.wake()
                if not wait:
                    return False
                began = time.monotonic()
                try:
                    self.condition.wait_for(lambda: self.has_room(size))
                finally:
                    self.blocked_s += time.monotonic() - began
            self.refuse()
            self.items.append((item, size))
            self.put_count += 1
            self.size += size
            if wake or 2 * self.size > self.limit:
                self.wake()
        return True

    def has_room(self, size: int) -> bool:
        return self.error is not None or not self.size or self.size + size <= self.limit

    def refuse(self) -> None:
        if self.error is not None:
            raise self.error

    def wake(self) -> None:
        if not self.woken:
            self.woken = True
            self.condition.notify_all()

    def join(self) -> None:
        """Wait until all that was put so far is done; raises what the taker failed with."""
        with self.condition:
            count = self.put_count
            self.wake()
            self.condition.wait_for(lambda: self.error or self.done_count >= count)
            self.refuse()

    def take(self, timeout: float) -> Queued | None:
        """The next item; None where nothing came in ``timeout`` seconds. The one before is done."""
        with self.condition:
            if self.held is not None:
                self.size -= self.held
                self.done_count += 1
                self.held = None
                self.condition.notify_all()
            self.woken = self.woken and bool(self.items)
            if not self.woken:
                self.condition.wait_for(lambda: self.woken, timeout)
            if not self.items:
                return None
            self.woken = True
            item, self.held = self.items.popleft()
            return item

    def fail(self, error: BaseException) -> None:
        """Raise this from every later put and join; samples still in the queue are given up."""
        with self.condition:
            self.error = error
            self.items.clear()
            self.size = 0
            self.held = None
            self.condition.notify_all()


POLL_S = 0.25
"""Longest time in the queue for samples that complete no cluster."""

Task = Callable[[], None]
Item = SampleRows | Task


@dataclass(frozen=True)
class FileChannel:
    """An input and its channel number in the file; ``is_new``: the file holds no track of it
    yet."""

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
        queue: SampleQueue[Item],
        output: RecordingOutput,
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
        self.members: list[FileChannel] = []
        self.first_tracks: dict[int, int] = {}
        """By channel number."""
        self.enter(self.writer.tracks.values())
        self.progress = Progress()
        self.finished = False
        self.written_at = time.monotonic()
        self.notes: list[str] = []
        """What people should know at the end."""
        self.ranges: dict[int, tuple[Plan, Range]] = {}
        """By channel number: those whose largest error the caller gave, and their ranges so far."""
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
        if isinstance(item, SampleRows):
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

    def add(self, members: Sequence[FileChannel], starts: Sequence[int]) -> None:
        """Inputs that samples may come for, from these ticks on."""
        settings = self.encoder.settings
        for member, start in zip(members, starts, strict=True):
            self.clusters.add(len(self.members), member.input.rate, start)
            self.members.append(member)
            plan = plan_input(member.input, settings)
            if plan.promise.floor is settings.max_error and not settings.allows_any_error:
                self.ranges[member.number] = (plan, Range())
        # What does not depend on samples is described at once: the file is whole from then on.
        self.describe(self.encoder.begin({m.number: m.input for m in members if m.is_new}))

    def write(self, clusters: Iterable[list[SamplePiece]]) -> None:
        for pieces in clusters:
            blocks = [self.members[p.channel].block(p.start, p.values) for p in pieces]
            tracks, packets = self.encoder.encode(blocks)
            for block in blocks if self.ranges else ():
                if block.channel in self.ranges:
                    self.ranges[block.channel][1].add(block.values)
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
        self.notes = self.encoder.notes() + self.observed.write_maps(self.writer)
        metadata = closing()
        if metadata:
            self.writer.metadata(metadata)
        self.output.close()
        self.progress.flushed_s = float(self.writer.stop)
        self.finished = True

    def wide_errors(self) -> Iterator[str]:
        """Yield a sentence for each channel that its largest error flattened."""
        settings = self.encoder.settings
        for plan, seen in self.ranges.values():
            step = float(abs(plan.calibration.step)) if plan.channel.calibration else None
            extent = seen.extent * (step if plan.input.takes_counts and step else 1)
            error = settings.max_error.absolute(extent, step, plan.input.unit) or 0.0
            if text := too_wide(settings, extent, error, plan.input.label, plan.input.unit):
                yield (
                    f"{text}, as is known now: next time give a smaller max_error, "
                    "or force_error=True"
                )

    def describe_silent(self) -> None:
        """Channels that nothing came for have a number all the same (TRK-010)."""
        known = self.first_tracks
        silent = {m.number: m.input for m in self.members if m.number not in known}
        self.describe(self.encoder.silent(silent))

    def give_up(self) -> None:
        """After an error: the data in the file stays, and the file is closed if possible."""
        try:
            if self.writer.failed is None:
                self.describe_silent()
        except Exception:
            pass
        self.output.give_up(close=self.writer.failed is None)
