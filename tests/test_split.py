"""The encoder's analysis: the zero-phase low-pass, and the choice of knots within the deadband."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import fft, signal

from hapfmt import split
from hapfmt.deadband import Deadband
from hapfmt.encoder import knots
from hapfmt.encoder.knots import knot_values, select_knots, select_knots_plain
from hapfmt.errors import ParameterError
from hapfmt.split import CASCADE_RATIO, low_pass

FILTERS = sorted(CASCADE_RATIO)
SAMPLES = st.floats(-1e6, 1e6)
GRAM = Deadband(1, 10, (10,), (0,))


def amplitude(y, frequency_hz, rate_hz):
    """Amplitude of one sine in y, away from the edges."""
    t = np.arange(y.size) / rate_hz
    middle = slice(y.size // 4, y.size - y.size // 4)
    basis = np.stack([np.cos(2 * np.pi * frequency_hz * t), np.sin(2 * np.pi * frequency_hz * t)])
    return np.hypot(*np.linalg.lstsq(basis[:, middle].T, y[middle], rcond=None)[0])


class TestLowPass:
    @pytest.mark.parametrize("filter", FILTERS)
    @pytest.mark.parametrize(("cutoff", "rate"), [(20, 1000), (20, 50), (0.7, 1.5), (10, 1e4)])
    def test_cascade_is_3_db_down_at_the_cutoff(self, filter, cutoff, rate):
        x = np.sin(2 * np.pi * cutoff / rate * np.arange(60 * int(rate / cutoff) + 400))
        y = low_pass(x, rate, cutoff, filter=filter)
        assert amplitude(y, cutoff, rate) == pytest.approx(2**-0.5, abs=1e-3)

    @pytest.mark.parametrize("filter", FILTERS)
    def test_no_delay(self, filter):
        x = np.sin(2 * np.pi * 3 * np.arange(4000) / 1000)
        y = low_pass(x, 1000, filter=filter)
        middle = slice(1000, 3000)
        lags = [np.dot(x[1000 + k : 3000 + k], y[middle]) for k in range(-3, 4)]
        assert int(np.argmax(lags)) == 3

    def test_constants_are_solved_from_the_polynomial(self):
        s = np.array([split._BESSEL4_HALF, split._BESSEL4_ROOT]) * 1j
        gain = np.abs(105 / (s**4 + 10 * s**3 + 45 * s**2 + 105 * s + 105)) ** 2
        np.testing.assert_allclose(gain, [0.5, 0.5**0.5], rtol=1e-14)

    def test_stiff_contact_bessel(self):
        """Undershoot before the clamp 0.33 % (Butterworth of order 2: 3.4 %), none after it."""
        x = np.where(np.arange(2000) < 1000, 0.0, 3.3)
        raw = split._by_sections(x, 0.02, "bessel4", 150)
        assert -0.0034 < raw.min() / 3.3 < -0.0033
        y = low_pass(x, 1000)
        assert y.min() == 0 and y.max() == 3.3
        assert 1000 - np.flatnonzero(y > 0.01)[0] == 16

    def test_stiff_contact_butterworth_never_undershoots(self):
        x = np.where(np.arange(2000) < 1000, 0.0, 3.3)
        assert split._by_sections(x, 0.02, "butter1", 150).min() >= 0

    @pytest.mark.parametrize("filter", FILTERS)
    @pytest.mark.parametrize("ratio", [0.3, 0.02, 1e-3, 1e-4])
    def test_sections_and_cosines_agree(self, filter, ratio):
        x = np.cumsum(np.random.default_rng(1).normal(size=60_001))
        by_sections = split._by_sections(x, ratio, filter, max(64, int(3 / ratio)))
        by_cosines = split._by_cosines(x, ratio, filter)
        assert np.abs(by_sections - by_cosines).max() < 1e-9 * np.abs(x).max()

    @pytest.mark.parametrize("filter", FILTERS)
    @pytest.mark.parametrize("ratio", [9e-5, 2e-5, 1e-7, 1e-12])
    def test_cutoff_far_below_the_rate(self, filter, ratio):
        """A slow sine survives as the response says, whatever the ratio (row 12)."""
        periods = 8.0
        n = 80_001
        x = 5 + np.cos(np.pi * 2 * periods * np.arange(n) / (n - 1))
        w = periods / n / ratio
        y = low_pass(x, 1.0, ratio, filter=filter)
        if w < 0.05:
            np.testing.assert_allclose(y, x, atol=0.01)
        elif w > 1000:
            np.testing.assert_allclose(y, 5, atol=1e-3)
        assert np.all(np.isfinite(y))
        np.testing.assert_allclose(y.mean(), 5, atol=1e-3)

    def test_scaled_by_powers_of_two_exactly(self):
        x = np.random.default_rng(2).normal(size=500)
        for power in (1000, -1000):
            scaled = low_pass(np.ldexp(x, power), 1000)
            assert np.array_equal(np.ldexp(scaled, -power), low_pass(x, 1000))

    @pytest.mark.parametrize("n", [0, 1, 2])
    def test_too_short_to_filter_is_a_copy(self, n):
        for shape in ((n,), (n, 3)):
            x = np.arange(np.prod(shape), dtype=np.float64).reshape(shape)
            y = low_pass(x, 1000)
            assert np.array_equal(x, y) and not np.shares_memory(x, y)

    def test_cutoff_at_nyquist_is_a_copy(self):
        x = np.random.default_rng(3).normal(size=100)
        for cutoff in (500, 5000, float("inf")):
            assert np.array_equal(low_pass(x, 1000, cutoff), x)

    def test_short_of_the_padding_still_low_pass(self):
        x = np.tile([1.0, -1.0], 20)
        assert np.abs(low_pass(x, 1000)).max() < 0.05

    def test_constants_stay(self):
        for value in (0.0, -0.0, 3.3, -1e300, 5e-324):
            for n in (3, 10, 1000):
                assert np.all(low_pass(np.full(n, value), 1000) == value)

    def test_integers_and_columns(self):
        x = np.random.default_rng(4).integers(-3000, 3000, (700, 3)).astype(np.int16)
        y = low_pass(x, 1000)
        for column in range(3):
            np.testing.assert_allclose(y[:, column], low_pass(x[:, column], 1000), rtol=1e-12)

    def test_glitch_and_median(self):
        """A sample of 1 kN draws the slow part by 57 N; the median takes it out (row 8)."""
        clean = 1 + 0.1 * np.sin(2 * np.pi * 2 * np.arange(2000) / 1000)
        x = clean.copy()
        x[1000] = 1000
        assert np.abs(low_pass(x, 1000) - low_pass(clean, 1000)).max() > 50
        assert np.abs(low_pass(x, 1000, median3=True) - low_pass(clean, 1000)).max() < 1e-3

    @settings(max_examples=60, deadline=None)
    @given(
        st.lists(
            st.one_of(
                st.floats(allow_nan=False, allow_infinity=False),
                st.sampled_from([0.0, -0.0, 5e-324, 1e300, -1.7e308, 1.7976931348623157e308]),
            ),
            max_size=200,
        ),
        st.sampled_from(FILTERS),
        st.sampled_from([1e-320, 1e-12, 1e-5, 1e-3, 0.02, 0.3, 0.499, 0.6]),
        st.booleans(),
    )
    def test_finite_and_within_the_input(self, values, filter, ratio, median3):
        x = np.array(values)
        y = low_pass(x, 1.0, ratio, filter=filter, median3=median3)
        assert y.shape == x.shape
        if x.size:
            assert x.min() <= y.min() and y.max() <= x.max()

    def test_poles_are_roots_of_the_polynomial(self):
        poles, gain = split._PROTOTYPE["bessel4"]
        roots = np.roots([1, 10, 45, 105, 105]) / split._BESSEL4_HALF
        for pole in poles:
            assert np.abs(roots - pole).min() < 1e-13
        assert np.prod(poles) == pytest.approx(gain, rel=1e-14)
        assert np.abs(1 / np.prod(1j - np.array(poles)) * gain) == pytest.approx(0.5**0.5)

    @settings(max_examples=200)
    @given(st.floats(1e-4, 0.4999))
    def test_design_is_that_of_scipy(self, cutoff):
        """To the last bit: the bytes of files depend on it."""
        theirs = {
            "bessel4": signal.bessel(4, 2 * cutoff, norm="mag", output="sos"),
            "butter1": signal.butter(1, 2 * cutoff, output="sos"),
        }
        for name, sections in theirs.items():
            assert np.array_equal(split._sections(cutoff, name), sections)
            assert np.array_equal(split._steady(sections), signal.sosfilt_zi(sections))

    @settings(max_examples=60)
    @given(
        arrays(np.float64, array_shapes(max_dims=2, min_side=6, max_side=90), elements=SAMPLES),
        st.sampled_from(FILTERS),
        st.floats(1e-4, 0.4999),
        st.integers(5, 89),
    )
    def test_passes_are_those_of_scipy(self, x, filter, ratio, padding):
        """To the last bit, by the compiled loop and by its readable twin."""
        padding = min(padding, x.shape[0] - 1)
        sections = split._sections(split._pass_cutoff(ratio, filter), filter)
        theirs = signal.sosfiltfilt(sections, x, axis=0, padtype="even", padlen=padding)
        assert np.array_equal(split._by_sections(x, ratio, filter, padding), theirs)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(split, "compiled", None)
            assert np.array_equal(split._by_sections(x, ratio, filter, padding), theirs)

    @given(
        arrays(np.float64, array_shapes(max_dims=2, min_side=3, max_side=90), elements=SAMPLES),
        st.sampled_from(FILTERS),
        st.floats(1e-12, 0.4999),
    )
    def test_cosines_are_those_of_scipy(self, x, filter, ratio):
        gain = split._gain(x.shape[0], ratio, filter).reshape((-1,) + (1,) * (x.ndim - 1))
        theirs = fft.idct(fft.dct(x, type=1, axis=0) * gain, type=1, axis=0)
        far = np.abs(split._by_cosines(x, ratio, filter) - theirs).max()
        assert far <= 1e-14 * np.abs(x).max()

    def test_refused(self):
        x = np.zeros(10)
        for arguments in ((x, 0), (x, -1), (x, float("nan")), (x, 1000, 0), (x, 1000, -20)):
            with pytest.raises(ParameterError, match="positive"):
                low_pass(*arguments)
        with pytest.raises(ParameterError, match="finite"):
            low_pass(np.array([0.0, np.nan, 1.0]), 1000)
        with pytest.raises(ParameterError, match="butter1"):
            low_pass(x, 1000, filter="butter4")


counts = st.one_of(
    st.integers(-60, 60),
    st.sampled_from([2**31 - 1, -(2**31), 0, 2**31 - 2]),
)


@st.composite
def tracks(draw):
    components = draw(st.integers(1, 3))
    vector = draw(st.booleans())
    kn, kd = draw(st.sampled_from([(1, 10), (0, 1), (1, 1), (3, 2), (65535, 1), (7, 100)]))
    floor = draw(st.lists(st.integers(1, 20), min_size=components, max_size=components))
    zero = draw(st.lists(counts, min_size=components, max_size=components))
    runs = draw(
        st.lists(st.tuples(st.tuples(*[counts] * components), st.integers(1, 40)), max_size=30)
    )
    rows = [row for row, length in runs for _ in range(length)]
    table = np.array(rows, dtype=np.int64).reshape(-1, components)
    return table, Deadband(kn, kd, tuple(floor), tuple(zero), vector)


@pytest.fixture(params=["as shipped", "small"], scope="module")
def sizes(request):
    """Chunks and blocks small enough that both searches, and the change between them, are met."""
    patch = pytest.MonkeyPatch()
    if request.param == "small":
        for name, size in (("_DENSE", 12), ("_CHUNK", 48), ("_BLOCK_LIMIT", 16)):
            patch.setattr(knots, name, size)
    yield request.param
    patch.undo()


@pytest.mark.parametrize("n", [1, 2, 3, 10, 151, 152, 1000, 70_000])
@pytest.mark.parametrize("rate", [30, 100, 1000, 20_000])
def test_what_is_told_of_is_the_slow_part(n, rate):
    x = np.cumsum(np.random.default_rng(n).normal(0, 100, (n, 2)), axis=0)
    far = np.abs(split.slow_for_telling(x, rate) - low_pass(x, rate)).max()
    assert far <= 1e-11 * np.abs(x).max()


class TestSelectKnots:
    @pytest.mark.usefixtures("sizes")
    @settings(max_examples=100, deadline=None)
    @given(tracks(), st.sampled_from(["last", "sample"]), st.booleans())
    def test_equals_the_plain_one(self, track, reference, keep_last):
        slow, deadband = track
        found = select_knots(slow, deadband, reference=reference, keep_last=keep_last)
        plain = select_knots_plain(slow, deadband, reference=reference, keep_last=keep_last)
        assert found.dtype == np.int64
        assert found.tolist() == plain.tolist()

    @pytest.mark.parametrize("components", [1, 3])
    @pytest.mark.parametrize("vector", [False, True])
    @pytest.mark.parametrize("reference", ["last", "sample"])
    def test_equals_the_plain_one_on_long_tracks(self, components, vector, reference):
        """Noise, rest, a slow walk and 32-bit steps one after the other."""
        rng = np.random.default_rng(5)
        size = (2000, components)
        full = np.where(rng.integers(0, 2, size) == 0, -(2**31), 2**31 - 1)
        slow = np.concatenate(
            [
                rng.integers(-3000, 3000, size),
                np.full(size, 700),
                np.cumsum(rng.integers(-2, 3, size), axis=0),
                full,
            ]
        )
        deadband = Deadband(1, 10, (10,) * components, (0,) * components, vector)
        plain = select_knots_plain(slow, deadband, reference=reference, keep_last=True)
        for loops in (knots.compiled, None):
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(knots, "compiled", loops)
                found = select_knots(slow, deadband, reference=reference, keep_last=True)
            assert np.array_equal(found, plain)

    @given(tracks())
    @settings(max_examples=60, deadline=None)
    def test_hold_with_reference_sample_keeps_the_contract(self, track):
        slow, deadband = track
        ticks = select_knots(slow, deadband, reference="sample", keep_last=False)
        if slow.size:
            held = slow[ticks][np.searchsorted(ticks, np.arange(len(slow)), side="right") - 1]
            assert not deadband.outside(slow, held).any()
            assert deadband.worst_ratio(slow, held) <= 1

    def test_rule_of_the_paper(self):
        slow = np.array([100, 105, 110, 111, 100, 99, 121, 0, 10, -10, 11])
        assert select_knots(slow, GRAM, keep_last=False).tolist() == [0, 3, 5, 6, 7, 10]
        assert select_knots(slow[:10], GRAM, keep_last=True).tolist() == [0, 3, 5, 6, 7, 9]

    def test_floor_quietens_a_decay(self):
        """Row 1: a force that decays to zero needs tens of knots, not thousands."""
        force = 3000 * np.exp(-np.arange(14_000) / 700) + np.arange(14_000) % 3
        assert select_knots(force.astype(int), GRAM, keep_last=True).size < 60

    def test_empty_and_short(self):
        for n, knots_expected in ((0, []), (1, [0]), (2, [0, 1])):
            slow = np.zeros(n, dtype=np.int64)
            assert select_knots(slow, GRAM, keep_last=True).tolist() == knots_expected
            assert select_knots_plain(slow, GRAM, keep_last=True).tolist() == knots_expected

    def test_refused(self):
        with pytest.raises(ParameterError, match="reference"):
            select_knots(np.zeros(3, int), GRAM, reference="first", keep_last=True)
        with pytest.raises(ParameterError, match="integer"):
            select_knots(np.zeros(3), GRAM, keep_last=True)


def test_knot_values_round_half_up():
    slow = np.array([[-3, 3], [-2, 2], [2**31 - 1, -(2**31)], [5, 6]])
    for step in (1, 2, 3, 4, 1000):
        values = knot_values(slow, np.array([0, 2, 3]), step)
        exact = [
            [(Fraction(int(c), step) + Fraction(1, 2)).__floor__() for c in slow[t]]
            for t in (0, 2, 3)
        ]
        assert values.tolist() == exact
    with pytest.raises(ParameterError, match="step"):
        knot_values(slow, np.array([0]), 0)
