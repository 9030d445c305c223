"""What must hold of every frame of a schedule, said once more and otherwise than it is computed."""

from __future__ import annotations

from fractions import Fraction
from math import ceil, cos, floor, inf, isfinite, nan, pi

import numpy as np
from hypothesis import strategies as st

from hapfmt.replay.profile.model import Actuator, Frame, FrameBlock, Profile, Timing
from hapfmt.replay.schedule import Schedule


def make_profile(*actuators: Actuator, gain: float = 1.0, **timing) -> Profile:
    timing = {"rate": Fraction(1000), "ramp_s": 0.004, **timing}
    actuators = actuators or (make_actuator(),)
    return Profile("bench", "", "", (), Timing(**timing), actuators, gain=gain)


def make_actuator(
    name="force", minimum=-5.0, maximum=5.0, slew=1e6, step=0.001, **more
) -> Actuator:
    return Actuator(name, "N", minimum, maximum, slew, step, **more)


def make_block(first, values, known=True, generation=0, last=False) -> FrameBlock:
    """``values``: [samples] or [samples][actuators]."""
    values = np.array(values, float)
    values = values[:, None] if values.ndim == 1 else values
    return FrameBlock(first, values, np.broadcast_to(known, values.shape), generation, last)


AWKWARD = [nan, inf, -inf, 1e300, -1e300, 1.7e308, -0.0, 5e-324]


@st.composite
def actuators(draw, rate):
    step = draw(st.sampled_from([0.001, 1.0, 1 / 3, 1e-9, 250.0]))
    low = draw(st.integers(-200, 200))
    high = draw(st.integers(low, low + 300))
    rest = draw(st.integers(low, high))
    change = draw(st.sampled_from([1, 1, 2, 7, 50, 10**6]))
    return Actuator(
        "a",
        "N",
        (low - 0.25) * step,
        (high + draw(st.sampled_from([0.25, 0.75]))) * step,
        (change + 0.01) * step * float(rate),
        step,
        rest * step,
        rectify=draw(st.booleans()),
    )


@st.composite
def profiles(draw):
    rate = draw(st.sampled_from([Fraction(1000), Fraction(30000, 1001), Fraction(3000)]))
    return make_profile(
        *draw(st.lists(actuators(rate), min_size=1, max_size=3)),
        gain=draw(st.sampled_from([1.0, 0.5, 1 / 3, 1e-300])),
        rate=rate,
        frame_samples=draw(st.sampled_from([1, 1, 1, 2, 32])),
        ramp_s=draw(st.sampled_from([0.0, 0.003, 0.02])),
        hold_s=draw(st.sampled_from([0.02, 0.02, 0.02, 0.0005])),
    )


@st.composite
def rows(draw, profile, samples):
    """Values and what is known of them: runs of constants, with leaps between."""
    width = len(profile.actuators)
    values = np.empty((samples, width))
    known = np.ones((samples, width), bool)
    for column, actuator in enumerate(profile.actuators):
        room = 2 * (actuator.maximum - actuator.minimum) + actuator.step
        usual = st.floats(actuator.minimum - room, actuator.maximum + room)
        cuts = draw(st.lists(st.integers(0, samples), max_size=4))
        for start, stop in zip([0, *sorted(cuts)], [*sorted(cuts), samples], strict=True):
            values[start:stop, column] = draw(usual | usual | st.sampled_from(AWKWARD))
            known[start:stop, column] = draw(st.sampled_from([True, True, True, False]))
    return values, known


