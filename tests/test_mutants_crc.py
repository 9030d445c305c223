"""Files that break rules although their checksums hold, through every verb (tools/mutants_crc.py)."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import forge as f
import pytest
from depth import PROFILE, either
from fuzzing.mutants import (
    FIRST,
    PER_FILE,
    VERBS,
    Row,
    check,
    check_recovered,
    cluster_of,
    limits_of,
    mutant,
    rows_of,
    seeds,
)
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.limits import Limits
from hapfmt.reading.verifier import verify

FEWEST = 60
PARTS = 4


@pytest.mark.parametrize("part", range(PARTS))
@either("count", FEWEST, deep=12_000 if PROFILE == "nightly" else 400)
def test_mutants(part: int, count: int, tmp_path: Path) -> None:
    """
    VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
    """
    told: Counter[str] = Counter()
    for seed in range(part * count // PARTS, (part + 1) * count // PARTS):
        told.update(check(seed, tmp_path))
    # Else the mutants are too wild, or too tame.
    assert told["law: recovered, 3"] > count // PARTS // 4
    assert sum(times for line, times in told.items() if line.endswith(": 2")) > 0


@given(st.integers(0, 1 << 62))
def test_any_mutant(seed: int) -> None:
    check_recovered(mutant(seed), limits_of(seed))


@pytest.mark.parametrize("seed", [9064, 15_718, 18_204, 26_951])
def test_no_sample_is_delivered_and_lost(seed: int) -> None:
    """Intact packets that overlap, that pass the limit of a cluster, or of which the exact values
    break a rule."""
    check_recovered(mutant(seed), limits_of(seed))


def test_a_wrong_digest_is_not_left_in_place(tmp_path: Path) -> None:
    """Its track lacks another that is not understood, so that no digest of it was compared."""
    check(18_815, tmp_path)


def test_every_verb_has_its_turn() -> None:
    assert 4 * len(VERBS) <= FEWEST * PER_FILE
    assert len(seeds()) > 500
    assert {len(seed) > 250 for seed in seeds()[:FIRST]} == {True}


def two_events(first: int, second: int, *more: Row) -> bytes:
    """A layer with two packets of an event each, which begin at these ticks."""
    rows = [Row(0, 0, 4, f.KNOT_DATA), Row(1, first, 4, f.event(0, "a")), *more]
    return f.closed(
        ("HEAD", f.head()),
        f.TRACK_0,
        ("TRAK", f.layer(f.tlv(2, f.strings("by hand")), first=1)),
        ("DATA", f.cluster(*rows, (1, second, 4, f.event(1, "b")))),
        duration_ns=8_000_000,
    )


def test_packets_of_events_that_start_together() -> None:
    """
    DAT-002: Rows MUST be in strictly increasing order of (track, start), those of events too.
    REC-006: A recovered file MUST contain exactly the packets that a reader delivers through damage and that decode, exact values too. Track id, start, span and bytes stay the same.
    """
    data = two_events(0, 0)
    assert verify(data).exit_code == 2
    assert check_recovered(data, Limits()) == "recovered, 0"


def test_rows_come_back() -> None:
    rows = [Row(0, 3, 4, b"abc"), Row(700, 1 << 40, 1, b"")]
    assert rows_of(cluster_of(rows)) == rows


@pytest.mark.parametrize("seed", [2509, 18_767, 20_854, 23_978])
def test_what_was_found(seed: int, tmp_path: Path) -> None:
    """Tracks that are not understood and name a base that is not there, or a codec of letters
    beyond ASCII, escaped as foreign exceptions."""
    check(seed, tmp_path)


def test_bytes_after_the_packets_are_nobodys() -> None:
    """Every checksum holds, and all packets come back: nothing is lost with what no row speaks of."""
    rows = [Row(0, 4 * i, 4, f.KNOT_DATA) for i in range(2)]
    data = f.closed(
        ("HEAD", f.head()), f.TRACK_0, ("DATA", f.cluster(*rows) + b"\0"), duration_ns=8_000_000
    )
    assert verify(data).error.requirement == "DAT-005"
    assert check_recovered(data, Limits()) == "recovered, 0"
