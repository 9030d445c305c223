"""Whole replays to a device that hapfmt cannot tell from a real one: every byte that arrives.

The library hidapi is the one that is installed, unchanged; see tests/virtual_hid. What must arrive
is computed here from the layouts that the profiles describe (replay_device.py), never by hapfmt.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import sin, tau
from statistics import median

import hid_descriptors
import pytest
import replay_device as rd
from virtual_hid.descriptors import dualsense, glove
from virtual_hid.world import world

pytestmark = pytest.mark.usefixtures("hidapi")


@pytest.fixture(scope="module")
def thousand():
    """Counts of a second: the thumb tells which sample it is, the others move at their own pace."""
    return [
        list(range(1000)),
        [-2 * n for n in range(1000)],
        [round(2400 * sin(tau * n / 200)) for n in range(1000)],
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
    counted, and nothing else changes. With real-time scheduling one undisturbed run of three is
    asked for.
    """
    file = rd.recording(tmp_path / "thousand.hapf", thousand)
    frames = expected(thousand)
    for _ in range(3):
        with world(device=glove()) as w:
            report = rd.clean(rd.replay(w, file).wait())
            data = [x.data for x in w.reports]
            opened = [x.handle for x in w.events if x.op == "open"]
            assert {x.handle for x in w.reports} == {opened[0]}, "one writer"
        assert report["sent"] + report["skipped"] == len(frames) - rd.NEUTRAL
        assert len(data) == report["sent"] + rd.NEUTRAL
        reports = [rd.Report.of(x) for x in data]
        rd.check_counters(reports)
        if not report["skipped"]:
            assert data == [
                struct.pack("<BB5h", 1, n & 0xFF, *counts) for n, counts in enumerate(frames)
            ]
            return
        samples = dict(enumerate(zip(*thousand, strict=True)))
        full = [x.counts for x in reports[rd.RAMP : -len(frames[1000:])]]
        assert all(x == samples[x[0]] for x in full), "each frame is that of one moment"
        assert all(a[0] < b[0] for a, b in pairwise(full))
    if "FIFO" in report["realtime"]["scheduler"]:
        pytest.fail(f"{report['skipped']} frames were skipped, three times")


def test_reports_that_are_features(tmp_path):
    text = rd.GLOVE.read_text(encoding="utf-8")
    profile = tmp_path / "feature.toml"
    profile.write_text(text.replace('path = "output"', 'path = "feature"'), encoding="utf-8")
    file = rd.constant(tmp_path / "constant.hapf", 1)
    with world(device=glove(path="feature")) as w:
        rd.clean(rd.replay(w, file, profile=profile).wait())
        assert {x.op for x in w.reports} == {"feature"}
        rd.check_constant(w.reports)


def test_a_device_whose_reports_differ_gets_none(tmp_path):
    """One byte more than the profile says: refused before the first write."""
    file = rd.constant(tmp_path / "constant.hapf", 1)
    with world(device=glove(size=13)) as w:
        done = rd.replay(w, file).wait()
        assert done.returncode == 1
        assert "length" in done.stderr or "bytes" in done.stderr
        assert not w.reports


class TestDualSense:
    def test_rumble_by_bluetooth(self, tmp_path):
        """Report 0x31 of hid-playstation.c: sequence in the high nibble, tag, flags, motors, CRC."""
        file = rd.recording(
            tmp_path / "rumble.hapf", [[4000] * 1000, [-2000] * 1000], labels=("left", "right"),
            scale=Fraction(1, 1000),
        )  # fmt: skip
        device = replace(dualsense("bluetooth"), descriptor=hid_descriptors.DUALSENSE_BLUETOOTH)
        with world(device=device) as w:
            report = rd.clean(rd.replay(w, file, profile="dualsense-bluetooth").wait())
            data = [x.data for x in w.reports]
        assert {len(x) for x in data} == {78}
        assert all(map(rd.crc_right, data))
        assert [x[1] for x in data] == [(n & 15) << 4 for n in range(len(data))]
        assert {(x[0], *x[2:5]) for x in data} == {(0x31, 0x10, 0x03, 0)}
        assert not any(any(x[7:74]) for x in data)
        motors = [(x[6], x[5]) for x in data]
        # 4 N and 2 N of 10 N, gain 0.5, 255 steps; both as amplitudes.
        assert max(motors) == (51, 26)
        assert motors[-rd.NEUTRAL :] == [(0, 0)] * rd.NEUTRAL
        assert report["sent"] + report["skipped"] == 50 + 5  # a second, and a ramp of 100 ms

    def test_waveforms_by_bluetooth_at_their_period(self, tmp_path):
        """Report 0x32: 32 pairs of signed bytes every 10.667 ms, none early, CRC right."""
        left = [n // 32 - 46 for n in range(3000)]  # which packet it is
        right = [30] * 3000
        file = rd.recording(
            tmp_path / "waves.hapf", [left, right], labels=("left", "right"), unit="1", rate=3000,
            scale=Fraction(2, 128),
        )  # fmt: skip
        device = replace(dualsense("bluetooth"), descriptor=hid_descriptors.DUALSENSE_BLUETOOTH)
        with world(device=device) as w:
            report = rd.clean(rd.replay(w, file, profile="dualsense-bluetooth-haptics").wait())
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
        assert max(late) - min(late) < period + 1, "a packet that is a period late is left out"
        assert median(late) - min(late) < 2
        # The last packet of the replay is all at rest; then come the neutral ones.
        assert report["sent"] + report["skipped"] == -(-(3000 + 150) // 32) + 1
