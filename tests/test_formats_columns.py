"""The tables of docs/parquet-and-lerobot.md, cell by cell."""

from __future__ import annotations

import decimal
import io
import json
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import pytest
from spec import ROOT

from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.convert import read, save
from hapfmt.errors import ParameterError
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

PAGE = ROOT / "docs" / "parquet-and-lerobot.md"
N = 200
X = np.sin(np.arange(N))


def table(section: str) -> dict[str, dict[str, str]]:
    part = PAGE.read_text("utf-8").split(f"## {section}\n")[1].split("\n## ")[0]
    head, _, *rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in re.findall(r"^\|.*\|$", part, re.M)
    ]
    return {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}


# What is read


def foreign(columns: dict[str, Any], kind: str, root: Path, fields: dict[str, Any]) -> Any:
    """A file of pyarrow with these columns, and times of 100 Hz."""
    if kind == "LeRobot":
        return dataset(columns, root, fields)
    columns = {"time": np.arange(N) / 100, **columns}
    made = pa.table(columns)
    for name, about in fields.items():
        place = made.column_names.index(name)
        made = made.set_column(place, made.schema.field(name).with_metadata(about), made[name])
    stream = io.BytesIO()
    if kind == "Parquet":
        pa.parquet.write_table(made, stream)
    else:
        pa.feather.write_feather(made, stream)
    return stream.getvalue()


def dataset(columns: dict[str, Any], root: Path, fields: dict[str, Any]) -> Path:
    own = {"timestamp": np.float32(np.arange(N) / 100), "frame_index": np.arange(N)}
    columns = {**own, "episode_index": np.zeros(N, np.int64), **columns}
    made = pa.table(columns)
    features = {}
    for field in made.schema:
        dtype = "string" if pa.types.is_string(field.type) else str(field.type)
        if pa.types.is_struct(field.type):
            dtype = "image"
        features[field.name] = {"dtype": dtype, "shape": [1], "names": None}
    for name, about in fields.items():
        features[name] |= {"names": [name]}
        place = made.column_names.index(name)
        made = made.set_column(place, made.schema.field(name).with_metadata(about), made[name])
    features.pop("host", None)
    files = {
        "data/chunk-000/file-000.parquet": made,
        "meta/episodes/chunk-000/file-000.parquet": pa.table(
            {"episode_index": [0], "length": [N], "data/chunk_index": [0], "data/file_index": [0],
             "dataset_from_index": [0], "dataset_to_index": [N]}
        ),
    }  # fmt: skip
    for name, content in files.items():
        (root / name).parent.mkdir(parents=True)
        pa.parquet.write_table(content, root / name)
    info = {"codebase_version": "v3.0", "fps": 100, "features": features}
    (root / "meta/info.json").write_text(json.dumps(info), "utf-8")
    return root


def values(*columns: Any) -> Callable[[Recording], str]:
    """All of them are there, bit for bit."""

    def check(found: Recording) -> str:
        assert len(found) == len(columns)
        for channel, x in zip(found, columns, strict=True):
            expected = np.asarray(x)
            assert channel.coverage == (Span(0, N),)
            assert np.array_equal(channel.stored, expected)
            assert channel.stored.dtype.kind != "f" or channel.stored.dtype == expected.dtype
        return "exact"

    return check


def unread(*names: str) -> Callable[[Recording], str]:
    def check(found: Recording) -> str:
        assert len(found) == 1
        for name in names:
            notes = [note for note in found.metadata["notes"] if f"'{name}" in note]
            assert notes and "not read" in notes[0]
        return "no"

    return check


def with_gap(found: Recording) -> str:
    assert found[0].coverage == (Span(0, 50), Span(60, N))
    return "exact" if found[0].stored.dtype.kind in "iu" else "gap"


def with_unit(found: Recording) -> str:
    assert (found[0].label, found[0].unit) == ("fx", "N")
    return "exact"


def rate_is_exact(found: Recording) -> str:
    assert found[0].rate_exact == 100 and "notes" not in found.metadata
    return "exact"


