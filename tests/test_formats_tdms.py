"""TDMS files, written by npTDMS or after NI's description of DAQmx segments."""

from __future__ import annotations

import io
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from formats import damaged, facts, survives
from hypothesis import given
from hypothesis import strategies as st
from tdms_files import channel, daqmx, interleaved, linear, written

from hapfmt.clocks import ClockObservation
from hapfmt.convert import imported, read, tdms
from hapfmt.errors import LimitError, ParameterError
from hapfmt.recording import Calibration, Span

START = np.datetime64("2026-05-01T10:00:00.25", "us")
START_NS = 1_777_629_600_250_000_000
WAVE = {"wf_increment": 0.001, "wf_start_time": START}


def notes(data: bytes, **options: Any) -> list[str]:
    return read(data, **options).metadata.get("notes", [])


def foreign(data: bytes) -> dict[str, Any]:
    from nptdms import TdmsFile

    file = TdmsFile.read(io.BytesIO(data))
    return {c.name: c[:] for group in file.groups() for c in group.channels()}


def session() -> bytes:
    """Three segments, two groups, two rates."""
    x = np.arange(300, dtype=np.int16)
    return written(*[
        [
            channel("hand", "fx", x[at : at + 100], unit_string="Newton", **WAVE,
                    **linear(10 / 32768, 0.5)),
            channel("hand", "acc", x[at : at + 100] / 7, wf_increment=1 / 3000,
                    wf_start_time=START + np.timedelta64(300, "us"), unit_string="m/s^2"),
            channel("log", "text", ["a", "b"]),
        ]
        for at in (0, 100, 200)
    ])  # fmt: skip


