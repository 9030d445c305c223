"""Textures from a model: what the encoder makes of them, and that every program says so."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from commands import run
from hypothesis import given, settings
from hypothesis import strategies as st
from rendering import profile_of
from scipy.signal import butter, lfilter

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.codecs.noise import decode_within, encode_component
from hapfmt.codecs.predicted import SINES
from hapfmt.edit import subset
from hapfmt.encoder.encode import encode
from hapfmt.encoder.synthetic import (
    ORDERS,
    Intervals,
    TextureModel,
    best_order,
    burg,
    density_of,
    ends_of,
    envelope,
    errors_of,
    quantised,
    reflections,
)
from hapfmt.errors import ParameterError
from hapfmt.format.source import BytesSource
from hapfmt.limits import LEVELS
from hapfmt.metrics import band_energy_error_db, texture_levels_db
from hapfmt.reading.decoder import TrackDecoder
from hapfmt.reading.dump import dump
from hapfmt.reading.reader import Reader
from hapfmt.reading.verifier import verify
from hapfmt.replay.render import Renderer, assign
from hapfmt.split import low_pass

RATE = 1000
DATA = Path(__file__).parents[2] / "shared" / "data"
FINE = Calibration(1, 0, 10_000)
SYNTHETIC = Settings.of("perceptual", synthetic_texture=True, smallest=False)
COEFFICIENTS = (1.2, -0.9, 0.1)


def texture(seconds: float = 8.0, seed: int = 1) -> np.ndarray:
    """Coloured noise whose loudness follows a slow stroke."""
    n = int(seconds * RATE)
    noise = np.random.default_rng(seed).normal(size=n)
    x = lfilter([1], [1, *(-c for c in COEFFICIENTS)], noise)
    return 0.05 * x * (1 + 0.5 * np.sin(np.arange(n) / 700))


def force(x: np.ndarray | None = None) -> np.ndarray:
    x = texture() if x is None else x
    return 3 + np.sin(np.arange(x.size) / 900) + x


def channel(x: np.ndarray, **given) -> Channel:
    counts = np.rint(x / float(FINE.step)).astype(np.int32)
    given = {"label": "fz", "unit": "N"} | given
    return Channel(counts, RATE, calibration=FINE, **given)


def written(*channels: Channel, settings: Settings = SYNTHETIC) -> bytes:
    stream = io.BytesIO()
    hapfmt.write(Recording(channels), stream, settings, canonical=1)
    return stream.getvalue()


@pytest.fixture(scope="module")
def data() -> bytes:
    return written(channel(force()), channel(force()[:100] * 0 + 1, label="still"))


def noise_packets(settings: Settings = SYNTHETIC, *channels: Channel) -> list[tuple]:
    """Tracks of NOIS and their packets."""
    made = encode(Recording(channels or (channel(force()),)), settings)
    return [(made.tracks[p.track], p) for p in made.packets if made.tracks[p.track].synthetic]


class TestModel:
    @given(st.integers(0, 2**32), st.sampled_from([(0.5,), (1.6, -0.9), COEFFICIENTS]))
    def test_burg_finds_the_filter_of_a_signal(self, seed, coefficients):
        noise = np.random.default_rng(seed).normal(size=4000)
        x = lfilter([1], [1, *(-c for c in coefficients)], noise)
        errors = errors_of(x, 0, x.size, quantised(burg(x, len(coefficients))))
        assert abs(errors[10:].std() - noise[10:].std()) < 0.05

    def test_burg_of_silence(self):
        assert not burg(np.zeros(100), 8).any()
        assert burg(np.ones(3), 8).size == 8

    def test_errors_are_those_of_the_lattice(self):
        """The direct form is what the filter of SPEC 9.10 undoes."""
        ks = [100, -80, 30, -5]
        x = np.random.default_rng(2).normal(size=300)
        e = errors_of(x, 0, x.size, ks)
        g = np.zeros(4)
        for now, error in zip(x, e, strict=True):
            f, h = error, g.copy()
            for j in range(3, -1, -1):
                k = (SINES[ks[j]] if ks[j] >= 0 else -SINES[-ks[j]]) / 32768
                f += k * g[j]
                if j < 3:
                    h[j + 1] = g[j] - k * f
            h[0] = f
            g = h
            assert abs(f - now) < 1e-9

    def test_errors_go_on_from_the_block_before(self):
        x, ks = texture(1.0), [90, -60]
        whole = errors_of(x, 0, x.size, ks)
        assert np.allclose(whole[400:700], errors_of(x, 400, 700, ks))

    @pytest.mark.parametrize("rate", [10, 100, 240, 1000, 2200, 8000, 51_200, 1e6])
    def test_intervals(self, rate):
        found = Intervals.of(rate)
        found.parameters.parse(found.parameters.build(), 0)
        if 200 <= rate <= 40_000:
            assert 0.04 < found.ticks / rate < 0.1
            assert 0.5 < found.block_ticks / rate < 2

    def test_the_order_is_enough(self):
        """Of a filter of three coefficients the least is taken; of a comb more."""
        intervals = Intervals.of(RATE)
        assert best_order([reflections(texture(), intervals, ORDERS[-1])]) == ORDERS[0]
        comb = lfilter([1], [1, *[0] * 19, 0.95], np.random.default_rng(3).normal(size=8000))
        assert best_order([reflections(comb, intervals, ORDERS[-1])]) == 20
        assert best_order([reflections(np.zeros(900), intervals, ORDERS[-1])]) == 0

    def test_single_impulses_make_pulses(self):
        rng = np.random.default_rng(5)
        assert density_of(rng.normal(size=9000)) == 0
        assert density_of(np.zeros(0)) == 0
        clicks = rng.normal(size=9000) * (rng.random(9000) < 0.05)
        assert 8 <= density_of(clicks) <= 20

    @pytest.mark.parametrize("size", [1, 2, 63, 64, 65, 200, 1000])
    def test_gains_of_any_length(self, size):
        intervals = Intervals.of(RATE)
        ends = ends_of(np.full(size, 3.0), intervals)
        assert ends.size == intervals.parameters.interval_count(size)
        assert np.allclose(ends, 3) and np.allclose(envelope(ends, intervals, size), 3)


def decoded_noise(x: np.ndarray, order: int) -> np.ndarray:
    """The texture that a model of x gives."""
    intervals = Intervals.of(RATE)
    made = TextureModel.of(x, reflections(x, intervals, order), order, intervals)
    data = made.packet(0.0, 0, 7)
    return decode_within(data, intervals.parameters, x.size, 1, 0, -(2**31), 2**31 - 1)[:, 0]


@pytest.mark.parametrize("order", [8, 16, 32])
def test_a_model_has_the_power_and_the_bands_of_its_texture(order):
    x = texture(10.0, seed=order) / float(FINE.step)
    y = decoded_noise(x, order)
    assert abs(20 * np.log10(y.std() / x.std())) < 1
    error = band_energy_error_db(x, y, RATE)
    assert error <= band_energy_error_db(x[: -RATE // 2], x[RATE // 2 :], RATE)
    assert decoded_noise(x, 0).std() > 0 and error < band_energy_error_db(
        x, decoded_noise(x, 0), RATE
    )


class TestFiles:
    def test_lines_and_noise(self, data):
        """NOI-001: A track of codec `NOIS` MUST be of kind full band or HF, and have no contract."""
        with Reader(data) as reader:
            tracks = reader.catalogue.tracks
            assert [(t.kind, t.codec) for t in tracks.values()] == [
                ("lf", "KNOT"), ("full", "KNOT"), ("hf", "NOIS"),
            ]  # fmt: skip
            assert tracks[2].contract is None and tracks[0].contract is not None
            assert not tracks[0].contract.guaranteed
        assert len(data) < 1500

    def test_the_slow_part_keeps_its_deadband(self, data):
        x = channel(force()).samples()
        slow = low_pass(x, RATE)
        d = hapfmt.read(data, band="lf")[0].samples()
        allowed = np.maximum(0.1 * np.abs(slow), 0.002 * np.ptp(x))
        assert (np.abs(d - slow) <= allowed + float(FINE.step)).all()
        y = hapfmt.read(data)[0].samples()
        assert np.abs(low_pass(y - d, RATE)[200:-200]).max() < 0.1

    def test_band_energies(self, data):
        x, y = channel(force()).samples(), hapfmt.read(data)[0].samples()
        own = band_energy_error_db(x[: -RATE // 2], x[RATE // 2 :], RATE)
        assert band_energy_error_db(x, y, RATE) < own
        assert not np.array_equal(x, y)

    def test_the_same_bytes_each_time(self, data):
        again = written(channel(force()), channel(force()[:100] * 0 + 1, label="still"))
        assert again == data

    def test_a_channel_without_texture_has_no_noise(self):
        calm = channel(3 + np.sin(np.arange(8000) / 900))
        with Reader(written(calm)) as reader:
            assert [t.codec for t in reader.catalogue.tracks.values()] == ["KNOT"]

    def test_silent_stretches_stay_silent(self):
        x = texture()
        x[2000:5000] = 0
        data = written(channel(force(x)))
        y = hapfmt.read(data)[0].samples() - hapfmt.read(data, band="lf")[0].samples()
        assert not y[2300:4700].any()
        assert y[1000:1800].std() > 0.03 and y[5600:6500].std() > 0.03

    def test_gaps_and_several_clusters(self):
        x = force(texture(12.0))
        x[3000:3500] = np.nan
        given = Channel.from_physical(x, RATE, label="fz", unit="N")
        data = written(given, settings=replace(SYNTHETIC, cluster=Fraction(2)))
        back = hapfmt.read(data)[0]
        assert back.coverage == given.coverage
        assert verify(data).exit_code == 0
        packets = noise_packets(replace(SYNTHETIC, cluster=Fraction(2)), given)
        assert len({packet.data[2:6] for _, packet in packets}) == len(packets) > 5

    def test_counts_do_not_leave_the_range_of_the_recording(self, data):
        with Reader(data) as reader:
            track = reader.catalogue.tracks[0]
        y = hapfmt.read(data)[0].stored
        assert track.count_min <= y.min() and y.max() <= track.count_max

    def test_a_smaller_lossless_form_is_kept(self):
        few = channel(np.tile([0.0, 0.5, 1.0, 0.5, 0.25], 40) + 3)
        data = written(few, settings=replace(SYNTHETIC, smallest=True))
        back = hapfmt.read(data)[0]
        assert back.synthetic or np.array_equal(back.samples(), few.samples())


class TestSettings:
    def test_words_of_the_command_line(self):
        assert SYNTHETIC.describe() == "perceptual --synthetic-texture"

    @pytest.mark.parametrize(
        ("preset", "given", "why"),
        [
            ("lossless", {}, "requires preset perceptual"),
            ("paper", {}, "requires preset perceptual"),
            ("perceptual", {"texture": False}, "not both"),
            ("perceptual", {"snr": 20.0}, "has no snr"),
            ("perceptual", {"quality": "low"}, "has no quality"),
            ("perceptual", {"bitrate": 4.0}, "has no bitrate"),
        ],
    )
    def test_what_does_not_go_together(self, preset, given, why):
        with pytest.raises(ParameterError, match=why):
            Settings.of(preset, synthetic_texture=True, **given)


class TestLabels:
    def test_info(self, data, tmp_path):
        """NOI-002: A program that describes, converts or plays a channel with such a track MUST call its texture synthetic."""
        (tmp_path / "x.hapf").write_bytes(data)
        text = run("info", "x.hapf", cwd=tmp_path).stdout.decode()
        assert "slow part deadband 10" in text and "synthetic texture" in text
        found = json.loads(run("info", "x.hapf", "--json", cwd=tmp_path).stdout)
        assert [each["synthetic"] for each in found["channels"]] == [True, False]

    def test_encode(self, tmp_path):
        hapfmt.write(Recording((channel(force()),)), tmp_path / "x.hapf")
        done = run("encode", "x.hapf", "y.hapf", "--preset", "perceptual", "--synthetic-texture",
                   cwd=tmp_path)  # fmt: skip
        assert done.returncode == 0
        text = done.stdout.decode()
        assert "slow part deadband 10 %" in text and "an aim, synthetic texture" in text

    def test_dump(self, data):
        """NOI-002: A program that describes, converts or plays a channel with such a track MUST call its texture synthetic."""
        tracks = [track for entry in dump(BytesSource(data))
                  for track in entry.get("tracks", ())]  # fmt: skip
        assert [track["synthetic"] for track in tracks] == [False, False, True]

    def test_channels(self, data):
        assert [each.synthetic for each in hapfmt.read(data).channels] == [True, False]
        assert not hapfmt.read(data, band="lf")[0].synthetic
        assert hapfmt.read(data, band="hf")[0].synthetic
        assert "synthetic texture" in repr(hapfmt.read(data)[0])

    @pytest.mark.skipif(not find_spec("xarray"), reason="xarray is not installed")
    def test_xarray(self, data):
        dataset = hapfmt.read(data).to_xarray()
        assert dataset["fz"].attrs["texture"] == "synthetic"
        assert "texture" not in dataset["still"].attrs

    def test_convert(self, data):
        """NOI-002: A program that describes, converts or plays a channel with such a track MUST call its texture synthetic."""
        notes = hapfmt.save(hapfmt.read(data), io.BytesIO(), format="csv")
        assert any("texture of fz is synthetic" in each for each in notes)

    def test_replay(self, data):
        """NOI-002: A program that describes, converts or plays a channel with such a track MUST call its texture synthetic."""
        profile = profile_of()
        with Reader(data) as reader:
            assigned = assign(reader, profile, by_order=True, ignore=["still"])
            notes = Renderer(reader, profile, assigned).notes
        assert "channel fz has a synthetic texture" in notes


class TestAfterwards:
    def test_verify_against_the_original(self, data):
        """DBC-004: A channel without a contract MUST be stored without loss: its full band equals the counts, the raw numbers, or with exact values (9.7) the numbers of the source."""
        original = Recording((channel(force()), channel(force()[:100] * 0 + 1, label="still")))
        report = verify(data, against=original)
        assert report.exit_code == 0
        check = report.contracts[0]
        assert check.synthetic and check.outside and not check.broken and not check.promised
        assert "the texture is synthetic" in report.bounds()

    def test_verify_prints_it(self, data, tmp_path):
        (tmp_path / "x.hapf").write_bytes(data)
        hapfmt.write(
            Recording((channel(force()), channel(force()[:100] * 0 + 1, label="still"))),
            tmp_path / "original.hapf",
        )
        done = run("verify", "x.hapf", "--against", "original.hapf", cwd=tmp_path)
        assert done.returncode == 0 and "synthetic texture" in done.stdout.decode()

    @pytest.mark.parametrize("band", ["lf", "hf"])
    def test_one_band_is_a_valid_file(self, data, band):
        out = io.BytesIO()
        subset(data, out, band=band)
        assert verify(out.getvalue()).exit_code == 0
        x = hapfmt.read(data, band=band)[0]
        found = hapfmt.read(out.getvalue())
        assert np.array_equal(found["fz"].stored, x.stored)
        assert found["fz"].synthetic == (band == "hf")

    def test_a_packet_may_move_in_time(self):
        """As files that are joined need it."""
        ((track, packet),) = noise_packets()
        decoder = TrackDecoder(track, LEVELS[1])
        later = replace(packet, start=packet.start + 12345)
        assert np.array_equal(decoder.decode(packet), decoder.decode(later))


LOUDNESS_DB, BAND_DB = 1.0, 5.0
"""How far the loudness may be off, and that of a band: noise of 4 s in 16 Hz varies by over 1 dB."""


def off_by(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    level, bands = texture_levels_db(x, y, RATE)
    return abs(level), max(abs(each.db) for each in bands)


class TestLoudness:
    """The decoded channel is as loud as the recorded one, whatever its unit and its grid."""

    @given(st.integers(-12, 12), st.sampled_from(["doubles", "lattice", "counts"]),
           st.integers(4, 9), st.integers(0, 2**32))  # fmt: skip
    @settings(max_examples=30, deadline=None)
    def test_at_any_scale(self, exponent, kind, digits, seed):
        scale, x = 10.0**exponent, force(texture(4.0, seed)) / 5
        digits = min(digits, exponent + 15)
        grid = Calibration(10 ** max(exponent - digits, 0), 0, 10 ** max(digits - exponent, 0))
        counts = np.rint(x * 10**digits).astype(np.int32)
        stored = {"doubles": x * scale, "lattice": grid.physical(counts), "counts": counts}[kind]
        given = Channel(
            stored, RATE, calibration=grid if kind == "counts" else None, unit="N", label="fz"
        )
        stream = io.BytesIO()
        options = {"preset": "perceptual", "synthetic_texture": True, "floor": "0.2%"}
        summary = hapfmt.write(Recording((given,)), stream, smallest=False, **options)
        back = hapfmt.read(stream.getvalue())[0]
        assert back.synthetic
        level, band = off_by(given.samples(), back.samples())
        assert level < LOUDNESS_DB
        assert band < BAND_DB
        decision = summary.decisions[0]
        assert abs(decision.level_db) == pytest.approx(level, abs=1e-6)
        assert abs(decision.band_db) == pytest.approx(band, abs=1e-6)

    @pytest.mark.parametrize("step", [1e-9, 1e-7, 1e-4])
    def test_from_the_command_line(self, step, tmp_path):
        x = np.rint(force() / 5 / step) * step
        np.savez(tmp_path / "a.npz", x=x, rate=RATE, unit="N", channel_names="fz")
        words = ("--preset", "perceptual", "--synthetic-texture", "--json")
        done = run("encode", "a.npz", "a.hapf", *words, cwd=tmp_path)
        (told,) = json.loads(done.stdout)["channels"]
        assert run("decode", "a.hapf", "b.npz", cwd=tmp_path).returncode == 0
        with np.load(tmp_path / "b.npz") as arrays:
            level, band = off_by(x, arrays["x"][0])
        assert level < LOUDNESS_DB
        assert band < BAND_DB
        assert abs(told["level_db"]) == pytest.approx(level, abs=1e-6)

    def test_a_band_that_a_model_cannot_have_is_named(self, tmp_path):
        """A gap of an octave in the spectrum at a rate of 5 kHz needs more than 32 coefficients."""
        rng, rate = np.random.default_rng(1), 5000
        x = lfilter(*butter(6, [200, 300], "bandpass", fs=rate), rng.normal(size=4 * rate))
        np.savez(tmp_path / "a.npz", x=1 + x, rate=rate, unit="N", channel_names="fz")
        words = ("--preset", "perceptual", "--synthetic-texture")
        done = run("encode", "a.npz", "a.hapf", *words, cwd=tmp_path)
        text = (done.stdout + done.stderr).decode()
        assert re.search(r"fz: the synthetic texture is \d+\.\d dB louder at \d+ to \d+ Hz", text)
        assert re.search(r"level [+-]\d\.\d dB", text)

    @pytest.mark.parametrize("name", ["T1", "T3"])
    def test_recordings(self, name):
        found = sorted(DATA.glob(f"**/{name}_acc.npz"))
        if not found:
            pytest.skip("the recordings of ../shared/data are not here")
        recording = hapfmt.read(found[0])
        stream = io.BytesIO()
        options = {"preset": "perceptual", "synthetic_texture": True, "felt": "all"}
        hapfmt.write(recording, stream, **options)
        level, band = off_by(recording[0].samples(), hapfmt.read(stream.getvalue())[0].samples())
        assert level < LOUDNESS_DB
        assert band < BAND_DB


def test_an_empty_packet_is_silence():
    parameters = Intervals.of(RATE).parameters
    assert encode_component([0, 0, 0], [[1, 2]], parameters, seed=1) == b""
