"""Recording -> MCAP, as messages of ROS 2 or of JSON, by mcap.

The record ``hapfmt`` of the metadata holds what messages do not, as JSON under the key
``recording``; mcap_own.py reads it. Foxglove, PlotJuggler and Rerun show the messages.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingExtraError, ParameterError
from ..recording import Channel, Event, Recording, in_order
from ..spool import release
from ..version import __version__
from .common import not_carried, refusing
from .formats import Destination, WriteOptions
from .message_kinds import WrittenTopic, holds_counts, topics_of
from .own import CARRIED, own_members
from .ros_definitions import definition
from .ros_packing import MessageTemplate
from .timestamps import stamps_of

try:
    import msgspec
    from mcap.writer import Writer
except ImportError:
    raise MissingExtraError("mcap", "ros") from None

RECORD, KEY = "hapfmt", "recording"
EVENTS, LOG = "/events", "rcl_interfaces/msg/Log"
SCHEMAS = ("ros2", "json")
_ROWS = 4096
"""Messages of a topic that are made at a time."""
_CHUNK_SIZE = 1 << 20
_TIME_LIMIT = {"ros2": 2**31 * 10**9, "json": 2**63}
"""ns since 1970; messages of ROS 2 count seconds with 32 bits."""
_INFO_ROS, _INFO_FOXGLOVE = 20, 2
"""Levels of a log message."""
_JSON_TYPES = {"int32": "integer", "int64": "integer", "uint64": "integer"}


class _Batch(NamedTuple):
    times: NDArray[np.int64]
    messages: list[bytes]


def write(recording: Recording, target: Destination, options: WriteOptions) -> list[str]:
    """A topic for the channels that share their times, and the topic /events."""
    schema = options.schema or "ros2"
    if schema not in SCHEMAS:
        raise ParameterError(f"the schemas of MCAP are {' and '.join(SCHEMAS)}, not {schema!r}")
    topics = topics_of(recording, standard=schema == "ros2")
    notes: list[str] = []
    zero_ns = _zero(recording, topics, schema, notes)
    with refusing("the metadata of the recording", RecursionError):
        own = json.dumps(_own(recording, topics, schema, zero_ns))
    writer: Any = Writer(target.stream, chunk_size=_CHUNK_SIZE)
    writer.start("ros2" if schema == "ros2" else "", f"hapfmt {__version__}")
    writer.add_metadata(RECORD, {"version": "1", KEY: own})
    with refusing("the attachments of the recording"):
        for name, (kind, data) in recording.attachments.items():
            writer.add_attachment(zero_ns, zero_ns, name, kind, data)
    packing: _Packing = _RosPacking() if schema == "ros2" else _JsonPacking(recording)
    sources: list[Iterator[_Batch]] = []
    ids: list[int] = []
    for topic in topics:
        if topic.spans:
            ids.append(packing.register(writer, topic))
            sources.append(_batches(recording, topic, zero_ns, packing))
    total = sum(sum(span.ticks for span in topic.spans) for topic in topics)
    if recording.events:
        ids.append(packing.register_events(writer))
        sources.append(_events(recording, zero_ns, packing))
        total += len(recording.events)
    done = 0
    numbers = [0] * len(ids)
    for owners, times, messages in _merged(sources):
        for source, time, message in zip(owners, times, messages, strict=True):
            writer.add_message(ids[source], time, message, time, numbers[source] & 0xFFFFFFFF)
            numbers[source] += 1
        done += len(messages)
        release()
        if options.progress:
            options.progress(done, total)
    writer.finish()
    counts = [c.label for c in recording.channels if holds_counts(c)]
    notes += [f"channel {label!r} is written as counts" for label in counts]
    if any(channel.exact is not None for channel in recording.channels):
        notes.append("the grids of floating-point channels are not carried over to .mcap")
    metadata = tuple(recording.metadata)
    return notes + not_carried(recording, ".mcap", *CARRIED, "attachments", *metadata)


def _zero(
    recording: Recording, topics: Sequence[WrittenTopic], schema: str, notes: list[str]
) -> int:
    """The time of tick 0 in the messages: the start of the recording, else 0."""
    last = max(
        (topic.spans[-1].stop / topic.rate for topic in topics if topic.spans),
        default=Fraction(0),
    )
    last = max([last, *(event.time for event in recording.events)])
    length, limit = int(last * 10**9) + 1, _TIME_LIMIT[schema]
    if length >= limit:
        raise ParameterError(
            f"the recording is {float(last):.6g} s long, and messages of MCAP hold times up to "
            f"{limit // 10**9} s"
        )
    epoch_ns = recording.epoch_ns
    if epoch_ns is None:
        return 0
    if epoch_ns >= 0 and epoch_ns + length < limit:
        return epoch_ns
    notes.append(
        "messages do not hold the start time of the recording; they begin at 0, and the metadata "
        "keeps it"
    )
    return 0


def _own(
    recording: Recording, topics: Sequence[WrittenTopic], schema: str, zero_ns: int
) -> dict[str, Any]:
    def about(number: int, path: str) -> dict[str, Any]:
        channel = recording.channels[number]
        plain = channel.exact is not None
        found: dict[str, Any] = {
            "number": number,
            "path": path,
            "dtype": str(np.dtype(np.float64) if plain else channel.stored.dtype),
        }
        calibration = None if plain else channel.calibration
        if calibration is not None:
            found["calibration"] = [calibration.a, calibration.b, calibration.d]
            if holds_counts(channel):
                found["counts"] = True
        texts = ("label", "unit", "quantity", "axis", "group", "body_site", "device")
        found |= {key: text for key in texts if (text := getattr(channel, key))}
        return found | ({"lsb": channel.lsb} if channel.lsb is not None else {})

    return {
        "schema": schema,
        "zero_ns": zero_ns,
        "topics": [
            {
                "name": topic.name,
                "rate": str(topic.rate),
                "spans": [[span.start, span.stop] for span in topic.spans],
                "channels": [
                    about(number, path)
                    for number, path in zip(topic.channels, topic.paths, strict=True)
                ],
            }
            for topic in topics
        ],
        **own_members(recording),
    }


# Values


class _Samples:
    """The samples of a channel as they are in messages, slice by slice."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self.is_stored = channel.calibration is None or holds_counts(channel)

    def between(self, first: int, last: int) -> NDArray[Any]:
        """Those at the places first <= place < last."""
        channel = self.channel
        if channel.exact is not None:
            return channel.exact[first:last]
        stored = channel.stored[first:last]
        if self.is_stored or channel.calibration is None:
            return stored
        return channel.calibration.physical(stored)


