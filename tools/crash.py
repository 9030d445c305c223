"""kill -9 of a recording process at random moments under load, and what its file still holds.

python tools/crash.py [--trials 200] [--seed 1]

The process records 30 channels of three rates in chunks of random sizes, calls flush at random
moments and reports after each, through a pipe, the flushed ticks. It is killed at a random moment
after its start, every tenth at a random moment of its life. Then the file must open. At worst it is
not closed, or its last chunk is cut. Every sample in it must be the recorded one, and all flushed
samples must be there. Every second trial appends to the file of the previous one. After each trial,
a recorder appends to the file and closes it, and the file must be intact. The page cache survives a
kill, so this program does not test a loss of power.
"""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import installed  # noqa: F401

import click
import numpy as np
from measured import print_origin, print_table
from numpy.typing import NDArray

import hapfmt

RATES = [Fraction(100), Fraction(1000), Fraction(8000)]
CHANNELS = 30
CLUSTER = Fraction(1, 5)
LIFE_S = 0.8
"""A process lives for less than this."""

HARMLESS = {"not-closed", "truncated"}
"""Findings that a kill may leave."""

CUT = {"bad-table", "bad-packet"}
"""Findings that it may leave within the chunk that it cut, which was not yet flushed."""

CALIBRATION = hapfmt.Calibration(1, 0, 1000)


def inputs() -> list[hapfmt.Input]:
    """Counts, floats on a grid, and doubles without one."""
    found = []
    for number in range(CHANNELS):
        rate = RATES[number % 3]
        label = f"channel {number}"
        if number % 5 == 4:
            found.append(hapfmt.Input(label, rate, "m"))
        elif number % 5 == 3:
            found.append(hapfmt.Input(label, rate, "V", lsb=0.5))
        else:
            found.append(hapfmt.Input(label, rate, "N", calibration=CALIBRATION))
    return found


def samples(number: int, start: int, stop: int) -> NDArray[np.int64]:
    """What is recorded of a channel: noise that its ticks determine."""
    ticks = np.arange(start, stop, dtype=np.uint64)
    mixed = (ticks + np.uint64(number << 32)) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    return ((mixed * np.uint64(0xBF58476D1CE4E5B9)) >> np.uint64(48)).astype(np.int64) - (1 << 15)


def values(number: int, counts: NDArray[np.int64]) -> NDArray[np.float64] | NDArray[np.int64]:
    if number % 5 == 4:
        return counts / 3
    return counts * 0.5 if number % 5 == 3 else counts


def child(path: str, pipe: int, seed: int, append: bool) -> None:
    """Records until it is killed."""
    rng = np.random.default_rng(seed)
    recorder = hapfmt.Recorder(path, inputs(), cluster=CLUSTER, append=append, hold=0.3)
    ticks = [int(tick) for tick in recorder.lanes.ticks]
    counts = [0] * CHANNELS
    report(pipe, ticks, counts)
    while True:
        for number in rng.permutation(CHANNELS).tolist():
            at = ticks[number]
            size = int(rng.integers(1, 1 + int(RATES[number % 3] / 10)))
            recorder.write(number, values(number, samples(number, at, at + size)), tick=at)
            gap = 7 if rng.integers(200) == 0 else 0
            ticks[number] = at + size + gap
            counts[number] += size
        if rng.integers(6) == 0:
            recorder.flush()
            report(pipe, ticks, counts)


def report(pipe: int, ticks: list[int], counts: list[int]) -> None:
    """In one write, so that it arrives whole: what is flushed, by channel."""
    os.write(pipe, json.dumps([ticks, counts]).encode() + b"\n")


@dataclass
class Tally:
    """What the trials found."""

    trials: int = 0
    unborn: int = 0
    """Killed before anything was flushed, the file empty or not there."""
    findings: Counter[str] = field(default_factory=Counter)
    flushed: int = 0
    kept: int = 0
    faults: list[str] = field(default_factory=list)


def trial(path: Path, seed: int, append: bool, tally: Tally) -> None:
    """One life of a recorder, killed, and its file looked at."""
    rng = np.random.default_rng([seed, 1])
    reader, writer = os.pipe()
    pid = os.fork()
    if not pid:
        os.close(reader)
        try:
            child(str(path), writer, seed, append)
        except BaseException as error:
            os.write(2, f"trial {seed}: {error!r}\n".encode())
        os._exit(1)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        first = pipe.readline() if seed % 10 else b""
        time.sleep(float(rng.uniform(0, LIFE_S)))
        os.kill(pid, signal.SIGKILL)
        status = os.waitpid(pid, 0)[1]
        sent = (first + pipe.read()).split(b"\n")[:-1]
    tally.trials += 1
    if not os.WIFSIGNALED(status):
        tally.faults.append(f"trial {seed}: the recorder failed by itself")
    flushed = [json.loads(line) for line in sent]
    if len(flushed) < 2 and (not path.exists() or path.stat().st_size < 64):
        tally.unborn += 1
        return
    try:
        look(path, [Flushed(*each) for each in zip(*first_and_last(flushed), strict=True)], tally)
    except (hapfmt.HapfmtError, AssertionError) as error:
        tally.faults.append(f"trial {seed}: {error}")


