"""Every end of a replay, as a device sees it that hapfmt cannot tell from a real one.

How it ends for the device, by what ended it:

* a signal, an error of the file or of ours, frames that are too late, the death of the player or of
  the watchdog: the whole ramp from the last force, then the neutral frames;
* the death of the writer, or a writer that hangs: neutral frames of the watchdog, without a ramp;
* a device that refuses a report once: the ramp and the neutral frames all the same;
* a device that refuses all: nothing any more can be seen. What was tried can;
* a device that has gone: nothing is tried after the write that failed.
"""

from __future__ import annotations

import errno
import signal
import sys
from fractions import Fraction
from functools import partial

import pytest
import replay_device as rd
from depth import either
from spec import ROOT
from virtual_hid.descriptors import glove
from virtual_hid.model import Fault
from virtual_hid.world import world as any_world

world = partial(any_world, tier="fuse")
"""Which process writes, and when it closes the device, is told by FUSE alone."""
pytestmark = [pytest.mark.usefixtures("hidapi"), pytest.mark.realtime]

HOLD_MS = 300
TRIP_S = 0.6
"""Of silence, after which the watchdog acts (docs/safety.md): twice the hold time."""
KILLED_S = 0.5
"""After the death of the writer, in which a busy machine may be late: measured, 3 to 11 ms."""
MARGIN_S = 0.4


@pytest.fixture(scope="module")
def constant(tmp_path_factory):
    return rd.constant(tmp_path_factory.mktemp("constant") / "constant.hapf")


SIGNALS = [signal.Signals[x] for x in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, x)]


@either("signals", SIGNALS[1:2], deep=SIGNALS)
def test_signals(tmp_path, constant, signals):
    """PLY-007: However it ends, as far as it still runs, a player MUST send the neutral frame last, several times. It does not write to a device again once a write failed because the device is gone."""
    devices = [(glove(serial=f"SN{number}"), ()) for number in signals]
    with world(devices=devices) as w:
        running = rd.together(w, constant, rd.patient(tmp_path))
        for each, device, number in zip(running, w.devices, signals, strict=True):
            device.wait_for(rd.steady(200))
            each.signal(number)
        for each, device, number in zip(running, w.devices, signals, strict=True):
            done = each.wait()
            report = rd.told(done)
            assert done.returncode == 128 + number
            assert (report["outcome"], report["signal"]) == ("interrupted", number)
            rd.check_constant(device.reports)
        assert rd.alone(w)


@pytest.fixture(scope="module", autouse=True)
def patience(request, tmp_path_factory, constant):
    """Devices that stall for seconds, while all other tests run: for 3 s, and for good."""
    wanted = [x for x in request.session.items if x.parent.name == "TestPatience"]
    if all(x.get_closest_marker("skip") for x in wanted):
        yield None
        return
    profile = rd.patient(tmp_path_factory.mktemp("patience"), hold_ms=HOLD_MS)
    stalls = [Fault("stall", at=60, ms=3000)], [Fault("stall", at=60, ms=60_000)]
    devices = [(glove(serial=f"SN{number}"), faults) for number, faults in enumerate(stalls)]
    with world(devices=devices) as w:
        yield w, rd.together(w, constant, profile)


