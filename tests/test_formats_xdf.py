"""XDF files, which pyxdf reads too and agrees."""

from __future__ import annotations

import gzip
import io
import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from formats import damaged, facts, survives
from hypothesis import given
from hypothesis import strategies as st
from xdf_files import BOUNDARY, DTYPES, START, channels, chunk, header, offset, samples

from hapfmt.convert import imported, read
from hapfmt.errors import LimitError, ParameterError
from hapfmt.recording import Calibration, Event, Span


def session(count: int = 1000) -> tuple[bytes, Any]:
    """Forces at 500 Hz in chunks of 100 whose first row alone has a stamp, markers, and offsets."""
    x = np.random.default_rng(4).integers(-3000, 3000, (count, 2))
    desc = channels(("fx", "millinewtons"), ("emg", "microvolts"))
    out = b"XDF:" + START + header(7, "glove", "int16", 2, 500, desc)
    out += header(9, "markers", "string", 1, 0)
    for first in range(0, count, 100):
        stamps = [1000 + first / 500, *[None] * 99]
        out += samples(7, "int16", x[first : first + 100], stamps) + BOUNDARY
        out += offset(7, 1000 + first / 500, -900.25)
    out += samples(9, "string", [["begin"], ["slip ü"]], [100.0, 100.75])
    return out, x


def foreign(data: bytes, tmp_path: Path) -> dict[str, dict[str, Any]]:
    """What pyxdf reads, by the name of the stream."""
    import pyxdf

    path = tmp_path / "foreign.xdf"
    path.write_bytes(data)
    streams, _ = pyxdf.load_xdf(path, synchronize_clocks=False, dejitter_timestamps=False)
    return {stream["info"]["name"][0]: stream for stream in streams}


class TestSession:
    def test_values_labels_units_rate_and_markers(self, tmp_path: Path) -> None:
        data, x = session()
        theirs = foreign(data, tmp_path)
        assert (theirs["glove"]["time_series"] == x).all()
        back = read(data)
        assert back.labels == ["fx", "emg"]
        assert [c.unit for c in back] == ["mN", "uV"]
        assert [c.group for c in back] == ["glove", "glove"]
        assert [c.rate_exact for c in back] == [500, 500]
        assert [c.coverage for c in back] == [(Span(0, 1000),)] * 2
        for place, channel in enumerate(back):
            assert channel.counts.tolist() == theirs["glove"]["time_series"][:, place].tolist()
            assert channel.calibration == Calibration()
        assert [event.text for event in back.events] == ["begin", "slip ü"]
        assert [t[0] for t in theirs["markers"]["time_series"]] == ["begin", "slip ü"]

    def test_streams_of_two_computers_share_one_zero(self) -> None:
        """The stamps of the glove, 1000 s, are 99.75 s of the recorder. The first marker came at
        100 s, so tick 0 is 99.75 s."""
        data, _ = session()
        data = data.replace(struct.pack("<d", -900.25), struct.pack("<d", -900.125))
        back = read(data)
        assert back["fx"].start_tick == 0
        assert back.events == (
            Event(Fraction(1, 8), "begin", layer="markers"),
            Event(Fraction(7, 8), "slip ü", layer="markers"),
        )

    def test_an_event_may_come_first(self) -> None:
        """The first marker is 0.25 s before the glove, so tick 0 is there."""
        data, _ = session()
        back = read(data.replace(struct.pack("<d", -900.25), struct.pack("<d", -899.75)))
        assert back["fx"].coverage == (Span(125, 1125),)
        assert back.events[0] == Event(Fraction(0), "begin", layer="markers")

    def test_an_event_hours_before_is_left_out(self) -> None:
        data, _ = session()
        back = read(data.replace(struct.pack("<d", 100.0), struct.pack("<d", -9e4)))
        assert [event.text for event in back.events] == ["slip ü"]
        assert back.metadata["notes"] == [
            "1 event of stream 'markers': more than 3600 s before the first sample, not read"
        ]

    def test_both_clocks_are_observed(self) -> None:
        data, _ = session()
        seen = read(data).clocks
        own = [s for s in seen if s.clock == "lsl:glove-pc"]
        assert [(s.tick, s.time_ns) for s in own] == [
            (0, 1000 * 10**9), (500, 1001 * 10**9), (999, 1001_998_000_000)
        ]  # fmt: skip
        recorder = [s for s in seen if s.clock == "lsl"]
        assert [s.tick for s in recorder] == [100 * i for i in range(10)]
        assert recorder[0].time_ns == 99_750_000_000
        assert {s.channel for s in seen} == {0}

    def test_zipped(self, tmp_path: Path) -> None:
        data, _ = session()
        path = tmp_path / "a.xdfz"
        path.write_bytes(gzip.compress(data))
        back = read(path)
        assert [c.counts.tolist() for c in back] == [c.counts.tolist() for c in read(data)]
        path.write_bytes(gzip.compress(data)[:-30])
        with pytest.raises(ParameterError, match="this is no XDF file"):
            read(path)

    def test_a_bomb(self) -> None:
        bomb = b"XDF:" + struct.pack("<BQH", 8, 1 << 40, 5) + bytes(1 << 22)
        assert "the file ends within the chunk" in read(bomb).metadata["notes"][0]
        with pytest.raises(LimitError, match=r"the chunk at byte .* has 1099511627774 bytes"):
            read(bomb[:13] + b"\3\0" + bomb[15:])

    def test_a_packed_bomb(self, tmp_path: Path) -> None:
        path = tmp_path / "a.xdfz"
        path.write_bytes(
            gzip.compress(b"XDF:" + struct.pack("<BQH", 8, 1 << 40, 5) + bytes(1 << 26))
        )
        with pytest.raises(LimitError, match="the file unpacks to more than 200 times its size"):
            read(path)

    def test_select(self) -> None:
        data, _ = session()
        assert read(data, select="glove").events == ()
        assert read(data, select="mark*").channels == ()
        with pytest.raises(ParameterError, match="no stream is called 'x'; there are: 'glove', 'm"):
            read(data, select="x")

    def test_blocks_are_chunks(self) -> None:
        data, _ = session()
        with imported(data) as (_, found):
            assert [len(block.values[0]) for block in found.blocks()] == [100] * 10

    def test_original_stamps(self) -> None:
        data, _ = session()
        back = read(data, keep_stamps=True, select="glove")
        assert back.labels == ["fx", "emg", "stamp"]
        assert back["stamp"].unit == "ns"
        assert np.abs(back["stamp"].stored).max() <= 1

    def test_start_of_the_header(self) -> None:
        xml = b"<info><datetime>2021-06-01T13:20:05-0400</datetime></info>"
        data, _ = session()
        back = read(data.replace(START, chunk(1, xml)))
        assert back.epoch_ns == 1_622_568_005 * 10**9
        assert back.epoch_uncertainty_ns == 10**9


