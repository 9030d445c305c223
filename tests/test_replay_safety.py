"""A replay against what can befall it: stopped and killed processes, hostile values, slow files, full
disks. Whole processes, a loopback for the device; judged by what the device got, and by that alone."""

from __future__ import annotations

import json
import os
import re
import signal
import struct
import subprocess
import sys
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from replay_scenes import profile_of
from spec import ROOT

from hapfmt.replay.process import watchdog
from hapfmt.replay.process.children import clock
from hapfmt.replay.process.loop import FrameLoop
from hapfmt.replay.process.pipes import Kind, Message
from hapfmt.replay.process.watchdog import Guard
from hapfmt.replay.profile.model import FrameBlock, Profile

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="signals that stop a process"),
    pytest.mark.realtime,
]

SECONDS = 60.0
"""In which everything ends."""
QUICK_S = 0.6
"""Of silence, after which the watchdog of a quick replay trips: twice its hold time."""


def deep(value: Any) -> Any:
    return pytest.param(value, marks=pytest.mark.deep)


def patient(hold_ms: int = 1000) -> str:
    """glove5, which here may be later than it should: busy machines are no fault of ours."""
    return glove(hold_ms=str(hold_ms))


class Got(NamedTuple):
    """A frame as the device has it."""

    by: int
    at_s: float
    number: int
    due_s: float
    samples: tuple[tuple[int, ...], ...]
    data: bytes


class Replay:
    """A player of a scene in a process of its own; the log is the device."""

    def __init__(self, folder: Path, **given: Any) -> None:
        self.log = folder / "device.jsonl"
        self.given: dict[str, Any] = {
            "profile": patient(), "scene": "push", "seconds": 1.0, "log": str(self.log), **given
        }  # fmt: skip
        self.profile: Profile = profile_of(self.given["profile"])
        self.process = subprocess.Popen(
            [sys.executable, str(ROOT / "tests" / "replay_scenes.py"), json.dumps(self.given)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True,
        )  # fmt: skip

    def __enter__(self) -> Replay:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def end(self, seconds: float = SECONDS) -> dict[str, Any]:
        """Its report."""
        out, errors = self.process.communicate(timeout=seconds)
        assert out, errors
        found: dict[str, Any] = json.loads(out.splitlines()[-1])
        assert self.process.returncode == found["exit_code"], errors
        return found

    def lines(self) -> list[str]:
        """Those of the log that are whole."""
        return self.log.read_text("ascii").split("\n")[:-1] if self.log.exists() else []

    def frames(self) -> list[Got]:
        """All that came so far, as plain 16-bit fields from byte 2 on."""
        found = []
        width = len(self.profile.actuators)
        for line in self.lines():
            each = json.loads(line)
            for _, data in each["reports"]:
                raw = bytes.fromhex(data)
                counts = struct.unpack_from(
                    f"<{width * self.profile.timing.frame_samples}h", raw, 2
                )
                rows = tuple(
                    counts[i : i + width] for i in range(0, len(counts), width)
                )  # fmt: skip
                found.append(
                    Got(
                        each["by"],
                        each["at_ns"] / 1e9,
                        each["number"],
                        each["due_ns"] / 1e9,
                        rows,
                        raw,
                    )
                )
        return found

    def wait_for(self, count: int) -> list[Got]:
        """Until the device has so many frames."""
        end = time.monotonic() + SECONDS
        while len(self.lines()) < count or len(found := self.frames()) < count:
            assert time.monotonic() < end and self.process.poll() is None, self.process.poll()
            time.sleep(0.005)
        return found

    def pid(self, name: str) -> int:
        """Of writer or watchdog."""
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            for pid in descendants(self.process.pid):
                if f"process.{name}" in command(pid):
                    return pid
            time.sleep(0.005)
        raise AssertionError(f"no {name}")

    # -- what a device may be given

    def judge(self) -> list[Got]:
        """Within limits and slew from one frame to the next; in order; at rest at the end."""
        frames = self.frames()
        limits = [self.profile.limits(actuator) for actuator in self.profile.actuators]
        rest = tuple(limit.rest for limit in limits)
        before = rest
        for frame in frames:
            for sample in frame.samples:
                for count, last, limit in zip(sample, before, limits, strict=True):
                    assert limit.low <= count <= limit.high, frame
                    assert abs(count - last) <= limit.change, (frame, last)
                before = sample
        numbers = [frame.number for frame in frames if frame.number >= 0]
        assert all(a < b for a, b in pairwise(numbers)), "order"
        self.judge_end(frames)
        return frames

    def judge_end(self, frames: list[Got]) -> None:
        count = self.profile.timing.neutral_count
        rest = tuple(self.profile.limits(actuator).rest for actuator in self.profile.actuators)
        assert len(frames) >= count
        assert all(set(frame.samples) == {rest} for frame in frames[-count:])


def command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")
    except OSError:
        return ""


def descendants(pid: int) -> list[int]:
    found = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = [int(word) for word in path.read_text("ascii").split()]
        except OSError:
            continue
        for child in children:
            found += [child, *descendants(child)]
    return found


needs_proc = pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="finds processes by /proc (Linux)"
)


