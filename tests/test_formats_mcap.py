"""MCAP that hapfmt writes: mcap and rosbags read it strictly, and it comes back as it was."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
import tracemalloc
import uuid
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import strategies as s
from commands import run
from depth import DEEP, examples
from formats import damaged, survives, written
from hypothesis import given, settings
from ros_files import START, bag, json_mcap, path_of
from spec import ROOT

import hapfmt
from hapfmt.clocks import ClockMap, ClockObservation
from hapfmt.convert import imported, read, save
from hapfmt.errors import HapfmtError, ParameterError
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

SCHEMAS = ("ros2", "json")
RECORDINGS = sorted((ROOT.parent / "shared" / "data").glob("*/*.npz"))
PAGE = ROOT / "docs" / "ros-and-mcap.md"


@pytest.fixture(scope="module", params=SCHEMAS)
def schema(request) -> str:
    return request.param


def messages(data: bytes) -> list[tuple[Any, Any, Any]]:
    """(schema, channel, message) in order, by mcap with all checks of CRCs."""
    from mcap.reader import NonSeekingReader, SeekingReader
    from mcap.stream_reader import StreamReader

    count = len([*StreamReader(io.BytesIO(data), validate_crcs=True).records])
    assert count
    once = [*NonSeekingReader(io.BytesIO(data), validate_crcs=True).iter_messages()]
    found = [*SeekingReader(io.BytesIO(data), validate_crcs=True).iter_messages()]
    assert [each[2] for each in found] == [each[2] for each in once]
    return found


def decoded(data: bytes) -> Iterator[tuple[str, int, Any]]:
    """Topic, log time and message of ROS 2, by the definitions in the file, by rosbags."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    for schema, channel, message in messages(data):
        if schema.name not in store.fielddefs:
            found = get_types_from_msg(schema.data.decode(), schema.name)
            store.register({k: v for k, v in found.items() if k not in store.fielddefs})
        assert channel.message_encoding == "cdr" and schema.encoding == "ros2msg"
        yield channel.topic, message.log_time, store.deserialize_cdr(message.data, schema.name)


def vector(label: str, unit: str, quantity: str, rows: int = 50, axes: str = "xyz"):
    generator = np.random.default_rng(len(label))
    return [
        Channel(
            generator.normal(size=rows), 1000, label=f"{label}.{axis}", unit=unit,
            quantity=quantity, axis=axis, group=label, device="tool",
        )
        for axis in axes
    ]  # fmt: skip


def plain(label: str, unit: str, **described: Any) -> Channel:
    rows = described.pop("rows", 50)
    x = np.random.default_rng(3).normal(size=rows)
    return Channel(x, described.pop("rate", 1000), label=label, unit=unit, **described)


def kinds(recording: Recording) -> dict[str, str]:
    data, _ = written(recording, "mcap")
    return {channel.topic: schema.name for schema, channel, _ in messages(data)}


