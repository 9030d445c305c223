"""Time and memory against length and channels: a simulated glove at 1 kHz, 1 s to 100 minutes of
22 channels, and 10 s of 1 to 2048 channels.

python tools/scaling.py [--minutes 1,10,100] [--sensors 8,512] [--preset lossless] [--picture FILE]

Each step runs in a process of its own. Time is CPU time for each million samples: flat where the
work is linear. Memory is the peak while the step runs, beyond what the process holds when it
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
from fractions import Fraction
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
DRAWN = ("encode", "read", "verify")
MIB = 1 << 20

Lines = dict[str, dict[str, list[tuple[float, float]]]]
"""By title and step: million samples and CPU seconds."""

BRIEF_S, TIMES = 0.2, 5
"""Steps that take less are repeated."""


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
    before, result = resident(), 0
    times: list[float] = []
    while len(times) < TIMES and sum(times) < BRIEF_S:
        began = time.process_time()
        result = work()
        times.append(time.process_time() - began)
    seconds = min(times)
    print(json.dumps({"seconds": seconds, "extra": max(peak() - before - result, 0)}))


def measured(step: str, path: str, preset: str, minutes: float, sensors: int) -> dict[str, float]:
    """A step in a process of its own."""
    arguments = ["--minutes", repr(minutes), "--preset", preset, "--sensors", str(sensors),
                 "--step", step, "--file", path]  # fmt: skip
    done = subprocess.run(
        [sys.executable, __file__, *arguments], check=True, capture_output=True, text=True,
        env=environment(),
    )  # fmt: skip
    found: dict[str, float] = json.loads(done.stdout)
    return found


def draw(path: str, lines: Lines) -> None:
    """CPU seconds against samples, a panel for each of the ways to grow; gray: in proportion."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(lines), sharey=True, squeeze=False)[0]
    for axes, (title, steps) in zip(panels, lines.items(), strict=True):
        for step, points in steps.items():
            x, y = zip(*points, strict=True)
            axes.plot(x, [y[-1] * each / x[-1] for each in x], color="0.8", linewidth=1)
            axes.plot(x, y, marker="o", label=step)
        axes.set(xscale="log", yscale="log", title=title, xlabel="million samples")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("CPU seconds")
    panels[0].legend()
    figure.savefig(path, dpi=100)


@click.command(help=__doc__)
@click.option("--minutes", default="1/60,1/6,1,10,100", help="Lengths, of 22 channels.")
@click.option("--sensors", default="1,8,64,512,2048", help="Numbers of channels, of 10 s.")
@click.option("--preset", default="lossless", help="lossless, near-lossless, perceptual or paper.")
@click.option("--picture", default="", help="Draw the times into this file.")
@click.option("--step", help="One step only, in this process, for --file.", hidden=True)
@click.option("--file", "path", default="", hidden=True)
def main(
    minutes: str, sensors: str, preset: str, picture: str, step: str | None, path: str
) -> None:
    if step:
        child(step, path, preset, float(minutes), int(sensors))
        return
    lengths = [(float(Fraction(each)), SENSORS) for each in minutes.split(",") if each]
    widths = [(1 / 6, int(each)) for each in sensors.split(",") if each]
    ways = {"22 channels, longer and longer": lengths, "10 s, more and more channels": widths}
    ways = {title: sizes for title, sizes in ways.items() if sizes}
    rows: list[list[object]] = []
    lines: Lines = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(console=Console(stderr=True), transient=True) as bar,
    ):
        task = bar.add_task("scaling", total=sum(map(len, ways.values())) * len(STEPS))
        for title, sizes in ways.items():
            steps = lines.setdefault(title, {each: [] for each in DRAWN})
            for length, count in sizes:
                path = str(Path(folder) / "glove.hapf")
                samples = count * 60 * length / 1000
                row: list[object] = [f"{60 * length:g}", count, f"{samples:.2f}"]
                for each in STEPS:
                    bar.update(task, description=f"{60 * length:g} s x {count}, {each}")
                    found = measured(each, path, preset, length, count)
                    if each in steps:
                        steps[each].append((samples, found["seconds"]))
                    mib = found["extra"] / MIB
                    row.append(f"{1000 * found['seconds'] / samples:.1f} ms, {mib:.0f}")
                    bar.advance(task)
                row.insert(3, f"{Path(path).stat().st_size / 1e6:.2f}")
                rows.append(row)
    print_origin()
    print(f"preset {preset}: CPU time for each million samples, then peak MiB\n")
    print_table(["seconds", "channels", "M samples", "file MB", *STEPS], rows)
    if picture:
        draw(picture, lines)


if __name__ == "__main__":
    main()
