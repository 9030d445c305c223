"""Whole replays to a device that hapfmt cannot tell from a real one: every byte that arrives.

The library hidapi is the one that is installed, unchanged; see tests/virtual_hid. What must arrive
is computed here from the layouts that the profiles describe (replay_device.py), never by hapfmt.
"""

from __future__ import annotations

import os
import struct
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import sin, tau
from statistics import median

import hid_descriptors
import pytest
import replay_device as rd
from virtual_hid.descriptors import dualsense, glove, pro_controller, xbox
from virtual_hid.world import world

import hapfmt

pytestmark = [pytest.mark.usefixtures("hidapi"), pytest.mark.realtime]


@pytest.fixture(scope="module")
def thousand():
    """Counts of a second: the thumb tells which sample it is, the others move at their own pace,
    so slowly that leaving out 20 frames is no step for the limiter."""
    return [
        list(range(1000)),
        [-2 * n for n in range(1000)],
        [round(2000 * sin(tau * n / 600)) for n in range(1000)],
        [7919 * n % 201 - 100 for n in range(1000)],
        [2000] * 1000,
    ]


def expected(thousand):
    """Counts of each frame of an undisturbed replay, in their order."""
    samples = list(zip(*thousand, strict=True))
    ramp = [
        tuple(rd.count(x * rd.shape(n + 1)) for x in row)
        for n, row in enumerate(samples[: rd.RAMP])
    ]
    return [*ramp, *samples[rd.RAMP :], *rd.rested(samples[-1])]


def test_a_thousand_frames_of_five_actuators(tmp_path, thousand):
    """Complete, in order, each byte as the layout has it.

    A frame that comes a period late is left out (PLY-005), which a busy machine may force: it is
    counted, and nothing else changes. Complete is shown by the first undisturbed run of three.
    """
    file = rd.recording(tmp_path / "thousand.hapf", thousand)
    frames = expected(thousand)
    for _ in range(3):
        with world(device=glove()) as w:
            report = rd.clean(rd.replay(w, file, profile=rd.patient(tmp_path)).wait())
            data = [x.data for x in w.reports]
            opened = [x.handle for x in w.events if x.op == "open"]
            assert {x.handle for x in w.reports} == {opened[0]}, "one writer"
        rd.check_sent(report, len(frames) - rd.NEUTRAL)
        assert len(data) == report["sent"] + rd.NEUTRAL
        reports = [rd.Report.of(x) for x in data]
        rd.check_counters(reports)
        if not report["skipped"]:
            assert data == [
                struct.pack("<BB5h", 1, n & 0xFF, *counts) for n, counts in enumerate(frames)
            ]
            return
        if report["slew_limited"]:
            continue  # so many frames were left out at once that the next is a way to its value
        samples = dict(enumerate(zip(*thousand, strict=True)))
        full = [x.counts for x in reports[rd.RAMP : -len(frames[1000:])]]
        assert all(x == samples[x[0]] for x in full), "each frame is that of one moment"
        assert all(a[0] < b[0] for a, b in pairwise(full))
    pytest.skip(
        f"busy: {report['skipped']} frames were left out, the third time; the others are right"
    )


@pytest.mark.deep
def test_reports_that_are_features(tmp_path):
    profile = rd.patient(tmp_path)
    text = profile.read_text(encoding="utf-8")
    profile.write_text(text.replace('path = "output"', 'path = "feature"'), encoding="utf-8")
    file = rd.constant(tmp_path / "constant.hapf", 1)
    with world(device=glove(path="feature")) as w:
        rd.clean(rd.replay(w, file, profile=profile).wait())
        assert {x.op for x in w.reports} == {"feature"}
        rd.check_constant(w.reports)


@pytest.mark.deep
def test_a_record_is_what_the_device_took(tmp_path):
    file = rd.constant(tmp_path / "constant.hapf", 1)
    sent = tmp_path / "sent.hapf"
    with world() as w:
        report = rd.clean(rd.replay(w, file, "--record", sent, profile=rd.patient(tmp_path)).wait())
        rd.check_constant(w.reports)
        counts = rd.counts_of(w.reports)[: -rd.NEUTRAL]
    kept = hapfmt.read(sent).channels
    assert [x.label for x in kept] == list(rd.FINGERS)
    steps = [[round(value / 0.001) for value in x.samples().tolist()] for x in kept]
    assert list(zip(*steps, strict=True)) == counts
    assert kept[0].stop_tick - len(counts) == report["skipped"]


