"""Error measures: against hand computations and other implementations, and where there is nothing
to measure."""

from __future__ import annotations

import sys
from fractions import Fraction
from types import ModuleType

import numpy as np
import pytest
from scipy import signal
from scipy.stats import norm

from hapfmt.deadband import Deadband
from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.metrics import (
    LEAST_M,
    Similarity,
    band_energy_error_db,
    max_error,
    max_in_deadbands,
    resampling_8khz,
    rmse,
    share_outside,
    snr_db,
    snr_hf_db,
    snr_weighted_db,
    spqi,
    st_sim,
    texture_threshold_db,
    vibrotactile_threshold,
)

RATE = 1000


def texture(seed, n=3000):
    """1 N with slow drift and 30 mN of noise."""
    rng = np.random.default_rng(seed)
    return 1 + 0.3 * np.sin(np.arange(n) / 800) + 0.03 * rng.normal(size=n)


class TestDistances:
    def test_known(self):
        f, y = np.array([0.0, 3.0, 0.0, 0.0]), np.array([0.0, 0.0, 4.0, 0.0])
        assert max_error(f, y) == 4
        assert rmse(f, y) == 2.5

    @pytest.mark.parametrize("n", [0, 1, 5])
    def test_identical_and_empty(self, n):
        f = np.arange(n, dtype=np.float64)
        assert max_error(f, f) == rmse(f, f) == 0
        assert snr_hf_db(f, f, RATE) == snr_weighted_db(f, f, RATE) == np.inf
        assert band_energy_error_db(f, f, RATE) == 0

    def test_extremes(self):
        f = np.array([1.7e308, 1e-300, 0.0])
        assert rmse(f, -f) == np.inf and max_error(f, -f) == np.inf
        assert rmse(f, f / 2) == pytest.approx(1.7e308 / 2 / 3**0.5)
        assert max_error(f, f - np.array([0, 1e-300, 0])) == 1e-300
        assert max_error(np.array([5e-324]), np.array([0.0])) == 5e-324
        assert rmse(np.full(4, 1e-200), np.zeros(4)) == pytest.approx(1e-200)

    def test_integers(self):
        assert max_error(np.array([250], np.uint8), np.array([255], np.uint8)) == 5


class TestSnr:
    def test_white_noise_in_the_residual(self):
        f = texture(1)
        y = f + 0.003 * np.random.default_rng(2).normal(size=f.size)
        assert snr_hf_db(f, y, RATE) == pytest.approx(20, abs=0.5)

    def test_lost_lf_part_counts(self):
        assert snr_hf_db(texture(1), texture(1) - 1, RATE) < -25

    def test_components_are_pooled(self):
        f = np.stack([texture(1), texture(3)], axis=1)
        y = f + 0.003 * np.random.default_rng(2).normal(size=f.shape)
        assert snr_hf_db(f, y, RATE) == pytest.approx(20, abs=0.5)

    @pytest.mark.parametrize("f", [np.full(500, 0.1), np.full(2, 3.0)])
    def test_no_texture(self, f):
        assert snr_hf_db(f, f + 1, RATE) == -np.inf

    def test_scale_does_not_matter(self):
        f, y = texture(1), texture(1) + 0.001 * texture(2)
        for power in (-1000, 1000):
            scaled = snr_hf_db(np.ldexp(f, power), np.ldexp(y, power), RATE)
            assert scaled == pytest.approx(snr_hf_db(f, y, RATE), abs=1e-9)


