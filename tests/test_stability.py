"""Every row of tools/stability: the naive way is as bad, and ours as good, as the row says."""

from __future__ import annotations

import sys
from functools import cache

import pytest
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import stability
from stability.row import Limit, at_least, at_most, compared, exactly

found = cache(stability.rows_of)
CASES = [
    *stability.QUICK,
    *(pytest.param(case, marks=pytest.mark.deep) for case in stability.DEEP),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_case(case):
    assert found(case)
    for row in found(case):
        assert row.ok, row
        assert row.unit
        # Whatever the limits: the two never agree.
        assert row.naive != row.ours, row


def test_every_row_is_there():
    """1 to 21 are the cases of the design, the others further extremes."""
    numbers = {row.number for case in stability.QUICK for row in found(case)}
    assert set(range(1, 22)) <= numbers
    assert {case.__name__ for case in stability.DEEP}.isdisjoint(
        c.__name__ for c in stability.QUICK
    )


def test_a_row_fails_where_either_side_does():
    good = {"naive": (5, at_least(5)), "ours": (0, exactly(0)), "unit": "N"}
    assert compared(1, "", **good).ok
    assert compared(1, "", **good).limits == "naive ≥ 5, ours = 0"
    assert not compared(1, "", **good, held=False).ok
    for other in ({"naive": (4.9, at_least(5))}, {"ours": (1e-9, exactly(0))}):
        assert not compared(1, "", **good | other).ok
    nan = float("nan")
    for limit in (at_most(1), at_least(1), exactly(1), Limit("=", nan)):
        assert not limit.holds(nan)
