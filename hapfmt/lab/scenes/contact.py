"""A mass on the spring and damper of the hand, pressed against a unilateral spring and damper.

    m z'' = hand (target - z) + hand_damping (target' - z') + f,
    f     = contact gap + contact_damping gap'   while gap = surface - z > 0 and f > 0, else 0.

z, target and surface are heights in metres. The mass touches from above. The contact pushes and
never pulls, so a damped contact separates while its spring is still compressed.

The exact solver: both modes, free and touching, are linear, and the drive is a
cubic, so a step within a mode is a matrix exponential. If a step begins and ends in different
modes, the solver finds the moment of change and integrates the pieces separately. A step that
begins and ends in the same mode has the energy of that mode at both ends. So even an undetected
touch within a step gains no energy.

Six integrators take one step of the mass:

=============  =====  =======================================================  =============
name           order  largest stable step, of either mode (w: rad/s, c: Ns/m)  at impact
=============  =====  =======================================================  =============
explicit-euler 1      c / k; overdamped: 2 / fastest eigenvalue                gains energy
semi-implicit  1      4 / (d + sqrt(d^2 + 4 w^2)), d = c / m: 2 / w undamped   gains energy
implicit       1      none                                                     loses energy
trapezoid      2      none                                                     keeps energy
rk4            4      |R(step eigenvalue)| = 1: 2 sqrt(2) / w undamped         gains energy
exact          4      none                                                     keeps energy
=============  =====  =======================================================  =============

The order holds for smooth motion. At a change of contact the force has a kink, and all but "exact"
fall to order 2 at most. "trapezoid" is the implicit midpoint rule in smooth motion. A midpoint rule
gains energy if the contact begins or ends within a step. So "trapezoid" takes the difference
quotient of the contact's potential as its force, a discrete gradient: Gonzalez, J. Nonlinear Sci.
6, 1996, doi:10.1007/BF02440162; for collisions Chatziioannou and van Walstijn, J. Sound Vib. 339,
2015, doi:10.1016/j.jsv.2014.11.017. The energy then changes exactly by the work of hand and
surface, at any step. For a spring this is a quadratic equation with one valid root, without
iteration.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import factorial, inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import ParameterError
from .linear import exponential

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
        """Raise ParameterError for values that no body has."""
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
"""Most changes of contact in one step; the rest of the step has one mode."""

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


__all__ = ["INTEGRATORS", "Integrator", "Motion", "System", "default_step_s", "integrate"]

Step = Callable[[int, float, float], tuple[float, float]]
"""(n, z, v) at the beginning of step n -> (z, v) at its end."""

STEP_S = 50e-6
STEPS_PER_RADIAN = 10
"""Steps of a scene: 20 kHz, or 10 per radian of the contact's natural frequency where that is more,
from 240 kN/m on with 60 g."""


BLOCK = 1 << 15
"""Steps for which the drive is laid out at a time: a few MB of Python's floats."""


@dataclass(frozen=True)
class Integrator:
    """make: system, drive and step in seconds -> the step. limit: stiffness and damping per mass,
    (1/s^2, 1/s), -> seconds. gains: whether energy can grow at an impact."""

    name: str
    order: int
    gains: bool
    limit: Callable[[float, float], float]
    make: Callable[[System, Drive, float], Step]

    def limit_s(self, system: System) -> float:
        """Largest step with which no mode grows, in seconds; inf where there is none, and 0 where
        no step is stable."""
        return min(self.limit(*system.mode(touching)) for touching in (False, True))


def integrate(
    system: System,
    target: Samples,
    surface: Samples,
    dt_s: float,
    integrator: str = "exact",
    z0: float | None = None,
    v0: float = 0.0,
    *,
    target_velocity: Samples | None = None,
    surface_velocity: Samples | None = None,
) -> Motion:
    """The motion of the mass, [steps], that begins at ``z0`` (None: at the target) with ``v0``.

    target, surface: [steps], metres. The velocities are those of ``np.gradient`` where not given;
    given true ones, smooth motion converges with the order of the integrator, else with 2 at most.
    Steps beyond ``limit_s`` are taken as asked for, and diverge.
    """
    system.check()
    method = find(integrator)
    if not (0 < dt_s < inf and target.ndim == 1 and target.size and target.shape == surface.shape):
        raise ParameterError("a motion needs a step above 0 s and as many targets as surfaces")

    def rate(of: Samples, given: Samples | None) -> Samples:
        if given is None:
            return np.gradient(of, dt_s) if of.size > 1 else np.zeros_like(of)
        if given.shape != of.shape:
            raise ParameterError("a velocity needs as many steps as its path")
        return given

    drive = Drive(target, rate(target, target_velocity), surface, rate(surface, surface_velocity))
    z, v = np.empty(target.size), np.empty(target.size)
    z[0], v[0] = target[0] if z0 is None else z0, v0
    for first in range(0, target.size - 1, BLOCK):
        part = slice(first, first + BLOCK + 1)
        step = method.make(system, Drive(*(x[part] for x in drive)), dt_s)
        path = [(float(z[first]), float(v[first]))]
        for n in range(z[part].size - 1):
            path.append(step(n, *path[n]))
        z[part], v[part] = np.array(path).T
    return Motion(z, v, contact_force(system, drive, z, v))


