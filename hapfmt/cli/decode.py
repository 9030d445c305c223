"""hapfmt decode: decodes a .hapf file."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, cast

import click

from ..errors import ParameterError
from .common import (
    contents,
    echo_json,
    file_id_option,
    force_option,
    input_of,
    json_option,
    memory_option,
    output_format_option,
    parse_channels,
    progress,
    refuse_output,
    refuse_span,
    save_recording,
    start_option,
    stop_option,
    suffix_of,
    tell_losses,
    tell_written,
    threads_option,
)
from .screen import Verb, complain

if TYPE_CHECKING:
    from ..limits import Limits
    from ..reading.reader import Band


@click.command(cls=Verb)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option(
    "--channels",
    multiple=True,
    help="Labels or numbers: force_x,force_y or 0,3; may be given several times. [all]",
)
@start_option
@stop_option
@click.option(
    "--band",
    type=click.Choice(["full", "lf", "hf"]),
    default="full",
    show_default=True,
    help="The sum, the slow part, or the texture alone.",
)
@output_format_option()
@file_id_option
@threads_option
@memory_option
@force_option
@json_option
def decode(
    source: str,
    target: str,
    channels: tuple[str, ...],
    start: Fraction | None,
    stop: Fraction | None,
    band: str,
    output_format: str | None,
    file_id: int | None,
    force: bool,
    as_json: bool,
    threads: int | None,
    max_memory: Limits,
) -> int:
    """Decode the .hapf file IN into OUT: .npz, .npy, .csv, .wav and others, which hapfmt info
    --formats lists. Gaps become NaN.

    If the file is damaged, lost samples become gaps, the losses are printed, and the exit code
    is 3.

    \b
    hapfmt decode touch.hapf touch.npz
    hapfmt decode touch.hapf part.csv --channels force_z --start 1.5 --stop 2
    hapfmt decode - - --output-format csv < touch.hapf | head
    """
    from ..reading.reader import Reader
    from ..spool import Spool

    suffix_of(target, output_format)
    refuse_output(target, output_format, force)
    refuse_span(start, stop)
    with Reader(input_of(source), threads=threads, limits=max_memory, file_id=file_id) as reader:
        names = parse_channels(channels, [ref.label for ref in reader.channels])
        reader.check_band(names, cast("Band", band))
        with progress("decoding") as advance:
            recording = reader.read(
                names, start, stop, band=cast("Band", band), progress=advance, store=Spool()
            )
        nothing = (start is not None or stop is not None) and not recording.sample_count
        if (nothing and reader.lost) or (reader.findings and not reader.catalogue.tracks):
            nothing = True
            complain("No samples are left to decode; nothing is written")
        elif nothing:
            end = float(reader.duration)
            band_ = "" if band == "full" else f" of band {band}"
            raise ParameterError(
                f"No samples{band_} in this time range; the recording ends at {end:g} s",
                path=reader.source.path,
            )
        else:
            save_recording(recording, target, output_format, force, max_memory)
        code = tell_losses(reader)
        if as_json and target != "-":
            echo_json(
                {
                    "channel_count": len(recording),
                    "sample_count": recording.sample_count,
                    "duration_s": float(recording.duration),
                    "damage": reader.damage(names).as_json(),
                    "exit_code": code,
                }
            )
        elif not nothing:
            tell_written(target, contents(recording))
    return code
