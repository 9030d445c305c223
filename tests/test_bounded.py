"""Lossless, an absolute bound, a deadband: what is promised holds for any signal."""

from __future__ import annotations

import io
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import recordings

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.codecs.grids import LpcParameters
from hapfmt.deadband import Deadband
from hapfmt.encoder.bounded import likely_ways, scalar_ways, vector_ways
from hapfmt.encoder.encode import choose_level, encode
from hapfmt.encoder.gridded import nearest_level
from hapfmt.encoder.plan import Promise
from hapfmt.encoder.settings import Tolerance, amount
from hapfmt.encoder.source import InputBlock, cut, make_track
from hapfmt.encoder.unit import at_most, bound_of, decode_all
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import TrackDecoder


def shapes(size, seed):
    """Awkward signals of ``size`` counts."""
    g = np.random.default_rng(seed)
    t = np.arange(size)
    return {
        "noise": g.integers(-300, 300, size),
        "walk": g.integers(-20, 21, size).cumsum(),
        "steps": g.integers(-3, 4, size // 9 + 1).repeat(9)[:size] * 1000,
        "ramps": np.abs(t % 80 - 40) * 25 - 300,
        "sine": np.round(20000 * np.sin(t / 9)).astype(np.int64),
        "ends": np.array([-(2**31), 2**31 - 1])[g.integers(0, 2, size)],
        "taps": (g.random(size) < 0.02) * 30000 + g.integers(-1, 2, size),
        "near zero": g.integers(-2, 3, size),
    }


signals = st.builds(
    lambda name, size, seed: shapes(size, seed)[name],
    st.sampled_from(sorted(shapes(1, 0))),
    st.sampled_from([1, 2, 3, 150, 400]),
    st.integers(0, 2**32),
)
webers = st.sampled_from(
    [Fraction(0), Fraction(1, 10), Fraction(1, 100), Fraction(1), Fraction(9, 10),
     Fraction(314159265, 10**9), Fraction(1, 10**6)]
)  # fmt: skip
floors = st.sampled_from(["0.5lsb", "1lsb", "20lsb", "1.5lsb", "1%", "100%", "1e9"]).map(
    Tolerance.parse
)
calibrations = st.sampled_from(
    [Calibration(1, 0, 1000), Calibration(-3, 1, 7), Calibration(1, 10**8, 1),
     Calibration(1, -(10**12), 1000)]
)  # fmt: skip


def channel(counts, calibration, **described):
    return Channel(
        np.asarray(counts), Fraction(1000), calibration=calibration, unit="N", **described
    )


def encoded(recording, settings):
    stream = io.BytesIO()
    hapfmt.write(recording, stream, settings, canonical=3)
    return stream.getvalue()


def assert_intact(recording, settings):
    """The recording as it comes back; every guarantee checked against the original."""
    data = encoded(recording, settings)
    report = hapfmt.verify(data, against=recording)
    assert report.verdict == "intact", (report.error, report.findings)
    assert not any(check.outside for check in report.contracts if check.contract)
    return hapfmt.read(data)


class TestArchive:
    @given(recordings())
    def test_any_recording_comes_back(self, recording):
        back = assert_intact(recording, Settings.of("lossless"))
        for before, after in zip(recording.channels, back.channels, strict=True):
            assert after.coverage == before.coverage
            assert after.samples().tobytes() == before.samples().tobytes()

    @given(signals, calibrations)
    def test_counts_come_back(self, x, calibration):
        back = assert_intact(Recording((channel(x, calibration),)), Settings.of("lossless"))
        assert back.channels[0].stored.tolist() == x.tolist()

    def test_everything_is_predicted(self):
        made = encode(
            Recording((channel(shapes(99, 1)["noise"], Calibration()),)), Settings.of("lossless")
        )
        assert [(t.codec, d.exact) for t, d in zip(made.tracks, made.decisions, strict=True)] == [
            ("LPCR", True)
        ]


def deadband(k, floor):
    return Settings.of("perceptual", texture=False, felt="all", smallest=False, k=k, floor=floor)


class TestNearLossless:
    @given(
        signals, calibrations, st.sampled_from(["0.5lsb", "1lsb", "7lsb", "10%", "1e12", "0.003"])
    )
    def test_never_beyond_the_error(self, x, calibration, text):
        force = not text.endswith("%")
        settings = Settings.of("near-lossless", max_error=text, force_error=force, smallest=False)
        recording = Recording((channel(x, calibration),))
        y = assert_intact(recording, settings).channels[0].stored.astype(np.int64)
        error = Tolerance.parse(text)
        allowed = {
            "lsb": Fraction(error.value),
            "range": Fraction(error.value) * int(np.ptp(x)),
            "unit": Fraction(error.value) / abs(calibration.step),
        }.get(error.kind, Fraction(error.value) / abs(calibration.step))
        assert int(np.abs(x - y).max()) <= allowed

    def test_a_thousandth_of_the_range_unless_told(self):
        assert Settings.of("near-lossless").max_error == Tolerance(0.001, "range")
        with pytest.raises(hapfmt.ParameterError, match="requires preset near-lossless or percep"):
            Settings.of("lossless", max_error="1lsb")

    def test_below_one_count_is_lossless(self):
        recording = Recording((channel([1, 5, 2], Calibration()),))
        made = encode(recording, Settings.of("near-lossless", max_error="0.9lsb"))
        assert made.decisions[0].exact and made.tracks[0].contract is None


@given(st.fractions(0, 65535))
def test_a_weber_fraction_of_16_bits_is_never_larger(k):
    ratio = at_most(k)
    assert ratio <= k and max(ratio.numerator, ratio.denominator) < 1 << 16
    assert k - ratio <= max(Fraction(1, 65535), k / 5000, k * k / 65535)


class TestDeadband:
    @given(signals, calibrations, webers, floors)
    def test_no_sample_outside(self, x, calibration, k, floor):
        """DBC-002: With flag *guaranteed*, every sample MUST keep the contract: for each component `|x - y| * kd <= max(kn * |x - zero|, floor * kd)`. The vector form is the same with Euclidean norms over the components, compared by their squares, and the floor of the first component. A verifier that is given x checks this with exact arithmetic. It reports the number of samples outside and the worst ratio of the left side to the right."""
        settings = deadband(k, floor)
        recording = Recording((channel(x, calibration),))
        y = assert_intact(recording, settings).channels[0].stored.astype(np.int64)
        band = Deadband.from_physical(at_most(k), 1, [calibration])
        whole = {"lsb": floor.value, "range": floor.value * int(np.ptp(x))}.get(
            floor.kind, floor.value / float(abs(calibration.step))
        )
        wide = Deadband(band.kn, band.kd, (max(min(int(whole), 2**31 - 1), 1),), band.zero)
        assert not wide.outside(x, y).any()

    @given(signals, calibrations, webers, floors)
    def test_every_way_keeps_it_and_can_be_read(self, x, calibration, k, floor):
        """Also the ways that lost by size."""
        one = channel(x, calibration)
        spans = tuple(cut(one.coverage, one.rate, Fraction(10), 1))
        source = InputBlock((one,), x[:, None].astype(np.int64), spans)
        bound = bound_of(source, Promise(amount(floor), k))
        base = make_track(source.channels, 0, codec="KNOT", count_min=-(2**31),
                          count_max=2**31 - 1)  # fmt: skip
        for why, way in scalar_ways(source, bound):
            if (coded := way(base, None)) is None:
                assert why == "fewest lines"
                continue
            decoder = TrackDecoder(coded.track, LEVELS[2])
            y = np.concatenate([decoder.decode(packet) for packet in coded.packets])
            assert not bound.band.outside(source.counts, y.astype(np.int64)).any()
            if not bound.slack:
                weber = np.abs(x - bound.band.zero[0]) * bound.band.kn // bound.band.kd
                assert (np.abs(x - y[:, 0]) <= weber).all()

    @pytest.mark.parametrize("name", ["noise", "walk", "ramps", "sine", "taps"])
    @pytest.mark.parametrize("k", [Fraction(0), Fraction(1, 10)])
    def test_the_likely_ways_hold_the_smallest(self, name, k):
        x = shapes(9000, 3)[name]
        one = channel(x, Calibration(1, 0, 1000))
        source = InputBlock((one,), x[:, None].astype(np.int64), one.coverage)
        bound = bound_of(source, Promise(Tolerance.parse("1%"), k))
        base = make_track(source.channels, 0, codec="KNOT", count_min=-(2**31),
                          count_max=2**31 - 1)  # fmt: skip
        every = {why: way(base, None).size for why, way in scalar_ways(source, bound)}
        likely = [why for why, _ in likely_ways(source, base, bound, knots_alone=False)]
        assert min(every[why] for why in likely) <= 1.02 * min(every.values())
        assert len(likely) < len(every)

    @given(st.integers(0, 2**32), webers, floors, st.sampled_from(["noise", "walk", "near zero"]))
    def test_vectors(self, seed, k, floor, name):
        axes = tuple(
            channel(shapes(200, seed + i)[name], Calibration(1, 0, 1000), axis=a, group="tip")
            for i, a in enumerate("xyz")
        )
        assert_intact(Recording(axes), deadband(k, floor))

    @given(
        st.integers(0, 2**32),
        webers,
        floors,
        st.sampled_from(sorted(shapes(1, 0))),
        st.integers(2, 4),
        st.sampled_from([1, 2, 40, 300]),
    )
    def test_every_way_of_a_vector(self, seed, k, floor, name, width, size):
        calibration = Calibration(1, 5, 1000)
        axes = tuple(channel(shapes(size, seed + i)[name], calibration) for i in range(width))
        rows = np.column_stack([axis.stored for axis in axes]).astype(np.int64)
        source = InputBlock(
            axes, rows, tuple(cut(axes[0].coverage, axes[0].rate, Fraction(10), width))
        )
        bound = bound_of(source, Promise(amount(floor), k))
        base = make_track(source.channels, 0, codec="KNOT", count_min=-(2**31),
                          count_max=2**31 - 1)  # fmt: skip
        for _, way in vector_ways(source, bound):
            y = decode_all(way(base, None), width)
            assert not bound.band.outside(rows, y).any()

    def test_levels_beyond_all_counts(self):
        """The only level near a count may be one that no knot may have: no lines then."""
        x = np.random.default_rng(1).integers(2**31 - 2**28, 2**31, 300)
        one = channel(x.astype(np.int32), Calibration(1, 2**31, 1000))
        for floor in ("2500lsb", "2800lsb", "3100lsb"):
            assert_intact(Recording((one,)), deadband(Fraction(9, 10), floor))

    def test_vectors_need_few_knots(self):
        """A turning force: one clock for its axes, lines where it moves evenly."""
        t = np.arange(2000)
        rows = np.column_stack([np.round(9000 * np.sin(t / 150 + turn)) for turn in (0, 1, 2)])
        axes = tuple(channel(row.astype(np.int64), Calibration(1, 0, 1000)) for row in rows.T)
        spans = tuple(cut(axes[0].coverage, axes[0].rate, Fraction(10), 3))
        source = InputBlock(axes, rows.astype(np.int64), spans)
        bound = bound_of(source, Promise(amount("0.5%"), Fraction(1, 10)))
        base = make_track(source.channels, 0, codec="KNOT", count_min=-(2**31),
                          count_max=2**31 - 1)  # fmt: skip
        plain, held, lines = [way(base, None).size for _, way in vector_ways(source, bound)]
        assert lines < held < plain
        assert held < 0.5 * plain

    @given(recordings(), webers, floors)
    def test_any_recording(self, recording, k, floor):
        assert_intact(recording, deadband(k, floor))

    @pytest.mark.parametrize(("offset", "level"), [(2**24 - 400, 1), (2**25, 2)])
    def test_a_grid_far_from_zero_needs_level_2(self, offset, level):
        """Levels are counted from the physical 0."""
        source = InputBlock((channel(shapes(40, 5)["noise"], Calibration(1, offset, 1)),),
                        shapes(40, 5)["noise"][:, None], ())  # fmt: skip
        track = make_track(source.channels, 0, codec="LPCR", count_min=-300, count_max=300)
        grid = LpcParameters(9, -offset, 1, 10)
        chosen = choose_level([replace(track, parameters=grid.build())])
        assert chosen.number == level
        farthest = nearest_level(np.array([300]), grid)
        assert (farthest <= grid.index_limit(LEVELS[1].count_bound)) == (level == 1)


def test_near_lossless_counts_the_deviation_of_the_lattice():
    x = np.random.default_rng(1).normal(size=900)
    recording = Recording((Channel.from_physical(x, 1000, unit="N"),))
    settings = Settings.of("near-lossless", max_error="0.01", tolerance="0.004")
    stream = io.BytesIO()
    hapfmt.write(recording, stream, settings, canonical=1)
    back = hapfmt.read(stream.getvalue()).channels[0]
    assert back.deviation is not None and back.deviation.largest > 0.001
    assert np.abs(back.samples() - x).max() <= 0.01


class TestExactBound:
    """A contract holds for exact values. In binary64 a difference may exceed it by rounding."""

    @given(
        st.integers(0, 2**32),
        st.sampled_from([Fraction(1, 1000), Fraction(12207, 10**7), Fraction(1, 10**9)]),
        st.sampled_from([0, Fraction(1, 20), Fraction(1, 5)]),
        st.sampled_from([Fraction(1, 1000), Fraction(1, 50), Fraction(3, 10)]),
    )
    @settings(max_examples=25, deadline=None)
    def test_any_counts(self, seed, step, k, floor):
        rng = np.random.default_rng(seed)
        x = np.cumsum(rng.normal(size=500)) * 0.02 + rng.normal(size=500) * 0.01
        grid = Calibration(step.numerator, int(rng.integers(0, step.numerator)), step.denominator)
        counts = np.rint(x.clip(-2, 2) / float(step)).astype(np.int32)
        given = Channel(counts, 1000, calibration=grid, unit="N", label="x")
        options = {"preset": "near-lossless", "max_error": float(floor), "force_error": True}
        if k:
            options = {"preset": "perceptual", "texture": False, "k": k, "floor": float(floor)}
        stream = io.BytesIO()
        hapfmt.write(Recording((given,)), stream, smallest=False, **options)
        back = hapfmt.read(stream.getvalue())[0]
        assert back.calibration is not None
        for count, other in zip(counts.tolist(), back.stored.tolist(), strict=True):
            exact = grid.exact(count)
            allowed = max(k * abs(exact), Fraction(float(floor)))
            assert abs(back.calibration.exact(other) - exact) <= allowed
        f, y = given.samples(), back.samples()
        rounding = 2.0**-51 * np.maximum(np.abs(f), np.abs(y))
        assert (np.abs(y - f) <= np.maximum(float(k) * np.abs(f), float(floor)) + rounding).all()
