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
    load_recording,
    memory_option,
    notes_of,
    output_format_option,
    output_of,
    progress,
    refuse_output,
    refuse_target,
    save_recording,
    suffix_of,
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
    fps: str | None,
    force: bool,
    as_json: bool,
    max_memory: Limits,
    **given: Any,
) -> int:
    """Convert IN to OUT by their suffixes: .npz .npy .csv .wav .hapf.

    A .hapf output is lossless (hapfmt encode has presets). If the output format cannot hold
    something, a note on standard error names it.

    \b
    hapfmt convert touch.csv touch.npz
    hapfmt convert touch.hapf touch.wav
    """
    if suffix_of(source, input_format) == suffix_of(target, output_format) == HAPF:
        raise ParameterError("both are .hapf: copy the file, or use hapfmt encode")
    if suffix_of(target, output_format) == HAPF:
        refuse_target(target, force)
        if fps is not None:
            raise ParameterError("--fps is for LeRobot datasets, not for .hapf")
    else:
        refuse_output(target, output_format, force)
    recording, code = load_recording(
        source, input_format, max_memory, labels=labels, unit=unit, **given
    )
    tell_notes(recording)
    if suffix_of(target, output_format) == HAPF:
        from ..encoder.settings import Settings
        from ..writing.writer import write

        with progress("encoding") as advance:
            write(recording, output_of(target), Settings(), force=force, progress=advance)
    else:
        save_recording(recording, target, output_format, force, max_memory, fps=fps)
    if as_json and target != "-":
        echo_json(
            {
                "channel_count": len(recording),
                "sample_count": recording.sample_count,
                "duration_s": float(recording.duration),
                "notes": notes_of(recording),
            }
        )
    else:
        tell_written(target, contents(recording))
    return code
