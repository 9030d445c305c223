"""Follows a growing file: delivers each chunk when it is complete, as facts or as decoded pieces.

An incomplete chunk at the end does not count as damage. Such a chunk is delivered only when an
intact chunk follows it. The reader holds one cluster and the first index of the file in memory.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import FormatError, ParameterError
from ..files import Closing
from ..format.cluster import Packet, parse_cluster, salvage_cluster
from ..format.extras import FIRST_OFFSET
from ..format.source import is_url, open_source
from ..format.track import Track
from ..format.walk import Chunk, Finding, header_at, identify, read_chunk, walk
from ..format.wire import SIGNATURE
from .catalogue import Catalogue, ChannelRef, FalseIndexError
from .opening import learn_checkpoint, lose_chunk, no_signature
from .packets import PacketPass, Seconds, tick_range

if TYPE_CHECKING:
    from .decoder import Band, DecodedPiece, TrackDecoder

INTERVAL = 0.2
"""Seconds between two looks at the file."""


class Follower(Closing):
    """Reads a file that still grows.

    It ends when the file is closed, after ``timeout`` seconds without news, when ``until(self)`` is
    true, or after :meth:`stop`. It looks every ``interval`` seconds.

    A file that is replaced or shortened is read again from its start; ``restarts`` counts that.
    ``findings`` of the catalogue list damage, but not the incomplete end.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        interval: float = INTERVAL,
        timeout: float | None = None,
        until: Callable[[Follower], bool] | None = None,
    ) -> None:
        if isinstance(path, str) and is_url(path):
            raise ParameterError("only a local file can be followed")
        self.path = os.fspath(path)
        self.interval, self.timeout, self.until = interval, timeout, until
        self.restarts = 0
        self.stamp: tuple[int, int] | None = None
        self.stopped = threading.Event()
        self.begin()
        try:
            if self.look() and self.start() and self.file_id is not None:
                self.start_at_index(self.file_id)
        except BaseException:
            self.source.close()
            raise
        # All chunks after the index are new.
        self.stamp = None

    def begin(self) -> None:
        """Open the file that has the name now, and start at its first byte."""
        if not Path(self.path).is_file() and Path(self.path).exists():
            raise ParameterError(f"{self.path} is not a file that could grow")
        self.source = open_source(self.path)
        status = Path(self.path).stat()
        self.identity = status.st_dev, status.st_ino
        self.stamp = None
        self.catalogue = Catalogue(self.source)
        self.last: Chunk | None = None
        self.file_id: int | None = None
        self.first_id: int | None = None
        """That of the HEAD at the start: another one shows another file."""
        self.closed = False
        self.cluster_count = 0
        self.stop_ns = 0
        self.cluster_at = status.st_mtime
        """When the last cluster was seen, in seconds of time.time()."""

    def close(self) -> None:
        self.source.close()

    def stop(self) -> None:
        """End the iterators; may be called in any thread."""
        self.stopped.set()

    @property
    def duration(self) -> Fraction:
        return Fraction(self.stop_ns, 10**9)

    @property
    def channels(self) -> list[ChannelRef]:
        """The channels that are described so far."""
        return self.catalogue.channels

    def chunks(self) -> Iterator[Chunk]:
        """Every further chunk as soon as it is complete, until the follower ends."""
        quiet_from = time.monotonic()
        while True:
            for chunk in self.poll():
                quiet_from = time.monotonic()
                yield chunk
            quiet = time.monotonic() - quiet_from
            if self.closed or self.stopped.is_set() or (self.until and self.until(self)):
                return
            if self.timeout is not None and quiet >= self.timeout:
                return
            self.stopped.wait(self.interval)

    def poll(self) -> Iterator[Chunk]:
        """The chunks that were completed since the last call."""
        if not self.look() or not self.start():
            return
        findings: list[Finding] = []
        told = 0
        waiting: list[Chunk] = []
        for chunk in walk(self.source, findings, self.file_id, after=self.last):
            waiting.append(chunk)
            if not chunk.intact:
                continue
            self.catalogue.findings += findings[told:]
            told = len(findings)
            for whole in waiting:
                self.learn(whole)
                yield whole
            waiting = []

    def look(self) -> bool:
        """True if the file has changed since the last call."""
        try:
            status = Path(self.path).stat()
        except FileNotFoundError:
            return False
        other = (status.st_dev, status.st_ino) != self.identity
        if not other and self.file_id is not None:
            head = header_at(self.source, FIRST_OFFSET, None)
            other = head is None or head.file_id != self.first_id
            other = other or (self.last is not None and status.st_size < self.last.stop)
        if other:
            before = self.source
            try:
                self.begin()
                status = Path(self.path).stat()
            except FileNotFoundError:
                return False
            before.close()
            self.restarts += 1
        stamp = status.st_size, status.st_mtime_ns
        if stamp == self.stamp:
            return False
        self.stamp = stamp
        self.source.size = status.st_size
        return True

    def start(self) -> bool:
        """True if the first chunk of the file is complete."""
        if self.file_id is not None:
            return True
        begins = self.source.read_at(0, len(SIGNATURE))
        if begins != SIGNATURE[: len(begins)]:
            raise no_signature(self.source)
        first = read_chunk(self.source, FIRST_OFFSET)
        if first is None or not first.intact:
            return False
        self.first_id = first.header.file_id
        # A spliced file may be that of another id: every reader takes the same (REC-013).
        self.file_id = self.catalogue.file_id = identify(self.source)
        return True

    def start_at_index(self, file_id: int) -> None:
        catalogue = Catalogue(self.source, file_id=file_id, indexed=True)
        try:
            index = learn_checkpoint(catalogue, file_id)
        except FormatError:
            return
        if index is None:
            return
        catalogue.indexed = False
        self.catalogue, self.last = catalogue, index
        self.cluster_count = len(catalogue.data)
        self.stop_ns = max((ref.stop_ns or 0 for ref in catalogue.data), default=0)

    def learn(self, chunk: Chunk) -> None:
        """Add a chunk to the catalogue, with the parts of its payload that are needed later."""
        self.last = Chunk(chunk.header, chunk.offset, b"", chunk.intact)
        self.catalogue.foot = None
        ref = None
        if chunk.intact:
            try:
                ref = self.catalogue.learn(chunk)
            except FormatError as error:
                if not self.catalogue.damaged:
                    raise error.at(path=self.path) from None
                lose_chunk(self.catalogue, chunk, error)
        if chunk.header.type == "DATA":
            self.cluster_count += 1
            self.cluster_at = time.time()
            self.stop_ns = max(self.stop_ns, (ref and ref.stop_ns) or 0)
        self.closed = self.catalogue.foot is not None and chunk.stop == self.source.size

    def pieces(
        self,
        channels: Sequence[str | int] | str | int | None = None,
        start: Seconds | None = None,
        *,
        band: Band = "full",
        exact: bool = False,
    ) -> Iterator[DecodedPiece]:
        """Decoded packets as they arrive. ``start``: from this second on; None: only new ones.

        ``channels``: labels or numbers; it waits for those that are not described yet. None: all
        channels and events, also those that are added later.
        """
        wanted = WantedPackets(self, channels, band, exact, start)
        if start is None:
            for _ in self.poll():
                pass
        else:
            yield from self.past(wanted, start)
        for chunk in self.chunks():
            if chunk.header.type == "DATA":
                for packet in self.packets(chunk):
                    yield from wanted.decode(packet)

    def past(self, wanted: WantedPackets, start: Seconds) -> Iterator[DecodedPiece]:
        """Decoded packets of the clusters in the index, from second ``start`` on."""
        if self.last is None:
            return
        ranges = {track.id: tick_range(track.rate, start, None) for track in wanted.tracks()}
        try:
            for packet in PacketPass(self.catalogue, lambda: None).packets(ranges, start):
                yield from wanted.decode(packet)
        except FalseIndexError:
            self.source.close()
            self.begin()

    def packets(self, chunk: Chunk) -> Iterator[Packet]:
        catalogue, at = self.catalogue, chunk.payload_offset
        tracks, level, seed = catalogue.tracks, catalogue.level, chunk.header.cluster_seed
        if catalogue.unsupported:
            raise catalogue.unsupported
        if chunk.intact:
            try:
                yield from parse_cluster(chunk.payload, tracks, level, at, seed)
                return
            except FormatError as error:
                if not catalogue.damaged:
                    raise error.at(path=self.path) from None
        for item in salvage_cluster(chunk.payload, tracks, level, at, seed):
            if isinstance(item, Packet):
                yield item


