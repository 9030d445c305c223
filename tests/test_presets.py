"""What each preset promises, and that no lossy form is larger than the lossless one."""

from __future__ import annotations

import io
import re
import warnings
from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from click.testing import CliRunner
from depth import either
from hypothesis import given
from hypothesis import strategies as st
from strategies import recordings

import hapfmt
from hapfmt import Calibration, Channel, ParameterError, Recording, Settings
from hapfmt.cli.encode import encode as encode_command
from hapfmt.cli.info import describe
from hapfmt.cli.record import record as record_command
from hapfmt.cli.scene import scene as scene_command
from hapfmt.cli.screen import in_options
from hapfmt.encoder.encode import Decision
from hapfmt.encoder.plan import few_values, is_clock, promise_of, quantity_of
from hapfmt.encoder.settings import ALIASES, PRESETS, alias_note, preset_of
from hapfmt.errors import DataWarning
from hapfmt.format.source import open_source
from hapfmt.kernels import compiled
from hapfmt.metrics import snr_hf_db
from hapfmt.reading.opening import open_catalogue
from hapfmt.recording import Span

DATA = Path(__file__).parents[2] / "shared" / "data"
T = np.arange(4000) / 1000
NOISE = np.random.default_rng(5).normal(size=T.size)
PUSH = 3 * np.sin(T) ** 2
MILLI = Calibration(1, 0, 1000)
PERCEPTUAL = Settings.of("perceptual")
NO_TEXTURE = Settings.of("perceptual", texture=False)
LOSSY = [
    {"preset": "near-lossless"},
    {"preset": "near-lossless", "max_error": "1%"},
    {"preset": "near-lossless", "max_error": "3lsb", "force_error": True},
    {"preset": "perceptual"},
    {"preset": "perceptual", "texture": False},
    {"preset": "perceptual", "texture": False, "felt": "all"},
    {"preset": "perceptual", "felt": "all", "snr": 50},
    {"preset": "paper"},
    {"preset": "paper", "bits": 16},
]


def counted(x: np.ndarray, unit: str = "1", **described: object) -> Channel:
    """Thousandths of a unit."""
    return Channel(
        np.rint(x * 1000).astype(np.int32), Fraction(1000), calibration=MILLI, unit=unit,
        **described,
    )  # fmt: skip


def doubles(x: np.ndarray, unit: str = "1", **described: object) -> Channel:
    return Channel.from_physical(x, 1000, unit=unit, **described)


def stated(decision: Decision) -> float:
    """The largest error that the file states."""
    if decision.kept_as == "lossless":
        return 0.0
    kept = re.fullmatch(r"within ([\d.e-]+)( \S+)?", decision.kept_as)
    assert kept, decision.kept_as
    return float(kept[1])


def decided(channel: Channel, settings: Settings = PERCEPTUAL) -> tuple[Decision, Channel]:
    """The decision, and the channel as it comes back, verified."""
    recording, stream = Recording((channel,)), io.BytesIO()
    summary = hapfmt.write(recording, stream, settings, canonical=1)
    report = hapfmt.verify(stream.getvalue(), against=recording)
    assert report.verdict == "intact"
    back = hapfmt.read(stream.getvalue()).channels[0]
    return summary.decisions[0], back


def size_of(recording: Recording, settings: Settings) -> int:
    """Bytes of the file; 0 where an option is refused because no channel uses it."""
    try:
        return hapfmt.write(recording, io.BytesIO(), settings, canonical=1).file_size
    except ParameterError as error:
        assert settings.preset == "perceptual" and "would do nothing: no " in error.message
        return 0


