"""Recorder: whatever the chunks, the recording is that of the whole; what fails says so."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
import threading
import time
import warnings
from contextlib import nullcontext
from fractions import Fraction

import numpy as np
import pytest
from depth import either, examples
from hypothesis import given, settings
from hypothesis import strategies as st
from spec import ROOT

import hapfmt
from hapfmt import Calibration, Channel, Input, Recorder, Recording, Settings, Span
from hapfmt.errors import DataWarning, HapfmtError, LimitError, ParameterError
from hapfmt.recording import spans_of
from hapfmt.writing.clusters import ClusterGrid, SampleRows

CALIBRATION = Calibration(1, 3, 200)
RATES = [Fraction(1), Fraction(10), Fraction(1000), Fraction(44100, 7), Fraction(1, 10)]


def counts_input(label: str = "force", rate: object = 1000, **given: object) -> Input:
    return Input(label, rate, "N", calibration=CALIBRATION, **given)


@st.composite
def sources(draw):
    """An input, its samples by tick and which of them there are: [ticks], [ticks]."""
    number = draw(st.integers(0, 99))
    rate = draw(st.sampled_from(RATES))
    size = draw(st.integers(0, 60) | st.integers(0, 4000))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    known = np.ones(size, np.bool_)
    for _ in range(draw(st.integers(0, 3))):
        a = draw(st.integers(0, size))
        known[a : a + draw(st.integers(0, 300))] = False
    kind = draw(st.sampled_from(["counts", "lsb", "doubles"]))
    label = f"{kind} {number}"
    walk = np.cumsum(rng.integers(-9, 10, size))
    if kind == "counts":
        return counts_input(label, rate), walk.astype(np.int64), known
    if kind == "lsb":
        return Input(label, rate, "m", lsb=0.001), walk / 1000, known
    return Input(label, rate, "m"), rng.normal(size=size), known


def channel_of(source) -> Channel:
    given, values, known = source
    return Channel(
        values[known],
        given.rate,
        tuple(spans_of(known)),
        calibration=given.calibration,
        label=given.label,
        unit=given.unit,
    )


def same_channel(found: Channel, source) -> None:
    expected = channel_of(source)
    assert (found.label, found.rate_exact, found.coverage) == (
        expected.label,
        expected.rate_exact,
        expected.coverage,
    )
    if source[0].lsb is None:
        assert found.samples().tobytes() == expected.samples().tobytes()
    else:
        deviation = found.deviation.declared if found.deviation else 0.0
        assert deviation <= 0.00051
        assert np.allclose(found.samples(), expected.samples(), rtol=0, atol=deviation + 1e-12)


@st.composite
def chunkings(draw, sources, most_calls=600):
    """(channel, from, to) in any order of the channels, each in its own order."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    most = draw(st.sampled_from([1, 7, 100, 5000]))
    left = {place: 0 for place, source in enumerate(sources) if source[1].size}
    calls = []
    while left and len(calls) < most_calls:
        place = int(rng.choice(list(left)))
        size = sources[place][1].size
        at, stop = left[place], min(left[place] + int(rng.integers(1, most + 1)), size)
        if len(calls) > most_calls * 2 // 3:
            stop = size
        calls.append((place, at, stop))
        left[place] = stop
        if stop == size:
            del left[place]
    return calls


@pytest.mark.compiled
@either("most_calls", 600, 1500, 3000)
@given(data=st.data())
def test_any_chunking_gives_the_recording_of_the_whole(most_calls, data):
    found = data.draw(st.lists(sources(), min_size=1, max_size=4, unique_by=lambda s: s[0].label))
    calls = data.draw(chunkings(found, most_calls))
    cluster = data.draw(st.sampled_from([Fraction(1), Fraction(1, 7), Fraction(60)]))
    patience = data.draw(st.sampled_from([0, Fraction(1, 3), 1, 1000]))
    stream = io.BytesIO()
    with Recorder(
        stream, [s[0] for s in found], cluster=cluster, patience=patience, canonical=5
    ) as recorder:
        for place, at, stop in calls:
            given_, values, known = found[place]
            if given_.takes_counts:
                for span in spans_of(known[at:stop], at):
                    recorder.write(place, values[span.start : span.stop], span.start)
            else:
                recorder.write(place, np.where(known, values, np.nan)[at:stop], at)
            if data.draw(st.integers(0, 200)) == 0:
                recorder.flush()
    status = recorder.status()
    assert status.written == sum(int(s[2].sum()) for s in found)
    assert status.taken == status.written + status.missing
    assert not status.dropped and status.file_size == len(stream.getvalue())
    assert hapfmt.verify(stream.getvalue()).verdict == "intact"
    back = hapfmt.read(stream.getvalue())
    for channel, source in zip(back.channels, found, strict=True):
        same_channel(channel, source)


@given(st.integers(1, 300), st.integers(1, 5), st.integers(0, 2**32), st.booleans())
def test_rows_are_the_channels_one_by_one(size, width, seed, floats):
    rng = np.random.default_rng(seed)
    counts = rng.integers(-900, 900, (size, width))
    values = counts / 7 if floats else counts
    inputs = [
        Input(f"{i}", 100, "N") if floats else counts_input(f"{i}", 100) for i in range(width)
    ]
    stream = io.BytesIO()
    with Recorder(stream, inputs, canonical=1) as recorder:
        at = 0
        while at < size:
            stop = min(size, at + int(rng.integers(1, 50)))
            if rng.integers(2):
                recorder.write_rows(values[at:stop])
            else:
                recorder.write_all({i: values[at:stop, i] for i in range(width)})
            at = stop
    for place, channel in enumerate(hapfmt.read(stream.getvalue()).channels):
        own = channel.samples() if floats else channel.stored
        assert (own == values[:, place]).all() and channel.coverage == (Span(0, size),)


