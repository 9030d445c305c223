"""Arrow tables <-> channels, for Parquet, Feather and LeRobot.

Numeric columns become channels. So do the fields of a structure, and the places of a list whose
length is constant. A column of times places the rows. Our own files say the rest in their metadata:

=========================  ====================================================================
schema, key ``hapfmt``     JSON: ``version`` 1, ``rate`` as text "num/den", and ``epoch_ns``,
                           ``epoch_uncertainty_ns``, ``metadata``, ``events``, ``clocks``,
                           ``clock_maps`` where the recording has them
field, by name             ``label``, ``unit``, ``quantity``, ``axis``, ``group``, ``body_site``,
                           ``device``
field, key ``hapfmt``      JSON: ``dtype`` of the channel, ``calibration`` [a, b, d], ``lsb``
=========================  ====================================================================
"""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import accumulate
from math import lcm, prod
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockObservation
from ..errors import (
    HapfmtError,
    LimitError,
    MissingExtraError,
    ParameterError,
    matching,
    unknown,
)
from ..limits import TICK_LIMIT
from ..numbers import rdiv
from ..recording import (
    CHANNEL_LIMIT,
    Calibration,
    Channel,
    Event,
    Recording,
    Span,
    seconds_of,
    unique,
)
from ..times import TIME_UNITS, time_name
from ..units import split_name
from .common import choose_rate, not_carried, one_rate, rate_from, refusing, unit_of
from .formats import ReadOptions, WriteOptions
from .own import CARRIED, own_json, own_members, restored_counts, with_own
from .tables import Import, ImportBlock, ImportColumn, ImportTable
from .timestamps import Placed, observations, place, restart, stamp_channel, stamp_label

ROWS = 1 << 16
"""Most rows of a batch."""
BATCH_SIZE = 1 << 23
"""Bytes of a batch, about, where rows are wide."""
_DEPTH = 8
"""Levels of structures and lists within each other; deeper ones are left out."""
WIDTH = 1 << 14
"""Longest list that is read as channels."""
EVENTS = 10_000
"""Events that are made of a column of texts, or of rows without a rate."""
_TEXT_SIZE = 1 << 16
"""Characters of a text that becomes an event."""
_CLOCK_S = 100_000_000
"""Seconds: later times count from 1970."""
_SINCE_1970 = {0: 1_000_000_000, -3: 10**12, -6: 10**15, -9: 10**18}
"""The least number that counts from 1970 in a unit, in the year 2001, by its power of ten."""
_SHUFFLED, _FEW = 0.05, 64
"""Share of rows that go back in time where a table is out of order; few rows may be events."""
_ROUNDING = 1e-6
"""Ticks by which a time of ours may differ from its tick."""
_RATE_KEYS = (
    "rate", "rate_hz", "sampling_rate", "sample_rate", "sampling_frequency", "samplerate", "fs",
    "sfreq", "fps",
)  # fmt: skip
_PROGRAMS = ("hapfmt", "pandas", "PANDAS_ATTRS", "huggingface", "ARROW:schema")
"""Keys under which programs describe the columns to themselves."""
TEXT_KEYS = ("quantity", "axis", "group", "body_site", "device")


def arrow(extra: str = "arrow") -> Any:
    """The package pyarrow; MissingExtraError without it."""
    try:
        import pyarrow
    except ImportError:
        raise MissingExtraError("pyarrow", extra) from None
    return pyarrow


@contextmanager
def arrow_errors(what: str) -> Iterator[None]:
    """Turns the exceptions of pyarrow into ours. It raises OSError for malformed files too, then
    without a number."""
    import pyarrow

    try:
        with refusing(what, pyarrow.ArrowException, RecursionError, NotImplementedError):
            yield
    except OSError as error:
        if isinstance(error, HapfmtError) or error.errno is not None:
            raise
        reason = str(error).partition("\n")[0]
        raise ParameterError(f"{what}: {reason}") from error


def checked_schema(schema: Any) -> Any:
    """The schema, once all of its names have been decoded; pyarrow does that when they are used."""
    todo = list(schema)
    while todo:
        field = todo.pop()
        if not isinstance(field.name, str):
            raise ParameterError("a column has no name")
        type_ = _plain_type(field.type)
        todo += [type_.field(place) for place in range(type_.num_fields)]
    return schema


class Container(Protocol):
    """A file of columns. ``batches`` reads columns by name; a batch holds at least these."""

    schema: Any

    @property
    def row_count(self) -> int: ...

    def batches(self, columns: Sequence[str], rows: int) -> Iterator[Any]: ...

    def may_lack(self, column: str) -> bool:
        """Whether values of the column may be missing."""
        ...


class Cells(NamedTuple):
    """Values, and the places without one; ``missing`` None: all are there."""

    values: NDArray[Any]
    missing: NDArray[np.bool_] | None


