"""When the DATA chunks of a damaged file stood, by the indexes that hold (SPEC 12.2)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import NamedTuple

from ..container.index import FIRST_OFFSET, MS_LIMIT, Index, parse_index
from ..container.walk import read_chunk
from ..errors import FormatError
from .catalogue import Catalogue, ChunkRef

ANYWHERE = 1 << 63
"""Bytes may have come in or gone: an index does not stand where it stood."""


class Times(NamedTuple):
    """Milliseconds that lost packets lie within; ``stop`` None: nobody knows how long."""

    start: int = 0
    stop: int | None = None


UNKNOWN = Times()
NOTHING = Times(0, 0)


class Timeline:
    """What indexes say of the DATA chunks, by their sequence numbers."""

    def __init__(self, catalogue: Catalogue, refs: Sequence[ChunkRef]) -> None:
        known = [None if ref.start_ns is None else ref.sequence for ref in refs]
        self.before = list(accumulate([None, *known], newest))
        """Before each of the chunks, the sequence number of the last one that is intact."""
        self.after = list(accumulate([None, *reversed(known)], newest))[::-1]
        """That of the first one from there on."""
        self.listed: dict[int, tuple[int, int]] = {}
        """Milliseconds of the DATA chunks, of all from some one on."""
        self.first: int | None = None
        """The sequence number from which on all chunks are listed."""
        self.end = 0
        """Where the last index stands: nothing says what came after it."""
        self.read(catalogue)
        self.numbers = sorted(self.listed)

    def read(self, catalogue: Catalogue) -> None:
        types = {ref.sequence: ref.type for ref in catalogue.chunks if ref.sequence is not None}
        last = -1
        for ref in catalogue.chunks:
            chunk = read_chunk(catalogue.source, ref.offset) if ref.type == "iNDX" else None
            if chunk is None or not chunk.intact or not chunk.header.known:
                continue
            try:
                index = parse_index(chunk.payload, ANYWHERE, chunk.payload_offset)
            except FormatError:
                continue
            numbers = sequences(index, chunk.header.sequence, types)
            if numbers is None:
                continue
            first = numbers[0] if numbers else chunk.header.sequence
            if self.first is None or first > last + 1:
                self.first, self.listed = first, {}
            self.first = min(self.first, first)
            last, self.end = chunk.header.sequence, ref.offset
            for entry, number in zip(index.entries, numbers, strict=True):
                if entry.type == "DATA":
                    self.listed[number] = entry.start_ms, entry.stop_ms
        if catalogue.foot is not None:
            self.end = ANYWHERE

    def between(self, number: int, offset: int) -> Times:
        """Times of the DATA chunks that are lost, or damaged, around the chunk with this number
        among the chunks, or just before it; ``offset``: of the damage."""
        before, high = self.before[number], self.after[number]
        low = -1 if before is None else before
        if self.first is None or low + 1 < self.first or (high is None and offset > self.end):
            return UNKNOWN
        stop = len(self.numbers) if high is None else bisect_left(self.numbers, high)
        lost = self.numbers[bisect_right(self.numbers, low) : stop]
        if not lost:
            return NOTHING
        times = [self.listed[each] for each in lost]
        latest = max(stop for _, stop in times)
        return Times(min(start for start, _ in times), latest if latest < MS_LIMIT else None)


def newest(last: int | None, number: int | None) -> int | None:
    return last if number is None else number


def sequences(index: Index, own: int, types: Mapping[int, str]) -> list[int] | None:
    """The sequence numbers of the chunks that an index lists: all before it but iNDX and fOOT, so
    that they are told from behind. None where the chunks that were found contradict."""
    numbers = []
    number = own
    for entry in reversed(index.entries):
        number -= 1
        while types.get(number) in ("iNDX", "fOOT"):
            number -= 1
        if number < 0 or types.get(number, entry.type) != entry.type:
            return None
        numbers.append(number)
    if index.covers_from == FIRST_OFFSET and number != 0:
        # An index or a footer between them was not found.
        return None
    return numbers[::-1]
