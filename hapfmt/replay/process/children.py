"""How the processes of a replay are started."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import IO, Any


def start(module: str, stderr: int | None = None) -> subprocess.Popen[bytes]:
    """``python -m hapfmt.replay.process.module`` with pipes; ``stderr`` None: that of ours.

    In a session of its own: Ctrl-C reaches the player alone, which ends the others in order.
    """
    apart: dict[str, Any] = (
        {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        if sys.platform == "win32"
        else {"start_new_session": True}
    )
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
