"""HDF5: files that h5py wrote are read exactly; ours come back whole; hostile ones are refused."""

from __future__ import annotations

import io
import json
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import strategies
from commands import run
from depth import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt.convert import imported, read, save
from hapfmt.errors import HapfmtError, LimitError, MissingExtraError, ParameterError
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

h5py = pytest.importorskip("h5py")
pytestmark = pytest.mark.filterwarnings("ignore::hapfmt.errors.MovedTimesWarning")
RNG = np.random.default_rng(1)


def made(fill: Callable[[Any], object]) -> bytes:
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        fill(file)
    return stream.getvalue()


def read_made(fill: Callable[[Any], object], **options: Any) -> Recording:
    return read(made(fill), **options)


def notes(recording: Recording) -> list[str]:
    return list(recording.metadata.get("notes", []))


def put(file: Any, path: str, data: Any, **attributes: Any) -> None:
    options = {"chunks": True, "compression": "gzip", "shuffle": True} if np.ndim(data) else {}
    one = file.create_dataset(path, data=data, **options)
    one.attrs.update(attributes)


class TestLayouts:
    def test_aloha(self) -> None:
        """/action and /observations, a row for each time, images left out, no rate."""
        values = {name: RNG.random((9, 14)) for name in ("qpos", "qvel", "effort")}
        action = RNG.random((9, 14)).astype(np.float32)

        def fill(file: Any) -> None:
            file.attrs["sim"] = True
            put(file, "action", action)
            for name, x in values.items():
                put(file, f"observations/{name}", x)
            put(file, "observations/images/cam_high", np.zeros((9, 48, 64, 3), np.uint8))

        with pytest.raises(
            ParameterError, match=r"no times and no rate are known for /action \(9 x"
        ):
            read_made(fill)
        found = read_made(fill, rate=50)
        assert len(found) == 56 and found.labels[:2] == ["action.0", "action.1"]
        assert found["action.13"].stored.dtype == np.float32
        assert np.array_equal(found["action.13"].stored, action[:, 13])
        for name, x in values.items():
            for joint in range(14):
                channel = found[f"{name}.{joint}"]
                assert np.array_equal(channel.stored, x[:, joint])
                assert (channel.rate_exact, channel.group) == (50, f"observations.{name}")
        assert notes(found) == [
            "images of /observations/images/cam_high (9 x 48 x 64 x 3 uint8) are not read"
        ]
        assert found.metadata["attributes"]["/"]["sim"] is True

    @staticmethod
    def robomimic(file: Any) -> None:
        file.create_group("data").attrs["env_args"] = json.dumps(
            {"env_name": "Lift", "env_kwargs": {"control_freq": 20}}
        )
        for number in range(11):
            demo = f"data/demo_{number}"
            put(file, f"{demo}/actions", np.full((6, 7), number, np.float64))
            put(file, f"{demo}/obs/eef_pos", np.full((6, 3), number, np.float64))
            put(file, f"{demo}/next_obs/eef_pos", np.zeros((6, 3)))
            put(file, f"{demo}/dones", np.arange(6))

    def test_robomimic(self) -> None:
        with pytest.raises(ParameterError, match="holds 11 episodes, demo_0 to demo_10; choose"):
            read_made(self.robomimic)
        with pytest.raises(ParameterError, match="no episode 'demo_11'"):
            read_made(self.robomimic, episode="demo_11")
        for episode in (10, "demo_10"):
            found = read_made(self.robomimic, episode=episode)
            assert found.labels == [
                *(f"actions.{i}" for i in range(7)), "dones", *(f"eef_pos.{i}" for i in range(3)),
            ]  # fmt: skip
            assert set(found["eef_pos.2"].stored) == {10.0}
            assert {channel.rate_exact for channel in found} == {20}
            assert notes(found)[0] == "of 11 episodes, demo_10 is read"
            assert "repeats obs" in notes(found)[1]
        with pytest.raises(ParameterError, match="no groups such as demo_0"):
            read_made(lambda file: put(file, "x", np.zeros(5)), episode=1, rate=5)

    @pytest.mark.parametrize(
        ("name", "attributes", "unit"),
        [
            ("timestamp", {}, 1),
            ("time", {"units": "s"}, 1),
            ("timestamps", {"unit": "ms"}, 1e-3),
            ("t", {"units": "microseconds"}, 1e-6),
            ("ts", {"units": "nsec"}, 1e-9),
            ("time_us", {}, 1e-6),
            ("stamps_ns", {}, 1e-9),
        ],
    )
    @pytest.mark.parametrize("start_s", [0, 1_700_000_000])
    def test_group_with_times(
        self, name: str, attributes: dict[str, str], unit: float, start_s: int
    ) -> None:
        """Losses are gaps; the unit comes from an attribute, from the name, or from the size."""
        ticks = np.delete(np.arange(1000), np.arange(400, 430))
        times: Any = ticks / 500 + start_s
        if unit != 1:
            times = ticks * round(1 / 500 / unit) + round(start_s / unit)
        x = RNG.normal(size=(3, 970))

        def fill(file: Any) -> None:
            put(file, "wrench/data", x, unit="Newton", labels=["fx", "fy", "fz"])
            put(file, f"wrench/{name}", times, **attributes)

        found = read_made(fill)
        assert found.labels == ["fx", "fy", "fz"]
        for row, channel in zip(x, found, strict=True):
            assert np.array_equal(channel.stored, row)
            assert (channel.rate_exact, channel.unit) == (500, "N")
            assert channel.coverage == (Span(0, 400), Span(430, 1000))
        assert found.epoch_ns == (start_s * 10**9 or None)
        assert found.metadata["source_units"]["fx"] == "Newton"

    def test_times_without_a_unit_are_noted(self) -> None:
        def fill(file: Any) -> None:
            put(file, "x", np.arange(99.0))
            put(file, "t", np.arange(99) * 2500)

        found = read_made(fill)
        assert found[0].rate_exact == 400
        assert notes(found) == ["/t has no unit; its times rise by 2500, and are read as us"]

    def test_tables_share_one_zero(self) -> None:
        def fill(file: Any) -> None:
            put(file, "a/x", np.arange(500.0))
            put(file, "a/time", 1_700_000_000_000_000_000 + np.arange(500) * 1_000_000)
            put(file, "b/x", np.arange(500, dtype=np.int16))
            put(file, "b/time", 1_700_000_000_250_000_000 + np.arange(500) * 2_000_000)

        found = read_made(fill)
        assert found.labels == ["a", "b"] and found.epoch_ns == 1_700_000_000 * 10**9
        assert [c.start_tick for c in found] == [0, 125]
        assert found["b"].stored.dtype == np.int32 and found["b"].calibration == Calibration()

    def test_own_times_and_those_above(self) -> None:
        """An array's own times come first, then the nearest group's with as many rows."""

        def fill(file: Any) -> None:
            put(file, "time", np.arange(200) / 100)
            put(file, "arm/q", np.zeros(200))
            put(file, "arm/force", np.zeros(300))
            put(file, "arm/force_time", np.arange(300) / 250)

        found = read_made(fill)
        assert {c.label: c.rate for c in found} == {"force": 250, "q": 100}

    def test_clock_chooses(self) -> None:
        def fill(file: Any) -> None:
            put(file, "x", np.zeros(300))
            put(file, "t", np.arange(300) / 100)
            put(file, "stamp", np.arange(300) / 100 + 1.7e9)

        assert abs(read_made(fill, clock="stamp").epoch_ns - 1_700_000_000 * 10**9) < 1000
        assert read_made(fill, clock="t").epoch_ns is None
        assert "another clock was chosen" in " ".join(notes(read_made(fill, clock="t")))
        with pytest.raises(ParameterError, match="no time array 'log'; there are"):
            read_made(fill, clock="log")

    @pytest.mark.parametrize("key", ["fs", "rate", "sampling_rate", "sample_rate", "fps"])
    @pytest.mark.parametrize("where", ["/", "x"])
    def test_rates(self, key: str, where: str) -> None:
        def fill(file: Any) -> None:
            put(file, "x", np.arange(5000.0))
            file[where].attrs[key] = np.float32(35.618)

        assert read_made(fill)[0].rate_exact == Fraction(17809, 500)
        assert read_made(fill, rate="44100/7")[0].rate_exact == 6300

    def test_a_given_rate_leaves_those_of_the_file(self) -> None:
        def fill(file: Any) -> None:
            put(file, "a/x", np.arange(3000.0))
            put(file, "a/t", np.arange(3000) / 500)
            put(file, "b/y", np.arange(600.0), fs=100)
            put(file, "c/z", np.arange(600.0))

        found = read_made(fill, rate=10)
        assert {c.group: c.rate_exact for c in found} == {"a": 500, "b": 100, "c": 10}
        assert notes(found) == ["the rate 10 Hz is only for /c/z; the file tells the others"]
        with pytest.raises(ParameterError, match="have several rates"):
            read_made(fill, rate=10, select=["/a/*", "/b/*"])
        assert read_made(fill, rate=1000, select="/a/*")[0].rate_exact == 1000

    def test_a_given_rate_for_times_that_tell_none(self) -> None:
        def fill(file: Any) -> None:
            put(file, "a/x", np.arange(300.0))
            put(file, "a/t", np.arange(300) / 500)
            put(file, "b/y", np.arange(5.0))
            put(file, "b/t", [0, 0.013, 0.051, 0.3037, 0.31])

        found = read_made(fill, rate=100)
        assert {c.group: c.rate_exact for c in found} == {"a": 500, "b": 100}

    def test_a_given_rate_for_our_own_layout(self, tmp_path: Path) -> None:
        file = tmp_path / "a.h5"
        x, y = (Channel(np.arange(9.0), Fraction(rate), label=str(rate)) for rate in (500, 100))
        save(Recording((x, y)), file)
        with pytest.raises(ParameterError, match="have several rates"):
            read(file, rate=10)
        found = read(file, rate=10, select="100")
        assert found[0].rate_exact == 10
        assert notes(found) == ["the rate of the file, 100 Hz, was overridden by 10 Hz"]

    def test_notes_name_neither_options_nor_arguments(self) -> None:
        def fill(file: Any) -> None:
            put(file, "a/x", np.zeros(3000), fs=10)
            put(file, "c/square", np.zeros((9, 9)), fs=10)
            put(file, "b/y", np.zeros(600))
            put(file, "a/t", np.arange(3000) / 10)
            put(file, "a/time", np.arange(3000) / 10)

        found = notes(read_made(fill, clock="t"))
        assert len(found) == 3
        assert not any("=" in note or "--" in note for note in found)

    def test_a_file_that_is_cut_off(self) -> None:
        data = made(lambda file: put(file, "x", RNG.random(5000), fs=10))
        half = len(data) // 2
        with pytest.raises(
            ParameterError,
            match=f"cannot be opened: it is cut off: {half} of {len(data)} bytes are there; copy it",
        ):
            read(data[:half])

    def test_a_rate_as_a_data_set(self) -> None:
        def fill(file: Any) -> None:
            put(file, "g/x", np.arange(5000.0))
            file["fs"] = 2000

        assert read_made(fill)[0].rate == 2000

    def test_shapes(self) -> None:
        """The longer side is time; a taxel grid becomes a channel for each taxel."""

        def fill(file: Any) -> None:
            file.attrs["fs"] = 100
            put(file, "wide", np.arange(300.0).reshape(3, 100))
            put(file, "tall", np.arange(300.0).reshape(100, 3))
            put(file, "skin", np.arange(600).reshape(100, 2, 3))
            put(file, "matrix", np.eye(4))

        found = read_made(fill)
        assert np.array_equal(found["wide.1"].stored, np.arange(100.0) + 100)
        assert np.array_equal(found["tall.1"].stored, np.arange(100.0) * 3 + 1)
        assert np.array_equal(found["skin.1.2"].stored, np.arange(100) * 6 + 5)
        assert "matrix" in notes(found)[0]

    def test_transpose(self) -> None:
        def fill(file: Any) -> None:
            file.attrs["fs"] = 100
            put(file, "x", np.arange(36.0).reshape(6, 6))

        with pytest.raises(
            ParameterError, match=r"either side of /x \(6 x 6 float64\) may be time"
        ):
            read_made(fill)
        assert read_made(fill, transpose=True)["x.1"].stored[0] == 1
        assert read_made(fill, transpose=False)["x.1"].stored[0] == 6

    def test_compound(self) -> None:
        kind = [("time", "f8"), ("f", [("x", "<f4"), ("y", ">i2")]), ("v", "f8", (2,)), ("s", "S3")]
        rows = np.zeros(400, kind)
        rows["time"] = np.arange(400) / 800
        rows["f"]["x"] = np.arange(400)
        rows["f"]["y"] = -np.arange(400)
        rows["v"] = np.arange(800).reshape(400, 2)
        found = read_made(lambda file: put(file, "log", rows))
        assert found.labels == ["f.x", "f.y", "v.0", "v.1"]
        assert {channel.rate for channel in found} == {800}
        assert np.array_equal(found["f.x"].stored, np.arange(400, dtype=np.float32))
        assert np.array_equal(found["f.y"].stored, -np.arange(400))
        assert np.array_equal(found["v.1"].stored, np.arange(400) * 2 + 1)
        assert "/log/s is not read" in " ".join(notes(found))

    @pytest.mark.parametrize(
        ("given", "kept"),
        [
            ("i1", "int32"), ("<i2", "int32"), (">i4", "int32"), ("u1", "int32"), ("u2", "int32"),
            ("?", "int32"), ("u4", "uint64"), (">u8", "uint64"), ("i8", "int64"),
            ("f2", "float16"), (">f4", "float32"), ("f8", "float64"),
        ],
    )  # fmt: skip
    def test_dtypes(self, given: str, kept: str) -> None:
        dtype = np.dtype(given)
        x = np.zeros(600, dtype)
        if dtype.kind in "iu":
            x[:2] = np.iinfo(dtype).min, np.iinfo(dtype).max
        elif dtype.kind == "f":
            x[:3] = np.finfo(dtype).max, np.finfo(dtype).smallest_subnormal, -0.0
        found = read_made(lambda file: put(file, "x", x, fs=10))[0]
        assert found.stored.dtype == kept
        assert found.is_counts == (kept == "int32")
        assert found.stored.tobytes() == x.astype(kept).tobytes()

    def test_nan_is_a_gap(self) -> None:
        x = np.arange(100.0)
        x[10:20] = np.nan
        found = read_made(lambda file: put(file, "x", x, fs=10))[0]
        assert found.coverage == (Span(0, 10), Span(20, 100))

    def test_scale(self) -> None:
        def fill(file: Any) -> None:
            put(file, "x", np.arange(99, dtype=np.int16), fs=10, scale_factor=0.001, add_offset=2.5)

        assert read_made(fill)[0].calibration == Calibration(1, 2500, 1000)

    def test_units_and_names(self) -> None:
        def fill(file: Any) -> None:
            file.attrs["fs"] = 10
            put(file, "force [N]", np.zeros(99))
            put(file, "acc", np.zeros((99, 2)), units=["m/s^2", "g"], columns=["ax", "ay"])
            put(file, "temp", np.zeros(99), units=b"degC")

        found = read_made(fill)
        assert {c.label: c.unit for c in found} == {
            "force": "N", "ax": "m/s2", "ay": "[g]", "temp": "Cel",
        }  # fmt: skip

    def test_equal_names_get_their_group(self) -> None:
        def fill(file: Any) -> None:
            file.attrs["fs"] = 10
            put(file, "left/fx", np.zeros(99))
            put(file, "right/fx", np.zeros(99))
            put(file, "right/fy", np.zeros(99))

        assert read_made(fill).labels == ["left.fx", "right.fx", "fy"]

    def test_stamps_of_several_tables_have_the_names_of_the_tables(self) -> None:
        def fill(file: Any) -> None:
            for name, rate in (("left", 100), ("right", 50)):
                put(file, f"{name}/t", np.arange(99) / rate)
                put(file, f"{name}/{name[0]}x", np.zeros(99))

        labels = ["lx", "left.stamp", "rx", "right.stamp"]
        assert read_made(fill, keep_stamps=True).labels == labels
        assert read_made(fill, keep_stamps=True, select="left").labels == ["lx", "stamp"]

    def test_select(self) -> None:
        def fill(file: Any) -> None:
            file.attrs["fs"] = 10
            for name in ("left/fx", "left/fy", "right/fx"):
                put(file, name, np.zeros(99))

        for pattern, count in {"left": 2, "/left/fx": 1, "fx": 2, "*/f?": 3, "right/*": 1}.items():
            assert len(read_made(fill, select=pattern)) == count
        with pytest.raises(ParameterError, match="no data set 'up'; there are: '/left/fx'"):
            read_made(fill, select=["left", "up"])

    def test_irregular_rows_are_events(self) -> None:
        def fill(file: Any) -> None:
            put(file, "x", np.arange(500.0), fs=100)
            put(file, "press/level", np.array([3, 5, 4]))
            put(file, "press/time", np.array([0.5, 0.617, 3.9021]))

        found = read_made(fill)
        assert [(e.time, e.text, e.layer) for e in found.events] == [
            (Fraction(1, 2), "3", "press"), (Fraction(617, 1000), "5", "press"),
            (Fraction(39021, 10000), "4", "press"),
        ]  # fmt: skip
        assert found.labels == ["x"]

    def test_stamps_are_kept(self) -> None:
        late = RNG.integers(0, 200_000, 3000)
        stamps = 1_700_000_000 * 10**9 + np.arange(3000) * 1_000_000 + late

        def fill(file: Any) -> None:
            put(file, "a/x", np.arange(3000.0))
            put(file, "a/stamp", stamps)

        found = read_made(fill, keep_stamps=True)
        assert found.labels == ["a", "stamp"]
        assert np.array_equal(
            found.epoch_ns + np.arange(3000) * 1_000_000 + found["stamp"].stored, stamps
        )

    def test_values_come_in_blocks(self) -> None:
        """Rows of a block are few where the rows are wide."""
        x = RNG.integers(0, 99, (20_000, 64))
        data = made(lambda file: put(file, "x", x, fs=100))
        with imported(data) as (_, found):
            blocks = list(found.blocks())
            assert found.size == x.nbytes and len(blocks) > 1
        assert np.array_equal(np.concatenate([np.stack(b.values, 1) for b in blocks]), x)

    def test_inspecting_reads_no_values(self) -> None:
        """Values that cannot be read are not noticed."""
        data = bytearray(made(lambda file: put(file, "x", RNG.random(5000), fs=100)))
        with h5py.File(io.BytesIO(bytes(data))) as file:
            at = file["x"].id.get_chunk_info(0).byte_offset
        data[at : at + 50] = bytes(50)
        with imported(bytes(data)) as (_, found):
            assert found.labels == ["x"]
            with pytest.raises(ParameterError, match="/x cannot be read: "):
                list(found.blocks())