def toml(text: str, **changes: str) -> str:
    """A profile with other values for some keys, wherever they stand."""
    for key, value in changes.items():
        text, found = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        assert found, key
    return text


def glove(**changes: str) -> str:
    return toml(profile_of("glove5").text, **changes)


class TestHostileValues:
    @pytest.mark.parametrize("gain", [deep(0.5), 1.0])
    @pytest.mark.parametrize(
        "scene", ["nonsense", *map(deep, ("push", "flips", "slow_flips", "flickers"))]
    )
    def test_the_device_never_sees_them(self, tmp_path, scene, gain):
        with Replay(tmp_path, scene=scene, options={"gain": gain}) as replay:
            report = replay.end()
            frames = replay.judge()
        assert report["outcome"] == "clean"
        highest = max(abs(count) for frame in frames for count in frame.samples[0])
        assert 0 < highest <= 5000 * gain

    def test_a_rest_elsewhere_and_a_slow_slew(self, tmp_path):
        """The way back takes longer than the ramp: the neutral frame waits for it."""
        profile = glove(rest="-1.5", slew="5", ramp_ms="10", hold_ms="1000")
        with Replay(tmp_path, profile=profile, seconds=0.5) as replay:
            report = replay.end()
            frames = replay.judge()
        assert report["outcome"] == "clean" and report["slew_limited"] > 0
        assert max(frame.samples[0][0] for frame in frames) > -100

    @pytest.mark.deep
    def test_a_slow_slew_and_a_signal(self, tmp_path):
        profile = glove(slew="3", ramp_ms="2", hold_ms="1000")
        with Replay(tmp_path, profile=profile, seconds=20) as replay:
            replay.wait_for(1000)
            replay.process.terminate()
            report = replay.end()
            replay.judge()
        assert (report["outcome"], report["exit_code"]) == ("interrupted", 128 + 15)

    @pytest.mark.deep
    def test_hundreds_of_actuators(self, tmp_path):
        report = {"fields": [], "actuators": []}
        for n in range(256):
            report["actuators"].append(
                f'[[actuator]]\nname = "a{n}"\nunit = "N"\nminimum = -3\nmaximum = 3\n'
                "rest = 0\nslew = 300\nstep = 0.001\n"
            )
            report["fields"].append(f'{{at = {2 + 2 * n}, actuator = "a{n}", type = "i16"}}')
        profile = (
            'name = "many"\n[timing]\nrate = 250\nhold_ms = 1000\n'
            + "\n".join(report["actuators"])
            + '[[report]]\npath = "output"\nid = 1\nlength = 514\nfields = ['
            + ", ".join(['{at = 1, counter = "u8"}', *report["fields"]])
            + "]\n"
        )
        with Replay(tmp_path, profile=profile, scene="flickers") as replay:
            report = replay.end()
            replay.judge()
        assert report["outcome"] == "clean"

    @pytest.mark.deep
    def test_keys_pressed_in_any_order(self, tmp_path):
        """Pauses and seeks on top of one another, at full force."""
        keys = ["pause", "pause", "forward", "back", "pause", "back", "pause", "forward", "back"]
        script = [[(0, 0.04, 0.2)[n % 3], key] for n, key in enumerate(keys * 4)]
        script.append([0.5, "stop"])
        with Replay(tmp_path, scene="slow_flips", seconds=60, keys=script) as replay:
            report = replay.end()
            frames = replay.judge()
        assert (report["outcome"], report["exit_code"]) == ("interrupted", 0)
        # Frames at rest lie between the pieces.
        quiet = [not any(frame.samples[0]) for frame in frames]
        assert sum(a and not b for a, b in pairwise(quiet)) > 8


