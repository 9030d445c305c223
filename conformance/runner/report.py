"""The outcome for a person, as JSON, and as JUnit XML."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from .manifest import rules
from .process import Implementation
from .running import FAILED, PASSED, SKIPPED, Result, Step, claimed_parts

KNOWN, FIXED = "known failure", "passes although listed"
COLUMNS = ("set", "cases", PASSED, FAILED, "known", SKIPPED)
SHOWN = 3
"""Differences of a verb that are printed."""
SHOWN_RULES = 12
SHOWN_FAILURES = 40


def status_of(result: Result) -> str:
    if result.known is None or result.status == SKIPPED:
        return result.status
    return KNOWN if result.status == FAILED else FIXED


def bad(result: Result) -> bool:
    return status_of(result) in (FAILED, FIXED)


def counts(results: Iterable[Result]) -> dict[str, Counter[str]]:
    """By set; ``all`` at the end."""
    found: dict[str, Counter[str]] = {}
    every: Counter[str] = Counter()
    for result in results:
        row = found.setdefault(result.case.set, Counter())
        for counter in (row, every):
            counter.update(["cases", status_of(result)])
    return found | {"all": every}


def table(results: Sequence[Result]) -> Iterator[str]:
    widths = (14, 6, 7, 7, 6, 11)
    head = [COLUMNS[0].ljust(widths[0])]
    head += [name.rjust(width) for name, width in zip(COLUMNS[1:], widths[1:], strict=True)]
    yield " ".join(head)
    for name, row in counts(results).items():
        failed = row[FAILED] + row[FIXED]
        cells = (row["cases"], row[PASSED], failed, row[KNOWN], row[SKIPPED])
        yield " ".join(
            [name.ljust(widths[0])]
            + [str(cell).rjust(width) for cell, width in zip(cells, widths[1:], strict=True)]
        )


def requirements(results: Iterable[Result], *, exercised: bool) -> set[str]:
    return {
        rule
        for result in results
        if (result.status != SKIPPED) == exercised
        for rule in result.case.requirements
    }


def not_exercised(results: Sequence[Result]) -> list[str]:
    """Rules of cases none of which was run."""
    return sorted(requirements(results, exercised=False) - requirements(results, exercised=True))


def about(tested: Implementation) -> str:
    told = tested.capabilities
    verbs = " ".join(verb for verb in told["verbs"] if verb != "serve")
    parts = " ".join(told["parts"]) or "exit codes only"
    return (
        f"{tested.name} {told.get('version', '')}: level {told['level']}; {verbs}; "
        f"{' '.join(told['codecs']) or 'no codec'}; {parts}"
    )


def text(
    tested: Implementation, results: Sequence[Result], seconds: float, referees: Sequence[str]
) -> Iterator[str]:
    yield about(tested)
    failures = [result for result in results if bad(result)]
    for result in failures[:SHOWN_FAILURES]:
        yield ""
        yield from failure(result)
    if len(failures) > SHOWN_FAILURES:
        yield f"\nand {len(failures) - SHOWN_FAILURES} more (--json and --junit have all)"
    yield ""
    yield from table(results)
    known = [result for result in results if status_of(result) == KNOWN]
    for result in known:
        yield f"known failure: {result.case.id}: {result.known}"
    reasons = Counter(
        reason for result in results if result.status == SKIPPED for reason in result.reasons
    )
    for reason, count in reasons.most_common():
        yield f"not tested: {count} cases for want of {reason}"
    parts = claimed_parts(tested)
    if parts:
        yield f"not compared, since not claimed: {', '.join(parts)}"
    unheard = not_exercised(results)
    if unheard:
        yield f"requirements not exercised: {len(unheard)}: {', '.join(unheard)}"
    without = sorted(set(rules()) - {rule for r in results for rule in r.case.requirements})
    if without and len(without) <= SHOWN_RULES:
        yield f"rules of SPEC.md for which no case was chosen: {', '.join(without)}"
    elif without:
        yield f"rules of SPEC.md for which no case was chosen: {len(without)} (--json has all)"
    if any(s.verb.startswith(("recover,", "encode,")) for r in results for s in r.steps):
        yield f"referees: {', '.join(referees) or 'none, so only bytes were checked'}"
    slow = max(results, key=lambda result: result.seconds, default=None)
    if slow is not None and slow.seconds:
        yield f"{seconds:.1f} s; the longest case was {slow.case.id}, {slow.seconds:.2f} s"


def failure(result: Result) -> Iterator[str]:
    case = result.case
    word = "FAILED" if status_of(result) == FAILED else "PASSES, ALTHOUGH LISTED AS FAILING"
    fault = f" [{case.fault}]" if case.fault else ""
    yield f"{word} {case.id}{fault}: {case.about}"
    yield f"  rules: {', '.join(case.requirements)}"
    for step in result.steps:
        if step.status == FAILED:
            yield from step_lines(step)


def step_lines(step: Step) -> Iterator[str]:
    for difference in step.differences[:SHOWN]:
        yield f"  {step.verb}: {difference}"
    if len(step.differences) > SHOWN:
        yield f"  {step.verb}: and {len(step.differences) - SHOWN} more differences"
    if step.outcome and step.outcome.errors.strip():
        yield f"  it said: {step.outcome.errors.strip().splitlines()[-1][:200]}"
    if step.command:
        yield f"  again: {shlex.join(step.command)}"


def step_json(step: Step) -> dict[str, Any]:
    out: dict[str, Any] = {"verb": step.verb, "status": step.status}
    if step.reason:
        out["reason"] = step.reason
    if step.outcome:
        out |= {
            "exit_code": step.outcome.code, "seconds": round(step.outcome.seconds, 4),
            "peak_bytes": step.outcome.peak,
        }  # fmt: skip
        if step.outcome.why:
            out["why"] = step.outcome.why
    if step.differences:
        out["differences"] = [
            {"where": d.where, "expected": d.wanted, "found": d.found} for d in step.differences
        ]
    return out


def as_json(tested: Implementation, results: Sequence[Result], seconds: float) -> dict[str, Any]:
    every = {rule for result in results for rule in result.case.requirements}
    return {
        "implementation": tested.capabilities,
        "command": tested.command,
        "seconds": round(seconds, 3),
        "counts": {name: dict(row) for name, row in counts(results).items()},
        "cases": [
            {
                "set": result.case.set, "name": result.case.name, "status": status_of(result),
                "requirements": result.case.requirements,
                "steps": [step_json(step) for step in result.steps],
            }
            for result in results
        ],
        "requirements_not_exercised": not_exercised(results),
        "rules_without_case": sorted(set(rules()) - every),
        "parts_not_claimed": claimed_parts(tested),
    }  # fmt: skip


def write_json(path: Path, reports: Sequence[dict[str, Any]]) -> None:
    text = json.dumps({"runs": list(reports)}, indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def junit(tested: Implementation, results: Sequence[Result], seconds: float) -> str:
    rows = []
    for result in results:
        name, group = quoteattr(result.case.name), quoteattr(f"{tested.name}.{result.case.set}")
        inner, status = "", status_of(result)
        if bad(result):
            lines = "\n".join(failure(result))
            inner = f"<failure message={quoteattr(result.case.about)}>{escape(lines)}</failure>"
        elif status == KNOWN:
            inner = f"<skipped message={quoteattr(f'known failure: {result.known}')}/>"
        elif status == SKIPPED:
            inner = f"<skipped message={quoteattr('for want of ' + ', '.join(result.reasons))}/>"
        rows.append(
            f"<testcase classname={group} name={name} time={quoteattr(f'{result.seconds:.4f}')}>"
            f"{inner}</testcase>"
        )
    failed = sum(bad(result) for result in results)
    skipped = sum(status_of(result) in (KNOWN, SKIPPED) for result in results)
    return (
        f"<testsuite name={quoteattr(tested.name)} tests={quoteattr(str(len(results)))} "
        f'failures="{failed}" errors="0" skipped="{skipped}" time="{seconds:.3f}">\n'
        + "\n".join(rows)
        + "\n</testsuite>"
    )


def write_junit(path: Path, suites: Sequence[str]) -> None:
    body = "\n".join(suites)
    legal = "".join(c for c in body if c in "\t\n\r" or c >= " ")
    path.write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<testsuites>\n{legal}\n</testsuites>\n',
        encoding="utf-8",
    )
