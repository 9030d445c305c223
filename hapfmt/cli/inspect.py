"""hapfmt inspect: shows the contents of a file in another format, and the channels it gives."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import click

from ..errors import ParameterError
from ..limits import Limits
from ..numbers import counted
from ..units import unit_text
from .common import (
    asked_of,
    echo_json,
    import_options,
    input_format_option,
    input_of,
    json_option,
    memory_option,
    progress,
)
from .screen import Column, Verb, note, say, table

if TYPE_CHECKING:
    from ..convert.formats import Format
    from ..convert.tables import Import, ImportTable


@click.command(cls=Verb)
@click.argument("file", metavar="FILE", required=False)
@click.option("--formats", "list_formats", is_flag=True, help="List the formats and stop.")
@import_options
@input_format_option
@memory_option
@json_option
def inspect(
    file: str | None,
    list_formats: bool,
    input_format: str | None,
    as_json: bool,
    max_memory: Limits,
    **given: Any,
) -> int:
    """Show the contents of FILE, a recording in another format, and the channels that encode gets.

    Nothing is converted. The options are those of encode: try them here first.

    \b
    hapfmt inspect session.mcap
    hapfmt inspect session.mcap --select /wrench --clock log
    hapfmt inspect --formats
    """
    if list_formats:
        show_formats(as_json)
        return 0
    if file is None:
        raise ParameterError("give FILE, or --formats")
    from ..convert import imported

    with ExitStack() as bar:
        advance = bar.enter_context(progress("reading"))
        with imported(
            input_of(file), format=input_format, limits=max_memory, progress=advance,
            **asked_of(given),
        ) as (chosen, found):  # fmt: skip
            bar.close()  # before anything is printed
            if as_json:
                echo_json(import_json(chosen, found))
            else:
                show(chosen, found)
    return 0


def show_formats(as_json: bool) -> None:
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
        return
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


def show(chosen: Format, found: Import) -> None:
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
    events = f", {counted(len(found.events), 'event')}" if found.events else ""
    say(f"{chosen.title}: {count} in {counted(len(found.tables), 'table')}{events}")
    table(headers, rows)
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
