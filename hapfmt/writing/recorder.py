"""Samples as they arrive -> a file that grows, and its status (SPEC clause 15).

The caller's samples become private arrays, checked against the channels of the recording.
"""

from __future__ import annotations

import os
import threading
import warnings
import weakref
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from functools import partial
from math import ceil
from types import TracebackType
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..clocks import ClockObservation
from ..encoder.live import Input
from ..encoder.settings import Settings
from ..errors import DataWarning, LimitError, ParameterError, unknown
from ..limits import TICK_LIMIT
from ..numbers import counted, exact
from ..recording import Event
from .clusters import ClusterGrid, SampleRows, code
from .start import Options, Start
from .worker import FileChannel, Item, SampleQueue, Worker


def owned(values: ArrayLike, inputs: Sequence[Input]) -> NDArray[Any]:
    """[ticks, channels] int32 counts or float64, a copy; [ticks] goes for one channel.

    Raises ParameterError for another shape or kind, and for counts beyond the bits of an input.
    """
    given = np.asarray(values)
    if given.ndim < 2 and len(inputs) == 1:
        given = given.reshape(-1, 1)
    if given.ndim != 2 or given.shape[1] != len(inputs):
        raise ParameterError(
            f"samples of {named(inputs)} are [ticks, {len(inputs)}], not {list(given.shape)}"
            if len(inputs) > 1
            else f"samples of {named(inputs)} are one-dimensional, not {list(given.shape)}"
        )
    if not inputs[0].takes_counts:
        if given.dtype.kind not in "fiub" or given.dtype.itemsize > 8:
            raise ParameterError(
                f"samples of {named(inputs)} are floats, not {given.dtype}: "
                "integer counts need an Input with a calibration"
            )
        values = np.array(given, np.float64, order="C")
        check_steps(values, inputs)
        return values
    if given.dtype.kind not in "iu" and given.size:
        raise ParameterError(
            f"samples of {named(inputs)} are integer counts, not {given.dtype}, "
            "as its calibration says"
        )
    check_range(given, inputs)
    return np.array(given, np.int32, order="C")


def check_range(counts: NDArray[Any], inputs: Sequence[Input]) -> None:
    bits = inputs[0].bits if len(inputs) == 1 else min(given.bits for given in inputs)
    if not counts.size or (counts.dtype.kind == "i" and 8 * counts.dtype.itemsize <= bits):
        return
    if counts.size == 1:
        low = high = int(counts.item())
    else:
        low, high = int(counts.min()), int(counts.max())
    if within(low, high, bits):
        return
    for place, given in enumerate(inputs):
        low, high = int(counts[:, place].min()), int(counts[:, place].max())
        if not within(low, high, given.bits):
            raise ParameterError(
                f"counts of {given.label!r} from {low} to {high} need more than its "
                f"{given.bits} bits"
            )


def check_steps(values: NDArray[np.float64], inputs: Sequence[Input]) -> None:
    """ParameterError for floats beyond the counts of an input with an lsb."""
    for place, given in enumerate(inputs):
        if given.lsb is not None:
            x, half = values[:, place], 1 << (given.bits - 1)
            beyond = (x < given.lsb * -half) | (x > given.lsb * (half - 1))
            if beyond.any():
                odd = float(x[beyond][0])
                raise ParameterError(
                    f"{odd!r} of {given.label!r} is outside the {given.bits} bits of steps of "
                    f"{given.lsb:g}: give a larger lsb"
                )


def within(low: int, high: int, bits: int) -> bool:
    return -(1 << (bits - 1)) <= low and high < 1 << (bits - 1)


def named(inputs: Sequence[Input]) -> str:
    if len(inputs) == 1:
        return repr(inputs[0].label)
    return f"the {len(inputs)} channels from {inputs[0].label!r} to {inputs[-1].label!r}"


@dataclass
class InputGroup:
    """Channels whose samples come together."""

    channels: tuple[int, ...]
    index: NDArray[np.intp]
    inputs: list[Input]
    grid: ClusterGrid
    wake: int = 0
    """The first tick of the cluster after the one that the last sample was for."""


