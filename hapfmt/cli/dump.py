"""hapfmt dump"""

from __future__ import annotations

import json

import click

from ..container.source import open_source
from .common import input_of


@click.command(short_help="All of a file as canonical JSON.")
@click.argument("file", metavar="FILE")
@click.option("--counts", is_flag=True, help="Decode the packets and print their counts too.")
def dump(file: str, counts: bool) -> int:
    """FILE as one JSON array, an object a chunk in the order of the bytes, the findings last.

    Keys are sorted, nothing depends on the machine: two dumps can be compared as text.
    """
    from ..dump import dump as dump_chunks

    source = open_source(input_of(file))
    code = 0
    try:
        click.echo("[", nl=False)
        for place, entry in enumerate(dump_chunks(source, counts=counts)):
            click.echo(",\n" if place else "\n", nl=False)
            click.echo(json.dumps(entry, sort_keys=True, separators=(",", ":")), nl=False)
            if entry.get("findings"):
                code = 3
        click.echo("\n]")
    finally:
        source.close()
    return code