class Watch:
    """Calls ``frames_due`` and checks what comes, sample by sample, against what was fed."""

    def __init__(self, profile: Profile, gain: float | None = None) -> None:
        self.schedule = Schedule(profile, gain)
        self.profile = profile
        self.gain = profile.gain if gain is None else gain
        self.limits = [profile.limits(actuator) for actuator in profile.actuators]
        self.period_ns = profile.timing.period * 10**9
        self.size = profile.timing.frame_samples
        self.last = [limits.rest for limits in self.limits]
        self.number = -1
        self.unsent = 0
        """The first frame since which the device got none."""
        self.sent = self.made = 0
        self.lost_ns = 0
        """By which the clock jumped back too far."""
        self.latest_ns = 0
        self.generation = self.start = 0
        self.settling = False
        """Nothing may be played before all are at rest."""
        self.content: dict[int, tuple[list[float], list[bool]]] = {}
        self.end: int | None = None
        self.bound: int | None = None
        """Frames that the end may take."""

    def feed(self, block: FrameBlock) -> None:
        self.schedule.feed(block)
        if block.generation != self.generation or self.end is not None:
            return
        if block.first + len(block.values) > self.fed:  # else it brings nothing
            given = zip(block.values.tolist(), block.known.tolist(), strict=True)
            for at, row in enumerate(given, block.first):
                self.content.setdefault(at, row)
        if block.last:
            self.end = self.fed

    @property
    def fed(self) -> int:
        return max(self.content, default=self.start - 1) + 1

    def seek(self, generation: int, first: int) -> None:
        stopping = self.schedule.state in ("stopping", "ended")
        self.schedule.seek(generation, first)
        if generation > self.generation and not stopping:
            self.generation, self.content, self.end, self.start = generation, {}, None, first
            self.settling = True

    def pause(self) -> None:
        self.settling |= self.schedule.state == "playing"
        self.schedule.pause()

    def stop(self, outcome="interrupted") -> None:
        self.schedule.stop(outcome)
        self.note_stop()

    def note_stop(self) -> None:
        if self.schedule.state == "stopping" and self.bound is None:
            self.bound = self.sent + self.schedule.frames_to_rest

    def tick(self, now_ns: int, taken: bool = True) -> Frame | None:
        """One call, at ``now_ns``; ``taken``: whether the device gets what comes."""
        schedule, lanes = self.schedule, self.schedule.lanes
        state, played = schedule.state, schedule.played
        before = [(lane.envelope.phase, lane.envelope.falling) for lane in lanes]
        to_rest = schedule.frames_to_rest
        frame = schedule.frames_due(now_ns)
        hold_ns = round(self.profile.timing.hold_s * 1e9)
        broken = self.number >= 0 and now_ns + self.lost_ns < self.latest_ns - hold_ns
        if broken and state != "ended":
            self.lost_ns = self.latest_ns - now_ns
            assert schedule.outcome in ("late", "device-lost")
        time_ns = now_ns + self.lost_ns
        self.latest_ns = max(self.latest_ns, time_ns)
        due = floor(time_ns / self.period_ns)
        if state == "ended" or due <= self.number:
            assert frame is None
            self.note_stop()
            return None
        assert frame is not None
        assert frame.number == due
        assert frame.due_ns == ceil(due * self.period_ns) - self.lost_ns <= now_ns
        assert schedule.next_ns == ceil((due + 1) * self.period_ns) - self.lost_ns > now_ns
        if time_ns - ceil(self.unsent * self.period_ns) > hold_ns:
            assert schedule.outcome in ("late", "device-lost")
            assert schedule.state in ("stopping", "ended")
        skipped, self.number = due - self.unsent, due
        unsent, self.unsent, last = self.unsent, due + 1, self.last[:]
        self.sent += 1
        self.check_counts(schedule.counts, due)
        self.check_samples(frame, state, played, skipped, before)
        if schedule.state in ("stopping", "ended"):
            if self.bound is None:
                self.bound = self.sent - 1 + max(to_rest, self.static_bound)
            assert self.sent < self.bound or schedule.state == "ended"
        if schedule.state == "ended":
            assert all(row == tuple(x.rest for x in self.limits) for row in frame.counts)
        if not taken:
            schedule.not_taken()
            self.sent, self.unsent, self.last = self.sent - 1, unsent, last
            now = [(lane.envelope.phase, lane.envelope.falling) for lane in lanes]
            assert (schedule.played, now) == (played, before)
            assert schedule.state != "ended"
        return frame

    @property
    def static_bound(self) -> int:
        slowest = max(-(-(x.high - x.low) // x.change) for x in self.limits)
        length = max(lane.envelope.length for lane in self.schedule.lanes)
        return -(-(length + slowest) // self.size) + 1

    def check_counts(self, counts, due) -> None:
        assert counts.sent == self.sent
        assert counts.sent + counts.skipped == due + 1
        self.made += 1  # what was counted of a frame that is not taken stays counted
        samples = self.made * self.size * len(self.limits)
        assert counts.clamped <= samples and counts.refused <= samples
        assert counts.slew_limited <= samples and counts.gap_samples <= samples
        assert counts.under_runs <= counts.under_run_samples <= self.made * self.size

    def check_samples(self, frame, state, played, skipped, before) -> None:
        schedule = self.schedule
        assert len(frame.counts) == self.size
        moved = schedule.played - played
        assert moved in (0, self.size, self.size * (skipped + 1), self.size * skipped)
        at = schedule.played - self.size if moved and schedule.outcome is None else None
        self.settling &= any(
            phase or last != limits.rest
            for (phase, _), last, limits in zip(before, self.last, self.limits, strict=True)
        )
        if self.settling or state in ("pausing", "paused", "stopping", "ended"):
            assert moved == 0
        for index, limits in enumerate(self.limits):
            lane = schedule.lanes[index]
            phase, falling = before[index]
            length = lane.envelope.length
            for sample, row in enumerate(frame.counts):
                old, new = self.last[index], row[index]
                given = None if at is None else self.value(at + sample, index)
                assert isinstance(new, int)
                assert limits.low <= new <= limits.high
                assert abs(new - old) <= limits.change
                self.check_gain(index, limits, new)
                if sample == 0 and at is not None and skipped and moved > self.size:
                    over = range(at - skipped * self.size, at)
                    if phase and any(self.value(x, index) is None for x in over):
                        falling = True
                if given is None or falling:
                    # Nothing is invented: towards rest, never away from it, never past it.
                    assert min(old, limits.rest) <= new <= max(old, limits.rest)
                    falling = bool(phase) or falling
                    phase = max(phase - 1, 0)
                    if phase == 0 and new == limits.rest:
                        falling = False
                else:
                    phase = min(phase + 1, length)
                    shape = 1.0 if phase == length else (1 - cos(pi * phase / length)) / 2
                    rest = self.profile.actuators[index].rest
                    value = rest + self.gain * shape * (given - rest)
                    wanted = floor(value / self.profile.actuators[index].step + 0.5)
                    wanted = min(max(wanted, limits.low), limits.high)
                    assert new == min(max(wanted, old - limits.change), old + limits.change)
                self.last[index] = new
            assert (lane.envelope.phase, lane.envelope.falling) == (phase, falling)

    def check_gain(self, index, limits, count) -> None:
        """No force is nearer to a limit than the gain allows."""
        actuator = self.profile.actuators[index]
        below = self.gain * (actuator.rest - actuator.minimum) / actuator.step
        above = self.gain * (actuator.maximum - actuator.rest) / actuator.step
        assert -below - 1 <= count - limits.rest <= above + 1

    def value(self, at, index) -> float | None:
        """What an actuator would be given there, within its limits; None: nothing."""
        row, known = self.content.get(at, ([], []))
        if not row or not known[index] or not isfinite(row[index]):
            return None
        actuator = self.profile.actuators[index]
        value = abs(row[index]) if actuator.rectify else row[index]
        return min(max(value, actuator.minimum), actuator.maximum)

    def run_to_end(self) -> None:
        """On time, from now on; it must end."""
        self.note_stop()
        for _ in range((self.bound or 0) - self.sent + 1):
            if self.schedule.state == "ended":
                break
            self.tick(self.schedule.next_ns)
        assert self.schedule.state == "ended"


def scene_steep(watch_of):
    """More than the slew limit, than the limits, and not finite."""
    watch = watch_of(make_profile(make_actuator(slew=1000, maximum=4.9996)))
    watch.feed(make_block(0, [1] * 20 + [-1e300] * 20 + [1e300] * 30 + [nan] * 30 + [3] * 30))
    on_time(watch, 130)
    return watch


def scene_gap(watch_of):
    watch = watch_of(make_profile(make_actuator(rest=1.0), gain=0.5))
    watch.feed(make_block(0, [-4.0] * 60, np.array([[n % 20 < 12] for n in range(60)])))
    on_time(watch, 60)
    return watch


def scene_magnitudes(watch_of):
    watch = watch_of(make_profile(make_actuator(minimum=0.0, rectify=True)))
    watch.feed(make_block(0, [-2.0] * 30))
    on_time(watch, 20)
    return watch


def scene_stalls(watch_of):
    """Short ones, over joins too; then one that is too long."""
    watch = watch_of(make_profile())
    watch.feed(make_block(0, np.sin(np.arange(300) / 9), np.arange(300)[:, None] % 30 != 7))
    now_ns = 0
    for periods in [
        1,
        1,
        1,
        1,
        1,
        1,
        3.7,
        0.2,
        1,
        1,
        1,
        1,
        2,
        15,
        1,
        1,
        1,
        1,
        1,
        1,
        8,
        1,
        1,
        1,
        25,
        1,
    ]:
        watch.tick(now_ns - 1000)
        watch.tick(now_ns)
        watch.tick(now_ns)
        now_ns += round(periods * watch.period_ns)
    return watch


def scene_back(watch_of):
    watch = watch_of(make_profile())
    watch.feed(make_block(0, np.ones(300)))
    on_time(watch, 50)
    watch.tick(49_000_000)
    watch.tick(40_000_000)
    on_time(watch, 5)
    watch.tick(1_000_000)
    return watch


def scene_pause(watch_of):
    watch = watch_of(make_profile())
    watch.feed(make_block(0, np.arange(300) / 100))
    on_time(watch, 20)
    watch.pause()
    on_time(watch, 2)
    watch.schedule.resume()
    on_time(watch, 10)
    watch.pause()
    on_time(watch, 10)
    watch.schedule.resume()
    on_time(watch, 10)
    return watch


def scene_seek(watch_of):
    watch = watch_of(make_profile(make_actuator(slew=300)))
    watch.feed(make_block(0, np.full(300, 2.0)))
    on_time(watch, 20)
    for generation in (1, 2):
        watch.seek(generation, 0)
        watch.feed(make_block(0, np.full(300, -3.0), generation=generation))
        on_time(watch, 5 * generation)
    on_time(watch, 50)
    watch.seek(3, 10)
    on_time(watch, 50)
    return watch


def on_time(watch, frames) -> None:
    for _ in range(frames):
        watch.tick(watch.schedule.next_ns)


SCENES = {name[6:]: value for name, value in list(globals().items()) if name.startswith("scene_")}
