"""The table "What is read" of docs/xdf-tdms-edf.md, cell by cell, on files of other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
import xdf_files as xdf
from test_formats_survival import table

from hapfmt.convert import read
from hapfmt.convert.timestamps import stamps_of
from hapfmt.recording import Span

X = np.arange(-100, 100)
REGULAR = [50 + i / 100 for i in range(200)]
LATE = [time + 1e-3 * (i % 3) for i, time in enumerate(REGULAR)]


def xdf_stream(
    format: str, x: Any = X, stamps: Sequence[float] = REGULAR, rate: float = 100, desc: str = ""
) -> bytes:
    rows = [[each] for each in x]
    head = xdf.header(1, "force", format, 1, rate, desc)
    return xdf.START + head + xdf.samples(1, format, rows, stamps)


def read_xdf(chunks: bytes, **options: Any) -> Any:
    return read(b"XDF:" + chunks, **options)


def xdf_exact(*formats: str) -> str:
    for format in formats:
        x = X / 7 if format in ("float32", "double64") else X
        [channel] = read_xdf(xdf_stream(format, x))
        expected = np.asarray(x, xdf.DTYPES[format])
        assert channel.stored.tolist() == expected.tolist()
        if channel.calibration is None:
            assert channel.stored.dtype == expected.dtype
    return "exact"


def xdf_events(format: str, x: Any) -> str:
    back = read_xdf(xdf_stream(format, x, [1, 1.371, 4.902], 0))
    assert [event.text for event in back.events] == list(map(str, x))
    assert [float(event.time) for event in back.events] == [0, 0.371, 3.902]
    assert not back.channels
    return "events"


def xdf_rates() -> str:
    second = xdf.header(2, "emg", "int16", 1, 2000) + xdf.samples(
        2, "int16", [[i] for i in range(100)], [50 + i / 2000 for i in range(100)]
    )
    assert [c.rate_exact for c in read_xdf(xdf_stream("int16") + second)] == [100, 2000]
    return "exact"


def xdf_lost() -> str:
    kept = [i for i in range(200) if not 80 <= i < 90]
    [channel] = read_xdf(xdf_stream("int16", X[kept], [REGULAR[i] for i in kept]))
    assert channel.coverage == (Span(0, 80), Span(90, 200))
    return "a gap"


def xdf_described(label: str, unit: str) -> Any:
    return read_xdf(xdf_stream("int16", desc=xdf.channels((label, unit))))


def xdf_label() -> str:
    assert xdf_described("Fx (thumb), raw", "").labels == ["Fx (thumb), raw"]
    return "exact"


def xdf_unit() -> str:
    back = xdf_described("fx", "Newton")
    assert back[0].unit == "N"
    assert back.metadata["source_units"] == {"fx": "Newton"}
    return "in UCUM; the text is kept"


def xdf_stamps() -> str:
    [channel] = read_xdf(xdf_stream("int16", stamps=LATE))
    assert channel.coverage == (Span(0, 200),)
    return "to the nearest tick"


def xdf_kept_stamps() -> str:
    back = read_xdf(xdf_stream("int16", stamps=LATE), keep_stamps=True)
    kept = back["force.stamp"]
    zero = next(c.time_ns for c in back.clocks) - int(kept.stored[0])
    stamps = stamps_of(kept.stored, np.arange(200), kept.rate_exact, zero)
    assert np.abs(stamps - np.rint(np.array(LATE) * 1e9)).max() <= 1
    return "to 1 ns"


def xdf_clocks() -> str:
    offsets = b"".join(xdf.offset(1, time, 7) for time in (50, 51))
    seen = read_xdf(xdf_stream("int16") + offsets).clocks
    assert [(c.clock, c.tick) for c in seen if c.clock == "lsl:force-pc"] == [
        ("lsl:force-pc", tick) for tick in (0, 100, 199)
    ]
    assert [(c.tick, c.time_ns) for c in seen if c.clock == "lsl"] == [
        (0, 57 * 10**9), (100, 58 * 10**9)
    ]  # fmt: skip
    return "once a second"


def xdf_start() -> str:
    head = xdf.chunk(1, b"<info><datetime>2026-05-01T10:00:00+02:00</datetime></info>")
    back = read_xdf(xdf_stream("int16").replace(xdf.START, head))
    assert back.epoch_ns == 1_777_622_400 * 10**9
    assert back.epoch_uncertainty_ns == 10**9
    return "to 1 s"


CELLS: dict[str, dict[str, Callable[[], str]]] = {
    "integers of 8 to 32 bits": {"XDF": lambda: xdf_exact("int8", "int16", "int32")},
    "integers of 64 bits": {"XDF": lambda: xdf_exact("int64")},
    "floating point": {"XDF": lambda: xdf_exact("float32", "double64")},
    "texts": {"XDF": lambda: xdf_events("string", "abc")},
    "streams without a rate": {"XDF": lambda: xdf_events("int16", [4, -5, 6])},
    "several rates": {"XDF": xdf_rates},
    "lost rows": {"XDF": xdf_lost},
    "labels": {"XDF": xdf_label},
    "units": {"XDF": xdf_unit},
    "time stamps": {"XDF": xdf_stamps},
    "time stamps with `--keep-stamps`": {"XDF": xdf_kept_stamps},
    "the clocks of computers": {"XDF": xdf_clocks},
    "the start time": {"XDF": xdf_start},
}


@pytest.mark.parametrize("row", CELLS)
def test_cells(row: str) -> None:
    assert {name: shown() for name, shown in CELLS[row].items()} == table("What is read")[row]


def test_the_table_has_no_other_row() -> None:
    assert [*table("What is read")] == [*CELLS]
