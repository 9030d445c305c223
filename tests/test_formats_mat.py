"""MAT: files that scipy wrote are read exactly; ours come back whole; hostile ones are refused."""

from __future__ import annotations

import io
import json
import re
import struct
import sys
import time
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
from formats import damaged, survives, written
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt.convert import imported, read, save
from hapfmt.convert.formats import Source
from hapfmt.convert.mat import version_of
from hapfmt.convert.mat5_files import tree_of_mat5
from hapfmt.convert.mat73_files import tree_of_mat73
from hapfmt.convert.mat_layout import identifiers
from hapfmt.errors import LimitError, MissingExtraError, ParameterError
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

pytestmark = pytest.mark.filterwarnings("ignore::hapfmt.errors.MovedTimesWarning")
RNG = np.random.default_rng(1)


def made(packed: bool = True, **variables: Any) -> bytes:
    """A file that scipy writes."""
    from scipy.io import savemat

    stream = io.BytesIO()
    savemat(stream, variables, do_compression=packed, oned_as="column")
    return stream.getvalue()


def cells(*values: Any) -> Any:
    found = np.empty(len(values), object)
    found[:] = values
    return found


def notes(recording: Recording) -> list[str]:
    return list(recording.metadata.get("notes", []))


# ------------------------------------------------------------------ files made of their elements


def element(kind: int, content: bytes, order: str = "<") -> bytes:
    return struct.pack(order + "II", kind, len(content)) + content + bytes(-len(content) % 8)


def head(order: str = "<") -> bytes:
    start = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8)
    return start + struct.pack(order + "H", 0x0100) + (b"IM" if order == "<" else b"MI")


def matrix(
    name: str,
    shape: tuple[int, ...],
    content: bytes,
    kind: int = 6,
    flags: int = 0,
    order: str = "<",
) -> bytes:
    """``content``: what follows the name."""
    return element(
        14,
        element(6, struct.pack(order + "II", kind | flags, 0), order)
        + element(5, struct.pack(f"{order}{len(shape)}i", *shape), order)
        + element(1, name.encode(), order)
        + content,
        order,
    )


def opaque(name: str, kind: str) -> bytes:
    texts = b"".join(element(1, text.encode()) for text in (name, "MCOS", kind))
    return element(14, element(6, struct.pack("<II", 17, 0)) + texts + matrix("", (1, 1), b""))


def packed(data: bytes) -> bytes:
    small = zlib.compress(data)
    return struct.pack("<II", 15, len(small)) + small


GOOD = matrix("fs", (1, 1), element(9, struct.pack("<d", 100.0))) + matrix(
    "x", (50, 1), element(9, np.arange(50.0).tobytes())
)


