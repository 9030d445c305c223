"""Examples that the site shows and no other test runs: docstrings, and conformance/README.md."""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from textwrap import dedent
from typing import Any

import jsonschema
import numpy as np
import pytest
from spec import ROOT

import hapfmt

MODULES = ["hapfmt", "hapfmt.edit", "hapfmt.metrics", "hapfmt.lab.scenes"]
SUITE = ROOT / "conformance"
PAGE = (SUITE / "README.md").read_text("utf-8")


def public() -> Iterator[tuple[str, Any]]:
    """Modules, their public names, and the public members of classes."""
    for name in MODULES:
        module = import_module(name)
        yield name, module
        for each in getattr(module, "__all__", ()):
            found = getattr(module, each)
            if not inspect.isclass(found):
                yield f"{name}.{each}", found
                continue
            yield f"{name}.{each}", found
            for member, value in vars(found).items():
                if not member.startswith("_"):
                    plain = getattr(value, "fget", None) or getattr(value, "__func__", value)
                    yield f"{name}.{each}.{member}", plain


def examples() -> Iterator[Any]:
    """Indented blocks below an empty line: code, as Markdown has it."""
    for name, thing in public():
        text = inspect.cleandoc(thing.__doc__ or "") if hasattr(thing, "__doc__") else ""
        for block in re.findall(r"\n\n((?:    .*(?:\n|\Z)|\n)+)", text):
            yield pytest.param(dedent(block), id=name)


def test_examples_are_found() -> None:
    assert [each.id for each in examples()].count("hapfmt.Recorder") == 1


@pytest.mark.parametrize("code", [*examples()])
def test_a_docstring_runs(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    time = np.arange(25_000) / 1000
    array = np.stack([np.sin(time), np.cos(time)])
    labels = ["fx", "fy"] if "fy" in code else ["fx", "force_z"]
    for name in ("touch", "a", "b", "long"):
        if f'"{name}.hapf"' in code and "Recorder" not in code:
            hapfmt.write(array, f"{name}.hapf", rate=1000, labels=labels, units="N")
    counts = np.arange(2000, dtype=np.int32)
    names = {name: getattr(hapfmt, name) for name in ("Input", "Recorder", "Calibration")}
    values = {"array": array, "counts": counts, "f": array[0], "y": array[0] + 0.01}
    exec(code, {**names, **values, "hapfmt": hapfmt})


@pytest.mark.deep
@pytest.mark.skipif(os.name == "nt", reason="the adapter is a shell script")
def test_the_first_adapter_of_the_conformance_page(tmp_path: Path) -> None:
    """It answers with the JSON of the page, and the program prints the first line of the page."""
    (block,) = re.findall(r"^```json\n(.*?)^```$", PAGE, re.S | re.M)
    schema = json.loads((SUITE / "schemas" / "capabilities.schema.json").read_text("utf-8"))
    jsonschema.validate(json.loads(block), schema)
    adapter = tmp_path / "mine"
    adapter.write_text(
        f"#!/bin/sh\nif [ \"$1\" = capabilities ]; then cat <<'E'\n{block}E\nexit\nfi\n"
        f'exec "{sys.executable}" "{SUITE / "adapters" / "python"}" "$@"\n'
    )
    adapter.chmod(0o755)
    words = ["--impl", str(adapter), "--set", "valid", "--case", "knot-linear*"]
    done = subprocess.run(
        [sys.executable, str(SUITE / "run.py"), *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (shown,) = re.findall(r"^\$ hapf-conformance [^\n]*\n(.*?)^```$", PAGE, re.S | re.M)
    first = shown.splitlines()[0]
    assert first in done.stdout
    counted = [int(n) for n in re.findall(r"^valid .*$", shown, re.M)[0].split()[1:]]
    cases = json.loads((SUITE / "manifest.json").read_text("utf-8"))["cases"]
    total = sum(case["set"] == "valid" for case in cases)
    assert counted[0] == total == sum(counted[1:])
    (failed,) = re.findall(r"^FAILED valid/(\S+): (.*)$", shown, re.M)
    assert failed in [(case["name"], case["about"]) for case in cases]
