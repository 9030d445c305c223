"""When the DATA chunks of a damaged file stood, by the indexes that hold (SPEC 12.2)."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import NamedTuple

from ..container.index import FIRST_OFFSET, MS_LIMIT, Index, ceil_ms, floor_ms, parse_index
from ..container.walk import read_chunk
from ..errors import FormatError
from ..numbers import exact
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
    """What indexes say of the DATA chunks, matched with those that are intact by their times."""

    def __init__(self, catalogue: Catalogue, refs: Sequence[ChunkRef]) -> None:
        self.refs = refs
        self.listed: list[tuple[int, int]] = []
        """Milliseconds of the DATA chunks, of all from some one on."""
        self.whole = False
        """Whether from the first one."""
        self.end = 0
        """Where the last index stands: nothing says what came after it."""
        self.read(catalogue)
        self.matched = self.match()
        """(place among ``refs``, place in ``listed``), both growing."""

    def read(self, catalogue: Catalogue) -> None:
        listed: dict[int, tuple[int, int]] = {}
        before: tuple[int, Index] | None = None
        feet = 0
        for ref in catalogue.chunks:
            feet += ref.type == "fOOT"
            chunk = read_chunk(catalogue.source, ref.offset) if ref.type == "iNDX" else None
            if chunk is None or not chunk.intact or not chunk.header.known:
                continue
            try:
                index = parse_index(chunk.payload, ANYWHERE, chunk.payload_offset)
            except FormatError:
                continue
            if index.covers_from == FIRST_OFFSET:
                self.whole = True
            elif before is None or not follows(before, chunk.header.sequence - feet, index):
                self.whole, listed = False, {}
            before, self.end, feet = (chunk.header.sequence, index), ref.offset, 0
            for entry in index.entries:
                if entry.type == "DATA":
                    listed[entry.offset] = entry.start_ms, entry.stop_ms
        self.listed = [listed[offset] for offset in sorted(listed)]
        if catalogue.foot is not None:
            self.end = ANYWHERE

    def match(self) -> list[tuple[int, int]]:
        places: dict[tuple[int, int], list[int]] = {}
        for place, times in enumerate(self.listed):
            places.setdefault(times, []).append(place)
        found: list[tuple[int, int]] = []
        last = -1
        for number, ref in enumerate(self.refs):
            if ref.start_ns is None or ref.stop_ns is None:
                continue
            second = exact(10**9)
            times = floor_ms(exact(ref.start_ns) / second), ceil_ms(exact(ref.stop_ns) / second)
            known = places.get(times, [])
            at = bisect_right(known, last)
            if at < len(known):
                last = known[at]
                found.append((number, last))
        return found

    def between(self, number: int, offset: int) -> Times:
        """Times of the DATA chunks that are lost, or damaged, around the chunk with this number
        among ``refs``, or just before it; ``offset``: of the damage."""
        at = bisect_right(self.matched, (number, -1))
        low = self.matched[at - 1][1] + 1 if at else 0
        if at < len(self.matched):
            high = self.matched[at][1]
        elif offset <= self.end:
            high = len(self.listed)
        else:
            return UNKNOWN
        if not self.listed or (not at and not self.whole):
            return UNKNOWN
        if low >= high:
            return NOTHING
        times = self.listed[low:high]
        stop = max(stop for _, stop in times)
        return Times(min(start for start, _ in times), stop if stop < MS_LIMIT else None)


def follows(before: tuple[int, Index], sequence: int, index: Index) -> bool:
    """Whether an index lists every chunk since the one before it: its entries fill the sequence
    numbers between them."""
    last = before[1].entries[-1].offset if before[1].entries else before[1].covers_from
    newer = sum(entry.offset > last for entry in index.entries)
    return newer == sequence - before[0] - 1
