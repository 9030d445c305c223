"""Recordings to replay, and what arrived at a device, read from its bytes by the layouts alone.

Nothing of hapfmt.replay is used here: what must arrive follows from players.md, the reports as the
profiles describe them, and the gain of 0.5 that a profile has.
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import groupby, pairwise
from math import cos, floor, pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from spec import ROOT
from virtual_hid.model import Event
from virtual_hid.running import Running
from virtual_hid.world import World

from hapfmt import Channel, Recording, Settings, write
from hapfmt.recording import Calibration

PROFILES = ROOT / "hapfmt" / "replay" / "profile" / "builtin"
FINGERS = ("thumb", "index", "middle", "ring", "little")
RAMP = 50
"""Samples of glove5's ramp: 50 ms at 1 kHz."""
CHANGE = 500
"""Counts from one sample to the next: 500 N/s, 0.001 N a count."""
NEUTRAL = 5
LEVELS = (1000, -800, 600, -400, 2000)
"""Counts that the constant recording gives, one for each finger."""


class Report(NamedTuple):
    """Output report 1 of glove5."""

    id: int
    counter: int
    counts: tuple[int, ...]

    @classmethod
    def of(cls, data: bytes) -> Report:
        number, counter, *counts = struct.unpack("<BB5h", data)
        return cls(number, counter, tuple(counts))


def recording(
    path: Path, counts: Sequence[Sequence[int]], *, unit: str = "N", labels: Sequence[str] = FINGERS,
    rate: int = 1000, scale: Fraction = Fraction(2, 1000), cluster: Fraction | None = None,
) -> Path:  # fmt: skip
    """Channels whose samples arrive as these counts: twice as much is recorded, since the gain is 0.5."""
    held = Calibration(scale.numerator, 0, scale.denominator)
    channels = tuple(
        Channel(np.array(each, np.int64), Fraction(rate), calibration=held, label=label, unit=unit)
        for each, label in zip(counts, labels, strict=True)
    )
    write(Recording(channels), path, Settings("lossless", cluster=cluster), force=True)
    return path


def constant(path: Path, seconds: int = 60) -> Path:
    return recording(path, [[level] * (1000 * seconds) for level in LEVELS])


def replay(
    w: World, file: Path, *options: object, profile: object = "glove5", **others: Any
) -> Running:
    words = [sys.executable, "-W", "error", "-m", "hapfmt", "replay", file, "--device", profile]
    return w.start([*words, "--json", *options], cwd=ROOT, **others)


def together(w: World, file: Path, profile: object) -> list[Running]:
    """A replay on each device of a world, at once."""
    return [replay(w, file, "--path", each.path, profile=profile) for each in w.devices]


def told(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """What the replay said of itself."""
    assert "Traceback" not in done.stderr, done.stderr
    try:
        report: dict[str, Any] = json.loads(done.stdout)
    except ValueError:
        raise AssertionError(f"{done.returncode}: {done.stdout!r}\n{done.stderr}") from None
    assert report["exit_code"] == done.returncode
    return report


def clean(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """What a replay said that ended as it should."""
    report = told(done)
    assert (report["outcome"], report["exit_code"], report["lost"]) == ("clean", 0, []), report
    assert report["watchdog"] == "stood by"
    return report


def check_sent(report: dict[str, Any], frames: int) -> None:
    """Of so many frames those that were not sent were skipped; a ramp goes by samples that are
    sent, so it takes longer where some are left out."""
    assert frames <= report["sent"] + report["skipped"] <= frames + report["skipped"], report


def shape(phase: int, length: int = RAMP) -> float:
    """The raised cosine."""
    return (1 - cos(pi * phase / length)) / 2


def count(wanted: float) -> int:
    """Whole counts, rounded as players.md says."""
    return floor(wanted + 0.5)


def rise(levels: Sequence[int] = LEVELS) -> list[tuple[int, ...]]:
    return [tuple(count(x * shape(p)) for x in levels) for p in range(1, RAMP + 1)]


def fall(levels: Sequence[int] = LEVELS, phase: int = RAMP) -> list[tuple[int, ...]]:
    """From what was sent at ``phase`` to rest."""
    top = shape(phase)
    return [tuple(count(x * (shape(p) / top)) for x in levels) for p in range(phase - 1, -1, -1)]


def rested(levels: Sequence[int] = LEVELS) -> list[tuple[int, ...]]:
    """The last that a device sees: the ramp and the neutral frames."""
    return [*fall(levels), *[(0,) * len(levels)] * NEUTRAL]


def counts_of(events: Sequence[Event]) -> list[tuple[int, ...]]:
    return [Report.of(x.data).counts for x in events]


def check_steps(counts: Sequence[Sequence[int]]) -> None:
    """PLY-002, from rest on."""
    before: Sequence[int] = (0,) * len(counts[0])
    for now in counts:
        assert all(-5000 <= x <= 5000 for x in now), now
        assert all(abs(a - b) <= CHANGE for a, b in zip(before, now, strict=True)), (before, now)
        before = now


def check_counters(reports: Sequence[Report]) -> None:
    """None is missing, none twice, none out of order."""
    assert {x.id for x in reports} <= {1}
    assert [x.counter for x in reports] == [n & 0xFF for n in range(len(reports))]


def check_constant(events: Sequence[Event]) -> None:
    """One writer's replay of the constant recording: up, steady, down, neutral; nothing else."""
    reports = [Report.of(x.data) for x in events]
    check_counters(reports)
    counts = [x.counts for x in reports]
    check_steps(counts)
    assert counts[:RAMP] == rise()
    assert set(counts[RAMP : -len(rested())]) <= {LEVELS}
    assert counts[-len(rested()) :] == rested()


def steady(frames: int) -> Callable[[list[Event]], bool]:
    """So many frames have come, so that the ramp is long over."""
    return lambda events: sum(x.taken for x in events) >= frames


def crc_right(data: bytes) -> bool:
    """Sony's: CRC-32 over 0xA2 and all before it."""
    return zlib.crc32(b"\xa2" + data[:-4]) == int.from_bytes(data[-4:], "little")


def gaps_ms(events: Sequence[Event]) -> list[float]:
    return [(b.time_ns - a.time_ns) / 1e6 for a, b in pairwise(events)]


def patient(folder: Path, hold_ms: int = 1000, name: str = "glove5") -> Path:
    """A profile that may be later: where lateness is not what is tried, a busy machine is no fault."""
    lines = (PROFILES / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    lines = [line for line in lines if not line.startswith("hold_ms")]
    lines.insert(lines.index("[timing]") + 1, f"hold_ms = {hold_ms}")
    path = folder / f"patient-{name}-{hold_ms}.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def is_neutral(event: Event) -> bool:
    return not any(Report.of(event.data).counts)


def without_repeats(counts: Sequence[tuple[int, ...]]) -> list[tuple[int, ...]]:
    return [now for now, _ in groupby(counts)]


def pid_of(w: World, name: str) -> int:
    """Of the process of a replay that has this module, once it has opened the device."""

    def opened(events: list[Event]) -> list[int]:
        return [x.pid for x in events if x.op == "open" and x.program.endswith(f"process.{name}")]

    return opened(w.device.wait_for(opened))[0]


def alone(w: World, seconds: float = 60.0) -> bool:
    """Nothing of a replay is left running."""
    end = time.monotonic() + seconds
    # Of what words name, not of where they lie: a clone may be called like this too.
    while any(word.split(".")[0] == "hapfmt" for x in w.processes() for word in x["words"]):
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True