class TestNames:
    def test_lossless_unless_told(self):
        assert Settings().preset == Settings.of().preset == PRESETS[0] == "lossless"
        channel = doubles(NOISE, "N")
        decision, back = decided(channel, Settings())
        assert decision.kept_as == "lossless" and decision.largest_error == 0.0
        assert back.samples().tobytes() == channel.samples().tobytes()

    @pytest.mark.parametrize("old", sorted(ALIASES))
    def test_old_names_warn_in_python(self, old):
        """At the line of the caller, since Python shows no others."""
        name, implied = ALIASES[old]
        assert alias_note(old).startswith(f"preset {old} is now called {name}")
        given = {"rate": 1000, "units": "N", "canonical": 1}
        ours, theirs = io.BytesIO(), io.BytesIO()
        with pytest.warns(DeprecationWarning) as caught:
            settings = Settings.of(old, digest=True)
            hapfmt.write(PUSH + NOISE, ours, preset=old, digest=True, **given)
        assert settings == Settings.of(name, digest=True, **implied)
        assert [str(one.message) for one in caught] == [alias_note(old)] * 2
        assert {one.filename for one in caught} == {__file__}
        hapfmt.write(PUSH + NOISE, theirs, settings, **given)
        assert ours.getvalue() == theirs.getvalue()

    @pytest.mark.parametrize("old", sorted(ALIASES))
    @pytest.mark.parametrize("verb", ["encode", "scene", "record"])
    def test_old_names_are_noted_on_the_command_line(self, verb, old, tmp_path):
        name, implied = ALIASES[old]
        if verb == "record" and name == "perceptual":
            implied = {**implied, "texture": False, "floor": "2lsb"}
        words = [*(["--no-texture", "--floor", "2lsb"] if "floor" in implied else []),
                 "--preset", old]  # fmt: skip
        source, out = str(tmp_path / "a.csv"), str(tmp_path / "a.hapf")
        x = np.rint(1000 * (PUSH + NOISE)) / 1000
        Path(source).write_text("\n".join(["f", *map(str, x)]))
        rate = ["--rate", "1000", "--unit", "N"]
        command, given = {
            "encode": (encode_command, [str(tmp_path / "a.npz"), out]),
            "scene": (scene_command, ["sand", out, "--seconds", "0.5"]),
            "record": (record_command, [out, "-i", source, *rate, "--lsb", "0.001"]),
        }[verb]
        hapfmt.save(x, tmp_path / "a.npz", rate=1000, units="N")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            done = CliRunner().invoke(command, [*given, *words])
        assert done.exit_code == 0, done.output
        assert done.stderr.count(in_options(alias_note(old))) == 1
        assert not [one for one in caught if one.category is DeprecationWarning]
        made_by = hapfmt.read(out).metadata["encoder"]
        expected = Settings.of(name, **implied).describe()
        assert preset_of(made_by).replace(" --cluster 1", "") == expected

    @pytest.mark.parametrize("k", [1.5, "10", "150%", -0.1, Fraction(-1, 9)])
    def test_a_weber_fraction_is_a_share(self, k):
        with pytest.raises(ParameterError, match=r"k is a share from 0 to 1, such as 0\.1 or 10%"):
            Settings.of("perceptual", k=k)
        assert Settings.of("perceptual", k="100%").k == 1

    @pytest.mark.parametrize(
        ("preset", "given", "words"),
        [
            ("lossless", {"max_error": "1lsb"}, "max_error requires preset near-lossless or"),
            ("lossless", {"k": "10%"}, "k requires preset perceptual or paper"),
            ("lossless", {"tolerance": "1%"}, "tolerance requires"),
            ("near-lossless", {"floor": 1}, "floor requires preset perceptual or paper"),
            ("near-lossless", {"snr": 20.0}, "snr requires preset perceptual"),
            ("perceptual", {"bits": 5}, "bits requires preset paper"),
            ("perceptual", {"step": "1lsb"}, "step requires preset paper"),
            ("paper", {"fast": True}, "effort requires preset lossless or near-lossless or"),
            ("lossless", {"fast": True, "effort": "best"}, "fast=True or effort='best', not both"),
            ("lossless", {"effort": "most"}, "the effort is one of fast, default, best"),
            ("paper", {"texture": False}, "texture=False requires preset perceptual"),
            ("paper", {"felt": "all"}, "felt requires preset perceptual"),
            ("paper", {"references": False}, "references=False requires"),
            ("perceptual", {"vectors": "required"}, "vectors requires texture=False"),
        ],
    )
    def test_options_that_a_preset_does_not_use_are_refused(self, preset, given, words):
        with pytest.raises(ParameterError, match=words):
            Settings.of(preset, **given)

    def test_percent_and_units(self):
        settings = Settings.of("perceptual", k="8%", floor="10mN")
        assert settings.k == Fraction(8, 100)
        assert settings.describe() == "perceptual --k 2/25 --floor 10.0mN"
        quiet, _ = decided(counted(0.009 * np.sin(40 * T), "N"), settings)
        assert "silent: nothing above 0.01 N" in quiet.reason
        with pytest.raises(ParameterError, match="does not fit a channel in m"):
            decided(counted(PUSH + NOISE, "m"), Settings.of("near-lossless", max_error="10mN"))

    def test_a_large_offset_leaves_no_room_for_finer_counts(self):
        x = np.arange(-100, 250, 7, dtype=np.int32)
        channel = Channel(x, 1000, calibration=Calibration(1, (1 << 52) - 1), unit="N")
        _, back = decided(channel, Settings.of("perceptual", k=0, floor="0.5lsb", smallest=False))
        assert np.abs(back.samples() - channel.samples()).max() <= 0.5