@dataclass(frozen=True)
class Leaf:
    """Numbers in a column: ``fields`` lead to them through structures, ``shape`` is that of the
    lists they lie in."""

    column: str
    fields: tuple[str, ...]
    shape: tuple[int, ...]
    type: Any
    metadata: Mapping[str, str]

    @property
    def name(self) -> str:
        return ".".join((self.column, *self.fields))

    @property
    def count(self) -> int:
        return prod(self.shape)

    @property
    def is_float(self) -> bool:
        return self.dtype.kind == "f"

    @property
    def dtype(self) -> np.dtype[Any]:
        """The type of the numbers in the file."""
        found: np.dtype[Any] = np.dtype(self.type.to_pandas_dtype())
        return found

    def split(self, batch: Any) -> list[Cells]:
        """The values of a batch, place by place."""
        wide, lacking = self.wide(batch)
        found = []
        for number in range(self.count):
            own, lacks = wide[:, number], lacking[:, number]
            if not lacks.any():
                found.append(Cells(own, None))
            elif self.is_float:
                found.append(Cells(np.where(lacks, own.dtype.type(np.nan), own), lacks))
            else:
                found.append(Cells(own, lacks))
        return found

    def wide(self, batch: Any) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """[rows, places] of a batch, and where values are missing."""
        import pyarrow as pa

        rows = batch.num_rows
        array = batch.column(batch.schema.get_field_index(self.column))
        for name in self.fields:
            array = _storage(array)
            array = array.flatten()[array.type.get_field_index(name)]
        present = np.ones(rows, bool)
        for width in self.shape:
            array = _storage(array)
            known = np.asarray(array.is_valid())
            sizes = array.value_lengths() if not pa.types.is_fixed_size_list(array.type) else None
            if sizes is not None and not (np.asarray(sizes.drop_null()) == width).all():
                raise ParameterError(
                    f"column {self.name!r} holds lists of several lengths, not only of {width}"
                )
            array = array.flatten()
            places = np.flatnonzero(present)
            present[places[~known]] = False
            present = np.repeat(present, width)
        values, missing = _numbers(_storage(array))
        wide = np.zeros(present.size, values.dtype)
        wide[present] = values
        lacking = ~present
        if missing is not None:
            lacking[present] = missing
        return wide.reshape(rows, self.count), lacking.reshape(rows, self.count)


def _storage(array: Any) -> Any:
    """Without the dressing of an extension type or a dictionary."""
    import pyarrow as pa

    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    if pa.types.is_dictionary(array.type):
        array = array.dictionary_decode()
    return array


def _plain_type(type_: Any) -> Any:
    import pyarrow as pa

    if isinstance(type_, pa.BaseExtensionType):
        type_ = type_.storage_type
    if pa.types.is_dictionary(type_):
        type_ = type_.value_type
    return type_


def _numbers(array: Any) -> Cells:
    import pyarrow

    if not array.null_count:
        return Cells(array.to_numpy(zero_copy_only=False), None)
    missing = np.asarray(array.is_null())
    zero = False if array.type == pyarrow.bool_() else 0
    return Cells(array.fill_null(zero).to_numpy(zero_copy_only=False), missing)


def is_number(type_: Any) -> bool:
    import pyarrow as pa

    return bool(
        pa.types.is_integer(type_) or pa.types.is_floating(type_) or pa.types.is_boolean(type_)
    )


def is_text(type_: Any) -> bool:
    import pyarrow as pa

    type_ = _plain_type(type_)
    return bool(pa.types.is_string(type_) or pa.types.is_large_string(type_) or is_view(type_))


def is_view(type_: Any) -> bool:
    """Texts as Polars writes them; pyarrow computes less with them."""
    import pyarrow as pa

    return bool(type_ == pa.string_view())


def texts_of(metadata: Any) -> dict[str, str]:
    """Metadata of a schema or a field as texts."""
    return {
        key.decode("utf-8", "replace"): value.decode("utf-8", "replace")
        for key, value in (metadata or {}).items()
    }


class Columns:
    """The columns of a file, sorted by what they hold."""

    def __init__(self, container: Container, *, only: Sequence[str] | None = None) -> None:
        self.container = container
        self.leaves: list[Leaf] = []
        self.texts: list[str] = []
        self.notes: list[str] = []
        names = [field.name for field in container.schema]
        twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
        if twice:
            raise ParameterError(
                f"several columns are called {twice[0]!r}; give each a name of its own"
            )
        for field in container.schema:
            if only is None or field.name in only:
                self._add(field, field.type, field.name, (), (), texts_of(field.metadata))
        if sum(leaf.count for leaf in self.leaves) > CHANNEL_LIMIT:
            raise LimitError(
                f"the columns hold {sum(leaf.count for leaf in self.leaves)} channels, more than "
                f"{CHANNEL_LIMIT}; select a part (select=)"
            )

    def _add(
        self,
        field: Any,
        type_: Any,
        column: str,
        fields: tuple[str, ...],
        shape: tuple[int, ...],
        metadata: Mapping[str, str],
    ) -> None:
        import pyarrow as pa

        name = ".".join((column, *fields))
        type_ = _plain_type(type_)
        if len(fields) + len(shape) > _DEPTH:
            self.notes.append(
                f"column {name!r} is not read: its type has more than {_DEPTH} levels"
            )
        elif is_number(type_):
            self.leaves.append(Leaf(column, fields, shape, type_, metadata))
        elif pa.types.is_struct(type_) and not shape:
            for place in range(type_.num_fields):
                own = type_.field(place)
                if type_.get_field_index(own.name) < 0:
                    self.notes.append(f"column {name!r} has several fields {own.name!r}")
                    continue
                inner = {**metadata, **texts_of(own.metadata)}
                self._add(own, own.type, column, (*fields, own.name), shape, inner)
        elif (width := self._width(type_, column, fields, shape)) is not None:
            if width == 0:
                self.notes.append(f"column {name!r} is not read: its lists are empty")
            elif width * prod(shape) > WIDTH:
                self.notes.append(f"column {name!r} is not read: its lists are longer than {WIDTH}")
            else:
                inner_type = type_.value_type
                self._add(field, inner_type, column, fields, (*shape, width), metadata)
        elif is_text(type_) and not fields and not shape:
            self.texts.append(column)
        else:
            self.notes.append(f"column {name!r} ({short_type(type_)}) is not read")

    def _width(
        self, type_: Any, column: str, fields: tuple[str, ...], shape: tuple[int, ...]
    ) -> int | None:
        """The length of the lists; None for any other type, and for lists of varying length."""
        import pyarrow as pa

        if pa.types.is_fixed_size_list(type_):
            return int(type_.list_size)
        if not (pa.types.is_list(type_) or pa.types.is_large_list(type_)):
            return None
        for batch in self.container.batches([column], 256):
            array = batch.column(batch.schema.get_field_index(column))
            for name in fields:
                array = _storage(array)
                array = array.flatten()[array.type.get_field_index(name)]
            for _ in shape:
                array = _storage(array).flatten()
            sizes = np.unique(np.asarray(_storage(array).value_lengths().drop_null()))
            if sizes.size:
                return int(sizes[0]) if sizes.size == 1 else None
        return 0


