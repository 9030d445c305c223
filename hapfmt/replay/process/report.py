"""The report of a replay: counts, lateness, parts not played, outcome (SPEC 13, PLY-008).

Percentiles of the lateness take a few kilobytes for any number of frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

Outcome = Literal["clean", "late", "device-lost", "interrupted", "failed"]


@dataclass
class ReplayReport:
    """``late`` and ``call``: microseconds, p50, p99, p999 and max; None where no clock ran."""

    outcome: Outcome
    reason: str = ""
    """Of an end that is not clean."""
    signal: int | None = None
    error_code: int = 1
    """Exit code of what made it fail."""
    sent: int = 0
    """Frames, without the neutral ones."""
    skipped: int = 0
    """Frames left out, since a later one was due."""
    clamped: int = 0
    slew_limited: int = 0
    under_runs: int = 0
    gap_samples: int = 0
    refused: int = 0
    """Samples that were not finite."""
    neutral: int = 0
    """Neutral frames that the device took at the end."""
    late: dict[str, float] | None = None
    """From the time a frame was due to the call that sends it."""
    call: dict[str, float] | None = None
    """How long the device took each."""
    realtime: dict[str, str] = field(default_factory=dict)
    kernels: dict[str, str] = field(default_factory=dict)
    """By actuator."""
    left_out: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    watchdog: str = "none"
    """"stood by", "tripped: why", "ended: why", or "none"."""
    said: list[str] = field(default_factory=list)
    """What the processes wrote to their standard error."""

    @property
    def exit_code(self) -> int:
        if self.outcome == "device-lost":
            return 6
        if self.outcome == "late":
            return 5
        if self.outcome == "interrupted" and self.signal is not None:
            return 128 + self.signal
        if self.outcome == "failed":
            return self.error_code
        return 3 if self.lost else 0

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "exit_code": self.exit_code}


OCTAVE = 64
"""Classes from 2^k to 2^(k+1) nanoseconds: a percentile is at most 1/64 too large, never too
small. Below 128 ns, and for the largest of all, it is exact."""
LIMIT = 2**63 - 1
CLASSES = 58 * OCTAVE
"""Of all times up to LIMIT, about 292 years."""


def class_of(time_ns: int) -> int:
    shift = max(0, time_ns.bit_length() - OCTAVE.bit_length())
    return shift * OCTAVE + (time_ns >> shift)


def largest_of(index: int) -> int:
    """The largest time of a class."""
    if index < 2 * OCTAVE:
        return index
    shift = index // OCTAVE - 1
    return ((index - shift * OCTAVE + 1) << shift) - 1


class Lateness:
    """Times in nanoseconds; one that is negative counts as 0, one above LIMIT as LIMIT."""

    def __init__(self) -> None:
        self._classes: dict[int, int] = {}
        self.count = 0
        self.max = 0

    def add(self, time_ns: int) -> None:
        time_ns = min(max(time_ns, 0), LIMIT)
        index = class_of(time_ns)
        self._classes[index] = self._classes.get(index, 0) + 1
        self.count += 1
        self.max = max(self.max, time_ns)

    def merge(self, other: Lateness) -> None:
        """Merges the times of ``other`` into this."""
        for index, count in other._classes.items():
            self._classes[index] = self._classes.get(index, 0) + count
        self.count += other.count
        self.max = max(self.max, other.max)

    def percentiles(self, per_mille: Iterable[int] = (500, 990, 999)) -> tuple[int, ...]:
        """For each share, the least time that this share of all times does not exceed; 0 if
        there are none."""
        found = []
        order = sorted(self._classes)
        for wanted in per_mille:
            rank = -(-self.count * wanted // 1000)
            value = 0
            for index in order:
                rank -= self._classes[index]
                if rank <= 0:
                    value = min(largest_of(index), self.max)
                    break
            found.append(value)
        return tuple(found)

    def to_json(self) -> dict[str, object]:
        """All of it, to be sent to another process and merged there."""
        return {"max": self.max, "classes": [list(item) for item in sorted(self._classes.items())]}

    @classmethod
    def from_json(cls, value: dict[str, object]) -> Lateness:
        found = cls()
        classes = value["classes"]
        assert isinstance(classes, list) and isinstance(value["max"], int)
        found._classes = {int(index): int(count) for index, count in classes}
        found.count = sum(found._classes.values())
        found.max = value["max"]
        return found
