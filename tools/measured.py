"""What every table of measurements says first: machine, versions, commit; and how it is printed."""

from __future__ import annotations

import os
import platform
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from hapfmt.version import __version__

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared" / "data"


def print_origin() -> None:
    """Machine, versions, commit."""
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run(
        [*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    )
    changed = subprocess.run(
        [*git, "status", "--porcelain"], capture_output=True, text=True, check=False
    )
    mark = "+" if changed.stdout else ""
    print(
        f"hapfmt {__version__}, commit {commit.stdout.strip() or 'unknown'}{mark}, "
        f"Python {platform.python_version()}, NumPy {np.__version__}, "
        f"{platform.machine()}, {os.cpu_count()} cores\n"
    )


def print_table(headers: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Markdown."""
    cells = [[str(cell) for cell in row] for row in rows]
    widths = [
        max(len(header), *(len(row[i]) for row in cells)) if cells else len(header)
        for i, header in enumerate(headers)
    ]
    for row in [list(headers), ["-" * width for width in widths], *cells]:
        print("| " + " | ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) + " |")
    print()


def best_of(work: Callable[[], object], repeats: int = 5) -> float:
    """Shortest CPU time of several runs, in seconds."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        work()
        times.append(time.process_time() - began)
    return min(times)


def recordings() -> list[Path]:
    """The recordings beside the repository, or none."""
    return sorted(DATA.rglob("*.npz"))
