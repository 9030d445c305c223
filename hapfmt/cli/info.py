"""hapfmt info: loads neither NumPy nor any codec."""

from __future__ import annotations

from typing import Any
from uuid import UUID

import click

from ..catalogue import Catalogue, ChannelRef
from ..container.source import open_source
from ..limits import Limits
from ..opening import open_catalogue
from .common import echo_json, input_of, json_option, memory_option, printable, table


@click.command(short_help="What a file holds.")
@click.argument("file", metavar="FILE")
@memory_option
@json_option
def info(file: str, as_json: bool, max_memory: Limits) -> int:
    """What FILE holds: channels, rates, units, codecs, times, and whether it was closed.

    Reads the index and the descriptions only; nothing is decoded.
    """
    source = open_source(input_of(file))
    try:
        catalogue = open_catalogue(source, limits=max_memory)
        found = describe(catalogue)
    finally:
        source.close()
    if as_json:
        echo_json(found)
    else:
        show(file, catalogue, found)
    return int(found["exit_code"])


def describe(catalogue: Catalogue) -> dict[str, Any]:
    """Everything that info tells, for JSON."""
    head = catalogue.head
    return {
        "file_size": catalogue.source.size,
        "version": f"{head.major}.{head.minor}" if head else None,
        "level": catalogue.level.number,
        "file_id": head.file_id if head else None,
        "uuid": str(UUID(bytes=head.uuid)) if head and head.uuid else None,
        "epoch_ns": head.epoch_ns if head else None,
        "epoch_uncertainty_ns": head.epoch_uncertainty_ns if head else None,
        "duration_s": float(catalogue.duration),
        "closed": catalogue.closed,
        "indexed": catalogue.indexed,
        "cluster_count": len(catalogue.data),
        "track_count": len(catalogue.tracks),
        "channels": [channel_json(ref) for ref in catalogue.channels],
        "metadata": catalogue.metadata,
        "attachments": [
            {"name": a.name, "media_type": a.media_type, "size": len(a.content)}
            for a, _ in catalogue.each_attachment()
        ],
        "unknown_chunks": [header.type for header in catalogue.unknown],
        "unsupported": str(catalogue.unsupported) if catalogue.unsupported else None,
        "findings": [finding.as_json() for finding in catalogue.findings],
        "exit_code": catalogue.exit_code,
    }


def channel_json(ref: ChannelRef) -> dict[str, Any]:
    component = ref.track.components[ref.index]
    tracks = [ref.track] + ([ref.residual] if ref.residual else [])
    contract = tracks[-1].contract
    a, b, d = component.calibration
    return {
        "channel": ref.number,
        "label": component.label,
        "unit": component.unit,
        "quantity": component.quantity,
        "axis": component.axis,
        "group": component.group,
        "body_site": component.body_site,
        "device": component.device,
        "rate_num": ref.track.rate.numerator,
        "rate_den": ref.track.rate.denominator,
        "number_format": ref.track.number_format,
        "calibration": {"a": a, "b": b, "d": d} if ref.track.number_format == "counts" else None,
        "count_min": ref.track.count_min,
        "count_max": ref.track.count_max,
        "tracks": [{"id": t.id, "kind": t.kind, "codec": t.codec} for t in tracks],
        "contract": contract
        and {
            "kn": contract.kn,
            "kd": contract.kd,
            "vector": contract.vector,
            "guaranteed": contract.guaranteed,
            "floor": contract.floor[ref.index],
            "zero": contract.zero[ref.index],
        },
        "deviation": component.deviation
        and {"declared": component.deviation[0], "largest": component.deviation[1]},
        "exact": ref.track.codec == "LPCX",
        "unsupported": ref.track.unsupported,
    }


def show(file: str, catalogue: Catalogue, found: dict[str, Any]) -> None:
    closed = "closed" if found["closed"] else "NOT CLOSED"
    click.echo(
        f"{printable(file)}: hapf {found['version']} level {found['level']}, "
        f"{found['file_size']} bytes, {found['duration_s']:.6g} s, "
        f"{found['cluster_count']} clusters, {found['track_count']} tracks, {closed}"
    )
    for key in ("uuid", "epoch_ns"):
        if found[key] is not None:
            click.echo(f"{key}: {found[key]}")
    rows = [channel_row(ref) for ref in catalogue.channels]
    if rows:
        table(["channel", "label", "unit", "rate Hz", "step", "coded as", "contract"], rows)
    for key, value in catalogue.metadata.items():
        click.echo(printable(f"{key}: {value}"))
    for attachment in found["attachments"]:
        click.echo(printable(f"attachment: {attachment['name']} ({attachment['size']} bytes)"))
    for finding in catalogue.findings:
        click.echo(f"hapfmt: {printable(str(finding))}", err=True)
    if catalogue.unsupported:
        click.echo(f"hapfmt: {catalogue.unsupported}", err=True)


def channel_row(ref: ChannelRef) -> list[str]:
    component = ref.track.components[ref.index]
    tracks = [ref.track] + ([ref.residual] if ref.residual else [])
    contract = tracks[-1].contract
    rate = ref.track.rate
    a, _, d = component.calibration
    step = f"{a / d:.6g}" if ref.track.number_format == "counts" else ref.track.number_format
    promise = "exact values" if ref.track.codec == "LPCX" else "-"
    if contract:
        word = "guaranteed" if contract.guaranteed else "aimed at"
        shape = "vector, " if contract.vector else ""
        width = f"k {contract.kn / contract.kd:.4g}, floor {contract.floor[ref.index]}"
        promise = f"{shape}{width}, {word}"
    return [
        str(ref.number),
        component.label,
        component.unit,
        str(rate.numerator) if rate.denominator == 1 else f"{float(rate):.6g}",
        step,
        " + ".join(f"{t.codec} {t.kind}" for t in tracks),
        ref.track.unsupported or promise,
    ]