class TestDevice:
    @pytest.mark.deep
    def test_it_refuses_one_report(self, tmp_path, constant):
        with world(faults=[Fault("error", at=300, count=1)]) as w:
            report = rd.told(rd.replay(w, constant, profile=rd.patient(tmp_path)).wait())
            assert (report["outcome"], report["exit_code"]) == ("device-lost", 6)
            counts = rd.counts_of(w.reports)
            rd.check_steps(counts)
            assert counts[300:] == rd.rested()
            refused = [x for x in w.events if x.error]
            assert [x.error for x in refused] == [errno.EIO]
            assert rd.Report.of(refused[0].data).counts == rd.LEVELS

    @pytest.mark.deep
    def test_it_refuses_all(self, tmp_path, constant):
        """What it took last is the force before; what was tried last is the neutral frame."""
        with world(faults=[Fault("error", at=300)]) as w:
            report = rd.told(rd.replay(w, constant, profile=rd.patient(tmp_path)).wait())
            assert (report["outcome"], report["exit_code"]) == ("device-lost", 6)
            assert len(w.reports) == 300
            refused = [x for x in w.events if x.error == errno.EIO]
            tried = rd.counts_of(refused)
            assert tried[:2] == [rd.LEVELS, rd.fall()[0]]
            assert 2 + rd.NEUTRAL <= len(tried) <= 2 + 500 / 20 + 1
            assert all(map(rd.is_neutral, refused[2:]))
            assert report["neutral"] == 0
            assert rd.alone(w)

    def test_it_goes(self, tmp_path, constant):
        """
        PLY-007: However it ends, as far as it still runs, a player MUST send the neutral frame last, several times. It does not write to a device again once a write failed because the device is gone.
        """
        with world(faults=[Fault("unplug", at=300)]) as w:
            done = rd.replay(w, constant, profile=rd.patient(tmp_path)).wait()
            report = rd.told(done)
            assert (report["outcome"], done.returncode) == ("device-lost", 6)
            assert len(w.reports) == 300
            assert [x.error for x in w.events if x.error] == [errno.ENODEV]
            assert [x.op for x in w.events].count("close") == 2
            assert rd.alone(w)

    @pytest.mark.deep
    def test_it_is_not_there(self, constant):
        with world() as w:
            w.device.unplug()
            done = rd.replay(w, constant).wait()
            assert done.returncode == 1
            assert "glove5" in done.stderr
            assert not w.events

    @pytest.mark.deep
    def test_it_stalls_for_less_than_the_hold(self, tmp_path, constant):
        """The time goes on: frames are left out, none comes twice, none in a burst."""
        with world(faults=[Fault("stall", at=300, ms=30)]) as w:
            profile = rd.patient(tmp_path)
            report = rd.clean(rd.replay(w, constant, "--stop", "1", profile=profile).wait())
            assert report["skipped"] >= 25
            rd.check_sent(report, 1000 + rd.RAMP)
            rd.check_constant(w.reports)

    def test_it_stalls_for_longer_than_the_hold(self, tmp_path, constant):
        """PLY-005: A player MUST NOT send a frame before its time, twice, or out of order; it skips a frame that is a period late or more and sends the one that is due. If it comes later to a frame than the profile allows, it ramps to rest and stops."""
        with world(faults=[Fault("stall", at=60, ms=HOLD_MS + 30)]) as w:
            profile = rd.patient(tmp_path, hold_ms=HOLD_MS)
            report = rd.told(rd.replay(w, constant, profile=profile).wait())
            assert (report["outcome"], report["exit_code"]) == ("late", 5)
            assert report["late"]["max"] >= 1000 * (HOLD_MS + 29)
            assert report["watchdog"] == "stood by"
            rd.check_constant(w.reports)
            assert rd.counts_of(w.reports)[61:] == rd.rested()

    @pytest.mark.deep
    def test_it_is_slow(self, tmp_path, constant):
        """2 ms for each report: every second frame is left out, and the end is as it should be."""
        with world(slow_ms=2) as w:
            report = rd.clean(
                rd.replay(w, constant, "--stop", "0.5", profile=rd.patient(tmp_path)).wait()
            )
            assert 0.4 < report["skipped"] / (report["sent"] + report["skipped"]) < 0.8
            rd.check_constant(w.reports)


