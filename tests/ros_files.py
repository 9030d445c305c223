"""Bags and MCAP files, written by their own libraries (rosbags, mcap)."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

START = 1_700_000_000 * 10**9
KINDS = ("bag", "db3", "mcap")


class Bag:
    """A bag of one kind that is being written."""

    def __init__(self, path: Path, kind: str) -> None:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore

        self.is_ros1 = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:
            self.writer: Any = rosbag1.Writer(path)
        else:
            plugin = rosbag2.StoragePlugin.SQLITE3 if kind == "db3" else rosbag2.StoragePlugin.MCAP
            self.writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        self.writer.open()
        self.connections: dict[tuple[str, str | None], Any] = {}

    def make(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def header(self, stamp_ns: int, frame: str = "tool", number: int = 0) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", *divmod(int(stamp_ns), 10**9))
        first = [number] if self.is_ros1 else []
        return self.make("std_msgs/msg/Header", *first, stamp, frame)

    def vector(self, values: Iterable[float]) -> Any:
        return self.make("geometry_msgs/msg/Vector3", *map(float, values))

    def wrench(self, stamp_ns: int, values: Iterable[float], number: int = 0) -> Any:
        x = [*values]
        inner = self.make("geometry_msgs/msg/Wrench", self.vector(x[:3]), self.vector(x[3:]))
        header = self.header(stamp_ns, number=number)
        return self.make("geometry_msgs/msg/WrenchStamped", header, inner)

    def put(self, topic: str, log_ns: int, message: Any, caller: str | None = None) -> None:
        kind = message.__msgtype__
        if (topic, caller) not in self.connections:
            more = {"callerid": caller} if caller else {}
            self.connections[topic, caller] = self.writer.add_connection(
                topic, kind, typestore=self.store, **more
            )
        pack = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic, caller], int(log_ns), pack(message, kind))


@contextmanager
def bag(folder: Path, kind: str, name: str = "a") -> Iterator[Bag]:
    path = folder / (f"{name}.bag" if kind == "bag" else f"{name}_{kind}")
    made = Bag(path, kind)
    made.path = path  # type: ignore[attr-defined]
    yield made
    made.writer.close()


def path_of(folder: Path, kind: str, name: str = "a") -> Path:
    return folder / (f"{name}.bag" if kind == "bag" else f"{name}_{kind}")


def wrenches(folder: Path, kind: str, rows: int = 300, name: str = "a") -> tuple[Path, np.ndarray]:
    """A regular topic of 1 kHz, and its values, [rows, 6]."""
    x = np.random.default_rng(5).normal(size=(rows, 6))
    with bag(folder, kind, name) as one:
        for row in range(rows):
            stamp = START + row * 10**6
            one.put("/ft/wrench", stamp + 80_000, one.wrench(stamp, x[row], row))
    return path_of(folder, kind, name), x


def json_mcap(
    messages: Iterable[tuple[str, int, dict[str, Any]]],
    schemas: dict[str, tuple[str, dict[str, Any]]] | None = None,
    **how: Any,
) -> bytes:
    """(topic, log time, message) as MCAP with JSON."""
    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream, **how)
    writer.start()
    channels: dict[str, int] = {}
    for number, (topic, log_ns, message) in enumerate(messages):
        if topic not in channels:
            name, schema = (schemas or {}).get(topic, ("thing", {"type": "object"}))
            place = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            channels[topic] = writer.register_channel(topic, "json", place)
        writer.add_message(channels[topic], log_ns, json.dumps(message).encode(), log_ns, number)
    writer.finish()
    return stream.getvalue()
