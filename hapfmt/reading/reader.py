"""File -> recording: reads only the requested channels, times and bands, in order or by index.

The decoded numbers are compared with the stored checksums of tracks (dGST, SPEC 11.5).
"""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from math import ceil
from typing import Any, BinaryIO

from ..clocks import ClockMap, ClockObservation, on_channels
from ..errors import (
    DataWarning,
    FormatError,
    ParameterError,
    channels_called,
    verdict_of,
)
from ..files import Closing
from ..format.cluster import Packet
from ..format.extras import Attachment, parse_digests
from ..format.source import ByteSource, open_source
from ..format.track import Track, lone_lf
from ..format.walk import Finding, read_chunk
from ..limits import Limits
from ..numbers import counted
from ..numbers import exact as exact_number
from ..recording import Event, Recording, observed_between, refuse_past_end
from ..spool import MEMORY, Memory
from ..threads import in_order, thread_count
from .catalogue import Catalogue, ChannelRef, FalseIndexError, refuse_omission
from .damage import DamageReport, LostSpan, damaged_areas, lost_within
from .decoder import (
    BANDS,
    Assembly,
    Band,
    Decoded,
    DecodedPiece,
    PieceDecoder,
    TrackDecoder,
    TrackDigest,
    events_of,
    wanted_tracks,
)
from .opening import lose_chunk, open_catalogue
from .packets import BATCH, Batch, PacketPass, Seconds, batches, tick_range


class DigestCheck:
    """Takes the pieces of whole tracks in the order of the file, then compares."""

    def __init__(self, catalogue: Catalogue, tracks: Collection[int] | None = None) -> None:
        self.catalogue = catalogue
        found = stored_digests(catalogue)
        self.stored = {id_: found[id_] for id_ in found if tracks is None or id_ in tracks}
        self.running = {id_: TrackDigest() for id_ in self.stored}

    def add(self, piece: DecodedPiece) -> None:
        offset, _ = self.stored.get(piece.track.id, (0, b""))
        if piece.offset < offset:
            self.running[piece.track.id].update(piece.start, piece.digested)

    def compare(self, lossy: Collection[int]) -> None:
        """Report each checksum that differs; tracks with losses are not compared (DGS-002)."""
        for id_, (offset, digest) in self.stored.items():
            if id_ in lossy or self.catalogue.tracks[id_].unsupported:
                continue
            if self.running[id_].digest() != digest:
                message = f"the decoded numbers of track {id_} do not match their checksum"
                self.catalogue.lose("bad-digest", offset, 32, message, "DGS-002")


def stored_digests(catalogue: Catalogue) -> dict[int, tuple[int, bytes]]:
    """The last digest of each track and its offset (SPEC 11.5)."""
    found: dict[int, tuple[int, bytes]] = {}
    # In a damaged file the description of a track may be lost; a recoverer of an undamaged one
    # reports a digest of no track, since it leaves it out.
    harmed = catalogue.harmed
    for ref in catalogue.chunks:
        chunk = read_chunk(catalogue.source, ref.offset) if ref.type == "dGST" else None
        if chunk is None or not chunk.intact:
            continue
        try:
            listed = parse_digests(chunk.payload, chunk.payload_offset)
            check_digested(catalogue, listed.keys(), chunk.payload_offset, harmed=harmed)
        except FormatError as error:
            if not catalogue.damaged:
                raise
            lose_chunk(catalogue, chunk, error)
            continue
        found |= {id_: listed[id_] for id_ in listed if id_ in catalogue.tracks}
    return found


def check_digested(catalogue: Catalogue, ids: Collection[int], at: int, *, harmed: bool) -> None:
    """The tracks of a dGST payload at ``at``; in a damaged file some may not be known."""
    tracks = catalogue.tracks
    unknown = [
        i for i in ids if i not in tracks or (tracks[i].offset > at and not catalogue.damaged)
    ]
    if unknown and not harmed:
        raise FormatError(
            f"a digest of track {unknown[0]}, which is not described",
            requirement="DGS-001",
            offset=at,
        )
    if any(i in tracks and tracks[i].kind == "events" for i in ids):
        raise FormatError("Tracks of events have no checksum", requirement="DGS-001", offset=at)


