"""Presets compared over a folder of recordings: ratio, largest error, time. Prints Markdown.

python tools/presets.py [DATA]        a folder of recordings; without: ../shared/data

The ratio is that of the samples as float64 (8 bytes each) to the whole file, as the geometric mean
over the files. Every decoded sample is compared with the float64 of the recording; the error of a
channel is in % of its range. CPU seconds are of encoding alone.
"""

from __future__ import annotations

import io
import time
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
from measured import DATA, files_in, origin

import hapfmt
from hapfmt.convert.formats import read_suffixes
from hapfmt.metrics import snr_hf_db, st_sim

SETTINGS: dict[str, dict[str, Any]] = {
    "lossless": {},
    "near-lossless": {"preset": "near-lossless"},
    "near-lossless, 1 %": {"preset": "near-lossless", "max_error": "1%"},
    "perceptual": {"preset": "perceptual"},
    "perceptual, no texture": {"preset": "perceptual", "texture": False},
    "perceptual, no texture, all felt": {"preset": "perceptual", "texture": False, "felt": "all"},
    "paper": {"preset": "paper"},
}

NAMED = ("teleop1dof/question1a_foam", "shock51k/Test_001")

TEXTURES = (
    ("biotac_slide/mat1_3_pac", "pac"),
    ("teleop1dof/question1a_foam", "tau_human"),
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


def load_all(data: Path) -> Iterator[tuple[str, hapfmt.Recording]]:
    for path in files_in(data):
        if path.suffix.lower() in read_suffixes():
            yield str(path.relative_to(data).with_suffix("")), hapfmt.read(path)


def written(
    recording: hapfmt.Recording, given: dict[str, Any]
) -> tuple[hapfmt.writing.writer.Summary, bytes, float]:
    stream, began = io.BytesIO(), time.process_time()
    summary = hapfmt.write(recording, stream, hapfmt.Settings.of(**given), canonical=1, threads=1)
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


def ladder(recordings: dict[str, hapfmt.Recording]) -> Iterator[str]:
    """Rows: median SNR and ST-SIM of the textures that have one in the lowest quality, the mean of
    their bits per sample, and seconds."""
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
        middle = f"{median(alike):.3f} | {quantiles(alike, n=10)[0]:.3f}" if enough else "- | -"
        yield f"| `{name}` | {mean:.2f} | {median(ratios):.1f} | {middle} | {seconds:.0f} |"


def longest_run(channel: hapfmt.Channel) -> slice:
    at, best = 0, slice(0, 0)
    for span in channel.coverage:
        if span.ticks > best.stop - best.start:
            best = slice(at, at + span.ticks)
        at += span.ticks
    return best


@click.command(help=__doc__)
@click.argument("data", type=click.Path(exists=True, path_type=Path), default=DATA)
def main(data: Path) -> None:
    recordings = dict(load_all(data))
    if not recordings:
        raise click.ClickException(f"{data} holds no recordings")
    print(f"# Presets over {len(recordings)} recordings\n\n{origin()}\n")
    print("| setting | ratio | largest error, % of range: all / median of files | CPU s |")
    print("|---|---|---|---|")
    found: dict[str, dict[str, Result]] = {}
    for name, given in SETTINGS.items():
        rows = {file: measure(recording, given) for file, recording in recordings.items()}
        found[name] = rows
        mean = exp(sum(log(row.ratio) for row in rows.values()) / len(rows))
        errors = [row.percent for row in rows.values()]
        cpu = sum(row.cpu_s for row in rows.values())
        print(f"| {name} | {mean:.1f} | {max(errors):.3g} / {median(errors):.3g} | {cpu:.1f} |")
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
        print(
            "\nTextures: geometric mean of bits per sample; median of SNR (dB) and ST-SIM; ST-SIM "
            "of the worst tenth; CPU s\n\n| quality | bits/sample | SNR | ST-SIM | worst | CPU s |"
            "\n|---|---|---|---|---|---|"
        )
        for row in ladder(recordings):
            print(row)
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
