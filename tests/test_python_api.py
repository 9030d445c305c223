"""Recordings and channels as people use them in Python: read, select, arrays, tables, write."""

from __future__ import annotations

import io
import re
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import hapfmt
from hapfmt import Calibration, Channel, Event, ParameterError, Recording, Span
from hapfmt.errors import (
    LimitError,
    MissingExtraError,
    MovedTimesWarning,
    UnknownChannelError,
)


def example() -> Recording:
    x = np.sin(np.arange(3000) / 100)
    gappy = x.copy()
    gappy[1000:1200] = np.nan
    return Recording(
        (
            Channel.from_physical(x, 1000, label="fx", unit="N"),
            Channel.from_physical(gappy, 1000, label="fy", unit="N", start_tick=5),
            Channel(np.arange(300), 100, calibration=Calibration(1, 0, 10), label="<b>t</b>"),
        ),
        epoch_ns=1_700_000_000 * 10**9,
        events=(Event(1, "touch", channel="fy"), Event(2, "all"), Event("0.5", "x", channel=0)),
    )


class TestChannel:
    def test_numpy_and_times(self):
        fy = example()["fy"]
        x, t = fy.to_numpy(), fy.times()
        assert x.shape == t.shape == (3000,) and x.dtype == t.dtype == np.float64
        assert t[0] == 0.005 and t[-1] == 3.004 and np.isnan(x[1000:1200]).all()
        assert np.array_equal(x[~np.isnan(x)], fy.samples())
        assert np.array_equal(np.asarray(fy), x, equal_nan=True)
        assert np.asarray(fy, dtype=np.float32).dtype == np.float32

    def test_times_are_the_nearest_doubles(self):
        channel = Channel(np.zeros(1000), "44100/7", (Span(123_456, 124_456),))
        exact = [float(Fraction(tick * 7, 44100)) for tick in range(123_456, 124_456)]
        assert channel.times().tolist() == exact

    def test_seconds(self):
        fx = example()["fx"]
        for start, stop in [(1, 2), (1.5, None), (None, 0.25), (2.5, 3)]:
            x, t = fx.to_numpy(start, stop), fx.times(start, stop)
            first, last = (0 if start is None else start), (99 if stop is None else stop)
            assert len(x) == len(t) and ((t >= first) & (t < last)).all()
            assert len(t) == ((fx.times() >= first) & (fx.times() < last)).sum()

    def test_rate_counts_and_samples(self):
        counts = example()[2]
        assert type(counts.rate) is float and counts.rate == 100
        assert type(counts.rate_exact) is Fraction and counts.rate_exact == 100
        assert counts.counts.dtype.kind == "i" and counts.samples()[7] == 0.7
        with pytest.raises(ParameterError, match="'fx' holds float64, not counts"):
            _ = example()["fx"].counts

    @pytest.mark.parametrize("rate", [1000, 1000.0, Fraction(1000), "1000", np.float32(1000)])
    def test_construction(self, rate):
        assert Channel(np.zeros(3), rate, label="x").rate_exact == 1000
        assert Channel(np.zeros(3), rate=rate).rate == 1000.0

    def test_a_rate_is_kept_by_replace(self):
        from dataclasses import replace

        third = Channel(np.zeros(3), Fraction(10, 3))
        assert replace(third, label="x").rate_exact == Fraction(10, 3)
        assert replace(third, rate=5).rate_exact == 5

    def test_no_rate(self):
        with pytest.raises(ParameterError, match="needs samples and a rate"):
            Channel(np.zeros(3))

    def test_gaps_that_take_too_much_memory(self):
        far = Channel(np.zeros(2), 1000, (Span(0, 1), Span(1 << 40, (1 << 40) + 1)))
        for call in (far.to_numpy, far.times, lambda: np.asarray(far), Recording((far,)).to_numpy):
            with pytest.raises(LimitError, match=r"samples\(\), which leaves the gaps out"):
                call()
        assert len(far.samples()) == 2 and len(far.to_numpy(0, 5)) == 5000

    def test_repr(self):
        for channel in example():
            lines = repr(channel).splitlines()
            assert 1 <= len(lines) <= 3 and all(len(line) < 200 for line in lines)
        assert "2800 samples at 1000 Hz" in repr(
            example()["fy"]
        ) and "to 3.005 s, 1 gap; unit N; float64" in repr(example()[1])


