"""Files of other programs as people have them: what surprised is read as it is meant, or refused
with a way out; outputs with gaps are bounded."""

from __future__ import annotations

import io
import resource
import subprocess
import sys
import time
import zipfile
from fractions import Fraction

import commands
import numpy as np
import pytest
from depth import deep
from stalls import slowness

import hapfmt
from hapfmt import Channel, ParameterError, Recording, Span
from hapfmt.errors import LimitError

pytestmark = pytest.mark.filterwarnings("ignore::hapfmt.errors.MovedTimesWarning")

MAIN = "from hapfmt.cli import main; main()"


def csv(text: str, **given) -> Recording:
    return hapfmt.read(text.encode(), format="csv", **given)


def npz(**arrays) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def notes(recording: Recording) -> list[str]:
    return recording.metadata.get("notes", [])


def run(*arguments, cwd):
    done = commands.run(*arguments, cwd=cwd)
    return subprocess.CompletedProcess(done.args, done.returncode, None, done.stderr.decode())


def run_capped(*arguments, cwd):
    """A process of its own, whose memory is bounded."""

    def cap():
        resource.setrlimit(resource.RLIMIT_DATA, (330 << 20, 330 << 20))

    command = [sys.executable, "-c", MAIN, *map(str, arguments)]
    return subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, check=False, preexec_fn=cap
    )


REFUSED = {"verify": "requires --against", "compare": "is for inputs of other formats"}
"""What these verbs say of an option for other formats where all files are .hapf."""


class TestCsv:
    @pytest.mark.parametrize(
        ("name", "label", "unit"),
        [
            ("force [N]", "force", "N"),
            ("force (N)", "force", "N"),
            ("force(N)", "force", "N"),
            ("acc (m/s^2)", "acc", "m/s2"),
            ("finger (left)", "finger (left)", "1"),
            ("x ()", "x ()", "1"),
            ("force (N) [mN]", "force (N)", "mN"),
        ],
    )
    def test_units_in_brackets_of_both_kinds(self, name, label, unit):
        [channel] = csv(f"t,{name}\n0,1\n1,2\n")
        assert (channel.label, channel.unit) == (label, unit)

    def test_unix_times_give_the_epoch(self):
        rows = "".join(f"{1_763_830_800 + i / 1000:.3f},{i}\n" for i in range(50))
        rec = csv(f"timestamp,x\n{rows}")
        assert rec.epoch_ns == 1_763_830_800 * 10**9 and rec[0].rate == 1000
        assert rec[0].coverage == (Span(0, 50),)
        assert "the first time, 2025-11-22T17:00:00Z, became the epoch" in notes(rec)[0]
        milliseconds = rows.replace(".", "")
        rec = csv(f"timestamp [ms],x\n{milliseconds}")
        assert rec.epoch_ns == 1_763_830_800 * 10**9 and rec[0].rate == 1000

    @pytest.mark.parametrize(
        ("first", "epoch_ns"),
        [
            ("2025-11-22T17:00:00.0{}Z", 1_763_830_800_000_000_000),
            ("2025-11-22 17:00:00.0{}", 1_763_830_800_000_000_000),
            ("2025-11-22T18:30:00.2{}+01:30", 1_763_830_800_200_000_000),
            ("2025-11-22T12:00:00.9{}-0500", 1_763_830_800_900_000_000),
        ],
    )
    def test_dates(self, first, epoch_ns):
        rows = "".join(f"{first.format(i)},{i}\n" for i in range(9))
        rec = csv(f"time,x\n{rows}")
        assert (rec[0].rate, rec.epoch_ns) == (100, epoch_ns)

    def test_decimal_commas(self):
        rec = csv("t;x [N];y\n0,000;1,5;-2,5e3\n0,001;2;,25\n0,002;;0\n")
        assert rec[0].samples().tolist() == [1.5, 2] and rec[0].rate == 1000
        assert rec[1].samples().tolist() == [-2500, 0.25, 0]

    def test_dates_with_decimal_commas(self):
        rec = csv("time;x\n2025-11-22T17:00:00.5;1,5\n2025-11-22T17:00:01.5;2,5\n")
        assert rec[0].samples().tolist() == [1.5, 2.5]

    def test_a_comma_at_the_end_makes_no_channel(self):
        for rows in ("0,1,\n1,2,\n", "0,1\n1,2\n"):
            assert csv(f"t,x,\n{rows}").labels == ["x"]

    def test_labels_that_are_there_twice(self):
        rec = csv("t,x,x,x,y\n0,1,2,3,4\n1,1,2,3,4\n")
        assert rec.labels == ["x", "x (2)", "x (3)", "y"]
        assert notes(rec) == ["several channels are called 'x'; the second became 'x (2)'"]
        assert csv("t,x,x (2),x\n0,1,2,3\n1,1,2,3\n").labels == ["x", "x (2)", "x (3)"]

    @pytest.mark.parametrize("head", ["t" + ",x" * 60_000, "," * 60_000, "t" + ",x" * 600_000])
    def test_very_many_columns_are_refused_at_once(self, head):
        row = ",1" * head.count(",")
        began = time.process_time()
        with pytest.raises(ParameterError, match="more than 32766 columns"):
            csv(f"{head}\n0{row}\n1{row}\n")
        assert time.process_time() - began < slowness()


