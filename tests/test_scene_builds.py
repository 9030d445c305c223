"""Scenes: each is plausible, the same again, and costs nothing for what is not in it."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from depth import deep
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

import hapfmt
from hapfmt.encoder.settings import Tolerance
from hapfmt.errors import LimitError, ParameterError
from hapfmt.lab.scenes import Scene, builtin_names, load_scene, motion, simulate
from hapfmt.lab.scenes.description import (
    FINGERS,
    INTEGRATORS,
    Contact,
    Press,
    Reach,
    Stroke,
    Tool,
    Touches,
)
from hapfmt.lab.scenes.linear import exponential
from hapfmt.split import low_pass

BUILT_IN = builtin_names()
JOINTS = 22


def physical(scene: Scene) -> dict[str, np.ndarray]:
    recording, _ = simulate(scene)
    return {channel.label: channel.samples() for channel in recording.channels}


def payload_size(recording: hapfmt.Recording) -> int:
    """Bytes of the packets of a perceptual file."""
    return hapfmt.write(recording, BytesIO(), hapfmt.Settings.of("perceptual")).payload_size


def residual(force: np.ndarray) -> np.ndarray:
    """What the paper's method leaves for its second track: force minus decoded knots."""
    channel = hapfmt.Channel.from_physical(force, 1000, label="force", unit="N", lsb=0.0005)
    stream = BytesIO()
    paper = hapfmt.Settings.of("paper", k=0.1, bits=0, floor=Tolerance.parse("0.01"))
    hapfmt.write(hapfmt.Recording((channel,)), stream, paper, canonical=1)
    return force - hapfmt.read(stream.getvalue()).channels[0].samples()


def kurtosis(x: np.ndarray) -> float:
    """3 for a normal distribution."""
    return float(np.mean((x - x.mean()) ** 4) / np.var(x) ** 2)


