"""Whole small files: the worked examples of Annex B, and what clauses 5 and 6 allow."""

from __future__ import annotations

from collections.abc import Iterator

import forge as f
from case import Case
from facts import Packet, Track, intact, recording

FIVES = Track(packets=[Packet(0, [5, 5, 5, 5], f.KNOT_DATA)])


def cases() -> Iterator[Case]:
    yield Case(
        "valid",
        "minimal",
        "A head, one track, one constant packet, an index and a footer.",
        ["FIL-001", "FIL-002", "FIL-003", "DAT-004", "KNT-002"],
        recording(FIVES),
        intact(FIVES, head={"major": 1, "minor": 0, "level": 1, "file_id": 7, "uuid": None,
                            "epoch_ns": None, "epoch_uncertainty_ns": None}),
    )  # fmt: skip
