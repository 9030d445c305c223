"""The player's side of a replay on a device: starts the writer, feeds it, ends it; reads the keys.

A thread renders blocks ahead of time, at most one second of them. Every wait has a time limit. On
any exception the pipe to the writer closes. A writer whose player has gone ramps to rest by itself.
"""

from __future__ import annotations

import atexit
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from ...errors import HapfmtError, ParameterError
from ...reading.packets import Seconds
from ..profile.model import FrameBlock, FrameSink, Profile
from ..profile.parse import parse_profile
from . import loop
from .children import Errors, descriptor, seconds, start
from .loop import ReplayReport, Signals
from .pipes import (
    Kind,
    Message,
    MessageError,
    inlet,
    outlet,
    pack,
    pack_block,
    pack_json,
    parse_log,
    parts,
)

Key = Literal["pause", "back", "forward", "stop"]
BYTES: dict[bytes, Key] = {
    b" ": "pause",
    b"q": "stop",
    b"Q": "stop",
    b"\x1b[D": "back",
    b"\x1b[C": "forward",
    b"\x1bOD": "back",
    b"\x1bOC": "forward",
}
WINDOWS: dict[str, Key] = {
    " ": "pause",
    "q": "stop",
    "Q": "stop",
    "\xe0K": "back",
    "\xe0M": "forward",
    "\0K": "back",
    "\0M": "forward",
}
LONGEST = max(map(len, BYTES))


class TerminalKeys:
    """In a ``with`` block the terminal gives each key at once and shows none; after it, and at any
    exit of the interpreter, it is as before. Where there is no terminal, no key comes."""

    def __init__(self, descriptor: int | None = None) -> None:
        self.descriptor = descriptor
        self.before: Any = None
        self.waiting = b""

    def __enter__(self) -> TerminalKeys:
        if self.descriptor is None:
            with suppress(OSError, ValueError, AttributeError):
                self.descriptor = sys.stdin.fileno()
        if self.descriptor is None or not os.isatty(self.descriptor):
            self.descriptor = None
        elif sys.platform != "win32":
            self.begin(self.descriptor)
        return self

    def __exit__(self, *_: object) -> None:
        self.restore()

    if sys.platform != "win32":

        def begin(self, descriptor: int) -> None:
            import termios

            try:
                self.before = termios.tcgetattr(descriptor)
                changed = termios.tcgetattr(descriptor)
                changed[3] &= ~(termios.ICANON | termios.ECHO)
                off = os.fpathconf(descriptor, "PC_VDISABLE")
                # Ctrl-Z would stop the player and not the device; Ctrl-\\ leave the terminal so.
                for place in (termios.VSUSP, termios.VQUIT):
                    changed[6][place] = bytes([off & 0xFF])
                changed[6][termios.VMIN], changed[6][termios.VTIME] = 0, 0
                termios.tcsetattr(descriptor, termios.TCSADRAIN, changed)
            except (termios.error, OSError):
                self.restore()
                self.descriptor = None
            else:
                atexit.register(self.restore)

        def restore(self) -> None:
            import termios

            if self.before is not None and self.descriptor is not None:
                with suppress(termios.error, OSError):  # the terminal may have gone
                    termios.tcsetattr(self.descriptor, termios.TCSANOW, self.before)
            self.before = None
            atexit.unregister(self.restore)

        def pressed(self) -> list[Key]:
            """Keys since the last call; unknown keys are dropped."""
            if self.descriptor is None:
                return []
            try:
                self.waiting += os.read(self.descriptor, 1 << 10)
            except BlockingIOError:
                pass
            except OSError:
                self.descriptor = None
            found, self.waiting = split(self.waiting)
            return found

    else:

        def restore(self) -> None:
            """Nothing was changed."""

        def pressed(self) -> list[Key]:
            import msvcrt

            found: list[Key] = []
            while self.descriptor is not None and msvcrt.kbhit():
                key = msvcrt.getwch()
                if key in "\0\xe0":
                    key += msvcrt.getwch()
                if key in WINDOWS:
                    found.append(WINDOWS[key])
            return found


def split(data: bytes) -> tuple[list[Key], bytes]:
    """Keys, and what may be the beginning of one."""
    found: list[Key] = []
    while data:
        for size in range(1, LONGEST + 1):
            if data[:size] in BYTES:
                found.append(BYTES[data[:size]])
                data = data[size:]
                break
        else:
            if len(data) < LONGEST and any(name.startswith(data) for name in BYTES):
                return found, data
            data = data[1:]
    return found, b""


WAITING = 32
"""Blocks of some 50 ms each."""


