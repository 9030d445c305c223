"""Which DATA chunks a damaged file has lost, and when they were, by its indexes (SPEC 14.2)."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import NamedTuple

from ..format.index import MS_LIMIT, IndexEntry, parse_index
from ..format.walk import read_chunk
from ..errors import FormatError
from .catalogue import Catalogue

ANYWHERE = 1 << 63
"""Bytes may have come in or gone: an index does not stand where it stood."""


class Times(NamedTuple):
    """Milliseconds that lost packets lie within; ``stop`` None: nobody knows how long."""

    start: int = 0
    stop: int | None = None


UNKNOWN = Times()
NOTHING = Times(0, 0)


class Timeline:
    """What the intact indexes say of chunks, by their sequence numbers."""

    def __init__(self, catalogue: Catalogue) -> None:
        self.listed: dict[int, IndexEntry] = {}
        for ref in catalogue.chunks:
            chunk = read_chunk(catalogue.source, ref.offset) if ref.type == "iNDX" else None
            if chunk is None or not chunk.intact or not chunk.header.known:
                continue
            try:
                index = parse_index(chunk.payload, ANYWHERE, chunk.payload_offset)
            except FormatError:
                continue
            self.listed |= dict(enumerate(index.entries, index.first_sequence))
        self.found = sorted({ref.sequence for ref in catalogue.chunks if ref.sequence is not None})
        self.gone = sorted(self.listed.keys() - set(self.found))
        """Sequence numbers of chunks that are listed and were not found."""

    def of(self, sequence: int) -> Times:
        """When the packets of the DATA chunk with this number are."""
        entry = self.listed.get(sequence)
        return UNKNOWN if entry is None or entry.type != "DATA" else times_of([entry])

    def missing(self, low: int, high: int) -> Times:
        """The same for the chunks between two numbers that were not found."""
        if high <= low + 1:
            return NOTHING
        count = high - low - 1
        count -= bisect_left(self.found, high) - bisect_right(self.found, low)
        gone = self.gone[bisect_right(self.gone, low) : bisect_left(self.gone, high)]
        if len(gone) < count:
            return UNKNOWN
        return times_of([entry for n in gone if (entry := self.listed[n]).type == "DATA"])


def times_of(entries: list[IndexEntry]) -> Times:
    if not entries:
        return NOTHING
    stop = max(entry.stop_ms for entry in entries)
    return Times(min(entry.start_ms for entry in entries), stop if stop < MS_LIMIT else None)
