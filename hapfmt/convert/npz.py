""".npz <-> Recording: arrays by name in a zip file, never a pickle.

======================  =============================================================
``x``                   [channels, samples] or [samples], real; NaN is a gap
``rate``, ``rate_hz``   text "num/den", exact; number, its shortest decimal counts
``channel_names``       [channels] text
``unit``                text, one or [channels]
``lsb``                 step of the source's quantiser, one or [channels], NaN = none
``start_tick``          tick of the first sample, 0 if absent
``index``               [channels] positions in the recording
``source``              text, where the recording comes from
``events``              text, JSON: a list of objects with ``time``, ``text``, ``duration``,
                        ``channel`` and ``layer``, times as "num/den" in s
``clocks``              text, JSON: observations of other clocks, a list of objects with
                        ``clock``, ``channel``, ``tick``, ``time_ns`` and ``uncertainty_ns``
``clock_maps``          text, JSON: a list of objects with ``clock``, ``channel`` and
                        ``points``, a list of [tick, time_ns]
``t``                   [samples] true times in s: compared with the grid, not stored. Integers
                        may be ms, us or ns, which their size or their steps tell
======================  =============================================================

Where channels differ in rate, each rate is a group. Its keys end in __0, __1 ...

Archives from other programs are read too: ``fs`` or ``sampling_rate`` for the rate, ``time`` for
``t``. The times give the rate where no key does. Without ``x``, each channel is an array of one
dimension, or a single array of any name holds them all.
"""

from __future__ import annotations

import json
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from decimal import Decimal
from fractions import Fraction
from io import SEEK_END
from math import isinf, isnan, nan
from operator import itemgetter
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockMap, ClockObservation
from ..errors import LimitError, MovedTimesWarning, ParameterError
from ..files import Closing
from ..limits import TICK_LIMIT
from ..numbers import checked_rate
from ..recording import (
    Channel,
    Event,
    Recording,
    index_of_channel,
    refuse_transpose,
    spans_at,
    spans_of,
    unique,
)
from ..times import STEADY, TickGrid, TimeStamps, deviation_note, time_name, whole_ns
from .common import (
    CHANNEL_LIMIT,
    Dense,
    are_doubles,
    choose_rate,
    exact_doubles,
    not_carried,
    rate_from,
    refusing,
    unit_of,
)
from .formats import Destination, ReadOptions, Source, WriteOptions
from .npy import (
    doubles_2d,
    memory_of,
    read_array,
    read_header,
    stored_samples,
    write_array,
    write_dense,
)
from .timestamps import kept_stamps

T = TypeVar("T", Event, ClockObservation, ClockMap)
_KEY = re.compile(
    r"(x|rate|rate_hz|channel_names|unit|lsb|start_tick|index|t)(__(?:0|[1-9][0-9]{0,4}))?"
)
_ZIP_ERRORS = (
    zipfile.BadZipFile, zlib.error, struct.error, RuntimeError, NotImplementedError
)  # fmt: skip
_RATES = ("fs", "Fs", "sampling_rate", "sample_rate", "samplerate", "sfreq")
_TIMES = ("t", "time", "times", "timestamps")
_UNIX_S = (946_684_800, 4_102_444_800)
"""Times between the years 2000 and 2100 count from 1970."""
_COUNTED = (100, 100_000)
"""Integer times in steps from here on are microseconds, and nanoseconds."""
_GROUPS = 1000
"""Rates of a file."""
_DIRECTORY_SIZE = 1 << 21
"""Longest list of members in bytes, checked before it is read: 20 000 members at least."""
_MEMBERS = 10_000
LEVEL = 1
"""Of DEFLATE: level 6 takes six times as long and makes files a quarter smaller."""
_KEYS_NAMED = 8
"""A message lists this many keys and counts the others."""


