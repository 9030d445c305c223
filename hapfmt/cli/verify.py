"""hapfmt verify"""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from .common import (
    echo_json,
    input_format_option,
    input_of,
    json_option,
    load_recording,
    memory_option,
    printable,
    progress,
    table,
    tell_some,
    threads_option,
)

if TYPE_CHECKING:
    from ..limits import Limits
    from ..verifier import Report


@click.command(short_help="Check every rule of a file, and its deadband contract.")
@click.argument("file", metavar="FILE")
@click.option("--against", metavar="ORIGINAL", help="The recording that FILE was encoded from.")
@input_format_option
@click.option("--rate", help="Ticks per second of ORIGINAL, if it does not say.")
@threads_option
@memory_option
@json_option
def verify(
    file: str,
    against: str | None,
    input_format: str | None,
    rate: str | None,
    as_json: bool,
    threads: int | None,
    max_memory: Limits,
) -> int:
    """Check FILE: checksums, structure, every packet decoded, digests, index, limits.

    With --against, each sample of the original is compared in integers: how many lie outside the
    deadband that the file states, and the worst ratio (1 is the edge). Exit code 3 where a
    guarantee does not hold, where a channel without a contract differs at all, where samples are
    missing or invented, or where the original is further from its lattice than the file states.
    """
    from ..verifier import verify as check

    original = load_recording(against, input_format, rate, max_memory)[0] if against else None
    with progress("verifying") as advance:
        report = check(
            input_of(file), against=original, limits=max_memory, progress=advance, threads=threads
        )
    if as_json:
        echo_json(report.as_json())
    else:
        show(file, report)
    return report.exit_code


def show(file: str, report: Report) -> None:
    click.echo(
        f"{printable(file)}: {report.verdict}; {report.packets} packets, {report.samples} samples, "
        f"{report.digests} digests" + (f", {report.events} events" if report.events else "")
    )
    if report.error:
        click.echo(f"hapfmt: {printable(str(report.error))}", err=True)
    tell_some(
        [
            f"0x{f['offset']:x}+{f['size']}: {f['code']}: {f['message']} [{f['requirement']}]"
            for f in report.findings
        ]
    )
    tell_some(report.lost_lines)
    if report.verdict == "damaged" and report.damage:
        name = printable(file)
        click.echo(
            f"hapfmt: to keep these {report.packets} packets, run: hapfmt recover {name} OUT",
            err=True,
        )
    if report.unknown:
        click.echo(f"unknown chunks: {' '.join(report.unknown)}")
    if report.contracts:
        rows = []
        for c in report.contracts:
            promise = "-"
            if c.contract:
                word = "guaranteed" if c.contract.guaranteed else "aimed at"
                promise = f"k {c.contract.kn / c.contract.kd:.4g} {word}"
            ratio = f"{float(c.worst_ratio):.4f}" if c.contract else "-"
            rows.append(
                [str(c.channel), c.label, promise, str(c.samples), str(c.outside), ratio,
                 f"{c.largest_error:.6g}", str(c.missing), str(c.invented)]
            )  # fmt: skip
        headers = ["channel", "label", "contract", "samples", "outside", "worst ratio",
                   "largest error", "missing", "invented"]  # fmt: skip
        table(headers, rows)
        for c in report.contracts:
            if c.moved > c.stated:
                click.echo(
                    f"hapfmt: channel {c.channel}: the original is up to {c.moved:.6g} away from "
                    f"its lattice, the file states {c.stated:.6g}",
                    err=True,
                )
