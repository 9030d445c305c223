"""rerun-loader-hapf: what it prints is what Rerun's own reader finds; files of others are refused."""

from __future__ import annotations

import io
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hapfmt
from hapfmt.cli.rerun_loader import main, windows
from hapfmt.convert import save
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

EPOCH = 1_700_000_000 * 10**9


def recording() -> Recording:
    generator = np.random.default_rng(2)
    return Recording(
        (
            Channel(generator.normal(size=4000), 1000, (Span(10, 1510), Span(2000, 4500)),
                    label="fx", unit="N"),
            Channel(np.arange(900, dtype=np.int32), 200, calibration=Calibration(1, 0, 100), label="a/b"),
            Channel(np.empty(0), 50, label="never"),
        ),
        epoch_ns=EPOCH,
        events=(Event(Fraction(1, 4), "slip", layer="grip"), Event(Fraction(2), "end")),
    )  # fmt: skip


def printed(path: Path, *words: str) -> subprocess.CompletedProcess[bytes]:
    code = "import sys; from hapfmt.cli.rerun_loader import main; main()"
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code, str(path), *words],
        capture_output=True, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("rerun") / "grasp.hapf"
    hapfmt.write(recording(), path)
    return path


def needs_rerun() -> None:
    pytest.importorskip("rerun.chunk", reason="rerun-sdk (extra rerun) is not installed")


class TestProtocol:
    @pytest.mark.parametrize("name", ["a.npz", "a.rrd", "a", "absent.hapf", "."])
    def test_other_files_are_not_for_it(self, name, tmp_path):
        if not name.startswith(("absent", ".")):
            (tmp_path / name).write_bytes(b"x")
        done = CliRunner().invoke(main, [str(tmp_path / name), "--recording-id", "x"])
        assert (done.exit_code, done.output) == (66, "")

    def test_it_starts_fast(self, tmp_path):
        code = """
import sys
from hapfmt.cli.rerun_loader import main
try:
    main(["a.npz"])
except SystemExit as end:
    assert end.code == 66
assert not {"rerun", "numpy", "pyarrow"} & set(sys.modules)
"""
        subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)

    def test_without_the_extra(self, file, monkeypatch):
        monkeypatch.setitem(sys.modules, "rerun", None)
        done = CliRunner().invoke(main, [str(file)])
        assert done.exit_code == 1
        assert "pip install 'hapfmt[rerun]'" in done.output

    def test_damaged_files_are_named(self, file, tmp_path):
        needs_rerun()
        path = tmp_path / "cut.hapf"
        path.write_bytes(file.read_bytes()[:400])
        done = printed(path)
        assert done.returncode == 1 and done.stdout == b""
        assert done.stderr.startswith(b"rerun-loader-hapf: ")
        assert b"Traceback" not in done.stderr


class TestStream:
    def chunks(self, data: bytes, tmp_path: Path) -> dict[str, list]:
        from rerun.chunk import RrdReader

        path = tmp_path / "a.rrd"
        path.write_bytes(data)
        found: dict[str, list] = {}
        for chunk in RrdReader(path).stream().to_chunks():
            found.setdefault(chunk.entity_path, []).append(chunk)
        return found

    def column(self, chunks: list, name: str) -> tuple[list[int], list[int], list]:
        """(recording time, UTC, value) of all rows that have it, in ns."""
        rows = []
        for chunk in chunks:
            batch = chunk.to_record_batch()
            if name in batch.schema.names and not chunk.is_static:
                times = [
                    batch.column(one).cast("int64").to_pylist() for one in ("recording_time", "utc")
                ]
                rows += zip(*times, batch.column(name).to_pylist(), strict=True)
        rows.sort(key=lambda row: row[0])
        return tuple(map(list, zip(*rows, strict=True))) if rows else ([], [], [])

    def test_values_times_gaps_and_events(self, file, tmp_path):
        needs_rerun()
        done = printed(
            file, "--application-id", "lab", "--recording-id", "r1", "--opened-recording-id", "r0",
            "--time_sequence", "x=3",
        )  # fmt: skip
        assert done.returncode == 0 and done.stderr == b""
        found = self.chunks(done.stdout, tmp_path)
        own = {path for path in found if not path.startswith("/__")}
        assert own == {"/fx", r"/a\/b", "/never", "/events", "/events/grip"}
        for channel, path, period in zip(
            recording(), ("/fx", r"/a\/b"), (10**6, 5 * 10**6), strict=False
        ):
            times, utc, values = self.column(found[path], "Scalars:scalars")
            ticks = np.concatenate([np.arange(*span) for span in channel.coverage])
            assert times == (ticks * period).tolist()
            assert utc == (ticks * period + EPOCH).tolist()
            assert values == [[x] for x in channel.samples()]
        assert self.column(found["/fx"], "Clear:is_recursive") == (
            [1510 * 10**6], [EPOCH + 1510 * 10**6], [[False]],
        )  # fmt: skip
        assert self.column(found["/events/grip"], "TextLog:text") == (
            [250 * 10**6], [EPOCH + 250 * 10**6], [["slip"]],
        )  # fmt: skip
        names = {
            path: chunk.to_record_batch().column("SeriesLines:names").to_pylist()
            for path in own
            for chunk in found[path]
            if chunk.is_static
        }
        assert names["/fx"] == [["fx [N]"]] and names[r"/a\/b"] == [["a/b"]]

    def test_a_prefix(self, file, tmp_path):
        needs_rerun()
        found = self.chunks(printed(file, "--entity-path-prefix", "world/hand").stdout, tmp_path)
        assert "/world/hand/fx" in found

    def test_rerun_opens_the_mcap_that_hapfmt_writes(self, tmp_path):
        needs_rerun()
        from rerun.chunk import McapReader

        save(recording(), tmp_path / "a.mcap")
        chunks = McapReader(tmp_path / "a.mcap").stream().to_chunks()
        rows = {}
        for chunk in chunks:
            rows[chunk.entity_path] = max(rows.get(chunk.entity_path, 0), chunk.num_rows)
        assert rows["/samples"] == 4000 and rows["/events"] == 2


class TestWindows:
    """Parts of the file, each small, that together hold every sample once."""

    def parts(self, made: Recording) -> list[Recording]:
        stream = io.BytesIO()
        hapfmt.write(made, stream)
        with hapfmt.Reader(io.BytesIO(stream.getvalue())) as reader:
            return [reader.read(start=start, stop=stop) for start, stop in windows(reader)]

    def test_a_long_recording(self):
        made = Recording(
            (
                Channel(np.arange(400_000.0), 1000),
                Channel(np.arange(290.0), Fraction(3, 4)),
            )
        )
        parts = self.parts(made)
        assert len(parts) >= 6 and max(part.sample_count for part in parts) < 72_000
        for number, channel in enumerate(made):
            assert np.array_equal(np.concatenate([p[number].stored for p in parts]), channel.stored)

    def test_years_without_samples_take_no_windows(self):
        spans = (Span(0, 5), Span(1 << 35, (1 << 35) + 5))
        parts = self.parts(Recording((Channel(np.arange(10.0), 1000, spans),)))
        assert len(parts) <= 3
        assert [x for p in parts for x in p[0].stored.tolist()] == [*range(10)]