class TestVersion5:
    @pytest.mark.parametrize("is_packed", [False, True])
    @pytest.mark.parametrize(
        ("given", "kept"),
        [
            ("i1", "int32"), ("i2", "int32"), ("i4", "int32"), ("u1", "int32"), ("u2", "int32"),
            ("?", "int32"), ("u4", "uint64"), ("u8", "uint64"), ("i8", "int64"), ("f4", "float32"),
            ("f8", "float64"),
        ],
    )  # fmt: skip
    def test_dtypes(self, given: str, kept: str, is_packed: bool) -> None:
        dtype = np.dtype(given)
        x = np.zeros(600, dtype)
        if dtype.kind in "iu":
            x[:2] = np.iinfo(dtype).min, np.iinfo(dtype).max
        elif dtype.kind == "f":
            x[:3] = np.finfo(dtype).max, np.finfo(dtype).smallest_subnormal, -0.0
        else:
            x[::3] = True
        found = read(made(is_packed, x=x, fs=10))[0]
        assert found.stored.dtype == kept and found.rate == 10
        assert found.is_counts == (kept == "int32")
        assert found.stored.tobytes() == x.astype(kept).tobytes()

    @pytest.mark.parametrize("is_packed", [False, True])
    def test_structures_with_times(self, is_packed: bool) -> None:
        ticks = np.delete(np.arange(1000), np.arange(400, 430))
        x = RNG.normal(size=(970, 3))
        wrench = {
            "time": ticks / 500 + 1_700_000_000, "data": x, "unit": "Newton",
            "labels": cells("fx", "fy", "fz"),
        }  # fmt: skip
        found = read(made(is_packed, wrench=wrench, fs=9.0))
        assert found.labels == ["fx", "fy", "fz"]
        for row, channel in zip(x.T, found, strict=True):
            assert np.array_equal(channel.stored, row)
            assert (channel.rate_exact, channel.unit) == (500, "N")
            assert channel.coverage == (Span(0, 400), Span(430, 1000))
        assert found.epoch_ns == 1_700_000_000 * 10**9
        assert found.metadata["source_units"]["fx"] == "Newton"
        assert "missing rows: 30, gaps: 1" in notes(found)[-1]
        assert "9 Hz" not in str(notes(found))

    def test_structure_of_simulink(self) -> None:
        """signals is an array of structures, each with values, dimensions and a label."""
        x, v = RNG.normal(size=(300, 2)), RNG.normal(size=300)
        signals = [
            {"values": x, "dimensions": 2, "label": "pos"},
            {"values": v, "dimensions": 1, "label": "vel"},
        ]
        given = {"time": np.arange(300) / 100, "signals": signals, "blockName": "m/scope"}
        found = read(made(sim=given))
        assert found.labels == ["pos.0", "pos.1", "vel"]
        assert np.array_equal(found["pos.1"].stored, x[:, 1])
        assert np.array_equal(found["vel"].stored, v)
        assert {channel.rate for channel in found} == {100}

    def test_a_workspace(self) -> None:
        """Arrays that share a time vector; others have a rate."""
        t = np.arange(400) / 800
        found = read(made(t=t, force=np.sin(t), slow=np.arange(99.0), slow_time=np.arange(99) / 10))
        assert {c.label: c.rate for c in found} == {"force": 800, "slow": 10}
        assert np.array_equal(found["force"].stored, np.sin(t))

    @pytest.mark.parametrize("transposed", [False, True])
    def test_a_column_of_times(self, transposed: bool) -> None:
        t = np.delete(np.arange(500), [7, 8]) * 4
        x = np.column_stack([RNG.normal(size=498), t, RNG.normal(size=498)])
        labels = cells("fx [N]", "time [ms]", "fy [mN]")
        found = read(made(log={"data": x.T if transposed else x, "labels": labels}))
        assert [(c.label, c.unit, c.rate) for c in found] == [("fx", "N", 250), ("fy", "mN", 250)]
        assert np.array_equal(found["fy"].stored, x[:, 2])
        assert found[0].coverage == (Span(0, 7), Span(9, 500))

    def test_a_column_of_times_by_a_map(self, tmp_path: Path) -> None:
        t = np.arange(500) * 4
        data = made(log=np.column_stack([t, np.arange(500) * 0.5, np.arange(500) * 2.0]))
        with pytest.raises(
            ParameterError, match=r"/log \(500 x 3 float64\).* which column is time"
        ):
            read(data)
        path = tmp_path / "map.toml"
        text = "[[table]]\ndata = 'log'\ntime_column = 0\ntime_unit = 'ms'\nlabels = ['a', 'b']\n"
        path.write_text(text)
        found = read(data, map=path)
        assert found.labels == ["a", "b"] and {c.rate for c in found} == {250}
        assert np.array_equal(found["b"].stored, np.arange(500) * 2.0)
        path.write_text(text.replace("= 0", "= 3"))
        with pytest.raises(
            ParameterError, match=r"time_column: /log .* no such column \(at line 3"
        ):
            read(data, map=path)
        path.write_text(text.replace("'log'", "['log', 'x']"))
        with pytest.raises(
            ParameterError, match=r"time_column: is for one data set .*\(at line 3\)"
        ):
            read(data, map=path)

    def test_shapes(self) -> None:
        skin = np.arange(600).reshape(100, 2, 3)
        x = np.arange(300.0).reshape(100, 3)
        found = read(made(skin=skin, wide=x.T, tall=x, fs=100))
        assert np.array_equal(found["skin.1.2"].stored, skin[:, 1, 2])
        assert np.array_equal(found["wide.1"].stored, x[:, 1])
        assert np.array_equal(found["tall.1"].stored, x[:, 1])
        with pytest.raises(ParameterError, match="either side of /x"):
            read(made(x=np.zeros((6, 6)), fs=1))
        assert read(made(x=np.eye(6), fs=1), transpose=True).labels == [f"x.{i}" for i in range(6)]

    def test_cells(self) -> None:
        """Numbered from 1, as MATLAB does."""
        trials = cells(np.arange(90.0), np.arange(80.0))
        data = made(trials=trials, fs=10, subject="S1", names=cells("a", "b"))
        found = read(data)
        assert found.labels == ["trials.1", "trials.2"]
        assert np.array_equal(found["trials.2"].stored, np.arange(80.0))
        assert read(data, select="trials/2").labels == ["trials.2"]
        about = found.metadata["attributes"]["/"]
        assert about == {"fs": 10, "subject": "S1", "names": ["a", "b"]}

    def test_texts(self) -> None:
        wide = matrix("w", (1, 2), element(17, "\N{OHM SIGN}x".encode("utf-16-le")), 4)
        rows = matrix("r", (2, 3), element(4, "acb  d".encode("utf-16-le")), 4)
        found = read(head() + GOOD + wide + rows).metadata["attributes"]["/"]
        assert found == {"fs": 100.0, "w": "\N{OHM SIGN}x", "r": ["ab", "c d"]}
        assert (
            read(made(x=np.zeros(9), fs=1, s="\N{OHM SIGN}")).metadata["attributes"]["/"]["s"]
            == "\N{OHM SIGN}"
        )

    def test_the_other_byte_order(self) -> None:
        x = np.arange(-25.0, 25.0)
        data = head(">")
        data += matrix("fs", (1, 1), element(3, b"\x00\x64", ">"), order=">")
        data += matrix("x", (50, 1), element(9, x.astype(">f8").tobytes(), ">"), order=">")
        found = read(data)
        assert found[0].rate == 100 and np.array_equal(found[0].stored, x)

    def test_what_is_not_read(self) -> None:
        from scipy.sparse import eye_array

        parts = [opaque("tt", "timetable"), opaque("names", "string"), opaque("model", "ss")]
        parts.append(matrix("f", (1, 1), matrix("", (0, 0), b""), 16))
        parts.append(matrix("old", (1, 1), element(1, b"inline"), 3))
        parts.append(made(s=eye_array(9), c=np.array([1j, 2]))[128:])
        found = "\n".join(notes(read(head() + GOOD + b"".join(parts))))
        for text in (
            "/tt is an object of the class timetable, which only MATLAB reads; in MATLAB, s = struct",
            "/names is an object of the class string, which only MATLAB reads; in MATLAB, cellstr",
            "/model is an object of the class ss, which only MATLAB reads; store it as an array",
            "/f is a function, which is not read",
            "/old is an object of the class inline",
            "/s is a sparse matrix, which is not read; in MATLAB, full makes",
            "/c is not read: it holds complex numbers",
        ):
            assert text in found
        with pytest.raises(
            ParameterError, match="nothing that is read as a channel: /tt is an obj"
        ):
            read(head() + parts[0])

    @pytest.mark.parametrize("is_packed", [False, True])
    def test_values_come_in_blocks(self, is_packed: bool) -> None:
        """A compressed variable lies in a temporary file; few of its bytes are in memory."""
        x = (np.arange(50_000 * 32) % 99).reshape(-1, 32)
        data = made(is_packed, x=x, fs=100)
        with imported(io.BytesIO(data)) as (_, found):
            assert found.size == x.nbytes
            tracemalloc.start()
            parts = 0
            for block in found.blocks():
                rows = slice(block.first_row, block.first_row + len(block.values[0]))
                assert np.array_equal(np.stack(block.values, 1), x[rows])
                parts += 1
            assert tracemalloc.get_traced_memory()[1] < x.nbytes
            tracemalloc.stop()
        assert parts > 3

    def test_inspecting_reads_no_values(self) -> None:
        """Values that cannot be read are not noticed."""
        data = bytearray(made(x=RNG.random(50_000), fs=10))
        at = len(data) - 20_000
        data[at : at + 50] = bytes(50)
        with imported(bytes(data)) as (_, found):
            assert found.labels == ["x"]
            with pytest.raises(ParameterError, match="a compressed variable"):
                list(found.blocks())

    def test_version_4(self) -> None:
        from scipy.io import savemat

        stream = io.BytesIO()
        savemat(stream, {"x": np.zeros(9)}, format="4")
        with pytest.raises(ParameterError, match=r"of version 5 or 7\.3; .*'-v7'"):
            read(stream.getvalue(), format="mat")