class PlayPosition(Protocol):
    """Which time through the recording, and where in it."""

    @property
    def loop(self) -> int: ...

    @property
    def seconds(self) -> Seconds | None: ...


class SeekableSource(loop.FrameSource, Protocol):
    """A Renderer that seeks."""

    def blocks(
        self, first: int = 0, generation: int = 0, at: Seconds | None = None, loop: int = 0
    ) -> Iterator[FrameBlock]: ...

    def position(self, sample: int) -> PlayPosition: ...


class Feeding:
    """One generation: what is played from one position on. ``error``: what ended it early."""

    def __init__(
        self,
        source: SeekableSource,
        actuators: int,
        generation: int = 0,
        at: Seconds | None = None,
        loop: int = 0,
        before: Feeding | None = None,
    ) -> None:
        self.source, self.generation, self.at, self.loop = source, generation, at, loop
        self.actuators = actuators
        self.ready: queue.Queue[FrameBlock] = queue.Queue(WAITING)
        self.head: FrameBlock | None = None
        self.begun = False
        """What the source says of positions is about this generation."""
        self.halted = threading.Event()
        self.error: BaseException | None = None
        self.thread = threading.Thread(target=self.run, args=(before,), daemon=True)
        self.thread.start()

    def run(self, before: Feeding | None) -> None:
        if before is not None:
            before.halt()
            before.thread.join()
        stop = 0
        try:
            for block in self.source.blocks(0, self.generation, self.at, self.loop):
                self.begun = True
                for part in parts(block):
                    if not self.put(part):
                        return
                stop = block.first + len(block.values)
                if block.last:
                    return
        except BaseException as error:
            self.error = error
        shape = (0, self.actuators)
        nothing = FrameBlock(
            stop, np.zeros(shape), np.zeros(shape, bool), self.generation, last=True
        )
        self.put(nothing)

    def put(self, block: FrameBlock) -> bool:
        """Waits for room; False once the player has stopped."""
        while not self.halted.is_set():
            try:
                self.ready.put(block, timeout=0.05)
                return True
            except queue.Full:
                continue
        return False

    def take(self, before: int) -> FrameBlock | None:
        """The next block, if it is there and begins earlier than sample ``before``."""
        if self.head is None:
            try:
                self.head = self.ready.get_nowait()
            except queue.Empty:
                return None
        if self.head.first >= before:
            return None
        block, self.head = self.head, None
        return block

    def halt(self) -> None:
        self.halted.set()


AHEAD_S = 1.0
"""The writer never has more than this ahead."""
PREFILL_S = 0.2
"""Before the start; an hour-long file starts as soon."""
JUMP_S = 5.0
"""Seconds that an arrow key jumps."""
TURN_S = 0.02
ALIVE_S = 0.25
STATUS_S = 0.1
READY_S = 30.0
"""For the device, the watchdog, and the imports of both on a busy machine."""
SILENT_S = 15.0
"""A writer that is silent for this long is killed. A call into a hanging device returns after
5.2 s, and the first neutral frame may be a second such call."""
END_S = 5.0
"""For a process that has said all."""


class PlayerStatus(NamedTuple):
    position_s: float
    """In the file."""
    state: str
    sent: int
    skipped: int
    under_runs: int
    max_late_us: float


class Keyboard(Protocol):
    def pressed(self) -> list[Key]: ...


class Patient(Signals):
    """A second signal does not cut the ramp short."""

    def ask(self, number: int, _frame: object) -> None:
        self.asked = self.asked or number


def play(
    renderer: SeekableSource,
    profile: Profile,
    sink_config: dict[str, Any],
    *,
    gain: float | None = None,
    record: FrameSink | None = None,
    on_status: Callable[[PlayerStatus], None] | None = None,
    keys: Keyboard | None = None,
    watchdog: bool = True,
    heartbeat_s: float | None = None,
    realtime: bool = True,
) -> ReplayReport:
    """Play what ``renderer`` renders on the device that ``sink_config`` names (sinks.open_sink).

    ``gain``: of everything, above 0 and at most 1 [that of the profile]. ``record`` gets each frame
    that was sent. ``watchdog`` False: without the second process, where a device cannot be opened
    twice. ``heartbeat_s``: a writer that is silent for longer trips the watchdog [0.1, and twice
    the hold time at least]. Signals end it by a ramp (SIGINT, SIGTERM, SIGHUP, in the main
    thread). The report gives errors of file or device; other exceptions are raised.
    """
    if parse_profile(profile.text) != profile:
        raise ParameterError("the profile differs from its text, which is what the writer reads")
    if heartbeat_s is None:
        heartbeat_s = max(0.1, 2 * profile.timing.hold_s)
    if heartbeat_s <= profile.timing.hold_s:
        raise ParameterError(
            f"a heartbeat of {heartbeat_s} s: more than the {profile.timing.hold_s} s that the"
            " profile lets a frame be late"
        )
    setup = {
        "profile": profile.text,
        "name": profile.name,
        "sink": sink_config,
        "gain": profile.gain if gain is None else gain,
        "heartbeat_s": heartbeat_s,
        "watchdog": watchdog,
        "realtime": realtime,
        "log": record is not None,
    }
    with Patient() as signals:
        player = Player(renderer, profile, record, on_status, keys, signals)
        try:
            player.target.send(pack_json(Kind.SETUP, **setup))
            player.run()
        finally:
            player.close()
        return player.report()


