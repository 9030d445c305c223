"""hapfmt concat: joins .hapf files one after the other."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import click

from ..errors import ParameterError
from .common import (
    FractionType,
    by_epoch_option,
    canonical_option,
    force_option,
    json_option,
    memory_option,
    originals,
    output_of,
    progress,
    refuse_idle,
    refuse_target,
    same_times_option,
    tell,
)
from .screen import Verb

if TYPE_CHECKING:
    from ..edit import Times
    from ..limits import Limits


@click.command(cls=Verb)
@click.argument("sources", metavar="IN...", nargs=-1, required=True)
@click.argument("target", metavar="OUT")
@click.option(
    "--gap",
    type=FractionType(),
    metavar="S",
    help="Seconds between the end of a file and the start of the next.",
)
@by_epoch_option
@same_times_option
@canonical_option
@memory_option
@force_option
@json_option
def concat(
    sources: tuple[str, ...],
    target: str,
    gap: Fraction | None,
    by_epoch: bool,
    same_times: bool,
    canonical: int | None,
    force: bool,
    as_json: bool,
    max_memory: Limits,
) -> int:
    """Join the .hapf files IN, one after the other, into OUT. Packets are copied bit for bit.

    Channels are matched by label, or by number if labels are missing. Parts of one recording, as
    split makes them, keep their times. Otherwise each file begins where the previous one ends.

    \b
    hapfmt concat part-*.hapf whole.hapf
    hapfmt concat monday.hapf tuesday.hapf both.hapf --gap 1
    """
    from .. import edit

    refuse_target(target, force)
    if len(sources) == 1:
        refuse_idle("requires two files or more", gap=gap, by_epoch=by_epoch, same_times=same_times)
    times = times_of(by_epoch, same_times)
    with originals(sources, max_memory) as opened, progress("copying") as advance:
        edited = edit.concat(
            opened, output_of(target), times=times, gap=gap,
            canonical=canonical, force=force, progress=advance,
        )  # fmt: skip
    tell(edited, target, as_json)
    return 0


def times_of(by_epoch: bool, same_times: bool) -> Times | None:
    if by_epoch and same_times:
        raise ParameterError("Give --by-epoch or --same-times, not both")
    return "epoch" if by_epoch else "same" if same_times else None
