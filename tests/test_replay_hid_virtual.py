"""The sink, ``hapfmt devices`` and ``hapfmt profile check`` with the unmodified hidapi, on virtual
devices that look as real ones do (tests/virtual_hid says where that can be had)."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import hid_descriptors as hd
import pytest
from virtual_hid.model import Device, Fault
from virtual_hid.world import world

from hapfmt.replay.profile.matching import parse_descriptor

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="virtual devices are Linux'"
)

GLOVE = Device("Glove", descriptor=hd.GLOVE5)
PAD = Device("Wireless Controller", "Sony", "SN2", 0x054C, 0x0CE6, "usb", hd.DUALSENSE_USB)
XBOX = Device(
    "Xbox Wireless Controller", "Microsoft", "SN4", 0x045E, 0x0B13, "bluetooth", hd.XBOX_BLUETOOTH
)
JOYCON = Device("Joy-Con (L)", "Nintendo", "SN5", 0x057E, 0x2006, "bluetooth", hd.JOYCON)
KEYBOARD = Device("Keyboard", "Nobody", "SN6", 0x046D, 0xC31C, "usb", hd.KEYBOARD)

BEGIN = """
import sys
from hapfmt.errors import HapfmtError
from hapfmt.replay.profile.matching import choose
from hapfmt.replay.profile.model import HidReport
from hapfmt.replay.profile.parse import load_profile
from hapfmt.replay.sinks.hid import HidSink, connected, find
profile = load_profile("glove5")
frame = lambda n: HidReport("output", bytes([1, n]) + bytes(10))
def told(call):
    try:
        call()
    except HapfmtError as error:
        print(type(error).__name__, error)
"""


def hapfmt(made, *words, code=0):
    done = made.run([sys.executable, "-W", "error", "-m", "hapfmt", *words])
    assert done.returncode == code, done.stderr
    return done


def python(made, code, *words):
    done = made.python(BEGIN + code, *words).wait()
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_devices():
    """Each with its profile, and nothing is sent to any."""
    bluetooth = replace(PAD, bus="bluetooth", serial="SN3", descriptor=hd.DUALSENSE_BLUETOOTH)
    all_of_them = [GLOVE, PAD, bluetooth, XBOX, JOYCON, KEYBOARD]
    with world(devices=[(each, ()) for each in all_of_them]) as made:
        shown = hapfmt(made, "devices").stdout
        rows = json.loads(hapfmt(made, "devices", "--json").stdout)["devices"]
        seen = [each.events for each in made.devices]
    assert {row["path"].split("/")[-1] for row in rows} == {f"hidraw{n}" for n in range(6)}
    rows.sort(key=lambda row: row["path"])
    assert [[(each["name"], each["fits"]) for each in row["profiles"]] for row in rows] == [
        [("glove5", True)],
        [("dualsense-usb", True)],
        [("dualsense-bluetooth", True), ("dualsense-bluetooth-haptics", True)],
        [("xbox-bluetooth", True)],
        [("joycon-left", True)],
        [],
    ]
    assert [row["missing"] for row in rows] == [[]] * 5 + [["profile"]]
    assert [row["bus"] for row in rows] == [
        "usb",
        "usb",
        "bluetooth",
        "bluetooth",
        "bluetooth",
        "usb",
    ]
    assert rows[0]["usages"] == [[0xFF00, 1]] and rows[5]["usages"] == [[1, 6]]
    assert all(row["path"] in shown for row in rows)
    assert all(each.op in ("open", "close") for events in seen for each in events)
    assert not seen[5], "a keyboard is not even opened"


def test_profile_check():
    """Against the descriptor of the device itself."""
    other = replace(GLOVE, descriptor=hd.device(0xFF00, 1, hd.field(hd.OUTPUT, 10, number=1)))
    with world(devices=[(GLOVE, ()), (other, ())]) as made:
        good, bad = (each.path for each in made.devices)
        assert (
            f"each of its reports is one of {good}"
            in hapfmt(made, "profile", "check", "glove5", "--path", good).stdout
        )
        refused = hapfmt(made, "profile", "check", "glove5", "--path", bad, code=1).stderr
        assert not made.devices[0].reports + made.devices[1].reports
    assert "output report 0x01: the profile sends 12 bytes, the device takes 11" in refused


def test_reports_arrive_as_they_are():
    """Output reports by write, feature reports by their own call, in their order."""
    descriptor = hd.GLOVE5[:-1] + hd.field(hd.FEATURE, 3, number=5) + hd.GLOVE5[-1:]
    with world(device=replace(GLOVE, descriptor=descriptor)) as made:
        python(
            made,
            """
sink = HidSink(find(profile).path, profile)
sink.open()
for n in range(200):
    sink.write((frame(n), HidReport("feature", bytes([5, n, 0, 255]))) if n % 10 == 0 else (frame(n),))
