"""How late frames are: a plain sleep loop, and hapfmt's player, on this machine, under a load.

python tools/replay_timing.py [--seconds 60] [--load N] [--ways sleep,loopback,hid] [--kills 20]
                              [--hour] [--json FILE]

Frames of 5 and of 22 actuators at 1 kHz (glove5, glove22), and PCM of two at 3 kHz, 32 samples in a
frame (dualsense-bluetooth-haptics). The sleep loop is what one writes without thinking: sleep until
the frame is due, in an ordinary process; its reports are made beforehand and go to /dev/null. The
player reads a file, renders, and its writer sends: into a file (loopback), or through hidapi into a
virtual HID device (hid, Linux). A frame that was skipped counts with the time until the one in its
place. `late` is what the sender found when it began to send; `seen` is when frames came out at the
other end, those of the earliest being the measure: what came to that and had not been late. --load
keeps N processes of ordinary priority busy meanwhile. --kills: SIGKILL for the writer, and how long
after it the watchdog's first neutral frame came out. --hour: an hour of 22 channels, from the start
of `hapfmt replay` to its first frame, and the memory of its processes. Each way has a row for each
device: where a run sent nothing or failed, the row says what happened.
"""

from __future__ import annotations

import json
import os
import platform
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import installed  # noqa: F401

import click
import numpy as np
from measured import origin, print_table
from numpy.typing import ArrayLike
from replay_cases import CASES, Case, make_file, make_hours
from replay_ends import ENVIRONMENT, End, opened, wait_for
from watched import Watched

PERCENTILES = (50, 99, 99.9)
BUSY = "x = 1\nwhile True: x = x * 3 % 1000003"
AFTER_S = 30.0
"""A run may take this much longer than its file."""
MIB = 1 << 20


@dataclass
class Row:
    """One way of sending to one device. Lists: p50, p99, p99.9 and max, in microseconds."""

    way: str
    device: str
    load: int
    seconds: float
    outcome: str
    frames: int
    skipped: int
    late: list[float]
    seen: list[float] | None = None
    call: list[float] | None = None
    """How long the device took each frame."""
    cpu_us: float | None = None
    """CPU time of the sender for a frame."""
    load_average: float = 0.0
    realtime: str = ""
    watchdog: str = ""
    reason: str = ""
    """Why the run did not end as it should."""


def percentiles(times: ArrayLike) -> list[float]:
    """Percentiles of the times; each is the time of a frame, the later one between two."""
    found = np.asarray(times, float)
    return [*np.percentile(found, PERCENTILES, method="higher").tolist(), float(found.max())]


@contextmanager
def busy(count: int) -> Iterator[None]:
    running = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        time.sleep(1.0 if running else 0.0)
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


# -- a loop that sleeps


def sleep_loop(case: Case, seconds: float) -> dict[str, Any]:
    reports = [bytes([1, k & 255]) + bytes(case.report_size - 2) for k in range(256)]
    late: list[float] = []
    k = sent = 0
    period, frames = case.period_s, round(seconds / case.period_s)
    cpu = time.process_time()
    with Path(os.devnull).open("wb", buffering=0) as device:
        began = time.monotonic()
        while k < frames:
            wait = began + k * period - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            now = time.monotonic() - began
            due = max(int(now / period), k)
            late += [1e6 * (now - each * period) for each in range(k, due + 1)]
            device.write(reports[due & 255])
            k, sent = due + 1, sent + 1
    cpu = time.process_time() - cpu
    return {"frames": sent, "skipped": len(late) - sent, "late": percentiles(late),
            "cpu_us": 1e6 * cpu / sent}  # fmt: skip


def sleeps(case: Case, seconds: float) -> dict[str, Any]:
    """In a process of its own."""
    words = [sys.executable, __file__, "--child", "sleep", case.profile, str(seconds)]
    done = subprocess.run(words, check=True, capture_output=True, text=True, env=ENVIRONMENT)
    return {"outcome": "clean", **json.loads(done.stdout)}


# -- the player


def play_file(file: str, profile_name: str, sink: str) -> None:
    """As `hapfmt replay` does, into any sink, at full gain."""
    from hapfmt import Reader
    from hapfmt.replay.process.player import play
    from hapfmt.replay.profile.parse import load_profile
    from hapfmt.replay.render import Renderer, assign

    profile = load_profile(profile_name)
    with Reader(file) as reader:
        renderer = Renderer(reader, profile, assign(reader, profile, by_order=True))
        report = play(renderer, profile, json.loads(sink), gain=1.0)
    print(json.dumps(report.to_json()))


def watch(stop_after: str, *words: str) -> None:
    """Runs a command, watches its processes, and interrupts it (0: never)."""
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    with Watched(process.pid, ("process.writer", "process.watchdog")) as watched:
        try:
            out = process.communicate(timeout=float(stop_after) or None)[0]
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGINT)
            out = process.communicate()[0]
    found = {
        "cpu_share": watched.cpu_share("process.writer"),
        "peaks": {name.rpartition(".")[2]: watched.peak_size(name) for name in watched.looks},
    }
    print(json.dumps({"report": json.loads(out), **found}))


