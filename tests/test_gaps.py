"""A gap is no signal: samples on one side of it never change what comes out on the other side."""

from __future__ import annotations

import contextlib
import io
import sys
from fractions import Fraction

import numpy as np
import pytest
from commands import run
from depth import deep
from hypothesis import given, settings
from hypothesis import strategies as st
from rendering import joined, profile_of

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings, Span
from hapfmt.errors import ParameterError
from hapfmt.lab.compare import compare, pair_up
from hapfmt.lab.parts import RecordingParts
from hapfmt.lab.study.outputs import RATE_HZ, Scaling, signal
from hapfmt.lab.study.prepare import low_passed
from hapfmt.lab.views import Builder, survey
from hapfmt.metrics import band_energy_error_db, snr_hf_db, st_sim
from hapfmt.reading.reader import Reader
from hapfmt.replay.render import Assignment, Renderer, Route
from hapfmt.replay.render.feed import ChannelResampler

RATE = 1000
MILLI = Calibration(1, 0, 1000)
LONG, SHORT = 700, 520
"""Ticks before and after the gap."""


def side(seed: int, ticks: int, level: int, slope: int = 0) -> np.ndarray:
    """Counts of a press of ``level`` with a texture."""
    rng = np.random.default_rng(seed)
    t = np.arange(ticks)
    slow = level + slope * t / ticks + 300 * np.sin(2 * np.pi * 3 * t / RATE)
    fast = 60 * np.sin(2 * np.pi * 170 * t / RATE) + rng.normal(0, 15, ticks)
    return np.round(slow + fast).astype(np.int32)


BEFORE, AFTER = side(1, LONG, 3000, 800), side(2, SHORT, 900, -1500)


def channel(before: np.ndarray, after: np.ndarray, gap: int) -> Channel:
    spans = (Span(0, before.size), Span(before.size + gap, before.size + gap + after.size))
    counts = np.concatenate([before, after]).astype(np.int32)
    return Channel(
        counts, Fraction(RATE), spans, calibration=MILLI, label="f", unit="N", quantity="force"
    )


def one(before: np.ndarray, after: np.ndarray, gap: int) -> Recording:
    return Recording((channel(before, after, gap),))


PRESETS = ("lossless", "near-lossless", "perceptual", "paper")
NAN = np.full(500, np.nan)
TABLES = {
    "csv": "time,x\n" + "".join(f"{tick / 1000:.3f},nan\n" for tick in range(NAN.size)),
    "npz": {"x": NAN, "rate": 1000.0},
    "parquet": {"time": np.arange(NAN.size) / 1000, "x": NAN},
}


class TestOnlyNan:
    """A channel without any number keeps its length: its samples are NaN, and no gap."""

    @pytest.mark.parametrize("preset", PRESETS)
    @pytest.mark.parametrize(
        "x",
        [NAN, NAN.astype(np.float32), np.ma.masked_all(NAN.size, np.int16)],
        ids=["doubles", "floats", "masked"],
    )
    @pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside another"])
    def test_arrays(self, preset, x, beside, tmp_path):
        fields = {"x": x, "y": np.sin(np.arange(NAN.size) / 9)} if beside else {"x": x}
        hapfmt.write(fields, tmp_path / "a.hapf", rate=1000, units="N", preset=preset)
        recording = hapfmt.read(tmp_path / "a.hapf")
        channel = recording.channels[0]
        assert len(channel) == channel.times().size == NAN.size
        assert np.array_equal(channel.to_numpy(), NAN, equal_nan=True)
        assert np.array_equal(recording.to_numpy()[0], NAN, equal_nan=True)

    @pytest.mark.parametrize("preset", PRESETS)
    @pytest.mark.parametrize("suffix", TABLES)
    def test_command_line(self, preset, suffix, tmp_path):
        table = TABLES[suffix]
        if suffix == "csv":
            (tmp_path / "in.csv").write_text(str(table))
        elif suffix == "npz":
            np.savez(tmp_path / "in.npz", **table)
        else:
            pytest.importorskip("pandas").DataFrame(table).to_parquet(tmp_path / "in.parquet")
        for words in (
            ["encode", f"in.{suffix}", "a.hapf", "--preset", preset],
            ["decode", "a.hapf", "out.csv"],
            ["decode", "a.hapf", "out.npz"],
        ):
            assert run(*words, cwd=tmp_path).returncode == 0
        assert len((tmp_path / "out.csv").read_text().splitlines()) == 1 + NAN.size
        with np.load(tmp_path / "out.npz") as arrays:
            assert np.array_equal(arrays["x"], NAN[None], equal_nan=True)

    @pytest.mark.filterwarnings("ignore:.* is stored without loss. it has infinite samples")
    def test_infinities_are_no_gaps(self, tmp_path):
        x = np.where(np.arange(NAN.size) < 100, np.inf, -np.inf)
        for preset in PRESETS:
            hapfmt.write(x, tmp_path / "a.hapf", rate=1000, units="N", preset=preset, force=True)
            assert np.array_equal(hapfmt.read(tmp_path / "a.hapf").to_numpy()[0], x)


