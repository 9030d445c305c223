"""The table "What comes back" of docs/xdf-tdms-edf.md, cell by cell."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from formats import facts, written
from spec import ROOT

from hapfmt.clocks import ClockObservation
from hapfmt.convert import read
from hapfmt.errors import ParameterError
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

PAGE = ROOT / "docs" / "xdf-tdms-edf.md"


def channel(**described: Any) -> Channel:
    known = {
        "stored": np.arange(-50, 50, dtype=np.int16), "rate": 1000, "label": "fx",
        "calibration": Calibration(1, 0, 100), **described,
    }  # fmt: skip
    return Channel(known.pop("stored"), **known)


FULL_SCALE = np.array([-32768, 32767] * 50, np.int16)
CASES = {
    "integers of 16 bits": Recording((channel(),)),
    "integers of 24 bits": Recording((channel(stored=np.arange(100) * 80_000 - 4_000_000),)),
    "integers of 16 bits, full scale 1": Recording(
        (channel(stored=FULL_SCALE, calibration=Calibration(1, 0, 1 << 15)),)
    ),
    "floating point": Recording((channel(stored=np.sin(np.arange(100.0)), calibration=None),)),
    "a rate of 44100/7 Hz": Recording((channel(rate=Fraction(44_100, 7)),)),
    "several rates": Recording((channel(), channel(rate=500, label="fy"))),
    "gaps": Recording((channel(coverage=(Span(0, 50), Span(70, 120))),)),
    "the start time": Recording((channel(),), epoch_ns=1_790_000_000_123_456_789),
    "a start after tick 0": Recording((channel(coverage=(Span(7, 107),)),)),
    "labels of up to 16 characters": Recording((channel(label="thumb, force [x]"),)),
    "longer labels": Recording((channel(label="normal force of the thumb"),)),
    "units of up to 8 characters": Recording((channel(unit="m/s2"),)),
    "longer units": Recording((channel(unit="{raw(0-255)}"),)),
    "groups": Recording((channel(group="hand"),)),
    "events": Recording((channel(),), events=(Event(Fraction(1, 50), "slip", Fraction(1, 100)),)),
    "layers of events": Recording((channel(),), events=(Event(Fraction(1, 50), "a", layer="b"),)),
    "clocks": Recording((channel(),), clocks=(ClockObservation("daq", 0, 5, 10**9),)),
}


def members(recording: Recording) -> tuple[Any, ...]:
    return (
        recording.epoch_ns,
        recording.events,
        recording.clocks,
        [(facts(c), c.label, c.unit, c.group) for c in recording],
    )


def survival(recording: Recording, format: str) -> str:
    try:
        out, notes = written(recording, format)
    except ParameterError as error:
        assert "use ." in str(error)
        return "refused"
    back = read(out, format=format)
    if members(back) == members(recording):
        assert not [note for note in notes if "not carried" in note]
        return "exact"
    assert notes
    return "rounded" if any("rounded" in note for note in notes) else "no"


def table(section: str = "What comes back") -> dict[str, dict[str, str]]:
    part = PAGE.read_text("utf-8").split(f"## {section}")[1].split("\n## ")[0]
    head, _, *rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in re.findall(r"^\|.*\|$", part, re.M)
    ]
    return {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}


@pytest.mark.parametrize("case", CASES)
def test_cells(case: str) -> None:
    cells = table()[case]
    assert {name: survival(CASES[case], name.lower()) for name in cells} == cells


def test_the_table_has_no_other_row() -> None:
    assert [*table()] == [*CASES]
