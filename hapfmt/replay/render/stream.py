"""File -> packets of the played tracks, read ahead, in the memory of one cluster.

Tracks share one pass over the file while they advance together. A track gets its own pass if it has
no packets for long while packets of the others accumulate. Examples are a track with one tick an
hour, and a file that stores one track after the other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import accumulate

from ...errors import FormatError
from ...format.track import Track
from ...reading.catalogue import Catalogue, ChunkRef
from ...reading.damage import LostSpan
from ...reading.decoder import DecodedPiece
from ...reading.packets import overlapping
from ...reading.reader import Reader

AHEAD = 1 << 19
"""Samples that tracks may hold at the end of a cluster, while one of them still has nothing."""
NS = 10**9
NEVER = 1 << 80
"""Nanoseconds; means that no packet follows."""


class NewCatalogueError(Exception):
    """The index proved false: the file was walked through, and may hold other tracks."""


@dataclass(eq=False)
class PacketQueue:
    """Decoded packets of tracks that continue one another, in order of time: ticks [start, end)."""

    tracks: dict[int, Track]
    rate: Fraction
    end: int
    stop: int
    """Ticks before it came, or never come."""
    pieces: deque[DecodedPiece] = field(default_factory=deque)
    held: int = 0
    """Ticks of the pieces."""

    def put(self, piece: DecodedPiece) -> None:
        late = self.stop - piece.start
        if late >= len(piece.numbers):
            return
        if late > 0:
            exact = None if piece.exact is None else piece.exact[late:]
            piece = piece._replace(start=self.stop, numbers=piece.numbers[late:], exact=exact)
        self.pieces.append(piece)
        self.held += len(piece.numbers)
        self.stop = piece.start + len(piece.numbers)

    def pop(self) -> DecodedPiece:
        piece = self.pieces.popleft()
        self.held -= len(piece.numbers)
        return piece


class DecodingPass:
    """One pass over the file for some queues, from what they have to the end of their range."""

    def __init__(self, reader: Reader, queues: Sequence[PacketQueue]) -> None:
        self.queues = list(queues)
        # A reader of its own: which spans are lost is known by pass. In one thread, the pass is
        # where its pieces are.
        self.reader = copy(reader)
        self.reader.threads = 1
        self.reader.lost = []
        self.catalogue: Catalogue = self.reader.catalogue
        self.clusters = 0
        """Passed so far."""
        self.frontier_ns = 0
        """Packets that are still to come start then or later."""
        self.pieces: Iterator[DecodedPiece] | None = None
        self.ended = False

    def complete(self, queue: PacketQueue, tick: int) -> bool:
        """True if the queue holds everything that the file has before this tick."""
        if self.ended or queue.stop >= min(tick, queue.end):
            return True
        rate = queue.rate
        return self.frontier_ns * rate.numerator >= tick * rate.denominator * NS

    def pull(self) -> None:
        """The next packet goes to its queues."""
        if self.pieces is None:
            self.pieces = self.open()
        try:
            piece = next(self.pieces, None)
        except FormatError:
            if self.reader.catalogue is self.catalogue:
                raise
            raise NewCatalogueError from None
        if self.reader.catalogue is not self.catalogue:
            raise NewCatalogueError
        if piece is None:
            self.ended = True
            return
        for queue in self.queues:
            if piece.track.id in queue.tracks:
                queue.put(piece)

    def open(self) -> Iterator[DecodedPiece]:
        live = [queue for queue in self.queues if queue.stop < queue.end and queue.tracks]
        tracks = {id_: track for queue in live for id_, track in queue.tracks.items()}
        if not tracks:
            return iter(())
        start = min(queue.stop / queue.rate for queue in live)
        stop = max(queue.end / queue.rate for queue in live)
        starts = starts_of(overlapping(self.catalogue.data, start, stop))
        self.frontier_ns = starts[0]

        def passed(done: int, count: int) -> None:
            self.clusters += 1
            self.frontier_ns = starts[done] if count == len(starts) - 1 else 0

        return self.reader.pieces(list(tracks.values()), start, stop, exact=True, progress=passed)

    def close(self) -> None:
        if self.pieces is not None:
            self.pieces.close()  # type: ignore[attr-defined]
        self.pieces = None


def starts_of(refs: Sequence[ChunkRef]) -> list[int]:
    """The earliest packet, in nanoseconds, of each cluster and all after it, NEVER behind the last.

    Where damage hides the times of one, they are taken to be in order.
    """
    known = accumulate(
        (ref.start_ns for ref in refs), lambda a, b: a if b is None else b, initial=0
    )
    times = [0 if time is None else time for time in list(known)[1:]]
    return list(accumulate([NEVER, *reversed(times)], min))[::-1]


class PacketSource:
    """All passes that feed the given queues; each group starts with one pass.

    If the index proves false, ``rebind`` gets the corrected catalogue and reassigns the tracks of
    the queues.
    """

    def __init__(
        self,
        reader: Reader,
        groups: Sequence[Sequence[PacketQueue]],
        rebind: Callable[[Catalogue], None],
    ) -> None:
        self.reader = reader
        self.rebind = rebind
        self.streams: dict[PacketQueue, DecodingPass] = {}
        self.lists: list[list[LostSpan]] = []
        for queues in groups:
            self.start(queues)

    def start(self, queues: Sequence[PacketQueue]) -> None:
        if queues:
            self.streams |= dict.fromkeys(queues, DecodingPass(self.reader, queues))

    def fill(self, queue: PacketQueue, tick: int) -> None:
        """All of the queue that the file has before this tick."""
        before = self.streams[queue].clusters
        while not (stream := self.streams[queue]).complete(queue, tick):
            others = [other for other in stream.queues if other is not queue]
            if stream.clusters > before and sum(other.held for other in others) > AHEAD:
                stream.close()
                self.start(others)
                self.start([queue])
                before = 0
                continue
            try:
                stream.pull()
            except NewCatalogueError:
                self.renew(stream.reader.catalogue)
                before = 0
            self.keep_lost(stream)

    def keep_lost(self, stream: DecodingPass) -> None:
        """Each pass over packets has a list of its own."""
        if all(stream.reader.lost is not known for known in self.lists):
            self.lists.append(stream.reader.lost)

    def renew(self, catalogue: Catalogue) -> None:
        """The same queues from what they have on, from the file as it turned out to be."""
        self.reader.catalogue = catalogue
        self.rebind(catalogue)
        for stream in dict.fromkeys(self.streams.values()):
            stream.close()
            self.start(stream.queues)

    @property
    def lost(self) -> list[LostSpan]:
        return list(dict.fromkeys(span for spans in self.lists for span in spans))

    @property
    def groups(self) -> list[list[PacketQueue]]:
        """Queues that share a pass."""
        return [stream.queues for stream in dict.fromkeys(self.streams.values())]

    def close(self) -> None:
        for stream in dict.fromkeys(self.streams.values()):
            stream.close()
