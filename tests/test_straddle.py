"""A header is found wherever it starts, whatever edges of buffers it lies across."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path

import forge as f
import pytest
from judge import samples

from hapfmt.format.source import ByteSource, BytesSource, open_source
from hapfmt.format.walk import BLOCK_SIZE, FIRST_BLOCK, find_header, walk
from hapfmt.reading.verifier import verify

EDGES = (1 << 12, 1 << 16, 1 << 20)
SHIFTS = range(-1, 34)
"""Bytes of the header that stand before the edge: none, some of the sync word, some of the header,
all of it."""
SIZES = [FIRST_BLOCK << i for i in range((BLOCK_SIZE // FIRST_BLOCK).bit_length())]
OWN_EDGES = [*accumulate(SIZES), sum(SIZES) + BLOCK_SIZE, sum(SIZES) + 2 * BLOCK_SIZE]
"""Where the blocks end that a scan reads, counted from its start."""
CHUNK = f.chunk("mETa", b"{}", 0)
BAIT = [b"\xf9", b"\0", f.SYNC[:2], f.SYNC[:3], f.SYNC, CHUNK[:31]]
"""What fills the space in front: a false start in every place."""


def filled(size: int, bait: bytes) -> bytes:
    return (bait * (size // len(bait) + 1))[len(bait) - size % len(bait) :][:size]


@pytest.mark.parametrize("bait", BAIT)
@pytest.mark.parametrize("edge", EDGES)
def test_edges_of_buffers(edge, bait):
    """
    REC-002: A recovering reader MUST find at least the chunks and packets that the procedures below find.
    """
    front = b"\xf9" * edge + filled(min(edge, 1 << 14) + 1, bait)
    for shift in SHIFTS:
        at = edge - shift
        source = BytesSource(front[len(front) - at :] + CHUNK + b"\xf9" * 40)
        assert find_header(source, 0, f.FILE_ID) == at
        assert find_header(source, at + 1, f.FILE_ID) is None


@pytest.mark.parametrize("start", [0, 8, 4093])
def test_edges_of_the_blocks_of_the_scan(start):
    for edge in OWN_EDGES:
        for shift in SHIFTS:
            at = start + edge - shift
            source = BytesSource(b"\xf9" * at + CHUNK)
            assert find_header(source, start, None) == at


def damaged_at(at: int) -> bytes:
    """A file whose DATA chunk starts at ``at``, after a chunk that has lost a byte."""
    start = len(f.file(("HEAD", f.head()), f.TRACK_0))
    long = ("aTTc", f.strings("a", "") + b"\xf9\0" * (1 << 19))
    size = at - start - f.HEADER + 1
    attached = (long[0], long[1][:size])
    data = f.file(("HEAD", f.head()), f.TRACK_0, attached, f.DATA_0)
    return data[: start + 40] + data[start + 41 :]


@pytest.mark.parametrize("edge", EDGES)
@pytest.mark.parametrize("kind", ["bytes", "file"])
def test_a_walk_across_edges(edge, kind, tmp_path: Path):
    """
    REC-002: A recovering reader MUST find at least the chunks and packets that the procedures below find.
    """
    for shift in (0, 1, 2, 3, 4, 16, 35, 36):
        data = damaged_at(edge - shift)
        source: ByteSource = BytesSource(data)
        if kind == "file":
            (tmp_path / "a.hapf").write_bytes(data)
            source = open_source(tmp_path / "a.hapf")
        places = [(chunk.header.type, chunk.offset) for chunk in walk(source, [])]
        source.close()
        assert places[-1] == ("DATA", edge - shift)


def test_its_samples():
    data = damaged_at((1 << 20) - 2)
    assert verify(data).verdict == "damaged"
    assert samples(data) == samples(f.minimal())
