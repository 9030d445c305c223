"""Faults in one file: wrong samples that are delivered, how many come back, and what recover makes.

python tools/faults.py [--trials N] [--quick] [--many]      default 1000 of each kind

--quick: 50 of each kind. --many: a recorder's file too, 22 channels at 1 kHz in clusters of 1 s.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import installed  # noqa: F401

import numpy as np
from measured import print_origin, print_table

import hapfmt
from hapfmt.scenes.stylus import simulate
from hapfmt.verifier import verify

SECONDS, RATE = 60.0, 8000
CLUSTER = Fraction(1, 2)
Rng = np.random.Generator
Fault = Callable[[bytes, Rng], bytes]


def change(data: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    out[rng.integers(len(out))] ^= int(rng.integers(1, 256))
    return bytes(out)


def truncate(data: bytes, rng: Rng) -> bytes:
    return data[: rng.integers(len(data))]


def delete(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + data[at + 1 :]


def insert(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + rng.bytes(1) + data[at:]


def burst(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + rng.bytes(min(512, len(data) - at)) + data[at + 512 :]


def zero_block(data: bytes, rng: Rng) -> bytes:
    at = 4096 * int(rng.integers(len(data) // 4096))
    return data[:at] + bytes(4096) + data[at + 4096 :]


def swap_blocks(data: bytes, rng: Rng) -> bytes:
    a, b = sorted(int(x) for x in 4096 * rng.choice(len(data) // 4096, 2, replace=False))
    return (
        data[:a] + data[b : b + 4096] + data[a + 4096 : b] + data[a : a + 4096] + data[b + 4096 :]
    )


def tail(data: bytes, rng: Rng) -> bytes:
    return data + rng.bytes(int(rng.integers(1, 5000)))


FAULTS: dict[str, Fault] = {
    "one byte changed": change,
    "truncated": truncate,
    "one byte deleted": delete,
    "512 bytes overwritten": burst,
    "one byte inserted": insert,
    "4 KiB zeroed": zero_block,
    "two 4 KiB blocks swapped": swap_blocks,
    "bytes after the end": tail,
}


@dataclass(frozen=True)
class Case:
    """A file and what it holds."""

    name: str
    data: bytes
    clean: hapfmt.Recording


def built(name: str, channels: list[hapfmt.Channel], preset: str, cluster: Fraction) -> Case:
    stream = io.BytesIO()
    labelled = [
        hapfmt.Channel(c.stored, c.rate_exact, c.coverage, c.calibration, f"force {i}", c.unit)
        for i, c in enumerate(channels)
    ]
    settings = hapfmt.Settings.of(preset, cluster=cluster)
    hapfmt.write(hapfmt.Recording(tuple(labelled)), stream, settings, canonical=1)
    return Case(name, stream.getvalue(), hapfmt.read(stream.getvalue()))


@cache
def case(name: str) -> Case:
    if name == "many":
        seeds = range(22)
        channels = [simulate("cork", SECONDS, seed, 1000).channels[0] for seed in seeds]
        return built(name, channels, "lossless", Fraction(1))
    pairs = (("sand", 1), ("cork", 2))
    channels = [simulate(t, SECONDS, seed, RATE).channels[0] for t, seed in pairs]
    return built(name, channels, "perceptual", CLUSTER)


@dataclass
class Trial:
    """What became of one damaged file."""

    right: int = 0
    wrong: int = 0
    reported: bool = True
    refused: bool = False
    """By recover."""
    intact: bool = True
    """What recover wrote, or nothing was."""
    same: bool = True
    """Whether its samples are those that reading the damaged file gives."""


def attempt(clean: hapfmt.Recording, data: bytes) -> Trial:
    trial = Trial()
    back: hapfmt.Recording | None = None
    try:
        with hapfmt.Reader(data, threads=1) as reader:
            back = reader.read()
            trial.reported = bool(reader.findings)
    except hapfmt.HapfmtError:
        pass
    if back is not None:
        trial.right, trial.wrong = compare(clean, back)
    out = io.BytesIO()
    try:
        hapfmt.recover(data, out, canonical=2)
    except hapfmt.HapfmtError:
        trial.refused = True
        trial.same = back is None or not back.sample_count
        return trial
    trial.intact = verify(out.getvalue(), threads=1).verdict == "intact"
    again = hapfmt.read(out.getvalue(), threads=1)
    trial.same = back is None or equal(back, again)
    return trial


def compare(clean: hapfmt.Recording, back: hapfmt.Recording) -> tuple[int, int]:
    """Samples delivered right, and wrong."""
    right = wrong = 0
    by_label = {channel.label: channel for channel in clean.channels}
    for place, channel in enumerate(back.channels):
        original = by_label.get(channel.label, clean.channels[min(place, len(clean) - 1)])
        for start, values in channel.segments():
            truth = original.stored[start : start + values.size]
            same = int((values[: truth.size] == truth).sum())
            right += same
            wrong += values.size - same
    return right, wrong


def equal(a: hapfmt.Recording, b: hapfmt.Recording) -> bool:
    """Whether each channel has the same samples at the same ticks; lost channels have none."""
    rest = {channel.label: channel for channel in b.channels}
    for channel in a.channels:
        other = rest.pop(channel.label, None)
        if other is None or other.coverage != channel.coverage:
            return False
        if not np.array_equal(other.stored, channel.stored):
            return False
    return not any(channel.stored.size for channel in rest.values())


def run(job: tuple[str, str, int]) -> list[str]:
    """One row of the table."""
    name, kind, trials = job
    found = case(name)
    rng = np.random.default_rng(7)
    done = []
    for _ in range(trials):
        broken = FAULTS[kind](found.data, rng)
        if broken != found.data:
            done.append(attempt(found.clean, broken))
    shares = [trial.right / found.clean.sample_count for trial in done]
    silent = sum(trial.wrong for trial in done if not trial.reported)
    figures = [
        len(done),
        sum(trial.wrong for trial in done),
        silent,
        sum(not trial.reported for trial in done),
        f"{100 * np.mean(shares):.2f}",
        f"{100 * np.min(shares):.2f}",
        sum(trial.refused for trial in done),
        sum(not trial.intact for trial in done),
        sum(not trial.same for trial in done),
    ]
    return [kind, *map(str, figures)]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--many", action="store_true")
    options = parser.parse_args()
    trials = 50 if options.quick else options.trials
    print_origin()
    headers = ["fault", "trials", "wrong samples", "of them silent", "faults not reported",
               "recovered %", "worst %", "refused by recover", "not intact after recover",
               "other samples after recover"]  # fmt: skip
    for name in ["pair", "many"] if options.many else ["pair"]:
        found = case(name)
        what = "22 channels at 1000 Hz, clusters of 1 s"
        if name == "pair":
            what = f"2 channels at {RATE} Hz, clusters of {float(CLUSTER)} s"
        print(f"\n{SECONDS:.0f} s, {what}, {len(found.data)} bytes, {trials} trials of each kind\n")
        with ProcessPoolExecutor(2) as pool:
            rows = list(pool.map(run, [(name, kind, trials) for kind in FAULTS]))
        print_table(headers, rows)


if __name__ == "__main__":
    main()
