"""tools/report/integrators.py: what its tables and pictures say is what was run."""

from __future__ import annotations

import json
import sys
from math import inf
from pathlib import Path

import numpy as np
import pytest
from spec import ROOT

from hapfmt.lab.scenes.contact import INTEGRATORS

sys.path.insert(0, str(ROOT / "tools"))

from report import integrator_runs as runs
from report import integrators
from report.section import Options, spread


def test_the_largest_step_from_which_on_an_error_stays_small():
    points = [
        runs.Point("rk4", 1e3, step, error, spread([1.0]))
        for step, error in ((1e-3, 0.005), (5e-4, 0.02), (2e-4, 0.008), (1e-4, 0.001))
    ]
    assert integrators.reached(points, "rk4", 1e3, 1e-2).step_s == 2e-4
    assert integrators.reached(points, "rk4", 1e3, 1e-4) is None
    assert integrators.reached(points, "exact", 1e3, 1e-2) is None


def test_taps_go_on_where_they_were_cut():
    whole = runs.taps(runs.STYLUS, 1e-3, 300)
    tail = runs.taps(runs.STYLUS, 1e-3, 100, first=200)
    for every, last in zip(whole, tail, strict=True):
        assert np.allclose(every[200:], last, rtol=0, atol=1e-12)
    rates = np.gradient(whole.target, 1e-3), np.gradient(whole.surface, 1e-3)
    assert np.abs(rates[0] - whole.target_velocity)[1:-1].max() < 1e-4
    assert np.abs(rates[1] - whole.surface_velocity)[1:-1].max() < 2e-3


def test_naive_and_default_at_100_kilonewtons_a_metre():
    naive = runs.tapping(1e5, "explicit-euler", 2, 1e-3)
    ours = runs.tapping(1e5, "exact", 2)
    assert naive.peak_m == inf and naive.gain == inf
    assert ours.peak_m < 3e-3 and ours.gain == 0
    assert abs(runs.bounce(1e5, "trapezoid", 2).drift) < 1e-10


@pytest.mark.deep
def test_section(monkeypatch):
    monkeypatch.setattr(runs, "LONG_STIFFNESSES", (1e5,))
    monkeypatch.setattr(runs, "REFERENCE", -5)
    monkeypatch.setattr(runs, "QUICK_FINEST", -4)
    found = integrators.section(Options(None, True, Path(), lambda _line: None))
    assert all(len(row) == len(t.headers) for t in found.tables for row in t.rows)
    assert len(found.tables[0].rows) == len(INTEGRATORS)
    assert all(figure.svg.rstrip().endswith("</svg>") for figure in found.figures)
    json.dumps(found.data, allow_nan=False)
    assert "diverged with" not in found.text
