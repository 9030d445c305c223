"""Sources of values that no player should trust, and a player of them as a program of its own.

python replay_scenes.py '{"profile": ..., "log": ..., "scene": ..., "seconds": ...}'
"""

from __future__ import annotations

import errno
import json
import sys
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import count
from typing import Any

import numpy as np

from hapfmt.replay.process.player import PlayerStatus, play
from hapfmt.replay.profile.model import FrameBlock, Profile
from hapfmt.replay.profile.parse import load_profile, parse_profile
from hapfmt.replay.render.renderer import Position

BLOCK = 50

# Of samples [n] and a number of actuators: values and whether they are known, both [n, actuators].
Scene = Callable[["np.ndarray", int], tuple["np.ndarray", "np.ndarray"]]


def spread(values: np.ndarray, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    """The same for all, known everywhere."""
    whole = np.repeat(np.asarray(values, float)[:, None], actuators, axis=1)
    return whole, np.ones(whole.shape, bool)


def push(n: np.ndarray, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    """The largest force, all the time."""
    return spread(np.full(n.shape, 1e300), actuators)


def flips(n: np.ndarray, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    """From one end to the other with each sample."""
    return spread(np.where(n % 2, -1e9, 1e9), actuators)


def slow_flips(n: np.ndarray, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    return spread(np.where(n // 100 % 2, -1e9, 1e9), actuators)


def flickers(n: np.ndarray, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    """Known, and not, at another pace for each actuator."""
    values, known = push(n, actuators)
    return values, known & (n[:, None] // (1 + 37 * np.arange(actuators)) % 2 == 0)


def nonsense(n: np.ndarray, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    """Stretches of a force, and between them what is no number, said to be known."""
    kinds = np.array([1e308, np.nan, -1e308, np.inf, 3.0, -np.inf])
    return spread(kinds[n // 70 % kinds.size], actuators)


def sine(n: np.ndarray, actuators: int) -> tuple[np.ndarray, np.ndarray]:
    return spread(4 * np.sin(n / 50), actuators)


SCENES: dict[str, Scene] = {
    scene.__name__: scene for scene in (push, flips, slow_flips, flickers, nonsense, sine)
}


class Source:
    """A renderer of a scene. ``fault`` after ``fault_s``: it "raises", "hangs", or its blocks are
    "broken" (a shape that is none)."""

    left_out: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()

    def __init__(
        self,
        profile: Profile,
        scene: str,
        seconds: float,
        fault: str = "",
        fault_s: float = 0.0,
        slow: float = 0.0,
    ) -> None:
        self.kernels: dict[str, str] = {}
        self.width, self.scene = len(profile.actuators), SCENES[scene]
        self.rate = float(profile.timing.rate)
        self.samples = round(seconds * self.rate)
        self.fault, self.fault_at = fault, fault_s * self.rate
        self.loop, self.at = 0, 0.0
        self.slow = slow
        """Times longer than the block that each block takes."""

    def blocks(
        self, first: int = 0, generation: int = 0, at: Any = None, loop: int = 0
    ) -> Iterator[FrameBlock]:
        self.loop, self.at = loop, float(at or 0)
        begun = round(float(at or 0) * self.rate)
        for start in count(0, BLOCK):
            stop = min(start + BLOCK, self.samples - begun)
            if self.fault and start >= self.fault_at:
                self.fail()
            if self.slow:
                time.sleep(self.slow * BLOCK / self.rate)
            values, known = self.scene(
                np.arange(begun + start, begun + max(stop, start)), self.width
            )
            last = begun + stop >= self.samples
            yield FrameBlock(first + start, values, known, generation, last)
            if last:
                return

    def fail(self) -> None:
        if self.fault == "raises":
            raise OSError(errno.EIO, "the disk has failed")
        while self.fault == "hangs":
            time.sleep(1)

    def position(self, sample: int) -> Position:
        return Position(self.loop, Fraction(self.at + sample / self.rate))


class FullDisk:
    """A recording for which there is no room after some frames."""

    def __init__(self, frames: int) -> None:
        self.frames = frames

    def open(self) -> None: ...

    def send(self, *_: object) -> None:
        self.frames -= 1
        if self.frames < 0:
            raise OSError(errno.ENOSPC, "No space left on device")

    def close(self) -> None: ...


class Pressed:
    """Keys, each with its delay in seconds after the first frame or the key before; 0 is no delay."""

    def __init__(self, script: list[tuple[float, Any]]) -> None:
        self.script, self.before_s = list(script), 0.0

    def look(self, status: PlayerStatus) -> None:
        if status.sent and not self.before_s:
            self.before_s = time.monotonic()

    def pressed(self) -> list[Any]:
        now_s = time.monotonic()
        found = []
        while self.before_s and self.script and now_s - self.before_s >= self.script[0][0]:
            found.append(self.script.pop(0)[1])
            self.before_s = now_s
        return found


def profile_of(given: str) -> Profile:
    return parse_profile(given, "given") if "\n" in given else load_profile(given)


def main() -> None:
    given = json.loads(sys.argv[1])
    profile = profile_of(given["profile"])
    source = Source(profile, given["scene"], given.get("seconds", 1.0), **given.get("source", {}))
    sink = {"kind": "loopback", "file": given["log"], **given.get("sink", {})}
    options = given.get("options", {})
    if "disk" in given:
        options["record"] = FullDisk(given["disk"])
    if "keys" in given:
        options["keys"] = keys = Pressed(given["keys"])
        options["on_status"] = keys.look
    if "block_s" in given:
        options["on_status"] = lambda _: time.sleep(given["block_s"])
    report = play(source, profile, sink, **options)
    print(json.dumps(report.to_json()), flush=True)
    sys.exit(report.exit_code)


if __name__ == "__main__":
    main()