def read(source: Source, options: ReadOptions) -> Recording:
    """A zip file of arrays with the keys above; NaN is a gap, other keys are noted."""
    rate = options.rate
    with _Archive(source.stream, options) as archive:
        matches = [match for key in archive.members if (match := _KEY.fullmatch(key)) is not None]
        # What follows the name in the keys x, x__0, x__1 ... of the groups.
        endings = [match[2] or "" for match in matches if match[1] == "x"]
        if "" in endings and len(endings) > 1:
            raise ParameterError("keys x and x__0 together; a file has one group, or numbered ones")
        if len(endings) > _GROUPS:
            raise LimitError(f"this .npz archive has {len(endings)} groups, more than {_GROUPS}")
        endings = sorted(endings, key=lambda ending: int(ending[2:] or 0)) or [""]
        if rate is not None and len(endings) > 1:
            raise ParameterError("the file holds several rates; they cannot be overridden by one")
        notes: list[str] = []
        found = [_channels(archive, ending, options, notes) for ending in endings]
        channels = [channel for group in found for channel in group.channels]
        positions = [p for ending in endings for p in archive.integers(f"index{ending}")]
        origin = archive.texts("source")
        events = archive.objects("events", Event)
        clocks = archive.objects("clocks", ClockObservation)
        clock_maps = archive.objects("clock_maps", ClockMap)
    if positions and sorted(positions) != list(range(len(channels))):
        raise ParameterError("the index keys do not give each channel a position of its own")
    placed = zip(positions or range(len(channels)), channels, strict=True)
    ordered = [channel for _, channel in sorted(placed, key=itemgetter(0))]
    ordered += [group.stamps for group in found if group.stamps is not None]
    names = unique([channel.label for channel in ordered], notes)
    if unread := sorted(key for key in archive.members if key not in archive.used):
        more = len(unread) - _KEYS_NAMED
        shown = ", ".join(map(repr, unread[:_KEYS_NAMED]))
        notes.append(f"keys not carried over: {shown}{f' and {more} more' if more > 0 else ''}")
    metadata = {"source": "; ".join(origin)} if origin else {}
    described = {**metadata, "notes": notes} if notes else metadata
    return Recording(
        tuple(
            channel if channel.label == name else replace(channel, label=name)
            for channel, name in zip(ordered, names, strict=True)
        ),
        metadata=described,
        events=tuple(events),
        clocks=tuple(clocks),
        clock_maps=tuple(clock_maps),
        epoch_ns=found[0].epoch_ns if len(found) == 1 else None,
    )


def _objects(recording: Recording) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """The keys that hold JSON, and their contents."""
    labels = [channel.label for channel in recording.channels]
    yield (
        "events",
        [
            {**vars(e), "time": str(e.time), "duration": str(e.duration),
             "channel": index_of_channel(e, labels)}
            for e in recording.events
        ],
    )  # fmt: skip
    yield "clocks", [asdict(seen) for seen in recording.clocks]
    yield "clock_maps", [asdict(one) for one in recording.clock_maps]


