"""Vectors of the sets invalid, future and limits: what verify, Reader and recover make of them."""

from __future__ import annotations

import hashlib
import io
import json
import re
from functools import cache
from typing import Any

import broken
import forge as f
import page
import pytest
from case import FAULTS, INTACT, NONCONFORMING, Case
from depth import deep, sample
from judge import rule
from sets import invalid_clusters, invalid_tracks, limits
from spec import ROOT

import hapfmt
from hapfmt.errors import HapfmtError
from hapfmt.reading.verifier import verify

CONFORMANCE = ROOT / "conformance"
MANIFEST = json.loads((CONFORMANCE / "manifest.json").read_text(encoding="utf-8"))["cases"]
SETS = ("invalid", "future", "limits")
COMMITTED = [
    pytest.param(case, id=f"{case['set']}-{case['name']}")
    for case in MANIFEST
    if case["set"] in SETS and "made_on_demand" not in case
]
MADE = ("events-above-2-to-16", "chunks-of-no-bytes", "inflates-to-16-mib", "packets-above-level-1")
"""Of those that are made on demand, a few that are quick."""


@cache
def demanded() -> dict[str, Case]:
    return {case.name: case for case in limits.cases() if callable(case.data)}


def codes(wanted: int | list[int]) -> list[int]:
    return wanted if isinstance(wanted, list) else [wanted]


def judge(data: bytes, expect: dict[str, Any]) -> None:
    exits, report = expect["exit"], verify(data)
    assert report.exit_code in codes(exits["verify"]), report.error or report.findings
    if "verdict" in expect:
        assert report.verdict == expect["verdict"]
    wanted = expect.get("verify", {}).get("requirement", [])
    said = {finding["requirement"] for finding in report.findings}
    said |= {report.error.requirement} if report.error else set()
    assert not wanted or said & set([wanted] if isinstance(wanted, str) else wanted), said
    if "decode" in exits:
        code, tracks = decoded(data)
        assert code in codes(exits["decode"])
        if code == INTACT and "tracks" in expect.get("decode", {}):
            assert tracks == [told(track) for track in expect["decode"]["tracks"]]
    if "recover" in exits:
        code, verdict = recovered(data)
        assert code in codes(exits["recover"])
        if code != NONCONFORMING and expect["verdict"] != "unsupported":
            assert verdict == expect["recover"]["verdict"]


def told(track: dict[str, Any]) -> tuple[int, Any, str]:
    return track["track"], track["spans"], track["numbers"]["sha256"]


def decoded(data: bytes) -> tuple[int, list[tuple[int, Any, str]]]:
    """The exit code, and of each track its id, spans and the SHA-256 of its counts as i64."""
    found: dict[int, Any] = {}
    try:
        with hapfmt.Reader(data) as reader:
            tracks = list(reader.catalogue.tracks.values())
            for track in tracks:
                if track.kind != "events":
                    found[track.id] = [], hashlib.sha256()
            for piece in reader.pieces(tracks, exact=True):
                if piece.track.id in found:
                    spans, digest = found[piece.track.id]
                    start, stop = piece.start, piece.start + len(piece.numbers)
                    if spans and spans[-1][1] == start:
                        spans[-1][1] = stop
                    else:
                        spans.append([start, stop])
                    digest.update(piece.numbers.astype("<i8").tobytes())
            _ = reader.events(), reader.catalogue.clocks
    except HapfmtError as error:
        return error.exit_code, []
    return INTACT, [(id_, spans, found[id_][1].hexdigest()) for id_, (spans, _) in found.items()]


def recovered(data: bytes) -> tuple[int, str]:
    """The exit code, and the verdict on the new file."""
    out = io.BytesIO()
    try:
        done = hapfmt.recover(data, out, canonical=9)
    except HapfmtError as error:
        return error.exit_code, ""
    return done.exit_code, verify(out.getvalue()).verdict


