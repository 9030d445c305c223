"""hapfmt meta: sets or prints the metadata of a .hapf file."""

from __future__ import annotations

import json
from typing import Any

import click

from ..errors import ParameterError
from .common import (
    copy_option,
    echo_json,
    force_option,
    input_of,
    json_option,
    output_of,
    refuse_idle,
    refuse_target,
    tell_added,
)
from .screen import Verb, say


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@click.argument("members", metavar="[KEY=VALUE]...", nargs=-1)
@copy_option
@force_option
@json_option
def meta(
    file: str, members: tuple[str, ...], output: str | None, force: bool, as_json: bool
) -> int:
    """Set metadata of the .hapf file FILE, in place. Without KEY=VALUE, print all metadata.

    VALUE is JSON; anything else is taken as text.

    \b
    hapfmt meta touch.hapf
    hapfmt meta touch.hapf subject=S07 'session={"number": 2}'
    """
    from .. import edit

    if not members:
        refuse_idle("requires KEY=VALUE", output=output)
    if output is None:
        refuse_idle("requires --output", force=force)
    if not members:
        with edit.Original(input_of(file), scan=False) as original:
            known = original.catalogue.described
        if as_json:
            echo_json(known)
        for name, value in () if as_json else known.items():
            text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            say(f"{name}: {text}")
        return 0
    if output is not None:
        refuse_target(output, force)
    given = input_of(file) if output is not None else file
    values = dict(map(member, members))
    notes = edit.set_metadata(given, values, output and output_of(output), force=force)
    tell_added(output or file, f"set {', '.join(values)}", notes, as_json)
    return 0


def member(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise ParameterError(f"Expected KEY=VALUE, got {text!r}")
    try:
        return name, json.loads(value, parse_constant=refuse)
    except ValueError:
        return name, value


def refuse(name: str) -> Any:
    raise ValueError(name)