class Lanes:
    """Channels by label or place, alone or together."""

    def __init__(self, cluster: Fraction, start_s: Fraction) -> None:
        self.cluster, self.start_s = cluster, start_s
        self.members: list[FileChannel] = []
        self.ticks: NDArray[np.int64] = np.empty(0, np.int64)
        """Where the next sample of each channel goes."""
        self.silent: set[int] = set()
        """Places that nothing came for yet: these may begin anywhere."""
        self.by_label: dict[str, int] = {}
        self.known: dict[tuple[int, ...], InputGroup] = {}
        self.single: dict[str | int, InputGroup] = {}

    def enter(self, member: FileChannel, start_s: Fraction) -> int:
        """The place of an input that is new."""
        place = len(self.members)
        self.members.append(member)
        if member.is_new:
            self.silent.add(place)
        self.by_label.setdefault(member.input.label, place)
        self.ticks = np.append(self.ticks, ceil(start_s * member.input.rate))
        return place

    @property
    def seconds(self) -> Fraction:
        """The end of the latest sample so far."""
        latest: dict[Fraction, int] = {}
        for tick, member in zip(self.ticks.tolist(), self.members, strict=True):
            rate = member.input.rate
            latest[rate] = max(latest.get(rate, 0), tick)
        return max((tick / rate for rate, tick in latest.items()), default=self.start_s)

    def place_of(self, channel: str | int) -> int:
        place = self.by_label.get(channel, -1) if isinstance(channel, str) else channel
        if isinstance(place, (int, np.integer)) and 0 <= place < len(self.members):
            return int(place)
        labels = [member.input.label for member in self.members]
        raise ParameterError(unknown("channel", channel, labels))

    def one(self, channel: str | int) -> InputGroup:
        """The lane of a single channel."""
        lane = self.single.get(channel)
        if lane is None:
            lane = self.single[channel] = self.of((channel,))
        return lane

    def of(self, channels: Sequence[str | int]) -> InputGroup:
        places = tuple(self.place_of(channel) for channel in channels)
        lane = self.known.get(places)
        if lane is None:
            inputs = [self.members[place].input for place in places]
            if not inputs or len(set(places)) < len(places):
                raise ParameterError("rows have one channel or more, each once")
            if len({(given.rate, given.takes_counts) for given in inputs}) > 1:
                raise ParameterError(
                    f"{named(inputs)} have different rates, or integers and floats: "
                    "write them separately"
                )
            grid = ClusterGrid.of(self.cluster, inputs[0].rate)
            lane = InputGroup(places, np.array(places, np.intp), inputs, grid)
            self.known[places] = lane
        return lane

    def start_of(self, lane: InputGroup, tick: int | None) -> int:
        """Where samples go; ticks never go back."""
        if len(lane.channels) == 1 and (tick is None or tick >= self.ticks.item(lane.channels[0])):
            return self.ticks.item(lane.channels[0]) if tick is None else tick
        ticks = self.ticks[lane.index]
        ahead = int(ticks.max())
        if tick is None:
            if int(ticks.min()) != ahead:
                raise ParameterError(
                    f"{named(lane.inputs)} are not at one tick, but from {ticks.min()} "
                    f"to {ahead}: give the tick"
                )
            return ahead
        if 0 <= tick < ahead and self.silent:
            behind = ticks > tick
            if self.silent.issuperset(lane.index[behind].tolist()):
                return tick
        if tick < ahead:
            place = int(ticks.argmax())
            raise ParameterError(
                f"samples of {lane.inputs[place].label!r} for tick {tick} come after those up to "
                f"tick {ahead}: ticks never go back"
            )
        return tick

    def move(self, lane: InputGroup, tick: int) -> None:
        """The next samples of a lane go to this tick."""
        if len(lane.channels) == 1:
            self.ticks[lane.channels[0]] = tick
        else:
            self.ticks[lane.index] = tick
        if self.silent:
            self.silent.difference_update(lane.channels)