@given(
    st.sampled_from([*DTYPES]),
    st.integers(1, 3),
    st.lists(st.tuples(st.integers(0, 9), st.booleans()), min_size=1, max_size=6),
    st.integers(0, 99),
)
def test_any_chunks_are_read_as_pyxdf_reads_them(
    format: str, width: int, parts: list[tuple[int, bool]], seed: int
) -> None:
    """Values bit for bit, and stamps that are left out."""
    import pyxdf

    rng = np.random.default_rng(seed)
    out, row = b"XDF:" + START + header(1, "s", format, width, 100), 0
    for count, stamped in parts:
        raw = rng.bytes(count * width * np.dtype(DTYPES[format]).itemsize)
        x = np.frombuffer(raw, DTYPES[format]).reshape(count, width)
        given = rng.random(count) < 0.5 if stamped else np.zeros(count, bool)
        stamps = [5 + (row + i) / 100 if given[i] else None for i in range(count)]
        if not row and count:
            stamps[0] = 5.0
        out += samples(1, format, np.nan_to_num(x) if "i" not in format else x, stamps)
        row += count
    [theirs], _ = pyxdf.load_xdf(_file(out), synchronize_clocks=False, dejitter_timestamps=False)
    back = read(out, rate=100)
    ours = [channel.stored.tolist() for channel in back]
    series = np.asarray(theirs["time_series"])
    assert ours == ([column.tolist() for column in series.T] if row else [])
    if row:
        assert back[0].coverage == (Span(0, row),)
        assert np.allclose(theirs["time_stamps"], 5 + np.arange(row) / 100, atol=1e-9)


def _file(data: bytes) -> Any:
    """pyxdf takes a stream of the class that open() gives."""
    return io.BufferedReader(io.BytesIO(data))  # type: ignore[type-var]


def one(
    format: str, x: Any, stamps: Sequence[float | None], rate: float = 0, desc: str = ""
) -> bytes:
    width = len(x[0]) if len(x) else 1
    return (
        b"XDF:" + START + header(1, "s", format, width, rate, desc) + samples(1, format, x, stamps)
    )


