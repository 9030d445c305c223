"""Starts the processes of a replay and requests real-time settings for them.

A process asks for each setting that the system offers, and reports which ones it got, or why not.
The clock of a replay is monotonic, has a fine resolution and counts the time of a suspend. A
suspend is thus a stall like any other: a force does not resume after it.
"""

from __future__ import annotations

import ctypes
import gc
import io
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, cast

LINES, COLUMNS = 200, 2000
"""Most lines and columns that are kept of a child's output."""


def start(module: str, stderr: int | None = None) -> subprocess.Popen[bytes]:
    """``python -m hapfmt.replay.process.module`` with pipes; ``stderr`` None: that of ours.

    In a session of its own: Ctrl-C reaches the player alone, which ends the others in order.
    """
    apart: dict[str, Any] = {"start_new_session": True}
    if sys.platform == "win32":
        apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return subprocess.Popen(
        # -P: what lies in the current directory is not imported.
        [sys.executable, "-P", "-m", f"{__package__}.{module}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=stderr,
        bufsize=0,
        env=environment(),
        **apart,
    )


def environment() -> dict[str, str]:
    """The modules that we have ourselves, and no pool of threads for linear algebra."""
    path = os.pathsep.join(os.fspath(Path(p).absolute()) for p in sys.path)
    return {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def descriptor(pipe: IO[bytes] | None) -> int:
    assert pipe is not None
    return pipe.fileno()


class Errors:
    """What processes write to their standard error, and what the watchdog says of itself there."""

    def __init__(self, pipe: IO[bytes] | None) -> None:
        assert pipe is not None
        self.pipe = pipe
        self.lines: list[str] = []
        self.watchdog = ""
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self) -> None:
        buffered = io.BufferedReader(cast(io.RawIOBase, self.pipe))
        with buffered, suppress(OSError, ValueError):
            for line in buffered:
                self.hear(line.decode("utf-8", "replace").rstrip())

    def hear(self, line: str) -> None:
        if line.startswith('{"watchdog": '):
            with suppress(ValueError, KeyError, TypeError):
                self.watchdog = watchdog_text(json.loads(line)["watchdog"])
                return
        if line and len(self.lines) < LINES:
            self.lines.append(line[:COLUMNS])

    def wait(self, seconds: float) -> None:
        """Waits at most this many seconds for the end of all processes that write there."""
        self.thread.join(seconds)
        if self.thread.is_alive():
            self.lines.append(f"a process has not ended after {seconds:.0f} s more")


def watchdog_text(state: dict[str, Any]) -> str:
    text = f"tripped: {state['cause']}; the device took {state['sent']} neutral frames"
    return text + (f", {state['failed']} not: {state['error']}" if state["failed"] else "")


PRIORITY = 50
"""Priority under SCHED_FIFO: the middle of 1 to 99."""
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
PR_SET_TIMERSLACK = 29
LATENCY = Path("/dev/cpu_dma_latency")
"""While it is open with 0 us written, processors do not fall into deep sleep."""
NOT_HERE = f"not on this system ({sys.platform})"


def apply(priority: int = PRIORITY) -> dict[str, str]:
    """Applies every available setting: name -> its result, or why it failed."""
    settings: dict[str, Callable[[], str]] = {
        "scheduler": lambda: scheduler(priority),
        "memory": lock_memory,
        "timer": timer,
        "processor": stay_awake,
        "collector": freeze,
    }
    return {name: attempted(setting) for name, setting in settings.items()}


def nothing() -> dict[str, str]:
    return dict.fromkeys(
        ("scheduler", "memory", "timer", "processor", "collector"), "not asked for"
    )


def attempted(setting: Callable[[], str]) -> str:
    try:
        return setting()
    except (OSError, AttributeError, ValueError) as error:
        return f"not permitted ({reason(error)})"


def reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def limited(name: str) -> str:
    """``name`` and what it is set to, where that is why something is not permitted."""
    if sys.platform == "win32":
        return ""
    import resource

    soft, _ = resource.getrlimit(getattr(resource, name))
    return f"{name} {'unlimited' if soft == resource.RLIM_INFINITY else soft}"


def scheduler(priority: int) -> str:
    if sys.platform == "linux":
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except PermissionError:
            return nicer(f"SCHED_FIFO not permitted ({limited('RLIMIT_RTPRIO')})")
        return f"SCHED_FIFO {priority}"
    if sys.platform == "darwin":
        USER_INTERACTIVE = 0x21  # pthread/qos.h
        checked(ctypes.CDLL(None).pthread_set_qos_class_self_np(USER_INTERACTIVE, 0))
        return "QOS_CLASS_USER_INTERACTIVE"
    if sys.platform == "win32":
        HIGH_PRIORITY_CLASS, THREAD_PRIORITY_TIME_CRITICAL = 0x80, 15
        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        kernel.GetCurrentProcess.restype = kernel.GetCurrentThread.restype = ctypes.c_void_p
        process = ctypes.c_void_p(kernel.GetCurrentProcess())
        thread = ctypes.c_void_p(kernel.GetCurrentThread())
        if not kernel.SetPriorityClass(process, HIGH_PRIORITY_CLASS):
            raise ctypes.WinError(ctypes.get_last_error())
        if not kernel.SetThreadPriority(thread, THREAD_PRIORITY_TIME_CRITICAL):
            raise ctypes.WinError(ctypes.get_last_error())
        return "HIGH_PRIORITY_CLASS, THREAD_PRIORITY_TIME_CRITICAL"
    return nicer(NOT_HERE)


def nicer(why: str) -> str:
    """Without a real-time class, a lower nice value is what remains."""
    try:
        return f"{why}; nice {os.nice(-10)}"
    except OSError:
        return why


def lock_memory() -> str:
    """No page that was used once has to come back from the disk.

    Unused pages are left out: with all of them, 99 MB instead of 30, the end of a writer
    that is killed takes 9 ms longer to reach its watchdog.
    """
    if sys.platform != "linux":
        return NOT_HERE
    import resource

    unlimited = resource.RLIM_INFINITY
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    # Under a limit, locking what is still to come would let a later allocation fail.
    whole = hard == unlimited or os.geteuid() == 0
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_ONFAULT | MCL_CURRENT | (MCL_FUTURE if whole else 0)):
        why = os.strerror(ctypes.get_errno())
        return f"not permitted ({why}; {limited('RLIMIT_MEMLOCK')})"
    return "locked" if whole else f"locked, but not what comes ({limited('RLIMIT_MEMLOCK')})"


