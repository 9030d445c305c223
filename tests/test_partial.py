"""Clause 6.4: of a large cluster the table and the packets that are wanted; the same samples as
from the whole, and no loss that goes unseen."""

from __future__ import annotations

import contextlib
import io
from fractions import Fraction

import forge as f
import numpy as np
import pytest
import strategies
from depth import either
from hypothesis import assume, given
from hypothesis import strategies as st
from judge import samples
from spec import ROOT
from test_walk import damaged

import hapfmt
from hapfmt.codecs.events import CodedEvent, build_events
from hapfmt.errors import FormatError, HapfmtError
from hapfmt.format.cluster import Packet, parse_rows, parse_table_head
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Component, Track
from hapfmt.reading import packets
from hapfmt.reading.opening import open_catalogue
from hapfmt.reading.reader import Reader
from hapfmt.writing.filewriter import FileWriter


@pytest.fixture(scope="module", autouse=True)
def in_part():
    """However small the cluster and large the share."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packets, "SHARE", 0)
        patch.setattr(BytesSource, "gap", 0)
        yield


WHOLE = 1 << 30
"""As SHARE: every payload is read whole."""

LABELS = ["even", "gap", "late", "slow", "twice"]
PLAN = [
    # cluster of a second at 10 Hz: (track, start, span)
    [(0, 0, 10), (1, 0, 10), (3, 0, 30), (4, 0, 4), (4, 4, 6)],
    [(0, 10, 10), (1, 10, 4), (1, 16, 4), (4, 10, 4), (4, 14, 6)],
    [(0, 20, 10), (1, 20, 10), (2, 23, 7), (4, 20, 4), (4, 24, 5)],
    [(0, 30, 10), (2, 30, 10), (3, 30, 10), (4, 30, 4), (4, 34, 6)],
]
"""Tracks without a gap, with one in a cluster and one of a cluster, that begin late, whose packets
are longer than the clusters, and of two packets a cluster with a gap between clusters."""


def number(track: int, tick: int) -> int:
    return (50 * track + tick) % 200 - 100


def written(plan=PLAN) -> bytes:
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    writer.describe([
        Track(i, "full", "RAWB", Fraction(10), i, (Component(label=label),), f.raw_parameters(1),
              count_min=-128, count_max=127)
        for i, label in enumerate(LABELS)
    ])  # fmt: skip
    for rows in plan:
        writer.cluster(
            Packet(t, start, span, b"\0" + bytes(number(t, start + i) % 256 for i in range(span)))
            for t, start, span in rows
        )
    writer.close()
    return out.getvalue()


DATA = written()
CLEAN = {
    (t, tick): number(t, tick)
    for rows in PLAN
    for t, start, span in rows
    for tick in range(start, start + span)
}
RANGES = [(0, 4), (0, 1), (1, 2), (1, 3), (Fraction(3, 2), Fraction(5, 2)), (3, 9), (0, None)]


def part_of(channel: int, start: Fraction | int, stop: Fraction | int | None) -> dict:
    return {
        (t, tick): value
        for (t, tick), value in CLEAN.items()
        if t == channel and tick >= 10 * start and (stop is None or tick < 10 * stop)
    }


class Counting(BytesSource):
    """Knows which bytes were read."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.seen: list[tuple[int, int]] = []

    def read_at(self, offset: int, size: int) -> bytes:
        self.seen.append((offset, size))
        return super().read_at(offset, size)


@pytest.mark.parametrize("channel", range(5))
@pytest.mark.parametrize(("start", "stop"), RANGES)
def test_the_same_samples(channel, start, stop):
    assert samples(DATA, channels=channel, start=start, stop=stop) == part_of(channel, start, stop)


