"""Mutants of one module: which of its possible mistakes do the given tests find?

python tools/mutate.py hapfmt/replay/schedule.py --tests "tests/test_replay_schedule.py"

Each mutant changes one place of the module: a comparison, a sign, a number, a condition, a result,
or a statement that is left out. A process of its own imports it and runs the tests up to the first
that fails. Nothing is written into the clone. Programs that tests start see the module as it is.
Prints a table and every mutant that survives. Needs POSIX.
"""

from __future__ import annotations

import ast
import io
import os
import random
import resource
import shlex
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

import installed

import click
import hypothesis
import pytest
from measured import print_table

COMPARED: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
"""Another boundary, and the opposite."""
CALCULATED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.FloorDiv, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift,
}  # fmt: skip
SWAPPED = {"min": "max", "max": "min", "any": "all", "all": "any", "ceil": "floor", "floor": "ceil"}
STATEMENTS = ast.Assign | ast.AugAssign | ast.AnnAssign | ast.Expr | ast.Raise | ast.Continue
OPTIONS = ["-p", "no:cacheprovider", "--tb=no", "--assert=plain"]
MEMORY = 2 << 30
LATE = (signal.SIGPROF, signal.SIGALRM)
GROWTH, WAITING = 4, 40
"""A mutant may take this many times the CPU time of the module itself, and this many times longer
if it only waits. Other work on the machine makes no mutant late."""


class Mutant(NamedTuple):
    kind: str
    line: int
    change: str
    code: CodeType


def expressions(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """What may replace an expression."""
    match node:
        case ast.Compare(left, ops, others):
            for place, op in enumerate(ops):
                for other in COMPARED[type(op)]:
                    changed = [*ops[:place], other(), *ops[place + 1 :]]
                    yield "comparison", ast.Compare(left, changed, others)
        case ast.BoolOp(op, values):
            yield "and, or", ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
            for place in range(len(values)):
                rest = [*values[:place], *values[place + 1 :]]
                yield "operand left out", rest[0] if len(rest) == 1 else ast.BoolOp(op, rest)
        case ast.BinOp(left, op, right) if type(op) in CALCULATED:
            yield "arithmetic", ast.BinOp(left, CALCULATED[type(op)](), right)
        case ast.UnaryOp(ast.Not() | ast.USub() | ast.UAdd(), operand):
            yield "sign, not", operand
        case ast.Constant(bool(value)):
            yield "constant", ast.Constant(not value)
        case ast.Constant(int(value) | float(value)):
            yield "constant", ast.Constant(value + 1)
            yield "constant", ast.Constant(value - 1)
        case ast.Call(ast.Name(name), arguments, keywords) if name in SWAPPED:
            yield "min, max", ast.Call(ast.Name(SWAPPED[name], ast.Load()), arguments, keywords)


def statements(node: ast.AST, inside: bool) -> Iterator[tuple[str, ast.stmt]]:
    """What may replace a statement; ``inside`` a function."""
    match node:
        case ast.Return(ast.expr() as value):
            if not (isinstance(value, ast.Constant) and value.value is None):
                yield "result", ast.Return(ast.Constant(None))
        case ast.Expr(ast.Constant()) | ast.AnnAssign(value=None):
            return
        case ast.AugAssign(target, op, value) if type(op) in CALCULATED:
            yield "arithmetic", ast.AugAssign(target, CALCULATED[type(op)](), value)
    if inside and isinstance(node, STATEMENTS):
        yield "statement left out", ast.Pass()


Place = tuple[str, ast.AST, str, int | None, ast.AST]


def places(node: ast.AST, inside: bool = False) -> Iterator[Place]:
    """Each change: its kind, the parent, the field, the place in a list, and the new node.

    Annotations and the texts of errors stay as they are."""
    inside = inside or isinstance(node, ast.FunctionDef)
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "exc", "decorator_list"):
            continue
        for place, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.JoinedStr):
                continue
            found = [*statements(child, inside), *expressions(child)]
            condition = field == "test" or isinstance(node, ast.BoolOp)
            if condition and isinstance(child, ast.Name | ast.Attribute | ast.Call):
                found.append(("sign, not", ast.UnaryOp(ast.Not(), child)))
            yield from ((kind, node, field, place, new) for kind, new in found)
            yield from places(child, inside)


def described(old: ast.AST, new: ast.AST) -> str:
    if isinstance(new, ast.Pass):
        return f"without {ast.unparse(old)}"
    if isinstance(old, ast.BoolOp):
        kept = new.values if isinstance(new, ast.BoolOp) else [new]
        if left_out := [value for value in old.values if value not in kept]:
            return f"without {ast.unparse(left_out[0])}"
    return f"{ast.unparse(old)} -> {ast.unparse(new)}"


