"""hapfmt plot and hapfmt compare: pictures as data (pages, axes, labels), files, exit codes."""

from __future__ import annotations

import io
import json
import sys
from contextlib import ExitStack
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from spec import ROOT

import hapfmt
from hapfmt import metrics
from hapfmt.cli import cli, plot
from hapfmt.cli.common import open_parts
from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.lab.compare import compare, pair_up
from hapfmt.lab.parts import RecordingParts
from hapfmt.lab.plotting import figures as drawing
from hapfmt.lab.plotting import pages as layout
from hapfmt.lab.plotting import panels
from hapfmt.lab.plotting.pages import grid_shape, placed
from hapfmt.limits import Limits
from hapfmt.recording import Calibration, Channel, Recording

pytest.importorskip("matplotlib")
from matplotlib.colors import to_hex

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
    hapfmt.write(
        one, folder / "a.hapf", hapfmt.Settings.of("paper", smallest=False, cluster=Fraction(1, 2))
    )
    data = (folder / "a.hapf").read_bytes()
    (folder / "cut.hapf").write_bytes(data[: len(data) * 2 // 3])
    archive = hapfmt.Settings.of("lossless", fast=True, cluster=Fraction(60))
    events = [hapfmt.Event(1, "half of $it", channel=0, duration=0.5), hapfmt.Event(0.5, "\x1b[2J")]
    three = Recording(tuple(channel(i, label="$x_" + "y" * 70) for i in range(3)), events=events)
    hapfmt.write(three, folder / "three.hapf", hapfmt.Settings.of("paper"))
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
        return [str(file)]

    monkeypatch.setattr(panels, "save", save)
    return seen


def run(*words):
    return cli.main([str(word) for word in words], standalone_mode=False)


def check_labels(figure, least):
    """Every panel tells its unit: at its axis, in its title, or once for the page. Panels that
    share one time line below each other name it once."""
    shown = [axes for axes in figure.axes if axes.lines or axes.patches or axes.texts]
    assert len(shown) >= least
    for axes in shown:
        assert axes.get_ylabel() or figure.get_supylabel() or " in " in axes.get_title("left")
        below = [
            other for other in figure.axes
            if other.get_position().x0 == pytest.approx(axes.get_position().x0, abs=0.02)
        ]  # fmt: skip
        assert any(other.get_xlabel() for other in below)
    return shown


def check_palette(figure):
    """One colour for one word of the legend, in every panel, and the legend has every word."""
    found = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            colour = getattr(handle, "get_color", None)
            if colour is None:
                patch = handle.patches[0] if hasattr(handle, "patches") else handle
                faces = np.atleast_2d(patch.get_facecolor())
                colour = lambda faces=faces: tuple(faces[0, :3])  # noqa: E731
            found.setdefault(label, set()).add(to_hex(colour()))
    assert {label: {panels.PALETTE[label]} for label in found} == found
    ((legend,)) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == list(found)
    return set(found)


def check_nothing_lies_on_the_data(figure):
    """Neither the legend nor a line of the header or the footnotes."""
    figure.draw_without_rendering()
    words = [figure.legends[0].get_window_extent(), *(t.get_window_extent() for t in figure.texts)]
    panels = [axes.get_window_extent() for axes in figure.axes]
    assert not any(word.overlaps(panel) for word in words for panel in panels)
    width = figure.get_window_extent().width
    assert all(word.x0 >= 0 and word.x1 <= width for word in words)


def words_of(figure):
    return "\n".join(text.get_text() for text in figure.texts)


def test_one_channel(room, pages):
    assert (
        run("plot", room / "a.hapf", "--output", room / "x.png", "--against", room / "a.npz") == 0
    )
    ((figure,), kind) = pages[0]
    assert kind == "png"
    shown = check_labels(figure, 6)
    assert [axes.get_title("left").split(" ")[0] for axes in shown] == [
        "f0:", "Residual", "Error:", "The", "Spectrum", "How", "The",
    ]  # fmt: skip
    whole = shown[0].get_legend_handles_labels()[1]
    assert whole == ["deadband", "original", "decoded", "slow part (LF)", "knots"]
    assert check_palette(figure) == {*whole, "residual (HF)", "error", "error bound"}
    check_nothing_lies_on_the_data(figure)
    assert [axes.get_xlabel() for axes in shown[-3:]] == [
        "frequency in Hz", "error in mN", "error / half the deadband",
    ]  # fmt: skip
    assert shown[0].get_ylabel() == "force in N" and shown[0].get_xlim() == (0, 2)


def test_the_facts_are_in_the_picture(room, pages):
    assert (
        run("plot", room / "a.hapf", "--output", room / "x.png", "--against", room / "a.npz") == 0
    )
    assert run("plot", room / "three.hapf", "--output", room / "x.png") == 0
    assert run("plot", room / "a.npz", "--output", room / "x.png", "--stop", "1") == 0
    assert run("plot", room / "many.hapf", "--output", room / "x.pdf") == 0
    size = (room / "a.hapf").stat().st_size
    said = words_of(pages[0][0][0])
    for fact in (
        "a.hapf, against its original", "1 channel ", "1000 Hz", "2 s", "2 000 samples",
        f"{16000 / size:.3g} times smaller than float64", "preset ", "largest error 0.",
        "% of range",
    ):  # fmt: skip
        assert fact in said
    assert "largest error " in pages[0][0][0].axes[0].get_title("left")
    assert "3 channels" in words_of(pages[1][0][0])
    assert "from 0 s to 1 s" in words_of(pages[2][0][0])
    assert "smaller" not in words_of(pages[2][0][0])  # the file holds more than is shown
    assert all("every sample lossless" in words_of(figure) for figure in pages[3][0])


def test_the_signal_sets_the_limits_and_not_the_deadband(tmp_path, pages):
    """A voltage far from zero, of which a tenth is eight times its range."""
    x = 8.6 + 0.1 * np.sin(np.arange(4000) / 100)
    wide = Recording((Channel.from_physical(x, 1000, label="u", unit="V", lsb=0.001),))
    hapfmt.save(wide, tmp_path / "u.npz")
    hapfmt.write(
        wide, tmp_path / "u.hapf", hapfmt.Settings.of("paper", smallest=False, k="0.1", floor=0.01)
    )
    many = Recording(wide.channels * 9)
    hapfmt.write(
        many,
        tmp_path / "many.hapf",
        hapfmt.Settings.of("paper", smallest=False, k="0.1", floor=0.01),
    )
    run("plot", tmp_path / "u.hapf", "-o", tmp_path / "u.png", "--against", tmp_path / "u.npz")
    run("plot", tmp_path / "many.hapf", "-o", tmp_path / "u.png")
    (one,), (small,) = (figures for figures, _ in pages)
    for axes in (one.axes[0], *small.axes):
        assert "deadband" in axes.get_legend_handles_labels()[1]
        low, high = axes.get_ylim()
        assert 8.2 < low < 8.51 and 8.69 < high < 9.0


def test_any_format_and_a_stretch(room, pages):
    words = ["plot", room / "a.npz", "--output", room / "x.svg", "--start", "0.5", "--stop", "1"]
    assert run(*words) == 0
    figure = pages[0][0][0]
    assert figure.axes[0].get_xlim() == (0.5, 1)
    assert [axes.get_title("left").split(" ")[0] for axes in check_labels(figure, 2)] == [
        "f0", "Spectrum",
    ]  # fmt: skip


def test_a_few_channels_have_rows(room, pages):
    assert run("plot", room / "three.hapf", "--output", room / "x.pdf") == 0
    figures = pages[0][0]
    assert len(figures) == 4  # a page for all, and one for each
    check_labels(figures[0], 6)
    for figure in figures:
        assert "event" in check_palette(figure)
        check_nothing_lies_on_the_data(figure)  # texts of strangers are no formulas
    texts = [text.get_text() for axes in figures[0].axes for text in axes.texts]
    assert any(r"half of \$it" in text for text in texts)
    assert not any("\x1b" in text for text in texts)
    assert figures[0].get_supylabel() == "force in N"


@pytest.mark.parametrize(
    ("count", "most"), [(14, 8), pytest.param(70, layout.SMALL, marks=pytest.mark.deep)]
)
def test_many_channels_are_small_multiples(room, pages, monkeypatch, count, most):
    monkeypatch.setattr(layout, "SMALL", most)
    labels = [f"f{place}" for place in range(count)]
    words = ["plot", room / "many.hapf", "--output", room / "x.png"]
    assert run(*words, "--channels", ",".join(labels)) == 0
    ((both, _),) = pages
    assert [len(figure.axes) for figure in both] == [count // 2] * 2
    assert [axes.get_title("left") for figure in both for axes in figure.axes] == labels
    for figure in both:
        check_labels(figure, count // 2)
        check_palette(figure)
        check_nothing_lies_on_the_data(figure)
        assert figure.get_supylabel() == "force in N"  # once, and at no panel
        assert not any(axes.get_ylabel() for axes in figure.axes)
    assert run("plot", room / "many.hapf", "--output", room / "x.png", "--channels", "f3,69") == 0
    assert [len(figure.axes) for figure in pages[1][0]] == [4]


def test_every_page_gets_a_file_of_its_own(room, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(layout, "SMALL", 4)
    monkeypatch.setattr(layout, "DETAILED", 0)
    path = tmp_path / "x.png"
    words = ["plot", room / "many.hapf", "--output", path, "--channels", "0,1,2,3,4,5,6"]
    assert run(*words) == 0
    assert "2 pages" in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir()) == ["x-1.png", "x-2.png"]
    (tmp_path / "x-1.png").unlink()
    with pytest.raises(ParameterError, match=r"x-2\.png"):
        run(*words)
    assert [each.name for each in tmp_path.iterdir()] == ["x-2.png"]
    assert run(*words, "--force") == 0
    assert len(list(tmp_path.iterdir())) == 2


def test_grids_are_balanced_and_well_filled():
    for count in range(1, 65):
        check_grid(count)


def check_grid(count):
    columns, rows = grid_shape(count)
    places = placed(list(range(count)), columns)
    assert [view for view, *_ in places] == list(range(count))
    assert len({(row, column) for _, row, column, _ in places}) == count
    sizes = [sum(place[2] == column for place in places) for column in range(columns)]
    assert max(sizes) == rows and max(sizes) - min(sizes) <= 1
    assert columns * rows - count < columns and (count < 7 or 2 <= columns <= 4)
    assert sum(last for *_, last in places) == columns


def test_damage_is_drawn_and_reported(room, pages, capsys):
    assert run("plot", room / "cut.hapf", "--output", room / "x.png") == 3
    figure = pages[0][0][0]
    assert "cut.hapf" in capsys.readouterr().err
    assert "damage in " in words_of(figure)
    check_nothing_lies_on_the_data(figure)


def test_one_damaged_packet_of_many(tmp_path, pages, capsys):
    """One cluster, so that its times are known from its packets alone."""
    data = hapfmt.Settings.of("lossless", fast=True, cluster=Fraction(60))
    rng = np.random.default_rng(1)
    noise = [Channel(rng.integers(-999, 999, 3000).astype(np.int32), 1000) for _ in range(27)]
    hapfmt.write(Recording(tuple(noise)), tmp_path / "a.hapf", data)
    damaged = bytearray((tmp_path / "a.hapf").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (tmp_path / "a.hapf").write_bytes(damaged)
    assert run("plot", tmp_path / "a.hapf", "--output", tmp_path / "x.png") == 3
    assert "lost: channel 13 from 0 s to 3 s" in capsys.readouterr().err
    (figure,) = pages[0][0]
    drawn = [np.isfinite(axes.lines[0].get_ydata()).any() for axes in figure.axes]
    assert drawn == [place != 13 for place in range(27)]
    assert "lost to damage" in figure.axes[13].get_legend_handles_labels()[1]
    assert "lost to damage" in check_palette(figure)
    words = words_of(figure)
    assert "lost: channel 13" in words and "1 of 27 channels lost samples to damage" in words
    assert "every sample lossless" not in words


def test_many_gaps_leave_the_signal_visible(tmp_path, pages):
    """Rows at few of many ticks: no hatches over the panel, and each row is a point."""
    ticks = np.cumsum(np.random.default_rng(1).integers(2, 20, 400))
    x = np.full(ticks[-1] + 1, np.nan)
    x[ticks] = np.sin(ticks / 500)
    hapfmt.write(x, tmp_path / "a.hapf", rate=1000, labels=["fx"], units=["N"])
    assert run("plot", tmp_path / "a.hapf", "-o", tmp_path / "a.png") == 0
    axes = pages[0][0][0].axes[0]
    (gaps,) = [each for each in axes.collections if each.get_label() == "gap"]
    assert max(path.vertices[:, 1].max() for path in gaps.get_paths()) < 0.1
    (line,) = [each for each in axes.lines if each.get_label() == "signal"]
    assert line.get_marker() == "."


def test_a_lossless_file_has_no_knots_in_its_picture(tmp_path, pages):
    channel = Channel(np.full(2000, 7, np.int32), 1000, calibration=Calibration(), label="x")
    hapfmt.write(Recording((channel,)), tmp_path / "a.hapf")
    with hapfmt.Reader(tmp_path / "a.hapf") as reader:
        assert {ref.track.codec for ref in reader.channels} == {"KNOT"}
    assert run("plot", tmp_path / "a.hapf", "-o", tmp_path / "a.png") == 0
    figure = pages[0][0][0]
    assert "knots" not in figure.axes[0].get_legend_handles_labels()[1]


def test_gaps_events_and_few_samples(tmp_path, pages):
    x = np.array([1.0, np.nan, 3.0, 2.0])
    known = Channel.from_physical(x, 1000, label="x", unit="N", lsb=1.0)
    hapfmt.save(Recording((known,)), tmp_path / "few.npz")
    flat = Channel.from_physical(np.full(5000, 0.7), 1000, label="x", unit="N", lsb=0.1)
    hapfmt.write(Recording((flat,)), tmp_path / "flat.hapf")
    for name in ("few.npz", "flat.hapf"):
        assert run("plot", tmp_path / name, "-o", tmp_path / "x.png") == 0
    (few,), (constant,) = (figures for figures, _ in pages)
    assert {"signal", "gap"} <= check_palette(few)
    assert few.axes[0].get_xlabel() == "time in ms"
    # Nothing moves in a constant: no stretch of it, and its spectrum would be that of rounding.
    assert len(constant.axes) == 1
    low, high = constant.axes[0].get_ylim()
    assert low < 0.7 < high


@pytest.mark.parametrize("kind", MAGIC)
def test_files_whole_or_not_at_all(room, kind, tmp_path):
    path = tmp_path / f"x.{kind}"
    words = ["plot", room / "a.hapf", "--output", path, "--stop", "0.2"]
    assert run(*words) == 0
    first = path.read_bytes()
    assert first.startswith(MAGIC[kind])
    with pytest.raises(ParameterError, match="already exists"):
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
        ([], r"--output a\.png .*--window"),
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
    with pytest.raises(ParameterError, match="No display"):
        run("plot", room / "a.hapf", "--window")


def test_the_original_must_fit(room):
    words = ["plot", room / "three.hapf", "--output", room / "x.png", "--against", room / "a.npz"]
    with pytest.raises(ParameterError, match="The original lacks"):
        run(*words)
    with pytest.raises(ParameterError, match="no channel 'z'"):
        run("plot", room / "a.npz", "--output", room / "x.png", "--channels", "z")


def test_memory_that_may_be_taken_is_bounded(room):
    with pytest.raises(hapfmt.errors.LimitError):
        run("plot", room / "a.hapf", "--output", room / "x.png", "--max-memory", "1k")
    assert Limits.of_memory("1k").memory == 1024


def compared(a, b, **given):
    parts = [RecordingParts(Recording((each,))) for each in (a, b)]
    ((found,), _) = compare(*parts, pair_up(*parts), **given)
    return found


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

    def test_perceptual_measures(self, room, capsys):
        """Those of hapfmt.metrics; the deadband is that of preset perceptual, 0.2 % of the range."""
        pytest.importorskip("vibromaf.metrics.spqi")
        pair = room / "a.npz", room / "a.hapf"
        assert "metrics" not in self.told(capsys, *pair)[1]["channels"][0]
        code, told = self.told(capsys, *pair, "--metrics")
        (row,) = told["channels"]
        f, y = (hapfmt.read(path)[0].samples() for path in pair)
        rate, floor = 1000.0, 0.002 * float(np.ptp(f))
        assert code == 3 and row["metrics"] == {
            "seconds": 2.0,
            "k": 0.1,
            "floor": pytest.approx(floor),
            "snr_weighted_db": metrics.snr_weighted_db(f, y, rate, "acceleration"),
            "largest_deadbands": pytest.approx(metrics.max_in_deadbands(f, y, floor)),
            "outside_share": pytest.approx(metrics.share_outside(f, y, floor)),
            "st_sim": metrics.st_sim(f, y, rate),
            "spqi": metrics.spqi(f, y, rate),
            "band_energy_error_db": metrics.band_energy_error_db(f, y, rate),
            "missing": "",
        }
        assert run("compare", *pair, "--metrics") == 3
        said = capsys.readouterr().out
        assert f"{row['metrics']['st_sim']:.3f}" in said and "of the first 2 s" in said

    def test_measures_of_equal_and_short_channels(self, room, capsys):
        pytest.importorskip("vibromaf.metrics.spqi")
        words = [room / "a.npz", room / "a.npz", "--metrics"]
        (row,) = self.told(capsys, *words)[1]["channels"]
        found = row["metrics"]
        assert found["st_sim"] == found["spqi"] == 1 and found["snr_weighted_db"] is None
        assert found["largest_deadbands"] == found["outside_share"] == 0
        (row,) = self.told(capsys, room / "a.npz", room / "a.hapf", "--metrics", "--stop", "1")[1][
            "channels"
        ]
        assert row["metrics"]["st_sim"] is row["metrics"]["spqi"] is None
        assert row["metrics"]["missing"].startswith("ST-SIM and SPQI need at least 1.088 s")
        run("compare", room / "a.npz", room / "a.hapf", "--metrics", "--stop", "1")
        assert "note: ST-SIM and SPQI need at least" in capsys.readouterr().err

    def test_measures_of_a_long_recording_take_its_first_minute(self):
        """Memory stays bounded: a difference behind it changes none of them."""
        pytest.importorskip("vibromaf.metrics.spqi")
        x = np.random.default_rng(1).normal(size=7000)
        y = np.where(np.arange(7000) < 6000, x, 0)
        found = compared(Channel(x, 100, unit="Pa"), Channel(y, 100, unit="Pa"), measured=True)
        assert found.differing == 1000 and found.measures is not None
        assert found.measures.seconds == 60 and found.measures.outside_share == 0
        assert found.measures.k == 0.1 and found.measures.snr_weighted_db is None
        moved = compared(Channel(x, 100, unit="m"), Channel(y + 1, 100, unit="m"), measured=True)
        assert moved.measures.k == 0 and moved.measures.outside_share == 1
        assert moved.measures.largest_deadbands == pytest.approx(1 / (0.002 * np.ptp(x)))

    def test_nothing_to_measure(self):
        pytest.importorskip("vibromaf.metrics.spqi")
        x = np.zeros(2000)
        x[3] = np.nan
        assert compared(Channel(x, 1000), Channel(x, 1000), measured=True).measures is None
        flat = np.full(2000, 1.5)
        found = compared(Channel(flat, 1000), Channel(flat + 1, 1000), measured=True).measures
        assert found.largest_deadbands is found.outside_share is None

    def test_a_missing_package_is_named_first(self, room, monkeypatch):
        monkeypatch.setitem(sys.modules, "vibromaf.metrics.stsim", None)
        with pytest.raises(MissingExtraError, match=r"pip install 'hapfmt\[metrics\]'"):
            run("compare", room / "a.npz", room / "a.npz", "--metrics")

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
        assert shown[0].get_legend_handles_labels()[1] == ["A", "B", "gap in B"]
        assert "difference B − A" in check_palette(figure)
        check_nothing_lies_on_the_data(figure)
        assert "samples in one only" in shown[0].get_title("left")
        assert "B: damage in " in words_of(figure)

    @pytest.mark.parametrize(
        ("count", "differing", "most", "expected"),
        [
            (13, 9, drawing.SMALL, [18]),
            (8, 8, 4, [8, 8]),
            pytest.param(13, 13, drawing.SMALL, [26], marks=pytest.mark.deep),
            pytest.param(40, 40, drawing.SMALL, [40, 40], marks=pytest.mark.deep),
        ],
    )
    def test_pictures_of_many_channels(
        self, tmp_path, pages, monkeypatch, count, differing, most, expected
    ):
        """Those that differ are drawn in one grid; of more than a page every page is kept."""
        monkeypatch.setattr(drawing, "SMALL", most)
        ours = [channel(place, 300) for place in range(count)]
        theirs = [
            replace(each, stored=each.stored + (place < differing))
            for place, each in enumerate(ours)
        ]
        hapfmt.save(Recording(tuple(ours)), tmp_path / "a.npz")
        hapfmt.save(Recording(tuple(theirs)), tmp_path / "b.npz")
        words = [tmp_path / "a.npz", tmp_path / "b.npz", "--plot", tmp_path / "x.png"]
        assert run("compare", *words) == 3
        figures = pages.pop()[0]
        assert [len(figure.axes) for figure in figures] == expected
        for figure in figures:
            assert check_palette(figure) == {"A", "B", "difference B − A"}
            check_nothing_lies_on_the_data(figure)
            said = words_of(figure)
            assert f"{count} channels" in said and "1000 Hz" in said
            assert ("identical (not drawn): f9, f10" in said) == (differing < count)

    def test_refused(self, room):
        with pytest.raises(ParameterError, match="Only one of A and B"):
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
                pair = [open_parts(str(path), None, Limits.of_memory("64M")) for _ in range(2)]
                for parts in pair:
                    opened.callback(parts.close)
                plot.draw(pair[0], None, path.name, None, None, False)
                rows, _ = compare(*pair, pair_up(*pair), views=True)
            except hapfmt.errors.HapfmtError:
                continue
            assert all(row.identical for row in rows), path
            drawn += 1
    assert drawn > 100
