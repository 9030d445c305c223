"""hapfmt plot and hapfmt compare: pictures as data (pages, axes, labels), files, exit codes."""

from __future__ import annotations

import io
import json
import sys
from contextlib import ExitStack
from fractions import Fraction

import numpy as np
import pytest
from spec import ROOT

import hapfmt
from hapfmt.cli import cli, plot
from hapfmt.cli.parts import open_parts
from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.limits import Limits
from hapfmt.plotting import style
from hapfmt.recording import Calibration, Channel, Recording
from hapfmt.survey.compare import compare, pair_up

pytest.importorskip("matplotlib")
MAGIC = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<?xml", "pdf": b"%PDF-"}


def channel(place=0, n=2000, label=None):
    t = np.arange(n) / 1000
    x = np.round(4000 * (1 + 0.3 * np.sin((3 + place) * t) + 0.02 * np.sin(600 * t)))
    return Channel(
        x.astype(np.int32), Fraction(1000), calibration=Calibration(1, 0, 4000),
        label=f"f{place}" if label is None else label, unit="N", quantity="force",
    )  # fmt: skip


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """a.npz, a.hapf (one channel), cut.hapf (damaged), three.hapf, many.hapf."""
    folder = tmp_path_factory.mktemp("plot")
    one = Recording((channel(),))
    hapfmt.save(one, folder / "a.npz")
    hapfmt.write(one, folder / "a.hapf", hapfmt.Settings.of("default", cluster=Fraction(1, 2)))
    data = (folder / "a.hapf").read_bytes()
    (folder / "cut.hapf").write_bytes(data[: len(data) * 2 // 3])
    archive = hapfmt.Settings.of("archive", fast=True)
    events = [hapfmt.Event(1, "half of $it", channel=0, duration=0.5), hapfmt.Event(0.5, "\x1b[2J")]
    three = Recording(tuple(channel(i, label="$x_" + "y" * 70) for i in range(3)), events=events)
    hapfmt.write(three, folder / "three.hapf")
    hapfmt.write(
        Recording(tuple(channel(i, 200) for i in range(70))), folder / "many.hapf", archive
    )
    return folder


@pytest.fixture
def pages(monkeypatch):
    """What would be saved."""
    seen = []

    def save(figures, file, kind, *, force=False):  # noqa: ARG001
        seen.append((list(figures), kind))

    monkeypatch.setattr(style, "save", save)
    return seen


def run(*words):
    return cli.main([str(word) for word in words], standalone_mode=False)


def check_labels(figure, least):
    """All axes that hold data say what they show; those that share one time line below each other
    say it once."""
    shown = [axes for axes in figure.axes if axes.lines or axes.patches or axes.texts]
    assert len(shown) >= least
    for axes in shown:
        assert axes.get_ylabel()
        below = [
            other for other in figure.axes
            if other.get_position().x0 == pytest.approx(axes.get_position().x0, abs=0.02)
        ]  # fmt: skip
        assert any(other.get_xlabel() for other in below)
    return shown


def test_one_channel(room, pages):
    assert (
        run("plot", room / "a.hapf", "--output", room / "x.png", "--against", room / "a.npz") == 0
    )
    ((figure,), kind) = pages[0]
    assert kind == "png"
    shown = check_labels(figure, 6)
    assert [axes.get_title("left").split(" ")[0] for axes in shown] == [
        "f0:", "0.4", "texture", "error:", "spectrum", "errors", "the",
    ]  # fmt: skip
    whole = shown[0].get_legend_handles_labels()[1]
    assert whole == ["deadband", "original", "decoded", "slow part (LF)", "knots"]
    assert [axes.get_xlabel() for axes in shown[-3:]] == [
        "frequency in Hz", "error in N", "error / half width",
    ]  # fmt: skip
    assert shown[0].get_ylabel() == "force in N" and shown[0].get_xlim() == (0, 2)


def test_any_format_and_a_stretch(room, pages):
    assert (
        run("plot", room / "a.npz", "--output", room / "x.svg", "--start", "0.5", "--stop", "1")
        == 0
    )
    figure = pages[0][0][0]
    assert figure.axes[0].get_xlim() == (0.5, 1)
    assert [axes.get_title("left").split(" ")[0] for axes in check_labels(figure, 2)] == [
        "f0:", "spectrum",
    ]  # fmt: skip


def test_a_few_channels_have_rows(room, pages):
    assert run("plot", room / "three.hapf", "--output", room / "x.pdf") == 0
    figures = pages[0][0]
    assert len(figures) == 4  # a page for all, and one for each
    check_labels(figures[0], 6)
    figures[0].savefig(io.BytesIO(), format="png", dpi=20)  # texts of strangers are no formulas
    texts = [text.get_text() for axes in figures[0].axes for text in axes.texts]
    assert any(r"half of \$it" in text for text in texts)
    assert not any("\x1b" in text for text in texts)


def test_many_channels_are_small_multiples(room, pages, capsys):
    assert run("plot", room / "many.hapf", "--output", room / "x.png") == 0
    assert run("plot", room / "many.hapf", "--output", room / "x.pdf") == 0
    assert "first of 2 pages" in capsys.readouterr().err
    (one, _), (both, _) = pages
    assert len(one) == 1 and [len(figure.axes) for figure in both] == [35, 35]
    assert run("plot", room / "many.hapf", "--output", room / "x.png", "--channels", "f3,69") == 0
    assert [len(figure.axes) for figure in pages[2][0]] == [4]


def test_damage_is_drawn_and_reported(room, pages, capsys):
    assert run("plot", room / "cut.hapf", "--output", room / "x.png") == 3
    figure = pages[0][0][0]
    told = capsys.readouterr().err
    assert "cut.hapf" in told
    assert "findings" in figure.get_supxlabel()


@pytest.mark.parametrize("kind", MAGIC)
def test_files_whole_or_not_at_all(room, kind, tmp_path):
    path = tmp_path / f"x.{kind}"
    words = ["plot", room / "a.hapf", "--output", path, "--stop", "0.2"]
    assert run(*words) == 0
    first = path.read_bytes()
    assert first.startswith(MAGIC[kind])
    with pytest.raises(ParameterError, match="only with force"):
        run(*words)
    if kind == "png":
        assert run(*words, "--force") == 0
    assert list(tmp_path.iterdir()) == [path]


def test_to_a_pipe(room, monkeypatch):
    class Pipe:
        buffer = io.BytesIO()

        def isatty(self):
            return False

    monkeypatch.setattr(sys, "stdout", Pipe())
    assert (
        run("plot", room / "a.npz", "--output", "-", "--output-format", "svg", "--stop", "0.1") == 0
    )
    assert Pipe.buffer.getvalue().startswith(MAGIC["svg"])


def test_refused_before_any_work(room, monkeypatch):
    monkeypatch.setattr(plot, "open_parts", None)
    file = room / "a.hapf"
    for words, message in (
        ([], "--window"),
        (["--output", room / "x.gif"], r"\.svg"),
        (["--output", room / "x.png", "--window"], "--window"),
        (["--output", room / "nowhere" / "x.png"], "directory"),
    ):
        with pytest.raises(ParameterError, match=message):
            run("plot", file, *words)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'hapfmt\[plot\]'"):
        run("plot", file, "--output", room / "x.png")
    with pytest.raises(MissingExtraError, match="plot"):
        run("compare", file, file, "--plot", room / "x.png")


def test_a_window_needs_a_display(room, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setitem(sys.modules, "tkinter", None)
    with pytest.raises(ParameterError, match="--output"):
        run("plot", room / "a.hapf", "--window")
    monkeypatch.undo()
    if sys.platform != "linux":
        pytest.skip("elsewhere there is always a display")
    pytest.importorskip("tkinter")
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(ParameterError, match="no display"):
        run("plot", room / "a.hapf", "--window")


def test_the_original_must_fit(room):
    words = ["plot", room / "three.hapf", "--output", room / "x.png", "--against", room / "a.npz"]
    with pytest.raises(ParameterError, match="the original lacks"):
        run(*words)
    with pytest.raises(ParameterError, match="no channel 'z'"):
        run("plot", room / "a.npz", "--output", room / "x.png", "--channels", "z")


def test_memory_that_may_be_taken_is_bounded(room):
    with pytest.raises(hapfmt.errors.LimitError):
        run("plot", room / "a.hapf", "--output", room / "x.png", "--max-memory", "1k")
    assert Limits.of_memory("1k").memory == 1024


class TestCompare:
    def told(self, capsys, *words):
        code = run("compare", *words, "--json")
        return code, json.loads(capsys.readouterr().out)

    def test_identical(self, room, capsys):
        code, told = self.told(capsys, room / "a.hapf", room / "a.hapf")
        assert code == told["exit_code"] == 0 and told["identical"]
        assert told["channels"][0]["largest_counts"] == 0

    def test_different_and_within_tolerance(self, room, capsys):
        pair = room / "a.npz", room / "a.hapf"
        code, told = self.told(capsys, *pair)
        (row,) = told["channels"]
        assert code == told["exit_code"] == 3 and row["verdict"] == "differs"
        assert row["sample_count"] == 2000 and 0 < row["rms"] < row["largest"] < 0.1
        assert row["snr_hf_db"] < row["snr_db"]
        assert self.told(capsys, *pair, "--tolerance", row["largest"])[0] == 0
        assert self.told(capsys, *pair, "--tolerance", row["largest"] / 2)[0] == 3
        assert run("compare", *pair, "--tolerance", "5%") == 0
        assert "1 within tolerance" in capsys.readouterr().out

    def test_damage(self, room, capsys):
        code, told = self.told(capsys, room / "a.hapf", room / "cut.hapf")
        (row,) = told["channels"]
        assert (
            code == 3 and row["only_a_count"] > 0 == row["only_b_count"] == row["differing_count"]
        )

    def test_picture(self, room, pages, capsys):
        words = [room / "a.npz", room / "cut.hapf", "--plot", room / "both.png"]
        assert run("compare", *words) == 3
        capsys.readouterr()
        (figure,) = pages[0][0]
        shown = check_labels(figure, 3)
        assert shown[0].get_legend_handles_labels()[1] == ["A", "B", "B has a gap"]
        assert "samples in one only" in shown[0].get_title("left")
        assert "findings" in figure.get_supxlabel()

    def test_refused(self, room):
        with pytest.raises(ParameterError, match="only one of A and B"):
            run("compare", "-", "-")
        with pytest.raises(ParameterError, match="Neither recording has samples"):
            run(
                "compare",
                room / "a.npz",
                room / "a.npz",
                "--start",
                "5",
                "--stop",
                "6",
                "--plot",
                room / "x.png",
            )


@pytest.mark.deep
def test_every_vector_gives_a_picture_or_one_of_our_errors():
    """And what can be read is the same as itself."""
    drawn = 0
    for path in sorted((ROOT / "conformance" / "vectors").rglob("*.hapf"))[::4]:
        with ExitStack() as opened:
            try:
                pair = [
                    open_parts(str(path), None, None, Limits.of_memory("64M")) for _ in range(2)
                ]
                for parts in pair:
                    opened.callback(parts.close)
                plot.draw(pair[0], None, path.name, None, None, False)
                rows, _ = compare(*pair, pair_up(*pair), views=True)
            except hapfmt.errors.HapfmtError:
                continue
            assert all(row.identical for row in rows), path
            drawn += 1
    assert drawn > 100
