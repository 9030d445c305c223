"""Tracks as facts: how they are described, their packets, and the numbers that these stand for.

``decode_of`` makes of them what a decoder must give (SPEC 10); facts.py the file, and all that is
expected. Imports nothing from hapfmt: a packet is told its bytes and its numbers.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import forge as f
from case import numbers

KINDS = ("full", "lf", "hf", "events")
FORMATS = ("counts", "int64", "uint64", "binary16", "binary32", "binary64")


class Packet(NamedTuple):
    """``rows``: a number for each tick, or for each tick the numbers of its components; counts
    as the track delivers them, clamped. ``exact``: the words of LPCX, likewise."""

    start: int
    rows: Sequence[Any]
    body: bytes
    cluster: int = 0
    exact: Sequence[Any] = ()

    @property
    def span(self) -> int:
        return len(self.rows)

    @property
    def stop(self) -> int:
        return self.start + len(self.rows)


class Event(NamedTuple):
    tick: int
    duration: int = 0
    channel: int | None = None
    text: str = ""


@dataclass(frozen=True, kw_only=True)
class Track:
    """``parameters``: of the codec (TLV 1). ``tlvs``: those behind it. ``joined``: the chunk of the
    track before it describes this one too. ``about``: label, unit and so on, of all components or
    of each. ``calibration``: (A, B, D), of all components or of each."""

    id: int = 0
    codec: str = "KNOT"
    kind: str = "full"
    number_format: str = "counts"
    width: int = 1
    rate: tuple[int, int] = (1000, 1)
    low: int = -100
    high: int = 100
    channel: int = 0
    base: int | None = None
    parameters: bytes | None = f.knot_parameters()
    tlvs: bytes = b""
    continues: int | None = None
    joined: bool = False
    packets: Sequence[Packet] = ()
    about: dict[str, str] | Sequence[dict[str, str]] = field(default_factory=dict)
    calibration: Any = None
    further: tuple[int, ...] = ()

    @property
    def channels(self) -> list[int]:
        follow = range(self.channel, self.channel + self.width)
        return [self.channel, *self.further] if self.further else list(follow)

    @property
    def words(self) -> bool:
        return self.number_format != "counts"

    @property
    def record(self) -> bytes:
        first = b"" if self.parameters is None else f.tlv(1, self.parameters)
        linked = self.base if self.continues is None else self.continues
        return f.track(
            first + self.tlvs,
            component_count=self.width,
            kind=KINDS.index(self.kind),
            number_format=FORMATS.index(self.number_format),
            codec=self.codec.encode(),
            rate_num=self.rate[0],
            rate_den=self.rate[1],
            count_min=0 if self.words else self.low,
            count_max=0 if self.words else self.high,
            first_channel=self.channel,
            linked=0 if linked is None else 1 + linked,
        )

    @property
    def chunk(self) -> f.Chunk:
        return "TRAK", f.tracks(self.record, first=self.id)

    def rows(self) -> dict[int, tuple[int, ...]]:
        """The numbers of each tick."""
        return {
            packet.start + i: tuple(row) if isinstance(row, (tuple, list)) else (row,)
            for packet in self.packets
            for i, row in enumerate(packet.rows)
        }

    def component(self, i: int) -> dict[int, int]:
        return {tick: row[i] for tick, row in self.rows().items()}

    def exact(self) -> dict[int, tuple[int, ...]]:
        """The words of each tick."""
        return {
            packet.start + i: tuple(row) if isinstance(row, (tuple, list)) else (row,)
            for packet in self.packets
            for i, row in enumerate(packet.exact)
        }

    def told(self, i: int) -> dict[str, Any]:
        """Members of component i's channel, without its samples."""
        texts = self.about if isinstance(self.about, dict) else self.about[i]
        out: dict[str, Any] = {"channel": self.channels[i], **texts, "rate": list(self.rate)}
        affine = self.affine(i)
        if affine is not None:
            out["calibration"] = list(affine)
        return out

    def affine(self, i: int) -> tuple[int, int, int] | None:
        given = self.calibration
        return given[i] if given and isinstance(given[0], (tuple, list)) else given


@dataclass(frozen=True, kw_only=True)
class Layer:
    """``packets``: (start, span, events in order of their ticks, and the cluster)."""

    id: int = 1
    label: str = ""
    rate: tuple[int, int] = (1_000_000, 1)
    packets: Sequence[tuple[Any, ...]] = ()
    tlvs: bytes | None = None

    @property
    def chunk(self) -> f.Chunk:
        tlvs = f.tlv(2, f.strings(self.label)) if self.tlvs is None else self.tlvs
        rate = {"rate_num": self.rate[0], "rate_den": self.rate[1]}
        return "TRAK", f.layer(tlvs, first=self.id, **rate)

    def rows(self) -> Iterable[tuple[int, int, int, int, bytes]]:
        for start, span, events, *cluster in self.packets:
            body, before = b"", start
            for event in events:
                tick, duration, channel, text = Event(*event)
                number = 0 if channel is None else channel + 1
                body += f.event(tick - before, text, duration, number)
                before = tick
            yield (cluster or [0])[0], self.id, start, span, body

    def events(self) -> list[list[Any]]:
        """In order of their ticks, those of one tick in order of the file."""
        every = sorted(self.packets, key=lambda packet: (packet[3:] or (0,), packet[0]))
        found = [list(Event(*event)) for _, _, events, *_ in every for event in events]
        return sorted(found, key=lambda event: event[0])