def player_words(case: Case, file: Path, end: End) -> list[str]:
    sink = json.dumps(end.sink())
    return [sys.executable, __file__, "--child", "play", str(file), case.profile, sink]


def plays(case: Case, seconds: float, end: End, folder: Path) -> dict[str, Any]:
    """The whole player, and what came out at the other end."""
    file = folder / f"{case.profile}.hapf"
    make_file(case, seconds, file)
    words = [sys.executable, __file__, "--child", "watch", "0", *player_words(case, file, end)]
    found = json.loads(end.start(words).output(seconds + AFTER_S))
    report = found["report"]
    share, late = found["cpu_share"], report["late"] or {}
    return {
        "outcome": report["outcome"],
        "frames": report["sent"],
        "skipped": report["skipped"],
        "late": list(late.values()),
        "call": list((report["call"] or {}).values()),
        "seen": seen(end, case, report["sent"]),
        "cpu_us": None if share is None else 1e6 * share * case.period_s,
        "realtime": "; ".join(f"{name}: {got}" for name, got in report["realtime"].items()),
        "watchdog": report["watchdog"],
        "reason": report["reason"] or "",
    }


def seen(end: End, case: Case, sent: int) -> list[float] | None:
    """How late frames came out, against the hundredth of them that came earliest; None of none."""
    period = case.period_s
    times = np.array([arrival.at_ns for arrival in end.arrivals()[:sent]], float) / 1e9
    if not times.size:
        return None
    times -= times[0] + np.median((times - times[0] + period / 2) % period) - period / 2
    # Half a period late at most is early for the next: what is much earlier than most is late.
    numbers = np.floor(times / period + 1 / 8)
    late = times - numbers * period
    first = np.percentile(late, 1)
    missing = [
        at - each * period
        for at, before, number in zip(times[1:], numbers, numbers[1:], strict=False)
        for each in np.arange(before + 1, number)
    ]
    return percentiles(1e6 * np.maximum(np.concatenate([late, missing]) - first, 0))


def kills(case: Case, end: End, folder: Path, count: int) -> list[float]:
    """Milliseconds from SIGKILL of the writer to the first frame of the watchdog."""
    file = folder / f"{case.profile}.hapf"
    make_file(case, 30, file)
    rng, found = random.Random(1), []
    for _ in range(count):
        running = end.start(player_words(case, file, end))
        pid = wait_for(end, 100)[-1].pid
        writer = end.writer(running)
        time.sleep(rng.uniform(0, 0.05))
        killed_ns = time.monotonic_ns()
        end.kill(writer)
        report = json.loads(running.output(AFTER_S))
        if "tripped" not in report["watchdog"]:
            raise RuntimeError(f"the watchdog did not trip: {report}")
        first = next(x for x in end.arrivals() if x.pid != pid and x.at_ns > killed_ns)
        found.append((first.at_ns - killed_ns) / 1e6)
    return found


def hour(end: End, folder: Path, seconds: float) -> dict[str, Any]:
    """An hour of 22 channels: five start-ups, and the memory after this number of seconds."""
    case, file = CASES[1], folder / "hour.hapf"
    make_hours(file, 1.0)
    firsts: list[float] = []
    for _ in range(5):
        words = player_words(case, file, end)
        began_ns = time.monotonic_ns()
        running = end.start(words)
        firsts.append((wait_for(end, 1)[0].at_ns - began_ns) / 1e6)
        end.kill(end.writer(running))
        running.output(AFTER_S)
    words = [sys.executable, __file__, "--child", "watch", str(seconds)]
    found = json.loads(
        end.start([*words, *player_words(case, file, end)]).output(seconds + AFTER_S)
    )
    return {"file_size": file.stat().st_size, "first_ms": firsts, "peaks": found["peaks"],
            "under_runs": found["report"]["under_runs"]}  # fmt: skip


def run(way: str, case: Case, seconds: float, folder: Path) -> tuple[str, dict[str, Any]]:
    """The name of a way and its measurements, or its error."""
    title = {"sleep": "sleep loop"}.get(way, way)
    try:
        if way == "sleep":
            return title, sleeps(case, seconds)
        with opened(way, case, folder) as end:
            title = end.way
            return title, plays(case, seconds, end, folder)
    except Exception as error:
        return title, {"outcome": "failed", "frames": 0, "skipped": 0, "late": [],
                       "reason": happened(error)}  # fmt: skip


def happened(error: Exception) -> str:
    """In one line; of a program that failed, the last one that it printed."""
    if isinstance(error, subprocess.CalledProcessError) and error.stderr:
        return str(error.stderr).strip().splitlines()[-1]
    said = str(error).strip().splitlines() or [""]
    return said[-1] if isinstance(error, RuntimeError) else f"{type(error).__name__}: {said[-1]}"


# -- tables


