"""A mutant: a program with one mistake, written as changes to lines of the right one.

A change that finds its line no longer, or more than once, is an error: a mutant never falls asleep.
"""

from __future__ import annotations
import __future__

import ast
import importlib
import inspect
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

PACKAGE, ADAPTER = "hapfmt", "hapfmt_adapter"


class NotApplicableError(Exception):
    """The line that a mutant changes is not there."""


@dataclass(frozen=True)
class Edit:
    """``old`` occurs once in the source of ``place``, module:function or module:Class.method of
    hapfmt, or a file of the adapter in JavaScript; ``new`` takes its place."""

    place: str
    old: str
    new: str


@dataclass(frozen=True)
class Rebind:
    """The constant module:NAME has the value of an expression instead, wherever it was imported;
    ``users`` are the functions, module:function, that it means something to."""

    place: str
    expression: str
    users: tuple[str, ...]


@dataclass(frozen=True)
class Mutant:
    """``about``: what is wrong, in a sentence; ``requirements``: the ids that it breaks; ``role``:
    whose mistake it is."""

    name: str
    about: str
    requirements: tuple[str, ...]
    changes: tuple[Edit | Rebind, ...]
    role: str = "decoder"
    language: str = "python"

    @property
    def places(self) -> set[str]:
        """The functions of hapfmt that are not what they were: a case that calls none of them
        cannot tell."""
        found: set[str] = set()
        for change in self.changes:
            found.update(change.users if isinstance(change, Rebind) else (change.place,))
        return found

    def apply(self) -> None:
        """Change the hapfmt of this process."""
        sources: dict[str, list[Edit]] = {}
        for change in self.changes:
            if isinstance(change, Rebind):
                rebind(change)
            else:
                sources.setdefault(change.place, []).append(change)
        for place, edits in sources.items():
            function = function_of(place)
            function.__code__ = edited(function, edits)

    def apply_to(self, folder: Path) -> None:
        """Change a copy of the files in ``folder``."""
        for change in self.changes:
            assert isinstance(change, Edit)
            path = folder / change.place
            if not path.exists():
                raise NotApplicableError(f"{change.place}: no such file")
            path.write_text(replaced(path.read_text("utf-8"), change), "utf-8")


def mutant(
    name: str, about: str, requirements: str, *changes: Edit | Rebind, **given: str
) -> Mutant:
    return Mutant(name, about, tuple(requirements.split()), changes, **given)


def owner_of(place: str) -> tuple[Any, str]:
    module, _, path = place.partition(":")
    *outer, name = path.split(".")
    try:
        owner: Any = importlib.import_module(
            module if module.startswith(ADAPTER) else f"{PACKAGE}.{module}"
        )
        for part in outer:
            owner = getattr(owner, part)
    except (ImportError, AttributeError) as error:
        raise NotApplicableError(f"{place}: {error}") from None
    if name not in vars(owner):
        raise NotApplicableError(f"{place}: no such name")
    return owner, name


def function_of(place: str) -> FunctionType:
    """The object there, without what properties, class methods and caches put around it."""
    owner, name = owner_of(place)
    found = vars(owner)[name]
    for wrapper in ("fget", "__func__", "func", "__wrapped__"):
        found = getattr(found, wrapper, found)
    assert isinstance(found, FunctionType), place
    return found


def edited(function: FunctionType, edits: Sequence[Edit]) -> CodeType:
    """Its code after the edits. Exchanging the code alone reaches all who imported the function."""
    source = textwrap.dedent(inspect.getsource(function))
    for edit in edits:
        source = replaced(source, edit)
    return compiled(function, source)


def compiled(function: FunctionType, source: str, first: str = "") -> CodeType:
    """The code of ``source``, with the statement ``first`` before all others."""
    tree = ast.parse(source)
    definition = tree.body[0]
    assert isinstance(definition, ast.FunctionDef)
    definition.decorator_list = []
    definition.body[:0] = ast.parse(first).body
    flags = __future__.annotations.compiler_flag
    made: dict[str, Any] = {}
    code = compile(ast.fix_missing_locations(tree), "<mutant>", "exec", flags, dont_inherit=True)
    exec(code, function.__globals__, made)
    found: CodeType = made[function.__name__].__code__
    return found


def watch(places: Iterable[str]) -> set[str]:
    """From now on the set has those of these functions that were called."""
    called: set[str] = set()
    for place in places:
        function = function_of(place)
        function.__globals__["_called"] = called
        source = textwrap.dedent(inspect.getsource(function))
        function.__code__ = compiled(function, source, f"_called.add({place!r})")
    return called


def replaced(source: str, edit: Edit) -> str:
    count = source.count(edit.old)
    if count != 1:
        raise NotApplicableError(f"{edit.place}: {count} times in it: {edit.old}")
    return source.replace(edit.old, edit.new)


def rebind(change: Rebind) -> None:
    owner, name = owner_of(change.place)
    before = vars(owner)[name]
    after = eval(change.expression, vars(owner))
    for module in [module for path, module in sys.modules.items() if path.startswith(PACKAGE)]:
        for key, value in list(vars(module).items()):
            if value is before and key == name:
                setattr(module, key, after)