def find(name: str) -> Integrator:
    """The integrator of that name."""
    if name not in INTEGRATORS:
        known = ", ".join(INTEGRATORS)
        raise ParameterError(f"no integrator is called {name!r}; there are: {known}")
    return INTEGRATORS[name]


def default_step_s(system: System, integrator: str = "exact") -> float:
    """50 us, or a tenth of a radian in contact, or half the largest stable step: the least."""
    step = min(STEP_S, 1 / (STEPS_PER_RADIAN * max(system.fastest_rad_per_s, 1e-9)))
    step = min(step, find(integrator).limit_s(system) / 2)
    if not (isfinite(step) and step > 0):
        raise ParameterError(f"no step of {integrator} is stable without damping")
    return step


def pulls(system: System, drive: Drive) -> Samples:
    """Acceleration by the hand at z = 0, v = 0; [steps], m/s^2."""
    pull = system.hand_n_per_m * drive.target + system.hand_ns_per_m * drive.target_velocity
    return pull / system.mass_kg


def explicit_euler(system: System, drive: Drive, dt: float) -> Step:
    """Position and velocity both move with what they were."""
    accelerate = acceleration(system)
    u, s, w = pulls(system, drive).tolist(), drive.surface.tolist(), drive.surface_velocity.tolist()

    def step(n: int, z: float, v: float) -> tuple[float, float]:
        return z + dt * v, v + dt * accelerate(z, v, u[n], s[n], w[n])

    return step


def semi_implicit(system: System, drive: Drive, dt: float) -> Step:
    """Symplectic Euler: the velocity first, then the position with the new velocity."""
    accelerate = acceleration(system)
    u, s, w = pulls(system, drive).tolist(), drive.surface.tolist(), drive.surface_velocity.tolist()

    def step(n: int, z: float, v: float) -> tuple[float, float]:
        v += dt * accelerate(z, v, u[n], s[n], w[n])
        return z + dt * v, v

    return step


def runge_kutta(system: System, drive: Drive, dt: float) -> Step:
    """The classical one of order 4; in the middle of a step the drive is the cubic of its ends."""
    accelerate = acceleration(system)
    pull = system.hand_n_per_m / system.mass_kg, system.hand_ns_per_m / system.mass_kg
    x, x_rate = middle(drive.target, drive.target_velocity, dt)
    y, y_rate = middle(drive.surface, drive.surface_velocity, dt)
    u, s, w = pulls(system, drive).tolist(), drive.surface.tolist(), drive.surface_velocity.tolist()
    um, sm, wm = (pull[0] * x + pull[1] * x_rate).tolist(), y.tolist(), y_rate.tolist()
    half, sixth = dt / 2, dt / 6

    def step(n: int, z: float, v: float) -> tuple[float, float]:
        a1 = accelerate(z, v, u[n], s[n], w[n])
        v2 = v + half * a1
        a2 = accelerate(z + half * v, v2, um[n], sm[n], wm[n])
        v3 = v + half * a2
        a3 = accelerate(z + half * v2, v3, um[n], sm[n], wm[n])
        v4 = v + dt * a3
        a4 = accelerate(z + dt * v3, v4, u[n + 1], s[n + 1], w[n + 1])
        return (
            z + sixth * (v + 2 * (v2 + v3) + v4),
            v + sixth * (a1 + 2 * (a2 + a3) + a4),
        )

    return step


def implicit(system: System, drive: Drive, dt: float) -> Step:
    """Backward Euler. Its contact is a monotone function of where the step ends, so one of three
    ends fits: free, touching, or held at the surface while the damper has not yet its full force.
    """
    stiffness, damping = system.mode(False)
    divisor = 1 + dt * damping + dt * dt * stiffness
    give = dt * dt / (system.mass_kg * divisor)
    c = give * system.contact_ns_per_m
    held = 1 + give * system.contact_n_per_m + c / dt
    u, s, w = pulls(system, drive).tolist(), drive.surface.tolist(), drive.surface_velocity.tolist()

    def step(n: int, z: float, v: float) -> tuple[float, float]:
        v = (v + dt * (u[n + 1] - stiffness * z)) / divisor
        surface = s[n + 1]
        gap = surface - z - dt * v
        if gap > 0:
            inside = (gap - c * (w[n + 1] - (surface - z) / dt)) / held
            v += (gap - min(max(inside, 0.0), gap)) / dt
        return z + dt * v, v

    return step