class TestRecording:
    def test_container(self):
        rec = example()
        assert len(rec) == 3 and rec.labels == ["fx", "fy", "<b>t</b>"]
        assert [channel.label for channel in rec] == rec.labels
        assert "fy" in rec and "fz" not in rec and rec["fy"] in rec and 1 not in rec
        assert rec["fy"] is rec[1] is rec[-2] is rec[np.int64(1)] is rec.channel("fy")

    @pytest.mark.parametrize("error", [KeyError, ParameterError, UnknownChannelError])
    def test_unknown_channels(self, error):
        rec = example()
        with pytest.raises(error, match="'FX'; did you mean 'fx'"):
            rec["FX"]
        with pytest.raises(error, match="there are: 'fx', 'fy', '<b>t</b>'"):
            rec["pressure"]
        with pytest.raises(error, match="no channel 3; there are 3, from 0"):
            rec[3]
        twice = Recording((rec[0], rec[0]))
        with pytest.raises(error, match="2 channels are called 'fx'; use their numbers: 0, 1"):
            twice["fx"]

    def test_other_keys(self):
        rec = example()
        assert rec[["fy", "fx"]].labels == ["fy", "fx"] and rec.sel("f?").labels == ["fx", "fy"]
        assert rec.sel("0").labels == rec.sel("-3").labels == ["fx"]
        stream = io.BytesIO()
        hapfmt.write(rec, stream)
        for names in ("f?", ["fx", 1], [0, -2], ["0", "-2"]):
            assert hapfmt.read(stream.getvalue(), names).labels == ["fx", "fy"]
        for names in ("f", ["nothing_*"], [-4]):
            with pytest.raises(UnknownChannelError):
                hapfmt.read(stream.getvalue(), names)
            with pytest.raises(UnknownChannelError):
                rec.sel(names)
        for names in (slice(1), {"fx"}):
            with pytest.raises(ParameterError, match="a list of them"):
                rec.sel(names)
            with pytest.raises(ParameterError, match="a list of them"):
                hapfmt.read(stream.getvalue(), names)
        for given in ({"a": np.zeros(3)}, [np.zeros(3)], Channel(np.zeros(3), 1), 3):
            with pytest.raises(ParameterError, match=r"a list of hapfmt\.Channel"):
                Recording(given)
        with pytest.raises(ParameterError, match=r"a list of hapfmt\.Event"):
            Recording(events=((1, "touch"),))
        assert Channel([1.0, 2.0], 5).samples().tolist() == [1, 2]

    def test_events_that_still_hold(self):
        rec = Recording(
            tuple(example()),
            events=(Event(0.5, "long", 1), Event(0.5, "over", 0.25), Event(1, "x")),
        )
        assert [event.text for event in rec.sel(start=1).events] == ["long", "x"]
        stream = io.BytesIO()
        hapfmt.write(rec, stream, cluster=Fraction(1, 4))
        with hapfmt.Reader(stream.getvalue()) as reader:
            assert [event.text for event in reader.events(start=1)] == ["long", "x"]
            assert [event.text for event in reader.events(1, 1.5)] == ["long", "x"]

    @pytest.mark.parametrize(
        ("start", "stop"),
        [(None, None), (None, 1), (0.5, 1), (0.75, 1), (0.8, 1.2), (1, None), (1.4, 1.5), (1.5, 3)],
    )
    @pytest.mark.parametrize("labels", [None, ["fy"]])
    def test_three_ways_to_select_find_the_same_events(self, start, stop, labels):
        rec = Recording(
            tuple(example()),
            events=(
                Event(0, "whole", 3),
                Event(0.5, "long", 1, layer="grip"),
                Event(0.5, "over", 0.25, channel=1, layer="grip"),
                Event(0.75, "other", 2, channel=0),
                Event(1, "mark", channel=1),
            ),
        )
        stream = io.BytesIO()
        hapfmt.write(rec, stream, cluster=Fraction(1, 4))
        selected = rec.sel(labels, start, stop).events
        assert sorted(selected, key=lambda e: e.time) == list(selected)
        with hapfmt.Reader(stream.getvalue()) as reader:
            assert reader.read(labels, start, stop).events == selected
            if labels is None:
                assert tuple(reader.events(start, stop)) == selected
            assert not reader.lost and not reader.findings
        assert hapfmt.read(stream.getvalue(), labels, start, stop).events == selected

    @pytest.mark.parametrize("wrong", [1.7e18, "2026-11-22", datetime(2026, 11, 22, tzinfo=UTC)])
    def test_an_epoch_is_an_integer(self, wrong):
        for name in ("epoch_ns", "epoch_uncertainty_ns"):
            advice = rf"{name} is an integer.*int\(t\.timestamp\(\) \* 1e9\)"
            with pytest.raises(ParameterError, match=advice):
                Recording(**{name: wrong})
        for far in (1 << 63, -(1 << 63) - 1):
            with pytest.raises(ParameterError, match=r"within 2\^63 nanoseconds"):
                Recording(epoch_ns=far)
        for far in (-1, 1 << 63):
            with pytest.raises(ParameterError, match=r"below 2\^63 ns"):
                Recording(epoch_ns=0, epoch_uncertainty_ns=far)
        assert type(Recording(epoch_ns=np.int64(7)).epoch_ns) is int
        t = datetime(2026, 11, 22, tzinfo=UTC)
        assert Recording(epoch_ns=int(t.timestamp() * 1e9)).epoch_ns == 1_795_305_600 * 10**9

    def test_an_empty_range(self):
        with pytest.raises(ParameterError, match="No samples in this time range"):
            example().sel(start=2, stop=1)

    def test_the_asked_window_is_filled_with_nan(self):
        short = Recording((Channel(np.ones(500), 1000, (Span(100, 600),)),))
        for x, t in (
            (short[0].to_numpy(0, 1), short[0].times(0, 1)),
            (short.to_numpy(0, 1)[0], short.times(0, 1)),
        ):
            assert len(x) == len(t) == 1000 and np.isnan(x).sum() == 500 and t[0] == 0
        assert len(short[0]) == len(short[0].to_numpy()) == 500

    @pytest.mark.parametrize(
        "rate", [1 / 0.003, 1000 / 3, 1 / np.diff(np.arange(9) * 0.003).mean()]
    )
    def test_rates_that_were_divided(self, rate):
        assert Channel(np.zeros(3), rate).rate_exact == Fraction(1000, 3)
        assert Channel(np.zeros(3), 1 / 3600.0).rate_exact == Fraction(1, 3600)
        assert Channel(np.zeros(3), 35.618).rate_exact == Fraction("35.618")
        assert Channel(np.zeros(3), str(rate)).rate_exact == Fraction(str(rate))

    def test_sel(self):
        part = example().sel(["fy", "fx"], start=1.0, stop=2)
        assert part.labels == ["fy", "fx"] and part["fx"].coverage == (Span(1000, 2000),)
        assert part["fy"].coverage == (Span(1000, 1005), Span(1205, 2000))
        assert part.epoch_ns == example().epoch_ns
        assert [(event.text, event.channel) for event in part.events] == [("touch", 0)]
        assert [event.text for event in example().sel("fx").events] == ["all", "x"]
        assert len(example().sel()) == 3 and example().sel(2).labels == ["<b>t</b>"]

    def test_to_numpy(self):
        rec = example().sel(["fx", "fy"])
        x, t = rec.to_numpy(), rec.times()
        assert x.shape == (2, 3005) and t.shape == (3005,)
        assert np.isnan(x[0, 3000:]).all() and np.isnan(x[1, :5]).all()
        assert x[0, 1500] == rec["fx"].samples()[1500]
        assert rec.to_numpy(1, 1.5).shape == (2, 500)
        with pytest.raises(ParameterError, match=r"2 rates.*such as rec.sel\(\['fx', 'fy'\]\)"):
            example().to_numpy()
        assert Recording().to_numpy().shape == (0, 0)

    def test_repr_is_short_for_any_recording(self):
        long = Channel(np.zeros(1), 1, label="x\n\x1b[31m" * 999, unit="y" * 99)
        for rec in (Recording(), example(), Recording((long,) * 500)):
            lines = repr(rec).splitlines()
            assert len(lines) <= 22 and all(len(line) < 160 for line in lines)
            assert "\x1b" not in repr(rec)
        assert "and 480 more" in repr(Recording((long,) * 500))

    def test_html_is_escaped(self):
        html = example()._repr_html_()
        assert "&lt;b&gt;t&lt;/b&gt;" in html and "<b>" not in html
        assert html.count("<tr>") == 4
        assert "and 400 more" in Recording((example()[0],) * 500)._repr_html_()


