"""Tables that fit the terminal: the label comes first and stays whole, words stay whole, columns
that find no room are left out and named."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from .screen import JOINED, cells, printable, say, shortened, width_of, wrapped

GAP = "  "
NARROW = 12
"""Columns of text wrap down to this width before a column is left out."""


class Column(NamedTuple):
    header: str
    drop: int = 0
    """Of a narrow terminal: the largest goes first; 0 always stays."""


def table(
    headers: Sequence[str | Column],
    rows: Sequence[Sequence[str]],
    *,
    err: bool = False,
    elsewhere: str = "--json",
) -> None:
    """A table on standard output (``err``: error). The first column is the label and always stays;
    of plain headers the last goes first. ``elsewhere``: how else a person gets all columns."""
    columns = [
        each if isinstance(each, Column) else Column(each, place)
        for place, each in enumerate(headers)
    ]
    texts = [[printable(cell) for cell in row] for row in rows]
    lines, left_out, needed = laid_out(columns, texts, width_of(err=err))
    for line in lines:
        say(line, err=err)
    if left_out:
        names = ", ".join(column.header for column in left_out)
        also = f" or {elsewhere}" if elsewhere else ""
        say(f"(not shown: {names}; a terminal of {needed} columns{also} shows them)", err=err)


def laid_out(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], width: int | None
) -> tuple[list[str], list[Column], int]:
    """The lines, the columns left out, and the width that would show all of them."""
    numeric = [all(is_number(row[c]) for row in rows) and bool(rows) for c in range(len(columns))]
    shown = list(range(len(columns)))
    natural = [
        max([cells(column.header), *(cells(row[c]) for row in rows)])
        for c, column in enumerate(columns)
    ]
    least = [
        max(
            [longest_word(column.header)]
            + [cells(row[c]) if c == 0 or numeric[c] else longest_word(row[c]) for row in rows]
        )
        for c, column in enumerate(columns)
    ]
    least = [max(n, min(full, NARROW)) for n, full in zip(least, natural, strict=True)]
    for c, column in enumerate(columns):
        if numeric[c]:
            # Headers of numbers wrap: they are often wider than the numbers.
            least[c] = max([longest_word(column.header), *(cells(row[c]) for row in rows)])
    if width is not None:
        while needed(shown, least) > width:
            droppable = [c for c in shown if columns[c].drop and c]
            if not droppable:
                break
            shown.remove(max(droppable, key=lambda c: (columns[c].drop, c)))
        widths = shares(shown, natural, least, width)
    else:
        widths = natural
    header = [column.header for column in columns]
    lines = line_of(header, shown, widths, numeric)
    lines.append("─" * needed(shown, widths))
    for row in rows:
        lines += line_of(row, shown, widths, numeric)
    left_out = [column for c, column in enumerate(columns) if c not in shown]
    return lines, left_out, needed(range(len(columns)), least)


def needed(shown: Sequence[int], widths: Sequence[int]) -> int:
    return sum(widths[c] for c in shown) + len(GAP) * (len(shown) - 1)


def shares(
    shown: Sequence[int], natural: Sequence[int], least: Sequence[int], width: int
) -> list[int]:
    """Widths of the columns: what is left goes to those that miss least."""
    widths = list(least)
    spare = width - needed(shown, widths)
    for c in sorted(shown, key=lambda c: natural[c] - least[c]):
        more = max(0, min(natural[c] - widths[c], spare))
        widths[c] += more
        spare -= more
    while spare < 0:
        # Nothing is left to leave out: the widest texts lose their middle.
        widest = max(shown, key=lambda c: widths[c])
        if widths[widest] <= 1:
            break
        widths[widest] -= 1
        spare += 1
    return widths


def line_of(
    row: Sequence[str], shown: Sequence[int], widths: Sequence[int], numeric: Sequence[bool]
) -> list[str]:
    """One row, of as many lines as its highest cell."""
    parts = []
    for c in shown:
        words = " ".join(shortened(word, widths[c]) for word in row[c].split(" "))
        cell = shortened(row[c], widths[c]) if c == 0 and row[c] else words
        parts.append(wrapped(cell, widths[c], ""))
    lines = []
    for k in range(max(map(len, parts))):
        line = []
        for c, part in zip(shown, parts, strict=True):
            text = part[k] if k < len(part) else ""
            blank = " " * (widths[c] - cells(text))
            line.append(blank + text if numeric[c] else text + blank)
        lines.append(GAP.join(line).rstrip())
    return lines


def longest_word(text: str) -> int:
    return max((cells(word) for word in text.split(" ")), default=0)


def is_number(text: str) -> bool:
    """A number, a number with its unit, or a dash."""
    first, _, unit = text.replace(JOINED, " ").partition(" ")
    return first.strip("-+%x.0123456789eE") in ("", "inf", "nan") and " " not in unit