def print_rows(rows: list[Row]) -> None:
    shown = []
    for row in rows:
        cells = [row.device, row.way, row.outcome, row.frames, row.skipped]
        cells += [f"{x:.0f}" for x in row.late] or ["-"] * 4
        cells += [f"{x:.0f}" for x in row.seen[1:]] if row.seen else ["-"] * 3
        cells += [f"{row.call[n]:.0f}" if row.call else "-" for n in (1, 3)]
        cells += [f"{row.cpu_us:.0f}" if row.cpu_us else "-", f"{row.load_average:.1f}"]
        shown.append(cells)
    print_table(
        ["device", "way", "end", "frames", "skipped", "late p50", "p99", "p99.9", "max", "seen p99",
         "p99.9", "max", "call p99", "max", "CPU", "load avg"],
        shown,
    )  # fmt: skip
    for row in rows:
        if row.reason:
            print(f"{row.device}, {row.way}: {row.outcome}, {row.reason}")


def print_ends(ends: dict[str, Any]) -> None:
    """The other measurements."""
    rows: list[list[object]] = []
    for way, text in ends.get("failed", {}).items():
        rows.append([way, f"failed: {text}"])
    for way, times in ends.get("kills_ms", {}).items():
        middle, most = sorted(times)[len(times) // 2], max(times)
        rows.append([f"SIGKILL of the writer to the neutral frame, {way}, {len(times)} times",
                     f"median {middle:.1f} ms, max {most:.1f} ms"])  # fmt: skip
    for way, found in ends.get("hour", {}).items():
        firsts = sorted(found["first_ms"])
        size = f"{found['file_size'] / MIB:.0f} MiB"
        rows.append([f"an hour of 22 channels ({size}), {way}: start to first frame, {len(firsts)} "
                     "times", f"median {firsts[len(firsts) // 2]:.0f} ms, "
                     f"max {firsts[-1]:.0f} ms"])  # fmt: skip
        peaks = ", ".join(f"{name} {size / MIB:.0f}" for name, size in found["peaks"].items())
        rows.append([f"the same: most memory, MiB, {way}", peaks])
    if rows:
        print_table(["measure", "value"], rows)


def child(words: tuple[str, ...]) -> None:
    """What runs in a process of its own."""
    task, *arguments = words
    if task == "sleep":
        case = next(case for case in CASES if case.profile == arguments[0])
        print(json.dumps(sleep_loop(case, float(arguments[1]))))
    elif task == "play":
        play_file(*arguments)
    else:
        watch(*arguments)


@click.command(help=__doc__)
@click.option("--seconds", default=60.0, help="Of each run.")
@click.option("--load", default=0, help="Busy processes of ordinary priority at the same time.")
@click.option("--ways", default="sleep,loopback,hid")
@click.option("--kills", "kill_count", default=0, help="Times that the writer is killed.")
@click.option("--hour", "with_hour", is_flag=True, help="An hour-long file of 22 channels.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="All figures.")
def main(
    seconds: float, load: int, ways: str, kill_count: int, with_hour: bool, json_path: Path | None
) -> None:
    rows: list[Row] = []
    ends: dict[str, Any] = {"kills_ms": {}, "hour": {}, "failed": {}}
    with tempfile.TemporaryDirectory() as name, busy(load):
        folder = Path(name)
        for case in CASES:
            for way in ways.split(","):
                title, found = run(way, case, seconds, folder)
                row = Row(
                    title, case.title, load, seconds, load_average=os.getloadavg()[0], **found
                )
                rows.append(row)
                latest = f"{row.late[-1]:.0f} us" if row.late else row.reason
                click.echo(f"{row.device}, {row.way}: {row.outcome}, {latest}", err=True)
        for way in (way for way in ways.split(",") if way != "sleep"):
            if kill_count:
                try:
                    with opened(way, CASES[0], folder) as end:
                        ends["kills_ms"][end.way] = kills(CASES[0], end, folder, kill_count)
                except Exception as error:
                    ends["failed"][f"SIGKILL of the writer, {way}"] = happened(error)
            if with_hour:
                try:
                    with opened(way, CASES[1], folder) as end:
                        ends["hour"][end.way] = hour(end, folder, min(seconds, 60))
                except Exception as error:
                    ends["failed"][f"an hour of 22 channels, {way}"] = happened(error)
    about = (
        f"{origin()}, kernel {platform.release()} ({platform.version()}); {seconds:g} s a run, "
        f"{load} busy processes at the same time"
    )
    print(
        f"{about}\nreal-time settings: {next((r.realtime for r in rows if r.realtime), 'none')}\n"
    )
    print("Microseconds; CPU: of the sender, a frame.\n")
    print_rows(rows)
    print_ends(ends)
    if json_path:
        found_all = {"measured_on": about, "rows": [asdict(row) for row in rows], **ends}
        json_path.write_text(json.dumps(found_all, indent=1), "utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(tuple(sys.argv[2:]))
    else:
        main()
