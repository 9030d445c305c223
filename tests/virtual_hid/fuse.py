"""Serves one device as a FUSE file system whose root is one file, the hidraw node.

One thread, no waiting but for the kernel, the test, and the next report that is due: what stalls
does not keep other handles from being served.
"""

from __future__ import annotations

import errno
import gc
import os
import select
import struct
import time
from pathlib import Path

from . import fuse_wire as wire
from . import sysfs
from .behaviour import Answer, Node
from .channel import Channel
from .control import command
from .linux import MS_NODEV, MS_NOSUID, mount, real_time
from .log import Log, Processes
from .model import BUSES, Device

PRIORITY = 60  # above the player's, so that what is measured is the player
READ_SIZE = wire.LARGEST + 4096


class Server:
    def __init__(self, device: Device, number: int, slow_ms: float = 0.0) -> None:
        self.device = device
        self.number: int | None = number
        """In /sys; None: no longer there."""
        self.log = Log()
        self.processes = Processes()
        self.node = Node(device, self.log.add, slow_ms)
        self.owner = (os.getuid(), os.getgid())
        self.opened = 0
        self.asked: dict[int, int] = {}
        """Requests that wait, with what they are."""

    def mount(self, path: str, fuse: str) -> None:
        self.fd = os.open(fuse, os.O_RDWR)
        user, group = self.owner
        options = f"fd={self.fd},rootmode=100000,user_id={user},group_id={group},allow_other"
        mount("vhid", path, "fuse", MS_NOSUID | MS_NODEV, options)

    def serve(self, channel: Channel) -> None:
        """Until the test or the mount goes."""
        while True:
            due = self.node.next_ns()
            pause = None if due is None else max(0, due - time.monotonic_ns()) / 1e9
            ready, _, _ = select.select([self.fd, channel.fileno()], [], [], pause)
            self.node.advance(time.monotonic_ns())
            if self.fd in ready and not self.kernel():
                return
            if channel.fileno() in ready:
                try:
                    channel.send(command(self.node, self.log, channel.receive()))
                except (EOFError, ConnectionError):
                    return
            self.flush()
            if self.node.gone and self.number is not None:
                sysfs.remove(Path("/sys"), self.number)
                self.number = None

    # -- the kernel

    def kernel(self) -> bool:
        """One request; False when there will be no more."""
        try:
            data = os.read(self.fd, READ_SIZE)
        except OSError as error:
            if error.errno in (errno.ENODEV, errno.EBADF):
                return False
            if error.errno in (errno.EINTR, errno.ENOENT, errno.EAGAIN):
                return True
            raise
        head, body = wire.request(data)
        if head.opcode == wire.DESTROY:
            return False
        if head.opcode not in wire.WITHOUT_ANSWER:
            self.request(head, body)
        return True

    def request(self, head: wire.Request, body: bytes) -> None:
        now = time.monotonic_ns()
        ticket, node = head.ticket, self.node
        self.asked[ticket] = head.opcode
        match head.opcode:
            case wire.WRITE:
                handle, _, size, *_ = wire.WRITE_IN.unpack_from(body)
                report = body[wire.WRITE_IN.size :][:size]
                node.write(ticket, "output", handle, self.processes.of(head.pid), report, now)
            case wire.IOCTL:
                self.ioctl(head, body, now)
            case wire.READ:
                handle, _, size, _, _, flags, _ = wire.READ_IN.unpack_from(body)
                node.read(ticket, handle, size, wire.may_wait(flags))
            case wire.POLL:
                handle, poller, flags, _ = wire.POLL_IN.unpack_from(body)
                ready = node.poll(handle, poller if flags & wire.POLL_SCHEDULE_NOTIFY else None)
                self.reply(ticket, struct.pack("<II", ready, 0))
            case wire.OPEN:
                self.opened += 1
                pid = self.processes.of(head.pid)
                node.open(ticket, self.opened, pid, self.processes.program(pid), now)
            case wire.RELEASE:
                (handle,) = struct.unpack_from("<Q", body)
                node.close(ticket, handle, self.processes.of(head.pid), now)
            case wire.INTERRUPT:
                del self.asked[ticket]  # which has no answer of its own
                node.interrupt(*struct.unpack_from("<Q", body))
            case wire.INIT:
                self.reply(ticket, wire.init())
            case wire.GETATTR | wire.SETATTR:
                self.reply(ticket, wire.attributes(self.owner))
            case wire.FLUSH | wire.FSYNC | wire.ACCESS:
                self.reply(ticket)
            case _:
                self.reply(ticket, error=errno.ENOSYS)

    def ioctl(self, head: wire.Request, body: bytes, now: int) -> None:
        """As <linux/hidraw.h> numbers them."""
        handle, _, code, _, given, _ = wire.IOCTL_IN.unpack_from(body)
        data = body[wire.IOCTL_IN.size :][:given]
        letter, number, size = wire.ioctl(code)
        device, pid = self.device, self.processes.of(head.pid)
        texts = {4: f"{device.manufacturer} {device.name}", 5: "virtual/input0", 8: device.serial}
        if self.node.gone:
            self.reply(head.ticket, error=errno.ENODEV)
        elif letter == "H" and number == 1:
            self.reply(head.ticket, wire.ioctl_result(0, struct.pack("<i", len(device.descriptor))))
        elif letter == "H" and number == 2:
            text = struct.pack("<I", len(device.descriptor)) + device.descriptor
            self.reply(head.ticket, wire.ioctl_result(0, text))
        elif letter == "H" and number == 3:
            ids = struct.pack("<IHH", BUSES[device.bus], device.vendor_id, device.product_id)
            self.reply(head.ticket, wire.ioctl_result(0, ids))
        elif letter == "H" and number in texts:
            text = (texts[number].encode() + b"\0")[:size]
            self.reply(head.ticket, wire.ioctl_result(len(text), text))
        elif letter == "H" and number == 6:
            self.node.write(head.ticket, "feature", handle, pid, data, now)
        elif letter == "H" and number == 7:
            self.node.get_feature(head.ticket, handle, pid, data, now)
        else:
            self.reply(head.ticket, error=errno.EINVAL if letter == "H" else errno.ENOTTY)

    # -- answers

    def flush(self) -> None:
        for each in self.node.answers:
            self.reply(each.ticket, self.body(each), each.error)
        self.node.answers.clear()
        for poller in self.node.woken:
            self.put(wire.woken(poller))
        self.node.woken.clear()

    def body(self, each: Answer) -> bytes:
        match self.asked[each.ticket]:
            case wire.WRITE:
                return struct.pack("<II", each.result, 0)
            case wire.IOCTL:
                return wire.ioctl_result(each.result, each.data)
            case wire.OPEN:
                return wire.opened(each.result)
            case _:
                return each.data

    def reply(self, ticket: int, body: bytes = b"", error: int = 0) -> None:
        self.asked.pop(ticket, None)
        self.put(wire.answer(ticket, b"" if error else body, error))

    def put(self, data: bytes) -> None:
        try:
            os.write(self.fd, data)
        except OSError as error:
            if error.errno != errno.ENOENT:  # who asked has gone
                raise


def main(
    channel: Channel, device: Device, number: int, slow_ms: float, path: str, fuse: str
) -> None:
    """Mounts, says so, and serves."""
    server = Server(device, number, slow_ms)
    try:
        server.mount(path, fuse)
    except OSError as error:
        channel.send({"error": f"{fuse}: {error.strerror or error}"})
        return
    gc.disable()
    refused = real_time(PRIORITY)
    channel.send({"path": path, "refused": refused})
    server.serve(channel)
