"""Docstrings of hapfmt as Markdown: lists of terms, and the roles of Sphinx."""

from __future__ import annotations

import re
from typing import Any

import griffe

ENTRY = re.compile(r"^(\S.*)\n((?:    .*\n?)+)", re.M)
"""A line before indented ones is a term, and they are its text."""
ROLE = re.compile(r":(?:meth|func|class|mod|attr):`([^`]+)`")


def markdown(text: str) -> str:
    return ROLE.sub(linked, ENTRY.sub(entry, text))


def entry(found: re.Match[str]) -> str:
    terms = re.sub(r"(\w+)", r"`\1`", found[1])
    words = " ".join(line.strip() for line in found[2].splitlines())
    return f"\n{terms}\n:   {words}\n"


def linked(role: re.Match[str]) -> str:
    name = role[1]
    return f"[`{name}`][{name}]" if name.startswith("hapfmt.") else f"`{name}`"


class Docstrings(griffe.Extension):
    def on_instance(self, *, obj: griffe.Object, **kwargs: Any) -> None:  # noqa: ARG002
        if obj.docstring:
            obj.docstring.value = markdown(obj.docstring.value)
