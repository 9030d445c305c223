"""The cases: manifest.json, expected/ and vectors/."""

from __future__ import annotations

import fnmatch
import json
import re
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

ROOM = Path(__file__).resolve().parent.parent
RULE = re.compile(r"^- \*\*([A-Z]{3}-\d{3})\*\*", re.MULTILINE)


@dataclass
class Case:
    """One entry of the manifest. ``path``: the file, or a folder: of a job, or of a file and the
    job that is its original."""

    set: str
    name: str
    about: str
    requirements: list[str]
    path: Path
    fault: str | None = None
    on_demand: bool = False
    room: Path = field(default=ROOM, repr=False)

    @property
    def id(self) -> str:
        return f"{self.set}/{self.name}"

    @cached_property
    def expect(self) -> dict[str, Any]:
        path = self.room / "expected" / self.set / f"{self.name}.json"
        return json.loads(path.read_text(encoding="utf-8"))

    @property
    def file(self) -> Path:
        return self.path / "file.hapf" if self.path.is_dir() else self.path

    @property
    def job(self) -> Path:
        return self.path / "job.json"


def load(room: Path = ROOM) -> list[Case]:
    manifest = json.loads((room / "manifest.json").read_text(encoding="utf-8"))
    cases = []
    for entry in manifest["cases"]:
        name = entry["name"] if "files" in entry else f"{entry['name']}.hapf"
        cases.append(
            Case(
                entry["set"], entry["name"], entry["about"], entry["requirements"],
                room / "vectors" / entry["set"] / name, entry.get("fault"),
                bool(entry.get("made_on_demand")), room,
            )
        )  # fmt: skip
    return cases


def select(cases: Sequence[Case], sets: Sequence[str], patterns: Sequence[str]) -> list[Case]:
    """Cases of these sets whose name, or set/name, matches one of the patterns; none: all."""
    chosen = [case for case in cases if not sets or case.set in sets]
    if patterns:
        chosen = [
            case
            for case in chosen
            if any(
                fnmatch.fnmatch(text, pattern)
                for pattern in patterns
                for text in (case.name, case.id)
            )
        ]
    return chosen


def make_on_demand(cases: Sequence[Case], folder: Path) -> None:
    """Files that are too large to be kept are made in ``folder``, by their generators; without
    these they are missing."""
    wanted = [case for case in cases if case.on_demand]
    if not wanted:
        return
    folder.mkdir(parents=True, exist_ok=True)
    make = wanted[0].room / "gen" / "make.py"
    if make.exists():
        subprocess.run([sys.executable, str(make), "--limits", str(folder)], check=True)
    for case in wanted:
        case.path = folder / f"{case.name}.hapf"


def rules(room: Path = ROOM) -> list[str]:
    """Ids of SPEC.md and docs/spec, where these are present."""
    pages = [room.parent / "SPEC.md", *(room.parent / "docs" / "spec").glob("*.md")]
    texts = [page.read_text(encoding="utf-8") for page in pages if page.exists()]
    return sorted({rule for text in texts for rule in RULE.findall(text)})
