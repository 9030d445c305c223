"""A mass on the spring and damper of the hand, pressed against a unilateral spring and damper.

    m z'' = hand (target - z) + hand_damping (target' - z') + f,
    f     = contact gap + contact_damping gap'   while gap = surface - z > 0 and f > 0, else 0.

z, target and surface are heights in metres. The mass touches from above. The contact pushes and
never pulls, so a damped contact separates while its spring is still compressed.

This file also holds the exact solver. Both modes, free and touching, are linear, and the drive is a
cubic, so a step within a mode is a matrix exponential. If a step begins and ends in different
modes, the solver finds the moment of change and integrates the pieces separately. A step that
begins and ends in the same mode has the energy of that mode at both ends. So even an undetected
touch within a step gains no energy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import factorial, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import ParameterError
from .matrix import exponential

Samples = NDArray[np.float64]


class System(NamedTuple):
    """Mass, hand and contact; a contact of 0 N/m is none."""

    mass_kg: float
    hand_n_per_m: float
    hand_ns_per_m: float
    contact_n_per_m: float
    contact_ns_per_m: float = 0.0

    def mode(self, touching: bool) -> tuple[float, float]:
        """Stiffness and damping per mass, (1/s^2, 1/s): z'' = -stiffness z - damping z' + drive."""
        stiffness, damping = self.hand_n_per_m, self.hand_ns_per_m
        if touching:
            stiffness, damping = stiffness + self.contact_n_per_m, damping + self.contact_ns_per_m
        return stiffness / self.mass_kg, damping / self.mass_kg

    @property
    def fastest_rad_per_s(self) -> float:
        """Natural frequency in contact, without damping."""
        return sqrt(self.mode(True)[0])

    def check(self) -> None:
        """Raise ParameterError for what no body is."""
        if not all(map(isfinite, self)) or self.mass_kg <= 0 or min(self[1:]) < 0:
            raise ParameterError(
                "a system needs a mass above 0 and springs and dampers from 0 on, all finite"
            )
        if self.contact_ns_per_m and not self.contact_n_per_m:
            raise ParameterError("a contact that damps needs a spring")


class Drive(NamedTuple):
    """What moves the system: [steps] each, metres and m/s, at the beginning of each step.

    Between two steps both follow the cubic of their ends (Hermite).
    """

    target: Samples
    target_velocity: Samples
    surface: Samples
    surface_velocity: Samples


class Motion(NamedTuple):
    """[steps] each, at the beginning of each step: metres, m/s, newtons on the surface."""

    z: Samples
    v: Samples
    force: Samples


def contact_force(system: System, drive: Drive, z: Samples, v: Samples) -> Samples:
    """Newtons on the surface, [steps]."""
    with np.errstate(invalid="ignore", over="ignore"):
        gap, rate = drive.surface - z, drive.surface_velocity - v
        force = system.contact_n_per_m * gap + system.contact_ns_per_m * rate
        return np.where(gap > 0, np.maximum(force, 0), 0.0)


def energy(system: System, drive: Drive, z: Samples, v: Samples) -> Samples:
    """Joules in the mass and both springs, [steps]."""
    with np.errstate(invalid="ignore", over="ignore"):
        gap = np.maximum(drive.surface - z, 0)
        stretch = drive.target - z
        springs = system.hand_n_per_m * stretch**2 + system.contact_n_per_m * gap**2
        return (system.mass_kg * v**2 + springs) / 2


