"""hapfmt recover: writes everything readable of a damaged file to an intact file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from ..errors import ParameterError
from .common import (
    FileIdType,
    echo_json,
    file_id_option,
    force_option,
    input_of,
    json_option,
    memory_option,
    output_of,
    progress,
    refuse_idle,
    refuse_target,
    tell_some,
    verbose_option,
)
from .screen import Verb, complain, say

if TYPE_CHECKING:
    from ..edit.recover import Recovery
    from ..limits import Limits


@click.command(cls=Verb)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="[OUT]", required=False)
@click.option(
    "--in-place", is_flag=True, help="Mend IN itself. Keep IN.damaged unless only its end changes."
)
@click.option(
    "--canonical",
    type=FileIdType(),
    metavar="ID",
    help="File id of canonical mode: the same input gives the same bytes.",
)
@file_id_option
@memory_option
@force_option
@verbose_option
@json_option
def recover(
    source: str,
    target: str | None,
    in_place: bool,
    canonical: int | None,
    file_id: int | None,
    force: bool,
    verbose: bool,
    as_json: bool,
    max_memory: Limits,
) -> int:
    """Write everything readable in IN to OUT, an intact file.

    Packets are copied bit for bit. Lost samples stay gaps. The losses are printed, and noted in the
    metadata of OUT. The exit code is 0 if nothing was lost.

    \b
    hapfmt recover broken.hapf whole.hapf
    hapfmt recover --in-place crashed.hapf
    """
    if target is not None and in_place:
        raise ParameterError("Give OUT or --in-place, not both")
    if target is None and not in_place:
        raise ParameterError("Give OUT, the file to write, or --in-place")
    if target is None:
        refuse_idle("requires OUT", force=force)
        from ..edit.recover import recover_in_place

        with progress("recovering") as advance:
            done = recover_in_place(
                source,
                canonical=canonical,
                file_id=file_id,
                limits=max_memory,
                progress=advance,
            )
    else:
        from ..edit.recover import recover as recover_file

        refuse_target(target, force)
        with progress("recovering") as advance:
            done = recover_file(
                input_of(source),
                output_of(target),
                canonical=canonical,
                file_id=file_id,
                force=force,
                limits=max_memory,
                progress=advance,
            )
    if as_json and target != "-":
        echo_json(done.as_json())
    else:
        show(source, target or source, done, verbose=verbose)
    return done.exit_code


def show(source: str, target: str, done: Recovery, *, verbose: bool) -> None:
    if verbose:
        tell_some([str(finding) for finding in done.findings])
    tell_some([f"{source}: {line}" for line in done.summary])
    if done.kept_as:
        complain(f"the damaged file is now {done.kept_as}")
    say(f"{target}: {done.headline()}", err=target == "-")
