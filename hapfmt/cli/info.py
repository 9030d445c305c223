"""hapfmt info: prints the contents of a file; of a .hapf file without loading NumPy or any codec.

With --follow it prints one line at each look at a growing file.
"""

from __future__ import annotations

import json
import re
import sys
import time
from collections import Counter
from itertools import groupby
from pathlib import Path
from typing import Any

import click

from ..errors import ParameterError
from ..format.source import open_source
from ..format.track import Contract, Track
from ..format.wire import id_text
from ..limits import Limits
from ..numbers import counted
from ..reading.catalogue import Catalogue, ChannelRef, FalseIndexError
from ..reading.damage import DamageReport
from ..reading.follow import Follower
from ..reading.opening import open_catalogue
from ..units import unit_text
from .common import (
    FOREIGN_ONLY,
    HAPF,
    asked_of,
    echo_json,
    import_options,
    input_format_option,
    input_of,
    json_option,
    memory_option,
    refuse_idle,
    schema_option,
    tell_some,
)
from .foreign import events_json, show_events, show_foreign, show_formats
from .screen import JOINED, Column, Verb, clipped, complain, joined, raw, say, table, width_of


def follow_file(file: str, interval: float, as_json: bool) -> int:
    """Runs until the file is closed or Ctrl-C is pressed; neither is an error."""
    if file == "-":
        raise ParameterError("--follow requires a file name, not a pipe")
    with Follower(file, interval=interval) as follower:
        size, moment = 0, 0.0
        try:
            while True:
                for _ in follower.poll():
                    pass
                now = time.monotonic()
                rate = (follower.source.size - size) / (now - moment) if moment else None
                size, moment = follower.source.size, now
                show_growth(describe_growth(follower, rate), as_json)
                if follower.closed:
                    break
                follower.stopped.wait(interval)
        except KeyboardInterrupt:
            pass
        if sys.stdout.isatty() and not as_json:
            say()
        findings = follower.catalogue.findings
        if not as_json:
            tell_some([f"{file}: {finding}" for finding in findings])
        return follower.catalogue.exit_code


def describe_growth(follower: Follower, rate: float | None) -> dict[str, Any]:
    """The object of --json; the rate is in bytes a second since the previous line."""
    return {
        "duration_s": float(follower.duration),
        "cluster_count": follower.cluster_count,
        "track_count": len(follower.catalogue.tracks),
        "file_size": follower.source.size,
        "bytes_per_s": rate,
        "last_cluster_age_s": max(time.time() - follower.cluster_at, 0.0),
        "closed": follower.closed,
        "restarts": follower.restarts,
        "finding_count": len(follower.catalogue.findings),
        "exit_code": follower.catalogue.exit_code,
    }


def show_growth(found: dict[str, Any], as_json: bool) -> None:
    if as_json:
        echo_json(found)
        sys.stdout.flush()
        return
    rate = "-" if found["bytes_per_s"] is None else f"{found['bytes_per_s']:.0f}"
    state = "closed" if found["closed"] else f"last {found['last_cluster_age_s']:.1f} s ago"
    text = (
        f"{found['duration_s']:.3f} s, {counted(found['cluster_count'], 'cluster')}, "
        f"{found['file_size']} bytes, {rate} bytes/s, {state}"
    )
    width = width_of()
    if width is None:
        say(text)
    else:
        # On a terminal one line is written again and again.
        raw("\r\x1b[K" + clipped(text, width))
    sys.stdout.flush()


SHOWN_CHARACTERS = 160
"""Most characters of nested metadata that are printed."""


