"""The frames of a schedule, literally; and scenes where each of its parts is needed."""

from __future__ import annotations

import weakref
from dataclasses import replace
from fractions import Fraction
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_watch import AWKWARD, SCENES, Watch, make_actuator, make_block, make_profile

from hapfmt.errors import ParameterError
from hapfmt.replay.profile.model import CountLimits
from hapfmt.replay.schedule import Limiter, Schedule, ramp_samples

MS = 10**6
ENDLESS = 10_000
"""Counts: no replay here is as long."""


def sent(schedule, frames=None):
    """The counts of the first actuator in the next frames, on time."""
    found = []
    while schedule.state != "ended" and (frames is None or len(found) < frames):
        assert len(found) < ENDLESS, "it does not end"
        frame = schedule.frames_due(schedule.next_ns)
        found.extend(row[0] for row in frame.counts)
    return found


def started(values, profile=None, **more):
    schedule = Schedule(profile or make_profile(), **more)
    schedule.feed(make_block(0, values))
    return schedule


class TestRamps:
    """PLY-003: A player MUST pass from rest to signal and back by a ramp, never by a step: at the start and the end, at a pause, a seek, the join of a loop, an error."""

    def test_start_and_end(self):
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, np.ones(6), last=True))
        assert sent(schedule) == [146, 500, 854, 1000, 1000, 1000, 854, 500, 146, 0]
        assert schedule.outcome == "clean"

    def test_an_error(self):
        schedule = started(np.ones(6))
        assert sent(schedule, 4) == [146, 500, 854, 1000]
        schedule.stop("failed")
        assert schedule.state == "stopping"
        assert sent(schedule) == [854, 500, 146, 0]
        assert schedule.outcome == "failed"

    def test_a_pause_goes_on_where_it_was(self):
        schedule = started([1, 1, 1, 1, 1, 2, 3, 3, 3, 3, 3])
        assert sent(schedule, 5) == [146, 500, 854, 1000, 1000]
        schedule.pause()
        assert schedule.state == "pausing"
        assert sent(schedule, 4) == [854, 500, 146, 0]
        assert schedule.state == "paused"
        assert sent(schedule, 2) == [0, 0]
        schedule.resume()
        assert sent(schedule, 5) == [293, 1500, 2561, 3000, 3000]
        assert schedule.counts.gap_samples == schedule.counts.under_runs == 0

    def test_a_pause_in_a_soft_start(self):
        schedule = started(np.ones(20))
        assert sent(schedule, 3) == [146, 500, 854]
        schedule.pause()
        assert sent(schedule, 4) == [500, 147, 0, 0]

    def test_a_pause_taken_back_comes_to_rest_first(self):
        schedule = started(np.ones(20))
        assert sent(schedule, 4) == [146, 500, 854, 1000]
        schedule.pause()
        assert sent(schedule, 1) == [854]
        schedule.resume()
        assert schedule.state == "playing"
        assert sent(schedule, 7) == [500, 146, 0, 146, 500, 854, 1000]

    def test_a_seek_waits_for_rest_and_for_its_blocks(self):
        schedule = started(np.ones(20))
        assert sent(schedule, 4) == [146, 500, 854, 1000]
        schedule.seek(1, 5000)
        assert schedule.played == 5000
        schedule.feed(make_block(4, np.ones(9)))  # rendered before the seek
        assert sent(schedule, 6) == [854, 500, 146, 0, 0, 0]
        schedule.feed(make_block(5000, np.full(9, 2.0), generation=1))
        assert sent(schedule, 3) == [293, 1000, 1707]
        assert schedule.counts.under_runs == 0

    @pytest.mark.parametrize("generation", [0, 2])
    def test_blocks_of_another_seek(self, generation):
        """Those from before it, and those of one that is still to come, are not played."""
        schedule = started(np.ones(20))
        schedule.seek(1, 0)
        schedule.feed(make_block(0, np.full(9, 2.0), generation=generation, last=True))
        assert sent(schedule, 3) == [0, 0, 0]
        schedule.feed(make_block(0, np.ones(9), generation=1))
        assert sent(schedule, 4) == [146, 500, 854, 1000]

    def test_a_block_that_ends_where_a_seek_begins(self):
        """It brings nothing, so the replay waits for one that does."""
        schedule = started(np.ones(20))
        schedule.seek(1, 50)
        schedule.feed(make_block(40, np.ones(10), generation=1))
        assert sent(schedule, 3) == [0, 0, 0]
        assert (schedule.played, schedule.counts.under_runs) == (50, 0)

    def test_a_seek_in_a_ramp(self):
        schedule = started(np.ones(20))
        assert sent(schedule, 2) == [146, 500]
        schedule.seek(1, 0)
        schedule.feed(make_block(0, np.full(9, -4.0), generation=1))
        assert sent(schedule, 4) == [146, 0, -586, -2000]

    def test_a_seek_that_was_asked_for_before(self):
        schedule = started(np.ones(20))
        schedule.seek(2, 0)
        schedule.feed(make_block(0, np.ones(20), generation=2))
        sent(schedule, 5)
        for generation in (2, 1, 0):
            schedule.seek(generation, 0)
        assert schedule.played == 5
        assert sent(schedule, 2) == [1000, 1000]

    def test_frames_left_out_before_it_plays_cost_nothing_of_it(self):
        schedule = Schedule(make_profile())
        sent(schedule, 2)
        schedule.feed(make_block(0, [1, 2, 3, 4, 5, 5, 5, 5]))
        assert schedule.frames_due(7 * MS).counts == ((146,),)
        assert sent(schedule, 4) == [1000, 2561, 4000, 5000]
        schedule.seek(1, 50)
        sent(schedule, 5)
        schedule.feed(make_block(50, [1, 2, 3, 4], generation=1))
        assert schedule.frames_due(30 * MS).counts == ((146,),)

    def test_a_late_first_frame_leaves_nothing_out(self):
        schedule = started([1, 2, 3, 4, 5])
        assert schedule.frames_due(5 * MS).counts == ((146,),)
        assert schedule.played == 1

    def test_a_seek_in_a_pause_stays_paused(self):
        schedule = started(np.ones(20))
        sent(schedule, 5)
        schedule.pause()
        sent(schedule, 5)
        schedule.seek(1, 100)
        schedule.feed(make_block(100, np.ones(9), generation=1))
        assert sent(schedule, 3) == [0, 0, 0]
        schedule.resume()
        assert sent(schedule, 2) == [146, 500]

    def test_a_seek_from_a_signal_at_rest(self):
        """Its ramp is at the top although it sends the resting count: no step after the seek."""
        schedule = started(np.zeros(20))
        assert sent(schedule, 6) == [0] * 6
        schedule.pause()
        assert schedule.state == "pausing"
        schedule.resume()
        schedule.seek(1, 100)
        schedule.feed(make_block(100, np.ones(9), generation=1))
        assert sent(schedule, 8) == [0, 0, 0, 0, 146, 500, 854, 1000]

    def test_the_join_of_a_loop(self):
        """However short: one sample of nothing is a ramp down and one up."""
        schedule = Schedule(make_profile())
        known = np.ones((14, 1), bool)
        known[4] = False
        schedule.feed(make_block(0, np.ones(14), known))
        assert sent(schedule, 12) == [
            *(146, 500, 854, 1000),
            *(854, 500, 146, 0),
            *(146, 500, 854, 1000),
        ]

    def test_a_skip_over_a_join(self):
        """Both sides are known, what is skipped is not: no step from one to the other."""
        schedule = Schedule(make_profile())
        known = np.ones((30, 1), bool)
        known[5] = False
        schedule.feed(make_block(0, [1] * 5 + [0] + [4] * 24, known))
        sent(schedule, 5)
        assert schedule.frames_due(7 * MS).counts == ((854,),)
        assert sent(schedule, 5) == [500, 146, 0, 586, 2000]

    def test_a_skip_in_a_join(self):
        """The fall goes on from its own top, not from where the slew limit kept the actuator."""
        profile = make_profile(make_actuator(slew=170), ramp_s=0.008)
        known = np.arange(60)[:, None] < 20
        schedule = Schedule(profile)
        schedule.feed(make_block(0, np.ones(60), known))
        assert sent(schedule, 26)[20:] == [962, 854, 691, 521, 351, 181]
        assert schedule.frames_due(28 * MS).counts == ((38,),)
        assert sent(schedule, 2) == [0, 0]

    def test_a_skip_at_rest(self):
        """Who is at rest already need not come to rest: the signal begins with its first sample."""
        known = np.ones((40, 1), bool)
        known[5:20] = False
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, np.ones(40), known))
        assert sent(schedule, 10)[5:] == [854, 500, 146, 0, 0]
        assert schedule.frames_due(20 * MS).counts == ((146,),)

    def test_a_skip_over_a_hole_between_blocks(self):
        schedule = started(np.ones(6))
        schedule.feed(make_block(8, np.full(20, 4.0)))
        sent(schedule, 5)
        assert schedule.frames_due(10 * MS).counts == ((854,),)
        assert sent(schedule, 5) == [500, 146, 0, 586, 2000]

    def test_a_skip_before_a_join(self):
        """Only what is skipped must be known."""
        known = np.ones((20, 1), bool)
        known[9] = False
        schedule = started(np.ones(5))
        schedule.feed(make_block(5, np.ones(20), known))
        sent(schedule, 6)
        assert schedule.frames_due(8 * MS).counts == ((1000,),)
        assert sent(schedule, 6) == [1000] * 5 + [854]

    def test_a_skip_of_frames_of_many_samples(self):
        schedule = started(np.arange(60) / 20, make_profile(frame_samples=3))
        sent(schedule, 3)
        assert schedule.frames_due(15 * MS).counts == ((750,), (800,), (850,))
        assert schedule.played == 18

    def test_a_ramp_too_long_to_be_seen(self):
        """So long that a raised cosine of its first sample is zero as a double."""
        schedule = started(np.full(9, 5.0), make_profile(ramp_s=1e6))
        assert sent(schedule, 2) == [0, 0]
        schedule.stop()
        assert sent(schedule) == [0, 0]

    def test_to_a_rest_that_is_not_zero(self):
        profile = make_profile(make_actuator(rest=2.0), gain=0.5)
        schedule = Schedule(profile)
        schedule.feed(make_block(0, np.full(5, -5.0), last=True))
        assert sent(schedule) == [1487, 250, -987, -1500, -1500, -987, 250, 1487, 2000]

    def test_with_a_device_of_many_samples_a_frame(self):
        schedule = Schedule(make_profile(frame_samples=3))
        schedule.feed(make_block(0, np.ones(7), last=True))
        assert sent(schedule) == [
            146,
            500,
            854,
            1000,
            1000,
            1000,
            1000,
            854,
            500,
            146,
            0,
            0,
            0,
            0,
            0,
        ]
        assert schedule.counts.sent == 5

    @pytest.mark.parametrize(
        ("ramp_s", "samples"), [(0.05, 50), (0.0005, 2), (0.0, 2), (0.0101, 11)]
    )
    def test_length(self, ramp_s, samples):
        assert ramp_samples(ramp_s, Fraction(1000)) == samples


