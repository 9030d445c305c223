"""One case on one implementation: its verbs, and what became of each."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .compare import (
    PARTS,
    VERDICTS,
    Difference,
    decode_differences,
    exit_differences,
    verify_differences,
)
from .manifest import Case
from .process import Implementation, Outcome
from .schema import check

PASSED, FAILED, SKIPPED = "passed", "failed", "not tested"
LOST = 3
REFUSED = 2
"""With this exit code nothing that was written counts."""
RECOVERED_ANEW = ("file_id",)
"""Members of head that a recovered file has of its own."""


@dataclass
class Step:
    """A verb, or a check of an encoder."""

    verb: str
    status: str = PASSED
    differences: list[Difference] = field(default_factory=list)
    reason: str = ""
    """Why it was not tested."""
    command: list[str] = field(default_factory=list)
    outcome: Outcome | None = None

    def __post_init__(self) -> None:
        if self.differences and self.status == PASSED:
            self.status = FAILED


@dataclass
class Result:
    case: Case
    steps: list[Step]
    known: str | None = None
    """The reason, where the case is listed as a known failure."""

    @property
    def status(self) -> str:
        found = {step.status for step in self.steps}
        return FAILED if FAILED in found else PASSED if PASSED in found else SKIPPED

    @property
    def reasons(self) -> list[str]:
        """Why what was not tested was not."""
        found = {step.reason for step in self.steps if step.status == SKIPPED}
        return sorted({each for each in found if not each.startswith("verb ")} or found)

    @property
    def seconds(self) -> float:
        return sum(step.outcome.seconds for step in self.steps if step.outcome)


def run_case(case: Case, tested: Implementation, referees: Sequence[Implementation]) -> Result:
    """Every verb for which the case says an exit code."""
    steps = []
    with tempfile.TemporaryDirectory(prefix="hapf-conformance-") as room:
        for verb in case.expect.get("exit", {}):
            reason = not_claimed(case, verb, tested)
            if reason:
                steps.append(Step(verb, SKIPPED, reason=reason))
                continue
            folder = Path(room, verb)
            folder.mkdir()
            if verb == "decode":
                steps.append(check_decode(case, tested, folder))
            elif verb == "verify":
                steps.append(check_verify(case, tested, folder))
            elif verb == "recover":
                steps += check_recover(case, tested, referees, folder)
            elif verb == "encode":
                from .encoding import check_encode

                steps += check_encode(case, tested, referees, folder)
    return Result(case, steps)


def made_for(case: Case, tested: Implementation) -> bool:
    return case.set in tested.capabilities.get("sets", [case.set])


def not_claimed(case: Case, verb: str, tested: Implementation) -> str:
    """What the implementation lacks for the verb, or nothing."""
    needs, told = case.expect.get("needs", {}), tested.capabilities
    if not made_for(case, tested):
        return f"set {case.set}"
    if case.on_demand and not case.file.exists():
        return "the generator gen/make.py, which makes their files"
    if verb not in told["verbs"]:
        return f"verb {verb}"
    for codec in needs.get("codecs", []):
        if codec not in told["codecs"]:
            return f"codec {codec}"
    for preset in needs.get("presets", []):
        if preset not in told.get("presets", []):
            return f"preset {preset}"
    if needs.get("level", 1) > told["level"]:
        return f"level {needs['level']}"
    return ""


def ended(outcome: Outcome, wanted: Any) -> list[Difference]:
    if outcome.why:
        return [Difference("the program", f"exit code {wanted}", outcome.why)]
    return exit_differences(wanted, outcome.code)


def read_json(path: Path) -> tuple[dict[str, Any], list[Difference]]:
    """The object in a file; what is wrong where there is none."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}, [Difference(path.name, "a JSON object", "no file")]
    except (ValueError, OSError) as error:
        return {}, [Difference(path.name, "a JSON object", f"what is none ({error})")]
    if not isinstance(value, dict):
        return {}, [Difference(path.name, "a JSON object", type(value).__name__)]
    return value, []


def read_report(path: Path, outcome: Outcome) -> tuple[dict[str, Any], list[Difference]]:
    """A report whose verdict is that of the exit code."""
    report, differences = read_json(path)
    if not differences:
        differences = check(report, "verify", path.name)
    if not differences and report["verdict"] != VERDICTS.get(outcome.code):
        wanted = f"that of exit code {outcome.code}, {VERDICTS.get(outcome.code)}"
        differences = [Difference("verdict", wanted, report["verdict"])]
    return report, differences


def compare_decoded(folder: Path, wanted: dict[str, Any], parts: Sequence[str]) -> list[Difference]:
    """What a decoder wrote into ``folder``."""
    found, differences = read_json(folder / "decode.json")
    if not differences:
        claimed = {k: v for k, v in found.items() if PARTS.get(k, "head") in {"head", *parts}}
        differences = check(claimed, "decode", "decode.json")
    if not differences:
        differences = decode_differences(
            wanted, found, lambda name: (folder / Path(name).name).read_bytes(), parts
        )
    return differences


def check_decode(case: Case, tested: Implementation, folder: Path) -> Step:
    expect = case.expect
    outcome = tested.call("decode", case.file, folder)
    differences = ended(outcome, expect["exit"]["decode"])
    if not differences and "decode" in expect and delivered(outcome, folder):
        differences = compare_decoded(folder, expect["decode"], tested.capabilities["parts"])
    return step("decode", differences, tested, outcome, "decode", case.file, "OUT")


