"""Parquet and Feather: files of pandas and pyarrow are read exactly, and ours by them."""

import contextlib
import io
import json
import struct
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pandas as pd
import polars
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import pytest
import strategies as s
from depth import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt import Event
from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.convert import imported, read, save
from hapfmt.convert.parquet_footer import column_chunks
from hapfmt.errors import HapfmtError, LimitError, MissingExtraError, ParameterError
from hapfmt.recording import Calibration, Channel, Recording, Span

pytestmark = pytest.mark.filterwarnings("ignore::hapfmt.errors.DataWarning")
FORMATS = ["parquet", "feather"]
NAN = float("nan")


def written(table: pa.Table, kind: str, **options) -> bytes:
    """By pyarrow."""
    stream = io.BytesIO()
    if kind == "parquet":
        pa.parquet.write_table(table, stream, **options)
    elif kind == "stream":
        with pa.ipc.new_stream(stream, table.schema) as writer:
            writer.write_table(table)
    else:
        pa.feather.write_feather(table, stream, **options)
    return stream.getvalue()


def facts(channel: Channel):
    """All that a file keeps of a channel, bit for bit."""
    return (
        channel.stored.tobytes(), channel.stored.dtype, channel.rate_exact, channel.coverage,
        channel.calibration, channel.label, channel.unit, channel.quantity, channel.axis,
        channel.group, channel.body_site, channel.device, channel.lsb,
    )  # fmt: skip


def values(channel: Channel) -> list[float]:
    return channel.filled(0, int(channel.duration * channel.rate_exact)).tolist()


