"""SPEC's requirements, the tests that quote them, and the ids that errors carry."""

from __future__ import annotations

import re
from pathlib import Path

from spec import ITEM, PARTS, REQUIREMENTS, ROOT, TEXT, items, quotes

PENDING: set[str] = set()
"""Requirements that no test checks yet."""

MEANING = (
    "The words MUST, MUST NOT, SHOULD and MAY in capitals are to be read as in BCP 14 "
    "(RFC 2119, RFC 8174). Every MUST has one id of three letters and a number."
)

TESTS = sorted(Path(__file__).parent.glob("test_*.py"))


def quoted() -> list[tuple[str, str, str, str]]:
    return [(path.name, *quote) for path in TESTS for quote in quotes(path)]


def test_ids_are_unique_and_well_formed():
    ids = [id_ for id_, _ in items()]
    assert len(ids) == len(set(ids)) > 100
    assert all(re.fullmatch(r"[A-Z]{3}-\d{3}", id_) for id_ in ids)


def test_every_requirement_says_must():
    assert [id_ for id_, text in REQUIREMENTS.items() if "MUST" not in text] == []


def test_every_must_has_an_id():
    """But those of the sentences of clause 2 that say what the word means."""
    rest = " ".join(ITEM.sub("", "\n\n".join(PARTS)).split())
    assert MEANING in rest
    assert re.findall(r"[^.]*\bMUST\b[^.]*", rest.replace(MEANING, "")) == []


def test_quotes_are_verbatim():
    wrong = [
        (file, test, id_) for file, test, id_, text in quoted() if REQUIREMENTS.get(id_) != text
    ]
    assert wrong == []


def test_every_requirement_is_quoted_by_a_test():
    covered = {id_ for _, _, id_, _ in quoted()}
    assert REQUIREMENTS.keys() - covered == PENDING


def test_errors_carry_ids_of_the_spec():
    wrong = []
    for path in sorted((ROOT / "hapfmt").rglob("*.py")):
        ids = re.findall(r"\"([A-Z]{3}-\d{3})\"", path.read_text(encoding="utf-8"))
        wrong += [f"{path.name}: {id_}" for id_ in ids if id_ not in REQUIREMENTS]
    assert wrong == []


def test_clause_16_says_who_keeps_and_checks_each_requirement_of_the_page():
    part = TEXT[TEXT.index("| kept by | checked by") : TEXT.index("A decoder is a reader that")]
    own = [match["id"] for match in ITEM.finditer(TEXT)]
    listed = []
    for cell in re.findall(r"\| ([^|]+) \|$", part, re.M)[1:]:
        for first, last in re.findall(r"([A-Z]{3}(?:-\d{3})?)(?: to ([A-Z]{3}-\d{3}))?", cell):
            if last:
                listed += [id_ for id_ in own if first <= id_ <= last]
            else:
                listed += [id_ for id_ in own if id_.startswith(first)]
    assert sorted(listed) == sorted(own)


def test_no_source_names_an_id_that_is_gone():
    prefixes = {id_[:3] for id_ in REQUIREMENTS}
    wrong = []
    for folder in ("hapfmt", "conformance", "docs", "tests", "tools"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".c", ".h", ".js", ".md", ".ksy"):
                found = set(re.findall(r"\b[A-Z]{3}-\d{3}\b", path.read_text(encoding="utf-8")))
                gone = {id_ for id_ in found - REQUIREMENTS.keys() if id_[:3] in prefixes}
                wrong += [f"{path.relative_to(ROOT)}: {id_}" for id_ in gone]
    assert wrong == []