class TestLossless:
    """What preset perceptual keeps to the last bit."""

    CASES: ClassVar = {
        "constant": (counted(T * 0 + 2, "N"), "constant"),
        "no samples": (counted(T[:0], "N"), "no samples"),
        "clock by unit": (counted(T, "s"), "a clock"),
        "clock by quantity": (counted(PUSH, "1", quantity="time"), "a clock"),
        "clock by name": (counted(PUSH, "1", label="frame_index"), "a clock or counter by its name"),
        "counter": (counted(T), "only rises or only falls: a clock or counter"),
        "counter down": (counted(-T), "only rises or only falls: a clock or counter"),
        "states": (counted(np.floor(T) % 3), "distinct values: states"),
        "infinite": (doubles(np.where(T > 1, np.inf, NOISE), "N"), "infinite samples"),
    }  # fmt: skip

    @pytest.mark.parametrize("name", CASES)
    def test_kept(self, name):
        channel, reason = self.CASES[name]
        warned = pytest.warns(DataWarning, match=reason) if name == "infinite" else nullcontext()
        with warned:
            decision, back = decided(channel)
        assert decision.kept_as == "lossless" and decision.largest_error == 0.0
        assert reason in decision.reason
        assert back.samples().tobytes() == channel.samples().tobytes()

    def test_clocks_and_states(self):
        assert is_clock(np.arange(16.0))
        assert not is_clock(np.arange(15.0))
        assert not is_clock(np.repeat(np.arange(10.0), 3))
        assert not is_clock(np.append(np.arange(16.0), 3))
        assert not is_clock(np.array([1e308, -1e308] * 8))
        assert few_values(np.array([1.0, 2, 3, 4, 4, 1]))
        assert not few_values(np.array([1.0, 2, 3, 4, 5]))

    def test_what_is_named_goes_before_the_unit(self):
        assert quantity_of(counted(PUSH, "V", quantity="Force")) == "force"
        assert quantity_of(counted(PUSH, "N", quantity="normal force")) == "force"
        assert quantity_of(counted(PUSH, "1", quantity="bend")) == "bend"
        assert quantity_of(counted(PUSH)) == ""


