"""Presets compared over a folder of recordings: ratio, largest error, time. Prints Markdown.

python tools/presets.py [DATA] [--write]        a folder of recordings; without: ../shared/data

The ratio is that of the samples as float64 (8 bytes each) to the whole file, as the geometric mean
over the files. Every decoded sample is compared with the float64 of the recording; the error of a
channel is in % of its range. CPU seconds are of encoding alone.
"""

from __future__ import annotations

import io
import time
import warnings
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from math import exp, log
from pathlib import Path
from statistics import median, quantiles
from typing import Any, NamedTuple

import installed  # noqa: F401

import click
import numpy as np
from bench import load_all
from measured import DATA, origin, print_table, write_rows

import hapfmt
from hapfmt.errors import DataWarning
from hapfmt.metrics import snr_hf_db, snr_weighted_db, spqi, st_sim

NO_TEXTURE = {"preset": "perceptual", "texture": False}
SETTINGS: dict[str, dict[str, Any]] = {
    "lossless": {},
    "near-lossless": {"preset": "near-lossless"},
    "near-lossless --max-error 1%": {"preset": "near-lossless", "max_error": "1%"},
    "perceptual": {"preset": "perceptual"},
    "perceptual --snr 20": {"preset": "perceptual", "snr": 20},
    "perceptual --no-texture": NO_TEXTURE,
    "perceptual --no-texture --felt all": {**NO_TEXTURE, "felt": "all"},
    "paper": {"preset": "paper"},
}
"""Where no channel is felt, options of perceptual do nothing: such a file is near-lossless."""

FOAM = "teleop1dof/question1a_foam"
NAMED = (FOAM, "shock51k/Test_001")

WEIGHTED_DB, WEIGHTINGS = 15.0, (0.0, 0.25, 0.5)
"""A torque of FOAM, coded with each weighting."""

TEXTURES = (
    ("biotac_slide/mat1_3_pac", "pac"),
    (FOAM, "tau_human"),
    ("smartwheel/smartwheel", "Fx"),
)
"""Recordings and channels whose texture is measured at one quality."""

QUALITY_DB = 20.0

LADDER: dict[str, dict[str, Any]] = {
    "--quality low": {"quality": "low"},
    "--quality medium": {"quality": "medium"},
    "--quality high": {"quality": "high"},
    "--snr 10": {"snr": 10},
    "--snr 20": {"snr": 20},
    "--st-sim 0.9": {"st_sim": 0.9},
    "--st-sim 0.95": {"st_sim": 0.95},
}
"""Qualities of the texture that are compared."""

SIMILAR_S = 30
"""ST-SIM is measured on the first seconds."""


class Result(NamedTuple):
    ratio: float
    percent: float
    """The largest error of a channel, in % of its range."""

    cpu_s: float