class TestProcesses:
    def test_the_writer_is_killed(self, tmp_path, constant):
        """Which can send nothing any more: the watchdog does, through its own handle."""
        with world() as w:
            running = rd.replay(w, constant, profile=rd.patient(tmp_path))
            writer, watchdog = rd.pid_of(w, "writer"), rd.pid_of(w, "watchdog")
            w.device.wait_for(rd.steady(200))
            w.signal(writer, signal.SIGKILL)
            done = running.wait()
            report = rd.told(done)
            assert (report["outcome"], done.returncode) == ("failed", 1)
            assert report["watchdog"].startswith("tripped: the writer has died")
            before = [x for x in w.reports if x.pid == writer]
            after = [x for x in w.reports if x.pid == watchdog]
            assert rd.Report.of(before[-1].data).counts == rd.LEVELS
            assert len(after) >= rd.NEUTRAL
            assert w.reports == before + after
            assert all(map(rd.is_neutral, after))
            assert (after[0].time_ns - before[-1].time_ns) / 1e9 < KILLED_S
            assert rd.alone(w)

    @pytest.mark.deep
    def test_the_writer_stands_still_in_a_call(self, tmp_path, constant):
        """The watchdog acts after its time. The frame that the writer was in comes late, and is
        followed by nothing but neutral ones."""
        with world(faults=[Fault("handle-stall", at=60, ms=1500)]) as w:
            done = rd.replay(w, constant, profile=rd.patient(tmp_path, hold_ms=HOLD_MS)).wait()
            report = rd.told(done)
            assert (report["outcome"], done.returncode) == ("late", 5)
            assert "tripped: the writer was silent" in report["watchdog"]
            reports = w.reports
            (stale,) = [x for x in reports if x.time_ns - x.asked_ns > 1e9]
            at = reports.index(stale)
            assert rd.Report.of(stale.data).counts == rd.LEVELS
            meanwhile, after = reports[60:at], reports[at + 1 :]
            assert stale.handle not in {x.handle for x in meanwhile}
            assert all(map(rd.is_neutral, meanwhile + after))
            assert len(after) >= rd.NEUTRAL
            delay = (meanwhile[0].time_ns - stale.asked_ns) / 1e9
            assert TRIP_S - 0.02 < delay < TRIP_S + MARGIN_S

    @pytest.mark.deep
    def test_the_writer_is_stopped_and_goes_on(self, tmp_path, constant):
        with world() as w:
            running = rd.replay(w, constant, profile=rd.patient(tmp_path, hold_ms=HOLD_MS))
            writer, watchdog = rd.pid_of(w, "writer"), rd.pid_of(w, "watchdog")
            w.device.wait_for(rd.steady(60))
            w.signal(writer, signal.SIGSTOP)
            events = w.device.wait_for(
                lambda events: events[-1].taken and events[-1].pid == watchdog
            )
            stopped = [x for x in events if x.pid == writer and x.taken]
            tripped = [x for x in events if x.pid == watchdog and x.taken]
            delay = (tripped[0].time_ns - stopped[-1].time_ns) / 1e9
            assert TRIP_S - 0.02 < delay < TRIP_S + MARGIN_S
            w.signal(writer, signal.SIGCONT)
            done = running.wait()
            assert done.returncode == 5
            rest = [x for x in w.reports if x not in stopped]
            late = [x for x in rest if not rd.is_neutral(x)]
            assert len(late) <= 1, "the one that it was about to send"
            assert all(map(rd.is_neutral, w.reports[-2 * rd.NEUTRAL :]))
            assert rd.alone(w)

    def test_the_player_is_killed(self, tmp_path, constant):
        """The writer knows it by its pipe, and comes to rest by itself."""
        with world() as w:
            running = rd.replay(w, constant, profile=rd.patient(tmp_path))
            w.device.wait_for(rd.steady(200))
            running.signal(signal.SIGKILL)
            assert running.wait().returncode == -signal.SIGKILL
            w.device.wait_for(lambda events: [x.op for x in events].count("close") == 2)
            rd.check_constant(w.reports)
            assert rd.alone(w)

    @pytest.mark.deep
    def test_player_and_writer_are_killed(self, tmp_path, constant):
        with world() as w:
            running = rd.replay(w, constant, profile=rd.patient(tmp_path))
            writer, watchdog = rd.pid_of(w, "writer"), rd.pid_of(w, "watchdog")
            w.device.wait_for(rd.steady(200))
            running.signal(signal.SIGKILL)
            w.signal(writer, signal.SIGKILL)
            w.device.wait_for(lambda events: [x.op for x in events].count("close") == 2)
            after = [x for x in w.reports if x.pid == watchdog]
            assert len(after) >= rd.NEUTRAL
            assert all(map(rd.is_neutral, after + w.reports[-rd.NEUTRAL :]))
            assert rd.alone(w)

    @pytest.mark.deep
    def test_the_watchdog_is_killed(self, tmp_path, constant):
        with world() as w:
            running = rd.replay(w, constant, profile=rd.patient(tmp_path))
            w.device.wait_for(rd.steady(100))
            w.signal(rd.pid_of(w, "watchdog"), signal.SIGKILL)
            report = rd.told(running.wait())
            assert (report["outcome"], report["exit_code"]) == ("failed", 1)
            assert "watchdog" in report["reason"]
            rd.check_constant(w.reports)
            assert rd.alone(w)

    @pytest.mark.deep
    def test_an_exception_of_ours(self, tmp_path, constant):
        """It leaves the program, and leaves the device at rest."""
        code = (
            "import sys\n"
            "from hapfmt.replay.render.renderer import Renderer\n"
            "blocks = Renderer.blocks\n"
            "def failing(self, *given, **named):\n"
            "    for number, block in enumerate(blocks(self, *given, **named)):\n"
            "        if number == 8:\n"
            "            raise ZeroDivisionError('made up')\n"
            "        yield block\n"
            "Renderer.blocks = failing\n"
            "from hapfmt.cli import main\n"
            "main()\n"
        )
        with world() as w:
            words = ["replay", constant, "--device", rd.patient(tmp_path)]
            done = w.start([sys.executable, "-W", "error", "-c", code, *words], cwd=ROOT).wait()
            assert done.returncode == 1
            assert "made up" in done.stderr
            rd.check_constant(w.reports)
            assert rd.alone(w)


