"""Coded knots: the compiled loops are their readable twins, bit for bit."""

from __future__ import annotations

from functools import partial
from itertools import product

import numpy as np
import pytest
import strategies
from depth import sample
from hypothesis import given
from hypothesis import strategies as st
from twins import built, changed, clamped, packed, same

from hapfmt.codecs import knots as codec
from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.knots import KnotParameters, decode_coded_within, encode_knots
from hapfmt.kernels import compiled
from hapfmt.limits import LEVELS

levels = st.sampled_from([LEVELS[1], LEVELS[2]])
decoded = partial(same, codec, clamped, decode_coded_within)
encoded = partial(same, codec, packed, encode_knots)
ranges = st.sampled_from([(-(2**31), 2**31 - 1), (0, 0), (-5, 100), (-(2**23), 2**23 - 1)])
cases = levels.flatmap(
    lambda level: st.tuples(
        st.just(level), strategies.coded_knots(level), strategies.knot_rows(), ranges
    )
)
ONE, TWO = LEVELS[1], LEVELS[2]


@built
class TestTwins:
    @given(cases)
    def test_packets(self, case):
        level, parameters, (mode, ticks, indices, span), (low, high) = case
        parameters = KnotParameters(mode, parameters.grid, coded=True)
        limit = parameters.grid.index_limit(level.count_bound)
        indices = indices.clip(-limit, limit)
        data = encoded(ticks, indices, mode)
        shape = span, indices.shape[1]
        fast = decoded(data, parameters, *shape, level, 9, low, high)
        assert fast[0] == shape

    @given(cases, st.data())
    def test_mutated(self, case, data):
        """Counts, or class, rule, offset and words of the error."""
        level, parameters, (mode, ticks, indices, span), (low, high) = case
        packet = bytearray(encode_knots(ticks, indices, mode))
        for _ in range(data.draw(st.integers(0, 3))):
            at = data.draw(st.integers(0, len(packet)))
            packet[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        span = data.draw(st.sampled_from([span, span + 1, 1, 2, 2**20]))
        width = indices.shape[1]
        decoded(bytes(packet), parameters, span, width, level, 9, low, high)

    @given(
        st.lists(st.sampled_from([0, 1, 2, 3, 9, 0x7F, 0x80, 0xFF]), max_size=20).map(bytes),
        strategies.coded_knots(TWO),
        st.integers(1, 12),
        st.integers(1, 3),
        ranges,
    )
    def test_any_bytes(self, data, parameters, span, width, limits):
        decoded(data, parameters, span, width, TWO, 0, *limits)

    @pytest.mark.parametrize(
        ("mode", "width", "far", "gap"),
        sample(product(["hold", "linear"], [1, 3], [1, 40, 2**20, 2**32], [1, 60, 5000]), 16),
    )
    def test_long_packets(self, mode, width, far, gap):
        """Models that have learned, raw bits by the hundred, and buffers that are too small."""
        rng = np.random.default_rng(far * gap + width)
        ticks = np.cumsum(np.append(0, rng.integers(1, gap, 700, endpoint=True)))
        indices = rng.integers(-far, far, (701, width), endpoint=True)
        data = encoded(ticks, indices, mode)
        span = int(ticks[-1]) + 1
        for grid in (LpcParameters(), LpcParameters(1, -(2**31)), LpcParameters(1, 7, 1, 1024)):
            given = data, KnotParameters(mode, grid, coded=True), span, width, TWO, 0
            fast = decoded(*given, -(2**31), 2**31 - 1)
            assert fast[0] == (span, width) or (grid.kn and far > 2**15)
            decoded(*given, -9, far // 3)

    @given(
        st.lists(st.sampled_from([0, 1, 2, 9, -1, 2**24, 2**24 + 1]), min_size=1, max_size=4),
        st.lists(st.sampled_from([0, 2**32, 2**32 + 1, -(2**63)]), min_size=5, max_size=5),
        st.sampled_from(["hold", "linear"]),
    )
    def test_what_no_packet_holds(self, gaps, indices, mode):
        ticks = np.cumsum([0, *gaps])
        made = encoded(ticks, np.array(indices[: ticks.size])[:, None], mode)
        wrong = min(gaps) < 1 or max(gaps) > 2**24 or max(map(abs, indices[: ticks.size])) > 2**32
        assert isinstance(made, str) == wrong


def test_more_knots_than_a_second_takes():
    """As many as a cluster of level 1 has room for, from few bytes and from many."""
    ticks = np.arange(1 << 16 if compiled is None else 1 << 20)
    for far in (0, 15):
        indices = (ticks % 2 * far)[:, None]
        data = encode_knots(ticks, indices, "hold")
        # What can be foreseen takes nearly nothing; a size takes three flags and two raw bits.
        assert 8 * len(data) < 400 + (0.01 + 2.1 * bool(far)) * ticks.size
        parameters = KnotParameters("hold", LpcParameters(), coded=True)
        counts = decode_coded_within(data, parameters, ticks.size, 1, ONE, 0, -99, 99)
        assert (counts == indices).all()


ROW = np.zeros(6, np.int64)
DECODE = {
    "coded": b"", "lines": True, "further": 0, "limit": 9, "step": 1, "zero": 0, "levels": b"",
    "low": -9, "high": 9, "first": ROW[:2].copy(), "work": ROW[:4].copy(),
    "counts": np.zeros(6, np.int32),
}  # fmt: skip
ENCODE = {
    "ticks": ROW[:2].copy(), "indices": ROW[:4].copy(), "lines": False, "coded": bytearray(9)
}  # fmt: skip
BELOW = np.array([0, 1, -1])


@built
class TestArguments:
    @pytest.mark.parametrize(
        "wrong",
        [
            {"further": -1}, {"further": 3}, {"limit": -1}, {"limit": 2**32 + 1}, {"step": 0},
            {"step": 2**32}, {"zero": 2**31}, {"zero": -(2**31) - 1}, {"levels": ROW[:1]},
            {"limit": 2, "levels": BELOW}, {"limit": 2, "levels": BELOW + 2**33 + 1},
            {"levels": bytes(81)}, {"low": 10}, {"low": -(2**31) - 1}, {"high": 2**31},
            {"first": ROW[:1].copy()}, {"first": ROW[:0].copy()}, {"first": ROW[:2] + 10},
            {"first": ROW[:2] - 10}, {"work": ROW[:3].copy()}, {"counts": np.zeros(5, np.int32)},
            {"counts": np.zeros(0, np.int32)}, {"counts": memoryview(bytearray(25))[1:]},
        ],
        ids=changed,
    )  # fmt: skip
    def test_limits_that_would_overflow(self, wrong):
        assert compiled.coded_knots_decode(*DECODE.values())[0] == 0
        with pytest.raises(ValueError, match="not the limits"):
            compiled.coded_knots_decode(*(DECODE | wrong).values())

    @pytest.mark.parametrize(
        "wrong",
        [
            {"ticks": ROW[:0]}, {"ticks": ROW[:3]}, {"ticks": bytes(15)}, {"indices": bytes(17)},
            {"ticks": memoryview(bytes(17))[1:]},
        ],
        ids=changed,
    )  # fmt: skip
    def test_no_knots(self, wrong):
        assert compiled.coded_knots_encode(*ENCODE.values())[0] == 8
        with pytest.raises(ValueError, match="not arrays of knots"):
            compiled.coded_knots_encode(*(ENCODE | wrong).values())

    def test_no_room(self):
        status, size = compiled.coded_knots_encode(
            np.arange(9), np.arange(9) ** 5, False, bytearray()
        )
        assert status == 5
        room = bytearray(size)
        status, size = compiled.coded_knots_encode(np.arange(9), np.arange(9) ** 5, False, room)
        assert status == 0 < size == len(room)
