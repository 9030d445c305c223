"""hapfmt dump: prints a file as one JSON array."""

from __future__ import annotations

import json

import click

from ..format.source import open_source
from ..limits import Limits
from .common import input_of, memory_option, schema_option
from .screen import Verb, raw


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@click.option("--counts", is_flag=True, help="Decode the packets and print their counts too.")
@memory_option
@schema_option
def dump(file: str, counts: bool, max_memory: Limits) -> int:
    """Print FILE as one JSON array: one object for each chunk, in order, then the findings.

    Keys are sorted, and nothing depends on the machine. So two dumps can be compared as text.

    \b
    hapfmt dump touch.hapf
    hapfmt dump touch.hapf --counts > touch.json
    """
    from ..reading.dump import dump as dump_chunks

    source = open_source(input_of(file))
    code = 0
    try:
        before = "[\n"
        for entry in dump_chunks(source, counts=counts, limits=max_memory):
            # Open the file before printing, so that an error leaves no incomplete JSON.
            text = json.dumps(entry, sort_keys=True, separators=(",", ":"), allow_nan=False)
            raw((before + text).replace("\x7f", "\\u007f"))
            before = ",\n"
            code = entry.get("exit_code", code)
        raw("\n]\n")
    finally:
        source.close()
    return code
