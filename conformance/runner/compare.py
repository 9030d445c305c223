"""What is expected against what was found: exit codes, decode.json with its raw files, reports.

Nothing here runs a program: whoever has the answers of an implementation can compare them.
"""

from __future__ import annotations

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

Raw = Callable[[str], bytes]
"""The content of a raw file by its name; OSError or KeyError where there is none."""

VERDICTS: dict[int | None, str] = {0: "intact", 2: "nonconforming", 3: "damaged", 4: "unsupported"}
PARTS = {
    "tracks": "tracks", "channels": "channels", "lf": "bands", "hf": "bands", "layers": "layers",
    "clocks": "clocks", "maps": "maps", "metadata": "metadata", "attachments": "attachments",
    "unknown": "unknown",
}  # fmt: skip
"""The part that each member of decode.json belongs to; ``head`` is always compared."""
INNER_PARTS = {"exact": "exact", "physical": "physical"}
NAMES = ("track", "channel", "name", "label")
"""Members that say which entry of a list is meant."""
MISSING = object()


@dataclass(frozen=True)
class Difference:
    """``where``: a path within the JSON; what was wanted and what was found there."""

    where: str
    wanted: str
    found: str

    def __str__(self) -> str:
        return f"{self.where}: expected {self.wanted}, found {self.found}"


def exit_differences(wanted: int | Sequence[int], code: int | None) -> list[Difference]:
    allowed = [wanted] if isinstance(wanted, int) else list(wanted)
    if code in allowed:
        return []
    words = " or ".join(f"{c} ({VERDICTS.get(c, 'error')})" for c in allowed)
    found = f"{code} ({VERDICTS.get(code, 'error')})" if code is not None else "none"
    return [Difference("exit code", words, found)]


def decode_differences(
    wanted: dict[str, Any], found: dict[str, Any], raw: Raw, parts: Collection[str]
) -> list[Difference]:
    """Members that are named in ``wanted`` and belong to ``parts``, against a decode.json."""
    out: list[Difference] = []
    for name, value in wanted.items():
        if name in PARTS and PARTS[name] not in parts:
            continue
        trim = without_empty if PARTS.get(name) == "bands" else as_it_is
        out += compare(name, trim(value), trim(found.get(name, MISSING)), raw, parts)
    return out


def as_it_is(value: Any) -> Any:
    return value


def without_empty(band: Any) -> Any:
    """Channels of which nothing is delivered may be left out or not."""
    if not isinstance(band, list):
        return band
    return [one for one in band if not isinstance(one, dict) or one.get("spans") != []]


def compare(
    where: str, wanted: Any, found: Any, raw: Raw, parts: Collection[str]
) -> Iterator[Difference]:
    """Lists whole and in order, of objects the wanted members."""
    if found is MISSING:
        yield Difference(where, shown(wanted), "nothing")
    elif isinstance(wanted, dict):
        if not isinstance(found, dict):
            yield Difference(where, "an object", shown(found))
            return
        for name, value in wanted.items():
            inner = f"{where}.{name}"
            if INNER_PARTS.get(name, name) not in parts and name in INNER_PARTS:
                continue
            got = found.get(name, MISSING)
            if stands_for_numbers(value):
                yield from compare_numbers(inner, value, got, wanted | found, raw)
            else:
                yield from compare(inner, value, got, raw, parts)
    elif isinstance(wanted, list) and wanted and isinstance(wanted[0], dict):
        if not isinstance(found, list) or len(found) != len(wanted):
            yield Difference(where, f"{len(wanted)} entries", counted(found))
            return
        for place, (value, got) in enumerate(zip(wanted, found, strict=True)):
            yield from compare(f"{where}[{name_of(value, place)}]", value, got, raw, parts)
    elif not same(wanted, found):
        yield Difference(where, shown(wanted), shown(found))


def name_of(entry: dict[str, Any], place: int) -> str:
    for name in NAMES:
        if entry.get(name) is not None:
            return f"{name} {entry[name]}"
    return str(place)


def counted(found: Any) -> str:
    return f"{len(found)} entries" if isinstance(found, list) else shown(found)


def same(wanted: Any, found: Any) -> bool:
    """As JSON sees it: 1 is 1.0, but not true."""
    if isinstance(wanted, list):
        return (
            isinstance(found, list)
            and len(wanted) == len(found)
            and all(same(*pair) for pair in zip(wanted, found, strict=True))
        )
    if isinstance(wanted, dict):
        return (
            isinstance(found, dict)
            and wanted.keys() == found.keys()
            and all(same(wanted[name], found[name]) for name in wanted)
        )
    if isinstance(wanted, bool) or isinstance(found, bool):
        return wanted is found
    return bool(wanted == found)


def shown(value: Any, limit: int = 120) -> str:
    text = value if isinstance(value, str) and value.isprintable() else repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def stands_for_numbers(value: Any) -> bool:
    return isinstance(value, dict) and {"count", "sha256"} <= value.keys()


