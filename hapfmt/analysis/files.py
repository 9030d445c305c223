"""Files that are read part by part: their version, their first and last ticks, and any part.

An index knows the times of clusters to the millisecond (SPEC 11.1). The tables of the first and the
last clusters tell the ticks.
"""

from __future__ import annotations

import copy
import errno
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import Any

from ..errors import FormatError
from ..format.cluster import HEAD_ROOM, TableRow, parse_table, parse_table_head
from ..format.source import is_url
from ..format.track import unsupported_track
from ..format.walk import header_at
from ..format.wire import HEADER_SIZE
from ..reading.catalogue import Catalogue, ChannelRef, ChunkRef, TrackPair
from ..reading.decoder import Assembly, Decoded, intersect
from ..reading.opening import FAR_NS
from ..reading.packets import ROW_SIZE, tick_after
from ..reading.reader import Reader
from ..recording import Channel, Span, append_span

CHUNK_TICKS = 1 << 20
"""Ticks of a chunk for Dask, 8 MiB: as many whole clusters as have this many."""


class PartReader(Reader):
    """One that is asked for many parts, and knows the file that it opened.

    A local file is known by its inode, size and time of change.
    """

    _advice = "The command hapfmt recover writes an intact copy; hapfmt.Reader reads what is intact"

    def __init__(self, path: str) -> None:
        # Before it is opened: a change in between is then seen at the first reading.
        self.path = path
        self.stamp = stamp_of(path)
        super().__init__(path, strict=True)

    _known: tuple[Catalogue, dict[int, ChannelRef]] | None = None

    def by_number(self) -> dict[int, ChannelRef]:
        if self._known is None or self._known[0] is not self.catalogue:
            self._known = self.catalogue, {ref.number: ref for ref in self.channels}
        return self._known[1]


def open_reader(path: str, mode: str = "r") -> PartReader:  # noqa: ARG001
    """xarray gives a mode, where it opens the file again in another process too."""
    return PartReader(path)


def stamp_of(path: str) -> tuple[int, ...]:
    """Time of change, size and inode of a local file."""
    if is_url(path):
        return ()
    info = Path(path).stat()
    return info.st_mtime_ns, info.st_size, info.st_ino


def version_of(reader: PartReader) -> tuple[Any, ...]:
    """What differs where a path leads to another file, here or on another machine. The inode may
    differ there for the same file."""
    source, catalogue = reader.source, reader.catalogue
    version = getattr(source, "version", reader.stamp[:1])
    return source.size, version, catalogue.file_id, catalogue.uuid


@contextmanager
def unchanged(reader: PartReader, version: tuple[Any, ...]) -> Iterator[PartReader]:
    """Reads are in this context: of a file that changes before or meanwhile, nothing comes out."""
    refuse_change(reader, version)
    try:
        yield reader
    except OSError as error:
        if error.errno == errno.ESTALE:  # of a URL
            raise changed(reader) from error
        raise
    finally:
        # Also after an error: a file in change looks damaged.
        refuse_change(reader, version)


def refuse_change(reader: PartReader, version: tuple[Any, ...]) -> None:
    if version_of(reader) != version or stamp_of(reader.path) != reader.stamp:
        raise changed(reader)


def changed(reader: Reader) -> OSError:
    message = "the file changed after it was opened; open it again"
    return OSError(errno.ESTALE, message, reader.source.path)


def described(ref: ChannelRef) -> Channel:
    """The channel without its samples."""
    return Assembly({track.id: Decoded(track) for track in ref.tracks}, "full").channel(ref)


def check_channels(reader: Reader, refs: Sequence[ChannelRef]) -> None:
    """Raise what reading these channels would raise for their descriptions."""
    reader.refuse_unknown()
    for ref in refs:
        for track in ref.tracks:
            if track.unsupported:
                raise unsupported_track(track, reader.source.path)
    reader.lost_parts(refs, "full")


def read_ticks(reader: Reader, refs: Sequence[ChannelRef], first: int, last: int) -> list[Channel]:
    """The samples of channels of one rate at the ticks [first, last)."""
    # A copy has its own list of losses, so that threads share no state that changes.
    reader = copy.copy(reader)
    rate = refs[0].track.rate
    parts = reader.assembly(refs, first / rate, last / rate)
    reader.refuse_damage()
    return [parts.channel(ref) for ref in refs]


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
    pairs = {part.track.id: part for channel in channels for part in channel.parts}
    rate_of = {id_: pair.track.rate for id_, pair in pairs.items()}
    rate_of |= {p.residual.id: p.residual.rate for p in pairs.values() if p.residual is not None}
    rates = set(rate_of.values())
    refs = catalogue.data
    ends: dict[int, tuple[int, int]] = {}

    def add(ref: ChunkRef) -> None:
        for row in rows_of(catalogue, ref):
            if row.track in rate_of:
                first, last = ends.get(row.track, (row.start, row.stop))
                ends[row.track] = min(first, row.start), max(last, row.stop)

    def known(rate: Fraction) -> list[tuple[int, int]]:
        return [ends[id_] for id_ in pairs if id_ in ends and rate_of[id_] == rate]

    # No cluster from here on begins earlier, and none up to here ends later.
    starts = [*accumulate((ref.start_ns or 0 for ref in reversed(refs)), min)][::-1]
    stops = [*accumulate((FAR_NS if ref.stop_ns is None else ref.stop_ns for ref in refs), max)]
    for ref, start_ns in zip(refs, starts, strict=True):
        if all(any(tick_after(start_ns, r) >= first for first, _ in known(r)) for r in rates):
            break
        add(ref)
    for ref, stop_ns in zip(reversed(refs), reversed(stops), strict=True):
        if ref is not refs[-1] and all(
            any(stop_ns * r <= last * 10**9 for _, last in known(r)) for r in rates
        ):
            break
        add(ref)
    bands = [pair for pair in pairs.values() if pair.residual is not None]
    if any(p.residual and ends.get(p.track.id) != ends.get(p.residual.id) for p in bands):
        ends |= _common_ends(catalogue, bands)
    found = {rate: known(rate) for rate in rates}
    found = {rate: [one for one in own if one[0] < one[1]] for rate, own in found.items()}
    return {
        rate: (min((a for a, _ in own), default=0), max((b for _, b in own), default=0))
        for rate, own in found.items()
    }


def _common_ends(catalogue: Catalogue, pairs: Sequence[TrackPair]) -> dict[int, tuple[int, int]]:
    """The ends of what both bands cover (DEC-003), from all tables."""
    spans: dict[int, list[Span]] = {track.id: [] for pair in pairs for track in pair.tracks}
    for ref in catalogue.data:
        for row in rows_of(catalogue, ref):
            if row.track in spans:
                append_span(spans[row.track], Span(row.start, row.stop))
    found = {}
    for pair in pairs:
        lf, hf = (spans[track.id] for track in pair.tracks)
        both = [span for _, span in intersect(lf, hf)]
        found[pair.track.id] = (both[0].start, both[-1].stop) if both else (0, 0)
    return found


def chunks_of(catalogue: Catalogue, rate: Fraction, first: int, last: int) -> tuple[int, ...]:
    """Sizes of chunks for Dask. They begin where clusters do, to the millisecond of the index."""
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