class TestNearLossless:
    @pytest.mark.parametrize("share", [1e-5, 1e-3, 1e-2, 0.3])
    @pytest.mark.parametrize("kind", ["doubles", "float32", "near a lattice", "counts", "far"])
    def test_the_bound_holds_for_the_doubles_without_any_other_option(self, kind, share):
        x = PUSH + 0.1 * NOISE
        channel = {
            "doubles": doubles(x, "m"),
            "float32": replace(doubles(x, "m"), stored=x.astype(np.float32)),
            "near a lattice": doubles(np.rint(x * 999) / 999 * (1 + 1e-13), "m"),
            "counts": counted(x, "m"),
            "far": doubles(x + 1e9, "m"),
        }[kind]
        settings = Settings.of("near-lossless", max_error=f"{100 * share:g}%", smallest=False)
        decision, back = decided(channel, settings)
        x = channel.samples()
        error = np.abs(x - back.samples()).max()
        assert error <= share * np.ptp(x) * (1 + 1e-9)
        assert decision.largest_error == pytest.approx(error, rel=1e-9, abs=1e-300)
        assert stated(decision) <= share * np.ptp(x) * 1.001
        assert decision.original_bits == 8 * channel.stored.itemsize and decision.unit == "m"

    def test_most_of_the_bound_is_used(self):
        """A grid that takes a share of the error for itself would leave less to the quantiser."""
        decision, _ = decided(doubles(NOISE, "m"), Settings.of("near-lossless"))
        assert decision.largest_error > 0.99 * 0.001 * np.ptp(NOISE)
        assert decision.size < 8 * NOISE.size / 6

    @pytest.mark.parametrize("odd", [-0.0, 5e-324, 1e3])
    def test_an_odd_value_does_not_change_the_mode(self, odd):
        """-0.0 has no count, and once turned the bound off for its whole channel."""
        x = PUSH + 0.1 * NOISE
        x[77] = odd
        usual, _ = decided(doubles(PUSH + 0.1 * NOISE, "N"), Settings.of("near-lossless"))
        decision, back = decided(doubles(x, "N"), Settings.of("near-lossless"))
        assert stated(decision) == pytest.approx(stated(usual), rel=0.1)
        assert decision.size < 1.1 * usual.size
        assert np.abs(back.samples() - x).max() <= decision.largest_error <= 0.0041
        for settings in (PERCEPTUAL, NO_TEXTURE):
            felt, _ = decided(doubles(x, "N"), settings)
            assert felt.largest_error and "force: threshold 0.2 % of range" in felt.reason

    @pytest.mark.parametrize("settings", [Settings.of("near-lossless"), PERCEPTUAL, NO_TEXTURE])
    def test_infinite_samples_are_kept(self, settings):
        x = PUSH + 0.1 * NOISE
        x[[50, 51, 900]] = np.inf, -np.inf, np.inf
        stream, recording = io.BytesIO(), Recording((doubles(x, "N", label="f"),))
        with pytest.warns(DataWarning, match="'f' is stored without loss: it has infinite samples"):
            hapfmt.write(recording, stream, settings)
        assert hapfmt.verify(stream.getvalue(), against=recording).exit_code == 0
        assert hapfmt.read(stream.getvalue()).channels[0].samples().tobytes() == x.tobytes()

    def test_an_amount_in_steps_needs_a_step(self):
        settings = Settings.of("near-lossless", max_error="1lsb")
        with pytest.warns(DataWarning, match="max_error does nothing for '': no step is known"):
            decision, _ = decided(doubles(NOISE, "N"), settings)
        assert decision.kept_as == "lossless" and "no step is known" in decision.reason
        known = doubles(NOISE, "N", lsb=0.01)
        decision, _ = decided(known, Settings.of("near-lossless", max_error="1lsb"))
        assert 0.009 < decision.largest_error <= 0.01


