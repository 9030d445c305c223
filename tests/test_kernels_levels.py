"""Levels of a deadband grid: the compiled loop is its readable twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import built

from hapfmt.codecs import predicted
from hapfmt.codecs.grids import LEVELS_LIMIT, LpcParameters, deadband_levels
from hapfmt.kernels import compiled

ratios = st.sampled_from([(1, 10), (1, 1), (2, 1), (65535, 65534), (65534, 65535), (300, 301)])
bounds = st.sampled_from([0, 1, 2**24, 2**32 - 1, 2**32]) | st.integers(0, 2**20)
steps = st.sampled_from([0, 1, 20, 2**24, 2**31]) | st.integers(0, 100)


def both(grid, bound):
    levels = deadband_levels.__wrapped__
    fast = levels(grid, bound)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(predicted, "compiled", None)
        slow = levels(grid, bound)
    return fast, slow


def assert_same(grid, bound):
    fast, slow = both(grid, bound)
    assert [row.dtype for row in fast] == [np.int64, np.int64]
    assert [row.tolist() for row in fast] == [row.tolist() for row in slow]
    return fast


@built
class TestTwins:
    @given(steps, ratios, bounds)
    def test_any_grid(self, step, ratio, bound):
        assert_same(LpcParameters(step, 0, *ratio), bound)

    @pytest.mark.parametrize("ratio", [(1, 1024), (64, 65535), (63, 64000), (1, 1000)])
    def test_the_finest(self, ratio):
        levels, _ = assert_same(LpcParameters(0, 0, *ratio), 2**32)
        assert levels.size < LEVELS_LIMIT


ROWS = np.zeros(4, np.int64), np.zeros(4, np.int64)


@built
class TestArguments:
    def test_no_room(self):
        assert compiled.deadband_levels(1, 1, 10, 4, *ROWS) == 2
        assert compiled.deadband_levels(1, 1, 10, 2**32, *ROWS) == -1

    @pytest.mark.parametrize(
        "wrong",
        [
            (-1, 1, 10, 9), (2**32 + 1, 1, 10, 9), (1, 0, 10, 9), (1, 65536, 10, 9), (1, 1, 0, 9),
            (1, 1, 65536, 9), (1, 1, 10, -1), (1, 1, 10, 2**32 + 1),
        ],
    )  # fmt: skip
    def test_no_grid(self, wrong):
        with pytest.raises(ValueError, match="not a deadband"):
            compiled.deadband_levels(*wrong, *ROWS)
        with pytest.raises(ValueError, match="two equal rows"):
            compiled.deadband_levels(1, 1, 10, 9, ROWS[0], ROWS[1][:3].copy())
