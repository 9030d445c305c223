"""Print SPEC.md's layout tables from hapfmt/container/layout.py.

python tools/spec_tables.py          print every table
python tools/spec_tables.py --write  put them into SPEC.md, between their markers
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))  # the layouts of this clone, whatever is installed

from hapfmt.container.layout import TABLES  # noqa: E402

SPEC = ROOT / "SPEC.md"
MARKED = re.compile(r"<!-- table: (?P<name>[^>]+?) -->\n.*?<!-- end -->", re.S)


def type_name(field: object) -> str:
    """SPEC's word for a field's type; fields are FormatField or Bytes under Renamed."""
    inner = getattr(field, "subcon", field)
    code = getattr(inner, "fmtstr", None)
    if code is None:
        return f"byte[{inner.sizeof()}]"
    return {
        "<B": "u8", "<H": "u16", "<L": "u32", "<Q": "u64", "<l": "i32", "<q": "i64", "<f": "f32",
    }[code]  # fmt: skip


def table(name: str) -> str:
    """The Markdown table of one layout: offset, size, type, name, meaning."""
    rows = ["| offset | size | type | field | meaning |", "|---|---|---|---|---|"]
    offset = 0
    for field in TABLES[name].subcons:
        size = field.sizeof()
        rows.append(f"| {offset} | {size} | {type_name(field)} | `{field.name}` | {field.docs} |")
        offset += size
    rows.append(f"| {offset} | | | | end |")
    return "\n".join(rows)


def render(text: str) -> str:
    """The text with every marked table replaced by the one the declarations give."""
    return MARKED.sub(
        lambda match: f"<!-- table: {match['name']} -->\n{table(match['name'])}\n<!-- end -->",
        text,
    )


def main() -> None:
    if sys.argv[1:] == ["--write"]:
        SPEC.write_text(render(SPEC.read_text(encoding="utf-8")), encoding="utf-8")
        return
    for name in TABLES:
        print(f"{name}\n\n{table(name)}\n")


if __name__ == "__main__":
    main()