class Flushed(NamedTuple):
    """One channel: the number of samples between two ticks that are on the disk."""

    start: int = 0
    stop: int = 0
    count: int = 0


def first_and_last(sent: list[list[list[int]]]) -> tuple[list[int], list[int], list[int]]:
    """Ticks at the beginning; ticks and counts at the last flush."""
    nothing = [[0] * CHANNELS] * 2
    first, last = (sent[0], sent[-1]) if sent else (nothing, nothing)
    return first[0], last[0], last[1]


def look(path: Path, flushed: list[Flushed], tally: Tally) -> None:
    """Check that the file holds the flushed samples, and that every sample was recorded."""
    with hapfmt.Reader(path, scan=True) as reader:
        recording = reader.read()
        codes = {finding.code for finding in reader.findings}
        cut = min(
            (each.offset for each in reader.findings if each.code == "truncated"), default=None
        )
        for each in reader.findings:
            within = cut is not None and each.offset >= cut and each.code in CUT
            assert within or each.code in HARMLESS, f"{each}"
        for lost in reader.lost:
            assert cut is not None and lost.offset is not None and lost.offset >= cut, f"{lost}"
    tally.findings.update(codes or {"intact"})
    by_label = {channel.label: channel for channel in recording.channels}
    for number, sent in enumerate(flushed):
        channel = by_label.get(f"channel {number}")
        if channel is None:
            assert not sent.count, f"channel {number} is missing, {sent} flushed"
            continue
        recorded = np.concatenate(
            [samples(number, *span) for span in channel.coverage] or [np.empty(0, np.int64)]
        )
        wanted = values(number, recorded)
        found = channel.stored if channel.exact is None else channel.exact
        if number % 5 >= 3:
            found = channel.samples()
        assert (found == wanted).all(), f"channel {number} holds other samples"
        kept = sum(
            max(min(span.stop, sent.stop) - max(span.start, sent.start), 0)
            for span in channel.coverage
        )
        assert kept == sent.count, f"channel {number} kept {kept} of {sent}"
        tally.kept += int(channel.stored.size)
        tally.flushed += kept


def mend(path: Path, seed: int, tally: Tally) -> None:
    """Append to what is left and close it: the file is intact again."""
    try:
        with hapfmt.Recorder(path, inputs(), cluster=CLUSTER, append=True) as recorder:
            ticks = [int(tick) for tick in recorder.lanes.ticks]
            for number, at in enumerate(ticks):
                recorder.write(number, values(number, samples(number, at, at + 9)))
        verdict = hapfmt.verify(path).verdict
        assert verdict == "intact", f"after append and close: {verdict}"
        look(path, [Flushed(tick, tick + 9, 9) for tick in ticks], Tally())
    except (hapfmt.HapfmtError, AssertionError) as error:
        tally.faults.append(f"trial {seed}, mended: {error}")


@click.command(help=__doc__)
@click.option("--trials", default=200)
@click.option("--seed", default=1)
def main(trials: int, seed: int) -> None:
    tally = Tally()
    with hapfmt.Recorder(io.BytesIO(), inputs()) as recorder:
        # A trial does not include imports and first measurements.
        recorder.write(0, samples(0, 0, 1000))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crash.hapf"
        number = 0
        while tally.trials - tally.unborn < trials:
            number += 1
            append = bool(number % 2) and path.exists() and path.stat().st_size >= 64
            if not append:
                path.unlink(missing_ok=True)
            trial(path, seed * 100_000 + number, append, tally)
            if path.exists() and path.stat().st_size >= 64:
                mend(path, seed * 100_000 + number, tally)
    print_origin()
    rows: list[list[object]] = [
        ["killed", tally.trials - tally.unborn],
        ["opened", tally.trials - tally.unborn - len(tally.faults)],
        ["killed before the first chunk, not counted above", tally.unborn],
        *([f"verdict {code}", count] for code, count in sorted(tally.findings.items())),
        ["samples flushed and there", tally.flushed],
        ["samples there beyond the last flush", tally.kept - tally.flushed],
        ["faults", len(tally.faults)],
    ]
    print_table(["kill -9", "count"], rows)
    for fault in tally.faults[:20]:
        print(fault)
    sys.exit(1 if tally.faults else 0)


if __name__ == "__main__":
    main()
