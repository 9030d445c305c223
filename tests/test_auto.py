"""Preset auto: what each sort of channel becomes, and that every sample keeps the bound told."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from click.testing import CliRunner
from hapfmt.encoder.auto import NOTHING, few_values, is_clock, plan_channel, quantity_of
from hypothesis import given
from hypothesis import strategies as st
from strategies import recordings

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.cli.encode import encode as encode_command
from hapfmt.encoder import auto
from hapfmt.encoder.encode import Decision
from hapfmt.encoder.source import Source
from hapfmt.encoder.unit import bound_of, slow_part
from hapfmt.recording import Span
from hapfmt.scenes.stylus import simulate

AUTO = Settings.of("auto")
T = np.arange(4000) / 1000
NOISE = np.random.default_rng(5).normal(size=T.size)
PUSH = 3 * np.sin(T) ** 2
MILLI = Calibration(1, 0, 1000)


def counted(x: np.ndarray, unit: str = "1", **described: str) -> Channel:
    """Thousandths of a unit."""
    return Channel(
        np.rint(x * 1000).astype(np.int32), Fraction(1000), calibration=MILLI, unit=unit,
        **described,
    )  # fmt: skip


def doubles(x: np.ndarray, unit: str = "1", **described: str) -> Channel:
    return Channel.from_physical(x, 1000, unit=unit, **described)


def decided(
    channel: Channel, settings: Settings = AUTO
) -> tuple[Decision, Channel, hapfmt.verifier.Report]:
    """The decision, the channel as it comes back, and what verify finds."""
    recording, stream = Recording((channel,)), io.BytesIO()
    summary = hapfmt.write(recording, stream, settings, canonical=1)
    report = hapfmt.verify(stream.getvalue(), against=recording)
    assert report.verdict == "intact"
    assert not any(check.broken for check in report.contracts)
    return summary.decisions[0], hapfmt.read(stream.getvalue()).channels[0], report


LOSSLESS = {
    "constant": (counted(T * 0 + 2, "N"), "constant"),
    "no samples": (counted(T[:0], "N"), "no samples"),
    "clock by unit": (counted(T, "s"), "lossless (a clock: exact)"),
    "clock by quantity": (counted(PUSH, "1", quantity="time"), "lossless (a clock: exact)"),
    "clock by name": (counted(PUSH, "1", label="frame_index"), "by its name: exact"),
    "counter": (counted(T), "a clock or counter: exact"),
    "counter down": (counted(-T), "a clock or counter: exact"),
    "doubles that only rise": (doubles(np.sqrt(T + 0.1)), "bit for bit: counts of a binary grid"),
    "states": (counted(np.floor(T) % 3), "states: exact"),
    "infinite": (doubles(np.where(T > 1, np.inf, NOISE), "N"), "no lattice, kept bit for bit"),
}


@pytest.mark.parametrize("name", LOSSLESS)
def test_kept_without_loss(name):
    channel, reason = LOSSLESS[name]
    decision, back, _ = decided(channel)
    assert decision.exact
    assert reason in decision.reason
    assert decision.left_out == NOTHING
    assert back.samples().tobytes() == channel.samples().tobytes()


@pytest.mark.parametrize(
    ("unit", "k"),
    [("N", 0.1), ("N.m", 0.1), ("kPa", 0.1), ("m/s2", 0.1), ("m/s", 0.08), ("deg/s", 0.08)],
)
def test_a_felt_zero_has_a_deadband(unit, k):
    channel = counted(PUSH + 0.2 * NOISE, unit)
    decision, back, report = decided(channel)
    assert f"deadband of {100 * k:g} %, texture in" in decision.reason
    assert decision.within
    contract = report.contracts[0].contract
    assert contract is not None
    assert contract.kn / contract.kd == pytest.approx(k, rel=1e-3)
    x, y = channel.samples(), back.samples()
    assert (np.abs(x - y) <= np.maximum(k * np.abs(x), 0.002 * np.ptp(x)) + 1e-9).all()
    assert np.abs(x - y).max() > 0.002 * np.ptp(x)


@pytest.mark.parametrize("unit", ["rad", "mm", "Cel", "V", "mA", "{count}", "1", "Hz"])
def test_elsewhere_only_the_floor_stays(unit):
    channel = counted(PUSH + 0.2 * NOISE, unit)
    decision, back, report = decided(channel)
    assert "no zero that is felt" in decision.reason
    assert decision.left_out == "less than 0.2 % of the range"
    contract = report.contracts[0].contract
    assert contract is not None
    assert contract.kn == 0
    x, y = channel.samples(), back.samples()
    assert 0 < np.abs(x - y).max() <= 0.002 * np.ptp(x) + 1e-9


def test_what_is_named_goes_before_the_unit():
    assert quantity_of(counted(PUSH, "V", quantity="Force")) == "force"
    assert quantity_of(counted(PUSH, "N", quantity="normal force")) == "force"
    assert quantity_of(counted(PUSH, "1", quantity="bend")) == "bend"
    assert quantity_of(counted(PUSH)) == ""
    assert "deadband of 10 %" in decided(counted(PUSH, "V", quantity="force"))[0].reason


def test_no_texture_above_threshold():
    decision, _, _ = decided(counted(PUSH + 1 + 0.002 * NOISE, "N"))
    assert decision.chosen == "knots"
    assert "no texture above it" in decision.reason
    assert decision.left_out.endswith("and all texture above 20 Hz")


def test_texture_is_measured_in_stretches(monkeypatch):
    x = np.rint(3000 + 2000 * np.sin(3 * T) + 300 * NOISE * (T % 1 < 0.3)).astype(np.int32)
    spans = (Span(0, 1500), Span(1700, 4200))
    channel = Channel(x, Fraction(1000), spans, MILLI, unit="N")
    source = Source((channel,), x[:, None], spans)
    settings = Settings.of("deadband")
    bound = bound_of(source, settings)
    whole = bound.band.outside(source.counts, slow_part(source, settings)).mean()
    assert whole > 0.01
    assert auto.texture_share(source, bound, 20.0) == pytest.approx(whole)
    monkeypatch.setattr(auto, "STRETCH", 333)
    assert auto.texture_share(source, bound, 20.0) == pytest.approx(whole, abs=1e-3)


def test_silence_is_told_and_held():
    channel = counted(0.003 * NOISE.clip(-3, 3), "N")
    decision, back, report = decided(channel)
    assert "silent: nothing above 0.01 N" in decision.reason
    assert decision.left_out == "all but its level"
    assert decision.size < 20
    assert np.abs(channel.samples() - back.samples()).max() <= 0.01
    assert report.contracts[0].contract.guaranteed


def test_silence_is_what_the_caller_says():
    quiet = counted(0.003 * NOISE.clip(-3, 3), "m/s2")
    assert "silent" not in decided(quiet)[0].reason
    assert "silent" in decided(quiet, Settings.of("auto", floor="0.01"))[0].reason
    place = counted(0.003 * NOISE.clip(-3, 3), "m")
    assert "silent" not in decided(place, Settings.of("auto", floor="0.01"))[0].reason


def test_true_doubles_go_on_a_lattice_below_the_floor():
    channel = doubles(PUSH + 0.2 * NOISE, "N")
    decision, back, report = decided(channel)
    assert "rounded within the tolerance" in decision.lattice
    assert decision.size < channel.stored.nbytes / 20
    x, y = channel.samples(), back.samples()
    assert (np.abs(x - y) <= np.maximum(0.1 * np.abs(x), 0.002 * np.ptp(x))).all()
    assert 0 < report.contracts[0].moved <= 0.002 * np.ptp(x) / 32


def test_nothing_left_out_where_the_floor_is_below_a_count():
    decision, back, _ = decided(counted(NOISE, "V"), Settings.of("auto", floor="0.3lsb"))
    assert decision.left_out == NOTHING
    assert np.array_equal(back.stored, np.rint(NOISE * 1000))


def test_a_tolerance_of_the_caller_is_told():
    clock, settings = doubles(np.sqrt(T + 0.1), "s"), Settings.of("auto", tolerance="1e-6")
    decision, back, _ = decided(clock, settings)
    assert decision.exact
    assert decision.left_out == "less than 1e-06 s"
    assert 0 < np.abs(back.samples() - clock.samples()).max() <= 1e-6


def test_a_weber_fraction_of_nothing_leaves_the_floor():
    decision, _, _ = decided(counted(PUSH + 0.2 * NOISE, "N"), Settings.of("auto", k=0))
    assert "(force: the floor alone)" in decision.reason


def test_axes_of_a_group_are_apart_unless_they_must_not_be():
    recording = simulate("cork", 1.0, axes=3)
    summary = hapfmt.write(recording, io.BytesIO(), AUTO, canonical=1)
    assert [d.axis_count for d in summary.decisions] == [1, 1, 1]
    required = replace(AUTO, vectors="required")
    stream = io.BytesIO()
    summary = hapfmt.write(recording, stream, required, canonical=1)
    assert [d.axis_count for d in summary.decisions] == [3, 3, 3]
    assert "on the norm" in summary.decisions[0].reason
    report = hapfmt.verify(stream.getvalue(), against=recording)
    assert not any(check.broken for check in report.contracts)


def test_smaller_than_the_default_at_a_bound_that_is_no_wider():
    recording = simulate("sand", 2.0)
    sizes = {
        preset: hapfmt.write(recording, io.BytesIO(), Settings.of(preset), canonical=1).file_size
        for preset in ("default", "auto")
    }
    assert sizes["auto"] < sizes["default"]


def test_other_presets_plan_nothing():
    channel, settings = counted(T, "s"), Settings.of("deadband")
    assert plan_channel(channel, settings).settings is settings
    assert decided(channel, settings)[0].left_out == ""


def test_clocks_and_states():
    assert is_clock(np.arange(16.0))
    assert not is_clock(np.arange(15.0))
    assert not is_clock(np.repeat(np.arange(10.0), 3))
    assert not is_clock(np.append(np.arange(16.0), 3))
    assert not is_clock(np.array([1e308, -1e308] * 8))
    assert few_values(np.array([1.0, 2, 3, 4, 4, 1]))
    assert not few_values(np.array([1.0, 2, 3, 4, 5]))


@given(recordings(), st.sampled_from(["N", "m", "s", "1"]), st.sampled_from([0.0, 0.1, 1.5]))
def test_never_outside(recording, unit, k):
    channels = tuple(replace(channel, unit=unit) for channel in recording.channels)
    altered = replace(recording, channels=channels)
    stream = io.BytesIO()
    summary = hapfmt.write(altered, stream, Settings.of("auto", k=k), canonical=1)
    report = hapfmt.verify(stream.getvalue(), against=altered)
    assert report.verdict == "intact", (report.error, report.findings)
    assert not any(check.broken for check in report.contracts)
    assert all(d.exact or d.within for d in summary.decisions)
    assert all(d.left_out for d in summary.decisions)


def test_command_tells_what_was_left_out(tmp_path):
    source = str(tmp_path / "in.npz")
    hapfmt.save(Recording((counted(PUSH, "N", label="push"), counted(T, "s", label="t"))), source)
    out = str(tmp_path / "out.hapf")
    done = CliRunner().invoke(encode_command, [source, out, "--preset", "auto"])
    assert done.exit_code == 0, done.output
    assert "left out" in done.output
    done = CliRunner().invoke(encode_command, [source, out, "-f", "--preset", "auto", "--json"])
    told = json.loads(done.output)["channels"]
    assert told[1]["left_out"] == NOTHING
    assert told[0]["left_out"].startswith("less than 10 % or 0.2 % of the range")
