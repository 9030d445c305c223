"""What a key of a scene description may hold: each field of a dataclass carries its own rule, which
holds alike for TOML and for values given in Python; errors name the key and say what to do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from difflib import get_close_matches
from math import isfinite
from typing import Any, TypeVar

from ..errors import ParameterError

Made = TypeVar("Made")
NONE: Any = object()
"""In place of a default: the key cannot be left out."""


class SceneError(ParameterError):
    """What is wrong with a description, and under which key."""

    def __init__(self, at: str, text: str) -> None:
        super().__init__(f"{at}: {text}" if at else text)
        self.key, self.text = at, text

    def under(self, at: str) -> SceneError:
        """The same error, where the table it was found in is at ``at``."""
        return SceneError(".".join(filter(None, (at, self.key))), self.text)


@dataclass(frozen=True)
class Key:
    """``what`` says in words what belongs there; ``read(value, at)`` gives it, or raises."""

    what: str
    read: Callable[[Any, str], Any]
    table: type[Any] | None = None


def key(what: str, read: Callable[[Any, str], Any], default: Any, table: Any = None) -> Any:
    metadata = {"key": Key(what, read, table)}
    return (
        field(metadata=metadata) if default is NONE else field(default=default, metadata=metadata)
    )


def number(
    what: str, default: Any = NONE, *, low: float = 0.0, high: float, above: float | None = None
) -> Any:
    """A float in [low, high], or in (above, high]; None where that is the default."""

    def read(value: Any, at: str) -> float | None:
        if value is None and default is None:
            return None
        return real(value, at, low, high, above)

    return key(what, read, default)


def whole(what: str, default: Any = NONE, *, low: int, high: int) -> Any:
    def read(value: Any, at: str) -> int:
        if not isinstance(value, int) or isinstance(value, bool):
            raise SceneError(at, f"is not a whole number; write one from {low} to {high}")
        if not low <= value <= high:
            raise SceneError(at, f"{shown(value)} is out of range; write {low} to {high}")
        return value

    return key(what, read, default)


def text(what: str, default: Any = "", *, most: int) -> Any:
    def read(value: Any, at: str) -> str:
        if not isinstance(value, str):
            raise SceneError(at, "is not a text; put it between quotes")
        if len(value) > most:
            raise SceneError(at, f"has {len(value)} characters; at most {most} are taken")
        return value

    return key(what, read, default)


def flag(what: str, default: bool) -> Any:
    def read(value: Any, at: str) -> bool:
        if not isinstance(value, bool):
            raise SceneError(at, "is neither true nor false; write one of them, without quotes")
        return value

    return key(what, read, default)


def choice(what: str, choices: Sequence[str], default: Any = NONE) -> Any:
    def read(value: Any, at: str) -> str | None:
        if value is None and default is None:
            return None
        return chosen(value, at, choices)

    return key(what, read, default)


def several(what: str, choices: Sequence[str], default: Any = NONE) -> Any:
    """A tuple of different ones of the choices, in the order of the choices."""

    def read(value: Any, at: str) -> tuple[str, ...] | None:
        if value is None and default is None:
            return None
        if not isinstance(value, (list, tuple)) or not value:
            raise SceneError(at, f"is not a list; write some of {', '.join(choices)} in brackets")
        found = [chosen(each, f"{at}[{n}]", choices) for n, each in enumerate(value)]
        for n, each in enumerate(found):
            if each in found[:n]:
                raise SceneError(f"{at}[{n}]", f"{each!r} is there twice; write it once")
        return tuple(each for each in choices if each in found)

    return key(what, read, default)


def pair(what: str, default: Any, *, low: float = 0.0, high: float) -> Any:
    """The smallest and the largest of something."""

    def read(value: Any, at: str) -> tuple[float, float]:
        if not isinstance(value, (list, tuple)) or len(value) != 2:
            raise SceneError(at, "is not two numbers; write [smallest, largest]")
        first, last = (real(each, f"{at}[{n}]", low, high, None) for n, each in enumerate(value))
        if first > last:
            raise SceneError(at, "begins with the larger number; write [smallest, largest]")
        return first, last

    return key(what, read, default)


def part(what: str, table: type[Any]) -> Any:
    """A table that may be left out, and then costs nothing."""

    def read(value: Any, at: str) -> Any:
        if value is None or isinstance(value, table):
            return value
        raise SceneError(at, f"is not of type {table.__name__}; give one, or None")

    return key(what, read, None, table)


def check(made: Any) -> None:
    """For ``__post_init__``: every value by its rule, and as its rule gives it."""
    for each in fields(made):
        value = each.metadata["key"].read(getattr(made, each.name), each.name)
        object.__setattr__(made, each.name, value)


def read_table(table: type[Made], values: Any, at: str = "") -> Made:
    """A TOML table as the dataclass ``table``."""
    if not isinstance(values, dict):
        raise SceneError(at, "is not a table; write it as [table] or { key = value }")
    known: dict[str, Field[Any]] = {each.name: each for each in fields(table)}  # type: ignore[arg-type]
    given: dict[str, Any] = {}
    for name, value in values.items():
        path = ".".join(filter(None, (at, name)))
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
            raise SceneError(path[:200], f"is not a known key; {hint}")
        rule: Key = known[name].metadata["key"]
        given[name] = read_table(rule.table, value, path) if rule.table else value
    for name, each in known.items():
        if name not in given and each.default is MISSING:
            raise SceneError(at, f"{name} is missing: {each.metadata['key'].what}")
    try:
        return table(**given)
    except SceneError as error:
        raise error.under(at) from None


def chosen(value: Any, at: str, choices: Sequence[str]) -> str:
    listed = ", ".join(choices)
    if not isinstance(value, str):
        raise SceneError(at, f"is not a text; write one of {listed}, between quotes")
    if value not in choices:
        near = get_close_matches(value, choices, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"choose one of {listed}"
        raise SceneError(at, f"there is no {value[:40]!r}; {hint}")
    return value


def real(value: Any, at: str, low: float, high: float, above: float | None) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise SceneError(at, "is not a number; write one, without quotes")
    if isinstance(value, float) and not isfinite(value):
        raise SceneError(at, f"{value} cannot be used; write a finite number")
    if above is not None and value <= above:
        raise SceneError(at, f"{shown(value)} is too small; write a number above {above:g}")
    if not low <= value <= high:
        raise SceneError(at, f"{shown(value)} is out of range; write {low:g} to {high:g}")
    return float(value)


def shown(value: float) -> str:
    """Python refuses to print integers of many digits."""
    return f"{value}" if isinstance(value, float) or abs(value) < 10**20 else "the number"
