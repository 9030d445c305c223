"""What our own layouts of HDF5 and MAT share: channels that are stored one by one."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockMap, ClockObservation
from ..errors import LimitError, ParameterError, matching, unknown
from ..recording import CHANNEL_LIMIT, Calibration, Channel, Deviation, Event, Recording, extent
from .common import filled_rates
from .formats import ReadOptions
from .layouts import BLOCK_SIZE
from .tables import Import, ImportBlock, ImportColumn, ImportTable

CHUNK_ROWS = 1 << 14
DESCRIBED = ("quantity", "axis", "group", "body_site", "device")
CARRIED = (
    "calibration", "label", "unit", "lsb", "deviation", *DESCRIBED, "epoch_ns",
    "epoch_uncertainty_ns", "attachments", "events", "clocks", "clock_maps",
)  # fmt: skip
Spans = tuple[tuple[int, int], ...]


class Stored(NamedTuple):
    """A channel of a file. ``read(0, first, last)`` gives its rows."""

    table_name: str
    rows: int
    read: Callable[[int, int, int], NDArray[Any]]
    place: int
    column: ImportColumn
    rate: Fraction
    start_tick: int
    spans: Spans | None
    """First row and end of each measured part; None: all rows."""

    @property
    def table(self) -> tuple[Any, ...]:
        """What channels of one table share."""
        return self.table_name, self.rate, self.start_tick, self.rows, self.spans


def import_of_stored(
    found: Sequence[Stored], options: ReadOptions
) -> tuple[Import, dict[int, int]]:
    """The tables of the channels that are selected, and their places in the file -> here."""
    if len(found) > CHANNEL_LIMIT:
        raise LimitError(f"{len(found)} channels, more than {CHANNEL_LIMIT}")
    ordered = sorted(found, key=lambda one: one.place)
    if [one.place for one in ordered] != list(range(len(ordered))):
        raise ParameterError("the channels do not have the places 0, 1, 2 and so on")
    places = _selected(ordered, options.select)
    tables, sources = [], []
    chosen = [one for one in ordered if one.place in places]
    notes: list[str] = []
    stated = [(one.column.label, one.rate, None) for one in chosen]
    rates, _ = filled_rates(options.rate, stated, notes)
    chosen = [one._replace(rate=rate or one.rate) for one, rate in zip(chosen, rates, strict=True)]
    for _, group in groupby(chosen, key=lambda one: one.table):
        own = list(group)
        spans, ticks = own[0].spans, None
        if spans is not None:
            ticks = np.concatenate([np.arange(a, b) for a, b in spans] or [np.empty(0, np.int64)])
        tables.append(
            ImportTable(
                name=own[0].table_name,
                columns=tuple(one.column for one in own),
                rate=own[0].rate,
                row_count=own[0].rows if ticks is None else ticks.size,
                ticks=ticks,
                start_tick=own[0].start_tick,
            )
        )
        sources.append(own)

    def blocks() -> Iterator[ImportBlock]:
        for number, own in enumerate(sources):
            yield from _blocks(number, own)

    return Import(tuple(tables), blocks, notes=tuple(notes)), places


def _blocks(number: int, own: Sequence[Stored]) -> Iterator[ImportBlock]:
    rows = max(BLOCK_SIZE // max(sum(one.column.dtype.itemsize for one in own), 1), CHUNK_ROWS)
    rows -= rows % CHUNK_ROWS
    at = 0
    for first, last in ((0, own[0].rows),) if own[0].spans is None else own[0].spans:
        for start in range(first, last, rows):
            stop = min(start + rows, last)
            values = [
                one.read(0, start, stop).reshape(-1).astype(one.column.dtype, copy=False)
                for one in own
            ]
            yield ImportBlock(number, at, values)
            at += stop - start


def _selected(found: Sequence[Stored], select: Sequence[str]) -> dict[int, int]:
    if not select:
        return {one.place: one.place for one in found}
    labels = [one.column.label for one in found]
    wanted: set[int] = set()
    for pattern in select:
        places = matching(pattern, labels) or [
            place for place, label in enumerate(labels) if label == pattern
        ]
        if not places:
            raise ParameterError(unknown("channel", pattern, labels))
        wanted |= set(places)
    return {old: new for new, old in enumerate(sorted(wanted))}


def of_channels(
    whole: Import,
    places: Mapping[int, int],
    events: Sequence[Event],
    clocks: Sequence[ClockObservation],
    clock_maps: Sequence[ClockMap],
) -> Import:
    """With the events and clocks of the channels that are read."""

    def moved(items: Sequence[Any]) -> tuple[Any, ...]:
        return tuple(
            one if one.channel is None else _at(one, places[one.channel])
            for one in items
            if one.channel is None or one.channel in places
        )

    return replace(whole, events=moved(events), clocks=moved(clocks), clock_maps=moved(clock_maps))


def _at(one: Any, place: int) -> Any:
    return replace(one, channel=place)


def check_gaps(
    recording: Recording, by_rate: Mapping[Fraction, list[int]], suffix: str, max_memory: int
) -> None:
    """LimitError where the gaps take more."""
    size = 0
    for places in by_rate.values():
        channels = [recording.channels[place] for place in places]
        first, last = extent(channels)
        size += 8 * sum(last - first - channel.stored.size for channel in channels)
    if size > max_memory:
        raise LimitError(
            f"the gaps take {size} bytes as NaN in {suffix}, more than the {max_memory} allowed; "
            "allow more (max_memory=) or write a part"
        )


def times_of(rate: Fraction, first: int, last: int) -> NDArray[np.float64]:
    """Seconds of ticks, rounded."""
    ticks = np.arange(first, last, dtype=np.float64)
    return ticks * float(rate.denominator) / float(rate.numerator)


def spans_of(channel: Channel, first: int, last: int) -> Spans | None:
    """Rows that are measured, where the values themselves do not say it: NaN does."""
    x = channel.stored if channel.exact is None else channel.exact
    spans = tuple((span.start - first, span.stop - first) for span in channel.coverage)
    return None if x.dtype.kind == "f" or spans == ((0, last - first),) else spans


def exact_note(recording: Recording) -> list[str]:
    """A note on doubles whose counts are not kept."""
    gridded = [channel.label for channel in recording if channel.exact is not None]
    if not gridded:
        return []
    return [
        f"the floating-point values of {', '.join(map(repr, gridded[:8]))} are kept, not the "
        "counts behind them"
    ]


def column_of(described: Mapping[str, Any], dtype: np.dtype[Any]) -> ImportColumn:
    calibration = None
    if "calibration" in described:
        calibration = Calibration(*described["calibration"])
    deviation = described.get("deviation")
    lsb = described.get("lsb")
    return ImportColumn(
        label=str(described["label"]),
        unit=str(described["units"]),
        **{name: str(described.get(name, "")) for name in DESCRIBED},
        calibration=calibration,
        lsb=None if lsb is None else float(lsb),
        dtype=dtype,
        deviation=None if deviation is None else Deviation(*map(float, deviation)),
    )


def integer_of(about: Mapping[str, Any], name: str, low: int, high: int) -> int:
    value = about.get(name)
    if type(value) is not int or not low <= value < high:
        raise ParameterError(f"the attribute {name} is not an integer from {low} to {high - 1}")
    return value


def seconds_of(text: str) -> Fraction:
    if re.fullmatch(r"[0-9]{1,400}(/[0-9]{1,400})?", text) is None:
        raise ParameterError(f"{text[:40]!r} is not the time of an event")
    return Fraction(text)


def reference_of(channel: int, count: int) -> int | None:
    if not -1 <= channel < count:
        raise ParameterError(f"an event or a clock names channel {channel} of {count}")
    return None if channel == -1 else channel


def checked_spans(found: NDArray[Any], rows: int, path: str) -> None:
    """ParameterError where [spans, 2] are not in order within the rows."""
    if found.size:
        edges = found.reshape(-1)
        inner = edges[1:-1].reshape(-1, 2)
        if (
            int(edges[0]) < 0
            or int(edges[-1]) > rows
            or (found[:, 0] >= found[:, 1]).any()
            or (inner[:, 0] >= inner[:, 1]).any()
        ):
            raise ParameterError(f"{path} holds spans that overlap, or leave the {rows} rows")
