"""Private worlds with virtual devices, and what is left of them: what tests of replays stand on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from spec import ROOT
from virtual_hid import umock
from virtual_hid.behaviour import MS
from virtual_hid.descriptors import dualsense, glove, pro_controller, xbox
from virtual_hid.model import Fault
from virtual_hid.world import world

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="namespaces and FUSE are of Linux"),
    pytest.mark.usefixtures("hidapi"),
    pytest.mark.realtime,
]
NEEDS = "import hidraw, sys, time\nopened = hidraw.device()\nopened.open_path(hidraw.enumerate()[0]['path'])\n"


class TestWorld:
    """With hidapi as it is installed, unchanged."""

    @pytest.mark.parametrize("tier", ["uhid", "fuse", "umockdev"])
    def test_a_world_for_hidapi(self, tier):
        if tier == "uhid" and not os.access("/dev/uhid", os.R_OK | os.W_OK):
            pytest.skip("no /dev/uhid that may be written")
        if tier == "umockdev" and not umock.python():
            pytest.skip("no umockdev with its bindings for Python")
        code = NEEDS + (
            "for number in range(1000):\n"
            "    assert opened.write(bytes([1]) + number.to_bytes(11, 'little')) == 12\n"
            "assert opened.send_feature_report(b'\\3abcd') == 5\n"
            "assert bytes(opened.get_feature_report(3, 5)) == b'\\3abcd'\n"
            "print(bytes(opened.get_report_descriptor()).hex())\n"
            "opened.close()"
        )
        with world(tier=tier) as w:
            done = w.python(code).wait()
            assert (done.returncode, done.stderr) == (0, "")
            assert done.stdout == glove().descriptor.hex() + "\n"
            if tier != "umockdev":  # which does not tell of it
                w.device.wait_for(lambda events: events[-1].op == "close")
            outputs = [x for x in w.reports if x.op == "output"]
            assert [x.data for x in outputs] == [
                b"\1" + i.to_bytes(11, "little") for i in range(1000)
            ]
            others = [x.op for x in w.events if x.op != "output"]
            assert others[:3] == ["open", "feature", "get"]
            assert set(others[3:]) <= {"close"}
            times = [x.time_ns for x in w.events]
            assert times == sorted(times)

    def test_a_world_of_several(self):
        devices = [glove(serial="A"), dualsense(), dualsense("bluetooth"), pro_controller(), xbox()]
        code = (
            "import hidraw\n"
            "for x in hidraw.enumerate():\n"
            "    print(x['vendor_id'], x['product_id'], x['serial_number'], x['bus_type'],"
            " x['usage_page'], x['usage'], sep=' ')\n"
            "    opened = hidraw.device()\n"
            "    opened.open_path(x['path'])\n"
            "    opened.write(x['path'])\n"
            "    opened.close()"
        )
        with world(devices=[(x, ()) for x in devices], tier="fuse") as w:
            done = w.python(code).wait()
            assert done.stderr == ""
            want = {
                f"{x.vendor_id} {x.product_id} {x.serial} {1 if x.bus == 'usb' else 2} "
                + ("65280 1" if x.vendor_id == 0x1209 else "1 5")
                for x in devices
            }
            assert set(done.stdout.splitlines()) == want
            assert [[x.data.decode() for x in d.reports] for d in w.devices] == [
                [d.path] for d in w.devices
            ]

    def test_a_world_with_two_handles_of_a_device_that_stalls(self):
        with world(faults=[Fault("stall", at=3, ms=1000)]) as w:
            first = w.python(NEEDS + "for i in range(5): opened.write(bytes([1, i]))")
            w.device.wait_for(lambda events: len(events) == 4)
            second = w.python(NEEDS + "opened.write(b'\\1N')")
            w.device.wait_for(lambda events: sum(x.op == "open" for x in events) == 2)
            first.signal(signal.SIGKILL)
            assert first.wait().returncode == -signal.SIGKILL
            assert second.wait().returncode == 0
            stalled = next(x for x in w.events if x.data == b"\1\3")
            assert stalled.time_ns - stalled.asked_ns >= 1000 * MS
            assert [x.data for x in w.reports] == [b"\1\0", b"\1\1", b"\1\2", b"\1\3", b"\1N"]

    def test_a_world_where_only_a_handle_stalls(self):
        with world(faults=[Fault("handle-stall", at=3, ms=1000)]) as w:
            first = w.python(NEEDS + "for i in range(5): opened.write(bytes([1, i]))")
            w.device.wait_for(lambda events: len(events) == 4)
            w.python(NEEDS + "opened.write(b'\\1N')").wait()
            first.wait()
            opened = {x.handle: x.pid for x in w.events if x.op == "open"}
            assert opened[1] == first.pid
            stalled = next(x for x in w.events if x.data == b"\1\3")
            other = next(x for x in w.events if x.data == b"\1N")
            assert other.pid == opened[2]
            if other.asked_ns < stalled.time_ns:  # unless it took a second to start
                assert other.time_ns == other.asked_ns < stalled.time_ns

    def test_a_world_whose_device_goes(self):
        code = NEEDS + (
            "print(opened.read(4), flush=True)\n"
            "try:\n    opened.read(4)\nexcept OSError as error:\n    print(error)\n"
            "print(opened.write(b'\\1abc'), hidraw.enumerate())\n"
        )
        with world(tier="fuse") as w:
            running = w.python(code)
            w.device.wait_for(lambda events: events)
            w.device.say(b"\1abc")
            end = time.monotonic() + 60
            while not running.stdout and time.monotonic() < end:
                time.sleep(0.005)
            w.device.unplug()
            assert running.wait().stdout == "[1, 97, 98, 99]\nread error\n-1 []\n"
            assert not w.reports

    @pytest.mark.parametrize("tier", ["fuse", "umockdev"])
    def test_a_world_with_errors(self, tier):
        if tier == "umockdev" and not umock.python():
            pytest.skip("no umockdev with its bindings for Python")
        code = NEEDS + "print([opened.write(bytes([1, i])) for i in range(6)])"
        with world(faults=[Fault("error", at=2, count=3)], tier=tier) as w:
            assert w.python(code).wait().stdout == "[2, 2, -1, -1, -1, 2]\n"
            assert [x.data[1] for x in w.reports] == [0, 1, 5]
            assert [x.error for x in w.events if x.op == "output"] == [0, 0, 5, 5, 5, 0]


SLEEPER = """
import sys, time
sys.path.insert(0, {tests!r})
from virtual_hid.world import open_world
with open_world(tier="fuse") as w:
    # A child that ignores what it can, in a session of its own, and holds the device open.
    w.start(["sh", "-c", "trap '' HUP INT TERM; exec 3<>/dev/shm/hidraw0; setsid sleep 1000 & sleep 1000"])
    w.device.wait_for(lambda events: events)
    print(w.keeper.pid, flush=True)
    time.sleep(1000)
