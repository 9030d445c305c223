"""Recording -> file -> recording: what any input and any settings must keep."""

from __future__ import annotations

import io
from fractions import Fraction

import numpy as np
import pytest
from depth import either
from hypothesis import given
from hypothesis import strategies as st
from strategies import encoder_settings, idle_settings, recordings

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.codecs.knots import KnotParameters
from hapfmt.codecs.quantised import QuanParameters
from hapfmt.encoder.encode import encode
from hapfmt.encoder.settings import Tolerance
from hapfmt.encoder.source import cut, declared_range, held_range, share_lattice
from hapfmt.encoder.unit import choose_codebook
from hapfmt.format.track import build_track, chunks_of, round_up
from hapfmt.lab.scenes.stylus import simulate
from hapfmt.limits import LEVELS
from hapfmt.recording import Span

ONE_COUNT = Tolerance(1, "lsb")


def encoded(recording: Recording, settings: Settings | None = None) -> bytes:
    stream = io.BytesIO()
    hapfmt.write(recording, stream, settings, canonical=7)
    return stream.getvalue()


def force(counts: object, **described: object) -> Channel:
    values = np.asarray(counts, np.int32)
    return Channel(
        values, Fraction(1000), calibration=Calibration(1, 0, 1000), unit="N", **described
    )


def noise(size: int, width: int = 300, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).integers(-width, width, size)


@idle_settings
class TestAnyRecording:
    @given(recordings(), encoder_settings())
    def test_comes_back_and_keeps_its_promises(self, recording, settings):
        """DBC-002: With flag *guaranteed*, every sample MUST keep the contract: for each component `|x - y| * kd <= max(kn * |x - zero|, floor * kd)`. The vector form is the same with Euclidean norms over the components, compared by their squares, and the floor of the first component."""
        data = encoded(recording, settings)
        report = hapfmt.verify(data, against=recording)
        assert report.verdict == "intact", (report.error, report.findings)
        assert not any(check.broken for check in report.contracts)
        for before, after in zip(recording.channels, hapfmt.read(data).channels, strict=True):
            assert after.coverage == before.coverage
            assert after.rate == before.rate
            if settings.step == ONE_COUNT:
                assert after.samples().tobytes() == before.samples().tobytes()

    @given(recordings())
    def test_description_comes_back(self, recording):
        after = hapfmt.read(encoded(recording))
        for name in ("uuid", "epoch_ns", "epoch_uncertainty_ns", "attachments"):
            if name != "uuid" or recording.uuid:
                assert getattr(after, name) == getattr(recording, name)
        assert after.metadata == {**recording.metadata, "encoder": after.metadata["encoder"]}
        for a, b in zip(recording.channels, after.channels, strict=True):
            for name in ("label", "unit", "quantity", "axis", "group", "body_site", "device",
                         "calibration"):  # fmt: skip
                if name != "calibration" or a.is_counts:
                    assert getattr(a, name) == getattr(b, name)

    @given(recordings(), encoder_settings())
    def test_canonical_bytes(self, recording, settings):
        """WRT-002: A writer MUST choose the file id at random. In canonical mode the id is an input or follows from the content. No time of day, host, user or random number enters the file: the same input and settings give the same bytes with the same encoder version on the same machine."""
        assert encoded(recording, settings) == encoded(recording, settings)


def deadband(**given):
    """The deadband alone, for every channel, also where lossless is smaller."""
    return Settings.of("perceptual", texture=False, felt="all", smallest=False, **given)