class TestKeywords:
    @pytest.mark.parametrize("name", ["fs", "sr", "sample_rate", "samplerate"])
    def test_other_names_of_a_rate(self, name, tmp_path):
        np.save(tmp_path / "x.npy", np.arange(9.0))
        for call in (
            partial(hapfmt.read, tmp_path / "x.npy"),
            partial(hapfmt.write, np.arange(9.0), tmp_path / "x.hapf"),
            partial(Recording.from_array, np.arange(9.0)),
            partial(Channel, np.arange(9.0)),
        ):
            with pytest.raises(ParameterError, match=f"no .* '{name}'; did you mean 'rate'"):
                call(**{name: 100})
            with pytest.raises(ParameterError, match=r"'transpos'|'calibratio'"):
                call(**{"calibratio" if call.func is Channel else "transpos": 100})

    def test_sel_takes_channels_as_read_does(self):
        assert example().sel(channels=["fy", "fx"]).labels == ["fy", "fx"]

    def test_an_error_without_a_unit_has_none(self, tmp_path):
        given = {"rate": 1000, "preset": "near-lossless", "max_error": "1%"}
        x = np.sin(np.arange(1000) / 50)
        summary = repr(hapfmt.write(x, tmp_path / "a.hapf", **given))
        assert re.search(r"largest error [\d.]+$", summary, re.M), summary
        summary = repr(hapfmt.write(x, tmp_path / "b.hapf", units="N", **given))
        assert re.search(r"largest error [\d.]+ N$", summary, re.M), summary


