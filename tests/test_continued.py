"""Clause 6.3: a channel coded in several tracks, one after the other."""

from __future__ import annotations

import io
from dataclasses import replace
from fractions import Fraction

import forge as f
import numpy as np
import pytest
from click.testing import CliRunner
from depth import deep, either
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples
from test_damage import check

import hapfmt
from hapfmt.cli import cli
from hapfmt.encoder.encode import encode
from hapfmt.errors import UnsupportedError
from hapfmt.format.cluster import Packet
from hapfmt.format.source import BytesSource
from hapfmt.format.track import Component, Track
from hapfmt.limits import LEVELS
from hapfmt.reading.dump import dump, measure
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify
from hapfmt.recording import Calibration, Channel, Deviation, Recording, Span
from hapfmt.writing.filewriter import FileWriter

HEAD = ("HEAD", f.head())
LEVELS_OF_ONE = f.tlv(1, f.quan_parameters(b"\x22\x22", m=1, r=1))
"""Two bits each: 00 is level 0, 01 is 1, 10 is -1, 11 x a run of 2 + x."""


def labelled(label):
    return f.HOLD + f.tlv(2, f.strings(label))


PARTS = [
    ("TRAK", f.trak(labelled("first"), kind=1)),
    ("TRAK", f.trak(LEVELS_OF_ONE, kind=2, base=0, codec=b"QUAN", first=1)),
    ("TRAK", f.trak(labelled("second"), continues=0, count_max=7, first=2)),
    ("TRAK", f.trak(labelled("third"), continues=2, kind=1, first=3)),
    ("TRAK", f.trak(LEVELS_OF_ONE, kind=2, base=3, codec=b"QUAN", first=4)),
]
"""LF and HF, then full band of a smaller range, then LF and HF again."""

DATA = [
    ("DATA", f.cluster((0, 0, 4, f.svarint(5)), (1, 0, 4, b"\x18"), (2, 4, 2, f.svarint(8)))),
    ("DATA", f.cluster((2, 7, 2, f.svarint(6)), (3, 9, 4, f.svarint(-1)), (4, 9, 3, b"\x18"))),
]
CHAIN = f.closed(HEAD, *PARTS, *DATA, duration_ns=13_000_000)
FULL = {0: 5, 1: 6, 2: 4, 3: 5, 4: 7, 5: 7, 7: 6, 8: 6, 9: -1, 10: 0, 11: -2}


def by_tick(data, **asked):
    return {tick: value for (_, tick), value in samples(data, **asked).items()}


class TestOneChannel:
    """
    TRK-018: A reader MUST deliver tracks that continue one another as one channel, each within its own coverage. The first of them describes it. Each track keeps its own contract; the deviation of the channel is the largest.
    """

    def test_bands(self):
        assert rule(CHAIN) == ("intact", None)
        assert by_tick(CHAIN) == FULL
        low = {0: 5, 1: 5, 2: 5, 3: 5, 4: 7, 5: 7, 7: 6, 8: 6, 9: -1, 10: -1, 11: -1, 12: -1}
        assert by_tick(CHAIN, band="lf") == low
        assert by_tick(CHAIN, band="hf") == {0: 0, 1: 1, 2: -1, 3: 0, 9: 0, 10: 1, 11: -1}

    def test_its_description_and_coverage(self):
        (channel,) = Reader(CHAIN).read().channels
        assert channel.label == "first"
        assert channel.coverage == (Span(0, 6), Span(7, 12))
        (ref,) = Reader(CHAIN).channels
        assert [[track.id for track in part.tracks] for part in ref.parts] == [[0, 1], [2], [3, 4]]

    @given(st.integers(0, 13), st.integers(0, 13), st.sampled_from(["full", "lf", "hf"]))
    def test_a_stretch_of_time(self, a, b, band):
        asked = {"start": Fraction(a, 1000), "stop": Fraction(b, 1000), "band": band}
        whole = by_tick(CHAIN, band=band)
        assert by_tick(CHAIN, **asked) == {t: v for t, v in whole.items() if a <= t < b}

    def test_deviations(self):
        first = f.tlv(18, f.deviation(0.5, 0.25))
        second = f.tlv(18, f.deviation(1.0, 0.125))
        data = f.closed(
            HEAD,
            ("TRAK", f.trak(f.HOLD + first)),
            ("TRAK", f.trak(f.HOLD + second, continues=0, first=1)),
            ("DATA", f.cluster((0, 0, 2, f.KNOT_DATA), (1, 2, 2, f.KNOT_DATA))),
        )
        assert Reader(data).read().channels[0].deviation == Deviation(1.0, 0.25)

    def test_words(self):
        raw = f.tlv(1, f.raw_parameters(8))
        fields = {"codec": b"RAWB", "number_format": 5, "count_min": 0, "count_max": 0}
        words = [np.array([x]).tobytes() for x in (0.1, np.inf)]
        data = f.closed(
            HEAD,
            ("TRAK", f.trak(raw, **fields)),
            ("TRAK", f.trak(raw, continues=0, **fields, first=1)),
            ("DATA", f.cluster((0, 0, 1, b"\0" + words[0]), (1, 3, 1, b"\0" + words[1]))),
        )
        (channel,) = Reader(data).read().channels
        assert channel.stored.tolist() == [0.1, np.inf]
        assert channel.coverage == (Span(0, 1), Span(3, 4))


