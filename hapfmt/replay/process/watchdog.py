"""The process that puts the device to rest when the writer no longer does.

It opens the device a second time before anything moves, and then only listens on standard input for
the writer's heartbeat. It trips when the heartbeat stops, or when the input ends without a goodbye.
It then sends neutral frames through its own handle, at once and repeatedly. It stops when the
writer has ended or has said goodbye. The repetition matters: a writer that was stalled in a call
may send an old force after the first neutral frame. The watchdog does not ramp. It does not know
the force, only that no process controls it.

If the writer hangs, the first neutral frame comes ``heartbeat_s`` after the last beat. If the
writer is killed, it comes a few milliseconds after its death: 3.4 ms, at most 6.7 ms in 20 runs.
Those values hold for two cores at twice their load under SCHED_FIFO; without it, 5.3 ms and 23 ms.

This file also has the writer's side of the watchdog.
"""

from __future__ import annotations

import faulthandler
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from typing import Any, NamedTuple

from ...errors import DeviceError, DeviceGoneError, HapfmtError
from ..profile.model import Frame, FrameSink
from ..sinks import open_sink
from . import children
from .children import clock, descriptor, seconds, start
from .pipes import (
    Inlet,
    Kind,
    Message,
    MessageError,
    Outlet,
    inlet,
    outlet,
    pack,
    pack_json,
    reports_of,
)

SETUP_S = 10.0
"""Time limit for the setup from the writer."""
ALIVE_S = 0.05
"""Interval of the heartbeats to the writer."""
LONGEST_S = 30.0
"""Upper bound after tripping, even if the writer still runs."""


class WatchdogSetup(NamedTuple):
    sink: dict[str, Any]
    neutral: tuple[tuple[Any, ...], ...]
    """The reports of as many neutral frames as are to be sent."""
    heartbeat_s: float
    period_s: float
    """From one neutral frame to the next."""
    realtime: bool

    @classmethod
    def of(cls, message: Message) -> WatchdogSetup:
        return cls(
            message.field("sink", dict),
            tuple(reports_of(reports) for reports in message.field("neutral", list)),
            message.field("heartbeat_s", float),
            message.field("period_s", float),
            message.field("realtime", bool),
        )


class Watchdog:
    def __init__(
        self, setup: WatchdogSetup, sink: FrameSink, source: Inlet, target: Outlet, asked: list[int]
    ) -> None:
        self.setup, self.sink, self.source, self.target = setup, sink, source, target
        self.beat_at = seconds()
        self.alive_at = 0.0
        self.goodbye = False
        self.turn = 0
        """Number of the neutral frame; some frames contain it."""
        self.sent = self.failed = 0
        self.error = ""
        self.device_gone = False
        self.asked = asked
        """Signals that asked it to end; it is the writer that does that."""

    def run(self) -> None:
        cause = self.watch()
        if cause:
            self.trip(cause)

    def watch(self) -> str:
        """Until a goodbye (empty), or the cause to trip."""
        while True:
            # Before it listens: beats that came while it did not run are no silence.
            now = seconds()
            self.listen()
            if self.goodbye:
                return ""
            if self.source.ended:
                return "the writer has died"
            silent_s = now - self.beat_at
            if silent_s >= self.setup.heartbeat_s:
                return f"the writer was silent for {silent_s * 1000:.0f} ms"
            if now - self.alive_at >= ALIVE_S:
                self.alive_at = now
                self.target.send(pack_json(Kind.ALIVE))
            self.report_signal()
            self.source.wait(min(self.setup.heartbeat_s - silent_s, ALIVE_S))

    def listen(self) -> None:
        """All that the writer has said."""
        try:
            while (message := self.source.take()) is not None:
                self.beat_at = seconds()
                self.goodbye = self.goodbye or message.kind is Kind.GOODBYE
        except MessageError:
            # Malformed messages mean that the writer is faulty.
            self.source.ended = True

    def report_signal(self) -> None:
        if self.asked:
            self.target.send(pack_json(Kind.GOODBYE, signal=self.asked.pop()))

    def trip(self, cause: str) -> None:
        """Sends neutral frames, at least as many as requested, until the writer is done or gone."""
        began = seconds()
        # A device that takes nothing can hold a call for seconds; but not this process without end.
        faulthandler.dump_traceback_later(LONGEST_S, exit=True)
        self.neutral()
        first_ms = (seconds() - began) * 1000
        self.target.send(pack_json(Kind.TRIPPED, cause=cause))
        rest = len(self.setup.neutral) - 1
        gone = False
        while not self.device_gone and (rest > 0 or not gone):
            time.sleep(self.setup.period_s)
            self.listen()
            if not gone and (self.goodbye or self.source.ended):
                # What the writer did last may have come after our last frame.
                gone, rest = True, max(rest, 1)
            self.neutral()
            rest -= 1
            if seconds() - began > LONGEST_S / 2:
                break
        self.say(state="tripped", cause=cause, sent=self.sent, failed=self.failed,
                 first_ms=round(first_ms, 3), error=self.error)  # fmt: skip

    def neutral(self) -> None:
        reports = self.setup.neutral[self.turn % len(self.setup.neutral)]
        self.turn += 1
        try:
            self.sink.send(Frame(-1, 0, ()), reports)
            self.sent += 1
        except Exception as error:
            self.failed += 1
            self.error = str(error)
            self.device_gone = isinstance(error, DeviceGoneError)

    @staticmethod
    def say(**state: Any) -> None:
        """To the player, who reads our standard error: the writer may be dead."""
        with suppress(OSError):
            os.write(2, json.dumps({"watchdog": state}).encode() + b"\n")


