"""hapfmt du"""

from __future__ import annotations

import click

from ..container.source import open_source
from ..limits import Limits
from .common import echo_json, input_of, json_option, memory_option, printable, table


@click.command(short_help="Where the bytes go, by cause and by track.")
@click.argument("file", metavar="FILE")
@memory_option
@json_option
def du(file: str, as_json: bool, max_memory: Limits) -> int:
    """Where the bytes of FILE go; the causes add up to its size."""
    from ..usage import measure

    source = open_source(input_of(file))
    try:
        usage = measure(source, max_memory)
    finally:
        source.close()
    if as_json:
        echo_json(usage.as_json())
        return usage.exit_code
    rows = [
        [cause, str(size), f"{100 * size / max(usage.file, 1):.2f}"]
        for cause, size in usage.causes.items()
        if size
    ]
    table(["cause", "bytes", "%"], [*rows, ["file", str(usage.file), "100.00"]])
    tracks = [
        [
            str(t.id),
            f"{t.codec} {t.kind}",
            ", ".join(t.labels),
            str(t.packet_count),
            str(t.packets_size),
            str(t.exact_size) if t.exact_size else "-",
            str(t.table_size),
            str(t.parameters_size),
            f"{8 * t.packets_size / t.sample_count:.4f}" if t.sample_count else "-",
        ]
        for t in usage.tracks.values()
    ]
    headers = ["track", "coded as", "channels", "packets", "bytes", "exact", "in tables",
               "parameters", "b/sample"]  # fmt: skip
    table(headers, tracks)
    click.echo(printable(file) + f": payload {usage.payload} of {usage.file} bytes")
    return usage.exit_code
