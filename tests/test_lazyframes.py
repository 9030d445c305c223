"""Tables that are read on demand: ``scan_hapf`` of Polars; and ``to_arrow``."""

from __future__ import annotations

import os
import sys
import time
from fractions import Fraction
from importlib.util import find_spec

import numpy as np
import pytest
from depth import examples
from hypothesis import given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt import Channel, Recording, Span
from hapfmt.analysis import lazyframes
from hapfmt.errors import HapfmtError, MissingExtraError, ParameterError

TICKS = 4000


def example() -> Recording:
    """Two channels at 1000/3 Hz; one has a gap and begins late, and one holds a NaN."""
    fx = np.sin(np.arange(TICKS) / 50)
    fx[1000:1500] = np.nan
    fy = np.arange(TICKS - 100.0)
    fy[7] = np.nan
    return Recording(
        (
            Channel.from_physical(fx, Fraction(1000, 3), label="fx", unit="N", axis="x"),
            Channel(fy, Fraction(1000, 3), (Span(100, TICKS),), label="fy", unit="N"),
        ),
        epoch_ns=17 * 10**17,
        metadata={"subject": "S7"},
    )


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("lazy") / "a.hapf"
    hapfmt.write(example(), path)
    return os.fspath(path)


@pytest.mark.skipif(find_spec("pyarrow") is None, reason="needs the extra 'arrow'")
class TestArrow:
    def test_values_and_nulls(self):
        table = example().to_arrow()
        assert table.column_names == ["time", "fx", "fy"] and table.num_rows == TICKS
        assert table["fx"].null_count == 500 and table["fy"].null_count == 100
        assert np.array_equal(table["time"].to_numpy(), example().times())
        assert np.isnan(table["fy"][107].as_py())
        for channel in example():
            got = table[channel.label].to_numpy()
            assert np.array_equal(got, channel.filled(0, TICKS), equal_nan=True)
        assert table.schema.field("fx").metadata[b"unit"] == b"N"

    def test_a_parquet_file_of_it_comes_back(self, tmp_path):
        parquet = pytest.importorskip("pyarrow.parquet")
        parquet.write_table(example().to_arrow(), tmp_path / "a.parquet")
        back = hapfmt.read(tmp_path / "a.parquet")
        assert back.labels == ["fx", "fy"] and back.epoch_ns == example().epoch_ns
        assert back["fx"].rate_exact == Fraction(1000, 3) and back["fx"].unit == "N"
        assert back["fx"].coverage == example()["fx"].coverage and back["fx"].axis == "x"
        assert np.array_equal(back["fx"].to_numpy(), example()["fx"].to_numpy(), equal_nan=True)

    def test_rates_and_names(self):
        two = Recording.from_array({"a": [1.0], "b": [2.0]}, {"a": 1, "b": 2})
        with pytest.raises(ParameterError, match="2 rates"):
            two.to_arrow()
        named = Recording.from_array({"time": [1.0], "": [2.0]}, 10).to_arrow()
        assert named.column_names == ["time", "time (2)", "ch2"]
        assert Recording().to_arrow().num_rows == 0

    def test_without_the_package(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "pyarrow", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[arrow\]"):
            example().to_arrow()


pl = pytest.importorskip("polars", reason="needs the extra 'polars'")


def whole() -> pl.DataFrame:
    table = pl.DataFrame({"time": example().times()})
    for channel in example():
        values = pl.Series(channel.label, channel.filled(0, TICKS))
        missing = np.ones(TICKS, bool)
        for span in channel.coverage:
            missing[span.start : span.stop] = False
        table = table.with_columns(values.set(pl.Series(missing), None))
    return table


numbers = st.sampled_from([0.0, 0.3, 3.0, 12, 1.5, float("nan"), float("inf")]) | st.floats(-1, 13)
comparisons = st.builds(
    lambda name, op, value, turned: getattr(
        pl.lit(value) if turned else pl.col(name), op
    )(pl.col(name) if turned else value),
    st.sampled_from(["time", "time", "fx", "fy"]),
    st.sampled_from(["__lt__", "__le__", "__gt__", "__ge__", "__eq__", "__ne__"]),
    numbers,
    st.booleans(),
)  # fmt: skip
between = st.builds(
    lambda a, b, closed: pl.col("time").is_between(a, b, closed=closed),
    numbers,
    numbers,
    st.sampled_from(["both", "left", "right", "none"]),
)
other = st.sampled_from(
    [pl.col("time").floor() == 3, pl.col("time").is_in([0.3, 0.6]), pl.lit(True)]
)
predicates = st.recursive(
    comparisons | between | other,
    lambda inner: (
        st.builds(lambda a, b: a & b, inner, inner)
        | st.builds(lambda a, b: a | b, inner, inner)
        | st.builds(lambda a: ~a, inner)
    ),
    max_leaves=5,
)


class TestScan:
    @given(predicates, st.lists(st.sampled_from(["time", "fx", "fy"]), unique=True, min_size=1),
           st.none() | st.integers(0, 500))  # fmt: skip
    @settings(max_examples=examples(150), deadline=None)
    def test_any_query_gives_what_it_gives_of_the_whole_table(self, file, predicate, columns, rows):
        wanted = whole().lazy().filter(predicate).select(columns)
        found = hapfmt.scan_hapf(file).filter(predicate).select(columns)
        if rows is not None:
            wanted, found = wanted.head(rows), found.head(rows)
        assert found.collect().equals(wanted.collect())

    def test_only_what_is_needed_is_decoded(self, file, monkeypatch):
        asked = []
        read = lazyframes.read_ticks
        monkeypatch.setattr(
            lazyframes, "read_ticks", lambda *given: asked.append(given[1:]) or read(*given)
        )
        lazy = hapfmt.scan_hapf(file)
        assert lazy.collect_schema().names() == ["time", "fx", "fy"] and not asked
        second = lazy.filter(pl.col("time") >= 6, pl.col("time") < 6.3).select("fy").collect()
        assert second.height == 100
        ((refs, first, last),) = asked
        assert [ref.label for ref in refs] == ["fy"]
        assert 1990 < first <= 2000 and 2100 <= last < 2110
        asked.clear()
        assert lazy.filter(pl.col("time") < 0).collect().height == 0
        assert lazy.select(pl.len()).collect().item() == TICKS
        assert lazy.head(10).collect().height == 10
        assert sum(last - first for _, first, last in asked) < 50

    def test_in_batches(self, file, monkeypatch):
        monkeypatch.setattr(lazyframes, "BATCH", 333)
        assert hapfmt.scan_hapf(file).collect().equals(whole())

    def test_channels(self, file, tmp_path):
        assert hapfmt.scan_hapf(file, "fy").collect_schema().names() == ["time", "fy"]
        path = tmp_path / "two.hapf"
        hapfmt.write({"a": [1.0, 2], "b": [2.0]}, path, rate={"a": 1, "b": 2})
        with pytest.raises(ParameterError, match=r"2 rates .*one rate"):
            hapfmt.scan_hapf(path)
        assert hapfmt.scan_hapf(path, ["a"]).collect()["a"].to_list() == [1.0, 2.0]
        hapfmt.write(Recording(), path, force=True)
        assert hapfmt.scan_hapf(path).collect().shape == (0, 1)

    def test_damage_and_change(self, tmp_path):
        path = tmp_path / "a.hapf"
        path.write_bytes(b"nothing")
        with pytest.raises(HapfmtError):
            hapfmt.scan_hapf(path)
        hapfmt.write(np.zeros(10), path, rate=1, force=True)
        lazy = hapfmt.scan_hapf(path)
        hapfmt.write(np.ones(10), path, rate=1, force=True)
        with pytest.raises((OSError, pl.exceptions.ComputeError), match="changed after"):
            lazy.collect()

    def test_a_change_between_two_batches(self, tmp_path, monkeypatch):
        path = tmp_path / "a.hapf"
        hapfmt.write(np.zeros(1000), path, rate=1)
        monkeypatch.setattr(lazyframes, "BATCH", 300)
        read = lazyframes.read_ticks

        def changing(*given):
            found = read(*given)
            if given[2] == 300:
                time.sleep(0.02)  # times of files have steps of up to 10 ms
                hapfmt.write(np.ones(1000), path, rate=1, force=True)
            return found

        monkeypatch.setattr(lazyframes, "read_ticks", changing)
        with pytest.raises((OSError, pl.exceptions.ComputeError), match="changed after"):
            hapfmt.scan_hapf(path).collect()

    def test_without_the_package(self, file, monkeypatch):
        monkeypatch.setitem(sys.modules, "polars", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[polars\]"):
            hapfmt.scan_hapf(file)
