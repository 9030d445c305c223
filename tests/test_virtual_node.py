"""A hidraw node and a device of uhid, without any kernel."""

from __future__ import annotations

import errno
import os
import socket
import sys

import pytest
from virtual_hid import uhid
from virtual_hid.behaviour import MS, POLLERR, POLLHUP, POLLIN, POLLOUT, Answer, Node
from virtual_hid.descriptors import descriptor, dualsense, glove
from virtual_hid.model import Device, Event, Fault

linux = pytest.mark.skipif(sys.platform != "linux", reason="its sockets are of Linux")


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
