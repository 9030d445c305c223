"""The way of one sample: which functions it passes from .npz to .hapf, and back.

python tools/trace.py [--channels 3] [--names] [--memory]

It counts the functions of hapfmt that run, their files, and how often the next call is in another
file than the one before. A first pass, which is not counted, loads modules and fills caches.
--names lists the functions in the order of their first calls. --memory measures how much memory a
long recording takes in addition, in sizes of its array.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import installed  # noqa: F401

import numpy as np

import hapfmt

PACKAGE = Path(hapfmt.__file__).parent
SAMPLES, LONG = 3000, 300_000


def ways(folder: Path, channels: int, samples: int) -> dict[str, Callable[[], object]]:
    """What is measured, each step from the file of the step before; values have a step of 0.001."""
    rows = [np.sin(np.arange(samples) * (3 + 2 * place) / 1000) * 3 for place in range(channels)]
    np.savez(folder / "in.npz", x=np.round(np.stack(rows) / 0.001) * 0.001, rate=1000.0)
    hapf, out = folder / "x.hapf", folder / "out.npz"
    return {
        "there": lambda: hapfmt.write(hapfmt.read(folder / "in.npz"), hapf, force=True),
        "back": lambda: hapfmt.save(hapfmt.read(hapf), out, force=True),
    }


def traced(work: Callable[[], object]) -> list[tuple[str, str]]:
    """(file, function) of each call within the package, in order."""
    found: list[tuple[str, str]] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(PACKAGE):
            found.append((path.relative_to(PACKAGE).as_posix(), frame.f_code.co_qualname))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return found


def named(calls: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """The functions among them, each once: no comprehensions, no lambdas."""
    return [call for call in dict.fromkeys(calls) if not call[1].endswith(">")]


def peak_of(work: Callable[[], object]) -> int:
    """Most bytes that the work takes in addition."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--channels", type=int, default=3, metavar="N", help="in the recording [3]")
    parser.add_argument("--names", action="store_true", help="list the functions")
    parser.add_argument("--memory", action="store_true", help="measure the peak of memory")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        steps = ways(Path(folder), given.channels, LONG if given.memory else SAMPLES)
        for work in steps.values():
            work()
        for way, work in steps.items():
            if given.memory:
                size = 8 * given.channels * LONG
                print(f"{way}: at most {peak_of(work) / size:.1f} times the array in memory")
                continue
            calls = traced(work)
            functions = named(calls)
            changes = 1 + sum(a[0] != b[0] for a, b in zip(calls, calls[1:], strict=False))
            files = len({file for file, _ in functions})
            print(f"{way}: {len(functions)} functions in {files} files, {changes} changes of file")
            for file, name in functions if given.names else ():
                print(f"  {file}  {name}")


if __name__ == "__main__":
    main()
