"""xarray: a dataset that is read on demand has the values, times and texts of the recording."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
import time
import zipfile
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import hostile
import numpy as np
import pytest
import strategies
from depth import examples, sample
from hypothesis import given, settings
from hypothesis import strategies as st
from server import serving
from spec import ROOT

import hapfmt
import hapfmt.analysis.files
from hapfmt import ClockMap, ClockObservation, Event, Recording
from hapfmt.errors import HapfmtError, LimitError, ParameterError

xr = pytest.importorskip("xarray", reason="needs the extra 'xarray'")
pd = pytest.importorskip("pandas")
datasets = pytest.importorskip("hapfmt.datasets")
backend = pytest.importorskip("hapfmt.analysis.backend")

VECTORS = ROOT / "conformance" / "vectors"
VALID = [
    *sorted((VECTORS / "valid").glob("*.hapf")),
    *sorted((VECTORS / "uncommon").glob("*.hapf")),
    VECTORS / "limits" / "tick-2-to-48-of-years.hapf",
]
ALWAYS = [path for path in VALID if path.stem.startswith(("bands-", "last-tick", "tick-2-to-48"))]
INVALID = sorted((VECTORS / "invalid").glob("*.hapf"))


def two_rates() -> Recording:
    force = np.sin(np.arange(5000) / 90)
    force[1200:1300] = np.nan
    made = Recording.from_array(
        {"fx": force, "x": np.arange(1250.0)}, {"fx": 1000, "x": 250}, units={"fx": "N", "x": "mm"}
    )
    fx = replace(made["fx"], quantity="force", axis="x", device="probe")
    return replace(
        made,
        channels=(fx, made["x"]),
        epoch_ns=1_700_000_000 * 10**9,
        metadata={"subject": "S7"},
        events=(Event(0.5, "contact", Fraction(1, 4), 1, "hand"), Event(1, "end")),
        clock_maps=(ClockMap("pc", 0, ((0, 10**18), (4000, 10**18 + 4 * 10**9 + 160_000))),),
    )


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("xarray") / "two.hapf"
    hapfmt.write(two_rates(), path)
    return str(path)


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("law") / "any.hapf"


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Five minutes, in clusters of seconds; chunks of Dask are of 2^16 ticks."""
    pytest.importorskip("dask", reason="needs the extra 'dask'")
    path = tmp_path_factory.mktemp("dask") / "long.hapf"
    x = (np.arange(300_000) % 1000).astype(np.int16)
    rates = {"x": 1000, "y": 1}
    hapfmt.write({"x": x, "y": x[:300]}, path, hapfmt.Settings(cluster=1), rate=rates)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hapfmt.analysis.files, "CHUNK_TICKS", 1 << 16)
        yield path