def work(system: System, drive: Drive, motion: Motion, dt_s: float) -> Samples:
    """Joules that hand and surface have put in since the first step, [steps]; trapezoid rule.

    A passive system has ``energy <= energy[0] + work`` at every step.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        pull = system.hand_n_per_m * (drive.target - motion.z)
        pull += system.hand_ns_per_m * (drive.target_velocity - motion.v)
        power = pull * drive.target_velocity + motion.force * drive.surface_velocity
        done = np.cumsum((power[1:] + power[:-1]) * (dt_s / 2))
        return np.concatenate([[0.0], done])


PIECE_RAD = 0.5
TERMS = 16
"""A piece is at most half a radian long, where 16 terms of a Taylor series leave 1e-18."""

CHANGES = 100
"""Of contact in one step; what comes after is walked in one mode."""

Coefficients = NDArray[np.float64]


class Mode(NamedTuple):
    """z'' = -stiffness z - damping z' + drive; [4, steps - 1] drive, powers of time in seconds."""

    stiffness: float
    damping: float
    drive: Coefficients


def exact_step(
    system: System, drive: Drive, dt: float
) -> Callable[[int, float, float], tuple[float, float]]:
    """(n, z, v) at the beginning of step n -> (z, v) at its end."""
    target, surface = (
        cubic(drive.target, drive.target_velocity, dt),
        cubic(drive.surface, drive.surface_velocity, dt),
    )
    hand = pull(target, system.hand_n_per_m, system.hand_ns_per_m) / system.mass_kg
    base = pull(surface, system.contact_n_per_m, system.contact_ns_per_m) / system.mass_kg
    modes = Mode(*system.mode(False), hand), Mode(*system.mode(True), hand + base)
    (a, b, c, d), free_z, free_v = propagator(modes[0], dt)
    (e, f, g, h), held_z, held_v = propagator(modes[1], dt)
    s, w = drive.surface.tolist(), drive.surface_velocity.tolist()
    k, damper = system.contact_n_per_m, system.contact_ns_per_m
    walk = walker(system, modes, surface, dt)

    def step(n: int, z: float, v: float) -> tuple[float, float]:
        gap, rate = s[n] - z, w[n] - v
        touching = gap > 0 and k * gap + damper * rate > 0
        if touching:
            end_z, end_v = e * z + f * v + held_z[n], g * z + h * v + held_v[n]
        else:
            end_z, end_v = a * z + b * v + free_z[n], c * z + d * v + free_v[n]
        end = s[n + 1] - end_z
        if touching:
            fits = end > 0 and k * end + damper * (w[n + 1] - end_v) > 0 and gap + dt * rate > 0
        else:
            fits = end <= 0 and gap + dt * rate <= 0
        if fits:
            return end_z, end_v
        return walk(n, z, v, touching)

    return step


def cubic(path: Samples, rate: Samples, dt: float) -> Coefficients:
    """[4, steps - 1]: powers of the time since the beginning of each step, in seconds."""
    slope = np.diff(path) / dt
    start, end = rate[:-1], rate[1:]
    return np.stack(
        [
            path[:-1],
            start,
            (3 * slope - 2 * start - end) / dt,
            (start + end - 2 * slope) / dt**2,
        ]
    )


def pull(path: Coefficients, spring: float, damper: float) -> Coefficients:
    """spring x + damper x' of a cubic, as a cubic."""
    force = spring * path
    force[:-1] += damper * path[1:] * np.array([[1.0], [2.0], [3.0]])
    return force


def propagator(mode: Mode, dt: float) -> tuple[list[float], list[float], list[float]]:
    """((p, q, r, s), x, y): a step takes (z, v) to (p z + q v + x[n], r z + s v + y[n]).

    Both come from the exponential of one matrix, for (z / dt, v) and the drive's four derivatives.
    The derivatives are scaled by dt, so that all entries have a similar size.
    """
    matrix = np.zeros((6, 6))
    matrix[0, 1] = 1
    matrix[1, :3] = -mode.stiffness * dt * dt, -mode.damping * dt, 1
    matrix[2:5, 3:] = np.eye(3)
    exact = exponential(matrix)
    scale = np.array([factorial(j) * dt ** (j + 1) for j in range(4)])
    pushed = (exact[:2, 2:] * scale) @ mode.drive
    step = [exact[0, 0], exact[0, 1] * dt, exact[1, 0] / dt, exact[1, 1]]
    return list(map(float, step)), (pushed[0] * dt).tolist(), pushed[1].tolist()


