"""The writer: while it lives, it is the only process that writes to the device.

It reads the setup from standard input, then blocks and commands of the player. It sends status
messages to the player on standard output. If the input ends without a stop command, the player has
died.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any, NamedTuple

from ...errors import DeviceError, HapfmtError
from ..sinks import open_sink
from . import children
from .pipes import Inlet, Kind, Message, Outlet, inlet, outlet, pack_json, reports_json
from .watchdog import Guard, first_message, signals

if TYPE_CHECKING:
    from ..profile.model import Profile

SETUP_S = 10.0
PERIOD_S = 0.002, 0.02
"""From one neutral frame of the watchdog to the next: that of the device, within these."""


class WriterSetup(NamedTuple):
    profile: str
    """The TOML of it."""
    name: str
    sink: dict[str, Any]
    gain: float
    heartbeat_s: float
    watchdog: bool
    realtime: bool
    log: bool

    @classmethod
    def of(cls, message: Message) -> WriterSetup:
        kinds = {"profile": str, "name": str, "sink": dict, "gain": float, "heartbeat_s": float}
        flags = dict.fromkeys(("watchdog", "realtime", "log"), bool)
        return cls(**{name: message.field(name, kind) for name, kind in (kinds | flags).items()})


def main() -> int:
    source, target, asked = inlet(0), outlet(1), signals()
    guard: Guard | None = None
    try:
        setup = WriterSetup.of(first_message(source, Kind.SETUP, SETUP_S))
        # It begins while we import what is heavy.
        guard = Guard() if setup.watchdog else None
        report = write(setup, guard, source, target, asked)
    except Exception as error:
        known = isinstance(error, HapfmtError)
        report = {
            "outcome": "device-lost" if isinstance(error, DeviceError) else "failed",
            "reason": str(error) if known else repr(error),
            "error_code": error.exit_code if isinstance(error, HapfmtError) else 1,
        }
    if guard is not None:
        guard.goodbye()
        report["watchdog"] = guard.state
    # Before the wait for the watchdog, which a device that hangs may hold in a call for seconds.
    target.send(pack_json(Kind.END, **report))
    target.drain(2.0)
    if guard is not None:
        guard.end()
    # All is said, and no library shall keep the process by what it does at an end.
    os._exit(0)


def write(
    setup: WriterSetup, guard: Guard | None, source: Inlet, target: Outlet, asked: list[int]
) -> dict[str, Any]:
    """From the opening of the device to its closing: what the report says of it."""
    from ..profile.parse import parse_profile
    from .loop import FrameLoop

    profile = parse_profile(setup.profile, setup.name)
    sink = open_sink(setup.sink, profile)
    warm_up(profile)
    got = children.apply() if setup.realtime else children.nothing()
    loop = FrameLoop(profile, setup.gain, sink, source, target, asked, log=setup.log)
    try:
        if profile.init:
            loop.aside(profile.init)
        if guard is not None:
            guard.begin(
                setup.heartbeat_s,
                sink=setup.sink,
                neutral=neutral_frames(profile),
                period_s=min(max(float(profile.timing.period), PERIOD_S[0]), PERIOD_S[1]),
                realtime=setup.realtime,
            )
            loop.guard = guard
        target.send(pack_json(Kind.READY, realtime=got))
    except Exception as error:
        loop.fail(error)
    try:
        loop.run()
        loop.tell_log()
        return loop.report()
    finally:
        sink.close()


def warm_up(profile: Profile) -> None:
    """What a frame needs was used once before the first: pages, caches, modules."""
    import numpy as np

    from ..profile.model import FrameBlock
    from ..profile.packing import Packer
    from ..schedule import Schedule
    from .pipes import Sent, pack_block, pack_log, parse_block

    shape = (64 * profile.timing.frame_samples, len(profile.actuators))
    schedule, packer = Schedule(profile), Packer(profile)
    block = FrameBlock(0, np.zeros(shape), np.ones(shape, bool), last=True)
    schedule.feed(parse_block(pack_block(block)))
    while (frame := schedule.frames_due(schedule.next_ns)) is not None:
        packer.pack(frame)
        pack_log([Sent(frame, frame.due_ns)])
    packer.neutral()


def neutral_frames(profile: Profile) -> list[list[list[str]]]:
    """As many as are sent at an end; they may differ (counters)."""
    from ..profile.packing import Packer

    packer = Packer(profile)
    return [reports_json(packer.neutral()) for _ in range(profile.timing.neutral_count)]


if __name__ == "__main__":
    sys.exit(main())