@pytest.mark.deep
def test_a_device_whose_reports_differ_gets_none(tmp_path):
    """One byte more than the profile says: refused before the first write."""
    file = rd.constant(tmp_path / "constant.hapf", 1)
    with world(device=glove(size=13)) as w:
        done = rd.replay(w, file).wait()
        assert done.returncode == 1
        assert "length" in done.stderr or "bytes" in done.stderr
        assert not w.reports


@pytest.mark.deep
def test_keys_of_a_terminal(tmp_path):
    """PLY-003: A player MUST pass from rest to signal and back by a ramp, never by a step: at the start and the end, at a pause, a seek, the join of a loop, an error.

    Space pauses and goes on, right seeks, q ends.
    """
    file = rd.constant(tmp_path / "constant.hapf")
    ours, theirs = pytest.importorskip("pty").openpty()
    with world() as w, os.fdopen(ours, "wb", 0) as keyboard, os.fdopen(theirs, "rb", 0) as terminal:
        running = rd.replay(w, file, profile=rd.patient(tmp_path), stdin=terminal)
        places = []
        for key in (b" ", b" ", b"\x1b[C", b"q"):
            seen = len(w.reports)
            w.device.wait_for(rd.steady(seen + 200 + 2 * rd.RAMP))
            places.append(len(w.reports))
            keyboard.write(key)
        done = running.wait()
        report = rd.told(done)
        assert (report["outcome"], report["reason"], done.returncode) == (
            "interrupted",
            "q was pressed",
            0,
        )
        counts = rd.counts_of(w.reports)
    rd.check_steps(counts)
    way = [*rd.rise(), *rd.fall()] * 3
    assert rd.without_repeats(counts) == rd.without_repeats(way)
    assert counts[-len(rd.rested()) :] == rd.rested()
    assert counts[places[0]] == rd.LEVELS == counts[places[2]] == counts[places[3]]
    assert counts[places[1]] == (0,) * 5, "a pause rests"