class TestMaps:
    @staticmethod
    def odd(file: Any) -> None:
        put(file, "rec1/chanA", np.arange(12.0).reshape(4, 3))
        put(file, "rec1/chanB", np.arange(4))
        put(file, "clk", np.arange(4) * 250)
        put(file, "rest", np.zeros(7))

    def read(self, tmp_path: Path, text: str, **options: Any) -> Recording:
        (tmp_path / "map.toml").write_text(text)
        return read_made(self.odd, map=tmp_path / "map.toml", **options)

    def test_all_keys(self, tmp_path: Path) -> None:
        found = self.read(
            tmp_path,
            """
            [[table]]
            name = "wrench"
            data = ["/rec1/chanA", "rec1.chanB"]
            time = "/clk"
            time_unit = "us"
            axis = 0
            labels = ["fx", "fy", "fz", "state"]
            unit = ["N", "N", "mN", "1"]
            quantity = "force"
            """,
        )
        assert found.labels == ["fx", "fy", "fz", "state"]
        assert [c.unit for c in found] == ["N", "N", "mN", "1"]
        assert {c.rate for c in found} == {4000} and found[0].quantity == "force"
        assert np.array_equal(found["fy"].stored, [1, 4, 7, 10])
        assert notes(found) == ["the map does not name /rest; they are not read"]

    def test_rate(self, tmp_path: Path) -> None:
        text = "[[table]]\ndata = '/rest'\nrate = '44100/7'\n"
        assert self.read(tmp_path, text)[0].rate_exact == 6300
        assert self.read(tmp_path, text, rate=5)[0].rate == 5

    @pytest.mark.parametrize(
        ("text", "error"),
        [
            ("x = 1", "x: is not a known key; known: table"),
            ("table = []", "table: has 0 values; write a list of 1 to 10000 tables"),
            ("[[table]]", "table[0].data: is missing; add path of a data set"),
            ("[[table]]\ndata = 3", "table[0].data: is a number; write a text"),
            ("[[table]]\ndata = []\nrate = 1", "table[0].data: is empty"),
            ("[[table]]\ndata = 'rest'\nraet = 1", "table[0].raet: is not a known key; did you mean"),
            ("[[table]]\ndata = 'rest'\nrate = -1", "table[0].rate: rate is above 0"),
            ("[[table]]\ndata = 'rest'", "table[0]: it needs time, time_column or rate"),
            ("[[table]]\ndata = 'res'\nrate = 1", "no data set 'res'; did you mean '/rest'?"),
            ("[[table]]\ndata = 'rest'\ntime = 'clk'", "data: /rest is 7, and /clk has 4 times"),
            ("[[table]]\ndata = 'rest'\ntime_unit = 'h'\ntime = 'clk'", "time_unit: there is no 'h'"),
            ("[[table]]\ndata = 'rest'\naxis = 1\nrate = 1", "axis: /rest has 1 side"),
            ("[[table]]\ndata = ['rest', 'clk']\nrate = 1", "data: the arrays have [4, 7] rows"),
            ("[[table]]\ndata = 'rest'\nlabels = ['a', 'b']\nrate = 1", "labels: 2 for 1 channel"),
            ("[[table]", "Invalid TOML"),
        ],
    )  # fmt: skip
    def test_errors(self, tmp_path: Path, text: str, error: str) -> None:
        with pytest.raises(ParameterError) as caught:
            self.read(tmp_path, text)
        assert error in str(caught.value)

    def test_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(FileNotFoundError):
            read_made(self.odd, map=tmp_path / "none.toml")


