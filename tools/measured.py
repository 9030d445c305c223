"""What every table of measurements says of itself: machine, versions, commit; how it is printed,
how it comes into a page, and how work is timed."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from installed import ROOT, commit, describe

import numpy as np

DATA = ROOT.parent / "shared" / "data"
Result = TypeVar("Result")


def machine() -> str:
    info = Path("/proc/cpuinfo")
    names = [
        line.partition(":")[2].strip()
        for line in (info.read_text("utf-8").splitlines() if info.exists() else ())
        if line.startswith("model name")
    ]
    return f"{names[0] if names else platform.machine()}, {os.cpu_count()} cores"


def origin() -> str:
    """One line: which hapfmt, Python, NumPy and machine."""
    python = platform.python_version()
    return f"{describe()}, Python {python}, NumPy {np.__version__}, {machine()}"


def print_origin() -> None:
    print(f"{origin()}\n")


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


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]
MARK = r"<!-- (%s): (tools/[^ ]+) at ([^ ]+) on (.*?) -->\n\n((?:\|.*\n){2})((?:\|.*\n)*)"
"""A table of figures in a page: its name, the program that writes it, the commit and the machine of
the figures, its head, and its rows."""


def write_rows(name: str, rows: Sequence[Sequence[object]]) -> None:
    """Put rows into the table of that name, in the page that has it."""
    lines = "".join("| " + " | ".join(map(str, row)) + " |\n" for row in rows)

    git = ["git", "-C", str(ROOT), "status", "--porcelain", "hapfmt", "tools"]
    changed = subprocess.run(git, capture_output=True, text=True, check=False).stdout
    on = f"{commit(ROOT).rstrip('+')}{'+' * bool(changed)} on {machine()}"

    def renewed(found: re.Match[str]) -> str:
        assert {len(row) for row in rows} == {found[5].split("\n")[0].count("|") - 1}, name
        return f"<!-- {name}: {found[2]} at {on} -->\n\n{found[5]}{lines}"

    texts = {page: page.read_text("utf-8") for page in PAGES}
    (page,) = [page for page, text in texts.items() if f"<!-- {name}: " in text]
    page.write_text(re.sub(MARK % re.escape(name), renewed, texts[page]), "utf-8")


def files_in(folder: Path) -> list[Path]:
    """All files below a folder, sorted. Linked folders are followed, each folder once."""
    found: list[Path] = []
    seen: set[str] = set()
    for at, folders, names in os.walk(folder, followlinks=True):
        seen.add(os.path.realpath(at))
        folders[:] = sorted(
            name for name in folders if os.path.realpath(Path(at) / name) not in seen
        )
        found += [Path(at) / name for name in names]
    return sorted(found)


def timed(work: Callable[[], Result], repeats: int = 1) -> tuple[Result, float]:
    """The result of the work, and the shortest CPU time of the runs, in seconds."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        result = work()
        times.append(time.process_time() - began)
    return result, min(times)


def best_of(work: Callable[[], object], repeats: int = 5) -> float:
    """Shortest CPU time of several runs, in seconds."""
    return timed(work, repeats)[1]
