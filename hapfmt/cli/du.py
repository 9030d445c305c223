"""hapfmt du: prints what uses the bytes of a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from ..format.source import open_source
from ..limits import Limits
from .common import echo_json, input_of, json_option, memory_option
from .screen import Column, Verb, say, table

if TYPE_CHECKING:
    from ..reading.dump import TrackUsage

SHOWN_LABELS = 2
"""Labels of a track in its row."""


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@memory_option
@json_option
def du(file: str, as_json: bool, max_memory: Limits) -> int:
    """Print where the bytes of FILE go. The causes add up to its size.

    \b
    hapfmt du touch.hapf
    hapfmt du touch.hapf --json
    """
    from ..reading.dump import measure

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
    say()
    headers = [
        Column("channels"), Column("track", 3), Column("coded as", 2), Column("packets", 4),
        Column("bytes"), Column("corrections", 6), Column("in tables", 5),
        Column("parameters", 7), Column("bits/sample", 1),
    ]  # fmt: skip
    table(headers, [track_row(track) for track in usage.tracks.values()])
    say(f"{file}: payload {usage.payload} of {usage.file} bytes")
    return usage.exit_code


def track_row(track: TrackUsage) -> list[str]:
    nameless = "without a name" if track.kind == "events" else "?"
    labels = [label or nameless for label in track.labels]
    more = len(labels) - SHOWN_LABELS
    samples = track.sample_count
    return [
        ", ".join(labels[:SHOWN_LABELS]) + (f" and {more} more" if more > 0 else ""),
        str(track.id),
        f"{track.codec} {track.kind}",
        str(track.packet_count),
        str(track.packets_size),
        str(track.exact_size) if track.exact_size else "-",
        str(track.table_size),
        str(track.parameters_size),
        f"{8 * track.packets_size / samples:.3f}" if samples else "-",
    ]