def spans_of(ticks: Iterable[int]) -> list[list[int]]:
    """Maximal spans."""
    out: list[list[int]] = []
    for tick in sorted(ticks):
        if out and out[-1][1] == tick:
            out[-1][1] += 1
        else:
            out.append([tick, tick + 1])
    return out


def sampled(values: dict[int, int], *, words: bool = False) -> dict[str, Any]:
    ordered = [values[tick] for tick in sorted(values)]
    return {"spans": spans_of(values), "numbers": numbers(ordered, words=words)}


def double_bits(number: float) -> int:
    return struct.unpack("<Q", struct.pack("<d", number))[0]


def double_of(count: int, affine: tuple[int, int, int] | None) -> int:
    """Bits of the value (VAL-003); the quotient of two integers is rounded once in Python."""
    a, b, d = affine or (1, 0, 1)
    return double_bits((count * a + b) / d)


def physical(values: dict[int, int], affine: tuple[int, int, int]) -> dict[str, Any]:
    return numbers([double_of(values[tick], affine) for tick in sorted(values)], words=True)


def full_band(track: Track, i: int, hf: Track | None) -> dict[int, int]:
    own = track.component(i)
    if track.kind == "full":
        return own
    if hf is None:
        return {}
    fast = hf.component(i)
    return {
        tick: max(track.low, min(track.high, own[tick] + fast[tick]))
        for tick in own.keys() & fast.keys()
    }


def channel_of(tracks: Sequence[Track], number: int, bases: dict[int | None, Track]) -> dict:
    """``tracks``: those that continue one another."""
    first = tracks[0]
    i = first.channels.index(number)
    values: dict[int, int] = {}
    for track in tracks:
        values |= full_band(track, track.channels.index(number), bases.get(track.id))
    out = first.told(i) | sampled(values, words=first.words)
    exact = {
        tick: row[track.channels.index(number)]
        for track in tracks
        for tick, row in track.exact().items()
    }  # fmt: skip
    if exact:
        quotients = {tick: double_of(values[tick], first.affine(i)) for tick in values}
        exact = quotients | exact
        out["exact"] = numbers([exact[tick] for tick in sorted(exact)], words=True)
    elif first.affine(i) is not None and not first.words:
        out["physical"] = physical(values, first.affine(i))
    return out


def bands_of(tracks: Sequence[Track], wanted: str) -> list[dict[str, Any]]:
    found: dict[int, dict[int, int]] = {}
    of = {track.id: track for track in tracks}
    for track in tracks:
        if track.kind not in (wanted, "full" if wanted == "lf" else wanted):
            continue
        owner = of[track.base] if track.kind == "hf" else track
        for i, number in enumerate(owner.channels):
            found.setdefault(number, {}).update(track.component(i))
    words = {track.channel: track.words for track in tracks if track.kind == "full"}
    return [
        {"channel": number} | sampled(values, words=words.get(number, False))
        for number, values in sorted(found.items())
        if values
    ]


def decode_of(*tracks: Track, layers: Sequence[Layer] = (), **more: Any) -> dict[str, Any]:
    """The member ``decode``: tracks, channels, where there are LF tracks the bands, layers, and
    what else is told; a member that is None is not compared."""
    every = sorted(tracks, key=lambda track: track.id)
    listed = [
        {
            "track": track.id, "kind": track.kind, "codec": track.codec,
            "number_format": track.number_format, "component_count": track.width,
            "rate": list(track.rate), "spans": spans_of(track.rows()),
            "numbers": numbers(
                [number for _, row in sorted(track.rows().items()) for number in row],
                words=track.words,
            ),
        }
        for track in every
    ]  # fmt: skip
    bases = {track.base: track for track in every if track.kind == "hf"}
    channels: dict[int, list[Track]] = {}
    for track in every:
        for i in range(track.width if track.kind != "hf" else 0):
            channels.setdefault(track.channels[i], []).append(track)
    out: dict[str, Any] = {
        "tracks": listed,
        "channels": [channel_of(channels[n], n, bases) for n in sorted(channels)],
    }
    if any(track.kind in ("lf", "hf") for track in every):
        out |= {"lf": bands_of(every, "lf"), "hf": bands_of(every, "hf")}
    if layers:
        out["layers"] = [
            {"track": layer.id, "label": layer.label, "rate": list(layer.rate),
             "events": layer.events()}
            for layer in sorted(layers, key=lambda layer: layer.id)
        ]  # fmt: skip
    every_member = out | more
    return {name: value for name, value in every_member.items() if value is not None}


def digest(track: Track, packets: Sequence[Packet] | None = None) -> bytes:
    """Of the packets of a track, all unless told which, as dGST has it (11.5)."""
    part = replace(track, packets=track.packets if packets is None else packets)
    exact, rows = part.exact(), part.rows()
    size = 8 if exact else {"counts": 4, "binary16": 2, "binary32": 4}.get(track.number_format, 8)
    numbers_ = [exact[tick] if exact else row for tick, row in sorted(rows.items())]
    raw = b"".join((n % 256**size).to_bytes(size, "little") for row in numbers_ for n in row)
    covered = b"".join(struct.pack("<QQ", a, b - a) for a, b in spans_of(rows))
    return hashlib.sha256(hashlib.sha256(raw).digest() + covered).digest()