class TestSources:
    @pytest.mark.deep
    def test_a_file_that_is_too_slow(self, tmp_path):
        """Values that come too late are not played late."""
        with Replay(tmp_path, seconds=1.5, source={"slow": 1.7}) as replay:
            report = replay.end()
            replay.judge()
        assert report["under_runs"] > 0

    def test_a_file_that_hangs(self, tmp_path):
        """The device rests while nothing comes, and a signal still ends it."""
        source = {"fault": "hangs", "fault_s": 0.5}
        with Replay(tmp_path, seconds=60, source=source) as replay:
            count = len(replay.wait_for(600))
            while any(replay.frames()[-1].samples[0]):
                count = len(replay.wait_for(count + 1))
            replay.process.send_signal(signal.SIGINT)
            report = replay.end()
            replay.judge()
        assert report["exit_code"] == 128 + 2 and report["watchdog"] == "stood by"

    @pytest.mark.deep
    def test_a_file_that_hangs_at_once(self, tmp_path):
        with Replay(tmp_path, seconds=60, source={"fault": "hangs"}) as replay:
            replay.pid("watchdog")
            time.sleep(1.0)
            replay.process.send_signal(signal.SIGINT)
            assert replay.end()["exit_code"] == 128 + 2
            replay.judge()

    @pytest.mark.deep
    def test_a_file_that_fails(self, tmp_path):
        source = {"fault": "raises", "fault_s": 0.5}
        with Replay(tmp_path, seconds=60, source=source) as replay:
            report = replay.end()
            replay.judge()
        assert report["outcome"] == "failed" and "disk has failed" in report["reason"]

    def test_a_disk_that_is_full(self, tmp_path):
        with Replay(tmp_path, seconds=60, disk=300) as replay:
            report = replay.end()
            replay.judge()
        assert (report["outcome"], report["exit_code"]) == ("failed", 1)
        assert "No space left" in report["reason"]

    @pytest.mark.deep
    def test_a_terminal_that_takes_nothing(self, tmp_path):
        """The player stands in a call: the writer plays what it has, and rests."""
        with Replay(tmp_path, seconds=60, block_s=5.0) as replay:
            report = replay.end()
            frames = replay.judge()
        assert report["outcome"] == "failed" and "silent" in report["reason"]
        assert frames[-1].at_s - frames[0].at_s < 4.5


