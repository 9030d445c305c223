"""The overview of a file: lowest and highest values of its channels, by bins.

It is an attachment in parts, of which those are read that are asked for. docs/spec/overview.md has
the layout.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..format.deflate import inflate
from ..format.extras import OVERVIEW_NAMES
from ..format.layout import OVERVIEW_CHANNEL, OVERVIEW_END, OVERVIEW_PART
from ..format.source import ByteSource
from ..format.walk import header_at
from ..format.wire import HEADER_SIZE
from .catalogue import Catalogue

MAGIC = b"hOVW"
FACTOR = 8
"""Bins of a level in one of the next."""
COARSEST = 1024
"""Most bins of the coarsest level."""
BLOCK = 4096
"""Bins of a part."""
LARGEST_BASE = 1 << 24
TICK_LIMIT = 1 << 48
EMPTY = -32768
"""Both codes of a bin without a finite value."""

Codes = NDArray[np.int16]


@dataclass(frozen=True)
class OverviewChannel:
    """One channel: its number, its ticks, and the range of its values."""

    channel: int
    first_tick: int
    tick_count: int
    low: float
    high: float

    def bins(self, size: int) -> tuple[int, int]:
        """The number of the first bin of ``size`` ticks, and how many bins hold the channel."""
        if not self.tick_count:
            return 0, 0
        first = self.first_tick // size
        return first, (self.first_tick + self.tick_count - 1) // size - first + 1

    def level_count(self, base: int) -> int:
        count = 1 if self.tick_count else 0
        while count and self.bins(base * FACTOR ** (count - 1))[1] > COARSEST:
            count += 1
        return count

    def part_count(self, base: int) -> int:
        sizes = (base * FACTOR**level for level in range(self.level_count(base)))
        return sum(-(-self.bins(size)[1] // BLOCK) for size in sizes)


class OverviewPart(NamedTuple):
    """A block of a level of a channel, and its place in the content of the attachment."""

    row: int
    level: int
    block: int
    offset: int
    size: int
    crc: int


class Extremes(NamedTuple):
    """Bins of ``bin_ticks`` ticks each; bin i begins at tick ``(first_bin + i) * bin_ticks``."""

    bin_ticks: int
    first_bin: int
    low: NDArray[np.float64]
    """[bins]: at most the lowest finite value, in the channel's unit; NaN where there is none."""
    high: NDArray[np.float64]
    """[bins]: at least the highest finite value."""


