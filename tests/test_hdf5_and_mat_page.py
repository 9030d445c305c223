"""The tables of docs/hdf5-and-mat.md, cell by cell."""

from __future__ import annotations

import io
import re
import uuid
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from formats import written
from spec import ROOT
from test_formats_mat import cells, made, made_73, opaque, put, put_references, put_text

from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.convert import read
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

PAGE = (ROOT / "docs" / "hdf5-and-mat.md").read_text("utf-8")


def table(heading: str) -> dict[str, list[str]]:
    """The last table of a section: {first cell: the others}."""
    part = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    lines = re.findall(r"^\|.*\|$", part.rpartition("|---")[2], re.M)
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0]: row[1:] for row in rows if row[0]}


def quoted(note: str) -> list[str]:
    return [text for text in re.findall("`([^`]*)`", note) if text[:2] != "--"]


GIVEN = Recording(
    (
        Channel(
            np.arange(-50, 50, dtype=np.int16),
            1000,
            (Span(5, 45), Span(100, 160)),
            Calibration(3, 7, 1000),
            "force/x",
            "N",
            lsb=0.003,
        ),
        Channel(np.arange(95.0), 1000, (Span(20, 115),), label="y"),
        Channel(np.arange(7, dtype=np.float16), "44100/7", label="slow"),
    ),
    uuid=uuid.UUID(int=5),
    epoch_ns=1_700_000_000 * 10**9,
    epoch_uncertainty_ns=5,
    events=(Event(Fraction(1, 3), "tap", Fraction(1, 10), 1, "hand"),),
    clocks=(ClockObservation("pc", 0, 5, 17),),
    clock_maps=(ClockMap("pc", 1, ((0, 5), (10, 99))),),
    metadata={"subject": "S1"},
    attachments={"a.txt": ("text/plain", b"hello")},
)


@pytest.mark.parametrize(("format", "title"), [("h5", "HDF5"), ("mat", "MAT")])
def test_there_and_back(format: str, title: str) -> None:
    cells = table(f"The {title} files that hapfmt writes")
    data, said = written(GIVEN, format)
    back = read(data)

    def both(*names: str) -> bool:
        return all(
            getattr(a, name) == getattr(b, name)
            for name in names
            for a, b in zip(back, GIVEN, strict=True)
        )

    def same(*names: str) -> bool:
        return all(getattr(back, name) == getattr(GIVEN, name) for name in names)

    exact = {
        "values": [a.stored.tobytes() for a in back] == [b.stored.tobytes() for b in GIVEN],
        "rates": both("rate_exact"),
        "gaps": both("coverage"),
        "labels": both("label"),
        "units": both("unit"),
        "calibrations": both("calibration"),
        "start and epoch": both("start_tick") and same("epoch_ns", "epoch_uncertainty_ns"),
        "events": same("events"),
        "clocks": same("clocks", "clock_maps"),
        "metadata": same("metadata"),
        "attachments": same("attachments"),
    }
    assert all(exact.values()), exact
    assert [what for what, (kept, _) in cells.items() if kept == "exact"] == [*exact]

    holed = Recording((Channel(np.array([1.0, np.nan, 2.0]), 5, label="fx"),))
    doubles = np.array([0.1, 0.2])
    grid = Channel(np.array([1, 2]), 5, (), Calibration(1, 0, 10), "fx", exact=doubles)
    holed_data, holed_said = written(holed, format)
    grid_data, grid_said = written(Recording((grid,)), format)
    assert read(holed_data)[0].coverage == (Span(0, 1), Span(2, 3))
    assert read(grid_data)[0].stored.tobytes() == doubles.tobytes()
    assert back.uuid is None
    lost = {
        "NaN as a value": holed_said,
        "counts behind corrected doubles": grid_said,
        "UUID": said,
    }
    assert set(cells) - set(exact) == set(lost)
    for what, notes in lost.items():
        (note,) = quoted(cells[what][1])
        assert cells[what][0].startswith("no") and note in " ".join(notes), what


# ------------------------------------------------------------------ what comes in

RNG = np.random.default_rng(5)
LOST = np.delete(np.arange(1000), np.arange(400, 430))
TYPES = [
    "int8",
    "int16",
    "int32",
    "uint8",
    "uint16",
    "uint32",
    "int64",
    "uint64",
    "float32",
    "float64",
    "bool",
]
Arrays = dict[str, Any]


def in_hdf5(arrays: Arrays) -> bytes:
    h5py = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        for name, x in arrays.items():
            if isinstance(x, (str, list)):
                file.attrs[name] = x
            else:
                file[name] = x
    return stream.getvalue()


def in_mat5(arrays: Arrays) -> bytes:
    return made(**{n: cells(*x) if isinstance(x, list) else x for n, x in arrays.items()})


def in_mat73(arrays: Arrays) -> bytes:
    kinds = {"float64": "double", "float32": "single", "bool": "logical"}

    def fill(file: Any) -> None:
        for name, x in arrays.items():
            if isinstance(x, str):
                put_text(file, name, x)
            elif isinstance(x, list):
                parts = [put_text(file, f"#refs#/{name}{i}", each) for i, each in enumerate(x)]
                put_references(file, name, parts, "cell")
            else:
                kind = str(np.asarray(x).dtype)
                put(file, name, x, kinds.get(kind, kind))

    return made_73(fill)


WAYS: dict[str, Callable[[Arrays], bytes]] = {
    "HDF5": in_hdf5, "MAT 5": in_mat5, "MAT 7.3": in_mat73,
}  # fmt: skip


