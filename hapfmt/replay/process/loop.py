"""The loop that sends frames when they are due, its cleanup, and its report (SPEC 13, PLY-008).

Dry runs and recordings use a virtual clock, without processes or real time. They run as fast as
possible and give the same frames each time: no frame is late, and none is skipped.

The report has counts, lateness, the parts that were not played, and the outcome. Percentiles of the
lateness take a few kilobytes for any number of frames.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from math import ceil
from types import FrameType
from typing import Any, Literal, Protocol, cast, get_args

import numpy as np

from ...errors import DeviceError, DeviceGoneError, HapfmtError
from ..profile.model import Frame, FrameBlock, FrameSink, HidReport, Profile
from ..profile.packing import Packer
from ..schedule import Schedule
from .children import clock
from .pipes import (
    Inlet,
    Kind,
    Message,
    MessageError,
    Outlet,
    Sent,
    pack,
    pack_json,
    pack_log,
    parse_block,
)
from .watchdog import Guard

Outcome = Literal["clean", "late", "device-lost", "interrupted", "failed"]


@dataclass
class ReplayReport:
    """``late`` and ``call``: microseconds, p50, p99, p999 and max; None where no clock ran."""

    outcome: Outcome
    reason: str = ""
    """Why the end is not clean."""
    signal: int | None = None
    error_code: int = 1
    """Exit code of what made it fail."""
    sent: int = 0
    """Frames, without the neutral ones."""
    skipped: int = 0
    """Frames left out, since a later one was due."""
    clamped: int = 0
    slew_limited: int = 0
    under_runs: int = 0
    gap_samples: int = 0
    refused: int = 0
    """Samples that were not finite."""
    neutral: int = 0
    """Neutral frames that the device took at the end."""
    late: dict[str, float] | None = None
    """From the time a frame was due to the call that sends it."""
    call: dict[str, float] | None = None
    """How long the device took each."""
    realtime: dict[str, str] = field(default_factory=dict)
    kernels: dict[str, str] = field(default_factory=dict)
    """By actuator."""
    left_out: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    watchdog: str = "none"
    """One of ``stood by``, ``tripped: why``, ``ended: why``, ``none``."""
    said: list[str] = field(default_factory=list)
    """What the processes wrote to their standard error."""

    @property
    def exit_code(self) -> int:
        if self.outcome == "device-lost":
            return 6
        if self.outcome == "late":
            return 5
        if self.outcome == "interrupted" and self.signal is not None:
            return 128 + self.signal
        if self.outcome == "failed":
            return self.error_code
        return 3 if self.lost else 0

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "exit_code": self.exit_code}


OCTAVE = 64
"""Classes from 2^k to 2^(k+1) nanoseconds: a percentile is at most 1/64 too large, never too
small. Below 128 ns, and for the largest of all, it is exact."""
LIMIT = 2**63 - 1
CLASSES = 58 * OCTAVE
"""Classes of all times up to LIMIT, about 292 years."""


def class_of(time_ns: int) -> int:
    shift = max(0, time_ns.bit_length() - OCTAVE.bit_length())
    return shift * OCTAVE + (time_ns >> shift)


def largest_of(index: int) -> int:
    """The largest time of a class."""
    if index < 2 * OCTAVE:
        return index
    shift = index // OCTAVE - 1
    return ((index - shift * OCTAVE + 1) << shift) - 1


class Lateness:
    """Times in nanoseconds; one that is negative counts as 0, one above LIMIT as LIMIT."""

    def __init__(self) -> None:
        self._classes: dict[int, int] = {}
        self.count = 0
        self.max = 0

    def add(self, time_ns: int) -> None:
        time_ns = min(max(time_ns, 0), LIMIT)
        index = class_of(time_ns)
        self._classes[index] = self._classes.get(index, 0) + 1
        self.count += 1
        self.max = max(self.max, time_ns)

    def percentiles(self, per_mille: Iterable[int] = (500, 990, 999)) -> tuple[int, ...]:
        """For each share, the least time that this share of all times does not exceed; 0 if
        there are none."""
        found = []
        order = sorted(self._classes)
        for wanted in per_mille:
            rank = -(-self.count * wanted // 1000)
            value = 0
            for index in order:
                rank -= self._classes[index]
                if rank <= 0:
                    value = min(largest_of(index), self.max)
                    break
            found.append(value)
        return tuple(found)


LEAD_NS = 5_000_000
"""From the word to start to the first frame."""
SLEEP_NS = 10_000_000
"""At most, so that commands and heartbeats never wait longer."""
READY_NS = 150_000
"""Lead time: a frame is made this long before it is due; then the loop polls the clock. A sleep
ends about 50 us late, and the largest frame takes 40 us."""
HANDLE_NS = 300_000
"""Messages are handled while at least this time is left; otherwise one before each frame."""
SKIPPED = 1000
"""Largest number of skipped frames whose lateness is counted one by one, oldest first."""
STATUS_NS = 50_000_000
PLAYER_NS = 3_000_000_000
"""A player that is silent for this long is treated as dead."""
NEUTRAL_S = 0.02
"""From one neutral frame to the next, where the period is longer, or the device did not take it."""
TRYING_S = 0.5
"""For neutral frames that the device does not take, but could."""


class FrameLoop:
    def __init__(
        self,
        profile: Profile,
        gain: float | None,
        sink: FrameSink,
        source: Inlet,
        target: Outlet,
        asked: list[int],
        *,
        log: bool,
    ) -> None:
        self.profile, self.sink = profile, sink
        self.guard: Guard | None = None
        self.source, self.target, self.asked = source, target, asked
        self.schedule, self.packer = Schedule(profile, gain), Packer(profile)
        self.log: list[Sent] | None = [] if log else None
        self.period_ns = float(profile.timing.period) * 1e9
        self.latest_ns = min(self.period_ns, profile.timing.hold_s * 1e9)
        """A frame that is this late is not sent."""
        self.late, self.call = Lateness(), Lateness()
        self.start_ns: int | None = None
        self.heard_ns = self.status_ns = clock()
        self.begun = False
        """The player has said to start."""
        self.deaf = False
        """Further messages of the player are ignored."""
        self.generation = self.neutral = 0
        self.unsent = 0
        """The number of the first frame that was not sent yet."""
        self.gone = False
        """The device is; nothing more is written."""
        self.reason, self.error_code = "", 1
        self.signal: int | None = None

    def run(self) -> None:
        """Plays, then comes to rest. Errors are never raised: ``report`` holds them."""
        errors = 0
        while errors < 2 and not self.gone and self.schedule.state != "ended":
            try:
                if self.guard is not None and self.guard.left_alone(clock()):
                    self.stop("late", "the writer was stalled, and the watchdog may have tripped")
                    break
                if self.start_ns is None:
                    if self.schedule.outcome is not None:
                        break
                    self.wait(clock() + SLEEP_NS)
                    if self.begun:
                        self.start_ns = clock() + LEAD_NS
                else:
                    self.step(self.start_ns)
            except Exception as error:
                # The first leads to a ramp; if that fails too, to neutral frames at once.
                errors += 1
                self.fail(error)
        self.rest()

    def step(self, start_ns: int) -> None:
        """One frame, when it is due."""
        due_ns = self.schedule.next_ns
        self.wait(start_ns + due_ns - READY_NS)
        frame = self.schedule.frames_due(max(clock() - start_ns, due_ns))
        if frame is None:
            return
        taken = False
        try:
            if self.guard is not None:
                self.guard.listen(clock())
            late_ns = self.until(start_ns + frame.due_ns) - start_ns - frame.due_ns
            if late_ns >= self.latest_ns and self.schedule.outcome is None:
                # Held up since it was made: the one that is due now takes its place. But a frame
                # of a ramp to rest is sent, or a machine that is always too slow would never rest.
                return
            # Not before: its counters count what is sent.
            reports = self.packer.pack(frame)
            began = clock()
            if self.guard is not None and self.guard.left_alone(began):
                return
            self.sink.send(frame, reports)
            taken = True
        finally:
            if not taken:
                self.schedule.not_taken()
        self.call.add(clock() - began)
        self.count_late(began - start_ns, frame)
        if self.log is not None:
            self.log.append(Sent(frame, began - start_ns))

    def count_late(self, sent_ns: int, frame: Frame) -> None:
        """Frames that were skipped are as late as the one that came in their place."""
        left_out = range(self.unsent, frame.number)[:SKIPPED]
        for number in left_out:
            self.late.add(sent_ns - round(number * self.period_ns))
        self.late.add(sent_ns - frame.due_ns)
        self.unsent = frame.number + 1

    def wait(self, until_ns: int) -> None:
        """Sleeps, reads messages and sends heartbeats until ``until_ns``."""
        while True:
            now = clock()
            self.attend(now)
            while self.listen() and until_ns - clock() > HANDLE_NS:
                pass
            left = until_ns - clock()
            if left <= 0:
                return
            time.sleep(min(left, SLEEP_NS) / 1e9)

    @staticmethod
    def until(due_ns: int) -> int:
        """Polls the clock until ``due_ns``; returns the time."""
        while (now := clock()) < due_ns:
            pass
        return now

    def attend(self, now: int) -> None:
        """Serves the watchdog, signals, the player's silence, and status messages to the player."""
        guard = self.guard
        if guard is not None and guard.due(now) and not guard.left_alone(now):
            guard.beat(now)
            guard.listen(now)
            if guard.asked is not None:
                self.interrupted(guard.asked)
            if guard.ended and not guard.tripped:
                self.stop("failed", f"the watchdog {guard.state}")
        if self.asked:
            self.interrupted(self.asked.pop(0))
        if now - self.heard_ns > PLAYER_NS and not self.deaf:
            self.deaf = True
            self.stop("failed", "the player is silent")
        if now - self.status_ns >= STATUS_NS:
            self.status_ns = now
            self.tell()

    def listen(self) -> bool:
        """Handles a message of the player, if there is one."""
        if self.deaf:
            return False
        try:
            message = self.source.take()
            if message is not None:
                self.heard_ns = clock()
                self.handle(message)
                return True
        except MessageError:
            self.deaf = True
            raise
        if self.source.ended:
            self.deaf = True
            self.stop("failed", "the player has died")
        return False

    def handle(self, message: Message) -> None:
        match message.kind:
            case Kind.BLOCK:
                self.schedule.feed(parse_block(message.payload))
            case Kind.START:
                self.begun = True
            case Kind.STOP:
                self.signal = self.signal or message.fields().get("signal")
                outcome = message.field("outcome", str)
                if outcome not in get_args(Outcome):
                    raise MessageError(f"STOP: unknown outcome {outcome!r}")
                self.stop(cast(Outcome, outcome), message.field("reason", str))
            case Kind.PAUSE:
                self.schedule.pause()
            case Kind.RESUME:
                self.schedule.resume()
            case Kind.SEEK:
                self.generation = message.field("generation", int)
                self.schedule.seek(self.generation, message.field("first", int))
            case Kind.ALIVE:
                pass
            case other:
                raise MessageError(f"{other.name} is not a message of a player")

    def interrupted(self, number: int) -> None:
        self.signal = self.signal or number
        self.stop("interrupted", f"signal {number}")

    def stop(self, outcome: Outcome, reason: str) -> None:
        before = self.schedule.outcome
        self.schedule.stop(outcome)
        if self.schedule.outcome != before or not self.reason:
            self.reason = reason

    def fail(self, error: Exception) -> None:
        lost = isinstance(error, DeviceError)
        self.gone = self.gone or isinstance(error, DeviceGoneError)
        if isinstance(error, HapfmtError) and not lost:
            self.error_code = error.exit_code
        text = str(error) if isinstance(error, HapfmtError) else repr(error)
        self.stop("device-lost" if lost else "failed", text)

    def rest(self) -> None:
        """The last that the device gets: neutral frames, and its own words of leave."""
        failing_until = clock() + round(TRYING_S * 1e9)
        period_s = min(self.period_ns / 1e9, NEUTRAL_S)
        while not self.gone and self.neutral < self.profile.timing.neutral_count:
            if self.guard is not None and not self.guard.left_alone(clock()):
                self.guard.beat(clock())
            try:
                self.aside(self.packer.neutral())
                self.neutral += 1
                time.sleep(period_s)
            except Exception as error:
                self.fail(error)
                if self.gone or clock() > failing_until:
                    break
                time.sleep(NEUTRAL_S)
        if self.neutral and not self.gone and self.profile.exit:
            try:
                self.aside(self.profile.exit)
            except Exception as error:
                self.fail(error)

    def aside(self, reports: tuple[HidReport, ...]) -> None:
        """Reports that are no frame of the schedule."""
        at_ns = 0 if self.start_ns is None else clock() - self.start_ns
        self.sink.send(Frame(-1, at_ns, ()), reports)

    def tell(self) -> None:
        """The player: how far it is, and which frames were sent."""
        self.tell_log()
        self.target.send(pack_json(Kind.STATUS, **self.status()))
        if self.target.broken and not self.deaf:
            self.deaf = True
            self.stop("failed", "the player does not listen")

    def tell_log(self) -> None:
        if self.log:
            self.target.send(pack(Kind.SENT, pack_log(self.log)))
            self.log.clear()

    def status(self) -> dict[str, Any]:
        return {
            "state": self.schedule.state,
            "played": self.schedule.played,
            "generation": self.generation,
            "max_late_us": self.late.max / 1000,
            **vars(self.schedule.counts),
        }

    def report(self) -> dict[str, Any]:
        outcome = self.schedule.outcome or "clean"
        return {
            "outcome": outcome,
            "reason": "" if outcome == "clean" else self.reason,
            "error_code": self.error_code,
            "signal": self.signal,
            "neutral": self.neutral,
            "late": microseconds(self.late),
            "call": microseconds(self.call),
            **vars(self.schedule.counts),
        }


