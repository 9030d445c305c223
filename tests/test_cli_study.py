"""hapfmt study, in a terminal and on pipes: whole sessions, crashes, wrong words, summaries."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import ENVIRONMENT, run
from spec import ROOT
from terminal import called

import hapfmt
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.lab.study.description import load_study
from hapfmt.lab.study.prepare import prepare
from hapfmt.lab.study.rating import load_answers, order

STUDY = """
name = "textures"
[[session]]
name = "sand"
recording = "sand.hapf"
[[condition]]
name = "same"
role = "reference"
[[condition]]
name = "b5"
preset = "paper"
k = 0.1
bits = 5
[[condition]]
name = "anchor"
role = "anchor"
preset = "paper"
bits = 0
"""
PATIENT_S = 60.0


@pytest.fixture(scope="module")
def prepared(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("prepared") / "study"
    folder.mkdir()
    hapfmt.write(simulate("sand", 0.2), folder / "sand.hapf", canonical=1)
    (folder / "study.toml").write_text(STUDY)
    prepare(load_study(folder / "study.toml"), folder / "study-conditions")
    return folder


@pytest.fixture
def room(prepared: Path, tmp_path: Path) -> Path:
    """A copy: what is prepared stays so, wherever the study lies."""
    return Path(shutil.copytree(prepared, tmp_path / "room"))


def asked(room: Path, subject: str, words: str, *more: object):
    return run("study", "study.toml", "--subject", subject, "--dry-run", *more, cwd=room,
               stdin=words.encode())  # fmt: skip


def answers(room: Path, subject: str):
    return load_answers(room / "study-answers" / f"{subject}.jsonl")


class Terminal:
    """``hapfmt ...`` in a terminal of its own, which it controls."""

    def __init__(self, room: Path, *words: object, first: str = "pass") -> None:
        import pty

        code = f"import os; os.setsid(); import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); {first}; from hapfmt.cli import main; main()"
        self.master, slave = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-W", "error", "-c", code, *map(str, words)],
            cwd=room, stdin=slave, stdout=slave, stderr=slave,
            env={**ENVIRONMENT, "PYTHONPATH": str(ROOT), "TERM": "xterm"},
        )  # fmt: skip
        os.close(slave)
        self.text, self.read = "", 0

    def __enter__(self) -> Terminal:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.master)

    def more(self, seconds: float) -> bool:
        if not select.select([self.master], [], [], seconds)[0]:
            return True
        try:
            data = os.read(self.master, 1 << 16)
        except OSError:  # Linux: the other end has closed
            return False
        self.text += data.decode().replace("\r\n", "\n")
        return bool(data)

    def until(self, pattern: str) -> re.Match[str]:
        """What comes next and fits."""
        stop = time.monotonic() + PATIENT_S
        while not (found := re.compile(pattern).search(self.text, self.read)):
            assert self.more(0.1), self.text
            assert time.monotonic() < stop, self.text
        self.read = found.end()
        return found

    def type(self, text: str) -> None:
        os.write(self.master, text.encode())

    def end(self) -> int:
        while self.more(0.1) and self.process.poll() is None:
            pass
        return self.process.wait(PATIENT_S)


needs_terminal = pytest.mark.skipif(os.name == "nt", reason="terminals of POSIX")


@needs_terminal
class TestTerminal:
    def start(self, room: Path, subject: str = "S1") -> Terminal:
        return Terminal(room, "study", "study.toml", "--subject", subject, "--dry-run")

    def test_a_whole_session(self, room):
        with self.start(room) as terminal:
            terminal.until("textures: How close")
            terminal.until(r"Bad +Poor +Fair +Good +Excellent\n0-+20-+40-+60-+80-+100")
            for number, rating in enumerate(("100", "85.5", "0"), 1):
                terminal.until(rf"question {number} of 3\n> ")
                terminal.type("r")
                terminal.until("played the reference .*\n> ")
                terminal.type("p")
                terminal.until("played this one .*\n> ")
                terminal.type("a")
                terminal.until("played this one .*\n> ")
                terminal.type(f"{rating}\r")
                terminal.until(rf"{rating}: \w+; saved")
            terminal.until("Done. Thank you.\n3 of 3 answers are in study-answers/S1.jsonl")
            assert terminal.end() == 0
        found = answers(room, "S1")
        assert list(found.ratings.values()) == [100, 85.5, 0]
        assert [line["plays"] for line in found.lines] == [{"this": 2, "reference": 1}] * 3
        with self.start(room) as terminal:
            terminal.until("3 of 3 are answered; on with the rest")
            assert terminal.end() == 0
        assert answers(room, "S1").lines == found.lines

    def test_wrong_words_and_a_way_back(self, room):
        with self.start(room) as terminal:
            for word, told in (
                ("50\r", "play this one first"),
                ("p", "played this one"),
                ("101\r", "a rating lies between 0 and 100"),
                ("9x\r", "'9x' is none of r p a b q"),
                ("-5\r", "'-5' is none of"),
                ("1e1\r", "'1e1' is none of"),
                ("nan\r", "'nan' is none of"),
                ("\r?", "r plays the reference, p this one"),
                ("b", "there is no question before"),
                ("7\x7f3\x7f\x7f\x7f20\r", r"20: Poor; saved\n\nsession 1 of 1: question 2"),
                ("b", r"question 1 of 3\n"),
                ("p", "played this one"),
                ("30\r", r"30: Poor; saved\n\nsession 1 of 1: question 2"),
            ):
                terminal.until("> ")
                terminal.type(word)
                terminal.until(told)
            terminal.until("> ")
            terminal.type("q")
            terminal.until("1 of 3 answers .*\nthe same command goes on from here")
            assert terminal.end() == 0
        found = answers(room, "S1")
        assert [line["rating"] for line in found.lines] == [20, 30] and found.ratings == {0: 30}

    def test_killed_and_gone_on_with(self, room):
        with self.start(room) as terminal:
            terminal.until("question 1 of 3\n> ")
            terminal.type("p")
            terminal.until("played this one .*\n> ")
            terminal.type("61\r")
            terminal.until("question 2 of 3\n> ")
            terminal.type("p")
            terminal.until("played this one .*\n> ")
            terminal.type("7")
            terminal.until("7")
            terminal.process.send_signal(signal.SIGKILL)
            assert terminal.end() == -signal.SIGKILL
        before = answers(room, "S1")
        assert list(before.ratings.values()) == [61]
        with (room / "study-answers" / "S1.jsonl").open("ab") as stream:
            stream.write(b'{"trial": 1, "rati')
        with self.start(room) as terminal:
            terminal.until(r"S1.jsonl: the last line was torn \(18 bytes\) and is ignored")
            terminal.until("S1: 1 of 3 are answered; on with the rest")
            terminal.until("question 2 of 3\n> ")
            for rating in (62, 63):
                terminal.type(f"p{rating}\r")
                terminal.until(f"{rating}: Good; saved")
            assert terminal.end() == 0
        assert answers(room, "S1").trials == before.trials
        assert list(answers(room, "S1").ratings.values()) == [61, 62, 63]

    def test_ctrl_c_leaves_the_terminal_as_it_was(self, room):
        import termios

        with self.start(room) as terminal:
            before = termios.tcgetattr(terminal.master)
            terminal.until("question 1 of 3\n> ")
            terminal.type("p")
            terminal.until("played this one .*\n> ")
            terminal.type("8\x03")
            terminal.until("0 of 3 answers .*\nthe same command goes on")
            assert terminal.end() == 130
            assert termios.tcgetattr(terminal.master) == before

    @pytest.mark.deep
    def test_ctrl_c_while_a_device_plays(self, room):
        """It comes to rest, what was answered is kept, and the command goes on."""
        from replaying import glove, lines, moving

        hapfmt.write(simulate("sand", 20.0), room / "long.hapf", canonical=1)
        (room / "glove.toml").write_text(glove().text)
        (room / "study.toml").write_text(STUDY.replace("sand.hapf", "long.hapf"))
        frames = room / "frames"
        config = {"kind": "loopback", "file": str(frames)}
        first = f"import hapfmt.lab.study.outputs as o; o.find_device = lambda *_: {config}"
        words = ["study", "study.toml", "--subject", "S1", "--device", "glove.toml"]
        words += ["--map", "0=thumb", "--no-watchdog"]
        with Terminal(room, *words, first=first) as terminal:
            terminal.until("question 1 of 3\n> ")
            terminal.type("p")
            moving(frames)
            terminal.type("\x03")
            terminal.until("0 of 3 answers .*\nthe same command goes on")
            assert terminal.end() == 130
        assert lines(frames)[-1].neutral and len(lines(frames)) < 10_000

    def test_ctrl_d(self, room):
        with self.start(room) as terminal:
            terminal.until("> ")
            terminal.type("\x04")
            terminal.until("0 of 3 answers")
            assert terminal.end() == 0


class TestPipes:
    def test_two_subjects(self, room):
        for subject, ratings in (("S1", (90, 50, 10)), ("S2", (95, 70, 20))):
            names = ("same", "b5", "anchor")
            order = self.order(room, subject)
            words = "".join(f"p\nr\n{ratings[names.index(each)]}\n" for each in order)
            done = asked(room, subject, words)
            assert done.returncode == 0, done.stderr
            assert b"Done. Thank you." in done.stdout
        files = [f"study-answers/{subject}.jsonl" for subject in ("S1", "S2")]
        said = run("study", "--summary", *files, "--json", cwd=room)
        found = json.loads(said.stdout)
        rows = {row["condition"]: row for row in found["all"]}
        assert [rows[name]["rating"]["mean"] for name in names] == [92.5, 60, 15]
        # By hand: t(0.975, 1) = 12.7062, sd / sqrt(2) = 2.5, 10, 5.
        halves = [rows[name]["rating"]["high"] - rows[name]["rating"]["mean"] for name in names]
        assert halves == pytest.approx([31.7655, 127.062, 63.531], rel=1e-5)
        assert rows["b5"]["difference"]["mean"] == -32.5 and found["screened"] == found["all"]
        text = run("study", "--summary", *files, cwd=room)
        assert (
            b"textures: 2 subjects" in text.stdout and b"no subject rated the hidden" in text.stdout
        )
        assert b"nothing was felt by S1, S2: a dry run" in text.stderr
        lines = run("study", "--summary", *files, "--csv", cwd=room).stdout.decode()
        table = list(csv.DictReader(io.StringIO(lines)))
        assert [float(row["mean"]) for row in table] == [92.5, 60, 15] * 2
        pytest.importorskip("matplotlib")
        paths = [room / each for each in files]
        assert called("study", "--summary", *paths, "--plot", room / "o.svg").code == 0
        assert b"<svg" in (room / "o.svg").read_bytes()
        assert called("study", "--summary", *paths, "--plot", room / "o.svg").code == 1

    def order(self, room: Path, subject: str) -> list[str]:
        return [each.condition for each in order(load_study(room / "study.toml"), subject)]

    def test_the_end_of_a_pipe(self, room):
        done = asked(room, "S1", "p\n80")
        assert done.returncode == 0 and b"1 of 3 answers" in done.stdout
        assert b"on with the rest" in asked(room, "S1", "").stdout

    def test_the_study_has_changed(self, room):
        asked(room, "S1", "p\n80\n")
        (room / "study.toml").write_text(STUDY + "\n# another\n")
        done = asked(room, "S1", "p\n80\n")
        assert done.returncode == 1 and b"another study, or to this one before" in done.stderr
        assert asked(room, "S1", "p\n80\n", "--answers", "new.jsonl").returncode == 0

    def test_a_device_is_rehearsed(self, room):
        words = "p\n50\n" * 3
        done = run("study", "study.toml", "--subject", "S1", "--device", "glove5", "--dry-run",
                   "--map", "0=1", cwd=room, stdin=words.encode())  # fmt: skip
        assert done.returncode == 0 and b"3 of 3 answers" in done.stdout
        output = answers(room, "S1").head["output"]
        assert (output["kind"], output["profile"]) == ("dry-run", "glove5")

    def test_new_and_prepare(self, room):
        done = run("study", "--new", "a.toml", "sand.hapf", cwd=room)
        assert b"1 session of 11 conditions" in done.stdout
        assert run("study", "--new", "a.toml", "sand.hapf", cwd=room).returncode == 1
        said = run("study", "a.toml", "--prepare", "--json", cwd=room)
        sizes = {
            each["condition"]: each["file_size"] for each in json.loads(said.stdout)["stimuli"]
        }
        assert len(sizes) == 11 and sizes["anchor"] == min(sizes.values())
        assert sizes["k 10 %, 2 bits"] < sizes["k 10 %, 5 bits"] < sizes["k 10 %, 8 bits"]

    @pytest.mark.parametrize(
        ("words", "told"),
        [
            (["study.toml"], "whose answers"),
            (["study.toml", "--subject", "S1"], "say where it is felt"),
            (["study.toml", "--subject", "S1", "--dry-run", "--wav", "w"], "one of them"),
            (["study.toml", "--subject", "S1", "--dry-run", "--gain", "0.1"], "requires --device"),
            (["study.toml", "--subject", "../S", "--dry-run"], "cannot be a subject"),
            (["study.toml", "--subject", "S1", "--device", "glove5", "--map", "9=1"], "9"),
            (["study.toml", "--prepare", "--summary"], "choose one of"),
            (["study.toml", "--plot", "a.png"], "requires --summary"),
            (["--summary", "study.toml"], "line 1: this is not JSON"),
            (["--summary", "study.toml", "--csv", "--json"], "choose one of --csv and --json"),
            (["--new", "n.toml"], "give the recordings"),
            (["--new", "n.toml", "no.hapf"], "no such file"),
            (["study.toml", "study.toml", "--subject", "S1"], "one study at a time"),
            (["no.toml", "--prepare"], "no.toml"),
        ],
    )
    def test_refused(self, room, words, told):
        done = run("study", *words, cwd=room)
        assert done.returncode == 1 and told in done.stderr.decode()
        assert not (room / "study-answers").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="devices and pipes of POSIX")
class TestFilesWithoutEnd:
    """Device files and pipes, in any place that a study or a command line names."""

    @pytest.fixture(params=["/dev/zero", "pipe", "/dev/tty", "folder", "huge"])
    def endless(self, request, tmp_path) -> str:
        place = tmp_path / request.param.strip("/").replace("/", "-")
        if request.param == "pipe":
            os.mkfifo(place)
        elif request.param == "folder":
            place.mkdir()
        elif request.param == "huge":
            with place.open("wb") as stream:
                stream.truncate(1 << 40)
        else:
            return request.param
        return str(place)

    @pytest.fixture(autouse=True)
    def here(self, room, monkeypatch):
        """In the study's folder, and not for ever."""
        monkeypatch.chdir(room)
        signal.alarm(300)
        yield
        signal.alarm(0)

    @staticmethod
    def refused(*words) -> str:
        said = called("study", *words)
        assert said.code == 1 and "Traceback" not in said.err, said
        return said.err

    def test_a_recording(self, room, endless):
        text = STUDY.replace('"sand.hapf"', f'"{endless}"')
        (room / "study.toml").write_text(text)
        for words in (["--prepare"], ["--subject", "S1", "--dry-run"]):
            assert endless in self.refused("study.toml", *words)

    def test_a_file_of_a_condition(self, room, endless):
        text = STUDY.replace(
            'preset = "paper"\nk = 0.1\nbits = 5\n', f'files = {{ sand = "{endless}" }}\n'
        )
        assert text != STUDY
        (room / "study.toml").write_text(text)
        assert endless in self.refused("study.toml", "--prepare")

    def test_a_study(self, endless):
        assert endless in self.refused(endless, "--prepare")

    def test_answers(self, endless):
        assert endless in self.refused("--summary", endless)
        said = self.refused("study.toml", "--subject", "S1", "--dry-run", "--answers", endless)
        assert endless in said or "--answers" in said

    def test_what_was_prepared(self, room, endless):
        """A list of files that cannot be read is made anew."""
        manifest = room / "study-conditions" / "prepared.json"
        told = json.loads(manifest.read_text())
        told["stimuli"][0]["path"] = endless
        manifest.write_text(json.dumps(told))
        assert called("study", "study.toml", "--prepare").code == 0
        assert endless not in manifest.read_text()


ESCAPES = "\\u001b]0;title\\u0007\\u009b31m\\u202e"


@pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
def test_texts_of_a_study_cannot_steer_the_terminal(room):
    text = STUDY.replace('name = "textures"', f'name = "t{ESCAPES}"\nquestion = "q{ESCAPES}"\n'
                         f'scale = ["a{ESCAPES}", "b", "c", "d", "e"]')  # fmt: skip
    text = text.replace('name = "sand"', f'name = "sand{ESCAPES}"')
    (room / "study.toml").write_text(text)
    with Terminal(room, "study", "study.toml", "--subject", "S1", "--dry-run") as terminal:
        for word in ("p", "50\r", "?", "q"):
            terminal.until("> ")
            terminal.type(word)
        assert terminal.end() == 0
        asked_for = terminal.text[terminal.text.index("\ufffd]0;title") - 1 :]
    assert not {"\x1b", "\x07", "\x9b", "\u202e"} & set(asked_for)
