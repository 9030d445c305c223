"""Clauses 11.1 and 11.2: the index and the footer are hints; without them the file is walked."""

from __future__ import annotations

import contextlib
import io
import time
from fractions import Fraction
from itertools import accumulate

import forge as f
import pytest
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples
from stalls import slowness

from hapfmt.errors import FormatError
from hapfmt.format.cluster import Packet
from hapfmt.format.extras import (
    Attachment,
    Foot,
    Index,
    IndexEntry,
    build_foot,
    build_index,
    ceil_ms,
    ceil_ns,
    floor_ms,
    parse_foot,
    parse_index,
)
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Component, Track
from hapfmt.reading.opening import open_catalogue
from hapfmt.reading.reader import Reader
from hapfmt.writing.filewriter import FileWriter

pytestmark = pytest.mark.capped

HEAD = ("HEAD", f.head())
TRACK_AT = 8 + f.HEADER + len(f.head())
DATA_AT = TRACK_AT + f.HEADER + len(f.TRACK_0[1])
u64 = st.integers(0, 2**64 - 1)


@st.composite
def indexes(draw):
    # Chunks stand at least a header apart.
    gaps = draw(st.lists(st.integers(f.HEADER, 2**50), max_size=4))
    offsets = list(accumulate(gaps, initial=draw(st.integers(8, 2**50))))[: len(gaps)]
    types = st.sampled_from(["HEAD", "TRAK", "DATA", "mETa"])
    ms = st.integers(0, 2**53 - 1)
    rows = tuple(
        IndexEntry(kind, at, *(sorted((draw(ms), draw(ms))) if kind == "DATA" else (0, 0)))
        for kind, at in [(draw(types), at) for at in offsets]
    )
    previous = draw(st.sampled_from([0, rows[0].offset if rows else 8]))
    return Index(previous, draw(st.integers(0, 2**32 - 1)), rows)


@given(indexes())
def test_an_index_comes_back(index):
    """
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    """
    data = build_index(index)
    rows = [tuple(entry) for entry in index.entries]
    assert data == f.index(rows, previous=index.previous, first=index.first_sequence)
    assert parse_index(data, 2**64, 0) == index


@given(st.builds(Foot, st.integers(0, 2**32 - 1), u64))
def test_a_footer_comes_back(foot):
    """
    FOT-001: The payload MUST be as long as the layout.
    """
    assert build_foot(foot) == f.foot(*foot)
    assert parse_foot(build_foot(foot), 100) == foot


@given(st.binary(max_size=80))
def test_any_bytes(data):
    for parse in (lambda: parse_index(data, 500, 0), lambda: parse_foot(data, 0)):
        with contextlib.suppress(FormatError):
            parse()


@pytest.mark.parametrize("count", [2**32 - 1, 2**31, 1])
def test_entries_that_are_not_there(count):
    with pytest.raises(FormatError, match="length"):
        parse_index(f.index([], count=count), 500, 0)


@given(st.fractions(min_value=0, max_value=9 * 10**9))
def test_milliseconds_hold_the_time(seconds):
    assert Fraction(floor_ms(seconds), 1000) <= seconds <= Fraction(ceil_ms(seconds), 1000)
    assert ceil_ms(seconds) - floor_ms(seconds) <= 1


@given(st.fractions(min_value=0, max_value=9 * 10**9))
def test_nanoseconds_hold_the_time(seconds):
    assert Fraction(ceil_ns(seconds) - 1, 10**9) < seconds <= Fraction(ceil_ns(seconds), 10**9)


def test_times_beyond_their_range():
    """
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    """
    far = Fraction(2**48 * 2**32)
    assert ceil_ns(far) == 2**63 - 1
    assert (floor_ms(far), ceil_ms(far)) == (2**53 - 1, 2**53 - 1)