@click.command(cls=Verb)
@click.argument("file", metavar="FILE", required=False)
@click.option("--formats", is_flag=True, help="List the formats and stop.")
@click.option("--events", is_flag=True, help="List the events too.")
@click.option("--follow", is_flag=True, help="Print a line each second while a .hapf FILE grows.")
@click.option(
    "--interval",
    type=click.FloatRange(0.01),
    metavar="S",
    help="Seconds between the lines of --follow. [1]",
)
@import_options
@input_format_option
@memory_option
@json_option
@schema_option
def info(
    file: str | None,
    formats: bool,
    events: bool,
    follow: bool,
    interval: float | None,
    input_format: str | None,
    as_json: bool,
    max_memory: Limits,
    **given: Any,
) -> int:
    """Print what FILE contains: channels, rates, units and times. A .hapf file also has codecs and
    error bounds, and may be closed or not.

    Only the index and the descriptions are read, unless these are damaged; --events decodes the
    events. FILE may be a URL. --follow ends when the file is closed, or with Ctrl-C.

    For a file of another format, the channels are those that encode makes. The options are those
    of encode: try them here first.

    \b
    hapfmt info touch.hapf
    hapfmt info touch.hapf --events
    hapfmt info session.mcap --select /wrench --clock log
    hapfmt info --formats
    """
    if formats:
        if file is not None:
            raise ParameterError("--formats takes no FILE")
        return show_formats(as_json)
    if file is None:
        raise ParameterError("give FILE, or --formats")
    if interval is not None and not follow:
        raise ParameterError("--interval requires --follow")
    if not is_hapf(file, input_format):
        if follow:
            raise ParameterError("--follow requires a .hapf file", path=file)
        return show_foreign(file, input_format, events, as_json, max_memory, **given)
    refuse_idle(FOREIGN_ONLY, **asked_of(given))
    if follow:
        if events:
            raise ParameterError("give one of --events and --follow")
        return follow_file(file, 1 if interval is None else interval, as_json)
    look = with_its_events if events else described
    damage, found = look(file, max_memory)
    if as_json:
        echo_json(found)
    else:
        show(file, damage, found)
    return int(found["exit_code"])


def is_hapf(file: str, input_format: str | None) -> bool:
    """Whether FILE is read as a .hapf file: without another format, suffix or content."""
    if input_format is None:
        path = Path(file)
        found = path.is_file() or path.is_dir() or "://" in file
        if not found or path.suffix.lower() == HAPF:
            return True
    from ..convert import format_of

    return format_of(file, input_format) is None


def described(file: str, limits: Limits) -> tuple[DamageReport, dict[str, Any]]:
    source = open_source(input_of(file))
    try:
        catalogue = open_catalogue(source, limits=limits)
        try:
            return facts(catalogue)
        except FalseIndexError:
            return facts(open_catalogue(source, scan=True, limits=limits))
    finally:
        source.close()


def facts(catalogue: Catalogue) -> tuple[DamageReport, dict[str, Any]]:
    """The facts of info; of a damaged file with what ``verify`` says of it."""
    damage = DamageReport(catalogue, [])
    if catalogue.damaged:
        from ..reading.reader import Reader
        from ..reading.verifier import examine

        damage = examine(Reader(catalogue.source, scan=True, limits=catalogue.limits))
        catalogue = damage.catalogue
    told = None if catalogue.indexed else damage.as_json()
    return damage, describe(catalogue) | {"damage": told}


def with_its_events(file: str, limits: Limits) -> tuple[DamageReport, dict[str, Any]]:
    from ..reading.reader import Reader

    with Reader(input_of(file), limits=limits) as reader:
        damage, found = facts(reader.catalogue)
        return damage, {**found, "events": events_json(reader.events())}


def describe(catalogue: Catalogue) -> dict[str, Any]:
    """All facts of info, for JSON."""
    head = catalogue.head
    return {
        "format": "hapf",
        "file_size": catalogue.source.size,
        "version": f"{head.major}.{head.minor}" if head else None,
        "level": catalogue.level.number,
        "file_id": None if catalogue.file_id is None else id_text(catalogue.file_id),
        "uuid": str(catalogue.uuid) if catalogue.uuid else None,
        "epoch_ns": head.epoch_ns if head else None,
        "epoch_uncertainty_ns": head.epoch_uncertainty_ns if head else None,
        "duration_s": float(catalogue.duration) if catalogue.duration or catalogue.closed else None,
        "closed": catalogue.closed,
        "indexed": catalogue.indexed,
        "cluster_count": len(catalogue.data),
        "track_count": len(catalogue.tracks),
        "channels": [channel_json(ref) for ref in catalogue.channels],
        "layers": [layer_json(layer) for layer in catalogue.layers],
        "clocks": clocks_json(catalogue),
        "encoder": head.encoder if head else None,
        "metadata": catalogue.metadata,
        "attachments": [
            {"name": name, "media_type": a.media_type, "size": len(a.content)}
            for name, a, _ in catalogue.named_attachments()
        ],
        "unknown_chunks": [header.type for header in catalogue.unknown],
        "unsupported": str(catalogue.unsupported) if catalogue.unsupported else None,
        "findings": [finding.as_json() for finding in catalogue.findings],
        "exit_code": catalogue.exit_code,
    }