@pytest.mark.parametrize("kind", FORMATS)
class TestForeign:
    def test_a_data_frame(self, kind, tmp_path):
        rng = np.random.default_rng(1)
        x, n = rng.normal(size=3000), rng.integers(-9, 9, 3000).astype(np.int16)
        frame = pd.DataFrame(
            {"fx [N]": x, "n": n, "phase": ["rest"] * 1000 + ["press"] * 2000},
            index=pd.Index(np.arange(3000) / 1000, name="time"),
        )
        path = tmp_path / f"a.{kind}"
        if kind == "parquet":
            frame.to_parquet(path)
        else:
            frame.reset_index().to_feather(path)
        found = read(path)
        assert found.labels == ["fx", "n"] and found["fx"].unit == "N"
        assert found["fx"].stored.tobytes() == x.tobytes()
        assert found["n"].counts.tolist() == n.tolist() and found["n"].rate_exact == 1000
        assert [(e.time, e.duration, e.text, e.layer) for e in found.events] == [
            (0, 1, "rest", "phase"),
            (1, 2, "press", "phase"),
        ]

    @pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
    def test_arrow_timestamps_and_durations(self, kind, unit):
        per = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
        steps = np.arange(200) * (per // 200 if unit != "s" else 1)
        stamps = 1_700_000_000 * per + steps
        table = pa.table(
            {"x": np.arange(200.0), "when": pa.array(stamps, pa.timestamp(unit, tz="UTC"))}
        )
        found = read(written(table, kind))
        assert found[0].rate_exact == (200 if unit != "s" else 1) and len(found) == 1
        assert found.epoch_ns == 1_700_000_000 * 10**9
        table = pa.table({"x": np.arange(200.0), "d": pa.array(steps, pa.duration(unit))})
        found = read(written(table, kind))
        assert found[0].rate_exact == (200 if unit != "s" else 1) and found.epoch_ns is None

    @pytest.mark.parametrize(
        ("name", "times", "rate", "start"),
        [
            ("t [ms]", np.arange(10) * 2 + 100, 500, 50),
            ("time_us", np.arange(10) * 250, 4000, 0),
            ("timestamp", np.arange(10) / 44100, 44100, 0),
            ("Time (s)", np.arange(10, dtype=np.float32) / 8, 8, 0),
            ("timestamp_ns", 1_700_000_000 * 10**9 + np.arange(10) * 10**6, 1000, 0),
            ("timestamp", 1_700_000_000 * 10**6 + np.arange(10) * 1000, 1000, 0),
        ],
    )
    def test_times_by_name(self, kind, name, times, rate, start):
        found = read(written(pa.table({name: times, "x": np.arange(10.0)}), kind))
        assert found.labels == ["x"]
        assert found[0].rate_exact == rate and found[0].start_tick == start
        assert (found.epoch_ns == 1_700_000_000 * 10**9) is bool(times[0] > 1e9)

    def test_lost_rows_are_a_gap(self, kind):
        ticks = np.delete(np.arange(1000), range(400, 430))
        table = pa.table({"time": ticks / 1000, "x": ticks.astype(float)})
        found = read(written(table, kind))
        assert found[0].coverage == (Span(0, 400), Span(430, 1000))
        assert found[0].stored.tolist() == ticks.tolist()

    @pytest.mark.parametrize(
        ("type_", "dtype", "low", "high"),
        [
            ("bool", "int32", 0, 1), ("int8", "int32", -128, 127), ("uint8", "int32", 0, 255),
            ("int16", "int32", -(2**15), 2**15 - 1), ("uint16", "int32", 0, 2**16 - 1),
            ("int32", "int32", -(2**31), 2**31 - 1), ("uint32", "uint64", 0, 2**32 - 1),
            ("int64", "int64", -(2**63), 2**63 - 1), ("uint64", "uint64", 0, 2**64 - 1),
            ("float16", "float16", -1.5, 65504), ("float32", "float32", -1.5, 2.0**100),
            ("float64", "float64", -0.0, 5e-324),
        ],
    )  # fmt: skip
    def test_every_type_of_number(self, kind, type_, dtype, low, high):
        ends = np.array([low, high, low], type_)
        array = pa.array(ends, pa.bool_() if type_ == "bool" else None)
        found = read(written(pa.table({"x": array}), kind), rate=10)[0]
        assert found.stored.dtype == dtype
        assert found.stored.tobytes() == ends.astype(dtype).tobytes()
        assert found.calibration == (Calibration() if dtype == "int32" else None)
        # A missing integer never becomes a double on its way.
        lacking = pa.array([ends[0].item(), None, ends[1].item()], array.type)
        found = read(written(pa.table({"x": lacking, "y": [1.0, 2.0, NAN]}), kind), rate=10)
        assert found["x"].stored.tobytes() == ends[:2].astype(dtype).tobytes()
        assert found["x"].coverage == (Span(0, 1), Span(2, 3))
        assert values(found["y"])[:2] == [1.0, 2.0] and found["y"].coverage == (Span(0, 2),)

    def test_lists_and_structures(self, kind):
        table = pa.table(
            {
                "f": pa.array([[1, 2, None], None, [3, 4, 5]], pa.list_(pa.float32(), 3)),
                "m": pa.array([[[1, 2], [3, 4]], [[5, 6], [7, 8]], None]),
                "w": pa.array([{"x": 1, "in": {"z": 2.5}}, None, {"x": 3, "in": None}]),
                "ragged": pa.array([[1], [1, 2], []], pa.list_(pa.int64())),
                "blob": pa.array([b"a", b"b", b"c"]),
            }
        )
        found = read(written(table, kind), rate=10)
        assert found.labels == ["f.0", "f.1", "f.2", "m.0.0", "m.0.1", "m.1.0", "m.1.1", "w.x",
                                "w.in.z"]  # fmt: skip
        assert [values(found[label]) for label in ("m.1.0", "w.in.z")] == [[3, 7], [2.5]]
        assert found["f.0"].coverage == (Span(0, 1), Span(2, 3)) == found["w.x"].coverage
        assert found["f.2"].stored.tolist() == [5]
        notes = found.metadata["notes"]
        assert "column 'blob' (binary) is not read" in notes
        assert any("'ragged'" in note for note in notes)

    def test_metadata_of_fields(self, kind):
        about = {"unit": "newtons", "label": "thumb", "axis": "x", "device": "ATI"}
        schema = pa.schema(
            [
                pa.field("a", pa.float64(), metadata=about),
                pa.field("c", pa.int16(), metadata={"scale_factor": "0.01", "add_offset": "-2.5"}),
            ],
            metadata={"sampling_rate": "44100/7"},
        )
        table = pa.table([[1.0, 2.0], [100, 250]], schema=schema)
        found = read(written(table, kind))
        assert facts(found[0])[2:] == (
            Fraction(6300), (Span(0, 2),), None, "thumb", "N", "", "x", "", "", "ATI", None,
        )  # fmt: skip
        assert found[1].calibration == Calibration(1, -250, 100)
        assert values(found[1]) == [-1.5, 0.0]
        assert found.metadata["source_units"] == {"thumb": "newtons"}

    def test_metadata_of_the_file(self, kind, tmp_path):
        table = pa.table({"x": [1.0, 2.0]})
        data = written(table.replace_schema_metadata({"subject": "S1", "fs": "50"}), kind)
        assert read(data).metadata == {"subject": "S1"} and read(data)[0].rate_exact == 50
        frame = pd.DataFrame({"x": [1.0, 2.0]})
        frame.attrs = {"subject": "S2", "trial": 4, "odd": NAN}
        frame.to_parquet(tmp_path / "a")
        data = written(pa.parquet.read_table(tmp_path / "a"), kind)
        assert read(data, rate=9).metadata == {"subject": "S2", "trial": 4}

    def test_polars(self, kind, tmp_path):
        rng = np.random.default_rng(4)
        x = rng.normal(size=4000)
        frame = polars.DataFrame(
            {
                "time": np.arange(4000) * 0.5e-3,
                "fx [N]": x,
                "n": polars.Series([None, *range(3999)], dtype=polars.UInt8, strict=False),
                "taxels": polars.Series(x.reshape(-1, 1) * [1, 2], dtype=polars.Array(float, 2)),
                "phase": polars.Series(["a", "b"] * 2000, dtype=polars.Categorical),
                "word": ["first"] * 2000 + [None] * 2000,
            }
        )
        path = tmp_path / f"a.{kind}"
        frame.write_parquet(path) if kind == "parquet" else frame.write_ipc(path)
        found = read(path)
        assert found.labels == ["fx", "n", "taxels.0", "taxels.1"]
        assert found["fx"].stored.tobytes() == x.tobytes() and found["fx"].rate_exact == 2000
        assert found["taxels.1"].stored.tobytes() == (x * 2).tobytes()
        assert found["n"].coverage == (Span(1, 257),)
        assert found["n"].counts.tolist() == list(range(256))
        assert [e.text for e in found.events] == [*["a", "b"] * 2000, "first"]

    def test_units_among_the_attributes_of_a_frame(self, kind, tmp_path):
        recording = Recording((Channel(np.arange(9.0), 100, label="f", unit="N"),), epoch_ns=5)
        frame = recording.to_pandas()
        path = tmp_path / "a.parquet"
        frame.to_parquet(path)
        if kind == "feather":
            path.write_bytes(written(pa.parquet.read_table(path), kind))
        found = read(path)
        assert facts(found[0]) == facts(recording[0]) and found.epoch_ns == 5

    def test_dictionaries_and_row_groups(self, kind):
        codes = pa.array(np.arange(5000) % 3).dictionary_encode()
        words = pa.array(["a", "b"] * 2500).dictionary_encode()
        options = {"row_group_size": 700} if kind == "parquet" else {"chunksize": 700}
        table = pa.table({"i": codes, "t": words, "x": np.arange(5000.0)})
        found = read(written(table, kind, **options), rate=10)
        assert found["i"].stored.tolist() == (np.arange(5000) % 3).tolist()
        assert found["x"].stored.tolist() == list(range(5000))
        assert [e.text for e in found.events] == ["a", "b"] * 2500

    def test_no_rows(self, kind):
        table = pa.table({"x": pa.array([], pa.int16()), "word": pa.array([], pa.string())})
        found = read(written(table, kind), rate=10)
        assert found.labels == ["x"] and not found[0].stored.size and not found.events

    def test_select_and_clock(self, kind):
        n = np.arange(100)
        table = pa.table(
            {
                "host": pa.array(1_700_000_000_000 + n * 10, pa.timestamp("ms")),
                "device_us": 77 + n * 10_000,
                "fx": n * 1.0, "fy": n * 2.0, "mode": ["a"] * 100,
            }
        )  # fmt: skip
        data = written(table, kind)
        found = read(data)
        assert found.labels == ["device_us", "fx", "fy"]
        assert found.metadata["notes"] == [
            "column 'device_us' is a channel; its name says that it may hold times"
        ]
        found = read(data, select="f*", clock="device_us")
        assert not found.metadata
        assert found.labels == ["fx", "fy"] and found[0].rate_exact == 100
        assert {c.clock for c in found.clocks} == {"host"}
        assert found.clocks[0] == ClockObservation("host", 0, 0, 1_700_000_000_000 * 10**6)
        for wrong in ({"select": "fz"}, {"clock": "mode"}):
            with pytest.raises(ParameterError, match=r"^no column 'fz'; |^no column of times"):
                read(data, **wrong)

    def test_stamps_are_kept(self, kind):
        rng = np.random.default_rng(2)
        ns = 1_700_000_000 * 10**9 + np.arange(500) * 10**6 + rng.integers(-90_000, 90_000, 500)
        table = pa.table({"t": pa.array(ns, pa.timestamp("ns")), "x": np.arange(500.0)})
        found = read(written(table, kind), keep_stamps=True)
        assert found.labels == ["x", "stamp"] and found[0].rate_exact == 1000
        ticks = np.arange(500) * 10**6
        assert (found["stamp"].stored + found.epoch_ns + ticks == ns).all()

    def test_rows_without_a_rate_become_events(self, kind):
        times = np.array([0.0, 0.71318, 3.14159, 3.27172, 9.90013])
        found = read(written(pa.table({"time": times, "key": [1, 2, 3, 4, 5]}), kind))
        assert len(found) == 0
        assert [(float(e.time), json.loads(e.text)) for e in found.events] == [
            (t, {"key": k + 1}) for k, t in enumerate(times)
        ]
        assert any("no rate" in note for note in found.metadata["notes"])

    @pytest.mark.parametrize("rate", [None, 500])
    @pytest.mark.parametrize("rows", [20, 1500])
    def test_times_that_start_again_are_refused(self, kind, rows, rate):
        """Two trials, each from 0 s on."""
        n = np.arange(rows)
        named = {"subject": ["a"] * rows + ["b"] * rows, "one": [1] * 2 * rows}
        table = {"t": np.r_[n, n] / 500, "f": np.r_[n, n] * 0.5}
        what = rf"column 't': the times start again after row {rows}"
        with pytest.raises(ParameterError, match=rf"{what}; 'subject' changes there\."):
            read(written(pa.table({"one": named["one"], **named, **table}), kind), rate=rate)
        with pytest.raises(ParameterError, match=rf"{what}\. The table holds several"):
            read(written(pa.table(table), kind), rate=rate)

    def test_dates_of_a_clock_that_was_set_back_are_noted(self, kind):
        ns = 1_700_000_000 * 10**9 + np.arange(2000) * 2_000_000
        ns[1000:] -= 3600 * 10**9
        found = read(
            written(pa.table({"t": pa.array(ns, pa.timestamp("ns")), "f": ns * 0.5}), kind)
        )
        assert found[0].coverage == (Span(0, 2000),)
        assert any("went back by 3600 s after row 1000" in n for n in found.metadata["notes"])

    @pytest.mark.parametrize("rate", [None, 500])
    def test_rows_out_of_order_are_refused(self, kind, rate):
        rows = np.random.default_rng(1).permutation(1000)
        table = pa.table({"t": rows / 500, "f": rows * 0.5})
        with pytest.raises(ParameterError, match=r"column 't': .* sort the table by this column"):
            read(written(table, kind), rate=rate)

    def test_no_rate(self, kind):
        with pytest.raises(ParameterError, match="holds no rate; give one"):
            read(written(pa.table({"x": [1.0]}), kind))
        with pytest.raises(ParameterError, match=r"integers without a unit; name it 't \[ms\]'"):
            read(written(pa.table({"t": [1, 2], "x": [1.0, 2.0]}), kind))

    def test_refused(self, kind):
        table = pa.table([[1.0], [2.0]], names=["x", "x"])
        with pytest.raises(ParameterError, match="several columns are called 'x'"):
            read(written(table, "stream" if kind == "feather" else kind), format=kind, rate=1)
        with pytest.raises(ParameterError, match="no column of numbers"):
            read(written(pa.table({"x": ["a"]}), kind), rate=1)
        times = pa.array([0.0, None, 2.0])
        with pytest.raises(ParameterError, match="'time', has empty cells"):
            read(written(pa.table({"time": times, "x": [1.0] * 3}), kind))


def test_a_stream_of_arrow(tmp_path):
    table = pa.table({"x": np.arange(5.0)})
    (tmp_path / "a.arrow").write_bytes(written(table, "stream"))
    assert read(tmp_path / "a.arrow", rate=5)[0].stored.tolist() == list(range(5))


# What we write


CLOCKS = (ClockObservation("pc", 0, 3, 10**18, 5), ClockObservation("pc", None, 0, 7))
RECORDING = Recording(
    (
        Channel(np.arange(6, dtype=np.int32) * 7, 1000, (Span(2, 5), Span(9, 12)),
                Calibration(3, -7, 1000), "fx", "N", "force", "x", "tip", "thumb", "ATI"),
        Channel(np.array([1, 2**63 - 1]), 1000, (Span(2, 4),), label="time", unit="ns"),
        Channel(np.array([0.1, -0.0, 5e-324]), 1000, label="fx", lsb=0.1),
        Channel(np.array([0.5, 2], np.float16), 1000, (Span(1 << 40, (1 << 40) + 2),)),
        Channel(np.empty(0), 1000, label="empty"),
    ),
    epoch_ns=1_700_000_000_000_000_001,
    epoch_uncertainty_ns=9,
    metadata={"subject": "S1", "nested": {"a": [1, None]}},
    events=(Event(Fraction(1, 3), "touch", Fraction(1, 7), 1, "marks"),),
    clocks=CLOCKS,
    clock_maps=(ClockMap("pc", 0, ((0, 5), (10, 99))),),
)  # fmt: skip


@pytest.mark.parametrize("kind", FORMATS)
class TestOurs:
    def test_everything_comes_back(self, kind, tmp_path):
        path = tmp_path / f"a.{kind}"
        notes = save(RECORDING, path)
        assert notes == ()
        found = read(path)
        expected = [replace(c, label=n) for c, n in zip(RECORDING, found.labels, strict=True)]
        assert found.labels == ["fx", "time", "fx (2)", "", "empty"]
        assert [*map(facts, found)][:4] == [*map(facts, expected)][:4]
        assert np.isnan(found["empty"].samples()).all()  # a row is a sample, or a gap beside others
        for name in ("epoch_ns", "epoch_uncertainty_ns", "events", "clocks", "clock_maps"):
            assert getattr(found, name) == getattr(RECORDING, name)
        assert {k: v for k, v in found.metadata.items() if k != "notes"} == RECORDING.metadata

    def test_others_see_plain_columns(self, kind, tmp_path):
        path = tmp_path / f"a.{kind}"
        save(RECORDING, path)
        table = (pa.parquet if kind == "parquet" else pa.feather).read_table(path)
        assert table.column_names == ["time", "fx", "time (2)", "fx (2)", "ch4", "empty"]
        frame = table.to_pandas().set_index("time")
        seconds = RECORDING["empty"].rate * 0 + np.array([*range(5), *range(9, 12)]) / 1000
        assert frame.index[:8].tolist() == seconds.tolist()
        assert frame.index[-1] == ((1 << 40) + 1) / 1000 and len(frame) == 10
        physical = RECORDING[0].calibration.physical(RECORDING[0].counts)
        assert frame["fx"].dropna().tolist() == physical.tolist()
        assert table.schema.field("fx").metadata[b"unit"] == b"N"
        assert table.schema.field("time").metadata == {b"unit": b"s"}
        assert table.schema.metadata[b"rate_hz"] == b"1000.0"
        seen = polars.read_parquet(path) if kind == "parquet" else polars.read_ipc(path)
        assert seen["fx"].drop_nulls().to_list() == physical.tolist()
        assert seen["time"].to_list() == frame.index.tolist()
        assert seen["time (2)"].drop_nulls().to_list() == [1, 2**63 - 1]

    @settings(max_examples=examples(60), deadline=None)
    @given(s.recordings().flatmap(s.clocked))
    def test_any_recording_comes_back(self, kind, recording):
        rates = {channel.rate_exact for channel in recording}
        assume(recording.channels)
        if len(rates) > 1:
            with pytest.raises(ParameterError, match="holds one rate"):
                save(recording, io.BytesIO(), format=kind)
            recording = recording.sel(
                [i for i, c in enumerate(recording) if c.rate_exact == recording[0].rate_exact]
            )
        stream = io.BytesIO()
        save(recording, stream, format=kind)
        found = read(stream.getvalue())
        for mine, theirs in zip(recording, found, strict=True):
            if mine.stored.size or not theirs.stored.size:
                assert facts(replace(mine, label=theirs.label)) == facts(theirs)
            else:  # rows beside others, none with a number
                assert np.isnan(theirs.samples()).all()
        assert found.events == recording.events and found.clocks == recording.clocks
        assert found.clock_maps == recording.clock_maps
        assert (found.epoch_ns, found.epoch_uncertainty_ns) == (
            recording.epoch_ns, recording.epoch_uncertainty_ns,
        )  # fmt: skip

    def test_counts_that_no_double_tells_stay_counts(self, kind):
        far = Channel(np.array([2**31 - 1, -(2**31)]), 10, calibration=Calibration(2**21 - 1, 1, 3),
                      label="far")  # fmt: skip
        notes = save(Recording((far,)), stream := io.BytesIO(), format=kind)
        assert any("column 'far' holds counts" in note for note in notes) or not notes
        assert facts(read(stream.getvalue())[0]) == facts(far)

    def test_doubles_behind_a_grid_come_back_as_doubles(self, kind):
        x = np.array([0.1, 0.2, 0.30000000000000004])
        near = Channel(np.array([1, 2, 3]), 10, calibration=Calibration(1, 0, 10), exact=x)
        notes = save(Recording((near,)), stream := io.BytesIO(), format=kind)
        assert any("grids of floating-point channels" in note for note in notes)
        assert read(stream.getvalue())[0].stored.tobytes() == x.tobytes()

    def test_what_was_changed_is_found(self, kind):
        save(RECORDING.sel([0]), stream := io.BytesIO(), format=kind)
        reader = pa.parquet if kind == "parquet" else pa.feather
        table = reader.read_table(io.BytesIO(stream.getvalue()))
        for name, array, message in [
            ("fx", pa.array([0.1] * 6), "calibration does not give"),
            ("time", pa.array(np.arange(6) / 1001.5), "not ticks of 1000 Hz"),
            ("time", pa.array(np.arange(6, 0, -1) / 1000), "not ticks of 1000 Hz"),
        ]:
            place = table.column_names.index(name)
            changed = table.set_column(place, table.schema.field(name), array)
            with pytest.raises(ParameterError, match=message):
                read(written(changed, kind))

    @pytest.mark.parametrize(
        "text",
        ["5", "{", "[" * 100_000, '{"version": 2}', '{"version": 1}',
         '{"version": 1, "rate": "1e9999999"}', '{"version": 1, "rate": "10", "events": [5]}',
         '{"version": 1, "rate": "10", "clocks": {"a": 1}}',
         '{"version": 1, "rate": "10", "epoch_ns": "x"}',
         '{"version": 1, "rate": "10", "events": 7}'],
    )  # fmt: skip
    def test_wrong_metadata_of_ours(self, kind, text):
        table = pa.table({"x": [1.0]}).replace_schema_metadata({"hapfmt": text})
        with pytest.raises(ParameterError):
            read(written(table, kind))

    @pytest.mark.parametrize(
        "text",
        ['{"dtype": "O"}', '{"dtype": "float64", "calibration": [1, 0, 1]}', '{"dtype": "<i4"}',
         '{"dtype": "int32", "calibration": [0, 0, 1]}', '{"lsb": "x"}', '{"dtype": "V9"}',
         '{"dtype": "int32", "calibration": 5}', "[]"],
    )  # fmt: skip
    def test_wrong_metadata_of_a_field(self, kind, text):
        schema = pa.schema([pa.field("x", pa.float64(), metadata={"hapfmt": text})])
        with pytest.raises(ParameterError, match=r"metadata of column 'x'|calibration needs"):
            read(written(pa.table([[1.0]], schema=schema), kind), rate=1)


# Untrusted files


@pytest.mark.parametrize("kind", FORMATS)
class TestHostile:
    def test_any_damage_gives_a_recording_or_our_error(self, kind):
        save(RECORDING, stream := io.BytesIO(), format=kind)
        nested = written(
            pa.table({"l": [[1.0, 2.0]] * 9, "t": ["a", "b", None] * 3, "i": [1, None, 3] * 3}),
            kind,
        )
        rng = np.random.default_rng(3)
        for whole in (stream.getvalue(), nested):
            damaged = [whole[:size] for size in range(0, len(whole), max(1, len(whole) // 20))]
            for _ in range(60):
                at = int(rng.integers(len(whole)))
                changed = bytes(rng.integers(0, 256, int(rng.integers(0, 3)), dtype=np.uint8))
                damaged.append(whole[:at] + changed + whole[at + 1 :])
            for data in damaged:
                try:
                    read(data, format=kind, rate=100, limits=hapfmt.Limits(memory=1 << 22))
                except HapfmtError as error:
                    assert str(error)

    def test_every_cut_is_found(self, kind):
        save(RECORDING, stream := io.BytesIO(), format=kind)
        whole = stream.getvalue()
        for size in range(0, len(whole), 97):
            with pytest.raises(ParameterError, match=r"truncated|not a[n]? (Parquet|Arrow) file"):
                read(whole[:size], format=kind)

    @pytest.mark.capped
    def test_bombs(self, kind):
        zeros = pa.table({"x": pa.array(np.zeros(3_000_000))})
        options = {"chunksize": 3_000_000} if kind == "feather" else {"use_dictionary": False}
        data = written(zeros, kind, compression="zstd", **options)
        assert len(data) < 100_000
        with pytest.raises(LimitError, match="more than the 1000000 allowed"):
            read(data, rate=1, limits=hapfmt.Limits(memory=1_000_000))
        with pytest.raises(LimitError, match="more than the 1000000 allowed"), imported(
            io.BytesIO(data), format=kind, rate=1, limits=hapfmt.Limits(memory=1_000_000)
        ) as (_, found):  # fmt: skip
            for _ in found.blocks():
                pass

    def test_deep_nesting(self, kind):
        deep = pa.array([1.0])
        for level in range(50):
            deep = (
                pa.StructArray.from_arrays([deep], names=["a"])
                if level % 2
                else pa.FixedSizeListArray.from_arrays(deep, 1)
            )
        data = written(pa.table({"deep": deep, "x": [1.0]}), kind)
        found = read(data, rate=1)
        assert found.labels == ["x"] and "'deep" in found.metadata["notes"][0]

    def test_notes_in_place_of_other_types(self, kind):
        import decimal

        table = pa.table(
            {"x": [1.0], "d": [decimal.Decimal("1.5")], "m": pa.array([[("a", 1)]],
             pa.map_(pa.string(), pa.int64())), "n": pa.nulls(1)}
        )  # fmt: skip
        found = read(written(table, kind), rate=1)
        assert found.labels == ["x"] and len(found.metadata["notes"]) == 3

    def test_without_pyarrow(self, kind, monkeypatch):
        data = written(pa.table({"x": [1.0]}), kind)
        monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[arrow\]"):
            read(data, rate=1)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[arrow\]"):
            save(RECORDING, io.BytesIO(), format=kind)


def test_wrong_footers():
    data = written(pa.table({"x": [1.0]}), "parquet")
    for length in (len(data), 1 << 31, 0):
        wrong = data[:-8] + struct.pack("<I", length) + b"PAR1"
        with pytest.raises(ParameterError):
            read(wrong, rate=1)
    with pytest.raises(ParameterError, match="encrypted"):
        read(b"PARE" + data[4:], format="parquet", rate=1)
    with pytest.raises(ParameterError, match="version 1 is not read"):
        read(b"FEA1" + bytes(100), rate=1)
    for bad in (1 << 40, -1):
        # The number of rows of the first record batch.
        arrow = bytearray(written(pa.table({"x": np.arange(7777.0)}), "feather"))
        at = arrow.index(struct.pack("<q", 7777))
        arrow[at : at + 8] = struct.pack("<q", bad)
        with pytest.raises(ParameterError, match="declares"):
            read(bytes(arrow), rate=1)


def test_statistics_that_contradict_the_schema():
    """pyarrow ends the process where these numbers are asked for."""
    data = written(pa.table({"x": [1.0, 2.0, 3.0]}), "parquet")
    optional, required = b"\x25\x02\x18\x01x", b"\x25\x00\x18\x01x"
    assert data.count(optional) == 1
    with pytest.raises(ParameterError, match="Definition level histogram"):
        read(data.replace(optional, required), rate=1)


@pytest.mark.parametrize("size", [1, 5])
def test_the_footer_is_read_as_pyarrow_reads_it(size):
    lacking = pa.array([1, None, 3] * size, pa.int64())
    table = pa.table(
        {"x": lacking, "t": pa.array(["a"] * 3 * size), "n": [{"a": [1.5]}] * 3 * size}
    )
    data = written(table, "parquet", row_group_size=2, write_page_index=True)
    length = int.from_bytes(data[-8:-4], "little")
    found = column_chunks(data[-8 - length : -8])
    about = pa.parquet.read_metadata(io.BytesIO(data))
    assert len(found) == about.num_row_groups
    for number, group in enumerate(found):
        known = [about.row_group(number).column(i) for i in range(about.num_columns)]
        assert group == [(c.total_uncompressed_size, c.statistics.null_count) for c in known]


@given(st.binary(max_size=60))
def test_any_footer_is_read_or_refused(data):
    with contextlib.suppress(ParameterError):
        column_chunks(data)


def test_names_that_are_not_utf8():
    for kind in FORMATS:
        table = pa.table({"name_1": [1.0], "deep": [{"name_2": [1.0]}]})
        for name in (b"name_1", b"name_2"):
            data = written(table, kind).replace(name, name[:4] + b"\xff\xff")
            with pytest.raises(ParameterError, match=r"not a.? \w+ file|cannot be read"):
                read(data, format=kind, rate=1)


def test_memory_is_bounded():
    table = pa.table({"time": np.arange(10_000) / 1000, "x": np.arange(10_000.0)})
    for kind in FORMATS:
        with pytest.raises(LimitError, match="max_memory="):
            read(written(table, kind, compression="zstd"), limits=hapfmt.Limits(memory=50_000))
