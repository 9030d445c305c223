"""Vectors of damaged files: what hapfmt makes of each, in one process (all verbs: conformance/)."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOM = Path(__file__).resolve().parent.parent / "conformance"
sys.path.insert(0, str(ROOM))

import wreck as w  # noqa: E402
from depth import either, sample  # noqa: E402
from hapfmt_adapter import verbs  # noqa: E402
from runner.manifest import load  # noqa: E402
from runner.process import Outcome  # noqa: E402
from runner.running import run_case  # noqa: E402

import hapfmt  # noqa: E402
from hapfmt.reading.verifier import verify  # noqa: E402

TICKS = {(track, tick) for track in range(3) for tick in range(12)}


class Here:
    """What run.py takes for an implementation, without a process."""

    name, capabilities, command = "hapfmt", verbs.CAPABILITIES, ("hapfmt",)

    def has(self, verb: str) -> bool:
        return verb in verbs.CAPABILITIES["verbs"]

    def call(self, *arguments: str | Path) -> Outcome:
        return Outcome(verbs.run([str(argument) for argument in arguments]), 0.0)


CASES = [case for case in load() if case.set in ("recoverable", "render")]


@pytest.mark.parametrize("case", sample(CASES, 6), ids=lambda case: case.name)
def test_case(case):
    """
    REC-012: A damage report MUST name every missing sample, by a span of its track or of one that its channel needs.
    """
    here = Here()
    result = run_case(case, here, [here])
    assert [str(d) for step in result.steps for d in step.differences] == []
    assert result.status == "passed"


def named(data: bytes) -> set[tuple[int, int]]:
    """Ticks that are delivered as they were, or named as lost."""
    report = verify(data)
    assert report.damage is not None
    lost = [span for part in [report.damage, *report.damage["damages"]] for span in part["lost"]]
    found = {
        (span["track"], tick)
        for span in lost
        for tick in range(span["start"], 12 if span["stop"] is None else min(span["stop"], 12))
    }
    with hapfmt.Reader(data, scan=True) as reader:
        for piece in reader.pieces(list(reader.catalogue.tracks.values())):
            for i, row in enumerate(piece.numbers.tolist()):
                assert row == [w.value(piece.track.id, piece.start + i)]
                found.add((piece.track.id, piece.start + i))
    return found


PLACES = [place for place in w.STEADY.places if place.type == "DATA"]


@pytest.mark.parametrize("laid", [w.STEADY, w.OPEN], ids=["closed", "open"])
@either("every", 13, deep=3)
def test_bytes_of_two_clusters(laid, every):
    """
    REC-012: A damage report MUST name every missing sample, by a span of its track or of one that its channel needs.
    """
    second, third = PLACES[1:]
    for start in range(second.payload, second.stop, every):
        for stop in range(third.payload, third.stop, every + 2):
            assert named(w.without(laid.data, start, stop)) >= TICKS


@pytest.mark.parametrize("source", [0, 2])
@either("every", 7, deep=2)
def test_bytes_of_another_cluster(source, every):
    """
    REC-012: A damage report MUST name every missing sample, by a span of its track or of one that its channel needs.
    """
    data, size, at = w.STEADY.data, PLACES[1].stop - PLACES[1].payload, PLACES[1].payload
    other = data[PLACES[source].payload : PLACES[source].stop]
    for start in range(0, size, every):
        for stop in range(start + 1, size + 1, every + 1):
            bad = w.over(data, at + start, other[start:stop])
            assert bad == data or named(bad) >= TICKS


def test_a_part_of_a_closed_file_whose_last_cluster_is_damaged():
    """By its index: what the cluster's times are, no more."""
    data = w.flip(w.STEADY.data, w.STEADY.row(1, 8).at)
    with hapfmt.Reader(data) as reader:
        assert reader.read([1], start=0, stop=1).channels[0].coverage == ((0, 8),)
        assert [span[:3] for span in reader.lost] == [(1, 8, 12)]