class TestChannels:
    def test_values_rates_scales_units_and_starts(self) -> None:
        data = session()
        back = read(data)
        assert back.labels == ["fx", "acc"]
        assert [c.group for c in back] == ["hand", "hand"]
        assert [c.unit for c in back] == ["N", "m/s2"]
        assert [c.rate_exact for c in back] == [1000, 3000]
        assert back["fx"].counts.tolist() == list(range(300))
        assert back["fx"].calibration == Calibration(5, 8192, 16384)
        assert back["fx"].samples().tolist() == foreign(data)["fx"].tolist()
        assert back["acc"].stored.tolist() == foreign(data)["acc"].tolist()
        assert back.epoch_ns == START_NS
        assert back["acc"].coverage == (Span(1, 301),)
        assert back.metadata["source_units"] == {"fx": "Newton", "acc": "m/s^2"}

    def test_a_start_between_two_ticks_is_observed(self) -> None:
        assert read(session()).clocks == (
            ClockObservation("wf_start_time", 1, 1, START_NS + 300_000),
        )

    def test_the_offset_of_the_start(self) -> None:
        back = read(written([channel("g", "x", [1.5], wf_start_offset=0.5, **WAVE)]))
        assert back.epoch_ns == START_NS + 500_000_000

    def test_what_is_left_out(self) -> None:
        data = written([
            channel("g", "x", [1.5], **WAVE),
            channel("g", "z", np.array([1j])),
            channel("g", "when", [START]),
            channel("g", "s", ["a"]),
            channel("g", "none", np.empty(0), **WAVE),
        ])  # fmt: skip
        assert read(data).labels == ["x"]
        assert notes(data) == [
            "channel 'g/z' holds ComplexDoubleFloat values, which are not read",
            "channel 'g/when' holds TimeStamp values, which are not read",
            "channel 'g/s' holds String values, which are not read",
            "channel 'g/none' holds no values",
        ]

    def test_select(self) -> None:
        assert read(session(), select="hand/f*").labels == ["fx"]
        with pytest.raises(ParameterError, match="no channel is called 'fx'; there are: 'hand/fx'"):
            read(session(), select="fx")

    def test_a_rate_is_needed(self) -> None:
        data = written([channel("g", "x", [1.5, 2.5])])
        with pytest.raises(ParameterError, match="channel g/x has no wf_increment"):
            read(data)
        assert read(data, rate=50)["x"].rate_exact == 50

    @pytest.mark.parametrize(
        ("name", "unit", "code", "said"),
        [
            ("Beschl", "g", "[g]", "is read as [g], since its name says acceleration"),
            ("accX", "mg", "m[g]", "is read as m[g], since its name says acceleration"),
            ("load", "g", "g", "is mass; [g] is acceleration"),
            ("accuracy", "mg", "mg", "is mass; [g] is acceleration"),
            ("acc", "gram", "g", ""),
            ("acc", "[g]", "[g]", ""),
        ],
    )
    def test_g_is_gram_or_gravity(self, name: str, unit: str, code: str, said: str) -> None:
        back = read(written([channel("h", name, [1.5], unit_string=unit, **WAVE)]))
        assert back[name].unit == code
        assert [said in note for note in back.metadata.get("notes", [])] == [True] * bool(said)

    def test_a_given_rate_leaves_those_of_the_file(self) -> None:
        data = written([
            channel("g", "x", [1.5] * 4, wf_increment=0.002),
            channel("g", "y", [1.5] * 3, wf_increment=0.01),
            channel("g", "z", [1.5, 2.5]),
        ])  # fmt: skip
        back = read(data, rate=10)
        assert {c.label: c.rate_exact for c in back} == {"x": 500, "y": 100, "z": 10}
        assert notes(data, rate=10) == ["the rate 10 Hz is only for g/z; the file tells the others"]
        with pytest.raises(ParameterError, match="have several rates"):
            read(data, rate=10, select=["g/x", "g/y"])
        one = read(data, rate=10, select="g/x")
        assert one["x"].rate_exact == 10
        assert one.metadata["notes"] == ["the rate of the file, 500 Hz, was overridden by 10 Hz"]

    def test_a_given_rate_beside_time_stamps(self) -> None:
        uneven = np.array([0, 13, 51, 64, 87, 311])
        data = written([
            channel("g", "t", START + np.arange(100) * np.timedelta64(10, "ms")),
            channel("g", "x", np.arange(100.0)),
            channel("h", "t", START + uneven * np.timedelta64(1, "ms")),
            channel("h", "y", np.arange(6.0)),
            channel("i", "z", [1.0]),
        ])  # fmt: skip
        back = read(data, rate=50, select=["g/*", "i/*"])
        assert {c.label: c.rate_exact for c in back} == {"x": 100, "z": 50}
        both = read(data, rate=200, select=["g/*", "h/*"])
        assert {c.label: c.rate_exact for c in both} == {"x": 100, "y": 200}
        assert read(data, rate=200, select="g/*")["x"].rate_exact == 200

    def test_time_stamps_of_a_group(self) -> None:
        kept = np.array([i for i in range(100) if not 40 <= i < 50])
        data = written([
            channel("g", "t", START + kept * np.timedelta64(10, "ms")),
            channel("g", "x", kept.astype(np.int32)),
            channel("h", "y", [1.0], wf_increment=0.5, wf_start_time=START - np.timedelta64(1, "s")),
        ])  # fmt: skip
        back = read(data)
        assert back["x"].coverage == (Span(100, 140), Span(150, 200))
        assert back["x"].counts.tolist() == kept.tolist()
        assert back.epoch_ns == START_NS - 10**9
        assert [(c.clock, c.channel, c.tick) for c in back.clocks] == [
            ("g/t", 0, 100), ("g/t", 0, 139), ("g/t", 0, 150), ("g/t", 0, 199)
        ]  # fmt: skip
        assert back.clocks[0].time_ns == START_NS

    def test_stamps_without_a_rate(self) -> None:
        stamps = START + np.array([0, 371, 4902, 7919]) * np.timedelta64(1, "us")
        data = written([channel("g", "t", stamps), channel("g", "x", np.arange(4.0))])
        with pytest.raises(ParameterError, match=r"time stamps of g/t have no rate; give one"):
            read(data)

    def test_properties_are_kept(self) -> None:
        from nptdms import GroupObject, RootObject

        data = written([
            RootObject({"name": "slip", "subject": 7, "begun": START}),
            GroupObject("g", {"arm": "left"}),
            channel("g", "x", [1.5], gain=2.5, **WAVE),
        ])  # fmt: skip
        assert read(data).metadata["properties"] == {
            "/": {"name": "slip", "subject": 7, "begun": "2026-05-01T10:00:00.250000"},
            "/'g'": {"arm": "left"},
            "/'g'/'x'": {"gain": 2.5},
        }

    @pytest.mark.parametrize("big_endian", [False, True])
    def test_interleaved(self, big_endian: bool) -> None:
        x = np.arange(-30, 30, dtype=np.int16).reshape(-1, 3)
        data = interleaved(x, big_endian=big_endian) * 2
        back = read(data)
        assert [c.counts.tolist() for c in back] == [[*column, *column] for column in x.T.tolist()]
        assert foreign(data)["ai1"].tolist() == back["ai1"].counts.tolist()
        assert {c.rate_exact for c in back} == {1000}

    def test_blocks_are_chunks(self) -> None:
        with imported(session()) as (_, found):
            assert [(b.table, b.first_row) for b in found.blocks()] == [
                (0, 0), (1, 0), (0, 100), (1, 100), (0, 200), (1, 200)
            ]  # fmt: skip


