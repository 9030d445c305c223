"""A player reads ahead from any file: every layout, damage, a false index; in little memory."""

from __future__ import annotations

import io
import time
import tracemalloc
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import forge as f
import make
import numpy as np
import pytest
from depth import either, sample
from hypothesis import given
from hypothesis import strategies as st
from rendering import file_of, joined, profile_of
from stalls import slowness
from test_continued import CHAIN, TestContracts, two_channels, whole_of
from test_continued import joined as continued
from test_losses import GAPS, STEADY, TABLE, payload_of
from test_recover import flipped

from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.encoder.encode import encode
from hapfmt.errors import HapfmtError, ParameterError
from hapfmt.format.cluster import Packet
from hapfmt.kernels import compiled
from hapfmt.limits import LEVELS
from hapfmt.reading.reader import Reader
from hapfmt.recording import Span
from hapfmt.replay.render import Assignment, Renderer, Route
from hapfmt.replay.render import feed as streaming
from hapfmt.writing.filewriter import FileWriter

VECTORS = sorted((Path(make.__file__).resolve().parent.parent / "vectors").rglob("*.hapf"))
MILLI = Calibration(1, 0, 1000)
BANDS = ("full", "lf", "hf")
MOST, CHANNELS = 5000, 6
"""Ticks that are compared of a channel, and channels of a file."""


def decoded(data, band, number, start, stop):
    """[ticks] of a channel, NaN where there is nothing, read as a part of the file; None: refused."""
    try:
        with Reader(data) as reader:
            rate = reader.select([number])[0].track.rate
            chosen = reader.select([number])
            assembly = reader.assembly(chosen, start / rate, stop / rate, band=band)
            return assembly.channel(chosen[0]).filled(start, stop)
    except HapfmtError:
        return None


def played(data, band, number, start, stop, block=None):
    """The same by a renderer, for a device that is as fast as the channel."""
    try:
        with Reader(data) as reader:
            rate = reader.select([number])[0].track.rate
            profile = profile_of(rate=rate, band=band)
            renderer = Renderer(
                reader,
                profile,
                Assignment((Route(number, 0, Fraction(1)),)),
                start / rate,
                stop / rate,
            )
            renderer.block_samples = block or renderer.block_samples
            values, known = joined(renderer.blocks())
    except HapfmtError:
        return None
    out = np.full(stop - start, np.nan)
    out[: len(values)] = np.where(known, values, np.nan)[:, 0]
    return out


def same(data, bands=BANDS, block=None):
    """That a renderer gives of each channel what a reader gives of the same stretch."""
    try:
        with Reader(data) as reader:
            channels = {ref.number: (ref.track.rate, reader.duration) for ref in reader.channels}
            codecs = {track.codec for track in reader.catalogue.tracks.values()}
    except HapfmtError:
        return
    for number, (rate, duration) in list(channels.items())[:CHANNELS]:
        stop = int(duration * rate)
        start = max(stop - MOST, 0)
        for band in bands:
            want = decoded(data, band, number, start, stop)
            got = played(data, band, number, start, stop, block)
            if want is None:
                # Refused, or nothing of it is needed: a band that is not there, marks.
                assert got is None or not np.isfinite(got).any() or "EVNT" in codecs
                continue
            want[~np.isfinite(want)] = np.nan
            assert got is not None
            np.testing.assert_array_equal(got, want)


@pytest.mark.parametrize("path", sample(VECTORS), ids=lambda path: "-".join(path.parts[-2:]))
def test_every_conformance_file(path):
    same(path.read_bytes())


@pytest.mark.parametrize("block", [1, 3, 1000])
@pytest.mark.parametrize("data", [CHAIN, STEADY, GAPS])
def test_chains_and_gaps(data, block):
    same(data, block=block)


@pytest.mark.parametrize("block", [7, 1000])
def test_continued_tracks_of_different_codecs(block):
    a, b = two_channels(0, 2000, 1), two_channels(2500, 1500, 2)
    for settings in (TestContracts.SETTINGS, TestContracts.SETTINGS[::-1]):
        same(continued(a, b, settings=settings), block=block)
    assert len(whole_of(a, b).channels) == 2


