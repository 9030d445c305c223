"""The processes of a running program, seen from outside (Linux): who they are, CPU time, memory."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import NamedTuple

PROC = Path("/proc")
TICK = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


class Seen(NamedTuple):
    """One look at a process."""

    at: float
    cpu_s: float
    peak_size: int
    """Bytes it held at most until then."""


def command(pid: int) -> str:
    return (PROC / str(pid) / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")


def children(pid: int) -> list[int]:
    """Those it started, and theirs."""
    found: list[int] = []
    for task in (PROC / str(pid) / "task").glob("*/children"):
        for child in map(int, task.read_text("ascii").split()):
            found += [child, *children(child)]
    return found


def look(pid: int) -> Seen:
    fields = (PROC / str(pid) / "stat").read_text("utf-8").rpartition(")")[2].split()
    status = (PROC / str(pid) / "status").read_text("utf-8").splitlines()
    peak = next((int(line.split()[1]) for line in status if line.startswith("VmHWM")), 0)
    return Seen(time.monotonic(), (int(fields[11]) + int(fields[12])) / TICK, 1024 * peak)


def find(parent: int, name: str, within_s: float = 10.0) -> int:
    """The first process below ``parent`` with ``name`` in its command line."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            for pid in children(parent):
                if name in command(pid):
                    return pid
        except OSError:
            pass
        time.sleep(0.002)
    raise RuntimeError(f"no process {name!r} below {parent} within {within_s:g} s")


class Watched:
    """Looks at a process and those below it twice a second, as long as the block lasts."""

    def __init__(self, pid: int, names: tuple[str, ...]) -> None:
        self.pid, self.names = pid, names
        self.looks: dict[str, list[Seen]] = {}
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.work, daemon=True)

    def work(self) -> None:
        while not self.ended.wait(0.5):
            try:
                for pid in (self.pid, *children(self.pid)):
                    line = command(pid)
                    name = next((name for name in self.names if name in line), None)
                    if name is None and pid == self.pid:
                        name = "player"
                    if name:
                        self.looks.setdefault(name, []).append(look(pid))
            except (OSError, ValueError, IndexError):  # it ends while it is looked at
                continue

    def __enter__(self) -> Watched:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        self.thread.join()

    def cpu_share(self, name: str) -> float | None:
        """CPU seconds of a second, between the first look and the last."""
        looks = self.looks.get(name, [])
        if len(looks) < 2:
            return None
        return (looks[-1].cpu_s - looks[0].cpu_s) / (looks[-1].at - looks[0].at)

    def peak_size(self, name: str) -> int | None:
        return max((seen.peak_size for seen in self.looks.get(name, [])), default=None)
