"""Samples in a temporary file: the same values and the same files, in bounded memory."""

from __future__ import annotations

import errno
import io
import json
import os
import subprocess
import sys
from collections import namedtuple
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import hapfmt
from hapfmt import Channel, Recording, spool
from hapfmt.cli.encode import sample_of
from hapfmt.convert import opened
from hapfmt.convert.tables import Import
from hapfmt.spool import GrowingArray, Spool, is_mapped, release

ON_DISK = partial(Spool, 0)


def recording(ticks: int = 3000) -> Recording:
    """Counts, doubles off any grid, a gap, and channels that follow from each other."""
    rng = np.random.default_rng(3)
    walk = np.cumsum(rng.integers(-3, 4, ticks))
    rough = np.cumsum(rng.normal(0, 0.01, ticks))
    rough[100:200] = np.nan
    calibration = hapfmt.Calibration(1, 0, 20)
    counts = [walk, walk + rng.integers(0, 2, ticks), 7 * walk]
    return Recording(
        (
            *(
                Channel(x.astype(np.int32), 1000, calibration=calibration, label=f"joint {n}")
                for n, x in enumerate(counts)
            ),
            Channel.from_physical(rough, 1000, label="force", unit="N"),
        )
    )


def same(one: Recording, other: Recording) -> bool:
    return one.labels == other.labels and all(
        a.coverage == b.coverage and np.array_equal(a.samples(), b.samples())
        for a, b in zip(one, other, strict=True)
    )


def test_arrays_keep_their_values_when_memory_is_given_back():
    store = Spool(0)
    arrays = [store.empty(5000, dtype) for dtype in ("i4", "f8", "u1")]
    for number, array in enumerate(arrays):
        array[:] = number
    release()
    assert [set(array.tolist()) for array in arrays] == [{0}, {1}, {2}]
    assert all(map(is_mapped, arrays))


def test_the_first_bytes_stay_in_memory():
    store = Spool(1000)
    assert [is_mapped(store.empty(600, np.uint8)) for _ in range(2)] == [False, True]
    array = np.arange(100, dtype=np.int32)
    assert store.kept(array) is array
    kept = store.kept(array)
    assert is_mapped(kept)
    assert np.array_equal(kept, array)
    assert store.kept(kept) is kept


