"""Files that break rules although every checksum holds, through all verbs.

python tools/mutants_crc.py [--count 36000] [--start 0] [--jobs 1]

Each file goes through ``recover``, whose output must verify as intact under the same limits, and
through four verbs by turns. Only exceptions of ``hapfmt.errors`` may come out. What breaks a law is
printed with its number; ``--start N --count 1`` runs it again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import installed  # noqa: F401

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "conformance" / "gen")]

STRIDE = 100
SHOWN = 20


def run(span: tuple[int, int]) -> tuple[Counter[str], list[str]]:
    """What became of these mutants, and the laws that broke."""
    from fuzzing.mutants import check

    warnings.simplefilter("error")
    told: Counter[str] = Counter()
    broken = []
    with tempfile.TemporaryDirectory() as name:
        for seed in range(*span):
            try:
                told.update(check(seed, Path(name)))
            except Exception:
                broken.append(f"mutant {seed}\n{traceback.format_exc()}")
    return told, broken


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=36_000)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    asked = parser.parse_args()
    stop = asked.start + asked.count
    spans = [(at, min(at + STRIDE, stop)) for at in range(asked.start, stop, STRIDE)]
    began, told, broken = time.monotonic(), Counter[str](), 0
    with ProcessPoolExecutor(asked.jobs) as pool:
        for done, (some, faults) in enumerate(pool.map(run, spans), 1):
            told += some
            for fault in faults:
                broken += 1
                if broken <= SHOWN:
                    print(fault, flush=True)
            if done % 20 == 0:
                print(f"{min(done * STRIDE, asked.count)} files, {broken} broken", flush=True)
    for line, count in sorted(told.items()):
        print(f"{line:32} {count}")
    seconds = time.monotonic() - began
    print(f"{asked.count} files in {seconds:.0f} s, {broken} broke a law")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
