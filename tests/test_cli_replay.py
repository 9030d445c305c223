"""hapfmt replay without a device: what is printed, recorded, told, and how it ends."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import commands
import numpy as np
import pytest
from terminal import called

import hapfmt
from hapfmt import Calibration, Channel, Recording, Span
from hapfmt.errors import DeviceError, FormatError, MissingExtraError
from hapfmt.replay.process.loop import ReplayReport
from hapfmt.replay.profile.matching import SystemDevice
from hapfmt.replay.render import Renderer

PROFILE = """
name = "two"
gain = 0.5
[[match]]
vendor_id = 0x1209
product_id = 0xFFFE
[timing]
rate = 100
hold_ms = 1000
ramp_ms = 20
neutral_count = 2
[[actuator]]
name = "left"
unit = "N"
accepts = { N = 1 }
minimum = -5
maximum = 5
rest = 0
slew = 1e6
step = 0.01
[[actuator]]
name = "right"
unit = "N"
accepts = { N = 1 }
minimum = -1
maximum = 1
rest = 0
slew = 1e6
step = 0.01
[[report]]
path = "output"
id = 1
length = 6
fields = [
    { at = 1, counter = "u8" },
    { at = 2, actuator = "left", type = "i16" },
    { at = 4, actuator = "right", type = "i16" },
]
"""
STEP = Calibration(1, 0, 100)
SITES = {"a": "left hand", "b": "right hand"}

GOLDEN = """\
0.000000 output  01 00 32 00 ce ff
0.010000 output  01 01 64 00 9c ff
0.020000 output  01 02 64 00 9c ff
0.030000 output  01 03 64 00 9c ff
0.040000 output  01 04 32 00 ce ff
0.050000 output  01 05 00 00 00 00
0.060000 output  01 06 00 00 00 00
0.070000 output  01 07 00 00 00 00
"""
"""Four samples of 1 N and -1 N; a ramp of two samples up and down; the neutral frame twice."""


def steady(*values: int, ticks: int = 4, rate: int = 100) -> Recording:
    """Channels a of the left hand, b of the right, c, d ... of one value each, in 0.01 N."""
    return Recording(
        tuple(
            Channel(np.full(ticks, value, np.int32), Fraction(rate), calibration=STEP, label=label,
                    unit="N", body_site=SITES.get(label, ""))
            for label, value in zip("abcdef", values, strict=False)
        )
    )  # fmt: skip


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    path = tmp_path / "two.toml"
    path.write_text(PROFILE)
    return path


@pytest.fixture
def touch(tmp_path: Path) -> Path:
    path = tmp_path / "touch.hapf"
    hapfmt.write(steady(100, -100), path)
    return path


@pytest.fixture
def dry(profile: Path, touch: Path) -> Callable:
    return lambda *words, file=touch: called(
        "replay", file, "--device", profile, "--dry-run", *words
    )


def values_of(out: str) -> list[tuple[int, int]]:
    """Counts of left and right, of each packet."""
    data = [bytes.fromhex(line.split(maxsplit=2)[2]) for line in out.splitlines()]
    return [tuple(np.frombuffer(each[2:], "<i2").tolist()) for each in data]


class TestDryRun:
    def test_packets(self, dry):
        said = dry("--gain", 1)
        assert (said.code, said.out) == (0, GOLDEN)

    def test_the_plan_and_the_report_stand_on_standard_error(self, dry):
        err = dry().err
        assert "two: gain 0.5, 100 frames a second" in err
        site = "by the words of its body site, 'left hand'"
        assert f"  left <- 0 'a', {site}: -5 to 5 N, at most 1e+06 N/s" in err
        assert "  at rest: no actuator\n" in err
        assert "6 sent, 0 skipped, 2 neutral" in err

    def test_json(self, dry):
        said = dry("--gain", 1, "--json")
        assert said.code == 0 and "  left <- 0 'a', " in said.err
        *packets, report = map(json.loads, said.out.splitlines())
        assert [
            f"{packet['due_ns'] / 1e9:.6f} {packet['path']:<7} {bytes.fromhex(packet['data']).hex(' ')}"
            for packet in packets
        ] == GOLDEN.splitlines()
        assert report["profile"] == "two" and report["gain"] == 1
        assert report["channels"] == {"left": "a", "right": "b"}
        assert report["reasons"]["right"] == "by the words of its body site, 'right hand'"
        assert report["at_rest"] == []
        assert (report["outcome"], report["exit_code"], report["sent"]) == ("clean", 0, 6)
        assert report["late"] is None and report["record"] is None

    def test_the_gain_is_that_of_the_profile_unless_told(self, dry):
        assert max(values_of(dry().out)) == (50, -50)
        assert max(values_of(dry("--gain", "0.1").out)) == (10, -10)

    def test_what_is_limited_is_counted(self, dry, tmp_path):
        """PLY-008: A player MUST report what it did not play: channels that the device cannot render, lost samples, skipped frames, limited values."""
        path = tmp_path / "more.hapf"
        volts = Channel(np.zeros(4), Fraction(100), label="battery", unit="V")
        hapfmt.write(Recording((*steady(900, 100, 100).channels, volts)), path)
        words = ["--gain", 1, "--ignore", "c,battery"]
        said = dry(*words, file=path)
        assert max(values_of(said.out))[0] == 500
        assert "4 clamped, 0 slew-limited" in said.err
        assert "left out: channel 3 'battery': ignored" in said.err
        report = json.loads(dry(*words, "--json", file=path).out.splitlines()[-1])
        assert report["clamped"] == 4 and report["skipped"] == 0 and report["lost"] == []
        assert len(report["left_out"]) == 2

    def test_channels_to_actuators(self, dry):
        assert max(values_of(dry("--gain", 1, "--map", "b=left").out)) == (0, 0)
        assert min(values_of(dry("--gain", 1, "--map", "b=left").out)) == (-100, 0)
        for words in (["b=left,a=right"], ["b=1,0=2"], ["b=left", "--map", "a=right"]):
            assert (-100, 100) in values_of(dry("--gain", 1, "--map", *words).out)

    def test_a_part(self, dry):
        assert len(values_of(dry("--start", "0.01", "--stop", "0.03").out)) == 2 + 2 + 2

    def test_speed(self, dry, tmp_path):
        path = tmp_path / "long.hapf"
        hapfmt.write(steady(100, ticks=100), path)
        assert len(values_of(dry("--speed", 2, file=path).out)) == 50 + 2 + 2
        assert len(values_of(dry("--speed", "0.5", file=path).out)) == 200 + 2 + 2

    def test_loops(self, dry):
        once, twice = (values_of(dry("--gain", 1, *words).out) for words in ([], ["--loop", "2"]))
        assert len(twice) > len(once) and (0, 0) in twice[1:-3]

    @pytest.mark.skipif(sys.platform == "win32", reason="head of POSIX")
    def test_an_endless_loop_ends_with_its_reader(self, touch, profile):
        words = [
            sys.executable,
            "-W",
            "error",
            "-m",
            "hapfmt",
            "replay",
            touch,
            "--device",
            profile,
            "--dry-run",
            "--loop",
        ]
        with subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=commands.ENVIRONMENT
        ) as process:
            lines = [process.stdout.readline() for _ in range(100)]
            process.stdout.close()
            assert process.wait(60) == 1
        assert len(set(lines)) == 100

    def test_from_a_url(self, dry, touch):
        pytest.importorskip("fsspec")
        assert dry("--gain", 1, file=touch.as_uri()).out == GOLDEN

    def test_from_standard_input(self, touch, profile, tmp_path):
        done = commands.run(
            "replay",
            "-",
            "--device",
            profile,
            "--dry-run",
            "--gain",
            1,
            cwd=tmp_path,
            stdin=touch.read_bytes(),
        )
        assert (done.returncode, done.stdout.decode()) == (0, GOLDEN)


class TestRecord:
    def test_it_can_be_held_against_the_original(self, profile, tmp_path):
        """At the device's own rate and a gain of 1, all but the ramps is what was recorded."""
        rng = np.random.default_rng(1)
        counts = rng.integers(-100, 101, (2, 3000)).astype(np.int32)
        spans = (Span(0, 1000), Span(1200, 3200))
        original = Recording(
            tuple(
                Channel(row, Fraction(100), spans, calibration=STEP, label=label, unit="N", body_site=SITES[label])
                for label, row in zip("ab", counts, strict=True)
            )
        )  # fmt: skip
        hapfmt.write(original, tmp_path / "in.hapf")
        words = ["--device", profile, "--dry-run", "--gain", 1]
        out = tmp_path / "out.hapf"
        said = called("replay", tmp_path / "in.hapf", *words, "--record", out)
        assert said.code == 0 and "3202 sent" in said.out
        sent = hapfmt.read(out)
        assert [channel.label for channel in sent.channels] == ["left", "right"]
        for there, back in zip(original.channels, sent.channels, strict=True):
            assert back.coverage == (Span(0, 3202),) and back.calibration == STEP
            dense = np.nan_to_num(there.filled(0, 3202))
            differs = np.flatnonzero(dense != back.samples())
            assert set(differs.tolist()) <= {0, 1000, 1200, 3200}
            assert np.all(back.stored[1001:1200] == 0)
        told = sent.metadata["replay"]
        assert told["profile"] == "two" and told["gain"] == 1 and told["kernels"]
        assert told["channels"] == {"left": "a", "right": "b"}
        assert hapfmt.verify(out).verdict == "intact"

    def test_the_same_bytes_each_time(self, dry, tmp_path):
        for name in "xy":
            assert dry("--record", tmp_path / f"{name}.hapf").code == 0
        assert (tmp_path / "x.hapf").read_bytes() == (tmp_path / "y.hapf").read_bytes()

    def test_csv(self, dry, tmp_path):
        said = dry("--gain", 1, "--record", tmp_path / "out.csv")
        assert said.code == 0 and "6 sent" in said.out
        assert (tmp_path / "out.csv").read_text().splitlines()[1:] == [
            "t [s],left [N],right [N]",
            "0.00,0.5,-0.5",
            "0.01,1.0,-1.0",
            "0.02,1.0,-1.0",
            "0.03,1.0,-1.0",
            "0.04,0.5,-0.5",
            "0.05,0.0,0.0",
        ]

    def test_nothing_is_replaced_unless_forced(self, dry, tmp_path):
        path = tmp_path / "out.csv"
        path.write_text("mine")
        said = dry("--record", path)
        assert said.code == 1 and "already exists" in said.err and path.read_text() == "mine"
        assert dry("--record", path, "--force").code == 0
        assert path.read_text().startswith("# replay: ")

    def test_json(self, dry, tmp_path):
        report = json.loads(dry("--json", "--record", tmp_path / "out.hapf").out)
        assert report["record"] == str(tmp_path / "out.hapf") and report["sent"] == 6

    def test_a_full_disk_at_the_end_takes_no_report_away(self, dry, tmp_path, monkeypatch):
        def full(_self):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("hapfmt.replay.sinks.record.CsvRows.close", full)
        said = dry("--record", tmp_path / "out.csv")
        assert said.code == 1 and "6 sent" in said.out
        assert "record of what was sent is lost" in said.err and "No space left" in said.err
        assert not (tmp_path / "out.csv").exists()