class _Archive(Closing):
    """The members of a zip file by key, and the memory that their arrays may still take."""

    def __init__(self, stream: BinaryIO, options: ReadOptions) -> None:
        # A zip file of very many members is refused before its list of them is read.
        end = stream.seek(0, SEEK_END)
        stream.seek(max(end - (1 << 16) - 22, 0))
        tail = stream.read()
        stream.seek(0)
        at = tail.rfind(b"PK\x05\x06")
        if at >= 0 and len(tail) >= at + 22:
            count, size = struct.unpack_from("<HI", tail, at + 10)
            if count > _MEMBERS or size > _DIRECTORY_SIZE:
                raise LimitError(f"this .npz archive has too many members: more than {_MEMBERS}")
        with refusing("this is not an .npz archive", *_ZIP_ERRORS):
            self._opened = zipfile.ZipFile(stream)
        self._memory_left, self.store = options.max_memory, options.store
        self.members = {
            info.filename.removesuffix(".npy"): info for info in self._opened.infolist()
        }
        self.used: set[str] = {"source", "events"}
        if len(self.members) > _MEMBERS:
            raise LimitError(f"this .npz archive has too many members: more than {_MEMBERS}")

    def close(self) -> None:
        self._opened.close()

    def shape(self, key: str) -> tuple[tuple[int, ...], str]:
        """Shape and kind of dtype of a key's array; no array is read."""
        with (
            refusing(f"key {key!r}", *_ZIP_ERRORS),
            self._opened.open(self.members[key]) as member,
        ):
            shape, _, dtype = read_header(member, f"key {key!r}")
        return shape, dtype.kind

    def array(self, key: str) -> NDArray[Any] | None:
        """The array of a key, None where it is absent."""
        info = self.members.get(key)
        if info is None:
            return None
        self.used.add(key)
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ParameterError(f"key {key!r} is compressed by a method that .npz does not use")
        with refusing(f"key {key!r}", *_ZIP_ERRORS), self._opened.open(info) as member:
            array = read_array(
                member, f"key {key!r}", max_memory=self._memory_left, store=self.store
            )
        self._memory_left -= memory_of(array.shape, array.dtype)
        return array

    def numbers(self, key: str, kinds: str, wanted: str, limit: int) -> NDArray[Any]:
        """[n] values of one of the dtype kinds; n is 0 where the key is absent."""
        array = self.array(key)
        if array is None:
            return np.empty(0)
        if array.dtype.kind not in kinds:
            raise ParameterError(f"key {key!r} holds {array.dtype} values, not {wanted}")
        if array.size > limit:
            raise ParameterError(f"key {key!r} has {array.size} entries, more than {limit}")
        return array.reshape(-1)

    def texts(self, key: str) -> list[str]:
        texts = self.numbers(key, "US", "text", CHANNEL_LIMIT)
        with refusing(f"key {key!r} holds no text"):
            return [t.decode() if isinstance(t, bytes) else str(t) for t in texts.tolist()]

    def objects(self, key: str, kind: type[T]) -> list[T]:
        """What ``_objects`` made of events or clocks. Other programs may have numbers there."""
        if key not in self.members or (key != "events" and self.shape(key)[1] not in "US"):
            return []
        with refusing(f"key {key!r}", RecursionError, TypeError):
            return [kind(**row) for text in self.texts(key) for row in json.loads(text)]

    def integers(self, key: str) -> list[int]:
        values = self.numbers(key, "iu", "integers", CHANNEL_LIMIT)
        return [int(value) for value in values.tolist()]

    def rate(self, key: str) -> Fraction | None:
        """A text unchanged; of a float its shortest decimal, in its own dtype."""
        values = self.numbers(key, "iufU", "a rate", 1)
        with refusing(f"key {key!r}"):
            return rate_from(str(values[0])) if values.size else None


def _plain(archive: _Archive) -> list[str]:
    """The keys of the channels where there is no key x: arrays of one dimension and one length."""
    known = {*_RATES, *_TIMES, "source", "events"}
    keys = [k for k in archive.members if k not in known and (k == "x" or not _KEY.fullmatch(k))]
    shapes = {key: archive.shape(key) for key in keys}
    rows = {k: shape for k, (shape, kind) in shapes.items() if kind in "biuf" and len(shape) == 1}
    lengths = {shape for shape in rows.values() if shape[0] > 1}
    return [key for key, shape in rows.items() if shape in lengths] if len(lengths) == 1 else []