class TestFilesOfMatlab:
    """Those that are installed with SciPy, of MATLAB 5.3 to 8 on three systems."""

    @pytest.fixture
    def files(self) -> list[Path]:
        import scipy.io.matlab

        found = sorted(Path(scipy.io.matlab.__file__).parent.glob("tests/data/*.mat"))
        if not found:
            pytest.skip("SciPy is installed without its test data")
        return found

    @staticmethod
    def tree(path: Path) -> Any:
        with Source(path) as source:
            is_new = version_of(source.head) == 7.3
            tree = tree_of_mat73(source) if is_new else tree_of_mat5(source, 1 << 30)
            return tree, [(array, array.block(0, 0, array.shape[0])) for array in tree.arrays]

    @staticmethod
    def member(value: Any, path: tuple[str, ...]) -> Any:
        for name in path:
            if not name.isdigit():
                value = value[name]
            elif np.ndim(value):  # SciPy gives a single cell as its content
                value = value[int(name) - 1]
        return value

    def test_arrays_are_as_scipy_reads_them(self, files: list[Path]) -> None:
        from scipy.io import loadmat

        compared = 0
        for path in files:
            if not re.search(r"_(5\.3|6|7|8)[._]|endian", path.name) or "hdf5" in path.name:
                continue
            tree, arrays = self.tree(path)
            known = loadmat(path, simplify_cells=True)
            for array, values in arrays:
                other = np.asarray(self.member(known, array.path))
                assert np.array_equal(values.reshape(-1), other.reshape(-1)), (path, array.name)
                compared += 1
            for group, values in tree.groups.items():
                for name, value in values.items():
                    other = self.member(known, (*group, name))
                    if isinstance(value, list):
                        other = [text.rstrip() for text in other]
                    assert value == other, (path, group, name)
                    compared += 1
        assert compared > 60

    def test_version_73(self, files: list[Path]) -> None:
        (path,) = [path for path in files if path.name.startswith("testhdf5_7.4")]
        tree, ((array, values),) = self.tree(path)
        assert array.name == "/testdouble" and not tree.notes
        assert np.array_equal(values, [np.arange(9) * np.pi / 4])

    def test_all_others(self, files: list[Path]) -> None:
        """A recording or our error, also of those that are damaged."""
        damaged = {path.name: survives(path.read_bytes(), "mat", 1 << 30) for path in files}
        assert damaged["corrupted_zlib_data.mat"] is None
        assert damaged["corrupted_zlib_checksum.mat"] is None