class TestTypes:
    def test_vectors_have_types_of_ros(self):
        recording = Recording(
            (
                *vector("left.force", "N", "force"),
                *vector("left.torque", "N.m", "torque"),
                *vector("right.force", "N", "force"),
                *vector("imu.linear_acceleration", "m/s2", "acceleration"),
                *vector("imu.angular_velocity", "rad/s", "velocity"),
                *vector("cam.position", "m", "position"),
                *vector("cam.orientation", "1", "orientation", axes="xyzw"),
                *vector("point", "m", "position"),
                *vector("mag", "T", "magnetic field"),
                *vector("base.linear", "m/s", "velocity"),
                *vector("base.angular", "rad/s", "velocity"),
            )
        )
        assert kinds(recording) == {
            "/left": "geometry_msgs/msg/WrenchStamped",
            "/right": "geometry_msgs/msg/Vector3Stamped",
            "/imu": "sensor_msgs/msg/Imu",
            "/cam": "geometry_msgs/msg/PoseStamped",
            "/point": "geometry_msgs/msg/PointStamped",
            "/mag": "sensor_msgs/msg/MagneticField",
            "/base": "geometry_msgs/msg/TwistStamped",
        }

    def test_every_value_stamp_and_frame_by_rosbags(self):
        recording = Recording(
            (*vector("ft.force", "N", "force"), *vector("ft.torque", "N.m", "torque")),
            epoch_ns=START + 7,
        )
        data, _ = written(recording, "mcap")
        rows = [*decoded(data)]
        assert [time for _, time, _ in rows] == [START + 7 + row * 10**6 for row in range(50)]
        for row, (topic, time, message) in enumerate(rows):
            assert topic == "/ft" and message.header.frame_id == "tool"
            stamp = message.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == time
            wrench = message.wrench
            values = [
                getattr(part, axis) for part in (wrench.force, wrench.torque) for axis in "xyz"
            ]
            assert values == [channel.stored[row] for channel in recording]

    def test_an_imu_without_orientation_says_so(self):
        recording = Recording(
            (*vector("linear_acceleration", "m/s2", ""), *vector("angular_velocity", "rad/s", ""))
        )
        for _, _, message in decoded(written(recording, "mcap")[0]):
            assert message.orientation_covariance[0] == -1

    def test_joints(self):
        recording = Recording(
            tuple(
                plain(f"{joint}.{what}", unit)
                for joint in ("hip", "Knie µ")
                for what, unit in (("position", "rad"), ("velocity", "rad/s"), ("effort", "N.m"))
            )
        )
        for row, (topic, _, message) in enumerate(decoded(written(recording, "mcap")[0])):
            assert (topic, message.name) == ("/joint_state", ["hip", "Knie µ"])
            assert message.position.tolist() == [recording[n].stored[row] for n in (0, 3)]
            assert message.effort.tolist() == [recording[n].stored[row] for n in (2, 5)]

    def test_single_numbers(self):
        recording = Recording(
            (
                plain("p", "Pa", quantity="pressure", device="a"),
                plain("t", "Cel", quantity="temperature", device="b"),
                plain("e", "lx", quantity="illuminance", device="c"),
            )
        )
        assert kinds(recording) == {
            "/a": "sensor_msgs/msg/FluidPressure",
            "/b": "sensor_msgs/msg/Temperature",
            "/c": "sensor_msgs/msg/Illuminance",
        }

    def test_all_others_have_a_field_each(self):
        counts = np.arange(-25, 25, dtype=np.int16)
        recording = Recording(
            (
                Channel(counts, 1000, calibration=Calibration(1, 0, 100), label="Grip force [N]"),
                Channel(np.arange(50, dtype=np.uint64) + 2**63, 1000, label="2nd"),
                Channel(np.arange(50, dtype=np.float32), 1000, label="class"),
                Channel(np.arange(50.0), 1000, label="Kraft µN"),
                Channel(np.arange(50.0), 1000, label="\x00"),
                Channel(np.arange(25.0), 500, label="slow"),
            )
        )
        rows = [*decoded(written(recording, "mcap")[0])]
        first = next(message for topic, _, message in rows if topic == "/samples")
        fields = first.__dataclass_fields__
        assert [name for name in fields if name != "header" and not name.startswith("__")] == [
            "grip_force_n", "ch2_2nd", "class_", "kraft_n", "ch5",
        ]  # fmt: skip
        assert first.grip_force_n == -0.25 and first.ch2_2nd == 2**63
        assert len({message.__msgtype__ for _, _, message in rows}) == 2

    def test_messages_come_in_order_of_time(self, schema):
        recording = Recording(
            (
                plain("a", "N", rows=9000),
                plain("b", "N", rows=30, rate=3),
                plain("c", "N", rate=77),
            ),
            events=tuple(Event(Fraction(n, 7), str(n)) for n in (40, 3, 12)),
        )
        found = messages(written(recording, "mcap", schema=schema)[0])
        times = [message.log_time for _, _, message in found]
        assert times == sorted(times) and len(times) == 9000 + 30 + 50 + 3
        for topic in {channel.topic for _, channel, _ in found}:
            numbers = [m.sequence for _, channel, m in found if channel.topic == topic]
            assert numbers == [*range(len(numbers))]

    def test_json_has_units_and_names(self):
        recording = Recording((*vector("ft.force", "mN", "force"),), epoch_ns=START)
        found = messages(written(recording, "mcap", schema="json")[0])
        kind, channel, message = found[1]
        assert (kind.encoding, channel.message_encoding) == ("jsonschema", "json")
        fields = json.loads(kind.data)["properties"]
        assert fields["ft_force_y"] == {"type": "number", "title": "ft.force.y", "unit": "mN"}
        assert json.loads(message.data) == {
            "timestamp": {"sec": START // 10**9, "nsec": 10**6},
            **{f"ft_force_{c.axis}": c.stored[1] for c in recording},
        }

    def test_events_are_log_messages(self):
        recording = Recording((), events=(Event(Fraction(1, 4), "slip", layer="grip"),))
        [(topic, time, message)] = decoded(written(recording, "mcap")[0])
        assert (topic, time, message.name, message.msg) == ("/events", 250_000_000, "grip", "slip")
        [(kind, _, message)] = messages(written(recording, "mcap", schema="json")[0])
        assert kind.name == "foxglove.Log"
        assert json.loads(message.data)["message"] == "slip"


class TestManyOfAll:
    def test_definitions_are_made_once(self, monkeypatch):
        from hapfmt.convert import ros_definitions

        made: list[object] = []
        original = ros_definitions.get_typestore
        monkeypatch.setattr(
            ros_definitions, "get_typestore", lambda *a: made.append(a) or original(*a)
        )
        ros_definitions._common.cache_clear()
        events = tuple(Event(Fraction(n), str(n)) for n in range(50))
        written(Recording((plain("a", "N"), plain("b", "N", rate=3)), events=events), "mcap")
        assert len(made) == 1

    def test_topics_of_one_name(self, schema):
        """A topic for each channel, since all have other gaps."""
        recording = Recording(
            tuple(plain(f"a{n}", "N", coverage=(Span(n, n + 50),)) for n in range(30))
        )
        data, _ = written(recording, "mcap", schema=schema)
        names = {channel.topic for _, channel, _ in messages(data)}
        assert names == {"/samples", *(f"/samples_{n}" for n in range(2, 31))}
        assert [facts(c) for c in read(data)] == [facts(c) for c in recording]


class TestRosbags:
    """A folder with metadata.yaml around our file is a bag that rosbags opens."""

    def test_as_a_bag(self, tmp_path):
        recording = Recording(
            (
                *vector("ft.force", "N", "force"),
                *vector("ft.torque", "N.m", "torque"),
                plain("x", "1"),
            )
        )
        from rosbags.highlevel import AnyReader
        from rosbags.rosbag2.storage_mcap import McapReader

        path = tmp_path / "a.mcap"
        save(recording, path)
        strict = McapReader(path)
        strict.open()
        assert strict.metadata.message_count == 100
        assert {one.topic for one in strict.connections} == {"/ft", "/samples"}
        strict.close()
        folder = as_bag(
            path, {"/ft": "geometry_msgs/msg/WrenchStamped", "/samples": "hapfmt_msgs/msg/Samples"}
        )
        with AnyReader([folder]) as reader:
            rows = [
                (one.topic, time, reader.deserialize(raw, one.msgtype))
                for one, time, raw in reader.messages()
            ]
        assert len(rows) == 100
        assert [m.wrench.force.y for topic, _, m in rows if topic == "/ft"] == recording[
            1
        ].stored.tolist()
        assert [m.x for topic, _, m in rows if topic == "/samples"] == recording[6].stored.tolist()
        back = read(folder)
        assert back.labels == recording.labels


def as_bag(path: Path, topics: dict[str, str]) -> Path:
    """The metadata that `ros2 bag reindex` would write."""
    about = {
        "version": 5, "storage_identifier": "mcap", "relative_file_paths": [path.name],
        "duration": {"nanoseconds": 1}, "starting_time": {"nanoseconds_since_epoch": 0},
        "message_count": 100, "compression_format": "", "compression_mode": "",
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name, "type": kind, "serialization_format": "cdr",
                    "offered_qos_profiles": "",
                },
                "message_count": 50,
            }
            for name, kind in topics.items()
        ],
        "files": [],
    }  # fmt: skip
    text = json.dumps({"rosbag2_bagfile_information": about})
    (path.parent / "metadata.yaml").write_text(text)
    return path.parent


