"""Stamps of messages become ticks, and come back: hapfmt.convert.timestamps."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from depth import deep
from hypothesis import example, given
from hypothesis import strategies as st
from test_timestamps import CASES, Publisher

from hapfmt.convert.timestamps import (
    Placed,
    align,
    observations,
    place,
    stamp_channel,
    stamps_of,
)
from hapfmt.errors import ParameterError

EPOCH = 1_700_000_000 * 10**9
ROWS = np.arange(20_000)


def nanoseconds(times: np.ndarray) -> np.ndarray:
    return EPOCH + np.round(np.asarray(times) * 1e9).astype(np.int64)


def delays(size: int = ROWS.size, deviation: float = 8e-5, seed: int = 0) -> np.ndarray:
    return np.abs(np.random.default_rng(seed).normal(0, deviation, size))


def true_rate(placed: Placed) -> float:
    return float(placed.rate) * (1 + placed.drift_ppm / 1e6)


@pytest.mark.parametrize("seed", range(4))
def test_a_bag_with_drift_a_loss_and_bursts(seed):
    """1 kHz, 40 ppm, 80 us of delay, 30 rows lost, bursts of 12: at most 0.5 % wrong ticks."""
    publisher = Publisher(seed=seed)
    ticks, times = publisher.messages()
    found = place(nanoseconds(times), name="/wrench")
    assert np.count_nonzero(found.ticks != ticks) <= 0.005 * len(ticks)
    [gap] = np.flatnonzero(np.diff(found.ticks) > 1)
    assert (found.ticks[gap], found.ticks[gap + 1]) == (6999, 7030)
    assert found.rate == 1000
    assert abs(true_rate(found) * publisher.period - 1) < 1e-6
    assert abs(found.start_ns - EPOCH - 0.055e6) < 0.02e6  # the median delay
    assert found.jitter_ns < 50_000
    moved, rate, missing = found.notes
    assert moved.startswith("/wrench: rows moved by up to 11.")
    assert "the rows come at 999.96" in rate
    assert missing == "/wrench: missing rows: 30, gaps: 1, longest gap: 30 rows"


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("rated", [False, True])
def test_cases(case, rated):
    publisher = CASES[case]
    ticks, times = publisher.messages()
    rate = Fraction(publisher.rate) if rated else None
    found = place(nanoseconds(times), name=case, rate=rate)
    assert np.count_nonzero(found.ticks != ticks) <= 0.005 * len(ticks)
    assert rate is None or found.rate == rate


RATES_OF_EIGHT_STAMPS = st.integers(1, 44_100).map(Fraction) | st.fractions(
    1, 1000, max_denominator=20
)
"""Eight stamps in whole ns may fit several of the rates that are finer than these."""


@given(
    rate=st.sampled_from([Fraction(n) for n in (1, 30, 240, 700, 1000, 3000, 44_100)])
    | RATES_OF_EIGHT_STAMPS,
    rows=st.integers(8, 300),
    lost=st.sets(st.integers(4, 300), max_size=2),
    start=st.integers(-(10**15), 2 * 10**18),
)
@example(rate=Fraction(71), rows=8, lost=set(), start=0)  # each step is 14 084 507 ns
def test_an_exact_grid_stays_exact(rate, rows, lost, start):
    ticks = np.array([n for n in range(rows) if n not in lost])
    stamps = np.array([start + n * 10**9 * rate.denominator // rate.numerator for n in ticks])
    found = place(stamps, name="grid")
    assert found.rate == rate
    assert found.ticks.tolist() == ticks.tolist()
    assert abs(found.start_ns - start) <= 1 and found.jitter_ns <= 1
    assert abs(found.drift_ppm) < 1e-9


@given(
    rows=st.integers(0, 400),
    rate=st.none() | st.integers(1, 2000).map(Fraction),
    jitter=st.floats(0, 3),
    numbered=st.booleans(),
    seed=st.integers(0, 2**32),
)
def test_ticks_increase_and_stamps_come_back(rows, rate, jitter, numbered, seed):
    generator = np.random.default_rng(seed)
    kept = np.flatnonzero(generator.random(rows) < 0.9)
    stamps = nanoseconds(1e-3 * (kept + generator.normal(0, jitter, kept.size)))
    try:
        found = place(stamps, name="any", rate=rate, sequence=kept if numbered else None)
    except ParameterError:
        return
    if found is None:
        return
    assert found.ticks[0] == 0 and (np.diff(found.ticks) > 0).all()
    assert found.ticks.dtype == np.int64 and found.ticks.shape == stamps.shape
    epoch_ns, [start] = align([found])
    values = stamp_channel(found, stamps, epoch_ns, start)
    assert (stamps_of(values, found.ticks + start, found.rate, epoch_ns) == stamps).all()


@given(
    rates=st.lists(st.fractions(Fraction(1, 100), 10**7, max_denominator=10**6), min_size=1),
    starts=st.lists(st.integers(0, 10**15), min_size=1),
)
def test_align_moves_by_at_most_half_a_tick(rates, starts):
    placed = [
        Placed(rate, np.array([0, 7]), EPOCH + start, (), 0, 0.0)
        for rate, start in zip(rates, starts, strict=False)
    ]
    epoch_ns, ticks = align(placed)
    assert epoch_ns == min(each.start_ns for each in placed) and min(ticks) == 0
    for each, tick in zip(placed, ticks, strict=True):
        assert abs(tick / each.rate * 10**9 - (each.start_ns - epoch_ns)) <= 10**9 / each.rate / 2


def test_stamps_of_two_clocks_are_not_aligned():
    far = Placed(Fraction(10**6), np.array([0, 7]), EPOCH, (), 0, 0.0)
    with pytest.raises(ParameterError, match="of several clocks"):
        align([far, far._replace(start_ns=0)])


def test_stamps_come_back_at_any_rate():
    rate = Fraction(10**18 + 1, 10**15)
    ticks = np.array([0, 1, 2**40])
    found = Placed(rate, ticks, EPOCH, (), 0, 0.0)
    stamps = EPOCH + np.array([5, -7, 2**62 - EPOCH])
    values = stamp_channel(found, stamps, EPOCH, 3)
    assert (stamps_of(values, ticks + 3, rate, EPOCH) == stamps).all()


def test_observations_of_a_clock():
    """The first row, the last, one a second, and both sides of each gap."""
    ticks = np.delete(np.arange(2500), slice(1200, 1300))
    stamps = EPOCH + ticks * 1_000_040
    found = place(stamps, name="/wrench", rate=Fraction(1000))
    seen = observations(found, stamps, "log", 5, "fx")
    assert [each.tick - 5 for each in seen] == [0, 1000, 1199, 1300, 2000, 2499]
    assert all(each.time_ns == EPOCH + (each.tick - 5) * 1_000_040 for each in seen)
    assert {(each.clock, each.channel) for each in seen} == {("log", "fx")}


class TestSequenceNumbers:
    """They count rows that were lost before they got a stamp, and rows that come very late."""

    @pytest.mark.parametrize("lost", [0.1, 0.5])
    def test_losses(self, lost):
        kept = np.flatnonzero(np.random.default_rng(0).random(ROWS.size) >= lost)
        stamps = nanoseconds(1e-3 * ROWS + delays(deviation=8e-4))[kept]
        found = place(stamps, name="x", sequence=kept.astype(np.uint32))
        assert (found.ticks == kept - kept[0]).all() and found.rate == 1000

    @pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32, np.int64])
    def test_wrap_around(self, kind):
        lost = np.delete(ROWS, slice(9000, 9100))
        numbers = (lost + 2**32 - 500) % 2**32
        stamps = nanoseconds(1e-3 * lost + delays(lost.size, 3e-4))
        found = place(stamps, name="x", sequence=numbers.astype(kind))
        assert (found.ticks == lost).all() and len(found.notes) == 2

    def test_a_publisher_that_begins_again(self):
        ticks = ROWS + 2000 * (ROWS > 8000)
        numbers = np.where(ROWS > 8000, ROWS - 8001, ROWS + 70)
        found = place(nanoseconds(1e-3 * ticks + delays()), name="x", sequence=numbers)
        assert (found.ticks == ticks).all()
        assert "begin again 1 times" in found.notes[0]

    def test_numbers_that_jump_without_time(self):
        numbers = ROWS + 10**6 * (ROWS > 8000)
        found = place(nanoseconds(1e-3 * ROWS + delays()), name="x", sequence=numbers)
        assert (found.ticks == ROWS).all()

    def test_a_constant_is_no_number(self):
        stamps = nanoseconds(1e-3 * ROWS + delays())
        found = place(stamps, name="x", sequence=np.zeros(ROWS.size, np.uint32))
        assert (found.ticks == ROWS).all()

    def test_numbers_that_repeat_are_left_out(self):
        stamps = nanoseconds(1e-3 * ROWS + delays())
        found = place(stamps, name="x", sequence=ROWS - (ROWS % 50 == 1))
        assert (found.ticks == ROWS).all()
        assert "repeat or go back" in found.notes[0]
        with pytest.raises(ParameterError, match="numbers come twice, so two publishers"):
            place(stamps, name="x", sequence=ROWS // 2)

    def test_of_two_publishers(self):
        both = np.repeat(ROWS[:500], 2) + 70 * (np.arange(1000) % 2)
        with pytest.raises(ParameterError, match=r"/wrench: .*two publishers .*in turn"):
            place(nanoseconds(5e-4 * np.arange(1000)), name="/wrench", sequence=both)

    @pytest.mark.parametrize("numbers", [ROWS[:5], ROWS[:6] / 2])
    def test_of_another_kind(self, numbers):
        with pytest.raises(ParameterError, match="one integer for each row"):
            place(nanoseconds(ROWS[:6]), name="x", sequence=numbers)


class TestClocksThatAreNotSteady:
    @pytest.mark.parametrize("amplitude", [2, *deep([0.5, 10])])
    def test_a_clock_that_wanders(self, amplitude):
        """By up to 210 ppm at 1 kHz; 30 rows are lost."""
        rows = np.arange(300_000)
        times = 1e-3 * (rows + amplitude * np.sin(4 * np.pi * rows / rows.size)) + delays(rows.size)
        kept = np.delete(rows, slice(150_000, 150_030))
        found = place(nanoseconds(times[kept]), name="x")
        assert (found.ticks == kept).all() and found.rate == 1000

    def test_a_clock_that_is_slewed(self):
        """By 500 ppm for 20 s."""
        rows = np.arange(100_000)
        times = 1e-3 * rows + 5e-7 * np.clip(rows - 40_000, 0, 20_000) + delays(rows.size)
        assert (place(nanoseconds(times), name="x", rate=Fraction(1000)).ticks == rows).all()

    @pytest.mark.parametrize("deviation", [0, 8e-5])
    def test_a_clock_that_is_set_back(self, deviation):
        times = 1e-3 * ROWS + delays(deviation=deviation) - 3 * (ROWS > 8000)
        found = place(nanoseconds(times), name="x")
        assert (found.ticks == ROWS).all()
        assert "went back by 2.99" in found.notes[0]

    def test_single_stamps_that_are_wrong(self):
        times = 1e-3 * ROWS + delays()
        times[500], times[900] = 0, -2
        assert (place(nanoseconds(times), name="x").ticks == ROWS).all()

    def test_a_device_that_pauses_between_ticks(self):
        found = place(nanoseconds(1e-3 * ROWS + 2.0005 * (ROWS > 8000) + delays()), name="x")
        steps = np.diff(found.ticks)
        assert steps[8000] in (2001, 2002) and np.count_nonzero(steps != 1) == 1

    def test_stamps_that_go_back_and_forth(self):
        with pytest.raises(ParameterError, match=r"x: .*two clocks"):
            place(nanoseconds(1e-3 * ROWS - 50 * (ROWS % 2)), name="x")


@pytest.mark.parametrize(
    "rates", [(1000, 1000), (1000, 1000, 1001), *deep([(1000, 1000.05), (1000, 999)])]
)
def test_publishers_in_turn_are_refused(rates):
    times = [
        Publisher(rate=rate, jitter=0.02, bursts=0, lost=(), seed=n).messages()[1] + n * 0.0003
        for n, rate in enumerate(rates)
    ]
    stamps = nanoseconds(np.sort(np.concatenate(times)))
    with pytest.raises(ParameterError, match=f"/wrench: .*from {len(rates)} sources in turn"):
        place(stamps, name="/wrench")
    both = place(stamps, name="/wrench", rate=Fraction(1000 * len(rates)))
    assert both.rate == 1000 * len(rates)


@pytest.mark.parametrize("rows", [10, 100, 1000])
@pytest.mark.parametrize("numbered", [False, True])
def test_bursts_with_equal_stamps_need_a_rate(rows, numbered):
    """A device that hands over 12 rows at a time."""
    stamps = nanoseconds(1e-3 * (np.arange(rows) // 12 * 12))
    sequence = np.arange(rows) if numbered else None
    if rows < 64:
        assert place(stamps, name="x", sequence=sequence) is None
    else:
        with pytest.raises(ParameterError, match=r"give a rate \(rate=\)"):
            place(stamps, name="x", sequence=sequence)
    found = place(stamps, name="x", sequence=sequence, rate=Fraction(1000))
    assert (found.ticks == np.arange(rows)).all()


@pytest.mark.parametrize("rows", [3, 10, 30, 100, 1000, *deep([20_000])])
@pytest.mark.parametrize("numbered", [False, True])
def test_random_times_are_events(rows, numbered):
    sequence = np.arange(rows) if numbered else None
    for seed in range(5):
        times = np.cumsum(np.random.default_rng(seed).exponential(1e-3, rows))
        assert place(nanoseconds(times), name="x", sequence=sequence) is None


def test_few_rows():
    assert place([], name="x") is None and place([], name="x", rate=Fraction(10)) is None
    assert place([EPOCH, EPOCH + 10**9], name="x") is None
    assert place([EPOCH, EPOCH, EPOCH], name="x") is None
    assert place([EPOCH], name="x", rate=Fraction(10)) == Placed(
        Fraction(10), np.array([0]), EPOCH, (), 0, 0.0
    )
    jittering = nanoseconds([0, 0.1, 0.21, 0.3, 0.39, 0.5, 0.6, 0.7])
    assert place(jittering[:7], name="x") is None
    assert place(jittering, name="x").rate == 10


def test_equal_stamps_need_another_clock():
    with pytest.raises(ParameterError, match="the last time is not after the first"):
        place(np.zeros(100, np.int64), name="x")
    with pytest.raises(ParameterError, match="do not fit a rate of 10 Hz"):
        place(np.zeros(1000, np.int64), name="x", rate=Fraction(10))
