"""Clause 9.1: knots, against ten lines that follow the page."""

from __future__ import annotations

import contextlib

import numpy as np
import page
import pytest
import strategies
from forge import svarint, varint
from hypothesis import given
from hypothesis import strategies as st
from test_integers import slow_varints

from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.knots import KnotParameters, build_knots, decode_knots, parse_knots
from hapfmt.errors import FormatError
from hapfmt.limits import LEVELS
from hapfmt.numbers import rdiv

pytestmark = pytest.mark.capped

ONE = LEVELS[1]


def slow_knots(data, parameters, span, width, level=ONE):
    """Rows of counts; None where a rule is broken."""
    numbers = slow_varints(data)
    if numbers is None or not numbers or (len(numbers) + 1) % (width + 1):
        return None
    table = [([0, *numbers])[i : i + width + 1] for i in range(0, len(numbers) + 1, width + 1)]
    ticks, rows, tick, values = [], [], 0, [0] * width
    for row, (gap, *coded) in enumerate(table):
        if row and gap < 1:
            return None
        tick += gap
        values = [v + (c // 2 if c % 2 == 0 else -(c + 1) // 2) for v, c in zip(values, coded)]  # noqa: B905
        ticks.append(tick)
        rows.append(values)
    grid = parameters.grid
    y = page.grid_levels(grid.kn, grid.kd, grid.step, level.count_bound) if grid.kn else None
    last = len(y) - 1 if y else level.count_bound // grid.step
    if any(abs(v) > last for row in rows for v in row) or ticks[-1] >= span:
        return None
    sizes = [[y[abs(v)] if y else abs(v) * grid.step for v in row] for row in rows]
    rows = [
        [grid.zero + (size if v >= 0 else -size) for v, size in zip(*pair, strict=True)]
        for pair in zip(rows, sizes, strict=True)
    ]
    if parameters.interpolation == "hold":
        return [rows[max(i for i, k in enumerate(ticks) if k <= t)] for t in range(span)]
    if len(ticks) == 1:
        return rows * span
    if ticks[-1] != span - 1:
        return None
    out = []
    for t in range(span):
        i = max(i for i, k in enumerate(ticks[:-1]) if k <= t)
        run = ticks[i + 1] - ticks[i]
        pairs = zip(rows[i], rows[i + 1], strict=True)
        out.append([v0 + rdiv((v1 - v0) * (t - ticks[i]), run) for v0, v1 in pairs])
    return out


def decoded(data, parameters, span, width, level=ONE):
    try:
        return decode_knots(data, parameters, span, width, level, 0).tolist()
    except FormatError:
        return None


cases = strategies.knot_parameters(ONE).flatmap(
    lambda p: st.tuples(st.just(p), strategies.knots(p, ONE))
)


class TestParameters:
    @given(
        strategies.levels.flatmap(lambda v: st.tuples(st.just(v), strategies.knot_parameters(v)))
    )
    def test_come_back(self, case):
        """
        KNT-001: `interpolation` and `coding` MUST be 0 or 1.
        COD-002: The codec parameters (TLV 1) MUST be present and as long as their layout. Those of `QUAN` also contain the codebook; `EVNT` has none.
        """
        level, parameters = case
        data = parameters.build()
        assert KnotParameters.parse(data, level, 0) == parameters
        for other in (data[:-1], data + b"\0", b""):
            with pytest.raises(FormatError):
                KnotParameters.parse(other, level, 0)

    @given(st.binary(max_size=10))
    def test_any_bytes(self, data):
        with contextlib.suppress(FormatError):
            assert KnotParameters.parse(data, ONE, 0).build() == data


class TestDecoding:
    @given(cases)
    def test_knots_come_back(self, case):
        _, (ticks, values, _) = case
        data = build_knots(ticks, values)
        back = parse_knots(data, values.shape[1], 0)
        assert [x.tolist() for x in back] == [ticks.tolist(), values.tolist()]

    @given(cases)
    def test_as_the_page_says(self, case):
        """
        KNT-002: There MUST be at least one knot, and a knot MUST be whole.
        KNT-003: The ticks of knots MUST increase and be less than `span`. If linear with more than one knot, the last tick is `span - 1`.
        CNV-001: A decoder MUST compute every count with the integer arithmetic of this clause, or with one that gives the same integers.
        """
        parameters, (ticks, values, span) = case
        data, width = build_knots(ticks, values), values.shape[1]
        expected = slow_knots(data, parameters, span, width)
        assert expected is not None
        assert decoded(data, parameters, span, width) == expected

    @given(cases, st.data())
    def test_mutated(self, case, data):
        parameters, (ticks, values, span) = case
        packet = bytearray(build_knots(ticks, values))
        at = data.draw(st.integers(0, len(packet) - 1))
        packet[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        width = values.shape[1]
        expected = slow_knots(bytes(packet), parameters, span, width)
        assert decoded(bytes(packet), parameters, span, width) == expected

    @given(
        st.lists(st.sampled_from([0, 1, 2, 3, 9, 0x7F, 0x80, 0xFF]), max_size=12).map(bytes),
        strategies.knot_parameters(ONE),
        st.integers(1, 12),
        st.integers(1, 3),
    )
    def test_any_bytes(self, data, parameters, span, width):
        expected = slow_knots(data, parameters, span, width)
        assert decoded(data, parameters, span, width) == expected

    @pytest.mark.parametrize("bound", [2**24, 2**32])
    def test_extremes_of_each_level_are_exact(self, bound):
        level = LEVELS[1 if bound == 2**24 else 2]
        far = 59_999
        data = svarint(-bound) + varint(far) + svarint(2 * bound)
        got = decode_knots(data, KnotParameters("linear"), 60_000, 1, level, 0)[:, 0]
        for t in (0, 1, 2, 9999, 59_999):
            assert got[t] == -bound + rdiv(2 * bound * t, far)

    def test_ties_go_up(self):
        data = svarint(10) + varint(2) + svarint(-5)
        assert decoded(data, KnotParameters("linear"), 3, 1) == [[10], [8], [5]]

    def test_a_line_ends_with_its_packet(self):
        for gap, counts in ((1, None), (2, [[0], [50], [100]]), (3, None), (100, None)):
            data = svarint(0) + varint(gap) + svarint(100)
            assert decoded(data, KnotParameters("linear"), 3, 1) == counts


FROZEN = [
    ("hold", 25, 8, "080302", [[100]] * 3 + [[125]] * 5),
    ("linear", 1, 6, "1402090318", [[10], [8], [5], [9], [13], [17]]),
    ("linear", 3, 4, "0201", [[3, -3]] * 4),
]


@pytest.mark.parametrize(("interpolation", "step", "span", "text", "counts"), FROZEN)
def test_frozen_bitstreams(interpolation, step, span, text, counts):
    parameters = KnotParameters(interpolation, LpcParameters(step))
    assert decoded(bytes.fromhex(text), parameters, span, len(counts[0])) == counts


def test_no_value_wraps():
    """Sums of the largest differences stay integers of 64 bits, or are refused."""
    data = svarint(2**52 - 1) + (varint(1) + svarint(2**52 - 1)) * 5000
    assert decoded(data, KnotParameters("hold"), 10_000, 1) is None
    assert (
        decoded(svarint(0) + varint(2**53 - 1) + svarint(0), KnotParameters("hold"), 9, 1) is None
    )


def test_counts_are_a_row_for_each_tick():
    got = decode_knots(svarint(7), KnotParameters("hold"), 3, 1, ONE, 0)
    assert (got.shape, got.dtype) == ((3, 1), np.int64)
