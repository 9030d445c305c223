"""What people are told of damage: short, by channel, and no loss that is none."""

from __future__ import annotations

import json
from fractions import Fraction

import forge as f
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


def cut_out(data: bytes, start: int, stop: int) -> bytes:
    return data[:start] + data[stop:]


def damaged_files(data: bytes) -> dict[str, bytes]:
    places = clusters(data)
    (second, size), (fifth, _), last = places[1], places[4], len(data) - 30
    flip = flipped(data, second + size // 2)
    return {
        "flipped, with its index": flip,
        "flipped, without an index": flipped(flip, last),
        "a cluster is missing": cut_out(data, second, second + size),
        "a cluster and the index are missing": flipped(
            cut_out(data, second, second + size), last - size
        ),
        "cut": data[: fifth + 60],
        "flipped and cut": flip[: fifth + 60],
    }


def ticks_lost(reader: Reader, first: int, last: int) -> set[tuple[int, int]]:
    """(track, tick) of all that is lost within some ticks."""
    return {
        (span.track, tick)
        for span in reader.lost
        for tick in range(max(first, span.start), last if span.stop is None else span.stop)
        if tick < last
    }


@pytest.mark.parametrize("kind", damaged_files(encoded(recording(), hapfmt.Settings(cluster=1))))
def test_a_part_lost_what_the_whole_file_lost_there(kind, files):
    data = damaged_files((files / "t.hapf").read_bytes())[kind]
    whole = Reader(data, scan=True)
    whole.read()
    for start, stop in [(0, 1), (1, 2), (1.5, 1.75), (2, 5), (3, 4), (4.5, 6), (5, 6.5)]:
        with Reader(data) as part:
            read = part.read(None, start, stop)
            first, last = int(start * 240), int(stop * 240)
            lost = ticks_lost(part, first, last)
            assert lost == ticks_lost(whole, first, last), (start, stop)
            closed = [span for span in part.lost if span.stop is not None]
            assert all(first <= span.start < span.stop <= last for span in closed)
            for ref, channel in zip(part.channels, read.channels, strict=True):
                for span in channel.coverage:
                    assert not lost & {
                        (ref.track.id, tick) for tick in range(span.start, span.start + span.ticks)
                    }


def test_a_report_on_a_part_says_so(files):
    """No line about a part sounds as if it were about the file."""
    data = (files / "t.hapf").read_bytes()
    bad = damaged_files(data)["flipped, without an index"]
    (files / "bad.hapf").write_bytes(bad)
    for start, said in (("1", "lost: "), ("3", "no sample of this part is known to be lost")):
        for words in (["decode", "bad.hapf", "o.npz"], ["plot", "bad.hapf", "-o", "o.svg"]):
            more = ["--start", start, "--stop", str(int(start) + 1), "--force"]
            done = run(*words, *more, cwd=files)
            assert done.returncode == 3, words
            assert said in done.stderr.decode()
            assert "this is about the part that was read" in done.stderr.decode()
        assert "hapfmt verify checks all" in (files / "o.svg").read_text()
    assert "about the part" not in run("decode", "bad.hapf", "o.csv", cwd=files).stderr.decode()
    assert "about the part" not in run("verify", "bad.hapf", cwd=files).stderr.decode()


def test_where_nothing_can_be_read_nothing_is_said_to_be_kept(files):
    data = (files / "t.hapf").read_bytes()
    start = clusters(data)[0][0]
    (files / "zero.hapf").write_bytes(bytes(len(data) - 100) + data[-100:])
    (files / "head.hapf").write_bytes(data[: start + 20])
    for name, said in (("zero", "what was in it is not known"), ("head", "lost in 7 channels")):
        done = run("verify", f"{name}.hapf", cwd=files)
        text = done.stderr.decode()
        assert done.returncode == 3 and said in text, text
        assert "no sample is known" not in text and "recover" not in text
        done = run("decode", f"{name}.hapf", "o.csv", "--start", "1", cwd=files)
        assert done.returncode == 3 and said in done.stderr.decode()
        assert not (files / "o.csv").exists()
    done = run("decode", "zero.hapf", "o.csv", cwd=files)
    assert done.returncode == 3 and b"what was in it is not known" in done.stderr


def test_the_length_is_that_of_the_packets_found(tmp_path):
    """The only cluster is cut short, so it has no times of its own."""
    data = encoded(recording(), hapfmt.Settings())
    ((offset, size),) = clusters(data)
    (tmp_path / "cut.hapf").write_bytes(data[: offset + 32 + size * 2 // 5])
    found = json.loads(run("info", "cut.hapf", "--json", cwd=tmp_path).stdout)
    assert found["duration_s"] == 6.5625
    assert b" 6.5625 s, " in run("info", "cut.hapf", cwd=tmp_path).stdout
    done = run("decode", "cut.hapf", "o.npz", "--start", "6", cwd=tmp_path)
    assert done.returncode == 3 and b"0 s to the end" in done.stderr
    (tmp_path / "start.hapf").write_bytes(data[:offset])
    found = json.loads(run("info", "start.hapf", "--json", cwd=tmp_path).stdout)
    assert found["duration_s"] is None
    assert b"of unknown length" in run("info", "start.hapf", cwd=tmp_path).stdout


@pytest.mark.parametrize("place", [8, 40], ids=["header", "payload"])
@pytest.mark.parametrize("indexed", [False, True])
def test_the_length_of_a_closed_file_is_that_of_its_footer(place, indexed):
    last = ("DATA", f.cluster((0, 100, 4, f.KNOT_DATA)))
    data = bytearray(
        f.closed(
            ("HEAD", f.head()), f.TRACK_0, f.DATA_0, last, duration_ns=104_000_000, indexed=indexed
        )
    )
    data[data.index(b"DATA", data.index(b"DATA") + 4) - 4 + place] ^= 1
    for scan in (False, True):
        with Reader(bytes(data), scan=scan) as reader:
            assert reader.duration == Fraction(104, 1000)


def test_the_picture_counts_the_channels_that_verify_names():
    data = encoded(recording(), hapfmt.Settings())
    ((offset, size),) = clusters(data)
    with Reader(data[: offset + 32 + size * 2 // 5], scan=True) as reader:
        reader.read()
        report = reader.damage()
        named = {label for part in report.parts() for label in part.labels if part.start < 6.5}
        assert 0 < len(named) < 7
        assert report.headline() == f"{len(named)} of 7 channels lost samples to damage"
        assert repr(report) == "\n  ".join([f"Damage: {report.headline()}", *report.lines()])
    with Reader(data) as reader:
        assert repr(reader.damage()) == "Damage: none"


def test_a_lost_stretch_is_named(files):
    data = (files / "t.hapf").read_bytes()
    offset, size = clusters(data)[2]
    (files / "bad.hapf").write_bytes(cut_out(data, offset, offset + size))
    options = ["--start", "2.25", "--stop", "2.5", "--channels", "c1"]
    done = run("decode", "bad.hapf", "o.npz", *options, cwd=files)
    assert done.returncode == 3
    assert b"lost: c1 from 2.25 s to 2.5 s" in done.stderr and b"ends at" not in done.stderr
    assert not (files / "o.npz").exists()


def test_advice_names_options_that_exist(files):
    """The id of a chosen file is in the next command too, and no Python word in any text."""
    data = (files / "t.hapf").read_bytes()
    hapfmt.write(recording(), files / "other.hapf", canonical=5)
    offset, size = clusters(data)[2]
    mixed = flipped(data, offset + size // 2) + (files / "other.hapf").read_bytes()[8:]
    (files / "bad.hapf").write_bytes(mixed)
    file_id = json.loads(run("info", "t.hapf", "--json", cwd=files).stdout)["file_id"]
    done = run("verify", "bad.hapf", "--file-id", file_id, cwd=files)
    assert f"recover bad.hapf OUT --file-id {file_id}".encode() in done.stderr
    done = run("decode", "bad.hapf", "o.npz", "--file-id", file_id, cwd=files)
    assert f"verify -v bad.hapf --file-id {file_id}".encode() in done.stderr
    for words in (["info", "bad.hapf"], ["plot", "bad.hapf", "-o", "o.svg"]):
        assert b"; hapfmt decode --file-id reads the other" in run(*words, cwd=files).stderr
    assert "file_id=" not in (files / "o.svg").read_text()
    run("recover", "bad.hapf", "r.hapf", "--file-id", file_id, cwd=files)
    assert b"file_id=" not in run("info", "r.hapf", cwd=files).stdout


def lost_ticks(report: dict | None) -> list[tuple] | None:
    return report and [(row["channel"], row["lost_ticks"]) for row in report["channels"]]


@either("seeds", range(20), range(200), range(1000))
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
