"""docs/spec/players.md: kernels and places, alone; and which channel plays where."""

from __future__ import annotations

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from rendering import SHAPES, file_of, joined, profile_of

from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.errors import ParameterError
from hapfmt.reading.reader import Reader
from hapfmt.replay.render import Assignment, Renderer, Route, assign
from hapfmt.replay.render.assign import factor_for, parse_term
from hapfmt.replay.render.feed import NOWHERE, DeviceGrid, kernel, samples_in

MILLI = Calibration(1, 0, 1000)
FLAT, STOP, FLOOR_DB = 0.85, 1.16, -80.0
"""The sinc of docs/spec/players.md, in cutoffs."""
ratios = st.sampled_from(
    [Fraction(1, 10), Fraction(3, 7), Fraction(1), Fraction(21, 10), Fraction(7)]
)
fractions = st.fractions(0, 10**6, max_denominator=10**6)


def resampled(x, shape, ratio, count):
    """``count`` samples of a device, of a signal that goes on on both sides as it ends."""
    chosen = kernel(shape, ratio)
    places = DeviceGrid(Fraction(0), ratio, Fraction(1)).places(0, count)
    pad = chosen.half
    return chosen.apply(np.pad(x, pad, mode="symmetric"), -pad, places.ticks, places.phases)


class TestPlaces:
    @given(
        fractions, fractions.filter(bool), st.fractions("0.0001", 200_000), st.integers(0, 10**12)
    )
    def test_are_exact(self, start, step, rate, number):
        grid = DeviceGrid(start, step, rate)
        ticks, phases = grid.places(number, 5)
        for i in range(5):
            place = (start + (number + i) * step) * rate
            assert grid.tick(number + i) == floor(place)
            assert ticks[i] == min(floor(place), NOWHERE)
            assert phases[i] == min(float(place - floor(place)), np.nextafter(1.0, 0.0))

    def test_beyond_64_bits(self):
        """A tick that nothing covers, where the true one has no room; phases of any denominator."""
        grid = DeviceGrid(Fraction(10**30), Fraction(1, 3), Fraction(200_000))
        assert set(grid.places(0, 3).ticks.tolist()) == {NOWHERE}
        odd = Fraction(1, 10**39 + 7)
        assert DeviceGrid(Fraction(0), odd, Fraction(1)).places(1, 1).phases[0] == float(odd)
        below = 1 - Fraction(1, 10**30)
        assert DeviceGrid(below, Fraction(1), Fraction(1)).places(0, 1).phases[0] == np.nextafter(
            1.0, 0.0
        )

    @given(fractions, fractions.filter(bool))
    def test_count(self, seconds, step):
        count = samples_in(seconds, step)
        assert count * step >= seconds
        assert not count or (count - 1) * step < seconds


