"""The chain of indexes (SPEC 6.5), and what else a writer that goes on must know of a file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from ..errors import FormatError
from ..limits import Limits
from ..format.index import Index, IndexEntry, check_listing, entry_count, parse_index
from ..format.source import Source
from ..format.walk import header_at, read_chunk

if TYPE_CHECKING:
    from ..reading.catalogue import Catalogue


def index_chain(
    source: Source, offset: int, file_id: int | None, limits: Limits | None = None
) -> list[tuple[int, Index]]:
    """Offsets and indexes, oldest first, of the chain that ends at ``offset``."""
    limits, listed = limits or Limits(), 0
    parts: list[tuple[int, Index]] = []
    position = position_after = offset
    while True:
        chunk = read_chunk(source, position, file_id)
        if chunk is None or not chunk.intact or chunk.header.type != "iNDX":
            raise FormatError(
                "no index where one should be", requirement="IDX-002", offset=position
            )
        if parts and chunk.stop > position_after:
            raise FormatError("indexes overlap", requirement="IDX-002", offset=position)
        listed += entry_count(chunk.payload)
        limits.check_records(listed)
        index = parse_index(chunk.payload, position, chunk.payload_offset)
        parts.append((position, index))
        if not index.previous:
            return parts[::-1]
        position, position_after = index.previous, position


def chain_of(catalogue: Catalogue, entries: Sequence[IndexEntry]) -> list[tuple[int, Index]]:
    """The chain that a file ends with; empty where there is none, or it does not list
    ``entries``."""
    source, file_id = catalogue.source, catalogue.file_id
    if catalogue.indexed and catalogue.foot:
        return index_chain(source, catalogue.foot.index_offset, file_id)
    parts: list[tuple[int, Index]] = []
    offsets = [ref.offset for ref in catalogue.chunks if ref.type == "iNDX" and ref.known]
    with suppress(FormatError):
        for offset, index in index_chain(source, offsets[-1], file_id) if offsets else ():
            check_listing(index, offset, entries, offset)
            parts.append((offset, index))
        return parts
    return []


def copied_tracks(source: Source, entries: Sequence[IndexEntry]) -> set[int]:
    """The track ids that HEAD and TRAK chunks carry twice."""
    places = [entry.offset for entry in entries if entry.type in ("HEAD", "TRAK")]
    headers = [header_at(source, offset, None) for offset in places]
    counts = Counter(header.track for header in headers if header is not None)
    return {track for track, count in counts.items() if count > 1}
