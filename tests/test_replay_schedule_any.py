"""Whatever is asked of a schedule, in any order, at any time: what must hold of each frame holds.

And the check is worth something: with each of its parts broken, a schedule is found out.
"""

from __future__ import annotations

from dataclasses import replace
from math import floor

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)
from replay_watch import SCENES, Watch, profiles, rows

from hapfmt.replay import schedule
from hapfmt.replay.profile.model import FrameBlock
from hapfmt.replay.schedule import ActuatorPath, Envelope, Limiter, Schedule

HOUR_NS = 3600 * 10**9


class Replays(RuleBasedStateMachine):
    """Feeds, lets time pass, stalls, pauses, seeks and stops."""

    @initialize(profile=profiles(), gain=st.sampled_from([None, None, 1.0, 0.01]))
    def begin(self, profile, gain):
        self.watch = Watch(profile, gain)
        self.schedule = self.watch.schedule
        self.now_ns = 0
        self.ordered = 0
        """Blocks come in order: none begins before the one before it."""
        self.generation = 0

    def feed(self, data, first, samples, **more):
        values, known = data.draw(rows(self.watch.profile, samples))
        self.watch.feed(FrameBlock(first, values, known, self.generation, **more))
        self.ordered = first

    @rule(data=st.data(), samples=st.integers(0, 80))
    def feed_the_next(self, data, samples):
        self.feed(data, self.watch.fed, samples)

    @rule(data=st.data(), samples=st.integers(0, 80), shift=st.integers(-40, 40))
    def feed_over_or_beyond(self, data, samples, shift):
        first = max(self.watch.fed + shift, self.ordered, self.watch.start)
        self.feed(data, first, samples)

    @precondition(lambda self: self.generation)
    @rule(data=st.data())
    def feed_what_is_old(self, data):
        values, known = data.draw(rows(self.watch.profile, 20))
        self.watch.feed(FrameBlock(self.watch.fed, values, known, self.generation - 1, last=True))

    @rule(data=st.data(), samples=st.integers(0, 30))
    def feed_the_last(self, data, samples):
        self.feed(data, self.watch.fed, samples, last=True)

    @rule(data=st.data(), frames=st.integers(1, 60))
    def play(self, data, frames):
        """As a player does, ahead of time."""
        samples = frames * self.watch.size
        while self.watch.end is None and self.watch.fed < self.schedule.played + samples + 20:
            self.feed(data, self.watch.fed, samples + 20)
        self.go_on(frames)

    @rule(frames=st.integers(1, 30))
    def go_on(self, frames):
        for _ in range(frames):
            self.now_ns = max(self.now_ns, self.schedule.next_ns)
            self.watch.tick(self.now_ns)

    @rule(periods=st.lists(st.fractions(0, 5, max_denominator=64), min_size=1, max_size=5))
    def wait(self, periods):
        for part in periods:
            self.now_ns += floor(part * self.watch.period_ns)
            self.watch.tick(self.now_ns)
            assert self.schedule.frames_due(self.now_ns) is None

    @rule(frames=st.lists(st.booleans(), min_size=1, max_size=10))
    def lose(self, frames):
        """Frames that were made and not sent."""
        for taken in frames:
            self.now_ns = max(self.now_ns, self.schedule.next_ns)
            self.watch.tick(self.now_ns, taken)

    @rule(ns=st.sampled_from([10**6, 19 * 10**6, 20 * 10**6]))
    def stall(self, ns):
        self.now_ns += ns
        self.watch.tick(self.now_ns)

    @rule(ns=st.sampled_from([1, 10**6, 20 * 10**6]))
    def jump_back(self, ns):
        self.now_ns -= ns
        self.watch.tick(self.now_ns)

    @rule(
        ns=st.sampled_from([21 * 10**6, 10**9, HOUR_NS, -21 * 10**6, -HOUR_NS]),
        rarely=st.integers(0, 3),
    )
    def jump(self, ns, rarely):
        if rarely == 0:
            self.now_ns += ns
            self.watch.tick(self.now_ns)

    @rule()
    def pause(self):
        self.watch.pause()

    @rule()
    def resume(self):
        self.schedule.resume()

    @rule(
        data=st.data(),
        first=st.integers(0, 500),
        step=st.sampled_from([1, 1, 1, 2, 0, -1]),
        frames=st.integers(0, 20),
    )
    def seek(self, data, first, step, frames):
        self.watch.seek(self.generation + step, first)
        if self.watch.generation != self.generation:
            self.generation, self.ordered = self.watch.generation, first
        if frames:
            self.play(data, frames)

    @rule(
        outcome=st.sampled_from(["interrupted", "failed", "device-lost"]), rarely=st.integers(0, 3)
    )
    def stop(self, outcome, rarely):
        if rarely == 0:
            self.watch.stop(outcome)

    def teardown(self):
        if hasattr(self, "watch"):
            self.watch.stop()
            self.watch.run_to_end()
            assert self.schedule.outcome is not None
            assert self.schedule.frames_due(self.now_ns + HOUR_NS) is None