class TestStreamsWithoutARate:
    def test_rows_become_events(self) -> None:
        data = one(
            "double64", [[0.5, 2], [1, 3]], [10.0, 10.3], desc=channels(("a", ""), ("b", ""))
        )
        back = read(data)
        assert back.channels == ()
        assert back.events == (
            Event(Fraction(0), '{"a": 0.5, "b": 2.0}', layer="s"),
            Event(Fraction(3, 10), '{"a": 1.0, "b": 3.0}', layer="s"),
        )

    def test_one_value_is_the_text(self) -> None:
        assert [e.text for e in read(one("int8", [[5], [-6]], [1.0, 2.5])).events] == ["5", "-6"]

    def test_a_given_rate_leaves_nominal_ones(self) -> None:
        data = b"XDF:" + START
        for number, (rate, times) in enumerate(
            [(100, np.arange(99) / 100), (50, np.arange(50) / 50), (0, [0, 0.013, 0.051, 0.3037])],
            start=1,
        ):
            data += header(number, f"s{number}", "int16", 1, rate)
            data += samples(number, "int16", [[i] for i in range(len(times))], list(times))
        found = read(data, rate=200)
        assert [c.rate_exact for c in found] == [100, 50, 200]
        with pytest.raises(ParameterError, match="have several rates"):
            read(data, rate=200, select=["s1", "s2"])
        assert read(data, rate=200, select="s2")[0].rate_exact == 200

    def test_a_rate_that_the_stamps_show(self) -> None:
        stamps = [10 + i / 50 for i in range(100)]
        back = read(one("float32", [[i] for i in range(100)], stamps))
        assert back["s"].rate_exact == 50
        assert back["s"].stored.dtype == np.float32

    def test_events_are_bounded(self) -> None:
        rng = np.random.default_rng(1)
        stamps = np.cumsum(rng.exponential(1, 3000)).tolist()
        data = one("int8", [[1]] * 3000, stamps)
        with pytest.raises(LimitError, match="its 3000 rows take too much as events"):
            read(data, max_memory=1 << 20)

    def test_events_of_all_streams_together_are_bounded(self) -> None:
        stamps = np.cumsum(np.random.default_rng(1).exponential(1, 900)).tolist()
        data = b"XDF:" + START
        for number in range(4):
            data += header(number, f"s{number}", "int8", 1, 0)
            data += samples(number, "int8", [[1]] * 900, stamps)
        assert len(read(data, max_memory=1 << 20, select="s0").events) == 900
        with pytest.raises(LimitError, match="stream 's3' has no rate"):
            read(data, max_memory=3 << 19)


class TestClocks:
    def test_lost_rows_are_a_gap(self) -> None:
        stamps = [10 + i / 100 for i in range(200) if not 80 <= i < 90]
        back = read(one("int16", [[i] for i in range(190)], stamps, rate=100))
        assert back["s"].coverage == (Span(0, 80), Span(90, 200))

    @pytest.mark.parametrize(("true", "jitter"), [(90, 0), (50, 2e-3), (102, 1e-4), (1000, 1e-4)])
    def test_a_nominal_rate_that_is_wrong(self, true: int, jitter: float) -> None:
        late = np.random.default_rng(0).exponential(1, 2000) * jitter
        stamps = (10 + np.arange(2000) / true + late).tolist()
        back = read(one("int16", [[i] for i in range(2000)], stamps, rate=100))
        assert abs(float(back["s"].rate_exact) / true - 1) < 1e-3
        assert back["s"].coverage == (Span(0, 2000),)
        said = f"the nominal rate is 100 Hz, the stamps come at {back['s'].rate_exact} Hz"
        assert back.metadata["notes"][0] == f"stream 's': {said}"

    def test_a_nominal_rate_decides_for_stamps_that_jitter_much(self) -> None:
        late = np.random.default_rng(0).uniform(0, 0.009, 40)
        stamps = (10 + np.arange(40) / 100 + late).tolist()
        back = read(one("int16", [[i] for i in range(40)], stamps, rate=100))
        assert back["s"].rate_exact == 100
        assert read(one("int16", [[i] for i in range(40)], stamps)).channels == ()

    def test_offsets_after_the_clock_was_set_back(self) -> None:
        first = [1000 + i / 100 for i in range(100)]
        second = [5 + i / 100 for i in range(100)]
        x = [[i] for i in range(100)]
        data = b"XDF:" + START + header(1, "s", "int16", 1, 100) + header(2, "m", "string", 1, 0)
        data += samples(1, "int16", x, first) + offset(1, 1000.5, -1000)
        data += samples(1, "int16", x, second) + offset(1, 5.5, 2)
        data += samples(2, "string", [["a"]], [0.25]) + samples(2, "string", [["b"]], [7.5])
        assert [e.time for e in read(data).events] == [Fraction(1, 4), Fraction(15, 2)]
        again = read(data, episode="1")
        assert [(c.clock, c.time_ns) for c in again.clocks if c.clock == "lsl"] == [
            ("lsl", 7_500_000_000)
        ]

    def test_a_clock_that_was_set_back(self) -> None:
        stamps = [1000 + i / 100 for i in range(200)] + [5 + i / 100 for i in range(150)]
        data = one("int16", [[i] for i in range(350)], stamps, rate=100)
        back = read(data)
        assert back["s"].counts.tolist() == list(range(200))
        assert back.metadata["notes"][0] == (
            "the clock of stream 's' was set back 1 time; the rows from there on are other "
            "recordings; episode 1 is the next"
        )
        assert read(data, episode=1)["s"].counts.tolist() == list(range(200, 350))
        with pytest.raises(ParameterError, match="no stream has an episode 2; the first one is 0"):
            read(data, episode=2)
        with pytest.raises(ParameterError, match="episode is a number from 0 on, not 'x'"):
            read(data, episode="x")


