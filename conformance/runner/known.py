"""Known failures: cases that must fail, each with a reason. A case that passes is reported, so that
it is taken off the list."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .manifest import Case

Known = dict[str, str]
"""Reason by set/name."""


def read_known(path: Path | None, cases: Sequence[Case]) -> Known:
    """ValueError where a line names no case, or gives no reason."""
    known: Known = {}
    if path is None:
        return known
    ids = {case.id for case in cases}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        name, _, reason = line.strip().partition(" ")
        if not name or name.startswith("#"):
            continue
        if name not in ids:
            raise ValueError(f"{path}:{number}: no case is called {name}")
        if not reason.strip():
            raise ValueError(f"{path}:{number}: say why {name} fails")
        known[name] = reason.strip()
    return known
