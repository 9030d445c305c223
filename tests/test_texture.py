"""The quality of textures: each target is met, by each way to code one, as a decoder hears it."""

from __future__ import annotations

import io
import json
import re
import sys
from dataclasses import replace
from fractions import Fraction
from functools import cache, partial
from math import inf
from pathlib import Path

import numpy as np
import pytest
from commands import run_in_terminal
from depth import deep, either
from hypothesis import given
from hypothesis import strategies as st
from terminal import called

import hapfmt
from hapfmt import Calibration, Channel, ParameterError, Recording, Settings
from hapfmt.encoder.bitrate import fill
from hapfmt.encoder.effort import EFFORTS
from hapfmt.encoder.encode import Decision
from hapfmt.encoder.felt import FeltChannel
from hapfmt.encoder.plan import Promise
from hapfmt.encoder.quality import NoiseMeasure, has_similarity
from hapfmt.encoder.settings import CLOSE, TextureQuality, Tolerance
from hapfmt.encoder.source import InputBlock, cut
from hapfmt.encoder.texture import widest
from hapfmt.encoder.unit import decoded_pieces
from hapfmt.encoder.ways import CodedTrial, Way, ways_of
from hapfmt.errors import MissingExtraError
from hapfmt.kernels import compiled
from hapfmt.metrics import snr_db, snr_hf_db, snr_weighted_db, st_sim
from hapfmt.recording import Span
from hapfmt.split import slow_for_telling, split_text
from hapfmt.writing.writer import reached

pytestmark = pytest.mark.skipif(compiled is None, reason="minutes without the extension")

DATA = Path(__file__).parents[2] / "shared" / "data"
MILLI = Calibration(1, 0, 1000)