class TestDeadband:
    @given(st.integers(0, 2**32), st.sampled_from([0.3, 1, 7, 40]), st.sampled_from([0, 2, 300]))
    def test_every_sample_within_the_floor(self, seed, floor, slope):
        x = noise(700, 30, seed) + np.arange(700) * slope // 10
        settings = deadband(k=0, floor=Tolerance(floor, "lsb"))
        y = hapfmt.read(encoded(Recording((force(x),)), settings)).channels[0].stored
        assert np.abs(x - y).max() <= int(floor)

    @either("size", 150, deep=400)
    @given(st.integers(0, 2**32))
    def test_vectors_by_their_norm(self, size, seed):
        columns = [noise(size, 200, seed + i) for i in range(3)]
        axes = tuple(force(c, axis=a, group="tip") for a, c in zip("xyz", columns, strict=True))
        settings = deadband(k=0, floor=Tolerance(9, "lsb"))
        back = hapfmt.read(encoded(Recording(axes), settings))
        e = np.column_stack([c.stored for c in back.channels]) - np.column_stack(columns)
        assert ((e**2).sum(axis=1) <= 81).all()

    def test_constant_and_empty_channels_cost_next_to_nothing(self):
        minutes = force(np.full(300_000, 5))
        made = encode(Recording((minutes, force([]))))
        assert sum(len(p.data) for p in made.packets) / 300_000 * 8 < 0.01
        assert [d.reason for d in made.decisions] == ["constant", "no samples"]


@pytest.mark.parametrize("axes", ["", "xyz"])
def test_silence_is_one_value_for_all(axes):
    """A channel that stays within the floor costs one packet, however long it is."""
    rows = [np.clip(noise(60_000, 9, seed), -4, 4) for seed in range(len(axes) or 1)]
    group = "tip" if axes else ""
    channels = [force(row, axis=axes[i : i + 1], group=group) for i, row in enumerate(rows)]
    recording = Recording(tuple(channels))
    coded = encode(recording, deadband(k=0, floor="20lsb"))
    # Knots of a vector are looked for cluster by cluster.
    assert len(coded.packets) == (3 if axes else 1)
    settings = deadband(k=0, floor="20lsb")
    report = hapfmt.verify(encoded(recording, settings), against=recording)
    assert report.verdict == "intact"
    assert report.contracts[0].contract.guaranteed


