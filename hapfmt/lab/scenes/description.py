"""The description of a scene: frozen Structs, the same from TOML and from Python, and its files.

Only the parts that a description names are imported, built and computed: a height field only with
a texture, a contact solver only with a contact, a finger's channels only with that finger.
docs/scenes.md lists every key.

``Work`` counts the work that a scene took. Each counter is updated where the work is done, so a
part that did not run shows 0.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, Literal, get_args

from ...descriptions import (
    Description,
    DescriptionError,
    Library,
    above,
    assign,
    parse_toml,
    read,
    refuse_twice,
    what,
    within,
)
from ...errors import HapfmtError
from ...structs import Meta, keys_of

Integrator = Literal["explicit-euler", "semi-implicit", "implicit", "trapezoid", "rk4", "exact"]
INTEGRATORS = get_args(Integrator)
Surface = Literal["stone", "sand", "cork"]
Finger = Literal["thumb", "index", "middle", "ring", "little"]
FINGERS: tuple[Finger, ...] = get_args(Finger)
SensorName = Literal[
    "tangential force x", "tangential force y", "normal force",
    "position x", "position y", "position z", "velocity x", "velocity y", "velocity z",
]  # fmt: skip
CHANNELS: tuple[SensorName, ...] = get_args(SensorName)
FORCES = CHANNELS[:3]
Speed = Annotated[float, Meta(ge=1e-3, le=1)]
Hertz = Annotated[float, Meta(ge=0.1, le=50)]

MOST_SAMPLES = 1 << 28
"""Most samples of a recording, all channels together: 2 GiB while they are made."""

STIFFEST_N_PER_M = 1e7
"""A steel rod of 1 cm^2 and 2 m."""


def refuse_descending(key: str, pair: tuple[float, float]) -> None:
    if pair[0] > pair[1]:
        raise DescriptionError(key, "begins with the larger number; write [smallest, largest]")


class Contact(Description):
    """Spring and damper that push during contact and never pull."""

    n_per_m: Annotated[float, above(0, STIFFEST_N_PER_M, "stiffness in N/m")]
    damping: Annotated[float, within(0, 2, "damping ratio: 0 bounces, 1 does not oscillate")] = 0.0
    integrator: Annotated[Integrator, what("how it is solved [exact]")] | None = None
    dt_s: (
        Annotated[float, within(1e-7, 1.0, "time step in s [from stiffness and texture]")] | None
    ) = None


class Object(Contact):
    """The object that a hand grasps."""

    grip_n: Annotated[float, above(0, 200, "force of the thumb in N")] = 6.0
    width_m: Annotated[float, within(0.005, 0.1, "thickness in m")] = 0.06


class Texture(Description):
    """A height field under the tip of a tool."""

    surface: Annotated[Surface, what("name of the surface")]
    relief: Annotated[float, within(0, 100, "factor on its heights")] = 1.0


class Touches(Description):
    """Lifts the tool off the surface while it strokes, and sets it down again: contact onsets."""

    every_s: Annotated[float, within(1e-2, 3600, "period of the touch-downs in s")] = 2.0
    lift_m: Annotated[float, above(0, 0.5, "height of the lift in m")] = 0.01
    away_s: Annotated[float, within(0, 3600, "time in the air in s")] = 0.1
    travel_s: Annotated[float, within(1e-3, 60, "time of each way, up and down, in s")] = 0.08

    def __post_init__(self) -> None:
        super().__post_init__()
        if 2 * self.travel_s + self.away_s > self.every_s:
            raise DescriptionError("every_s", "is too short; write at least 2 x travel_s + away_s")


class Stroke(Description):
    """Moves over the plane with wandering speed and pressure; lifts off at the end."""

    speed_m_per_s: Annotated[tuple[Speed, Speed], what("[slowest, fastest] in m/s")] = (0.05, 0.07)
    press_n: Annotated[float, above(0, 100, "force of the hand in N")] = 0.95
    touches: Annotated[Touches | None, what("lifts off and touches down again")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_descending("speed_m_per_s", self.speed_m_per_s)


class Press(Description):
    """Comes down along the normal, stays, goes up, repeats. A short hold is a tap."""

    press_n: Annotated[float, above(0, 100, "force of the hand in N")]
    lift_m: Annotated[float, above(0, 0.5, "height between presses in m")] = 0.01
    travel_s: Annotated[float, within(1e-3, 60, "time to come down in s")] = 0.2
    hold_s: Annotated[float, within(0, 3600, "time in contact in s")] = 0.8
    every_s: Annotated[float, within(1e-2, 3600, "period in s")] = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if 2 * self.travel_s + self.hold_s > self.every_s:
            raise DescriptionError(
                "every_s",
                "is over before the hand is up again; write at least 2 x travel_s + hold_s",
            )


class Reach(Description):
    """Smooth movements from point to point in space."""

    extent_m: Annotated[float, above(0, 10, "side of the cube of motion in m")] = 0.2
    travel_s: Annotated[float, within(1e-2, 60, "duration of a movement in s")] = 0.7
    every_s: Annotated[float, within(1e-2, 3600, "period in s")] = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.travel_s > self.every_s:
            raise DescriptionError("travel_s", "is longer than every_s; write at most that")


class Sensor(Description):
    """A force sensor: step, range and noise."""

    step_n: Annotated[float, within(1e-6, 1, "step in N")] = 0.0005
    range_n: Annotated[float, above(0, 1e4, "largest force, positive or negative, in N")] = 16.384
    noise_n: Annotated[float, within(0, 1, "noise (rms) in N")] = 0.0005

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.range_n / self.step_n <= 1 << 30:
            raise DescriptionError(
                "range_n", "takes less than 1 or more than 2^30 steps; mend step_n"
            )


Recorded = Meta(
    min_length=1,
    description="channels to record [normal force; without contact: positions, velocities]",
)


class Tool(Description):
    """A mass that a hand holds by a spring and a damper. It moves in one of three ways."""

    mass_kg: Annotated[float, within(1e-4, 100, "mass in kg")] = 0.06
    hand_n_per_m: Annotated[float, within(1, 1e6, "stiffness of the hand in N/m")] = 250.0
    hand_ns_per_m: Annotated[float, within(0, 1e5, "damping of the hand in Ns/m")] = 3.0
    channels: Annotated[tuple[SensorName, ...], Recorded] | None = None
    stroke: Annotated[Stroke | None, what("moves over the plane")] = None
    press: Annotated[Press | None, what("moves down and up")] = None
    reach: Annotated[Reach | None, what("moves in space")] = None
    contact: Annotated[Contact | None, what("contact with a surface")] = None
    texture: Annotated[Texture | None, what("texture of the surface")] = None
    sensor: Annotated[Sensor | None, what("force sensor")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        ways = [name for name in ("stroke", "press", "reach") if getattr(self, name)]
        if len(ways) != 1:
            raise DescriptionError(
                "", f"has {' and '.join(ways) or 'none'} of stroke, press, reach; give one of them"
            )
        if self.contact and self.reach:
            raise DescriptionError("contact", "is never met by reach; take one of them out")
        if self.texture and not (self.contact and self.stroke):
            missing = "[tool.stroke]" if self.contact else "[tool.contact]"
            raise DescriptionError(
                "texture", f"is not felt without {missing}; add it, or take texture out"
            )
        if self.sensor and not self.contact:
            raise DescriptionError(
                "sensor", "has no force to read; add [tool.contact], or take it out"
            )
        if self.channels:
            refuse_twice("channels", self.channels)
            assign(self, "channels", tuple(x for x in CHANNELS if x in self.channels))
        for name in self.channels or ():
            if name in FORCES and not self.contact:
                raise DescriptionError("channels", f"{name!r} needs [tool.contact]; add it")
            if self.press and name[-1] in "xy":
                raise DescriptionError(
                    "channels", f"{name!r}: a press moves along z alone; leave it out"
                )

    @property
    def recorded(self) -> tuple[str, ...]:
        """The names of its channels."""
        if self.channels:
            return self.channels
        if self.contact:
            return ("normal force",)
        return tuple(c for c in CHANNELS if c not in FORCES and (not self.press or c[-1] == "z"))


class Tremor(Description):
    """Physiological tremor of the fingers."""

    rms_m: Annotated[float, within(0, 1e-2, "amplitude at the fingertip (rms) in m")] = 0.0001
    hz: Annotated[tuple[Hertz, Hertz], what("[slowest, fastest] in Hz")] = (8.0, 12.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_descending("hz", self.hz)


class Hand(Description):
    """Closes, holds and opens. Records joints, and with an object the fingertip forces."""

    fingers: Annotated[
        tuple[Finger, ...], Meta(min_length=1, description="the fingers of the hand")
    ] = FINGERS
    abduction: Annotated[bool, what("angles between the fingers")] = True
    palm: Annotated[bool, what("the arch of the palm")] = True
    wrist: Annotated[bool, what("flexion and abduction of the wrist")] = True
    close_s: Annotated[float, within(0.05, 60, "time to close in s")] = 0.6
    hold_s: Annotated[float, within(0, 3600, "time to hold in s")] = 1.6
    open_s: Annotated[float, within(0.05, 60, "time to open in s")] = 0.5
    every_s: Annotated[float, within(0.2, 3600, "period of the grasps in s")] = 4.0
    object: Annotated[Object | None, what("the object to grasp")] = None
    tremor: Annotated[Tremor | None, what("tremor of the fingers")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        refuse_twice("fingers", self.fingers)
        assign(self, "fingers", tuple(x for x in FINGERS if x in self.fingers))
        if self.close_s + self.hold_s + self.open_s > 0.9 * self.every_s:
            raise DescriptionError(
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


class Scene(Description):
    """The keys of the whole scene."""

    name: Annotated[str, Meta(max_length=100, description="name")] = ""
    description: Annotated[str, Meta(max_length=4000, description="description")] = ""
    seconds: Annotated[float, above(0, 36_000, "duration in s")] = 4.0
    seed: Annotated[int, within(0, (1 << 63) - 1, "seed of the random numbers")] = 1
    rate_hz: Annotated[int, within(1, 1_000_000, "samples per second of every sensor")] = 1000
    tool: Annotated[Tool | None, what("a tool in the hand")] = None
    hand: Annotated[Hand | None, what("a hand with its joints")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tool is None and self.hand is None:
            raise DescriptionError("", "a scene of nothing; add [tool] or [hand]")
        for at, contact in self.contacts.items():
            if contact.dt_s is not None and contact.dt_s * self.rate_hz > 1:
                raise DescriptionError(
                    f"{at}.dt_s", f"is longer than a tick; write at most {1 / self.rate_hz:g}"
                )

    @property
    def ticks(self) -> int:
        return max(round(self.seconds * self.rate_hz), 1)

    @property
    def contacts(self) -> dict[str, Contact]:
        """By their keys in the description."""
        found = {
            "tool.contact": self.tool and self.tool.contact,
            "hand.object": self.hand and self.hand.object,
        }
        return {at: contact for at, contact in found.items() if contact}

    def changed(self, **given: Any) -> Scene:
        """A copy with other ``seconds``, ``seed`` or ``rate_hz``, or with other ``n_per_m``,
        ``damping``, ``integrator`` or ``dt_s`` of every contact. None keeps a value."""
        asked = {name: value for name, value in given.items() if value is not None}
        own = {each.name for each in keys_of(Contact).values()}
        of_contact = {name: asked.pop(name) for name in own & asked.keys()}
        if of_contact and not self.contacts:
            raise DescriptionError(
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
        for name in parts:
            if name not in PARTS:
                raise DescriptionError(
                    "", f"no part is called {name!r}; there are: {', '.join(PARTS)}"
                )
            if self._without(name) == self:
                raise DescriptionError("", f"scene {self.name!r} has no part {name!r}")
        return self._without(*parts)

    def _without(self, *parts: str) -> Scene:
        tool, hand = self.tool, self.hand
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


LIBRARY = Library(__package__, "scene")


def builtin_names() -> tuple[str, ...]:
    """Names of the scenes that come with the package, sorted."""
    return LIBRARY.names()


def scene_text(name_or_path: str) -> str:
    """The TOML of the built-in scene of this name, or else of the file."""
    return LIBRARY.text(name_or_path)


def load_scene(name_or_path: str) -> Scene:
    """The built-in scene of this name, or else the one in this TOML file."""
    return parse_scene(scene_text(name_or_path), path=name_or_path)


def parse_scene(text: str, path: str | None = None) -> Scene:
    """TOML -> Scene; ``path`` is named in errors."""
    try:
        return read(Scene, parse_toml(text))
    except HapfmtError as error:
        raise error.at(path=path) from None


@dataclass
class Work:
    """Counters of the computed parts.

    step_count
        steps of tool and fingers, all axes.
    contact_step_count
        steps that a contact solver took; the others are exact steps of linear parts, one a tick.
    unstable_count
        steps longer than the limit of stability of their integrator.
    height_count
        points of a height field.
    finger_count, tremor_count, channel_count, sample_count
        fingers, points of tremor, channels and samples.
    saturated_count
        samples at the end of their sensor's range.
    """

    step_count: int = 0
    contact_step_count: int = 0
    unstable_count: int = 0
    height_count: int = 0
    finger_count: int = 0
    tremor_count: int = 0
    channel_count: int = 0
    sample_count: int = 0
    saturated_count: int = 0

    def as_json(self) -> dict[str, int]:
        return asdict(self)
