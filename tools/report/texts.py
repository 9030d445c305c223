"""The tables of the page in one Markdown file, each of them as CSV, and all of it as JSON."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from report.page import Part, shown
from report.section import Table

LONG_TABLE = 100
"""Rows beyond which a table is left to its CSV file."""


def slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:60]


def markdown_table(table: Table) -> str:
    """Pipes and line ends in a cell do not end it."""

    def line(cells: Sequence[str]) -> str:
        safe = [re.sub(r"\s*\n\s*", " ", cell).replace("|", "\\|") for cell in cells]
        return "| " + " | ".join(safe) + " |"

    words = [any(isinstance(row[i], str) for row in table.rows) for i in range(len(table.headers))]
    rule = "|" + "|".join("---" if word else "--:" for word in words) + "|"
    rows = [line([shown(cell) for cell in row]) for row in table.rows]
    return "\n".join([line(table.headers), rule, *rows])


def markdown_file(title: str, facts: Sequence[str], parts: Sequence[Part]) -> str:
    blocks = [f"# {title}", *facts]
    for part in parts:
        blocks.append(f"## {part.title}")
        if part.section is None:
            blocks.append(part.finding)
            continue
        blocks.append(part.section.text.strip())
        for table in part.section.tables:
            short = len(table.rows) <= LONG_TABLE
            file = f"{len(table.rows)} rows: {part.name}-{slug(table.title)}.csv"
            blocks += [f"### {table.title}", markdown_table(table) if short else file]
    return "\n\n".join(blocks) + "\n"


def plain(value: Any) -> Any:
    """As JSON has it: NumPy's numbers as numbers, what is not finite as null."""
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, list | tuple | set):
        return [plain(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def as_json(title: str, facts: Mapping[str, str], parts: Sequence[Part]) -> str:
    sections = {}
    for part in parts:
        known = part.section
        sections[part.name] = {
            "title": part.title,
            "finding": part.finding,
            "seconds": round(part.seconds, 3),
            "ran": known is not None,
            **(
                {
                    "text": known.text.strip(),
                    "tables": [table._asdict() for table in known.tables],
                    "figures": [
                        {"title": figure.title, "caption": figure.caption}
                        for figure in known.figures
                    ],
                    "data": known.data,
                }
                if known
                else {}
            ),
        }
    found = {"title": title, **facts, "sections": sections}
    return json.dumps(plain(found), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_tables(folder: Path, parts: Sequence[Part]) -> list[Path]:
    """Each table of each section, all digits."""
    written = []
    for part in parts:
        for table in part.section.tables if part.section else ():
            path = folder / f"{part.name}-{slug(table.title)}.csv"
            with path.open("w", newline="", encoding="utf-8") as stream:
                csv.writer(stream).writerows([table.headers, *table.rows])
            written.append(path)
    return written