def two_indexes(**changes) -> bytes:
    """HEAD, TRAK, DATA, index of all; DATA, index of that, footer."""
    out = f.file(HEAD, f.TRACK_0, f.DATA_0)
    second = 8 + f.HEADER + len(f.head())
    third = second + f.HEADER + len(f.TRACK_0[1])
    first_index = len(out)
    rows = [("HEAD", 8, 0, 0), ("TRAK", second, 0, 0), ("DATA", third, 0, 10**9)]
    out += f.chunk("iNDX", f.index(rows), 3)
    data = len(out)
    out += f.chunk("DATA", f.cluster((0, 4, 4, f.KNOT_DATA)), 4)
    rows = [("iNDX", first_index, 0, 0), ("DATA", data, 0, 10**9)]
    given_ = {"previous": first_index, "first": 3} | changes
    last_index = len(out)
    out += f.chunk("iNDX", f.index(rows, **given_), 5)
    return out + f.chunk("fOOT", f.foot(len(out) - last_index, 8_000_000), 6)


def left_out() -> bytes:
    """HEAD, TRAK, DATA, index; DATA in no index, DATA, index, footer."""
    out = f.file(HEAD, f.TRACK_0, f.DATA_0)
    first = len(out)
    rows = [("HEAD", 8, 0, 0), ("TRAK", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, 10**9)]
    out += f.chunk("iNDX", f.index(rows), 3)
    out += f.chunk("DATA", f.cluster((0, 4, 4, f.KNOT_DATA)), 4)
    listed = len(out)
    out += f.chunk("DATA", f.cluster((0, 8, 4, f.KNOT_DATA)), 5)
    last = len(out)
    rows = [("iNDX", first, 0, 0), ("DATA", listed, 0, 10**9)]
    out += f.chunk("iNDX", f.index(rows, previous=first, first=4), 6)
    return out + f.chunk("fOOT", f.foot(len(out) - last, 12_000_000), 7)


class TestChains:
    """
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    """

    def test_of_indexes(self):
        data = two_indexes()
        assert rule(data) == ("intact", None)
        catalogue = open_catalogue(BytesSource(data))
        assert catalogue.indexed
        types = ["HEAD", "TRAK", "DATA", "iNDX", "DATA", "iNDX", "fOOT"]
        assert [chunk.type for chunk in catalogue.chunks] == types
        assert len(samples(data, start=0)) == 8

    @pytest.mark.parametrize(("previous", "id_"), [(0, "IDX-002"), (8, "IDX-002")])
    def test_out_of_place(self, previous, id_):
        data = two_indexes(previous=previous)
        assert rule(data) == ("nonconforming", id_)
        assert not open_catalogue(BytesSource(data)).indexed

    @pytest.mark.parametrize("first", [0, 2, 4, 2**32 - 1])
    def test_counts_from_another(self, first):
        """
        IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
        """
        assert rule(two_indexes(first=first)) == ("nonconforming", "IDX-002")

    def test_a_chunk_between_two_is_left_out(self):
        """Its samples come by reading in order."""
        data = left_out()
        assert rule(data) == ("nonconforming", "IDX-002")
        assert not open_catalogue(BytesSource(data)).indexed

    def test_previous_is_no_index(self):
        third = 8 + f.HEADER + len(f.head()) + f.HEADER + len(f.TRACK_0[1])
        data = f.minimal(
            ahead={"entries": [("DATA", third, 0, 10**12)], "first": 2, "previous": third}
        )
        assert rule(data) == ("nonconforming", "IDX-002")


