"""One hour of 22 channels at 1 kHz: what an overview adds to the file and to the encoding.

    .venv/bin/python tools/overview.py [--seconds 3600]

Times are CPU times of this process with one thread.
"""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path

import installed  # noqa: F401

import numpy as np
from measured import print_origin, print_table, timed

import hapfmt
from hapfmt.reading.overview import overview_of, places_of

CHANNELS, RATE = 22, 1000


def make(seconds: int) -> hapfmt.Recording:
    """Integers that wander, as a sensor with a slow signal and a noise of a few counts gives."""
    draw = np.random.default_rng(17)
    t = np.arange(RATE * seconds)
    signals = {
        f"c{number}": (
            2000 * np.sin(t * (0.3 + 0.1 * number) / RATE) + draw.normal(0, 2, t.size)
        ).astype(np.int16)
        for number in range(CHANNELS)
    }
    return hapfmt.Recording.from_array(signals, RATE, units="mN")


def measure(recording: hapfmt.Recording, folder: Path, cluster: int, *, fast: bool) -> list[str]:
    seconds = []
    for overview in (False, True):
        path = folder / f"{overview}.hapf"
        write = partial(
            hapfmt.write, recording, path, fast=fast, cluster=cluster, threads=1, force=True
        )
        seconds.append(timed(partial(write, overview=overview))[1])
    size = path.stat().st_size
    with hapfmt.Reader(path) as reader:
        seen = overview_of(reader.catalogue)
        ((start, stop),) = places_of(reader.catalogue)
    assert seen is not None
    top = seen.levels(0) - 1
    picture = [
        size - min(part.offset for part in seen.parts.values() if part.level >= level)
        for level in (top, max(top - 1, 0))
    ]
    return [
        "fast" if fast else "lossless",
        f"{cluster} s",
        f"{size / 1e6:.1f} MB",
        f"{(stop - start) / 1e3:.0f} kB, {100 * (stop - start) / size:.1f} %",
        f"{seen.base} ticks",
        " and ".join(f"{each / 1e3:.0f} kB" for each in picture),
        f"{seconds[0]:.1f} s",
        f"{seconds[1] - seconds[0]:+.1f} s",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=int, default=3600)
    parser.add_argument("--fast-only", action="store_true", help="leave out the slower encoding")
    given = parser.parse_args()
    print_origin()
    recording = make(given.seconds)
    with tempfile.TemporaryDirectory() as folder:
        rows = [
            measure(recording, Path(folder), cluster, fast=fast)
            for fast, cluster in [
                (True, 1),
                (True, 10),
                *([] if given.fast_only else [(False, 10)]),
            ]
        ]
    print_table(
        ("encoded", "clusters", "file", "overview", "smallest bin", "last bytes: 1, 2 levels",
         "encoding", "overview"),
        rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
