"""What passes between the processes of a replay; the watchdog by itself, keys, settings."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from replaying import PATIENT_S, lines, until

from hapfmt.errors import DeviceError, ParameterError
from hapfmt.replay.process import children
from hapfmt.replay.process.children import COLUMNS, LINES, Errors, descriptor, start
from hapfmt.replay.process.loop import ReplayReport
from hapfmt.replay.process.pipes import (
    HEADER,
    SIZE_LIMIT,
    Inbox,
    Inlet,
    Kind,
    Message,
    MessageError,
    Outlet,
    Sent,
    ThreadedInlet,
    ThreadedOutlet,
    inlet,
    outlet,
    pack,
    pack_block,
    pack_json,
    pack_log,
    parse_block,
    parse_log,
    parts,
    reports_json,
    reports_of,
)
from hapfmt.replay.process.player import BYTES, TerminalKeys, split
from hapfmt.replay.process.watchdog import first_message
from hapfmt.replay.profile.model import Frame, FrameBlock, HidReport
from hapfmt.replay.sinks import open_sink

posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX only")
MESSAGES = st.lists(
    st.tuples(st.sampled_from(list(Kind)), st.binary(max_size=40)).map(lambda m: Message(*m)),
    max_size=6,
)


def taken(inbox: Inbox) -> list[Message]:
    found = []
    while (message := inbox.take()) is not None:
        found.append(message)
    return found


class TestMessages:
    @given(MESSAGES, st.integers(1, 50))
    def test_whole_and_in_pieces(self, messages, size):
        data = b"".join(pack(*message) for message in messages)
        whole, pieces = Inbox(), Inbox()
        whole.feed(data)
        found = []
        for place in range(0, len(data), size):
            pieces.feed(data[place : place + size])
            found += taken(pieces)
        assert taken(whole) == found == messages
        whole.end()
        pieces.end()

    @given(st.binary(max_size=60))
    def test_any_bytes_give_messages_or_our_error(self, data):
        inbox = Inbox()
        inbox.feed(data)
        with suppress(MessageError):
            for message in taken(inbox):
                for parse in (message.fields, lambda m=message: message_bodies(m)):
                    with suppress(MessageError):
                        parse()
            inbox.end()

    @given(MESSAGES.filter(bool), st.data())
    def test_a_cut_is_reported(self, messages, data):
        whole = b"".join(pack(*message) for message in messages)
        cut = data.draw(st.integers(1, HEADER.size + len(messages[-1].payload) - 1))
        inbox = Inbox()
        inbox.feed(whole[:-cut])
        assert taken(inbox) == messages[:-1]
        with pytest.raises(MessageError, match="cut off"):
            inbox.end()

    def test_a_size_is_refused_before_its_bytes_come(self):
        inbox = Inbox()
        inbox.feed(HEADER.pack(Kind.BLOCK, SIZE_LIMIT + 1))
        with pytest.raises(MessageError, match="more than"):
            inbox.take()

    def test_fields(self):
        message = Message(Kind.STOP, b'{"outcome": "late", "number": 3, "flag": true}')
        assert message.field("outcome", str) == "late"
        assert message.field("number", float) == 3.0
        for name, kind in (("outcome", int), ("flag", int), ("flag", float), ("none", str)):
            with pytest.raises(MessageError, match=name):
                message.field(name, kind)

    @pytest.mark.parametrize("payload", [b"", b"\xff", b"[1]", b"[" * 100_000, b'{"a": }'])
    def test_no_json_object(self, payload):
        with pytest.raises(MessageError):
            Message(Kind.STATUS, payload).fields()

    def test_reports(self):
        reports = (HidReport("output", b"\1\2"), HidReport("feature", b"\3"))
        assert reports_of(json.loads(json.dumps(reports_json(reports)))) == reports
        for wrong in (3, [["output", "xy"]], [["input", "00"]], [["output"]], [[1, 2]]):
            with pytest.raises(MessageError):
                reports_of(wrong)


def message_bodies(message: Message) -> None:
    for parse in (parse_block, parse_log):
        with suppress(MessageError):
            parse(message.payload)


@st.composite
def blocks(draw: Any) -> FrameBlock:
    shape = draw(st.tuples(st.integers(0, 9), st.integers(0, 4)))
    return FrameBlock(
        draw(st.integers(-(2**63), 2**63 - 20)),
        draw(arrays(np.float64, shape)),
        draw(arrays(np.bool_, shape)),
        draw(st.integers(0, 2**32 - 1)),
        draw(st.booleans()),
    )


def same(x: FrameBlock, y: FrameBlock) -> bool:
    arrays_equal = x.values.tobytes() == y.values.tobytes() and np.array_equal(x.known, y.known)
    return arrays_equal and x._replace(values=0, known=0) == y._replace(values=0, known=0)


class TestBlocks:
    @given(blocks())
    def test_both_ways(self, block):
        assert same(parse_block(pack_block(block)), block)

    @given(blocks(), st.integers(1, 12))
    def test_parts(self, block, values):
        found = list(parts(block, values))
        assert all(part.values.size <= max(values, part.values.shape[1]) for part in found)
        size = max(values // max(block.values.shape[1], 1), 1)
        assert [part.first for part in found] == list(
            range(block.first, block.first + max(len(block.values), 1), size)
        )
        assert np.concatenate([part.values for part in found]).tobytes() == block.values.tobytes()
        assert [part.last for part in found] == [False] * (len(found) - 1) + [block.last]

    def test_parts_of_many_actuators_at_a_high_rate(self):
        """50 ms of 256 actuators at 96 kHz: each message within its limit."""
        values = np.zeros((4800, 256))
        for part in parts(FrameBlock(0, values, values == 0)):
            inbox = Inbox()
            inbox.feed(pack(Kind.BLOCK, pack_block(part)))
            message = inbox.take()
            assert message is not None and same(parse_block(message.payload), part)

    @given(st.binary(max_size=80))
    def test_any_bytes(self, data):
        for parse in (parse_block, parse_log):
            with suppress(MessageError):
                parse(data)

    @given(st.data(), st.integers(1, 3), st.integers(0, 3), st.integers(1, 5))
    def test_log(self, data, samples, actuators, count):
        number = st.integers(-(2**63), 2**63 - 1)
        row = st.tuples(*[number] * actuators)
        log = [
            Sent(
                Frame(data.draw(number), data.draw(number), data.draw(st.tuples(*[row] * samples))),
                data.draw(number),
            )
            for _ in range(count)
        ]
        assert parse_log(pack_log(log)) == log


@contextmanager
def pipe(reader: type[Inlet], writer: type[Outlet]) -> Iterator[tuple[Inlet, Outlet]]:
    near, far = os.pipe()
    target = writer(far)
    try:
        yield reader(near), target
    finally:
        target.close()
        for each in (far, near):
            with suppress(OSError):
                os.close(each)


@posix
@pytest.mark.parametrize("reader", [Inlet, ThreadedInlet])
@pytest.mark.parametrize("writer", [Outlet, ThreadedOutlet])
class TestPipes:
    def test_messages_pass(self, reader, writer):
        with pipe(reader, writer) as (source, target):
            assert source.take() is None and not source.ended
            for number in range(300):
                target.send(pack(Kind.BLOCK, bytes([number % 256]) * number))
            target.drain(0.0)
            for number in range(300):
                message = first_message(source, Kind.BLOCK, PATIENT_S)
                assert message.payload == bytes([number % 256]) * number
                target.flush()
            os.close(target.descriptor)
            until(lambda: source.take() is None and source.ended)

    def test_wait_ends(self, reader, writer):
        with pipe(reader, writer) as (source, target):
            began = time.monotonic()
            source.wait(0.05)
            assert 0.04 < time.monotonic() - began < PATIENT_S
            target.send(pack(Kind.ALIVE))
            source.wait(PATIENT_S)
            assert until(source.take) == Message(Kind.ALIVE, b"")
            with pytest.raises(MessageError, match="silence"):
                first_message(source, Kind.SETUP, 0.05)
            target.send(pack(Kind.ALIVE))
            with pytest.raises(MessageError, match="ALIVE instead of SETUP"):
                first_message(source, Kind.SETUP, PATIENT_S)
            os.close(target.descriptor)
            with pytest.raises(MessageError, match="the pipe ended"):
                first_message(source, Kind.SETUP, PATIENT_S)


@posix
@pytest.mark.parametrize("writer", [Outlet, ThreadedOutlet])
def test_nobody_reads(writer):
    with pipe(Inlet, writer) as (_, target):
        for _ in range(3):
            target.send(bytes(SIZE_LIMIT))
        assert target.broken
        size = len(target.waiting)
        target.send(b"x")
        assert len(target.waiting) <= size + 1


@posix
def test_the_other_side_has_gone():
    near, far = os.pipe()
    os.close(near)
    target = outlet(far)
    target.send(b"x")
    assert target.broken
    os.close(far)


class Dog:
    """A watchdog, and we are its writer."""

    def __init__(self, file: Path, **setup: Any) -> None:
        self.file = file
        self.process = start("watchdog", subprocess.PIPE)
        self.errors = Errors(self.process.stderr)
        self.source = inlet(descriptor(self.process.stdout))
        self.target = outlet(descriptor(self.process.stdin))
        neutral = [[["output", f"01{number:02x}" + "00" * 10]] for number in range(3)]
        sink = {"kind": "loopback", "file": str(file), "faults": setup.pop("faults", None)}
        self.setup = {
            "sink": sink,
            "neutral": neutral,
            "heartbeat_s": 30.0,
            "period_s": 0.001,
            "realtime": False,
            **setup,
        }

    def __enter__(self) -> Dog:
        self.target.send(pack_json(Kind.SETUP, **self.setup))
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.hang_up()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.errors.wait(PATIENT_S)

    def hang_up(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()

    def ready(self) -> dict[str, Any]:
        return first_message(self.source, Kind.READY, PATIENT_S).fields()

    def hears(self, kind: Kind) -> Message:
        """The next message of this kind; the watchdog tells meanwhile that it lives."""

        def next_one() -> Message | None:
            while (message := self.source.take()) is not None and message.kind is Kind.ALIVE:
                pass
            return message

        message: Message = until(next_one)
        assert message.kind is kind
        return message

    def ended(self) -> int:
        code = self.process.wait(PATIENT_S)
        self.errors.wait(PATIENT_S)
        return code


class TestWatchdog:
    def test_a_goodbye(self, tmp_path):
        with Dog(tmp_path / "device") as dog:
            assert set(dog.ready()) == {"realtime"}
            for _ in range(20):
                dog.target.send(pack(Kind.BEAT))
            dog.target.send(pack(Kind.GOODBYE))
            assert dog.ended() == 0
        assert lines(dog.file) == []
        assert (dog.errors.watchdog, dog.errors.lines) == ("", [])

    @pytest.mark.parametrize("last", [b"", pack(Kind.BEAT)[:3], b"\xff\xff"])
    def test_the_writer_has_died(self, tmp_path, last):
        """Whole messages or not: without a goodbye."""
        with Dog(tmp_path / "device") as dog:
            dog.ready()
            dog.target.send(pack(Kind.BEAT) + last)
            dog.hang_up()
            assert dog.ended() == 0
        assert [line.report[1] for line in lines(dog.file)][:3] == [0, 1, 2]
        assert all(line.neutral for line in lines(dog.file))
        assert dog.errors.watchdog.startswith("tripped: the writer has died; the device took")

    @pytest.mark.realtime
    def test_the_writer_is_silent(self, tmp_path):
        with Dog(tmp_path / "device", heartbeat_s=0.05) as dog:
            dog.ready()
            cause = dog.hears(Kind.TRIPPED).field("cause", str)
            assert cause.startswith("the writer was silent for")
            until(lambda: len(lines(dog.file)) > 5)
            dog.target.send(pack(Kind.GOODBYE))
            assert dog.ended() == 0
        assert all(line.neutral for line in lines(dog.file))

    @pytest.mark.parametrize(
        ("faults", "tried"), [({"gone": 0}, 1), ({"fail": {"frame": 0, "times": 9}}, 3)]
    )
    def test_a_device_that_takes_nothing(self, tmp_path, faults, tried):
        """One try where it is gone, all of them where it is there."""
        with Dog(tmp_path / "device", faults=faults) as dog:
            dog.ready()
            dog.hang_up()
            assert dog.ended() == 0
        assert dog.errors.watchdog.startswith(
            f"tripped: the writer has died; the device took 0 neutral frames, {tried} not:"
        )

    @posix
    def test_a_signal(self, tmp_path):
        with Dog(tmp_path / "device") as dog:
            dog.ready()
            dog.process.send_signal(signal.SIGTERM)
            assert dog.hears(Kind.GOODBYE).field("signal", int) == signal.SIGTERM
            assert dog.process.poll() is None
            dog.target.send(pack(Kind.GOODBYE))
            assert dog.ended() == 0
        assert lines(dog.file) == []

    @pytest.mark.parametrize(
        ("setup", "said"),
        [
            ({"faults": {"open": True}}, "cannot be opened"),
            ({"sink": {"kind": "none"}}, "no sink"),
            ({"neutral": []}, "no neutral frame"),
            ({"neutral": [3]}, "no reports"),
            ({"heartbeat_s": "soon"}, "'heartbeat_s' is not of type float"),
        ],
    )
    def test_it_cannot_begin(self, tmp_path, setup, said):
        with Dog(tmp_path / "device", **setup) as dog:
            assert said in dog.ready()["error"]
            assert dog.ended() != 0

    def test_it_loads_no_arrays(self):
        code = "import hapfmt.replay.process.watchdog, sys; sys.exit('numpy' in sys.modules)"
        assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


class TestErrors:
    def test_lines_are_bounded(self):
        code = f"print('x' * {COLUMNS + 10}); [print(i) for i in range({LINES + 10})]"
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, bufsize=0)
        errors = Errors(process.stdout)
        errors.wait(PATIENT_S)
        process.wait()
        assert len(errors.lines) == LINES
        assert len(errors.lines[0]) == COLUMNS

    def test_lines_that_only_look_like_those_of_a_watchdog(self):
        errors = ["[1", '{"watchdog": 3', '{"watchdog": 3}', '{"watchdog": {"state": "x"}}']
        code = f"for line in {errors!r}: print(line)"
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, bufsize=0)
        read = Errors(process.stdout)
        read.wait(PATIENT_S)
        process.wait()
        assert (read.watchdog, read.lines) == ("", errors)


class TestRealtime:
    def test_each_says_what_it_got(self):
        code = (
            "from hapfmt.replay.process import children as realtime; import json;"
            "print(json.dumps([realtime.apply(), realtime.nothing()]))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, check=True, text=True
        )
        got, nothing = json.loads(done.stdout)
        assert got.keys() == nothing.keys()
        assert all(got.values())
        assert set(nothing.values()) == {"not asked for"}
        assert got["collector"] == "off"

    @pytest.mark.skipif(sys.platform != "linux", reason="the words of Linux")
    def test_what_is_not_permitted(self):
        """An ordinary user, and no limits raised for him."""
        code = (
            "import os, resource, json\n"
            "for name in ('RLIMIT_RTPRIO', 'RLIMIT_NICE'):\n"
            "    resource.setrlimit(getattr(resource, name), (0, 0))\n"
            "resource.setrlimit(resource.RLIMIT_MEMLOCK, (4096, 4096))\n"
            "from hapfmt.replay.process import children as realtime\n"
            "if os.geteuid() == 0:\n"
            "    os.setuid(65534)\n"
            "print(json.dumps(realtime.apply()))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, check=True, text=True
        )
        got = json.loads(done.stdout)
        assert got["scheduler"] == "SCHED_FIFO not permitted (RLIMIT_RTPRIO 0)"
        assert got["memory"].endswith("RLIMIT_MEMLOCK 4096)")
        assert got["timer"] == "slack 1 ns"

    def test_an_attempt(self):
        def refused() -> str:
            raise PermissionError(1, "no")

        assert children.attempted(lambda: "yes") == "yes"
        assert children.attempted(refused) == "not permitted (no)"


class TestKeys:
    @given(st.lists(st.sampled_from([*BYTES, b"x", b"\x1b[A", b"\n"]), max_size=8))
    def test_split(self, given):
        data = b"".join(given)
        expected = [BYTES[each] for each in given if each in BYTES]
        assert split(data) == (expected, b"")
        found, waiting = [], b""
        for byte in data:
            keys, waiting = split(waiting + bytes([byte]))
            found += keys
        assert found == expected

    @given(st.binary(max_size=20))
    def test_any_bytes(self, data):
        assert len(split(data)[1]) < 3

    @posix
    def test_a_terminal_is_as_before(self):
        import pty
        import termios

        master, slave = pty.openpty()
        try:
            before = termios.tcgetattr(slave)
            with pytest.raises(KeyError), TerminalKeys(slave) as keys:
                assert termios.tcgetattr(slave) != before
                assert keys.pressed() == []
                os.write(master, b" \x1b[C\x1b[Dxq")
                found: list[str] = []
                until(lambda: found.extend(keys.pressed()) or len(found) == 4)
                assert found == ["pause", "forward", "back", "stop"]
                raise KeyError
            assert termios.tcgetattr(slave) == before
        finally:
            os.close(master)
            os.close(slave)

    @posix
    def test_a_terminal_that_goes(self):
        import pty

        master, slave = pty.openpty()
        with TerminalKeys(slave) as keys:
            os.close(master)
            os.close(slave)
            assert keys.pressed() == []

    def test_no_terminal(self):
        near, far = os.pipe()
        with TerminalKeys(near) as keys:
            os.write(far, b"q")
            assert keys.pressed() == []
        os.close(near)
        os.close(far)


class TestReport:
    @pytest.mark.parametrize(
        ("report", "code"),
        [
            (ReplayReport("clean"), 0),
            (ReplayReport("clean", lost=["something"]), 3),
            (ReplayReport("late", lost=["something"]), 5),
            (ReplayReport("device-lost", signal=2), 6),
            (ReplayReport("interrupted", signal=15, lost=["something"]), 143),
            (ReplayReport("interrupted"), 0),
            (ReplayReport("failed"), 1),
            (ReplayReport("failed", error_code=4), 4),
        ],
    )
    def test_exit_codes(self, report, code):
        """Clause 13."""
        assert report.exit_code == report.to_json()["exit_code"] == code
        json.dumps(report.to_json())


class TestLoopback:
    def frames(self, **how: Any) -> Any:
        return open_sink({"kind": "loopback", **how})

    def test_lines(self, tmp_path):
        file = tmp_path / "device"
        sink = self.frames(file=str(file))
        reports = (HidReport("output", b"\1" + bytes(11)),)
        sink.send(Frame(3, 17, ((0,),)), reports)
        sink.close()
        sink.close()
        (line,) = lines(file)
        assert (line.by, line.number, line.due_ns) == (os.getpid(), 3, 17)
        with pytest.raises(DeviceError, match="not open"):
            sink.send(Frame(4, 18, ((0,),)), reports)

    def test_gone_is_gone_for_all(self, tmp_path):
        file = str(tmp_path / "device")
        one, two = (
            self.frames(file=file, faults={"gone": 0}),
            self.frames(file=file, faults={"gone": 9}),
        )
        for sink in (one, two):
            with pytest.raises(DeviceError, match="gone"):
                sink.send(Frame(0, 0, ()), ())
            sink.close()

    def test_configs(self, tmp_path):
        for config in ({}, {"kind": "other"}):
            with pytest.raises(ParameterError):
                open_sink(config)
        with pytest.raises(ParameterError, match="fault"):
            self.frames(file=str(tmp_path / "device"), faults={"flood": 1})
