"""Pictures of opinions: what is drawn where."""

from __future__ import annotations

import itertools

import pytest

from hapfmt.errors import ParameterError
from hapfmt.lab.plotting import figures
from hapfmt.lab.plotting.figures import plot_opinions
from hapfmt.lab.study.description import SCALE
from hapfmt.lab.study.summary import SummaryRow, mean_of


def row(name, role="test", k=None, bits=None, values=(50.0, 60.0, 70.0)) -> SummaryRow:
    return SummaryRow(name, role, None, mean_of(values), mean_of([0.0, 0.0]), k, bits, 1.0)


GRID = [
    row("same", "reference", values=(95.0, 96.0)),
    *(row(f"{k} {b}", "test", k, b) for k, b in itertools.product((0.05, 0.2), (2, 8))),
    row("slow", "anchor", 0.1, 0, values=(10.0,)),
]


@pytest.fixture
def drawn(monkeypatch):
    """The figure, in place of its file."""
    pytest.importorskip("matplotlib")
    found = []
    monkeypatch.setattr(figures, "save", lambda figures, *_, **__: found.extend(figures))

    def draw(rows, **how):
        found.clear()
        plot_opinions("x.png", rows, scale=SCALE, **how)
        return found[0].axes[0]

    return draw


def test_grid(drawn):
    axes = drawn(GRID, title="a $ b")
    bars = axes.containers
    assert [bar.get_label() for bar in bars] == ["8 bits", "2 bits"]
    for bar in bars:
        line, _, (spans,) = bar
        assert list(line.get_ydata()) == [60, 60] and line.get_xdata() == pytest.approx(
            [5, 20], abs=0.2
        )
        (low, high) = spans.get_segments()[0][:, 1]
        assert (low, high) == pytest.approx((60 - 24.8414, 60 + 24.8414), abs=1e-4)
    texts = [text.get_text() for text in axes.texts]
    assert texts == ["same", "slow", *SCALE] and axes.get_title("left") == r"a \$ b"


def test_side_by_side_where_there_is_no_grid(drawn):
    for rows in (GRID[:2] + GRID[-1:], [row("a", k="2lsb", bits=2), row("b", k=0.1, bits=2)]):
        axes = drawn(rows)
        assert [text.get_text() for text in axes.get_xticklabels()] == [r.condition for r in rows]
        assert [bar[0].get_ydata()[0] for bar in axes.containers] == [r.rating.mean for r in rows]


def test_files(tmp_path):
    pytest.importorskip("matplotlib")
    for kind in ("png", "svg", "pdf"):
        plot_opinions(tmp_path / f"a.{kind}", GRID, scale=SCALE)
        assert (tmp_path / f"a.{kind}").stat().st_size > 1000
    with pytest.raises(ParameterError, match="already exists"):
        plot_opinions(tmp_path / "a.png", GRID, scale=SCALE)
    with pytest.raises(ParameterError, match=r"\.png, \.svg, \.pdf"):
        plot_opinions(tmp_path / "a.txt", GRID, scale=SCALE)
    with pytest.raises(ParameterError, match="No opinions"):
        plot_opinions(tmp_path / "b.png", [], scale=SCALE)
