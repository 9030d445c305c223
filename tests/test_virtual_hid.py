"""The virtual devices by themselves: what tests of replays stand on."""

from __future__ import annotations

import errno
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from spec import ROOT
from virtual_hid import uhid, umock
from virtual_hid.behaviour import MS, POLLERR, POLLHUP, POLLIN, POLLOUT, Answer, Node
from virtual_hid.descriptors import descriptor, dualsense, glove, pro_controller, xbox
from virtual_hid.model import Device, Event, Fault
from virtual_hid.world import world

linux = pytest.mark.skipif(sys.platform != "linux", reason="namespaces and FUSE are of Linux")
NEEDS = "import hidraw, sys, time\nopened = hidraw.device()\nopened.open_path(hidraw.enumerate()[0]['path'])\n"


@pytest.fixture(autouse=True)
def hidapi(request):
    if "world" in request.node.name:
        module = pytest.importorskip("hidraw", reason="hidapi is not installed")
        if not hasattr(module, "device"):
            pytest.skip("another package named hid")


class Calls:
    """A node, and its log."""

    def __init__(self, device: Device | None = None, slow_ms: float = 0.0) -> None:
        self.log: list[Event] = []
        self.node = Node(device or glove(), self.log.append, slow_ms)
        self.node.open(1, 1, 10, "writer", 0)
        self.node.open(2, 2, 11, "watchdog", 0)
        self.answers()

    def answers(self) -> list[Answer]:
        got, self.node.answers = self.node.answers, []
        return got

    def write(self, ticket: int, now: int, handle: int = 1, op: str = "output") -> list[Answer]:
        self.node.write(ticket, op, handle, 10, bytes([1, ticket]), now)
        return self.answers()

    def taken(self) -> list[int]:
        """Tickets of reports that the device has, in its order."""
        return [x.data[1] for x in self.log if x.taken]


