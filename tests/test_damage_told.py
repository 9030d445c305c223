"""What people are told of damage: short, by channel, and no loss that is none."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest
from commands import run
from depth import either
from fuzzing.mutants import mutant
from fuzzing.spliced import spliced
from terminal import called
from test_reader import encoded

import hapfmt
from hapfmt.reading.reader import Reader
from hapfmt.recording import Calibration, Channel, Recording


def recording() -> Recording:
    rng = np.random.default_rng(0)
    counts = [np.cumsum(rng.integers(-5, 6, 1575)).astype(np.int32) for _ in range(6)]
    counts.append(np.ones(1575, np.int32))
    return Recording(
        tuple(
            Channel(x, 240, calibration=Calibration(1, 0, 100), label=f"c{i}", unit="N")
            for i, x in enumerate(counts)
        )
    )


@pytest.fixture
def files(tmp_path):
    hapfmt.save(recording(), tmp_path / "t.npz")
    (tmp_path / "t.hapf").write_bytes(encoded(recording(), hapfmt.Settings(cluster=Fraction(1))))
    return tmp_path


def clusters(data: bytes) -> list[tuple[int, int]]:
    with Reader(data, scan=True) as reader:
        return [(ref.offset, ref.size) for ref in reader.catalogue.chunks if ref.type == "DATA"]


def flipped(data: bytes, place: int) -> bytes:
    out = bytearray(data)
    out[place] ^= 1
    return bytes(out)


def test_recovered_file_against_its_original(files):
    data = (files / "t.hapf").read_bytes()
    offset, size = clusters(data)[2]
    (files / "bad.hapf").write_bytes(flipped(data, offset + size // 2))
    assert run("recover", "bad.hapf", "r.hapf", cwd=files).returncode == 3
    done = run("verify", "r.hapf", cwd=files)
    assert done.returncode == 0 and done.stdout.startswith(b"r.hapf: intact; ")
    done = run("verify", "r.hapf", "--against", "t.npz", cwd=files)
    said = (done.stdout + done.stderr).decode()
    assert done.returncode == 3
    assert "intact, but 240 samples of the original are missing" in said
    assert "every sample that both have equals the original" in said
    assert "recover" not in said and "break" not in said


@pytest.mark.compiled
@either("every", 9, deep=1)
def test_no_loss_behind_the_end(files, every):
    """The index rounds the end up to a millisecond, which is a part of a tick."""
    data = (files / "t.hapf").read_bytes()
    offset, size = clusters(data)[-1]
    for place in range(offset + 30, offset + 20 + size, every):
        with Reader(flipped(data, place), scan=True) as reader:
            reader.read()
            for line in reader.damage().lines():
                assert "from 6.5625 s" not in line and "6.566" not in line


def test_a_cut_file_lost_nothing_of_a_channel_that_reaches_its_end(files):
    data = (files / "t.hapf").read_bytes()
    offset, _ = clusters(data)[3]
    (files / "cut.hapf").write_bytes(data[: offset + 40])
    done = run("verify", "cut.hapf", cwd=files)
    lines = done.stderr.decode().splitlines()
    assert done.returncode == 3
    assert lines[0].startswith("hapfmt: damage in ") and b"0x" not in done.stderr
    assert [line for line in lines if "lost" in line] == [
        "hapfmt: lost in 6 channels (c0, c1, c2, c3 ...): 3 s to the end"
    ]
    assert lines[-1].endswith("run: hapfmt recover cut.hapf OUT")
    assert b"[WRT-001]" in run("verify", "-v", "cut.hapf", cwd=files).stderr


def test_a_file_cut_between_chunks(files):
    data = (files / "t.hapf").read_bytes()
    (files / "cut.hapf").write_bytes(data[: clusters(data)[1][0]])
    done = run("recover", "cut.hapf", "r.hapf", cwd=files)
    assert done.returncode == 0
    assert b"the file was not closed; what came after" in done.stderr
    assert b"nothing lost of what is in the file" in done.stdout


def test_a_cut_in_the_only_cluster(tmp_path):
    """The cluster has no times of its own then: those of the packets that are left count."""
    counts = [np.ones(1575, np.int32), *(channel.stored for channel in recording().channels)]
    channels = [
        Channel(x, 240, calibration=Calibration(1, 0, 100), label=f"c{i}")
        for i, x in enumerate(counts)
    ]
    data = encoded(Recording(tuple(channels)), hapfmt.Settings())
    ((offset, size),) = clusters(data)
    (tmp_path / "cut.hapf").write_bytes(data[: offset + 32 + size * 2 // 5])
    done = run("verify", "cut.hapf", cwd=tmp_path)
    assert b"0 s to the end" in done.stderr
    assert b"what came after 6.5625 s is unknown" in done.stderr
    assert b"from 6.5625 s" not in done.stderr


def lost_ticks(report: dict | None) -> list[tuple] | None:
    return report and [(row["channel"], row["lost_ticks"]) for row in report["channels"]]


@either("seeds", range(40), deep=range(1000))
def test_every_verb_tells_the_same_damage(seeds, tmp_path):
    """Files that break rules, and files with parts of others."""
    path, count = tmp_path / "x.hapf", 0
    verbs = {
        "info": ("info", path),
        "decode": ("decode", path, tmp_path / "x.npz", "--force"),
        "recover": ("recover", path, tmp_path / "y.hapf", "--force"),
        "compare": ("compare", path, path),
    }
    for data in [*map(mutant, seeds), *(spliced(seed)[0] for seed in seeds)]:
        path.write_bytes(data)
        said = json.loads(called("verify", path, "--json").out)
        if said["verdict"] != "damaged" or said["error"]:
            continue
        count += 1
        for name, words in verbs.items():
            found = json.loads(called(*words, "--json").out)["damage"]
            report = found["a"] if name == "compare" else found
            # By its index alone info sees only what that leads to, and says so.
            assert lost_ticks(report) == lost_ticks(said["damage"]) or (
                name == "info" and report is None
            ), name
    assert count > len(seeds) // 2
