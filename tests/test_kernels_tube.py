"""Knots in a tube: the compiled loops are their readable twins, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_tube import random_tube, tubes

from hapfmt.encoder import tube as module
from hapfmt.encoder.tube import COUNT_BOUND, fewest_hold, fewest_linear
from hapfmt.kernels import compiled

built = pytest.mark.skipif(compiled is None, reason="the extension is not built, or HAPFMT_PURE=1")
scales = st.sampled_from([1, 2**11, 2**26, 2**31])


def assert_same(find, lower, upper):
    fast = find(lower, upper)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "compiled", None)
        slow = find(lower, upper)
    for a, b in zip(fast, slow, strict=True):
        assert a.dtype == b.dtype == np.int64
        assert a.tolist() == b.tolist()
    return fast


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


@built
@pytest.mark.parametrize("name", ["fewest_hold", "fewest_linear"])
class TestArguments:
    def test_the_longest_tube(self, name):
        """2**24 ticks between the extremes, where products are largest."""
        size = 1 << 24
        lower, upper = np.full(size, -COUNT_BOUND), np.full(size, COUNT_BOUND)
        lower[0] = upper[0] = -COUNT_BOUND
        lower[-1] = upper[-1] = COUNT_BOUND
        upper[size // 2 - 1] = 0
        ticks, values = np.empty_like(lower), np.empty_like(lower)
        count = getattr(compiled, name)(lower, upper, ticks, values)
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
            getattr(compiled, name)(*tube, np.zeros(room, np.int64), np.zeros(room, np.int64))

    def test_wrong_types(self, name):
        good = np.zeros(2, np.int64)
        with pytest.raises(ValueError, match="not a tube"):
            getattr(compiled, name)(memoryview(bytes(17))[1:], good, good, good)
        with pytest.raises((TypeError, BufferError)):
            getattr(compiled, name)(good, good, bytes(16), good)
        with pytest.raises(TypeError):
            getattr(compiled, name)(good)