@needs_proc
class TestStoppedAndKilled:
    """SIGSTOP is what swapping, a debugger, a suspended machine and a busy one look like."""

    def force(self, replay: Replay) -> None:
        """Until a force stands."""
        replay.wait_for(300)

    def quick(self, folder: Path) -> Replay:
        """That is long, and whose watchdog trips after QUICK_S."""
        return Replay(folder, profile=patient(300), seconds=60)

    def test_the_writer_is_stopped_for_long(self, tmp_path):
        with self.quick(tmp_path) as replay:
            self.force(replay)
            writer, watchdog = replay.pid("writer"), replay.pid("watchdog")
            os.kill(writer, signal.SIGSTOP)
            stopped_s = time.monotonic()
            wait_until(lambda: any(frame.by == watchdog for frame in replay.frames()))
            time.sleep(0.5)
            asleep = replay.frames()
            os.kill(writer, signal.SIGCONT)
            report = replay.end()
            frames = replay.frames()
        first = next(frame for frame in asleep if frame.by == watchdog)
        assert 0 < first.at_s - stopped_s < QUICK_S + 0.1
        assert not any(asleep[-1].samples[0])
        replay.judge_end(frames)
        # No more than the one frame that may have been under way follows the neutral ones.
        after = [frame for frame in frames[len(asleep) :] if any(frame.samples[0])]
        assert len(after) <= 1
        assert report["outcome"] == "late" and "tripped" in report["watchdog"]

    @pytest.mark.deep
    def test_the_writer_is_stopped_for_longer_than_its_watchdog_lives(self, tmp_path):
        with self.quick(tmp_path) as replay:
            self.force(replay)
            writer, watchdog = replay.pid("writer"), replay.pid("watchdog")
            os.kill(writer, signal.SIGSTOP)
            report = replay.end()
            frames = replay.frames()
            assert not command(writer) and not command(watchdog)
        replay.judge_end(frames)
        assert report["exit_code"] not in (0, None)

    @pytest.mark.deep
    def test_the_writer_is_stopped_again_and_again(self, tmp_path):
        """Around the time after which the watchdog trips: force and rest never alternate."""
        with self.quick(tmp_path) as replay:
            self.force(replay)
            writer, watchdog = replay.pid("writer"), replay.pid("watchdog")
            try:
                for ms in (-595, -5, -2, -1, 0, 1, 2, 5):
                    os.kill(writer, signal.SIGSTOP)
                    time.sleep(QUICK_S + ms / 1000)
                    os.kill(writer, signal.SIGCONT)
                    time.sleep(0.002)
            except ProcessLookupError:
                pass
            replay.end()
            frames = replay.frames()
        replay.judge_end(frames)
        tripped = next((n for n, f in enumerate(frames) if f.by == watchdog), len(frames))
        assert sum(any(frame.samples[0]) for frame in frames[tripped:]) <= 1

    def test_the_watchdog_is_stopped(self, tmp_path):
        """It finds the beats that came meanwhile, and does not take them for silence."""
        with self.quick(tmp_path) as replay:
            self.force(replay)
            watchdog = replay.pid("watchdog")
            for _ in range(3):
                os.kill(watchdog, signal.SIGSTOP)
                time.sleep(QUICK_S + 0.1)
                os.kill(watchdog, signal.SIGCONT)
                time.sleep(0.02)
            replay.process.terminate()
            report = replay.end()
            frames = replay.judge()
        assert (report["outcome"], report["watchdog"]) == ("interrupted", "stood by")
        assert not [frame for frame in frames if frame.by == watchdog]

    @pytest.mark.deep
    def test_the_watchdog_never_comes_back(self, tmp_path):
        with Replay(tmp_path, seconds=60) as replay:
            self.force(replay)
            watchdog = replay.pid("watchdog")
            os.kill(watchdog, signal.SIGSTOP)
            report = replay.end()
            replay.judge()
            assert not command(watchdog)
        assert report["outcome"] == "failed" and "silent" in report["watchdog"]

    @pytest.mark.deep
    def test_the_watchdog_is_killed(self, tmp_path):
        with Replay(tmp_path, seconds=60) as replay:
            self.force(replay)
            os.kill(replay.pid("watchdog"), signal.SIGKILL)
            report = replay.end()
            replay.judge()
        assert report["outcome"] == "failed" and "died" in report["watchdog"]

    @pytest.mark.deep
    def test_the_player_is_stopped(self, tmp_path):
        """As by Ctrl-Z: what was ahead is played, then the device rests."""
        with Replay(tmp_path, seconds=60) as replay:
            self.force(replay)
            writer = replay.pid("writer")
            os.kill(replay.process.pid, signal.SIGSTOP)
            stopped_s = time.monotonic()
            wait_until(lambda: not command(writer) or state(writer) == "Z")
            frames = replay.judge()
            os.kill(replay.process.pid, signal.SIGCONT)
            report = replay.end()
        assert report["outcome"] == "failed"
        loud = [frame.at_s for frame in frames if any(frame.samples[0])]
        assert loud[-1] - stopped_s < 2.0

    def test_all_of_a_terminal_is_killed(self, tmp_path):
        """By a key that ends its foreground processes, or a job that is thrown out: the others are
        not among them."""
        with Replay(tmp_path, seconds=60) as replay:
            self.force(replay)
            writer, watchdog = replay.pid("writer"), replay.pid("watchdog")
            os.killpg(replay.process.pid, signal.SIGKILL)
            wait_until(lambda: not command(writer) and not command(watchdog))
            frames = replay.judge()
        assert {frame.by for frame in frames} == {writer}

    @pytest.mark.parametrize("both", [deep(False), True])
    def test_the_player_is_killed(self, tmp_path, both):
        """Alone: a ramp. With the writer: the watchdog's neutral frames."""
        with Replay(tmp_path, seconds=60) as replay:
            self.force(replay)
            writer, watchdog = replay.pid("writer"), replay.pid("watchdog")
            replay.process.kill()
            if both:
                os.kill(writer, signal.SIGKILL)
            killed_s = time.monotonic()
            wait_until(lambda: not command(writer) and not command(watchdog))
            frames = replay.frames()
            if not both:
                replay.judge()
        replay.judge_end(frames)
        loud = [frame.at_s for frame in frames if any(frame.samples[0])]
        assert loud[-1] - killed_s < (0.02 if both else 0.3)

    def test_the_writer_is_killed(self, tmp_path):
        with Replay(tmp_path, seconds=60) as replay:
            self.force(replay)
            writer, watchdog = replay.pid("writer"), replay.pid("watchdog")
            os.kill(writer, signal.SIGKILL)
            report = replay.end()
            frames = replay.frames()
        replay.judge_end(frames)
        assert {frame.by for frame in frames[-5:]} == {watchdog}
        assert report["outcome"] == "failed" and "tripped" in report["watchdog"]
        assert "signal 9" in report["reason"]

    @pytest.mark.parametrize("stopped_s", [1.5, deep(4.0)])
    def test_everything_is_stopped(self, tmp_path, stopped_s):
        """As a suspended machine that goes on: the old force does not come back."""
        with self.quick(tmp_path) as replay:
            self.force(replay)
            pids = [replay.process.pid, replay.pid("writer"), replay.pid("watchdog")]
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            time.sleep(stopped_s)
            asleep = len(replay.frames())
            for pid in pids:
                os.kill(pid, signal.SIGCONT)
            report = replay.end()
            frames = replay.frames()
        replay.judge_end(frames)
        assert report["exit_code"] == 5
        assert sum(any(frame.samples[0]) for frame in frames[asleep:]) <= 1

    @pytest.mark.parametrize("number", [signal.SIGTERM, deep(signal.SIGINT), deep(signal.SIGHUP)])
    def test_signals_for_each_process(self, tmp_path, number):
        """Sent to any of the three, twice: a ramp all the same."""
        for name in ("", "writer", "watchdog"):
            folder = tmp_path / (name or "player")
            folder.mkdir()
            with Replay(folder, seconds=60) as replay:
                self.force(replay)
                pid = replay.pid(name) if name else replay.process.pid
                os.kill(pid, number)
                time.sleep(0.005)
                with suppress(ProcessLookupError):
                    os.kill(pid, number)
                report = replay.end()
                replay.judge()
            assert (report["outcome"], report["exit_code"]) == ("interrupted", 128 + number), name


