"""hapfmt subset: writes a part of a .hapf file."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, cast

import click

from .common import (
    canonical_option,
    exact_option,
    force_option,
    input_of,
    json_option,
    memory_option,
    output_of,
    parse_channels,
    progress,
    refuse_span,
    refuse_target,
    start_option,
    stop_option,
    tell,
    to_zero_option,
)
from .screen import Verb

if TYPE_CHECKING:
    from ..limits import Limits
    from ..reading.reader import Band


@click.command(cls=Verb)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option(
    "--channels",
    multiple=True,
    help="Labels or numbers: force_x,force_y or 0,3; repeatable. [all]",
)
@start_option
@stop_option
@click.option(
    "--band",
    type=click.Choice(["full", "lf", "hf"]),
    default="full",
    show_default=True,
    help="Keep all, the slow part, or the texture of each channel.",
)
@exact_option
@to_zero_option
@click.option("--level", type=click.Choice(["1", "2"]), help="Lowest level of OUT. [level of IN]")
@canonical_option
@memory_option
@force_option
@json_option
def subset(
    source: str,
    target: str,
    channels: tuple[str, ...],
    start: Fraction | None,
    stop: Fraction | None,
    band: str,
    exact: bool,
    to_zero: bool,
    level: str | None,
    canonical: int | None,
    force: bool,
    as_json: bool,
    max_memory: Limits,
) -> int:
    """Write a part of the .hapf file IN into the .hapf file OUT. Packets are copied bit for bit.

    A packet that overlaps the time range is kept whole. So OUT may begin earlier and end later than
    you asked; the output prints both. --exact cuts at the sample. The samples keep their times.

    \b
    hapfmt subset long.hapf part.hapf --channels force_z --start 10 --stop 20
    hapfmt subset long.hapf slow.hapf --band lf
    """
    from .. import edit

    refuse_target(target, force)
    refuse_span(start, stop)
    whole = start is None and stop is None
    opened = edit.Original(input_of(source), scan=whole, limits=max_memory)
    with opened as original, progress("copying") as advance:
        edited = edit.subset(
            original, output_of(target), parse_channels(channels, list(original.labels.values())),
            start, stop, band=cast("Band", band), exact=exact, to_zero=to_zero,
            level=int(level) if level else None, canonical=canonical, force=force, progress=advance,
        )  # fmt: skip
    tell(edited, target, as_json)
    return 0
