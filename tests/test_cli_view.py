"""hapfmt view on the command line: what it serves, writes and refuses."""

from __future__ import annotations

import base64
import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import run
from spec import ROOT

import hapfmt
from hapfmt.cli import view as view_module
from hapfmt.viewer.export import LARGEST, size_of
from hapfmt.viewer.server import ServedFile

DATA = (ROOT / "conformance" / "examples" / "residual.hapf").read_bytes()


@pytest.fixture
def room(tmp_path: Path) -> Path:
    (tmp_path / "touch.hapf").write_bytes(DATA)
    return tmp_path


def inside(page: bytes) -> dict[str, bytes]:
    """The files in an exported page, by name."""
    text = page.decode("utf-8")
    listed = re.search(r'<script type="application/json" id="files">(.*?)</script>', text)
    assert listed is not None
    found = {}
    for file in json.loads(listed[1]):
        tag = f'<script type="haptics/vnd.hapf;base64" id="{file["inline"]}">'
        start = text.index(tag) + len(tag)
        found[file["name"]] = base64.b64decode(
            text[start : text.index("</script>", start)], validate=True
        )
    return found


class TestExport:
    def test_has_the_data_inside(self, room: Path) -> None:
        done = run("view", "touch.hapf", "--export", "touch.html", cwd=room)
        assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
        assert inside((room / "touch.html").read_bytes()) == {"touch.hapf": DATA}
        assert sorted(path.name for path in room.iterdir()) == ["touch.hapf", "touch.html"]

    def test_tells_a_person_its_size(self, room: Path) -> None:
        done = commands.run_in_terminal("view", "touch.hapf", "--export", "a.html", cwd=room)
        size = (room / "a.html").stat().st_size
        assert f"a.html: a page with its data, {size} bytes" in done.stdout.decode()

    def test_into_a_pipe(self, room: Path) -> None:
        done = run("view", "-", "--export", "-", cwd=room, stdin=DATA)
        assert done.returncode == 0 and inside(done.stdout) == {"standard input": DATA}
        done = commands.run_in_terminal("view", "touch.hapf", "--export", "-", cwd=room)
        assert done.returncode == 1 and b"page is too long for a terminal" in done.stdout

    @pytest.mark.parametrize("size", [300, 301, 302, 303, (3 << 18) - 1, 3 << 18, (3 << 18) + 1])
    def test_any_size(self, room: Path, size: int) -> None:
        data = (DATA + bytes(size))[:size]
        (room / "touch.hapf").write_bytes(data)
        assert run("view", "touch.hapf", "--export", "a.html", cwd=room).returncode == 0
        assert inside((room / "a.html").read_bytes()) == {"touch.hapf": data}

    def test_names_of_any_kind(self, room: Path) -> None:
        names = ["</script><img src=x onerror=alert(1)>.hapf", "a'\"&<!--.hapf", "é\u2028\n.hapf"]
        for name in names:
            (room / name.replace("/", "∕")).write_bytes(DATA)
        files = [name.replace("/", "∕") for name in names]
        assert run("view", *files, "--export", "a.html", cwd=room).returncode == 0
        page = (room / "a.html").read_bytes()
        assert list(inside(page)) == files
        assert b"<img" not in page and b"<!--" not in page

    def test_two_files_of_one_name(self, room: Path) -> None:
        (room / "b").mkdir()
        (room / "b" / "touch.hapf").write_bytes(DATA[:100])
        run("view", "touch.hapf", "b/touch.hapf", "--export", "a.html", cwd=room)
        found = inside((room / "a.html").read_bytes())
        assert found == {"touch.hapf": DATA, "b/touch.hapf": DATA[:100]}

    def test_replaces_nothing_without_force(self, room: Path) -> None:
        (room / "a.html").write_bytes(b"mine")
        done = run("view", "touch.hapf", "--export", "a.html", cwd=room)
        assert done.returncode == 1 and b"use --force" in done.stderr
        assert (room / "a.html").read_bytes() == b"mine"
        assert run("view", "touch.hapf", "--export", "a.html", "-f", cwd=room).returncode == 0
        assert inside((room / "a.html").read_bytes()) == {"touch.hapf": DATA}

    def test_never_over_a_recording(self, room: Path) -> None:
        done = run("view", "touch.hapf", "--export", "touch.hapf", "--force", cwd=room)
        assert done.returncode == 1 and b"ends in .html" in done.stderr
        assert (room / "touch.hapf").read_bytes() == DATA

    def test_a_file_too_large_for_a_page(self, room: Path) -> None:
        os.truncate(room / "touch.hapf", LARGEST + 1)
        with (
            ServedFile(str(room / "touch.hapf"), "touch.hapf") as file,
            pytest.raises(hapfmt.errors.LimitError, match="too many for one page"),
        ):
            size_of(file)
        done = run("view", "touch.hapf", "--export", "a.html", cwd=room)
        assert done.returncode == 4 and not (room / "a.html").exists()

    def test_a_large_page_has_a_note(
        self, room: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr(view_module, "LARGE", 1000)
        with ServedFile(str(room / "touch.hapf"), "touch.hapf") as file:
            view_module.write([file], str(room / "a.html"), False)
        assert "slow to open" in capsys.readouterr().err


class TestRefusals:
    def test_of_another_format(self, room: Path) -> None:
        recording = hapfmt.read(room / "touch.hapf")
        hapfmt.save(recording.sel([0]), room / "my touch.npz")
        (room / "touch.csv").write_text("t,x\n0,1\n0.001,2\n", "utf-8")
        (room / "zip.hapf").write_bytes((room / "my touch.npz").read_bytes())
        for name in ("my touch.npz", "touch.csv", "zip.hapf"):
            done = run("view", name, "--no-browser", cwd=room)
            assert done.returncode == 1 and not done.stdout
            assert "encode it first" in done.stderr.decode()
        done = run("view", "my touch.npz", "--no-browser", cwd=room)
        assert b"hapfmt encode 'my touch.npz' 'my touch.hapf'" in done.stderr

    def test_of_anything_else(self, room: Path) -> None:
        (room / "page.html").write_text("<p>", "utf-8")
        np.arange(5).tofile(room / "noise")
        for name, what in {
            "page.html": "not a .hapf file", "noise": "not a .hapf file", ".": "a folder",
            "none.hapf": "No such file",
        }.items():  # fmt: skip
            done = run("view", name, "--no-browser", cwd=room)
            assert done.returncode == 1 and what in done.stderr.decode(), name

    @pytest.mark.skipif(os.name == "nt", reason="pipes of POSIX")
    def test_of_a_pipe(self, room: Path) -> None:
        """At once: nobody may ever write to it."""
        os.mkfifo(room / "pipe.hapf")
        done = run("view", "pipe.hapf", "--no-browser", cwd=room)
        assert (done.returncode, done.stdout) == (1, b"")
        assert b"pipe.hapf: not a regular file; the name - reads a pipe" in done.stderr

    @pytest.mark.parametrize("words", [["--no-browser"], ["--export", "a.html"]])
    @pytest.mark.parametrize(
        "data", [b"", b"\x89PNG\r\n\x1a\n" + bytes(1000), DATA[:8], DATA[:20]], ids=len
    )
    def test_of_a_file_without_any_chunk(self, room: Path, data: bytes, words: list) -> None:
        """As ``hapfmt info`` refuses it."""
        (room / "touch.hapf").write_bytes(data)
        done = run("view", "touch.hapf", *words, cwd=room)
        said = run("info", "touch.hapf", cwd=room)
        assert (done.returncode, done.stdout, done.stderr) == (2, b"", said.stderr)
        assert said.returncode == 2 and not (room / "a.html").exists()
        done = run("view", "-", *words, cwd=room, stdin=data)
        assert done.returncode == 2 and not done.stdout

    def test_not_of_a_damaged_file(self, room: Path) -> None:
        for data in (bytes(40) + DATA[40:], DATA[100:], b"\x89PNG" + DATA):
            (room / "touch.hapf").write_bytes(data)
            done = run("view", "touch.hapf", "--export", "a.html", "--force", cwd=room)
            assert done.returncode == 0, done.stderr
            assert inside((room / "a.html").read_bytes()) == {"touch.hapf": data}

    @pytest.mark.parametrize(
        ("words", "what"),
        [
            ("touch.hapf --export a.html --port 9000", "--port is for the server"),
            ("touch.hapf --export a.html --no-browser", "--no-browser is for the server"),
            ("touch.hapf --force", "--force requires --export"),
            ("touch.hapf --port 70000", "70000 is not in the range"),
            ("touch.hapf --export gone/a.html", "does not exist"),
            ("", "Missing argument 'FILE...'"),
        ],
    )
    def test_of_options(self, room: Path, words: str, what: str) -> None:
        done = run("view", *words.split(), cwd=room)
        assert done.returncode == 1 and what in done.stderr.decode()


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C is sent otherwise there")
@pytest.mark.parametrize("data", [DATA, b"\0" + DATA[1:]], ids=["intact", "damaged"])
def test_serves_until_ctrl_c(room: Path, data: bytes) -> None:
    """Also a file whose beginning is damaged."""
    (room / "touch.hapf").write_bytes(data)
    command = [sys.executable, "-m", "hapfmt", "view", "touch.hapf"]
    environment = {k: v for k, v in os.environ.items() if k not in view_module.DISPLAYS}
    with subprocess.Popen(
        command, cwd=room, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:  # fmt: skip
        assert process.stdout is not None and process.stderr is not None
        url = process.stdout.readline().strip()
        with urllib.request.urlopen(f"{url}files/0") as answer:
            assert answer.read() == data
        notes = ""  # the second one comes from a thread
        while "Ctrl-C" not in notes or "no display here" not in notes:
            line = process.stderr.readline()
            assert line, notes
            notes += line
        process.send_signal(signal.SIGINT)
        rest, last = process.communicate(timeout=20)
    assert (process.returncode, rest, last) == (0, "", "")


def test_opens_the_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(view_module.webbrowser, "open", lambda url: opened.append(url) or True)
    monkeypatch.setenv("DISPLAY", ":0")
    view_module.open_browser("http://127.0.0.1:1/x/").join()
    assert opened == ["http://127.0.0.1:1/x/"]


def test_a_browser_that_is_not_there(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(view_module.webbrowser, "open", lambda _: False)
    monkeypatch.setenv("DISPLAY", ":0")
    view_module.open_browser("http://127.0.0.1:1/x/").join()
    assert "no browser was found" in capsys.readouterr().err