class Silence:
    """The end of a pipe from which nothing comes, and that takes all."""

    ended = broken = False

    def take(self) -> Message | None:
        return None

    def send(self, _: bytes) -> None: ...


class TestTripped:
    """Nothing but neutral frames follows what the watchdog says, in time or not."""

    def test_between_making_a_frame_and_sending_it(self):
        profile = profile_of(patient())

        class Device:
            forces = others = 0

            def send(self, frame, _):
                self.forces += bool(frame.counts)
                self.others += not frame.counts

        class Tripping:
            ended = tripped = False
            asked, state = None, ""

            def due(self, _):
                return False

            def beat(self, _): ...

            def listen(self, _):
                self.tripped = device.forces >= 100

            def left_alone(self, _):
                return self.tripped

        device: Any = Device()
        loop = FrameLoop(profile, 1.0, device, Silence(), Silence(), [], log=False)
        loop.guard, loop.begun = Tripping(), True
        values = np.full((1000, 5), 3.0)
        loop.schedule.feed(FrameBlock(0, values, values > 0, 0, True))
        loop.run()
        assert (device.forces, device.others) == (100, profile.timing.neutral_count)
        assert loop.report()["outcome"] == "late"

    def test_while_the_heart_beats(self):
        """It may trip for a cause of its own: a pipe that is full, a clock that jumps."""
        guard = Guard.__new__(Guard)
        source: Any = Silence()
        guard.source = guard.target = source
        guard.beat_ns = guard.heard_ns = clock()
        guard.heartbeat_ns, guard.tripped, guard.ended = 10**11, False, False
        assert not guard.left_alone(clock())
        said = [Message(Kind.TRIPPED, b'{"cause": "any"}')]
        source.take = lambda: said.pop() if said else None
        guard.listen(clock())
        guard.beat(clock())
        assert guard.left_alone(clock())


class TestWatchdogClock:
    def test_beats_that_came_while_it_did_not_run(self, monkeypatch):
        """It loses the processor between looking into the pipe and at the clock, and takes what came
        meanwhile for no silence."""
        clock = [0.0]

        class Source:
            ended = False
            looks = 0

            def __init__(self):
                self.said: list[Message] = []

            def take(self):
                if self.said:
                    return self.said.pop()
                self.looks += 1
                clock[0] += 0.5
                self.said = [Message(Kind.BEAT if self.looks < 20 else Kind.GOODBYE, b"")]
                return None

            def wait(self, seconds): ...

        class Nothing:
            def send(self, *_): ...

        monkeypatch.setattr(watchdog, "seconds", lambda: clock[0])
        setup = watchdog.WatchdogSetup({}, (), 0.1, 0.001, False)
        watched = watchdog.Watchdog(setup, Nothing(), Source(), Nothing(), [])
        assert watched.watch() == ""


def state(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return ""


def wait_until(condition: Any) -> None:
    end = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)
