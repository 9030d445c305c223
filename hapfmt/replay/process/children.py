"""How the processes of a replay are started."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, cast

LINES, COLUMNS = 200, 2000
"""Of what is kept of a process that talks."""


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
                self.watchdog = told(json.loads(line)["watchdog"])
                return
        if line and len(self.lines) < LINES:
            self.lines.append(line[:COLUMNS])

    def wait(self, seconds: float) -> None:
        """Until all that could write there have ended, so long at most."""
        self.thread.join(seconds)
        if self.thread.is_alive():
            self.lines.append(f"a process has not ended after {seconds:.0f} s more")


def told(state: dict[str, Any]) -> str:
    text = f"tripped: {state['cause']}; the device took {state['sent']} neutral frames"
    return text + (f", {state['failed']} not: {state['error']}" if state["failed"] else "")
