"""tools/bench.py: its recipes keep their bounds, and it runs with whatever peers are installed."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

import hapfmt
from hapfmt import Settings
from hapfmt.encoder.effort import without

sys.path.insert(0, str(ROOT / "tools"))

import speeds
from peers import exact, packages, relative, zipped
from results import Cell, Row, mean

SOME = np.random.default_rng(3).integers(-900, 900, 400).cumsum()


def row(coder: str, coded: int, file: int, family: str = "log", outside: int = 0) -> Row:
    return Row("r", "t", coder, family, 1, 80, coded, file, outside, 0.5, 0.1, 0.1, 1)


@pytest.mark.parametrize("coder", exact.integer_coders(), ids=lambda coder: coder.name)
@pytest.mark.parametrize(
    "counts", [SOME, SOME * 300, np.arange(5), np.full(9, -(2**23)), np.array([2**23 - 1, 0])]
)
def test_integers_come_back(coder, counts):
    blob = coder.encode(counts.astype(np.int64), 35.6)
    assert np.array_equal(coder.decode(blob, counts.size), counts)


def test_flac_refuses_what_it_cannot_hold():
    pytest.importorskip("soundfile")
    assert exact.flac_encode(np.array([2**23, 0]), 1000) is None


@pytest.mark.parametrize("coder", exact.double_coders(), ids=lambda coder: coder.name)
def test_doubles_come_back(coder):
    x = np.array([0.1, -0.0, np.inf, 5e-324, 1e300, *np.linspace(0, 1, 50)])
    back = coder.decode(coder.encode(x, 1000.0), x.size)
    assert x.tobytes() == np.asarray(back).tobytes()


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=60),
    st.sampled_from([0.01, 0.1, 0.3, 0.49, 0.7, 0.95]),
    st.sampled_from(["log", "cells"]),
)
def test_companded_cells_keep_the_bound(values, k, family):
    x = np.array(values)
    if not np.ptp(x) > 1e-6:
        return
    floor = 0.002 * float(np.ptp(x))
    compander = relative.companders(k, floor)[family]
    u = compander.compand(x)
    assert np.allclose(compander.inverse(u), x, rtol=1e-9, atol=floor * 1e-9)
    for away in (-1, -0.3, 0, 0.8, 1):
        y = compander.value(u + away * compander.error)
        assert relative.outside(x, y, k, floor)[0] == 0


@pytest.mark.parametrize("k", [0.05, 0.4])
def test_every_recipe_keeps_the_bound(k):
    x = SOME.astype(float)
    floor = 0.002 * float(np.ptp(x))
    for recipe in relative.recipes(k, floor):
        blob = recipe.encode(x, 1000.0)
        assert relative.outside(x, recipe.decode(blob, x.size), k, floor)[0] == 0, recipe.name


def test_a_broken_bound_is_counted():
    x = np.array([0.0, 1.0, 2.0])
    assert relative.outside(x, np.array([0.01, 1.2, 2.0]), 0.1, 0.02) == (1, pytest.approx(2))
    assert relative.outside(x, np.array([np.nan, 1.0, 2.0]), 0.1, 0.02)[0] == 1
    assert relative.outside(x, x[:2], 0.1, 0.02)[0] == 3


def test_cells_compare_with_the_smallest_peer_that_kept_the_bound():
    ours = row("deadband", 50, 90, "ours")
    cell = Cell(ours, [row("a", 100, 120), row("b", 80, 150, "cells")])
    assert (cell.best.coder, cell.best_file.coder) == ("b", "a")
    assert (cell.ratio(), cell.ratio("log"), cell.ratio("native")) == (50 / 80, 0.5, None)
    assert not row("c", 1, 1, outside=2).held
    assert mean([0.5, 2.0]) == pytest.approx(1)


def test_sizes_of_peers():
    assert zipped.coded_size([b"abc", b""]) == 3 + 2 * zipped.SIDE
    whole = zipped.file_size([b"abc" * 50, b""], ["a", "b"], {"unit": "N"})
    assert 150 < whole < 150 + 400


def run(*arguments: str, without: str = "") -> str:
    """The bench on tiny simulated recordings; ``without``: modules that cannot be imported."""
    blocked = f"import sys; sys.modules.update(dict.fromkeys({without.split()!r}));"
    code = f"{blocked} sys.argv[0] = 'bench.py'; import bench; bench.main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "--simulated", "--seconds", "0.2", *arguments],
        cwd=ROOT / "tools", env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.deep
def test_runs_with_what_is_installed(tmp_path):
    path = tmp_path / "out.csv"
    told = run("--task", "deadband,lossless,doubles", "--k", "0.1", "--repeats", "2",
               "--csv", str(path))  # fmt: skip
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    ours = [r for r in rows if r["family"] == "ours"]
    assert {r["task"] for r in ours} == {"deadband k=0.1", "lossless", "doubles"}
    assert all(r["held"] == "True" for r in ours)
    assert all(int(r["coded_size"]) < int(r["file_size"]) for r in ours)
    assert "commit" in told and "Ms/s" in told
    for package in packages.left_out():
        assert package in told.splitlines()[-1]


def test_names_the_peers_that_are_missing():
    every = " ".join(packages.PACKAGES)
    told = run("--task", "lossless", "--only", "cork", without=every)
    assert told.splitlines()[-1].endswith("pip install " + " ".join(packages.PACKAGES.values()))


@pytest.mark.deep
def test_times_are_multiples_of_flac(tmp_path):
    times = json.loads(run("--speed", "--json", "--only", "cork", "--repeats", "1"))
    assert set(times["simulated cork"]) == {*speeds.PRESETS, speeds.DECODED} == {*speeds.WANTED}
    assert all(0 < factor < 1e5 for factor in times["simulated cork"].values())
    run("--picture", str(tmp_path / "p.png"), "--only", "cork", "--repeats", "1")
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


def test_the_price_of_a_search_is_what_is_lost_and_saved_without_it():
    assert speeds.price([(100, 1.0), (100, 3.0)], [(110, 0.5), (100, 1.5)]) == pytest.approx(
        (5, 50)
    )
    walks = speeds.walks()
    with without("cuts"):
        assert not Settings().searches.cuts
        data = speeds.file_of(speeds.shortened(walks, 100), {})
    assert Settings().searches.cuts
    assert hapfmt.read(data).sample_count == 22 * 100


def test_flac_runs_on_counts_of_any_range():
    wide = np.array([0, 1 << 30, -(1 << 30)] * 50, np.int32)
    far = np.arange(1 << 24, (1 << 24) + 50, dtype=np.int32)
    found = speeds.run_flac(hapfmt.Recording((hapfmt.Channel(wide, 1), hapfmt.Channel(far, 1))), 1)
    assert found.size > 100
