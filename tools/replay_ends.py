"""Where a replay is measured from: a loopback that is a file, and a virtual HID device."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from installed import IMPORTS, ROOT, environment

from replay_cases import Case
from watched import find

from hapfmt.replay.profile.parse import load_profile

sys.path.insert(0, str(ROOT / "tests"))

ENVIRONMENT = environment()
SECONDS = 30.0


class Arrival(NamedTuple):
    """A frame as it came out at the other end."""

    at_ns: int
    """Time of the monotonic clock."""
    pid: int
    data: bytes


class Running(Protocol):
    """A program that plays."""

    def output(self, seconds: float) -> str: ...


class End(Protocol):
    way: str

    def sink(self) -> dict[str, Any]: ...
    def start(self, words: Sequence[str]) -> Running: ...
    def arrivals(self) -> list[Arrival]: ...
    def writer(self, running: Any) -> int: ...
    def kill(self, pid: int) -> None: ...


class Local:
    """A process here."""

    def __init__(self, words: Sequence[str]) -> None:
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
        )

    def output(self, seconds: float) -> str:
        out, errors = self.process.communicate(timeout=seconds)
        if not out:
            raise RuntimeError(errors)
        return out


class Loopback:
    way = "loopback"

    def __init__(self, folder: Path) -> None:
        self.log = folder / "frames.jsonl"

    def sink(self) -> dict[str, Any]:
        self.log.unlink(missing_ok=True)
        return {"kind": "loopback", "file": str(self.log)}

    def start(self, words: Sequence[str]) -> Local:
        return Local(words)

    def arrivals(self) -> list[Arrival]:
        if not self.log.exists():
            return []
        text = self.log.read_text("ascii")
        lines = map(json.loads, text[: text.rfind("\n") + 1].splitlines())
        return [
            Arrival(line["at_ns"], line["by"], bytes.fromhex(line["reports"][0][1]))
            for line in lines
        ]

    def writer(self, running: Local) -> int:
        return find(running.process.pid, "process.writer")

    def kill(self, pid: int) -> None:
        os.kill(pid, signal.SIGKILL)


class Hid:
    """hidapi as it is, and a hidraw node in a world of its own (tests/virtual_hid)."""

    way = "virtual HID"

    def __init__(self, world: Any) -> None:
        self.world = world
        self.before = 0

    def sink(self) -> dict[str, Any]:
        self.before = len(self.world.reports)
        return {"kind": "hid", "path": self.world.path}

    def start(self, words: Sequence[str]) -> Any:
        return Inside(self.world.start(list(words), env=IMPORTS))

    def arrivals(self) -> list[Arrival]:
        return [Arrival(x.time_ns, x.pid, x.data) for x in self.world.reports[self.before :]]

    def writer(self, running: Any) -> int:  # noqa: ARG002
        return int(self.world.process("process.writer"))

    def kill(self, pid: int) -> None:
        self.world.signal(pid, signal.SIGKILL)


class Inside:
    """A process of the world."""

    def __init__(self, running: Any) -> None:
        self.running = running

    def output(self, seconds: float) -> str:
        done = self.running.wait(seconds)
        if not done.stdout:
            raise RuntimeError(done.stderr)
        return str(done.stdout)


@contextmanager
def opened(way: str, case: Case, folder: Path) -> Iterator[End]:
    """A device that fits the profile. Raises RuntimeError, with the reason, where there is none."""
    if way == "loopback":
        yield Loopback(folder)
        return
    from virtual_hid.descriptors import descriptor, dualsense
    from virtual_hid.model import Device
    from virtual_hid.world import UnavailableError, open_world

    profile = load_profile(case.profile)
    reports = [("output", each.id, each.length - 1) for each in profile.reports]
    made = Device(descriptor=descriptor(reports, usage=profile.matches[0].usage or 1))
    device = dualsense("bluetooth") if case.frame_samples > 1 else made
    try:
        with open_world(device=device) as world:
            yield Hid(world)
    except UnavailableError as error:
        raise RuntimeError(str(error)) from None


def wait_for(end: End, count: int) -> list[Arrival]:
    """Wait until this number of frames has come out."""
    latest = time.monotonic() + SECONDS
    while len(found := end.arrivals()) < count:
        if time.monotonic() > latest:
            raise RuntimeError(f"{len(found)} frames in {SECONDS:g} s")
        time.sleep(0.002)
    return found