class WantedPackets:
    """Which packets are decoded, and how far each track has come."""

    def __init__(
        self,
        follower: Follower,
        channels: Sequence[str | int] | str | int | None,
        band: Band,
        exact: bool,
        start: Seconds | None,
    ) -> None:
        self.follower, self.band, self.exact, self.start = follower, band, exact, start
        names = [channels] if isinstance(channels, (str, int)) else channels
        self.names = None if names is None else {str(name) for name in names}
        self.catalogue: Catalogue | None = None
        self.known = 0
        self.decoders: dict[int, TrackDecoder] = {}
        self.ranges: dict[int, tuple[int, int]] = {}
        self.stops: dict[int, int] = {}

    def tracks(self) -> list[Track]:
        """As far as they are described."""
        from .decoder import wanted_tracks

        chosen = [
            ref
            for ref in self.follower.channels
            if self.names is None or {ref.label, str(ref.number)} & self.names
        ]
        layers = self.follower.catalogue.layers if self.names is None else []
        return [*wanted_tracks(chosen, self.band), *layers]

    def refresh(self) -> None:
        from .decoder import TrackDecoder

        catalogue = self.follower.catalogue
        if catalogue.source is not getattr(self.catalogue, "source", None):
            # Another file: reset all tracks.
            self.decoders, self.stops, self.known = {}, {}, 0
        self.catalogue = catalogue
        if self.known != len(catalogue.tracks):
            self.known = len(catalogue.tracks)
            for track in self.tracks():
                decoder = TrackDecoder(track, catalogue.level, self.follower.path)
                self.decoders.setdefault(track.id, decoder)
                self.ranges[track.id] = tick_range(track.rate, self.start, None)

    def decode(self, packet: Packet) -> Iterator[DecodedPiece]:
        """The piece, unless it is not wanted or was delivered before."""
        from .decoder import PieceDecoder

        self.refresh()
        if packet.track not in self.decoders:
            return
        # Events come in any order: those of a later place in the file are new.
        layer = self.decoders[packet.track].track.kind == "events"
        place, stop = (packet.offset, packet.offset + 1) if layer else (packet.start, packet.stop)
        if place < self.stops.get(packet.track, 0):
            return
        self.stops[packet.track] = stop
        if packet.stop <= self.ranges[packet.track][0]:
            return
        try:
            yield PieceDecoder(self.decoders, self.ranges, exact=self.exact).decode(packet)
        except FormatError as fault:
            catalogue = self.follower.catalogue
            if not catalogue.damaged:
                raise
            rule = fault.requirement or "COD-001"
            catalogue.lose("bad-packet", packet.offset, len(packet.data), fault.message, rule)
