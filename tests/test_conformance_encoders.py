"""What run.py finds of encoders."""

from __future__ import annotations

import json
import math
import shlex
import struct
import sys
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import pytest
import suite
from runner import encoding, jobs
from runner.process import Caps, Implementation

WRONG = Path(__file__).resolve().parent / "wrong_encoder.py"
JOB = {
    "channels": [
        {"label": "a", "rate": [1000, 1], "format": "counts", "calibration": [1, 0, 1],
         "spans": [[0, 300], [400, 500]], "numbers": "a.raw"}
    ],
    "mode": "deadband", "k": [1, 10], "floor": 3, "guaranteed": True, "file_id": "0x0000000000000009",
    "cluster_s": [1, 50],
}  # fmt: skip


class Referee(Implementation):
    """One process for all tests."""

    def close(self):
        """Later."""


@pytest.fixture(scope="module")
def referee():
    made = Referee(suite.PROGRAMS["hapfmt"], Caps(60, 8 << 30))
    made.local = SimpleNamespace()
    yield made
    super(Referee, made).close()


class TestEncoders:
    """What run.py finds of encoders that are wrong in one thing."""

    def run(self, tmp_path, job, deed):
        room = tmp_path / "cases"
        folder = room / "vectors" / "encode" / "job"
        folder.mkdir(parents=True)
        counts = [round(500 * math.sin(i / 20)) for i in range(400)]
        (folder / "a.raw").write_bytes(struct.pack("<400q", *counts))
        (folder / "job.json").write_text(json.dumps(job))
        (room / "expected" / "encode").mkdir(parents=True)
        (room / "expected" / "encode" / "job.json").write_text(json.dumps({"exit": {"encode": 0}}))
        entry = {"set": "encode", "name": "job", "about": "A job.", "requirements": ["DBC-002"], "files": ["job.json", "a.raw"]}  # fmt: skip
        (room / "manifest.json").write_text(json.dumps({"format": "1.0", "cases": [entry]}))
        program = [sys.executable, str(WRONG), deed]
        return suite.called(
            "--cases", str(room), "--jobs", "1", "--memory", "8192", "--impl", shlex.join(program)
        )

    @pytest.mark.parametrize(
        ("mode", "deed", "said"),
        [
            ("deadband", "nothing", ()),
            pytest.param("split", "nothing", (), marks=pytest.mark.deep),
            ("lossless", "nothing", ()),
            ("lossless", "one more", (
                "decodes-to-input by hapfmt: channels[0], tick 0: expected 0, found 1",
                "strict-verify by hapfmt: exit code: expected 0 (intact), found 3",
            )),
            ("lossless", "no gap", ("channels[0].spans: expected [[0, 300], [400, 500]], found [[0, 400]]",)),
            ("lossless", "no label", ("channels[0].label: expected a, found",)),
            ("deadband", "wide", ("bounded-error by hapfmt: channels [0], tick",)),
            ("deadband", "random id", (
                "reencode-stable: a second run: expected the same bytes, found others from 1",
                "file id: expected 0x0000000000000009, found",
            )),
            ("deadband", "no index", ("index-complete: index: expected every chunk, in order, found at",)),
            ("deadband", "no footer", ("index-complete: index: expected every chunk, in order, found no fOOT",)),
            ("deadband", "refuse", ("not tested: 1 cases for want of an encoder that does this job",)),
            ("deadband", "no file", ("encode: expected a file, found none",)),
        ],
    )  # fmt: skip
    def test_each(self, tmp_path, referee, monkeypatch, mode, deed, said):
        monkeypatch.setattr(suite.run, "own", lambda *_given, **_named: [referee])
        code, text = self.run(tmp_path, JOB | {"mode": mode}, deed)
        assert code == int(bool(said) and deed != "refuse"), text
        assert all(each in text for each in said), text

    def test_what_a_cut_file_gives(self):
        whole = {(0, 0): 1, (0, 1): 2}
        assert not list(encoding.cut_differences({(0, 0): 1}, {(0, 0): 1}, whole))
        for found, before in (({}, {(0, 0): 1}), ({(0, 0): 2}, {}), ({(0, 5): 1}, {})):
            assert list(encoding.cut_differences(found, before, whole))

    def test_a_vector_may_be_wider_than_its_axes(self):
        told = {"rate": [1, 1], "format": "counts", "spans": [[0, 1]], "group": "g"}
        channels = [jobs.Channel(told | {"axis": axis}, (100,)) for axis in "xy"]
        job = jobs.Job({"mode": "deadband", "k": [1, 10], "floor": 1}, channels)
        assert jobs.groups(channels) == [[0, 1]]
        rows = [(114,), (100,)]
        assert not list(jobs.bound_differences(job, [0, 1], rows))
        assert list(jobs.bound_differences(job, [0, 1], [(115,), (100,)]))
        assert list(jobs.bound_differences(job, [0], rows[:1]))

    def test_words_may_be_counts_of_the_same_numbers(self):
        half = struct.unpack("<Q", struct.pack("<d", 0.5))[0]
        told = {"rate": [1, 1], "format": "binary64", "spans": [[0, 1]]}
        channel = jobs.Channel(told, (half,))
        assert channel.value(half) == Fraction(1, 2)
        assert jobs.Channel(told | {"format": "binary16"}, ()).value(0x7C00) is None

    @pytest.mark.parametrize(
        ("calibration", "zero"), [((1, 0, 1), 0), ((2, -5, 9), 3), ((2, 5, 1), -2), ((-2, 5, 1), 3)]
    )
    def test_count_of_the_physical_value_0(self, calibration, zero):
        assert jobs.Channel({"calibration": calibration}, ()).zero == zero