class TestDataset:
    def test_it_is_the_dataset_of_the_recording(self, file):
        with xr.open_dataset(file) as lazy:
            assert lazy.load().identical(hapfmt.read(file).to_xarray())

    def test_names_and_attributes(self, file):
        with xr.open_dataset(file) as data:
            assert dict(data.sizes) == {"time_1000Hz": 5000, "time_250Hz": 1250}
            assert data.attrs["Conventions"].startswith("CF-")
            assert data.attrs["epoch_ns"] == 1_700_000_000 * 10**9
            fx = data["fx"].attrs
            assert fx["units"] == "N" and fx["long_name"] == "fx" and fx["rate"] == 1000.0
            assert (fx["quantity"], fx["channel_axis"], fx["device"]) == ("force", "x", "probe")
            assert fx["calibration"].startswith("(count * ")
            assert data["time_250Hz"].attrs["units"] == "s"

    def test_nothing_is_read_before_it_is_needed(self, file, monkeypatch):
        decoded = []
        decode = hapfmt.Reader.assembly
        monkeypatch.setattr(
            hapfmt.Reader, "assembly", lambda *a, **k: decoded.append(a) or decode(*a, **k)
        )
        with xr.open_dataset(file) as data:
            part = data["fx"].sel(time_1000Hz=slice(1, 2))
            repr(data), part.shape, data.nbytes
            assert not decoded
            assert part.values.shape == (1001,) and len(decoded) == 1

    def test_groups(self, file):
        with xr.open_dataset(file, group="250Hz") as data:
            assert list(data) == ["x"] and data["x"].dims == ("time",)
        with xr.open_dataset(file, group="events") as events:
            assert events["text"].values.tolist() == ["contact", "end"]
            assert events["time"].values.tolist() == [0.5, 1.0]
            assert events["duration"].values.tolist() == [0.25, 0.0]
            assert events["channel"].values.tolist() == ["x", ""]
            assert events["layer"].values.tolist() == ["hand", ""]
        with pytest.raises(ParameterError, match="250Hz"):
            xr.open_dataset(file, group="25Hz")

    def test_a_tree(self, file):
        with xr.open_datatree(file) as tree:
            assert set(tree.children) == {"1000Hz", "250Hz", "events"}
            with xr.open_dataset(file, group="1000Hz") as group:
                assert tree["1000Hz"].to_dataset().identical(group)

    def test_channels_that_are_left_out(self, file):
        with xr.open_dataset(file, drop_variables="fx") as data:
            assert list(data) == ["x"] and data["x"].dims == ("time",)

    def test_clocks_are_coordinates(self, file):
        map_ = two_rates().clock_maps[0]
        with xr.open_dataset(file, group="1000Hz") as data:
            pc = data["pc"]
            assert pc.dtype == np.int64 and pc.attrs["units"] == "ns"
            assert pc.values.tolist() == [map_.time_ns(k) for k in range(5000)]
            assert int(pc[4321]) == map_.time_ns(4321)
        with xr.open_dataset(file, clocks=False) as data:
            assert set(data.coords) == {"time_1000Hz", "time_250Hz"}

    def test_it_can_be_written_again(self, file, tmp_path):
        with xr.open_dataset(file) as data:
            hapfmt.write(data, tmp_path / "b.hapf")
        back = hapfmt.read(tmp_path / "b.hapf")
        was = hapfmt.read(file)
        assert back.labels == was.labels and [c.unit for c in back] == [c.unit for c in was]
        for a, b in zip(was, back, strict=True):
            assert np.array_equal(a.to_numpy(), b.to_numpy(), equal_nan=True)

    def test_labels_that_are_names_of_times(self, tmp_path):
        """Names are the same in all groups; the label is an attribute."""
        x = np.arange(10.0)
        hapfmt.write({"time": x, "b": x}, tmp_path / "one.hapf", rate=10)
        with xr.open_dataset(tmp_path / "one.hapf") as data:
            assert [*data] == ["time (2)", "b"] and data["b"].dims == ("time",)
            assert data["time (2)"].attrs["long_name"] == "time"
            assert data["time (2)"].values.tolist() == x.tolist()
            assert data.load().identical(hapfmt.read(tmp_path / "one.hapf").to_xarray())
        labels = ["time_10Hz", "time", "time_5Hz", "time_5_1Hz", " ", ""]
        channels = [
            hapfmt.Channel(x, 5 if number % 2 else 10, label=label)
            for number, label in enumerate(labels)
        ]
        hapfmt.write(Recording(tuple(channels)), tmp_path / "two.hapf")
        names = ["time_10Hz (2)", "time (2)", "time_5Hz (2)", "time_5_1Hz (2)", "ch5", "ch6"]
        with xr.open_dataset(tmp_path / "two.hapf") as data:
            assert [*data] == names and data.sizes == {"time_10Hz": 10, "time_5Hz": 10}
            assert data.load().identical(hapfmt.read(tmp_path / "two.hapf").to_xarray())
        with xr.open_datatree(tmp_path / "two.hapf") as tree:
            assert [*tree["10Hz"].data_vars, *tree["5Hz"].data_vars] == names[::2] + names[1::2]

    def test_a_tree_of_labels_with_slashes(self, tmp_path):
        """As topics of ROS have. A tree of xarray has none in names."""
        path = tmp_path / "a.hapf"
        channels = [
            hapfmt.Channel(np.arange(4.0), 10, label=label) for label in ("/a/x", "_a_x", "b")
        ]
        map_ = ClockMap("header/stamp", 0, ((0, 10**18), (4, 10**18 + 4 * 10**8)))
        event = Event(0, "tap", channel=0)
        hapfmt.write(Recording(tuple(channels), clock_maps=(map_,), events=(event,)), path)
        with xr.open_datatree(path) as tree:
            group = tree["10Hz"].to_dataset()
            assert [*group] == ["_a_x", "_a_x (2)", "b"] and "header_stamp" in group.coords
            assert group["_a_x"].attrs["long_name"] == "/a/x"
            assert tree["events"]["channel"].values.tolist() == ["_a_x"]
        with xr.open_dataset(path) as data:
            assert [*data] == ["/a/x", "_a_x", "b"] and "header/stamp" in data.coords

    @pytest.mark.parametrize("value", [True, False])
    @pytest.mark.parametrize(
        "keyword",
        ["mask_and_scale", "decode_times", "decode_timedelta", "use_cftime", "concat_characters",
         "decode_coords", "decode_cf"],
    )  # fmt: skip
    def test_keywords_of_xarray_without_a_meaning_here(self, file, keyword, value):
        with xr.open_dataset(file) as data, xr.open_dataset(file, **{keyword: value}) as same:
            assert same.identical(data)
        with xr.open_datatree(file) as tree, xr.open_datatree(file, **{keyword: value}) as same:
            assert same.identical(tree)

    def test_other_keywords(self, file):
        with pytest.raises(ParameterError, match=r"no keyword 'clock'; did you mean 'clocks'"):
            xr.open_dataset(file, clock=False)
        with pytest.raises(ParameterError, match="no keyword 'spool'"):
            xr.open_datatree(file, spool=True)

    def test_no_channels(self, tmp_path):
        hapfmt.write(Recording(), tmp_path / "none.hapf")
        with xr.open_dataset(tmp_path / "none.hapf") as data:
            assert not data.variables
        with xr.open_datatree(tmp_path / "none.hapf") as tree:
            assert not tree.children


