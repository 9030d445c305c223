"""A private world with virtual HID devices, in which any command runs: the API for tests.

with world(device=glove(), faults=[Fault("error", at=100)]) as w:
    done = w.run([sys.executable, "-m", "hapfmt", "replay", ...])
    assert w.reports[-1].data == ...
"""

from __future__ import annotations

import array
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import IO, Any

from . import umock
from .channel import Channel
from .descriptors import glove
from .model import Device, Event, Fault, Setup
from .running import SECONDS, Running
from .virtual import Virtual

TESTS = Path(__file__).resolve().parent.parent
START = (
    f"import sys; sys.path.insert(0, {str(TESTS)!r});from virtual_hid.keeper import main; main()"
)
MESSAGE = 1 << 20
BEGIN_SECONDS = 60.0


class UnavailableError(Exception):
    """No virtual device can be had here; the message says why."""


class World:
    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.codes: dict[int, int] = {}
        """Exit codes of what has ended, orphans too: process -> code, or minus the signal."""
        self.commands: list[Running] = []
        self.control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        pairs = [socket.socketpair() for _ in setup.devices]
        given = [theirs, *(inner for _, inner in pairs)]
        text = json.dumps({**asdict(setup), "devices": [x.to_json() for x in setup.devices]})
        self.keeper = subprocess.Popen(
            [sys.executable, "-S", "-E", "-c", START, str(os.getpid()), text]
            + [str(each.fileno()) for each in given],
            pass_fds=[each.fileno() for each in given], stdin=subprocess.DEVNULL,
        )  # fmt: skip
        for each in given:
            each.close()
        self.devices = [
            Virtual(device, Channel(outer))
            for device, (outer, _) in zip(setup.devices, pairs, strict=True)
        ]

    def begin(self, faults: Sequence[Sequence[Fault]]) -> None:
        """Waits for it to be there; UnavailableError where it cannot."""
        try:
            message = self.message(BEGIN_SECONDS)
        except EOFError:
            message = {"error": "no namespaces of its own, and no word why"}
        if "error" in message:
            raise UnavailableError(message["error"])
        for device, theirs in zip(self.devices, faults, strict=True):
            if reason := device.begin():
                raise UnavailableError(reason)
            for fault in theirs:
                device.befall(fault)

    def close(self) -> None:
        """With all that is left in it."""
        self.control.close()
        for device in self.devices:
            device.channel.close()
        try:
            self.keeper.wait(BEGIN_SECONDS)
        finally:
            self.keeper.kill()
            self.keeper.wait()
            for each in self.commands:
                each.close()

    # -- the first device, where there is but one

    @property
    def device(self) -> Virtual:
        return self.devices[0]

    @property
    def path(self) -> str:
        return self.device.path

    @property
    def events(self) -> list[Event]:
        return self.device.events

    @property
    def reports(self) -> list[Event]:
        return self.device.reports

    # -- commands

    def start(
        self,
        words: Sequence[object],
        *,
        stdin: IO[bytes] | None = None,
        env: Mapping[str, str] | None = None,
        cwd: object = None,
    ) -> Running:
        """``env`` comes on top of what the test has."""
        running = Running(self, [str(word) for word in words], stdin)
        self.commands.append(running)
        added = {"SYSTEMD_DEVICE_VERIFY_SYSFS": "0", **self.device.env}
        if self.setup.tier == "umockdev":
            added |= umock.environment()
        message = {
            "do": "start",
            "words": running.words,
            "env": {**os.environ, **added, **(env or {})},
            "cwd": str(cwd or Path.cwd()),
        }
        files = array.array("i", running.files())
        data = json.dumps(message).encode()
        self.control.sendmsg([data], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, files)])
        running.pid = self.answer()["pid"]
        return running

    def run(
        self, words: Sequence[object], *, seconds: float = SECONDS, **others: Any
    ) -> subprocess.CompletedProcess[str]:
        return self.start(words, **others).wait(seconds)

    def python(self, code: str, *words: object, **others: Any) -> Running:
        return self.start([sys.executable, "-W", "error", "-c", code, *words], **others)

    def signal(self, pid: int, number: int) -> None:
        self.ask(do="signal", pid=pid, signal=number)

    def processes(self) -> list[dict[str, Any]]:
        """All that run in the world: pid, parent, words. Its devices' servers are pythons too."""
        found: list[dict[str, Any]] = self.ask(do="processes")["processes"]
        return found

    def process(self, word: str, seconds: float = SECONDS) -> int:
        """The one that has this among its words, as soon as there is one."""
        end = time.monotonic() + seconds
        while True:
            for each in self.processes():
                if any(word in x for x in each["words"]):
                    return int(each["pid"])
            if time.monotonic() > end:
                raise TimeoutError(f"no process with {word!r} in {seconds} s")
            time.sleep(0.005)

    def code(self, pid: int, seconds: float = SECONDS) -> int:
        """With which the process ended, which may be anybody's."""
        end = time.monotonic() + seconds
        while pid not in self.codes:
            left = end - time.monotonic()
            if left <= 0:
                raise TimeoutError(f"process {pid} has not ended")
            self.hear(left)
        return self.codes[pid]

    # -- messages

    def ask(self, **message: Any) -> dict[str, Any]:
        self.control.send(json.dumps(message).encode())
        return self.answer()

    def answer(self) -> dict[str, Any]:
        while True:
            message = self.message(BEGIN_SECONDS)
            if "ended" in message:
                self.codes[message["ended"]] = message["code"]
            elif "error" in message:
                raise ValueError(message["error"])
            else:
                return message

    def hear(self, seconds: float) -> None:
        """What has ended; nothing else comes unasked."""
        ready, _, _ = select.select([self.control], [], [], max(0, seconds))
        if ready:
            message = self.message(0)
            self.codes[message["ended"]] = message["code"]

    def message(self, seconds: float) -> dict[str, Any]:
        ready, _, _ = select.select([self.control], [], [], seconds)
        if not ready:
            raise TimeoutError("the world does not answer")
        data = self.control.recv(MESSAGE)
        if not data:
            raise EOFError("the world has ended")
        message: dict[str, Any] = json.loads(data)
        return message


