"""tools/mutate.py: every mutant of a module, and which of them the tests of it kill."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location

import pytest
from spec import ROOT

pytest.importorskip("resource", reason="the tool needs POSIX")

TOOL = ROOT / "tools" / "mutate.py"

SOURCE = '''
"""A text is no statement."""
LIMIT: int = 3

def fitting(values: list[int], low: int = 0) -> int:
    """So is this."""
    found = 0
    for value in values:
        if low <= value and not value == LIMIT:
            found += max(-value, 1)
    if found:
        return found
    raise ValueError(f"none of {len(values) - 1}")
'''

CHANGES = """
3 3 -> 4
3 3 -> 2
5 0 -> 1
5 0 -> -1
7 without found = 0
7 0 -> 1
7 0 -> -1
9 low <= value and (not value == LIMIT) -> low <= value or not value == LIMIT
9 without low <= value
9 without not value == LIMIT
9 low <= value -> low < value
9 low <= value -> low > value
9 not value == LIMIT -> value == LIMIT
9 value == LIMIT -> value != LIMIT
10 found += max(-value, 1) -> found -= max(-value, 1)
10 without found += max(-value, 1)
10 max(-value, 1) -> min(-value, 1)
10 -value -> value
10 1 -> 2
10 1 -> 0
11 found -> not found
12 return found -> return None
13 without raise ValueError(f'none of {len(values) - 1}')
"""


@pytest.fixture(scope="module")
def mutants():
    """The tool as a module."""
    sys.path.insert(0, str(ROOT / "tools"))
    spec = spec_from_file_location("mutants_of_a_module", TOOL)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.path.remove(str(ROOT / "tools"))
    return module


def test_every_change(mutants):
    found = mutants.mutants_of(SOURCE)
    assert [f"{one.line} {one.change}" for one in found] == CHANGES.strip().split("\n")


@pytest.mark.deep
def test_every_mutant_is_another_program(mutants):
    path = ROOT / "hapfmt" / "replay" / "schedule.py"
    source = path.read_text("utf-8")
    codes = [one.code for one in mutants.mutants_of(source, str(path))]
    assert len(codes) > 100
    assert compile(ast.parse(source), str(path), "exec") not in codes
    assert len(set(codes)) > 0.95 * len(codes)  # a < 1 and a < 0 + 1


def run(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(TOOL), *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.deep
class TestARun:
    MODULE = "hapfmt/replay/schedule.py"

    def test_a_sample(self):
        words = (self.MODULE, "--tests", "tests/test_replay_schedule.py", "--sample", "6")
        done = run(*words, "--seed", "3")
        assert done.returncode == 0, done.stderr
        (row,) = re.findall(r"all \| +(\d+) \| +(\d+) \| +(\d+) \|", done.stdout)
        assert sum(map(int, row)) == 6 and int(row[0]) > 0
        assert done.stdout.count(self.MODULE) == int(row[2])
        assert "6 mutants in" in done.stdout

    def test_tests_that_fail_without_a_mutant(self):
        done = run(self.MODULE, "--tests", "tests/no_such_test.py")
        assert done.returncode == 1
        assert "the tests fail without a mutant" in done.stderr