class TestRefusals:
    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (["--gain", "0"], "gain"),
            (["--gain", "1.5"], "gain"),
            (["--loop=-1"], "-1"),
            (["--map", "zzz=left"], "zzz"),
            (["--map", "a=zzz"], "zzz"),
            (["--map", "a"], "a"),
            (["--path", "/dev/hidraw0"], "--dry-run opens none"),
            (["--speed", "0"], "speed"),
            (["--start", "3"], "no samples between"),
            (["--start", "0.03", "--stop", "0.01"], "no samples between"),
            (["--record", "out.wav"], ".hapf or .csv"),
            (["--record", "nowhere/out.hapf"], "does not exist"),
        ],
    )
    def test_of_options(self, dry, words, message, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        before = sorted(tmp_path.iterdir())
        said = dry(*words)
        assert said.code == 1 and message in said.err and said.out == ""
        assert sorted(tmp_path.iterdir()) == before

    def test_of_files(self, dry, tmp_path):
        said = dry(file=tmp_path / "none.hapf")
        assert said.code == 1 and "No such file" in said.err
        (tmp_path / "text.hapf").write_bytes(b"no hapf file at all" * 9)
        assert dry(file=tmp_path / "text.hapf").code == 2

    def test_of_profiles(self, touch):
        said = called("replay", touch, "--device", "glove99", "--dry-run")
        assert said.code == 1 and "glove99" in said.err and "glove5" in said.err
        assert called("replay", touch, "--dry-run").code == 1

    def test_channels_without_an_actuator(self, dry, tmp_path):
        """PLY-013: A player MUST refuse to play while a channel has no actuator and the user has not left it out; before anything moves it MUST print which channel drives which actuator, why, and which actuators rest."""
        path = tmp_path / "more.hapf"
        volts = Channel(np.ones(4), Fraction(100), unit="V", label="battery, main")
        hapfmt.write(Recording((*steady(100, 100, 100).channels, volts)), path)
        for words in ([], ["--map-by-order"], ["--ignore", "c"]):
            said = dry(*words, "--record", tmp_path / "out.csv", file=path)
            assert said.code == 1 and said.out == "" and not (tmp_path / "out.csv").exists()
            assert "replay does not guess: " in said.err and "its unit is V" in said.err
            assert "actuators of two: 1=left, 2=right" in said.err
        offered = re.findall(r"^  (hapfmt replay .*)", dry(file=path).err, re.MULTILINE)
        (line,) = offered
        assert line.endswith("--ignore c,3") and called(*shlex.split(line)[1:]).code == 0

    def test_the_command_lines_play_as_they_stand(self, profile, tmp_path):
        """All other options are kept: above all the gain."""
        path = tmp_path / "not 'a' thumb.hapf"
        hapfmt.write(Recording((replace(steady(100)[0], label="not left", body_site=""),)), path)
        words = ["--gain", "0.05", "--dry-run", "--map-by-order", "--ignore=0", "--stop=0.04"]
        said = called("replay", path, "--device", profile, *words[:3], *words[5:])
        lines = re.findall(r"^  (hapfmt replay .*)", said.err, re.MULTILINE)
        assert said.code == 1 and [line.split(" --")[-1] for line in lines] == [
            "map 'not left=left'", "map-by-order",
        ]  # fmt: skip
        for line in lines:
            played = called(*shlex.split(line)[1:])
            assert played.code == 0 and "two: gain 0.05" in played.err
            assert max(values_of(played.out)) == (5, 0)
        again = called("replay", path, *words, "--device", profile)
        assert again.code == 1 and "nothing to play" in again.err

    @pytest.mark.parametrize("more", ["--map-by-order", "--ignore=b"])
    def test_two_ways_to_choose(self, dry, more):
        said = dry("--map", "a=left", more)
        assert said.code == 1 and "--map names every channel to play" in said.err

    def test_a_device_is_not_touched(self, profile, tmp_path, monkeypatch):
        """The refusal comes before anything is opened or sent."""
        file = tmp_path / "device.txt"
        config = {"kind": "loopback", "file": str(file), "faults": {}}
        monkeypatch.setattr("hapfmt.cli.replay.config_of", lambda *_: config)
        hapfmt.write(steady(100, 100, 100), tmp_path / "three.hapf")
        said = called("replay", tmp_path / "three.hapf", "--device", profile)
        assert said.code == 1 and "1 of 3 channels have no actuator" in said.err
        assert "--dry-run" not in said.err and not file.exists()

    def test_no_device(self, profile, touch, monkeypatch):
        """What to do stands in the error; nothing is replaced by then."""
        monkeypatch.setattr("hapfmt.replay.sinks.hid.connected", list)
        said = called("replay", touch, "--device", profile)
        assert said.code == 1
        assert "no device that the profile two fits is connected" in said.err
        assert "hapfmt devices" in said.err and "--dry-run" in said.err

    def test_several_devices(self, profile, touch, monkeypatch):
        two = [SystemDevice(path, 0x1209, 0xFFFE) for path in (b"/dev/hidraw1", b"/dev/hidraw2")]
        monkeypatch.setattr("hapfmt.replay.sinks.hid.connected", lambda: two)
        said = called("replay", touch, "--device", profile)
        assert said.code == 1
        assert "choose one of /dev/hidraw1, /dev/hidraw2 (--path chooses one" in said.err

    def test_no_hidapi(self, profile, touch, monkeypatch):
        def missing():
            raise MissingExtraError("hidapi", "replay")

        monkeypatch.setattr("hapfmt.replay.sinks.hid.hid_module", missing)
        said = called("replay", touch, "--device", profile)
        assert said.code == 1 and said.err.endswith("pip install 'hapfmt[replay]'\n")


class TestDamage:
    def test_what_is_lost_is_a_ramp_to_rest_and_exit_code_3(self, dry, tmp_path):
        path = tmp_path / "long.hapf"
        counts = np.random.default_rng(3).integers(90, 111, 3000).astype(np.int32)
        channel = Channel(
            counts, Fraction(100), calibration=STEP, label="a", unit="N", body_site="left hand"
        )
        hapfmt.write(Recording((channel,)), path, hapfmt.Settings.of("lossless", cluster="5"))
        data = bytearray(path.read_bytes())
        with hapfmt.Reader(path) as reader:
            packets = list(reader.packets({0: (0, 1 << 40)}))
        damaged = packets[2]
        data[damaged.offset] ^= 0x5A
        path.write_bytes(data)
        said = dry("--gain", 1, file=path)
        assert said.code == 3 and "lost: a from 10 s to 15 s" in said.err
        left = np.array(values_of(said.out))[:3000, 0]
        first, last = damaged.start, damaged.start + damaged.span
        assert (first, last) == (1000, 1500)
        assert np.all(left[first + 2 : last] == 0)
        for part in (slice(2, first), slice(last + 2, None)):
            assert np.array_equal(left[part], counts[part])
        report = json.loads(dry("--json", file=path).out.splitlines()[-1])
        assert report["exit_code"] == 3 and report["outcome"] == "clean"
        assert report["lost"] == ["lost: a from 10 s to 15 s"] and report["findings"]

    def test_a_broken_rule_ends_it_by_a_ramp(self, dry, tmp_path, monkeypatch):
        """As of a packet whose checksum holds: the exit code is that of the error."""
        blocks = Renderer.blocks

        def broken(self, *given):
            for block in blocks(self, *given):
                yield block._replace(last=False)
            raise FormatError("knot ticks not increasing", requirement="KNT-003")

        monkeypatch.setattr(Renderer, "blocks", broken)
        said = dry("--gain", 1, "--record", tmp_path / "out.csv")
        assert said.code == 2 and "knot ticks not increasing [KNT-003]" in said.err
        assert "failed" in said.out
        rows = (tmp_path / "out.csv").read_text().splitlines()
        assert rows[5].endswith(",1.0,-1.0") and rows[-1].endswith(",0.0,0.0")


class TestEnds:
    """With a player that tells what it was told to tell."""

    @pytest.fixture
    def ended(self, profile, touch, monkeypatch):
        def run(report: ReplayReport | Exception, *words):
            def play(*_args: object, **_more: object) -> ReplayReport:
                if isinstance(report, Exception):
                    raise report
                return report

            monkeypatch.setattr("hapfmt.cli.replay.config_of", lambda *_: {"kind": "none"})
            monkeypatch.setattr("hapfmt.replay.process.player.play", play)
            return called("replay", touch, "--device", profile, *words)

        return run

    @pytest.mark.parametrize(
        ("report", "code"),
        [
            (ReplayReport("clean"), 0),
            (ReplayReport("clean", lost=["a: 2 s"]), 3),
            (ReplayReport("late", reason="30 ms late"), 5),
            (ReplayReport("late"), 5),
            (ReplayReport("device-lost", reason="write failed"), 6),
            (ReplayReport("interrupted", signal=2), 130),
            (ReplayReport("interrupted", signal=15), 143),
            (ReplayReport("failed", reason="bad packet", error_code=2), 2),
            (DeviceError("has gone"), 6),
        ],
    )
    def test_exit_codes(self, ended, report, code):
        said = ended(report)
        assert said.code == code
        reason = getattr(report, "reason", "") or str(getattr(report, "message", ""))
        assert reason in said.err
        if report == ReplayReport("late"):
            assert "a frame was later than the 1000 ms that the profile allows" in said.err
        if isinstance(report, ReplayReport):
            assert json.loads(ended(report, "--json").out)["exit_code"] == code
            assert re.search(rf"ended +{report.outcome}\n", said.out)

    def test_the_table(self, ended):
        times = {"p50": 1.2, "p99": 20, "p999": 300, "max": 4000}
        report = ReplayReport(
            "clean", sent=7, skipped=1, neutral=5, clamped=2, slew_limited=3, under_runs=4, gap_samples=6,
            refused=8, late=times, call=times, realtime={"scheduler": "SCHED_FIFO 50"},
            kernels={"left": "held"}, watchdog="stood by",
        )  # fmt: skip
        out = ended(report).out
        for text in (
            "7 sent, 1 skipped, 5 neutral", "p50 1 us, p99 20 us, p99.9 300 us, max 4000 us",
            "2 clamped, 3 slew-limited", "6 in gaps or between loops, 8 not finite", "under-runs ", "held: left",
            "SCHED_FIFO 50", "stood by",
        ):  # fmt: skip
            assert text in out


@pytest.mark.realtime
class TestLoopback:
    """The whole way through player, writer and watchdog, to a device that is a file."""

    @pytest.fixture
    def played(self, profile, tmp_path, monkeypatch):
        file = tmp_path / "device.txt"

        def run(*words, source=tmp_path / "touch.hapf", **faults):
            config = {"kind": "loopback", "file": str(file), "faults": faults}
            monkeypatch.setattr("hapfmt.cli.replay.config_of", lambda *_: config)
            said = called("replay", source, "--device", profile, "--gain", 1, *words)
            lines = file.read_text().splitlines() if file.exists() else []
            return said, [report for line in lines for report in json.loads(line)["reports"]]

        return run

    def test_the_packets_of_the_dry_run(self, played, profile, tmp_path):
        """At ten frames a second: a busy machine is no reason to skip one."""
        profile.write_text(
            PROFILE.replace("rate = 100", "rate = 10").replace("_ms = 20", "_ms = 200")
        )
        path = tmp_path / "slow.hapf"
        hapfmt.write(steady(100, -100, rate=10), path)
        said, reports = played("--json", "--record", tmp_path / "out.hapf", source=path)
        told = json.loads(said.out)
        assert (said.code, told["outcome"], told["skipped"]) == (0, "clean", 0), said.err
        assert [data for _, data in reports] == [
            line.split(maxsplit=2)[2].replace(" ", "") for line in GOLDEN.splitlines()
        ]
        assert told["sent"] == 6 and told["late"]["p50"] <= told["late"]["max"] < 100_000
        left, right = hapfmt.read(tmp_path / "out.hapf").channels
        assert left.stored.tolist() == [50, 100, 100, 100, 50, 0]
        assert right.stored.tolist() == [-50, -100, -100, -100, -50, 0]

    def test_the_table(self, played, touch):
        said, _ = played(source=touch)
        assert said.code == 0
        for text in ("late", "p99.9", "scheduler", "watchdog", "stood by"):
            assert text in said.out

    def test_a_device_that_goes(self, played, tmp_path):
        path = tmp_path / "long.hapf"
        hapfmt.write(steady(100, ticks=300), path)
        said, reports = played("--record", tmp_path / "out.csv", source=path, gone=20)
        assert said.code == 6 and "has gone" in said.err and len(reports) == 20
        assert len((tmp_path / "out.csv").read_text().splitlines()) == 2 + 20


@pytest.mark.skipif(sys.platform == "win32", reason="terminals and signals of POSIX")
@pytest.mark.realtime
class TestTerminal:
    """Progress, keys and signals, while a recording of a minute plays."""

    @pytest.fixture
    def playing(self, profile, tmp_path):
        path = tmp_path / "long.hapf"
        hapfmt.write(steady(100, ticks=6000), path)
        config = {"kind": "loopback", "file": str(tmp_path / "device.txt")}
        words = ["hapfmt", "replay", str(path), "--device", str(profile), "--gain", "1"]
        code = (
            f"import sys; sys.argv = {words!r}; import hapfmt.cli.replay as verb; "
            f"verb.config_of = lambda *_: {config!r}; from hapfmt.cli import main; main()"
        )
        master, slave = os.openpty()
        with subprocess.Popen(
            [sys.executable, "-W", "error", "-c", code],
            stdin=slave, stdout=subprocess.PIPE, stderr=slave, env=commands.ENVIRONMENT,
        ) as process:  # fmt: skip
            os.close(slave)
            try:
                seen = b""
                while b"playing " not in seen:
                    seen += os.read(master, 1 << 12)
                yield process, master
            finally:
                process.kill()
                os.close(master)

    @staticmethod
    def ended(process, master) -> str:
        """What it says, on the terminal and in the table."""
        seen = b""
        while True:
            try:
                data = os.read(master, 1 << 12)
            except OSError:  # the other side has gone
                break
            if not data:
                break
            seen += data
        out = process.stdout.read()
        process.wait(60)
        return seen.decode() + out.decode()

    @staticmethod
    def last_counts(folder: Path) -> list[str]:
        lines = (folder / "device.txt").read_text().splitlines()[-3:]
        return [json.loads(line)["reports"][0][1][4:] for line in lines]

    def test_q_ends_it_by_a_ramp(self, playing, tmp_path):
        process, master = playing
        os.write(master, b"  q")
        said = self.ended(process, master)
        assert process.returncode == 0 and "q was pressed" in said
        assert re.search(r"ended +interrupted", said)
        assert self.last_counts(tmp_path) == ["00000000"] * 3

    @pytest.mark.parametrize(
        "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.deep)]
    )
    def test_signals(self, playing, tmp_path, number):
        process, master = playing
        process.send_signal(number)
        said = self.ended(process, master)
        assert process.returncode == 128 + number and f"signal {int(number)}" in said
        assert self.last_counts(tmp_path) == ["00000000"] * 3
