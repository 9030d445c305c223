"""Clause 14: finding chunks through damage, against SPEC's procedure taken at its word."""

from __future__ import annotations

import time
import zlib

import forge as f
import pytest
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples
from stalls import slowness

from hapfmt.errors import LimitError
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import BLOCK_SIZE, Finding, find_header, walk
from hapfmt.reading.verifier import verify

pytestmark = pytest.mark.capped

CHUNKS = [("HEAD", f.head()), f.TRACK_0, f.DATA_0, ("mETa", b"{}"), ("aTTc", f.strings("a", "b"))]
DATA = f.closed(*CHUNKS)
ATTACHED = f.closed(("HEAD", f.head()), ("aTTc", f.strings("a", "") + DATA), f.TRACK_0, f.DATA_0)
"""A whole file, of the same file id, inside an attachment."""


def slow_walk(data: bytes) -> list[tuple[int, bool]]:
    """(offset, intact) of the chunks that SPEC's procedure uses, in its own words."""

    def number(p: int, size: int) -> int:
        return int.from_bytes(data[p : p + size], "little")

    def valid(p: int, id_: int | None) -> bool:
        h = data[p : p + 32]
        return (
            len(h) == 32
            and h[:4] == f.SYNC
            and zlib.crc32(h[:28]) == number(p + 28, 4)
            and h[4:8].isalpha()
            and h[4:8].isascii()
            and size(p) <= 1 << 24
            and id_ in (None, id_at(p))
        )

    def id_at(p: int) -> int:
        return number(p + 8, 8)

    def size(p: int) -> int:
        return number(p + 20, 4)

    def payload(p: int) -> bytes:
        return data[p + 32 : p + 32 + size(p)]

    def intact(p: int) -> bool:
        whole = len(payload(p)) == size(p)
        return whole and f.file_crc(payload(p), id_at(p)) == number(p + 24, 4)

    headers = [p for p in range(len(data)) if valid(p, None)]
    id_ = id_at(headers[0]) if headers else None  # test_foreign.py has files of several ids
    position = 8 if data[:8] == f.SIGNATURE else 0
    seen: set[int] = set()
    suspect: int | None = None
    used = []
    while True:
        if not (position < len(data) and valid(position, id_)):
            if position >= len(data) and suspect is None:
                return used
            start = position if suspect is None else suspect
            later = [p for p in headers if p >= start and valid(p, id_)]
            if not later:
                return used
            position, suspect = later[0], None
            continue
        at, position = position, min(position + 32 + size(position), len(data))
        sequence = number(at + 16, 4)
        if sequence in seen:
            suspect = at + 32
            continue
        used.append((at, intact(at)))
        if intact(at):
            seen.add(sequence)
        suspect = None if intact(at) else at + 32


def fast_walk(data: bytes) -> tuple[list[tuple[int, bool]], list[Finding]]:
    findings: list[Finding] = []
    chunks = list(walk(BytesSource(data), findings))
    return [(chunk.offset, chunk.intact) for chunk in chunks], findings


