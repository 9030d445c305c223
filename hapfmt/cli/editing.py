"""What the verbs that edit share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import click

from ..errors import ParameterError
from ..numbers import counted, exact
from .common import echo_json, input_of, output_option
from .screen import note, say

if TYPE_CHECKING:
    from ..edit import Edited, Original
    from ..limits import Limits

canonical_option = click.option(
    "--canonical",
    type=click.IntRange(0, (1 << 32) - 1),
    metavar="FILE_ID",
    help="The same input gives the same bytes; FILE_ID replaces the random file id.",
)
to_zero_option = click.option(
    "--to-zero",
    is_flag=True,
    help="Move the first packet to tick 0, or as near as whole ticks of every track allow. The "
    "epoch moves too.",
)
by_epoch_option = click.option(
    "--by-epoch", is_flag=True, help="Place each file by its epoch, to the nearest tick."
)
same_times_option = click.option(
    "--same-times", is_flag=True, help="Tick 0 of all files is the same moment."
)
copy_option = output_option("OUT", "Leave FILE as it is and write a copy with the addition.")


@contextmanager
def originals(names: Sequence[str], limits: Limits) -> Iterator[list[Original]]:
    """The files that are edited, open within the limits."""
    from ..edit import Original

    with ExitStack() as stack:
        yield [stack.enter_context(Original(input_of(name), limits=limits)) for name in names]


def tell(edited: Edited, target: str, as_json: bool) -> None:
    """What was written, and what not; nothing on standard output where the file goes there."""
    if target == "-":
        for each in edited.notes:
            note(each)
    elif as_json:
        echo_json(edited.as_json())
    else:
        show(edited)


def show(edited: Edited) -> None:
    say(f"{edited.file or '-'}: {line(edited)}")
    for each in edited.notes:
        note(each)


def line(edited: Edited) -> str:
    span = "no samples"
    if edited.start is not None and edited.stop is not None:
        span = f"{float(edited.start):.6g} s to {float(edited.stop):.6g} s"
    return (
        f"{edited.file_size} bytes, {counted(len(edited.channels), 'channel')}, {span}, "
        f"{counted(edited.packet_count, 'packet')}"
    )


def named(pairs: tuple[str, ...], files: tuple[str, ...]) -> dict[int, Any]:
    """FILE=SECONDS by the place of the file."""
    found: dict[int, Any] = {}
    for pair in pairs:
        name, equals, text = pair.rpartition("=")
        if not equals or files.count(name) != 1:
            raise ParameterError(
                f"Expected --offset IN=SECONDS with one of the input files, got {pair!r}"
            )
        found[files.index(name)] = exact(text)
    return found


def tell_added(file: str, what: str, notes: Sequence[str], as_json: bool) -> None:
    """What was appended to a file; nothing on standard output where the file goes there."""
    for each in notes:
        note(each)
    if file == "-":
        return
    if as_json:
        echo_json({"file": file, "notes": list(notes)})
    else:
        say(f"{file}: {what}")
