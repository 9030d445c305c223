"""hapfmt encode"""

from __future__ import annotations

import time
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Literal

import click

from ..errors import ParameterError
from ..names import channels_called
from .common import (
    HAPF,
    AmountType,
    BitsType,
    FileIdType,
    FractionType,
    PresetType,
    ShareType,
    echo_json,
    force_option,
    input_format_option,
    json_option,
    labels_option,
    load_recording,
    memory_option,
    output_of,
    progress,
    refuse_target,
    suffix_of,
    tell_notes,
    threads_option,
    transpose_option,
    unit_option,
)
from .help import Verb
from .screen import note

if TYPE_CHECKING:
    from ..limits import Limits
    from ..recording import Recording
    from ..writing.writer import Summary

AXES = ("x", "y", "z", "rx", "ry", "rz")


@click.command(cls=Verb)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option(
    "--preset",
    type=PresetType(["lossless", "near-lossless", "perceptual", "paper"]),
    default="lossless",
    show_default=True,
    help="lossless: every bit as it was recorded. "
    "near-lossless: no sample is further off than --max-error. "
    "perceptual: leaves out what cannot be felt. Forces, torques, pressures, accelerations and "
    "velocities keep Weber's deadband in the slow part, and their texture to --snr; all other "
    "channels are near-lossless; clocks, counters and states are lossless. "
    "paper: the method of Brandi, Chaudhari and Steinbach. Their online deadband of the whole "
    "signal is: --bits 0 --interpolation hold, with a --cutoff above half the rate.",
)
@click.option(
    "--max-error",
    type=AmountType(),
    metavar="AMOUNT",
    help="near-lossless, perceptual: largest error in all: 0.1% of the channel's range, 0.01 in "
    "its unit, 10mN, 2lsb [0.1%].",
)
@click.option(
    "--fast",
    is_flag=True,
    default=None,
    help="lossless: integer channels encode up to nine times as fast, files are larger.",
)
@click.option(
    "--k", "k", type=ShareType(), help="perceptual, paper: Weber fraction of the deadband [10%]."
)
@click.option(
    "--floor",
    type=AmountType(),
    metavar="AMOUNT",
    help="perceptual, paper: absolute threshold of the deadband [0.2% of the range; paper: 10mN "
    "for forces].",
)
@click.option(
    "--felt",
    multiple=True,
    metavar="CHANNEL|all",
    help="perceptual: a channel that is felt too, by label or number; or all. May be repeated.",
)
@click.option(
    "--no-texture",
    "texture",
    flag_value=False,
    default=None,
    help="perceptual: keep the deadband alone.",
)
@click.option(
    "--snr",
    type=float,
    metavar="DB",
    help="perceptual: quality of the texture, its power over that of the error [20, or errors "
    "below --floor].",
)
@click.option(
    "--bits",
    type=BitsType(),
    help="paper: bits of the residual's quantiser, 2 to 16, step from its range; 0: no residual "
    "[5].",
)
@click.option("--step", type=AmountType(), metavar="AMOUNT", help="paper: step of the residual.")
@click.option(
    "--cutoff",
    "cutoff_hz",
    type=float,
    help="perceptual, paper: split between slow part and texture, Hz [20].",
)
@click.option(
    "--cluster",
    type=FractionType(),
    help="Length of a cluster in seconds [10; up to 120 at slow rates].",
)
@click.option(
    "--tolerance",
    type=AmountType(),
    metavar="AMOUNT",
    help="For experts: how far the grid of floating point channels may be from the values, within "
    "the error that the preset allows.",
)
@click.option(
    "--interpolation",
    type=click.Choice(["linear", "hold"]),
    help="paper: how knots are joined [linear].",
)
@click.option(
    "--vector",
    "vectors",
    multiple=True,
    metavar="X,Y[,Z]",
    help="perceptual --no-texture, paper: channels that are the axes of one vector, by label or "
    "number: one deadband on their norm. May be given several times.",
)
@click.option(
    "--references/--no-references",
    default=None,
    help="All but paper: channels that resemble each other may share a track and be predicted "
    "from each other; a lost packet then takes all of them along [on].",
)
@click.option("--digest", is_flag=True, help="Store the SHA-256 of every decoded track.")
@click.option("--rate", help="Ticks per second, for inputs that do not say: 1000, 44100/7.")
@transpose_option
@labels_option
@unit_option
@input_format_option
@click.option(
    "--canonical",
    type=FileIdType(content=True),
    metavar="ID",
    help="The same input gives the same bytes. ID replaces the random file id: a number, or "
    '"content" to take it from what is encoded.',
)
@click.option("-v", "--verbose", is_flag=True, help="Say how each channel was coded, and why.")
@threads_option
@memory_option
@force_option
@json_option
def encode(
    source: str,
    target: str,
    preset: str,
    rate: str | None,
    transpose: bool | None,
    labels: str | None,
    unit: str | None,
    input_format: str | None,
    canonical: int | Literal["content"] | None,
    force: bool,
    as_json: bool,
    threads: int | None,
    max_memory: Limits,
    verbose: bool,
    vectors: tuple[str, ...],
    **given: Any,
) -> int:
    """Encode the recording IN (.npz .npy .csv .wav .hapf) into OUT.

    \b
    hapfmt encode touch.npz touch.hapf
    hapfmt encode touch.csv touch.hapf --preset paper --k 0.1 --bits 5
    hapfmt encode f.npy f.hapf --rate 1000 --preset near-lossless --max-error 1%
    cat touch.npz | hapfmt encode - - --input-format npz > touch.hapf
    """
    from ..encoder.settings import Settings, lossy_preset, renamed
    from ..writing.writer import write

    refuse_target(target, force)
    if target != "-" and suffix_of(target, None) != HAPF:
        note(f"{target} will be a hapf file; the usual suffix is {HAPF}")
    given["vectors"] = "required" if vectors else None
    given["felt"] = given["felt"] or None
    preset, given = renamed(preset, given)
    settings = Settings.of(preset, **given)
    recording, code = load_recording(
        source, input_format, rate, max_memory, transpose=transpose, labels=labels, unit=unit
    )
    tell_notes(recording)
    if earlier := lossy_preset(recording.metadata.get("encoder")):
        note(f"the input is already lossy ({earlier}); error bounds count from it")
    for place, names in enumerate(vectors):
        recording = with_vector(recording, names.split(","), f"vector {place + 1}")
    began = time.perf_counter()
    with progress("encoding") as advance:
        summary = write(
            recording,
            output_of(target),
            settings,
            canonical=canonical,
            force=force,
            progress=advance,
            threads=threads,
        )
    seconds = time.perf_counter() - began
    if as_json and target != "-":
        echo_json(summary_json(summary, recording.duration, seconds))
    elif target != "-":
        from .encoded import show

        show(summary, target, seconds, recording, verbose=verbose)
    return code


def with_vector(recording: Recording, names: list[str], group: str) -> Recording:
    """The recording with these channels as the axes x, y, z ... of one group."""
    channels = list(recording.channels)
    labels = [channel.label for channel in channels]
    places = channels_called(names, dict(enumerate(labels)))
    if not 2 <= len(places) <= len(AXES):
        raise ParameterError(f"a vector has 2 to {len(AXES)} axes: {','.join(names)}")
    if places != list(range(places[0], places[0] + len(places))):
        raise ParameterError(
            f"the axes of a vector must be neighbours in the recording, in order: "
            f"{','.join(names)} are channels {places}"
        )
    for place, axis in zip(places, AXES, strict=False):
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
