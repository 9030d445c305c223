"""A file of another program -> file, block by block (SPEC clause 15), in bounded memory.

The samples wait until every table has passed the end of a cluster. Knots, textures and relations
between channels need the whole recording, so :func:`why_whole` names what cannot be written so.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from math import inf
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..codecs.raw import DTYPES
from ..convert import refuse_foreign
from ..convert.formats import ReadOptions
from ..convert.tables import Import, ImportColumn, ImportTable
from ..encoder.encode import Decision
from ..encoder.gridded import KEPT, nearest
from ..encoder.live import (
    Block,
    ChannelEncoder,
    ExactEncoder,
    GridEncoder,
    Input,
    LiveEncoder,
    Plan,
    WordsEncoder,
    choose_exact,
    plan_input,
)
from ..encoder.plan import Range, check_error
from ..encoder.settings import Settings, Tolerance, counts_of
from ..encoder.unit import STEP_LIMIT
from ..errors import DataWarning, LimitError, ParameterError
from ..files import refuse, target
from ..format.cluster import Packet
from ..format.track import Track
from ..format.wire import check_file_id
from ..limits import LEVELS, TICK_LIMIT, Limits
from ..reading.catalogue import ChannelRef, TrackPair
from ..recording import Calibration, Recording
from ..threads import thread_count
from .clusters import Clusters, SamplePiece, SampleRows, pieces_of
from .filewriter import FileWriter
from .overview import attach_overview, readable
from .writer import Summary, clock_chunks, doubts_of, encoder_of, extras_of, layers_of

STREAMED = 512 << 20
"""Bytes of values above which a file is encoded while it is read. Below, :func:`write` encodes it
whole, which takes more memory and makes smaller files."""

WAITING = 64 << 20
"""Most bytes of samples that wait for their cluster. Above, clusters are written as they are."""

CLUSTERS = 4
"""Clusters that fit these bytes at least."""

SEEN = 24 << 20
"""Bytes of samples that are looked at before the form of floating point channels is chosen."""

LOOKED_AT = 16
"""Pieces of these samples, for each channel; the one with the most distinct values counts."""

Advance = Callable[[int, int], None]


def why_whole(settings: Settings, canonical: object = None) -> str:
    """What needs the whole recording in memory; empty where nothing does."""
    if settings.preset in ("perceptual", "paper"):
        return f"preset {settings.preset}"
    if settings.tolerance is not None:
        return "--tolerance"
    if settings.digest:
        return "--digest"
    return "--canonical content" if canonical == "content" else ""


def read_if_small(
    found: Recording | Import, options: ReadOptions, limits: Limits, whole: str
) -> Recording | Import:
    """All of a file of small size; ``whole`` names what needs all of it, if anything does."""
    if not isinstance(found, Import):
        return found
    if not whole and found.size > min(STREAMED, limits.memory or STREAMED):
        return found
    try:
        return found.recording(options.max_memory, options.progress, options.store)
    except LimitError as error:
        if not whole:
            raise
        raise LimitError(f"{whole} needs the whole recording, and {error.message}") from None


def write_import(
    found: Import,
    file: str | os.PathLike[str] | BinaryIO,
    settings: Settings | None = None,
    *,
    canonical: int | None = None,
    force: bool = False,
    overview: bool = False,
    progress: Advance | None = None,
    threads: int | None = None,
) -> Summary:
    """Encode a file of another program into a path or a stream, as :func:`write` does, while its
    blocks are read. The file appears under its name when it is complete.

    ``progress`` is called with rows: those that were read, and all. Values are read twice where
    their range has to be known first: for an error in percent of it, and for 32-bit counts.

    Raises ParameterError where the settings need the whole recording (:func:`why_whole`), the file
    exists, or the blocks do not fit their tables; OSError.
    """
    settings = settings or Settings()
    if needed := why_whole(settings, canonical):
        raise ParameterError(f"{needed} needs the whole recording in memory")
    check_file_id(canonical)
    if isinstance(file, (str, os.PathLike)):
        refuse_foreign(file)
        refuse(os.fspath(file), force)
    described = found.described()
    for note in doubts_of(described):
        warnings.warn(note, DataWarning, stacklevel=2)
    importer = Importer(found, described, settings, progress or (lambda _done, _all: None))
    importer.threads = thread_count(
        threads, sum(t.row_count * len(t.columns) for t in found.tables)
    )
    if importer.needs_ranges:
        importer.find_ranges()
    with target(file, force) as stream:
        if not overview:
            return importer.run(stream, canonical)
        importer.overview = True
        with readable(stream) as own:
            return importer.run(own, canonical)


@dataclass
class ImportedChannel:
    """One channel, and what becomes of it."""

    number: int
    label: str
    table: ImportTable
    source: ImportColumn
    settings: Settings
    known: Range | None = None
    size: int = 0
    sample_count: int = 0
    largest_error: float = 0.0
    encoder: ChannelEncoder | None = None
    bounded: bool = False
    """Whether samples may differ from those that came."""
    may_be_bounded: bool = False
    """The same, where it is not known yet."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """The dtype of its samples here: native, and integers of up to 32 bits are signed."""
        dtype = self.source.dtype
        if dtype.kind == "b" or (dtype.kind == "u" and dtype.itemsize < 4):
            return np.dtype(np.int32)
        return dtype.newbyteorder("=")

    @property
    def takes_counts(self) -> bool:
        dtype = self.source.dtype
        return dtype.kind in "biu" and (self.source.calibration is not None or dtype.itemsize < 8)

    @cached_property
    def calibration(self) -> Calibration | None:
        return (self.source.calibration or Calibration()) if self.takes_counts else None

    @property
    def needs_range(self) -> bool:
        relative = self.settings.preset == "near-lossless"
        return relative or (self.takes_counts and self.source.dtype.itemsize >= 4)

    @property
    def unit(self) -> str:
        return self.source.unit

    @property
    def step(self) -> float | None:
        """One count in the unit of the channel; None where it is not known."""
        if self.calibration is None:
            return self.source.lsb
        return abs(float(self.calibration.step))

    @property
    def extent(self) -> float:
        """The range in the unit of the channel, 0 where it is not known."""
        counts_or_values = self.known.extent if self.known else 0
        return float(counts_or_values * (self.step if self.calibration and self.step else 1))

    def input(self, **given: Any) -> Input:
        one = self.source
        with warnings.catch_warnings():  # :func:`write_import` has warned of unknown units
            warnings.simplefilter("ignore", DataWarning)
            return Input(
                self.label, self.table.rate, one.unit, one.quantity, one.axis, one.group,
                one.body_site, one.device, calibration=self.calibration, **given,
            )  # fmt: skip

    @cached_property
    def plain(self) -> Input:
        return self.input()

    def counts_plan(self) -> Plan:
        low, high = count_range(self.source.dtype, self.known)
        bits = max((-low - 1).bit_length(), high.bit_length()) + 1
        if bits > 32:
            raise ParameterError(f"counts of {self.label!r} from {low} to {high} need over 32 bits")
        return plan_input(self.input(bits=max(bits, 2)), self.counts_settings())

    def counts_settings(self) -> Settings:
        """The settings; those of near-lossless with an amount in counts, which needs no samples."""
        if self.settings.preset != "near-lossless" or self.known is None:
            return self.settings
        assert self.calibration is not None
        extent = int(self.known.extent)
        allowed = counts_of(self.settings.max_error, self.calibration, extent, self.source.unit)
        error = min(int(allowed), STEP_LIMIT // 2 - 1)
        if error < 1:
            return lossless(self.settings)
        self.bounded = True
        return replace(self.settings, max_error=Tolerance(error, "lsb"))

    def choose(self, sample: NDArray[Any]) -> ChannelEncoder:
        """The encoder; ``sample`` are some of the values."""
        if self.takes_counts:
            return GridEncoder(self.counts_plan(), self.number)
        plan = plan_input(self.plain, lossless(self.settings))
        words = next((name for name, dtype in DTYPES.items() if dtype == self.dtype), "binary64")
        if words in ("int64", "uint64", "binary16"):
            return WordsEncoder(plan, self.number, words)
        exact = choose_exact(plan, self.number, sample, None)
        stepped = self.steps_plan()
        if stepped is None:
            return exact
        grid = GridEncoder(stepped, self.number)
        both: list[ChannelEncoder] = [exact, grid]
        sizes = [len(each.code(each.take(sample, 0), 0).packets[0].data) for each in both]
        self.bounded = sizes[1] < sizes[0]
        return grid if self.bounded else exact

    def steps_plan(self) -> Plan | None:
        """Floats as steps of twice the largest error; None where every bit is kept."""
        if self.settings.preset != "near-lossless" or self.known is None:
            return None
        amount, unit = self.settings.max_error, self.source.unit
        error = amount.absolute(self.known.extent, self.source.lsb, unit)
        if error is None or not 0 < error < inf:
            return None
        step = rounded_down(2 * error)
        reach = max(abs(self.known.low), abs(self.known.high)) / step + 1 if step else inf
        if not reach < 1 << 31:
            return None
        bits = max(int(reach).bit_length() + 1, 2)
        try:
            return plan_input(self.input(lsb=step, bits=bits), lossless(self.settings))
        except ParameterError:
            return None

    def decision(self, tracks: Iterable[Track]) -> Decision:
        """The report on this channel; tracks: all of the file."""
        parts = [TrackPair(t, None) for t in tracks if t.first_channel == self.number]
        forms: dict[type, str] = {ExactEncoder: "exact", WordsEncoder: "raw"}
        return Decision(
            channel=self.number,
            label=self.label,
            sample_count=self.sample_count,
            axis_count=1,
            chosen=forms.get(type(self.encoder), "predicted"),
            reason="encoded while it was read",
            lattice="as recorded" if self.takes_counts else "stored as it came",
            exact=not self.bounded,
            within=True,
            size=self.size,
            unit=self.source.unit,
            kept_as=ChannelRef(self.number, 0, tuple(parts)).kept_as,
            largest_error=self.largest_error,
            relative_error=self.largest_error / self.extent if self.extent else 0.0,
            original_bits=8 * self.source.dtype.itemsize,
        )


def lossless(settings: Settings) -> Settings:
    return Settings(cluster=settings.cluster, effort=settings.effort)


def rounded_down(step: float) -> float:
    """To four digits, so that the step is a simple fraction; 0 where there is none."""
    if not 0 < step < inf:
        return 0.0
    near = float(f"{step:.3e}")
    return near if near <= step * (1 - 2**-12) else float(f"{step * (1 - 2**-9):.3e}")


def count_range(dtype: np.dtype[Any], known: Range | None) -> tuple[int, int]:
    """The least and the largest count."""
    if known is not None:
        return (int(known.low), int(known.high)) if known.low <= known.high else (0, 0)
    if dtype.kind == "b":
        return 0, 1
    info = np.iinfo(dtype)
    return int(info.min), int(info.max)


@dataclass(frozen=True)
class ColumnGroup:
    """Columns of one table and dtype, whose samples go together."""

    channels: tuple[int, ...]
    places: tuple[int, ...]
    dtype: np.dtype[Any]


@dataclass
class Importer:
    """One file on its way."""

    found: Import
    described: Recording
    settings: Settings
    progress: Advance
    threads: int = 1
    overview: bool = False
    columns: list[ImportedChannel] = field(default_factory=list)
    lanes: list[list[ColumnGroup]] = field(default_factory=list)
    """By table."""
    payload: int = 0
    """Bytes of the packets so far."""
    read_before: int = 0
    """Rows of a first pass."""

    def __post_init__(self) -> None:
        labels = iter(self.found.labels)
        for table in self.found.tables:
            own = [
                ImportedChannel(
                    len(self.columns) + place, next(labels), table, source, self.settings
                )
                for place, source in enumerate(table.columns)
            ]
            by_dtype: dict[Any, list[int]] = {}
            for place, column in enumerate(own):
                by_dtype.setdefault(column.dtype, []).append(place)
            first = len(self.columns)
            self.lanes.append(
                [
                    ColumnGroup(tuple(first + place for place in places), tuple(places), dtype)
                    for dtype, places in by_dtype.items()
                ]
            )
            self.columns += own
        self.total = sum(table.row_count for table in self.found.tables)
        self.cluster = self.cluster_of()
        self.clusters = Clusters(self.cluster, None)
        self.begun = False

    @property
    def needs_ranges(self) -> bool:
        return any(column.needs_range for column in self.columns)

    def cluster_of(self) -> Fraction:
        """Seconds: as :func:`write` chooses them, but several fit the memory."""
        if self.settings.cluster is not None:
            return self.settings.cluster
        wanted = self.settings.cluster_of(self.described)
        per_second = sum((t.row_size * t.rate for t in self.found.tables), Fraction(0))
        if not per_second:
            return wanted
        return min(wanted, max(Fraction(WAITING, CLUSTERS) / per_second, Fraction(1)))

    def blocks(self, done: int = 0, total: int | None = None) -> Iterator[tuple[int, int, Any]]:
        """Table, first row and values of each block, checked."""
        filled = [0] * len(self.found.tables)
        for block in self.found.blocks():
            rows = len(block.values[0]) if block.values else 0
            if block.first_row != filled[block.table]:
                raise ParameterError("the rows of the file changed while it was read")
            filled[block.table] += rows
            if filled[block.table] > self.found.tables[block.table].row_count:
                raise ParameterError("the file has more rows than were counted")
            yield block.table, block.first_row, block.values
            self.progress(done + sum(filled), total or self.total)
        if filled != [table.row_count for table in self.found.tables]:
            raise ParameterError("the file ended before all of its rows were read")

    def find_ranges(self) -> None:
        """Read all values once. Raises ParameterError where an error bound flattens a channel."""
        firsts = self.first_columns()
        ranges = [Range() for _ in self.columns]
        for table, _, values in self.blocks(0, 2 * self.total):
            for place, x in enumerate(values):
                known = x[~np.isnan(x)] if x.dtype.kind == "f" else x
                ranges[firsts[table] + place].add(known)
        self.read_before = self.total
        for column, range_ in zip(self.columns, ranges, strict=True):
            column.known = range_
            if self.settings.preset == "near-lossless":
                error = self.settings.max_error.absolute(column.extent, column.step, column.unit)
                check_error(self.settings, column.extent, error or 0.0, column.label, column.unit)
                if inf in (-range_.low, range_.high):
                    warnings.warn(KEPT.format(column.label), DataWarning, stacklevel=4)

    def first_columns(self) -> list[int]:
        firsts, at = [], 0
        for table in self.found.tables:
            firsts.append(at)
            at += len(table.columns)
        return firsts

    def run(self, stream: BinaryIO, canonical: int | None) -> Summary:
        self.stream, self.canonical = stream, canonical
        for column in self.columns:
            table = column.table
            start = int(table.all_ticks(0, 1)[0]) if table.row_count else TICK_LIMIT
            self.clusters.add(column.number, table.rate, start)
        done = self.read_before
        for number, first_row, values in self.blocks(done, done + self.total):
            complete = self.take(number, first_row, values)
            if not self.begun and self.clusters.size < SEEN:
                continue
            self.begin()
            if complete:
                self.write(self.clusters.complete())
            if self.clusters.size > WAITING:
                self.write(self.clusters.rest())
        self.begin()
        return self.finish()

    def take(self, number: int, first_row: int, values: Sequence[NDArray[Any]]) -> bool:
        """Whether a cluster may be complete."""
        table = self.found.tables[number]
        rows = len(values[0]) if values else 0
        ticks = table.all_ticks(first_row, first_row + rows)
        if rows and (ticks[0] < 0 or ticks[-1] >= TICK_LIMIT):
            raise ParameterError(f"ticks of table {table.name!r} lie in [0, 2^48)")
        cuts = [0, *(np.flatnonzero(np.diff(ticks) != 1) + 1).tolist(), rows]
        row = first_row + rows
        next_ = int(table.all_ticks(row, row + 1)[0]) if row < table.row_count else TICK_LIMIT
        complete = False
        for lane in self.lanes[number]:
            columns = [np.asarray(values[place]).astype(lane.dtype) for place in lane.places]
            whole = np.column_stack(columns)
            for first, last in zip(cuts, cuts[1:], strict=False):
                if first < last:
                    part = SampleRows(lane.channels, int(ticks[first]), whole[first:last])
                    complete |= self.clusters.take(part)
            # The next row is known, so that nothing waits for a gap or for the end of a table.
            nothing = whole[:0]
            complete |= self.clusters.take(SampleRows(lane.channels, next_, nothing))
        return complete

    def begin(self) -> None:
        """Choose the forms of the channels by the samples so far, and start the file."""
        if self.begun:
            return
        self.begun = True
        layers, marks = layers_of(self.described, 0, self.cluster)
        rates = {track.id: track.rate for track in layers}
        timed = [(mark.start / rates[mark.track], mark) for mark in marks]
        self.marks = sorted(timed, key=lambda pair: pair[0])
        self.encoder = LiveEncoder(lossless(self.settings), first_track=len(layers))
        samples = self.samples()
        levels = [LEVELS[1]]
        for column in self.columns:
            sample = samples.get(column.number)
            if sample is not None or column.takes_counts:
                column.encoder = column.choose(np.empty(0) if sample is None else sample)
                self.encoder.use(column.number, column.encoder)
                if isinstance(column.encoder, GridEncoder):
                    levels.append(column.encoder.plan.level)
            elif plan := column.steps_plan():
                column.may_be_bounded = True
                levels.append(plan.level)
        lossy = any(column.bounded or column.may_be_bounded for column in self.columns)
        settings = self.settings if lossy else lossless(self.settings)
        extras = extras_of(self.described)
        level = max(levels, key=lambda one: one.number)
        if max((len(payload) for _, payload in extras), default=0) > level.payload_size:
            level = LEVELS[2]
        self.writer = FileWriter(
            self.stream,
            level=level,
            file_id=self.canonical,
            epoch_ns=self.found.epoch_ns,
            epoch_uncertainty_ns=self.found.epoch_uncertainty_ns,
            encoder=encoder_of(self.described, settings),
        )
        self.writer.describe(layers)
        for type_, payload in extras:
            self.writer.chunk(type_, payload)

    def samples(self) -> dict[int, NDArray[Any]]:
        """For each channel the piece with the most distinct values, among some of those here."""
        found: dict[int, list[NDArray[Any]]] = {}
        for number in sorted(self.clusters.buckets):
            for piece in pieces_of(self.clusters.buckets[number].rows):
                found.setdefault(piece.channel, []).append(piece.values)
        return {
            channel: max(pieces[:: -(-len(pieces) // LOOKED_AT)], key=lambda x: np.unique(x).size)
            for channel, pieces in found.items()
        }

    def write(self, clusters: Iterable[list[SamplePiece]]) -> None:
        for pieces in clusters:
            blocks = []
            for piece in pieces:
                column = self.columns[piece.channel]
                if column.encoder is None:
                    column.encoder = column.choose(piece.values)
                    self.encoder.use(piece.channel, column.encoder)
                blocks.append(Block(piece.channel, column.plain, piece.start, piece.values))
                column.sample_count += piece.values.size
                if column.bounded:
                    column.largest_error = max(column.largest_error, error_of(column, piece.values))
            tracks, packets = self.encoder.encode(blocks, threads=self.threads)
            self.writer.describe(tracks)
            for packet in packets:
                channel = self.writer.tracks[packet.track].first_channel
                self.columns[channel].size += len(packet.data)
            self.put([*packets, *self.due(self.clusters.done_s)])

    def put(self, packets: Sequence[Packet]) -> None:
        self.payload += sum(len(packet.data) for packet in packets)
        self.writer.cluster(packets)

    def due(self, until: Fraction | None) -> list[Packet]:
        """Packets of the events before ``until`` seconds; None: of all."""
        count = sum(until is None or time < until for time, _ in self.marks)
        ready, self.marks = self.marks[:count], self.marks[count:]
        return [packet for _, packet in ready]

    def finish(self) -> Summary:
        self.write(self.clusters.complete())
        self.write(self.clusters.rest())
        if rest := self.due(None):
            self.put(rest)
        silent = {c.number: c.plain for c in self.columns if not c.sample_count}
        self.writer.describe(self.encoder.silent(silent))
        for chunk in clock_chunks(self.described, list(self.writer.tracks.values())):
            self.writer.chunk(*chunk)
        overview_size = 0
        if self.overview:
            overview_size = attach_overview(self.stream, self.writer, self.threads)
        self.writer.close()
        return Summary(
            self.writer.offset,
            self.payload,
            sum(column.sample_count for column in self.columns),
            tuple(column.decision(self.writer.tracks.values()) for column in self.columns),
            overview_size,
        )


def error_of(column: ImportedChannel, values: NDArray[Any]) -> float:
    """The largest error of samples that a grid keeps, in their unit."""
    encoder = column.encoder
    assert isinstance(encoder, GridEncoder)
    plan = encoder.plan
    counts = encoder.take(values, 0)
    kept = plan.grid.counts(nearest(counts, plan.grid), int(np.abs(counts).max(initial=0)))
    given = plan.calibration.physical(counts) if plan.input.takes_counts else values
    return float(np.abs(plan.calibration.physical(kept) - given).max(initial=0))


__all__ = ["STREAMED", "read_if_small", "why_whole", "write_import"]
