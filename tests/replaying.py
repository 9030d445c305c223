"""Replays into a file: a recording that is made up, the lines that the device got, the processes.

As a program: a player of its own, told by JSON what to play; its report goes to standard output.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from hapfmt.errors import FormatError
from hapfmt.replay.process.player import play
from hapfmt.replay.profile.model import FrameBlock, Profile
from hapfmt.replay.profile.parse import load_profile, parse_profile
from hapfmt.replay.render.renderer import Position

RATE = 1000
CHANGE = 500
"""Counts from one frame to the next, at most: 500 N/s in steps of 1 mN."""
NEUTRAL_COUNT = 5
PATIENT_S = 60.0
"""For what takes a second on a machine that does nothing else."""


def glove(hold_ms: int = 1000) -> Profile:
    """glove5, which here may be later than it should: busy machines are no fault of ours."""
    text = load_profile("glove5").text
    assert "hold_ms = 20\n" in text
    return parse_profile(text.replace("hold_ms = 20\n", f"hold_ms = {hold_ms}\n"))


class Sines:
    """A renderer of ``seconds`` of 5 Hz, 2 N; ``fails_at``: samples that come before an error."""

    kernels: ClassVar = {"thumb": "linear"}
    left_out = ("channel 6: no actuator",)

    def __init__(self, seconds: float, fails_at: int | None = None, error: Any = None) -> None:
        self.total, self.fails_at = round(seconds * RATE), fails_at
        self.error = error or FormatError("made up")
        self.lost: list[str] = []

    def blocks(
        self, first: int = 0, generation: int = 0, at: Any = None, loop: int = 0
    ) -> Iterator[FrameBlock]:
        assert loop == 0
        self.begun = first, at
        begin = min(round(float(at or 0) * RATE), self.total)
        for start in range(begin, max(self.total, begin + 1), 50):
            stop = min(start + 50, self.total)
            if self.fails_at is not None and stop > self.fails_at:
                raise self.error
            values = 2 * np.sin(2 * np.pi * 5 * np.arange(start, stop) / RATE + 1)
            values = np.repeat(values[:, None], 5, axis=1)
            known = np.ones(values.shape, bool)
            yield FrameBlock(first + start - begin, values, known, generation, stop == self.total)

    def position(self, sample: int) -> Position:
        first, at = self.begun
        return Position(0, Fraction(at or 0) + Fraction(sample - first, RATE))


class Line(NamedTuple):
    """What the device got, and from which process."""

    by: int
    at_ns: int
    number: int
    due_ns: int
    report: bytes

    @property
    def counts(self) -> tuple[int, ...]:
        assert self.report[0] == 1 and len(self.report) == 12
        return tuple(np.frombuffer(self.report, "<i2", 5, 2).tolist())

    @property
    def neutral(self) -> bool:
        return self.counts == (0,) * 5


def lines(path: Path) -> list[Line]:
    """All that are whole: somebody may still be writing."""
    if not path.exists():
        return []
    found = []
    for text in path.read_text(encoding="ascii").split("\n")[:-1]:
        line = json.loads(text)
        ((kind, data),) = line["reports"]
        assert kind == "output"
        found.append(
            Line(line["by"], line["at_ns"], line["number"], line["due_ns"], bytes.fromhex(data))
        )
    return found


def until(condition: Callable[[], Any], seconds: float = PATIENT_S) -> Any:
    """What it gives, once that is true."""
    stop = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < stop, "it does not happen"
        time.sleep(0.005)
    return found


def moving(file: Path, count: int = 100) -> list[Line]:
    """Once the device has got so many frames."""
    return until(lambda: len(got := lines(file)) >= count and got)


def running(pid: int) -> bool:
    """Neither gone nor a zombie."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in "ZX"


def child(pid: int) -> int | None:
    """The only child of a process."""
    try:
        found = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    except OSError:
        return None
    return int(found[0]) if found else None


class Playing:
    """A player in a process of its own."""

    def __init__(self, file: Path, **how: Any) -> None:
        self.file = file
        self.process = subprocess.Popen(
            [sys.executable, __file__, json.dumps({"file": str(file), **how})],
            stdout=subprocess.PIPE,
        )

    def __enter__(self) -> Playing:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()

    def moving(self) -> list[Line]:
        return moving(self.file)

    def report(self) -> dict[str, Any]:
        out, _ = self.process.communicate(timeout=PATIENT_S)
        report: dict[str, Any] = json.loads(out)
        assert self.process.returncode == report["exit_code"]
        return report


def main() -> int:
    how = json.loads(sys.argv[1])
    report = play(
        Sines(how.get("seconds", 60)),
        glove(how.get("hold_ms", 1000)),
        {"kind": "loopback", "file": how["file"], "faults": how.get("faults")},
        heartbeat_s=how.get("heartbeat_s", 5),
        realtime=False,
    )
    print(json.dumps(report.to_json()))
    return report.exit_code


if __name__ == "__main__":
    sys.exit(main())