def test_the_same_calls_give_the_same_bytes():
    files = []
    for _ in range(2):
        stream = io.BytesIO()
        with Recorder(stream, [counts_input(), Input("x", 50)], canonical=9) as recorder:
            for at in range(0, 5000, 10):
                recorder.write("force", np.arange(at, at + 10))
                recorder.write("x", [at / 3] if at % 20 == 0 else [])
        files.append(stream.getvalue())
    assert files[0] == files[1]


def test_a_recording_written_whole_and_one_written_live_are_equal(tmp_path):
    counts = np.cumsum(np.random.default_rng(3).integers(-4, 5, 30_000))
    whole = Channel(counts, Fraction(1000), calibration=CALIBRATION, label="force", unit="N")
    hapfmt.write(Recording((whole,)), tmp_path / "whole.hapf", Settings.of("lossless"))
    with Recorder(tmp_path / "live.hapf", [counts_input()]) as recorder:
        for at in range(0, 30_000, 17):
            recorder.write("force", counts[at : at + 17])
    a, b = (hapfmt.read(tmp_path / name).channels[0] for name in ("whole.hapf", "live.hapf"))
    assert (a.stored == b.stored).all() and a.coverage == b.coverage
    assert a.calibration == b.calibration
    assert (tmp_path / "live.hapf").stat().st_size < 1.2 * (tmp_path / "whole.hapf").stat().st_size


def test_ticks_never_go_back(tmp_path):
    with Recorder(tmp_path / "a.hapf", [counts_input(), counts_input("b")]) as recorder:
        recorder.write("force", [1, 2, 3], tick=10)
        with pytest.raises(ParameterError, match=r"'force' for tick 12 .* tick 13"):
            recorder.write("force", [4], tick=12)
        with pytest.raises(ParameterError, match="from 0 to 13: give the tick"):
            recorder.write_rows([[1, 2]])
        recorder.write_rows([[5, 6]], tick=13)
        recorder.skip("force", 6)
        recorder.write("force", [7])
        with pytest.raises(ParameterError, match="a gap of -1 ticks"):
            recorder.skip("force", -1)
        with pytest.raises(ParameterError, match="below 2\\^48"):
            recorder.write("b", [1], tick=1 << 48)
    force, other = hapfmt.read(tmp_path / "a.hapf").channels
    assert force.coverage == (Span(10, 14), Span(20, 21)) and force.stored.tolist() == [
        1,
        2,
        3,
        5,
        7,
    ]
    assert other.coverage == (Span(13, 14),)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([1.5], "integer counts, not float64"),
        ([1 << 23], "from 8388608 to 8388608 need more than its 24 bits"),
        ([-(1 << 23) - 1], "24 bits"),
        ([[1, 2]], "one-dimensional"),
        (["a"], "integer counts"),
    ],
)
def test_what_does_not_fit_an_input_is_refused_and_nothing_is_taken(values, message):
    stream = io.BytesIO()
    with Recorder(stream, [counts_input()], canonical=1) as recorder:
        with pytest.raises(ParameterError, match=message):
            recorder.write("force", values)
        recorder.write("force", [(1 << 23) - 1, -(1 << 23)])
    assert hapfmt.read(stream.getvalue()).channels[0].stored.tolist() == [8388607, -8388608]


def test_refusals():
    two = [counts_input(), Input("x", 10)]
    for given_, message in [
        ({"on_full": "wait"}, "on_full"),
        ({"cluster": 0}, "length must be positive"),
        ({"fsync": "often"}, "fsync"),
        ({"canonical": -1}, "file id"),
        ({"canonical": 1, "hold": 3}, "cannot use the time of day"),
        ({"at": 3}, "requires append"),
        ({"append": True, "force": True}, "not both"),
        ({"append": True}, "cannot be appended"),
        ({"queue_size": 0}, "1 byte"),
        ({"settings": Settings.of("lossless", digest=True)}, "whole tracks"),
        ({"settings": Settings.of("perceptual")}, "needs the whole recording"),
        ({"epoch_ns": 1 << 70}, "epoch"),
        ({"metadata": {"a": float("nan")}}, "JSON"),
    ]:
        with pytest.raises(ParameterError, match=message):
            Recorder(io.BytesIO(), two, **given_)
    with Recorder(io.BytesIO(), two, canonical=1) as recorder:
        for call, message in [
            (lambda: recorder.write("y", [1]), "no channel 'y'; there are: 'force', 'x'"),
            (lambda: recorder.write(2, [1]), "no channel 2"),
            (lambda: recorder.write_rows([[1, 2]]), "write them separately"),
            (lambda: recorder.write_rows([[1, 2]], channels=[0, 0]), "each once"),
            (lambda: recorder.add(counts_input("wide", bits=25)), "needs level 2"),
            (lambda: recorder.write("x", [1 + 2j]), "are floats"),
        ]:
            with pytest.raises(ParameterError, match=message):
                call()
    with pytest.raises(ParameterError, match="was closed"):
        recorder.write("force", [1])
    recorder.close()