def made_73(fill: Callable[[Any], object]) -> bytes:
    """As MATLAB lays out version 7.3: 512 bytes of its own before the HDF5 file."""
    import h5py

    stream = io.BytesIO()
    with h5py.File(stream, "w", userblock_size=512) as file:
        fill(file)
    start = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    return start + stream.getvalue()[128:]


def put(file: Any, path: str, x: Any, kind: str = "double", **attributes: Any) -> Any:
    """An array as MATLAB stores it: the sides the other way round."""
    x = np.asarray(x)
    data = file.create_dataset(path, data=x.T if x.ndim > 1 else x.reshape(1, -1))
    data.attrs["MATLAB_class"] = np.bytes_(kind)
    data.attrs.update(attributes)
    return data


def put_text(file: Any, path: str, text: str) -> Any:
    codes = np.frombuffer(text.encode("utf-16-le"), np.uint16)[None]
    return put(file, path, codes, "char", MATLAB_int_decode=2)


def put_references(file: Any, path: str, parts: list[Any], kind: str = "") -> None:
    import h5py

    data = file.create_dataset(path, data=np.array([[part.ref] for part in parts], h5py.ref_dtype))
    if kind:
        data.attrs["MATLAB_class"] = np.bytes_(kind)


class TestVersion73:
    def test_workspace(self) -> None:
        """Arrays, structures, arrays of structures, cells, texts, logical values."""
        x, y = RNG.normal(size=(300, 3)), RNG.normal(size=300)
        skin = np.arange(3000).reshape(300, 2, 5).astype(np.int16)

        def fill(file: Any) -> None:
            put(file, "wrench/data", x)
            put(file, "wrench/time", np.arange(300) / 500)
            put_text(file, "wrench/unit", "N")
            names = [put_text(file, f"#refs#/{c}", f"f{c}") for c in "xyz"]
            put_references(file, "wrench/labels", names, "cell")
            file["wrench"].attrs["MATLAB_class"] = np.bytes_("struct")
            put(file, "sim/time", np.arange(300) / 100)
            values = [put(file, f"#refs#/v{i}", y * i) for i in (1, 2)]
            labels = [put_text(file, f"#refs#/l{i}", f"s{i}") for i in (1, 2)]
            put_references(file, "sim/signals/values", values)
            put_references(file, "sim/signals/label", labels)
            put(file, "skin", skin, "int16")
            put(file, "skin_time", np.arange(300) / 50)
            put(file, "on", y > 0, "logical", MATLAB_int_decode=1)
            put(file, "on_time", np.arange(300) / 50)
            put(file, "empty", np.zeros(2, np.uint64), MATLAB_empty=1)

        found = read(made_73(fill))
        assert found.labels[:5] == ["on", "s1", "s2", "skin.0.0", "skin.0.1"]
        assert [(c.label, c.unit, c.rate) for c in found][-3:] == [
            ("fx", "N", 500), ("fy", "N", 500), ("fz", "N", 500),
        ]  # fmt: skip
        assert np.array_equal(found["fy"].stored, x[:, 1])
        assert np.array_equal(found["s2"].stored, y * 2) and found["s2"].rate == 100
        assert np.array_equal(found["skin.1.3"].stored, skin[:, 1, 3])
        assert np.array_equal(found["on"].stored, y > 0)
        assert not notes(found)
        assert "MATLAB_class" not in json.dumps(found.metadata)

    def test_as_version_5(self) -> None:
        """The same variables in both versions are the same recording."""
        x = RNG.normal(size=(90, 4))
        t = np.arange(90) / 30

        def fill(file: Any) -> None:
            put(file, "a/t", t)
            put(file, "a/x", x)
            put(file, "fs", 7.0)

        new, old = read(made_73(fill)), read(made(a={"t": t, "x": x}, fs=7.0))
        assert [*map(facts, new)] == [*map(facts, old)] and new.metadata == old.metadata

    def test_what_is_not_read(self) -> None:
        import h5py

        def fill(file: Any) -> None:
            put(file, "fs", 10.0)
            put(file, "x", np.zeros(99))
            put(file, "tt", np.zeros(6, np.uint32), "timetable", MATLAB_object_decode=3)
            put(file, "f", np.zeros(6, np.uint32), "function_handle", MATLAB_object_decode=1)
            put(file, "c", np.zeros(9, complex))
            file.create_group("sp").attrs["MATLAB_sparse"] = np.uint64(9)
            file["far"] = h5py.ExternalLink("/etc/passwd", "/x")
            put(file, "#subsystem#/MCOS", np.zeros(9))

        found = read(made_73(fill))
        assert found.labels == ["x"]
        shown = "\n".join(notes(found))
        for text in (
            "/tt is an object of the class timetable, which only MATLAB reads; in MATLAB, s = struct",
            "/f is a function", "/c is not read: it holds", "/sp is a sparse matrix",
            "/far is a link to another file, which is not read",
        ):  # fmt: skip
            assert text in shown
        assert "subsystem" not in shown

    def test_long_texts(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("hapfmt.convert.hdf5_files.ALL_TEXTS_SIZE", 30_000)

        def fill(file: Any) -> None:
            put(file, "fs", 10.0)
            put(file, "x", np.zeros(99))
            put_text(file, "a_long", "x" * (1 << 20) + "x")
            for number in range(4):
                put_text(file, f"t{number}", "x" * 20_000)

        about = read(made_73(fill)).metadata
        assert [*about["attributes"]["/"]] == ["fs", "t0", "t1"]
        assert "the text /a_long is too long, and is not read" in about["notes"]
        assert "the text /t2 is too long, and is not read" in about["notes"]

    def test_cells_in_a_circle(self) -> None:
        def fill(file: Any) -> None:
            import h5py

            put(file, "fs", 10.0)
            put(file, "x", np.zeros(99))
            cell = file.create_dataset("a", (2, 1), h5py.ref_dtype)
            cell.attrs["MATLAB_class"] = np.bytes_("cell")
            cell[0], cell[1] = cell.ref, file["x"].ref

        found = read(made_73(fill))
        assert len(found) == 1
        assert "/a/1 is another name of an object" in "\n".join(notes(found))


def near(recording: Recording) -> Recording:
    """With the same gaps, but nearer to tick 0, so that they fit in memory."""
    channels = []
    for place, channel in enumerate(recording):
        shift = channel.start_tick - channel.start_tick % 4096
        spans = tuple(Span(a - shift, b - shift) for a, b in channel.coverage)
        channels.append(replace(channel, coverage=spans, label=f"{place} {channel.label}"))
    return replace(recording, channels=tuple(channels))


DESCRIBED = (
    "rate_exact", "coverage", "calibration", "label", "unit", "quantity", "axis", "group",
    "body_site", "device", "deviation", "lsb",
)  # fmt: skip
MEMBERS = (
    "epoch_ns", "epoch_uncertainty_ns", "metadata", "attachments", "events", "clocks", "clock_maps",
)  # fmt: skip


def facts(channel: Channel) -> tuple[Any, ...]:
    stored = channel.stored
    return (
        str(stored.dtype), stored.tobytes(), *(getattr(channel, name) for name in DESCRIBED),
    )  # fmt: skip


class TestOurLayout:
    @given(data=st.data())
    @settings(max_examples=examples(60), suppress_health_check=list(HealthCheck), deadline=None)
    def test_everything_comes_back(self, data: st.DataObject) -> None:
        given = near(data.draw(strategies.recordings().flatmap(strategies.clocked)))
        back = read(written(given, "mat")[0])
        assert [*map(facts, back)] == [*map(facts, given)]
        for name in MEMBERS:
            assert getattr(back, name) == getattr(given, name), name

    def example(self) -> Recording:
        counts = np.arange(-50, 50, dtype=np.int16)
        spans = (Span(5, 45), Span(100, 160))
        return Recording(
            (
                Channel(counts, 1000, spans, Calibration(3, 7, 1000), "force/x", "N", lsb=0.003),
                Channel(np.arange(95.0), 1000, (Span(20, 115),), label="y"),
                Channel(np.arange(7, dtype=np.float16), "44100/7", label="slow"),
                Channel(np.array([2**63 - 1]), 3, label="one"),
            ),
            epoch_ns=1_700_000_000 * 10**9,
            events=(Event(Fraction(1, 3), "tap", Fraction(1, 10), 1, "hand"),),
            metadata={"subject": "S1"},
            attachments={"a.bin": ("", b"\x05"), "b": ("text/plain", b"hello"), "c": ("", b"")},
        )

    def test_others_understand_it(self, tmp_path: Path) -> None:
        """As scipy reads it: a structure for each rate with times, values, units and scales."""
        from scipy.io import loadmat

        given = self.example()
        assert save(given, tmp_path / "x.mat") == ()
        found = loadmat(tmp_path / "x.mat", simplify_cells=True)
        fast = found["rate_1000Hz"]
        assert (fast["fs"], fast["units"]) == (1000, {"force_x": "N", "y": "1"})
        assert np.array_equal(fast["time"], np.arange(5, 160) / 1000)
        assert fast["force_x"].dtype == np.int16 and not fast["force_x"][40:95].any()
        physical = fast["force_x"] * fast["scale"]["force_x"] + fast["offset"]["force_x"]
        assert np.allclose(physical[:40], given[0].samples()[:40], rtol=1e-15)
        assert np.isnan(fast["y"][:15]).all() and np.array_equal(fast["y"][15:110], np.arange(95.0))
        assert found["rate_6300Hz"]["slow"].dtype == np.float32
        assert found["rate_3Hz"]["one"] == 2**63 - 1
        assert found["events"] == {"time": 1 / 3, "duration": 0.1, "text": "tap", "layer": "hand"}
        assert found["attachments"]["a2"].tobytes() == b"hello"
        assert json.loads(found["hapfmt"])["metadata"] == {"subject": "S1"}

    def test_without_the_header(self) -> None:
        """A file without our text is read as any other: each structure has times."""
        from scipy.io import loadmat, savemat

        found = loadmat(io.BytesIO(written(self.example(), "mat")[0]))
        found["rate_1000Hz"] = found["rate_1000Hz"]
        stream = io.BytesIO()
        savemat(stream, {"rate_1000Hz": found["rate_1000Hz"]})
        back = read(stream.getvalue())
        assert [(c.label, c.unit) for c in back] == [("force_x", "N"), ("y", "1")]
        assert back[1].rate_exact == 1000
        assert np.array_equal(back["y"].stored, np.arange(95.0))

    def test_the_same_recording_gives_the_same_bytes(self) -> None:
        assert written(self.example(), "mat") == written(self.example(), "mat")

    def test_without_scipy(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """It writes MAT files; hapfmt itself reads them."""
        data = written(self.example(), "mat")[0]
        monkeypatch.setitem(sys.modules, "scipy.io", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[mat\]"):
            written(self.example(), "mat")
        assert read(data).labels == self.example().labels

    def test_select(self) -> None:
        data = written(self.example(), "mat")[0]
        back = read(data, select=["y", "sl*"])
        assert back.labels == ["y", "slow"] and [e.channel for e in back.events] == [0]
        with pytest.raises(ParameterError, match="no channel 'z'"):
            read(data, select="z")

    def test_names(self) -> None:
        texts = ["fx", "fx", "time", "1x", "\N{OHM SIGN}", "", "a b", "a.b", "z" * 80, "z" * 81]
        found = identifiers(texts, ("time",))
        assert found[:8] == ["fx", "fx_2", "time_2", "ch4_1x", "ch5", "ch6", "a_b", "a_b_2"]
        assert found[8:] == ["z" * 63, "z" * 61 + "_2"]
        texts = ["fx", "f:x", "f;x", "time", "1x", "\N{OHM SIGN}", "", "z" * 80, "z" * 81]
        given = Recording(tuple(Channel(np.zeros(3), 5, label=text) for text in texts))
        assert read(written(given, "mat")[0]).labels == texts

    def test_wide_gaps_and_long_variables_are_refused(self) -> None:
        far = Channel(np.zeros(2), 10, (Span(0, 1), Span(1 << 40, (1 << 40) + 1)))
        with pytest.raises(LimitError, match=r"the gaps take 8796093022200 bytes as NaN in \.mat"):
            written(Recording((far,)), "mat")
        long = Channel(np.zeros(2), 10, (Span(0, 1), Span(1 << 27, (1 << 27) + 1)))
        with pytest.raises(LimitError, match="a variable of a MAT file at most 2147483647; write"):
            written(Recording((long,)), "mat", max_memory=1 << 40)

    def test_hostile_changes(self) -> None:
        """Each member of the text with a value that does not belong there."""
        from scipy.io import loadmat, savemat

        whole = loadmat(io.BytesIO(written(self.example(), "mat")[0]))
        whole = {name: value for name, value in whole.items() if not name.startswith("__")}
        about = json.loads(str(whole["hapfmt"][0]))

        def refused(change: Callable[[Any], object]) -> str:
            copy = json.loads(json.dumps(about))
            change(copy)
            stream = io.BytesIO()
            savemat(stream, {**whole, "hapfmt": json.dumps(copy)})
            with pytest.raises((ParameterError, LimitError)) as caught:
                read(stream.getvalue())
            return str(caught.value)

        first = ("channels", 0)

        def to(value: Any, *keys: Any) -> Callable[[Any], None]:
            def change(at: Any) -> None:
                for key in keys[:-1]:
                    at = at[key]
                at[keys[-1]] = value

            return change

        for error, change in {
            "version 2 ": to(2, "version"),
            "is missing, or does not hold 155 int16": to("y", *first, "field"),
            "the attribute table": to(1 << 20, *first, "table"),
            "the attribute rows": to(-1, "tables", 0, "rows"),
            "not a rate": to("fast", "tables", 0, "rate"),
            "holds object values|not understood|holds <U": to("U9", *first, "dtype"),
            "spans that overlap": to([[0, 99], [95, 155]], *first, "spans"),
            "is not of integers": to([1, 2, 0.5], *first, "calibration"),
            "names channel 9 of 4": to(9, "events", 0, 3),
            "is not the time of an event": to("1/x", "events", 0, 0),
            "cannot be read": to(5, "metadata"),
            "the attribute table is not": to({}, "channels", 1),
        }.items():
            assert re.search(error, refused(change)), error


class TestHostile:
    def refused(self, data: bytes, match: str, **options: Any) -> None:
        with pytest.raises((ParameterError, LimitError), match=match):
            read(data, format="mat", **options)

    def test_sizes(self) -> None:
        """Each is checked before anything is allocated."""
        tracemalloc.start()
        large = (1 << 30, 1 << 30)
        self.refused(head() + matrix("x", large, element(9, bytes(80))), "holds 80 bytes")
        self.refused(head() + matrix("x", (-1, 5), element(9, b"")), "no sizes of a matrix")
        self.refused(head() + struct.pack("<II", 14, 1 << 31), "truncated")
        self.refused(head() + matrix("x", large, b"", 1), "cells, more than")
        names = element(5, struct.pack("<i", 8)) + element(1, b"a".ljust(8, b"\0"))
        self.refused(head() + matrix("x", large, names, 2), "entries, more than")
        self.refused(head() + matrix("x", large, element(5, b"") + element(1, b""), 2), "entries")
        self.refused(head() + matrix("x", (1,) * 99, b""), "no sizes")
        odd = element(14, element(6, bytes(8)) + element(5, bytes(9)) + element(1, b"x"))
        self.refused(head() + odd, "no sizes")
        self.refused(head() + matrix("x", (1, 1), b"", 99), "unknown class 99")
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
        tracemalloc.stop()

    def test_deep(self) -> None:
        inner = matrix("", (1, 1), element(9, bytes(8)))
        for _ in range(100):
            inner = matrix("", (1, 1), inner, 1)
        self.refused(head() + matrix("x", (1, 1), inner, 1), "more than 32 deep")

    def test_many(self) -> None:
        few = matrix("", (0, 0), b"")
        self.refused(head() + matrix("x", (1, 19_999), few * 19_999, 1) + GOOD, "more than 20000")

    def test_long_names_and_many_notes(self) -> None:
        """A note names its variable, so that long names could take any memory."""
        handle = matrix("", (1, 1), matrix("", (0, 0), b""), 16)
        many = matrix("c", (1, 5000), handle * 5000, 1)
        found = notes(read(head() + GOOD + many))
        assert len(found) == 1001 and found[-1].startswith("more is not read")
        self.refused(head() + matrix("x" * 600, (1, 1), b""), "holds no name")

    def test_bombs(self) -> None:
        """A variable that unpacks to 40 MB, and one that unpacks to more than it states."""
        zeros = matrix("x", (5 << 20, 1), element(9, bytes(40 << 20)))
        bomb = head() + packed(zeros) + GOOD
        tracemalloc.start()
        self.refused(bomb, "take", max_memory=20 << 20)
        assert tracemalloc.get_traced_memory()[1] < 8 << 20
        tracemalloc.stop()
        longer = packed(
            matrix("x", (50, 1), element(9, np.arange(50.0).tobytes())) + bytes(1 << 20)
        )
        fs = matrix("fs", (1, 1), element(9, struct.pack("<d", 100.0)))
        self.refused(head() + fs + longer, "a compressed variable is longer than it states")

    @pytest.mark.deep
    def test_many_arrays_take_no_longer_each(self) -> None:
        """3000 trials with times of their own: they took 29 s when each was compared with all."""
        t = np.arange(20) / 10
        trials = cells(*({"time": t, "x_time": t, "x": np.zeros(20)} for _ in range(3000)))
        data = made(False, trials=trials)
        before = time.process_time()
        assert len(read(data, select="trials/7/*")) == 1
        assert time.process_time() - before < 10

    def test_a_text_that_is_long(self) -> None:
        text = matrix("note", (1, 3 << 20), element(16, b"x" * (3 << 20)), 4)
        found = read(head() + GOOD + packed(text))
        assert notes(found) == ["the text /note is too long, and is not read"]

    def test_sizes_are_checked_first(self) -> None:
        data = made(x=np.zeros(1 << 20), fs=10)
        self.refused(
            data, "the values take 8388608 bytes, more than the 1000000", max_memory=1_000_000
        )
        timed = made(x=np.zeros(1 << 18), t=np.arange(1 << 18) / 100)
        self.refused(timed, "the times of 262144 rows take about", max_memory=1_000_000)

    def test_any_damage_gives_a_recording_or_our_error(self) -> None:
        ours = written(TestOurLayout().example(), "mat")[0]
        wrench = {"time": np.arange(50) / 10, "data": np.ones((50, 2)), "labels": cells("a", "b")}
        plain = made(False, w=wrench, s=[{"values": np.zeros(50)}] * 2, c=cells("x", 5.0), fs=1)
        newer = made_73(lambda f: (put(f, "a/x", np.arange(50)), put(f, "a/t", np.arange(50) / 10)))
        for whole in (ours, plain, newer):
            for data in damaged(whole, 30, examples(150)):
                survives(data, "mat")


@pytest.mark.deep  # the commands of docs/hdf5-and-mat.md always run
def test_on_the_command_line(tmp_path: Path) -> None:
    x = np.arange(3000.0).reshape(1000, 3)
    (tmp_path / "a.mat").write_bytes(made(wrench={"data": x, "fs": 500, "unit": "N"}))
    done = run("info", "a.mat", cwd=tmp_path)
    assert done.returncode == 0 and b"MAT: 3 channels" in done.stdout, done.stderr
    assert run("encode", "a.mat", "a.hapf", cwd=tmp_path).returncode == 0
    assert run("convert", "a.hapf", "b.mat", cwd=tmp_path).returncode == 0
    back = hapfmt.read(tmp_path / "b.mat")
    assert np.array_equal(back["wrench.2"].samples(), np.arange(2, 3000.0, 3))
