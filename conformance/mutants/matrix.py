"""Mutants on cases: which case kills which mutant, by the comparison that every implementation
meets."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from multiprocessing import get_context
from pathlib import Path

from runner.manifest import Case
from runner.process import Caps, Implementation, Outcome
from runner.running import FAILED, Result, run_case

from .mutant import Mutant
from .workers import SECONDS, Worker

JAVASCRIPT = Path(__file__).resolve().parent.parent / "adapters" / "js"


class Forked(Implementation):
    """hapfmt in a worker."""

    def __init__(self, mutant: Mutant | None = None) -> None:
        verbs = import_module("hapfmt.conformance.verbs")
        self.capabilities = dict(verbs.CAPABILITIES)
        self.command = ["python", "-m", "hapfmt.conformance"]
        self.caps = Caps(SECONDS)
        self.worker = Worker(mutant)

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
        copy = shutil.copytree(JAVASCRIPT, self.room / "js")
        if mutant is not None:
            mutant.apply_to(copy)
        super().__init__(["node", str(copy / "cli.js")], Caps(SECONDS))

    def close(self) -> None:
        super().close()
        shutil.rmtree(self.room, ignore_errors=True)


def implementation(mutant: Mutant | None, language: str = "python") -> Implementation:
    return (Patched if language == "javascript" else Forked)(mutant)


@dataclass
class Examined:
    """``killers``: what each case that killed the mutant found first; ``asked``: cases in all."""

    name: str
    killers: dict[str, str] = field(default_factory=dict)
    asked: int = 0
    seconds: float = 0.0

    @property
    def killed(self) -> bool:
        return bool(self.killers)


def suited(mutant: Mutant, cases: Sequence[Case], first: str = "") -> list[Case]:
    """All cases, those first that should find the mistake: the one that did so before, those of
    the rules that it breaks, and of these the small ones."""
    broken = set(mutant.requirements)

    def place(case: Case) -> tuple[bool, float, int]:
        rules = set(case.requirements)
        shared = len(rules & broken)
        size = 0 if case.on_demand or case.path.is_dir() else case.path.stat().st_size
        return case.id != first, -shared / (1 + len(rules - broken) / 8), size

    return sorted(cases, key=place)


def reason(result: Result) -> str:
    step = next(step for step in result.steps if step.status == FAILED)
    return f"{step.verb}: {step.differences[0]}"


def examine(
    mutant: Mutant, cases: Sequence[Case], first: dict[str, str], *, quick: bool
) -> Examined:
    """``quick``: up to the first case that kills."""
    began = time.monotonic()
    found = Examined(mutant.name)
    tested = implementation(mutant, mutant.language)
    referee = Forked()
    try:
        for case in suited(mutant, cases, first.get(mutant.name, "")):
            found.asked += 1
            result = run_case(case, tested, [referee])
            if result.status == FAILED:
                found.killers[case.id] = reason(result)
                if quick:
                    break
    finally:
        tested.close()
        referee.close()
    found.seconds = time.monotonic() - began
    return found


def control(cases: Sequence[Case], language: str = "python") -> Examined:
    """The program without a mistake, which no case should kill."""
    began = time.monotonic()
    found = Examined(f"(no mistake, {language})", asked=len(cases))
    tested, referee = implementation(None, language), Forked()
    try:
        for case in cases:
            result = run_case(case, tested, [referee])
            if result.status == FAILED:
                found.killers[case.id] = reason(result)
    finally:
        tested.close()
        referee.close()
    found.seconds = time.monotonic() - began
    return found


def examine_all(
    mutants: Sequence[Mutant], cases: Sequence[Case], first: dict[str, str], *, quick: bool,
    jobs: int,
) -> Iterator[Examined]:  # fmt: skip
    """One after the other, or several at a time, in the order of ``mutants``."""
    one = partial(examine, cases=cases, first=first, quick=quick)
    if jobs < 2:
        yield from map(one, mutants)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
        yield from pool.map(one, mutants)