PLAUSIBLE = 64
"""Values for each byte of a file, above which no room is made before they are decoded."""

IN_FLIGHT = 1 << 19
"""Samples that are decoded ahead of those that are delivered, by all threads together; a packet of
more is decoded alone."""


class Reader(Closing):
    """Reads a hapf file: a path, a URL, bytes, or a binary stream.

    Damage raises no error: the reader delivers intact parts, and ``findings`` and ``lost`` list
    the damage. Bytes that break a rule although their checksums hold raise FormatError.

    limits
        what the file may use; more raises LimitError.
    strict
        raise an error at the first damage.
    threads
        number of threads that decode. None: HAPFMT_THREADS, else the number of CPUs; one thread for
        small files.
    scan
        walk through the whole file when it is opened. Reading all of it does that anyway.
    mapped
        map a local file into memory, which saves copies. The process dies if another program
        shortens the file meanwhile.
    spool
        for URLs: fetch the whole file first, not only the parts that are read.
    file_id
        for a file that contains parts of others: the id of the file to read. None: the one of
        its start and its end, or, if these differ, of most bytes. The finding *other-file* names
        the ids.

    A text with :// or :: is a URL for fsspec (extra "remote").
    """

    _advice = "hapfmt.Reader reads what is intact; hapfmt.recover(file, into) writes an intact copy"
    """What helps where damage is an error."""

    def __init__(
        self,
        file: str | os.PathLike[str] | bytes | BinaryIO | ByteSource,
        *,
        limits: Limits | None = None,
        strict: bool = False,
        threads: int | None = None,
        scan: bool = False,
        mapped: bool = False,
        spool: bool = False,
        file_id: int | None = None,
    ) -> None:
        self.file_id = file_id
        self.limits = limits or Limits()
        self.strict = strict
        self.threads = threads
        self.source = open_source(file, mapped=mapped, spool=spool)
        self.lost: list[LostSpan] = []
        self.partial = False
        """Whether the last read was of some tracks or seconds alone."""
        self._whole: PacketPass | None = None
        try:
            self.catalogue: Catalogue = open_catalogue(
                self.source, scan=scan, limits=self.limits, file_id=file_id
            )
            self.refuse_damage()
        except BaseException:
            self.source.close()
            raise

    def close(self) -> None:
        self.source.close()

    def __repr__(self) -> str:
        """One line: the file, and the damage found so far."""
        name = "" if self.source.path is None else f" {self.source.path!r}"
        damage = len(damaged_areas(self.findings))
        facts = [
            counted(len(self.channels), "channel"),
            f"{float(self.duration):.6g} s",
            "closed" if self.catalogue.closed else "not closed",
            *([counted(damage, "damaged place")] if damage else []),
            *([counted(len(self.lost), "lost part")] if self.lost else []),
        ]
        return f"Reader{name}: {', '.join(facts)}"

    @property
    def channels(self) -> list[ChannelRef]:
        return self.catalogue.channels

    @property
    def _layers(self) -> list[Track]:
        """The event tracks that this version can decode."""
        return [layer for layer in self.catalogue.layers if not layer.unsupported]

    @property
    def metadata(self) -> dict[str, Any]:
        return self.catalogue.described

    @property
    def findings(self) -> list[Finding]:
        return self.catalogue.findings

    @property
    def exit_code(self) -> int:
        """The code of SPEC clause 13, for the parts read so far."""
        codes = (finding.code for finding in self.findings)
        unknown = self.catalogue.not_understood
        return verdict_of(codes, unknown=unknown, lost=bool(self.lost))

    def damage(self, channels: Sequence[str | int] | str | int | None = None) -> DamageReport:
        """What is wrong with the parts read so far; ``channels``: those that were read."""
        numbers = None if channels is None else {ref.number for ref in self.select(channels)}
        return DamageReport(self.catalogue, self.lost, numbers, self.partial)

    @property
    def duration(self) -> Fraction:
        return self.catalogue.duration

    @property
    def attachments(self) -> dict[str, Attachment]:
        try:
            return self.catalogue.attachments
        except FalseIndexError:
            self.scan()
            return self.catalogue.attachments

    @property
    def clocks(self) -> list[ClockObservation]:
        """Observations of other clocks, in the order of the file. The ticks of a track of several
        channels are those of its first channel."""
        try:
            return self.catalogue.clocks
        except FalseIndexError:
            self.scan()
            return self.catalogue.clocks

    @property
    def clock_maps(self) -> list[ClockMap]:
        """Maps from ticks to other clocks, where the file has them."""
        try:
            return self.catalogue.clock_maps
        except FalseIndexError:
            self.scan()
            return self.catalogue.clock_maps

    def scan(self) -> None:
        """Walk through the whole file, so that every byte is checked."""
        if self.catalogue.indexed:
            self.catalogue = open_catalogue(
                self.source, scan=True, limits=self.limits, file_id=self.file_id
            )
            self.refuse_damage()

    def refuse_damage(self) -> None:
        if self.strict and self.catalogue.findings:
            first = self.catalogue.findings[0]
            raise first.error(
                f"{first.code}: {first.message}. {self._advice}",
                requirement=first.requirement,
                offset=first.offset,
                path=self.source.path,
            )

    def refuse_unknown(self) -> None:
        """CHK-009."""
        if self.catalogue.unsupported:
            raise self.catalogue.unsupported

    def select(self, channels: Sequence[str | int] | str | int | None) -> list[ChannelRef]:
        """Channels by label or number, in the given order; None: all.

        A text that is not a label may be a pattern such as "pos_*". An integer selects by number;
        negative numbers count from the end. Raises UnknownChannelError.
        """
        known = self.catalogue.channels
        if channels is None:
            return known
        by_number = {ref.number: ref for ref in known}
        labels = {number: ref.label for number, ref in by_number.items()}
        return [by_number[number] for number in channels_called(channels, labels)]

    def check_band(self, channels: Sequence[str | int] | str | int | None, band: Band) -> None:
        """ParameterError for an HF band that none of these channels has; a DataWarning for LF."""
        parts = [part for ref in self.select(channels) for part in ref.parts]
        if band == "full" or any(part.residual or part.track.kind != "full" for part in parts):
            return
        text = "no channel here is stored as a slow part and its texture, so band "
        if band == "hf":
            raise ParameterError(f"{text}'hf' would be empty", path=self.source.path)
        warnings.warn(f"{text}{band!r} is all of it", DataWarning, stacklevel=3)

    def read(
        self,
        channels: Sequence[str | int] | str | int | None = None,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        band: Band = "full",
        exact: bool = True,
        clocks: bool = True,
        progress: Callable[[int, int], None] | None = None,
        store: Memory = MEMORY,
    ) -> Recording:
        """The recording, or some of its channels, seconds [start, stop) and one band of it.

        ``channels`` as for :meth:`select`. ``exact``: also decode the float64 corrections, where
        the file has them. ``progress`` is called with (clusters done, clusters in all).

        The clocks of a track refer to the first of the chosen channels that it holds. A part in
        time has the observations at start <= time < stop; ticks and maps stay as they are.
        ``clocks=False`` leaves clocks out. They may be anywhere in the file, so a part of a remote
        file then needs fewer requests. A ``hapfmt.spool.Spool`` as ``store`` keeps the samples
        on the disk.
        """
        if band not in BANDS:
            raise ParameterError(f"band is one of {', '.join(BANDS)}")
        if start is None and stop is None:
            self.scan()
        catalogue = self.catalogue
        chosen = self.select(channels)
        assembly = self.assembly(
            chosen, start, stop, band=band, exact=exact, progress=progress, store=store
        )
        events = assembly.events()
        if start is not None and self._layers:
            lost = self.lost
            events = self._events_between(self._layers, start, stop)
            self.lost = [*lost, *self.lost]
        seen, maps = (self.clocks, self.clock_maps) if clocks else ([], [])
        if self.catalogue is not catalogue:
            # The index was false: other channels may be there.
            return self.read(
                channels, start, stop, band=band, exact=exact, clocks=clocks, progress=progress,
                store=store,
            )  # fmt: skip
        head = self.catalogue.head
        own: dict[int | str | None, int] = {}
        for place, ref in enumerate(chosen):
            own.setdefault(ref.track.first_channel, place)
        rates = [ref.track.rate for ref in chosen]
        return Recording(
            tuple(assembly.channel(ref) for ref in chosen),
            uuid=self.catalogue.uuid,
            epoch_ns=head.epoch_ns if head else None,
            epoch_uncertainty_ns=head.epoch_uncertainty_ns if head else 0,
            metadata=self.catalogue.described,
            attachments={
                name: (found.media_type, found.content)
                for name, found in self.attachments.items()
                if not found.is_overview
            },
            events=events_of(events, self.catalogue.channels, chosen) if events else (),
            clocks=tuple(observed_between(on_channels(seen, own), rates, start, stop)),
            clock_maps=tuple(on_channels(maps, own)),
        )

    def assembly(
        self,
        chosen: Sequence[ChannelRef],
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        band: Band = "full",
        exact: bool = True,
        progress: Callable[[int, int], None] | None = None,
        store: Memory = MEMORY,
    ) -> Assembly:
        """The decoded parts of some channels, before they are put together."""
        wanted = wanted_tracks(chosen, band)
        whole = store.on_disk and start is None and stop is None
        rows = self.expected_rows(wanted) if whole else {}
        decoded = {track.id: Decoded(track, store, rows.get(track.id, 0)) for track in wanted}
        samples = 0
        assembly = Assembly(decoded, band)
        digests = None
        if start is None and stop is None and exact:
            # Whole tracks are read, so their stored checksums can be compared.
            self.scan()
            digests = DigestCheck(self.catalogue, decoded)
        # Events of a part need a pass of their own, from the beginning of the file.
        layers = self._layers if start is None else []
        for piece in self.pieces([*wanted, *layers], start, stop, exact=exact, progress=progress):
            if digests is not None:
                digests.add(piece)
            samples += piece.numbers.size
            self.limits.check("samples", samples)
            if piece.track.channels:
                decoded[piece.track.id].add(piece.start, piece.numbers, piece.exact)
            else:
                assembly.add_events(piece.track, piece.events)
                self.limits.check("events", assembly.event_count)
        self.lost.extend(self.lost_parts(chosen, band))
        if digests is not None:
            digests.compare({span.track for span in self.lost})
        return assembly

    def expected_rows(self, tracks: Sequence[Track]) -> dict[int, int]:
        """By track, the ticks of the whole recording; none where few of them can have samples."""
        rows = {track.id: ceil(self.duration * track.rate) for track in tracks}
        values = sum(rows[track.id] * len(track.components) for track in tracks)
        return rows if values <= PLAUSIBLE * self.source.size else {}

    def events(
        self,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        layers: Sequence[str] | None = None,
    ) -> list[Event]:
        """Events that hold at some time within the seconds [start, stop), in order of time.

        ``layers``: names of layers; None: all. The channel of an event is a number.
        """
        if start is None and stop is None:
            self.scan()
        catalogue = self.catalogue
        chosen = [
            layer
            for layer in self.catalogue.layers
            if layers is None or layer.components[0].label in layers
        ]
        events = self._events_between(chosen, start, stop)
        if self.catalogue is not catalogue:
            return self.events(start, stop, layers=layers)
        return events

    def _events_between(
        self, layers: Sequence[Track], start: Seconds | None, stop: Seconds | None
    ) -> list[Event]:
        low = None if start is None else exact_number(start)
        if low is not None and stop is not None and exact_number(stop) <= low:
            return []
        assembly = Assembly({}, "full")
        # An event that still holds at ``start`` may have begun in any cluster before it.
        for piece in self.pieces(layers, None if start is None else 0, stop):
            rate = piece.track.rate
            kept = [
                event
                for event in piece.events
                if low is None
                or event.tick >= low * rate
                or event.tick + event.duration > low * rate
            ]
            assembly.add_events(piece.track, kept)
            self.limits.check("events", assembly.event_count)
        return assembly.events()

    def pieces(
        self,
        tracks: Sequence[Track],
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        exact: bool = False,
        progress: Callable[[int, int], None] | None = None,
        beside: Sequence[Track] = (),
    ) -> Iterator[DecodedPiece]:
        """Decoded packets of ``tracks`` in order of the file, cut to the seconds [start, stop).
        The losses of tracks ``beside`` are noted too.

        It needs the memory of one cluster. Reading everything walks through the file first, so
        that it finds all damage. Reading a part trusts the index unless it is wrong.
        """
        if start is None and stop is None:
            self.scan()
        self.refuse_unknown()
        ranges = {t.id: tick_range(t.rate, start, stop) for t in [*tracks, *beside]}
        decoders = {t.id: TrackDecoder(t, self.catalogue.level, self.source.path) for t in tracks}

        decoder = PieceDecoder(decoders, ranges, exact=exact)

        def decode(batch: Batch) -> list[DecodedPiece | FormatError]:
            pieces: list[DecodedPiece | FormatError] = []
            for packet in batch.packets:
                try:
                    pieces.append(decoder.decode(packet))
                except FormatError as error:
                    pieces.append(error)
            return pieces

        # One thread where there is or may be damage: earlier findings then decide how a packet
        # that breaks a rule is treated.
        threads = 1
        if not (self.catalogue.damaged or self.catalogue.indexed):
            seconds = float(self.catalogue.duration)
            samples = [
                seconds * t.rate.numerator / t.rate.denominator * len(t.components)
                for t in tracks
                if t.channels
            ]
            threads = thread_count(self.threads, int(sum(samples)))
        known = {id_: decoder.track for id_, decoder in decoders.items()}
        found = self.packets(ranges, start, stop, progress)
        packets = (packet for packet in found if packet.track in known)
        if threads == 1:
            yield from self.one_by_one(decoder, packets, known)
            return
        jobs = batches(packets, known, self.limits, BATCH)
        for batch, pieces in in_order(
            lambda job: (job, decode(job)), jobs, threads, lambda job: job.weight / IN_FLIGHT
        ):
            for packet, piece in zip(batch.packets, pieces, strict=True):
                if isinstance(piece, DecodedPiece):
                    yield piece
                    continue
                if not self.catalogue.damaged:
                    raise piece
                # In a damaged file a broken rule is part of the damage (SPEC clause 14).
                self.lose_packet(packet, piece)

    def one_by_one(
        self, decoder: PieceDecoder, packets: Iterable[Packet], tracks: Mapping[int, Track]
    ) -> Iterator[DecodedPiece]:
        """As :meth:`pieces`, in the thread of the caller."""
        work = 0
        for packet in packets:
            samples = tracks[packet.track].weight(packet.span, len(packet.data))
            work += samples
            self.limits.check("packet_samples", samples)
            self.limits.check("work_samples", work)
            try:
                piece = decoder.decode(packet)
            except FormatError as error:
                if not self.catalogue.damaged:
                    raise
                # In a damaged file a broken rule is part of the damage (SPEC clause 14).
                self.lose_packet(packet, error)
                continue
            yield piece

    def packets(
        self,
        ranges: dict[int, tuple[int, int]],
        start: Seconds | None = None,
        stop: Seconds | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Packet]:
        """Packets that overlap the ranges of their tracks, with CRCs checked and not decoded.

        ``ranges``: {track id: (first tick, tick after the last)}.
        """
        count, last = 0, -1
        try:
            for packet in self.one_pass(ranges, start, stop, progress):
                count, last = count + 1, packet.offset
                yield packet
            return
        except FalseIndexError:
            # Keep the packets already delivered; find the rest by walking (IDX-003).
            self.scan()
            self.refuse_unknown()
        known = {id_: ends for id_, ends in ranges.items() if id_ in self.catalogue.tracks}
        for packet in self.one_pass(known, start, stop, progress):
            if packet.offset <= last:
                count -= 1
                continue
            refuse_omission(count, last, self.source.path)
            yield packet
        self.lost += [LostSpan(id_, 0, None) for id_ in sorted(ranges.keys() - known.keys())]
        refuse_omission(count, last, self.source.path)

    def one_pass(
        self,
        ranges: dict[int, tuple[int, int]],
        start: Seconds | None,
        stop: Seconds | None,
        progress: Callable[[int, int], None] | None,
    ) -> Iterator[Packet]:
        """The packets of one pass; ``lost`` then holds the losses within the ranges.

        What a part lost follows from packets around it too. So these are the losses of a pass over
        the whole file, if that was walked through.
        """
        part = start is not None or stop is not None
        needed = {t.id for ref in self.channels for t in ref.tracks if not t.unsupported}
        self.partial = part or not needed <= ranges.keys()
        current = PacketPass(self.catalogue, self.refuse_damage)
        self.lost = current.lost
        whole = None
        if part and self.catalogue.damaged and not self.catalogue.indexed:
            whole, self.lost = self._whole, []
            if whole is None or whole.catalogue is not self.catalogue:
                self._whole = whole = PacketPass(self.catalogue, self.refuse_damage)
                deque(whole.packets(dict.fromkeys(self.catalogue.tracks, (0, 1 << 63))), 0)
            current.refused = {span.offset for span in whole.left_out}
        yield from current.packets(ranges, start, stop, progress)
        if part:
            self.lost += whole.lost if whole else []
            self.lost[:] = lost_within(self.lost, ranges, self.catalogue.tracks)

    def lost_parts(self, chosen: Sequence[ChannelRef], band: Band) -> list[LostSpan]:
        """Packets that lack a description for decoding: LF tracks without their HF track
        (DEC-003), and tracks that a known one continues."""
        parts = {part.track.id: part for ref in chosen for part in ref.parts}
        known = [part for part in parts.values() if not part.track.unsupported]
        bare = [p.track for p in known if p.track.kind == "lf" and not p.residual]
        if band != "full":
            bare = []
        if bare and self.catalogue.closed and not self.catalogue.damaged:
            raise lone_lf(bare[0]).at(path=self.source.path)
        before = [p.track.continues for p in parts.values() if p.track.continues is not None]
        lost = {id_ for id_ in before if id_ not in self.catalogue.tracks}
        return [LostSpan(id_, 0, None) for id_ in sorted(lost | {track.id for track in bare})]

    def lose_packet(self, packet: Packet, error: FormatError) -> None:
        size = len(packet.data)
        rule = error.requirement or "COD-001"
        self.catalogue.lose("bad-packet", packet.offset, size, error.message, rule)
        self.lost.append(LostSpan(packet.track, packet.start, packet.stop))


def read(
    file: str | os.PathLike[str] | bytes | BinaryIO | ByteSource,
    channels: Sequence[str | int] | str | int | None = None,
    start: Seconds | None = None,
    stop: Seconds | None = None,
    *,
    band: Band = "full",
    exact: bool = True,
    limits: Limits | None = None,
    threads: int | None = None,
) -> Recording:
    """The recording in ``file``, or a part of it.

    Raises ChecksumError or TruncatedError where the file is damaged: ``Reader`` reads what is
    intact, ``recover`` writes an intact copy.
    """
    whole = start is None and stop is None
    with Reader(file, limits=limits, strict=True, scan=whole, threads=threads) as reader:
        reader.check_band(channels, band)
        recording = reader.read(channels, start, stop, band=band, exact=exact)
        reader.refuse_damage()
        if start is not None:
            refuse_past_end(start, reader.duration)
        return recording


__all__ = ["BANDS", "Band", "DecodedPiece", "LostSpan", "Reader", "read"]
