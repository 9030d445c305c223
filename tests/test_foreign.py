"""Data of another file never pass as this file's (SPEC 14.1): blocks of a second recording of the
same set-up in place of a file's own."""

from __future__ import annotations

import io
import sys
from collections import Counter
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import forge as f
import numpy as np
import pytest
from depth import either
from fuzzing.spliced import check
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples
from spec import ROOT
from test_viewer_data import NODE, Viewer

import hapfmt
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import identify

sys.path.insert(0, str(ROOT / "tools"))
import faults

pytestmark = pytest.mark.capped

OTHER_ID = 1 << 40
SETTINGS = hapfmt.Settings.of("lossless", cluster="5")


@cache
def array(count: int) -> faults.Case:
    """Elements of which few are touched, in clusters of 5 s; more than 20 kB."""
    return faults.built(
        f"{count} taxels", "", lambda number: faults.taxels(count, number), SETTINGS
    )


@pytest.mark.compiled
@pytest.mark.parametrize("kind", faults.FOREIGN)
@pytest.mark.parametrize(
    ("count", "seconds"), [(16, 300), pytest.param(64, 100, marks=pytest.mark.deep)]
)
@either("trials", 1, deep=4)
def test_no_sample_of_another_recording(kind, count, seconds, trials, monkeypatch):
    """
    REC-001: A reader MUST NOT deliver a sample from a packet whose CRC differs, nor from a chunk whose header CRC or file id differs.
    REC-012: A damage report MUST name every missing sample, by a span of its track or of one that its channel needs.
    """
    monkeypatch.setattr(faults, "TAXEL_SECONDS", seconds)
    case = array(count)
    rng = np.random.default_rng(3)
    right = 0
    for _ in range(trials):
        broken = faults.FOREIGN[kind](case.data, case.other, rng)
        if broken == case.data:
            continue
        trial = faults.attempt(case.clean, broken)
        assert (trial.wrong, trial.unnamed, trial.refused) == (0, 0, False)
        assert trial.reported and trial.intact and trial.same
        right += trial.right
    # A short file has one description only, in its first block.
    assert right or kind == "first blocks of another file"


def file_of(counts: list[int], file_id: int) -> list[bytes]:
    """The chunks of a file whose clusters each hold one count."""
    chunks = [("HEAD", f.head()), f.TRACK_0]
    for number, count in enumerate(counts):
        payload = f.cluster((0, 4 * number, 4, f.svarint(count)), file_id=file_id)
        chunks.append(("DATA", payload))
    return [
        f.chunk(type_, payload, sequence, file_id=file_id)
        for sequence, (type_, payload) in enumerate(chunks)
    ]


OURS, THEIRS = file_of([1, 2, 3, 4], f.FILE_ID), file_of([11, 12, 13, 14], OTHER_ID)
MIXED = f.SIGNATURE + THEIRS[0] + OURS[1] + OURS[2] + OURS[3] + THEIRS[4] + OURS[5]


def values(data: bytes, **given) -> list[int]:
    with hapfmt.Reader(data, **given) as reader:
        return sorted(set(reader.read().channels[0].stored.tolist()))


class TestChoice:
    """
    REC-013: A reader MUST take the file id that `identify` gives, unless its caller names another. It reports each other id that `walk` meets, with both ids. Every way to read a file takes the same id: whole, in part, by an index, or while it grows. An index is used only where `HEAD` and `last` of `identify` have the same id.
    """

    def test_most_bytes_choose(self):
        assert identify(BytesSource(MIXED)) == f.FILE_ID
        assert values(MIXED) == [1, 2, 4]

    def test_the_finding_names_both(self):
        report = hapfmt.verify(MIXED)
        (found,) = [each for each in report.findings if each["code"] == "other-file"]
        assert found["offset"] == 8
        assert "0x0000010000000000" in found["message"]
        assert "0x0000000000000007" in found["message"]
        assert rule(MIXED)[0] == "damaged"

    def test_the_caller_chooses(self):
        mixed = f.SIGNATURE + THEIRS[0] + THEIRS[1] + b"".join(OURS) + THEIRS[4]
        assert values(mixed) == [1, 2, 3, 4]
        assert values(mixed, file_id=OTHER_ID) == [13]
        out = io.BytesIO()
        hapfmt.recover(mixed, out, file_id=OTHER_ID, canonical=1)
        assert values(out.getvalue()) == [13]
        assert hapfmt.verify(mixed, file_id=OTHER_ID).samples == 4

    def test_an_intact_file_has_one(self):
        whole = f.SIGNATURE + b"".join(OURS)
        assert identify(BytesSource(whole)) == f.FILE_ID
        codes = [finding["code"] for finding in hapfmt.verify(whole).findings]
        assert codes == ["not-closed"]

    def test_an_id_that_no_chunk_has(self):
        with pytest.raises(hapfmt.HapfmtError):
            hapfmt.Reader(f.minimal(), file_id=99)

    def test_a_damaged_attachment_does_not_choose(self):
        """Its content is a file with more clusters than this one."""
        inner = f.SIGNATURE + b"".join(file_of(list(range(40)), OTHER_ID))
        data = bytearray(f.minimal(("aTTc", f.strings("a", "") + inner)))
        data[data.index(inner) + 3] ^= 1
        assert identify(BytesSource(bytes(data))) == f.FILE_ID
        assert samples(bytes(data)) == samples(f.minimal())


@pytest.fixture(scope="module")
def viewer():
    if NODE is None:
        yield None
        return
    one = Viewer()
    with one.process:
        yield one.open


@either("count", 30, 400, 2000)
def test_every_way_to_read_agrees(count, viewer, tmp_path):
    """
    REC-013: A reader MUST take the file id that `identify` gives, unless its caller names another. It reports each other id that `walk` meets, with both ids. Every way to read a file takes the same id: whole, in part, by an index, or while it grows. An index is used only where `HEAD` and `last` of `identify` have the same id.
    """
    told = Counter()
    for seed in range(count):
        told.update(check(seed, tmp_path, viewer))
    assert told["damaged"] > count // 2 and told["intact"]


@given(st.integers(0, 1 << 62))
def test_any_splice(seed):
    with TemporaryDirectory() as folder:
        check(seed, Path(folder))


class TestIds:
    """
    WRT-002: A writer MUST choose the file id at random. In canonical mode the id is an input or follows from the content. No time of day, host, user or random number enters the file: the same input and settings give the same bytes with the same encoder version on the same machine.
    """

    @staticmethod
    def written(x: np.ndarray, **given) -> tuple[bytes, int]:
        out = io.BytesIO()
        hapfmt.write(x, out, rate=1000, canonical="content", **given)
        with hapfmt.Reader(out.getvalue()) as reader:
            return out.getvalue(), reader.catalogue.file_id

    def test_by_content(self):
        x = np.arange(100)
        data, file_id = self.written(x)
        assert self.written(x) == (data, file_id)
        assert file_id >> 32
        others = [self.written(x + 1)[1], self.written(x, units="N")[1]]
        assert len({file_id, *others}) == 3

    def test_a_copy_of_packets_has_crcs_of_its_own(self):
        """A verb that copies packets writes them under the id of the new file."""
        data, _ = self.written(np.arange(1000) % 7)
        out = io.BytesIO()
        hapfmt.edit.subset(data, out, [0], canonical=5)
        assert hapfmt.verify(out.getvalue()).verdict == "intact"
        start, stop = faults.clusters_of(data)[0]
        begin, end = faults.clusters_of(out.getvalue())[0]
        assert stop - start == end - begin
        assert data[start:stop] != out.getvalue()[begin:end]
