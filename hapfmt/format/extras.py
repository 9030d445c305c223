"""Payloads that decoding never needs: metadata, attachments, clocks, indexes and the FOOT.

mETa holds metadata and aTTc an attachment (SPEC 11.3, 11.4). cLOk holds observations of another
clock, and cMAp a map to its time (SPEC 11.6). iNDX and fOOT say where the chunks are (SPEC 11.1,
11.2); they are hints and never trusted.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple, NoReturn

from ..clocks import TICK_BOUND, TIME_BOUND
from ..errors import FormatError, ParameterError, TruncatedError
from ..numbers import build_svarint, build_varint, parse_svarint, parse_varint
from .layout import FOOT, INDEX
from .wire import HEADER_SIZE, encode_text, parse_text

DEPTH_LIMIT = 64
DIGIT_LIMIT = 1000
"""Characters of a number: more are refused, since reading them takes the square of their number."""


def build_metadata(metadata: dict[str, Any]) -> bytes:
    """Canonical JSON: sorted keys, no spaces."""
    if not isinstance(metadata, dict):
        raise ParameterError("metadata must be a JSON object, a dict in Python")
    try:
        payload = json.dumps(
            metadata, ensure_ascii=False, sort_keys=True, separators=(",", ":"), allow_nan=False
        ).encode("utf-8")
        parse_metadata(payload, 0)
    except (TypeError, ValueError, RecursionError, FormatError) as error:
        raise ParameterError(f"metadata cannot be written as JSON: {error}") from None
    return payload


def parse_metadata(payload: bytes, offset: int) -> dict[str, Any]:
    """SPEC MET-001."""

    def refuse(name: str) -> NoReturn:
        raise ValueError(name)

    def integer(text: str) -> int:
        return int(text) if len(text) <= DIGIT_LIMIT else refuse(text)

    def real(text: str) -> float:
        value = float(text)
        return value if math.isfinite(value) and len(text) <= DIGIT_LIMIT else refuse(text)

    try:
        text = parse_text(payload, offset)
        value = json.loads(text, parse_constant=refuse, parse_int=integer, parse_float=real)
        if "\\u" in text:
            # Only an escape can stand for half of a surrogate pair.
            check_texts(value)
    except (ValueError, RecursionError):
        raise FormatError(
            "metadata is not JSON within the bounds", requirement="MET-001", offset=offset
        ) from None
    if not isinstance(value, dict):
        raise FormatError("metadata is not a JSON object", requirement="MET-001", offset=offset)
    level: list[Any] = [value]
    for _ in range(DEPTH_LIMIT):
        level = [
            inner
            for item in level
            for inner in (item.values() if isinstance(item, dict) else item)
            if isinstance(inner, (dict, list))
        ]
        if not level:
            return value
    raise FormatError("metadata nested more than 64 deep", requirement="MET-001", offset=offset)


def check_texts(value: Any) -> None:
    """ValueError where a text within has no UTF-8."""
    waiting = [value]
    while waiting:
        item = waiting.pop()
        if isinstance(item, str):
            item.encode("utf-8")
        elif isinstance(item, dict):
            waiting.extend(item)
            waiting.extend(item.values())
        elif isinstance(item, list):
            waiting.extend(item)


MEDIA_TYPE = "haptics/vnd.hapf"
"""The media type of a file (docs/spec/media-type.md)."""
OVERVIEW = ("overview", f"{MEDIA_TYPE}.overview")
"""Name and media type of the overview (SPEC OVW-001)."""


@dataclass(frozen=True)
class Attachment:
    """A named file inside the recording."""

    name: str
    media_type: str
    content: bytes

    @property
    def is_overview(self) -> bool:
        """Whether it describes the packets of the file that it was written in."""
        return (self.name, self.media_type) == OVERVIEW

    @property
    def safe_name(self) -> str:
        """The name without any path: last component, no leading dots (SPEC ATT-002)."""
        last = self.name.replace("\\", "/").replace(":", "/").rsplit("/", 1)[-1]
        return "".join(c for c in last if c.isprintable()).lstrip(".") or "attachment"


def build_attachment(attachment: Attachment) -> bytes:
    out = b""
    for text in (attachment.name, attachment.media_type):
        raw = encode_text(text)
        out += bytes([len(raw)]) + raw
    if not attachment.name:
        raise ParameterError("an attachment has a name")
    return out + attachment.content


OVERVIEW_NAMES = build_attachment(Attachment(*OVERVIEW, b""))
"""What the payload of an overview begins with."""


def parse_attachment(payload: bytes, offset: int) -> Attachment:
    """SPEC ATT-001."""
    texts = []
    position = 0
    for _ in range(2):
        stop = position + 1 + (payload[position] if position < len(payload) else 0)
        if stop > len(payload):
            raise FormatError(
                "attachment ends within its name", requirement="ATT-001", offset=offset + position
            )
        texts.append(parse_text(payload[position + 1 : stop], offset + position + 1))
        position = stop
    if not texts[0]:
        raise FormatError("attachment without a name", requirement="ATT-001", offset=offset)
    return Attachment(texts[0], texts[1], payload[position:])


STEP_LIMIT = 1 << 52
"""What a svarint holds lies below."""
CHUNK_COUNT = 1 << 14
"""Observations of a chunk that this writer makes: at most 27 bytes each fit level 1."""

ClockRow = tuple[int, int, int]
"""Tick, time and uncertainty, both in nanoseconds."""


class ClockChunk(NamedTuple):
    """The content of a cLOk chunk; ``track`` None: its ticks are nanoseconds."""

    clock: str
    track: int | None
    rows: list[ClockRow]


class ClockMapChunk(NamedTuple):
    """The content of a cMAp chunk: points (tick, time in nanoseconds)."""

    clock: str
    track: int | None
    points: tuple[tuple[int, int], ...]


def build_clocks(clock: str, track: int | None, rows: Iterable[ClockRow]) -> Iterator[bytes]:
    """cLOk payloads of the observations of a clock on one track: several where they are many, or
    where the clock leaps further than a difference can tell."""
    for part in parts_of(rows):
        out = bytearray(build_name(clock, track) + build_varint(len(part)))
        before = None
        for tick, time_ns, uncertainty_ns in part:
            if before is None:
                out += build_svarint(tick) + time_ns.to_bytes(8, "little", signed=True)
            else:
                out += build_svarint(tick - before[0]) + build_svarint(time_ns - before[1])
            out += build_varint(uncertainty_ns)
            before = tick, time_ns
        yield bytes(out)


def parts_of(rows: Iterable[ClockRow]) -> Iterator[list[ClockRow]]:
    part: list[ClockRow] = []
    for row in rows:
        far = part and (
            len(part) == CHUNK_COUNT
            or abs(row[0] - part[-1][0]) >= STEP_LIMIT
            or abs(row[1] - part[-1][1]) >= STEP_LIMIT
        )
        if far:
            yield part
            part = []
        part.append(row)
    if part:
        yield part


def build_map(clock: str, track: int | None, points: Sequence[tuple[int, int]]) -> bytes:
    """The cMAp payload."""
    (tick, time_ns), *others = points
    out = bytearray(build_name(clock, track) + build_varint(len(points)))
    out += build_svarint(tick) + time_ns.to_bytes(8, "little", signed=True)
    for later, then_ns in others:
        out += build_varint(later - tick) + build_varint(then_ns - time_ns)
        tick, time_ns = later, then_ns
    return bytes(out)


def build_name(clock: str, track: int | None) -> bytes:
    raw = clock.encode()
    return build_varint(0 if track is None else track + 1) + bytes([len(raw)]) + raw


def parse_name(payload: bytes, offset: int) -> tuple[str, int | None, int]:
    """The name, the track, and where both end."""
    number, start = parse_varint(payload, 0, offset)
    stop = start + 1 + (payload[start] if start < len(payload) else 0)
    if stop == start + 1 or stop > len(payload):
        raise FormatError(
            "a clock without a name that lies in its chunk",
            requirement="CLK-001",
            offset=offset + start,
        )
    name = parse_text(payload[start + 1 : stop], offset + start + 1)
    return name, number - 1 if number else None, stop


def parse_clock(payload: bytes, offset: int) -> ClockChunk:
    """A cLOk payload at ``offset``."""
    clock, track, position = parse_name(payload, offset)
    at = position
    count, position = parse_varint(payload, position, offset)
    if count < 1:
        raise FormatError("no observation", requirement="CLK-001", offset=offset + at)
    rows: list[ClockRow] = []
    tick = time_ns = 0
    for place in range(count):
        at = position
        step, position = parse_svarint(payload, position, offset)
        if place == 0:
            later, position = parse_time(payload, position, offset)
        else:
            later, position = parse_svarint(payload, position, offset)
        uncertainty, position = parse_varint(payload, position, offset)
        tick, time_ns = tick + step, time_ns + later
        check_bounds(tick, time_ns, offset + at)
        rows.append((tick, time_ns, uncertainty))
    check_end(payload, position, offset)
    return ClockChunk(clock, track, rows)


def parse_map(payload: bytes, offset: int) -> ClockMapChunk:
    """A cMAp payload at ``offset``."""
    clock, track, position = parse_name(payload, offset)
    at = position
    count, position = parse_varint(payload, position, offset)
    if count < 2:
        raise FormatError("a map of fewer than 2 points", requirement="CLK-001", offset=offset + at)
    at = position
    tick, position = parse_svarint(payload, position, offset)
    time_ns, position = parse_time(payload, position, offset)
    check_bounds(tick, time_ns, offset + at)
    points = [(tick, time_ns)]
    for _ in range(count - 1):
        at = position
        step, position = parse_varint(payload, position, offset)
        later, position = parse_varint(payload, position, offset)
        if not (step and later):
            raise FormatError(
                "a clock that does not advance", requirement="CLK-003", offset=offset + at
            )
        tick, time_ns = tick + step, time_ns + later
        check_bounds(tick, time_ns, offset + at)
        points.append((tick, time_ns))
    check_end(payload, position, offset)
    return ClockMapChunk(clock, track, tuple(points))


def parse_time(payload: bytes, position: int, offset: int) -> tuple[int, int]:
    raw = payload[position : position + 8]
    if len(raw) < 8:
        raise TruncatedError(
            "the bytes end within a time", requirement="CLK-001", offset=offset + position
        )
    return int.from_bytes(raw, "little", signed=True), position + 8


def check_bounds(tick: int, time_ns: int, at: int) -> None:
    if abs(tick) >= TICK_BOUND or not -TIME_BOUND <= time_ns < TIME_BOUND:
        raise FormatError("a tick or a time out of bounds", requirement="CLK-003", offset=at)


def check_end(payload: bytes, position: int, offset: int) -> None:
    if position != len(payload):
        raise FormatError(
            "bytes left over after a clock", requirement="CLK-001", offset=offset + position
        )


FIRST_OFFSET = 8
INDEX_EVERY = 1 << 22
"""Bytes of chunks after which an index is due (SPEC IDX-005)."""
BARE_SIZE, BARE_COUNT = 1 << 16, 16
"""A file of at most this many bytes and chunks needs no index (SPEC IDX-005)."""
NS_LIMIT = (1 << 63) - 1
MS_LIMIT = (1 << 53) - 1
ENTRY_SIZES = (5, 28)
"""The smallest and the largest number of bytes that an entry takes."""
INDEX_SIZE = INDEX.size


class IndexEntry(NamedTuple):
    """A chunk's type and offset; for DATA the milliseconds that its packets lie within."""

    type: str
    offset: int
    start_ms: int = 0
    stop_ms: int = 0


