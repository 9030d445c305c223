"""Values -> the frame that is due (docs/spec/players.md). Pure: no clock, no sleep, no device.

The caller supplies the time. Frame k is due ``ceil(k * period)`` nanoseconds after the start. While
the recording plays, each frame, sent or skipped, advances it by one frame. While it does not play,
its position does not change. So ``played``, the number of the next sample, counts no pause.

The values of one actuator are rectified, clamped, ramped, scaled and limited. The limiter is the
last step: it keeps counts within their limits and close to the previous count (PLY-002). It uses
integers only, so that no rounding, file value or earlier fault can bypass it.

Soft start and soft stop use a raised cosine whose phase moves by one per sample (PLY-003). A
falling envelope reaches rest before it rises again. So a short gap, a cancelled pause and a seek
all ramp as slowly as a long gap.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from fractions import Fraction
from math import ceil, cos, floor, inf, isfinite, pi
from typing import Literal, get_args

import numpy as np

from ..errors import ParameterError
from ..numbers import exact
from .profile.model import Actuator, CountLimits, Frame, FrameBlock, Profile

COUNT_LIMIT = 2**53
"""Whole numbers up to here are exact as float64."""


def count_limits(profile: Profile, actuator: Actuator) -> CountLimits:
    """The limits of an actuator, refused where they do not bound it or let it never move."""
    try:
        limits = profile.limits(actuator)
    except (ArithmeticError, ValueError):  # not finite, or a step of zero
        limits = CountLimits(1, 0, 0, 0)
    low, high, rest, change = limits
    if not (
        -COUNT_LIMIT <= low <= rest <= high <= COUNT_LIMIT
        and change >= 1
        and actuator.step > 0
        and isfinite(actuator.maximum - actuator.minimum)
        and actuator.minimum <= actuator.rest <= actuator.maximum
    ):
        raise ParameterError(
            f"actuator {actuator.name!r} of profile {profile.name!r} has no usable limits: it needs"
            " minimum <= rest <= maximum, and a slew of one step a sample or more",
            requirement="PLY-001",
        )
    return limits


class Limiter:
    """Counts of one actuator, from rest on."""

    __slots__ = ("_high", "_low", "change", "count", "limited")

    def __init__(self, limits: CountLimits) -> None:
        self._low, self._high, self.count, self.change = limits
        self.limited = 0

    def __call__(self, wanted: int) -> int:
        """The count sent for it. ``count`` is in range, so a step towards the range stays in it."""
        if wanted > self._high:
            wanted = self._high
        elif wanted < self._low:
            wanted = self._low
        change = wanted - self.count
        if change > self.change:
            wanted = self.count + self.change
            self.limited += 1
        elif change < -self.change:
            wanted = self.count - self.change
            self.limited += 1
        self.count = wanted
        return wanted


def ramp_samples(seconds: float, rate: Fraction) -> int:
    """Two at least: one value between rest and signal. 0.05 s are 50 ms, as the profile says, not
    what the float of it is."""
    return max(2, ceil(exact(seconds) * rate))


class Envelope:
    """Envelope of one actuator. ``phase``: 0 at rest, ``length`` at the full signal."""

    __slots__ = ("falling", "length", "phase", "top")

    def __init__(self, length: int) -> None:
        self.length = length
        self.phase = 0
        self.falling = False
        self.top = 1.0
        """Its shape where the fall began."""

    def shape(self) -> float:
        return (1 - cos(pi * self.phase / self.length)) / 2

    def rise(self) -> float:
        """What part of the signal this sample is."""
        if self.phase == self.length:
            return 1.0
        self.phase += 1
        return self.shape()

    def begin_fall(self) -> None:
        self.falling = True
        self.top = self.shape()

    def fall(self) -> float:
        """What is left in this sample of the value that the fall began with."""
        if self.phase:
            self.phase -= 1
        return self.shape() / self.top if self.top else 0.0


LaneState = tuple[int, int, int, bool, float]


class ActuatorPath:
    """Exactly one of ``play`` and ``fall`` is called for each sample that is sent."""

    __slots__ = (
        "_gain",
        "_heard",
        "_held",
        "_maximum",
        "_minimum",
        "_rectify",
        "_rest",
        "_silent",
        "_step",
        "clamped",
        "envelope",
        "gaps",
        "limiter",
        "refused",
        "rest",
    )

    def __init__(self, profile: Profile, actuator: Actuator, gain: float) -> None:
        limits = count_limits(profile, actuator)
        self.limiter = Limiter(limits)
        self.envelope = Envelope(ramp_samples(profile.timing.ramp_s, profile.timing.rate))
        self.rest = limits.rest
        self._rest, self._step, self._rectify = actuator.rest, actuator.step, actuator.rectify
        self._minimum, self._maximum = actuator.minimum, actuator.maximum
        self._gain = gain
        self._held = 0
        """Counts from rest where the fall began."""
        self._heard = False
        self._silent = 0
        self.clamped = self.refused = 0
        self.gaps = 0
        """Samples that were not known between such that were."""

    @property
    def at_rest(self) -> bool:
        return self.envelope.phase == 0 and self.limiter.count == self.rest

    @property
    def samples_to_rest(self) -> int:
        """Upper bound of the samples of a fall from here."""
        away = abs(self.limiter.count - self.rest)
        return self.envelope.phase - (-away // self.limiter.change)

    def play(self, value: float, known: bool) -> int:
        if not known:
            self._silent += 1
            return self.fall()
        if not isfinite(value):
            self.refused += 1
            return self.fall()
        envelope = self.envelope
        if envelope.falling:
            return self.fall()
        if envelope.phase == 0:
            self.gaps += self._silent if self._heard else 0
            self._heard = True
            self._silent = 0
        if self._rectify:
            value = abs(value)
        if value > self._maximum:
            value = self._maximum
            self.clamped += 1
        elif value < self._minimum:
            value = self._minimum
            self.clamped += 1
        wanted = self._rest + self._gain * envelope.rise() * (value - self._rest)
        return self.limiter(floor(wanted / self._step + 0.5))

    def fall(self) -> int:
        """One sample nearer to rest.

        The fall starts from the count last sent, not from the wanted one. If the slew limit held
        the actuator short of a large value, it reverses at once and never approaches that value.
        """
        envelope, limiter = self.envelope, self.limiter
        if not envelope.falling:
            if envelope.phase == 0:
                return limiter(self.rest)
            self.cut()
        count = limiter(self.rest + floor(self._held * envelope.fall() + 0.5))
        if envelope.phase == 0 and count == self.rest:
            envelope.falling = False
        return count

    def cut(self) -> None:
        """Start to fall at the next sample, all the way to rest."""
        envelope = self.envelope
        if envelope.phase and not envelope.falling:
            envelope.begin_fall()
            self._held = self.limiter.count - self.rest

    def state(self) -> LaneState:
        envelope = self.envelope
        return self.limiter.count, self._held, envelope.phase, envelope.falling, envelope.top

    def restore(self, state: LaneState) -> None:
        """Restores an earlier state, because the frame was not sent. Event counts are kept."""
        envelope = self.envelope
        self.limiter.count, self._held, envelope.phase, envelope.falling, envelope.top = state

    def forget(self) -> None:
        """The next sample comes from elsewhere in the recording, so no gap precedes it."""
        self._heard = False
        self._silent = 0


State = Literal["playing", "pausing", "paused", "stopping", "ended"]
Outcome = Literal["clean", "failed", "interrupted", "late", "device-lost"]
Row = tuple[list[float], list[bool]]
SEVERITY = get_args(Outcome)
"""With several reasons to stop, the last in this order is reported (docs/spec/players.md, exit
codes)."""


@dataclass
class Counts:
    sent: int = 0
    """Frames; those ``skipped`` were late."""
    skipped: int = 0
    clamped: int = 0
    """Samples of actuators that were outside the limits."""
    slew_limited: int = 0
    """Samples of actuators that the slew limit changed."""
    under_runs: int = 0
    """Times that blocks came too late."""
    under_run_samples: int = 0
    gap_samples: int = 0
    """Samples of actuators that were not known, between such that were."""
    refused: int = 0
    """Samples of actuators that were not finite."""


class Schedule:
    """What is sent to the actuators of ``profile``.

    ``gain`` of everything, above 0 and at most 1 [that of the profile]. The recording begins with
    the first block that comes, so the clock may run before.
    """

    def __init__(self, profile: Profile, gain: float | None = None) -> None:
        timing = profile.timing
        gain = profile.gain if gain is None else gain
        if not 0 < gain <= 1:
            raise ParameterError(f"the gain must be above 0 and at most 1, not {gain!r}")
        if not (
            timing.rate > 0
            and timing.frame_samples >= 1
            and 0 < timing.hold_s < inf
            and 0 <= timing.ramp_s < inf
        ):
            raise ParameterError(
                f"profile {profile.name!r} has no usable rate, frame, hold or ramp",
                requirement="PLY-001",
            )
        self.lanes = tuple(ActuatorPath(profile, actuator, gain) for actuator in profile.actuators)
        self._rest = tuple(lane.rest for lane in self.lanes)
        self._hole: Row = ([0.0] * len(self.lanes), [False] * len(self.lanes))
        """Between two blocks: not known, as if a block said so."""
        self._samples = timing.frame_samples
        self._period_ns, self._periods = (timing.period * 1_000_000_000).as_integer_ratio()
        """``_period_ns`` nanoseconds equal ``_periods`` periods."""
        self._hold_ns = round(timing.hold_s * 1e9)
        self._number = 0
        """Number of the next frame."""
        self._unsent = 0
        """Number of the first frame since which the device got none."""
        self._before: tuple[int, int, int, bool, list[LaneState]] | None = None
        """``_unsent`` and more before the last frame."""
        self._latest = 0
        """Latest time given by the caller."""
        self._shift = 0
        """Nanoseconds by which the clock jumped backwards."""
        self._goal: Literal["play", "pause", "stop"] = "play"
        self._settling = False
        """True: nothing plays until every actuator is at rest."""
        self._running = False
        """The frame before this was played, not a resting one or one of a ramp to rest."""
        self._ended = False
        self._counts = Counts()
        self.outcome: Outcome | None = None
        self._begin(0, 0)

    def _begin(self, generation: int, first: int) -> None:
        self._generation = generation
        self._blocks: deque[FrameBlock] = deque()
        self.played = first
        self._fed = first
        self._end: int | None = None
        self._waiting = True
        """For the first block."""
        self._starved = False
        for lane in self.lanes:
            lane.forget()

    @property
    def state(self) -> State:
        if self._ended:
            return "ended"
        if self._goal == "pause":
            return "paused" if self.at_rest else "pausing"
        return "stopping" if self._goal == "stop" else "playing"

    @property
    def at_rest(self) -> bool:
        return all(lane.at_rest for lane in self.lanes)

    @property
    def next_ns(self) -> int:
        """When the next frame is due."""
        return self._due_ns(self._number)

    @property
    def counts(self) -> Counts:
        return replace(
            self._counts,
            clamped=sum(lane.clamped for lane in self.lanes),
            slew_limited=sum(lane.limiter.limited for lane in self.lanes),
            gap_samples=sum(lane.gaps for lane in self.lanes),
            refused=sum(lane.refused for lane in self.lanes),
        )

    @property
    def frames_to_rest(self) -> int:
        """Upper bound of the frames of a ramp to rest from here, including the resting one."""
        samples = max((lane.samples_to_rest for lane in self.lanes), default=0)
        return -(-samples // self._samples) + 1

    @property
    def needs_blocks(self) -> bool:
        """True if samples of the next frame are still missing."""
        return self._end is None and self._fed < self.played + self._samples

    def feed(self, block: FrameBlock) -> None:
        """Appends the next block, which the caller must not change afterwards.

        Blocks of another generation than that of the last seek are dropped. Where blocks overlap,
        the first one counts.
        """
        shape = (len(block.values), len(self.lanes))
        if block.values.shape != shape or block.known.shape != shape:
            raise ParameterError(
                f"a block of shapes {block.values.shape} and {block.known.shape} where both must"
                f" be (samples, {len(self.lanes)})"
            )
        if block.generation != self._generation or self._end is not None or self._goal == "stop":
            return
        end = block.first + len(block.values)
        if end > self._fed and len(block.values):
            self._blocks.append(block)
            self._fed = end
            self._waiting = False
        if block.last:
            self._end = self._fed
            self._waiting = False

    def stop(self, outcome: Outcome = "interrupted") -> None:
        """Ramp to rest, then end; later requests have no effect."""
        if self._ended:
            return
        self._goal = "stop"
        self._settling = True
        if SEVERITY.index(outcome) >= SEVERITY.index(self.outcome or "clean"):
            self.outcome = outcome

    def not_taken(self) -> None:
        """The device did not get the last frame: all is as before it, and it is one of those that
        are skipped when another comes. It does not come again."""
        if self._before is None:
            return
        self._unsent, self._counts.skipped, self.played, self._running, states = self._before
        self._before = None
        self._counts.sent -= 1
        self._ended = False
        for lane, state in zip(self.lanes, states, strict=True):
            lane.restore(state)

    def pause(self) -> None:
        if self._goal == "play":
            self._goal = "pause"
            self._settling = True

    def resume(self) -> None:
        if self._goal == "pause":
            self._goal = "play"

    def seek(self, generation: int, first: int) -> None:
        """Ramp to rest, then continue at sample ``first`` when a block of ``generation`` is in."""
        if self._goal != "stop" and generation > self._generation:
            self._begin(generation, first)
            self._settling = True

    def frames_due(self, now_ns: int) -> Frame | None:
        """The frame that is due now, if any; those before it are skipped.

        A clock that jumps back further than the hold time is taken as broken: waiting for it would
        hold the force. The schedule then goes by the time that passes, and stops as late.
        """
        if self._ended:
            return None
        if self._number and now_ns + self._shift < self._latest - self._hold_ns:
            self._shift = self._latest - now_ns
            self.stop("late")
        now_ns += self._shift
        self._latest = max(self._latest, now_ns)
        due = now_ns * self._periods // self._period_ns
        if due < self._number:
            return None
        if now_ns - self._due_ns(self._unsent) - self._shift > self._hold_ns:
            self.stop("late")
        # Only now: a frame that was not taken goes back to where it began.
        while self._blocks and self._blocks[0].first + len(self._blocks[0].values) <= self.played:
            self._blocks.popleft()
        counts, skipped = self._counts, due - self._unsent
        states = [lane.state() for lane in self.lanes]
        self._before = self._unsent, counts.skipped, self.played, self._running, states
        counts.sent += 1
        counts.skipped += skipped
        frame = Frame(due, self._due_ns(due), self._samples_due(skipped))
        self._number = self._unsent = due + 1
        if self._goal == "stop" and self.at_rest:
            self._ended = all(row == self._rest for row in frame.counts)
        return frame

    def _due_ns(self, number: int) -> int:
        return -(-number * self._period_ns // self._periods) - self._shift

    def _samples_due(self, skipped: int) -> tuple[tuple[int, ...], ...]:
        if self._settling and self.at_rest:
            self._settling = False
        if self._goal == "play" and not self._settling and not self._waiting:
            if skipped and self._running:
                self._leap(skipped * self._samples)
            self._running = True
            if self._end is None or self.played < self._end:
                rows = self._rows()
                self.played += self._samples
                return tuple([self._play(row) for row in rows])
            self.stop("clean")
        self._running = False
        return tuple([tuple([x.fall() for x in self.lanes]) for _ in range(self._samples)])

    def _play(self, row: Row | None) -> tuple[int, ...]:
        if row is None:
            return tuple([lane.fall() for lane in self.lanes])
        given = zip(self.lanes, *row, strict=True)
        return tuple([lane.play(value, known) for lane, value, known in given])

    def _rows(self) -> list[Row | None]:
        """The rows from sample ``played`` on; None where there is no block."""
        rows: list[Row | None] = []
        at, stop = self.played, self.played + self._samples
        for first, values, known, *_ in self._blocks:
            if first > at:
                rows += [self._hole] * (min(first, stop) - at)
                at = min(first, stop)
            part = slice(at - first, max(stop - first, 0))
            found = list(zip(values[part].tolist(), known[part].tolist(), strict=True))
            rows += found
            at += len(found)
            if at == stop:
                self._starved = False
                return rows
        self._miss(stop - at)
        return rows + [None] * (stop - at)

    def _leap(self, samples: int) -> None:
        """Leave samples out. An actuator that is not known all the way comes to rest first: the
        two sides of a gap are never joined. (At most the samples of the hold time.)"""
        at, stop = self.played, self.played + samples
        known = np.ones(len(self.lanes), bool)
        for first, values, given, *_ in self._blocks:
            if not at < stop or first > at:
                break
            part = slice(at - first, stop - first)
            known &= (given[part] & np.isfinite(values[part])).all(axis=0)
            at = max(at, min(stop, first + len(values)))
        for lane, still in zip(self.lanes, known.tolist(), strict=True):
            if at < stop or not still:
                lane.cut()
        self.played = stop

    def _miss(self, samples: int) -> None:
        """No block arrived in time; after the last block this is normal."""
        if self._end is None:
            self._counts.under_run_samples += samples
            self._counts.under_runs += not self._starved
            self._starved = True
