"""The page: one file of HTML that needs nothing else, readable light, dark, small and on paper."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from math import isnan
from typing import NamedTuple

from report.section import Cell, Figure, Section, Table

FOLDED_FROM = 24
"""Rows from which on a table is folded away behind its title; the finding is above it."""

CSS = """
:root { color-scheme: light dark; --ink: #1b1d20; --paper: #fff; --pale: #8a8f98; --line: #d9dce1;
  --soft: #f4f5f7; --quiet: #5c626b; --link: #0059a6; --bad: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8ea; --paper: #15171a; --pale: #8b9199;
  --line: #363b42; --soft: #1f2226; --quiet: #a3a9b1; --link: #7db8ee; --bad: #ff8a80; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 76rem; padding: 1rem clamp(.8rem, 3vw, 2.5rem) 4rem;
  background: var(--paper); color: var(--ink); font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.7rem; margin: .5rem 0 0; } h2 { margin: 3rem 0 .5rem; font-size: 1.35rem; }
h2 { border-top: 2px solid var(--line); padding-top: 1rem; } h3 { margin: 0; font-size: 1rem; }
a { color: var(--link); } p, ul { max-width: 46rem; } li { margin: .3rem 0; }
code { background: var(--soft); padding: 0 .25em; border-radius: 3px; font-size: .92em; }
.origin, figcaption, .note { color: var(--quiet); font-size: .88rem; }
.origin { overflow-wrap: anywhere; margin: .2rem 0; max-width: none; }
.finding { font-size: 1.1rem; border-left: 4px solid var(--link); padding-left: .8rem; }
.failed { border-left: 4px solid var(--bad); padding-left: .8rem; overflow-wrap: anywhere; }
nav ol { padding-left: 1.4rem; } nav li { max-width: 60rem; } nav span { display: block; }
.figures { display: grid; gap: 1.5rem 2rem; margin: 1rem 0;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 33rem), 1fr)); }
figure { margin: 0; min-width: 0; max-width: 44rem; } figure.wide { grid-column: 1 / -1;
  max-width: none; }
.picture { overflow-x: auto; } .picture svg, .picture img { width: 100%; height: auto;
  display: block; } .wide svg { min-width: 46rem; }
