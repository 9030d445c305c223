"""A stream -> calls of a recorder (docs/streams.md); the first bytes decide its kind.

* Lines of text: rows of samples, and objects in JSON.
* Binary frames: samples and objects.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import nan
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..descriptions import parse_json, read
from ..encoder.live import Input
from ..errors import ParameterError
from ..numbers import counted, double, plain_doubles
from ..recording import Calibration, spans_of
from ..structs import Meta, OneOf, Struct, keys_of
from ..times import may_be_times
from ..units import given_units, split_name, units_for
from .recorder import Recorder, check_range, owned

UNSET: Any = object()
"""A key that was not given, where null says something."""


class StreamKeys(Struct):
    """An object of a stream."""


class ChannelKeys(StreamKeys):
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
        given = vars(self) | {"unit": given_units([self.unit])[0]}
        if self.calibration is not None:
            given["calibration"] = Calibration(*self.calibration)
        return Input(**given)


class HeaderKeys(StreamKeys):
    """The object at the beginning of a stream."""

    channels: Annotated[tuple[ChannelKeys, ...], Meta(min_length=1)]
    metadata: dict[str, Any] = field(default_factory=dict)
    epoch_ns: int | Literal["now"] | None = UNSET
    epoch_uncertainty_ns: int = UNSET

    def made(self) -> Header:
        epoch = {"epoch_ns": self.epoch_ns, "epoch_uncertainty_ns": self.epoch_uncertainty_ns}
        given = {key: value for key, value in epoch.items() if value is not UNSET}
        return Header([each.made() for each in self.channels], self.metadata, given)


class Action(OneOf):
    """An object after the header; docs/streams.md says what each does."""

    __slots__ = ()


class Values(StreamKeys, Action):
    values: tuple[float | None, ...]
    channel: int | str
    tick: int | None = None


class Mark(StreamKeys, Action):
    mark: str
    time: float | None = None
    duration: float | None = None
    channel: int | str | None = None
    layer: str | None = None


class Clock(StreamKeys, Action):
    clock: str
    tick: int
    time_ns: int
    channel: int | str | None = None
    uncertainty_ns: int | None = None


class Add(StreamKeys, Action):
    add: ChannelKeys


class Skip(StreamKeys, Action):
    skip: int
    channel: int | str | None = None


class Flush(StreamKeys, Action):
    flush: Any


class More(StreamKeys, Action):
    metadata: dict[str, Any]


ACTIONS = (Values, Mark, Clock, Add, Skip, Flush, More)
Action.kinds = {next(iter(keys_of(kind))): kind for kind in ACTIONS}


@dataclass
class Header:
    """The header of a stream: its inputs, metadata and epoch."""

    inputs: list[Input]
    metadata: dict[str, Any] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)
    """The epoch, where it is given."""
    notes: list[str] = field(default_factory=list)
    """What a person may want to know of it."""


class StreamSession:
    """One stream, and the recorder that it begins with its header."""

    def __init__(self, begin: Callable[[Header], Recorder]) -> None:
        self.begin = begin
        self.recorder: Recorder | None = None
        self.tick = 0
        """Tick of the next row."""
        self.unused: list[str] = []
        """Options that only a stream without a header uses."""

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
            header = read(HeaderKeys, given).made()
            header.notes.extend(
                f"{option} does nothing here: the header of the stream describes the channels"
                for option in self.unused
            )
            self.start(header)
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
        self.refuse_rates()
        inputs = recorder.inputs
        counts = [p for p, given in enumerate(inputs) if given.takes_counts]
        floats = [p for p, given in enumerate(inputs) if not given.takes_counts]
        rest = values if not counts else values[:, floats]
        if counts:
            chosen = values[:, counts]
            missing = np.isnan(chosen)
            if chosen.dtype.kind == "f":
                chosen = whole(np.where(missing, 0, chosen))
            # All are checked before some are taken.
            check_range(chosen, [inputs[place] for place in counts])
            if floats:
                owned(rest, [inputs[place] for place in floats])
            if not missing.any():
                recorder.write_rows(chosen, start, counts)
            else:
                for place in counts:
                    self.counts(place, values[:, place], start)
        if floats:
            recorder.write_rows(rest, start, floats)
        self.tick = start + len(values)

    def refuse_rates(self) -> None:
        """Rows are for channels of one rate."""
        if len({given.rate for given in self.running.inputs}) > 1:
            raise ParameterError(
                "rows are for channels of one rate: give the values of each channel"
            )

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


LINE_SIZE = 1 << 24
"""A longer line is refused, not collected."""

TICK_DIGITS = 19
"""More than any tick has; Python refuses to read thousands of them."""

DECIMAL = re.compile(rb"[+-]?\d*[.,]?\d+(e[+-]?\d+)?", re.I)
"""A number with a decimal point or comma."""


OnBadLine = Literal["gap", "stop"]
"""What to do with a line that cannot be used; a gap is a row without samples."""

ALMOST = re.compile(r"[+-]?0x[0-9a-f]+", re.I)
"""Besides what float() takes: numbers that are none here, and no names of columns either."""


@dataclass(frozen=True)
class BareTable:
    """What is known of a bare table of numbers, which has no header."""

    rate: Fraction | None = None
    labels: Sequence[str] = ()
    unit: str | None = None
    lsb: float | None = None

    def header(self, names: Sequence[str] = (), columns: int = 0) -> Header:
        """The header for columns of these names, or for ``columns`` of them without names."""
        if self.rate is None:
            raise ParameterError("a table needs its rate: --rate 1000, or a header of JSON")
        given = [split_name(name) for name in names]
        labels = list(self.labels) or [label for label, _ in given]
        labels = labels or [str(number + 1) for number in range(columns)]
        if len(labels) != (columns or len(names)):
            raise ParameterError(
                f"{len(labels)} labels for {columns or len(names)} columns: --labels a,b,c"
            )
        if self.unit is not None:
            units = units_for(self.unit, len(labels))
        else:
            units = given_units(unit for _, unit in given) or ["1"] * len(labels)
        notes = []
        if len(names) > 1 and may_be_times(names[0]):
            notes.append(
                f"column {names[0]!r} is recorded as a channel; hapfmt encode places rows by their "
                "times"
            )
        return Header(
            [
                Input(label, self.rate, unit, lsb=self.lsb)
                for label, unit in zip(labels, units, strict=True)
            ],
            notes=notes,
        )


@dataclass
class PendingRows:
    """Lines of numbers that follow on, not parsed yet."""

    lines: list[bytes] = field(default_factory=list)
    number: int = 0
    tick: int | None = None


class LineStream:
    """Takes bytes in pieces of any size; whole lines are worked off at the end of each piece."""

    def __init__(self, session: StreamSession, table: BareTable, on_bad_line: OnBadLine) -> None:
        self.session, self.table, self.on_bad_line = session, table, on_bad_line
        self.rest = b""
        self.number = 0
        self.rows = PendingRows()
        self.bad_count = 0
        self.first_bad = ""

    @property
    def place(self) -> str:
        return f"line {self.number}"

    def feed(self, data: bytes) -> None:
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in lines:
            self.line(line)
        self.settle()
        if len(self.rest) > LINE_SIZE:
            self.number += 1
            raise ParameterError(f"a line of more than {LINE_SIZE} bytes")

    def finish(self) -> None:
        """The last line may have no end."""
        if self.rest:
            self.line(self.rest)
        self.rest = b""
        self.settle()

    def check(self, error: ParameterError) -> None:
        """Count a line that cannot be used; raise the error where the recording ends."""
        recorder = self.session.recorder
        if error.path is not None or (recorder and recorder.queue.error):
            raise error
        if self.on_bad_line == "stop":
            raise ParameterError(
                f"{error.message}; to go on after such a line: on_bad_line='gap'"
            ) from error
        self.bad_count += 1
        self.first_bad = self.first_bad or f"{self.place}: {error.message}"

    def line(self, line: bytes) -> None:
        line = line.strip(b" \r")
        self.number += 1
        if not line or line.startswith(b"#"):
            return
        if line.startswith(b"{"):
            self.settle()
            try:
                self.session.object(parse_json(line))
            except ParameterError as error:
                if self.session.recorder is None:
                    raise
                self.check(error)
            return
        if self.session.recorder is None and self.begin(line):
            return
        tick = None
        if line.startswith(b"@"):
            self.settle()
            head, _, line = line[1:].partition(b" ")
            if not head.isdigit() or len(head) > TICK_DIGITS or not line.strip():
                self.check(ParameterError("@ is followed by a tick, a space, and a row"))
                return
            tick = int(head)
        if not self.rows.lines:
            self.rows.number, self.rows.tick = self.number, tick
        elif self.number != self.rows.number + len(self.rows.lines):
            # A comment was between them, and errors count lines.
            self.settle()
            self.rows.number = self.number
        self.rows.lines.append(line)

    def begin(self, line: bytes) -> bool:
        """The recorder of a bare table; whether its first line holds names, or is left out."""
        line = line.partition(b" ")[2] if line.startswith(b"@") else line
        cells = [cell.strip() for cell in fields_of(line)]
        numbers = [is_number(cell) for cell in cells]
        refuse_commas(line)
        # A program that is joined amid a line sends its rest first.
        known = self.table.labels if self.on_bad_line == "gap" else ()
        is_row = all(numbers)
        if is_row or (known and (len(cells) != len(known) or any(numbers))):
            try:
                parse_row(line, len(known or cells))
            except ParameterError as error:
                if not known:
                    raise
                self.check(error)
                return True
        self.session.start(self.table.header(*((), len(cells)) if is_row else (cells,)))
        return not is_row

    def settle(self) -> None:
        """Hand over the rows that were collected."""
        rows, self.rows = self.rows, PendingRows()
        if not rows.lines:
            return
        last, columns = self.number, len(self.session.running.inputs)
        self.session.refuse_rates()
        values: list[list[float]] = []
        for place, line in enumerate(rows.lines):
            self.number = rows.number + place
            try:
                values.append(parse_row(line, columns))
            except ParameterError as error:
                if self.on_bad_line == "stop":
                    self.hand_over(values, rows)
                    self.number = rows.number + place
                    refuse_commas(line)
                self.check(error)
                values.append([nan] * columns)
        self.hand_over(values, rows)
        self.number = last

    def hand_over(self, values: list[list[float]], rows: PendingRows) -> None:
        if not values:
            return
        array, recorder = np.array(values), self.session.running
        self.number, taken = rows.number, recorder.taken
        try:
            self.session.rows(array, rows.tick)
        except ParameterError:
            if recorder.taken > taken:
                raise
            # One of them is at fault: the others are kept.
            for place, row in enumerate(array):
                self.number = rows.number + place
                tick = rows.tick if place == 0 else None
                try:
                    self.session.rows(row[None], tick)
                except ParameterError as error:
                    self.check(error)
                    self.session.tick += tick is None


def refuse_commas(line: bytes) -> None:
    """Decimal commas, which would be taken for commas between numbers, and the rest for names.

    "0,25" alone is two numbers; next to a semicolon, a tab or a space it is one.
    """
    for separator in (b";", b"\t", None):
        cells = [cell.strip() for cell in line.split(separator)]
        cells = [cell for cell in cells if cell]
        odd = [cell for cell in cells if b"," in cell]
        if len(cells) > 1 and odd and all(DECIMAL.fullmatch(cell) for cell in cells):
            raise ParameterError(
                f"{odd[0].decode()!r} has a decimal comma; write decimal points, as in 1.5"
            )


def fields_of(line: bytes) -> list[str]:
    text = line.decode("utf-8", "replace")
    for separator in (",", ";", "\t"):
        if separator in text:
            return text.split(separator)
    return text.split()


def parse_row(line: bytes, columns: int) -> list[float]:
    """The numbers of a row, nan where a field is empty; ParameterError says what is wrong."""
    found = fields_of(line)
    if len(found) != columns:
        raise ParameterError(f"{len(found)} values for {columns} channels")
    values = plain_doubles(found) if line.isascii() and b"_" not in line else None
    return values or [double(cell.strip()) if cell.strip() else nan for cell in found]


def is_number(cell: str) -> bool:
    """True if a cell of a first line cannot name a column: it is empty, or resembles a number."""
    try:
        return not cell or bool(ALMOST.fullmatch(cell)) or float(cell) is not None
    except ValueError:
        return False


MAGIC = b"hFr1"
HEADER = struct.Struct("<4sBBHqII")
"""Magic, type, number format, channel, tick, count, size of the payload."""

OBJECT, SAMPLES, ROWS = range(3)
FORMATS = {1: "<i2", 2: "<i4", 3: "<f4", 4: "<f8"}
GO_ON = -1
"""In place of a tick: where the last sample ended."""

PAYLOAD_SIZE = 1 << 26
"""A longer frame is refused, not collected."""


def build_frame(
    type_: int,
    payload: bytes,
    *,
    number_format: int = 0,
    channel: int = 0,
    tick: int = GO_ON,
    count: int = 0,
) -> bytes:
    head = HEADER.pack(MAGIC, type_, number_format, channel, tick, count, len(payload))
    return head + payload


class Frames:
    """Takes bytes in pieces of any size; whole frames are worked off."""

    def __init__(self, session: StreamSession) -> None:
        self.session = session
        self.rest = bytearray()
        self.offset = 0

    @property
    def place(self) -> str:
        return f"byte {self.offset}"

    def feed(self, data: bytes) -> None:
        self.rest += data
        at = 0
        try:
            while len(self.rest) - at >= HEADER.size:
                magic, type_, format_, channel, tick, count, size = HEADER.unpack_from(
                    self.rest, at
                )
                if magic != MAGIC:
                    raise ParameterError("no frame begins here")
                if size > PAYLOAD_SIZE:
                    raise ParameterError(f"a frame of {size} bytes, above {PAYLOAD_SIZE}")
                stop = at + HEADER.size + size
                if len(self.rest) < stop:
                    break
                payload = bytes(memoryview(self.rest)[at + HEADER.size : stop])
                self.frame(type_, format_, channel, tick, count, payload)
                self.offset += stop - at
                at = stop
        finally:
            del self.rest[:at]

    def finish(self) -> None:
        if self.rest:
            raise ParameterError(f"the stream ends within a frame, {len(self.rest)} bytes into it")

    def frame(
        self, type_: int, format_: int, channel: int, tick: int, count: int, payload: bytes
    ) -> None:
        if type_ == OBJECT:
            self.session.object(parse_json(payload))
            return
        if type_ not in (SAMPLES, ROWS) or format_ not in FORMATS or tick < GO_ON:
            raise ParameterError(f"a frame of type {type_}, number format {format_}, tick {tick}")
        inputs = self.session.running.inputs
        columns = 1 if type_ == SAMPLES else len(inputs)
        dtype = np.dtype(FORMATS[format_])
        if len(payload) != count * columns * dtype.itemsize:
            raise ParameterError(f"{len(payload)} bytes are not {count} times {columns} samples")
        values = np.frombuffer(payload, dtype)
        start = None if tick == GO_ON else tick
        if type_ == SAMPLES:
            self.session.samples(channel, values, start)
        else:
            self.session.rows(values.reshape(count, columns), start)


class InputStream:
    """Takes bytes in pieces of any size. ``begin`` makes the recorder once the channels are known.

    ``on_bad_line``: what to do with a line that cannot be used; None: the ``usual``.

    Errors of the stream say where: a line, or the byte where a frame begins. What came before is
    with the recorder.
    """

    def __init__(
        self,
        begin: Callable[[Header], Recorder],
        table: BareTable | None = None,
        on_bad_line: OnBadLine | None = None,
        *,
        usual: OnBadLine = "stop",
    ) -> None:
        self.session = StreamSession(begin)
        self.table, self.on_bad_line, self.usual = table or BareTable(), on_bad_line, usual
        self.session.unused = [
            f"--{name}" for name, value in vars(self.table).items() if value not in (None, ())
        ]
        self.first = b""
        self.parser: LineStream | Frames | None = None

    @property
    def recorder(self) -> Recorder | None:
        return self.session.recorder

    @property
    def bad_lines(self) -> tuple[int, str]:
        """The number of lines that were left out, and the error of the first."""
        parser = self.parser
        return (parser.bad_count, parser.first_bad) if isinstance(parser, LineStream) else (0, "")

    def feed(self, data: bytes) -> None:
        if self.parser is None:
            self.first += data
            if len(self.first) < len(MAGIC) and MAGIC.startswith(self.first):
                return
            self.choose()
            data, self.first = self.first, b""
        assert self.parser is not None
        self.work(lambda parser: parser.feed(data))

    def choose(self) -> None:
        binary = self.first.startswith(MAGIC)
        if not binary:
            self.parser = LineStream(self.session, self.table, self.on_bad_line or self.usual)
            return
        if self.on_bad_line is not None:
            raise ParameterError("frames have no lines: leave out on_bad_line")
        self.parser = Frames(self.session)

    def finish(self) -> None:
        """The stream has ended."""
        if self.parser is None:
            self.choose()
            first = self.first
            self.work(lambda parser: parser.feed(first))
        self.work(lambda parser: parser.finish())
        if self.recorder is None:
            raise ParameterError("the stream ended before any channel was named")

    def close(self) -> None:
        """Close the recorder; the file says how many lines were left out."""
        if self.recorder is None:
            return
        count, first = self.bad_lines
        if count:
            notes = self.recorder.metadata.get("notes", [])
            text = f"{counted(count, 'line')} of the stream could not be used; the first: {first}"
            self.recorder.metadata["notes"] = [*(notes if isinstance(notes, list) else []), text]
        self.recorder.close()

    def work(self, step: Callable[[LineStream | Frames], None]) -> None:
        assert self.parser is not None
        try:
            step(self.parser)
        except ParameterError as error:
            if error.path is not None:
                # The error of the output file has its path.
                raise
            raise StreamError(f"{self.parser.place}: {error.message}") from error


class StreamError(ParameterError):
    """What a stream says makes no sense."""
