"""The overview of a file that is being written: what a reader decodes, by bins.

The file is decoded part by part before it is closed. The memory is that of some clusters and of the
bins. docs/spec/overview.md has the layout.
"""

from __future__ import annotations

import shutil
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from tempfile import TemporaryFile
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import DataWarning
from ..format.extras import OVERVIEW, OVERVIEW_NAMES, Attachment
from ..format.layout import OVERVIEW_CHANNEL, OVERVIEW_END, OVERVIEW_PART
from ..reading.overview import (
    BLOCK,
    EMPTY,
    FACTOR,
    LARGEST_BASE,
    MAGIC,
    Codes,
    OverviewChannel,
    build_part,
    layout_of,
    values_of,
)
from ..reading.reader import Reader
from ..recording import Channel
from .filewriter import FileWriter

SMALLEST_BASE = 64
"""Ticks of the smallest bins: a viewer decodes the packets where it shows fewer."""
SHARE = 25
"""The overview takes at most a 25th of the file, but a small file may have its coarsest bins."""
SMALL = 1 << 14
BIN_SIZE = 2
"""Bytes that a bin takes at least, to begin with."""
AT_ONCE = 1 << 22
"""Samples that are decoded at once, or those of one cluster."""


@dataclass
class Bins:
    """Lowest and highest values of a channel in bins of ``base`` ticks."""

    channel: int
    base: int
    first_tick: int = 0
    stop_tick: int = 0
    runs: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]] = field(default_factory=list)
    """The first bin, and the values of it and of those that follow."""

    def add(self, part: Channel) -> None:
        """Samples that come after those before."""
        values = part.samples()
        if not np.isfinite(values).all():
            values = np.where(np.isfinite(values), values, np.nan)
        at = 0
        for start, stop in part.coverage:
            if not self.stop_tick:
                self.first_tick = start
            self.stop_tick = max(self.stop_tick, stop)
            first = start // self.base
            edges = np.arange(first, (stop - 1) // self.base + 1) * self.base - start
            edges[0] = 0
            run = values[at : at + stop - start]
            self.runs.append((first, np.fmin.reduceat(run, edges), np.fmax.reduceat(run, edges)))
            at += stop - start

    def joined(self) -> tuple[OverviewChannel, Codes, Codes]:
        """The row of the channel; lowest and highest codes, [bins] each."""
        row = OverviewChannel(
            self.channel, self.first_tick, self.stop_tick - self.first_tick, 0.0, 0.0
        )
        first, count = row.bins(self.base)
        low, high = np.full(count, np.nan), np.full(count, np.nan)
        for at, lowest, highest in self.runs:
            place = slice(at - first, at - first + len(lowest))
            low[place] = np.fmin(low[place], lowest)
            high[place] = np.fmax(high[place], highest)
        known = ~np.isnan(low)
        if known.any():
            ends = float(low[known].min()), float(high[known].max())
            row = OverviewChannel(self.channel, row.first_tick, row.tick_count, *ends)
        values = values_of(row.low, row.high)[1:]
        down = np.searchsorted(values, low, side="right") + EMPTY
        up = np.searchsorted(values, high, side="left") + EMPTY + 1
        down = np.minimum(down, up)  # codes of one value, which have a bin of its own
        codes = [np.where(known, each, EMPTY).astype(np.int16) for each in (down, up)]
        return row, codes[0], codes[1]


def coarser(low: Codes, high: Codes, first: int, factor: int) -> tuple[Codes, Codes]:
    """Codes of bins that hold ``factor`` of these, of which the first has the number ``first``."""
    before = first % factor
    after = -(before + len(low)) % factor
    empty = low == EMPTY
    ends = np.where(empty, -EMPTY - 1, low), np.where(empty, EMPTY, high)
    down, up = (
        np.pad(x, (before, after), constant_values=value).reshape(-1, factor)
        for x, value in zip(ends, (-EMPTY - 1, EMPTY), strict=True)
    )
    lowest, highest = down.min(axis=1), up.max(axis=1)
    return np.where(highest == EMPTY, np.int16(EMPTY), lowest), highest


def windows(reader: Reader) -> Iterator[tuple[Fraction, Fraction | None]]:
    """Seconds from, to, of some clusters each; together they hold all samples."""
    rate = sum((ref.track.rate for ref in reader.channels), Fraction(0))
    least = Fraction(AT_ONCE) / rate if rate else None
    starts = sorted(Fraction(ref.start_ns or 0, 10**9) for ref in reader.catalogue.data)
    begin = Fraction(0)
    for later in starts:
        if least is not None and later - begin >= least:
            yield begin, later
            begin = later
    yield begin, None


def first_base(reader: Reader, room: int) -> int:
    """The smallest base whose bins may have room."""
    times = [(ref.start_ns or 0, ref.stop_ns or 0) for ref in reader.catalogue.data]
    span = max((stop for _, stop in times), default=0) - min((t for t, _ in times), default=0)
    ticks = sum(int(ref.track.rate * span / 10**9) for ref in reader.channels)
    base = SMALLEST_BASE
    while base <= LARGEST_BASE and ticks // base * BIN_SIZE > room:
        base *= 2
    return base


@contextmanager
def readable(stream: BinaryIO) -> Iterator[BinaryIO]:
    """The stream, or a temporary file whose bytes go to the stream at the end."""
    own = False
    with suppress(OSError, AttributeError):
        own = stream.readable() and stream.seekable() and not stream.tell()
    if own:
        yield stream
        return
    with TemporaryFile() as file:
        yield file
        file.seek(0)
        shutil.copyfileobj(file, stream)


def attach_overview(stream: BinaryIO, writer: FileWriter, threads: int | None = None) -> int:
    """Write the overview of what ``writer`` has written to ``stream``, which can be read. Returns
    its bytes in the file.

    Nothing is written where it would be too large, even with the largest bins.
    """
    made = overview(stream, writer, threads)
    before = writer.offset
    if made is not None:
        writer.attach(made)
    else:
        text = "no overview: it would take too much of the file; a viewer reads all samples"
        warnings.warn(text, DataWarning, stacklevel=4)
    return writer.offset - before


def overview(stream: BinaryIO, writer: FileWriter, threads: int | None = None) -> Attachment | None:
    stream.flush()
    end = stream.tell()
    room = min(max(writer.offset // SHARE, SMALL), writer.level.payload_size)
    room -= len(OVERVIEW_NAMES)
    with Reader(stream, scan=True, threads=threads) as reader:
        base = first_base(reader, room)
        if base > LARGEST_BASE:
            stream.seek(end)
            return None
        bins = [Bins(ref.number, base) for ref in reader.channels]
        for start, stop in windows(reader):
            assembly = reader.assembly(reader.channels, start, stop)
            for each, ref in zip(bins, reader.channels, strict=True):
                each.add(assembly.channel(ref))
    stream.seek(end)
    found = [each.joined() for each in bins]
    while base <= LARGEST_BASE:
        content = content_of(found, base, writer)
        if len(content) <= room:
            return Attachment(*OVERVIEW, content)
        firsts = [row.bins(base)[0] for row, _, _ in found]
        base *= 2
        found = [
            (row, *coarser(low, high, first, 2))
            for (row, low, high), first in zip(found, firsts, strict=True)
        ]
    return None


def content_of(
    found: list[tuple[OverviewChannel, Codes, Codes]], base: int, writer: FileWriter
) -> bytes:
    """The content of the attachment."""
    rows = tuple(row for row, _, _ in found)
    levels: dict[tuple[int, int], tuple[Codes, Codes]] = {}
    for place, (row, *codes) in enumerate(found):
        levels[place, 0] = codes[0], codes[1]
        for level in range(1, row.level_count(base)):
            first, _ = row.bins(base * FACTOR ** (level - 1))
            levels[place, level] = coarser(*levels[place, level - 1], first, FACTOR)
    parts = []
    for place, level, block, bins in layout_of(rows, base):
        low, high = (x[block * BLOCK : block * BLOCK + bins] for x in levels[place, level])
        parts.append(build_part(low, high))
    table = b"".join(
        OVERVIEW_CHANNEL.pack(
            channel=row.channel,
            first_tick=row.first_tick,
            tick_count=row.tick_count,
            low=row.low,
            high=row.high,
        )
        for row in rows
    )
    table += b"".join(OVERVIEW_PART.pack(size=len(part), crc=zlib.crc32(part)) for part in parts)
    end = OVERVIEW_END.build(
        file_id=writer.file_id,
        covered=writer.offset,
        base=base,
        channel_count=len(rows),
        part_count=len(parts),
        table_crc=zlib.crc32(table),
        magic=MAGIC,
        end_crc=0,
    )[: -OVERVIEW_END.fields[-1].size]
    return b"".join(parts) + table + end + zlib.crc32(end).to_bytes(4, "little")
