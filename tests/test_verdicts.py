"""One table of verdicts (SPEC clause 13): every verb, on every file of the conformance sets."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from depth import sample
from spec import ROOT
from terminal import called

import hapfmt
from hapfmt.errors import (
    ChecksumError,
    FormatError,
    HapfmtError,
    LimitError,
    UnsupportedError,
    verdict_of,
)
from hapfmt.format.wire import HEADER_SIZE
from hapfmt.limits import Limits
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify

BROKEN, UNKNOWN, LIMITED = FormatError("x"), UnsupportedError("x"), LimitError("x")
TABLE: list[tuple[set[str], HapfmtError | None, bool, bool, int]] = [
    ({"bad-payload"}, LIMITED, True, True, 4),
    ({"bad-payload"}, BROKEN, True, False, 3),
    ({"bad-payload"}, UNKNOWN, True, False, 3),
    ({"bad-payload", "not-closed"}, None, False, False, 3),
    (set(), None, True, True, 3),
    ({"not-closed"}, None, False, False, 3),
    ({"not-closed"}, None, True, False, 3),
    ({"not-closed"}, UNKNOWN, True, False, 3),
    ({"not-closed"}, BROKEN, True, False, 4),
    ({"not-closed"}, BROKEN, False, False, 2),
    (set(), BROKEN, True, False, 4),
    (set(), UNKNOWN, False, False, 4),
    (set(), None, True, False, 4),
    (set(), BROKEN, False, False, 2),
    (set(), None, False, False, 0),
]
"""Codes of findings, error, unknown parts, lost samples; the exit code."""


@pytest.mark.parametrize(("codes", "error", "unknown", "lost", "code"), TABLE)
def test_the_list(
    codes: set[str], error: HapfmtError | None, unknown: bool, lost: bool, code: int
) -> None:
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause.
    """
    assert verdict_of(codes, error=error, unknown=unknown, lost=lost) == code


SETS = ("valid", "uncommon", "invalid", "recoverable", "future")
LARGEST = 100_000
WHOLE = ("decode", "convert")
"""They read everything, but what only a verifier checks."""
WALKING = ("du", "dump")
"""They read every chunk and decode nothing, or report what does not decode as a part of the text."""
VERBS: dict[str, tuple[str, ...]] = {
    "info": ("info", "IN", "--json"),
    "du": ("du", "IN", "--json"),
    "dump": ("dump", "IN", "--counts"),
    "decode": ("decode", "IN", "OUT.npz"),
    "convert": ("convert", "IN", "OUT.npz"),
    "subset": ("subset", "IN", "OUT.hapf"),
    "concat": ("concat", "IN", "OUT.hapf"),
    "clocks": ("clocks", "IN", "--json"),
    "events": ("annotate", "IN", "--list", "--json"),
    "attachments": ("attach", "IN", "--list", "--json"),
    "metadata": ("meta", "IN", "--json"),
}
VERIFIERS_ONLY = ("IDX-", "FOT-", "TRK-010", "TRK-012", "EVT-003")


def vectors() -> list[Path]:
    found = [
        p for name in SETS for p in sorted((ROOT / "conformance/vectors" / name).glob("*.hapf"))
    ]
    return [path for path in found if path.stat().st_size <= LARGEST]


def allowed(verb: str, report: Any, data: bytes) -> set[int]:
    """By what ``verify`` says, and by what the verb reads."""
    told: set[int] = {report.exit_code}
    rule = (report.error.requirement or "") if report.error else ""
    open_ = any(finding["code"] == "not-closed" for finding in report.findings)
    digest_alone = {finding["code"] for finding in report.findings} == {"bad-digest"}
    if report.exit_code == 0:
        # Other formats do not hold everything.
        return {0, 1} if verb in WHOLE else {0}
    if verb in WHOLE:
        if rule.startswith(VERIFIERS_ONLY) or (report.exit_code == 2 and in_index(report, data)):
            told.add(3 if open_ else 0)
        if verify_unknown(data):
            told.add(4)
        return told
    if verb in WALKING:
        if report.exit_code == 2 or digest_alone:
            told.add(3 if open_ else 0)
        return told
    told |= {0} | ({3} if open_ else set()) | ({4} if verify_unknown(data) else set())
    return told


def in_index(report: Any, data: bytes) -> bool:
    """Whether the broken rule is one of the bytes of an index, such as CNV-002."""
    at = (report.error.offset if report.error else None) or 0
    try:
        with Reader(data, scan=True) as reader:
            return any(
                ref.type == "iNDX" and ref.offset < at <= ref.offset + HEADER_SIZE + (ref.size or 0)
                for ref in reader.catalogue.chunks
            )
    except HapfmtError:
        return False


def verify_unknown(data: bytes) -> bool:
    """Whether it has parts that are not known, so that a program may give nothing."""
    try:
        with Reader(data, scan=True) as reader:
            return reader.catalogue.not_understood
    except UnsupportedError:
        return True
    except HapfmtError:
        return False


@pytest.mark.parametrize(
    "path", sample(vectors(), 20), ids=lambda path: f"{path.parent.name}/{path.stem}"
)
def test_every_verb(path: Path, tmp_path: Path) -> None:
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause.
    """
    data = path.read_bytes()
    expected = json.loads(
        (ROOT / "conformance/expected" / path.parent.name / f"{path.stem}.json").read_bytes()
    )
    report = verify(data)
    assert called("verify", path, "--json").code == report.exit_code
    wanted = expected.get("exit", {}).get("verify", report.exit_code)
    assert report.exit_code in (wanted if isinstance(wanted, list) else [wanted])
    for verb, line in VERBS.items():
        words = [str(tmp_path / w.lower()) if w.startswith("OUT") else w for w in line]
        words = [str(path) if word == "IN" else word for word in words]
        said = called(*words)
        assert said.code in allowed(verb, report, data), (verb, said)
        clear(tmp_path.iterdir())


def clear(paths: Iterable[Path]) -> None:
    for path in paths:
        path.unlink()


DIGEST = (ROOT / "conformance/vectors/recoverable/digest-differs.hapf").read_bytes()


def test_a_reader_of_whole_tracks_compares_their_checksums() -> None:
    with Reader(DIGEST) as reader:
        recording = reader.read()
        assert [finding.code for finding in reader.findings] == ["bad-digest"]
        assert reader.exit_code == verify(DIGEST).exit_code == 3
        assert recording.sample_count
    with Reader(DIGEST) as reader:
        reader.read(start=0, stop=1)
        assert (reader.findings, reader.exit_code) == ([], 0)
    with pytest.raises(ChecksumError):
        hapfmt.read(DIGEST)


def test_limits_come_before_damage() -> None:
    """
    LIM-003: A reader MAY have lower limits of its own, and MUST then report *unsupported*, not damage.
    """
    data = (ROOT / "conformance/vectors/recoverable/digest-differs-and-damage.hapf").read_bytes()
    assert verify(data).exit_code == 3
    few = Limits(work_samples=4)
    assert verify(data, limits=few).exit_code == 4
    with Reader(data, limits=few) as reader, pytest.raises(LimitError):
        reader.read()


def test_a_damaged_file_says_what_to_do_next() -> None:
    with pytest.raises(
        ChecksumError, match=r"bad-digest: .* hapfmt.Reader .* hapfmt\.recover\(file, into\)"
    ):
        hapfmt.read(DIGEST)