class TestLimits:
    """PLY-002: Whatever the file contains and whatever happens, a player MUST keep every value that it sends within the limits. Its difference from the value before is at most the largest change of one sample."""

    def test_slew(self):
        schedule = started(np.ones(20), make_profile(make_actuator(slew=200)))
        assert sent(schedule, 7) == [146, 346, 546, 746, 946, 1000, 1000]
        assert schedule.counts.slew_limited == 4
        schedule.stop()
        assert sent(schedule) == [854, 654, 454, 254, 54, 0]

    def test_only_what_was_changed_is_counted(self):
        limiter = Limiter(CountLimits(-9, 9, 0, 3))
        assert [limiter(count) for count in (3, 0, -3, -9, -9, 9)] == [3, 0, -3, -6, -9, -6]
        assert limiter.limited == 2
        schedule = started([5.0, -5.0] * 4)
        sent(schedule, 8)
        assert schedule.counts.clamped == schedule.counts.slew_limited == 0

    def test_one_count_a_sample(self):
        """A fall starts from what was sent, and never goes on to what was wanted."""
        profile = make_profile(make_actuator(slew=1))
        schedule = started(np.ones(20), profile)
        assert sent(schedule, 6) == [1, 2, 3, 4, 5, 6]
        schedule.stop()
        assert schedule.frames_to_rest == 11
        assert sent(schedule) == [5, 4, 3, 2, 1, 0]

    def test_frames_to_rest(self):
        """The phases that are left, the counts that a slew limit leaves, and a frame at rest."""
        profile = make_profile(make_actuator(slew=2, rest=1.0), frame_samples=2)
        schedule = started(np.full(60, 5.0), profile)
        assert schedule.frames_to_rest == 1
        assert sent(schedule, 20)[-1] == 1040
        assert schedule.frames_to_rest == (4 + 40 / 2) / 2 + 1

    def test_without_actuators(self):
        """Nothing can move, so the first frame is the last of a stop."""
        schedule = Schedule(replace(make_profile(), actuators=()))
        assert schedule.frames_to_rest == 1
        schedule.stop()
        assert schedule.frames_due(0).counts == ((),)
        assert schedule.state == "ended"

    @pytest.mark.parametrize(("value", "count"), [(1e300, 5000), (-1e300, -5000), (5.1, 5000)])
    def test_clamp(self, value, count):
        schedule = started([value] * 9)
        assert sent(schedule, 9)[3:] == [count] * 6
        assert schedule.counts.clamped == 9

    def test_limits_are_rounded_inwards(self):
        profile = make_profile(make_actuator(minimum=-0.95, maximum=0.95, step=0.1))
        schedule = started([0.95] * 5 + [-0.95] * 5, profile)
        assert sent(schedule, 10)[3:] == [9, 9] + [-9] * 5

    def test_magnitudes(self):
        schedule = started([-2] * 5, make_profile(make_actuator(minimum=0, rectify=True)))
        assert sent(schedule, 5) == [293, 1000, 1707, 2000, 2000]

    @pytest.mark.parametrize(("gain", "count"), [(1.0, 1000), (0.5, 500), (1e-300, 0)])
    def test_gain(self, gain, count):
        assert sent(started(np.ones(9), gain=gain), 9)[-1] == count

    @pytest.mark.parametrize("gain", [0, -1, 1.001, nan, inf])
    def test_no_other_gain(self, gain):
        with pytest.raises(ParameterError, match="above 0 and at most 1"):
            Schedule(make_profile(), gain)

    @pytest.mark.parametrize(
        "change",
        [
            {"maximum": inf},
            {"minimum": -inf},
            {"maximum": nan},
            {"slew": nan},
            {"slew": inf},
            {"slew": 0.9},
            {"slew": -1e6},
            {"rest": 6.0},
            {"rest": nan},
            {"step": 0.0},
            {"step": -0.001},
            {"step": nan},
            {"step": 1e-300},
            {"step": 20.0, "minimum": 1.0, "rest": 1.0},
            {"minimum": -1.7e308, "maximum": 1.7e308, "step": 1e300},
            {"minimum": -1.7e308, "maximum": 1.7e308, "step": 1e300, "slew": 1e306},
            {"minimum": 0.0, "maximum": 0.0, "step": -0.001, "slew": -1e6},
            {"rest": 5.0004},
            {"rest": -5.0004},
            {"maximum": 2.0**53 + 2, "step": 1.0},
            {"minimum": -(2.0**53) - 2, "step": 1.0},
        ],
    )
    def test_no_limits_no_play(self, change):
        with pytest.raises(ParameterError, match="limits") as error:
            Schedule(make_profile(make_actuator(**change)))
        assert error.value.requirement == "PLY-001"

    @pytest.mark.parametrize("rest", [-5.0, 5.0])
    def test_rest_at_a_limit(self, rest):
        schedule = started(np.zeros(9), make_profile(make_actuator(rest=rest)))
        assert sent(schedule, 6)[3:] == [0, 0, 0]
        schedule.stop()
        assert sent(schedule)[-1] == 1000 * rest

    def test_limits_as_wide_as_can_be(self):
        """Counts up to 2^53 of either sign are exact as float64."""
        wide = make_actuator(minimum=-(2.0**53), maximum=2.0**53, step=1.0, slew=2.0**70)
        schedule = started([2.0**53] * 5 + [-(2.0**53)] * 5, make_profile(wide))
        found = sent(schedule, 10)
        assert (found[4], found[9]) == (2**53, -(2**53))

    @pytest.mark.parametrize(
        "timing",
        [
            {"rate": Fraction(0)},
            {"rate": Fraction(-1000)},
            {"frame_samples": 0},
            {"hold_s": 0.0},
            {"hold_s": nan},
            {"hold_s": inf},
            {"ramp_s": -0.001},
            {"ramp_s": inf},
            {"ramp_s": nan},
        ],
    )
    def test_no_times_no_play(self, timing):
        with pytest.raises(ParameterError, match="rate, frame, hold or ramp") as error:
            Schedule(make_profile(**timing))
        assert error.value.requirement == "PLY-001"

    @given(
        low=st.integers(-(2**53), 0),
        high=st.integers(0, 2**53),
        change=st.integers(1, 2**54),
        wanted=st.lists(st.integers(-(2**80), 2**80)),
    )
    def test_the_limiter_alone(self, low, high, change, wanted):
        limiter, last = Limiter(CountLimits(low, high, 0, change)), 0
        for count in wanted:
            found = limiter(count)
            assert low <= found <= high and abs(found - last) <= change
            nearest = min(max(count, low), high)
            assert found == nearest or abs(found - last) == change
            last = found


