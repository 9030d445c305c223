"""A file of another program, described before its values are read.

A table is what shares its times: a topic of messages, an HDF5 group, a stream. Its columns become
channels. :class:`Import` lists the tables, and yields their values in blocks of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockMap, ClockObservation
from ..errors import LimitError, ParameterError
from ..recording import (
    Calibration,
    Channel,
    Deviation,
    Event,
    Recording,
    Span,
    known_samples,
    spans_at,
    unique,
)
from ..spool import MEMORY, Memory, release
from .common import CHANNEL_LIMIT, with_notes

ROWS = 1 << 16
"""Rows of a block that is made of a recording."""


@dataclass(frozen=True)
class ImportColumn:
    """One channel of a table.

    ``unit`` is a UCUM code, ``source_unit`` the text of the file where it differs. ``dtype`` is
    that of the values in the blocks: with a ``calibration`` they are integer counts.
    """

    label: str
    unit: str = "1"
    quantity: str = ""
    axis: str = ""
    group: str = ""
    body_site: str = ""
    device: str = ""
    calibration: Calibration | None = None
    lsb: float | None = None
    dtype: np.dtype[Any] = field(default_factory=lambda: np.dtype(np.float64))
    source_unit: str = ""
    deviation: Deviation | None = None


@dataclass(frozen=True)
class ImportTable:
    """Rows with common times.

    Row i is at tick ``start_tick + ticks[i]``, or ``start_tick + i`` where ``ticks`` is None.
    ``name`` is that in the file. ``kind`` says what it is there, such as a message type.
    """

    name: str
    columns: tuple[ImportColumn, ...]
    rate: Fraction
    row_count: int
    ticks: NDArray[np.int64] | None = None
    start_tick: int = 0
    kind: str = ""
    notes: tuple[str, ...] = ()

    @property
    def spans(self) -> tuple[Span, ...]:
        if not self.row_count:
            return ()
        if self.ticks is None:
            return (Span(self.start_tick, self.start_tick + self.row_count),)
        return spans_at(self.ticks + self.start_tick)

    def all_ticks(self, first_row: int, stop_row: int) -> NDArray[np.int64]:
        """Ticks of the rows first_row <= row < stop_row."""
        if self.ticks is None:
            return np.arange(self.start_tick + first_row, self.start_tick + stop_row)
        return self.ticks[first_row:stop_row] + self.start_tick

    @property
    def row_size(self) -> int:
        """Bytes of a row in a recording."""
        return sum(column.dtype.itemsize for column in self.columns)


class ImportBlock(NamedTuple):
    """Rows of one table: ``values`` has a [rows] array for each column.

    The blocks of a table come in the order of its rows and leave none out.
    """

    table: int
    first_row: int
    values: Sequence[NDArray[Any]]


@dataclass(frozen=True)
class Import:
    """The contents of a file. ``blocks`` starts a pass over the values; NaN is a gap.

    ``notes`` name losses, in plain sentences. The other members are those of a Recording.
    """

    tables: tuple[ImportTable, ...]
    blocks: Callable[[], Iterator[ImportBlock]]
    epoch_ns: int | None = None
    epoch_uncertainty_ns: int = 0
    metadata: Mapping[str, Any] = field(default_factory=dict)
    attachments: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    notes: tuple[str, ...] = ()
    clocks: tuple[ClockObservation, ...] = ()
    clock_maps: tuple[ClockMap, ...] = ()

    @property
    def size(self) -> int:
        """Bytes that all values take."""
        return sum(table.row_count * table.row_size for table in self.tables)

    @property
    def duration(self) -> Fraction:
        """Seconds from the zero to the end of the last row."""
        ends = [(t.spans[-1].stop / t.rate) for t in self.tables if t.row_count]
        return max(ends, default=Fraction(0))

    @property
    def labels(self) -> list[str]:
        """Labels of all channels, made unique."""
        return unique([c.label for table in self.tables for c in table.columns], [])

    @property
    def all_notes(self) -> list[str]:
        found = [*self.notes, *(note for table in self.tables for note in table.notes)]
        return list(dict.fromkeys(found))

    def empty_channels(self) -> list[Channel]:
        """The channels without their samples."""
        columns = [(table, column) for table in self.tables for column in table.columns]
        if len(columns) > CHANNEL_LIMIT:
            raise LimitError(f"{len(columns)} channels, more than {CHANNEL_LIMIT}")
        return [
            Channel(
                np.empty(0, column.dtype), table.rate, calibration=column.calibration, label=label,
                unit=column.unit, quantity=column.quantity, axis=column.axis, group=column.group,
                body_site=column.body_site, device=column.device, lsb=column.lsb,
                deviation=column.deviation,
            )
            for (table, column), label in zip(columns, self.labels, strict=True)
        ]  # fmt: skip

    def described(self) -> Recording:
        """The recording without its samples."""
        units = {
            label: column.source_unit
            for label, column in zip(
                self.labels, (c for table in self.tables for c in table.columns), strict=True
            )
            if column.source_unit and column.source_unit != column.unit
        }
        metadata = {**self.metadata, **({"source_units": units} if units else {})}
        return Recording(
            tuple(self.empty_channels()),
            epoch_ns=self.epoch_ns,
            epoch_uncertainty_ns=self.epoch_uncertainty_ns,
            metadata=with_notes(metadata, self.all_notes),
            attachments=dict(self.attachments),
            events=self.events,
            clocks=self.clocks,
            clock_maps=self.clock_maps,
        )

    def recording(
        self,
        max_memory: int,
        progress: Callable[[int, int], None] | None = None,
        store: Memory = MEMORY,
    ) -> Recording:
        """All of it. Raises LimitError, before any value is read, where the values take
        more than ``max_memory`` bytes."""
        if self.size > max_memory:
            raise LimitError(
                f"the values take {self.size} bytes, more than the {max_memory} allowed; allow "
                "more (max_memory=) or select a part (select=)"
            )
        empty = self.described()
        arrays = [
            [store.empty(table.row_count, column.dtype) for column in table.columns]
            for table in self.tables
        ]
        filled, total = [0] * len(self.tables), sum(table.row_count for table in self.tables)
        for block in self.blocks():
            rows = len(block.values[0]) if block.values else 0
            if block.first_row != filled[block.table]:
                raise ParameterError("the rows of the file changed while it was read")
            for array, values in zip(arrays[block.table], block.values, strict=True):
                array[block.first_row : block.first_row + rows] = values
            filled[block.table] += rows
            release()
            if progress:
                progress(sum(filled), total)
        if filled != [table.row_count for table in self.tables]:
            raise ParameterError("the file ended before all of its rows were read")
        channels = iter(empty.channels)
        return replace(
            empty,
            channels=tuple(
                filled_channel(next(channels), array, table, store)
                for table, own in zip(self.tables, arrays, strict=True)
                for array in own
            ),
        )


def filled_channel(
    empty: Channel, values: NDArray[Any], table: ImportTable, store: Memory
) -> Channel:
    """The channel with its samples; a NaN is a gap."""
    spans = table.spans
    if values.dtype.kind == "f":
        values, known = known_samples(values)
        if not known.all():
            spans = spans_at(table.all_ticks(0, table.row_count)[known])
            values = store.kept(values[known])
        release()
    return replace(empty, stored=values, coverage=spans)


def import_of(recording: Recording) -> Import:
    """A recording that is in memory already, one table for each channel."""
    notes = recording.metadata.get("notes", [])
    tables = tuple(
        ImportTable(
            name=channel.label,
            columns=(
                ImportColumn(
                    channel.label, channel.unit, channel.quantity, channel.axis, channel.group,
                    channel.body_site, channel.device, channel.calibration, channel.lsb,
                    channel.stored.dtype, deviation=channel.deviation,
                ),
            ),
            rate=channel.rate_exact,
            row_count=channel.stored.size,
            ticks=np.concatenate(
                [np.arange(span.start, span.stop) for span in channel.coverage]
            )
            if len(channel.coverage) > 1
            else None,
            start_tick=channel.start_tick if len(channel.coverage) == 1 else 0,
        )
        for channel in recording.channels
    )  # fmt: skip

    def blocks() -> Iterator[ImportBlock]:
        for number, channel in enumerate(recording.channels):
            for first in range(0, channel.stored.size, ROWS):
                yield ImportBlock(number, first, [channel.stored[first : first + ROWS]])

    return Import(
        tables,
        blocks,
        recording.epoch_ns,
        recording.epoch_uncertainty_ns,
        {key: value for key, value in recording.metadata.items() if key != "notes"},
        recording.attachments,
        recording.events,
        tuple(notes if isinstance(notes, list) else [notes]),
        recording.clocks,
        recording.clock_maps,
    )
