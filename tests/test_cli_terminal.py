"""What a person sees: tables on terminals of 80, 100 and 120 columns, closed streams, hostile text,
names that were mistyped."""

from __future__ import annotations

import ast
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from commands import pseudo_terminal, run, run_in_terminal, run_to_terminal
from depth import deep, sample
from terminal import called

import hapfmt
from hapfmt.cli import SECTIONS, VERBS, cli, screen
from hapfmt.errors import ParameterError

LABELS = ("thumb_proximal_flexion_torque", "fx", "BioTac electrode 17", "Δ slip velocity")
UNITS = ("N.m", "N", "1", "mm/s")
HOSTILE = "a\x1b[2J\x07b\nhapfmt: forged\x9b31m\x7f\u202etxet\u2066\r"
WRITTEN = {"x.npz:", "channels,", "s,", "bytes"}
"""Only a terminal says what was written."""
CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u202a-\u202e\u2066-\u2069]")
pytestmark = pytest.mark.skipif(os.name == "nt", reason="terminals and streams of POSIX")


def recording(labels: tuple[str, ...] = LABELS, count: int = 4000) -> hapfmt.Recording:
    walk = np.cumsum(np.random.default_rng(1).integers(-40, 41, (len(labels), count)), axis=1)
    return hapfmt.Recording(
        tuple(
            hapfmt.Channel(
                row.astype(np.int32), 1000, calibration=hapfmt.Calibration(1, 0, 1000),
                label=label, unit=unit,
            )
            for row, label, unit in zip(walk, labels, UNITS, strict=False)
        )
    )  # fmt: skip


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("terminal")
    hapfmt.save(recording(), folder / "touch.npz")
    for words in (
        ["encode", "touch.npz", "a.hapf", "--preset", "near-lossless", "--max-error", "5lsb"],
        ["encode", "touch.npz", "l.hapf"],
        ["annotate", "a.hapf", "--at", "1", "first contact with a surface, seen on video by Anna"],
        ["meta", "a.hapf", "subject=S07"],
    ):
        assert run(*words, cwd=folder).returncode == 0, words
    (folder / "note.txt").write_text("hello")
    assert run("attach", "a.hapf", "note.txt", cwd=folder).returncode == 0
    raw = bytearray((folder / "l.hapf").read_bytes())
    raw[len(raw) // 2] ^= 1
    (folder / "flipped.hapf").write_bytes(raw)
    return folder


SHOWN: dict[str, tuple[list[str], list[str], int]] = {
    "encode": (["encode", "touch.npz", "-v", "-f", "x.hapf"], ["label", "bits/sample", *LABELS], 0),
    "info": (["info", "a.hapf"], ["label", "kept as", *LABELS], 0),
    "info --events": (["info", "a.hapf", "--events"], ["time, s", "Anna"], 0),
    "verify": (["verify", "flipped.hapf"], ["damaged", "hapfmt recover flipped.hapf OUT"], 3),
    "verify --against": (
        ["verify", "a.hapf", "--against", "touch.npz"],
        ["label", "verdict", "keeps its error bound", *LABELS],
        0,
    ),
    "compare": (
        ["compare", "touch.npz", "a.hapf"], ["label", "verdict", "differs", "4 different", *LABELS], 3,
    ),
    "du": (["du", "a.hapf"], ["cause", "channels", "bytes", *LABELS], 0),
    "decode": (["decode", "flipped.hapf", "x.npz", "-f"], ["lost:"], 3),
    "recover": (["recover", "flipped.hapf", "x.hapf", "-f"], ["with loss"], 3),
    "subset": (["subset", "a.hapf", "x.hapf", "-f", "--channels", "fx"], ["1 channel,"], 0),
    "attach": (["attach", "a.hapf", "--list"], ["media type", "note.txt"], 0),
    "annotate": (["annotate", "a.hapf", "--list"], ["time, s", "text", "Anna"], 0),
    "clocks": (["clocks", "a.hapf"], ["observations of other clocks"], 0),
    "profile list": (["profile", "list"], ["name", "dualsense-bluetooth-haptics"], 0),
    "profile check": (["profile", "check", "glove22"], ["actuator", "lowest"], 0),
    "scene": (["scene"], ["everything", "grasp"], 0),
    "demo": (["demo", "--seconds", "1"], ["preset", "bytes"], 0),
    "replay": (
        ["replay", "a.hapf", "--device", "glove5", "--dry-run", "--map", "fx=thumb", "--stop",
         "0.05", "--record", "x.csv", "-f"],
        ["thumb", "frames"],
        0,
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "columns"),
    sample(
        (pytest.param(name, columns, id=f"{name} {columns}") for name in SHOWN for columns in (80, 100, 120)),
        always=(*(f"{name} 80" for name in SHOWN), "encode 100", "compare 120"),
    ),
)  # fmt: skip
def test_output_fits_the_terminal(name: str, columns: int, room: Path, tmp_path: Path) -> None:
    words, wanted, code = SHOWN[name]
    folder = tmp_path / "room"
    shutil.copytree(room, folder)
    done = run_in_terminal(*words, cwd=folder, columns=columns)
    text = done.stdout.decode()
    assert done.returncode == code, text
    lines = text.replace("\r\n", "\n").split("\n")
    assert max(screen.cells(line) for line in lines) <= columns, text
    flat = " ".join(text.split())
    for each in wanted:
        assert each in flat, each
    for label in LABELS:
        # A label is in one line or not at all.
        assert (label in flat) == any(label in line for line in lines)
    piped = run(*words, cwd=folder)
    known = set((piped.stdout + piped.stderr).decode().split()) | WRITTEN
    for word in set(flat.split()):
        if "not shown" in flat or re.search(r"\d", word) or set(word) <= set("─"):
            continue
        assert word in known, word


def test_perceptual_measures_fit_the_terminal(room: Path) -> None:
    pytest.importorskip("vibromaf.metrics.spqi")
    done = run_in_terminal("compare", "touch.npz", "a.hapf", "--metrics", cwd=room)
    # What a bar of progress wrote is wiped out.
    text = done.stdout.decode().replace("\r\n", "\n").rpartition("\x1b[2K")[2]
    assert done.returncode == 3
    assert max(map(screen.cells, text.split("\n"))) <= 80
    measures = text.split("\n\n", 1)[1]
    for word in ("weighted", "deadbands", "outside %", "ST-SIM", "SPQI", *LABELS):
        assert word in measures, word
    assert "of the first 4 s of the longest stretch" in measures


@pytest.mark.parametrize("columns", [80, 100])
def test_columns_left_out_are_named(columns: int, room: Path) -> None:
    text = run_in_terminal("compare", "touch.npz", "a.hapf", cwd=room, columns=columns).stdout
    piped = run("compare", "touch.npz", "a.hapf", cwd=room).stdout.decode()
    header = piped.split("\n")[0]
    assert "SNR>20Hz dB" in header and "B only" in header
    flat = " ".join(text.decode().split())
    named = re.search(
        r"\(not shown: (.*?); a terminal of (\d+) columns or --json shows them\)", flat
    )
    assert named is not None and int(named[2]) > columns
    wide = run_in_terminal("compare", "touch.npz", "a.hapf", cwd=room, columns=int(named[2]))
    assert b"not shown" not in wide.stdout


class TestTables:
    def laid(self, width: int | None, headers: list[Any], rows: list[list[str]]) -> list[str]:
        columns = [
            each if isinstance(each, screen.Column) else screen.Column(each) for each in headers
        ]
        return screen.laid_out(columns, rows, width)[0]

    def test_a_long_label_is_shortened_only_where_nothing_else_is_left(self) -> None:
        label = "index_finger_distal_interphalangeal_joint_torque"
        headers = ["label", screen.Column("number", 1), screen.Column("what", 2)]
        rows = [[label, "12", "words that wrap"]]
        for width in range(len(label), 100):
            lines = self.laid(width, headers, rows)
            assert any(label in line for line in lines) and max(map(len, lines)) <= width
        lines = self.laid(40, headers, rows)
        assert max(map(len, lines)) <= 40
        cell = lines[2].split()[0]
        assert (
            "…" in cell
            and label.startswith(cell.split("…")[0])
            and label.endswith(cell.split("…")[1])
        )

    def test_numbers_are_right_aligned_and_words_whole(self) -> None:
        rows = [["a", "1.5 N", "some words here to wrap"], ["b", "22.25 N", "more"]]
        lines = self.laid(34, ["label", "error", "text"], rows)
        assert lines[2].index("1.5 N") == lines[4].index("22.25") + 2 if len(lines) > 4 else True
        assert set(" ".join(lines).split()) >= {"words", "here", "wrap", "22.25"}

    def test_wide_characters_count_twice(self) -> None:
        lines = self.laid(None, ["label", "n"], [["力", "1"], ["abcd", "2"]])
        assert {screen.cells(line) for line in lines[2:]} == {screen.cells(lines[3])}

    def test_a_pipe_keeps_all_columns_in_one_line(self) -> None:
        lines = self.laid(None, ["label", "text"], [["a", "words " * 60]])
        assert len(lines) == 3


def marked(verbs: tuple[tuple[str, ...], ...], quick: tuple[str, ...]) -> list[object]:
    names = [" ".join(words[:2]) for words in verbs]
    return [
        pytest.param(words, id=name, marks=() if name in quick else pytest.mark.deep)
        for words, name in zip(verbs, names, strict=True)
    ]


class TestStreams:
    """Standard streams that are closed or full: our error, exit code 1, no traceback."""

    VERBS = (
        ("encode", "touch.npz", "x.hapf", "-f"), ("decode", "a.hapf", "x.npz", "-f", "--json"),
        ("info", "a.hapf"), ("verify", "a.hapf"), ("recover", "a.hapf", "x.hapf", "-f"),
        ("du", "a.hapf"), ("dump", "a.hapf"), ("subset", "a.hapf", "x.hapf", "-f"),
        ("split", "a.hapf", "--every", "9", "-f"), ("concat", "a.hapf", "x.hapf", "-f"),
        ("merge", "a.hapf", "x.hapf", "-f"), ("attach", "a.hapf", "--list"),
        ("annotate", "a.hapf", "--list"), ("meta", "a.hapf"), ("clocks", "a.hapf"),
        ("convert", "a.hapf", "x.npz", "-f", "--json"), ("compare", "a.hapf", "a.hapf"),
        ("devices",), ("profile", "list"), ("scene",), ("demo", "--seconds", "0.2"),
        ("replay", "a.hapf", "--device", "glove5", "--dry-run", "--map", "fx=thumb", "--stop", "0.01"),
        ("--help",), ("--version",), ("decode", "a.hapf", "-", "--output-format", "csv"),
        ("encode", "touch.npz", "-"),
    )  # fmt: skip

    QUICK = ("encode touch.npz", "--help")
    """The others run with HYPOTHESIS_PROFILE=ci: each is two processes."""

    def outcome(self, words: tuple[str, ...], how: str, cwd: Path) -> tuple[int, str]:
        command = f'exec "$0" -m hapfmt "$@" {how}'
        done = subprocess.run(
            ["sh", "-c", command, sys.executable, *words], cwd=cwd, capture_output=True,
            check=False, stdin=subprocess.DEVNULL, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        return done.returncode, done.stderr.decode()

    @pytest.mark.parametrize(
        "words",
        marked(VERBS, QUICK),
    )
    def test_of_output(self, words: tuple[str, ...], room: Path, tmp_path: Path) -> None:
        folder = tmp_path / "room"
        shutil.copytree(room, folder)
        hows = [">&-", ">&- 2>&- <&-"] + ([">/dev/full"] if Path("/dev/full").exists() else [])
        for how in hows:
            code, err = self.outcome(words, how, folder)
            assert code == 1 and "Traceback" not in err, (how, err)
            lines = [line for line in err.splitlines() if line.startswith("hapfmt: ")]
            assert how.count("2>") or len(lines) == 1, err

    @pytest.mark.parametrize(
        "words",
        [
            ("encode", "-", "x.hapf", "--input-format", "npz"), ("info", "-"),
            ("record", "x.hapf", "--rate", "10"), *deep([
                ("verify", "-"), ("decode", "-", "x.npz"), ("annotate", "a.hapf", "--table", "-"),
                ("convert", "-", "x.npz", "--input-format", "csv"),
            ]),
        ],
    )  # fmt: skip
    def test_of_input(self, words: tuple[str, ...], room: Path) -> None:
        code, err = self.outcome(words, "<&-", room)
        assert (code, err) == (1, "hapfmt: standard input is closed\n")

    def test_lost_messages_change_no_exit_code(self, room: Path) -> None:
        for words, code in ((("info", "a.hapf"), 0), (("verify", "flipped.hapf"), 3), (("no",), 1)):
            assert self.outcome(words, "2>&-", room)[0] == code

    def test_a_file_never_gets_a_standard_stream(self, room: Path, tmp_path: Path) -> None:
        code, _ = self.outcome(("encode", "touch.npz", str(tmp_path / "x.hapf")), ">&- 2>&-", room)
        assert code == 1 and hapfmt.verify(tmp_path / "x.hapf").verdict == "intact"


class TestHostileText:
    @pytest.fixture
    def evil(self, tmp_path: Path) -> Path:
        labels = (HOSTILE, HOSTILE + "2", "\x1b]0;title\x07", "c")
        found = hapfmt.Recording(
            recording(labels, 300).channels,
            metadata={HOSTILE: HOSTILE, "notes": [HOSTILE]},
            attachments={"evil\u202e.txt": ("text/plain", b"x")},
            events=(hapfmt.Event(0, HOSTILE, layer=HOSTILE),),
        )
        hapfmt.write(found, tmp_path / "e.hapf")
        hapfmt.save(found, tmp_path / "e.npz")
        raw = bytearray((tmp_path / "e.hapf").read_bytes())
        raw[len(raw) * 3 // 5] ^= 1
        (tmp_path / "f.hapf").write_bytes(raw)
        (tmp_path / "bad.csv").write_text("time,text\nx," + HOSTILE.replace("\n", ""))
        (tmp_path / "bad.toml").write_bytes(b"a = '" + HOSTILE.encode() + b"'")
        return tmp_path

    NAME = HOSTILE.replace("/", "")
    PATHS: tuple[tuple[str, ...], ...] = (
        ("info", "e.hapf", "--events"), ("info", "f.hapf"), ("verify", "e.hapf"), ("verify", "f.hapf"),
        ("verify", "e.hapf", "--against", "e.npz"), ("du", "e.hapf"), ("compare", "e.npz", "e.hapf"),
        ("compare", "e.npz", "f.hapf"), ("encode", "e.npz", "x.hapf", "-v"), ("encode", "e.hapf", "y.hapf"),
        ("decode", "e.hapf", "x.npz"), ("decode", "f.hapf", "y.npz"), ("recover", "f.hapf", "r.hapf"),
        ("decode", "e.hapf", "x.csv", "--channels", NAME + "?"), ("subset", "e.hapf", "s.hapf", "--channels", NAME + "?"),
        ("attach", "e.hapf", "--list"), ("annotate", "e.hapf", "--list"), ("meta", "e.hapf"),
        ("meta", "e.hapf", NAME), ("clocks", "e.hapf"), ("plot", NAME), ("convert", "e.hapf", "c.npz"),
        ("info", NAME), ("encode", NAME, "x2.hapf"), ("encode", "e.npz", NAME + "/x.hapf"), ("decode", NAME, "q.npz"),
        ("encode", "e.npz", "x3.hapf", "--preset", NAME), ("encode", "e.npz", "x3.hapf", NAME), (NAME,),
        ("encode", "e.npz", "x3.hapf", "--" + NAME), ("encode", "e.npz", "x3.hapf", "--k", NAME),
        ("decode", "e.hapf", "q.npz", "--start", NAME), ("split", "e.hapf", "--every", NAME),
        ("split", "e.hapf", "--every", "9", "--output", NAME + "{}.hapf"), ("concat", "e.hapf", NAME, "w.hapf"),
        ("merge", "e.hapf", "w.hapf", "--offset", NAME), ("attach", "e.hapf", NAME),
        ("attach", "e.hapf", "--extract", NAME), ("attach", "e.hapf", "--extract", "--output", "out"),
        ("annotate", "e.hapf", "--table", "bad.csv"), ("annotate", "e.hapf", "--at", "0", "--channel", NAME, "x"),
        ("replay", "e.hapf", "--device", "glove5", "--dry-run", "--stop", "0.01"),
        ("replay", "e.hapf", "--device", NAME, "--dry-run"), ("replay", "e.hapf", "--device", "bad.toml", "--dry-run"),
        ("replay", "e.hapf", "--device", "glove5", "--dry-run", "--map", NAME + "=1"),
        ("profile", "show", NAME), ("profile", "check", "bad.toml"), ("profile", "check", "glove5", "--descriptor", NAME),
        ("scene", NAME, "x4.hapf"), ("scene", "bad.toml", "x4.hapf"), ("scene", "sand", "x4.hapf", "--without", NAME),
        ("study", NAME, "--prepare"), ("study", "bad.toml", "--prepare"), ("study", "--summary", NAME),
        ("record", "z.hapf", "--input", NAME), ("dump", "e.hapf"), ("encode", "e.npz", "-", "--input-format", NAME),
    )  # fmt: skip

    @pytest.mark.parametrize(
        "words",
        sample(((words,) for words in PATHS), 2),
        ids=lambda words: ascii(" ".join(words))[1:60],
    )
    def test_no_control_character_reaches_the_terminal(
        self, words: tuple[str, ...], evil: Path
    ) -> None:
        done = run_in_terminal(*words, cwd=evil)
        text = done.stdout.decode().replace("\r\n", "\n")
        assert text and not CONTROLS.search(text), ascii(text)
        # Nor a line that something else than this program began.
        assert "\nhapfmt: forged" not in text
        piped = run(*words, "-f", cwd=evil)
        for said in (piped.stdout, piped.stderr):
            assert words[0] == "dump" or not CONTROLS.search(said.decode())

    def test_csv_on_a_terminal(self, evil: Path) -> None:
        label = HOSTILE.replace("\n", "").replace("\r", "")
        hapfmt.write(recording((label,), 400), evil / "e.hapf", force=True)
        done = run_in_terminal("decode", "e.hapf", "-", "--output-format", "csv", cwd=evil)
        text = done.stdout.decode().replace("\r\n", "\n")
        assert done.returncode == 0 and not CONTROLS.search(text) and text.count("\n") > 300
        # A pipe gets the labels as they are.
        piped = run("decode", "e.hapf", "-", "--output-format", "csv", cwd=evil)
        assert HOSTILE[:3].encode() in piped.stdout
        done = run_in_terminal("decode", "e.hapf", "-", "--output-format", "npz", cwd=evil)
        assert done.returncode == 1 and b"this format is binary" in done.stdout

    def test_printable(self) -> None:
        assert screen.printable("Δ 1 mm/s, été, 力") == "Δ 1 mm/s, été, 力"
        for code in (*range(32), *range(127, 160), 0x2028, 0x202E, 0x2066, 0xFEFF, 0xDC80):
            assert screen.printable(f"a{chr(code)}b") in ("a\ufffdb", "a\xa0b"), hex(code)
        assert screen.printable("a\u2003b") == "a b"


def test_text_goes_out_in_one_place() -> None:
    """What calls print or click.echo itself would not be printable, nor wrapped."""
    for path in Path(screen.__file__).parent.glob("*.py"):
        if path.name == "screen.py":
            continue
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func)
                assert name not in ("print", "click.echo", "click.secho", "sys.stderr.write"), (
                    path.name
                )


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["enkode", "a", "b"], "encode"), (["verfy"], "verify"), (["profile", "chek", "x"], "check"),
        (["encode", "touch.npz", "z.hapf", "--preset", "near-losless"], "near-lossless"),
        (["encode", "touch.npz", "z.hapf", "--max-eror", "1"], "--max-error"),
        (["decode", "a.hapf", "z.npz", "--channels", "fz"], "fx"),
        (["subset", "a.hapf", "z.hapf", "--channels", "BioTac electrode 71"], "BioTac electrode 17"),
        (["compare", "touch.npz", "a.hapf", "--channels", "thumb_flexion_torque"], LABELS[0]),
        (["attach", "a.hapf", "--extract", "nota.txt"], "note.txt"),
        (["replay", "a.hapf", "--device", "glov5", "--dry-run"], "glove5"),
        (["profile", "show", "joycon-lft"], "joycon-left"), (["scene", "grsp", "x.npz"], "grasp"),
        (["demo", "--texture", "corc"], "cork"),
    ],
)  # fmt: skip
def test_did_you_mean(words: list[str], meant: str, room: Path) -> None:
    done = run(*words, cwd=room)
    err = done.stderr.decode()
    assert done.returncode == 1 and re.search(rf"[Dd]id you mean '{re.escape(meant)}'\?", err), err