class TestNode:
    def test_a_report_is_taken_at_once(self):
        calls = Calls()
        assert calls.write(5, 7) == [Answer(5, result=2)]
        assert calls.log[-1] == Event("output", 1, 10, b"\1\5", 7, 7)

    @pytest.mark.parametrize("size", [0, 1, 16385])
    def test_lengths_that_no_report_has(self, size):
        calls = Calls()
        calls.node.write(3, "output", 1, 10, bytes(size), 0)
        assert calls.answers() == [Answer(3, errno.EINVAL, size)]
        assert not calls.taken()

    def test_a_stalled_device_keeps_every_handle_waiting_in_order(self):
        calls = Calls()
        calls.node.befall(Fault("stall", at=1, ms=50), 0)
        assert calls.write(3, 0)
        assert not calls.write(4, 10)
        assert not calls.write(5, 20, handle=2)
        assert not calls.write(6, 30, op="feature")
        assert calls.node.next_ns() == 10 + 50 * MS
        calls.node.advance(9 + 50 * MS)
        assert not calls.answers()
        calls.node.advance(10 + 50 * MS)
        assert [x.ticket for x in calls.answers()] == [4, 5, 6]
        assert calls.taken() == [3, 4, 5, 6]

    def test_a_write_waits_five_seconds_and_is_not_delivered(self):
        calls = Calls()
        calls.node.befall(Fault("stall", ms=7000), 0)
        assert not calls.write(3, 0)
        assert not calls.write(4, 3000 * MS)
        assert calls.node.next_ns() == 5000 * MS
        calls.node.advance(5000 * MS)
        assert calls.answers() == [Answer(3, errno.ETIMEDOUT, 2)]
        calls.node.advance(7000 * MS)
        assert calls.answers() == [Answer(4, result=2)]
        assert calls.taken() == [4]

    def test_a_stalled_handle_keeps_nobody_else_waiting(self):
        calls = Calls()
        calls.node.befall(Fault("handle-stall", at=0, ms=50), 0)
        assert not calls.write(3, 0)
        assert calls.write(4, 1, handle=2)
        calls.node.advance(50 * MS)
        assert calls.answers() == [Answer(3, result=2)]
        assert calls.taken() == [4, 3]

    def test_bluetooth_takes_later_what_it_accepts_now(self):
        calls = Calls(dualsense("bluetooth"))
        calls.node.befall(Fault("stall", at=0, ms=50), 0)
        assert calls.write(3, 0) == [Answer(3, result=2)]
        assert not calls.taken()
        calls.node.advance(6000 * MS)
        assert calls.taken() == [3]

    def test_a_slow_device_takes_one_after_the_other(self):
        calls = Calls(slow_ms=2)
        calls.write(3, 0)
        calls.write(4, 0, handle=2)
        calls.node.advance(2 * MS)
        assert calls.taken() == [3]
        calls.node.advance(4 * MS)
        assert calls.taken() == [3, 4]

    def test_errors_from_a_report_on_for_so_many(self):
        calls = Calls()
        calls.node.befall(Fault("error", at=1, count=2), 0)
        got = [calls.write(ticket, 0)[0].error for ticket in range(3, 8)]
        assert got == [0, errno.EIO, errno.EIO, 0, 0]

    def test_errors_from_now_on(self):
        calls = Calls()
        calls.write(3, 0)
        calls.node.befall(Fault("error", errno_name="EPIPE"), 0)
        assert [calls.write(x, 0)[0].error for x in (4, 5)] == [errno.EPIPE] * 2
        calls.node.faults.clear()
        assert not calls.write(6, 0)[0].error

    def test_gone_for_everybody(self):
        calls = Calls()
        calls.node.read(3, 2, 64, may_wait=True)
        calls.node.poll(1, 77)
        calls.node.befall(Fault("stall", ms=100), 0)
        calls.write(4, 0)
        calls.node.befall(Fault("unplug", at=1), 0)
        calls.node.write(5, "output", 1, 10, b"\1\5", 1)
        assert {(x.ticket, x.error) for x in calls.answers()} == {
            (3, errno.EIO), (4, errno.ENODEV), (5, errno.ENODEV),
        }  # fmt: skip
        assert calls.node.woken == [77]
        assert calls.node.poll(2, 78) == POLLOUT | POLLERR | POLLHUP
        calls.node.read(6, 2, 64, may_wait=True)
        calls.node.open(7, 3, 12, "late", 2)
        calls.node.get_feature(8, 1, 10, b"\3", 2)
        assert [x.error for x in calls.answers()] == [errno.EIO, errno.ENODEV, errno.ENODEV]
        assert not calls.taken()

    def test_each_handle_reads_every_input_report(self):
        calls = Calls()
        calls.node.poll(1, 77)
        calls.node.read(3, 2, 2, may_wait=True)
        calls.node.say(b"abc")
        assert calls.answers() == [Answer(3, data=b"ab")]
        assert calls.node.woken == [77]
        assert calls.node.poll(1, None) == POLLOUT | POLLIN
        calls.node.read(4, 1, 64, may_wait=False)
        calls.node.read(5, 1, 64, may_wait=False)
        assert calls.answers() == [Answer(4, data=b"abc"), Answer(5, errno.EAGAIN)]

    def test_a_read_that_waits_is_interrupted_and_a_write_is_not(self):
        calls = Calls()
        calls.node.befall(Fault("stall", ms=100), 0)
        calls.write(3, 0)
        calls.node.read(4, 1, 64, may_wait=True)
        calls.node.interrupt(3)
        calls.node.interrupt(4)
        assert calls.answers() == [Answer(4, errno.EINTR)]

    def test_a_feature_report_is_given_back(self):
        calls = Calls()
        calls.node.write(3, "feature", 1, 10, b"\3abc", 0)
        calls.node.get_feature(4, 2, 11, b"\3\0\0", 1)
        calls.node.get_feature(5, 2, 11, b"\4", 1)
        assert calls.answers() == [
            Answer(3, result=4), Answer(4, 0, 3, b"\3ab"), Answer(5, errno.EPIPE),
        ]  # fmt: skip


def test_a_report_descriptor():
    """HID 1.11, 6.2.2: vendor-defined page, one collection, bytes from 0 to 255."""
    assert descriptor([("output", 1, 10), ("feature", 0, 300)]).hex(" ") == (
        "06 00 ff 09 01 a1 01 15 00 26 ff 00 75 08 09 02 85 01 95 0a 91 02 09 02 96 2c 01 b1 02 c0"
    )


