"""Mutants on cases: which case kills which mutant, by the comparison that every implementation
meets."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

from runner.manifest import Case
from runner.process import Caps, Implementation, Outcome
from runner.running import FAILED, Result, run_case

from .mutant import Mutant
from .workers import SECONDS, Worker

ROOT = Path(__file__).resolve().parent.parent.parent
ADAPTER = Path("conformance", "adapters", "js")
JAVASCRIPT = Path("hapfmt", "viewer")  # its decoder


class Forked(Implementation):
    """hapfmt in a worker."""

    def __init__(self, mutant: Mutant | None = None, watched: Collection[str] = ()) -> None:
        verbs = import_module("hapfmt_adapter.verbs")
        self.capabilities = dict(verbs.CAPABILITIES)
        self.command = ["python", "conformance/adapters/python"]
        self.caps = Caps(SECONDS)
        self.worker = Worker(mutant, watched)

    def call(self, *arguments: str | Path) -> Outcome:
        began = time.monotonic()
        code = self.worker.run([str(argument) for argument in arguments])
        why = "it died, or took too long" if code is None else ""
        return Outcome(code, time.monotonic() - began, None, why)

    def close(self) -> None:
        self.worker.close()


class Patched(Implementation):
    """A copy of the adapter in JavaScript with a mutant's mistake."""

    def __init__(self, mutant: Mutant | None = None) -> None:
        self.room = Path(tempfile.mkdtemp(prefix="hapf-mutant-"))
        for folder in (ADAPTER, JAVASCRIPT):
            shutil.copytree(ROOT / folder, self.room / folder)
        if mutant is not None:
            mutant.apply_to(self.room / JAVASCRIPT / "decoder")
        super().__init__(["node", str(self.room / ADAPTER / "cli.js")], Caps(SECONDS))

    def close(self) -> None:
        super().close()
        shutil.rmtree(self.room, ignore_errors=True)


def implementation(mutant: Mutant | None, language: str = "python") -> Implementation:
    return (Patched if language == "javascript" else Forked)(mutant)


@dataclass
class Examined:
    """``killers``: what each case that killed the mutant found first; ``asked``: cases in all;
    ``wrong``: what cases found that the program without a mistake fails too."""

    name: str
    killers: dict[str, str] = field(default_factory=dict)
    asked: int = 0
    seconds: float = 0.0
    wrong: dict[str, str] = field(default_factory=dict)

    @property
    def killed(self) -> bool:
        return bool(self.killers)


VERBS = {
    "decoder": ("decode", "verify"),
    "verifier": ("verify",),
    "recoverer": ("recover",),
    "encoder": ("encode",),
}
"""By the role of a mutant, those by which it is found."""


def asked_of(mutant: Mutant, cases: Sequence[Case]) -> Iterator[Case]:
    """The cases of its role, and of each the verbs of its role. Limits take a second each: only
    where they are about the rules that it breaks."""
    for case in cases:
        codes = case.expect.get("exit", {})
        exit_ = {verb: codes[verb] for verb in VERBS[mutant.role] if verb in codes}
        about = case.set != "limits" or {*case.requirements} & {*mutant.requirements}
        if exit_ and about:
            part = replace(case)
            part.__dict__["expect"] = case.expect | {"exit": exit_}
            yield part


def suited(mutant: Mutant, cases: Sequence[Case], first: str = "") -> list[Case]:
    """Its cases, first the one that found the mistake before, then those of the rules that it
    breaks, and of these the small ones."""
    broken = set(mutant.requirements)

    def place(case: Case) -> tuple[bool, float, int]:
        rules = set(case.requirements)
        shared = len(rules & broken)
        size = case.path.stat().st_size if case.path.is_file() else 0
        return case.id != first, -shared / (1 + len(rules - broken) / 8), size

    return sorted(asked_of(mutant, cases), key=place)


def finding(result: Result) -> str | None:
    """What a case found first."""
    failed = [step for step in result.steps if step.status == FAILED]
    return f"{failed[0].verb}: {failed[0].differences[0]}" if failed else None


def examine(
    mutant: Mutant, cases: Sequence[Case], first: dict[str, str], called: Called, *, quick: bool
) -> Examined:
    """``quick``: up to the first case that kills, which counts where the program without a mistake
    passes the same case. (Else all of them were asked of that one before.) Cases that call nothing
    that the mutant changes need not be run."""
    began, places = time.monotonic(), mutant.places
    found = Examined(mutant.name)
    tested, right = implementation(mutant, mutant.language), implementation(None, mutant.language)
    referee = Forked()
    try:
        for case in suited(mutant, cases, first.get(mutant.name, "")):
            found.asked += 1
            if mutant.language == "python" and not called.get(case.id, places) & places:
                continue
            why = finding(run_case(case, tested, [referee]))
            if why is None:
                continue
            wrong = finding(run_case(case, right, [referee])) if quick else None
            if wrong is not None:
                found.wrong[case.id] = wrong
                continue
            found.killers[case.id] = why
            if quick:
                break
    finally:
        for program in (tested, right, referee):
            program.close()
    found.seconds = time.monotonic() - began
    return found


Called = dict[str, set[str]]
"""By case, the functions that it calls of those that mutants change."""


def control(
    cases: Sequence[Case], language: str = "python", places: Collection[str] = ()
) -> tuple[Examined, Called]:
    """The program without a mistake, which no case should kill; and which of the functions in
    ``places`` each case calls."""
    began = time.monotonic()
    found = Examined(f"(no mistake, {language})", asked=len(cases))
    right = Patched() if language == "javascript" else Forked(None, places)
    referee = Forked()
    called: Called = {}
    try:
        for case in cases:
            if isinstance(right, Forked):
                called[case.id] = right.worker.called = set()
            why = finding(run_case(case, right, [referee]))
            if why is not None:
                found.wrong[case.id] = why
    finally:
        right.close()
        referee.close()
    found.seconds = time.monotonic() - began
    return found, called


def examine_all(
    mutants: Sequence[Mutant], cases: Sequence[Case], first: dict[str, str], called: Called, *,
    quick: bool, jobs: int,
) -> Iterator[Examined]:  # fmt: skip
    """One after the other, or several at a time, in the order of ``mutants``."""
    one = partial(examine, cases=cases, first=first, called=called, quick=quick)
    if jobs < 2:
        yield from map(one, mutants)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
        yield from pool.map(one, mutants)