def test_other_packets_are_not_read():
    reader = Reader(DATA)
    source = Counting(DATA)
    reader.source = reader.catalogue.source = source
    reader.read("even", 1, 2)
    first = reader.catalogue.data[1].offset
    stop = reader.catalogue.data[2].offset
    packet = stop - 11 - 5 - 5 - 5 - 7
    assert [(at, size) for at, size in source.seen if first <= at < stop][-1] == (packet, 11)


def test_a_gap_costs_no_more():
    """The CRC of the table tells that there is no other row: no packet of another track is read."""
    reader = Reader(DATA)
    source = Counting(DATA)
    reader.source = reader.catalogue.source = source
    reader.read("gap", 0, 2)
    sizes = [sum(1 + span for _, _, span in rows) for rows in PLAN[:2]]
    stops = [ref.offset for ref in reader.catalogue.data[1:3]]
    wanted = [11, 10]
    read = [
        size
        for at, size in source.seen
        if any(
            stop - packets_size <= at < stop
            for stop, packets_size in zip(stops, sizes, strict=True)
        )
    ]
    assert read == wanted


def hidden(cluster: int, row: int) -> bytes:
    """A row's track changed in a way that leaves the table in order."""
    reader = Reader(DATA)
    at = reader.catalogue.data[cluster].offset + f.HEADER
    head = parse_table_head(DATA[at:], reader.catalogue.level, at)
    found = list(parse_rows(DATA[at:], head))[row]
    assert (found.track, found.start, found.span) == PLAN[cluster][row]
    bad = bytearray(DATA)
    bad[at + found.offset] += 1
    return bytes(bad)


@pytest.mark.parametrize(
    ("cluster", "row", "channel"), [(2, 1, "gap"), (3, 1, "late"), (0, 2, "slow")]
)
def test_a_row_that_hides_is_reported(cluster, row, channel):
    """
    REC-003: A reader that goes on after damage MUST report every stretch of bytes that was lost, and every span that `lost` names.
    """
    bad = hidden(cluster, row)
    with Reader(bad) as reader:
        found = reader.read(channel, 0, 4)
        (ref,) = reader.select(channel)
        have = {
            start + i for start, values in found.channels[0].segments() for i in range(len(values))
        }
        wanted = {tick for (t, tick) in CLEAN if t == ref.number}
        assert reader.findings
        for tick in wanted - have:
            assert any(
                span.track == ref.track.id
                and span.start <= tick
                and (span.stop is None or tick < span.stop)
                for span in reader.lost
            )


def outcome(data: bytes, channel: int, start, stop) -> tuple[dict | None, set[int]]:
    """The samples, and the ticks that are reported as lost."""
    try:
        with Reader(data) as reader:
            found = reader.read(channel, start, stop)
            (ref,) = reader.select(channel)
            have = {
                (channel, first + i): int(value)
                for first, values in found.channels[0].segments()
                for i, value in enumerate(values)
            }
            lost = {
                tick
                for span in reader.lost
                if span.track == ref.track.id
                for tick in range(span.start, 50 if span.stop is None else span.stop)
            }
            return have, lost
    except HapfmtError:
        return None, set()


@pytest.mark.parametrize("channel", range(5))
@either("every", 11, deep=1)
def test_every_flip_in_the_clusters(channel, every, monkeypatch):
    """The same samples as from whole payloads; what is missing is reported."""
    refs = Reader(DATA).catalogue.data
    places = range(refs[0].offset + channel, refs[-1].offset + f.HEADER + 90, every)
    for at in places:
        bad = bytearray(DATA)
        bad[at] ^= 1 << at % 8
        for start, stop in [(0, 4), (1, 3)]:
            have, lost = outcome(bytes(bad), channel, start, stop)
            with monkeypatch.context() as patch:
                patch.setattr(packets, "SHARE", WHOLE)
                assert outcome(bytes(bad), channel, start, stop)[0] == have
            clean = part_of(channel, start, stop)
            assert have is not None and have.items() <= clean.items()
            assert {tick for _, tick in clean.keys() - have.keys()} <= lost


