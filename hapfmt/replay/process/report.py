"""What a replay was: counts, lateness, what was not played, how it ended (SPEC 13, PLY-008)."""

from __future__ import annotations

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