class TestTables:
    def test_pandas(self):
        pandas = pytest.importorskip("pandas")
        frame = example().sel(["fx", "fy"]).to_pandas()
        assert isinstance(frame, pandas.DataFrame) and list(frame.columns) == ["fx", "fy"]
        assert frame.index.name == "time" and frame.index[5] == 0.005 and frame.shape == (3005, 2)
        assert frame["fy"].isna().sum() == 205 and frame.attrs["units"] == {"fx": "N", "fy": "N"}
        with pytest.raises(ParameterError, match="select those of one rate"):
            example().to_pandas()

    def test_pandas_there_and_back(self, tmp_path):
        pytest.importorskip("pandas")
        rec = example().sel(["fx", "fy"])
        hapfmt.write(rec.to_pandas(), tmp_path / "a.hapf")
        back = hapfmt.read(tmp_path / "a.hapf")
        assert back.labels == rec.labels and back.epoch_ns == rec.epoch_ns
        for a, b in zip(rec, back, strict=True):
            assert (a.rate_exact, a.coverage, a.unit) == (b.rate_exact, b.coverage, b.unit)

    @pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin", "UTC+02:00"])
    def test_dates_come_back_in_their_zone(self, tmp_path, zone):
        """Across the change to summer time, and from a part."""
        pandas = pytest.importorskip("pandas")
        index = pandas.date_range("2024-03-31 00:59:59.5", periods=1500, freq="1ms", tz=zone)
        given = pandas.DataFrame({"x": np.arange(1500.0)}, index=index)
        hapfmt.write(given, tmp_path / "a.hapf")
        rec = hapfmt.read(tmp_path / "a.hapf")
        for found, wanted in (
            (rec.to_pandas(), given),
            (rec.sel(start=0.5, stop=1).to_pandas(), given.iloc[500:1000]),
        ):
            assert isinstance(found.index, pandas.DatetimeIndex)
            assert found.index.equals(wanted.index) and str(found.index.tz) == str(index.tz)
            assert np.array_equal(found["x"], wanted["x"])
        hapfmt.write(rec.to_pandas(), tmp_path / "b.hapf")
        assert hapfmt.read(tmp_path / "b.hapf").epoch_ns == rec.epoch_ns

    @pytest.mark.parametrize("zone", ["Nowhere/Else", "../../etc/passwd", "", 5, "UTC+99:99"])
    def test_a_zone_that_is_not_known_is_utc(self, zone):
        pandas = pytest.importorskip("pandas")
        x = Channel(np.arange(4.0), 10)
        index = Recording((x,), epoch_ns=10**18, metadata={"time_zone": zone}).to_pandas().index
        assert str(index.tz) == "UTC" and index[0] == pandas.Timestamp(10**18, tz="UTC")
        index = Recording((x,), metadata={"time_zone": zone}).to_pandas().index
        assert index.tolist() == [0, 0.1, 0.2, 0.3]  # without an epoch there are no dates

    def test_columns_differ_from_each_other_and_from_the_times(self):
        pytest.importorskip("pandas")
        x = Channel(np.arange(4.0), 10, label="time", unit="s")
        frame = Recording((x, replace(x, label="a", unit="N"), replace(x, label="a"))).to_pandas()
        assert [*frame] == ["time (2)", "a", "a (2)"]
        assert frame.attrs["units"] == {"time (2)": "s", "a": "N", "a (2)": "s"}
        assert [*frame.reset_index()] == ["time", "time (2)", "a", "a (2)"]
        back = Recording.from_array(frame)
        assert back.labels == [*frame] and [c.unit for c in back] == ["s", "N", "s"]

    def test_a_column_of_texts_is_to_be_left_out(self):
        pandas = pytest.importorskip("pandas")
        phase = pandas.Series(["reach", "hold"], dtype=object)
        frame = pandas.DataFrame({"x": [1.0, 2.0], "phase": phase})
        with pytest.raises(ParameterError, match=r"leave it out with .drop\(columns='phase'\)"):
            Recording.from_array(frame, rate=10)

    def test_dates_give_the_epoch(self):
        pandas = pytest.importorskip("pandas")
        index = pandas.date_range("2026-11-22T17:00:00", periods=10, freq="10ms")
        rec = Recording.from_array(pandas.DataFrame({"x": range(10)}, index=index))
        assert (rec.labels, rec[0].rate_exact) == (["x"], 100)
        assert rec.epoch_ns == 1_795_366_800 * 10**9
        with pytest.raises(ParameterError, match="holds no times; give a rate"):
            Recording.from_array(pandas.DataFrame({"x": range(10)}))

    def test_units_follow_their_columns(self):
        pandas = pytest.importorskip("pandas")
        index = pandas.Index(np.arange(5) / 10.0)
        frame = pandas.DataFrame({"a": range(5), "b": range(5)}, index=index)
        frame.attrs["units"] = {"a": "N", "b": "m"}
        assert [c.unit for c in Recording.from_array(frame[["b"]])] == ["m"]
        assert [c.unit for c in Recording.from_array(frame[["b", "a"]].assign(c=1))] == [
            "m", "N", "1",
        ]  # fmt: skip
        mine = Recording.from_array(frame, units={"b": "rad"}, labels=["b", "c"])
        assert [(c.label, c.unit) for c in mine] == [("b", "rad"), ("c", "1")]
        with pytest.raises(UnknownChannelError, match="did you mean"):
            Recording.from_array({"fx": [1, 2]}, 5, units={"Fx": "N"})
        with pytest.raises(ParameterError, match="not a set"):
            Recording.from_array(np.zeros((2, 5)), 5, units={"N", "m"})
        with pytest.raises(ParameterError, match="not a dict"):
            Recording.from_array(np.zeros((2, 5)), 5, labels={"a": 0, "b": 1})

    def test_names_of_columns_hold_units_as_in_a_csv_file(self, tmp_path):
        pandas = pytest.importorskip("pandas")
        rec = example().sel(["fx", "fy"])
        hapfmt.save(rec, tmp_path / "a.csv")
        frame = pandas.read_csv(tmp_path / "a.csv", index_col=0)
        assert list(frame.columns) == ["fx [N]", "fy [N]"]
        back = Recording.from_array(frame)
        assert [(c.label, c.unit, c.coverage) for c in back] == [
            (c.label, c.unit, c.coverage) for c in rec
        ]
        frame.columns = ["Fx (Nmm)", "Fx [mN]"]
        codes = [(c.label, c.unit) for c in Recording.from_array(frame)]
        assert codes == [("Fx", "N.mm"), ("Fx (2)", "mN")]

    def test_what_is_given_beside_the_names_of_columns(self):
        pandas = pytest.importorskip("pandas")
        frame = pandas.DataFrame({"fx [N]": [1.0, 2], "finger (left)": [3.0, 4]})

        def named(**given):
            return [(c.label, c.unit) for c in Recording.from_array(frame, 10, **given)]

        as_they_are = [("fx [N]", "m"), ("finger (left)", "1")]
        assert named() == [("fx", "N"), ("finger (left)", "1")]
        assert named(labels=["a", "b"]) == [("a", "N"), ("b", "1")]
        assert named(units={"fx [N]": "m"}) == as_they_are
        frame.attrs["units"] = {"fx [N]": "m"}
        assert named() == as_they_are

    def test_names_of_a_dict_give_units_too(self):
        rows = {"fx [N]": [1.0, 2], "finger (left)": [3.0, 4]}

        def named(**given):
            return [(c.label, c.unit) for c in Recording.from_array(rows, 10, **given)]

        assert named() == [("fx", "N"), ("finger (left)", "1")]
        assert named(labels=["a", "b"]) == [("a", "N"), ("b", "1")]
        assert named(units={"fx [N]": "m"}) == [("fx [N]", "m"), ("finger (left)", "1")]
        assert named(units="m") == [("fx [N]", "m"), ("finger (left)", "m")]

    def test_the_name_of_the_index_gives_its_unit(self):
        pandas = pytest.importorskip("pandas")
        frame = pandas.DataFrame({"x": range(4)}, index=[5.0, 10.0, 15.0, 20.0])
        rates = {"t [ms]": 200, "time_ms": 200, "t [s]": 0.2, "time": 0.2}
        for name, rate in rates.items():
            assert Recording.from_array(frame.rename_axis(index=name))[0].rate == rate

    @pytest.mark.parametrize("dtype", [None, object, "category", "string"])
    def test_a_column_of_texts_is_refused_with_advice_that_works(self, dtype, tmp_path):
        pandas = pytest.importorskip("pandas")
        phase = pandas.Series([None] + ["rest"] * 9 + ["press"] * 10, dtype=dtype)
        frame = pandas.DataFrame({"fx": np.arange(20.0), "phase": phase})
        frame.index = pandas.Index(np.arange(20) / 100, name="time")
        with pytest.raises(
            ParameterError, match=r"'phase' .* holds texts.*drop\(columns='phase'\)"
        ):
            hapfmt.write(frame, tmp_path / "a.hapf")
        assert Recording.from_array(frame.drop(columns="phase")).labels == ["fx"]
        frame.to_parquet(tmp_path / "a.parquet")
        events = hapfmt.read(tmp_path / "a.parquet").events
        assert [event.text for event in events] == ["rest", "press"]
        frame["phase"] = pandas.to_datetime(np.arange(20), unit="s")
        with pytest.raises(ParameterError, match="'phase' of the DataFrame holds times"):
            Recording.from_array(frame)

    def test_a_column_of_times_is_named(self):
        pandas = pytest.importorskip("pandas")
        frame = pandas.DataFrame({"t [s]": [0.0, 0.1], "x": [1.0, 2.0]})
        with pytest.raises(ParameterError, match=r"or use \.set_index\('t \[s\]'\)"):
            Recording.from_array(frame)
        assert [c.label for c in Recording.from_array(frame, 10)] == ["t", "x"]

    def test_the_index_places_the_rows(self):
        pandas = pytest.importorskip("pandas")
        frame = pandas.DataFrame({"x": range(4)}, index=[5.0, 5.1, 5.2, 5.4])
        for rate in (10, None):
            assert Recording.from_array(frame, rate)[0].coverage == (Span(50, 53), Span(54, 55))
        durations = frame.set_index(pandas.to_timedelta(frame.index, unit="s"))
        assert Recording.from_array(durations)[0].coverage == (Span(50, 53), Span(54, 55))
        dates = pandas.date_range("2026-11-22T17:00:00", periods=4, freq="10ms", tz="Asia/Tokyo")
        assert Recording.from_array(frame.set_index(dates)).epoch_ns == 1_795_334_400 * 10**9
        with pytest.raises(ParameterError, match="do not count its rows"):
            Recording.from_array(frame.set_index(pandas.Index([3, 4, 5, 6])), 10)
        assert Recording.from_array(frame.reset_index(drop=True), 10)[0].coverage == (Span(0, 4),)

    def test_a_row_that_is_out_of_order_is_named(self):
        pandas = pytest.importorskip("pandas")
        dates = pandas.date_range("2026-01-01", periods=6000, freq="1ms", tz="Asia/Tokyo")
        order = np.r_[:4174, 4173:6000]
        frame = pandas.DataFrame({"x": order}, index=dates[order])
        where = r"row 4174 \(2026-01-01 00:00:04.173000\+09:00\) is not later than the"
        with pytest.raises(ParameterError, match=where):
            Recording.from_array(frame)
        frame.index = order / 1000
        with pytest.raises(ParameterError, match=r"row 4174 \(4\.173\) is not later than the"):
            Recording.from_array(frame)

    @pytest.mark.parametrize(("first", "epoch_ns"), [(-1.0, None), (1.7e9, 1_700_000_000 * 10**9)])
    def test_moved_times_are_told(self, first, epoch_ns):
        pandas = pytest.importorskip("pandas")
        frame = pandas.DataFrame({"x": range(4)}, index=first + np.arange(4) / 8)
        with pytest.warns(MovedTimesWarning, match="became"):
            rec = Recording.from_array(frame)
        assert rec[0].start_tick == 0 and rec.epoch_ns == epoch_ns
        assert len(rec.metadata["notes"]) == 1

    def test_a_series_and_xarray(self):
        pandas = pytest.importorskip("pandas")
        series = pandas.Series([1.0, 2, 3], index=[0.5, 1.0, 1.5], name="grip")
        rec = Recording.from_array(series)
        assert rec.labels == ["grip"] and rec[0].rate_exact == 2 and rec[0].start_tick == 1
        pytest.importorskip("xarray")
        data = example().sel(["fx", "fy"]).to_xarray()
        back = Recording.from_array(data)
        assert back.labels == ["fx", "fy"] and [c.unit for c in back] == ["N", "N"]
        assert back.epoch_ns == example().epoch_ns and back["fy"].start_tick == 5
        assert Recording.from_array(data["fx"])["fx"].unit == "N"
        with pytest.raises(ParameterError, match="2 dimensions"):
            Recording.from_array(data.to_dataarray())

    @pytest.mark.parametrize("one", [example()["fx"], example().sel("fx")], ids=["channel", "all"])
    def test_as_numpy_wants_it(self, one):
        """numpy.asarray with a dtype, and with each of the three values of copy."""
        x = np.asarray(one)
        assert x.dtype == np.float64 and np.array_equal(x, one.to_numpy(), equal_nan=True)
        assert np.asarray(one, dtype=np.float32).dtype == np.float32
        assert np.array_equal(one.__array__(copy=True), x, equal_nan=True)
        assert one.__array__(np.float32, copy=None).dtype == np.float32
        with pytest.raises(ValueError, match="always a copy"):
            one.__array__(copy=False)
        assert np.nanmax(one) == np.nanmax(x)

    def test_other_byte_orders(self):
        for dtype in (">f8", ">i2", ">f4"):
            assert Recording.from_array(np.arange(3).astype(dtype), 5)[0].samples()[1] == 1
        for dtype in (object, np.longdouble):
            with pytest.raises(ParameterError, match=r"convert it|convert numbers"):
                Recording.from_array(np.arange(3).astype(dtype), 5)

    def test_xarray(self):
        pytest.importorskip("xarray")
        data = example().to_xarray()
        assert set(data.dims) == {"time_1000Hz", "time_100Hz"} and data["fx"].attrs["units"] == "N"
        assert data["fy"].shape == (3005,) and float(data["time_100Hz"][7]) == 0.07
        assert example().sel("fx").to_xarray()["fx"].dims == ("time",)
        twice = Recording((example()[0], example()[0])).to_xarray()
        assert list(twice) == ["fx", "fx (2)"]

    @pytest.mark.parametrize("package", ["pandas", "xarray"])
    def test_without_the_package(self, package, monkeypatch):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(MissingExtraError, match=rf"pip install 'hapfmt\[{package}\]'"):
            getattr(example().sel("fx"), f"to_{package}")()


