"""Many blocks in one call: the compiled loop is its readable twin, bit for bit, and refuses what it
was not made for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import predictors
from twins import built

from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.predicted import TABLE, Predictor, decode_indices
from hapfmt.deadband import Deadband
from hapfmt.encoder import live_many
from hapfmt.encoder.live_many import Missing, Shelf, Task, encode_block, encode_blocks
from hapfmt.encoder.predict import LIMITS
from hapfmt.encoder.quick import ORDERS, costs_of
from hapfmt.kernels import compiled

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
    blocks, tasks = [], []
    for _ in range(draw(st.integers(1, 5))):
        dtype = draw(st.sampled_from([np.int16, np.int32, np.int64]))
        top = min(np.iinfo(dtype).max, draw(st.sampled_from([3, 500, 2**15 - 1, 2**31 - 1])))
        g = np.random.default_rng(draw(st.integers(0, 99)))
        block = g.integers(-top - 1, top, size, endpoint=True)
        if draw(st.booleans()):
            block = block.cumsum() // 40
        if draw(st.booleans()):
            block[:] = block[0]
        blocks.append(np.clip(block, -top - 1, top).astype(dtype))
        low, high = draw(
            st.sampled_from([(-(2**31), 2**31 - 1), (-(2**23), 2**23 - 1), (-100, 400)])
        )
        way = draw(st.none() | predictors())
        if way is not None:
            way = Predictor(way.difference, way.reflections, 0, way.repeats, way.raw_signs)
            if way.coefficients is None:
                way = Predictor(1)
        tasks.append(
            Task(low, high, draw(st.sampled_from(GRIDS)), draw(st.sampled_from(BANDS)), way)
        )
    return blocks, tasks


def both(blocks, tasks):
    shelf = Shelf.empty()
    records = [shelf.record(task) for task in tasks]
    fast = encode_blocks(blocks, tasks, records, shelf)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(live_many, "compiled", None)
        assert encode_blocks(blocks, tasks, records, shelf) == fast
    return fast


class TestTwin:
    @given(jobs())
    def test_any_blocks(self, job):
        blocks, tasks = job
        for packet, block, task in zip(both(blocks, tasks), blocks, tasks, strict=True):
            if isinstance(packet, bytes):
                indices = decode_indices(packet, block.size, 2**32, 0)
                y = task.grid.counts(indices, 2**32)
                if task.grid == LpcParameters():
                    assert np.array_equal(y, block)
                if task.band:
                    y = np.clip(y, task.low, task.high)
                    assert not task.band.outside(block.astype(np.int64), y).any()
            elif packet is Missing.OUTSIDE:
                assert block.min() < task.low or block.max() > task.high
            else:
                assert packet in (Missing.NO_CODE, Missing.BROKEN)

    def test_every_outcome(self):
        x = np.array([5, 900, -3, 8] * 20, np.int16)
        whole = LpcParameters()
        tasks = [
            Task(-1000, 1000, whole, None, Predictor(1)),
            Task(-1000, 899, whole, None, Predictor(1)),
            Task(-1000, 1000, LpcParameters(50), Deadband(0, 1, (3,), (0,)), Predictor(1)),
            Task(-1000, 1000, whole, None, Predictor(4, (), 0)),
            Task(-1000, 1000, whole, None, None),
        ]
        found = both([x] * 5, tasks)
        assert found[1:3] == [Missing.OUTSIDE, Missing.BROKEN]
        assert all(isinstance(found[i], bytes) for i in (0, 3, 4))
        far = np.array([-(2**31), 2**31 - 1] * 20, np.int32)
        wide = Task(-(2**31), 2**31 - 1, whole, None, Predictor(4))
        assert both([far], [wide]) == [Missing.NO_CODE]

    def test_what_finds_no_room_is_left_out(self):
        """White noise of 32 bits beside a constant: packets are as large as their samples."""
        g = np.random.default_rng(0)
        noise = [g.integers(-(2**31), 2**31, 400).astype(np.int32) for _ in range(3)]
        task = Task(-(2**31), 2**31 - 1, LpcParameters(), None, Predictor(0))
        shelf = Shelf.empty()
        records = [shelf.record(task)] * 4
        found = encode_blocks([*noise, np.zeros(400, np.int32)], [task] * 4, records, shelf)
        assert Missing.FULL in found
        assert found[0] == encode_block(noise[0], task)
        assert isinstance(found[3], bytes)


def call(**changed):
    shelf = Shelf.empty()
    task = Task(-100, 100, LpcParameters(3, 0, 1, 10), Deadband(1, 10, (3,), (0,)), Predictor(1))
    given = {
        "blocks": [np.arange(50, dtype=np.int16)],
        "grids": shelf.levels,
        "tasks": shelf.record(task),
        "sines": TABLE,
        "limits": LIMITS,
        "costs": costs_of(50),
        "packets": np.empty(1000, np.uint8),
        "ends": np.empty(1, np.int64),
    }
    return compiled.encode_blocks(*(given | changed).values())


def record(**changed):
    """One task's numbers, by their places."""
    shelf = Shelf.empty()
    task = Task(-100, 100, LpcParameters(), None, Predictor(1))
    numbers = np.frombuffer(bytearray(shelf.record(task)), np.int64)
    for place, value in changed.items():
        numbers[int(place[1:])] = value
    return numbers.tobytes()


class TestRefused:
    def test_as_it_is(self):
        assert call() > 0

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
            {"tasks": record(_0=101)},
            {"tasks": record(_0=-(2**40))},
            {"tasks": record(_2=0)},
            {"tasks": record(_2=2**33)},
            {"tasks": record(_3=2**40)},
            {"tasks": record(_4=1)},
            {"tasks": record(_4=-2)},
            {"tasks": record(_5=5)},
            {"tasks": record(_6=33)},
            {"tasks": record(_7=1)},
            {"tasks": record(_8=65536)},
            {"tasks": record(_9=-1)},
            {"tasks": record(_10=-1)},
            {"tasks": record(_11=2**40)},
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
        broken = np.frombuffer(bytearray(record()), np.int64).copy()
        broken[6] = 1
        broken.view(np.int32)[24] = 2**30
        ends = np.empty(1, np.int64)
        call(tasks=broken.tobytes(), ends=ends)
        assert ends[0] == Missing.NO_CODE
