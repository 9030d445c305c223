"""hapfmt encode"""

from __future__ import annotations

import time
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import click

from ..errors import ParameterError
from .common import (
    AmountType,
    FractionType,
    echo_json,
    force_option,
    json_option,
    load_recording,
    output_of,
    parse_channels,
    printable,
    progress,
    table,
    tell_notes,
)

if TYPE_CHECKING:
    from ..recording import Recording
    from ..writer import Summary

AXES = ("x", "y", "z", "rx", "ry", "rz")
ORIGINAL_BITS = 64
"""Bits of a sample before encoding, as the paper counts: a double."""


@click.command(short_help="Encode a recording into a .hapf file.")
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option(
    "--preset",
    type=click.Choice(["default", "paper"]),
    default="default",
    show_default=True,
    help="default: every sample within its deadband, texture kept with an explicit step. "
    "paper: Brandi, Chaudhari and Steinbach to the letter.",
)
@click.option("--k", "k", type=FractionType(), help="Weber fraction of the deadband [0.1].")
@click.option(
    "--floor",
    type=AmountType(),
    help="Absolute floor of the deadband: 0.01 (in the unit), 2lsb, or 0.2% of the range "
    "[default: 0.2%; paper: 0.01].",
)
@click.option(
    "--bits",
    type=click.IntRange(0, 16),
    help="Bits of the residual's quantiser, step from its range; 0: no residual [paper: 5].",
)
@click.option(
    "--step", type=AmountType(), help="Step of the residual: 0.005, 1lsb, 0.1% [2 x floor]."
)
@click.option("--cutoff", "cutoff_hz", type=float, help="Split between slow and fast, Hz [20].")
@click.option("--cluster", type=FractionType(), help="Length of a cluster in seconds [10].")
@click.option(
    "--tolerance",
    type=AmountType(),
    help="Put true doubles on a lattice this close: 1e-6, 0.5lsb, 0.01%. Without it they are kept "
    "bit for bit, which costs 50 bits a sample.",
)
@click.option(
    "--interpolation", type=click.Choice(["linear", "hold"]), help="How knots are joined [linear]."
)
@click.option(
    "--vector",
    "vectors",
    multiple=True,
    metavar="X,Y[,Z]",
    help="Channels that are the axes of one vector, by label or number: one deadband on their "
    "norm, one knot clock. May be given several times.",
)
@click.option("--digest", is_flag=True, help="Store the SHA-256 of every decoded track.")
@click.option("--rate", help="Ticks per second, for inputs that do not say: 1000, 44100/7.")
@click.option("--from", "format_", help="Format of the input, for a pipe: npz npy csv wav hapf.")
@click.option(
    "--canonical",
    type=click.IntRange(0, (1 << 32) - 1),
    metavar="FILE_ID",
    help="The same input gives the same bytes; FILE_ID stands for the random file id.",
)
@force_option
@json_option
def encode(
    source: str,
    target: str,
    preset: str,
    rate: str | None,
    format_: str | None,
    canonical: int | None,
    force: bool,
    as_json: bool,
    vectors: tuple[str, ...],
    **given: Any,
) -> int:
    """Encode the recording IN (.npz .npy .csv .wav .hapf) into OUT.

    \b
    hapfmt encode touch.npz touch.hapf
    hapfmt encode touch.csv touch.hapf --preset paper --k 0.1 --bits 5
    hapfmt encode force.npy force.hapf --rate 1000 --tolerance 0.01%
    cat touch.npz | hapfmt encode - - --from npz > touch.hapf
    """
    from ..encoder.settings import Settings
    from ..writer import write

    settings = Settings.of(preset, **{k: v for k, v in given.items() if v is not None})
    recording, code = load_recording(source, format_, rate)
    tell_notes(recording)
    for place, names in enumerate(vectors):
        recording = with_vector(recording, parse_channels(names) or [], f"vector {place + 1}")
    began = time.perf_counter()
    with progress("encoding") as advance:
        summary = write(
            recording,
            output_of(target),
            settings,
            canonical=canonical,
            force=force,
            progress=advance,
        )
    seconds = time.perf_counter() - began
    if as_json and target != "-":
        echo_json(summary_json(summary, recording.duration, seconds))
    elif target != "-":
        show(summary, target, seconds)
    return code


def with_vector(recording: Recording, names: list[str | int], group: str) -> Recording:
    """The recording with these channels as the axes x, y, z ... of one group."""
    channels = list(recording.channels)
    labels = [channel.label for channel in channels]
    if not 2 <= len(names) <= len(AXES):
        raise ParameterError(f"a vector has 2 to {len(AXES)} axes: {names}")
    for name, axis in zip(names, AXES, strict=False):
        place = labels.index(name) if name in labels else name
        if not isinstance(place, int) or place >= len(channels):
            raise ParameterError(f"no channel {name!r}; there are: {', '.join(labels)}")
        channels[place] = replace(channels[place], group=group, axis=axis)
    return replace(recording, channels=tuple(channels))


def summary_json(summary: Summary, duration: Fraction, seconds: float) -> dict[str, Any]:
    return {
        "file_size": summary.file_size,
        "payload_size": summary.payload_size,
        "sample_count": summary.sample_count,
        "duration_s": float(duration),
        "encode_s": seconds,
        "channels": [decision.as_json() for decision in summary.decisions],
    }


def show(summary: Summary, target: str, seconds: float) -> None:
    rows = [
        [
            str(d.channel),
            d.label,
            str(d.sample_count),
            f"{8 * d.size / d.sample_count:.3f}" if d.sample_count else "-",
            "yes" if d.guaranteed else "no",
            f"{d.chosen}: {d.reason}",
            d.lattice,
        ]
        for d in summary.decisions
    ]
    headers = ["channel", "label", "samples", "b/sample", "within", "coded as", "values"]
    table(headers, rows)
    samples = summary.sample_count
    if samples:
        bits = 8 * summary.file_size / samples
        click.echo(
            f"{printable(target)}: {summary.file_size} bytes for {samples} samples, "
            f"{bits:.3f} bits a sample with everything, {ORIGINAL_BITS / bits:.1f} times smaller "
            f"than doubles, in {seconds:.2f} s"
        )
    raw = [d for d in summary.decisions if d.chosen == "raw"]
    if raw:
        click.echo(
            f"{len(raw)} of {len(summary.decisions)} channels are true doubles and were kept bit "
            "for bit; --tolerance 0.01% puts them on a lattice, if that error is no loss to you"
        )