def near(recording: Recording) -> Recording:
    """With the same gaps, but nearer to tick 0, so that they fit in memory; labels that differ."""
    channels = []
    for place, channel in enumerate(recording):
        shift = channel.start_tick - channel.start_tick % 4096
        spans = tuple(Span(a - shift, b - shift) for a, b in channel.coverage)
        label = f"{place} {channel.label}".replace("\0", "")
        channels.append(replace(channel, coverage=spans, label=label))
    return replace(recording, channels=tuple(channels))


def facts(channel: Channel) -> tuple[Any, ...]:
    names = [
        "rate_exact",
        "coverage",
        "calibration",
        "label",
        "unit",
        "quantity",
        "axis",
        "group",
        "body_site",
        "device",
        "deviation",
        "lsb",
    ]
    stored = channel.stored
    return (str(stored.dtype), stored.tobytes(), *(getattr(channel, name) for name in names))


def there_and_back(recording: Recording, **options: Any) -> Recording:
    stream = io.BytesIO()
    save(recording, stream, format=".h5")
    return read(stream.getvalue(), **options)


class TestOurLayout:
    @given(data=st.data())
    @settings(max_examples=examples(60), suppress_health_check=list(HealthCheck), deadline=None)
    def test_everything_comes_back(self, data: st.DataObject) -> None:
        given = near(data.draw(strategies.recordings().flatmap(strategies.clocked)))
        back = there_and_back(given)
        assert [*map(facts, back)] == [*map(facts, given)]
        for name in [
            "epoch_ns",
            "epoch_uncertainty_ns",
            "metadata",
            "attachments",
            "events",
            "clocks",
            "clock_maps",
        ]:
            assert getattr(back, name) == getattr(given, name), name

    def example(self) -> Recording:
        counts = np.arange(-50, 50, dtype=np.int16)
        spans = (Span(5, 45), Span(100, 160))
        return Recording(
            (
                Channel(counts, 1000, spans, Calibration(3, 7, 1000), "force/x", "N", lsb=0.003),
                Channel(np.arange(95.0), 1000, (Span(20, 115),), label="y"),
                Channel(np.arange(7, dtype=np.float32), "44100/7", label="slow"),
            ),
            epoch_ns=1_700_000_000 * 10**9,
            events=(Event(Fraction(1, 3), "tap", Fraction(1, 10), 1, "hand"),),
            metadata={"subject": "S1"},
        )

    def test_others_understand_it(self, tmp_path: Path) -> None:
        """As h5py reads it: rows on one grid, NaN in gaps, scales as CF names them."""
        assert save(self.example(), tmp_path / "x.h5") == ()
        with h5py.File(tmp_path / "x.h5") as file:
            group = file["rate_1000Hz"]
            assert (group.attrs["rate"], group.attrs["start_tick"]) == ("1000", 5)
            assert np.array_equal(group["time"], np.arange(5, 160) / 1000)
            assert group["y"].dims[0][0] == group["time"] and group["time"].attrs["units"] == "s"
            x, y = group["force|x"], group["y"]
            assert x.shape == y.shape == (155,) and x.dtype == np.int16
            assert (x.compression, x.shuffle, x.attrs["units"]) == ("gzip", True, "N")
            assert np.array_equal(x[:40], np.arange(-50, -10)) and not x[40:95].any()
            physical = x[:40] * x.attrs["scale_factor"] + x.attrs["add_offset"]
            assert np.allclose(physical, self.example()[0].samples()[:40], rtol=1e-15)
            assert file[x.attrs["spans"]][()].tolist() == [[0, 40], [95, 155]]
            assert np.isnan(y[:15]).all() and np.array_equal(y[15:110], np.arange(95.0))
            assert file["rate_6300Hz/slow"].dtype == np.float32
            assert file["events/time_s"][0] == 1 / 3 and file["events/text"].asstr()[0] == "tap"
            assert json.loads(file["metadata"].asstr()[()]) == {"subject": "S1"}

    def test_the_same_recording_gives_the_same_bytes(self) -> None:
        streams = [io.BytesIO(), io.BytesIO()]
        for stream in streams:
            save(self.example(), stream, format="hdf5")
        assert streams[0].getvalue() == streams[1].getvalue()

    def test_a_channel_called_time(self) -> None:
        given = Recording((Channel(np.arange(9.0), 5, label="time"),))
        assert there_and_back(given)["time"].samples().tolist() == list(range(9))

    def test_many_channels(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """More than a dimension scale can list."""
        given = Recording(tuple(Channel(np.zeros(1), 5, label=f"c{i}") for i in range(3)))
        for most, listed in ((3, 1), (2, 0)):
            monkeypatch.setattr("hapfmt.convert.hdf5_layout.MOST_SCALED", most)
            stream = io.BytesIO()
            save(given, stream, format="h5")
            with h5py.File(stream) as file:
                assert len(file["rate_5Hz/c2"].dims[0]) == listed
            assert read(stream.getvalue()).labels == given.labels

    @pytest.mark.deep
    def test_a_thousand_channels(self) -> None:
        given = Recording(tuple(Channel(np.zeros(1), 5, label=f"c{i}") for i in range(1000)))
        assert there_and_back(given).labels == given.labels

    def test_select(self) -> None:
        back = there_and_back(self.example(), select=["y", "sl*"])
        assert back.labels == ["y", "slow"] and [e.channel for e in back.events] == [0]
        with pytest.raises(ParameterError, match="no channel 'z'"):
            there_and_back(self.example(), select="z")

    def test_exact_doubles(self) -> None:
        x = np.array([0.1, 0.2, 0.3])
        channel = Channel(np.array([1, 2, 3]), 10, (), Calibration(1, 0, 10), "a", exact=x)
        stream = io.BytesIO()
        (note,) = save(Recording((channel,)), stream, format="h5")
        assert note == "the floating-point values of 'a' are kept, not the counts behind them"
        assert read(stream.getvalue())[0].stored.tobytes() == x.tobytes()

    def test_wide_gaps_are_refused(self) -> None:
        far = Channel(np.zeros(2), 10, (Span(0, 1), Span(1 << 40, (1 << 40) + 1)))
        with pytest.raises(LimitError, match=r"the gaps take 8796093022200 bytes as NaN in \.h5"):
            save(Recording((far,)), io.BytesIO(), format="h5")

    def test_pipes(self) -> None:
        class Pipe(io.RawIOBase):
            taken = b""

            def writable(self) -> bool:
                return True

            def write(self, data: Any) -> int:
                self.taken += bytes(data)
                return len(data)

        pipe = Pipe()
        save(self.example(), pipe, format="h5")  # type: ignore[arg-type]
        assert [*map(facts, read(pipe.taken))] == [*map(facts, self.example())]

    def test_text_that_hdf5_cannot_hold(self, tmp_path: Path) -> None:
        bad = Recording((Channel(np.zeros(2), 10, label="a\0b"),))
        with pytest.raises(ParameterError, match=r"cannot be written as HDF5: .*NULL"):
            save(bad, tmp_path / "x.h5")
        assert not list(tmp_path.iterdir())


def refused(fill: Callable[[Any], object], match: str, **options: Any) -> None:
    with pytest.raises((ParameterError, LimitError), match=match):
        read_made(fill, **options)


class TestHostile:
    def noted(self, fill: Callable[[Any], object]) -> str:
        def both(file: Any) -> None:
            put(file, "good", np.arange(100.0), fs=10)
            fill(file)

        found = read_made(both)
        assert found.labels == ["good"]
        return "; ".join(notes(found))

    def test_links_in_a_circle(self) -> None:
        def fill(file: Any) -> None:
            group = file.create_group("a")
            group["again"] = group
            group["top"] = file["/"]
            file["soft"] = h5py.SoftLink("/soft")
            file["other"] = h5py.ExternalLink("/etc/passwd", "/x")

        found = self.noted(fill)
        assert "/a/again is another name of an object" in found
        assert "/a/top is another name" in found
        assert "/soft is a link to /soft" in found
        assert "/other is a link to another file, which is not read" in found

    def test_values_that_lie_elsewhere(self, tmp_path: Path) -> None:
        secret = tmp_path / "secret"
        secret.write_bytes(bytes(800))

        def fill(file: Any) -> None:
            layout = h5py.VirtualLayout((100,), "f8")
            layout[:] = h5py.VirtualSource("other.h5", "x", (100,))
            file.create_virtual_dataset("virtual", layout)
            file.create_dataset("outside", (100,), "f8", external=[(secret, 0, 800)])

        found = self.noted(fill)
        assert "/virtual is not read: it is a virtual data set" in found
        assert "/outside is not read: its values lie in another file" in found

    def test_types(self) -> None:
        def fill(file: Any) -> None:
            file["refs"] = np.array([file.ref] * 3, h5py.ref_dtype)
            file.create_dataset("ragged", (3,), h5py.vlen_dtype("f4"))
            file["complex"] = np.zeros(9, complex)
            file["opaque"] = np.zeros(3, "V5")
            file["long"] = np.zeros(9, np.longdouble)
            file["none"] = h5py.Empty("f8")
            file["texts"] = ["a", "b"]

        found = self.noted(fill)
        for text in (
            "references",
            "rows of different lengths",
            "complex",
            "/opaque",
            "/none is em",
        ):
            assert text in found, text

    def test_fill_values_and_chunks(self) -> None:
        """1 TB that was never written; a chunk that would be read whole."""

        def fill(file: Any) -> None:
            file.create_dataset("tera", (1 << 37,), "f8", chunks=(1 << 16,), compression="gzip")
            big = file.create_dataset(
                "chunk", (1 << 27,), "u1", chunks=(1 << 27,), compression="gzip"
            )
            big.id.write_direct_chunk((0,), zlib.compress(bytes(1 << 10)))

        tracemalloc.start()
        found = self.noted(fill)
        assert tracemalloc.get_traced_memory()[1] < 32 << 20
        tracemalloc.stop()
        assert "/tera is not read: 1099511627776 bytes are declared, 0 are stored" in found
        assert "/chunk is not read: 134217728 bytes are declared" in found

    def test_a_chunk_that_unpacks_to_more(self) -> None:
        bomb = zlib.compress(bytes(80 << 20), 9)

        def fill(file: Any) -> None:
            one = file.create_dataset("bomb", (1000,), "f8", chunks=(1000,), compression="gzip")
            one.id.write_direct_chunk((0,), bomb)

        assert "/bomb is not read: a chunk is longer than it declares" in self.noted(fill)

    def test_a_stored_chunk_that_is_longer(self) -> None:
        """lzf makes up to 88 bytes of one."""

        def fill(file: Any) -> None:
            one = file.create_dataset("bomb", (1000,), "f8", chunks=(1000,), compression="lzf")
            one.id.write_direct_chunk((0,), bytes(1 << 20))

        assert "/bomb is not read: a chunk is longer than it declares" in self.noted(fill)

    def test_without_h5py(self, monkeypatch: pytest.MonkeyPatch) -> None:
        data = made(lambda file: put(file, "x", np.zeros(99), fs=10))
        monkeypatch.setitem(sys.modules, "h5py", None)
        for format in ("hdf5", "mat"):
            with pytest.raises(MissingExtraError, match=r"hapfmt\[hdf5\]"):
                read(data, format=format)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[hdf5\]"):
            save(Recording((Channel(np.zeros(9), 5),)), io.BytesIO(), format="h5")

    def test_a_text_that_is_repeated(self) -> None:
        """4000 texts, each a million characters, would take 4 GB."""

        def fill(file: Any) -> None:
            file.attrs.create("labels", np.array(["x"] * 3000, object), dtype=h5py.string_dtype())
            file.attrs["long"] = "y" * 1_000_000

        data = bytearray(made(lambda file: (put(file, "good", np.zeros(99), fs=10), fill(file))))
        assert "labels" not in read(bytes(data)).metadata["attributes"]["/"]

    def test_a_heap_that_has_no_end(self) -> None:
        """HDF5 reads an entry of size 0 again and again."""

        def fill(file: Any) -> None:
            put(file, "good", np.zeros(99), fs=10)
            file.attrs["subject"] = "S1"

        data = bytearray(made(fill))
        assert read(bytes(data)).metadata["attributes"]["/"]["subject"] == "S1"
        at = data.index(b"GCOL\x01") + 16
        while data[at : at + 2] != bytes(2):
            at += 16 + -(-int.from_bytes(data[at + 8 : at + 16], "little") // 8) * 8
        data[at + 8 : at + 16] = bytes(8)
        found = read(bytes(data))
        assert found.labels == ["good"]
        assert notes(found) == [
            "attribute 'subject' of / is not read: its texts are damaged or too long"
        ]

    def test_all_texts_together(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Compressed texts, which take no space in the file."""
        monkeypatch.setattr("hapfmt.convert.hdf5_files.ALL_TEXTS_SIZE", 30_000)

        def fill(file: Any) -> None:
            put(file, "good", np.zeros(99), fs=10)
            for number in range(9):
                packed = {"compression": "gzip", "chunks": True}
                file.create_dataset(f"t{number}", data=np.array([b"x" * 9999] * 2), **packed)

        about = read_made(fill).metadata
        assert [*about["attributes"]["/"]] == ["t0", "t1"]
        assert "the texts of /t2 are not read: they are too many" in about["notes"][0]

    def test_filters(self) -> None:
        hdf5plugin = pytest.importorskip("hdf5plugin")

        def fill(file: Any) -> None:
            file.create_dataset("x", data=np.arange(5000.0), **hdf5plugin.Blosc())

        found = self.noted(fill)
        assert "/x is not read: it is compressed by blosc (HDF5 filter 32001)" in found
        assert "h5repack -f GZIP=4 rewrites" in found

    @pytest.mark.parametrize("filters", [{"compression": "lzf"}, {"fletcher32": True}])
    def test_filters_of_h5py(self, filters: dict[str, Any]) -> None:
        x = RNG.random(5000)
        found = read_made(lambda file: file.create_dataset("x", data=x, **filters), rate=10)
        assert np.array_equal(found[0].stored, x)

    def test_deep_and_many(self) -> None:
        refused(lambda file: file.create_group("/".join("a" * 40)), "more than 32 deep")
        refused(lambda file: file.create_group("a" * 600), "a name has 600 characters")
        refused(
            lambda file: put(file, "x", np.zeros((2, 40_000)), fs=1), "more than", transpose=True
        )

    def test_sizes_are_checked_first(self) -> None:
        def fill(file: Any) -> None:
            put(file, "x", np.zeros(1 << 20), fs=10)

        refused(fill, "the values take 8388608 bytes, more than the 1000000", max_memory=1_000_000)

        def timed(file: Any) -> None:
            put(file, "x", np.zeros(1 << 18))
            put(file, "t", np.arange(1 << 18) / 100)

        refused(timed, "the times of 262144 rows take about", max_memory=1_000_000)

    @pytest.mark.parametrize(
        ("times", "error"),
        [
            (np.full(99, np.nan), "not finite"),
            (np.full(99, 1e300), "beyond the year 2262"),
            (np.full(99, 2**62), "do not rise"),
            (739_000 + np.arange(99) / 86_400, "datenum"),
            (np.zeros(99), "the last time is not after the first"),
        ],
    )
    def test_times(self, times: Any, error: str) -> None:
        def fill(file: Any) -> None:
            put(file, "x", np.zeros(99))
            put(file, "t", times)

        refused(fill, error)

    def test_ours_with_a_wrong_member(self) -> None:
        stream = io.BytesIO()
        save(TestOurLayout().example(), stream, format="h5")
        whole = stream.getvalue()
        changes: dict[str, Callable[[Any], object]] = {
            "version 2 ": lambda f: f.attrs.modify("version", 2),
            "do not have the places": lambda f: f["rate_1000Hz/y"].attrs.modify("index", 7),
            "the attribute start_tick": lambda f: f["rate_1000Hz"].attrs.modify("start_tick", -1),
            "spans that overlap": lambda f: f["spans/0"].write_direct(np.array([[0, 99], [95, 155]])),
            "does not name spans": lambda f: f["rate_1000Hz/force|x"].attrs.modify("spans", "/a"),
            "is a link": lambda f: f.__setitem__("rate_1000Hz/z", h5py.SoftLink("/rate_1000Hz/y")),
            "is not one row": lambda f: f.__setitem__("rate_1000Hz/z", np.zeros((2, 2))),
            "names channel 9 of 3": lambda f: f["events/channel"].__setitem__(0, 9),
            "is not the time of an event": lambda f: f["events/time"].__setitem__(0, "1/x"),
            "not a rate": lambda f: f["rate_1000Hz"].attrs.modify("rate", "fast"),
            "not an object|not a JSON object|cannot be read": lambda f: f["metadata"].__setitem__((), "[1]"),
        }  # fmt: skip
        for error, change in changes.items():
            copy = io.BytesIO(whole)
            with h5py.File(copy, "r+") as file:
                change(file)
            with pytest.raises(HapfmtError, match=error):
                read(copy.getvalue())

    def test_any_damage_gives_a_recording_or_our_error(self) -> None:
        stream = io.BytesIO()
        save(TestOurLayout().example(), stream, format="h5")
        foreign = made(lambda f: (put(f, "a/x", np.arange(50)), put(f, "a/t", np.arange(50) / 10)))
        rng = np.random.default_rng(3)
        for whole in (stream.getvalue(), foreign):
            damaged = [whole[:size] for size in range(0, len(whole), len(whole) // 40)]
            for _ in range(examples(200)):
                at = int(rng.integers(len(whole)))
                damaged.append(whole[:at] + bytes([rng.integers(256)]) + whole[at + 1 :])
            for data in damaged:
                try:
                    read(data, format="h5", max_memory=1 << 22)
                except (HapfmtError, OSError) as error:
                    assert str(error)


def test_advice_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "c.h5").write_bytes(made(lambda f: put(f, "x", np.zeros((6, 6)))))
    done = run("info", "c.h5", cwd=tmp_path)
    assert b"give a rate (--rate), or a map that says" in done.stderr and done.returncode == 1


@pytest.mark.deep  # the commands of docs/hdf5-and-mat.md always run
def test_on_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(
        made(lambda f: put(f, "wrench", np.arange(3000.0).reshape(1000, 3), fs=500, units="N"))
    )
    done = run("info", path.name, cwd=tmp_path)
    assert done.returncode == 0 and b"HDF5: 3 channels" in done.stdout, done.stderr
    assert run("encode", path.name, "a.hapf", cwd=tmp_path).returncode == 0
    assert run("convert", "a.hapf", "b.h5", cwd=tmp_path).returncode == 0
    back = hapfmt.read(tmp_path / "b.h5")
    assert np.array_equal(back["wrench.2"].samples(), np.arange(2, 3000.0, 3))
