"""Clause 2: rdiv, clamp, varint and svarint, one by one and in rows."""

from __future__ import annotations

from fractions import Fraction
from math import floor

import numpy as np
import pytest
import strategies
from forge import svarint, varint
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.codecs.knots import build_varints, from_signed, parse_varints, to_signed
from hapfmt.errors import FormatError
from hapfmt.numbers import build_svarint, build_varint, clamp, parse_varint, rdiv

pytestmark = pytest.mark.capped

FROZEN = {
    0: "00", 1: "01", 127: "7F", 128: "8001", 300: "AC02", 16383: "FF7F", 16384: "808001",
    2**53 - 1: "FFFFFFFFFFFFFF0F",
}  # fmt: skip


def slow_varints(data: bytes) -> list[int] | None:
    """SPEC's sentences, byte by byte; None where they are broken."""
    values, value, size = [], 0, 0
    for byte in data:
        value += (byte & 0x7F) * 128**size
        size += 1
        if byte >= 0x80:
            continue
        if size > 8 or value >= 2**53 or (byte == 0 and size > 1):
            return None
        values.append(value)
        value, size = 0, 0
    return values if size == 0 else None


@given(st.integers(-(2**58), 2**58), st.integers(1, 2**33))
def test_rdiv_rounds_to_nearest(n, d):
    """
    CNV-001: A decoder MUST compute every count with the integer arithmetic of this clause, or with one that gives the same integers.
    """
    assert rdiv(n, d) == floor(Fraction(n, d) + Fraction(1, 2))


def test_rdiv_ties_go_up():
    assert [rdiv(1, 2), rdiv(-1, 2), rdiv(-3, 2)] == [1, 0, -1]


@given(st.integers(), st.integers(), st.integers(0))
def test_clamp(x, low, extent):
    assert clamp(x, low, low + extent) == sorted((low, x, low + extent))[1]


@pytest.mark.parametrize(("value", "text"), FROZEN.items())
def test_frozen_varints(value, text):
    data = bytes.fromhex(text)
    assert build_varint(value) == build_varints(np.array([value])) == data
    assert parse_varint(data, 0) == (value, len(data))


@given(strategies.varints, st.binary(max_size=3), st.binary(max_size=3))
def test_a_varint_comes_back(value, before, after):
    """
    CNV-002: A varint MUST be less than 2^53, at most 8 bytes long, and minimal: its last byte is not 0 unless it is its only byte.
    """
    data = build_varint(value)
    assert data == varint(value)
    assert len(data) <= 8
    assert parse_varint(before + data + after, len(before)) == (value, len(before + data))


@pytest.mark.parametrize("value", [-1, 2**53])
def test_numbers_that_no_varint_holds(value):
    with pytest.raises(ValueError, match="out of range"):
        build_varint(value)


@given(st.lists(strategies.varints))
def test_rows_come_back(values):
    data = build_varints(np.array(values, np.int64))
    assert data == b"".join(map(varint, values))
    assert parse_varints(data, 0).tolist() == values


@given(st.lists(strategies.svarints))
def test_signed_rows_come_back(values):
    numbers = from_signed(np.array(values, np.int64))
    assert to_signed(numbers).tolist() == values
    assert build_varints(numbers) == b"".join(map(svarint, values))
    assert b"".join(map(build_svarint, values)) == b"".join(map(svarint, values))


any_bytes = st.binary(max_size=40) | st.lists(
    st.sampled_from([0, 1, 0x7F, 0x80, 0xFF]), max_size=40
).map(bytes)


@given(any_bytes)
def test_any_bytes_are_read_as_the_page_says(data):
    """
    CNV-002: A varint MUST be less than 2^53, at most 8 bytes long, and minimal: its last byte is not 0 unless it is its only byte.
    """
    expected = slow_varints(data)
    if expected is None:
        with pytest.raises(FormatError):
            parse_varints(data, 0)
    else:
        assert parse_varints(data, 0).tolist() == expected


@given(any_bytes)
def test_one_by_one_is_as_in_rows(data):
    position, values = 0, []
    try:
        while position < len(data):
            value, position = parse_varint(data, position)
            values.append(value)
    except FormatError:
        values = None
    assert values == slow_varints(data)
