"""Coverage-guided fuzzing of every parser and decoder (pip install -e '.[fuzz]').

python tools/fuzz.py [TARGET ...] [--seconds 60] [--work FOLDER] [--pure]   try new inputs
python tools/fuzz.py [TARGET ...] [--work FOLDER] --keep      what found new code to tests/corpus

Targets and their properties are in tests/fuzzing; one process each, memory capped at 256 MiB more
than it has when it begins. What breaks a property is left in FOLDER/TARGET-crash-...
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import re
import resource
import subprocess
import sys
import time
import warnings
from importlib import import_module
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import installed  # noqa: F401

ROOT = Path(__file__).resolve().parent.parent
CORPUS = ROOT / "tests" / "corpus"
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "conformance" / "gen")]

MEMORY = 256 << 20
"""Bytes beyond those of the interpreter and its modules."""

SLOW = 20
"""Seconds that an input may take; the readable loops under instrumentation are slow."""

RAW = 8
"""One mutation in this number leaves checksums as they are."""

ROOM = {"file": 80 << 10, "append": 16 << 10, "edited": 16 << 10, "recovered": 16 << 10}
OTHER_ROOM = 8 << 10
"""Bytes of the inputs of a target that are kept."""


AGAIN = 10_000
"""Inputs between two settings of the memory cap: an instrumented run keeps memory of its own."""


def cap_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    cap = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (cap, resource.RLIM_INFINITY))


def fuzz(name: str, arguments: list[str]) -> None:
    """Runs in a process of its own; libFuzzer ends it."""
    import atheris

    with atheris.instrument_imports(include=["hapfmt"]):
        from fuzzing import TARGETS
        from fuzzing.mend import build, mend_file, parts_of
    target = TARGETS[name]

    def change_parts(data: bytes, size: int, rng: random.Random) -> bytes:
        """Change one payload of a file, or leave out, move or double chunks."""
        parts = parts_of(data)
        if not parts:
            return atheris.Mutate(data, size)
        at, other = rng.randrange(len(parts)), rng.randrange(len(parts))
        way = rng.randrange(8)
        if way == 0:
            parts.insert(other, parts[at])
        elif way == 1:
            parts.insert(other, parts.pop(at))
        elif way == 2 and len(parts) > 1:
            parts.pop(at)
        else:
            payload = atheris.Mutate(parts[at].payload, max(len(parts[at].payload) + 64, 64))
            parts[at] = parts[at]._replace(payload=payload)
        return build(parts)

    def mutate(data: bytes, size: int, seed: int) -> bytes:
        rng = random.Random(seed)
        if target.mend is mend_file and rng.randrange(RAW):
            changed = change_parts(data, size, rng)
        else:
            changed = atheris.Mutate(data, size)
            if seed % RAW:
                changed = target.mend(changed)
        return changed[:size]

    calls = count()

    def run(data: bytes) -> None:
        if next(calls) % AGAIN == 0:
            cap_memory()
        target.run(data)

    warnings.simplefilter("error")
    for seed in target.seeds():
        target.run(seed)
    given = [f"-max_len={target.size}", f"-timeout={SLOW}", "-rss_limit_mb=4096", *arguments]
    atheris.Setup(["fuzz", *given], run, custom_mutator=mutate)
    atheris.Fuzz()


def lines_of(target: Any, data: bytes) -> set[tuple[str, int, int]]:
    """Steps from line to line within the package that an input takes."""
    steps: set[tuple[str, int, int]] = set()
    package = str(Path(import_module("hapfmt").__file__ or "").parent)

    def local(frame: Any, event: str, _: Any) -> Any:
        if event == "line":
            before = last.get(id(frame), 0)
            last[id(frame)] = frame.f_lineno
            steps.add((frame.f_code.co_filename, before, frame.f_lineno))
        return local

    def enter(frame: Any, _event: str, _: Any) -> Any:
        return local if frame.f_code.co_filename.startswith(package) else None

    last: dict[int, int] = {}
    sys.settrace(enter)
    try:
        target.run(data)
    finally:
        sys.settrace(None)
    return steps


def keep(name: str, work: Path) -> tuple[int, int]:
    """The fewest and shortest inputs that take every step, in tests/corpus; how many, bytes."""
    from fuzzing import TARGETS

    target, folder = TARGETS[name], CORPUS / name
    folder.mkdir(parents=True, exist_ok=True)
    places = [*folder.iterdir(), *(work / name).glob("*")]
    inputs = sorted(
        {p.read_bytes() for p in places} | set(target.seeds()), key=lambda d: (len(d), d)
    )
    taken: set[tuple[str, int, int]] = set()
    kept: list[bytes] = []
    room = ROOM.get(name, OTHER_ROOM)
    for data in inputs:
        began = time.monotonic()
        steps = lines_of(target, data) - taken
        if steps and time.monotonic() - began < 1 and len(data) <= room:
            room -= len(data)
            taken |= steps
            kept.append(data)
    for old in folder.iterdir():
        old.unlink()
    for data in kept:
        (folder / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)
    return len(kept), sum(map(len, kept))


def run(name: str, seconds: int, work: Path, pure: bool) -> str:
    """One line: executions, coverage before and after, inputs, what broke."""
    own, seeds = work / name, CORPUS / name
    own.mkdir(parents=True, exist_ok=True)
    from fuzzing import TARGETS

    for seed in TARGETS[name].seeds():
        (own / hashlib.sha256(seed).hexdigest()[:16]).write_bytes(seed)
    began = time.monotonic()
    command = [
        sys.executable, __file__, name, "--inside", f"-max_total_time={seconds}",
        f"-artifact_prefix={work}/{name}-", "-print_final_stats=1", str(own),
        *([str(seeds)] if seeds.is_dir() else []),
    ]  # fmt: skip
    environment = os.environ | ({"HAPFMT_PURE": "1"} if pure else {})
    done = subprocess.run(
        command, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment,
        text=True, errors="replace",
    )  # fmt: skip
    (work / f"{name}.log").write_text(done.stdout, encoding="utf-8")
    covers = re.findall(r"INITED cov: (\d+)|(?:NEW|REDUCE|pulse|DONE) +cov: (\d+)", done.stdout)
    first = next((a for a, _ in covers if a), "?")
    last = next((b for _, b in reversed(covers) if b), first)
    runs = re.findall(r"#(\d+)", done.stdout)
    crashed = "" if done.returncode == 0 else f", BROKEN ({done.returncode}): see {work}/{name}.log"
    return (
        f"{name}: {runs[-1] if runs else 0} executions in {time.monotonic() - began:.0f} s, "
        f"coverage {first} to {last}, {len(list(own.iterdir()))} inputs{crashed}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("targets", nargs="*")
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--work", type=Path, default=Path("fuzzing"))
    parser.add_argument("--pure", action="store_true")
    parser.add_argument("--keep", action="store_true")
    asked = parser.parse_args()
    if not asked.keep and find_spec("atheris") is None:
        print("fuzzing needs atheris: python -m pip install -e '.[fuzz]'", file=sys.stderr)
        return 1
    from fuzzing import TARGETS

    broken = 0
    for name in asked.targets or TARGETS:
        if asked.keep:
            print("{}: {} inputs, {} bytes".format(name, *keep(name, asked.work)), flush=True)
            continue
        line = run(name, asked.seconds, asked.work, asked.pure)
        broken |= "BROKEN" in line
        print(line, flush=True)
    return broken


if __name__ == "__main__":
    if "--inside" in sys.argv:
        fuzz(sys.argv[1], sys.argv[3:])
    sys.exit(main())