@cache
def texture(seed: int = 3, seconds: int = 4, rate: int = 1000) -> np.ndarray:
    """A force with noise whose power rises and falls."""
    rng = np.random.default_rng(seed)
    t = np.arange(seconds * rate) / rate
    noise = rng.normal(size=t.size)
    shaped = np.convolve(noise, np.hanning(max(rate // 200, 3)), "same")
    return 2 + np.sin(t) + 0.15 * (1.2 + np.sin(2 * t)) * shaped / shaped.std()


def counted(x: np.ndarray, rate: int = 1000, unit: str = "N", step: int = 1000) -> Channel:
    counts = np.rint(x * step).astype(np.int32)
    return Channel(counts, Fraction(rate), calibration=Calibration(1, 0, step), unit=unit)


def doubles(x: np.ndarray, rate: int = 1000, unit: str = "N") -> Channel:
    return Channel.from_physical(x, rate, unit=unit)


MAKE = {
    "counts": counted,
    "coarse counts": partial(counted, step=40),
    "doubles": doubles,
}


def decided(channel: Channel, **given: object) -> tuple[Decision, Channel, int]:
    """The decision, the channel as it comes back, verified, and bytes of the file."""
    recording, stream = Recording((channel,)), io.BytesIO()
    settings = Settings.of("perceptual", smallest=False, **given)
    summary = hapfmt.write(recording, stream, settings, canonical=1)
    assert hapfmt.verify(stream.getvalue(), against=recording).verdict == "intact"
    back = hapfmt.read(stream.getvalue()).channels[0]
    return summary.decisions[0], back, summary.file_size


def slow_keeps_deadband(x: np.ndarray, y: np.ndarray, rate: float, k: float = 0.1) -> bool:
    slow, error = (slow_for_telling(each[:, None], rate)[:, 0] for each in (x, y - x))
    return bool((np.abs(error) <= np.maximum(k * np.abs(slow), 0.002 * np.ptp(x)) * 1.01).all())


class TestTargets:
    @pytest.mark.parametrize("db", [5, 10, 20, 35])
    @pytest.mark.parametrize("make", ["counts", "doubles"])
    @pytest.mark.parametrize("rate", [1000, 8000])
    def test_snr(self, db: float, make: str, rate: int) -> None:
        channel = MAKE[make](texture(rate=rate), rate)
        decision, back, _ = decided(channel, snr=db, k=0.3)
        x, y = channel.samples(), back.samples()
        assert db <= snr_hf_db(x, y, rate) <= (1 + CLOSE) * db
        assert decision.snr_hf_db == pytest.approx(snr_hf_db(x, y, rate), abs=1e-6)
        assert decision.snr_db == pytest.approx(snr_db(x, y), abs=1e-6)
        assert decision.missed == "" and slow_keeps_deadband(x, y, rate, 0.3)

    @given(st.integers(0, 2**32), st.floats(4, 40), st.sampled_from(sorted(MAKE)))
    def test_snr_of_any_texture(self, seed: int, db: float, make: str) -> None:
        """It is never below the target; above it only for a reason that is given."""
        channel = MAKE[make](texture(seed, 2))
        decision, back, _ = decided(channel, snr=db)
        x, y = channel.samples(), back.samples()
        reached = inf if np.array_equal(x, y) else snr_hf_db(x, y, 1000.0)
        assert reached >= db - 1e-9
        assert (reached <= (1 + CLOSE) * db + 1e-9) == (decision.missed == "")
        assert slow_keeps_deadband(x, y, 1000.0)

    @pytest.mark.parametrize("wanted", [0.95, *deep([0.8, 0.98])])
    @pytest.mark.parametrize("make", ["counts", "doubles"])
    def test_st_sim(self, wanted: float, make: str) -> None:
        pytest.importorskip("vibromaf")
        channel = MAKE[make](texture())
        decision, back, _ = decided(channel, st_sim=wanted)
        found = st_sim(channel.samples(), back.samples(), 1000)
        assert wanted <= found <= (1 + CLOSE) * wanted
        assert decision.st_sim == pytest.approx(found, abs=1e-9) and decision.missed == ""

    def test_st_sim_is_that_of_the_longest_run(self) -> None:
        pytest.importorskip("vibromaf")
        x = texture()
        channel = replace(doubles(x), coverage=(Span(0, 500), Span(600, 4100)))
        _, back, _ = decided(channel, st_sim=0.9)
        found = st_sim(x[500:], back.samples()[500:], 1000)
        assert 0.9 <= found <= (1 + CLOSE) * 0.9

    def test_what_is_too_short_for_st_sim_keeps_the_usual_ratio(self) -> None:
        pytest.importorskip("vibromaf")
        assert not has_similarity(1087, Fraction(1000)) and has_similarity(1088, Fraction(1000))
        assert not has_similarity(10**6, Fraction(30))
        channel = doubles(texture()[:1000])
        decision, back, _ = decided(channel, st_sim=0.9)
        assert decision.st_sim is None and decision.missed == "too short for ST-SIM: 20 dB"
        assert 20 <= snr_hf_db(channel.samples(), back.samples(), 1000) <= 20.4

    def test_st_sim_needs_its_package(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "vibromaf", None)
        with pytest.raises(MissingExtraError, match=r"hapfmt\[metrics\]"):
            decided(doubles(texture()), st_sim=0.9)

    @pytest.mark.parametrize("kbps", [6, *deep([3, 12])])
    def test_bit_rate(self, kbps: float) -> None:
        """Of the whole file; what has no texture counts too."""
        channels = (
            doubles(texture(1)), counted(texture(2)),
            counted(np.cumsum(texture(4) - 2) / 100, unit="mm"),
        )  # fmt: skip
        recording, stream = Recording(channels), io.BytesIO()
        summary = hapfmt.write(recording, stream, preset="perceptual", bitrate=kbps, canonical=1)
        reached = 8 * len(stream.getvalue()) / 4 / 1000
        assert summary.file_size == len(stream.getvalue())
        assert (1 - CLOSE) * kbps <= reached <= kbps
        felt = [decision.snr_hf_db for decision in summary.decisions[:2]]
        assert max(felt) - min(felt) < 0.3 and summary.decisions[2].snr_hf_db is None

    def test_a_bit_rate_encodes_again_what_has_a_texture(self) -> None:
        """The same file comes from any number of threads, and from the ratio that was found."""
        recording = Recording((doubles(texture(1)), doubles(texture(2))))
        first, second = io.BytesIO(), io.BytesIO()
        for stream, threads in ((first, 1), (second, 2)):
            hapfmt.write(
                recording, stream, preset="perceptual", bitrate=5, canonical=1, threads=threads
            )
        assert first.getvalue() == second.getvalue()

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ({"snr": 20, "quality": "low"}, "give one of quality, snr, st_sim, bitrate"),
            ({"bitrate": 20, "st_sim": 0.9}, "give one of quality, snr, st_sim, bitrate"),
            ({"quality": "best"}, "the quality is one of low, medium, high"),
            ({"st_sim": 1}, "above 0 and below 1"),
            ({"st_sim": 0}, "above 0 and below 1"),
            ({"bitrate": 0}, "positive number of kbit/s"),
            ({"bitrate": inf}, "positive number of kbit/s"),
            ({"texture": False, "bitrate": 5}, "leaves no texture"),
            ({"texture": False, "quality": "low"}, "leaves no texture"),
        ],
    )
    def test_refused(self, given: dict[str, object], words: str) -> None:
        with pytest.raises(ParameterError, match=words):
            Settings.of("perceptual", **given)

    @pytest.mark.parametrize("name", ["quality", "st_sim", "bitrate"])
    def test_other_presets_refuse_them(self, name: str) -> None:
        value = {"quality": "low", "st_sim": 0.9, "bitrate": 5}[name]
        with pytest.raises(ParameterError, match=f"{name} requires preset perceptual"):
            Settings.of("near-lossless", **{name: value})

    def test_medium_is_the_default(self) -> None:
        channel, files = counted(texture()), []
        for asked in ({}, {"quality": "medium"}):
            stream = io.BytesIO()
            hapfmt.write(Recording((channel,)), stream, preset="perceptual", canonical=1, **asked)
            files.append(hapfmt.read(stream.getvalue()).channels[0].stored)
        assert np.array_equal(*files)


class TestLadder:
    @given(
        st.integers(0, 2**32),
        st.floats(0.003, 1),
        st.sampled_from(sorted(MAKE)),
        st.booleans(),
    )
    def test_higher_quality_is_never_smaller(
        self, seed: int, loud: float, make: str, pauses: bool
    ) -> None:
        x = texture(seed, 2)
        slow = slow_for_telling(x[:, None], 1000.0)[:, 0]
        x = slow + loud * (x - slow) * (np.arange(x.size) > 800 if pauses else 1)
        channel = MAKE[make](x)
        settings = [Settings.of("perceptual", quality=q) for q in ("low", "medium", "high")]
        low, medium, high = (
            hapfmt.write(Recording((channel,)), io.BytesIO(), each, canonical=1).payload_size
            for each in settings
        )
        assert low <= (1 + CLOSE) * medium + 8
        assert medium <= (1 + CLOSE) * high + 8

    @pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data")
    @either("parts", (24, 3000), deep=(1, 12000))
    def test_recorded(self, parts: tuple[int, int]) -> None:
        every, size = parts
        for path in sorted(DATA.rglob("*.npz"))[::every]:
            recording = hapfmt.read(path)
            some = tuple(c.slice_ticks(0, size) for c in recording.channels[:6])
            if all(c.rate_exact <= 40 for c in some):  # too slow for a texture
                continue
            part = replace(recording, channels=some)
            sizes = []
            for quality in ("low", "medium", "high"):
                stream = io.BytesIO()
                summary = hapfmt.write(
                    part, stream, preset="perceptual", quality=quality, felt="all", canonical=1
                )
                assert hapfmt.verify(stream.getvalue(), against=part).verdict == "intact"
                sizes.append(summary.file_size)
            low, medium, high = sizes
            assert low <= (1 + CLOSE) * medium and medium <= (1 + CLOSE) * high, path.name


class TestSilence:
    def pausing(self) -> tuple[np.ndarray, np.ndarray]:
        """A texture of 2 s in 10 s of smooth contact, whose noise is below the threshold."""
        t = np.arange(10_000) / 1000
        smooth = 2 + np.sin(t)
        noise = np.random.default_rng(8).normal(size=t.size)
        loud = (t > 4) & (t < 6)
        return smooth + np.where(loud, 0.05 * noise, 0.001 * noise.clip(-3, 3)), loud

    @pytest.mark.parametrize("make", ["counts", "doubles"])
    def test_silent_stretches_take_next_to_nothing(self, make: str) -> None:
        """Their noise is below the threshold, and once was coded: 2.5 times the size."""
        x, loud = self.pausing()
        decision, back, size = decided(
            MAKE[make](x, step=10_000) if make == "counts" else doubles(x)
        )
        _, _, alone = decided(doubles(x[loud]))
        assert decision.snr_hf_db == pytest.approx(20, abs=0.5)
        assert size < 1.25 * alone
        e = (back.samples() - x)[loud]
        fast = (x - slow_for_telling(x[:, None], 1000.0)[:, 0])[loud]
        assert 19.9 < 10 * np.log10(fast.var() / (e @ e / e.size)) < 20.5
        assert slow_keeps_deadband(x, back.samples(), 1000.0)

    def test_a_stated_ratio_keeps_them(self) -> None:
        """With --snr the ratio is that of all samples."""
        x, _ = self.pausing()
        _, back, size = decided(doubles(x), snr=20)
        assert 20 <= snr_hf_db(x, back.samples(), 1000.0) <= 20.4
        assert size > decided(doubles(x))[2]

    def test_smooth_contact_has_no_texture(self) -> None:
        t = np.arange(4000) / 1000
        x = 3 * np.sin(t) ** 2 + 0.001 * np.random.default_rng(1).normal(size=t.size)
        for quality in ("low", "medium", "high"):
            decision, _, _ = decided(doubles(x), quality=quality)
            assert decision.missed == "no texture above the threshold"
            assert decision.snr_hf_db is None and 8 * decision.size < 0.2 * x.size


class TestWays:
    """Each way gives the samples that a decoder makes of its packets, and meets the target."""

    @staticmethod
    def felt(
        channel: Channel, target: TextureQuality, floor: float = 0.005
    ) -> tuple[FeltChannel, Promise]:
        promise = Promise(Tolerance(floor), Fraction(1, 10), target)
        spans = tuple(cut(channel.coverage, channel.rate_exact, Fraction(10), 1))
        source = InputBlock((channel,), channel.stored[:, None], spans)
        return FeltChannel.of(channel.samples(), source, promise, 20.0), promise

    @pytest.mark.parametrize("db", [3, 12, 30])
    @pytest.mark.parametrize("step", [40, 1000, 100_000])
    def test_all(self, db: float, step: int) -> None:
        channel = counted(texture(), step=step)
        felt, promise = self.felt(channel, TextureQuality(db))
        found = 0
        for way in ways_of(felt, channel, 0, promise, EFFORTS["best"]):
            trial = widest(way, felt)
            assert trial is not None
            noise = float(np.square(trial.samples - felt.x).mean())
            assert trial.noise is None or trial.noise == pytest.approx(noise, rel=0.06)
            unit = trial.code(None)
            assert unit is not None
            calibration = unit.channels[0].calibration
            y = calibration.physical(np.concatenate([p[:, 0] for p in decoded_pieces(unit)]))
            assert np.array_equal(y, trial.samples)
            assert felt.holds(y) and unit.size > 0
            assert way.costly or trial.code(unit.size // 2) is None
            found += 1
        assert found >= 4

    @pytest.mark.parametrize("loud", [0.01, 1])
    def test_the_error_follows_the_step(self, loud: float) -> None:
        """Also by MDCT. Where last coefficients became 0, the states of the quantiser were others
        than those of the decoder, and errors jumped by a third."""
        slow = slow_for_telling(texture()[:, None], 1000.0)[:, 0]
        channel = counted(slow + loud * (texture() - slow), step=20_000)
        felt, promise = self.felt(channel, TextureQuality(10), floor=0.001)
        for way in ways_of(felt, channel, 0, promise, EFFORTS["best"]):
            for _ in range(4):
                assert way.at(way.first) is not None  # classes and steps settle
            errors = [
                felt.measure.error(way.at(way.first * 1.01**k).samples) for k in range(-12, 13)
            ]
            assert max(abs(np.diff(np.log(errors)))) < 0.12

    @pytest.mark.parametrize("codec", ["LPCR", "MDCT"])
    def test_values_whose_own_grid_is_far_finer(self, codec):
        """Decimals of nine digits have 31-bit counts, too large for MDCT: a coarser grid does."""
        x = np.round(texture(), 9)
        recording, stream = Recording((doubles(x),)), io.BytesIO()
        settings = Settings.of("perceptual", snr=15, texture_codec=codec, smallest=False)
        hapfmt.write(recording, stream, settings, canonical=1)
        assert hapfmt.verify(stream.getvalue(), against=recording).verdict == "intact"
        with hapfmt.Reader(stream.getvalue()) as reader:
            assert codec in {track.codec for track in reader.catalogue.tracks.values()}
        y = hapfmt.read(stream.getvalue()).channels[0].samples()
        assert 15 <= snr_hf_db(x, y, 1000) <= 15 * (1 + CLOSE)

    def test_own_grid_of_few_values(self) -> None:
        """Differences of encoder counts: steps that are no multiples took 20 to 40 % more."""
        rng = np.random.default_rng(2)
        x = 0.0419 * np.rint(20 * np.sin(np.arange(8000) / 300) + rng.normal(size=8000) * 0.6)
        decision, back, _ = decided(doubles(x, 2000, "rad/s"))
        assert np.abs(back.samples() - x).max() < 1e-9 and decision.missed
        coarser, _, _ = decided(doubles(x + 1e-3 * rng.normal(size=8000), 2000, "rad/s"))
        assert decision.size < 0.9 * coarser.size

    def test_the_search_finds_the_widest_step(self) -> None:
        """Of an error that grows with a power of the step; also from far off, and with plateaus."""
        x = texture()
        channel = counted(x)
        felt, _ = self.felt(channel, TextureQuality(20), floor=0.05)
        assert isinstance(felt.measure, NoiseMeasure)
        noise = np.random.default_rng(1).normal(size=x.size)
        noise -= slow_for_telling(noise[:, None], 1000.0)[:, 0]
        noise /= np.sqrt(noise @ noise / noise.size)
        allowed = np.sqrt(felt.measure.allowed * felt.power)
        for power in (0.5, 1, 2, 3):
            for scale in (0.02, 1, 20):
                tried: list[float] = []

                def way(
                    step: float, power: float = power, right: float = scale * felt.first_step,
                    tried: list[float] = tried,
                ) -> CodedTrial:  # fmt: skip
                    tried.append(step)
                    e = allowed * (step / right) ** power
                    y = channel.samples() + e * noise
                    return CodedTrial(step, lambda: y, lambda _size: None)

                trial = widest(Way(way, felt.first_step), felt)
                assert trial is not None
                error = felt.measure.error(trial.samples)
                assert 0.985 * felt.measure.allowed <= error <= felt.measure.allowed
                assert len(tried) <= 14


class TestOneCodec:
    @pytest.mark.parametrize(("codec", "other"), [("LPCR", "MDCT"), ("MDCT", "LPCR")])
    def test_the_other_is_left_out(self, codec, other):
        recording, stream = Recording((counted(texture()),)), io.BytesIO()
        settings = Settings.of("perceptual", snr=15, texture_codec=codec, smallest=False)
        hapfmt.write(recording, stream, settings, canonical=1)
        with hapfmt.Reader(stream.getvalue()) as reader:
            codecs = {track.codec for track in reader.catalogue.tracks.values()}
        assert codec in codecs and other not in codecs

    @pytest.mark.parametrize("loud", [0.006, 0.02])
    def test_a_transform_where_the_threshold_decides(self, loud):
        """Either has to hold, errors below the threshold or the ratio. Once none was tried."""
        noise = np.random.default_rng(5).normal(size=4000)
        channel = counted(2 + np.sin(np.arange(4000) / 1000) + loud * noise, step=20_000)
        decision, back, _ = decided(channel, texture_codec="MDCT")
        assert decision.chosen == "transformed"
        x, y = channel.samples(), back.samples()
        below = decision.largest_error <= 0.002 * np.ptp(x)
        assert below == (loud < 0.01) and (below or snr_hf_db(x, y, 1000) >= 20)
        assert decision.missed == ("errors stay below the threshold" if below else "")

    def test_the_default_is_the_smaller(self):
        sizes = {
            codec: decided(counted(texture()), snr=15, texture_codec=codec)[2]
            for codec in (None, "LPCR", "MDCT")
        }
        assert sizes[None] <= min(sizes.values()) + 32  # the metadata name the option

    @pytest.mark.parametrize("given", [{"texture": False}, {"synthetic_texture": True}])
    def test_what_does_not_go_together(self, given):
        with pytest.raises(ParameterError, match="needs a texture that is coded"):
            Settings.of("perceptual", texture_codec="MDCT", **given)

    def test_unknown_codec(self):
        with pytest.raises(ParameterError, match="LPCR, MDCT"):
            Settings.of("perceptual", texture_codec="QUAN")


class TestWeighting:
    """Steps grow where people feel less, so that at one ratio the weighted ratio is larger."""

    @pytest.mark.parametrize("unit", ["N", "m/s2", "m/s"])
    def test_errors_move_to_where_they_are_not_felt(self, unit):
        x = texture()
        power = {"N": "acceleration", "m/s2": "acceleration", "m/s": "velocity"}[unit]
        found = {}
        for gamma in (0.0, 0.5):
            given = {"texture_codec": "MDCT", "weighting": gamma, "felt": ("all",)}
            decision, back, _ = decided(counted(x, unit=unit), snr=15, **given)
            assert decision.snr_hf_db == pytest.approx(15, rel=CLOSE)
            found[gamma] = snr_weighted_db(x, back.samples(), 1000, power)
        assert found[0.5] > found[0.0]

    def test_a_quantity_without_threshold_is_not_weighted(self):
        with pytest.raises(ParameterError, match=r"weighting would do nothing: .* for voltage"):
            decided(counted(texture(), unit="V"), weighting=0.5, felt=("all",))

    @pytest.mark.parametrize("gamma", [-0.1, 1.1, "0.25"])
    def test_range(self, gamma):
        with pytest.raises(ParameterError, match="exponent from 0 to 1"):
            Settings.of("perceptual", weighting=gamma)

    @pytest.mark.parametrize("given", [{"texture_codec": "LPCR"}, {"synthetic_texture": True}])
    def test_what_does_not_go_together(self, given):
        with pytest.raises(ParameterError, match="only MDCT weights"):
            Settings.of("perceptual", weighting=0.25, **given)


class TestFill:
    """The search for a size."""

    @given(
        st.floats(500, 5000), st.floats(0.3, 3), st.integers(5000, 10**6), st.booleans(),
        st.floats(0.01, 30),
    )  # fmt: skip
    def test_within_the_budget(
        self, rest: float, bits: float, samples: int, jump: bool, share: float
    ) -> None:
        """Sizes of 6 dB a bit, and a jump down where another way becomes the smaller."""

        def size_of(db: float) -> int:
            size = samples * np.log2(1 + 10 ** (db / 10)) / 16 * bits + rest
            return int(0.95 * size if jump and db > 25 else size)

        budget = rest + share * samples / 8
        best = fill(lambda db: db, size_of, budget)
        if size_of(0) > budget:
            assert best == 0
        else:
            assert size_of(best) <= budget
            assert size_of(best) >= (0.93 if jump else 0.98) * budget - 1 or best == 120

    def test_few_encodings(self) -> None:
        tried = []

        def size_of(db: float) -> int:
            tried.append(db)
            return int(1000 + 500 * db)

        assert fill(lambda db: db, size_of, 9000) == pytest.approx(15.8, abs=0.3)
        assert len(tried) <= 6


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("texture")
    hapfmt.save(
        {"thumb normal force": texture(1), "fx": texture(2)}, folder / "touch.npz", rate=1000,
        units="N",
    )  # fmt: skip
    return folder


class TestTold:
    """What the command line, JSON and metadata say."""

    def encoded(self, room: Path, *options: object) -> tuple[str, hapfmt.Recording]:
        target = room / "a.hapf"
        said = called(
            "encode", room / "touch.npz", target, "-f", "--preset", "perceptual", *options
        )
        assert said.code == 0, said.err
        return said.out, hapfmt.read(target)

    def test_the_table_shows_what_was_reached(self, room: Path) -> None:
        out, recording = self.encoded(room, "--snr", 15)
        lines = out.splitlines()
        assert lines[0].split()[-1] == "texture"
        assert all(line.endswith(("15.0 dB", "15.1 dB")) for line in lines[2:4])
        assert "another quality" not in out
        encoder = recording.metadata["encoder"]
        assert ": perceptual --snr 15.0 (texture 15" in encoder and encoder.endswith(" dB)")

    def test_exact_textures_are_no_number_of_decibels(self) -> None:
        """A texture that differs by rounding alone once made it "13.69 to 198 dB"."""
        stream = io.BytesIO()
        recording = Recording((doubles(texture()),))
        (known,) = hapfmt.write(recording, stream, preset="perceptual").decisions
        for decibels, words in (
            ([13.69, 198.0], "texture 13.69 dB, 1 exact"),
            ([198.0, 199.0], "texture exact"),
            ([13.69, 20.25, 198.0], "texture 13.69 to 20.25 dB, 1 exact"),
        ):
            decisions = [replace(known, snr_hf_db=each) for each in decibels]
            assert reached(decisions) == f" ({words})"

    @pytest.mark.parametrize("cutoff", [20, 35])
    def test_each_ratio_names_its_filter(self, room: Path, cutoff: int) -> None:
        """One wording: the filter decides what is above the split, and changes the figure."""
        out, _ = self.encoded(room, "--snr", 15, "--cutoff", cutoff)
        assert split_text(cutoff) in out and f"above {cutoff} Hz" in out
        verbose, _ = self.encoded(room, "--snr", 15, "-v")
        assert "dB over all frequencies" in verbose
        source, file = room / "touch.npz", room / "a.hapf"
        for words in (["info", file], ["compare", source, file], ["demo", "--seconds", "2"]):
            assert split_text() in called(*words).out
        for page in ("presets.md", "measuring.md"):
            assert "Bessel" in (Path(__file__).parents[1] / "docs" / page).read_text("utf-8")

    def test_metadata_of_a_second_encoding(self, room: Path) -> None:
        _, recording = self.encoded(room, "--quality", "low")
        stream = io.BytesIO()
        hapfmt.write(recording, stream, canonical=1)
        encoder = hapfmt.read(stream.getvalue()).metadata["encoder"]
        assert (
            f"{hapfmt.__version__}; input: hapfmt" in encoder
            and "perceptual --quality low" in encoder
        )

    def test_json(self, room: Path) -> None:
        out, _ = self.encoded(room, "--bitrate", 4, "--json")
        found = json.loads(out)
        assert 3.92 <= found["kbit_per_s"] <= 4
        for channel in found["channels"]:
            assert (
                channel["snr_hf_db"] > 1 and channel["st_sim"] is None and channel["missed"] == ""
            )

    def test_st_sim(self, room: Path) -> None:
        pytest.importorskip("vibromaf")
        out, recording = self.encoded(room, "--st-sim", 0.9)
        assert out.count("ST-SIM 0.9") == 2
        assert "ST-SIM 0.9" in recording.metadata["encoder"]

    def test_a_target_that_is_not_reached(self, room: Path) -> None:
        out, _ = self.encoded(room, "--snr", 300)
        assert "another quality than asked for: thumb normal force, fx: lossless is smaller" in out
        out, _ = self.encoded(room, "--bitrate", 0.1)
        assert "kbit/s, not 0.1: the rest of the file takes as much" in out
        out, _ = self.encoded(room, "--bitrate", 5000)
        assert "kbit/s, not 5000: textures have no more to gain" in out

    def test_refused_in_words_of_the_command_line(self, room: Path) -> None:
        words = ("encode", room / "touch.npz", room / "b.hapf", "--preset", "perceptual")
        said = called(*words, "--snr", 3, "--bitrate", 3)
        assert "give one of --quality, --snr, --st-sim, --bitrate" in said.err
        said = called(*words, "--no-texture", "--quality", "low")
        assert "--no-texture leaves no texture" in said.err
        said = called("encode", room / "touch.npz", room / "b.hapf", "--bitrate", 3)
        assert "--bitrate requires preset perceptual" in said.err

    @pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
    def test_in_80_columns(self, room: Path) -> None:
        words = ["encode", "touch.npz", "c.hapf", "-f", "--preset", "perceptual", "--snr", "15"]
        done = run_in_terminal(*words, cwd=room, columns=80)
        text = done.stdout.decode()
        assert done.returncode == 0, text
        assert "thumb normal force" in text and re.search(r"15\.[01] dB", text)
        assert split_text() in text
        assert max(map(len, text.splitlines())) <= 80