def main() -> int:
    source, target = inlet(0), outlet(1)
    asked = signals()
    try:
        setup = WatchdogSetup.of(first_message(source, Kind.SETUP, SETUP_S))
        if not setup.neutral:
            raise MessageError("no neutral frame")
        sink = open_sink(setup.sink)
    except Exception as error:
        target.send(pack_json(Kind.READY, error=str(error) or repr(error)))
        target.drain(1.0)
        return error.exit_code if isinstance(error, HapfmtError) else 1
    # Above the writer: one that spins without end must not keep its watchdog from running.
    got = children.apply(children.PRIORITY + 1) if setup.realtime else children.nothing()
    target.send(pack_json(Kind.READY, realtime=got))
    try:
        Watchdog(setup, sink, source, target, asked).run()
    finally:
        sink.close()
        target.drain(1.0)
    return 0


def signals() -> list[int]:
    """Where the numbers of the signals appear that ask a process to end."""
    asked: list[int] = []
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda number, _: asked.append(number))
    return asked


def first_message(source: Inlet, kind: Kind, within_s: float) -> Message:
    """The first message, which must be of this kind and come in time."""
    stop = seconds() + within_s
    while (message := source.take()) is None:
        left = stop - seconds()
        if source.ended or left <= 0:
            raise MessageError(f"no {kind.name}: {'the pipe ended' if source.ended else 'silence'}")
        source.wait(left)
    if message.kind is not kind:
        raise MessageError(f"{message.kind.name} instead of {kind.name}")
    return message


if __name__ == "__main__":
    sys.exit(main())


READY_S = 10.0
"""To open the device a second time."""
BEAT_NS = 10_000_000
SILENT_NS = 2_000_000_000
"""A watchdog that is silent for this long is treated as dead."""
BEAT = pack(Kind.BEAT)


class Guard:
    """``state`` is what the report says of it: empty while all is well."""

    def __init__(self) -> None:
        self.process = start("watchdog")
        self.source = inlet(descriptor(self.process.stdout))
        self.target = outlet(descriptor(self.process.stdin))
        self.beat_ns = self.heard_ns = 0
        self.heartbeat_ns = 0
        self.realtime: dict[str, str] = {}
        self.state = ""
        self.tripped = False
        self.ended = False
        self.asked: int | None = None
        """The signal that asked it to end."""

    def begin(self, heartbeat_s: float, **setup: Any) -> None:
        """Waits until it has its own handle; then it needs heartbeats. Raises DeviceError."""
        self.heartbeat_ns = round(heartbeat_s * 1e9)
        self.target.send(pack_json(Kind.SETUP, heartbeat_s=heartbeat_s, **setup))
        self.target.drain(1.0)
        try:
            answer = first_message(self.source, Kind.READY, READY_S).fields()
        except MessageError as error:
            raise DeviceError(f"the watchdog did not begin: {error}") from None
        if "error" in answer:
            raise DeviceError(f"the watchdog cannot open the device too: {answer['error']}")
        self.realtime = answer["realtime"]
        self.heard_ns = clock()
        self.beat(self.heard_ns)

    def beat(self, now_ns: int) -> None:
        if not self.ended:
            self.target.send(BEAT)
            self.beat_ns = now_ns

    def due(self, now_ns: int) -> bool:
        return now_ns - self.beat_ns >= BEAT_NS

    def left_alone(self, now_ns: int) -> bool:
        """True once the watchdog may have taken over; from then on send neutral frames only."""
        return self.tripped or (not self.ended and now_ns - self.beat_ns >= self.heartbeat_ns)

    def listen(self, now_ns: int) -> None:
        """What it has said since."""
        if self.ended:
            return
        try:
            while (message := self.source.take()) is not None:
                self.heard_ns = now_ns
                self.hear(message)
        except MessageError as error:
            self.ended, self.state = True, f"ended: {error}"
        if self.source.ended or self.target.broken:
            self.ended, self.state = True, self.state or "ended: it has died"
        elif now_ns - self.heard_ns > SILENT_NS and not self.left_alone(now_ns):
            # Else we were stalled ourselves, and it may not yet have had its turn again.
            self.ended, self.state = True, self.state or "ended: it is silent"

    def hear(self, message: Message) -> None:
        if message.kind is Kind.TRIPPED:
            self.tripped = True
            self.state = f"tripped: {message.field('cause', str)}"
        elif message.kind is Kind.GOODBYE:
            self.asked = message.field("signal", int)

    def goodbye(self) -> None:
        """We end, and well."""
        if self.heartbeat_ns:
            self.listen(clock())
        self.state = self.state or ("stood by" if self.heartbeat_ns else "none")
        if not self.target.broken:
            self.target.send(pack(Kind.GOODBYE))
        self.target.drain(1.0)

    def end(self, seconds: float = 5.0) -> None:
        """Waits for its process, at most this many seconds."""
        self.target.close()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            with suppress(OSError):
                os.write(2, b"the watchdog did not end, and was killed\n")
