"""The kill matrix in text, as JSON, and as MUTANTS.md."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from runner.manifest import Case

from .matrix import Examined
from .mutant import Mutant

PAGE = Path(__file__).resolve().parent.parent / "MUTANTS.md"
ROW = re.compile(r"^\| `([a-z0-9-]+)` .*\| `?([a-z]+/[a-z0-9-]+)`? \|$", re.MULTILINE)
SHORT = {"uncommon": "unc", "recoverable": "rec"}

TEXT = """\
# Mutants: does the suite notice?

Each line is a program with one mistake: hapfmt with a line or two changed (`mutants/*.py` say
which), or the adapter in JavaScript. The suite has to tell every one of them from the right
program, which passes every case. `python conformance/mutants/run.py` finds out; `--quick` stops at
the first case that notices, and `--quick --write` makes this page.

{summary}

"killed by" names a case that notices. Most mutants are noticed by several.
"""


def counts(found: Examined, cases: Mapping[str, Case]) -> Counter[str]:
    """Killers by set."""
    return Counter(cases[id_].set for id_ in found.killers)


def head(sets: Sequence[str]) -> str:
    cells = [SHORT.get(name, name).rjust(7) for name in sets]
    return f"{'mutant':32} {'cases':>5} {' '.join(cells)}  for one"


def line(found: Examined, cases: Mapping[str, Case], sets: Sequence[str]) -> str:
    row = counts(found, cases)
    cells = [(str(row[name]) if row[name] else ".").rjust(7) for name in sets]
    first = next(iter(found.killers), "SURVIVED")
    return f"{found.name:32} {len(found.killers):>5} {' '.join(cells)}  {first}"


def as_json(examined: Sequence[Examined], mutants: Sequence[Mutant]) -> dict[str, Any]:
    told = {mutant.name: mutant for mutant in mutants}
    return {
        "mutants": [
            {
                "name": found.name,
                "about": told[found.name].about,
                "role": told[found.name].role,
                "language": told[found.name].language,
                "requirements": list(told[found.name].requirements),
                "killed": found.killed,
                "killers": found.killers,
                "cases_run": found.asked,
                "seconds": round(found.seconds, 3),
            }
            for found in examined
        ]
    }


def page(examined: Sequence[Examined], mutants: Sequence[Mutant]) -> str:
    """MUTANTS.md."""
    killed = sum(found.killed for found in examined)
    summary = f"{killed} of {len(examined)} mutants are killed."
    return TEXT.format(summary=summary) + "".join(rows(examined, mutants))


def rows(examined: Sequence[Examined], mutants: Sequence[Mutant]) -> Iterator[str]:
    results = {found.name: found for found in examined}
    groups: dict[tuple[str, str], list[Mutant]] = {}
    for mutant in mutants:
        groups.setdefault((mutant.role, mutant.language), []).append(mutant)
    for (role, language), group in groups.items():
        where = " in JavaScript" if language == "javascript" else ""
        yield f"\n## Wrong {role}s{where}\n\n"
        yield "| mutant | what is wrong | breaks | killed by |\n|---|---|---|---|\n"
        for mutant in group:
            found = results[mutant.name]
            first = next(iter(found.killers), "")
            yield (
                f"| `{mutant.name}` | {mutant.about} | {', '.join(mutant.requirements)} "
                f"| {f'`{first}`' if first else 'none'} |\n"
            )


def first_killers(path: Path = PAGE) -> dict[str, str]:
    """What the page says: where a quick run begins."""
    return dict(ROW.findall(path.read_text("utf-8"))) if path.exists() else {}
