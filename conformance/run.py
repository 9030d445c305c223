"""Runs the conformance cases on implementations of hapf, the format for recorded touch.

%(prog)s --impl "./my-adapter"    any program with the verbs of README.md
%(prog)s --impl ... --set valid --case "knot-*"
%(prog)s                          those of this repository, or hapfmt where it is installed

README.md says what the verbs write; --where prints its folder. Ends with 0 where everything that
was tested is as expected, 1 where something is not, 2 where an implementation cannot be run.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from runner import report  # noqa: E402
from runner.known import Known, read_known  # noqa: E402
from runner.manifest import Case, load, make_on_demand, select  # noqa: E402
from runner.process import Caps, Implementation, UnusableError  # noqa: E402
from runner.running import Result, made_for, run_case  # noqa: E402

OWN = (
    [sys.executable, str(HERE / "adapters" / "python")],
    ["node", str(HERE / "adapters" / "js" / "cli.js")],
)
"""The implementations of this repository."""


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    add = parser.add_argument
    add("--impl", action="append", metavar="CMD", help="command of an adapter; repeatable")
    add("--referee", action="append", metavar="CMD",
        help="judges recovered and encoded files; repeatable [of this repository]")  # fmt: skip
    add("--cases", type=Path, default=HERE, metavar="FOLDER",
        help="with manifest.json, expected/ and vectors/ [this one]")  # fmt: skip
    add("--set", action="append", default=[], metavar="SET", help="only this set; repeatable")
    add("--case", action="append", default=[], metavar="GLOB",
        help="only cases whose name, or set/name, matches; repeatable")  # fmt: skip
    add("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="cases at a time")
    add("--timeout", type=float, default=60, metavar="S", help="seconds of a verb [60]")
    add("--memory", type=int, default=1024, metavar="MIB", help="MiB of a verb [1024]")
    add("--known-failures", type=Path, metavar="FILE",
        help="lines of 'set/name reason': these cases must fail")  # fmt: skip
    add("--junit", type=Path, metavar="FILE", help="write JUnit XML")
    add("--json", type=Path, metavar="FILE", help="write the outcome as JSON")
    add("--no-serve", action="store_true", help="a process for each verb, whatever is claimed")
    add("--list", action="store_true", help="only list the cases")
    add("--where", action="store_true", help="only print the folder of README.md and the cases")
    return parser.parse_args(arguments)


def own(caps: Caps, *, serve: bool) -> list[Implementation]:
    """Those of this repository that run here."""
    found = []
    for command in (each for each in OWN if Path(each[1]).exists()):
        try:
            found.append(Implementation(command, caps, HERE.parent, serve=serve))
        except UnusableError as error:
            first, *rest = str(error).splitlines()
            print("not here:", first, *rest[-1:], file=sys.stderr)
    return found


def run_all(
    tested: Implementation, cases: Sequence[Case], referees: Sequence[Implementation], jobs: int,
    known: Known,
) -> list[Result]:  # fmt: skip
    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        results = list(pool.map(lambda case: run_case(case, tested, referees), cases))
    for result in results:
        result.known = known.get(result.case.id)
    return results


def main(arguments: Sequence[str] | None = None) -> int:
    given = parse(arguments)
    if given.where:
        print(HERE)
        return 0
    every = load(given.cases.resolve())
    cases = select(every, given.set, given.case)
    if given.list:
        for case in cases:
            print(f"{case.id}: {case.about} [{', '.join(case.requirements)}]")
        return 0
    if not cases:
        sets = dict.fromkeys(case.set for case in every)
        unknown = [name for name in given.set if name not in sets]
        what = f"no set {unknown[0]!r}" if unknown else "no case is called so"
        print(f"{what}; the sets are: {', '.join(sets)}", file=sys.stderr)
        return 2
    caps = Caps(given.timeout, given.memory << 20)
    programs: list[Implementation] = []
    try:
        known = read_known(given.known_failures, every)
        referees = (
            [Implementation(command, caps, serve=not given.no_serve) for command in given.referee]
            if given.referee
            else own(caps, serve=not given.no_serve)
        )
        programs += referees
        tested = (
            [Implementation(command, caps, serve=not given.no_serve) for command in given.impl]
            if given.impl
            else referees
        )
        programs += tested
        if not tested:
            raise ValueError("no implementation runs here; name yours: --impl COMMAND")
    except (UnusableError, ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    try:
        return run_and_tell(given, tested, cases, referees, known)
    finally:
        for program in programs:
            program.close()


def run_and_tell(
    given: argparse.Namespace, tested: Sequence[Implementation], cases: Sequence[Case],
    referees: Sequence[Implementation], known: Known,
) -> int:  # fmt: skip
    reports, suites, failed = [], [], False
    with tempfile.TemporaryDirectory(prefix="hapf-conformance-") as room:
        make_on_demand([c for c in cases if any(made_for(c, p) for p in tested)], Path(room))
        for place, program in enumerate(tested):
            began = time.monotonic()
            results = run_all(program, cases, referees, given.jobs, known)
            seconds = time.monotonic() - began
            names = [referee.name for referee in referees]
            print("\n".join(["", *report.text(program, results, seconds, names)][not place :]))
            reports.append(report.as_json(program, results, seconds))
            suites.append(report.junit(program, results, seconds))
            failed = failed or any(report.bad(result) for result in results)
    if given.json:
        report.write_json(given.json, reports)
    if given.junit:
        report.write_junit(given.junit, suites)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
