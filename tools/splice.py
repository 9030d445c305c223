"""Files with blocks of other files, forks and repeated parts, by every way to read them.

python tools/splice.py [--count 2000] [--start 0]

Every way, the viewer's too, takes the same file id, title and channels, or ends in an error. No
sample is wrong, and each is delivered or named as lost. What breaks a law is printed with its
number; ``--start N --count 1`` runs it again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import traceback
from collections import Counter
from pathlib import Path

import installed  # noqa: F401

from measured import print_origin, print_table

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "conformance" / "gen")]


def main() -> int:
    from fuzzing.spliced import check
    from test_viewer_data import NODE, Viewer

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--start", type=int, default=0)
    asked = parser.parse_args()
    told: Counter[str] = Counter()
    broken = 0
    viewer = Viewer() if NODE else None
    with tempfile.TemporaryDirectory() as name:
        for seed in range(asked.start, asked.start + asked.count):
            try:
                told.update(check(seed, Path(name), viewer.open if viewer else None))
            except Exception:
                broken += 1
                print(f"trial {seed}\n{traceback.format_exc()}", flush=True)
    if viewer:
        viewer.process.communicate()
    print_origin()
    print_table(["what", "trials"], [[what, str(count)] for what, count in sorted(told.items())])
    print(f"{asked.count} trials, {broken} broke a law")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