def _array_of(
    archive: _Archive, ending: str, transpose: bool | None
) -> tuple[Sequence[NDArray[Any]], list[str]]:
    """[channels, samples], and the labels that the keys themselves are."""
    labelled = (
        archive.shape(f"channel_names{ending}")[0]
        if (f"channel_names{ending}" in archive.members)
        else ()
    )
    count = labelled[0] if len(labelled) == 1 else None
    keys = [f"x{ending}"]
    if ending or "x" in archive.members:
        beside = [] if ending or archive.shape("x")[0][1:] else _plain(archive)
        if len(beside) > 1:
            keys = beside  # one array each, and one of them is called x
    else:
        keys = _plain(archive)
        known = {*_RATES, *_TIMES}
        wide = [
            key
            for key in archive.members
            if key not in known and not keys and len(archive.shape(key)[0]) == 2
        ]
        keys = keys or wide
        if not keys or (wide and len(wide) > 1):
            shapes = {
                key: " x ".join(map(str, archive.shape(key)[0])) or "one value"
                for key in sorted(archive.members)[:_KEYS_NAMED]
            }
            there = ", ".join(f"{key!r} ({shape})" for key, shape in shapes.items())
            more = len(archive.members) - len(shapes)
            raise ParameterError(
                "no key 'x' ([channels, samples]), and no arrays of one dimension and one length; "
                f"there are: {there}{f' and {more} more' if more else ''}"
            )
    if len(keys) == 1:
        array = archive.array(keys[0])
        assert array is not None
        what = f"key {keys[0]!r}"
        nameless = array.ndim == 2 or re.fullmatch(r"x(__\d+)?|arr_\d+", keys[0])
        named = [] if nameless else keys
        rows = doubles_2d(array, what, labelled=count, transpose=transpose, store=archive.store)
        return rows, named
    refuse_transpose(transpose)
    if len(keys) > CHANNEL_LIMIT:
        raise LimitError(f"{len(keys)} channels, more than {CHANNEL_LIMIT}")
    rows = [_row(array, key) for key in keys if (array := archive.array(key)) is not None]
    return rows, keys


def _row(array: NDArray[Any], key: str) -> NDArray[Any]:
    """A channel in an array of its own. 64-bit integers stay if no doubles equal them."""
    if array.dtype.kind in "iu" and array.dtype.itemsize == 8 and not are_doubles(array):
        return array.astype(array.dtype.newbyteorder("="), copy=False)
    return exact_doubles(array, f"key {key!r}")


class _Group(NamedTuple):
    """Channels that share a rate and a start, the epoch that their times tell, and the channel
    that keeps these times."""

    channels: list[Channel]
    epoch_ns: int | None = None
    stamps: Channel | None = None


def _channels(archive: _Archive, ending: str, options: ReadOptions, notes: list[str]) -> _Group:
    rate, keep = options.rate, options.keep_stamps
    x, keys = _array_of(archive, ending, options.transpose)
    channels = len(x)
    if not channels:
        return _Group([])
    ticks = len(x[0])
    notes += [
        f"key {key!r} is read as a channel; times in seconds are read from the key 't'"
        for key in keys
        if time_name(key)
    ]
    labels = archive.texts(f"channel_names{ending}") or keys
    labels = labels or [f"ch{i + 1}" for i in range(channels)]
    if len(labels) == ticks != channels:
        if options.transpose:
            text = "has a label for each row, so it is [channels, samples]: use transpose=False"
            raise ParameterError(f"x{ending} {text}")
        raise ParameterError(
            f"x{ending} looks transposed; it is [channels, samples]: use transpose=True"
        )
    units = archive.texts(f"unit{ending}") or ["1"]
    units *= channels if len(units) == 1 else 1
    lsb = archive.numbers(f"lsb{ending}", "iuf", "numbers", CHANNEL_LIMIT)
    steps = exact_doubles(lsb, f"key 'lsb{ending}'").tolist() or [nan]
    steps *= channels if len(steps) == 1 else 1
    starts = archive.integers(f"start_tick{ending}") or [0]
    counted = {
        "channel_names": len(labels),
        "unit": len(units),
        "lsb": len(steps),
        "index": len(archive.integers(f"index{ending}")) or channels,
    }
    for name, count in counted.items():
        if count != channels:
            raise ParameterError(f"{name}{ending} has {count} entries for {channels} channels")
    if any(step < 0 or isinf(step) for step in steps):
        raise ParameterError(f"lsb{ending} holds a step that is negative or infinite")
    if len(starts) != 1 or not 0 <= starts[0] <= TICK_LIMIT - ticks:
        raise ParameterError(f"start_tick{ending} is not one tick in [0, 2^48)")
    found = _rate(archive, ending)
    grid: TickGrid | None = None
    kept: Sequence[int] | None = None
    keys_of_times = [f"{name}{ending}" for name in (_TIMES if not ending else _TIMES[:1])]
    times = None
    for key in [key for key in keys_of_times if key in archive.members][:1]:
        times = _times(archive, key, notes)
    if times is not None and found is None:
        grid, kept = _grid(times, rate, ticks, keep)
        found = grid.rate
        notes += grid.notes
        for note in grid.notes:
            warnings.warn(note, MovedTimesWarning, stacklevel=6)
    hertz = choose_rate(rate, found, notes)
    if grid is None and keep:
        kept = _in_ns(times, ticks, keys_of_times[0])
    if times is not None and grid is None:
        notes += _times_notes(times, hertz, ticks, starts[0], kept=keep)
    made = []
    for given, label, unit, step in zip(x, labels, units, steps, strict=True):
        row, known = stored_samples(given, archive.store)
        spans = tuple(spans_of(known, starts[0])) if grid is None else spans_at(grid.ticks[known])
        made.append(
            Channel(
                row,
                hertz,
                spans,
                label=label,
                unit=unit_of(unit, label, notes),
                lsb=None if isnan(step) or not step else step,  # 0: not known
            )
        )
    grid = grid or TickGrid(hertz, np.arange(starts[0], starts[0] + ticks), ())
    return _Group(made, grid.epoch_ns, None if kept is None else kept_stamps(kept, grid))