def compare_numbers(
    where: str, wanted: dict[str, Any], name: Any, owner: dict[str, Any], raw: Raw
) -> Iterator[Difference]:
    """A raw file against how many numbers there are, which, or their digest. ``owner``: the entry
    that they belong to, whose spans say the ticks."""
    if not isinstance(name, str):
        found = "nothing" if name is MISSING else shown(name)
        yield Difference(where, "the name of a raw file", found)
        return
    try:
        data = raw(name)
    except (OSError, KeyError, ValueError) as error:
        yield Difference(where, f"a raw file {shown(name)}", f"none ({type(error).__name__})")
        return
    count = wanted["count"]
    if len(data) != 8 * count:
        found = f"{len(data) // 8} numbers" if len(data) % 8 == 0 else f"{len(data)} bytes"
        yield Difference(where, f"{count} numbers of 8 bytes", found)
        return
    if hashlib.sha256(data).hexdigest() == wanted["sha256"]:
        return
    if "numbers" not in wanted:
        yield Difference(
            where, f"{count} numbers with SHA-256 {wanted['sha256'][:16]}...", "others"
        )
        return
    words = any(isinstance(number, str) for number in wanted["numbers"])
    right = [int(number) for number in wanted["numbers"]]
    found_numbers = struct.unpack(f"<{count}{'Q' if words else 'q'}", data)
    wrong = [i for i, pair in enumerate(zip(right, found_numbers, strict=True)) if len({*pair}) > 1]
    if not wrong:
        yield Difference(where, "numbers with their SHA-256", "an expectation that contradicts it")
        return
    first = wrong[0]
    form = (lambda n: f"0x{n:016x}") if words else str
    yield Difference(
        f"{where}, {place_of(first, owner)}",
        form(right[first]),
        f"{form(found_numbers[first])} ({len(wrong)} of {count} differ)",
    )


def place_of(number: int, owner: dict[str, Any]) -> str:
    """Tick, and component where there are several, of the number at this place."""
    width = owner.get("component_count", 1)
    left, component = divmod(number, width)
    for start, stop in owner.get("spans", []):
        if left < stop - start:
            tick = f"tick {start + left}"
            return f"{tick} component {component}" if width > 1 else tick
        left -= stop - start
    return f"number {number}"


def verify_differences(
    expect: dict[str, Any], report: dict[str, Any], parts: Collection[str]
) -> list[Difference]:
    """A report of ``verify`` against an expectation's members ``verdict`` and ``verify``."""
    wanted = expect.get("verify", {})
    out: list[Difference] = []
    if "verdict" in expect and report.get("verdict") != expect["verdict"]:
        out.append(Difference("verdict", expect["verdict"], shown(report.get("verdict"))))
    for name, value in wanted.items():
        if name == "damages":
            out += damage_differences(value, report.get("damages"))
        elif name == "lost":
            out += lost_differences(value, report)
        elif name == "requirement":
            if "findings" in parts:
                out += requirement_differences(value, report)
        else:
            out += compare(name, value, report.get(name, MISSING), no_raw, parts)
    return out


def no_raw(name: str) -> bytes:
    raise KeyError(name)


def damage_differences(wanted: Sequence[Sequence[Any]], damages: Any) -> Iterator[Difference]:
    """Code, offset and size of each, in any order."""
    if not isinstance(damages, list):
        yield Difference("damages", "a list", shown(damages))
        return
    left = Counter(tuple(row) for row in wanted)
    left.subtract((d.get("code"), d.get("offset"), d.get("size")) for d in damages)
    missing = [f"{c} at {o}, {s} bytes" for (c, o, s), n in left.items() for _ in range(n)]
    more = [f"{c} at {o}, {s} bytes" for (c, o, s), n in left.items() for _ in range(-n)]
    if missing or more:
        yield Difference("damages", "; ".join(missing) or "nothing else", "; ".join(more) or "not")


def lost_spans(report: dict[str, Any]) -> Iterator[tuple[int, int, int | None]]:
    """All of a report, whether a damage took them or not."""
    for damage in [report, *report.get("damages", [])]:
        for span in damage.get("lost", []):
            yield span["track"], span["start"], span["stop"]


def union(spans: Iterable[Sequence[Any]]) -> list[list[Any]]:
    """[track, start, stop] joined where they overlap or touch; stop None is never."""
    rows = sorted(
        (track, start, float("inf") if stop is None else stop) for track, start, stop in spans
    )
    out: list[list[Any]] = []
    for track, start, stop in rows:
        if out and out[-1][0] == track and start <= out[-1][2]:
            out[-1][2] = max(out[-1][2], stop)
        elif start < stop:
            out.append([track, start, stop])
    return [[track, a, None if b == float("inf") else b] for track, a, b in out]


def lost_differences(
    wanted: Sequence[Sequence[Any]], report: dict[str, Any]
) -> Iterator[Difference]:
    try:
        found = union(lost_spans(report))
    except (KeyError, TypeError, AttributeError) as error:
        yield Difference("lost", "spans", f"what has no {error}")
        return
    right = union(wanted)
    if right != found:
        yield Difference("lost [track, start, stop]", shown(right), shown(found))


def requirement_differences(
    wanted: str | Sequence[str], report: dict[str, Any]
) -> Iterator[Difference]:
    """The rule that is broken is among those that the report names; of several, one."""
    right = [wanted] if isinstance(wanted, str) else list(wanted)
    rows = [*report.get("findings", []), *report.get("damages", [])]
    named = [row.get("requirement") for row in rows if isinstance(row, dict)]
    if not set(right) & set(named):
        found = ", ".join(str(name) for name in named)
        yield Difference("requirement of a finding", " or ".join(right), found or "none")


def spans_are_canonical(spans: Any) -> bool:
    """Ordered, maximal, none empty."""
    try:
        return all(a < b for a, b in spans) and all(b < c for (_, b), (c, _) in pairwise(spans))
    except (TypeError, ValueError):
        return False
