"""FileWriter and write: chunks in one piece, indexes in time, nothing overwritten."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import walk
from hapfmt.format.wire import HEADER_SIZE
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.reading.opening import open_catalogue


class Pieces(io.BytesIO):
    """Remembers each write."""

    def __init__(self) -> None:
        super().__init__()
        self.sizes: list[int] = []

    def write(self, data: object) -> int:
        self.sizes.append(len(data))
        return super().write(data)


def words(samples: int, rate: int = 1000) -> Recording:
    """What no coder makes smaller, and none takes long for."""
    x = np.random.default_rng(1).integers(0, 1 << 64, samples, np.uint64)
    return Recording((Channel(x, Fraction(rate)),))


def types(data: bytes) -> list[str]:
    return [chunk.header.type for chunk in walk(BytesSource(data), [])]


def test_chunks_are_written_in_one_piece():
    """WRT-001: A writer MUST write a chunk only when it is complete, header and payload in one piece. If it cannot write it whole, it reports that, and removes the part where the system lets it cut."""
    stream = Pieces()
    hapfmt.write(simulate("sand", 1.0), stream)
    chunks = list(walk(BytesSource(stream.getvalue()), []))
    assert stream.sizes == [8, *(HEADER_SIZE + chunk.header.payload_size for chunk in chunks)]


def test_file_ids_are_random_outside_canonical_mode():
    """WRT-002: A writer MUST choose the file id at random. In canonical mode the id is an input or follows from the content. No time of day, host, user or random number enters the file: the same input and settings give the same bytes with the same encoder version on the same machine."""
    ids = set()
    for _ in range(8):
        stream = io.BytesIO()
        hapfmt.write(Recording(()), stream)
        ids.add(open_catalogue(BytesSource(stream.getvalue())).file_id)
    assert len(ids) == 8


def test_an_index_in_every_four_mebibytes():
    """IDX-005: A writer MUST write an index before the chunks that no index lists, together with the next one, pass 4 MiB. It writes one before the `fOOT` of a file that passes 64 KiB or 16 chunks. A live writer also writes one every 10 seconds. Where nothing is new it writes none, except before `fOOT`."""
    stream = io.BytesIO()
    hapfmt.write(words(1_250_000), stream, Settings(cluster=Fraction(20)))
    data = stream.getvalue()
    assert len(data) > 9 << 20
    chunks = list(walk(BytesSource(data), []))
    since = 8
    for chunk in chunks:
        if chunk.header.type == "iNDX":
            since = chunk.offset
        assert chunk.stop - since <= (4 << 20) + (1 << 20)
    assert [c.header.type for c in chunks][-2:] == ["iNDX", "fOOT"]
    assert types(data).count("iNDX") == 3
    assert hapfmt.verify(data).verdict == "intact"


def test_the_last_index_lists_everything():
    stream = io.BytesIO()
    hapfmt.write(words(900_000), stream)
    data = stream.getvalue()
    catalogue = open_catalogue(BytesSource(data))
    assert catalogue.indexed
    assert [ref.type for ref in catalogue.chunks] == types(data)


def test_clusters_too_large_for_a_payload_are_split():
    channels = tuple(words(60_000, 6000).channels[0] for _ in range(4))
    stream = io.BytesIO()
    hapfmt.write(Recording(channels), stream)
    data = stream.getvalue()
    assert types(data).count("DATA") > 2
    back = hapfmt.read(data)
    assert all((c.stored == channels[0].stored).all() for c in back.channels)


def test_a_copy_of_the_description_saves_a_file_with_a_damaged_start():
    stream = io.BytesIO()
    hapfmt.write(simulate("sand", 40.0), stream)
    data = bytearray(stream.getvalue())
    clean = hapfmt.read(bytes(data)).channels[0]
    assert types(bytes(data)).count("HEAD") == 2
    at = data.find(b"TRAK")
    data[at + 40] ^= 1
    with hapfmt.Reader(bytes(data)) as reader:
        back = reader.read().channels[0]
        assert reader.findings
    assert (back.stored == clean.stored).all() and back.label == clean.label


def test_channels_of_a_kind_share_one_description():
    joints = tuple(
        Channel(np.arange(3, dtype=np.int32) * 0 + i, Fraction(100), calibration=Calibration(),
                label=f"joint {i}") for i in range(22)
    )  # fmt: skip
    joints = tuple(Channel(np.full(3, 5, np.int32), c.rate_exact, calibration=c.calibration,
                           label=c.label) for c in joints)  # fmt: skip
    stream = io.BytesIO()
    hapfmt.write(Recording(joints), stream)
    assert types(stream.getvalue()).count("TRAK") == 1
    assert [c.label for c in hapfmt.read(stream.getvalue()).channels] == [c.label for c in joints]


def test_more_channels_than_one_description_holds():
    many = tuple(
        Channel(np.full(2, 1, np.int32), Fraction(1), calibration=Calibration(), label=str(i))
        for i in range(700)
    )
    stream = io.BytesIO()
    hapfmt.write(Recording(many), stream)
    back = hapfmt.read(stream.getvalue())
    assert [c.label for c in back.channels] == [c.label for c in many]


def test_an_existing_file_is_refused_without_force(tmp_path: Path):
    path = tmp_path / "a.hapf"
    path.write_bytes(b"precious")
    with pytest.raises(hapfmt.ParameterError, match="exists"):
        hapfmt.write(Recording(()), path)
    assert path.read_bytes() == b"precious"
    hapfmt.write(Recording(()), path, force=True)
    assert hapfmt.verify(path).verdict == "intact"


def test_a_failed_write_leaves_nothing(tmp_path: Path):
    wrong = Channel(np.array([True]), Fraction(1))
    with pytest.raises(hapfmt.ParameterError):
        hapfmt.write(Recording((wrong,)), tmp_path / "a.hapf")
    assert not list(tmp_path.iterdir())


def test_large_attachments_raise_the_level():
    attached = {"picture": ("image/png", bytes(3 << 20))}
    stream = io.BytesIO()
    hapfmt.write(Recording((), attachments=attached), stream)
    assert hapfmt.read(stream.getvalue()).attachments == attached
    with pytest.raises(hapfmt.ParameterError):
        hapfmt.write(Recording((), attachments={"a": ("", bytes(17 << 20))}), io.BytesIO())


def test_a_file_that_was_not_closed_gives_what_it_has():
    stream = io.BytesIO()
    recording = simulate("sand", 3.0)
    hapfmt.write(recording, stream, Settings(cluster=Fraction(1)))
    data = stream.getvalue()
    ends = [c.stop for c in walk(BytesSource(data), []) if c.header.type == "DATA"]
    with hapfmt.Reader(data[: ends[1]]) as reader:
        assert reader.read().channels[0].stored.size == 2000
        assert [finding.code for finding in reader.findings] == ["not-closed"]