def joined(*recordings, settings=()):
    """A file of recordings that follow each other, each coded for itself."""
    out = io.BytesIO()
    made = [encode(each, chosen) for each, chosen in zip(recordings, settings, strict=True)]
    writer = FileWriter(out, level=LEVELS[2], file_id=f.FILE_ID)
    before: dict[int, int] = {}
    shift = 0
    for encoded in made:
        tracks = [moved(track, shift, before) for track in encoded.tracks]
        writer.describe(tracks)
        before = {track.first_channel: track.id for track in tracks if track.kind != "hf"}
        packets = [
            Packet(packet.track + shift, packet.start, packet.span, packet.data)
            for packet in encoded.packets
        ]
        writer.cluster(packets)
        shift += len(tracks)
    writer.close()
    return out.getvalue()


def moved(track: Track, shift: int, before: dict[int, int]) -> Track:
    return replace(
        track,
        id=track.id + shift,
        base=None if track.base is None else track.base + shift,
        continues=None if track.kind == "hf" else before.get(track.first_channel),
    )


def two_channels(start, size, seed):
    rng = np.random.default_rng(seed)
    calibration = Calibration(1, 0, 1000)
    counts = np.cumsum(rng.integers(-40, 41, (2, size)), axis=1) + 3000
    return Recording(
        tuple(
            Channel(
                stored=row, rate=Fraction(1000), coverage=(Span(start, start + size),),
                calibration=calibration, unit="N", label=label,
            )
            for row, label in zip(counts, "ab", strict=True)
        )
    )  # fmt: skip


def whole_of(*recordings):
    parts = zip(*(recording.channels for recording in recordings), strict=True)
    return Recording(
        tuple(
            replace(
                some[0],
                stored=np.concatenate([part.stored for part in some]),
                coverage=tuple(span for part in some for span in part.coverage),
            )
            for some in parts
        )
    )


