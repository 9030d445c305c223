"""The demo picture: written for every kind of recording, and the same bytes for the same data."""

from __future__ import annotations

import io
import subprocess
import sys

import numpy as np
import pytest
from spec import ROOT

from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.lab.plotting import figures as drawing
from hapfmt.lab.plotting import panels
from hapfmt.lab.plotting.figures import Demonstrated

pytest.importorskip("matplotlib")
sys.path.insert(0, str(ROOT / "tools"))
import picture


def parts(n, *, knots=None, **changes):
    t = np.arange(n) / 1000
    d = 1 + 0.2 * np.sin(3 * t)
    f = d + 0.03 * np.sin(500 * t)
    values = {
        "original": f,
        "lf": d,
        "decoded": d + np.round((f - d) / 0.005) * 0.005,
        "half": np.maximum(0.1 * d, 0.01),
        "rate_hz": 1000,
        "knots": np.arange(0, n, 50) if knots is None else knots,
        "sizes": [("float64", 8 * n), ("lossless", n), ("perceptual --no-texture", 9)],
        "title": "a title",
    }
    return Demonstrated(**(values | changes))


MAGIC = {".png": b"\x89PNG\r\n\x1a\n", ".svg": b"<?xml", ".pdf": b"%PDF-"}


@pytest.fixture
def figures(monkeypatch):
    """What would be saved."""
    seen = []
    monkeypatch.setattr(drawing, "save", lambda made, *_args, **_kind: seen.extend(made))
    return seen


@pytest.mark.parametrize("suffix", MAGIC)
def test_kinds(tmp_path, suffix):
    path = tmp_path / f"demo{suffix}"
    drawing.plot_demo(path, parts(500))
    assert path.read_bytes().startswith(MAGIC[suffix])


def test_same_data_same_picture(tmp_path):
    for name in ("a.png", "b.png"):
        drawing.plot_demo(tmp_path / name, parts(300))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("n", [1, 2, 50, 30_000])
def test_any_length(tmp_path, n):
    drawing.plot_demo(tmp_path / "n.png", parts(n))


def test_what_it_says(figures):
    """Numbers of the stretch, the largest error of all, the sizes, one colour for one meaning."""
    drawing.plot_demo("x.png", parts(3000), start_s=1.5)
    (figure,) = figures
    whole, residual, error, sizes = figure.axes
    assert "20 knots instead of 1000 samples" in whole.get_title("left")
    assert "at most 2.5 mN" in error.get_title("left")
    assert whole.get_xlim() == residual.get_xlim() == error.get_xlim() == (1.5, 2.5)
    assert residual.get_ylim() == error.get_ylim()  # the error is small on this scale
    said = [text.get_text() for text in sizes.texts]
    assert said[:4] == ["24 kB", "float64", "3 kB · 8.0 times smaller", "lossless"]
    for axes in (whole, residual, error):
        for line in axes.lines:
            assert line.get_color() == panels.PALETTE[line.get_label()]
    low, high = whole.get_ylim()
    known = parts(3000).original[1500:2500]
    assert high - low < 1.5 * np.ptp(known)


def test_no_word_lies_on_a_panel(figures):
    drawing.plot_demo("x.png", parts(3000))
    (figure,) = figures
    figure.savefig(io.BytesIO(), format="png", dpi=figure.dpi)
    panels = [axes.get_window_extent() for axes in figure.axes]
    words = [figure.legends[0].get_window_extent(), *(t.get_window_extent() for t in figure.texts)]
    assert not any(word.overlaps(panel) for word in words for panel in panels)
    page = figure.get_window_extent()
    for text in figure.axes[-1].texts:
        assert text.get_window_extent().x1 <= page.x1


def test_it_begins_where_the_signal_first_moves(figures):
    late = parts(5000)
    late.original[:3000] = 0
    drawing.plot_demo("x.png", late)
    start, stop = figures[0].axes[0].get_xlim()
    assert start < 3 < stop and stop - start == pytest.approx(1)


def test_awkward(tmp_path):
    """Gaps, no knots, lossless, no residual, silence."""
    with_gap = parts(400, knots=np.zeros(0, int))
    with_gap.original[100:200] = np.nan
    drawing.plot_demo(tmp_path / "gap.png", with_gap)
    good = parts(400)
    lossless = parts(400, decoded=good.original, half=np.zeros(400))
    drawing.plot_demo(tmp_path / "lossless.png", lossless, start_s=0.0)
    drawing.plot_demo(tmp_path / "slow.png", parts(400, decoded=good.lf))
    names = ("original", "lf", "decoded", "half")
    silent = parts(400, **{name: np.zeros(400) for name in names})
    drawing.plot_demo(tmp_path / "silent.png", silent)


def test_refused(tmp_path):
    empty = {name: np.zeros(0) for name in ("original", "lf", "decoded", "half")}
    for changes, message in (
        ({"lf": np.zeros(50)}, "one length"),
        ({"rate_hz": 0}, "positive rate"),
        (empty, "at least one sample"),
    ):
        with pytest.raises(ParameterError, match=message):
            drawing.plot_demo(tmp_path / "x.png", parts(100, **changes))
    with pytest.raises(ParameterError, match="outside"):
        drawing.plot_demo(tmp_path / "x.png", parts(100), start_s=-1)
    with pytest.raises(ParameterError, match=r"\.svg"):
        drawing.plot_demo(tmp_path / "x.gif", parts(100))
    assert not list(tmp_path.iterdir())


def test_the_picture_of_the_readme():
    """A page shows it at 800 pixels, and loads it at once; the tool makes it anew."""
    size, width, height = picture.measured(picture.PICTURE)
    assert size < picture.LARGEST and 800 <= width <= 1200 and height < width


def test_missing_matplotlib(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"hapfmt\[plot\]"):
        drawing.plot_demo(tmp_path / "x.png", parts(100))


def test_imports_nothing_heavy_and_never_pyplot(tmp_path):
    code = (
        "import sys, numpy as np, hapfmt.lab.plotting.figures as p\n"
        "assert 'matplotlib' not in sys.modules\n"
        "x = np.ones(30)\n"
        f"p.plot_demo({str(tmp_path / 'x.png')!r}, p.Demonstrated(x, x, x, x,"
        " np.array([0, 29]), 10, [('float64', 240)]))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


@pytest.mark.parametrize(
    ("least", "most"), [(-2e-11, 2e-11), (1e7, 3e7), (5000.0001, 5000.0004), (0.0, 1e-4)]
)
def test_no_factor_or_offset_lies_above_an_axis(least, most):
    axes = panels.new_figure(4, 3).add_subplot()
    axes.plot([0, 1], [least, most])
    panels.style(axes, "", "", "")
    axes.figure.draw_without_rendering()
    assert axes.yaxis.get_offset_text().get_text() == ""
    shown = [label.get_text().replace("\N{MINUS SIGN}", "-") for label in axes.get_yticklabels()]
    assert len(set(shown)) == len(shown) > 2
    close = 1e-3 * (most - least)
    assert [float(text) for text in shown] == pytest.approx(list(axes.get_yticks()), abs=close)


def test_damage_looks_like_nothing_else():
    def rgb(colour):
        return np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)])

    damage = rgb(panels.DAMAGE)
    others = {colour for colour in panels.PALETTE.values() if colour != panels.DAMAGE}
    assert min(np.linalg.norm(damage - rgb(colour)) for colour in others) > 100