def trapezoid(system: System, drive: Drive, dt: float) -> Step:
    """Midpoint rule with the difference quotient of the contact's potential as its force.

    gap at the beginning p, at the end q, without contact at the end g, and

        q = g - k (q+^2 - p+^2) / (q - p) - c (q+ - p+),   x+ = max(x, 0);

    the right side falls with q, so one q fits. Where the force would pull there is none, q = g.
    """
    stiffness, damping = system.mode(False)
    divisor = 1 + dt * damping / 2 + dt * dt * stiffness / 4
    give = dt * dt / (2 * system.mass_kg * divisor)
    k, c = give * system.contact_n_per_m / 2, give * system.contact_ns_per_m / dt
    held = 1 + k + c
    pull = pulls(system, drive)
    u, s = ((pull[1:] + pull[:-1]) / 2).tolist(), drive.surface.tolist()
    half = dt / 2

    def step(n: int, z: float, v: float) -> tuple[float, float]:
        mean = (v + half * (u[n] - stiffness * z)) / divisor
        p, g = s[n] - z, s[n + 1] - z - dt * mean
        if p > 0:
            q = (g + (c - k) * p) / held
            if q < 0:
                free = g + c * p
                root = sqrt((free - p) * (free - p) + 4 * k * p * p)
                total = free + p
                q = 2 * p * (free - k * p) / (total + root) if total > 0 else (total - root) / 2
            if q < g:
                mean += (g - q) / dt
        elif g > 0:
            total = g + (1 + c) * p
            root = sqrt(total * total - 4 * held * g * p)
            q = (total + root) / (2 * held) if total > 0 else 2 * g * p / (total - root)
            mean += (g - q) / dt
        return z + dt * mean, 2 * mean - v

    return step


def acceleration(system: System) -> Callable[[float, float, float, float, float], float]:
    """(z, v, pull, surface, its velocity) -> m/s^2."""
    stiffness, damping = system.mode(False)
    k, c = system.contact_n_per_m / system.mass_kg, system.contact_ns_per_m / system.mass_kg

    def accelerate(z: float, v: float, u: float, s: float, w: float) -> float:
        a = u - stiffness * z - damping * v
        if z < s:
            push = k * (s - z) + c * (w - v)
            if push > 0:
                return a + push
        return a

    return accelerate


def middle(path: Samples, rate: Samples, dt: float) -> tuple[Samples, Samples]:
    """Path and velocity in the middle of each step, [steps - 1], on the cubic of its ends."""
    rise = np.diff(path)
    return (
        (path[1:] + path[:-1]) / 2 - dt / 8 * np.diff(rate),
        1.5 / dt * rise - (rate[1:] + rate[:-1]) / 4,
    )


def explicit_limit(stiffness: float, damping: float) -> float:
    """|1 + dt x| <= 1 for both eigenvalues x of the mode."""
    spread = damping * damping - 4 * stiffness
    if spread < 0:
        return damping / stiffness
    return 4 / (damping + sqrt(spread)) if damping else inf


def semi_implicit_limit(stiffness: float, damping: float) -> float:
    """1 + trace + determinant of the step matrix >= 0 (Jury): dt^2 w^2 + 2 dt d <= 4."""
    root = damping + sqrt(damping * damping + 4 * stiffness)
    return 4 / root if root else inf


def runge_kutta_limit(stiffness: float, damping: float) -> float:
    """|R(dt x)| <= 1, R the first five terms of exp: along the ray of x, |R|^2 - 1 is a polynomial
    of degree 8 in the length; its first root beyond 1 (real x: 2.785, imaginary: 2 sqrt(2))."""
    x = (-damping - np.emath.sqrt(damping * damping - 4 * stiffness)) / 2
    length = abs(x)
    if not length:
        return inf
    terms = [(x / length) ** j / factorial(j) for j in range(5)]
    square = np.convolve(terms, np.conj(terms)).real
    roots = np.roots(square[:0:-1])
    real = roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots.real)]
    return float(real[real > 1].min() / length)


def no_limit(_stiffness: float, _damping: float) -> float:
    """Stable with any step."""
    return inf


INTEGRATORS: dict[str, Integrator] = {
    one.name: one
    for one in (
        Integrator("explicit-euler", 1, True, explicit_limit, explicit_euler),
        Integrator("semi-implicit", 1, True, semi_implicit_limit, semi_implicit),
        Integrator("implicit", 1, False, no_limit, implicit),
        Integrator("trapezoid", 2, False, no_limit, trapezoid),
        Integrator("rk4", 4, True, runge_kutta_limit, runge_kutta),
        Integrator("exact", 4, False, no_limit, exact_step),
    )
}
