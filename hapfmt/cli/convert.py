"""hapfmt convert"""

from __future__ import annotations

import click

from ..errors import ParameterError
from .common import (
    HAPF,
    force_option,
    load_recording,
    output_of,
    save_recording,
    suffix_of,
    tell_notes,
)


@click.command(short_help="From any format to any other.")
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option("--rate", help="Ticks per second, for inputs that do not say: 1000, 44100/7.")
@click.option("--from", "from_", help="Format of the input, for a pipe.")
@click.option("--to", "to", help="Format of the output, for a pipe.")
@force_option
def convert(
    source: str, target: str, rate: str | None, from_: str | None, to: str | None, force: bool
) -> int:
    """Convert IN to OUT by their suffixes: .npz .npy .csv .wav .hapf.

    To .hapf it encodes with the default preset (encode has the options). What the output format
    cannot hold is said on standard error.
    """
    if suffix_of(source, from_) == suffix_of(target, to) == HAPF:
        raise ParameterError("both are .hapf: copy the file, or encode it anew with encode")
    recording, code = load_recording(source, from_, rate)
    tell_notes(recording)
    if suffix_of(target, to) == HAPF:
        from ..writer import write

        write(recording, output_of(target), force=force)
    else:
        save_recording(recording, target, to, force)
    return code