def start_is_exact(found: Recording) -> str:
    assert found.epoch_ns == 1_700_000_000 * 10**9
    return "exact"


def moved(found: Recording) -> str:
    assert found[0].rate_exact == 100 and found[0].coverage == (Span(0, N),)
    assert re.search("moved|differ", found.metadata["notes"][0])
    return "moved"


def second_clock(found: Recording) -> str:
    if found.clocks:
        assert {each.clock for each in found.clocks} == {"host"}
        return "clock"
    return unread("host")(found)


def as_events(found: Recording) -> str:
    assert [(e.text, e.time) for e in found.events] == [("a", 0), ("b", 1)]
    return "events"


def lost_rows(found: Recording) -> str:
    assert found[0].coverage == (Span(0, 50), Span(60, N + 10))
    assert found[0].stored.tobytes() == X.tobytes()
    return "gap"


FLOATS = [X.astype(np.float16), X.astype(np.float32), X]
WHOLE = [np.arange(N) % 2 == 0, (np.arange(N) - 50).astype(np.int8), np.arange(N) * (1 << 50)]
LOST = np.delete(np.arange(N + 10), range(50, 60))
HOLES = [*range(50), *[None] * 10, *range(60, N)]
JITTER = np.arange(N) / 100 + np.where(np.arange(N) % 7 == 3, 0.002, 0)
STAMPS = pa.array(1_700_000_000_000 + np.arange(N) * 10, pa.timestamp("ms"))
PICTURE = pa.array([{"bytes": b"x", "path": "a.png"}] * N)
READ: dict[str, tuple[dict[str, Any], Callable[[Recording], str], dict[str, Any]]] = {
    "floating point of 16, 32, 64 bits": (
        {str(i): x for i, x in enumerate(FLOATS)}, values(*FLOATS), {}),
    "integers, truth values": ({str(i): x for i, x in enumerate(WHOLE)}, values(*WHOLE), {}),
    "integers with empty cells": ({"x": pa.array(HOLES, pa.int16())}, with_gap, {}),
    "NaN": ({"x": np.array(HOLES, float)}, with_gap, {}),
    "the rate": ({"x": X}, rate_is_exact, {}),
    "missing rows": (
        {"x": X, "time": LOST / 100, "timestamp": np.float32(LOST / 100), "frame_index": LOST},
        lost_rows, {}),
    "the start time": (
        {"x": X, "time": STAMPS},
        start_is_exact, {}),
    "times that jitter": ({"x": X, "time": JITTER, "timestamp": np.float32(JITTER)}, moved, {}),
    "a second column of times": (
        {"x": X, "time": STAMPS, "host": STAMPS}, second_clock, {}),
    "labels": ({"thumb, force [x]": X}, values(X), {}),
    "units in the names": ({"fx [N]": X}, with_unit, {"fx [N]": {}}),
    "units in the metadata": ({"fx": X}, with_unit, {"fx": {"unit": "newton"}}),
    "lists of one length": (
        {"x": pa.array(np.stack([X, -X], 1).tolist())}, values(X, -X), {}),
    "lists of several lengths": (
        {"x": X, "odd": pa.array([[1.0], [1.0, 2.0]] * (N // 2))}, unread("odd"), {}),
    "dictionaries": ({"x": pa.array(np.arange(N) % 3).dictionary_encode()},
                     values(np.arange(N) % 3), {}),
    "texts": ({"x": X, "phase": ["a"] * 100 + ["b"] * 100}, as_events, {}),
    "decimals, binary, maps": (
        {"x": X, "odd": pa.array([decimal.Decimal("1.5")] * N), "blob": pa.array([b"a"] * N),
         "map": pa.array([[("a", 1)]] * N, pa.map_(pa.string(), pa.int64()))},
        unread("odd", "blob", "map"), {}),
    "images": ({"x": X, "top": PICTURE}, unread("top"), {}),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::hapfmt.errors.DataWarning")
@pytest.mark.parametrize("case", READ)
def test_read(case: str, tmp_path: Path) -> None:
    for kind, cell in table("What is read")[case].items():
        columns, check, fields = READ[case]
        if kind == "LeRobot":
            if cell == "-":
                continue
            columns = {name: x for name, x in columns.items() if name != "time"}
        else:
            columns = {
                name: x for name, x in columns.items() if name not in ("timestamp", "frame_index")
            }
        found = read(foreign(columns, kind, tmp_path / "set", fields))
        assert check(found) == cell, kind


# What comes back


def channel(**described: Any) -> Channel:
    known = {
        "stored": np.arange(-50, 50, dtype=np.int16), "rate": 1000, "label": "fx",
        "calibration": Calibration(1, 0, 100), **described,
    }  # fmt: skip
    return Channel(known.pop("stored"), **known)


GAP = (Span(0, 50), Span(70, 120))
FAR = np.array([2**60, -(2**60)] * 50)
WRITTEN = {
    "integers with a scale": Recording((channel(),)),
    "integers of 64 bits": Recording((channel(stored=FAR, calibration=None),)),
    "floating point of 16, 32, 64 bits": Recording(
        tuple(channel(stored=x, calibration=None, label=str(x.dtype)) for x in FLOATS)
    ),
    "a rate of 44101/7 Hz": Recording((channel(rate=Fraction(44_101, 7)),)),
    "several rates": Recording((channel(), channel(rate=500, label="fy"))),
    "gaps": Recording((channel(coverage=GAP), channel(stored=X, calibration=None, label="x"))),
    "gaps among integers beyond 2^53": Recording(
        (channel(stored=FAR, calibration=None, coverage=GAP),)
    ),
    "a start after tick 0": Recording((channel(coverage=(Span(7, 107),)),)),
    "the start time": Recording((channel(),), epoch_ns=1_790_000_000_123_456_789),
    "labels, units, quantities, axes": Recording(
        (channel(label="thumb, [x]/y", unit="m/s2", quantity="force", axis="x"),)
    ),
    "groups, body sites, devices": Recording(
        (channel(group="left hand", body_site="thumb", device="ATI"),)
    ),
    "events": Recording(
        (channel(),), events=(Event(Fraction(1, 3), "slip", Fraction(1, 7), 0, "a"),)
    ),
    "clocks": Recording(
        (channel(),),
        clocks=(ClockObservation("pc", 0, 3, 10**18, 5),),
        clock_maps=(ClockMap("pc", 0, ((0, 5), (10, 99))),),
    ),
    "metadata": Recording((channel(),), metadata={"subject": "S1", "n": {"a": [1, None]}}),
    "NaN that was measured": Recording(
        (channel(stored=np.where(np.arange(N) == 70, np.nan, X), calibration=None),)
    ),
    "attachments": Recording((channel(),), attachments={"a.txt": ("text/plain", b"a")}),
}


def members(recording: Recording) -> Any:
    return [
        recording.epoch_ns, recording.metadata, recording.events, recording.clocks,
        recording.clock_maps, recording.attachments,
    ] + [
        (c.stored.tobytes(), c.stored.dtype, c.coverage, c.calibration, c.rate_exact, c.label,
         c.unit, c.quantity, c.axis, c.group, c.body_site, c.device)
        for c in recording
    ]  # fmt: skip


def saved(recording: Recording, kind: str, path: Path) -> tuple[str, ...]:
    fps: dict[str, Any] = {}
    if kind == "LeRobot":
        fps["fps"] = min(c.rate_exact for c in recording) / 10
    return save(recording, path, format=kind.lower(), **fps)


def survival(recording: Recording, kind: str, path: Path) -> str:
    try:
        notes = saved(recording, kind, path)
    except ParameterError as error:
        assert re.search(r"use \.|cannot hold both", str(error))
        return "refused"
    back = read(path, format=kind.lower())
    if members(back) == members(recording):
        assert not [note for note in notes if "not carried" in note]
        return "exact"
    assert notes
    return "gap" if any("cannot be told from gaps" in note for note in notes) else "no"


@pytest.mark.parametrize("case", WRITTEN)
def test_comes_back(case: str, tmp_path: Path) -> None:
    cells = table("What comes back")[case]
    for kind, cell in cells.items():
        assert survival(WRITTEN[case], kind, tmp_path / kind) == cell, kind


# What others see

SEEN = Recording(
    (
        channel(coverage=GAP, unit="N"),
        channel(stored=X[:100], calibration=None, label="acc", coverage=(Span(20, 120),)),
    ),
    epoch_ns=1_790_000_000_123_456_789,
    metadata={"task": "press"},
    events=(Event(Fraction(1, 50), "slip"),),
    clocks=(ClockObservation("pc", 0, 3, 10**18, 5),),
)
PHYSICAL = (np.arange(-50, 50) / 100).tolist()


@pytest.fixture
def seen(tmp_path: Path) -> dict[str, Path]:
    for kind in ("Parquet", "Feather"):
        saved(SEEN, kind, tmp_path / kind)
    save(SEEN, tmp_path / "LeRobot", format="lerobot", fps=100)
    return {path.name: path for path in tmp_path.iterdir()}


def test_what_others_see(seen: dict[str, Path]) -> None:
    cells = table("What others see")
    frames = {
        "Parquet": [polars.read_parquet(seen["Parquet"]), pd.read_parquet(seen["Parquet"])],
        "Feather": [polars.read_ipc(seen["Feather"]), pd.read_feather(seen["Feather"])],
    }  # fmt: skip
    for kind, (of_polars, of_pandas) in frames.items():
        assert (
            of_polars["fx"].drop_nulls().to_list() == PHYSICAL == of_pandas["fx"].dropna().tolist()
        )
        assert of_polars["fx"].null_count() == 20
        assert of_polars["time"].to_list() == (np.arange(120) / 1000).tolist()
        reader = pa.parquet if kind == "Parquet" else pa.feather
        schema = reader.read_table(seen[kind]).schema
        assert schema.metadata[b"rate_hz"] == b"1000.0"
        assert schema.field("fx").metadata[b"unit"] == b"N" and schema.names[1:] == ["fx", "acc"]
        own = json.loads(schema.metadata[b"hapfmt"])
        assert {"epoch_ns", "events", "clocks", "metadata"} <= own.keys()
    root = seen["LeRobot"]
    info = json.loads((root / "meta/info.json").read_text("utf-8"))
    feature = info["features"]["observation.touch"]
    assert (info["fps"], feature["shape"]) == (100, [10, 2])
    assert feature["names"] == {"channels": ["fx", "acc"]}
    data = pa.parquet.read_table(root / "data")
    x = np.array(data["observation.touch"].to_pylist()).reshape(120, 2)
    assert x[~np.isnan(x[:, 0]), 0].tolist() == PHYSICAL
    assert data["timestamp"].to_pylist() == np.float32(np.arange(12) / 100).tolist()
    assert pd.read_parquet(root / "meta/tasks.parquet").index.tolist() == ["press"]
    assert cells == {
        "values": {"Parquet, Feather": "physical values", "LeRobot": "physical values"},
        "gaps": {"Parquet, Feather": "empty cells", "LeRobot": "NaN"},
        "times": {"Parquet, Feather": "column `time`", "LeRobot": "column `timestamp`"},
        "the rate": {"Parquet, Feather": "`rate_hz`", "LeRobot": "`fps` and the windows"},
        "labels": {"Parquet, Feather": "names of the columns", "LeRobot": "`names`"},
        "units": {"Parquet, Feather": "`unit` of the field", "LeRobot": "hidden"},
        "start time, events, clocks": {"Parquet, Feather": "hidden", "LeRobot": "hidden"},
        "task": {"Parquet, Feather": "hidden", "LeRobot": "task"},
    }


def test_the_tables_have_no_other_rows() -> None:
    assert [*table("What is read")] == [*READ]
    assert [*table("What comes back")] == [*WRITTEN]
