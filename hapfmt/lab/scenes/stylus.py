"""A stylus that a hand draws over a surface: the force at its tip, as a sensor records it.

The scene is that of Brandi, Chaudhari, Steinbach ("Texture compensation for haptic feedback signal
compression", VECIMS 2011), without the device. A hand moves over a plane at 50-70 mm/s, touches
down, presses with about 0.9 N, and lifts off. In the plane the tip follows the hand. Along the
normal a mass hangs on the spring and damper of the hand. While it touches, the spring of the
contact acts as well.

Both modes, free and touching, are linear. A step within one mode is a matrix exponential: exact,
and stable at any stiffness. The moment of contact is detected up to one step late. If the step is
too long for the stiffness, the contact gains energy at each impact and bounces without end. So the
step is chosen from the stiffness.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from math import ceil, inf, sqrt
from typing import Any

import numpy as np

from ...descriptions import read
from ...errors import ParameterError
from ...recording import Channel, Recording
from .build import run_tool
from .contact import Motion, System
from .description import FORCES, STIFFEST_N_PER_M, Contact, Stroke, Texture, Tool, Work
from .linear import exponential
from .motion import Floats, StepGrid
from .sensors import force_reading

HELD = Tool(stroke=Stroke())
"""Stylus and hand as seen from the tip: 60 g, 250 N/m, 3 Ns/m; alone they swing at 10 Hz."""

CONTACT_N_PER_M: dict[str | None, float] = {
    None: 700.0,
    "stone": 900.0,
    "sand": 650.0,
    "cork": 450.0,
}
"""Stiffness of the contact, 450-900 N/m; None is the flat plane."""

STEP_HZ = 20_000
STEPS_PER_RADIAN = 10
"""Steps of the scene: 20 kHz, or 10 per radian of the contact's natural frequency where that is
more, from 240 kN/m on. Peak of the first impact at 100 kN/m: 7.7 N, and 7.5 N with steps of 100
kHz; at 1 kHz the same contact bounces without end."""


def simulate(
    texture: str | None = "sand",
    seconds: float = 4.0,
    seed: int = 1,
    rate_hz: int = 1000,
    *,
    axes: int = 1,
    contact_n_per_m: float | None = None,
    step_hz: float | None = None,
) -> Recording:
    """One recording of the stylus: channel "normal force", or three with ``axes=3`` (group "tip").

    texture: "stone", "sand", "cork", or None for the flat plane, which computes no height field.
    rate_hz: rate of the sensor, which averages over each of its ticks. The scene runs at the next
    multiple of it above ``step_hz`` (None: chosen from the stiffness). The same arguments give the
    same counts on one machine and one version of NumPy.

    Measured over 4 s at 1 kHz, seeds 1-10. The mean covers the whole recording. HF is the part
    above 20 Hz, in contact, as :func:`hapfmt.split.low_pass` splits it:

    ========  =========  ===========  ==========  ===================
    texture   mean       HF rms       peak        HF energy (10-99 %)
    ========  =========  ===========  ==========  ===================
    None      0.86 N      1.0 mN      1.34 N      (sensor noise)
    "stone"   0.86 N     32 mN        1.5 N       22-142 Hz
    "sand"    0.86 N     32 mN        1.4 N       34-230 Hz
    "cork"    0.86 N     32 mN        1.3 N       28-195 Hz
    ========  =========  ===========  ==========  ===================
    """
    if texture not in CONTACT_N_PER_M:
        known = ", ".join(name for name in CONTACT_N_PER_M if name)
        raise ParameterError(f"no texture is called {texture!r}; there are: {known}, and None")
    if axes not in (1, 3):
        raise ParameterError("the stylus has one axis or three")
    stiffness = CONTACT_N_PER_M[texture] if contact_n_per_m is None else contact_n_per_m
    if not 0 < stiffness <= STIFFEST_N_PER_M:
        raise ParameterError("a contact needs a stiffness above 0 and up to 1e7 N/m")
    if step_hz is None:
        step_hz = max(
            STEP_HZ, STEPS_PER_RADIAN * sqrt((HELD.hand_n_per_m + stiffness) / HELD.mass_kg)
        )
    if not (0 < seconds < inf and rate_hz >= 1 and 1 <= step_hz < inf):
        raise ParameterError("a scene needs a finite duration and rates of at least 1 Hz")
    if seed < 0:
        raise ParameterError("a seed is not negative")

    grid = StepGrid(max(round(seconds * rate_hz), 1), max(ceil(step_hz / rate_hz), 2), rate_hz)
    of_hand, of_surface, of_sensor = (
        np.random.Generator(np.random.PCG64(child))
        for child in np.random.SeedSequence(seed).spawn(3)
    )
    names = FORCES[-axes:]
    tool = replace(
        HELD,
        channels=names,
        contact=Contact(stiffness),
        texture=read(Texture, {"surface": texture}) if texture else None,
    )
    work = Work()
    traces = run_tool(tool, grid, of_hand, of_surface, work, lambda _: None, held)
    # The normal force is read first: the same counts with one axis and with three.
    reading = force_reading()
    readings = [reading.counts(traces[name], of_sensor, work) for name in reversed(names)]
    channels = [
        Channel(
            stored=counts,
            rate=Fraction(rate_hz),
            calibration=reading.calibration,
            label=name,
            unit="N",
            quantity="force",
            axis=axis,
            group="tip" if axes == 3 else "",
            device="simulated stylus",
        )
        for counts, name, axis in zip(reversed(readings), names, "xyz"[-axes:], strict=True)
    ]
    scene: dict[str, Any] = {
        "name": "stylus",
        "texture": texture,
        "seed": seed,
        "contact_n_per_m": stiffness,
        "step_hz": rate_hz * grid.per_tick,
    }
    return Recording(tuple(channels), metadata={"scene": scene})


def held(
    system: System,
    target: Floats,
    surface: Floats,
    dt_s: float,
    integrator: str,  # noqa: ARG001
    z0: float | None,
    v0: float,
    *,
    target_velocity: Floats,
    surface_velocity: Floats,  # noqa: ARG001
) -> Motion:
    """Exact steps under a drive that is held for each of them, in the mode that each begins in.

    As :func:`hapfmt.lab.scenes.contact.integrate`, whose "exact" is better: here a contact is
    noticed up to a step late. The recordings of this module, which are measured with in many
    places, are those of these steps.
    """
    pull = system.hand_n_per_m * target + system.hand_ns_per_m * target_velocity
    pull /= system.mass_kg
    pushed = pull + system.contact_n_per_m / system.mass_kg * surface
    (a, b, c, d), (e, f) = held_step(*system.mode(False), dt_s)
    (p, q, r, s), (g, h) = held_step(*system.mode(True), dt_s)
    z, v = float(target[0]) if z0 is None else z0, v0
    places, speeds = [], []
    for height, free, touching in zip(
        surface.tolist(), pull.tolist(), pushed.tolist(), strict=True
    ):
        places.append(z)
        speeds.append(v)
        if z < height:
            z, v = p * z + q * v + g * touching, r * z + s * v + h * touching
        else:
            z, v = a * z + b * v + e * free, c * z + d * v + f * free
    path = np.array(places)
    force = np.where(path < surface, system.contact_n_per_m * (surface - path), 0.0)
    return Motion(path, np.array(speeds), force)


def held_step(stiffness: float, damping: float, dt_s: float) -> tuple[list[float], list[float]]:
    """(z, v) after dt is [[p, q], [r, s]] (z, v) + (g, h) u for a constant acceleration u."""
    system = np.zeros((3, 3))
    system[0, 1] = 1
    system[1] = -stiffness, -damping, 1
    exact = exponential(system * dt_s)
    return exact[:2, :2].ravel().tolist(), exact[:2, 2].tolist()
