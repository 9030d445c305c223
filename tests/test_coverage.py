"""conformance/COVERAGE.md: current, and no requirement without something that speaks of it."""

from __future__ import annotations

import coverage_table as coverage
from spec import REQUIREMENTS


def test_current():
    assert coverage.TARGET.read_text(encoding="utf-8") == coverage.text()


def test_no_requirement_without():
    assert {what: ids for what, ids in coverage.without().items() if ids} == {}


def test_reasons_are_of_requirements():
    assert coverage.REASONS.keys() | coverage.EVERY_CASE.keys() <= REQUIREMENTS.keys()


def test_every_requirement_has_a_row():
    rows = [line.split(" | ")[0] for line in coverage.text().splitlines() if line.startswith("| ")]
    assert [row[2:] for row in rows if row[2:] in REQUIREMENTS][: len(REQUIREMENTS)] == list(
        REQUIREMENTS
    )
