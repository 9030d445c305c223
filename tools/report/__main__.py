"""python tools/report, or python -m tools.report, from a clone; what it does is in run.py."""

from __future__ import annotations

import sys
from pathlib import Path

TOOLS = Path(__file__).resolve().parent.parent

if __name__ == "__main__":
    sys.path.insert(0, str(TOOLS))
    import installed  # noqa: F401

    from report.run import main

    main(prog_name="python tools/report")
