"""The pages a user reads, README.md and docs: their prose and the blocks that run."""

from __future__ import annotations

import doctest
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import commands
from spec import ROOT

README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").glob("**/*.md"))]
BLOCK = re.compile(r"^ *```(\w*) *(\w*)[^\n]*\n(.*?)^ *```$", re.S | re.M)
SHELL = re.compile(r"[|<>;&$*`\\]")
WIDTH = 80


class Block(NamedTuple):
    kind: str
    needs: str
    """A module: without it, the block is not run."""
    body: str


class Command(NamedTuple):
    line: str
    shown: str
    """The output that the page shows."""


def blocks(page: Path) -> list[Block]:
    return [Block(*found) for found in BLOCK.findall(page.read_text("utf-8"))]


def commands_of(block: Block) -> list[Command]:
    parts = re.split(r"^\$ (.*)\n", block.body, flags=re.M)
    assert parts[0] == "", f"output without a command: {parts[0]}"
    return [Command(*pair) for pair in zip(parts[1::2], parts[2::2], strict=True)]


def walk(page: Path, room: Path, run: Callable[[Command, Path], None], python: bool = True) -> None:
    """Runs the commands and the Python of a page, in its order, in the folder ``room``."""
    names: dict[str, object] = {"__name__": page.stem}
    before = Path.cwd()
    for block in blocks(page):
        if block.kind == "console":
            for command in commands_of(block):
                run(command, room)
        elif block.kind == "python" and python and installed(block.needs):
            os.chdir(room)
            try:
                exec(compile(block.body, str(page), "exec"), names)
            finally:
                os.chdir(before)


def installed(module: str) -> bool:
    return not module or find_spec(module) is not None


def run_shown(command: Command, room: Path) -> None:
    """The exit code is 0, and a terminal of 80 columns prints what the page shows."""
    code, out, err = printed(command, room)
    assert code == 0, f"$ {command.line}\n{out}{err}"
    if command.shown:
        same = doctest.OutputChecker().check_output(
            shape(command.shown), shape(out), doctest.ELLIPSIS
        )
        assert same, f"$ {command.line}\n{out}{err}\n--- the page shows\n{command.shown}"
        for then, now in sizes_in(command.shown, out):
            near = abs(then - now) <= max(0.1 * now, 100)
            assert near, f"$ {command.line}\n{now} bytes, the page shows {then}"


def sizes_in(shown: str, out: str) -> list[tuple[int, int]]:
    """Bytes that the page shows, and those of today, where all of the output is shown."""
    texts = [re.findall(r"(\d+) bytes", text) for text in (shown, out)]
    pairs = zip(*texts, strict=True) if len(texts[0]) == len(texts[1]) else ()
    return [(int(then), int(now)) for then, now in pairs]


def printed(command: Command, room: Path) -> tuple[int, str, str]:
    """The exit code, standard output in a terminal, standard error in a file."""
    words = simple(command)
    if words is not None:
        done = commands.run_to_terminal(*words, cwd=room, columns=WIDTH)
    else:
        done = subprocess.run(
            ["sh", "-c", command.line], cwd=room, env=environment(room), capture_output=True,
            stdin=subprocess.DEVNULL, check=False,
        )  # fmt: skip
    return done.returncode, seen(done.stdout.decode()), done.stderr.decode()


def run_in_terminal(command: Command, room: Path) -> None:
    """With all streams on a terminal: the same exit code, and what is printed fits it."""
    words = simple(command)
    assert words is not None, f"needs a shell: {command.line}"
    done = commands.run_in_terminal(*words, cwd=room, columns=WIDTH)
    text = seen(done.stdout.decode())
    assert done.returncode == 0, f"$ {command.line}\n{text}"
    assert "Traceback" not in text, text
    wide = [line for line in text.splitlines() if len(line) > WIDTH]
    assert not wide, f"$ {command.line}\n" + "\n".join(wide)


def run_piped(command: Command, room: Path) -> None:
    """With files as streams."""
    words = simple(command)
    assert words is not None, f"needs a shell: {command.line}"
    done = commands.run(*words, cwd=room)
    assert done.returncode == 0, f"$ {command.line}\n{done.stderr.decode()}"


def shape(text: str) -> str:
    """What has to be equal: all but numbers, and where lines break."""
    text = re.sub(r"[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", "#", text)
    text = re.sub(r"(?<!exit code )(?<![\w.])-?\d[\d.]*(e-?\d+)?", "#", text)
    text = re.sub(r",\s+in\s+# s\b|─", "", text)
    return " ".join(text.split()) + "\n"


def seen(printed: str) -> str:
    """Without colours and cursor movements; each overwriting of a line is a line."""
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", printed).replace("\r\n", "\n").replace("\r", "\n")


def simple(command: Command) -> list[str] | None:
    """The arguments of hapfmt, where a command runs nothing else and needs no shell."""
    words = shlex.split(command.line, comments=True)
    if words[0] != "hapfmt" or SHELL.search(re.sub(r"'[^']*'", "", command.line)):
        return None
    return words[1:]


def environment(room: Path) -> dict[str, str]:
    """With ``hapfmt`` as a command."""
    folder = room / ".bin"
    if not folder.exists():
        folder.mkdir()
        script = folder / "hapfmt"
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m hapfmt "$@"\n')
        script.chmod(0o755)
    kept = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    return {**kept, "PATH": f"{folder}:{os.environ['PATH']}"}


def renew(page: Path) -> None:
    """Puts the output of today below each command that shows all of its output."""
    text = page.read_text("utf-8")

    def run(command: Command, room: Path) -> None:
        nonlocal text
        code, out, err = printed(command, room)
        assert code == 0, f"$ {command.line}\n{out}{err}"
        if command.shown and "..." not in command.shown:
            now = "".join(f"{line.rstrip()}\n" for line in out.strip("\n").splitlines())
            shown = f"$ {command.line}\n{command.shown}"
            text = text.replace(shown, f"$ {command.line}\n{now}", 1)

    with tempfile.TemporaryDirectory() as folder:
        walk(page, Path(folder), run)
    page.write_text(text, "utf-8")


if __name__ == "__main__":  # python tests/pages.py docs/inspect.md ...
    for name in sys.argv[1:]:
        renew(Path(name).resolve())