def walker(
    system: System, modes: tuple[Mode, Mode], surface: Coefficients, dt: float
) -> Callable[[int, float, float, bool], tuple[float, float]]:
    """A step with changes of contact in it."""
    k, damper = system.contact_n_per_m, system.contact_ns_per_m
    lengths = [PIECE_RAD / max(sqrt(mode.stiffness), mode.damping, 1e-9) for mode in modes]

    def walk(n: int, z: float, v: float, touching: bool) -> tuple[float, float]:
        done, changes = 0.0, 0
        floor = surface[:, n].tolist()
        while done < dt:
            mode = modes[touching]
            piece = min(lengths[touching], dt - done)
            path = taylor(mode, z, v, shifted(mode.drive[:, n].tolist(), done))
            gap = [-x for x in path]
            for j, x in enumerate(shifted(floor, done)):
                gap[j] += x

            def push(t: float, gap: list[float] = gap) -> float:
                depth, speed = value(gap, t)
                return k * depth + min(damper * speed, 0.0)

            def rate(t: float, gap: list[float] = gap) -> float:
                return value(gap, t)[1]

            moment = change(push, rate, touching, piece) if changes < CHANGES else None
            if moment is not None:
                piece, changes = moment, changes + 1
            z, v = value(path, piece)
            done = dt if piece == dt - done else done + piece
            touching ^= moment is not None
        return z, v

    return walk


def change(
    push: Callable[[float], float], rate: Callable[[float], float], touching: bool, piece: float
) -> float | None:
    """When the mode changes first within a piece, if it does. The gap turns at most once in it;
    before and after, it changes where the mode fits one end and not the other. Right after a change
    ``push`` is 0 give or take a rounding, and need not fit the beginning."""

    def fits(t: float) -> bool:
        return (push(t) > 0) is touching

    if fits(piece) and not fits(0.0):
        return None
    parts = [0.0, piece]
    if rate(0.0) * rate(piece) < 0:
        parts.insert(1, crossing(rate, 0.0, piece))
    for start, end in pairwise(parts):
        if not fits(end):
            return crossing(push, start, end) if fits(start) else start
    return None


def taylor(mode: Mode, z: float, v: float, drive: Sequence[float]) -> list[float]:
    """Coefficients of the path from (z, v), in powers of seconds."""
    path = [z, v]
    for j in range(TERMS - 2):
        a = -mode.stiffness * path[j] - mode.damping * (j + 1) * path[j + 1]
        if j < 4:
            a += drive[j]
        path.append(a / ((j + 1) * (j + 2)))
    return path


def shifted(c: Sequence[float], t: float) -> tuple[float, float, float, float]:
    """The cubic as seen from ``t`` on."""
    c0, c1, c2, c3 = c
    return (
        c0 + t * (c1 + t * (c2 + t * c3)),
        c1 + t * (2 * c2 + 3 * t * c3),
        c2 + 3 * t * c3,
        c3,
    )


def value(path: Sequence[float], t: float) -> tuple[float, float]:
    """Value and derivative of a polynomial."""
    x = rate = 0.0
    for c in reversed(path):
        rate = rate * t + x
        x = x * t + c
    return x, rate


def crossing(of: Callable[[float], float], start: float, end: float) -> float:
    """Where a function changes sign, to a rounding (regula falsi, Illinois)."""
    low, high = of(start), of(end)
    for _ in range(100):
        if high == low:
            break
        t = end - high * (end - start) / (high - low)
        if not min(start, end) < t < max(start, end):
            break
        middle = of(t)
        if (middle > 0) is (high > 0):
            low /= 2
        else:
            start, low = end, high
        end, high = t, middle
    return start if abs(low) < abs(high) else end
