"""Blocks to packets: what comes out is what went in, or within what was allowed, block by block."""

from __future__ import annotations

import io
from dataclasses import replace
from fractions import Fraction
from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hapfmt
from hapfmt import Calibration, ParameterError, Settings
from hapfmt.deadband import Deadband
from hapfmt.encoder import live
from hapfmt.encoder.encode import encode
from hapfmt.encoder.live import Block, Input, LiveEncoder
from hapfmt.encoder.settings import Tolerance
from hapfmt.format.track import Track
from hapfmt.limits import LAST_TRACK_ID, LEVELS, TICK_LIMIT
from hapfmt.reading.decoder import TrackDecoder
from hapfmt.writing.filewriter import FileWriter

ARCHIVE, FAST = Settings("lossless"), Settings(effort="fast")
COUNTS = Input("torque", 1000, unit="N.m", calibration=Calibration(1, 0, 1000))
FLOATS = Input("force", 1000, unit="N")


def deadband(**given):
    return Settings.of("perceptual", texture=False, felt="all", **given)


class Tape:
    """What an encoder was given and has made, as a file would hold it."""

    def __init__(self, settings=None, *, first_track=0):
        self.encoder = LiveEncoder(settings, first_track=first_track)
        self.tracks: dict[int, Track] = {}
        self.packets = []
        self.level = LEVELS[1]

    def write(self, *blocks):
        self.level = max(
            self.level,
            self.encoder.level(block.input for block in blocks),
            key=lambda level: level.number,
        )
        tracks, packets = self.encoder.encode(blocks)
        for track in tracks:
            assert track.id == self.encoder.next_track - len(tracks) + tracks.index(track)
            assert track.id not in self.tracks
            self.tracks[track.id] = track
        assert packets == sorted(packets, key=lambda p: (p.track, p.start))
        assert sum(p.span for p in packets) == sum(b.values.size for b in blocks)
        self.packets += packets
        return tracks, packets

    def read(self, channel=0):
        """Counts or words, and doubles where they are exact."""
        numbers, exact = [], []
        for packet in self.packets:
            track = self.tracks[packet.track]
            if track.first_channel == channel:
                decoder = TrackDecoder(track, self.level)
                numbers.append(decoder.decode(packet)[:, 0])
                doubles = decoder.decode_exact(packet, numbers[-1][:, None])
                exact.append(None if doubles is None else doubles[:, 0])
        return np.concatenate(numbers), None if exact[0] is None else np.concatenate(exact)


def in_blocks(x, sizes):
    """Pieces of x of these sizes, over and over."""
    at, place = 0, 0
    while at < x.size:
        yield at, x[at : at + sizes[place % len(sizes)]]
        at += sizes[place % len(sizes)]
        place += 1


def recorded(x, given, settings=None, sizes=(100,), channel=0):
    tape = Tape(settings)
    for start, piece in in_blocks(x, sizes):
        tape.write(Block(channel, given, start, piece))
    return tape