@strategies.idle_settings
@given(
    strategies.recordings(), strategies.encoder_settings(),
    st.sampled_from(["full", "lf", "hf"]), st.data(),
)  # fmt: skip
def test_any_part_of_any_file(recording, settings, band, data):
    """Reading [a, b) is slicing the whole, on intact and on damaged files."""
    out = io.BytesIO()
    hapfmt.write(recording, out, settings, canonical=f.FILE_ID)
    file = out.getvalue()
    assume(len(recording))
    channel = data.draw(st.integers(0, len(recording) - 1))
    ends = st.integers(0, int(1000 * recording.duration) + 2)
    start, stop = sorted(Fraction(data.draw(ends), 1000) for _ in range(2))
    assume(start < stop)
    asked = {"channels": channel, "start": start, "stop": stop, "band": band}
    rate = recording.channels[channel].rate_exact
    whole = samples(file, channels=channel, band=band)
    clean = {key: value for key, value in whole.items() if start * rate <= key[1] < stop * rate}
    bad = data.draw(damaged(file))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packets, "SHARE", WHOLE)
        full = samples(bad, **asked)
    assert samples(file, **asked) == clean
    part = samples(bad, **asked)
    assert (part or {}).items() <= clean.items()
    assert part == full or full is None


class TestRules:
    """Where a rule does not hold the payload is read whole, and what is wrong is raised."""

    @pytest.mark.parametrize(
        ("rows", "rule"),
        [([(0, 10, 10), (9, 10, 10)], "DAT-008"), ([(0, 10, 10), (1, 10, 2**24 + 1)], "DAT-003")],
    )
    def test_are_those_of_the_whole(self, rows, rule):
        data = f.closed(
            ("HEAD", f.head()),
            ("TRAK", f.trak(track_count=3)),
            ("DATA", f.cluster((0, 0, 10, f.KNOT_DATA))),
            ("DATA", f.cluster(*((*row, f.KNOT_DATA) for row in rows))),
        )
        with pytest.raises(FormatError) as error:
            Reader(data).read(0, start=0)
        assert error.value.requirement == rule