def test_a_channel_may_come_late_and_one_may_never_speak(tmp_path):
    path = tmp_path / "late.hapf"
    with Recorder(path, [counts_input(), Input("silent", 10)]) as recorder:
        recorder.write("force", np.arange(2500))
        assert recorder.add(Input("late", 8, "m")) == 2
        assert recorder.add(counts_input("early", 100)) == 3
        recorder.write("late", [0.5, 0.25])
        recorder.write("early", [1, 2], tick=5)
        recorder.write("force", np.arange(2500))
    assert hapfmt.verify(path).verdict == "intact"
    back = hapfmt.read(path)
    assert [c.label for c in back.channels] == ["force", "silent", "late", "early"]
    assert back.channels[1].coverage == () and back.channels[2].coverage == (Span(20, 22),)
    assert back.channels[3].coverage == (Span(5, 7),)


def chunk_count(path, type_="DATA") -> int:
    with hapfmt.Reader(path, scan=True) as reader:
        return sum(chunk.type == type_ for chunk in reader.catalogue.chunks)


def wait_for(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_stalled_channel_does_not_hold_up_the_others(tmp_path):
    path = tmp_path / "stall.hapf"
    inputs = [counts_input("a", 100), counts_input("b", 100)]
    with Recorder(path, inputs, hold=1000) as recorder:
        recorder.write_rows(np.zeros((50, 2), np.int32))
        recorder.write("a", np.ones(250, np.int32))
        wait_for(lambda: recorder.status().cluster_count >= 3)
        recorder.write("a", np.ones(700, np.int32))
        wait_for(lambda: recorder.status().cluster_count >= 10)
        recorder.write("b", np.full(900, 7, np.int32))
        recorder.write_rows(np.full((50, 2), 9, np.int32), tick=1000)
    a, b = hapfmt.read(path).channels
    assert a.coverage == (Span(0, 1050),) and b.coverage == (Span(0, 950), Span(1000, 1050))
    assert b.stored.tolist() == [0] * 50 + [7] * 900 + [9] * 50
    assert hapfmt.verify(path).verdict == "intact"


def test_channels_written_one_after_the_other_share_clusters_with_write_all(tmp_path):
    path = tmp_path / "all.hapf"
    inputs = [counts_input("a", 100), counts_input("b", 1000)]
    with Recorder(path, inputs) as recorder:
        recorder.write_all({"a": np.arange(1000), "b": np.arange(10_000)})
    assert chunk_count(path) == 10


def test_nothing_waits_longer_than_hold(tmp_path):
    path = tmp_path / "hold.hapf"
    with Recorder(path, [counts_input()], hold=0.2) as recorder:
        recorder.write("force", [1, 2, 3])
        wait_for(lambda: recorder.status().written == 3)
        with hapfmt.Reader(path) as reader:
            assert reader.read().channels[0].stored.tolist() == [1, 2, 3]


def test_flush_makes_all_durable(tmp_path, monkeypatch):
    path = tmp_path / "flush.hapf"
    synced = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda fd: (synced.append(fd), fsync(fd))[1])
    with Recorder(path, [counts_input()], fsync="close") as recorder:
        recorder.write("force", np.arange(5500))
        recorder.mark("here")
        before = len(synced)
        recorder.flush()
        assert len(synced) == before + 1
        with hapfmt.Reader(path) as reader:
            assert reader.read().channels[0].stored.size == 5500
            assert [finding.code for finding in reader.findings] == ["not-closed"]
        assert recorder.status().flushed_s >= 5.5


class Slow(io.BytesIO):
    """A stream that waits until it may write."""

    def __init__(self) -> None:
        super().__init__()
        self.free = threading.Event()
        self.free.set()

    def write(self, data) -> int:
        self.free.wait()
        return super().write(data)


def test_a_full_queue_drops_only_what_it_counts():
    stream = Slow()
    recorder = Recorder(stream, [counts_input()], on_full="drop", queue_size=20_000, epoch_ns=None)
    recorder.flush()
    stream.free.clear()
    values = np.arange(400, dtype=np.int32)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(100):
            recorder.write("force", values)
    status = recorder.status()
    assert len(caught) == 1 and "were dropped" in str(caught[0].message)
    assert 0 < status.dropped["force"] < 40_000 and status.dropped_count % 400 == 0
    assert status.taken + status.dropped_count == 40_000 and status.queued_size <= 50_000
    stream.free.set()
    recorder.close()
    back = hapfmt.read(stream.getvalue())
    channel = back.channels[0]
    assert channel.stored.size == status.taken and channel.stored.size < 40_000
    ticks = np.concatenate([np.arange(s.start, s.stop) for s in channel.coverage])
    assert (channel.stored == ticks % 400).all()
    assert back.metadata["notes"] == [
        f"dropped: {status.dropped_count} samples of 'force', for which the encoder was too slow"
    ]


