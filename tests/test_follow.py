"""A file that grows, followed while it is written."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import forge as f
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

from hapfmt.cli import cli
from hapfmt.errors import FormatError, ParameterError
from hapfmt.format.cluster import Packet
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Component, Track
from hapfmt.reading.follow import Follower
from hapfmt.reading.opening import open_catalogue
from hapfmt.writing.filewriter import FileWriter


def track(id_: int) -> Track:
    return Track(id_, "full", "RAWB", Fraction(10), id_, (Component(label=f"c{id_}"),),
                 f.raw_parameters(1), count_min=-128, count_max=127)  # fmt: skip


def packet(id_: int, cluster: int) -> Packet:
    return Packet(id_, 10 * cluster, 10, bytes([0, *[cluster % 100] * 10]))


def values(id_: int, clusters) -> dict[tuple[int, int], int]:
    return {(id_, 10 * c + i): c % 100 for c in clusters for i in range(10)}


def grown(clusters: int = 6, every: int = 3, *, late: int = 4, closed: bool = True) -> bytes:
    """A track from the start, one that is described before cluster ``late``; some indexes."""
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    writer.describe([track(0)])
    for c in range(clusters):
        if c == late:
            writer.describe([track(1)])
        writer.cluster([packet(0, c)] + ([packet(1, c)] if c >= late else []))
        if c % every == every - 1:
            writer.index()
    if closed:
        writer.close()
    return out.getvalue()


DATA = grown()
ALL = values(0, range(6)) | values(1, range(4, 6))


def collect(pieces) -> dict[tuple[int, int], int]:
    found: dict[tuple[int, int], int] = {}
    for piece in pieces:
        for i, value in enumerate(piece.numbers[:, 0].tolist()):
            key = piece.track.id, piece.start + i
            assert key not in found
            found[key] = value
    return found


HEEDS = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
    "from hapfmt.cli import main; main()"
)
"""The command line; what a shell starts in the background, and all below it, ignores interrupts."""


class Stepper:
    """Writes a file in pieces, one before each look at it; nobody sleeps."""

    def __init__(self, path: Path, parts: list[bytes]) -> None:
        self.path, self.parts = path, parts
        path.write_bytes(b"")

    def follow(self, **given) -> Follower:
        return Follower(self.path, interval=0, until=self.step, **given)

    def step(self, _: Follower) -> bool:
        """Writes on; true where nothing is left."""
        if not self.parts:
            return True
        with self.path.open("ab") as stream:
            stream.write(self.parts.pop(0))
        return False


def cut(data: bytes, places) -> list[bytes]:
    ends = [0, *sorted({place % len(data) for place in places}), len(data)]
    return [data[a:b] for a, b in pairwise(ends) if a < b]


@given(st.lists(st.integers(0, 10**6), max_size=12))
def test_wherever_the_writer_pauses(tmp_path_factory, places):
    """A chunk that is not whole is no damage; nothing is missed, nothing comes twice."""
    path = tmp_path_factory.mktemp("follow") / "a.hapf"
    with Stepper(path, cut(DATA, places)).follow() as follower:
        assert collect(follower.pieces(start=0)) == ALL
        assert follower.closed and follower.catalogue.findings == []
        assert (follower.cluster_count, follower.duration, follower.restarts) == (6, 6, 0)


def test_byte_for_byte(tmp_path):
    parts = [DATA[i : i + 1] for i in range(len(DATA))]
    with Stepper(tmp_path / "a.hapf", parts).follow() as follower:
        assert collect(follower.pieces(start=0)) == ALL
        assert follower.closed


class TestWhatIsAskedFor:
    @pytest.mark.parametrize("start", [0, 1, Fraction(5, 2), 4, 9])
    @pytest.mark.parametrize("have", [0, 1, 3, 5])
    def test_from_a_second_on(self, tmp_path, start, have):
        """What stands there already, and what comes."""
        path = tmp_path / "a.hapf"
        refs = open_catalogue(BytesSource(DATA), scan=True).data
        at = refs[have].offset + 7
        path.write_bytes(DATA[:at])
        parts = cut(DATA[at:], range(0, 10**4, 37))

        def step(_: Follower) -> bool:
            with path.open("ab") as stream:
                stream.write(parts.pop(0) if parts else b"")
            return False

        with Follower(path, interval=0, until=step) as follower:
            expected = {key: value for key, value in ALL.items() if key[1] >= 10 * start}
            assert collect(follower.pieces(start=start)) == expected

    def test_only_what_is_new(self, tmp_path):
        path = tmp_path / "a.hapf"
        refs = open_catalogue(BytesSource(DATA), scan=True).data
        path.write_bytes(DATA[: refs[2].offset])
        stepper = Stepper.__new__(Stepper)
        stepper.path, stepper.parts = path, [DATA[refs[2].offset :]]
        with stepper.follow() as follower:
            assert collect(follower.pieces("c0")) == values(0, range(2, 6))

    @pytest.mark.parametrize("name", ["c1", 1, "1"])
    def test_a_channel_that_comes_late(self, tmp_path, name):
        with Stepper(tmp_path / "a", cut(DATA, range(0, 10**4, 50))).follow() as follower:
            assert follower.channels == []
            assert collect(follower.pieces([name], start=0)) == values(1, range(4, 6))

    def test_a_false_index(self, tmp_path):
        """What it lists is looked for from the beginning."""
        data = bytearray(grown(3, late=9, closed=False))
        refs = open_catalogue(BytesSource(bytes(data)), scan=True).chunks
        index = refs[-1]
        rows = [
            (r.type, r.offset + (r.type == "DATA"), 0, 3000 * (r.type == "DATA")) for r in refs[:-2]
        ]
        rows.append((refs[-2].type, refs[-2].offset, 2000, 3000))
        lying = f.chunk("iNDX", f.index(rows), index.sequence)
        path = tmp_path / "a"
        path.write_bytes(bytes(data[: index.offset]) + lying)
        with Follower(path, interval=0, timeout=0) as follower:
            assert collect(follower.pieces(start=0)) == values(0, range(3))


class TestItsEnd:
    def test_time_out(self, tmp_path):
        path = tmp_path / "a"
        path.write_bytes(grown(closed=False))
        with Follower(path, interval=0.001, timeout=0.01) as follower:
            assert collect(follower.pieces(start=0)) == ALL
            assert not follower.closed

    def test_a_predicate(self, tmp_path):
        path = tmp_path / "a"
        path.write_bytes(grown(closed=False))
        with Follower(path, interval=0, until=lambda seen: seen.cluster_count == 6) as follower:
            assert sum(chunk.header.type == "DATA" for chunk in follower.chunks()) <= 6

    def test_another_thread(self, tmp_path):
        path = tmp_path / "a"
        path.write_bytes(grown(closed=False))
        with Follower(path, interval=60) as follower:
            threading.Timer(0.02, follower.stop).start()
            assert collect(follower.pieces(start=0)) == ALL

    def test_nothing_there(self, tmp_path):
        with pytest.raises(FileNotFoundError):
            Follower(tmp_path / "nothing")
        for name in ("http://127.0.0.1/a.hapf", tmp_path):
            with pytest.raises(ParameterError, match=r"follow|grow"):
                Follower(name)

    def test_no_hapf_file(self, tmp_path):
        (tmp_path / "a").write_bytes(b"RIFF")
        with pytest.raises(FormatError, match="no signature"):
            Follower(tmp_path / "a")


class TestDamage:
    def test_is_told_once_something_follows(self, tmp_path):
        refs = open_catalogue(BytesSource(DATA), scan=True).data
        bad = bytearray(DATA)
        bad[refs[1].offset + 50] ^= 1
        parts = cut(bytes(bad), [refs[2].offset, refs[2].offset + 40])
        stepper = Stepper(tmp_path / "a", parts)
        with stepper.follow() as follower:
            stepper.step(follower)
            assert [chunk.header.type for chunk in follower.poll()] == ["HEAD", "TRAK", "DATA"]
            assert follower.catalogue.findings == []
            found = collect(follower.pieces(start=0))
            assert found.items() <= ALL.items()
            assert values(0, range(2, 6)).items() <= found.items()
            assert {finding.code for finding in follower.catalogue.findings} >= {"bad-payload"}

    def test_garbage_between(self, tmp_path):
        refs = open_catalogue(BytesSource(DATA), scan=True).data
        at = refs[3].offset
        parts = [DATA[:at], b"junk", DATA[at:]]
        with Stepper(tmp_path / "a", parts).follow() as follower:
            assert collect(follower.pieces(start=0)) == ALL
            assert follower.catalogue.findings[0].code == "garbage"


class TestAnotherFile:
    @pytest.mark.parametrize("how", ["replaced", "cut", "rewritten"])
    def test_is_followed_from_its_beginning(self, tmp_path, how):
        path, other = tmp_path / "a", tmp_path / "b"
        path.write_bytes(grown(closed=False))
        out = io.BytesIO()
        writer = FileWriter(out, file_id=99 if how == "rewritten" else f.FILE_ID)
        writer.describe([track(5)])
        writer.cluster([packet(5, 7)])
        if how == "rewritten":
            for c in range(8, 40):
                writer.cluster([packet(5, c)])
        writer.close()

        def change(follower: Follower) -> bool:
            if not follower.restarts:
                if how == "replaced":
                    other.write_bytes(out.getvalue())
                    other.replace(path)
                else:
                    path.write_bytes(out.getvalue())
            return False

        with Follower(path, interval=0, until=change) as follower:
            found = collect(follower.pieces(start=0))
            assert found == ALL | values(5, range(7, 40 if how == "rewritten" else 8))
            assert follower.restarts == 1 and follower.closed

    def test_gone_and_back(self, tmp_path):
        path = tmp_path / "a"
        path.write_bytes(grown(closed=False))
        looks = []

        def step(_: Follower) -> bool:
            looks.append(1)
            if len(looks) == 1:
                path.rename(tmp_path / "away")
            if len(looks) == 3:
                path.write_bytes(DATA)
            return False

        with Follower(path, interval=0, until=step) as follower:
            pieces = list(follower.pieces(start=0))
            assert follower.closed and len(looks) == 3
            assert len(pieces) == 2 * 8


def test_beside_a_writer(tmp_path):
    """A thread writes and flushes while another follows."""
    path = tmp_path / "a"
    with path.open("wb") as stream:
        writer = FileWriter(stream, file_id=f.FILE_ID)
        writer.describe([track(0)])
        stream.flush()

        def write() -> None:
            for c in range(200):
                writer.cluster([packet(0, c)])
                stream.flush()
            writer.close()
            stream.flush()

        thread = threading.Thread(target=write)
        with Follower(path, interval=0.001, timeout=30) as follower:
            thread.start()
            found = collect(follower.pieces(start=0))
            thread.join()
            assert found == values(0, range(200))
            assert follower.closed and follower.catalogue.findings == []


def test_memory_does_not_grow_with_the_file(tmp_path):
    path = tmp_path / "a"
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    writer.describe([track(0)])
    for c in range(3000):
        writer.cluster([packet(0, c)])
    writer.close()
    path.write_bytes(b"")
    with Follower(path, interval=0) as follower:
        path.write_bytes(out.getvalue())
        assert sum(1 for _ in follower.pieces(start=0)) == 3000
        assert follower.catalogue.chunks == [] and follower.last.payload == b""


class TestTheCommand:
    def test_of_a_closed_file(self, tmp_path):
        path = tmp_path / "a.hapf"
        path.write_bytes(DATA)
        done = CliRunner().invoke(cli, ["info", "--follow", str(path)], standalone_mode=False)
        assert done.return_value == 0
        assert done.stdout == f"6.000 s, 6 clusters, {len(DATA)} bytes, - bytes/s, closed\n"

    def test_refuses_a_pipe(self):
        done = CliRunner().invoke(cli, ["info", "--follow", "-"])
        assert isinstance(done.exception, ParameterError)

    @pytest.mark.skipif(os.name == "nt", reason="no SIGINT for a child here")
    @pytest.mark.parametrize("ends", ["closed", "interrupted"])
    def test_while_it_grows(self, tmp_path, ends):
        path = tmp_path / "a.hapf"
        path.write_bytes(grown(3, closed=False))
        run = subprocess.Popen(
            [sys.executable, "-c", HEEDS, "info", "--follow", "--interval", "0.01", "--json", str(path)],
            cwd=ROOT, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        with run:
            first = json.loads(run.stdout.readline())
            assert (first["cluster_count"], first["closed"], first["duration_s"]) == (3, False, 3)
            if ends == "closed":
                path.write_bytes(grown(3))
            else:
                run.send_signal(signal.SIGINT)
            rest, _ = run.communicate(timeout=60)
            lines = [json.loads(line) for line in rest.splitlines()]
            assert run.returncode == 0
        if ends == "closed":
            assert lines[-1]["closed"] and lines[-1]["file_size"] == len(grown(3))
        assert all(line["last_cluster_age_s"] >= 0 for line in lines)
        assert all(line["exit_code"] == 0 for line in lines)
