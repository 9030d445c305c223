"""An edited file is built from originals: their descriptions, clusters and other chunks.

It notes what it keeps and what it leaves out. A damaged original is refused.

* The plan of each track: its new id, channel numbers and description, and its shift in time.
* A slow part, or a residual, that becomes a channel of its own (SPEC TRK-012, EDT-006).
* Chunks of clocks whose tracks move in time (SPEC 11.6).
* Events whose channels get other numbers, or are left out (SPEC 9.9, EDT-003).
* The metadata of several files, combined without loss.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import ceil, gcd, lcm
from typing import Any, BinaryIO, NamedTuple
from uuid import UUID

from ..clocks import TICK_BOUND
from ..codecs.events import build_events, parse_events
from ..errors import (
    DAMAGED,
    ChecksumError,
    FormatError,
    HapfmtError,
    ParameterError,
    UnsupportedError,
)
from ..files import Closing, atomic_write, refuse
from ..format.cluster import Packet, parse_cluster
from ..format.extras import OVERVIEW_NAMES, Attachment
from ..format.layout import HEAD
from ..format.source import open_source
from ..format.track import Affine, Contract, Track, lone_lf
from ..format.walk import Chunk, header_at, read_chunk
from ..format.wire import HEAD_TLVS, UNCERTAINTY_LIMIT, Head, parse_tlvs
from ..limits import LAST_CHANNEL, LAST_TRACK_ID, LEVELS, TICK_LIMIT, Level, Limits
from ..numbers import build_svarint, build_varint, counted, parse_svarint, parse_varint
from ..reading.catalogue import Catalogue, ChunkRef, FalseIndexError
from ..reading.opening import open_catalogue
from ..reading.packets import Seconds, overlapping
from ..reading.reader import stored_digests
from ..writing.filewriter import FileWriter

Input = str | os.PathLike[str] | bytes | BinaryIO
Advance = Callable[[int, int], None]

NS = 10**9
DESCRIBED = frozenset({"HEAD", "TRAK", "DATA", "iNDX", "fOOT", "mETa", "dGST"})
"""Chunk types that an editor writes by itself; the others it copies or leaves out."""


class Original(Closing):
    """Opens a path, bytes, or a binary stream for editing.

    ``scan`` checks the whole file first. ``limits`` bound its memory. Raises an error that
    recommends recovery if any part of it is damaged.
    """

    def __init__(self, file: Input, *, scan: bool = True, limits: Limits | None = None) -> None:
        self.limits = limits
        self.source = open_source(file)
        try:
            self.open(scan=scan)
        except BaseException:
            self.source.close()
            raise

    def open(self, *, scan: bool) -> None:
        self.catalogue: Catalogue = open_catalogue(self.source, scan=scan, limits=self.limits)
        self.refuse()

    def close(self) -> None:
        self.source.close()

    @property
    def name(self) -> str:
        """The name in messages; pipes and bytes have none."""
        return self.source.path or "the input"

    @property
    def head(self) -> Head:
        """With the UUID, also where it follows from the file id."""
        catalogue = self.catalogue
        assert catalogue.head is not None and catalogue.uuid is not None
        return replace(catalogue.head, uuid=catalogue.uuid.bytes)

    @property
    def tracks(self) -> dict[int, Track]:
        return self.catalogue.tracks

    @property
    def attachments(self) -> dict[str, Attachment]:
        """Attachments by name; if the index is wrong, the whole file is read."""
        try:
            return self.catalogue.attachments
        except FalseIndexError:
            self.open(scan=True)
            return self.catalogue.attachments

    @property
    def labels(self) -> dict[int, str]:
        """Labels by channel number."""
        return labels_of(self.tracks)

    def refuse(self) -> None:
        catalogue = self.catalogue
        if catalogue.unsupported:
            raise catalogue.unsupported
        if catalogue.findings:
            first = catalogue.findings[0]
            raise self.damaged(first.error, f"{first.code}: {first.message}", first.offset)
        bare = [
            track
            for track in self.tracks.values()
            if track.kind == "lf" and track.id not in catalogue.table.bases
        ]
        if bare:
            raise lone_lf(bare[0]).at(path=self.source.path)

    def damaged(self, kind: type[FormatError], message: str, offset: int) -> HapfmtError:
        error = kind(
            f"{message}; nothing was written: run hapfmt recover first",
            requirement="EDT-001",
            offset=offset,
            path=self.source.path,
        )
        error.exit_code = DAMAGED
        return error

    def check_known(self, tracks: Sequence[Track]) -> None:
        """Packets of any codec are copied. A track of an unknown kind is refused, since its
        description may refer to anything."""
        for track in tracks:
            if track.unsupported and not track.unsupported.startswith("codec "):
                raise UnsupportedError(
                    f"track {track.id} needs {track.unsupported}; leave its channels out",
                    offset=track.offset,
                    path=self.source.path,
                )

    def refs(self, start: Seconds | None, stop: Seconds | None) -> list[ChunkRef]:
        """DATA chunks that overlap these seconds, in order of time."""
        refs = overlapping(self.catalogue.data, start, stop)
        try:
            for ref in refs:
                if ref.limit is not None:
                    ref.checked(header_at(self.source, ref.offset, self.catalogue.file_id))
        except FalseIndexError:
            # An index that points elsewhere (IDX-003).
            self.open(scan=True)
            refs = overlapping(self.catalogue.data, start, stop)
        return refs

    def clusters(
        self,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        progress: Advance | None = None,
    ) -> Iterator[list[Packet]]:
        """The packets of one DATA chunk after another, with all CRCs checked."""
        refs = self.refs(start, stop)
        last: dict[int, int] = {}
        for done, ref in enumerate(refs):
            packets = self.cluster(ref)
            for packet in packets:
                track = self.tracks[packet.track]
                if track.kind != "events" and packet.start < last.get(track.id, 0):
                    raise FormatError(
                        f"packets of track {track.id} overlap",
                        requirement="DAT-006",
                        offset=packet.offset,
                        path=self.source.path,
                    )
                last[track.id] = packet.stop
            yield packets
            if progress:
                progress(done + 1, len(refs))

    def cluster(self, ref: ChunkRef) -> list[Packet]:
        chunk = read_chunk(self.source, ref.offset, self.catalogue.file_id)
        if chunk is None or not chunk.intact or chunk.header.type != "DATA":
            message = "checksum error in the payload of a DATA chunk"
            raise self.damaged(ChecksumError, message, ref.offset)
        try:
            level, at = self.catalogue.level, chunk.payload_offset
            return parse_cluster(chunk.payload, self.tracks, level, at, chunk.header.cluster_seed)
        except FormatError as error:
            raise error.at(path=self.source.path) from None

    def others(self, *, behind: bool) -> Iterator[Chunk]:
        """Chunks that are none of ``DESCRIBED``, before the first DATA chunk or behind it."""
        first = min((ref.offset for ref in self.catalogue.data), default=self.source.size)
        for ref in self.catalogue.chunks:
            if ref.type in DESCRIBED or (ref.offset > first) != behind:
                continue
            chunk = read_chunk(self.source, ref.offset, self.catalogue.file_id)
            if chunk is None or not chunk.intact or chunk.header.type != ref.type:
                message = f"checksum error in the payload of a {ref.type} chunk"
                raise self.damaged(ChecksumError, message, ref.offset)
            yield chunk


def open_original(file: Input | Original, *, scan: bool = True) -> AbstractContextManager[Original]:
    """Opens a file for editing; one that is open stays open."""
    return nullcontext(file) if isinstance(file, Original) else Original(file, scan=scan)


def has_channels(track: Track) -> bool:
    return track.kind not in ("hf", "events")


def labels_of(tracks: Mapping[int, Track]) -> dict[int, str]:
    """By channel number."""
    found: dict[int, str] = {}
    for track in tracks.values():
        if has_channels(track):
            for number, component in zip(track.channels, track.components, strict=True):
                found.setdefault(number, component.label)
    return found


def common_period(rates: Sequence[Fraction]) -> Fraction:
    """The shortest time, in seconds, that is a whole number of ticks at each rate."""
    if not rates:
        return Fraction(1, 10**9)
    return Fraction(lcm(*(r.denominator for r in rates)), gcd(*(r.numerator for r in rates)))


def ticks_of(seconds: Fraction, rate: Fraction) -> int:
    """Exactly; ParameterError unless the result is a whole number."""
    ticks = seconds * rate
    if ticks.denominator != 1:
        raise ParameterError(f"{seconds} s is not a whole number of ticks at {rate} Hz")
    return ticks.numerator


class TrackPlace(NamedTuple):
    """A track as the new file describes it, and the ticks that its packets move by."""

    track: Track
    shift: int = 0


class EditPlan(NamedTuple):
    """``places`` by the old track id, ``numbers`` by the old channel number; all tracks move by
    ``shift`` seconds."""

    places: dict[int, TrackPlace]
    numbers: dict[int, int]
    shift: Fraction = Fraction(0)


def lay_out(
    kept: Mapping[int, Track],
    *,
    first_track: int = 0,
    first_channel: int = 0,
    shift: Fraction = Fraction(0),
) -> EditPlan:
    """Tracks, by their old id and in the order of the file, get new ids and channel numbers in
    the same order without holes; ``shift`` is in seconds."""
    ids = {old: first_track + place for place, old in enumerate(kept)}
    wanted = {n for track in kept.values() if has_channels(track) for n in track.channels}
    numbers = {old: first_channel + place for place, old in enumerate(sorted(wanted))}
    if (
        max(ids.values(), default=0) > LAST_TRACK_ID
        or max(numbers.values(), default=0) > LAST_CHANNEL
    ):
        raise ParameterError("more tracks or channels than a file can have, about 65 000")
    before: dict[int, int] = {}
    places = {}
    for old in sorted(kept):
        track = kept[old]
        changes: dict[str, object] = {"id": ids[old]}
        if track.kind != "events":
            for number in (track.first_channel, *track.further):
                if number not in numbers:
                    # Only a track that is not understood has a channel that its base has not.
                    raise UnsupportedError(
                        f"Track {old} refers to channel {number}, which is not copied",
                        offset=track.offset,
                    )
            changes["first_channel"] = numbers[track.first_channel]
            changes["further"] = tuple(numbers[number] for number in track.further)
        if track.base is not None:
            if track.base not in ids:
                # Only a track that is not understood refers to one that does not belong to it.
                raise UnsupportedError(
                    f"Track {old} refers to track {track.base}, which is not copied",
                    offset=track.offset,
                )
            changes["base"] = ids[track.base]
        if has_channels(track):
            # Tracks that share their channel numbers continue one another, in order of their ids.
            if track.first_channel in before:
                changes["continues"] = before[track.first_channel]
            before[track.first_channel] = ids[old]
        places[old] = TrackPlace(replace(track, **changes), ticks_of(shift, track.rate))  # type: ignore[arg-type]
    return EditPlan({old: places[old] for old in kept}, numbers, shift)


def level_for(tracks: Sequence[Track], *levels: Level, largest: int = 0) -> Level:
    """The highest of ``levels``. Level 2 where a declared range needs it, or the largest payload of
    a chunk other than a cluster."""
    level = max(levels, key=lambda level: level.number, default=LEVELS[1])
    low = largest <= level.payload_size and all(track.in_range_of(level) for track in tracks)
    return level if low else LEVELS[2]


TYPES = frozenset({"cLOk", "cMAp"})


class Everything:
    """A set that contains everything."""

    def __contains__(self, _: object) -> bool:
        return True


def differing_maps(originals: Sequence[Original]) -> set[bytes]:
    """The maps that files, parts of one line of time, do not have in common."""
    found = [
        {
            map_of(chunk.payload)
            for behind in (False, True)
            for chunk in original.others(behind=behind)
            if chunk.header.type == "cMAp"
        }
        for original in originals
    ]
    return found[0].union(*found) - found[0].intersection(*found)


def map_of(payload: bytes) -> bytes:
    """The clock and the points of a cMAp payload, which was parsed before."""
    _, start = parse_varint(payload, 0)
    return payload[start:]


def moved_clock(payload: bytes, plan: EditPlan, offset: int) -> bytes:
    """The payload of a clock chunk, of observations or a map, for its new track on the new time
    line: all its ticks are counted from the first.

    Raises ParameterError where the track is left out, or where no whole number of ticks, or no
    svarint, says that.
    """
    number, named = parse_varint(payload, 0, offset)
    place = plan.places.get(number - 1)
    if number and place is None:
        raise ParameterError(f"it refers to track {number - 1}")
    ticks = Fraction(place.shift) if place else plan.shift * NS
    if ticks.denominator != 1:
        raise ParameterError("its ticks cannot move so")
    track = build_varint(place.track.id + 1 if place else 0)
    if not ticks:
        return track + payload[named:]
    size = payload[named] if named < len(payload) else 0
    _, start = parse_varint(payload, named + 1 + size, offset)
    tick, stop = parse_svarint(payload, start, offset)
    tick += ticks.numerator
    if not -TICK_BOUND < tick < TICK_BOUND:
        raise ParameterError("its ticks cannot move so")
    return track + payload[named:start] + build_svarint(tick) + payload[stop:]


def renumbered(packet: Packet, numbers: Mapping[int, int]) -> tuple[Packet | None, int]:
    """The packet of events with new channel numbers, without the events of channels that have none;
    and how many these were. None where no event is left."""
    events = parse_events(packet.data, packet.start, packet.span, packet.offset)
    kept = [
        event if event.channel is None else event._replace(channel=numbers[event.channel])
        for event in events
        if event.channel is None or event.channel in numbers
    ]
    lost = len(events) - len(kept)
    if not kept:
        return None, lost
    return replace(packet, data=build_events(kept, packet.start)), lost


Output = str | os.PathLike[str] | BinaryIO


@dataclass
class Edited:
    """The result of an edit; ``notes`` list omissions and changes.

    ``start`` and ``stop``: the kept packets are within these seconds of the new time line; None if
    there are none. ``asked`` and ``made``: the seconds that were asked for, None for an open end,
    and those of the kept packets, both on the time line of the original. ``missing``: stretches
    within them, on the new time line, for which a channel has no samples.
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
    asked: tuple[Fraction | None, Fraction | None] | None = None
    made: tuple[Fraction, Fraction] | None = None
    rounded: bool = False
    """True if packets reach beyond the requested times by a sample or more."""
    missing: list[Stretch] = field(default_factory=list)
    channels: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        return {
            **vars(self),
            "start": seconds_of(self.start),
            "stop": seconds_of(self.stop),
            "offsets": [float(offset) for offset in self.offsets],
            "asked": self.asked and [seconds_of(end) for end in self.asked],
            "made": self.made and [seconds_of(end) for end in self.made],
            "missing": [
                {"channels": list(channels), "start": float(start), "stop": float(stop)}
                for channels, start, stop in self.missing
            ],
        }