class TestContracts:
    A, B = two_channels(0, 2000, 1), two_channels(2500, 1500, 2)
    SETTINGS = (
        hapfmt.Settings(preset="paper", smallest=False),
        hapfmt.Settings(),
    )

    @pytest.fixture
    def file(self):
        return joined(self.A, self.B, settings=self.SETTINGS)

    def test_each_track_has_its_own(self, file):
        """
        DBC-002: With flag *guaranteed*, every sample MUST keep the contract: for each component `|x - y| * kd <= max(kn * |x - zero|, floor * kd)`. The vector form is the same with Euclidean norms over the components, compared by their squares, and the floor of the first component. A verifier that is given x checks this with exact arithmetic. It reports the number of samples outside and the worst ratio of the left side to the right.
        """
        report = verify(file, against=whole_of(self.A, self.B))
        assert report.verdict == "intact"
        found = [(c.channel, c.samples, c.contract is None) for c in report.contracts]
        assert found == [(0, 2000, False), (0, 1500, True), (1, 2000, False), (1, 1500, True)]

    def test_a_change_is_found_where_it_is(self, file):
        """
        DBC-004: A channel without a contract MUST be stored without loss: its full band equals the counts, the raw numbers, or with exact values (9.7) the numbers of the source.
        """
        changed = whole_of(self.A, self.B)
        values = changed.channels[1].stored.copy()
        values[-1] += 1
        changed = replace(
            changed, channels=(changed.channels[0], replace(changed.channels[1], stored=values))
        )
        report = verify(file, against=changed)
        assert report.verdict == "damaged"
        assert [c.outside for c in report.contracts] == [0, 0, 0, 1]

    def test_samples_that_are_missing(self, file):
        longer = whole_of(self.A, two_channels(2200, 2000, 3))
        report = verify(file, against=longer)
        assert [c.missing for c in report.contracts] == [0, 500, 0, 500]

    def test_exact_values_of_one_part(self):
        """Those of the other are the quotient."""
        rng = np.random.default_rng(5)
        exact = rng.integers(-500, 500, 300) * 0.001
        shared = {"rate": Fraction(100), "unit": "N", "calibration": Calibration(1, 0, 1000)}
        counts = np.rint(exact * 1000).astype(np.int64)
        first = Channel(stored=counts, coverage=(Span(0, 300),), exact=exact, **shared)
        second = Channel(stored=counts, coverage=(Span(300, 600),), **shared)
        lossless = hapfmt.Settings()
        data = joined(Recording((first,)), Recording((second,)), settings=(lossless, lossless))
        (channel,) = hapfmt.read(data).channels
        assert channel.exact is not None
        assert channel.exact.tobytes() == np.concatenate([exact, second.samples()]).tobytes()
        (plain,) = Reader(data).read(exact=False).channels
        assert plain.exact is None


class TestDamage:
    """What is left of a chain stays readable, and stays one channel."""

    SMALL = f.closed(
        HEAD,
        ("TRAK", f.trak()),
        ("TRAK", f.trak(continues=0, first=1)),
        ("DATA", f.cluster((0, 0, 2, f.KNOT_DATA))),
        ("DATA", f.cluster((1, 3, 1, f.KNOT_DATA))),
    )

    def without(self, place):
        """CHAIN with one byte of a description changed."""
        payload = bytearray(PARTS[place][1])
        data = bytearray(CHAIN)
        data[CHAIN.index(payload) + 12] ^= 1
        return bytes(data)

    @pytest.mark.parametrize(
        ("place", "gone"), [(0, range(4)), (1, range(4)), (2, range(4, 9)), (3, range(9, 13))]
    )
    def test_a_lost_description(self, place, gone):
        data = self.without(place)
        assert rule(data)[0] == "damaged"
        assert by_tick(data) == {t: v for t, v in FULL.items() if t not in gone}
        reader = Reader(data)
        reader.read()
        assert {(*key,) for key in FULL.items() if key[0] in gone} <= {
            (tick, FULL.get(tick))
            for lost in reader.lost
            for tick in range(lost.start, 13 if lost.stop is None else lost.stop)
        }

    @pytest.mark.parametrize("band", ["lf", "hf"])
    def test_bands(self, band):
        whole = by_tick(CHAIN, band=band)
        for place in range(5):
            found = by_tick(self.without(place), band=band)
            assert found.items() <= whole.items()
            assert found

    @pytest.mark.parametrize("part", [0, *deep(range(1, 8))])
    def test_every_flip(self, part):
        clean = samples(self.SMALL)
        for at in range(part, len(self.SMALL), 8):
            data = bytearray(self.SMALL)
            data[at] ^= 1 << at % 8
            check(bytes(data), clean)

    @either("every", 7, deep=1)
    def test_every_flip_of_a_longer_one(self, every):
        clean = samples(CHAIN)
        for at in range(0, len(CHAIN), every):
            data = bytearray(CHAIN)
            data[at] ^= 0x10
            assert verify(bytes(data)).verdict != "intact"
            assert (samples(bytes(data)) or {}).items() <= clean.items()

    def test_strangers_are_left_out(self):
        """A track of the same channel that does not fit what is left."""
        other = ("TRAK", f.trak(continues=8, rate_num=7, first=5))
        twin = ("TRAK", f.trak(continues=0, first=6))
        data = f.closed(HEAD, *PARTS, *DATA) + b"x"
        assert by_tick(data) == FULL
        bad = f.file(HEAD, ("aaaa", b"x", {"crc": 0}), *PARTS, other, twin, *DATA)
        assert by_tick(bad) == FULL
        codes = [(found.code, found.requirement) for found in Reader(bad).findings]
        assert codes.count(("bad-chunk", "TRK-016")) == 2

    def test_packets_that_are_mixed(self):
        late = ("DATA", f.cluster((0, 20, 1, f.KNOT_DATA)))
        bad = f.file(HEAD, ("aaaa", b"x", {"crc": 0}), *PARTS, *DATA, late)
        assert by_tick(bad) == FULL
        assert ("overlap", "TRK-016") in [(x.code, x.requirement) for x in find(bad)]


