"""The joints of a hand, as a glove with 22 sensors sees them, and how its fingers bend them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .description import FINGERS, Hand
from .waves import Floats, Waves

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

UNEVEN = 0.25
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
    ahead = rng.uniform(-UNEVEN, UNEVEN)
    return np.asarray(joint.open + (joint.fist - joint.open) * closed * (1 + ahead * (1 - closed)))


def wandering(joint: Joint, rng: np.random.Generator) -> Callable[[Floats], Floats]:
    """Angles of the wrist, which takes no part in a grasp, at times."""
    rms, waves = WRIST_WANDER[WRIST.index(joint)], Waves(rng, 0.05, 0.4)
    return lambda t: np.asarray(joint.open + rms * waves.at(t))