class TestFalseIndexes:
    """
    IDX-003: A reader MUST check an entry against the header that it points to before it uses it. It reads the file in order where they differ, or where the sequence number of an index is not that after its last entry.
    """

    CHUNKS = (
        ("HEAD", f.head()),
        ("TRAK", f.trak(track_count=2)),
        ("DATA", f.cluster((0, 0, 4, f.KNOT_DATA), (1, 0, 4, f.KNOT_DATA))),
        ("DATA", f.cluster((0, 4, 4, f.KNOT_DATA), (1, 4, 4, f.KNOT_DATA))),
    )

    def rows(self) -> list[tuple[str, int, int, int]]:
        at = 8
        rows = []
        for type_, payload, *_ in self.CHUNKS:
            rows.append((type_, at, 0, f.LATE_MS if type_ == "DATA" else 0))
            at += f.HEADER + len(payload)
        return rows

    def file(self, rows) -> bytes:
        return f.closed(*self.CHUNKS, ahead={"entries": rows}, duration_ns=8_000_000)

    def test_true(self):
        assert len(samples(self.file(self.rows()), channels=0, start=0)) == 8

    @pytest.mark.parametrize("shift", [1, 31, 33])
    def test_found_late(self, shift):
        """After packets were delivered: the others follow, each once."""
        rows = self.rows()
        rows[-1] = ("DATA", rows[-1][1] + shift, *rows[-1][2:])
        data = self.file(rows)
        reader = Reader(data)
        assert reader.catalogue.indexed
        got = list(reader.packets({0: (0, 8)}, start=0))
        assert [(p.start, p.span) for p in got] == [(0, 4), (4, 4)]
        assert not reader.catalogue.indexed
        assert samples(data, start=0) == samples(self.file(self.rows()))

    def test_one_left_out_before(self):
        """What the packets delivered so far do not follow from is refused."""
        rows = self.rows()
        rows[-1] = ("DATA", rows[-1][1] + 1, *rows[-1][2:])
        reader = Reader(self.file(rows))
        reader.catalogue.chunks[2] = reader.catalogue.chunks[2]._replace(start_ns=0, stop_ns=0)
        got = reader.packets({0: (0, 8)}, start=0)
        assert [(p.start, p.span) for p in got] == [(0, 4), (4, 4)]

    @pytest.mark.parametrize("closed", [True, False])
    @pytest.mark.parametrize("kind", ["DATA", "TRAK", "aTTc", "mETa", "HEAD", "XXXX", "xxxx"])
    def test_nested_chunks(self, kind, closed):
        """Chunks within chunks, each of which promises all that follows: nothing is read again and
        again, whatever an index says."""
        count = 5000
        inner = b"".join(f.chunk(kind, b"", 9, size=f.HEADER * (count - i)) for i in range(count))
        before = [("HEAD", f.head()), f.TRACK_0]
        body = f.file(*before, ("aTTc", f.strings("a", "") + inner))
        first = len(body) - len(inner)
        rows = [("HEAD", 8, 0, 0), ("TRAK", 8 + f.HEADER + len(f.head()), 0, 0)]
        rows += [(kind, first + f.HEADER * i, 0, 9 * (kind == "DATA")) for i in range(count)]
        data = body + f.chunk("iNDX", f.index(rows), 10)
        if closed:
            data += f.chunk("fOOT", f.foot(len(data) - len(body)), 11)
        source = Counting(data)
        catalogue = open_catalogue(source)
        with Reader(data) as reader:
            reader.source = reader.catalogue.source = source
            with contextlib.suppress(HapfmtError):
                reader.read(0, start=0, stop=1)
            with contextlib.suppress(HapfmtError):
                assert set(reader.attachments) <= {"a"}
        assert catalogue.head
        assert sum(min(size, len(data)) for _, size in source.seen) < 12 * len(data)
        assert len(source.seen) < 2000


def test_events_beside_samples():
    """A layer has gaps everywhere, and its events are there."""
    rows = [(0, 0, 10), (0, 10, 10), (0, 20, 10)]
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    layer = Track(2, "events", "EVNT", Fraction(10), 0, (Component(label="notes"),), b"")
    writer.describe([
        *(Track(i, "full", "RAWB", Fraction(10), i, (Component(),), f.raw_parameters(1),
                count_min=-128, count_max=127) for i in range(2)),
        layer,
    ])  # fmt: skip
    for c, (_, start, span) in enumerate(rows):
        body = [Packet(i, start, span, bytes([0, *range(span)])) for i in range(2)]
        if c == 1:
            body.append(Packet(2, 12, 1, build_events([CodedEvent(12, 0, 0, "touch")], 12)))
        writer.cluster(body)
    writer.index()
    writer.close()
    reader = Reader(out.getvalue())
    assert reader.catalogue.indexed
    found = reader.read(0, 0, 3)
    assert [event.text for event in found.events] == ["touch"]
    assert found.channels[0].gaps == () and len(found.channels[0].stored) == 30
    assert [event.text for event in reader.events(1, 2)] == ["touch"]


@pytest.mark.parametrize("name", ["uncommon/last-tick", "limits/tick-2-to-48-of-years"])
def test_times_beyond_those_of_an_index(name):
    """
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    """
    path = ROOT / "conformance" / "vectors" / f"{name}.hapf"
    whole = hapfmt.read(path)
    with hapfmt.Reader(path) as reader:
        for number, channel in enumerate(whole):
            start = channel.start_tick / channel.rate_exact
            found = reader.read(number, start=start, stop=channel.duration)[0]
            assert found.coverage == channel.coverage
            assert np.array_equal(found.stored, channel.stored)