@given(st.data())
@settings(max_examples=examples(40), deadline=None)
def test_any_recording_any_part(room, data):
    """Values and times of any part of any channel are those of the recording."""
    recording = data.draw(strategies.recordings())
    hapfmt.write(recording, room, force=True)
    was = hapfmt.read(room)
    with xr.open_dataset(room) as lazy:
        assert len(lazy.data_vars) == len(was)
        for variable, channel in zip(lazy.data_vars.values(), was, strict=True):
            time = variable[variable.dims[0]] if variable.dims else None
            index = lazy.xindexes[variable.dims[0]].transform
            origin = index.ticks.start
            assert index.rate == channel.rate_exact and index.ticks.step == 1
            if not channel.coverage:
                continue
            first, last = channel.start_tick - origin, channel.stop_tick - origin
            assert 0 <= first <= last <= index.size
            part = sorted(data.draw(st.tuples(*[st.integers(first, last)] * 2)))
            part[1] = min(part[1], part[0] + 5000)
            a, b = part
            step = data.draw(st.sampled_from([1, 1, 3, -1]))
            chosen = slice(a, b)
            got = variable[chosen][::step].values
            wanted = channel.filled(a + origin, b + origin)[::step]
            assert np.array_equal(got, wanted, equal_nan=True)
            seconds = hapfmt.recording.seconds_of(a + origin, b + origin, index.rate)
            assert np.array_equal(time[chosen].values, seconds)
        with xr.open_dataset(room, group="events") as events:
            names = [*lazy.data_vars]
            assert events["text"].values.tolist() == [event.text for event in was.events]
            assert events["time"].values.tolist() == [float(event.time) for event in was.events]
            assert events["channel"].values.tolist() == [
                "" if event.channel is None else names[event.channel] for event in was.events
            ]
        try:
            whole = was.to_xarray()
        except LimitError:
            return
        assert lazy.load().identical(whole)


@given(
    strategies.clock_maps(), strategies.rates, st.lists(st.integers(0, 2**40), max_size=5),
    st.booleans(),
)  # fmt: skip
@settings(max_examples=examples(200), deadline=None)
def test_clock_times_are_those_of_the_map(map_, rate, ticks, is_ns):
    map_ = map_ if is_ns else replace(map_, channel=0)
    exact = [
        map_.time_ns(hapfmt.numbers.rdiv(t * 10**9 * rate.denominator, rate.numerator))
        if is_ns
        else map_.time_ns(t)
        for t in ticks
    ]
    ticks = np.array(ticks, np.int64)
    if all(-(1 << 63) <= time < 1 << 63 for time in exact):
        assert datasets.clock_times(map_, rate, ticks).tolist() == exact
    else:
        with pytest.raises(LimitError, match="64 bits"):
            datasets.clock_times(map_, rate, ticks)


def test_clocks_without_a_map():
    seen = [
        ClockObservation("pc", 0, tick, time) for tick, time in [(0, 5), (9, 95), (9, 99), (8, 2)]
    ]
    (map_,) = datasets.clock_maps(seen, [])
    assert map_.points == ((0, 5), (9, 95))
    assert datasets.clock_maps(seen[:1], []) == []