class TestLossOfSignal:
    """PLY-004: A player MUST treat ticks that a channel does not cover, and values that are not finite, as loss of signal: it ramps from the last value to rest, and invents none."""

    def test_a_gap(self):
        known = np.array([[True]] * 4 + [[False]] * 6 + [[True]] * 6)
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, [1] * 4 + [3] * 6 + [2] * 6, known))
        assert sent(schedule, 14) == [
            146,
            500,
            854,
            1000,
            854,
            500,
            146,
            0,
            0,
            0,
            293,
            1000,
            1707,
            2000,
        ]
        assert schedule.counts.gap_samples == 6
        assert schedule.counts.refused == schedule.counts.under_runs == 0

    def test_what_is_no_gap(self):
        """Before the first that is known, after the last, and from one place to another."""
        known = np.array([[False]] * 3 + [[True]] * 5 + [[False]] * 3)
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, np.ones(11), known))
        sent(schedule, 11)
        for generation in (1, 2):
            schedule.seek(generation, 0)
            schedule.feed(make_block(0, np.ones(11), known, generation, last=generation == 2))
            sent(schedule, 14)
        assert (schedule.state, schedule.counts.gap_samples) == ("ended", 0)

    def test_every_gap_counts_once(self):
        """With its last sample, however short what follows is."""
        known = np.array([[c == "x"] for c in "xxxx......xxxxxx.....x"])
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, np.ones(22), known, last=True))
        sent(schedule)
        assert schedule.counts.gap_samples == 11

    @given(st.lists(st.booleans(), max_size=40))
    def test_any_gaps(self, known):
        """All that is not known after the first that is, if the signal comes back after it."""
        known = [*known, *[True] * 8]
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, np.ones(len(known)), np.array(known)[:, None]))
        sent(schedule, len(known))
        assert schedule.counts.gap_samples == known[known.index(True) :].count(False)

    @pytest.mark.parametrize("value", [nan, inf, -inf])
    def test_not_finite(self, value):
        schedule = started([1] * 4 + [value] * 2 + [1] * 6)
        assert sent(schedule, 10) == [146, 500, 854, 1000, 854, 500, 146, 0, 146, 500]
        assert schedule.counts.refused == 2

    def test_nothing_but_what_is_not_finite(self):
        schedule = started([nan, inf, -inf] * 5)
        assert sent(schedule, 15) == [0] * 15

    def test_an_actuator_of_several(self):
        profile = make_profile(make_actuator("a"), make_actuator("b"))
        known = np.array([[True, False]] * 4 + [[False, False]] * 4)
        schedule = Schedule(profile)
        schedule.feed(make_block(0, np.ones((8, 2)), known, last=True))
        rows = [schedule.frames_due(schedule.next_ns).counts[0] for _ in range(8)]
        assert rows == [(x, 0) for x in (146, 500, 854, 1000, 854, 500, 146, 0)]

    def test_blocks_that_come_too_late(self):
        schedule = started(np.ones(4))
        assert sent(schedule, 6) == [146, 500, 854, 1000, 854, 500]
        schedule.feed(make_block(4, np.full(20, 2.0)))  # two of them have passed
        assert schedule.played == 6
        assert sent(schedule, 4) == [146, 0, 293, 1000]
        counts = schedule.counts
        assert (counts.under_runs, counts.under_run_samples, counts.gap_samples) == (1, 2, 0)

    def test_every_wait_for_blocks_counts_once(self):
        schedule = started(np.ones(4))
        sent(schedule, 6)
        schedule.feed(make_block(6, np.ones(4)))
        sent(schedule, 7)
        assert (schedule.counts.under_runs, schedule.counts.under_run_samples) == (2, 5)

    def test_a_first_frame_that_waits_counts_too(self):
        """That of a replay, and that after a seek."""
        schedule = Schedule(make_profile(frame_samples=3))
        for generation in (0, 1):
            schedule.seek(generation, 0)
            schedule.feed(make_block(0, np.ones(2), generation=generation))
            sent(schedule, 15)
            assert schedule.counts.under_runs == generation + 1

    def test_a_last_block_that_brings_nothing(self):
        """It ends the recording after what came before it."""
        schedule = started(np.ones(6))
        schedule.feed(make_block(2, [9, 9], last=True))
        assert sent(schedule) == [146, 500, 854, 1000, 1000, 1000, 854, 500, 146, 0]

    def test_blocks_are_kept_until_they_are_played(self):
        schedule = started(np.ones(4))
        block = make_block(4, np.ones(4))
        kept = weakref.ref(block.values)
        schedule.feed(block)
        schedule.feed(make_block(8, np.ones(4)))
        del block
        sent(schedule, 8)
        assert kept() is not None  # the last frame may come back
        sent(schedule, 1)
        assert kept() is None

    def test_blocks_after_a_stop_are_not_kept(self):
        schedule = started(np.ones(4))
        schedule.stop()
        block = make_block(4, np.ones(4))
        kept = weakref.ref(block.values)
        schedule.feed(block)
        del block
        assert kept() is None

    def test_the_samples_that_a_frame_needs(self):
        schedule = Schedule(make_profile(frame_samples=3))
        assert schedule.needs_blocks
        schedule.feed(make_block(0, np.ones(2)))
        assert schedule.needs_blocks
        schedule.feed(make_block(2, np.ones(1)))
        assert not schedule.needs_blocks
        schedule.frames_due(0)
        assert schedule.needs_blocks
        schedule.feed(make_block(3, np.ones(1), last=True))
        assert not schedule.needs_blocks

    def test_a_hole_between_blocks_is_a_gap(self):
        schedule = started(np.ones(4))
        schedule.feed(make_block(9, np.ones(9)))
        assert sent(schedule, 11) == [146, 500, 854, 1000, 854, 500, 146, 0, 0, 146, 500]
        assert (schedule.counts.under_runs, schedule.counts.gap_samples) == (0, 5)

    def test_a_short_block_beyond_a_hole(self):
        schedule = started(np.ones(4))
        schedule.feed(make_block(9, np.ones(2)))
        found = [len(schedule.frames_due(n * MS).counts) for n in range(12)]
        assert found == [1] * 12

    def test_nothing_follows_the_last_block(self):
        schedule = Schedule(make_profile(frame_samples=3))
        schedule.feed(make_block(0, np.ones(5), last=True))
        schedule.feed(make_block(5, np.ones(9), last=True))
        assert sent(schedule) == [146, 500, 854, 1000, 1000, 854, 500, 146, 0, 0, 0, 0]
        assert schedule.played == 6

    def test_blocks_that_overlap(self):
        schedule = started([1, 1, 1, 1, 1])
        schedule.feed(make_block(2, [9, 9, 9, 2, 3]))
        schedule.feed(make_block(3, [9, 9]))
        assert sent(schedule, 7)[3:] == [1000, 1000, 2000, 3000]

    def test_no_block_at_first_is_no_under_run(self):
        schedule = Schedule(make_profile())
        assert sent(schedule, 5) == [0] * 5
        schedule.feed(make_block(0, np.zeros(0)))
        assert sent(schedule, 2) == [0] * 2
        schedule.feed(make_block(0, np.ones(9)))
        assert sent(schedule, 2) == [146, 500]
        assert schedule.counts.under_runs == 0

    def test_a_first_block_that_begins_later(self):
        schedule = Schedule(make_profile())
        schedule.feed(make_block(3, np.ones(9)))
        assert sent(schedule, 5) == [0, 0, 0, 146, 500]

    @pytest.mark.parametrize("first", [0, 7])
    def test_nothing_at_all_to_play(self, first):
        schedule = Schedule(make_profile())
        schedule.feed(make_block(first, np.zeros(0), last=True))
        assert sent(schedule) == [0]
        assert (schedule.state, schedule.outcome) == ("ended", "clean")

    def test_a_block_of_another_shape(self):
        with pytest.raises(ParameterError, match="samples, 1"):
            Schedule(make_profile()).feed(make_block(0, np.ones((3, 2))))
        block = make_block(0, np.ones(3))
        with pytest.raises(ParameterError, match="samples, 1"):
            Schedule(make_profile()).feed(block._replace(known=np.ones((2, 1), bool)))
        for values in (np.ones((3, 2)), np.ones(3)):
            with pytest.raises(ParameterError, match="samples, 1"):
                Schedule(make_profile()).feed(block._replace(values=values))


