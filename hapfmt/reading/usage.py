"""Where the bytes of a file go: by cause and by track, adding up to its size."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..codecs.events import parse_events
from ..format.cluster import Packet, parse_cluster, parse_table_head
from ..format.salvage import salvage_cluster
from ..format.source import Source
from ..format.walk import Chunk, Finding, walk
from ..format.wire import HEADER_SIZE, SIGNATURE
from ..errors import FormatError
from ..integers import parse_varint
from ..limits import Limits
from .catalogue import Catalogue
from .opening import open_catalogue

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


def measure(source: Source, limits: Limits | None = None) -> Usage:
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
