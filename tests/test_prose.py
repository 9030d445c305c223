"""Words of README.md, docs/*.md, help texts, messages, docstrings and comments."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from inspect import cleandoc
from pathlib import Path

import click
import pytest
from pages import PAGES
from spec import ROOT, TEXT

BANNED = [
    r"stands?\b(?! for)",
    r"stood",
    r"told",
    r"by little",
    r"so many",
    r"comes of",
    r"(?<!there )is no\b(?! longer)",
    r"what is (late|lost|in it|there|wanted|missing|added|felt)",
    r"what was",
    r"true doubles",
    r"lattices?",
    r"beside",
    r"anew",
    r"strangers?",
    r"(gone|goes|go) on with",
    r"nothing but",
    r"whatever is",
    r"such as it",
    r"as nearly as",
    r"thereof",
    r"unlike that of",
    r"deadband contract",
    r"felt how",
]
PATTERN = re.compile(rf"\b(?:{'|'.join(BANNED)})\b", re.I)
IN_CODE = [
    r"nobody",
    r"hardly",
    r"in vain",
    r"now and then",
    r"whatever happens",
    r"whoever",
    r"somebody|anybody",
    r"sp(eaks?|oke) of",
    r"for ever",
    r"so long at most",
    r"once more",
    r"makes? of (it|them)",
    r"(?-i:Of)(?! course)",
]
"""Also left out of docstrings and comments. A sentence does not begin with ``Of``."""
REMARK = re.compile(rf"\b(?:{'|'.join(BANNED + IN_CODE)})\b", re.I)
PYTHON = r'"""[\s\S]*?"""|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])*\'|#.*'
"""A string or a comment."""
CODED = [*sorted(ROOT.glob("hapfmt/**/*")), *sorted(ROOT.glob("tools/**/*"))]
CODED += sorted(ROOT.glob("conformance/adapters/**/*"))
LONGEST = 25  # words in a sentence


def sentences(text: str) -> Iterator[str]:
    """Of prose in Markdown: code is a word, a cell of a table and an item of a list end one."""
    text = re.sub(r"^ *```.*?^ *```$", "\n", text, flags=re.S | re.M)
    text = re.sub(r"<!--.*?-->|<http[^>]*>", "", text, flags=re.S)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`", "CODE", text)
    for part in re.split(r"\n\s*\n|^ *(?:[*-]|\d+\.|#+) |\||:\n", text, flags=re.M):
        for sentence in re.split(r"(?<=[.!?;:])\**\s+", part):
            yield " ".join(sentence.split())


def faults(text: str) -> list[str]:
    found = []
    for sentence in sentences(text):
        if match := PATTERN.search(sentence):
            found.append(f"{match[0]!r}: {sentence}")
        words = re.findall(r"[\w'’%-]*\w[\w'’%-]*", sentence)
        if len(words) > LONGEST:
            found.append(f"{len(words)} words: {sentence}")
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_page(page: Path) -> None:
    assert faults(page.read_text("utf-8")) == []


def test_spec() -> None:
    """Without the table of clause 16 and the references, which are lists."""
    text = re.sub(r"^\| files \| .*\n", "", TEXT[: TEXT.index("## 19 References")], flags=re.M)
    text += TEXT[TEXT.index("## Annex A") :]
    found = [fault for fault in faults(text) if "eadband contract'" not in fault]
    assert found == []


def prose_of(paragraph: str) -> str:
    """Of a help text: what follows \\b is printed line by line, examples and tables."""
    if not paragraph.startswith("\b"):
        return paragraph
    return re.sub(r"^ *hapfmt .*$|\n| {2,}", "\n\n", paragraph[1:], flags=re.M)


def helps(command: click.Command, name: str) -> Iterator[tuple[str, str]]:
    if command.help:
        yield name, "\n\n".join(prose_of(part) for part in cleandoc(command.help).split("\n\n"))
    for parameter in command.params:
        if isinstance(parameter, click.Option) and parameter.help:
            yield f"{name} {parameter.opts[0]}", parameter.help
    if isinstance(command, click.Group):
        context = click.Context(command)
        for each in command.list_commands(context):
            found = command.get_command(context, each)
            assert found is not None
            yield from helps(found, f"{name} {each}")


def test_help_texts() -> None:
    from hapfmt.cli import cli

    found = {name: faults(text) for name, text in helps(cli, "hapfmt")}
    assert {name: each for name, each in found.items() if each} == {}


@cache
def statements(path: Path) -> list[ast.Raise | ast.Expr]:
    """Those that have texts for people."""
    nodes = ast.walk(ast.parse(path.read_text("utf-8")))
    return [node for node in nodes if isinstance(node, (ast.Raise, ast.Expr))]


def messages(path: Path) -> Iterator[tuple[int, str]]:
    """The texts of ``raise XError(...)``: expressions within are {}."""
    for node in statements(path):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for argument in node.exc.args:
                yield from ((node.lineno, text) for text in texts(argument))


def texts(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.JoinedStr):
        yield "".join(
            str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values
        )
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, str) and " " in node.value:
            yield node.value
    else:
        for each in ast.iter_child_nodes(node):
            yield from texts(each)


def test_messages() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in sorted((ROOT / "hapfmt").rglob("*.py"))
        for line, text in messages(path)
        if PATTERN.search(text)
    ]
    assert found == []


def docstrings(path: Path) -> Iterator[tuple[int, str]]:
    """Also those below a constant or a field."""
    for node in statements(path):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            text = node.value.value
            if isinstance(text, str):
                yield node.lineno, text


def blocks(comments: Iterator[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Comments on successive lines are one text."""
    first, last, text = 0, 0, ""
    for line, comment in comments:
        if text and line == last + 1:
            last, text = line, f"{text}\n{comment}"
        else:
            if text:
                yield first, text
            first, last, text = line, line, comment
    if text:
        yield first, text


def comments_of(source: str) -> Iterator[tuple[int, str]]:
    """Strings are passed over: tokenize takes seconds for all files."""
    for found in re.finditer(PYTHON, source):
        if found[0].startswith("#"):
            yield source.count("\n", 0, found.start()) + 1, found[0].lstrip("#: ")


def c_comments(source: str) -> Iterator[tuple[int, str]]:
    for found in re.finditer(r"/\*[\s\S]*?\*/|//.*", source):
        line = source.count("\n", 0, found.start()) + 1
        yield line, re.sub(r"^ *(//+|/?\*+/?)|\*/", "", found[0], flags=re.M)


def remarks(path: Path) -> Iterator[tuple[int, str]]:
    source = path.read_text("utf-8")
    if path.suffix == ".py":
        yield from docstrings(path)
        yield from blocks(comments_of(source))
    else:
        yield from blocks(c_comments(source))


def test_docstrings_and_comments() -> None:
    found = []
    for path in CODED:
        if path.suffix in (".py", ".c", ".h", ".js"):
            for line, text in remarks(path):
                words = re.sub(r"`[^`]*`|\b\w+\.(py|c|h)\b", "CODE", " ".join(text.split()))
                if match := REMARK.search(words):
                    found.append(f"{path.relative_to(ROOT)}:{line}: {match[0]!r}: {words}")
    assert found == []
