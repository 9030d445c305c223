"""Sustained load: how many channels at 1 kHz one core records in real time, with none dropped.

python tools/load.py [--seconds 300] [--preset lossless] [--fast] [--channels N]

Counts of a simulated glove, each channel from a moment of its own, come every 10 ms as rows of all
channels, at the pace of the clock; the queue may not fill up. One process, pinned to one core,
hands them over, encodes, and writes to the disk, fsync after each cluster of 1 s. The number is
doubled, then narrowed in short runs, then held for the whole time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

from installed import environment

import click
import numpy as np
from measured import print_origin, print_table
from numpy.typing import NDArray
from simulated import SENSORS, STEP, glove

import hapfmt

RATE = 1000
CHUNK = 10
"""Ticks that come at once: 10 ms."""

BLOCK_S = 2
"""Seconds of samples that are made beforehand, and played forwards and backwards."""

PROBE_S = 10.0
"""Seconds of a short run."""

LATE_S = 1.0
"""Behind the clock by more than this is not keeping up."""

NARROW = 1.1
"""The search ends where the numbers that pass and fail are this close."""


def samples(channels: int) -> NDArray[np.int16]:
    """[ticks, channels]"""
    ticks = BLOCK_S * RATE
    joints = [c.stored for c in glove(20 + BLOCK_S).channels]
    block = np.empty((ticks, channels), np.int16)
    for channel in range(channels):
        at = (channel // SENSORS * 37) % (20 * RATE)
        block[:, channel] = joints[channel % SENSORS][at : at + ticks]
    return np.concatenate([block, block[::-1]])


LIVE: dict[str, dict[str, object]] = {
    "lossless": {},
    "near-lossless": {"max_error": "2lsb"},
    "perceptual": {"texture": False, "felt": "all", "floor": "2lsb"},
}
"""What is known of samples that are still to come: no texture, which needs the whole recording, and
no bound in % of their range."""


def settings_of(preset: str, fast: bool) -> hapfmt.Settings:
    return hapfmt.Settings.of(preset, fast=fast or None, **LIVE[preset])


def record(path: str, channels: int, seconds: float, preset: str, fast: bool) -> dict[str, float]:
    """One run, paced by the clock."""
    block = samples(channels)
    inputs = [
        hapfmt.Input(f"{n}", Fraction(RATE), "deg", calibration=STEP) for n in range(channels)
    ]
    settings = settings_of(preset, fast)
    late = queued = 0.0
    with hapfmt.Recorder(path, inputs, settings, on_full="drop", force=True) as recorder:
        began, cpu = time.monotonic(), time.process_time()
        for tick in range(0, round(seconds * RATE), CHUNK):
            due = began + (tick + CHUNK) / RATE
            wait = due - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            at = tick % len(block)
            recorder.write_rows(block[at : at + CHUNK])
            late = max(late, time.monotonic() - due)
            if tick % RATE == 0:
                queued = max(queued, recorder.status().queued_size)
        wall, cpu = time.monotonic() - began, time.process_time() - cpu
        left = recorder.status().queued_size
    status = recorder.status()
    return {
        "channels": channels,
        "seconds": seconds,
        "dropped": status.dropped_count,
        "late": late,
        "queued": queued,
        "left": left,
        "load": cpu / wall,
        "bits": 8 * status.file_size / max(status.written, 1),
    }


def run(channels: int, seconds: float, preset: str, fast: bool) -> dict[str, float]:
    """In a process of its own, on one core."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = {"channels": channels, "seconds": seconds, "preset": preset}
        command = [sys.executable, __file__, "--child", "--file", str(Path(folder) / "a.hapf")]
        command += [part for name, value in arguments.items() for part in (f"--{name}", str(value))]
        done = subprocess.run(
            command + ["--fast"] * fast,
            check=True,
            capture_output=True,
            text=True,
            env=environment(),
        )
    found: dict[str, float] = json.loads(done.stdout)
    kept = "kept up" if keeps_up(found) else "did not"
    click.echo(f"{channels} channels for {seconds:g} s: {kept}, load {found['load']:.2f}", err=True)
    return found


def keeps_up(found: dict[str, float]) -> bool:
    return found["dropped"] == 0 and found["late"] < LATE_S


@click.command(help=__doc__)
@click.option("--seconds", default=300.0, help="Of the long run.")
@click.option(
    "--preset",
    default="lossless",
    type=click.Choice([*LIVE]),
    help="near-lossless and perceptual with a bound of two steps.",
)
@click.option("--fast", is_flag=True, help="Preset lossless: less search.")
@click.option("--channels", default=0, help="So many and no search.")
@click.option("--child", is_flag=True, hidden=True)
@click.option("--file", "path", default="", hidden=True)
def main(seconds: float, preset: str, fast: bool, channels: int, child: bool, path: str) -> None:
    if child:
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
        print(json.dumps(record(path, channels, seconds, preset, fast)))
        return
    try:
        settings_of(preset, fast)
    except hapfmt.HapfmtError as error:
        raise click.UsageError(str(error)) from None
    probe = min(PROBE_S, seconds)
    good, bad = channels, 0
    if not channels:
        good, trial = 0, 256
        while not bad or bad / max(good, 1) > NARROW:
            if keeps_up(run(trial, probe, preset, fast)):
                good = trial
            else:
                bad = trial
            trial = 2 * good if not bad else (good + bad) // 2
    found = run(good, seconds, preset, fast)
    while not keeps_up(found) and not channels:
        good = round(good / NARROW)
        found = run(good, seconds, preset, fast)
    print_origin()
    print(f"preset {preset}{' --fast' * fast}, 1 core, {RATE} Hz, {CHUNK} ms at once\n")
    print_table(
        ["channels", "seconds", "dropped", "late s", "queue MiB", "CPU share", "bits/sample"],
        [
            [
                int(found["channels"]),
                f"{found['seconds']:g}",
                int(found["dropped"]),
                f"{found['late']:.3f}",
                f"{found['queued'] / 2**20:.1f}",
                f"{found['load']:.2f}",
                f"{found['bits']:.3f}",
            ]
        ],
    )


if __name__ == "__main__":
    main()