def short_type(type_: Any) -> str:
    text = str(type_)
    return text if len(text) <= 40 else f"{text[:37]}..."


def chosen(columns: Columns, select: Sequence[str]) -> list[Leaf]:
    """The leaves that names or patterns select; all where there are none."""
    if not select:
        return columns.leaves
    names = [leaf.name for leaf in columns.leaves]
    known = [*dict.fromkeys([*names, *(leaf.column for leaf in columns.leaves)])]
    wanted: set[str] = set()
    for each in select:
        found = [each] if each in known else [known[i] for i in matching(each, known)]
        if not found:
            raise ParameterError(unknown("column", each, known))
        wanted.update(found)
    return [leaf for leaf in columns.leaves if leaf.name in wanted or leaf.column in wanted]


class Part(NamedTuple):
    """One channel of a file: a place of a leaf. ``restored``: physical values become counts."""

    leaf: int
    place: int
    column: ImportColumn
    restored: Calibration | None


def parts_of(
    leaves: Sequence[Leaf],
    notes: list[str],
    describe: Callable[[Leaf, int], ImportColumn] | None = None,
) -> list[Part]:
    """The channels that leaves give, with what the metadata of their fields says."""
    found = []
    for number, leaf in enumerate(leaves):
        own = own_json(leaf.metadata.get("hapfmt"), f"the metadata of column {leaf.name!r}")
        for cell in range(leaf.count):
            column = describe(leaf, cell) if describe else described(leaf, cell, notes)
            found.append(_part(number, cell, leaf, column, own, notes))
    return found


def described(leaf: Leaf, place: int, notes: list[str]) -> ImportColumn:
    """Label, unit and texts by the name of a column and its metadata."""
    about = leaf.metadata
    label, unit = split_name(leaf.name)
    label = about.get("label", label)
    unit = next((about[key] for key in ("unit", "units") if key in about), unit)
    if leaf.shape:
        label = ".".join([label, *map(str, np.unravel_index(place, leaf.shape))])
    code = unit_of(unit, label, notes)
    texts = {key: about[key] for key in TEXT_KEYS if key in about}
    source = unit if unit not in ("", code) else ""
    return replace(ImportColumn(label, code, source_unit=source), **texts)  # type: ignore[arg-type]


def _part(
    number: int,
    place: int,
    leaf: Leaf,
    column: ImportColumn,
    own: Mapping[str, Any],
    notes: list[str],
) -> Part:
    dtype = leaf.dtype
    if own:
        with refusing(f"the metadata of column {leaf.name!r}"):
            kept = np.dtype(str(own.get("dtype", dtype)))
            calibration = Calibration(*own["calibration"]) if "calibration" in own else None
            lsb = None if own.get("lsb") is None else float(own["lsb"])
        fits = kept.kind in ("iu" if calibration else "iuf") and kept.itemsize <= 8
        if not fits or (calibration is None and kept != dtype):
            raise ParameterError(f"the metadata of column {leaf.name!r} names the dtype {kept}")
        column = replace(column, calibration=calibration, dtype=kept, lsb=lsb)
        return Part(number, place, column, calibration if leaf.is_float else None)
    if dtype.kind == "b" or (dtype.kind in "iu" and dtype.itemsize < 4) or dtype == np.int32:
        calibration = _scale(leaf, notes) or Calibration()
        column = replace(column, calibration=calibration, dtype=np.dtype(np.int32))
        return Part(number, place, column, None)
    kept = np.dtype(np.uint64) if dtype.kind == "u" else dtype
    if any(key in leaf.metadata for key in ("scale_factor", "add_offset")):
        notes.append(f"the scale of column {leaf.name!r} ({dtype}) is not applied")
    return Part(number, place, replace(column, dtype=kept), None)


def _scale(leaf: Leaf, notes: list[str]) -> Calibration | None:
    """The scale in the metadata of a field: value = count * scale_factor + add_offset."""
    texts = [leaf.metadata.get(key, "").strip() for key in ("scale_factor", "add_offset")]
    if not any(texts):
        return None
    try:
        if any(len(text) > 60 or "e" in text.lower() for text in texts):
            raise ValueError
        step, zero = Fraction(texts[0] or 1), Fraction(texts[1] or 0)
        d = lcm(step.denominator, zero.denominator)
        made = Calibration(int(step * d), int(zero * d), d)
        if not made.covers(-(1 << 31), (1 << 31) - 1):
            raise ValueError
    except (ValueError, ZeroDivisionError, ParameterError):
        notes.append(f"the scale of column {leaf.name!r} is not applied: no exact calibration")
        return None
    return made


def memory_check(size: int, what: str, max_memory: int) -> None:
    if size > max_memory:
        raise LimitError(
            f"{what} take {size} bytes, more than the {max_memory} allowed; allow more "
            "(max_memory=) or select a part (select=)"
        )


