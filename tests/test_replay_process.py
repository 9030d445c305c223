"""A replay by processes: player, writer, watchdog; into a file, where the order of things shows.

Nothing here depends on a machine that keeps time, but for what is late on purpose.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from replaying import (
    CHANGE,
    NEUTRAL_COUNT,
    RATE,
    Line,
    Playing,
    Sines,
    child,
    glove,
    lines,
    moving,
    running,
    until,
)

import hapfmt
from hapfmt.errors import ParameterError
from hapfmt.replay.process import player
from hapfmt.replay.process.loop import ReplayReport
from hapfmt.replay.process.player import Key, PlayerStatus, play
from hapfmt.replay.profile.model import Frame, HidReport
from hapfmt.replay.render.assign import assign
from hapfmt.replay.render.renderer import Renderer


def deep(*values: Any) -> list[Any]:
    """Parameters that differ too little from others to be tried each time."""
    return [
        pytest.param(*value, marks=pytest.mark.deep)
        if isinstance(value, tuple)
        else pytest.param(value, marks=pytest.mark.deep)
        for value in values
    ]


pytestmark = pytest.mark.realtime
posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and /proc")
linux = pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "device"


def played(
    file: Path,
    source: Any = None,
    hold_ms: int = 1000,
    meanwhile: Callable[[int], Any] | None = None,
    **how: Any,
) -> ReplayReport:
    """A replay here, of 0.3 s unless said otherwise; ``meanwhile`` is told the writer's process,
    once the device has got some frames, and does something to it."""
    config = {"kind": "loopback", "file": str(file), "faults": how.pop("faults", None)}
    how = {"heartbeat_s": 5, "realtime": False, **how}
    failed: list[BaseException] = []

    def act() -> None:
        try:
            meanwhile(moving(file)[0].by)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=act)
    if meanwhile is not None:
        thread.start()
    report = play(source or Sines(60 if meanwhile else 0.3), glove(hold_ms), config, **how)
    if meanwhile is not None:
        thread.join()
    assert not failed, failed
    return report


def kill(number: int) -> Callable[[int], None]:
    return lambda writer: os.kill(writer, number)


def kill_watchdog(number: int) -> Callable[[int], None]:
    def act(writer: int) -> None:
        watchdog = child(writer)
        assert watchdog is not None
        os.kill(watchdog, number)

    return act


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
    """PLY-007: However it ends, as far as it still runs, a player MUST send the neutral frame last, several times. It does not write to a device again once a write failed because the device is gone."""

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
    @pytest.mark.parametrize("name", ["SIGTERM", *deep("SIGINT", "SIGHUP")])
    def test_a_signal_to_the_player(self, file, name):
        number = getattr(signal, name)
        report = played(file, meanwhile=lambda _: os.kill(os.getpid(), number))
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("interrupted", 128 + number)
        assert report.watchdog == "stood by"

    @posix
    @pytest.mark.parametrize("name", ["SIGINT", *deep("SIGTERM", "SIGHUP")])
    def test_a_signal_to_the_writer(self, file, name):
        number = getattr(signal, name)
        report = played(file, meanwhile=kill(number))
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("interrupted", 128 + number)

    @linux
    @pytest.mark.deep
    def test_a_signal_to_the_watchdog(self, file):
        report = played(file, meanwhile=kill_watchdog(signal.SIGTERM))
        check_rest(lines(file))
        assert report.exit_code == 128 + signal.SIGTERM

    @posix
    @pytest.mark.deep
    def test_a_second_signal_does_not_cut_the_ramp(self, file):
        def again(_: int) -> None:
            for _ in range(5):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.003)

        report = played(file, meanwhile=again)
        check_rest(lines(file))
        assert report.exit_code == 128 + signal.SIGINT

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
    @pytest.mark.deep
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
        report = played(file, meanwhile=kill_watchdog(signal.SIGKILL))
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert report.watchdog == "ended: it has died"

    def test_an_exception_in_the_writer(self, file):
        report = played(file, Sines(60), faults={"error": 100})
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert "ZeroDivisionError" in report.reason

    def test_a_write_error(self, file):
        report = played(file, Sines(60), faults={"fail": {"frame": 100}})
        check_rest(lines(file))
        assert report.sent == len(lines(file)) - NEUTRAL_COUNT
        assert (report.outcome, report.exit_code) == ("device-lost", 6)
        assert "did not take a report" in report.reason

    @pytest.mark.deep
    def test_write_errors_one_after_the_other(self, file):
        report = played(file, Sines(60), faults={"fail": {"frame": 100, "times": 4}})
        check_rest(lines(file), ramped=False)
        assert report.exit_code == 6
        assert report.neutral == NEUTRAL_COUNT

    def test_an_error_of_the_file_midway(self, file):
        report = played(file, Sines(60, fails_at=200))
        got = lines(file)
        check_rest(got)
        assert report.sent + report.skipped > 150
        assert (report.outcome, report.exit_code) == ("failed", 2)
        assert report.reason == "made up"

    @pytest.mark.deep
    def test_an_error_of_ours_midway(self, file):
        with pytest.raises(KeyError):
            played(file, Sines(60, fails_at=200, error=KeyError("made up")))
        check_rest(lines(file))

    @pytest.mark.deep
    def test_an_error_of_the_caller(self, file):
        def on_status(_: PlayerStatus) -> None:
            raise KeyError("made up")

        with pytest.raises(KeyError):
            played(file, Sines(60), on_status=on_status)
        check_rest(lines(file))

    def test_late(self, file):
        faults = {"stall": {"frame": 100, "ms": 900}}
        report = played(file, Sines(60), hold_ms=500, faults=faults)
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("late", 5)
        assert report.skipped > 800
        assert report.late["max"] > 800_000


class TestGone:
    """Ends that somebody does not live to see."""

    @posix
    def test_the_writer_is_killed(self, file):
        report = played(file, meanwhile=kill(signal.SIGKILL))
        got = lines(file)
        writer = got[0].by
        last = got[-NEUTRAL_COUNT:]
        assert all(line.neutral and line.by != writer for line in last)
        assert {line.by for line in got[:-NEUTRAL_COUNT]} == {writer}
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert report.reason == "the writer has died (signal 9)"
        assert report.watchdog == "tripped: the writer has died; the device took 5 neutral frames"
        assert report.sent > 0

    @linux
    @pytest.mark.deep
    def test_player_and_writer_are_killed(self, file):
        with Playing(file) as playing:
            writer = playing.moving()[0].by
            watchdog = child(writer)
            playing.process.kill()
            os.kill(writer, signal.SIGKILL)
            until(lambda: not running(watchdog))
        got = lines(file)
        assert all(line.neutral and line.by == watchdog for line in got[-NEUTRAL_COUNT:])

    @linux
    @pytest.mark.deep
    def test_the_writer_hangs(self, file, monkeypatch):
        """The watchdog trips at once, the player ends what does not come back."""
        monkeypatch.setattr(player, "SILENT_S", 0.5)
        faults = {"stall": {"frame": 100, "ms": 60_000}}
        report = played(file, Sines(60), faults=faults, heartbeat_s=1.1)
        got = lines(file)
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert report.reason.startswith("the writer said nothing for")
        assert report.watchdog.startswith("tripped: the writer")
        assert all(line.neutral for line in got[-NEUTRAL_COUNT:])
        assert not running(got[0].by)

    def test_the_device(self, file):
        report = played(file, Sines(60), faults={"gone": 100})
        check_order(lines(file))
        assert len(lines(file)) == 100
        assert (report.outcome, report.exit_code) == ("device-lost", 6)
        assert "has gone" in report.reason
        assert report.neutral == 0

    def test_the_writer_before_it_began(self, file, monkeypatch):
        monkeypatch.setattr(player, "start", lambda _, stderr: start_other(stderr))
        report = played(file)
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert report.reason == "the writer has died (exit code 7)"
        assert report.said == ["no such thing"]
        assert not file.exists()

    @pytest.mark.deep
    def test_a_writer_that_is_none(self, file, monkeypatch):
        code = "import time; print('hello', flush=True); time.sleep(60)"
        monkeypatch.setattr(player, "start", lambda _, stderr: start_other(stderr, code))
        report = played(file)
        assert report.outcome == "failed"
        assert "an unknown message" in report.reason


def start_other(stderr: int | None, code: str | None = None) -> subprocess.Popen[bytes]:
    code = code or "import sys; print('no such thing', file=sys.stderr); sys.exit(7)"
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=stderr,
        bufsize=0,
    )


class TestStall:
    @pytest.mark.parametrize(("ms", "before"), [(800, False), *deep((3000, True))])
    def test_of_a_call(self, file, ms, before):
        """From the watchdog's first neutral frame on there is none of the old ones, but for that
        which was under way."""
        faults = {"stall": {"frame": 100, "ms": ms, "before": before}}
        report = played(file, Sines(60), 300, faults=faults, heartbeat_s=0.4)
        got = lines(file)
        check_order(got)
        writer = got[0].by
        first = next(place for place, line in enumerate(got) if line.by != writer)
        later = [line for line in got[first:] if not line.neutral]
        assert len(later) == before
        assert all(line.number > got[first - 1].number for line in later)
        assert all(line.number == -1 for line in got[first:] if line not in later)
        assert {line.by for line in got[-NEUTRAL_COUNT:]} >= {writer}
        assert (report.outcome, report.exit_code) == ("late", 5)
        assert report.watchdog.startswith("tripped: the writer was silent for")

    @posix
    @pytest.mark.deep
    def test_of_the_whole_writer(self, file):
        def hold(writer: int) -> None:
            os.kill(writer, signal.SIGSTOP)
            until(lambda: any(line.by != writer for line in lines(file)))
            os.kill(writer, signal.SIGCONT)

        report = played(file, hold_ms=300, heartbeat_s=0.5, meanwhile=hold)
        got = lines(file)
        writer = got[0].by
        first = next(place for place, line in enumerate(got) if line.by != writer)
        assert all(line.neutral for line in got[first:])
        assert report.exit_code == 5

    @linux
    @pytest.mark.deep
    def test_of_the_watchdog(self, file):
        """It is no watchdog any more, and does not trip when it comes back to beats that wait."""

        def hold(writer: int) -> None:
            watchdog = child(writer)
            assert watchdog is not None
            os.kill(watchdog, signal.SIGSTOP)
            until(lambda: any(line.number == -1 for line in lines(file)))
            os.kill(watchdog, signal.SIGCONT)

        report = played(file, meanwhile=hold)
        check_rest(lines(file))
        assert len({line.by for line in lines(file)}) == 1
        assert report.reason == "the watchdog ended: it is silent"


class TestBeginning:
    def test_a_device_that_cannot_be_opened(self, file):
        report = played(file, faults={"open": True})
        assert (report.outcome, report.exit_code) == ("device-lost", 6)
        assert "cannot be opened" in report.reason
        assert report.watchdog == "none"

    def test_a_device_that_cannot_be_opened_twice(self, file):
        report = played(file, faults={"open": 2})
        assert (report.outcome, report.exit_code) == ("device-lost", 6)
        assert "the watchdog cannot open the device too" in report.reason
        assert all(line.number == -1 for line in lines(file))

    @pytest.mark.deep
    def test_without_a_watchdog(self, file):
        report = played(file, faults={"open": 2}, watchdog=False)
        check_rest(lines(file))
        assert report.exit_code == 0
        assert report.watchdog == "none"

    def test_an_unknown_sink(self):
        report = play(Sines(0.1), glove(), {"kind": "telepathy"}, realtime=False)
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert "telepathy" in report.reason

    def test_a_profile_that_was_changed(self, file):
        """The writer would play by the limits of the text."""
        profile = glove()
        changed = dataclasses.replace(profile, gain=0.1)
        with pytest.raises(ParameterError, match="differs from its text"):
            play(Sines(0.1), changed, {"kind": "loopback", "file": str(file)})

    @pytest.mark.parametrize(
        ("hold_ms", "heartbeat_s"), [(20, 0.1), (50, 0.1), (51, 0.102), (1000, 2)]
    )
    def test_the_heartbeat_goes_by_the_hold_time(self, hold_ms, heartbeat_s, monkeypatch):
        """docs/safety.md: 0.1 s, and twice the hold time at least."""
        started = []

        class ToldError(Exception):
            """What the writer would be told."""

        class Player:
            def __init__(self, *_: object) -> None:
                self.target = self

            def send(self, message: bytes) -> None:
                started.append(json.loads(message[message.index(b"{") :]))
                raise ToldError

            def close(self) -> None: ...

        monkeypatch.setattr(player, "Player", Player)
        with pytest.raises(ToldError):
            play(Sines(0.1), glove(hold_ms), {"kind": "loopback"})
        assert [told["heartbeat_s"] for told in started] == [heartbeat_s]

    def test_a_heartbeat_that_is_too_short(self, file):
        with pytest.raises(ParameterError, match="heartbeat"):
            played(file, heartbeat_s=0.5)

    @pytest.mark.deep
    def test_an_error_at_once(self, file):
        report = played(file, Sines(1, fails_at=0))
        assert (report.outcome, report.exit_code) == ("failed", 2)
        assert all(line.neutral for line in lines(file))

    def test_an_hour_starts_at_once(self, file):
        keys = Pressing({0: "stop"})
        began = time.monotonic()
        report = played(file, Sines(3600), keys=keys, on_status=keys)
        assert time.monotonic() - began < 60
        assert report.exit_code == 0


class Pressing:
    """A keyboard: which key at which time of asking, once anything moves."""

    def __init__(self, keys: dict[int, Key]) -> None:
        self.keys, self.asked = keys, -1
        self.statuses: list[PlayerStatus] = []

    def __call__(self, status: PlayerStatus) -> None:
        self.statuses.append(status)

    def pressed(self) -> list[Key]:
        if not self.statuses:
            return []
        self.asked += 1
        return [self.keys[self.asked]] if self.asked in self.keys else []


class TestKeys:
    def test_pause_and_resume(self, file):
        keys = Pressing({0: "pause", 20: "pause"})
        report = played(file, Sines(0.6), keys=keys, on_status=keys)
        got = lines(file)
        check_rest(got)
        frames = check_order(got)
        resting = [line.number for line in frames if line.neutral]
        moving = [line.number for line in frames if not line.neutral]
        assert any(moving[0] < number < moving[-1] for number in resting)
        assert "paused" in {status.state for status in keys.statuses}
        # All of it is played, and what the pause took besides.
        assert report.outcome == "clean"
        assert report.sent + report.skipped > 600 + 20
        assert report.under_runs == 0

    def test_seek(self, file):
        keys = Pressing({0: "forward", 20: "back", 40: "stop"})
        report = played(file, Sines(60), keys=keys, on_status=keys)
        got = lines(file)
        check_rest(got)
        places = [status.position_s for status in keys.statuses]
        assert max(places) >= 5
        assert any(later < sooner - 4 for sooner, later in itertools.pairwise(places))
        assert report.exit_code == 0
        assert report.under_runs == 0

    @pytest.mark.deep
    def test_stop(self, file):
        keys = Pressing({5: "stop"})
        report = played(file, Sines(60), keys=keys, on_status=keys)
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("interrupted", 0)
        assert report.reason == "q was pressed"

    @pytest.mark.deep
    def test_pause_seek_stop(self, file):
        keys = Pressing({0: "pause", 10: "forward", 20: "stop"})
        report = played(file, Sines(60), keys=keys, on_status=keys)
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("interrupted", 0)


class Recorded:
    """A sink for what was sent."""

    def __init__(self, fails_at: int | None = None) -> None:
        self.frames: list[Frame] = []
        self.fails_at = fails_at

    def open(self) -> None: ...

    def close(self) -> None: ...

    def send(self, frame: Frame, reports: tuple[HidReport, ...]) -> None:
        assert reports == ()
        if len(self.frames) == self.fails_at:
            raise OSError(28, "no space left")
        self.frames.append(frame)


class TestRecord:
    def test_what_was_sent(self, file):
        record = Recorded()
        report = played(file, record=record)
        frames = [line for line in lines(file) if line.number >= 0]
        assert [frame.number for frame in record.frames] == [line.number for line in frames]
        assert [frame.counts for frame in record.frames] == [(line.counts,) for line in frames]
        assert len(record.frames) == report.sent

    @pytest.mark.deep
    def test_a_record_that_cannot_be_written(self, file):
        report = played(file, Sines(60), record=Recorded(100))
        check_rest(lines(file))
        assert (report.outcome, report.exit_code) == ("failed", 1)
        assert "no space left" in report.reason


class TestDamage:
    def test_a_damaged_file_is_played_with_ramps(self, file, tmp_path):
        """A cluster that is lost is a gap: down to rest, and up again behind it."""
        path = tmp_path / "touch.hapf"
        values = 2 + np.arange(900) / 1000
        channel = hapfmt.Channel(values, Fraction(RATE), label="thumb", unit="N")
        settings = hapfmt.Settings(cluster=Fraction(3, 10))
        hapfmt.write(hapfmt.Recording((channel,)), path, settings)
        data = bytearray(path.read_bytes())
        second = data.index(b"DATA", data.index(b"DATA") + 4)
        data[second + 40] ^= 1
        path.write_bytes(data)
        profile = glove()
        with hapfmt.Reader(path) as reader:
            renderer = Renderer(reader, profile, assign(reader, profile))
            report = played(file, renderer)
        got = lines(file)
        check_rest(got)
        frames = check_order(got)
        assert any(300 <= line.number < 600 and line.neutral for line in frames)
        moving = [line.number for line in frames if not line.neutral]
        assert moving[0] < 300 and moving[-1] > 650
        assert (report.outcome, report.exit_code) == ("clean", 3)
        assert len(report.lost) == 1
        assert report.kernels.keys() == {"thumb"}
