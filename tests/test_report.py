"""tools/report: a page that needs nothing else, and the same figures as text."""

from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

from report import codec_figures, codecs, subjects, trials
from report import run as report
from report.codecs import front
from report.page import Part, divided, page, shown
from report.section import CannotRunError, Figure, Options, Section, Table, spread, timed
from report.texts import as_json, markdown_table, write_tables

import hapfmt

VOID = {"meta", "br", "img", "hr", "input", "link"}
SVG = '<svg viewBox="0 0 10 10"><defs><path id="m1" d="M0 0"/></defs><use href="#m1"/></svg>'
ODD = 'a|b <i> & "c"\nd'
TABLE = Table(
    "Of x & y", ["name", "n", "x"], [[ODD, 12345, 0.123456789], ["b", None, 1e-9], ["", 0, True]]
)
TEXT = "It is 3 times **as fast**. And `a<b`.\n\n* one\n* two\nmore\n\n[here](#codecs) <script>"
MADE_UP = Section("Made & up", TEXT, [TABLE], [Figure("A", "b < c", SVG)], {"x": float("inf")})
PARTS = [
    Part("one", MADE_UP, seconds=2),
    Part("two", MADE_UP),
    Part("three", None, "no <package> here"),
]


class Reader(HTMLParser):
    """Fails where elements do not nest, and keeps what a test asks for."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.cells: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_startendtag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


def read(text: str) -> Reader:
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert not reader.open
    return reader


def test_the_page_is_whole_and_needs_nothing_else():
    text = page("T & t", ["On: a <machine>."], PARTS)
    seen = read(text).seen
    ids = [attrs["id"] for _, attrs in seen if "id" in attrs]
    assert len(ids) == len(set(ids)) and {"one", "two", "three"} < set(ids)
    for tag, attrs in seen:
        assert tag not in ("link", "iframe", "object", "base")
        for name in ("href", "src", "xlink:href"):
            if target := attrs.get(name):
                assert target[0] == "#" and target[1:] in {*ids, "codecs"}
    assert "@import" not in text and "url(http" not in text
    assert [tag for tag, _ in seen].count("script") == 1
    assert "&lt;script&gt;" in text and "no &lt;package&gt; here" in text


def test_contents_tell_what_was_found():
    assert PARTS[0].finding == "It is 3 times **as fast**."
    assert PARTS[2].finding == "Not measured: no <package> here"
    assert divided("One")[0] == "One" and divided("It is 0.5 of a. B")[0] == "It is 0.5 of a."
    contents = page("T", [], PARTS).partition("<nav>")[2].partition("</nav>")[0]
    assert contents.count("It is 3 times <strong>as fast</strong>.") == 2


def test_cells_are_escaped_and_sorted_as_numbers():
    reader = read(page("T", [], PARTS[:1]))
    assert ODD in reader.cells
    values = [attrs["data-v"] for _, attrs in reader.seen if "data-v" in attrs]
    assert values == ["12345.0", "0.123456789", "", "1e-09", "0.0", "1.0"]
    line = markdown_table(TABLE).splitlines()[2]
    assert line == '| a\\|b <i> & "c" d | 12\u202f345 | 0.1235 |'


@pytest.mark.parametrize(
    ("cell", "text"), [(None, ""), (True, "yes"), (1234.6, "1\u202f235"), (1e-9, "1e-09"), (7, "7")]
)
def test_four_digits(cell, text):
    assert shown(cell) == text


def test_csv_and_json_agree(tmp_path):
    found = json.loads(as_json("T", {"on": "a machine"}, PARTS))
    assert found["on"] == "a machine" and found["sections"]["three"]["ran"] is False
    assert found["sections"]["one"]["data"] == {"x": None}
    (table,) = found["sections"]["one"]["tables"]
    paths = write_tables(tmp_path, PARTS)
    assert [path.name for path in paths] == ["one-of-x-y.csv", "two-of-x-y.csv"]
    with paths[0].open(newline="", encoding="utf-8") as stream:
        headers, *rows = csv.reader(stream)
    assert headers == table["headers"]
    assert rows == [["" if c is None else str(c) for c in row] for row in table["rows"]]


def test_a_section_that_cannot_run_stops_no_other(monkeypatch, capsys):
    def of(error: Exception | None) -> ModuleType:
        module = ModuleType("made")

        def section(_options: Options) -> Section:
            if error:
                raise error
            return MADE_UP

        module.section = section
        return module

    made = {
        "codecs": of(CannotRunError("no disc")),
        "paper": of(OSError("bad")),
        "scenes": of(None),
    }
    monkeypatch.setattr(report, "import_module", lambda name: made[name.removeprefix("report.")])
    monkeypatch.setattr(report, "find_spec", lambda _name: True)
    parts = [report.run(name, Options()) for name in made]
    assert [(part.why, part.failed) for part in parts] == [
        ("no disc", False), ("OSError: bad", True), ("", False)
    ]  # fmt: skip
    assert "OSError" in capsys.readouterr().err
    monkeypatch.setattr(report, "find_spec", lambda _name: None)
    assert "no tools/report/codecs.py" in report.run("codecs", Options()).why


def test_spread_and_front():
    assert spread([1, 2, 3, 4, 5]) == (3, 2, 4, 5) and spread([2, 4])[:3] == (3, 2, 4)
    assert timed(lambda: 7, 2)[0] == 7
    assert front([(1, 9), (2, 3), (2, 4), (3, 3), (4, 0), (1, 9.5)]) == [0, 1, 4]


def test_every_recording_is_measured_or_named_with_the_reason(tmp_path, monkeypatch):
    """Linked folders too; of a long recording the middle."""
    data, elsewhere = tmp_path / "data", tmp_path / "elsewhere"
    for folder in (data / "set", elsewhere):
        folder.mkdir(parents=True)
    monkeypatch.setattr(subjects, "SCENES", ())
    monkeypatch.setattr(subjects, "SAMPLES", 600)
    monkeypatch.setattr(subjects, "compiled", True)
    ticks = np.arange(1000.0)
    x = np.stack([np.sin(ticks / 50), np.full(1000, 0.25), ticks % 7])
    names = ["force", "still", "steps"]
    for path in (data / "set" / "long.npz", elsewhere / "linked.npz"):
        few = 1000 if "long" in path.name else 150
        np.savez(path, x=x[:, :few], rate_hz=100.0, channel_names=names, unit="N")
    (data / "set" / "broken.npz").write_bytes(b"PK")
    (data / "README.md").write_text("no recording")
    try:
        (data / "other").symlink_to(elsewhere)
    except OSError:
        pytest.skip("this system has no symbolic links")
    listed: list[subjects.Listed] = []
    found = list(subjects.subjects(Options(data=data), listed))
    assert {each.name.partition(",")[0] for each in found} == {"set/long", "other/linked"}
    by_name = {each.name: each for each in listed}
    assert list(by_name) == ["other/linked", "set/broken.npz", "set/long"]
    assert by_name["set/broken.npz"].skipped and by_name["set/broken.npz"].measured == 0
    whole, part = by_name["other/linked"], by_name["set/long"]
    assert (whole.samples, whole.start_s, whole.stop_s) == (450, 0, 1.5)
    assert whole.skipped in ("", "channel 'still': constant")
    assert (part.samples, part.start_s, part.stop_s) == (3000, 4, 6)
    assert part.skipped.endswith("samples outside the middle 2 s")


def test_st_sim_is_bounded(monkeypatch):
    """At most the first channels that are fast enough, and their first seconds."""
    calls = []
    monkeypatch.setattr(trials, "st_sim", lambda x, _y, rate: calls.append((x.size, rate)) or 0.5)
    rng = np.random.default_rng(1)
    rates = [100, 500, 500, 1000, 1000, 1000]
    channels = tuple(
        hapfmt.Channel.from_physical(rng.normal(size=12 * rate), rate, label=str(n))
        for n, rate in enumerate(rates)
    )
    subject = subjects.Subject("x", True, hapfmt.Recording(channels), None)
    found = trials.errors(subject, [x + 0.1 for x in subject.truth])
    assert calls == [(5000, 500), (5000, 500), (10_000, 1000), (10_000, 1000)]
    assert found["st_sim"] == 0.5


def command(out: Path, *arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "tools/report", "--quick", "--no-data", "-o", str(out), *arguments],
        cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(out / "index.html")
    return done.stderr


@pytest.mark.deep
def test_codecs_and_decoding_of_small_scenes(tmp_path):
    told = command(tmp_path, "--only", "codecs", "--only", "decoding")
    assert re.search(r"\d s\] codecs: sand: lossless", told)
    read((tmp_path / "index.html").read_text("utf-8"))
    found = json.loads((tmp_path / "report.json").read_text("utf-8"))
    codecs = found["sections"]["codecs"]
    ours = [trial for trial in codecs["data"] if trial["family"] != "peer"]
    assert {trial["family"] for trial in ours} == {
        "lossless", "near-lossless", "deadband", "perceptual", "paper"
    }  # fmt: skip
    assert all(not trial["failed"] and not trial["outside"] for trial in ours)
    exact = [trial for trial in ours if trial["task"] == "lossless"]
    assert exact and all(trial["largest_percent"] == 0 for trial in exact)
    decoding = found["sections"]["decoding"]
    if decoding["ran"]:
        assert all(case["fast"]["digest"] == case["slow"]["digest"] for case in decoding["data"])
    else:
        assert "extension" in decoding["finding"]
    assert (tmp_path / "codecs-every-measurement.csv").exists()


def test_pictures_of_stability() -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure as Canvas
    from report.stability import draw

    panels = Canvas().subplots(2, 2)
    draw(panels)
    assert all(panel.lines and panel.get_title() for panel in panels.flat)


def test_perceptual_measures_a_texture_where_no_unit_is_known() -> None:
    """It once measured near-lossless there, and nothing on channels without a texture."""
    settings = [each for each in trials.settings(True) if each.family == "perceptual"]
    noise = np.random.default_rng(4).normal(size=4000)

    def tried(x: np.ndarray, rate: int) -> list[trials.Trial | None]:
        recording = hapfmt.Recording((hapfmt.Channel.from_physical(x, rate),))
        subject = subjects.Subject("x", False, recording, None)
        return [trials.try_ours(subject, each, 1) for each in settings]

    default, alone = tried(2 + noise, 1000)
    assert default and 19 < default.snr_hf_db < 22 and default.setting == ""
    assert alone and alone.snr_hf_db < default.snr_hf_db - 2
    quiet = trials.Setting("perceptual", "10 dB", "", hapfmt.Settings.of("perceptual", snr=10))
    settings[:] = [quiet]
    assert tried(noise, 30) == [None]
    summary = codecs.summary_rows([default])
    assert len(summary[0]) == len(codecs.SUMMARY)
    errors = {name: summary[0][place] for place, name in enumerate(codecs.SUMMARY)}
    assert errors["largest error, % of range: largest"] > errors["rms error, % of range: median"]
    figures = codec_figures.pictures([default._replace(family="lossless"), default])
    assert all(">default<" in figure.svg for figure in figures[:3])