def test_exact_values_beside_counts():
    """Of a sensor's counts that somebody multiplied in two ways: every double as it was."""
    rng = np.random.default_rng(2)
    counts = rng.integers(-30_000, 30_000, 500)
    x = np.where(counts % 7 == 0, np.nextafter(counts * 0.001, 9e9), counts * 0.001)
    channel = Channel.from_physical(x, 1000, unit="N")
    data = file_of(Recording((channel,)))
    with Reader(data) as reader:
        assert {track.codec for track in reader.catalogue.tracks.values()} == {"LPCX"}
    same(data, ("full",), block=7)
    assert played(data, "full", 0, 0, 500).tobytes() == x.tobytes()


class TestDamage:
    @pytest.mark.compiled
    @pytest.mark.parametrize("data", [CHAIN, STEADY, GAPS])
    @either("every", 17, deep=3, nightly=1)
    def test_any_byte(self, data, every):
        for at in range(0, len(data), every):
            same(flipped(data, at), ("full",))

    @pytest.mark.compiled
    @pytest.mark.parametrize("data", [CHAIN, STEADY])
    @either("every", 17, deep=3, nightly=1)
    def test_any_length(self, data, every):
        """Files that were not closed."""
        for size in range(0, len(data), every):
            same(data[:size], ("full",))

    @given(st.integers(0, 10**6), st.integers(1, 2000))
    def test_a_stretch_of_bytes(self, at, size):
        at %= len(LONG)
        data = LONG[:at] + bytes(byte ^ 0x5A for byte in LONG[at : at + size]) + LONG[at + size :]
        same(data, ("full", "lf"))

    def test_what_is_lost_is_said_and_not_played(self):
        second = payload_of(STEADY, "DATA", 1)
        data = flipped(STEADY, second + TABLE + 5)
        with Reader(data) as reader:
            profile = profile_of(3)
            routes = tuple(Route(i, i, Fraction(1)) for i in range(3))
            renderer = Renderer(reader, profile, Assignment(routes))
            values, known = joined(renderer.blocks())
            assert [tuple(span)[:3] for span in renderer.lost_spans] == [(1, 4, 8)]
            assert renderer.lost == ["lost: channel 1 from 0.004 s to 0.008 s"]
            # Once more: nothing is counted twice.
            joined(renderer.blocks())
            assert len(renderer.lost_spans) == 1
        assert known.tolist() == [[True, not 4 <= n < 8, True] for n in range(12)]
        assert not np.isnan(values).any()


def long_file():
    rng = np.random.default_rng(5)
    channels = [
        Channel(
            np.cumsum(rng.integers(-20, 21, 3000)).astype(np.int32), Fraction(1000),
            calibration=MILLI, unit="N", label=label,
        )
        for label in "abc"
    ]  # fmt: skip
    return file_of(
        Recording(tuple(channels)),
        Settings("paper", bits=8, cluster=Fraction(1, 4), smallest=False),
    )


LONG = long_file()


