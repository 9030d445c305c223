"""A tool in contact: its normal motion is solved with the contact, step by step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from ...errors import ParameterError
from .contact import INTEGRATORS, Motion, System, integrate
from .description import Contact, Tool, Work
from .motion import Floats, StepGrid
from .tool import Advance, asked_for, default_integrator, in_plane, system_of


class Solve(Protocol):
    """As :func:`hapfmt.lab.scenes.contact.integrate`."""

    def __call__(
        self,
        system: System,
        target: Floats,
        surface: Floats,
        dt_s: float,
        integrator: str,
        z0: float | None,
        v0: float,
        *,
        target_velocity: Floats,
        surface_velocity: Floats,
    ) -> Motion: ...


FRICTION = 0.35
"""Coulomb friction of the tip; only drawn on where tangential forces are recorded."""


LOST_M = 10.0
"""Further than this from the surface no hand holds anything: the steps have diverged."""


class Normal:
    """One mass along the normal of what it touches, block by block."""

    def __init__(
        self,
        system: System,
        contact: Contact,
        grid: StepGrid,
        target: Callable[[Floats], Floats],
        work: Work,
        solve: Solve | None = None,
    ) -> None:
        """``target``: seconds to the metres at which the hand would have the tip."""
        self.system, self.grid, self.target, self.work = system, grid, target, work
        self.solve: Solve = solve or integrate
        self.integrator = default_integrator(contact)
        self.limit_s = INTEGRATORS[self.integrator].limit_s(system)
        self.z = float(target(np.zeros(1))[0])
        self.v = 0.0

    def block(
        self, start: int, stop: int, surface: tuple[Floats, Floats] | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Places, velocities, forces on the surface at steps [start, stop).

        surface: its height in metres and its rate of rise in m/s (None: a plane at 0). Both cover
        these steps and the next one, except at the end of the recording.
        """
        beyond = min(stop + 1, self.grid.steps)
        height, rise = surface or (np.zeros(beyond - start),) * 2
        target, slope = self.grid.with_slope(self.target, start, beyond)
        motion = self.solve(
            self.system, target, height, self.grid.dt_s, self.integrator, self.z, self.v,
            target_velocity=slope, surface_velocity=rise,
        )  # fmt: skip
        self.work.step_count += stop - start
        self.work.contact_step_count += stop - start
        if self.grid.dt_s > self.limit_s:
            self.work.unstable_count += stop - start
        lost = ~(np.abs(motion.z) < LOST_M)
        if lost.any():
            self._tell_divergence(start + int(np.argmax(lost)))
        self.z, self.v = float(motion.z[-1]), float(motion.v[-1])
        kept = stop - start
        return motion.z[:kept], motion.v[:kept], motion.force[:kept]

    def _tell_divergence(self, step: int) -> None:
        dt, stiffness = self.grid.dt_s, self.system.contact_n_per_m
        raise ParameterError(
            f"{self.integrator} diverged after {step * dt:.3g} s: its steps of {dt:.3g} s are "
            f"above the {self.limit_s:.3g} s it is stable up to at {stiffness:g} N/m; "
            "take a smaller --dt, or --integrator exact"
        )


def run_touching(
    tool: Tool,
    contact: Contact,
    grid: StepGrid,
    of_hand: np.random.Generator,
    of_surface: np.random.Generator,
    work: Work,
    advance: Advance,
    solve: Solve | None = None,
) -> dict[str, Floats]:
    """As :func:`hapfmt.lab.scenes.build.run_tool`."""
    compliance = 1 / tool.hand_n_per_m + 1 / contact.n_per_m
    if tool.press:
        from .motion import PressMotion

        press = PressMotion(tool.press, grid, of_hand)
        normal = Normal(
            system_of(tool, contact), contact, grid, lambda t: press.height(t, compliance), work
        )
        return run_flat(tool, grid, normal, advance)

    from .motion import StrokeMotion

    assert tool.stroke
    stroke = StrokeMotion(tool.stroke, grid, of_hand)
    normal = Normal(
        system_of(tool, contact), contact, grid, lambda t: stroke.height(t, compliance), work, solve
    )
    profile = None
    out = {name: np.empty(grid.ticks) for name in tool.recorded}
    if tool.texture:
        from .surface import HeightProfile

        profile = HeightProfile(tool.texture, stroke, grid, of_surface, work)
        stroke.x = stroke.y = 0.0
    plane, sideways = in_plane(tool), asked_for(tool, "tangential")
    if plane:
        from .tool import record_plane
    for start, stop in grid.blocks():
        rows, t = grid.ticks_of(start, stop), grid.times(start, stop)
        surface = profile.surface(start, min(stop + 1, grid.steps)) if profile else None
        z, v, force = normal.block(start, stop, surface)
        record_normal(grid, out, rows, z, v, force)
        if sideways:
            drag = -force * (FRICTION + (profile.rise(start, stop) if profile else 0)
                             / stroke.speed(t))  # fmt: skip
            heading = stroke.heading(t)
            for name, along in (("x", np.cos(heading)), ("y", np.sin(heading))):
                if (label := f"tangential force {name}") in out:
                    out[label][rows] = grid.averages(drag * along)
        if plane:
            record_plane(stroke, t, out, rows, grid.per_tick)
        advance(rows.stop - rows.start)
    return out


def run_flat(tool: Tool, grid: StepGrid, normal: Normal, advance: Advance) -> dict[str, Floats]:
    """Computes only the normal direction, on a plane at height 0."""
    out = {name: np.empty(grid.ticks) for name in tool.recorded}
    for start, stop in grid.blocks():
        rows = grid.ticks_of(start, stop)
        record_normal(grid, out, rows, *normal.block(start, stop))
        advance(rows.stop - rows.start)
    return out


def record_normal(
    grid: StepGrid, out: dict[str, Floats], rows: slice, z: Floats, v: Floats, force: Floats
) -> None:
    """A sensor of force averages over its ticks; places are those at their beginning."""
    if "normal force" in out:
        out["normal force"][rows] = grid.averages(force)
    if "position z" in out:
        out["position z"][rows] = z[:: grid.per_tick]
    if "velocity z" in out:
        out["velocity z"][rows] = v[:: grid.per_tick]