class TestWholeSnr:
    def test_by_hand(self):
        f = np.array([1.0, 3.0, 1.0, 3.0])  # mean 2, variance 1
        assert snr_db(f, f + 0.1) == pytest.approx(20)
        assert snr_db(f + 1000, f + 1000.1) == pytest.approx(20)

    def test_components_are_pooled(self):
        """The variance of each component is around its own mean."""
        f = np.array([[1.0, 10.0], [3.0, 10.0]])  # variances 1 and 0
        assert snr_db(f, f + 0.1) == pytest.approx(10 * np.log10(0.5 / 0.01))

    def test_nothing_to_measure(self):
        f = np.full(5, 2.0)
        assert snr_db(f, f) == snr_db(f[:0], f[:0]) == np.inf
        assert snr_db(f, f + 1) == -np.inf
        assert snr_db(np.full(7, 0.1) * 1e300, np.full(7, 0.2) * 1e300) == -np.inf

    def test_any_scale(self):
        f = texture(1)
        for power in (-1000, 1000):
            scaled = snr_db(np.ldexp(f, power), np.ldexp(f + 0.01 * texture(2), power))
            assert scaled == pytest.approx(snr_db(f, f + 0.01 * texture(2)), abs=1e-9)


class TestThreshold:
    def test_displacement(self):
        """Flat, 12 dB an octave down, flat, 12 dB an octave up."""
        hz = np.array([10, 40, 80, 125, 250, 300, 600])
        levels = 20 * np.log10(vibrotactile_threshold(hz) / 1e-7)
        down = 40 * np.log10(250 / 40)
        octave = 40 * np.log10(2)
        assert levels == pytest.approx([down, down, down - octave, octave, 0, 0, octave])
        assert vibrotactile_threshold(250.0) == LEAST_M == 1e-7

    def test_acceleration_is_flat_where_displacement_falls_by_the_square(self):
        found = vibrotactile_threshold(np.array([40, 63, 160, 250]), "acceleration")
        assert found == pytest.approx(np.full(4, 1e-7 * (2 * np.pi * 250) ** 2))

    def test_velocity_is_between(self):
        hz = np.array([30.0, 300.0])
        between = vibrotactile_threshold(hz) * vibrotactile_threshold(hz, "acceleration")
        assert vibrotactile_threshold(hz, "velocity") == pytest.approx(np.sqrt(between))

    def test_other_quantities_are_refused(self):
        with pytest.raises(ParameterError, match="displacement, velocity, acceleration"):
            vibrotactile_threshold(100.0, "pressure")


class TestWeightedSnr:
    """Two sines: lines 100 and 500 of the cosine transform of 1000 samples at 1 kHz, which are 50
    and 250 Hz."""

    AT = np.pi * (np.arange(1000) + 0.5) / 1000
    LOW, HIGH = np.cos(100 * AT), np.cos(500 * AT)

    @pytest.mark.parametrize(
        ("quantity", "ratio"), [("displacement", 25.0), ("velocity", 5.0), ("acceleration", 1.0)]
    )
    def test_by_hand(self, quantity, ratio):
        """At 50 Hz the threshold of a displacement is 25 times that at 250 Hz: (250 / 50)^2."""
        f, e = 3 * self.LOW + 2 * self.HIGH, 0.3 * self.LOW + 0.1 * self.HIGH
        wanted = 10 * np.log10(((3 / ratio) ** 2 + 2**2) / ((0.3 / ratio) ** 2 + 0.1**2))
        assert snr_weighted_db(f, f + e, RATE, quantity) == pytest.approx(wanted, abs=1e-9)

    def test_against_a_filter_of_the_spectrum(self):
        """The same weights, as a zero-phase filter of the mirrored signal."""
        f = texture(1)
        y = f + 0.003 * np.random.default_rng(2).normal(size=f.size)

        def filtered(x):
            mirrored = np.concatenate([x, x[::-1]])
            hz = np.fft.rfftfreq(mirrored.size, 1 / RATE)
            gain = np.zeros(hz.size)
            high = hz >= 20
            gain[high] = 1e-7 / vibrotactile_threshold(hz[high])
            return np.fft.irfft(np.fft.rfft(mirrored) * gain, mirrored.size)[: x.size]

        wanted = 20 * np.log10(np.linalg.norm(filtered(f)) / np.linalg.norm(filtered(y - f)))
        assert snr_weighted_db(f, y, RATE, "displacement") == pytest.approx(wanted, abs=1e-6)

    def test_slow_errors_do_not_count(self):
        slow = np.cos(20 * self.AT)  # 10 Hz
        f = 5 + self.HIGH
        assert snr_weighted_db(f, f + slow, RATE) > 100 > snr_hf_db(f, f + slow, RATE)

    def test_nothing_to_measure(self):
        f = np.full(500, 0.7)
        assert snr_weighted_db(f, f, RATE) == snr_weighted_db(f[:0], f[:0], RATE) == np.inf
        assert snr_weighted_db(f, f + texture(1, 500), RATE) == -np.inf
        assert snr_weighted_db(texture(1), texture(2), 40) == np.inf
        assert snr_weighted_db(texture(1, 1), texture(2, 1), RATE) == np.inf

    def test_components_and_scale(self):
        f = np.stack([texture(1), texture(3)], axis=1)
        y = f + 0.003 * np.random.default_rng(2).normal(size=f.shape)
        whole = snr_weighted_db(f, y, RATE)
        assert snr_weighted_db(np.ldexp(f, 990), np.ldexp(y, 990), RATE) == pytest.approx(whole)
        parts = [snr_weighted_db(f[:, i], y[:, i], RATE) for i in (0, 1)]
        assert min(parts) <= whole <= max(parts)


