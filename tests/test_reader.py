"""Clauses 7, 8 and 10: channels, times and bands of a file; no more is decoded than asked for."""

from __future__ import annotations

import io
import tracemalloc
from collections import Counter
from fractions import Fraction

import forge as f
import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from judge import rule, samples

import hapfmt
from hapfmt.errors import FormatError, HapfmtError, LimitError, ParameterError
from hapfmt.limits import LEVELS, Limits
from hapfmt.numbers import clamp
from hapfmt.reading import catalogue
from hapfmt.reading.decoder import TrackDecoder
from hapfmt.reading.reader import Reader
from hapfmt.recording import Calibration, Channel, Recording, Span

pytestmark = pytest.mark.capped

HEAD = ("HEAD", f.head())
LINE = f.tlv(1, f.knot_parameters(1))
LEVELS_OF_ONE = f.tlv(1, f.quan_parameters(b"\x22\x22", m=1, r=1))
"""Two bits each: 00 is level 0, 01 is 1, 10 is -1, 11 x a run of 2 + x."""


def encoded(recording, settings=None, **given_):
    out = io.BytesIO()
    hapfmt.write(recording, out, settings, canonical=f.FILE_ID, **given_)
    return out.getvalue()


def pair(
    lf: bytes, hf: bytes, lf_range=(-100, 100), hf_range=(-100, 100), lf_at=(0, 4), hf_at=(0, 4)
):
    """A channel of two tracks, one packet each, at (start, span)."""
    low = ("TRAK", f.trak(kind=1, count_min=lf_range[0], count_max=lf_range[1]))
    fields = {
        "kind": 2,
        "base": 0,
        "codec": b"QUAN",
        "count_min": hf_range[0],
        "count_max": hf_range[1],
    }
    high = ("TRAK", f.trak(LEVELS_OF_ONE, **fields, first=1))
    data = ("DATA", f.cluster((0, *lf_at, lf), (1, *hf_at, hf)))
    stop = max(sum(lf_at), sum(hf_at)) * 10**6
    return f.closed(HEAD, low, high, data, duration_ns=stop)


def values(data, **asked):
    return list((samples(data, **asked) or {}).values())