BAD = {
    "begins? with XDF:": b"XDF;" + START,
    "the chunk at byte 4 has no valid size": b"XDF:\2abc",
    "is shorter than its tag": b"XDF:\1\1\1\0",
    "an XML header is malformed": b"XDF:" + chunk(1, b"<info>"),
    "has declarations, which are not read": b"XDF:" + chunk(1, b"<!DOCTYPE x><info/>"),
    "stream 's' has the format 'complex'": b"XDF:" + header(1, "s", "complex", 1, 1),
    "stream 's' has '0' channels": b"XDF:" + header(1, "s", "int8", 0, 1),
    "stream 's' has '99999999' channels": b"XDF:" + header(1, "s", "int8", 99_999_999, 1),
    "stream 's': the nominal rate: 'nan'": b"XDF:" + header(1, "s", "int8", 1, float("nan")),
    "two streams have the number 1": b"XDF:" + header(1, "s", "int8", 1, 1) * 2,
    "samples of stream 1 come before its header": b"XDF:" + samples(1, "int8", [[1]], [1.0]),
    "shorter than its 200 rows": b"XDF:"
    + header(1, "s", "int8", 1, 1)
    + chunk(3, b"\1\0\0\0\1\xc8\0\1"),
    "neither a time stamp nor none": b"XDF:"
    + header(1, "s", "int8", 1, 1)
    + chunk(3, b"\1\0\0\0\1\1\7\1"),
    "a number without a valid size": b"XDF:"
    + header(1, "s", "int8", 1, 1)
    + chunk(3, b"\1\0\0\0\7\1\0\1"),
    "a time stamp that is infinite or too large": one("int8", [[1]], [float("inf")]),
    "a chunk ends within a text": b"XDF:"
    + header(1, "s", "string", 1, 0)
    + chunk(3, b"\1\0\0\0\1\1\0\1\x09ab"),
}


@pytest.mark.parametrize("message", BAD)
def test_refused(message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        read(BAD[message], format="xdf")


def test_damage() -> None:
    data, _ = session(200)
    for each in damaged(data):
        survives(each, "xdf")
    cut = read(data[:-10])
    assert "the file ends within the chunk" in cut.metadata["notes"][0]
    assert len(cut["fx"].counts) == 200


def test_command_line(tmp_path: Path) -> None:
    (tmp_path / "a.xdf").write_bytes(session()[0])
    shown = run("info", "a.xdf", cwd=tmp_path).stdout.decode()
    assert "XDF: 2 channels, 2 events" in shown
    assert "uV (from 'microvolts')" in shown
    assert run("encode", "a.xdf", "a.hapf", cwd=tmp_path).returncode == 0
    found, back = read(tmp_path / "a.xdf"), read(tmp_path / "a.hapf")
    assert [facts(c) for c in back] == [facts(c) for c in found]
    assert (back.events, back.clocks) == (found.events, found.clocks)
