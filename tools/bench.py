"""Sizes, errors and speeds compared with other packages: same recordings, same bound, same run.

python tools/bench.py [DATA]          a folder of recordings, or one; default: ../shared/data
python tools/bench.py --simulated     no data needed
python tools/bench.py --speed         times of all presets as multiples of flac -8, and memory
python tools/bench.py --against COMMIT      the same, and at another commit
python tools/bench.py --searches      what each search of the encoder gains, and costs
python tools/bench.py --picture FILE  size against encoding and decoding time

Bits per sample (b/s) of packets, and of whole files. A peer's are the bytes of its own format and 4
for each channel; its whole file is a zip of them with names, rates and units. Every sample of every
coder is checked against the bound. A peer whose package is missing is named, and left out.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import installed  # noqa: F401

import click
import numpy as np
import speeds
from measured import DATA, files_in, origin, timed
from peers.exact import Coder, double_coders, integer_coders
from peers.packages import PACKAGES, left_out, versions
from peers.relative import Recipe, outside, recipes
from peers.zipped import coded_size, file_size
from results import OURS, Cell, Row, cells, print_broken, print_sizes, print_speeds, print_summary
from results import write_csv as save_csv
from rich.console import Console
from rich.progress import Progress

import hapfmt
from hapfmt.convert.formats import read_suffixes
from hapfmt.encoder.lattice import find_lattice
from hapfmt.encoder.settings import Tolerance

TASKS = ("deadband", "lossless", "doubles")
FLOOR = 0.002
"""Absolute threshold as a share of each channel's range."""

ALWAYS = "flac -8"
COUNT_LIMIT = 1 << 31
SEEN_RATIOS = 1 << 20
"""Denominators of calibrations in task lossless, where only the counts are the truth."""

Peer = Coder | Recipe
Check = Callable[[Sequence[np.ndarray]], tuple[int, float]]


class Job(NamedTuple):
    """One recording and task: what we write, what peers get, and the bound."""

    recording: str
    task: str
    ours: dict[str, tuple[hapfmt.Recording, hapfmt.Settings]]
    peers: Callable[[int], list[Peer]]
    """The peers for one channel."""

    arrays: list[np.ndarray]
    check: Check


def load_all(data: Path, only: str, rate: str | None) -> Iterator[tuple[str, hapfmt.Recording]]:
    """(name, recording) of each file that can be read; the others are printed with the reason.

    It leaves out those of the project's own data that only show how labs store their files.
    """
    paths = [data] if data.is_file() else files_in(data)
    root = data.parent if data.is_file() else data
    for path in paths:
        name = str(path.relative_to(root).with_suffix(""))
        if path.suffix.lower() not in (*read_suffixes(), ".hapf") or only not in name:
            continue
        if data == DATA and name.startswith("real/"):
            continue
        try:
            given = {} if path.suffix == ".hapf" else {"rate": rate}
            yield name, hapfmt.read(path, **given)
        except hapfmt.HapfmtError as error:
            click.echo(f"left out: {error}", err=True)


def deadband_jobs(name: str, recording: hapfmt.Recording, ks: Sequence[str]) -> Iterator[Job]:
    """The Weber fractions, each with the floor."""
    kept = [c for c in recording.channels if c.stored.size and np.isfinite(c.samples()).all()]
    arrays = [channel.samples() for channel in kept]
    if not kept:
        return
    # The peers' bound is each channel's own, so ours is: no vectors.
    ours = replace(recording, channels=tuple(replace(channel, group="") for channel in kept))
    floors = [FLOOR * float(np.ptp(x)) for x in arrays]
    for k in ks:
        settings = hapfmt.Settings.of(
            "perceptual", texture=False, felt="all", k=k, floor=Tolerance(FLOOR, "range")
        )
        value = float(Fraction(k))

        def check(found: Sequence[np.ndarray], k: float = value) -> tuple[int, float]:
            each = [
                outside(x, y, k, f) if f else (int((x != y).sum()), 0.0)
                for x, y, f in zip(arrays, found, floors, strict=True)
            ]
            return sum(count for count, _ in each), max(worst for _, worst in each)

        yield Job(
            name, f"deadband k={k}", {"deadband": (ours, settings)},
            lambda channel, k=value: recipes(k, floors[channel]), arrays, check,
        )  # fmt: skip