def test_notes_of_what_was_dropped_stay_few_however_many_channels():
    stream = Slow()
    inputs = [counts_input(f"{n:050}") for n in range(2000)]
    recorder = Recorder(stream, inputs, on_full="drop", queue_size=100_000, epoch_ns=None)
    recorder.flush()
    stream.free.clear()
    with warnings.catch_warnings(record=True):
        warnings.simplefilter("always")
        for _ in range(20):
            recorder.write_rows(np.ones((50, 2000), np.int64))
    status = recorder.status()
    stream.free.set()
    recorder.close()
    notes = hapfmt.read(stream.getvalue()).metadata["notes"]
    assert len(status.dropped) == 2000 and len(notes) == 101
    assert (
        notes[-1] == f"dropped: {status.dropped_count * 1900 // 2000} samples of 1900 more channels"
    )


def test_a_full_queue_raises_where_asked_and_the_samples_can_come_again():
    stream = Slow()
    recorder = Recorder(stream, [counts_input()], on_full="raise", queue_size=20_000, epoch_ns=None)
    recorder.flush()
    stream.free.clear()
    with pytest.raises(LimitError, match=r"400 samples of 'force' at tick .* were not taken"):
        for _ in range(100):
            recorder.write("force", np.arange(400))
    taken = recorder.status().taken
    stream.free.set()
    recorder.flush()
    recorder.write("force", np.arange(400))
    recorder.close()
    assert hapfmt.read(stream.getvalue()).channels[0].coverage == (Span(0, taken + 400),)


@pytest.mark.realtime
def test_a_full_queue_blocks_and_the_time_is_counted():
    stream = Slow()
    recorder = Recorder(stream, [counts_input()], queue_size=20_000, epoch_ns=None)
    recorder.flush()
    stream.free.clear()
    threading.Timer(0.3, stream.free.set).start()
    recorder.write("force", np.arange(200_000))
    recorder.close()
    assert recorder.status().blocked_s > 0.1 and not recorder.status().dropped
    assert hapfmt.read(stream.getvalue()).channels[0].stored.size == 200_000


class Broken(io.BytesIO):
    """A disk that is full after so many bytes."""

    room = 1500

    def write(self, data) -> int:
        if self.tell() + len(data) > self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


def test_what_the_thread_fails_with_comes_out_of_calls_and_of_close():
    recorder = Recorder(Broken(), [counts_input()], epoch_ns=None)
    noise = np.random.default_rng(0).integers(-1000, 1000, 20_000)
    with pytest.raises(OSError, match="No space left"):
        for at in range(0, 20_000, 1000):
            recorder.write("force", noise[at : at + 1000])
            recorder.flush()
    with pytest.raises(OSError, match="No space left"):
        recorder.close()
    recorder.close()
    with pytest.raises(ParameterError, match="was closed"):
        recorder.flush()


def test_a_full_disk_leaves_a_valid_file(tmp_path, monkeypatch):
    path = tmp_path / "full.hapf"
    pwrite = os.pwrite

    def limited(fd, data, position):
        if position + len(data) > 30_000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return pwrite(fd, data, position)

    noise = np.random.default_rng(0).integers(-1000, 1000, 50_000)
    with (
        pytest.raises(OSError, match="No space left") as caught,
        Recorder(path, [counts_input(), Input("silent", 10)]) as recorder,
    ):
        monkeypatch.setattr(os, "pwrite", limited)
        for at in range(0, 50_000, 100):
            recorder.write("force", noise[at : at + 100])
        recorder.flush()
    assert caught.value.filename == str(path)
    monkeypatch.undo()
    with hapfmt.Reader(path, scan=True) as reader:
        assert {finding.code for finding in reader.findings} <= {"not-closed"}
        values = reader.read().channels[0].stored
    assert values.size >= 10_000 and (values == noise[: values.size]).all()
    with Recorder(path, [counts_input()], append=True) as recorder:
        recorder.write("force", [5])
    assert hapfmt.verify(path).verdict == "intact"


def test_an_error_in_the_block_still_closes_the_file(tmp_path):
    path = tmp_path / "error.hapf"
    with pytest.raises(ZeroDivisionError), Recorder(path, [counts_input()]) as recorder:
        recorder.write("force", [1, 2])
        1 / 0  # noqa: B018
    assert hapfmt.verify(path).verdict == "intact"
    assert hapfmt.read(path).channels[0].stored.tolist() == [1, 2]


def test_what_the_encoder_refuses_leaves_a_valid_file(tmp_path):
    path = tmp_path / "refused.hapf"
    recorder = Recorder(path, [Input("x", 10, lsb=1e-3), Input("silent", 10)], hold=1000)
    recorder.write("x", np.zeros(25))
    recorder.flush()
    with pytest.raises(ParameterError, match=r"1e\+30 of 'x' is outside the 24 bits"):
        recorder.write("x", np.full(20, 1e30))

    def refuse(_: object) -> None:
        raise ParameterError("no")

    recorder.worker.encoder.encode = refuse
    recorder.write("x", np.zeros(20))
    with pytest.raises(ParameterError):
        recorder.flush()
    with pytest.raises(ParameterError):
        recorder.close()
    assert hapfmt.verify(path).verdict == "intact"
    assert hapfmt.read(path).channels[0].stored.size >= 25


CHILD = """
import os, sys
from hapfmt import Input, Recorder
recorder = Recorder(sys.argv[1], [Input("x", 10)], **eval(sys.argv[3]))
recorder.write("x", [1.0, 2.0, 3.0])
{}
"""