class TestPaper:
    @pytest.mark.parametrize("bits", [2, 5, 8])
    def test_levels_of_b_bits_and_error_within_half_a_step(self, bits):
        x = noise(3000, 500)
        made = encode(Recording((force(x),)), Settings.of("paper", bits=bits, smallest=False))
        parameters = QuanParameters.parse(made.tracks[1].parameters, LEVELS[1], 0)
        hf = hapfmt.read(
            encoded(Recording((force(x),)), Settings.of("paper", bits=bits, smallest=False)),
            band="hf",
        )
        times = hf.channels[0].calibration.d // 1000
        levels = hf.channels[0].stored // parameters.step
        most = 2 ** (bits - 1) - 1
        assert 0.9 * most <= np.abs(levels).max() <= most
        y = hapfmt.read(
            encoded(Recording((force(x),)), Settings.of("paper", bits=bits, smallest=False))
        )
        assert 2 * np.abs(times * x - y.channels[0].stored).max() <= parameters.step

    def test_residual_is_taken_against_the_decoded_lf_track(self):
        """WRT-003: An encoder MUST form the residual against the LF track as decoded, after its quantisation."""
        recording = Recording((force(noise(3000, 500) + 2000),))
        data = encoded(recording, Settings.of("paper", bits=5, smallest=False))
        made = encode(recording, Settings.of("paper", bits=5, smallest=False))
        assert KnotParameters.parse(made.tracks[0].parameters, LEVELS[1], 0).grid.step > 1
        step = QuanParameters.parse(made.tracks[1].parameters, LEVELS[1], 0).step
        d, e = (hapfmt.read(data, band=band).channels[0].stored for band in ("lf", "hf"))
        residual = recording.channels[0].stored.astype(int) - d
        assert (e == (2 * residual + step) // (2 * step) * step).all()

    def test_without_residual_the_contract_is_an_aim(self):
        made = encode(simulate("sand", 2.0), Settings.of("paper", bits=0))
        contract = made.tracks[0].contract
        assert contract is not None and not contract.guaranteed
        assert (contract.kn, contract.kd, contract.floor) == (1, 10, (20,))

    def test_doubles_go_on_a_lattice_far_below_the_floor(self):
        x = np.random.default_rng(1).normal(size=500)
        channel = Channel.from_physical(x, 1000, unit="N")
        made = encode(Recording((channel,)), Settings.of("paper"))
        declared, largest = made.tracks[0].components[0].deviation
        assert largest <= declared == round_up(0.01 / 32)


def test_missing_samples_are_never_stored():
    """WRT-004: An encoder MUST NOT store a value for a sample that its source marks as missing. NaN is such a mark in text and array files, but a value in a recording in memory."""
    x = np.array([1.0, np.nan, 2.0, 3.0, np.nan, np.nan, 4.0])
    back = hapfmt.read(encoded(Recording((Channel.from_physical(x, 10),))))
    assert back.channels[0].coverage == (Span(0, 1), Span(2, 4), Span(6, 7))
    assert np.array_equal(back.channels[0].filled(), x, equal_nan=True)


def test_words_keep_every_bit():
    x = np.frombuffer(bytes(range(256)), np.float64)
    nan = np.array([0x7FF8_0000_0000_BEEF], np.uint64).view(np.float64)
    words = Channel(np.concatenate([x, nan, [-0.0, np.inf, 5e-324]]), Fraction(1))
    back = hapfmt.read(encoded(Recording((words,)))).channels[0]
    assert back.stored.tobytes() == words.stored.tobytes()


def test_one_knot_clock_for_the_axes_of_a_vector():
    recording = simulate("sand", 1.0, axes=3)
    made = encode(recording, Settings.of("paper", smallest=False))
    assert [(t.kind, len(t.components)) for t in made.tracks] == [("lf", 3), ("hf", 3)]
    assert made.tracks[0].contract is None and made.tracks[1].contract.vector


@pytest.mark.parametrize("change", ["rate", "group", "axis", "coverage", "step"])
def test_what_is_no_vector_is_coded_apart(change):
    a = force(noise(40), axis="x", group="tip")
    other = {"rate": Fraction(999), "group": "palm", "axis": "x", "coverage": (Span(1, 41),),
             "step": Calibration(1, 0, 2**40 + 1)}[change]  # fmt: skip
    given = {"axis": "y", "group": "tip", change: other}
    calibration = given.pop("step", Calibration(1, 0, 1000))
    b = Channel(noise(40, seed=2).astype(np.int32), given.pop("rate", Fraction(1000)),
                given.pop("coverage", ()), calibration, unit="N", **given)  # fmt: skip
    made = encode(Recording((a, b)))
    assert {len(track.components) for track in made.tracks} == {1}


@given(
    st.lists(st.tuples(st.integers(-50, 50).filter(bool), st.integers(-99, 99),
                       st.integers(1, 60)), min_size=2, max_size=6)
)  # fmt: skip
def test_one_lattice_for_all_axes_keeps_every_value(terms):
    axes = [Channel(noise(30, seed=i), Fraction(1), calibration=Calibration(*t), axis=str(i),
                    group="g") for i, t in enumerate(terms)]  # fmt: skip
    try:
        shared = share_lattice(axes, axes)
    except hapfmt.ParameterError as error:
        assert "common measure" in error.message
        return
    assert len({abs(channel.calibration.step) for channel in shared}) == 1
    for before, after in zip(axes, shared, strict=True):
        assert before.samples().tobytes() == after.samples().tobytes()


def test_axes_that_were_rounded_are_rounded_anew_on_their_common_lattice():
    rng = np.random.default_rng(1)
    axes = tuple(
        Channel.from_physical(rng.normal(scale=scale, size=900), 1000, unit="N", axis=a, group="g")
        for a, scale in (("x", 1), ("y", 50))
    )
    settings = deadband(tolerance="1%", floor="0.5", k=0, vectors="required")
    data = encoded(Recording(axes), settings)
    report = hapfmt.verify(data, against=Recording(axes))
    assert report.verdict == "intact" and report.contracts[0].contract.vector
    assert all(0 < check.moved <= check.stated for check in report.contracts)


def test_a_vector_that_cannot_be_is_refused_where_it_is_asked_for():
    a = force(noise(40), axis="x", group="tip", label="fx")
    b = Channel.from_physical(np.random.default_rng(1).normal(size=40), 1000, axis="y", group="tip")
    with pytest.raises(hapfmt.ParameterError, match="cannot be one vector: they differ in unit"):
        encode(Recording((a, b)), deadband(vectors="required"))


@given(st.integers(0, 10**6), st.integers(1, 10**5), st.sampled_from([Fraction(1, 3), Fraction(10)]),
       st.sampled_from([Fraction(1000), Fraction(44100, 7), Fraction(1, 3600)]))  # fmt: skip
def test_packets_end_where_clusters_begin(start, ticks, cluster, rate):
    spans = cut([Span(start, start + ticks)], rate, cluster, 1)
    assert spans[0].start == start and spans[-1].stop == start + ticks
    assert all(a.stop == b.start for a, b in zip(spans, spans[1:], strict=False))
    for span in spans:
        assert span.start / rate // cluster == (span.stop - 1) / rate // cluster
        assert span.ticks <= 1 << 16


@pytest.mark.parametrize(
    ("rates", "settings", "seconds"),
    [
        (["8000"], Settings(), 10),
        (["1"], Settings(), 256),
        (["1/3600"], Settings.of("lossless"), 256 * 3600),
        (["1/3600", "8000"], Settings.of("paper"), 10),
        (["100"], Settings.of("lossless"), 120),
        (["1000"], Settings.of("lossless"), 66),
        (["1000"], Settings.of("lossless", fast=True), 33),
        (["1"], Settings.of("lossless", fast=True), 256),
        (["1/3600"], Settings(cluster=Fraction(1)), 1),
        ([], Settings(), 256),
    ],
)
def test_seconds_of_a_cluster(rates, settings, seconds):
    made = [Channel(np.zeros(1, np.int8), rate, calibration=Calibration()) for rate in rates]
    assert settings.cluster_of(Recording(tuple(made))) == seconds


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        ([], (0, 0)),
        ([0], (0, 0)),
        ([5], (0, 7)),
        ([-1], (-1, 0)),
        ([-4, 3], (-4, 3)),
        ([-5], (-8, 7)),
    ],
)
def test_declared_range(counts, expected):
    assert declared_range(np.array(counts, np.int64)) == expected


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        ([5] * 8 + [-3], (-8, 5)),
        ([5] * 7 + [-3] * 7, (-8, 7)),
        ([-5] * 8 + [3] * 8, (-5, 3)),
        ([5] * 8 + [0] * 8, (0, 5)),
        ([5] * 8 + list(range(5)) * 2000, (0, 7)),
    ],
)
def test_the_range_ends_where_a_sensor_does(counts, expected):
    assert held_range(np.array(counts, np.int64)) == expected