def channel_json(ref: ChannelRef) -> dict[str, Any]:
    component = ref.track.components[ref.index]
    contract = ref.parts[0].contract
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
        "tracks": [
            {
                "id": t.id,
                "kind": t.kind,
                "codec": t.codec,
                "continues": t.continues,
                "contract": t.contract and contract_json(t.contract, ref.index),
            }
            for t in ref.tracks
        ],
        "contract": contract and contract_json(contract, ref.index),
        "kept_as": unsupported_of(ref) or ref.kept_as,
        "deviation": component.deviation
        and {"declared": component.deviation[0], "largest": component.deviation[1]},
        "exact": any(track.codec == "LPCX" for track in ref.tracks),
        "synthetic": ref.synthetic,
        "unsupported": unsupported_of(ref),
    }


def clocks_json(catalogue: Catalogue) -> list[dict[str, Any]]:
    """Each clock on each channel, with the number of its observations and of its map's points."""
    counts = Counter((seen.clock, seen.channel) for seen in catalogue.clocks)
    points = {(found.clock, found.channel): len(found.points) for found in catalogue.clock_maps}
    tracks: dict[int | str | None, int] = {ref.number: ref.track.id for ref in catalogue.channels}
    return [
        {
            "clock": clock,
            "track": tracks.get(channel),
            "observation_count": counts[clock, channel],
            "point_count": points.get((clock, channel), 0),
        }
        for clock, channel in dict.fromkeys([*counts, *points])
    ]


def layer_json(layer: Track) -> dict[str, Any]:
    return {
        "track": layer.id,
        "label": layer.components[0].label,
        "device": layer.components[0].device,
        "rate_num": layer.rate.numerator,
        "rate_den": layer.rate.denominator,
        "provenance": layer.provenance,
        "unsupported": layer.unsupported,
    }


def contract_json(contract: Contract, index: int) -> dict[str, Any]:
    """The error bound of the component with this index; an unsupported track may have fewer."""
    index = min(index, len(contract.floor) - 1)
    return {
        "kn": contract.kn,
        "kd": contract.kd,
        "vector": contract.vector,
        "guaranteed": contract.guaranteed,
        "floor": contract.floor[index],
        "zero": contract.zero[index],
    }


def unsupported_of(ref: ChannelRef) -> str | None:
    """Why a channel is unsupported: the first reason of its tracks that are not HF."""
    reasons = [part.track.unsupported for part in ref.parts]
    return next((reason for reason in reasons if reason), None)


