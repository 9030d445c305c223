"""Clause 9.8: transforms, contexts and packets, against the page; compiled loops and their twins."""

from __future__ import annotations

import contextlib
import hashlib
import re

import numpy as np
import page_transform as page
import pytest
from hypothesis import given
from hypothesis import strategies as st
from spec import TEXT
from twins import built, by_the_twin

from hapfmt.codecs import transform as codec
from hapfmt.codecs.entropy import START_MOST
from hapfmt.codecs.transform import (
    BLOCKS,
    NEXT,
    SUM_LIMIT,
    TransformParameters,
    cosines,
    decode_within,
    encode_component,
    inverse,
    waves,
)
from hapfmt.encoder import transform as encoder
from hapfmt.encoder.transform import Quantised, encode_row, forward, trellis
from hapfmt.errors import FormatError
from hapfmt.limits import LEVELS

pytestmark = pytest.mark.capped

ONE = LEVELS[1]
WIDE = (-(2**31), 2**31 - 1)

parameters = st.builds(
    TransformParameters,
    st.sampled_from(BLOCKS),
    st.sampled_from([1, 255, 256, 2**32]) | st.integers(1, 2**32),
    st.sampled_from([0, 1, 2, 32]).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
)


@st.composite
def integers(draw, largest=2**34 - 1):
    """[blocks][coefficients] of one size of block, and the number of ticks."""
    m = draw(st.sampled_from([5, 5, 6]))
    kept = draw(st.sampled_from([1, 2, 5]) | st.integers(1, 2**m))
    blocks = draw(st.integers(1, 4))
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    reach = min(draw(st.sampled_from([0, 1, 3, 50, 2**20, 2**34 - 1])), largest)
    rows = generator.integers(-reach, reach + 1, (blocks, kept))
    rows[generator.random(rows.shape) < draw(st.sampled_from([0, 0.5, 0.95]))] = 0
    span = 2**m * (blocks - 1) + draw(st.integers(1, 2**m))
    return m, rows, span


codings = st.tuples(st.integers(0, 255), st.integers(0, START_MOST))


def decoded(data, m, span, step=1, level=ONE):
    """Counts, or all that an error says."""
    try:
        rows = decode_within(data, TransformParameters(1 << m, step), span, 1, level, 50, *WIDE)
    except FormatError as error:
        return error.requirement, error.offset, error.message
    return rows[:, 0].tolist()


def as_the_page_says(data, m, span, step=1):
    try:
        return page.decode(data, span, m, [step] * 2**m)
    except page.BrokenRule as rule:
        return str(rule)


class TestParameters:
    @given(parameters)
    def test_come_back(self, given):
        """MDC-001: m MUST be 5 to 9, and `step` 1 to 2^32. n is 0 or a power of two, at most 128 and at most M."""
        data = given.build()
        assert TransformParameters.parse(data, 0) == given
        for other in (data[:-1], data + b"\0", b"\4" + data[1:], b"\x0a" + data[1:]):
            with pytest.raises(FormatError):
                TransformParameters.parse(other, 0)

    @given(parameters)
    def test_steps_as_the_page_says(self, given):
        m = given.size.bit_length() - 1
        assert given.steps.tolist() == page.steps(m, given.step, given.weights)

    @given(st.binary(max_size=20))
    def test_any_bytes(self, data):
        with contextlib.suppress(FormatError):
            assert TransformParameters.parse(data, 0).build() == data


