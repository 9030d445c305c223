"""Channels that are predicted from each other: which, when, and that nothing is lost by it."""

from __future__ import annotations

import io
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from depth import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st

import hapfmt
from hapfmt import Calibration, Channel, Recording, Settings
from hapfmt.codecs import predicted
from hapfmt.codecs.predicted import (
    Predictor,
    encode_indices,
    parse_header,
    split_components,
)
from hapfmt.encoder import predict, references
from hapfmt.encoder.effort import EFFORTS
from hapfmt.encoder.encode import encode
from hapfmt.encoder.plan import bound_promise
from hapfmt.encoder.predict import encode_best
from hapfmt.encoder.references import find_links, fit, intervals, places_in
from hapfmt.recording import Span

DATA = Path(__file__).parents[2] / "shared" / "data"

ARCHIVE = Settings()
STEP = Calibration(1, 0, 100)


def channels(counts, rate=1000, **given):
    return tuple(
        Channel(np.asarray(row, np.int32), rate, calibration=STEP, label=f"t{place}", **given)
        for place, row in enumerate(counts)
    )


def skin(count=6, size=2000, seed=1, noise=3):
    """Taxels under one load: much in common, a little of their own."""
    g = np.random.default_rng(seed)
    load = g.integers(-40, 41, size).cumsum()
    shares = g.uniform(0.3, 1.8, count)
    return [np.rint(share * load + g.normal(0, noise, size)).astype(int) for share in shares]


def written(recording, settings=ARCHIVE):
    stream = io.BytesIO()
    summary = hapfmt.write(recording, stream, settings, canonical=1)
    return stream.getvalue(), summary


def assert_same(recording, data):
    back = hapfmt.read(data)
    for before, after in zip(recording.channels, back.channels, strict=True):
        assert after.coverage == before.coverage
        assert after.samples().tobytes() == before.samples().tobytes()


