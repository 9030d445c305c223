"""A recording as an xarray.Dataset: names, CF attributes, and an index of times that takes no room.

The reader of files (``hapfmt.analysis.backend``) and ``Recording.to_xarray`` share all of it, so
that both give the same dataset. Times follow from ticks: nothing is stored, and none is rounded
before the division.
"""

from __future__ import annotations

import json
from collections.abc import Hashable, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
import pandas as pd
import xarray
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing
from xarray.core.coordinate_transform import CoordinateTransform
from xarray.core.indexes import CoordinateTransformIndex, Index, PandasIndex
from xarray.core.indexing import IndexSelResult

from .clocks import ClockMap, ClockObservation, by_clock
from .errors import LimitError, ParameterError
from .numbers import rdiv
from .units import to_udunits
from .version import __version__

CONVENTIONS = "CF-1.11"
TIME_LIMIT = 1 << 28
"""Times that are computed at once, 2 GiB."""
_WHOLE_NS = 1 << 62


class TickTransform(CoordinateTransform):
    """Positions -> ticks -> seconds. ``ticks`` is a range; an array where they are not even."""

    def __init__(
        self, rate: Fraction, ticks: range | NDArray[np.int64], *, name: Hashable, dim: str
    ) -> None:
        super().__init__([name], {dim: len(ticks)})
        self.rate = rate
        self.ticks = ticks

    @property
    def name(self) -> Hashable:
        return self.coord_names[0]

    @property
    def dim(self) -> str:
        return self.dims[0]

    @property
    def size(self) -> int:
        return self.dim_size[self.dim]

    @property
    def grid(self) -> range | None:
        """The ticks, where they are a range that goes forward."""
        return self.ticks if isinstance(self.ticks, range) and self.ticks.step > 0 else None

    def ticks_at(self, positions: Any) -> NDArray[np.int64]:
        places = np.asarray(positions).astype(np.int64)
        if isinstance(self.ticks, range):
            found: NDArray[np.int64] = self.ticks.start + places * self.ticks.step
            return found
        return np.asarray(self.ticks[places])

    def all_ticks(self) -> NDArray[np.int64]:
        if self.size > TIME_LIMIT:
            raise LimitError(
                f"{self.size} times are above the limit of {TIME_LIMIT}; take a part of the time"
            )
        return np.asarray(self.ticks, np.int64)

    def seconds(self, positions: Any) -> NDArray[np.float64]:
        """The doubles that ``seconds_of`` gives for the ticks at these positions."""
        numerator = self.ticks_at(positions).astype(np.float64) * float(self.rate.denominator)
        seconds: NDArray[np.float64] = numerator / float(self.rate.numerator)
        return seconds

    def forward(self, dim_positions: dict[str, Any]) -> dict[Hashable, Any]:
        return {self.name: self.seconds(dim_positions[self.dim])}

    def equals(self, other: CoordinateTransform, **_: Any) -> bool:
        if not isinstance(other, TickTransform) or self.rate != other.rate:
            return False
        if isinstance(self.ticks, range) and isinstance(other.ticks, range):
            return self.ticks == other.ticks
        return self.size == other.size and np.array_equal(self.all_ticks(), other.all_ticks())

    def generate_coords(self, dims: tuple[str, ...] | None = None) -> dict[Hashable, Any]:
        self.all_ticks()
        return super().generate_coords(dims)

    def of(self, ticks: range | NDArray[np.int64], dim: str | None = None) -> TickTransform:
        """Other ticks of the same rate; even ones become a range."""
        if not isinstance(ticks, range) and ticks.size:
            first, step = int(ticks[0]), int(ticks[1] - ticks[0]) if ticks.size > 1 else 1
            even = range(first, first + step * ticks.size, step) if step > 0 else range(0)
            if len(even) == ticks.size and np.array_equal(ticks, np.asarray(even)):
                ticks = even
        elif not isinstance(ticks, range):
            ticks = range(0)
        return TickTransform(self.rate, ticks, name=self.name, dim=dim or self.dim)

    def count_before(self, seconds: NDArray[np.float64], *, including: bool) -> NDArray[np.int64]:
        """How many times lie before each of ``seconds``, or at it where ``including``; for a grid
        that goes forward."""
        grid = self.grid
        assert grid is not None
        estimate = np.floor((seconds * float(self.rate) - grid.start) / grid.step)
        place = np.clip(np.nan_to_num(estimate), 0, self.size).astype(np.int64)
        # The estimate is off by one or two, by the rounding of its product.
        for _ in range(4):
            below, here = self.seconds(np.maximum(place - 1, 0)), self.seconds(place)
            back = (below > seconds) if including else (below >= seconds)
            ahead = (here <= seconds) if including else (here < seconds)
            place = place - (back & (place > 0)) + (ahead & (place < self.size))
        found: NDArray[np.int64] = place
        return found