@pytest.mark.realtime
@pytest.mark.parametrize(
    "words", [("encode", "big.npz", "x.hapf"), ("convert", "big.npz", "x.hapf")]
)
def test_long_work_shows_progress_and_an_interrupt_leaves_nothing(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    x = np.random.default_rng(1).integers(-99, 99, (48, 480_000), np.int32).cumsum(1, np.int32)
    np.savez(tmp_path / "big.npz", x=x, rate_hz=1000.0)
    ours, theirs = os.openpty()
    command = [sys.executable, "-m", "hapfmt", *words]
    done = subprocess.Popen(command, cwd=tmp_path, stderr=theirs, stdout=subprocess.DEVNULL)
    os.close(theirs)
    text = b""
    try:
        while b"encoding" not in text:
            text += os.read(ours, 1 << 12)
    except OSError:
        pytest.fail(f"it ended before the interrupt, with {done.wait(60)}: {text!r}")
    done.send_signal(signal.SIGINT)
    assert done.wait(60) == 1
    with suppress(OSError):
        while more := os.read(ours, 1 << 12):
            text += more
    os.close(ours)
    assert b"hapfmt: interrupted" in text and b"Traceback" not in text
    assert [path.name for path in tmp_path.iterdir()] == ["big.npz"]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verdicts")
    time = np.arange(2000) / 1000
    labels = ["thumb CMC abduction torque", "little finger MCP flexion torque"]
    x = np.stack([np.sin(6 * time), np.cos(9 * time)])
    given: Any = {"rate": 1000, "labels": labels, "units": "N"}
    hapfmt.write(x, folder / "original.hapf", **given)
    hapfmt.write(x, folder / "near.hapf", **given, preset="near-lossless", max_error="1%")
    hapfmt.write(x + 0.5, folder / "other.hapf", **given)
    data = bytearray((folder / "original.hapf").read_bytes())
    data[len(data) // 2] ^= 16
    (folder / "damaged.hapf").write_bytes(data)
    return folder


class TestVerdicts:
    """The label, the verdict and the error of a channel stay on narrow terminals; bad is red."""

    ROWS = (
        ("verify near.hapf --against original.hapf", "verdict", "within", False),
        ("verify other.hapf --against original.hapf", "verdict", "broken", True),
        ("compare near.hapf original.hapf --tolerance 1%", "verdict", "within", False),
        ("compare other.hapf original.hapf", "verdict", "differs", True),
        ("archive verify damaged.hapf", "result", "damaged", True),
        ("verify damaged.hapf", "", "damaged", True),
    )

    @pytest.mark.parametrize("columns", [60, *deep([80])])
    @pytest.mark.parametrize(
        ("command", "header", "word", "bad"), sample(ROWS, 4, always={ROWS[1][0]})
    )
    def test_they_stay(
        self, files: Path, command: str, header: str, word: str, bad: bool, columns: int
    ) -> None:
        words = [sys.executable, "-m", "hapfmt", *command.split()]
        colors = {"TERM": "xterm", "NO_COLOR": ""}
        with pseudo_terminal(columns) as (slave, printed):
            subprocess.run(
                words, cwd=files, stdin=slave, stdout=slave, stderr=slave, check=False,
                env={**os.environ, **colors},
            )  # fmt: skip
            os.close(slave)
        text = b"".join(printed).decode().replace("\r\n", "\n")
        plain = re.sub(r"\x1b\[\d+m", "", text)
        assert max(map(len, plain.split("\n"))) <= columns and header in plain
        assert (f"\x1b[31m{word}\x1b[0m" in text) == bad and word in plain
        if header == "verdict":
            assert "little finger MCP flexion torque" in plain and "largest" in plain

    def test_no_colour_where_it_is_not_wanted(
        self, files: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("NO_COLOR", "")
        monkeypatch.setenv("TERM", "xterm")
        assert screen.colored("damaged", "damaged") != "damaged"
        said = called("verify", files / "damaged.hapf")
        assert "damaged" in said.out and "\x1b" not in said.out
        for name, value in (("NO_COLOR", "1"), ("TERM", "dumb")):
            with monkeypatch.context() as patch:
                patch.setenv(name, value)
                assert screen.colored("damaged", "damaged") == "damaged"
        assert screen.colored("damaged.hapf: intact", "intact") == "damaged.hapf: intact"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_the_progress_has_left_the_terminal_before_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hapfmt.cli import common, foreign, info

    hapfmt.save(recording(count=2000), tmp_path / "a.mcap")
    terminal, shown = Terminal(), []
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(common, "LONG_SECONDS", -1)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(foreign, "show", lambda *_: shown.append(terminal.getvalue()))
    info.info.main([str(tmp_path / "a.mcap")], standalone_mode=False)
    hide, bring_back = "\x1b[?25l", "\x1b[?25h"
    assert hide in shown[0] and shown[0].rindex(bring_back) > shown[0].rindex(hide)
    assert terminal.getvalue() == shown[0]


def test_what_is_printed_beside_the_progress_reaches_a_pipe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from hapfmt.cli import common

    terminal, pipe = Terminal(), io.StringIO()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(common, "LONG_SECONDS", -1)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "stdout", pipe)
    with common.progress("reading") as advance:
        advance(1, 2)
        screen.say("a line")
    assert pipe.getvalue() == "a line\n" and "a line" not in terminal.getvalue()


def test_suffixes_of_other_formats_are_refused(room: Path) -> None:
    for name in ("o.h5", "o.csv", "o.npz", "o.json", "o.PNG"):
        done = run("encode", "touch.npz", name, cwd=room)
        assert done.returncode == 1 and b"hapf files end in .hapf" in done.stderr
        assert not (room / name).exists()


def test_errors_of_several_lines_keep_them() -> None:
    error = ParameterError("first", more=["  hapfmt info x", "last"])
    assert str(error) == "first\n  hapfmt info x\nlast" and error.line() == "first"


def test_errors_are_json_too(room: Path) -> None:
    said = called("info", room / "none.hapf", "--json")
    assert json.loads(said.out)["exit_code"] == 1 and "No such file" in said.err


def test_help_has_sections() -> None:
    text = called("--help").out
    places = [text.index(f"{name}:\n") for name in SECTIONS]
    assert places == sorted(places) and len(VERBS) == 27
    for verb, what in VERBS.items():
        assert re.search(rf"^  {verb} +{re.escape(what)}$", text, re.M), verb


def test_help_of_every_verb_has_examples_and_groups_within_80_columns(tmp_path: Path) -> None:
    own = ("encode", "convert", "recover", "verify", "catalogue", "find", "bag")
    for verb in [*VERBS, *(f"archive {each}" for each in own)]:
        done = run_in_terminal(*verb.split(), "--help", cwd=tmp_path)
        text = done.stdout.decode().replace("\r\n", "\n")
        assert done.returncode == 0 and max(map(len, text.split("\n"))) <= 80, verb
        if verb not in ("profile", "archive"):  # groups, whose help lists their own verbs
            assert re.search(rf"\n\nExamples:\n(?:  .*hapfmt .*\n)*  .*hapfmt {verb}", text), verb
    text = called("encode", "--help-all").out
    parts = ["Quality:", "\n  --preset", "\n  --quality", "What is read:", "Output:",
             "For experts:", "\n  --canonical"]  # fmt: skip
    places = [text.index(part) for part in parts]
    assert places == sorted(places)


@pytest.mark.parametrize("verb", ["encode", "archive encode", "record"])
def test_a_help_shows_at_most_20_options_and_help_all_shows_the_rest(verb: str) -> None:
    short, whole = (
        re.findall(
            r"^  (?:-\w, )?(--[\w-]+)",
            called(*verb.split(), help_).out.partition("Quality:")[2],
            re.M,
        )
        for help_ in ("--help", "--help-all")
    )
    assert short[0] == "--preset" and len(short) <= 20 < len(whole) and set(short) < set(whole)
    words = verb.split()
    command = cli.get_command(click.Context(cli), words[0])
    command = getattr(command, "commands", {}).get(words[-1], command)
    names = {param.opts[-1] for param in command.params if isinstance(param, click.Option)}
    assert set(whole) == {*names, "--help"}
    assert f"{len(whole) - len(short)} more options" in re.sub(
        r"\s+", " ", called(*words, "--help").out
    )


def test_no_verb_at_all_prints_the_help() -> None:
    said = called()
    assert said.code == 1 and "Record and replay:" in said.out and not said.err


def test_version_says_whether_the_loops_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    from hapfmt import kernels

    monkeypatch.delenv("HAPFMT_PURE", raising=False)
    built = kernels.load() is not None
    assert (", compiled loops\n" in called("--version").out) == built
    monkeypatch.setenv("HAPFMT_PURE", "1")
    assert (", compiled loops\n" in called("--version").out) is False
    code = "import sys; from hapfmt.cli import main\ntry: main()\nfinally: print('numpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.endswith("False\n")


def test_verify_shows_its_proof_in_one_line_a_row(tmp_path: Path) -> None:
    values = np.cumsum(np.random.default_rng(1).normal(size=(2, 3000)), axis=1) / 1000
    labels = ["thumb CMC rotation abduction", "fx"]
    for preset in ("lossless", "near-lossless"):
        hapfmt.write(values, tmp_path / f"{preset}.hapf", rate=1000, labels=labels,
                     units=["rad", "N"], preset=preset)  # fmt: skip
    words = ("near-lossless.hapf", "--against", "lossless.hapf")
    text = run_in_terminal("verify", *words, cwd=tmp_path, columns=80).stdout.decode()
    (row,) = [line for line in text.splitlines() if "fx" in line]
    # The words of "kept as" go on in the next line; the numbers do not.
    assert len(row.split()) == 7 and 50 < float(row.split()[-2]) <= 100, text
    assert 0.05 < float(row.split()[-1]) <= 0.1, text
    assert "none is missing, none was added" in text
    words = ("near-lossless.hapf", "lossless.hapf", "--tolerance", "1%")
    text = run_in_terminal("compare", *words, cwd=tmp_path, columns=80).stdout.decode()
    assert len([line for line in text.splitlines() if "within" in line]) == 3, text


def test_info_tells_times_dates_and_notes(tmp_path: Path) -> None:
    known = recording(count=2000)
    late = hapfmt.Recording(
        tuple(channel.slice_ticks(1000, 2000) for channel in known.channels),
        metadata={"notes": ["one", "two"], "scene": {"points": list(range(200))}},
        epoch_ns=86_400 * 10**9,
    )  # fmt: skip
    hapfmt.write(late, tmp_path / "late.hapf")
    text = run("info", "late.hapf", cwd=tmp_path).stdout.decode()
    assert "1 s to 2 s (1 s)" in text
    assert "epoch_ns: 86400000000000 (1970-01-02T00:00:00Z)" in text
    assert "\nnote: one\nnote: two\n" in text
    assert max(map(len, text.splitlines())) < 250 and "--json shows all" in text


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["decode", "a.hapf", "out.npy"], r"out\.npy: 4 channels, 4 s, \d+ bytes"),
        (
            ["decode", "l.hapf", "out.csv", "--start", "1", "--stop", "1.5"],
            r"out\.csv: 4 channels, 1 to 1\.5 s, \d+ bytes",
        ),
        (["convert", "touch.npz", "out.csv"], r"out\.csv: 4 channels, 4 s, \d+ bytes"),
    ],
)
def test_a_terminal_says_what_was_written_and_a_pipe_nothing(
    room: Path, words: list[str], line: str
) -> None:
    shown = run_to_terminal(*words, "-f", cwd=room).stdout.decode()
    assert re.fullmatch(line, shown.strip()), shown
    assert run(*words, "-f", cwd=room).stdout == b""


def test_a_target_of_another_suffix_is_noted(room: Path) -> None:
    done = run("encode", "touch.npz", "touch.bin", "-f", cwd=room)
    assert done.returncode == 0
    assert done.stderr == b"note: touch.bin will be a hapf file; the usual suffix is .hapf\n"


def test_a_verb_offers_only_formats_that_it_writes(room: Path) -> None:
    offered = [
        re.sub(r"\s+", " ", run(verb, "--help", cwd=room).stdout.decode())
        for verb in ("decode", "convert")
    ]
    found = [
        re.search(r"Format of the output, if its name does not say: ([^.]*)", t) for t in offered
    ]
    assert ["hapf" in each[1] for each in found if each] == [False, True]
