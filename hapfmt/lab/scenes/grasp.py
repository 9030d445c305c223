"""A hand that repeatedly closes on an object, holds it and releases it.

Each finger is driven along a minimum-jerk path to where it would be without an obstacle. The object
stops the finger, and the rest of the path becomes pressing force. Fingers are solved one by one:
absent fingers take no steps, and without an object no finger takes any.

The file also has the joints of a hand, as a glove with 22 sensors measures them, and how each
finger bends them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .description import FINGERS, Hand, Work
from .motion import Floats, Repeats, StepGrid, Waves, minimum_jerk, stream
from .sensors import JOINT, Reading, force_reading
from .tool import Advance, contact_grid

if TYPE_CHECKING:
    from .contact import System
    from .description import Object

GAPE_M = 0.105
"""Between thumb and fingers of an open hand; joints of a hand that has closed it are those of a
fist."""


@dataclass(frozen=True)
class Joint:
    """Angles in radians with the hand open and as a fist; ``finger`` bends it, and it is there only
    where ``beside`` is too."""

    label: str
    open: float
    fist: float
    finger: str = ""
    beside: str = ""


THUMB = (
    Joint("thumb CMC rotation", 0.15, 0.90, "thumb"),
    Joint("thumb MCP flexion", 0.10, 0.75, "thumb"),
    Joint("thumb IP flexion", 0.05, 0.95, "thumb"),
)
BENDS = {"index": (1.40, 1.75, 1.05), "middle": (1.45, 1.80, 1.10), "ring": (1.45, 1.80, 1.10),
         "little": (1.50, 1.70, 1.10)}  # fmt: skip
"""MCP, PIP and DIP of a fist, radians; an open hand has a tenth of them."""

OPEN_SHARE = 0.1
ABDUCTIONS = (
    Joint("thumb CMC abduction", 0.95, 0.35, "thumb"),
    Joint("index-middle abduction", 0.22, 0.04, "index", "middle"),
    Joint("middle-ring abduction", 0.15, 0.03, "ring", "middle"),
    Joint("ring-little abduction", 0.25, 0.05, "little", "ring"),
)
PALM = Joint("palm arch", 0.08, 0.40)
WRIST = (Joint("wrist flexion", -0.35, -0.35), Joint("wrist abduction", 0.05, 0.05))
WRIST_WANDER = (0.10, 0.04)
"""Radians (rms) that the two angles of the wrist wander by."""

UNEVEN_JOINTS = 0.25
"""How far a joint may run ahead of its finger, or lag behind, as a share of its bend."""


def joints_of(hand: Hand) -> list[Joint]:
    """Those there are: 22 of a whole hand."""
    found: list[Joint] = []
    for finger in FINGERS:
        if finger in hand.fingers:
            found += THUMB if finger == "thumb" else flexions(finger)
    if hand.abduction:
        found += [
            joint
            for joint in ABDUCTIONS
            if joint.finger in hand.fingers and (not joint.beside or joint.beside in hand.fingers)
        ]
    return [*found, *([PALM] if hand.palm else []), *(WRIST if hand.wrist else [])]


def flexions(finger: str) -> list[Joint]:
    return [
        Joint(f"{finger} {name} flexion", OPEN_SHARE * fist, fist, finger)
        for name, fist in zip(("MCP", "PIP", "DIP"), BENDS[finger], strict=True)
    ]


def bent(joint: Joint, closed: Floats, rng: np.random.Generator) -> Floats:
    """Angles of a joint, for how far its finger has closed (0 open, 1 a fist); [ticks] both."""
    ahead = rng.uniform(-UNEVEN_JOINTS, UNEVEN_JOINTS)
    return np.asarray(joint.open + (joint.fist - joint.open) * closed * (1 + ahead * (1 - closed)))


def wandering(joint: Joint, rng: np.random.Generator) -> Callable[[Floats], Floats]:
    """Angles of the wrist at times; the wrist does not move with a grasp."""
    rms, waves = WRIST_WANDER[WRIST.index(joint)], Waves(rng, 0.05, 0.4)
    return lambda t: np.asarray(joint.open + rms * waves.at(t))


SHARES = {"thumb": 1.0, "index": 0.335, "middle": 0.335, "ring": 0.175, "little": 0.155}
"""Shares of the grip force. The thumb opposes the other fingers. They share its force as in R. G.
Radwin and others, "External finger forces in submaximal five-finger static pinch prehension",
Ergonomics 35, 1992: 33, 33, 17 and 15 %."""

FINGER_KG, FINGER_N_PER_M, FINGER_NS_PER_M = 0.008, 300.0, 2.0
"""A fingertip as the object meets it; orders of magnitude."""

LATE_S = 0.06
"""Fingers begin within this time of each other."""

UNEVEN = 0.03
"""How much a force that is held wanders (rms)."""


class Signal(NamedTuple):
    """A channel before it is read: [ticks] in the unit of its reading."""

    label: str
    reading: Reading
    values: Floats


class Finger:
    """Where the hand drives one fingertip: metres above the object, or from the closed fist."""

    def __init__(self, hand: Hand, name: str, grasps: Repeats, seed: int) -> None:
        rng = stream(seed, f"hand.{name}")
        self.hand, self.grasps = hand, grasps
        self.late = rng.uniform(0, LATE_S)
        self.width = hand.object.width_m if hand.object else 0.0
        self.away = (GAPE_M - self.width) / 2
        self.depth = 0.0
        self.wander = Waves(rng, 0.1, 1)
        if hand.object:
            compliance = 1 / FINGER_N_PER_M + 1 / hand.object.n_per_m
            self.depth = hand.object.grip_n * SHARES[name] * compliance
        tremor = hand.tremor
        self.tremor = Waves(stream(seed, f"tremor.{name}"), *tremor.hz) if tremor else None

    def target(self, t: Floats) -> Floats:
        number, since = self.grasps.at(t)
        depth = self.depth * self.grasps.strength[number] * (1 + UNEVEN * self.wander.at(t))
        z = self.away - (self.away + depth) * gripped(self.hand, since - self.late)
        if self.tremor and self.hand.tremor:
            z += self.hand.tremor.rms_m * self.tremor.at(t)
        return np.asarray(z)

    def closed(self, z: Floats) -> Floats:
        """From 0, open, to 1, a fist."""
        return np.asarray(1 - (z + self.width / 2) / (GAPE_M / 2))


def gripped(hand: Hand, since: Floats) -> Floats:
    """0 open, 1 closed, for the seconds since a grasp began."""
    closing = minimum_jerk(since / hand.close_s)
    return np.asarray(closing - minimum_jerk((since - hand.close_s - hand.hold_s) / hand.open_s))


def labels_of(hand: Hand) -> list[str]:
    """Labels of the hand's channels, in their order."""
    forces = [f"{name} force" for name in FINGERS if hand.object and name in hand.fingers]
    return [*(joint.label for joint in joints_of(hand)), *forces]