class TestBands:
    DATA = pair(f.svarint(5), b"\x18")
    """LF 5 5 5 5; HF 0 1 -1 0."""

    def test_each(self):
        """
        DEC-005: A decoder MUST deliver d where only LF is wanted. Where only HF is wanted it delivers e^, with B of the calibration taken as 0. A full-band track belongs to LF.
        """
        assert rule(self.DATA) == ("intact", None)
        assert values(self.DATA) == [5, 6, 4, 5]
        assert values(self.DATA, band="lf") == [5, 5, 5, 5]
        assert values(self.DATA, band="hf") == [0, 1, -1, 0]

    def test_full_band_tracks(self):
        assert values(f.minimal(), band="lf") == [5] * 4
        assert values(f.minimal(), band="hf") == []
        (channel,) = Reader(f.minimal()).read(band="hf").channels
        assert channel.coverage == ()

    def test_residuals_have_no_offset(self):
        tlvs = f.HOLD + f.tlv(3, f.calibration(1, 50, 2))
        low = ("TRAK", f.trak(tlvs, kind=1))
        high = ("TRAK", f.trak(LEVELS_OF_ONE, kind=2, base=0, codec=b"QUAN", first=1))
        data = f.closed(
            HEAD, low, high, ("DATA", f.cluster((0, 0, 4, f.svarint(5)), (1, 0, 4, b"\x18")))
        )
        physical = [
            Reader(data).read(band=band).channels[0].samples().tolist()
            for band in hapfmt.reading.reader.BANDS
        ]
        assert physical == [[27.5, 28.0, 27.0, 27.5], [27.5] * 4, [0.0, 0.5, -0.5, 0.0]]

    def test_clamping_of_a_track(self):
        """
        DEC-001: A decoder MUST clamp each decoded count to the declared range of its track. It clamps the sum of LF and HF to the range of the LF track.
        """
        data = pair(f.svarint(5), b"\x18", lf_range=(-9, 3), hf_range=(0, 0))
        assert values(data, band="lf") == [3] * 4
        assert values(data, band="hf") == [0] * 4

    def test_clamping_of_the_sum(self):
        """
        DEC-001: A decoder MUST clamp each decoded count to the declared range of its track. It clamps the sum of LF and HF to the range of the LF track.
        """
        data = pair(f.svarint(5), b"\x18", lf_range=(5, 5))
        assert values(data) == [5, 5, 5, 5]
        assert values(pair(f.svarint(5), b"\x18", lf_range=(0, 5))) == [5, 5, 4, 5]

    @pytest.mark.parametrize(
        ("lf_at", "hf_at", "both"),
        [
            ((0, 4), (2, 4), [2, 3]),
            ((2, 4), (0, 4), [2, 3]),
            ((0, 2), (4, 2), []),
            ((1, 9), (3, 2), [3, 4]),
        ],
    )
    def test_ticks_that_both_cover(self, lf_at, hf_at, both):
        """
        DEC-003: The full band of a channel with an HF track MUST be delivered only for ticks that both tracks cover; the others are gaps. For an LF track whose HF track is not known it is empty. Gaps are not filled with values. Where an output cannot leave them out, it marks them by NaN or a mask.
        """
        hf = {4: b"\x18", 2: b"\x10"}[hf_at[1]]
        data = pair(f.svarint(5), hf, lf_at=lf_at, hf_at=hf_at)
        assert rule(data) == ("intact", None)
        assert [tick for _, tick in samples(data)] == both

    def test_unknown(self):
        with pytest.raises(ParameterError):
            Reader(self.DATA).read(band="mf")

    @given(
        st.lists(st.integers(-1, 1), min_size=1, max_size=30),
        st.integers(-20, 20),
        st.integers(-20, 20),
    )
    def test_the_sum_is_what_the_page_says(self, e, d, high):
        low = min(d, high) - 1
        row = "".join({0: "00", 1: "01", -1: "10"}[level] for level in e)
        row += "0" * (-len(row) % 8)
        hf = bytes(int(row[i : i + 8], 2) for i in range(0, len(row), 8))
        at = (0, len(e))
        data = pair(f.svarint(d), hf, lf_range=(low, high), lf_at=at, hf_at=at)
        assert values(data) == [clamp(clamp(d, low, high) + x, low, high) for x in e]


class TestGaps:
    """
    DEC-003: The full band of a channel with an HF track MUST be delivered only for ticks that both tracks cover; the others are gaps. For an LF track whose HF track is not known it is empty. Gaps are not filled with values. Where an output cannot leave them out, it marks them by NaN or a mask.
    """

    DATA = f.closed(
        HEAD,
        f.TRACK_0,
        ("DATA", f.cluster((0, 2, 2, b"\x02"), (0, 7, 1, b"\x04"))),
        duration_ns=8 * 10**6,
    )

    def test_hold_no_values(self):
        (channel,) = Reader(self.DATA).read().channels
        assert channel.coverage == (Span(2, 4), Span(7, 8))
        assert channel.stored.tolist() == [1, 1, 2]

    def test_show_as_nan(self):
        (channel,) = Reader(self.DATA).read().channels
        assert np.isnan(channel.filled()).tolist() == [
            True,
            True,
            False,
            False,
            True,
            True,
            True,
            False,
        ]


EIGHT = Fraction(8, 1000)


