"""An edited file in the making: descriptions, clusters and other chunks come over from originals,
and what was kept and what was not is noted on the way."""

from __future__ import annotations

import hashlib
import os
import uuid
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, BinaryIO

from ..atomic import atomic_write, refuse
from ..format.cluster import Packet
from ..writing.filewriter import FileWriter
from ..format.layout import HEAD
from ..format.tlv import parse_tlvs
from ..format.track import Track
from ..format.wire import NO_TRACK, Head
from ..errors import FormatError, ParameterError
from ..limits import TICK_LIMIT, Level
from ..numbers import counted
from ..reading.digests import stored_digests
from ..reading.seconds import Seconds
from .clocks import TYPES, moved_clock
from .original import NS, Advance, Original, has_channels
from .plan import Place, Plan
from .renumber import renumbered

Output = str | os.PathLike[str] | BinaryIO


@dataclass
class Edited:
    """What an editor wrote, and what it had to leave out or change (``notes``).

    ``start`` and ``stop``: seconds that the kept packets lie within, on the new time line; None
    where there are none.
    """

    file: str | None = None
    file_size: int = 0
    level: int = 1
    packet_count: int = 0
    packet_size: int = 0
    cluster_count: int = 0
    track_count: int = 0
    digest_count: int = 0
    start: Fraction | None = None
    stop: Fraction | None = None
    offsets: list[Fraction] = field(default_factory=list)
    """Where the zeros of several files lie, in seconds."""
    channels: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        return {
            **vars(self),
            "start": None if self.start is None else float(self.start),
            "stop": None if self.stop is None else float(self.stop),
            "offsets": [float(offset) for offset in self.offsets],
        }


