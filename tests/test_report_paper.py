"""tools/report/paper.py: the paper's figures, and the measures in the place of its ratings."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from importlib.util import find_spec
from io import BytesIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spec import ROOT

sys.path.insert(0, str(ROOT / "tools"))

from report import paper, rated
from report.felt import displacement_m_per_n, felt, weighted_power
from report.paper_figures import LINE_GAP, most_textured, name_lines
from report.ratio import Source, grid, measure, recorded, settings, simulated
from report.section import Options
from report.texts import plain
from report.variants import leaves, parts_of, plain_huffman_bits, variants

import hapfmt
from hapfmt.lab.scenes import load_scene
from hapfmt.metrics import vibrotactile_threshold

RATE = 1000.0
TOOL = load_scene("sand").tool


@pytest.fixture(scope="module")
def short() -> paper.Section:
    return paper.section(Options(quick=True))


@pytest.fixture(scope="module")
def sand() -> Source:
    return next(source for source in simulated(1.5) if source.name == "sand")


class TestSection:
    @pytest.mark.deep
    def test_has_every_table_and_figure(self, short):
        assert [table.title.partition(":")[0] for table in short.tables] == [
            "The paper's own figures, in both readings of b", "Both readings of b at k = 10 %",
            "Fig. 4", "Fig. 5, measured", "Where the paper says more, or something else",
            "What each choice costs", "How peaky the residuals are, and what b = 5 adds",
        ]  # fmt: skip
        assert [figure.title.partition(":")[0] for figure in short.figures] == [
            "Fig. 2", "Fig. 4", "Fig. 5, measured",
        ]  # fmt: skip
        for table in short.tables:
            assert table.rows
            assert {len(row) for row in table.rows} == {len(table.headers)}
        if find_spec("matplotlib"):
            assert all(figure.svg.startswith("<svg") for figure in short.figures)

    def test_covers_all_settings(self, short):
        for name in ("stone", "sand", "cork"):
            found = short.data["fig4"][name]
            assert {row["bits"] for row in found} == {0, 2, 5, 8}
            assert {row["k_percent"] for row in found} == {1, 10, 50}
        assert {(row["name"], row["bits"]) for row in short.data["fig5"]} == {
            (name, bits) for name in ("stone", "sand", "cork") for bits in (0, 2, 5, 8)
        }

    def test_data_is_json_and_first_sentence_a_finding(self, short):
        assert json.loads(json.dumps(plain(short.data), allow_nan=False))["seconds"] == 2.0
        assert short.text.startswith("**On simulated sand")
        assert "nan" not in short.text

    def test_both_readings_beside_the_figures_of_the_paper(self, short):
        """Within one fixed range no residual has more levels than within its own, and costs less."""
        claims = short.tables[0]
        assert [row[1] for row in claims.rows] == [
            "up to 97 %", "up to 97 %", "3.5", "5 times (rated by people)"
        ]  # fmt: skip
        found = {(r["name"], r["reading"], r["bits"]): r for r in short.data["readings"]}
        for name in ("stone", "sand", "cork", "sand, no touch-downs"):
            for bits in (2, 5):
                own, fixed = (found[name, reading, bits] for reading in (paper.EACH, paper.FIXED))
                assert fixed["range_"] >= own["range_"]
                assert fixed["added_points"] <= own["added_points"] + 0.05
        assert "Where we " in short.text and "cannot tell: quality" in short.text

    def test_touch_downs_make_residuals_peaky_and_b_5_cheap(self, short):
        peaks = {row["recording"]: row for row in short.data["peaks"]}
        kurtosis, points, *_ = (paper.PEAK_HEADERS[1], paper.PEAK_HEADERS[3])
        for name in ("stone", "sand", "cork"):
            peaky, calm = peaks[name], peaks[f"{name}, no touch-downs"]
            assert peaky[kurtosis] > 2 * calm[kurtosis]
            assert peaky[points] < calm[points] - 1

    def test_agreement_is_counted(self):
        def of(name: str, added: float, similarity: float | None) -> list[paper.Reading]:
            return [
                paper.Reading(name, reading, bits, 1.0, 95.5, added, 10.0, similarity, 0.1)
                for reading in (paper.EACH, paper.FIXED)
                for bits in (2, 5)
            ]

        read = [*of("stone", 3.4, 0.9), *of("sand", 6.0, 0.3), *of("cork", 3.0, None),
                *of("sand, no touch-downs", 3.5, 0.9), *of("foam, torque", 9.9, 0.9)]  # fmt: skip
        headers, rows = paper.claims(read)
        verdict = headers.index(f"textures that agree, {paper.EACH}")
        assert [row[verdict] for row in rows] == ["3 of 3", "3 of 3", "2 of 3", "1 of 2"]
        recorded_ = headers.index(f"recorded, {paper.EACH}")
        assert [row[recorded_] for row in rows] == ["95.5", "95.5", "9.9", "9.0"]

    def test_says_that_it_is_no_rating(self, short):
        assert "no rating" in short.text.lower()
        assert "no ratings" in short.figures[-1].caption.lower()

    def test_needs_no_recordings(self, tmp_path):
        assert recorded(None) == recorded(tmp_path) == []


class TestRatio:
    def test_falls_with_bits_and_grows_with_k(self, sand):
        """Up to the size of the lossless channel, which is kept where it is smaller."""
        found = list(grid(sand, (1, 10, 50), (0, 5, 8)))
        stream = BytesIO()
        lossless = hapfmt.write(sand.recording, stream, canonical=1).payload_size
        for percent in (1, 10, 50):
            sizes = [p.payload_size for p in found if p.percent == percent]
            assert sizes == sorted(sizes)
            assert len(set(sizes)) == 3 or sizes[-1] == lossless
        alone = [p.payload_size for p in found if p.bits == 0]
        assert alone == sorted(alone, reverse=True)
        assert len(set(alone)) == 3

    def test_error_shrinks_with_bits(self, sand):
        f = sand.recording.channels[0].samples()
        found = [measure(sand, settings(10, bits, sand.floor)) for bits in (0, 3, 5, 8)]
        errors = [float(np.abs(hapfmt.read(p.file).channels[0].samples() - f).max()) for p in found]
        assert errors == sorted(errors, reverse=True)
        assert errors[-1] < errors[0] / 20
        assert [p.snr_db for p in found] == sorted(p.snr_db for p in found)

    def test_percent_counts_doubles(self, sand):
        point = measure(sand, settings(10, 5, sand.floor))
        assert point.sample_count == 1500
        assert point.file_percent == pytest.approx(100 * len(point.file) / (1500 * 8))
        assert point.payload_percent < point.file_percent


class TestVariants:
    def test_parts_add_up(self, sand):
        point = measure(sand, settings(10, 5, sand.floor))
        parts = parts_of(point.file)
        assert parts.slow_size + parts.fast_size == point.payload_size
        f = sand.recording.channels[0].samples()
        count = 1 / 2000
        assert np.abs(parts.whole - f).max() <= parts.step / 2 + count
        assert parts.knots[0] == 0
        assert parts.knots[-1] == f.size - 1

    def test_first_is_the_paper_and_prediction_is_smaller(self, sand):
        first, *others, predicted = variants(sand, 10, 5)
        point = measure(sand, settings(10, 5, sand.floor))
        assert first.payload_percent == point.payload_percent
        assert first.snr_db == point.snr_db
        assert predicted.payload_percent < first.payload_percent
        half_a_step = parts_of(point.file).step / 2 + 1 / 2000
        assert predicted.largest <= half_a_step / float(sand.floor)
        tapped = next(each for each in others if "tap" in each.name)
        assert tapped.snr_db < first.snr_db - 10
        opened = next(each for each in others if "open" in each.name)
        assert opened.outside_percent > first.outside_percent

    def test_huffman_of_known_counts(self):
        assert plain_huffman_bits(np.array([0, 0, 1, 2])) == 2 * 1 + 2 + 2
        assert plain_huffman_bits(np.array([3, 3, 3])) == 3
        assert plain_huffman_bits(np.arange(16)) == 64

    def test_leaves(self):
        f = np.array([1.0, 0.0, -2.0, 1.0])
        assert leaves(f, f + np.array([0.1, 0.01, 0.3, 0.0]), 0.1, 0.01) == (
            25.0,
            pytest.approx(1.5),
        )


class TestRated:
    def test_torques_are_not_felt(self, sand):
        (channel,) = sand.recording.channels
        slow = replace(channel, stored=channel.stored * 0, label="still")
        torque = replace(channel, unit="N.m", quantity="torque")
        recording = replace(sand.recording, channels=(slow, torque))
        source = Source("lever", recording, sand.floor)
        assert most_textured(source).recording.channels == (torque,)
        found = rated.rate(source, Options(quick=True))
        assert [each.bits for each in found] == [0, 2, 5, 8]
        assert [each.felt for each in found] == [None] * 4
        headers, rows = rated.ratings(found)
        assert all(len(row) == len(headers) and row[4:8] == (None,) * 4 for row in rows)
        if find_spec("matplotlib"):
            assert "error felt" not in rated.picture5(found, "of a lever").svg

    def test_similarity_where_vibromaf_is_installed(self, sand, monkeypatch):
        monkeypatch.setattr(rated, "find_spec", lambda name: name == "vibromaf")
        monkeypatch.setattr(rated, "st_sim", lambda *_: 0.25)
        found = rated.rate(sand, Options(quick=True))
        assert [each.similarity for each in found] == [0.25] * 4
        assert "sand 0.25" in rated.similarity_of(found, ["sand"])
        if find_spec("matplotlib"):
            assert "ST-SIM" in rated.picture5(found, "sand").svg

    def test_no_similarity_without(self):
        assert rated.similarity_of([rated.Rated("sand", 8, 1.0, 30.0, None, None)], ["sand"]) == ""


class TestFelt:
    @given(st.sampled_from([62.5, 125.0, 250.0, 375.0]), st.floats(0, 6.28))
    def test_sine_at_threshold_has_power_one(self, hz, phase):
        at = np.array([hz])
        force = float((vibrotactile_threshold(at) / displacement_m_per_n(at, TOOL))[0])
        x = force * np.sin(2 * np.pi * hz * np.arange(2048) / RATE + phase)
        power = weighted_power(x, RATE, TOOL)
        assert power[2:-2] == pytest.approx(1, rel=0.1)

    def test_slow_force_is_no_vibration(self):
        x = 1 + 0.5 * np.sin(2 * np.pi * np.arange(4000) / RATE)
        assert weighted_power(x, RATE, TOOL).max() < 0.01

    def test_louder_errors_are_felt_longer(self, sand):
        f = sand.recording.channels[0].samples()
        noise = np.random.default_rng(5).normal(0, 1, f.size)
        found = [felt(f, f + rms * noise, RATE, TOOL) for rms in (0.0001, 0.003, 0.03)]
        levels = [each.error_db for each in found]
        assert levels == sorted(levels)
        assert levels[1] - levels[0] == pytest.approx(20 * np.log10(30), abs=0.01)
        assert found[0].share == 0
        assert found[-1].share > 0.8
        for each in found:
            assert each.share <= each.share_grasped
            assert each.texture_db > 0

    def test_nothing_is_felt_of_nothing(self):
        silent = np.zeros(1000)
        assert felt(silent, silent, RATE, TOOL) == (-120, -120, 0, 0)

    @given(st.lists(st.tuples(st.integers(0, 9), st.booleans()), min_size=1))
    def test_least_unfelt(self, rows):
        none = felt(np.zeros(500), np.zeros(500), RATE, TOOL)
        found = [
            rated.Rated("x", bits, 0.0, 0.0, none._replace(share=float(felt_)), None)
            for bits, felt_ in rows
        ]
        said = rated.least_unfelt(found, lambda felt: felt.share)
        unfelt = [b for b, _ in rows if all(not f for bits, f in rows if bits >= b)]
        assert said == (f"b = {min(unfelt)}" if unfelt else "no b that was measured")


class Axes:
    """As much of matplotlib's as names of lines need."""

    def __init__(self) -> None:
        self.places: dict[str, float] = {}

    def get_ylim(self) -> tuple[float, float]:
        return 0.0, 10.0

    def annotate(self, name: str, place: tuple[float, float], **_: object) -> None:
        self.places[name] = place[1]


@given(st.lists(st.floats(0, 10), min_size=1, max_size=6))
def test_names_of_lines_stay_apart_and_in_order(values):
    axes = Axes()
    name_lines(axes, [(value, str(i), "") for i, value in enumerate(values)])
    order = sorted(range(len(values)), key=lambda i: values[i])
    places = [axes.places[str(i)] for i in order]
    assert all(b - a >= LINE_GAP - 1e-9 for a, b in zip(places, places[1:], strict=False))
    assert places[-1] <= 1 + 1e-9
