"""What a stream says -> calls of a recorder; the words of docs/streams.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import UNSET, Meta, Struct, UnsetType
from msgspec.structs import asdict
from numpy.typing import NDArray

from ..descriptions import OneOf, read
from ..errors import ParameterError
from ..recording import Calibration, spans_of
from ..units import to_ucum
from ..encoder.inputs import Input
from .recorder import Recorder


class Keys(Struct, frozen=True, forbid_unknown_fields=True):
    """An object of a stream."""


class ChannelKeys(Keys, frozen=True):
    """A channel: what an Input has, as JSON."""

    label: str
    rate: Annotated[float | str, Meta(description="the ticks per second")]
    unit: str = "1"
    quantity: str = ""
    axis: str = ""
    group: str = ""
    body_site: str = ""
    device: str = ""
    calibration: Annotated[tuple[int, ...], Meta(min_length=1, max_length=3)] | None = None
    """A, B and D."""
    bits: int = 24
    lsb: float | None = None

    def made(self) -> Input:
        given = asdict(self) | {"unit": to_ucum(self.unit)}
        if self.calibration is not None:
            given["calibration"] = Calibration(*self.calibration)
        return Input(**given)


class HeaderKeys(Keys, frozen=True):
    """What stands at the beginning of a stream."""

    channels: Annotated[tuple[ChannelKeys, ...], Meta(min_length=1)]
    metadata: dict[str, Any] = msgspec.field(default_factory=dict)
    epoch_ns: int | Literal["now"] | UnsetType | None = UNSET
    epoch_uncertainty_ns: int | UnsetType = UNSET

    def made(self) -> Header:
        epoch = {"epoch_ns": self.epoch_ns, "epoch_uncertainty_ns": self.epoch_uncertainty_ns}
        given = {key: value for key, value in epoch.items() if value is not UNSET}
        return Header([each.made() for each in self.channels], self.metadata, given)


class Action(OneOf):
    """An object after the header; docs/streams.md says what each does."""

    __slots__ = ()


class Values(Keys, Action, frozen=True):
    values: tuple[float | None, ...]
    channel: int | str
    tick: int | None = None


class Mark(Keys, Action, frozen=True):
    mark: str
    time: float | None = None
    duration: float | None = None
    channel: int | str | None = None
    layer: str | None = None


class Clock(Keys, Action, frozen=True):
    clock: str
    tick: int
    time_ns: int
    channel: int | str | None = None
    uncertainty_ns: int | None = None


class Add(Keys, Action, frozen=True):
    add: ChannelKeys


class Skip(Keys, Action, frozen=True):
    skip: int
    channel: int | str | None = None


class Flush(Keys, Action, frozen=True):
    flush: Any


class More(Keys, Action, frozen=True):
    metadata: dict[str, Any]


ACTIONS = (Values, Mark, Clock, Add, Skip, Flush, More)
Action.kinds = {kind.__struct_fields__[0]: kind for kind in ACTIONS}


@dataclass
class Header:
    """What stands at the beginning of a stream."""

    inputs: list[Input]
    metadata: dict[str, Any] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)
    """The epoch, where it is given."""
    notes: list[str] = field(default_factory=list)
    """What a person may want to know of it."""


class Session:
    """One stream, and the recorder that it begins with its header."""

    def __init__(self, begin: Callable[[Header], Recorder]) -> None:
        self.begin = begin
        self.recorder: Recorder | None = None
        self.tick = 0
        """Of the next row."""

    def start(self, header: Header) -> None:
        self.recorder = self.begin(header)
        self.tick = max((int(c) for c in self.recorder.lanes.ticks), default=0)

    @property
    def running(self) -> Recorder:
        if self.recorder is None:
            raise ParameterError("the stream does not begin with a header")
        return self.recorder

    def object(self, given: dict[str, Any]) -> None:
        """A header, or one of the actions."""
        if self.recorder is None:
            self.start(read(HeaderKeys, given).made())
        elif "channels" in given:
            raise ParameterError("a stream can have only one header")
        else:
            self.act(read(Action, given))

    def act(self, action: Action) -> None:
        recorder = self.running
        match action:
            case Values(values, channel, tick):
                found = np.array([np.nan if v is None else v for v in values], np.float64)
                self.samples(channel, found, tick)
            case Mark(text, time, duration, channel, layer):
                recorder.mark(text, time, duration or 0, channel, layer=layer or "")
            case Clock(name, tick, time_ns, channel, uncertainty_ns):
                recorder.clock(name, channel, tick, time_ns, uncertainty_ns or 0)
            case Add(given):
                recorder.add(given.made())
            case Skip(ticks, channel) if channel is not None:
                recorder.skip(channel, ticks)
            case Skip(ticks):
                self.tick += max(ticks, 0)
            case Flush():
                recorder.flush()
            case More(metadata):
                recorder.metadata.update(metadata)

    def rows(self, values: NDArray[Any], tick: int | None = None) -> None:
        """Rows [ticks, channels], NaN where a sample is missing."""
        recorder = self.running
        start = self.tick if tick is None else tick
        rates = {given.rate for given in recorder.inputs}
        if len(rates) > 1:
            raise ParameterError(
                "rows are for channels of one rate: give the values of each channel"
            )
        counts = [p for p, given in enumerate(recorder.inputs) if given.takes_counts]
        floats = [p for p, given in enumerate(recorder.inputs) if not given.takes_counts]
        if counts:
            chosen = values[:, counts]
            if chosen.dtype.kind == "i":
                recorder.write_rows(chosen, start, counts)
            elif not np.isnan(chosen).any():
                recorder.write_rows(whole(chosen), start, counts)
            else:
                for place in counts:
                    self.counts(place, values[:, place], start)
        if floats:
            chosen = values if not counts else values[:, floats]
            recorder.write_rows(chosen, start, floats)
        self.tick = start + len(values)

    def counts(self, place: int, values: NDArray[np.float64], start: int) -> None:
        """Counts of one channel, some of them missing."""
        recorder, stop = self.running, start + len(values)
        for span in spans_of(~np.isnan(values), start):
            recorder.write(place, whole(values[span.start - start : span.stop - start]), span.start)
        recorder.skip(place, stop - int(recorder.lanes.ticks[place]))

    def samples(self, channel: str | int, values: NDArray[Any], tick: int | None) -> None:
        """Samples of one channel; NaN where one is missing."""
        recorder = self.running
        place = recorder.lanes.place_of(channel)
        if values.dtype.kind == "f" and recorder.inputs[place].takes_counts:
            start = int(recorder.lanes.ticks[place]) if tick is None else tick
            recorder.lanes.start_of(recorder.lanes.one(place), start)
            self.counts(place, values.astype(np.float64), start)
        else:
            recorder.write(place, values, tick)


def whole(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Counts that came as text or floats."""
    if values.size and not (np.abs(values) < 2.0**53).all():
        raise ParameterError("a count beyond 2^53")
    counts = values.astype(np.int64)
    if (counts != values).any():
        odd = float(values[counts != values].flat[0])
        raise ParameterError(f"{odd!r} is not an integer count, but the calibration requires one")
    return counts
