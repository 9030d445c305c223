"""Time and memory against length: a simulated glove of 22 channels at 1 kHz, 1, 10, 100 minutes.

python tools/scaling.py [--minutes 1,10,100] [--preset lossless] [--sensors 22]

Each step runs in a process of its own. Time is CPU time for each minute of recording: flat where
the work is linear. Memory is the peak while the step runs, beyond what the process holds when it
begins (for encode, the recording) and, for read, beyond the arrays that it returns.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

from installed import environment

import click
from measured import print_origin, print_table
from rich.console import Console
from rich.progress import Progress
from simulated import SENSORS, glove

import hapfmt
from hapfmt.format.source import open_source
from hapfmt.reading.dump import measure

STEPS = ("encode", "read", "pieces", "verify", "du", "info")
MIB = 1 << 20


def resident() -> int:
    """Bytes this process holds now."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return peak()


def peak() -> int:
    """Bytes this process has held at most."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def work_of(step: str, path: str, preset: str, minutes: float, sensors: int) -> Callable[[], int]:
    """What a step does; it gives the bytes that its result takes."""
    if step == "encode":
        recording = glove(60 * minutes, sensors=sensors)
        settings = hapfmt.Settings.of(preset)

        def encode() -> int:
            hapfmt.write(recording, path, settings, canonical=1, force=True)
            return 0

        return encode

    def read() -> int:
        return sum(channel.stored.nbytes for channel in hapfmt.read(path).channels)

    def pieces() -> int:
        with hapfmt.Reader(path) as reader:
            tracks = list({ref.track.id: ref.track for ref in reader.channels}.values())
            assert sum(piece.numbers.size for piece in reader.pieces(tracks))
        return 0

    def verify() -> int:
        assert hapfmt.verify(path).verdict == "intact"
        return 0

    def du() -> int:
        assert measure(open_source(path)).causes
        return 0

    def info() -> int:
        with hapfmt.Reader(path) as reader:
            assert len(reader.channels) == sensors
        return 0

    return {"read": read, "pieces": pieces, "verify": verify, "du": du, "info": info}[step]


def child(step: str, path: str, preset: str, minutes: float, sensors: int) -> None:
    """One step, measured; JSON on standard output."""
    # Imports are no part of the step.
    small, stream = glove(1, sensors=1), BytesIO()
    hapfmt.write(small, stream, hapfmt.Settings.of(preset))
    hapfmt.verify(stream.getvalue(), against=small)
    work = work_of(step, path, preset, minutes, sensors)
    before, began = resident(), time.process_time()
    result = work()
    seconds = time.process_time() - began
    print(json.dumps({"seconds": seconds, "extra": max(peak() - before - result, 0)}))


@click.command(help=__doc__)
@click.option("--minutes", default="1,10,100", help="Lengths.")
@click.option("--preset", default="lossless", help="lossless, near-lossless, perceptual or paper.")
@click.option("--sensors", default=SENSORS, help="Channels.")
@click.option("--step", help="One step only, in this process, for --file.", hidden=True)
@click.option("--file", "path", default="", hidden=True)
def main(minutes: str, preset: str, sensors: int, step: str | None, path: str) -> None:
    if step:
        child(step, path, preset, float(minutes), sensors)
        return
    lengths = minutes.split(",")
    rows = []
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(console=Console(stderr=True), transient=True) as bar,
    ):
        task = bar.add_task("scaling", total=len(lengths) * len(STEPS))
        for length in lengths:
            path = str(Path(folder) / "glove.hapf")
            row: list[object] = [length, f"{sensors * 60 * float(length) / 1000:.1f}"]
            for each in STEPS:
                bar.update(task, description=f"{length} min, {each}")
                arguments = ["--minutes", length, "--preset", preset, "--sensors", str(sensors),
                             "--step", each, "--file", path]  # fmt: skip
                done = subprocess.run(
                    [sys.executable, __file__, *arguments], check=True, capture_output=True,
                    text=True, env=environment(),
                )  # fmt: skip
                found = json.loads(done.stdout)
                row.append(f"{found['seconds'] / float(length):.3f} s, {found['extra'] / MIB:.0f}")
                bar.advance(task)
            row.insert(2, f"{Path(path).stat().st_size / 1e6:.2f}")
            rows.append(row)
    print_origin()
    print(f"preset {preset}: CPU seconds for each minute of recording, then peak MiB\n")
    print_table(["minutes", "M samples", "file MB", *STEPS], rows)


if __name__ == "__main__":
    main()