@dataclass(frozen=True, repr=False)
class Status:
    """The state of a recording in progress.

    seconds
        its length so far.
    taken, missing, written
        samples that the recorder accepted, those of them that were NaN, and those in the file.
    dropped
        {label: samples} that were not accepted.
    queued_size
        bytes of samples in memory.
    cluster_count, file_size
        clusters and bytes in the file.
    flushed_s
        seconds that survive a crash.
    blocked_s
        seconds that the caller waited for room in the queue.
    busy_s
        CPU seconds of the encoding thread.
    factor
        seconds of the recording that the thread encodes in one CPU second; below 1 it is too slow.
    """

    seconds: float = 0.0
    taken: int = 0
    missing: int = 0
    written: int = 0
    dropped: dict[str, int] = field(default_factory=dict)
    queued_size: int = 0
    cluster_count: int = 0
    file_size: int = 0
    flushed_s: float = 0.0
    blocked_s: float = 0.0
    busy_s: float = 0.0
    factor: float = 0.0

    def __repr__(self) -> str:
        """One line, with units."""
        queued = f", {self.queued_size} bytes in the queue" if self.queued_size else ""
        speed = f", encoded {self.factor:.3g} times as fast as recorded" if self.factor else ""
        return (
            f"Status: {self.seconds:.6g} s, {counted(self.taken, 'sample')} taken, {self.missing} "
            f"missing, {self.dropped_count} dropped, {self.written} written{queued}; "
            f"{counted(self.cluster_count, 'cluster')}, {self.file_size} bytes in the file, "
            f"{self.flushed_s:.6g} s survive a crash{speed}"
        )

    @property
    def dropped_count(self) -> int:
        return sum(self.dropped.values())

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


Seconds = Fraction | float | str
OnFull = Literal["block", "drop", "raise"]
QUEUE_SIZE = 64 << 20
"""Bytes: 4.5 minutes of 30 channels of doubles at 1 kHz."""


class Turn:
    """One call at a time, of a recording that goes on."""

    def __init__(self, queue: SampleQueue[Item]) -> None:
        self.queue = queue
        self.lock = threading.RLock()
        self.process = os.getpid()
        self.closed = False

    def __enter__(self) -> None:
        if os.getpid() != self.process:
            # The thread, and the owner of the lock, are in the other process.
            raise ParameterError("the recording belongs to the process that began it")
        self.lock.acquire()
        if self.closed or self.queue.error is not None:
            self.lock.release()
            if self.closed:
                raise ParameterError("the recording was closed")
            self.queue.refuse()

    def __exit__(self, *_: object) -> None:
        self.lock.release()