class TestTime:
    """PLY-005: A player MUST NOT send a frame before its time, twice, or out of order; it skips a frame that is a period late or more and sends the one that is due. If it comes later to a frame than the profile allows, it ramps to rest and stops."""

    def test_never_early_never_twice(self):
        schedule = started(np.ones(9))
        assert schedule.frames_due(-1) is None
        assert schedule.frames_due(-(10**12)) is None
        assert schedule.outcome is None
        assert schedule.frames_due(0) == (0, 0, ((146,),))
        assert schedule.frames_due(0) is None
        assert schedule.frames_due(MS - 1) is None
        assert schedule.frames_due(MS) == (1, MS, ((500,),))
        assert schedule.frames_due(MS + 1) is None

    def test_late_frames_are_left_out(self):
        schedule = started([1, 1, 1, 1, 1, 2, 3, 4, 5])
        sent(schedule, 5)
        assert schedule.frames_due(7 * MS + 999_999) == (7, 7 * MS, ((4000,),))
        assert schedule.played == 8
        assert (schedule.counts.sent, schedule.counts.skipped) == (6, 2)
        assert schedule.next_ns == 8 * MS

    def test_a_ramp_is_not_shorter_for_it(self):
        schedule = started(np.ones(50))
        found = [schedule.frames_due(n * MS).counts[0][0] for n in (0, 2, 4, 9, 10)]
        assert found == [146, 500, 854, 1000, 1000]

    def test_periods_that_are_no_whole_nanoseconds(self):
        schedule = Schedule(make_profile(rate=Fraction(3000)))
        for number, due_ns in enumerate([0, 333_334, 666_667, 1_000_000, 1_333_334]):
            assert schedule.next_ns == due_ns
            assert schedule.frames_due(due_ns - 1) is None
            assert schedule.frames_due(due_ns)[:2] == (number, due_ns)

    def test_periods_of_seconds(self):
        schedule = Schedule(make_profile(make_actuator(slew=1), rate=Fraction(1, 2), hold_s=3.0))
        schedule.frames_due(0)
        assert schedule.next_ns == 2 * 10**9

    def test_a_clock_that_goes_back_a_little(self):
        schedule = started(np.ones(50))
        sent(schedule, 10)
        assert schedule.frames_due(0) is None
        assert schedule.frames_due(10 * MS).number == 10
        assert schedule.outcome is None