class TestDeadbands:
    def test_by_hand(self):
        """10 % of 2 N are 0.2 N; below 1 N the threshold of 0.1 N is wider."""
        f = np.array([2.0, -2.0, 0.5, 0.0])
        y = f + np.array([0.2, -0.3, 0.1, 0.05])
        assert max_in_deadbands(f, y, 0.1) == pytest.approx(1.5)
        assert share_outside(f, y, 0.1) == 0.25
        assert max_in_deadbands(f, y, 0.1, k=0) == pytest.approx(3)
        assert share_outside(f, y, 0.1, k=0) == 0.5

    def test_vector(self):
        """An error of (0.3, 0.4) N at (3, 4) N is 0.5 N at 5 N."""
        f, y = np.array([[3.0, 4.0], [0.0, 0.0]]), np.array([[3.3, 4.4], [0.6, 0.8]])
        assert max_in_deadbands(f, y, 0.5, vector=True) == pytest.approx(2)
        assert share_outside(f, y, 0.5, vector=True) == 0.5
        assert share_outside(f, y, 0.5) == 0.5

    def test_as_the_exact_check_of_a_file(self):
        deadband = Deadband(1, 10, (10,), (0,))
        rng = np.random.default_rng(1)
        x = rng.integers(-2000, 2000, 5000)
        y = x + rng.integers(-150, 151, x.size)
        f, g = x * 0.001, y * 0.001
        assert share_outside(f, g, 0.01) == deadband.outside(x, y).mean() > 0.3
        assert max_in_deadbands(f, g, 0.01) == pytest.approx(float(deadband.worst_ratio(x, y)))

    def test_nothing_to_measure_and_refused(self):
        f = np.zeros(3)
        assert max_in_deadbands(f, f, 1) == share_outside(f, f, 1) == 0
        assert max_in_deadbands(f[:0], f[:0], 1) == share_outside(f[:0], f[:0], 1) == 0
        for floor, k in ((0, 0.1), (np.inf, 0.1), (1, -0.1), (np.nan, 0.1), (1, np.nan)):
            with pytest.raises(ParameterError, match="threshold above 0"):
                max_in_deadbands(f, f, floor, k)


class TestBandEnergy:
    def test_gain_in_all_bands(self):
        f = texture(1) - texture(1).mean()
        assert band_energy_error_db(f, f * 10 ** (3 / 20), RATE) == pytest.approx(3, abs=0.05)

    def test_other_noise_of_equal_spectrum_is_close_and_silence_is_far(self):
        f, y = texture(1), texture(2)
        assert 1 < band_energy_error_db(f, y, RATE) < 6
        assert band_energy_error_db(f, np.ones_like(f), RATE) > 30
        assert snr_hf_db(f, y, RATE) < 0

    @pytest.mark.parametrize("n", [1, 2, 3, 4, 20, 127, 129])
    @pytest.mark.parametrize("rate", [1 / 3600, 1, 50, 1000, 200_000])
    def test_short_and_slow(self, n, rate):
        f = texture(1, n)
        assert np.isfinite(band_energy_error_db(f, f[::-1], rate))
        assert np.isfinite(band_energy_error_db(np.zeros(n), f, rate))
        assert band_energy_error_db(np.zeros(n), np.ones(n), rate) == pytest.approx(0, abs=1e-6)