def layout_of(rows: tuple[OverviewChannel, ...], base: int) -> Iterator[tuple[int, int, int, int]]:
    """Row, level, block and bins of each part, in the order of the content."""
    found = []
    for place, row in enumerate(rows):
        levels = row.level_count(base)
        for level in range(levels):
            count = row.bins(base * FACTOR**level)[1]
            for block in range(-(-count // BLOCK)):
                bins = min(BLOCK, count - block * BLOCK)
                found.append((level - levels, block, place, level, bins))
    for _, block, place, level, bins in sorted(found):
        yield place, level, block, bins


def values_of(low: float, high: float) -> NDArray[np.float64]:
    """[65536]: the values of the codes from -32768 on; they never fall. The first is NaN."""
    codes = np.arange(EMPTY, -EMPTY, dtype=np.float64)
    middle, step = low / 2 + high / 2, (high / 2 - low / 2) / 32767
    with np.errstate(over="ignore"):
        values = np.clip(middle + codes * step, low, high)
    values[0], values[1], values[-1] = np.nan, low, high
    return values


def build_part(low: Codes, high: Codes) -> bytes:
    """The part of these codes, [bins] each."""
    a = np.diff(low.view(np.uint16), prepend=np.uint16(0))
    b = high.view(np.uint16) - low.view(np.uint16)
    raw = b"".join(x.astype("<u2").view(np.uint8).reshape(-1, 2).T.tobytes() for x in (a, b))
    packer = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
    return packer.compress(raw) + packer.flush()


def parse_part(data: bytes, bins: int, offset: int) -> tuple[Codes, Codes]:
    """Lowest and highest codes, [bins] each, of the part at ``offset``."""
    raw = np.frombuffer(inflate(data, 4 * bins, "OVW-003", offset), np.uint8).astype(np.uint16)
    planes = raw.reshape(4, bins)
    a, b = planes[0] + (planes[1] << 8), planes[2] + (planes[3] << 8)
    lowest = np.cumsum(a, dtype=np.uint16)
    low, high = lowest.view(np.int16), (lowest + b).view(np.int16)
    if np.any(low > high) or np.any((low == EMPTY) != (high == EMPTY)):
        raise FormatError(
            "a bin of the overview ends below its begin", requirement="OVW-003", offset=offset
        )
    return low, high


class Overview:
    """The overview of a file. ``channels``: one row for each channel; ``covered``: the offset in
    the file before which it describes all packets; ``base``: ticks of the smallest bins."""

    def __init__(self, source: ByteSource, start: int, stop: int, file_id: int) -> None:
        """From the content at the offsets ``start`` to ``stop``; FormatError where a rule is
        broken, or it is that of another file."""
        self.source, self.start = source, start
        at = max(stop - OVERVIEW_END.size, start)
        raw = source.read_at(at, stop - at)
        end = OVERVIEW_END.parse(raw, 0, "OVW-001", at)
        if end.magic != MAGIC or end.end_crc != zlib.crc32(raw[: -OVERVIEW_END.fields[-1].size]):
            raise FormatError("no end of an overview", requirement="OVW-007", offset=at)
        if end.file_id != file_id or end.covered > start:
            raise FormatError("the overview of another file", requirement="OVW-002", offset=at)
        self.covered, self.base = int(end.covered), int(end.base)
        if not 1 <= self.base <= LARGEST_BASE or self.base & (self.base - 1):
            raise FormatError("the overview has no base", requirement="OVW-001", offset=at)
        size = OVERVIEW_CHANNEL.size * end.channel_count + OVERVIEW_PART.size * end.part_count
        if size > at - start:
            raise FormatError(
                "the table of the overview is cut short", requirement="OVW-003", offset=at
            )
        table = source.read_at(at - size, size)
        if zlib.crc32(table) != end.table_crc:
            raise FormatError(
                "checksum error in the table of the overview", requirement="OVW-007", offset=at
            )
        self.channels = tuple(read_rows(table, end.channel_count, at - size))
        self.parts = self.read_parts(table[OVERVIEW_CHANNEL.size * end.channel_count :], at - size)

    def read_parts(self, table: bytes, stop: int) -> dict[tuple[int, int, int], OverviewPart]:
        """By row, level and block; ``stop``: the offset of the table."""
        expected = 0
        for row in self.channels:
            expected += row.part_count(self.base)
            if expected > len(table) // OVERVIEW_PART.size:
                break
        if expected * OVERVIEW_PART.size != len(table):
            raise FormatError(
                "another number of parts than the channels have",
                requirement="OVW-003",
                offset=stop,
            )
        parts, at = {}, self.start
        for number, (place, level, block, _) in enumerate(layout_of(self.channels, self.base)):
            size, crc = OVERVIEW_PART.read(table, number * OVERVIEW_PART.size)
            if not size:
                raise FormatError("an empty part", requirement="OVW-003", offset=stop)
            parts[place, level, block] = OverviewPart(place, level, block, at, size, crc)
            at += size
        if at != stop:
            raise FormatError(
                "the parts of the overview do not end at its table",
                requirement="OVW-003",
                offset=stop,
            )
        return parts

    def levels(self, channel: int) -> int:
        """Levels of a channel number; 0: it has no samples. KeyError for another channel."""
        return self.channels[self.row(channel)].level_count(self.base)

    def row(self, channel: int) -> int:
        for place, row in enumerate(self.channels):
            if row.channel == channel:
                return place
        raise KeyError(channel)

    def envelope(
        self, channel: int, level: int, first_block: int = 0, stop_block: int | None = None
    ) -> Extremes:
        """Some blocks of a level of a channel number, by default all.

        Raises FormatError where a part breaks a rule, KeyError for a channel or a level that is not
        there.
        """
        place = self.row(channel)
        row = self.channels[place]
        if not 0 <= level < row.level_count(self.base):
            raise KeyError(level)
        size = self.base * FACTOR**level
        first, count = row.bins(size)
        values = values_of(row.low, row.high)
        found: list[tuple[Codes, Codes]] = []
        for block in range(-(-count // BLOCK))[first_block:stop_block]:
            part = self.parts[place, level, block]
            data = self.source.read_at(part.offset, part.size)
            if len(data) != part.size or zlib.crc32(data) != part.crc:
                raise FormatError(
                    "checksum error in a part of the overview",
                    requirement="OVW-007",
                    offset=part.offset,
                )
            found.append(parse_part(data, min(BLOCK, count - block * BLOCK), part.offset))
        low, high = (
            values[np.concatenate(x).astype(np.int32) - EMPTY] if found else np.empty(0)
            for x in ([low for low, _ in found], [high for _, high in found])
        )
        return Extremes(size, first + first_block * BLOCK, low, high)


def read_rows(table: bytes, count: int, offset: int) -> Iterator[OverviewChannel]:
    """The rows of the channels in the table at ``offset``."""
    last = -1
    for place in range(count):
        at = place * OVERVIEW_CHANNEL.size
        row = OverviewChannel(*OVERVIEW_CHANNEL.read(table, at))
        ordered = isfinite(row.low) and isfinite(row.high) and row.low <= row.high
        if row.channel <= last or row.first_tick + row.tick_count > TICK_LIMIT or not ordered:
            raise FormatError(
                "a channel of the overview out of its bounds",
                requirement="OVW-003",
                offset=offset + at,
            )
        last = row.channel
        yield row


def overview_of(catalogue: Catalogue) -> Overview | None:
    """The overview of the file, that of the most chunks if it has several; None without one.

    One that breaks a rule counts as none (OVW-007).
    """
    best: Overview | None = None
    numbers = {ref.number for ref in catalogue.channels}
    for start, stop in places_of(catalogue):
        try:
            found = Overview(catalogue.source, start, stop, catalogue.file_id or 0)
        except FormatError:
            continue
        known = all(row.channel in numbers for row in found.channels)
        if known and (best is None or found.covered > best.covered):
            best = found
    return best


def places_of(catalogue: Catalogue) -> Iterator[tuple[int, int]]:
    """The contents of the attachments that are overviews by name and media type: from, to."""
    source = catalogue.source
    for ref in catalogue.chunks:
        header = header_at(source, ref.offset, catalogue.file_id) if ref.type == "aTTc" else None
        if header is None or header.type != "aTTc":
            continue
        begin = ref.offset + HEADER_SIZE
        stop = begin + header.payload_size
        start = begin + len(OVERVIEW_NAMES)
        if start <= stop <= source.size and source.read_at(begin, start - begin) == OVERVIEW_NAMES:
            yield start, stop
