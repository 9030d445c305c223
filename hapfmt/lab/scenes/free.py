"""A tool in the air. Without a contact all parts are linear and take one step per tick."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .description import Tool
from .follow import LinearFollower
from .motion import Floats, StepGrid
from .tool import Advance, in_plane
from .work import Work

if TYPE_CHECKING:
    from .motion import StrokeMotion


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