@contextmanager
def open_world(
    device: Device | None = None,
    faults: Sequence[Fault] = (),
    *,
    devices: Sequence[tuple[Device, Sequence[Fault]]] = (),
    slow_ms: float = 0.0,
    tier: str = "",
    fuse: str = "/dev/fuse",
) -> Iterator[World]:
    """One device (a glove) with its faults, or several with theirs; UnavailableError."""
    all_of_them = list(devices) or [(device or glove(), faults)]
    faulty = slow_ms > 0 or any(theirs for _, theirs in all_of_them)
    tier = tier or choose(faulty)
    if tier == "umockdev" and len(all_of_them) > 1:
        raise UnavailableError("umockdev serves one device here")
    with ExitStack() as stack:
        told = [tier, fuse]
        if tier == "umockdev":
            told += [umock.python(), stack.enter_context(tempfile.TemporaryDirectory())]
        setup = Setup(tuple(x for x, _ in all_of_them), (slow_ms,) * len(all_of_them), *told)
        made = World(setup)
        stack.callback(made.close)
        made.begin([x for _, x in all_of_them])
        yield made


def choose(faulty: bool) -> str:
    """The kernel's own uhid where there is one and it can do what is asked, else FUSE, else
    umockdev."""
    if sys.platform != "linux":
        raise UnavailableError("virtual devices are of Linux")
    reasons = []
    if faulty:
        reasons.append("uhid knows no faults")
    elif not os.access("/dev/uhid", os.R_OK | os.W_OK):
        reasons.append("no /dev/uhid that may be written")
    else:
        return "uhid"
    if reason := why_no_fuse():
        if umock.python():
            return "umockdev"
        raise UnavailableError("; ".join([*reasons, reason, "no umockdev"]))
    return "fuse"


@cache
def why_no_fuse() -> str:
    """Found out by trying; empty where it can be had."""
    if not Path("/dev/fuse").exists():
        return "no /dev/fuse"
    try:
        with open_world(tier="fuse") as made:
            done = made.run(["cat", "/sys/class/hidraw/hidraw0/dev"])
            return "" if done.returncode == 0 else done.stderr
    except (UnavailableError, TimeoutError) as error:
        return str(error)


@contextmanager
def world(*positional: Any, **named: Any) -> Iterator[World]:
    """As ``open_world``; where there is none the test is skipped, and says why."""
    import pytest

    with ExitStack() as stack:
        try:
            made = stack.enter_context(open_world(*positional, **named))
        except UnavailableError as error:
            pytest.skip(str(error))
        yield made