class TestRead:
    @pytest.mark.parametrize("suffix", ["hapf", "npz", "npy", "csv", "wav"])
    def test_any_format_by_suffix_content_or_name(self, tmp_path, suffix):
        if suffix == "wav":
            pytest.importorskip("soundfile")
        rec = Recording((Channel.from_physical(np.arange(50.0), 100, label="ch1"),))
        path = tmp_path / f"a.{suffix}"
        hapfmt.write(rec, path) if suffix == "hapf" else hapfmt.save(rec, path)
        rate = {"rate": 100} if suffix == "npy" else {}
        bare = path.rename(tmp_path / "bare")
        data = bare.read_bytes()
        for found in (
            hapfmt.read(bare, **rate),
            hapfmt.read(data, **rate),
            hapfmt.read(io.BytesIO(data), **rate),
            hapfmt.read(io.BytesIO(data), format=suffix, **rate),
            hapfmt.read(Pipe(data), **rate),
        ):
            assert found[0].samples().tolist() == list(range(50)), suffix
        part = hapfmt.read(bare, channels=[0], start=0.1, stop=0.2, **rate)
        assert part[0].samples().tolist() == list(range(10, 20))

    def test_content_comes_before_the_suffix(self, tmp_path):
        hapfmt.write(np.arange(9), tmp_path / "a.hapf", rate=1)
        (tmp_path / "a.hapf").rename(tmp_path / "a.csv")
        assert len(hapfmt.read(tmp_path / "a.csv")) == 1

    def test_what_does_not_go_together(self, tmp_path):
        hapfmt.write(np.arange(9), tmp_path / "a.hapf", rate=1)
        with pytest.raises(ParameterError, match="holds its own rate"):
            hapfmt.read(tmp_path / "a.hapf", rate=5)
        with pytest.raises(ParameterError, match=r"a CSV file has no bands"):
            hapfmt.read(b"t,x\n0,1\n1,2\n", format="csv", band="lf")
        (tmp_path / "a.xls").write_bytes(b"\xd0\xcf\x11\xe0")
        with pytest.raises(ParameterError, match=r"'\.xls' is not one of"):
            hapfmt.read(tmp_path / "a.xls")

    @pytest.mark.parametrize("kind", ["array", "table", "list", "recording", "none"])
    def test_what_is_no_file(self, kind):
        given = {"array": np.zeros(3), "list": [1, 2], "recording": example(), "none": None}.get(
            kind
        )
        if kind == "table":
            given = pytest.importorskip("pandas").DataFrame({"x": [1.0, 2.0]})
        advice = r"hapfmt\.write writes an array or a table.*hapfmt\.Recording\.from_array"
        with pytest.raises(ParameterError, match=advice):
            hapfmt.read(given)

    def test_a_url(self):
        pytest.importorskip("fsspec")
        import fsspec

        with fsspec.open("memory://table.csv", "wb") as stream:
            stream.write(b"t,x\n0,1\n1,2\n")
        assert hapfmt.read("memory://table.csv")["x"].samples().tolist() == [1, 2]

    def test_load_warns(self):
        with pytest.warns(DeprecationWarning, match="use hapfmt.read"):
            assert len(hapfmt.load(io.BytesIO(b"x\n1\n"), format="csv", rate=1)) == 1