class TickIndex(CoordinateTransformIndex):
    """Selects by time as an index of pandas does that holds all times, without holding them."""

    transform: TickTransform

    def isel(self, indexers: Mapping[Any, Any]) -> Index | None:
        old = self.transform
        chosen = indexers[old.dim]
        if isinstance(chosen, slice):
            return TickIndex(old.of(old.ticks[chosen]))
        values = np.asarray(getattr(chosen, "values", chosen))
        if values.ndim != 1:
            return None
        if values.dtype == bool:
            values = np.flatnonzero(values)
        values = np.where(values < 0, values + old.size, values)
        dim = chosen.dims[0] if isinstance(chosen, xarray.Variable) else old.dim
        return TickIndex(old.of(old.ticks_at(values), str(dim)))

    def sel(
        self, labels: dict[Any, Any], method: str | None = None, tolerance: Any = None
    ) -> IndexSelResult:
        (label,) = labels.values()
        if self.transform.grid is None:
            return PandasIndex(self.to_pandas_index(), self.transform.dim).sel(
                labels, method, tolerance
            )
        if isinstance(label, slice):
            if method is not None:
                raise NotImplementedError("a slice of times takes no method")
            return IndexSelResult({self.transform.dim: self._slice(label)})
        wanted = np.asarray(getattr(label, "values", label))
        if wanted.dtype == bool or wanted.dtype.kind not in "iuf":
            raise KeyError(f"times are seconds, not {label!r:.80}")
        places = self._places(wanted.astype(np.float64), method, tolerance)
        found: Any = places
        if isinstance(label, (xarray.Variable, xarray.DataArray)):
            found = label.copy(data=places)
        elif not places.ndim:
            found = int(places)
        return IndexSelResult({self.transform.dim: found})

    def _slice(self, label: slice) -> slice:
        ends: list[int] = [0, self.transform.size]
        for side, end in enumerate((label.start, label.stop)):
            if end is not None:
                at = np.asarray(float(end))
                ends[side] = int(self.transform.count_before(at, including=bool(side)))
        return slice(ends[0], max(ends), label.step)

    def _places(
        self, wanted: NDArray[np.float64], method: str | None, tolerance: Any
    ) -> NDArray[np.int64]:
        size = self.transform.size
        before = self.transform.count_before(wanted, including=True) - 1
        after = self.transform.count_before(wanted, including=False)
        last = np.minimum(after, max(size - 1, 0))
        if method is None:
            places, there = last, self.transform.seconds(last) == wanted
        elif method in ("pad", "ffill"):
            places, there = before, before >= 0
        elif method in ("backfill", "bfill"):
            places, there = last, after < size
        elif method == "nearest":
            down = np.abs(self.transform.seconds(np.maximum(before, 0)) - wanted)
            up = np.abs(self.transform.seconds(last) - wanted)
            is_before = (before >= 0) & ((down < up) | (after >= size))
            places, there = np.where(is_before, before, last), ~np.isnan(wanted)
        else:
            raise ValueError(f"method {method!r} is none of nearest, ffill, bfill")
        there = there & (size > 0)
        if tolerance is not None:
            there &= np.abs(self.transform.seconds(np.maximum(places, 0)) - wanted) <= tolerance
        if not np.all(there):
            missing = np.atleast_1d(wanted)[~np.atleast_1d(there)]
            raise KeyError(
                f"no sample at {float(missing[0])!r} s; method='nearest' takes the nearest one"
            )
        return np.asarray(places)

    def join(self, other: Any, how: str = "inner") -> Self:
        old, new = self.transform, other.transform
        self._check_rate(other)
        mine, theirs = old.grid, new.grid
        if mine and theirs and mine.step == theirs.step and not (mine[0] - theirs[0]) % mine.step:
            least, most = (max, min) if how == "inner" else (min, max)
            stop = most(mine[-1], theirs[-1]) + 1
            return type(self)(old.of(range(least(mine[0], theirs[0]), stop, mine.step)))
        both = np.intersect1d if how == "inner" else np.union1d
        return type(self)(old.of(both(old.all_ticks(), new.all_ticks())))

    def reindex_like(self, other: Any) -> dict[Hashable, Any]:
        self._check_rate(other)
        wanted = other.transform.all_ticks()
        ticks = self.transform.ticks
        if isinstance(ticks, range):
            places, rest = np.divmod(wanted - ticks.start, ticks.step)
            missing = (rest != 0) | (places < 0) | (places >= len(ticks))
        else:
            order = np.argsort(ticks, kind="stable")
            at = np.searchsorted(ticks, wanted, sorter=order)
            places = order[np.minimum(at, len(ticks) - 1)]
            missing = ticks[places] != wanted
            if np.unique(ticks).size < ticks.size:
                raise ParameterError("some times are there twice; select each once")
        return {self.transform.dim: np.where(missing, -1, places)}

    def _check_rate(self, other: TickIndex) -> None:
        mine, theirs = self.transform.rate, other.transform.rate
        if mine != theirs:
            raise ParameterError(
                f"times at {float(mine):.6g} Hz and {float(theirs):.6g} Hz do not coincide; "
                "resample one of them, or interpolate it: a.interp_like(b)"
            )

    @classmethod
    def concat(cls, indexes: Sequence[Any], dim: Hashable, positions: Any = None) -> Any:
        """One after the other; times of several rates become an index of pandas."""
        parts = [one.transform for one in indexes]
        first = parts[0]
        if any(part.rate != first.rate for part in parts):
            plain = [PandasIndex(one.to_pandas_index(), dim) for one in indexes]
            return PandasIndex.concat(plain, dim, positions)
        ticks: range | NDArray[np.int64] = np.empty(0, np.int64)
        grids = [part.grid for part in parts if part.size]
        go_on = all(
            a and b and a.step == b.step and a[-1] + a.step == b[0] for a, b in pairwise(grids)
        )
        if positions is None and go_on and grids and grids[0] and grids[-1]:
            ticks = range(grids[0].start, grids[-1].stop, grids[0].step)
        else:
            ticks = np.concatenate([part.all_ticks() for part in parts])
            if positions is not None:
                places = np.concatenate([np.asarray([*one]) for one in positions])
                ticks = ticks[np.argsort(places, kind="stable")]
        return cls(first.of(ticks, str(dim)))

    def to_pandas_index(self) -> pd.Index:
        times = self.transform.generate_coords()[self.transform.name]
        return pd.Index(times, name=self.transform.name)

    def _repr_inline_(self, max_width: int) -> str:  # noqa: ARG002
        return f"TickIndex ({self._facts()})"

    def __repr__(self) -> str:
        return f"<TickIndex: {self._facts()}>"

    def _facts(self) -> str:
        old, grid = self.transform, self.transform.grid
        if grid is None:
            return f"{old.size} of the times at {float(old.rate):.6g} Hz"
        return f"{old.size} times at {float(old.rate / grid.step):.6g} Hz from tick {grid.start}"


