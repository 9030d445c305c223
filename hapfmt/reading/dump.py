"""All of a file as JSON values, chunk by chunk in the order of the bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any
from uuid import UUID

from ..format.clocks import parse_clock, parse_map
from ..format.cluster import Packet, parse_cluster
from ..format.description import parse_description
from ..format.extras import parse_attachment, parse_metadata
from ..format.index import parse_foot, parse_index
from ..format.salvage import salvage_cluster
from ..format.source import Source
from ..format.track import Component, Track
from ..format.walk import Chunk, Finding, walk
from ..format.wire import parse_head
from ..errors import HapfmtError, LimitError
from ..limits import Limits
from .catalogue import Catalogue
from .opening import open_catalogue

NUMBERS_SHARE = 4
"""The numbers of so many times fewer samples than a packet may have are told of a chunk, since each
takes 100 to 200 bytes as text: all that a cluster of level 1 holds, unless the caller's limits are
lower. A few bytes can stand for 2^28 at level 2."""


def dump(
    source: Source, *, counts: bool = False, limits: Limits | None = None
) -> Iterator[dict[str, Any]]:
    """One JSON object for each chunk, then one with the findings; ``counts`` decodes packets."""
    catalogue = open_catalogue(source, scan=True, limits=limits)
    findings: list[Finding] = []
    for chunk in walk(source, findings, catalogue.file_id):
        entry: dict[str, Any] = {
            "offset": chunk.offset,
            "intact": chunk.intact,
            **{name: value for name, value in vars(chunk.header).items() if name != "file_id"},
        }
        try:
            entry |= content(catalogue, chunk, counts)
        except HapfmtError as error:
            entry["error"] = str(error)
        yield entry
    yield {
        "findings": [finding.as_json() for finding in catalogue.findings],
        "exit_code": catalogue.exit_code,
    }


def content(catalogue: Catalogue, chunk: Chunk, counts: bool) -> dict[str, Any]:
    """What the payload says."""
    payload, at = chunk.payload, chunk.payload_offset
    kind = chunk.header.type
    if kind == "DATA":
        return {"packets": packets_json(catalogue, chunk, counts)}
    if not chunk.intact or not chunk.header.known:
        return {"sha256": hashlib.sha256(payload).hexdigest()}
    if kind == "HEAD":
        head = parse_head(payload, at)
        uuid = str(UUID(bytes=head.uuid)) if head.uuid else None
        return {"head": {**vars(head), "uuid": uuid}}
    if kind == "TRAK":
        tracks = parse_description(payload, chunk.header.track, catalogue.level, at)
        return {"tracks": [track_json(track) for track in tracks]}
    if kind == "iNDX":
        index = parse_index(payload, chunk.offset, at)
        entries = [entry._asdict() for entry in index.entries]
        return {"index": {**index._asdict(), "entries": entries}}
    if kind == "fOOT":
        return {"foot": parse_foot(payload, at)._asdict()}
    if kind == "mETa":
        return {"metadata": parse_metadata(payload, at)}
    if kind == "aTTc":
        found = parse_attachment(payload, at)
        digest = hashlib.sha256(found.content).hexdigest()
        return {
            "attachment": {
                "name": found.name,
                "media_type": found.media_type,
                "size": len(found.content),
                "sha256": digest,
            }
        }
    if kind in ("cLOk", "cMAp"):
        catalogue.limits.check_metadata(len(payload), at)
        return clock_json(chunk)
    if kind == "dGST":
        return {"digests": [payload[i : i + 32].hex() for i in range(0, len(payload), 32)]}
    return {"sha256": hashlib.sha256(payload).hexdigest()}


def clock_json(chunk: Chunk) -> dict[str, Any]:
    if chunk.header.type == "cMAp":
        found = parse_map(chunk.payload, chunk.header.track, chunk.payload_offset)
        return {"clock": found.clock, "points": [list(point) for point in found.points]}
    seen = parse_clock(chunk.payload, chunk.header.track, chunk.payload_offset)
    rows = [[each.tick, each.time_ns, each.uncertainty_ns] for each in seen]
    return {"clock": seen[0].clock, "observations": rows}


def packets_json(catalogue: Catalogue, chunk: Chunk, counts: bool) -> list[dict[str, Any]]:
    read: Callable[..., Iterable[Any]] = parse_cluster if chunk.intact else salvage_cluster
    tracks, level, seed = catalogue.tracks, catalogue.level, chunk.header.cluster_seed
    packets = read(chunk.payload, tracks, level, chunk.payload_offset, seed)
    out = []
    told = 0
    for packet in packets:
        if not isinstance(packet, Packet):
            out.append({"damaged": True})
            continue
        row: dict[str, Any] = {
            "track": packet.track,
            "start": packet.start,
            "span": packet.span,
            "size": len(packet.data),
            "sha256": hashlib.sha256(packet.data).hexdigest(),
        }
        if counts:
            told += catalogue.tracks[packet.track].weight(packet.span, len(packet.data))
            if told > catalogue.limits.packet_samples // NUMBERS_SHARE:
                raise LimitError(
                    "one chunk has too many samples to print; use hapfmt decode instead",
                    requirement="LIM-003",
                    offset=packet.offset,
                )
            row |= numbers_json(catalogue, packet)
        out.append(row)
    return out


def numbers_json(catalogue: Catalogue, packet: Packet) -> dict[str, Any]:
    """[ticks][components] counts, or words as unsigned integers, exact values likewise; or
    events."""
    from .decoder import TrackDecoder

    track = catalogue.tracks[packet.track]
    decoder = TrackDecoder(track, catalogue.level)
    if track.kind == "events":
        return {"events": [event._asdict() for event in decoder.decode_events(packet)]}
    numbers = decoder.decode(packet)
    exact = decoder.decode_exact(packet, numbers)
    if track.number_format != "counts":
        numbers = numbers.view(f"<u{numbers.dtype.itemsize}")
    beside = {} if exact is None else {"exact": exact.view("<u8").tolist()}
    return {"numbers": numbers.tolist(), **beside}


def track_json(track: Track) -> dict[str, Any]:
    contract = track.contract
    return {
        "id": track.id,
        "kind": track.kind,
        "codec": track.codec,
        "number_format": track.number_format,
        "rate_num": track.rate.numerator,
        "rate_den": track.rate.denominator,
        "count_min": track.count_min,
        "count_max": track.count_max,
        "first_channel": track.first_channel,
        "base": track.base,
        "continues": track.continues,
        "parameters": track.parameters.hex(),
        "provenance": track.provenance,
        "unsupported": track.unsupported,
        "contract": contract and contract._asdict(),
        "components": [component_json(component) for component in track.components],
    }


def component_json(component: Component) -> dict[str, Any]:
    deviation = component.deviation
    return {
        **vars(component),
        "calibration": component.calibration._asdict(),
        "deviation": deviation and {"declared": deviation[0], "largest": deviation[1]},
    }
