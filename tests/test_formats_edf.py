"""EDF and BDF: files of edfio are read exactly, ours are read by edfio, and both ways round."""

from __future__ import annotations

import datetime
import io
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from formats import damaged, facts, survives, written
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.convert import imported, read, save
from hapfmt.errors import LimitError, ParameterError
from hapfmt.recording import Calibration, Channel, Event, Recording, Span

BITS = {"edf": 16, "bdf": 24}
both = pytest.mark.parametrize("format", BITS)


def foreign(format: str, **options: Any) -> tuple[bytes, list[Any]]:
    """A file of edfio: two rates, three scales, annotations."""
    import edfio

    signal = edfio.EdfSignal if format == "edf" else edfio.BdfSignal
    file = edfio.Edf if format == "edf" else edfio.Bdf
    rng = np.random.default_rng(1)
    signals = [
        signal(rng.normal(size=3000), 1000, label="fx", physical_dimension="N"),
        signal(rng.normal(size=3000) * 1e-3, 1000, label="EMG", physical_dimension="uV"),
        signal(
            rng.normal(size=300),
            100,
            label="temp",
            physical_dimension="degC",
            transducer_type="PT100",
            physical_range=(-40, 60),
            prefiltering="LP:10Hz",
        ),
    ]
    notes = [edfio.EdfAnnotation(0.5, None, "touch"), edfio.EdfAnnotation(1, 0.25, "slip@@fx")]
    stream = io.BytesIO()
    known: dict[str, Any] = {
        "starttime": datetime.time(10, 11, 12, 250000),
        "recording": edfio.Recording(startdate=datetime.date(2026, 1, 2), equipment_code="rig"),
        "patient": edfio.Patient(code="P7"),
        "annotations": notes,
    }
    file(signals, **{**known, **options}).write(stream)
    return stream.getvalue(), signals


def foreign_reader(format: str) -> Callable[[bytes], Any]:
    import edfio

    return edfio.read_edf if format == "edf" else edfio.read_bdf


@both
class TestForeignFiles:
    def test_counts_scales_rates_units_and_times(self, format: str) -> None:
        data, signals = foreign(format)
        back = read(data)
        assert back.labels == ["fx", "EMG", "temp"]
        assert [c.unit for c in back] == ["N", "uV", "Cel"]
        assert [c.rate_exact for c in back] == [1000, 1000, 100]
        for channel, signal in zip(back, signals, strict=True):
            assert channel.counts.tolist() == signal.digital.tolist()
            assert channel.calibration is not None
            low, high = (Fraction(str(end)) for end in signal.physical_range)
            assert channel.calibration.exact(signal.digital_min) == low
            assert channel.calibration.exact(signal.digital_max) == high
            size = max(abs(low), abs(high))
            assert np.abs(channel.samples() - signal.data).max() <= 1e-15 * float(size) * 4
        assert back["temp"].device == "PT100"
        assert back.metadata["prefiltering"] == {"temp": "LP:10Hz"}
        assert back.metadata["source_units"] == {"temp": "degC"}
        assert back.metadata["patient"] == "P7 X X X"
        assert back.metadata["recording"] == "X X rig"
        assert back.metadata["notes"] == ["the start time names no time zone and is read as UTC"]
        moment = datetime.datetime(2026, 1, 2, 10, 11, 12, tzinfo=datetime.UTC)
        assert back.epoch_ns == int(moment.timestamp()) * 10**9 + 250_000_000
        assert back.events == (
            Event(Fraction(1, 2), "touch"),
            Event(Fraction(1), "slip", Fraction(1, 4), channel=0),
        )

    def test_a_file_that_hides_its_start(self, format: str) -> None:
        data, _ = foreign(format, starttime=None, recording=None, patient=None, annotations=None)
        back = read(data)
        assert back.epoch_ns is None
        assert back.metadata == {
            "prefiltering": {"temp": "LP:10Hz"},
            "source_units": {"temp": "degC"},
        }

    def test_a_hidden_date_keeps_the_time(self, format: str) -> None:
        import edfio

        kind = edfio.Edf if format == "edf" else edfio.Bdf
        signal = (edfio.EdfSignal if format == "edf" else edfio.BdfSignal)(np.arange(9.0), 9)
        stream = io.BytesIO()
        kind([signal], starttime=datetime.time(9, 30)).write(stream)
        back = read(stream.getvalue())
        assert back.epoch_ns is None and back.metadata["start_time"] == "09:30:00"
        assert back.metadata["notes"] == [
            "the file hides its date; metadata 'start_time' keeps the time of day, 09:30:00"
        ]
        again = io.BytesIO()
        assert not any("start_time" in note for note in save(back, again, format=format))
        again.seek(0)
        assert foreign_reader(format)(again).starttime == datetime.time(9, 30)
        assert read(again.getvalue()).metadata["start_time"] == "09:30:00"

    def test_a_file_that_is_cut_off(self, format: str) -> None:
        data, signals = foreign(format)
        back = read(data[:-7])
        whole = read(data)
        size = back["temp"].stored.size
        assert size == whole["temp"].stored.size - signals[2].samples_per_data_record
        assert np.array_equal(back["temp"].stored, whole["temp"].stored[:size])
        assert (
            "the file is cut off: of 3 records, the first 2 are read; the rest is lost"
            in (back.metadata["notes"])
        )

    def test_the_description_reads_no_values(self, format: str) -> None:
        data, _ = foreign(format, annotations=None, starttime=None)
        start = int(data[184:192])
        stream = io.BytesIO(data)
        with imported(stream) as (_, found):
            assert stream.tell() == start
            assert [(t.name, t.rate, t.row_count) for t in found.tables] == [
                ("2 signals", 1000, 3000),
                ("temp", 100, 300),
            ]

    def test_select(self, format: str) -> None:
        data, signals = foreign(format)
        back = read(data, select=["t*", "EMG"])
        assert back.labels == ["EMG", "temp"]
        assert back["temp"].counts.tolist() == signals[2].digital.tolist()
        assert [event.channel for event in back.events] == [None, None]
        with pytest.raises(ParameterError, match="no signal is called 'fy'; there are: 'fx'"):
            read(data, select="fy")
        with pytest.raises(ParameterError, match="several rates"):
            read(data, rate=500)
        assert read(data, select="temp", rate=50)["temp"].rate_exact == 50

    def test_damage(self, format: str) -> None:
        data, _ = foreign(format)
        assert not survives(data[:200], format)
        for each in damaged(data):
            survives(each, format)