class TestBoundThatFlattens:
    """A largest error above 10 % of a range is probably meant in percent."""

    @pytest.mark.parametrize("make", [doubles, counted])
    @pytest.mark.parametrize("preset", ["near-lossless", "perceptual"])
    def test_is_refused_unless_it_is_meant(self, make, preset):
        channel = make(1.1 * np.sin(3 * T), "V" if preset == "perceptual" else "N", label="f")
        words = rf"^1 {channel.unit} is 45\.\d % of the range of channel 'f'; did you mean 1%\? "
        with pytest.raises(ParameterError, match=words + "To allow it, add force_error=True$"):
            self.write(channel, preset, max_error=1)
        with pytest.raises(ParameterError, match=r"of channel 'f'\. To allow it"):
            self.write(channel, preset, max_error=f"300m{channel.unit}")
        for allowed in (
            {"max_error": "100%"}, {"max_error": "46%"}, {"max_error": 0.2},
            {"max_error": 1, "force_error": True},
        ):  # fmt: skip
            self.write(channel, preset, **allowed)

    def write(self, channel: Channel, preset: str, **given: object) -> None:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "no channel is known to be felt")
            hapfmt.write(channel, io.BytesIO(), preset=preset, **given)

    def test_what_has_no_range_is_not_refused(self):
        still = counted(T * 0 + 2, "N")
        assert decided(still, Settings.of("near-lossless", max_error=1))[0].largest_error == 0

    def test_the_decision_states_its_share_of_the_range(self):
        x = PUSH + 0.1 * NOISE
        x[100] = 1e6  # the range leaves out a glitch
        decision, _ = decided(doubles(x, "N"), Settings.of("near-lossless", max_error="1%"))
        assert 0.009 < decision.relative_error <= 0.01 * (1 + 1e-9)


