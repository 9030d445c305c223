"""Clause 9.5: grids, predictors and packets, against the page."""

from __future__ import annotations

import contextlib
import hashlib
import re
from dataclasses import astuple
from math import pi, sin

import numpy as np
import page
import pytest
import strategies
from forge import svarint
from hypothesis import given
from hypothesis import strategies as st
from spec import EXAMPLES

from hapfmt.codecs import predicted
from hapfmt.codecs.entropy import Encoder, ends_of, share_of
from hapfmt.codecs.grids import LpcParameters, deadband_levels
from hapfmt.codecs.predicted import (
    INDEX_LIMIT,
    SINES,
    Predictor,
    decode_indices,
    decode_predicted,
    encode_indices,
    parse_header,
)
from hapfmt.deadband import Deadband
from hapfmt.encoder.predict import encode_best
from hapfmt.errors import FormatError, HapfmtError
from hapfmt.format.cluster import Packet
from hapfmt.limits import LEVELS
from hapfmt.reading.decoder import TrackDecoder

pytestmark = pytest.mark.capped

ONE, TWO = LEVELS[1], LEVELS[2]
cases = st.tuples(strategies.index_arrays(), strategies.predictors())


def packet_of(indices, predictor):
    """None where a prediction error cannot be coded."""
    try:
        return encode_indices(indices, predictor)
    except ValueError:
        return None


def choices(packet, predictor):
    """What the encoder chose: probabilities of repeats, and the rest as page.encode is told it."""
    at = parse_header(packet, 0)[2]
    if packet[at] == page.BY_BITS:
        middle = at + 1 + 4 * predictor.repeats
        return list(packet[at + 1 : middle]), {"number": page.BY_BITS}
    coding, start = packet[at : at + 2]
    middle = at + 2 + 4 * predictor.repeats
    signs = list(packet[middle : middle + 3]) if coding & 32 else []
    rest = {
        "number": coding & 15,
        "start": start,
        "signs": signs,
        "states": 1 + 3 * (coding >> 4 & 1),
    }
    return list(packet[at + 2 : middle]), rest


def decoded(data, span, limit=INDEX_LIMIT):
    """Indices, or the id of the rule that was broken."""
    try:
        return decode_indices(data, span, limit, 0).tolist()
    except FormatError as error:
        return error.requirement


def decoded_as_the_page_says(data, span, limit=INDEX_LIMIT):
    try:
        return page.decode(data, span, limit)
    except page.BrokenRule as rule:
        return str(rule)


class TestParameters:
    @given(strategies.levels.flatmap(lambda v: st.tuples(st.just(v), strategies.lpc_parameters(v))))
    def test_come_back(self, case):
        """LPC-002: `grid` MUST be 0 or 1, and `step` at most what the level allows; it may be 0 on the deadband grid only. `zero` is a signed number of 32 bits. `kn` and `kd` are at least 1 and less than 2^16, and `kd` at most 1024 * `kn`."""
        level, parameters = case
        data = parameters.build()
        assert LpcParameters.parse(data, level, 0) == parameters
        for other in (data[:-1], data + b"\0", b"", b"\2" + data[1:]):
            with pytest.raises(FormatError):
                LpcParameters.parse(other, level, 0)

    @given(st.binary(min_size=15, max_size=17) | st.binary(max_size=20))
    def test_any_bytes(self, data):
        with contextlib.suppress(FormatError):
            assert LpcParameters.parse(data, TWO, 0).build() == data


