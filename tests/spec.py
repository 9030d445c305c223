"""SPEC.md and docs/spec as {id: sentence}, and what the docstrings of tests quote of them."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "SPEC.md").read_text(encoding="utf-8")
EXAMPLES = (ROOT / "conformance" / "EXAMPLES.md").read_text(encoding="utf-8")
PARTS = [TEXT, *(path.read_text("utf-8") for path in sorted((ROOT / "docs/spec").glob("*.md")))]
ITEM = re.compile(r"^- \*\*(?P<id>[^*]+)\*\* (?P<sentence>.+?)(?=\n- |\n\n|\Z)", re.M | re.S)
QUOTE = re.compile(r"^\s*(?P<id>[A-Z]{3}-\d{3}): (?P<sentence>.+?)\s*$", re.M)


def items() -> list[tuple[str, str]]:
    """(id, sentence) in order of the pages; line breaks within a sentence become spaces."""
    found = [match for part in PARTS for match in ITEM.finditer(part)]
    return [(m["id"], " ".join(m["sentence"].split())) for m in found]


REQUIREMENTS = dict(items())


@cache
def quotes(path: Path) -> tuple[tuple[str, str, str], ...]:
    """(test, id, sentence) of each line of a test's docstring that quotes a requirement."""
    found = []
    text = path.read_text(encoding="utf-8")
    nodes = list(ast.parse(text).body) if re.search(r"[A-Z]{3}-\d{3}: ", text) else []
    for node in nodes:
        if not isinstance(node, ast.FunctionDef):
            nodes += getattr(node, "body", [])
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name.startswith(
            ("test_", "Test")
        ):
            told = ast.get_docstring(node, clean=False) or ""
            found += [(node.name, m["id"], m["sentence"]) for m in QUOTE.finditer(told)]
    return tuple(found)
