"""Where the conformance suite stands, and the implementations of this repository."""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

import run

ROOT = Path(__file__).resolve().parent.parent
CONFORMANCE = ROOT / "conformance"
PROGRAMS = {
    "hapfmt": [sys.executable, str(CONFORMANCE / "adapters" / "python")],
    "JavaScript": ["node", str(CONFORMANCE / "adapters" / "js" / "cli.js")],
}


def called(*words: str) -> tuple[int, str]:
    """conformance/run.py in this process: its exit code, and what it says."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = run.main(words)
    return code, said.getvalue()
