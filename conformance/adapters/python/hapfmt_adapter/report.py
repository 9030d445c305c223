"""The verbs verify and recover: the damage report, and what is not damage."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hapfmt.errors import VERDICTS, HapfmtError

from .raw import write_json

NAMED = re.compile(r"\[([A-Z]{3}-\d{3})\]")
EMPTY: dict[str, Any] = {"damages": [], "lost": [], "byte_count": 0, "channels": []}


def verify_into(source: str, target: str, original: str | None) -> int:
    from hapfmt.reading.verifier import verify

    against = None
    if original is not None:
        from .job import read_job

        against = read_job(Path(original))[0]
    found = verify(source, against=against)
    contracts = [
        {"channel": each.channel, "outside": each.outside, "worst": float(each.worst_ratio)}
        for each in found.contracts
    ]
    write_report(target, found.exit_code, found.damage, found.error, contracts)
    return found.exit_code


def recover_into(source: str, target: str, report: str) -> int:
    from hapfmt.edit.recover import recover

    try:
        done = recover(source, target, force=True)
    except HapfmtError as error:
        if error.exit_code in VERDICTS:
            write_report(report, error.exit_code, None, error)
        raise
    write_report(report, done.exit_code, done.damage)
    return done.exit_code


def write_report(
    target: str,
    code: int,
    damage: dict[str, Any] | None,
    error: HapfmtError | None = None,
    contracts: list[dict[str, Any]] | None = None,
) -> None:
    findings = [finding_of(error)] if error else []
    write_json(
        Path(target),
        {
            "verdict": VERDICTS[code],
            **(damage or EMPTY),
            "findings": findings,
            "contracts": contracts or [],
        },
    )


def finding_of(error: HapfmtError) -> dict[str, Any]:
    """The finding of an error; the message about an unsupported part names the rule."""
    named = NAMED.search(error.message)
    return {
        "requirement": error.requirement or (named[1] if named else None),
        "offset": error.offset,
        "message": error.message,
    }
