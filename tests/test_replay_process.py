"""A replay by processes: player, writer, watchdog; into a file, where the order of things shows.

Nothing here depends on a machine that keeps time, but for what is late on purpose.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replaying import (
    CHANGE,
    NEUTRAL_COUNT,
    Line,
    Playing,
    Sines,
    child,
    glove,
    lines,
    running,
    until,
)

from hapfmt.errors import FormatError, ParameterError
from hapfmt.replay.frames import Frame
from hapfmt.replay.process import player
from hapfmt.replay.process.player import Status, play
from hapfmt.replay.process.report import ReplayReport

posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and /proc")
linux = pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "device"


def played(file: Path, source: Any = None, hold_ms: int = 1000, **how: Any) -> ReplayReport:
    """A replay here, of 0.3 s unless said otherwise."""
    config = {"kind": "loopback", "file": str(file), "faults": how.pop("faults", None)}
    how = {"heartbeat_s": 5, "realtime": False, **how}
    return play(source or Sines(0.3), glove(hold_ms), config, **how)


def check_order(got: list[Line]) -> list[Line]:
    """Frames of one writer, in order, each change within the limits; the frames."""
    frames = [line for line in got if line.number >= 0]
    numbers = [line.number for line in frames]
    assert numbers == sorted(set(numbers))
    assert len({line.by for line in frames}) <= 1
    counts = np.array([(0,) * 5, *(line.counts for line in frames)])
    assert np.abs(counts).max() <= 5000
    assert np.abs(np.diff(counts, axis=0)).max() <= CHANGE
    return frames


def check_rest(got: list[Line], *, ramped: bool = True) -> None:
    """Down by a ramp, and neutral frames as the last."""
    frames = check_order(got)
    last = got[-NEUTRAL_COUNT:]
    assert all(line.number == -1 and line.neutral for line in last)
    if ramped:
        assert frames[-1].neutral
        assert any(not line.neutral for line in frames)


class TestEnds:
    """PLY-007: On every end that it lives to see, a player MUST send the neutral frame, several times, as the last."""

    def test_clean(self, file):
        report = played(file)
        got = lines(file)
        check_rest(got)
        assert (report.outcome, report.exit_code) == ("clean", 0)
        assert report.neutral == NEUTRAL_COUNT
        assert report.sent == len(got) - NEUTRAL_COUNT
        assert report.sent + report.skipped > 300
        assert report.watchdog == "stood by"
        assert report.said == []
        assert report.late is not None and report.late["p50"] <= report.late["max"]
        assert report.left_out == ["channel 6: no actuator"]
        assert len({line.by for line in got}) == 1

    @posix
    @pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
    def test_a_signal_to_the_player(self, file, name):
        with Playing(file) as playing:
            playing.moving()
            playing.process.send_signal(getattr(signal, name))
            report = playing.report()
        check_rest(lines(file))
        assert report["outcome"] == "interrupted"
        assert report["exit_code"] == 128 + getattr(signal, name)
        assert report["watchdog"] == "stood by"

    @posix
    @pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
    def test_a_signal_to_the_writer(self, file, name):
        with Playing(file) as playing:
            os.kill(playing.moving()[0].by, getattr(signal, name))
            report = playing.report()
        check_rest(lines(file))
        assert report["exit_code"] == 128 + getattr(signal, name)

    @linux
    def test_a_signal_to_the_watchdog(self, file):
        with Playing(file) as playing:
            watchdog = child(playing.moving()[0].by)
            assert watchdog is not None
            os.kill(watchdog, signal.SIGTERM)
            report = playing.report()
        check_rest(lines(file))
        assert report["exit_code"] == 128 + signal.SIGTERM

    @posix
    def test_a_second_signal_does_not_cut_the_ramp(self, file):
        with Playing(file) as playing:
            playing.moving()
            for _ in range(5):
                playing.process.send_signal(signal.SIGINT)
                time.sleep(0.01)
            report = playing.report()
        check_rest(lines(file))
        assert report["exit_code"] == 128 + signal.SIGINT

    @linux
    def test_the_player_is_killed(self, file):
        with Playing(file) as playing:
            writer = playing.moving()[0].by
            watchdog = child(writer)
            playing.process.kill()
            until(lambda: not running(writer))
            until(lambda: not running(watchdog))
        check_rest(lines(file))

    @linux
    def test_the_player_is_stopped(self, file):
        with Playing(file) as playing:
            writer = playing.moving()[0].by
            playing.process.send_signal(signal.SIGSTOP)
            until(lambda: not running(writer))
            playing.process.send_signal(signal.SIGCONT)
            report = playing.report()
        check_rest(lines(file))
        assert report["outcome"] == "failed"
        assert report["reason"] == "the player is silent"

    @linux
    def test_the_watchdog_is_killed(self, file):
        with Playing(file) as playing:
            watchdog = child(playing.moving()[0].by)
            assert watchdog is not None
            os.kill(watchdog, signal.SIGKILL)
            report = playing.report()
        check_rest(lines(file))
        assert (report["outcome"], report["exit_code"]) == ("failed", 1)
        assert report["watchdog"] == "ended: it has died"

    def test_an_exception_in_the_writer(self, file):
        report = played(file, Sines(60), faults={"error": 100})
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert "ZeroDivisionError" in report.reason

    def test_a_write_error(self, file):
        report = played(file, Sines(60), faults={"fail": {"frame": 100}})
        got = lines(file)
        assert all(line.neutral for line in got[-NEUTRAL_COUNT:])
        assert got[-NEUTRAL_COUNT - 1].neutral
        assert (report.outcome, report.exit_code) == ("device-lost", 6)
        assert "did not take a report" in report.reason

    def test_write_errors_one_after_the_other(self, file):
        report = played(file, Sines(60), faults={"fail": {"frame": 100, "times": 4}})
        check_rest(lines(file)[100:], ramped=False)
        assert report.exit_code == 6
        assert report.neutral == NEUTRAL_COUNT - 2

    def test_an_error_of_the_file_midway(self, file):
        report = played(file, Sines(60, fails_at=200))
        got = lines(file)
        check_rest(got)
        assert len(got) > 200
        assert (report.outcome, report.exit_code) == ("failed", 2)
        assert report.reason == "made up"

    def test_an_error_of_ours_midway(self, file):
        with pytest.raises(KeyError):
            played(file, Sines(60, fails_at=200, error=KeyError("made up")))
        check_rest(lines(file))

    def test_an_error_of_the_caller(self, file):
        def on_status(_: Status) -> None:
            raise KeyError("made up")

        with pytest.raises(KeyError):
            played(file, Sines(60), on_status=on_status)
        check_rest(lines(file))

    def test_late(self, file):
        faults = {"stall": {"frame": 100, "ms": 300}}
        report = played(file, Sines(60), hold_ms=20, faults=faults)
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("late", 5)
        assert report.skipped > 200
        assert report.late["max"] > 250_000