def microseconds(times: Lateness) -> dict[str, float] | None:
    if not times.count:
        return None
    p50, p99, p999 = times.percentiles((500, 990, 999))
    return {"p50": p50 / 1e3, "p99": p99 / 1e3, "p999": p999 / 1e3, "max": times.max / 1e3}


class FrameSource(Protocol):
    """A Renderer."""

    @property
    def kernels(self) -> dict[str, str]: ...

    @property
    def left_out(self) -> list[str]: ...

    @property
    def lost(self) -> list[str]: ...

    def blocks(self) -> Iterator[FrameBlock]: ...


class Signals:
    """SIGINT, SIGTERM and SIGHUP ask for the end; a second one is a KeyboardInterrupt."""

    def __init__(self) -> None:
        self.asked: int | None = None
        self.before: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            with suppress(ValueError, AttributeError):  # not in the main thread; not on Windows
                number = getattr(signal, name)
                self.before[number] = signal.signal(number, self.ask)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)

    def ask(self, number: int, _frame: FrameType | None) -> None:
        if self.asked is not None:
            raise KeyboardInterrupt
        self.asked = number


class Rehearsal:
    """One schedule, its blocks, and the sinks that get its frames."""

    def __init__(
        self,
        blocks: Iterator[FrameBlock],
        profile: Profile,
        sinks: Sequence[FrameSink],
        gain: float | None,
    ) -> None:
        self.schedule = Schedule(profile, gain)
        self.packer = Packer(profile)
        self.blocks, self.profile, self.sinks = blocks, profile, list(sinks)
        """One that failed is given nothing more."""
        self.error: BaseException | None = None
        """Error of a block: the samples before it are played, then the ramp to rest."""
        self.neutral = 0

    def feed(self) -> None:
        """As far as the next frame needs."""
        try:
            while self.schedule.needs_blocks and self.schedule.state == "playing":
                self.schedule.feed(next(self.blocks, None) or self.nothing())
        except (Exception, KeyboardInterrupt) as error:
            self.error = error
            self.schedule.stop("failed")

    def nothing(self) -> FrameBlock:
        shape = (0, len(self.profile.actuators))
        return FrameBlock(self.schedule.played, np.zeros(shape), np.zeros(shape, bool), last=True)

    def run(self, signals: Signals) -> None:
        try:
            self.report(self.profile.init, 0)
            while self.schedule.state != "ended":
                if signals.asked is not None:
                    self.schedule.stop("interrupted")
                self.feed()
                frame = self.schedule.frames_due(self.schedule.next_ns)
                assert frame is not None
                self.send(frame, self.packer.pack(frame))
        except BaseException:
            with suppress(Exception):  # the first error is the one to tell
                self.rest()
            raise
        self.rest()

    def rest(self) -> None:
        start_ns, period_ns = self.schedule.next_ns, self.profile.timing.period * 10**9
        for _ in range(self.profile.timing.neutral_count):
            self.report(self.packer.neutral(), start_ns + ceil(self.neutral * period_ns))
            self.neutral += 1
        self.report(self.profile.exit, start_ns + ceil(self.neutral * period_ns))

    def report(self, reports: tuple[HidReport, ...], due_ns: int) -> None:
        """Reports that are no samples."""
        if reports:
            self.send(Frame(-1, due_ns, ()), reports)

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None:
        for sink in self.sinks[:]:
            try:
                sink.send(frame, reports)
            except BaseException:
                self.sinks.remove(sink)
                raise


