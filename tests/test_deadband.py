"""DBC-002: With flag *guaranteed*, every sample MUST keep the contract: scalar form `|x - y| * kd <= max(kn * |x - zero|, floor * kd)` for each component; vector form the same with Euclidean norms over the components, compared by their squares, and the floor of the first component."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapfmt.deadband import Deadband
from hapfmt.errors import ParameterError
from hapfmt.recording import Calibration

MILLINEWTON = Calibration(1, 0, 1000)

counts = st.one_of(
    st.sampled_from([0, 1, -1, 9, 10, 11, 2**24, 2**31 - 1, -(2**31)]),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(-200, 200),
)
fractions = st.one_of(
    st.sampled_from([(1, 10), (0, 1), (65535, 65535), (65535, 1), (1, 65535), (3, 2)]),
    st.tuples(st.integers(0, 65535), st.integers(1, 65535)),
)
floors = st.one_of(st.sampled_from([1, 10, 2**32 - 1]), st.integers(1, 1000))


@st.composite
def cases(draw, vector):
    """A deadband, and x and y as lists of rows; every other y lies close to the bound of its x."""
    components = draw(st.integers(1, 3))
    kn, kd = draw(fractions)
    zero = draw(st.lists(counts, min_size=components, max_size=components))
    floor = draw(st.lists(floors, min_size=components, max_size=components))
    rows = draw(st.lists(st.tuples(*[counts] * components), min_size=1, max_size=8))
    near = []
    for row in rows:
        tolerances = [
            max(kn * abs(x - z) // kd, f) for x, z, f in zip(row, zero, floor, strict=True)
        ]
        share = draw(st.sampled_from([1, components]))
        near.append(
            [
                max(-(2**31), min(2**31 - 1, x + draw(st.integers(-1, 1)) + t // share))
                for x, t in zip(row, tolerances, strict=True)
            ]
        )
    y = near if draw(st.booleans()) else draw(st.permutations(rows))
    return Deadband(kn, kd, tuple(floor), tuple(zero), vector), [list(r) for r in rows], list(y)


@settings(deadline=None)
@given(cases(vector=False))
def test_scalar_contract_is_the_formula(case):
    deadband, x, y = case
    broken = [
        [
            abs(a - b) * deadband.kd > max(deadband.kn * abs(a - z), f * deadband.kd)
            for a, b, z, f in zip(p, q, deadband.zero, deadband.floor, strict=True)
        ]
        for p, q in zip(x, y, strict=True)
    ]
    x, y = np.array(x), np.array(y)
    assert deadband.outside(x, y).tolist() == broken
    assert (np.abs(x - y) > deadband.tolerance(x)).tolist() == broken
    assert (deadband.worst_ratio(x, y) > 1) == np.any(broken)


@settings(deadline=None)
@given(cases(vector=True))
def test_vector_contract_is_the_formula(case):
    deadband, x, y = case
    kn, kd, floor = deadband.kn, deadband.kd, deadband.floor[0]
    squares = [
        (
            sum((a - b) ** 2 for a, b in zip(p, q, strict=True)) * kd**2,
            max(
                sum((a - z) ** 2 for a, z in zip(p, deadband.zero, strict=True)) * kn**2,
                floor**2 * kd**2,
            ),
        )
        for p, q in zip(x, y, strict=True)
    ]
    x, y = np.array(x), np.array(y)
    assert deadband.outside(x, y).tolist() == [error > allowed for error, allowed in squares]
    worst, exact = deadband.worst_ratio(x, y), max(Fraction(*pair) for pair in squares)
    assert exact <= worst**2
    assert worst == 0 or (worst - Fraction(1, 1 << 20)) ** 2 < exact


def test_scalar_ratio_is_exact():
    deadband = Deadband(1, 10, (10,), (0,))
    x = np.array([1000, 50, -7])
    assert deadband.worst_ratio(x, x + np.array([100, 10, 0])) == 1
    assert deadband.worst_ratio(x, x + np.array([101, 10, 0])) == Fraction(101, 100)
    assert deadband.worst_ratio(x[:0], x[:0]) == 0
    assert deadband.outside(x, x + np.array([101, 10, -11])).tolist() == [True, False, True]


def test_vector_decision_where_float64_cannot_tell():
    """Squares 2**62 apart from 0 and 1 from each other: equal as float64, different as integers."""
    a = 2**31 - 1
    deadband = Deadband(1, 1, (1,), (0, 0), vector=True)
    x, y = np.array([[a, 0], [a, 0], [a, 1]]), np.array([[0, 0], [0, 1], [0, 0]])
    assert float(a * a) == float(a * a + 1)
    assert deadband.outside(x, y).tolist() == [False, True, False]
    assert deadband.worst_ratio(x, y) == 1 + Fraction(1, 1 << 20)
    assert deadband.worst_ratio(x, x) == 0


def test_vector_floor_is_a_sphere():
    deadband = Deadband(0, 1, (5,), (0, 0, 0), vector=True)
    x = np.zeros((3, 3), np.int64)
    assert deadband.outside(x, np.array([[3, 4, 0], [3, 4, 1], [0, 0, 5]])).tolist() == [0, 1, 0]


def test_from_physical():
    assert Deadband.from_physical(0.1, 0.01, [MILLINEWTON]) == Deadband(1, 10, (10,), (0,))
    assert Deadband.from_physical("0.07", "0.0109", [Calibration(-1, 500, 1000)] * 2) == Deadband(
        7, 100, (10, 10), (500, 500)
    )
    far = Deadband.from_physical("1/10", 1e9, [Calibration(1, -(2**40), 1)])
    assert (far.zero, far.floor) == ((2**31 - 1,), (10**9,))
    with pytest.raises(ParameterError, match="one scale"):
        Deadband.from_physical(0.1, 0.01, [MILLINEWTON, Calibration(1, 0, 2000)], vector=True)
    with pytest.raises(ParameterError, match="finite"):
        Deadband.from_physical(float("nan"), 0.01, [MILLINEWTON])
    with pytest.raises(ParameterError, match="absolute floor"):
        Deadband.from_physical(0.1, 0.0009, [MILLINEWTON])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1, 10, (0,), (0,)), "absolute floor"),
        ((1, 10, (1 << 32,), (0,)), "2\\^32"),
        ((1, 0, (1,), (0,)), "Weber"),
        ((65536, 1, (1,), (0,)), "Weber"),
        ((-1, 1, (1,), (0,)), "Weber"),
        ((1, 10, (1,), (0, 0)), "one floor"),
        ((1, 10, (1, 1), (0, 0, 0), True), "one floor"),
        ((1, 10, (), ()), "component"),
        ((1, 10, (1,), (1 << 31,)), "32 bits"),
    ],
)
def test_refused(arguments, message):
    with pytest.raises(ParameterError, match=message):
        Deadband(*arguments)


def test_refused_arrays():
    deadband = Deadband(1, 10, (1, 1), (0, 0))
    x = np.zeros((4, 2), np.int32)
    for bad, message in (
        (x.astype(float), "integer"),
        (x[:, :1], "components"),
        (x[:, 0], "components"),
        (x.astype(np.uint64) + np.uint64(2**63), "2\\^32"),
    ):
        with pytest.raises(ParameterError, match=message):
            deadband.outside(bad, bad)
    with pytest.raises(ParameterError, match="equal shapes"):
        deadband.outside(x, x[:3])
    with pytest.raises(ParameterError, match="per component"):
        Deadband(1, 10, (1,), (0, 0), vector=True).tolerance(x)
    assert deadband.outside(x[:0], x[:0]).shape == (0, 2)
    assert Deadband(1, 10, (1,), (0, 0), vector=True).outside(x[:0], x[:0]).shape == (0,)
