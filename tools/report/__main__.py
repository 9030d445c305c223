"""python tools/report, or python -m tools.report, from a clone; what it does is in run.py."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent

if __name__ == "__main__":
    sys.path[:0] = [str(ROOT), str(ROOT / "tools")]
    from report.run import main

    main(prog_name="python tools/report")
