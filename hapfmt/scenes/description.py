"""What is in a scene: frozen dataclasses, the same from TOML and from Python.

What a description does not name is not built, not computed and not imported: no texture, no height
field; no contact, no contact solver; no finger, no channel. docs/scenes.md lists every key.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from .keys import SceneError, check, choice, flag, number, pair, part, several, text, whole

Integrator = Literal["explicit-euler", "semi-implicit", "implicit", "trapezoid", "rk4", "exact"]
INTEGRATORS = ("explicit-euler", "semi-implicit", "implicit", "trapezoid", "rk4", "exact")
SURFACES = ("stone", "sand", "cork")
FINGERS = ("thumb", "index", "middle", "ring", "little")
FORCES = ("tangential force x", "tangential force y", "normal force")
CHANNELS = (
    *FORCES,
    *(f"{quantity} {axis}" for quantity in ("position", "velocity") for axis in "xyz"),
)

MOST_SAMPLES = 1 << 28
"""Of a recording, all channels together: 2 GiB while they are made."""

STIFFEST_N_PER_M = 1e7
"""A steel rod of 1 cm^2 and 2 m."""


@dataclass(frozen=True)
class Contact:
    """Spring and damper that push during contact and never pull."""

    n_per_m: float = number("stiffness in N/m", above=0, high=STIFFEST_N_PER_M)
    damping: float = number("damping ratio: 0 bounces, 1 does not oscillate", 0.0, high=2)
    integrator: Integrator | None = choice("how it is solved [exact]", INTEGRATORS, None)
    dt_s: float | None = number(
        "time step in s [from stiffness and texture]", None, above=0, low=1e-7, high=1.0
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class Object(Contact):
    """The object that a hand grasps."""

    grip_n: float = number("force of the thumb in N", 6.0, above=0, high=200)
    width_m: float = number("thickness in m", 0.06, low=0.005, high=0.1)


@dataclass(frozen=True)
class Texture:
    """A height field under the tip of a tool."""

    surface: str = choice("name of the surface", SURFACES)
    relief: float = number("factor on its heights", 1.0, high=100)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class Touches:
    """Lifts the tool off the surface while it strokes, and sets it down again: contact onsets."""

    every_s: float = number("period of the touch-downs in s", 2.0, low=1e-2, high=3600)
    lift_m: float = number("height of the lift in m", 0.01, above=0, high=0.5)
    away_s: float = number("time in the air in s", 0.1, high=3600)
    travel_s: float = number("time of each way, up and down, in s", 0.08,
                             low=1e-3, high=60)  # fmt: skip

    def __post_init__(self) -> None:
        check(self)
        if 2 * self.travel_s + self.away_s > self.every_s:
            raise SceneError("every_s", "is too short; write at least 2 x travel_s + away_s")


@dataclass(frozen=True)
class Stroke:
    """Moves over the plane with wandering speed and pressure; lifts off at the end."""

    speed_m_per_s: tuple[float, float] = pair("[slowest, fastest] in m/s", (0.05, 0.07),
                                              low=1e-3, high=1.0)  # fmt: skip
    press_n: float = number("force of the hand in N", 0.95, above=0, high=100)
    touches: Touches | None = part("lifts off and touches down again", Touches)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class Press:
    """Comes down along the normal, stays, goes up, repeats. A short hold is a tap."""

    press_n: float = number("force of the hand in N", above=0, high=100)
    lift_m: float = number("height between presses in m", 0.01, above=0, high=0.5)
    travel_s: float = number("time to come down in s", 0.2, low=1e-3, high=60)
    hold_s: float = number("time in contact in s", 0.8, high=3600)
    every_s: float = number("period in s", 2.0, low=1e-2, high=3600)

    def __post_init__(self) -> None:
        check(self)
        if 2 * self.travel_s + self.hold_s > self.every_s:
            raise SceneError(
                "every_s",
                "is over before the hand is up again; write at least 2 x travel_s + hold_s",
            )


@dataclass(frozen=True)
class Reach:
    """Smooth movements from point to point in space."""

    extent_m: float = number("side of the cube of motion in m", 0.2, above=0, high=10)
    travel_s: float = number("duration of a movement in s", 0.7, low=1e-2, high=60)
    every_s: float = number("period in s", 1.0, low=1e-2, high=3600)

    def __post_init__(self) -> None:
        check(self)
        if self.travel_s > self.every_s:
            raise SceneError("travel_s", "is longer than every_s; write at most that")


@dataclass(frozen=True)
class Sensor:
    """A force sensor: step, range and noise."""

    step_n: float = number("step in N", 0.0005, low=1e-6, high=1)
    range_n: float = number("largest force, positive or negative, in N", 16.384, above=0, high=1e4)
    noise_n: float = number("noise (rms) in N", 0.0005, high=1)

    def __post_init__(self) -> None:
        check(self)
        if not 1 <= self.range_n / self.step_n <= 1 << 30:
            raise SceneError("range_n", "takes less than 1 or more than 2^30 steps; mend step_n")


@dataclass(frozen=True)
class Tool:
    """A mass that a hand holds by a spring and a damper. It moves in one of three ways."""

    mass_kg: float = number("mass in kg", 0.060, low=1e-4, high=100)
    hand_n_per_m: float = number("stiffness of the hand in N/m", 250.0, low=1, high=1e6)
    hand_ns_per_m: float = number("damping of the hand in Ns/m", 3.0, high=1e5)
    channels: tuple[str, ...] | None = several(
        "channels to record [normal force; without contact: positions, velocities]", CHANNELS, None
    )
    stroke: Stroke | None = part("moves over the plane", Stroke)
    press: Press | None = part("moves down and up", Press)
    reach: Reach | None = part("moves in space", Reach)
    contact: Contact | None = part("contact with a surface", Contact)
    texture: Texture | None = part("texture of the surface", Texture)
    sensor: Sensor | None = part("force sensor", Sensor)

    def __post_init__(self) -> None:
        check(self)
        ways = [name for name in ("stroke", "press", "reach") if getattr(self, name)]
        if len(ways) != 1:
            raise SceneError(
                "", f"has {' and '.join(ways) or 'none'} of stroke, press, reach; give one of them"
            )
        if self.contact and self.reach:
            raise SceneError("contact", "is never met by reach; take one of them out")
        if self.texture and not (self.contact and self.stroke):
            missing = "[tool.stroke]" if self.contact else "[tool.contact]"
            raise SceneError(
                "texture", f"is not felt without {missing}; add it, or take texture out"
            )
        if self.sensor and not self.contact:
            raise SceneError("sensor", "has no force to read; add [tool.contact], or take it out")
        for name in self.channels or ():
            if name in FORCES and not self.contact:
                raise SceneError("channels", f"{name!r} needs [tool.contact]; add it")
            if self.press and name[-1] in "xy":
                raise SceneError("channels", f"{name!r}: a press moves along z alone; leave it out")

    @property
    def recorded(self) -> tuple[str, ...]:
        """The names of its channels."""
        if self.channels:
            return self.channels
        if self.contact:
            return ("normal force",)
        return tuple(c for c in CHANNELS if c not in FORCES and (not self.press or c[-1] == "z"))


@dataclass(frozen=True)
class Tremor:
    """Physiological tremor of the fingers."""

    rms_m: float = number("amplitude at the fingertip (rms) in m", 1e-4, high=1e-2)
    hz: tuple[float, float] = pair("[slowest, fastest] in Hz", (8.0, 12.0), low=0.1, high=50)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True)
class Hand:
    """Closes, holds and opens. Records joints, and with an object the fingertip forces."""

    fingers: tuple[str, ...] = several("the fingers of the hand", FINGERS, FINGERS)
    abduction: bool = flag("angles between the fingers", True)
    palm: bool = flag("the arch of the palm", True)
    wrist: bool = flag("flexion and abduction of the wrist", True)
    close_s: float = number("time to close in s", 0.6, low=0.05, high=60)
    hold_s: float = number("time to hold in s", 1.6, high=3600)
    open_s: float = number("time to open in s", 0.5, low=0.05, high=60)
    every_s: float = number("period of the grasps in s", 4.0, low=0.2, high=3600)
    object: Object | None = part("the object to grasp", Object)
    tremor: Tremor | None = part("tremor of the fingers", Tremor)

    def __post_init__(self) -> None:
        check(self)
        if self.close_s + self.hold_s + self.open_s > 0.9 * self.every_s:
            raise SceneError(
                "every_s", "is too short to close, hold and open; write 1.2 times their sum"
            )


PARTS = (
    "texture",
    "touches",
    "contact",
    "tool",
    "hand",
    "tremor",
    "abduction",
    "palm",
    "wrist",
    *FINGERS,
)
"""What can be taken out of a scene by name."""


@dataclass(frozen=True)
class Scene:
    """The keys of the whole scene."""

    name: str = text("name", most=100)
    description: str = text("description", most=4000)
    seconds: float = number("duration in s", 4.0, above=0, high=36_000)
    seed: int = whole("seed of the random numbers", 1, low=0, high=(1 << 63) - 1)
    rate_hz: int = whole("samples per second of every sensor", 1000, low=1, high=1_000_000)
    tool: Tool | None = part("a tool in the hand", Tool)
    hand: Hand | None = part("a hand with its joints", Hand)

    def __post_init__(self) -> None:
        check(self)
        if self.tool is None and self.hand is None:
            raise SceneError("", "a scene of nothing; add [tool] or [hand]")
        for at, contact in self.contacts.items():
            if contact.dt_s is not None and contact.dt_s * self.rate_hz > 1:
                raise SceneError(
                    f"{at}.dt_s", f"is longer than a tick; write at most {1 / self.rate_hz:g}"
                )

    @property
    def ticks(self) -> int:
        return max(round(self.seconds * self.rate_hz), 1)

    @property
    def contacts(self) -> dict[str, Contact]:
        """By where they stand in the description."""
        found = {
            "tool.contact": self.tool and self.tool.contact,
            "hand.object": self.hand and self.hand.object,
        }
        return {at: contact for at, contact in found.items() if contact}

    def changed(self, **given: Any) -> Scene:
        """With other ``seconds``, ``seed``, ``rate_hz``; ``n_per_m``, ``damping``, ``integrator``,
        ``dt_s`` of whatever is touched. What is None stays."""
        asked = {name: value for name, value in given.items() if value is not None}
        own = {each.name for each in fields(Contact)}
        of_contact = {name: asked.pop(name) for name in own & asked.keys()}
        if of_contact and not self.contacts:
            raise SceneError(
                sorted(of_contact)[0],
                f"scene {self.name!r} touches nothing, so it has no such part",
            )
        tool, hand = self.tool, self.hand
        if of_contact and tool and tool.contact:
            tool = replace(tool, contact=replace(tool.contact, **of_contact))
        if of_contact and hand and hand.object:
            hand = replace(hand, object=replace(hand.object, **of_contact))
        return replace(self, tool=tool, hand=hand, **asked)

    def without(self, *parts: str) -> Scene:
        """The same scene and the same seed, with these of :data:`PARTS` taken out."""
        tool, hand = self.tool, self.hand
        for name in parts:
            if name not in PARTS:
                raise SceneError("", f"no part is called {name!r}; there are: {', '.join(PARTS)}")
        if "tool" in parts:
            tool = None
        if "hand" in parts:
            hand = None
        if tool and "texture" in parts:
            tool = replace(tool, texture=None)
        if tool and tool.stroke and "touches" in parts:
            tool = replace(tool, stroke=replace(tool.stroke, touches=None))
        if tool and "contact" in parts:
            left = tuple(name for name in tool.channels or () if name not in FORCES)
            tool = replace(tool, contact=None, texture=None, sensor=None, channels=left or None)
        if hand:
            hand = hand_without(hand, parts)
        return replace(self, tool=tool, hand=hand)


def hand_without(hand: Hand, parts: tuple[str, ...]) -> Hand:
    switched: dict[str, Any] = {p: False for p in ("abduction", "palm", "wrist") if p in parts}
    if "contact" in parts:
        switched["object"] = None
    if "tremor" in parts:
        switched["tremor"] = None
    left = tuple(name for name in hand.fingers if name not in parts)
    return replace(hand, fingers=left, **switched)