def test_nothing_decodes_beyond_a_saturated_sensor():
    x = np.clip(6500 * np.sin(np.arange(4000) / 50), -5000, 5000)
    data = encoded(Recording((force(x),)), Settings.of("paper", bits=3, smallest=False))
    for band in ("lf", "full"):
        y = hapfmt.read(data, band=band).channels[0].stored
        assert 4900 < np.abs(y).max() <= 5000


@given(st.lists(st.integers(-(2**31), 2**31), min_size=1, max_size=60))
def test_a_codebook_has_a_word_for_every_level(levels):
    from hapfmt.codecs.quantised import decode_levels, encode_quantised

    column = np.array(levels, np.int64)[:, None]
    parameters = choose_codebook([column], 1)
    data = encode_quantised(column, parameters)
    assert decode_levels(data, parameters, len(levels), 0).tolist() == levels


@pytest.mark.parametrize(
    "wrong",
    [
        {"preset": "best"},
        {"bits": 1},
        {"bits": 17},
        {"bits": 5, "step": ONE_COUNT},
        {"cutoff_hz": 0.0},
        {"cluster": Fraction(0)},
        {"k": Fraction(-1)},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(hapfmt.ParameterError):
        Settings.of(wrong.pop("preset", "paper"), **wrong)


@pytest.mark.parametrize(
    "channel",
    [
        Channel(np.array([2**31]), Fraction(1), calibration=Calibration()),
        Channel(np.array([1 << 20]), Fraction(1), calibration=Calibration(2**40, 0, 1)),
        Channel(np.array([True]), Fraction(1)),
        Channel(np.array([1.0]), Fraction(1, 2**33)),
        Channel(np.array([1.0]), Fraction(1), label="x" * 256),
    ],
)
def test_what_does_not_fit_the_format_is_refused(channel):
    with pytest.raises(hapfmt.ParameterError):
        encoded(Recording((channel,)))


def test_all_tracks_share_one_chunk():
    """Whatever they have of their own; HF tracks follow in the order of their bases."""
    rng = np.random.default_rng(3)
    t = np.arange(600)
    shapes = [np.rint(900 * np.sin(t / 40)), rng.normal(0, 50, 600), 0 * t + 7, 30 * (t // 100)]
    channels = [
        Channel(
            np.rint(shapes[i % 4] * (i + 1)).astype(np.int32), Fraction(1000 if i % 3 else 500),
            calibration=Calibration(1, 0, 100 + i), label=f"f{i}", unit="N",
        )
        for i in range(16)
    ]  # fmt: skip
    for preset in ("perceptual", "lossless", "paper"):
        made = encode(Recording(tuple(channels)), Settings.of(preset))
        records = [(track, build_track(track)) for track in made.tracks]
        assert [part for _, part in chunks_of(records)] == [made.tracks]
        bases = [track.base for track in made.tracks if track.kind == "hf"]
        assert bases == [track.id for track in made.tracks if track.kind == "lf"]
        back = hapfmt.read(encoded(Recording(tuple(channels)), Settings.of(preset)))
        assert [c.label for c in back.channels] == [c.label for c in channels]


class TestConstantStretches:
    def packets(self, values, **given):
        channel = Channel(np.array(values), Fraction(10), calibration=Calibration(), **given)
        settings = Settings.of("lossless", cluster=Fraction(1))
        made = encode(Recording((channel,)), settings)
        back = hapfmt.read(encoded(Recording((channel,)), settings)).channels[0]
        assert np.array_equal(back.stored, channel.stored) and back.coverage == channel.coverage
        return [(packet.start, packet.span) for packet in made.packets]

    def test_one_packet(self):
        assert self.packets([7] * 95) == [(0, 95)]

    def test_a_gap_parts_them(self):
        coverage = (Span(0, 40), Span(41, 96))
        assert self.packets([7] * 95, coverage=coverage) == [(0, 40), (41, 55)]

    def test_only_what_is_constant_is_joined(self):
        ramp = [*range(10)]
        assert self.packets(ramp * 2 + [3] * 30 + ramp) == [(0, 10), (10, 10), (20, 30), (50, 10)]

    @pytest.mark.parametrize("preset", ["lossless"])
    def test_exact_values_are_not_joined(self, preset):
        """The same count and the same bytes, but the corrections of one sample only."""
        x = np.append(np.arange(1, 20) * 0.02, [-0.0, -0.0])
        recording = Recording((Channel(x, Fraction(1)),))
        data = encoded(recording, Settings.of(preset, cluster=Fraction(1)))
        back = hapfmt.read(data).channels[0]
        assert back.exact.view(np.int64).tolist() == x.view(np.int64).tolist()


@pytest.mark.parametrize("preset", ["paper", "perceptual", "near-lossless"])
@pytest.mark.parametrize("values", [[1e308, -1e308], [0.0, 5e-321]])
def test_a_floor_that_leaves_no_room(preset, values):
    """A share of the range beyond the largest double, and one below the smallest."""
    recording = Recording((Channel(np.array(values), Fraction(1), unit="m", quantity="velocity"),))
    given = {"floor": "0.2%"} if preset == "paper" else {}
    data = encoded(recording, Settings.of(preset, **given))
    assert hapfmt.read(data).channels[0].samples().tolist() == values
