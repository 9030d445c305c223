"""Tracks and packets -> chunks, one after the other (SPEC clauses 5, 6, 15); needs no codec."""

from __future__ import annotations

import secrets
import uuid
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple, Protocol

from ..errors import ParameterError
from ..format.cluster import HEAD_ROOM, ROW_ROOM, Packet, build_cluster
from ..format.extras import (
    BARE_COUNT,
    BARE_SIZE,
    FIRST_OFFSET,
    INDEX_EVERY,
    INDEX_SIZE,
    Attachment,
    ClockRow,
    Foot,
    Index,
    IndexEntry,
    build_attachment,
    build_clocks,
    build_digests,
    build_foot,
    build_index,
    build_map,
    build_metadata,
    ceil_ms,
    ceil_ns,
    floor_ms,
)
from ..format.track import Record, Track, build_track, chunks_of, complete, silent_tracks
from ..format.walk import FOOT_SIZE
from ..format.wire import (
    HEADER_SIZE,
    SIGNATURE,
    Head,
    build_chunk,
    cluster_seed,
    crc32,
    seed_of,
    uuid_of,
)
from ..limits import LEVELS, Level
from ..reading.opening import chain_of, copied_payloads

if TYPE_CHECKING:
    from ..reading.catalogue import Catalogue

COPY_SHARE = 50
"""HEAD and TRAK are repeated at the end (SPEC 6.1) if that adds at most a 50th to the file."""

PAYLOAD_TARGET = {1: 1 << 19, 2: 1 << 22}
"""Clusters are split above this size, well below the limit of the level."""

CHECKPOINT_SECONDS = 10
"""Between two indexes of a live writer (SPEC IDX-005)."""

JOINT_SIZE = 8
"""Bytes that one distance may grow by where two indexes become one."""

SEQUENCE_LIMIT = 1 << 32


class ChunkStream(Protocol):
    """Where chunks go. One that has ``whole_writes`` keeps all of a write or nothing: after a
    failed one the file still ends with a whole chunk, and can be closed."""

    def write(self, data: bytes, /) -> object: ...


class IndexLink(NamedTuple):
    """An index in the chain: its offset and sequence number, that of the first chunk that it lists,
    its payload's size."""

    offset: int
    sequence: int
    first: int
    size: int