def discontinuous(onsets: list[float], samples: int = 10) -> bytes:
    """EDF+D: edfio writes EDF+C, and the onsets are changed."""
    import edfio

    x = np.arange(samples * len(onsets), dtype=np.int16)
    signal = edfio.EdfSignal.from_digital(x, samples, label="fx")
    stream = io.BytesIO()
    wide = [edfio.EdfAnnotation(0, None, "wide" * 4)]
    edfio.Edf([signal], annotations=wide, data_record_duration=1).write(stream)
    data = bytearray(stream.getvalue().replace(b"EDF+C", b"EDF+D"))
    size = (len(data) - 768) // len(onsets)  # of a record; the header has two signals
    for number, onset in enumerate(onsets):
        at = 768 + number * size + 2 * samples
        mark = f"+{onset:.2f}\x14\x14\0".encode()
        room = size - 2 * samples
        assert len(mark) <= room
        data[at : at + room] = mark.ljust(room, b"\0")
    return bytes(data)


class TestGaps:
    def test_pauses_between_records(self) -> None:
        back = read(discontinuous([0, 1, 5, 6]))
        assert back["fx"].coverage == (Span(0, 20), Span(50, 70))
        assert back["fx"].counts.tolist() == list(range(40))

    def test_a_record_between_two_samples(self) -> None:
        back = read(discontinuous([0, 1, 5.04]))
        assert back["fx"].coverage == (Span(0, 20), Span(50, 60))
        assert "moved by up to half a sample" in back.metadata["notes"][0]

    def test_records_that_overlap(self) -> None:
        with pytest.raises(ParameterError, match="record 3 begins before record 2 ends"):
            read(discontinuous([0, 1, 1.5]))

    def test_records_far_apart(self) -> None:
        with pytest.raises(ParameterError, match="too far apart"):
            read(discontinuous([0, 1, 9e17]))

    def test_a_record_without_an_onset(self) -> None:
        data = discontinuous([0, 1, 5])
        with pytest.raises(ParameterError, match="record 3 has no onset"):
            read(data.replace(b"+5.00\x14\x14", bytes(7)))

    def test_the_ticks_are_bounded(self) -> None:
        with pytest.raises(LimitError, match="ticks of 40 rows"):
            read(discontinuous([0, 1, 5, 6]), max_memory=900)


