"""Exact steps of linear systems: the exponential of a small matrix, and a free mass on a spring.

SciPy also has the exponential, but its linear algebra imports 190 modules.
"""

from __future__ import annotations

from math import ceil, log2

import numpy as np
from numpy.typing import NDArray

from .description import Tool
from .motion import Floats

TERMS = 20
"""Terms of the series, at a norm of at most 1/2: the rest is below 2^-21 / 21!, far below 2^-53."""

SWEEPS = 3
"""Sweeps of the balancing; two suffice for a spring of 1e7 N/m with velocities near 1."""


def exponential(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """exp(a), [n, n]: balanced, the series of a / 2^s, squared s times.

    Each squaring doubles the rounding error, so a smaller norm gives a more exact result. Balancing
    by powers of two rounds nothing. A step of 130 radians has an error of 7e-15 (SciPy: 5e-14).
    """
    scale = balance(a)
    a = a * (scale / scale[:, None])
    norm = float(np.abs(a).sum(axis=1).max())
    halvings = max(ceil(log2(norm)) + 1, 0) if norm > 0 else 0
    a = a / 2.0**halvings
    out = term = np.eye(len(a))
    for n in range(1, TERMS + 1):
        term = term @ a / n
        out = out + term
    for _ in range(halvings):
        out = out @ out
    return np.asarray(out * (scale[:, None] / scale))


def balance(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """Powers of two, [n], so that rows and columns of a[i, j] scale[j] / scale[i] are alike
    (E. E. Osborne, "On pre-conditioning of matrices", J. ACM 7, 1960)."""
    size = np.abs(a) - np.diag(np.abs(np.diag(a)))
    scale = np.ones(len(a))
    for _ in range(SWEEPS):
        for i in range(len(a)):
            column, row = float(size[:, i].sum()), float(size[i].sum())
            if column and row:
                by = 2.0 ** round((log2(row) - log2(column)) / 2)
                scale[i] *= by
                size[:, i] *= by
                size[i] /= by
    return scale


class LinearFollower:
    """Follows a target that is linear within each step."""

    def __init__(self, tool: Tool, dt_s: float, start: float) -> None:
        spring, damper = tool.hand_n_per_m / tool.mass_kg, tool.hand_ns_per_m / tool.mass_kg
        # State: place, velocity; then target and its velocity, which a step holds.
        system = np.zeros((4, 4))
        system[0, 1] = system[2, 3] = 1
        system[1] = -spring, -damper, spring, damper
        self.rows = exponential(system * dt_s)[:2].tolist()
        self.dt_s = dt_s
        self.z, self.v = start, 0.0

    def follow(self, target: Floats, last: float) -> tuple[Floats, Floats]:
        """Place and velocity at the beginning of each step, [steps] each; ``last`` is where the
        target is at the end of the last one."""
        slope = np.diff(target, append=last) / self.dt_s
        (a, b, c, d), (p, q, r, s) = self.rows
        z, v, places, velocities = self.z, self.v, [], []
        for u, w in zip(target.tolist(), slope.tolist(), strict=True):
            places.append(z)
            velocities.append(v)
            z, v = a * z + b * v + c * u + d * w, p * z + q * v + r * u + s * w
        self.z, self.v = z, v
        return np.array(places), np.array(velocities)
