"""Prints a file as JSON values, chunk by chunk in the order of the bytes, and the use of its bytes.

The bytes of a file are listed by cause and by track, and add up to its size.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any
from uuid import UUID

from ..codecs.events import parse_events
from ..errors import FormatError, HapfmtError, LimitError
from ..format.cluster import Packet, parse_cluster, parse_table_head, salvage_cluster
from ..format.extras import (
    parse_attachment,
    parse_clock,
    parse_digests,
    parse_foot,
    parse_index,
    parse_map,
    parse_metadata,
)
from ..format.source import ByteSource
from ..format.track import Component, Track, parse_description
from ..format.walk import Chunk, Finding, walk
from ..format.wire import HEADER_SIZE, SIGNATURE, parse_head, uuid_of
from ..limits import Limits
from ..numbers import parse_varint
from .catalogue import Catalogue
from .opening import open_catalogue

NUMBERS_SHARE = 4
"""Samples printed per chunk are at most a quarter of those that the limits allow in a packet. As
text each takes 100 to 200 bytes. Unless the caller's limits are lower, this is a whole cluster of
level 1. At level 2 a few bytes can encode 2^28 samples."""


def dump(
    source: ByteSource, *, counts: bool = False, limits: Limits | None = None
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
        uuid = UUID(bytes=head.uuid or uuid_of(chunk.header.file_id))
        return {"head": {**vars(head), "uuid": str(uuid)}}
    if kind == "TRAK":
        tracks = parse_description(payload, catalogue.level, at)
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
        catalogue.limits.check("metadata", len(payload), at)
        return clock_json(chunk)
    if kind == "dGST":
        digests = parse_digests(payload, at)
        return {"track": min(digests), "digests": [each.hex() for _, each in digests.values()]}
    return {"sha256": hashlib.sha256(payload).hexdigest()}


def clock_json(chunk: Chunk) -> dict[str, Any]:
    if chunk.header.type == "cMAp":
        found = parse_map(chunk.payload, chunk.payload_offset)
        points = [list(point) for point in found.points]
        return {"clock": found.clock, "track": found.track, "points": points}
    seen = parse_clock(chunk.payload, chunk.payload_offset)
    rows = [list(row) for row in seen.rows]
    return {"clock": seen.clock, "track": seen.track, "observations": rows}


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
        "synthetic": track.synthetic,
        "number_format": track.number_format,
        "rate_num": track.rate.numerator,
        "rate_den": track.rate.denominator,
        "count_min": track.count_min,
        "count_max": track.count_max,
        "channels": [*track.channels],
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


CAUSES = (
    "signature",
    "chunk headers",
    "HEAD",
    "TRAK",
    "packet tables",
    "packets",
    "exact values",
    "iNDX",
    "fOOT",
    "mETa",
    "aTTc",
    "dGST",
    "cLOk",
    "cMAp",
    "other chunks",
    "damage",
)


@dataclass
class TrackUsage:
    """Bytes of one track: packets and how many of these are exact values, its rows in the packet
    tables; samples or events that they decode to."""

    id: int
    kind: str
    codec: str
    labels: list[str]
    packets_size: int = 0
    exact_size: int = 0
    table_size: int = 0
    parameters_size: int = 0
    packet_count: int = 0
    sample_count: int = 0
    event_count: int = 0


@dataclass
class Usage:
    """``causes`` add up to ``file``; ``payload`` is the bytes of all packets, with what of them are
    exact values, which ``causes`` books apart."""

    file: int
    causes: dict[str, int] = field(default_factory=lambda: dict.fromkeys(CAUSES, 0))
    tracks: dict[int, TrackUsage] = field(default_factory=dict)
    exit_code: int = 0

    @property
    def payload(self) -> int:
        return self.causes["packets"] + self.causes["exact values"]

    def as_json(self) -> dict[str, Any]:
        return {
            "file": self.file,
            "payload": self.payload,
            "causes": self.causes,
            "tracks": [vars(track) for track in self.tracks.values()],
        }


def measure(source: ByteSource, limits: Limits | None = None) -> Usage:
    """Walks through the whole file; decodes nothing."""
    catalogue = open_catalogue(source, scan=True, limits=limits)
    usage = Usage(source.size, exit_code=catalogue.exit_code)
    described = {t.id: parts[0].track for parts in catalogue.parts for p in parts for t in p.tracks}
    for track in catalogue.tracks.values():
        usage.tracks[track.id] = TrackUsage(
            track.id,
            track.kind,
            track.codec,
            [component.label for component in described.get(track.id, track).components],
            parameters_size=len(track.parameters),
        )
    causes = usage.causes
    findings: list[Finding] = []
    for chunk in walk(source, findings, catalogue.file_id):
        if not chunk.intact and chunk.header.type != "DATA":
            continue
        causes["chunk headers"] += HEADER_SIZE
        if chunk.header.type == "DATA":
            size = add_packets(usage, catalogue, chunk)
            causes["packet tables"] += (len(chunk.payload) - size) if chunk.intact else 0
            continue
        cause = chunk.header.type if chunk.header.type in causes else "other chunks"
        causes[cause] += len(chunk.payload)
    if source.read_at(0, len(SIGNATURE)) == SIGNATURE:
        causes["signature"] = len(SIGNATURE)
    causes["damage"] = usage.file - sum(causes.values())
    return usage


def add_packets(usage: Usage, catalogue: Catalogue, chunk: Chunk) -> int:
    """Book the packets of one DATA payload; returns their bytes."""
    try:
        read = parse_cluster if chunk.intact else salvage_cluster
        items = read(chunk.payload, catalogue.tracks, catalogue.level, 0, chunk.header.cluster_seed)
        packets = [item for item in items if isinstance(item, Packet)]
        row_size = parse_table_head(chunk.payload, catalogue.level, 0).row_size if packets else 0
    except FormatError:
        packets, row_size = [], 0
    for packet in packets:
        track = usage.tracks[packet.track]
        track.packets_size += len(packet.data)
        track.table_size += row_size
        track.exact_size += exact_size(packet, track.codec)
        track.packet_count += 1
        track.event_count += event_count(packet, track.codec)
        if track.kind != "events":
            track.sample_count += packet.span * len(catalogue.tracks[packet.track].components)
    size = sum(len(packet.data) for packet in packets)
    beside = sum(exact_size(packet, usage.tracks[packet.track].codec) for packet in packets)
    usage.causes["packets"] += size - beside
    usage.causes["exact values"] += beside
    return size


def event_count(packet: Packet, codec: str) -> int:
    if codec != "EVNT":
        return 0
    try:
        return len(parse_events(packet.data, packet.start, packet.span, packet.offset))
    except FormatError:
        return 0


def exact_size(packet: Packet, codec: str) -> int:
    """Bytes of a packet that its counts do not need (SPEC 9.7)."""
    if codec != "LPCX":
        return 0
    try:
        size, start = parse_varint(packet.data, 0)
    except FormatError:
        return 0
    return max(len(packet.data) - start - size, 0)
