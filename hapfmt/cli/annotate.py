"""hapfmt annotate: adds an event to a .hapf file in place."""

from __future__ import annotations

import csv
import io
import json
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ParameterError
from ..numbers import counted
from .common import (
    FractionType,
    copy_option,
    echo_json,
    force_option,
    input_of,
    json_option,
    output_of,
    refuse_idle,
    refuse_target,
    standard_input,
    tell_added,
)
from .screen import Verb, note, say, table

if TYPE_CHECKING:
    from ..recording import Event

TIMES, TEXTS = ("time", "onset"), ("text", "trial_type")
"""Names of columns; the second ones are those of BIDS."""


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@click.argument("text", metavar="[TEXT]", required=False)
@click.option("--at", type=FractionType(), metavar="S", help="Time in seconds.")
@click.option("--duration", type=FractionType(), metavar="S", help="Duration in seconds. [0]")
@click.option("--channel", help="Label or number of the channel it is about. [all]")
@click.option("--layer", default="", help="Name of a group of events, such as the observer.")
@click.option(
    "--table",
    "table_",
    metavar="TABLE",
    help="Add all events of a table. CSV or JSON lines; columns: time (or onset), duration, "
    "channel, layer, text (or trial_type).",
)
@click.option("--list", "list_", is_flag=True, help="List the events (of --layer, if given).")
@copy_option
@force_option
@json_option
def annotate(
    file: str,
    text: str | None,
    at: Fraction | None,
    duration: Fraction | None,
    channel: str | None,
    layer: str,
    table_: str | None,
    list_: bool,
    output: str | None,
    force: bool,
    as_json: bool,
) -> int:
    """Add an event to the .hapf file FILE, in place. Its other contents do not change.

    \b
    hapfmt annotate touch.hapf --at 1.25 "first contact"
    hapfmt annotate touch.hapf --at 2 --duration 0.5 --channel fx --layer eva slip
    hapfmt annotate touch.hapf --table events.csv
    hapfmt annotate touch.hapf --list
    """
    from .. import edit

    if output is None:
        refuse_idle("requires --output", force=force)
    if list_:
        refuse_idle(
            "does not go with --list", at=at, duration=duration, channel=channel, table=table_,
            output=output,
        )  # fmt: skip
        if text is not None:
            raise ParameterError("--list takes no TEXT")
        return show(file, layer, as_json)
    one = [text, at, duration, channel]
    if table_ is not None:
        if any(x is not None for x in one):
            raise ParameterError("Give --table, or one event with --at and TEXT, not both")
        events = read_table(table_, layer)
        if layer and all(event.layer != layer for event in events):
            note("--layer is for rows without a layer, and each row of the table has one")
    else:
        if text is None or at is None:
            raise ParameterError("Give --at SECONDS and the argument TEXT, or --table, or --list")
        row = {"time": at, "duration": duration, "channel": channel, "text": text}
        events = [event_of(row, layer)]
    if output is not None:
        refuse_target(output, force)
    given = input_of(file) if output is not None else file
    notes = edit.annotate(given, events, output and output_of(output), force=force)
    what = f"{counted(len(events), 'event')} added"
    tell_added(output or file, what, notes, as_json)
    return 0


def event_of(row: dict[str, Any], layer: str) -> Event:
    from ..recording import Event

    channel = row.get("channel")
    if isinstance(channel, str):
        channel = channel or None
    return Event(
        row["time"], row.get("text") or "", row.get("duration") or Fraction(0), channel,
        row.get("layer") or layer,
    )  # fmt: skip


def read_table(name: str, layer: str) -> list[Event]:
    """CSV, or JSON lines where the first character is a brace."""
    raw = standard_input().read() if name == "-" else Path(name).read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ParameterError("the events are not UTF-8 text", path=name) from None
    rows = json_rows(text) if text.lstrip().startswith("{") else csv_rows(text)
    events = []
    for number, row in rows:
        try:
            time = next((row[x] for x in TIMES if row.get(x) not in (None, "")), None)
            if time is None:
                raise ParameterError("no column time (or onset)")
            words = next((row[x] for x in TEXTS if row.get(x) is not None), "")
            events.append(event_of({**row, "time": time, "text": words}, layer))
        except ParameterError as error:
            raise ParameterError(f"line {number}: {error.message}", path=name) from None
    known = {*TIMES, *TEXTS, "duration", "channel", "layer"}
    odd = [key for key in dict.fromkeys(key for _, row in rows for key in row) if key not in known]
    if odd:
        note(f"{name}: left out, as events have no such columns: {', '.join(odd)}")
    return events


def csv_rows(text: str) -> list[tuple[int, dict[str, Any]]]:
    first = text.split("\n", 1)[0]
    delimiter = max("\t;,", key=first.count)
    reader = csv.DictReader(io.StringIO(text, newline=""), delimiter=delimiter, restval="")
    try:
        return [
            (reader.line_num, {str(key).strip().lower(): row[key] for key in row}) for row in reader
        ]
    except csv.Error as error:
        raise ParameterError(f"not a CSV table: {error}") from None


def json_rows(text: str) -> list[tuple[int, dict[str, Any]]]:
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line, parse_float=str)
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            raise ParameterError(f"line {number} is not a JSON object")
        rows.append((number, row))
    return rows


def show(file: str, layer: str, as_json: bool) -> int:
    from ..reading.reader import Reader
    from .common import tell_losses

    with Reader(input_of(file)) as reader:
        events = reader.events(layers=[layer] if layer else None)
        labels = {ref.number: ref.label for ref in reader.channels}
        code = tell_losses(reader)
    if as_json:
        rows = [{**vars(e), "time": float(e.time), "duration": float(e.duration)} for e in events]
        echo_json({"events": rows, "exit_code": code})
    elif events:
        table(
            ["time, s", "text", "duration, s", "channel", "layer"],
            [
                [
                    f"{float(e.time):.9g}", e.text, f"{float(e.duration):.9g}",
                    "-" if e.channel is None else labels.get(int(e.channel)) or str(e.channel),
                    e.layer,
                ]
                for e in events
            ],
        )  # fmt: skip
    else:
        say("no events")
    return code
