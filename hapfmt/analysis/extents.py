"""The first and the last tick of each rate of a file, by reading few of its tables.

An index knows the times of clusters to the millisecond (SPEC 6.5). The tables of the first and the
last clusters tell the ticks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction

from ..errors import FormatError
from ..format.cluster import HEAD_ROOM, TableRow, parse_table, parse_table_head
from ..format.walk import header_at
from ..format.wire import HEADER_SIZE
from ..reading.catalogue import Catalogue, ChannelRef, ChunkRef
from ..reading.packets import ROW_SIZE, tick_after

CHUNK_TICKS = 1 << 20
"""Ticks of a chunk for Dask, 8 MiB: as many whole clusters as have this many."""


def rows_of(catalogue: Catalogue, ref: ChunkRef) -> Sequence[TableRow]:
    """The rows of the table of one cluster, whose checksum is compared."""
    if ref.offset in catalogue.tables:
        return catalogue.tables[ref.offset][1]
    source, level, tracks = catalogue.source, catalogue.level, catalogue.tracks
    header = header_at(source, ref.offset, catalogue.file_id)
    if ref.limit is not None:
        header = ref.checked(header)
    if header is None:
        raise FormatError("no chunk where one should be", requirement="REC-003", offset=ref.offset)
    at, payload_size = ref.offset + HEADER_SIZE, header.payload_size
    size = min(HEAD_ROOM + ROW_SIZE * len(tracks), payload_size)
    part = source.read_at(at, size)
    table_size = parse_table_head(part, level, at).table_size
    if table_size > size:
        part += source.read_at(at + size, min(table_size, payload_size) - size)
    return parse_table(part, payload_size, tracks, level, at, header.cluster_seed, None)[1]


def extents_of(
    catalogue: Catalogue, channels: Iterable[ChannelRef]
) -> dict[Fraction, tuple[int, int]]:
    """{rate: (first tick, tick after the last)} of the samples of these channels."""
    rate_of: dict[int, Fraction] = {}
    for channel in channels:
        for part in channel.parts:
            rate_of[part.track.id] = part.track.rate
    refs = catalogue.data
    first: dict[Fraction, int] = {}
    last: dict[Fraction, int] = {}
    rates = set(rate_of.values())
    for ref in refs:
        if all(rate in first and _begins(ref, rate) >= first[rate] for rate in rates):
            break
        for row in rows_of(catalogue, ref):
            if (rate := rate_of.get(row.track)) is not None:
                first[rate] = min(first.get(rate, row.start), row.start)
    for place, ref in enumerate(reversed(refs)):
        if all(rate in last and _ends(ref, rate) <= last[rate] for rate in rates):
            break
        if place and not first.keys() & rates:
            break  # No table has anything of these channels.
        for row in rows_of(catalogue, ref):
            if (rate := rate_of.get(row.track)) is not None:
                last[rate] = max(last.get(rate, row.stop), row.stop)
    return {rate: (first.get(rate, 0), last.get(rate, 0)) for rate in rates}


def _begins(ref: ChunkRef, rate: Fraction) -> int:
    """No packet of a cluster begins before this tick."""
    return 0 if ref.start_ns is None else tick_after(ref.start_ns, rate)


def _ends(ref: ChunkRef, rate: Fraction) -> int:
    """No packet of a cluster ends after this tick."""
    if ref.stop_ns is None:
        return 1 << 62
    return ref.stop_ns * rate.numerator // (rate.denominator * 10**9)


def chunks_of(catalogue: Catalogue, rate: Fraction, first: int, last: int) -> tuple[int, ...]:
    """Sizes of chunks for Dask, which begin where clusters do, as nearly as the index tells."""
    sizes = []
    start = before = first
    for ref in catalogue.data:
        if ref.start_ns is None:
            continue
        at = tick_after(ref.start_ns, rate)
        if at >= last:
            break
        if at - start > CHUNK_TICKS and before > start:
            sizes.append(before - start)
            start = before
        before = max(at, before)
    if last - start > CHUNK_TICKS and before > start:
        sizes.append(before - start)
        start = before
    return (*sizes, last - start) if last > start else tuple(sizes) or (0,)
