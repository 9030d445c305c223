"""The suite as a distribution of its own: the command hapf-conformance, without hapfmt."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from runner.manifest import load
from suite import CONFORMANCE, ROOT

pytestmark = pytest.mark.deep
ADAPTER = [sys.executable, str(CONFORMANCE / "adapters" / "python")]


def copy_of_the_suite(folder: Path) -> Path:
    """What a clone has of it: a build writes into its folder."""
    ignored = shutil.ignore_patterns("__pycache__", "build", "*.egg-info", "mutants", "js")
    shutil.copytree(CONFORMANCE, folder / "conformance", ignore=ignored)
    shutil.copy(ROOT / "SPEC.md", folder)
    shutil.copytree(ROOT / "docs" / "spec", folder / "docs" / "spec")
    return folder / "conformance"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The wheel, made from the sdist, in an empty environment: its command."""
    room = tmp_path_factory.mktemp("suite")
    source = copy_of_the_suite(room)
    build = "import sys; from setuptools import build_meta as b; print(b.build_{}(sys.argv[1]))"
    pack = [sys.executable, "-c"]
    subprocess.run(
        [*pack, build.format("sdist"), str(room)], cwd=source, check=True, capture_output=True
    )
    (archive,) = room.glob("*.tar.gz")
    shutil.unpack_archive(archive, room / "unpacked")
    (unpacked,) = (room / "unpacked").iterdir()
    subprocess.run(
        [*pack, build.format("wheel"), str(room)], cwd=unpacked, check=True, capture_output=True
    )
    (wheel,) = room.glob("*.whl")
    subprocess.run([sys.executable, "-m", "venv", str(room / "venv")], check=True)
    python = room / "venv" / "bin" / "python"
    subprocess.run(
        [python, "-m", "pip", "install", "-q", "--no-deps", wheel], check=True, capture_output=True
    )
    return str(python.with_name("hapf-conformance"))


def conformance(command: str, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([command, *options], capture_output=True, text=True, check=False, cwd="/")


def test_all_cases_are_in_it(installed):
    told = conformance(installed, "--list").stdout.splitlines()
    assert [line.split(":")[0] for line in told] == [case.id for case in load()]
    folder = Path(conformance(installed, "--where").stdout.strip())
    for name in (
        "README.md",
        "LICENSE",
        "adapters/c/knot.c",
        "components/crc32.json",
        "../SPEC.md",
    ):
        assert (folder / name).is_file(), name


def test_it_runs_an_adapter_of_any_kind(installed, tmp_path):
    """Also the cases that are made when they are run, from tables of SPEC.md."""
    out = tmp_path / "out.json"
    done = conformance(
        installed, "--impl", shlex.join(ADAPTER), "--json", str(out), "--set", "limits",
        "--set", "encode", "--jobs", "2",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "referees: none, so only bytes were checked" in done.stdout
    counts = json.loads(out.read_text())["runs"][0]["counts"]["all"]
    assert counts["passed"] == counts["cases"] > 100


def test_without_an_implementation(installed):
    done = conformance(installed)
    assert (done.returncode, done.stdout) == (2, "")
    assert "No module named 'hapfmt'" in done.stderr
    assert "no implementation runs here; name yours: --impl COMMAND" in done.stderr


def test_a_program_that_fails(installed):
    done = conformance(installed, "--impl", "false")
    assert done.returncode == 2 and "false capabilities: exit code 1" in done.stderr


def test_the_version_is_that_of_the_format():
    project = tomllib.loads((CONFORMANCE / "pyproject.toml").read_text("utf-8"))["project"]
    page = (ROOT / "SPEC.md").read_text("utf-8")
    assert f"\nVersion {project['version'].rpartition('.')[0]} of " in page
