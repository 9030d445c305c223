"""tools/: programs measure the installed hapfmt, or stop and say why; quick ones run."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import commands
import numpy as np
import pytest
from spec import ROOT

import hapfmt
from hapfmt.kernels import compiled

MEASURE_NOTHING = {"installed.py", "sanitize.py", "spec_tables.py"}
"""sanitize.py builds its own copy; spec_tables.py prints the layouts of the clone."""


def scripts() -> list[Path]:
    found = sorted((ROOT / "tools").glob("*.py")) + sorted((ROOT / "tools").glob("*/__main__.py"))
    return [
        path
        for path in found
        if path.name not in MEASURE_NOTHING and "__main__" in path.read_text("utf-8")
    ]


def entry(path: Path) -> str:
    """The program that a path names, a file or a folder; empty where it is none."""
    main = path / "__main__.py" if path.is_dir() else path
    return main.read_text("utf-8") if main.suffix == ".py" and main.exists() else ""


@pytest.fixture
def clone(tmp_path):
    """A clone without compiled loops, in which nothing was installed in place."""
    folder = tmp_path / "clone"
    left_out = shutil.ignore_patterns("*.so", "*.pyd", "__pycache__")
    for name in ("tools", "hapfmt"):
        shutil.copytree(ROOT / name, folder / name, ignore=left_out)
    return folder


@pytest.fixture
def site(tmp_path):
    """What `pip install .` leaves: a copy of the package with its loops, and its metadata."""
    folder = tmp_path / "site"
    package = Path(hapfmt.__file__).parent
    shutil.copytree(package, folder / "hapfmt", ignore=shutil.ignore_patterns("__pycache__"))
    metadata = folder / "hapfmt-0.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: hapfmt\nVersion: 0.0\n")
    (metadata / "direct_url.json").write_text(json.dumps({"url": "file:///x", "dir_info": {}}))
    return folder


def run(*words: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "HAPFMT_PURE")}
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, capture_output=True, text=True, check=False,
        env={**kept, **environment},
    )  # fmt: skip


class TestAfterAnInstallationThatIsNotInPlace:
    @pytest.mark.deep
    def test_a_report_measures_the_installed_copy(self, clone, site, tmp_path):
        out = tmp_path / "out"
        words = ("--quick", "--only", "paper", "--no-data", "-o", str(out))
        given = {"PYTHONPATH": str(site), **({} if compiled else {"HAPFMT_PURE": "1"})}
        done = run("tools/report", *words, cwd=clone, **given)
        assert done.returncode == 0, done.stderr
        on = json.loads((out / "report.json").read_text("utf-8"))["on"]
        assert "an installed copy of this commit" in on
        assert ("compiled loops" if compiled else "readable Python loops") in on

    def test_other_code_than_the_clone_is_said(self, clone, site):
        (clone / "hapfmt" / "version.py").write_text('__version__ = "9"\n')
        given = {"PYTHONPATH": str(site), **({} if compiled else {"HAPFMT_PURE": "1"})}
        done = run("tools/installed.py", cwd=clone, **given)
        assert done.returncode == 0, done.stderr
        assert "commit unknown, an installed copy with other code than this clone" in done.stdout
        assert "hapfmt 9" not in done.stdout

    def test_no_loops_no_timings(self, clone, site):
        for path in (site / "hapfmt" / "kernels").glob("_kernels*"):
            if path.suffix in (".so", ".pyd"):
                path.unlink()
        done = run("tools/bench.py", cwd=clone, PYTHONPATH=str(site))
        assert done.returncode == 1 and not done.stdout
        assert "no compiled loops" in done.stderr
        assert "python -m pip install --force-reinstall --no-deps -e ." in done.stderr
        asked = run("tools/installed.py", cwd=clone, PYTHONPATH=str(site), HAPFMT_PURE="1")
        assert asked.returncode == 0 and "readable Python loops" in asked.stdout


def test_without_an_installation_the_command_is_named(clone):
    """-S: no packages at all, so that this is the first import that can fail."""
    for script in ("bench.py", "report"):
        done = run("-S", f"tools/{script}", cwd=clone)
        assert done.returncode == 1 and not done.stdout
        assert done.stderr.count("\n") == 1
        assert "hapfmt is not installed" in done.stderr
        assert "python -m pip install -e '.[bench]'" in done.stderr


@pytest.mark.parametrize("path", scripts(), ids=lambda path: str(path.relative_to(ROOT / "tools")))
def test_every_tool_chooses_its_hapfmt_first(path):
    """The first import that is not of the standard library is that of tools/installed.py."""
    tree = ast.parse(path.read_text("utf-8"))
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names.append((node.lineno, node.module or ""))
    first = next(
        name for _, name in sorted(names) if name.partition(".")[0] not in sys.stdlib_module_names
    )
    assert first == "installed"


@pytest.mark.parametrize(
    "path",
    [path for path in (ROOT / "tools").glob("*") if "__main__" in entry(path)],
    ids=lambda path: path.name,
)
def test_help_says_what_a_program_does_and_does_nothing(path, tmp_path):
    """manpages.py once wrote its pages into a folder that it called --help."""
    done = commands.run_program(path, "--help", cwd=tmp_path)
    assert done.returncode == 0, done.stderr.decode()
    told = done.stdout.decode()
    assert "usage" in told.lower() or f"python tools/{path.name}" in told
    assert list(tmp_path.iterdir()) == []


def test_the_page_lists_every_program():
    page = (ROOT / "docs" / "measuring.md").read_text("utf-8")
    programs = {
        path.name for path in (ROOT / "tools").glob("*.py") if "__main__" in path.read_text("utf-8")
    }
    folders = {path.parent.name for path in (ROOT / "tools").glob("*/__main__.py")}
    assert set(re.findall(r"`tools/(\w+(?:\.py)?)\b", page)) == programs | folders


@pytest.mark.parametrize(
    ("words", "printed"),
    [
        (["scenes.py", "--keys"], "| `travel_s` |"),
        (["load.py", "--seconds", "1", "--channels", "2"], "lossless"),
        *(
            pytest.param(
                ["load.py", "--seconds", "1", "--channels", "2", "--preset", preset],
                preset,
                marks=pytest.mark.deep,
            )
            for preset in ("perceptual", "near-lossless")
        ),
        pytest.param(["texture_rates.py", "--quick"], "simulated sand", marks=pytest.mark.deep),
        (["messages.py", "--quick"], "| wrench and joints, 27 channels |"),
        (["throughput.py", "--quick"], "exact values, recall, readable"),
        (["overview.py", "--seconds", "4", "--fast-only"], "smallest bin"),
        pytest.param(["lazy.py", "--seconds", "20"], "by URL", marks=pytest.mark.deep),
        pytest.param(
            ["archives.py", "--files", "5", "--megabytes", "2", "--jobs", "1"],
            "3 files were damaged; exactly these are reported",
            marks=pytest.mark.deep,
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_runs(words, printed):
    """Each program that has an option for a few seconds of work."""
    if words[0] in ("throughput.py", "archives.py"):
        pytest.importorskip("soundfile")
    if words[0] == "lazy.py":
        pytest.importorskip("xarray")
        pytest.importorskip("aiohttp")
    done = commands.run_program(ROOT / "tools" / words[0], *words[1:], cwd=ROOT)
    assert done.returncode == 0, done.stderr.decode()
    assert printed in done.stdout.decode()


def test_presets_run(tmp_path):
    time = np.arange(200) / 1000
    hapfmt.save(np.sin(40 * time), tmp_path / "sine.npz", rate=1000, labels=["fx"], units="N")
    done = commands.run_program(ROOT / "tools" / "presets.py", tmp_path, cwd=ROOT)
    assert done.returncode == 0, done.stderr.decode()
    told = re.sub(" +", " ", done.stdout.decode())
    assert all(f"| `{preset}` |" in told for preset in ("lossless", "paper"))


def test_fuzzing_names_its_package():
    if find_spec("atheris") is not None:
        pytest.skip("atheris is installed")
    done = run(str(ROOT / "tools" / "fuzz.py"), "header", cwd=ROOT)
    assert done.returncode == 1
    assert done.stderr.splitlines() == ["fuzzing needs atheris: python -m pip install -e '.[fuzz]'"]


@pytest.mark.compiled
def test_the_way_of_a_sample_grows_no_longer():
    """tools/trace.py counts the functions and files between .npz and .hapf, there and back."""
    done = run("tools/trace.py", cwd=ROOT)
    assert done.returncode == 0, done.stderr
    found = re.findall(r"(there|back): ([0-9]+) functions in ([0-9]+) files", done.stdout)
    longest = {"there": (298, 37), "back": (241, 31)}
    assert [way for way, *_ in found] == list(longest)
    for way, functions, files in found:
        assert (int(functions), int(files)) <= longest[way] and int(files) <= longest[way][1]