def find(data):
    reader = Reader(data)
    reader.read()
    return reader.findings


class TestUnknown:
    """Of an unsupported track nothing is checked: it leaves the others alone."""

    @pytest.mark.parametrize(
        "fields", [{"component_count": 1}, {"rate_num": 7}, {"first_channel": 1}]
    )
    def test_that_does_not_fit(self, fields, tmp_path):
        two = ("TRAK", f.trak(component_count=2))
        tlvs = f.tlv(16, f.deadband(entries=[(1, 0)] * fields.get("component_count", 2)))
        strange = (
            "TRAK",
            f.trak(
                tlvs, **({"component_count": 2, "codec": b"NEWC", "continues": 0} | fields), first=1
            ),
        )
        data = f.closed(
            HEAD, two, strange, ("DATA", f.cluster((0, 0, 4, f.svarint(5) + f.svarint(6)))),
        )  # fmt: skip
        assert verify(data).verdict in ("unsupported", "nonconforming")
        for band in ("full", "lf", "hf"):
            assert samples(data, band=band, channels=[0]) is not None
        path = tmp_path / "a.hapf"
        path.write_bytes(data)
        for how in ([], ["--json"]):
            assert (
                CliRunner().invoke(cli, ["info", str(path), *how], standalone_mode=False).exception
                is None
            )

    @pytest.mark.parametrize("first_channel", [0, 5])
    def test_two_that_continue_it_share_no_channel(self, first_channel):
        """TRK-010: Channel numbers MUST be at most 65534, and different for different components; only HF tracks and continued tracks share them. In a closed file they are 0, 1, 2 ... without a hole."""
        numbers = f.HOLD + f.tlv(5, b"\5\0")
        data = f.closed(
            HEAD,
            ("TRAK", f.trak(codec=b"NEWC")),
            ("TRAK", f.trak(numbers, component_count=2, continues=0, first=1)),
            ("TRAK", f.trak(first_channel=first_channel, continues=0, first=2)),
            ("TRAK", f.trak(component_count=4, first_channel=1, first=3)),
        )
        with pytest.raises(UnsupportedError):
            Reader(data)

    def test_that_fits(self):
        strange = ("TRAK", f.trak(b"", continues=0, codec=b"NEWC", first=1))
        data = f.closed(HEAD, f.TRACK_0, strange, f.DATA_0)
        assert verify(data).verdict == "unsupported"
        assert samples(data) is None
        assert samples(data, band="hf") == {}


class TestTold:
    def test_info(self, tmp_path):
        path = tmp_path / "chain.hapf"
        path.write_bytes(CHAIN)
        told = CliRunner().invoke(cli, ["info", str(path)]).output
        assert "KNOT lf + QUAN hf, then KNOT full, then KNOT lf + QUAN hf" in told

    def test_du(self):
        tracks = measure(BytesSource(CHAIN)).tracks
        assert [track.labels for track in tracks.values()] == [["first"]] * 5

    def test_dump(self):
        rows = [row for chunk in dump(BytesSource(CHAIN)) for row in chunk.get("tracks", ())]
        assert [row["continues"] for row in rows] == [None, None, 0, 2, None]


def test_tracks_of_one_chunk_that_continue_one_another():
    one = Track(0, "full", "KNOT", Fraction(1000), 0, (Component(),), f.knot_parameters())
    out = io.BytesIO()
    writer = FileWriter(out, file_id=f.FILE_ID)
    writer.describe([one, replace(one, id=1, continues=0), replace(one, id=2, continues=1)])
    writer.cluster([Packet(i, i, 1, b"\0") for i in range(3)])
    writer.close()
    assert rule(out.getvalue()) == ("intact", None)
    assert by_tick(out.getvalue()) == {0: 0, 1: 0, 2: 0}