def import_of_columns(
    container: Container,
    parts: Sequence[Part],
    leaves: Sequence[Leaf],
    rate: Fraction,
    ticks: NDArray[np.int64] | None,
    start_tick: int,
    options: ReadOptions,
    *,
    name: str,
    kind: str = "",
    stamps: NDArray[np.int64] | None = None,
) -> tuple[tuple[ImportTable, ...], Callable[[], Iterator[ImportBlock]]]:
    """The tables of channels, and their values. ``ticks`` are those of the rows, less
    ``start_tick``. ``stamps``: a channel more, with the time stamps in ns from their ticks.

    Values that lack among integers give tables of their own, since only floats can be NaN.
    """
    rows = container.row_count
    known = _known(container, parts, leaves, options)
    groups: list[tuple[list[Part], NDArray[np.bool_] | None]] = []
    for number, part in enumerate(parts):
        mask = known.get(number)
        same = bool(groups) and (
            groups[-1][1] is None
            if mask is None
            else (before := groups[-1][1]) is not None and np.array_equal(before, mask)
        )
        if same:
            groups[-1][0].append(part)
        else:
            groups.append(([part], mask))
    tables = []
    for own, mask in groups:
        at, first = ticks, start_tick
        if mask is not None:
            places = np.flatnonzero(mask)
            at = places if ticks is None else ticks[places]
        if at is not None and at.size and int(at[-1]) + 1 == at.size:
            at = None
        tables.append(
            ImportTable(
                name, tuple(part.column for part in own), rate,
                rows if mask is None else int(np.count_nonzero(mask)), at, first, kind,
            )
        )  # fmt: skip
    if stamps is not None:
        column = ImportColumn(stamp_label(name, 1), "ns", dtype=np.dtype(np.int64))
        tables.append(ImportTable(name, (column,), rate, rows, ticks, start_tick, kind))

    def blocks() -> Iterator[ImportBlock]:
        done, filled = 0, [0] * len(groups)
        for batch in read_batches(container, leaves):
            size = batch.num_rows
            with arrow_errors("the table cannot be read"):
                split = [leaf.split(batch) for leaf in leaves]
            for number, (own, mask) in enumerate(groups):
                wanted = None if mask is None else mask[done : done + size]
                values = [
                    _converted(part, leaves[part.leaf], split[part.leaf][part.place], wanted)
                    for part in own
                ]
                yield ImportBlock(number, filled[number], values)
                filled[number] += len(values[0])
            if stamps is not None:
                yield ImportBlock(len(groups), done, [stamps[done : done + size]])
            done += size
        if done != rows:
            raise ParameterError(f"the table ends after {done} of {rows} rows")

    return tuple(tables), blocks