def counts_of(channel: hapfmt.Channel, *, search: bool) -> np.ndarray | None:
    """Integer counts of a channel on a grid: its own counts, or multiples of the file's step."""
    if channel.is_counts:
        return channel.stored.astype(np.int64)
    x = channel.samples()
    if not x.size or not np.isfinite(x).all():
        return None
    if channel.lsb is not None and isfinite(channel.lsb) and channel.lsb > 0:
        steps = np.rint((x - x[0]) / channel.lsb) + round(x[0] / channel.lsb)
        return steps.astype(np.int64) if np.abs(steps).max() < COUNT_LIMIT else None
    found = find_lattice(x) if search else None
    return found.counts if found else None


def counted(channel: hapfmt.Channel, counts: np.ndarray) -> hapfmt.Channel:
    """The channel as these counts, its calibration near enough to cost what the real one costs."""
    given = channel.calibration
    if given is None:
        step = Fraction(channel.lsb or 1.0).limit_denominator(SEEN_RATIOS) or Fraction(1)
        given = hapfmt.Calibration(step.numerator, 0, step.denominator)
        if not given.covers(int(counts.min()), int(counts.max())):
            given = hapfmt.Calibration()
    return replace(channel, stored=counts, calibration=given, lsb=None)


def lossless_jobs(name: str, recording: hapfmt.Recording) -> Iterator[Job]:
    """Integer counts."""
    ours = in_counts(recording)
    if ours is None:
        return
    arrays = [channel.stored for channel in ours.channels]
    fast = hapfmt.Settings.of("lossless", fast=True)
    yield Job(
        name, "lossless",
        {"lossless": (ours, hapfmt.Settings.of("lossless")), "lossless --fast": (ours, fast)},
        lambda _channel: list(integer_coders()), arrays, lambda found: same(arrays, found),
    )  # fmt: skip


def in_counts(recording: hapfmt.Recording) -> hapfmt.Recording | None:
    """The channels that are integers, as counts; None where there are none."""
    search = all(channel.lsb is None for channel in recording.channels)
    found = [(c, counts_of(c, search=search)) for c in recording.channels if c.stored.size]
    known = tuple(counted(c, counts) for c, counts in found if counts is not None)
    return replace(recording, channels=known) if known else None


def doubles_jobs(name: str, recording: hapfmt.Recording) -> Iterator[Job]:
    """The doubles of the file, bit for bit."""
    kept = [c for c in recording.channels if c.stored.dtype == np.float64 and c.stored.size]
    if not kept:
        return
    ours = replace(recording, channels=tuple(kept))
    arrays = [channel.stored for channel in kept]
    yield Job(
        name, "doubles", {"lossless": (ours, hapfmt.Settings.of("lossless"))},
        lambda _channel: list(double_coders()), arrays, lambda found: same(arrays, found),
    )  # fmt: skip


def same(arrays: Sequence[np.ndarray], found: Sequence[np.ndarray]) -> tuple[int, float]:
    """Samples that differ in any bit."""
    return sum(
        x.size if x.shape != y.shape else int((x.view(np.int64) != y.view(np.int64)).sum())
        for x, y in zip(arrays, found, strict=True)
    ), 0.0


def measure_ours(job: Job, coder: str, repeats: int) -> Row:
    """Through the whole package: grid, choice, file; read back and verified."""
    recording, settings = job.ours[coder]

    def encode() -> tuple[bytes, int]:
        stream = io.BytesIO()
        summary = hapfmt.write(recording, stream, settings, canonical=1)
        return stream.getvalue(), summary.payload_size

    (data, payload), encode_s = timed(encode, repeats)
    back, decode_s = timed(lambda: hapfmt.read(data), repeats)
    if job.task == "lossless":
        found = [channel.stored.astype(np.int64) for channel in back.channels]
    else:
        found = [channel.samples() for channel in back.channels]
    report = hapfmt.verify(data, against=recording)
    if report.verdict != "intact":
        raise AssertionError(f"{job.recording}, {coder}: {report.error or report.findings}")
    return Row(
        job.recording, job.task, coder, OURS, len(recording), recording.sample_count, payload,
        len(data), *job.check(found), encode_s, decode_s, repeats,
        sum(check.outside for check in report.contracts if check.promised),
        max((float(check.worst_ratio) for check in report.contracts), default=0.0),
    )  # fmt: skip


