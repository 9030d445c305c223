"""hapfmt split: cuts a .hapf file into parts."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import click

from ..errors import ParameterError
from .common import (
    FractionType,
    canonical_option,
    echo_json,
    exact_option,
    force_option,
    fraction,
    json_option,
    memory_option,
    originals,
    progress,
    refuse_target,
    show,
    to_zero_option,
)
from .screen import Verb

if TYPE_CHECKING:
    from ..limits import Limits


@click.command(cls=Verb)
@click.argument("source", metavar="IN")
@click.option("--every", type=FractionType(), metavar="S", help="Length of each part, in seconds.")
@click.option("--at", metavar="T1,T2,...", help="Times in seconds at which a new part begins.")
@click.option(
    "-o",
    "--output",
    metavar="NAME",
    default="part-{:03d}.hapf",
    show_default=True,
    help="Name of the parts; {} is replaced by the number.",
)
@exact_option
@to_zero_option
@canonical_option
@memory_option
@force_option
@json_option
def split(
    source: str,
    every: Fraction | None,
    at: str | None,
    output: str,
    exact: bool,
    to_zero: bool,
    canonical: int | None,
    force: bool,
    as_json: bool,
    max_memory: Limits,
) -> int:
    """Cut the .hapf file IN into parts. Packets are copied bit for bit.

    A packet is kept whole, in the part in which it begins; --exact cuts at the sample. Every part
    has all channels, metadata and attachments. Parts keep their times, so concat joins them again.

    \b
    hapfmt split long.hapf --every 600 --output 'part-{:03d}.hapf'
    hapfmt split long.hapf --at 12.5,30
    """
    from .. import edit

    if output == "-":
        raise ParameterError("Give a file name with {} for the number of the part")
    refuse_target(output, force=True)
    times = [fraction(text) for text in at.split(",")] if at else []
    with originals([source], max_memory) as (original,), progress("copying") as advance:
        parts = edit.split(
            original, output, every=every, at=times, exact=exact, to_zero=to_zero,
            canonical=canonical, force=force, progress=advance,
        )  # fmt: skip
    if as_json:
        echo_json({"parts": [part.as_json() for part in parts]})
        return 0
    for part in parts:
        show(part)
    return 0