def header(changes: dict[int, bytes] | None = None, tail: bytes = b"\1\0" * 6) -> bytes:
    """Plain EDF by hand: one signal of 2 samples in a record, 3 records."""
    head = bytearray(b" " * 512)
    fields = {
        0: b"0", 168: b"31.12.99", 176: b"23.59.59", 184: b"512", 236: b"3", 244: b"0.5", 252: b"1",
        256: b"fx", 256 + 96: b"\xb5V", 256 + 104: b"-1", 256 + 112: b"1", 256 + 120: b"-2",
        256 + 128: b"2", 256 + 216: b"2",
    }  # fmt: skip
    for at, text in {**fields, **(changes or {})}.items():
        head[at : at + 8] = text.ljust(8)
    return bytes(head) + tail


LEAST, MOST, LOW, HIGH = 256 + 120, 256 + 128, 256 + 104, 256 + 112
REFUSED = {
    "begins with other bytes": header()[8:],
    "truncated: 100 of 256 bytes": header()[:100],
    "truncated: the file ends within its header": header()[:300],
    "the number of signals is '0'": header({252: b"0"}),
    "the number of signals is ''": header({252: b""}),
    "the header has 512 bytes for 2 signals": header({252: b"2"}),
    "the duration of a record is 'x'": header({244: b"x"}),
    "the duration of a record is '1/0'": header({244: b"1/0"}),
    "the duration of a record is negative": header({244: b"-1"}),
    "the duration 0, so the signals have no rate": header({244: b"0"}),
    "truncated: the header counts 3 records, none is there": header(tail=b"\0"),
    "the number of records is '-2'": header({236: b"-2"}),
    "signal 'fx': the physical minimum is 'nan'": header({LOW: b"nan"}),
    "signal 'fx': the digital maximum is '1.5'": header({MOST: b"1.5"}),
    "number of samples in a record is '0'": header({256 + 216: b"0"}),
    r"says EDF\+D, and no signal has the onsets": header({192: b"EDF+D"}),
}


class TestPlainFiles:
    def test_scale_rate_unit_and_start(self) -> None:
        back = read(header())
        [fx] = back.channels
        assert (fx.rate_exact, fx.unit, fx.calibration) == (4, "uV", Calibration(1, 0, 2))
        assert fx.counts.tolist() == [1] * 6
        moment = datetime.datetime(1999, 12, 31, 23, 59, 59, tzinfo=datetime.UTC)
        assert back.epoch_ns == int(moment.timestamp()) * 10**9

    @pytest.mark.parametrize("message", REFUSED)
    def test_refused(self, message: str) -> None:
        with pytest.raises(ParameterError, match=message):
            read(REFUSED[message], format="edf")

    def test_a_long_record(self) -> None:
        """Streamed, a file of one record would be held whole."""
        data = header({236: b"1", 256 + 216: b"50000"}, bytes(100_000))
        assert read(data, max_memory=100_000)["fx"].counts.size == 50_000
        with pytest.raises(LimitError, match="a record takes 100000 bytes, more than the 99999"):
            read(data, max_memory=99_999)

    def test_unfinished(self) -> None:
        back = read(header({236: b"-1"}, b"\1\0" * 7))
        assert back["fx"].counts.tolist() == [1] * 6
        assert back.metadata["notes"][0].startswith("the header counts no records; the 3 whole")

    def test_more_than_the_header_counts(self) -> None:
        back = read(header(tail=b"\1\0" * 9))
        assert "the 6 bytes after the last record are not read" in back.metadata["notes"]

    def test_no_scale(self) -> None:
        back = read(header({MOST: b"-2"}))
        assert back["fx"].calibration == Calibration()
        assert "signal 'fx' has no scale and is read as counts" in back.metadata["notes"]

    def test_a_scale_beyond_exact_integers(self) -> None:
        back = read(header({LOW: b"1E-40", HIGH: b"12345678"}))
        assert back["fx"].samples().tolist() == [0.75 * 12345678] * 6
        assert "is rounded to float64" in back.metadata["notes"][0].replace("are", "is")

    def test_a_start_that_is_not_a_time(self) -> None:
        back = read(header({168: b"31.02.99"}))
        assert back.epoch_ns is None
        assert "the start '31.02.99', '23.59.59' is not a time" in back.metadata["notes"][0]