def run_hand(
    hand: Hand, ticks: int, rate_hz: int, seed: int, work: Work, advance: Advance
) -> Iterator[Signal]:
    """Its channels one after the other, finger by finger, so that few are held at a time."""
    joints = joints_of(hand)
    plain = StepGrid(ticks, 1, rate_hz)
    lasts = hand.close_s + hand.hold_s + hand.open_s + LATE_S
    grasps = Repeats(stream(seed, "hand.grasps"), ticks / rate_hz, hand.every_s, lasts)
    for name in hand.fingers:
        finger = Finger(hand, name, grasps, seed)
        work.finger_count += 1
        if hand.object:
            z, force = run_finger(finger, hand.object, ticks, rate_hz, work, advance)
            yield Signal(f"{name} force", force_reading(), force)
        else:
            z = by_blocks(plain, finger.target, advance)
            work.tremor_count += ticks if finger.tremor else 0
        closed = finger.closed(z)
        for joint in joints:
            if joint.finger == name:
                yield Signal(joint.label, JOINT, bent(joint, closed, stream(seed, joint.label)))
    if PALM in joints:
        wide = hand.object.width_m if hand.object else 0.0

        def cupped(t: Floats) -> Floats:
            return gripped(hand, grasps.at(t)[1]) * (1 - wide / GAPE_M)

        closed = by_blocks(plain, cupped, None)
        yield Signal(PALM.label, JOINT, bent(PALM, closed, stream(seed, PALM.label)))
    for joint in joints:
        if joint in WRIST:
            angle = wandering(joint, stream(seed, joint.label))
            yield Signal(joint.label, JOINT, by_blocks(plain, angle, None))


def by_blocks(
    grid: StepGrid, values: Callable[[Floats], Floats], advance: Advance | None
) -> Floats:
    """A function of time at each tick."""
    out = np.empty(grid.ticks)
    for start, stop in grid.blocks():
        out[start:stop] = values(grid.times(start, stop))
        if advance:
            advance(stop - start)
    return out


def run_finger(
    finger: Finger, touched: Object, ticks: int, rate_hz: int, work: Work, advance: Advance
) -> tuple[Floats, Floats]:
    """Where a fingertip is, in metres above the object, and the force on it, newtons; [ticks]."""
    from .touch import Normal

    system = system_of_finger(touched)
    grid = contact_grid(system, touched, ticks, rate_hz)
    normal = Normal(system, touched, grid, finger.target, work)
    work.tremor_count += grid.steps if finger.tremor else 0
    z, force = np.empty(ticks), np.empty(ticks)
    for start, stop in grid.blocks():
        rows = grid.ticks_of(start, stop)
        place, _, pushed = normal.block(start, stop)
        z[rows], force[rows] = place[:: grid.per_tick], grid.averages(pushed)
        advance(rows.stop - rows.start)
    return z, force


def system_of_finger(touched: Object) -> System:
    from .contact import System

    damper = 2 * touched.damping * (touched.n_per_m * FINGER_KG) ** 0.5
    return System(FINGER_KG, FINGER_N_PER_M, FINGER_NS_PER_M, touched.n_per_m, damper)
