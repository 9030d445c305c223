"""What the integrators do: error and run time of one tap series, and energy of long bounces."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from math import inf, nan
from typing import NamedTuple

import numpy as np

from hapfmt.lab.scenes.contact import (
    INTEGRATORS,
    Drive,
    Motion,
    Samples,
    System,
    default_step_s,
    energy,
    integrate,
    work,
)
from report.section import Spread, spread

STYLUS = System(mass_kg=0.060, hand_n_per_m=250.0, hand_ns_per_m=3.0, contact_n_per_m=1e5)
STIFFNESSES = (1e2, 1e3, 1e4, 1e5)
LONG_STIFFNESSES = (*STIFFNESSES, 1e6, 1e7)
DEFAULTS = [name for name in INTEGRATORS if name != "explicit-euler"]
"""What a scene may be asked for; explicit Euler is there to be compared with."""

TICK_S = 1e-3
SECONDS = 0.512
COARSEST, FINEST, QUICK_FINEST = 4, -8, -6
"""Steps are 2^n ms: 16 ms to 4 us."""

REFERENCE = -9
"""2 us: the exact step; what halving it changes is stated."""

TAP_HZ, ABOVE_M, FORCE_N = 4.0, 2e-3, 1.0
RELIEF = ((40.0, 30e-6), (130.0, 10e-6))
"""The hand goes up and down between 2 mm above and what presses with 1 N at rest; under it the
surface moves as a texture does at 60 mm/s, (Hz, metres)."""


class Point(NamedTuple):
    """One integrator with one step. error: rms of the force's error over rms of the force, at 1 kHz
    or at every step where that is rarer. cpu: seconds per simulated second."""

    name: str
    stiffness: float
    step_s: float
    error: float
    cpu: Spread


class Reference(NamedTuple):
    """force: at 1 kHz, newtons. halving: what half the step changes, as an error of a Point."""

    force: Samples
    halving: float
    changes: int


class Long(NamedTuple):
    """A long run. gain, drift: the largest and the last relative excess of energy over that of the
    beginning plus the work put in. trace: the excess after each second."""

    name: str
    stiffness: float
    step_s: float
    cpu_s: float
    peak_m: float
    gain: float
    drift: float
    trace: list[float]


def taps(system: System, dt: float, steps: int, first: int = 0) -> Drive:
    """The hand and the surface, with their true velocities."""
    t = (first + np.arange(steps)) * dt
    deep = FORCE_N * (1 / system.hand_n_per_m + 1 / system.contact_n_per_m)
    w, half = 2 * np.pi * TAP_HZ, (ABOVE_M + deep) / 2
    return Drive(
        ABOVE_M - half + half * np.cos(w * t),
        -half * w * np.sin(w * t),
        sum(a * np.sin(2 * np.pi * hz * t) for hz, a in RELIEF),
        sum(a * 2 * np.pi * hz * np.cos(2 * np.pi * hz * t) for hz, a in RELIEF),
    )


def follow(
    system: System, drive: Drive, dt: float, name: str, z0: float | None = None, v0: float = 0.0
) -> Motion:
    """integrate() with the true velocities; what diverges does so in silence."""
    with np.errstate(all="ignore"):
        return integrate(
            system,
            drive.target,
            drive.surface,
            dt,
            name,
            z0,
            v0,
            target_velocity=drive.target_velocity,
            surface_velocity=drive.surface_velocity,
        )


def tapped(system: System, power: int, name: str) -> tuple[Samples, float]:
    """Force at 1 kHz, or at every step, of one run with steps of 2^power ms; and its CPU time."""
    dt = TICK_S * 2.0**power
    drive = taps(system, dt, round(SECONDS / dt) + 1)
    began = time.process_time()
    force = follow(system, drive, dt, name).force
    return force[:: 2 ** max(-power, 0)], time.process_time() - began


def relative(force: Samples, truth: Samples) -> float:
    """rms of the difference over rms of the truth; inf where the force is not finite."""
    with np.errstate(all="ignore"):
        error = float(np.sqrt(np.mean((force - truth) ** 2) / np.mean(truth**2)))
    return error if np.isfinite(error) else inf


def reference(stiffness: float) -> Reference:
    system = STYLUS._replace(contact_n_per_m=stiffness)
    force, finer = (tapped(system, REFERENCE - n, "exact")[0] for n in (0, 1))
    changes = int(np.sum(np.diff(finer > 0)))
    return Reference(finer, relative(force, finer), changes)


def points(stiffness: float, truth: Samples, finest: int, repeats: int) -> Iterator[Point]:
    """Every integrator with every step; repeats take turns, so that a slow minute hits all."""
    system = STYLUS._replace(contact_n_per_m=stiffness)
    powers = range(COARSEST, finest - 1, -1)
    cpu: dict[tuple[str, int], list[float]] = {}
    errors = {}
    for _ in range(repeats):
        for power in powers:
            for name in INTEGRATORS:
                force, seconds = tapped(system, power, name)
                cpu.setdefault((name, power), []).append(seconds / SECONDS)
                errors[name, power] = relative(force, truth[:: 2 ** max(power, 0)])
    for (name, power), seconds in cpu.items():
        step = TICK_S * 2.0**power
        yield Point(name, stiffness, step, errors[name, power], spread(seconds))


def bounce(stiffness: float, name: str, seconds: float, dt: float | None = None) -> Long:
    """Let go 2 mm above the surface with no damping at all: the energy should stay as it is."""
    system = STYLUS._replace(contact_n_per_m=stiffness, hand_ns_per_m=0.0)

    def still(_first: int, steps: int, _dt: float) -> Drive:
        zero = np.zeros(steps)
        return Drive(zero, zero, zero, zero)

    return long(system, still, name, seconds, dt, ABOVE_M)


def tapping(stiffness: float, name: str, seconds: float, dt: float | None = None) -> Long:
    """The taps, with the hand's damping: energy beyond what hand and surface put in is a gain."""
    system = STYLUS._replace(contact_n_per_m=stiffness)
    return long(system, lambda n, steps, dt: taps(system, dt, steps, n), name, seconds, dt, None)


def long(
    system: System,
    drive_at: Callable[[int, int, float], Drive],
    name: str,
    seconds: float,
    dt: float | None,
    z0: float | None,
) -> Long:
    """Second by second, until its end or until the mass is 1 m away."""
    dt = default_step_s(system, name) if dt is None else dt
    steps = round(1 / dt)
    z, v, put_in, first_energy, peak_energy, peak = z0, 0.0, 0.0, nan, 0.0, 0.0
    over, trace = [], []
    began = time.process_time()
    for second in range(round(seconds)):
        drive = drive_at(second * steps, steps + 1, dt)
        motion = follow(system, drive, dt, name, z, v)
        joules = energy(system, drive, motion.z, motion.v)
        done = work(system, drive, motion, dt) + put_in
        if second == 0:
            first_energy = float(joules[0])
        with np.errstate(all="ignore"):
            excess = joules - done - first_energy
            over.append(float(np.nanmax(excess)))
            trace.append(float(excess[-1]))
            peak_energy = max(peak_energy, float(joules.max()))
            peak = max(peak, float(np.abs(motion.z).max()))
        z, v, put_in = float(motion.z[-1]), float(motion.v[-1]), float(done[-1])
        if not peak < 1:
            peak, over, trace = inf, [inf], [inf]
            break
    scale = first_energy if z0 is not None else peak_energy
    return Long(
        name,
        system.contact_n_per_m,
        dt,
        time.process_time() - began,
        peak,
        max(over) / scale,
        trace[-1] / scale,
        [x / scale for x in trace],
    )
