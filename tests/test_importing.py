"""Files of other programs that are encoded while they are read."""

from __future__ import annotations

import dataclasses
import io
import json
import mmap
import os
import signal
import subprocess
import sys
import tracemalloc
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from depth import deep
from hypothesis import given
from hypothesis import strategies as st
from overviews import check_bounds
from test_plugins import install

import hapfmt
from hapfmt import (
    Calibration,
    ClockMap,
    ClockObservation,
    Event,
    LimitError,
    ParameterError,
    Settings,
)
from hapfmt.cli import cli
from hapfmt.convert.formats import formats
from hapfmt.convert.tables import Import, ImportBlock, ImportColumn, ImportTable
from hapfmt.errors import DataWarning
from hapfmt.format.source import open_source
from hapfmt.reading.opening import open_catalogue
from hapfmt.reading.verifier import verify
from hapfmt.writing import importing
from hapfmt.writing.importing import why_whole, write_import

MILLI = Calibration(1, 0, 1000)
COUNTS = ("int8", "uint8", "int16", "uint16", "int32")
WORDS = ("int64", "uint64", "float16", "float32", "float64")
RATES = (Fraction(10), Fraction(1000), Fraction(44100, 7), Fraction(1, 60))


def column(label: str, dtype: str, **more) -> ImportColumn:
    calibration = MILLI if dtype in COUNTS else None
    return ImportColumn(label, "N", dtype=np.dtype(dtype), calibration=calibration, **more)


def import_from(tables, values, order, **more) -> Import:
    """``order``: (table, rows) of each block; what is left comes at the end."""

    def blocks():
        done = [0] * len(tables)
        rest = [(number, table.row_count) for number, table in enumerate(tables)]
        for number, rows in [*order, *rest]:
            first = done[number]
            stop = min(first + rows, tables[number].row_count)
            if stop > first:
                yield ImportBlock(number, first, [x[first:stop] for x in values[number]])
            done[number] = stop

    return Import(tuple(tables), blocks, **more)


@st.composite
def imports(draw) -> Import:
    tables, values = [], []
    for number in range(draw(st.integers(1, 3))):
        rows = draw(st.integers(0, 90))
        columns, arrays = [], []
        rng = np.random.default_rng(draw(st.integers(0, 99)))
        for dtype in draw(st.lists(st.sampled_from(COUNTS + WORDS), min_size=1, max_size=3)):
            columns.append(column(f"{number}.{len(columns)}", dtype))
            kind = np.dtype(dtype)
            if kind.kind == "f":
                x = np.round(rng.normal(0, 9, rows), draw(st.integers(0, 9))).astype(kind)
                x[rng.random(rows) < draw(st.sampled_from([0, 0.3, 1]))] = np.nan
            else:
                info = np.iinfo(kind)
                x = rng.integers(info.min, info.max, rows, kind, endpoint=True)
            arrays.append(x)
        steps = rng.choice([1, 1, 1, 1, 2, 40], rows) if draw(st.booleans()) else None
        ticks = None if steps is None else np.cumsum(steps)
        rate, start = draw(st.sampled_from(RATES)), draw(st.integers(0, 300))
        table = ImportTable(f"t{number}", tuple(columns), rate, rows, ticks, start, kind="k")
        tables.append(table)
        values.append(arrays)
    order = draw(st.lists(st.tuples(st.integers(0, len(tables) - 1), st.integers(1, 40))))
    labels = [c.label for table in tables for c in table.columns]
    return import_from(
        tables,
        values,
        order,
        epoch_ns=draw(st.none() | st.just(1_700_000_000_000_000_000)),
        metadata={"subject": "S1"},
        attachments={"notes.txt": ("text/plain", b"hello")},
        events=(
            Event(Fraction(7, 2), "late", channel=labels[0]),
            Event(0, "first", Fraction(1, 3), layer="marks"),
        ),
        notes=("images of topic /camera are not read",),
        clocks=(ClockObservation("robot", labels[-1], 5, 10**9, 3),),
        clock_maps=(ClockMap("wall", labels[0], ((0, 10), (5, 10**9))),),
    )


def whole(found: Import) -> hapfmt.Recording:
    return found.recording(1 << 30)


def streamed(found: Import, **more) -> bytes:
    stream = io.BytesIO()
    write_import(found, stream, **more)
    return stream.getvalue()


@given(imports(), st.sampled_from(["lossless", "near-lossless"]))
def test_an_overview_is_that_of_what_is_decoded(found: Import, preset: str):
    data = streamed(found, settings=Settings.of(preset), overview=True)
    if any(whole(found).channels):
        check_bounds(data)


