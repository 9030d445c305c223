"""Clauses 6.3 and 9.9: layers of events in a file, beside its channels."""

from __future__ import annotations

import io
import json
from fractions import Fraction

import forge as f
import numpy as np
import pytest
import strategies
from click.testing import CliRunner
from depth import either
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples

import hapfmt
from hapfmt.cli import cli
from hapfmt.codecs.events import coded, event_packets, layer_track, rate_of
from hapfmt.errors import LimitError, ParameterError, UnsupportedError
from hapfmt.format.cluster import Packet
from hapfmt.format.source import BytesSource
from hapfmt.limits import Limits
from hapfmt.reading.dump import dump, measure
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify
from hapfmt.recording import Calibration, Channel, Event, Recording, Span, in_order
from hapfmt.writing.filewriter import FileWriter

HEAD = ("HEAD", f.head())
NAMED = f.tlv(2, f.strings("touch"))
LAYER = ("TRAK", f.layer(NAMED, rate_num=1000, first=1))


def written(recording, settings=None):
    out = io.BytesIO()
    hapfmt.write(recording, out, settings, canonical=f.FILE_ID)
    return out.getvalue()


def channel(label="a", size=100):
    return Channel(
        stored=np.arange(size), rate=Fraction(100), coverage=(Span(0, size),),
        calibration=Calibration(), label=label,
    )  # fmt: skip


def marked(*packets, duration_ns=9_000_000):
    """One channel of 4 ms, and packets (start, span, bytes) of a layer in a cluster of their own."""
    data = ("DATA", f.cluster(*[(1, *packet) for packet in packets]))
    return f.closed(HEAD, f.TRACK_0, LAYER, f.DATA_0, data, duration_ns=duration_ns)


MARKS = marked((2, 7, f.event(0, "in") + f.event(3, "out", 5, 1) + f.event(0, "twice")))


def told(data, **asked):
    return [
        (int(e.time * 1000), e.text, int(e.duration * 1000), e.channel)
        for e in Reader(data).events(**asked)
    ]


class TestLayer:
    """
    TRK-019: A track of kind events MUST have codec `EVNT`, one component, number format counts, count_min, count_max, `first_channel` and `linked` 0. Of the TLVs of clause 8 it has only 2, 14 and 22. No other kind has that codec.
    EVT-003: `size` and `channel` MUST be at most 65535. In a closed file `channel` is 0 or that of an existing channel, which only verifiers check.
    """

    def test_is_read_beside_the_channels(self):
        assert rule(MARKS) == ("intact", None)
        assert told(MARKS) == [(2, "in", 0, None), (5, "out", 5, 0), (5, "twice", 0, None)]
        recording = Reader(MARKS).read()
        assert [event.text for event in recording.events] == ["in", "out", "twice"]
        assert {event.layer for event in recording.events} == {"touch"}
        assert samples(MARKS) == {(0, tick): 5 for tick in range(4)}

    def test_what_it_may_say_of_itself(self):
        tlvs = NAMED + f.tlv(14, f.strings("button")) + f.tlv(22, b"by hand") + f.tlv(24, b"?")
        both = ("TRAK", f.layer(tlvs, track_count=2, first=1))
        data = f.closed(HEAD, f.TRACK_0, both, f.DATA_0)
        assert rule(data) == ("intact", None)
        first, second = Reader(data).catalogue.layers
        assert (first.components[0].device, first.provenance) == ("button", "by hand")
        assert (second.id, second.components) == (2, first.components)

    def test_an_unknown_ancillary_tlv_of_a_low_type(self):
        """Clause 8 has no TLV 0; it has the reserved TLV 20."""
        for type_, told in [(0, ("intact", None)), (20, ("nonconforming", "TRK-019"))]:
            tlvs = b"".join(sorted([NAMED, f.tlv(type_, b"?")]))
            data = f.closed(
                HEAD, f.TRACK_0, ("TRAK", f.layer(tlvs, track_count=1, first=1)), f.DATA_0
            )
            assert rule(data) == told

    def test_no_channel_is_its_own(self):
        assert [ref.number for ref in Reader(MARKS).channels] == [0]
        low = ("TRAK", f.layer())
        assert rule(f.closed(HEAD, low)) == ("intact", None)

    def test_a_file_that_is_not_closed_may_still_get_the_channel(self):
        open_ = f.file(HEAD, LAYER, ("DATA", f.cluster((1, 0, 1, f.event(0, channel=9)))))
        assert rule(open_) == ("damaged", "FIL-003")

    def test_unknown_ones_leave_the_channels_alone(self):
        strange = ("TRAK", f.layer(codec=b"XVNT", first=1))
        data = f.closed(HEAD, f.TRACK_0, strange, f.DATA_0)
        assert verify(data).verdict == "unsupported"
        assert samples(data) == {(0, tick): 5 for tick in range(4)}
        with pytest.raises(UnsupportedError):
            Reader(data).events()