def timer() -> str:
    """Sleeps end when they should, not up to 50 us (Linux) or 15 ms (Windows) later."""
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        return "slack 1 ns"
    if sys.platform == "win32":
        checked(ctypes.WinDLL("winmm").timeBeginPeriod(1))
        return "period 1 ms"
    return NOT_HERE


def stay_awake() -> str:
    if sys.platform != "linux":
        return NOT_HERE
    if not LATENCY.exists():
        return f"not on this system (no {LATENCY})"
    KEPT.append(LATENCY.open("wb", buffering=0))
    KEPT[-1].write(bytes(4))
    return "kept awake"


KEPT: list[Any] = []
"""Open until the process ends."""


def freeze() -> str:
    gc.collect()
    gc.freeze()
    gc.disable()
    return "off"


def checked(code: int) -> None:
    if code:
        raise OSError(code, f"error {code}")


if sys.platform == "linux":

    def clock() -> int:
        """Nanoseconds."""
        return time.clock_gettime_ns(time.CLOCK_BOOTTIME)

elif sys.platform == "darwin":

    def clock() -> int:
        """Nanoseconds; this one counts sleep there, and ``time.monotonic`` does not."""
        return time.clock_gettime_ns(time.CLOCK_MONOTONIC)

else:
    # On Windows time.monotonic has steps of 15.6 ms before Python 3.13.
    clock = time.perf_counter_ns


def seconds() -> float:
    return clock() / 1e9
