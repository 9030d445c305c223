"""Values out of a TOML table, each checked; errors name the key path and say what to do."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from math import isfinite
from typing import Any, NoReturn

from ...errors import ParameterError


class ProfileError(ParameterError):
    """What is wrong with a profile, where."""

    def __init__(self, at: str, text: str, requirement: str | None = None) -> None:
        super().__init__(f"{at}: {text}" if at else text, requirement=requirement)


REQUIRED: Any = object()


class Table:
    """One table: keys are taken one by one, and ``done`` refuses those that nobody took."""

    def __init__(self, values: Any, at: str = "") -> None:
        if not isinstance(values, dict):
            raise ProfileError(at, "is not a table; write it as [table] or { key = value }")
        self.values = values
        self.at = at
        self.known: list[str] = []

    def path(self, key: str) -> str:
        return f"{self.at}.{key}" if self.at else key

    def fail(self, key: str, text: str, requirement: str | None = None) -> NoReturn:
        raise ProfileError(self.path(key), text, requirement)

    def has(self, key: str) -> bool:
        return key in self.values

    def take(self, key: str, default: Any, what: str, requirement: str | None = None) -> Any:
        self.known.append(key)
        if key in self.values:
            return self.values[key]
        if default is REQUIRED:
            self.fail(key, f"is missing; add {what}", requirement)
        return default

    def done(self) -> None:
        for key in self.values:
            if key not in self.known:
                near = get_close_matches(key, self.known, 1)
                hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(self.known)}"
                self.fail(key, f"is not a known key; {hint}")

    def text(
        self, key: str, default: Any = REQUIRED, most: int = 4000, pattern: str | None = None
    ) -> str:
        value = self.take(key, default, "a text")
        if not isinstance(value, str):
            self.fail(key, "is not a text; put it between quotes")
        if len(value) > most:
            self.fail(key, f"has {len(value)} characters; at most {most} are taken")
        if pattern is not None and key in self.values and re.fullmatch(pattern, value) is None:
            self.fail(key, f"{value!r} cannot be used; write letters, digits, '-', '_' and '.'")
        return value

    def choice(self, key: str, choices: Sequence[str], default: Any = REQUIRED) -> Any:
        listed = ", ".join(choices)
        value = self.take(key, default, f"one of {listed}")
        if key in self.values and value not in choices:
            self.fail(key, f"{value!r} is none of {listed}; choose one of them")
        return value

    def flag(self, key: str) -> bool:
        value = self.take(key, False, "true or false")
        if not isinstance(value, bool):
            self.fail(key, "is neither true nor false; write one of them, without quotes")
        return value

    def integer(self, key: str, low: int, high: int, default: Any = REQUIRED) -> int:
        value = self.take(key, default, f"a whole number from {low} to {high}")
        if key not in self.values:
            return default  # type: ignore[no-any-return]
        return whole(value, low, high, self.path(key))

    def number(
        self,
        key: str,
        default: Any = REQUIRED,
        *,
        low: float = -1e9,
        above: float | None = None,
        high: float = 1e9,
        what: str = "a number",
        requirement: str | None = None,
    ) -> float:
        value = self.take(key, default, what, requirement)
        if key not in self.values:
            return default  # type: ignore[no-any-return]
        return real(value, self.path(key), low, above, high)

    def rows(self, key: str, low: int, high: int) -> list[Any]:
        """A list of tables or values."""
        value = self.take(key, REQUIRED if low else [], "at least one")
        if not isinstance(value, list):
            self.fail(key, f"is not a list; write it as [[{key}]], or between brackets")
        if not low <= len(value) <= high:
            wanted = f"at least {low}" if len(value) < low else f"at most {high}"
            self.fail(key, f"has {len(value)} entries; there must be {wanted}")
        return value

    def tables(self, key: str, low: int, high: int) -> list[Table]:
        return [
            Table(row, f"{self.path(key)}[{n}]") for n, row in enumerate(self.rows(key, low, high))
        ]

    def names(self, key: str, most: int) -> tuple[str, ...]:
        values = self.rows(key, 1, most)
        for n, value in enumerate(values):
            if not isinstance(value, str):
                self.fail(f"{key}[{n}]", "is not a text; write the name of an actuator")
        return tuple(values)


def whole(value: Any, low: int, high: int, at: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise ProfileError(at, f"is not a whole number; write one from {low} to {high}")
    if not low <= value <= high:
        raise ProfileError(at, f"{shown(value)} is out of range; write {low} to {high}")
    return value


def real(value: Any, at: str, low: float, above: float | None, high: float) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ProfileError(at, "is not a number; write one, without quotes")
    if isinstance(value, float) and not isfinite(value):
        raise ProfileError(at, f"{value} is not a finite number")
    if above is not None and value <= above:
        raise ProfileError(at, f"{shown(value)} is too small; write a number above {above:g}")
    if not low <= value <= high:
        raise ProfileError(
            at, f"{shown(value)} is out of range; write a number from {low:g} to {high:g}"
        )
    return float(value)


def shown(value: float) -> str:
    """Python refuses to print integers of many digits."""
    return f"{value}" if abs(value) < 10**20 else "the number"
