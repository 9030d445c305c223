"""A replay on a virtual clock: as fast as it goes, the same frames each time.

For dry runs and recordings: no process and no real time, so no frame is late and none is skipped.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import suppress
from math import ceil
from types import FrameType
from typing import Any, Protocol

import numpy as np

from ...errors import HapfmtError
from ..frames import Block, Frame, Sink
from ..profile.model import Profile, Report
from ..profile.packing import Packer
from ..schedule import Schedule
from .report import ReplayReport


class Source(Protocol):
    """A Renderer."""

    @property
    def kernels(self) -> dict[str, str]: ...

    @property
    def left_out(self) -> list[str]: ...

    @property
    def lost(self) -> list[str]: ...

    def blocks(self) -> Iterator[Block]: ...


class Signals:
    """SIGINT, SIGTERM and SIGHUP ask for the end; a second one is a KeyboardInterrupt."""

    def __init__(self) -> None:
        self.asked: int | None = None
        self.before: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            with suppress(ValueError, AttributeError):  # not in the main thread; not on Windows
                number = getattr(signal, name)
                self.before[number] = signal.signal(number, self.ask)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self.before.items():
            signal.signal(number, handler)

    def ask(self, number: int, _frame: FrameType | None) -> None:
        if self.asked is not None:
            raise KeyboardInterrupt
        self.asked = number


class Rehearsal:
    """One schedule, its blocks, and the sinks that get its frames."""

    def __init__(
        self, blocks: Iterator[Block], profile: Profile, sinks: Sequence[Sink], gain: float | None
    ) -> None:
        self.schedule = Schedule(profile, gain)
        self.packer = Packer(profile)
        self.blocks, self.profile, self.sinks = blocks, profile, list(sinks)
        """One that failed is given nothing more."""
        self.error: BaseException | None = None
        """Of the blocks: what came before it is played, and the ramp to rest."""
        self.neutral = 0

    def feed(self) -> None:
        """As far as the next frame needs."""
        try:
            while self.schedule.needs_blocks and self.schedule.state == "playing":
                self.schedule.feed(next(self.blocks, None) or self.nothing())
        except (Exception, KeyboardInterrupt) as error:
            self.error = error
            self.schedule.stop("failed")

    def nothing(self) -> Block:
        shape = (0, len(self.profile.actuators))
        return Block(self.schedule.played, np.zeros(shape), np.zeros(shape, bool), last=True)

    def run(self, signals: Signals) -> None:
        try:
            self.report(self.profile.init, 0)
            while self.schedule.state != "ended":
                if signals.asked is not None:
                    self.schedule.stop("interrupted")
                self.feed()
                frame = self.schedule.frames_due(self.schedule.next_ns)
                assert frame is not None
                self.send(frame, self.packer.pack(frame))
        except BaseException:
            with suppress(Exception):  # the first error is the one to tell
                self.rest()
            raise
        self.rest()

    def rest(self) -> None:
        start_ns, period_ns = self.schedule.next_ns, self.profile.timing.period * 10**9
        for _ in range(self.profile.timing.neutral_count):
            self.report(self.packer.neutral(), start_ns + ceil(self.neutral * period_ns))
            self.neutral += 1
        self.report(self.profile.exit, start_ns + ceil(self.neutral * period_ns))

    def report(self, reports: tuple[Report, ...], due_ns: int) -> None:
        """Reports that are no samples."""
        if reports:
            self.send(Frame(-1, due_ns, ()), reports)

    def send(self, frame: Frame, reports: tuple[Report, ...]) -> None:
        for sink in self.sinks[:]:
            try:
                sink.send(frame, reports)
            except BaseException:
                self.sinks.remove(sink)
                raise


def rehearse(
    renderer: Source, profile: Profile, sinks: Sequence[Sink], *, gain: float | None = None
) -> ReplayReport:
    """Play to sinks that need no real time; they are closed whatever happens.

    An error of the file ends it by a ramp to rest, and the report names it; an error of a sink is
    raised.
    """
    rehearsal = Rehearsal(renderer.blocks(), profile, sinks, gain)
    opened: list[Sink] = []
    try:
        for sink in sinks:
            sink.open()
            opened.append(sink)
        with Signals() as signals:
            rehearsal.run(signals)
    finally:
        for sink in opened:
            sink.close()
    error = rehearsal.error
    if error is not None and not isinstance(error, (HapfmtError, OSError)):
        raise error
    counts, outcome = rehearsal.schedule.counts, rehearsal.schedule.outcome
    return ReplayReport(
        outcome=outcome or "clean",
        reason=str(error or ""),
        signal=signals.asked if outcome == "interrupted" else None,
        error_code=getattr(error, "exit_code", 1),
        sent=counts.sent,
        clamped=counts.clamped,
        slew_limited=counts.slew_limited,
        gap_samples=counts.gap_samples,
        refused=counts.refused,
        neutral=rehearsal.neutral,
        kernels=dict(renderer.kernels),
        left_out=list(renderer.left_out),
        lost=list(renderer.lost),
    )
