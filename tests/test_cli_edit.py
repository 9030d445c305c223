"""The verbs that edit, as programs: output, pipes, JSON, exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from edited import assert_intact, assert_same, made
from test_cli import run, run_json

import hapfmt


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """a.hapf and b.hapf, of the same channels; damaged.hapf."""
    (tmp_path / "a.hapf").write_bytes(made("paper step"))
    (tmp_path / "b.hapf").write_bytes(made("paper step", 1, uuid=None, epoch_ns=None))
    (tmp_path / "damaged.hapf").write_bytes(made("paper step")[:-999])
    return tmp_path


def test_subset(room: Path) -> None:
    done = run(
        "subset",
        "a.hapf",
        "part.hapf",
        "--channels",
        "a,c",
        "--start",
        "1.2",
        "--stop",
        "1.3",
        cwd=room,
    )
    assert done.returncode == 0, done.stderr
    line = done.stdout.decode()
    assert line.startswith("part.hapf: ") and "2 channels, 1 s to 1.5 s (asked for " in line
    assert "(asked for 1.2 s to 1.3 s), 4 packets" in line
    assert [c.label for c in hapfmt.read(room / "part.hapf").channels] == ["a", "c"]
    code, told = run_json("subset", "a.hapf", "x.hapf", "--band", "hf", "--to-zero", cwd=room)
    assert (code, told["file"], told["start"]) == (0, "x.hapf", 0.0)
    assert [channel["label"] for channel in told["channels"]] == ["a", "b", "c"]
    piped = run("subset", "-", "-", "--channels", "1", stdin=made("paper step"), cwd=room)
    assert piped.returncode == 0
    assert_same(hapfmt.read(piped.stdout), hapfmt.read(made("paper step"), ["b"]))


def test_subsets_of_one_file_are_the_same_bytes(room: Path) -> None:
    twice = [
        run("subset", "a.hapf", "-", "--channels", "b", "--canonical", "3", cwd=room).stdout
        for _ in range(2)
    ]
    assert twice[0] == twice[1]
    assert_intact(twice[0])


def test_split_and_concat(room: Path) -> None:
    done = run("split", "a.hapf", "--at", "0.9,2", "--output", "p{:02d}.hapf", cwd=room)
    assert done.returncode == 0, done.stderr
    names = ["p00.hapf", "p01.hapf", "p02.hapf"]
    assert [line.split(":")[0] for line in done.stdout.decode().splitlines()] == names
    again = run("split", "a.hapf", "--at", "0.9,2", "--output", "p{:02d}.hapf", cwd=room)
    assert again.returncode == 1 and b"already exists" in again.stderr
    code, told = run_json("concat", *names, "whole.hapf", cwd=room)
    assert code == 0 and told["offsets"] == [0.0, 0.0, 0.0]
    assert_same(hapfmt.read(room / "whole.hapf"), hapfmt.read(room / "a.hapf"))
    code, told = run_json("split", "a.hapf", "--every", "1", "--to-zero", cwd=room)
    assert [part["start"] for part in told["parts"]] == [0.0] * 4
    assert run("split", "a.hapf", "--every", "1", "--output", "-", cwd=room).returncode == 1


def test_merge(room: Path) -> None:
    done = run("merge", "a.hapf", "b.hapf", "both.hapf", cwd=room)
    assert done.returncode == 1 and b"give --by-epoch, --same-times" in done.stderr
    done = run("merge", "a.hapf", "b.hapf", "both.hapf", "--offset", "b.hapf=0.5", cwd=room)
    assert done.returncode == 0
    assert b"note: labels that more than one file has: a, b, c" in done.stderr
    code, told = run_json(
        "merge", "a.hapf", "b.hapf", "c.hapf", "--same-times", "--prefix", "l/", "--prefix", "r/",
        cwd=room,
    )  # fmt: skip
    assert code == 0 and [c["label"] for c in told["channels"]][2:4] == ["l/c", "r/a"]
    wrong: list[list[str]] = [
        ["--offset", "b.hapf"], ["--offset", "c.hapf=1"], ["--offset", "b.hapf=0.0001"],
        ["--by-epoch", "--same-times"], ["--prefix", "x"], ["--by-epoch"],
    ]  # fmt: skip
    for options in wrong:
        assert run("merge", "a.hapf", "b.hapf", "d.hapf", *options, cwd=room).returncode == 1
    assert not (room / "d.hapf").exists()


def test_attach_and_meta(room: Path) -> None:
    (room / "note.txt").write_text("hello")
    assert run("attach", "a.hapf", "note.txt", cwd=room).stdout == b"a.hapf: attached note.txt\n"
    code, told = run_json("attach", "a.hapf", "--list", cwd=room)
    assert code == 0 and told["attachments"][1] == {
        "name": "note.txt", "media_type": "text/plain", "size": 5,
    }  # fmt: skip
    assert b"note.txt" in run("attach", "a.hapf", "--list", cwd=room).stdout
    (room / "out").mkdir()
    done = run("attach", "a.hapf", "--extract", "note.txt", "--output", "out", cwd=room)
    assert (room / "out" / "note.txt").read_text() == "hello" and done.returncode == 0
    code, told = run_json("attach", "a.hapf", "--extract", "--output", "out", "-f", cwd=room)
    assert len(told["files"]) == 2
    done = run("meta", "a.hapf", "subject=S7", 'rig={"v": 2}', "x=NaN", cwd=room)
    assert done.stdout == b"a.hapf: set subject, rig, x\n"
    code, known = run_json("meta", "a.hapf", cwd=room)
    assert (known["subject"], known["rig"], known["x"]) == ("S7", {"v": 2}, "NaN")
    assert 'rig: {"v": 2}' in run("meta", "a.hapf", cwd=room).stdout.decode()
    assert_intact((room / "a.hapf").read_bytes(), digests=6)
    before = (room / "a.hapf").read_bytes()
    done = run("meta", "-", "subject=S8", "-o", "-", stdin=before, cwd=room)
    assert done.stdout.startswith(before)
    assert hapfmt.read(done.stdout).metadata["subject"] == "S8"
    wrong: list[list[str]] = [
        ["attach", "a.hapf"], ["attach", "a.hapf", "--list", "--extract"], ["attach", "a.hapf", "no"],
        ["attach", "a.hapf", "note.txt", "a.hapf", "--name", "x"], ["meta", "a.hapf", "subject"],
        ["meta", "a.hapf", "a=1", "-o", "b.hapf"], ["meta", "a.hapf", "a=1", "-o", "b.wav"],
    ]  # fmt: skip
    for arguments in wrong:
        assert run(*arguments, cwd=room).returncode == 1
    assert (room / "a.hapf").read_bytes() == before


VERBS: list[list[Any]] = [
    ["subset", "damaged.hapf", "out.hapf"],
    ["split", "damaged.hapf", "--every", "1", "--output", "out-{}.hapf"],
    ["concat", "a.hapf", "damaged.hapf", "out.hapf"],
    ["merge", "a.hapf", "damaged.hapf", "out.hapf", "--same-times"],
    ["meta", "damaged.hapf", "a=1", "-o", "out.hapf"],
]


@pytest.mark.parametrize("arguments", VERBS, ids=lambda arguments: arguments[0])
def test_damage_is_refused_with_its_own_exit_code(room: Path, arguments: list[str]) -> None:
    done = run(*arguments, "--json", cwd=room)
    assert done.returncode == 3
    assert b"run hapfmt recover first" in done.stderr
    assert json.loads(done.stdout)["exit_code"] == 3
    assert list(room.glob("out*")) == []


@pytest.mark.parametrize(
    "words",
    [
        ("subset", "a.hapf", "x.hapf"),
        ("split", "a.hapf", "--every", "1"),
        ("concat", "a.hapf", "b.hapf", "x.hapf"),
        ("merge", "a.hapf", "b.hapf", "x.hapf", "--same-times"),
    ],
)
def test_more_than_the_memory_is_refused(room: Path, words: tuple[str, ...]) -> None:
    done = run(*words, "--max-memory", "2k", cwd=room)
    assert done.returncode == 4 and b"--max-memory" in done.stderr
    assert not (room / "x.hapf").exists() and not list(room.glob("part-*"))
    assert run(*words, "--max-memory", "64M", cwd=room).returncode == 0


def test_a_part_that_reaches_beyond_its_times_says_so(tmp_path: Path) -> None:
    np.savez(tmp_path / "t.npz", x=np.sin(np.arange(3000) / 50)[None], rate_hz=1000.0)
    assert run("encode", "t.npz", "t.hapf", "--cluster", "3", cwd=tmp_path).returncode == 0
    done = run("subset", "t.hapf", "p.hapf", "--start", "1", "--stop", "2", cwd=tmp_path)
    assert done.returncode == 0
    assert b"0 s to 3 s (asked for 1 s to 2 s), 1 packet" in done.stdout
    assert done.stderr == b"note: packets are kept whole; --exact cuts at the sample\n"
    for words in (["--start", "1", "--stop", "2"], ["--start", "2"]):
        done = run("subset", "t.hapf", "p.hapf", "-f", "--exact", *words, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, b"")
        exact = hapfmt.read(tmp_path / "p.hapf")["ch1"]
        assert exact.coverage == (
            hapfmt.Span(int(words[1]) * 1000, 2000 + 1000 * (len(words) < 3)),
        )
    done = run("subset", "t.hapf", "x.hapf", "--exact", cwd=tmp_path)
    assert done.returncode == 1 and b"--exact requires --start or --stop" in done.stderr
    code, told = run_json("split", "t.hapf", "--at", "1.5,2", "--exact", cwd=tmp_path)
    assert code == 0 and [part["made"] for part in told["parts"]] == [[0, 1.5], [1.5, 2], [2, 3]]
    done = run("concat", "part-000.hapf", "part-002.hapf", "c.hapf", cwd=tmp_path)
    assert b"note: missing: 1.5 s to 2 s of all channels\n" in done.stderr
    assert run("encode", "t.npz", "t.hapf", "-f", "--cluster", "1", cwd=tmp_path).returncode == 0
    done = run("subset", "t.hapf", "p.hapf", "-f", "--start", "1", "--stop", "2", cwd=tmp_path)
    assert b"kept whole" not in done.stderr
