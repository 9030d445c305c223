"""Tests of real time are run again where the machine stood still, and only there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from spec import ROOT

CONFTEST = """
import sys
sys.path.insert(0, {tests!r})
import stalls
stalls.STALL_S, stalls.TURN_S = {limit}, 0.005

def pytest_runtest_protocol(item, nextitem):
    stalls.run(item, nextitem)
    return True
"""
TESTS = """
import pytest
turns = []

@pytest.fixture(scope="module")
def turn():
    turns.append(len(turns))
    return turns[-1]

def test_that_fails_at_first(turn, tmp_path):
    assert not list(tmp_path.iterdir())
    (tmp_path / "left").touch()
    assert turn == {passes}

def test_that_passes(turn): ...
"""


@pytest.mark.parametrize(
    ("limit", "passes", "said"),
    [
        (0.0, 2, "2 passed"),
        pytest.param(0.0, 6, "1 failed, 1 passed", marks=pytest.mark.deep),
        (60.0, 1, "1 failed, 1 passed"),
    ],
)
def test_a_test_runs_again_where_the_machine_stood_still(limit, passes, said, tmp_path: Path):
    """With new fixtures, a few times; a machine that kept time has no second try."""
    (tmp_path / "conftest.py").write_text(CONFTEST.format(tests=str(ROOT / "tests"), limit=limit))
    (tmp_path / "test_it.py").write_text(TESTS.format(passes=passes))
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:hypothesispytest"]
    done = subprocess.run(
        [sys.executable, *words, str(tmp_path)], cwd=tmp_path, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert said in done.stdout, done.stdout + done.stderr
