"""The catalogue: a Parquet table with one row for each channel of each file.

polars writes it, and selects rows by an SQL expression. It parses the expression itself: an
expression names columns and calls functions of numbers and text, and reads no files.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

from ..errors import VERDICTS, MissingExtraError, ParameterError, unknown
from ..limits import Limits
from .jobs import FileOutcome, Job
from .places import CATALOGUE, Place

NAME = CATALOGUE
COLUMNS = {
    "file": "String",
    "channel": "Int32",
    "label": "String",
    "unit": "String",
    "quantity": "String",
    "axis": "String",
    "group": "String",
    "device": "String",
    "body_site": "String",
    "rate": "Float64",
    "rate_exact": "String",
    "start": "Float64",
    "duration": "Float64",
    "samples": "Int64",
    "missing": "Int64",
    "min": "Float64",
    "max": "Float64",
    "rms": "Float64",
    "recorded": "Datetime",
    "uuid": "String",
    "encoder": "String",
    "file_size": "Int64",
    "modified": "Datetime",
    "signature": "String",
    "checksum": "String",
    "verdict": "String",
    "error": "String",
}
"""Name and type of each column, in their order."""


AGGREGATE = re.compile(
    r"\b(avg|count|first|last|max|mean|median|min|stddev|std|sum|var|variance|quantile\w*)\s*\(",
    re.IGNORECASE,
)


def polars() -> Any:
    try:
        return import_module("polars")
    except ImportError:
        raise MissingExtraError("polars", "archive") from None


def text(value: Any) -> Any:
    """Text that UTF-8 can hold: file names may be any bytes."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode("utf-8")
    return value


def table_of(rows: Iterable[Mapping[str, Any]]) -> Any:
    pl = polars()
    types = {
        name: pl.Datetime("us", "UTC") if kind == "Datetime" else getattr(pl, kind)
        for name, kind in COLUMNS.items()
    }
    columns: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    for row in rows:
        for name, values in columns.items():
            value = row.get(name)
            if COLUMNS[name] == "Datetime" and isinstance(value, str):
                value = datetime.fromisoformat(value)
            values.append(text(value))
    return pl.DataFrame(columns, schema=types)


def to_parquet(rows: Iterable[Mapping[str, Any]]) -> bytes:
    stream = BytesIO()
    table_of(rows).write_parquet(stream, compression="zstd")
    return stream.getvalue()


def read(path: str | os.PathLike[str]) -> Any:
    """The table of a catalogue, or of the folder or the bag that holds it."""
    from ..format.source import is_url, shown, spooled_url

    pl = polars()
    name = os.fspath(path)
    if is_url(name):
        with spooled_url(name) as stream:
            stream.seek(0)
            return parsed(pl, stream.read(), shown(name))
    where = Path(name)
    if where.is_dir():
        places = [where / NAME, where / "data" / NAME]
        found = next((each for each in places if each.is_file()), None)
        if found is None:
            raise ParameterError(
                f"{name} holds no {NAME}; make one with: hapfmt archive catalogue {name}", path=""
            )
        where = found
    return parsed(pl, where.read_bytes(), str(where))


def parsed(pl: Any, data: bytes, name: str) -> Any:
    try:
        table = pl.read_parquet(BytesIO(data))
    except (pl.exceptions.PolarsError, OSError) as error:
        raise ParameterError(f"not a Parquet file: {first_line(error)}", path=name) from None
    if missing := [column for column in COLUMNS if column not in table.columns]:
        raise ParameterError(f"not a catalogue: the column {missing[0]!r} is missing", path=name)
    return table


def find(table: Any, where: str | None) -> Any:
    """The rows for which an SQL expression such as "quantity = 'force' and rms > 2" is true."""
    if where is None:
        return table
    pl = polars()
    outside_of_texts = re.sub("'[^']*'", "''", where)
    if aggregate := AGGREGATE.search(outside_of_texts):
        raise ParameterError(
            f"--where looks at one channel at a time: {aggregate[1]}(...) is of several"
        )
    try:
        return table.lazy().filter(pl.sql_expr(where)).collect()
    except pl.exceptions.ColumnNotFoundError as error:
        name = re.search(r'"([^"]*)"', str(error))
        if name is None or name[1].startswith("_"):
            raise ParameterError(f"--where is one expression over columns: {where}") from None
        message = unknown("column", name[1], list(COLUMNS))
        raise ParameterError(f"{message} (text is in single quotes: '{name[1]}')") from None
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        if re.search("datetime", str(error), re.IGNORECASE) and "'" in where:
            raise ParameterError(
                f"--where {where!r}: a day is written as date '2026-01-31', "
                "and a part of a time as hour(recorded)"
            ) from None
        raise ParameterError(f"--where {where!r}: {first_line(error)}") from None


def first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0] or type(error).__name__


def known_rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    """The rows of an earlier catalogue by file; empty where there is none."""
    found: dict[str, list[dict[str, Any]]] = {}
    if path.is_file():
        for row in read(path).to_dicts():
            found.setdefault(row["file"], []).append(row)
    return found


def catalogue_jobs(places: Sequence[Place], out: Path, limits: Limits) -> list[Job]:
    """A file below the folder of the catalogue is named from there, so both may move together."""
    root = out.parent.resolve()
    work = []
    for place in places:
        name = place.shown
        if not place.is_url:
            path = Path(place.location).absolute()
            inside = path.parent.resolve()
            below = inside.is_relative_to(root)
            name = (inside.relative_to(root) / path.name).as_posix() if below else str(path)
        work.append(Job("catalogue", place, options={"file": text(name)}, limits=limits))
    return work


def catalogued(
    work: Sequence[Job], known: Mapping[str, list[dict[str, Any]]]
) -> dict[int, FileOutcome]:
    """Outcomes of the jobs whose files are in an earlier catalogue, unchanged, by their places."""
    found = {}
    for place, job in enumerate(work):
        rows = known.get(job.options["file"])
        if rows and job.place.signature and rows[0]["signature"] == job.place.signature:
            word = rows[0]["verdict"]
            code = next((code for code, name in VERDICTS.items() if name == word), 1)
            found[place] = FileOutcome(
                job.place.name, "unchanged", code, rows[0]["error"] or "", rows=rows
            )
    return found


def as_json(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row for JSON."""
    return {
        name: value.isoformat() if hasattr(value, "isoformat") else value
        for name, value in row.items()
    }
