"""Knots, decoded and selected: the compiled loops are their readable twins, bit for bit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import strategies
from depth import either
from hypothesis import given
from hypothesis import strategies as st
from twins import built, by_the_twin, changed, clamped, same

from hapfmt.codecs import knots
from hapfmt.codecs import knots as codec
from hapfmt.codecs.knots import KnotParameters, build_knots, build_varints, decode_within
from hapfmt.deadband import Deadband
from hapfmt.encoder import knots as encoder
from hapfmt.encoder.knots import select_knots, select_knots_plain
from hapfmt.kernels import compiled
from hapfmt.limits import LEVELS
from hapfmt.numbers import build_varint

levels = st.sampled_from([LEVELS[1], LEVELS[2]])
decoded = partial(same, codec, clamped, decode_within)
ranges = st.sampled_from([(-(2**31), 2**31 - 1), (0, 0), (-5, 100), (-(2**23), 2**23 - 1)])
cases = levels.flatmap(
    lambda level: strategies.knot_parameters(level).flatmap(
        lambda p: st.tuples(st.just(level), st.just(p), strategies.knots(p, level), ranges)
    )
)


@built
class TestDecoding:
    @given(cases)
    def test_packets(self, case):
        level, parameters, (ticks, values, span), (low, high) = case
        data = build_knots(ticks, values)
        fast = decoded(data, parameters, span, values.shape[1], level, 9, low, high)
        assert fast[0] == (span, values.shape[1])

    @given(cases, st.data())
    def test_mutated(self, case, data):
        """Counts, or class, rule, offset and words of the error."""
        level, parameters, (ticks, values, span), (low, high) = case
        packet = bytearray(build_knots(ticks, values))
        for _ in range(data.draw(st.integers(1, 3))):
            at = data.draw(st.integers(0, len(packet)))
            packet[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        decoded(bytes(packet), parameters, span, values.shape[1], level, 9, low, high)

    @given(
        st.lists(st.sampled_from([0, 1, 2, 3, 9, 0x7F, 0x80, 0xFF]), max_size=20).map(bytes),
        strategies.knot_parameters(LEVELS[2]),
        st.integers(1, 12),
        st.integers(1, 3),
        ranges,
    )
    def test_any_bytes(self, data, parameters, span, width, limits):
        decoded(data, parameters, span, width, LEVELS[2], 0, *limits)

    @pytest.mark.parametrize("components", [1, 3, 7])
    @pytest.mark.parametrize("bits", [2, 16, 31, 33])
    @pytest.mark.parametrize("mean", [1, 2, 30, 900])
    def test_long_packets(self, components, bits, mean):
        """Lines with and without a clamp, short and long."""
        rng = np.random.default_rng(mean * bits)
        ticks = np.cumsum(np.append(0, rng.integers(1, 2 * mean, 99)))
        far = 1 << (bits - 1)
        values = rng.integers(-far, far, (ticks.size, components), endpoint=True)
        span = int(ticks[-1]) + 1
        data = build_knots(ticks, values)
        for mode in ("linear", "hold"):
            for low, high in ((-(2**31), 2**31 - 1), (-(far // 2), far // 3)):
                limits = max(low, -(2**31)), min(high, 2**31 - 1)
                fast = decoded(data, KnotParameters(mode), span, components, LEVELS[2], 0, *limits)
                assert fast[0] == (span, components)

    @either("span", 1 << 20, 1 << 22, 1 << 24)
    def test_the_longest_lines(self, span):
        """2**24 ticks, from one end of the counts to the other."""
        far = 1 << 32
        ticks = np.array([0, 5, span - 1])
        values = np.array([[far], [-far], [far]])
        data = build_knots(ticks, values)
        given = data, KnotParameters("linear"), span, 1, LEVELS[2], 0, -(2**31), 2**31 - 1
        fast = decode_within(*given)
        assert (fast == by_the_twin(codec, decode_within, *given)).all()

    def test_where_a_knot_may_stand(self):
        """KNT-003 at its ends."""
        for gaps in ([1], [2], [3], [2, 1], [1, 1], [1, 2], [2**24], [2**24 + 1], [1, 2**24 - 1],
                     [1, 2**24], [2**53 - 1], [0]):  # fmt: skip
            data = b"\2" + b"".join(build_varint(gap) + b"\2" for gap in gaps)
            for mode in ("hold", "linear"):
                for span in (1, 2, 3, 4):
                    decoded(data, KnotParameters(mode), span, 1, LEVELS[2], 0, -9, 9)


@st.composite
def vectors(draw):
    """Tracks whose distances are next to a deadband, or equal to it."""
    width = draw(st.integers(1, 4))
    scale = draw(st.sampled_from([1, 3, 2**16, 2**30]))
    count = st.integers(-3, 3).map(lambda v: v * scale) | st.integers(-(2**32) + 1, 2**32 - 1)
    rows = draw(st.lists(st.lists(count, min_size=width, max_size=width), max_size=20))
    near = draw(st.integers(-2, 2))
    floor = draw(st.sampled_from([1, min(max(5 * scale + near, 1), 2**32 - 1), 2**32 - 1]))
    zero = draw(st.sampled_from([0, 7, -(2**31), 2**31 - 1]))
    kn, kd = draw(st.sampled_from([(0, 1), (1, 1), (1, 10), (3, 4), (65535, 65534), (65535, 1)]))
    band = Deadband(kn, kd, (floor,) * width, (zero,) * width, draw(st.booleans()))
    return np.array(rows, np.int64).reshape(-1, width), band


def selections(table, band):
    return [
        select_knots(table, band, reference=reference, keep_last=last).tolist()
        for reference in ("last", "sample")
        for last in (False, True)
    ]


@built
class TestSelecting:
    @given(vectors())
    def test_distances_next_to_the_deadband(self, case):
        table, band = case
        fast = selections(table, band)
        assert fast == by_the_twin(encoder, selections, table, band)
        assert fast == [
            select_knots_plain(table, band, reference=reference, keep_last=last).tolist()
            for reference in ("last", "sample")
            for last in (False, True)
        ]


@built
@given(st.lists(st.sampled_from([0, 1, 127, 128, 2**52, 2**53 - 1]) | st.integers(0, 2**53 - 1)))
def test_varints(numbers):
    row = np.array(numbers, np.int64)
    fast = build_varints(row)
    assert fast == by_the_twin(knots, build_varints, row)
    assert fast == b"".join(map(build_varint, numbers))


@built
@pytest.mark.parametrize("number", [-1, 2**53, -(2**63)])
def test_what_is_no_varint(number):
    row = np.array([1, number])
    with pytest.raises(ValueError, match="not numbers"):
        compiled.build_varints(row, bytearray(16))
    with pytest.raises(ValueError, match="no room"):
        compiled.build_varints(row[:1], bytearray(7))
    with pytest.raises(ValueError, match="no room"):
        compiled.build_varints(bytes(7), bytearray(99))


ROW = np.zeros(4, np.int64)
DECODE = {
    "packet": b"\0", "components": 2, "lines": True, "limit": 9, "step": 1, "zero": 0,
    "levels": b"", "low": -9, "high": 9, "values": ROW.copy(), "counts": np.zeros(6, np.int32),
}  # fmt: skip
SELECT = {
    "table": np.zeros((3, 2), np.int64), "zero": ROW[:2], "floor": ROW[:2] + 1, "kn": 1, "kd": 2,
    "vector": False, "by_sample": False, "ticks": np.zeros(3, np.int64),
}  # fmt: skip


@built
class TestArguments:
    @pytest.mark.parametrize(
        "wrong",
        [
            {"step": 0}, {"step": 2**32 + 1}, {"components": 0}, {"components": -1},
            {"components": 3}, {"limit": 2**32 + 1}, {"limit": -1}, {"step": 2, "limit": 2**31 + 1},
            {"low": 10}, {"low": -(2**31) - 1}, {"high": 2**31}, {"zero": 2**31},
            {"levels": ROW[:1]}, {"levels": bytes(81)},
            {"values": ROW[:3].copy()}, {"counts": np.zeros(5, np.int32)},
            {"counts": np.zeros(0, np.int32)}, {"counts": memoryview(bytearray(25))[1:]},
        ],
        ids=changed,
    )  # fmt: skip
    def test_limits_that_would_overflow(self, wrong):
        assert compiled.knots_decode(*DECODE.values()) is False
        with pytest.raises(ValueError, match="not the limits"):
            compiled.knots_decode(*(DECODE | wrong).values())

    @pytest.mark.parametrize(
        "wrong",
        [
            {"table": np.zeros((2, 2), np.int64)}, {"zero": ROW[:0]}, {"floor": ROW[:2]},
            {"floor": ROW[:1] + 1}, {"floor": ROW[:2] + 2**32}, {"zero": ROW[:2] + 2**31},
            {"kn": -1}, {"kn": 65536}, {"kd": 0}, {"kd": 65536}, {"vector": True},
            {"table": np.full((3, 2), 2**32)}, {"table": np.full((3, 2), -(2**63))},
            {"ticks": np.zeros(0, np.int64)},
        ],
        ids=changed,
    )  # fmt: skip
    def test_no_deadband(self, wrong):
        assert compiled.select_knots(*SELECT.values()) == 1
        with pytest.raises(ValueError, match="not a deadband"):
            compiled.select_knots(*(SELECT | wrong).values())