class Pipe(io.BytesIO):
    def seekable(self) -> bool:
        return False


class TestOldNames:
    def test_they_are_not_listed(self):
        import rlcompleter

        channel = example()["fx"]
        found = rlcompleter.Completer({"channel": channel}).attr_matches("channel.")
        listed = {name.removeprefix("channel.").rstrip("()") for name in found}
        for old in ("values", "physical", "dense"):
            assert old not in listed and old not in dir(channel) and old not in dir(Channel)
        assert {"counts", "samples", "filled", "to_numpy"} <= listed
        with pytest.raises(AttributeError, match="'Channel' object has no attribute 'value'"):
            _ = channel.value

    def test_they_warn(self):
        fx = example()["fx"]
        with pytest.warns(DeprecationWarning, match=r"channel\.values is deprecated"):
            assert fx.values is fx.stored
        with pytest.warns(DeprecationWarning, match=r"use channel\.samples\(\)"):
            assert np.array_equal(fx.physical(), fx.samples())
        with pytest.warns(DeprecationWarning, match=r"to_numpy"):
            assert np.array_equal(fx.dense(3, 9), fx.filled(3, 9))
        with pytest.warns(DeprecationWarning, match="stored="):
            assert Channel(values=np.zeros(2), rate=1).stored.size == 2