def mutants_of(source: str, path: str = "<module>") -> list[Mutant]:
    """All, in the order of their lines."""
    tree, found = ast.parse(source), []
    for kind, parent, field, place, new in list(places(tree)):
        owner: Any = getattr(parent, field) if place is not None else vars(parent)
        key: Any = field if place is None else place
        old, owner[key] = owner[key], new
        ast.copy_location(new, old)
        ast.fix_missing_locations(new)
        found.append(Mutant(kind, old.lineno, described(old, new), compile(tree, path, "exec")))
        owner[key] = old
    return sorted(found, key=lambda mutant: mutant.line)


class Loader(SourceFileLoader):
    """Gives a module other code than its file has."""

    code: CodeType

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        return self.code

    def find_spec(self, name: str, path: object, target: object = None) -> ModuleSpec | None:  # noqa: ARG002
        return spec_from_file_location(name, self.path, loader=self) if name == self.name else None


class Quick:
    """Failing examples are neither kept nor made smaller."""

    @pytest.hookimpl(trylast=True)
    def pytest_configure(self) -> None:
        phases = [hypothesis.Phase.explicit, hypothesis.Phase.generate]
        settings = hypothesis.settings(database=None, derandomize=True, phases=phases)
        settings.register_profile("mutants", settings)
        settings.load_profile("mutants")


def prepare(tests: list[str]) -> None:
    """Import once what every process needs, but for the modules of the clone."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        pytest.main(["--collect-only", *OPTIONS, *tests])
    folders = [str(installed.ROOT / part) for part in ("hapfmt", "tests", "conformance")]
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(tuple(folders)):
            del sys.modules[name]


def start(loader: Loader, code: CodeType, tests: list[str], seconds: float) -> int:
    """A process that ends with what pytest ends with; a signal ends it after ``seconds``."""
    if pid := os.fork():
        return pid
    signal.setitimer(signal.ITIMER_PROF, GROWTH * seconds)
    signal.setitimer(signal.ITIMER_REAL, WAITING * seconds)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    loader.code = code
    sys.meta_path.insert(0, loader)  # type: ignore[arg-type]
    try:
        os._exit(pytest.main(["-x", *OPTIONS, *tests], [Quick()]))
    except BaseException:
        os._exit(1)


def run(
    loader: Loader, mutants: list[Mutant], tests: list[str], seconds: float, jobs: int
) -> Iterator[tuple[Mutant, str]]:
    running: dict[int, Mutant] = {}
    waiting = list(reversed(mutants))
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            running[start(loader, mutant.code, tests, seconds)] = mutant
        pid, status = os.wait()
        slow = os.WIFSIGNALED(status) and os.WTERMSIG(status) in LATE
        yield running.pop(pid), "timed out" if slow else "killed" if status else "survived"


@click.command(help=__doc__)
@click.argument("module", type=click.Path(exists=True, path_type=Path))
@click.option("--tests", required=True, help="What pytest runs: files, or options of its own.")
@click.option("--sample", type=click.IntRange(1), help="Only this many, chosen at random.")
@click.option("--seed", default=1, show_default=True, help="Of the choice.")
@click.option("--jobs", default=2, show_default=True, help="Mutants at a time.")
def main(module: Path, tests: str, sample: int | None, seed: int, jobs: int) -> None:
    path, asked = module.resolve(), shlex.split(tests)
    name = ".".join(path.relative_to(installed.ROOT).with_suffix("").parts)
    source = path.read_text("utf-8")
    mutants = mutants_of(source, str(path))
    if sample is not None:
        chosen = random.Random(seed).sample(range(len(mutants)), min(sample, len(mutants)))
        mutants = [mutants[place] for place in sorted(chosen)]
    os.chdir(installed.ROOT)
    prepare(asked)
    loader, began = Loader(name, str(path)), time.monotonic()
    right = Mutant("none", 0, "none", compile(source, str(path), "exec"))
    if [found for _, found in run(loader, [right], asked, 3600, 1)] != ["survived"]:
        sys.exit("the tests fail without a mutant")
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = used.ru_utime + used.ru_stime + 1
    kinds: dict[str, Counter[str]] = {}
    for mutant, found in run(loader, mutants, asked, seconds, jobs):
        kinds.setdefault(mutant.kind, Counter())[found] += 1
        if found == "survived":
            click.echo(f"{module}:{mutant.line}: {mutant.change}")
    fates = ("killed", "timed out", "survived")
    rows = [[kind, *(count[fate] for fate in fates)] for kind, count in sorted(kinds.items())]
    rows.append(["all", *(sum(count[fate] for count in kinds.values()) for fate in fates)])
    print_table(["change", *fates], rows)
    click.echo(f"{len(mutants)} mutants in {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