class TestOrder:
    """
    EVT-004: A reader MUST give the events of a layer in order of their ticks, those of one tick in the order of the file.
    DAT-006: Packets of one track MUST NOT overlap in time and MUST come in order of time within the file. Tracks of kind events are exempt.
    """

    def test_packets_in_any_order(self):
        late = f.event(6, "b") + f.event(1, "c")
        data = marked((0, 9, late), (3, 6, f.event(0, "a") + f.event(3, "bb")))
        assert rule(data) == ("intact", None)
        assert [text for _, text, *_ in told(data)] == ["a", "b", "bb", "c"]

    def test_clusters_in_any_order(self):
        early = ("DATA", f.cluster((1, 0, 1, f.event(0, "first"))))
        data = f.closed(
            HEAD, f.TRACK_0, LAYER, ("DATA", f.cluster((1, 8, 1, f.event(0, "last")))), f.DATA_0,
            early, duration_ns=9_000_000,
        )  # fmt: skip
        assert rule(data) == ("intact", None)
        assert [text for _, text, *_ in told(data)] == ["first", "last"]
        assert told(data, stop=Fraction(1, 1000)) == [(0, "first", 0, None)]

    def test_packets_that_start_together(self):
        """The writer puts them into different clusters."""
        out = io.BytesIO()
        writer = FileWriter(out, file_id=f.FILE_ID)
        writer.describe([layer_track(0, "x", Fraction(1000))])
        writer.cluster([Packet(0, 5, 1, f.event(0, text)) for text in "abc"])
        writer.close()
        assert rule(out.getvalue()) == ("intact", None)
        assert [text for _, text, *_ in told(out.getvalue())] == ["a", "b", "c"]


class TestTimes:
    @given(st.integers(0, 10), st.integers(0, 10))
    def test_a_stretch_of_time(self, a, b):
        """Events that begin in it, and those that still hold at its start."""
        asked = {"start": Fraction(a, 1000), "stop": Fraction(b, 1000)}
        whole = told(MARKS)
        held = [
            (tick, text, duration, channel)
            for tick, text, duration, channel in whole
            if tick < b and (tick >= a or tick + duration > a)
        ]
        assert told(MARKS, **asked) == (held if a < b else [])
        found = [event.text for event in Reader(MARKS).read(**asked).events]
        assert found == [event[1] for event in held if a < b]

    def test_layers_by_name(self):
        assert told(MARKS, layers=["touch"]) == told(MARKS)
        assert told(MARKS, layers=["else"]) == []

    def test_rates(self):
        thirds = [Event(Fraction(1, 3), "a")]
        assert rate_of(thirds) == 3_000_000
        assert rate_of([Event(Fraction(1, 2**31 - 1))]) == 1_000_000
        row = coded(Event("0.0000004"), Fraction(1_000_000), [])
        assert row.tick == 0
        assert coded(Event("0.0000005"), Fraction(1_000_000), []).tick == 1


@given(strategies.recordings())
def test_files_keep_events(recording):
    back = hapfmt.read(written(recording))
    assert sorted(back.events, key=str) == sorted(rounded(recording.events), key=str)
    assert [event.time for event in back.events] == sorted(event.time for event in back.events)


