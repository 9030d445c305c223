"""Sinks without a device: frames as text, and as a recording of what was sent."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import hapfmt
from hapfmt import Span
from hapfmt.errors import ParameterError
from hapfmt.replay.profile.model import Actuator, Frame, HidReport, Profile, Timing
from hapfmt.replay.sinks.dry import DryRunSink
from hapfmt.replay.sinks.record import RecordSink

THUMB = Actuator("thumb", "N", -10, 10, 100, 0.001, quantity="force", body_site="thumb")
VOICE = Actuator("voice", "1", 0, 1, 50, 1 / 255)
PROFILE = Profile("two", "", "", (), Timing(Fraction(1000)), (THUMB, VOICE))


def frame(number: int, *counts: tuple[int, ...], size: int = 1, rate: int = 1000) -> Frame:
    return Frame(number, -(-number * size * 10**9 // rate), counts)


def loaded(path: str) -> hapfmt.Recording:
    return hapfmt.read(path) if path.endswith(".hapf") else hapfmt.read(path, rate=1000)


class TestDryRun:
    REPORTS = (HidReport("output", b"\x01\xff\x00"), HidReport("feature", b"\x02"))

    def test_text(self):
        out = io.StringIO()
        sink = DryRunSink(out)
        sink.open()
        sink.send(Frame(1, 1_333_334, ((0, 0),)), self.REPORTS)
        sink.send(Frame(12345678, 12_345_678_000_000, ()), self.REPORTS[:1])
        sink.close()
        assert out.getvalue() == (
            "0.001333 output  01 ff 00\n0.001333 feature 02\n12345.678000 output  01 ff 00\n"
        )

    def test_json(self):
        out = io.StringIO()
        DryRunSink(out, as_json=True).send(Frame(1, 1_333_334, ()), self.REPORTS)
        told = [json.loads(line) for line in out.getvalue().splitlines()]
        assert told == [
            {"due_ns": 1_333_334, "path": "output", "data": "01ff00"},
            {"due_ns": 1_333_334, "path": "feature", "data": "02"},
        ]


class TestRecord:
    COUNTS = tuple((n * 3 - 5000, n % 256) for n in range(5000))

    @pytest.fixture(params=[".hapf", ".csv"])
    def path(self, request, tmp_path):
        return str(tmp_path / f"sent{request.param}")

    def test_counts_are_exact_and_what_was_not_sent_is_a_gap(self, path):
        with RecordSink(path, PROFILE) as sink:
            sink.open()
            sink.send(frame(0), ())
            for n, counts in enumerate(self.COUNTS):
                if not 10 <= n < 4700:
                    sink.send(frame(n, counts), ())
            sink.send(frame(5003), (HidReport("output", b"\0"),))
            sink.close()
        thumb, voice = loaded(path).channels
        assert thumb.coverage == voice.coverage == (Span(0, 10), Span(4700, 5000))
        kept = np.array([*self.COUNTS[:10], *self.COUNTS[4700:]])
        assert np.array_equal(thumb.samples(), kept[:, 0] / 1000)
        assert np.array_equal(voice.samples(), kept[:, 1] / 255)
        assert (thumb.label, thumb.unit, thumb.rate_exact) == ("thumb", "N", 1000)

    def test_many_rows_pass_in_pieces(self, path):
        with RecordSink(path, PROFILE) as sink:
            for n in range(9000):
                sink.send(frame(n, self.COUNTS[n % 5000]), ())
        thumb = loaded(path).channels[0]
        assert thumb.coverage == (Span(0, 9000),)
        assert thumb.samples()[8999] == self.COUNTS[3999][0] / 1000

    def test_frames_of_several_samples(self, path):
        profile = replace(PROFILE, timing=Timing(Fraction(3000), 32))
        with RecordSink(path, profile) as sink:
            for k in (0, 1, 3):
                sink.send(frame(k, *self.COUNTS[32 * k : 32 * k + 32], size=32, rate=3000), ())
        thumb = hapfmt.read(path).channels[0]
        assert thumb.coverage == (Span(0, 64), Span(96, 128)) and thumb.rate_exact == 3000

    def test_it_says_what_was_played(self, tmp_path):
        told = {"gain": 0.5, "kernels": ["linear"]}
        with RecordSink(str(tmp_path / "a.hapf"), PROFILE, metadata=told) as sink:
            sink.send(frame(0, (0, 0)), ())
        recording = hapfmt.read(tmp_path / "a.hapf")
        assert recording.metadata["replay"] == {"profile": "two", **told}
        thumb, voice = recording.channels
        assert (thumb.quantity, thumb.body_site, thumb.device) == ("force", "thumb", "two")
        assert thumb.calibration.step == Fraction(1, 1000)
        assert voice.calibration.step == Fraction(1, 255)
        with RecordSink(str(tmp_path / "a.csv"), PROFILE, metadata=told):
            pass
        comment = (tmp_path / "a.csv").read_text().splitlines()[0]
        assert json.loads(comment.removeprefix("# replay: ")) == {"profile": "two", **told}

    def test_the_same_bytes_with_an_id(self, tmp_path):
        for name in "ab":
            with RecordSink(str(tmp_path / f"{name}.hapf"), PROFILE, canonical=7) as sink:
                sink.send(frame(0, (1, 2)), ())
        assert (tmp_path / "a.hapf").read_bytes() == (tmp_path / "b.hapf").read_bytes()

    def test_an_error_leaves_what_was_sent(self, path):
        with pytest.raises(RuntimeError), RecordSink(path, PROFILE) as sink:
            sink.send(frame(0, (1, 2)), ())
            raise RuntimeError
        assert loaded(path).channels[0].samples().tolist() == [0.001]

    def test_nothing_is_replaced_unless_asked(self, path, tmp_path):
        with RecordSink(path, PROFILE) as sink:
            sink.send(frame(0, (1, 2)), ())
        with pytest.raises(ParameterError, match="already exists"):
            RecordSink(path, PROFILE)
        with RecordSink(path, PROFILE, force=True) as sink:
            sink.send(frame(0, (3, 2)), ())
        assert loaded(path).channels[0].samples().tolist() == [0.003]
        assert len(list(tmp_path.iterdir())) == 1

    def test_names_and_steps_that_cannot_be(self, tmp_path):
        with pytest.raises(ParameterError, match=r"recorded as \.hapf or \.csv"):
            RecordSink(str(tmp_path / "a.wav"), PROFILE)
        tiny = replace(PROFILE, actuators=(replace(THUMB, step=1e-30),))
        with pytest.raises(ParameterError, match="cannot be recorded exactly"):
            RecordSink(str(tmp_path / "a.hapf"), tiny)

    @pytest.mark.parametrize(
        ("step", "fraction"),
        [
            (0.1, Fraction(1, 10)),
            (5 / 32767, Fraction(5, 32767)),
            (2.0, 2),
            (2**-20, Fraction(1, 2**20)),
        ],
    )
    def test_steps_as_the_simplest_fraction(self, tmp_path, step, fraction):
        profile = replace(PROFILE, actuators=(replace(THUMB, step=step),))
        with RecordSink(str(tmp_path / "a.hapf"), profile) as sink:
            sink.send(frame(0, (1,)), ())
        assert hapfmt.read(tmp_path / "a.hapf").channels[0].calibration.step == fraction
