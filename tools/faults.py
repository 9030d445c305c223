"""Faults in one file: wrong samples that are delivered, how many come back, and what recover makes.

python tools/faults.py [--trials N] [--quick] [--many] [--foreign]      default 1000 of each kind
python tools/faults.py --sizes [--trials N] [--write]   what comes back of files of 2 kB to 5 MB
python tools/faults.py --law [--trials N] [DATA]   one byte at each of N places; files cut at half

--quick: 50 of each kind. --many: a recorder's file too, 22 channels at 1 kHz in clusters of 1 s.
--foreign: tactile arrays too, of 16, 64 and 200 mostly silent channels, and all of them with parts
of a second recording of the same set-up in place of their own.
--law: recordings whose lossless file has 100 kB or more, of a folder (default ../shared/data).
--write: put the tables into docs/damage.md; its figures are those of --trials 20.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import NamedTuple

import installed  # noqa: F401

import numpy as np
from bench import load_all
from measured import DATA, files_in, print_origin, print_table, write_rows

import hapfmt
from hapfmt.format.source import BytesSource
from hapfmt.format.walk import walk
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.reading.verifier import verify

SECONDS, RATE = 60.0, 8000
CLUSTER = Fraction(1, 2)
TAXELS, TAXEL_RATE, TAXEL_SECONDS = (16, 64, 200), 100, 300
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


NEED_BLOCKS = ("4 KiB zeroed", "two 4 KiB blocks swapped")
BLOCK, MOST_BLOCKS = 4096, 16
Foreign = Callable[[bytes, bytes, Rng], bytes]
"""Parts of the second file in the first."""


def pasted(data: bytes, other: bytes, to: int, source: int, blocks: int) -> bytes:
    """A number of blocks replaced by the blocks of the other file."""
    part = other[BLOCK * source : BLOCK * (source + blocks)]
    part = part[: len(data) - BLOCK * to]
    return data[: BLOCK * to] + part + data[BLOCK * to + len(part) :]


def some(data: bytes, rng: Rng) -> int:
    """1 to 16 blocks, a quarter of the file at most: most of it is still its own."""
    return int(rng.integers(1, max(min(MOST_BLOCKS, len(data) // BLOCK // 4), 1) + 1))


def same_blocks(data: bytes, other: bytes, rng: Rng) -> bytes:
    blocks = some(data, rng)
    at = int(rng.integers(max(min(len(data), len(other)) // BLOCK - blocks, 1)))
    return pasted(data, other, at, at, blocks)


def other_blocks(data: bytes, other: bytes, rng: Rng) -> bytes:
    blocks = some(data, rng)
    at, source = (int(rng.integers(max(len(each) // BLOCK - blocks, 1))) for each in (data, other))
    return pasted(data, other, at, source, blocks)


def first_blocks(data: bytes, other: bytes, rng: Rng) -> bytes:
    return pasted(data, other, 0, 0, some(data, rng))


def last_blocks(data: bytes, other: bytes, rng: Rng) -> bytes:
    """The end of the other file, from a block of its own, at the end."""
    blocks = some(data, rng)
    at = max(len(data) // BLOCK - blocks, 0)
    source = max(len(other) // BLOCK - blocks, 0)
    return data[: BLOCK * at] + other[BLOCK * source :]


def foreign_payload(data: bytes, other: bytes, rng: Rng) -> bytes:
    """The payload of a cluster of the other file behind a header of this one."""
    mine, theirs = clusters_of(data), clusters_of(other)
    place = int(rng.integers(len(mine)))
    source = place if place < len(theirs) and rng.integers(2) else int(rng.integers(len(theirs)))
    start, stop = mine[place]
    begin, end = theirs[source]
    return data[:start] + other[begin:end] + data[stop:]


@cache
def clusters_of(data: bytes) -> list[tuple[int, int]]:
    """Where the payloads of DATA chunks are."""
    chunks = walk(BytesSource(data), [])
    return [(c.payload_offset, c.stop) for c in chunks if c.header.type == "DATA"]


FOREIGN: dict[str, Foreign] = {
    "blocks of another file, same place": same_blocks,
    "blocks of another file, other place": other_blocks,
    "first blocks of another file": first_blocks,
    "last blocks of another file": last_blocks,
    "payload of another file": foreign_payload,
}


@dataclass(frozen=True)
class Case:
    """A file and what it holds, and a second recording of the same set-up."""

    name: str
    about: str
    data: bytes
    clean: hapfmt.Recording
    other: bytes


def built(
    name: str,
    about: str,
    channels: Callable[[int], list[hapfmt.Channel]],
    settings: hapfmt.Settings,
) -> Case:
    """``channels``: of the first recording or of the second."""
    files = []
    for number in (0, 1):
        labelled = [
            hapfmt.Channel(c.stored, c.rate_exact, c.coverage, c.calibration, f"force {i}", c.unit)
            for i, c in enumerate(channels(number))
        ]
        stream = io.BytesIO()
        hapfmt.write(hapfmt.Recording(tuple(labelled)), stream, settings, canonical=1 + number)
        files.append(stream.getvalue())
    data, other = files
    return Case(name, about, data, hapfmt.read(data), other)


def forces(number: int) -> list[hapfmt.Channel]:
    pairs = (("sand", 1 + 10 * number), ("cork", 2 + 10 * number))
    return [simulate(t, SECONDS, seed, RATE).channels[0] for t, seed in pairs]


def many_forces(number: int) -> list[hapfmt.Channel]:
    seeds = range(100 * number, 100 * number + 22)
    return [simulate("cork", SECONDS, seed, 1000).channels[0] for seed in seeds]


def taxels(count: int, number: int) -> list[hapfmt.Channel]:
    """An array of which one element in eight is touched."""
    rng = np.random.default_rng(number)
    ticks = TAXEL_RATE * TAXEL_SECONDS
    counts = np.zeros((count, ticks), np.int32)
    touched = rng.choice(count, max(count // 8, 2), replace=False)
    counts[touched] = np.cumsum(rng.integers(-3, 4, (touched.size, ticks)), axis=1)
    return [hapfmt.Channel(row, TAXEL_RATE) for row in counts]


@cache
def case(name: str) -> Case:
    if name == "many":
        about = f"{SECONDS:.0f} s, 22 channels at 1000 Hz, clusters of 1 s"
        settings = hapfmt.Settings.of("lossless", cluster=Fraction(1))
        return built(name, about, many_forces, settings)
    if name.startswith("taxels"):
        count = int(name.split()[1])
        about = f"{TAXEL_SECONDS} s, {count} taxels at {TAXEL_RATE} Hz, one in eight is touched"
        settings = hapfmt.Settings.of("lossless")
        return built(name, about, lambda number: taxels(count, number), settings)
    about = f"{SECONDS:.0f} s, 2 channels at {RATE} Hz, clusters of {float(CLUSTER)} s"
    return built(name, about, forces, hapfmt.Settings.of("perceptual", cluster=CLUSTER))


@dataclass
class Trial:
    """What became of one damaged file."""

    right: int = 0
    wrong: int = 0
    unnamed: int = 0
    """Samples that are missing of a channel that is described, and that no lost span names."""
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
            trial.unnamed = unnamed(clean, reader, back)
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


def unnamed(clean: hapfmt.Recording, reader: hapfmt.Reader, back: hapfmt.Recording) -> int:
    if {finding.code for finding in reader.findings} == {"not-closed"}:
        # After a cut between two chunks the rest is unknown.
        return 0
    by_label = {channel.label: channel for channel in clean.channels}
    missing = 0
    for ref, channel in zip(reader.channels, back.channels, strict=True):
        original = by_label.get(channel.label)
        if original is None:
            continue
        known = np.zeros(original.stored.size, bool)
        spans = [(start, start + values.size) for start, values in channel.segments()]
        tracks = {track.id for track in ref.tracks}
        spans += [(span.start, span.stop) for span in reader.lost if span.track in tracks]
        for start, stop in spans:
            known[start:stop] = True
        missing += int((~known).sum())
    return missing


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
        if kind in FAULTS:
            broken = FAULTS[kind](found.data, rng)
        else:
            broken = FOREIGN[kind](found.data, found.other, rng)
        if broken != found.data:
            done.append(attempt(found.clean, broken))
    shares = [trial.right / found.clean.sample_count for trial in done]
    silent = sum(trial.wrong for trial in done if not trial.reported)
    figures = [
        len(done),
        sum(trial.wrong for trial in done),
        silent,
        sum(not trial.reported for trial in done),
        sum(trial.unnamed for trial in done),
        f"{100 * np.mean(shares):.2f}",
        f"{100 * np.min(shares):.2f}",
        sum(trial.refused for trial in done),
        sum(not trial.intact for trial in done),
        sum(not trial.same for trial in done),
    ]
    return [kind, *map(str, figures)]


SIZES = {"2 kB": (1, 2_000), "200 kB": (8, 200_000), "5 MB": (8, 5_000_000)}
"""Channels, and about how many bytes."""

SHOWN_SIZES = ("2 kB", "200 kB")
"""Those of docs/damage.md."""

PRESETS = ("lossless", "near-lossless", "perceptual", "paper")
SIZE_RATE, TRIED_SECONDS, LONGEST = 1000, 8.0, 1500.0


@cache
def sized(name: str, preset: str) -> Case:
    """Forces at 1 kHz, for as long as makes a file of that size."""
    count, wanted = SIZES[name]
    settings = hapfmt.Settings.of(preset)

    def made(seconds: float) -> bytes:
        channels = [
            replace(simulate("cork", seconds, seed, SIZE_RATE).channels[0], label=f"force {seed}")
            for seed in range(count)
        ]
        stream = io.BytesIO()
        hapfmt.write(hapfmt.Recording(tuple(channels)), stream, settings, canonical=1)
        return stream.getvalue()

    seconds, data = TRIED_SECONDS, b""
    for _ in range(3):
        data = made(seconds)
        seconds = min(seconds * wanted / len(data), LONGEST)
    return Case(name, preset, data, hapfmt.read(data), b"")


def run_size(job: tuple[str, str, str, int]) -> str:
    name, preset, kind, trials = job
    return recovered(sized(name, preset), kind, trials)


def recovered(found: Case, kind: str, trials: int) -> str:
    """The mean share that comes back, and the least, in %."""
    if kind in NEED_BLOCKS and len(found.data) < 2 * BLOCK:
        return "-"
    rng = np.random.default_rng(11)
    shares = []
    for _ in range(trials):
        broken = FAULTS[kind](found.data, rng)
        right = 0
        with suppress(hapfmt.HapfmtError), hapfmt.Reader(broken, threads=1) as reader:
            right, wrong = compare(found.clean, reader.read())
            assert not wrong
        shares.append(100 * right / found.clean.sample_count)
    return f"{np.mean(shares):.1f} / {np.min(shares):.0f}"


CLUSTERS: dict[str, tuple[str, ...]] = {
    "teleop1dof/question1a_foam": ("", "--cluster 1", "--cluster 0.5", "--no-references"),
    "smartwheel/smartwheel": ("", "--cluster 10", "--cluster 1", "--no-references"),
}
"""Recordings, and options of preset lossless that limit what one damaged byte takes."""


def cluster_rows(trials: int) -> list[list[str]]:
    """Size, and the share that comes back if one byte changes, with each of the options."""
    rows = []
    for (file, options), name in zip(CLUSTERS.items(), ("foam", "wheel"), strict=True):
        recording = hapfmt.read(next(p for p in files_in(DATA) if str(p).endswith(f"{file}.npz")))
        rate, count = float(recording.channels[0].rate_exact), len(recording)
        about = f"{name}, {count} channels at {rate:g} Hz, {float(recording.duration):.3g} s"
        for option in options:
            seconds = option.removeprefix("--cluster ")
            stream = io.BytesIO()
            hapfmt.write(
                recording, stream, canonical=1, references=option != "--no-references",
                cluster=seconds if seconds != option else None,
            )  # fmt: skip
            found = Case(file, option, stream.getvalue(), hapfmt.read(stream.getvalue()), b"")
            share = recovered(found, "one byte changed", trials)
            rows.append([about, f"`{option}`" if option else "none", f"{len(found.data)}", share])
            about = ""
    return rows


def print_sizes(trials: int, write: bool) -> None:
    columns = {}
    for name in SHOWN_SIZES if write else SIZES:
        about = ", ".join(f"{preset} {len(sized(name, preset).data)}" for preset in PRESETS)
        print(f"\nFiles of about {name} ({about} bytes), {trials} trials of each kind\n")
        jobs = [(name, preset, kind, trials) for kind in FAULTS for preset in PRESETS]
        with ProcessPoolExecutor(2) as pool:
            cells = list(pool.map(run_size, jobs))
        rows = [
            [kind, *cells[len(PRESETS) * i : len(PRESETS) * (i + 1)]]
            for i, kind in enumerate(FAULTS)
        ]
        print_table(["recovered: mean / least, %", *PRESETS], rows)
        columns[name] = rows
    if write:
        pairs = zip(columns["2 kB"], columns["200 kB"], strict=True)
        shown = [[*small[:2], *large[1:]] for small, large in pairs]
        write_rows("faults", [row for row in shown if row[0] != "bytes after the end"])
    if DATA.exists():
        rows = cluster_rows(trials)
        print_table(["recording", "option", "bytes", "recovered: mean / least, %"], rows)
        if write:
            write_rows("clusters", rows)


LARGE, LAW_PLACES = 100_000, 100
"""Bytes of the lossless files that the law is for, and places of a changed byte."""

MEAN_KEPT, LEAST_KEPT, HALF_KEPT = 0.97, 0.90, 0.40
"""Shares of the samples: of one changed byte the mean and the worst, and of a file cut at half."""


class Kept(NamedTuple):
    """What a file keeps of its samples. ``described``: where a byte of HEAD or TRAK changed."""

    size: int
    mean: float
    least: float
    described: float
    half: float

    @property
    def lawful(self) -> bool:
        kept = self.mean >= MEAN_KEPT and min(self.least, self.described) >= LEAST_KEPT
        return kept and self.half >= HALF_KEPT


def lossless_file(recording: hapfmt.Recording) -> bytes:
    stream = io.BytesIO()
    hapfmt.write(recording, stream, canonical=1)
    return stream.getvalue()


def share_right(clean: hapfmt.Recording, data: bytes) -> float:
    """Samples that a damaged file still gives, of all; none of them is wrong."""
    right = 0
    with suppress(hapfmt.HapfmtError), hapfmt.Reader(data, threads=1) as reader:
        right, wrong = compare(clean, reader.read())
        assert not wrong
    return right / clean.sample_count


def spread(start: int, stop: int, count: int) -> list[int]:
    """Places within a stretch of bytes, at equal distances."""
    return [start + (stop - start) * (2 * k + 1) // (2 * count) for k in range(count)]


def kept_of(data: bytes, places: int = LAW_PLACES) -> Kept:
    """``places`` of the whole file, and a fifth as many of its first HEAD and TRAK."""
    clean, rng = hapfmt.read(data, threads=1), np.random.default_rng(5)

    def changed(at: int) -> float:
        broken = bytearray(data)
        broken[at] ^= int(rng.integers(1, 256))
        return share_right(clean, bytes(broken))

    found = [changed(at) for at in spread(0, len(data), places)]
    described = next(c.offset for c in walk(BytesSource(data), []) if c.header.type == "DATA")
    early = [changed(at) for at in spread(0, described, -(-places // 5))]
    half = share_right(clean, data[: len(data) // 2])
    return Kept(len(data), float(np.mean(found)), min(found), min(early), half)


def law_row(job: tuple[str, bytes, int]) -> list[str]:
    name, data, places = job
    kept = kept_of(data, places)
    shares = (kept.mean, kept.least, kept.described, kept.half)
    return [name, f"{kept.size}", *(f"{100 * each:.1f}" for each in shares), str(kept.lawful)]


def print_law(folder: Path, places: int) -> None:
    files = ((name, lossless_file(recording)) for name, recording in load_all(folder, "", None))
    jobs = [(name, data, places) for name, data in files if len(data) >= LARGE]
    with ProcessPoolExecutor(2) as pool:
        rows = list(pool.map(law_row, jobs))
    headers = ["recording", "bytes", "mean", "worst", "HEAD, TRAK", "cut at half, %", "lawful"]
    print_table(headers, rows)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("data", nargs="?", type=Path, default=DATA)
    parser.add_argument("--law", action="store_true")
    parser.add_argument("--trials", type=int, default=1000)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--many", action="store_true")
    parser.add_argument("--foreign", action="store_true")
    parser.add_argument("--sizes", action="store_true")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    trials = 50 if options.quick else options.trials
    print_origin()
    if options.law:
        print_law(options.data, min(trials, LAW_PLACES))
        return
    if options.sizes:
        print_sizes(trials, options.write)
        return
    headers = ["fault", "trials", "wrong samples", "of them silent", "faults not reported",
               "losses not named", "recovered %", "worst %", "refused by recover",
               "not intact after recover", "other samples after recover"]  # fmt: skip
    names = ["pair", "many"] if options.many else ["pair"]
    names += [f"taxels {count}" for count in TAXELS] if options.foreign else []
    kinds = [*FAULTS, *FOREIGN] if options.foreign else list(FAULTS)
    for name in names:
        found = case(name)
        print(f"\n{found.about}, {len(found.data)} bytes, {trials} trials of each kind\n")
        with ProcessPoolExecutor(2) as pool:
            rows = list(pool.map(run, [(name, kind, trials) for kind in kinds]))
        print_table(headers, rows)


if __name__ == "__main__":
    main()
