"""Clause 9.5, flag Rice: packets against the page, and which predictor they get."""

from __future__ import annotations

import numpy as np
import page
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st
from test_codecs_predicted import decoded, decoded_as_the_page_says
from test_kernels import assert_same
from twins import built

import hapfmt
from hapfmt.codecs.grids import LpcParameters
from hapfmt.codecs.predicted import INDEX_LIMIT, Predictor, encode_indices
from hapfmt.codecs.rice import WIDTH_LIMIT, RiceReader, RiceWriter
from hapfmt.encoder.quick import PIECE, choose_quick, encode_quick, quick_autocorrelation
from hapfmt.errors import FormatError, ParameterError
from hapfmt.integers import from_signed
from hapfmt.kernels import compiled

pytestmark = pytest.mark.capped

widths = st.lists(st.integers(0, 31), min_size=1, max_size=4)
errors = st.sampled_from([0, 0, 1, -1, 2**34 - 1, -(2**34)]) | st.integers(-(2**34), 2**34 - 1)
FROZEN = [
    ([0, 1, 4, 9, 16, 25, 36, 49], Predictor(2, (), 0, rice=True), "8200000c88888880"),
    ([5, 5, 5, 6, 5, 5, -90, 5], Predictor(0, (), 5, rice=True), "80000a0030842508000ec0"),
]  # fmt: skip


def of_errors(data, count):
    """Errors, or the id of the rule that was broken."""
    reader = RiceReader(data, 0)
    try:
        found = [reader.decode() for _ in range(count)]
        reader.finish()
    except FormatError as error:
        return error.requirement
    return found


class TestCodes:
    @given(st.lists(errors, min_size=1, max_size=70), widths)
    def test_any_widths(self, row, widths):
        """A decoder takes the widths as they come."""
        model = page.Rice(widths=widths)
        for e in row:
            model.code(None, e)
        data = model.end()
        assert of_errors(data, len(row)) == row
        for size in range(0, len(data), 7):
            assert of_errors(data[:size], len(row)) != row

    @given(st.lists(errors, min_size=1, max_size=70))
    def test_what_the_writer_says(self, row):
        writer = RiceWriter()
        for e in row:
            writer.encode(e)
        reader = page.Rice(writer.finish())
        assert [reader.code(None) for _ in row] == row
        assert reader.finish() is None

    @pytest.mark.parametrize("e", [2**34, -(2**34) - 1])
    def test_errors_of_35_bits_are_not_coded(self, e):
        with pytest.raises(ValueError, match="2\\^34"):
            RiceWriter().encode(e)

    @given(st.integers(0, 31), st.integers(0, 40))
    def test_a_width_near_the_best(self, width, seed):
        """No other width makes a block much smaller."""
        scale = (1 << width) / 3
        row = np.rint(np.random.default_rng(seed).laplace(0, scale, 32)).astype(np.int64).tolist()
        sizes = []
        for w in range(1, WIDTH_LIMIT + 1):
            model = page.Rice(widths=[w])
            model.errors = row
            model.end()
            sizes.append(len(model.bits) - from_signed(w) - 1)
        writer = RiceWriter()
        for e in row:
            writer.encode(e)
        writer.finish()
        assert writer.count <= min(sizes) * 1.05 + 2 * WIDTH_LIMIT + 1


class TestPackets:
    @given(strategies.index_arrays(), strategies.predictors(), st.data())
    def test_any_widths(self, indices, predictor, data):
        """
        LPC-010: With flag *Rice* the flags *repeats* and *references* MUST be 0.
        LPC-011: Every w MUST be at least 0 and at most 31.
        LPC-012: The last bit that is read MUST lie in the last byte of the component packet, and the bits after it MUST be 0: a decoder takes bits behind the end for 0, and stops at the latest with the block that read one.
        """
        row = indices[:70].tolist()
        g, ks, base = predictor.difference, predictor.reflections, predictor.base
        try:
            packet = page.encode(row, g, ks, base, rice=True, widths=data.draw(widths))
        except page.BrokenRule:
            return
        assert decoded(packet, len(row)) == row
        at = data.draw(st.integers(0, len(packet) - 1))
        mutated = packet[:at] + data.draw(st.binary(max_size=2)) + packet[at + 1 :]
        for limit in (3, INDEX_LIMIT):
            expected = decoded_as_the_page_says(mutated, len(row), limit)
            assert decoded(mutated, len(row), limit) == expected

    @given(
        st.sampled_from([b"\x80\0\0", b"\x84\0\0", b"\x81\3\x50\xc0\x20\0", b"\x88\0\0"]),
        st.lists(st.sampled_from([0, 0, 0, 1, 0x80, 0xFF, 0x48]), max_size=30).map(bytes),
        st.integers(1, 40),
    )
    def test_any_bytes(self, header, coded, span):
        packet = header + coded
        assert decoded(packet, span) == decoded_as_the_page_says(packet, span)

    @pytest.mark.parametrize(("indices", "predictor", "text"), FROZEN)
    def test_frozen_bitstreams(self, indices, predictor, text):
        assert encode_indices(np.array(indices), predictor).hex() == text
        assert decoded(bytes.fromhex(text), len(indices)) == indices


