"""Runs the cases of conformance/ on programs with one mistake each: which case kills which?

python conformance/mutants/run.py                the whole matrix
python conformance/mutants/run.py --quick        each mutant up to the first case that kills it, and
                                                 the program without a mistake on these cases alone
python conformance/mutants/run.py --mutant NAME  only this one, and what each case found
python conformance/mutants/run.py --quick --write  the same, and conformance/MUTANTS.md

Ends with 1 where a mutant survives, or cannot be made, or the program without a mistake fails.
Needs fork, and for mutants in JavaScript node.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

ROOM = Path(__file__).resolve().parent.parent
if __name__ == "__main__":
    sys.path[0] = str(ROOM)
    sys.path.insert(0, str(ROOM.parent))
    sys.path.insert(0, str(ROOM / "adapters" / "python"))
from runner.manifest import Case, load, make_on_demand, select  # noqa: E402

from mutants import MUTANTS, table  # noqa: E402
from mutants.matrix import JAVASCRIPT, Called, Examined, control, examine_all  # noqa: E402
from mutants.mutant import Mutant, NotApplicableError  # noqa: E402
from mutants.workers import prepare  # noqa: E402

MEMORY = Path("/dev/shm")
"""Files that live for milliseconds: on a disk they take a quarter of the time."""


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="stop each mutant at its first kill")
    add("--write", action="store_true", help="write MUTANTS.md")
    add("--mutant", action="append", default=[], metavar="GLOB", help="only these; repeatable")
    add("--set", action="append", default=[], metavar="SET", help="only cases of this set")
    add("--case", action="append", default=[], metavar="GLOB", help="only these cases")
    add("--limits", action="store_true", help="also the cases that are made on demand")
    add("--jobs", type=int, default=1, metavar="N", help="mutants at a time [1]")
    add("--json", type=Path, metavar="FILE", help="write the whole matrix")
    add("--list", action="store_true", help="only list the mutants")
    return parser.parse_args(arguments)


def chosen(patterns: Sequence[str]) -> list[Mutant]:
    found = [
        mutant
        for mutant in MUTANTS
        if not patterns or any(fnmatch.fnmatch(mutant.name, pattern) for pattern in patterns)
    ]
    if shutil.which("node") and JAVASCRIPT.is_dir():
        return found
    here = [mutant for mutant in found if mutant.language != "javascript"]
    if len(here) < len(found):
        print(f"without node {len(found) - len(here)} mutants are left out", file=sys.stderr)
    return here


def check_control(cases: Sequence[Case], mutants: Sequence[Mutant]) -> tuple[set[str], Called]:
    """The cases that programs without a mistake do not pass; and what each case calls."""
    wrong: set[str] = set()
    called: Called = {}
    for language in dict.fromkeys(mutant.language for mutant in mutants):
        places = {p for m in mutants if m.language == language for p in m.places}
        found, by_case = control(cases, language, places)
        if language == "python":
            called = by_case
        for id_, why in found.wrong.items():
            print(f"{found.name} fails {id_}: {why}")
        print(f"{found.name}: {len(cases)} cases, {found.seconds:.1f} s")
        wrong |= found.wrong.keys()
    return wrong, called


def tell(examined: Sequence[Examined], mutants: Sequence[Mutant], seconds: float) -> None:
    survivors = [found.name for found in examined if not found.killed]
    told = {mutant.name: mutant for mutant in mutants}
    print(f"\n{len(examined) - len(survivors)} of {len(examined)} killed, {seconds:.1f} s")
    for name in survivors:
        rules = ", ".join(told[name].requirements)
        print(f"SURVIVED {name}: {told[name].about} [{rules}]")


def main(arguments: Sequence[str] | None = None) -> int:
    given = parse(arguments)
    mutants = chosen(given.mutant)
    if given.list:
        for mutant in mutants:
            print(f"{mutant.name}: {mutant.about} [{', '.join(mutant.requirements)}]")
        return 0
    began = time.monotonic()
    cases = [c for c in select(load(), given.set, given.case) if given.limits or not c.on_demand]
    if not mutants or not cases:
        print("no mutant, or no case, is called so", file=sys.stderr)
        return 2
    prepare()
    if MEMORY.is_dir():
        tempfile.tempdir = str(MEMORY)
    with tempfile.TemporaryDirectory(prefix="hapf-mutants-") as room:
        make_on_demand(cases, Path(room))
        return run(given, mutants, cases, began)


def run(
    given: argparse.Namespace, mutants: Sequence[Mutant], cases: Sequence[Case], began: float
) -> int:
    wrong, called = (set(), {}) if given.quick else check_control(cases, mutants)
    cases = [case for case in cases if case.id not in wrong]
    by_id = {case.id: case for case in cases}
    sets = list(dict.fromkeys(case.set for case in cases))
    print("\n" + table.head(sets))
    examined: list[Examined] = []
    try:
        for found in examine_all(
            mutants, cases, table.first_killers(), called, quick=given.quick, jobs=given.jobs
        ):
            examined.append(found)
            print(table.line(found, by_id, sets), flush=True)
            for id_, why in found.wrong.items():
                print(f"    the program without a mistake fails {id_}: {why}")
            wrong |= found.wrong.keys()
            if given.mutant and not given.quick:
                for id_, why in found.killers.items():
                    print(f"    {id_}: {why}")
    except NotApplicableError as error:
        print(f"a mutant cannot be made: {error}", file=sys.stderr)
        return 1
    tell(examined, mutants, time.monotonic() - began)
    if given.json:
        text = json.dumps(table.as_json(examined, mutants), indent=1, ensure_ascii=False)
        given.json.write_text(text + "\n", "utf-8")
    if given.write and not given.mutant:
        table.PAGE.write_text(table.page(examined, mutants), "utf-8")
    return int(bool(wrong) or not all(found.killed for found in examined))


if __name__ == "__main__":
    if not hasattr(os, "fork"):
        sys.exit("mutants need fork")
    sys.exit(main())
