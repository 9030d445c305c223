"""hapfmt archive: many files, a catalogue, bags."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from server import serving

import hapfmt
from hapfmt.archive import bags, catalogue, jobs, places, runs, work
from hapfmt.archive.places import Place
from hapfmt.cli.screen import in_options
from hapfmt.errors import ParameterError
from hapfmt.format.source import NO_PARTS
from hapfmt.limits import Limits

pytestmark = pytest.mark.skipif(os.name == "nt", reason="names and links of POSIX")
AS_ROOT = hasattr(os, "geteuid") and os.geteuid() == 0
NAMES = ["plain", "with space", "gräße", "日本", "line\nbreak", "quote'\"", "-dash", "a.b"]
BAGGED = [name for name in NAMES if "\n" not in name]
"""Programs read a line break in a name of a bag differently, so it is refused there."""


def signal_of(seed: int, size: int = 300) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    return np.round(rng.normal(0, 2, (2, size)), 3)


def write_npz(path: Path, seed: int = 1, size: int = 300) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    recording = hapfmt.Recording.from_array(
        signal_of(seed, size), rate=1000, labels=["fx", "fy"], units="N"
    )
    hapfmt.save(recording, path, force=True)


def write_hapf(path: Path, seed: int = 1, size: int = 300) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    hapfmt.write(signal_of(seed, size), path, rate=1000, labels=["fx", "fy"], units=["N", "mm"])


def archive(*words: object, cwd: Path, code: int = 0) -> str:
    done = commands.run("archive", *words, cwd=cwd)
    assert done.returncode == code, done.stdout.decode() + done.stderr.decode()
    assert b"Traceback" not in done.stderr
    return done.stdout.decode()


def report(*words: object, cwd: Path, code: int = 0) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(archive(*words, "--json", cwd=cwd, code=code))
    assert found["exit_code"] == code
    return found


def results(found: dict[str, Any]) -> dict[str, str]:
    return {each["file"]: each["result"] for each in found["files"]}


def visible(folder: Path) -> set[str]:
    """Files of a folder, but for the log."""
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return found - {".hapfmt-archive/log.jsonl"}


def flip(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 0x40
    path.write_bytes(data)


def damage(path: Path) -> None:
    """One byte in the middle, where the packets are."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x40
    path.write_bytes(data)


