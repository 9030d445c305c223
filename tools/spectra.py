"""Spectra of many files by Dask: equal to those of one process, how fast, in how much memory.

    .venv/bin/python tools/spectra.py [--files 1000] [--seconds 20] [--workers 2] [--s3]

The files hold the scene "everything": 36 channels at 1 kHz. A few recordings are simulated with
seeds of their own. Each file has the samples of one of them, shifted by some seconds. 1000 files of
20 s are 720 million samples, 5.8 GB as float64.

Each worker is a process with one thread. It opens files by xarray and computes the spectrum of
every channel by Welch's method. "killed": one worker is killed when a fifth of the files is done.
"--s3": the same from a server of S3 (moto) on this machine.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import installed  # noqa: F401

import numpy as np
from measured import print_origin, print_table, write_rows
from numpy.typing import NDArray
from scipy.signal import welch

import hapfmt
from hapfmt.archive.runs import ALLOCATOR
from hapfmt.lab.scenes import load_scene, simulate

BASES = 8
"""Recordings that are simulated."""
MIB = 1 << 20


def make(folder: Path, count: int, seconds: float) -> list[Path]:
    """Files that are there already are kept."""
    paths = [folder / f"{seconds:g}s-{number:05}.hapf" for number in range(count)]
    missing = [(number, path) for number, path in enumerate(paths) if not path.exists()]
    bases: dict[int, hapfmt.Recording] = {}
    draw = np.random.default_rng(17)
    shifts = draw.integers(0, max(int(1000 * seconds), 1), count).tolist()
    for number, path in missing:
        seed = number % BASES
        if seed not in bases:
            scene = load_scene("everything").changed(seconds=seconds, seed=seed)
            bases[seed], _ = simulate(scene)
        channels = [replace(c, stored=np.roll(c.stored, shifts[number])) for c in bases[seed]]
        hapfmt.write(replace(bases[seed], channels=tuple(channels)), path, fast=True)
    return paths


def spectra(path: str) -> NDArray[np.float64]:
    """[channels, frequencies]: the power of every channel of a file."""
    import xarray

    with xarray.open_dataset(path, engine="hapf") as data:
        rows = [welch(one.values, 1000, nperseg=1024)[1] for one in data.data_vars.values()]
    return np.stack(rows)


def peak_memory() -> int:
    """Bytes that this process had at most."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def by_dask(paths: list[str], workers: int, kill: bool = False) -> tuple[Any, float, int, int]:
    """The spectra, seconds, the largest peak of a worker, and what it had before."""
    import dask
    from dask.distributed import Client, LocalCluster, as_completed

    with (
        dask.config.set(
            {f"distributed.nanny.pre-spawn-environ.{k}": ALLOCATOR[k] for k in ALLOCATOR}
        ),
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0"
        ) as cluster,
        Client(cluster) as client,
    ):
        client.gather(client.map(spectra, paths[:workers], pure=False))  # imports
        before = max(client.run(peak_memory).values())
        start = time.perf_counter()
        futures = client.map(spectra, paths, pure=False)
        if kill:
            for done, _ in enumerate(as_completed(futures), 1):
                if done >= len(paths) // 5:
                    break
            os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
        found = client.gather(futures)
        seconds = time.perf_counter() - start
        peak = max(client.run(peak_memory).values())
    return found, seconds, peak, before


@contextmanager
def s3_of(paths: list[Path]) -> Iterator[list[str]]:
    """URLs of the files in a server of S3, a process of its own."""
    import fsspec

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    os.environ |= {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ACCESS_KEY_ID": "me",
        "AWS_SECRET_ACCESS_KEY": "me",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    words = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    server = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(300):
            with socket.socket() as asked:
                if asked.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.1)
        files = fsspec.filesystem("s3")
        files.mkdir("touch")
        files.put([str(path) for path in paths], "touch/")
        yield [f"s3://touch/{path.name}" for path in paths]
    finally:
        server.terminate()
        server.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--folder", type=Path, help="keep the files here for the next run")
    parser.add_argument("--s3", action="store_true")
    parser.add_argument("--write", action="store_true", help="put the table into docs/planning.md")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        folder.mkdir(exist_ok=True)
        measure(
            make(folder, given.files, given.seconds),
            given.seconds,
            given.workers,
            given.s3,
            given.write,
        )


def measure(files: list[Path], seconds: float, workers: int, s3: bool, write: bool) -> None:
    samples = round(36 * 1000 * seconds) * len(files)
    size = sum(path.stat().st_size for path in files)
    print_origin()
    print(
        f"{len(files)} files, {samples / 1e6:.0f} M samples, {8 * samples / 1e9:.2f} GB as "
        f"float64, {size / 1e9:.3f} GB in files\n"
    )
    paths = [str(path) for path in files]
    spectra(paths[0])
    start = time.perf_counter()
    expected = [spectra(path) for path in paths]
    base = time.perf_counter() - start
    rows: list[list[str]] = []

    def row(name: str, taken: float, peak: int) -> None:
        speeds = [f"{taken:.1f}", f"{base / taken:.2f}", f"{samples / taken / 1e6:.1f}"]
        rows.append([name, *speeds, f"{peak / MIB:.0f}"])

    def run(name: str, call: Callable[[], tuple[Any, float, int, int]]) -> None:
        found, taken, peak, _ = call()
        row(name, taken, peak)
        if not all(map(np.array_equal, found, expected)):
            sys.exit(f"{name}: the spectra are NOT EQUAL")

    row("one, without Dask", base, peak_memory())
    run("1 worker of Dask", lambda: by_dask(paths, 1))
    run(f"{workers} workers", lambda: by_dask(paths, workers))
    run(f"{workers} workers, one killed on the way", lambda: by_dask(paths, workers, kill=True))
    if s3:
        with s3_of(files) as urls:
            run(f"{workers} workers, files in S3", lambda: by_dask(urls, workers))
    print_table(["processes", "seconds", "speed-up", "M samples/s", "peak of a worker, MiB"], rows)
    if write:
        write_rows("spectra", rows)


if __name__ == "__main__":
    main()
