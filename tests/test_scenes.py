"""The simulated stylus: real enough to compress, exact enough to be stiff, the same every time."""

from __future__ import annotations

import sys
from fractions import Fraction

import numpy as np
import pytest

from hapfmt.errors import ParameterError
from hapfmt.lab.scenes import surface
from hapfmt.lab.scenes.description import Contact, Press, Tool, Work
from hapfmt.lab.scenes.motion import StepGrid
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.lab.scenes.tool import system_of
from hapfmt.lab.scenes.touch import FRICTION, Normal
from hapfmt.split import low_pass

TEXTURES = ["stone", "sand", "cork"]


def test_one_channel_of_counts():
    recording = simulate("sand", 1.0, seed=3, rate_hz=500)
    (channel,) = recording.channels
    assert (channel.label, channel.unit, channel.quantity) == ("normal force", "N", "force")
    assert (channel.axis, channel.group, channel.rate_exact) == ("z", "", Fraction(500))
    assert channel.stored.dtype == np.int16 and channel.stored.shape == (500,)
    assert channel.calibration.step == Fraction(1, 2000)
    assert recording.metadata["scene"] == {
        "name": "stylus",
        "texture": "sand",
        "seed": 3,
        "contact_n_per_m": 650.0,
        "step_hz": 20_000,
    }


@pytest.mark.parametrize("texture", TEXTURES)
def test_forces_are_those_of_the_scene(texture):
    """Mean 0.8-1.0 N, texture above 20 Hz 20-60 mN rms; air at both ends, no contact lost."""
    force = simulate(texture).channels[0].samples()
    touching = slice(500, 3700)
    texture_rms = (force - low_pass(force, 1000))[touching].std()
    assert 0.8 < force.mean() < 1.0
    assert 0.020 < texture_rms < 0.060
    assert force[touching].min() > 0.5 and force.max() < 2.0
    assert np.abs(force[[0, 50, -50, -1]]).max() < 0.005


def test_flat_plane_is_silent_and_computes_no_height_field(monkeypatch):
    monkeypatch.setitem(sys.modules, "hapfmt.lab.scenes.surface", None)
    force = simulate(None).channels[0].samples()
    assert 0.8 < force.mean() < 1.0
    assert (force - low_pass(force, 1000))[500:3700].std() < 0.002


def test_reproducible_and_seeded():
    first, again, other = (simulate("cork", 0.5, seed=s).channels[0].stored for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_texture_does_not_change_the_hand():
    flat, sand = (simulate(t, seed=4).channels[0].samples() for t in (None, "sand"))
    slow = slice(500, 3700)
    assert np.abs(low_pass(flat - sand, 1000, 2)[slow]).max() < 0.02


def test_three_axes():
    recording = simulate("sand", seed=2, axes=3)
    x, y, z = recording.channels
    assert [channel.axis for channel in recording.channels] == ["x", "y", "z"]
    assert {channel.group for channel in recording.channels} == {"tip"}
    assert np.array_equal(z.stored, simulate("sand", seed=2).channels[0].stored)
    along = np.hypot(x.samples(), y.samples())[500:3700] / z.samples()[500:3700]
    assert along.mean() == pytest.approx(FRICTION, rel=0.05)
    assert np.sign(x.samples()[500:3700]).min() < 0 < np.sign(x.samples()[500:3700]).max()


class TestStiffness:
    def at(self, stiffness, **more):
        return simulate(None, 2.0, contact_n_per_m=stiffness, **more).channels[0].samples()

    @pytest.mark.parametrize("stiffness", [1e3, 1e4, 1e5, 1e6])
    def test_force_at_rest_does_not_depend_on_it(self, stiffness):
        """Row 20: an explicit Euler step of 1 ms diverges here."""
        force = self.at(stiffness)
        assert 0.9 < force[800:1700].mean() < 1.05
        assert np.abs(np.diff(force[800:1700])).max() < 0.006

    def test_steps_converge(self):
        fine, normal = self.at(1e5, step_hz=100_000), self.at(1e5)
        assert np.abs(fine - normal)[800:].max() < 0.01
        assert normal.max() == pytest.approx(fine.max(), rel=0.05)

    def test_static_force(self):
        """At rest the press is what both springs in a row hold."""
        contact, work = Contact(500.0), Work()
        tool = Tool(press=Press(0.7), contact=contact)
        depth = -0.7 * (1 / 250 + 1 / 500)
        normal = Normal(
            system_of(tool, contact),
            contact,
            StepGrid(20_000, 1, 20_000),
            lambda t: np.full_like(t, depth),
            work,
        )
        raised = np.full(20_000, 1e-3), np.zeros(20_000)
        *_, force = normal.block(0, 20_000, raised)
        assert force[-1] == pytest.approx(0.7 + 1e-3 * 250 * 500 / 750, rel=1e-6)
        assert work.contact_step_count == 20_000


class TestHeightfields:
    @pytest.mark.parametrize("texture", TEXTURES)
    def test_a_function_of_the_plane(self, texture):
        heights = surface.SURFACES[texture](np.random.default_rng(1))
        x, y = np.random.default_rng(2).uniform(-0.2, 0.2, (2, 400))
        assert np.array_equal(heights(x, y)[100:200], heights(x[100:200], y[100:200]))
        assert np.all(np.isfinite(heights(x, y)))
        assert 10e-6 < heights(x, y).std() < 300e-6

    @pytest.mark.parametrize("texture", TEXTURES)
    def test_no_cliffs(self, texture):
        """1 um on, the height has changed by a few um at most."""
        heights = surface.SURFACES[texture](np.random.default_rng(1))
        x = np.arange(40_000) * 1e-6
        steps = np.abs(np.diff(heights(x, 0.3 * x)))
        assert np.percentile(steps, 99.9) < 10e-6

    def test_stone_is_self_affine(self):
        """Structure function of a Hurst exponent of 0.8: slope 1.6 over a decade."""
        heights = surface.stone(np.random.default_rng(3))
        x = np.arange(100_000) * 20e-6
        profile = heights(x, np.zeros_like(x))
        lags = np.array([5, 10, 20, 40])
        structure = [np.mean((profile[lag:] - profile[:-lag]) ** 2) for lag in lags]
        slope = np.polyfit(np.log(lags), np.log(structure), 1)[0]
        assert 1.2 < slope < 1.8


@pytest.mark.parametrize("seconds", [1e-9, 0.001, 0.01, 0.3])
@pytest.mark.parametrize("rate", [1, 7, 1000, 44_100])
def test_short_and_odd(seconds, rate):
    recording = simulate("sand", seconds, rate_hz=rate, axes=3)
    assert {channel.stored.size for channel in recording.channels} == {
        max(round(seconds * rate), 1)
    }


def test_refused():
    for arguments, message in (
        ({"texture": "velvet"}, "velvet"),
        ({"axes": 2}, "axis"),
        ({"seconds": 0}, "duration"),
        ({"seconds": float("nan")}, "duration"),
        ({"seconds": float("inf")}, "duration"),
        ({"rate_hz": 0}, "rates"),
        ({"contact_n_per_m": 0}, "stiffness"),
        ({"contact_n_per_m": 1e12}, "stiffness"),
        ({"seed": -1}, "seed"),
    ):
        with pytest.raises(ParameterError, match=message):
            simulate(**arguments)
