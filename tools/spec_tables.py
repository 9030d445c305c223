"""Print the layout tables of SPEC.md and docs/spec from hapfmt/format/layout.py.

python tools/spec_tables.py          print every table
python tools/spec_tables.py --write  put them into the pages, between their markers
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # the layouts of this clone, not of an installed copy

from hapfmt.format.layout import OVERVIEW_TABLES, TABLES  # noqa: E402

PAGES = (ROOT / "SPEC.md", ROOT / "docs/spec/overview.md")
LAYOUTS = {**TABLES, **OVERVIEW_TABLES}
MARKED = re.compile(r"<!-- table: (?P<name>[^>]+?) -->\n.*?<!-- end -->", re.S)


def table(name: str) -> str:
    """The Markdown table of one layout: offset, size, type, name, meaning."""
    rows = ["| offset | size | type | field | meaning |", "|---|---|---|---|---|"]
    layout = LAYOUTS[name]
    for field, offset in zip(layout.fields, layout.offsets.values(), strict=True):
        size, kind, meaning = field.size, field.type, field.meaning
        rows.append(f"| {offset} | {size} | {kind} | `{field.name}` | {meaning} |")
    rows.append(f"| {layout.size} | | | | end |")
    return "\n".join(rows)


def render(text: str) -> str:
    """The text with every marked table replaced by the one the declarations give."""
    return MARKED.sub(
        lambda match: f"<!-- table: {match['name']} -->\n{table(match['name'])}\n<!-- end -->",
        text,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--write", action="store_true", help="put the tables into SPEC.md")
    if parser.parse_args().write:
        for page in PAGES:
            page.write_text(render(page.read_text(encoding="utf-8")), encoding="utf-8")
        return
    for name in LAYOUTS:
        print(f"{name}\n\n{table(name)}\n")


if __name__ == "__main__":
    main()
