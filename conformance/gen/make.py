"""Makes conformance/vectors, conformance/expected and conformance/manifest.json.

python conformance/gen/make.py          compare with what is committed
python conformance/gen/make.py --write  write
python conformance/gen/make.py --limits FOLDER  write the files of the set limits, which are large

Imports nothing from hapfmt. Each module in sets/ has a function ``cases`` that yields its cases.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from case import SETS, Case  # noqa: E402

ROOM = HERE.parent
LARGEST = 64 << 10
WIDTH = 100


def all_cases() -> list[Case]:
    """In order of the sets, within a set in order of names."""
    found = []
    for path in sorted((HERE / "sets").glob("[a-z]*.py")):
        found += importlib.import_module(f"sets.{path.stem}").cases()
    found.sort(key=lambda case: (SETS.index(case.set), case.name))
    names = [(case.set, case.name) for case in found]
    twice = {name for name in names if names.count(name) > 1}
    assert not twice, f"names given twice: {sorted(twice)}"
    return found


def lines(value: object, depth: int = 0) -> str:
    """JSON with a line for each member, but for what fits on one."""
    short = json.dumps(value, ensure_ascii=False)
    flat = isinstance(value, list) and not any(isinstance(item, (list, dict)) for item in value)
    if len(short) + depth <= WIDTH or flat or not isinstance(value, (list, dict)) or not value:
        return short
    if isinstance(value, dict):
        rows = [f"{json.dumps(name)}: {lines(item, depth + 1)}" for name, item in value.items()]
        opening, closing = "{}"
    else:
        rows = [lines(item, depth + 1) for item in value]
        opening, closing = "[]"
    indent = "\n" + " " * (depth + 1)
    return f"{opening}{indent}{f',{indent}'.join(rows)}\n{' ' * depth}{closing}"


def dump(value: object) -> bytes:
    return (lines(value) + "\n").encode()


def described(data: bytes) -> dict[str, object]:
    assert len(data) <= LARGEST, len(data)
    return {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def files(cases: list[Case]) -> Iterator[tuple[str, bytes]]:
    """(path within conformance/, bytes) of everything that is committed."""
    entries = []
    for case in cases:
        entry: dict[str, object] = {
            "set": case.set, "name": case.name, "about": case.about,
            "requirements": list(case.requirements),
        }  # fmt: skip
        if case.fault:
            entry["fault"] = case.fault
        if callable(case.data):
            entry["made_on_demand"] = True
        elif isinstance(case.data, dict):
            entry["files"] = {name: described(data) for name, data in case.data.items()}
            for name, data in case.data.items():
                yield f"vectors/{case.set}/{case.name}/{name}", data
        else:
            entry |= described(case.data)
            yield f"vectors/{case.set}/{case.name}.hapf", case.data
        yield f"expected/{case.set}/{case.name}.json", dump(case.expect)
        entries.append(entry)
    yield "manifest.json", dump({"format": "1.0", "cases": entries})


def differences(wanted: dict[str, bytes]) -> list[str]:
    found = [
        path.relative_to(ROOM).as_posix()
        for room in ("vectors", "expected")
        for path in (ROOM / room).rglob("*")
        if path.is_file()
    ]
    out = [f"{name}: is no case" for name in found if name not in wanted]
    for name, data in wanted.items():
        path = ROOM / name
        if not path.exists():
            out.append(f"{name}: missing")
        elif path.read_bytes() != data:
            out.append(f"{name}: differs")
    return out


def write(wanted: dict[str, bytes]) -> None:
    for line in differences(wanted):
        name, what = line.split(": ")
        path = ROOM / name
        if what == "is no case":
            path.unlink()
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(wanted[name])
        print(line)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--limits", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    cases = all_cases()
    if given.limits:
        given.limits.mkdir(parents=True, exist_ok=True)
        for case in cases:
            if callable(case.data):
                (given.limits / f"{case.name}.hapf").write_bytes(case.data())
        return 0
    wanted = dict(files(cases))
    if given.write:
        write(wanted)
        return 0
    differing = differences(wanted)
    print("\n".join(differing) or f"{len(cases)} cases, as committed")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
