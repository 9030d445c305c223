"""The table "What is read" of docs/xdf-tdms-edf.md, cell by cell, on files of other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import tdms_files as tdms
import xdf_files as xdf
from test_formats_survival import table

from hapfmt.convert import read
from hapfmt.convert.timestamps import stamps_of
from hapfmt.errors import ParameterError
from hapfmt.recording import Calibration, Span

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


def xdf_scale() -> str:
    """A resolution in the description of a channel is not one that LSL defines."""
    desc = "<channels><channel><label>a</label><resolution>0.5</resolution></channel></channels>"
    assert read_xdf(xdf_stream("int16", desc=desc))[0].calibration == Calibration()
    return "counts only"


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
    kept = back["stamp"]
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


START = np.datetime64("2026-05-01T10:00:00.123456", "us")


def tdms_channel(x: Any, **properties: Any) -> Any:
    given = {"wf_increment": 0.01, **properties}
    return read(tdms.written([tdms.channel("g", "x", x, **given)]))


def tdms_exact(*dtypes: str) -> str:
    for dtype in dtypes:
        x = (X / 7 if dtype[0] == "f" else X % 128).astype(dtype)
        [channel] = tdms_channel(x)
        assert channel.stored.tolist() == x.tolist()
        if channel.calibration is None:
            assert channel.stored.dtype == (np.uint64 if dtype == "u4" else x.dtype)
    return "exact"


def tdms_noted(x: Any) -> str:
    back = tdms_channel(x)
    assert not back.channels
    assert "which are not read" in back.metadata["notes"][0]
    return "no"


def tdms_refused() -> str:
    with pytest.raises(ParameterError, match="give a rate"):
        read(tdms.written([tdms.channel("g", "x", [1, 2])]))
    return "refused; give `--rate`"


def tdms_rates() -> str:
    data = tdms.written([
        tdms.channel("g", "x", [1.5], wf_increment=1 / 44100),
        tdms.channel("g", "y", [1.5, 2], wf_increment=3.0),
    ])  # fmt: skip
    assert [c.rate_exact for c in read(data)] == [44100, Fraction(1, 3)]
    return "exact"


def tdms_stamped(stamps: Any, **options: Any) -> Any:
    data = tdms.written([
        tdms.channel("g", "t", START + np.rint(stamps * 1e6).astype(int) * np.timedelta64(1, "us")),
        tdms.channel("g", "x", np.arange(len(stamps))),
    ])  # fmt: skip
    return read(data, **options)


def tdms_lost() -> str:
    kept = np.array([i for i in range(200) if not 80 <= i < 90])
    [channel] = tdms_stamped(kept / 100)
    assert channel.coverage == (Span(0, 80), Span(90, 200))
    return "a gap"


def tdms_stamps() -> str:
    [channel] = tdms_stamped(np.array(LATE))
    assert channel.coverage == (Span(0, 200),)
    return "to the nearest tick"


def tdms_kept_stamps() -> str:
    back = tdms_stamped(np.array(LATE), keep_stamps=True)
    kept = back["stamp"]
    stamps = stamps_of(kept.stored, np.arange(200), kept.rate_exact, back.epoch_ns)
    expected = (START + np.rint(np.array(LATE) * 1e6).astype(int) * np.timedelta64(1, "us")).astype(
        "M8[ns]"
    )
    assert np.abs(stamps - expected.astype(np.int64)).max() <= 1
    return "to 1 ns"


def tdms_label() -> str:
    data = tdms.written([tdms.channel("g", "Fx (thumb), raw", [1.5], wf_increment=1.0)])
    assert read(data).labels == ["Fx (thumb), raw"]
    return "exact"


def tdms_unit() -> str:
    back = tdms_channel([1.5], unit_string="Newton")
    assert back[0].unit == "N"
    assert back.metadata["source_units"] == {"x": "Newton"}
    return "in UCUM; the text is kept"


def tdms_scale() -> str:
    [channel] = tdms_channel(X.astype("i2"), **tdms.linear(10 / 32768, 0.5))
    assert channel.calibration == Calibration(5, 8192, 16384)
    assert channel.counts.tolist() == X.tolist()
    return "exact"


def tdms_clocks() -> str:
    back = tdms_stamped(np.arange(200) / 100)
    assert [c.tick for c in back.clocks] == [0, 100, 199]
    return "once a second"


def tdms_start() -> str:
    back = tdms_channel([1.5], wf_start_time=START)
    assert back.epoch_ns == int(START.astype("M8[ns]").astype(np.int64))
    return "to 1 ns"


CELLS: dict[str, dict[str, Callable[[], str]]] = {
    "integers of 8 to 32 bits": {
        "XDF": lambda: xdf_exact("int8", "int16", "int32"),
        "TDMS": lambda: tdms_exact("i1", "u1", "i2", "u2", "i4", "u4"),
    },
    "integers of 64 bits": {
        "XDF": lambda: xdf_exact("int64"),
        "TDMS": lambda: tdms_exact("i8", "u8"),
    },
    "floating point": {
        "XDF": lambda: xdf_exact("float32", "double64"),
        "TDMS": lambda: tdms_exact("f4", "f8"),
    },
    "a linear scale": {"XDF": xdf_scale, "TDMS": tdms_scale},
    "texts": {
        "XDF": lambda: xdf_events("string", "abc"),
        "TDMS": lambda: tdms_noted(["a", "b"]),
    },
    "samples without a rate": {
        "XDF": lambda: xdf_events("int16", [4, -5, 6]),
        "TDMS": tdms_refused,
    },
    "several rates": {"XDF": xdf_rates, "TDMS": tdms_rates},
    "lost rows": {"XDF": xdf_lost, "TDMS": tdms_lost},
    "labels": {"XDF": xdf_label, "TDMS": tdms_label},
    "units": {"XDF": xdf_unit, "TDMS": tdms_unit},
    "time stamps": {"XDF": xdf_stamps, "TDMS": tdms_stamps},
    "time stamps with `--keep-stamps`": {"XDF": xdf_kept_stamps, "TDMS": tdms_kept_stamps},
    "the clocks of computers": {"XDF": xdf_clocks, "TDMS": tdms_clocks},
    "the start time": {"XDF": xdf_start, "TDMS": tdms_start},
}


@pytest.mark.parametrize("row", CELLS)
def test_cells(row: str) -> None:
    assert {name: shown() for name, shown in CELLS[row].items()} == table("What is read")[row]


def test_the_table_has_no_other_row() -> None:
    assert [*table("What is read")] == [*CELLS]
