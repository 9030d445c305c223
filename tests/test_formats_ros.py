"""Bags of ROS 1 and ROS 2, and MCAP: what their own libraries write becomes a recording."""

from __future__ import annotations

import io
import re
import shutil
import sqlite3
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth import DEEP, deep, examples
from ros_files import KINDS, START, Bag, bag, json_mcap, path_of, wrenches
from test_timestamps import Publisher

from hapfmt.convert import imported, read
from hapfmt.errors import HapfmtError, LimitError, ParameterError
from hapfmt.recording import Span

FORCES = [f"wrench.{what}.{axis}" for what in ("force", "torque") for axis in "xyz"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("bags")


@pytest.fixture(scope="module", params=KINDS)
def kind(request) -> str:
    return request.param


class TestTopics:
    def test_a_wrench(self, kind, folder):
        path, x = wrenches(folder, kind)
        recording = read(path)
        assert recording.labels == FORCES
        assert all(c.rate_exact == 1000 and c.coverage == (Span(0, 300),) for c in recording)
        assert np.array_equal(recording.to_numpy(), x.T)
        first, last = recording[0], recording[5]
        assert (first.unit, first.quantity, first.axis, first.device) == ("N", "force", "x", "tool")
        assert (last.unit, last.quantity, last.axis, last.group) == (
            "N.m", "torque", "z", "wrench.torque",
        )  # fmt: skip
        assert recording.epoch_ns == START
        seen = {(each.clock, each.channel, each.tick, each.time_ns) for each in recording.clocks}
        assert {("header", 0, 0, START), ("log", 0, 0, START + 80_000)} <= seen

    def test_the_log_time_counts_where_asked(self, kind, folder):
        path, _ = wrenches(folder, kind, name="logs")
        assert read(path, clock="log").epoch_ns == START + 80_000
        with pytest.raises(ParameterError, match="header and log, not 'sun'"):
            read(path, clock="sun")

    def test_every_stamp_is_kept_where_asked(self, kind, folder):
        path, _ = wrenches(folder, kind, name="stamps")
        recording = read(path, keep_stamps=True, clock="log")
        assert recording.labels == [*FORCES, "stamp"]
        assert recording["stamp"].unit == "ns"
        assert set(recording["stamp"].to_numpy().tolist()) == {0}

    def test_joints_texts_arrays_and_what_is_left_out(self, kind, folder):
        rows = 100
        with bag(folder, kind, "many") as one:
            make = one.make
            for row in range(rows):
                t = START + row * 10**7
                joints = [np.array([row, 2.0]), np.array([3.0, row]), np.array([])]
                one.put(
                    "/arm/joints", t,
                    make("sensor_msgs/msg/JointState", one.header(t, "base"), ["hip", "knee"], *joints),
                )  # fmt: skip
                part = make("std_msgs/msg/MultiArrayDimension", "taxel", 3, 3)
                layout = make("std_msgs/msg/MultiArrayLayout", [part], 0)
                values = np.array([row, -1, 2], np.int32)
                one.put("/skin", t, make("std_msgs/msg/Int32MultiArray", layout, values))
                one.put("/on", t, make("std_msgs/msg/Bool", row % 2 == 0))
                one.put("/wide", t, make("std_msgs/msg/UInt64", 2**63 + row))
                loose = np.zeros(row % 3, np.float32)
                one.put("/loose", t, make("std_msgs/msg/Float32MultiArray", layout, loose))
                zeros, vector = np.zeros(9), one.vector((row, 0, 9.81))
                turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
                one.put(
                    "/imu", t,
                    make("sensor_msgs/msg/Imu", one.header(t), turn, zeros, vector, zeros, vector, zeros),
                )  # fmt: skip
                if row in (3, 50):
                    one.put("/say", t, make("std_msgs/msg/String", f"row {row}"))
                if row in (7, 8, 61):
                    one.put("/rare", t + row * 12_345, make("std_msgs/msg/Float64", row / 2))
            seen = make(
                "sensor_msgs/msg/Image",
                one.header(START),
                1,
                1,
                "mono8",
                0,
                1,
                np.zeros(1, np.uint8),
            )
            one.put("/camera", START, seen)
        recording = read(path_of(folder, kind, "many"))
        assert recording.labels[:4] == [
            "hip.position",
            "knee.position",
            "hip.velocity",
            "knee.velocity",
        ]
        assert recording["hip.position"].unit == "rad"
        assert recording["knee.velocity"].to_numpy().tolist() == [*range(rows)]
        assert recording["taxel[0]"].counts.tolist() == [*range(rows)]
        assert recording["taxel[1]"].stored.dtype == np.int32
        assert recording["on"].counts.tolist() == [1, 0] * 50
        assert recording["wide"].stored.tolist() == [2**63 + row for row in range(rows)]
        assert recording["linear_acceleration.x"].quantity == "acceleration"
        assert recording["angular_velocity.x"].unit == "rad/s"
        events = {(e.layer, float(e.time), e.text) for e in recording.events}
        assert events == {
            ("/say", 0.03, "row 3"), ("/say", 0.5, "row 50"),
            ("/rare", 0.070086415, "3.5"), ("/rare", 0.08009876, "4.0"),
            ("/rare", 0.610753045, "30.5"),
        }  # fmt: skip
        notes = recording.metadata["notes"]
        for text in (
            "images of topic /camera (sensor_msgs/msg/Image) are not read",
            "covariances of topic /imu are not read",
            "the array data of topic /loose has 0 to 2 values, and is not read",
            "topic /rare has no steady rate; its 3 messages are events",
        ):
            assert text in notes
        assert any("count as hinges" in note for note in notes)

    def test_topics_and_channels_are_selected(self, kind, folder):
        path, x = wrenches(folder, kind, name="select")
        assert read(path, select="/ft/*").labels == FORCES
        assert read(path, select=["*.force.?", "wrench.torque.z"]).labels == [
            *FORCES[:3],
            FORCES[5],
        ]
        assert np.array_equal(read(path, select="wrench.force.y").to_numpy()[0], x[:, 1])
        with pytest.raises(
            ParameterError,
            match=r"called '/ft/wench'; did you mean '/ft/wrench'\? There are: /ft/wrench, ",
        ):
            read(path, select="/ft/wench")
        with pytest.raises(ParameterError, match=r"called 'zzz'; there are: /ft/wrench, "):
            read(path, select="zzz")

    def test_a_selected_channel_comes_without_the_notes_and_events_of_others(self, kind, folder):
        with bag(folder, kind, "others") as one:
            for row in range(300):
                t = START + row * 10**6 + 60_000 * (row % 3)
                one.put("/ft", t, one.wrench(t, [row] * 6))
                one.put("/x", t, one.make("std_msgs/msg/Float64", row / 2))
                if row in (3, 50):
                    one.put("/say", t, one.make("std_msgs/msg/String", f"row {row}"))
            one.put("/odd", START + 17, one.make("std_msgs/msg/Float64", 1.0))
        path = path_of(folder, kind, "others")
        assert {event.layer for event in read(path).events} == {"/say", "/odd"}
        recording = read(path, select="wrench.force.y", keep_stamps=True)
        assert recording.labels == ["wrench.force.y", "stamp"]
        assert recording[0].to_numpy().tolist() == [*range(300)]
        assert not recording.events
        notes = recording.metadata["notes"]
        assert notes and all("/ft" in note for note in notes)
        assert all("/x" in note for note in read(path, select="/x").metadata["notes"])

    def test_same_labels_have_their_topic_in_front(self, kind, folder):
        with bag(folder, kind, "two") as one:
            for row in range(100):
                for hand in ("left", "right"):
                    t = START + row * 10**7
                    one.put(f"/{hand}/ft", t, one.wrench(t, [row] * 6))
        kept = read(path_of(folder, kind, "two"), keep_stamps=True)
        assert [label for label in kept.labels if "stamp" in label] == [
            "left/ft.stamp",
            "right/ft.stamp",
        ]
        recording = read(path_of(folder, kind, "two"))
        assert recording.labels[0] == "left/ft.wrench.force.x"
        assert recording.channels[6].group == "right/ft.wrench.force"

    def test_nothing_is_read_by_info_but_the_times(self, kind, folder):
        path, _ = wrenches(folder, kind, name="inspected")
        with imported(path) as (_, found):
            [table] = found.tables
            assert (table.row_count, table.rate, table.name) == (300, 1000, "/ft/wrench")
            assert found.size == 300 * 48


class TestTimes:
    """The simulated bag of 1 kHz: 40 ppm of drift, a delay of 80 us, 30 rows lost, bursts of 12."""

    def test_a_given_rate_leaves_that_of_other_topics(self, folder):
        uneven = [0, 13, 51, 64, 87, 311]
        with bag(folder, "mcap", "rates") as one:
            for row in range(100):
                stamp = START + row * 2_000_000
                one.put("/even", stamp, one.wrench(stamp, [row] * 6))
            for row in range(100):
                stamp = START + row * 10_000_000
                one.put("/slow", stamp, one.wrench(stamp, [row] * 6))
            for ms in uneven:
                stamp = START + ms * 1_000_000
                one.put("/uneven", stamp, one.wrench(stamp, [ms] * 6))
        path = path_of(folder, "mcap", "rates")
        with imported(path, rate=200) as (_, found):
            rates = {table.name: table.rate for table in found.tables}
        assert rates == {"/even": 500, "/slow": 100, "/uneven": 200}
        with (
            pytest.raises(ParameterError, match="have several rates"),
            imported(path, rate=200, select=["/even", "/slow"]),
        ):
            pass

    @pytest.mark.parametrize("way", KINDS)
    @pytest.mark.parametrize("clock", ["header", "log"])
    def test_ticks_loss_and_rate(self, way, clock, folder):
        rows = 4000 if way != "mcap" else 20_000
        ticks, times = Publisher(
            rows=rows, lost=((rows * 7 // 20, rows * 7 // 20 + 30),)
        ).messages()
        stamps = START + np.rint(times * 1e9).astype(np.int64)
        name = f"times_{clock}"
        with bag(folder, way, name) as one:
            for tick, stamp in zip(ticks.tolist(), stamps.tolist(), strict=True):
                header = stamp if clock == "header" else 0
                message = one.wrench(header, [tick] * 6)
                one.put("/ft", stamp + 100_000 * (clock == "header"), message)
        with imported(path_of(folder, way, name)) as (_, found):
            [table] = found.tables
            assert np.count_nonzero(table.all_ticks(0, table.row_count) != ticks) <= 0.005 * len(
                ticks
            )
            assert table.rate == 1000
            first = rows * 7 // 20
            assert [
                (a.stop, b.start) for a, b in zip(table.spans, table.spans[1:], strict=False)
            ] == [(first, first + 30)]
            seen = [one for one in found.clocks if one.clock == clock]
            span = (seen[-1].time_ns - seen[0].time_ns) / (seen[-1].tick - seen[0].tick)
            publisher = Publisher()
            late = publisher.jitter * publisher.period * 1e9 * 4
            assert abs(span / (publisher.period * 1e9) - 1) < 1e-6 + late / (
                seen[-1].time_ns - seen[0].time_ns
            )
            assert any("999.96" in note for note in table.notes) or rows < 20_000

    def test_two_publishers_of_one_connection_are_refused(self, folder):
        with bag(folder, "mcap", "turns") as one:
            for row in range(600):
                t = START + row * 10**6
                one.put("/ft", t, one.wrench(t, [row] * 6))
                t += 3 * 10**5 + row * 700
                one.put("/ft", t, one.wrench(t, [row] * 6))
        with pytest.raises(ParameterError, match=r"topic /ft: .*(publishers|sources)"):
            read(path_of(folder, "mcap", "turns"))

    @pytest.mark.parametrize("later_ns", [500_000, 413_000, 0])
    def test_frames_that_take_turns_have_channels_each(self, kind, later_ns, folder):
        name = f"frames_{later_ns}"
        with bag(folder, kind, name) as one:
            for row in range(300):
                for hand, sign in (("left", 1), ("right", -1)):
                    t = START + row * 10**6 + later_ns * (sign < 0)
                    message = one.wrench(t, [sign * row] * 6, row)
                    message.header.frame_id = hand
                    one.put("/ft", t, message)
        path = path_of(folder, kind, name)
        recording = read(path)
        assert [c.rate_exact for c in recording] == [1000] * 12
        left, right = (recording[f"ft ({hand}).wrench.force.x"] for hand in ("left", "right"))
        assert left.to_numpy().tolist() == [*range(300)]
        assert right.to_numpy().tolist() == [-row for row in range(300)]
        assert (left.device, right.device) == ("left", "right")
        ticks = [c.tick for c in recording.clocks if c.channel == 6]
        assert max(ticks) - min(ticks) == 299
        text = "on topic /ft the frames 'left' and 'right' take turns; each has channels of its own"
        assert text in recording.metadata["notes"]
        only = read(path, select="/ft (right)")
        assert len(only) == 6 and np.array_equal(only[0].to_numpy(), right.to_numpy())

    def test_a_frame_that_changes_once_is_of_one_publisher(self, kind, folder):
        with bag(folder, kind, "moved") as one:
            for row in range(300):
                t = START + row * 10**6
                message = one.wrench(t, [row] * 6, row)
                message.header.frame_id = "a" if row < 200 else "base"
                one.put("/ft", t, message)
        recording = read(path_of(folder, kind, "moved"))
        assert recording.labels == FORCES
        assert "the frame_id of topic /ft changes, and is not kept" in recording.metadata["notes"]

    def test_numbers_that_come_twice_are_of_two_publishers(self, folder):
        with bag(folder, "bag", "twice") as one:
            for row in range(600):
                t = START + row * 10**6
                one.put("/ft", t, one.wrench(t, [row] * 6, row // 2))
        with pytest.raises(ParameterError, match=r"topic /ft: .* come twice, so two publishers"):
            read(path_of(folder, "bag", "twice"))

    def test_a_publisher_without_messages_is_not_counted(self, folder):
        with bag(folder, "bag", "silent") as one:
            for row in range(200):
                t = START + row * 10**6
                one.put("/ft", t, one.wrench(t, [row] * 6, row), "/left")
            kind = "geometry_msgs/msg/WrenchStamped"
            one.writer.add_connection("/ft", kind, typestore=one.store, callerid="/right")
        assert "publishers" not in str(read(path_of(folder, "bag", "silent")).metadata)

    def test_two_publishers_with_connections_have_channels_each(self, folder):
        with bag(folder, "bag", "callers") as one:
            for row in range(200):
                for caller in ("/left", "/right"):
                    t = START + row * 10**6
                    sign = 1 if caller == "/left" else -1
                    one.put("/ft", t, one.wrench(t, [sign * row] * 6, row), caller)
        recording = read(path_of(folder, "bag", "callers"))
        assert len(recording) == 12
        assert recording["ft (/right).wrench.force.x"].to_numpy()[7] == -7
        assert (
            "2 publishers send on topic /ft; each has channels of its own"
            in recording.metadata["notes"]
        )

    def test_sequence_numbers_of_ros_1_find_the_loss(self, folder):
        rows = [row for row in range(400) if not 200 <= row < 205]
        with bag(folder, "bag", "numbered") as one:
            for row in rows:
                t = START + row * 10**6 + (row * 7919 % 13) * 50_000
                one.put("/ft", t, one.wrench(t, [row] * 6, row))
        assert read(path_of(folder, "bag", "numbered"))[0].gaps == (Span(200, 205),)

    def test_simulated_time_has_no_epoch(self, folder):
        with bag(folder, "db3", "simulated") as one:
            for row in range(100):
                one.put("/ft", START + row * 10**7, one.wrench(10**7 * row + 10**9, [row] * 6))
        recording = read(path_of(folder, "db3", "simulated"), keep_stamps=True)
        assert recording.epoch_ns is None
        stamps = recording["stamp"].to_numpy() + 10**7 * np.arange(100)
        assert (stamps == 10**9 + 10**7 * np.arange(100)).all()

    def test_clocks_that_cannot_be_one_are_refused(self, folder):
        with bag(folder, "db3", "mixed") as one:
            for row in range(100):
                one.put("/ft", START + row * 10**7, one.wrench(10**7 * row + 10**9, [row] * 6))
                one.put("/x", START + row * 10**7, one.make("std_msgs/msg/Float64", 1.0))
        path = path_of(folder, "db3", "mixed")
        with pytest.raises(ParameterError, match="differ by more than a day"):
            read(path)
        assert len(read(path, clock="log")) == 7
        with pytest.raises(ParameterError, match="no message has a header stamp"):
            read(path, clock="header", select="/x")


class TestLayout:
    """Every number is the one that rosbags decodes."""

    TYPES = (
        "geometry_msgs/msg/PoseWithCovarianceStamped", "sensor_msgs/msg/Imu",
        "sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState", "nav_msgs/msg/Odometry",
        "trajectory_msgs/msg/JointTrajectory", "sensor_msgs/msg/Joy", "sensor_msgs/msg/NavSatFix",
        "diagnostic_msgs/msg/DiagnosticArray", "sensor_msgs/msg/CameraInfo", "std_msgs/msg/Empty",
        "std_msgs/msg/UInt8MultiArray", "shape_msgs/msg/Mesh",
    )  # fmt: skip

    @pytest.mark.parametrize("is_cdr", [True, False])
    @pytest.mark.parametrize("name", TYPES)
    def test_as_rosbags(self, name, is_cdr):
        from rosbags.typesys import Stores, get_typestore

        from hapfmt.convert.ros_layout import RosLayout

        store = get_typestore(Stores.ROS2_HUMBLE if is_cdr else Stores.ROS1_NOETIC)
        generator = np.random.default_rng(3)
        made = [any_message(store, name, generator) for _ in range(12)]
        pack = store.serialize_cdr if is_cdr else store.serialize_ros1
        unpack = store.deserialize_cdr if is_cdr else store.deserialize_ros1
        packed = [bytes(pack(one, name)) for one in made]
        decoded = [unpack(one, name) for one in packed]
        count = 0
        rows = []
        for part in RosLayout(store.fielddefs, name, is_cdr=is_cdr).parts(packed):
            rows += part.rows.tolist()
            for path, number in part.numbers.items():
                values = part.values(path)
                for row, value in zip(part.rows.tolist(), values, strict=True):
                    expected = at_path(decoded[row], path)
                    if number.is_time:
                        expected = expected.sec * 10**9 + expected.nanosec
                    assert np.array_equal(value, expected, equal_nan=True), path
                    count += 1
            for path in part.texts:
                for place, row in enumerate(part.rows.tolist()):
                    assert part.text(path, place) == at_path(decoded[row], path)
        assert sorted(rows) == [*range(12)]
        assert count or name.endswith("Empty")

    def test_big_endian(self):
        from rosbags.typesys import Stores, get_typestore

        from hapfmt.convert.ros_layout import RosLayout

        store = get_typestore(Stores.ROS2_HUMBLE)
        one = any_message(store, "sensor_msgs/msg/Imu", np.random.default_rng(1))
        packed = [
            bytes(store.serialize_cdr(one, one.__msgtype__, little_endian=little))
            for little in (True, False)
        ]
        found = [*RosLayout(store.fielddefs, one.__msgtype__, is_cdr=True).parts(packed)]
        assert len(found) == 2
        for part in found:
            assert part.values("linear_acceleration.y")[0] == one.linear_acceleration.y


def any_message(store: Any, name: str, generator: np.random.Generator) -> Any:
    def any_value(description: Any) -> Any:
        what, about = int(description[0].value), description[1]
        if what == 1:
            if about[0] == "string":
                return "x" * int(generator.integers(0, 4))
            if about[0] == "bool":
                return bool(generator.integers(2))
            if about[0].startswith("float"):
                return float(np.dtype(about[0]).type(generator.normal()))
            size = np.dtype({"byte": "i1", "octet": "u1", "char": "u1"}.get(about[0], about[0]))
            return int(generator.integers(0, np.iinfo(size).max, dtype=size))
        if what == 2:
            if about.startswith("builtin_interfaces"):
                return store.types[about](
                    int(generator.integers(2**31)), int(generator.integers(10**9))
                )
            return any_message(store, about, generator)
        member, size = about
        count = size if what == 3 else int(generator.integers(0, 3))
        values = [any_value(member) for _ in range(count)]
        if int(member[0].value) == 1 and member[1][0] != "string":
            return np.array(
                values, {"byte": "u1", "octet": "u1", "char": "u1"}.get(member[1][0], member[1][0])
            )
        return values

    return store.types[name](*(any_value(about) for _, about in store.fielddefs[name][1]))


def at_path(message: Any, path: str) -> Any:
    for name in path.replace("[", ".[").split("."):
        message = (
            message[int(name[1:-1])]
            if name.startswith("[")
            else getattr(message, name, None)
            if hasattr(message, name)
            else getattr(message, f"{name}_")
        )
    return message


class TestJson:
    def test_numbers_times_texts(self):
        def message(row: int) -> dict[str, Any]:
            stamp = {"sec": 1_700_000_000, "nsec": row * 10**7}
            return {
                "timestamp": stamp, "force": {"x": row / 4, "y": -1}, "count": row, "on": True,
                "array": [1.5, row], "state": "ok", **({"some": 2.5} if row % 2 else {}),
            }  # fmt: skip

        schema = {"properties": {"force": {"properties": {"x": {"type": "number", "unit": "mN"}}}}}
        data = json_mcap(
            (("/touch", START + row * 10**7 + 5000, message(row)) for row in range(100)),
            {"/touch": ("touch", schema)},
        )
        recording = read(io.BytesIO(data))
        assert recording.labels == [
            "force.x",
            "force.y",
            "count",
            "on",
            "array[0]",
            "array[1]",
            "some",
        ]
        assert recording["force.x"].unit == "mN"
        assert recording["force.x"].to_numpy().tolist() == [row / 4 for row in range(100)]
        assert recording["count"].stored.dtype == np.int64
        assert recording["on"].calibration is not None
        assert len(recording["some"].gaps) == 49
        assert recording.epoch_ns == START

    @pytest.mark.parametrize(
        "how", [{"use_chunking": False}, {"use_statistics": False}, {"repeat_channels": False}]
    )
    @pytest.mark.parametrize("packing", ["NONE", "LZ4", "ZSTD"])
    def test_every_structure_of_a_file(self, how, packing):
        from mcap.writer import CompressionType

        data = json_mcap(
            ((topic, START + row * 10**7, {"v": float(row)}) for row in range(100) for topic in ("/a", "/b")),
            compression=CompressionType[packing], chunk_size=500, **how,
        )  # fmt: skip
        recording = read(io.BytesIO(data))
        assert recording.labels == ["a.v", "b.v"]
        assert recording[1].to_numpy().tolist() == [*map(float, range(100))]

    def test_logs_are_events_and_unknown_encodings_are_said(self):
        from mcap.writer import Writer

        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start()
        log = writer.register_schema("foxglove.Log", "jsonschema", b"{}")
        texts = writer.register_channel("/log", "json", log)
        odd = writer.register_channel("/odd", "flatbuffer", log)
        writer.add_message(texts, 10**18, b'{"message": "began", "level": 2}', 0)
        writer.add_message(odd, 10**18, b"?", 0)
        plain = writer.register_channel("/plain", "x-own", 0)
        writer.add_message(plain, 10**18, b"?", 0)
        writer.add_attachment(0, 0, "notes.txt", "text/plain", b"hello")
        writer.add_metadata("robot", {"arm": "left"})
        writer.finish()
        recording = read(io.BytesIO(stream.getvalue()))
        assert [(e.text, e.layer) for e in recording.events] == [("began", "/log")]
        assert recording.attachments == {"notes.txt": ("text/plain", b"hello")}
        assert recording.metadata["robot"] == {"arm": "left"}
        assert (
            "topic /odd (foxglove.Log) is not read: messages with the encoding 'flatbuffer' are not known"
            in recording.metadata["notes"]
        )
        assert any(
            note.startswith("topic /plain is not read: ") for note in recording.metadata["notes"]
        )


def tried(data: bytes, format: str, tmp_path: Path) -> None:
    try:
        source: Any = io.BytesIO(data)
        if format == "ros2":
            source = tmp_path / "a.db3"
            source.write_bytes(data)
        read(source, format=format, max_memory=1 << 24)
    except (HapfmtError, OSError) as error:
        assert str(error)


class TestDamage:
    @pytest.mark.capped
    @pytest.mark.parametrize("way", KINDS)
    def test_any_damage_gives_a_recording_or_our_error(self, way, folder, tmp_path):
        path, _ = wrenches(folder, way, rows=70, name="damaged")
        if path.is_dir():
            [path] = [*path.glob("*.db3"), *path.glob("*.mcap")]
        whole = path.read_bytes()
        format = {"bag": "rosbag", "db3": "ros2", "mcap": "mcap"}[way]
        generator = np.random.default_rng(11)
        for size in generator.integers(0, len(whole), examples(40)).tolist():
            tried(whole[:size], format, tmp_path)
        for _ in range(examples(120)):
            data = bytearray(whole)
            at = int(generator.integers(len(whole)))
            data[at : at + 4] = generator.integers(0, 256, 4, dtype=np.uint8).tobytes()
            tried(bytes(data), format, tmp_path)

    @pytest.mark.parametrize("format", ["mcap", "rosbag"])
    def test_not_such_a_file(self, format):
        for data in (b"", b"x" * 100, b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" * 9):
            with pytest.raises(ParameterError):
                read(io.BytesIO(data), format=format)

    @pytest.mark.parametrize(
        "value",
        ["NULL", "x'ff'", "1e300", *deep(["5", "''", "'\ud800'", "9223372036854775807", "-1"])],
    )
    @pytest.mark.parametrize("table", ["topics", "messages", "message_definitions", "schema"])
    def test_cells_of_any_type(self, table, value, tmp_path):
        """SQLite keeps any type in any cell."""
        path, _ = wrenches(tmp_path, "db3", rows=20)
        [path] = path.glob("*.db3")
        copy = tmp_path / "copy.db3"
        with closing(sqlite3.connect(path)) as known:
            columns = [row[1] for row in known.execute(f"PRAGMA table_info({table})")]
        assert columns
        for column in columns:
            shutil.copyfile(path, copy)
            with closing(sqlite3.connect(copy)) as changed, suppress(sqlite3.Error):
                changed.execute("PRAGMA writable_schema = 1")
                sql = changed.execute(
                    "SELECT sql FROM sqlite_master WHERE name = ?", (table,)
                ).fetchone()[0]
                loose = re.sub("NOT NULL", "", sql)
                changed.execute("UPDATE sqlite_master SET sql = ? WHERE name = ?", (loose, table))
                changed.commit()
            with closing(sqlite3.connect(copy)) as changed, suppress(sqlite3.Error, UnicodeError):
                changed.execute(f"UPDATE {table} SET {column} = {value}")
                changed.commit()
            tried(copy.read_bytes(), "ros2", tmp_path)

    @pytest.mark.capped
    @pytest.mark.parametrize("way", ["db3", "mcap"])
    def test_the_metadata_of_a_folder(self, way, tmp_path):
        path, _ = wrenches(tmp_path, way, rows=20)
        about = path / "metadata.yaml"
        whole = about.read_text("utf-8")
        bomb = "\n  - &a [x, x, x, x]" + "".join(
            f"\n  - &{chr(c + 1)} [{', '.join([f'*{chr(c)}'] * 9)}]"
            for c in range(ord("a"), ord("w"))
        )
        values = [
            "",
            "null",
            "-1",
            "[]",
            "{}",
            "[[" * (900 if DEEP else 30),
            "&x [*x]",
            '"\\0"',
            "../../etc",
            bomb,
        ]
        lines = whole.splitlines()
        refused = 0
        for number, line in enumerate(lines):
            key, colon, _ = line.partition(": ")
            for value in values if DEEP else values[number % 11 :: 11]:
                changed = f"{key}{colon}{value}" if colon else value
                about.write_text(
                    "\n".join([*lines[:number], changed, *lines[number + 1 :]]), "utf-8"
                )
                try:
                    read(path, max_memory=1 << 24)
                except (HapfmtError, OSError) as error:
                    assert len(str(error)) < 10_000
                    refused += 1
        assert refused > 5
        for key in ("storage_identifier", "compression_mode", "relative_file_paths"):
            rest = [
                line
                for line in lines
                if key not in line and ".db3" not in line and ".mcap" not in line
            ]
            about.write_text("\n".join([*rest, f"  {key}:{bomb}"]), "utf-8")
            with pytest.raises(ParameterError, match=r"metadata\.yaml"):
                read(path)
        about.write_text("#" * (5 << 20))
        with pytest.raises(LimitError, match=r"metadata\.yaml is longer"):
            read(path)

    @pytest.mark.capped
    @pytest.mark.parametrize("packing", ["zstd", "lz4"])
    def test_bombs_are_refused(self, packing):
        from mcap.data_stream import RecordBuilder
        from mcap.records import Chunk, DataEnd, Footer, Header

        size = 64 << 20
        if packing == "zstd":
            import zstandard

            packed = zstandard.compress(bytes(size))
        else:
            import lz4.frame

            packed = lz4.frame.compress(bytes(size))
        for stated, error, text in (
            (size, LimitError, "67108864 bytes, more than"),
            (100, ParameterError, "chunk"),
        ):
            builder = RecordBuilder()
            Header("", "").write(builder)
            Chunk(packing, packed, 0, 0, 0, stated).write(builder)
            DataEnd(0).write(builder)
            Footer(0, 0, 0).write(builder)
            magic = b"\x89MCAP0\r\n"
            with pytest.raises(error, match=text):
                read(io.BytesIO(magic + builder.end() + magic), max_memory=1 << 22)

    @pytest.mark.capped
    def test_a_bomb_in_a_bag(self, folder):
        from rosbags.rosbag1 import Writer

        path = folder / "bomb.bag"
        one = Bag.__new__(Bag)
        from rosbags.typesys import Stores, get_typestore

        one.is_ros1, one.store, one.connections = True, get_typestore(Stores.ROS1_NOETIC), {}
        one.writer = Writer(path)
        one.writer.set_compression(Writer.CompressionFormat.BZ2)
        one.writer.open()
        layout = one.make("std_msgs/msg/MultiArrayLayout", [], 0)
        one.put(
            "/x",
            START,
            one.make("std_msgs/msg/UInt8MultiArray", layout, np.zeros(8 << 20, np.uint8)),
        )
        one.writer.close()
        assert path.stat().st_size < 10_000
        with pytest.raises(LimitError, match="a chunk of the bag takes more than 1048576 bytes"):
            read(path, max_memory=1 << 20)

    def test_times_are_bounded(self, folder):
        path, _ = wrenches(folder, "db3", rows=3000, name="long")
        with pytest.raises(LimitError, match="max_memory="):
            read(path, max_memory=50_000)

    def test_a_type_of_itself(self):
        from mcap.writer import Writer

        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start("ros2")
        cycle = b"a/Loop next\nfloat64 x\n" + b"=" * 80 + b"\nMSG: a/Loop\na/Loop next\n"
        schema = writer.register_schema("a/msg/Loop", "ros2msg", cycle)
        channel = writer.register_channel("/loop", "cdr", schema)
        writer.add_message(channel, START, b"\0\1\0\0" + bytes(64), START)
        writer.finish()
        with pytest.raises(ParameterError, match="nested too deeply"):
            read(io.BytesIO(stream.getvalue()))

    @pytest.mark.parametrize(
        "text",
        ["\n" * 200_000, "# x\n" * 60_000, "float64 x\n" * 5_000, "float64[" * 30_000, "float64[2000000000] x",
         "a/C[4000000000] x\n" + "=" * 80 + "\nMSG: a/C\nfloat64 z\n", "float64[" + "9" * 5000 + "] x",
         "a/C[4096] x\na/C[4096] y\n" + "=" * 80 + "\nMSG: a/C\n", "float64 x\n" * 30_000, "\0", "x" * 70],
        ids=lambda text: text[:12].encode("unicode_escape").decode(),
    )  # fmt: skip
    def test_definitions_of_any_kind(self, text):
        """They are refused, or left out with a note, and take no long time."""
        from mcap.writer import Writer

        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("a/msg/B", "ros2msg", text.encode())
        channel = writer.register_channel("/x", "cdr", schema)
        for row in range(100):
            writer.add_message(channel, START + row * 10**7, b"\0\1\0\0" + bytes(64), START)
        writer.finish()
        began = time.process_time()
        try:
            assert len(read(stream.getvalue())) == 0
        except ParameterError as error:
            assert len(str(error)) < 1000
        assert time.process_time() - began < 20

    @pytest.mark.parametrize("chunk_size", [1 << 10, 1 << 20])
    def test_a_file_cut_in_half_has_advice(self, chunk_size):
        seen = (("/x", START + row * 10**7, {"x": row}) for row in range(2000))
        data = json_mcap(seen, chunk_size=chunk_size)
        with pytest.raises(ParameterError, match=r"middle of a record.* \(mcap recover\)$"):
            read(data[: len(data) // 2], format="mcap")

    def test_a_bag_cut_in_half_has_advice(self, tmp_path):
        path, _ = wrenches(tmp_path, "bag")
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(ParameterError, match=r"no whole index.* \(rosbag reindex\)$"):
            read(path)

    @pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap"])
    def test_an_empty_file(self, name, tmp_path):
        (tmp_path / name).touch()
        with pytest.raises(ParameterError, match=r"the file is empty$"):
            read(tmp_path / name)

    def test_messages_without_a_type_are_named_without_brackets(self):
        from mcap.writer import Writer

        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/raw", "binary", 0), START, b"x", START)
        writer.finish()
        [note] = read(stream.getvalue(), format="mcap").metadata["notes"]
        assert note.startswith("topic /raw is not read: ")

    def test_a_bag_that_lost_a_part(self, folder):
        path, _ = wrenches(folder, "mcap", name="lost")
        [part] = path.glob("*.mcap")
        part.unlink()
        with pytest.raises(ParameterError, match=r"lost_mcap\.mcap of the bag is missing"):
            read(path)
        (path / "metadata.yaml").write_text("a: [")
        with pytest.raises(ParameterError, match=r"metadata\.yaml"):
            read(path)


class TestSurvival:
    """The table of docs/ros-and-mcap.md, cell by cell."""

    DRIFT = 40e-6
    ROWS = 2003

    def stamp(self, row: int) -> int:
        """The first and the last message are on time, the others up to 36 us late."""
        return START + round(row * 10**6 * (1 + self.DRIFT)) + row * 5 % 13 * 3000

    def made(self, kind: str, folder: Path) -> Path:
        """1 kHz by a slow clock of the device, with 30 messages lost, and other topics."""
        name = "survival"
        with bag(folder, kind, name) as one:
            make = one.make
            for row in range(self.ROWS):
                if 700 <= row < 730:
                    continue
                t = self.stamp(row)
                one.put("/ft", t + 80_000 + row % 7, one.wrench(t, [row / 7] * 6, row))
                if row % 100 == 0:
                    vector, zeros = one.vector((row, 0, 9.81)), np.zeros(9)
                    turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
                    imu = [
                        one.header(START + row * 10**6, number=row // 100),
                        turn,
                        zeros,
                        vector,
                        zeros,
                        vector,
                        zeros,
                    ]
                    one.put("/imu", t, make("sensor_msgs/msg/Imu", *imu))
                    joints = [
                        one.header(START + row * 10**6, number=row // 100),
                        ["hip"],
                        np.ones(1),
                        np.ones(1),
                        np.ones(1),
                    ]
                    one.put("/joints", t, make("sensor_msgs/msg/JointState", *joints))
                    one.put("/say", t, make("std_msgs/msg/String", f"row {row}"))
                    layout = make("std_msgs/msg/MultiArrayLayout", [], 0)
                    loose = np.zeros(row // 100 % 3, np.float32)
                    one.put("/loose", t, make("std_msgs/msg/Float32MultiArray", layout, loose))
            seen = make(
                "sensor_msgs/msg/Image",
                one.header(START),
                1,
                1,
                "mono8",
                0,
                1,
                np.zeros(1, np.uint8),
            )
            one.put("/camera", START, seen)
        return path_of(folder, kind, name)

    def cells(self, found: Any) -> dict[str, str]:
        rows = np.delete(np.arange(self.ROWS), range(700, 730))
        force = found["wrench.force.x"]
        clocks = {
            name: [c for c in found.clocks if c.clock == name and c.channel == 0]
            for name in ("header", "log")
        }
        first, last = clocks["header"][0], clocks["header"][-1]
        period = (last.time_ns - first.time_ns) / (last.tick - first.tick)
        stamps = {"header": np.array([self.stamp(row) for row in range(self.ROWS)])}
        stamps["log"] = stamps["header"] + 80_000 + np.arange(self.ROWS) % 7
        kept = found["ft.stamp"]
        ticks = np.concatenate([np.arange(*span) for span in kept.coverage])
        checks = {
            "numbers": ("exact", force.stored.tolist() == (rows / 7).tolist()),
            "names of fields and joints": ("exact", "hip.position" in found and "linear_acceleration.z" in found),
            "`frame_id`": ("exact", force.device == "tool"),
            "units of the types above": ("exact", [found[n].unit for n in ("wrench.torque.z", "hip.effort", "angular_velocity.x")] == ["N.m", "N.m", "rad/s"]),
            "lost messages": ("exact", force.gaps == (Span(700, 730),)),
            "rate of the device": ("within 1 ppm", abs(period / (1e6 * (1 + self.DRIFT)) - 1) < 1e-6),
            "both clocks, once a second": ("exact", all(one.time_ns == stamps[name][one.tick] for name, own in clocks.items() for one in own) and len(clocks["log"]) >= 4),
            "every stamp, with `--keep-stamps`": ("exact", np.array_equal(found.epoch_ns + ticks * 10**6 + kept.stored, stamps["header"][rows])),
            "texts": ("exact", [e.text for e in found.events][:2] == ["row 0", "row 100"]),
        }  # fmt: skip
        lost = {
            "covariances": not any("covariance" in label for label in found.labels),
            "images": not any("camera" in label for label in found.labels),
            "arrays of changing length": not any("loose" in label for label in found.labels),
        }
        return {name: cell if ok else "broken" for name, (cell, ok) in checks.items()} | {
            name: "no" if ok else "broken" for name, ok in lost.items()
        }

    def test_every_cell(self, kind, folder):
        found = read(self.made(kind, folder), keep_stamps=True)
        from test_formats_mcap import table

        rows = table("*exact* is bit for bit. The\nlast column quotes")
        column = {"bag": ".bag", "db3": ".db3", "mcap": ".mcap"}[kind]
        assert {name: row[column] for name, row in rows.items()} == self.cells(found)
        notes = "\n".join(found.metadata["notes"])
        for row in rows.values():
            assert row["note"] in notes