class TestListing:
    """
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    """

    ROWS = (("HEAD", 8, 0, 0), ("TRAK", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, 10**12))

    def test_true(self):
        assert rule(f.minimal(ahead={"entries": self.ROWS})) == ("intact", None)

    @pytest.mark.parametrize("row", range(3))
    def test_one_left_out(self, row):
        rows = self.ROWS[:row] + self.ROWS[row + 1 :]
        assert rule(f.minimal(ahead={"entries": rows})) == ("nonconforming", "IDX-002")

    @pytest.mark.parametrize(
        "row", [("HEAD", 9, 0, 0), ("TRAK", DATA_AT + 1, 0, 0), ("mETa", DATA_AT + 40, 0, 0)]
    )
    def test_one_too_many(self, row):
        rows = sorted([*self.ROWS, row], key=lambda r: r[1])
        assert rule(f.minimal(ahead={"entries": rows})) == ("nonconforming", "IDX-002")

    def test_times(self):
        for start, stop in [(1, 10**12), (0, 3)]:
            rows = (*self.ROWS[:2], ("DATA", DATA_AT, start, stop))
            assert rule(f.minimal(ahead={"entries": rows})) == ("nonconforming", "IDX-002")


class TestAHint:
    """
    IDX-003: A reader MUST check an entry against the header that it points to before it uses it. It reads the file in order where they differ, or where the sequence number of an index is not that after its last entry.
    """

    @pytest.mark.parametrize("back", range(1, 70, 5))
    def test_damaged_ends(self, back):
        data = bytearray(f.minimal())
        data[-back] ^= 0x10
        assert open_catalogue(BytesSource(bytes(data))).findings
        assert samples(bytes(data), start=0) == samples(f.minimal())

    @pytest.mark.parametrize("rows", [
        (("HEAD", 8, 0, 0), ("TRAK", TRACK_AT + 1, 0, 0), ("DATA", DATA_AT, 0, 10**12)),
        (("HEAD", 8, 0, 0), ("mETa", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, 10**12)),
        (("TRAK", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, 10**12)),
    ])  # fmt: skip
    def test_entries_that_lie(self, rows):
        assert samples(f.minimal(ahead={"entries": rows}), start=0) == samples(f.minimal())

    @pytest.mark.parametrize("at", [DATA_AT - 1, DATA_AT + 1, TRACK_AT])
    def test_a_data_entry_that_lies(self, at):
        rows = (("HEAD", 8, 0, 0), ("TRAK", TRACK_AT, 0, 0), ("DATA", at, 0, 10**12))
        rows = (
            tuple(sorted(set(rows), key=lambda r: r[1])) if at != TRACK_AT else (rows[0], rows[2])
        )
        assert samples(f.minimal(ahead={"entries": rows}), start=0) == samples(f.minimal())

    @pytest.mark.parametrize("closed", [True, False])
    def test_no_entry(self, closed):
        data = f.minimal(ahead={"entries": ()})
        data = data if closed else data[: -f.FOOT]
        assert not open_catalogue(BytesSource(data)).indexed
        assert samples(data, start=0) == samples(f.minimal())

    def test_a_description_left_out(self):
        rows = (("HEAD", 8, 0, 0), ("DATA", DATA_AT, 0, 10**12))
        assert samples(f.minimal(ahead={"entries": rows})) == samples(f.minimal())