class _Times(NamedTuple):
    """Times of samples: floats in seconds, or int64 in a unit of ``exponent``."""

    values: NDArray[Any]
    exponent: int = 0


def _times(archive: _Archive, key: str, notes: list[str]) -> _Times:
    """Integers count from 1970, by their size, or in steps that are too large for seconds."""
    x = archive.numbers(key, "iuf", "numbers", TICK_LIMIT)
    if x.dtype.kind == "f" or not x.size or int(x.max()) >= 1 << 63:
        return _Times(exact_doubles(x, f"key {key!r}"))
    x = x.astype(np.int64)
    exponent = next(
        (power for power in (0, -3, -6, -9) if _UNIX_S[0] <= int(x[0]) * 10.0**power <= _UNIX_S[1]),
        None,
    )
    step = float(np.median(np.diff(x))) if x.size > 1 else 0.0
    if exponent is None:
        exponent = 0 if step < _COUNTED[0] else -6 if step < _COUNTED[1] else -9
    if exponent:
        unit = {-3: "ms", -6: "us", -9: "ns"}[exponent]
        notes.append(f"key {key!r} holds integers, which are read as times in {unit}")
    return _Times(x, exponent)


def _in_ns(times: _Times | None, ticks: int, key: str) -> list[int]:
    """The times of samples whose rate is known already."""
    if times is None:
        raise ParameterError(f"no key {key!r}, so there are no time stamps to keep")
    values, exponent = times
    if len(values) != ticks or not np.isfinite(values).all():
        raise ParameterError(
            f"the sample times cannot be kept: there are {len(values)}, perhaps not finite, for "
            f"{ticks} samples"
        )
    with refusing("the sample times cannot be kept"):
        return [whole_ns(Decimal(repr(time)), exponent) for time in values.tolist()]


def _grid(
    times: _Times, rate: Fraction | None, ticks: int, keep: bool
) -> tuple[TickGrid, Sequence[int] | None]:
    values, exponent = times
    if len(values) != ticks:
        raise ParameterError(f"{len(values)} times for {ticks} samples; give the rate (rate=)")
    stamps = TimeStamps(exponent, keep=keep)
    for time in values.tolist():
        try:
            stamps.add(repr(time))
        except ValueError as error:
            raise ParameterError(f"the time {time!r} {error}; give the rate (rate=)") from None
    return stamps.grid(rate), stamps.ns


def _rate(archive: _Archive, ending: str) -> Fraction | None:
    for name in _RATES if not ending else ():
        if name in archive.members and (found := archive.rate(name)) is not None:
            return found
    exact, rounded = archive.rate(f"rate{ending}"), archive.rate(f"rate_hz{ending}")
    if exact is None or rounded is None:
        return exact or rounded
    if float(exact) != float(rounded):
        raise ParameterError(f"rate{ending} is {exact} Hz and rate_hz{ending} {rounded} Hz")
    return exact


