"""A mass on the hand's spring and damper, against a unilateral spring and damper: the system.

    m z'' = hand (target - z) + hand_damping (target' - z') + f,
    f     = contact gap + contact_damping gap'   while gap = surface - z > 0 and f > 0, else 0.

z, target and surface are heights in metres: the mass touches from above. The contact pushes and
never pulls, so with damping it lets go while the spring is still compressed. Both ways of moving,
free and touching, are linear.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import ParameterError

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
