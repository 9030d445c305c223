"""Where decoded counts are clamped and numbers are refused: at the limit, one inside, one outside.

Each case is worked out here, and holds for the compiled loops and for their readable twins.
"""

from __future__ import annotations

import numpy as np
import pytest
from depth import deep
from twins import by_the_twin

from hapfmt.codecs import knots, predicted, quantised
from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.knots import KnotParameters, build_knots, encode_knots
from hapfmt.codecs.predicted import join_components
from hapfmt.encoder.predict import encode_best
from hapfmt.encoder.unit import choose_codebook
from hapfmt.errors import FormatError
from hapfmt.limits import LEVELS

LIMITS = [(-5, 100), (0, 0), (3, 9), (-9, -3), (-(2**23), 2**23 - 1), (-(2**31), 2**31 - 1)]
LEVEL = LEVELS[2]
BOUND = LEVEL.count_bound


def edges(low: int, high: int) -> list[int]:
    """Counts at both limits, one inside and one outside, as far as the level has them."""
    near = {edge + by for edge in (low, high) for by in (-2, -1, 0, 1, 2)} | {0}
    return sorted(x for x in near if abs(x) <= BOUND)


def both(module, decode, *given):
    """What the compiled loop and its twin give, which is the same."""
    out = []
    for call in (decode, lambda *given: by_the_twin(module, decode, *given)):
        try:
            out.append(call(*given).tolist())
        except FormatError as error:
            out.append(error.requirement)
    assert out[0] == out[1]
    return out[0]


def clipped(values, low, high):
    return np.clip(np.array(values, np.int64), low, high).tolist()


@pytest.mark.parametrize("width", [1, 3])
@pytest.mark.parametrize(("low", "high"), LIMITS)
class TestCounts:
    """At the limits of the declared range."""

    def rows(self, low, high, width):
        values = edges(low, high)
        order = np.random.default_rng(7).permutation(values)
        row = [*values, *order.tolist()]
        return np.array([np.roll(row, place) for place in range(width)], np.int64).T

    def test_quantised(self, low, high, width):
        rows = self.rows(low, high, width)
        parameters = choose_codebook([rows], 1)
        data = quantised.encode_quantised(rows, parameters)
        got = both(
            quantised, quantised.decode_within, data, parameters, *rows.shape, LEVEL, 0, low, high
        )
        assert got == clipped(rows, low, high)

    @pytest.mark.parametrize("step", [2, 7])
    def test_quantised_in_steps(self, low, high, width, step):
        """A limit between two levels."""
        rows = np.unique(self.rows(low, high, 1) // step)[:, None].repeat(width, axis=1)
        rows = np.concatenate([rows, rows + 1])
        parameters = choose_codebook([rows], step)
        data = quantised.encode_quantised(rows, parameters)
        got = both(
            quantised, quantised.decode_within, data, parameters, *rows.shape, LEVEL, 0, low, high
        )
        assert got == clipped(rows * step, low, high)

    @pytest.mark.parametrize("joined", ["hold", "linear"])
    def test_knots_at_every_tick(self, low, high, width, joined):
        rows = self.rows(low, high, width)
        ticks = np.arange(len(rows))
        given = (*rows.shape, LEVEL, 0, low, high)
        data = build_knots(ticks, rows)
        assert both(
            knots, knots.decode_within, data, KnotParameters(joined), *given
        ) == clipped(rows, low, high)  # fmt: skip
        coded = encode_knots(ticks, rows, joined)
        assert both(
            knots, knots.decode_coded_within, coded,
            KnotParameters(joined, LpcParameters(), coded=True), *given,
        ) == clipped(rows, low, high)  # fmt: skip

    @pytest.mark.parametrize("run", [9, 70, *deep([4])])
    def test_lines_through_both_limits(self, low, high, width, run):
        """Lines that end at a limit, one inside or outside of it, up and down; long ones too, which
        are drawn several ticks at a time."""
        ends = [x for x in edges(low, high) if x]
        for first in ends:
            for last in ends[:: 3 if run > 9 else 1]:
                values = np.array([[first] * width, [last] * width], np.int64)
                ticks, span = np.array([0, run]), run + 1
                line = [first + half_up(t * (last - first), run) for t in range(span)]
                expected = clipped([[x] * width for x in line], low, high)
                given = (span, width, LEVEL, 0, low, high)
                data = build_knots(ticks, values)
                got = both(knots, knots.decode_within, data, KnotParameters("linear"), *given)
                assert got == expected
                coded = encode_knots(ticks, values, "linear")
                parameters = KnotParameters("linear", LpcParameters(), coded=True)
                got = both(knots, knots.decode_coded_within, coded, parameters, *given)
                assert got == expected

    @pytest.mark.parametrize("zero", [0, 3])
    def test_predicted(self, low, high, width, zero):
        rows = self.rows(low, high, width) - zero
        rows = np.clip(rows, -BOUND, BOUND)
        data = join_components([encode_best(np.ascontiguousarray(column)) for column in rows.T])
        parameters = LpcParameters(1, zero)
        got = both(
            predicted, predicted.decode_within, data, parameters, *rows.shape, LEVEL, 0, low, high
        )
        assert got == clipped(rows + zero, low, high)


def half_up(a: int, b: int) -> int:
    """a / b rounded, halves up."""
    return (2 * a + b) // (2 * b)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("level", [LEVELS[1], LEVELS[2]])
class TestBounds:
    """The largest number that a packet may hold is read, one more is refused."""

    wide = (-(2**31), 2**31 - 1)

    def test_knots(self, level, sign):
        for step in (1, 3):
            for by in (-1, 0, 1):
                value = sign * (level.count_bound // step + by)
                data = build_knots(np.array([0]), np.array([[value]]))
                parameters = KnotParameters("hold", LpcParameters(step))
                got = both(knots, knots.decode_within, data, parameters, 1, 1, level, 0, *self.wide)
                wanted = clipped([[value * step]], *self.wide)
                assert got == (wanted if by <= 0 else "LPC-003")

    def test_quantised(self, level, sign):
        for step in (1, 3):
            for by in (-1, 0, 1):
                value = sign * (2 * level.count_bound // step + by)
                if value * sign > 1 << 32:
                    continue  # no packet of this encoder holds it
                rows = np.array([[value], [1]])
                parameters = choose_codebook([rows], step)
                data = quantised.encode_quantised(rows, parameters)
                got = both(quantised, quantised.decode_within, data, parameters,
                           2, 1, level, 0, *self.wide)  # fmt: skip
                wanted = clipped([[value * step], [step]], *self.wide)
                assert got == wanted if by <= 0 else isinstance(got, str)

    def test_indices(self, level, sign):
        for step in (1, 3):
            limit, grid = level.count_bound // step, LpcParameters(step)
            for by in (-1, 0, 1):
                value = sign * (limit + by)
                wanted = clipped([[value * step], [step]], *self.wide)
                given = (2, 1, level, 0, *self.wide)
                if value * sign > 1 << 32:
                    continue  # no packet of this encoder holds it
                data = encode_best(np.array([value, 1]))
                got = both(predicted, predicted.decode_within, data, grid, *given)
                assert got == wanted if by <= 0 else got == "LPC-003"
                data = encode_knots(np.array([0, 1]), np.array([[value], [1]]), "hold")
                got = both(knots, knots.decode_coded_within, data,
                           KnotParameters("hold", grid, coded=True), *given)  # fmt: skip
                assert got == wanted if by <= 0 else got == "LPC-003"