@pytest.mark.capped(False)  # threads decode what is long
@strategies.idle_settings
@given(strategies.recordings(), strategies.encoder_settings(), st.data())
def test_a_part_is_a_slice_of_the_whole(recording, settings, data):
    """Reading [a, b) and slicing the whole give the same; so do the index and the walk."""
    file = encoded(recording, settings)
    whole = Reader(file).read()
    times = st.sampled_from(
        [Fraction(0), Fraction(1, 100), Fraction(1), Fraction(2**40, 1000)]
    ) | st.fractions(0, 1)
    a, b = sorted((data.draw(times), data.draw(times)))
    part = Reader(file).read(start=a, stop=b)
    for x, y in zip(whole.channels, part.channels, strict=True):
        cut = x.slice_ticks(
            *(
                -(
                    -t.numerator
                    * x.rate_exact.numerator
                    // (t.denominator * x.rate_exact.denominator)
                )
                for t in (a, b)
            )
        )
        assert cut.coverage == y.coverage
        assert cut.stored.tobytes() == y.stored.tobytes() or not cut.stored.size


class TestTimes:
    """
    TIM-001: A reader that gives seconds MUST compute them from the tick by that one expression, never by adding up.
    """

    DATA = f.closed(
        HEAD, ("TRAK", f.trak(rate_num=30000, rate_den=1001)),
        ("DATA", f.cluster((0, 0, 1 << 20, f.KNOT_DATA))), duration_ns=-(-(1001 * 10**9 << 20) // 30000),
    )  # fmt: skip

    @pytest.mark.parametrize("tick", [0, 1, 29970, 2**20 - 1])
    def test_one_tick(self, tick):
        at = Fraction(tick * 1001, 30000)
        late = Reader(self.DATA).read(start=at, stop=at + Fraction(1, 10**9))
        assert late.channels[0].coverage == (Span(tick, tick + 1),)
        early = Reader(self.DATA).read(start=at - Fraction(1, 10**9), stop=at)
        assert tick not in [span.start for span in early.channels[0].coverage]

    def test_the_end_of_a_channel(self):
        (channel,) = Reader(self.DATA).read().channels
        assert channel.duration == Fraction(1001 << 20, 30000)

    def test_empty_and_upside_down(self):
        for start, stop in [(1, 1), (2, 1), (-2, -1), (10**9, None)]:
            assert samples(self.DATA, start=start, stop=stop) == {}

    @pytest.mark.parametrize("start", [float("inf"), float("nan"), "x"])
    def test_times_that_are_no_numbers(self, start):
        with pytest.raises(HapfmtError):
            Reader(f.minimal()).read(start=start)


def many() -> Recording:
    """Four channels at three rates, two seconds."""
    rng = np.random.default_rng(5)

    def channel(label, rate, ticks):
        x = np.cumsum(rng.integers(-30, 31, ticks)) + rng.integers(-400, 400, ticks)
        return Channel(
            x.astype(np.int32),
            Fraction(rate),
            calibration=Calibration(1, 0, 1000),
            label=label,
            unit="N",
        )

    return Recording(
        (
            channel("a", 1000, 2000),
            channel("b", 1000, 2000),
            channel("c", 250, 500),
            channel("d", 8000, 16000),
        )
    )


@pytest.fixture(scope="module")
def many_file() -> bytes:
    return encoded(many(), hapfmt.Settings.of("paper", cluster=Fraction(1, 4), smallest=False))


@pytest.fixture
def decoded_packets(monkeypatch):
    """Counts the packets that are decoded, by track."""
    counter: Counter[int] = Counter()
    original = TrackDecoder.decode

    def decode(self, packet):
        counter[packet.track] += 1
        return original(self, packet)

    monkeypatch.setattr(TrackDecoder, "decode", decode)
    return counter


class TestDecodedOnly:
    def tracks(self, file, label):
        (ref,) = [ref for ref in Reader(file).channels if ref.label == label]
        return ref.track.id, ref.residual.id

    def test_channels(self, many_file, decoded_packets):
        lf, hf = self.tracks(many_file, "c")
        Reader(many_file).read(["c"])
        assert decoded_packets == {lf: 8, hf: 8}

    @pytest.mark.parametrize("band", ["lf", "hf"])
    def test_bands(self, many_file, decoded_packets, band):
        lf, hf = self.tracks(many_file, "a")
        Reader(many_file).read(["a"], band=band)
        assert decoded_packets == {lf if band == "lf" else hf: 8}

    def test_times(self, many_file, decoded_packets):
        Reader(many_file).read(["a"], start=Fraction(1, 4), stop=Fraction(1, 2))
        assert set(decoded_packets.values()) == {1}

    def test_order_and_numbers(self, many_file):
        whole = Reader(many_file).read()
        chosen = Reader(many_file).read(["d", 0, "d"])
        assert [channel.label for channel in chosen.channels] == ["d", "a", "d"]
        assert np.array_equal(chosen.channels[0].stored, whole.channels[3].stored)
        with pytest.raises(ParameterError, match="there are"):
            Reader(many_file).read(["e"])

    def test_bytes_read(self):
        """A short time by the index reads a small part of the file."""

        class Counting(io.BytesIO):
            total = 0

            def read(self, size=-1):
                data = super().read(size)
                self.total += len(data)
                return data

        settings = hapfmt.Settings.of("paper", cluster=Fraction(1, 16), smallest=False)
        data = encoded(many(), settings)
        stream = Counting(data)
        Reader(stream).read(start=0, stop=Fraction(1, 100))
        assert stream.total < len(data) // 3


@strategies.idle_settings
@given(strategies.recordings(), strategies.encoder_settings())
def test_files_that_are_written_are_intact(recording, settings):
    """
    CHK-005: `sequence` MUST be 0 in the first chunk and greater by one in each next chunk.
    IDX-002: The entries MUST fill the payload, and list every chunk before the index: from the `iNDX` chunk at `previous` on, or from the first chunk where `previous` is 0. `first_sequence` is the sequence number of the first; the others have the numbers after it. For a `DATA` chunk `start_ms` is at most the start of its earliest packet, and `start_ms + length_ms` at least the end of its latest. Times of 2^53 and more are set to 2^53 - 1.
    FOT-002: `index_distance` MUST be as the table says. In a `fOOT` that closes the file `duration_ns` is the end of the latest packet of any track, rounded up, at most the largest i64; 0 without packets.
    DGS-003: A digest MUST be that of exactly the packets of its track in chunks before it, by sequence numbers.
    """
    file = encoded(recording, settings)
    report = hapfmt.verify(file)
    assert (report.verdict, report.error, report.findings, report.lost) == ("intact", None, [], [])
    back = hapfmt.read(file)
    assert [c.coverage for c in back.channels] == [c.coverage for c in recording.channels]
    assert report.samples >= back.sample_count
    assert back.attachments == recording.attachments
    assert back.epoch_ns == recording.epoch_ns


class TestValues:
    """
    VAL-003: A reader that gives binary64 values MUST give the correctly rounded quotient, or the exact values of 9.7. (The quotient is one division of two exact binary64 integers.)
    """

    @given(strategies.affines((-(2**23), 2**23 - 1)), st.integers(-(2**23), 2**23 - 1))
    def test_are_correctly_rounded(self, affine, count):
        calibration = Calibration(*affine)
        exact = Fraction(count * affine.a + affine.b, affine.d)
        assert calibration.physical(np.array([count]))[0] == exact.numerator / exact.denominator

    def test_words_are_what_they_are(self):
        x = np.array([0.1, -0.0, np.inf, 5e-324])
        (channel,) = hapfmt.read(encoded(Recording((Channel(x, Fraction(10)),)))).channels
        assert channel.stored.tobytes() == x.tobytes()

    def test_words_of_no_samples(self):
        x = np.random.default_rng(0).normal(size=9)
        (channel,) = Reader(encoded(Recording((Channel(x, Fraction(10)),)))).read(start=5).channels
        assert channel.stored.dtype == np.float64


class TestLimits:
    """
    LIM-002: A reader MUST check every limit before it takes memory for what the number promises.
    LIM-003: A reader MAY have lower limits of its own, and MUST then report *unsupported*, not damage.
    """

    def test_samples(self, many_file):
        with pytest.raises(LimitError) as error:
            Reader(many_file, limits=Limits(samples=1000)).read()
        assert error.value.exit_code == 4
        Reader(many_file, limits=Limits(samples=1000)).read(["c"], band="lf")

    def test_packets(self, many_file):
        with pytest.raises(LimitError):
            Reader(many_file, limits=Limits(packet_samples=100)).read(["d"])

    @pytest.mark.parametrize(
        "data",
        [
            f.SIGNATURE + f.chunk("HEAD", b"", 0, size=2**32 - 1),
            f.SIGNATURE + f.chunk("HEAD", f.head(), 0, size=2**24),
            f.file(HEAD, ("TRAK", f.trak(f.tlv(1, b"")[:-1] + f.varint(2**32)))),
            f.file(HEAD, f.TRACK_0, ("DATA", f.varint(2**32))),
            f.file(HEAD, f.TRACK_0, ("DATA", f.cluster((0, 0, 2**32, f.KNOT_DATA)))),
            f.file(HEAD, f.TRACK_0, ("DATA", f.table([(0, 2**32, 0, 4, 0)]))),
            f.file(
                HEAD, f.TRACK_0, ("DATA", f.cluster((0, 0, 4, b"\0" + f.varint(2**32) + b"\0")))
            ),
            f.file(HEAD, f.TRACK_0, ("DATA", f.cluster((0, 0, 4, f.svarint(2**32))))),
            f.minimal(ahead={"count": 2**32 - 1}),
            f.minimal(duration_ns=2**64 - 1),
            f.minimal(index_distance=2**32 - 1),
            f.minimal(("aTTc", b"\xff")),
        ],
        ids=range(12),
    )
    def test_2_to_the_32_of_anything(self, data):
        Reader(f.minimal()).read()
        tracemalloc.start()
        try:
            with Reader(data, strict=True) as reader:
                reader.read()
            report = hapfmt.verify(data)
            assert report.verdict != "intact"
        except HapfmtError:
            pass
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1 << 20

    def test_levels_differ(self):
        assert LEVELS[1].payload_size < LEVELS[2].payload_size


class TestStrict:
    def test_damage_raises(self, residual_file):
        bad = bytearray(residual_file)
        bad[bad.rindex(b"DATA") + 60] ^= 1
        with pytest.raises(FormatError, match="bad-payload"):
            hapfmt.read(bytes(bad))
        assert Reader(bytes(bad)).read().channels[0].coverage != ()

    def test_not_closed_raises(self):
        with pytest.raises(FormatError, match="not-closed"):
            hapfmt.read(f.minimal()[: -f.FOOT])

    def test_an_error_names_the_file(self, tmp_path):
        path = tmp_path / "a.hapf"
        path.write_bytes(b"no")
        with pytest.raises(FormatError) as error:
            hapfmt.read(path)
        assert str(error.value) == f"{path}:0x0: not a hapf file: no signature [FIL-001]"


def test_a_file_that_changes_while_it_is_read(tmp_path):
    path = tmp_path / "a.hapf"
    path.write_bytes(f.minimal())
    with Reader(path) as reader:
        pieces = reader.pieces(list(reader.catalogue.tracks.values()))
        reader.scan()
        with path.open("r+b") as stream:
            stream.seek(reader.catalogue.data[0].offset)
            stream.write(b"gone")
        with pytest.raises(FormatError, match="changed while it was read"):
            list(pieces)


def test_channels_are_put_together_once(monkeypatch):
    """So a loop over reader.channels[i] takes time in proportion to their number."""
    made = Counter()

    class Counted(catalogue.ChannelRef):
        def __init__(self, *given):
            made.update(["channel"])
            super().__init__(*given)

    monkeypatch.setattr(catalogue, "ChannelRef", Counted)
    data = io.BytesIO()
    hapfmt.write(np.arange(60, dtype=np.int32).reshape(20, 3), data, rate=100, transpose=False)
    with Reader(data.getvalue()) as reader:
        numbers = [reader.channels[place].number for place in range(20)]
        reader.channels.pop()
        assert numbers == [ref.number for ref in reader.channels] == list(range(20))
        reader.scan()
        assert len(reader.read().channels) == 20
    assert made["channel"] <= 40
