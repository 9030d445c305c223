"""tools/texture_rates.py: bits at equal quality, of results that were decoded."""

from __future__ import annotations

import sys
from math import inf, log2

import numpy as np
import pytest
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import texture_rates as rates
from texture_rates import Coded, Curve, Curves, Texture

from hapfmt import metrics

SIGNAL = np.random.default_rng(1).normal(size=3000).cumsum()
SIGNAL -= 0.99 * np.concatenate([[0], SIGNAL[:-1]])
TEXTURE = Texture("noise", 5 + SIGNAL, 1000.0)


def law(texture: Texture, step: float) -> Coded:
    """6 bits at the standard deviation, one more for each halving; the step as the result."""
    return Coded(6 - log2(step / texture.level), np.array([step]))


def decibels(texture: Texture, y: np.ndarray) -> float:
    return -20 * float(np.log10(y[0] / texture.level))


class TestSearch:
    @pytest.mark.parametrize("wanted", [-30.0, 0.0, 0.1, 13.2, 60.0])
    def test_bits_at_a_quality(self, wanted):
        """Along a known law, between the steps that are tried."""
        found = Curve(law, TEXTURE).bits(decibels, wanted)
        assert found == pytest.approx(6 + wanted / (20 * np.log10(2)), abs=1e-9)

    def test_each_step_is_coded_once(self):
        steps = []

        def counted(texture, step):
            steps.append(step)
            return law(texture, step)

        curve = Curve(counted, TEXTURE)
        for wanted in (10.0, 20.0, 10.0):
            curve.bits(decibels, wanted)
        assert len(steps) == len(set(steps)) <= 16

    def test_a_quality_out_of_reach(self):
        assert Curve(law, TEXTURE).bits(decibels, 200.0) == inf
        assert rates.shown(inf) == "-"

    def test_the_best_of_several_ways(self):
        def worse(texture, step):
            bits, y = law(texture, step)
            return Coded(bits + 1, y)

        both = Curves(TEXTURE, {"x": [Curve(worse, TEXTURE), Curve(law, TEXTURE)]})
        assert both.bits("x", decibels, 0.0) == pytest.approx(6)


@pytest.mark.parametrize("name", rates.CODECS)
def test_every_codec_reaches_the_quality_and_a_finer_step_costs_more(name):
    way = rates.CODECS[name][0]
    coarse, fine = (way(TEXTURE, share * TEXTURE.level) for share in (0.3, 0.03))
    for coded, least in ((coarse, 12), (fine, 32)):
        assert coded.y.shape == TEXTURE.x.shape
        assert metrics.snr_hf_db(TEXTURE.x, coded.y, 1000) > least
    assert 0.2 < coarse.bits < fine.bits < 12


def test_prediction_decodes_to_its_grid():
    step = 0.1 * TEXTURE.level
    assert np.array_equal(rates.lpcr(TEXTURE, step).y, np.rint(TEXTURE.x / step) * step)


def test_tables(capsys):
    every = [rates.curves_of(TEXTURE, ["paper", "LPCR"])]
    rates.print_qualities("SNR", every, rates.snr_hf, 20.0)
    paper, lpcr = (every[0].bits(codec, rates.snr_hf, 20.0) for codec in ("paper", "LPCR"))
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("|")
    ]
    figures = [f"{paper:.2f}", f"{lpcr:.2f}"]
    assert rows[0] == ["bits a sample", "paper", "LPCR"]
    assert rows[2:] == [
        ["noise", *figures],
        ["geometric mean", *figures],
        ["ratio to paper", "1.00", f"{lpcr / paper:.2f}"],
    ]
    rates.print_qualities("SNR", every, rates.snr_hf, 500.0)
    last = capsys.readouterr().out.split("\n")[-4:]
    assert all("-" in line and not any(map(str.isdigit, line)) for line in last if line)


def test_a_way_of_several_codecs_is_coded_once():
    curves = rates.curves_of(TEXTURE, ["LPCR", "LPCR or MDCT"])
    assert curves.of["LPCR"][0] is curves.of["LPCR or MDCT"][0]


def test_weights_of_bands():
    """At 40 Hz the threshold is (250 / 40)^2 times its minimum, so a power of 1/2 gives 6.25."""
    assert rates.weights_of(256, 0.0, 1000) == b""
    weights = rates.weights_of(512, 0.5, 1000)
    assert len(weights) == 64
    at = [(place + 0.5) * 500 / 64 for place in range(64)]
    assert all(weight == 200 for weight, hz in zip(weights, at, strict=True) if hz <= 40)
    assert [weight for weight, hz in zip(weights, at, strict=True) if 250 < hz < 300] == [32] * 6


def test_a_model_takes_few_bits_and_has_the_power_of_the_texture():
    (sand,) = rates.simulated(4.0)
    coded, order = rates.nois(sand)
    assert coded.bits * sand.rate_hz < 300 and order in range(8, 33)
    fast = sand.x - rates.low_pass(sand.x, sand.rate_hz)
    assert coded.y.std() == pytest.approx(fast.std(), rel=0.3)
    assert np.corrcoef(coded.y, fast)[0, 1] < 0.2
    assert rates.nois(sand, 2)[1] == 2 and rates.nois(sand, 2)[0].bits < coded.bits


def test_table_of_models(capsys):
    (sand,) = rates.simulated(2.0)
    rates.print_models([rates.curves_of(sand, ["LPCR"])])
    header, _, row = (line for line in capsys.readouterr().out.splitlines() if line.startswith("|"))
    assert "NOIS bit/s" in header and "simulated sand" in row
    assert header.count("|") == row.count("|")