class Stretch(NamedTuple):
    """Seconds from ``start`` to before ``stop``, and the labels of the channels that lack them."""

    channels: tuple[str, ...]
    start: Fraction
    stop: Fraction


def seconds_of(time: Fraction | None) -> float | None:
    return None if time is None else float(time)


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
            recording_uuid=UUID(bytes=head.uuid) if head.uuid else None,
            epoch_ns=head.epoch_ns,
            epoch_uncertainty_ns=head.epoch_uncertainty_ns,
            encoder=head.encoder,
        )
        self.edited = Edited(name, level=level.number)
        self.stops: dict[tuple[int, bool], int] = {}
        self.ends: dict[int, tuple[int, int]] = {}
        self.partial: dict[Original, set[int]] = {}
        self.last: dict[Original, dict[int, int]] = {}
        """The offset of a track's last packet in its file."""
        self.seen: dict[bytes, Original] = {}
        """Which file had a chunk first, by its digest."""
        self.maps_to_drop: Container[bytes] = ()
        """Clock maps that hold only for some of their tracks."""
        self.lost_events = 0
        self.asked: tuple[Fraction | None, Fraction | None] = (None, None)
        """The seconds that the file shall have; None: any."""
        self.gaps: dict[int, list[tuple[int, int]]] = {}
        """By the first channel of a track: ticks without samples; the first entry has no start."""

    def note(self, text: str) -> None:
        if text not in self.edited.notes:
            self.edited.notes.append(text)

    def describe(self, original: Original, plan: EditPlan) -> None:
        for old, place in plan.places.items():
            lost = set(original.tracks[old].unknown) - set(place.track.unknown)
            if lost:
                listed = ", ".join(str(type_) for type_, _ in sorted(lost))
                self.note(f"TLVs {listed} of track {old} left out: not known here")
        tracks = {place.track.id: place.track for place in plan.places.values()}
        self.out.describe(list(tracks.values()))
        if parse_tlvs(original.catalogue.head_payload, HEAD.size, 0).keys() - HEAD_TLVS:
            self.note("TLVs of HEAD left out: not known here")

    def metadata(self, metadata: Mapping[str, Any]) -> None:
        if metadata:
            self.out.metadata(dict(metadata))

    def others(self, original: Original, plan: EditPlan, *, behind: bool) -> None:
        """Attachments, clocks and chunks of unknown types that are safe to copy; what an earlier
        file had too comes once."""
        for chunk in original.others(behind=behind):
            header, payload = chunk.header, chunk.payload
            if not header.known and header.type[3].isupper():
                self.note(f"{header.type} chunk left out: unknown, and unsafe to copy")
                continue
            if header.type == "aTTc" and payload.startswith(OVERVIEW_NAMES):
                self.note("the overview was left out: it describes the packets of another file")
                continue
            if header.type in TYPES:
                try:
                    payload = moved_clock(payload, plan, chunk.payload_offset)
                except ParameterError as error:
                    self.note(f"{header.type} chunk left out: {error.message}")
                    continue
            digest = hashlib.sha256(header.type.encode() + payload).digest()
            if self.seen.setdefault(digest, original) is not original:
                continue
            if header.type == "cMAp" and map_of(payload) in self.maps_to_drop:
                self.note("cMAp chunk left out: packets of other files come to its track")
                continue
            self.out.chunk(header.type, payload)
            if not header.known:
                self.note(f"{header.type} chunk copied: unknown, but safe to copy")

    def clusters(
        self,
        original: Original,
        plan: EditPlan,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        pick: Callable[[Packet], Packet | None] | None = None,
        progress: Advance | None = None,
    ) -> Iterator[list[Packet]]:
        """Packets of one DATA chunk after the other, those of the plan, or what ``pick`` takes of
        them, moved to their place."""
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
                taken = pick(packet) if pick else packet
                if taken is not packet:
                    partial.add(packet.track)
                if taken is None:
                    continue
                last[packet.track] = packet.offset
                numbers = plan.numbers if renumber and place.track.kind == "events" else None
                moved = self.moved(taken, place, numbers)
                if moved is not None:
                    batch.append(moved)
            if batch:
                yield batch

    def moved(
        self, packet: Packet, place: TrackPlace, numbers: Mapping[int, int] | None
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
        if track.kind != "hf" and packet.start > self.stops.get(line, -1):
            gap = self.stops.get(line, -1), packet.start
            self.gaps.setdefault(track.first_channel, []).append(gap)
        self.stops[line] = packet.stop

    def compare(self) -> None:
        """Compare the packets with the requested times."""
        missing: dict[tuple[Fraction, Fraction], list[str]] = {}
        for track in self.out.tracks.values():
            if track.first_channel not in self.gaps or not has_channels(track):
                continue
            (_, begun), *gaps = self.gaps.pop(track.first_channel)
            ended, rate = self.stops[track.first_channel, False], track.rate
            start, stop = self.asked
            first = begun if start is None else ceil(start * rate)
            last = ended if stop is None else ceil(stop * rate)
            self.edited.rounded |= begun < first or ended > last
            for low, high in [(first, begun), *gaps, (ended, last)]:
                if low < high:
                    labels = missing.setdefault((low / rate, high / rate), [])
                    labels += [component.label for component in track.components]
        self.edited.missing = [
            Stretch(tuple(labels), start, stop) for (start, stop), labels in sorted(missing.items())
        ]

    def digests(self, original: Original, plan: EditPlan) -> None:
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
        edited.file_size = out.offset
        edited.cluster_count = sum(entry.type == "DATA" for entry in out.entries)
        edited.track_count = len(out.tracks)
        edited.start, edited.stop = self.span or (None, None)
        found: dict[int, dict[str, Any]] = {}
        for track in out.tracks.values():
            if has_channels(track):
                for number, component in zip(track.channels, track.components, strict=True):
                    found.setdefault(number, {"channel": number, "label": component.label})
        edited.channels = [found[number] for number in sorted(found)]
        self.compare()
        return edited


SHOWN = 3
"""Missing stretches that a note names."""


def note_missing(edited: Edited) -> None:
    """A note on the stretches without samples, where they are not just those of one original."""
    shown = []
    for labels, start, stop in edited.missing[:SHOWN]:
        named = ", ".join(map(repr, labels))
        named = named if len(labels) < len(edited.channels) else "all channels"
        shown.append(f"{float(start):.6g} s to {float(stop):.6g} s of {named}")
    if len(edited.missing) > SHOWN:
        shown.append(f"{len(edited.missing) - SHOWN} more")
    if shown:
        edited.notes.append(f"missing: {'; '.join(shown)}")


def refuse_output(file: Output, force: bool) -> None:
    """Refuses an output before any work."""
    if isinstance(file, (str, os.PathLike)):
        refuse(os.fspath(file), force)


def opened(file: Output, force: bool) -> AbstractContextManager[BinaryIO]:
    if isinstance(file, (str, os.PathLike)):
        return atomic_write(file, force=force)
    return nullcontext(file)


def name_of(file: Output) -> str | None:
    return os.fspath(file) if isinstance(file, (str, os.PathLike)) else None


def another(head: Head, shift: Fraction) -> Head:
    """The head of a recording of its own, whose tick 0 is ``shift`` seconds after that of
    ``head``: without its UUID, and the epoch moved along."""
    if head.epoch_ns is None or not shift:
        return replace(head, uuid=None)
    exact = shift * NS
    whole = round(exact)
    doubt = min(head.epoch_uncertainty_ns + (exact != whole), UNCERTAINTY_LIMIT - 1)
    epoch = head.epoch_ns + whole
    if not -(1 << 63) <= epoch < 1 << 63:
        return replace(head, uuid=None, epoch_ns=None, epoch_uncertainty_ns=0)
    return replace(head, uuid=None, epoch_ns=epoch, epoch_uncertainty_ns=doubt)


def with_note(metadata: Mapping[str, Any], text: str) -> dict[str, Any]:
    """The member ``notes`` tells what happened (SPEC 11.3)."""
    notes = metadata.get("notes", [])
    known = notes if isinstance(notes, list) else [notes]
    return {**metadata, "notes": [*known, text]}


FLOOR_LIMIT = (1 << 32) - 1


def reach_of(track: Track) -> int:
    return max(abs(track.count_min), abs(track.count_max), 1)


def slow_alone(track: Track, residual: Track) -> Track:
    """The LF track in full band, its contract an aim: as far from the recording as the channel was,
    and as its residual reaches."""
    size = len(track.components)
    known = residual.contract or Contract(0, 1, False, False, (0,) * size, (0,) * size)
    floor = tuple(min(floor + reach_of(residual), FLOOR_LIMIT) for floor in known.floor)
    return replace(
        track, kind="full", unknown=(), contract=known._replace(guaranteed=False, floor=floor)
    )


def residual_alone(track: Track, residual: Track) -> Track:
    """The HF track in full band, described as its base is; B of the calibration is 0 (DEC-005).

    It was not recorded by itself: its contract is an aim.
    """
    components = tuple(
        replace(c, calibration=Affine(c.calibration.a, 0, c.calibration.d))
        for c in track.components
    )
    size = len(components)
    floor = residual.contract.floor if residual.contract else (1,) * size
    # A texture from a model has none (NOI-001).
    aim = None if residual.synthetic else Contract(0, 1, False, False, floor, (0,) * size)
    return replace(
        residual, kind="full", base=None, unknown=(), components=components, contract=aim
    )


def combined(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Members of all; one that differs from those of its name gets a number, as attachments do, and
    notes follow one another."""
    found: dict[str, Any] = {}
    notes: list[Any] = []
    for part in parts:
        for name, value in part.items():
            if name == "notes":
                listed = value if isinstance(value, list) else [value]
                notes += [note for note in listed if note not in notes]
                continue
            number, key = 1, name
            while key in found and not same(found[key], value):
                number += 1
                key = f"{name} ({number})"
            found[key] = value
    return found | ({"notes": notes} if notes else {})


def described_by(originals: Sequence[Original]) -> tuple[str, dict[str, Any]]:
    """The encoder of the first file that names one, and the metadata of all. Other encoders become
    members."""
    encoders = [{"encoder": text} for o in originals if (text := o.head.encoder)]
    metadata = combined([*encoders, *(original.catalogue.metadata for original in originals)])
    return metadata.pop("encoder") if encoders else "", metadata


def same(a: Any, b: Any) -> bool:
    """True if two values are equal as JSON: true is not 1."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and bool(a == b)
