"""hapfmt attach: attaches files to a .hapf file in place."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import click

from ..errors import ParameterError
from .common import (
    echo_json,
    force_option,
    input_of,
    json_option,
    output_of,
    output_option,
    refuse_idle,
    refuse_target,
    tell_added,
)
from .screen import Verb, say, table

if TYPE_CHECKING:
    from ..edit import Original


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@click.argument("paths", metavar="[PATH]...", nargs=-1)
@click.option("--name", help="Name of the attachment, for one PATH. [its own]")
@click.option("--media-type", help="Media type, such as text/plain or image/png. [by name]")
@click.option("--list", "list_", is_flag=True, help="List the attachments.")
@click.option(
    "--extract", is_flag=True, help="Write the attachments named PATH into a folder. [all]"
)
@output_option(
    "PATH", "Leave FILE as it is and write a copy; with --extract: the folder to extract into [.]."
)
@force_option
@json_option
def attach(
    file: str,
    paths: tuple[str, ...],
    name: str | None,
    media_type: str | None,
    list_: bool,
    extract: bool,
    output: str | None,
    force: bool,
    as_json: bool,
) -> int:
    """Attach the files PATH to the .hapf file FILE, in place. Its other contents do not change.

    \b
    hapfmt attach touch.hapf photo.png calibration.pdf
    hapfmt attach touch.hapf --list
    hapfmt attach touch.hapf --extract photo.png --output photos
    """
    from .. import edit

    if list_:
        refuse_idle("does not go with --list", extract=extract, output=output)
        if paths:
            raise ParameterError("--list takes no PATH")
    if list_ or extract:
        refuse_idle("is for files to attach", name=name, media_type=media_type)
    if output is None and not extract:
        refuse_idle("requires --output or --extract", force=force)
    if list_:
        with edit.Original(input_of(file), scan=False) as original:
            show(original, as_json)
        return 0
    if extract:
        written = edit.extract(input_of(file), paths or None, output or ".", force=force)
        if as_json:
            echo_json({"files": [os.fspath(path) for path in written]})
        for path in () if as_json else written:
            say(os.fspath(path))
        return 0
    if not paths:
        raise ParameterError("Give files to attach, --list or --extract")
    if name is not None and len(paths) != 1:
        raise ParameterError("--name requires exactly one file")
    attachments = [edit.attachment_of(path, name=name, media_type=media_type) for path in paths]
    if output is not None:
        refuse_target(output, force)
    given = input_of(file) if output is not None else file
    notes = edit.attach(given, attachments, output and output_of(output), force=force)
    names = ", ".join(attachment.name for attachment in attachments)
    tell_added(output or file, f"attached {names}", notes, as_json)
    return 0


def show(original: Original, as_json: bool) -> None:
    known = original.attachments
    if as_json:
        echo_json(
            {
                "attachments": [
                    {"name": name, "media_type": a.media_type, "size": len(a.content)}
                    for name, a in known.items()
                ]
            }
        )
    elif known:
        rows = [[name, a.media_type, str(len(a.content))] for name, a in known.items()]
        table(["name", "media type", "bytes"], rows)
