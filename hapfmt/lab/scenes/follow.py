"""A free mass on a spring and damper. The system is linear, so one exact step per tick is enough at
any of its frequencies.
"""

from __future__ import annotations

import numpy as np

from .description import Tool
from .matrix import exponential
from .motion import Floats


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
