"""Where the conformance suite stands, and the implementations of this repository."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CONFORMANCE = ROOT / "conformance"
PROGRAMS = {
    "hapfmt": [sys.executable, "-m", "hapfmt.conformance"],
    "JavaScript": ["node", str(CONFORMANCE / "adapters" / "js" / "cli.js")],
}