def signal(name, size, seed):
    g, t = np.random.default_rng(seed), np.arange(size)
    return {
        "noise": g.integers(-300, 300, size),
        "walk": g.integers(-20, 21, size).cumsum(),
        "steps": g.integers(-3, 4, size // 9 + 1).repeat(9)[:size] * 1000,
        "sine": np.round(20000 * np.sin(t / 9)).astype(np.int64),
        "ends": np.array([-(2**23), 2**23 - 1])[g.integers(0, 2, size)],
        "rest, then taps": (t > size / 2) * (g.random(size) < 0.05) * 30000 + 5,
        "near zero": g.integers(-2, 3, size),
        "constant": np.full(size, 77),
    }[name]


NAMES = "noise", "walk", "steps", "sine", "ends", "rest, then taps", "near zero", "constant"
signals = st.builds(
    signal, st.sampled_from(NAMES), st.sampled_from([1, 2, 40, 333, 700]), st.integers(0, 99)
)
block_sizes = st.lists(st.sampled_from([1, 2, 7, 64, 100, 500]), min_size=1, max_size=3)
int_types = st.sampled_from(["i4", "i8", ">i4", "u4"])
"""As the counts come in; unsigned where none is negative."""


class TestCounts:
    @given(signals, block_sizes, int_types, st.sampled_from([ARCHIVE, FAST]))
    def test_any_blocks_come_back(self, x, sizes, dtype, settings):
        if dtype == "u4":
            x = np.minimum(np.abs(x), 2**23 - 1)
        tape = recorded(x.astype(dtype), COUNTS, settings, sizes)
        assert np.array_equal(tape.read()[0], x)
        assert len(tape.tracks) == 1
        assert tape.tracks[0].contract is None

    def test_many_channels_at_once(self):
        """Of several rates and lengths, two blocks of one channel among them."""
        tape, rows = Tape(), {c: signal("walk", 900, c) for c in range(40)}
        slow = replace(COUNTS, rate=Fraction(100))
        for at in (0, 300, 600):
            blocks = []
            for channel, x in rows.items():
                given = slow if channel % 3 else COUNTS
                cuts = [at, at + 100, at + 300] if channel % 2 else [at, at + 300]
                for start, stop in zip(cuts, cuts[1:], strict=False):
                    blocks.append(Block(channel, given, start, x[start:stop].astype(np.int16)))
            tape.write(*blocks)
        for channel, x in rows.items():
            assert np.array_equal(tape.read(channel)[0], x)

    def test_the_same_blocks_give_the_same_bytes(self):
        x = signal("walk", 3000, 5)
        one, other = recorded(x, COUNTS, sizes=(250,)), recorded(x, COUNTS, sizes=(250,))
        assert one.packets == other.packets
        assert one.tracks == other.tracks

    def test_channels_do_not_know_of_each_other(self):
        """A channel's packets are the same alone and beside others."""
        rows = {c: signal(name, 1200, c) for c, name in enumerate(NAMES[:4])}
        together = Tape()
        for at in range(0, 1200, 200):
            together.write(*(Block(c, COUNTS, at, x[at : at + 200]) for c, x in rows.items()))
        for channel, x in rows.items():
            alone = recorded(x, COUNTS, sizes=(200,), channel=channel)
            mine = [p.data for p in together.packets if p.track == channel]
            assert mine == [p.data for p in alone.packets]

    def test_arrays_of_any_layout(self):
        x = signal("walk", 400, 2).astype(np.int32)
        odd = np.frombuffer(b"\0" + x.tobytes(), np.int32, offset=1)
        table = np.column_stack((x, x))
        assert not odd.flags.aligned
        for values in (odd, table[:, 1], x[::-1][::-1]):
            tape = recorded(values, COUNTS)
            assert np.array_equal(tape.read()[0], x)

    def test_nearly_as_small_as_the_whole_recording(self):
        """Blocks of a second against clusters of a second, each channel for itself."""
        g = np.random.default_rng(0)
        t = np.arange(20_000) / 1000
        rows = [
            np.round(900 * np.sin(t * f) + g.normal(0, noise, t.size)).astype(np.int32)
            for f, noise in ((1.3, 0.6), (7.0, 5.0), (0.2, 0.0), (40.0, 2.0))
        ]
        for settings, more in ((ARCHIVE, 1.015), (FAST, 1.0)):
            live = Tape(settings)
            for start in range(0, t.size, 1000):
                live.write(*(
                    Block(c, COUNTS, start, x[start : start + 1000]) for c, x in enumerate(rows)
                ))  # fmt: skip
            recording = hapfmt.Recording(tuple(
                hapfmt.Channel(x, Fraction(1000), calibration=COUNTS.calibration) for x in rows
            ))  # fmt: skip
            whole = encode(recording, replace(settings, cluster=Fraction(1), references=False))
            size = sum(len(p.data) for p in live.packets)
            assert size <= more * sum(len(p.data) for p in whole.packets)

    def test_a_file_of_them(self, tmp_path):
        stream = io.BytesIO()
        writer, encoder = FileWriter(stream, file_id=1), LiveEncoder()
        x = signal("walk", 3000, 9)
        for at in (0, 1000, 2000):
            tracks, packets = encoder.encode([Block(0, COUNTS, at, x[at : at + 1000])])
            writer.describe(tracks)
            writer.cluster(packets)
        writer.close()
        path = tmp_path / "live.hapf"
        path.write_bytes(stream.getvalue())
        (channel,) = hapfmt.read(path).channels
        assert np.array_equal(channel.stored, x)
        assert (channel.label, channel.unit) == ("torque", "N.m")
        assert channel.calibration == COUNTS.calibration


errors = st.sampled_from(["0.3lsb", "1lsb", "2.5lsb", "40lsb", "0.004"])


class TestLoss:
    @given(signals, block_sizes, errors)
    def test_near_lossless(self, x, sizes, text):
        settings = Settings.of("near-lossless", max_error=text)
        tape = recorded(x, COUNTS, settings, sizes)
        allowed = 4 if text == "0.004" else int(float(text[:-3]))
        assert np.abs(tape.read()[0] - x).max() <= allowed
        (track,) = tape.tracks.values()
        assert (track.contract is None) == (allowed == 0)
        if track.contract:
            assert track.contract.guaranteed
            assert track.contract.floor == (allowed,)

    @given(
        signals,
        block_sizes,
        st.sampled_from(["0.5lsb", "1lsb", "3lsb", "0.02"]),
        st.sampled_from([Fraction(0), Fraction(1, 10), Fraction(1, 3), Fraction(1)]),
        st.sampled_from([Calibration(1, 0, 1000), Calibration(-3, 1, 7), Calibration(1, 10**6, 1)]),
    )
    def test_deadband(self, x, sizes, floor, k, calibration):
        settings = deadband(floor=floor, k=k)
        given = replace(COUNTS, calibration=calibration)
        tape = recorded(x, given, settings, sizes)
        y = tape.read()[0]
        contract = tape.tracks[0].contract
        assert all(track.contract == contract for track in tape.tracks.values())
        assert contract.guaranteed
        band = Deadband(contract.kn, contract.kd, contract.floor, contract.zero)
        assert not band.outside(x, y.astype(np.int64)).any()
        assert Fraction(contract.kn, contract.kd) <= k
        assert contract.floor[0] <= max(1, (20 * calibration.d // 1000 if floor == "0.02" else 3))

    def test_a_deadband_takes_the_smallest_way(self):
        """And another one where the signal becomes another, in a track that continues the first."""
        g, t = np.random.default_rng(3), np.arange(200_000)
        slow = np.abs(t % 8000 - 4000) + g.integers(-4, 5, t.size)
        texture = slow + np.round(900 * np.sin(t / 2)).astype(np.int64)
        settings = deadband(floor="6lsb", k=Fraction(0))
        knots = recorded(slow, COUNTS, settings, (1000,))
        assert [track.codec for track in knots.tracks.values()] == ["KNOT"]
        dense = recorded(texture, COUNTS, settings, (1000,))
        assert [track.codec for track in dense.tracks.values()] == ["LPCR"]
        both = recorded(np.concatenate((slow, texture, slow)), COUNTS, settings, (1000,))
        assert [both.tracks[i].codec for i in range(3)] == ["KNOT", "LPCR", "KNOT"]
        assert [both.tracks[i].continues for i in range(3)] == [None, 0, 1]
        assert [both.tracks[i].first_channel for i in range(3)] == [0, 0, 0]
        starts = {id_: [p.start for p in both.packets if p.track == id_] for id_ in both.tracks}
        assert max(starts[0]) < min(starts[1])
        assert max(starts[1]) < min(starts[2])
        sizes = [sum(len(p.data) for p in tape.packets) for tape in (both, knots, dense)]
        assert sizes[0] < 1.25 * (2 * sizes[1] + sizes[2])

    def test_turns_stay_few(self):
        g, t = np.random.default_rng(3), np.arange(20_000)
        slow = np.abs(t % 8000 - 4000) + g.integers(-4, 5, t.size)
        x = np.concatenate([slow, slow + np.round(900 * np.sin(t / 2)).astype(np.int64)] * 12)
        tape = recorded(x, COUNTS, deadband(floor="6lsb", k=Fraction(0)), (1000,))
        assert 1 < len(tape.tracks) <= 9

    @pytest.mark.parametrize(
        ("given", "kind"),
        [
            (replace(COUNTS, unit="N", quantity="force"), "felt"),
            (replace(COUNTS, unit="m/s2"), "felt"),
            (replace(COUNTS, unit="mm"), "exact"),
            (replace(COUNTS, unit="1", label="seq"), "exact"),
            (replace(COUNTS, unit="s"), "exact"),
            (FLOATS, "felt"),
            (replace(FLOATS, unit="s"), "exact"),
        ],
    )
    def test_perceptual_goes_by_the_quantity(self, given, kind):
        x = signal("walk", 2000, 4)
        x = x if given.takes_counts else x / 7.0
        (track, *_), _ = LiveEncoder(Settings.of("perceptual", texture=False)).encode(
            [Block(0, given, 0, x)]
        )
        assert (track.contract is not None) == (kind == "felt")

    def test_perceptual_with_a_floor_of_the_caller(self):
        settings = Settings.of("perceptual", texture=False, floor="3lsb", max_error="3lsb")
        x = signal("walk", 2000, 4)
        (track,), _ = LiveEncoder(settings).encode([Block(0, replace(COUNTS, unit="mm"), 0, x)])
        assert (track.contract.kn, track.contract.floor) == (0, (3,))
        force = replace(COUNTS, unit="N")
        (track,), _ = LiveEncoder(Settings.of("perceptual", texture=False)).encode(
            [Block(0, force, 0, x)]
        )
        assert (track.contract.kn, track.contract.kd) == (1, 10)
        assert track.contract.floor == (10,)


class TestLsb:
    @given(
        st.lists(st.floats(-500, 500), min_size=1, max_size=60),
        st.sampled_from([0.1, 0.25, 1e-4, 0.3, 20.944e-6 * 5]),
        block_sizes,
    )
    def test_half_a_step_away_at_most(self, x, lsb, sizes):
        x = np.array(x)
        given = replace(FLOATS, lsb=lsb)
        tape = recorded(x, given, None, sizes)
        (track,) = tape.tracks.values()
        (component,) = track.components
        assert float(Fraction(component.calibration.a, component.calibration.d)) == lsb
        declared, largest = component.deviation
        assert 0.5 * lsb <= largest <= declared <= 0.50001 * lsb
        y = Calibration(*component.calibration).physical(tape.read()[0])
        assert np.abs(x - y).max() <= largest

    @given(
        st.lists(st.floats(-30, 30), min_size=1, max_size=60),
        st.sampled_from([0.01, 0.003]),
        st.sampled_from([Fraction(0), Fraction(1, 10)]),
    )
    def test_the_deadband_holds_for_the_source(self, x, lsb, k):
        x, floor = np.array(x), 0.05
        settings = deadband(floor=floor, k=k)
        tape = recorded(x, replace(FLOATS, lsb=lsb), settings, (7,))
        calibration = Calibration(*tape.tracks[0].components[0].calibration)
        for source, count in zip(x.tolist(), tape.read()[0].tolist(), strict=True):
            away = abs(Fraction(source) - calibration.exact(count))
            assert away <= max(k * abs(Fraction(source)), Fraction(floor))

    def test_the_range_is_that_of_the_bits(self):
        given = replace(FLOATS, lsb=0.5, bits=8)
        tape = recorded(np.array([-64.0, 63.5]), given)
        assert tape.read()[0].tolist() == [-128, 127]
        for wrong in (63.75, -64.5, inf, -inf, float("nan")):
            with pytest.raises(ParameterError, match=r"'force'\), tick 12: .* larger lsb"):
                recorded(np.array([1.0] * 12 + [wrong]), given, sizes=(20,))


doubles = st.floats() | st.sampled_from([0.0, -0.0, 5e-324, inf, -inf, 1e308, 0.1, 1 / 3])


class TestFloats:
    @given(st.lists(doubles, min_size=1, max_size=30), block_sizes)
    def test_any_doubles_come_back_bit_for_bit(self, x, sizes):
        tape = recorded(np.array(x), FLOATS, sizes=sizes)
        self.same(tape, np.array(x))

    @staticmethod
    def same(tape, x):
        words, exact = tape.read()
        y = words if exact is None else exact
        assert y.dtype.itemsize == x.dtype.itemsize or exact is not None
        assert y.astype(np.float64).tobytes() == x.astype(np.float64).tobytes()

    @given(signals, block_sizes, st.sampled_from([0.01, 1 / 3, 2.0**-9, 1e-9, 7e11]))
    def test_lattices(self, x, sizes, step):
        self.same(recorded(x * step, FLOATS, sizes=sizes), x * step)

    def test_a_lattice_is_as_small_as_counts(self):
        x = signal("walk", 4000, 1)
        counts = sum(len(p.data) for p in recorded(x, COUNTS, sizes=(1000,)).packets)
        for values in (x * 0.01, x / 1000.0):
            tape = recorded(values, FLOATS, sizes=(1000,))
            assert sum(len(p.data) for p in tape.packets) <= counts + 3 * 4
            self.same(tape, values)

    def test_a_lattice_in_binary32_comes_back(self):
        values = (signal("walk", 4000, 1) * 0.01).astype(np.float32)
        self.same(recorded(values, FLOATS, sizes=(1000,)), values.astype(np.float64))

    def test_noise_takes_less_than_its_words(self):
        x = np.random.default_rng(0).normal(0, 1, 8000).cumsum()
        tape = recorded(x, FLOATS, sizes=(1000,))
        assert tape.tracks[0].codec == "LPCX"
        assert sum(len(p.data) for p in tape.packets) < 0.85 * 8 * x.size

    def test_a_channel_at_rest_first(self):
        x = np.concatenate((np.zeros(1000), signal("walk", 3000, 1) * 0.01))
        tape = recorded(x, FLOATS, sizes=(1000,))
        self.same(tape, x)
        assert tape.tracks[0].codec == "LPCX"
        assert sum(len(p.data) for p in tape.packets) < 0.3 * 8 * 3000

    def test_singles_that_are_noise_stay_words(self):
        g = np.random.default_rng(0)
        x = g.integers(0, 2**31, 4000).astype(np.uint32).view(np.float32)
        x = np.nan_to_num(x, nan=1.0)
        tape = recorded(x, FLOATS, sizes=(1000,))
        assert tape.tracks[0].number_format == "binary32"
        assert tape.read()[0].tobytes() == x.tobytes()
        with pytest.raises(ParameterError, match=r"tick 5: 0.1 is not a binary32"):
            tape.write(Block(0, FLOATS, 4, np.array([1.0, 0.1])))
        tape.write(Block(0, FLOATS, 4, np.array([1.0, 0.5])))

    def test_the_one_correction_without_a_code(self):
        """2^63 places away from the nearest count in the range (SPEC 9.7)."""
        tape = Tape()
        tape.write(Block(0, FLOATS, 0, np.array([1.0])))
        track = tape.tracks[0]
        value = Calibration(*track.components[0].calibration).physical(
            np.array([track.count_max, track.count_min])
        )
        places = value.view(np.int64)
        opposite = (places ^ np.int64(-(2**63))).view(np.float64)
        x = np.concatenate((opposite, -value, np.nextafter(opposite, 0), np.nextafter(-value, inf)))
        tape.write(Block(0, FLOATS, 1, x))
        self.same(tape, np.concatenate(([1.0], x)))

    def test_integers_that_doubles_hold(self):
        self.same(
            recorded(np.array([1, -5, 2**53 - 1]), FLOATS), np.array([1.0, -5.0, 2.0**53 - 1])
        )
        self.same(recorded(np.array([1.5, 2], np.float16), FLOATS), np.array([1.5, 2.0]))
        with pytest.raises(ParameterError, match="integers beyond 2"):
            recorded(np.array([2**53]), FLOATS)


LOSSY = {
    "absolute": Settings.of("near-lossless", max_error="0.01"),
    "coarse": Settings.of("near-lossless", max_error="5"),
    "fine": Settings.of("near-lossless", max_error="1e-9"),
    "range": Settings.of("near-lossless"),
    "force": Settings.of("perceptual", texture=False),
    "all felt": deadband(k=0.5),
    "floor": deadband(floor="0.05"),
}
wild = st.lists(
    st.tuples(st.integers(0, 699), st.sampled_from([inf, -inf, 1e300, -1e9, 9e4, -0.0, 5e-324])),
    max_size=3,
)


class TestFloatsWithinABound:
    """Every sample is within the bound, or the same double."""

    @staticmethod
    def values(tape):
        found = []
        for packet in sorted(tape.packets, key=lambda packet: packet.start):
            track = tape.tracks[packet.track]
            decoder = TrackDecoder(track, tape.level)
            numbers = decoder.decode(packet)
            doubles = decoder.decode_exact(packet, numbers)
            if doubles is None and track.number_format == "counts":
                doubles = Calibration(*track.components[0].calibration).physical(numbers)
            found.append((numbers if doubles is None else doubles)[:, 0])
        return np.concatenate(found).astype(np.float64)

    @staticmethod
    def check(x, y, settings):
        same = x.view(np.int64) == y.view(np.int64)
        finite = [Fraction(value) for value in x[np.isfinite(x)].tolist()]
        extent = max(finite, default=0) - min(finite, default=0)
        k, floor = Fraction(0), settings.max_error
        if settings.preset == "perceptual":
            k, floor = settings.k, settings.floor
            floor = floor or (settings.deadband_floor if settings.felt else Tolerance(0.01))
        amount = Fraction(floor.value) * (extent if floor.kind == "range" else 1)
        for place in np.flatnonzero(~same).tolist():
            a, b = Fraction(float(x[place])), Fraction(float(y[place]))
            assert abs(a - b) <= max(k * abs(a), amount), (place, float(a), float(b))

    @given(
        signals,
        st.sampled_from([1.0, 0.01, 1 / 3000, 1e-9, 7e11]),
        st.sampled_from([0.0, 0.1, 101325.0, -3e7]),
        wild,
        block_sizes,
        st.sampled_from(sorted(LOSSY)),
    )
    def test_law(self, x, step, middle, odd, sizes, name):
        x = x * step + middle
        for place, value in odd:
            x[place % x.size] = value
        self.check(x, self.values(recorded(x, FLOATS, LOSSY[name], sizes)), LOSSY[name])

    @given(signals, signals, st.sampled_from(sorted(LOSSY)), st.sampled_from(sorted(LOSSY)))
    def test_a_track_of_the_file_is_continued(self, x, more, before, after):
        tape = recorded(x * 0.01, FLOATS, LOSSY[before])
        first = max(tape.tracks)
        again = Tape(LOSSY[after], first_track=first + 1)
        again.encoder.known(0, tape.tracks[first])
        again.tracks = dict(tape.tracks)
        again.write(Block(0, FLOATS, x.size, more / 3.0))
        self.check(more / 3.0, self.values(again), LOSSY[after])

    @pytest.mark.parametrize("name", sorted(set(LOSSY) - {"fine"}))
    def test_nearly_as_small_as_the_whole_recording(self, name):
        g, t = np.random.default_rng(1), np.arange(20_000) / 1000
        x = 2 * np.sin(2 * np.pi * 0.7 * t) + 1 + g.normal(0, 0.002, t.size)
        size = sum(len(p.data) for p in recorded(x, FLOATS, LOSSY[name], (1000,)).packets)
        channel = hapfmt.Channel(x, 1000, label="force", unit="N")
        settings = replace(LOSSY[name], cluster=Fraction(1), force_error=name == "coarse")
        whole = sum(len(p.data) for p in encode(hapfmt.Recording([channel]), settings).packets)
        assert size < 1.3 * whole + 200

    def test_the_bound_grows_with_the_range(self):
        """A sensor at rest comes first: a thousandth of its noise is no bound for what follows."""
        g, t = np.random.default_rng(1), np.arange(20_000) / 1000
        x = g.normal(0, 1e-3, t.size) + np.where(t < 2, 0, 5 * np.sin(t) ** 3)
        tape = recorded(x, FLOATS, LOSSY["range"], (1000,))
        assert len(tape.tracks) < 8
        assert sum(len(p.data) for p in tape.packets) < 1.0 * x.size
        self.check(x, self.values(tape), LOSSY["range"])

    def test_states_and_clocks_stay_exact_where_encode_keeps_them(self):
        settings = Settings.of("perceptual", texture=False)
        for values in (np.arange(3000) / 7, np.arange(3000) // 500 % 3 * 0.7):
            x = values.astype(np.float64)
            y = self.values(recorded(x, replace(FLOATS, unit="mm"), settings, (1000,)))
            assert y.tobytes() == x.tobytes()


class TestKnown:
    """What stands in the file already is gone on with."""

    def first(self, x, given, settings=None):
        tape = recorded(x, given, settings, (1000,))
        return tape, tape.tracks[max(tape.tracks)]

    def go_on(self, tape, track, given, x, settings=None, start=None):
        after = Tape(settings, first_track=max(tape.tracks) + 1)
        after.tracks, after.packets = dict(tape.tracks), list(tape.packets)
        after.encoder.known(0, track)
        begin = max(p.stop for p in tape.packets) if start is None else start
        after.write(Block(0, given, begin, x))
        return after

    @pytest.mark.parametrize(
        ("given", "settings", "scale"),
        [
            (COUNTS, ARCHIVE, 1),
            (COUNTS, FAST, 1),
            (COUNTS, Settings.of("near-lossless", max_error="2lsb"), 1),
            (COUNTS, deadband(floor="5lsb"), 1),
            (replace(FLOATS, lsb=0.01), ARCHIVE, 0.01),
            (FLOATS, ARCHIVE, 0.01),
            (FLOATS, ARCHIVE, np.pi),
        ],
    )
    def test_a_track_of_ones_own_serves(self, given, settings, scale):
        x = signal("walk", 3000, 2)
        x = x if scale == 1 else x * scale
        tape, track = self.first(x[:2000], given, settings)
        after = self.go_on(tape, track, given, x[2000:], settings)
        assert after.tracks == tape.tracks
        y, exact = after.read()
        if exact is not None:
            assert exact.tobytes() == x.tobytes()
        elif settings.preset == "lossless":
            assert np.array_equal(y, np.round(x / scale))

    def test_while_its_range_holds_the_counts(self):
        x = np.arange(-100, 100).repeat(5)
        recording = hapfmt.Recording(
            (hapfmt.Channel(x, Fraction(1000), calibration=COUNTS.calibration),)
        )
        coded = encode(recording, ARCHIVE)
        (track,) = coded.tracks
        assert track.count_max == 127
        tape = Tape()
        tape.tracks, tape.packets = {0: track}, coded.packets
        after = self.go_on(tape, track, COUNTS, x)
        assert list(after.tracks) == [0]
        tracks, packets = after.encoder.encode([Block(0, COUNTS, 5000, np.array([128, 5]))])
        assert [(t.id, t.continues, t.count_max) for t in tracks] == [(1, 0, 2**23 - 1)]
        assert [p.track for p in packets] == [1]
        _, packets = after.encoder.encode([Block(0, COUNTS, 5002, np.array([1, 5]))])
        assert [p.track for p in packets] == [1]

    def test_a_range_of_exact_values_too(self):
        x = np.arange(100).repeat(20) / 3
        recording = hapfmt.Recording((hapfmt.Channel(x, Fraction(1000)),))
        coded = encode(recording, ARCHIVE)
        (track,) = coded.tracks
        after = Tape(first_track=1)
        after.tracks, after.packets = {0: track}, coded.packets
        after.encoder.known(0, track)
        tail = np.array([1e6, -1e9, 5.5, inf])
        if track.codec == "LPCX":
            after.write(Block(0, FLOATS, x.size, x[:100]))
            assert list(after.tracks) == [0]
        after.write(Block(0, FLOATS, x.size + 100, tail))
        assert after.read()[1] is not None or track.codec != "LPCX"

    def test_floats_after_counts_without_loss(self):
        """A lattice that encode() found: what leaves it is exact too."""
        x = signal("walk", 2000, 2)
        _, track = self.first(x, COUNTS)
        tail = np.array([0.001, 0.0015, 1 / 3])
        after = Tape(first_track=1)
        after.encoder.known(0, track)
        tracks, _ = after.write(Block(0, FLOATS, 2000, tail))
        assert [(t.codec, t.continues) for t in tracks] == [("LPCX", 0)]
        assert tracks[0].components[0].calibration == track.components[0].calibration
        assert after.read()[1].tobytes() == tail.tobytes()

    def test_other_settings_continue_it(self):
        x = signal("walk", 3000, 2)
        tape, track = self.first(x[:2000], COUNTS, deadband(floor="5lsb"))
        after = self.go_on(tape, track, COUNTS, x[2000:], ARCHIVE)
        new = after.tracks[track.id + 1]
        assert (new.continues, new.contract) == (track.id, None)
        assert np.array_equal(after.read()[0][2000:], x[2000:])
        back = self.go_on(after, new, COUNTS, x[:1000], deadband(floor="5lsb"))
        assert back.tracks[new.id + 1].continues == new.id

    @pytest.mark.parametrize(
        ("given", "why"),
        [
            (replace(COUNTS, rate=Fraction(500)), "its rate"),
            (replace(COUNTS, calibration=Calibration(1, 0, 10)), "its calibration"),
        ],
    )
    def test_what_cannot_be_continued(self, given, why):
        tape, track = self.first(signal("walk", 1000, 1), COUNTS)
        with pytest.raises(ParameterError, match=f"'torque'.* cannot be continued: {why}"):
            self.go_on(tape, track, given, np.array([1]))

    def test_words_are_no_counts(self):
        g = np.random.default_rng(0)
        x = g.integers(0, 2**30, 4000).astype(np.uint32).view(np.float32)
        tape, track = self.first(x, FLOATS)
        after = self.go_on(tape, track, FLOATS, x)
        assert after.tracks == tape.tracks
        with pytest.raises(ParameterError, match="its number format"):
            self.go_on(tape, track, COUNTS, np.array([1]))
        integers = replace(track, number_format="int64")
        with pytest.raises(ParameterError, match="the file has int64"):
            self.go_on(tape, integers, FLOATS, np.array([1.0]))

    def test_shared_tracks_and_bands(self):
        _, track = self.first(signal("walk", 1000, 1), COUNTS)
        encoder = LiveEncoder()
        for wrong in (
            replace(track, kind="lf"),
            replace(track, components=track.components * 2),
            replace(track, first_channel=3),
        ):
            with pytest.raises(ParameterError, match="channel 0 cannot be continued: its track 0"):
                encoder.known(0, wrong)
        encoder.encode([Block(0, COUNTS, 0, np.array([1]))])
        with pytest.raises(ParameterError, match="being recorded"):
            encoder.known(0, track)


class TestRefused:
    @pytest.mark.parametrize("preset", ["perceptual", "paper"])
    def test_presets_that_need_the_whole_recording(self, preset):
        with pytest.raises(ParameterError, match=f"preset {preset} needs the whole recording"):
            LiveEncoder(Settings.of(preset))

    @pytest.mark.parametrize(
        ("settings", "why"),
        [
            (deadband(), "0.2 % of range of 'torque' is not known before the end"),
            (Settings.of("near-lossless", max_error="1%"), "1 % of range of 'torque'"),
            (Settings.of("near-lossless", max_error="1", tolerance="1e-3"), "states its lsb"),
            (Settings.of("near-lossless", max_error="1 mm"), "does not fit a channel in N.m"),
        ],
    )
    def test_amounts(self, settings, why):
        with pytest.raises(ParameterError, match=why):
            LiveEncoder(settings).level([COUNTS])

    def test_an_amount_in_steps_needs_a_step(self):
        with pytest.raises(ParameterError, match=r"'force' has no known step.*: add lsb="):
            LiveEncoder(Settings.of("near-lossless", max_error="2lsb")).level([FLOATS])

    @pytest.mark.parametrize("dtype", ["i2", "i4", "i8", "u8"])
    @pytest.mark.parametrize("settings", [ARCHIVE, FAST, deadband(floor="9lsb")])
    def test_counts_beyond_the_bits(self, dtype, settings):
        """Named by channel and tick; the other blocks may be given again."""
        given = replace(COUNTS, bits=12)
        tape, good = Tape(settings), np.arange(100) * 20
        tape.write(Block(7, given, 0, good.astype(dtype)), Block(8, given, 0, good.astype(dtype)))
        wrong = good.copy()
        wrong[50:] = 2048
        more = Block(9, given, 0, good.astype(dtype))
        message = r"channel 8 \('torque'\), tick 150: the count 2048 is outside the 12 bits"
        with pytest.raises(ParameterError, match=message):
            tape.encoder.encode(
                [Block(7, given, 100, good), Block(8, given, 100, wrong.astype(dtype)), more]
            )
        tracks, packets = tape.encoder.encode([Block(7, given, 100, good), more])
        assert [track.first_channel for track in tracks] == [9]
        assert len(packets) == 2

    @pytest.mark.parametrize(
        ("block", "why"),
        [
            (Block(0, COUNTS, 0, np.zeros(0, np.int32)), "a row of 1 to 65536 samples"),
            (Block(0, COUNTS, 0, np.zeros(65537, np.int32)), "a row of 1 to 65536 samples"),
            (Block(0, COUNTS, 0, np.zeros((2, 2), np.int32)), "a row of 1 to 65536 samples"),
            (Block(0, COUNTS, -1, np.zeros(1, np.int32)), "ticks lie in"),
            (Block(0, COUNTS, TICK_LIMIT, np.zeros(1, np.int32)), "ticks lie in"),
            (Block(0, COUNTS, 0, np.zeros(1)), "takes integer counts, not float64"),
            (Block(0, COUNTS, 0, np.zeros(1, bool)), "takes integer counts, not bool"),
            (Block(0, FLOATS, 0, np.array(["a"])), "takes numbers"),
            (Block(0, FLOATS, 0, np.zeros(1, np.longdouble)), "takes numbers"),
            (Block(0, replace(FLOATS, lsb=1.0), 0, np.array([None])), "takes numbers"),
            (Block(0, replace(FLOATS, lsb=1e300), 0, np.zeros(1)), "is not a fraction of integers"),
            (
                Block(0, replace(FLOATS, lsb=1e-300), 0, np.zeros(1)),
                "is not a fraction of integers",
            ),
            (Block(0, replace(COUNTS, rate=Fraction(1, 2**40)), 0, np.zeros(1, int)), "32 bits"),
            (
                Block(
                    0, replace(COUNTS, calibration=Calibration(2**40, 0, 1)), 0, np.zeros(1, int)
                ),
                "above 2.53",
            ),
        ],
    )
    def test_blocks(self, block, why):
        with pytest.raises(ParameterError, match=why):
            LiveEncoder().encode([block])

    def test_more_tracks_than_a_file_has(self):
        encoder = LiveEncoder(first_track=LAST_TRACK_ID)
        encoder.encode([Block(0, COUNTS, 0, np.array([1]))])
        with pytest.raises(ParameterError, match="at most 65534 tracks"):
            encoder.encode([Block(1, COUNTS, 0, np.array([1]))])


class TestLevel:
    @pytest.mark.parametrize(
        ("given", "settings", "level"),
        [
            (COUNTS, ARCHIVE, 1),
            (replace(COUNTS, bits=25), ARCHIVE, 2),
            (replace(COUNTS, bits=32), deadband(floor="3lsb"), 2),
            (
                replace(COUNTS, calibration=Calibration(1, 2**23, 1)),
                deadband(floor=5),
                1,
            ),
            (
                replace(COUNTS, calibration=Calibration(1, 2**26, 1)),
                deadband(floor=5),
                2,
            ),
            (FLOATS, ARCHIVE, 1),
            (replace(FLOATS, lsb=1e-6), ARCHIVE, 1),
        ],
    )
    def test_the_lowest_that_holds_the_input(self, given, settings, level):
        assert LiveEncoder(settings).level([given]).number == level

    def test_of_none(self):
        assert LiveEncoder().level([]).number == 1

    @pytest.mark.parametrize("settings", [ARCHIVE, FAST, deadband(floor="3lsb")])
    def test_32_bits(self, settings):
        x = np.array([-(2**31), 2**31 - 1] * 40)
        tape = recorded(x, replace(COUNTS, bits=32), settings, (16,))
        contract = tape.tracks[0].contract
        away = np.abs(tape.read()[0] - x).max()
        assert away == 0 if contract is None else away <= 2**31 // 10


class TestDescribed:
    """Tracks without packets: before the first sample, and of channels that never had one."""

    @pytest.mark.parametrize("settings", [ARCHIVE, Settings.of("near-lossless", max_error="1lsb")])
    def test_before_the_first_sample(self, settings):
        encoder = LiveEncoder(settings)
        (track,) = encoder.begin({3: COUNTS})
        assert (track.id, track.first_channel) == (0, 3)
        tracks, packets = encoder.encode([Block(3, COUNTS, 0, np.array([5, 6]))])
        assert tracks == []
        assert [packet.track for packet in packets] == [0]

    def test_what_depends_on_samples_waits_for_them(self):
        encoder = LiveEncoder(deadband(floor="0.003", k=Fraction(0)))
        assert encoder.begin({3: COUNTS, 4: FLOATS}) == []
        x = np.round(900 * np.sin(np.arange(1000) / 2)).astype(np.int64)
        tracks, packets = encoder.encode([Block(3, COUNTS, 0, x), Block(4, FLOATS, 0, x / 3)])
        assert [(t.codec, t.first_channel) for t in tracks] == [("LPCR", 3), ("LPCR", 4)]
        assert [packet.track for packet in packets] == [0, 1]

    @pytest.mark.parametrize("settings", [ARCHIVE, deadband(floor="0.003")])
    def test_channels_without_a_sample(self, settings):
        encoder = LiveEncoder(settings)
        encoder.encode([Block(1, COUNTS, 0, np.array([5, 6]))])
        tracks = encoder.silent({0: COUNTS, 2: FLOATS, 3: replace(FLOATS, lsb=0.5)})
        assert [(t.id, t.first_channel) for t in tracks] == [(1, 0), (2, 2), (3, 3)]
        assert [t.continues for t in tracks] == [None] * 3


def test_a_contract_that_does_not_hold_is_no_packet(monkeypatch):
    """What the decoder makes of every lossy packet is compared with the samples."""
    monkeypatch.setattr(live, "nearest", lambda x, grid: x // grid.step + 1)
    settings = Settings.of("near-lossless", max_error="2lsb")
    with pytest.raises(AssertionError, match="left it"):
        recorded(signal("walk", 100, 1), COUNTS, settings)
