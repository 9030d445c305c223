"""A device by umockdev: for where neither uhid nor FUSE nor namespaces may be had.

umockdev is a library that is loaded before a program's own (LD_PRELOAD) and gives its opens, writes
and ioctls of one node to this process. hidapi itself is unchanged, but what is below it is not the
kernel. Faults work as they do by FUSE; which process calls, and when it closes, is not told. One device, and programs
that are linked dynamically. Debian: umockdev, gir1.2-umockdev-1.0, python3-gi.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import time
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from . import sysfs
from .behaviour import Answer, Node
from .channel import Channel
from .control import command
from .log import Log
from .model import BUSES, Device

PRELOAD = "libumockdev-preload.so.0"
NODE = "/dev/hidraw0"
ENOTTY, EINVAL = 25, 22


@cache
def python() -> str:
    """One that has the bindings; empty where there is none."""
    check = "import gi; gi.require_version('UMockdev', '1.0'); from gi.repository import UMockdev"
    for each in dict.fromkeys([sys.executable, "/usr/bin/python3"]):
        if shutil.which(each):
            done = subprocess.run([each, "-c", check], capture_output=True, check=False)
            if done.returncode == 0:
                return each
    return ""


def environment() -> dict[str, str]:
    """Of a program that is to see the device; UMOCKDEV_DIR comes from the server."""
    before = os.environ.get("LD_PRELOAD")
    return {"LD_PRELOAD": f"{PRELOAD}:{before}" if before else PRELOAD}


class Server:
    def __init__(self, library: Any, device: Device, slow_ms: float) -> None:
        self.library, self.device = library, device
        self.log = Log()
        self.node = Node(device, self.log.add, slow_ms)
        self.clients: dict[Any, int] = {}
        self.opened = self.asked = 0
        self.waiting: dict[int, tuple[Any, Any]] = {}
        """Calls that wait, with where their result goes."""

    def connected(self, client: Any) -> None:
        self.opened += 1
        self.clients[client] = self.opened
        self.node.open(0, self.opened, 0, "", time.monotonic_ns())

    def ticket(self, client: Any, place: Any = None) -> int:
        self.asked += 1
        self.waiting[self.asked] = (client, place)
        return self.asked

    def write(self, client: Any) -> None:
        data = bytes(client.get_arg().retrieve())
        ticket = self.ticket(client)
        self.node.write(ticket, "output", self.clients[client], 0, data, time.monotonic_ns())
        self.answer()

    def read(self, client: Any) -> None:
        """What is there: there is no waiting here, as poll is not handled."""
        self.node.read(self.ticket(client), self.clients[client], 1 << 14, may_wait=False)
        self.answer()

    def ioctl(self, client: Any) -> None:
        """As <linux/hidraw.h> numbers them."""
        code, device = client.get_request(), self.device
        letter, number, size = chr(code >> 8 & 0xFF), code & 0xFF, code >> 16 & 0x3FFF
        constant = {
            1: struct.pack("<i", len(device.descriptor)),
            2: struct.pack("<I", len(device.descriptor)) + device.descriptor,
            3: struct.pack("<IHH", BUSES[device.bus], device.vendor_id, device.product_id),
        }
        now, handle = time.monotonic_ns(), self.clients[client]
        if letter != "H" or number not in (1, 2, 3, 6, 7):
            client.complete(-1, ENOTTY if letter != "H" else EINVAL)
            return
        place = client.get_arg().resolve(0, size)
        if number in constant:
            place.update(0, constant[number])
            client.complete(0, 0)
        elif number == 6:
            data = bytes(place.retrieve())
            self.node.write(self.ticket(client), "feature", handle, 0, data, now)
        else:
            data = bytes(place.retrieve())
            self.node.get_feature(self.ticket(client, place), handle, 0, data, now)
        self.answer()

    def answer(self) -> None:
        """What the node has by now; then again when the next report is due."""
        self.node.advance(time.monotonic_ns())
        for each in self.node.answers:
            if each.ticket:
                self.complete(each)
        self.node.answers.clear()
        self.node.woken.clear()
        due = self.node.next_ns()
        if due is not None:
            left_ms = max(0, -(-(due - time.monotonic_ns()) // 1_000_000))
            self.library.timeout_add(left_ms, self.again)

    def again(self) -> bool:
        self.answer()
        return False

    def complete(self, each: Answer) -> None:
        client, place = self.waiting.pop(each.ticket)
        if place is not None and not each.error:
            place.update(0, each.data)
        client.complete(-1 if each.error else each.result or len(each.data), each.error)


def main() -> None:
    """``fd device slow folder``: the test's socket; what to be; where the testbed may lie."""
    fd, text, slow_ms, folder = sys.argv[1:]
    os.environ["TMPDIR"] = folder
    gi = import_module("gi")
    gi.require_version("UMockdev", "1.0")
    umockdev: Any = import_module("gi.repository.UMockdev")
    glib: Any = import_module("gi.repository.GLib")
    channel = Channel(socket.socket(fileno=int(fd)))
    server = Server(glib, Device.from_json(json.loads(text)), float(slow_ms))

    class Handler(umockdev.IoctlBase):  # type: ignore[misc]
        """Handled is what they say of each call, whenever it is completed."""

        def do_client_connected(self, client: Any) -> None:
            server.connected(client)

        def do_handle_ioctl(self, client: Any) -> bool:
            server.ioctl(client)
            return True

        def do_handle_write(self, client: Any) -> bool:
            server.write(client)
            return True

        def do_handle_read(self, client: Any) -> bool:
            server.read(client)
            return True

    bed = umockdev.Testbed.new()
    root = Path(bed.get_root_dir())
    shutil.rmtree(root / "sys")
    sysfs.build(root / "sys", [server.device], "")
    (root / "dev").mkdir(exist_ok=True)
    (root / NODE[1:]).touch()
    bed.attach_ioctl(NODE, Handler())
    loop = glib.MainLoop()

    def asked(*_: Any) -> bool:
        try:
            channel.send(command(server.node, server.log, channel.receive()))
        except (EOFError, ConnectionError):
            loop.quit()
            return False
        if server.node.gone:
            sysfs.remove(root / "sys", 0)
        server.answer()
        return True

    glib.unix_fd_add_full(glib.PRIORITY_DEFAULT, channel.fileno(), glib.IOCondition.IN, asked)
    channel.send({"path": NODE, "env": {"UMOCKDEV_DIR": str(root)}})
    loop.run()
