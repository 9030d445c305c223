"""A hand-held tool: its parts, its recorded channels, and its motion in the air.

Without a contact all parts are linear and take one step per tick. touch.py has the contact.
"""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, inf, sqrt
from typing import TYPE_CHECKING

import numpy as np

from .description import FORCES, Contact, Tool, Work
from .linear import LinearFollower
from .motion import Floats, StepGrid

if TYPE_CHECKING:
    from .contact import System
    from .motion import StrokeMotion

TEXTURE_STEP_S = 1 / 20_000
"""Time step of a tip on a texture: 3 um at the mean speed, a tenth of the length that the tip
smooths over."""

EXACT = "exact"

Advance = Callable[[int], None]
"""Called with the ticks that are done since the last call."""


def default_integrator(contact: Contact) -> str:
    """The exact step: stable at any stiffness, and the cheapest for its error."""
    return contact.integrator or EXACT


def system_of(tool: Tool, contact: Contact) -> System:
    from .contact import System

    damper = 2 * contact.damping * sqrt(contact.n_per_m * tool.mass_kg)
    return System(tool.mass_kg, tool.hand_n_per_m, tool.hand_ns_per_m, contact.n_per_m, damper)


def grid_of(tool: Tool, ticks: int, rate_hz: int) -> StepGrid:
    """One step a tick without contact; else as many as stiffness and texture need."""
    if tool.contact is None:
        return StepGrid(ticks, 1, rate_hz)
    longest = TEXTURE_STEP_S if tool.texture else inf
    return contact_grid(system_of(tool, tool.contact), tool.contact, ticks, rate_hz, longest)


def contact_grid(
    system: System, contact: Contact, ticks: int, rate_hz: int, longest_s: float = inf
) -> StepGrid:
    """Steps as the contact asks for them, else as its integrator does, ``longest_s`` at most."""
    from .contact import STEPS_PER_RADIAN, default_step_s

    if contact.dt_s is not None:
        # A decimal such as 0.0001 is not quite the tenth of a tick.
        return StepGrid(ticks, max(ceil(1 / (rate_hz * contact.dt_s) - 1e-6), 1), rate_hz)
    if (integrator := default_integrator(contact)) == EXACT:
        # It finds the moment of contact within a step, so the sensor is all that needs small ones.
        step = 1 / (STEPS_PER_RADIAN * system.fastest_rad_per_s)
    else:
        step = default_step_s(system, integrator)
    step = min(step, longest_s)
    return StepGrid(ticks, max(ceil(1 / (rate_hz * step) - 1e-6), 2), rate_hz)


def asked_for(tool: Tool, *kinds: str) -> bool:
    """Whether a channel begins with one of these words."""
    return any(name.startswith(kinds) for name in tool.recorded)


def in_plane(tool: Tool) -> bool:
    """Whether where the tip is in the plane is recorded."""
    return any(name[-1] in "xy" and name not in FORCES for name in tool.recorded)


def run_free(
    tool: Tool, grid: StepGrid, rng: np.random.Generator, work: Work, advance: Advance
) -> dict[str, Floats]:
    """As :func:`hapfmt.lab.scenes.build.run_tool`. Only the axes that are recorded move."""
    if tool.stroke:
        return run_stroke(tool, grid, rng, work, advance)
    axes = [axis for axis in "xyz" if any(name[-1] == axis for name in tool.recorded)]
    if tool.reach:
        from .motion import ReachMotion

        reach = ReachMotion(tool.reach, grid, rng)

        def target(axis: str, t: Floats) -> Floats:
            return reach.along("xyz".index(axis), t)

    else:
        from .motion import PressMotion

        assert tool.press
        press = PressMotion(tool.press, grid, rng)

        def target(axis: str, t: Floats) -> Floats:  # noqa: ARG001
            return press.height(t, 1 / tool.hand_n_per_m)

    out = {name: np.empty(grid.ticks) for name in tool.recorded}
    followers: dict[str, LinearFollower] = {}
    for start, stop in grid.blocks():
        t = grid.times(start, stop + 1)
        for axis in axes:
            follow(tool, grid, followers, axis, target(axis, t), out, start)
        work.step_count += len(axes) * (stop - start)
        advance(stop - start)
    return out


def run_stroke(
    tool: Tool, grid: StepGrid, rng: np.random.Generator, work: Work, advance: Advance
) -> dict[str, Floats]:
    """In the plane the tip is where the hand is."""
    from .motion import StrokeMotion

    assert tool.stroke
    motion = StrokeMotion(tool.stroke, grid, rng)
    out = {name: np.empty(grid.ticks) for name in tool.recorded}
    followers: dict[str, LinearFollower] = {}
    along_z = any(name[-1] == "z" for name in out)
    for start, stop in grid.blocks():
        t = grid.times(start, stop)
        if in_plane(tool):
            record_plane(motion, t, out, slice(start, stop))
        if along_z:
            target = motion.height(grid.times(start, stop + 1), 1 / tool.hand_n_per_m)
            follow(tool, grid, followers, "z", target, out, start)
            work.step_count += stop - start
        advance(stop - start)
    return out


def follow(
    tool: Tool,
    grid: StepGrid,
    followers: dict[str, LinearFollower],
    axis: str,
    target: Floats,
    out: dict[str, Floats],
    start: int,
) -> None:
    """One axis over one block; ``target`` is one step longer than that."""
    if axis not in followers:
        followers[axis] = LinearFollower(tool, grid.dt_s, float(target[0]))
    place, velocity = followers[axis].follow(target[:-1], float(target[-1]))
    for name, values in ((f"position {axis}", place), (f"velocity {axis}", velocity)):
        if name in out:
            out[name][start : start + len(values)] = values


def record_plane(
    motion: StrokeMotion, t: Floats, out: dict[str, Floats], rows: slice, every: int = 1
) -> None:
    """Where the hand is in the plane, and how fast, at each ``every``-th time of a block."""
    paths, t = motion.path(t), t[::every]
    speed, heading = motion.speed(t), motion.heading(t)
    for axis, path, along in zip("xy", paths, (np.cos(heading), np.sin(heading)), strict=True):
        velocity = speed * along
        if f"velocity {axis}" in out:
            out[f"velocity {axis}"][rows] = velocity
        if f"position {axis}" in out:
            out[f"position {axis}"][rows] = motion.since_start(axis, path[::every], velocity)