class TestFalseIndex:
    """A file whose index names other places: found out while it is played, and played on."""

    @pytest.mark.parametrize("at", range(3))
    @pytest.mark.parametrize("block", [1, 5, 1000])
    def test_places(self, at, block):
        rows = [[(track, 4 * i, 4, f.svarint(track + 1)) for track in range(2)] for i in range(3)]
        chunks = [
            ("HEAD", f.head()),
            ("TRAK", f.trak(track_count=2)),
            *[("DATA", f.cluster(*some)) for some in rows],
        ]
        places, offset = [], 8
        for number, (type_, payload, *_) in enumerate(chunks):
            times = (4 * (number - 2), 4 * (number - 1)) if type_ == "DATA" else (0, 0)
            places.append((type_, offset, *times))
            offset += f.HEADER + len(payload)
        lie = list(places)
        type_, where, *times = lie[2 + at]
        lie[2 + at] = (type_, where + 1, *times)
        true = f.closed(*chunks, ahead={"entries": places}, duration_ns=12_000_000)
        false = f.closed(*chunks, ahead={"entries": lie}, duration_ns=12_000_000)
        assert Reader(false).catalogue.indexed
        for channel in range(2):
            want = played(true, "full", channel, 0, 12)
            assert np.isfinite(want).all()
            np.testing.assert_array_equal(played(false, "full", channel, 0, 12, block), want)

    def test_a_cluster_that_it_hid(self):
        """Found out behind it: what was played was a gap, and the rest goes on."""
        rows = [(0, 4 * i, 4, f.svarint(i)) for i in range(4)]
        chunks = [("HEAD", f.head()), f.TRACK_0, *[("DATA", f.cluster(row)) for row in rows]]
        entries, offset = [], 8
        for number, (type_, payload, *_) in enumerate(chunks):
            times = (4 * (number - 2), 4 * (number - 1)) if type_ == "DATA" else (0, 0)
            entries.append((type_, offset + (number == 5), *times))
            offset += f.HEADER + len(payload)
        del entries[3]
        ahead = {"entries": entries, "first": 1}  # so that the numbers fit
        data = f.closed(*chunks, ahead=ahead, duration_ns=16_000_000)
        with Reader(data) as reader:
            renderer = Renderer(reader, profile_of(), Assignment((Route(0, 0, Fraction(1)),)))
            renderer.block_samples = 4
            values, known = joined(renderer.blocks())
        assert known[:, 0].tolist() == [not 4 <= n < 8 for n in range(16)]
        assert values[known].tolist() == [0.0] * 4 + [2.0] * 4 + [3.0] * 4

    def test_a_description_that_it_hid(self):
        """The index does not list the track that continues the first."""
        chunks = [
            ("HEAD", f.head()),
            ("TRAK", f.trak()),
            ("DATA", f.cluster((0, 0, 4, f.svarint(1)))),
            ("TRAK", f.trak(continues=0, first=1)),
            ("DATA", f.cluster((1, 4, 4, f.svarint(2)))),
        ]
        offsets, offset = [], 8
        for _, payload, *_ in chunks:
            offsets.append(offset)
            offset += f.HEADER + len(payload)
        entries = [("HEAD", offsets[0], 0, 0), ("TRAK", offsets[1], 0, 0)]
        entries += [("DATA", offsets[2], 0, 4), ("DATA", offsets[4] - 1, 4, 8)]
        ahead = {"entries": entries, "first": 1}
        data = f.closed(*chunks, ahead=ahead, duration_ns=8_000_000)
        with Reader(data) as reader:
            assert len(reader.catalogue.tracks) == 1
            renderer = Renderer(reader, profile_of(), Assignment((Route(0, 0, Fraction(1)),)))
            values, known = joined(renderer.blocks())
            assert len(reader.catalogue.tracks) == 2
        assert values[known].tolist() == [1.0] * 4 + [2.0] * 4


def laid_out(recording, settings, order):
    """The packets of a recording in clusters of one packet each, in another order."""
    made = encode(recording, settings)
    out = io.BytesIO()
    writer = FileWriter(out, level=LEVELS[2], file_id=1)
    writer.describe(made.tracks)
    packets = [Packet(p.track, p.start, p.span, p.data) for p in made.packets]
    packets.sort(key=lambda packet: order(packet, made.tracks[packet.track].kind))
    for packet in packets:
        writer.cluster([packet])
    writer.close()
    return out.getvalue()


ORDERS = {
    "by time": lambda packet, _: (packet.start, packet.track),
    "track after track": lambda packet, _: (packet.track, packet.start),
    "last track first": lambda packet, _: (-packet.track, packet.start),
    "all LF, then all HF": lambda packet, kind: (kind == "hf", packet.start, packet.track),
}


