"""A mass against a contact: as stable as stated, as exact as stated, and no energy from nothing."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.errors import ParameterError
from hapfmt.lab.scenes import stylus
from hapfmt.lab.scenes.contact import (
    INTEGRATORS,
    Drive,
    System,
    contact_force,
    default_step_s,
    energy,
    integrate,
    work,
)
from hapfmt.lab.scenes.description import Stroke
from hapfmt.lab.scenes.motion import StepGrid, StrokeMotion

STYLUS = System(0.060, 250.0, 3.0, 1e5)
SYSTEMS = [
    STYLUS,
    STYLUS._replace(contact_n_per_m=1e2),
    STYLUS._replace(contact_ns_per_m=20.0),
    STYLUS._replace(hand_ns_per_m=40.0),
    STYLUS._replace(hand_ns_per_m=0.0),
    System(2.0, 30.0, 500.0, 40.0, 1000.0),
]
BOUNDED = [name for name, one in INTEGRATORS.items() if one.limit_s(STYLUS) < inf]
PASSIVE = [name for name, one in INTEGRATORS.items() if not one.gains]
FIT = [name for name in INTEGRATORS if name != "explicit-euler"]
STIFF = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7]


def held(system, touching, steps):
    """A drive whose rest is z = 0, far from where the contact changes."""
    surface = 1.0 if touching else -1.0
    target = -system.contact_n_per_m / system.hand_n_per_m if touching else 0.0
    return Drive(np.full(steps, target), np.zeros(steps), np.full(steps, surface), np.zeros(steps))


def spectral_radius(name, system, touching, dt):
    """Of the step's own matrix, read off the step."""
    step = INTEGRATORS[name].make(system, held(system, touching, 2), dt)
    rest = np.array(step(0, 0.0, 0.0))
    small = 1e-6
    columns = [(np.array(step(0, *x)) - rest) / small for x in ((small, 0.0), (0.0, small))]
    return max(abs(np.linalg.eigvals(np.array(columns).T)))


def mode_limit(name, system, touching):
    return INTEGRATORS[name].limit(*system.mode(touching))


class TestStability:
    @pytest.mark.parametrize("system", SYSTEMS)
    @pytest.mark.parametrize("name", BOUNDED)
    def test_the_limit_is_where_the_spectral_radius_passes_1(self, name, system):
        for touching in (False, True):
            limit = mode_limit(name, system, touching)
            if not limit:
                assert spectral_radius(name, system, touching, 1e-5) > 1
                continue
            for below in (0.999, 0.7, 0.3, 0.03):
                assert spectral_radius(name, system, touching, below * limit) < 1 + 1e-8
            for above in (1.001, 1.3, 3):
                assert spectral_radius(name, system, touching, above * limit) > 1 + 1e-7

    @pytest.mark.parametrize("system", SYSTEMS)
    @pytest.mark.parametrize("name", PASSIVE)
    def test_no_limit(self, name, system):
        for touching in (False, True):
            assert mode_limit(name, system, touching) == inf
            for radians in (0.01, 0.3, 2, 30):
                dt = radians / system.fastest_rad_per_s
                assert spectral_radius(name, system, touching, dt) < 1 + 1e-6

    @pytest.mark.parametrize("name", BOUNDED)
    def test_runs_just_below_and_above(self, name):
        """Pressed against the surface and pushed by 1 nm: 2 % decide."""
        steps = 4000
        system = System(0.060, 250.0, 10.0, 1e3)

        def run(factor):
            dt = factor * INTEGRATORS[name].limit_s(system)
            drive = held(system, True, steps)
            motion = integrate(system, drive.target, drive.surface, dt, name, z0=1e-9)
            return np.abs(motion.z[-100:]).max()

        assert run(0.98) < 1e-9
        assert run(1.02) > 1e-6

    def test_formulas_of_the_undamped_contact(self):
        system = STYLUS._replace(hand_ns_per_m=0.0)
        w = system.fastest_rad_per_s
        assert INTEGRATORS["explicit-euler"].limit_s(system) == 0
        assert INTEGRATORS["semi-implicit"].limit_s(system) == pytest.approx(2 / w)
        assert INTEGRATORS["rk4"].limit_s(system) == pytest.approx(2 * sqrt(2) / w)

    def test_a_free_mass_is_always_stable(self):
        system = System(1.0, 0.0, 0.0, 0.0)
        assert all(one.limit_s(system) == inf for one in INTEGRATORS.values())
        for name in INTEGRATORS:
            motion = integrate(system, np.zeros(11), np.zeros(11), 0.1, name, z0=1.0, v0=2.0)
            assert motion.z[-1] == pytest.approx(3.0) and not motion.force.any()

    def test_with_a_millisecond_the_naive_step_diverges_and_the_others_do_not(self):
        """Row 20."""
        target, surface = np.full(2000, -5e-3), np.zeros(2000)
        naive = integrate(STYLUS, target, surface, 1e-3, "explicit-euler", z0=1e-3)
        assert np.abs(naive.z).max() > 1
        for name in PASSIVE:
            motion = integrate(STYLUS, target, surface, 1e-3, name, z0=1e-3)
            assert np.abs(motion.z).max() < 6e-3