def written(data, **given) -> Recording:
    stream = io.BytesIO()
    hapfmt.write(data, stream, **given)
    return hapfmt.read(stream.getvalue())


class TestWrite:
    def test_an_array(self):
        x = np.stack([np.sin(np.arange(500) / 9), np.cos(np.arange(500) / 9)])
        x[1, 100:200] = np.nan
        back = written(x, rate=1000, labels=["fx", "fy"], units="N", preset="lossless")
        assert back.labels == ["fx", "fy"] and [c.unit for c in back] == ["N", "N"]
        assert np.array_equal(back.to_numpy(), x, equal_nan=True)

    def test_one_dimension(self):
        back = written(np.arange(7.0), rate="44100/7", labels="grip", units=["N"])
        assert back["grip"].rate_exact == 6300 and back["grip"].samples().tolist() == [*range(7)]
        assert written([1, 2, 3], rate=1).labels == ["ch1"]

    @pytest.mark.parametrize(
        "dtype", ["?", *("i1", "i2", "i4", "u1", "u2"), *("i8", "u4", "u8", "f2", "f4", "f8")]
    )
    def test_dtypes(self, dtype):
        x = np.array([0, 1, 1, 0, 1]).astype(dtype)
        found = Recording.from_array(x, 10)[0]
        assert found.is_counts == (dtype in ("?", "i1", "i2", "i4", "u1", "u2"))
        assert written(x, rate=10)[0].samples().tolist() == [0, 1, 1, 0, 1]

    def test_masked(self):
        x = np.ma.masked_equal(np.array([1, 2, 9, 4], np.int16), 9)
        found = Recording.from_array(x, 10)[0]
        assert found.coverage == (Span(0, 2), Span(3, 4)) and found.counts.tolist() == [1, 2, 4]

    def test_by_label_and_channels(self):
        back = written({"a": np.arange(5.0), "b": np.arange(9)}, rate={"a": 10, "b": 10})
        assert back.labels == ["a", "b"] and back["b"].stored.size == 9
        channels = list(example())
        assert written(channels).labels == example().labels
        assert written(channels[0]).labels == ["fx"]

    @pytest.mark.parametrize(
        ("data", "given", "message"),
        [
            (np.zeros((1000, 3)), {}, r"1000 x 3, .*pass array\.T, or transpose=True"),
            (np.zeros(5), {"rate": None}, "no rate; give one"),
            (np.zeros(5), {"rate": "1 kHz"}, "^rate is a number of samples.*, not '1 kHz'$"),
            (np.zeros(5), {"max_eror": 1}, "no option 'max_eror'; did you mean 'max_error'"),
            (np.zeros(5), {"unit": "N"}, "no option 'unit'; did you mean 'units'"),
            (np.zeros((2, 3, 4)), {}, "3 dimensions"),
            (np.zeros(()), {}, "0 dimensions"),
            (np.zeros(3, complex), {}, "complex128 values, not real"),
            (np.array(["a"]), {}, "not real numbers"),
            ([[1, 2], [3]], {}, "rows of different lengths"),
            (np.zeros((2, 9)), {"labels": ["a"]}, "labels are 2 texts"),
            (np.zeros((2, 9)), {"units": ["N"] * 3}, "units are 2 texts"),
            (np.zeros(9), {"transpose": True}, "nothing to transpose"),
            (np.zeros(9), {"colour": 3}, "colour"),
            (np.zeros(9), {"settings": hapfmt.Settings(), "preset": "lossless"}, "not both"),
        ],
    )
    def test_refused(self, data, given, message):
        with pytest.raises(ParameterError, match=message):
            hapfmt.write(data, io.BytesIO(), **{"rate": 10, **given})

    def test_a_recording_has_its_own_rate(self):
        with pytest.raises(ParameterError, match="rate is for arrays"):
            hapfmt.write(example(), io.BytesIO(), rate=10)

    def test_transposed_by_will(self):
        x = np.arange(3000.0).reshape(1000, 3)
        assert len(Recording.from_array(x, 10, transpose=True)) == 3
        assert len(Recording.from_array(x, 10, transpose=False)) == 1000
        assert len(Recording.from_array(x[:5], 10, labels=[*"abcde"])) == 5
        assert Recording.from_array(x.T, 10)[2].samples()[1] == 5

    @pytest.mark.parametrize("call", [hapfmt.write, hapfmt.save])
    @pytest.mark.parametrize("name", ["o.hapf", Path("o.hapf")])
    def test_the_name_before_the_recording(self, call, name):
        message = r"^'o\.hapf' names a file; the recording comes first, then the file$"
        with pytest.raises(ParameterError, match=message):
            call(name, np.zeros(3), rate=1)

    @pytest.mark.parametrize("suffix", ["h5", "npz", "csv", "flac", "json", "mcap"])
    def test_names_of_other_formats(self, tmp_path, suffix):
        path = tmp_path / f"o.{suffix}"
        with pytest.raises(ParameterError, match=r"hapf files end in \.hapf"):
            hapfmt.write(np.zeros(3), path, rate=1)
        assert not path.exists()

    def test_the_advice_on_another_format_works_as_it_reads(self, tmp_path):
        x = np.arange(12.0).reshape(2, 6)
        given = {"rate": 10, "labels": ["fx", "fy"], "units": "N"}
        with pytest.raises(ParameterError) as error:
            hapfmt.write(x, tmp_path / "o.csv", **given)
        (verb,) = re.findall(r"hapfmt\.(\w+) write", str(error.value))
        getattr(hapfmt, verb)(x, tmp_path / "o.csv", **given)
        back = hapfmt.read(tmp_path / "o.csv")
        assert back.labels == ["fx", "fy"] and [c.unit for c in back] == ["N", "N"]
        assert np.array_equal(back.to_numpy(), x) and back[0].rate_exact == 10
        with pytest.raises(ParameterError) as error:
            hapfmt.save(x, tmp_path / "o.hapf", **given)
        (call,) = re.findall(r"hapfmt\.write\(.*\)", str(error.value))
        eval(call.replace(")", ", **given)"), {"hapfmt": hapfmt, "recording": x, "given": given})
        assert hapfmt.read(tmp_path / "o.hapf").labels == ["fx", "fy"]
        with pytest.raises(ParameterError, match="rate is for arrays"):
            hapfmt.save(example(), tmp_path / "o.npz", rate=10)

    def test_save_takes_tables(self, tmp_path):
        pandas = pytest.importorskip("pandas")
        frame = pandas.DataFrame({"fx": [0.5, 1.5]}, index=[1.0, 1.5])
        hapfmt.save(frame, tmp_path / "o.npz", units={"fx": "N"})
        (back,) = hapfmt.read(tmp_path / "o.npz")
        assert (back.label, back.unit, back.start_tick) == ("fx", "N", 2)
        frame.index = [1.7e9, 1.7e9 + 0.5]
        with pytest.warns(MovedTimesWarning) as caught:
            hapfmt.save(frame, tmp_path / "p.npz")
            hapfmt.write(frame, tmp_path / "p.hapf")
        assert {one.filename for one in caught} == {__file__}