def run_child(path, body: str, options: str = "{}") -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", CHILD.format(body), str(path), "", options],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


def test_the_end_of_the_program_closes_the_file(tmp_path):
    done = run_child(tmp_path / "end.hapf", "")
    assert (done.returncode, done.stderr) == (0, "")
    assert hapfmt.verify(tmp_path / "end.hapf").verdict == "intact"
    assert hapfmt.read(tmp_path / "end.hapf").channels[0].stored.size == 3


def test_a_recorder_that_nobody_holds_is_closed(tmp_path):
    recorder = Recorder(tmp_path / "gone.hapf", [counts_input()])
    recorder.write("force", [1, 2, 3])
    del recorder
    assert hapfmt.verify(tmp_path / "gone.hapf").verdict == "intact"


def test_a_program_that_stops_at_once_leaves_what_was_flushed(tmp_path):
    run_child(tmp_path / "exit.hapf", "recorder.flush(); os._exit(1)")
    with hapfmt.Reader(tmp_path / "exit.hapf") as reader:
        assert reader.read().channels[0].stored.size == 3
        assert [finding.code for finding in reader.findings] == ["not-closed"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_leaves_the_recording_to_its_process(tmp_path):
    body = """
pid = os.fork()
if not pid:
    try:
        recorder.write("x", [9.0])
    except Exception as error:
        print(error)
    recorder.close()
    sys.exit(0)
os.waitpid(pid, 0)
recorder.write("x", [4.0])
recorder.close()
"""
    done = run_child(tmp_path / "fork.hapf", body)
    assert done.stdout == "the recording belongs to the process that began it\n", done.stderr
    assert hapfmt.verify(tmp_path / "fork.hapf").verdict == "intact"
    assert hapfmt.read(tmp_path / "fork.hapf").channels[0].stored.tolist() == [1, 2, 3, 4]


def test_two_recorders_on_one_file_are_refused(tmp_path):
    path = tmp_path / "locked.hapf"
    with Recorder(path, [counts_input()]) as recorder:
        recorder.flush()
        with pytest.raises(ParameterError, match="Another program is writing"):
            Recorder(path, [counts_input()], append=True)
        with pytest.raises(ParameterError):
            Recorder(path, [counts_input()], force=True)
        recorder.write("force", [1])
    with pytest.raises(ParameterError, match="already exists"):
        Recorder(path, [counts_input()])
    assert hapfmt.read(path).channels[0].stored.tolist() == [1]


def test_several_threads_may_write(tmp_path):
    inputs = [counts_input(f"{n}", 1000) for n in range(4)]
    with Recorder(tmp_path / "threads.hapf", inputs) as recorder:

        def run(place: int) -> None:
            for at in range(0, 5000, 50):
                recorder.write(place, np.arange(at, at + 50) * (place + 1))

        threads = [threading.Thread(target=run, args=(n,)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    for place, channel in enumerate(hapfmt.read(tmp_path / "threads.hapf").channels):
        assert (channel.stored == np.arange(5000) * (place + 1)).all()


@pytest.mark.parametrize("end", ["closed", "open", "torn"])
def test_append(tmp_path, end):
    path = tmp_path / "append.hapf"
    inputs = [counts_input(), Input("x", 10, "m"), Input("x", 10, "N")]
    recorder = Recorder(path, inputs, metadata={"who": "me"}, epoch_ns=10**18)
    recorder.write("force", np.arange(2500))
    recorder.write(1, [0.5, 0.25])
    recorder.flush()
    data = path.read_bytes()
    recorder.close()
    if end != "closed":
        path.write_bytes(data + (b"" if end == "open" else data[-90:-40]))
    again = [Input("x", 10, "m"), counts_input("new"), counts_input()]
    torn = pytest.warns(DataWarning, match="50 bytes at .* were cut off, no whole chunk")
    with torn if end == "torn" else nullcontext():
        recorder = Recorder(path, again, append=True, at=Fraction(3))
    with recorder:
        recorder.write("x", [1.0])
        recorder.write("force", [7, 8])
        recorder.write("new", [9])
        recorder.write("force", [10], tick=3500)
    assert hapfmt.verify(path).verdict == "intact"
    back = hapfmt.read(path)
    found = [(c.label, c.unit, c.coverage) for c in back.channels]
    expected = [
        ("force", "N", (Span(0, 2500), Span(3000, 3002), Span(3500, 3501))),
        ("x", "m", (Span(0, 2), Span(30, 31))),
        ("x", "N", ()),
        ("new", "N", (Span(3000, 3001),)),
    ]
    if end != "closed":
        # The silent channel had no track yet.
        expected = [*expected[:2], expected[3]]
    assert found == expected
    assert back.channels[1].samples().tolist() == [0.5, 0.25, 1.0]
    assert back.metadata["who"] == "me" and back.epoch_ns == 10**18
    assert back.metadata["notes"][-1].startswith("appended from 3 s on by hapfmt")
    with pytest.raises(ParameterError, match=r"ends at 3.501 s: nothing is appended at 2 s"):
        Recorder(path, again, append=True, at=2)


def test_append_to_a_damaged_file_is_refused_or_goes_to_the_end(tmp_path):
    """Whatever byte is wrong: no sample is appended before the end of the recording."""
    path = tmp_path / "damaged.hapf"
    with Recorder(path, [counts_input()], canonical=5) as recorder:
        recorder.write("force", np.arange(2500) % 50)
    whole, refused = path.read_bytes(), 0
    for at in range(0, len(whole), 5):
        damaged = bytearray(whole)
        damaged[at] ^= 16
        path.write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)
            try:
                with Recorder(path, [counts_input()], append=True) as recorder:
                    assert recorder.lanes.start_s == Fraction(5, 2)
            except HapfmtError as error:
                assert error.path == str(path) and path.read_bytes() == damaged
                refused += "damaged before its end" in str(error)
    assert refused > len(whole) // 20


def test_append_tells_what_a_cut_end_has_lost(tmp_path):
    path = tmp_path / "cut.hapf"
    with Recorder(path, [counts_input(), counts_input("x")]) as recorder:
        for label in ("force", "x"):
            recorder.write(label, np.random.default_rng(1).integers(0, 99, 1000))
    with hapfmt.Reader(path, scan=True) as reader:
        (cluster,) = reader.catalogue.data
    path.write_bytes(path.read_bytes()[: cluster.offset + cluster.size])
    told = "lost: x from 0 s to 1 s. If another copy of the file is whole, append to that one"
    with (
        pytest.warns(DataWarning, match=told),
        Recorder(path, [counts_input("x")], append=True) as recorder,
    ):
        recorder.write("x", [1])
    assert "lost: x from 0 s to 1 s" in hapfmt.read(path).metadata["notes"][0]


def test_append_with_a_label_of_another_rate_or_unit_is_refused(tmp_path):
    path = tmp_path / "labels.hapf"
    with Recorder(path, [Input("x", 10, "m"), Input("x", 10, "N")]) as recorder:
        recorder.write_rows([[1.0, 2.0]])
    before = path.read_bytes()
    for other, told in (
        (Input("x", 20, "N"), r"'x' is 10 Hz in m and 10 Hz in N in the file, not 20 Hz in N: "),
        (Input("x", 10), "not 10 Hz in no unit: give it that rate and unit, or another label"),
    ):
        with pytest.raises(ParameterError, match=told) as caught:
            Recorder(path, [other], append=True)
        assert caught.value.path == str(path) and path.read_bytes() == before


def test_append_at_the_end_and_at_the_wall_clock(tmp_path):
    path = tmp_path / "now.hapf"
    began = time.time_ns()
    with Recorder(path, [counts_input()], epoch_ns=began - 60 * 10**9) as recorder:
        recorder.write("force", np.arange(1500))
    with Recorder(path, [counts_input()], append=True) as recorder:
        recorder.write("force", [1])
    with Recorder(path, [counts_input()], append=True, at="now") as recorder:
        recorder.write("force", [2])
    a, b = hapfmt.read(path).channels[0].coverage
    assert a == Span(0, 1501) and 60_000 <= b.start < 120_000
    with Recorder(tmp_path / "none.hapf", [counts_input()], epoch_ns=None) as recorder:
        recorder.write("force", [1])
    with pytest.raises(ParameterError, match="no epoch"):
        Recorder(tmp_path / "none.hapf", [counts_input()], append=True, at="now")


def test_metadata_that_changes_is_written_at_the_end(tmp_path):
    path = tmp_path / "meta.hapf"
    before = {"a": 1, "encoder": "of the recording before", "notes": ["mine"]}
    with Recorder(path, [counts_input()], metadata=before) as recorder:
        with hapfmt.Reader(path) as reader:
            assert reader.metadata["a"] == 1
        recorder.metadata["b"] = [2]
    assert hapfmt.read(path).metadata == {
        "a": 1, "b": [2], "notes": ["mine"], "encoder": f"hapfmt {hapfmt.__version__}: lossless --cluster 1"
    }  # fmt: skip
    assert chunk_count(path, "mETa") == 2


@pytest.mark.parametrize(
    "chosen",
    [
        Settings.of("perceptual", texture=False),
        Settings.of("near-lossless", max_error="0.01"),
        Settings.of("near-lossless"),
    ],
)
def test_floats_of_lossy_presets_keep_a_bound_of_the_whole_recording(tmp_path, chosen):
    """In a file, in two parts, and as small as if the whole had been known."""
    g, t = np.random.default_rng(1), np.arange(5000) / 1000
    x = 2 * np.sin(5 * t) + g.normal(0, 0.002, t.size)
    x[3000] = np.inf
    with (
        pytest.warns(DataWarning, match="1000 samples of 'f' are kept bit for bit"),
        Recorder(tmp_path / "a.hapf", [Input("f", 1000, "N")], chosen) as recorder,
    ):
        recorder.write("f", x[:4000])
    with Recorder(tmp_path / "a.hapf", [Input("f", 1000, "N")], chosen, append=True) as recorder:
        recorder.write("f", x[4000:])
    assert hapfmt.verify(tmp_path / "a.hapf").verdict == "intact"
    y = hapfmt.read(tmp_path / "a.hapf").channels[0].samples()
    floor = chosen.max_error.absolute(4.01, None) if chosen.preset == "near-lossless" else 0.01
    k = float(chosen.k) if chosen.preset == "perceptual" else 0
    same = x == y
    assert (np.abs(x[~same] - y[~same]) <= np.maximum(k * np.abs(x[~same]), floor)).all()
    assert y[3000] == np.inf and 1000 <= np.count_nonzero(same) < 1100
    assert (tmp_path / "a.hapf").stat().st_size < 5000 + 8 * 1000


@pytest.mark.parametrize(
    "chosen",
    [
        Settings.of("lossless", fast=True),
        Settings.of("perceptual", texture=False),
        Settings.of("perceptual", texture=False, felt="all", floor="0.02"),
        Settings.of("near-lossless", max_error="2lsb"),
    ],
)
def test_presets(tmp_path, chosen):
    walk = np.cumsum(np.random.default_rng(1).integers(-5, 6, 5000))
    with Recorder(tmp_path / "a.hapf", [counts_input()], chosen) as recorder:
        recorder.write("force", walk)
    assert hapfmt.verify(tmp_path / "a.hapf").verdict == "intact"
    found = hapfmt.read(tmp_path / "a.hapf").channels[0].stored
    allowed = {"near-lossless": 2, "lossless": 0}.get(chosen.preset)
    if allowed is not None:
        assert np.abs(found - walk).max() <= allowed


def test_memory_stays_that_of_a_few_clusters(tmp_path):
    """Of 26 channels that stall, gap and go on; what grows is the index, 1 KiB in ten clusters."""
    import tracemalloc

    inputs = [counts_input(f"{n}", 100) for n in range(26)]
    rows = np.zeros((100, 26), np.int32)
    with Recorder(tmp_path / "long.hapf", inputs, fsync="never") as recorder:
        peaks = []
        for _ in range(3):
            tracemalloc.start()
            for _ in range(50):
                recorder.write_rows(rows)
            recorder.flush()
            peaks.append(tracemalloc.get_traced_memory())
            tracemalloc.stop()
    assert all(kept < 200_000 for kept, _ in peaks[1:])


@given(st.fractions(Fraction(1, 50), 50), st.sampled_from(RATES), st.integers(0, 10**6))
@settings(max_examples=examples(200))
def test_grid(cluster, rate, tick):
    grid = ClusterGrid.of(cluster, rate)
    number = grid.number(tick)
    assert number * cluster <= tick / rate < (number + 1) * cluster
    assert grid.start(number) <= tick < grid.start(number + 1)
    assert SampleRows((0,), tick, np.zeros((3, 1))).stop == tick + 3


def test_events(tmp_path):
    """In the cluster of their time, by layer, of channels of any number; appended ones too."""
    path = tmp_path / "events.hapf"
    inputs = [counts_input("a"), counts_input("b")]
    with Recorder(path, inputs) as recorder:
        recorder.write_rows(np.zeros((1500, 2), np.int32))
        recorder.mark("now")
        recorder.mark("later", time=2.25, duration="0.5", channel="b", layer="notes")
        recorder.mark("early", time=0, channel=0)
        for text in ("a\0b", "x" * 70_000, 7):
            with pytest.raises(ParameterError):
                recorder.mark(text)
        with pytest.raises(ParameterError):
            recorder.mark("no", time=-1)
        with pytest.raises(ParameterError, match="no channel 'c'"):
            recorder.mark("no", channel="c")
        recorder.write_rows(np.zeros((1000, 2), np.int32))
    with hapfmt.Reader(path) as reader:
        assert reader.duration == Fraction(11, 4) or reader.duration >= Fraction(5, 2)
    with Recorder(path, [counts_input("b")], append=True) as recorder:
        recorder.write("b", [1])
        recorder.mark("again", layer="notes")
        recorder.mark("new", layer="third")
    assert hapfmt.verify(path).verdict == "intact"
    back = hapfmt.read(path)
    assert back.channels[1].coverage == (Span(0, 2501),)
    found = [(e.layer, e.text, e.time, e.duration, e.channel) for e in back.events]
    assert sorted(found, key=str) == sorted(
        [
            ("", "early", 0, 0, 0),
            ("", "now", Fraction(3, 2), 0, None),
            ("notes", "later", Fraction(9, 4), Fraction(1, 2), 1),
            ("notes", "again", Fraction(2501, 1000), 0, None),
            ("third", "new", Fraction(2501, 1000), 0, None),
        ],
        key=str,
    )


def test_events_without_samples(tmp_path):
    path = tmp_path / "marks.hapf"
    with Recorder(path, [counts_input()]) as recorder:
        for number in range(5000):
            recorder.mark(f"mark {number}", time=number)
        recorder.flush()
    assert hapfmt.verify(path).verdict == "intact"
    assert len(hapfmt.read(path).events) == 5000


def test_clock_observations_are_stored_raw_and_maps_only_when_asked(tmp_path):
    path = tmp_path / "clocks.hapf"
    inputs = [counts_input("a"), Input("x", 10, "m")]

    def observe(recorder, first: int, last: int) -> None:
        for second in range(first, last):
            recorder.write("a", np.zeros(1000, np.int32))
            recorder.clock("camera", "a", 1000 * second, 5 * 10**9 + second * 1_000_040_000, 100)
            recorder.clock("gps", None, second * 10**9, 10**18 + second * 10**9)
            recorder.clock("late", "x", 10 * second, 10**9 * second)

    with Recorder(path, inputs) as recorder:
        observe(recorder, 0, 20)
        for wrong in [
            ("", "a", 0, 0),
            ("c", "b", 0, 0),
            ("c", "a", 1 << 60, 0),
            ("c", "a", 0.5, 0),
        ]:
            with pytest.raises(ParameterError):
                recorder.clock(*wrong)
    assert hapfmt.verify(path).verdict == "intact"
    with hapfmt.Reader(path) as reader:
        assert len(reader.clocks) == 60 and reader.clock_maps == []
        seen = [o for o in reader.clocks if o.clock == "camera"]
        assert seen[3].time_ns == 5 * 10**9 + 3 * 1_000_040_000 and seen[3].uncertainty_ns == 100
        assert reader.channels[seen[3].channel].label == "a"
        assert {o.channel for o in reader.clocks if o.clock == "gps"} == {None}
    with (
        pytest.warns(DataWarning, match="no map of clock 'once'"),
        Recorder(path, inputs, append=True, clock_maps=True) as recorder,
    ):
        observe(recorder, 20, 40)
        recorder.clock("once", "a", 40_000, 5)
    assert hapfmt.verify(path).verdict == "intact"
    with hapfmt.Reader(path) as reader:
        assert len(reader.clocks) == 121
        maps = {found.clock: found for found in reader.clock_maps}
        assert set(maps) == {"camera", "gps", "late"}
        for second in (0, 7, 39):
            exact = 5 * 10**9 + second * 1_000_040_000
            assert abs(maps["camera"].time_ns(1000 * second) - exact) <= 1
        assert any("no map of clock 'once'" in note for note in reader.metadata["notes"])


def test_maps_may_be_asked_for_later(tmp_path):
    with Recorder(tmp_path / "a.hapf", [counts_input()]) as recorder:
        recorder.clock("c", "force", 0, 0)
        recorder.write("force", np.zeros(2000, np.int32))
        recorder.flush()
        recorder.fit_clocks()
        recorder.clock("c", "force", 1000, 10**9)
    with hapfmt.Reader(tmp_path / "a.hapf") as reader:
        assert reader.clock_maps[0].time_ns(500) == 5 * 10**8


@pytest.mark.parametrize("again", [["x", "force"], ["force"], ["other", "third"]])
def test_append_where_a_crash_left_no_description_of_a_channel(tmp_path, again):
    path = tmp_path / "hole.hapf"
    recorder = Recorder(path, [Input("x", 10), counts_input(), Input("y", 10)])
    recorder.write("force", [1, 2])
    recorder.flush()
    data = path.read_bytes()
    recorder.close()
    path.write_bytes(data)
    inputs = [counts_input() if label == "force" else Input(label, 10) for label in again]
    with Recorder(path, inputs, append=True) as recorder:
        recorder.write(0, [1])
    assert hapfmt.verify(path).verdict == "intact"
    labels = [channel.label for channel in hapfmt.read(path).channels]
    assert (
        labels
        == {
            "x": ["x", "force"],
            "force": ["(never recorded)", "force"],
            "other": ["other", "force", "third"],
        }[again[0]]
    )


def test_events_and_observations_alone_wait_no_longer_than_hold(tmp_path):
    path = tmp_path / "alone.hapf"
    with Recorder(path, [counts_input()], hold=0.2) as recorder:
        recorder.mark("first", time=100)
        recorder.clock("c", None, 5, 6)

        def seen() -> bool:
            with hapfmt.Reader(path) as reader:
                return len(reader.read().events) == 1 and len(reader.clocks) == 1

        wait_for(seen)
    assert hapfmt.verify(path).verdict == "intact"


def test_a_clock_that_leaps_has_no_map_that_a_file_holds(tmp_path):
    """Set from 0 to the time of day: the observations stay, and a note says why there is no map."""
    with (
        pytest.warns(DataWarning, match="no map of clock 'pc'"),
        Recorder(tmp_path / "a.hapf", [counts_input()], clock_maps=True) as recorder,
    ):
        recorder.write("force", np.zeros(40_000, np.int32))
        for second in range(40):
            leap = 10**18 * (second >= 20)
            recorder.clock("pc", "force", 1000 * second, leap + second * 10**9)
    with hapfmt.Reader(tmp_path / "a.hapf") as reader:
        assert len(reader.clocks) == 40 and reader.clock_maps == []
        assert any("no map of clock 'pc'" in note for note in reader.metadata["notes"])


class TestBoundThatFlattens:
    """The range is known at the end, so the recorder tells then of a bound above 10 % of it."""

    @pytest.mark.parametrize("kind", ["counts", "floats"])
    def test_is_told_when_the_recorder_is_closed(self, kind):
        given = {"calibration": Calibration(1, 0, 1000)} if kind == "counts" else {"lsb": 0.001}
        x = np.rint(1000 * np.sin(np.arange(3000) / 30))
        x = x.astype(np.int32) if kind == "counts" else x / 1000
        for error, force, told in ((1, False, True), (0.1, False, False), (1, True, False)):
            settings = Settings.of("near-lossless", max_error=error, force_error=force)
            recorder = Recorder(io.BytesIO(), [Input("f", 1000, "N", **given)], settings)
            recorder.write("f", x)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                recorder.close()
            said = [str(one.message) for one in caught]
            assert bool(said) == told
            if told:
                assert said == [
                    "1 N is 50 % of the range of channel 'f', as is known now: next time give a "
                    "smaller max_error, or force_error=True"
                ]
