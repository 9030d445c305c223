"""tools/replay_timing.py: what it makes of known times, and that it runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import nullcontext

import numpy as np
import pytest
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import replay_timing
from replay_cases import CASES
from replay_ends import Arrival
from replay_timing import percentiles, seen


def test_percentiles_are_those_of_a_frame():
    assert percentiles([7.0]) == [7, 7, 7, 7]
    assert percentiles(range(1, 1001)) == [501, 991, 1000, 1000]


class Arrived:
    def __init__(self, times_s):
        self.times_s = times_s

    def arrivals(self):
        return [Arrival(round(1e9 * (33.3 + t)), 1, b"") for t in self.times_s]


def test_lateness_as_it_is_seen():
    """Of a thousand frames, each 80 us after its time: ten are 300 us later, one is 2.4 ms late and
    the two after it are left out, with the time until it."""
    due = np.arange(1000) / 1000
    times = due + 80e-6
    times[100:200:10] += 300e-6
    times[500] = due[502] + 480e-6
    kept = np.delete(times, [501, 502])
    p50, p99, p999, most = seen(Arrived(kept), CASES[0], len(kept))
    assert (p50, p99) == (pytest.approx(0, abs=1), pytest.approx(300, abs=1))
    assert (p999, most) == (pytest.approx(2400, abs=1), pytest.approx(2400, abs=1))


def test_no_arrival_has_no_lateness():
    assert seen(Arrived([]), CASES[0], 0) is None
    assert seen(Arrived([0.5]), CASES[0], 7) == [0, 0, 0, 0]


REPORT = {"outcome": "late", "sent": 0, "skipped": 9, "late": None, "call": None, "realtime": {},
          "watchdog": "stood by", "reason": "a frame was 31 ms late"}  # fmt: skip


class Player:
    """An end whose player says what it is told to."""

    way = "made up"

    def __init__(self, said: object) -> None:
        self.said = said

    def sink(self):
        return {}

    def arrivals(self):
        return []

    def start(self, _words):
        return self

    def output(self, _seconds):
        if isinstance(self.said, Exception):
            raise self.said
        return json.dumps({"report": self.said, "cpu_share": None, "peaks": {}})


@pytest.mark.parametrize(
    ("said", "outcome", "reason"),
    [
        (REPORT, "late", "a frame was 31 ms late"),
        (RuntimeError("Traceback\nOSError: no room"), "failed", "OSError: no room"),
        (subprocess.TimeoutExpired(["python"], 30), "failed", "TimeoutExpired: "),
        (ValueError("no JSON"), "failed", "ValueError: no JSON"),
        (subprocess.CalledProcessError(1, ["x"], "", "a\nlast words\n"), "failed", "last words"),
    ],
)
def test_every_row_appears_with_what_happened(said, outcome, reason, monkeypatch, tmp_path, capsys):
    """On a busy machine a run sends nothing, or its program fails; its row is there all the same."""
    monkeypatch.setattr(replay_timing, "opened", lambda *_: nullcontext(Player(said)))
    monkeypatch.setattr(replay_timing, "make_file", lambda *_: None)
    monkeypatch.setitem(replay_timing.wait_for.__globals__, "SECONDS", 0.02)
    path = tmp_path / "found.json"
    replay_timing.main.callback(0.5, 0, "loopback,hid", 1, False, path)
    told = json.loads(path.read_text("utf-8"))
    assert len(told["rows"]) == 2 * len(CASES)
    for row in told["rows"]:
        assert row["outcome"] == outcome and row["reason"].startswith(reason)
        assert (row["frames"], row["late"], row["seen"]) == (0, [], None)
    assert len(told["failed"]) == 2
    printed = capsys.readouterr().out
    assert printed.count(f"made up: {outcome}, {reason}") == 2 * len(CASES)
    assert printed.count("SIGKILL of the writer") == 2


@pytest.mark.deep
def test_it_runs(tmp_path):
    found = tmp_path / "found.json"
    done = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "replay_timing.py"), "--seconds", "0.5", "--load", "1",
         "--ways", "sleep,loopback", "--kills", "1", "--json", str(found)],
        capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(found.read_text("utf-8"))
    assert "kernel" in told["measured_on"] and "1 busy" in told["measured_on"]
    assert [row["way"] for row in told["rows"]] == ["sleep loop", "loopback"] * 3
    for row in told["rows"]:
        assert row["frames"] > 0 and len(row["late"]) == 4 and row["late"] == sorted(row["late"])
        if row["outcome"] == "clean":
            ticks = 0.5 * (3000 / 32 if "PCM" in row["device"] else 1000)
            assert row["frames"] + row["skipped"] >= round(ticks)
    (took,) = told["kills_ms"]["loopback"]
    assert 0 < took < 1000