class ClockArray(BackendArray):
    """int64 [ticks]: nanoseconds of another clock, computed when they are read."""

    def __init__(self, map_: ClockMap, rate: Fraction, first: int, size: int) -> None:
        self.map = map_
        self.rate = rate
        self.first = first
        self.shape = (size,)
        self.dtype = np.dtype(np.int64)

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self._times
        )

    def _times(self, key: tuple[Any, ...]) -> Any:
        places = range(self.shape[0])[key[0]] if isinstance(key[0], slice) else key[0]
        if isinstance(places, range) and len(places) > TIME_LIMIT:
            raise LimitError(f"{len(places)} times are above the limit of {TIME_LIMIT}")
        ticks = np.asarray(places, np.int64) + self.first
        return clock_times(self.map, self.rate, ticks)


def clock_times(map_: ClockMap, rate: Fraction, ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """What ``map_.time_ns`` gives for each tick, exactly; LimitError beyond 64 bits."""
    whole = np.atleast_1d(ticks)
    places: NDArray[Any] = whole
    if map_.channel is None:
        ns, rate_ns = rate.denominator * 10**9, rate.numerator
        if not whole.size or int(np.abs(whole).max()) * ns * 2 < _WHOLE_NS:
            places = (2 * whole * ns + rate_ns) // (2 * rate_ns)
        else:
            places = np.array([rdiv(int(tick) * ns, rate_ns) for tick in whole], object)
    points = map_.points
    lines = np.searchsorted(np.array([k for k, _ in points[1:-1]], np.int64), places, "right")
    out = np.empty(whole.shape, np.int64)
    for line in np.unique(lines).tolist():
        (k0, t0), (k1, t1) = points[line : line + 2]
        at = lines == line
        ahead, span = places[at] - k0, k1 - k0
        quotient, rest = divmod(t1 - t0, span)
        far = int(max(abs(ahead.min()), abs(ahead.max())))
        if far * (2 * rest + 1) + span >= _WHOLE_NS or far * quotient + abs(t0) >= _WHOLE_NS:
            exact = [map_.time_ns(k0 + int(one)) for one in ahead]
            if any(not -(1 << 63) <= one < 1 << 63 for one in exact):
                raise LimitError(f"clock {map_.clock!r} leaves the range of 64 bits")
            out[at] = exact
        else:
            out[at] = t0 + quotient * ahead + (2 * rest * ahead + span) // (2 * span)
    return out.reshape(np.shape(ticks))


def clock_maps(observed: Iterable[ClockObservation], maps: Iterable[ClockMap]) -> list[ClockMap]:
    """The maps; for a clock without one, straight lines between its observations that advance."""
    found = by_clock(maps)
    for key, own in by_clock(observed).items():
        points: list[tuple[int, int]] = []
        for seen in own if key not in found else ():
            if not points or (seen.tick > points[-1][0] and seen.time_ns > points[-1][1]):
                points.append((seen.tick, seen.time_ns))
        if len(points) > 1:
            found[key] = [ClockMap(*key, tuple(points))]
    return [own[0] for own in found.values()]


def attributes(channel: Any) -> dict[str, Any]:
    """CF attributes of a hapfmt.Channel, and those of the format that CF does not know."""
    units = to_udunits(channel.unit)
    about: dict[str, Any] = {
        **({} if units is None else {"units": units}),
        "long_name": channel.label,
        "ucum": channel.unit,
        "rate": float(channel.rate_exact),
    }
    if channel.rate_exact.denominator != 1:
        about["rate_exact"] = str(channel.rate_exact)
    # CF keeps the name "axis" for coordinates.
    names = {"quantity": "quantity", "axis": "channel_axis", "group": "group",
             "body_site": "body_site", "device": "device"}  # fmt: skip
    for name, key in names.items():
        if text := getattr(channel, name):
            about[key] = text
    if channel.calibration is not None:
        one = channel.calibration
        about["calibration"] = f"(count * {one.a} + {one.b}) / {one.d}"
    if channel.deviation is not None:
        about["declared_error"] = channel.deviation.declared
        about["largest_error"] = channel.deviation.largest
    if channel.synthetic:
        about["texture"] = "synthetic"
    return about


class About(NamedTuple):
    """What a dataset says of the whole recording."""

    uuid: Any = None
    epoch_ns: int | None = None
    epoch_uncertainty_ns: int = 0
    metadata: Mapping[str, Any] = MappingProxyType({})

    def attributes(self) -> dict[str, Any]:
        about: dict[str, Any] = {"Conventions": CONVENTIONS, "source": f"hapfmt {__version__}"}
        if self.uuid is not None:
            about["uuid"] = str(self.uuid)
        if self.epoch_ns is not None:
            about["epoch_ns"] = self.epoch_ns
        if self.epoch_uncertainty_ns:
            about["epoch_uncertainty_ns"] = self.epoch_uncertainty_ns
        if self.metadata:
            about["metadata"] = json.dumps(dict(self.metadata))  # a text: to_netcdf takes it
        return about


class DatasetVariable(NamedTuple):
    """A variable to be, with the values from the first tick of its rate to the last.

    number
        the number of the channel in the recording.
    channel
        a hapfmt.Channel, maybe without samples.
    """

    name: str
    number: int
    channel: Any
    data: Any
    encoding: Mapping[str, Any] = MappingProxyType({})


def rate_names(rates: Iterable[Fraction]) -> dict[Fraction, str]:
    """1000 Hz -> "1000Hz": names of groups, and after "time_" of dimensions."""
    rates = list(dict.fromkeys(rates))
    names = [_short(rate) for rate in rates]
    return {
        rate: name if names.count(name) == 1 else _exact(rate)
        for rate, name in zip(rates, names, strict=True)
    }


def _short(rate: Fraction) -> str:
    return f"{float(rate):.6g}Hz"


def _exact(rate: Fraction) -> str:
    return f"{rate.numerator}_{rate.denominator}Hz"


def time_names(rates: Iterable[Fraction]) -> list[str]:
    """All names that times of these rates may have, in any group."""
    found = {f"time_{name}": None for rate in rates for name in (_short(rate), _exact(rate))}
    return ["time", *found]


def dataset_of(
    signals: Sequence[DatasetVariable],
    extents: Mapping[Fraction, tuple[int, int]],
    about: About,
    maps: Sequence[ClockMap] = (),
    *,
    rate_of: Mapping[Any, Fraction] | None = None,
) -> xarray.Dataset:
    """A variable for each signal, a coordinate of times for each of their rates, and a coordinate
    for each clock on its ticks. ``rate_of``: the rates of the channels that clocks refer to."""
    rates = list(dict.fromkeys(signal.channel.rate_exact for signal in signals))
    alone = len(rates) == 1
    time_of = {
        rate: "time" if alone else f"time_{name}" for rate, name in rate_names(rates).items()
    }
    if rate_of is None:
        rate_of = {signal.number: signal.channel.rate_exact for signal in signals}
    coordinates = xarray.Coordinates()
    taken = {signal.name for signal in signals} | set(time_of.values())
    clocks: dict[str, Any] = {}
    for rate, time in time_of.items():
        first, last = extents[rate]
        transform = TickTransform(rate, range(first, last), name=time, dim=time)
        coordinates = coordinates | xarray.Coordinates.from_xindex(TickIndex(transform))
        for map_ in maps:
            if map_.channel is not None and rate_of.get(map_.channel) != rate:
                continue
            name = map_.clock if alone else f"{map_.clock}_{time.removeprefix('time_')}"
            while name in taken:
                name = f"{name} clock"
            taken.add(name)
            lazy = indexing.LazilyIndexedArray(ClockArray(map_, rate, first, last - first))
            told = {"units": "ns", "long_name": f"time of the clock {map_.clock}"}
            clocks[name] = xarray.Variable((time,), lazy, told)
    variables = {
        signal.name: xarray.Variable(
            (time_of[signal.channel.rate_exact],),
            signal.data,
            attributes(signal.channel),
            dict(signal.encoding),
        )
        for signal in signals
    }
    made = xarray.Dataset(variables, coordinates, about.attributes()).assign_coords(clocks)
    for time in time_of.values():
        made[time].attrs.update(
            {"units": "s", "long_name": "time since the start of the recording", "axis": "T"}
        )
    return made


def events_of(events: Sequence[Any], names: Mapping[int, str], about: About) -> xarray.Dataset:
    """Events by their number: time and duration in seconds, text, channel, layer. ``names`` are
    those of the variables; an event of all channels has ""."""

    def texts(found: Iterable[str]) -> NDArray[Any]:
        return np.array([*found], dtype=object)

    def name_of(channel: Any) -> str:
        return "" if channel is None else names.get(channel, str(channel))

    seconds = {"units": "s"}
    return xarray.Dataset(
        {
            "text": ("event", texts(event.text for event in events)),
            "duration": ("event", np.array([float(e.duration) for e in events]), seconds),
            "channel": ("event", texts(name_of(event.channel) for event in events)),
            "layer": ("event", texts(event.layer for event in events)),
        },
        {"time": ("event", np.array([float(event.time) for event in events]), seconds)},
        about.attributes(),
    )
