"""Tracks and packets -> chunks, one after the other (SPEC clauses 5, 6, 13); needs no codec."""

from __future__ import annotations

import secrets
import uuid
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import BinaryIO

from ..errors import ParameterError
from ..limits import LEVELS, Level
from .cluster import Packet, build_cluster, entry_size
from .extras import Attachment, build_attachment, build_metadata
from .index import (
    ENTRY_SIZES,
    FIRST_OFFSET,
    INDEX_EVERY,
    Foot,
    Index,
    IndexEntry,
    build_foot,
    build_index,
    ceil_ms,
    ceil_ns,
    floor_ms,
)
from .series import build_series
from .track import Track, series_of
from .wire import HEADER_SIZE, NO_TRACK, SIGNATURE, ChunkHeader, Head, crc32

COPY_SHARE = 50
"""HEAD and TRAK are repeated at the end (SPEC 6.1) where that adds at most a 50th to the file."""

PAYLOAD_TARGET = {1: 1 << 19, 2: 1 << 22}
"""Clusters are split above this size, well below the limit of the level."""


class FileWriter:
    """Writes chunks to a stream, one after the other, and the index and the footer by itself.

    ``file_id`` None: at random (SPEC WRT-005). The stream needs ``write`` only.
    """

    def __init__(
        self,
        stream: BinaryIO,
        *,
        level: Level = LEVELS[1],
        file_id: int | None = None,
        recording_uuid: uuid.UUID | None = None,
        epoch_ns: int | None = None,
        epoch_uncertainty_ns: int = 0,
    ) -> None:
        self.stream = stream
        self.level = level
        self.file_id = secrets.randbits(32) if file_id is None else file_id
        self.head = Head(
            level.number,
            self.file_id,
            recording_uuid.bytes if recording_uuid else None,
            epoch_ns,
            epoch_uncertainty_ns,
        )
        self.offset = 0
        self.sequence = 0
        self.tracks: dict[int, Track] = {}
        self.series: list[tuple[int, bytes]] = []
        self.entries: list[IndexEntry] = []
        self.indexed_entries = 0
        self.indexed_to = FIRST_OFFSET
        self.last_index = 0
        self.data_count = 0
        self.stop = Fraction(0)
        self.put(SIGNATURE)
        self.chunk("HEAD", self.head.build())

    def put(self, data: bytes) -> None:
        self.stream.write(data)
        self.offset += len(data)

    def chunk(
        self,
        type_: str,
        payload: bytes,
        track: int = NO_TRACK,
        times: tuple[int, int] = (0, 0),
        flags: int = 0,
    ) -> None:
        """One whole chunk in one write (SPEC WRT-001)."""
        if len(payload) > self.level.payload_size:
            raise ParameterError(
                f"a {type_} chunk of {len(payload)} bytes is above {self.level.payload_size}, "
                f"the limit of level {self.level.number}"
            )
        unindexed = self.offset - self.indexed_to + HEADER_SIZE + len(payload)
        if type_ != "iNDX" and unindexed > INDEX_EVERY and len(self.entries) > self.indexed_entries:
            self.index()
        entry = IndexEntry(type_, self.offset, *times)
        header = ChunkHeader(
            type_, self.file_id, self.sequence, len(payload), track, flags, crc32(payload)
        )
        self.put(header.build() + payload)
        self.sequence += 1
        if type_ not in ("iNDX", "fOOT"):
            self.entries.append(entry)

    def describe(self, tracks: Sequence[Track]) -> None:
        """TRAK chunks for tracks in order of their ids."""
        for series in series_of(tracks):
            self.describe_as(build_series(series), series)

    def describe_as(self, payload: bytes, series: Sequence[Track]) -> None:
        """A TRAK chunk with these very bytes, which describe ``series``."""
        self.series.append((series[0].id, payload))
        self.chunk("TRAK", payload, series[0].id)
        self.tracks.update((track.id, track) for track in series)

    def metadata(self, metadata: dict[str, object]) -> None:
        self.chunk("mETa", build_metadata(metadata))

    def attach(self, attachment: Attachment) -> None:
        self.chunk("aTTc", build_attachment(attachment))

    def cluster(self, packets: Iterable[Packet]) -> None:
        """DATA chunks for the packets of one stretch of time; several where one grows too large."""
        batch: list[Packet] = []
        size = samples = 0
        target = PAYLOAD_TARGET[self.level.number]
        for packet in sorted(packets, key=lambda p: (p.track, p.start)):
            weight = len(packet.data) + entry_size(packet)
            count = packet.span * len(self.tracks[packet.track].components)
            full = (
                size + weight > target
                or samples + count > self.level.cluster_samples
                or len(batch) >= self.level.packets
            )
            if batch and full:
                self.data(batch)
                batch, size, samples = [], 0, 0
            batch.append(packet)
            size += weight
            samples += count
        if batch:
            self.data(batch)

    def data(self, packets: Sequence[Packet]) -> None:
        ends: dict[tuple[int, int], tuple[int, int]] = {}
        for packet in packets:
            rate = self.tracks[packet.track].rate.as_integer_ratio()
            low, high = ends.get(rate, (packet.start, packet.stop))
            ends[rate] = min(low, packet.start), max(high, packet.stop)
        start = min(Fraction(low * d, n) for (n, d), (low, _) in ends.items())
        stop = max(Fraction(high * d, n) for (n, d), (_, high) in ends.items())
        payload = build_cluster(packets)
        self.chunk("DATA", payload, times=(floor_ms(start), ceil_ms(stop)))
        self.data_count += 1
        self.stop = max(self.stop, stop)

    def index(self, *, everything: bool = False) -> None:
        """An index of what was not indexed yet, or of everything where that fits a payload."""
        entries, covers_from = self.entries[self.indexed_entries :], self.indexed_to
        if everything and len(self.entries) * ENTRY_SIZES[1] < self.level.payload_size // 2:
            entries, covers_from = self.entries, FIRST_OFFSET
        payload = build_index(Index(covers_from, self.last_index, tuple(entries)))
        self.last_index, self.indexed_to = self.offset, self.offset
        self.indexed_entries = len(self.entries)
        self.chunk("iNDX", payload)

    def digest(self, digests: dict[int, bytes]) -> None:
        """dGST chunks; ``digests`` by track id, runs of ids in one chunk each."""
        run: list[int] = []
        for track in sorted(digests):
            if run and track != run[-1] + 1:
                self.chunk("dGST", b"".join(digests[t] for t in run), run[0])
                run = []
            run.append(track)
        if run:
            self.chunk("dGST", b"".join(digests[t] for t in run), run[0])

    def close(self) -> None:
        """Copies of the description, index, footer; the stream stays open."""
        described = [self.head.build(), *(payload for _, payload in self.series)]
        if COPY_SHARE * sum(len(part) + HEADER_SIZE for part in described) <= self.offset:
            self.chunk("HEAD", self.head.build())
            for track, payload in self.series:
                self.chunk("TRAK", payload, track)
        self.index(everything=True)
        foot = Foot(
            self.last_index,
            self.offset + HEADER_SIZE + 32,
            self.data_count,
            len(self.tracks),
            ceil_ns(self.stop),
        )
        self.chunk("fOOT", build_foot(foot))