def show(file: str, damage: DamageReport, found: dict[str, Any]) -> None:
    catalogue = damage.catalogue
    closed = "closed" if found["closed"] else f"NOT{JOINED}CLOSED"
    say(
        f"{file}: hapf {found['version']} level {found['level']}, "
        f"{found['file_size']} bytes, {span_text(catalogue)}, "
        f"{counted(found['cluster_count'], 'cluster')}, "
        f"{counted(found['track_count'], 'track')}, {closed}"
    )
    if found["uuid"] is not None:
        say(f"uuid: {found['uuid']}")
    if found["epoch_ns"] is not None:
        say(f"epoch_ns: {found['epoch_ns']}{date_text(found['epoch_ns'])}")
    rows = [channel_row(ref) for ref in catalogue.channels]
    if rows:
        headers = [
            Column("label"), Column("#", 4), Column("unit", 2), Column("rate, Hz", 1),
            Column("step", 3), Column("kept as"), Column("codecs", 5),
        ]  # fmt: skip
        table(headers, rows)
    for layer in catalogue.layers:
        name = layer.components[0].label or "without a name"
        say(f"layer of events: {name} (track {layer.id}, {layer.rate} ticks/s)")
    for clock in found["clocks"]:
        ticks = "ns" if clock["track"] is None else f"ticks of track {clock['track']}"
        points = clock["point_count"]
        mapped = f", mapped by {counted(points, 'point')}" if points else ""
        count = counted(clock["observation_count"], "observation")
        say(f"clock: {clock['clock']} ({count} by {ticks}{mapped})")
    show_events(found.get("events"))
    for key, value in catalogue.described.items():
        for text in metadata_texts(key, value):
            say(text)
        if key == "encoder" and "(texture " in str(value):
            from ..split import LF_CUTOFF_HZ, split_text

            cutoff = re.search(r"--cutoff ([\d.]+)", str(value))
            say(f"texture: {split_text(float(cutoff[1]) if cutoff else LF_CUTOFF_HZ)}")
    for attachment in found["attachments"]:
        say(f"attachment: {attachment['name']} ({attachment['size']} bytes)")
    tell_some(damage.lines())
    if catalogue.unsupported:
        complain(str(catalogue.unsupported))


def span_text(catalogue: Catalogue) -> str:
    """The length; the times of a recording that does not start at 0 come first."""
    stop = float(catalogue.duration)
    starts = [chunk.start_ns for chunk in catalogue.data if chunk.start_ns is not None]
    start = min(starts, default=0) / 1e9
    if not stop and not catalogue.closed:
        return "of unknown length"
    if not 0 < start < stop:
        return f"{stop:.6g} s"
    return f"{start:.6g} s to {stop:.6g} s ({stop - start:.6g} s)"


def date_text(epoch_ns: int) -> str:
    """Date and time; empty beyond the calendar of Python."""
    from datetime import UTC, datetime, timedelta

    try:
        moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=epoch_ns // 10**9)
    except OverflowError:
        return ""
    return f" ({moment:%Y-%m-%dT%H:%M:%SZ})"


def metadata_texts(key: str, value: Any) -> list[str]:
    """Lines for a person: one for each note; long nested values are shortened."""
    if isinstance(value, str):
        return [f"{key}: {value}"]
    if key == "notes" and isinstance(value, list) and all(isinstance(x, str) for x in value):
        return [f"note: {each}" for each in value]
    if key == "source_units" and isinstance(value, dict):
        return source_unit_texts(value)
    text = json.dumps(value, ensure_ascii=False)
    if len(text) <= SHOWN_CHARACTERS:
        return [f"{key}: {text}"]
    return [f"{key}: {text[:SHOWN_CHARACTERS]} ... ({len(text)} characters; --json shows all)"]


def source_unit_texts(units: dict[str, Any]) -> list[str]:
    """A line for each unit text of the source, and the channels that have it."""
    labels: dict[str, list[str]] = {}
    for label, text in units.items():
        labels.setdefault(str(text), []).append(label)
    lines = []
    for text, names in labels.items():
        shown = ", ".join(names[:3])
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        lines.append(f"source unit {text!r}: {shown}{more}")
    return lines


def channel_row(ref: ChannelRef) -> list[str]:
    component = ref.track.components[ref.index]
    rate = ref.track.rate
    a, _, d = component.calibration
    step = f"{a / d:.6g}" if ref.track.number_format == "counts" else ref.track.number_format
    codings = [" + ".join(f"{t.codec} {t.kind}" for t in part.tracks) for part in ref.parts]
    return [
        component.label or f"channel {ref.number}",
        str(ref.number),
        unit_text(component.unit) or "-",
        str(rate.numerator) if rate.denominator == 1 else f"{float(rate):.6g}",
        step,
        unsupported_of(ref) or joined(ref.kept_as),
        ", then ".join(text for text, _ in groupby(codings)),
    ]