class Recorder:
    """Records channels into a file while their samples arrive.

        inputs = [Input("force", 1000, "N", calibration=Calibration(1, 0, 4000))]
        with Recorder("touch.hapf", inputs) as recorder:
            recorder.write("force", counts)

    A thread encodes copies of the samples, cluster by cluster. Samples before the last ``flush``
    survive a crash. With ``fsync="cluster"`` so do all but the last cluster or two.

    file
        a path, or a binary stream that can be written.
    cluster
        length of a cluster in seconds.
    patience
        seconds that a cluster waits for channels that are late. Their samples then get clusters of
        their own.
    hold
        most seconds of wall clock that a sample waits for its cluster to be complete
        [cluster + 2 patience; no limit in canonical mode].
    fsync
        when to wait for the disk: "cluster", "close", "never", or a number of seconds.
    queue_size
        most bytes of samples that wait for the encoder.
    on_full
        if the queue is full: "block" waits, "raise" raises LimitError, and "drop" makes a gap. The
        file's notes and a warning count dropped samples.
    append
        continue an existing file. Inputs with the label, rate and unit of a channel continue it;
        others become new channels. A warning names the losses of a damaged end.
    at
        with ``append``: second of the first new sample; "now": by the epoch; None: the end.
    epoch_ns
        UTC time of tick 0 in nanoseconds since 1970-01-01, "now", or None.
    clock_maps
        fit a map to the observations of each clock at the end.
    canonical
        file id; the same calls then give the same bytes.

    Methods may be called in several threads. The next call, or close, raises an error of the
    encoding thread, such as a full disk. The file is valid up to that point.
    """

    def __init__(
        self,
        file: str | os.PathLike[str] | BinaryIO,
        inputs: Iterable[Input],
        settings: Settings | None = None,
        *,
        cluster: Seconds | None = None,
        patience: Seconds = 1,
        hold: Seconds | None = None,
        fsync: Literal["cluster", "close", "never"] | float = "cluster",
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
            raise ParameterError("the queue must hold at least 1 byte")
        options = Options(
            settings,
            cluster,
            patience,
            hold,
            fsync,
            append,
            at,
            force,
            dict(metadata or {}),
            epoch_ns,
            epoch_uncertainty_ns,
            clock_maps,
            canonical,
        )
        self.name = f" {os.fspath(file)!r}" if isinstance(file, (str, os.PathLike)) else ""
        self.on_full = on_full
        self.queue: SampleQueue[Item] = SampleQueue(queue_size)
        self.turn = Turn(self.queue)
        start = Start(file, list(inputs), options, self.queue)
        self.worker, self.closing = start.worker, start.closing
        self.lanes = Lanes(options.cluster, start.start_s)
        self.next_number = start.next_number
        for member in start.members:
            self.lanes.enter(member, start.start_s)
        self.metadata: dict[str, Any] = start.metadata
        """Members that change are written again at the end."""
        self.taken = 0
        self.warned = False
        self.worker.thread.start()
        self.finalizer = weakref.finalize(self, shut, self.queue, self.worker, os.getpid())
        if start.cut:
            warnings.warn(
                f"{start.cut}. If another copy of the file is whole, append to that one",
                DataWarning,
                stacklevel=2,
            )

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

    def __repr__(self) -> str:
        """One line: the file, the channels, and their state."""
        status = self.status()
        facts = [
            counted(len(self.inputs), "channel"),
            f"{status.seconds:.6g} s",
            f"{status.file_size} bytes",
            *([f"{counted(status.dropped_count, 'sample')} dropped"] if status.dropped else []),
            *(["closed"] if self.turn.closed else []),
        ]
        return f"Recorder{self.name}: {', '.join(facts)}"

    @property
    def inputs(self) -> list[Input]:
        return [member.input for member in self.lanes.members]

    def add(self, given: Input) -> int:
        """Add a channel to a recording in progress; returns its number among the inputs.

        It begins at the current end of the recording, unless its first samples have a tick.
        """
        with self.turn:
            start_s = self.lanes.seconds
            number = self.next_number
            self.worker.check(given)
            member = FileChannel(given, number)
            self.queue.put(partial(self.worker.add, [member], [ceil(start_s * given.rate)]))
            self.next_number += 1
            return self.lanes.enter(member, start_s)

    def write(
        self, channel: str | int, values: ArrayLike | None = None, tick: int | None = None
    ) -> None:
        """Record samples of one channel, [ticks]: counts with a calibration, else floats.

        NaN is a missing sample. The samples follow the previous ones, or begin at ``tick`` after
        a gap. Raises ParameterError, and LimitError with ``on_full="raise"``.
        """
        if values is None or not isinstance(channel, (str, int, np.integer)):
            raise ParameterError(
                "write takes a label and its samples, write('force', values); write_all takes "
                "{label: samples}, write_rows an array [ticks, channels]"
            )
        with self.turn:
            self._put(self.lanes.one(channel), values, tick)

    def write_rows(
        self,
        values: ArrayLike,
        tick: int | None = None,
        channels: Sequence[str | int] | None = None,
    ) -> None:
        """Record samples of channels of one rate and kind, [ticks, channels]; None: all channels.

        This is the fastest way to record many channels. Raises as :meth:`write` does.
        """
        with self.turn:
            chosen = range(len(self.lanes.members)) if channels is None else channels
            self._put(self.lanes.of(tuple(chosen)), values, tick)

    def write_all(self, values: Mapping[str | int, ArrayLike]) -> None:
        """Record samples of several channels, each after its previous ones.

        Long arrays are taken in turns, so that channels share clusters of the same time.
        """
        with self.turn:
            arrays = [(self.lanes.one(c), np.asarray(given)) for c, given in values.items()]
            places = [0] * len(arrays)
            until = Fraction(0)
            while any(at < len(array) for at, (_, array) in zip(places, arrays, strict=True)):
                until += self.lanes.cluster
                for number, (lane, array) in enumerate(arrays):
                    at, stop = places[number], ceil(until * lane.inputs[0].rate)
                    if at < len(array):
                        self._put(lane, array[at:stop], None)
                    places[number] = max(stop, at)

    def skip(self, channel: str | int, ticks: int) -> None:
        """Leave a gap of ``ticks`` samples in a channel."""
        with self.turn:
            lane = self.lanes.one(channel)
            start = self.lanes.start_of(lane, None) + ticks
            if ticks < 0 or start > TICK_LIMIT:
                raise ParameterError(f"a gap of {ticks} ticks in {named(lane.inputs)}")
            nothing = owned(np.empty(0, np.int32), lane.inputs)
            self.queue.put(SampleRows(lane.channels, start, nothing), wake=start >= lane.wake)
            self.lanes.move(lane, start)

    def _put(self, lane: InputGroup, values: ArrayLike, tick: int | None) -> None:
        rows = owned(values, lane.inputs)
        start = self.lanes.start_of(lane, tick)
        if start + len(rows) > TICK_LIMIT:
            raise ParameterError(f"ticks of {named(lane.inputs)} lie below 2^48, not at {start}")
        step = max(len(rows), 1)
        if self.on_full == "block":
            step = max(self.queue.limit // 4 // max(rows[:1].nbytes, 1), 1)
        for at in range(0, len(rows), step):
            part = rows[at : at + step]
            stop = start + at + len(part)
            wake = stop >= lane.wake
            item = SampleRows(lane.channels, start + at, part)
            if self.queue.put(item, part.nbytes, wake=wake, wait=self.on_full == "block"):
                self.taken += part.size
            elif self.on_full == "drop":
                self._drop(lane, len(part))
            else:
                raise LimitError(
                    f"the encoder is {self.queue.size} bytes behind: {len(part)} samples of "
                    f"{named(lane.inputs)} at tick {start} were not taken"
                )
            self.lanes.move(lane, stop)
            if wake:
                lane.wake = lane.grid.start(lane.grid.number(stop) + 1)

    def _drop(self, lane: InputGroup, ticks: int) -> None:
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
        """Store an event at ``time`` seconds; None: at the current end of the recording."""
        with self.turn:
            place = None if channel is None else self.lanes.place_of(channel)
            at = self.lanes.seconds if time is None else exact(time)
            event = Event(at, text, exact(duration), layer=layer)
            number = None if place is None else self.lanes.members[place].number
            code(event, number)
            self.queue.put(partial(self.worker.layers.add, event, number), len(text))

    def clock(
        self,
        name: str,
        channel: str | int | None,
        tick: int,
        time_ns: int,
        uncertainty_ns: int = 0,
    ) -> None:
        """Store a reading of another clock at a tick of a channel; channel None: at a nanosecond of
        the recording."""
        with self.turn:
            place = None if channel is None else self.lanes.place_of(channel)
            number = None if place is None else self.lanes.members[place].number
            seen = ClockObservation(name, number, tick, time_ns, uncertainty_ns)
            self.queue.put(partial(self.worker.observed.add, seen), len(name))

    def fit_clocks(self) -> None:
        """Write maps of the clocks at the end, as ``clock_maps`` does."""
        with self.turn:
            self.worker.observed.maps = True

    def flush(self) -> None:
        """Write all samples so far to the disk before returning."""
        with self.turn:
            self.queue.put(self.worker.flush, wake=True)
        self.queue.join()

    def status(self) -> Status:
        progress, queue, members = self.worker.progress, self.queue, self.lanes.members
        recorded_s = float(self.worker.writer.stop - self.lanes.start_s)
        return Status(
            seconds=float(self.lanes.seconds),
            taken=self.taken,
            missing=self.worker.clusters.missing,
            written=progress.written,
            dropped={members[p].input.label: n for p, n in sorted(progress.dropped.items())},
            queued_size=queue.size + self.worker.clusters.size,
            cluster_count=progress.cluster_count,
            file_size=self.worker.writer.offset,
            flushed_s=progress.flushed_s,
            blocked_s=queue.blocked_s,
            busy_s=progress.busy_s,
            factor=recorded_s / progress.busy_s if progress.busy_s else 0.0,
        )

    def close(self) -> None:
        """Write the remaining samples and the index. A second call does nothing."""
        if os.getpid() != self.turn.process:
            return
        with self.turn.lock:
            if self.turn.closed:
                return
            self.turn.closed = True
            self.finalizer.detach()
            end = partial(self.worker.finish, partial(self.closing, dict(self.metadata)))
            with suppress(Exception):
                # What the thread failed with is raised below.
                self.queue.put(end, wake=True)
            self.worker.thread.join()
        if self.worker.error is not None:
            raise self.worker.error
        for text in (*self.worker.notes, *self.worker.wide_errors()):
            warnings.warn(text, DataWarning, stacklevel=2)


def shut(queue: SampleQueue[Item], worker: Worker, process: int) -> None:
    """Close the file of a recorder without references, or at the end of the program."""
    if os.getpid() == process and threading.current_thread() is not worker.thread:
        with suppress(Exception):
            queue.put(partial(worker.finish, dict), wake=True)
        worker.thread.join()


__all__ = ["Input", "Recorder", "Status"]