class TestLate:
    """PLY-005: A player MUST NOT send a frame before its time, twice, or out of order; it skips a frame that is a period late or more and sends the one that is due. If it comes later to a frame than the profile allows, it ramps to rest and stops."""

    @pytest.mark.parametrize("stall_ns", [20 * MS + 1, 3600 * 10**9, 10**20])
    def test_from_a_force_that_was_held(self, stall_ns):
        schedule = started(np.ones(50))
        sent(schedule, 5)
        frame = schedule.frames_due(5 * MS + stall_ns)
        assert frame.counts == ((854,),)
        assert frame.number == (5 * MS + stall_ns) // MS
        assert sent(schedule) == [500, 146, 0]
        assert (schedule.state, schedule.outcome) == ("ended", "late")
        assert schedule.counts.sent + schedule.counts.skipped == frame.number + 4

    def test_not_before(self):
        schedule = started(np.ones(50))
        sent(schedule, 5)
        assert schedule.frames_due(25 * MS).counts == ((1000,),)
        assert schedule.outcome is None

    @pytest.mark.parametrize("hold_s", [0.02, 10.0])
    def test_to_the_nanosecond(self, hold_s):
        for more, outcome in ((0, None), (1, "late")):
            schedule = started(np.ones(50), make_profile(hold_s=hold_s))
            schedule.frames_due(MS)
            schedule.frames_due(2 * MS + round(hold_s * 1000) * MS + more)
            assert schedule.outcome == outcome

    def test_a_clock_that_goes_back_by_the_hold_time(self):
        schedule = started(np.ones(50))
        schedule.frames_due(0)
        assert schedule.frames_due(-20 * MS) is None
        assert schedule.outcome is None
        assert schedule.frames_due(-20 * MS - 1) is None
        assert schedule.outcome == "late"
        assert schedule.next_ns == -19 * MS - 1

    def test_a_clock_that_goes_back_again(self):
        """A little does not count; as far as the first time does."""
        schedule = started(np.ones(5000), make_profile(ramp_s=0.008))
        sent(schedule, 1000)
        schedule.frames_due(500 * MS)
        assert schedule.next_ns == 501 * MS
        assert len(sent(schedule, 2)) == 2
        schedule.frames_due(490 * MS)
        assert schedule.next_ns == 503 * MS
        schedule.frames_due(100 * MS)
        assert schedule.next_ns == 101 * MS
        assert len(sent(schedule)) == 6

    def test_a_clock_that_goes_back(self):
        """Waiting until it has come as far again would hold the force for so long."""
        schedule = started(np.ones(5000))
        sent(schedule, 1000)
        assert schedule.frames_due(100 * MS) is None
        assert schedule.outcome == "late"
        assert schedule.next_ns == 101 * MS
        assert schedule.frames_due(101 * MS) == (1000, 101 * MS, ((854,),))
        assert sent(schedule) == [500, 146, 0]

    def test_what_is_graver_is_told(self):
        schedule = started(np.ones(50))
        sent(schedule, 5)
        schedule.stop("interrupted")
        schedule.frames_due(500 * MS)
        assert schedule.outcome == "late"
        schedule.stop("device-lost")
        schedule.stop("interrupted")
        assert schedule.outcome == "device-lost"


