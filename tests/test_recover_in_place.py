"""``recover --in-place``: ends are mended in the file, anything else beside it."""

from __future__ import annotations

import json

import forge as f
import pytest
from judge import samples
from test_recover import flipped, packets, payload_of, run

import hapfmt
from hapfmt.errors import FormatError, ParameterError
from hapfmt.reading.verifier import verify
from hapfmt.writing.start import open_append

ROWS = [(0, 4 * i, 4, f.svarint(i)) for i in range(4)]
WHOLE = f.closed(
    ("HEAD", f.head()), f.TRACK_0, *[("DATA", f.cluster(row)) for row in ROWS],
    duration_ns=16_000_000,
)  # fmt: skip
OPEN = WHOLE[: payload_of(WHOLE, "iNDX") - f.HEADER]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.hapf"


def names(path) -> list[str]:
    return sorted(found.name for found in path.parent.iterdir())


def test_an_intact_file_is_left_alone(path):
    path.write_bytes(WHOLE)
    done = hapfmt.recover_in_place(path)
    assert (done.exit_code, done.mended, path.read_bytes()) == (0, "", WHOLE)


@pytest.mark.parametrize(
    ("data", "code", "kept"),
    [
        (OPEN, 0, ROWS),
        (OPEN[:-1], 3, ROWS[:3]),
        (OPEN[:-20], 3, ROWS[:3]),
        (WHOLE + b"garbage", 3, ROWS),
        (WHOLE[:-1], 3, ROWS),
    ],
)
def test_ends_are_mended_in_the_file(path, data, code, kept):
    path.write_bytes(data)
    done = hapfmt.recover_in_place(path)
    found = path.read_bytes()
    assert (done.mended, names(path)) == ("end", ["a.hapf"])
    assert verify(found).verdict == "intact"
    assert packets(found) == kept
    assert found[: len(OPEN) - 60] == data[: len(OPEN) - 60]
    assert done.exit_code in (0, code)


@pytest.mark.parametrize("place", [100, payload_of(WHOLE, "DATA", 1), payload_of(WHOLE, "DATA", 3)])
def test_other_damage_is_mended_beside(path, place):
    bad = flipped(WHOLE, place)
    path.write_bytes(bad)
    done = hapfmt.recover_in_place(path)
    assert (done.exit_code, done.mended) == (3, "file")
    assert names(path) == ["a.hapf", "a.hapf.damaged"]
    assert (path.parent / "a.hapf.damaged").read_bytes() == bad
    assert verify(path.read_bytes()).verdict == "intact"
    assert samples(path.read_bytes()) == samples(bad)


def test_the_damaged_one_is_never_written_over(path):
    path.write_bytes(flipped(WHOLE, 100))
    (path.parent / "a.hapf.damaged").write_bytes(b"older")
    with pytest.raises(ParameterError, match="already exists"):
        hapfmt.recover_in_place(path)
    assert path.read_bytes() == flipped(WHOLE, 100)
    assert (path.parent / "a.hapf.damaged").read_bytes() == b"older"


def test_a_file_that_is_being_written_is_refused(path):
    path.write_bytes(WHOLE)
    with open_append(path), pytest.raises(ParameterError, match="Another program"):
        hapfmt.recover_in_place(path)


def test_a_failure_changes_nothing(path, monkeypatch):
    from hapfmt.edit import recover

    bad = flipped(WHOLE, payload_of(WHOLE, "DATA", 1))
    path.write_bytes(bad)
    monkeypatch.setattr(recover.os, "link", lambda *_: (_ for _ in ()).throw(OSError("no")))
    with pytest.raises(OSError, match="no"):
        hapfmt.recover_in_place(path)
    assert (names(path), path.read_bytes()) == (["a.hapf"], bad)


def test_what_is_no_file_is_refused(path):
    path.write_bytes(b"nothing")
    with pytest.raises(FormatError):
        hapfmt.recover_in_place(path)
    with pytest.raises(FileNotFoundError):
        hapfmt.recover_in_place(path.parent / "none.hapf")


def test_verb(path):
    path.write_bytes(flipped(WHOLE, payload_of(WHOLE, "DATA", 1)))
    done = run("--in-place", str(path), "--json")
    report = json.loads(done.stdout)
    assert (done.returncode, report["mended"]) == (3, "file")
    assert report["kept_as"].endswith("a.hapf.damaged")
    assert run("--in-place", str(path)).returncode == 0
    both, neither = run("--in-place", str(path), "other.hapf"), run(str(path))
    assert both.returncode == neither.returncode == 1
    assert b"Give OUT or --in-place, not both" in both.stderr
    assert b"Give OUT, the file to write, or --in-place" in neither.stderr


BAD_INDEX = f.closed(
    ("HEAD", f.head()), f.TRACK_0, *[("DATA", f.cluster(row)) for row in ROWS],
    duration_ns=17_000_000,
)  # fmt: skip
"""The footer states another duration."""


def test_a_file_that_breaks_a_rule_is_not_left_alone(path):
    path.write_bytes(BAD_INDEX)
    assert verify(BAD_INDEX).verdict == "nonconforming"
    done = hapfmt.recover_in_place(path)
    assert (done.exit_code, done.mended) == (0, "file")
    assert verify(path.read_bytes()).verdict == "intact"
    assert packets(path.read_bytes()) == ROWS


def test_a_packet_that_breaks_a_rule_does_not_stay_at_the_end(path):
    """Appending would keep it: its checksum holds."""
    bad = f.file(("HEAD", f.head()), f.TRACK_0, ("DATA", f.cluster((0, 0, 4, b""))))
    path.write_bytes(bad)
    done = hapfmt.recover_in_place(path)
    assert (done.exit_code, done.mended) == (3, "file")
    assert verify(path.read_bytes()).verdict == "intact"
