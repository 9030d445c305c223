"""What hapfmt info shows of other formats: the contents of a file, and the list of formats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from ..limits import Limits
from ..numbers import counted
from ..units import unit_text
from .common import asked_of, echo_json, input_of, progress
from .screen import Column, note, say, table

if TYPE_CHECKING:
    from ..convert.formats import Format
    from ..convert.tables import Import, ImportTable
    from ..recording import Event


def show_foreign(
    file: str,
    input_format: str | None,
    events: bool,
    as_json: bool,
    max_memory: Limits,
    **given: Any,
) -> int:
    """Print what a file of another format contains; no values are read."""
    from ..convert import imported

    with ExitStack() as bar:
        advance = bar.enter_context(progress("reading"))
        with imported(
            input_of(file), format=input_format, limits=max_memory, progress=advance,
            **asked_of(given),
        ) as (chosen, found):  # fmt: skip
            bar.close()  # before anything is printed
            if as_json:
                listed = {"events": events_json(found.events)} if events else {}
                echo_json(import_json(chosen, found) | listed)
            else:
                show(chosen, found, events)
    return 0


def events_json(events: Iterable[Event]) -> list[dict[str, Any]]:
    return [
        {**vars(event), "time": str(event.time), "duration": str(event.duration)}
        for event in events
    ]


def show_events(events: Sequence[dict[str, Any]] | None) -> None:
    """Print a table of the events of a file, or a note that it has none; None prints nothing."""
    if events == []:
        note("this file has no events; hapfmt annotate adds some")
    elif events:
        headers = ["time, s", "text", "duration, s", "channel", "layer"]
        table(headers, [event_row(event) for event in events])


def event_row(event: dict[str, Any]) -> list[str]:
    channel = "-" if event["channel"] is None else str(event["channel"])
    at, duration = (f"{float(Fraction(event[name])):.9g}" for name in ("time", "duration"))
    return [at, event["text"], duration, channel, event["layer"]]


def show_formats(as_json: bool) -> int:
    from ..convert.formats import formats

    rows = [
        {
            "format": one.name,
            "title": one.title,
            "suffixes": list(one.suffixes) or [one.folder],
            "reads": one.reads,
            "writes": one.writes,
            "options": sorted(one.options),
        }
        for one in formats().values()
    ]
    if as_json:
        echo_json({"formats": rows})
        return 0
    cells = [
        [
            one.name,
            " ".join([*one.suffixes, *([f"folder with {one.folder}"] if one.folder else [])]),
            "yes" if one.reads else "no",
            "yes" if one.writes else "no",
            " ".join(f"--{name.replace('_', '-')}" for name in sorted(one.options)),
        ]
        for one in formats().values()
    ]
    headers = [
        Column("format"), Column("files"), Column("reads"), Column("writes"), Column("options", 1),
    ]  # fmt: skip
    table(headers, cells)
    return 0


def show(chosen: Format, found: Import, events: bool) -> None:
    labels = iter(found.labels)
    rows = []
    for each in found.tables:
        before = ""  # of neighbours with the same unit text, the first shows it
        for place, column in enumerate(each.columns):
            unit = unit_text(column.unit) or "-"
            if column.source_unit not in ("", column.unit, before):
                unit += f" (from {column.source_unit!r})"
            before = column.source_unit
            rows.append(
                [
                    next(labels),
                    unit,
                    f"{float(each.rate):.6g}" if not place else "",
                    str(each.row_count) if not place else "",
                    str(max(len(each.spans) - 1, 0)) if not place else "",
                    named(each) if not place else "",
                ]
            )
    headers = [
        Column("channel"), Column("unit"), Column("Hz"), Column("rows"), Column("gaps", 2),
        Column("from", 1),
    ]  # fmt: skip
    count = counted(len(rows), "channel")
    more = f", {counted(len(found.events), 'event')}" if found.events else ""
    say(f"{chosen.title}: {count}{more}")
    table(headers, rows)
    if events:
        show_events(events_json(found.events))
    for each_note in found.all_notes:
        note(each_note)


def named(one: ImportTable) -> str:
    return f"{one.name} ({one.kind})" if one.kind else one.name


def import_json(chosen: Format, found: Import) -> dict[str, Any]:
    labels = iter(found.labels)
    return {
        "format": chosen.name,
        "tables": [
            {
                "name": each.name,
                "kind": each.kind,
                "rate_hz": float(each.rate),
                "rate": str(each.rate),
                "row_count": each.row_count,
                "start_tick": each.spans[0].start if each.spans else 0,
                "gaps": [
                    [before.stop, after.start]
                    for before, after in zip(each.spans, each.spans[1:], strict=False)
                ],
                "channels": [
                    {
                        "label": next(labels),
                        "unit": column.unit,
                        "source_unit": column.source_unit or column.unit,
                        "quantity": column.quantity,
                        "axis": column.axis,
                        "group": column.group,
                        "device": column.device,
                        "dtype": str(column.dtype),
                    }
                    for column in each.columns
                ],
            }
            for each in found.tables
        ],
        "event_count": len(found.events),
        "epoch_ns": found.epoch_ns,
        "size": found.size,
        "notes": found.all_notes,
    }
