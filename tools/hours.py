"""Ten simulated hours through the recorder: speed, memory hour by hour, and the file afterwards.

python tools/hours.py [--hours 10] [--preset lossless] [--fast]

A glove of 22 channels at 1 kHz and 4 accelerations at 8 kHz, in chunks of 100 ms, as fast as the
recorder takes them; fsync once a second, as at the pace of the clock. Two minutes of samples are
made beforehand and played forwards and backwards: packets do not depend on each other, so that
repeats are as hard to code.
"""

from __future__ import annotations

import tempfile
import time
from fractions import Fraction
from pathlib import Path

import installed  # noqa: F401

import click
import numpy as np
from measured import print_origin, print_table
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from scaling import MIB, resident
from scipy.signal import lfilter
from simulated import STEP, glove

import hapfmt

BLOCK_S = 120
CHUNK_S = Fraction(1, 10)
SLOW, FAST = Fraction(1000), Fraction(8000)
ACCELERATION = hapfmt.Calibration(1, 0, 2048)
"""16 bits over 16 g."""


def vibrations(channels: int = 4) -> NDArray[np.int16]:
    """[ticks, channels]: noise around a resonance of 250 Hz, 11 bits or so."""
    rng = np.random.Generator(np.random.PCG64(5))
    noise = rng.normal(0, 40, (int(BLOCK_S * FAST), channels))
    radius, angle = 0.97, 2 * np.pi * 250 / float(FAST)
    shaped = lfilter([1.0], [1.0, -2 * radius * np.cos(angle), radius**2], noise, axis=0)
    return np.clip(np.floor(shaped + 0.5), -32768, 32767).astype(np.int16)


def there_and_back(block: NDArray[np.int16]) -> NDArray[np.int16]:
    return np.concatenate([block, block[::-1]])


def timed(work: object) -> float:
    """Shortest wall time of five, in milliseconds."""
    times = []
    for _ in range(5):
        began = time.perf_counter()
        work()  # type: ignore[operator]
        times.append(time.perf_counter() - began)
    return 1000 * min(times)


@click.command(help=__doc__)
@click.option("--hours", default=10.0)
@click.option("--preset", default="lossless")
@click.option("--fast", is_flag=True)
def main(hours: float, preset: str, fast: bool) -> None:
    joints = there_and_back(np.column_stack([c.stored for c in glove(BLOCK_S).channels]))
    shakes = there_and_back(vibrations())
    inputs = [hapfmt.Input(f"joint {n}", SLOW, "deg", calibration=STEP) for n in range(22)]
    inputs += [
        hapfmt.Input(f"vibration {n}", FAST, "[g]", calibration=ACCELERATION) for n in range(4)
    ]
    groups = [(joints, range(22), SLOW), (shakes, range(22, 26), FAST)]
    settings = hapfmt.Settings.of(preset, fast=fast or None)
    chunks = round(hours * 3600 / float(CHUNK_S))
    memory = [resident()]
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "hours.hapf")
        bar = Progress(console=Console(stderr=True), transient=True)
        with bar, hapfmt.Recorder(path, inputs, settings, fsync=1.0) as recorder:
            task = bar.add_task("recording", total=chunks)
            began, cpu = time.perf_counter(), time.process_time()
            for chunk in range(chunks):
                for block, places, rate in groups:
                    size = int(CHUNK_S * rate)
                    at = chunk * size % len(block)
                    recorder.write_rows(block[at : at + size], channels=places)
                if chunk % 36_000 == 35_999:
                    memory.append(resident())
                bar.update(task, completed=chunk + 1)
            recorder.flush()
            wall, cpu = time.perf_counter() - began, time.process_time() - cpu
        status = recorder.status()
        middle = Fraction(hours) * 1800

        def open_file() -> None:
            with hapfmt.Reader(path) as reader:
                assert len(reader.channels) == 26

        def read_second() -> None:
            found = hapfmt.read(path, ["joint 7"], start=middle, stop=middle + 1)
            assert found.channels[0].stored.size == 1000

        print_origin()
        seconds = hours * 3600
        print_table(
            ["measure", "value"],
            [
                ["preset", preset + " --fast" * fast],
                ["hours, samples", f"{hours:g}, {status.written / 1e6:.0f} M"],
                ["real-time factor (wall)", f"{seconds / wall:.0f}"],
                ["real-time factor (CPU, all threads)", f"{seconds / cpu:.0f}"],
                ["real-time factor (CPU, recorder's thread)", f"{seconds / status.busy_s:.0f}"],
                ["caller blocked, s", f"{status.blocked_s:.1f}"],
                ["file, MB", f"{status.file_size / 1e6:.1f}"],
                ["bits a sample", f"{8 * status.file_size / status.written:.3f}"],
                ["clusters", status.cluster_count],
                ["open, ms", f"{timed(open_file):.1f}"],
                ["open and read 1 s of one channel in the middle, ms", f"{timed(read_second):.1f}"],
            ],
        )
    print("memory of the process in MiB, at the start and after each hour:")
    print(", ".join(f"{size / MIB:.0f}" for size in memory))


if __name__ == "__main__":
    main()