sink.close()
""",
        )
        seen = [(each.op, each.data) for each in made.reports]
    expected = []
    for n in range(200):
        expected.append(("output", bytes([1, n]) + bytes(10)))
        if n % 10 == 0:
            expected.append(("feature", bytes([5, n, 0, 255])))
    assert seen == expected


def test_nothing_is_sent_to_a_device_with_other_reports():
    other = replace(GLOVE, descriptor=hd.device(0xFF00, 1, hd.field(hd.OUTPUT, 63, number=1)))
    with world(device=other) as made:
        out = python(made, "told(HidSink(find(profile).path, profile).open)")
        assert not made.reports
        assert [each.op for each in made.events] == ["open", "close"]
    assert out.startswith("ParameterError the profile glove5 does not fit ")
    assert "the profile sends 12 bytes, the device takes 64" in out and "nothing was sent" in out


def test_a_write_error():
    with world(device=GLOVE, faults=[Fault("error", at=3, count=1)]) as made:
        out = python(
            made,
            """
sink = HidSink(find(profile).path, profile)
sink.open()
for n in range(5):
    told(lambda: sink.write((frame(n), frame(100 + n))))
sink.close()
""",
        )
        taken = [each.data[1] for each in made.reports if not each.error]
    assert out.count("\n") == 1
    assert (
        out.startswith("DeviceError ")
        and "output report 0x01 was not taken: Input/output error" in out
    )
    assert taken == [0, 100, 1, 2, 102, 3, 103, 4, 104], "none after the one that failed"


def test_a_device_that_goes():
    """What is sent then fails at once, and so does opening it again."""
    with world(device=GLOVE, faults=[Fault("unplug", at=2)]) as made:
        out = python(
            made,
            """
path = find(profile).path
sink = HidSink(path, profile)
sink.open()
for n in range(4):
    told(lambda: sink.write((frame(n),)))
sink.close()
told(sink.open)
""",
        )
        assert [each.data[1] for each in made.reports if not each.error] == [0, 1]
    lines = out.splitlines()
    assert len(lines) == 3
    assert all("output report 0x01 was not taken: No such device" in line for line in lines[:2])
    assert (
        lines[2].startswith("DeviceError ")
        and "cannot be opened" in lines[2]
        and "No such device" in lines[2]
    )


def test_a_device_may_be_opened_again():
    """Twice by two objects, as writer and watchdog do, and again after it was closed."""
    with world(device=GLOVE) as made:
        python(
            made,
            """
path = find(profile).path
one, two = HidSink(path, profile), HidSink(path)
one.open(); two.open()
one.write((frame(1),)); two.write((frame(2),))
one.close()
two.write((frame(3),))
one.open()
one.write((frame(4),))
one.close(); two.close()
""",
        )
        assert [each.data[1] for each in made.reports] == [1, 2, 3, 4]


@pytest.mark.realtime
def test_close_waits_for_a_write_that_stalls():
    """The real library would read freed memory."""
    with world(device=GLOVE, faults=[Fault("stall", at=1, ms=1000)]) as made:
        out = python(
            made,
            """
import threading, time
sink = HidSink(find(profile).path, profile)
sink.open()
sink.write((frame(0),))
thread = threading.Thread(target=lambda: told(lambda: sink.write((frame(1), frame(2)))))
thread.start()
time.sleep(0.1)
begin = time.monotonic()
sink.close()
print(time.monotonic() - begin > 0.1)
thread.join()
""",
        )
        seen = [each.data[1] for each in made.reports if not each.error]
    assert "True" in out and "the device is not open" in out
    assert seen == [0, 1]


def test_several_that_fit():
    """The profile alone does not say which one."""
    with world(devices=[(GLOVE, ()), (replace(GLOVE, serial="SN9"), ())]) as made:
        paths = [each.path for each in made.devices]
        out = python(
            made, "told(lambda: find(profile)); print(find(profile, sys.argv[1]).place)", paths[1]
        )
    assert out.startswith("ParameterError the profile glove5 fits 2 devices: ")
    assert all(path in out for path in paths)
    assert out.splitlines()[-1] == paths[1]


COLLECTIONS = {
    "two": hd.device(1, 2, hd.field(hd.INPUT, 1, number=1))
    + hd.device(0xFF00, 3, hd.field(hd.OUTPUT, 2, number=2)),
    "three": hd.device(1, 2) + hd.device(12, 1) + hd.device(0xFF43, 0x202, hd.field(hd.OUTPUT, 2)),
    "nested": hd.device(1, 2, hd.device(13, 4)) + hd.device(1, 6),
    "page of its own": hd.item(hd.PAGE, 1)
    + hd.item(hd.USAGE, 0xFF42_0007, 4)
    + hd.item(hd.COLLECTION, 1)
    + hd.item(hd.END),
    "page after usage": hd.item(hd.USAGE, 5)
    + hd.item(hd.PAGE, 1)
    + hd.item(hd.COLLECTION, 1)
    + hd.item(hd.END),
}


def test_usages_are_those_that_hidapi_finds():
    """Two readings of the same bytes: hidapi's in C, and ours."""
    given = [
        (replace(GLOVE, serial=name, descriptor=data), ()) for name, data in COLLECTIONS.items()
    ]
    with world(devices=given) as made:
        out = python(
            made,
            "import json; print(json.dumps([(x.serial, x.usage_page, x.usage) for x in connected()]))",
        )
    found: dict[str, list[tuple[int, int]]] = {}
    for name, page, usage in json.loads(out):
        found.setdefault(name, []).append((page, usage))
    assert found == {
        name: list(parse_descriptor(data).usages) for name, data in COLLECTIONS.items()
    }
