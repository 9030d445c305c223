"""The verb decode: all that a file delivers (SPEC clauses 10 and 14), as JSON and raw numbers."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hapfmt.codecs.events import CodedEvent
from hapfmt.errors import FormatError, verdict_of
from hapfmt.format.extras import parse_clock, parse_map
from hapfmt.format.track import Track, first_of, parse_fields, split
from hapfmt.format.walk import read_chunk
from hapfmt.format.wire import HEADER_SIZE, KNOWN_TYPES, id_text
from hapfmt.reading.catalogue import Catalogue, ChannelRef, ChunkRef
from hapfmt.reading.decoder import Assembly, Band, Decoded
from hapfmt.reading.reader import Reader
from hapfmt.recording import Channel, Span

from .raw import write_json, write_numbers

TEXTS = ("label", "unit", "quantity", "axis", "group", "body_site", "device")


def decode_into(source: str, folder: str) -> int:
    """Writes decode.json and raw files; the exit code of SPEC clause 13."""
    room = Path(folder)
    with Reader(source, scan=True) as reader:
        try:
            write_json(room / "decode.json", decoded(reader, room))
        except FormatError as error:
            codes = (finding.code for finding in reader.findings)
            return verdict_of(codes, error=error, unknown=reader.catalogue.not_understood)
        return reader.exit_code


def decoded(reader: Reader, room: Path) -> dict[str, Any]:
    catalogue = reader.catalogue
    tracks, layers = decode_tracks(reader)
    reader.lost.extend(reader.lost_parts(catalogue.channels, "full"))
    return {
        "head": head_json(catalogue),
        "tracks": [
            track_json(catalogue, tracks[id_], room)
            for id_ in sorted(tracks)
            if not tracks[id_].track.unsupported
        ],
        "channels": channels_json(catalogue, tracks, room),
        "lf": band_json(catalogue, tracks, "lf", room),
        "hf": band_json(catalogue, tracks, "hf", room),
        "layers": [layer_json(catalogue, layer, layers[layer.id]) for layer in known(catalogue)],
        "clocks": clocks_json(catalogue),
        "maps": maps_json(catalogue),
        "metadata": metadata_of(catalogue),
        "attachments": list(attachments_json(catalogue)),
        "unknown": unknown_of(catalogue),
    }


def decode_tracks(reader: Reader) -> tuple[dict[int, Decoded], dict[int, list[CodedEvent]]]:
    """Numbers and events by track ids, nothing of those that are unsupported."""
    all_tracks = reader.catalogue.tracks.values()
    tracks = {track.id: Decoded(track) for track in all_tracks if track.kind != "events"}
    layers: dict[int, list[CodedEvent]] = {layer.id: [] for layer in known(reader.catalogue)}
    samples = events = 0
    supported = [track for track in all_tracks if not track.unsupported]
    for piece in reader.pieces(supported, exact=True):
        if piece.track.kind == "events":
            layers[piece.track.id] += piece.events
            events += len(piece.events)
            reader.limits.check("events", events)
        else:
            samples += piece.numbers.size
            reader.limits.check("samples", samples)
            tracks[piece.track.id].add(piece.start, piece.numbers, piece.exact)
    return tracks, layers


def known(catalogue: Catalogue) -> list[Track]:
    """The layers that are supported."""
    return [layer for layer in catalogue.layers if not layer.unsupported]


def head_json(catalogue: Catalogue) -> dict[str, Any] | None:
    head = catalogue.head
    if head is None or catalogue.file_id is None:
        return None
    dated = head.epoch_ns is not None
    return {
        "major": head.major,
        "minor": head.minor,
        "level": head.level,
        "file_id": id_text(catalogue.file_id),
        "uuid": catalogue.uuid.hex if catalogue.uuid else None,
        "epoch_ns": str(head.epoch_ns) if dated else None,
        "epoch_uncertainty_ns": str(head.epoch_uncertainty_ns) if dated else None,
    }


def stored_rate(catalogue: Catalogue, track: Track) -> list[int]:
    """The rate in the file, not reduced."""
    chunk = read_chunk(catalogue.source, track.offset - HEADER_SIZE)
    assert chunk is not None
    records = split(chunk.payload, catalogue.level, track.offset)
    fields, _ = parse_fields(records[track.id - first_of(chunk.payload)], 0, 0)
    return [fields.rate_num, fields.rate_den]


def spans_json(spans: Sequence[Span]) -> list[list[int]]:
    return [[span.start, span.stop] for span in spans]


def track_json(catalogue: Catalogue, found: Decoded, room: Path) -> dict[str, Any]:
    track = found.track
    return {
        "track": track.id,
        "kind": track.kind,
        "codec": track.codec,
        "number_format": track.number_format,
        "component_count": len(track.components),
        "rate": stored_rate(catalogue, track),
        "spans": spans_json(found.spans),
        "numbers": write_numbers(room, f"track-{track.id}.raw", found.numbers()),
    }


def channels_json(
    catalogue: Catalogue, tracks: dict[int, Decoded], room: Path
) -> list[dict[str, Any]]:
    assembly = Assembly(tracks, "full")
    out = []
    for ref in supported_channels(catalogue):
        channel, name = assembly.channel(ref), f"channel-{ref.number}"
        calibration = channel.calibration
        one: dict[str, Any] = {"channel": ref.number}
        one |= {text: getattr(channel, text) for text in TEXTS}
        one |= {
            "rate": stored_rate(catalogue, ref.track),
            "calibration": [calibration.a, calibration.b, calibration.d]
            if calibration
            else [1, 0, 1],
            "spans": spans_json(channel.coverage),
            "numbers": write_numbers(room, f"{name}.raw", channel.stored),
        }
        if calibration:
            values = calibration.physical(channel.stored)
            one["physical"] = write_numbers(room, f"{name}.physical", values)
        if has_exact(ref):
            one["exact"] = write_numbers(room, f"{name}.exact", channel.samples())
        out.append(one)
    return out


def supported_channels(catalogue: Catalogue) -> Iterator[ChannelRef]:
    """Channels of which a track can be decoded."""
    for ref in catalogue.channels:
        if any(not part.track.unsupported for part in ref.parts):
            yield ref


def has_exact(ref: ChannelRef) -> bool:
    return any(part.track.codec == "LPCX" and not part.track.unsupported for part in ref.parts)


def band_json(
    catalogue: Catalogue, tracks: dict[int, Decoded], band: Band, room: Path
) -> list[dict[str, Any]]:
    """What DEC-005 delivers of each channel, but for those of which that is nothing."""
    assembly = Assembly(tracks, band)
    out = []
    for ref in supported_channels(catalogue):
        channel: Channel = assembly.channel(ref)
        if channel.coverage:
            name = write_numbers(room, f"{band}-{ref.number}.raw", channel.stored)
            spans = spans_json(channel.coverage)
            out.append({"channel": ref.number, "spans": spans, "numbers": name})
    return out


def layer_json(catalogue: Catalogue, layer: Track, events: list[CodedEvent]) -> dict[str, Any]:
    """EVT-004: in order of ticks, those of one tick in the order of the file."""
    return {
        "track": layer.id,
        "label": layer.components[0].label,
        "rate": stored_rate(catalogue, layer),
        "events": [list(event) for event in sorted(events, key=lambda event: event.tick)],
    }


def clocks_json(catalogue: Catalogue) -> list[dict[str, Any]]:
    return [
        {
            "track": seen.track,
            "name": seen.clock,
            "observations": [[tick, str(time), str(unsure)] for tick, time, unsure in seen.rows],
        }
        for seen in catalogue.parsed_clocks("cLOk", parse_clock)
    ]


def maps_json(catalogue: Catalogue) -> list[dict[str, Any]]:
    return [
        {
            "track": found.track,
            "name": found.clock,
            "points": [[tick, str(time_ns)] for tick, time_ns in found.points],
        }
        for found in catalogue.parsed_clocks("cMAp", parse_map)
    ]


def intact(catalogue: Catalogue, ref: ChunkRef) -> bool:
    chunk = read_chunk(catalogue.source, ref.offset, catalogue.file_id)
    return chunk is not None and chunk.intact


def metadata_of(catalogue: Catalogue) -> dict[str, Any] | None:
    """None where no chunk gives any."""
    lost = {finding.offset for finding in catalogue.findings if finding.code == "bad-chunk"}
    there = any(
        ref.type == "mETa" and ref.offset not in lost and intact(catalogue, ref)
        for ref in catalogue.chunks
    )
    return catalogue.metadata if there else None


def attachments_json(catalogue: Catalogue) -> Iterator[dict[str, Any]]:
    size = 0
    for attachment, offset in catalogue.each_attachment():
        size += len(attachment.content)
        catalogue.limits.check("attachments", size, offset)
        yield {
            "name": attachment.name,
            "media_type": attachment.media_type,
            "size": len(attachment.content),
            "sha256": hashlib.sha256(attachment.content).hexdigest(),
        }


def unknown_of(catalogue: Catalogue) -> list[list[Any]]:
    """CHK-010; damaged ones are reported as damage."""
    return [
        [ref.type, ref.offset]
        for ref in catalogue.chunks
        if ref.type not in KNOWN_TYPES and ref.type[0].islower() and intact(catalogue, ref)
    ]
