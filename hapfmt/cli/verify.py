"""hapfmt verify: checks a file against every rule of the format."""

from __future__ import annotations

import shlex
from math import inf
from typing import TYPE_CHECKING, Any

import click

from ..errors import DAMAGED
from .common import (
    asked_of,
    chosen_id,
    echo_json,
    file_id_option,
    import_options,
    input_format_option,
    input_of,
    json_option,
    load_recording,
    memory_option,
    options_by_input,
    progress,
    refuse_format,
    refuse_idle,
    schema_option,
    tell_some,
    threads_option,
    verbose_option,
    way_out,
)
from .encode import amount
from .screen import Column, Verb, complain, joined, say, table

if TYPE_CHECKING:
    from ..limits import Limits
    from ..reading.verifier import ContractCheck, Report


@click.command(cls=Verb)
@click.argument("file", metavar="FILE")
@click.option("--against", metavar="ORIGINAL", help="The recording that FILE was encoded from.")
@input_format_option
@import_options
@file_id_option
@threads_option
@memory_option
@verbose_option
@json_option
@schema_option
def verify(
    file: str,
    against: str | None,
    input_format: str | None,
    file_id: int | None,
    verbose: bool,
    as_json: bool,
    threads: int | None,
    max_memory: Limits,
    **given: Any,
) -> int:
    """Check FILE against every rule: checksums, structure, packets, index, limits.

    With --against, each sample is compared with the original. The output counts the samples outside
    the error bound that the file states, and gives the largest error in percent of it. The exit
    code is 3 if a bound does not hold, or if samples are missing or invented. A channel without
    an error bound must be identical. Give the options that encode got for the original, such as
    --rate or --keep-stamps.

    \b
    hapfmt verify touch.hapf
    hapfmt verify touch.hapf --against original.npz
    hapfmt verify lab.hapf --against lab.bag --keep-stamps
    """
    from ..reading.verifier import verify as verify_file

    if against is None:
        refuse_idle("requires --against", input_format=input_format, **asked_of(given))
    refuse_format(input_format, against)
    options = options_by_input((against,), input_format, given)
    original = None
    if against:
        original, _ = load_recording(against, input_format, max_memory, **options[against])
    with progress("verifying") as advance:
        report = verify_file(
            input_of(file),
            against=original,
            file_id=file_id,
            limits=max_memory,
            progress=advance,
            threads=threads,
        )
    if as_json:
        echo_json(report.as_json())
    else:
        show(file, report, verbose=verbose, file_id=file_id)
    return report.exit_code


def show(file: str, report: Report, *, verbose: bool, file_id: int | None) -> None:
    from ..format.walk import Finding

    say(f"{file}: {report.headline()}", verdict=report.verdict)
    if report.error:
        complain(report.error.line(), way_out(report.error))
    if verbose:
        tell_some([str(Finding(**finding)) for finding in report.findings])
    tell_some(report.summary)
    if report.unknown:
        say(f"unknown chunks: {' '.join(report.unknown)}")
    if report.contracts:
        checks = report.contracts
        # On a narrow terminal, columns of zeros go first; the last line names them.
        headers = [
            Column("label"), Column("#", 9), Column("verdict"), Column("kept as", 2),
            Column("outside", 3 if any(check.outside for check in checks) else 6),
            Column("largest error"), Column("% of bound", 5), Column("% of range", 4),
            Column("samples", 8),
            Column("missing", 1 if any(check.missing for check in checks) else 7),
            Column("added", 1 if any(check.invented for check in checks) else 7),
        ]  # fmt: skip
        table(headers, [row_of(check) for check in checks])
        said = report.bounds()
        (complain if report.exit_code else say)(said)
        for check in report.contracts:
            if check.moved > check.stated:
                complain(
                    f"{name_of(check)}: the original is up to {check.moved:.6g} away from its "
                    f"grid, the file states {check.stated:.6g}"
                )
    if report.file_code == DAMAGED and report.damage and report.packets:
        command = f"hapfmt recover {shlex.quote(file)} OUT{chosen_id(file_id)}"
        these = "this packet" if report.packets == 1 else f"these {report.packets} packets"
        complain(f"to keep {these}, run: {command}")


def name_of(check: ContractCheck) -> str:
    return check.label or f"channel {check.channel}"


def verdict_of(check: ContractCheck) -> str:
    """A word as compare has it; an aim promises nothing, so samples may be outside."""
    if check.broken:
        return "broken"
    if check.outside:
        return "synthetic" if check.synthetic else "outside"
    return "within" if check.largest_error else "identical"


def row_of(check: ContractCheck) -> list[str]:
    return [
        name_of(check),
        str(check.channel),
        verdict_of(check),
        joined(check.kept_as),
        str(check.outside),
        amount(check.largest_error, check.unit) if check.largest_error else "0",
        of_bound(check),
        percent(check.largest_error, check.extent),
        str(check.samples),
        str(check.missing),
        str(check.invented),
    ]


def of_bound(check: ContractCheck) -> str:
    if check.contract:
        return f"{100 * float(check.worst_ratio):.1f}"
    return percent(check.largest_error, check.stated)


def percent(error: float, whole: float) -> str:
    """Return an error in percent of a whole, as text; "-" where there is no whole."""
    if not error:
        return "0"
    return f"{100 * (error / whole):.3g}" if 0 < whole < inf else "-"
