"""The demo picture: written for every kind of recording, and the same bytes for the same data."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from hapfmt import plotting
from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.plotting import demo

pytest.importorskip("matplotlib")


def parts(n, *, knots=None):
    t = np.arange(n) / 1000
    d = 1 + 0.2 * np.sin(3 * t)
    f = d + 0.03 * np.sin(500 * t)
    y = d + np.round((f - d) / 0.005) * 0.005
    half = np.maximum(0.1 * d, 0.01)
    return {
        "original": f,
        "lf": d,
        "reconstruction": y,
        "lower": d - half,
        "upper": d + half,
        "rate_hz": 1000,
        "knots": np.arange(0, n, 50) if knots is None else knots,
        "error_bound": 0.0025,
    }


MAGIC = {".png": b"\x89PNG\r\n\x1a\n", ".svg": b"<?xml", ".pdf": b"%PDF-"}


@pytest.mark.parametrize("suffix", MAGIC)
def test_kinds(tmp_path, suffix):
    path = tmp_path / f"demo{suffix}"
    plotting.plot_demo(path, **parts(500), title="a title")
    assert path.read_bytes().startswith(MAGIC[suffix])


def test_same_data_same_picture(tmp_path):
    for name in ("a.png", "b.png"):
        plotting.plot_demo(tmp_path / name, **parts(300))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("n", [1, 2, 50, 30_000])
def test_any_length(tmp_path, n):
    plotting.plot_demo(tmp_path / "n.png", **parts(n), start_s=5.0)


def test_awkward(tmp_path):
    """Gaps, no knots, lossless, a deadband of no width, no bound."""
    with_gap = parts(400, knots=np.zeros(0, int))
    with_gap["original"][100:200] = np.nan
    plotting.plot_demo(tmp_path / "gap.png", **with_gap)
    lossless = parts(400) | {"error_bound": None}
    lossless |= {"reconstruction": lossless["original"]}
    lossless |= {"lower": lossless["lf"], "upper": lossless["lf"]}
    plotting.plot_demo(tmp_path / "lossless.png", **lossless, zoom_start_s=0.0)
    silent = {key: np.zeros(400) for key in ("original", "lf", "reconstruction", "lower", "upper")}
    plotting.plot_demo(tmp_path / "silent.png", **(parts(400) | silent))


def test_outline_keeps_peaks():
    x = np.zeros(100_000)
    x[77_777] = 5
    x[33_333] = -3
    at, least, most = demo._outline(np.arange(x.size) / 1e3, x)
    assert at.size <= demo.OUTLINE_POINTS / 2
    assert most.max() == 5 and least.min() == -3
    time, line = demo._line(np.arange(x.size) / 1e3, x)
    assert time.size == line.size <= demo.OUTLINE_POINTS
    assert np.all(np.diff(time) >= 0)
    short = np.arange(10.0)
    assert demo._line(short, short)[1] is short


def test_refused(tmp_path):
    good = parts(100)
    for changes, message in (
        ({"lf": good["lf"][:50]}, "one length"),
        ({"rate_hz": 0}, "rate"),
        ({"zoom_start_s": 99.0}, "outside"),
        ({key: np.zeros(0) for key in good if key not in ("rate_hz", "error_bound")}, "not empty"),
    ):
        with pytest.raises(ParameterError, match=message):
            plotting.plot_demo(tmp_path / "x.png", **(good | changes))
    with pytest.raises(ParameterError, match=r"\.svg"):
        plotting.plot_demo(tmp_path / "x.gif", **good)
    assert not list(tmp_path.iterdir())


def test_missing_matplotlib(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"hapfmt\[plot\]"):
        plotting.plot_demo(tmp_path / "x.png", **parts(100))


def test_imports_nothing_heavy_and_never_pyplot(tmp_path):
    code = (
        "import sys, numpy as np, hapfmt.plotting as p\n"
        "assert 'matplotlib' not in sys.modules\n"
        "x = np.ones(30)\n"
        f"p.plot_demo({str(tmp_path / 'x.png')!r}, original=x, lf=x, reconstruction=x,"
        " lower=x - 1, upper=x + 1, rate_hz=10, knots=np.array([0, 29]))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
