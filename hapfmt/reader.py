"""File -> recording: sequential or by index, only the channels, times and bands asked for."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from types import TracebackType
from typing import Any, BinaryIO, Literal, NamedTuple
from uuid import UUID

from numpy.typing import NDArray

from .catalogue import Catalogue, ChannelRef, ChunkRef, open_catalogue
from .container.cluster import Packet, parse_cluster, salvage_cluster
from .container.extras import Attachment
from .container.source import open_source
from .container.track import Track
from .container.walk import Finding, read_chunk
from .decoder import TrackDecoder
from .errors import ChecksumError, FormatError, ParameterError, TruncatedError
from .limits import Limits
from .reconstruct import Decoded, add_residual, build_channel
from .recording import Recording

Band = Literal["full", "lf", "hf"]
BANDS: tuple[Band, ...] = ("full", "lf", "hf")
TAIL_LOSSES = frozenset({"missing-chunk", "truncated", "garbage", "duplicate-chunk"})
"""Findings after the last DATA chunk that may have been packets."""
Seconds = Fraction | float | int


class LostSpan(NamedTuple):
    """Ticks of a track that damage took: start <= t < stop; stop None: nobody knows how many."""

    track: int
    start: int
    stop: int | None


class Piece(NamedTuple):
    """One decoded packet: numbers [ticks, components] from tick ``start`` on."""

    track: Track
    start: int
    numbers: NDArray[Any]


@dataclass
class Progress:
    """Where a pass over the packets stands, per track."""

    last_stop: dict[int, int] = field(default_factory=dict)
    broken: set[int] = field(default_factory=set)


class Reader:
    """Opens a path, bytes, or a binary stream.

    Damage raises nothing by itself: what can be read is delivered, what is lost is in ``findings``
    and ``lost``; ``strict=True`` raises at the first damage instead. Bytes that break a rule
    although their checksums hold raise FormatError either way.
    """

    def __init__(
        self,
        file: str | os.PathLike[str] | bytes | BinaryIO,
        *,
        limits: Limits | None = None,
        strict: bool = False,
    ) -> None:
        self.limits = limits or Limits()
        self.strict = strict
        self.source = open_source(file)
        self.lost: list[LostSpan] = []
        try:
            self.catalogue: Catalogue = open_catalogue(self.source)
        except BaseException:
            self.source.close()
            raise
        self.refuse_damage()

    def __enter__(self) -> Reader:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        self.source.close()

    @property
    def channels(self) -> list[ChannelRef]:
        return self.catalogue.channels

    @property
    def metadata(self) -> dict[str, Any]:
        return self.catalogue.metadata

    @property
    def findings(self) -> list[Finding]:
        return self.catalogue.findings

    @property
    def duration(self) -> Fraction:
        return self.catalogue.duration

    def attachments(self) -> list[Attachment]:
        return self.catalogue.attachments()

    def scan(self) -> None:
        """Walk through the whole file, so that every byte is checked."""
        if self.catalogue.indexed:
            self.catalogue = open_catalogue(self.source, scan=True)
            self.refuse_damage()

    def refuse_damage(self) -> None:
        if self.strict and self.findings:
            first = self.findings[0]
            kind = TruncatedError if first.code in ("not-closed", "truncated") else ChecksumError
            raise kind(
                f"{first.code}: {first.message}",
                requirement=first.requirement,
                offset=first.offset,
                path=self.source.path,
            )

    def select(self, channels: Sequence[str | int] | None) -> list[ChannelRef]:
        """Channels by label or number, in the order asked for; None: all."""
        known = self.channels
        if channels is None:
            return known
        chosen = []
        for name in channels:
            found = [c for c in known if name in (c.number, c.label)]
            if not found:
                labels = ", ".join(f"{c.number}={c.label!r}" for c in known)
                raise ParameterError(f"no channel {name!r}; there are: {labels}")
            chosen.append(found[0])
        return chosen

    def read(
        self,
        channels: Sequence[str | int] | None = None,
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        band: Band = "full",
        progress: Callable[[int, int], None] | None = None,
    ) -> Recording:
        """The recording, or the channels, seconds [start, stop) and band that are asked for.

        ``progress`` is called with (clusters done, clusters in all).
        """
        if band not in BANDS:
            raise ParameterError(f"band is one of {', '.join(BANDS)}")
        chosen = self.select(channels)
        wanted = wanted_tracks(chosen, band)
        decoded = {track.id: Decoded(track) for track in wanted}
        samples = 0
        for piece in self.pieces(wanted, start, stop, progress=progress):
            samples += piece.numbers.size
            self.limits.check_samples(samples)
            decoded[piece.track.id].add(piece.start, piece.numbers)
        return self.assemble(chosen, decoded, band)

    def assemble(
        self, chosen: Sequence[ChannelRef], decoded: dict[int, Decoded], band: Band
    ) -> Recording:
        sums: dict[int, Decoded] = {}
        built = []
        for ref in chosen:
            component = ref.track.components[ref.index]
            if band == "hf":
                track = decoded[ref.residual.id] if ref.residual else Decoded(ref.track)
                built.append(build_channel(track, ref.index, component, hf_only=True))
                continue
            if ref.residual is not None and band == "full":
                if ref.track.id not in sums:
                    sums[ref.track.id] = add_residual(
                        decoded[ref.track.id], decoded[ref.residual.id]
                    )
                track = sums[ref.track.id]
            else:
                track = decoded[ref.track.id]
            built.append(build_channel(track, ref.index, component))
        head = self.catalogue.head
        return Recording(
            tuple(built),
            uuid=UUID(bytes=head.uuid) if head and head.uuid else None,
            epoch_ns=head.epoch_ns if head else None,
            epoch_uncertainty_ns=head.epoch_uncertainty_ns if head else 0,
            metadata=self.metadata,
            attachments={a.name: (a.media_type, a.content) for a in self.attachments()},
        )

    def pieces(
        self,
        tracks: Sequence[Track],
        start: Seconds | None = None,
        stop: Seconds | None = None,
        *,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Piece]:
        """Decoded packets of ``tracks`` in order of the file, cut to the seconds [start, stop).

        Memory is that of one cluster. A read of everything walks through the file first, so that
        no damage goes by unseen; a read of a part trusts the index as far as it holds.
        """
        if start is None and stop is None:
            self.scan()
        if self.catalogue.unsupported:
            raise self.catalogue.unsupported
        ranges = {t.id: tick_range(t.rate, start, stop) for t in tracks}
        decoders = {t.id: TrackDecoder(t, self.catalogue.level, self.source.path) for t in tracks}
        for packet in self.packets(ranges, start, stop, progress):
            decoder = decoders[packet.track]
            self.limits.check_packet(packet.span * len(decoder.track.components))
            numbers = decoder.decode(packet)
            first, last = ranges[packet.track]
            a, b = max(first - packet.start, 0), min(last - packet.start, packet.span)
            yield Piece(decoder.track, packet.start + a, numbers[a:b])

    def packets(
        self,
        ranges: dict[int, tuple[int, int]],
        start: Seconds | None = None,
        stop: Seconds | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Packet]:
        """Packets of the tracks in ``ranges`` that overlap their tick range, CRCs checked."""
        self.lost.clear()
        state = Progress()
        refs = [ref for ref in self.catalogue.data if overlaps(ref, start, stop)]
        found = {ref.sequence for ref in self.catalogue.chunks if ref.sequence is not None}
        previous: ChunkRef | None = None
        for done, ref in enumerate(refs):
            if self.missing(found, previous, ref):
                state.broken.update(ranges)
            previous = ref
            for packet in self.cluster(ref, state, set(ranges)):
                if packet.track not in ranges:
                    continue
                if not self.settle(packet, state):
                    continue
                first, last = ranges[packet.track]
                if packet.start < last and packet.stop > first:
                    yield packet
            if progress:
                progress(done + 1, len(refs))
        if self.missing(found, previous, None):
            state.broken.update(ranges)
        for track in sorted(state.broken & set(ranges)):
            self.lost.append(LostSpan(track, state.last_stop.get(track, 0), None))

    def missing(self, found: set[int], before: ChunkRef | None, after: ChunkRef | None) -> bool:
        """Whether chunks were lost between two DATA chunks; ``found`` are the sequence numbers of
        the chunks whose header holds."""
        if self.catalogue.indexed or not self.catalogue.damaged:
            return False
        if after is None or after.sequence is None:
            end = before.offset if before else -1
            return any(f.code in TAIL_LOSSES and f.offset > end for f in self.findings)
        low = -1 if before is None or before.sequence is None else before.sequence
        return any(number not in found for number in range(low + 1, after.sequence))

    def cluster(self, ref: ChunkRef, state: Progress, wanted: set[int]) -> Iterator[Packet]:
        """The packets of one DATA chunk; damaged ones are reported instead."""
        catalogue = self.catalogue
        chunk = read_chunk(self.source, ref.offset)
        if chunk is None or chunk.header.type != "DATA":
            # Only an index can lead here: what it says is not so (IDX-003).
            catalogue.lose(
                "bad-index", ref.offset, 0, "no DATA chunk where the index has one", "IDX-003"
            )
            self.refuse_damage()
            state.broken.update(wanted)
            return
        at, size = chunk.payload_offset, len(chunk.payload)
        if chunk.intact:
            try:
                yield from parse_cluster(chunk.payload, catalogue.tracks, catalogue.level, at)
                return
            except FormatError as error:
                if not catalogue.damaged:
                    raise error.at(path=self.source.path) from None
        elif catalogue.indexed:
            catalogue.lose(
                "bad-payload",
                ref.offset,
                size + 32,
                "payload CRC of a DATA chunk differs",
                "CHK-003",
            )
            self.refuse_damage()
        for item in salvage_cluster(chunk.payload, catalogue.tracks, catalogue.level, at):
            if isinstance(item, Packet):
                yield item
            elif item is None:
                catalogue.lose("bad-table", at, size, "the packet table cannot be read", "REC-003")
                state.broken.update(wanted)
            else:
                catalogue.lose(
                    "bad-packet", item.offset, item.size,
                    f"a packet, perhaps of track {item.track}, is damaged", "DAT-004",
                )  # fmt: skip
                # The entry itself may be what is damaged: any track may have lost something.
                state.broken.update(wanted)

    def settle(self, packet: Packet, state: Progress) -> bool:
        """Order of time (DAT-006), and what was lost before this packet; False: leave it out."""
        last = state.last_stop.get(packet.track, 0)
        if packet.start < last:
            if not self.catalogue.damaged:
                raise FormatError(
                    f"packets of track {packet.track} overlap",
                    requirement="DAT-006",
                    offset=packet.offset,
                    path=self.source.path,
                )
            self.catalogue.lose(
                "overlap",
                packet.offset,
                len(packet.data),
                f"a packet of track {packet.track} covers ticks that were delivered before",
                "DAT-006",
            )
            return False
        if packet.track in state.broken:
            if packet.start > last:
                self.lost.append(LostSpan(packet.track, last, packet.start))
            state.broken.discard(packet.track)
        state.last_stop[packet.track] = packet.stop
        return True


def wanted_tracks(chosen: Sequence[ChannelRef], band: Band) -> list[Track]:
    """The tracks that a band of some channels needs, each once."""
    tracks: dict[int, Track] = {}
    for ref in chosen:
        if band != "hf":
            tracks[ref.track.id] = ref.track
        if band != "lf" and ref.residual is not None:
            tracks[ref.residual.id] = ref.residual
    return list(tracks.values())


def tick_range(rate: Fraction, start: Seconds | None, stop: Seconds | None) -> tuple[int, int]:
    """Ticks from ceil(start * rate) to ceil(stop * rate), exactly (SPEC clause 7)."""

    def tick(seconds: Seconds) -> int:
        product = Fraction(seconds) * rate
        return -(-product.numerator // product.denominator)

    return (
        0 if start is None else max(tick(start), 0),
        1 << 62 if stop is None else tick(stop),
    )


def overlaps(ref: ChunkRef, start: Seconds | None, stop: Seconds | None) -> bool:
    if ref.start_ns is None or ref.stop_ns is None:
        return True
    after = stop is not None and Fraction(stop) * 10**9 <= ref.start_ns
    before = start is not None and Fraction(start) * 10**9 >= ref.stop_ns
    return not (after or before)


def read(
    file: str | os.PathLike[str] | bytes | BinaryIO,
    channels: Sequence[str | int] | None = None,
    start: Seconds | None = None,
    stop: Seconds | None = None,
    *,
    band: Band = "full",
    limits: Limits | None = None,
) -> Recording:
    """The recording in ``file``, or a part of it; any damage raises (use Reader to go on)."""
    with Reader(file, limits=limits, strict=True) as reader:
        recording = reader.read(channels, start, stop, band=band)
        reader.refuse_damage()
        return recording


__all__ = ["BANDS", "Band", "LostSpan", "Piece", "Reader", "read"]
