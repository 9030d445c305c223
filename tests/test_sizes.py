"""tools/sizes.py: sizes of files that were decoded and compared."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

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


def test_table():
    assert sizes.markdown(ROWS).split("\n") == [
        "| recording | channels | FLAC | lossless |",
        "|---|--:|--:|--:|",
        "| sand | 1 | 8.0 | 16.0 |",
        "| a (2) | 3-5 | 4.0 | 16.0 |",
        "| b | 1 | - | 4.0 |",
        "| 3 recordings | 1-5 | - | 10.1 |",
    ]


def test_readme():
    text = (
        "# x\n\n| recording | old |\n|---|--:|\n| sand | 1 |\n\nText. Measured at commit 1\non a\n"
        "machine.\n\n## More\n"
    )
    assert sizes.readme(text, sizes.markdown(ROWS), sizes.measured_at()).split("\n")[:9] == [
        "# x", "",
        "| recording | channels | FLAC | lossless |",
        "|---|--:|--:|--:|",
        "| sand | 1 | 8.0 | 16.0 |",
        "| 3 recordings | 1-5 | - | 10.1 |",
        "",
        f"Text. Measured at commit {sizes.commit(ROOT)} on {sizes.machine()}.", "",
    ]  # fmt: skip


def test_the_readme_has_every_column():
    text = (ROOT / "README.md").read_text("utf-8")
    assert f"{sizes.head([*sizes.PEERS, *sizes.OURS])}\n| sand | 1 |" in text
    assert set(sizes.RECIPES) == set(sizes.PEERS)


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
