"""Simulated stiff scenes: row 20."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hapfmt.lab.scenes.contact import Drive, Motion, System, default_step_s, energy, integrate, work

from .row import Row, at_least, at_most, compared
from .signals import Samples

SECONDS = 1.0
HAND = (0.06, 250.0, 3.0)
"""Mass in kg, N/m and Ns/m of the hand."""


def target(t: Samples) -> Samples:
    """Down to 4 mm below the surface and up again, within half a second."""
    return 0.002 - 0.006 * np.sin(np.pi * t * 2) ** 2


def velocity(t: Samples) -> Samples:
    return -0.006 * 2 * np.pi * np.sin(4 * np.pi * t)


def run(system: System, dt: float, integrator: str) -> tuple[Motion, Drive]:
    t = np.arange(round(SECONDS / dt)) * dt
    flat = np.zeros(t.size)
    motion = integrate(
        system, target(t), flat, dt, integrator, target_velocity=velocity(t), surface_velocity=flat
    )
    return motion, Drive(target(t), velocity(t), flat, flat)


def stiff() -> Iterator[Row]:
    """The hand alone can press with 250 N/m times 4 mm: 1 N, and a bounce of what it fell with."""
    for stiffness, naive_step, least, most in (
        (1e3, 4e-3, 2, 1), (1e4, 1e-3, 5, 1.5), (1e5, 1e-3, 1e4, 5),
    ):  # fmt: skip
        system = System(*HAND, stiffness)
        with np.errstate(all="ignore"):
            naive = run(system, naive_step, "explicit-euler")[0].force
        dt = default_step_s(system)
        motion, drive = run(system, dt, "exact")
        fine, _ = run(system, dt / 2, "exact")
        stored = energy(system, drive, motion.z, motion.v)
        gained = stored - stored[0] - work(system, drive, motion, dt)
        error = np.abs(motion.force - fine.force[::2]).max()
        largest = float(np.nan_to_num(np.abs(naive), nan=np.inf).max())
        yield compared(
            20, f"60 g against {stiffness:g} N/m, explicit Euler, {1000 * naive_step:g} ms",
            (min(largest, 1e300), at_least(least)), (motion.force.max(), at_most(most)),
            "N at most", f"exact, {1e6 * dt:.3g} us: {1000 * error:.2g} mN from half the "
            f"step; energy gained {1e6 * max(gained.max(), 0):.2g} of {1e6 * stored.max():.3g} uJ",
            held=bool(np.isfinite(motion.force).all() and gained.max() <= 1e-3 * stored.max()),
        )  # fmt: skip


ROWS = (stiff,)
