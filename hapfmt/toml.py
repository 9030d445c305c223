"""Descriptions in TOML: those that come with the package, and those in files."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from .errors import ParameterError
from .names import similar

MOST_BYTES = 1 << 20
MOST_PARTS = 16
"""Names joined by dots in one key. The time that tomllib takes grows with their square."""
MOST_WORDS = 1 << 16
"""Names and values in all."""
MOST_NESTED = 32
"""Brackets and braces within one another."""
MOST_DIGITS = 1000
"""Characters of a number."""

TOKEN = re.compile(
    r"""
    (?P<string> \"{3} (?: [^"\\] | \\[\s\S] | "{1,2}(?!") )* "{3,5}
              | '{3} (?: [^'] | '{1,2}(?!') )* '{3,5}
              | " (?: [^"\\\n] | \\. )* "
              | ' [^'\n]* ' )
  | (?P<word> [A-Za-z0-9_+-]+ )
  | (?P<comment> \#[^\n]* )
  | (?P<other> [^\ \t] )
    """,
    re.VERBOSE,
)


def parse_toml(text: str) -> dict[str, Any]:
    """Raise ParameterError where the text is no TOML, or more than a description needs."""
    check_size(text)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ParameterError(f"Invalid TOML: {str(error) or 'nested too deeply'}") from None


def check_size(text: str) -> None:
    """Refuse text that would take much more time or memory than its length; one pass."""
    if len(text) > MOST_BYTES:
        raise ParameterError(f"Invalid TOML: more than {MOST_BYTES} characters")
    words = parts = nested = 0
    joined = False
    for token in TOKEN.finditer(text):
        kind, found = token.lastgroup, token[0]
        if kind in ("string", "word"):
            words += 1
            parts = parts + 1 if joined else 1
            joined = False
            if parts > MOST_PARTS:
                raise too_much(text, token, f"a key of more than {MOST_PARTS} parts")
            if words > MOST_WORDS:
                raise too_much(text, token, f"more than {MOST_WORDS} names and values")
            if len(found) > MOST_DIGITS and found[0] in "0123456789+-":
                raise too_much(text, token, f"a number of more than {MOST_DIGITS} digits")
        elif found == ".":
            joined = True
        else:
            joined, parts = False, 0
            nested += (found in "[{") - (found in "]}")
            if nested > MOST_NESTED:
                raise too_much(text, token, f"nested more than {MOST_NESTED} deep")
            if found in "\"'":
                # The string does not end: tomllib stops here too.
                return


def too_much(text: str, token: re.Match[str], what: str) -> ParameterError:
    line = text.count("\n", 0, token.start()) + 1
    column = token.start() - text.rfind("\n", 0, token.start())
    return ParameterError(f"Invalid TOML: {what} (at line {line}, column {column})")


@dataclass(frozen=True)
class Library:
    """The folder "builtin" of ``package``; ``kind``: what a file of it is called."""

    package: str
    kind: str

    @property
    def folder(self) -> Traversable:
        return resources.files(self.package) / "builtin"

    def names(self) -> tuple[str, ...]:
        """What comes with the package, sorted."""
        names = (entry.name for entry in self.folder.iterdir())
        return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))

    def text(self, name_or_path: str) -> str:
        """The TOML of this name, or else of the file."""
        known = self.names()
        if name_or_path in known:
            return (self.folder / f"{name_or_path}.toml").read_text(encoding="utf-8")
        path = Path(name_or_path)
        if not path.is_file():
            meant = similar(name_or_path[:200], known)
            advice = f"did you mean {meant!r}?" if meant else f"there are: {', '.join(known)}"
            raise ParameterError(f"no file and no {self.kind} {name_or_path[:200]!r}; {advice}")
        with path.open("rb") as stream:
            data = stream.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise ParameterError(f"more than 1 MiB; a {self.kind} is shorter", path=name_or_path)
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError:
            raise ParameterError("not UTF-8, as TOML must be", path=name_or_path) from None
