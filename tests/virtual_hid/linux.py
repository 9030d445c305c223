"""Calls of Linux that Python 3.11 does not have."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from pathlib import Path
from typing import Any

CLONE_NEWNS, CLONE_NEWUSER, CLONE_NEWPID = 0x00020000, 0x10000000, 0x20000000
MS_NOSUID, MS_NODEV, MS_BIND, MS_REC, MS_PRIVATE = 2, 4, 1 << 12, 1 << 14, 1 << 18
PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
MCL_CURRENT, MCL_FUTURE = 1, 2

libc: Any = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None


def check(result: int, what: str) -> None:
    if result:
        code = ctypes.get_errno()
        raise OSError(code, f"{what}: {os.strerror(code)}")


def mount(source: str, target: str, kind: str | None, flags: int = 0, data: str = "") -> None:
    done = libc.mount(
        source.encode(), target.encode(), kind.encode() if kind else None,
        ctypes.c_ulong(flags), data.encode(),
    )  # fmt: skip
    check(done, f"mount {kind or source} on {target}")


def unshare(flags: int) -> None:
    check(libc.unshare(flags), "unshare")


def die_with_parent(parent: int) -> None:
    """SIGKILL when ``parent`` ends; it may have already."""
    check(libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0), "prctl")
    if os.getppid() != parent:
        os._exit(1)


def own_namespaces() -> None:
    """Of mounts and processes: as root, or by a user namespace where one may have them."""
    uid, gid = os.getuid(), os.getgid()
    try:
        unshare(CLONE_NEWNS | CLONE_NEWPID)
    except PermissionError:
        unshare(CLONE_NEWUSER | CLONE_NEWNS | CLONE_NEWPID)
        Path("/proc/self/setgroups").write_bytes(b"deny")
        Path("/proc/self/uid_map").write_bytes(f"0 {uid} 1".encode())
        Path("/proc/self/gid_map").write_bytes(f"0 {gid} 1".encode())


def real_time(priority: int) -> str:
    """SCHED_FIFO and locked memory; what was refused, in words."""
    refused = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        refused.append(f"SCHED_FIFO: {error.strerror}")
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE):
        refused.append(f"mlockall: {os.strerror(ctypes.get_errno())}")
    return ", ".join(refused)