def read_batches(container: Container, leaves: Sequence[Leaf]) -> Iterator[Any]:
    names = [*dict.fromkeys(leaf.column for leaf in leaves)]
    width = sum(leaf.count * 8 for leaf in leaves)
    return container.batches(names, max(min(ROWS, BATCH_SIZE // max(width, 1)), 1))


def _known(
    container: Container, parts: Sequence[Part], leaves: Sequence[Leaf], options: ReadOptions
) -> dict[int, NDArray[np.bool_]]:
    """The rows in which channels of integers have values, where not in all."""
    doubtful = [
        number
        for number, part in enumerate(parts)
        if part.column.dtype.kind != "f" and container.may_lack(leaves[part.leaf].column)
    ]
    if not doubtful:
        return {}
    memory_check(len(doubtful) * container.row_count, "the marks of missing values",
                 options.max_memory)  # fmt: skip
    masks = {number: np.ones(container.row_count, bool) for number in doubtful}
    own = [*dict.fromkeys(parts[number].leaf for number in doubtful)]
    done = 0
    for batch in read_batches(container, [leaves[each] for each in own]):
        with arrow_errors("the table cannot be read"):
            split = {each: leaves[each].split(batch) for each in own}
        for number in doubtful:
            missing = split[parts[number].leaf][parts[number].place].missing
            if missing is not None:
                masks[number][done : done + batch.num_rows] = ~missing
        done += batch.num_rows
    return {number: mask for number, mask in masks.items() if not mask.all()}


def _converted(
    part: Part, leaf: Leaf, values: Cells, wanted: NDArray[np.bool_] | None
) -> NDArray[Any]:
    x, missing = values
    if part.column.dtype.kind != "f":
        if missing is not None and (wanted is None or (missing & wanted).any()):
            raise ParameterError(
                f"column {leaf.name!r} has empty cells, and its statistics say that it has none"
            )
        if wanted is not None:
            x = x[wanted]
    if part.restored is None:
        return np.ascontiguousarray(x.astype(part.column.dtype, copy=False))
    counts = restored_counts(x, part.restored, part.column.dtype)
    if counts is None:
        raise ParameterError(
            f"column {leaf.name!r} holds values that its calibration does not give; remove the key "
            "'hapfmt' from the metadata of the field to read them as they are"
        )
    return counts


# Times


class Stamps(NamedTuple):
    """A column of times in ns. ``absolute``: they count from 1970."""

    column: str
    ns: NDArray[np.int64]
    absolute: bool


def time_column(columns: Columns, clock: str | None) -> tuple[str | None, list[str]]:
    """The column that holds the times of the rows, and the others of that kind."""
    import pyarrow as pa

    schema = columns.container.schema
    types = {field.name: _plain_type(field.type) for field in schema}
    temporal = [
        name
        for name, type_ in types.items()
        if pa.types.is_timestamp(type_) or pa.types.is_duration(type_)
    ]
    numeric = {leaf.column for leaf in columns.leaves if not leaf.fields and not leaf.shape}
    if clock is not None:
        able = [*temporal, *(name for name in types if name in numeric)]
        if clock not in able:
            raise ParameterError(unknown("column of times", clock, able))
        return clock, [name for name in temporal if name != clock]
    index = [name for name in _pandas_index(schema) if name in types]
    times = [
        name
        for name in index
        if name in temporal
        or (name in numeric and (time_name(name) or pa.types.is_floating(types[name])))
    ]
    times += temporal
    times += [name for name in types if name in numeric and time_name(name.strip()) is not None]
    found = next(iter(times), None)
    return found, [name for name in temporal if name != found]


def _pandas(schema: Any) -> dict[str, Any]:
    text = texts_of(schema.metadata).get("pandas")
    try:
        found = json.loads(text) if text else {}
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _pandas_index(schema: Any) -> list[str]:
    found = _pandas(schema).get("index_columns", [])
    return [name for name in found if isinstance(name, str)] if isinstance(found, list) else []


def stamps_of(
    container: Container, column: str, options: ReadOptions, notes: list[str]
) -> Stamps | str:
    """The times of a column in ns, or the reason why they are none."""
    import pyarrow as pa

    memory_check(8 * container.row_count, "the times", options.max_memory)
    field = container.schema.field(column)
    type_, about = _plain_type(field.type), texts_of(field.metadata)
    arrays = []
    for batch in container.batches([column], ROWS):
        with arrow_errors("the times cannot be read"):
            array = _storage(batch.column(batch.schema.get_field_index(column)))
            if array.null_count:
                raise ParameterError(f"the column of times, {column!r}, has empty cells")
            if not is_number(type_):
                array = array.cast(pa.int64())
            arrays.append(array.to_numpy(zero_copy_only=False))
    x = np.concatenate(arrays) if arrays else np.empty(0, np.int64)
    if pa.types.is_timestamp(type_) or pa.types.is_duration(type_):
        exponent: int | None = {"s": 0, "ms": -3, "us": -6, "ns": -9}[type_.unit]
        absolute = bool(pa.types.is_timestamp(type_))
        return Stamps(column, _whole_ns(x, exponent or 0, column), absolute)
    named = time_name(column.strip())
    unit = about.get("unit", about.get("units", split_name(column)[1]))
    exponent = TIME_UNITS.get(unit)
    if exponent is None and named is not None and named.unit is not None:
        exponent = named.exponent
    if exponent is None and "_" in column:
        exponent = TIME_UNITS.get(column.rpartition("_")[2])
    first = abs(float(x[0])) if x.size else 0.0
    if exponent is None:
        for power, least in _SINCE_1970.items():
            if least <= first < 10 * least:
                exponent = power
                if power:
                    notes.append(
                        f"the times in {column!r} are taken for 1e{power} s since 1970, by their "
                        "size"
                    )
    if exponent is None and x.dtype.kind != "f":
        return f"column {column!r} holds integers without a unit; name it '{column} [ms]' or so"
    ns = _whole_ns(x, exponent or 0, column)
    return Stamps(column, ns, bool(ns.size and ns[0] >= _CLOCK_S * 10**9))


def _whole_ns(x: NDArray[Any], exponent: int, column: str) -> NDArray[np.int64]:
    scale = 10 ** (9 + exponent)
    with np.errstate(all="ignore"):
        rough = x.astype(np.float64) * float(scale)
    if not (np.abs(rough) < 2.0**62).all():
        raise ParameterError(f"column {column!r} holds times that are not finite, or too large")
    whole = np.rint(rough).astype(np.int64) if x.dtype.kind == "f" else x.astype(np.int64) * scale
    return np.asarray(whole)


class Grid(NamedTuple):
    """Where the rows are. ``placed`` None: they are ``own`` ticks, or one tick apart."""

    rate: Fraction
    ticks: NDArray[np.int64] | None
    start_tick: int
    epoch_ns: int | None
    placed: Placed | None = None


def grid_of(
    container: Container, stamps: Stamps, options: ReadOptions, found: Fraction | None
) -> Grid | None:
    """Places the rows by their times; None where they have no rate."""
    name = f"column {stamps.column!r}"
    back = np.count_nonzero(np.diff(stamps.ns) < 0)
    if back > max(_SHUFFLED * stamps.ns.size, 1) and stamps.ns.size > _FEW:
        raise ParameterError(
            f"{name}: the times of {back} rows are before the time of the row above; sort the "
            "table by this column"
        )
    if (row := restart(stamps.ns)) is not None:
        cause = _changing(container, row)
        by = f"; {cause!r} changes there" if cause else ""
        raise ParameterError(
            f"{name}: the times start again after row {row + 1}{by}. The table holds several "
            "recordings; store each as a file of its own"
        )
    placed = place(stamps.ns, name=name, rate=options.rate or found)
    if placed is None:
        return None
    start = rdiv(placed.start_ns * placed.rate.numerator, placed.rate.denominator * 10**9)
    if stamps.absolute:
        return Grid(placed.rate, placed.ticks, 0, placed.start_ns, placed)
    if not 0 <= start < TICK_LIMIT - int(placed.ticks[-1]):
        start = 0
    return Grid(placed.rate, placed.ticks, start, None, placed)


def _changing(container: Container, row: int) -> str | None:
    """A column of texts or integers that changes after a row, and neither before nor after it."""
    import pyarrow as pa

    names = [
        field.name
        for field in container.schema
        if is_text(field.type) or pa.types.is_integer(_plain_type(field.type))
    ]
    for name in names:
        cells: list[Any] = []
        first = 0
        for batch in container.batches([name], 1 << 12):
            inside = range(max(row - 1 - first, 0), min(row + 3 - first, batch.num_rows))
            column = batch.column(batch.schema.get_field_index(name))
            cells += [column[place].as_py() for place in inside]
            first += batch.num_rows
            if first > row + 2:
                break
        if len(cells) == 4 and cells[0] == cells[1] != cells[2] == cells[3]:
            return str(name)
    return None


def own_grid(seconds: NDArray[np.float64], rate: Fraction) -> Grid:
    """Rows of a file of ours: each time is the double nearest to that of a tick."""
    with np.errstate(all="ignore"):
        wanted = seconds * float(rate.numerator) / float(rate.denominator)
        ticks = np.rint(wanted)
        near = np.abs(wanted - ticks) <= np.maximum(_ROUNDING, ticks * 2.0**-51)
    if not (near & (ticks >= 0) & (ticks < TICK_LIMIT)).all() or (np.diff(ticks) < 1).any():
        raise ParameterError(f"the column 'time' holds times that are not ticks of {rate} Hz")
    whole = ticks.astype(np.int64)
    start = int(whole[0]) if whole.size else 0
    return Grid(rate, whole - start, start, None)


# Texts


def text_events(
    container: Container,
    column: str,
    seconds: Callable[[int], Fraction],
    tick: Fraction,
    notes: list[str],
    layer: str | None = None,
) -> list[Event]:
    """An event for each run of one text; where they are too many, a note. A row takes ``tick``
    seconds."""
    runs: list[tuple[int, str | None]] = []
    rows = 0
    for batch in container.batches([column], 1 << 12):
        with arrow_errors(f"column {column!r} cannot be read"):
            encoded = _encoded(batch.column(batch.schema.get_field_index(column)))
            codes = np.asarray(encoded.indices.cast("int64").fill_null(-1))
            edges = np.flatnonzero(np.diff(codes, prepend=-2))
            for edge in edges.tolist():
                code = int(codes[edge])
                text = None if code < 0 else encoded.dictionary[code].as_py()
                if not runs or runs[-1][1] != text:
                    runs.append((rows + edge, text))
                if len(runs) > EVENTS or (text is not None and len(text) > _TEXT_SIZE):
                    notes.append(
                        f"column {column!r} of texts is not read: it has more than {EVENTS} "
                        f"changes, or texts longer than {_TEXT_SIZE} characters"
                    )
                    return []
        rows += batch.num_rows
    ends = [*(row for row, _ in runs), rows][1:]
    return [
        Event(seconds(row), text, seconds(end - 1) + tick - seconds(row), layer=layer or column)
        for (row, text), end in zip(runs, ends, strict=True)
        if text
    ]


def _encoded(array: Any) -> Any:
    """Texts as numbers of texts."""
    import pyarrow as pa

    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    if pa.types.is_dictionary(array.type):
        return array
    return (array.cast(pa.large_string()) if is_view(array.type) else array).dictionary_encode()


# Reading a file


def read_table(container: Container, options: ReadOptions, kind: str) -> Import:
    """The Import of a Parquet or Feather file."""
    columns = Columns(container)
    notes: list[str] = []
    about = texts_of(container.schema.metadata)
    own = own_json(about.get("hapfmt"), "the metadata of the file")
    if own and own.get("version") != 1:
        raise ParameterError("the file was written by a later version of hapfmt")
    if own and options.clock not in (None, "time"):
        raise ParameterError(unknown("column of times", options.clock, ["time"]))
    column, others = ("time", []) if own else time_column(columns, options.clock)
    found = _rate_in(about, columns.leaves, own)
    stamps: Stamps | str | None = None
    if column is not None and not own:
        stamps = stamps_of(container, column, options, notes)
        if isinstance(stamps, str):
            if options.clock is not None:
                raise ParameterError(stamps)
            notes.append(f"{stamps}; it became a channel")
            column = None
    indexes = [name for name in _pandas_index(container.schema) if name != column]
    leaves = [
        leaf
        for leaf in chosen(columns, options.select)
        if leaf.column != column and not (leaf.column in indexes and _is_unnamed(leaf.column))
    ]
    if not own and options.clock is None:
        notes += [
            f"column {leaf.name!r} is a channel; its name says that it may hold times"
            for leaf in leaves
            if not leaf.shape and _has_time_unit(leaf.name)
        ]
    left = [leaf.column for leaf in columns.leaves if leaf.column in indexes]
    notes += [f"the index {name!r} of pandas is not read" for name in left if _is_unnamed(name)]
    notes += [
        note
        for note in columns.notes
        if not any(note.startswith(f"column {name!r} (") for name in (column, *others))
    ]
    parts = parts_of(leaves, notes)
    if not parts:
        raise ParameterError("the file has no column of numbers")
    rate, ticks, start_tick, epoch_ns = Fraction(1), None, 0, None
    grid: Grid | None = None
    if own and found is not None:
        grid = own_grid(seconds_in(container, "time", options), found)
        grid = grid._replace(rate=choose_rate(options.rate, found, notes))
    elif isinstance(stamps, Stamps) and stamps.ns.size:
        grid = grid_of(container, stamps, options, found)
        if grid is None:
            return _as_events(container, parts, leaves, stamps, notes)
        assert grid.placed is not None
        notes += grid.placed.notes
    if grid is not None:
        rate, ticks, start_tick, epoch_ns, _ = grid
    else:
        try:
            rate = choose_rate(options.rate, found, notes)
        except ParameterError as error:
            reason = f"; {stamps}" if isinstance(stamps, str) else ""
            raise ParameterError(f"{error}{reason}") from None
    kept = None
    if options.keep_stamps:
        if not isinstance(stamps, Stamps) or grid is None or grid.placed is None or own:
            raise ParameterError("the file has no column of times to keep")
        zero = grid.epoch_ns if grid.epoch_ns is not None else 0
        kept = stamp_channel(grid.placed, stamps.ns, zero, start_tick)
    tables, blocks = import_of_columns(
        container, parts, leaves, rate, ticks, start_tick, options, name="rows", kind=kind,
        stamps=kept,
    )  # fmt: skip

    def seconds(row: int) -> Fraction:
        return (start_tick + (row if ticks is None else int(ticks[row]))) / rate

    events: list[Event] = []
    if not options.select:
        for name in columns.texts:
            events += text_events(container, name, seconds, 1 / rate, notes)
    clocks: list[ClockObservation] = []
    for name in others:
        clocks += _observed(container, name, grid, start_tick, options, notes)
    made = Import(
        tables, blocks, epoch_ns, notes=tuple(dict.fromkeys(notes)), events=tuple(events),
        clocks=tuple(clocks),
    )  # fmt: skip
    if own:
        return with_own(made, own)
    made = replace(made, metadata=_metadata_in(about))
    return _with_pandas(made, container.schema, stamps if isinstance(stamps, Stamps) else None)


def _metadata_in(about: Mapping[str, str]) -> dict[str, Any]:
    """What others wrote into the metadata of the file, but for what is read already."""
    read = {*_RATE_KEYS, *_PROGRAMS, "notes"}
    return {key: text for key, text in about.items() if key not in read}


def _observed(
    container: Container,
    column: str,
    grid: Grid | None,
    start_tick: int,
    options: ReadOptions,
    notes: list[str],
) -> list[ClockObservation]:
    """What the clock of another column of times showed."""
    if grid is not None and grid.placed is not None:
        try:
            seen = stamps_of(container, column, options, notes)
        except ParameterError as error:
            notes.append(f"the times in column {column!r} are not read: {error}")
            return []
        if isinstance(seen, Stamps):
            found = observations(grid.placed, seen.ns, column, start_tick, 0)
            return [ClockObservation(*each) for each in found]
    notes.append(f"the times in column {column!r} are not read")
    return []


def _has_time_unit(name: str) -> bool:
    """Whether a name such as device_us or "clock [ms]" ends in a unit of time."""
    last = name.rpartition("_")[2]
    return split_name(name)[1] in TIME_UNITS or (last != name and last in ("ms", "us", "ns"))


def _is_unnamed(name: str) -> bool:
    return name.startswith("__index_level_")


def seconds_in(container: Container, column: str, options: ReadOptions) -> NDArray[np.float64]:
    """The times of our own file, as they are written."""
    memory_check(16 * container.row_count, "the times", options.max_memory)
    if not any(field.name == column and is_number(field.type) for field in container.schema):
        raise ParameterError(f"the file has no column {column!r} of numbers")
    arrays = [np.empty(0)]
    for batch in container.batches([column], ROWS):
        with arrow_errors("the times cannot be read"):
            array = batch.column(batch.schema.get_field_index(column))
            arrays.append(array.to_numpy(zero_copy_only=False).astype(np.float64))
    return np.concatenate(arrays)


def _rate_in(
    about: Mapping[str, str], leaves: Sequence[Leaf], own: Mapping[str, Any]
) -> Fraction | None:
    """The rate that the metadata of the file or of its fields gives."""
    if own:
        return rate_from(str(own.get("rate", "")))
    for key in _RATE_KEYS:
        if key in about:
            return rate_from(about[key])
    rates = {
        rate_from(leaf.metadata[key])
        for leaf in leaves
        for key in _RATE_KEYS
        if key in leaf.metadata
    }
    if len(rates) > 1:
        listed = ", ".join(f"{rate} Hz" for rate in sorted(rates)[:5])
        raise ParameterError(
            f"the columns have several rates ({listed}); store each rate as a file of its own"
        )
    return rates.pop() if rates else None


def _with_pandas(made: Import, schema: Any, stamps: Stamps | None) -> Import:
    """The attributes of a DataFrame: units and epoch, as ``to_pandas`` puts them there, and what
    else the user noted."""
    about = texts_of(schema.metadata)
    try:
        given = json.loads(about.get("PANDAS_ATTRS", "{}"), parse_constant=lambda _: None)
    except (ValueError, RecursionError):
        return made
    found = given if isinstance(given, dict) else {}
    epoch = found.get("epoch_ns")
    if made.epoch_ns is None and isinstance(epoch, int) and abs(epoch) < 1 << 63 and stamps:
        made = replace(made, epoch_ns=epoch)
    read = {"units", "notes", *_RATE_KEYS, *(() if made.epoch_ns is None else ("epoch_ns",))}
    more = {key: x for key, x in found.items() if key not in read and x is not None}
    made = replace(made, metadata={**made.metadata, **more})
    units = found.get("units")
    if not isinstance(units, dict):
        return made
    notes: list[str] = []

    def unit(column: ImportColumn) -> ImportColumn:
        text = units.get(column.label)
        if not isinstance(text, str) or column.unit != "1":
            return column
        code = unit_of(text, column.label, notes)
        return replace(column, unit=code, source_unit=text if text != code else "")

    tables = tuple(replace(table, columns=tuple(map(unit, table.columns))) for table in made.tables)
    return replace(made, tables=tables, notes=(*made.notes, *notes))


def _as_events(
    container: Container,
    parts: Sequence[Part],
    leaves: Sequence[Leaf],
    stamps: Stamps,
    notes: list[str],
) -> Import:
    """Rows without a rate: one event each, with the values as JSON."""
    if container.row_count > EVENTS:
        raise ParameterError(
            f"column {stamps.column!r} holds {container.row_count} times without a rate; give one "
            "(rate=) to move each row to the nearest tick"
        )
    order = np.argsort(stamps.ns, kind="stable")
    zero = int(stamps.ns.min()) if stamps.absolute or int(stamps.ns.min()) < 0 else 0
    rows: list[str] = []
    for batch in read_batches(container, leaves):
        split = [leaf.split(batch) for leaf in leaves]
        cells = [(part.column.label, split[part.leaf][part.place]) for part in parts]
        for row in range(batch.num_rows):
            found = {
                label: x.values[row].item()
                for label, x in cells
                if x.missing is None or not x.missing[row]
            }
            rows.append(json.dumps(found, ensure_ascii=False))
    events = [
        Event(Fraction(int(stamps.ns[row]) - zero, 10**9), rows[row], layer="rows")
        for row in order.tolist()
    ]
    notes = [*notes, f"the rows have no rate, so each became an event: {len(rows)}"]
    return Import(
        (),
        lambda: iter(()),
        zero if stamps.absolute else None,
        events=tuple(events),
        notes=tuple(notes),
    )


# Writing


class Sparse:
    """The samples of a channel by tick: values, and where there are none."""

    def __init__(self, channel: Channel, values: NDArray[Any]) -> None:
        self.dtype = values.dtype
        self._values = values
        self._spans = channel.coverage
        self._starts = [span.start for span in channel.coverage]
        self._places = [0, *accumulate(span.ticks for span in channel.coverage)]

    def between(self, first: int, last: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """[last - first] values, and True where one lacks."""
        out = np.zeros(last - first, self._values.dtype)
        missing = np.ones(last - first, bool)
        for number in range(max(bisect_right(self._starts, first) - 1, 0), len(self._spans)):
            span = self._spans[number]
            if span.start >= last:
                break
            a, b = max(span.start, first), min(span.stop, last)
            if a < b:
                at = self._places[number] + a - span.start
                out[a - first : b - first] = self._values[at : at + b - a]
                missing[a - first : b - first] = False
        return out, missing


def column_values(channel: Channel) -> tuple[NDArray[Any], bool]:
    """What a column holds: physical values, if the counts are known from them, else the counts.
    True where these have to be multiplied."""
    if channel.exact is not None:
        return channel.exact, False
    calibration = channel.calibration
    if calibration is None or calibration == Calibration():
        return channel.stored, False
    for first in range(0, channel.stored.size, 1 << 18):
        counts = channel.stored[first : first + (1 << 18)]
        back = restored_counts(calibration.physical(counts), calibration, counts.dtype)
        if back is None or not np.array_equal(back, counts):
            return channel.stored, True
    return calibration.physical(channel.stored), False


def filled_spans(recording: Recording) -> list[Span]:
    """Where any channel has samples."""
    spans: list[Span] = []
    for span in sorted(span for channel in recording.channels for span in channel.coverage):
        if spans and span.start <= spans[-1].stop:
            spans[-1] = Span(spans[-1].start, max(spans[-1].stop, span.stop))
        else:
            spans.append(span)
    return spans


def tables_of(
    recording: Recording, suffix: str, options: WriteOptions
) -> tuple[Any, Iterator[Any], list[str]]:
    """The schema, the batches and the notes of a table with a column for each channel.

    Rows in which no channel has a sample are left out; the column of times tells of them.
    """
    pa = arrow()
    rate = one_rate(recording, suffix)
    spans = filled_spans(recording)
    rows = sum(span.ticks for span in spans)
    cells = len(recording.channels) * rows - recording.sample_count
    if 8 * cells > options.max_memory:
        raise LimitError(
            f"the gaps take {8 * cells} bytes as empty cells of {suffix}, more than the "
            f"{options.max_memory} allowed; allow more (max_memory=) or write a part"
        )
    labels = [channel.label or f"ch{i + 1}" for i, channel in enumerate(recording.channels)]
    names = unique(["time", *labels], [])[1:]
    fields = [pa.field("time", pa.float64(), nullable=False, metadata={"unit": "s"})]
    sources: list[Sparse] = []
    scaled: list[str] = []
    for channel, name in zip(recording.channels, names, strict=True):
        values, counts = column_values(channel)
        if counts:
            scaled.append(name)
        sources.append(Sparse(channel, values))
        with arrow_errors(f"the label {channel.label!r}"):
            fields.append(
                pa.field(name, pa.from_numpy_dtype(values.dtype), metadata=_field_metadata(channel))
            )
    own = {"version": 1, "rate": str(rate), **own_members(recording)}
    with refusing("the metadata of the recording"):
        about = {"hapfmt": json.dumps(own, ensure_ascii=False), "rate_hz": str(float(rate))}
        schema = pa.schema(fields, metadata=about)

    def batches() -> Iterator[Any]:
        at_once = max(min(ROWS, BATCH_SIZE // (8 * len(fields))), 1)
        done = 0
        for span in spans:
            for first in range(span.start, span.stop, at_once):
                last = min(first + at_once, span.stop)
                arrays = [pa.array(seconds_of(first, last, rate))]
                for source in sources:
                    values, missing = source.between(first, last)
                    arrays.append(pa.array(values, mask=missing))
                yield pa.RecordBatch.from_arrays(arrays, schema=schema)
                done += last - first
                if options.progress:
                    options.progress(done, rows)

    notes = [f"column {name!r} holds counts; its metadata gives the calibration" for name in scaled]
    if any(channel.exact is not None for channel in recording.channels):
        notes.append(f"the grids of floating-point channels are not carried over to {suffix}")
    metadata = tuple(recording.metadata)
    return schema, batches(), notes + not_carried(recording, suffix, *CARRIED, *metadata)


def _field_metadata(channel: Channel) -> dict[str, str]:
    return {**channel_texts(channel), "hapfmt": json.dumps(channel_numbers(channel))}


def channel_texts(channel: Channel) -> dict[str, str]:
    about = {"label": channel.label, "unit": channel.unit}
    return about | {key: text for key in TEXT_KEYS if (text := getattr(channel, key))}


def channel_numbers(channel: Channel) -> dict[str, Any]:
    """What the values of a column need in order to become the samples of a channel again."""
    own: dict[str, Any] = {
        "dtype": str(channel.stored.dtype if channel.exact is None else channel.exact.dtype)
    }
    calibration = channel.calibration if channel.exact is None else None
    if calibration is not None:
        own["calibration"] = [calibration.a, calibration.b, calibration.d]
    if channel.lsb is not None:
        own["lsb"] = channel.lsb
    return own
