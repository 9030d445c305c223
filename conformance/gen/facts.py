"""Whole files of tracks as facts, and all that is expected of them; what sets/ begin with.

``recording`` makes the file, ``intact``, ``refused``, ``damaged`` what is expected, ``case_of``
both.
Imports nothing from hapfmt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import forge as f
from case import DAMAGED, INTACT, NONCONFORMING, UNSUPPORTED, Case
from tracks import Event, Layer, Packet, Track, decode_of, digest, double_bits, double_of

__all__ = [
    "Event",
    "Layer",
    "Packet",
    "Track",
    "case_of",
    "closed_at",
    "damaged",
    "decode_of",
    "digest",
    "double_bits",
    "double_of",
    "expectation",
    "intact",
    "milliseconds",
    "nanoseconds",
    "needs_of",
    "recording",
    "refused",
]

VERDICTS = {
    INTACT: "intact", NONCONFORMING: "nonconforming", DAMAGED: "damaged",
    UNSUPPORTED: "unsupported",
}  # fmt: skip


def needs_of(*tracks: Track, layers: Sequence[Layer] = (), level: int = 1) -> dict[str, Any]:
    codecs = {track.codec for track in tracks} | {"EVNT" for _ in layers}
    return {"codecs": sorted(codecs), "level": level}


def expectation(verdict: int, **members: Any) -> dict[str, Any]:
    """Every verb ends with the code of the verdict, but for those of ``exit``: a code, a list of
    codes one of which it is, or None where the verb is not run."""
    exits = {"decode": verdict, "verify": verdict, "recover": verdict} | members.pop("exit", {})
    out = {
        "needs": members.pop("needs", {"codecs": [], "level": 1}),
        "exit": {verb: code for verb, code in exits.items() if code is not None},
        "verdict": VERDICTS[verdict],
    }
    return out | {name: value for name, value in members.items() if value is not None}


def intact(*tracks: Track, layers: Sequence[Layer] = (), level: int = 1, recovered: Any = None,
           **more: Any) -> dict[str, Any]:  # fmt: skip
    """A file with nothing to complain about. ``recovered``: members of what the recovered file
    decodes to that are not those of ``more``; the file id is a new one, and offsets are others."""
    decode = decode_of(*tracks, layers=layers, **more)
    kept = {name: value for name, value in decode.items() if name not in ("head", "unknown")}
    if "head" in more:
        staying = ("level", "uuid", "epoch_ns", "epoch_uncertainty_ns")
        kept["head"] = {name: more["head"][name] for name in staying if name in more["head"]}
    kept |= recovered or {}
    return expectation(
        INTACT,
        needs=needs_of(*tracks, layers=layers, level=level),
        decode=decode,
        verify={"damages": [], "lost": []},
        recover=None if kept == decode else {"verdict": "intact", "decode": kept},
    )


def refused(requirement: str, *tracks: Track, exit: Any = None, level: int = 1,
            **more: Any) -> dict[str, Any]:  # fmt: skip
    """A file that breaks a rule although its checksums hold. ``tracks`` and ``more``: what those
    decoders give who need not look at what is broken; ``exit`` of ``decode`` is then [0, 2]."""
    codes = {"decode": [0, 2] if tracks or more else 2, "recover": None}
    return expectation(
        NONCONFORMING,
        needs=needs_of(*tracks, level=level),
        exit=codes | (exit or {}),
        decode=decode_of(*tracks, **more) if tracks or more else None,
        verify={"requirement": requirement},
    )


def damaged(damages: Sequence[Sequence[Any]], lost: Sequence[Sequence[Any]], *tracks: Track,
            exit: Any = None, level: int = 1, layers: Sequence[Layer] = (),
            recovered: Any = None, **more: Any) -> dict[str, Any]:  # fmt: skip
    """``damages``: (code, offset, size); ``lost``: (track, start, stop or None); ``tracks``: with
    those packets alone that are still delivered."""
    return expectation(
        DAMAGED,
        needs=needs_of(*tracks, layers=layers, level=level),
        exit=exit or {},
        decode=decode_of(*tracks, layers=layers, **more),
        verify={"damages": [list(row) for row in damages], "lost": [list(row) for row in lost]},
        recover=None if recovered is None else {"verdict": "intact", "decode": recovered},
    )


def nanoseconds(stop: int, rate: tuple[int, int]) -> int:
    """Rounded up, at most the largest i64."""
    return min(-(-stop * rate[1] * 10**9 // rate[0]), 2**63 - 1)


def milliseconds(start: int, stop: int, rate: tuple[int, int]) -> tuple[int, int]:
    """Rounded down and up, below 2^53."""
    last = 2**53 - 1
    begin, end = start * rate[1] * 1000 // rate[0], -(-stop * rate[1] * 1000 // rate[0])
    return min(begin, last), min(end, last)


def recording(*tracks: Track, layers: Sequence[Layer] = (), before: Sequence[Any] = (),
              more: Sequence[Any] = (), head: bytes | None = None, level: int = 1,
              late: Sequence[int] = (), squeeze: int | None = None,
              **footer: Any) -> bytes:  # fmt: skip
    """HEAD, TRAK chunks, ``before``, the clusters, ``more``, a true index and the footer.
    ``late``: ids of tracks that are described only after cluster 0. ``squeeze``: kind of block of
    the DEFLATE streams that describe the others."""
    rows, stops, times = [], [0], {}
    for track in tracks:
        rows += [(p.cluster, track.id, p.start, p.span, p.body) for p in track.packets]
    for layer in layers:
        rows += layer.rows()
    rates = {track.id: track.rate for track in (*tracks, *layers)}
    for cluster, track_id, start, span, _ in rows:
        rate = rates[track_id]
        stops.append(nanoseconds(start + span, rate))
        begin, end = milliseconds(start, start + span, rate)
        a, b = times.get(cluster, (begin, end))
        times[cluster] = min(a, begin), max(b, end)
    late_ones = [track.chunk for track in (*tracks, *layers) if track.id in late]
    if head is None:
        head = f.head(level=level)
    chunks: list[Any] = [("HEAD", head)]
    for track in (*tracks, *layers):
        if getattr(track, "joined", False):
            type_, payload = chunks[-1]
            chunks[-1] = (type_, payload + track.record)
        elif track.id not in late:
            chunks.append(track.chunk)
    if squeeze is not None:
        chunks = [
            (type_, f.squeezed(payload, squeeze) if type_ == "TRAK" else payload)
            for type_, payload in chunks
        ]
    chunks += before
    for number in sorted(times):
        chunks.append(("DATA", f.cluster(*sorted(row[1:] for row in rows if row[0] == number))))
        if number == 0:
            chunks += late_ones
    chunks += more
    return closed_at(chunks, [times[number] for number in sorted(times)], max(stops), **footer)


def closed_at(chunks: Sequence[Any], times: Sequence[tuple[int, int]], duration_ns: int,
              **footer: Any) -> bytes:  # fmt: skip
    """``times``: (start, stop) in milliseconds of each DATA chunk."""
    at, entries, left = len(f.SIGNATURE), [], list(times)
    for type_, payload, *_ in chunks:
        start, stop = left.pop(0) if type_ == "DATA" else (0, 0)
        entries.append((type_, at, start, stop))
        at += f.HEADER + len(payload)
    ahead = {"entries": entries} | footer.pop("ahead", {})
    return f.closed(*chunks, ahead=ahead, **({"duration_ns": duration_ns} | footer))


def case_of(set_: str, name: str, about: str, requirements: Sequence[str], *tracks: Track,
            layers: Sequence[Layer] = (), level: int = 1, file: dict[str, Any] | None = None,
            data: bytes | None = None, **more: Any) -> Case:  # fmt: skip
    """An intact file. ``file``: what ``recording`` is told besides; ``more``: members of
    ``decode``."""
    if data is None:
        data = recording(*tracks, layers=layers, level=level, **(file or {}))
    expect = intact(*tracks, layers=layers, level=level, **more)
    return Case(set_, name, about, requirements, data, expect)