class FileWriter:
    """Writes chunks to a stream, one after the other, and the index and the footer by itself.

    ``file_id`` None: at random (SPEC WRT-002). The stream needs ``write`` only. ``clock`` gives
    seconds to a live writer: it writes an index every 10 of them.
    """

    def __init__(
        self,
        stream: ChunkStream,
        *,
        level: Level = LEVELS[1],
        file_id: int | None = None,
        recording_uuid: uuid.UUID | None = None,
        epoch_ns: int | None = None,
        epoch_uncertainty_ns: int = 0,
        encoder: str = "",
        clock: Callable[[], float] | None = None,
    ) -> None:
        file_id = secrets.randbits(64) if file_id is None else file_id
        own = None if recording_uuid is None else recording_uuid.bytes
        own = None if own == uuid_of(file_id) else own
        head = Head(level.number, own, epoch_ns, epoch_uncertainty_ns, encoder)
        self.begin(stream, head, head.build(), file_id, clock)
        stream.write(SIGNATURE)
        self.offset += len(SIGNATURE)
        self.chunk("HEAD", self.head_payload)

    def begin(
        self,
        stream: ChunkStream,
        head: Head,
        payload: bytes,
        file_id: int,
        clock: Callable[[], float] | None,
    ) -> None:
        self.stream = stream
        self.head, self.head_payload = head, payload
        self.level, self.file_id = LEVELS[head.level], file_id
        self.offset = self.sequence = 0
        self.tracks: dict[int, Track] = {}
        self.descriptions: list[bytes] = []
        self.copied: set[int] = set()
        """File CRCs of the payloads of HEAD and TRAK chunks that the file holds twice."""
        self.entries: list[IndexEntry] = []
        """Entries of all chunks: their places are the sequence numbers."""
        self.resumed_entries = 0
        self.parts: list[IndexLink] = []
        self.indexed_entries = 0
        """Chunks up to the last index and its footer."""
        self.indexed_to = FIRST_OFFSET
        self.seconds = clock
        self.indexed_at = clock() if clock else 0.0
        self.stop = Fraction(0)
        self.closed = self.ending = False
        self.failed: OSError | None = None
        self.unwritten: list[Packet] = []
        """Packets that a failed write lost."""

    @classmethod
    def resume(
        cls,
        stream: ChunkStream,
        catalogue: Catalogue,
        *,
        clock: Callable[[], float] | None = None,
    ) -> FileWriter:
        """Goes on where a file without damage ends; ``stream`` writes there (SPEC WRT-006)."""
        assert catalogue.head is not None and catalogue.file_id is not None
        self = cls.__new__(cls)
        self.begin(stream, catalogue.head, catalogue.head_payload, catalogue.file_id, clock)
        self.offset = catalogue.source.size
        self.tracks = dict(catalogue.tracks)
        self.descriptions = list(catalogue.table.payloads.values())
        self.entries = [
            IndexEntry(
                ref.type,
                ref.offset,
                floor_ms(Fraction(ref.start_ns or 0, 10**9)),
                ceil_ms(Fraction(ref.stop_ns or 0, 10**9)),
            )
            for ref in catalogue.chunks
        ]
        self.resumed_entries = len(self.entries)
        offsets = [entry.offset for entry in self.entries]
        self.copied = copied_payloads(catalogue.source, self.entries)
        for offset, index in chain_of(catalogue, self.entries):
            place = bisect_left(offsets, offset)
            size = len(build_index(index))
            self.parts.append(IndexLink(offset, place, index.first_sequence, size))
            self.indexed_to, self.indexed_entries = offset, place + 1
        if catalogue.closed:
            self.indexed_entries = len(self.entries)
        self.sequence = len(self.entries)
        self.stop = catalogue.duration
        self.closed = catalogue.closed
        return self

    def chunk(self, type_: str, payload: bytes) -> None:
        """One whole chunk in one write (SPEC WRT-001)."""
        if self.failed:
            raise self.failed
        if len(payload) > self.level.payload_size:
            raise ParameterError(
                f"a {type_} chunk of {len(payload)} bytes is above {self.level.payload_size}, "
                f"the limit of level {self.level.number}"
            )
        if type_ not in ("iNDX", "fOOT") and self.index_due(HEADER_SIZE + len(payload)):
            self.index()
        self.put_chunk(type_, payload)

    def put_chunk(self, type_: str, payload: bytes, times: tuple[int, int] = (0, 0)) -> None:
        """Under the next sequence number."""
        if self.sequence >= SEQUENCE_LIMIT:
            raise ParameterError("a file holds at most 2^32 chunks")
        entry = IndexEntry(type_, self.offset, *times)
        chunk = build_chunk(type_, payload, file_id=self.file_id, sequence=self.sequence)
        try:
            self.stream.write(chunk)
        except OSError as error:
            self.end_early(error)
            raise
        self.offset += len(chunk)
        self.closed = type_ == "fOOT"
        self.sequence += 1
        self.entries.append(entry)

    def describe(self, tracks: Sequence[Track]) -> None:
        """TRAK chunks, as few as hold them in this order."""
        self.describe_as((track, build_track(track)) for track in tracks)

    def describe_as(self, records: Iterable[Record]) -> None:
        """The same with these very bytes for each track."""
        for payload, tracks in chunks_of(records):
            self.chunk("TRAK", payload)
            self.descriptions.append(payload)
            self.tracks.update((track.id, track) for track in tracks)

    def metadata(self, metadata: dict[str, object]) -> None:
        self.chunk("mETa", build_metadata(metadata))

    def attach(self, attachment: Attachment) -> None:
        self.chunk("aTTc", build_attachment(attachment))

    def clock(self, clock: str, track: int | None, rows: Iterable[ClockRow]) -> None:
        """cLOk chunks for observations, in order, as few as hold them."""
        for payload in build_clocks(clock, track, rows):
            self.chunk("cLOk", payload)

    def clock_map(self, clock: str, track: int | None, points: Sequence[tuple[int, int]]) -> None:
        """A cMAp chunk."""
        self.chunk("cMAp", build_map(clock, track, points))

    def cluster(self, packets: Iterable[Packet]) -> None:
        """DATA chunks for the packets of one stretch of time; several where one grows too large."""
        batch: list[Packet] = []
        size = samples = written = 0
        target = PAYLOAD_TARGET[self.level.number]
        packets = sorted(packets, key=lambda p: (p.track, p.start))
        try:
            for packet in packets:
                weight = len(packet.data) + ROW_ROOM
                count = self.tracks[packet.track].weight(packet.span, len(packet.data))
                # Packets of events may start together; in one cluster they must not (DAT-002).
                again = batch and (batch[-1].track, batch[-1].start) == (packet.track, packet.start)
                full = (
                    again
                    or size + weight > target
                    or samples + count > self.level.cluster_samples
                    or len(batch) >= self.level.packets
                )
                if batch and full:
                    self.data(batch)
                    written += len(batch)
                    batch, size, samples = [], 0, 0
                batch.append(packet)
                size += weight
                samples += count
            if batch:
                self.data(batch)
        except OSError:
            self.unwritten += packets[written:]
            raise

    def data(self, packets: Sequence[Packet]) -> None:
        ends: dict[tuple[int, int], tuple[int, int]] = {}
        for packet in packets:
            rate = self.tracks[packet.track].rate.as_integer_ratio()
            low, high = ends.get(rate, (packet.start, packet.stop))
            ends[rate] = min(low, packet.start), max(high, packet.stop)
        start = min(Fraction(low * d, n) for (n, d), (low, _) in ends.items())
        stop = max(Fraction(high * d, n) for (n, d), (_, high) in ends.items())
        room = HEAD_ROOM + sum(ROW_ROOM + len(packet.data) for packet in packets)
        if self.failed:
            raise self.failed
        if self.index_due(HEADER_SIZE + room):
            self.index()
        payload = build_cluster(packets, cluster_seed(self.file_id, self.sequence))
        times = floor_ms(start), ceil_ms(stop)
        self.put_chunk("DATA", payload, times)
        self.stop = max(self.stop, stop)

    def index_due(self, size: int) -> bool:
        """Whether an index comes before a chunk of ``size`` bytes (SPEC IDX-005)."""
        if len(self.entries) == self.indexed_entries or self.ending:
            return False
        late = self.seconds is not None and self.seconds() - self.indexed_at >= CHECKPOINT_SECONDS
        return late or self.offset - self.indexed_to + size > INDEX_EVERY

    def checkpoint(self) -> None:
        """Write an index of the chunks without one, if there are any."""
        if len(self.entries) > self.indexed_entries:
            self.index()

    def index(self, *, closing: bool = False) -> None:
        """Write an index of the chunks without one; at the end of more, so that the chain is
        short."""
        parts = list(self.parts)
        first = parts[-1].sequence if parts else 0
        if closing:
            room = self.level.payload_size - JOINT_SIZE
            room -= len(build_index(Index(0, first, tuple(self.entries[first:]))))
            while parts and self.joins(parts[-1], first, room):
                _, _, first, size = parts.pop()
                room -= size - INDEX_SIZE + JOINT_SIZE
        before = parts[-1].offset if parts else 0
        payload = build_index(Index(before, first, tuple(self.entries[first:])))
        offset, sequence = self.offset, self.sequence
        self.chunk("iNDX", payload)
        self.parts = [*parts, IndexLink(offset, sequence, first, len(payload))]
        self.indexed_to, self.indexed_entries = offset, len(self.entries)
        self.indexed_at = self.seconds() if self.seconds else 0.0

    def joins(self, part: IndexLink, first: int, room: int) -> bool:
        """Whether the last index repeats ``part``, the one before ``first``. It always repeats
        those of this writer. It repeats those of the existing file only where they are no longer
        than the new entries. This way repeated small appends add little to the file."""
        if part.size - INDEX_SIZE + JOINT_SIZE > room:
            return False
        return part.first >= self.resumed_entries or 2 * first <= len(self.entries) + part.first

    def digest(self, digests: dict[int, bytes]) -> None:
        """dGST chunks; ``digests`` by track id, runs of ids in one chunk each."""
        run: list[int] = []
        for track in sorted(digests):
            if run and track != run[-1] + 1:
                self.chunk("dGST", build_digests(run[0], [digests[id_] for id_ in run]))
                run = []
            run.append(track)
        if run:
            self.chunk("dGST", build_digests(run[0], [digests[id_] for id_ in run]))

    def close(self) -> None:
        """Copies of the description, index, footer; the stream stays open.

        Channel numbers that nothing was described for get an empty track (TRK-010).
        Nothing is written where the file was closed and nothing came since. On a full disk the
        copies may be missing.
        """
        if self.closed:
            return
        try:
            self.describe(silent_tracks(list(self.tracks.values())))
            seed = seed_of(self.file_id)
            described = [("HEAD", self.head_payload)]
            described += [("TRAK", payload) for payload in self.descriptions]
            copies = {crc32(payload, seed): (type_, payload) for type_, payload in described}
            copies = {crc: copies[crc] for crc in copies if crc not in self.copied}
            size = sum(len(payload) + HEADER_SIZE for _, payload in copies.values())
            # HEAD and TRAK again (SPEC 6.1), each once in the life of a file.
            for crc in copies if COPY_SHARE * size <= self.offset else ():
                self.chunk(*copies[crc])
                self.copied.add(crc)
            if not self.is_bare():
                self.index(closing=True)
            self.foot()
        except OSError:
            if not self.closed:
                raise

    def foot(self) -> None:
        distance = self.offset - self.parts[-1].offset if self.parts else 0
        self.chunk("fOOT", build_foot(Foot(distance, ceil_ns(self.stop))))

    def is_bare(self) -> bool:
        """Whether the file may be closed without any index (SPEC IDX-005)."""
        small = self.offset + FOOT_SIZE <= BARE_SIZE and self.sequence < BARE_COUNT
        return small and not any(entry.type == "iNDX" for entry in self.entries)

    def end_early(self, error: OSError) -> None:
        """After a failed write: index and footer, where there is room; then nothing more."""
        if self.ending:
            return
        self.ending = True
        whole = not self.closed and getattr(self.stream, "whole_writes", False)
        if whole and self.entries and complete(self.tracks.values()):
            bare = self.is_bare()
            # An index of everything may find no room where one of the rest does.
            for closing in () if bare else (True, False):
                with suppress(OSError):
                    self.index(closing=closing)
                    break
            if bare or self.indexed_entries == len(self.entries):
                with suppress(OSError):
                    self.foot()
        self.failed = error
