"""Samples as they arrive -> a file that grows (SPEC clause 13)."""

from __future__ import annotations

import os
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from math import ceil
from types import TracebackType
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import LimitError, ParameterError
from ..limits import TICK_LIMIT
from ..numbers import exact
from .clusters import Grid, Rows
from .inputs import Input
from .queue import Queue
from .samples import named, owned
from .start import Plan, begin
from .status import Status
from .worker import Item, Worker

Seconds = Fraction | float | str
OnFull = Literal["block", "drop", "raise"]
QUEUE_SIZE = 64 << 20
"""Bytes: 4.5 minutes of 30 channels of doubles at 1 kHz."""


@dataclass
class Lane:
    """Channels whose samples come together."""

    channels: tuple[int, ...]
    index: NDArray[np.intp]
    inputs: list[Input]
    grid: Grid
    wake: int = 0
    """The first tick of the cluster after the one that the last sample was for."""


class Recorder:
    """Records channels into a file while their samples arrive.

        inputs = [Input("force", 1000, "N", calibration=Calibration(1, 0, 4000))]
        with Recorder("touch.hapf", inputs) as recorder:
            recorder.write("force", counts)

    ``file``: a path, or a binary stream that is written only. Samples are copied and coded in a
    thread of its own, cluster by cluster (``cluster`` seconds). What lies before the last
    ``flush``, and with ``fsync="cluster"`` all but the last cluster or two, survives a crash.

    ``fsync``: "cluster", "close", or a number of seconds: how often the disk is waited for.
    ``patience``: seconds that a cluster waits for channels behind the others; what they bring later
    is written in clusters of its own. ``hold``: seconds of wall clock that a sample waits at most
    for its cluster to be complete [cluster + 2 patience; none in canonical mode].
    ``queue_size``: bytes that wait for the encoder; ``on_full``: "block" until there is room,
    "drop" what comes (a gap, counted, told in a warning and in the file's notes), or "raise"
    LimitError. ``append``: go on with the file, where it ends, at ``at`` seconds, or for "now" by
    its epoch; inputs are its channels of the same label, rate and unit, others become new ones.
    ``epoch_ns``: UTC time of tick 0, "now", or None. ``clock_maps``: fit a map to the observations
    of each clock at the end. ``canonical``: file id; the same calls give the same bytes.

    What the thread fails with (a full disk) is raised by the next call and by close; the file is
    valid up to there. Methods may be called from several threads.
    """

    def __init__(
        self,
        file: str | os.PathLike[str] | BinaryIO,
        inputs: Iterable[Input],
        settings: Any = None,
        *,
        cluster: Seconds | None = None,
        patience: Seconds = 1,
        hold: Seconds | None = None,
        fsync: Literal["cluster", "close"] | float = "cluster",
        queue_size: int = QUEUE_SIZE,
        on_full: OnFull = "block",
        append: bool = False,
        at: Seconds | Literal["now"] | None = None,
        force: bool = False,
        metadata: Mapping[str, Any] | None = None,
        epoch_ns: int | Literal["now"] | None = "now",
        epoch_uncertainty_ns: int = 0,
        clock_maps: bool = False,
        canonical: int | None = None,
    ) -> None:
        if on_full not in ("block", "drop", "raise"):
            raise ParameterError("on_full is one of block, drop, raise")
        if queue_size < 1:
            raise ParameterError("a queue has room for a byte at least")
        plan = Plan.of(
            settings,
            cluster=cluster,
            patience=patience,
            hold=hold,
            fsync=fsync,
            append=append,
            at=at,
            force=force,
            metadata=dict(metadata or {}),
            epoch_ns=epoch_ns,
            epoch_uncertainty_ns=epoch_uncertainty_ns,
            clock_maps=clock_maps,
            canonical=canonical,
        )
        self.on_full = on_full
        self.cluster = plan.cluster
        self.inputs: list[Input] = []
        self.cursors: NDArray[np.int64] = np.empty(0, np.int64)
        self.by_label: dict[str, int] = {}
        self.lanes: dict[tuple[int, ...], Lane] = {}
        self.taken = 0
        self.warned = self.closed = False
        self.lock = threading.RLock()
        self.process = os.getpid()
        self.queue: Queue[Item] = Queue(queue_size)
        self.worker, members, self.start_s = begin(file, list(inputs), plan, self.queue)
        for member in members:
            self.enter(member.input, self.start_s)
        self.metadata: dict[str, Any] = plan.metadata
        """Members that change are written again at the end."""
        self.worker.thread.start()
        self.finalizer = weakref.finalize(self, shut, self.queue, self.worker, self.process)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except (Exception, KeyboardInterrupt) as second:
            if error is None:
                raise
            if second is not error:
                error.add_note(f"and the recording was not closed: {second}")

    def enter(self, given: Input, start_s: Fraction) -> int:
        """The place of an input that is new."""
        place = len(self.inputs)
        self.inputs.append(given)
        self.by_label.setdefault(given.label, place)
        self.cursors = np.append(self.cursors, ceil(start_s * given.rate))
        return place

    @property
    def seconds(self) -> Fraction:
        """The end of the latest sample so far, and where a channel begins that is added now."""
        ends = ((int(c), given.rate) for c, given in zip(self.cursors, self.inputs, strict=True))
        latest: dict[Fraction, int] = {}
        for tick, rate in ends:
            latest[rate] = max(latest.get(rate, 0), tick)
        return max((tick / rate for rate, tick in latest.items()), default=self.start_s)

    def add(self, given: Input) -> int:
        """A channel that comes late; its number among the inputs. It begins at the end of what is
        recorded so far, unless its first samples say another tick."""
        with self.lock:
            self.check_open()
            start_s = self.seconds
            member = self.worker.accept(given)
            start = ceil(start_s * given.rate)
            self.queue.put(partial(self.worker.add, [member], [start]))
            return self.enter(given, start_s)

    def place_of(self, channel: str | int) -> int:
        place = self.by_label.get(channel, -1) if isinstance(channel, str) else channel
        if 0 <= place < len(self.inputs):
            return place
        labels = ", ".join(repr(given.label) for given in self.inputs)
        raise ParameterError(f"no channel {channel!r}; there are: {labels}")

    def lane_of(self, channels: Sequence[str | int]) -> Lane:
        places = tuple(self.place_of(channel) for channel in channels)
        lane = self.lanes.get(places)
        if lane is None:
            inputs = [self.inputs[place] for place in places]
            if not inputs or len(set(places)) < len(places):
                raise ParameterError("rows have one channel or more, each once")
            if len({(given.rate, given.takes_counts) for given in inputs}) > 1:
                raise ParameterError(
                    f"{named(inputs)} have different rates, or counts beside floats: "
                    "write them apart"
                )
            grid = Grid.of(self.cluster, inputs[0].rate)
            lane = Lane(places, np.array(places, np.intp), inputs, grid)
            self.lanes[places] = lane
        return lane

    def write(self, channel: str | int, values: ArrayLike, tick: int | None = None) -> None:
        """Samples of one channel, [ticks]: counts where its input has a calibration, else floats,
        of which NaN is a missing one. They go on where the last ended, or at ``tick``: what lies
        between is a gap."""
        with self.lock:
            self.put(self.lane_of((channel,)), values, tick)

    def write_rows(
        self,
        values: ArrayLike,
        tick: int | None = None,
        channels: Sequence[str | int] | None = None,
    ) -> None:
        """Samples of channels of one rate and kind, [ticks, channels]; None: of all channels. The
        fast way for many channels."""
        with self.lock:
            chosen = range(len(self.inputs)) if channels is None else channels
            self.put(self.lane_of(tuple(chosen)), values, tick)

    def write_all(self, values: Mapping[str | int, ArrayLike]) -> None:
        """Samples of several channels from where each of them ended. Long ones are taken in turns,
        so that channels of the same time share clusters."""
        with self.lock:
            arrays = [(self.lane_of((c,)), np.asarray(given)) for c, given in values.items()]
            places = [0] * len(arrays)
            until = Fraction(0)
            while any(at < len(array) for at, (_, array) in zip(places, arrays, strict=True)):
                until += self.cluster
                for number, (lane, array) in enumerate(arrays):
                    at, stop = places[number], ceil(until * lane.inputs[0].rate)
                    if at < len(array):
                        self.put(lane, array[at:stop], None)
                    places[number] = max(stop, at)

    def skip(self, channel: str | int, ticks: int) -> None:
        """So many samples of a channel are missing: a gap."""
        with self.lock:
            lane = self.lane_of((channel,))
            start = self.start_of(lane, None) + ticks
            if ticks < 0 or start > TICK_LIMIT:
                raise ParameterError(f"a gap of {ticks} ticks in {named(lane.inputs)}")
            self.check_open()
            nothing = owned(np.empty(0, np.int32), lane.inputs)
            self.queue.put(Rows(lane.channels, start, nothing), wake=start >= lane.wake)
            self.cursors[lane.index] = start

    def start_of(self, lane: Lane, tick: int | None) -> int:
        """Where samples go; ticks never go back."""
        cursors = self.cursors[lane.index]
        ahead = int(cursors.max())
        if tick is None:
            if int(cursors.min()) != ahead:
                raise ParameterError(
                    f"{named(lane.inputs)} do not stand at one tick, but from {cursors.min()} "
                    f"to {ahead}: give the tick"
                )
            return ahead
        if tick < ahead:
            place = int(cursors.argmax())
            raise ParameterError(
                f"samples of {lane.inputs[place].label!r} for tick {tick} come after those up to "
                f"tick {ahead}: ticks never go back"
            )
        return tick

    def put(self, lane: Lane, values: ArrayLike, tick: int | None) -> None:
        self.check_open()
        rows = owned(values, lane.inputs)
        start = self.start_of(lane, tick)
        if start + len(rows) > TICK_LIMIT:
            raise ParameterError(f"ticks of {named(lane.inputs)} lie below 2^48, not at {start}")
        now = time.monotonic()
        step = max(len(rows), 1)
        if self.on_full == "block":
            step = max(self.queue.limit // 4 // max(rows[:1].nbytes, 1), 1)
        for at in range(0, len(rows), step):
            part = rows[at : at + step]
            stop = start + at + len(part)
            wake = stop >= lane.wake
            item = Rows(lane.channels, start + at, part, now)
            if self.queue.put(item, part.nbytes, wake=wake, wait=self.on_full == "block"):
                self.taken += part.size
            elif self.on_full == "drop":
                self.drop(lane, len(part))
            else:
                raise LimitError(
                    f"the encoder is {self.queue.size} bytes behind: {len(part)} samples of "
                    f"{named(lane.inputs)} at tick {start} were not taken"
                )
            self.cursors[lane.index] = stop
            if wake:
                lane.wake = lane.grid.start(lane.grid.number(stop) + 1)

    def drop(self, lane: Lane, ticks: int) -> None:
        dropped = self.worker.progress.dropped
        for place in lane.channels:
            dropped[place] = dropped.get(place, 0) + ticks
        if not self.warned:
            self.warned = True
            warnings.warn(
                f"the encoder is behind: samples of {named(lane.inputs)} were dropped, and are a "
                "gap; status() counts them",
                RuntimeWarning,
                stacklevel=4,
            )

    def mark(
        self,
        text: str,
        time: Seconds | None = None,
        duration: Seconds = 0,
        channel: str | int | None = None,
        *,
        layer: str = "",
    ) -> None:
        """An event at ``time`` seconds; None: at the end of what is recorded so far."""
        with self.lock:
            self.check_open()
            place = None if channel is None else self.place_of(channel)
            at = self.seconds if time is None else exact(time)
            event = self.worker.extras.event(text, at, exact(duration), layer)
            number = None if place is None else self.worker.members[place].number
            self.queue.put(partial(self.worker.extras.add_event, event, number), len(text))

    def clock(
        self,
        name: str,
        channel: str | int | None,
        tick: int,
        time_ns: int,
        uncertainty_ns: int = 0,
    ) -> None:
        """What another clock said at a tick of a channel; None: at a nanosecond of the recording.
        It is stored as it is."""
        with self.lock:
            self.check_open()
            place = None if channel is None else self.place_of(channel)
            number = None if place is None else self.worker.members[place].number
            extras = self.worker.extras
            observation = extras.observation(tick, time_ns, uncertainty_ns)
            self.queue.put(partial(extras.add_observation, name, number, observation), len(name))

    def fit_clocks(self) -> None:
        """Have maps of the clocks written at the end: see ``clock_maps``."""
        with self.lock:
            self.check_open()
            self.queue.put(self.worker.extras.ask_maps)

    def flush(self) -> None:
        """When this returns, all that was written so far is on the disk."""
        with self.lock:
            self.check_open()
            self.queue.put(self.worker.flush, wake=True)
        self.queue.join()

    def status(self) -> Status:
        progress, queue = self.worker.progress, self.queue
        recorded_s = float(self.worker.writer.stop - self.start_s)
        return Status(
            seconds=float(self.seconds),
            taken=self.taken,
            missing=progress.missing,
            written=progress.written,
            dropped={self.inputs[p].label: n for p, n in sorted(progress.dropped.items())},
            queued_size=queue.size + progress.pending_size,
            cluster_count=progress.cluster_count,
            file_size=self.worker.writer.offset,
            flushed_s=progress.flushed_s,
            blocked_s=queue.blocked_s,
            busy_s=progress.busy_s,
            factor=recorded_s / progress.busy_s if progress.busy_s else 0.0,
        )

    def check_open(self) -> None:
        if os.getpid() != self.process:
            raise ParameterError("this recording belongs to the process that began it")
        if self.closed:
            raise ParameterError("the recording was closed")
        self.queue.refuse()

    def close(self) -> None:
        """Write all that is here, and the index; once more does nothing."""
        if os.getpid() != self.process:
            return
        with self.lock:
            if self.closed:
                return
            self.closed = True
            self.finalizer.detach()
            try:
                self.queue.put(partial(self.worker.finish, dict(self.metadata)), wake=True)
            finally:
                self.worker.thread.join()
            if self.worker.error is not None:
                raise self.worker.error


def shut(queue: Queue[Item], worker: Worker, process: int) -> None:
    """Close the file of a recorder that nobody holds any more, or at the end of the program."""
    if os.getpid() == process and threading.current_thread() is not worker.thread:
        with suppress(Exception):
            queue.put(partial(worker.finish, {}), wake=True)
            worker.thread.join()


__all__ = ["Input", "Recorder", "Status"]