def written(
    recording: hapfmt.Recording, given: dict[str, Any]
) -> tuple[hapfmt.writing.writer.Summary, bytes, float]:
    stream, began = io.BytesIO(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # no channel is felt
        try:
            summary = hapfmt.write(recording, stream, canonical=1, threads=1, **given)
        except hapfmt.ParameterError as error:
            if "would do nothing" not in str(error):
                raise
            summary = hapfmt.write(recording, stream, canonical=1, threads=1, preset="perceptual")
    return summary, stream.getvalue(), time.process_time() - began


def measure(recording: hapfmt.Recording, given: dict[str, Any]) -> Result:
    summary, data, cpu = written(recording, given)
    worst = 0.0
    decoded = hapfmt.read(data).channels
    for channel, back, decision in zip(recording.channels, decoded, summary.decisions, strict=True):
        x, y = channel.samples(), back.samples()
        finite = np.isfinite(x)
        if not finite.any() or x.size != y.size:
            continue
        error = float(np.abs(x - y)[finite].max())
        if abs(error - decision.largest_error) > 1e-6 * decision.largest_error + 1e-300:
            raise AssertionError(f"{channel.label}: reported {decision.largest_error}, is {error}")
        extent = float(np.ptp(x[finite]))
        worst = max(worst, 100 * error / extent if extent else 0.0)
    return Result(8 * recording.sample_count / len(data), worst, cpu)


def texture(recording: hapfmt.Recording, label: str) -> tuple[float, float, float, float]:
    """Bits a sample and SNR of one channel: of preset perceptual, and of knots with a quantised
    residual whose step gives the same SNR."""
    channel = recording.channel(label)
    alone = hapfmt.Recording((channel,))
    rate = float(channel.rate_exact)

    def coded(**given: Any) -> tuple[float, float]:
        summary, data, _ = written(alone, given)
        y = hapfmt.read(data).channels[0].samples()
        bits = 8 * summary.payload_size / summary.sample_count
        return bits, snr_hf_db(channel.samples(), y, rate)

    ours = coded(preset="perceptual", felt="all", snr=QUALITY_DB)
    extent = float(np.ptp(channel.samples()))
    low, high = 1e-5 * extent, extent
    for _ in range(12):
        step = (low * high) ** 0.5
        _, snr = coded(preset="paper", step=step, floor="0.2%", tolerance="0.005%", smallest=False)
        low, high = (step, high) if snr > QUALITY_DB else (low, step)
    knots = {"floor": "0.2%", "tolerance": "0.005%", "smallest": False}
    return *ours, *coded(preset="paper", step=low, **knots)


def weighted(recording: hapfmt.Recording) -> Iterator[list[str]]:
    """Bytes, weighted SNR and SPQI of a torque with each weighting."""
    channel = recording.channel("tau_human")
    alone, x = hapfmt.Recording((channel,)), channel.samples()
    for gamma in WEIGHTINGS:
        given = {"preset": "perceptual", "snr": WEIGHTED_DB, "texture_codec": "MDCT"}
        _, data, _ = written(alone, {**given, "weighting": gamma})
        y = hapfmt.read(data).channels[0].samples()
        snr = snr_weighted_db(x, y, channel.rate_exact)
        yield [
            f"{gamma:g}", f"{len(data)}", f"{snr:.1f}", f"{spqi(x, y, channel.rate_exact):.2f}"
        ]  # fmt: skip


def ladder(recordings: dict[str, hapfmt.Recording]) -> Iterator[list[str]]:
    """Rows of the textures that have a quality in the lowest one: the mean of their bits per
    sample, median and least SNR, median and worst tenth of ST-SIM, seconds, how many."""
    textured: dict[str, list[int]] = {}
    for name, given in LADDER.items():
        bits, ratios, alike, seconds = [], [], [], 0.0
        for file, recording in recordings.items():
            summary, data, cpu = written(recording, {"preset": "perceptual", **given})
            seconds += cpu
            decoded = hapfmt.read(data)
            places = textured.setdefault(
                file, [each.channel for each in summary.decisions if each.snr_hf_db is not None]
            )
            for place in places:
                x, y = recording.channels[place], decoded.channels[place]
                each = summary.decisions[place]
                rows = longest_run(x)
                f, g = x.samples()[rows], y.samples()[rows]
                bits.append(8 * each.size / each.sample_count)
                ratios.append(snr_hf_db(f, g, x.rate))
                some = slice(0, round(SIMILAR_S * x.rate))
                with suppress(hapfmt.ParameterError):  # too short
                    alike.append(st_sim(f[some], g[some], x.rate_exact))
        mean = exp(sum(map(log, bits)) / len(bits))
        enough = len(alike) > 1
        middle = (median(alike), quantiles(alike, n=10)[0]) if enough else ()
        alikeness = [f"{each:.3f}" for each in middle] or ["-", "-"]
        yield [
            f"`{name}`", f"{mean:.2f}", f"{median(ratios):.1f}", f"{min(ratios):.1f}", *alikeness,
            f"{seconds:.0f}", f"{len(ratios)}",
        ]  # fmt: skip


def longest_run(channel: hapfmt.Channel) -> slice:
    at, best = 0, slice(0, 0)
    for span in channel.coverage:
        if span.ticks > best.stop - best.start:
            best = slice(at, at + span.ticks)
        at += span.ticks
    return best


@click.command(help=__doc__)
@click.argument("data", type=click.Path(exists=True, path_type=Path), default=DATA)
@click.option("--only", default="", help="Recordings whose name contains this.")
@click.option("--write", is_flag=True, help="Put the tables into docs/presets.md.")
def main(data: Path, only: str, write: bool) -> None:
    recordings = dict(load_all(data, only, None))
    if not recordings:
        raise click.ClickException(f"{data} holds no recordings")
    print(f"# Presets over {len(recordings)} recordings\n\n{origin()}\n")
    shown: list[list[str]] = []
    found: dict[str, dict[str, Result]] = {}
    for name, given in SETTINGS.items():
        rows = {file: measure(recording, given) for file, recording in recordings.items()}
        found[name] = rows
        mean = exp(sum(log(row.ratio) for row in rows.values()) / len(rows))
        errors = [row.percent for row in rows.values()]
        cpu = sum(row.cpu_s for row in rows.values())
        ratio = [f"{rows[file].ratio:.1f}" for file in rows if file.endswith(FOAM)]
        errors_shown = [f"{each:.2g}" for each in (max(errors), median(errors))]
        shown.append([f"`{name}`", f"{mean:.1f}", *errors_shown, *(ratio or ["-"]), f"{cpu:.1f}"])
        click.echo(f"{name} ...", err=True)
    error = "largest error, % of range: all files"
    print_table(["setting", "ratio", error, "median file", "ratio of foam", "CPU s"], shown)
    if write:
        write_rows("presets", [row[:-1] for row in shown])
    larger = [
        f"{file}, {name}"
        for name, rows in found.items()
        for file, row in rows.items()
        if row.ratio < found["lossless"][file].ratio
    ]
    print(f"\nLossy files larger than the lossless one: {', '.join(larger) or 'none'}.")
    print(
        "\n| recording | lossless | near-lossless 0.1 % | 1 % | perceptual |\n|---|---|---|---|---|"
    )
    for file in recordings:
        if file.endswith(NAMED):
            ratios = [found[name][file].ratio for name in list(SETTINGS)[:4]]
            print(f"| {file} | " + " | ".join(f"{ratio:.1f}" for ratio in ratios) + " |")
    if find_spec("vibromaf") is not None:
        lines = list(ladder(recordings))
        headers = ["quality", "bits/sample, geometric mean", "SNR, dB, median", "SNR, dB, least"]
        similar = ["ST-SIM, median", "ST-SIM, worst tenth", "CPU s", "textures"]
        print_table([*headers, *similar], lines)
        if write:
            write_rows("textures", [[*row[:3], *row[4:6]] for row in lines])
        for file, recording in recordings.items():
            if file.endswith(FOAM):
                lines = list(weighted(recording))
                print_table(["weighting", "bytes", "weighted SNR, dB", "SPQI"], lines)
                if write:
                    write_rows("weighting", lines)
    print(
        f"\nTexture at {QUALITY_DB:g} dB, bits a sample (SNR): preset perceptual, and knots with a "
        "quantised residual\n\n| channel | perceptual | knots + QUAN |\n|---|---|---|"
    )
    for file, recording in recordings.items():
        for name, label in TEXTURES:
            if file.endswith(name):
                ours, snr, theirs, other = texture(recording, label)
                print(f"| {file}, {label} | {ours:.2f} ({snr:.1f}) | {theirs:.2f} ({other:.1f}) |")


if __name__ == "__main__":
    main()