class TestStSim:
    def fake(self, monkeypatch, answer):
        """A stand-in for the package; gives back what it was asked."""
        calls = []

        def measure(distorted, reference, eta):
            calls.append((distorted, reference, eta))
            return answer

        for name in ("vibromaf", "vibromaf.metrics", "vibromaf.metrics.stsim"):
            module = ModuleType(name)
            module.st_sim = measure
            monkeypatch.setitem(sys.modules, name, module)
        return calls

    def test_protocol(self, monkeypatch):
        calls = self.fake(monkeypatch, 0.5)
        f = texture(1) + 5
        assert st_sim(f, f + 0.01 * texture(2), RATE) == 0.5
        ((distorted, reference, eta),) = calls
        assert distorted.size == reference.size == 8 * 3000 - 2 * 4096
        assert eta == 2 / 3
        assert abs(reference.mean()) < 1e-3
        assert reference.std() == pytest.approx(0.03, rel=0.1)
        assert not np.array_equal(distorted, reference)

    def test_complex_is_clamped(self, monkeypatch):
        self.fake(monkeypatch, complex(0.1, 0.2))
        assert st_sim(texture(1), -texture(1), RATE) == 0

    def test_without_texture(self, monkeypatch):
        self.fake(monkeypatch, 0.5)
        flat = np.full(3000, 0.7)
        assert st_sim(flat, flat, RATE) == 1
        assert st_sim(flat, flat + 1, RATE) == 1
        assert st_sim(flat, texture(1), RATE) == st_sim(texture(1), flat, RATE) == 0

    def test_missing_package(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "vibromaf.metrics.stsim", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[metrics\]"):
            st_sim(texture(1), texture(2), RATE)
        assert st_sim(texture(1), texture(1), RATE) == 1

    def test_refused(self, monkeypatch):
        self.fake(monkeypatch, 0.5)
        with pytest.raises(ParameterError, match=r"1\.088 s"):
            st_sim(texture(1, 1087), texture(2, 1087), RATE)
        assert st_sim(texture(1, 1088), texture(2, 1088), RATE) == 0.5
        with pytest.raises(ParameterError, match="30 Hz"):
            st_sim(texture(1), texture(2), 30)
        with pytest.raises(ParameterError, match="single"):
            st_sim(texture(1)[:, None], texture(2)[:, None], RATE)

    @pytest.mark.parametrize(
        "rate", [Fraction(17809, 500), Fraction(6993007, 10_000), 35.6180000001, 51_200, 96_001]
    )
    def test_an_odd_rate_needs_a_bounded_filter(self, monkeypatch, rate):
        """resample_poly designs 20 taps for each unit of the larger factor."""
        self.fake(monkeypatch, 0.5)
        factors = []
        resample = signal.resample_poly

        def recorded(x, up, down):
            factors.append((up, down))
            return resample(x, up, down)

        monkeypatch.setattr(signal, "resample_poly", recorded)
        n = int(2 * rate)
        assert st_sim(texture(1, n), texture(2, n), rate) == 0.5
        assert len(factors) == 2
        for up, down in factors:
            assert 20 * max(up, down) + 1 <= 655_381
            assert abs(Fraction(up, down) * Fraction(rate) / 8000 - 1) <= 3.1e-5

    @pytest.mark.parametrize(("rate", "ratio"), [(1000, 8), (2200, Fraction(40, 11)), (8000, 1)])
    def test_a_usual_rate_is_resampled_exactly(self, rate, ratio):
        assert resampling_8khz(rate) == ratio

    def test_the_package_itself(self):
        pytest.importorskip("vibromaf.metrics.stsim")
        f = texture(1)
        noise = np.random.default_rng(2).normal(size=f.size)
        close, far = st_sim(f, f + 0.003 * noise, RATE), st_sim(f, f + 0.1 * noise, RATE)
        assert 0.95 < close < 1
        assert 0 <= far < 0.5
        assert st_sim(f, 2 - f, RATE) == 0
        silence = np.where(np.arange(f.size) < 1500, f, 1.0)
        assert 0 < st_sim(f, silence, RATE) < 1


def blocks_8khz(x):
    """The protocol of both measures, for a signal at 8 kHz: high-pass, no edges, blocks of 512."""
    sections = signal.butter(2, 15, "highpass", fs=8000, output="sos")
    kept = signal.sosfiltfilt(sections, x)[4096:-4096]
    return kept[: kept.size // 512 * 512].reshape(-1, 512)


def perceptual_spectrum_db(blocks):
    """Noll et al. 2022: power spectrum of a cosine transform over the threshold of perception,
    a parabola over log f with its minimum of -77 dB at 250 Hz, which ends where it is above 0."""
    hz = np.linspace(0, 8000, 1024)[:512]
    offset = 1 - 250 / 550
    threshold = 62 / np.log10(offset) ** 2 * np.log10(hz / 550 + offset) ** 2 - 77
    first = int(np.flatnonzero(threshold > 0)[0])
    threshold[first:] = threshold[first]
    k, n = np.arange(512), np.arange(512)
    basis = np.sqrt(2 / 512) * np.cos(np.pi * k[:, None] * (2 * n + 1) / 1024)
    basis[0] /= np.sqrt(2)
    return 20 * np.log10(np.abs(blocks @ basis.T)) - threshold


class TestAgainstTheFormulas:
    """Both measures again, in NumPy, from the formulas of their papers."""

    RATE = 8000

    @pytest.fixture(autouse=True)
    def with_the_package(self):
        pytest.importorskip("vibromaf.metrics.spqi")

    def signals(self, seed, loud):
        rng = np.random.default_rng(seed)
        shape = signal.butter(2, [60, 400], "bandpass", fs=8000, output="sos")
        f = 1 + signal.sosfilt(shape, rng.normal(size=16_000))
        return f, f + loud * rng.normal(size=f.size)

    @pytest.mark.parametrize("loud", [0.003, 0.03, 0.3])
    def test_spqi(self, loud):
        f, y = self.signals(1, loud)
        of_f, of_y = (10 ** (perceptual_spectrum_db(blocks_8khz(x)) / 10) for x in (f, y))
        error_db = 10 * np.log10(np.abs(of_f - of_y).sum(1) / of_f.sum(1))
        wanted = np.mean((1 - np.tanh(0.3 * error_db + 2)) / 2)
        assert spqi(f, y, self.RATE) == pytest.approx(wanted, rel=1e-9)
        assert 0 < wanted < 1

    @pytest.mark.parametrize("loud", [0.003, 0.03, 0.3])
    def test_st_sim(self, loud):
        """Projections on f: of the blocks with mean 0 and variance 1, and of the normal
        distribution function of the spectra (a standard deviation of 12 dB)."""
        f, y = self.signals(1, loud)
        a, b = blocks_8khz(f), blocks_8khz(y)

        def projected(p, q):
            return np.mean((p * q).sum(1) / (p * p).sum(1))

        def normal(x):
            return (x - x.mean(1, keepdims=True)) / x.std(1, keepdims=True)

        temporal = projected(normal(a), normal(b))
        spectral = projected(*(norm.cdf(perceptual_spectrum_db(x) / 12) for x in (a, b)))
        wanted = temporal ** (2 / 3) * spectral ** (1 / 3)
        assert st_sim(f, y, self.RATE) == pytest.approx(wanted, rel=1e-9)

    @pytest.mark.parametrize("loud", [0, 0.003, 0.03, 0.3, 3])
    def test_similarity_in_one_pass(self, loud):
        f, y = self.signals(1, loud)
        similarity = Similarity(f, self.RATE)
        for each in (y, 2 - y, np.where(np.arange(f.size) < 8000, y, 1.0), np.ones(f.size)):
            assert similarity.of(each) == pytest.approx(st_sim(f, each, self.RATE), rel=1e-9)

    def test_threshold(self):
        perception = pytest.importorskip("vibromaf.signal.perception")
        wanted = perception.PerceptualThreshold(8000).calculate(512)
        np.testing.assert_allclose(texture_threshold_db(), wanted, rtol=0, atol=1e-9)

    def test_louder_errors_score_lower(self):
        f, _ = self.signals(1, 0)
        noise = np.random.default_rng(9).normal(size=f.size)
        found = [spqi(f, f + loud * noise, self.RATE) for loud in (0, 0.001, 0.01, 0.1, 1)]
        assert found[0] == 1 and found == sorted(found, reverse=True) and found[-1] < 0.2


class TestSpqi:
    def test_without_texture(self):
        pytest.importorskip("vibromaf.metrics.spqi")
        flat = np.full(3000, 0.7)
        assert spqi(flat, flat, RATE) == spqi(flat, flat + 1, RATE) == 1
        assert spqi(flat, texture(1), RATE) == spqi(texture(1), flat, RATE) == 0
        part = np.where(np.arange(3000) < 1500, texture(1), 1.0)
        assert 0 < spqi(part, part + 0.003 * texture(2), RATE) < 1

    def test_shaped_noise_is_not_accepted_but_a_sign_is(self):
        """The spectrum decides, block by block: a phase does not count, another noise does."""
        pytest.importorskip("vibromaf.metrics.spqi")
        f = texture(1)
        assert spqi(f, 2 - f, RATE) > 0.9 and st_sim(f, 2 - f, RATE) == 0
        assert spqi(f, texture(2), RATE) < 0.2

    def test_complex_is_clamped(self, monkeypatch):
        module = ModuleType("vibromaf.metrics.spqi")
        module.spqi = lambda *_, **__: complex(0.1, 0.2)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        assert spqi(texture(1), texture(2), RATE) == 0

    def test_refused(self, monkeypatch):
        with pytest.raises(ParameterError, match=r"SPQI needs at least 1\.088 s"):
            spqi(texture(1, 1087), texture(2, 1087), RATE)
        with pytest.raises(ParameterError, match="SPQI compares single"):
            spqi(texture(1)[:, None], texture(2)[:, None], RATE)
        monkeypatch.setitem(sys.modules, "vibromaf.metrics.spqi", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[metrics\]"):
            spqi(texture(1), texture(2), RATE)


def test_one_name():
    """`from hapfmt import metrics`, `import hapfmt.metrics` and `hapfmt.metrics` are one module."""
    import hapfmt

    assert hapfmt.metrics is sys.modules["hapfmt.metrics"]
    assert "metrics" in dir(hapfmt)


def test_refused():
    f = np.zeros(10)
    for metric in (
        max_error,
        rmse,
        snr_db,
        lambda f, y: snr_hf_db(f, y, RATE),
        lambda f, y: snr_weighted_db(f, y, RATE),
        lambda f, y: max_in_deadbands(f, y, 1),
        lambda f, y: share_outside(f, y, 1),
        lambda f, y: st_sim(f, y, RATE),
        lambda f, y: spqi(f, y, RATE),
    ):
        with pytest.raises(ParameterError, match="equal shapes"):
            metric(f, f[:9])
        with pytest.raises(ParameterError, match="finite"):
            metric(f, f + np.nan)
    for metric in (band_energy_error_db, snr_weighted_db):
        for rate in (0, -1, np.inf, np.nan):
            with pytest.raises(ParameterError, match="positive rate"):
                metric(f, f, rate)