class TestLayouts:
    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize("ahead", [streaming.AHEAD, 100])
    def test_any_order_of_clusters_plays(self, order, ahead, monkeypatch):
        monkeypatch.setattr(streaming, "AHEAD", ahead)
        rng = np.random.default_rng(3)
        channels = [
            Channel(
                rng.integers(-2000, 2001, size).astype(np.int32), Fraction(rate),
                (Span(start, start + size),), MILLI, unit="N",
            )
            for rate, start, size in ((1000, 0, 4000), (1000, 50, 3000), (250, 0, 1000))
        ]  # fmt: skip
        recording = Recording(tuple(channels))
        settings = Settings("paper", bits=8, cluster=Fraction(1, 4), smallest=False)
        data = laid_out(recording, settings, ORDERS[order])
        with Reader(data) as reader:
            want = reader.read()
            routes = tuple(Route(i, i, Fraction(1)) for i in range(3))
            renderer = Renderer(reader, profile_of(3), Assignment(routes))
            for _ in range(2):
                values, known = joined(renderer.blocks())
                for i in range(2):
                    line = want.channels[i].filled(0, 4000)
                    assert known[:, i].tolist() == np.isfinite(line).tolist()
                    assert values[known[:, i], i].tobytes() == line[np.isfinite(line)].tobytes()
                assert known[:, 2].all()
                assert values[::4, 2].tobytes() == want.channels[2].samples().tobytes()
        if order != "by time":
            assert bool(renderer.apart) == (ahead == 100)

    @pytest.mark.compiled
    def test_a_tick_an_hour_beside_a_thousand_a_second(self):
        """The next tick of the slow one lies an hour ahead: the other is not held until then."""
        fast = Channel(
            np.arange(4_000_000, dtype=np.int32), Fraction(1000), calibration=MILLI, unit="N"
        )
        slow = Channel(np.array([1, 3], np.int32), Fraction(1, 3600), calibration=MILLI, unit="N")
        data = file_of(Recording((fast, slow)), Settings.of("lossless", cluster=10))
        with Reader(data) as reader:
            routes = tuple(Route(i, i, Fraction(1)) for i in range(2))
            renderer = Renderer(reader, profile_of(2), Assignment(routes), stop=20)
            blocks = renderer.blocks()
            tracemalloc.start()
            some = [next(blocks) for _ in range(100)]
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert peak < 8 << 20
            values = np.concatenate([block.values for block in some])
            assert all(block.known.all() for block in some)
        assert values[:, 0].tolist() == (np.arange(5000) / 1000).tolist()
        assert (np.diff(values[:, 1]) > 0).all()
        assert abs(values[4999, 1] - (0.001 + 0.002 * 4.999 / 3600)) < 1e-6


