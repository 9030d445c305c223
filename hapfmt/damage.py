"""The damage report: what is wrong with a file, and which samples that took (SPEC 12.2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from .container.walk import Finding
from .reading.catalogue import Catalogue, ChannelRef
from .reading.losses import LostSpan

SHOWN = 4
"""Channels named in a line."""


def damage_report(catalogue: Catalogue, lost: Sequence[LostSpan]) -> dict[str, Any]:
    """The JSON object of SPEC 12.2."""
    damages: list[dict[str, Any]] = [
        {**finding.as_json(), "lost": []} for finding in catalogue.findings
    ]
    by_offset: dict[int | None, list[dict[str, Any]]] = {}
    for damage in damages:
        by_offset.setdefault(damage["offset"], damage["lost"])
    apart: list[dict[str, Any]] = []
    channels = by_track(catalogue)
    for span in lost:
        numbers = [ref.number for ref in channels.get(span.track, [])]
        by_offset.get(span.offset, apart).append(span_json(catalogue, span, numbers))
    return {
        "damages": damages,
        "lost": apart,
        "byte_count": damaged_bytes(catalogue.findings, catalogue.source.size),
        "channels": channels_json(catalogue, channels, lost),
    }


def by_track(catalogue: Catalogue) -> dict[int, list[ChannelRef]]:
    """The channels that each track is a part of."""
    found: dict[int, list[ChannelRef]] = {}
    for ref in catalogue.channels:
        for track in ref.tracks:
            found.setdefault(track.id, []).append(ref)
    return found


def span_json(catalogue: Catalogue, span: LostSpan, channels: list[int]) -> dict[str, Any]:
    track = catalogue.tracks.get(span.track)
    rate = track.rate if track else None
    return {
        "track": span.track,
        "channels": channels,
        "start": span.start,
        "stop": span.stop,
        "start_s": float(span.start / rate) if rate else None,
        "stop_s": float(span.stop / rate) if rate and span.stop is not None else None,
    }


def channels_json(
    catalogue: Catalogue, channels: dict[int, list[ChannelRef]], lost: Iterable[LostSpan]
) -> list[dict[str, Any]]:
    """At most how many ticks of each channel are lost in full band."""
    spans: dict[int, list[tuple[int, int]]] = {}
    open_ended: set[int] = set()
    for span in lost:
        for ref in channels.get(span.track, []):
            if span.stop is None:
                open_ended.add(ref.number)
            else:
                spans.setdefault(ref.number, []).append((span.start, span.stop))
    out = []
    for ref in catalogue.channels:
        places = joined(sorted(spans.get(ref.number, [])))
        count = None if ref.number in open_ended else sum(stop - start for start, stop in places)
        out.append(
            {
                "channel": ref.number,
                "label": ref.label,
                "lost_ticks": count,
                "lost_s": None if count is None else float(count / ref.track.rate),
            }
        )
    return out


def damaged_bytes(findings: Iterable[Finding], size: int) -> int:
    places = sorted((f.offset, min(f.offset + f.size, size)) for f in findings if f.size)
    return sum(stop - start for start, stop in joined(places))


def joined(spans: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Ordered spans, those that overlap or touch as one."""
    current: tuple[int, int] | None = None
    for start, stop in spans:
        if current is not None and start <= current[1]:
            current = current[0], max(current[1], stop)
            continue
        if current is not None:
            yield current
        current = start, stop
    if current is not None:
        yield current


def lost_lines(catalogue: Catalogue, lost: Iterable[LostSpan]) -> list[str]:
    """For people: each span with its channels and seconds."""
    channels = by_track(catalogue)
    lines = []
    for span in lost:
        track = catalogue.tracks.get(span.track)
        if track is None:
            lines.append(f"lost: track {span.track}, whose description is lost")
            continue
        names = [ref.label or f"channel {ref.number}" for ref in channels.get(track.id, [])]
        shown = ", ".join(names[:SHOWN]) or f"track {track.id}"
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        kind = {"lf": " (LF)", "hf": " (HF)"}.get(track.kind, "")
        start = float(span.start / track.rate)
        stop = "the end" if span.stop is None else f"{float(span.stop / track.rate):.6g} s"
        lines.append(f"lost: {shown}{more}{kind} from {start:.6g} s to {stop}")
    return lines
