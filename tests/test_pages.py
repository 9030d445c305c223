"""README.md and docs/*.md: every command and every line of Python runs, and links lead somewhere."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from depth import deep
from pages import (
    PAGES,
    README,
    Command,
    blocks,
    commands_of,
    run_in_terminal,
    run_piped,
    run_shown,
    walk,
)
from spec import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the pages are for a POSIX shell")
RUNNING = [page for page in PAGES if {b.kind for b in blocks(page)} & {"console", "python"}]
SHORT = 160


@pytest.mark.compiled
@pytest.mark.parametrize("page", RUNNING, ids=lambda page: page.name)
def test_page_runs(page: Path, tmp_path: Path) -> None:
    walk(page, tmp_path, run_shown)


@pytest.mark.parametrize("run", [run_in_terminal, *deep([run_piped])])
def test_readme_runs_anywhere(tmp_path: Path, run: Callable[[Command, Path], None]) -> None:
    walk(README, tmp_path, run, python=False)


def test_every_verb_is_shown() -> None:
    from hapfmt.cli import VERBS

    shown = [
        command.line
        for page in PAGES
        for block in blocks(page)
        if block.kind == "console"
        for command in commands_of(block)
    ]
    text = "\n".join(shown)
    assert [verb for verb in VERBS if f"hapfmt {verb}" not in text] == []


def anchors(page: Path) -> set[str]:
    """As GitHub makes them of headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.S | re.M)
    titles = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize(
    "page",
    [*PAGES, *(ROOT / name for name in ("SPEC.md", "CONTRIBUTING.md", "CHANGELOG.md"))],
    ids=lambda page: page.name,
)
def test_links_lead_somewhere(page: Path) -> None:
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text("utf-8")):
        if re.match(r"\w+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_index_lists_every_page() -> None:
    index = (ROOT / "docs" / "index.md").read_text("utf-8")
    docs = {page for page in PAGES if page.name not in {"README.md", "index.md"}}
    names = {page.relative_to(ROOT / "docs").as_posix() for page in docs}
    assert {name for name in names if f"({name}" not in index} == set()


def test_readme_is_short_and_shows_a_picture() -> None:
    text = README.read_text("utf-8")
    assert len(text.splitlines()) <= SHORT
    (picture,) = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert (ROOT / picture).is_file()
    assert len(re.findall(r"^python3 -m venv", text, re.M)) == 2