class TestPlausible:
    def test_there_are(self):
        assert set(BUILT_IN) == {
            "stone", "sand", "cork", "wall", "taps", "free", "grasp", "everything"
        }  # fmt: skip

    @pytest.mark.parametrize("texture", ["stone", "sand", "cork"])
    def test_textures_are_felt_where_they_are(self, texture):
        """About 0.9 N in contact; above 20 Hz 20-60 mN rms, and without the texture less than 2."""
        scene = load_scene(texture).without("touches").changed(seconds=2)
        (rough,), (flat,) = (physical(s).values() for s in (scene, scene.without("texture")))
        middle = slice(500, 1700)
        assert 0.6 < rough.mean() < 1.0 and rough[middle].min() > 0.4 and rough.max() < 2
        assert 0.020 < (rough - low_pass(rough, 1000))[middle].std() < 0.060
        assert (flat - low_pass(flat, 1000))[middle].std() < 0.002
        assert np.abs(rough[[0, 50, -50, -1]]).max() < 0.005

    @pytest.mark.parametrize("texture", ["stone", *deep(["sand", "cork"])])
    def test_the_residual_of_a_texture_has_peaks(self, texture):
        """Each touch-down is a contact onset: the kurtosis of what a deadband of 10 % leaves grows
        from about 3, that of a normal distribution, to more than 8; forces stay those of a hand."""
        scene = load_scene(texture).changed(seconds=11)
        (force,), (smooth,) = (physical(s).values() for s in (scene, scene.without("touches")))
        assert kurtosis(residual(smooth)) < 4
        assert kurtosis(residual(force)) > 8
        assert 2 < force.max() < 3.5 and force.min() > -0.005
        in_air = force < 0.01
        assert np.count_nonzero(np.diff(in_air.astype(int)) == -1) >= 6

    def test_touches_lift_as_often_and_as_high_as_they_are_told_to(self):
        """Up once in each ``every_s``, for about ``away_s`` and the ways there and back."""
        touches = Touches(every_s=0.5, lift_m=0.01, away_s=0.1, travel_s=0.05)
        tool = Tool(stroke=Stroke(touches=touches), contact=Contact(650.0),
                    channels=("normal force", "position z"))  # fmt: skip
        got = physical(Scene(tool=tool, seconds=4))
        height = got["position z"][300:3700]
        up = height > 0.003
        assert np.count_nonzero(np.diff(up.astype(int)) == 1) == 7
        assert 0.1 < up.mean() / 2 < 0.25
        assert 0.008 < height.max() < 0.02
        assert np.abs(got["normal force"][300:3700][up]).max() < 0.005

    def test_wall(self):
        """Pressed with 4 N into 100 kN/m: the peg stops within 0.1 mm, the force steps."""
        got = physical(load_scene("wall").changed(seconds=5))
        force, place = got["normal force"], got["position z"]
        pressed = force > 2
        assert 0.3 < pressed.mean() < 0.55
        assert 3 < np.median(force[pressed]) < 5 and force.max() < 20
        assert -0.0003 < place.min() < 0 and 0.0095 < place.max() < 0.0105
        assert np.diff(force).max() > 1
        assert np.abs(force[place > 0.001]).max() < 0.02

    @pytest.mark.parametrize(
        "stiffness",
        [1e2, *(pytest.param(k, marks=pytest.mark.deep) for k in (1e3, 1e4, 1e6, 1e7)), 1e5],
    )
    def test_wall_of_any_stiffness(self, stiffness):
        """What the hand presses with does not depend on the wall."""
        scene = load_scene("wall").changed(seconds=2.4, n_per_m=stiffness)
        force = physical(scene)["normal force"]
        held = force[force > 0.8 * np.percentile(force, 95)]
        assert 3 < np.median(held) < 5
        assert np.all(np.abs(force) < 66)

    def test_taps(self):
        """Eight in four seconds, of some newtons and some ten milliseconds."""
        (force,) = physical(load_scene("taps")).values()
        touched = np.concatenate([[False], force > 0.2])
        begins = np.flatnonzero(np.diff(touched.astype(int)) == 1)
        apart = begins[np.diff(begins, prepend=-1000) > 100]
        assert len(apart) == 8
        assert 1 < force.max() < 16 and 0.01 < (force > 0.2).mean() < 0.3

    def test_free(self):
        """Velocities are those of the places, and of a hand: below 1 m/s."""
        got = physical(load_scene("free"))
        assert list(got) == [f"{q} {a}" for q in ("position", "velocity") for a in "xyz"]
        for axis in "xyz":
            place, speed = got[f"position {axis}"], got[f"velocity {axis}"]
            assert np.abs(place).max() < 0.12 and 0.02 < np.abs(speed).max() < 1
            moved = place[0] + np.cumsum(speed) / 1000
            assert np.abs(moved - place).max() < 1e-3

    def test_grasp(self):
        got = physical(load_scene("grasp"))
        forces = {name: got.pop(f"{name} force") for name in FINGERS}
        assert len(got) == JOINTS and not set(got) & set(forces)
        assert all(-0.8 < x.min() <= x.max() < 1.9 for x in got.values())
        held = slice(2000, 2500)
        means = {name: force[held].mean() for name, force in forces.items()}
        others = sum(means[name] for name in FINGERS[1:])
        assert 4 < means["thumb"] < 8 and others == pytest.approx(means["thumb"], rel=0.1)
        assert means["index"] > means["ring"] and means["middle"] > means["little"]
        assert all(np.abs(force[:200]).max() < 0.01 for force in forces.values())
        assert all(abs(force[-1]) < 0.01 for force in forces.values())
        # Fingers that are stopped bend no further, but tremble.
        bend = got["index PIP flexion"]
        assert 0.3 < bend[held].mean() - bend[0] < 1.2 and bend[held].std() < 0.01
        closer = physical(load_scene("grasp").without("contact"))["index PIP flexion"]
        assert closer.max() > bend.max() + 0.5

    def test_stiff_object(self):
        scene = load_scene("grasp").changed(n_per_m=1e5, seconds=3).without(*FINGERS[1:])
        force = physical(scene)["thumb force"]
        assert 4 < force[2000:2500].mean() < 8 and force.max() < 16

    def test_tremor_is_felt_in_the_grip(self):
        scene = load_scene("grasp").without(*FINGERS[1:], "wrist", "palm")
        calm = physical(scene.without("tremor"))["thumb force"]
        shaken = physical(scene)["thumb force"]
        assert 0.010 < (shaken - calm)[1800:2600].std() < 0.060