class TestLossless:
    @given(imports(), st.sampled_from([1 << 26, 2000]), st.sampled_from([None, 1, 600]))
    def test_the_same_recording_as_in_memory(self, found: Import, room: int, cluster: int | None):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(importing, "WAITING", room)
            patch.setattr(importing, "SEEN", room // 4)
            data = streamed(found, settings=Settings(cluster=cluster))
        assert verify(data).exit_code == 0
        back, given = hapfmt.read(data), whole(found)
        stream = io.BytesIO()
        hapfmt.write(given, stream, Settings(cluster=cluster))
        at_once = hapfmt.read(stream.getvalue())
        assert back.labels == given.labels
        for one, other in zip(back, given, strict=True):
            if not one.stored.size and np.isnan(other.samples()).all():
                continue  # a stream does not know that no number follows
            assert one.coverage == other.coverage and one.rate_exact == other.rate_exact
            assert (one.unit, one.group, one.device) == (other.unit, other.group, other.device)
            if other.stored.dtype.itemsize == 8 and other.stored.dtype.kind in "iu":
                assert np.array_equal(one.stored, other.stored)
            else:
                bits = one.samples().view(np.int64), other.samples().view(np.int64)
                assert np.array_equal(*bits)
        for name in ("metadata", "attachments", "events", "clocks", "clock_maps", "epoch_ns"):
            assert getattr(back, name) == getattr(at_once, name), name
        assert len(back.clocks) == len(back.clock_maps) == 1

    @pytest.mark.parametrize("dtype", COUNTS)
    @pytest.mark.parametrize("large", [False, True])
    def test_the_level_is_that_of_the_counts(self, dtype: str, large: bool):
        info = np.iinfo(dtype)
        x = np.array([info.min, info.max] if large else [-1 if info.min else 0, 100], dtype)
        found = import_from(
            [ImportTable("t", (column("a", dtype),), Fraction(1), 2)], [[x]], [(0, 1)]
        )
        with hapfmt.Reader(streamed(found)) as reader:
            assert reader.catalogue.level.number == (2 if large and dtype == "int32" else 1)
            assert np.array_equal(reader.read()[0].counts, x)

    def test_channels_without_a_sample_are_there(self):
        nothing = np.full(5, np.nan)
        table = ImportTable("t", (column("a", "float64"), column("b", "int16")), Fraction(10), 5)
        empty = ImportTable("u", (column("c", "float32"), column("d", "int16")), Fraction(10), 0)
        found = import_from([table, empty], [[nothing, np.arange(5, dtype=np.int16)], []], [])
        back = hapfmt.read(streamed(found))
        assert back.labels == ["a", "b", "c", "d"]
        assert [channel.stored.size for channel in back] == [0, 5, 0, 0]

    def test_the_form_is_chosen_by_what_moves(self):
        """A sensor that rests first, for longer than a cluster."""
        rng = np.random.default_rng(1)
        x = np.concatenate([np.zeros(5000), rng.normal(0, 1, 5000)]).astype(np.float32)
        table = ImportTable("t", (ImportColumn("a", dtype=x.dtype),), Fraction(1000), x.size)
        found = import_from([table], [[x]], [(0, 100)] * 99)
        size = len(streamed(found, settings=Settings(cluster=1)))
        stream = io.BytesIO()
        assert size < 1.1 * hapfmt.write(whole(found), stream, Settings(cluster=1)).file_size

    def test_canonical(self):
        found = import_from(
            [ImportTable("t", (column("a", "float64"),), Fraction(10), 400)],
            [[np.sin(np.arange(400))]],
            [(0, 30)] * 9,
        )
        one = streamed(found, canonical=7)
        assert one == streamed(found, canonical=7, threads=2) != streamed(found, canonical=8)


class TestBounded:
    @pytest.mark.parametrize(("dtype", "error"), [("float64", 50), ("int16", 0.05)])
    def test_a_bound_that_flattens_is_refused_before_anything_is_written(
        self, dtype, error, tmp_path
    ):
        x = (100 * np.sin(np.arange(400) / 20)).astype(dtype)
        found = import_from(
            [ImportTable("t", (column("a", dtype),), Fraction(10), 400)], [[x]], [(0, 30)] * 9
        )
        target = tmp_path / "a.hapf"
        settings = Settings.of("near-lossless", max_error=error)
        with pytest.raises(ParameterError, match=r"is 25.* % of the range of channel 'a'.* To"):
            write_import(found, target, settings)
        assert not target.exists()
        settings = Settings.of("near-lossless", max_error=error, force_error=True)
        (decision,) = write_import(found, target, settings).decisions
        extent = 4 * error
        expected = pytest.approx(decision.largest_error / extent, rel=0.02)
        assert decision.relative_error == expected

    @given(imports(), st.sampled_from(["0.1%", "1%", "0.05", "2lsb"]))
    def test_no_sample_is_further_off(self, found: Import, error: str):
        force = not error.endswith("%")
        settings = Settings.of("near-lossless", max_error=error, force_error=force)
        back = hapfmt.read(streamed(found, settings=settings))
        for one, other, source in zip(
            back, whole(found), (c for t in found.tables for c in t.columns), strict=True
        ):
            if not one.stored.size and np.isnan(other.samples()).all():
                continue  # a stream does not know that no number follows
            assert one.coverage == other.coverage
            if not other.stored.size or (source.dtype.itemsize == 8 and source.dtype.kind in "iu"):
                continue
            away = np.abs(one.samples() - other.samples()).max()
            extent = np.ptp(other.samples())
            lsb = float(MILLI.step) if source.calibration else 0.0
            allowed = {"0.1%": 0.001 * extent, "1%": 0.01 * extent, "0.05": 0.05, "2lsb": 2 * lsb}
            rounding = np.spacing(np.abs(other.samples()).max())
            assert away <= allowed[error] * (1 + 1e-9) + rounding

    def test_size_and_error_are_those_of_write(self):
        rng = np.random.default_rng(2)
        x = np.sin(np.arange(20000) / 50) + rng.normal(0, 0.02, 20000)
        y = np.round(x * 9000).astype(np.int16)
        table = ImportTable(
            "t", (column("a", "float64"), column("b", "int16")), Fraction(1000), 20000
        )
        found = import_from([table], [[x, y]], [(0, 500)] * 39)
        settings = Settings.of("near-lossless", max_error="0.5%")
        stream = io.BytesIO()
        summary = write_import(found, stream, settings)
        other = hapfmt.write(whole(found), io.BytesIO(), settings)
        assert summary.file_size < 1.05 * other.file_size
        for one, two in zip(summary.decisions, other.decisions, strict=True):
            catalogue = open_catalogue(open_source(stream.getvalue()))
            assert one.kept_as == catalogue.channels[one.channel].kept_as
            bounds = [float(each.kept_as.split()[1]) for each in (one, two)]
            assert bounds[0] == pytest.approx(bounds[1], rel=0.03)
            assert 0.5 * two.largest_error < one.largest_error <= 1.01 * two.largest_error
            assert one.size < 1.05 * two.size and one.sample_count == 20000

    @pytest.mark.parametrize("error", ["0.1%", "0.01"])
    def test_infinite_samples_are_kept_with_a_note(self, error):
        x = np.sin(np.arange(4000) / 50) + np.random.default_rng(2).normal(0, 0.02, 4000)
        x[[7, 8, 900]] = np.inf, -np.inf, np.inf
        table = ImportTable("t", (ImportColumn("a", "N"),), Fraction(1000), x.size)
        found = import_from([table], [[x]], [])
        with pytest.warns(DataWarning, match="'a' is stored without loss: it has infinite samples"):
            data = streamed(found, settings=Settings.of("near-lossless", max_error=error))
        assert hapfmt.read(data).channels[0].samples().tobytes() == x.tobytes()

    def test_values_that_lie_on_a_coarse_grid_stay_lossless(self):
        x = np.tile([0.0, 1.0, 2.0, 1.0], 3000)
        table = ImportTable("t", (ImportColumn("a"),), Fraction(1000), x.size)
        found = import_from([table], [[x]], [])
        summary = write_import(found, io.BytesIO(), Settings.of("near-lossless"))
        assert summary.decisions[0].kept_as == "lossless"

    @pytest.mark.parametrize(
        "given", [{"preset": "perceptual"}, {"preset": "paper"}, {"digest": True}]
    )
    def test_what_needs_the_whole_recording_is_refused(self, given: dict, tmp_path: Path):
        settings = Settings.of(given.pop("preset", "lossless"), **given)
        assert why_whole(settings)
        table = ImportTable("t", (ImportColumn("a"),), Fraction(1000), 1)
        with pytest.raises(ParameterError, match="needs the whole recording in memory"):
            write_import(import_from([table], [[np.zeros(1)]], []), tmp_path / "a.hapf", settings)
        assert not list(tmp_path.iterdir())


def long_import(rows: int, apart: bool) -> Import:
    """Steps that take no time to encode; the tables side by side, or one after the other."""
    names = "ab"
    tables = [
        ImportTable(
            name, tuple(column(f"{name}{i}", "int16") for i in range(4)), Fraction(1000), rows
        )
        for name in names
    ]

    def part(number: int, first: int) -> ImportBlock:
        x = np.full(min(4096, rows - first), first // 4096 + number, np.int16)
        return ImportBlock(number, first, [x] * 4)

    def blocks():
        firsts = range(0, rows, 4096)
        if apart:
            yield from (part(number, first) for number in range(2) for first in firsts)
        else:
            yield from (part(number, first) for first in firsts for number in range(2))

    return Import(tuple(tables), blocks)


class TestMemory:
    @pytest.mark.compiled
    @pytest.mark.parametrize("apart", deep([False, True]))
    def test_it_does_not_grow(self, monkeypatch: pytest.MonkeyPatch, apart: bool, tmp_path: Path):
        monkeypatch.setattr(importing, "WAITING", 1 << 20)
        monkeypatch.setattr(importing, "SEEN", 1 << 19)
        peaks = []
        for rows in (100_000, 800_000):
            found = long_import(rows, apart)
            tracemalloc.start()
            write_import(found, tmp_path / "a.hapf", force=True, threads=1)
            peaks.append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
            assert (found.size > 12 * (1 << 20)) == (rows == 800_000)
        assert max(peaks) < 8 << 20
        back = hapfmt.read(tmp_path / "a.hapf")
        assert back["b3"].counts[[0, 4096, -1]].tolist() == [1, 2, (rows - 1) // 4096 + 1]

    @pytest.mark.deep
    @pytest.mark.capped
    @pytest.mark.compiled
    def test_more_than_the_process_may_take(self, tmp_path: Path):
        found = long_import(20_000_000, apart=False)
        assert found.size > 256 << 20
        with pytest.raises(OSError):  # of a mapping: freed memory could hold a bytearray
            mmap.mmap(-1, found.size)
        summary = write_import(found, tmp_path / "a.hapf", threads=1)
        assert summary.sample_count == 8 * 20_000_000


class TestInterruption:
    @pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, ParameterError, MemoryError])
    @pytest.mark.parametrize("at", [0, 1, 30])
    def test_no_file_is_left(self, tmp_path: Path, error: type[BaseException], at: int):
        table = ImportTable("t", (column("a", "int16"),), Fraction(10), 4000)

        def blocks():
            for number in range(40):
                if number == at:
                    raise error("stop")
                yield ImportBlock(0, 100 * number, [np.full(100, number, np.int16)])

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(importing, "SEEN", 100)
            with pytest.raises(error, match="stop"):
                write_import(Import((table,), blocks), tmp_path / "a.hapf", Settings(cluster=1))
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize(
        ("order", "message"),
        [
            ([(0, 0), (0, 20)], "changed while it was read"),
            ([(0, 0)], "ended before all of its rows"),
            ([(0, 0), (0, 10), (0, 20), (0, 30)], "more rows than were counted"),
        ],
    )
    def test_blocks_that_do_not_fit(self, tmp_path: Path, order, message: str):
        table = ImportTable("t", (column("a", "int16"),), Fraction(10), 30)
        made = [ImportBlock(number, first, [np.zeros(10, np.int16)]) for number, first in order]
        with pytest.raises(ParameterError, match=message):
            write_import(Import((table,), lambda: iter(made)), tmp_path / "a.hapf")
        assert not list(tmp_path.iterdir())

    def test_an_existing_file_stays(self, tmp_path: Path):
        (tmp_path / "a.hapf").write_bytes(b"mine")
        found = long_import(10, apart=False)
        with pytest.raises(ParameterError, match="already exists"):
            write_import(found, tmp_path / "a.hapf")
        with pytest.raises(ParameterError, match=r"hapf files end in \.hapf"):
            write_import(found, tmp_path / "a.npz")
        assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"mine"]
        write_import(found, tmp_path / "a.hapf", force=True)
        assert len(hapfmt.read(tmp_path / "a.hapf")) == 8