def test_a_file_goes_with_its_last_array(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    before = len(spool._mapped)
    array = Spool(0).empty(9, np.int32)
    assert len(spool._mapped) == before + 1
    if os.name != "nt":
        assert not list(tmp_path.iterdir())
    del array
    assert len(spool._mapped) == before


def test_a_full_disk_is_told_with_the_size(monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage(10, 10, 0))
    with pytest.raises(OSError, match=r"67108864 bytes of samples.*TMPDIR") as caught:
        Spool(0).empty(9, np.int32)
    assert caught.value.errno == errno.ENOSPC


def test_growing_goes_to_the_disk(monkeypatch):
    monkeypatch.setattr(spool, "TOGETHER", 100)
    growing = GrowingArray(Spool(0))
    parts = [np.arange(n * 6, dtype=np.int32).reshape(-1, 2) for n in range(1, 9)]
    for part in parts:
        growing.append(part)
    assert np.array_equal(growing.joined(), np.concatenate(parts))
    assert is_mapped(growing.joined())


@pytest.mark.parametrize("suffix", ["npz", "npy", "csv", "h5", "mat", "mcap", "parquet"])
def test_every_format_is_read_to_the_disk(suffix, tmp_path):
    pytest.importorskip({"h5": "h5py", "mat": "h5py", "parquet": "pyarrow"}.get(suffix, "numpy"))
    path = tmp_path / f"a.{suffix}"
    hapfmt.save(recording(), path)
    rate = {"rate": 1000} if suffix == "npy" else {}
    with opened(path, store=ON_DISK(), **rate) as (_, found, options):
        if isinstance(found, Import):
            whole = found.recording(options.max_memory, store=options.store)
        else:
            whole = found
    assert all(is_mapped(channel.stored) for channel in whole)
    assert same(whole, hapfmt.read(path, **rate))


def test_an_array_in_either_order_is_read_to_the_disk(tmp_path):
    x = np.arange(30, dtype=np.float32).reshape(3, 10)
    for order, transpose in (("C", None), ("F", None), ("C", True)):
        path = tmp_path / "a.npy"
        np.save(path, np.asarray(x.T if transpose else x, order=order))
        with opened(path, store=ON_DISK(), rate=10, transpose=transpose) as (_, found, _):
            assert np.array_equal(found.to_numpy(), x)
            assert all(is_mapped(channel.stored) for channel in found)


PRESETS = [
    {},
    {"preset": "near-lossless", "max_error": "1%"},
    {"preset": "perceptual", "felt": ("joint 0",)},
]


@pytest.mark.parametrize("given", PRESETS, ids=lambda given: given.get("preset", "lossless"))
def test_files_are_the_same_and_read_the_same(given, monkeypatch):
    files = []
    for store in (Spool, ON_DISK):
        monkeypatch.setattr("hapfmt.encoder.encode.Spool", store)
        stream = io.BytesIO()
        hapfmt.write(recording(), stream, hapfmt.Settings.of(**given), canonical=1)
        files.append(stream.getvalue())
    assert files[0] == files[1]
    with hapfmt.Reader(files[0]) as reader:
        found = reader.read(store=ON_DISK())
    assert all(is_mapped(channel.stored) for channel in found)
    assert same(found, hapfmt.read(files[0]))


PEAK = """
import json, sys
import numpy as np
from hapfmt.cli import main
from hapfmt.convert import npy
from hapfmt.spool import Spool
Spool.__init__.__defaults__, npy.READ = (0,), 1 << 16
most = []
def peak():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
from unittest import mock
for name in sys.argv[1:]:
    for command in (["encode", name, "a.hapf", "--fast"], ["decode", "a.hapf", "b.npz"],
                    ["verify", "a.hapf"]):
        with mock.patch("sys.argv", ["hapfmt", *command, *["--force"] * (command[0] != "verify")]):
            try:
                main()
            except SystemExit as done:
                assert not done.code
    most.append(peak())
print(json.dumps(most))
"""


@pytest.mark.compiled
@pytest.mark.skipif(sys.platform != "linux", reason="/proc is that of Linux")
def test_a_recording_of_four_times_the_length_takes_little_more_memory(tmp_path):
    """Values of 4 and 16 MB, all of which are on the disk."""
    rng = np.random.default_rng(1)
    for name, ticks in (("short", 12_500), ("long", 50_000)):
        x = np.cumsum(rng.integers(-9, 10, (40, ticks)), axis=1) / 20
        np.savez(tmp_path / f"{name}.npz", x=x, rate=1000)
    done = subprocess.run(
        [sys.executable, "-c", PEAK, "short.npz", "long.npz"],
        cwd=tmp_path,
        env={**os.environ, "HAPFMT_THREADS": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    short, long = json.loads(done.stdout.splitlines()[-1])
    # 6 MB of counts are not there either; the samples of one channel are looked at as a whole.
    assert long - short < 11 << 10


def shared_bytes() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * sum(int(x.split()[1]) for x in lines if x.startswith(("RssFile", "RssShmem")))


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is that of Linux")
def test_advice_holds_no_more_than_its_samples():
    """20 channels of 2 MB, all of which are on the disk."""
    store, x = ON_DISK(), np.sqrt(np.arange(250_000.0))
    kept = [hapfmt.Channel(store.kept(x), 1000) for _ in range(20)]
    release()
    before = shared_bytes()
    parts = [sample_of(channel, 4000) for channel in kept]
    assert all(part.stored.size < 5000 for part in parts)
    assert shared_bytes() - before < 20 << 20