def test_waveforms_of_a_dualsense_at_their_period(tmp_path):
    """Report 0x32: 32 pairs of signed bytes every 10.667 ms, none early, CRC right."""
    left = [n // 32 - 46 for n in range(3000)]  # which packet it is
    right = [30] * 3000
    file = rd.recording(
        tmp_path / "waves.hapf", [left, right], labels=("left", "right"), unit="1", rate=3000,
        scale=Fraction(2, 128),
    )  # fmt: skip
    device = replace(dualsense("bluetooth"), descriptor=hid_descriptors.DUALSENSE_BLUETOOTH)
    profile = rd.patient(tmp_path, name="dualsense-bluetooth-haptics")
    with world(device=device) as w:
        report = rd.clean(rd.replay(w, file, profile=profile).wait())
        events = w.reports
    data = [x.data for x in events]
    assert {len(x) for x in data} == {142}
    assert all(map(rd.crc_right, data))
    assert {x[:10].hex(" ") for x in data} == {"32 00 91 07 fe 00 00 00 00 ff"}
    assert [x[10] for x in data] == [n & 0xFF for n in range(len(data))]
    assert {x[11:13] for x in data} == {b"\x92\x40"}
    assert not any(any(x[77:138]) for x in data)
    pairs = [struct.unpack("64b", x[13:77]) for x in data]
    flat = [pair for x in pairs for pair in zip(x[::2], x[1::2], strict=True)]
    assert flat[-32 * rd.NEUTRAL :] == [(0, 0)] * (32 * rd.NEUTRAL)
    # Between the ramps, of 150 samples each: every packet is that of its time.
    steady = [
        (x, event.time_ns / 1e6)
        for x, event in zip(pairs, events, strict=True)
        if set(x[1::2]) == {30}
    ]
    assert all(len(set(x[::2])) == 1 for x, _ in steady)
    numbers = [x[0] + 46 for x, _ in steady]
    assert numbers[0] >= 4 and numbers[-1] <= 93
    assert all(a < b for a, b in pairwise(numbers))
    assert len(numbers) + report["skipped"] >= 93 - 5
    period = 32 / 3000 * 1000
    late = [time - number * period for number, (_, time) in zip(numbers, steady, strict=True)]
    assert median(late) - min(late) < period / 2
    # The last packet of the replay is all at rest; then come the neutral ones.
    rd.check_sent(report, -(-(3000 + 150) // 32) + 1)


LEVELS = {
    "joycon-left": {"high": 8, "low": 6},
    "xbox-bluetooth": {"strong": 8, "weak": 4, "left-trigger": 2, "right-trigger": 10},
    "dualsense-usb": {"left": 4, "right": -2},
    "dualsense-bluetooth": {"left": 4, "right": -2},
}
"""Newtons for each motor: 10 are full scale, and the gain is 0.5. Motors take the amount."""
CONTROLLERS = {
    "joycon-left": replace(pro_controller(), product_id=0x2006, descriptor=hid_descriptors.JOYCON),
    "xbox-bluetooth": replace(xbox(), descriptor=hid_descriptors.XBOX_BLUETOOTH),
    "dualsense-usb": replace(dualsense(), descriptor=hid_descriptors.DUALSENSE_USB),
    "dualsense-bluetooth": replace(
        dualsense("bluetooth"), descriptor=hid_descriptors.DUALSENSE_BLUETOOTH
    ),
}


@pytest.fixture(scope="module")
def sent(tmp_path_factory):
    """What four controllers got at once, in a second each."""
    room = tmp_path_factory.mktemp("controllers")
    with world(devices=[(x, ()) for x in CONTROLLERS.values()], tier="fuse") as w:
        running = []
        for name, levels in LEVELS.items():
            samples = [[level] * 1000 for level in levels.values()]
            file = rd.recording(
                room / f"{name}.hapf", samples, labels=list(levels), scale=Fraction(1)
            )
            running.append(rd.replay(w, file, profile=rd.patient(room, name=name)))
        reports = [rd.clean(each.wait()) for each in running]
        found = zip(CONTROLLERS, w.devices, reports, strict=True)
        yield {name: ([x.data for x in device.reports], told) for name, device, told in found}


@pytest.mark.deep
class TestControllers:
    def test_a_joycon(self, sent):
        """Vibration is enabled first; amplitudes as dekuNukem's table has them; five packets to stop."""
        data, report = sent["joycon-left"]
        assert data[0] == bytes.fromhex("01 00 00014040 00014040 48 01") + bytes(37)
        frames = data[1:]
        assert [x[:2] for x in frames] == [bytes([0x10, n + 1 & 15]) for n in range(len(frames))]
        # 0.4 at 320 Hz is index 58, 0.3 at 160 Hz is 44: 32 log2(8.7 a).
        steady = bytes([0x00, 0x01 + 2 * 58, 0x40, 0x40 + 22]) + bytes.fromhex("00014040")
        rest = bytes.fromhex("00014040 00014040")
        assert {x[2:] for x in frames[4:10]} == {steady}
        assert {x[2:] for x in frames[-rd.NEUTRAL :]} == {rest}
        rd.check_sent(report, 20 + 4)
        assert max(x[3] for x in frames) <= 0xC9
        assert max(x[5] for x in frames) <= 0x72

    def test_an_xbox_controller(self, sent):
        """Report 3 of xpadneo: what is enabled, four magnitudes, 200 ms, no delay, no repeat."""
        data, report = sent["xbox-bluetooth"]
        assert set(data[4:10]) == {bytes([3, 0x0F, 10, 50, 40, 20, 20, 0, 0])}
        assert set(data[-rd.NEUTRAL :]) == {bytes([3, 0x0F, 0, 0, 0, 0, 20, 0, 0])}
        rd.check_sent(report, 20 + 4)

    def test_a_dualsense_by_usb(self, sent):
        """Report 2 of hid-playstation.c: flags, the right motor, the left one."""
        data, report = sent["dualsense-usb"]
        assert set(data[10:50]) == {bytes([2, 3, 0, 26, 51]) + bytes(43)}
        assert set(data[-rd.NEUTRAL :]) == {bytes([2, 3]) + bytes(46)}
        rd.check_sent(report, 100 + 10)

    def test_a_dualsense_by_bluetooth(self, sent):
        """Report 0x31 of hid-playstation.c: sequence in the high nibble, tag, flags, motors, CRC."""
        data, report = sent["dualsense-bluetooth"]
        assert {len(x) for x in data} == {78}
        assert all(map(rd.crc_right, data))
        assert [x[1] for x in data] == [(n & 15) << 4 for n in range(len(data))]
        assert {(x[0], *x[2:5]) for x in data} == {(0x31, 0x10, 0x03, 0)}
        assert not any(any(x[7:74]) for x in data)
        motors = [(x[6], x[5]) for x in data]
        assert set(motors[5:30]) == {(51, 26)}
        assert motors[-rd.NEUTRAL :] == [(0, 0)] * rd.NEUTRAL
        rd.check_sent(report, 50 + 5)  # a second, and a ramp of 100 ms
