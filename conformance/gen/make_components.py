"""Makes conformance/components, vectors of the format's parts.

python conformance/gen/make_components.py          compare with what is committed
python conformance/gen/make_components.py --write  write

Imports nothing from hapfmt: what comes out follows from the page (page*.py) and from facts.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from components.component import Component, text  # noqa: E402

ROOM = HERE.parent / "components"
TOOLS = {"__init__", "component"}


def all_components() -> list[Component]:
    found: list[Component] = []
    for path in sorted((HERE / "components").glob("*.py")):
        if path.stem not in TOOLS:
            found += getattr(
                importlib.import_module(f"components.{path.stem}"), "components", list
            )()
    names = [component.name for component in found]
    assert len(names) == len({*names}), "a component twice"
    return found


def files() -> dict[str, bytes]:
    return {f"{component.name}.json": text(component) for component in all_components()}


def differences(wanted: dict[str, bytes]) -> list[str]:
    there = {path.name: path.read_bytes() for path in ROOM.glob("*.json")}
    out = [f"{name}: is no component" for name in sorted(there.keys() - wanted.keys())]
    for name, data in sorted(wanted.items()):
        if there.get(name) != data:
            out.append(f"{name}: {'differs' if name in there else 'missing'}")
    return out


def main() -> int:
    wanted = files()
    found = differences(wanted)
    print("\n".join(found) or f"{len(wanted)} components as committed")
    if sys.argv[1:] != ["--write"]:
        return 1 if found else 0
    for line in found:
        name = line.split(": ")[0]
        if name in wanted:
            (ROOM / name).write_bytes(wanted[name])
        else:
            (ROOM / name).unlink()
    return 0


if __name__ == "__main__":
    sys.exit(main())