def measure_peer(job: Job, place: int, repeats: int) -> Row | None:
    """One coder on all channels; None where one of them does not fit its format."""
    recording, _ = next(iter(job.ours.values()))
    rates = [channel.rate for channel in recording.channels]
    # A constant channel is its value, which counts as side information.
    flat = [bool((x == x[0]).all()) for x in job.arrays]
    coders: list[Peer | None] = [
        None if flat[i] else job.peers(i)[place] for i in range(len(job.arrays))
    ]
    known = next((coder for coder in coders if coder is not None), None)
    if known is None:
        return None

    def encode() -> list[bytes | None]:
        return [
            b"" if coder is None else coder.encode(x, rate)
            for coder, x, rate in zip(coders, job.arrays, rates, strict=True)
        ]

    blobs, encode_s = timed(encode, repeats)
    given = [blob for blob in blobs if blob is not None]
    if len(given) < len(blobs):
        return None

    def decode() -> list[np.ndarray]:
        return [
            x.copy() if coder is None else coder.decode(blob, x.size)
            for coder, blob, x in zip(coders, given, job.arrays, strict=True)
        ]

    found, decode_s = timed(decode, repeats)
    labels = [channel.label for channel in recording.channels]
    description = {
        "rates": sorted(set(rates)),
        "units": [channel.unit for channel in recording.channels],
        "coder": known.name,
        "task": job.task,
    }
    return Row(
        job.recording, job.task, known.name, getattr(known, "family", "exact"), len(labels),
        sum(x.size for x in job.arrays), coded_size(given),
        file_size(given, unique(labels), description), *job.check(found), encode_s, decode_s,
        repeats,
    )  # fmt: skip


def unique(labels: Sequence[str]) -> list[str]:
    """Names of members of a zip."""
    return [
        label if label and labels.count(label) == 1 else f"{label}{place}"
        for place, label in enumerate(labels)
    ]


def run(job: Job, repeats: int) -> list[Row]:
    """Every coder once; ours, the best peer and FLAC as often as asked."""
    rows = [measure_ours(job, coder, repeats) for coder in job.ours]
    varied = next((i for i, x in enumerate(job.arrays) if (x != x[0]).any()), None)
    places = range(len(job.peers(varied))) if varied is not None else range(0)
    peers = {place: row for place in places if (row := measure_peer(job, place, 1)) is not None}
    kept = [place for place, row in peers.items() if row.held]
    best = min(kept, key=lambda place: peers[place].coded_size, default=None)
    for place, row in peers.items():
        if repeats > 1 and (place == best or row.coder.endswith(ALWAYS)):
            peers[place] = measure_peer(job, place, repeats) or row
    return [*rows, *peers.values()]


def warm_up() -> None:
    """Imports and first calls are no part of a measurement."""
    t = np.arange(500) / 100
    recording = hapfmt.Recording((hapfmt.Channel.from_physical(np.sin(t), 100, lsb=0.001),))
    for job in jobs_of([("", recording)], TASKS, ["0.1"]):
        run(job, 1)


def jobs_of(
    recordings: Sequence[tuple[str, hapfmt.Recording]], tasks: Sequence[str], ks: Sequence[str]
) -> Iterator[Job]:
    for task in tasks:
        for name, recording in recordings:
            if task == "deadband":
                yield from deadband_jobs(name, recording, ks)
            elif task == "lossless":
                yield from lossless_jobs(name, recording)
            else:
                yield from doubles_jobs(name, recording)