class TestExtremes:
    def play(self, channel, **asked):
        device = {key: asked.pop(key) for key in ("rate", "band") if key in asked}
        with Reader(file_of(Recording((channel,)))) as reader:
            profile = profile_of(**device)
            renderer = Renderer(reader, profile, Assignment((Route(0, 0, Fraction(1)),)), **asked)
            return (*joined(renderer.blocks()), renderer)

    def doubles(self, x, rate=1000):
        return Channel(np.asarray(x, np.float64), Fraction(rate), unit="N")

    @pytest.mark.parametrize("rate", [100, 1000, 3001])
    def test_huge_values(self, rate):
        x = np.tile([1.7e308, -1.7e308, 1e300, 5e-324, -0.0], 60)
        values, known, _ = self.play(self.doubles(x), rate=rate)
        assert known.all()
        assert np.isfinite(values).all()
        if rate == 1000:
            assert values[:, 0].tobytes() == x.tobytes()

    @pytest.mark.parametrize("rate", [100, 1000, 3001])
    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_words_that_are_no_number_are_gaps(self, rate, bad):
        x = np.ones(300)
        x[[0, 100, 101, 299]] = bad
        values, known, _ = self.play(self.doubles(x), rate=rate)
        ticks = [n * 1000 // rate for n in range(len(values))]
        assert known[:, 0].tolist() == [np.isfinite(x[tick]) for tick in ticks]
        assert np.abs(values[known] - 1).max() == 0

    @pytest.mark.parametrize("dtype", [np.float16, np.float32, np.int64, np.uint64])
    def test_words(self, dtype):
        x = np.arange(50).astype(dtype)
        values, known, _ = self.play(Channel(x, Fraction(1000), unit="N"))
        assert known.all()
        assert values[:, 0].tolist() == list(range(50))

    def test_what_a_factor_makes_infinite_is_not_known(self):
        with Reader(file_of(Recording((self.doubles([1e300, 1.0]),)))) as reader:
            route = Route(0, 0, Fraction(10) ** 30)
            _, known = joined(Renderer(reader, profile_of(), Assignment((route,))).blocks())
        assert known[:, 0].tolist() == [False, True]

    @pytest.mark.parametrize("speed", [Fraction(1, 100), Fraction(1, 3), 100])
    @pytest.mark.parametrize("rate", [Fraction(1, 3600), 1, 200_000])
    def test_rates_and_speeds(self, rate, speed):
        """A slope stays that slope, at any rate of the channel for a device of 1 kHz."""
        size = 2000
        channel = Channel(
            np.arange(size, dtype=np.int32), Fraction(rate), calibration=Calibration(), unit="N"
        )
        stop = min(Fraction(size, 1) / rate, Fraction(speed) * 2)
        values, known, _ = self.play(channel, stop=stop, speed=speed)
        assert known.all()
        width = max(1, rate * Fraction(speed) / 1000)
        line = np.array([float(n * Fraction(speed) * rate / 1000) for n in range(len(values))])
        assert np.abs(values[:, 0] - np.minimum(line, size - 1)).max() <= 17 * width
        assert (np.diff(values[:, 0]) >= 0).all()

    def test_too_slow_a_device_is_refused(self):
        channel = Channel(
            np.arange(10, dtype=np.int32), Fraction(200_000), calibration=MILLI, unit="N"
        )
        with pytest.raises(ParameterError, match="1048576"):
            self.play(channel, rate=Fraction(1, 100))
        *_, renderer = self.play(channel, rate=10)
        assert renderer.kernels == {"a1": "linear (20000 ticks)"}

    def test_a_gap_of_hours_costs_nothing_to_skip(self):
        late = replace(self.doubles(np.ones(10)), coverage=(Span(10**9, 10**9 + 10),))
        _, known, renderer = self.play(late, start=Fraction(10**6) - 2)
        assert known.sum() == 10
        assert renderer.notes == ["the recording has nothing before 1e+06 s"]


class TestBounded:
    """What playing costs beside the file."""

    def hour(self, count, seconds=3600):
        """Clusters of 10 s, each with the same packets."""
        rng = np.random.default_rng(1)
        channels = [
            Channel(
                np.cumsum(rng.integers(-9, 10, 10_000)).astype(np.int32), Fraction(1000),
                calibration=MILLI, unit="N",
            )
            for _ in range(count)
        ]  # fmt: skip
        made = encode(Recording(tuple(channels)), Settings.of("lossless", cluster=10))
        out = io.BytesIO()
        writer = FileWriter(out, level=LEVELS[2], file_id=1)
        writer.describe(made.tracks)
        for start in range(0, seconds * 1000, 10_000):
            writer.cluster([Packet(p.track, p.start + start, p.span, p.data) for p in made.packets])
        writer.close()
        return out.getvalue()

    @pytest.mark.skipif(compiled is None, reason="minutes without the extension")
    @either("times", (20, 60), deep=(40, 160))
    def test_memory_does_not_grow_with_the_file(self, times):
        peaks = []
        for seconds in times:
            data = self.hour(4, seconds)
            with Reader(data) as reader:
                routes = tuple(Route(i, i, Fraction(1)) for i in range(4))
                renderer = Renderer(reader, profile_of(4), Assignment(routes))
                tracemalloc.start()
                for _ in renderer.blocks():
                    pass
                peaks.append(tracemalloc.get_traced_memory()[1])
                tracemalloc.stop()
        assert peaks[1] < 1.2 * peaks[0] + 200_000
        assert peaks[1] < 4 << 20  # four channels of 10 s as doubles are 320 kB

    def test_an_hour_starts_at_once(self, tmp_path):
        path = tmp_path / "hour.hapf"
        path.write_bytes(self.hour(4))
        begun = time.process_time()
        with Reader(path) as reader:
            routes = tuple(Route(i, i, Fraction(1)) for i in range(4))
            renderer = Renderer(reader, profile_of(4), Assignment(routes), start=1800)
            block = next(renderer.blocks())
            assert reader.catalogue.indexed
        assert block.known.all()
        assert time.process_time() - begun < 2.0 * slowness()