class TestTimes:
    """Selection is that of an index of pandas that holds all times."""

    @given(st.data())
    @settings(max_examples=examples(200), deadline=None)
    def test_as_pandas_selects(self, data):
        rate = data.draw(strategies.rates)
        first = data.draw(st.sampled_from([0, 1, 10**6, 2**40]) | st.integers(0, 2**47))
        size, step = data.draw(st.integers(1, 40)), data.draw(st.sampled_from([1, 2, 7]))
        index = datasets.TickIndex(
            datasets.TickTransform(
                rate, range(first, first + size * step, step), name="time", dim="time"
            )
        )
        plain = index.to_pandas_index()
        if not plain.is_unique:
            return
        between = st.floats(plain[0] - 1 / rate * 3, plain[-1] + 1 / rate * 3)
        labels = st.sampled_from(plain.tolist()) | between
        a, b = sorted(data.draw(st.tuples(labels, labels)))
        got = index.sel({"time": slice(a, b)}).dim_indexers["time"]
        wanted = plain.slice_indexer(a, b)
        assert range(size)[got] == range(size)[wanted]
        for method in (None, "nearest", "ffill", "bfill"):
            place = plain.get_indexer([a], method=method)[0]
            if place < 0:
                with pytest.raises(KeyError):
                    index.sel({"time": a}, method=method)
            else:
                found = index.sel({"time": a}, method=method).dim_indexers["time"]
                assert abs(plain[found] - a) == abs(plain[place] - a)
                assert method == "nearest" or found == place

    def test_selecting(self, file):
        with xr.open_dataset(file, group="1000Hz") as data:
            fx = data["fx"]
            assert float(fx.sel(time=0.25)) == float(fx[250])
            assert float(fx.sel(time=0.2504, method="nearest")) == float(fx[250])
            picked = fx.sel(time=[0.1, 0.3], method="nearest")
            assert picked["time"].values.tolist() == [0.1, 0.3]
            pointwise = fx.sel(time=xr.DataArray([0.1, 0.2], dims="trial"))
            assert pointwise.dims == ("trial",)
            with pytest.raises(KeyError, match=r"no sample at 0\.2504 s; .* takes the nearest one"):
                fx.sel(time=0.2504)
            with pytest.raises(KeyError):
                fx.sel(time=0.2504, method="nearest", tolerance=1e-4)
            with pytest.raises(KeyError, match="seconds"):
                fx.sel(time="noon")
            halves = fx.isel(time=slice(None, None, 2)).sel(time=slice(1, 2))
            assert isinstance(halves.xindexes["time"], datasets.TickIndex) and halves.size == 501

    def test_alignment(self):
        data = two_rates().sel("fx").to_xarray()
        early, late = data.isel(time=slice(0, 3000)), data.isel(time=slice(2000, 5000))
        both = xr.merge([early, late], join="outer", compat="no_conflicts")
        assert both.drop_attrs().equals(data.drop_attrs())
        assert (early["fx"] + late["fx"]).sizes["time"] == 1000
        whole = xr.concat([early, data.isel(time=slice(3000, 5000))], "time")
        assert isinstance(whole.xindexes["time"], datasets.TickIndex) and whole.equals(data)
        apart = xr.concat([early, data.isel(time=slice(4000, 5000))], "time")
        assert apart.sizes["time"] == 4000 and float(apart["time"][3000]) == 4.0
        assert isinstance(apart.xindexes["time"], datasets.TickIndex)
        slow = Recording.from_array(np.zeros(9), 10).to_xarray()
        with pytest.raises(ParameterError, match="interp_like"):
            xr.align(data, slow, join="outer")

    @pytest.mark.parametrize(
        "change",
        [
            lambda x: x.dropna("time"),
            lambda x: x.where(x > 0, drop=True),
            lambda x: x.sortby("time", ascending=False),
            lambda x: x.thin(time=10),
            lambda x: x[::-1],
            lambda x: x.isel(time=[1, 5, 9, 1200]),
            lambda x: x.isel(time=[]),
            lambda x: x.isel(time=[7]),
            lambda x: x.sel(time=[0.5, 0.25]),
            lambda x: x.isel(time=np.arange(5000) % 7 == 0),
            lambda x: x.groupby(x > 0.5).map(lambda group: group - group.mean()),
            lambda x: x.shift(time=3).diff("time"),
            lambda x: xr.concat([x[4000:], x[:10], x[10:900]], "time"),
        ],
    )
    def test_as_with_an_index_of_pandas(self, change):
        """What people do with times gives what it gives with all times in memory."""
        ours = two_rates().sel("fx").to_xarray()["fx"]
        plain = ours.drop_indexes("time").set_xindex("time")
        a, b = change(ours), change(plain)
        assert isinstance(b.xindexes["time"], xr.indexes.PandasIndex)
        assert isinstance(a.xindexes["time"], datasets.TickIndex)
        assert a.drop_indexes("time").equals(b.drop_indexes("time"))
        for join in ("inner", "outer", "left", "right"):
            with xr.set_options(arithmetic_join=join):
                for mine, theirs in ((a + ours, b + plain), (ours - a, plain - b), (a + a, b + b)):
                    assert (
                        mine.sortby("time")
                        .drop_indexes("time")
                        .equals(theirs.sortby("time").drop_indexes("time"))
                    )
        if a.size > 1:
            at = float(b["time"][1])
            assert a.sel(time=at).drop_vars("time").equals(b.sel(time=at).drop_vars("time"))

    def test_a_long_index_takes_no_room(self):
        """Ten days at 44.1 kHz."""
        size = 10 * 86_400 * 44_100
        index = datasets.TickIndex(
            datasets.TickTransform(Fraction(44_100), range(size), name="time", dim="time")
        )
        found = index.sel({"time": slice(86_400.0, 86_401.0)}).dim_indexers["time"]
        assert found == slice(86_400 * 44_100, 86_401 * 44_100 + 1, None)
        with pytest.raises(LimitError, match="times"):
            index.to_pandas_index()