def waves(steps, dt, down):
    """Taps at 3 Hz on a surface that moves; true velocities."""
    t = np.arange(steps) * dt
    w, q, a, b = 2 * np.pi * 3, 2 * np.pi * 31, 1.2e-3, 1e-4
    return Drive(
        a * np.cos(w * t) - down, -a * w * np.sin(w * t), b * np.sin(q * t), b * q * np.cos(q * t)
    )


def moved(system, drive, dt, name="exact", **start):
    return integrate(
        system,
        drive.target,
        drive.surface,
        dt,
        name,
        target_velocity=drive.target_velocity,
        surface_velocity=drive.surface_velocity,
        **start,
    )


def independent(system, seconds, down):
    """The end of the same taps by DOP853 with its own search for events."""
    from scipy.integrate import solve_ivp

    mass, hand, damper, k, c = system

    def inputs(t):
        w, q, a, b = 2 * np.pi * 3, 2 * np.pi * 31, 1.2e-3, 1e-4
        return (
            a * np.cos(w * t) - down,
            -a * w * np.sin(w * t),
            b * np.sin(q * t),
            b * q * np.cos(q * t),
        )

    def slope(t, state, touching):
        x, x_rate, s, s_rate = inputs(t)
        force = hand * (x - state[0]) + damper * (x_rate - state[1])
        if touching:
            force += k * (s - state[0]) + c * (s_rate - state[1])
        return [state[1], force / mass]

    def push(t, state, _touching):
        _, _, s, s_rate = inputs(t)
        return k * (s - state[0]) + min(c * (s_rate - state[1]), 0)

    push.terminal = True
    t, state, touching, changes = 0.0, [inputs(0)[0], 0.0], False, 0
    while t < seconds:
        push.direction = -1 if touching else 1
        done = solve_ivp(
            slope,
            (t, seconds),
            state,
            "DOP853",
            rtol=1e-11,
            atol=1e-14,
            max_step=2e-3,
            events=push,
            args=(touching,),
        )
        t, state = done.t[-1], done.y[:, -1]
        if done.status == 1:
            touching, changes = not touching, changes + 1
    return state, changes