def delivered(outcome: Outcome, folder: Path) -> bool:
    """Whether decode.json is looked at."""
    there = (folder / "decode.json").exists()
    return outcome.code in (0, 3) or (outcome.code != REFUSED and there)


def check_verify(case: Case, tested: Implementation, folder: Path) -> Step:
    path = folder / "report.json"
    original = ["--original", case.job] if case.path.is_dir() else []
    outcome = tested.call("verify", case.file, path, *original)
    differences = ended(outcome, case.expect["exit"]["verify"])
    if not differences:
        report, differences = read_report(path, outcome)
        if not differences:
            parts = tested.capabilities["parts"]
            differences = verify_differences(case.expect, report, parts)
    return step("verify", differences, tested, outcome, "verify", case.file, "OUT.json", *original)


def check_recover(
    case: Case, tested: Implementation, referees: Sequence[Implementation], folder: Path
) -> list[Step]:
    expect, target, report = case.expect, folder / "recovered.hapf", folder / "report.json"
    outcome = tested.call("recover", case.file, target, report)
    differences = ended(outcome, expect["exit"]["recover"])
    if not differences and outcome.code in (0, 3):
        differences = read_report(report, outcome)[1]
        if not target.exists():
            differences.append(Difference("recover", "a recovered file", "none"))
    steps = [step("recover", differences, tested, outcome, "recover", case.file, "OUT", "REPORT")]
    if differences or outcome.code not in (0, 3):
        return steps
    wanted = expect.get("recover", {})
    decode = wanted.get("decode", kept_by_recovery(expect.get("decode", {})))
    for number, referee in enumerate(referees):
        reason = lacks(case, referee)
        if reason:
            continue
        room = folder / str(number)
        (room / "decoded").mkdir(parents=True)
        judged = referee.call("verify", target, room / "report.json")
        found, differences = read_json(room / "report.json")
        verdict = wanted.get("verdict", "intact")
        if not differences and found.get("verdict") != verdict:
            first = next(iter([*found.get("findings", []), *found.get("damages", [])]), {})
            told = f"{found.get('verdict')}: {first.get('requirement')} {first.get('message')}"
            differences = [Difference("verdict on the recovered file", verdict, told)]
        named = f"recover, by {referee.name}"
        steps.append(step(named, differences, referee, judged, "verify", "RECOVERED", "OUT.json"))
        judged = referee.call("decode", target, room / "decoded")
        differences = ended(judged, 0 if verdict == "intact" else [0, 3, 4])
        if not differences and delivered(judged, room / "decoded"):
            parts = referee.capabilities["parts"]
            differences = compare_decoded(room / "decoded", decode, parts)
            if not differences:
                found = read_json(room / "decoded" / "decode.json")[0]
                differences = told_differences(wanted, outcome.code, found, parts)
        steps.append(step(named, differences, referee, judged, "decode", "RECOVERED", "OUT"))
    if len(steps) == 1:
        steps.append(Step("recover, by a referee", SKIPPED, reason="a referee for the codecs"))
    return steps


def told_differences(
    wanted: dict[str, Any], code: int, found: dict[str, Any], parts: Sequence[str]
) -> list[Difference]:
    """Types of unknown chunks that came along, and how many notes there are at least: one where
    something was lost (REC-010)."""
    out = []
    types = sorted(row[0] for row in found.get("unknown", []))
    if "unknown" in parts and sorted(wanted.get("unknown", types)) != types:
        out.append(Difference("unknown", str(wanted["unknown"]), str(types)))
    notes = (found.get("metadata") or {}).get("notes", [])
    least = max(wanted.get("notes", 0), code == LOST)
    if "metadata" in parts and (not isinstance(notes, list) or len(notes) < least):
        out.append(Difference("metadata.notes", f"{least} or more", str(notes)))
    return out


def kept_by_recovery(decode: dict[str, Any]) -> dict[str, Any]:
    """Of what the damaged file decodes to, what the recovered one does too: not the file id, not
    the offsets of chunks, and the metadata may have got a note."""
    kept = {name: value for name, value in decode.items() if name not in ("unknown", "metadata")}
    if isinstance(kept.get("head"), dict):
        kept["head"] = {k: v for k, v in kept["head"].items() if k not in RECOVERED_ANEW}
    elif "head" in kept:
        del kept["head"]
    return kept


def lacks(case: Case, referee: Implementation) -> str:
    """What a referee lacks for the case."""
    return next(
        (reason for verb in ("decode", "verify") if (reason := not_claimed(case, verb, referee))),
        "",
    )


def step(
    verb: str, differences: Sequence[Difference], program: Implementation, outcome: Outcome,
    *arguments: object,
) -> Step:  # fmt: skip
    command = [*program.command, *map(nearby, arguments)]
    return Step(verb, differences=list(differences), command=command, outcome=outcome)


def nearby(argument: object) -> str:
    """A path as one would type it here."""
    here = Path.cwd()
    if isinstance(argument, Path) and argument.is_relative_to(here):
        return str(argument.relative_to(here))
    return str(argument)


def claimed_parts(tested: Implementation) -> list[str]:
    """Parts that there are, and that this implementation does not tell."""
    every = {*PARTS.values(), "exact", "physical", "findings"}
    return sorted(every - set(tested.capabilities["parts"]))


def clean(folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
