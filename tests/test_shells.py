"""Completion in real shells, and manual pages as man(1) shows them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
from spec import ROOT

from hapfmt.cli import cli

SHELLS = {
    "bash": (["--noprofile", "--norc", "-i"], 'eval "$(_HAPFMT_COMPLETE=bash_source hapfmt)"'),
    "zsh": (
        ["-f", "-i"],
        'autoload -Uz compinit; compinit -u -D; eval "$(_HAPFMT_COMPLETE=zsh_source hapfmt)"',
    ),
    "fish": (["--no-config", "-i"], "_HAPFMT_COMPLETE=fish_source hapfmt | source"),
}
TYPED = {
    "hapfmt enco": "hapfmt encode",
    "hapfmt archive cata": "hapfmt archive catalogue",
    "hapfmt encode --keep-s": "hapfmt encode --keep-stamps",
    "hapfmt encode --preset near": "hapfmt encode --preset near-lossless",
    "hapfmt scene gra": "hapfmt scene grasp",
    "hapfmt info touch": "hapfmt info touching.hapf",
    "hapfmt verify a --against touch": "hapfmt verify a --against touching.hapf",
}
PATIENCE = 30.0


class TestCompletion:
    @pytest.mark.deep
    @pytest.mark.parametrize("shell", SHELLS)
    def test_a_tab_completes_the_line(self, shell, tmp_path):
        """Each line is typed into a terminal, with a tab, and written to a file as the shell has
        it."""
        pytest.importorskip("pty")
        program = shutil.which(shell)
        if program is None:
            pytest.skip(f"no {shell} here")
        (tmp_path / "touching.hapf").touch()
        words, setup = SHELLS[shell]
        bin_folder = Path(sys.executable).parent
        environment = {
            "PATH": f"{bin_folder}{os.pathsep}{os.environ['PATH']}",
            "HOME": str(tmp_path),
            "TERM": "xterm",
        }
        spawn = "import pty, sys; pty.spawn(sys.argv[1:])"
        with (tmp_path / "screen").open("wb") as screen:
            process = subprocess.Popen(
                [sys.executable, "-c", spawn, program, *words], cwd=tmp_path, env=environment,
                stdin=subprocess.PIPE, stdout=screen, stderr=screen, start_new_session=True,
            )  # fmt: skip
        try:
            typed(process, f"{setup}; echo ready > ready\r", tmp_path / "ready")
            for number, (line, whole) in enumerate(TYPED.items()):
                # Ctrl-A and Ctrl-E: to the start and the end of the line.
                out = tmp_path / f"line-{number}"
                keys = f"{line}\t\x01echo \x05 > {out.name}\r"
                assert typed(process, keys, out).split() == whole.split()
        finally:
            process.kill()
            process.communicate()

    def test_every_text_without_choices_completes_to_names_of_files(self):
        """Verbs of groups too."""
        texts = 0
        for command in all_commands(cli, click.Context(cli, info_name="hapfmt")):
            context = click.Context(command)
            for param in command.params:
                if isinstance(param.type, click.types.StringParamType):
                    (found,) = param.shell_complete(context, "to")
                    assert (found.type, found.value) == ("file", "to")
                    texts += 1
        assert texts > 100


def typed(process: subprocess.Popen[bytes], keys: str, out: Path) -> str:
    """Types the keys; what they make the shell write into the file."""
    process.stdin.write(keys.encode())
    process.stdin.flush()
    stop = time.monotonic() + PATIENCE
    while time.monotonic() < stop and process.poll() is None:
        if out.exists() and (text := out.read_text("utf-8")).endswith("\n"):
            return text
        time.sleep(0.02)
    raise AssertionError((out.parent / "screen").read_text("utf-8", errors="replace"))


def all_commands(command: click.Command, context: click.Context) -> list[click.Command]:
    found = [command]
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            verb = command.get_command(context, name)
            assert verb is not None
            found += all_commands(verb, click.Context(verb, parent=context, info_name=name))
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Of manual pages."""
    folder = tmp_path_factory.mktemp("man") / "man1"
    subprocess.run(
        [sys.executable, ROOT / "tools" / "manpages.py", folder], check=True,
        stdout=subprocess.DEVNULL, env={**os.environ, "SOURCE_DATE_EPOCH": "0"},
    )  # fmt: skip
    return folder


class TestManualPages:
    def test_each_verb_has_a_page_with_its_options(self, folder):
        commands = all_commands(cli, click.Context(cli, info_name="hapfmt"))
        pages = {path.stem: path.read_text("utf-8") for path in folder.iterdir()}
        assert len(pages) == len(commands)
        assert all(" 1 1970-01-01 hapfmt" in text for text in pages.values())
        encode = pages["hapfmt-encode"]
        for param in cli.get_command(click.Context(cli), "encode").params:
            if isinstance(param, click.Option) and not param.hidden:
                assert param.opts[-1].replace("-", "\\-") in encode

    def test_each_verb_has_its_exit_status_and_the_short_help_option(self, folder):
        pages = {path.stem: path.read_text("utf-8") for path in folder.iterdir()}
        assert all(".B \\-h, \\-\\-help\n" in text for text in pages.values())
        for name, text in pages.items():
            found = text.partition(".SH EXIT STATUS\n")[2].partition(".SH")[0]
            assert (".B 0\ndone" in found) == (name != "hapfmt"), name
            assert (".B 6\ndevice lost" in found) == name.startswith(
                ("hapfmt-replay", "hapfmt-study")
            )

    def test_mandoc_finds_no_fault(self, folder):
        program = shutil.which("mandoc")
        if program is None:
            pytest.skip("no mandoc here")
        done = subprocess.run(
            [program, "-T", "lint", "-W", "warning", *sorted(folder.iterdir())],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0 and not done.stdout, done.stdout

    def test_man_shows_each(self, folder):
        program = shutil.which("man")
        if program is None or not shutil.which("groff"):
            pytest.skip("no man(1) with groff here")
        for name in ("hapfmt", "hapfmt-encode", "hapfmt-archive-bag"):
            done = subprocess.run(
                [program, "--warnings", "-E", "UTF-8", "-l", str(folder / f"{name}.1")],
                capture_output=True, text=True, check=False,
                env={**os.environ, "MANWIDTH": "80", "MANPAGER": "cat"},
            )  # fmt: skip
            assert done.returncode == 0 and not done.stderr, done.stderr
            words = " ".join(done.stdout.split())
            assert name in words and "DESCRIPTION" in words and "--help" in words