class TestFooter:
    """
    FOT-002: `index_distance` MUST be as the table says. In a `fOOT` that closes the file `duration_ns` is the end of the latest packet of any track, rounded up, at most the largest i64; 0 without packets.
    """

    def test_true(self):
        assert rule(f.minimal()) == ("intact", None)

    @pytest.mark.parametrize(
        "changes",
        [{"index_distance": 0}, {"index_distance": 1}, {"index_distance": 2**32 - 1},
         {"duration_ns": 0}, {"duration_ns": f.DURATION_NS + 1}, {"duration_ns": 2**64 - 1}],
    )  # fmt: skip
    def test_false(self, changes):
        data = f.minimal(**changes)
        assert rule(data) == ("nonconforming", "FOT-002")
        assert samples(data, start=0) == samples(f.minimal())

    def test_of_another_length(self):
        """
        FOT-001: The payload MUST be as long as the layout.
        """
        body = f.file(HEAD, f.TRACK_0, f.DATA_0)
        for payload in (bytes(11), bytes(13)):
            assert rule(body + f.chunk("fOOT", payload, 3)) == ("nonconforming", "FOT-001")

    def test_without_an_index(self):
        """The file is read in order."""
        data = f.minimal(indexed=False, index_distance=0)
        assert rule(data) == ("intact", None)
        assert samples(data, start=0) == samples(f.minimal())
        assert not open_catalogue(BytesSource(data)).indexed
        assert rule(f.minimal(indexed=False, index_distance=1)) == ("nonconforming", "FOT-002")

    def test_chunks_behind_the_index(self):
        """A small file may have an index from before it grew: it is read in order."""
        body = f.file(HEAD, f.TRACK_0, f.DATA_0)
        rows = [("HEAD", 8, 0, 0), ("TRAK", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, 10**9)]
        data = body + f.chunk("iNDX", f.index(rows), 3)
        data += f.chunk("DATA", f.cluster((0, 4, 4, f.KNOT_DATA)), 4)
        data += f.chunk("fOOT", f.foot(len(data) - len(body), 8_000_000), 5)
        assert rule(data) == ("intact", None)
        assert len(samples(data, start=0)) == 8

    def test_closes_the_file(self):
        """
        FIL-003: A closed file MUST end with a `fOOT` chunk.
        VRD-001: A program that reads hapf files MUST end with the code of this clause. Programs that inspect, verify or recover files work on files with unknown critical parts as far as these are understood.
        """
        data = f.minimal()
        assert rule(data[: -f.FOOT]) == ("damaged", "FIL-003")
        assert samples(data[: -f.FOOT]) == samples(data)

    def test_the_last_counts(self):
        """Appended: a second footer after more packets."""
        first = f.minimal()
        out = first + f.chunk("DATA", f.cluster((0, 4, 4, f.KNOT_DATA)), 5)
        at = len(out)
        rows = [("HEAD", 8, 0, 0), ("TRAK", TRACK_AT, 0, 0), ("DATA", DATA_AT, 0, 10**9)]
        rows += [("iNDX", DATA_AT + f.HEADER + len(f.DATA_0[1]), 0, 0)]
        rows += [("fOOT", len(first) - f.FOOT, 0, 0), ("DATA", len(first), 0, 10**9)]
        out += f.chunk("iNDX", f.index(rows), 6)
        assert rule(out)[0] == "damaged"
        out += f.chunk("fOOT", f.foot(len(out) - at, 8_000_000), 7)
        assert rule(out) == ("intact", None)
        assert len(samples(out)) == 8


@pytest.fixture(scope="module")
def long_file() -> bytes:
    """12 MiB of clusters, a packet each."""
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    component, parameters = Component(), f.raw_parameters(4)
    writer.describe([Track(0, "full", "RAWB", Fraction(1000), 0, (component,), parameters)])
    for i in range(24):
        writer.cluster([Packet(0, i << 17, 1 << 17, b"\0" + bytes(1 << 19))])
    writer.close()
    return out.getvalue()