def tell(rows: Sequence[Row]) -> None:
    """All tables."""
    shown = cells(rows)
    groups: dict[str, list[Cell]] = {}
    for cell in shown:
        groups.setdefault(cell.what, []).append(cell)
    if shown:
        print("sizes in bits per sample; outside and largest error: in counts / in float64\n")
        print_sizes(shown)
        print("million samples per second of CPU time, best of n\n")
        print_speeds(shown, ALWAYS)
    print_broken(rows)
    together = [cell for cell in shown if cell.ours.task.startswith("deadband")]
    print_summary({**groups, "deadband, all k": together})


@click.command(help=__doc__)
@click.argument("data", required=False, type=click.Path(exists=True, path_type=Path))
@click.option("--simulated", is_flag=True, help="Simulated recordings instead of DATA.")
@click.option("--seconds", default=10.0, help="Length of the simulated ones.")
@click.option("--task", default="deadband,lossless,doubles", help=f"Of {', '.join(TASKS)}.")
@click.option("--k", "ks", default="0.02,0.1,0.3", help="Weber fractions of the deadband.")
@click.option("--only", default="", help="Recordings whose name contains this.")
@click.option("--rate", help="For files without a rate.")
@click.option("--repeats", default=3, type=click.IntRange(1), help="Runs; the best one counts.")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="A row for each coder.")
@click.option("--speed", is_flag=True, help="Times as multiples of flac -8, and memory.")
@click.option("--json", "as_json", is_flag=True, help="Of --speed: times alone.")
@click.option("--searches", is_flag=True, help="What each search gains and costs.")
@click.option("--against", metavar="COMMIT", help="Times here and at another commit.")
@click.option("--write", is_flag=True, help="Put these tables into docs/measuring.md.")
@click.option("--picture", type=click.Path(path_type=Path), help="Size against time.")
def main(
    data: Path | None, simulated: bool, seconds: float, task: str, ks: str, only: str,
    rate: str | None, repeats: int, csv_path: Path | None, speed: bool, as_json: bool,
    searches: bool, against: str | None, write: bool, picture: Path | None,
) -> None:  # fmt: skip
    tasks, weber = task.split(","), ks.split(",")
    if unknown := set(tasks) - set(TASKS):
        raise click.BadParameter(f"no task {', '.join(sorted(unknown))}; there are {TASKS}")
    if not all(0 < float(Fraction(k)) < 1 for k in weber):
        raise click.BadParameter("a Weber fraction lies between 0 and 1")
    if simulated or not (data or DATA.exists()):
        from simulated import recordings as scenes

        found = [(name, scene) for name, scene in scenes(seconds).items() if only in name]
    else:
        found = list(load_all(data or DATA, only, rate))
    if speed or searches or against or picture:
        integers = [(name, counts) for name, each in found if (counts := in_counts(each))]
        cases = speeds.cases_of(integers, data or DATA)
        if searches:
            speeds.print_searches(integers, repeats, write=write)
        elif against:
            chosen = ["--simulated", "--seconds", str(seconds)] if simulated else []
            given = [str(data.resolve())] if data else []
            speeds.print_against(against, [*given, *chosen, "--only", only], cases, repeats)
        elif picture:
            speeds.draw(cases, picture, repeats)
        else:
            speeds.print_times(cases, repeats, as_json=as_json, write=write)
        if not as_json:
            print(origin())
        return
    warm_up()
    rows: list[Row] = []
    jobs = list(jobs_of(found, tasks, weber))
    with Progress(console=Console(stderr=True), transient=True) as bar:
        work = bar.add_task("measuring", total=len(jobs))
        try:
            for job in jobs:
                bar.update(work, description=f"{job.task} {job.recording[-30:]}")
                rows += run(job, repeats)
                bar.advance(work)
        except KeyboardInterrupt:
            click.echo(f"interrupted: {int(bar.tasks[0].completed)} of {len(jobs)} jobs", err=True)
    tell(rows)
    print(origin())
    print("peers: " + (", ".join(f"{name} {v}" for name, v in versions().items()) or "none"))
    if missing := left_out():
        print(f"left out, of {len(PACKAGES)}: pip install {' '.join(missing)}")
    if csv_path:
        save_csv(rows, csv_path, origin())


if __name__ == "__main__":
    main()
