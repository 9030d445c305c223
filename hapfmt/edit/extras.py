"""The metadata of several files as one, with nothing lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def combined(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Members of all; one that differs from those of its name gets a number, as attachments do, and
    notes follow one another."""
    found: dict[str, Any] = {}
    notes: list[Any] = []
    for part in parts:
        for name, value in part.items():
            if name == "notes":
                listed = value if isinstance(value, list) else [value]
                notes += [note for note in listed if note not in notes]
                continue
            number, key = 1, name
            while key in found and not same(found[key], value):
                number += 1
                key = f"{name} ({number})"
            found[key] = value
    return found | ({"notes": notes} if notes else {})


def same(a: Any, b: Any) -> bool:
    """Equal as JSON: true is not 1."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and bool(a == b)