class Player:
    def __init__(
        self,
        renderer: SeekableSource,
        profile: Profile,
        record: FrameSink | None,
        on_status: Callable[[PlayerStatus], None] | None,
        keys: Keyboard | None,
        signals: Signals,
    ) -> None:
        self.renderer, self.profile, self.record = renderer, profile, record
        self.on_status, self.keys, self.signals = on_status, keys, signals
        self.rate = float(profile.timing.rate)
        self.writer = start("writer", subprocess.PIPE)
        self.errors = Errors(self.writer.stderr)
        self.source = inlet(descriptor(self.writer.stdout))
        self.target = outlet(descriptor(self.writer.stdin))
        self.feed = Feeding(renderer, len(profile.actuators))
        self.realtime: dict[str, str] = {}
        self.ready = self.started = self.stopped = self.paused = False
        self.fed = self.played = self.loop = 0
        self.position_s = 0.0
        self.status: dict[str, Any] = {}
        self.end: dict[str, Any] | None = None
        self.error: BaseException | None = None
        """Error of the file, or of the sink of the record."""
        self.trouble = ""
        """With the writer."""
        now = seconds()
        self.heard_at = self.began_at = now
        self.alive_at = self.status_at = 0.0
        self.stop_at: float | None = None
        """The writer must have ended by then."""

    def run(self) -> None:
        """Runs until the writer reports its end, or no longer can."""
        while self.end is None and not self.trouble:
            self.source.wait(TURN_S)
            self.hear()
            if self.signals.asked is not None:
                self.stop("interrupted", f"signal {self.signals.asked}", self.signals.asked)
            self.give()
            self.press()
            self.watch(seconds())

    def hear(self) -> None:
        """Handles all messages of the writer."""
        try:
            while self.end is None and (message := self.source.take()) is not None:
                self.heard_at = seconds()
                self.handle(message)
        except MessageError as error:
            self.trouble = f"the writer sent an unknown message: {error}"
        if self.source.ended and self.end is None:
            self.trouble = self.trouble or "the writer has died"

    def handle(self, message: Message) -> None:
        match message.kind:
            case Kind.READY:
                self.ready = True
                self.realtime = message.field("realtime", dict)
            case Kind.STATUS:
                status = message.fields()
                if status.get("generation") == self.feed.generation:
                    self.played = message.field("played", int)
                    self.status = status
            case Kind.SENT:
                self.keep(message)
            case Kind.END:
                self.end = message.fields()
            case other:
                raise MessageError(f"{other.name} is not a message of a writer")

    def keep(self, message: Message) -> None:
        if self.record is None or self.error is not None:
            return
        try:
            for sent in parse_log(message.payload):
                self.record.send(sent.frame, ())
        except Exception as error:
            self.error = error
            self.stop("failed", f"the record cannot be written: {error}")

    def give(self) -> None:
        """Sends blocks, up to the limit ahead, and the start command when there are enough."""
        ahead = self.played + round(AHEAD_S * self.rate)
        while not self.stopped and (block := self.feed.take(ahead)) is not None:
            self.target.send(pack(Kind.BLOCK, pack_block(block)))
            self.fed = block.first + len(block.values)
            if block.last:
                self.fed = max(self.fed, ahead)
                self.error = self.error or self.feed.error
        if self.ready and not self.started and self.fed >= PREFILL_S * self.rate:
            self.started = True
            self.target.send(pack(Kind.START))

    def press(self) -> None:
        for key in self.keys.pressed() if self.keys is not None else ():
            if key == "stop":
                self.stop("interrupted", "q was pressed")
            elif not self.started or self.stopped:
                pass
            elif key == "pause":
                self.paused = not self.paused
                self.target.send(pack(Kind.PAUSE if self.paused else Kind.RESUME))
            else:
                self.seek(self.position() + (JUMP_S if key == "forward" else -JUMP_S))

    def position(self) -> float:
        """Seconds in the file; between two loops the last there was."""
        if self.feed.begun:
            place = self.renderer.position(self.played)
            self.loop = place.loop
            if place.seconds is not None:
                self.position_s = float(place.seconds)
        return self.position_s

    def seek(self, to_s: float) -> None:
        """On with another place of the file; the writer ramps down first."""
        before = self.feed
        self.position_s = max(to_s, 0.0)
        self.feed = Feeding(
            self.renderer,
            before.actuators,
            before.generation + 1,
            self.position_s,
            self.loop,
            before,
        )
        generation = self.feed.generation
        self.fed = self.played = 0
        self.target.send(pack_json(Kind.SEEK, generation=generation, first=0))

    def stop(self, outcome: str, reason: str, number: int | None = None) -> None:
        """To rest by a ramp; asked for once."""
        if not self.stopped:
            self.stopped = True
            self.stop_at = seconds() + self.rest_s() + SILENT_S
            self.target.send(pack_json(Kind.STOP, outcome=outcome, reason=reason, signal=number))

    def rest_s(self) -> float:
        """Upper bound of a ramp to rest and of what follows it, for any actuators."""
        timing = self.profile.timing
        slowest = max(((a.maximum - a.minimum) / a.slew for a in self.profile.actuators), default=0)
        return timing.ramp_s + slowest + timing.neutral_count * 0.02 + 2 * float(timing.period)

    def watch(self, now: float) -> None:
        """Sends heartbeats, checks time limits, and reports the status."""
        if now - self.alive_at > ALIVE_S:
            self.alive_at = now
            self.target.send(pack(Kind.ALIVE))
        self.target.flush()
        if not self.ready and now - self.began_at > READY_S:
            self.trouble = f"the writer was not ready after {READY_S:.0f} s"
        elif self.ready and now - self.heard_at > SILENT_S:
            self.trouble = f"the writer said nothing for {SILENT_S:.0f} s"
        elif self.stop_at is not None and now > self.stop_at:
            self.trouble = "the writer did not come to rest in time"
        elif self.on_status is not None and self.status and now - self.status_at > STATUS_S:
            self.status_at = now
            status = self.status
            self.on_status(
                PlayerStatus(
                    self.position(),
                    status["state"],
                    status["sent"],
                    status["skipped"],
                    status["under_runs"],
                    status["max_late_us"],
                )
            )

    def close(self) -> None:
        """Ends all processes and threads."""
        self.feed.halt()
        if self.end is None and not self.trouble:
            # Something was raised here: the writer comes to rest all the same.
            self.stop("failed", "the player has failed")
            self.on_status = self.keys = self.record = None
            self.run()
        try:
            # Who has closed the pipe is as good as gone.
            self.writer.wait(END_S if self.end is not None or self.source.ended else 0)
        except subprocess.TimeoutExpired:
            self.writer.kill()
            self.trouble = (self.trouble or "the writer did not go") + ", and was killed"
            # Even this may fail, in a call of the kernel that does not return.
            with suppress(subprocess.TimeoutExpired):
                self.writer.wait(END_S)
        self.target.close()
        for pipe in (self.writer.stdin, self.writer.stdout):
            if pipe is not None:
                pipe.close()
        self.feed.thread.join(END_S)
        # The watchdog shares the writer's standard error, so this waits for both.
        self.errors.wait(END_S)

    def report(self) -> ReplayReport:
        """The writer's final report; if it sent none, one from its last status."""
        end = dict(self.end or {**self.status, "outcome": "failed", "reason": self.died()})
        for name in ("state", "played", "generation", "max_late_us", "under_run_samples"):
            end.pop(name, None)
        if self.error is not None and end["outcome"] in ("clean", "failed"):
            if not isinstance(self.error, (HapfmtError, OSError)):
                raise self.error
            end |= {"outcome": "failed", "reason": str(self.error)}
            end["error_code"] = getattr(self.error, "exit_code", 1)
        watchdog = self.errors.watchdog or end.pop("watchdog", "none")
        end.pop("watchdog", None)
        return ReplayReport(
            **end,
            watchdog=watchdog,
            realtime=self.realtime,
            kernels=dict(self.renderer.kernels),
            left_out=list(self.renderer.left_out),
            lost=list(self.renderer.lost),
            said=self.errors.lines,
        )

    def died(self) -> str:
        code = self.writer.returncode
        if code is None:
            return f"{self.trouble}, in vain"
        return f"{self.trouble} ({f'signal {-code}' if code < 0 else f'exit code {code}'})"
