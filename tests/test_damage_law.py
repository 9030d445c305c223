"""One changed byte costs little in a large file, and a cut file keeps its beginning in all channels
(tools/faults.py --law prints the same shares)."""

from __future__ import annotations

import io
import sys
from fractions import Fraction

import numpy as np
import pytest
from depth import DEEP, sample
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import faults
from measured import DATA

import hapfmt
from hapfmt.encoder.encode import encode
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import walk

PLACES = faults.LAW_PLACES if DEEP else 6

RECORDINGS = (
    "dropbear/set0_test0", "dropbear/set0_test4", "dropbear/slow10_test3",
    "panda_comanip/symbol17_1", "panda_comanip/symbol17_3", "shock51k/Test_001",
    "shock51k/Test_012", "smartwheel/smartwheel", "teleop1dof/question1a_foam",
    "teleop1dof/question1a_free_motion", "teleop1dof/question1a_rigid",
    "teleop1dof/question1a_spring", "teleop1dof/question1b_foam", "teleop1dof/question1b_rigid",
    "unlicensed/ninapro_glove/S11_glove",
)  # fmt: skip
"""All whose lossless file has 100 kB or more."""


def walks(channels: int, ticks: int, rate: int = 1000) -> hapfmt.Recording:
    rng = np.random.default_rng(channels)
    rows = np.cumsum(rng.integers(-40, 41, (channels, ticks)), axis=1).astype(np.int32)
    return hapfmt.Recording(
        tuple(hapfmt.Channel(row, rate, label=f"f{n}") for n, row in enumerate(rows))
    )


def filtered() -> hapfmt.Recording:
    """A signal and its filtered form far apart, among doubles that follow from nothing."""
    rng = np.random.default_rng(7)
    rows = [np.cumsum(rng.normal(size=9000)) for _ in range(6)]
    y = np.zeros(9000)
    for t in range(2, 9000):
        y[t] = 0.2 * rows[0][t] + 0.1 * rows[0][t - 1] + 1.1 * y[t - 1] - 0.4 * y[t - 2]
    return hapfmt.Recording(
        tuple(
            hapfmt.Channel.from_physical(x, 2000, label=f"f{n}") for n, x in enumerate([*rows, y])
        )
    )


SYNTHETIC = {
    "one channel": lambda: walks(1, 150_000),
    "two": lambda: walks(2, 70_000),
    "forty": lambda: walks(40, 4000),
    "linear": filtered,
}


def packets_keep(recording: hapfmt.Recording, size: int) -> float:
    """The mean that is kept where any byte of a packet costs that packet: few places do not tell."""
    coded = encode(recording)
    width = {track.id: len(track.components) for track in coded.tracks}
    lost = sum(len(each.data) * each.span * width[each.track] for each in coded.packets)
    return 1 - lost / size / recording.sample_count


def check(recording: hapfmt.Recording) -> None:
    data = faults.lossless_file(recording)
    assert len(data) >= faults.LARGE
    kept = faults.kept_of(data, PLACES)
    mean = kept.mean if DEEP else packets_keep(recording, len(data))
    assert mean >= faults.MEAN_KEPT
    assert kept.least >= faults.LEAST_KEPT
    assert kept.described == 1
    assert kept.half >= faults.HALF_KEPT


@pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data")
@pytest.mark.parametrize("name", sample(RECORDINGS, always={"shock51k/Test_001"}))
def test_recordings(name):
    path = DATA / f"{name}.npz"
    if not path.exists():
        pytest.skip(f"no {name}")
    check(hapfmt.read(path))


@pytest.mark.parametrize("name", SYNTHETIC)
def test_synthetic(name):
    check(SYNTHETIC[name]())


def test_one_damaged_header_takes_little():
    data = faults.lossless_file(walks(40, 4000))
    clean = hapfmt.read(data)
    for chunk in walk(BytesSource(data), []):
        broken = bytearray(data)
        broken[chunk.offset] ^= 1
        assert faults.share_right(clean, bytes(broken)) >= faults.LEAST_KEPT


def test_channels_that_follow_from_each_other_share_a_track():
    recording = filtered()
    stream = io.BytesIO()
    hapfmt.write(recording, stream, canonical=1)
    with hapfmt.Reader(stream.getvalue()) as reader:
        tracks = [list(track.channels) for track in reader.catalogue.tracks.values()]
        back = reader.read()
    assert [0, 6] in tracks and [3] in tracks
    for given, found in zip(recording.channels, back.channels, strict=True):
        assert given.label == found.label
        assert given.samples().tobytes() == found.to_numpy().tobytes()


def test_a_given_cluster_is_kept():
    recording = walks(2, 70_000)
    stream = io.BytesIO()
    hapfmt.write(recording, stream, canonical=1, cluster=Fraction(10))
    with hapfmt.Reader(stream.getvalue()) as reader:
        assert len([ref for ref in reader.catalogue.chunks if ref.type == "DATA"]) == 7
