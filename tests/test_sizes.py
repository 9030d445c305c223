"""tools/sizes.py: sizes of files that were decoded and compared. Figures in pages: where they come
from, and whether they are those of today."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from depth import deep
from spec import ROOT
from terminal import called

sys.path.insert(0, str(ROOT / "tools"))

import faults
import intervals
import measured
import presets
import sizes
from measured import files_in
from peers.packages import installed

import hapfmt
from hapfmt.lab.scenes import load_scene, simulate


@pytest.fixture(scope="module")
def sand() -> hapfmt.Recording:
    return simulate(load_scene("sand").changed(seconds=1))[0]


@pytest.fixture
def doubles() -> hapfmt.Recording:
    x = np.cumsum(np.random.default_rng(3).normal(size=(2, 500)), axis=1)
    x[0, 7] = -0.0
    return hapfmt.Recording(
        tuple(hapfmt.Channel.from_physical(row, 1000, label=f"f{n}") for n, row in enumerate(x))
    )


@pytest.mark.parametrize("coder", sizes.PEERS)
def test_every_peer_gives_back_what_it_got(coder, sand, doubles):
    packages, size_of = sizes.PEERS[coder]
    if not installed(*packages):
        pytest.skip(f"{coder} needs {' and '.join(packages)}")
    assert size_of(sand) > 100
    if coder == "FLAC":
        assert size_of(doubles) is None
    else:
        assert size_of(doubles) > 0.9 * 500 * 2 * 7


@pytest.mark.parametrize(
    ("coder", "name"), [("FLAC", "flac_decode"), ("zstd", "unzstd")]
)  # fmt: skip
def test_a_peer_that_loses_a_bit_is_found(coder, name, sand, monkeypatch):
    packages, size_of = sizes.PEERS[coder]
    if not installed(*packages):
        pytest.skip(f"{coder} needs {' and '.join(packages)}")
    right = getattr(sizes, name)

    def wrong(blob, *more):
        if name == "unzstd":
            return right(blob)[:-1] + bytes([right(blob)[-1] ^ 1])
        found = right(blob, *more)
        found[5] += 1
        return found

    monkeypatch.setattr(sizes, name, wrong)
    with pytest.raises(sizes.WrongError, match=f"{coder}: channel 0 differs"):
        size_of(sand)


def test_a_negative_zero_differs():
    x = np.array([0.0, 1.0])
    sizes.check("x", [x], [x.copy()])
    with pytest.raises(sizes.WrongError):
        sizes.check("x", [x], [np.array([-0.0, 1.0])])


def test_ours_are_checked_too(sand, monkeypatch):
    assert sizes.ours(sand, "near-lossless 0.1%") < sizes.ours(sand, "lossless")
    read = hapfmt.read

    def wrong(data):
        back = read(data)
        back.channels[0].stored[0] += 100
        return back

    monkeypatch.setattr(hapfmt, "read", wrong)
    with pytest.raises(sizes.WrongError, match="lossless: channel 0 differs"):
        sizes.ours(sand, "lossless")
    with pytest.raises(sizes.WrongError, match="leaves its error bound"):
        sizes.ours(sand, "near-lossless 0.1%")


ROWS = [
    sizes.Row("sand", 1, 800, {"FLAC": 100, "lossless": 50}),
    sizes.Row("a/x", 3, 800, {"FLAC": 100, "lossless": 100}),
    sizes.Row("a/y", 5, 800, {"FLAC": 400, "lossless": 25}),
    sizes.Row("b", 1, 800, {"FLAC": None, "lossless": 200}),
]


def test_lines():
    assert sizes.lines_of(ROWS, ["FLAC", "lossless"]) == [
        ["sand", "1", "8.0", "16.0"],
        ["a (2)", "3-5", "4.0", "16.0"],
        ["b", "1", "-", "4.0"],
        ["3 recordings", "1-5", "-", "10.1"],
    ]


def test_linked_folders_are_followed_once(tmp_path):
    data = tmp_path / "data"
    (data / "set").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    for path in (data / "set" / "a.npz", tmp_path / "elsewhere" / "b.npz"):
        path.touch()
    try:
        (data / "linked").symlink_to(tmp_path / "elsewhere")
        (data / "set" / "loop").symlink_to(data)
    except OSError:
        pytest.skip("this system has no symbolic links")
    assert files_in(data) == [data / "linked" / "b.npz", data / "set" / "a.npz"]


FIGURES = {
    match[1]: (page, match)
    for page in measured.PAGES
    for match in re.finditer(measured.MARK % r"[a-z]+", page.read_text("utf-8"))
}
TABLE = re.compile(r"^((?:\|.*\n){2})((?:\|.*\n)+)", re.M)
NUMBER = re.compile(r"[-\u2212]?\d[\d.,]*( ?(%|dB|ms|s|[kMG]i?B|/.*))?")
NO_FIGURES = re.compile(r"\| (offset|code( q)?|exit code) \|")
"""Headings of tables without measured numbers."""


@pytest.mark.parametrize("page", measured.PAGES, ids=lambda page: page.name)
def test_each_table_of_figures_says_where_it_comes_from(page):
    text = re.sub(r"^ *```.*?^ *```$", "", page.read_text("utf-8"), flags=re.S | re.M)
    marked = [match[0] for where, match in FIGURES.values() if where == page]
    for head, rows in TABLE.findall(text):
        cells = [cell.strip() for row in rows.splitlines() for cell in row.strip("|").split("|")]
        numbers = sum(bool(NUMBER.fullmatch(cell)) for cell in cells)
        if numbers >= 2 and 4 * numbers >= len(cells) and not NO_FIGURES.search(head):
            assert any(f"{head}{rows}" in each for each in marked), head


@pytest.mark.parametrize("name", FIGURES)
def test_the_program_that_is_named_writes_the_table(name):
    page, match = FIGURES[name]
    program = ROOT / match[2]
    files = program.glob("*.py") if program.is_dir() else [program]
    assert any(f'write_rows("{name}", ' in path.read_text("utf-8") for path in files)
    widths = {row.count(" | ") for row in (match[5] + match[6]).splitlines() if "---" not in row}
    assert len(widths) == 1 and page.read_text("utf-8").count(f"<!-- {name}: ") == 1


def shown(name: str) -> list[list[str]]:
    rows = FIGURES[name][1][6].splitlines()
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def about(texts: list[str], share: float = 0.03) -> list[object]:
    """Numbers that may differ a little, as between versions of a library."""
    found = [re.findall(r"[\d.]+", text) for text in texts]
    return [pytest.approx([float(x) for x in each], rel=share, abs=0.15) for each in found]


def numbers(texts: list[str]) -> list[list[float]]:
    return [[float(x) for x in re.findall(r"[\d.]+", text)] for text in texts]


@pytest.mark.compiled
class TestFiguresAreThoseOfToday:
    @pytest.mark.deep
    def test_sizes_of_a_scene(self):
        row = next(row for row in shown("sizes") if row[0] == "taps")
        recording = dict(sizes.scenes(sizes.SECONDS))["taps"]
        found = [8 * recording.sample_count / sizes.ours(recording, x) for x in sizes.OURS[:2]]
        assert numbers([f"{each:.2f}" for each in found]) == about(row[-3:-1])

    @pytest.mark.parametrize(
        "of", [("2 kB", "lossless", 1), *deep([("200 kB", "lossless", 2), ("200 kB", "paper", 5)])]
    )
    def test_what_comes_back_of_a_small_file(self, of):
        size, preset, column = of
        row = shown("faults")[0]
        assert row[0] == "one byte changed"
        found = faults.run_size((size, preset, row[0], 20))
        assert numbers([found]) == about([row[column]])

    @pytest.mark.deep
    @pytest.mark.skipif(not measured.DATA.exists(), reason="there are no recordings")
    def test_what_one_changed_byte_takes(self):
        found = faults.cluster_rows(20)
        assert [row[:2] for row in found] == [row[:2] for row in shown("clusters")]
        assert numbers([row[2] for row in found]) == about([row[2] for row in shown("clusters")])
        assert numbers([row[3] for row in found]) == about([row[3] for row in shown("clusters")])

    @pytest.mark.deep
    @pytest.mark.skipif(not measured.DATA.exists(), reason="there are no recordings")
    def test_compression_of_one_recording(self):
        path = next(p for p in files_in(measured.DATA) if str(p).endswith(f"{presets.FOAM}.npz"))
        recording = hapfmt.read(path)
        found = [presets.measure(recording, each).ratio for each in presets.SETTINGS.values()]
        told = [row[-1] for row in shown("presets")]
        assert numbers([f"{each:.2f}" for each in found]) == about(told)
        assert [row[0].strip("`") for row in shown("presets")] == list(presets.SETTINGS)

    def test_intervals(self):
        """Of 400 tests, not 4000: the standard error of a share is 1.5 %."""
        for row, found in zip(shown("intervals"), intervals.rows(400), strict=True):
            assert row[:2] == found[:2]
            assert numbers(found[2:]) == about(row[2:], 0.06)


def test_size_of_a_page_with_its_data(tmp_path):
    """docs/viewer.md: a page is 4/3 of the size of the files, and some more."""
    text = (ROOT / "docs" / "viewer.md").read_text("utf-8")
    told = re.search(r"4/3 of the size of the files, and ([\d.]+) MB more", text)
    file = tmp_path / "a.hapf"
    hapfmt.write(np.arange(9.0), file, rate=100)
    assert called("view", file, "--export", tmp_path / "a.html").code == 0
    size = (tmp_path / "a.html").stat().st_size - 4 / 3 * file.stat().st_size
    assert told and float(told[1]) == pytest.approx(size / 1e6, abs=0.06)
