"""docs/dependencies.md says what each dependency of pyproject.toml is for."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable

from spec import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PAGE = (ROOT / "docs" / "dependencies.md").read_text("utf-8")
REQUIRED, EXTRAS, DEVELOPMENT = PAGE.split("\n## ")[1:]


def packages(requirements: Iterable[str]) -> set[str]:
    """Names without versions. Extras of hapfmt itself have rows of their own."""
    found = (re.match(r"[\w-]+", text) for text in requirements)
    return {name[0] for name in found if name} - {"hapfmt"}


def rows(section: str) -> set[tuple[str, str]]:
    """(extra, package) of a table; an empty first cell repeats the one above it."""
    extra, found = "", []
    for first, package, use in re.findall(
        r"^\|(?: `([\w-]+)`)? \| `([\w-]+)` \| (.+) \|$", section, re.M
    ):
        extra = first or extra
        assert use.endswith(".")
        found.append((extra, package))
    assert len(found) == len(set(found))
    return set(found)


def test_required() -> None:
    found = re.findall(r"^\| `([\w-]+)` \| .+\. \|$", REQUIRED, re.M)
    assert sorted(found) == sorted(packages(PROJECT["dependencies"]))


def test_extras() -> None:
    extras = {name: packages(each) for name, each in PROJECT["optional-dependencies"].items()}
    shown = rows(EXTRAS) | rows(DEVELOPMENT)
    users = {package for _, package in rows(EXTRAS)}
    wanted = {(extra, package) for extra, each in extras.items() for package in each}
    assert shown - wanted == set()
    # Tests use the packages of the other extras too.
    left = {(extra, name) for extra, name in wanted - shown if extra in ("test", "deep")}
    assert wanted - shown == left
    assert {name for _, name in left} <= users
