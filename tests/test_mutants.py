"""Programs with one mistake each: their list, and that cases kill some of them. The whole quick run
is a step of its own (.ci/run)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOM = ROOT / "conformance"
sys.path.append(str(ROOM))
from mutants import MUTANTS, table  # noqa: E402
from mutants.matrix import JAVASCRIPT, ROOT  # noqa: E402
from mutants.mutant import Edit, NotApplicableError, Rebind, edited, function_of, mutant  # noqa: E402
from runner.manifest import load, rules  # noqa: E402

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants need fork")
ENOUGH = 25
SOME = ("lines-truncate", "header-crc-ignored", "recover-not-closed", "overlong-varint-written")


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOM / "mutants" / "run.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


class TestList:
    def test_names_are_given_once(self):
        twice = [name for name, count in Counter(m.name for m in MUTANTS).items() if count > 1]
        assert len(MUTANTS) >= ENOUGH
        assert not twice

    def test_each_breaks_rules_that_there_are(self):
        known = set(rules())
        for each in MUTANTS:
            assert each.requirements, each.name
            assert set(each.requirements) <= known, each.name

    def test_each_says_what_is_wrong_in_a_sentence(self):
        for each in MUTANTS:
            assert each.about[0].isupper(), each.name
            assert each.about.endswith("."), each.name
            assert each.role in ("decoder", "verifier", "recoverer", "encoder"), each.name
            assert each.language in ("python", "javascript"), each.name

    def test_each_changes_something(self):
        for each in MUTANTS:
            assert each.changes, each.name
            for change in each.changes:
                assert isinstance(change, Rebind) or change.old != change.new, each.name

    def test_each_finds_the_lines_that_it_changes(self):
        for each in MUTANTS:
            places: dict[str, list[Edit]] = {}
            for change in each.changes if each.language == "python" else ():
                if isinstance(change, Edit):
                    places.setdefault(change.place, []).append(change)
            for place, edits in places.items():
                function = function_of(place)
                assert edited(function, edits) != function.__code__, each.name

    def test_lines_of_javascript_too(self, tmp_path):
        for each in MUTANTS:
            if each.language == "javascript":
                decoder = ROOT / JAVASCRIPT / "decoder"
                copy = shutil.copytree(decoder, tmp_path / each.name)
                each.apply_to(copy)
                assert any(
                    (copy / change.place).read_text("utf-8")
                    != (decoder / change.place).read_text("utf-8")
                    for change in each.changes
                ), each.name

    def test_a_line_that_is_gone_is_an_error(self):
        lost = mutant("lost", "Nothing.", "CNV-001", Edit("numbers:rdiv", "no such line", ""))
        nowhere = replace(lost, changes=(Edit("numbers:no_such_function", "a", "b"),))
        for each in (lost, nowhere):
            with pytest.raises(NotApplicableError):
                each.apply()


class TestPage:
    def test_it_has_every_mutant_killed(self):
        page = table.PAGE.read_text("utf-8")
        first = table.first_killers()
        known = {case.id for case in load()}
        assert first.keys() == {each.name for each in MUTANTS}
        assert set(first.values()) <= known
        for each in MUTANTS:
            rules_of = ", ".join(each.requirements)
            assert f"| `{each.name}` | {each.about} | {rules_of} |" in page, each.name
        assert f"{len(MUTANTS)} of {len(MUTANTS)} mutants are killed" in page


class TestMatrix:
    @pytest.mark.deep
    def test_cases_kill_some(self, tmp_path):
        chosen = [word for name in SOME for word in ("--mutant", name)]
        done = run("--quick", "--json", tmp_path / "out.json", *chosen)
        assert done.returncode == 0, done.stdout + done.stderr
        found = json.loads((tmp_path / "out.json").read_text("utf-8"))["mutants"]
        assert {each["name"] for each in found} == set(SOME)
        assert all(each["killed"] and len(each["killers"]) == 1 for each in found)

    def test_a_survivor_is_told(self):
        done = run("--mutant", "header-crc-ignored", "--case", "valid/minimal")
        assert done.returncode == 1
        assert "SURVIVED header-crc-ignored" in done.stdout
        assert "0 of 1 killed" in done.stdout
