"""Malformed files of every foreign format, on disk: our errors, the file's name, bounded memory."""

from __future__ import annotations

import errno
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from depth import either
from fuzzing import foreign_files as ff
from terminal import called

import hapfmt
from hapfmt.convert.formats import OURS
from hapfmt.errors import HapfmtError, ParameterError

REQUIRED = {
    "flac": "soundfile", "tdms": "nptdms", "mcap": "mcap", "bag": "rosbags", "ros2": "rosbags",
    "hdf5": "h5py", "mat": "scipy", "parquet": "pyarrow", "feather": "pyarrow",
    "lerobot": "pyarrow",
}  # fmt: skip
FOUND = {
    "npz": [0, 4, 42, 74],  # a place that the directory names: OSError of a seek
    "xdf": [81, 153, 181, 377],  # a chunk that is shorter than its fields: struct.error
    "xdfz": [80, 216, 284, 702],  # BadGzipFile, which is an OSError
    "bag": [327, 753, 872, 1270],  # OSError of a seek
    "lerobot": [692, 7263],  # a file that the info names: not there, or with a NUL in its name
}
"""Numbers of mutants that ended in an exception which was not ours, by format."""


@pytest.fixture
def known(request) -> list[ff.Seed]:
    if package := REQUIRED.get(request.param):
        pytest.importorskip(package)
    return ff.seeds(request.param)


@pytest.mark.capped(1 << 30)
@either("count", 10, 100, 3000)
@pytest.mark.parametrize(("known", "format"), [(f, f) for f in ff.SEEDS], indirect=["known"])
def test_any_bytes_end_in_our_errors(tmp_path: Path, known, format, count):
    """
    LIM-002: A reader MUST check every limit before it takes memory for what the number promises.
    """
    for seed in known:
        assert ff.judge(ff.put(seed, tmp_path, format)) == "read"
    for number in (*FOUND.get(format, ()), *range(count)):
        ff.judge(ff.put(ff.mutant(format, known, number), tmp_path, format))


def test_every_format_that_is_read_is_tried():
    suffixes = {ff.SUFFIX.get(name, name) for name in ff.SEEDS} | {"db3"}
    for one in OURS:
        assert one.name in ff.SEEDS or {s[1:] for s in one.suffixes} & suffixes, one.name


def broken_npz(path: Path) -> Path:
    """Its directory says that it lies 50 bytes further on, so that the first member begins before
    the file does."""
    np.savez(path, x=np.zeros(9))
    data = bytearray(path.read_bytes())
    at = data.rindex(b"PK\5\6")
    place = int.from_bytes(data[at + 16 : at + 20], "little")
    data[at + 16 : at + 20] = (place + 50).to_bytes(4, "little")
    path.write_bytes(data)
    with zipfile.ZipFile(path) as archive, pytest.raises(OSError, match="Invalid argument"):
        archive.open("x.npy")
    return path


@pytest.mark.parametrize("verb", [["encode"], ["convert"], ["info"]])
def test_the_command_line_names_the_file(tmp_path: Path, verb):
    path = broken_npz(tmp_path / "broken.npz")
    out = [] if verb == ["info"] else [tmp_path / "out.hapf"]
    said = called(*verb, path, *out)
    assert said.code == 1
    assert said.err.startswith(f"hapfmt: {path}: ") and "malformed" in said.err


def test_an_error_of_the_system_stays_one_and_names_the_file(tmp_path: Path, monkeypatch):
    path = tmp_path / "a.csv"
    path.write_text("t,x\n0,1\n1,2\n")

    def fails(*_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("hapfmt.convert.csv.read", fails)
    with pytest.raises(OSError, match="Input/output error") as caught:
        hapfmt.read(path)
    assert caught.value.filename == str(path) and not isinstance(caught.value, HapfmtError)


def test_a_flac_file_is_flac(tmp_path: Path, capfd):
    """libsndfile would look for MP3 and more in it."""
    pytest.importorskip("soundfile")
    path = tmp_path / "a.flac"
    path.write_bytes(b"\xff\xfb\x90\x64" + bytes(2000))
    with warnings.catch_warnings(), pytest.raises(ParameterError, match="not a FLAC file"):
        hapfmt.read(path)
    assert capfd.readouterr().err == ""