@pytest.mark.parametrize("case", sample(COMMITTED))
def test_committed(case):
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause.
    LIM-001: A file MUST keep the limits of its level, unknown chunks too.
    """
    place = f"{case['set']}/{case['name']}"
    data = (CONFORMANCE / "vectors" / f"{place}.hapf").read_bytes()
    judge(data, json.loads((CONFORMANCE / "expected" / f"{place}.json").read_text("utf-8")))


@pytest.mark.parametrize("name", [*MADE[1:], *deep(MADE[:1])])
def test_made_on_demand(name):
    """
    LIM-002: A reader MUST check every limit before it takes memory for what the number promises.
    """
    case = demanded()[name]
    judge(case.data(), case.expect)


def test_there_are_some():
    count = {name: sum(case["set"] == name for case in MANIFEST) for name in SETS}
    assert count["invalid"] > 400 and count["future"] > 40 and count["limits"] > 60


WHOLE = {
    "minimal": f.minimal(),
    "described": broken.described(),
    "described with a span": broken.described(span=9, start=3, rate_num=7),
    "an index": invalid_clusters.listing(*invalid_clusters.RIGHT),
    "two clusters": invalid_clusters.clusters(
        invalid_clusters.held((0, 0, 4)), invalid_clusters.held((0, 4, 4)), span=8
    ),
    "two indexes": invalid_clusters.second_index(("iNDX", broken.END, 0, 0)),
    "a footer": invalid_clusters.footer(invalid_clusters.FOOT),
    "a contract": invalid_clusters.contract(),
    "a calibration": invalid_clusters.calibrated(3, 4, 5),
    "an HF track": invalid_tracks.with_hf(),
    "words": invalid_tracks.words(),
    "a track that continues": invalid_tracks.continuing(),
    "continued": invalid_tracks.split(
        invalid_tracks.at((0, 0, 4)), invalid_tracks.at((1, 4, 4))
    ),
    "continued bands": invalid_tracks.split(
        invalid_tracks.at((0, 0, 4), (1, 0, 4)),
        invalid_tracks.at((2, 4, 4), (3, 4, 4)),
        more=tuple(invalid_tracks.bands()),
    ),
    "LPCR": broken.packed(b"LPCR", f.lpcr_parameters(), page.encode([1, 2, 3, 4])),
}  # fmt: skip


@pytest.mark.parametrize("name", WHOLE)
def test_what_they_are_made_of_is_whole(name):
    """So that what is broken is the one fact that a vector tells."""
    assert rule(WHOLE[name]) == ("intact", None)


def test_faults_are_explained():
    """In FAULTS.md a second word stands in the table of its first word."""
    text = (CONFORMANCE / "FAULTS.md").read_text(encoding="utf-8")
    known = set()
    for part in text.split("\n## ")[1:]:
        first = part.split(":")[0]
        for row in re.findall(r"^\| ([a-z, -]+) \|", part, re.M):
            known |= {f"{first}/{word}" for word in row.split(", ")}
    used = {case["fault"] for case in MANIFEST if "fault" in case}
    assert used <= known
    assert {word.split("/")[0] for word in known} == set(FAULTS)


def test_what_is_unknown_comes_before_a_broken_rule():
    """Clause 13; and damage before both."""
    stranger = ("TRAK", f.trak(codec=b"NEWC", first_channel=1, first=1))
    data = f.minimal(stranger, ("mETa", b"{"))
    assert rule(data) == ("unsupported", "TRK-011")
    assert rule(data + b"\0")[0] == "damaged"


@pytest.mark.parametrize(
    "chunk",
    [
        ("aTTc", b"\0\0abc"),
        ("cLOk", f.clock([], track=0)),
        ("cMAp", f.clock_map([(0, 0), (1, 1)], track=1)),
        ("dGST", f.digests(bytes(31))),
    ],
    ids=lambda chunk: chunk[0],
)
def test_what_recover_leaves_out_is_reported(chunk):
    """
    REC-011: A recoverer MUST report all losses, and mention them in the member `notes` of the metadata.
    """
    layer = ("TRAK", f.layer(first=1))
    out = io.BytesIO()
    done = hapfmt.recover(f.minimal(layer, chunk), out, canonical=9)
    assert done.exit_code == 3
    assert [found.code for found in done.findings] == ["bad-chunk"]
    assert rule(out.getvalue()) == ("intact", None)
    assert chunk[0].encode() not in out.getvalue()
    assert len(hapfmt.read(out.getvalue()).metadata["notes"]) == 1