.picture svg * { stroke-linejoin: round; stroke-linecap: butt; }
.picture svg text { font-family: system-ui, sans-serif !important; }
.table { overflow-x: auto; margin: .5rem 0 1.5rem; max-height: 40rem; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .6rem; text-align: right; border-bottom: 1px solid var(--line); }
th { position: sticky; top: 0; background: var(--soft); vertical-align: bottom; cursor: pointer; }
th[aria-sort=ascending]::after { content: " \\2191"; }
th[aria-sort=descending]::after { content: " \\2193"; }
td.word, th.word { text-align: left; } td.word { min-width: 7rem; }
summary { cursor: pointer; font-weight: 600; } details { margin: .5rem 0; }
@media print { body { max-width: none; padding: 0; font-size: 9.5pt; }
  :root { --ink: #000; --paper: #fff; --pale: #555; --line: #bbb; --soft: #eee; --quiet: #444;
  --link: #000; }
  figure, tr { break-inside: avoid; } h2 { break-after: avoid; } .wide svg { min-width: 0; }
  .table { max-height: none; overflow: visible; } table { font-size: 7pt; }
  th { position: static; } th, td { padding: .1rem .25rem; } }
"""

SORT = """
document.addEventListener("click", event => {
  const head = event.target.closest("th");
  if (!head) return;
  const table = head.closest("table"), body = table.tBodies[0], at = head.cellIndex;
  const down = head.getAttribute("aria-sort") === "ascending";
  for (const other of table.querySelectorAll("th")) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const key = row => { const c = row.cells[at], v = c.dataset.v;
    return v === undefined ? c.textContent : v === "" ? Infinity : Number(v); };
  const order = (a, b) => typeof a === "number" && typeof b === "number" ? a - b
    : String(a).localeCompare(String(b));
  const rows = [...body.rows].sort((a, b) => order(key(a), key(b)) * (down ? -1 : 1));
  body.append(...rows);
});
"""


class Part(NamedTuple):
    """A section on the page. section: None if it could not run; why: the reason;
    seconds of wall time; failed: by an error, not for want of something."""

    name: str
    section: Section | None
    why: str = ""
    seconds: float = 0.0
    failed: bool = False

    @property
    def title(self) -> str:
        return self.section.title if self.section else self.name.capitalize()

    @property
    def finding(self) -> str:
        """Its first sentence, or why it is not here."""
        if self.section is None:
            return f"Not measured: {self.why}"
        return divided(self.section.text)[0]


def divided(text: str) -> tuple[str, str]:
    """The first sentence, and the rest."""
    first, _, rest = text.strip().partition("\n\n")
    flat = " ".join(first.split())
    end = re.search(r"[.!?](?:\*\*)?(?= [A-Z*`0-9])", flat)
    finding, more = (flat[: end.end()], flat[end.end() :]) if end else (flat, "")
    whole = re.fullmatch(r"\*\*([^*]+)\*\*", finding)
    return whole[1] if whole else finding, f"{more.strip()}\n\n{rest}".strip()


def page(title: str, facts: Sequence[str], parts: Sequence[Part]) -> str:
    """The whole document. facts: lines about machine, versions, date."""
    contents = "".join(
        f'<li><a href="#{part.name}">{escape(part.title)}</a>'
        f"<span>{inline_markdown(part.finding)}</span></li>"
        for part in parts
    )
    told = "".join(f'<p class="origin">{escape(fact)}</p>' for fact in facts)
    body = "".join(section_html(part) for part in parts)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{CSS}</style></head>\n<body>"
        f"<h1>{escape(title)}</h1>{told}<nav><ol>{contents}</ol></nav>\n{body}"
        f"<script>{SORT}</script></body></html>\n"
    )


def section_html(part: Part) -> str:
    head = f'<section id="{part.name}"><h2>{escape(part.title)}</h2>'
    if part.section is None:
        return f'{head}<p class="failed">{escape(part.finding)}</p></section>\n'
    finding, rest = divided(part.section.text)
    figures = "".join(
        figure_html(figure, f"{part.name}{place}-")
        for place, figure in enumerate(part.section.figures)
    )
    tables = "".join(table_html(table) for table in part.section.tables)
    return (
        f'{head}<p class="finding">{inline_markdown(finding)}</p>{markdown(rest)}'
        f'<div class="figures">{figures}</div>{tables}'
        f'<p class="note">Measured in {part.seconds:.0f} s.</p></section>\n'
    )


def figure_html(figure: Figure, prefix: str) -> str:
    """ids get a prefix, since all pictures share the page's."""
    svg = re.sub(r'\bid="', f'id="{prefix}', figure.svg)
    svg = re.sub(r'href="#', f'href="#{prefix}', svg).replace("url(#", f"url(#{prefix}")
    label = f'<svg role="img" aria-label="{escape(figure.title)}"'
    svg = svg.replace("<svg", label, 1)
    box = re.search(r'viewBox="[\d.]+ [\d.]+ ([\d.]+)', svg)
    width = float(box[1]) if box else 0
    wide = f' class="wide" style="max-width: {1.5 * width:.0f}px"' if width > 600 else ""
    return (
        f'<figure{wide}><h3>{escape(figure.title)}</h3><div class="picture">{svg}</div>'
        f"<figcaption>{inline_markdown(figure.caption)}</figcaption></figure>"
    )


def table_html(table: Table) -> str:
    """Numbers to the right, and sorted as numbers."""
    words = [any(isinstance(row[i], str) for row in table.rows) for i in range(len(table.headers))]
    head = "".join(
        f'<th class="{"word" if word else "number"}">{escape(header)}</th>'
        for header, word in zip(table.headers, words, strict=True)
    )
    body = "".join(
        f"<tr>{''.join(map(cell_html, row, words))}</tr>" for row in table.rows
    )  # fmt: skip
    whole = (
        f'<div class="table"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )
    if len(table.rows) < FOLDED_FROM:
        return f"<h3>{escape(table.title)}</h3>{whole}"
    return (
        f"<details><summary>{escape(table.title)} ({len(table.rows)} rows)</summary>"
        f"{whole}</details>"
    )


def cell_html(cell: Cell, word: bool) -> str:
    if word:
        return f'<td class="word">{escape(shown(cell))}</td>'
    key = "" if cell is None or isnan(cell) else repr(float(cell)).replace("inf", "Infinity")
    return f'<td data-v="{key}">{shown(cell)}</td>'


def shown(cell: Cell) -> str:
    """The text of a cell; a number has four digits."""
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int) or (abs(cell) >= 1000 and abs(cell) < 1e9):
        return f"{cell:,.0f}".replace(",", "\u202f")
    return f"{cell:.4g}"


def markdown(text: str) -> str:
    """Paragraphs and lists."""
    found = []
    for block in re.split(r"\n\s*\n", text.strip()):
        lines = block.strip().split("\n")
        if lines and re.match(r"[*-] ", lines[0]):
            items = re.split(r"(?:^|\n)[*-] ", block.strip())[1:]
            found.append(
                "<ul>" + "".join(f"<li>{inline_markdown(i)}</li>" for i in items) + "</ul>"
            )
        elif block.strip():
            found.append(f"<p>{inline_markdown(block.strip())}</p>")
    return "".join(found)


def inline_markdown(text: str) -> str:
    """**Bold**, `code` and [links](to); all else is text."""
    done = escape(text, quote=False)
    done = re.sub(r"`([^`]+)`", r"<code>\1</code>", done)
    done = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", done)
    return re.sub(r"\[([^\]]+)\]\(((?:https?:|#)[^)\s\"]*)\)", r'<a href="\2">\1</a>', done)