class TestEncode:
    def test_every_name_comes_back_whole_and_is_skipped_the_next_time(self, tmp_path: Path):
        for seed, name in enumerate(NAMES):
            write_npz(tmp_path / "in" / f"sub {seed % 2}" / f"{name}.npz", seed)
        (tmp_path / "in" / "notes.txt").write_text("no recording")
        (tmp_path / "in" / ".hidden.npz").write_text("no recording")
        found = report("encode", "in", "out", cwd=tmp_path)
        assert found["results"] == {"encoded": len(NAMES)}
        targets = {f"sub {seed % 2}/{name}.hapf" for seed, name in enumerate(NAMES)}
        assert visible(tmp_path / "out") == targets
        for seed, name in enumerate(NAMES):
            back = hapfmt.read(tmp_path / "out" / f"sub {seed % 2}" / f"{name}.hapf")
            assert np.array_equal(back.to_numpy(), signal_of(seed))
        before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.hapf")}
        found = report("encode", "in", "out", cwd=tmp_path)
        assert found["results"] == {"skipped": len(NAMES)}
        assert before == {path: path.stat().st_mtime_ns for path in before}

    def test_a_changed_source_is_refused_without_force(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz", 1)
        archive("encode", "in", "out", cwd=tmp_path)
        write_npz(tmp_path / "in" / "a.npz", 2, 400)
        found = report("encode", "in", "out", cwd=tmp_path, code=1)
        text = archive("encode", "in", "out", cwd=tmp_path, code=1)
        assert "the recording has changed since" in text
        assert "use --force" in text
        text = archive("encode", "in", "out", "--preset", "near-lossless", cwd=tmp_path, code=1)
        assert "the recording has changed since" in text
        assert results(found) == {"a.npz": "failed"}
        assert len(hapfmt.read(tmp_path / "out" / "a.hapf")["fx"].to_numpy()) == 300
        found = report("encode", "in", "out", "--force", cwd=tmp_path)
        assert results(found) == {"a.npz": "encoded"}
        assert len(hapfmt.read(tmp_path / "out" / "a.hapf")["fx"].to_numpy()) == 400

    @pytest.mark.deep
    def test_other_options_are_not_done_yet(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        archive("encode", "in", "out", cwd=tmp_path)
        more = ("--preset", "near-lossless", "--max-error", "1%")
        assert report("encode", "in", "out", *more, cwd=tmp_path, code=1)["results"] == {
            "failed": 1
        }
        found = report("encode", "in", "out", *more, "--force", cwd=tmp_path)
        assert found["results"] == {"encoded": 1}
        found = report("encode", "in", "out", *more, cwd=tmp_path)
        assert found["results"] == {"skipped": 1}

    def test_a_file_of_somebody_else_stays(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "a.hapf").write_text("mine")
        report("encode", "in", "out", cwd=tmp_path, code=1)
        report("encode", "in", "out", cwd=tmp_path, code=1)  # nor is it taken for our own
        assert (tmp_path / "out" / "a.hapf").read_text() == "mine"

    def test_bad_files_are_one_line_each_and_stop_nothing(self, tmp_path: Path):
        folder = tmp_path / "in"
        write_npz(folder / "good.npz")
        (folder / "bad.npz").write_text("junk")
        (folder / "empty.csv").write_text("")
        (folder / "loop.npz").symlink_to("loop.npz")
        (folder / "gone.npz").symlink_to("nothing")
        os.mkfifo(folder / "pipe.npz")
        (folder / "deep").mkdir()
        (folder / "deep" / "up").symlink_to(folder)  # a loop of folders
        found = report("encode", "in", "out", cwd=tmp_path, code=1)
        assert results(found) == {"good.npz": "encoded"} | dict.fromkeys(
            ["bad.npz", "empty.csv", "loop.npz", "gone.npz", "pipe.npz"], "failed"
        )
        assert all(each["message"] for each in found["files"] if each["exit_code"])
        assert visible(tmp_path / "out") == {"good.hapf"}
        lines = archive("encode", "in", "out", cwd=tmp_path, code=1).splitlines()
        for name in ("bad.npz", "empty.csv", "loop.npz", "gone.npz", "pipe.npz"):
            assert sum(line.startswith(f"{name} ") for line in lines) == 1

    def test_no_link_leads_out_of_the_source(self, tmp_path: Path):
        """Neither what lies there is encoded, nor a line of it printed."""
        secret = tmp_path / "secret"
        write_npz(secret / "b.npz")
        (secret / "s.csv").write_text("password,hunter2\n")
        (secret / "bag").mkdir()
        (secret / "bag" / "metadata.yaml").write_text("password: hunter2\n")
        folder = tmp_path / "in"
        write_npz(folder / "deep" / "a.npz")
        (folder / "s.csv").symlink_to(secret / "s.csv")
        (folder / "deep" / "b.npz").symlink_to("../../secret/b.npz")
        (folder / "gone.npz").symlink_to(secret / "gone.npz")
        (folder / "twice.npz").symlink_to("deep/b.npz")
        (folder / "all").symlink_to(secret)
        (folder / "inside.npz").symlink_to("deep/a.npz")
        (folder / "bag").mkdir()
        (folder / "bag" / "metadata.yaml").symlink_to(secret / "bag" / "metadata.yaml")
        (folder / "deep" / "up").symlink_to(folder)  # within: its files are found anyway
        links = ["s.csv", "deep/b.npz", "gone.npz", "twice.npz", "bag", "all"]
        found = report("encode", "in", "out", cwd=tmp_path)
        assert results(found) == dict.fromkeys(["deep/a.npz", "inside.npz"], "encoded") | (
            dict.fromkeys(links, "not followed")
        )
        assert found["results"] == {"encoded": 2, "not followed": 6}
        assert visible(tmp_path / "out") == {"deep/a.hapf", "inside.hapf"}
        done = commands.run("archive", "encode", "in/**/*.*", "more", cwd=tmp_path)
        assert b"a link out of its source is not followed" in done.stderr
        assert b"hunter2" not in done.stdout + done.stderr
        assert "b.hapf" not in {Path(name).name for name in visible(tmp_path / "more")}
        assert results(report("encode", "in/twice.npz", "it", cwd=tmp_path)) == {
            "twice.npz": "encoded"
        }
        (tmp_path / "out" / "link.hapf").symlink_to(tmp_path / "it" / "twice.hapf")
        for verb in ("verify", "catalogue", "recover"):
            words = [verb, "out", *(["again"] if verb == "recover" else [])]
            done = commands.run("archive", *words, cwd=tmp_path)
            assert done.returncode == 0
            assert b"link.hapf: a link out of its source is not followed" in done.stderr

    def test_a_link_that_takes_the_place_of_a_file(self, tmp_path: Path):
        """Between the search for files and the work on one."""
        write_npz(tmp_path / "in" / "a.npz")
        write_npz(tmp_path / "secret" / "b.npz")
        (place,) = places.find_places([str(tmp_path / "in")], places.is_foreign)
        (tmp_path / "in" / "a.npz").unlink()
        (tmp_path / "in" / "a.npz").symlink_to("../secret/b.npz")
        (outcome,) = runs.run([jobs.Job("encode", place, str(tmp_path / "a.hapf"), str(tmp_path))])
        assert outcome.message == "a link has taken the place of this file"
        assert not (tmp_path / "a.hapf").exists()

    def test_two_sources_of_one_target_are_both_refused(self, tmp_path: Path):
        for name in ("a.npz", "a.npy.npz", "b.npz"):
            write_npz(tmp_path / "in" / name)
        (tmp_path / "in" / "a.csv").write_text("t,fx\n0,1\n0.001,2\n0.002,3\n")
        found = report("encode", "in", "out", cwd=tmp_path, code=1)
        assert results(found) == {
            "a.csv": "failed", "a.npz": "failed", "a.npy.npz": "encoded", "b.npz": "encoded",
        }  # fmt: skip
        assert "same target" in found["files"][0]["message"]
        assert "a.npz" in found["files"][0]["message"]
        assert visible(tmp_path / "out") == {"a.npy.hapf", "b.hapf"}
        write_npz(tmp_path / "other" / "b.npz")
        found = report("encode", "in", "other", "more", cwd=tmp_path, code=1)
        messages = [each["message"] for each in found["files"] if each["message"]]
        assert any("other/b.npz would have the same target" in each for each in messages)

    def test_patterns_and_single_files(self, tmp_path: Path):
        for day in ("day1", "day2", "night"):
            write_npz(tmp_path / day / "x" / "a.npz")
        found = report("encode", "day?/**/*.npz", "out", cwd=tmp_path)
        assert visible(tmp_path / "out") == {"day1/x/a.hapf", "day2/x/a.hapf"}
        found = report("encode", "night/x/a.npz", "one", cwd=tmp_path)
        assert visible(tmp_path / "one") == {"a.hapf"}
        found = report("encode", "nothing*.npz", "missing.npz", "out", cwd=tmp_path, code=1)
        assert results(found) == {"nothing*.npz": "failed", "missing.npz": "failed"}

    def test_notes_are_said_by_kind(self, tmp_path: Path):
        times = np.arange(2000) / 1000 + np.random.default_rng(1).normal(0, 1e-4, 2000)
        rows = "".join(f"{t:.6f},{k}\n" for k, t in enumerate(np.sort(times)))
        (tmp_path / "in").mkdir()
        for name in ("a", "b"):
            (tmp_path / "in" / f"{name}.csv").write_text("t,fx\n" + rows)
        for verb, more in (("encode", []), ("convert", ["--output-format", "npz"])):
            done = commands.run("archive", verb, "in", f"{verb}d", *more, cwd=tmp_path)
            notes = [line for line in done.stderr.decode().splitlines() if "note" in line]
            assert sum("2 files, such as a.csv: " in line for line in notes) == len(notes) - 1 > 0
            assert notes[-1] == "note: --json lists the notes by file"
        found = report("encode", "in", "again", cwd=tmp_path)
        assert all(each["notes"] for each in found["files"])

    def test_nothing_is_left_out_silently(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        write_hapf(tmp_path / "in" / "b.hapf")
        (tmp_path / "in" / "c.txt").write_text("")
        (tmp_path / "in" / ".d").write_text("")
        done = commands.run("archive", "encode", "in", "out", cwd=tmp_path)
        assert b"left out: 1 .hapf file: b.hapf. To convert them" in done.stderr
        assert b"left out: 1 file of other formats: c.txt" in done.stderr
        names = ["b.hapf", "c.txt", *(f"n{place:02}.md" for place in range(11))]
        for name in names[2:]:
            (tmp_path / "in" / name).write_text("")
        done = commands.run("archive", "encode", "in", "out", cwd=tmp_path)
        told = ", ".join(names[1:11])
        rest = " and 2 more (--json lists all)"
        said = " ".join(done.stderr.decode().split())
        assert f"left out: 12 files of other formats: {told}{rest}" in said
        assert report("encode", "in", "out", cwd=tmp_path)["left_out"] == names
        done = commands.run("archive", "encode", "out/raw", "out", cwd=tmp_path)
        assert done.returncode == 1
        assert b"lies in the folder TARGET" in done.stderr

    def test_an_empty_folder(self, tmp_path: Path):
        (tmp_path / "in").mkdir()
        done = commands.run("archive", "encode", "in", "out", cwd=tmp_path)
        assert done.returncode == 0
        assert b"no file was found" in done.stderr

    def test_targets_that_cannot_be(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        (tmp_path / "file").write_text("")
        for target in ("file", "file/below", "http://127.0.0.1:1/x", "memory://x", "/proc/none"):
            done = commands.run("archive", "encode", "in", target, cwd=tmp_path)
            assert done.returncode == 1
            assert done.stderr.startswith(b"hapfmt: ")

    def test_what_may_not_be_read_or_written(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        in_process(tmp_path / "in", tmp_path / "out")  # imports, for which rights are needed too
        with tempfile.TemporaryDirectory() as name, without_rights() as give_up:
            room = Path(name)
            for folder in ("a", "b", "c", "d"):
                write_npz(room / "in" / folder / "x.npz")
            out = room / "out"
            (out / "b").mkdir(parents=True)
            shut = {
                room: 0o755,
                out: 0o777,
                out / "b": 0o555,
                room / "in" / "c": 0,
                room / "in" / "a" / "x.npz": 0,
            }
            for path, mode in shut.items():
                path.chmod(mode)
            give_up()
            found = in_process(room / "in", out)
            assert {each.name: each.message for each in found} == {
                "a/x.npz": "Permission denied", "b/x.npz": "Permission denied",
                "c": "Permission denied", "d/x.npz": "",
            }  # fmt: skip
            (out / "b").chmod(0o755) if not AS_ROOT else None
            (room / "in" / "c").chmod(0o755) if not AS_ROOT else None

    def test_a_full_disk_costs_that_file_alone(self, tmp_path: Path):
        """A limit on the size of files stands for the disk."""
        import resource

        write_npz(tmp_path / "in" / "a.npz", 1, 20)
        write_npz(tmp_path / "in" / "b.npz", 2, 40_000)
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
        try:
            found = in_process(tmp_path / "in", tmp_path / "out")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
            signal.signal(signal.SIGXFSZ, before)
        assert [each.exit_code for each in found] == [0, 1]
        assert found[1].message == "File too large"
        assert visible(tmp_path / "out") == {"a.hapf"}
        assert [each.result for each in in_process(tmp_path / "in", tmp_path / "out")] == [
            "skipped", "encoded",
        ]  # fmt: skip

    def test_a_fault_of_a_library_is_one_line(self, tmp_path: Path, monkeypatch):
        def fail(_job: object, _outcome: object) -> None:
            raise RecursionError("too deep")

        monkeypatch.setitem(work.WORK, "encode", fail)
        write_npz(tmp_path / "in" / "a.npz")
        (found,) = in_process(tmp_path / "in", tmp_path / "out")
        assert (found.exit_code, found.message) == (1, "internal error: RecursionError: too deep")


@contextmanager
def without_rights() -> Iterator[Callable[[], None]]:
    """A function that gives up the rights of root until the end of the block."""
    nobody = 65534
    try:
        yield lambda: os.seteuid(nobody) if AS_ROOT else None
    finally:
        if AS_ROOT:
            os.seteuid(0)


def encode_jobs(source: Path, target: Path, **more: Any) -> list[jobs.Job]:
    found = places.find_places([str(source)], places.is_foreign)
    targets, _ = runs.targets_of(found, str(target), ".hapf")
    options = {"preset": "lossless", "given": {}, "reading": {}}
    staging = str(target / runs.FOLDER / runs.STAGING)
    return [
        jobs.Job("encode", place, output, staging, options, **more)
        for place, output in zip(found, targets, strict=True)
    ]


def in_process(source: Path, target: Path) -> list[jobs.FileOutcome]:
    with (
        runs.Log(target / runs.FOLDER / runs.LOG) as log,
        runs.emptied(target / runs.FOLDER / runs.STAGING),
    ):
        return runs.run(encode_jobs(source, target), log=log, skip=runs.skip_written)


class TestInterrupted:
    def test_killed_between_the_file_and_its_line_in_the_log(self, tmp_path: Path, monkeypatch):
        write_npz(tmp_path / "in" / "a.npz")
        original = runs.run_job

        def killed(job: jobs.Job) -> jobs.FileOutcome:
            original(job)
            raise KeyboardInterrupt

        monkeypatch.setattr(runs, "run_job", killed)
        with pytest.raises(KeyboardInterrupt):
            in_process(tmp_path / "in", tmp_path / "out")
        monkeypatch.undo()
        assert visible(tmp_path / "out") == {"a.hapf"}
        (found,) = in_process(tmp_path / "in", tmp_path / "out")
        assert (found.result, found.exit_code) == ("skipped", 0)

    def test_interrupted_while_a_file_is_encoded(self, tmp_path: Path, monkeypatch):
        from hapfmt.writing import writer

        write_npz(tmp_path / "in" / "a.npz")
        write = writer.write

        def interrupted(_recording: Any, file: Path, *_: Any, **_options: Any) -> None:
            file.write_bytes(b"a part")
            raise KeyboardInterrupt

        monkeypatch.setattr(writer, "write", interrupted)
        with pytest.raises(KeyboardInterrupt):
            in_process(tmp_path / "in", tmp_path / "out")
        assert visible(tmp_path / "out") == set()
        monkeypatch.setattr(writer, "write", write)
        (found,) = in_process(tmp_path / "in", tmp_path / "out")
        assert (found.result, found.exit_code) == ("encoded", 0)

    def test_what_a_killed_run_left_unfinished_goes(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        left = tmp_path / "out" / runs.FOLDER / runs.STAGING
        left.mkdir(parents=True)
        (left / "0123.hapf").write_bytes(b"a part")
        report("encode", "in", "out", cwd=tmp_path)
        assert visible(tmp_path / "out") == {"a.hapf"}

    def test_a_log_that_a_crash_cut_or_somebody_broke(self, tmp_path: Path):
        for name in ("a", "b"):
            write_npz(tmp_path / "in" / f"{name}.npz")
        report("encode", "in", "out", cwd=tmp_path)
        path = tmp_path / "out" / runs.FOLDER / runs.LOG
        lines = path.read_bytes().splitlines(keepends=True)
        odd = [b"\xff\n", b"[]\n", b'{"file": 3, "stamp": []}\n', b'{"file": "x"}\n', b"null\n"]
        path.write_bytes(b"".join([*lines[:3], *odd, lines[3], lines[4][:-20]]))
        # The second file is whole, and the log says that it was begun here.
        assert report("encode", "in", "out", cwd=tmp_path)["results"] == {"skipped": 2}
        assert report("encode", "in", "out", cwd=tmp_path)["results"] == {"skipped": 2}

    def test_one_run_at_a_time(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        with runs.Log(tmp_path / "out" / runs.FOLDER / runs.LOG):
            done = commands.run("archive", "encode", "in", "out", cwd=tmp_path)
        assert done.returncode == 1
        assert b"another run uses the log" in done.stderr

    @pytest.mark.parametrize("verb", ["encode", "verify", "catalogue", "bag"])
    @pytest.mark.parametrize("kind", ["text", "recording", "folder", "device", "other log"])
    def test_a_file_that_is_no_log_stays(self, tmp_path: Path, verb: str, kind: str):
        pytest.importorskip("polars")
        pytest.importorskip("rocrate")
        write_hapf(tmp_path / "in" / "a.hapf")
        path = tmp_path / "report.log"
        if kind == "text":
            path.write_text("my notes")
        elif kind == "recording":
            write_hapf(path)
        elif kind == "folder":
            path.mkdir()
        elif kind == "device":
            path.symlink_to("/dev/null")
        else:
            with runs.Log(path, "something else"):
                pass
        before = path.read_bytes() if path.is_file() else b""
        words = {"encode": ["in", "out"], "catalogue": ["in", "-o", "c.parquet"]}.get(verb, ["in"])
        done = commands.run("archive", verb, *words, "--log", "report.log", cwd=tmp_path)
        assert done.returncode == 1
        wanted = b"is the log of another command" if kind == "other log" else b"is not a log of"
        assert wanted in done.stderr
        assert path.exists()
        assert not path.is_file() or path.read_bytes() == before
        assert (tmp_path / "in" / "a.hapf").exists()

    def test_an_archive_that_moved_goes_on(self, tmp_path: Path):
        write_npz(tmp_path / "lab" / "in" / "a.npz")
        report("encode", "in", "out", cwd=tmp_path / "lab")
        (tmp_path / "lab").rename(tmp_path / "moved")
        found = report("encode", "in", "out", cwd=tmp_path / "moved")
        assert found["results"] == {"skipped": 1}
        log = (tmp_path / "moved" / "out" / runs.FOLDER / runs.LOG).read_text()
        assert str(tmp_path) not in log

    def test_an_interruption_says_how_far_it_is(self):
        from hapfmt.cli.archive import counting

        shown: list[tuple[int, int]] = []
        with (
            pytest.raises(ParameterError, match="3 of 7 files done; the same command goes on"),
            counting(lambda *state: shown.append(state), "the same command goes on") as count,
        ):
            count(3, 7)
            raise KeyboardInterrupt
        assert shown == [(3, 7)]

    @pytest.mark.deep
    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
    @pytest.mark.parametrize("more", [(), ("--jobs", "2")], ids=["here", "jobs"])
    def test_ended_in_the_middle(self, tmp_path: Path, number: signal.Signals, more: tuple[str]):
        for seed in range(60):
            write_npz(tmp_path / "in" / f"{seed}.npz", seed, 8_000)
        words = [sys.executable, "-m", "hapfmt", "archive", "encode", "in", "out", *more]
        process = subprocess.Popen(
            words, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        while not list((tmp_path / "out").glob("1*.hapf")) and process.poll() is None:
            time.sleep(0.01)
        assert process.poll() is None
        os.killpg(process.pid, number)
        process.communicate()
        assert process.returncode == (1 if number == signal.SIGINT else -number)
        whole = list((tmp_path / "out").glob("*.hapf"))
        assert 0 < len(whole) < 60
        assert [path for path in whole if hapfmt.verify(path).exit_code] == []
        if number == signal.SIGINT:
            assert visible(tmp_path / "out") == {path.name for path in whole}
        found = report("encode", "in", "out", cwd=tmp_path)
        assert found["results"]["skipped"] >= len(whole)
        assert sum(found["results"].values()) == 60
        assert visible(tmp_path / "out") == {f"{seed}.hapf" for seed in range(60)}


class TestRecoverAndConvert:
    def test_advice_is_for_the_command_line(self, tmp_path: Path):
        write_hapf(tmp_path / "in" / "a.hapf", size=3000)
        damage(tmp_path / "in" / "a.hapf")
        words = ["convert", "in", "out", "--output-format", "csv"]
        for text in (
            archive(*words, cwd=tmp_path, code=2),
            report(*words, cwd=tmp_path, code=2)["files"][0]["message"],
        ):
            assert "hapfmt recover writes an intact copy" in " ".join(text.split())
            assert "hapfmt." not in text
        assert "Reader" not in in_options(NO_PARTS)

    def test_nothing_to_recover(self, tmp_path: Path):
        hapfmt.write(np.arange(300.0), tmp_path / "a.hapf", rate=1000, labels=["x"])
        for place in range(80, (tmp_path / "a.hapf").stat().st_size, 40):
            flip(tmp_path / "a.hapf", place)
        found = report("recover", "a.hapf", "out", cwd=tmp_path, code=3)
        assert "nothing was recovered" in found["files"][0]["message"]

    @pytest.mark.parametrize("words", [["verify"], ["catalogue"], ["recover", "out"]])
    def test_losses_that_are_not_shown_are_counted(self, tmp_path: Path, words: list[str]):
        x, path = np.random.default_rng(1).normal(size=12000), tmp_path / "in" / "a.hapf"
        path.parent.mkdir()
        hapfmt.write(x, path, rate=1000, labels=["x"], cluster=1)
        size = path.stat().st_size
        for place in range(5):
            flip(path, size * (4 * place + 3) // 24)
        lines = hapfmt.verify(path).summary
        assert len(lines) > 4
        found = report(words[0], "in", *words[1:], cwd=tmp_path, code=3)
        (message,) = (each["message"] for each in found["files"])
        more = f"and {len(lines) - 3} more: hapfmt verify FILE lists all"
        assert message == "; ".join([*lines[:3], more])

    def test_only_damaged_files_are_written(self, tmp_path: Path):
        for name in ("a", "b"):
            write_hapf(tmp_path / "in" / f"{name}.hapf", size=3000)
        damage(tmp_path / "in" / "b.hapf")
        found = report("recover", "in", "out", cwd=tmp_path, code=3)
        assert results(found) == {"a.hapf": "intact", "b.hapf": "recovered"}
        assert visible(tmp_path / "out") == {"b.hapf"}
        assert hapfmt.verify(tmp_path / "out" / "b.hapf").exit_code == 0
        assert found["files"][1]["message"]
        # The loss stays in the exit code, although nothing is done again.
        assert report("recover", "in", "out", cwd=tmp_path, code=3)["results"] == {"skipped": 2}

    def test_to_another_format_and_back(self, tmp_path: Path):
        write_hapf(tmp_path / "in" / "s" / "a.hapf", 3)
        report("convert", "in", "csvs", "--output-format", "csv", cwd=tmp_path)
        report("convert", "csvs", "back", "--output-format", "hapf", cwd=tmp_path)
        assert visible(tmp_path / "back") == {"s/a.hapf"}
        back = hapfmt.read(tmp_path / "back" / "s" / "a.hapf")
        assert np.array_equal(back.to_numpy(), signal_of(3))
        done = commands.run("archive", "convert", "in", "x", "--output-format", "xdf", cwd=tmp_path)
        assert done.returncode == 1
        assert b"does not write" in done.stderr

    def test_outputs_and_catalogues_are_not_inputs(self, tmp_path: Path):
        write_hapf(tmp_path / "a.hapf")
        (tmp_path / "catalogue.parquet").write_text("no recording")
        for _ in range(2):
            found = report("convert", ".", "csvs", "--output-format", "csv", cwd=tmp_path)
            assert list(results(found)) == ["a.hapf"]
            found = report("convert", "*", "csvs", "--output-format", "csv", cwd=tmp_path)
            assert list(results(found)) == ["a.hapf"]
        found = report("convert", ".", ".", "--output-format", "npz", cwd=tmp_path)
        assert visible(tmp_path) >= {"a.npz", "csvs/a.npz"}


class TestVerify:
    def test_quiet_when_all_is_good(self, tmp_path: Path):
        write_hapf(tmp_path / "in" / "a.hapf")
        assert archive("verify", "in", cwd=tmp_path) == ""
        shown = commands.run_in_terminal("archive", "verify", "in", cwd=tmp_path)
        assert b"intact" in shown.stdout

    def test_the_worst_code_counts(self, tmp_path: Path):
        for name in ("a", "b", "c"):
            write_hapf(tmp_path / "in" / f"{name}.hapf", size=3000)
        damage(tmp_path / "in" / "a.hapf")
        found = report("verify", "in", cwd=tmp_path, code=3)
        assert results(found) == {"a.hapf": "damaged", "b.hapf": "intact", "c.hapf": "intact"}
        (tmp_path / "in" / "b.hapf").write_text("junk")
        found = report("verify", "in", cwd=tmp_path, code=3)
        assert found["results"] == {"damaged": 1, "nonconforming": 1, "intact": 1}
        (tmp_path / "in" / "c.hapf").unlink()
        (tmp_path / "in" / "c.hapf").symlink_to("c.hapf")
        report("verify", "in", cwd=tmp_path, code=1)

    def test_worst_of_all_codes(self):
        def code(*codes: int) -> int:
            return runs.RunSummary([jobs.FileOutcome("", "", each) for each in codes]).exit_code

        assert [code(), code(0), code(4, 0), code(3, 4), code(4, 2, 3), code(2, 1)] == [
            0, 0, 4, 3, 3, 1,
        ]  # fmt: skip

    def test_nothing_found_is_not_intact(self, tmp_path: Path):
        """As a disk that is not mounted."""
        (tmp_path / "empty").mkdir()
        write_hapf(tmp_path / "in" / "a.hapf")
        for words in (["empty"], ["in", "empty"]):
            found = report("verify", *words, cwd=tmp_path, code=1)
            bad = [each for each in found["files"] if each["exit_code"]]
            assert [each["file"] for each in bad] == ["empty"]
            assert "no .hapf file and no bag was found here" in bad[0]["message"]

    def test_names_begin_with_their_source_where_there_are_several(self, tmp_path: Path):
        write_hapf(tmp_path / "one" / "a.hapf")
        write_hapf(tmp_path / "two" / "a.hapf")
        write_hapf(tmp_path / "b.hapf")
        found = report("verify", "one", "tw*", "b.hapf", cwd=tmp_path)
        assert sorted(results(found)) == ["b.hapf", "one/a.hapf", "two/a.hapf"]

    def test_a_large_file_is_not_read_into_memory(self, tmp_path: Path, monkeypatch):
        monkeypatch.setattr(jobs, "WHOLE", 10)
        path = tmp_path / "a.hapf"
        write_hapf(path)
        place = places.place_of(path, "a.hapf")
        assert jobs.content(place) == str(path)
        import hashlib

        good = hashlib.sha256(path.read_bytes()).hexdigest()
        for expected, code in ((good.upper(), 0), ("00", 3)):
            job = jobs.Job("verify", place, options={"expected": {"sha256": expected}})
            assert work.run_job(job).exit_code == code

    def test_an_interrupted_check_goes_on(self, tmp_path: Path):
        for name in ("a", "b"):
            write_hapf(tmp_path / "in" / f"{name}.hapf", size=3000)
        damage(tmp_path / "in" / "a.hapf")
        checks = [
            jobs.Job("verify", place)
            for place in places.find_places([str(tmp_path / "in")], places.is_hapf)
        ]
        with runs.Log(tmp_path / "log", runs.VERIFIED) as log:
            runs.run(checks[:1], log=log)
        os.utime(tmp_path / "in" / "b.hapf")
        found = report("verify", str(tmp_path / "in"), "--log", "log", cwd=tmp_path, code=3)
        assert results(found) == {"a.hapf": "damaged", "b.hapf": "intact"}
        assert not (tmp_path / "log").exists()  # the next check begins again


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Three files, one of them damaged, one in a folder; and their catalogue."""
    pytest.importorskip("polars")
    room = tmp_path_factory.mktemp("held")
    write_hapf(room / "in" / "a.hapf", 1, 3000)
    write_hapf(room / "in" / "sub dir" / "line\nbreak.hapf", 2)
    channel = hapfmt.Channel(
        np.array([3, -4, 12], np.int32), rate="44100/7", label="", unit="mm",
        coverage=(hapfmt.Span(10, 12), hapfmt.Span(20, 21)), quantity="displacement",
        calibration=hapfmt.Calibration(1, 0, 2),
    )  # fmt: skip
    recording = hapfmt.Recording((channel,), epoch_ns=1_700_000_000_123_456_789)
    hapfmt.write(recording, room / "in" / "gap.hapf")
    report("catalogue", "in", cwd=room)
    yield room


class TestCatalogue:
    def test_a_row_for_each_channel(self, held: Path):
        import hashlib

        import polars

        rows = polars.read_parquet(held / "in" / "catalogue.parquet").to_dicts()
        assert [(row["file"], row["channel"], row["label"]) for row in rows] == [
            ("a.hapf", 0, "fx"), ("a.hapf", 1, "fy"), ("gap.hapf", 0, None),
            ("sub dir/line\nbreak.hapf", 0, "fx"), ("sub dir/line\nbreak.hapf", 1, "fy"),
        ]  # fmt: skip
        x, y = signal_of(1, 3000)
        for row, values, unit in zip(rows[:2], (x, y), ("N", "mm"), strict=True):
            assert (row["min"], row["max"], row["unit"]) == (values.min(), values.max(), unit)
            assert row["rms"] == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-12)
            assert (row["rate"], row["start"], row["duration"]) == (1000, 0, 3)
            assert (row["samples"], row["missing"], row["verdict"]) == (3000, 0, "intact")
        gap = rows[2]
        assert (gap["samples"], gap["missing"], gap["quantity"]) == (3, 8, "displacement")
        assert (gap["min"], gap["max"], gap["rms"]) == (-2, 6, np.sqrt((1.5**2 + 4 + 36) / 3))
        assert (gap["start"], gap["duration"]) == (10 / 6300, 11 / 6300)
        assert (gap["rate_exact"], gap["rate"]) == ("6300", 6300)
        assert gap["recorded"].isoformat() == "2023-11-14T22:13:20.123456+00:00"
        data = (held / "in" / "gap.hapf").read_bytes()
        assert (gap["checksum"], gap["file_size"]) == (hashlib.sha256(data).hexdigest(), len(data))

    @pytest.mark.deep
    def test_duckdb_and_pandas_read_it(self, held: Path):
        path = held / "in" / "catalogue.parquet"
        pandas = pytest.importorskip("pandas")
        frame = pandas.read_parquet(path)
        assert frame["samples"].tolist() == [3000, 3000, 3, 300, 300]
        duckdb = pytest.importorskip("duckdb")
        found = duckdb.sql(
            f"select label, count(*), max(rms) from '{path}' group by label order by label"
        ).fetchall()
        assert [row[:2] for row in found] == [("fx", 2), ("fy", 2), (None, 1)]

    def test_only_new_and_changed_files_are_read(self, held: Path, tmp_path: Path):
        shutil.copytree(held / "in", tmp_path / "in")
        write_hapf(tmp_path / "in" / "new.hapf", 7)
        damage(tmp_path / "in" / "a.hapf")
        (tmp_path / "in" / "gap.hapf").unlink()
        found = report("catalogue", "in", cwd=tmp_path, code=3)
        assert results(found) == {
            "a.hapf": "damaged", "new.hapf": "intact", "sub dir/line\nbreak.hapf": "unchanged",
        }  # fmt: skip
        found = report("catalogue", "in", cwd=tmp_path, code=3)  # the damage is not forgotten
        assert found["results"] == {"unchanged": 3}
        found = report("find", "in", "--where", "verdict <> 'intact'", cwd=tmp_path)
        rows = found["rows"]
        assert [row["file"] for row in rows] == ["a.hapf"] * 2
        assert any(row["samples"] < 3000 for row in rows)
        assert all(row["error"] for row in rows)
        assert visible(tmp_path / "in") == {
            "a.hapf", "new.hapf", "sub dir/line\nbreak.hapf", "catalogue.parquet",
        }  # fmt: skip

    @pytest.mark.deep
    def test_what_cannot_be_read_has_a_row(self, tmp_path: Path):
        pytest.importorskip("polars")
        (tmp_path / "in").mkdir()
        (tmp_path / "in" / "junk.hapf").write_text("junk")
        name = os.fsdecode(b"\xff\xfe.hapf")
        write_hapf(tmp_path / "in" / name)
        report("catalogue", "in", "-o", "c.parquet", cwd=tmp_path, code=2)
        rows = report("find", "c.parquet", cwd=tmp_path)["rows"]
        assert [row["file"] for row in rows] == ["in/junk.hapf"] + ["in/\\udcff\\udcfe.hapf"] * 2
        assert (rows[0]["channel"], rows[0]["verdict"]) == (None, "nonconforming")

    @pytest.mark.deep
    def test_an_interrupted_catalogue_goes_on(self, held: Path, tmp_path: Path):
        found = places.find_places([str(held / "in")], places.is_hapf)
        todo = catalogue.catalogue_jobs(found, tmp_path / "c.parquet", Limits())
        with runs.Log(tmp_path / runs.FOLDER / "c.parquet.jsonl", runs.CATALOGUED) as log:
            runs.run(todo[:2], log=log)
        report("catalogue", held / "in", "-o", "c.parquet", cwd=tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == ["c.parquet"]
        ours = report("find", "c.parquet", cwd=tmp_path)["rows"]
        theirs = report("find", "in", cwd=held)["rows"]
        strip = ("file",)
        assert [{k: v for k, v in row.items() if k not in strip} for row in ours] == [
            {k: v for k, v in row.items() if k not in strip} for row in theirs
        ]

    def test_files_that_are_gone_are_counted(self, held: Path, tmp_path: Path):
        shutil.copytree(held / "in", tmp_path / "in")
        (tmp_path / "in" / "a.hapf").unlink()
        done = commands.run("archive", "catalogue", "in", cwd=tmp_path)
        assert b"2 rows of 1 file removed" in done.stderr
        shutil.rmtree(tmp_path / "in" / "sub dir")
        (tmp_path / "in" / "gap.hapf").unlink()
        done = commands.run("archive", "catalogue", "in", cwd=tmp_path)
        assert b"3 rows of 2 files removed" in done.stderr
        assert report("find", "in", cwd=tmp_path)["rows"] == []

    @pytest.mark.deep
    def test_it_replaces_nothing_else(self, held: Path, tmp_path: Path):
        (tmp_path / "c.parquet").write_text("mine")
        for words in (["-o", "c.parquet"], ["-o", "c.csv"], ["-o", "no/c.parquet"]):
            done = commands.run("archive", "catalogue", held / "in", *words, cwd=tmp_path)
            assert done.returncode == 1, words
        assert (tmp_path / "c.parquet").read_text() == "mine"

    def test_a_source_that_is_gone_leaves_the_catalogue(self, held: Path, tmp_path: Path):
        """As a disk that is not mounted."""
        before = (held / "in" / "catalogue.parquet").read_bytes()
        (tmp_path / "c.parquet").write_bytes(before)
        report("catalogue", "gone", "-o", "c.parquet", cwd=tmp_path, code=1)
        assert (tmp_path / "c.parquet").read_bytes() == before


class TestFind:
    @pytest.mark.parametrize(
        ("where", "count"),
        [
            ("unit = 'N' and rms > 1.9", 2),
            ("label like 'f%' and duration between 1 and 5", 2),
            ("missing > 0 or \"group\" <> ''", 1),
            ("recorded >= date('2023-11-14')", 1),
            ("channel is null", 0),
            ("lower(verdict) in ('intact', 'damaged')", 5),
            ("quantity = 'force' and unit = 'N'", 2),  # by the unit
            ("label is null and device is null", 1),
            ("modified > date '2020-01-01'", 5),
        ],
    )
    def test_an_expression(self, held: Path, where: str, count: int):
        assert catalogue.find(catalogue.read(held / "in"), where).height == count

    @pytest.mark.parametrize(
        ("where", "message"),
        [
            ("rmss > 2", "no column 'rmss'; did you mean 'rms'?"),
            ("rms >", "--where 'rms >'"),
            ("rms", "Boolean"),
            ("rms > 'a'", "compare"),
            ("recorded > '2026-01-01'", "date '2026-01-31'"),
            ('unit = "N"', "text is in single quotes: 'N'"),
            ("verdict <> intact", "text is in single quotes: 'intact'"),
            ("max(rms) > 1", "one channel at a time"),
            ("rms > AVG (rms)", "one channel at a time"),
            ("", "--where"),
            ("rms > 1; drop table x", "--where"),
            ("file in (select * from read_csv('/etc/passwd'))", "--where"),
            ("read_csv('/etc/passwd')", "--where"),
            ("__import__('os').system('touch /tmp/x')", "--where"),
        ],
    )
    def test_what_is_no_expression(self, held: Path, where: str, message: str):
        with pytest.raises(ParameterError) as caught:
            catalogue.find(catalogue.read(held / "in"), where)
        assert message in caught.value.line()

    @pytest.mark.parametrize("columns", [80, 120])
    def test_the_table_fits(self, held: Path, columns: int):
        done = commands.run_in_terminal("archive", "find", "in", cwd=held, columns=columns)
        lines = done.stdout.decode().replace("\r", "").splitlines()
        assert max(map(len, lines)) <= columns
        assert lines[0].startswith("label")
        assert "rms" in lines[0]
        assert "5 channels in 3 files" in lines

    def test_names_of_files_alone(self, held: Path):
        found = archive("find", "in", "--files", "--where", "unit = 'mm'", cwd=held)
        assert found.splitlines() == [
            "a.hapf",
            "gap.hapf",
            "sub dir/line\N{REPLACEMENT CHARACTER}break.hapf",
        ]

    def test_names_that_end_with_a_null_byte(self, held: Path):
        found = archive("find", "in", "--files", "-0", "--where", "unit = 'mm'", cwd=held)
        assert found.split("\0") == ["a.hapf", "gap.hapf", "sub dir/line\nbreak.hapf", ""]

    def test_a_file_that_cannot_be_read_is_no_channel(self, tmp_path: Path):
        pytest.importorskip("polars")
        (tmp_path / "junk.hapf").write_text("junk")
        report("catalogue", ".", cwd=tmp_path, code=2)
        found = archive("find", ".", cwd=tmp_path)
        assert "0 channels in 1 file, 1 of them without a readable channel" in found

    def test_what_is_no_catalogue(self, tmp_path: Path):
        polars = pytest.importorskip("polars")

        polars.DataFrame({"x": [1]}).write_parquet(tmp_path / "x.parquet")
        done = commands.run("archive", "find", "x.parquet", cwd=tmp_path)
        assert done.returncode == 1
        assert done.stderr.startswith(b"hapfmt: x.parquet: not a catalogue")
        (tmp_path / "junk.parquet").write_text("junk")
        for name, message in (
            ("x.parquet", "the column 'file' is missing"),
            ("junk.parquet", "not a Parquet file"),
            (".", "holds no catalogue.parquet"),
            ("none.parquet", "No such file"),
        ):
            with pytest.raises((ParameterError, OSError)) as caught:
                catalogue.read(tmp_path / name)
            assert message in str(caught.value)


@pytest.fixture(scope="module")
def bagged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for package in ("polars", "bagit", "rocrate"):
        pytest.importorskip(package)
    room = tmp_path_factory.mktemp("bagged")
    for seed, name in enumerate(BAGGED):
        write_hapf(room / "deposit" / f"sub {seed % 2}" / f"{name}.hapf", seed, 600)
    (room / "deposit" / "read me.txt").write_text("made by hand")
    found = report(
        "bag", "deposit", "--title", "Grasps", "--author", "A. Author", "--author", "B. Author",
        "--license", "https://creativecommons.org/licenses/by/4.0/", "--info",
        "Source-Organization=Lab", cwd=room,
    )  # fmt: skip
    assert found["file_count"] == len(BAGGED)
    assert found["payload_count"] == len(BAGGED) + 3
    return room


@pytest.fixture
def deposit(bagged: Path, tmp_path: Path) -> Path:
    shutil.copytree(bagged / "deposit", tmp_path / "deposit")
    return tmp_path


class TestBag:
    def test_bagit_accepts_it(self, bagged: Path):
        done = subprocess.run(
            [sys.executable, "-m", "bagit", "--validate", "deposit"], cwd=bagged,
            capture_output=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        head = (bagged / "deposit" / "bagit.txt").read_text()
        assert head == "BagIt-Version: 1.0\nTag-File-Character-Encoding: UTF-8\n"
        info = (bagged / "deposit" / "bag-info.txt").read_text("utf-8")
        assert "Source-Organization: Lab\n" in info
        assert "Contact-Name: B. Author\n" in info
        assert "Title: Grasps\n" in info

    @pytest.mark.deep
    def test_another_implementation_accepts_it(self, bagged: Path):
        bagit_utils = pytest.importorskip("bagit_utils", reason="bagit-utils is not installed")
        report = bagit_utils.Bag(bagged / "deposit").validate()
        assert report.valid and not report.issues

    def test_by_the_letter_of_the_rfc(self, bagged: Path):
        """Without any library: RFC 8493, sections 2.1.3 and 2.2.1."""
        import hashlib

        root = bagged / "deposit"
        for name in ("manifest-sha256.txt", "tagmanifest-sha256.txt"):
            listed = {}
            for line in (root / name).read_text("utf-8").removesuffix("\n").split("\n"):
                value, path = line.split(maxsplit=1)
                path = path.replace("%0A", "\n").replace("%0D", "\r").replace("%25", "%")
                listed[path] = value
                data = (root / path).read_bytes()
                assert hashlib.sha256(data).hexdigest() == value
            if name.startswith("manifest"):
                found = {p for p in (root / "data").rglob("*") if p.is_file()}
                assert {root / path for path in listed} == found
            else:
                assert set(listed) == {"bagit.txt", "bag-info.txt", "manifest-sha256.txt"}
        sizes = [path.stat().st_size for path in (root / "data").rglob("*") if path.is_file()]
        info = (root / "bag-info.txt").read_text("utf-8")
        assert f"Payload-Oxum: {sum(sizes)}.{len(sizes)}\n" in info

    def test_its_crate_names_files_channels_and_people(self, bagged: Path):
        from rocrate.rocrate import ROCrate

        data = bagged / "deposit" / "data"
        crate = ROCrate(data)
        assert (crate.name, crate.root_dataset["author"][1]["name"]) == ("Grasps", "B. Author")
        assert len(crate.root_dataset["hasPart"]) == len(BAGGED) + 2
        for seed, name in enumerate(BAGGED):
            (file,) = [
                e for e in crate.data_entities if e.get("name") == f"sub {seed % 2}/{name}.hapf"
            ]
            assert file["sha256"] and file["encodingFormat"] == "haptics/vnd.hapf"
            x, y = file["variableMeasured"]
            assert (x["name"], x["unitText"], y["name"], y["unitText"]) == ("fx", "N", "fy", "mm")
        everything = np.concatenate([signal_of(seed, 600)[0] for seed in range(len(BAGGED))])
        assert (x["minValue"], x["maxValue"]) == (everything.min(), everything.max())

    def test_a_good_bag_is_quiet_and_nothing_in_it_changes(self, bagged: Path):
        assert archive("verify", "deposit", cwd=bagged) == ""
        found = report("verify", "deposit", cwd=bagged)
        assert found["results"] == {"intact": len(BAGGED) + 6}
        for words in (["bag", "deposit"], ["catalogue", "deposit"]):
            done = commands.run("archive", *words, cwd=bagged)
            assert done.returncode == 1
            assert b"bag" in done.stderr
        rows = report("find", "deposit", cwd=bagged)["rows"]
        assert len(rows) == 2 * len(BAGGED)
        assert (bagged / "deposit" / "data" / rows[0]["file"]).is_file()

    def test_rot_missing_and_unknown_files(self, deposit: Path):
        data = deposit / "deposit" / "data"
        damage(data / "sub 0" / "plain.hapf")
        damage(data / "read me.txt")
        (data / "sub 1" / "-dash.hapf").unlink()
        (data / "sub 1" / "new.hapf").write_bytes((data / "sub 1" / "日本.hapf").read_bytes())
        # A whole file, but another one.
        other = data / "sub 1" / "with space.hapf"
        other.write_bytes((data / "sub 1" / "日本.hapf").read_bytes())
        found = report("verify", "deposit", cwd=deposit, code=3)
        bad = {each["file"]: each["result"] for each in found["files"] if each["exit_code"]}
        expected = {
            "data/sub 0/plain.hapf": "damaged", "data/read me.txt": "damaged",
            "data/sub 1/-dash.hapf": "missing", "data/sub 1/new.hapf": "unknown",
            "data/sub 1/with space.hapf": "damaged",
        }  # fmt: skip
        assert bad == expected
        text = archive("verify", "deposit", cwd=deposit, code=3)
        assert all(name in text for name in expected)

    def test_damage_of_the_bag_itself(self, deposit: Path):
        root = deposit / "deposit"
        (root / "bag-info.txt").write_text("Payload-Oxum: 1.1\n")
        found = report("verify", "deposit", cwd=deposit, code=3)
        assert [e["file"] for e in found["files"] if e["exit_code"]] == ["bag-info.txt"]
        manifest = root / "manifest-sha256.txt"
        manifest.write_text("00 ../../etc/passwd\n")
        report("verify", "deposit", cwd=deposit, code=2)
        manifest.write_bytes(b"\xff\xfe\x00")
        report("verify", "deposit", cwd=deposit, code=2)
        manifest.unlink()
        report("verify", "deposit", cwd=deposit, code=2)
        shutil.rmtree(root / "data")
        report("verify", "deposit", cwd=deposit, code=2)

    def test_a_folder_with_damage_is_not_bagged(self, tmp_path: Path):
        pytest.importorskip("rocrate")
        write_hapf(tmp_path / "in" / "a.hapf", size=3000)
        damage(tmp_path / "in" / "a.hapf")
        found = report("bag", "in", cwd=tmp_path, code=3)
        assert results(found) == {"a.hapf": "damaged"}
        assert visible(tmp_path / "in") == {"a.hapf"}
        report("bag", "in", "--force", cwd=tmp_path)
        report("verify", "in", cwd=tmp_path, code=3)

    def test_what_a_bag_cannot_hold(self, tmp_path: Path):
        pytest.importorskip("rocrate")
        folder = tmp_path / "in"
        write_hapf(folder / "a.hapf")
        (folder / "link.hapf").symlink_to("/etc/passwd")
        (folder / "loop").symlink_to(".")
        (folder / "50%0A.txt").write_text("")
        (folder / "line\nbreak.txt").write_text("")
        (folder / os.fsdecode(b"\xff.txt")).write_text("")
        os.mkfifo(folder / "pipe")
        found = report("bag", "in", cwd=tmp_path, code=1)
        assert len(found["files"]) == 6
        assert (folder / "a.hapf").exists()
        (folder / "bagless").mkdir()
        for words in (["--info", "x"], ["--info", "a:b=c"], ["--title", "a\nb"]):
            done = commands.run("archive", "bag", "in", *words, cwd=tmp_path)
            assert done.returncode == 1

    def test_the_crate_of_somebody_else_stays(self, tmp_path: Path):
        pytest.importorskip("rocrate")
        write_hapf(tmp_path / "in" / "a.hapf")
        (tmp_path / "in" / "ro-crate-metadata.json").write_text("{}")
        done = commands.run("archive", "bag", "in", cwd=tmp_path)
        assert done.returncode == 1
        assert b"did not write it" in done.stderr
        assert visible(tmp_path / "in") == {"a.hapf", "ro-crate-metadata.json"}

    @pytest.mark.parametrize("moment", range(1, 11))
    def test_an_interrupted_bag_is_made_again(self, tmp_path: Path, monkeypatch, moment: int):
        """A full disk and a crash at each step: three tag files, and the moves after them."""
        pytest.importorskip("rocrate")
        write_hapf(tmp_path / "in" / "a.hapf")
        write_hapf(tmp_path / "in" / "data" / "b.hapf")
        root = tmp_path / "in"
        report("catalogue", "in", cwd=tmp_path)
        count = 0

        def fail(original: Any) -> Any:
            def step(*words: Any) -> Any:
                nonlocal count
                count += 1
                if count == moment:
                    raise OSError(28, "No space left on device")
                return original(*words)

            return step

        undo = bags.unpack_unfinished
        with monkeypatch.context() as patch:
            patch.setattr(bags, "write_whole", fail(bags.write_whole))
            patch.setattr(Path, "rename", fail(Path.rename))
            patch.setattr(bags, "unpack_unfinished", lambda _root: None)
            with pytest.raises(OSError, match="No space left"):
                bags.write_bag(root, bags.DepositFacts(), 1)
        assert not (root / "bagit.txt").exists()
        found = report("verify", "in", cwd=tmp_path, code=2)
        assert "run hapfmt archive bag again" in found["files"][0]["message"]
        undo(root)
        assert visible(root) == {"a.hapf", "data/b.hapf", "catalogue.parquet"}
        report("bag", "in", cwd=tmp_path)
        report("verify", "in", cwd=tmp_path)
        assert visible(root) >= {"data/a.hapf", "data/data/b.hapf"}

    def test_a_full_disk_leaves_the_folder_as_it_was(self, tmp_path: Path, monkeypatch):
        write_hapf(tmp_path / "in" / "a.hapf")

        def full(path: Path, _text: str) -> None:
            path.touch()
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(bags, "write_whole", full)
        with pytest.raises(OSError, match="No space left"):
            bags.write_bag(tmp_path / "in", bags.DepositFacts(), 1)
        assert visible(tmp_path / "in") == {"a.hapf"}

    def test_nothing_is_written_into_a_bag(self, deposit: Path):
        write_npz(deposit / "new" / "n.npz")
        write_hapf(deposit / "new" / "n.hapf")
        root = deposit / "deposit"
        before = visible(root)
        words = ["--output-format", "csv"]
        for target in ("deposit", "deposit/data", "deposit/data/deeper/still"):
            for verb, more in (("encode", []), ("convert", words), ("recover", [])):
                done = commands.run("archive", verb, "new", target, *more, cwd=deposit)
                assert done.returncode == 1
                assert b"is a bag, and a new file would make it invalid" in done.stderr
        for words in (["bag", "deposit/data"], ["bag", "deposit/data/sub 0"]):
            done = commands.run("archive", *words, cwd=deposit)
            assert done.returncode == 1
            assert b"lies within the bag" in done.stderr
        words = ["catalogue", "new", "-o", "deposit/data/c.parquet"]
        assert commands.run("archive", *words, cwd=deposit).returncode == 1
        assert visible(root) == before
        (root / "bagit.txt").unlink()
        assert commands.run("archive", "bag", "deposit", cwd=deposit).returncode == 1
        assert visible(root) == before - {"bagit.txt"}

    def test_a_broken_bag_is_not_silent(self, deposit: Path):
        write_hapf(deposit / "deposit" / "stray.hapf")
        (deposit / "deposit" / "stray.txt").write_text("")
        (deposit / "deposit" / "data" / "up").symlink_to("..")
        found = report("verify", "deposit", cwd=deposit, code=2)
        unknown = {each["file"] for each in found["files"] if each["result"] == "unknown"}
        assert unknown == {"stray.hapf", "stray.txt", "data/up"}
        (deposit / "deposit" / "bagit.txt").unlink()
        found = report("verify", "deposit", cwd=deposit, code=2)
        assert "bagit.txt is missing" in found["files"][0]["message"]

    @pytest.mark.parametrize("source", [".", "*", "shelf", "sh*"])
    def test_bags_below_a_source_are_checked_as_bags(self, deposit: Path, source: str):
        (deposit / "shelf").mkdir()
        (deposit / "deposit").rename(deposit / "shelf" / "deposit")
        write_hapf(deposit / "shelf" / "a.hapf")
        assert report("verify", source, cwd=deposit)["results"] == {"intact": len(BAGGED) + 7}
        (deposit / "shelf" / "deposit" / "data" / "read me.txt").unlink()
        found = report("verify", source, cwd=deposit, code=3)
        missing = [each["file"] for each in found["files"] if each["result"] == "missing"]
        assert [Path(name).as_posix() for name in missing] == ["shelf/deposit/data/read me.txt"]

    def test_a_part_of_a_bag_gets_a_note(self, deposit: Path):
        done = commands.run("archive", "verify", "deposit/data", cwd=deposit)
        assert done.returncode == 0
        assert b"hapfmt archive verify" in done.stderr

    def test_a_link_in_a_bag_is_the_problem_of_one_file(self, deposit: Path):
        data = deposit / "deposit" / "data"
        (deposit / "outside.hapf").write_bytes((data / "sub 0" / "plain.hapf").read_bytes())
        (data / "sub 0" / "plain.hapf").unlink()
        (data / "sub 0" / "plain.hapf").symlink_to(deposit / "outside.hapf")
        found = report("verify", "deposit", cwd=deposit, code=3)
        bad = {each["file"]: each["message"] for each in found["files"] if each["exit_code"]}
        assert bad == {"data/sub 0/plain.hapf": "a link is in the place of this file"}
        assert len(found["files"]) == len(BAGGED) + 6

    def test_what_is_odd_in_a_folder_is_said(self, tmp_path: Path):
        pytest.importorskip("rocrate")
        (tmp_path / "in" / ".git").mkdir(parents=True)
        (tmp_path / "in" / ".git" / "config").write_text("")
        done = commands.run("archive", "bag", "in", cwd=tmp_path)
        assert done.returncode == 1
        assert b"holds no .hapf file" in done.stderr
        write_npz(tmp_path / "raw" / "b.npz")
        (job,) = encode_jobs(tmp_path / "raw", tmp_path / "in")
        with runs.Log(tmp_path / "in" / runs.FOLDER / runs.LOG) as log:
            log.write(job)
        write_hapf(tmp_path / "in" / "a.hapf")
        done = commands.run("archive", "bag", "in", cwd=tmp_path)
        assert done.returncode == 0
        assert b"1 hidden file, such as .git/config" in done.stderr
        assert b"1 output of an earlier command" in done.stderr


class TestRemote:
    def test_web_servers(self, tmp_path: Path):
        pytest.importorskip("aiohttp")
        pytest.importorskip("polars")
        write_hapf(tmp_path / "a.hapf", 1, 3000)
        good = (tmp_path / "a.hapf").read_bytes()
        bad = bytearray(good)
        bad[len(bad) // 2] ^= 1
        write_npz(tmp_path / "b.npz", 2)
        files = {
            "x/a.hapf": good,
            "x/bad.hapf": bytes(bad),
            "x/b.npz": (tmp_path / "b.npz").read_bytes(),
        }
        with serving(files) as server:
            urls = [server.url(f"x/{name}") for name in ("a.hapf", "bad.hapf", "none.hapf")]
            found = report("verify", *urls, cwd=tmp_path, code=1)
            assert [each["result"] for each in found["files"]] == ["intact", "damaged", "failed"]
            found = report("encode", server.url("x/b.npz"), "out", cwd=tmp_path)
            back = hapfmt.read(tmp_path / "out" / "b.hapf")
            assert np.array_equal(back.to_numpy(), signal_of(2))
            report("catalogue", urls[0], "-o", "c.parquet", cwd=tmp_path)
            rows = report("find", "c.parquet", cwd=tmp_path)["rows"]
            assert [row["file"] for row in rows] == [urls[0]] * 2

    @pytest.mark.deep
    def test_a_password_is_not_shown(self, tmp_path: Path):
        pytest.importorskip("aiohttp")
        with serving({}) as server:
            url = server.url("a.hapf").replace("http://", "http://me:secret@")
            done = commands.run("archive", "verify", url, cwd=tmp_path)
        assert done.returncode == 1
        assert b"secret" not in done.stdout + done.stderr

    def test_file_urls(self, tmp_path: Path):
        write_npz(tmp_path / "with space" / "a.npz")
        source, target = (tmp_path / "with space").as_uri(), (tmp_path / "out").as_uri()
        report("encode", source, target, cwd=tmp_path)
        assert visible(tmp_path / "out") == {"a.hapf"}

    def test_object_storage(self, tmp_path: Path):
        """The file system ``memory`` of fsspec, as s3 is: an object appears whole."""
        fsspec = pytest.importorskip("fsspec")
        write_npz(tmp_path / "in" / "s" / "a.npz", 5)
        place = places.find_places([str(tmp_path / "in")], places.is_foreign)
        (target,), _ = runs.targets_of(place, "memory://bucket/archive", ".hapf")
        options = {"preset": "lossless", "given": {}, "reading": {}}
        job = jobs.Job("encode", place[0], target, options=options)
        files = fsspec.filesystem("memory")
        try:
            with runs.Log(tmp_path / "log") as log:
                (done,) = runs.run([job], log=log, skip=runs.skip_written)
                assert (done.result, done.message) == ("encoded", "")
                (done,) = runs.run([job], log=log, skip=runs.skip_written)
                assert (done.result, done.message) == ("skipped", "")
            assert files.find("/bucket") == ["/bucket/archive/s/a.hapf"]
            again = work.run_job(job)
            assert "already exists" in again.message
            found = places.find_places(["memory://bucket/**/*.hapf"], places.is_hapf)
            assert [(p.name, p.size > 0) for p in found] == [("archive/s/a.hapf", True)]
            assert (
                places.find_places(["memory://bucket/archive"], places.is_hapf)[0].name
                == "s/a.hapf"
            )
        finally:
            files.rm("/bucket", recursive=True)

    def test_a_remote_target_needs_a_log(self, tmp_path: Path):
        write_npz(tmp_path / "in" / "a.npz")
        done = commands.run("archive", "encode", "in", "s3://bucket/x", cwd=tmp_path)
        assert done.returncode == 1
        assert b"--log" in done.stderr


@pytest.mark.parametrize("address", ["", "nonsense", "nonsense://x:1", "http://x:8786", "tcp://x"])
def test_what_is_no_address_of_a_scheduler(tmp_path: Path, address: str):
    write_hapf(tmp_path / "a.hapf")
    done = commands.run("archive", "verify", "a.hapf", "--dask", address, cwd=tmp_path)
    assert done.returncode == 1
    assert b"is not the address of a Dask scheduler" in done.stderr


def test_names_never_lead_out_of_the_target():
    odd = [Place("../../x.npz", "/a"), Place("/etc/x.npz", "/b")]
    found, _ = runs.targets_of(odd, "/out", ".hapf")
    assert found == ["/out/x.hapf", "/out/etc/x.hapf"]


def deadly() -> Limits:
    """Limits that end any worker which unpacks them."""

    class Deadly(Limits):
        def __setstate__(self, state: Any) -> None:
            import multiprocessing
            import os

            if multiprocessing.parent_process() is not None:  # not the scheduler
                os._exit(9)

        def __getstate__(self) -> Any:
            return {"deadly": True}

    return Deadly()


class Fatal(Limits):
    """Limits that end any process which unpacks them."""

    def __reduce__(self) -> Any:
        return os._exit, (9,)


class TestJobs:
    """Processes of this machine."""

    def test_the_same_files_as_in_one_process(self, tmp_path: Path):
        """Without Dask."""
        for seed in range(12):
            write_npz(tmp_path / "in" / f"{seed}.npz", seed, 3000)
        (tmp_path / "in" / "bad.npz").write_text("junk")
        here = report("encode", "in", "here", cwd=tmp_path, code=1)
        code = "import sys; sys.modules |= {'dask': None, 'distributed': None}\n"
        code += "if __name__ == '__main__': from hapfmt.cli import main; main()"
        words = ["archive", "encode", "in", "there", "--jobs", "2", "--json"]
        done = subprocess.run(
            [sys.executable, "-c", code, *words], cwd=tmp_path, capture_output=True, check=False
        )
        assert done.returncode == 1 and not done.stderr
        there = json.loads(done.stdout)
        assert results(here) == results(there)
        assert visible(tmp_path / "here") == visible(tmp_path / "there")
        for path in (tmp_path / "here").glob("*.hapf"):
            other = hapfmt.read(tmp_path / "there" / path.name)
            assert np.array_equal(hapfmt.read(path).to_numpy(), other.to_numpy())

    def test_a_file_that_kills_its_worker_is_the_only_one_that_fails(self, tmp_path: Path):
        for seed in range(20):
            write_hapf(tmp_path / "in" / f"{seed:02}.hapf", seed)
        found = places.find_places([str(tmp_path / "in")], places.is_hapf)
        todo = [jobs.Job("verify", place) for place in found]
        for number in (7, 12):
            todo[number] = jobs.Job("verify", todo[number].place, limits=Fatal())
        outcomes = runs.run(todo, workers=2)
        bad = [n for n, each in enumerate(outcomes) if each.exit_code]
        assert bad == [7, 12] and len(outcomes) == 20
        assert "died" in outcomes[7].message

    @pytest.mark.deep
    def test_interrupted_while_they_start(self, tmp_path: Path):
        for seed in range(30):
            write_npz(tmp_path / "in" / f"{seed}.npz", seed, 20_000)
        process = subprocess.Popen(
            [sys.executable, "-m", "hapfmt", "archive", "encode", "in", "out", "--jobs", "1"],
            cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
        psutil = pytest.importorskip("psutil")
        while process.poll() is None:  # until a process is on its way
            if psutil.Process(process.pid).children():
                break
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
        assert process.returncode == 1, err
        assert b"interrupted" in err
        assert b"Traceback" not in err

    @pytest.mark.deep
    def test_a_worker_that_is_killed_costs_time_alone(self, tmp_path: Path):
        psutil = pytest.importorskip("psutil")
        for seed in range(40):
            write_npz(tmp_path / "in" / f"{seed}.npz", seed, 10_000)
        process = subprocess.Popen(
            [sys.executable, "-m", "hapfmt", "archive", "encode", "in", "out", "--jobs", "2", "--json"],
            cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        while not list((tmp_path / "out").glob("*.hapf")) and process.poll() is None:
            time.sleep(0.01)
        workers = [
            child
            for child in psutil.Process(process.pid).children(recursive=True)
            if "spawn_main" in " ".join(child.cmdline())
        ]
        assert len(workers) == 2
        workers[0].kill()
        out, _ = process.communicate(timeout=120)
        found = json.loads(out)
        assert (found["results"], found["exit_code"]) == ({"encoded": 40}, 0), out
        assert visible(tmp_path / "out") == {f"{seed}.hapf" for seed in range(40)}


@pytest.mark.deep
class TestDask:
    """A cluster."""

    def test_a_scheduler_that_runs_already(self, tmp_path: Path):
        distributed = pytest.importorskip("distributed")
        for seed in range(4):
            write_hapf(tmp_path / "in" / f"{seed}.hapf", seed, 3000)
        damage(tmp_path / "in" / "2.hapf")
        with distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=1,
            processes=False,
            dashboard_address=":0",
            protocol="tcp://",
        ) as cluster:
            words = ("verify", "in", "--dask", cluster.scheduler_address)
            found = report(*words, cwd=tmp_path, code=3)
        assert results(found)["2.hapf"] == "damaged"

    def test_no_scheduler_there(self, tmp_path: Path):
        pytest.importorskip("distributed")
        write_hapf(tmp_path / "in" / "a.hapf")
        done = commands.run("archive", "verify", "in", "--dask", "tcp://127.0.0.1:1", cwd=tmp_path)
        assert done.returncode == 1
        assert b"no Dask scheduler answers" in done.stderr

    def test_a_scheduler_without_workers(self, tmp_path: Path, monkeypatch):
        distributed = pytest.importorskip("distributed")
        monkeypatch.setattr(runs, "WORKER_SECONDS", 0.2)
        write_hapf(tmp_path / "a.hapf")
        work = [jobs.Job("verify", places.place_of(tmp_path / "a.hapf", "a.hapf"))]
        heard: list[str] = []
        with (
            distributed.LocalCluster(
                n_workers=0, processes=False, dashboard_address=":0", protocol="tcp://"
            ) as cluster,
            pytest.raises(ParameterError, match="has no workers; start one with: dask worker"),
        ):
            runs.run(work, address=cluster.scheduler_address, tell=heard.append)
        assert heard[0].startswith("waiting for workers of tcp://")

    def test_a_scheduler_that_goes_away(self, tmp_path: Path):
        distributed = pytest.importorskip("distributed")
        psutil = pytest.importorskip("psutil")
        del distributed
        for seed in range(30):
            write_npz(tmp_path / "in" / f"{seed}.npz", seed, 20_000)
        code = (
            "import distributed, time\n"
            "if __name__ == '__main__':\n"
            "    c = distributed.LocalCluster(n_workers=1, processes=False, protocol='tcp://',"
            " dashboard_address=':0')\n"
            "    print(c.scheduler_address, flush=True)\n"
            "    time.sleep(600)\n"
        )
        scheduler = subprocess.Popen(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        assert scheduler.stdout is not None
        with scheduler, scheduler.stdout:
            address = scheduler.stdout.readline().decode().strip()
            process = subprocess.Popen(
                [sys.executable, "-m", "hapfmt", "archive", "encode", "in", "out", "--dask", address],
                cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
            while not list((tmp_path / "out").glob("*.hapf")) and process.poll() is None:
                time.sleep(0.01)
            psutil.Process(scheduler.pid).kill()
            _, err = process.communicate(timeout=60)
        assert process.returncode == 1
        assert b"Traceback" not in err
        assert b"the connection to the Dask scheduler" in err
        found = report("encode", "in", "out", cwd=tmp_path)
        assert found["results"]["skipped"] > 0

    def test_a_file_that_kills_its_worker_is_the_only_one_that_fails(self, tmp_path: Path):
        distributed = pytest.importorskip("distributed")
        for seed in range(20):
            write_hapf(tmp_path / "in" / f"{seed:02}.hapf", seed)
        found = places.find_places([str(tmp_path / "in")], places.is_hapf)
        todo = [jobs.Job("verify", place) for place in found]
        todo[7] = jobs.Job("verify", todo[7].place, limits=deadly())
        # Under load Dask may give up a process that dies while it starts: another one is left.
        with distributed.LocalCluster(
            n_workers=3, threads_per_worker=1, dashboard_address=":0", silence_logs=50
        ) as cluster:
            outcomes = runs.run(todo, address=cluster.scheduler_address)
        assert [each.exit_code for each in outcomes] == [0] * 7 + [1] + [0] * 12
        assert "died" in outcomes[7].message


@pytest.mark.deep
class TestS3:
    """The server of moto, on this machine."""

    @pytest.fixture
    def bucket(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
        pytest.importorskip("s3fs")
        moto_server = pytest.importorskip("moto.server")
        server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
        server.start()
        host, port = server.get_host_and_port()
        given = {
            "AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1",
        }  # fmt: skip
        for name, value in given.items():
            monkeypatch.setenv(name, value)
        try:
            import s3fs

            files = s3fs.S3FileSystem(skip_instance_cache=True)
            files.mkdir("lab")
            yield files
            files.rm("lab", recursive=True)  # the server keeps it for the next test
        finally:
            server.stop()

    def s3(self, *words: str, cwd: Path, code: int = 0) -> dict[str, Any]:
        """A fresh process: s3fs keeps threads and connections."""
        done = subprocess.run(
            [sys.executable, "-m", "hapfmt", "archive", *words, "--json"], cwd=cwd,
            capture_output=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    def test_encode_check_and_catalogue(self, tmp_path: Path, bucket: Any):
        for seed, name in enumerate(["a", "b c", "gräße"]):
            write_npz(tmp_path / "in" / "day 1" / f"{name}.npz", seed)
        words = ("encode", "in", "s3://lab/touch", "--log", "log")
        assert self.s3(*words, cwd=tmp_path)["results"] == {"encoded": 3}
        assert self.s3(*words, cwd=tmp_path)["results"] == {"skipped": 3}
        names = {f"lab/touch/day 1/{name}.hapf" for name in ("a", "b c", "gräße")}
        assert set(bucket.find("lab/touch")) == names
        other = ("encode", "in", "s3://lab/touch", "--log", "other")
        assert self.s3(*other, cwd=tmp_path, code=1)["results"] == {"failed": 3}
        data = bytearray(bucket.cat_file("lab/touch/day 1/b c.hapf"))
        data[len(data) // 2] ^= 1
        bucket.pipe_file("lab/touch/day 1/b c.hapf", bytes(data))
        found = self.s3("verify", "s3://lab/touch", cwd=tmp_path, code=3)
        assert results(found) == {
            "day 1/a.hapf": "intact", "day 1/b c.hapf": "damaged", "day 1/gräße.hapf": "intact",
        }  # fmt: skip
        words = ("catalogue", "s3://lab/touch/**/*.hapf", "-o", "c.parquet")
        assert self.s3(*words, cwd=tmp_path, code=3)["results"] == {"intact": 2, "damaged": 1}
        assert self.s3(*words, cwd=tmp_path, code=3)["results"] == {"unchanged": 3}
        found = self.s3("recover", "s3://lab/touch", "mended", cwd=tmp_path, code=3)
        assert visible(tmp_path / "mended") == {"day 1/b c.hapf"}
        found = self.s3("encode", "s3://lab/none", "out", cwd=tmp_path, code=1)
        assert found["results"] == {"failed": 1}

    def test_workers_read_and_write_it(self, tmp_path: Path, bucket: Any):
        for seed in range(6):
            write_npz(tmp_path / "in" / f"{seed}.npz", seed)
        found = self.s3("encode", "in", "s3://lab/x", "--log", "log", "--jobs", "2", cwd=tmp_path)
        assert found["results"] == {"encoded": 6}
        assert self.s3("verify", "s3://lab/x", "--jobs", "2", cwd=tmp_path)["results"] == {
            "intact": 6
        }
        assert len(bucket.find("lab/x")) == 6
