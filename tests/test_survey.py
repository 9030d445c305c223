"""Recordings in parts: outlines, histograms, spectra, views, differences. The result never depends
on where the parts begin."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import hapfmt
from hapfmt.encoder.settings import Tolerance
from hapfmt.errors import ParameterError
from hapfmt.lab import parts as parts_of
from hapfmt.lab.compare import compare, pair_up
from hapfmt.lab.parts import FileParts, RecordingParts
from hapfmt.lab.views import BINS, LARGEST, SHOWN, Histogram, Outline, Spectrum, liveliest, survey
from hapfmt.reading.reader import Reader
from hapfmt.recording import Calibration, Channel, Recording

LSB = Calibration(1, 0, 2000)


def force(n=6000, *, gaps=(), rate=1000, label="force"):
    t = np.arange(n) / rate
    x = 1 + 0.3 * np.sin(3 * t) + 0.02 * np.sin(700 * t)
    x = np.round(2000 * x) / 2000
    for a, b in gaps:
        x[a:b] = np.nan
    known = Channel.from_physical(x, rate, label=label, unit="N", quantity="force", lsb=1 / 2000)
    counts = np.round(known.stored * 2000).astype(np.int32)
    return Channel(counts, known.rate_exact, known.coverage, LSB, label, "N", "force")


def file_of(recording, preset="paper", **settings):
    if preset == "paper":
        settings = {"step": "0.4%", "smallest": False, **settings}
    import io

    stream = io.BytesIO()
    hapfmt.write(recording, stream, hapfmt.Settings.of(preset, **settings))
    return stream.getvalue()


class TestOutline:
    @given(st.data())
    def test_least_and_most_of_each_column_however_the_samples_come(self, data):
        first = data.draw(st.integers(0, 50))
        ticks = data.draw(st.integers(1, 300))
        x = data.draw(arrays(np.float64, ticks, elements=st.floats(width=32)))
        known = data.draw(arrays(np.bool_, ticks))
        got = Outline.over(first, first + ticks, Fraction(10), limit=data.draw(st.integers(1, 99)))
        edges = sorted(data.draw(st.sets(st.integers(1, max(ticks - 1, 1)), max_size=5)))
        for a, b in zip([0, *edges], [*edges, ticks], strict=True):
            channel = Channel.from_physical(
                np.where(known[a:b], 0.0, np.nan), 10, start_tick=first + a
            )
            got.add_channel(channel, x[a:b][known[a:b]])
        kept = np.where(known & np.isfinite(x), np.clip(x, -LARGEST, LARGEST), np.nan)
        for column in range(got.counts.size):
            place = slice(column * got.size, (column + 1) * got.size)
            values = kept[place][~np.isnan(kept[place])]
            assert got.counts[column] == known[place].sum()
            assert got.least[column] == (
                values.min() if values.size else pytest.approx(np.nan, nan_ok=True)
            )
            assert got.most[column] == (
                values.max() if values.size else pytest.approx(np.nan, nan_ok=True)
            )

    def test_few_ticks_are_kept_and_many_are_not(self):
        assert Outline.over(0, 4000, Fraction(1)).is_whole
        large = Outline.over(0, 10**9, Fraction(1000))
        assert large.counts.size == 2000 and large.seconds()[-1] < 1e6

    def test_what_lies_outside_is_left_out(self):
        outline = Outline.over(10, 14, Fraction(1))
        outline.add(8, np.arange(100.0))
        assert outline.most.tolist() == [2, 3, 4, 5]

    def test_gaps_lie_between_samples(self):
        outline = Outline.over(0, 10, Fraction(2))
        for start in (2, 5):
            outline.add(start, np.zeros(2))
        assert outline.runs(outline.missing()) == [(1.75, 2.25)]


class TestHistogram:
    @given(arrays(np.float64, st.integers(0, 60), elements=st.floats(-1e300, 1e300)))
    def test_nothing_is_lost_and_bars_hold_all(self, errors):
        histogram = Histogram()
        for error in errors:
            histogram.add(np.array([error]))
        assert histogram.total == errors.size and histogram.counts.size == BINS
        centres, counts, width = histogram.bars()
        assert counts.sum() == errors.size and counts.size <= 81
        if errors.size:
            assert np.abs(centres).max() + width / 2 >= 0.999 * np.abs(errors).max()

    def test_whole_counts_stay_apart(self):
        histogram = Histogram(0.5)
        histogram.add(np.array([-1.0, -0.5, 0, 0, 0.5]))
        centres, counts, width = histogram.bars()
        assert width == 0.5 and counts.tolist() == [1, 1, 2, 1, 0]
        assert centres.tolist() == [-1, -0.5, 0, 0.5, 1]

    def test_what_is_not_finite_is_counted_apart(self):
        histogram = Histogram()
        histogram.add(np.array([np.nan, np.inf, 1.0]))
        assert (histogram.total, histogram.beyond) == (1, 2)


class TestSpectrum:
    def test_power_of_a_sine_at_its_frequency(self):
        spectrum = Spectrum(1000, 20_000)
        x = 3 * np.sin(2 * np.pi * 100 * np.arange(20_000) / 1000)
        for block in np.split(x, 4):
            spectrum.add(block)
        hertz, power = spectrum.density()
        assert abs(hertz[np.argmax(power)] - 100) < 0.5
        assert np.sum(power) * hertz[0] == pytest.approx(4.5, rel=1e-3)

    def test_short_or_not_finite_runs_say_nothing(self):
        spectrum = Spectrum(1000, 20_000)
        spectrum.add(np.zeros(10))
        spectrum.add(np.full(5000, np.inf))
        assert spectrum.density() is None


@given(st.sets(st.integers(0, 60), min_size=1), st.integers(-5, 70), st.integers(-5, 70))
def test_a_slice_has_the_ticks_between_its_ends(ticks, a, b):
    x = np.full(61, np.nan)
    x[sorted(ticks)] = sorted(ticks)
    got = Channel.from_physical(x, 10).slice_ticks(a, b)
    expected = [tick for tick in sorted(ticks) if a <= tick < b]
    assert got.samples().tolist() == expected
    assert [tick for span in got.coverage for tick in range(span.start, span.stop)] == expected


class TestViews:
    @pytest.mark.parametrize("size", [1, 700, 1 << 20])
    def test_do_not_depend_on_the_parts(self, size, monkeypatch):
        recording = Recording((force(gaps=[(2000, 2500), (4001, 4002)]), force(300, rate=50)))
        data = file_of(recording, cluster=Fraction(1, 2))
        monkeypatch.setattr(parts_of, "PART", size)
        with Reader(data) as reader:
            whole = reader.read()
            views = survey(FileParts(reader), against=RecordingParts(recording))
            assert size > 1 or len(FileParts(reader).edges(Fraction(0), Fraction(6))) > 10
        for view, y, x in zip(views, whole.channels, recording.channels, strict=True):
            full = Outline.over(view.full.first, view.full.stop, y.rate_exact)
            full.add_channel(y)
            assert np.array_equal(view.full.counts, full.counts)
            assert np.array_equal(view.full.most, full.most, equal_nan=True)
            error = np.abs(y.samples() - x.samples()).max()
            assert view.errors.largest == error and view.errors.total == x.stored.size
            assert view.only_original == 0 and view.relative.largest <= 1
            inside = (view.low.least <= view.full.least) & (view.full.most <= view.high.most)
            assert inside[view.full.counts > 0].all()
        assert views[0].gaps and not views[1].gaps and not views[0].losses

    def test_knots_only_where_they_are_few(self):
        rng = np.random.default_rng(1)
        x = np.where(np.arange(8000) < 6000, 1000 * rng.integers(1, 40, 8000), 5000)
        loud = Channel(x.astype(np.int32), Fraction(1000), calibration=LSB, label="loud", unit="N")
        asked = {"texture": False, "felt": "all", "k": "0.01", "floor": 0.01}
        with Reader(file_of(Recording((loud,)), "perceptual", **asked)) as reader:
            parts = FileParts(reader)
            knotted = parts.refs[0].track.codec == "KNOT"
            few = survey(parts, Fraction(7), Fraction(8))[0].knots
            many = survey(parts)[0].knots
        assert knotted == (few is not None)
        assert many is None
        assert few is None or few.ticks.size <= SHOWN
        assert few is None or np.isfinite(few.values).all()

    def test_knots_lie_on_the_slow_part(self):
        with Reader(file_of(Recording((force(),)))) as reader:
            view = survey(FileParts(reader))[0]
            slow = reader.read(band="lf").channels[0].samples()
        assert view.knots.ticks.size > 10
        assert np.array_equal(view.knots.values, slow[view.knots.ticks])
        assert view.residual.most.max() > 0.01 and set(view.spectra) == {"full", "LF", "HF"}

    def test_damage_is_said_with_what_it_took(self):
        recording = Recording((force(gaps=[(100, 200)]),))
        data = bytearray(file_of(recording, cluster=Fraction(1)))
        with Reader(bytes(data)) as reader:
            ref, track = reader.catalogue.data[2], reader.channels[0].residual
            packets = reader.packets({track.id: (0, 1 << 62)})
            offset = next(p.offset for p in packets if p.start >= 2000)
        assert offset > ref.offset
        data[offset + 3] ^= 255
        with Reader(bytes(data)) as reader:
            parts = FileParts(reader)
            near = survey(parts, Fraction(0), Fraction(1))[0]
            view = survey(parts)[0]
            assert parts.lost_within(Fraction(0), Fraction(1)) == []
            assert [span.start for span in parts.lost_within(None, None)] == [2000]
        assert near.losses == []
        (loss,) = view.losses
        assert (round(loss.start), round(loss.stop), loss.what) == (2, 3, "HF")
        assert view.gaps == [pytest.approx((0.1, 0.2), abs=0.01)]
        assert view.full.sample_count == 4900 and view.lf.sample_count == 5900

    def test_one_cluster_with_a_damaged_packet_keeps_its_other_channels(self):
        rng = np.random.default_rng(1)
        counts = rng.integers(-1000, 1000, (27, 3000)).astype(np.int32)
        channels = [Channel(x, Fraction(1000), label=f"c{i}") for i, x in enumerate(counts)]
        data = bytearray(file_of(Recording(tuple(channels)), "lossless", cluster=Fraction(60)))
        data[len(data) // 2] ^= 1
        with Reader(bytes(data)) as reader:
            parts = FileParts(reader)
            assert len(reader.catalogue.data) == 1 and parts.extent() == (0, 3)
            views = survey(parts, spectra=False)
        whole = [view for view in views if view.full.sample_count == 3000]
        (cut_view,) = (view for view in views if view.full.sample_count == 0)
        assert len(whole) == 26 and not any(view.losses for view in whole)
        assert [(loss.start, loss.stop, loss.what) for loss in cut_view.losses] == [
            (0, pytest.approx(3, abs=0.001), "all")
        ]

    def test_a_lost_beginning_belongs_to_the_picture(self):
        data = bytearray(file_of(Recording((force(),)), "lossless", cluster=Fraction(2)))
        with Reader(bytes(data)) as reader:
            data[reader.catalogue.data[0].offset + 200] ^= 1
        with Reader(bytes(data)) as reader:
            (view,) = survey(FileParts(reader))
        assert view.start == 0 and view.stop == 6
        assert [(loss.start, round(loss.stop)) for loss in view.losses] == [(0, 2)]

    def test_where_most_happens(self):
        x = np.zeros(20_000)
        x[15_000] = 1
        view = survey(RecordingParts(Recording((Channel.from_physical(x, 1000),))))[0]
        start, stop = liveliest(view, 400)
        assert start < 15 < stop and (stop - start) * 1000 == 400
        assert liveliest(view, 10_000) is None

    @pytest.mark.parametrize("n", [3000, 40_000])
    def test_most_happens_in_the_texture_and_not_in_the_silence_before_it(self, n):
        """A contact: silence, one large step, a force with texture."""
        t = np.arange(n) / 1000
        x = np.where(t > n / 4000, 2 + 0.1 * np.sin(500 * t), 0.0)
        (view,) = survey(RecordingParts(Recording((Channel.from_physical(x, 1000),))))
        start, _ = liveliest(view, 400)
        assert start >= Fraction(n - 2000, 4000)
        flat = Recording((Channel.from_physical(np.ones(n), 1000),))
        assert liveliest(survey(RecordingParts(flat))[0], 400) is None

    def test_refused(self):
        parts = RecordingParts(Recording((force(),)))
        with pytest.raises(ParameterError, match="ends at 6 s"):
            survey(parts, Fraction(7))
        with pytest.raises(ParameterError, match="No samples in this time range"):
            survey(RecordingParts(Recording()))
        with pytest.raises(ParameterError, match="rate"):
            survey(parts, against=RecordingParts(Recording((force(rate=500),))))


def differences(a, b, tolerance=None, **times):
    one, two = RecordingParts(Recording(a)), RecordingParts(Recording(b))
    text = None if tolerance is None else Tolerance.parse(tolerance)
    return compare(one, two, pair_up(one, two), tolerance=text, **times)[0]


class TestCompare:
    def test_identical(self):
        (row,) = differences((force(gaps=[(5, 9)]),), (force(gaps=[(5, 9)]),))
        assert row.identical and row.within and row.verdict == "identical"
        assert (row.samples, row.largest_counts, row.snr_db) == (5996, 0, None)

    @pytest.mark.parametrize("size", [100, 1 << 20])
    def test_numbers_whatever_the_parts(self, size, monkeypatch):
        monkeypatch.setattr(parts_of, "PART", size)
        a, b = force(gaps=[(1000, 1100)]), force(gaps=[(1050, 1200)])
        values = b.stored.copy()
        values[3000] += 7
        values[10] -= 2
        b = Channel(values, b.rate_exact, b.coverage, b.calibration, b.label, b.unit)
        (row,) = differences((a,), (b,))
        assert (row.samples, row.only_a, row.only_b, row.differing) == (5800, 100, 50, 2)
        assert row.largest_counts == 7 and row.largest == pytest.approx(7 / 2000)
        assert row.at_s == pytest.approx(3.150)
        assert row.rms == pytest.approx(np.sqrt((49 + 4) / 5800) / 2000)
        x = a.samples()
        assert row.snr_db == pytest.approx(20 * np.log10(x.std() / row.rms), abs=1e-6)
        assert row.snr_hf_db is not None and row.snr_hf_db < row.snr_db
        assert not row.within

    def test_tolerance(self):
        a = force(500)
        b = Channel(a.stored + 1, a.rate_exact, a.coverage, a.calibration, a.label, a.unit)
        for text, within in (
            ("1lsb", True),
            ("0.9lsb", False),
            ("6e-4", True),
            ("1e-4", False),
            ("1%", True),
        ):
            (row,) = differences((a,), (b,), text)
            assert row.within == within, text
            assert row.verdict == ("within tolerance" if within else "differs")
        (row,) = differences((a,), (force(499),), "9")
        assert not row.within and row.only_a == 1

    def test_values_without_distance(self):
        words = np.array([np.nan, np.inf, -np.inf, 1e308, 0.0, 1.0])
        a = Channel(words, Fraction(10), label="x")
        assert differences((a,), (a,))[0].identical
        (row,) = differences((a,), (Channel(words[::-1].copy(), Fraction(10), label="x"),), "1")
        assert row.largest == np.inf and not row.within and row.differing == 6
        negative = np.where(words == 0, -0.0, words)
        (row,) = differences((a,), (Channel(negative, Fraction(10), label="x"),))
        assert row.differing == 1 and row.largest == 0 and row.within and not row.identical

    def test_channels_belong_together_by_label_else_by_place(self):
        a, b = force(9, label="a"), force(9, label="b")
        rows = differences((a, b), (b, force(9, label="c")))
        assert [row.verdict for row in rows] == ["only in A", "identical", "only in B"]
        unnamed = force(9, label="")
        assert [row.verdict for row in differences((unnamed, b), (a,))] == [
            "identical",
            "only in A",
        ]
        (row,) = differences((a,), (force(9, rate=500, label="a"),))
        assert row.verdict == "rates 1000 and 500 Hz" and not row.within

    def test_channels_of_other_units_are_not_paired_by_place(self):
        a, b = force(9, label="normal force"), replace(force(9, label="pos_master"), unit="m")
        assert [row.verdict for row in differences((a,), (b,))] == ["only in A", "only in B"]
        (row,) = differences((a,), (replace(b, unit=a.unit),))
        assert row.identical and "pos_master" in row.notes[0]

    def test_a_stretch_of_time(self):
        a, b = force(), force()
        b.stored[5000] += 1
        times = {"start": Fraction(1), "stop": Fraction(2)}
        (row,) = differences((a,), (b,), **times)
        assert row.identical and row.samples == 1000


@pytest.mark.deep
@pytest.mark.capped
def test_an_hour_in_bounded_memory(tmp_path):
    """28.8 million samples, 230 MB as doubles, within 256 MB together with all that is imported."""
    n = 3_600_000
    rng = np.random.default_rng(1)
    x = (4000 + 1000 * np.sin(np.arange(n) / 5000) + 20 * rng.standard_normal(n)).astype(np.int32)
    channels = [
        Channel(x, Fraction(1000), calibration=LSB, label=f"f{i}", unit="N") for i in range(8)
    ]
    hapfmt.write(
        Recording(tuple(channels)),
        tmp_path / "hour.hapf",
        hapfmt.Settings.of("lossless", fast=True),
    )
    with Reader(tmp_path / "hour.hapf") as one, Reader(tmp_path / "hour.hapf") as two:
        views = survey(FileParts(one), spectra=False)
        assert [view.full.sample_count for view in views] == [n] * 8
        a, b = FileParts(one), FileParts(two)
        assert all(row.identical for row in compare(a, b, pair_up(a, b))[0])
