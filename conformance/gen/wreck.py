"""Files of which every place is known, what can happen to their bytes, and what must be made of it.

Each sample is told by its track and tick, so what is kept can be written down as spans. What is
expected follows from SPEC 14 and the places of the file before it was damaged.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import forge as f
from case import Case, numbers

Packet = tuple[int, int, int, bytes]
Spans = Iterable[tuple[int, int]]
Damage = tuple[str, int, int]
Lost = tuple[int, int, int | None]
Chunk = tuple[str, bytes] | tuple[str, bytes, dict[str, Any]] | list[Packet]

HEADER = f.HEADER
MS = 10**6


def value(track: int, tick: int) -> int:
    """The count of each sample; one byte as a svarint, and so is the step to the next."""
    return (7 * tick + 23 * track) % 61 - 30


def knots(track: int, start: int, span: int) -> bytes:
    """A packet of KNOT, hold, with a knot at every tick: 2 * span - 1 bytes."""
    row = [value(track, start + tick) for tick in range(span)]
    steps = [b"\1" + f.svarint(b - a) for a, b in zip(row, row[1:], strict=False)]
    return f.svarint(row[0]) + b"".join(steps)


def packet(track: int, start: int, span: int = 4) -> Packet:
    return track, start, span, knots(track, start, span)


@dataclass(frozen=True)
class Row:
    """A packet and its entry in the table: where both stand."""

    track: int
    start: int
    entry: int
    entry_stop: int
    at: int
    stop: int

    @property
    def size(self) -> int:
        return self.stop - self.at


@dataclass(frozen=True)
class Place:
    """A chunk."""

    type: str
    sequence: int
    at: int
    stop: int
    rows: tuple[Row, ...]

    @property
    def payload(self) -> int:
        return self.at + HEADER

    @property
    def size(self) -> int:
        """Of header and payload."""
        return self.stop - self.at


@dataclass(frozen=True)
class Laid:
    data: bytes
    places: tuple[Place, ...]

    def of(self, type_: str, number: int = 0) -> Place:
        return [place for place in self.places if place.type == type_][number]

    def chunk(self, type_: str, number: int = 0) -> bytes:
        place = self.of(type_, number)
        return self.data[place.at : place.stop]

    def row(self, track: int, start: int) -> Row:
        rows = [row for place in self.places for row in place.rows]
        (found,) = [row for row in rows if (row.track, row.start) == (track, start)]
        return found


class Wide(list[Packet]):
    """A cluster each of whose fields has a byte in the rows."""


def cluster(packets: list[Packet]) -> f.Cluster:
    given = {"widths": (1, 1, 1, 1)} if isinstance(packets, Wide) else {}
    return f.cluster(*packets, **given)


def rows_of(packets: list[Packet], payload: int) -> tuple[Row, ...]:
    whole = cluster(packets)
    at = payload + len(whole) - sum(len(body) for *_, body in packets)
    columns = [[p[0] for p in packets], [len(p[3]) for p in packets]]
    columns += [[p[1] for p in packets], [p[2] for p in packets]]
    size = 4 + sum(f.bytes_of(max(column) - min(column)) for column in columns)
    size = 8 if isinstance(packets, Wide) else size
    entry = at - 4 - size * len(packets)
    out = []
    for track, start, _, body in packets:
        out.append(Row(track, start, entry, entry + size, at, at + len(body)))
        entry, at = entry + size, at + len(body)
    return tuple(out)


def lay(*chunks: Chunk, close: bool = True, indexed: bool = True,
        skip: Sequence[int] = ()) -> Laid:  # fmt: skip
    """A file of ``chunks``; a list of packets is a DATA chunk, of tracks of 1 kHz, so that a tick
    is a millisecond. ``close``: an index of all chunks, if ``indexed``, and a footer follow. An
    empty payload of iNDX is filled in: it lists all chunks before it. ``skip``: sequence numbers
    that are left out.
    """
    data, places, listed = bytearray(f.SIGNATURE), [], []
    sequence, stop_tick = 0, 0

    def add(type_: str, payload: bytes, given: Mapping[str, Any], rows: tuple[Row, ...]) -> None:
        nonlocal sequence
        while sequence in skip:
            sequence += 1
        at = len(data)
        data.extend(f.chunk(type_, payload, **({"sequence": sequence} | dict(given))))
        places.append(Place(type_, sequence, at, len(data), rows))
        sequence += 1

    for each in chunks:
        at = len(data)
        if isinstance(each, list):
            start, stop = min(p[1] for p in each), max(p[1] + p[2] for p in each)
            add("DATA", cluster(each), {}, rows_of(each, at + HEADER))
            listed.append(("DATA", at, start, stop))
            stop_tick = max(stop, stop_tick)
            continue
        type_, payload, *rest = each
        given = rest[0] if rest else {}
        add(type_, f.index(listed) if type_ == "iNDX" and not payload else payload, given, ())
        listed.append((type_, at, 0, 0))
    if close:
        index = len(data)
        if indexed:
            add("iNDX", f.index(listed), {}, ())
        add("fOOT", f.foot(len(data) - index, stop_tick * MS), {}, ())
    return Laid(bytes(data), tuple(places))


THREE: Chunk = ("TRAK", f.trak(track_count=3))
HEAD: Chunk = ("HEAD", f.head())


def clusters(*starts: int, tracks: int = 3) -> list[list[Packet]]:
    return [[packet(track, start) for track in range(tracks)] for start in starts]


STEADY = lay(HEAD, THREE, *clusters(0, 4, 8))
"""Three channels, twelve samples each in three clusters, closed."""

OPEN = lay(HEAD, THREE, *clusters(0, 4, 8), close=False)


def flip(data: bytes, at: int, bits: int = 1) -> bytes:
    return data[:at] + bytes([data[at] ^ bits]) + data[at + 1 :]


def without(data: bytes, start: int, stop: int | None = None) -> bytes:
    stop = start + 1 if stop is None else stop
    return data[:start] + data[stop:]


def with_bytes(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at:]


def over(data: bytes, at: int, new: bytes) -> bytes:
    """``new`` in place of as many bytes."""
    return data[:at] + new + data[at + len(new) :]


def spans_json(spans: Spans) -> list[list[int]]:
    return [list(span) for span in spans]


def row_numbers(track: int, spans: Spans) -> dict[str, Any]:
    return numbers([value(track, tick) for start, stop in spans for tick in range(start, stop)])


def decoded(kept: Mapping[int, Spans], channels: Mapping[int, int] | None = None) -> dict[str, Any]:
    """What is delivered of full-band tracks; ``channels``: by their numbers the tracks, -1 where
    none is left, by default the channels are the tracks."""
    channels = {track: track for track in kept} if channels is None else channels
    tracks = [
        {"track": track, "spans": spans_json(spans), "numbers": row_numbers(track, spans)}
        for track, spans in sorted(kept.items())
    ]
    found = []
    for number, track in sorted(channels.items()):
        spans = kept.get(track, ())
        out = {"spans": spans_json(spans), "numbers": row_numbers(track, spans)}
        found.append({"channel": number, **out})
    return {"tracks": tracks, "channels": found}


ALL = ((0, 12),)
"""Of each track of STEADY."""


def wrecked(
    name: str,
    about: str,
    requirements: Sequence[str],
    fault: str,
    data: bytes,
    *,
    damages: Iterable[Damage],
    lost: Iterable[Lost] = (),
    kept: Mapping[int, Spans] | None = None,
    decode: Mapping[str, Any] | None = None,
    recover: int | list[int] = 3,
    recovered: Mapping[str, Any] | None = None,
    codecs: Sequence[str] = ("KNOT",),
    verdict: str = "damaged",
    exits: Mapping[str, Any] | None = None,
) -> Case:
    """A case of set recoverable; ``kept`` by track, by default all of STEADY. ``recovered``: what
    the recovered file gives where that is something else, or another verdict."""
    found = dict(decoded(kept or dict.fromkeys(range(3), ALL)) if decode is None else decode)
    expect: dict[str, Any] = {
        "needs": {"codecs": list(codecs), "level": 1},
        "exit": {"decode": 3, "verify": 3, "recover": recover} | dict(exits or {}),
        "verdict": verdict,
        "decode": found,
        "verify": {
            "damages": [list(damage) for damage in damages],
            "lost": [list(span) for span in lost],
        },
        "recover": {"verdict": "intact", "decode": found} | dict(recovered or {}),
    }
    if not found:
        del expect["decode"]
        if not recovered or "decode" not in recovered:
            del expect["recover"]["decode"]
    return Case("recoverable", name, about, requirements, data, expect, fault)
