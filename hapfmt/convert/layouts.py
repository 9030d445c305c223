"""Arrays in named groups, as HDF5 and MAT files hold them -> tables with times, labels and units.

A group of arrays has no fixed meaning. The rules here are, in this order: times are an array of one
dimension with a name such as ``time`` or ``timestamps``, in the same group or the nearest one above
that has as many rows. Without times, an attribute or a number called ``rate``, ``fs`` or ``fps``
gives the rate. The longer side of an array is time. A file that these rules do not fit is described
by a map (see maps.py).
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import isfinite, lcm, prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import LimitError, ParameterError, matching, unknown
from ..numbers import counted
from ..recording import Calibration, Event
from ..times import TIME_UNITS
from ..units import split_name, to_ucum
from .common import CHANNEL_LIMIT, filled_rates, rate_from, several_rates, unit_of
from .formats import ReadOptions
from .tables import Import, ImportBlock, ImportColumn, ImportTable
from .timestamps import Placed, align, place, place_at_need, stamp_channel, stamp_label

Path = tuple[str, ...]

RATES = [
    "rate",
    "rate_hz",
    "fs",
    "fs_hz",
    "sampling_rate",
    "sample_rate",
    "samplerate",
    "sampling_frequency",
    "sfreq",
    "fps",
    "frequency",
    "control_freq",
]
LABELS = [
    "labels",
    "channel_names",
    "channel_labels",
    "column_names",
    "columns",
    "channels",
    "names",
]
UNITS = ("unit", "units")
PLAIN = ["data", "values", "value", "samples", "sample", "x", "signal", "signals"]
"""Names that say nothing: the group above names the channel."""
IMAGES = re.compile(r"image|images|rgb|depth|video|frames?|jpe?g|png", re.I)
EPISODES = re.compile(r"(demo|episode|traj|trajectory)_?(\d+)", re.I)
_UNIT_OF_TIME = (
    "s|sec|secs|seconds?|ms|msecs?|milliseconds?|us|usecs?|microseconds?|ns|nsecs?|nanoseconds?"
)
TIMES = re.compile(rf"(?:t|ts|times?|time_?stamps?|stamps?)(?:_?(?P<unit>{_UNIT_OF_TIME}))?", re.I)
WIDEST = 4096
"""Numbers in a row; more are images or the like."""
MOST_EVENTS = 100_000
MOST_NOTES = 1000
LONGEST_NAME = 512
"""Bytes of the name of a group, a data set or a variable."""
BLOCK_SIZE = 4 << 20
"""Bytes of a block, unless a chunk of the file is larger."""
FEWEST_ROWS = 1024
_SHOWN = 8
_UNIX_S = (946_684_800, 4_102_444_800)
"""Times between the years 2000 and 2100 count from 1970."""
_DAYS = (693_962, 767_011)
"""The same years in days, as datenum of MATLAB counts them."""
_NEAR = Fraction(1, 5000)
"""A stated rate this near to that of the times is the rate."""


@dataclass(frozen=True)
class SourceArray:
    """An array of numbers, not read yet.

    ``read(axis, first, last)`` gives the part with first <= index < last along one axis. ``rows``:
    how many are read together along each axis; () where any number may be. ``label``: in place of
    the last name of the path.
    """

    path: Path
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[int, int, int], NDArray[Any]]
    attributes: dict[str, Any] = field(default_factory=dict)
    rows: tuple[int, ...] = ()
    label: str = ""

    @property
    def name(self) -> str:
        return "/" + "/".join(self.path)

    @property
    def long_axes(self) -> list[int]:
        """Those with more than one index; the first if there is none."""
        return [axis for axis, size in enumerate(self.shape) if size != 1] or [0]

    @property
    def is_line(self) -> bool:
        return len(self.long_axes) == 1

    @property
    def size(self) -> int:
        return prod(self.shape)

    def width(self, axis: int) -> int:
        """Numbers in a row, where ``axis`` is time."""
        return prod(size for other, size in enumerate(self.shape) if other != axis)

    def block(self, axis: int, first: int, last: int) -> NDArray[Any]:
        """[rows, numbers in a row]."""
        part = np.asarray(self.read(axis, first, last))
        if part.shape != (*self.shape[:axis], last - first, *self.shape[axis + 1 :]):
            raise ParameterError(f"{self.name} is not as long as its header says")
        return np.moveaxis(part, axis, 0).reshape(last - first, -1)

    def line(self) -> NDArray[Any]:
        """All of it, [samples]."""
        axis = self.long_axes[0]
        return self.block(axis, 0, self.shape[axis]).reshape(-1)


@dataclass
class SourceTree:
    """``groups``: what is known of each group: its attributes, and its numbers and texts."""

    arrays: list[SourceArray] = field(default_factory=list)
    groups: dict[Path, dict[str, Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    _folded: dict[Path, dict[str, Any]] = field(default_factory=dict, init=False, repr=False)

    def note(self, text: str) -> None:
        """Add a note, up to a number that a person would read."""
        if len(self.notes) < MOST_NOTES:
            self.notes.append(text)
        elif len(self.notes) == MOST_NOTES:
            self.notes.append("more is not read; the notes name the first of it")

    def known(
        self, path: Path, names: Sequence[str], *, inherited: bool = True, top: int = 0
    ) -> Any:
        """The attribute of a group, or of the nearest one above it; None where none has it.
        ``top``: depth of the highest group that counts."""
        for depth in range(len(path), (top if inherited else len(path)) - 1, -1):
            group = path[:depth]
            if group not in self._folded:
                self._folded[group] = _folded(self.groups.get(group, {}))
            for name in names:
                if name in self._folded[group]:
                    return self._folded[group][name]
        return None

    def array(self, name: str) -> SourceArray:
        """The array of a path such as /force/data; dots separate names as well."""
        path = name.strip("/")
        for each in self.arrays:
            if path in ("/".join(each.path), ".".join(each.path)):
                return each
        raise ParameterError(unknown("data set", name, [each.name for each in self.arrays]))


class PlannedPart(NamedTuple):
    """An array with its time axis; what is None follows from the array."""

    array: SourceArray
    axis: int
    labels: Sequence[str] | None = None
    units: Sequence[str] | None = None
    quantity: str = ""


class PlannedTable(NamedTuple):
    """``exponent``: power of ten of the unit of the times, s; None: the times say it."""

    name: str
    parts: list[PlannedPart]
    times: SourceArray | None
    rate: Fraction | None
    exponent: int | None = None
    kind: str = ""

    @property
    def row_count(self) -> int:
        array, axis = self.parts[0][:2]
        return array.shape[axis]


def _folded(attributes: dict[str, Any]) -> dict[str, Any]:
    """With names in lower case; of equal ones the first."""
    return {
        key.casefold(): value for key, value in reversed(attributes.items()) if value is not None
    }


def named(attributes: dict[str, Any], names: Sequence[str]) -> Any:
    """The first attribute that has one of the names, in upper or lower case."""
    found = _folded(attributes)
    return next((found[name] for name in names if name in found), None)


def import_of_tree(tree: SourceTree, options: ReadOptions) -> Import:
    """The tables that the rules find in a file."""
    tree = _episode(tree, options)
    planned = _planned(tree, options)
    return built(tree, planned, options)


def _episode(tree: SourceTree, options: ReadOptions) -> SourceTree:
    """The part of the file that belongs to one episode of several."""
    found = {path: None for path in tree.groups if path and EPISODES.fullmatch(path[-1])}
    depth = min(map(len, found), default=0)
    episodes = {path[-1]: path for path in found if len(path) == depth}
    chosen = options.episode
    if chosen is None:
        if len(episodes) > 1 and not options.select:
            names = sorted(episodes, key=lambda name: int(EPISODES.fullmatch(name)[2]))  # type: ignore[index]
            raise ParameterError(
                f"the file holds {len(episodes)} episodes, {names[0]} to {names[-1]}; choose one "
                "(episode=)"
            )
        return tree
    numbered = {int(EPISODES.fullmatch(name)[2]): path for name, path in episodes.items()}  # type: ignore[index]
    path = episodes.get(chosen)
    if path is None and re.fullmatch(r"[0-9]{1,9}", chosen):
        path = numbered.get(int(chosen))
    if path is None:
        raise ParameterError(
            unknown("episode", chosen, list(episodes))
            if episodes
            else "the file has no groups such as demo_0 or episode_0 to choose an episode from"
        )
    above = {path[:depth] for depth in range(len(path))}
    return SourceTree(
        [array for array in tree.arrays if array.path[: len(path)] == path],
        {
            group: values
            for group, values in tree.groups.items()
            if group in above or group[: len(path)] == path
        },
        [f"of {counted(len(episodes), 'episode')}, {path[-1]} is read", *tree.notes],
    )


def _planned(tree: SourceTree, options: ReadOptions) -> list[PlannedTable]:
    notes, sized = tree.notes, []
    clocks: list[SourceArray] = []
    paths = {array.path for array in tree.arrays}
    for array in (part for whole in tree.arrays for part in _split(whole, tree)):
        if (
            array.is_line
            and array.size > 1
            and array.dtype.kind in "iuf"
            and _is_times(array, paths)
        ):
            clocks.append(array)
        elif array.size > 1:
            sized.append(array)
    if options.clock is not None and not any(_is_called(one, options.clock) for one in clocks):
        raise ParameterError(unknown("time array", options.clock, [one.name for one in clocks]))
    known = [one for one in clocks if options.clock is None or _is_called(one, options.clock)]
    times_of = _Clocks(known).of
    wanted = _selected(sized, options.select)
    first_axis = options.transpose is None and _rows_first(tree)
    found: dict[tuple[Any, ...], PlannedTable] = {}
    used: set[str] = set()
    timeless: list[SourceArray] = []
    square: list[SourceArray] = []
    transposes = options.transpose is None
    for array in wanted:
        if (reason := _unread(array)) is not None:
            notes.append(
                f"images of {array.name} ({_shape(array)}) are not read"
                if reason == "images"
                else f"{array.name} ({_shape(array)}) is not read: {reason}"
            )
            continue
        times = times_of(array)
        # A rate above the group of the times is that of other arrays.
        rate = _stated_rate(array, tree, 0 if times is None else len(times.path) - 1)
        if times is None and rate is None and options.rate is None:
            timeless.append(array)
            continue
        if times is not None:
            used.add(times.name)
        axis = _time_axis(array, times, options.transpose, first_axis)
        transposes |= axis != _time_axis(array, times, not options.transpose, first_axis)
        if axis is None:
            square.append(array)
            continue
        key = (
            array.path[:-1], None if times is None else times.name, rate, array.shape[axis],
        )  # fmt: skip
        planned = found.get(key)
        if planned is None:
            name = "/" + "/".join(array.path[:-1])
            planned = found[key] = PlannedTable(name, [], times, rate)
        planned.parts.append(PlannedPart(array, axis))
    tables = _long_enough(list(found.values()), notes, bool(options.select))
    if square:
        if not tables:
            raise ParameterError(_square(square))
        notes.append(f"{_listed(square)} is not read: either side may be time")
    if not tables:
        raise ParameterError(_nothing(sized, timeless, notes))
    if timeless:
        notes.append(
            f"no times and no rate are known for {_listed(timeless)}; a rate, or a map of the "
            "file, makes them channels"
        )
    if not transposes:
        notes.append("transpose changes nothing: times or shapes say which side is time")
    if others := [one for one in clocks if one.name not in used]:
        notes.append(
            f"the times {_listed(others)} are not used; another clock was chosen or is nearer"
        )
    return tables


def _split(array: SourceArray, tree: SourceTree) -> list[SourceArray]:
    """The array, or its times and the rest, where a label says that a column is time."""
    if len(array.long_axes) != 2 or array.dtype.kind not in "iuf":
        return [array]
    texts = _texts(named(array.attributes, LABELS)) or _texts(
        tree.known(array.path[:-1], LABELS, inherited=False)
    )
    sides = [axis for axis in array.long_axes if array.shape[axis] == len(texts)]
    clocks = [
        place for place, text in enumerate(texts) if TIMES.fullmatch(split_name(text.strip())[0])
    ]
    if len(sides) != 1 or len(clocks) != 1:
        return [array]
    return list(split_column(array, sides[0], clocks[0], texts))


def split_column(
    array: SourceArray, axis: int, place: int, texts: Sequence[str] = ()
) -> tuple[SourceArray, SourceArray]:
    """One column as times, and the array without it; ``axis`` counts the columns."""
    count = array.shape[axis]
    name, unit = split_name(texts[place].strip()) if texts else ("time", "")
    units = _texts(named(array.attributes, UNITS))
    if len(units) == count:
        unit = unit or units[place]

    def column(_: int, first: int, last: int) -> NDArray[Any]:
        return np.asarray(array.read(axis, place, place + 1)).reshape(-1)[first:last]

    def others(along: int, first: int, last: int) -> NDArray[Any]:
        if along != axis:
            return np.delete(np.asarray(array.read(along, first, last)), place, axis)
        whole = np.delete(np.asarray(array.read(axis, 0, count)), place, axis)
        return np.take(whole, range(first, last), axis)

    kept = dict(array.attributes)
    for names, values in ((LABELS, texts), (UNITS, units)):
        if len(values) == count:
            kept = {key: value for key, value in kept.items() if key.casefold() not in names}
            kept[names[0]] = [each for number, each in enumerate(values) if number != place]
    shape = tuple(size - (side == axis) for side, size in enumerate(array.shape))
    return (
        SourceArray(
            (*array.path, name), (array.size // count,), array.dtype, column,
            {"units": unit} if unit.strip("1") else {},
        ),
        replace(array, shape=shape, read=others, attributes=kept),
    )  # fmt: skip


def _nothing(
    sized: Sequence[SourceArray], timeless: Sequence[SourceArray], notes: Sequence[str]
) -> str:
    if timeless:
        wide = "" if all(each.is_line for each in timeless) else ", or which column is time"
        return (
            f"no times and no rate are known for {_listed(timeless)}; give a rate (rate=), or a "
            f"map that says where the times are{wide} (map=)"
        )
    if notes:
        return f"the file holds nothing that is read as a channel: {'; '.join(notes[:_SHOWN])}"
    if sized:
        return f"the file holds no arrays that are read as channels, only {_listed(sized)}"
    return "the file holds no arrays of numbers"


def _listed(arrays: Sequence[SourceArray]) -> str:
    shown = ", ".join(f"{each.name} ({_shape(each)})" for each in arrays[:_SHOWN])
    more = len(arrays) - _SHOWN
    return f"{shown} and {more} more" if more > 0 else shown


def _shape(array: SourceArray) -> str:
    return " x ".join(map(str, array.shape)) + f" {array.dtype}"


def _is_called(array: SourceArray, name: str) -> bool:
    return name.strip("/") in (array.path[-1], "/".join(array.path))


def _selected(arrays: list[SourceArray], select: Sequence[str]) -> list[SourceArray]:
    """The arrays whose path, name or group one of the patterns fits."""
    if not select:
        return arrays
    found: dict[str, SourceArray] = {}
    for pattern in select:
        wanted = pattern.strip("/")
        fitted = False
        for each in arrays:
            places = ["/".join(each.path[:depth]) for depth in range(1, len(each.path) + 1)]
            if wanted in (names := [*places, each.path[-1]]) or matching(wanted, names):
                found[each.name] = each
                fitted = True
        if not fitted:
            raise ParameterError(unknown("data set", pattern, [each.name for each in arrays]))
    return [each for each in arrays if each.name in found]


def _rows_first(tree: SourceTree) -> bool:
    """Files of ALOHA and robomimic have a row for each time, however few there are."""
    names = {"/".join(array.path) for array in tree.arrays}
    return {"action", "observations/qpos"} <= names or any(
        re.fullmatch(r"data/demo_\d+/actions", name) for name in names
    )


def _unread(array: SourceArray) -> str | None:
    """Why an array cannot be channels; None where it can."""
    sides = [size for size in array.shape if size != 1]
    if array.size == 0:
        return "it is empty"
    if "next_obs" in array.path[:-1]:
        return "it repeats obs, one row later"
    if len(sides) > 2 and (
        array.dtype == np.uint8 or any(IMAGES.fullmatch(name) for name in array.path)
    ):
        return "images"
    if any(IMAGES.fullmatch(name) for name in array.path[:-1]) and array.dtype == np.uint8:
        return "images"
    if len(sides) > 1 and prod(sides) // max(sides) > WIDEST:
        return f"a row has more than {WIDEST} numbers, as images have"
    if len(sides) > 2 and array.width(array.long_axes[0]) > WIDEST:
        return f"a row has more than {WIDEST} numbers, as images have"
    if array.dtype.kind not in "biuf":
        return f"{array.dtype} values are not real numbers"
    if array.dtype.itemsize > 8:
        return f"{array.dtype} is wider than float64"
    return None


def _is_times(array: SourceArray, paths: set[Path]) -> bool:
    name = array.path[-1]
    if TIMES.fullmatch(name) is not None:
        return True
    if named(array.attributes, UNITS) is not None and re.fullmatch(
        r"(?:seconds|milliseconds|microseconds|nanoseconds) since .*",
        _text(named(array.attributes, UNITS)),
    ):
        return True
    stem = _stem(name)
    return stem is not None and (*array.path[:-1], stem) in paths


def _stem(name: str) -> str | None:
    """The array that times such as force_time or t_force belong to."""
    head, _, tail = name.rpartition("_")
    if head and TIMES.fullmatch(tail):
        return head
    for size in range(2, 4):
        head, _, tail = (
            "_".join(name.split("_")[:-size]), "", "_".join(name.split("_")[-size:])
        )  # fmt: skip
        if head and TIMES.fullmatch(tail):
            return head
    head, _, tail = name.partition("_")
    return tail if tail and TIMES.fullmatch(head) else None


class _Clocks:
    """Arrays of times, found by where they are and how long they are."""

    def __init__(self, arrays: Sequence[SourceArray]) -> None:
        self._own: dict[tuple[Path, str], list[SourceArray]] = {}
        self._common: dict[tuple[Path, int], SourceArray] = {}
        for one in arrays:
            group, stem = one.path[:-1], _stem(one.path[-1])
            if stem is not None:
                self._own.setdefault((group, stem), []).append(one)
            if stem is None or TIMES.fullmatch(one.path[-1]) is not None:
                self._common.setdefault((group, one.size), one)

    def of(self, array: SourceArray) -> SourceArray | None:
        """The times of an array: its own, then those of the nearest group, with as many rows."""
        for one in self._own.get((array.path[:-1], array.path[-1]), []):
            if one.size in array.shape:
                return one
        for depth in range(len(array.path), -1, -1):
            for size in array.shape:
                found = self._common.get((array.path[:depth], size))
                if found is not None:
                    return found
        return None


def _stated_rate(array: SourceArray, tree: SourceTree, top: int) -> Fraction | None:
    value = named(array.attributes, RATES)
    if value is None:
        value = tree.known(array.path[:-1], RATES, top=top)
    if value is None:
        text = tree.known(array.path[:-1], ["env_args"], top=top)
        value = _control_rate(text) if isinstance(text, str) else None
    if isinstance(value, list) and len(value) == 1:
        value = value[0]
    if isinstance(value, (int, float, str)) and not isinstance(value, bool):
        try:
            return rate_from(value)
        except ParameterError:
            return None
    return None


def _control_rate(text: str) -> Any:
    """robomimic describes its environment in JSON."""
    try:
        found = json.loads(text)
        return found["env_kwargs"]["control_freq"]
    except (ValueError, RecursionError, LookupError, TypeError):
        return None


def _time_axis(
    array: SourceArray,
    times: SourceArray | None,
    transpose: bool | None,
    first_axis: bool,
) -> int | None:
    """None: the array is square and nothing else says."""
    axes = array.long_axes
    if len(axes) == 1:
        return axes[0]
    if times is not None:
        axes = [axis for axis in axes if array.shape[axis] == times.size]
        if len(axes) == 1:
            return axes[0]
    if transpose is not None:
        return axes[0] if transpose else axes[-1]
    if first_axis or len(array.long_axes) > 2:
        return axes[0]
    labels = _texts(named(array.attributes, LABELS))
    if labels and [array.shape[axis] for axis in axes].count(len(labels)) == 1:
        return next(axis for axis in axes if array.shape[axis] != len(labels))
    if array.shape[axes[0]] != array.shape[axes[-1]]:
        return max(axes, key=lambda axis: array.shape[axis])
    return None


def _square(arrays: Sequence[SourceArray]) -> str:
    return (
        f"either side of {_listed(arrays)} may be time; say that an array is [samples, channels] "
        "(transpose=True), or [channels, samples] (transpose=False)"
    )


def _long_enough(
    tables: list[PlannedTable], notes: list[str], is_selected: bool
) -> list[PlannedTable]:
    """Without the arrays that are much shorter than the others of their rate: constants."""
    if is_selected:
        return tables
    longest: dict[Any, int] = {}
    for one in tables:
        if one.times is None:
            longest[one.rate] = max(longest.get(one.rate, 0), one.row_count)
    kept = []
    for one in tables:
        if one.times is None and one.row_count * 20 < longest[one.rate]:
            arrays = [part.array for part in one.parts]
            notes.append(f"{_listed(arrays)} is much shorter than the others, and is not read")
        else:
            kept.append(one)
    return kept


def built(tree: SourceTree, planned: list[PlannedTable], options: ReadOptions) -> Import:
    """The contents of a file whose tables are known. Reads the times, and no values."""
    rows = sum(one.row_count for one in planned if one.times is not None)
    if rows * 64 > options.max_memory:  # stamps, ticks, and what counting them needs
        raise LimitError(
            f"the times of {rows} rows take about {rows * 64} bytes, more than the "
            f"{options.max_memory} allowed; allow more (max_memory=) or select a part (select=)"
        )
    notes = list(tree.notes)
    rates, is_forced = filled_rates(
        options.rate,
        [
            (", ".join(part.array.name for part in one.parts), one.rate, _times_name(one))
            for one in planned
        ],
        notes,
    )
    is_used = rates != [one.rate for one in planned] or is_forced
    planned = [one._replace(rate=rate) for one, rate in zip(planned, rates, strict=True)]
    stamps = [_stamps(one, notes) for one in planned]
    known: dict[str, Placed | None] = {}
    grids: list[Placed | None] = []
    for one, own in zip(planned, stamps, strict=True):
        if own is None or one.times is None:
            grids.append(None)
            continue
        key = f"{one.times.name} {one.rate}"
        if key not in known:
            if is_forced:
                known[key] = place(own, name=one.times.name, rate=options.rate)
            elif one.rate is None:
                known[key], took = place_at_need(own, options.rate, name=one.times.name)
                is_used |= took
            else:
                known[key] = _placed(one, own, notes)
        grids.append(known[key])
    if options.rate is not None and not is_used:
        raise several_rates()
    epoch_ns, zero, starts = _zero(grids, stamps, notes)
    labels = _labels(planned, tree)
    timed = sum(x is not None and y is not None for x, y in zip(grids, stamps, strict=True))
    tables: list[ImportTable] = []
    sources: list[tuple[PlannedTable, NDArray[np.int64] | None]] = []
    events: list[Event] = []
    for number, (one, own, grid) in enumerate(zip(planned, stamps, grids, strict=True)):
        columns = _columns(one, labels[number], tree, notes)
        if own is not None and grid is None:
            events += _events(one, columns, own, zero, notes)
            continue
        extra = None
        if grid is not None and own is not None and options.keep_stamps:
            extra = stamp_channel(grid, own, epoch_ns or 0, starts[number])
            stem = one.name.strip("/").replace("/", ".")
            label = stamp_label(stem, timed if stem else 1)
            columns.append(ImportColumn(label, "ns", dtype=np.dtype(np.int64)))
        if grid is None and one.rate is None:
            raise ParameterError(f"{one.name} has neither times nor a rate; give a rate (rate=)")
        ticks = None if grid is None else grid.ticks
        if ticks is not None and int(ticks[-1]) == ticks.size - 1:
            ticks = None
        tables.append(
            ImportTable(
                name=one.name,
                columns=tuple(columns),
                rate=one.rate if grid is None else grid.rate,  # type: ignore[arg-type]
                row_count=one.row_count,
                ticks=ticks,
                start_tick=starts[number],
                kind=one.kind,
                notes=() if grid is None else grid.notes,
            )
        )
        sources.append((one, extra))
    column_count = sum(len(table.columns) for table in tables)
    if column_count > CHANNEL_LIMIT:
        raise LimitError(f"{column_count} channels, more than {CHANNEL_LIMIT}")

    def blocks() -> Iterator[ImportBlock]:
        for number, (one, extra) in enumerate(sources):
            yield from _blocks(number, one, tables[number].columns, extra)

    return Import(
        tuple(tables), blocks, epoch_ns=epoch_ns, events=tuple(events), notes=tuple(notes),
        metadata=_metadata(tree),
    )  # fmt: skip


def _blocks(
    number: int,
    one: PlannedTable,
    columns: Sequence[ImportColumn],
    extra: NDArray[np.int64] | None,
) -> Iterator[ImportBlock]:
    size = sum(part.array.width(part.axis) * part.array.dtype.itemsize for part in one.parts)
    together = max((part.array.rows[part.axis] for part in one.parts if part.array.rows), default=1)
    rows = max(BLOCK_SIZE // max(size, 1), 1)
    rows = min(-(-rows // together) * together, max(rows, FEWEST_ROWS))
    for first in range(0, one.row_count, rows):
        last = min(first + rows, one.row_count)
        values: list[NDArray[Any]] = []
        for part in one.parts:
            block = part.array.block(part.axis, first, last)
            for column in range(block.shape[1]):
                dtype = columns[len(values)].dtype
                values.append(np.ascontiguousarray(block[:, column]).astype(dtype, copy=False))
        if extra is not None:
            values.append(extra[first:last])
        yield ImportBlock(number, first, values)


def _stamps(one: PlannedTable, notes: list[str]) -> NDArray[np.int64] | None:
    """The times of the rows, in ns."""
    if one.times is None:
        return None
    name, x = one.times.name, one.times.line()
    if x.size != one.row_count:
        raise ParameterError(f"{name} has {x.size} times for {one.row_count} rows")
    if x.dtype.kind == "f" and not np.isfinite(x).all():
        raise ParameterError(f"{name} holds times that are not finite")
    exponent = one.exponent
    if exponent is None:
        exponent = _exponent(one.times, x, notes)
    with np.errstate(over="ignore"):
        if x.dtype.kind == "f":
            wide = x.astype(np.float64)
            scale = 10.0**exponent
            if np.abs(wide).max() * scale >= 9.2e9:
                raise ParameterError(f"{name} holds times beyond the year 2262")
            if exponent:
                return np.rint(wide * 10.0 ** (9 + exponent)).astype(np.int64)
            whole = np.floor(wide)
            return whole.astype(np.int64) * 10**9 + np.rint((wide - whole) * 1e9).astype(np.int64)
        factor: int = 10 ** (9 + exponent)
        if max(abs(int(x.min())), abs(int(x.max()))) * factor >= 1 << 63:
            raise ParameterError(f"{name} holds times beyond the year 2262")
        return np.asarray(x.astype(np.int64) * factor)


def _exponent(times: SourceArray, x: NDArray[Any], notes: list[str]) -> int:
    """The power of ten of the unit of times: as stated, else by their size."""
    stated = named(times.attributes, UNITS)
    if isinstance(stated, list) and len(stated) == 1:
        stated = stated[0]
    match = TIMES.fullmatch(times.path[-1]) or TIMES.fullmatch(times.path[-1].rpartition("_")[2])
    for text in (stated, match["unit"] if match else None):
        if isinstance(text, str):
            unit = to_ucum(text.partition(" since ")[0])
            unit = "ns" if unit.strip("{}").lower() in _NANO else unit
            if unit in TIME_UNITS:
                return TIME_UNITS[unit]
    start, steps = float(abs(x[0])), np.diff(x.astype(np.float64))
    step = float(np.median(steps)) if steps.size else 0.0
    for exponent in (0, -3, -6, -9):
        if _UNIX_S[0] <= start * 10.0**exponent <= _UNIX_S[1]:
            return exponent
    if x.dtype.kind == "f":
        if _DAYS[0] < start < _DAYS[1] and step < 0.01:
            raise ParameterError(
                f"{times.name} seems to hold days, as datenum of MATLAB does; store seconds, or "
                "give a rate (rate=)"
            )
        if step < 1 or (x != np.rint(x)).any():
            return 0
    if step <= 0:
        raise ParameterError(f"{times.name} holds times that do not rise")
    exponent = -3 if step <= 100 else -6 if step < 100_000 else -9
    unit = {-3: "ms", -6: "us", -9: "ns"}[exponent]
    notes.append(f"{times.name} has no unit; its times rise by {step:g}, and are read as {unit}")
    return exponent


_NANO = ("nsec", "nsecs", "nanosecond", "nanoseconds")


def _times_name(one: PlannedTable) -> str | None:
    return None if one.times is None else one.times.name


def _placed(one: PlannedTable, stamps: NDArray[np.int64], notes: list[str]) -> Placed | None:
    """By the times, or at the stated rate where that is nearly theirs."""
    assert one.times is not None and one.rate is not None
    found = place(stamps, name=one.times.name)
    if found is None or one.rate == found.rate:
        return found
    if abs(one.rate / found.rate - 1) <= _NEAR:
        return place(stamps, name=one.times.name, rate=one.rate)
    notes.append(
        f"{one.times.name} tell a rate of {float(found.rate):g} Hz, and the file states "
        f"{float(one.rate):g} Hz; the times are used"
    )
    return found


def _zero(
    grids: Sequence[Placed | None],
    stamps: Sequence[NDArray[np.int64] | None],
    notes: list[str],
) -> tuple[int | None, int, list[int]]:
    """The epoch, what the clock shows at tick 0, and the start tick of each table."""
    moments = [
        *(grid.start_ns for grid in grids if grid is not None),
        *(
            int(own.min())
            for grid, own in zip(grids, stamps, strict=True)
            if grid is None and own is not None and own.size
        ),
    ]
    if not moments:
        return None, 0, [0] * len(grids)
    first = min(moments)
    is_unix = _UNIX_S[0] * 10**9 <= first <= _UNIX_S[1] * 10**9
    zero = first if is_unix or first < 0 else 0
    if first < 0:
        notes.append(f"the times begin at {first / 1e9:g} s; that is second 0 of the recording")
    base = Placed(Fraction(1), np.zeros(1, np.int64), zero, (), 0, 0.0)
    _, starts = align([base, *(base if grid is None else grid for grid in grids)])
    return (zero if is_unix else None), zero, starts[1:]


def _events(
    one: PlannedTable,
    columns: Sequence[ImportColumn],
    stamps: NDArray[np.int64],
    zero: int,
    notes: list[str],
) -> list[Event]:
    """Rows without a rate, as events."""
    if one.row_count > MOST_EVENTS:
        raise ParameterError(
            f"{one.name} has {one.row_count} rows whose times are not regular, too many for events;"
            " give a rate (rate=)"
        )
    notes.append(f"the times of {one.name} are not regular; its {one.row_count} rows are events")
    layer = one.name.strip("/").replace("/", ".") or columns[0].label
    found = []
    for block in _blocks(0, one, columns, None):
        for row, values in enumerate(zip(*(each.tolist() for each in block.values), strict=True)):
            text = (
                str(values[0])
                if len(values) == 1
                else json.dumps(dict(zip((c.label for c in columns), values, strict=True)))
            )
            seconds = Fraction(int(stamps[block.first_row + row]) - zero, 10**9)
            found.append(Event(seconds, text, layer=layer))
    return found


def _labels(planned: Sequence[PlannedTable], tree: SourceTree) -> list[list[list[str]]]:
    """Labels of the columns of each part of each table: short where that is clear."""
    short = [[_own_labels(part, tree, full=False) for part in one.parts] for one in planned]
    count = Counter(label for one in short for part in one for label in part)
    return [
        [
            labels if all(count[label] == 1 for label in labels)
            else _own_labels(part, tree, full=True)
            for part, labels in zip(one.parts, own, strict=True)
        ]
        for one, own in zip(planned, short, strict=True)
    ]  # fmt: skip


def _own_labels(part: PlannedPart, tree: SourceTree, *, full: bool) -> list[str]:
    array, axis = part.array, part.axis
    width = array.width(axis)
    if width > CHANNEL_LIMIT:
        raise LimitError(f"{array.name} has {width} channels, more than {CHANNEL_LIMIT}")
    path = list(array.path)
    if array.label:
        path[-len(array.label.split(".")) :] = [array.label]
    while len(path) > 1 and path[-1].casefold() in PLAIN and not array.label:
        path.pop()
    short = path[-2:] if path[-1].isdigit() else path[-1:]
    stem = split_name(".".join(path if full else short))[0]
    texts = list(part.labels or _texts(named(array.attributes, LABELS)))
    if not texts and width > 1:
        texts = _texts(tree.known(array.path[:-1], LABELS, inherited=False))
    if len(texts) != width:
        own = named(array.attributes, ["label"])
        if own is None and path != list(array.path):
            own = tree.known(array.path[:-1], ["label"], inherited=False)
        texts = []
        if isinstance(own, str) and own.strip():
            if width == 1:
                texts = [own]
            else:
                stem = ".".join([*(path[:-1] if full else []), own.strip()])
    if len(texts) == width:
        texts = [split_name(text.strip())[0] for text in texts]
        before = ".".join(path[:-1] if path == list(array.path) else path)
        return [f"{before}.{text}" if full and before else text for text in texts]
    if width == 1:
        return [stem]
    sides = [size for other, size in enumerate(array.shape) if other != axis and size != 1]
    return [".".join([stem, *map(str, place)]) for place in np.ndindex(*sides)]


def _columns(
    one: PlannedTable, labels: Sequence[Sequence[str]], tree: SourceTree, notes: list[str]
) -> list[ImportColumn]:
    columns = []
    for part, own in zip(one.parts, labels, strict=True):
        array, axis = part.array, part.axis
        units = list(part.units or _texts(named(array.attributes, UNITS)))
        if not units:
            units = _texts(tree.known(array.path[:-1], UNITS, inherited=False))
        if not units:
            units = _unit_by_name(array, tree)
        texts = _texts(named(array.attributes, LABELS))
        if not units and len(texts) == len(own):
            units = [split_name(text.strip())[1] for text in texts]
        if not units:
            units = [split_name(array.path[-1])[1]]
        units = units * len(own) if len(units) == 1 else units
        if len(units) != len(own):
            notes.append(
                f"{array.name} has {len(own)} columns and {len(units)} units: none is used"
            )
            units = [""] * len(own)
        dtype, calibration = _kept_as(array, notes)
        group = ".".join(array.path[:-1] if array.width(axis) == 1 else array.path)
        for label, unit in zip(own, units, strict=True):
            code = unit_of(unit, label, notes, about=f"{array.name} {part.quantity}")
            columns.append(
                ImportColumn(
                    label, code, part.quantity, group=group[:255], calibration=calibration,
                    dtype=dtype, source_unit=unit if unit.strip() != code else "",
                )
            )  # fmt: skip
    return columns


def _unit_by_name(array: SourceArray, tree: SourceTree) -> list[str]:
    """Where the structure ``units`` has a text for each array."""
    for name in (*UNITS, *map(str.capitalize, UNITS)):
        known = tree.groups.get((*array.path[:-1], name), {})
        if units := _texts(known.get(array.path[-1])):
            return units
    return []


def _kept_as(array: SourceArray, notes: list[str]) -> tuple[np.dtype[Any], Calibration | None]:
    dtype = array.dtype.newbyteorder("=")
    if dtype.kind == "f":
        return dtype, None
    if dtype.itemsize == 8 or dtype == np.uint32:
        return np.dtype(np.int64 if dtype.kind == "i" else np.uint64), None
    scale = named(array.attributes, ["scale_factor"])
    offset = named(array.attributes, ["add_offset"])
    if scale is None and offset is None:
        return np.dtype(np.int32), Calibration()
    try:
        a = Fraction(str(1 if scale is None else scale))
        b = Fraction(str(0 if offset is None else offset))
        d = lcm(a.denominator, b.denominator)
        found = Calibration(int(a * d), int(b * d), d)
        low, high = (0, 1) if dtype.kind == "b" else (np.iinfo(dtype).min, np.iinfo(dtype).max)
        if found.covers(low, high):
            return np.dtype(np.int32), found
    except (ValueError, ArithmeticError, ParameterError):
        pass
    notes.append(f"the scale of {array.name} has no exact form here; its counts are kept")
    return np.dtype(np.int32), Calibration()


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _texts(value: Any) -> list[str]:
    """A text, a list of texts, or several texts with commas."""
    if isinstance(value, str):
        return [text.strip() for text in value.split(",")] if "," in value else [value]
    if isinstance(value, list) and value and all(isinstance(text, str) for text in value):
        return list(value)
    return []


def _metadata(tree: SourceTree) -> dict[str, Any]:
    """The attributes of groups, as JSON."""
    found = {
        "/" + "/".join(path): {key: plain(value) for key, value in values.items()}
        for path, values in tree.groups.items()
        if values
    }
    return {"attributes": found} if found else {}


def plain(value: Any) -> Any:
    """A value as JSON holds it."""
    if isinstance(value, list):
        return [plain(each) for each in value]
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return value
