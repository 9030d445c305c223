"""hapfmt merge: puts the channels of several .hapf files into one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from ..errors import ParameterError
from .common import (
    by_epoch_option,
    canonical_option,
    force_option,
    json_option,
    memory_option,
    offsets_of,
    originals,
    output_of,
    progress,
    refuse_idle,
    refuse_target,
    same_times_option,
    tell,
)
from .concat import times_of
from .screen import Verb

if TYPE_CHECKING:
    from ..limits import Limits


@click.command(cls=Verb)
@click.argument("sources", metavar="IN...", nargs=-1, required=True)
@click.argument("target", metavar="OUT")
@by_epoch_option
@same_times_option
@click.option(
    "--offset",
    "offsets",
    multiple=True,
    metavar="IN=S",
    help="Start of IN in seconds, a whole number of its ticks; repeatable. [0]",
)
@click.option(
    "--prefix",
    "prefixes",
    multiple=True,
    metavar="TEXT",
    help="Prefix of the labels of a file's channels; give one for each file, in order.",
)
@canonical_option
@memory_option
@force_option
@json_option
def merge(
    sources: tuple[str, ...],
    target: str,
    by_epoch: bool,
    same_times: bool,
    offsets: tuple[str, ...],
    prefixes: tuple[str, ...],
    canonical: int | None,
    force: bool,
    as_json: bool,
    max_memory: Limits,
) -> int:
    """Put the channels of the .hapf files IN into one file OUT. Packets are copied bit for bit.

    Files of one recording, or with the same epoch, share their time line. Other files need an
    option that relates their times.

    \b
    hapfmt merge force.hapf skin.hapf both.hapf --by-epoch
    hapfmt merge l.hapf r.hapf both.hapf --same-times --prefix l/ --prefix r/
    """
    from .. import edit

    refuse_target(target, force)
    if prefixes and len(prefixes) != len(sources):
        raise ParameterError("Give one --prefix for each file (it may be empty)")
    if len(sources) == 1:
        refuse_idle("requires two files or more", by_epoch=by_epoch, same_times=same_times)
    times, given = times_of(by_epoch, same_times), offsets_of(offsets, sources)
    with originals(sources, max_memory) as opened, progress("copying") as advance:
        edited = edit.merge(
            opened, output_of(target), times=times,
            offsets=given, prefixes=prefixes or None, canonical=canonical, force=force,
            progress=advance,
        )  # fmt: skip
    tell(edited, target, as_json)
    return 0