labels = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=16)
calibrations = st.builds(
    lambda a, zero, d: Calibration(a, a * zero, d),
    st.sampled_from([1, 2, 3, 10, -1, -9]),
    st.integers(-50, 50),
    st.sampled_from([1, 2, 8, 10, 1000, 3, 7]),
)
"""With a whole count for the physical 0, as sensors have it."""


@st.composite
def recordings(draw: st.DrawFn, bits: int) -> Recording:
    rates = st.sampled_from([Fraction(1000), Fraction(100), Fraction(44_100, 7), Fraction(1, 3)])
    room = 500_000 if bits == 24 else 28_000
    found = []
    for label in draw(st.lists(labels, min_size=1, max_size=3, unique=True)):
        spans, at = [], draw(st.integers(0, 5))
        for _ in range(draw(st.integers(1, 3))):
            size = draw(st.integers(1, 6))
            spans.append(Span(at, at + size))
            at += size + draw(st.integers(1, 30))
        count = sum(span.ticks for span in spans)
        x = draw(st.lists(st.integers(-room, room), min_size=count, max_size=count))
        found.append(
            Channel(
                np.array(x, np.int32), draw(rates), tuple(spans), draw(calibrations),
                label=label.replace("@@", "@"), unit=draw(st.sampled_from(["1", "N", "m/s2", "[g]"])),
            )
        )  # fmt: skip
    times = st.fractions(0, 3, max_denominator=1000).map(lambda t: Fraction(round(t * 1000), 1000))
    events = draw(st.lists(st.builds(Event, times, labels, times), max_size=3))
    epoch = draw(st.none() | st.integers(-(10**18), 4 * 10**18))
    return Recording(
        tuple(found), epoch_ns=epoch, events=tuple(e for e in events if "@@" not in e.text)
    )