def facts(channel: Channel) -> tuple[Any, ...]:
    return (
        channel.stored.tobytes(), channel.stored.dtype, channel.rate_exact, channel.coverage,
        channel.calibration, channel.label, channel.unit, channel.quantity, channel.axis,
        channel.group, channel.body_site, channel.device, channel.lsb,
    )  # fmt: skip


def members(recording: Recording) -> tuple[Any, ...]:
    metadata = {key: value for key, value in recording.metadata.items() if key != "notes"}
    return (
        recording.epoch_ns, recording.epoch_uncertainty_ns, metadata, recording.events,
        recording.clocks, recording.clock_maps, dict(recording.attachments),
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore::hapfmt.errors.DataWarning")
class TestRoundTrip:
    @settings(max_examples=examples(50), deadline=None)
    @given(recording=s.recordings().flatmap(s.clocked))
    def test_any_recording_comes_back(self, schema, recording):
        refused = reason(recording, schema)
        if refused:
            with pytest.raises(ParameterError, match=refused):
                written(recording, "mcap", schema=schema)
            return
        data, _ = written(recording, "mcap", schema=schema)
        messages(data)
        back = read(data)
        assert "notes" not in back.metadata
        assert members(back) == members(recording)
        for mine, theirs in zip(recording, back, strict=True):
            assert facts(replace(without_nan(mine), label=theirs.label)) == facts(theirs)

    def test_a_part_of_the_channels(self, schema):
        recording = Recording(
            (plain("a", "N"), plain("b", "N", rate=500), plain("c", "N")),
            events=(Event(Fraction(0), "a", channel=0), Event(Fraction(0), "c", channel=2),
                    Event(Fraction(0), "all")),
            clocks=(ClockObservation("pc", 2, 5, 7), ClockObservation("pc", 0, 5, 7)),
            clock_maps=(ClockMap("pc", 2, ((0, 0), (5, 5))),),
        )  # fmt: skip
        data, _ = written(recording, "mcap", schema=schema)
        back = read(data, select=["b", "c"])
        assert back.labels == ["b", "c"]
        assert [(e.text, e.channel) for e in back.events] == [("c", 1), ("all", None)]
        assert back.clocks == (ClockObservation("pc", 1, 5, 7),)
        assert back.clock_maps[0].channel == 1
        assert read(data, select="/samples_2").labels == ["b"]
        with pytest.raises(ParameterError, match=r"no topic or channel is called 'z'; there are: "):
            read(data, select="z")

    def test_integers_of_64_bits(self, schema):
        ends = (np.array([0, 2**64 - 1], np.uint64), np.array([-(2**63), 2**63 - 1]))
        recording = Recording(tuple(Channel(x, 10, label=str(x.dtype)) for x in ends))
        back = read(written(recording, "mcap", schema=schema)[0])
        assert [facts(c) for c in back] == [facts(c) for c in recording]

    def test_counts_that_no_double_tells_are_written_as_counts(self, schema):
        counts = np.arange(2**52 - 100, 2**52)
        far = Channel(counts, 10, calibration=Calibration(1, 2**52 - 1, 3), label="far")
        data, notes = written(Recording((far,)), "mcap", schema=schema)
        assert "channel 'far' is written as counts" in notes
        assert facts(read(data)[0]) == facts(far)

    def test_times_that_messages_do_not_hold(self, schema):
        one = plain("a", "N")
        early = Recording((one,), epoch_ns=-5)
        data, notes = written(early, "mcap", schema=schema)
        assert any("do not hold the start time" in note for note in notes)
        assert read(data).epoch_ns == -5
        late = replace(one, rate_exact=Fraction(1, 3600), coverage=(Span(2**40, 2**40 + 50),))
        with pytest.raises(ParameterError, match="messages of MCAP hold times up to"):
            written(Recording((late,)), "mcap", schema=schema)

    def test_infinities(self):
        one = Channel(np.array([1.0, np.inf, -np.inf]), 10, label="a")
        data, _ = written(Recording((one,)), "mcap")
        assert facts(read(data)[0]) == facts(one)
        with pytest.raises(ParameterError, match=r"infinities.*schema='ros2'"):
            written(Recording((one,)), "mcap", schema="json")

    def test_the_schemas_have_names(self):
        with pytest.raises(ParameterError, match="ros2 and json, not 'ros1'"):
            written(Recording((plain("a", "N"),)), "mcap", schema="ros1")

    def test_doubles_behind_a_grid_come_back_as_doubles(self, schema):
        x = np.array([0.1, 0.2, 0.30000000000000004])
        near = Channel(np.array([1, 2, 3]), 10, calibration=Calibration(1, 0, 10), exact=x)
        data, notes = written(Recording((near,)), "mcap", schema=schema)
        assert any("grids" in note for note in notes)
        assert read(data)[0].stored.tolist() == x.tolist()

    def test_other_clocks_are_read_as_in_the_files_of_others(self, schema):
        recording = Recording((plain("a", "N", rows=100),), epoch_ns=START)
        data, _ = written(recording, "mcap", schema=schema)
        back = read(data, clock="log")
        assert back.labels == ["a"] and back.epoch_ns == START
        assert np.array_equal(back[0].stored, recording[0].stored)
        assert {one.clock for one in back.clocks} == {"header", "log"}


def reason(recording: Recording, schema: str) -> str:
    """Why messages do not hold the recording; "" where they do."""
    limit = 2**31 if schema == "ros2" else Fraction(2**63, 10**9)
    if max(recording.duration, *(e.time for e in recording.events), 0) >= limit:
        return "hold times up to"
    if schema == "json" and any(
        c.stored.dtype.kind == "f" and np.isinf(c.stored).any() for c in recording
    ):
        return "infinities"
    return ""


def without_nan(channel: Channel) -> Channel:
    if channel.stored.dtype.kind != "f" or not (missing := np.isnan(channel.stored)).any():
        return channel
    ticks = np.concatenate([np.arange(*span) for span in channel.coverage])[~missing]
    from hapfmt.recording import spans_at

    return replace(channel, stored=channel.stored[~missing], coverage=spans_at(ticks))


class TestChanged:
    """What other programs change is never read as if nothing had happened."""

    def rewritten(self, data: bytes, change: Any) -> bytes:
        """By mcap, with each message as ``change`` makes it; None: it is left out."""
        from mcap.reader import make_reader
        from mcap.writer import Writer

        stream = io.BytesIO()
        reader, writer = make_reader(io.BytesIO(data)), Writer(stream)
        writer.start("ros2")
        for each in reader.iter_metadata():
            writer.add_metadata(each.name, each.metadata)
        ids: dict[int, int] = {}
        for kind, channel, message in reader.iter_messages():
            if channel.id not in ids:
                place = writer.register_schema(kind.name, kind.encoding, kind.data)
                ids[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, place
                )
            new = change(message)
            if new is not None:
                writer.add_message(
                    ids[channel.id], new.log_time, new.data, new.publish_time, new.sequence
                )
        writer.finish()
        return stream.getvalue()

    def test_as_they_are(self, schema):
        recording = Recording((plain("a b", "N"),), epoch_ns=START)
        data, _ = written(recording, "mcap", schema=schema)
        back = read(self.rewritten(data, lambda message: message))
        assert facts(back[0]) == facts(recording[0])

    def test_messages_left_out(self, schema):
        recording = Recording((plain("a b", "N", rows=200),), epoch_ns=START)
        data, _ = written(recording, "mcap", schema=schema)
        cut = self.rewritten(data, lambda m: None if m.sequence < 20 or m.sequence == 90 else m)
        back = read(cut)
        assert any("another program changed" in note for note in back.metadata["notes"])
        assert back.labels == ["a_b"]
        assert back[0].gaps == (Span(70, 71),)
        assert back.epoch_ns == START + 20 * 10**6

    def test_other_values(self):
        one = Channel(np.arange(50), 1000, calibration=Calibration(1, 0, 10), label="a")
        data, _ = written(Recording((one,)), "mcap", schema="json")

        def changed(message):
            message.data = re.sub(rb'"a":[0-9.]+', b'"a":0.123', message.data)
            return message

        with pytest.raises(ParameterError, match="channel 'a' are not those that hapfmt wrote"):
            read(self.rewritten(data, changed))

    def test_any_damage_gives_a_recording_or_our_error(self, schema):
        recording = Recording(
            (
                plain("a", "N"),
                Channel(np.arange(30, dtype=np.int32), 500, calibration=Calibration()),
            ),
            events=(Event(Fraction(1, 100), "x"),),
        )
        data, _ = written(recording, "mcap", schema=schema)
        for broken in damaged(data, examples(60), examples(150)):
            survives(broken, "mcap")

    @pytest.mark.parametrize(
        "wrong",
        [
            "[]", "{", '{"topics": 3}', '{"topics": [{}]}', "[" * 100_000,
            '{"zero_ns": 0, "topics": [{"name": "/a", "rate": "0", "spans": [], "channels": []}]}',
            '{"zero_ns": 0, "topics": [{"name": "/a", "rate": "1e99", "spans": [], "channels": []}]}',
            '{"zero_ns": 0, "topics": [{"name": "/a", "rate": "1", "spans": [[5, 2]], "channels": []}]}',
            '{"zero_ns": 0, "topics": [{"name": "/a", "rate": "1", "spans": [[0, 99999999999]], "channels": []}]}',
            '{"zero_ns": 0, "topics": [{"name": "/a", "rate": "1", "spans": [], "channels": [{"number": 1, "path": "x", "dtype": "float64"}]}]}',
            '{"zero_ns": 0, "topics": [{"name": "/a", "rate": "1", "spans": [], "channels": [{"number": 0, "path": "x", "dtype": "object"}]}]}',
            '{"zero_ns": 0, "topics": [], "events": [{"time": "x"}]}',
        ],
    )  # fmt: skip
    def test_metadata_of_any_kind(self, wrong):
        from mcap.writer import Writer

        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("hapfmt", {"recording": wrong})
        writer.finish()
        with pytest.raises((ParameterError, hapfmt.errors.LimitError)):
            read(stream.getvalue(), max_memory=1 << 24)


def leaves(found: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all values."""
    yield path
    inner = (
        found.items()
        if isinstance(found, dict)
        else enumerate(found)
        if isinstance(found, list)
        else ()
    )
    for key, each in inner:
        yield from leaves(each, (*path, key))


def replaced(found: Any, path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    keys = found.items() if isinstance(found, dict) else enumerate(found)
    made = {key: replaced(each, path[1:], value) if key == path[0] else each for key, each in keys}
    return made if isinstance(found, dict) else list(made.values())


WRONG = (
    None, True, -1, 0.5, 2**31, 2**62, 2**63 - 1, 2**70, -(2**63), 10**400, float("nan"), "", "x", "-1", "1e999999999",
    "1/0", "9" * 60, [], [[]], [1, 2], [[0, 1 << 48]], {}, {"a": 1},
)  # fmt: skip


class TestOwnMetadata:
    """Any value anywhere in the record of the metadata gives a recording or our error."""

    def test_any_value(self, schema):
        from mcap.reader import make_reader

        recording = Recording(
            (
                channel(coverage=(Span(0, 50), Span(60, 110)), axis="x"), plain("b", "N"),
                replace(plain("c", "1"), lsb=0.5),
            ),
            epoch_ns=START, epoch_uncertainty_ns=3, metadata={"a": 1},
            events=(Event(Fraction(1, 3), "x", channel=1),),
            clocks=(ClockObservation("pc", 0, 5, 7),),
            clock_maps=(ClockMap("pc", 0, ((0, 0), (5, 5))),),
        )  # fmt: skip
        data, _ = written(recording, "mcap", schema=schema)
        [about] = make_reader(io.BytesIO(data)).iter_metadata()
        own = json.loads(about.metadata["recording"])
        change = TestChanged()
        plain_copy = change.rewritten(data, lambda message: message)
        assert len(read(plain_copy)) == 3
        count = 0
        for path in leaves(own):
            for value in WRONG if DEEP else WRONG[sum(map(len, map(str, path))) % 12 :: 12]:
                wrong = json.dumps(replaced(own, path, value))
                broken = self.with_own(data, wrong)
                count += survives(broken, "mcap") is None
        assert count > 20

    def with_own(self, data: bytes, text: str) -> bytes:
        """The file with another record. Its summary is left out, so readers go through all of it."""
        from mcap.data_stream import RecordBuilder
        from mcap.records import Chunk, DataEnd, Footer, Header, Metadata
        from mcap.stream_reader import StreamReader

        builder = RecordBuilder()
        for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
            if isinstance(record, (Header, Chunk)):
                record.write(builder)
            elif isinstance(record, Metadata):
                Metadata("hapfmt", {"recording": text}).write(builder)
        DataEnd(0).write(builder)
        Footer(0, 0, 0).write(builder)
        magic = b"\x89MCAP0\r\n"
        return magic + builder.end() + magic


class TestOddMessages:
    """JSON holds anything, in any message."""

    @pytest.mark.parametrize("clock", [None, "header"])
    @pytest.mark.parametrize("way", ["all", "last", "some", "in turn"])
    def test_any_value(self, way, clock):
        odd = [*WRONG, float("inf"), 1e300, 2**64, "\ud800", "\0", [1.5] * 300, [[1, 2], [3]], {"sec": 1, "nsec": 2},
               {"sec": 2**70, "nsec": -(2**70)}, {"sec": "1", "nsec": None}, {"": 1, ".": 2, "a[0]": 3}]  # fmt: skip
        for value in odd:

            def message(row: int, value: Any = value) -> dict[str, Any]:
                wrong = {"all": True, "last": row == 19, "some": row % 7 == 3, "in turn": row % 2}[
                    way
                ]
                stamp = {"sec": 1_700_000_000, "nsec": row * 10**6}
                made: dict[str, Any] = {"timestamp": stamp, "v": 1, "w": {"x": row / 2}}
                return (
                    {
                        **made,
                        "v": value,
                        "w": {"x": value},
                        "timestamp": value if row % 10 else stamp,
                    }
                    if wrong
                    else made
                )

            data = json_mcap(("/a", START + row * 10**6, message(row)) for row in range(20))
            for options in ({}, {"clock": clock} if clock else {"keep_stamps": True}):
                try:
                    read(data, max_memory=1 << 24, **options)
                except HapfmtError as error:
                    assert str(error)


class TestMemory:
    @pytest.mark.deep
    def test_blocks_are_small(self, tmp_path, schema):
        """12 MB of values need 8 MB at most, and the progress reaches its end."""
        rows, width = 60_000, 25
        x = np.arange(rows * 1.0)
        recording = Recording(tuple(Channel(x, 1000, label=f"c{n}") for n in range(width)))
        seen: list[tuple[int, int]] = []
        save(recording, tmp_path / "a.mcap", schema=schema, progress=lambda *at: seen.append(at))
        assert seen[-1] == (rows, rows)
        for options in ({}, {"clock": "log"}):
            seen.clear()
            with imported(tmp_path / "a.mcap", progress=lambda *at: seen.append(at), **options) as (
                _,
                found,
            ):
                tracemalloc.start()
                try:
                    held = sum(len(block.values[0]) for block in found.blocks())
                    _, peak = tracemalloc.get_traced_memory()
                finally:
                    tracemalloc.stop()
            assert held == rows
            assert peak < 8 << 20, peak
            assert seen and seen[-1][0] <= seen[-1][1]


class TestCommands:
    def test_there_and_back(self, tmp_path, schema):
        recording = Recording(
            (*vector("ft.force", "N", "force", rows=2000), plain("a", "mm", rows=500, rate=250))
        )
        save(recording, tmp_path / "a.npz")
        assert run("convert", "a.npz", "a.mcap", "--schema", schema, cwd=tmp_path).returncode == 0
        found = run("info", "a.mcap", "--json", cwd=tmp_path)
        assert json.loads(found.stdout)["format"] == "mcap"
        assert run("encode", "a.mcap", "a.hapf", cwd=tmp_path).returncode == 0
        back = hapfmt.read(tmp_path / "a.hapf")
        assert back.labels == recording.labels
        assert np.array_equal(back["ft.force.x"].samples(), recording[0].stored)

    @pytest.mark.parametrize("package", ["mcap", "rosbags"])
    def test_without_the_extra(self, package, tmp_path):
        code = f"""
import sys, numpy as np, hapfmt
sys.modules[{package!r}] = None
for call in (
    lambda: hapfmt.save(np.zeros((1, 5)), "a.mcap", rate=10),
    lambda: hapfmt.read(b"\\x89MCAP0\\r\\n"),
):
    try:
        call()
    except hapfmt.HapfmtError as error:
        assert "pip install 'hapfmt[ros]'" in str(error), error
    else:
        raise SystemExit("no error")
"""
        subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
        assert not [*tmp_path.iterdir()]

    def test_notes_of_an_earlier_conversion_are_not_told_again(self, tmp_path):
        with bag(tmp_path, "bag", "noted") as one:
            for row in range(100):
                t = START + row * 10**7
                one.put("/ft", t, one.wrench(t, [row] * 6, row))
            one.put("/rare", START, one.make("std_msgs/msg/Float64", 1.0))
        first = run("convert", "noted.bag", "a.hapf", cwd=tmp_path)
        assert b"topic /rare has no steady rate" in first.stderr
        assert b"/rare" in run("info", "a.hapf", cwd=tmp_path).stdout
        for words in (["convert", "a.hapf", "b.npz"], ["encode", "a.hapf", "b.hapf"]):
            done = run(*words, cwd=tmp_path)
            assert done.returncode == 0 and b"rare" not in done.stderr

    def test_schema_is_for_mcap(self, tmp_path):
        save(Recording((plain("a", "N"),)), tmp_path / "a.npz")
        for name in ("a.csv", "a.hapf"):
            done = run("convert", "a.npz", name, "--schema", "json", cwd=tmp_path)
            assert done.returncode == 1 and b"schema" in done.stderr


class TestFromBags:
    @pytest.mark.parametrize("way", ["ros2", "json"])
    def test_topics_keep_their_names(self, tmp_path, way):
        with bag(tmp_path, "bag", "named") as one:
            for row in range(100):
                t = START + row * 10**7
                one.put("/left/ft_sensor/wrench", t, one.wrench(t, [row] * 6, row))
                one.put("/b/wrench", t, one.wrench(t, [row] * 6, row))
                for name in ("/near", "/arm/far"):
                    one.put(name, t, one.make("std_msgs/msg/Float64", row / 2))
        whole = read(path_of(tmp_path, "bag", "named"))
        assert whole.metadata["topics"]["/near"] == ["near"]
        hapfmt.write(whole, tmp_path / "named.hapf")
        stored = hapfmt.read(tmp_path / "named.hapf")
        target = io.BytesIO()
        save(stored, target, format="mcap", schema=way)
        names = {"/left/ft_sensor/wrench", "/b/wrench", "/near", "/arm/far"}
        assert {channel.topic for _, channel, _ in messages(target.getvalue())} == names
        back = read(io.BytesIO(target.getvalue()))
        assert back.labels == whole.labels
        assert np.array_equal(back.to_numpy(), whole.to_numpy())

    @pytest.mark.parametrize(
        "wrong", [3, ["a"], {"": ["a"]}, {"\0": ["a"]}, {"/x": "a"}, {"/x": [3, {}]}]
    )
    def test_other_metadata_of_that_name(self, wrong):
        recording = Recording((plain("a", "N"),), metadata={"topics": wrong})
        target = io.BytesIO()
        save(recording, target, format="mcap")
        assert {channel.topic for _, channel, _ in messages(target.getvalue())} == {"/samples"}
        assert read(io.BytesIO(target.getvalue())).metadata["topics"] == wrong

    def test_a_bag_of_ros_1_becomes_the_same_messages(self, tmp_path):
        with bag(tmp_path, "bag") as one:
            for row in range(100):
                t = START + row * 10**7
                one.put("/ft", t + 5, one.wrench(t, [row / 3] * 6, row))
        recording = read(path_of(tmp_path, "bag"))
        data, _ = written(recording, "mcap")
        for row, (topic, time, message) in enumerate(decoded(data)):
            assert (topic, time, message.wrench.force.x) == (
                "/ft",
                START + row * 10**7,
                row / 3,
            )
        assert members(read(data)) == members(recording)


def channel(**described: Any) -> Channel:
    stored = described.pop("stored", np.arange(-50, 50, dtype=np.int16))
    known = {"label": "fx", "calibration": Calibration(1, 0, 100), "rate": 1000, **described}
    return Channel(stored, **known)


def floating(*values: float) -> Recording:
    return Recording((channel(stored=np.array(values), calibration=None),))


CASES = {
    "integers with a calibration": Recording((channel(),)),
    "floating point": floating(0.1, -0.0, 5e-324, 1e308),
    "NaN": floating(0.5, np.nan, 1.5),
    "infinities": floating(np.inf, -np.inf),
    "a rate of 44100/7 Hz": Recording((channel(rate=Fraction(44_100, 7)),)),
    "several rates": Recording((channel(), channel(rate=500, label="fy"))),
    "gaps": Recording((channel(coverage=(Span(3, 53), Span(70, 120))),)),
    "the start time": Recording((channel(),), epoch_ns=START + 1),
    "labels and units": Recording((channel(label="Kraft [µ] \t", unit="{raw(0-255)}"),)),
    "axes, groups, devices": Recording(
        tuple(channel(label=f"f{a}", axis=a, group="a b", device="d", unit="N") for a in "xyz")
    ),
    "clocks": Recording(
        (channel(),), clocks=(ClockObservation("pc", 0, 3, 5, 1),),
        clock_maps=(ClockMap("pc", None, ((0, 1), (2, 3))),),
    ),
    "events and layers": Recording(
        (channel(),), events=(Event(Fraction(1, 3), "a", Fraction(1, 7), 0, "layer"),)
    ),
    "metadata": Recording((channel(),), metadata={"a": {"b": [1, None, "µ"]}}),
    "attachments": Recording((channel(),), attachments={"a.txt": ("text/plain", b"x")}),
    "the file id": Recording((channel(),), uuid=uuid.UUID(int=7)),
    "longer than 68 years": Recording((channel(rate=1, coverage=(Span(2**31, 2**31 + 100),)),)),
}  # fmt: skip


def table(after: str) -> dict[str, dict[str, str]]:
    part = PAGE.read_text("utf-8").split(after)[1]
    lines = part[part.index("\n|") :].strip().split("\n\n")[0].splitlines()
    head, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}


def survival(recording: Recording, schema: str) -> str:
    try:
        data, notes = written(recording, "mcap", schema=schema)
    except ParameterError:
        return "refused"
    back = read(data)
    if any("NaN values" in note for note in notes):
        gap = back[0].coverage == (Span(0, 1), Span(2, 3))
        return "a gap" if gap else "no"
    if recording.uuid != back.uuid:
        assert any("not carried over to .mcap: uuid" in note for note in notes)
        return "no"
    assert not notes
    same = members(back) == members(recording) and list(map(facts, back)) == list(
        map(facts, recording)
    )
    return "exact" if same else "changed"


@pytest.mark.parametrize("case", CASES)
def test_cells_of_what_we_write(case):
    cells = table("A\ntest checks each cell:\n")[case]
    assert {name: survival(CASES[case], name) for name in cells} == cells


def test_the_table_has_no_other_row():
    assert [*table("A\ntest checks each cell:\n")] == [*CASES]


@pytest.mark.deep
@pytest.mark.skipif(not RECORDINGS, reason="no recordings in ../shared/data")
@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_real_recordings_come_back(schema, path):
    recording = read(path)
    back = read(written(recording, "mcap", schema=schema)[0])
    assert [facts(without_nan(c)) for c in recording] == [facts(c) for c in back]