class Making:
    """Writes to ``stream``, which needs ``write`` only."""

    def __init__(
        self,
        stream: BinaryIO,
        head: Head,
        *,
        level: Level,
        canonical: int | None = None,
        name: str | None = None,
    ) -> None:
        self.out = FileWriter(
            stream,
            level=level,
            file_id=canonical,
            recording_uuid=uuid.UUID(bytes=head.uuid) if head.uuid else None,
            epoch_ns=head.epoch_ns,
            epoch_uncertainty_ns=head.epoch_uncertainty_ns,
        )
        self.edited = Edited(name, level=level.number)
        self.stops: dict[tuple[int, bool], int] = {}
        self.ends: dict[int, tuple[int, int]] = {}
        self.partial: dict[Original, set[int]] = {}
        self.last: dict[Original, dict[int, int]] = {}
        """Where in its file the last packet of a track stands."""
        self.seen: dict[bytes, Original] = {}
        """Which file had a chunk first, by its digest."""
        self.maps_to_drop: Container[bytes] = ()
        """Payloads of clock maps that hold for a part of what they would speak of only."""
        self.lost_events = 0

    def note(self, text: str) -> None:
        if text not in self.edited.notes:
            self.edited.notes.append(text)

    def describe(self, original: Original, plan: Plan) -> None:
        for old, place in plan.places.items():
            lost = set(original.tracks[old].unknown) - set(place.track.unknown)
            if lost:
                listed = ", ".join(str(type_) for type_, _ in sorted(lost))
                self.note(f"TLVs {listed} of track {old} left out: not known here")
        tracks = {place.track.id: place.track for place in plan.places.values()}
        self.out.describe(list(tracks.values()))
        if parse_tlvs(original.catalogue.head_payload, HEAD.size, 0):
            self.note("TLVs of HEAD left out: not known here")

    def metadata(self, metadata: Mapping[str, Any]) -> None:
        if metadata:
            self.out.metadata(dict(metadata))

    def others(self, original: Original, plan: Plan, *, behind: bool) -> None:
        """Attachments, clocks and chunks of unknown types that are safe to copy; what an earlier
        file had too comes once."""
        for chunk in original.others(behind=behind):
            header, payload, track = chunk.header, chunk.payload, chunk.header.track
            if not header.known and header.type[3].isupper():
                self.note(f"{header.type} chunk left out: unknown, and unsafe to copy")
                continue
            if track != NO_TRACK:
                place = plan.places.get(track)
                if place is None and header.type != "aTTc":
                    self.note(f"{header.type} chunk left out: it speaks of track {track}")
                    continue
                track = place.track.id if place else NO_TRACK
            if header.known and header.type in TYPES:
                moved = moved_clock(payload, chunk.header.track, plan, chunk.payload_offset)
                if moved is None:
                    self.note(f"{header.type} chunk left out: its ticks cannot move so")
                    continue
                payload = moved
            digest = hashlib.sha256(f"{header.type} {track} ".encode() + payload).digest()
            if self.seen.setdefault(digest, original) is not original:
                continue
            if header.known and header.type == "cMAp" and payload in self.maps_to_drop:
                self.note("cMAp chunk left out: packets of other files come to its track")
                continue
            self.out.chunk(header.type, payload, track, flags=header.flags)
            if not header.known:
                self.note(f"{header.type} chunk copied: unknown, but safe to copy")

    def clusters(
        self,
        original: Original,
        plan: Plan,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        pick: Callable[[Packet], bool] | None = None,
        progress: Advance | None = None,
    ) -> Iterator[list[Packet]]:
        """Packets of one DATA chunk after the other, those of the plan that ``pick`` takes, moved
        to their place."""
        renumber = plan.numbers != {number: number for number in original.labels}
        partial = self.partial.setdefault(original, set())
        last = self.last.setdefault(original, {})
        if start is not None or stop is not None:
            partial.update(plan.places)
        for packets in original.clusters(start, stop, progress):
            batch = []
            for packet in packets:
                place = plan.places.get(packet.track)
                if place is None:
                    continue
                if pick and not pick(packet):
                    partial.add(packet.track)
                    continue
                last[packet.track] = packet.offset
                numbers = plan.numbers if renumber and place.track.kind == "events" else None
                moved = self.moved(packet, place, numbers)
                if moved is not None:
                    batch.append(moved)
            if batch:
                yield batch

    def moved(
        self, packet: Packet, place: Place, numbers: Mapping[int, int] | None
    ) -> Packet | None:
        """At its place; ``numbers``: new channel numbers for its events, None: they stay."""
        kept: Packet | None = packet
        if numbers is not None:
            kept, lost = renumbered(packet, numbers)
            self.lost_events += lost
        if kept is None:
            return None
        moved = replace(kept, track=place.track.id, start=kept.start + place.shift)
        if moved.start < 0 or moved.stop > TICK_LIMIT:
            raise ParameterError("a packet would move out of the ticks 0 to 2^48")
        return moved

    def put(self, packets: Sequence[Packet]) -> None:
        """One cluster; packets of the tracks that were described."""
        for packet in packets:
            track = self.out.tracks[packet.track]
            self.check_order(track, packet)
            start, stop = self.ends.get(track.id, (packet.start, packet.stop))
            self.ends[track.id] = min(start, packet.start), max(stop, packet.stop)
            self.edited.packet_count += 1
            self.edited.packet_size += len(packet.data)
        self.out.cluster(packets)

    @property
    def span(self) -> tuple[Fraction, Fraction] | None:
        """Seconds from the first packet to the end of the last so far."""
        if not self.ends:
            return None
        rates = {id_: self.out.tracks[id_].rate for id_ in self.ends}
        return (
            min(start / rates[id_] for id_, (start, _) in self.ends.items()),
            max(stop / rates[id_] for id_, (_, stop) in self.ends.items()),
        )

    def check_order(self, track: Track, packet: Packet) -> None:
        """DAT-006, and the same of tracks that continue one another: they share their channels."""
        if track.kind == "events":
            return
        line = track.first_channel, track.kind == "hf"
        if packet.start < self.stops.get(line, 0):
            at = float(packet.start / track.rate)
            if len(self.last) == 1:
                raise FormatError(
                    f"Two packets of channel {track.first_channel} overlap at {at:.6g} s",
                    requirement="DAT-006",
                    offset=packet.offset,
                    path=next(iter(self.last)).source.path,
                )
            raise ParameterError(
                f"channel {track.first_channel}: two packets overlap at {at:.6g} s; give the files "
                "in order of time, and only parts that do not overlap (split makes such)"
            )
        self.stops[line] = packet.stop

    def digests(self, original: Original, plan: Plan) -> None:
        """Those that still hold: of tracks whose packets all came over, at their own time."""
        known = stored_digests(original.catalogue)
        partial, last = self.partial.get(original, set()), self.last.get(original, {})
        kept = {
            place.track.id: known[old][1]
            for old, place in plan.places.items()
            if old in known and old not in partial and not place.shift
            if known[old][0] > last.get(old, 0)
        }
        lost = sum(old in plan.places for old in known) - len(kept)
        if lost:
            self.note(
                f"digests of {counted(lost, 'track')} left out: they are of other packets, or times"
            )
        self.out.digest(kept)
        self.edited.digest_count += len(kept)

    def close(self) -> Edited:
        self.out.close()
        if self.lost_events:
            self.note(
                f"{counted(self.lost_events, 'event')} left out: of channels that are left out"
            )
        edited, out = self.edited, self.out
        edited.file_size, edited.cluster_count = out.offset, out.data_count
        edited.track_count = len(out.tracks)
        edited.start, edited.stop = self.span or (None, None)
        found: dict[int, dict[str, Any]] = {}
        for track in out.tracks.values():
            if has_channels(track):
                for number, component in zip(track.channels, track.components, strict=True):
                    found.setdefault(number, {"channel": number, "label": component.label})
        edited.channels = [found[number] for number in sorted(found)]
        return edited


def refuse_output(file: Output, force: bool) -> None:
    """Before any work."""
    if isinstance(file, (str, os.PathLike)):
        refuse(os.fspath(file), force)


def opened(file: Output, force: bool) -> AbstractContextManager[BinaryIO]:
    if isinstance(file, (str, os.PathLike)):
        return atomic_write(file, force=force)
    return nullcontext(file)


def name_of(file: Output) -> str | None:
    return os.fspath(file) if isinstance(file, (str, os.PathLike)) else None


def another(head: Head, shift: Fraction, canonical: int | None) -> Head:
    """The head of a recording of its own, whose tick 0 is ``shift`` seconds after that of
    ``head``: another UUID, and the epoch moved along."""
    name = None if canonical is not None else uuid.uuid4().bytes
    if head.epoch_ns is None or not shift:
        return replace(head, uuid=name)
    exact = shift * NS
    whole = round(exact)
    doubt = head.epoch_uncertainty_ns + (exact != whole)
    epoch = head.epoch_ns + whole
    if not -(1 << 63) <= epoch < 1 << 63:
        return replace(head, uuid=name, epoch_ns=None, epoch_uncertainty_ns=0)
    return replace(head, uuid=name, epoch_ns=epoch, epoch_uncertainty_ns=doubt)


def with_note(metadata: Mapping[str, Any], text: str) -> dict[str, Any]:
    """The member ``notes`` tells what happened (SPEC 6.7)."""
    notes = metadata.get("notes", [])
    known = notes if isinstance(notes, list) else [notes]
    return {**metadata, "notes": [*known, text]}
