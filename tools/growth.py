"""Bytes of every recording and preset, and how much they grew since another commit.

python tools/growth.py [DATA] [--save FILE] [--against FILE]      default: ../shared/data

Prints Markdown: bytes of the whole file, of its packets and of its framing, preset lossless; then
the bytes of whole files of the other presets. Generated recordings and simulated scenes come
first. To compare two commits, run it with the Python of each: the first run saves what the second
is printed against. The process has one thread; seconds are CPU time of encoding.
"""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Iterator
from itertools import chain
from math import exp, log
from pathlib import Path
from typing import Any

import installed  # noqa: F401

import click
import numpy as np
from bench import load_all
from measured import DATA, origin, print_table, timed
from speeds import shortened, walks

import hapfmt
from hapfmt.errors import DataWarning
from hapfmt.lab.scenes import load_scene, simulate

SCENES = ("sand", "wall", "taps", "grasp", "free")
SECONDS = 60.0
DEADBAND = {"preset": "perceptual", "texture": False, "felt": "all", "floor": "0.2%"}
PRESETS: dict[str, dict[str, Any]] = {
    "lossless": {},
    "fast": {"fast": True},
    "near-lossless": {"preset": "near-lossless"},
    "perceptual": {"preset": "perceptual"},
    "paper": {"preset": "paper"},
    **{f"deadband {k}": {**DEADBAND, "k": k} for k in ("0.02", "0.1", "0.3")},
}

Figures = dict[str, dict[str, list[float]]]
"""By recording and preset: bytes of the file and of its packets, and seconds."""


def generated() -> Iterator[tuple[str, hapfmt.Recording]]:
    """One short channel; 22 of a sine and a random walk; and a long walk of clipped steps."""
    several = walks()
    yield "1 x 500 counts", shortened(several.sel(0), 500)
    yield "22 x 10 s", several
    steps = np.clip(np.round(np.random.default_rng(3).normal(0, 2, 2_000_000)), -9, 9)
    counts = np.cumsum(steps).astype(np.int32)
    yield "2 million steps", hapfmt.Recording((hapfmt.Channel(counts, 1000),))


def scenes(seconds: float) -> Iterator[tuple[str, hapfmt.Recording]]:
    for name in SCENES:
        yield name, simulate(load_scene(name).changed(seconds=seconds))[0]


def measure(recording: hapfmt.Recording, given: dict[str, Any]) -> list[float]:
    settings = hapfmt.Settings.of(**given)

    def write() -> hapfmt.Summary:
        return hapfmt.write(recording, io.BytesIO(), settings, canonical=1, threads=1)

    summary, seconds = timed(write)
    return [summary.file_size, summary.payload_size, seconds]


def share(now: float, then: float | None) -> str:
    return "-" if not then else f"{100 * (now / then - 1):+.2f}"


def mean_ratio(pairs: list[tuple[float, float]]) -> str:
    """Geometric, in %."""
    return share(exp(sum(log(a / b) for a, b in pairs) / len(pairs)), 1.0) if pairs else "-"


def print_lossless(found: Figures, before: Figures) -> None:
    rows = []
    for name, each in found.items():
        if "lossless" not in each:
            continue
        size, payload, seconds = each["lossless"]
        then = before.get(name, {}).get("lossless", [0, 0, 0])
        rows.append(
            [name, f"{size:.0f}", f"{payload:.0f}", f"{size - payload:.0f}", share(size, then[0]),
             share(payload, then[1]), f"{seconds:.2f}", f"{then[2]:.2f}" if then[2] else "-"]
        )  # fmt: skip
    print_table(
        ["lossless", "bytes", "packets", "framing", "bytes, %", "packets, %", "s", "s before"], rows
    )


def print_presets(found: Figures, before: Figures) -> None:
    """Bytes of each, and by how many % they grew."""
    names = [preset for preset in PRESETS if any(preset in each for each in found.values())]
    rows = []
    pairs: dict[str, list[tuple[float, float]]] = {preset: [] for preset in names}
    seconds: dict[str, list[float]] = {preset: [0.0, 0.0] for preset in names}
    for name, each in found.items():
        row = [name]
        for preset in names:
            if preset not in each:
                row.append("-")
                continue
            then = before.get(name, {}).get(preset)
            grown = ""
            if then:
                grown = f" {share(each[preset][0], then[0])}"
                pairs[preset].append((each[preset][0], then[0]))
                seconds[preset][1] += then[2]
            seconds[preset][0] += each[preset][2]
            row.append(f"{each[preset][0]:.0f}{grown}")
        rows.append(row)
    if any(pairs.values()):
        rows.append(["mean, %", *(mean_ratio(pairs[preset]) for preset in names)])
    rows.append(["s", *(f"{now:.1f} ({then:.1f})" for now, then in seconds.values())])
    print_table(["bytes and %" if before else "bytes", *names], rows)


@click.command(help=__doc__)
@click.argument(
    "data", default=DATA if DATA.exists() else None, required=False,
    type=click.Path(exists=True, path_type=Path),
)  # fmt: skip
@click.option("--only", default="", help="Recordings whose name contains this.")
@click.option("--preset", "presets", multiple=True, help="One preset; may be repeated.")
@click.option("--seconds", default=SECONDS, help="Length of the simulated scenes.")
@click.option("--save", type=click.Path(path_type=Path), help="Keep the figures as JSON.")
@click.option("--against", type=click.Path(exists=True, path_type=Path), help="Figures kept.")
def main(
    data: Path | None,
    only: str,
    presets: tuple[str, ...],
    seconds: float,
    save: Path | None,
    against: Path | None,
) -> None:
    found: Figures = {}
    for name, recording in chain(
        generated(), scenes(seconds), load_all(data, only, None) if data else ()
    ):
        if only not in name or not recording.sample_count:
            continue
        click.echo(f"{name} ...", err=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)
            found[name] = {
                preset: measure(recording, given)
                for preset, given in PRESETS.items()
                if not presets or preset in presets
            }
    kept = json.loads(against.read_text("utf-8")) if against else {"origin": "", "figures": {}}
    click.echo(f"{origin()}\n" + (f"against {kept['origin']}\n" if against else ""))
    print_lossless(found, kept["figures"])
    print_presets(found, kept["figures"])
    if save:
        save.write_text(json.dumps({"origin": origin(), "figures": found}, indent=1), "utf-8")


if __name__ == "__main__":
    main()