def told(recording: Recording) -> str:
    return "\n".join(recording.metadata.get("notes", []))


class ComesIn:
    """Each member: whether it comes in as the table says, and the notes."""

    def __init__(self, made: Callable[[Arrays], bytes]) -> None:
        self.made = made

    def of(self, **arrays: Any) -> Recording:
        return read(self.made(arrays))

    def values(self) -> tuple[str, str]:
        for name in TYPES:
            x = RNG.integers(0, 2 if name == "bool" else 100, 60).astype(name)
            found = self.of(x=x, fs=10.0)[0]
            if found.stored.astype(x.dtype).tobytes() != x.tobytes():
                return "no", ""
        return "exact", ""

    def channels(self) -> tuple[str, str]:
        x = RNG.normal(size=(60, 3))
        found = self.of(x=x, fs=10.0)
        return "exact" if all(np.array_equal(a.stored, b) for a, b in zip(found, x.T, strict=True)) else "no", ""  # fmt: skip

    def labels(self) -> tuple[str, str]:
        found = self.of(x=np.zeros((60, 2)), fs=10.0, labels=["fx", "fy"])
        return "exact" if found.labels == ["fx", "fy"] else "no", told(found)

    def units(self) -> tuple[str, str]:
        found = self.of(x=np.zeros(60), fs=10.0, unit="mN")
        return "exact" if found[0].unit == "mN" else "no", told(found)

    def other_units(self) -> tuple[str, str]:
        found = self.of(x=np.zeros(60), fs=10.0, unit="au")
        assert found.metadata["source_units"] == {"x": "au"}
        return f"no: `{found[0].unit}`", 'metadata["source_units"]'

    def stated_rates(self) -> tuple[str, str]:
        found = self.of(x=np.zeros(60), fs=35.618)
        return "exact" if found[0].rate_exact == Fraction(17809, 500) else "no", told(found)

    def even_times(self) -> tuple[str, str]:
        found = self.of(x=np.zeros(900), time=np.arange(900) / 700)
        return "exact" if found[0].rate_exact == 700 else "no", told(found)

    def missing_rows(self) -> tuple[str, str]:
        found = self.of(x=np.zeros(970), time=LOST / 500)
        spans = (Span(0, 400), Span(430, 1000))
        return "exact" if found[0].coverage == spans else "no", told(found)

    def nan(self) -> tuple[str, str]:
        x = np.arange(60.0)
        x[20:30] = np.nan
        found = self.of(x=x, fs=10.0)
        return "exact: a gap" if found[0].coverage == (Span(0, 20), Span(30, 60)) else "no", ""

    def jitter(self) -> tuple[str, str]:
        stamps = 1 + np.arange(2000) / 1000 + RNG.uniform(-2e-4, 2e-4, 2000)
        found = self.of(x=np.zeros(2000), time=stamps)
        near = found[0].rate_exact == 1000 and found[0].coverage[-1].stop - 3000 in (-1, 0, 1)
        kept = read(self.made({"x": np.zeros(2000), "time": stamps}), keep_stamps=True)
        own = (np.arange(2000) + kept[1].start_tick) * 1_000_000 + kept[1].stored
        near = near and bool(np.abs(own - stamps * 1e9).max() <= 1)
        return "to a tick" if near else "no", told(found)

    def complex(self) -> tuple[str, str]:
        found = self.of(x=np.zeros(60), c=np.full(60, 1j), fs=10.0)
        return "no" if found.labels == ["x"] else "", told(found)

    def objects(self) -> tuple[str, str]:
        if self.made is in_hdf5:
            return "", ""
        if self.made is in_mat5:
            found = read(in_mat5({"x": np.zeros(60), "fs": 10.0}) + opaque("tt", "timetable"))
        else:

            def fill(file: Any) -> None:
                put(file, "x", np.zeros(60))
                put(file, "fs", 10.0)
                put(file, "tt", np.zeros(6, np.uint32), "timetable", MATLAB_object_decode=3)

            found = read(made_73(fill))
        return "no" if found.labels == ["x"] else "", told(found)

    def images(self) -> tuple[str, str]:
        found = self.of(x=np.zeros(60), camera_rgb=np.zeros((60, 8, 8, 3), np.uint8), fs=10.0)
        return "no" if found.labels == ["x"] else "", told(found)


ROWS = {
    "values of each type above": ComesIn.values,
    "channels": ComesIn.channels,
    "labels": ComesIn.labels,
    "units that UCUM has": ComesIn.units,
    "other units": ComesIn.other_units,
    "stated rates": ComesIn.stated_rates,
    "rates from even times": ComesIn.even_times,
    "missing rows": ComesIn.missing_rows,
    "NaN": ComesIn.nan,
    "times with jitter": ComesIn.jitter,
    "complex numbers": ComesIn.complex,
    "objects of MATLAB": ComesIn.objects,
    "images": ComesIn.images,
}
COMES_IN = table("What comes in")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("what", ROWS)
def test_comes_in(what: str, way: str) -> None:
    cell = dict(zip((*WAYS, "note"), COMES_IN[what], strict=True))
    kept, notes = ROWS[what](ComesIn(WAYS[way]))
    assert kept == cell[way]
    if kept:
        assert all(text in notes for text in quoted(cell["note"])), notes


def test_the_table_has_no_other_row() -> None:
    assert [*COMES_IN] == [*ROWS]