class TestTheSameAgain:
    @pytest.mark.parametrize("name", BUILT_IN)
    def test_counts(self, name):
        scene = load_scene(name).changed(seconds=0.2)
        first, again, other = (simulate(scene.changed(seed=seed))[0] for seed in (1, 1, 2))
        assert first.metadata == again.metadata
        assert all(
            np.array_equal(a.stored, b.stored)
            for a, b in zip(first.channels, again.channels, strict=True)
        )
        assert any(
            not np.array_equal(a.stored, b.stored)
            for a, b in zip(first.channels, other.channels, strict=True)
        )

    @pytest.mark.parametrize("name", ["everything", "wall", "free"])
    def test_blocks_are_not_seen(self, name, monkeypatch):
        scene = load_scene(name).changed(seconds=0.15)
        whole = physical(scene)
        monkeypatch.setattr(motion, "BLOCK_STEPS", 777)
        for label, values in physical(scene).items():
            assert np.abs(values - whole[label]).max() < 1e-9, label

    def test_round_trip(self, tmp_path):
        recording, _ = simulate(load_scene("everything").changed(seconds=0.2))
        hapfmt.write(recording, tmp_path / "a.hapf", hapfmt.Settings.of("lossless", fast=True))
        back = hapfmt.read(tmp_path / "a.hapf")
        for mine, theirs in zip(recording.channels, back.channels, strict=True):
            assert np.array_equal(mine.stored, theirs.stored)
            assert (mine.label, mine.unit, mine.axis, mine.group, mine.calibration) == (
                theirs.label, theirs.unit, theirs.axis, theirs.group, theirs.calibration
            )  # fmt: skip
        assert back.metadata["scene"] == recording.metadata["scene"]

    def test_what_is_taken_out_moves_nothing_else(self):
        scene = load_scene("everything").changed(seconds=0.25)
        whole = physical(scene)
        for part in ("texture", "tool", "hand", "wrist", "ring", "palm"):
            for label, values in physical(scene.without(part)).items():
                if part == "texture" and ("force" in label or label.endswith("z")):
                    continue
                # Without the texture the steps are longer.
                most = 2e-6 if part == "texture" and label.startswith("position") else 0
                assert np.abs(values - whole[label]).max() <= most, (part, label)


class TestNothingForNothing:
    """Counters of what was left out are 0."""

    def work(self, name: str, *without: str) -> dict[str, int]:
        return simulate(load_scene(name).changed(seconds=0.2).without(*without))[1].as_json()

    def test_everything(self):
        work = self.work("everything")
        assert work["height_count"] == 0.2 * 20_000
        assert work["finger_count"] == 5 and work["channel_count"] == 9 + JOINTS + 5
        assert work["sample_count"] == 200 * work["channel_count"]
        assert work["step_count"] == work["contact_step_count"] > work["height_count"]

    def test_no_texture_no_heights(self):
        whole, flat = self.work("sand"), self.work("sand", "texture")
        assert whole["height_count"] == whole["contact_step_count"] == 4000
        assert flat["height_count"] == 0 and flat["contact_step_count"] < 1000

    def test_no_touches_are_drawn_where_none_are_named(self, monkeypatch):
        """A stroke alone asks for no repeats, and its hand moves as before."""
        scene = load_scene("sand").changed(seconds=0.2)
        monkeypatch.setattr(motion, "Repeats", None)
        simulate(scene.without("touches"))
        with pytest.raises(TypeError):
            simulate(scene)

    def test_no_contact_no_solver(self):
        assert self.work("sand", "contact")["contact_step_count"] == 0
        assert self.work("sand", "contact")["step_count"] == 200
        free = self.work("free")
        assert free["contact_step_count"] == 0 and free["step_count"] == 3 * 200
        hand = self.work("grasp", "contact", "tremor")
        assert hand["step_count"] == hand["tremor_count"] == 0
        assert hand["channel_count"] == JOINTS

    def test_no_finger_no_channel(self):
        work = self.work("grasp", *FINGERS[1:])
        assert work["finger_count"] == 1
        assert 5 * work["contact_step_count"] == self.work("grasp")["contact_step_count"]
        # Three joints and an abduction of the thumb, palm, wrist, and one force.
        assert work["channel_count"] == 4 + 1 + 2 + 1

    def test_only_axes_that_are_recorded_move(self):
        tool = Tool(reach=Reach(), channels=("position y",))
        assert simulate(Scene(tool=tool, seconds=0.2))[1].step_count == 200
        plane = Tool(stroke=Stroke(), channels=("position x",))
        assert simulate(Scene(tool=plane, seconds=0.2))[1].step_count == 0

    def test_modules(self):
        """What is not there is not imported, and neither a list nor a description needs numbers."""
        code = """
import json, sys
from hapfmt.lab.scenes import builtin_names, load_scene
seen = {}
def note(name):
    seen[name] = [m.removeprefix("hapfmt.lab.scenes.") for m in sys.modules
                  if m.startswith(("hapfmt.lab.scenes.", "numpy", "scipy")) and m.count(".") != 1]
    seen[name] += [m for m in ("numpy", "scipy") if m in sys.modules]
for name in builtin_names():
    load_scene(name)
note("described")
from hapfmt.lab.scenes import simulate
def make(name, *parts):
    simulate(load_scene(name).changed(seconds=0.01).without(*parts))
    note(" ".join((name, *parts)))
make("free")
make("grasp", "contact")
make("wall")
make("sand", "texture")
make("sand")
print(json.dumps(seen))
"""
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
        )
        loaded = {name: set(found) for name, found in json.loads(done.stdout).items()}
        ours = [{m for m in found if not m.startswith(("numpy", "scipy"))}
                for found in loaded.values()]  # fmt: skip
        described, free, hand, wall, flat, sand = ours
        assert described == {"description"} and "numpy" not in loaded["described"]
        assert free - described == {"build", "sensors", "tool", "motion", "linear"}
        assert hand - free == {"grasp"}
        assert wall - hand == {"touch", "contact"}
        assert flat == wall
        assert not any("scipy" in found for found in loaded.values())
        assert sand - flat == {"surface"}

    def test_a_texture_costs_bytes_where_it_is_felt(self):
        """Without a texture, or with one too fine to feel, a perceptual file is a third as large."""
        scene = load_scene("sand")
        assert scene.tool and scene.tool.texture
        fine = replace(scene.tool.texture, relief=0.02)
        flat, smooth = (
            scene.without("texture"),
            replace(scene, tool=replace(scene.tool, texture=fine)),
        )
        rough, none, little = (payload_size(simulate(s)[0]) for s in (scene, flat, smooth))
        assert none < 0.5 * rough and little < 1.05 * none


