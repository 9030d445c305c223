"""ROS 1 bags (.bag) and ROS 2 bags (a folder with metadata.yaml, .db3 or .mcap), by rosbags.

The definitions of the messages are those of the file. Old ROS 2 bags hold none; then the common
types of ROS 2 Humble are used.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..errors import LimitError, MissingExtraError, ParameterError
from .common import refusing
from .formats import Advance, ReadOptions, Source
from .messages import Topic, TopicMessage, read_messages
from .ros_definitions import default_types, parsed
from .ros_layout import RosLayout
from .tables import Import

try:
    from rosbags import rosbag1, rosbag2
    from rosbags.interfaces import Connection, MessageDefinitionFormat
    from rosbags.rosbag2 import ReaderError as Reader2Error
    from rosbags.typesys import TypesysError
except ImportError:
    raise MissingExtraError("rosbags", "ros") from None

_CHUNK_LIMIT = 1 << 28
"""Bytes of an unpacked chunk; recorders write chunks of about 1 MB."""
_NO_INDEX = (
    "the bag has no whole index, as after a crash of the recorder; the program rosbag repairs it "
    "(rosbag reindex)"
)
_METADATA_LIMIT = 1 << 22
_SHOWN = 1 << 12
"""Messages between two calls of the progress."""


def read(source: Source, options: ReadOptions) -> Import:
    if source.is_folder:
        return _read_folder(source, options)
    path = source.path
    if source.head.startswith(b"#ROSBAG"):
        return _read_bag(rosbag1.Reader(path), options, _bounded_chunks)
    if not source.head:
        raise ParameterError("the file is empty")
    if not path.suffix.lower() == ".db3":
        raise ParameterError("this is not a ROS bag; give a .bag, a .db3, or the folder of a bag")
    return _read_bag(rosbag2.Reader(path), options, _nothing)


def _read_folder(source: Source, options: ReadOptions) -> Import:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    path = source.path / "metadata.yaml"
    if path.stat().st_size > _METADATA_LIMIT:
        raise LimitError(f"metadata.yaml is longer than {_METADATA_LIMIT} bytes")
    with refusing("metadata.yaml", YAMLError, RuntimeError, AttributeError):
        about = YAML(typ="safe").load(path.read_text("utf-8"))["rosbag2_bagfile_information"]
        kind, mode = about["storage_identifier"], about.get("compression_mode") or ""
        names = list(about["relative_file_paths"])
        # A text of anything else may be exponentially long, since parts of YAML can be repeated.
        if not all(isinstance(each, str) for each in (kind, mode, *names)):
            raise ValueError("the kind of storage, or a name of a file, is not a text")
    names = [name.rpartition("/")[2] for name in names]
    if mode.lower() not in ("", "none"):
        raise ParameterError(
            f"the bag is compressed by {mode.lower()}; write it again without compression "
            "(ros2 bag convert), or as MCAP"
        )
    if kind == "mcap":
        from .mcap import read_files

        return read_files([source.path / name for name in names], options)
    if kind != "sqlite3":
        raise ParameterError(f"bags with the storage {kind!r} are not read")
    return _read_bag(rosbag2.Reader(source.path), options, _nothing)


def _nothing(reader: Any, room: int) -> None:
    pass


def _bounded_chunks(reader: Any, room: int) -> None:
    """Chunks that unpack to more than the room are refused before memory is taken."""
    room = min(room, _CHUNK_LIMIT)
    for at, chunk in reader.chunks.items():
        reader.chunks[at] = chunk._replace(decompressor=_bounded(chunk.decompressor, room))


def _bounded(unpack: Callable[[bytes], bytes], room: int) -> Callable[[bytes], bytes]:
    made: dict[str, Callable[[], Any]] = {"bz2": bz2.BZ2Decompressor, "lz4": _lz4}
    module = unpack.__module__.partition(".")[0].lstrip("_")
    if module not in made:
        return unpack

    def bounded(data: bytes) -> bytes:
        machine = made[module]()
        found: bytes = machine.decompress(data, room + 1)
        if len(found) > room:
            raise LimitError(f"a chunk of the bag takes more than {room} bytes")
        if not machine.eof:
            raise ParameterError("a chunk of the bag is damaged")
        return found

    return bounded


def _lz4() -> Any:
    from lz4.frame import LZ4FrameDecompressor

    return LZ4FrameDecompressor()


@contextmanager
def _refused() -> Iterator[None]:
    """The exceptions of rosbags on damaged files."""
    import apsw

    with refusing(
        "the bag is damaged or not supported",
        rosbag1.ReaderError, Reader2Error, TypesysError, struct.error, AssertionError,
        RuntimeError, AttributeError, apsw.Error,
    ):  # fmt: skip
        yield


def _read_bag(reader: Any, options: ReadOptions, prepare: Callable[[Any, int], None]) -> Import:
    file = _BagFile(reader, options, prepare)
    return read_messages(file, options)


class _BagFile:
    """Opened for each pass, so that nothing stays open."""

    def __init__(
        self, reader: Any, options: ReadOptions, prepare: Callable[[Any, int], None]
    ) -> None:
        self.reader = reader
        self.options = options
        self.prepare = prepare
        self.topics: list[Topic] = []
        self.ids: dict[int, int] = {}
        self.counts_all = False
        self.count = 0
        with self.opened():
            with _refused():
                self.count = sum(one.msgcount for one in reader.connections)
            self._find_topics(list(reader.connections))

    @contextmanager
    def opened(self) -> Iterator[None]:
        with ExitStack() as stack:
            with _refused():
                try:
                    self.reader.open()
                except rosbag1.ReaderError as error:
                    if "index" not in str(error).lower():
                        raise
                    raise ParameterError(_NO_INDEX) from error
                stack.callback(self.reader.close)
                self.prepare(self.reader, self.options.max_memory)
            yield

    def _find_topics(self, connections: list[Connection]) -> None:
        is_ros1 = isinstance(self.reader, rosbag1.Reader)
        known: dict[tuple[str, str, str | None], int] = {}
        senders: dict[str, set[str | None]] = {}
        for one in connections:
            # SQLite keeps values of any type.
            if not all(isinstance(x, str) for x in (one.topic, one.msgtype, one.msgdef.data)):
                raise ParameterError("the bag is damaged: a topic has no name, type or definition")
            senders.setdefault(one.topic, set()).add(getattr(one.ext, "callerid", None))
        for one in connections:
            sender = getattr(one.ext, "callerid", None)
            key = (one.topic, one.msgtype, sender)
            if key not in known:
                known[key] = len(self.topics)
                several = len(senders[one.topic]) > 1
                self.topics.append(self._topic(one, is_ros1, sender or "" if several else ""))
            self.ids[one.id] = known[key]

    @staticmethod
    def _topic(one: Connection, is_ros1: bool, publisher: str) -> Topic:
        definition, kind = one.msgdef, one.msgtype
        try:
            if definition.format is MessageDefinitionFormat.NONE or not definition.data.strip():
                types = default_types(kind)
            elif definition.format is MessageDefinitionFormat.IDL:
                types = parsed(definition.data, kind, "idl")
            else:
                types = parsed(definition.data, kind, "msg")
        except ParameterError as error:
            return Topic(one.topic, kind, None, str(error), publisher)
        return Topic(one.topic, kind, RosLayout(types, kind, is_cdr=not is_ros1), "", publisher)

    def messages(self, wanted: set[int]) -> Iterator[TopicMessage]:
        advance: Advance | None = self.options.progress
        with self.opened():
            chosen = [one for one in self.reader.connections if self.ids[one.id] in wanted]
            if not chosen:
                return
            messages = self.reader.messages(chosen)
            done = 0
            while True:
                with _refused():
                    found = next(messages, None)
                if found is None:
                    return
                connection, log_ns, data = found
                if not (isinstance(data, bytes) and isinstance(log_ns, int)):
                    raise ParameterError("the bag is damaged: a message has no time, or no bytes")
                yield TopicMessage(self.ids[connection.id], log_ns, 0, data)
                done += 1
                if advance and done % _SHOWN == 0:
                    advance(done, self.count)