WAYS = [
    ("lossless", {}),
    ("perceptual", {}),
    ("perceptual", {"texture": False}),
    ("perceptual", {"texture": False, "felt": "all"}),
    ("near-lossless", {"max_error": "20lsb"}),
    ("paper", {"bits": 2}),
    ("paper", {"bits": 0}),
    ("paper", {"step": "20lsb", "smallest": False}),
    ("paper", {"interpolation": "hold", "bits": 8, "smallest": False}),
]
SPLITS = [way for way in WAYS if way[0] == "paper" and way[1].get("bits") != 0]


def sides_of(recording: Recording, way: tuple[str, dict], band: str) -> list[bytes]:
    """What comes back before and after the gap, as physical values."""
    name, given_ = way
    out = io.BytesIO()
    hapfmt.write(recording, out, Settings.of(name, **given_), canonical=1)
    with Reader(out.getvalue()) as reader:
        try:
            (back,) = reader.read(band=band).channels
        except hapfmt.HapfmtError:
            return []  # no band of this name
    (original,) = recording.channels
    first, second = original.coverage
    dense = back.filled(0, second.stop)
    return [dense[: first.stop].tobytes(), dense[second.start :].tobytes()]


def bands_of(way: tuple[str, dict]) -> tuple[str, ...]:
    """Where the step of the residual is one for all of the channel, as large as its largest
    residual asks for, only the slow part can be compared."""
    name, given_ = way
    return ("lf",) if name == "paper" and given_.get("bits") else ("full", "lf")


def check_encoder(way: tuple[str, dict], gap: int) -> None:
    """One side in reverse has the same range, the same texture and other samples at the gap."""
    for band in bands_of(way):
        plain = sides_of(one(BEFORE, AFTER, gap), way, band)
        after_changed = sides_of(one(BEFORE, AFTER[::-1], gap), way, band)
        before_changed = sides_of(one(BEFORE[::-1], AFTER, gap), way, band)
        assert plain[:1] == after_changed[:1]
        assert plain[1:] == before_changed[1:]
        assert plain or (band == "lf" and way not in SPLITS)
        assert not plain or plain != after_changed != before_changed


