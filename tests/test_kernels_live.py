"""Many blocks in one call: the compiled loop is its readable twin, bit for bit, and refuses what it
was not made for."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import predictors
from twins import built

from hapfmt.codecs import knots, knots_coded, predicted
from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.knots import INTERPOLATIONS, KnotParameters
from hapfmt.codecs.knots_coded import decode_coded_knots
from hapfmt.codecs.predicted import TABLE, Predictor, decode_indices
from hapfmt.deadband import Deadband
from hapfmt.encoder import live_many, predict, quick, tube
from hapfmt.encoder.grids import grid_within
from hapfmt.encoder.live_many import (
    QUICK,
    How,
    Job,
    Missing,
    Shelf,
    Task,
    encode_blocks,
    habit_of,
    predictor_of,
)
from hapfmt.encoder.predict import LIMITS
from hapfmt.encoder.quick import ORDERS, costs_of
from hapfmt.encoder.tubed import HALF
from hapfmt.encoder.unit import Bound
from hapfmt.kernels import compiled
from hapfmt.limits import LEVELS

pytestmark = built

GRIDS = (
    LpcParameters(),
    LpcParameters(1, 5),
    LpcParameters(7, -3),
    LpcParameters(2**24 - 1),
    LpcParameters(3, 100, 1, 10),
    LpcParameters(0, -7, 1, 1000),
    LpcParameters(2, 2**20, 3, 2),
)
BANDS = (None, Deadband(1, 10, (4,), (0,)), Deadband(0, 1, (3,), (0,)))


@st.composite
def jobs(draw):
    size = draw(st.sampled_from([1, 2, 31, 32, 33, 300]))
    rows = []
    for _ in range(draw(st.integers(1, 5))):
        dtype = draw(st.sampled_from([np.int16, np.int32, np.int64]))
        top = min(np.iinfo(dtype).max, draw(st.sampled_from([3, 500, 2**15 - 1, 2**31 - 1])))
        g = np.random.default_rng(draw(st.integers(0, 99)))
        block = g.integers(-top - 1, top, size, endpoint=True)
        if draw(st.booleans()):
            block = block.cumsum() // 40
        if draw(st.booleans()):
            block[:] = block[0]
        block = np.clip(block, -top - 1, top).astype(dtype)
        low, high = draw(
            st.sampled_from([(-(2**31), 2**31 - 1), (-(2**23), 2**23 - 1), (-100, 400)])
        )
        task = Task(low, high, draw(st.sampled_from(GRIDS)), draw(st.sampled_from(BANDS)))
        if draw(st.booleans()):
            task = knots_task(draw, low, high)
        quick = draw(st.booleans())
        way = draw(predictors())
        way = replace(way, base=0, references=())
        if way.coefficients is None:
            way = Predictor(1)
        how = How.GIVEN if quick else draw(st.sampled_from(How))
        rows.append(job(block, task, None if quick else way, how))
    return rows


def knots_task(draw, low, high):
    """Whose grid has a value within the tube of every count."""
    slack = draw(st.sampled_from([0, 1, 3, 200]))
    ratio = draw(st.sampled_from([Fraction(0), Fraction(1, 10), Fraction(1, 2), Fraction(3, 2)]))
    zero = draw(st.sampled_from([0, 0, 77, -(2**20)]))
    band = Deadband(ratio.numerator, ratio.denominator, (max(slack, 1),), (zero,))
    joined = draw(st.sampled_from(INTERPOLATIONS))
    part = HALF if joined == "linear" else Fraction(1)
    return Task(low, high, grid_within(Bound(band, slack), part), band, joined, slack)


def job(block, task, predictor, how=How.GIVEN):
    """Its record follows from the grids of all, and is put in last; no predictor: a quick one is
    looked for."""
    habit = QUICK if predictor is None else habit_of(predictor)
    return Job(block, task, b"", habit, how)


def both(rows):
    shelf = Shelf()
    rows = [replace(row, record=shelf.record(row.task)) for row in rows]
    fast = encode_blocks(rows, shelf)
    with pytest.MonkeyPatch.context() as patch:
        for module in (live_many, predict, predicted, quick, tube, knots_coded, knots):
            patch.setattr(module, "compiled", None)
        assert encode_blocks(rows, shelf) == fast
    return fast


WHOLE = LpcParameters()


class TestTwin:
    @given(jobs())
    def test_any_blocks(self, rows):
        for (packet, habit), row in zip(both(rows), rows, strict=True):
            block, task = row.block, row.task
            if row.how is How.GIVEN or task.knots:
                assert habit == row.habit
            if task.knots and isinstance(packet, bytes):
                parameters = KnotParameters(task.knots, task.grid, coded=True)
                y = decode_coded_knots(packet, parameters, block.size, 1, LEVELS[2], 0)[:, 0]
                y = np.clip(y, task.low, task.high)
                assert not task.band.outside(block.astype(np.int64), y).any()
                continue
            if isinstance(packet, bytes):
                indices = decode_indices(packet, block.size, 2**32, 0)
                y = task.grid.counts(indices, 2**32)
                if task.grid == WHOLE:
                    assert np.array_equal(y, block)
                if task.band:
                    y = np.clip(y, task.low, task.high)
                    assert not task.band.outside(block.astype(np.int64), y).any()
            elif packet is Missing.OUTSIDE:
                assert block.min() < task.low or block.max() > task.high
            else:
                assert packet in (Missing.NO_CODE, Missing.BROKEN)

    @given(st.sampled_from([900, 1800, 7000]), st.integers(0, 30), st.sampled_from(How))
    @settings(max_examples=12)
    def test_signals(self, size, seed, how):
        """That predictors of several orders serve best, of short packets and of long ones, in which
        the estimate looks at a part."""
        g, t = np.random.default_rng(seed), np.arange(size)
        rows = [
            np.round(900 * np.sin(t / (3 + seed)) + g.normal(0, 3, size)),
            np.round(3e4 * np.sin(t / 200) + g.normal(0, 0.3, size)),
            g.normal(0, 0.1, size).cumsum().round(),
            np.repeat(g.integers(-9, 9, size // 10 + 1), 10)[:size],
            g.integers(-(2**20), 2**20, size),
        ]
        task = Task(-(2**23), 2**23 - 1, WHOLE, None)
        before = Predictor(1, (60, -20, 11))
        found = both([job(x.astype(np.int32), task, before, how) for x in rows])
        if how:
            ways = [predictor_of(habit) for _, habit in found]
            assert len(set(ways)) > 3
            assert any(way.repeats for way in ways)

    def test_the_one_before_is_kept_where_it_does_better(self):
        g = np.random.default_rng(1)
        x = np.round(900 * np.sin(np.arange(400) / 9) + g.normal(0, 3, 400)).astype(np.int32)
        task = Task(-(2**23), 2**23 - 1, WHOLE, None)
        ((packet, habit),) = both([job(x, task, Predictor(), How.LOOK)])
        shifted = np.roll(x, 1)
        given, beside, alone = both([
            job(shifted, task, predictor_of(habit), How.GIVEN),
            job(shifted, task, predictor_of(habit), How.LOOK_BESIDE),
            job(shifted, task, Predictor(), How.LOOK),
        ])  # fmt: skip
        assert len(beside[0]) == min(len(given[0]), len(alone[0])) <= len(packet) + 9

    def test_every_outcome(self):
        x = np.array([5, 900, -3, 8] * 20, np.int16)
        rows = [
            job(x, Task(-1000, 1000, WHOLE, None), Predictor(1)),
            job(x, Task(-1000, 899, WHOLE, None), Predictor(1)),
            job(x, Task(-1000, 1000, LpcParameters(50), Deadband(0, 1, (3,), (0,))), Predictor(1)),
            job(x, Task(-1000, 1000, WHOLE, None), Predictor(4)),
            job(x, Task(-1000, 1000, WHOLE, None), None),
        ]
        found = [packet for packet, _ in both(rows)]
        assert found[1:3] == [Missing.OUTSIDE, Missing.BROKEN]
        assert all(isinstance(found[i], bytes) for i in (0, 3, 4))
        far = np.array([-(2**31), 2**31 - 1] * 20, np.int32)
        wide = Task(-(2**31), 2**31 - 1, WHOLE, None)
        assert both([job(far, wide, Predictor(4))])[0][0] is Missing.NO_CODE
        beside = both([job(far, wide, Predictor(4), How.LOOK_BESIDE)])[0][0]
        assert np.array_equal(decode_indices(beside, 40, 2**32, 0), far)

    def test_what_finds_no_room_is_made_alone(self):
        """White noise of 32 bits: packets are larger than what there is room for at first."""
        g = np.random.default_rng(0)
        noise = [g.integers(-(2**31), 2**31, 400).astype(np.int32) for _ in range(3)]
        task = Task(-(2**31), 2**31 - 1, WHOLE, None)
        rows = [job(x, task, Predictor()) for x in [*noise, np.zeros(400, np.int32)]]
        found = both(rows)
        assert all(isinstance(packet, bytes) for packet, _ in found)
        assert sum(len(packet) for packet, _ in found) > 4 * (2 * 400 + 64)


def call(**changed):
    shelf = Shelf()
    task = Task(-100, 100, LpcParameters(3, 0, 1, 10), Deadband(1, 10, (3,), (0,)))
    record = shelf.record(task)
    given = {
        "blocks": [np.arange(50, dtype=np.int16)],
        "grids": shelf.levels,
        "tasks": record,
        "habits": bytearray(habit_of(Predictor(1))),
        "hows": b"\0",
        "sines": TABLE,
        "limits": LIMITS,
        "costs": costs_of(50),
        "packets": np.empty(1000, np.uint8),
        "ends": np.empty(1, np.int64),
    }
    return compiled.encode_blocks(*(given | changed).values())


def record(place, value):
    """A task with another number at one place."""
    numbers = np.frombuffer(Task(-100, 100, WHOLE, None).record(-1), np.int64).copy()
    numbers[place] = value
    return numbers.tobytes()


def habit(place, value):
    numbers = np.frombuffer(bytearray(habit_of(Predictor(1))), np.int32)
    numbers[place] = value
    return bytearray(numbers.tobytes())


def packets_of(x, task, dtype=np.int64):
    ((packet, _),) = both([job(np.array(x, dtype), task, Predictor(1))])
    return packet


class TestEdges:
    """One count within a bound, and one beyond."""

    @pytest.mark.parametrize("dtype", [np.int16, np.int32, np.int64])
    def test_the_declared_range(self, dtype):
        x = [-100, 0, 99] * 5
        assert isinstance(packets_of(x, Task(-100, 99, WHOLE, None), dtype), bytes)
        for low, high in ((-99, 99), (-100, 98)):
            assert packets_of(x, Task(low, high, WHOLE, None), dtype) is Missing.OUTSIDE

    @pytest.mark.parametrize("knots", [None, *INTERPOLATIONS])
    def test_counts_are_clamped_to_the_range(self, knots):
        """The grid's values are 105 and -105; a decoder makes 100 and -100 of them."""
        task = Task(-100, 100, LpcParameters(15), Deadband(0, 1, (1,), (0,)), knots, 7)
        for x in ([0, 99], [0, 100], [0, -99], [0, -100]):
            assert isinstance(packets_of(np.repeat(x, 9), task), bytes)
        for x in ([0, 98], [0, -98]):
            assert packets_of(np.repeat(x, 9), task) is Missing.BROKEN

    @pytest.mark.parametrize("knots", [None, "hold"])
    def test_a_tenth_of_the_count_and_no_more(self, knots):
        task = Task(-1000, 1000, LpcParameters(90), Deadband(1, 10, (1,), (0,)), knots, 11)
        assert isinstance(packets_of(np.repeat([0, 100], 9), task), bytes)
        assert packets_of(np.repeat([0, 101], 9), task) is Missing.BROKEN

    @pytest.mark.parametrize("knots", [None, *INTERPOLATIONS])
    def test_the_first_and_the_last_cell(self, knots):
        grid, band = LpcParameters(3, 0, 1, 10), Deadband(1, 5, (3,), (0,))
        task = Task(-1000, 1000, grid, band, knots, 3)
        assert isinstance(packets_of(np.repeat([-1000, 1000], 9), task), bytes)

    @pytest.mark.parametrize("knots", [None, *INTERPOLATIONS])
    def test_quotients_that_a_product_misses(self, knots):
        """As a double 49 times 1 / 49 is less than 1."""
        assert 49 * (1 / 49) < 1
        band = Deadband(0, 1, (98,), (0,))
        for step in (49, 98):
            task = Task(-(1 << 20), 1 << 20, LpcParameters(step), band, knots, step)
            assert isinstance(packets_of(np.arange(-490, 491, 49), task), bytes)

    def test_indices_of_33_bits(self):
        far = 1 << 32
        for x in ([far, 0], [0, far], [-far, 0], [0, -far]):
            task = Task(-far, far, WHOLE, None)
            assert isinstance(packets_of(x * 9, task), bytes)
            beyond = replace(task, grid=LpcParameters(1, -1 if max(x) else 1))
            assert packets_of(x * 9, beyond) is Missing.NO_CODE

    @pytest.mark.parametrize("knots", INTERPOLATIONS)
    @pytest.mark.parametrize("slack", [0, 3])
    def test_knots_of_33_bits(self, knots, slack):
        """2^32 from the zero of the grid."""
        far, band = (1 << 32) - 1, Deadband(0, 1, (4,), (0,))
        for x, zero in (([far - 40, far], -1), ([far], -1), ([-far, 40 - far], 1), ([-far], 1)):
            task = Task(-far, far, LpcParameters(1, zero), band, knots, slack)
            assert isinstance(packets_of(np.repeat(x, 9), task), bytes)

    @pytest.mark.parametrize("knots", INTERPOLATIONS)
    @pytest.mark.parametrize("top", [2, 3])
    def test_knots_lie_between_the_least_and_the_largest_count(self, knots, top):
        task = Task(-100, 100, WHOLE, Deadband(0, 1, (6,), (0,)), knots, 5)
        packet = packets_of(np.repeat([0, top], 9), task)
        parameters = KnotParameters(knots, WHOLE, coded=True)
        y = decode_coded_knots(packet, parameters, 18, 1, LEVELS[2], 0)[:, 0]
        assert set(y.tolist()) == {top // 2}

    @pytest.mark.parametrize("knots", INTERPOLATIONS)
    @pytest.mark.parametrize("step", [6, 7, 8])
    def test_the_slack_is_that_of_the_task(self, knots, step):
        """Counts at 0 and ``step``: within 3 of each other up to 6."""
        task = Task(-100, 100, WHOLE, Deadband(0, 1, (4,), (0,)), knots, 3)
        packet = packets_of(np.repeat([0, step], 9), task)
        parameters = KnotParameters(knots, WHOLE, coded=True)
        y = decode_coded_knots(packet, parameters, 18, 1, LEVELS[2], 0)[:, 0]
        assert (len(set(y.tolist())) == 1) is (step == 6)


class TestRefused:
    def test_as_it_is(self):
        assert call() > 0

    @pytest.mark.parametrize(
        ("place", "most", "sign"),
        [
            (0, 1 << 32, -1), (1, 1 << 32, 1), (2, (1 << 32) - 1, 1), (3, 1 << 32, 1),
            (3, 1 << 32, -1), (5, 65535, 1), (6, 65535, 1), (7, 1 << 32, 1), (8, 1 << 32, 1),
            (8, 1 << 32, -1), (10, 1 << 32, 1),
        ],
    )  # fmt: skip
    def test_the_widest_tasks(self, place, most, sign):
        call(tasks=record(place, sign * most))
        with pytest.raises(ValueError, match="not blocks of equal length"):
            call(tasks=record(place, sign * (most + 1)))

    @pytest.mark.parametrize("habits", [habit(0, 4), habit(1, 32)])
    def test_the_largest_habits(self, habits):
        call(habits=habits)

    def test_the_largest_tables(self):
        sines, far = TABLE.copy(), 1 << 33
        sines[-1] = 32767
        call(sines=sines, grids=[np.array([[0, far], [5, 9]])])
        for wrong in ({"sines": sines + 1}, {"grids": [np.array([[0, far + 1], [5, 9]])]}):
            with pytest.raises(ValueError, match="not blocks of equal length"):
                call(**wrong)
        habits = habit(1, 1)
        habits[-32] = 256 - 127
        call(habits=habits)

    @pytest.mark.parametrize(
        "changed",
        [
            {"blocks": []},
            {"blocks": (np.arange(50, dtype=np.int16),)},
            {"blocks": [np.arange(0, dtype=np.int16)]},
            {"blocks": [np.arange(50, dtype=np.uint16)]},
            {"blocks": [np.arange(50, dtype=np.int8)]},
            {"blocks": [np.arange(50, dtype=">i2")]},
            {"blocks": [np.arange(50, dtype=np.float64)]},
            {"blocks": [np.zeros((5, 10), np.int16)]},
            {"blocks": [np.arange(50, dtype=np.int16)] * 2},
            {"grids": []},
            {"grids": [np.zeros(3, np.int64)]},
            {"grids": [np.ones((2, 4), np.int64)]},
            {"grids": [np.array([[0, 5], [9, 3]])]},
            {"grids": ()},
            {"tasks": b""},
            {"tasks": record(0, 101)},
            {"tasks": record(0, -(2**40))},
            {"tasks": record(2, 0)},
            {"tasks": record(2, 2**33)},
            {"tasks": record(3, 2**40)},
            {"tasks": record(4, 1)},
            {"tasks": record(4, -2)},
            {"tasks": record(5, 65536)},
            {"tasks": record(6, -1)},
            {"tasks": record(7, -1)},
            {"tasks": record(8, 2**40)},
            {"tasks": record(9, 3)},
            {"tasks": record(9, 1)},
            {"tasks": record(10, -1)},
            {"habits": bytearray()},
            {"habits": habit(0, 5)},
            {"habits": habit(0, -1)},
            {"habits": habit(1, 33)},
            {"habits": habit(2, 1)},
            {"habits": habit(2, 128 | 8)},
            {"hows": b""},
            {"hows": b"\3"},
            {"sines": TABLE[1:]},
            {"sines": -TABLE},
            {"limits": LIMITS[1:]},
            {"costs": np.ones(ORDERS - 1)},
            {"ends": np.empty(2, np.int64)},
        ],
    )
    def test_what_it_was_not_made_for(self, changed):
        with pytest.raises(ValueError, match="not blocks of equal length"):
            call(**changed)

    def test_rows_with_holes(self):
        with pytest.raises((ValueError, BufferError)):
            call(blocks=[np.arange(100, dtype=np.int16)[::2]])

    def test_a_predictor_out_of_range_makes_no_packet(self):
        wrong = habit(1, 1)
        wrong[16:20] = (2**30).to_bytes(4, "little")
        ends = np.empty(1, np.int64)
        call(habits=wrong, ends=ends)
        assert ends[0] == Missing.NO_CODE
        wrong = habit(1, 1)
        wrong[-32] = 128
        with pytest.raises(ValueError, match="not blocks of equal length"):
            call(habits=wrong)
