"""How fast an archive is checked: `hapfmt archive verify`, `flac -t` and `sha256sum`.

    .venv/bin/python tools/archives.py [--files 1000] [--megabytes 5000] [--jobs 1,2] [--spectra M]

Makes FILES recordings of simulated scenes, MEGABYTES of float64 in all, as .hapf and as FLAC. Three
.hapf files are damaged: one bit, the end, and a hole of 512 bytes. All programs run in the same run
on files that were read before, so the disk does not count. The tool ends with exit code 1 unless
exactly the three files are reported.

20 of the recordings are different; the others are copies of them in files of their own. FLAC has
at most 8 channels a file, so a recording takes several. Without the program flac, its library
decodes them (soundfile).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import installed

import numpy as np
from measured import print_origin, print_table, write_rows

import hapfmt
from hapfmt.lab.scenes import load_scene, simulate

DISTINCT = 20
SCENES = ("grasp", "everything")
FLAC_CHANNELS = 8
HOLE = 512
TERABYTE = 1e12
NETWORK = 125e6
"""Bytes a second of 1 Gbit/s."""


class Made(NamedTuple):
    folder: Path
    samples: int
    damaged: list[str]


class Timing(NamedTuple):
    name: str
    jobs: int
    wall: float
    cpu: float
    size: int


def recording(number: int, seconds: float) -> hapfmt.Recording:
    scene = load_scene(SCENES[number % len(SCENES)])
    return simulate(scene.changed(seconds=seconds, seed=number))[0]


def write_flac(one: hapfmt.Recording, folder: Path) -> None:
    import soundfile

    chosen = [channel for channel in one.channels if channel.is_counts]
    chosen.sort(key=lambda channel: channel.rate_exact)
    for rate, own in groupby(chosen, key=lambda channel: channel.rate_exact):
        channels = list(own)
        for first in range(0, len(channels), FLAC_CHANNELS):
            part = channels[first : first + FLAC_CHANNELS]
            shortest = min(channel.stored.size for channel in part)
            block = np.column_stack([channel.counts[:shortest] for channel in part])
            low, high = int(block.min(initial=0)), int(block.max(initial=0))
            narrow = low >= -(1 << 15) and high < 1 << 15
            data = block.astype(np.int16) if narrow else (block.astype(np.int64) << 8).astype("i4")
            soundfile.write(
                folder / f"{int(rate)}-{first}.flac", data, max(int(rate), 1),
                "PCM_16" if narrow else "PCM_24", format="FLAC",
            )  # fmt: skip


def make(folder: Path, files: int, megabytes: float) -> Made:
    """The archive, and its FLAC twin."""
    hapf, flac = folder / "hapf", folder / "flac"
    known = folder / "made.json"
    wanted = {"files": files, "megabytes": megabytes}
    if known.exists():
        found = json.loads(known.read_text("utf-8"))
        if found["wanted"] == wanted:
            return Made(folder, found["samples"], found["damaged"])
    for old in (hapf, flac):
        shutil.rmtree(old, ignore_errors=True)
    size = 1e6 * megabytes / 8 / files
    samples = 0
    count = min(DISTINCT, files)
    for number in range(count):
        rate = recording(number, 0.1).sample_count / 0.1
        one = recording(number, max(size / rate, 0.1))
        copies = range(number, files, count)
        samples += one.sample_count * len(copies)
        first = hapf / f"session {number:04}.hapf"
        first.parent.mkdir(parents=True, exist_ok=True)
        hapfmt.write(one, first, fast=True, canonical=number + 1)
        own = flac / first.stem
        own.mkdir(parents=True)
        write_flac(one, own)
        for copy in copies[1:]:
            shutil.copyfile(first, hapf / f"session {copy:04}.hapf")
            shutil.copytree(own, flac / f"session {copy:04}")
        print(f"\r{number + 1} of {count} recordings", end="", file=sys.stderr)
    print(file=sys.stderr)
    damaged = damage(sorted(hapf.glob("*.hapf")))
    made = {"wanted": wanted, "samples": samples, "damaged": damaged}
    known.write_text(json.dumps(made), "utf-8")
    return Made(folder, samples, damaged)


def damage(paths: Sequence[Path]) -> list[str]:
    chosen = random.Random(3).sample(list(paths), 3)
    for kind, path in enumerate(chosen):
        data = bytearray(path.read_bytes())
        middle = len(data) // 2
        if kind == 0:
            data[middle] ^= 0x10
        elif kind == 1:
            del data[-1:]
        else:
            data[middle : middle + HOLE] = bytes(HOLE)
        path.write_bytes(data)
    return sorted(path.name for path in chosen)


def measured(name: str, jobs: int, size: int, work: Callable[[], object]) -> Timing:
    def cpu() -> float:
        both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(each.ru_utime + each.ru_stime for each in both)

    began, used = time.perf_counter(), cpu()
    work()
    return Timing(name, jobs, time.perf_counter() - began, cpu() - used, size)


def size_of(paths: Sequence[Path]) -> int:
    """Bytes of all files, which are in the memory of the system afterwards."""
    return sum(len(path.read_bytes()) for path in paths)


def verify(folder: Path, jobs: int) -> set[str]:
    words = [sys.executable, "-m", "hapfmt", "archive", "verify", str(folder), "--json"]
    words += ["--jobs", str(jobs)] if jobs > 1 else []
    environment = installed.environment(HAPFMT_THREADS="1")
    done = subprocess.run(words, capture_output=True, check=False, env=environment)
    if done.returncode not in (0, 3):
        sys.exit(done.stderr.decode())
    files = json.loads(done.stdout)["files"]
    return {each["file"] for each in files if each["exit_code"]}


def in_batches(program: Sequence[str], paths: Sequence[Path]) -> None:
    for first in range(0, len(paths), 500):
        names = [str(path) for path in paths[first : first + 500]]
        subprocess.run([*program, *names], check=True, stdout=subprocess.DEVNULL)


def decode_flac(paths: Sequence[Path]) -> None:
    import soundfile

    for path in paths:
        soundfile.read(path, dtype="int32")


SHOWN_WORKERS = (1, 4, 16, 64)


def print_plan(found: Sequence[Timing], made: Made, spectra: float | None, write: bool) -> None:
    """Hours per TB, from the speed of one worker in CPU time; ``spectra``: its samples a second."""
    one = next(each for each in found if each.name.startswith("hapfmt"))
    speed = one.size / one.cpu
    density = one.size / made.samples
    works = [("verify", speed)]
    if spectra:
        works.append(("spectra", spectra * density))
    hours = [
        [f"{TERABYTE / (size * workers) / 3600:.2g}" for rate in (each for _, each in works)
         for size in (rate, 8 * rate / density)]
        for workers in SHOWN_WORKERS
    ]  # fmt: skip
    if write and spectra:
        pairs = zip(SHOWN_WORKERS, hours, strict=True)
        write_rows("hours", [[workers, *row] for workers, row in pairs])
    for name, rate in works:
        print(
            f"{name}: one worker reads {rate / 1e6:.2f} MB of .hapf in a second of CPU time, "
            f"{rate / density / 1e6:.1f} M samples, {8 * rate / density / 1e6:.0f} MB of float64.\n"
        )
        print_table(
            ["workers", "hours per TB of .hapf", "hours per TB of float64", "they read, MB/s",
             "of 1 Gbit/s, %"],
            [
                [
                    workers,
                    f"{TERABYTE / (rate * workers) / 3600:.1f}",
                    f"{TERABYTE / (8 * rate / density * workers) / 3600:.2f}",
                    f"{rate * workers / 1e6:.0f}",
                    f"{100 * rate * workers / NETWORK:.0f}",
                ]
                for workers in (1, 2, 4, 8, 16, 32, 64)
            ],
        )  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--megabytes", type=float, default=5000, help="of float64, in all files")
    parser.add_argument("--jobs", default="1,2", help="numbers of processes")
    parser.add_argument("--folder", type=Path, help="keep the files here for the next run")
    parser.add_argument(
        "--spectra", type=float, metavar="M",
        help="M samples/s of one worker, as tools/spectra.py prints: adds them to the plan",
    )  # fmt: skip
    parser.add_argument("--write", action="store_true", help="put the tables into docs/planning.md")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        return measure(
            make(folder, max(given.files, 3), given.megabytes),
            [int(text) for text in given.jobs.split(",")],
            None if given.spectra is None else 1e6 * given.spectra,
            given.write,
        )


def measure(made: Made, jobs: Sequence[int], spectra: float | None, write: bool) -> int:
    hapf = sorted((made.folder / "hapf").glob("*.hapf"))
    flac = sorted((made.folder / "flac").rglob("*.flac"))
    hapf_size, flac_size = size_of(hapf), size_of(flac)
    reported: list[set[str]] = []
    found = [
        measured(
            "hapfmt archive verify", count, hapf_size,
            lambda count=count: reported.append(verify(made.folder / "hapf", count)),  # type: ignore[misc]
        )
        for count in jobs
    ]  # fmt: skip
    found.append(measured("sha256sum", 1, hapf_size, lambda: in_batches(["sha256sum"], hapf)))
    if shutil.which("flac"):
        work = lambda: in_batches(["flac", "-t", "-s"], flac)  # noqa: E731
        found.append(measured("flac -t", 1, flac_size, work))
    else:
        found.append(measured("libFLAC, decoding", 1, flac_size, lambda: decode_flac(flac)))
    print_origin()
    print(
        f"{len(hapf)} recordings, {made.samples / 1e6:.1f} M samples, "
        f"{8 * made.samples / 1e6:.0f} MB of float64, {hapf_size / 1e6:.1f} MB of .hapf, "
        f"{flac_size / 1e6:.1f} MB of FLAC; load {os.getloadavg()[0]:.1f}\n"
    )
    rows = [
        [
            f"`{each.name}`", each.jobs, f"{each.wall:.1f}", f"{each.cpu:.1f}",
            f"{each.size / each.wall / 1e6:.3g}", f"{made.samples / each.wall / 1e6:.3g}",
        ]
        for each in found
    ]  # fmt: skip
    print_table(
        ["program", "processes", "wall, s", "CPU, s", "MB/s of its files", "M samples/s"], rows
    )
    if write:
        write_rows("archives", rows)
    print_plan(found, made, spectra, write)
    right = all(each == set(made.damaged) for each in reported)
    print(
        f"{len(made.damaged)} files were damaged; "
        + ("exactly these are reported" if right else f"reported: {sorted(set().union(*reported))}")
    )
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
