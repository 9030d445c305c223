"""README: every command and line of Python of its tour runs, with the output that it shows."""

from __future__ import annotations

import doctest
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

README = Path(__file__).resolve().parent.parent / "README.md"
BLOCK = re.compile(r"```(console|python)\n(.*?)```", re.S)


def blocks(kind: str) -> list[str]:
    return [body for name, body in BLOCK.findall(README.read_text("utf-8")) if name == kind]


def commands(block: str) -> list[tuple[str, str]]:
    """(command, the output shown below it)"""
    parts = re.split(r"^\$ (.*)\n", block, flags=re.M)
    assert parts[0] == ""
    return list(zip(parts[1::2], parts[2::2], strict=True))


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory in which the tour has been walked."""
    folder = tmp_path_factory.mktemp("tour")
    (folder / "bin").mkdir()
    script = folder / "bin" / "hapfmt"
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m hapfmt "$@"\n')
    script.chmod(0o755)
    return folder


@pytest.mark.skipif(os.name == "nt", reason="the tour is written for a POSIX shell")
def test_tour_of_commands_then_of_python(room: Path) -> None:
    environment = {**os.environ, "PATH": f"{room / 'bin'}:{os.environ['PATH']}"}
    checker = doctest.OutputChecker()
    for command, shown in [pair for block in blocks("console") for pair in commands(block)]:
        done = subprocess.run(
            ["sh", "-c", command],
            cwd=room,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        if shown:
            assert checker.check_output(shown, done.stdout, doctest.ELLIPSIS), (
                f"{command}\n{done.stdout}"
            )
    before = Path.cwd()
    os.chdir(room)
    try:
        names: dict[str, object] = {}
        for block in blocks("python"):
            exec(compile(block, str(README), "exec"), names)
    finally:
        os.chdir(before)


def test_tour_shows_every_verb() -> None:
    from hapfmt.cli import VERBS

    text = " ".join(blocks("console"))
    assert [verb for verb in VERBS if f"hapfmt {verb}" not in text] == ["dump"]
