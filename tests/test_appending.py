"""Files gone on with: closed, not closed, cut at any byte (SPEC clause 15)."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import forge as f
import numpy as np
import pytest
from depth import either
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

import hapfmt
from hapfmt.encoder.settings import Settings
from hapfmt.errors import FormatError, HapfmtError, ParameterError, UnsupportedError
from hapfmt.format.cluster import Packet
from hapfmt.format.extras import Attachment
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Component, Track
from hapfmt.format.walk import Chunk, walk
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.limits import LEVELS
from hapfmt.reading.opening import open_catalogue
from hapfmt.writing.file import SyncPolicy, create_live
from hapfmt.writing.filewriter import FileWriter
from hapfmt.writing.start import open_append, track_ends

KNOT = f.knot_parameters()
FIVE = f.KNOT_DATA
NEVER = SyncPolicy("never")


def track(number: int, channel: int) -> Track:
    return Track(number, "full", "KNOT", Fraction(1000), channel, (Component(label=f"c{channel}"),),
                 KNOT, count_min=-100, count_max=100)  # fmt: skip


def value(count: int) -> bytes:
    return f.svarint(count)


def chunks(data: bytes) -> list[Chunk]:
    findings: list[object] = []
    found = list(walk(BytesSource(data), findings))
    assert findings == []
    return found


def types(data: bytes) -> list[str]:
    return [chunk.header.type for chunk in chunks(data)]


def intact(path: Path) -> None:
    report = hapfmt.verify(path)
    assert (report.verdict, report.error, report.findings, report.lost) == ("intact", None, [], [])
    with hapfmt.Reader(path) as reader:
        # Small files have no index.
        assert reader.catalogue.indexed == (b"iNDX" in path.read_bytes())


def recording(path: Path, clusters: int = 3, *, close: bool = True) -> None:
    with create_live(path) as file:
        writer = FileWriter(file, file_id=5)
        writer.describe([track(0, 0), track(1, 1)])
        for number in range(clusters):
            writer.cluster(Packet(i, 100 * number, 100, value(number + i)) for i in (0, 1))
        if close:
            writer.close()


class TestClosedFiles:
    """
    WRT-006: A writer that appends MUST change no byte before the end of the last whole chunk. It continues there with the file id, the next sequence number, and the level of the file. It refuses a file in which it finds damage before that end, or an unknown critical chunk. It need not read payloads that an index lists. Before it appends, it cuts off what follows the last whole chunk. It writes the packets of a cut `DATA` chunk whose CRC matches in a new `DATA` chunk, and reports the losses.
    """

    @pytest.mark.parametrize("close", [True, False])
    def test_go_on(self, tmp_path: Path, close: bool):
        path = tmp_path / "a"
        recording(path, close=close)
        before = path.read_bytes()
        with open_append(path) as more:
            assert (more.findings, more.note) == ([], None)
            assert more.ends() == {0: 300, 1: 300}
            more.writer.cluster([Packet(0, 310, 5, value(9))])
            more.writer.describe([track(2, 2)])
            more.writer.cluster([Packet(2, 0, 7, value(8)), Packet(1, 300, 1, value(7))])
            more.writer.metadata({"a": 1})
            more.writer.attach(Attachment("n", "", b"x"))
        data = path.read_bytes()
        assert data.startswith(before)
        intact(path)
        read = hapfmt.read(path)
        assert [len(channel.stored) for channel in read.channels] == [305, 301, 7]
        assert read.channels[0].coverage == (hapfmt.Span(0, 300), hapfmt.Span(310, 315))
        assert (read.metadata, read.attachments) == ({"a": 1}, {"n": ("", b"x")})
        assert {chunk.header.file_id for chunk in chunks(data)} == {5}

    def test_a_channel_goes_on_in_another_track(self, tmp_path: Path):
        path = tmp_path / "a"
        recording(path)
        with open_append(path) as more:
            more.writer.describe([replace(track(2, 1), count_min=-8, continues=1)])
            more.writer.cluster([Packet(2, 301, 2, value(-7))])
        intact(path)
        read = hapfmt.read(path)
        assert [len(channel.stored) for channel in read.channels] == [300, 302]
        assert read.channels[1].stored[-3:].tolist() == [3, -7, -7]

    def test_nothing_is_written_where_nothing_comes(self, tmp_path: Path):
        path = tmp_path / "a"
        recording(path)
        before = path.read_bytes()
        with open_append(path):
            pass
        assert path.read_bytes() == before

    def test_the_level_stays(self, tmp_path: Path):
        path = tmp_path / "a"
        recording(path)
        with open_append(path) as more, pytest.raises(ParameterError, match="limit of level 1"):
            more.writer.attach(Attachment("n", "", bytes(1 << 20)))
        intact(path)

    def test_ids_come_from_the_file_and_so_does_every_byte_of_its_head(self, tmp_path: Path):
        """An unknown ancillary TLV, a later minor version."""
        path = tmp_path / "a"
        head = f.head(f.tlv(8, b"x"), minor=9)
        body = b"\0" + bytes(1000)
        path.write_bytes(f.closed(("HEAD", head), f.TRACK_0, f.DATA_0, ("zzzz", body * 9)))
        with open_append(path) as more:
            more.writer.cluster([Packet(0, 4, 1, FIVE)])
        intact(path)
        heads = [c.payload for c in chunks(path.read_bytes()) if c.header.type == "HEAD"]
        assert heads == [head, head]

    @pytest.mark.parametrize("preset", ["lossless", "near-lossless", "perceptual", "paper"])
    def test_of_any_preset(self, tmp_path: Path, preset: str):
        path = tmp_path / "a"
        hapfmt.write(
            simulate("sand", 2.0), path, Settings(preset=preset, cluster=Fraction(1), digest=True)
        )
        before, digests = hapfmt.read(path), hapfmt.verify(path).digests
        with open_append(path) as more:
            number = max(more.writer.tracks) + 1
            more.writer.attach(Attachment("notes.txt", "text/plain", b"hello"))
            more.writer.describe([track(number, len(before.channels))])
            more.writer.cluster([Packet(number, 0, 3, FIVE)])
        intact(path)
        assert hapfmt.verify(path).digests == digests > 0
        after = hapfmt.read(path)
        for old, new in zip(before.channels, after.channels, strict=False):
            assert (old.stored == new.stored).all() and old.label == new.label
        assert after.channels[-1].stored.tolist() == [5, 5, 5]
        assert after.attachments["notes.txt"] == ("text/plain", b"hello")

    def test_a_digest_stays_true_of_the_packets_before_it(self, tmp_path: Path):
        path = tmp_path / "a"
        hapfmt.write(simulate("sand", 2.0), path, Settings(digest=True))
        with open_append(path) as more:
            id_, end = next(iter(more.ends().items()))
            old = hapfmt.Reader(path)
            with old:
                again = list(old.packets({id_: (0, 1 << 48)}))
            more.writer.cluster([Packet(id_, end + p.start, p.span, p.data) for p in again])
        intact(path)
        assert hapfmt.verify(path).digests >= 1
        x = hapfmt.read(path).channels[0].stored
        assert (x[: len(x) // 2] == x[len(x) // 2 :]).all()


class TestAgainAndAgain:
    def test_descriptions_are_repeated_once(self, tmp_path: Path):
        path = tmp_path / "a"
        with create_live(path) as file:
            writer = FileWriter(file)
            writer.describe([track(0, 0)])
            writer.attach(Attachment("x", "", bytes(20_000)))
            writer.close()
        for number in range(5):
            with open_append(path) as more:
                if number == 2:
                    more.writer.describe([track(1, 1)])
                more.writer.metadata({str(number): 0})
        intact(path)
        found = types(path.read_bytes())
        assert (found.count("HEAD"), found.count("TRAK")) == (2, 4)

    @either("times", 40, deep=150)
    def test_little_is_added_by_little(self, tmp_path: Path, times: int):
        path = tmp_path / "a"
        recording(path, 50 + 3 * times)
        sizes, links = [], []
        for number in range(times):
            before = path.stat().st_size
            with open_append(path, sync=NEVER) as more:
                links.append(len(more.writer.parts))
                more.writer.metadata({"n": number})
            sizes.append(path.stat().st_size - before)
        intact(path)
        assert max(links) <= 10
        assert sum(sizes) / len(sizes) < 300
        with open_append(path) as more:
            for number in range(4 * times):
                more.writer.cluster([Packet(0, 100_000 + number, 1, FIVE)])
        intact(path)
        with open_append(path) as more:
            assert len(more.writer.parts) == 1

    def test_an_index_that_does_not_fit_lists_what_does(self, tmp_path: Path):
        path = tmp_path / "a"
        small = replace(LEVELS[1], payload_size=1000)
        with create_live(path) as file:
            writer = FileWriter(file)
            writer.level = small
            for _ in range(10):
                for _ in range(50):
                    writer.chunk("zzzz", b"")
                writer.checkpoint()
            writer.close()
            assert len(writer.parts) == 8
            assert [c for c in chunks(path.read_bytes()) if len(c.payload) > 1000] == []
        intact(path)
        with open_append(path) as more:
            more.writer.level = small
            assert len(more.writer.parts) == 8
            more.writer.metadata({})
        intact(path)


def test_a_live_writer_lists_every_ten_seconds(tmp_path: Path):
    """IDX-005: A writer MUST write an index before the chunks that no index lists, together with the next one, pass 4 MiB. It writes one before the `fOOT` of a file that passes 64 KiB or 16 chunks. A live writer also writes one every 10 seconds. Where nothing is new it writes none, except before `fOOT`."""
    now = [100.0]
    path = tmp_path / "a"
    with create_live(path) as file:
        writer = FileWriter(file, clock=lambda: now[0])
        writer.describe([track(0, 0)])
        for number in range(40):
            now[0] += 0.75
            writer.cluster([Packet(0, number, 1, FIVE)])
        writer.checkpoint()
        size = file.size
        writer.checkpoint()
        assert file.size == size
    found = types(path.read_bytes())
    places = [i for i, type_ in enumerate(found) if type_ == "iNDX"]
    assert [b - a for a, b in zip(places, places[1:], strict=False)] == [15, 14][: len(places) - 1]
    with open_append(path, clock=lambda: now[0]) as more:
        now[0] += 9
        more.writer.cluster([Packet(0, 50, 1, FIVE)])
        now[0] += 1
        more.writer.cluster([Packet(0, 51, 1, FIVE)])
        now[0] += 1
        more.writer.cluster([Packet(0, 52, 1, FIVE)])
    assert types(path.read_bytes())[len(found) :] == [
        "DATA",
        "iNDX",
        "DATA",
        "DATA",
        "iNDX",
        "fOOT",
    ]
    intact(path)


def small_file() -> bytes:
    """A small closed file: clusters, metadata, an attachment, tracks that come late."""
    stream = io.BytesIO()
    writer = FileWriter(stream, file_id=3)
    low = Track(0, "lf", "KNOT", Fraction(1000), 0, (Component(),), KNOT, count_max=99)
    high = Track(1, "hf", "KNOT", Fraction(1000), 0, (Component(),), KNOT, count_max=99, base=0)
    writer.describe([low, high, track(2, 1)])
    writer.metadata({"notes": ["made by hand"]})
    for number in range(3):
        writer.cluster(Packet(i, 100 * number, 100, value(1 + i) + b"\1\0\1\2") for i in (0, 1, 2))
    writer.attach(Attachment("a", "", b"content"))
    writer.describe([Track(3, "lf", "KNOT", Fraction(10), 2, (Component(),), KNOT, count_max=99),
                     Track(4, "hf", "KNOT", Fraction(10), 2, (Component(),), KNOT, base=3)])  # fmt: skip
    writer.checkpoint()
    writer.cluster([Packet(2, 300, 5, FIVE), Packet(3, 0, 5, FIVE), Packet(4, 0, 5, b"\0")])
    writer.close()
    return stream.getvalue()


WHOLE = small_file()
HEAD_END = chunks(WHOLE)[0].stop


def packets_of(data: bytes) -> set[tuple[int, int, int]]:
    """(track, start, stop) of what a reader delivers."""
    with hapfmt.Reader(data) as reader:
        ranges = dict.fromkeys(reader.catalogue.tracks, (0, 1 << 48))
        return {(p.track, p.start, p.stop) for p in reader.packets(ranges)}


def go_on(path: Path) -> list[str] | None:
    """Open, append, close; the codes of what was mended, None where it was refused."""
    try:
        with open_append(path, sync=NEVER) as more:
            more.writer.metadata({"later": True})
            number = max(more.writer.tracks, default=-1) + 1
            channels = [
                c for t in more.writer.tracks.values() if t.kind != "hf" for c in t.channels
            ]
            more.writer.describe([track(number, len(channels))])
            more.writer.cluster([Packet(number, 0, 2, FIVE)])
            return [found.code for found in more.findings]
    except HapfmtError as error:
        assert error.path == str(path)
        return None


class TestCutFiles:
    """
    WRT-006: A writer that appends MUST change no byte before the end of the last whole chunk. It continues there with the file id, the next sequence number, and the level of the file. It refuses a file in which it finds damage before that end, or an unknown critical chunk. It need not read payloads that an index lists. Before it appends, it cuts off what follows the last whole chunk. It writes the packets of a cut `DATA` chunk whose CRC matches in a new `DATA` chunk, and reports the losses.
    """

    @either("every", 11, deep=3, nightly=1)
    def test_at_every_byte(self, tmp_path: Path, every: int):
        path = tmp_path / "a"
        ends = {chunk.stop for chunk in chunks(WHOLE)}
        tracks = [c.offset for c in chunks(WHOLE) if c.header.type == "TRAK"]
        for cut in sorted(
            {*range(0, len(WHOLE), every), HEAD_END - 1, HEAD_END, *ends} - {len(WHOLE)}
        ):
            path.write_bytes(WHOLE[:cut])
            before = packets_of(WHOLE[:cut]) if cut >= HEAD_END else set()
            codes = go_on(path)
            assert (codes is None) == (cut < HEAD_END)
            if codes is None:
                assert path.read_bytes() == WHOLE[:cut]
                continue
            intact(path)
            assert (codes == []) <= (cut in ends)
            assert (cut in ends and cut not in tracks) <= (codes == [])
            data = path.read_bytes()
            kept = max(end for end in ends | {HEAD_END} if end <= cut)
            assert before <= packets_of(data)
            assert "later" in hapfmt.read(path).metadata
            if codes == []:
                assert data.startswith(WHOLE[:kept])

    @given(st.data())
    def test_with_something_behind(self, tmp_path_factory, data):
        path = tmp_path_factory.mktemp("behind") / "a"
        cut = data.draw(st.integers(HEAD_END, len(WHOLE)))
        more = data.draw(
            st.builds(bytes, st.integers(1, 9000)) | st.binary(min_size=1, max_size=200)
        )
        start = WHOLE[:cut]
        path.write_bytes(start + more)
        before = packets_of(start)
        assert go_on(path) is not None
        intact(path)
        assert before <= packets_of(path.read_bytes())

    @given(st.integers(HEAD_END, len(WHOLE) - 1), st.integers(1, 400))
    def test_with_zeros_in_its_place(self, tmp_path_factory, start, size):
        """File systems give a file its length first, and its bytes later."""
        path = tmp_path_factory.mktemp("zeros") / "a"
        path.write_bytes(WHOLE[:start] + bytes(min(size, len(WHOLE) - start)))
        assert go_on(path) is not None
        intact(path)
        assert packets_of(WHOLE[:start]) <= packets_of(path.read_bytes())

    def test_packets_are_kept_and_people_told(self, tmp_path: Path):
        path = tmp_path / "a"
        third = [c for c in chunks(WHOLE) if c.header.type == "DATA"][2]
        path.write_bytes(WHOLE[: third.stop - 1])
        with open_append(path) as more:
            assert [found.code for found in more.findings] == ["truncated"]
            assert more.findings[0].offset == third.offset
            assert more.ends() == {0: 300, 1: 300, 2: 200}
            size = third.stop - 1 - third.offset
            note = (
                f"appending: {size} bytes at {third.offset} were cut off, from a cluster, "
                "and 2 of its packets written again; lost: c1 from 0.2 s to 0.3 s"
            )
            assert more.note == note
            assert more.catalogue.metadata["notes"] == ["made by hand", note]
        intact(path)
        assert hapfmt.read(path).metadata["notes"] == ["made by hand", note]
        assert packets_of(path.read_bytes()) == {
            (t, 100 * n, 100 * n + 100) for t in (0, 1, 2) for n in range(3)
        } - {(2, 200, 300)}  # fmt: skip

    def test_notes_of_another_kind_are_left_alone(self, tmp_path: Path):
        path = tmp_path / "a"
        data = f.file(("HEAD", f.head()), ("mETa", json.dumps({"notes": "mine"}).encode()))
        path.write_bytes(data + b"\xf9rubbish")
        with open_append(path) as more:
            assert more.note is not None and "no whole chunk" in more.note
        assert hapfmt.read(path).metadata == {"notes": "mine"}

    @pytest.mark.parametrize(
        ("type_", "told"), [("aTTc", True), ("TRAK", False), ("iNDX", False), ("fOOT", False)]
    )
    def test_what_people_are_told(self, tmp_path: Path, type_: str, told: bool):
        path = tmp_path / "a"
        chunk = [c for c in chunks(WHOLE) if c.header.type == type_][-1]
        path.write_bytes(WHOLE[: chunk.stop - 1])
        with open_append(path) as more:
            assert (more.note is not None) == told
            assert not told or "from a chunk aTTc" in str(more.note)
            assert [found.code for found in more.findings][-1:] == ["truncated"]

    def test_a_last_chunk_that_does_not_hold(self, tmp_path: Path):
        path = tmp_path / "a"
        third = [c for c in chunks(WHOLE) if c.header.type == "DATA"][2]
        data = bytearray(WHOLE[: third.stop])
        data[-1] ^= 1
        path.write_bytes(data)
        assert go_on(path) == ["bad-payload"]
        intact(path)
        assert {(0, 200, 300), (1, 200, 300)} <= packets_of(path.read_bytes())

    def test_nothing_is_mended_where_it_must_not(self, tmp_path: Path):
        path = tmp_path / "a"
        path.write_bytes(WHOLE[:-1])
        with pytest.raises(ParameterError, match="cannot be mended"):
            open_append(path, repair=False)
        assert path.read_bytes() == WHOLE[:-1]
        path.write_bytes(WHOLE)
        with open_append(path, repair=False) as more:
            more.writer.metadata({})
        intact(path)

    def test_mending_needs_no_room(self, tmp_path: Path):
        from test_live_file import size_limit

        path = tmp_path / "a"
        third = [c for c in chunks(WHOLE) if c.header.type == "DATA"][2]
        path.write_bytes(WHOLE[: third.stop - 1])
        with size_limit(third.stop - 1), pytest.raises(OSError), open_append(path):
            pytest.fail("the note has no room")
        assert {(0, 200, 300), (1, 200, 300)} <= packets_of(path.read_bytes())
        assert hapfmt.verify(path).error is None

    def test_an_old_index_that_lies_is_not_gone_on_with(self, tmp_path: Path):
        """Rules broken without damage are found by verify; the chain starts anew."""
        path = tmp_path / "a"
        data = f.file(("HEAD", f.head()), f.TRACK_0, f.DATA_0, ("iNDX", f.index([])))
        path.write_bytes(data)
        with open_append(path) as more:
            assert more.writer.parts == []
            more.writer.metadata({})
        index = [c for c in chunks(path.read_bytes()) if c.header.type == "iNDX"][-1]
        catalogue = open_catalogue(BytesSource(path.read_bytes()))
        assert catalogue.indexed and index.offset > len(data)
        types = ["HEAD", "TRAK", "DATA", "iNDX", "mETa", "iNDX", "fOOT"]
        assert [ref.type for ref in catalogue.chunks] == types


class TestRefusals:
    """
    WRT-006: A writer that appends MUST change no byte before the end of the last whole chunk. It continues there with the file id, the next sequence number, and the level of the file. It refuses a file in which it finds damage before that end, or an unknown critical chunk. It need not read payloads that an index lists. Before it appends, it cuts off what follows the last whole chunk. It writes the packets of a cut `DATA` chunk whose CRC matches in a new `DATA` chunk, and reports the losses.
    """

    def refused(self, path: Path, data: bytes, kind: type[HapfmtError], message: str) -> None:
        path.write_bytes(data)
        with pytest.raises(kind, match=message) as caught:
            open_append(path)
        assert caught.value.path == str(path)
        assert path.read_bytes() == data
        path.rename(path.with_name("not locked any more"))

    def test_damage_before_the_end(self, tmp_path: Path):
        first = next(c for c in chunks(WHOLE) if c.header.type == "DATA")
        for place in (first.offset + 3, first.payload_offset + 30, first.payload_offset + 1):
            data = bytearray(WHOLE[: -f.FOOT])
            data[place] ^= 1
            self.refused(tmp_path / "a", bytes(data), ParameterError, "run: hapfmt recover")
        for place in (0, 40):
            data = bytearray(WHOLE[: -f.FOOT])
            data[place] ^= 1
            self.refused(tmp_path / "a", bytes(data), ParameterError, "run: hapfmt recover|HEAD is")
        missing = WHOLE[: first.offset] + WHOLE[first.stop : -f.FOOT]
        self.refused(tmp_path / "a", missing, ParameterError, "missing-chunk")

    def test_an_unknown_critical_chunk(self, tmp_path: Path):
        self.refused(tmp_path / "a", f.minimal(("ZZZZ", b"")), UnsupportedError, "ZZZZ")

    def test_another_version(self, tmp_path: Path):
        data = f.closed(("HEAD", f.head(major=2)))
        self.refused(tmp_path / "a", data, UnsupportedError, "major version 2")

    def test_another_file_behind_it(self, tmp_path: Path):
        other = f.closed(("HEAD", f.head()), file_id=99)
        self.refused(tmp_path / "a", WHOLE + other, ParameterError, "another file")

    def test_more_rubbish_than_a_writer_leaves(self, tmp_path: Path):
        self.refused(tmp_path / "a", WHOLE + b"x" * (1 << 21), ParameterError, "belong to no chunk")
        path = tmp_path / "b"
        path.write_bytes(WHOLE + bytes(1 << 21))
        with open_append(path) as more:
            assert more.note is None
        assert path.read_bytes() == WHOLE

    def test_what_breaks_a_rule(self, tmp_path: Path):
        data = f.file(("HEAD", f.head()), f.TRACK_0, ("DATA", f.cluster((1, 0, 4, FIVE))))
        self.refused(tmp_path / "a", data, FormatError, "DAT-008")
        self.refused(tmp_path / "a", b"text", FormatError, "not a hapf file")

    def test_tracks_that_lack_others(self, tmp_path: Path):
        lone = ("TRAK", f.trak(kind=1))
        data = f.file(("HEAD", f.head()), lone, f.DATA_0)
        self.refused(tmp_path / "a", data, ParameterError, "tracks they depend on")
        path = tmp_path / "b"
        path.write_bytes(f.file(("HEAD", f.head()), lone))
        assert go_on(path) == ["truncated"]
        intact(path)


operations = st.lists(
    st.tuples(st.just("data"), st.integers(0, 4), st.integers(0, 9), st.integers(1, 50))
    | st.tuples(st.just("track"))
    | st.tuples(st.just("metadata"), st.sampled_from("abc"), st.integers(0, 9))
    | st.tuples(st.just("attach"), st.sampled_from("xyz"), st.binary(max_size=9))
    | st.tuples(st.just("session"), st.sampled_from(["close", "leave", "cut", "zeros", "checkpoint"])),
    max_size=30,
)  # fmt: skip


@given(operations)
def test_what_was_written_in_parts_reads_as_if_at_once(tmp_path_factory, steps):
    """Write A, append B, whatever happened in between: reading gives A and B."""
    place = tmp_path_factory.mktemp("parts")
    parts, whole = place / "parts", place / "whole"
    for path, split in ((parts, True), (whole, False)):
        file = create_live(path, sync=NEVER)
        writer = FileWriter(file, file_id=1)
        ends: dict[int, int] = {}
        for kind, *given_ in steps:
            if kind == "track":
                writer.describe([track(len(writer.tracks), len(writer.tracks))])
            elif kind == "data" and writer.tracks:
                number, gap, span = given_
                id_ = number % len(writer.tracks)
                start = ends.get(id_, 0) + gap
                writer.cluster([Packet(id_, start, span, value(number + gap))])
                ends[id_] = start + span
            elif kind == "metadata":
                writer.metadata({given_[0]: given_[1]})
            elif kind == "attach":
                writer.attach(Attachment(given_[0], "", given_[1]))
            elif kind == "session" and split:
                (how,) = given_
                if how == "checkpoint":
                    writer.checkpoint()
                    continue
                if how != "leave":
                    writer.close()
                file.close()
                if how == "cut":
                    data = path.read_bytes()
                    path.write_bytes(data[:-3])
                if how == "zeros":
                    data = path.read_bytes()
                    path.write_bytes(data[: -f.FOOT] + bytes(5000))
                more = open_append(path, sync=NEVER)
                file, writer, _ = more
                assert more.ends() == ends == track_ends(more.catalogue)
        writer.close()
        file.close()
        intact(path)
    a, b = hapfmt.read(parts), hapfmt.read(whole)
    assert (a.metadata, a.attachments) == (b.metadata, b.attachments)
    assert len(a.channels) == len(b.channels)
    for one, other in zip(a.channels, b.channels, strict=True):
        assert np.array_equal(one.stored, other.stored)
        assert (one.coverage, one.label, one.rate_exact) == (
            other.coverage,
            other.label,
            other.rate_exact,
        )


def test_after_an_error_the_file_is_closed(tmp_path: Path):
    path = tmp_path / "a"
    recording(path)
    with pytest.raises(RuntimeError), open_append(path) as more:
        more.writer.metadata({"a": 1})
        raise RuntimeError
    intact(path)
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt), open_append(path) as more:
        more.writer.metadata({"a": 2})
        raise KeyboardInterrupt
    assert path.read_bytes()[: len(before)] == before
    with open_append(path) as more:
        assert more.catalogue.metadata["a"] == 2
    intact(path)


def test_the_examples(tmp_path: Path):
    damaged = set()
    for example in sorted((ROOT / "conformance" / "examples").glob("*.hapf")):
        path = tmp_path / example.name
        path.write_bytes(example.read_bytes())
        before, codes = hapfmt.verify(path), go_on(path)
        if before.verdict == "intact":
            assert codes == []
            intact(path)
        else:
            damaged.add(example.stem)
            after = hapfmt.verify(path)
            assert (after.verdict, after.lost) == (before.verdict, before.lost), "nothing is hidden"
    assert damaged == {"salvaged", "table"}
