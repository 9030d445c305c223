"""Knots in a tube: the compiled loops are their readable twins, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_tube import random_tube, tubes
from twins import built

from hapfmt.codecs.grids import LpcParameters
from hapfmt.encoder import tube
from hapfmt.encoder import tube as module
from hapfmt.encoder.gridded import levels_of
from hapfmt.encoder.tube import COUNT_BOUND, fewest_hold, fewest_linear, joined_places
from hapfmt.errors import ParameterError
from hapfmt.kernels import compiled

scales = st.sampled_from([1, 2**11, 2**26, 2**31])


steps = st.sampled_from([1, 2, 7, 1000])
deadbands = st.builds(
    LpcParameters,
    st.sampled_from([0, 1, 6, 400]),
    st.sampled_from([0, -7, 100, 2**31 - 1]),
    st.sampled_from([1, 3]),
    st.sampled_from([2, 10, 200]),
)


def found(find, *given):
    """Knots, or the reason why there are none."""
    try:
        return find(*given)
    except ParameterError as error:
        return str(error)


def compared(fast, slow):
    """The knots, or None where both say why there are none."""
    if isinstance(slow, str):
        assert fast == slow
        return None
    for a, b in zip(fast, slow, strict=True):
        assert a.dtype == b.dtype == np.int64
        assert a.tolist() == b.tolist()
    return fast


def assert_same(find, lower, upper, *grid):
    fast = found(find, lower, upper, *grid)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "compiled", None)
        slow = found(find, lower, upper, *grid)
    return compared(fast, slow)


@built
@pytest.mark.parametrize("find", [fewest_hold, fewest_linear])
class TestTwins:
    @given(tube=tubes(), scale=scales)
    def test_small_tubes(self, find, tube, scale):
        far = COUNT_BOUND // scale
        lower, upper = (np.clip(bound, -far, far) * scale for bound in tube)
        assert_same(find, lower, upper)

    @pytest.mark.parametrize("kind", ["noise", "walk", "exact", "thin", "smooth", "weber"])
    def test_random_tubes(self, find, kind):
        rng = np.random.default_rng(3)
        for _ in range(60):
            assert_same(find, *random_tube(rng, kind))

    def test_places_with_one_between_that_no_line_reaches(self, find):
        """They are two runs of places, not one."""
        lower = np.array([3, 5, -5, -4, -14, -22, -14])
        upper = np.array([11, 8, 2, 1, -11, -13, -7])
        knots = assert_same(find, lower, upper)
        grid = range(-22, 12)
        assert knots is not None and (find is fewest_hold or inside(lower, upper, knots, grid))

    @pytest.mark.parametrize("width", [0, 1, 3, 40, 2000])
    def test_long_tubes(self, find, width):
        """Long links, long ones beside short ones, and values that no whole count reaches."""
        rng = np.random.default_rng(width)
        n = 4000
        slow = np.interp(
            np.arange(n), np.arange(0, n + 99, 100), rng.integers(-3000, 3000, n // 100 + 1)
        )
        for x in (
            slow,
            slow + rng.normal(0, width / 2, n),
            np.arange(n) / 97,
            1e5 * np.sin(np.arange(n) / 200),
        ):
            counts = np.rint(x).astype(np.int64)
            assert_same(find, counts - width, counts + width)

    def test_as_wide_and_as_steep_as_can_be(self, find):
        ends = np.array([-COUNT_BOUND, COUNT_BOUND])
        for size in (1, 2, 3, 17, 400):
            x = np.resize(ends, size)
            assert_same(find, x, x)
            assert_same(find, np.full(size, -COUNT_BOUND), np.full(size, COUNT_BOUND))
            ramp = np.linspace(-COUNT_BOUND, COUNT_BOUND, size).astype(np.int64)
            assert_same(find, np.maximum(ramp - 5, -COUNT_BOUND), np.minimum(ramp + 5, COUNT_BOUND))


def inside(lower, upper, knots, grid):
    """Values of the grid, and lines within the tube at every tick: the sum of SPEC 9.1."""
    ticks, values = (row.tolist() for row in knots)
    assert set(values) <= set(grid if isinstance(grid, range) else grid.tolist())
    if len(ticks) == 1:
        return bool((lower <= values[0]).all() and (values[0] <= upper).all())
    y = [
        v0 + (2 * (v1 - v0) * (t - t0) + t1 - t0) // (2 * (t1 - t0))
        for t0, t1, v0, v1 in zip(ticks, ticks[1:], values, values[1:], strict=False)
        for t in range(t0, t1)
    ]
    y.append(values[-1])
    return bool((lower <= np.array(y)).all() and (np.array(y) <= upper).all())


@built
class TestGrids:
    @given(tubes(), scales, steps, st.integers(-1100, 1100), st.sampled_from([0, 0, 1, 50]))
    def test_uniform(self, tube, scale, step, start, wider):
        """Each value of a grid, or a part of its values only: then there may be none."""
        lower = np.clip(tube[0] * scale - step // 2, -COUNT_BOUND, COUNT_BOUND)
        upper = np.clip(tube[1] * scale + step // 2, -COUNT_BOUND, COUNT_BOUND)
        first = int(lower.min()) + start // (1 + wider) - step * wider
        grid = range(first, max(int(upper.max()), first) + 1 + step * wider, step)
        knots = assert_same(fewest_linear, lower, upper, grid)
        if wider and knots is not None and upper.max() - lower.min() < 10**6:
            assert inside(lower, upper, knots, grid)

    @given(tubes(), st.sampled_from([1, 2**6, 2**11]), deadbands, st.sampled_from([-1, 0, 1, 30]))
    def test_deadband(self, tube, scale, grid, wider):
        """A tube of each count's deadband, narrower or wider."""
        x = np.clip(tube[0], -(2**20), 2**20) * scale
        width = np.maximum(grid.kn * np.abs(x - grid.zero) // grid.kd, grid.step) + wider
        lower, upper = x - np.maximum(width, 0), x + np.maximum(width, 0)
        _, levels = levels_of(x, grid)
        knots = assert_same(fewest_linear, lower, upper, levels)
        if knots is not None:
            assert inside(lower, upper, knots, levels)

    @pytest.mark.parametrize("kind", ["noise", "walk", "exact", "thin", "smooth", "weber"])
    def test_random_tubes(self, kind):
        rng = np.random.default_rng(5)
        for _ in range(40):
            lower, upper = random_tube(rng, kind)
            for step in (2, 3, 5):
                grid = range(int(lower.min()) - step, int(upper.max()) + step, step)
                assert_same(fewest_linear, lower - step // 2, upper + step // 2, grid)
            levels = np.unique(rng.integers(lower.min(), upper.max() + 1, 30))
            assert_same(fewest_linear, lower, upper, levels)

    @pytest.mark.parametrize("step", [1, 2, 7, 1000, 2**31, 2**32])
    def test_as_wide_as_can_be(self, step):
        """2**33 values, of which no list is made."""
        grid = range(-COUNT_BOUND, COUNT_BOUND + 1, step)
        for size in (2, 3, 17, 400):
            x = np.resize(np.array([-COUNT_BOUND, COUNT_BOUND]), size)
            assert_same(fewest_linear, x, x, grid)
            ramp = np.linspace(-COUNT_BOUND, COUNT_BOUND, size).astype(np.int64)
            assert_same(fewest_linear, ramp - step, ramp + step, grid)
            assert_same(fewest_linear, ramp - step // 2, ramp + step // 2, grid[::2])

    @pytest.mark.parametrize("bound", [COUNT_BOUND, 2**34])
    def test_listed_extremes(self, bound):
        levels = np.array([-bound, -COUNT_BOUND, -1, 0, 5, COUNT_BOUND, bound])
        levels = np.unique(levels)
        for size in (1, 2, 3, 17, 400):
            x = np.resize(levels[1:-1], size)
            assert_same(fewest_linear, x, x, levels)
            assert_same(fewest_linear, x - 2**31, x + 2**31, levels)

    @pytest.mark.parametrize("grid", [range(3, 9), range(0, 2)])
    def test_a_grid_that_ends_one_beside_the_tube(self, grid):
        with pytest.raises(ParameterError, match="a value of the grid at every tick"):
            fewest_linear(np.array([0, 2]), np.array([3, 2]), grid)

    @pytest.mark.parametrize("grid", [range(0), range(4, 9), range(0, 9, 3), np.array([0, 3, 9])])
    def test_no_value_within_the_tube(self, grid):
        with pytest.raises(ParameterError, match="a value of the grid at every tick"):
            fewest_linear(np.array([0, 2, 1]), np.array([3, 2, 1]), grid)

    @pytest.mark.parametrize(
        ("first", "step", "count", "levels"),
        [
            (0, 0, 1, []),
            (0, -1, 1, []),
            (0, 1, 0, []),
            (2**34 + 1, 1, 1, []),
            (-(2**34) - 1, 1, 1, []),
            (0, 1, 2**34 + 2, []),
            (-(2**34), 2**63 - 1, 2, []),
            (0, 1, 2, [0]),
            (0, 1, -1, [0]),
            (0, 1, 2**61 + 1, [0]),
            (0, 1, 2, [0, 0]),
            (0, 1, 2, [1, 0]),
            (0, 1, 1, [2**34 + 1]),
            (0, 1, 1, [-(2**34) - 1]),
        ],
    )
    def test_what_is_no_grid_is_refused(self, first, step, count, levels):
        row, table = np.zeros(2, np.int64), np.array(levels, np.int64)
        with pytest.raises(ValueError, match="not a tube"):
            compiled.fewest_linear(row, row, first, step, count, table, row.copy(), row.copy())

    def test_levels_of_other_sizes_are_refused(self):
        row = np.zeros(2, np.int64)
        with pytest.raises(ValueError, match="not a tube"):
            compiled.fewest_linear(row, row, 0, 1, 1, bytes(9), row.copy(), row.copy())


def joined_alike(axes, grids):
    with pytest.MonkeyPatch.context() as patch:
        fast = found(joined_places, axes, grids)
        patch.setattr(tube, "compiled", None)
        slow = found(joined_places, axes, grids)
    return compared(fast, slow)


@built
class TestVectors:
    @given(st.lists(tubes(), min_size=1, max_size=4), steps, st.sampled_from([0, 0, 1]), scales)
    def test_small_tubes(self, axes, step, wider, scale):
        size = min(lower.size for lower, _ in axes)
        far = COUNT_BOUND // scale
        sides, grids = [], []
        for low, high in axes:
            lower = np.clip(low[:size], -far, far) * scale - step // 2
            upper = np.clip(high[:size], -far, far) * scale + step // 2
            lower, upper = np.maximum(lower, -COUNT_BOUND), np.minimum(upper, COUNT_BOUND)
            sides.append((lower, upper))
            grids.append(range(int(lower.min()) + wider, int(upper.max()) + 1 + wider, step))
        joined_alike(sides, grids)

    @pytest.mark.parametrize("kind", ["noise", "walk", "smooth", "weber"])
    def test_long_tubes(self, kind):
        """Each line, its count rounded as in SPEC 9.1, within the tube of its axis."""
        rng = np.random.default_rng(8)
        for size, width, step in (900, 40, 21), (500, 3, 2), (300, 0, 1):
            t = np.arange(size)
            sides, grids = [], []
            for turn in range(3):
                x = {
                    "noise": rng.integers(-200, 200, size),
                    "walk": rng.integers(-9, 10, size).cumsum(),
                    "smooth": np.rint(9000 * np.sin(t / 40 + turn)).astype(np.int64),
                    "weber": np.rint(9000 * np.sin(t / 40 + turn)).astype(np.int64),
                }[kind]
                wide = width + (np.abs(x) // 10 if kind == "weber" else 0)
                lower, upper = x - wide, x + wide
                sides.append((lower, upper))
                grids.append(range(int(lower.min()), int(upper.max()) + 1, step))
            ticks, at = joined_alike(sides, grids)
            for (lower, upper), grid, column in zip(sides, grids, at.T, strict=True):
                values = np.array([grid[place] for place in column])
                assert inside(lower, upper, (ticks, values), grid)

    def test_no_value_within_a_tube(self):
        row = np.array([0, 9, 0])
        with pytest.raises(ParameterError, match="a value of the grid at every tick"):
            joined_places([(row, row), (row, row + 1)], [range(0, 10, 9), range(0, 9, 2)])

    @pytest.mark.parametrize(
        ("lower", "upper", "grids", "ticks", "places"),
        [
            (0, 0, 0, 0, 0),
            (4, 4, 0, 2, 4),
            (4, 4, 6, 0, 4),
            (3, 4, 6, 2, 4),
            (4, 3, 6, 2, 4),
            (4, 4, 5, 2, 4),
            (4, 4, 6, 2, 3),
            (4, 4, 3, 2, 4),
            (514, 514, 771, 2, 514),
        ],
    )
    def test_rows_that_do_not_fit(self, lower, upper, grids, ticks, places):
        sizes = lower, upper, grids, ticks, places
        rows = [np.ones(size, np.int64) for size in sizes]
        with pytest.raises(ValueError, match="not a tube"):
            compiled.fewest_joined(*rows)

    @pytest.mark.parametrize("grid", [(0, 0, 1), (0, 1, 0), (2**34 + 1, 1, 1), (0, 1, 2**34 + 2)])
    def test_grids_are_checked(self, grid):
        row, place = np.zeros(2, np.int64), np.zeros(2, np.int64)
        with pytest.raises(ValueError, match="not a tube"):
            compiled.fewest_joined(row, row, np.array(grid, np.int64), row.copy(), place)


def run(name, lower, upper, ticks, values):
    """With a grid of all counts."""
    grid = (-COUNT_BOUND, 1, 2 * COUNT_BOUND + 1, b"") if name == "fewest_linear" else ()
    return getattr(compiled, name)(lower, upper, *grid, ticks, values)


@built
@pytest.mark.parametrize("name", ["fewest_hold", "fewest_linear"])
class TestArguments:
    @pytest.mark.deep
    def test_the_longest_tube(self, name):
        """2**24 ticks between the extremes, where products are largest."""
        size = 1 << 24
        lower, upper = np.full(size, -COUNT_BOUND), np.full(size, COUNT_BOUND)
        lower[0] = upper[0] = -COUNT_BOUND
        lower[-1] = upper[-1] = COUNT_BOUND
        upper[size // 2 - 1] = 0
        ticks, values = np.empty_like(lower), np.empty_like(lower)
        count = run(name, lower, upper, ticks, values)
        assert count == 2
        assert values[:2].tolist() == [-COUNT_BOUND, COUNT_BOUND]

    @pytest.mark.parametrize(
        ("lower", "upper", "room"),
        [
            ([], [], 0),
            ([1], [0], 1),
            ([0, 0], [0], 2),
            ([0, 0], [0, 0], 1),
            ([0], [2**32 + 1], 1),
            ([-(2**32) - 1], [0], 1),
            ([-(2**63)], [2**63 - 1], 1),
        ],
    )
    def test_what_is_no_tube_is_refused(self, name, lower, upper, room):
        tube = np.array(lower, np.int64), np.array(upper, np.int64)
        with pytest.raises(ValueError, match="not a tube"):
            run(name, *tube, np.zeros(room, np.int64), np.zeros(room, np.int64))

    def test_wrong_types(self, name):
        good = np.zeros(2, np.int64)
        with pytest.raises(ValueError, match="not a tube"):
            run(name, memoryview(bytes(17))[1:], good, good, good)
        with pytest.raises((TypeError, BufferError)):
            run(name, good, good, bytes(16), good)
        with pytest.raises(TypeError):
            getattr(compiled, name)(good)
