"""What a stream says -> calls of a recorder; the words of docs/streams.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import ParameterError
from ..recording import Calibration, spans_of
from ..units import to_ucum
from .inputs import Input
from .recorder import Recorder

INPUT_KEYS = frozenset(f.name for f in fields(Input))
EPOCH_KEYS = ("epoch_ns", "epoch_uncertainty_ns")
HEADER_KEYS = frozenset({"channels", "metadata", *EPOCH_KEYS})


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
        self.actions: dict[str, Callable[[dict[str, Any]], None]] = {
            "values": self.values,
            "mark": self.mark,
            "clock": self.clock,
            "add": self.add,
            "skip": self.skip,
            "flush": self.flush,
            "metadata": self.metadata,
        }

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
            self.start(header_of(given))
            return
        if "channels" in given:
            raise ParameterError("a stream can have only one header")
        for key, action in self.actions.items():
            if key in given:
                action(given)
                return
        raise ParameterError(f"an object has one of {', '.join(self.actions)}")

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

    def values(self, given: dict[str, Any]) -> None:
        channel, values = only(given, "channel", "values", tick=None)
        if not isinstance(values, list):
            raise ParameterError("values are a list of numbers")
        try:
            array = np.array([np.nan if v is None else v for v in values], np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ParameterError(
                "values must be a list of numbers; null marks a missing one"
            ) from None
        self.samples(channel, array, whole_number(given.get("tick"), "tick"))

    def mark(self, given: dict[str, Any]) -> None:
        only(given, "mark", time=None, duration=None, channel=None, layer=None)
        self.running.mark(
            given["mark"],
            given.get("time"),
            given.get("duration") or 0,
            given.get("channel"),
            layer=given.get("layer") or "",
        )

    def clock(self, given: dict[str, Any]) -> None:
        name, tick, time_ns = only(
            given, "clock", "tick", "time_ns", channel=None, uncertainty_ns=None
        )
        self.running.clock(
            name, given.get("channel"), tick, time_ns, given.get("uncertainty_ns") or 0
        )

    def add(self, given: dict[str, Any]) -> None:
        only(given, "add")
        self.running.add(input_of(given["add"]))

    def skip(self, given: dict[str, Any]) -> None:
        only(given, "skip", channel=None)
        ticks, channel = whole_number(given["skip"], "skip") or 0, given.get("channel")
        if channel is None:
            self.tick += max(ticks, 0)
        else:
            self.running.skip(channel, ticks)

    def flush(self, given: dict[str, Any]) -> None:
        only(given, "flush")
        self.running.flush()

    def metadata(self, given: dict[str, Any]) -> None:
        (metadata,) = only(given, "metadata")
        if not isinstance(metadata, dict):
            raise ParameterError("metadata must be a JSON object")
        self.running.metadata.update(metadata)


def only(given: dict[str, Any], *keys: str, **optional: None) -> list[Any]:
    """The values of ``keys``, all of them there, and no keys that are not known."""
    missing = [key for key in keys if key not in given]
    unknown = sorted(set(given) - {*keys, *optional})
    if missing or unknown:
        what = f"misses {missing[0]!r}" if missing else f"has an unknown {unknown[0]!r}"
        raise ParameterError(f"an object with {keys[0] if keys[0] in given else keys[1]!r} {what}")
    return [given[key] for key in keys]


def whole_number(value: Any, name: str) -> int | None:
    if value is not None and (not isinstance(value, int) or isinstance(value, bool)):
        raise ParameterError(f"{name} is an integer, not {value!r}")
    return value


def whole(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Counts that came as text or floats."""
    if values.size and not (np.abs(values) < 2.0**53).all():
        raise ParameterError("a count beyond 2^53")
    counts = values.astype(np.int64)
    if (counts != values).any():
        odd = float(values[counts != values].flat[0])
        raise ParameterError(f"{odd!r} is not an integer count, but the calibration requires one")
    return counts


def header_of(given: dict[str, Any]) -> Header:
    unknown = sorted(set(given) - HEADER_KEYS)
    channels = given.get("channels")
    if unknown or not isinstance(channels, list) or not channels:
        raise ParameterError(
            f"a header has no {unknown[0]!r}" if unknown else "a header has a list of channels"
        )
    metadata = given.get("metadata", {})
    if not isinstance(metadata, dict):
        raise ParameterError("metadata must be a JSON object")
    epoch: dict[str, Any] = {key: given[key] for key in EPOCH_KEYS if key in given}
    return Header([input_of(channel) for channel in channels], metadata, epoch)


def input_of(given: Any) -> Input:
    """An Input of its fields as JSON; a calibration is a list of A, B and D."""
    if not isinstance(given, dict):
        raise ParameterError("a channel is an object with label and rate")
    unknown = sorted(set(given) - INPUT_KEYS)
    if unknown or not {"label", "rate"} <= set(given):
        what = f"has no {unknown[0]!r}" if unknown else "has a label and a rate"
        raise ParameterError(f"a channel {what}; known: {', '.join(sorted(INPUT_KEYS))}")
    for key in INPUT_KEYS & set(given) - {"rate", "calibration", "bits", "lsb"}:
        if not isinstance(given[key], str):
            raise ParameterError(f"the {key} of a channel is a text")
    if "unit" in given:
        given = {**given, "unit": to_ucum(given["unit"])}
    calibration = given.get("calibration")
    try:
        if calibration is not None:
            calibration = Calibration(*calibration)
        return Input(**{**given, "calibration": calibration})
    except (TypeError, ValueError):
        raise ParameterError(
            "a channel has numbers for rate, bits and lsb, and [A, B, D] for calibration"
        ) from None
