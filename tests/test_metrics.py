"""Error measures, and what they say where there is nothing to measure."""

from __future__ import annotations

import sys
from fractions import Fraction
from types import ModuleType

import numpy as np
import pytest
from scipy import signal

from hapfmt.deadband import Deadband
from hapfmt.errors import MissingExtraError, ParameterError
from hapfmt.lab.metrics import (
    band_energy_error_db,
    max_error,
    resampling_8khz,
    rmse,
    share_outside,
    snr_hf_db,
    st_sim,
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
        assert snr_hf_db(f, f, RATE) == np.inf
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


def test_share_outside():
    deadband = Deadband(1, 10, (10,), (0,))
    x = np.array([1000, 1000, 0, 0])
    assert share_outside(deadband, x, x + np.array([100, 101, 10, 11])) == 0.5
    assert share_outside(deadband, x[:0], x[:0]) == 0


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


def test_refused():
    f = np.zeros(10)
    for metric in (max_error, rmse, lambda f, y: snr_hf_db(f, y, RATE)):
        with pytest.raises(ParameterError, match="equal shapes"):
            metric(f, f[:9])
        with pytest.raises(ParameterError, match="finite"):
            metric(f, f + np.nan)
    with pytest.raises(ParameterError, match="positive rate"):
        band_energy_error_db(f, f, 0)
