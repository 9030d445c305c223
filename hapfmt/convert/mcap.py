"""MCAP of ROS 2, of ROS 1, and of Foxglove with JSON (https://mcap.dev), by mcap.

The library reads the records of the file. Chunks are unpacked here, within the memory allowed.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

from ..errors import LimitError, MissingExtraError, ParameterError
from .common import refusing
from .formats import ReadOptions, Source
from .json_messages import MAX_DEPTH, JsonDecoder
from .mcap_own import own_import
from .mcap_writer import KEY, RECORD, write
from .messages import MessageDecoder, Topic, TopicMessage, read_messages
from .ros_layout import RosLayout
from .tables import Import

try:
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError, RecordLengthLimitExceeded
    from mcap.opcode import Opcode
    from mcap.records import (
        Attachment,
        AttachmentIndex,
        Channel,
        Chunk,
        Header,
        Metadata,
        MetadataIndex,
        Schema,
        Statistics,
    )  # fmt: skip
    from mcap.records import Message as Record
    from mcap.stream_reader import StreamReader
except ImportError:
    raise MissingExtraError("mcap", "ros") from None

_CHUNK_LIMIT = 1 << 28
"""Bytes of an unpacked chunk; recorders write chunks of 1 to 10 MB."""
_MESSAGE = struct.Struct("<HIQQ")
_RECORD = struct.Struct("<BQ")
MAGIC = b"\x89MCAP0\r\n"
_FOOTER_SIZE = 29
_CUT = (
    "the file ends in the middle of a record, as after a crash of the recorder; the program mcap "
    "repairs it (mcap recover)"
)
_TOO_LARGE = "the descriptions and attachments take more than the {} bytes allowed"


def read(source: Source, options: ReadOptions) -> Import:
    return _read([source.stream], options)


def read_files(paths: Sequence[Path], options: ReadOptions) -> Import:
    """The parts of one recording, in order."""
    for path in paths:
        if not path.is_file():
            raise ParameterError(f"the file {path.name} of the bag is missing")
    return _read(paths, options)


def _read(parts: Sequence[Path | BinaryIO], options: ReadOptions) -> Import:
    file = _McapFile(parts, options)
    text = file.metadata.pop(RECORD, {}).get(KEY)
    if text is not None and not (options.rate or options.clock or options.keep_stamps):
        own = own_import(file, text, options, file.attachments, file.notes)
        if own is not None:
            return own
    return read_messages(
        file, options, metadata=file.metadata, attachments=file.attachments, notes=file.notes
    )


@contextmanager
def _refused() -> Iterator[None]:
    """The exceptions of mcap on damaged files. No record is longer than the file."""
    try:
        with refusing("the MCAP file is damaged", struct.error, RuntimeError):
            yield
    except RecordLengthLimitExceeded:
        raise ParameterError(_CUT) from None
    except McapError as error:
        raise ParameterError(f"the MCAP file is damaged: {error}") from error


class _ExactStream:
    """A stream that never gives fewer bytes than asked for, nor allocates more than there are."""

    def __init__(self, stream: BinaryIO) -> None:
        self.stream = stream
        stream.seek(0, 2)
        self.size = stream.tell()
        if not self.size:
            raise ParameterError("the file is empty")
        stream.seek(0)
        self.at = 0

    def read(self, size: int) -> bytes:
        if size > self.size - self.at:
            raise ParameterError(_CUT)
        self.at += size
        data = self.stream.read(size)
        if len(data) != size:
            raise ParameterError("the file became shorter while it was read")
        return data

    def seek(self, offset: int) -> None:
        if offset > self.size:
            raise ParameterError("an index of the MCAP file is damaged")
        self.stream.seek(offset)
        self.at = offset


class _ChannelSource(NamedTuple):
    part: int
    id: int


class _McapFile:
    def __init__(self, parts: Sequence[Path | BinaryIO], options: ReadOptions) -> None:
        self.parts = parts
        self.options = options
        self.notes: list[str] = []
        self.topics: list[Topic] = []
        self.metadata: dict[str, Any] = {}
        self.attachments: dict[str, tuple[str, bytes]] = {}
        self.ids: dict[_ChannelSource, int] = {}
        self.counts_all = False
        self._survey()

    # records

    def records(self, part: int) -> Iterator[Any]:
        """Those of one part, with the chunks unpacked: Schema, Channel, and (id, number, log_ns,
        data) of messages."""
        opened = self.parts[part]
        if isinstance(opened, Path):
            with opened.open("rb") as stream:
                yield from self._records(stream)
        else:
            yield from self._records(opened)

    def _records(self, stream: BinaryIO) -> Iterator[Any]:
        exact = _ExactStream(stream)
        reader = StreamReader(cast(BinaryIO, exact), emit_chunks=True, record_size_limit=exact.size)
        records = reader.records
        while True:
            with _refused():
                record = next(records, None)
            if record is None:
                return
            if self.options.progress:
                self.options.progress(exact.at, exact.size)
            if isinstance(record, Chunk):
                yield from _unpacked(record, min(self.options.max_memory, _CHUNK_LIMIT))
            elif isinstance(record, Record):
                yield record.channel_id, record.sequence, record.log_time, record.data
            else:
                yield record

    def messages(self, wanted: set[int]) -> Iterator[TopicMessage]:
        last, counts_all = -1, len(self.ids) > 1
        for part in range(len(self.parts)):
            ids = {
                source.id: topic
                for source, topic in self.ids.items()
                if source.part == part and topic in wanted
            }
            if not ids:
                continue
            for record in self.records(part):
                if type(record) is not tuple:
                    continue
                channel, number, log_ns, data = record
                if number <= last:
                    counts_all = False
                last = number
                if channel in ids:
                    if log_ns >= 1 << 63:
                        raise ParameterError(f"the log time {log_ns} ns is out of range")
                    yield TopicMessage(ids[channel], log_ns, number, data)
        self.counts_all = counts_all

    # what the file holds

    def _survey(self) -> None:
        for part in range(len(self.parts)):
            opened = self.parts[part]
            if isinstance(opened, Path):
                with opened.open("rb") as stream:
                    records = self._summary(stream) or self._descriptions(part)
            else:
                records = self._summary(opened) or self._descriptions(part)
            self._describe(part, records)

    def _descriptions(self, part: int) -> list[Any]:
        """By reading all of a file that has no summary."""
        left, found = self.options.max_memory, []
        for record in self.records(part):
            if isinstance(record, (Schema, Channel, Header, Metadata, Attachment)):
                left -= _size(record)
                if left < 0:
                    raise LimitError(_TOO_LARGE.format(self.options.max_memory))
                found.append(record)
        return found

    def _summary(self, stream: BinaryIO) -> list[Any]:
        """From the end of the file; [] where there is no summary, or not all of it."""
        exact = _ExactStream(stream)
        if exact.size < _FOOTER_SIZE + 2 * len(MAGIC):
            return []
        header = self._record_at(exact, len(MAGIC))
        stream.seek(exact.size - len(MAGIC) - _FOOTER_SIZE)
        raw = stream.read(_FOOTER_SIZE + len(MAGIC))
        (start,) = struct.unpack_from("<Q", raw, _RECORD.size)
        if raw[-len(MAGIC) :] != MAGIC or not 0 < start < exact.size:
            return []
        exact.seek(start)
        found: list[Any] = [header]
        reader = StreamReader(cast(BinaryIO, exact), skip_magic=True, record_size_limit=exact.size)
        with _refused():
            indexed = [*reader.records]
        statistics = next((one for one in indexed if isinstance(one, Statistics)), None)
        channels = [one for one in indexed if isinstance(one, Channel)]
        if statistics is None or statistics.channel_count != len({one.id for one in channels}):
            return []
        left = self.options.max_memory
        for one in indexed:
            if isinstance(one, (AttachmentIndex, MetadataIndex)):
                left -= one.length
                if left < 0:
                    raise LimitError(_TOO_LARGE.format(self.options.max_memory))
                found.append(self._record_at(exact, one.offset))
        return [*found, *(one for one in indexed if isinstance(one, (Schema, Channel)))]

    @staticmethod
    def _record_at(exact: _ExactStream, offset: int) -> Any:
        exact.seek(offset)
        reader = StreamReader(
            cast(BinaryIO, exact), skip_magic=True, record_size_limit=exact.size, emit_chunks=True
        )
        with _refused():
            return next(reader.records)

    def _describe(self, part: int, records: Sequence[Any]) -> None:
        schemas = {one.id: one for one in records if isinstance(one, Schema)}
        channels = {one.id: one for one in records if isinstance(one, Channel)}
        names = [channel.topic for channel in channels.values()]
        known = {(one.name, one.kind, one.publisher): n for n, one in enumerate(self.topics)}
        for channel in channels.values():
            several = names.count(channel.topic) > 1
            sender = channel.metadata.get("callerid") or f"channel {channel.id}"
            topic = _topic_of(channel, schemas.get(channel.schema_id), sender if several else "")
            key = (topic.name, topic.kind, topic.publisher)
            if key not in known:
                known[key] = len(self.topics)
                self.topics.append(topic)
            self.ids[_ChannelSource(part, channel.id)] = known[key]
        for one in records:
            if isinstance(one, Metadata):
                self.metadata.setdefault(one.name, dict(one.metadata))
            elif isinstance(one, Attachment):
                self.attachments.setdefault(one.name, (one.media_type, one.data))


def _topic_of(channel: Channel, schema: Schema | None, publisher: str) -> Topic:
    kind = schema.name if schema else ""
    try:
        decoder = _decoder_of(channel.message_encoding, schema, kind)
    except ParameterError as error:
        return Topic(channel.topic, kind, None, str(error), publisher)
    units = _units_of(schema) if channel.message_encoding == "json" and schema else {}
    return Topic(channel.topic, kind, decoder, "", publisher, units)


def _decoder_of(encoding: str, schema: Schema | None, kind: str) -> MessageDecoder:
    if encoding == "json":
        return JsonDecoder()
    if encoding not in ("cdr", "ros1"):
        raise ParameterError(f"messages with the encoding {encoding!r} are not known")
    from .ros_definitions import default_types, parsed

    if schema is None or not schema.encoding:
        return RosLayout(default_types(kind), kind, is_cdr=True)
    language = {"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl", "omgidl": "idl"}
    if schema.encoding not in language:
        raise ParameterError(f"schemas with the encoding {schema.encoding!r} are not known")
    with refusing("the definition of its type"):
        text = schema.data.decode("utf-8")
    kind = kind if "/msg/" in kind or "/" not in kind else "/msg/".join(kind.split("/", 1))
    return RosLayout(parsed(text, kind, language[schema.encoding]), kind, is_cdr=encoding == "cdr")


def _unpacked(chunk: Chunk, room: int) -> Iterator[Any]:
    data = _decompressed(chunk, room)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ParameterError("the checksum of a chunk is wrong; the MCAP file is damaged")
    at, end = 0, len(data)
    while at < end:
        if at + _RECORD.size > end:
            raise ParameterError("a chunk ends in the middle of a record")
        code, size = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if size > end - at or (code == Opcode.MESSAGE and size < _MESSAGE.size):
            raise ParameterError("a chunk ends in the middle of a record")
        if code == Opcode.MESSAGE:
            channel, number, log_ns, _ = _MESSAGE.unpack_from(data, at)
            yield channel, number, log_ns, data[at + _MESSAGE.size : at + size]
        elif code in (Opcode.SCHEMA, Opcode.CHANNEL):
            kind = Schema if code == Opcode.SCHEMA else Channel
            with refusing("the MCAP file is damaged", McapError, struct.error):
                yield kind.read(ReadDataStream(BytesIO(data[at : at + size])))
        at += size


def _decompressed(chunk: Chunk, room: int) -> bytes:
    """The size that the chunk states is checked first, since that much is allocated."""
    size = chunk.uncompressed_size
    if size > room:
        raise LimitError(
            f"a chunk of the file takes {size} bytes, more than {room}; allow more (max_memory=)"
        )
    with refusing("a chunk of the MCAP file is damaged", RuntimeError, *_broken()):
        if chunk.compression == "zstd":
            import zstandard

            if zstandard.frame_content_size(chunk.data) > size:
                raise ParameterError("a chunk is larger than it states")
            data = zstandard.decompress(chunk.data, size)
        elif chunk.compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor

            data = LZ4FrameDecompressor().decompress(chunk.data, size + 1)
        elif not chunk.compression:
            data = chunk.data
        else:
            raise ParameterError(f"the compression {chunk.compression!r} is not known")
    if len(data) != size:
        raise ParameterError(f"a chunk has {len(data)} bytes, not the {size} that it states")
    return bytes(data)


def _broken() -> tuple[type[Exception], ...]:
    import zstandard

    return (zstandard.ZstdError,)


def _size(record: Any) -> int:
    """About the bytes that a description takes."""
    if isinstance(record, (Schema, Attachment)):
        return len(record.data) + 100
    held = getattr(record, "metadata", {})
    return 100 + sum(len(key) + len(value) for key, value in held.items())


def _units_of(schema: Schema) -> dict[str, str]:
    """The units that a JSON schema gives, by path."""
    try:
        found = json.loads(schema.data)
    except (ValueError, RecursionError):
        return {}
    units: dict[str, str] = {}

    def walk(one: Any, path: str, depth: int) -> None:
        if not isinstance(one, dict) or depth > MAX_DEPTH:
            return
        unit = one.get("unit", one.get("units"))
        if isinstance(unit, str) and path:
            units[path] = unit
        inner = one.get("properties")
        for name, each in inner.items() if isinstance(inner, dict) else ():
            walk(each, f"{path}.{name}" if path else name, depth + 1)

    walk(found, "", 0)
    return units


__all__ = ["read", "read_files", "write"]