class TestQuick:
    @given(strategies.index_arrays())
    def test_whatever_is_chosen_comes_back(self, indices):
        assert decoded(encode_quick(indices), indices.size) == indices.tolist()

    def test_an_error_that_was_not_looked_at(self):
        x = np.zeros(3000, np.int64)
        x[::2] = 1000
        x[400:402] = INDEX_LIMIT, -INDEX_LIMIT
        assert decoded(encode_quick(x), x.size) == x.tolist()

    def test_a_sine_takes_few_coefficients(self):
        x = np.rint(1000 * np.sin(np.arange(9000) * 0.7)).astype(np.int64)
        assert 2 <= len(choose_quick(x).reflections) <= 12
        assert len(encode_quick(x)) < x.size * 3 / 8

    def test_a_line_is_a_polynomial(self):
        assert choose_quick(np.arange(50) * 7 + 3) == Predictor(2, (), 3, rice=True)

    def test_loud_pieces_do_not_drown_quiet_ones(self):
        """The correlation is that of most of the signal, not that of its loudest piece."""
        generator = np.random.default_rng(5)
        quiet = np.cumsum(generator.integers(-9, 10, 3 * PIECE))
        loud = generator.integers(-90000, 90001, PIECE)
        r = quick_autocorrelation(np.concatenate((quiet, loud)))
        assert abs(r[1] / r[0]) < 0.2


@built
class TestTwins:
    @given(strategies.index_arrays(), st.sampled_from([1, 9, 40]))
    def test_choice(self, indices, times):
        x = np.tile(indices, times)
        predictor = assert_same(choose_quick, x)
        assert predictor.base == x[0]
        assert_same(encode_quick, x)

    @pytest.mark.parametrize("size", [1, 2, 31, 32, 33, 1023, 1025, 4097, 9000])
    def test_sizes(self, size):
        x = np.random.default_rng(size).normal(0, 40, size).cumsum().astype(np.int64)
        data = assert_same(encode_quick, x)
        assert assert_same(decoded, data, size) == x.tolist()

    def test_a_packet_larger_than_its_first_buffer(self):
        x = np.random.default_rng(1).integers(-INDEX_LIMIT, INDEX_LIMIT, 500)
        assert len(assert_same(encode_quick, x)) > 2 * x.size + 64

    def test_arguments(self):
        with pytest.raises(ValueError, match="arrays"):
            compiled.rice_decode(b"", np.zeros(33, np.int32), 0, 0, 5, np.zeros(4, np.int64))
        with pytest.raises(ValueError, match="chosen"):
            compiled.quick_predictor(*[np.zeros(0)] * 6)
        with pytest.raises(ValueError, match="as many counts"):
            compiled.clamp_counts(np.zeros(3, np.int64), 1, 0, 0, 9, np.zeros(2, np.int32))


@given(strategies.index_arrays(9999), st.integers(1, 1000), st.integers(-(2**31), 2**31 - 1))
def test_clamped_counts(indices, step, zero):
    """The compiled loop clamps as the readable one (DEC-001)."""
    if compiled is None:
        return
    low, high = -(2**31), 2**30
    out = np.empty(indices.size, np.int32)
    compiled.clamp_counts(indices, step, zero, low, high, out)
    counts = LpcParameters(step, zero).counts(indices, 1 << 32)
    assert (out == counts.clip(low, high)).all()


class TestPreset:
    def recording(self):
        x = np.random.default_rng(2).normal(0, 40, 900).cumsum().astype(np.int32)
        channel = hapfmt.Channel(x, 1000, calibration=hapfmt.Calibration(1, 0, 100))
        return hapfmt.Recording((channel,))

    def test_lossless(self, tmp_path):
        path, recording = tmp_path / "fast.hapf", self.recording()
        summary = hapfmt.write(recording, path, hapfmt.Settings.of("lossless", fast=True))
        assert summary.decisions[0].reason == "lossless, fast"
        back = hapfmt.read(path)
        assert (back.channels[0].stored == recording.channels[0].stored).all()
        assert back.metadata["encoder"].endswith(": lossless --fast")
        assert hapfmt.verify(path, against=recording).verdict == "intact"

    @pytest.mark.parametrize("preset", ["near-lossless", "perceptual", "paper"])
    def test_of_lossless_only(self, preset):
        with pytest.raises(ParameterError, match="lossless"):
            hapfmt.Settings.of(preset, fast=True)
