"""CPU time of ROS bags and MCAP: importing one, and exporting one.

python tools/messages.py [--quick]

The bag is made with the library rosbags: 14 980 WrenchStamped at 1 kHz and 7490 JointState of 7
joints at 500 Hz, which are 22 470 messages with 27 channels. Their stamps jitter. --quick: a share
of the messages, to see that it runs.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from pathlib import Path
from typing import Any

import installed  # noqa: F401

import numpy as np
from measured import print_origin, print_table, timed

import hapfmt
from hapfmt.recording import Channel

WRENCHES = 14_980
JOINTS = [f"joint{number}" for number in range(7)]
EXPORTED = 100_000
QUICK = 50
START = 1_700_000_000 * 10**9
LIMIT_S = 2.5
LIMIT_RATE = 100_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    share, repeats = (QUICK, 1) if quick else (1, 3)
    print_origin()
    rows: list[list[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("bag", "db3", "mcap"):
            path, count, size = made_bag(Path(folder), kind, WRENCHES // share)
            recording, seconds = timed(lambda path=path: hapfmt.read(path), repeats)
            rows.append(
                [f".{kind}", count, len(recording), f"{size / 1e6:.2f}", f"{seconds:.2f}",
                 f"{count / seconds:.0f}"]
            )  # fmt: skip
    print(f"Import. The aim is at most {LIMIT_S} s.\n")
    print_table(["file", "messages", "channels", "MB", "CPU s", "messages/s"], rows)
    rows = []
    for name, channels in exported(EXPORTED // share).items():
        for schema in ("ros2", "json"):
            count = message_count(channels)
            size, seconds = timed(lambda c=channels, s=schema: saved(c, s), repeats)
            rows.append([name, schema, count, f"{size / 1e6:.2f}", f"{count / seconds:.0f}"])
    print(f"Export to MCAP. The aim is at least {LIMIT_RATE} messages/s.\n")
    print_table(["recording", "schema", "messages", "MB", "messages/s"], rows)


def made_bag(folder: Path, kind: str, wrenches: int) -> tuple[Path, int, int]:
    """The bag, its messages and its bytes."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    is_ros1 = kind == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    path = folder / f"a.{kind}"
    if is_ros1:
        writer: Any = rosbag1.Writer(path)
    else:
        plugin = rosbag2.StoragePlugin.SQLITE3 if kind == "db3" else rosbag2.StoragePlugin.MCAP
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    make, generator = store.types, np.random.default_rng(1)
    pack = store.serialize_ros1 if is_ros1 else store.serialize_cdr
    names = ("geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState")
    vector, wrench = make["geometry_msgs/msg/Vector3"], make["geometry_msgs/msg/Wrench"]
    count = 0
    with writer:
        ft, joints = (
            writer.add_connection(topic, name, typestore=store)
            for topic, name in zip(("/ft", "/joints"), names, strict=True)
        )
        for row in range(wrenches):
            stamp = START + row * 10**6 + int(abs(generator.normal()) * 80_000)
            time = make["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
            first = [row] if is_ros1 else []
            header = make["std_msgs/msg/Header"](*first, time, "tool")
            x = generator.normal(size=6)
            message = make[names[0]](header, wrench(vector(*x[:3]), vector(*x[3:])))
            writer.write(ft, stamp + 50_000, pack(message, names[0]))
            count += 1
            if row % 2 == 0:
                first = [row // 2] if is_ros1 else []
                header = make["std_msgs/msg/Header"](*first, time, "base")
                values = [generator.normal(size=len(JOINTS)) for _ in range(3)]
                writer.write(
                    joints, stamp + 60_000, pack(make[names[1]](header, JOINTS, *values), names[1])
                )
                count += 1
    size = sum(each.stat().st_size for each in (path.rglob("*") if path.is_dir() else [path]))
    return path, count, size


def exported(rows: int) -> dict[str, list[Channel]]:
    generator = np.random.default_rng(2)

    def channel(label: str, unit: str, rate: int, axis: str = "") -> Channel:
        x = generator.normal(size=rows * rate // 1000)
        group = label.rpartition(".")[0] if axis else ""
        return Channel(x, rate, label=label, unit=unit, axis=axis, group=group)

    wrench = [
        channel(f"ft.{what}.{axis}", unit, 1000, axis)
        for what, unit in (("force", "N"), ("torque", "N.m"))
        for axis in "xyz"
    ]
    joints = [
        channel(f"{joint}.{what}", unit, 500)
        for joint in JOINTS
        for what, unit in (("position", "rad"), ("velocity", "rad/s"), ("effort", "N.m"))
    ]
    return {"wrench, 6 channels": wrench, "wrench and joints, 27 channels": [*wrench, *joints]}


def message_count(channels: list[Channel]) -> int:
    """One topic for each rate."""
    return sum({channel.rate_exact: channel.stored.size for channel in channels}.values())


def saved(channels: list[Channel], schema: str) -> int:
    stream = io.BytesIO()
    hapfmt.save(hapfmt.Recording(tuple(channels)), stream, format="mcap", schema=schema)
    return len(stream.getvalue())


if __name__ == "__main__":
    main()