class TestNpz:
    X = np.arange(12.0).reshape(2, 6)

    def test_other_names_of_the_rate(self):
        for key in ("fs", "Fs", "sampling_rate", "sample_rate"):
            rec = hapfmt.read(npz(x=self.X, **{key: 250}))
            assert rec[0].rate == 250 and not notes(rec)

    @pytest.mark.parametrize("key", ["t", "time", "timestamps"])
    def test_times_give_the_rate_and_the_start(self, key):
        rec = hapfmt.read(npz(x=self.X, **{key: 0.5 + np.arange(6) / 100}))
        assert rec[0].rate == 100 and rec[1].coverage == (Span(50, 56),)
        rec = hapfmt.read(npz(x=self.X, **{key: 1_763_830_800 + np.arange(6) / 4}))
        assert rec[0].rate == 4 and rec.epoch_ns == 1_763_830_800 * 10**9

    def test_times_that_are_no_grid(self):
        with pytest.raises(ParameterError, match="not later than the time before"):
            hapfmt.read(npz(x=self.X, t=np.zeros(6)))
        with pytest.raises(ParameterError, match="5 times for 6 samples"):
            hapfmt.read(npz(x=self.X, t=np.arange(5.0)))

    def test_one_array_for_each_channel(self):
        rec = hapfmt.read(npz(fx=self.X[0], fy=self.X[1], fs=100, subject=np.array("S1")))
        assert rec.labels == ["fx", "fy"] and rec["fy"].samples().tolist() == [*range(6, 12)]
        assert notes(rec) == ["keys not carried over: 'subject'"]
        rec = hapfmt.read(npz(x=self.X[0], y=self.X[1], t=np.arange(6)))
        assert rec.labels == ["x", "y"] and rec["x"].rate == 1

    def test_a_single_array_of_any_name(self):
        stream = io.BytesIO()
        np.savez(stream, self.X)
        assert len(hapfmt.read(stream.getvalue(), rate=10)) == 2
        assert hapfmt.read(npz(force=self.X[0], fs=10)).labels == ["force"]

    def test_lsb_0_is_not_known(self):
        rec = hapfmt.read(npz(x=self.X, fs=10, lsb=np.array([0.0, 0.5])))
        assert rec[0].lsb is None and rec[1].lsb == 0.5

    def test_labels_that_are_there_twice(self):
        rec = hapfmt.read(npz(x=self.X, fs=10, channel_names=["f", "f"]))
        assert rec.labels == ["f", "f (2)"] and "several channels" in notes(rec)[0]

    def test_arrays_that_lie_on_their_side(self, tmp_path):
        tall = np.arange(600.0).reshape(200, 3)
        for suffix, data in (("npz", npz(x=tall, fs=10)), ("npy", None)):
            path = tmp_path / f"tall.{suffix}"
            path.write_bytes(data) if data else np.save(path, tall)
            more = ["--rate", "10"]
            for verb in ("convert", "encode"):
                done = run(verb, path, "no.hapf", *more, cwd=tmp_path)
                assert done.returncode == 1 and "--transpose" in done.stderr
            done = run("convert", path, "o.hapf", "--transpose", *more, "--force", cwd=tmp_path)
            assert done.returncode == 0, done.stderr
            assert hapfmt.read(tmp_path / "o.hapf")[1].samples()[2] == 7
            done = run("encode", path, "p.hapf", "--no-transpose", *more, "-f", cwd=tmp_path)
            assert len(hapfmt.read(tmp_path / "p.hapf")) == 200

    @pytest.mark.deep
    def test_the_original_of_a_file_lies_on_its_side_too(self, tmp_path):
        tall = np.arange(600.0).reshape(200, 3)
        (tmp_path / "tall.npz").write_bytes(npz(x=tall, fs=10))
        assert run("encode", "tall.npz", "a.hapf", "--transpose", cwd=tmp_path).returncode == 0
        for verb in (
            ("verify", "a.hapf", "--against", "tall.npz"),
            ("compare", "a.hapf", "tall.npz"),
            ("compare", "tall.npz", "tall.npz"),
            ("plot", "a.hapf", "-o", "a.png", "--against", "tall.npz"),
            ("plot", "tall.npz", "-o", "b.png"),
        ):
            done = run(*verb, cwd=tmp_path)
            assert done.returncode == 1 and "--transpose" in done.stderr
            done = run(*verb, "--transpose", cwd=tmp_path)
            assert done.returncode == 0, (verb, done.stderr)
        for verb in (("verify", "a.hapf"), ("compare", "a.hapf", "a.hapf")):
            done = run(*verb, "--transpose", cwd=tmp_path)
            assert done.returncode == 1 and REFUSED[verb[0]] in done.stderr

    def test_the_original_of_a_file_gets_the_options_of_encode(self, tmp_path):
        gaps = np.random.default_rng(1).exponential(0.01, 40)
        rows = [f"{t:.6f},{t:.3f}" for t in np.cumsum(gaps)]
        (tmp_path / "a.csv").write_text("time,f [N]\n" + "\n".join(rows) + "\n")
        options = ("--rate", "1000", "--keep-stamps")
        done = run("encode", "a.csv", "a.hapf", *options, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        for verb in (
            ("verify", "a.hapf", "--against", "a.csv"),
            ("compare", "a.hapf", "a.csv"),
            ("plot", "a.hapf", "-f", "-o", "a.png", "--against", "a.csv"),
        ):
            done = run(*verb, *options, cwd=tmp_path)
            assert done.returncode == 0, (verb, done.stderr)
            done = run(*verb, "--episode", "1", cwd=tmp_path)
            assert done.returncode == 1 and "CSV files do not use" in done.stderr
        for verb in (("verify", "a.hapf"), ("compare", "a.hapf", "a.hapf")):
            done = run(*verb, "--keep-stamps", cwd=tmp_path)
            assert done.returncode == 1 and REFUSED[verb[0]] in done.stderr

    def test_an_option_counts_for_the_inputs_that_use_it(self, tmp_path):
        tall = np.arange(600.0).reshape(200, 3)
        (tmp_path / "a.npz").write_bytes(npz(x=tall, fs=10))
        rows = "".join(f"{i / 10},{a},{b},{c}\n" for i, (a, b, c) in enumerate(tall))
        (tmp_path / "a.csv").write_text("time,x.0,x.1,x.2\n" + rows)
        done = run("compare", "a.npz", "a.csv", "--transpose", cwd=tmp_path)
        assert done.returncode == 0, done.stderr


def gappy(tmp_path, ticks=150_000_000):
    """A small file with a large gap."""
    path = tmp_path / "gap.hapf"
    coverage = (Span(0, 1), Span(ticks, ticks + 1))
    hapfmt.write(Recording((Channel(np.zeros(2), 1000, coverage, label="f"),)), path, force=True)
    assert path.stat().st_size < 1000
    return path


class TestGaps:
    @pytest.mark.parametrize("suffix", ["npz", "npy", "wav"])
    @pytest.mark.parametrize("verb", ["decode", "convert"])
    def test_a_gap_does_not_fill_the_disk_or_the_memory(self, tmp_path, suffix, verb):
        gappy(tmp_path)
        for more, size in ((), 1 << 30), (("--max-memory", "256M"), 256 << 20):
            done = run(verb, "gap.hapf", f"o.{suffix}", *more, cwd=tmp_path)
            assert done.returncode == 4, done.stderr
            assert f"more than the {size} allowed" in done.stderr and "--max-memory" in done.stderr
            assert not (tmp_path / f"o.{suffix}").exists()

    def test_csv_leaves_the_rows_out(self, tmp_path):
        done = run("decode", gappy(tmp_path), "o.csv", cwd=tmp_path)
        assert done.returncode == 0 and "149999999 rows without any sample" in done.stderr
        assert (tmp_path / "o.csv").read_text() == "t [s],f [1]\n0.000,0.0\n150000.000,0.0\n"
        back = hapfmt.read(tmp_path / "o.csv", rate=1000)
        assert back[0].coverage == (Span(0, 1), Span(150_000_000, 150_000_001))

    @pytest.mark.parametrize("suffix", ["npz", *deep(["npy", "wav"])])
    def test_gaps_that_are_allowed_are_written_in_slices(self, tmp_path, suffix):
        """12 million values take 96 MB at once."""
        path = gappy(tmp_path, 12_000_000)
        before = run_capped("info", path, cwd=tmp_path)
        assert before.returncode == 0, before.stderr
        done = run_capped("decode", path, f"o.{suffix}", "--threads", 1, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        if suffix != "wav":
            given = {"rate": 1000} if suffix == "npy" else {}
            back = hapfmt.read(tmp_path / f"o.{suffix}", **given)
            assert back[0].coverage == (Span(0, 1), Span(12_000_000, 12_000_001))

    @pytest.mark.parametrize("suffix", ["npz", "npy", "csv", "wav"])
    def test_gaps_of_one_channel_beside_another(self, suffix):
        full = Channel(np.zeros(4096), 10, label="ch1")
        some = [Channel(np.zeros(1), 10, (Span(k, k + 1),), label="x") for k in range(2, 40)]
        some = [full, *some] if suffix != "npy" else [full, Channel(np.zeros(1), 10)]
        with pytest.raises(LimitError, match="max_memory="):
            hapfmt.save(Recording(tuple(some)), io.BytesIO(), format=suffix, max_memory=1000)
        hapfmt.save(Recording(tuple(some)), io.BytesIO(), format=suffix, max_memory=1 << 21)

    def test_slices_are_what_one_piece_would_be(self, monkeypatch):
        rng = np.random.default_rng(5)
        x = np.where(rng.random((3, 900)) < 0.2, np.nan, rng.normal(size=(3, 900)))
        x[:, 0] = 0
        rec = Recording(
            tuple(Channel.from_physical(row, 10, label=f"ch{i + 1}") for i, row in enumerate(x))
        )
        whole = {}
        for size in (1 << 18, 7, 64):
            monkeypatch.setattr("hapfmt.convert.common.SLICE", size)
            monkeypatch.setattr("hapfmt.convert.csv.SLICE", size)
            for suffix in ("npz", "npy", "csv", "wav"):
                hapfmt.save(rec, stream := io.BytesIO(), format=suffix)
                if suffix == "npz":
                    found = np.load(io.BytesIO(stream.getvalue()))["x"].tobytes()
                elif suffix == "wav":  # holds the time of writing
                    found = hapfmt.read(stream.getvalue()).to_numpy().tobytes()
                else:
                    found = stream.getvalue()
                assert whole.setdefault(suffix, found) == found, suffix


class TestManyMembers:
    @pytest.mark.parametrize("name", ["x__{}", "key{}"])
    @pytest.mark.parametrize("count", [1500, 20_000])
    def test_refused_at_once(self, name, count):
        stream = io.BytesIO()
        member = io.BytesIO()
        np.save(member, np.zeros((1, 4)))
        with zipfile.ZipFile(stream, "w") as archive:
            for number in range(count):
                archive.writestr(f"{name.format(number)}.npy", member.getvalue())
        began = time.process_time()
        with pytest.raises((LimitError, ParameterError)) as error:
            hapfmt.read(stream.getvalue(), rate=None)
        assert time.process_time() - began < 2 * slowness()
        if count == 20_000 or name == "x__{}":
            assert isinstance(error.value, LimitError)
            assert ".npz archive has" in str(error.value)

    def test_too_many_rates_are_not_written(self):
        channels = [Channel(np.zeros(1), Fraction(1, k + 1)) for k in range(1001)]
        with pytest.raises(ParameterError, match="holds 1000 rates, the channels have 1001"):
            hapfmt.save(Recording(tuple(channels)), io.BytesIO(), format="npz")


class TestDecode:
    def test_a_range_without_samples(self, tmp_path):
        hapfmt.write(np.zeros(1000), tmp_path / "a.hapf", rate=1000)
        done = run("decode", "a.hapf", "o.npz", "--start", "5", cwd=tmp_path)
        assert done.returncode == 1 and "No samples in this time range" in done.stderr
        assert "ends at 1 s" in done.stderr and not (tmp_path / "o.npz").exists()
        assert run("decode", "a.hapf", "o.npz", "--start", "0.5", cwd=tmp_path).returncode == 0
