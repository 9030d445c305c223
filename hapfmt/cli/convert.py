"""hapfmt convert: converts between file formats by suffix."""

from __future__ import annotations

from typing import Any

import click

from ..errors import ParameterError
from ..limits import Limits
from .common import (
    HAPF,
    contents,
    echo_json,
    force_option,
    fps_option,
    import_options,
    input_format_option,
    json_option,
    labels_option,
    memory_option,
    opened_input,
    output_format_option,
    output_of,
    progress,
    refuse_output,
    refuse_target,
    save_recording,
    suffix_of,
    tell_import,
    tell_no_report,
    tell_notes,
    tell_written,
    unit_option,
)
from .screen import Verb


@click.command(cls=Verb)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@import_options
@labels_option
@unit_option
@input_format_option
@output_format_option("hapf")
@click.option(
    "--schema",
    type=click.Choice(["ros2", "json"]),
    help="Messages of an .mcap output: those of ROS 2, or JSON. [ros2]",
)
@fps_option
@memory_option
@force_option
@json_option
def convert(
    source: str,
    target: str,
    labels: str | None,
    unit: str | None,
    input_format: str | None,
    output_format: str | None,
    schema: str | None,
    fps: str | None,
    force: bool,
    as_json: bool,
    max_memory: Limits,
    **given: Any,
) -> int:
    """Convert IN to OUT by their suffixes: .hapf, .npz, .csv, .wav, .mcap, .parquet, .h5, .mat and
    others. hapfmt info --formats lists all. --select also chooses channels of a .hapf file.

    A .hapf output is lossless (hapfmt encode has presets). If the output format cannot hold
    something, a note on standard error names it.

    \b
    hapfmt convert touch.csv touch.npz
    hapfmt convert touch.hapf touch.wav
    hapfmt convert lab.hapf joints.parquet --select 'joint*'
    """
    from ..encoder.settings import Settings
    from ..recording import Recording
    from ..writing.importing import write_import
    from ..writing.writer import write

    if suffix_of(source, input_format) == suffix_of(target, output_format) == HAPF:
        raise ParameterError("both are .hapf: copy the file, or use hapfmt encode")
    suffix = suffix_of(target, output_format)
    tell_no_report(target, {"--json": as_json})
    if suffix == HAPF:
        for name, value in (("schema", schema), ("fps", fps)):
            if value is not None:
                raise ParameterError(f".hapf files do not use {name}")
        refuse_target(target, force)
    else:
        refuse_output(target, output_format, force)
    with opened_input(
        source, input_format, max_memory, whole="" if suffix == HAPF else f"{suffix} output",
        labels=labels, unit=unit, **given,
    ) as (found, code):  # fmt: skip
        if isinstance(found, Recording):
            notes = tell_notes(found, suffix_of(source, input_format) == HAPF)
            if suffix == HAPF:
                with progress("encoding") as advance:
                    write(found, output_of(target), Settings(), force=force, progress=advance)
            else:
                save_recording(
                    found, target, output_format, force, max_memory, schema=schema, fps=fps
                )
            count, written = found.sample_count, contents(found)
        else:
            tell_import(found)
            with progress("encoding") as advance:
                summary = write_import(found, output_of(target), force=force, progress=advance)
            count, written = summary.sample_count, contents(found)
            notes = found.all_notes
    if as_json and target != "-":
        echo_json(
            {
                "channel_count": len(found.labels),
                "sample_count": count,
                "duration_s": float(found.duration),
                "notes": notes,
            }
        )
    else:
        tell_written(target, written)
    return code
