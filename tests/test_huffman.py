"""Clause 9.2: code word lengths, the codebook in nibbles, canonical code words."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.codecs.quantised import (
    Codebook,
    build_codebook,
    code_lengths,
    pack_bits,
    parse_codebook,
    read_bits,
)
from hapfmt.errors import FormatError

pytestmark = pytest.mark.capped


def slow_lengths(data: bytes, symbols: int) -> list[int] | None:
    """SPEC's sentences, nibble by nibble; None where they are broken."""
    nibbles = [int(digit, 16) for digit in data.hex()]
    lengths: list[int] = []
    while nibbles:
        nibble = nibbles.pop(0)
        if nibble:
            lengths.append(nibble)
        elif nibbles:
            lengths += [0] * (nibbles.pop(0) + 1)
    if len(lengths) > symbols:
        return None
    used = [length for length in lengths if length]
    if used != [1] and sum(Fraction(1, 2**length) for length in used) != 1:
        return None
    return lengths + [0] * (symbols - len(lengths))


def slow_codes(lengths: list[int]) -> dict[int, str]:
    """Symbol -> its bits: the first all zeros, each next one more, shifted by the difference."""
    codes, code, before = {}, 0, 0
    for number, (length, symbol) in enumerate(sorted((n, s) for s, n in enumerate(lengths) if n)):
        code = (code + 1 if number else 0) << (length - before if number else 0)
        codes[symbol], before = f"{code:0{length}b}", length
    return codes


frequencies = st.lists(st.sampled_from([0, 0, 1, 2, 3, 1 << 40]) | st.integers(0, 50), min_size=1)


class TestLengths:
    @given(frequencies)
    def test_are_complete(self, weights):
        lengths = code_lengths(np.array(weights, np.int64))
        assert [bool(x) for x in lengths] == [bool(x) for x in weights]
        if sum(map(bool, weights)) > 1:
            assert sum(Fraction(1, 2 ** int(x)) for x in lengths if x) == 1

    @given(st.lists(st.integers(1, 30), min_size=2, max_size=12))
    def test_the_rarer_is_never_shorter(self, weights):
        lengths = code_lengths(np.array(weights, np.int64))
        pairs = sorted(zip(weights, lengths.tolist(), strict=True), key=lambda p: (p[0], -p[1]))
        assert all(a[1] >= b[1] for a, b in pairwise(pairs))

    def test_fibonacci_weights_stop_at_15_bits(self):
        weights = [1, 1]
        while len(weights) < 40:
            weights.append(weights[-1] + weights[-2])
        lengths = code_lengths(np.array(weights, np.int64))
        assert lengths.max() == 15


class TestCodebook:
    @given(frequencies)
    def test_comes_back(self, weights):
        lengths = code_lengths(np.array(weights, np.int64))
        if lengths.any():
            data = build_codebook(lengths)
            assert parse_codebook(data, lengths.size, 0).tolist() == lengths.tolist()

    @given(
        st.binary(max_size=6)
        | st.lists(st.sampled_from([0x11, 0x10, 0x01, 0x22, 0x00])).map(bytes),
        st.integers(1, 40),
    )
    def test_any_bytes_are_read_as_the_page_says(self, data, symbols):
        """
        QNT-003: The codebook MUST describe at most the symbols above. Its code words are complete: over the symbols that have one, 2^-length adds up to 1. Or exactly one symbol has one, of length 1.
        """
        expected = slow_lengths(data, symbols)
        if expected is None:
            with pytest.raises(FormatError):
                parse_codebook(data, symbols, 0)
        else:
            assert parse_codebook(data, symbols, 0).tolist() == expected

    @given(strategies.quan_parameters())
    def test_code_words_are_canonical(self, parameters):
        codes = slow_codes(parameters.lengths.tolist())
        book = parameters.book
        assert {s: f"{int(book.codes[s]):0{int(book.lengths[s])}b}" for s in codes} == codes
        ordered = sorted(codes.values())
        assert not any(b.startswith(a) for a, b in pairwise(ordered))

    def test_frozen(self):
        lengths = parse_codebook(bytes.fromhex("3231"), 4, 0)
        book = Codebook(lengths, np.array([0, 0, 0, 1]))
        assert lengths.tolist() == [3, 2, 3, 1]
        assert book.codes.tolist() == [0b110, 0b10, 0b111, 0b0]
        assert build_codebook(lengths).hex() == "3231"

    def test_skipped_symbols(self):
        lengths = [0] * 20 + [1] + [0] * 3 + [1] + [0] * 9
        data = build_codebook(np.array(lengths))
        assert data.hex() == "0f031021" or data.hex() == "0f03102100"
        assert parse_codebook(data, len(lengths), 0).tolist() == lengths


fields = st.lists(
    st.integers(0, 33).flatmap(lambda n: st.tuples(st.integers(0, (1 << n) - 1), st.just(n)))
)


class TestBits:
    @given(fields)
    def test_pack_and_read(self, pairs):
        values = np.array([value for value, _ in pairs], np.int64)
        widths = np.array([width for _, width in pairs], np.int64)
        data = pack_bits(values, widths)
        text = "".join(f"{value:0{width}b}" if width else "" for value, width in pairs)
        text += "0" * (-len(text) % 8)
        assert data == bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))
        assert read_bits(data, np.cumsum(widths) - widths, widths).tolist() == values.tolist()

    def test_beyond_the_data_are_zeros(self):
        assert read_bits(b"\xff", np.array([4, 100]), np.array([8, 33])).tolist() == [0xF0, 0]

    @pytest.mark.parametrize("size", [65535, 65536, 65537])
    def test_blocks(self, size):
        ones = np.ones(size, np.int64)
        assert pack_bits(ones, ones) == bytes(np.packbits(ones.astype(bool)))
