"""conformance/vectors and conformance/expected: made by conformance/gen alone, and hapfmt decodes
those of whole files as they say."""

from __future__ import annotations

import ast
import importlib
import json
import re
import sys
from pathlib import Path
from typing import Any

import case
import make
import pytest
from depth import sample
from hapfmt_adapter.verbs import CAPABILITIES, run
from spec import REQUIREMENTS

CONFORMANCE = Path(make.__file__).resolve().parent.parent
sys.path.insert(0, str(CONFORMANCE))
from runner.compare import decode_differences, verify_differences  # noqa: E402

MANIFEST = json.loads((CONFORMANCE / "manifest.json").read_bytes())["cases"]
WHOLE = [f"{entry['set']}/{entry['name']}" for entry in MANIFEST if entry["set"] in case.SETS[:2]]


SLOW = "render"
"""The module of conformance/gen/sets that takes longer than all others."""


@pytest.mark.deep
def test_what_is_committed_is_what_is_made() -> None:
    assert make.differences(dict(make.files(make.all_cases()))) == []


def test_what_is_committed_is_what_the_quick_modules_make() -> None:
    modules = sorted((CONFORMANCE / "gen" / "sets").glob("[a-z]*.py"))
    assert SLOW in {path.stem for path in modules}
    count = 0
    for path in modules:
        if path.stem != SLOW:
            cases = list(importlib.import_module(f"sets.{path.stem}").cases())
            wanted = dict(make.files(cases))
            del wanted["manifest.json"]
            for name, data in wanted.items():
                assert (CONFORMANCE / name).read_bytes() == data, name
            count += len(cases)
    assert count > 0.9 * len(MANIFEST)


def test_files_are_small() -> None:
    files = [path for name in ("vectors", "expected") for path in (CONFORMANCE / name).rglob("*.*")]
    assert len(files) > len(WHOLE)
    assert [path.name for path in files if path.stat().st_size > 64 << 10] == []


def test_the_generator_needs_the_standard_library_alone() -> None:
    folder = CONFORMANCE / "gen"
    modules = sorted(folder.rglob("*.py"))
    own = {path.relative_to(folder).with_suffix("").parts[0] for path in modules}
    own |= {path.stem for path in modules} | {"spec"}  # tests/spec.py, for the table of coverage
    for path in modules:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            others = {name.split(".")[0] for name in names} - own - sys.stdlib_module_names
            assert not others, f"{path.name} imports {others}"


def test_cases_say_what_they_are() -> None:
    """A name of words and a sentence, and rules that there are."""
    for entry in MANIFEST:
        assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", entry["name"])
        assert entry["about"][0].isupper() or not entry["about"][0].isalpha(), entry["name"]
        assert set(entry["requirements"]) <= REQUIREMENTS.keys(), entry["name"]


def test_the_worked_examples_are_cases() -> None:
    for path in sorted((CONFORMANCE / "examples").glob("*.hapf")):
        if path.stem in ("salvaged", "table"):  # the sets of damaged files have more of that
            continue
        twin = CONFORMANCE / "vectors" / "valid" / f"example-{path.name}"
        assert twin.read_bytes() == path.read_bytes()


def expectation(name: str) -> dict[str, Any]:
    return json.loads((CONFORMANCE / "expected" / f"{name}.json").read_bytes())


@pytest.mark.parametrize("name", sample(WHOLE))
def test_whole_files_decode_as_expected(name: str, tmp_path: Path) -> None:
    source, expect = CONFORMANCE / "vectors" / f"{name}.hapf", expectation(name)
    assert run(["decode", str(source), str(tmp_path)]) == expect["exit"]["decode"]
    found = json.loads((tmp_path / "decode.json").read_bytes())
    parts = CAPABILITIES["parts"]
    assert decode_differences(expect["decode"], found, lambda n: (tmp_path / n).read_bytes(),
                              parts) == []  # fmt: skip
    report = tmp_path / "report"
    assert run(["verify", str(source), str(report)]) == expect["exit"]["verify"]
    assert verify_differences(expect, json.loads(report.read_bytes()), parts) == []