class TestReader:
    def test_repr_is_one_line(self, tmp_path):
        path = tmp_path / "a\x1b.hapf"
        hapfmt.write(example(), path, cluster=Fraction(1, 4))
        with hapfmt.Reader(path) as reader:
            assert repr(reader) == f"Reader {str(path)!r}: 3 channels, 3.005 s, closed"
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        with hapfmt.Reader(bytes(data)) as reader:
            reader.read()
            lost = len(reader.lost)
            assert reader.findings and lost
            assert re.fullmatch(
                r"Reader: 3 channels, 3\.005 s, closed, 1 damaged place, "
                rf"{lost} lost parts?",
                repr(reader),
            )
        with hapfmt.Reader(bytes(data[: len(data) // 2])) as reader:
            assert ", not closed, 1 damaged place" in repr(reader)


def test_the_examples_of_the_docstring(tmp_path, monkeypatch):
    """Five everyday tasks take one line each."""
    import doctest

    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).with_name("everyday.txt")
    failed, tried = doctest.testfile(str(page), module_relative=False)
    assert not failed and tried >= 5


def test_reading_loads_no_encoder():
    code = "import hapfmt, sys; hapfmt.read(b't,x\\n0,1\\n1,2\\n').sel('x').to_numpy();"
    code += "print(any(name.startswith('hapfmt.encoder') for name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_packages_are_attributes():
    code = "import hapfmt; print(hapfmt.edit.subset.__name__, hapfmt.scenes.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["subset", "hapfmt.lab.scenes"]
    assert "load" not in dir(hapfmt) and {"edit", "scenes", "Summary"} <= set(dir(hapfmt))


def test_a_summary_prints_a_line_for_each_channel(tmp_path):
    x = np.random.default_rng(0).normal(size=(23, 50))
    summary = hapfmt.write(x, tmp_path / "o.hapf", rate=1000, units="N", preset="near-lossless")
    lines = repr(summary).split("\n")
    assert lines[0] == f"Summary: {summary.file_size} bytes, 1150 samples"
    assert len(lines) == 22 and lines[-1].startswith("  ... and 3 more channels (")
    assert lines[1].startswith("  'ch1'   within 0.00427 N  ") and lines[1].endswith(" N")