def rehearse(
    renderer: FrameSource,
    profile: Profile,
    sinks: Sequence[FrameSink],
    *,
    gain: float | None = None,
) -> ReplayReport:
    """Play to sinks that need no real time; they are closed in any case.

    An error of the file ends it by a ramp to rest, and the report names it; an error of a sink is
    raised.
    """
    rehearsal = Rehearsal(renderer.blocks(), profile, sinks, gain)
    opened: list[FrameSink] = []
    try:
        for sink in sinks:
            sink.open()
            opened.append(sink)
        with Signals() as signals:
            rehearsal.run(signals)
    finally:
        for sink in opened:
            sink.close()
    error = rehearsal.error
    if error is not None and not isinstance(error, (HapfmtError, OSError)):
        raise error
    counts, outcome = rehearsal.schedule.counts, rehearsal.schedule.outcome
    return ReplayReport(
        outcome=outcome or "clean",
        reason=str(error or ""),
        signal=signals.asked if outcome == "interrupted" else None,
        error_code=getattr(error, "exit_code", 1),
        sent=counts.sent,
        clamped=counts.clamped,
        slew_limited=counts.slew_limited,
        gap_samples=counts.gap_samples,
        refused=counts.refused,
        neutral=rehearsal.neutral,
        kernels=dict(renderer.kernels),
        left_out=list(renderer.left_out),
        lost=list(renderer.lost),
    )