class _Packing(Protocol):
    """How messages are made."""

    def register(self, writer: Any, topic: WrittenTopic) -> int: ...
    def register_events(self, writer: Any) -> int: ...
    def packed(
        self, topic: WrittenTopic, times: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
    ) -> list[bytes]: ...
    def event(self, time_ns: int, event: Event) -> bytes: ...


class _RosPacking:
    """Messages of ROS 2."""

    def __init__(self) -> None:
        self.templates: dict[str, MessageTemplate] = {}

    def register(self, writer: Any, topic: WrittenTopic) -> int:
        types, text = definition(topic.kind, topic.fields)
        content: dict[str, Any] = {"header.frame_id": topic.device, **topic.constants}
        if topic.joints:
            content["name"] = topic.joints
            kinds = [path.partition("[")[0] for path in topic.paths]
            content |= {kind: kinds.count(kind) for kind in kinds}
        self.templates[topic.name] = MessageTemplate(types, topic.kind, content)
        return self._channel(writer, topic.name, topic.kind, text)

    def register_events(self, writer: Any) -> int:
        return self._channel(writer, EVENTS, LOG, definition(LOG)[1])

    @staticmethod
    def _channel(writer: Any, name: str, kind: str, text: str) -> int:
        schema = writer.register_schema(kind, "ros2msg", text.encode())
        made: int = writer.register_channel(name, "cdr", schema, {"offered_qos_profiles": ""})
        return made

    def packed(
        self, topic: WrittenTopic, times: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
    ) -> list[bytes]:
        stamps = {"header.stamp.sec": times // 10**9, "header.stamp.nanosec": times % 10**9}
        return self.templates[topic.name].packed({**stamps, **values})

    def event(self, time_ns: int, event: Event) -> bytes:
        content = {
            "stamp.sec": time_ns // 10**9, "stamp.nanosec": time_ns % 10**9, "level": _INFO_ROS,
            "name": event.layer, "msg": event.text,
        }  # fmt: skip
        return bytes(MessageTemplate(definition(LOG)[0], LOG, content).data)


class _Stamp(msgspec.Struct, gc=False):
    sec: int
    nsec: int


class _JsonPacking:
    """Messages of JSON. Their schema says labels and units."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.encode = msgspec.json.Encoder().encode
        self.rows: dict[str, Any] = {}

    def register(self, writer: Any, topic: WrittenTopic) -> int:
        fields: dict[str, Any] = {}
        for number, (kind, path) in zip(topic.channels, topic.fields, strict=True):
            channel = self.recording.channels[number]
            fields[path] = {
                "type": _JSON_TYPES.get(kind, "number"), "title": channel.label,
                "unit": channel.unit,
            }  # fmt: skip
        names = {f"c{number}": path for number, path in enumerate(("timestamp", *fields))}
        self.rows[topic.name] = msgspec.defstruct("Row", [*names], rename=names, gc=False)
        return self._channel(writer, topic.name, topic.name.strip("/"), fields)

    def register_events(self, writer: Any) -> int:
        kinds = {"level": "integer", "message": "string", "name": "string", "file": "string",
                 "line": "integer"}  # fmt: skip
        fields = {name: {"type": kind} for name, kind in kinds.items()}
        return self._channel(writer, EVENTS, "foxglove.Log", fields)

    @staticmethod
    def _channel(writer: Any, name: str, title: str, fields: Mapping[str, Any]) -> int:
        time = {
            "type": "object",
            "title": "time",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        }
        text = json.dumps({"type": "object", "properties": {"timestamp": time, **fields}})
        schema = writer.register_schema(title, "jsonschema", text.encode())
        made: int = writer.register_channel(name, "json", schema)
        return made

    def packed(
        self, topic: WrittenTopic, times: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
    ) -> list[bytes]:
        for number, x in zip(topic.channels, values.values(), strict=True):
            if x.dtype.kind == "f" and np.isinf(x).any():
                label = self.recording.channels[number].label
                raise ParameterError(
                    f"channel {label!r} has infinities, which JSON does not hold; write messages "
                    "of ROS 2 (schema='ros2')"
                )
        stamps = map(_Stamp, (times // 10**9).tolist(), (times % 10**9).tolist())
        row = self.rows[topic.name]
        return [*map(self.encode, map(row, stamps, *(x.tolist() for x in values.values())))]

    def event(self, time_ns: int, event: Event) -> bytes:
        sec, nsec = divmod(time_ns, 10**9)
        return self.encode(
            {
                "timestamp": {"sec": sec, "nsec": nsec}, "level": _INFO_FOXGLOVE,
                "message": _utf8(event.text), "name": _utf8(event.layer), "file": "", "line": 0,
            }
        )  # fmt: skip


def _utf8(text: str) -> str:
    """Without lone surrogates."""
    return text.encode("utf-8", "replace").decode("utf-8")


def _batches(
    recording: Recording, topic: WrittenTopic, zero_ns: int, packing: _Packing
) -> Iterator[_Batch]:
    samples = [_Samples(recording.channels[number]) for number in topic.channels]
    for first, ticks in _tick_slices(topic):
        times = stamps_of(np.zeros(len(ticks), np.int64), ticks, topic.rate, zero_ns)
        values = {
            path: one.between(first, first + len(ticks))
            for path, one in zip(topic.paths, samples, strict=True)
        }
        yield _Batch(times, packing.packed(topic, times, values))


def _tick_slices(topic: WrittenTopic) -> Iterator[tuple[int, NDArray[np.int64]]]:
    """The ticks of a topic, some at a time, and the place of the first of them."""
    starts = np.array([span.start for span in topic.spans], np.int64)
    places = np.cumsum([0, *(span.ticks for span in topic.spans)])
    for first in range(0, int(places[-1]), _ROWS):
        rows = np.arange(first, min(first + _ROWS, int(places[-1])))
        span = np.searchsorted(places, rows, "right") - 1
        yield first, rows - places[span] + starts[span]


def _events(recording: Recording, zero_ns: int, packing: _Packing) -> Iterator[_Batch]:
    for event in in_order(recording.events):
        time_ns = zero_ns + int(event.time * 10**9)
        yield _Batch(np.array([time_ns]), [packing.event(time_ns, event)])


def _merged(
    sources: Sequence[Iterator[_Batch]],
) -> Iterator[tuple[list[int], list[int], list[bytes]]]:
    """The messages of all sources by time, some at once: their sources, times and bytes."""
    waiting: dict[int, _Batch] = {}
    left = dict(enumerate(sources))
    while left or waiting:
        for number in [n for n in left if n not in waiting]:
            batch = next(left[number], None)
            if batch is None:
                del left[number]
            else:
                waiting[number] = batch
        if not waiting:
            return
        # Up to here, no message of another batch can come earlier.
        end = min(int(batch.times[-1]) for batch in waiting.values())
        ready: list[tuple[int, _Batch]] = []
        for number, batch in [*waiting.items()]:
            count = int(np.searchsorted(batch.times, end, "right"))
            ready.append((number, _Batch(batch.times[:count], batch.messages[:count])))
            if count == len(batch.messages):
                del waiting[number]
            else:
                waiting[number] = _Batch(batch.times[count:], batch.messages[count:])
        yield _in_turn([one for one in ready if one[1].messages])


def _in_turn(ready: Sequence[tuple[int, _Batch]]) -> tuple[list[int], list[int], list[bytes]]:
    times = np.concatenate([batch.times for _, batch in ready])
    owners = np.repeat([n for n, _ in ready], [len(batch.messages) for _, batch in ready])
    messages = [message for _, batch in ready for message in batch.messages]
    if len(ready) == 1:
        return owners.tolist(), times.tolist(), messages
    order = np.argsort(times, kind="stable")
    return (
        owners[order].tolist(),
        times[order].tolist(),
        [messages[place] for place in order.tolist()],
    )