@contextlib.contextmanager
def low_pass_across_gaps():
    """Low-passes that begin where the last call ended, as if there were no gap between."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("low_pass", "slow_for_telling"):
            true = getattr(sys.modules["hapfmt.split"], name)
            held: dict[str, np.ndarray] = {}

            def across(x, *given_, true=true, held=held, **more):
                x = np.asarray(x)
                tail = held.get("x")
                if tail is None or tail.shape[1:] != x.shape[1:]:
                    tail = x[:0]
                held["x"] = x[-200:]
                return true(np.concatenate([tail, x]), *given_, **more)[len(tail) :]

            for module in [m for n, m in sys.modules.items() if n.startswith("hapfmt.")]:
                if getattr(module, name, None) is true:
                    patch.setattr(module, name, across)
        yield


class TestEncoder:
    @pytest.mark.parametrize("gap", [1, 7, 400])
    @pytest.mark.parametrize("way", WAYS, ids=str)
    def test_each_side_is_coded_by_itself(self, way, gap):
        check_encoder(way, gap)

    @pytest.mark.parametrize("way", [SPLITS[0], *deep(SPLITS[1:])], ids=str)
    def test_a_low_pass_across_the_gap_is_found(self, way):
        with low_pass_across_gaps(), pytest.raises(AssertionError):
            check_encoder(way, 7)

    def test_a_recording_in_progress(self):
        """Blocks that come over the gap: what was before it does not matter, at any preset."""
        deadband = {"texture": False, "felt": "all", "floor": "20lsb"}
        for name, given_ in (("lossless", {}), ("perceptual", deadband)):

            def recorded(before, name=name, given_=given_):
                out = io.BytesIO()
                put = hapfmt.Input("f", RATE, "N", "force", calibration=MILLI)
                with hapfmt.Recorder(
                    out, [put], Settings.of(name, **given_), canonical=1
                ) as recorder:
                    recorder.write("f", before)
                    recorder.write("f", AFTER, before.size + 7)
                with Reader(out.getvalue()) as reader:
                    (back,) = reader.read().channels
                return back.filled()[before.size + 7 :].tobytes()

            assert recorded(BEFORE) == recorded(BEFORE[::-1]) == recorded(BEFORE // 2)


counts = st.integers(-2000, 2000)


class TestFilters:
    @given(st.lists(counts, min_size=3, max_size=60), st.lists(counts, min_size=3, max_size=60),
           st.integers(1, 30), st.sampled_from([5.0, 40.0, 300.0]))  # fmt: skip
    def test_the_low_pass_of_a_study(self, before, after, gap, cutoff):
        self.check_study(np.array(before), np.array(after), gap, cutoff)

    @staticmethod
    def check_study(before, after, gap, cutoff):
        plain = low_passed(channel(before, after, gap), cutoff).filled()
        alone = Channel(before.astype(np.int32), Fraction(RATE), calibration=MILLI, unit="N")
        assert low_passed(alone, cutoff).filled().tobytes() == plain[: before.size].tobytes()
        alone = Channel(after.astype(np.int32), Fraction(RATE), calibration=MILLI, unit="N")
        behind = plain[before.size + gap :]
        assert low_passed(alone, cutoff).filled().tobytes() == behind.tobytes()

    def test_a_low_pass_across_the_gap_is_found(self):
        with low_pass_across_gaps(), pytest.raises(AssertionError):
            self.check_study(BEFORE, AFTER, 7, 20.0)

    @settings(max_examples=30)
    @given(st.lists(counts, min_size=1, max_size=40), st.lists(counts, min_size=1, max_size=40),
           st.integers(1, 30), st.sampled_from([1000, 300, 44_100, 96_000, Fraction(1000, 3)]))  # fmt: skip
    def test_the_sound_of_a_study(self, before, after, gap, rate):
        """Rates above and below the card's, in ratios of small and of large numbers."""
        at = len(before) + gap
        spans = (Span(0, len(before)), Span(at, at + len(after)))

        def sound(first, second):
            numbers = np.array([*first, *second], np.int32)
            made = Channel(numbers, Fraction(rate), spans, calibration=MILLI, unit="N")
            return signal(made, Scaling(0.0, 1e-4))

        plain = sound(before, after)
        edge, behind = RATE_HZ * len(before) / Fraction(rate), RATE_HZ * at / Fraction(rate)
        ahead = np.arange(plain.size) < edge
        other = [900 - each for each in after]
        assert sound(before, other)[ahead].tobytes() == plain[ahead].tobytes()
        later = np.arange(plain.size) >= behind
        other = [900 - each for each in before]
        assert sound(other, after)[later].tobytes() == plain[later].tobytes()
        assert not plain[~ahead & ~later].any()

    @pytest.mark.parametrize("metric", [snr_hf_db, band_energy_error_db, st_sim])
    def test_metrics_take_no_gap(self, metric):
        """A measure with a filter is given one stretch; what is missing is not filled in."""
        whole = np.sin(np.arange(4000.0))
        gapped = whole.copy()
        gapped[2000:2007] = np.nan
        with pytest.raises(ParameterError, match="span by span"):
            metric(gapped, whole, 1000)


def with_damage(data: bytes, damaged: range) -> bytes:
    """The file with a flipped bit in each packet that starts within these ticks."""
    with Reader(data) as reader:
        tracks = dict.fromkeys(reader.catalogue.tracks, (0, 1 << 40))
        packets = [each for each in reader.packets(tracks) if each.start in damaged]
    assert packets
    out = bytearray(data)
    for each in packets:
        out[each.offset] ^= 0x5A
    return bytes(out)