"""


@pytest.mark.parametrize("name", ["SIGKILL", "SIGTERM"])
def test_a_killed_test_leaves_no_world_behind(name):
    number = signal.Signals[name]
    with world(tier="fuse"):
        pass  # skips, and says why, where there is none
    code = SLEEPER.format(tests=str(ROOT / "tests"))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as test:
        try:
            assert test.stdout is not None
            keeper = int(test.stdout.readline())
            end = time.monotonic() + 60
            inside: list[int] = []
            while len(inside) < 4:  # process 1, the server, the shell, what it started
                assert time.monotonic() < end, inside
                inside = descendants(keeper)
            test.send_signal(number)
            assert test.wait(60) == -number
        finally:
            test.kill()
    end = time.monotonic() + 60
    while any(alive(pid) for pid in [keeper, *inside]):
        assert time.monotonic() < end, [pid for pid in inside if alive(pid)]
        time.sleep(0.01)
    assert "vhid" not in Path("/proc/mounts").read_text(encoding="utf-8")


def descendants(pid: int) -> list[int]:
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="utf-8").split()
    except (FileNotFoundError, ProcessLookupError):
        return []
    return [each for child in map(int, children) for each in (child, *descendants(child))]


def alive(pid: int) -> bool:
    try:
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_world_of_an_ordinary_user():
    """A user namespace. /dev/fuse is open to everybody on most systems; here it is made so, where
    we may. (The user may read all files, since a checkout of root's may be closed to others.)"""
    if os.getuid() != 0:
        pytest.skip("every other world of these tests is one")
    with world(tier="fuse"):
        pass
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT / 'tests')!r})\n"
        "from virtual_hid.world import UnavailableError, open_world\n"
        "import os; assert os.getuid() == 1000\n"
        "try:\n"
        "    with open_world(tier='fuse') as w:\n"
        "        done = w.run(['sh', '-c', 'printf abc > /dev/shm/hidraw0'])\n"
        "        print(done.stderr, [x.data for x in w.reports], w.device.refused)\n"
        "except UnavailableError as error:\n"
        "    print('unavailable:', error)\n"
    )
    open_to_all = (
        "mount -t tmpfs none /mnt && mknod -m 666 /mnt/fuse c 10 229 && mount --bind /mnt/fuse /dev/fuse"
        " && exec setpriv --reuid=1000 --regid=1000 --clear-groups --inh-caps=-all,+dac_read_search"
        ' --ambient-caps=-all,+dac_read_search --bounding-set=-all,+dac_read_search "$@"'
    )
    words = ["unshare", "-m", "sh", "-c", open_to_all, "sh", sys.executable, "-c", code]
    done = subprocess.run(words, cwd="/", capture_output=True, text=True, check=False, timeout=60)
    if "unavailable" in done.stdout or "mount:" in done.stderr or "mknod:" in done.stderr:
        pytest.skip(done.stdout + done.stderr)
    assert done.stdout.startswith(" [b'abc']"), done.stdout + done.stderr


def test_a_world_without_namespaces():
    """By umockdev, where nothing else may be had: what it started is ended with it all the same."""
    if not umock.python():
        pytest.skip("no umockdev with its bindings for Python")
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT / 'tests')!r})\n"
        "from virtual_hid.world import open_world\n"
        "with open_world() as w:\n"
        "    code = \"import os; os.write(os.open('/dev/hidraw0', os.O_RDWR), b'abc')\"\n"
        "    done = w.run([sys.executable, '-c', code])\n"
        "    w.run(['sh', '-c', 'setsid sleep 1000 & sleep 0.05'])\n"
        "    pids = [str(x['pid']) for x in w.processes()]\n"
        "    print(w.setup.tier, [x.data for x in w.reports], done.stderr, *pids)\n"
    )
    forbidden = (
        "for kind in user mnt pid; do echo 0 > /proc/sys/user/max_${kind}_namespaces; done;"
        'exec "$@"'
    )
    words = ["unshare", "-Ur", "sh", "-c", forbidden, "sh", sys.executable, "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    if "unshare:" in done.stderr or "sh:" in done.stderr:
        pytest.skip(done.stderr)
    assert done.stdout.startswith("umockdev [b'abc']"), done.stdout + done.stderr
    pids = [int(word) for word in done.stdout.split()[2:]]
    assert len(pids) == 2, done.stdout  # the server, and what ran on
    assert not any(map(alive, pids))