class Index(NamedTuple):
    previous: int
    first_sequence: int
    entries: tuple[IndexEntry, ...]


class Foot(NamedTuple):
    """``index_distance``: bytes back to the last index, 0 where there is none."""

    index_distance: int
    duration_ns: int


def ceil_ns(seconds: Fraction) -> int:
    return min(-(-seconds.numerator * 10**9 // seconds.denominator), NS_LIMIT)


def floor_ms(seconds: Fraction) -> int:
    return min(seconds.numerator * 1000 // seconds.denominator, MS_LIMIT)


def ceil_ms(seconds: Fraction) -> int:
    return min(-(-seconds.numerator * 1000 // seconds.denominator), MS_LIMIT)


def build_index(index: Index) -> bytes:
    out = bytearray(
        INDEX.build(
            previous=index.previous,
            first_sequence=index.first_sequence,
            entry_count=len(index.entries),
        )
    )
    before = index.previous
    for entry in index.entries:
        out += entry.type.encode("ascii") + build_varint(entry.offset - before)
        if entry.type == "DATA":
            out += build_varint(entry.start_ms) + build_varint(entry.stop_ms - entry.start_ms)
        before = entry.offset
    return bytes(out)


def entry_count(payload: bytes) -> int:
    """What the payload promises, and no more than it can hold; for a bound before it is parsed."""
    if len(payload) < INDEX_SIZE:
        return 0
    return min(int(INDEX.read(payload).entry_count), len(payload) // ENTRY_SIZES[0])


def parse_index(payload: bytes, own_offset: int, offset: int) -> Index:
    """The iNDX payload at ``offset``, whose chunk starts at ``own_offset``."""
    raw = INDEX.parse(payload, 0, "IDX-002", offset)
    if len(payload) < INDEX_SIZE + raw.entry_count * ENTRY_SIZES[0]:
        raise FormatError(
            "index length and entry count differ", requirement="IDX-002", offset=offset
        )
    if raw.entry_count * HEADER_SIZE > max(own_offset - raw.previous, 0):
        raise FormatError(
            "more entries than there are chunks before the index",
            requirement="IDX-002",
            offset=offset + INDEX.offsets["entry_count"],
        )
    if raw.previous and not FIRST_OFFSET <= raw.previous < own_offset:
        raise FormatError("previous index out of place", requirement="IDX-002", offset=offset)
    entries: list[IndexEntry] = []
    position, chunk_offset = INDEX_SIZE, raw.previous
    for _ in range(raw.entry_count):
        at = position
        letters = payload[at : at + 4]
        if len(letters) < 4:
            raise FormatError(
                "the index ends within an entry", requirement="IDX-002", offset=offset + at
            )
        if not (letters.isascii() and letters.isalpha()):
            raise FormatError(
                "an index entry without a chunk type", requirement="IDX-002", offset=offset + at
            )
        further, position = parse_varint(payload, at + 4, offset)
        chunk_offset += further
        if chunk_offset >= own_offset or (entries and further < HEADER_SIZE):
            raise FormatError(
                "index offsets out of order", requirement="IDX-002", offset=offset + at
            )
        if letters == b"DATA":
            start_ms, position = parse_varint(payload, position, offset)
            span_ms, position = parse_varint(payload, position, offset)
            entries.append(IndexEntry("DATA", chunk_offset, start_ms, start_ms + span_ms))
        else:
            entries.append(IndexEntry(letters.decode("latin-1"), chunk_offset))
    if position != len(payload):
        raise FormatError(
            "bytes left over after an index", requirement="IDX-002", offset=offset + position
        )
    return Index(raw.previous, raw.first_sequence, tuple(entries))


def build_foot(foot: Foot) -> bytes:
    return FOOT.build(**foot._asdict())


def parse_foot(payload: bytes, offset: int) -> Foot:
    """The fOOT payload at ``offset``."""
    if len(payload) != FOOT.size:
        raise FormatError("footer of another length", requirement="FOT-001", offset=offset)
    return Foot(*FOOT.read(payload))


DIGEST_SIZE = 32


def build_digests(first_track: int, digests: Sequence[bytes]) -> bytes:
    """The dGST payload of tracks whose ids follow on."""
    return build_varint(first_track) + b"".join(digests)


def parse_digests(payload: bytes, offset: int) -> dict[int, tuple[int, bytes]]:
    """Offset and digest of each track of a dGST payload at ``offset``."""
    first, start = parse_varint(payload, 0, offset)
    size = len(payload) - start
    if not size or size % DIGEST_SIZE:
        raise FormatError(
            "not a whole number of digests", requirement="DGS-001", offset=offset + start
        )
    return {
        first + place: (offset + at, payload[at : at + DIGEST_SIZE])
        for place, at in enumerate(range(start, len(payload), DIGEST_SIZE))
    }


def check_listing(index: Index, own_offset: int, chunks: Sequence[IndexEntry], offset: int) -> None:
    """IDX-002 against all chunks of the file, in order of their offsets."""
    start = bisect_left(chunks, index.previous, key=lambda chunk: chunk.offset)
    stop = bisect_left(chunks, own_offset, key=lambda chunk: chunk.offset)
    expected = chunks[start:stop]
    for listed, found in zip(index.entries, expected, strict=False):
        if (listed.type, listed.offset) != (found.type, found.offset):
            break
        if listed.start_ms > found.start_ms or listed.stop_ms < found.stop_ms:
            raise FormatError("index times miss samples", requirement="IDX-002", offset=offset)
    else:
        if len(expected) == len(index.entries):
            if index.first_sequence != start:
                raise FormatError(
                    f"the index counts its chunks from {index.first_sequence}, not {start}",
                    requirement="IDX-002",
                    offset=offset + INDEX.offsets["first_sequence"],
                )
            return
    raise FormatError("the index does not match the chunks", requirement="IDX-002", offset=offset)
