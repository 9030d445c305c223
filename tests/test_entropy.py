"""Clause 9.4: classes, lengths, sections and their ends, against the page."""

from __future__ import annotations

import hashlib

import page
import page_coding
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.codecs import entropy
from hapfmt.codecs.entropy import (
    ByBits,
    Decoder,
    Encoder,
    Lengths,
    Signs,
    put_bits,
    put_integers,
)
from hapfmt.errors import FormatError

magnitudes = st.sampled_from([0, 1, 9, 10, 43, 44, 45, 2**10, 2**31, 2**34 - 1]) | st.integers(
    0, 300
)
integers = st.builds(lambda u, sign: sign * u, magnitudes, st.sampled_from([1, -1]))
rows = st.lists(integers, max_size=40) | st.tuples(st.lists(integers, max_size=4), integers).map(
    lambda pair: [pair[1]] * 60 + pair[0]
)
bits = st.lists(st.integers(0, 1), max_size=80)


def coded(row, marks):
    """(coded bytes, what they are coded by)"""
    coder = Encoder()
    p = put_bits(coder, marks)
    signs = Signs.of(row)
    way = put_integers(coder, row, signs=not signs.pay)
    if signs.pay:
        signs.put(coder)
    return coder.finish(), p, way, signs.probabilities if signs.pay else b"", coder.many


def read(data, sizes, p, way, signs, many):
    coder = Decoder(data, 0, 4 if many else 1)
    marks = coder.bits(sizes[1], p)
    row = coder.integers(sizes[0], *way, signs=not signs)
    row = coder.signed(row, signs) if signs else row
    coder.finish()
    return list(row), list(marks)


def read_as_the_page_says(data, sizes, p, way, signs, many):
    coder = page.Coder(data, 4 if many else 1)
    marks = page_coding.code_bits(coder, sizes[1], p)
    row = page_coding.code_integers(coder, sizes[0], *way, not signs)
    row = page_coding.code_signs(coder, [abs(e) for e in row], signs) if signs else row
    coder.finish()
    return row, marks


def told(call, *arguments):
    try:
        return call(*arguments)
    except FormatError as error:
        return error.requirement
    except page.BrokenRule as rule:
        return str(rule)


def learnt(row, signs):
    coder = Encoder(many_pay=False)
    ByBits.of(row, signs=signs).put(coder)
    return coder.finish()


def read_by_bits(data, size, signs):
    coder = Decoder(data, 0, 1)
    row = coder.by_bits(size, signs=signs)
    coder.finish()
    return list(row)


def read_by_bits_as_the_page_says(data, size, signs):
    coder = page.Coder(data)
    row = page_coding.code_by_bits(coder, size, signs)
    coder.finish()
    return row