class TestElsewhere:
    def test_pickled(self, file):
        with xr.open_dataset(file) as data:
            there = pickle.loads(pickle.dumps(data))
            assert len(pickle.dumps(data)) < 20_000
            assert there.load().identical(data.load())
            there.close()

    @pytest.mark.deep
    def test_in_another_process(self, file, tmp_path):
        (tmp_path / "data.pickle").write_bytes(pickle.dumps(xr.open_dataset(file)))
        code = (
            "import pickle, sys; d = pickle.load(open(sys.argv[1], 'rb')); print(float(d['x'][7]))"
        )
        found = subprocess.check_output([sys.executable, "-c", code, tmp_path / "data.pickle"])
        assert float(found) == 7.0

    def test_any_url(self, file, tmp_path):
        fsspec = pytest.importorskip("fsspec", reason="needs the extra 'remote'")
        fsspec.filesystem("memory").pipe("/touch.hapf", Path(file).read_bytes())
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
            archive.write(file, "deep/touch.hapf")
        expected = hapfmt.read(file).to_xarray()
        for url in ("memory://touch.hapf", f"zip://deep/touch.hapf::{tmp_path}/a.zip"):
            with xr.open_dataset(url) as data:
                there = pickle.loads(pickle.dumps(data))
                assert there.load().identical(expected)
                there.close()

    @pytest.mark.deep
    def test_in_a_cluster_of_processes(self, file):
        distributed = pytest.importorskip("distributed", reason="needs the extra 'dask'")
        pytest.importorskip("aiohttp", reason="needs the extra 'remote'")
        expected = hapfmt.read(file).to_xarray()
        with (
            serving({"touch.hapf": Path(file).read_bytes()}) as server,
            distributed.Client(
                processes=True, n_workers=1, threads_per_worker=2, dashboard_address=":0"
            ),
        ):
            for path in (file, server.url("touch.hapf")):
                with xr.open_dataset(path, chunks={"time_1000Hz": 5000}) as data:
                    assert data.compute().identical(expected)

    def test_in_threads(self, file):
        expected = hapfmt.read(file).to_xarray()
        found: list[bool] = []
        with xr.open_dataset(file) as data:

            def work(first: int) -> None:
                for at in range(first, 4000, 700):
                    part = slice(at, at + 900)
                    same = data["fx"][part].values, expected["fx"][part].values
                    found.append(np.array_equal(*same, equal_nan=True))

            threads = [threading.Thread(target=work, args=(k * 100,)) for k in range(6)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        assert len(found) > 20 and all(found)

    def test_closed_files_are_opened_again(self, file):
        data = xr.open_dataset(file)
        data.close()
        assert float(data["x"][3]) == 3.0
        data.close()

    def test_another_file_at_the_same_path(self, tmp_path):
        path = tmp_path / "a.hapf"
        hapfmt.write(np.zeros(100), path, rate=100)
        data = xr.open_dataset(path)
        data.close()
        hapfmt.write(np.ones(100), path, rate=100, force=True)
        with pytest.raises(OSError, match="changed after it was opened"):
            data.load()
        data.close()

    @pytest.mark.parametrize("size", ["same", "longer", "shorter"])
    @pytest.mark.parametrize("way", ["in place", "replaced"])
    def test_a_file_that_changes_while_it_is_open(self, tmp_path, size, way):
        """Each later reading is an error, also of what was read before; a new opening is not."""
        path, other = tmp_path / "a.hapf", tmp_path / "b.hapf"
        count = {"same": 100_000, "longer": 120_000, "shorter": 80_000}[size]
        once = hapfmt.Settings(cluster=1)
        hapfmt.write(Recording.from_array(np.arange(100_000.0), 1000), path, once)
        hapfmt.write(Recording.from_array(np.arange(float(count)) + 1, 1000), other, once)
        assert (path.stat().st_size == other.stat().st_size) == (size == "same")
        data, lazy = xr.open_dataset(path), xr.open_dataset(path)["ch1"]
        assert float(data["ch1"][0]) == 0.0 and float(lazy[99_999]) == 99_999.0
        time.sleep(0.02)  # times of files have steps of up to 10 ms
        if way == "in place":
            path.write_bytes(other.read_bytes())
        else:
            other.replace(path)
        for place in (0, 50_000, 99_999):
            with pytest.raises(
                OSError, match=r"changed after it was opened; open it again.*a\.hapf"
            ):
                data["ch1"][place].load()
        there = pickle.loads(pickle.dumps(lazy))
        for again in (there, lazy):
            with pytest.raises(OSError, match="changed after it was opened"):
                again.load()
        data.close()
        with xr.open_dataset(path) as new:
            assert float(new["ch1"][0]) == 1.0 and new["ch1"].size == count

    def test_a_file_that_changes_in_the_middle_of_a_reading(self, tmp_path, monkeypatch):
        path = tmp_path / "a.hapf"
        hapfmt.write(np.zeros(100), path, rate=100)
        whole = path.read_bytes()
        read = backend.read_ticks

        def changing(*given):
            found = read(*given)
            time.sleep(0.02)
            path.write_bytes(whole)
            return found

        monkeypatch.setattr(backend, "read_ticks", changing)
        with xr.open_dataset(path) as data, pytest.raises(OSError, match="changed after it was"):
            data.load()

    def test_another_time_of_change(self, tmp_path):
        """Processes that open the file again see that it was written again."""
        path = tmp_path / "a.hapf"
        hapfmt.write(np.zeros(100), path, rate=100)
        data = xr.open_dataset(path)
        data.close()
        os.utime(path, ns=(0, path.stat().st_mtime_ns + 1))
        with pytest.raises(OSError, match="changed after it was opened"):
            pickle.loads(pickle.dumps(data)).load()
        data.close()

    def test_another_working_folder(self, tmp_path, monkeypatch):
        (tmp_path / "other").mkdir()
        monkeypatch.chdir(tmp_path)
        hapfmt.write(np.ones(100), "a.hapf", rate=100)
        with xr.open_dataset("a.hapf") as data:
            monkeypatch.chdir("other")
            assert float(data["ch1"].sum()) == 100.0

    def test_a_file_that_is_gone(self, tmp_path):
        path = tmp_path / "a.hapf"
        hapfmt.write(np.zeros(100), path, rate=100)
        data = xr.open_dataset(path)
        data.close()
        path.unlink()
        with pytest.raises(FileNotFoundError):
            data.load()


class TestDask:
    def test_chunks_are_whole_clusters(self, long):
        with xr.open_dataset(long, chunks={}) as data, hapfmt.Reader(long) as reader:
            assert data["x"].chunks is not None
            (sizes,) = data["x"].chunks
            assert sum(sizes) == 300_000 and len(sizes) >= 4 and data["y"].chunks == ((300,),)
            starts = {ref.start_ns // 10**6 for ref in reader.catalogue.data}
            assert len(starts) > 100
            assert set(np.cumsum(sizes)[:-1].tolist()) <= starts
            assert float(data["x"].sum()) == 300 * 499_500

    def test_a_number_is_for_all_rates(self, long):
        """xarray ignores names of dimensions that are not there."""
        with pytest.warns(UserWarning, match="separate the stored chunks"):
            data = xr.open_dataset(long, chunks=100_000)
        assert data["x"].chunks == ((100_000,) * 3,) and data["y"].chunks == ((300,),)
        data.close()

    def test_other_chunks(self, long):
        with xr.open_dataset(long, chunks={"time_1000Hz": 300_000, "time_1Hz": 300}) as data:
            assert data["x"].chunks == ((300_000,),)

    @pytest.mark.deep
    def test_processes(self, file):
        dask = pytest.importorskip("dask", reason="needs the extra 'dask'")
        if os.name == "nt":
            pytest.skip("starts slowly")
        with xr.open_dataset(file, chunks={}) as data, dask.config.set(scheduler="processes"):
            total = data["fx"].sum(skipna=True).compute(num_workers=1)
        assert float(total) == pytest.approx(np.nansum(two_rates()["fx"].to_numpy()))


class TestUntrusted:
    """Any bytes give a dataset or one of our errors."""

    @pytest.mark.parametrize("path", sample(VALID, always=ALWAYS), ids=lambda path: path.stem)
    def test_valid_files(self, path):
        was = hapfmt.read(path)
        with xr.open_dataset(path) as data:
            try:
                whole = was.to_xarray()
            except LimitError:
                assert len(data.data_vars) == len(was)
                return
            assert data.load().identical(whole)

    @pytest.mark.parametrize("path", sample(INVALID), ids=lambda path: path.stem)
    def test_invalid_files(self, path):
        """A part of the file may be sound, so that not each of them is an error here."""
        try:
            with xr.open_datatree(path) as tree:
                for node in tree.subtree:
                    node.to_dataset().load()
        except HapfmtError:
            pass

    @pytest.mark.parametrize(
        "name", sample(hostile.FILES, always=["packets", "index entries", "clocks", "LPCR"])
    )
    def test_hostile_files(self, name, tmp_path):
        path = tmp_path / "hostile.hapf"
        path.write_bytes(hostile.FILES[name](hostile.fitting(1 << 24)))
        try:
            with xr.open_dataset(path) as data:
                for variable in [*data.variables.values()][:10]:
                    variable[-1:].load()
        except HapfmtError:
            pass

    def test_damage_is_an_error(self, file, tmp_path):
        path = tmp_path / "bad.hapf"
        whole = bytearray(Path(file).read_bytes())
        with hapfmt.Reader(file) as reader:
            whole[reader.catalogue.data[0].offset + 300] ^= 1
        path.write_bytes(whole)
        with (
            pytest.raises(HapfmtError, match="command hapfmt recover"),
            xr.open_dataset(path) as data,
        ):
            data.load()

    @given(st.integers(0), st.integers(1, 255))
    @settings(max_examples=examples(150), deadline=None)
    def test_any_other_byte(self, file, room, at, change):
        """The dataset is the same, or there is an error: never other values."""
        whole = bytearray(Path(file).read_bytes())
        whole[at % len(whole)] ^= change
        room.write_bytes(whole)
        expected = hapfmt.read(file).to_xarray()
        try:
            with xr.open_dataset(room) as data:
                found = data.load()
        except HapfmtError:
            return
        assert found.identical(expected)

    def test_a_gap_of_years(self, tmp_path):
        path = tmp_path / "far.hapf"
        x = hapfmt.Channel(np.arange(2.0), 1000, (hapfmt.Span(0, 1), hapfmt.Span(2**46, 2**46 + 1)))
        hapfmt.write(Recording((x,)), path)
        with xr.open_dataset(path) as data:
            (far,) = data.data_vars.values()
            assert far.size == 2**46 + 1 and float(far[-1]) == 1.0
            with pytest.raises(LimitError, match="limit"):
                far.load()
            with pytest.raises(LimitError, match=r"limit of \d+; take a part of .*chunks=\{\}$"):
                far.variable.load()

    def test_what_is_no_recording(self, tmp_path):
        path = tmp_path / "a.hapf"
        path.write_bytes(b"nothing of the kind")
        with pytest.raises(HapfmtError):
            xr.open_dataset(path)
        with pytest.raises(ParameterError, match="to_xarray"):
            xr.open_dataset(b"\x89hapf", engine="hapf")