class TestPackets:
    @given(cases)
    def test_indices_come_back(self, case):
        indices, predictor = case
        data = packet_of(indices, predictor)
        if data is not None:
            assert decoded(data, indices.size) == indices.tolist()

    @given(cases)
    def test_as_the_page_says(self, case):
        """
        LPC-004: g MUST be at most 4, at most 1 where m > 0; m at most 32; k[i] at least -127; bits 5 and 7 of the flags 0; and of a constant component packet g, m and the other flags 0.
        LPC-006: A component packet MUST contain at least `flags`, `m` and m coefficients, and with flag *references* r and r references.
        """
        indices, predictor = case
        row = indices[:60].tolist()
        packet = packet_of(np.array(row), predictor)
        if packet is None:
            with pytest.raises(page.BrokenRule, match="RNG-003"):
                page.encode(row, *astuple(predictor)[:3])
        elif len(set(row)) > 1:
            given = [*astuple(predictor)[:3], *choices(packet, predictor)]
            assert page.encode(row, *given[:4], **given[4]) == packet
        if packet is not None:
            assert decoded(packet, len(row)) == row
            assert decoded_as_the_page_says(packet, len(row)) == row

    @given(cases, st.sampled_from([0, 3, 2**24, 2**32]), st.data())
    def test_mutated(self, case, limit, data):
        """LPC-003: The base and every index i MUST lie on the grid: uniform, |i| * step at most the count bound (clause 12); deadband, |i| at most N."""
        indices, predictor = case
        packet = bytearray(packet_of(indices[:40], predictor) or b"\0\0\0")
        at = data.draw(st.integers(0, len(packet) - 1))
        packet[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        span = data.draw(st.sampled_from([indices[:40].size, 1, 41]))
        expected = decoded_as_the_page_says(bytes(packet), span, limit)
        assert decoded(bytes(packet), span, limit) == expected

    @given(
        st.lists(st.sampled_from([0, 1, 2, 8, 9, 0x10, 0x7F, 0x80, 0xFF]), max_size=14).map(bytes),
        st.integers(1, 12),
        st.sampled_from([0, 7, 2**32]),
    )
    def test_any_bytes(self, data, span, limit):
        assert decoded(data, span, limit) == decoded_as_the_page_says(data, span, limit)

    @given(cases)
    def test_prefixes_and_trailing_bytes(self, case):
        indices, predictor = case
        data = packet_of(indices[:30], predictor)
        if data is None:
            return
        span = indices[:30].size
        for size in range(len(data)):
            assert decoded(data[:size], span) != indices[:30].tolist()
        for extra in (b"\0", b"\xff", data):
            assert decoded(data + extra, span) != indices[:30].tolist()

    def test_damage_is_mostly_seen(self):
        """What RNG-001 alone lets pass as other numbers, in raw bits above all; a packet has its CRC besides."""
        generator = np.random.default_rng(3)
        unseen = tried = 0
        for width in (3, 100, 5000):
            x = np.cumsum(generator.integers(-width, width + 1, 60))
            data = encode_indices(x, Predictor(1))
            damaged = [data[:size] for size in range(0, len(data), 5)]
            for at in range(8 * 3, 8 * len(data), 5):
                damaged.append(bytearray(data))
                damaged[-1][at // 8] ^= 1 << at % 8
            for packet in damaged:
                back = decoded(bytes(packet), 60)
                tried += 1
                assert back != x.tolist()
                unseen += isinstance(back, list)
        assert unseen / tried < 0.5

    @given(st.integers(1, 70), strategies.svarints.filter(lambda v: abs(v) <= INDEX_LIMIT))
    def test_constant(self, span, value):
        data = encode_indices(np.full(span, value), Predictor())
        assert len(data) <= 2 + 5
        assert decoded(data, span) == [value] * span

    @given(strategies.index_arrays())
    def test_the_chosen_predictor_can_be_decoded(self, indices):
        assert decoded(encode_best(indices), indices.size) == indices.tolist()

    def test_quiet_parts_choose_the_predictor_as_loud_ones_do(self):
        """A resonance that is a little louder than the counts, and loud white noise."""
        rng = np.random.default_rng(5)
        noise, x = rng.normal(0, 20, 16000), np.zeros(16000)
        for t in range(2, x.size):
            x[t] = 1.9 * np.cos(0.6) * x[t - 1] - 0.9025 * x[t - 2] + noise[t]
        x[6000:8000] = rng.normal(0, 4000, 2000)
        counts = np.rint(x).astype(np.int64)
        data = encode_best(counts)
        assert decoded(data, counts.size) == counts.tolist()
        # By the energy of all samples, the loud eighth decides: 8.3 bits.
        assert 8 * len(data) < 7.8 * counts.size

    def test_balanced_predictors_of_extremes(self):
        for seed in range(3):
            rng = np.random.default_rng(seed)
            counts = rng.integers(-3, 4, 4096)
            counts[rng.integers(0, 4096, 40)] = rng.choice([-INDEX_LIMIT, INDEX_LIMIT], 40)
            assert decoded(encode_best(counts), counts.size) == counts.tolist()

    @pytest.mark.parametrize("size", range(2, 7))
    def test_differences_of_extremes(self, size):
        for seed in range(20):
            ends = np.random.default_rng(seed).choice([-INDEX_LIMIT, INDEX_LIMIT], size)
            assert decoded(encode_best(ends), size) == ends.tolist()

    @pytest.mark.parametrize("index", [INDEX_LIMIT + 1, -INDEX_LIMIT - 1])
    def test_an_index_beyond_the_format_is_not_coded(self, index):
        for row in ([index, index], [0, index]):
            with pytest.raises(ValueError, match="2\\^32"):
                encode_indices(np.array(row), Predictor())

    def test_a_shift_that_would_wrap(self):
        """RNG-003: The magnitude u of an integer by class or by bits MUST be less than 2^34. Its k by bits is at most 35."""
        far = 2**34 - 1
        for size in (2**34, 2**40, 2**63):
            row = [far, -far] * 100 + [size]
            data = page.encode(row, forge=row, start=163)
            assert decoded(data, len(row)) == decoded_as_the_page_says(data, len(row)) == "RNG-003"

    @given(strategies.quiet_rows(), st.booleans(), st.data())
    def test_quiet(self, row, repeats, data):
        """By bits, with repeats and without, and a byte changed."""
        predictor = Predictor(1, (), row[0], repeats)
        packet = encode_indices(np.array(row), predictor)
        if len(set(row)) > 1:
            given_ = [*astuple(predictor)[:3], *choices(packet, predictor)]
            assert page.encode(row, *given_[:4], **given_[4]) == packet
        assert decoded(packet, len(row)) == row
        wrong = bytearray(packet)
        at = data.draw(st.integers(0, len(packet) - 1))
        wrong[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        wrong = bytes(wrong)
        assert decoded(wrong, len(row)) == decoded_as_the_page_says(wrong, len(row))


class TestPredictor:
    def test_sines(self):
        assert list(SINES) == page.K
        assert [round(32768 * sin(pi * k / 256)) for k in range(128)] == page.K
        assert all(abs(32768 * sin(pi * k / 256) % 1 - 0.5) > 0.001 for k in range(128))
        assert hashlib.sha256(np.array(SINES, "<u2").tobytes()).hexdigest() == page.DIGEST

    @given(st.lists(st.sampled_from([127, -127, 0]) | st.integers(-127, 127), max_size=32))
    def test_step_up(self, ks):
        """LPC-005: Every |p[j]| after each n MUST be at most 2^36, and every |c[j]| at most 2^21."""
        try:
            expected = page.step_up(ks)
        except page.BrokenRule:
            expected = None
        assert Predictor(reflections=tuple(ks)).coefficients == expected

    @pytest.mark.parametrize("index", [1, 40, 127, -127])
    def test_a_first_order_predictor_is_a_sine(self, index):
        (c,) = Predictor(reflections=(index,)).coefficients
        assert abs(c / 8192 - sin(pi * index / 256)) < 1e-4


fractions = st.sampled_from([(1, 10), (1, 1), (3, 2), (65534, 65535), (1, 1024)]) | st.tuples(
    st.integers(1, 40), st.integers(1, 40)
)


class TestDeadbandGrid:
    @given(fractions, st.integers(0, 30), st.integers(1, 300))
    def test_levels_as_the_page_says(self, ratio, step, bound):
        levels, tops = deadband_levels(LpcParameters(step, 0, *ratio), bound)
        assert levels.tolist() == page.grid_levels(*ratio, step, bound)
        assert np.minimum(tops, bound).tolist() == page.tops_by_search(*ratio, step, bound)
        assert (np.diff(levels) > 0).all()

    @given(fractions, st.integers(0, 30), st.integers(1, 300))
    def test_cells_hold_their_counts_and_no_more(self, ratio, step, bound):
        """Each count keeps the deadband at its level; a cell that took one count more would not."""
        grid = LpcParameters(step, 0, *ratio)
        levels, tops = deadband_levels(grid, bound)
        bottom = 0
        for level, top in zip(levels.tolist(), tops.tolist(), strict=True):
            for c in range(bottom, min(top, bound) + 1):
                assert abs(c - level) <= page.tolerance(c, *ratio, step)
            if top < bound:
                assert top + 1 - level > page.tolerance(top + 1, *ratio, step)
            if bottom:
                assert level + 1 - bottom > page.tolerance(bottom, *ratio, step)
            bottom = top + 1

    @given(strategies.levels, st.data())
    def test_any_count_is_within_its_deadband(self, level, data):
        parameters = data.draw(strategies.lpc_parameters(level).filter(lambda p: p.grid))
        bound = level.count_bound
        c = np.array(data.draw(st.lists(st.integers(-bound, bound), min_size=1, max_size=9)))
        levels, tops = deadband_levels(parameters, bound)
        indices = np.sign(c) * np.searchsorted(tops, np.abs(c))
        assert np.abs(indices).max() <= parameters.index_limit(bound) == levels.size - 1
        y = parameters.counts(indices, bound) - parameters.zero
        weber = [abs(x) * parameters.kn // parameters.kd for x in c.tolist()]
        assert (np.abs(c - y) <= np.maximum(weber, parameters.step)).all()
        if parameters.step:
            band = Deadband(parameters.kn, parameters.kd, (parameters.step,), (0,))
            inside = np.abs(c) < 1 << 32
            assert not band.outside(
                c[inside], np.clip(y, 1 - (1 << 32), (1 << 32) - 1)[inside]
            ).any()

    def test_levels_of_a_finest_grid_are_few_enough(self):
        for level, count in (ONE, 5972), (TWO, 8812):
            levels, _ = deadband_levels(LpcParameters(0, 0, 1, 1024), level.count_bound)
            assert levels.size == count + 1

    @pytest.mark.parametrize("level", [ONE, TWO])
    @pytest.mark.parametrize("ratio", [(1, 10), (65534, 65535), (7, 7)])
    def test_the_last_level_and_no_further(self, level, ratio):
        grid = LpcParameters(3, -5, *ratio)
        last = grid.index_limit(level.count_bound)
        data = bytes([16, 0]) + svarint(last)
        assert decode_predicted(data, grid, 1, 1, level, 0)[0, 0] == grid.counts(
            np.array([last]), level.count_bound
        )
        data = encode_indices(np.array([last + 1, last + 1]), Predictor())
        with pytest.raises(FormatError, match="LPC-003"):
            decode_predicted(data, grid, 2, 1, level, 0)


@given(strategies.levels, st.sampled_from([1, 2, 7, 2**24]), st.integers(-9, 9), st.data())
def test_uniform_counts(level, step, zero, data):
    grid = LpcParameters(step, zero)
    limit = level.count_bound // step
    indices = data.draw(strategies.index_arrays(limit))
    packet = encode_indices(indices, Predictor())
    counts = decode_predicted(packet, grid, indices.size, 1, level, 0)
    assert (counts.shape, counts.dtype) == ((indices.size, 1), np.int64)
    assert counts[:, 0].tolist() == [zero + i * step for i in indices.tolist()]
    beyond = page.encode([0, limit + 1])
    with pytest.raises(FormatError, match="LPC-003"):
        decode_predicted(beyond, grid, 2, 1, level, 0)


@given(strategies.packets().filter(lambda case: case[0].codec == "LPCR"), st.binary(max_size=9))
def test_a_track_decodes_or_says_why(case, other):
    track, packets, numbers = case
    decoder = TrackDecoder(track, ONE)
    for packet, counts in zip(packets, numbers, strict=True):
        clamped = counts.clip(track.count_min, track.count_max)
        assert (decoder.decode(packet) == clamped).all()
    with contextlib.suppress(HapfmtError):
        decoder.decode(Packet(0, 0, 3, other))


FROZEN = [
    ([5, 5, 5, 5], 0, [], 5, False,
     "10000a"),
    ([1, -1], 0, [], 0, False,
     "00000003180001c75f02"),
    ([0, 1, 4, 9, 16, 25, 36, 49], 2, [], 0, False,
     "020000041a9eabe06400"),
    ([7, 7, 7, 9, 9, 9, 9, -3, -3], 0, [], 7, True,
     "08000e0020ffffff55224d297b04"),
    ([0, 38, 71, 92, 100, 92, 71, 38, 0, -38, -71, -92, -100], 0, [120, -110], 0, False,
     "00027892000125c83030b7cb095135009f5dcc"),
    ([4294967296, -4294967296, 4294967296, 0], 1, [64], 0, False,
     "010140000e9c15ed7330ea1000006a100000b508000000000000"),
    ([1000, 2000, 4000, 8000, 16000, 32000, 64000, 128000, 256000, -512000], 4, [], 1000, True,
     "0c00d00f065a01808080000b44f61575460070cf401f401f401f401f403e887d00fa0000"),
    ([1000000, -1000000, 1000000, -1000000, 3, 1000000, -4000000], 1, [-90, 20, 5], 1000000, True,
     "0903a6140580897a00690180808005a9123d7711287058273c251e74bfb02db81a12000000"),
]  # fmt: skip
"""(indices, difference, reflection coefficients, base, repeats, packet)"""


EXAMPLE = re.compile(r"^\| `([0-9A-F]{2}(?: [0-9A-F]{2})*)` \| ([-0-9, ]+?)(?: \(.*)? \|$", re.M)


def test_examples_of_the_page():
    examples = EXAMPLE.findall(EXAMPLES)
    assert len(examples) == 7
    for text, numbers in examples:
        indices = [int(number) for number in numbers.split(", ")]
        data = bytes.fromhex(text)
        assert (
            decoded(data, len(indices)) == decoded_as_the_page_says(data, len(indices)) == indices
        )
    levels = [
        int(y) for y in re.search(r"y\(1\), \.\.\. are ([0-9, ]+)\.", page.TEXT)[1].split(", ")
    ]
    assert page.grid_levels(1, 10, 20, 9999)[: len(levels)] == levels
    assert Predictor(reflections=(120, -110)).coefficients == [16107, -7993]


@pytest.mark.parametrize(("indices", "difference", "ks", "base", "repeats", "text"), FROZEN)
def test_frozen_bitstreams(indices, difference, ks, base, repeats, text):
    predictor = Predictor(difference, tuple(ks), base, repeats)
    assert encode_indices(np.array(indices), predictor).hex() == text
    assert decoded(bytes.fromhex(text), len(indices)) == indices


@pytest.mark.capped(16 << 20)
def test_a_ramp_takes_bytes_a_sample(monkeypatch):
    """Few bytes may ask for many indices: the readable loop keeps no object of each."""
    monkeypatch.setattr(predicted, "compiled", None)
    span = 1 << 18
    predictor, coder = predicted.Predictor(1, base=1 << 20), Encoder()
    coder.section([share_of(ends_of(7, 0), 0)] * span)
    packet = predictor.build() + b"\x17\0" + coder.finish()
    assert len(packet) < span >> 5
    assert (predicted.decode_indices(packet, span, 1 << 24, 0) == 1 << 20).all()