class TestByBits:
    @given(rows, st.booleans(), st.data())
    def test_as_the_page_says(self, row, signs, data):
        row = row if signs else [abs(e) for e in row]
        whole, coder = learnt(row, signs), page.Coder()
        page_coding.code_by_bits(coder, len(row), signs, row)
        assert whole == coder.finish()
        assert read_by_bits(whole, len(row), signs) == row
        wrong = bytearray(whole)
        at = data.draw(st.integers(0, len(wrong)))
        wrong[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        given_ = bytes(wrong), len(row) + data.draw(st.integers(0, 1)), signs
        assert told(read_by_bits, *given_) == told(read_by_bits_as_the_page_says, *given_)

    @given(st.binary(max_size=40), st.integers(0, 60), st.booleans())
    def test_any_bytes(self, data, size, signs):
        given_ = data, size, signs
        assert told(read_by_bits, *given_) == told(read_by_bits_as_the_page_says, *given_)

    def test_what_the_decoder_expects_is_cheap(self):
        """The cost that an encoder compares is that of the bytes: zeros, steps, and any numbers."""
        for row in ([0] * 5000, [0, 0, 0, 1, 0, 0, -1] * 500, [9, -300, 2**20, 4] * 300):
            found = ByBits.of(row, signs=True)
            assert 8 * len(learnt(row, True)) <= found.cost / 256 * 1.01 + 48
        assert len(learnt([0] * 5000, True)) < 12

    def test_a_few_bytes_ask_for_little(self):
        with pytest.raises(FormatError, match=r"RNG-00[13]"):
            Decoder(b"\xff" * 40, 0, 1).by_bits(1 << 24, signs=True)


class TestClasses:
    @pytest.mark.parametrize("number", range(16))
    def test_as_the_page_says(self, number):
        for context in range(36):
            ends = entropy.ends_of(number, context)
            assert list(ends) == page.class_ends(number, context)
            assert all(a < b for a, b in zip((0, *ends), ends, strict=False))
            assert ends[-1] == entropy.SCALE

    def test_digest(self):
        whole = b"".join(
            end.to_bytes(2, "little")
            for number in range(16)
            for context in range(36)
            for end in entropy.ends_of(number, context)
        )
        assert hashlib.sha256(whole).hexdigest() == page_coding.DIGEST
        assert list(map(tuple, page.CLASSES)) == list(entropy.ROWS)

    @given(st.lists(st.integers(0, 255), min_size=1, max_size=64).filter(any))
    def test_lengths_as_the_page_says(self, weights):
        """RNG-004: What a packet says of how its symbols are coded MUST be whole. Bits without a meaning MUST be 0, no probability 0, and a start byte at most 163. In a table of lengths n is at least 1, and `first` + n at most 64. At least one weight is more than 0. No x has more than 32 probabilities of ranks (9.7)."""
        lengths = Lengths(0, bytes(weights))
        assert list(lengths.ends) == page_coding.length_ends(weights)
        data = lengths.build()
        assert Lengths.parse(data + b"\7") == lengths
        for wrong in (data[:-1], bytes([65 - len(weights)]) + data[1:], bytes(len(data)), b""):
            assert Lengths.parse(wrong) is None


class TestSections:
    @given(rows, bits)
    def test_come_back(self, row, marks):
        data, *ways = coded(row, marks)
        sizes = len(row), len(marks)
        assert read(data, sizes, *ways) == read_as_the_page_says(data, sizes, *ways) == (row, marks)

    def test_four_states(self):
        row = [(-1) ** i * (i % 300) for i in range(5000)]
        data, *ways = coded(row, [1, 0] * 300)
        assert ways[-1]
        assert read(data, (5000, 600), *ways) == (row, [1, 0] * 300)

    @given(rows, bits, st.data())
    def test_mutated(self, row, marks, data):
        """
        RNG-001: After the last symbol every state MUST be 65536. The first states, the words, and the raw bits, filled to whole bytes with bits 0, MUST take up exactly the coded bytes. A decoder that has taken more than these bytes stops at the latest after the batch, or outside batches after the integer or bit. What it reads beyond them is 0.
        RNG-003: The magnitude u of an integer by class or by bits MUST be less than 2^34. Its k by bits is at most 35.
        """
        whole, p, way, signs, many = coded(row, marks)
        wrong = bytearray(whole)
        at = data.draw(st.integers(0, len(wrong)))
        wrong[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
        sizes = len(row) + data.draw(st.integers(0, 1)), len(marks)
        given_ = bytes(wrong), sizes, p, way, signs, many
        assert told(read, *given_) == told(read_as_the_page_says, *given_)

    @given(st.binary(max_size=40), st.integers(0, 60), st.integers(0, 15), st.integers(0, 163))
    def test_any_bytes(self, data, size, number, start):
        given_ = data, (size, 5), bytes([1, 128, 200, 255]), (number, start), b"\x80\1\xff", False
        assert told(read, *given_) == told(read_as_the_page_says, *given_)

    @given(rows)
    def test_lengths_come_back(self, row):
        lengths, coder = Lengths.of(row), Encoder()
        entropy.put_by_length(coder, row, lengths)
        decoder = Decoder(coder.finish(), 0, 1)
        decoder.section()
        assert [decoder.by_length(lengths) for _ in row] == row
        decoder.finish()

    def test_what_has_no_code(self):
        with pytest.raises(ValueError, match="2\\^34"):
            put_integers(Encoder(), [2**34], signs=True)

    def test_a_few_bytes_ask_for_little(self):
        """The least that a symbol takes is 0.005 bits: some thousand ticks a byte, no more."""
        for number in range(16):
            with pytest.raises(FormatError, match=r"RNG-00[13]"):
                Decoder(b"\xff" * 40, 0, 1).integers(1 << 24, number, 0, signs=True)