class TestExactness:
    @pytest.mark.parametrize("damping", [0.0, 5.0])
    def test_exact_agrees_with_an_independent_solver(self, damping):
        system = STYLUS._replace(contact_n_per_m=1e4, contact_ns_per_m=damping)
        state, changes = independent(system, 0.25, 5e-4)
        assert changes > 4
        motion = moved(system, waves(5001, 50e-6, 5e-4), 50e-6)
        assert motion.z[-1] == pytest.approx(state[0], abs=1e-10)
        assert motion.v[-1] == pytest.approx(state[1], abs=1e-7)

    @pytest.mark.parametrize("name", INTEGRATORS)
    def test_order_in_smooth_motion(self, name):
        system = STYLUS._replace(contact_n_per_m=1e4, contact_ns_per_m=5.0)
        rest = -0.05 * 250 / 10_250
        fine, seconds = 2**15, 0.125
        truth = moved(system, waves(fine + 1, seconds / fine, 0.05), seconds / fine, z0=rest)
        assert truth.force.min() > 0
        errors = []
        for steps in (512, 1024):
            drive = waves(steps + 1, seconds / steps, 0.05)
            motion = moved(system, drive, seconds / steps, name, z0=rest)
            errors.append(np.abs(motion.z - truth.z[:: fine // steps]).max())
        assert np.log2(errors[0] / errors[1]) == pytest.approx(INTEGRATORS[name].order, abs=0.25)

    @pytest.mark.parametrize("name, order", [("semi-implicit", 1), ("trapezoid", 2), ("exact", 4)])
    def test_order_across_impacts(self, name, order):
        """With rough steps and a soft contact: else "exact" is at its rounding."""
        system, seconds, fine = STYLUS._replace(contact_n_per_m=1e3), 0.5, 2**14
        truth = moved(system, waves(fine + 1, seconds / fine, 5e-4), seconds / fine)
        assert np.sum(np.diff(truth.force > 0)) > 4
        steps = np.array([256, 512, 1024, 2048])
        errors = []
        for n in steps.tolist():
            motion = moved(system, waves(n + 1, seconds / n, 5e-4), seconds / n, name)
            errors.append(np.sqrt(np.mean((motion.z - truth.z[:: fine // n]) ** 2)))
        slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(order, abs=0.5)

    def test_velocities_not_given_are_those_of_the_paths(self):
        drive = waves(4001, 50e-6, 5e-4)
        plain = integrate(STYLUS, drive.target, drive.surface, 50e-6)
        assert np.abs(plain.z - moved(STYLUS, drive, 50e-6).z).max() < 1e-7

    @pytest.mark.parametrize("name", INTEGRATORS)
    def test_blocks_carry_on(self, name):
        drive = waves(2001, 20e-6, 5e-4)
        whole = moved(STYLUS, drive, 20e-6, name, v0=-0.1)
        head = moved(STYLUS, Drive(*(x[:1201] for x in drive)), 20e-6, name, v0=-0.1)
        tail = moved(
            STYLUS, Drive(*(x[1200:] for x in drive)), 20e-6, name, z0=head.z[-1], v0=head.v[-1]
        )
        for every, first, second in zip(whole, head, tail, strict=True):
            assert np.allclose(every, np.concatenate([first, second[1:]]), rtol=0, atol=1e-9)

    def test_agrees_with_the_stylus(self):
        """Which notices contact up to a step late: closer, the smaller its steps."""
        worst = []
        stiff = 1e4
        system = System(0.060, 250.0, 3.0, stiff)
        for per_tick in (20, 200):
            grid = StepGrid(300, per_tick, 1000)
            hand = StrokeMotion(Stroke(), grid, np.random.default_rng(1))
            target = hand.height(grid.times(0, grid.steps), 1 / 250 + 1 / stiff)
            rate, still = np.gradient(target, grid.dt_s), np.zeros(grid.steps)
            force = stylus.held(
                system, target, still, grid.dt_s, "exact", None, 0.0,
                target_velocity=rate, surface_velocity=still,
            ).force  # fmt: skip
            motion = integrate(system, target, still, grid.dt_s)
            worst.append(np.abs(motion.force - force).max())
        assert motion.force.max() > 0.5
        assert worst[1] < worst[0] / 5 and worst[1] < 0.02


def dropped(system, name, dt, steps, height=2e-3, down=0.0):
    """Energy of a mass let go above a surface that rests, under a hand that rests."""
    still = np.zeros(steps)
    drive = Drive(still - down, still, still, still)
    motion = moved(system, drive, dt, name, z0=height)
    return energy(system, drive, motion.z, motion.v), motion


class TestEnergy:
    @pytest.mark.parametrize("stiffness", STIFF)
    @pytest.mark.parametrize("name", ["trapezoid", "exact"])
    def test_kept_without_damping(self, name, stiffness):
        system = System(0.060, 250.0, 0.0, stiffness)
        dt = default_step_s(system, name)
        joules, motion = dropped(system, name, dt, 10_000, height=3e-4)
        assert np.sum(np.diff(motion.force > 0)) >= 1
        assert np.abs(joules / joules[0] - 1).max() < 1e-10

    @pytest.mark.parametrize("name", INTEGRATORS)
    def test_gained_where_it_is_said(self, name):
        """At the first impact after flight, without hand: what flew in against what flies off."""
        system = System(0.060, 0.0, 0.0, 1e5)
        ratios = []
        for late in np.linspace(0, 1, 9):
            still = np.zeros(40)
            dt = 0.3 / system.fastest_rad_per_s
            motion = integrate(system, still, still, dt, name, z0=late * 0.1 * dt, v0=-0.1)
            ratios.append((motion.v[-1] / 0.1) ** 2)
        assert bool(max(ratios) > 1 + 1e-6) is INTEGRATORS[name].gains

    @given(
        name=st.sampled_from(PASSIVE),
        stiffness=st.floats(10, 1e7),
        hand=st.floats(0, 1e3),
        dampings=st.tuples(st.floats(0, 50), st.floats(0, 300)),
        radians=st.floats(1e-3, 30),
        height=st.floats(-1e-3, 1e-3),
        speed=st.floats(-1, 1),
        down=st.floats(-1e-3, 1e-2),
    )
    def test_never_grows_by_itself(
        self, name, stiffness, hand, dampings, radians, height, speed, down
    ):
        system = System(0.060, hand, dampings[0], stiffness, dampings[1])
        dt = radians / system.fastest_rad_per_s
        still = np.zeros(60)
        drive = Drive(still - down, still, still, still)
        motion = moved(system, drive, dt, name, z0=height, v0=speed)
        joules = energy(system, drive, motion.z, motion.v)
        assert np.diff(joules).max() <= 1e-11 * joules[0] + 1e-30

    @pytest.mark.parametrize("name", FIT)
    def test_grows_by_the_work_of_hand_and_surface(self, name):
        dt = 5e-6
        drive = waves(80_001, dt, 5e-4)
        motion = moved(STYLUS, drive, dt, name)
        joules = energy(STYLUS, drive, motion.z, motion.v)
        excess = joules - joules[0] - work(STYLUS, drive, motion, dt)
        assert excess.max() < 0.01 * joules.max()

    def test_a_surface_left_in_vain_gives_nothing_back(self):
        """The damper lets go while the spring is compressed: a whole step of that gained energy."""
        system = System(0.060, 2.0, 0.0, 10.0, 1.0)
        joules, _ = dropped(system, "exact", 11 / system.fastest_rad_per_s, 60, height=4e-5)
        assert np.diff(joules).max() <= 1e-12 * joules[0]

    def test_at_rest_on_the_very_surface(self):
        """Where every rounding is a change of contact."""
        still = np.zeros(2000)
        motion = integrate(STYLUS, still, still, 1e-3, z0=1e-3)
        assert np.abs(motion.z[-100:]).max() < 1e-20

    @pytest.mark.parametrize("stiffness", STIFF)
    @pytest.mark.parametrize("name", FIT)
    def test_a_tap_with_the_default_step(self, name, stiffness):
        self.stays(name, stiffness, 0.3)

    @pytest.mark.deep
    @pytest.mark.parametrize("name", FIT)
    def test_a_minute_with_the_default_step(self, name):
        self.stays(name, 1e5, 60.0)

    def stays(self, name, stiffness, seconds):
        """Taps with the stylus: no higher than the hand, and at most a bounce's force."""
        system = STYLUS._replace(contact_n_per_m=stiffness)
        dt = default_step_s(system, name)
        drive = waves(round(seconds / dt), dt, 5e-4)
        motion = moved(system, drive, dt, name)
        assert np.abs(motion.z).max() < 3e-3
        assert motion.force.max() < 0.3 * sqrt(stiffness * 0.060) + 1


def test_force_pushes_and_never_pulls():
    system = System(1.0, 0.0, 0.0, 100.0, 10.0)
    still = np.zeros(4)
    z = np.array([0.1, -0.1, -0.1, -0.1])
    v = np.array([-5.0, 0.0, -1.0, 2.0])
    assert contact_force(system, Drive(*(still,) * 4), z, v).tolist() == [0, 10, 20, 0]


def test_one_step_and_its_defaults():
    motion = integrate(STYLUS, np.array([0.5]), np.array([0.0]), 1e-3)
    assert [x.tolist() for x in motion] == [[0.5], [0.0], [0.0]]
    assert default_step_s(STYLUS) == 50e-6
    assert default_step_s(STYLUS._replace(contact_n_per_m=1e7)) == pytest.approx(
        0.1 / sqrt(1e7 / 0.06), rel=1e-4
    )
    assert default_step_s(STYLUS, "explicit-euler") == pytest.approx(3 / 100_250 / 2)


def test_refused():
    still = np.zeros(3)
    for system, arguments, message in (
        (STYLUS, (still, still, 1e-3, "magic"), "magic"),
        (STYLUS, (still, still, 0.0), "step above 0"),
        (STYLUS, (still, still, float("nan")), "step above 0"),
        (STYLUS, (still, np.zeros(2), 1e-3), "as many targets"),
        (STYLUS, (np.zeros(0), np.zeros(0), 1e-3), "as many targets"),
        (STYLUS._replace(mass_kg=0.0), (still, still, 1e-3), "mass above 0"),
        (STYLUS._replace(hand_n_per_m=-1.0), (still, still, 1e-3), "mass above 0"),
        (STYLUS._replace(contact_n_per_m=inf), (still, still, 1e-3), "finite"),
        (System(1.0, 1.0, 1.0, 0.0, 1.0), (still, still, 1e-3), "needs a spring"),
    ):
        with pytest.raises(ParameterError, match=message):
            integrate(system, *arguments)
    with pytest.raises(ParameterError, match="as many steps"):
        integrate(STYLUS, still, still, 1e-3, target_velocity=np.zeros(2))
    with pytest.raises(ParameterError, match="without damping"):
        default_step_s(STYLUS._replace(hand_ns_per_m=0.0), "explicit-euler")