class TestTransform:
    def test_the_table(self):
        quarter = cosines()[:1025]
        assert quarter.tolist() == page.TABLE
        digest = hashlib.sha256(quarter.astype("<u2").tobytes()).hexdigest()
        assert digest == page.DIGEST

    def test_states_are_those_of_the_clause(self):
        rows = re.findall(r"^\| next\(state, [01]\) \|(.*)\|$", TEXT, re.M)
        assert [list(map(int, row.split("|"))) for row in rows] == [
            list(r) for r in zip(*NEXT, strict=True)
        ]

    @pytest.mark.parametrize("m", [5, 7, 9])
    def test_samples_as_the_page_says(self, m):
        generator = np.random.default_rng(m)
        blocks = generator.integers(-(2**20), 2**20, (3, 1 << m))
        blocks[1, 3:] = 0
        expected = page.transform(blocks.tolist(), m)
        assert inverse(blocks.astype(np.float64)).tolist() == expected

    @pytest.mark.parametrize("m", [5, 9])
    def test_the_largest_sums_are_exact(self, m):
        """All of a block in one coefficient, or spread over all, and each sign."""
        size = 1 << m
        for k in (0, 1, size - 1):
            rows = np.zeros((2, size))
            rows[:, k] = SUM_LIMIT
            assert inverse(rows).tolist() == page.transform(rows.astype(int).tolist(), m)
        rows = np.sign(waves(size)[:2]) * (SUM_LIMIT // size)
        assert inverse(rows).tolist() == page.transform(rows.astype(int).tolist(), m)

    @given(st.sampled_from(BLOCKS), st.integers(1, 1500), st.integers(0, 2**32))
    def test_the_encoder_inverts_it(self, size, count, seed):
        x = np.random.default_rng(seed).integers(-(2**20), 2**20, count).astype(np.float64)
        coefficients = np.rint(forward(x, size))
        assert np.abs(inverse(coefficients)[:count] - x).max() <= 64

    def test_a_constant_takes_one_coefficient(self):
        rows = np.abs(np.rint(forward(np.full(640, 1000.0), 64)))
        assert (rows[1:9, 0] > 300_000).all() and rows[1:9, 1:].max() == 0


class TestPackets:
    @given(integers(), codings)
    def test_as_the_page_says(self, case, coding):
        """
        MDC-002: |b| MUST be at most the count bound (clause 12), and K at most M.
        MDC-003: In each block the sum of all |X[k]| MUST be at most 2^36.
        """
        m, rows, span = case
        data = encode_component(7, rows, *coding)
        classes = coding[0] % 16, coding[0] // 16
        s = [1] * 2**m
        assert page.encode(rows.tolist(), s, 7, classes=classes, start=coding[1], loud=True) == data
        expected = as_the_page_says(data, m, span)
        found = decoded(data, m, span)
        assert expected in (found, found[0])

    @given(integers(), codings, st.data())
    def test_mutated(self, case, coding, data):
        m, rows, span = case
        packet = bytearray(encode_component(7, rows, *coding))
        for _ in range(data.draw(st.integers(1, 3))):
            at = data.draw(st.integers(0, len(packet)))
            packet[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3))
        found = decoded(bytes(packet), m, span)
        assert found == by_the_twin(codec, decoded, bytes(packet), m, span)
        expected = as_the_page_says(bytes(packet), m, span)
        assert expected in (found, found[0])

    @given(st.sampled_from([b"\0\1\x00\0", b"\0\x20\xe2\x0c", b"\2\5\xd8\xa3"]),
           st.binary(max_size=60), st.integers(1, 200), st.sampled_from([1, 2**20, 2**32]))  # fmt: skip
    def test_any_coded_bytes(self, header, coded, span, step):
        found = decoded(header + coded, 5, span, step)
        assert found == by_the_twin(codec, decoded, header + coded, 5, span, step)
        expected = as_the_page_says(header + coded, 5, span, step)
        assert expected in (found, found[0])

    @pytest.mark.parametrize("beside", [0, 1])
    def test_the_bounds(self, beside):
        for level in LEVELS.values():
            for base in (level.count_bound + beside, -level.count_bound - beside):
                data = codec.TransformHeader(base, 0).build()
                found = decoded(data, 5, 1, level=level)
                assert found[0] == "MDC-002" if beside else len(found) == 1
        data = encode_component(0, np.array([[2**26 + beside]]), 0, 99)
        assert ("MDC-003" in decoded(data, 5, 1, step=512)) == bool(beside)

    def test_a_component_is_as_if_alone(self):
        rows = [encode_component(b, np.array([[b, -b, 3]] * 3), 0xE2, 20) for b in (5, 9)]
        given = TransformParameters(32, 300), 70
        both = decode_within(bytes([len(rows[0])]) + b"".join(rows), *given, 2, ONE, 0, *WIDE)
        for column, row in zip(both.T, rows, strict=True):
            assert column.tolist() == decode_within(row, *given, 1, ONE, 0, *WIDE)[:, 0].tolist()

    def test_counts_are_clamped(self):
        data = encode_component(0, np.array([[50]]), 0, 20)
        counts = decode_within(data, TransformParameters(32, 256), 32, 1, ONE, 0, -5, 20)[:, 0]
        assert counts.max() == 20 and counts.min() >= -5


