"""Scene -> Recording: imports, builds and computes only the parts that the description names."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from ...errors import LimitError
from ...recording import Channel, Recording
from .description import FORCES, MOST_SAMPLES, Hand, Scene, Tool, Work

if TYPE_CHECKING:
    import numpy as np

    from .motion import Floats, StepGrid
    from .tool import Advance
    from .touch import Solve

MOST_HEIGHTS = 1 << 28
"""Points of a height field that are kept: 2 GiB."""

GROUPS = {"position": "tip position", "velocity": "tip velocity", "force": "tip"}
"""Vectors of a tool's channels, where all three axes are recorded."""

Progress = Callable[[int, int], None]


def simulate(scene: Scene, *, progress: Progress | None = None) -> tuple[Recording, Work]:
    """Simulate a scene; returns the recording and the counters of work.

    The same scene gives the same counts on one machine and one version of NumPy. A part that is
    left out changes only the samples that it affects. ``progress`` is called with (parts done,
    parts in all).

    Memory: the counts, 8 bytes a sample of one channel (of a tool: of all its channels), 6 MB, and
    for a texture 8 bytes for each step.
    """
    count = sum(len(names) for names in labels(scene).values())
    if count * scene.ticks > MOST_SAMPLES:
        raise LimitError(
            f"{count} channels of {scene.ticks} samples are more than the {MOST_SAMPLES} that a "
            "scene may have; take a shorter time, a lower rate or fewer channels"
        )
    work = Work()
    total = scene.ticks * (
        (scene.tool is not None) + (len(scene.hand.fingers) if scene.hand else 0)
    )
    done = 0

    def advance(ticks: int) -> None:
        nonlocal done
        done += ticks
        if progress:
            progress(done, total)

    described: dict[str, Any] = {"name": scene.name, "seed": scene.seed, "rate_hz": scene.rate_hz}
    channels: list[Channel] = []
    if scene.tool:
        channels += tool_channels(scene, scene.tool, work, advance, described)
    if scene.hand:
        channels += hand_channels(scene, scene.hand, work, advance, described)
    described["work"] = {name: value for name, value in work.as_json().items() if value}
    return Recording(tuple(channels), metadata={"scene": described}), work


def labels(scene: Scene) -> dict[str, list[str]]:
    """Labels of the channels that a scene will have, by part."""
    found = {}
    if scene.tool:
        found["tool"] = list(scene.tool.recorded)
    if scene.hand:
        from .grasp import labels_of

        found["hand"] = labels_of(scene.hand)
    return found


def tool_channels(
    scene: Scene, tool: Tool, work: Work, advance: Callable[[int], None], described: dict[str, Any]
) -> list[Channel]:
    from .motion import stream
    from .sensors import reading_of
    from .tool import default_integrator, grid_of

    grid = grid_of(tool, scene.ticks, scene.rate_hz)
    if tool.texture and grid.steps > MOST_HEIGHTS:
        raise LimitError(
            f"a texture under {grid.steps} steps is more than {MOST_HEIGHTS} may be kept; take a "
            "shorter time, a longer step, or the texture out"
        )
    of_hand, of_surface = stream(scene.seed, "tool.hand"), stream(scene.seed, "tool.surface")
    traces = run_tool(tool, grid, of_hand, of_surface, work, advance)
    described["step_hz"] = grid.per_tick * grid.rate_hz
    if tool.contact:
        described |= {"contact_n_per_m": tool.contact.n_per_m,
                 "integrator": default_integrator(tool.contact)}  # fmt: skip
    if tool.texture:
        described["texture"] = tool.texture.surface
    channels = []
    for label in tool.recorded:
        reading = reading_of(label, tool.sensor)
        counts = reading.counts(traces.pop(label), stream(scene.seed, label), work)
        axis = "z" if label == FORCES[-1] else label[-1]
        alike = [name for name in tool.recorded if reading.quantity in name]
        channels.append(
            Channel(
                counts,
                Fraction(scene.rate_hz),
                calibration=reading.calibration,
                label=label,
                unit=reading.unit,
                quantity=reading.quantity,
                axis=axis,
                group=GROUPS[reading.quantity] if len(alike) == 3 else "",
                device="simulated tool",
            )
        )
    return channels


def run_tool(
    tool: Tool,
    grid: StepGrid,
    of_hand: np.random.Generator,
    of_surface: np.random.Generator,
    work: Work,
    advance: Advance,
    solve: Solve | None = None,
) -> dict[str, Floats]:
    """What its sensors would see without noise: [ticks] in newtons, metres, m/s, by channel.

    ``solve`` stands for :func:`hapfmt.lab.scenes.contact.integrate`.
    """
    if tool.contact is None:
        from .tool import run_free

        return run_free(tool, grid, of_hand, work, advance)
    from .touch import run_touching

    return run_touching(tool, tool.contact, grid, of_hand, of_surface, work, advance, solve)


def hand_channels(
    scene: Scene, hand: Hand, work: Work, advance: Callable[[int], None], described: dict[str, Any]
) -> list[Channel]:
    from .grasp import labels_of, run_hand
    from .motion import stream

    if hand.object:
        from .tool import default_integrator

        described |= {"object_n_per_m": hand.object.n_per_m,
                 "object_integrator": default_integrator(hand.object)}  # fmt: skip
    found = {}
    for signal in run_hand(hand, scene.ticks, scene.rate_hz, scene.seed, work, advance):
        reading = signal.reading
        rng = stream(scene.seed, f"read {signal.label}")
        found[signal.label] = Channel(
            reading.counts(signal.values, rng, work),
            Fraction(scene.rate_hz),
            calibration=reading.calibration,
            label=signal.label,
            unit=reading.unit,
            quantity=reading.quantity,
            body_site="hand",
            device="simulated hand",
        )
    return [found[label] for label in labels_of(hand)]