class TestEnds:
    def test_nothing_stops_a_stop(self):
        schedule = started(np.ones(50))
        sent(schedule, 5)
        schedule.stop()
        schedule.resume()
        schedule.pause()
        schedule.seek(1, 0)
        schedule.feed(make_block(0, np.ones(9), generation=1))
        assert sent(schedule) == [854, 500, 146, 0]
        assert schedule.played == 5
        assert schedule.frames_due(10**12) is None
        schedule.stop("device-lost")
        assert schedule.outcome == "interrupted"

    def test_in_a_pause(self):
        schedule = started(np.ones(50))
        schedule.pause()
        schedule.stop()
        assert sent(schedule) == [0]

    def test_of_a_signal_at_rest(self):
        schedule = started(np.zeros(50))
        sent(schedule, 5)
        schedule.stop()
        assert sent(schedule) == [0, 0, 0, 0]

    def test_a_recording_ends_with_its_last_sample(self):
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, np.ones(6), last=True))
        sent(schedule, 6)
        assert (schedule.state, schedule.outcome) == ("playing", None)
        sent(schedule, 1)
        assert (schedule.state, schedule.outcome, schedule.played) == ("stopping", "clean", 6)

    def test_frames_that_were_not_taken(self):
        """All is as before them; the last of a ramp is not the end then."""
        schedule = started(np.ones(50), make_profile(make_actuator(slew=200)))
        assert sent(schedule, 7)[-2:] == [1000, 1000]
        schedule.stop("failed")
        assert sent(schedule, 3) == [854, 654, 454]
        schedule.not_taken()
        assert sent(schedule, 1) == [454]
        schedule.not_taken()
        schedule.not_taken()
        assert sent(schedule, 3) == [454, 254, 54]
        assert sent(schedule) == [0]
        schedule.not_taken()
        assert schedule.state == "stopping"
        assert sent(schedule) == [0]
        assert (schedule.counts.sent, schedule.counts.skipped) == (7 + 2 + 4, 3)

    def test_the_first_frame_of_a_block_that_was_not_taken(self):
        """What lies before it in the block before is still known: no gap, no way down."""
        schedule = started(np.ones(6))
        schedule.feed(make_block(6, np.ones(6)))
        assert sent(schedule, 4) == [146, 500, 854, 1000]
        assert schedule.frames_due(6 * MS).counts == ((1000,),)
        schedule.not_taken()
        assert schedule.played == 4
        assert schedule.frames_due(7 * MS).counts == ((1000,),)
        assert schedule.counts.under_runs == 0

    def test_a_frame_that_was_not_sent_in_time(self):
        """It is left out like others: the recording goes on, the ramp does not, late is late."""
        schedule = started([1, 2, 3, 4, 5] * 9)
        schedule.not_taken()
        assert sent(schedule, 2) == [146, 1000]
        schedule.not_taken()
        assert schedule.played == 1
        assert sent(schedule, 2) == [1500, 3414]
        schedule.not_taken()
        assert schedule.frames_due(23 * MS).counts == ((3414,),)
        assert schedule.outcome is None

    def test_one_that_was_not_sent_is_late_all_the_same(self):
        schedule = started(np.ones(50))
        sent(schedule, 5)
        schedule.not_taken()
        schedule.frames_due(24 * MS)
        assert schedule.outcome is None
        schedule.not_taken()
        assert schedule.frames_due(25 * MS).counts == ((854,),)
        assert schedule.outcome == "late"

    def test_one_that_was_not_sent_and_began_a_gap(self):
        known = np.ones((40, 1), bool)
        known[5] = False
        schedule = Schedule(make_profile())
        schedule.feed(make_block(0, np.ones(5)))
        schedule.feed(make_block(5, np.ones(1), False))
        schedule.feed(make_block(6, np.ones(20)))
        assert sent(schedule, 6)[-2:] == [1000, 854]
        schedule.not_taken()
        assert sent(schedule, 5) == [854, 500, 146, 0, 146]

    def test_one_that_was_not_sent_at_the_edge_of_a_block(self):
        schedule = Schedule(make_profile())
        for first in (0, 5, 6, 7):
            schedule.feed(make_block(first, np.ones(1 if first else 5)))
        assert sent(schedule, 6)[-1] == 1000
        schedule.not_taken()
        assert sent(schedule, 2) == [1000, 1000]

    def test_one_that_came_after_others_left_out_over_such_edges(self):
        schedule = Schedule(make_profile())
        for first in range(0, 30, 5):
            schedule.feed(make_block(first, np.ones(5)))
        sent(schedule, 4)
        for now_ns in (8 * MS, 12 * MS):
            assert schedule.frames_due(now_ns).counts == ((1000,),)
            schedule.not_taken()
        assert schedule.frames_due(16 * MS).counts == ((1000,),)
        assert (schedule.counts.sent, schedule.counts.skipped) == (5, 12)

    def test_an_outcome_that_nobody_knows_stops_too(self):
        schedule = started(np.ones(50))
        with pytest.raises(ValueError, match="tuple"):
            schedule.stop("bored")
        assert schedule.state == "stopping"


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_scenes(scene):
    watch = scene(Watch)
    watch.stop()
    watch.run_to_end()


@given(st.lists(st.sampled_from(AWKWARD) | st.floats(), max_size=60))
def test_any_values(values):
    watch = Watch(make_profile(make_actuator(slew=1000), rate=Fraction(1000)))
    watch.feed(make_block(0, np.array(values, float), last=True))
    while watch.schedule.state != "ended":
        watch.tick(watch.schedule.next_ns)
    assert watch.sent <= len(values) + 10 + 4