@given(st.integers(0, 2**32), st.floats(-8, 0.5))
def test_exponential(seed, decades):
    from scipy.linalg import expm

    matrix = np.random.default_rng(seed).normal(size=(6, 6)) * 10**decades
    theirs = expm(matrix)
    assert np.abs(exponential(matrix) - theirs).max() < 1e-11 * np.abs(theirs).max()


class TestChosen:
    def wall(self, **contact) -> Scene:
        tool = Tool(press=Press(1.0), contact=Contact(1e4, **contact))
        return Scene(name="wall", tool=tool, seconds=0.6)

    @pytest.mark.parametrize("integrator", INTEGRATORS)
    def test_integrators_agree_at_a_small_step(self, integrator):
        exact = physical(self.wall(dt_s=1e-5))["normal force"]
        other = physical(self.wall(dt_s=1e-5, integrator=integrator))["normal force"]
        assert np.abs(other - exact).max() < 0.05 * exact.max()

    def test_step(self):
        _, work = simulate(self.wall(dt_s=1e-4))
        assert work.contact_step_count == 6000
        _, work = simulate(self.wall(dt_s=1e-3))
        assert work.contact_step_count == 600

    def test_divergence_is_told(self):
        wall = load_scene("wall").changed(integrator="explicit-euler", dt_s=1e-3, n_per_m=1e6)
        with pytest.raises(ParameterError, match=r"explicit-euler diverged after .* s: .*--dt"):
            simulate(wall)

    def test_steps_that_are_too_long_are_counted(self):
        """A contact is left before it has grown without bound: nothing diverges, much is wrong."""
        wall = load_scene("wall").changed(integrator="explicit-euler", seconds=2)
        assert simulate(wall)[1].unstable_count == 0
        work = simulate(wall.changed(dt_s=1e-3))[1]
        assert work.unstable_count == work.contact_step_count == 2000

    def test_the_end_of_a_range_is_counted(self):
        recording, work = simulate(load_scene("taps").changed(n_per_m=1e7, seconds=1))
        force = recording.channels[0].stored
        assert work.saturated_count > 0 and force.max() == 32767

    def test_progress(self):
        calls: list[tuple[int, int]] = []
        simulate(load_scene("everything").changed(seconds=0.2), progress=lambda *a: calls.append(a))
        done, total = zip(*calls, strict=True)
        assert list(done) == sorted(done) and done[-1] == total[-1] == total[0]

    def test_too_much_is_refused_before_memory_grows(self):
        for name, limits in (("grasp", 36_000), ("sand", 36_000)):
            with pytest.raises(LimitError, match="shorter time"):
                simulate(load_scene(name).changed(seconds=limits))

    @pytest.mark.parametrize("name", BUILT_IN)
    @pytest.mark.parametrize(
        ("seconds", "rate"),
        [
            (0.003, 1000),
            (0.01, 44_100),
            *(pytest.param(*each, marks=pytest.mark.deep) for each in ((1e-9, 1), (1, 7))),
        ],
    )
    def test_short_and_odd(self, name, seconds, rate):
        scene = load_scene(name).changed(seconds=seconds, rate_hz=rate)
        recording, _ = simulate(scene)
        assert {len(c.stored) for c in recording.channels} == {max(round(seconds * rate), 1)}
