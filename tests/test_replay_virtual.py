"""A replay on a virtual clock: what the sinks get, however it ends."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from replay_watch import make_actuator, make_block, make_profile

from hapfmt.errors import DeviceError, FormatError
from hapfmt.replay.process.loop import rehearse
from hapfmt.replay.profile.model import Frame, HidReport, Integer, One, ReportLayout

MS = 10**6


def profile_with_reports(**timing):
    profile = make_profile(make_actuator(), gain=0.5, neutral_count=2, **timing)
    field = One(1, "force", Integer("i16"))
    return replace(
        profile,
        reports=(ReportLayout("output", 1, 3, (field,)),),
        init=(HidReport("feature", b"\x05go"),),
        exit=(HidReport("feature", b"\x05by"),),
    )


class Rendered:
    """What a Renderer gives, literally."""

    def __init__(self, *blocks):
        self.given = blocks
        self.kernels = {"force": "bounded"}
        self.left_out = ["B: N is no m"]
        self.lost = ["A: 3 samples"]

    def blocks(self):
        for block in self.given:
            if isinstance(block, BaseException):
                raise block
            yield block() if callable(block) else block


class Listed:
    """A sink that keeps all; ``fails`` at its n-th frame."""

    def __init__(self, fails=None):
        self.fails = fails
        self.calls = []

    def open(self):
        self.calls.append("open")

    def send(self, frame, reports):
        if len(self.calls) == self.fails:
            raise DeviceError("gone")
        self.calls.append((frame, reports))

    def close(self):
        self.calls.append("close")


def output(count):
    return (HidReport("output", b"\x01" + count.to_bytes(2, "little", signed=True)),)


def counts_of(sink):
    frames = [call[0] for call in sink.calls if call not in ("open", "close")]
    return [frame.counts[0][0] for frame in frames if frame.counts]


def test_all_that_a_sink_gets():
    sink = Listed()
    rehearse(Rendered(make_block(0, np.ones(5), last=True)), profile_with_reports(), [sink])
    assert sink.calls == [
        "open",
        (Frame(-1, 0, ()), (HidReport("feature", b"\x05go"),)),
        *((Frame(n, n * MS, ((x,),)), output(x)) for n, x in enumerate([73, 250, 427, 500, 500])),
        *((Frame(n, n * MS, ((x,),)), output(x)) for n, x in enumerate([427, 250, 73, 0], 5)),
        (Frame(-1, 9 * MS, ()), output(0)),
        (Frame(-1, 10 * MS, ()), output(0)),
        (Frame(-1, 11 * MS, ()), (HidReport("feature", b"\x05by"),)),
        "close",
    ]


def test_the_report():
    blocks = [make_block(0, [1, np.nan, 9] * 10), make_block(40, np.ones(9), last=True)]
    report = rehearse(Rendered(*blocks), profile_with_reports(), [], gain=1.0)
    assert report.to_json() | {"said": [], "realtime": {}} == report.to_json()
    assert (report.outcome, report.reason, report.signal, report.late) == ("clean", "", None, None)
    assert (report.sent, report.neutral, report.skipped, report.under_runs) == (53, 2, 0, 0)
    assert (report.refused, report.clamped, report.gap_samples) == (10, 5, 10)
    assert (report.kernels, report.left_out) == ({"force": "bounded"}, ["B: N is no m"])
    assert report.exit_code == 3  # samples were lost


def test_blocks_that_end_without_a_last():
    sink = Listed()
    report = rehearse(Rendered(make_block(0, np.ones(3))), profile_with_reports(), [sink])
    assert counts_of(sink) == [73, 250, 427, 250, 73, 0]
    assert (report.outcome, report.under_runs) == ("clean", 0)


@pytest.mark.parametrize("blocks", [[], [make_block(0, np.zeros(0), last=True)]])
def test_nothing_to_play(blocks):
    sink = Listed()
    assert rehearse(Rendered(*blocks), profile_with_reports(), [sink]).outcome == "clean"
    assert counts_of(sink) == [0]


@pytest.mark.parametrize(
    ("error", "code"), [(FormatError("wrong", requirement="DAT-001"), 2), (OSError("no disk"), 1)]
)
def test_an_error_of_the_file(error, code):
    """What came before it is played, then the ramp."""
    sink = Listed()
    rendered = Rendered(make_block(0, np.ones(5)), error)
    report = rehearse(rendered, profile_with_reports(), [sink])
    assert counts_of(sink) == [73, 250, 427, 500, 500, 427, 250, 73, 0]
    assert (report.outcome, report.reason, report.exit_code) == ("failed", str(error), code)
    assert sink.calls[-3][1] == output(0)


def test_an_error_that_is_none_of_ours_is_raised_after_the_ramp():
    sink = Listed()
    rendered = Rendered(make_block(0, np.ones(5)), ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        rehearse(rendered, profile_with_reports(), [sink])
    assert counts_of(sink)[-1] == 0
    assert sink.calls[-1] == "close"


def test_an_error_of_a_sink():
    sinks = [Listed(), Listed(fails=5), Listed()]
    rendered = Rendered(make_block(0, np.ones(50), last=True))
    with pytest.raises(DeviceError, match="gone"):
        rehearse(rendered, profile_with_reports(), sinks)
    assert [sink.calls[-1] for sink in sinks] == ["close"] * 3
    for sink in (sinks[0], sinks[2]):
        assert [call[1] for call in sink.calls[-4:-2]] == [output(0)] * 2
    assert len(sinks[1].calls) == 6


def test_a_sink_that_does_not_open():
    class Shut(Listed):
        def open(self):
            raise DeviceError("shut")

    first, last = Listed(), Listed()
    with pytest.raises(DeviceError, match="shut"):
        rehearse(Rendered(), profile_with_reports(), [first, Shut(), last])
    assert (first.calls, last.calls) == (["open", "close"], [])


@pytest.mark.skipif(os.name == "nt", reason="signals as on POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals(number):
    def asked():
        os.kill(os.getpid(), number)
        return make_block(5, np.ones(50))

    before = signal.getsignal(number)
    sink = Listed()
    report = rehearse(Rendered(make_block(0, np.ones(5)), asked), profile_with_reports(), [sink])
    assert counts_of(sink) == [73, 250, 427, 500, 500, 500, 427, 250, 73, 0]
    assert (report.outcome, report.signal, report.exit_code) == (
        "interrupted",
        number,
        128 + number,
    )
    assert signal.getsignal(number) is before


def test_blocks_are_taken_as_they_are_needed():
    taken = []

    def block(n):
        return lambda: taken.append(n) or make_block(n * 10, np.ones(10))

    class Counting(Listed):
        def send(self, frame, reports):  # noqa: ARG002
            if frame.counts and frame.number < 100:
                assert len(taken) == frame.number // 10 + 1

    rehearse(Rendered(*map(block, range(10))), profile_with_reports(), [Counting()])
    assert taken == list(range(10))


def test_periods_that_are_no_whole_nanoseconds():
    sink = Listed()
    rendered = Rendered(make_block(0, np.ones(3), last=True))
    rehearse(rendered, profile_with_reports(rate=Fraction(3000), ramp_s=0.001), [sink])
    due = [call[0].due_ns for call in sink.calls[2:-1]]
    assert due == [-(-n * 10**9 // 3000) for n in range(len(due))]
