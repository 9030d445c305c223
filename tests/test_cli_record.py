"""hapfmt record: pipes, signals, exit codes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

import commands
import numpy as np
import pytest
from spec import ROOT

import hapfmt
from hapfmt import Span

HEAD = b'{"channels": [{"label": "a", "rate": 1000, "calibration": [1, 0, 100]}]}\n'
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}


def started(*arguments: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "hapfmt", "record", *arguments],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=ENVIRONMENT,
    )  # fmt: skip


def run(data: bytes, *arguments: str, cwd: Path = ROOT) -> tuple[int, str, str]:
    done = commands.run("record", *arguments, cwd=cwd, stdin=data)
    return done.returncode, done.stdout.decode(), done.stderr.decode()


def test_a_table_then_more_of_it(tmp_path):
    path = str(tmp_path / "a.hapf")
    rows = "".join(f"{n},{n / 8}\n" for n in range(2500)).encode()
    table = ["--rate", "1000", "--labels", "x,y", "--unit", "N"]
    code, out, err = run(rows, path, *table)
    assert (code, err) == (0, "")
    assert out.startswith(f"{path}: 2.5 s, 5000 samples, 3 clusters, ")
    assert hapfmt.verify(path).verdict == "intact"
    code, out, err = run(rows, path, *table)
    assert code == 1 and "already exists" in err
    code, out, _ = run(rows[: rows.index(b"\n10,") + 1], path, *table, "--append", "--json")
    assert code == 0
    told = json.loads(out)
    assert told["written"] == 20 and told["channels"] == ["x", "y"] and told["dropped"] == {}
    x, y = hapfmt.read(path).channels
    assert x.coverage == (Span(0, 2510),) and x.unit == "N"
    assert y.samples()[2500:].tolist() == [n / 8 for n in range(10)]
    table = ["--rate", "500", "--labels", "a,b", "--append"]
    code, out, err = run(b"1,2\n", path, *table, "--unit", "N")
    assert (code, err) == (
        0,
        "note: adds 2 channels to the file: a (500 Hz in N), b (500 Hz in N)\n",
    )
    code, out, err = run(b"1,2\n", path, *table)
    assert code == 1 and "a.hapf: 'a' is 500 Hz in N in the file, not 500 Hz in no unit" in err
    Path(path).write_bytes(Path(path).read_bytes() + b"rubbish")
    code, out, err = run(b"1,2\n", path, *table, "--unit", "N")
    assert code == 0 and err.startswith("note: appending: 7 bytes at ")
    assert err.endswith(" append to that one\n")
    table = ["--rate", "1000", "--labels", "x,y", "--unit", "N"]
    assert run(rows, path, *table, "--force")[0] == 0
    assert hapfmt.read(path).channels[0].coverage == (Span(0, 2500),)


def test_a_bad_line_ends_with_1_and_keeps_what_came_before(tmp_path):
    path = str(tmp_path / "a.hapf")
    code, out, err = run(HEAD + b"1\n2\nx\n", path, "--json")
    assert code == 1 and "line 4: 'x' is not a number; to go on after such a line: --on-bad" in err
    assert f"kept in {path}: 0.002 s, 2 samples, 1 cluster" in err.replace("\n", " ")
    assert json.loads(out)["exit_code"] == 1
    assert hapfmt.verify(path).verdict == "intact"
    assert hapfmt.read(path).channels[0].stored.tolist() == [1, 2]


def test_a_bad_line_of_a_pipe_is_a_gap(tmp_path):
    """What comes from a device cannot be asked for again; what comes from a file can be mended."""
    path = tmp_path / "a.hapf"
    for number, (more, kept) in enumerate([([], 2), (["--on-bad-line", "stop"], 1)]):
        process = started(str(path), "--rate", "10", "--labels", "a,b", "--force", *more)
        out, err = process.communicate(b"1,2\n3,\xff4\n5,6\n")
        assert process.returncode == (3, 1)[number]
        assert b"line 2: '\xef\xbf\xbd4' is not a number" in err
        assert (b"1 line could not be used; the first: line 2" in err) == (number == 0)
        assert b" samples, 1 cluster, " in (out, err)[number]
        assert hapfmt.read(path).channels[0].samples().tolist() == [1, 5][:kept]
        assert hapfmt.verify(path).verdict == "intact"
    code, out, err = run(b"1\nx\n", str(path), "--rate", "1", "--force", "--json", "--on-bad-line", "gap")  # fmt: skip
    assert code == 3 and json.loads(out)["bad_lines"] == 1
    with hapfmt.Reader(path) as reader:
        assert reader.metadata["notes"] == [
            "1 line of the stream could not be used; the first: line 2: 'x' is not a number"
        ]


def test_gaps_are_for_lines(tmp_path):
    code, _, err = run(b"hFr1" + bytes(20), str(tmp_path / "a.hapf"), "--on-bad-line", "gap")
    assert code == 1 and "frames have no lines: leave out --on-bad-line" in err


def test_floats_within_a_bound_are_as_small_as_encode_makes_them(tmp_path):
    n = np.arange(5000) / 1000
    x = np.sin(4.4 * n) * 2 + np.random.default_rng(1).normal(0, 0.002, 5000)
    text = "".join(f"{value!r}\n" for value in x.tolist()).encode()
    table = ["--rate", "1000", "--labels", "f", "--unit", "N", "--force"]
    for options in (["near-lossless"], ["near-lossless", "--max-error", "0.01"], ["perceptual", "--no-texture"]):  # fmt: skip
        code, *_ = run(text, str(tmp_path / "r.hapf"), *table, "--preset", *options)
        assert code == 0
        (tmp_path / "x.csv").write_bytes(b"f [N]\n" + text)
        done = commands.run(
            "encode", "x.csv", "e.hapf", "--force", "--rate", 1000, "--cluster", 1, "--preset",
            *options, cwd=tmp_path,
        )  # fmt: skip
        assert done.returncode == 0
        sizes = [(tmp_path / name).stat().st_size for name in ("r.hapf", "e.hapf")]
        assert sizes[0] < 1.3 * sizes[1] + 300, (options, sizes)


@pytest.mark.parametrize("name", ["time [s]", "t", "Zeit (ms)", "timestamp"])
def test_a_column_of_times_is_a_channel_with_a_note(tmp_path, name):
    path = str(tmp_path / "a.hapf")
    code, _, err = run(f"{name},f [Nmm]\n0,1\n9,2\n".encode(), path, "--rate", "10")
    said = f"note: column {name!r} is recorded as a channel; hapfmt encode places rows by their"
    assert code == 0 and said in " ".join(err.split())
    time, f = hapfmt.read(path)
    assert time.samples().tolist() == [0, 9] and (f.label, f.unit) == ("f", "N.mm")


@pytest.mark.parametrize("names", [b"fx,time [s]", b"f (N),y", b"time"])
def test_other_columns_need_no_note(tmp_path, names):
    row = b",".join(b"1" for _ in names.split(b","))
    code, _, err = run(names + b"\n" + row + b"\n", str(tmp_path / "a.hapf"), "--rate", "10")
    assert (code, err) == (0, "")


def test_a_unit_for_each_channel_of_a_table(tmp_path):
    path = str(tmp_path / "a.hapf")
    assert run(b"1,2\n", path, "--rate", "10", "--unit", "Nmm,m")[0] == 0
    assert [channel.unit for channel in hapfmt.read(path)] == ["N.mm", "m"]
    code, _, err = run(b"1,2\n", path, "--rate", "10", "--unit", "N,m,s", "--force")
    assert code == 1 and "3 units for 2 channels" in err


def test_units_of_a_header_become_codes(tmp_path):
    path = str(tmp_path / "a.hapf")
    header = b'{"channels": [{"label": "a", "rate": 10, "unit": "Nmm"}]}\n1\n'
    assert run(header, path)[0] == 0 and hapfmt.read(path)[0].unit == "N.mm"
    assert run(b"1\n", path, "--rate", "10", "--unit", "m/s^2", "--force")[0] == 0
    assert hapfmt.read(path)[0].unit == "m/s2"


@pytest.mark.parametrize(
    ("data", "arguments", "message"),
    [
        (b"1\n", [], "a table needs its rate"),
        (b"", ["--rate", "10"], "ended before any channel"),
        (b"1\n", ["--rate", "10", "--fsync", "often"], "fsync is one of"),
        (
            b"1\n",
            ["--rate", "10", "--lsb", "1", "--preset", "near-lossless"],
            "0.1 % of range of '1' is not known before the end",
        ),
        (
            b"1\n",
            ["--rate", "10", "--preset", "near-lossless", "--max-error", "2lsb"],
            "'1' has no known step, so an amount in lsb does not apply: add --lsb",
        ),
        (b"1\n", ["--rate", "10", "--append"], "No such file"),
        (b"1\n", ["--rate", "10", "--input", "nowhere"], "No such file"),
    ],
)
def test_what_cannot_begin_leaves_no_file(tmp_path, data, arguments, message):
    path = tmp_path / "a.hapf"
    code, _, err = run(data, str(path), *arguments)
    assert code == 1 and message in err and not path.exists()


def test_from_a_file_to_a_pipe_with_an_id(tmp_path):
    source = tmp_path / "rows.txt"
    source.write_bytes(HEAD + b"1\n2\n3\n")
    outputs = set()
    for _ in range(2):
        done = commands.run("record", "-", "--input", source, "--canonical", "7", cwd=tmp_path)
        assert done.returncode == 0
        outputs.add(done.stdout)
        assert b"3 samples" in done.stderr
    (data,) = outputs
    assert hapfmt.read(data).channels[0].stored.tolist() == [1, 2, 3]


def wait_for_samples(path: Path) -> None:
    end = time.monotonic() + 60
    while not path.exists() or b"DATA" not in path.read_bytes():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_closes_the_file(tmp_path, number):
    path = tmp_path / "a.hapf"
    process = started(str(path))
    process.stdin.write(HEAD + b'1\n2\n{"flush": true}\n')
    process.stdin.flush()
    wait_for_samples(path)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, b"")
    assert b"2 samples" in out
    assert hapfmt.verify(path).verdict == "intact"
    assert hapfmt.read(path).channels[0].stored.tolist() == [1, 2]


def test_under_nohup_the_end_of_the_connection_ends_nothing(monkeypatch):
    from hapfmt.cli.record import exit_signals

    monkeypatch.setattr(signal, "getsignal", lambda _: signal.SIG_IGN)
    assert exit_signals() == [signal.SIGINT, signal.SIGTERM]
    monkeypatch.setattr(signal, "getsignal", lambda _: signal.SIG_DFL)
    assert signal.SIGHUP in exit_signals()


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_signal_before_anything_came(tmp_path):
    path = tmp_path / "a.hapf"
    process = started(str(path))
    time.sleep(1.5)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode in (1, -signal.SIGTERM) and not path.exists(), err


def test_dropped_samples_end_with_3(tmp_path, monkeypatch):
    """The encoder is held up by a disk that takes nothing until a sample is dropped."""
    from click.testing import CliRunner

    from hapfmt.cli import cli
    from hapfmt.writing import recorder as module

    monkeypatch.setattr(module, "QUEUE_SIZE", 4096)
    monkeypatch.setattr(module.Recorder.__init__, "__kwdefaults__", {
        **module.Recorder.__init__.__kwdefaults__, "queue_size": 4096
    })  # fmt: skip
    pwrite, put, refused = os.pwrite, module.SampleQueue.put, threading.Event()

    def slow(*given):
        if threading.current_thread() is not threading.main_thread():
            refused.wait(60)
        return pwrite(*given)

    def told(*given, **how):
        taken = put(*given, **how)
        if not taken:
            refused.set()
        return taken

    monkeypatch.setattr(os, "pwrite", slow)
    monkeypatch.setattr(module.SampleQueue, "put", told)
    source = tmp_path / "rows.txt"
    noise = np.random.default_rng(0).integers(-999, 999, 100_000)
    source.write_bytes(HEAD + "\n".join(map(str, noise)).encode())
    path = tmp_path / "a.hapf"
    arguments = [
        "record",
        str(path),
        "--input",
        str(source),
        "--on-full",
        "drop",
        "--fsync",
        "never",
    ]
    done = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert done.return_value == 3 and "dropped " in done.stderr
    back = hapfmt.read(path)
    values = back.channels[0]
    ticks = np.concatenate([np.arange(*span) for span in values.coverage])
    assert 0 < values.stored.size < noise.size and (values.stored == noise[ticks]).all()
    assert "for which the encoder was too slow" in back.metadata["notes"][0]


def test_what_a_kill_may_leave(tmp_path, monkeypatch):
    """tools/crash.py: a kill within a write cuts the last chunk, and that is no fault as long as
    all that was flushed is there; anything else that is lost is one."""
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    import crash

    path = tmp_path / "crash.hapf"
    at = [0] * crash.CHANNELS
    flushed, told = [], []
    with hapfmt.Recorder(path, crash.inputs(), cluster=crash.CLUSTER) as recorder:
        for _ in range(3):
            for number in range(crash.CHANNELS):
                stop = at[number] + int(crash.RATES[number % 3] / 10)
                values = crash.values(number, crash.samples(number, at[number], stop))
                recorder.write(number, values, tick=at[number])
                at[number] = stop
            recorder.flush()
            flushed.append(path.stat().st_size)
            told.append([crash.Flushed(0, stop, stop) for stop in at])
    whole = path.read_bytes()
    cuts = [*range(flushed[1], flushed[2], 997), flushed[2] - 1]
    codes: Counter[str] = Counter()
    for cut in cuts:
        path.write_bytes(whole[:cut])
        tally = crash.Tally()
        crash.look(path, told[1], tally)
        codes += tally.findings
    assert codes["truncated"] and codes["bad-packet"], codes
    with pytest.raises(AssertionError, match="kept"):
        crash.look(path, told[2], crash.Tally())
    path.write_bytes(whole[: flushed[0] + 999] + b"?" + whole[flushed[0] + 1000 :])
    with pytest.raises(AssertionError, match="bad-p"):
        crash.look(path, told[0], crash.Tally())


@pytest.mark.deep
def test_a_few_crashes():
    """tools/crash.py, a few of its trials."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "crash.py"), "--trials", "6", "--seed", "3"],
        capture_output=True, text=True, env=ENVIRONMENT, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^\| +killed \| +6 \|$", done.stdout, re.M), done.stdout
    assert re.search(r"^\| +faults \| +0 \|$", done.stdout, re.M), done.stdout


@pytest.mark.parametrize("text", ["0,25;12,25\n1,5;3,5\n", "0,25\t1\n", "0,25 1,5\n", "1;0,5"])
def test_decimal_commas_are_refused_before_a_file_is_there(tmp_path, text):
    code, _, err = run(text.encode(), "x.hapf", "--rate", "1000", cwd=tmp_path)
    assert code == 1 and "line 1: " in err
    assert "decimal comma; write decimal points" in err
    assert not list(tmp_path.iterdir())


def test_decimal_commas_below_a_header(tmp_path):
    *_, err = run(b"a;b\n0,25;1,5\n", "x.hapf", "--rate", "1000", cwd=tmp_path)
    assert "line 2: '0,25' has a decimal comma" in err
