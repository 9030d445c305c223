"""A hand-held tool: which parts it has, and which of its channels are recorded."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, inf, sqrt
from typing import TYPE_CHECKING

from .description import FORCES, Contact, Tool
from .motion import StepGrid

if TYPE_CHECKING:
    from .integrators import System

TEXTURE_STEP_S = 1 / 20_000
"""Of a tip on a texture: 3 um at the mean speed, a tenth of what the tip smooths over."""

EXACT = "exact"

Advance = Callable[[int], None]
"""Called with the ticks that are done since the last call."""


def default_integrator(contact: Contact) -> str:
    """The exact step: stable at any stiffness, and the cheapest for its error."""
    return contact.integrator or EXACT


def system_of(tool: Tool, contact: Contact) -> System:
    from .integrators import System

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
    from .integrators import STEPS_PER_RADIAN, default_step_s

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
