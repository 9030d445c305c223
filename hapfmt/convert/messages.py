"""Files of messages in topics (bags, MCAP) -> channels, in two passes.

The first pass takes the times of all messages and learns which numbers they hold. The second one
yields the values. A topic becomes a table; a topic without a rate, or of texts, becomes events.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from fractions import Fraction
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..clocks import ClockObservation
from ..errors import LimitError, ParameterError, similar
from ..numbers import counted
from ..recording import Calibration, Event
from ..units import to_ucum
from .common import several_rates
from .formats import ReadOptions
from .ros_types import COVARIANCE, JOINTS, NOT_READ, TEXTS, TOPICS, meaning, plain
from .tables import Import, ImportBlock, ImportColumn, ImportTable
from .timestamps import (
    Placed,
    align,
    observations,
    place,
    place_at_need,
    stamp_channel,
    stamp_label,
)

ROWS = 2048
"""Messages of a topic that are decoded at a time, unless they are large."""
_BLOCK_SIZE = 8 << 20
"""Bytes of messages that are decoded at a time."""
_ARRAY_LIMIT = 256
"""Numbers of an array that become channels; longer ones are data of another kind."""
_EVENT_LIMIT = 1 << 17
_FEW_ROWS = 64
_UNIX_NS = 10**18
"""About the year 2001: stamps below count from something else, such as the start of a program."""
_OTHER_CLOCK_NS = 86_400 * 10**9
"""Header stamps and log times of one recording are nearer to each other than a day."""
_STAMPS = ("header.stamp", "timestamp", "stamp", "header.timestamp", "time")
"""Paths of the time at which a message was made, the first one that there is."""


_SEQUENCE = "header.seq"
_FRAME = "header.frame_id"
_FRAME_LIMIT = 64
"""Frames of a topic that become topics of their own."""
_IN_TURN = 0.05
"""Share of messages with another frame than the one before, where frames take turns."""


class MessageNumber(Protocol):
    """A number of every message, or an array of ``length`` numbers."""

    @property
    def dtype(self) -> np.dtype[Any]: ...
    @property
    def length(self) -> int | None: ...
    @property
    def owners(self) -> Sequence[tuple[str, str]]: ...
    @property
    def is_time(self) -> bool: ...


class DecodedMessages(Protocol):
    """Some messages, decoded: ``rows`` of those that were given."""

    @property
    def rows(self) -> NDArray[np.intp]: ...
    @property
    def numbers(self) -> Mapping[str, MessageNumber]: ...
    @property
    def texts(self) -> Mapping[str, Any]: ...
    def values(self, path: str) -> NDArray[Any]: ...
    def text(self, path: str, row: int) -> str: ...
    def is_constant(self, path: str) -> bool: ...


class MessageDecoder(Protocol):
    def parts(self, messages: Sequence[bytes]) -> Iterator[DecodedMessages]: ...


@dataclass(frozen=True)
class Topic:
    """Messages of one publisher. ``decoder`` None: they cannot be decoded, for this ``reason``.

    ``publisher`` names it where several send on one topic. ``units`` are texts, by path.
    """

    name: str
    kind: str
    decoder: MessageDecoder | None
    reason: str = ""
    publisher: str = ""
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        return f"{self.name} ({self.publisher})" if self.publisher else self.name


class TopicMessage(NamedTuple):
    topic: int
    log_ns: int
    number: int
    """Sequence number; the same in all messages where the file has none."""
    data: bytes


class MessageFile(Protocol):
    @property
    def counts_all(self) -> bool:
        """Whether the sequence numbers count the messages of all topics together; known after a
        pass over the messages."""

    @property
    def topics(self) -> Sequence[Topic]: ...

    def messages(self, wanted: set[int]) -> Iterator[TopicMessage]:
        """In the order of the file, those of the wanted topics."""


class _TopicColumn(NamedTuple):
    path: str
    place: int | None
    """In an array; None: it is none."""
    description: ImportColumn


@dataclass
class _TopicScan:
    """What the first pass finds out of a topic."""

    topic: Topic
    logs: array[int] = field(default_factory=lambda: array("q"))
    sequence: array[int] = field(default_factory=lambda: array("Q"))
    stamps: list[NDArray[np.int64]] = field(default_factory=list)
    counts: list[NDArray[np.int64]] = field(default_factory=list)
    """The sequence numbers of headers."""
    stamp_path: str | None = None
    is_first: bool = True
    numbers: dict[str, MessageNumber] = field(default_factory=dict)
    varying: dict[str, set[int]] = field(default_factory=dict)
    some: set[str] = field(default_factory=set)
    """Paths of numbers that not all messages have."""
    texts: dict[str, str | None] = field(default_factory=dict)
    """None: it changes."""
    frames: dict[str, int] = field(default_factory=dict)
    """Number of each frame_id, in order of arrival."""
    frame_of: array[int] = field(default_factory=lambda: array("H"))
    """The number of the frame of each message."""

    def add(self, messages: Sequence[bytes]) -> None:
        assert self.topic.decoder is not None
        stamps = np.zeros(len(messages), np.int64)
        counts: NDArray[np.int64] | None = None
        frames = np.zeros(len(messages), np.uint16)
        for part in self.topic.decoder.parts(messages):
            self._learn(part)
            if _FRAME in part.texts:
                frames[part.rows] = self._frames(part)
            if self.stamp_path in part.numbers:
                assert self.stamp_path is not None
                stamps[part.rows] = part.values(self.stamp_path)
            if _SEQUENCE in part.numbers and part.numbers[_SEQUENCE].length is None:
                counts = np.zeros(len(messages), np.int64) if counts is None else counts
                counts[part.rows] = part.values(_SEQUENCE)
        self.stamps.append(stamps)
        self.frame_of.frombytes(frames.tobytes())
        if counts is not None:
            self.counts.append(counts)

    def _frames(self, part: DecodedMessages) -> int | list[int]:
        if part.is_constant(_FRAME):
            return self._frame(part.text(_FRAME, 0))
        return [self._frame(part.text(_FRAME, row)) for row in range(len(part.rows))]

    def _frame(self, name: str) -> int:
        """Frames beyond the limit share a number."""
        if len(self.frames) > _FRAME_LIMIT:
            return self.frames.get(name, _FRAME_LIMIT)
        return self.frames.setdefault(name, len(self.frames))

    def by_frame(self) -> dict[int, _TopicScan]:
        """One for the number of each frame_id where they take turns, as those of several
        publishers do, else {}."""
        of = np.array(self.frame_of)
        turns = np.count_nonzero(np.diff(of))
        if not (1 < len(self.frames) <= _FRAME_LIMIT and turns > _IN_TURN * of.size + 1):
            return {}
        counts = np.concatenate(self.counts) if self.counts else np.zeros(0, np.int64)
        found = {}
        for name, number in sorted(self.frames.items()):
            rows = of == number
            publisher = ", ".join(text for text in (self.topic.publisher, name) if text)
            found[number] = replace(
                self,
                topic=replace(self.topic, publisher=publisher),
                logs=array("q", np.array(self.logs)[rows].tobytes()),
                sequence=array("Q", bytes(8 * np.count_nonzero(rows))),
                stamps=[np.concatenate(self.stamps)[rows]],
                counts=[counts[rows]] if counts.size == rows.size else [],
                texts={**self.texts, _FRAME: name},
                frames={name: 0},
            )
        return found

    def _learn(self, part: DecodedMessages) -> None:
        if self.is_first:
            self.stamp_path = next(
                (p for p in _STAMPS if p in part.numbers and part.numbers[p].is_time), None
            )
        else:
            self.some |= self.numbers.keys() ^ part.numbers.keys()
        for path, number in part.numbers.items():
            known = self.numbers.setdefault(path, number)
            if known.length != number.length:
                self.varying.setdefault(path, {known.length or 0}).add(number.length or 0)
            if known.dtype.newbyteorder("=") != number.dtype.newbyteorder("="):
                wider = np.promote_types(known.dtype, number.dtype)
                self.numbers[path] = _WidenedNumber(
                    wider, known.length, known.owners, known.is_time
                )
        for path in self.texts.keys() - part.texts.keys():
            self.texts[path] = None
        for path in part.texts:
            same = part.is_constant(path)
            now = part.text(path, 0) if same else None
            self.texts[path] = now if self.is_first or self.texts.get(path, now) == now else None
        self.is_first = False


class _SplitFile:
    """A file whose topics are split by their frames. ``numbers``: of the topic of each frame."""

    def __init__(self, file: MessageFile) -> None:
        self.file = file
        self.topics = list(file.topics)
        self.numbers: dict[int, dict[int, int]] = {}
        self.frame_of: dict[int, Sequence[int]] = {}

    @property
    def counts_all(self) -> bool:
        return self.file.counts_all

    def split(self, number: int, scan: _TopicScan) -> dict[int, _TopicScan]:
        parts = scan.by_frame()
        if not parts:
            return {number: scan}
        self.frame_of[number] = scan.frame_of
        first = len(self.topics)
        self.numbers[number] = {frame: first + place_ for place_, frame in enumerate(parts)}
        self.topics += [part.topic for part in parts.values()]
        return dict(enumerate(parts.values(), start=first))

    def messages(self, wanted: set[int]) -> Iterator[TopicMessage]:
        whole = {number for number, own in self.numbers.items() if wanted & {*own.values()}}
        done = dict.fromkeys(whole, 0)
        for message in self.file.messages((wanted | whole) & set(range(len(self.file.topics)))):
            number = message.topic
            if number not in done:
                yield message
                continue
            row = done[number]
            done[number] += 1
            if row >= len(self.frame_of[number]):
                raise ParameterError("the rows of the file changed while it was read")
            part = self.numbers[number][self.frame_of[number][row]]
            if part in wanted:
                yield message._replace(topic=part)


class _WidenedNumber(NamedTuple):
    dtype: np.dtype[Any]
    length: int | None
    owners: Sequence[tuple[str, str]]
    is_time: bool


def read_messages(
    file: MessageFile,
    options: ReadOptions,
    *,
    metadata: Mapping[str, Any] | None = None,
    attachments: Mapping[str, tuple[str, bytes]] | None = None,
    notes: Sequence[str] = (),
) -> Import:
    """The channels and events of a file."""
    return _MessageReading(file, options, list(notes)).found(metadata or {}, attachments or {})


class _MessageReading:
    def __init__(self, file: MessageFile, options: ReadOptions, notes: list[str]) -> None:
        self.file = _SplitFile(file)
        self.options = options
        self.notes: list[tuple[str, str]] = [("", note) for note in notes]
        """With the title of the topic, where it is of one."""

    def note(self, topic: Topic, text: str) -> None:
        self.notes.append((topic.title, text))

    def notes_of(self, titles: set[str]) -> tuple[str, ...]:
        if not self.options.select:
            return tuple(note for _, note in self.notes)
        return tuple(note for title, note in self.notes if not title or title in titles)

    def is_named(self, topic: Topic) -> bool:
        """Whether it is selected by its name, or nothing is selected."""
        patterns = self.options.select
        return not patterns or any(_matches(topic, pattern) for pattern in patterns)

    def found(
        self, metadata: Mapping[str, Any], attachments: Mapping[str, tuple[str, bytes]]
    ) -> Import:
        if self.options.clock not in (None, "header", "log"):
            raise ParameterError(
                f"messages have the clocks header and log, not {self.options.clock!r}"
            )
        scans = self.scanned(self.chosen_topics())
        placed: dict[int, Placed] = {}
        stamps: dict[int, NDArray[np.int64]] = {}
        clocks: dict[int, str] = {}
        columns: dict[int, list[_TopicColumn]] = {}
        eventful: list[int] = []
        takes_rate = False
        is_one = sum(bool(s.logs) and plain(s.topic.kind) not in TEXTS for s in scans.values()) == 1
        for number, scan in scans.items():
            if not scan.logs:
                self.note(scan.topic, f"topic {scan.topic.title} has no messages")
                continue
            clocks[number], stamps[number] = self.stamps_of(scan)
            is_text = plain(scan.topic.kind) in TEXTS
            if not is_text:
                columns[number] = self.columns_of(scan)
            where, is_given = None, False
            if columns.get(number):
                name, sequence = f"topic {scan.topic.title}", self.sequence_of(scan)
                if is_one and self.options.rate is not None:
                    is_given = True
                    where = place(
                        stamps[number], name=name, rate=self.options.rate, sequence=sequence
                    )
                else:
                    where, is_given = place_at_need(
                        stamps[number], self.options.rate, name=name, sequence=sequence
                    )
            takes_rate |= is_given
            if where is not None and (is_given or not _is_sparse(where)):
                placed[number] = where
                continue
            has_columns = bool(columns.pop(number, None))
            if is_text or has_columns or scan.numbers.keys() <= {scan.stamp_path, _SEQUENCE}:
                eventful.append(number)
            if has_columns:
                self.note(
                    scan.topic,
                    f"topic {scan.topic.title} has no steady rate; its "
                    f"{counted(len(scan.logs), 'message')} are events",
                )
        if self.options.rate is not None and placed and not takes_rate:
            raise several_rates()
        self.check_clocks(clocks, stamps)
        eventful = [number for number in eventful if self.is_named(scans[number].topic)]
        events = self.raw_events(eventful, scans, stamps)
        first = min((time_ns for time_ns, _, _ in events), default=None)
        order = [*placed]
        anchors = [placed[number] for number in order]
        if first is not None:
            anchors.append(Placed(Fraction(1), np.zeros(1, np.int64), first, (), 0, 0.0))
        epoch_ns, starts = align(anchors)
        epoch = epoch_ns if epoch_ns >= _UNIX_NS else None
        names = self.prefixes(order, scans, columns)
        tables = [
            self.table(scans[n], placed[n], start, columns[n], names[n], clocks[n])
            for n, start in zip(order, starts[: len(order)], strict=True)
        ]
        selected = self.selected(tables, [scans[n].topic for n in order])
        chosen = [place_ for place_, wanted in enumerate(selected) if wanted]
        order = [order[place_] for place_ in chosen]
        tables = [tables[place_] for place_ in chosen]
        selected = [selected[place_] for place_ in chosen]
        titles = {scans[n].topic.title for n in scans if self.is_named(scans[n].topic)}
        titles |= {scans[n].topic.title for n in order}
        reading = _SecondPass(self.file, order, scans, columns, selected)
        extra = []
        if self.options.keep_stamps:
            for place_, number in enumerate(order):
                extra.append(
                    stamp_channel(
                        placed[number], stamps[number], epoch or 0, tables[place_].start_tick
                    )
                )
                one = tables[place_]
                label = stamp_label(scans[number].topic.title, len(order))
                column = ImportColumn(label, "ns", dtype=np.dtype(np.int64))
                tables[place_] = replace(one, columns=(*one.columns, column))
                selected[place_].append(len(one.columns))
        reading.extra = extra
        final = []
        for table, wanted in zip(tables, selected, strict=True):
            final.append(replace(table, columns=tuple(table.columns[c] for c in wanted)))
        reading.tables = final
        found = Import(
            tables=tuple(final),
            blocks=reading.blocks,
            epoch_ns=epoch,
            metadata=metadata,
            attachments=attachments,
            events=tuple(
                Event(Fraction(time_ns - epoch_ns, 10**9), text, layer=layer)
                for time_ns, text, layer in events
            ),
            notes=self.notes_of(titles),
            clocks=tuple(self.observed(order, scans, placed, final)),
        )
        labels = iter(found.labels)
        topics: dict[str, list[str]] = {}
        for n, table in zip(order, final, strict=True):
            own = topics.setdefault(scans[n].topic.name, [])
            own += [next(labels) for _ in table.columns]
        return replace(found, metadata={**({TOPICS: topics} if topics else {}), **metadata})

    @staticmethod
    def observed(
        order: Sequence[int],
        scans: Mapping[int, _TopicScan],
        placed: Mapping[int, Placed],
        tables: Sequence[ImportTable],
    ) -> Iterator[ClockObservation]:
        """Observations of the clocks "header" and "log", by the first channel of each topic."""
        first = 0
        for number, table in zip(order, tables, strict=True):
            if table.columns:
                scan = scans[number]
                stamps = {"header": np.concatenate(scan.stamps), "log": np.array(scan.logs)}
                for clock, own in stamps.items():
                    if own.any():
                        for each in observations(
                            placed[number], own, clock, table.start_tick, first
                        ):
                            yield ClockObservation(*each)
            first += len(table.columns)

    # selection

    def chosen_topics(self) -> set[int]:
        topics = self.file.topics
        able = {n for n, topic in enumerate(topics) if self.is_read(topic)}
        patterns = self.options.select
        named = {p: {n for n, t in enumerate(topics) if _matches(t, p)} for p in patterns}
        if patterns and all(named.values()):
            asked = set().union(*named.values())
            for n in sorted(asked - able):
                self.note(topics[n], self.why_not(topics[n]))
            return asked & able
        for n, topic in enumerate(topics):
            if n not in able:
                self.note(topic, self.why_not(topic))
        return able

    @staticmethod
    def is_read(topic: Topic) -> bool:
        return topic.decoder is not None and plain(topic.kind) not in NOT_READ

    @staticmethod
    def why_not(topic: Topic) -> str:
        what = NOT_READ.get(plain(topic.kind))
        name = f"{topic.title} ({topic.kind})" if topic.kind else topic.title
        if what is not None:
            return f"{what} of topic {name} are not read"
        return f"topic {name} is not read: {topic.reason}"

    def selected(self, tables: Sequence[ImportTable], topics: Sequence[Topic]) -> list[list[int]]:
        """The columns of each table that are wanted."""
        patterns = self.options.select
        if not patterns:
            return [[*range(len(table.columns))] for table in tables]
        used: set[str] = set()
        found: list[list[int]] = []
        for table, topic in zip(tables, topics, strict=True):
            whole = {p for p in patterns if _matches(topic, p)}
            used |= whole
            own = []
            for n, column in enumerate(table.columns):
                hits = {p for p in patterns if fnmatchcase(column.label, p)}
                used |= hits
                if whole or hits:
                    own.append(n)
            found.append(own)
        used |= {p for p in patterns if any(_matches(t, p) for t in self.file.topics)}
        for pattern in patterns:
            if pattern not in used:
                known = [
                    *dict.fromkeys(t.name for t in self.file.topics),
                    *(column.label for table in tables for column in table.columns),
                ]
                near = similar(pattern, known, 0.6)
                hint = f"; did you mean {near!r}? There are" if near else "; there are"
                listed = ", ".join(known[:20]) + (" ..." if len(known) > 20 else "")
                raise ParameterError(f"no topic or channel is called {pattern!r}{hint}: {listed}")
        return found

    # first pass

    def scanned(self, wanted: set[int]) -> dict[int, _TopicScan]:
        scans = {n: _TopicScan(self.file.topics[n]) for n in sorted(wanted)}
        broken: set[int] = set()
        left = self.options.max_memory // 32

        def learn(number: int, messages: Sequence[TopicMessage]) -> None:
            if number in broken:
                return
            scan = scans[number]
            try:
                scan.add([message.data for message in messages])
            except LimitError as error:
                broken.add(number)
                self.note(scan.topic, f"topic {scan.topic.title} is not read: {error}")
                return
            except ParameterError as error:
                raise ParameterError(f"topic {scan.topic.title}: {error}") from error
            scan.logs.extend([message.log_ns for message in messages])
            scan.sequence.extend([message.number for message in messages])

        for number, messages in batches(self.file.messages(wanted)):
            left -= len(messages)
            if left < 0:
                raise LimitError(
                    f"the times of the messages take more than the {self.options.max_memory} "
                    "bytes allowed; allow more (max_memory=) or select topics (select=)"
                )
            learn(number, messages)
        found: dict[int, _TopicScan] = {}
        for n, scan in scans.items():
            if n not in broken:
                parts = self.file.split(n, scan)
                found |= parts
                if n not in parts:
                    names = " and ".join(repr(name) for name in sorted(scan.frames))
                    text = f"on topic {scan.topic.title} the frames {names} take turns; each has "
                    for part in parts.values():
                        self.note(part.topic, f"{text}channels of its own")
        self.note_publishers(found)
        return found

    def note_publishers(self, scans: Mapping[int, _TopicScan]) -> None:
        senders: dict[str, list[Topic]] = {}
        for n, scan in scans.items():
            if n < len(self.file.file.topics) and scan.logs:
                senders.setdefault(scan.topic.name, []).append(scan.topic)
        for name, found in senders.items():
            if len(found) > 1 and any(topic.publisher for topic in found):
                text = f"{len(found)} publishers send on topic {name}; each has channels of its own"
                for topic in found:
                    self.note(topic, text)

    def stamps_of(self, scan: _TopicScan) -> tuple[str, NDArray[np.int64]]:
        logs = np.array(scan.logs, np.int64)
        stamps = np.concatenate(scan.stamps)
        if scan.stamp_path is None or not stamps.any():
            if scan.stamp_path is not None and self.options.clock != "log":
                self.note(
                    scan.topic,
                    f"the header stamps of topic {scan.topic.title} are all 0; its log times count",
                )
            return "log", logs
        return ("log", logs) if self.options.clock == "log" else ("header", stamps)

    def sequence_of(self, scan: _TopicScan) -> NDArray[Any] | None:
        """Numbers that count the messages of this topic: of the headers, else of the file."""
        share = 0.9
        if scan.counts:
            numbers = np.concatenate(scan.counts).astype(np.uint32)
            share = _IN_TURN
        elif self.file.counts_all:
            return None
        else:
            numbers = np.array(scan.sequence, np.uint32)
        steps = np.count_nonzero(np.diff(numbers))
        counts = numbers.size == len(scan.logs) and steps > share * len(scan.logs)
        return numbers if counts else None

    def check_clocks(
        self, clocks: Mapping[int, str], stamps: Mapping[int, NDArray[np.int64]]
    ) -> None:
        if self.options.clock == "header" and clocks and "header" not in clocks.values():
            raise ParameterError("no message has a header stamp; use the clock log (--clock log)")
        firsts = {
            kind: [int(np.median(stamps[n])) for n in clocks if clocks[n] == kind]
            for kind in ("header", "log")
        }
        if firsts["header"] and firsts["log"]:
            both = [*firsts["header"], *firsts["log"]]
            if max(both) - min(both) > _OTHER_CLOCK_NS:
                raise ParameterError(
                    "header stamps and log times come from clocks that differ by more than a day, "
                    "and some topics have log times only; use the log times of all (--clock log)"
                )

    # columns

    def columns_of(self, scan: _TopicScan) -> list[_TopicColumn]:
        topic = scan.topic
        found: list[_TopicColumn] = []
        noise, lengths, long = False, [], []
        for path, number in scan.numbers.items():
            if path in (scan.stamp_path, _SEQUENCE) or (
                path.startswith("layout.") and topic.kind.endswith("MultiArray")
            ):
                continue
            if COVARIANCE.search(path):
                noise = True
            elif path in scan.varying or (number.length is not None and path in scan.some):
                lengths.append(path)
            elif number.length is not None and number.length > _ARRAY_LIMIT:
                long.append((path, number.length))
            else:
                found += self.columns_at(scan, path, number)
        if noise:
            self.note(topic, f"covariances of topic {topic.title} are not read")
        for path in lengths:
            counts = sorted(scan.varying.get(path, {0}))
            self.note(
                topic,
                f"the array {path} of topic {topic.title} has {counts[0]} to {counts[-1]} values, "
                "and is not read",
            )
        for path, count in long:
            self.note(
                topic,
                f"the array {path} of topic {topic.title} has {count} values, and is not read",
            )
        if plain(topic.kind) == JOINTS and any(column.path == "position" for column in found):
            self.note(
                topic,
                f"the joints of topic {topic.title} count as hinges, with rad and N.m; the types "
                "of messages do not tell which of them slide",
            )
        texts = [p for p, t in scan.texts.items() if t is None and p != _FRAME]
        if texts and found:
            self.note(topic, f"texts of topic {topic.title} are not read: {', '.join(texts[:5])}")
        if _FRAME in scan.texts and scan.texts[_FRAME] is None:
            self.note(topic, f"the frame_id of topic {topic.title} changes, and is not kept")
        return found

    def columns_at(
        self, scan: _TopicScan, path: str, number: MessageNumber
    ) -> Iterator[_TopicColumn]:
        about, axis = meaning(number.owners)
        source = scan.topic.units.get(path, "")
        unit = "ns" if number.is_time else to_ucum(source) if source else about.unit
        dtype = np.dtype(np.int64) if number.is_time else number.dtype.newbyteorder("=")
        if path in scan.some and dtype.kind in "iu":
            dtype = np.dtype(np.float64)
        is_counts = (dtype.kind in "ib" and dtype.itemsize <= 4) or dtype in ("u1", "u2")
        if dtype.kind == "u" and not is_counts:
            dtype = np.dtype(np.uint64)
        places: Iterable[int | None] = [None] if number.length is None else range(number.length)
        for place_ in places:
            label = _label(scan, path, place_)
            group = label.rpartition(".")[0] if axis else ""
            yield _TopicColumn(
                path,
                place_,
                ImportColumn(
                    label,
                    unit,
                    about.quantity,
                    axis,
                    group,
                    device=scan.texts.get(_FRAME) or "",
                    calibration=Calibration() if is_counts else None,
                    dtype=np.dtype(np.int32) if is_counts else dtype,
                    source_unit=source,
                ),
            )

    @staticmethod
    def prefixes(
        order: Sequence[int],
        scans: Mapping[int, _TopicScan],
        columns: Mapping[int, Sequence[_TopicColumn]],
    ) -> dict[int, str]:
        """What precedes the labels of each topic: "" where no other topic has one of them."""
        owners: dict[str, set[int]] = {}
        for n in order:
            for column in columns[n]:
                owners.setdefault(column.description.label, set()).add(n)
        clashing = {n for own in owners.values() if len(own) > 1 for n in own}
        return {n: f"{scans[n].topic.title.strip('/')}." if n in clashing else "" for n in order}

    def table(
        self,
        scan: _TopicScan,
        where: Placed,
        start: int,
        columns: Sequence[_TopicColumn],
        prefix: str,
        clock: str,
    ) -> ImportTable:
        named = tuple(
            replace(
                column.description,
                label=f"{prefix}{column.description.label}",
                group=f"{prefix}{column.description.group}" if column.description.group else "",
            )
            for column in columns
        )
        kind = scan.topic.kind + (", log time" if clock == "log" else "")
        return ImportTable(
            name=scan.topic.title,
            columns=named,
            rate=where.rate,
            row_count=len(scan.logs),
            ticks=where.ticks,
            start_tick=start,
            kind=kind,
            notes=where.notes,
        )

    # events

    def raw_events(
        self,
        numbers: Sequence[int],
        scans: Mapping[int, _TopicScan],
        stamps: Mapping[int, NDArray[np.int64]],
    ) -> list[tuple[int, str, str]]:
        wanted = set(numbers)
        for number in numbers:
            if len(scans[number].logs) > _EVENT_LIMIT:
                wanted.discard(number)
                self.note(
                    scans[number].topic,
                    f"topic {scans[number].topic.title} has too many messages without a rate, "
                    f"{len(scans[number].logs)}; they are not read",
                )
        if not wanted:
            return []
        found: list[tuple[int, str, str]] = []
        row = dict.fromkeys(wanted, 0)
        left = self.options.max_memory
        for number, messages in batches(self.file.messages(wanted)):
            topic = scans[number].topic
            assert topic.decoder is not None
            texts = [""] * len(messages)
            for part in topic.decoder.parts([message.data for message in messages]):
                for place_, text in zip(part.rows.tolist(), _texts(topic, part), strict=True):
                    texts[place_] = text
            for offset, text in enumerate(texts):
                left -= len(text) + 200
                found.append((int(stamps[number][row[number] + offset]), text, topic.title))
            if left < 0:
                raise LimitError(
                    f"the events take more than the {self.options.max_memory} bytes allowed; "
                    "allow more (max_memory=) or select topics (select=)"
                )
            row[number] += len(messages)
        return sorted(found, key=lambda event: event[0])


class _SecondPass:
    """The second pass."""

    def __init__(
        self,
        file: MessageFile,
        order: Sequence[int],
        scans: Mapping[int, _TopicScan],
        columns: Mapping[int, Sequence[_TopicColumn]],
        selected: Sequence[Sequence[int]],
    ) -> None:
        self.file = file
        self.tables: Sequence[ImportTable] = ()
        self.places = {number: place_ for place_, number in enumerate(order)}
        self.decoders = {number: scans[number].topic.decoder for number in order}
        self.columns = columns
        self.selected = selected
        self.extra: Sequence[NDArray[np.int64]] = ()

    def blocks(self) -> Iterator[ImportBlock]:
        done = [0] * len(self.places)
        wanted = {number for number, place_ in self.places.items() if self.selected[place_]}
        for number, messages in batches(self.file.messages(wanted)):
            place_ = self.places[number]
            first, table = done[place_], self.tables[place_]
            rows = len(messages)
            values = [np.empty(rows, column.dtype) for column in table.columns]
            sources = self.columns[number]
            decoder = self.decoders[number]
            assert decoder is not None
            for part in decoder.parts([message.data for message in messages]):
                read: dict[str, NDArray[Any]] = {}
                for out, which in zip(values, self.selected[place_], strict=True):
                    if which == len(sources):
                        continue
                    path, element, _ = sources[which]
                    if path not in part.numbers:
                        out[part.rows] = np.nan
                        continue
                    if path not in read:
                        read[path] = part.values(path)
                    out[part.rows] = read[path] if element is None else read[path][:, element]
            if self.extra:
                values[-1][:] = self.extra[place_][first : first + rows]
            done[place_] += rows
            yield ImportBlock(place_, first, values)


def batches(messages: Iterator[TopicMessage]) -> Iterator[tuple[int, list[TopicMessage]]]:
    """The messages topic by topic, some at a time."""
    waiting: dict[int, list[TopicMessage]] = {}
    sizes: dict[int, int] = {}
    total = 0
    for message in messages:
        number = message.topic
        own = waiting.setdefault(number, [])
        own.append(message)
        size = len(message.data) + 100
        total += size
        sizes[number] = sizes.get(number, 0) + size
        if len(own) >= ROWS:
            total -= sizes.pop(number)
            yield number, waiting.pop(number)
        elif total > _BLOCK_SIZE:
            largest = max(sizes, key=sizes.__getitem__)
            total -= sizes.pop(largest)
            yield largest, waiting.pop(largest)
    yield from waiting.items()


def _matches(topic: Topic, pattern: str) -> bool:
    names = (topic.name, topic.name.strip("/"), topic.title)
    return any(fnmatchcase(name, pattern) for name in names)


def _is_sparse(where: Placed) -> bool:
    """A few rows with wide gaps: their rate may be a coincidence."""
    return len(where.ticks) < _FEW_ROWS and int(where.ticks[-1]) > 3 * len(where.ticks)


def _label(scan: _TopicScan, path: str, place_: int | None) -> str:
    """The fields' own names; joints and layouts give better ones."""
    topic = scan.topic
    short = topic.name.strip("/") or topic.name
    if plain(topic.kind) == JOINTS and place_ is not None:
        joint = scan.texts.get(f"name[{place_}]")
        return f"{joint}.{path}" if joint else f"{path}[{place_}]"
    if path == "data":
        layout = scan.texts.get("layout.dim[0].label")
        is_list = place_ is not None and "layout.dim[1].label" not in scan.texts
        name = layout if layout and is_list else short
        return name if place_ is None else f"{name}[{place_}]"
    return path if place_ is None else f"{path}[{place_}]"


def _texts(topic: Topic, part: DecodedMessages) -> Iterator[str]:
    """The text of each message: of its field, or all that it holds as JSON."""
    wanted = TEXTS.get(plain(topic.kind))
    if wanted is not None and wanted in part.texts:
        for row in range(len(part.rows)):
            yield part.text(wanted, row)
        return
    paths = [
        path
        for path, number in part.numbers.items()
        if not path.startswith("header.") and (number.length or 0) <= _ARRAY_LIMIT
    ]
    values = {path: part.values(path).tolist() for path in paths}
    names = [path for path in part.texts if not path.startswith("header.")]
    for row in range(len(part.rows)):
        held: dict[str, Any] = {path: values[path][row] for path in paths}
        held |= {path: part.text(path, row) for path in names}
        if not held:
            yield topic.name
        elif len(held) == 1:
            [only] = held.values()
            yield only if isinstance(only, str) else json.dumps(only)
        else:
            yield json.dumps(held, ensure_ascii=False)


__all__ = [
    "DecodedMessages",
    "MessageDecoder",
    "MessageFile",
    "Topic",
    "TopicMessage",
    "batches",
    "read_messages",
]
