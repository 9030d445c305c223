"""The watchdog, as the writer sees it."""

from __future__ import annotations

import os
import subprocess
from contextlib import suppress
from typing import Any

from ...errors import DeviceError
from .children import descriptor, start
from .clock import clock
from .messages import Kind, Message, MessageError, pack, pack_json
from .pipes import inlet, outlet
from .watchdog import first_message

READY_S = 10.0
"""To open the device a second time."""
BEAT_NS = 10_000_000
SILENT_NS = 2_000_000_000
"""A watchdog of which nothing was heard for so long watches no more."""
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
        """Waits until it has its own handle; from then on it must hear us. Raises DeviceError."""
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
        """Whether it may have tripped by now: what is sent from here on is neutral."""
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
        """Waits for its process, so long at most."""
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
