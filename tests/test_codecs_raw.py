"""Clause 9.3: byte planes, stored or deflated."""

from __future__ import annotations

import contextlib
import tracemalloc
import zlib

import numpy as np
import pytest
import strategies
from hypothesis import given
from hypothesis import strategies as st

from hapfmt.codecs.raw import APART, DTYPES, RawParameters, decode_raw, encode_raw
from hapfmt.errors import FormatError

pytestmark = pytest.mark.capped


def slow_words(planes: bytes, size: int, ticks: int, width: int, signed: bool) -> list[list[int]]:
    """Numbers [ticks][components] from the planes, byte by byte."""
    rows = []
    for tick in range(ticks):
        row = []
        for component in range(width):
            octets = bytes(planes[(component * size + i) * ticks + tick] for i in range(size))
            row.append(int.from_bytes(octets, "little", signed=signed))
        rows.append(row)
    return rows


def deflate(planes: bytes) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return b"\1" + packer.compress(planes) + packer.flush()


def bits_of(array: np.ndarray) -> list[list[int]]:
    if array.dtype.kind == "f":
        array = array.view(f"<u{array.dtype.itemsize}")
    return array.tolist()


@given(strategies.raw_arrays())
def test_numbers_come_back_bit_for_bit(case):
    kind, size, array = case
    data = encode_raw(array, size)
    back = decode_raw(data, RawParameters(size), kind, *array.shape, 0)
    assert back.dtype == (np.int32 if kind == "counts" else DTYPES[kind])
    assert bits_of(back) == bits_of(array)


@given(strategies.raw_arrays())
def test_as_the_page_says(case):
    """
    RAW-001: `word_size` MUST be 1, 2, 3 or 4 for counts, and the size of the number format for raw numbers.
    RAW-003: The method MUST be 0 or 1, with exactly `span * component_count * word_size` bytes. A DEFLATE stream is whole and ends with the packet; a decoder stops inflating at that size.
    """
    kind, size, array = case
    data = encode_raw(array, size)
    planes = data[1:] if data[0] == 0 else zlib.decompress(data[1:], -15)
    words = slow_words(planes, size, *array.shape, signed=kind in ("counts", "int64"))
    assert words == bits_of(array)
    assert RawParameters.parse(RawParameters(size).build(), kind, 0) == RawParameters(size)
    for method in (b"\0" + planes, deflate(planes)):
        back = decode_raw(method, RawParameters(size), kind, *array.shape, 0)
        assert bits_of(back) == bits_of(array)


@given(strategies.raw_arrays(), st.data())
def test_mutated(case, data):
    """
    RAW-003: The method MUST be 0 or 1, with exactly `span * component_count * word_size` bytes. A DEFLATE stream is whole and ends with the packet; a decoder stops inflating at that size.
    """
    kind, size, array = case
    packet = bytearray(encode_raw(array, size))
    at = data.draw(st.integers(0, len(packet)))
    packet[at : at + data.draw(st.integers(0, 2))] = data.draw(st.binary(max_size=2))
    try:
        back = decode_raw(bytes(packet), RawParameters(size), kind, *array.shape, 0)
    except FormatError:
        return
    planes = packet[1:] if packet[0] == 0 else zlib.decompress(bytes(packet[1:]), -15)
    words = slow_words(bytes(planes), size, *array.shape, signed=kind in ("counts", "int64"))
    assert words == bits_of(back)


@given(st.binary(max_size=20), st.integers(1, 5), st.integers(1, 3))
def test_any_bytes(data, ticks, width):
    with contextlib.suppress(FormatError):
        assert decode_raw(data, RawParameters(2), "counts", ticks, width, 0).shape == (ticks, width)


def test_inflating_stops_at_the_known_size():
    bomb = deflate(bytes(1 << 25))
    tracemalloc.start()
    with pytest.raises(FormatError, match="another length"):
        decode_raw(bomb, RawParameters(4), "counts", 10, 1, 0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


@pytest.mark.parametrize("cut", range(1, 9))
def test_a_deflate_stream_that_is_cut_short(cut):
    data = deflate(bytes(range(256)) * 4)
    with pytest.raises(FormatError):
        decode_raw(data[:-cut], RawParameters(1), "counts", 1024, 1, 0)


FROZEN = [
    ("counts", 2, "00" + "01FF" + "00FF", [[1], [-1]]),
    ("counts", 3, "00" + "00" + "00" + "80", [[-(2**23)]]),
    ("counts", 1, "00" + "0102" + "FDFE", [[1, -3], [2, -2]]),
    ("binary16", 2, "00" + "007F" + "3CC1", [[0x3C00], [0xC17F]]),
    ("uint64", 8, "00" + "01020304050607F8", [[0xF807060504030201]]),
]


@pytest.mark.parametrize(("kind", "size", "text", "numbers"), FROZEN)
def test_frozen_bitstreams(kind, size, text, numbers):
    data = bytes.fromhex(text)
    back = decode_raw(data, RawParameters(size), kind, len(numbers), len(numbers[0]), 0)
    assert bits_of(back) == numbers
    assert encode_raw(back, size) == data


def noise_and(low_bytes: int, ticks: int = APART) -> np.ndarray:
    """Words whose upper bytes are quiet, with noise below them."""
    rng = np.random.default_rng(low_bytes)
    quiet = rng.integers(0, 4, ticks).astype(np.uint64) << np.uint64(56)
    return (quiet | rng.integers(0, 1 << (8 * low_bytes), ticks, np.uint64))[:, None]


@pytest.mark.parametrize("low_bytes", [0, 1, 5, 7])
def test_long_packets_store_noise_and_code_the_rest(low_bytes):
    words = noise_and(low_bytes)
    data = encode_raw(words, 8)
    assert np.array_equal(decode_raw(data, RawParameters(8), "uint64", *words.shape, 0), words)
    # Two bits of the upper byte, and blocks of noise as they are.
    assert len(data) < len(words) * (low_bytes + 0.26) + 1000


def test_long_packets_of_words_that_repeat():
    words = np.tile(noise_and(7, 1000), (10, 1))
    data = encode_raw(words, 8)
    assert np.array_equal(decode_raw(data, RawParameters(8), "uint64", *words.shape, 0), words)
    assert len(data) < 8 * 1100 + 1000
