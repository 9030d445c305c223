"""One hour of 28 channels at 100, 1000 and 8000 Hz: what opening it and reading a second cost.

    .venv/bin/python tools/lazy.py [--seconds 3600] [--folder FOLDER]

The file is made once, in FOLDER or a temporary one: 54.7 million samples in an hour. Times are CPU
times of this process, medians of many runs, after one that imports. By URL, a server of this
machine counts requests and bytes.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import installed

import numpy as np

import hapfmt

RATES = {8000: 1, 1000: 5, 100: 22}


def make(path: Path, seconds: int) -> None:
    """Integers that wander, as a sensor with a slow signal and a noise of a few counts gives."""
    draw = np.random.default_rng(17)
    signals, rates = {}, {}
    for rate, count in RATES.items():
        for number in range(count):
            label = f"c{rate}_{number}"
            t = np.arange(rate * seconds)
            slow = 2000 * np.sin(t * (0.3 + 0.1 * number) / rate)
            signals[label] = (slow + draw.normal(0, 2, t.size)).astype(np.int16)
            rates[label] = rate
    hapfmt.write(signals, path, rate=rates, units="mN", fast=True)


def cpu_ms(run: Callable[[], object], times: int) -> float:
    run()
    found = []
    for _ in range(times):
        before = time.process_time()
        run()
        found.append(1000 * (time.process_time() - before))
    return statistics.median(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seconds", type=int, default=3600)
    parser.add_argument("--folder", type=Path, help="keep the file here for the next run")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        measure(given.folder or Path(temporary), given.seconds)


def measure(folder: Path, seconds: int) -> None:
    import xarray

    sys.path.append(str(installed.ROOT / "tests"))
    from server import serving

    path = folder / f"{seconds}.hapf"
    if not path.exists():
        make(path, seconds)
    size = path.stat().st_size
    samples = seconds * sum(rate * count for rate, count in RATES.items())
    print(f"{samples / 1e6:.1f} M samples, {size / 1e6:.1f} MB")

    def opened() -> None:
        xarray.open_dataset(path).close()

    print(f"open_dataset            {cpu_ms(opened, 30):7.1f} ms   at most 20")
    with xarray.open_dataset(path) as data:
        starts = iter(np.random.default_rng(1).uniform(0, seconds - 2, 1000).round(2))

        def second(rate: int) -> object:
            start = next(starts)
            return data[f"c{rate}_0"].sel({f"time_{rate}Hz": slice(start, start + 1)}).values

        for rate in RATES:
            ms = cpu_ms(partial(second, rate), 50)
            print(f"a second at {rate:4} Hz     {ms:7.1f} ms   at most 3")

        def ten() -> object:
            start = float(np.random.default_rng(2).uniform(0, seconds - 12))
            names = [f"c1000_{k}" for k in range(5)]
            return data[names].sel(time_1000Hz=slice(start, start + 10)).load()

        print(f"5 channels x 10 s       {cpu_ms(ten, 10):7.1f} ms")
        print(f"one channel at 1000 Hz  {cpu_ms(lambda: data['c1000_0'][:].values, 3):7.0f} ms")
        print(f"one channel at 8000 Hz  {cpu_ms(lambda: data['c8000_0'][:].values, 3):7.0f} ms")
    with serving({"hour.hapf": path.read_bytes()}) as server:
        for rate in RATES:
            server.asked.clear()
            server.heads = 0
            with xarray.open_dataset(server.url("hour.hapf")) as data:
                count, sent = len(server.asked) + server.heads, server.sent
                data[f"c{rate}_0"].sel(
                    {f"time_{rate}Hz": slice(seconds // 2, seconds // 2 + 1)}
                ).load()
            print(
                f"by URL, {rate:4} Hz: opened in {count} requests and {sent / 1e3:.0f} kB, with a "
                f"second in {len(server.asked) + server.heads} requests and "
                f"{server.sent / 1e3:.0f} kB   at most 3 and 200"
            )


if __name__ == "__main__":
    main()