def rendered(data: bytes, band: str, rate: int):
    with Reader(data) as reader:
        assignment = Assignment((Route(0, 0, Fraction(1)),))
        values, there = joined(
            Renderer(reader, profile_of(rate=rate, band=band), assignment).blocks()
        )
    return values[:, 0], there[:, 0]


class TestRenderer:
    @pytest.mark.parametrize("gap", [1, 7, 400])
    @pytest.mark.parametrize("rate", [100, 1000, 3000])
    @pytest.mark.parametrize("band", ["full", "lf", "hf"])
    def test_each_side_is_played_by_itself(self, band, rate, gap):
        """The other side may as well be lost."""
        self.check(band, rate, gap)

    @staticmethod
    def check(band, rate, gap):
        out = io.BytesIO()
        way = Settings.of("paper", bits=2) if band != "full" else Settings.of("lossless")
        hapfmt.write(one(BEFORE, AFTER, gap), out, way, canonical=1)
        data = out.getvalue()
        plain, there = rendered(data, band, rate)
        times = np.arange(plain.size) * Fraction(RATE, rate)
        ahead, later = there & (times < LONG), there & (times >= LONG + gap)
        assert ahead.any() and later.any() and not (there & ~ahead & ~later).any()
        for damaged, kept in (
            (range(LONG, LONG + gap + SHORT), ahead),
            (range(LONG), later),
        ):
            changed, there = rendered(with_damage(data, damaged), band, rate)
            assert there.tolist() == kept[: there.size].tolist()
            assert changed[kept[: there.size]].tobytes() == plain[kept].tobytes()

    @pytest.mark.parametrize("rate", [100, 3000])
    @pytest.mark.parametrize("band", ["full", "lf", "hf"])
    def test_a_resampler_across_the_gap_is_found(self, band, rate, monkeypatch):
        add = ChannelResampler.add

        def bridging(self, start, numbers, piece):
            if self.runs and self.runs[-1].stop < start:
                last = self.runs.pop()
                held = np.full(start - last.stop, last.values[-1])
                self.runs.append(last._replace(values=np.concatenate([last.values, held])))
            add(self, start, numbers, piece)

        self.check(band, rate, 7)
        monkeypatch.setattr(ChannelResampler, "add", bridging)
        with pytest.raises(AssertionError):
            self.check(band, rate, 7)


class TestViews:
    """What pictures and comparisons show of a texture."""

    @staticmethod
    def check_spectrum(gap):
        """Segments of a spectrum never hold a gap, so the order of both sides says nothing."""
        before, after = side(1, 1024, 3000, 500), side(2, 768, 900, -900)

        def density(first, second):
            (view,) = survey(RecordingParts(one(first, second, gap)))
            return view.spectra["full"].density()[1]

        assert np.allclose(density(after, before), density(before, after), rtol=1e-6, atol=0)

    @pytest.mark.parametrize("gap", [1, 7, 400])
    def test_spectrum(self, gap):
        self.check_spectrum(gap)

    def test_a_spectrum_across_the_gap_is_found(self, monkeypatch):
        def joined_runs(self, name, _channel, values):
            self.see_run(name, values)

        monkeypatch.setattr(Builder, "see", joined_runs)
        with pytest.raises(AssertionError):
            self.check_spectrum(7)

    @pytest.mark.parametrize("gap", [1, 7])
    def test_signal_to_noise_of_a_texture(self, gap):
        """It is that of the longest stretch, whatever comes after the gap."""
        noise = np.random.default_rng(3).integers(-5, 6, LONG)

        def ratio(after):
            original = one(BEFORE, after, gap)
            back = one(BEFORE + noise, after + 5, gap)
            parts = RecordingParts(original), RecordingParts(back)
            (found,), _ = compare(*parts, pair_up(*parts))
            return found.snr_hf_db

        alone = snr_hf_db(BEFORE / 1000, (BEFORE + noise) / 1000, RATE)
        assert ratio(AFTER) == pytest.approx(alone, rel=1e-12)
        assert ratio(AFTER) == ratio(AFTER[::-1]) == ratio(AFTER // 3)