@linux
class TestUhid:
    """Against a socket in the place of the kernel."""

    def kernel(self) -> tuple[uhid.Uhid, socket.socket]:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.theirs = theirs
        made = uhid.Uhid(theirs.detach(), glove())
        made.create()
        return made, ours

    def test_the_device_that_it_asks_for(self):
        made, kernel = self.kernel()
        with kernel:
            data = kernel.recv(1 << 16)
            assert len(data) == 4 + 4372  # type and struct uhid_create2_req, which is packed
            assert data[:4] == b"\x0b\0\0\0"
            assert data[4:25] == b"Nobody Virtual Glove\0"
            assert data[196:202] == b"SN0001"
            size, bus, vendor, product = (
                int.from_bytes(data[a:b], "little")
                for a, b in ((260, 262), (262, 264), (264, 268), (268, 272))
            )
            assert (size, bus, vendor, product) == (len(glove().descriptor), 3, 0x1209, 0xC0DE)
            assert data[280 : 280 + size] == glove().descriptor
            os.close(made.fd)

    def test_reports_both_ways(self):
        made, kernel = self.kernel()
        with kernel:
            kernel.recv(1 << 16)
            report = b"\x01" + bytes(range(10))
            said = [
                (4).to_bytes(4, "little"),
                b"\x06\0\0\0" + report.ljust(4096, b"\0") + b"\x0b\0\x01",
                b"\x0d\0\0\0" + b"\x07\0\0\0\x03\x00\x05\0" + b"\x03abcd".ljust(4096, b"\0"),
                b"\x09\0\0\0" + b"\x08\0\0\0\x03\x00",
            ]
            for each in said:
                kernel.send(each)
                made.hear()
            assert [(x.op, x.data) for x in made.log.events] == [
                ("open", b""), ("output", report), ("feature", b"\x03abcd"), ("get", b"\x03abcd"),
            ]  # fmt: skip
            assert kernel.recv(1 << 16) == b"\x0e\0\0\0" + b"\x07\0\0\0\0\0"
            got = kernel.recv(1 << 16)
            assert got[:17] == b"\x0a\0\0\0" + b"\x08\0\0\0" + b"\0\0" + b"\5\0" + b"\x03abcd"
            assert made.command({"do": "fault", "fault": Fault("error").to_json()}) == {}
            kernel.send(said[2])
            made.hear()
            assert kernel.recv(1 << 16) == b"\x0e\0\0\0" + b"\x07\0\0\0\x05\0"
            made.command({"do": "say", "data": "0102"})
            assert kernel.recv(1 << 16) == b"\x0c\0\0\0\2\0\1\2"
            assert "error" in made.command({"do": "fault", "fault": Fault("stall").to_json()})
            made.command({"do": "fault", "fault": Fault("unplug").to_json()})
            assert kernel.recv(1 << 16) == b"\x01\0\0\0"
            os.close(made.fd)


@linux
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
        with world(faults=[Fault("stall", at=3, ms=300)]) as w:
            first = w.python(NEEDS + "for i in range(5): opened.write(bytes([1, i]))")
            w.device.wait_for(lambda events: len(events) == 4)
            second = w.python(NEEDS + "opened.write(b'\\1N')")
            w.device.wait_for(lambda events: sum(x.op == "open" for x in events) == 2)
            first.signal(signal.SIGKILL)
            assert first.wait().returncode == -signal.SIGKILL
            assert second.wait().returncode == 0
            stalled = next(x for x in w.events if x.data == b"\1\3")
            assert stalled.time_ns - stalled.asked_ns >= 300 * MS
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
            end = time.monotonic() + 20
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


@linux
@pytest.mark.parametrize("name", ["SIGKILL", "SIGTERM"])
def test_a_killed_test_leaves_no_world_behind(name):
    number = signal.Signals[name]
    with world(tier="fuse"):
        pass  # skips, and says why, where there is none
    code = SLEEPER.format(tests=str(ROOT / "tests"))
    before = Path("/proc/mounts").read_text(encoding="utf-8")
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as test:
        try:
            assert test.stdout is not None
            keeper = int(test.stdout.readline())
            end = time.monotonic() + 20
            inside: list[int] = []
            while len(inside) < 4:  # process 1, the server, the shell, what it started
                assert time.monotonic() < end, inside
                inside = descendants(keeper)
            test.send_signal(number)
            assert test.wait(20) == -number
        finally:
            test.kill()
    end = time.monotonic() + 20
    while any(alive(pid) for pid in [keeper, *inside]):
        assert time.monotonic() < end, [pid for pid in inside if alive(pid)]
        time.sleep(0.01)
    assert Path("/proc/mounts").read_text(encoding="utf-8") == before


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


@linux
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


@linux
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