def test_a_damaged_file(tmp_path):
    """PLY-004: A player MUST treat ticks that a channel does not cover, and values that are not finite, as loss of signal: it ramps from the last value to rest, and invents none.

    A packet of the thumb is lost, 0.3 s: the thumb rests meanwhile, the others go on.
    """
    moving = [1000 + 7919 * n % 5 for n in range(1200)]
    still = [[level] * 1200 for level in rd.LEVELS[1:]]
    cluster = Fraction(3, 10)
    path = rd.recording(tmp_path / "damaged.hapf", [moving, *still], cluster=cluster)
    data = bytearray(path.read_bytes())
    starts = [n for n in range(len(data)) if data[n : n + 4] == b"DATA"]
    assert len(starts) == 4, "clusters; so small a file has no index"
    data[starts[1] + 40] ^= 0x40
    path.write_bytes(data)
    with world() as w:
        done = rd.replay(w, path, profile=rd.patient(tmp_path)).wait()
        report = rd.told(done)
        assert (report["outcome"], done.returncode) == ("clean", 3)
        assert report["lost"]
        counts = rd.counts_of(w.reports)
    rd.check_steps(counts)
    zero = (0,) * 4
    way = [zero, *rd.rise(rd.LEVELS[1:]), *rd.fall(rd.LEVELS[1:])]
    assert rd.without_repeats([zero, *(x[1:] for x in counts)]) == rd.without_repeats(way)
    thumb = [x[0] for x in counts]
    first = thumb.index(0)
    stop = next(n for n in range(first, len(thumb)) if thumb[n])
    assert rd.RAMP < first < stop < len(thumb) - len(rd.rested())
    assert stop - first + report["skipped"] >= 300 - rd.RAMP
    before = thumb[first - rd.RAMP]
    assert [(x,) for x in thumb[first - rd.RAMP + 1 : first + 1]] == rd.fall((before,))
    up = [abs(x - 1002 * rd.shape(n + 1)) for n, x in enumerate(thumb[stop : stop + rd.RAMP])]
    assert max(up) < 3
    assert all(
        1000 <= x <= 1004 for x in (*thumb[rd.RAMP : first - rd.RAMP], *thumb[stop + 50 : -55])
    )


@pytest.mark.deep
class TestPatience:
    """Last of all, so that the waiting costs no time."""

    def test_a_device_that_stalls_for_3_s(self, patience):
        """Nobody can reach it. Then it takes what waited: the frame that stalled, and neutral ones."""
        w, (running, _) = patience
        done = running.wait()
        report = rd.told(done)
        assert (report["outcome"], done.returncode) == ("late", 5)
        assert "tripped" in report["watchdog"]
        reports = w.devices[0].reports
        waited, after = reports[60], reports[61:]
        assert rd.Report.of(waited.data).counts == rd.LEVELS
        assert waited.time_ns - waited.asked_ns >= 3e9
        assert len(after) >= 2 * rd.NEUTRAL, "of the writer, and of the watchdog"
        assert all(map(rd.is_neutral, after))
        asked = [x.asked_ns for x in after if x.handle != waited.handle]
        assert (min(asked) - waited.asked_ns) / 1e9 < TRIP_S + MARGIN_S

    def test_a_device_that_hangs(self, patience):
        """Writes end after 5 s, not taken (the kernel's own limit); then nothing is tried for long."""
        w, (_, running) = patience
        done = running.wait()
        report = rd.told(done)
        assert (report["outcome"], done.returncode) == ("device-lost", 6)
        assert "tripped" in report["watchdog"]
        device = w.devices[1]
        assert len(device.reports) == 60
        first, *others = [x for x in device.events if x.error]
        assert first.error == errno.ETIMEDOUT
        assert others and all(map(rd.is_neutral, others))
        assert (device.events[-1].time_ns - first.asked_ns) / 1e9 < 20
        assert rd.alone(w)
