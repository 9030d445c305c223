"""Live files: whole writes, locks, syncs, full and failing disks (SPEC clause 15)."""

from __future__ import annotations

import errno
import os
import random
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import forge as f
import pytest
from depth import either
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

import hapfmt
import hapfmt.format.track
from hapfmt import files as locks
from hapfmt.errors import HapfmtError, ParameterError
from hapfmt.format.cluster import Packet
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Track
from hapfmt.format.walk import walk
from hapfmt.writing.file import LiveFile, SyncPolicy, create_live, open_live
from hapfmt.writing.filewriter import FileWriter
from hapfmt.writing.start import open_append

resource = pytest.importorskip("resource")

TRACK = Track(0, "full", "KNOT", Fraction(1000), 0, (hapfmt.format.track.Component(),),
              b"\0\0\0\1\0", count_min=-100, count_max=100)  # fmt: skip
FIVE = f.KNOT_DATA
HEAD_END = 8 + f.HEADER + len(f.head())


def noise(size: int) -> str:
    """What DEFLATE makes nothing of."""
    return random.Random(1).randbytes(size // 2).hex()


def packets(number: int, size: int = 1) -> list[Packet]:
    """A cluster of ten packets, ``size`` knots each."""
    body = FIVE + b"\1\0" * (size - 1)
    return [Packet(0, 10_000 * number + 1000 * i, 1000, body) for i in range(10)]


def record(file: LiveFile, clusters: int, size: int = 1) -> FileWriter:
    writer = FileWriter(file, file_id=1)
    writer.describe([TRACK])
    for number in range(clusters):
        writer.cluster(packets(number, size))
    writer.close()
    return writer


def samples(path: Path) -> int:
    with hapfmt.Reader(path) as reader:
        return sum(
            piece.numbers.size for piece in reader.pieces(list(reader.catalogue.tracks.values()))
        )


def findings(path: Path) -> set[str]:
    with hapfmt.Reader(path) as reader:
        return {found.code for found in reader.findings}


def codes(report: hapfmt.reading.verifier.Report) -> set[str]:
    return {found["code"] for found in report.findings}


@contextmanager
def size_limit(size: int) -> Iterator[None]:
    """No file may grow beyond ``size`` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


class TestCreation:
    def test_the_file_stands_under_its_name_from_the_first_byte(self, tmp_path: Path):
        path = tmp_path / "a.hapf"
        with create_live(path) as file:
            assert path.exists()
            writer = FileWriter(file)
            assert path.stat().st_size == writer.offset == file.size == HEAD_END
            assert findings(path) == {"not-closed"}
        assert path.stat().st_size == HEAD_END

    def test_a_file_that_nothing_was_written_to_is_removed(self, tmp_path: Path):
        create_live(tmp_path / "a").close()
        with create_live(tmp_path / "b") as file:
            file.write(b"12345678")
        (tmp_path / "c").write_bytes(b"old")
        create_live(tmp_path / "c", force=True).close()
        assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"c": b"old"}

    def test_an_old_file_stands_until_the_new_one_has_its_head(self, tmp_path: Path):
        path = tmp_path / "a"
        path.write_bytes(b"old")
        with create_live(path, force=True) as file:
            file.write(b"12345678")
            assert path.read_bytes() == b"old"
            file.write(b"9")
            assert path.read_bytes() == b"123456789"
            assert [p.name for p in tmp_path.iterdir()] == ["a"]
            file.write(b"0")
        assert path.read_bytes() == b"1234567890"

    def test_a_failure_before_the_head_keeps_the_old_file(self, tmp_path: Path):
        path = tmp_path / "a"
        path.write_bytes(b"old")
        with (
            create_live(path, force=True) as file,
            size_limit(30),
            pytest.raises(OSError, match=str(path)),
        ):
            FileWriter(file)
        assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a", b"old")]

    def test_a_link_stays_a_link(self, tmp_path: Path):
        for name in ("new", "old"):
            target, link = tmp_path / f"target {name}", tmp_path / name
            link.symlink_to(target)
            if name == "old":
                target.write_bytes(b"old")
            with create_live(link, force=True) as file:
                record(file, 1)
            assert link.is_symlink()
            assert hapfmt.verify(target).verdict == "intact"

    @pytest.mark.parametrize(
        ("name", "message"),
        [
            ("", "not a file name"),
            ("{tmp}", "is a directory"),
            ("{tmp}/missing/a", "does not exist"),
            ("/dev/null", "not a regular file"),
        ],
    )
    @pytest.mark.parametrize("force", [False, True])
    def test_refusals(self, tmp_path: Path, name: str, message: str, force: bool):
        with pytest.raises(ParameterError, match=message):
            create_live(name.format(tmp=tmp_path), force=force)

    def test_an_existing_file_needs_force(self, tmp_path: Path, monkeypatch):
        path = tmp_path / "a"
        path.write_bytes(b"old")
        with pytest.raises(ParameterError, match="already exists"):
            create_live(path)
        path.unlink()
        real = os.open

        def late(name, flags, *rest):
            path.write_bytes(b"meanwhile")
            return real(name, flags, *rest)

        monkeypatch.setattr(os, "open", late)
        with pytest.raises(ParameterError, match="already exists"):
            create_live(path)
        assert path.read_bytes() == b"meanwhile"

    def test_errors_of_the_system_name_the_file(self, tmp_path: Path):
        path = tmp_path / ("x" * 300)
        with pytest.raises(OSError, match="x" * 300):
            create_live(path)
        with pytest.raises(FileNotFoundError, match="gone"):
            open_live(tmp_path / "gone")


class TestWrites:
    """
    WRT-001: A writer MUST write a chunk only when it is complete, header and payload in one piece. If it cannot write it whole, it reports that, and removes the part where the system lets it cut.
    """

    def test_short_writes_are_gone_on_with(self, tmp_path: Path, monkeypatch):
        real = os.pwrite
        monkeypatch.setattr(os, "pwrite", lambda fd, data, at: real(fd, data[:7], at))
        with create_live(tmp_path / "a") as file:
            record(file, 3, 8)
        assert hapfmt.verify(tmp_path / "a").verdict == "intact"

    def test_a_system_that_writes_nothing(self, tmp_path: Path, monkeypatch):
        with create_live(tmp_path / "a") as file:
            FileWriter(file)
            monkeypatch.setattr(os, "pwrite", lambda *_: 0)
            with pytest.raises(OSError, match="wrote nothing"):
                file.write(b"x")
            assert file.lost_size == 1
        assert (tmp_path / "a").stat().st_size == HEAD_END

    def test_without_pwrite(self, tmp_path: Path, monkeypatch):
        monkeypatch.delattr(os, "pwrite")
        monkeypatch.delattr(os, "pread")
        with create_live(tmp_path / "a") as file:
            record(file, 3, 8)
        with open_append(tmp_path / "a") as more:
            more.writer.cluster(packets(3))
        assert hapfmt.verify(tmp_path / "a").verdict == "intact"
        assert samples(tmp_path / "a") == 40_000

    @either("every", 7, deep=1)
    def test_at_every_limit_of_the_size(self, tmp_path: Path, every: int):
        whole = tmp_path / "whole"
        with create_live(whole) as file:
            record(file, 3, 8)
        data, ends = whole.read_bytes(), {}
        for number, chunk in enumerate(walk(BytesSource(whole.read_bytes()), [])):
            ends[chunk.stop] = number
        closed = 0
        for limit in range(HEAD_END, len(data), every):
            path = tmp_path / f"{limit}"
            with create_live(path, sync=SyncPolicy("never")) as file, size_limit(limit):
                with pytest.raises(OSError, match=str(path)) as caught:
                    record(file, 3, 8)
                assert caught.value.errno == errno.EFBIG
            report = hapfmt.verify(path)
            assert report.verdict == "intact" or codes(report) == {"not-closed"}
            assert report.error is None
            kept = max(end for end in ends if end <= limit)
            assert samples(path) >= 10_000 * sum(
                chunk.header.type == "DATA" and chunk.stop <= kept
                for chunk in walk(BytesSource(data), [])
            )
            closed += report.verdict == "intact"
        assert closed > 20 // every

    def test_what_was_lost_is_counted(self, tmp_path: Path):
        with create_live(tmp_path / "a") as file:
            writer = FileWriter(file)
            writer.describe([TRACK])
            writer.cluster(packets(0))
            with size_limit(file.size + 152), pytest.raises(OSError):
                writer.cluster(packets(1, 100))
            assert writer.unwritten == packets(1, 100)
            assert file.lost_size > 2000
            assert writer.closed
            with pytest.raises(OSError):
                writer.cluster(packets(1))
            writer.close()
        assert hapfmt.verify(tmp_path / "a").verdict == "intact"
        assert samples(tmp_path / "a") == 10_000

    def test_of_a_cluster_in_several_chunks_the_first_are_kept(self, tmp_path: Path):
        with create_live(tmp_path / "a") as file:
            writer = FileWriter(file)
            writer.describe([TRACK])
            body = FIVE + b"\1\0" * 50_000
            long = [Packet(0, 60_000 * i, 60_000, body) for i in range(10)]
            with size_limit(800_000), pytest.raises(OSError):
                writer.cluster(long)
        assert 0 < len(writer.unwritten) < 10
        assert samples(tmp_path / "a") == 60_000 * (10 - len(writer.unwritten))
        assert hapfmt.verify(tmp_path / "a").verdict == "intact"

    def test_descriptions_cut_in_two_are_not_closed(self, tmp_path: Path):
        """Although index and footer would find room."""
        low = Track(
            0, "lf", "KNOT", Fraction(1), 0, TRACK.components, TRACK.parameters, count_max=9
        )
        high = replace(low, id=1, kind="hf", base=0, provenance=noise(500))
        with create_live(tmp_path / "a") as file:
            writer = FileWriter(file)
            writer.describe([low])
            with size_limit(file.size + 200), pytest.raises(OSError):
                writer.describe([high])
        report = hapfmt.verify(tmp_path / "a")
        assert report.error is None and codes(report) == {"not-closed"}

    def test_a_full_disk_while_appending_leaves_the_file_closed(self, tmp_path: Path):
        path = tmp_path / "a"
        with create_live(path) as file:
            record(file, 2)
        before = path.read_bytes()
        for room in range(0, 500, 7):
            with size_limit(len(before) + room), pytest.raises(OSError), open_append(path) as more:
                more.writer.cluster(packets(2, 100))
            assert path.read_bytes() == before

    def test_an_index_of_the_rest_where_one_of_everything_finds_no_room(self, tmp_path: Path):
        path = tmp_path / "a"
        with create_live(path) as file:
            writer = FileWriter(file)
            writer.describe([TRACK])
            for number in range(100):
                writer.cluster(packets(number))
            writer.checkpoint()
            writer.cluster(packets(100))
            with size_limit(file.size + 200), pytest.raises(OSError):
                writer.cluster(packets(101, 100))
            assert len(writer.parts) == 2
        assert hapfmt.verify(path).verdict == "intact"
        assert samples(path) == 1_010_000

    def test_copies_that_find_no_room_are_left_out(self, tmp_path: Path):
        path = tmp_path / "a"
        with create_live(path) as file:
            writer = FileWriter(file, file_id=1)
            writer.describe([replace(TRACK, provenance=noise(2000))])
            for number in range(15):
                writer.cluster(packets(number, 500))
            with size_limit(file.size + 1000):
                writer.close()
        types = [chunk.header.type for chunk in walk(BytesSource(path.read_bytes()), [])]
        assert types[-3:] == ["HEAD", "iNDX", "fOOT"]
        assert hapfmt.verify(path).verdict == "intact"


class Failing(LiveFile):
    """The n-th call to the system that writes fails, or it and all that follow."""

    calls = 0
    fails = 1 << 30
    gone = False
    part = 0

    def write_at(self, position: int, data: memoryview) -> int:
        self.calls += 1
        if self.calls == self.fails or (self.gone and self.calls > self.fails):
            if self.part:
                os.pwrite(self.descriptor, data[: min(self.part, len(data) - 1)], position)
            raise OSError(errno.EIO, "no such luck")
        return super().write_at(position, data)


def failing(path: Path, fails: int, gone: bool, part: int) -> Failing:
    file = create_live(path)
    file.__class__ = Failing
    assert isinstance(file, Failing)
    file.fails, file.gone, file.part = fails, gone, part
    return file


@given(st.integers(1, 12), st.booleans(), st.integers(0, 40), st.booleans())
def test_any_call_may_fail(tmp_path_factory, fails, gone, part, cut_fails):
    """Once or for good, with some bytes written or none, where the file can be cut or not."""
    path = tmp_path_factory.mktemp("failing") / "a"
    done = 0
    with pytest.MonkeyPatch.context() as patch, failing(path, fails, gone, part) as file:
        if cut_fails:
            patch.setattr(os, "ftruncate", lambda *_: (_ for _ in ()).throw(OSError(errno.EIO, "")))
        try:
            writer = FileWriter(file)
            writer.describe([TRACK])
            for number in range(6):
                writer.cluster(packets(number))
                done += 1
            writer.close()
        except OSError as error:
            assert error.filename == str(path)
    if not path.exists() or path.stat().st_size < HEAD_END:
        assert fails <= 2
        return
    report = hapfmt.verify(path)
    assert report.error is None
    assert codes(report) <= {"not-closed"} | ({"truncated", "garbage"} if cut_fails else set())
    assert samples(path) >= 10_000 * done
    with open_append(path) as more:
        more.writer.metadata({"later": True})
    assert hapfmt.verify(path).verdict == "intact"
    assert samples(path) >= 10_000 * done


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    place = tmp_path / "disk"
    place.mkdir()
    made = None
    if sys.platform == "linux" and os.geteuid() == 0:
        command = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(place)]
        made = subprocess.run(command, capture_output=True, check=False)
    if made is None or made.returncode:
        pytest.skip("no small file system can be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("every", "sizes"), [(3, None), pytest.param(1, (1, 40, 300), marks=pytest.mark.deep)]
)
def test_a_full_disk_at_every_fill_state(
    small_disk: Path, every: int, sizes: tuple[int, ...] | None
):
    path, ballast = small_disk / "a.hapf", small_disk / "ballast"
    verdicts = set()
    for pages in range(0, 16, every):
        for size in sizes or ((1, 300) if pages % 2 else (40,)):
            ballast.write_bytes(bytes(4096 * pages))
            done = 0
            with pytest.raises(OSError) as caught, create_live(path) as file:
                writer = FileWriter(file)
                writer.describe([TRACK])
                for number in range(1000):
                    writer.cluster(packets(number, size))
                    done += 1
            assert caught.value.errno == errno.ENOSPC
            assert caught.value.filename == str(path)
            if not path.exists():
                assert pages == 15 or done == 0
                continue
            report = hapfmt.verify(path)
            assert report.error is None
            assert report.verdict == "intact" or codes(report) == {"not-closed"}
            verdicts.add(report.verdict)
            assert samples(path) == 10_000 * done
            ballast.write_bytes(b"")
            with suppress(OSError) if pages < 3 else nullcontext(), open_append(path) as more:
                more.writer.metadata({"more": "room"})
            assert hapfmt.verify(path).verdict == "intact" or pages < 3
            path.unlink()
    assert verdicts == {"intact", "damaged"}


OTHER = """
import sys
from hapfmt.writing.start import open_append
from hapfmt.writing.file import create_live
try:
    {call}
except Exception as error:
    print(type(error).__name__, error)
else:
    print("opened")
"""


def other(call: str, path: Path) -> str:
    """What a second program says."""
    done = subprocess.run(
        [sys.executable, "-c", OTHER.format(call=call), str(path)],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


class TestLocks:
    CALLS = ("open_append(sys.argv[1])", "create_live(sys.argv[1], force=True)")

    def test_two_writers(self, tmp_path: Path):
        path = tmp_path / "a"
        refusal = f"ParameterError Another program is writing {path}"
        with create_live(path) as file:
            record(file, 2)
            assert [other(call, path) for call in self.CALLS] == [refusal] * 2
            assert hapfmt.verify(path).verdict == "intact"
            for call in (open_append, open_live, lambda p: create_live(p, force=True)):
                with pytest.raises(ParameterError, match="Another program is writing"):
                    call(path)
        assert other(self.CALLS[0], path) == "opened"
        with open_append(path):
            assert other(self.CALLS[0], path) == refusal
        with create_live(path, force=True) as file:
            FileWriter(file)
            assert other(self.CALLS[0], path) == refusal

    def test_what_is_being_recorded_is_not_replaced(self, tmp_path: Path):
        path = tmp_path / "a"
        with create_live(path) as file:
            record(file, 1)
            before = path.read_bytes()
            with pytest.raises(ParameterError, match="Another program is writing"):
                hapfmt.write(hapfmt.Recording(()), path, force=True)
        assert path.read_bytes() == before
        hapfmt.write(hapfmt.Recording(()), path, force=True)

    def test_whether_nobody_can_tell(self, tmp_path: Path, monkeypatch):
        def broken(*_: object) -> None:
            raise OSError(errno.EIO, "broken")

        (tmp_path / "a").write_bytes(b"")
        monkeypatch.setattr("fcntl.flock", broken)
        assert not locks.in_use(tmp_path / "a")
        assert not locks.in_use(tmp_path / "b")

    def test_a_lock_ends_with_its_process(self, tmp_path: Path):
        path = tmp_path / "a"
        code = """
import os, sys
from hapfmt.writing.filewriter import FileWriter
from hapfmt.writing.file import create_live
FileWriter(create_live(sys.argv[1]))
os.kill(os.getpid(), 9)
"""
        subprocess.run([sys.executable, "-c", code, str(path)], cwd=ROOT, check=False)
        with open_append(path):
            pass
        assert hapfmt.verify(path).verdict == "intact"

    def test_a_file_system_without_locks(self, tmp_path: Path, monkeypatch):
        def none(*_: object) -> None:
            raise OSError(errno.ENOLCK, "no locks")

        monkeypatch.setattr("fcntl.flock", none)
        with create_live(tmp_path / "a") as file:
            record(file, 1)
        assert hapfmt.verify(tmp_path / "a").verdict == "intact"

    def test_another_error_of_the_lock(self, tmp_path: Path, monkeypatch):
        def broken(*_: object) -> None:
            raise OSError(errno.EIO, "broken")

        monkeypatch.setattr("fcntl.flock", broken)
        with pytest.raises(OSError, match=str(tmp_path / "a")):
            create_live(tmp_path / "a")

    @pytest.mark.parametrize(("answer", "taken"), [(None, True), (errno.EACCES, False)])
    def test_where_bytes_are_locked(self, tmp_path: Path, monkeypatch, answer, taken):
        calls = []

        def locking(descriptor: int, mode: int, size: int) -> None:
            calls.append((mode, os.lseek(descriptor, 0, os.SEEK_CUR), size))
            if answer:
                raise OSError(answer, "taken")

        system = SimpleNamespace(LK_NBLCK=2, LK_UNLCK=0, locking=locking)
        monkeypatch.setattr(locks, "optional", {"fcntl": None, "msvcrt": system}.get)
        with (tmp_path / "a").open("w+b") as stream:
            stream.write(b"abc")
            stream.flush()
            assert locks.lock(stream.fileno()) is taken
            assert stream.tell() == 3
            if taken:
                locks.unlock(stream.fileno())
        assert calls == [(2, locks.FAR, 1), (0, locks.FAR, 1)][: 1 + taken]

    def test_where_nothing_is_known_of_locks(self, monkeypatch):
        monkeypatch.setattr(locks, "optional", {}.get)
        assert locks.lock(0) is None
        locks.unlock(0)

    def test_a_file_that_is_replaced_meanwhile(self, tmp_path: Path, monkeypatch):
        path = tmp_path / "a"
        path.write_bytes(b"old")
        real, left = os.open, [1]

        def replaced(name, flags, *rest):
            descriptor = real(name, flags, *rest)
            if left:
                left.pop()
                (tmp_path / "b").write_bytes(b"new")
                (tmp_path / "b").replace(path)
            return descriptor

        monkeypatch.setattr(os, "open", replaced)
        with open_live(path) as file:
            assert file.read_at(0, 3) == b"new"
        left += [1] * 100
        with pytest.raises(ParameterError, match="again and again"):
            open_live(path)

    def test_what_is_no_file_is_not_opened(self, tmp_path: Path):
        for place in (tmp_path, "/dev/null"):
            with pytest.raises(ParameterError, match="not a regular file"):
                open_live(place)


class TestSync:
    def counted(self, monkeypatch) -> list[int]:
        calls: list[int] = []
        monkeypatch.setattr(os, "fsync", calls.append)
        return calls

    @pytest.mark.parametrize(
        ("when", "expected"),
        [("cluster", 5), ("close", 1), ("never", 0), (Fraction(2), 3), (9.5, 1)],
    )
    def test_as_often_as_asked(self, tmp_path: Path, monkeypatch, when, expected):
        now = [0.0]
        file = create_live(tmp_path / "a", sync=SyncPolicy(when, lambda: now[0]))
        calls = self.counted(monkeypatch)
        writer = FileWriter(file)
        for _ in range(4):
            now[0] += 1
            writer.metadata({})
            file.settle()
        file.close()
        assert len(calls) == expected

    def test_a_new_name_is_made_durable(self, tmp_path: Path, monkeypatch):
        synced = []
        monkeypatch.setattr("hapfmt.writing.file.sync_directory", synced.append)
        create_live(tmp_path / "a").close()
        create_live(tmp_path / "b", sync=SyncPolicy("never")).close()
        (tmp_path / "c").write_bytes(b"old")
        with create_live(tmp_path / "c", force=True) as file:
            assert synced == [tmp_path]
            FileWriter(file)
        assert synced == [tmp_path] * 2

    @pytest.mark.parametrize("when", ["always", "", 0, -1, float("inf"), float("nan")])
    def test_policies_that_there_are_not(self, when):
        with pytest.raises(ParameterError):
            SyncPolicy(when)

    def test_an_error_names_the_file_and_leaves_it_unlocked(self, tmp_path: Path, monkeypatch):
        path = tmp_path / "a"

        def fail(_: int) -> None:
            raise OSError(errno.EIO, "the disk")

        with monkeypatch.context() as patch:
            file = create_live(path)
            FileWriter(file)
            patch.setattr(os, "fsync", fail)
            with pytest.raises(OSError, match=str(path)):
                file.sync()
            with pytest.raises(OSError, match=str(path)):
                file.close()
        with open_append(path) as more:
            more.writer.metadata({})
        assert hapfmt.verify(path).verdict == "intact"


CUT = {"truncated", "garbage"}
ON_ITS_WAY = CUT | {"bad-packet", "bad-table"}
"""What a reader finds while the system takes the bytes of a chunk."""


def test_a_reader_beside_the_writer(tmp_path: Path):
    """At any moment: a file that is not closed, perhaps with a chunk still on its way."""
    path = tmp_path / "a"
    stop, seen, wrong = threading.Event(), [], []

    def look() -> None:
        while not stop.is_set():
            try:
                with hapfmt.Reader(path, scan=True) as reader:
                    total = sum(
                        piece.numbers.size
                        for piece in reader.pieces(list(reader.catalogue.tracks.values()))
                    )
                    found = {finding.code for finding in reader.findings}
                    seen.append(total)
                    if not found <= {"not-closed"} | (ON_ITS_WAY if found & CUT else set()):
                        wrong.append(reader.findings)
            except HapfmtError as error:
                wrong.append(error)

    with create_live(path) as file:
        writer = FileWriter(file)
        writer.describe([TRACK])
        reader = threading.Thread(target=look)
        reader.start()
        for number in range(50):
            writer.cluster(packets(number, 200))
            assert findings(path) == {"not-closed"}
        writer.close()
    with open_append(path) as more:
        assert findings(path) == set()
        for number in range(50, 100):
            more.writer.cluster(packets(number, 200))
            assert findings(path) == {"not-closed"}
    assert findings(path) == set()
    stop.set()
    reader.join()
    assert wrong == []
    assert seen == sorted(seen) and len(set(seen)) > 2


def test_a_link_to_nothing_needs_force(tmp_path):
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "aim")
    with pytest.raises(ParameterError, match="is a symbolic link"):
        create_live(link)
    assert not (tmp_path / "aim").exists()