@given(
    st.sampled_from(["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f4", "f8"]),
    st.lists(st.integers(1, 9), min_size=1, max_size=4),
    st.integers(0, 99),
)
def test_any_values_are_kept_bit_for_bit(dtype: str, sizes: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [np.frombuffer(rng.bytes(size * int(dtype[1])), dtype) for size in sizes]
    parts = [np.nan_to_num(part) if dtype[0] == "f" else part for part in parts]
    data = written(*[[channel("g", "x", part, **WAVE)] for part in parts])
    [back] = read(data)
    x = np.concatenate(parts)
    assert back.stored.tolist() == x.tolist() == foreign(data)["x"].tolist()
    assert (back.calibration == Calibration()) == (dtype in ("i1", "i2", "i4", "u1", "u2"))


def scaled(x: Any, *scales: dict[str, Any]) -> bytes:
    properties = {"NI_Number_Of_Scales": len(scales)}
    for number, scale in enumerate(scales):
        properties |= {f"NI_Scale[{number}]_{key}": value for key, value in scale.items()}
    return written([channel("g", "x", x, **WAVE, **properties)])


def polynomial(*coefficients: float, source: int = 0xFFFFFFFF) -> dict[str, Any]:
    return {
        "Scale_Type": "Polynomial",
        "Polynomial_Coefficients_Size": len(coefficients),
        "Polynomial_Input_Source": source,
        **{f"Polynomial_Coefficients[{i}]": each for i, each in enumerate(coefficients)},
    }


class TestScales:
    X = np.arange(-50, 50, dtype=np.int16)

    def test_linear_polynomials_are_composed(self) -> None:
        data = scaled(self.X, polynomial(1.0, 0.5), polynomial(0.25, 2.0, source=0))
        assert read(data)["x"].calibration == Calibration(4, 9, 4)
        assert read(data)["x"].samples().tolist() == foreign(data)["x"].tolist()

    def test_scales_of_other_shapes(self) -> None:
        data = scaled(self.X, polynomial(1.0, 0.5, 0.125))
        assert read(data)["x"].stored.tolist() == foreign(data)["x"].tolist()
        assert notes(data) == [
            "the scale of channel 'g/x' is not an exact linear one; its values are doubles"
        ]

    def test_a_scale_with_too_many_digits(self) -> None:
        data = scaled(self.X, polynomial(1e-15 / 3, 1e-6 / 7))
        assert read(data)["x"].stored.tolist() == foreign(data)["x"].tolist()

    def test_values_that_are_scaled_already(self) -> None:
        data = written([
            channel("g", "x", self.X, NI_Scaling_Status="scaled", **WAVE, **linear(2.0, 0.0))
        ])  # fmt: skip
        assert read(data)["x"].calibration == Calibration()

    def test_daqmx(self) -> None:
        x = np.arange(-100, 100, dtype="<i2").reshape(-1, 2)
        properties = {
            "wf_increment": 0.0005, "unit_string": "Volts", "NI_Number_Of_Scales": 2,
            "NI_Scale[1]_Scale_Type": "Linear", "NI_Scale[1]_Linear_Slope": 10 / 32768,
            "NI_Scale[1]_Linear_Y_Intercept": 0.0, "NI_Scale[1]_Linear_Input_Source": 0,
        }  # fmt: skip
        data = daqmx(x, properties) + daqmx(x + 300, properties)
        back = read(data)
        assert [c.rate_exact for c in back] == [2000, 2000]
        assert [c.unit for c in back] == ["V", "V"]
        assert {c.calibration for c in back} == {Calibration(5, 0, 16384)}
        for number, own in enumerate(back):
            expected = [*x[:, number], *(x[:, number] + 300)]
            assert own.counts.tolist() == expected
            assert own.samples().tolist() == foreign(data)[own.label].tolist()

    def test_daqmx_without_a_scale(self) -> None:
        x = np.arange(6, dtype="u1").reshape(-1, 1)
        assert read(daqmx(x, {"wf_increment": 0.5}))["ai0"].counts.tolist() == list(range(6))


class TestHostile:
    def test_scales_that_never_end(self) -> None:
        data = scaled([1], polynomial(0.0, 2.0, source=1), polynomial(0.0, 2.0, source=0))
        with pytest.raises(LimitError, match="take more than 100 steps"):
            read(data)

    def test_scales_that_double_the_work(self) -> None:
        def add(source: int) -> dict[str, Any]:
            return {
                "Scale_Type": "Add",
                "Add_Left_Operand_Input_Source": source,
                "Add_Right_Operand_Input_Source": source,
            }

        with pytest.raises(LimitError, match="take more than 100 steps"):
            read(scaled([1], polynomial(0.0, 2.0), *map(add, range(60))))

    def test_a_huge_number_of_scales(self) -> None:
        data = written([channel("g", "x", [1], NI_Number_Of_Scales=2**40, **WAVE)])
        with pytest.raises(LimitError, match="has 1099511627776 scales, more than 100"):
            read(data)

    def test_many_segments_with_many_objects(self, monkeypatch: pytest.MonkeyPatch) -> None:
        first = written([channel("g", str(i), np.empty(0)) for i in range(100)])
        data = first + struct.pack("<4sIIQQ", b"TDSm", 0, 4713, 0, 0) * 1000
        assert read(data).channels == ()
        monkeypatch.setattr(tdms, "_WORK", 100_000)
        with pytest.raises(LimitError, match="too many segments with too many channels"):
            read(data)

    def test_chunks_are_bounded(self) -> None:
        data = written([channel("g", "x", np.zeros(1 << 18), **WAVE)])
        with pytest.raises(LimitError, match=r"a chunk at byte .* takes 2097152 bytes"):
            read(data, max_memory=1 << 20)

    def test_a_cut_file(self) -> None:
        data = written([channel("g", "x", np.arange(100), **WAVE)])[:-80]
        assert read(data)["x"].stored.tolist() == list(range(90))
        assert notes(data) == [
            "the file is cut off in its last segment; the values up to there are read, the rest is "
            "lost"
        ]

    @pytest.mark.parametrize(
        "data",
        [
            session,
            lambda: daqmx(np.ones((40, 2), "<i2"), WAVED),
            lambda: interleaved(np.ones((40, 2), np.int16)),
        ],
    )
    def test_damage(self, data: Any, capfd: pytest.CaptureFixture[str]) -> None:
        for each in damaged(data(), 40, 120):
            survives(each, "tdms")
        assert capfd.readouterr() == ("", "")


WAVED = {"wf_increment": 0.5, **linear(0.5, 0.0)}


def test_command_line(tmp_path: Path) -> None:
    (tmp_path / "a.tdms").write_bytes(session())
    shown = run("info", "a.tdms", cwd=tmp_path).stdout.decode()
    assert "TDMS: 2 channels" in shown
    assert "N (from 'Newton')" in shown
    assert run("encode", "a.tdms", "a.hapf", cwd=tmp_path).returncode == 0
    found, back = read(tmp_path / "a.tdms"), read(tmp_path / "a.hapf")
    assert [facts(c) for c in back] == [facts(c) for c in found]
    assert (back.epoch_ns, back.clocks) == (found.epoch_ns, found.clocks)


def test_the_rate_is_exact() -> None:
    for step, rate in [(1 / 44100, 44100), (1 / 3, 3), (0.0004, 2500), (3.0, Fraction(1, 3))]:
        data = written([channel("g", "x", [1.5], wf_increment=step)])
        assert read(data)["x"].rate_exact == rate
