"""A stylus drawn over a surface by a hand: the force at its tip, as a sensor would record it.

The scene of Brandi, Chaudhari, Steinbach ("Texture compensation for haptic feedback signal
compression", VECIMS 2011), without the device: a hand moves over a plane at 50-70 mm/s, touches
down, presses with about 0.9 N, and lifts off. In the plane the tip follows the hand. Along the
normal a mass hangs between spring and damper of the hand and, while it touches, the spring of the
contact.

Both ways of moving, free and touching, are linear, so a step within either is exact (a matrix
exponential) and stable at any stiffness. What is left is the moment of contact, which is noticed up
to a step late: a contact that is too stiff for its step gains energy at each impact, and bounces
for ever. So the step follows the stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, inf, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from ..recording import Calibration, Channel, Recording

MASS_KG = 0.060
HAND_N_PER_M = 250.0
HAND_NS_PER_M = 3.0
"""Stylus and hand as seen from the tip: 60 g, 250 N/m, 3 Ns/m; alone they swing at 10 Hz."""

CONTACT_N_PER_M: dict[str | None, float] = {
    None: 700.0,
    "stone": 900.0,
    "sand": 650.0,
    "cork": 450.0,
}
"""Stiffness of the contact, 450-900 N/m; None is the flat plane."""

STIFFEST_N_PER_M = 1e7
"""A steel rod of 1 cm^2 and 2 m; the step is then 8 us."""

SPEED_M_PER_S = (0.050, 0.070)
MEAN_FORCE_N = 0.95
"""What the hand aims at in contact. With touch-down and lift-off the mean over 4 s is about 0.9."""

FRICTION = 0.35
"""Coulomb friction of the tip; only drawn on with three axes."""

STEP_HZ = 20_000
STEPS_PER_RADIAN = 10
"""Steps of the scene: 20 kHz, or 10 per radian of the contact's natural frequency where that is
more, from 240 kN/m on. Peak of the first impact at 100 kN/m: 7.7 N, and 7.5 N with steps of 100
kHz; at 1 kHz the same contact bounces for ever."""

TIP_M = 25e-6
TIP_SLOPE_M = 400e-6
"""Gaussian widths (standard deviation along the path): of the contact patch, that smooths the
height; and of the ball of the tip, that bridges slopes shorter than itself."""

SENSOR = Calibration(1, 0, 2000)
SENSOR_NOISE_N = 0.5e-3
"""A 16-bit force sensor of +-16.384 N: one count is 0.5 mN, noise one count (rms)."""

APPROACH_M = 2e-3
TOUCH_S, LIFT_S, TRAVEL_S = 0.15, 0.10, 0.10
"""The hand waits 2 mm above the surface, starts down after 0.15 s, travels 0.1 s, and leaves so
that it is up again 0.1 s before the end; in recordings below 1 s all three shrink with it."""


@dataclass(frozen=True)
class Hand:
    """What the hand does; [steps] each.

    x, y: where it is in the plane, metres. heading: radians. speed: m/s. press: what it would push
    with at rest, newtons. lifted: from 0, pressing, to 1, above the surface.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    heading: NDArray[np.float64]
    speed: NDArray[np.float64]
    press: NDArray[np.float64]
    lifted: NDArray[np.float64]


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
    rate_hz: of the sensor, which averages over each of its ticks. The scene itself runs at the next
    multiple of that above ``step_hz`` (None: as the stiffness needs). The same arguments give the
    same counts on one machine and one version of NumPy.

    Measured over 4 s at 1 kHz, seeds 1-10 (mean over the whole recording; HF: above 20 Hz, in
    contact, as :func:`hapfmt.encoder.split.low_pass` splits it):

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
        step_hz = max(STEP_HZ, STEPS_PER_RADIAN * sqrt((HAND_N_PER_M + stiffness) / MASS_KG))
    if not (0 < seconds < inf and rate_hz >= 1 and 1 <= step_hz < inf):
        raise ParameterError("a scene needs a finite duration and rates of at least 1 Hz")
    if seed < 0:
        raise ParameterError("a seed is not negative")

    tick_count = max(round(seconds * rate_hz), 1)
    steps_per_tick = max(ceil(step_hz / rate_hz), 2)
    dt = 1 / (rate_hz * steps_per_tick)
    of_hand, of_surface, of_sensor = (
        np.random.Generator(np.random.PCG64(child))
        for child in np.random.SeedSequence(seed).spawn(3)
    )
    hand = move_hand(of_hand, tick_count * steps_per_tick, dt)
    if texture is None:
        under_tip = np.zeros_like(hand.x)
        height = under_tip
    else:
        from .heightfields import SURFACES

        under_tip = SURFACES[texture](of_surface)(hand.x, hand.y)
        under_tip -= under_tip.mean()
        height = _smooth(under_tip, TIP_M, dt)
    normal = push(height, hand, stiffness, dt)
    forces = [normal]
    if axes == 3:
        slope = np.gradient(_smooth(under_tip, TIP_SLOPE_M, dt), dt) / hand.speed
        drag = -normal * (FRICTION + slope)
        forces = [drag * np.cos(hand.heading), drag * np.sin(hand.heading), normal]
    names = ("tangential force x", "tangential force y", "normal force")[-axes:]
    # The normal force is read first: the same counts with one axis and with three.
    readings = [
        _read(force.reshape(tick_count, steps_per_tick).mean(axis=1), of_sensor)
        for force in reversed(forces)
    ]
    channels = [
        Channel(
            values=counts,
            rate=Fraction(rate_hz),
            calibration=SENSOR,
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
        "step_hz": rate_hz * steps_per_tick,
    }
    return Recording(tuple(channels), metadata={"scene": scene})


def move_hand(rng: np.random.Generator, steps: int, dt: float) -> Hand:
    """A slow turn, once in about 5 s, with wandering speed, heading and pressure."""
    t = np.arange(steps, dtype=np.float64) * dt
    slowest, fastest = SPEED_M_PER_S
    half = (fastest - slowest) / 2
    speed = slowest + half + half * np.clip(_wander(rng, t, 0.2, 1.5) / 2, -1, 1)
    heading = 2 * np.pi * (rng.uniform() + t / 5) + 0.3 * _wander(rng, t, 0.1, 1.0)
    press = MEAN_FORCE_N * (1 + 0.12 * _wander(rng, t, 0.2, 2.0)) + 0.006 * _wander(rng, t, 8, 12)
    shrink = min(1.0, steps * dt)
    down = (t / shrink - TOUCH_S) / TRAVEL_S
    up = ((steps * dt - t) / shrink - LIFT_S) / TRAVEL_S
    travelled = np.clip(np.minimum(down, up), 0, 1)
    return Hand(
        x=np.cumsum(speed * np.cos(heading)) * dt,
        y=np.cumsum(speed * np.sin(heading)) * dt,
        heading=heading,
        speed=speed,
        press=press,
        lifted=(1 + np.cos(np.pi * travelled)) / 2,
    )


def push(
    height: NDArray[np.float64], hand: Hand, stiffness: float, dt: float
) -> NDArray[np.float64]:
    """Normal force on the surface in newtons, [steps], at the beginning of each step.

    height: of the surface under the tip in metres, [steps].
    """
    depth = hand.press * (1 / HAND_N_PER_M + 1 / stiffness)
    target = hand.lifted * (depth + APPROACH_M) - depth
    pull = (HAND_N_PER_M * target + HAND_NS_PER_M * np.gradient(target, dt)) / MASS_KG
    pushed = pull + stiffness / MASS_KG * height
    (a, b, c, d), (e, f) = _step(HAND_N_PER_M, dt)
    (p, q, r, s), (g, h) = _step(HAND_N_PER_M + stiffness, dt)
    z, v = float(target[0]), 0.0
    force = []
    for surface, free, touching in zip(
        height.tolist(), pull.tolist(), pushed.tolist(), strict=True
    ):
        if z < surface:
            force.append(stiffness * (surface - z))
            z, v = p * z + q * v + g * touching, r * z + s * v + h * touching
        else:
            force.append(0.0)
            z, v = a * z + b * v + e * free, c * z + d * v + f * free
    return np.array(force)


def _step(stiffness: float, dt: float) -> tuple[list[float], list[float]]:
    """(z, v) after dt is [[p, q], [r, s]] (z, v) + (g, h) u for a constant acceleration input u."""
    from scipy.linalg import expm

    system = np.zeros((3, 3))
    system[0, 1] = 1
    system[1] = -stiffness / MASS_KG, -HAND_NS_PER_M / MASS_KG, 1
    exact = expm(system * dt)
    return exact[:2, :2].ravel().tolist(), exact[:2, 2].tolist()


def _wander(
    rng: np.random.Generator, t: NDArray[np.float64], low_hz: float, high_hz: float
) -> NDArray[np.float64]:
    """Eight sines of random frequency and phase between two frequencies; rms 1 in the long run."""
    out = np.zeros_like(t)
    for frequency, phase in zip(
        rng.uniform(low_hz, high_hz, 8), rng.uniform(0, 2 * np.pi, 8), strict=True
    ):
        out += np.sin(2 * np.pi * frequency * t + phase)
    return out / 2


def _smooth(height: NDArray[np.float64], width: float, dt: float) -> NDArray[np.float64]:
    """Gaussian of standard deviation ``width`` in metres at the mean speed, edges held."""
    sigma = width / (np.mean(SPEED_M_PER_S) * dt)
    reach = ceil(4 * sigma)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.convolve(np.pad(height, reach, mode="edge"), kernel / kernel.sum(), mode="valid")


def _read(force: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int16]:
    """Newtons to counts, int16: noise, rounding to the nearest, saturation."""
    noisy = force + rng.normal(0, SENSOR_NOISE_N, force.size)
    counts = np.floor(noisy * SENSOR.d / SENSOR.a + 0.5)
    return np.clip(counts, -(2**15), 2**15 - 1).astype(np.int16)
