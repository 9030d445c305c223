"""Error, size and run time of everything, in one page: scenes and recordings, integrators, codecs,
stability, and the paper's figures.

python tools/report [--quick] [--only SECTION] [--data DIR] [-o DIR]

Writes index.html, which needs no other file, report.md, report.json, and a CSV file for each table.
Without a folder of recordings only simulated scenes are measured. Only the middle of long
recordings is measured, so that ../shared/data takes less than 15 minutes of CPU time.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from installed import ROOT

import click
from measured import DATA, origin
from peers.packages import left_out, versions

from report.page import Part, page
from report.section import CannotRunError, Options
from report.texts import as_json, markdown_file, write_tables

TITLE = "hapfmt: error, size and run time"
SECTIONS = ("codecs", "model", "decoding", "integrators", "stability", "paper", "scenes")
"""In the order of the page."""


def known() -> list[str]:
    return [name for name in SECTIONS if find_spec(f"report.{name}")]


def run(name: str, options: Options) -> Part:
    """One section. If it fails, its error takes its place, and the others go on."""
    began = time.monotonic()
    try:
        if not find_spec(f"report.{name}"):
            raise CannotRunError(f"this clone has no tools/report/{name}.py")
        section = import_module(f"report.{name}").section(options)
        return Part(name, section, seconds=time.monotonic() - began)
    except CannotRunError as error:
        return Part(name, None, str(error), time.monotonic() - began)
    except Exception as error:
        traceback.print_exc()
        why = f"{type(error).__name__}: {error}"
        return Part(name, None, why, time.monotonic() - began, failed=True)


def facts(options: Options, seconds: float, on: str) -> dict[str, str]:
    """Everything that the figures depend on."""
    others = dict(versions())
    for module in ("scipy", "matplotlib", "vibromaf"):
        if find_spec(module):
            others[module] = str(getattr(import_module(module), "__version__", "installed"))
    missing = left_out() + [name for name in ("matplotlib", "vibromaf") if name not in others]
    return {
        "measured": f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, in {seconds:.0f} s; "
        f"{cpu_s():.0f} s of CPU time, child processes included"
        + (
            ". This is --quick: seconds of everything, no figures to quote" if options.quick else ""
        ),
        "on": on,
        "packages": ", ".join(f"{name} {version}" for name, version in others.items()),
        "left out": ", ".join(missing) or "nothing",
        "recordings": f"{options.data.name} and simulated scenes"
        if options.data
        else "simulated scenes alone",
        "times": "CPU time, the median of the runs; the tables have the quartiles",
    }


def cpu_s() -> float:
    """CPU time of this process and of those that it started, in seconds."""
    found = os.times()
    return found.user + found.system + found.children_user + found.children_system


def write(out: Path, about: dict[str, str], parts: Sequence[Part]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    lines = [f"{key.capitalize()}: {value}." for key, value in about.items()]
    (out / "index.html").write_text(page(TITLE, lines, parts), encoding="utf-8")
    (out / "report.md").write_text(markdown_file(TITLE, lines, parts), encoding="utf-8")
    (out / "report.json").write_text(as_json(TITLE, about, parts), encoding="utf-8")
    write_tables(out, parts)


@click.command(help=__doc__)
@click.option("--quick", is_flag=True, help="Little of everything: does it run?")
@click.option("--only", multiple=True, help=f"Of {', '.join(SECTIONS)}; may be repeated.")
@click.option("--data", type=click.Path(exists=True, file_okay=False, path_type=Path),
              help="A folder of recordings.  [../shared/data, where there is one]")  # fmt: skip
@click.option("--no-data", is_flag=True, help="Simulated scenes alone.")
@click.option(
    "--write",
    "to_docs",
    is_flag=True,
    help="Put the table of the model into docs/synthetic-textures.md.",
)
@click.option("-o", "--output", "out", type=click.Path(file_okay=False, path_type=Path),
              default=ROOT / "build" / "report", help="A folder for what is written.")  # fmt: skip
def main(
    quick: bool, only: tuple[str, ...], data: Path | None, no_data: bool, to_docs: bool, out: Path
) -> None:  # fmt: skip
    if unknown := set(only) - set(SECTIONS):
        raise click.BadParameter(f"no section {', '.join(sorted(unknown))}", param_hint="--only")
    began, on = time.monotonic(), origin()  # a tree may change while it is measured
    name = ""

    def progress(line: str) -> None:
        line = line.removeprefix(f"{name}: ")
        click.echo(f"[{time.monotonic() - began:4.0f} s] {name}: {line}", err=True)

    folder = None if no_data else data or (DATA if DATA.is_dir() else None)
    options = Options(folder, quick, out, progress, to_docs)
    parts: list[Part] = []
    try:
        for name in only or known():
            progress("begins")
            parts.append(run(name, options))
    except KeyboardInterrupt:
        parts.append(Part(name, None, "interrupted"))
    write(out, facts(options, time.monotonic() - began, on), parts)
    click.echo(out / "index.html")
    if failed := [part.name for part in parts if part.failed]:
        click.echo(f"failed: {', '.join(failed)}", err=True)
        sys.exit(1)