class TestWriter:
    """
    IDX-005: A writer MUST write an index before the chunks that no index lists, together with the next one, pass 4 MiB. It writes one before the `fOOT` of a file that passes 64 KiB or 16 chunks. A live writer also writes one every 10 seconds. Where nothing is new it writes none, except before `fOOT`.
    """

    def test_an_index_in_4_mib(self, long_file):
        catalogue = open_catalogue(BytesSource(long_file), scan=True)
        at = [chunk.offset for chunk in catalogue.chunks if chunk.type == "iNDX"]
        assert len(at) >= 3
        assert all(b - a <= 1 << 22 for a, b in zip([8, *at], at, strict=False))
        assert catalogue.chunks[-2].type == "iNDX"
        assert rule(long_file) == ("intact", None)

    @pytest.mark.parametrize(
        ("attached", "clusters", "indexed"),
        [(0, 1, False), (0, 13, False), (0, 14, True), (60_000, 1, False), (66_000, 1, True)],
    )
    def test_small_files_have_none(self, attached, clusters, indexed):
        """HEAD, TRAK and fOOT are chunks too."""
        out = io.BytesIO()
        writer = FileWriter(out, file_id=f.FILE_ID)
        parameters = f.raw_parameters(1)
        writer.describe([Track(0, "full", "RAWB", Fraction(1000), 0, (Component(),), parameters)])
        if attached:
            writer.attach(Attachment("a", "", bytes(attached)))
        for i in range(clusters):
            writer.cluster([Packet(0, i, 1, bytes(2))])
        writer.close()
        assert (f.SYNC + b"iNDX" in out.getvalue()) == indexed
        assert open_catalogue(BytesSource(out.getvalue())).indexed == indexed
        assert rule(out.getvalue()) == ("intact", None)

    def test_exactly_so_large(self):
        copy = f.HEADER + len(f.head())
        for size, indexed in [(1 << 16, False), ((1 << 16) + 1, True)]:
            out = io.BytesIO()
            writer = FileWriter(out, file_id=f.FILE_ID)
            writer.attach(
                Attachment("a", "", bytes(size - writer.offset - f.HEADER - 3 - copy - f.FOOT))
            )
            writer.close()
            assert (f.SYNC + b"iNDX" in out.getvalue()) == indexed
            assert indexed or len(out.getvalue()) == size

    def test_cut_anywhere(self, long_file):
        """What stands before the cut is read, closed or not."""
        whole = Reader(long_file).catalogue.data
        for cut in (len(long_file) // 2, len(long_file) - 1):
            found = Reader(long_file[:cut]).catalogue.data
            assert [ref.offset for ref in found] == [
                r.offset for r in whole if r.offset + f.HEADER <= cut
            ]


def live(clusters: int = 12, every: int = 3, attached: bytes = b"") -> bytes:
    """Clusters of 0.25 s at 44.1 Hz, an index after every third; not closed."""
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    parameters = f.raw_parameters(1)
    rate = Fraction(441, 10)
    ids = range(2)
    writer.describe(
        [
            Track(
                i,
                "full",
                "RAWB",
                rate,
                i,
                (Component(),),
                parameters,
                count_min=-128,
                count_max=127,
            )
            for i in ids
        ]
    )
    for c in range(clusters):
        writer.cluster(Packet(i, c * 11, 11, bytes([0] + [c % 100] * 11)) for i in ids)
        if c % every == every - 1:
            writer.index()
            if attached:
                writer.attach(Attachment("copy", "", attached))
    return out.getvalue()


LIVE = live()


class TestNotClosed:
    """
    FIL-003: A closed file MUST end with a `fOOT` chunk.
    """

    @pytest.mark.parametrize("cut", range(0, 500, 7))
    def test_as_if_walked(self, cut):
        """By the last index and what follows it, or by walking: the same, wherever it ends."""
        data = LIVE[: len(LIVE) - cut]
        found, walked = (open_catalogue(BytesSource(data), scan=scan) for scan in (False, True))
        assert found.indexed and not walked.indexed
        assert (found.duration, found.closed) == (walked.duration, False)
        assert found.findings == walked.findings != []
        assert [ref.offset for ref in found.data] == [ref.offset for ref in walked.data]
        assert found.exit_code == walked.exit_code
        for start, stop in [(0, 1), (Fraction(1, 2), 2), (1, 9)]:
            reader, scanned = Reader(data), Reader(data, scan=True)
            a, b = (r.read(start=start, stop=stop) for r in (reader, scanned))
            assert reader.lost == scanned.lost
            for x, y in zip(a.channels, b.channels, strict=True):
                assert (x.start_tick, x.gaps, x.stored.tolist()) == (
                    y.start_tick,
                    y.gaps,
                    y.stored.tolist(),
                )

    @pytest.mark.parametrize("back", range(1, 140, 3))
    def test_any_damage_is_walked(self, back):
        """What is damaged behind the index is found as by walking."""
        whole = live(14)
        assert whole.rfind(f.SYNC + b"iNDX") < len(whole) - 150
        data = bytearray(whole)
        data[-back] ^= 0x20
        found, walked = (open_catalogue(BytesSource(bytes(data)), scan=s) for s in (False, True))
        assert found.findings == walked.findings

    def test_little_is_read(self):
        """The end, the last index, the descriptions: not the hours before."""

        class Counting(BytesSource):
            read = 0

            def read_at(self, offset: int, size: int) -> bytes:
                self.read += min(size, self.size)
                return super().read_at(offset, size)

        source = Counting(live(4001, 100))
        catalogue = open_catalogue(source)
        assert catalogue.indexed and len(catalogue.data) == 4001
        assert Counting.read == 0 < source.read < source.size

    def test_an_index_within_an_attached_file(self):
        """It lists other chunks than stand before it."""
        inner = live(3)
        data = live(4, attached=inner)
        cut = data[: data.rfind(f.SYNC + b"DATA")]
        assert open_catalogue(BytesSource(data), scan=True).findings[0].code == "not-closed"
        for file in (data, cut):
            found, walked = (open_catalogue(BytesSource(file), scan=s) for s in (False, True))
            assert [r.offset for r in found.data] == [r.offset for r in walked.data]
            assert found.findings == walked.findings
            assert not found.indexed

    def test_looking_back_is_bounded(self):
        """However much looks like an index."""
        fake = f.chunk("iNDX", b"", 9, size=2**20)
        data = LIVE + fake * 30_000
        began = time.process_time()
        from hapfmt.reading.opening import last_index

        assert last_index(BytesSource(data), f.FILE_ID) is None
        assert time.process_time() - began < slowness()

    def test_a_false_end(self):
        """Of the last cluster an index lists: the end is read from its packets."""
        assert open_catalogue(BytesSource(live(3))).duration == Fraction(
            -(-33 * 10**10 // 441), 10**9
        )


class TestLazily:
    """
    IDX-003: A reader MUST check an entry against the header that it points to before it uses it. It reads the file in order where they differ, or where the sequence number of an index is not that after its last entry.
    """

    def closed(self) -> bytes:
        out = io.BytesIO()
        writer = FileWriter(out, file_id=f.FILE_ID)
        parameters = f.raw_parameters(1)
        writer.describe(
            [
                Track(
                    0,
                    "full",
                    "RAWB",
                    Fraction(10),
                    0,
                    (Component(),),
                    parameters,
                    count_min=-128,
                    count_max=127,
                )
            ]
        )
        for c in range(1000):
            writer.cluster([Packet(0, c * 10, 10, bytes(11))])
        writer.attach(Attachment("a", "", b"content"))
        writer.close()
        return out.getvalue()

    def test_no_header_of_a_cluster_is_read(self):
        data = self.closed()
        seen = []

        class Seeing(BytesSource):
            def read_at(self, offset: int, size: int) -> bytes:
                seen.append(offset)
                return super().read_at(offset, size)

        catalogue = open_catalogue(Seeing(data))
        assert catalogue.indexed and len(catalogue.data) == 1000
        assert len(seen) < 20 and not set(seen) & {ref.offset for ref in catalogue.data}

    def test_attachments(self):
        """One that is not where it is listed is looked for; one that is damaged is told."""
        data = self.closed()
        at = data.rfind(f.SYNC + b"aTTc")
        assert Reader(data).attachments["a"].content == b"content"
        bad = bytearray(data)
        bad[at + 40] ^= 1
        with Reader(bytes(bad)) as reader:
            assert reader.catalogue.indexed and reader.attachments == {}
            assert [finding.code for finding in reader.findings] == ["bad-payload"]
        bad = bytearray(data)
        bad[at + 20] ^= 1
        with Reader(bytes(bad)) as reader:
            assert reader.attachments == {} and not reader.catalogue.indexed
            assert [finding.code for finding in reader.findings][:1] == ["garbage"]