@st.composite
def damaged(draw, data):
    """Some edits of a file: flips, deletions, insertions, copies, cuts."""
    out = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(out) - 1))
        kind = draw(st.sampled_from(["flip", "delete", "insert", "copy", "cut"]))
        size = draw(st.sampled_from([1, 2, 32, 100]))
        if kind == "flip":
            out[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == "delete":
            del out[at : at + size]
        elif kind == "insert":
            out[at:at] = draw(st.binary(max_size=8) | st.just(f.SYNC))
        elif kind == "copy":
            out[at:at] = out[draw(st.integers(0, at)) :][:size]
        else:
            del out[max(at, 1) :]
        if not out:
            out = bytearray(b"\0")
    return bytes(out)


@given(damaged(DATA) | damaged(ATTACHED))
def test_finds_what_the_page_finds(data):
    """
    REC-002: A recovering reader MUST find at least the chunks and packets that the procedures below find.
    """
    assert fast_walk(data)[0] == slow_walk(data)


@given(
    st.binary(max_size=100) | st.lists(st.sampled_from([f.SYNC, DATA[8:44], b"\0"])).map(b"".join)
)
def test_any_bytes(data):
    assert fast_walk(data)[0] == slow_walk(data)


@given(damaged(DATA))
def test_every_byte_is_a_chunk_or_reported(data):
    """
    REC-003: A reader that goes on after damage MUST report every stretch of bytes that was lost, and every span that `lost` names.
    """
    chunks, findings = fast_walk(data)
    covered = bytearray(len(data))
    covered[:8] = b"\1" * 8
    for at, intact in chunks:
        size = f.HEADER + (int.from_bytes(data[at + 20 : at + 24], "little") if intact else 0)
        covered[at : at + size] = b"\1" * size
    for finding in findings:
        covered[finding.offset : finding.offset + finding.size] = b"\1" * finding.size
    assert all(covered[: len(data)])


def test_an_attached_file_is_content():
    assert fast_walk(ATTACHED) == ([(at, True) for at, _ in slow_walk(ATTACHED)], [])
    assert rule(ATTACHED) == ("intact", None)
    assert len(fast_walk(ATTACHED)[0]) == 6


@pytest.mark.parametrize("edge", [BLOCK_SIZE, 2 * BLOCK_SIZE])
@pytest.mark.parametrize("shift", range(-5, 38))
def test_a_header_across_the_edge_of_a_block(edge, shift):
    chunk = f.chunk("mETa", b"{}", 0)
    at = edge - shift
    data = b"\xf9" * at + chunk
    for start in (0, 3, at):
        assert find_header(BytesSource(data), start, f.FILE_ID) == at
    assert find_header(BytesSource(data), at + 1, f.FILE_ID) is None


@pytest.mark.parametrize(
    ("junk", "code"), [(b"\0", "garbage"), (b"\xff" * 70_000, "garbage"), (f.SYNC, "garbage")]
)
def test_bytes_after_the_last_chunk(junk, code):
    data = f.minimal() + junk
    report = verify(data)
    assert report.verdict == "damaged"
    assert report.findings[0]["code"] == code
    assert (report.findings[0]["offset"], report.findings[0]["size"]) == (
        len(data) - len(junk),
        len(junk),
    )
    assert samples(data) == samples(f.minimal())


def test_one_deleted_byte_costs_one_cluster():
    data = f.closed(
        ("HEAD", f.head()),
        f.TRACK_0,
        *[("DATA", f.cluster((0, 4 * i, 4, f.KNOT_DATA))) for i in range(3)],
    )
    second = [at for at, _ in slow_walk(data)][3]
    found = samples(data[: second + 40] + data[second + 41 :])
    assert {tick for _, tick in found} == {0, 1, 2, 3, 8, 9, 10, 11}


def test_a_chunk_that_comes_twice():
    twice = f.file(*CHUNKS[:3]) + f.chunk(*f.DATA_0[:2], 2)
    report = verify(twice)
    assert "duplicate-chunk" in [finding["code"] for finding in report.findings]
    assert samples(twice) == samples(f.minimal())


def nested(count: int) -> bytes:
    """Headers that each promise all that follows."""
    out = b""
    for sequence in range(count, 0, -1):
        size = f.HEADER * (count - sequence)
        out = f.chunk("aaaa", b"", sequence, size=size, crc=1) + out
    return f.file(("HEAD", f.head())) + out


def test_nested_headers_are_bounded():
    """
    REC-005: A reader MUST bound its work on nested headers. It may stop and report *unsupported* once it took checksums of more than 16 times the size of the file plus 64 MiB.
    """
    data = nested(8000)
    began = time.process_time()
    with pytest.raises(LimitError) as error:
        fast_walk(data)
    assert error.value.requirement == "REC-005"
    assert time.process_time() - began < 5 * slowness()
    assert rule(data) == ("unsupported", "REC-005")


def test_a_few_nested_headers_are_found():
    assert len(fast_walk(nested(50))[0]) == 51