@built
class TestTwins:
    @given(integers(), codings)
    def test_coded_bytes(self, case, coding):
        m, rows, span = case
        packet = encode_component(-3, rows, *coding)
        assert packet == by_the_twin(codec, encode_component, -3, rows, *coding)
        assert decoded(packet, m, span) == by_the_twin(codec, decoded, packet, m, span)

    @given(integers(2**33), codings, st.sampled_from([0, 90, 1000]), st.integers(0, 2**32))
    def test_the_trellis(self, case, coding, weight, seed):
        _, rows, _ = case
        noise = np.random.default_rng(seed).integers(0, 512, rows.shape)
        targets = np.minimum(np.abs(rows) * 512 + noise, 2**42 - 1)
        found = trellis(targets, *coding, weight)
        expected = by_the_twin(encoder, trellis, targets, *coding, weight)
        assert found.magnitudes.tolist() == expected.magnitudes.tolist()
        assert found.seen.tolist() == expected.seen.tolist()
        assert (found.errors, found.bits) == (expected.errors, expected.bits)
        assert found.cost(3) == found.errors + 3 * found.bits
        assert isinstance(found, Quantised) and found.seen.sum() == targets.size

    @pytest.mark.parametrize("size", codec.BLOCKS)
    def test_small_and_large_levels_of_whole_blocks(self, size):
        """Sums of 16-bit products, whose table ends at 32767, and sums of doubles."""
        rng = np.random.default_rng(size)
        for scale, weights in [(0.3, b""), (5, b""), (5, b"\x20\x30"), (900, b"")]:
            rows = np.rint(rng.laplace(size=(9, size)) * scale).astype(np.int64)
            packet = encode_component(7, rows, 0xD2, 20)
            parameters = TransformParameters(size, 2999, weights)
            given = packet, parameters, 9 * size - 5, 1, ONE, 0, *WIDE
            found = decode_within(*given)
            assert found.tolist() == by_the_twin(codec, decode_within, *given).tolist()

    def test_magnitudes_of_34_bits_are_refused(self):
        for twin in (True, False):
            call = (lambda f, *a: by_the_twin(codec, f, *a)) if twin else lambda f, *a: f(*a)
            with pytest.raises(ValueError, match="2\\^34"):
                call(encode_component, 0, np.array([[2**34]]), 0, 0)

    def test_the_loops_refuse_other_arguments(self):
        loops = codec.compiled
        steps, out = np.ones(3, np.int64), np.zeros(40, np.int32)
        window = codec.window(32)
        good = [b"\0" * 8, codec.tiles(32), codec.pairs(32), window, steps, 0, 0, 0, -5, 5, out]
        assert loops.mdct_decode(*good)[0] in codec.STATUS
        for place, bad in [
            (1, codec.tiles(64)), (2, codec.pairs(64)), (3, window[:, :8].copy()), (3, -window),
            (4, steps * 0), (4, steps[:0]), (4, np.ones(33, np.int64)), (5, 256), (6, 164),
            (7, 2**33), (8, 6),
        ]:  # fmt: skip
            with pytest.raises(ValueError, match="not a transform"):
                loops.mdct_decode(*[bad if i == place else x for i, x in enumerate(good)])
        seen = np.zeros((2, 36, 16), np.int64)
        targets = np.ones((2, 3), np.int64)
        for bad in (targets - 2, targets << 42, targets[:, :2].copy()):
            with pytest.raises(ValueError, match="not targets"):
                loops.mdct_trellis(bad, 3, 0, 0, 90, np.zeros((2, 3), np.int64), seen)
        for count, levels in [(3, targets << 34), (0, targets), (4, targets)]:
            with pytest.raises(ValueError, match="not levels"):
                loops.mdct_encode(levels, count, 0, 0, bytearray(99))


class TestEncoder:
    @pytest.mark.parametrize("size", BLOCKS)
    def test_the_error_is_that_of_the_step(self, size):
        """At high rates: 0.26 squares of the step for each coefficient, and less than 0.35."""
        x = np.random.default_rng(size).normal(0, 3000, 4 * size + 3)
        given = TransformParameters(size, 256 * 40)
        data = encode_row(x, given)
        y = decode_within(data, given, x.size, 1, ONE, 0, *WIDE)[:, 0]
        unit = 40**2 * size / 2
        assert 0.2 * unit < ((y - x) ** 2).mean() < 0.35 * unit

    @pytest.mark.parametrize("columns", [1, 2, 3])
    def test_last_coefficients_that_become_0_leave_the_others_alone(self, columns):
        """Each 0 that is coded changes the state of the quantisers too."""
        coefficients = np.zeros((9, 32))
        coefficients[:, : columns + 1] = np.random.default_rng(columns).normal(0, 999, columns + 1)
        coefficients[4, columns:] = 1.02 * 256
        data = encoder.encode_coefficients(0, coefficients, TransformParameters(32, 256))
        header, at = codec.parse_header(data, 32, ONE, 0)
        decoded = np.zeros((9, 32))
        steps = [256] * header.kept
        codec.decode_coefficients(data[at:], steps, header.classes, header.start, decoded, at)
        assert np.abs(decoded - coefficients).max() <= 2 * 256 and header.kept < 32

    def test_silence_takes_two_bytes(self):
        assert encode_row(np.full(5000, 7.0), TransformParameters(64, 100)) == b"\x0e\0"

    def test_what_the_codec_cannot_hold(self):
        for x in (np.array([0, 2.0**31, 0, -(2.0**31)] * 400), np.array([0, 1e300, 0.0])):
            with pytest.raises(ValueError, match="2\\^36"):
                encode_row(x, TransformParameters(512, 256))
