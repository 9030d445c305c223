"""Runs an implementation: one process for each verb, or one that serves many; time and memory are
capped."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import shlex
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from .schema import check

SHORTEST, LONGEST = 0.001, 0.02
"""Seconds between two looks at a process."""
TAIL = 2000


@dataclass(frozen=True)
class Caps:
    """Of one verb."""

    seconds: float = 30.0
    memory: int = 1 << 30


@dataclass(frozen=True)
class Outcome:
    """``code`` is None where the process ended by no exit code: ``why`` says how."""

    code: int | None
    seconds: float
    peak: int | None = None
    why: str = ""
    errors: str = ""


class UnusableError(Exception):
    """The implementation cannot be run, or says nothing of itself."""


class Implementation:
    """A command that takes the verbs of conformance/README.md. Threads may share it."""

    def __init__(
        self,
        command: str | Sequence[str],
        caps: Caps | None = None,
        cwd: Path | None = None,
        *,
        serve: bool = True,
    ) -> None:
        self.command = shlex.split(command) if isinstance(command, str) else list(command)
        self.caps = caps or Caps()
        self.cwd = cwd
        self.capabilities = self.ask()
        self.serves = serve and "serve" in self.capabilities["verbs"] and os.name == "posix"
        self.local = threading.local()
        self.servers: list[Server] = []

    @property
    def name(self) -> str:
        return str(self.capabilities.get("name") or self.command[0])

    def has(self, verb: str) -> bool:
        return verb in self.capabilities["verbs"]

    def ask(self) -> dict[str, Any]:
        with tempfile.TemporaryFile() as out:
            try:
                done = run_once([*self.command, "capabilities"], self.caps, self.cwd, out)
            except OSError as error:
                raise UnusableError(f"{shlex.join(self.command)}: {error}") from None
            out.seek(0)
            text = out.read().decode("utf-8", "replace")
        try:
            told = json.loads(text)
        except ValueError:
            told = None
        if done.code != 0 or not isinstance(told, dict):
            raise UnusableError(
                f"{shlex.join(self.command)} capabilities: exit code {done.code}, no JSON object"
                f"{': ' + done.errors.strip() if done.errors.strip() else ''} {done.why}".rstrip()
            )
        problems = check(told, "capabilities", "capabilities")
        if problems:
            raise UnusableError(f"{shlex.join(self.command)}: {problems[0]}")
        return told

    def call(self, *arguments: str | Path) -> Outcome:
        """One verb with its arguments."""
        argv = [str(argument) for argument in arguments]
        if not self.serves:
            return run_once([*self.command, *argv], self.caps, self.cwd)
        server: Server | None = getattr(self.local, "server", None)
        if server is None or not server.alive:
            server = self.local.server = Server([*self.command, "serve"], self.caps, self.cwd)
            self.servers.append(server)
        return server.call(argv)

    def close(self) -> None:
        for server in self.servers:
            server.close()
            server.errors.close()


def begin(command: Sequence[str], cwd: Path | None, **streams: Any) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, cwd=cwd, start_new_session=os.name == "posix", **streams)


def kill(process: subprocess.Popen[bytes]) -> None:
    """It, and what it started."""
    try:
        if os.name == "posix":
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    except ProcessLookupError:
        pass


def run_once(
    command: Sequence[str], caps: Caps, cwd: Path | None, out: IO[bytes] | None = None
) -> Outcome:
    with tempfile.TemporaryFile() as errors:
        began = time.monotonic()
        process = begin(
            command, cwd, stdin=subprocess.DEVNULL, stdout=out or subprocess.DEVNULL, stderr=errors
        )
        code, peak, why = watch(process, caps, began)
        return Outcome(code, time.monotonic() - began, peak, why, tail(errors))


def watch(
    process: subprocess.Popen[bytes], caps: Caps, began: float
) -> tuple[int | None, int | None, str]:
    """Until it ends, or is killed for taking too much: exit code, peak of memory, and why."""
    why, pause, seen, hidden = "", SHORTEST, 0, own_peak()
    while True:
        ended, peak = has_ended(process)
        if ended is not None:
            break
        seen = max(seen, status_of(process.pid, "VmHWM") or 0)
        if not why:
            why = excess(process.pid, caps, began)
            if why:
                kill(process)
        time.sleep(pause)
        pause = min(2 * pause, LONGEST)
    process.returncode = ended
    if peak is not None and peak <= hidden:
        peak = seen or None
    if not why and peak is not None and peak > caps.memory:
        why = f"took {peak >> 20} MiB of memory, {caps.memory >> 20} are allowed"
    if not why and ended < 0:
        why = f"was ended by {signal_name(-ended)}"
    return (None if why else ended), peak, why


def has_ended(process: subprocess.Popen[bytes]) -> tuple[int | None, int | None]:
    """Exit code and peak of memory, or None while it runs."""
    if not hasattr(os, "wait4"):
        return process.poll(), None
    pid, status, usage = os.wait4(process.pid, os.WNOHANG)
    if not pid:
        return None, None
    unit = 1 if os.uname().sysname == "Darwin" else 1024
    return os.waitstatus_to_exitcode(status), usage.ru_maxrss * unit


def own_peak() -> int:
    """Linux counts it as memory of each child, which was this process before it was another."""
    return status_of(os.getpid(), "VmHWM") or 0


def signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def excess(pid: int, caps: Caps, began: float) -> str:
    """Why a process is to be killed, or nothing."""
    if time.monotonic() - began > caps.seconds:
        return f"took longer than {caps.seconds:g} s"
    used = status_of(pid, "VmRSS")
    if used is not None and used > caps.memory:
        return f"took more than {caps.memory >> 20} MiB of memory"
    return ""


def status_of(pid: int, name: str) -> int | None:
    """Bytes, where the system has /proc."""
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return None
    for line in text.splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    return None


def tail(stream: IO[bytes], start: int = 0) -> str:
    end = stream.seek(0, os.SEEK_END)
    stream.seek(max(start, end - TAIL))
    return stream.read().decode("utf-8", "replace")


class Server:
    """A process that answers lines of arguments with exit codes."""

    def __init__(self, command: Sequence[str], caps: Caps, cwd: Path | None) -> None:
        self.caps = caps
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115
        self.process = begin(
            command, cwd, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors
        )
        self.alive = True

    def call(self, argv: Sequence[str]) -> Outcome:
        began, said = time.monotonic(), self.errors.seek(0, os.SEEK_END)
        assert self.process.stdin is not None
        forget_peak(self.process.pid)
        why, line = "", b""
        try:
            self.process.stdin.write(json.dumps(argv).encode() + b"\n")
            self.process.stdin.flush()
            line, why = self.answer(began)
        except OSError:
            why = "ended"
        peak = status_of(self.process.pid, "VmHWM")
        code: int | None = None
        if not why:
            try:
                code = int(line)
            except ValueError:
                why = f"answered {line[:40]!r}, which is no exit code" if line else "ended"
        if not why and peak is not None and peak > self.caps.memory:
            why = f"took {peak >> 20} MiB of memory, {self.caps.memory >> 20} are allowed"
        if why:
            self.close()
            if why == "ended":
                ended = self.process.returncode
                how = f"by {signal_name(-ended)}" if ended < 0 else f"with exit code {ended}"
                why = f"the server ended {how}"
            code = None
        return Outcome(code, time.monotonic() - began, peak, why, tail(self.errors, said))

    def answer(self, began: float) -> tuple[bytes, str]:
        """The next line; or why there is none."""
        assert self.process.stdout is not None
        line = b""
        with selectors.DefaultSelector() as ready:
            ready.register(self.process.stdout, selectors.EVENT_READ)
            while not line.endswith(b"\n"):
                if ready.select(LONGEST):
                    part = os.read(self.process.stdout.fileno(), 4096)
                    if not part:
                        return line, "ended"
                    line += part
                else:
                    why = excess(self.process.pid, self.caps, began)
                    if why:
                        kill(self.process)
                        return line, why
        return line, ""

    def close(self) -> None:
        """Ends it; a process that does not end with its input is killed."""
        if not self.alive:
            return
        self.alive = False
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        try:
            self.process.wait(1)
        except subprocess.TimeoutExpired:
            kill(self.process)
            self.process.wait()


def forget_peak(pid: int) -> None:
    """So that the next peak is that of the next verb (Linux)."""
    with contextlib.suppress(OSError):
        Path(f"/proc/{pid}/clear_refs").write_text("5", encoding="ascii")
