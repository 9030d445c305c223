"""Passes over all samples of a channel of doubles: each compiled loop is its readable twin."""

from __future__ import annotations

from fractions import Fraction
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import built, by_the_twin

from hapfmt.encoder import lattice, rational
from hapfmt.encoder.lattice import Facts, nearest_within
from hapfmt.limits import EXACT_LIMIT
from hapfmt.recording import Calibration

calibrations = st.builds(
    Calibration,
    st.integers(-(2**20), 2**20).filter(bool),
    st.integers(-(2**40), 2**40),
    st.integers(1, 2**40),
)
tolerances = st.sampled_from([0.0, 1e-12, 1e-3, 1.0, inf])


def both(x, calibration, allowed):
    """Counts up to the first that is missed by more than ``allowed``, and what is told of them."""
    fast = nearest_within(x, calibration, allowed)
    slow = by_the_twin(lattice, nearest_within, x, calibration, allowed)
    assert fast[1:] == slow[1:]
    missed = fast[2]
    assert fast[0][:missed].tolist() == slow[0][:missed].tolist()
    return fast


@built
class TestNearest:
    @given(calibrations, st.lists(st.integers(-(2**11), 2**11), min_size=1), tolerances)
    def test_values_of_the_grid(self, calibration, counts, allowed):
        x = calibration.physical(np.array(counts))
        given, worst, missed = both(x, calibration, allowed)
        assert (worst, missed) == (0.0, x.size)
        assert calibration.physical(given).tolist() == x.tolist()

    @given(
        calibrations,
        st.lists(st.tuples(st.integers(-(2**11), 2**11), st.floats(-1, 1)), min_size=1),
        tolerances,
    )
    def test_values_beside_it(self, calibration, places, allowed):
        step = float(calibration.step)
        x = np.array([(count + away) * step for count, away in places])
        x += calibration.b / calibration.d
        both(x, calibration, allowed)

    def test_halves_go_to_the_nearer_count_as_doubles_tell(self):
        x = np.array([0.5, 1.5, -0.5, 0.49999999999999994, 2.5])
        both(x, Calibration(), inf)
        both(x + 2.0**50, Calibration(1, 2**50, 1), inf)

    def test_the_first_miss_ends_it(self):
        x = np.array([0.0, 1.0, 1.25, 5.0])
        assert both(x, Calibration(), 0.125)[2] == 2
        assert both(x, Calibration(), 0.25)[1:] == (0.25, 4)

    def test_no_samples(self):
        assert both(np.zeros(0), Calibration(), 0.0)[1:] == (0.0, 0)


doubles = st.lists(
    st.floats() | st.sampled_from([0.0, -0.0, 5e-324, inf, -inf, nan, float(EXACT_LIMIT)])
)


@built
@given(doubles)
def test_facts(values):
    x = np.array(values, np.float64)
    fast, slow = Facts.of(x), by_the_twin(lattice, Facts.of, x)
    assert fast == slow
    assert fast.finite == bool(np.isfinite(x).all())


@built
@pytest.mark.parametrize("given", [(np.zeros(2), np.zeros(3, np.int32)), (b"123", b"1234")])
def test_other_arrays_are_refused(given):
    with pytest.raises(ValueError, match="not doubles"):
        lattice.compiled.nearest_within(1, 0, 1, 0.0, given[0], bytearray(given[1]))
    with pytest.raises(ValueError, match="not doubles"):
        lattice.compiled.double_facts(b"123")


@st.composite
def differences(draw):
    """Multiples of a step, each known within some noise; or any."""
    step = draw(st.floats(1e-6, 1e6))
    times = draw(st.lists(st.integers(1, 10**6) | st.floats(0.01, 1e6), min_size=1, max_size=40))
    noise = draw(st.sampled_from([1e-15, 1e-12, 1e-6, 0.01]))
    exact = np.array(times, np.float64) * step
    away = noise * max(step, 1e-9 * float(exact.max()))
    return exact - away, exact + away, draw(st.sampled_from([0.0, 16 * away, step / 3]))


@built
@given(differences())
def test_common_divisor(case):
    assert rational._divisor(*case) == by_the_twin(rational, rational._divisor, *case)


@given(st.fractions(0, 1000).filter(bool), st.floats(1e-9, 0.1))
def test_the_simplest_fraction_of_doubles(middle, width):
    low, high = float(middle) * (1 - width), float(middle) * (1 + width)
    n, m = rational.simplest_near(low, high)
    found = rational.simplest_fraction(Fraction(low), Fraction(high))
    assert Fraction(n) / Fraction(m) == found
