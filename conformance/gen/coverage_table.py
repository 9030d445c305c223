"""Makes conformance/COVERAGE.md: what speaks of each MUST of SPEC.md and docs/spec.

python conformance/gen/coverage_table.py          compare with what is committed
python conformance/gen/coverage_table.py --write  write

Imports nothing from hapfmt: takes manifest.json, components/, and the requirements that the
docstrings of tests quote (tests/spec.py).
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOM, ROOT = HERE.parent, HERE.parent.parent
sys.path.insert(0, str(ROOT / "tests"))
import spec  # noqa: E402

TARGET = ROOM / "COVERAGE.md"
SHOWN = 3
"""Names in a cell of the table; of more only how many they are."""

NO_EDITOR = "an editor: the verbs of an adapter make no file of parts of others"
NO_APPEND = "a writer that appends: the verbs of an adapter append to no file"
NO_VIEWER = "a viewer: the verbs of an adapter neither write nor show an overview"
NO_PLAYER = "a player: shows on a device and in time; the verbs of an adapter play nothing"
REASONS = {
    "ATT-002": "a reader that stores attachments: the verbs of an adapter store none",
    "NOI-002": "a program for people: the verbs of an adapter print, convert and play nothing",
    "WRT-001": "review: shows only in what a kill leaves; run.py cuts what encoders wrote",
    "WRT-006": NO_APPEND,
    **{f"EDT-00{n}": NO_EDITOR for n in range(1, 7)},
    **{f"OVW-00{n}": NO_VIEWER for n in (1, 2, 3, 5, 7, 9)},
    **{f"PLY-{n:03}": NO_PLAYER for n in (*range(1, 6), *range(7, 10), *range(11, 14))},
}
"""Why no vector and no component can show it."""

EVERY_CASE = {"VRD-001": "every case: exit codes are compared"}

HEADER = """# Requirement coverage

For each MUST of SPEC.md and docs/spec the vectors, the component vectors, and the tests of the
reference implementation that speak of it. `python conformance/gen/coverage_table.py --write` makes
it. A test compares it with the manifest, the components and the tests, and finds each MUST in one.

"""


def by_id(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    out: dict[str, list[str]] = {}
    for id_, name in pairs:
        names = out.setdefault(id_, [])
        if name not in names:
            names.append(name)
    return out


def cases() -> list[dict]:
    return json.loads((ROOM / "manifest.json").read_text(encoding="utf-8"))["cases"]


def vectors() -> dict[str, list[str]]:
    found = by_id(
        (id_, f"{case['set']}/{case['name']}") for case in cases() for id_ in case["requirements"]
    )
    return {id_: in_turn(names) for id_, names in found.items()}


def in_turn(names: list[str]) -> list[str]:
    """First one of each set, then the second one of each, and so on."""
    before: Counter[str] = Counter()
    places = []
    for name in names:
        before[name.split("/")[0]] += 1
        places.append(before[name.split("/")[0]])
    return [name for _, name in sorted(zip(places, names, strict=True), key=lambda pair: pair[0])]


def components() -> dict[str, list[str]]:
    found = []
    for path in sorted((ROOM / "components").glob("*.json")):
        component = json.loads(path.read_text(encoding="utf-8"))
        found += [(id_, path.stem) for id_ in component["requirements"]]
    return by_id(found)


def tests() -> dict[str, list[str]]:
    return by_id(
        (id_, f"{path.stem}.{test}")
        for path in sorted((ROOT / "tests").glob("test_*.py"))
        for test, id_, _ in spec.quotes(path)
    )


def cell(names: list[str]) -> str:
    more = [f"{len(names) - SHOWN} more"] if len(names) > SHOWN else []
    return ", ".join([*(f"`{name}`" for name in names[:SHOWN]), *more])


def without() -> dict[str, list[str]]:
    """Requirements that nothing speaks of; those that no vector shows, without a reason; those that
    one shows, with a reason; ids that SPEC.md does not have."""
    by_vector, by_component = vectors().keys(), components().keys()
    shown = by_vector | by_component | EVERY_CASE.keys()
    spoken_of = shown | tests().keys()
    return {
        "anything": [id_ for id_ in spec.REQUIREMENTS if id_ not in spoken_of],
        "reason": [id_ for id_ in spec.REQUIREMENTS if id_ not in shown | REASONS.keys()],
        "need of the reason": [id_ for id_ in REASONS if id_ in shown],
        "meaning": sorted((by_vector | by_component) - spec.REQUIREMENTS.keys()),
    }


def text() -> str:
    by_vector, by_component, by_test = vectors(), components(), tests()
    sets = Counter(case["set"] for case in cases())
    lines = [
        f"{len(spec.REQUIREMENTS)} requirements; {sum(sets.values())} vectors ("
        + ", ".join(f"{name} {count}" for name, count in sets.items())
        + f"); {len(list((ROOM / 'components').glob('*.json')))} components.",
        "",
        "| requirement | vectors | components | tests |",
        "|---|---|---|---|",
    ]
    untold = []
    for id_ in spec.REQUIREMENTS:
        shown = EVERY_CASE.get(id_) or cell(by_vector.get(id_, []))
        cells = [id_, shown, cell(by_component.get(id_, [])), cell(by_test.get(id_, []))]
        lines.append(f"| {' | '.join(cells)} |")
        if not shown and id_ not in by_component:
            untold.append(id_)
    lines += ["", "## Without a vector", "", "| requirement | why |", "|---|---|"]
    lines += [f"| {id_} | {REASONS.get(id_, '**none yet**')} |" for id_ in untold]
    return HEADER + "\n".join(lines) + "\n"


def main() -> int:
    wanted = text()
    good = True
    for what, ids in without().items():
        if ids:
            good = False
            print(f"without {what}: {', '.join(ids)}")
    if sys.argv[1:] == ["--write"]:
        TARGET.write_text(wanted, encoding="utf-8")
    elif not TARGET.exists() or TARGET.read_text(encoding="utf-8") != wanted:
        good = False
        print("COVERAGE.md differs")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
