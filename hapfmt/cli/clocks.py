"""hapfmt clocks: prints the observations of other clocks in a file, and their rates."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any, cast

import click

from .common import (
    FractionType,
    echo_json,
    input_of,
    json_option,
    memory_option,
    refuse_idle,
    tell_losses,
)
from .screen import Column, Verb, note, say, table

if TYPE_CHECKING:
    from ..clocks import ClockMap, ClockObservation
    from ..limits import Limits
    from ..reading.clocks import Delays
    from ..reading.reader import Reader


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@click.option("--fit", is_flag=True, help="Fit straight lines to each clock and print them.")
@click.option(
    "--delays",
    type=click.Choice(["both", "late"]),
    help="With --fit: whether time stamps can be early and late, or late only. [both]",
)
@click.option(
    "--segment",
    type=FractionType(),
    metavar="S",
    help="With --fit: length of one line in seconds. [chosen from the data]",
)
@memory_option
@json_option
def clocks(
    file: str,
    fit: bool,
    delays: str | None,
    segment: Fraction | None,
    as_json: bool,
    max_memory: Limits,
) -> int:
    """Print the observations of other clocks in FILE, and how these clocks run.

    Offset: how far a clock was ahead of the recording at its first observation. Drift: how much
    faster it runs. Jitter: half of the observations are within it of one straight line. The maps
    are those stored in FILE; with --fit they are new, and are not stored.

    \b
    hapfmt clocks touch.hapf
    hapfmt clocks touch.hapf --fit --delays late
    """
    if not fit:
        refuse_idle("requires --fit", delays=delays, segment=segment)
    from ..clocks import by_clock
    from ..reading.reader import Reader

    with Reader(input_of(file), limits=max_memory) as reader:
        seconds = None if segment is None else float(segment)
        asked = (cast("Delays", delays or "both"), seconds) if fit else None
        rows = [one_clock(reader, seen, asked) for seen in by_clock(reader.clocks).values()]
        code = tell_losses(reader)
    if as_json:
        echo_json({"clocks": rows, "exit_code": code})
    elif rows:
        show(rows)
    else:
        say("this file has no observations of other clocks")
        if fit:
            note("--fit has nothing to fit; hapfmt.Recorder.observe stores observations")
    return code


def one_clock(
    reader: Reader, seen: list[ClockObservation], fitted: tuple[Delays, float | None] | None
) -> dict[str, Any]:
    from ..reading.clocks import fit_clock, summarise
    from ..recording import NANOSECONDS

    clock, channel = seen[0].clock, seen[0].channel
    track = next((ref.track for ref in reader.channels if ref.number == channel), None)
    rate = NANOSECONDS if track is None else track.rate
    summary = summarise(seen, rate)
    ticks = [each.tick for each in seen]
    chosen: ClockMap | None = None
    if fitted and min(ticks) < max(ticks):
        chosen = fit_clock(seen, rate, delays=fitted[0], window=fitted[1])
    elif not fitted:
        maps = {(each.clock, each.channel): each for each in reader.clock_maps}
        chosen = maps.get((clock, channel))
    away = sorted(abs(each.time_ns - chosen.time_ns(each.tick)) for each in seen) if chosen else []
    return {
        "clock": clock,
        "track": None if track is None else track.id,
        "observation_count": summary.count,
        "first_s": float(min(ticks) / rate),
        "last_s": float(max(ticks) / rate),
        "offset_ns": summary.offset_ns,
        "drift_ppm": summary.drift_ppm,
        "jitter_ns": summary.jitter_ns,
        "points": [list(point) for point in chosen.points] if chosen else None,
        "beside_map_ns": away[len(away) // 2] if away else None,
    }


def show(rows: list[dict[str, Any]]) -> None:
    headers = [
        Column("clock"), Column("ticks of", 5), Column("observed", 2), Column("from s", 6),
        Column("to s", 7), Column("offset s"), Column("drift ppm"), Column("jitter us", 1),
        Column("map points", 4), Column("beside it us", 3),
    ]  # fmt: skip
    cells = [
        [
            row["clock"],
            "nanoseconds" if row["track"] is None else f"track {row['track']}",
            str(row["observation_count"]),
            f"{row['first_s']:.6g}",
            f"{row['last_s']:.6g}",
            f"{row['offset_ns'] / 1e9:.6f}",
            f"{row['drift_ppm']:.3f}",
            f"{row['jitter_ns'] / 1e3:.3f}",
            str(len(row["points"])) if row["points"] else "-",
            f"{row['beside_map_ns'] / 1e3:.3f}" if row["points"] else "-",
        ]
        for row in rows
    ]
    table(headers, cells)
