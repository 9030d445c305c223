"""A component file: one part of the format by itself, cases with inputs and what comes out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from page import BrokenRule

WIDTH = 100
SAFE = 2**53
"""Greater numbers are text: many readers of JSON hold no more."""

Case = dict[str, Any]


@dataclass(frozen=True)
class Component:
    name: str
    clause: str
    requirements: Sequence[str]
    about: str
    cases: Sequence[Case]

    def as_json(self) -> dict[str, Any]:
        names = [case["name"] for case in self.cases]
        assert len(names) == len({*names}), f"{self.name}: a name twice"
        return {
            "component": self.name,
            "clause": self.clause,
            "requirements": list(self.requirements),
            "about": self.about,
            "cases": [plain(case) for case in self.cases],
        }


def plain(value: Any) -> Any:
    """Bytes as hexadecimal, large integers as text."""
    if isinstance(value, (bytes, bytearray)):
        return value.hex()
    if isinstance(value, bool) or not isinstance(value, int):
        if isinstance(value, dict):
            return {str(key): plain(each) for key, each in value.items()}
        if isinstance(value, (list, tuple)):
            return [plain(each) for each in value]
        return value
    return value if abs(value) <= SAFE else str(value)


def tried(case: Case, run: Callable[[], Case]) -> Case:
    """The case with what comes out, or with the rule that is broken, or the rules that may be "
    "named."""
    try:
        return case | run()
    except BrokenRule as broken:
        ids = list(broken.args)
        return case | {"error": ids if len(ids) > 1 else ids[0]}


def also(cases: list[Case], others: dict[str, list[str]]) -> list[Case]:
    """Cases by name, in which other rules may be named as well."""
    for case in cases:
        for id_ in others.pop(case["name"], []):
            ids = case["error"] if isinstance(case["error"], list) else [case["error"]]
            case["error"] = [*ids, id_]
    assert not others, others
    return cases


def lines(value: Any, indent: str = "") -> Iterator[str]:
    """JSON in lines: what fits on a line takes one; rows of numbers are filled."""
    short = json.dumps(value, ensure_ascii=False)
    if len(indent) + len(short) <= WIDTH or not isinstance(value, (dict, list)) or not value:
        yield indent + short
        return
    inner = indent + " "
    if isinstance(value, dict):
        yield indent + "{"
        for i, (key, each) in enumerate(value.items()):
            rows = list(lines(each, inner))
            rows[0] = f"{inner}{json.dumps(key)}: {rows[0].lstrip(' ')}"
            rows[-1] += "," if i < len(value) - 1 else ""
            yield from rows
        yield indent + "}"
        return
    yield indent + "["
    if all(not isinstance(each, (dict, list)) for each in value):
        yield from filled([json.dumps(each, ensure_ascii=False) for each in value], inner)
    else:
        for i, each in enumerate(value):
            rows = list(lines(each, inner))
            rows[-1] += "," if i < len(value) - 1 else ""
            yield from rows
    yield indent + "]"


def filled(words: list[str], indent: str) -> Iterator[str]:
    row = ""
    for i, word in enumerate(words):
        more = word + ("," if i < len(words) - 1 else "")
        if row and len(indent) + len(row) + 1 + len(more) > WIDTH:
            yield indent + row
            row = ""
        row = f"{row} {more}".strip()
    yield indent + row


def text(component: Component) -> bytes:
    return ("\n".join(lines(component.as_json())) + "\n").encode()
