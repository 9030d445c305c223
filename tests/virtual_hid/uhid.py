"""A device made by the kernel itself: /dev/uhid, as Documentation/hid/uhid.rst has it.

The kernel then makes a true hidraw node. It hands over output reports after ``write`` has
returned, so that nothing can be refused or stalled but feature reports; who wrote is not told.
"""

from __future__ import annotations

import errno
import os
import select
import struct
import time
from pathlib import Path
from typing import Any

from .channel import Channel
from .log import Log
from .model import BUSES, Device, Event, Fault

DESTROY, START, STOP, OPEN, CLOSE, OUTPUT = 1, 2, 3, 4, 5, 6
GET_REPORT, GET_REPORT_REPLY, CREATE2, INPUT2, SET_REPORT, SET_REPORT_REPLY = 9, 10, 11, 12, 13, 14
KIND = struct.Struct("<I")
CREATE2_IN = struct.Struct("<128s64s64sHHIIII4096s")
OUTPUT_OUT = struct.Struct("<4096sHB")
SET_OUT = struct.Struct("<IBBH4096s")
SET_IN = struct.Struct("<IH")
GET_OUT = struct.Struct("<IBB")
GET_IN = struct.Struct("<IHH4096s")
INPUT2_IN = struct.Struct("<H4096s")
EVENT_SIZE = 4380  # of struct uhid_event, which is packed
FAULTS = ("unplug", "error")
SECONDS = 60.0


class Uhid:
    """``fd``: of /dev/uhid, or of what stands for it in a test."""

    def __init__(self, fd: int, device: Device) -> None:
        self.fd, self.device = fd, device
        self.mark = f"virtual/{os.getpid()}"
        self.log = Log()
        self.features: dict[int, bytes] = {}
        self.error = 0
        self.opened = 0

    def put(self, kind: int, body: bytes = b"") -> None:
        os.write(self.fd, KIND.pack(kind) + body)

    def create(self) -> None:
        device = self.device
        name = f"{device.manufacturer} {device.name}".encode()
        self.put(
            CREATE2,
            CREATE2_IN.pack(
                name, self.mark.encode(), device.serial.encode(), len(device.descriptor),
                BUSES[device.bus], device.vendor_id, device.product_id, 0x100, 0, device.descriptor,
            ),
        )  # fmt: skip

    def destroy(self) -> None:
        self.put(DESTROY)

    def say(self, data: bytes) -> None:
        self.put(INPUT2, INPUT2_IN.pack(len(data), data)[: 2 + len(data)])

    def hear(self) -> None:
        """One event of the kernel."""
        data = os.read(self.fd, EVENT_SIZE)
        (kind,), body = KIND.unpack_from(data), data[KIND.size :]
        if kind in (OPEN, CLOSE):  # of the first handle, and of the last
            self.opened += kind == OPEN
            self.note("open" if kind == OPEN else "close")
        elif kind == OUTPUT:
            report, size, which = OUTPUT_OUT.unpack_from(body)
            self.note("output" if which == 1 else "feature", report[:size])
        elif kind == SET_REPORT:
            ticket, number, _, size, report = SET_OUT.unpack(
                body[: SET_OUT.size].ljust(SET_OUT.size, b"\0")
            )
            if not self.error:
                self.features[number] = report[:size]
            self.note("feature", report[:size], self.error)
            self.put(SET_REPORT_REPLY, SET_IN.pack(ticket, self.error))
        elif kind == GET_REPORT:
            ticket, number, _ = GET_OUT.unpack_from(body)
            held = self.features.get(number)
            error = errno.EPIPE if held is None else self.error
            self.note("get", held or bytes([number]), error)
            self.put(GET_REPORT_REPLY, GET_IN.pack(ticket, error, len(held or b""), held or b""))

    def note(self, op: str, data: bytes = b"", error: int = 0) -> None:
        now = time.monotonic_ns()
        self.log.add(Event(op, self.opened, 0, data, now, now, error))

    def path(self) -> str:
        """Of the node that the kernel made; empty while there is none."""
        for raw in Path("/sys/class/hidraw").glob("hidraw*"):
            told = (raw / "device" / "uevent").read_text(encoding="utf-8", errors="replace")
            if f"HID_PHYS={self.mark}" in told.splitlines() and Path(f"/dev/{raw.name}").exists():
                return f"/dev/{raw.name}"
        return ""

    def command(self, message: dict[str, Any]) -> dict[str, Any]:
        match message.pop("do"):
            case "events":
                return self.log.since(message["first"])
            case "fault":
                return self.befall(Fault(**message["fault"]))
            case "clear":
                self.error = 0
            case "say":
                self.say(bytes.fromhex(message["data"]))
            case other:
                return {"error": f"no such command: {other}"}
        return {}

    def befall(self, fault: Fault) -> dict[str, Any]:
        if fault.kind not in FAULTS or fault.at is not None or fault.count is not None:
            return {"error": f"uhid cannot do this: {fault}"}
        if fault.kind == "unplug":
            self.destroy()
        else:
            self.error = getattr(errno, fault.errno_name)
        return {}


def main(channel: Channel, device: Device) -> None:
    try:
        fd = os.open("/dev/uhid", os.O_RDWR)
    except OSError as error:
        channel.send({"error": f"/dev/uhid: {error.strerror}"})
        return
    made = Uhid(fd, device)
    made.create()
    end = time.monotonic() + SECONDS
    path = ""
    while not path and time.monotonic() < end:
        if select.select([fd], [], [], 0.01)[0]:
            made.hear()
        path = made.path()
    channel.send({"path": path} if path else {"error": "uhid made no hidraw node"})
    while path:
        ready, _, _ = select.select([fd, channel.fileno()], [], [])
        if fd in ready:
            made.hear()
        if channel.fileno() in ready:
            try:
                channel.send(made.command(channel.receive()))
            except (EOFError, ConnectionError):
                return  # the kernel removes the device with the last of its files