def _times_notes(times: _Times, rate: Fraction, ticks: int, start: int, *, kept: bool) -> list[str]:
    """What the grid, which replaces the true times of the samples, in s, does not keep of them."""
    values, scale = times.values, 10.0**times.exponent
    if len(values) != ticks or not ticks or not np.isfinite(values).all():
        return [
            "the sample times (key 't') are not stored: "
            f"there are {len(values)}, perhaps not finite, for {ticks} samples"
        ]
    with np.errstate(over="ignore"):
        passed = (values - values[0]) * scale
        largest = float(np.abs(passed - np.arange(ticks) * float(1 / rate)).max())
    first = float(values[0]) * scale
    notes = []
    if largest > STEADY / float(rate):
        notes.append(deviation_note(largest, rate, " (key 't')", kept=kept))
    if abs(first - start / rate) > max(largest, STEADY / float(rate)):
        notes.append(f"the times begin at {first} s, which became tick {start}")
    return notes


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """Physical values as float64, dense over each group's ticks, NaN in gaps."""
    arrays = _arrays(recording, options.max_memory)
    with zipfile.ZipFile(target.stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, array in arrays.items():
            # A fixed date: the same recording gives the same bytes.
            info = zipfile.ZipInfo(f"{key}.npy", (1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            info._compresslevel = LEVEL  # type: ignore[attr-defined]
            with archive.open(info, "w", force_zip64=True) as member:
                if isinstance(array, Dense):
                    write_dense(member, array)
                else:
                    write_array(member, array)
    carried = [key for key in ("source", "events", "clocks", "clock_maps") if key in arrays]
    return not_carried(recording, ".npz", "unit", "label", "lsb", *carried)


def _arrays(recording: Recording, max_memory: int) -> dict[str, NDArray[Any] | Dense]:
    by_rate: dict[Fraction, list[tuple[int, Channel]]] = {}
    for position, channel in enumerate(recording.channels):
        by_rate.setdefault(channel.rate_exact, []).append((position, channel))
    if len(by_rate) > _GROUPS:
        raise ParameterError(f".npz holds {_GROUPS} rates, the channels have {len(by_rate)}")
    arrays: dict[str, NDArray[Any] | Dense] = {}
    for number, (rate, placed) in enumerate(by_rate.items()):
        positions, channels = zip(*placed, strict=True)
        x = Dense(channels, ".npz", max_memory)
        max_memory -= x.gap_size
        group: dict[str, NDArray[Any] | Dense] = {
            "x": x,
            "rate": np.array(f"{rate.numerator}/{rate.denominator}"),
            "rate_hz": np.array(float(checked_rate(rate))),
            "channel_names": _text([channel.label for channel in channels]),
            "unit": _text([channel.unit for channel in channels]),
            "lsb": np.array([_step(channel) for channel in channels]),
            "start_tick": np.array(x.start),
        }
        if len(by_rate) > 1:
            group["index"] = np.array(positions)
        ending = f"__{number}" if len(by_rate) > 1 else ""
        arrays |= {f"{key}{ending}": array for key, array in group.items()}
    if not by_rate:
        arrays["x"] = np.empty((0, 0))
    for key, rows in _objects(recording):
        if rows:
            text = json.dumps(rows, ensure_ascii=False, separators=(",", ":"))
            arrays[key] = _text([text]).reshape(())
    if isinstance(source := recording.metadata.get("source"), str):
        arrays["source"] = _text([source]).reshape(())
    return arrays


def _text(texts: list[str]) -> NDArray[np.str_]:
    """[n] text; NumPy cannot hold NUL at the end of one."""
    array = np.array(texts, dtype=np.str_)
    if array.tolist() != texts:
        raise ParameterError("a text that ends in NUL cannot be written as .npz")
    return array


def _step(channel: Channel) -> float:
    """The lsb that the channel states, or the step of its counts; NaN for none.

    A binary grid with exact values is the encoder's, not the sensor's.
    """
    if channel.lsb is not None:
        return channel.lsb
    if channel.calibration is None:
        return nan
    a, d = channel.calibration.step.as_integer_ratio()
    if channel.exact is not None and not (abs(a) & (abs(a) - 1) or d & (d - 1)):
        return nan
    return abs(a / d)