class TestKernels:
    @given(st.sampled_from(list(SHAPES.values())), ratios, st.floats(-1e308, 1e308))
    def test_a_constant_stays(self, shape, ratio, level):
        out = resampled(np.full(40, level), shape, ratio, samples_in(Fraction(40), ratio))
        if shape == "band-limited":
            assert np.abs(out - level).max() <= 1e-14 * abs(level) + 1e-320
        else:
            assert (out == level).all()

    @given(ratios, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
    def test_linear_is_exact_on_lines(self, ratio, slope, level):
        """At any width, since that is whole ticks."""
        x = slope * np.arange(400) + level
        count = int(300 / ratio)
        out = resampled(x, "linear", ratio, count)
        places = np.array([float(n * ratio) for n in range(count)])
        inside = (places >= 8) & (places < 380)
        error = np.abs(out - (slope * places + level))[inside]
        assert error.max() <= 1e-12 * (np.abs(x).max() + 1)

    @pytest.mark.parametrize("ratio", [Fraction(1, 10), Fraction(10, 31), Fraction(1)])
    @pytest.mark.parametrize("cutoffs", [0.01, 0.3, 0.7, FLAT])
    def test_band_limited_is_exact_below_its_cutoff(self, ratio, cutoffs):
        """Within 0.15 %: 0.01 dB, and the image above the cutoff; far below it within 0.02 %."""
        t = np.arange(600)
        x = np.cos(np.pi * cutoffs * t + 0.3)
        count = int(500 / ratio)
        out = resampled(x, "band-limited", ratio, count)
        places = np.array([float(n * ratio) for n in range(count)])
        inside = places > 20
        error = np.abs(out - np.cos(np.pi * cutoffs * places + 0.3))[inside].max()
        assert error < 1.5e-3
        if cutoffs <= 0.7:
            assert error < 2e-4

    @pytest.mark.parametrize("ratio", [Fraction(1), Fraction(21, 10), Fraction(7)])
    def test_response(self, ratio):
        """Of the continuous kernel: flat, then nothing, and half of it at the cutoff."""
        chosen = kernel("band-limited", ratio)
        phases = np.arange(64) / 64
        x = np.arange(1 - chosen.half, chosen.half + 1)[None, :] - phases[:, None]
        cutoffs = np.arange(0, 4, 0.01)
        angles = np.pi * cutoffs / float(chosen.width)
        weights = chosen.weights(phases).ravel()
        gain = np.abs([weights @ np.cos(angle * x.ravel()) for angle in angles]) / 64
        level = 20 * np.log10(gain + 1e-20)
        assert np.abs(level[cutoffs <= FLAT]).max() < 0.01
        assert level[cutoffs >= STOP].max() < FLOOR_DB
        assert abs(level[np.argmin(np.abs(cutoffs - 1))] + 6.02) < 0.01

    @pytest.mark.parametrize("shape", SHAPES.values())
    def test_what_a_slow_device_cannot_render_does_not_fold_back(self, shape):
        """10 kHz for 1 kHz: 900 Hz would become 100 Hz."""
        x = np.sin(2 * np.pi * 0.09 * np.arange(20_000))
        out = resampled(x, shape, Fraction(10), 1900)[50:]
        # A triangle has -38 dB there, and limits make no more of the sinc's -80.
        assert np.abs(out).max() < {"linear": 0.02, "band-limited": 1e-4, "bounded": 1e-4}[shape]

    @given(
        st.sampled_from(["linear", "bounded"]),
        ratios,
        st.lists(st.floats(-1e308, 1e308), min_size=2, max_size=60),
    )
    def test_never_beyond_the_neighbours(self, shape, ratio, x):
        x = np.array(x)
        count = samples_in(Fraction(len(x)), ratio)
        out = resampled(x, shape, ratio, count)
        width = -(-max(ratio, 1) // 1)
        for n, value in enumerate(out.tolist()):
            place = n * ratio
            near = [
                min(max(j, 0), len(x) - 1)
                for j in range(floor(place - width) - 1, floor(place + width) + 2)
            ]
            if abs(place - floor(place)) == 0 and max(ratio, 1) == 1:
                near = [floor(place)]
            assert x[near].min() <= value <= x[near].max()

    def test_tables_are_kept_and_let_go(self):
        chosen = kernel("band-limited", Fraction(1))
        for size in range(1, 50):
            chosen.table(np.arange(size) / size)
        assert len(chosen.tables) == 32
        first, which = chosen.table(np.array([0.5, 0.25, 0.5]))
        again, _ = chosen.table(np.array([0.25, 0.5]))
        assert first is again
        assert which.tolist() == [1, 0, 1]


class TestUnits:
    @pytest.mark.parametrize(
        ("unit", "accepts", "factor"),
        [
            ("N", {"N": 1.0}, 1),
            ("mN", {"N": 1.0}, Fraction(1, 1000)),
            ("kN", {"mN": 0.001}, 1000),
            ("mN", {"N": 5.0, "mN": 0.25}, Fraction(1, 4)),
            ("cN", {"N": 1000.0}, 10),
            ("uN", {"N": 0.1}, Fraction(1, 10**7)),
            ("mN.m", {"N.m": 1.0}, Fraction(1, 1000)),
            ("N.mm", {"N.m": 1.0}, Fraction(1, 1000)),
            ("mm/s2", {"m/s2": 1.0}, Fraction(1, 1000)),
            ("m/ms2", {"m/s2": 1.0}, 10**6),
            ("m.s-2", {"m/s2": 1.0}, 1),
            ("mm2", {"m2": 1.0}, Fraction(1, 10**6)),
            ("%", {"1": 255.0}, Fraction(255, 100)),
            ("/ms", {"/s": 1.0}, 1000),
            ("dam", {"m": 1.0}, 10),
            ("m[g]", {"[g]": 2.0}, Fraction(1, 500)),
            ("{raw(0-255)}", {"{raw(0-255)}": 2.0}, 2),
            ("Nm", {"N.m": 1.0}, 1),
            ("1", {"N": 1.0}, None),
            ("N", {}, None),
            ("N", {"N.m": 1.0}, None),
            ("m", {"min": 1.0}, None),
            ("cd", {"d": 1.0}, None),
            ("Pa", {"a": 1.0}, None),
            ("mol", {"ol": 1.0}, None),
            ("kg", {"N": 1.0}, None),
            ("{raw(0-1)}", {"{raw(0-255)}": 2.0}, None),
        ],
    )
    def test_factors(self, unit, accepts, factor):
        assert factor_for(unit, accepts) == factor

    @given(st.text(max_size=20))
    def test_any_text(self, unit):
        assert factor_for(unit, {unit: 3.0}) == 3
        parse_term(unit)


def channel(label="", unit="N", size=100, **described):
    return Channel(
        np.arange(size, dtype=np.int32), Fraction(1000), calibration=MILLI, label=label, unit=unit,
        **described,
    )  # fmt: skip


def assigned(channels, profile, *given_, settings=None):
    data = file_of(Recording(tuple(channels)), *([settings] if settings else []))
    with Reader(data) as reader:
        found = assign(reader, profile, given_)
    return {route.actuator: route.channel for route in found.routes}, found


class TestAssignment:
    def test_bands(self):
        noise = np.random.default_rng(1).integers(-999, 1000, 500).astype(np.int32)
        split = Settings("paper", k=Fraction(1, 10), bits=8, smallest=False)
        rough = Channel(noise, Fraction(1000), calibration=MILLI, label="rough", unit="N")
        for band, kept, gone in (("lf", "LF", "HF"), ("hf", "HF", "LF")):
            routes, found = assigned([rough], profile_of(band=band), "0=1", settings=split)
            assert routes == {0: 0}
            assert found.notes == (
                f"channel 0 'rough': its {gone} is left out, since 'a1' renders {kept} only",
            )
        for given_ in ([], ["0=1"]):
            with pytest.raises(ParameterError, match="it has no HF track"):
                assigned([rough], profile_of(band="hf"), *given_)

    def test_calibration_of_the_actuator(self):
        profile = profile_of()
        (actuator,) = profile.actuators
        tuned = actuator.__class__(**{**vars(actuator), "gain": -2.0, "offset": 0.5})
        profile = profile.__class__(**{**vars(profile), "actuators": (tuned,)})
        with Reader(file_of(Recording((channel(unit="mN"),)))) as reader:
            values, known = joined(
                Renderer(reader, profile, assign(reader, profile, by_order=True)).blocks()
            )
        assert known.all()
        assert np.allclose(values[:, 0], -2 * np.arange(100) * 1e-6 + 0.5, rtol=0, atol=1e-15)


@given(
    st.sampled_from(["full", "lf"]),
    st.sampled_from([100, 333, 1000, 2500]),
    st.integers(0, 200),
    st.data(),
)
def test_a_block_says_the_same_wherever_it_begins(band, rate, at, data):
    """From another second on, the same samples of the device have the same values."""
    rng = np.random.default_rng(9)
    counts = rng.integers(-2000, 2001, 600).astype(np.int32)
    made = Channel(counts, Fraction(1000), calibration=MILLI, unit="N")
    with Reader(
        file_of(
            Recording((made,)), Settings("paper", bits=8, cluster=Fraction(1, 10), smallest=False)
        )
    ) as reader:
        profile = profile_of(rate=rate, band=band)
        renderer = Renderer(reader, profile, Assignment((Route(0, 0, Fraction(1)),)))
        whole, _ = joined(renderer.blocks())
        assume(at < len(whole))
        renderer.block_samples = data.draw(st.integers(1, 100))
        part, _ = joined(renderer.blocks(0, 1, Fraction(at, rate)))
    assert part.tobytes() == whole[at:].tobytes()