Replays.TestCase.settings = settings(stateful_step_count=40)


class TestAnyReplay(Replays.TestCase):
    """PLY-002: Whatever the file contains and whatever happens, a player MUST keep every value that it sends within the limits. Its difference from the value before is at most the largest change of one sample."""


def unlimited(self, wanted):
    self.count = wanted
    return wanted


def clamped_only(self, wanted):
    self.count = min(max(wanted, self._low), self._high)
    return self.count


def at_once(self):
    self.phase = self.length
    return 1.0


def half_way(self):
    self.phase = max(self.phase - 1, 0)
    self.falling = self.phase > self.length // 2
    return self.shape() / self.top if self.top else 0.0


def dropped(self):
    self.phase = 0
    return 0.0


def held(self):
    return self.limiter(self.limiter.count)


def all_of_them(self, samples):
    self.played += samples


def twice(self, now_ns):
    due = now_ns * self._periods // self._period_ns
    self._number = min(self._number, due)
    return FRAMES_DUE(self, now_ns)


def one_after_the_other(self, now_ns):
    """A burst: late frames are all sent."""
    return FRAMES_DUE(self, min(now_ns, self.next_ns)) if now_ns >= self.next_ns else None


def early(self, now_ns):
    return FRAMES_DUE(self, now_ns + 1000)


def patient(self, profile, gain=None):
    timing = replace(profile.timing, hold_s=1e6)
    INIT(self, replace(profile, timing=timing), gain)


def resumed_at_once(self):
    RESUME(self)
    self._settling = False


def old_blocks_stay(self, generation, first):
    blocks = self._blocks
    SEEK(self, generation, first)
    self._blocks = blocks


def no_settling(self, generation, first):
    SEEK(self, generation, first)
    self._settling = self._goal == "stop"


def louder(self, profile, gain=None):  # noqa: ARG001
    INIT(self, profile, 1.0)


FRAMES_DUE, INIT, RESUME, SEEK = (
    Schedule.frames_due,
    Schedule.__init__,
    Schedule.resume,
    Schedule.seek,
)
FAULTS = [
    (Limiter, "__call__", unlimited),
    (Limiter, "__call__", clamped_only),
    (Envelope, "rise", at_once),
    (Envelope, "fall", half_way),
    (Envelope, "fall", dropped),
    (ActuatorPath, "fall", held),
    (ActuatorPath, "cut", lambda _: None),
    (schedule, "isfinite", lambda _: True),
    (schedule, "abs", lambda value: value),
    (Schedule, "_leap", all_of_them),
    (Schedule, "frames_due", twice),
    (Schedule, "frames_due", one_after_the_other),
    (Schedule, "frames_due", early),
    (Schedule, "__init__", patient),
    (Schedule, "__init__", louder),
    (Schedule, "resume", resumed_at_once),
    (Schedule, "seek", old_blocks_stay),
    (Schedule, "seek", no_settling),
]


FOUND = (AssertionError, ValueError, OverflowError)


@pytest.mark.parametrize(
    ("where", "name", "fault"), FAULTS, ids=lambda x: getattr(x, "__name__", x)
)
def test_a_fault_is_found(where, name, fault, monkeypatch):
    monkeypatch.setattr(where, name, fault, raising=False)
    found = 0
    for scene in SCENES.values():
        try:
            watch = scene(Watch)
            watch.stop()
            watch.run_to_end()
        except FOUND:
            found += 1
    assert found


@pytest.mark.deep
@pytest.mark.parametrize(
    ("where", "name", "fault"),
    [
        (Limiter, "__call__", unlimited),
        (Limiter, "__call__", clamped_only),
        (ActuatorPath, "fall", held),
        (Schedule, "__init__", patient),
    ],
)
def test_a_fault_is_found_by_search(where, name, fault, monkeypatch):
    monkeypatch.setattr(where, name, fault, raising=False)
    search = settings(
        max_examples=2000,
        stateful_step_count=40,
        phases=[Phase.generate],
        derandomize=True,
        database=None,
        report_multiple_bugs=False,
    )
    with pytest.raises(FOUND):
        run_state_machine_as_test(Replays, settings=search)
