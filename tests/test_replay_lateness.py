"""Percentiles in bounded memory, against the sorted list of all."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.replay.process.loop import CLASSES, LIMIT, OCTAVE, Lateness, class_of, largest_of

times = (
    st.integers(0, 300)
    | st.integers(0, 10**7)
    | st.integers(0, LIMIT)
    | st.builds(lambda bit, near: max(0, (1 << bit) + near), st.integers(0, 62), st.integers(-2, 2))
)


def lateness_of(values):
    found = Lateness()
    for value in values:
        found.add(value)
    return found


@given(times)
def test_classes(time_ns):
    index = class_of(time_ns)
    assert 0 <= index < CLASSES
    assert largest_of(index) >= time_ns
    assert class_of(largest_of(index)) == index
    assert largest_of(index) - time_ns <= time_ns // OCTAVE
    assert class_of(largest_of(index) + 1) == index + 1


def test_every_class_follows_the_one_before():
    assert [class_of(largest_of(index)) for index in range(CLASSES)] == list(range(CLASSES))
    assert largest_of(CLASSES - 1) == LIMIT


@given(st.lists(times, min_size=1), st.integers(1, 1000))
def test_percentiles(values, per_mille):
    """Never less than the exact one, and at most 1/64 more."""
    (found,) = lateness_of(values).percentiles([per_mille])
    exact = sorted(values)[-(-len(values) * per_mille // 1000) - 1]
    assert exact <= found <= exact + exact // OCTAVE
    assert found <= max(values)


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ([], (0, 0, 0)),
        ([7], (7, 7, 7)),
        (range(100), (49, 98, 99)),
        ([0] * 989 + [100] * 10 + [10**9], (0, 100, 100)),
        ([0] * 998 + [10**9] * 2, (0, 0, 10**9)),
        ([1000, 1001, 1 << 40], (1007, 1 << 40, 1 << 40)),
        ([-5, 1 << 70], (0, LIMIT, LIMIT)),
    ],
)
def test_literally(values, found):
    assert lateness_of(values).percentiles() == found


def test_memory_is_bounded():
    """A class for each of all times that fit, whatever their number."""
    lateness = lateness_of(largest_of(index) for index in range(CLASSES))
    for value in range(0, 10**6, 997):
        lateness.add(value)
    assert lateness.count == CLASSES + len(range(0, 10**6, 997))
    assert len(lateness._classes) == CLASSES == 3712
