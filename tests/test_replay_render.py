"""docs/spec/players.md: from a recording to the values that a device is to get."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
import strategies
from hypothesis import assume, given
from hypothesis import strategies as st
from rendering import SHAPES, expected, file_of, joined, profile_of, runs_of

from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.errors import ParameterError
from hapfmt.reading.decoder import TrackDecoder
from hapfmt.reading.reader import Reader
from hapfmt.recording import Span
from hapfmt.replay.render import Assignment, Position, Renderer, Route, assign

MILLI = Calibration(1, 0, 1000)
ALL = {"N": 1.0, "1": 1.0, "m/s2": 1.0, "{raw(0-255)}": 1.0}
SPLIT = Settings.of("paper", k=Fraction(1, 10), bits=8, cluster=Fraction(1), smallest=False)


def ramp(ticks=5000, rate=1000, **described):
    counts = ((np.arange(ticks) * 37) % 4001 - 2000).astype(np.int32)
    return Channel(counts, Fraction(rate), calibration=MILLI, unit="N", **described)


def rendered(data, profile, **asked):
    with Reader(data) as reader:
        return joined(
            Renderer(reader, profile, assign(reader, profile, by_order=True), **asked).blocks()
        )


WIDEST = 200
"""Ticks for a sample of the device: the reference adds up 32 times as many, one by one."""


class TestEverySampleIsWhatThePageSays:
    @strategies.idle_settings
    @given(
        strategies.recordings(),
        strategies.encoder_settings(),
        st.sampled_from(["full", "lf", "hf"]),
        st.sampled_from(
            [Fraction(1000), Fraction(333), Fraction(50), Fraction(10_000), Fraction(44100, 7)]
        ),
        st.sampled_from([Fraction(1), Fraction(7, 5), Fraction(1, 100), Fraction(100)]),
        st.data(),
    )
    def test_values_and_coverage(self, recording, settings, band, rate, speed, data):
        """
        PLY-009: For sample n of a replay a player MUST send the value of the channel at `start + n * speed / rate` seconds of the recording. Here rate is that of the device; the time is an exact rational number. It treats the channel as known at a time t exactly where it covers tick `floor(t * rate)` with a finite value; here rate is that of the channel.
        """
        assume(any(channel.stored.size for channel in recording.channels))
        widest = max(channel.rate_exact for channel in recording.channels) * speed / rate
        assume(widest <= WIDEST)
        file = file_of(recording, settings)
        step = speed / rate
        edges = [
            edge / c.rate_exact for c in recording.channels for span in c.coverage for edge in span
        ]
        start = data.draw(st.sampled_from(edges)) - data.draw(st.integers(0, 40)) * step
        start = max(start, Fraction(0))
        count = data.draw(st.integers(1, 60))
        near = 40 * max(step, Fraction(1, 50))  # more than any kernel is wide
        with Reader(file) as reader:
            want = [
                runs_of(channel)
                for channel in reader.read(
                    start=start - near, stop=start + count * step + near, band=band
                ).channels
            ]
            profile = profile_of(len(want), rate=rate, band=band, accepts=ALL)
            routes = tuple(Route(i, i, Fraction(1)) for i in range(len(want)))
            renderer = Renderer(
                reader, profile, Assignment(routes), start, start + count * step, speed
            )
            renderer.block_samples = data.draw(st.sampled_from([1, 7, 1000]))
            values, known = joined(renderer.blocks())
            renderer.block_samples = data.draw(st.integers(1, 70))
            again, known_again = joined(renderer.blocks())
        assert known.tolist() == known_again.tolist()
        assert values.tobytes() == again.tobytes()
        assert len(values) <= count
        for i, runs in enumerate(want):
            own = recording.channels[i].rate_exact
            for n in range(len(values)):
                found = expected(runs, SHAPES[band], own * step, (start + n * step) * own)
                assert known[n, i] == (found is not None)
                if found is not None:
                    assert abs(values[n, i] - found[0]) <= found[1]

    @strategies.idle_settings
    @given(strategies.recordings(), strategies.encoder_settings(), st.sampled_from(["full", "lf"]))
    def test_at_the_same_rate_samples_pass_bit_for_bit(self, recording, settings, band):
        channels = [c for c in recording.channels if c.stored.size]
        assume(channels)
        for place, channel in enumerate(channels):
            first = max(channel.start_tick - 3, 0)
            ticks = min(channel.stop_tick - first, 400)
            with Reader(file_of(Recording(tuple(channels)), settings)) as reader:
                want = reader.read(place, band=band).channels[0].filled(first, first + ticks)
                profile = profile_of(rate=channel.rate_exact, band=band)
                renderer = Renderer(
                    reader,
                    profile,
                    Assignment((Route(place, 0, Fraction(1)),)),
                    first / channel.rate_exact,
                    (first + ticks) / channel.rate_exact,
                )
                values, known = joined(renderer.blocks())
            assert known[:, 0].tolist() == np.isfinite(want).tolist()
            assert values[known].tobytes() == want[np.isfinite(want)].tobytes()

    def test_nothing_adds_up_over_ten_hours(self):
        """44.1 kHz / 7 for 1 kHz at 1.1 times the speed; both ends of a span in the tenth hour."""
        rate, speed = Fraction(44_100, 7), Fraction(11, 10)
        first = int(36_000 * rate)
        channel = Channel(
            np.arange(20_000, dtype=np.int32), rate, (Span(first, first + 20_000),), MILLI, unit="N"
        )
        values, known = rendered(
            file_of(Recording((channel,))), profile_of(), start=35_999, speed=speed
        )
        places = [(35_999 + n * speed / 1000) * rate - first for n in range(len(values))]
        inside = [0 <= place < 20_000 for place in places]
        assert known[:, 0].tolist() == inside
        line = [float(place) / 1000 for place, yes in zip(places, inside, strict=True) if yes]
        assert np.abs(values[known] - line)[20:-20].max() < 1e-6
        # In float64 seconds from the start the places would be wrong by 2^-38 s = 23 ns here.

    @pytest.mark.parametrize("band", ["full", "lf"])
    @pytest.mark.parametrize("rate", [100, 999, 1000, 4000])
    def test_no_force_before_the_touch_and_none_beyond_it(self, band, rate):
        """
        PLY-011: Between two ticks of an LF or full-band track a player MUST stay within the range of the ticks less than w away. No gap lies between these ticks.
        """
        counts = np.zeros(4000, np.int32)
        counts[1500:2500] = 3300
        channel = Channel(counts, Fraction(1000), calibration=MILLI, unit="N")
        values, known = rendered(file_of(Recording((channel,))), profile_of(rate=rate, band=band))
        assert known.all()
        width = max(1, -(-1000 // rate)) / 1000
        times = np.arange(len(values)) / rate
        assert not values[times <= 1.5 - width].any()
        assert (values[(times >= 1.5 + width) & (times < 2.5 - width)] == 3.3).all()
        assert values.min() == 0
        assert values.max() == 3.3

    @given(st.integers(1, 400), st.integers(0, 3), st.sampled_from([400, 1000, 3000]))
    def test_nothing_comes_across_a_gap(self, size, missing, rate):
        """A gap of a tick or none between 0 and 1 N: what lies before it stays exactly 0."""
        counts = np.repeat(np.array([0, 1000], np.int32), size)
        spans = (Span(0, size), Span(size + missing, 2 * size + missing))
        coverage = spans if missing else ()
        channel = Channel(counts, Fraction(1000), coverage, MILLI, unit="N")
        values, known = rendered(file_of(Recording((channel,))), profile_of(rate=rate))
        places = [Fraction(n * 1000, rate) for n in range(len(values))]
        if missing:
            before = np.array([place < size for place in places])
            assert known[:, 0].tolist() == [not size <= place < size + missing for place in places]
            assert not values[before & known[:, 0]].any()
            assert (values[~before & known[:, 0]] == 1).all()
        assert values.min() >= 0
        assert values.max() <= 1


class TestOnlyWhatIsPlayedIsDecoded:
    @pytest.fixture
    def decoded(self, monkeypatch):
        """Track ids of the decoders made, and of the packets decoded."""
        seen = {"decoders": [], "packets": []}
        decoding, making = TrackDecoder.decode, TrackDecoder.__init__

        def count(self, packet):
            seen["packets"].append(packet.track)
            return decoding(self, packet)

        def made(self, track, *rest):
            seen["decoders"].append(track.id)
            making(self, track, *rest)

        monkeypatch.setattr(TrackDecoder, "decode", count)
        monkeypatch.setattr(TrackDecoder, "__init__", made)
        return seen

    def split_file(self):
        generator = np.random.default_rng(1)
        channels = [
            replace(
                ramp(3000),
                label=label,
                stored=generator.integers(-2000, 2000, 3000).astype(np.int32),
            )
            for label in "ABC"
        ]
        return file_of(Recording(tuple(channels)), SPLIT)

    @pytest.mark.parametrize(
        ("band", "kinds"), [("lf", {"lf"}), ("hf", {"hf"}), ("full", {"lf", "hf"})]
    )
    def test_bands(self, band, kinds, decoded):
        """A device of LF only never decodes an HF track."""
        file = self.split_file()
        for seen in decoded.values():
            seen.clear()  # the encoder decodes what it made
        with Reader(file) as reader:
            tracks = dict(reader.catalogue.tracks)
            assert {track.kind for track in tracks.values()} == {"lf", "hf"}
            profile = profile_of(2, band=band)
            assignment = assign(reader, profile, ["B=1", "C=a2"])
            values, known = joined(Renderer(reader, profile, assignment).blocks())
            want = reader.read(["B", "C"], band=band).channels
        played = {id_ for id_, track in tracks.items() if track.kind in kinds}
        played &= {part.id for ref in reader.select(["B", "C"]) for part in ref.tracks}
        clusters = 3
        count = len(decoded["packets"]) - len(played) * clusters
        assert count == len(played) * clusters  # once to play them, once for ``want``
        assert set(decoded["packets"]) == set(decoded["decoders"]) == played
        assert known.all()
        for i, channel in enumerate(want):
            assert values[:, i].tobytes() == channel.samples().tobytes()

    def test_a_part_of_an_hour(self, decoded):
        """Neither what lies before nor what lies far behind it."""
        file = file_of(Recording((ramp(100_000),)), Settings.of("lossless", cluster=1))
        decoded["packets"].clear()
        with Reader(file) as reader:
            profile = profile_of()
            blocks = Renderer(
                reader, profile, assign(reader, profile, by_order=True), start=50
            ).blocks()
            first = next(blocks)
            assert len(decoded["packets"]) <= 2
            assert first.known.all()
            assert reader.catalogue.indexed
            joined([first, *blocks])
        assert len(decoded["packets"]) <= 52


class TestLoops:
    def test_two_ramps_without_signal_between_two_times(self):
        channel = ramp(200)
        with Reader(file_of(Recording((channel,)))) as reader:
            profile = profile_of(ramp_s=0.03)
            renderer = Renderer(reader, profile, assign(reader, profile, by_order=True), loops=3)
            values, known = joined(renderer.blocks())
            assert [(k.any(), k.all()) for k in (known[:200], known[200:260])] == [
                (True, True),
                (False, False),
            ]
            assert len(values) == 3 * 200 + 2 * 60
            for loop in range(3):
                at = loop * 260
                assert values[at : at + 200, 0].tobytes() == channel.samples().tobytes()
                assert renderer.position(at + 7) == Position(loop, Fraction(7, 1000))
                assert renderer.position(at + 230) == Position(loop, None)

    def test_for_ever(self):
        with Reader(file_of(Recording((ramp(20),)))) as reader:
            profile = profile_of()
            renderer = Renderer(reader, profile, assign(reader, profile, by_order=True), loops=0)
            blocks = renderer.blocks()
            some = [next(blocks) for _ in range(200)]
            assert not any(block.last for block in some)
            assert sum(block.known.all() for block in some if len(block.known) == 20) > 20
            blocks.close()

    def test_a_seek_goes_on_in_its_loop(self):
        channel = ramp(1000)
        with Reader(file_of(Recording((channel,)))) as reader:
            profile = profile_of()
            renderer = Renderer(reader, profile, assign(reader, profile, by_order=True), loops=3)
            blocks = list(renderer.blocks(5000, 2, Fraction(9, 10), 1))
            assert {block.generation for block in blocks} == {2}
            values, known = joined(blocks)
            assert blocks[0].first == 5000
            assert len(values) == 100 + 100 + 1000
            assert values[:100, 0].tobytes() == channel.samples()[900:].tobytes()
            assert renderer.position(5099) == Position(1, Fraction(999, 1000))
            assert renderer.position(5200) == Position(2, Fraction(0))
            assert not known[100:200].any()

    @pytest.mark.parametrize(("start", "stop"), [(3, 3), (3, 2), (99, None), (0, 0)])
    @pytest.mark.parametrize("loops", [0, 1, 4])
    def test_of_nothing(self, start, stop, loops):
        with Reader(file_of(Recording((ramp(1000),)))) as reader:
            profile = profile_of()
            renderer = Renderer(
                reader, profile, assign(reader, profile, by_order=True), start, stop, loops=loops
            )
            (block,) = renderer.blocks()
            assert block.last
            assert block.values.shape == (0, 1)

    def test_impossible_wishes(self):
        with Reader(file_of(Recording((ramp(10),)))) as reader:
            profile = profile_of()
            for wish in ({"speed": 0}, {"speed": -1}, {"loops": -1}):
                with pytest.raises(ParameterError):
                    Renderer(reader, profile, assign(reader, profile, by_order=True), **wish)