class TestPerceptual:
    @pytest.mark.parametrize(
        ("unit", "k"),
        [("N", 0.1), ("N.m", 0.1), ("kPa", 0.1), ("m/s2", 0.1), ("m/s", 0.08), ("deg/s", 0.08)],
    )
    def test_felt_quantities_keep_the_deadband(self, unit, k):
        channel = doubles(PUSH + 0.2 * NOISE, unit)
        decision, back = decided(channel, NO_TEXTURE)
        kept = re.fullmatch(r"deadband ([\d.]+) %, at least [\d.]+ (\S+)", decision.kept_as)
        assert kept and 99 * k < float(kept[1]) <= 100 * k and kept[2] == unit
        x, y = channel.samples(), back.samples()
        assert (np.abs(x - y) <= np.maximum(k * np.abs(x), 0.002 * np.ptp(x))).all()
        assert np.abs(x - y).max() > 0.01 * np.ptp(x)

    @pytest.mark.parametrize("unit", ["rad", "mm", "Cel", "V", "mA", "{count}", "1", "Hz"])
    def test_no_weber_fraction_where_zero_is_arbitrary(self, unit):
        channel = counted(PUSH + 0.2 * NOISE, unit)
        with pytest.warns(DataWarning, match="no channel is known to be felt: add unit='N'"):
            decision, back = decided(channel)
        assert stated(decision) == 0.004
        assert "absolute error bound only" in decision.reason
        x = channel.samples()
        assert 0 < np.abs(x - back.samples()).max() <= 0.001 * np.ptp(x) + 1e-9

    def test_unless_the_caller_calls_it_felt(self):
        channel = counted(PUSH + 0.2 * NOISE, "V", label="load cell")
        for felt in ("load cell", "0", "all"):
            given = Settings.of("perceptual", felt=felt, texture=False)
            assert decided(channel, given)[0].kept_as == "deadband 10 %, at least 0.008 V"
        with pytest.raises(ParameterError, match="no channel is called 'ring'"):
            decided(channel, Settings.of("perceptual", felt="ring"))

    @pytest.mark.parametrize("snr", [10, 20, 35])
    @pytest.mark.parametrize("make", [doubles, counted])
    def test_texture_has_its_quality(self, make, snr):
        """The SNR is that of hapfmt.metrics; the slow part keeps the deadband."""
        channel = make(PUSH + 2 + 0.2 * NOISE, "N")
        _, back = decided(channel, Settings.of("perceptual", snr=snr, smallest=False))
        x, y = channel.samples(), back.samples()
        assert snr <= snr_hf_db(x, y, 1000.0) < snr + 1
        from hapfmt.split import slow_for_telling

        slow, error = (slow_for_telling(each[:, None], 1000.0)[:, 0] for each in (x, y - x))
        assert (np.abs(error) <= np.maximum(0.1 * np.abs(slow), 0.002 * np.ptp(x)) * 1.01).all()

    def test_no_filter_reaches_over_a_gap(self):
        """A gap is no signal: before and after it the texture is measured by itself."""
        x = np.where(T < 2, 1.0, 5.0) + 0.05 * NOISE
        whole = Channel.from_physical(x, 1000, unit="N")
        gap = replace(whole, coverage=(Span(0, 2000), Span(9000, 11000)))
        settings = Settings.of("perceptual", smallest=False)
        apart, _ = decided(gap, settings)
        joined, _ = decided(whole, settings)
        # The jump is texture where nothing parts it, and a coarser step is enough there.
        assert apart.largest_error < 0.75 * joined.largest_error

    def test_nothing_above_the_threshold_is_no_texture(self):
        decision, _ = decided(doubles(PUSH + 1 + 0.0004 * NOISE, "N"))
        assert decision.kept_as == "deadband 9.95 %, at least 0.00597 N"
        assert decision.missed == "no texture above the threshold"
        assert decision.chosen == "knots"
        asked, _ = decided(
            doubles(PUSH + 1 + 0.0004 * NOISE, "N"), Settings.of("perceptual", snr=9)
        )
        assert asked.snr_hf_db == pytest.approx(9, abs=0.3)

    def test_texture_far_below_the_weber_fraction_is_kept(self):
        """10 % is a law of slow forces; a vibration of 2 % of the force is felt."""
        x = 1 + PUSH + 0.02 * np.sin(2 * np.pi * 95 * T)
        decision, back = decided(doubles(x, "N"))
        assert "no texture" not in decision.missed
        assert snr_hf_db(x, back.samples(), 1000.0) > 10

    @pytest.mark.parametrize("make", [doubles, counted])
    def test_errors_below_the_threshold_are_allowed_unless_the_quality_is_stated(self, make):
        channel = make(PUSH + 2 + 0.02 * NOISE, "N")
        floor = 0.002 * np.ptp(channel.samples())
        decision, back = decided(channel, Settings.of("perceptual"))
        assert stated(decision) <= 1.001 * floor
        error = np.abs(back.samples() - channel.samples()).max()
        assert decision.largest_error == pytest.approx(error) and error <= floor
        assert decision.size <= decided(channel, Settings.of("near-lossless"))[0].size
        strict, _ = decided(channel, Settings.of("perceptual", snr=20))
        assert strict.snr_hf_db == pytest.approx(20, abs=0.5)
        assert strict.size > decision.size

    def test_silence(self):
        decision, _ = decided(counted(0.003 * NOISE.clip(-3, 3), "N"))
        assert "silent: nothing above 0.01 N" in decision.reason and decision.size < 20
        with pytest.warns(DataWarning, match="no channel is known to be felt"):
            decision, _ = decided(counted(0.003 * NOISE.clip(-3, 3), "m"))
        assert "silent" not in decision.reason

    def test_vectors_where_they_are_asked_for(self):
        axes = [counted(PUSH + NOISE, "N", axis=a, group="tip", label=a) for a in "xyz"]
        recording, stream = Recording(tuple(axes)), io.BytesIO()
        assert [
            d.axis_count for d in hapfmt.write(recording, io.BytesIO(), NO_TEXTURE).decisions
        ] == [1, 1, 1]
        required = replace(NO_TEXTURE, vectors="required", smallest=False)
        summary = hapfmt.write(recording, stream, required, canonical=1)
        assert [d.axis_count for d in summary.decisions] == [3, 3, 3]
        assert summary.decisions[0].kept_as == "deadband 10 % of the vector, at least 0.017 N"
        report = hapfmt.verify(stream.getvalue(), against=recording)
        assert not any(check.broken for check in report.contracts)