@both
class TestThereAndBack:
    @given(data=st.data())
    def test_counts_gaps_rates_labels_units_events_and_start(
        self, format: str, data: st.DataObject
    ) -> None:
        given = data.draw(recordings(BITS[format]))
        out, notes = written(given, format)
        assert not [note for note in notes if "rounded" in note]
        back = read(out)
        assert back.labels == given.labels
        start = Fraction(0)
        if any("the start" in note for note in notes):
            start = min(c.start_tick / c.rate_exact - d.start_tick / d.rate_exact
                        for c, d in zip(given, back, strict=True))  # fmt: skip
        elif given.epoch_ns is not None and back.epoch_ns is not None:
            start = Fraction(back.epoch_ns - given.epoch_ns, 10**9)
        for one, other in zip(given, back, strict=True):
            shift = start * one.rate_exact
            assert abs(shift - round(shift)) < Fraction(1, 10**4)
            moved = tuple(Span(s.start - round(shift), s.stop - round(shift)) for s in one.coverage)
            assert facts(other) == (moved, *facts(one)[1:])
            assert other.unit == one.unit
        if not any("events before" in note for note in notes) and not start:
            assert sorted(map(repr, back.events)) == sorted(map(repr, given.events))

    @given(x=st.lists(st.floats(-1e5, 1e5, width=32), min_size=1, max_size=40))
    def test_floats_are_rounded_within_the_bound_of_the_note(
        self, format: str, x: list[float]
    ) -> None:
        given = Channel(np.array(x), 100, label="fx", unit="N")
        out, notes = written(Recording((given,)), format)
        [note] = [note for note in notes if "rounded" in note]
        assert ("; .bdf has finer steps" in note) is (format == "edf")
        bound = float(note.split("at most ")[1].split(" N off")[0])
        assert np.abs(read(out)["fx"].samples() - given.samples()).max() <= bound
        step = float(note.split("steps of ")[1].split(" N")[0])
        assert bound <= 0.51 * step
        assert step <= (max(x) - min(x) + 0.3) / (1 << (BITS[format] - 1))

    def test_edfio_reads_it(self, format: str) -> None:
        data, signals = foreign(format)
        given = read(data)
        out, notes = written(given, format)
        assert notes == (
            f"not carried over to .{format}: metadata 'prefiltering', metadata 'source_units'",
        )
        file = foreign_reader(format)(out)
        assert [s.label for s in file.signals] == given.labels
        for one, other in zip(file.signals, signals, strict=True):
            assert one.digital.tolist() == other.digital.tolist()
            assert np.abs(one.data - other.data).max() <= 1e-12 * np.abs(other.data).max()
            assert one.sampling_frequency == other.sampling_frequency
        assert [s.physical_dimension for s in file.signals] == ["N", "uV", "Cel"]
        assert [tuple(a) for a in file.annotations] == [
            (0.5, None, "touch"),
            (1, 0.25, "slip@@fx"),
        ]
        assert file.startdate == datetime.date(2026, 1, 2)
        assert file.starttime == datetime.time(10, 11, 12, 250000)
        assert file.patient.code == "P7"
        assert "rig hapfmt" in file.local_recording_identification

    def test_a_gap_is_an_annotation(self, format: str) -> None:
        given = Channel(
            np.arange(7, dtype=np.int16), 10, (Span(0, 3), Span(6, 10)), Calibration(1, 0, 2), "fx"
        )
        out, notes = written(Recording((given,)), format)
        assert notes == (
            "3 samples that are missing are filled with the last value and marked 'no data' by "
            "annotations",
        )
        file = foreign_reader(format)(out)
        assert file.signals[0].digital.tolist() == [0, 1, 2, 2, 2, 2, 3, 4, 5, 6]
        assert [tuple(a) for a in file.annotations] == [(0.3, 0.3, "no data@@fx")]
        assert facts(read(out)[0]) == facts(given)

    def test_16_bits_of_a_full_scale_of_1(self, format: str) -> None:
        """EDF cannot state 32767/32768 in 8 characters; BDF states larger counts."""
        given = Channel(
            np.array([-32768, 32767], np.int16), 8000, calibration=Calibration(1, 0, 1 << 15)
        )
        out, notes = written(Recording((given,)), format)
        assert any("rounded" in note for note in notes) is (format == "edf")
        assert (facts(read(out)[0]) == facts(given)) is (format == "bdf")

    def test_what_does_not_fit(self, format: str) -> None:
        from hapfmt.convert import save

        def refused(channel: Channel, match: str, **options: Any) -> None:
            with pytest.raises((ParameterError, LimitError), match=match):
                save(Recording((channel,)), io.BytesIO(), format=format, **options)

        refused(Channel(np.array([np.inf]), 10, label="a"), "channel 'a' holds infinities")
        refused(Channel(np.array([1e9]), 10, label="a"), "has 8 characters for it; use a larger")
        refused(Channel(np.zeros(0), 10), "recording without samples")
        refused(Channel(np.array([2**53 + 1]), 10, label="far"), "'far' holds 9007199254740993")
        far = Channel(np.zeros(2), 10, (Span(0, 1), Span(1 << 30, (1 << 30) + 1)))
        refused(far, "gaps take .* more than", max_memory=1 << 20)
        refused(Channel(np.zeros(2), Fraction(1, 10**9)), "no record of .*; use .npz")

    def test_labels_and_units_that_do_not_fit(self, format: str) -> None:
        x = np.zeros(2, np.int16)
        long = [f"a label that is too long {i}" for i in range(2)]
        given = [
            Channel(x, 10, calibration=Calibration(), label=long[0], unit="{raw(0-255)}"),
            Channel(x, 10, calibration=Calibration(), label=long[1], group="hand"),
        ]
        events = (Event(Fraction(0), "a\nb", layer="x"), Event(Fraction(1, 10), ""))
        out, notes = written(Recording(tuple(given), events=events), format)
        back = read(out)
        assert back.labels == ["a label that is", "a label that i_2"]
        assert [event.text for event in back.events] == ["a b", "event"]
        assert [
            "the label 'a label that is too long 0' is written as 'a label that is'",
            "the label 'a label that is too long 1' is written as 'a label that i_2'",
            "the unit '{raw(0-255)}' of channel 'a label that is too long 0' is not carried over",
            "the text 'a\\nb' of an event is written as 'a b'",
            "the text '' of an event is written as 'event'",
            "the layers of events are not carried over",
            f"not carried over to .{format}: group",
        ] == list(notes)


def test_command_line(tmp_path: Path) -> None:
    data, _ = foreign("edf")
    (tmp_path / "a.edf").write_bytes(data)
    assert b"EDF: 3 channels, 2 events" in run("info", "a.edf", cwd=tmp_path).stdout
    for words in (["encode", "a.edf", "a.hapf"], ["convert", "a.hapf", "b.bdf"]):
        assert run(*words, cwd=tmp_path).returncode == 0
    done = run("compare", "a.edf", "b.bdf", cwd=tmp_path)
    assert done.returncode == 0 and b"3 identical" in done.stdout