@contextmanager
def plain_loops():
    """The readable twins."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (predict, predicted, references):
            patch.setattr(module, "compiled", None)
        yield


class TestTracks:
    def test_one_track_and_much_smaller(self):
        recording = Recording(channels(skin()))
        data, summary = written(recording)
        assert_same(recording, data)
        assert [len(t.components) for t in encode(recording, ARCHIVE).tracks] == [6]
        alone, apart = written(recording, replace(ARCHIVE, references=False))
        assert len(data) < 0.75 * len(alone)
        assert_same(recording, alone)
        assert all(d.axis_count == 1 and d.exact and d.within for d in summary.decisions)
        assert sum(d.size for d in summary.decisions) < 0.75 * sum(d.size for d in apart.decisions)
        assert hapfmt.verify(data, against=recording).verdict == "intact"

    def test_it_is_told(self):
        decisions = encode(Recording(channels(skin())), ARCHIVE).decisions
        assert decisions[0].reason == "lossless, track of 0-5"
        assert decisions[1].reason == "lossless, track of 0-5, from 0"
        assert [d.channel for d in decisions] == list(range(6))

    def test_the_settings_say_no(self):
        settings = replace(ARCHIVE, references=False)
        assert len(encode(Recording(channels(skin())), settings).tracks) == 6
        assert settings.describe() == "lossless --no-references"
        assert ARCHIVE.describe() == "lossless"

    def test_a_deadband_does_not(self):
        settings = Settings.of("perceptual", texture=False, felt="all", smallest=False)
        made = encode(Recording(channels(skin(2, 300))), settings)
        assert {len(track.components) for track in made.tracks} == {1}

    def test_noise_stays_apart(self):
        rows = np.random.default_rng(5).integers(-99, 100, (5, 3000))
        made = encode(Recording(channels(rows)), ARCHIVE)
        assert [len(track.components) for track in made.tracks] == [1] * 5
        assert {d.reason for d in made.decisions} == {"lossless"}

    def test_neighbours_that_go_together(self):
        """Two skins with noise before, between and after them."""
        noise = np.random.default_rng(5).integers(-999, 1000, (3, 2000))
        rows = [noise[0], *skin(3, seed=2), noise[1], *skin(4, seed=3), noise[2]]
        recording = Recording(channels(rows))
        made = encode(recording, ARCHIVE)
        tied = [(t.first_channel, len(t.components)) for t in made.tracks]
        assert sorted(tied) == [(0, 1), (1, 3), (4, 1), (5, 4), (9, 1)]
        assert_same(recording, written(recording)[0])

    @pytest.mark.parametrize(
        "other",
        [
            {"rate": Fraction(999)},
            {"coverage": (Span(5, 2005),)},
            {"calibration": None},
        ],
        ids=str,
    )
    def test_what_cannot_share_a_track(self, other):
        given = channels(skin(4))
        if other.get("calibration", 0) is None:
            other = {"calibration": None, "stored": given[1].stored + np.pi}
        recording = Recording((given[0], replace(given[1], **other), *given[2:]))
        made = encode(recording, ARCHIVE)
        assert [len(track.components) for track in made.tracks] == [1, 1, 2]
        assert_same(recording, written(recording)[0])

    def test_steps_and_offsets_may_differ(self):
        """Components share a grid of counts, each with a calibration of its own."""
        given = channels(skin(2))
        recording = Recording((given[0], replace(given[1], calibration=Calibration(3, 7, 50))))
        data, _ = written(recording)
        assert len(encode(recording, ARCHIVE).tracks) == 1
        assert_same(recording, data)

    def test_ranges_that_a_calibration_does_not_cover_together(self):
        """count * A stays exact for the small counts of the second, not for those of the first."""
        small, wide = skin(1)[0], skin(1)[0] * 2**14
        fine = Calibration(2**38, 0, 2**38 + 1)
        one, other = channels([wide, small])
        recording = Recording((one, replace(other, calibration=fine)))
        assert len(encode(recording, ARCHIVE).tracks) == 2
        assert_same(recording, written(recording)[0])

    def test_constants_and_gaps(self):
        rows = skin(5, 2600)
        rows[2][:] = 7
        for row in rows:
            row[:1300] = row[0]
        spans = (Span(0, 1300), Span(5000, 5001), Span(9000, 10299))
        recording = Recording(channels(rows, coverage=spans))
        data, _ = written(recording)
        assert [len(t.components) for t in encode(recording, ARCHIVE).tracks] == [5]
        assert_same(recording, data)

    def test_more_than_a_track_holds(self):
        recording = Recording(channels(skin(40, 600)))
        sizes = [len(t.components) for t in encode(recording, ARCHIVE).tracks]
        assert sizes == [32, 8]
        assert_same(recording, written(recording)[0])

    @pytest.mark.compiled
    def test_long_packets_are_cut(self):
        recording = Recording(channels(skin(32, 9000), rate=10_000))
        made = encode(recording, replace(ARCHIVE, cluster=100))
        assert {packet.span for packet in made.packets} == {4096, 808}
        assert_same(recording, written(recording, replace(ARCHIVE, cluster=100))[0])

    def test_the_same_bytes_again(self):
        recording = Recording(channels(skin(9)))
        assert written(recording)[0] == written(recording)[0]

    def test_one_channel_of_many(self):
        recording = Recording(channels(skin()))
        (back,) = hapfmt.read(written(recording)[0], channels=[4]).channels
        assert back.stored.tolist() == recording.channels[4].stored.tolist()

    @given(st.integers(0, 2**32), st.sampled_from([1, 2, 5, 300]), st.sampled_from([1, 10**6]))
    def test_any_counts_come_back(self, seed, size, factor):
        g = np.random.default_rng(seed)
        common = g.integers(-900, 901, size) * factor
        rows = [common * g.integers(-2, 3) + g.integers(-2, 3, size) for _ in range(4)]
        recording = Recording(channels(rows))
        assert_same(recording, written(recording)[0])

    def test_the_ends_of_32_bits(self):
        g = np.random.default_rng(1)
        ends = np.array([-(2**31), 2**31 - 1])[g.integers(0, 2, 400)]
        recording = Recording(channels([ends, ends, -1 - ends]))
        assert len(encode(recording, ARCHIVE).tracks) == 1
        assert_same(recording, written(recording)[0])


class TestNearLossless:
    @pytest.mark.parametrize("error", ["0.5lsb", "1lsb", "6lsb"])
    def test_within_the_error(self, error):
        recording = Recording(channels(skin(noise=20)))
        settings = Settings.of("near-lossless", max_error=error)
        data, summary = written(recording, settings)
        made = encode(recording, settings)
        assert [len(track.components) for track in made.tracks] == [6]
        assert all("track of 0-5" in d.reason and d.within for d in summary.decisions)
        for before, after in zip(recording.channels, hapfmt.read(data).channels, strict=True):
            away = np.abs(before.stored.astype(int) - after.stored).max()
            assert away <= float(error[:-3])
        report = hapfmt.verify(data, against=recording)
        assert report.verdict == "intact" and not any(c.outside for c in report.contracts)
        apart = encode(recording, replace(settings, references=False))
        size = sum(d.size for d in made.decisions)
        assert size < 0.97 * sum(d.size for d in apart.decisions)

    def test_grids_that_differ_stay_apart(self):
        rows = skin(4)
        rows[1] = rows[1] * 3
        settings = Settings.of("near-lossless", max_error="1%")
        steps = [references.step_of([c], bound_promise(settings), settings) for c in channels(rows)]
        made = encode(Recording(channels(rows)), settings)
        assert all(a != b for a, b in zip(steps, steps[1:], strict=False))
        assert len(made.tracks) == 4


def links_of(rows):
    return find_links(np.array(rows), np.zeros(len(rows[0]), bool))


class TestLinks:
    def test_a_delayed_copy(self):
        x = np.random.default_rng(1).integers(-99, 100, 5000)
        assert links_of([x, np.roll(x, 1)])[1] == (0,)
        assert links_of([x, np.roll(x, -1)])[1] == (0,)
        assert links_of([x, np.roll(x, 2)]) == [(), ()]

    def test_the_nearest_alone_is_enough(self):
        """A sum of two needs both, a copy of one only that."""
        g = np.random.default_rng(1)
        a, b = g.integers(-99, 100, (2, 5000)).cumsum(axis=1)
        assert links_of([a, b, a + b, a + g.integers(-1, 2, 5000)])[2:] == [(0, 1), (0,)]

    def test_constants_and_short_ones(self):
        x = np.random.default_rng(1).integers(-99, 100, 5000)
        constant = np.full(5000, 3)
        assert links_of([constant, x, constant, x]) == [(), (), (), (1,)]
        assert links_of([constant, constant]) == [(), ()]
        assert links_of([x[:60], x[:60]]) == [(), ()]

    @pytest.mark.parametrize(
        ("links", "expected"),
        [
            ([(), (), ()], []),
            ([(), (0,), ()], [(0, 2)]),
            ([(), (0,), (), (2,)], [(0, 2), (2, 4)]),
            ([(), (), (1,), (0,)], [(0, 4)]),
            ([(), (0,), (), (2,), (0, 3)], [(0, 5)]),
            ([(), (), (), (0, 1)], [(0, 4)]),
        ],
    )
    def test_runs_that_no_link_leaves(self, links, expected):
        assert intervals(links) == expected

    def test_weights(self):
        """Half of one, minus a quarter of another a tick later."""
        g = np.random.default_rng(2)
        a, b = g.integers(-4000, 4001, (2, 3000))
        x = a // 2 - np.append(b[1:], 0) // 4
        found = fit(np.array([a, b, x]), 2, (0, 1))
        assert np.abs(np.array(found.weights) - [0, 32, 0, 0, 0, -16]).max() <= 3
        assert found.bits < found.without / 5

    def test_a_tap_does_not_spoil_the_weights(self):
        """One sample in a thousand, a hundred times as large, with a sign of its own."""
        g = np.random.default_rng(3)
        a = g.integers(-40, 41, 4000)
        x = a + g.integers(-1, 2, 4000)
        x[::1000] = -2000
        a[::1000] = 2000
        assert fit(np.array([a, x]), 1, (0,)).weights[1] > 24

    def test_what_is_looked_at(self):
        """Four pieces of a long channel, and all of a short one."""
        places, torn = places_in((Span(0, 14_000), Span(50_000, 136_000)))
        assert places.size == 4096
        assert places[[0, 1024]].tolist() == [11_988, 36_988]
        assert np.flatnonzero(torn).tolist() == [0, 1024, 2048, 3072]
        places, torn = places_in((Span(0, 500), Span(600, 700)))
        assert (places, np.flatnonzero(torn).tolist()) == (slice(None), [500])

    @given(st.integers(0, 2**32), st.integers(2, 5), st.sampled_from([2, 40, 300, 4400]))
    def test_the_twin_finds_the_same(self, seed, count, size):
        g = np.random.default_rng(seed)
        load = g.integers(-40, 41, size).cumsum() * int(g.integers(1, 5000))
        rows = [
            np.rint(share * np.roll(load, k - 1) + g.normal(0, 10 ** g.uniform(-1, 4), size))
            for k, share in enumerate(g.uniform(-1.5, 2, count))
        ]
        table, torn = np.array(rows, np.int64), g.integers(0, size, size) == 0
        with plain_loops():
            links = find_links(table, torn)
            fitted = fit(table, count - 1, tuple(range(count - 1)))
        assert find_links(table, torn) == links
        again = fit(table, count - 1, tuple(range(count - 1)))
        assert (again.cross == fitted.cross).all()
        assert replace(again, cross=fitted.cross) == fitted

    def test_a_jump_that_all_share_is_no_resemblance(self):
        g = np.random.default_rng(1)
        rows = g.integers(-9, 10, (2, 2000)) + np.where(np.arange(2000) < 990, 0, 10**6)
        spans = (Span(0, 990), Span(1000, 2010))
        made = encode(Recording(channels(rows, coverage=spans)), ARCHIVE)
        assert len(made.tracks) == 2


def test_packets_that_are_larger_with_references_go_without():
    """All but the last packet has much in common."""
    g = np.random.default_rng(1)
    a = g.integers(-500, 501, 20_000)
    b = np.concatenate((a[:15_000], g.integers(-500, 501, 5_000)))
    made = encode(Recording(channels([a, b])), replace(ARCHIVE, cluster=5))
    (track,) = made.tracks
    assert len(track.components) == 2
    told = []
    for packet in made.packets:
        start, end = split_components(packet.data, 2, 0)[1]
        predictor, _, _ = parse_header(packet.data[start:end], 0, 1)
        told.append(len(predictor.references))
    assert told == [1, 1, 1, 0]


def test_predictor_and_weights_are_fitted_in_turn():
    """Alone it looks like the smooth load; what the load leaves is noise with a pitch of its own."""
    g = np.random.default_rng(1)
    load = g.integers(-90, 91, 3000).cumsum()
    pitch = np.rint(300 * np.sin(np.arange(3000) / 2)).astype(int) + g.integers(-2, 3, 3000)
    rows = np.array([load, load + pitch])
    data = references.encode_referring(rows, 1, (0,), EFFORTS["default"])
    assert len(data) < 0.6 * len(encode_best(rows[1]))


@pytest.mark.parametrize("seed", range(4))
def test_higher_differences_have_no_coefficients(seed):
    """Alone it is a second difference, beside which LPC-004 allows none; references are found."""
    noise = np.random.default_rng(seed).integers(-40, 41, 300)
    indices = np.arange(300) ** 2 // 9 + noise
    alone = encode_indices(indices, Predictor(2))
    rows = np.array([noise, indices])
    assert len(references.encode_referring(rows, 1, (0,), EFFORTS["default"])) < len(alone) // 2


def test_references_tell_of_repeats():
    """Half of the samples repeat the one before in both rows: marks of this would cost a bit each."""
    g = np.random.default_rng(3)
    row = np.repeat(g.integers(-500, 501, 2000).cumsum(), g.integers(1, 4, 2000))
    data = references.encode_referring(np.array([row, row + 8]), 1, (0,), EFFORTS["default"])
    assert len(data) < 40


def tactile_array(seed: int) -> Recording:
    """Slow taxels that share a drift and a noise, some of them hardly touched."""
    rng = np.random.default_rng(seed)
    n, m, rate = (int(rng.integers(*ends)) for ends in ((200, 1200), (4, 24), (30, 100)))
    drift = np.convolve(np.cumsum(rng.normal(size=n)), np.ones(20) / 20, "same")
    drift = (drift - drift.min()) / np.ptp(drift)
    noise = rng.normal(size=n) * rng.choice([0.5, 2, 8])
    rows = (
        drift * rng.choice([0, 1]) * rng.integers(50, 2000)
        + noise * rng.choice([0, 1, 1]) * rng.random()
        + rng.normal(size=n) * rng.choice([0.05, 0.3, 1, 3])
        + rng.integers(0, 3000) * rng.choice([0, 1])
        for _ in range(m)
    )
    scale = Calibration(1, 0, 1000)
    return Recording(
        tuple(
            Channel(np.rint(x).astype(np.int32), rate, calibration=scale, label=str(k), unit="N")
            for k, x in enumerate(rows)
        )
    )


class TestNeverLarger:
    """A file with references is never larger than one without."""

    def sizes(self, recording: Recording, preset: str, **options: object) -> list[int]:
        return [
            hapfmt.write(
                recording, io.BytesIO(), preset=preset, canonical=1, references=each, **options
            ).file_size
            for each in (True, False)
        ]

    @pytest.mark.compiled
    @given(st.integers(0, 2**32))
    @example(14)
    @settings(max_examples=examples(15), deadline=None)
    def test_arrays(self, seed: int) -> None:
        with_references, without = self.sizes(tactile_array(seed), "perceptual")
        assert with_references <= without

    @pytest.mark.compiled
    @pytest.mark.skipif(not DATA.is_dir(), reason="no ../shared/data")
    def test_recordings(self) -> None:
        for path in sorted(DATA.glob("fabricslide/*.npz")):
            recording = hapfmt.read(path)
            with_references, without = self.sizes(recording, "perceptual", felt="all")
            assert with_references <= without