class TestPaper:
    def test_the_threshold_of_10_mn_is_for_forces(self):
        """A position of 10 mm in metres was wrong by a quarter of a millimetre, whatever b is."""
        settings = Settings.of("paper", bits=8, smallest=False)
        assert promise_of(counted(PUSH, "mN"), settings).floor.value == 10
        x = 0.01 * np.sin(7 * T)
        decision, _ = decided(doubles(x, "m"), settings)
        assert "the paper's 10 mN is for forces only" in decision.reason
        assert decision.largest_error < 0.002 * np.ptp(x)

    @pytest.mark.parametrize("bits", [8, 10, 12])
    def test_a_step_of_few_counts_is_not_rounded_up(self, bits):
        """Rounding 1.1 counts up to 2 lost 5 dB."""
        x = np.rint(30 * NOISE + 500 * PUSH) / 1000
        settings = Settings.of("paper", bits=bits, smallest=False, floor=0.05)
        _, back = decided(counted(x, "N"), settings)
        residual = x - hapfmt_slow(x, settings)
        step = np.abs(residual).max() / (2 ** (bits - 1) - 1)
        rms = float(np.sqrt(((x - back.samples()) ** 2).mean()))
        assert 20 * np.log10(rms / (step / 12**0.5)) < 0.7


def hapfmt_slow(x: np.ndarray, settings: Settings) -> np.ndarray:
    """The decoded slow part of a channel of counts."""
    stream = io.BytesIO()
    hapfmt.write(Recording((counted(x, "N"),)), stream, settings)
    return hapfmt.read(stream.getvalue(), band="lf").channels[0].samples()


@cache
def recorded_parts(every: int, size: int, count: int) -> list[tuple[str, Recording, int]]:
    """The start of each recording, or of every third, and its size where nothing is lost."""
    parts = []
    for path in sorted(DATA.rglob("*.npz"))[::every]:
        recording = hapfmt.read(path)
        some = tuple(c.slice_ticks(0, size) for c in recording.channels[:count])
        part = replace(recording, channels=some)
        parts.append((path.name, part, size_of(part, Settings())))
    return parts


@pytest.mark.skipif(compiled is None, reason="slow without the extension, with the same bytes")
@pytest.mark.filterwarnings("ignore:no channel is known to be felt")
@pytest.mark.filterwarnings("ignore:max_error does nothing for .*. no step is known")
class TestLaw:
    """No lossy output is larger than the lossless one."""

    @given(recordings(), st.sampled_from(LOSSY), st.sampled_from(["N", "m", "s", "m/s2", "1"]))
    def test_any_recording(self, recording, asked, unit):
        channels = tuple(replace(channel, unit=unit) for channel in recording.channels)
        recording = replace(recording, channels=channels)
        assert size_of(recording, Settings.of(**asked)) <= size_of(recording, Settings())

    @given(
        st.integers(0, 2**32),
        st.sampled_from([3, 40, 900, 5000]),
        st.sampled_from([1, 3]),
        st.sampled_from(["noise", "walk", "sine", "same", "steps"]),
        st.sampled_from(LOSSY),
        st.sampled_from(["fast", "default", "best"]),
    )
    def test_any_signal(self, seed, size, count, shape, asked, effort):
        rng = np.random.default_rng(seed)
        base = rng.normal(size=size)
        made = {
            "noise": lambda: rng.normal(size=size),
            "walk": lambda: rng.normal(size=size).cumsum(),
            "sine": lambda: np.sin(np.arange(size) * rng.uniform(0.01, 1)),
            "same": lambda: base,
            "steps": lambda: np.round(rng.normal(size=size).cumsum() / 5),
        }[shape]
        make = counted if seed % 2 else doubles
        recording = Recording(tuple(make(made(), "N", label=str(i)) for i in range(count)))
        effort = "default" if asked["preset"] == "paper" else effort
        lossy = size_of(recording, Settings.of(**asked, effort=effort))
        assert lossy <= size_of(recording, Settings(effort=effort))

    @pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data")
    @pytest.mark.parametrize("asked", LOSSY, ids=lambda asked: " ".join(map(str, asked.values())))
    @either("parts", (5, 1500, 3), deep=(1, 3000, 4))
    def test_recorded(self, asked, parts):
        for name, part, largest in recorded_parts(*parts):
            assert size_of(part, Settings.of(**asked)) <= largest, name

    def test_it_is_said(self):
        channel = counted(np.round(T * 7) % 2, "N")
        decision, back = decided(channel, Settings.of("paper", bits=16))
        assert decision.kept_as == "lossless" and "smaller than a lossy form" in decision.reason
        assert np.array_equal(back.stored, channel.stored)