def rounded(events):
    """To the microsecond where no rate of their layer holds them all."""
    out = []
    for event in events:
        rate = rate_of(e for e in events if e.layer == event.layer)
        time, duration = (
            Fraction((2 * (x * rate).numerator + (x * rate).denominator) // (2 * (x * rate).denominator)) / rate
            for x in (event.time, event.duration)
        )  # fmt: skip
        out.append(Event(time, event.text, duration, event.channel, event.layer))
    return out


class TestWriting:
    TEXTS = ("begin", "end")

    def recording(self, *events, labels="ab"):
        return Recording(tuple(channel(label) for label in labels), events=events)

    def test_labels_become_places(self):
        data = written(self.recording(Event(0.5, "x", channel="b"), Event(0.25, "y", 0.1, 0)))
        assert verify(data).events == 2
        assert hapfmt.read(data).events == (
            Event(Fraction(1, 4), "y", Fraction(1, 10), 0),
            Event(Fraction(1, 2), "x", 0, 1),
        )

    @pytest.mark.parametrize("place", ["c", 2, -1])
    def test_channels_that_there_are_not(self, place):
        with pytest.raises(ParameterError, match="names channel"):
            written(self.recording(Event(0, channel=place)))

    @pytest.mark.parametrize(
        "given_", [{"time": -1}, {"time": "x"}, {"time": 0, "duration": -1}, {"time": 0, "text": 5},
                   {"time": 0, "channel": 1.5}],
    )  # fmt: skip
    def test_events_that_are_none(self, given_):
        with pytest.raises(ParameterError):
            Event(**given_)

    def test_after_the_last_tick(self):
        with pytest.raises(ParameterError, match="2\\^48"):
            written(self.recording(Event(2**48)))

    def test_clusters_of_chosen_channels(self):
        """Their places are those in the answer; what speaks of others is left out."""
        data = written(
            self.recording(Event(0, "of a", 0, "a"), Event(1, "of b", 0, "b"), Event(2, "of all"))
        )
        found = Reader(data).read(["b"]).events
        assert [(event.text, event.channel) for event in found] == [("of b", 0), ("of all", None)]
        assert [event.channel for event in Reader(data).read(["b", "a", "b"]).events] == [
            1,
            0,
            None,
        ]

    def test_far_apart(self):
        """A packet is never longer than a cluster, nor than the format allows."""
        events = [Event(Fraction(i), str(i)) for i in (0, 1, 16, 17, 1000, 10**6)]
        packets = list(event_packets(0, [coded(e, Fraction(10**6), []) for e in events]))
        assert [packet.start // 10**6 for packet in packets] == [0, 17, 1000, 10**6]
        assert max(packet.span for packet in packets) <= 2**24
        data = written(self.recording(*events))
        assert [event.text for event in hapfmt.read(data).events] == [e.text for e in events]

    @pytest.mark.deep
    def test_many(self):
        """More than a packet or a cluster of level 1 holds."""
        events = [Event(0, "x" * 60000)] * 30 + [Event(1, "y")] * 70000
        data = written(self.recording(*events))
        assert verify(data).verdict == "intact"
        assert len(Reader(data).events()) == 70030
        sizes = [
            packet["size"]
            for chunk in dump(BytesSource(data))
            for packet in chunk.get("packets", ())
            if packet["track"] == 2
        ]
        assert max(sizes) < 1 << 17

    def test_canonical(self):
        """
        WRT-002: A writer MUST choose the file id at random. In canonical mode the id is an input or follows from the content. No time of day, host, user or random number enters the file: the same input and settings give the same bytes with the same encoder version on the same machine.
        """
        recording = self.recording(Event(0, "a", layer="q"), Event(0, "b", layer="p"))
        assert written(recording) == written(recording)
        assert [event.text for event in hapfmt.read(written(recording)).events] == ["a", "b"]


class TestLimits:
    def test_events_held(self):
        with pytest.raises(LimitError):
            Reader(MARKS, limits=Limits(events=2)).read()
        assert len(Reader(MARKS, limits=Limits(events=2)).events(stop=Fraction(1, 200))) == 1


class TestDigests:
    """
    DGS-001: Whole digests MUST follow the track id, one at least, and fill the payload. The tracks are described before it; none is of kind events, since events may be added to a closed file.
    """

    def test_none_is_written(self):
        recording = Recording((channel(),), events=(Event(0, "a"),))
        data = written(recording, hapfmt.Settings(digest=True))
        report = verify(data)
        assert (report.verdict, report.digests, report.events) == ("intact", 1, 1)


class TestDamage:
    TWO = f.closed(
        HEAD, f.TRACK_0, LAYER, f.DATA_0,
        ("DATA", f.cluster((1, 0, 1, f.event(0, "first")), (1, 1, 1, f.event(0, "second")))),
    )  # fmt: skip

    def test_a_damaged_packet_is_lost_alone(self):
        """
        REC-003: A reader that goes on after damage MUST report every stretch of bytes that was lost, and every span that `lost` names.
        """
        for text, other in ((b"first", "second"), (b"second", "first")):
            data = bytearray(self.TWO)
            data[self.TWO.index(text)] ^= 1
            reader = Reader(bytes(data))
            assert [event.text for event in reader.events()] == [other]
            assert {"bad-payload", "bad-packet"} <= {found.code for found in reader.findings}
            assert [lost.track for lost in reader.lost] == [1]
            assert verify(bytes(data)).verdict == "damaged"
            assert samples(bytes(data)) == samples(self.TWO)

    @either("every", 5, deep=1)
    def test_every_flip(self, every):
        clean = set(told(self.TWO))
        for at in range(0, len(self.TWO), every):
            data = bytearray(self.TWO)
            data[at] ^= 0x10
            assert verify(bytes(data)).verdict != "intact"
            assert set(self.events_of(bytes(data))) <= clean
            assert (samples(bytes(data)) or {}).items() <= samples(self.TWO).items()

    def events_of(self, data):
        try:
            return told(data)
        except hapfmt.HapfmtError:
            return []

    def test_a_packet_that_breaks_a_rule(self):
        bad = f.cluster((1, 0, 1, f.event(0, "kept")), (1, 1, 1, f.event(5, "out of its packet")))
        intact = f.file(HEAD, f.TRACK_0, LAYER, ("DATA", bad))
        assert rule(intact)[1] == "EVT-001"
        damaged = f.file(HEAD, ("aaaa", b"x", {"crc": 0}), f.TRACK_0, LAYER, ("DATA", bad))
        assert [event.text for event in Reader(damaged).events()] == ["kept"]
        assert "EVT-001" in [found["requirement"] for found in verify(damaged).findings]

    def test_a_channel_whose_description_is_lost(self):
        """What spoke of it speaks of nothing that can be named."""
        data = bytearray(MARKS)
        data[MARKS.index(f.trak()) + 9] ^= 1
        assert [event.channel for event in Reader(bytes(data)).read().events] == [None] * 3


class TestOtherFiles:
    EVENTS = (
        Event(Fraction(1, 3), 'a "quoted", text\n', Fraction(1, 7), 1, "Ebene µ"),
        Event(0, ""),
    )
    RECORDING = Recording((channel("a"), channel("b")), events=EVENTS)

    def test_npz_keeps_them(self, tmp_path):
        path = tmp_path / "a.npz"
        notes = hapfmt.save(self.RECORDING, path)
        assert not any("events" in note for note in notes)
        back = hapfmt.read(path)
        assert back.events == self.EVENTS
        assert "notes" not in back.metadata
        with np.load(path) as archive:
            rows = json.loads(archive["events"].item())
        assert rows[0]["time"] == "1/3"

    @pytest.mark.parametrize(
        "text", ["{", "5", "[5]", '[{"time": "1/0"}]', '[{"when": 1}]', "[" * 100_000, "null"]
    )
    def test_npz_with_something_else(self, tmp_path, text):
        path = tmp_path / "a.npz"
        np.savez(path, x=np.zeros((1, 3)), rate="10", events=np.array(text))
        with pytest.raises(ParameterError):
            hapfmt.read(path)

    @pytest.mark.parametrize("suffix", [".npy", ".csv", ".wav"])
    def test_others_say_that_they_do_not(self, tmp_path, suffix):
        notes = hapfmt.save(self.RECORDING, tmp_path / f"a{suffix}")
        assert any("events" in note for note in notes if note.startswith("not carried over"))


class TestTold:
    @pytest.fixture
    def path(self, tmp_path):
        path = tmp_path / "marks.hapf"
        path.write_bytes(MARKS)
        return str(path)

    def test_info(self, path):
        assert "layer of events: touch (track 1, 1000 ticks/s)" in self.run("info", path)
        (layer,) = json.loads(self.run("info", path, "--json"))["layers"]
        assert (layer["track"], layer["label"], layer["rate_num"]) == (1, "touch", 1000)

    def test_verify(self, path):
        assert "3 events" in self.run("verify", path)
        assert json.loads(self.run("verify", path, "--json"))["event_count"] == 3

    def test_dump(self, path):
        rows = json.loads(self.run("dump", path, "--counts"))
        (packet,) = [p for row in rows for p in row.get("packets", ()) if p["track"] == 1]
        assert packet["events"][1] == {"tick": 5, "duration": 5, "channel": 0, "text": "out"}

    def test_events_of_info(self, path):
        told_lines = self.run("info", path, "--events").splitlines()
        rows = [line.split()[0] for line in told_lines if line.lstrip().startswith("0.")]
        assert rows == ["0.002", "0.005", "0.005"]
        rows = json.loads(self.run("info", path, "--events", "--json"))["events"]
        assert rows[1] == {
            "time": "1/200", "duration": "1/200", "channel": 0, "text": "out", "layer": "touch",
        }  # fmt: skip

    def test_du(self):
        usage = measure(BytesSource(MARKS))
        assert (usage.tracks[1].event_count, usage.tracks[1].sample_count) == (3, 0)
        assert usage.tracks[1].labels == ["touch"]
        assert sum(usage.causes.values()) == len(MARKS)

    def run(self, *args):
        done = CliRunner().invoke(cli, args, standalone_mode=False)
        assert done.exception is None
        return done.output


def test_in_order_of_time_and_as_they_come():
    events = [Event(1, "b"), Event(0, "c"), Event(1, "a")]
    assert [event.text for event in in_order(events)] == ["c", "b", "a"]