LAB = """
import time
from fractions import Fraction
import numpy as np
from hapfmt.convert.formats import Format
from hapfmt.convert.tables import Import, ImportBlock, ImportColumn, ImportTable
FORMAT = Format(name="lab", title="Lab", suffixes=(".lab",), module=__name__)
def read(source, options):
    rows = 5000
    ticks = np.arange(rows) + (np.arange(rows) > 100)
    columns = ImportColumn("x", "m", dtype=np.dtype("f4")), ImportColumn("y", "m")
    table = ImportTable("t", columns, Fraction(1000), rows, ticks)
    def blocks():
        for first in range(0, rows, 500):
            if source.head == b"slow":
                time.sleep(0.1)
            x = np.sin(np.arange(first, first + 500) / 40)
            yield ImportBlock(0, first, [x.astype("f4"), np.round(x, 3)])
    return Import((table,), blocks, notes=("images are not read",))
"""


class TestCommands:
    @pytest.fixture
    def room(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        site = tmp_path / "site"
        site.mkdir()
        monkeypatch.syspath_prepend(str(site))
        install(site, "hapfmt_lab", LAB)
        formats.cache_clear()
        (tmp_path / "a.lab").write_bytes(b"go on")
        (tmp_path / "b.lab").write_bytes(b"slow")
        monkeypatch.chdir(tmp_path)
        yield tmp_path
        formats.cache_clear()
        sys.modules.pop("hapfmt_lab", None)

    def run(self, *words: str) -> int:
        return cli.main(list(words), standalone_mode=False)

    @pytest.mark.parametrize("verb", ["encode", "convert"])
    @pytest.mark.usefixtures("room")
    def test_a_large_input_streams(self, verb: str, capsys, monkeypatch):
        self.run(verb, "a.lab", "whole.hapf")
        monkeypatch.setattr("hapfmt.convert.tables.Import.recording", None)
        labels = ["--labels", "fx, fy", "--unit", "N"]
        self.run(verb, "a.lab", "b.hapf", "--max-memory", "20K", *labels)
        seen = capsys.readouterr()
        assert "images are not read" in seen.err and "1 missing sample in each of 2" in seen.err
        back, other = hapfmt.read("b.hapf"), hapfmt.read("whole.hapf")
        assert back.labels == ["fx", "fy"] and {c.unit for c in back} == {"N"}
        for one, two in zip(back, other, strict=True):
            assert np.array_equal(one.samples(), two.samples()) and one.coverage == two.coverage

    @pytest.mark.usefixtures("room")
    def test_json(self, capsys):
        self.run("encode", "a.lab", "a.hapf", "--json", "--max-memory", "20K")
        found = json.loads(capsys.readouterr().out)
        assert found["sample_count"] == 10000 and found["duration_s"] == 5.001
        assert [each["kept_as"] for each in found["channels"]] == ["lossless"] * 2

    def test_what_cannot_stream_says_why(self, room: Path):
        with pytest.raises(
            LimitError, match="preset perceptual needs the whole recording, and the"
        ):
            self.run("encode", "a.lab", "a.hapf", "--preset", "perceptual", "--max-memory", "20K")
        with pytest.raises(LimitError, match=r"\.npz output needs the whole recording"):
            self.run("convert", "a.lab", "a.npz", "--max-memory", "20K")
        self.run("encode", "a.lab", "a.hapf", "--preset", "perceptual")
        assert not (room / "a.npz").exists()

    @pytest.mark.realtime
    @pytest.mark.skipif(os.name == "nt", reason="no terminal and no SIGINT for a child here")
    @pytest.mark.parametrize("verb", ["encode", *deep(["convert"])])
    def test_an_interrupt_leaves_nothing(self, room: Path, verb: str):
        before = {path.name for path in room.iterdir()}
        words = [verb, "b.lab", "b.hapf", "--max-memory", "20K"]
        ours, theirs = os.openpty()
        done = subprocess.Popen(
            [sys.executable, "-m", "hapfmt", *words], stderr=theirs, stdout=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": str(room / "site")},
        )  # fmt: skip
        os.close(theirs)
        text = b""
        while b"encoding" not in text:
            text += os.read(ours, 1 << 12)  # EIO, so a failure, where it ends before
        assert {path.name for path in room.iterdir()} > before
        done.send_signal(signal.SIGINT)
        assert done.wait(60) == 1
        with suppress(OSError):
            while more := os.read(ours, 1 << 12):
                text += more
        os.close(ours)
        assert b"hapfmt: interrupted" in text and b"Traceback" not in text
        assert {path.name for path in room.iterdir()} == before

    @pytest.mark.usefixtures("room")
    def test_a_lossy_input_is_told(self, capsys, monkeypatch):
        import_of = Import.described
        made = {"encoder": "hapfmt 1: near-lossless"}
        monkeypatch.setattr(
            Import, "described", lambda self: dataclasses.replace(import_of(self), metadata=made)
        )
        for more in ([], ["--max-memory", "20K"]):
            self.run("encode", "a.lab", "c.hapf", "-f", *more)
            assert "the input is already lossy" in capsys.readouterr().err