WIDE = np.arange(1, 4)[:, None] * (2 + PUSH + 0.1 * NOISE)
KEPT: dict[str, Recording] = {
    "doubles": Recording((doubles(PUSH + 2 + 0.1 * NOISE, "N"), doubles(NOISE, "m"))),
    "counts": Recording((counted(PUSH + 2 + 0.1 * NOISE, "N"), counted(NOISE, "Cel"))),
    "vector": Recording(tuple(
        counted(x + 0.05 * NOISE[::-1], "N", axis=axis, group="tip", label=axis)
        for x, axis in zip(WIDE, "xyz", strict=True)
    )),
    "references": Recording(tuple(counted(x, "N") for x in WIDE)),
    "linear": Recording((*map(doubles, WIDE), doubles(WIDE[0] + WIDE[1]))),
    "slow": Recording((Channel.from_physical(PUSH[:300], 30, unit="N"), )),
    "silent": Recording((counted(0.003 * NOISE.clip(-3, 3), "N"), counted(0 * T + 1, "N"))),
    "words": Recording((
        replace(doubles(PUSH, "N"), stored=PUSH.astype(np.float32)),
        Channel(np.arange(4000, dtype=np.int64) << 40, Fraction(1000)),
    )),
    "others": Recording((counted(np.rint(T), "s"), counted(T > 2), counted(PUSH[:0], "N"))),
    "odd": Recording((doubles(np.where(T == 1, 1e3, PUSH), "N", lsb=0.001),)),
}  # fmt: skip
ASKED: dict[str, list[dict[str, object]]] = {
    "lossless": [{}, {"fast": True}, {"effort": "best"}],
    "near-lossless": [
        {}, {"max_error": "2lsb"}, {"references": False},
        {"max_error": "0.01", "force_error": True, "tolerance": 0.001},
    ],
    "perceptual": [
        {}, {"quality": "low"}, {"quality": "high"}, {"snr": 12.5}, {"bitrate": 40.0}, {"k": 0},
        {"floor": "20mN"}, {"synthetic_texture": True}, {"texture_codec": "LPCR"},
        {"texture": False}, {"texture": False, "felt": "all"}, {"smallest": False},
        {"texture": False, "vectors": "required"},
    ],
    "paper": [{}, {"bits": 0}, {"bits": 0, "interpolation": "hold"}],
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::hapfmt.errors.DataWarning")
class TestKeptAs:
    """What encode prints of a channel is what info prints of the file later."""

    @pytest.mark.parametrize("preset", ASKED)
    @pytest.mark.parametrize("name", KEPT)
    @either("every", 6, deep=1)
    def test_encode_and_info_use_the_same_words(self, name, preset, every):
        """Each option with a sixth of the recordings, or with all."""
        asked = ASKED[preset]
        for options in asked[[*KEPT].index(name) % len(asked) % every :: every]:
            self.check(KEPT[name], preset, options)

    def check(self, recording: Recording, preset: str, options: dict[str, object]) -> None:
        stream = io.BytesIO()
        try:
            summary = hapfmt.write(recording, stream, preset=preset, **options)
        except ParameterError as error:
            if "would do nothing" in str(error) or "% of the range" in str(error):
                return
            raise
        catalogue = open_catalogue(open_source(stream.getvalue()))
        told = [each["kept_as"] for each in describe(catalogue)["channels"]]
        assert [each.kept_as for each in summary.decisions] == told
        report = hapfmt.verify(stream.getvalue(), against=recording)
        assert [each["kept_as"] for each in report.as_json()["contracts"]] == told
        for decision in summary.decisions:
            if decision.kept_as == "lossless":
                assert not decision.largest_error
            if decision.kept_as.startswith("within") and "aim" not in decision.kept_as:
                bound = float(decision.kept_as.split()[1])
                assert decision.largest_error <= 1.006 * bound
