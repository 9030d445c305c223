"""Clause 9.2: quantised levels, against a decoder that reads bit by bit."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import strategies
from forge import quan_parameters
from hypothesis import given
from hypothesis import strategies as st
from test_huffman import slow_codes

from hapfmt.codecs.quantised import (
    BLOCK_SIZE,
    Alphabet,
    QuanParameters,
    code_lengths,
    decode_levels,
    decode_quantised,
    encode_quantised,
    quantise,
)
from hapfmt.errors import FormatError, TruncatedError
from hapfmt.limits import LEVELS
from hapfmt.numbers import rdiv

pytestmark = pytest.mark.capped

ONE, TWO = LEVELS[1], LEVELS[2]


def slow_levels(data: bytes, parameters: QuanParameters, total: int) -> list[int] | None:
    """Levels in the order of the packet; None where a rule is broken."""
    alphabet = parameters.alphabet
    m, r = alphabet.direct_levels, alphabet.run_classes
    codes = {bits: s for s, bits in slow_codes(parameters.lengths.tolist()).items()}
    if len(codes) == 1:
        codes = {"": next(iter(codes.values()))}
    row = "".join(f"{byte:08b}" for byte in data)
    out: list[int] = []
    at = 0
    while len(out) < total:
        word = ""
        while word not in codes:
            if at >= len(row) or len(word) > 15:
                return None
            word, at = word + row[at], at + 1
        symbol = codes[word]
        j = symbol - 2 * m if symbol <= 2 * m + r else symbol - (2 * m + r + 1)
        width = 0 if symbol <= 2 * m else j if symbol <= 2 * m + r else j + 1
        if at + width > len(row):
            return None
        extra, at = int(row[at : at + width] or "0", 2), at + width
        if symbol == 0:
            out.append(0)
        elif symbol <= 2 * m:
            out.append((symbol + 1) // 2 if symbol % 2 else -(symbol // 2))
        elif symbol <= 2 * m + r:
            if 2**j + extra > total - len(out):
                return None
            out += [0] * (2**j + extra)
        else:
            magnitude = m + 2**j + extra // 2
            out.append(-magnitude if extra % 2 else magnitude)
    if len(row) - at >= 8 or "1" in row[at:]:
        return None
    return out


def decoded(data, parameters, total):
    try:
        return decode_levels(data, parameters, total, 0).tolist()
    except FormatError:
        return None


@st.composite
def cases(draw):
    alphabet = draw(strategies.alphabets)
    array = draw(strategies.level_arrays(alphabet))
    return array, draw(strategies.books_for(alphabet, array))


class TestParameters:
    @given(strategies.quan_parameters())
    def test_come_back(self, parameters):
        """
        QNT-001: `step` MUST be at least 1 and at most what the level of the file allows; `2M + R + C + 1` is at most 4096, R at most 24 and C at most 32.
        """
        back = QuanParameters.parse(parameters.build(), TWO, 0)
        assert (back.step, back.alphabet) == (parameters.step, parameters.alphabet)
        assert back.lengths.tolist() == parameters.lengths.tolist()

    @given(st.binary(max_size=20))
    def test_any_bytes(self, data):
        try:
            parameters = QuanParameters.parse(data, ONE, 0)
        except FormatError:
            return
        assert 1 <= parameters.step <= ONE.step
        assert parameters.alphabet.size <= 4096

    def test_largest_alphabet(self):
        parameters = QuanParameters.parse(quan_parameters(b"\x11", m=2047, r=1), ONE, 0)
        assert parameters.alphabet.size == 4096


class TestDecoding:
    @given(cases())
    def test_levels_come_back(self, case):
        array, parameters = case
        data = encode_quantised(array, parameters)
        flat = array.T.reshape(-1).tolist()
        assert decoded(data, parameters, array.size) == flat
        assert slow_levels(data, parameters, array.size) == flat

    @given(cases(), st.data())
    def test_mutated(self, case, data):
        """
        COD-001: A decoder MUST use all bytes of a packet, and report an error where bytes are missing or left over.
        QNT-004: Runs MUST NOT pass the end of the last component. The packet ends with the byte that contains the last bit, and the bits that fill it are 0.
        """
        array, parameters = case
        packet = bytearray(encode_quantised(array, parameters))
        at = data.draw(st.integers(0, len(packet)))
        packet[at : at + data.draw(st.integers(0, 1))] = data.draw(st.binary(max_size=1))
        total = data.draw(st.sampled_from([array.size, array.size + 1, max(array.size - 1, 1)]))
        expected = slow_levels(bytes(packet), parameters, total)
        assert decoded(bytes(packet), parameters, total) == expected

    @given(st.binary(max_size=12), strategies.quan_parameters(ONE), st.integers(1, 100))
    def test_any_bytes(self, data, parameters, total):
        assert decoded(data, parameters, total) == slow_levels(data, parameters, total)

    @given(cases(), st.integers(1, 1000))
    def test_counts_are_levels_times_step(self, case, step):
        """
        QNT-006: The magnitude of level times step MUST be at most twice the count bound (clause 12).
        """
        array, parameters = case
        parameters = QuanParameters(step, parameters.alphabet, parameters.lengths)
        data = encode_quantised(array, parameters)
        if np.abs(array).max() * step <= 2 * ONE.count_bound:
            got = decode_quantised(data, parameters, *array.shape, ONE, 0)
            assert got.tolist() == (array * step).tolist()
        else:
            with pytest.raises(FormatError, match="out of range"):
                decode_quantised(data, parameters, *array.shape, ONE, 0)

    @given(st.integers(-(2**32), 2**32), st.integers(1, 2**24))
    def test_quantise_is_within_half_a_step(self, e, step):
        level = int(quantise(np.array([e]), step)[0])
        assert level == rdiv(e, step)
        assert abs(2 * (e - level * step)) <= step

    @pytest.mark.parametrize("extra", [-1, 0, 1])
    def test_code_words_across_blocks(self, extra):
        """Words of 3 bits never end where a block of bytes does."""
        rng = np.random.default_rng(extra + 1)
        array = rng.integers(-3, 4, (8 * (BLOCK_SIZE + extra) // 3, 1))
        alphabet = Alphabet(3, 0, 0)
        parameters = QuanParameters(1, alphabet, np.array([3, 3, 3, 3, 3, 3, 2]))
        data = encode_quantised(array, parameters)
        assert np.array_equal(decode_levels(data, parameters, array.size, 0), array[:, 0])

    def test_long_run_across_components(self):
        alphabet = Alphabet(1, 4, 0)
        array = np.zeros((500, 3), np.int64)
        array[0, 0] = array[-1, -1] = 1
        symbols, _ = alphabet.tokenise(array.T.reshape(-1))
        parameters = QuanParameters(
            1, alphabet, code_lengths(np.bincount(symbols, minlength=alphabet.size))
        )
        data = encode_quantised(array, parameters)
        assert decode_quantised(data, parameters, 500, 3, ONE, 0).tolist() == array.tolist()


FROZEN = [
    ("02000000010001003231", "D740", [0, 1, -1, 0, 0, 0]),
    ("02000000010001003231", "00", [0, 0]),
    ("0100000000000010" + "10", "", [0] * 9),
    ("0100000000000003" + "2222", "52", [1, -2]),
]


@pytest.mark.parametrize(("parameters", "packet", "levels"), FROZEN)
def test_frozen_bitstreams(parameters, packet, levels):
    parsed = QuanParameters.parse(bytes.fromhex(parameters), ONE, 0)
    assert decoded(bytes.fromhex(packet), parsed, len(levels)) == levels
    assert encode_quantised(np.array(levels)[:, None], parsed).hex().upper() == packet


def test_a_run_that_is_cut_short_takes_no_memory():
    """One byte that promises a run of 2^25 zeros in a packet of one tick."""
    lengths = np.zeros(25, np.int64)
    lengths[[0, 24]] = 1
    parameters = QuanParameters(1, Alphabet(0, 24, 0), lengths)
    decode_levels(b"\x00", parameters, 8, 0)
    tracemalloc.start()
    with pytest.raises(TruncatedError):
        decode_levels(b"\xff", parameters, 1, 0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 22


def test_levels_without_a_word_are_refused():
    parameters = QuanParameters(1, Alphabet(1, 0, 0), np.array([1, 1, 0]))
    for levels in ([-1], [2]):
        with pytest.raises(ValueError, match="no code word"):
            encode_quantised(np.array([levels]), parameters)
