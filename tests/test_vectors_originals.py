"""Vectors of promises: what verify says of a file beside its original."""

from __future__ import annotations

import json

import pytest
from hapfmt_adapter.verbs import run
from judge import rule
from sets import originals
from spec import ROOT

CASES = list(originals.cases())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_promises(case, tmp_path):
    """
    DBC-002: With flag *guaranteed*, every sample MUST keep the contract: for each component `|x - y| * kd <= max(kn * |x - zero|, floor * kd)`. The vector form is the same with Euclidean norms over the components, compared by their squares, and the floor of the first component. A verifier that is given x checks this with exact arithmetic. It reports the number of samples outside and the worst ratio of the left side to the right.
    DBC-004: A channel without a contract MUST be stored without loss: its full band equals the counts, the raw numbers, or with exact values (9.7) the numbers of the source.
    TLV-006: Every source value MUST be at most `largest` away from the physical value of its count. Without a deviation it is equal to it, or the track has exact values (9.7).
    """
    folder, report = ROOT / "conformance" / "vectors" / "encode" / case.name, tmp_path / "a.json"
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == case.data
    given = str(folder / "file.hapf"), str(report), "--original", str(folder / "job.json")
    assert run(["verify", *given]) == case.expect["exit"]["verify"]
    found = json.loads(report.read_text(encoding="utf-8"))
    assert found["verdict"] == case.expect["verdict"]
    for wanted, told in zip(
        case.expect.get("verify", {}).get("contracts", []), found["contracts"], strict=False
    ):
        assert {name: told[name] for name in wanted} == wanted


def test_each_file_alone_is_intact():
    assert {rule(case.data["file.hapf"]) for case in CASES} == {("intact", None)}


def test_promises_are_kept_and_broken():
    codes = [case.expect["exit"]["verify"] for case in CASES]
    assert min(codes.count(0), codes.count(3)) >= 12
